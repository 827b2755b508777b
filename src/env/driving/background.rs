//! Background traffic: the vehicles that SUMO drives, and pedestrians. This module decides when
//! the vehicles of the route files depart and which of them are agents, reads where background
//! traffic is, and turns its vehicles into wrecks after collisions.
//!
//! A vehicle that may change lanes is on the lane that SUMO reports: after a lane change, its route
//! becomes the one along the new lane ([`LaneRoutes`](super::lane_routes::LaneRoutes)).
//!
//! Background traffic occupies the slots behind the agents'. First come the vehicles that start at
//! spawn places, then those of the route files, as many as the scenario's capacity allows. Agents
//! from route files get free slots among the agents'. A
//! background vehicle that collides with an agent or a wreck becomes a wreck itself, for as long
//! as an agent's wreck. Collisions of background vehicles with each other are left to SUMO.

use rand::RngExt as _;

use super::agents::{Slot, Status};
use super::collisions::Collisions;
use super::departure::Departure;
use super::effects::Effects;
use super::geometry::{Pose, Size};
use super::metrics::BackgroundMetrics;
use super::motion::{NO_CHECKS, SUMO_CHECKS, lane_change_mode};
use super::spawn::{MARGIN, Placed, Spawned};
use super::task::{Driver, Task};
use crate::rng::{Rng, Seed};
use crate::scenario::{PlannedSource, Spacing};
use crate::sumo::{Command, Snapshot};

/// Departure times of a vehicle or flow of the route files.
#[derive(Debug, Clone)]
struct Clock {
    rng: Rng,
    /// Next departure, counted from the start of the episode \[s\].
    next: f64,
    /// Number of departures left.
    left: u64,
    /// Source of the decisions which vehicles are agents.
    roles: Rng,
    /// Vehicles that are due and not on the road yet.
    due: Option<Due>,
}

/// Vehicles of one type that depart together.
#[derive(Debug, Clone, Copy)]
struct Due {
    /// Index into [`Demand::types`](crate::scenario::Demand).
    kind: usize,
    /// Index into the departures of the plan.
    departure: usize,
    /// Number of vehicles.
    count: u64,
    /// Time at which they are due, from the start of the episode \[s\].
    time: f64,
    /// Whether the first of them is an agent.
    is_agent: bool,
}

/// A background vehicle at a spawn place that has not departed yet.
#[derive(Debug, Clone, Copy)]
struct Pending {
    slot: usize,
    placed: Placed,
    /// Index of the type in SUMO's list.
    vehicle_type: u32,
    size: Size,
}

/// The background traffic of an episode. Its slots are given to the methods as a slice without
/// those of the agents.
#[derive(Debug, Clone)]
pub(super) struct Background {
    driver: Driver,
    clocks: Vec<Clock>,
    /// Vehicles at spawn places that have not departed yet.
    pending: Vec<Pending>,
    /// Whether an agent has come in the episode, or has been there from its start.
    has_agents: bool,
    effects: Effects,
}

impl Background {
    pub(super) fn new(task: &Task, driver: Driver) -> Self {
        let clocks = Vec::with_capacity(task.map.plan.sources.len());
        let effects = Effects::new(task.agents, task.others);
        Self { driver, clocks, pending: Vec::new(), has_agents: false, effects }
    }

    /// Begins a new episode: empties the slots and lets vehicles depart. `spawned` are the vehicles
    /// at spawn places; `slots` are those of the agents and of the background traffic.
    pub(super) fn spawn(
        &mut self,
        task: &Task,
        world: u32,
        seed: Seed,
        spawned: &Spawned,
        slots: &mut [Slot],
        commands: &mut Vec<Command>,
    ) {
        self.effects.begin();
        self.has_agents = task.starting > 0;
        self.clocks.clear();
        for source in &task.map.plan.sources {
            // The number in the files, so that departures do not depend on who is left out.
            let mut rng = seed.index(source.source as u64).rng();
            let mut next = source.begin;
            if !matches!(source.spacing, Spacing::Equal(_)) {
                next += gap(source.spacing, &mut rng);
            }
            let roles = seed.child("agents").index(source.source as u64).rng();
            self.clocks.push(Clock { rng, next, left: source.number, roles, due: None });
        }
        let mut rng = seed.child("places").rng();
        let others = &mut slots[task.agents..];
        for (slot, i) in others.iter_mut().zip(task.agents as u32..) {
            if slot.added {
                commands.push(Command::Remove { world, slot: i });
            }
            *slot = Slot::default();
        }
        self.pending.clear();
        for (slot, placed) in (task.agents..).zip(&spawned.others) {
            let (vehicle_type, size) = task.place_type(draw(&task.place_mix, &mut rng));
            let pending = placed.map(|placed| Pending { slot, placed, vehicle_type, size });
            self.pending.extend(pending);
        }
        self.let_depart(task, world, 0.0, spawned, slots, commands);
    }

    /// Appends the commands of the coming exchange, `now` seconds after the start of the episode.
    /// `spawned` are the vehicles at spawn places; `slots` are those of the agents and of the
    /// background traffic.
    pub(super) fn act(
        &mut self,
        task: &Task,
        world: u32,
        now: f64,
        spawned: &Spawned,
        slots: &mut [Slot],
        commands: &mut Vec<Command>,
    ) {
        for (i, slot) in slots[task.agents..].iter_mut().enumerate() {
            if slot.status != Status::Wreck {
                continue;
            }
            let at = (task.agents + i) as u32;
            if slot.wreck_steps == 0 {
                self.effects.dismiss(i, task.map.routes[slot.route].is_walked());
                *slot = Slot::default();
                commands.push(Command::Remove { world, slot: at });
                continue;
            }
            slot.wreck_steps -= 1;
            if !std::mem::replace(&mut self.effects.road_users[i].stopped, true) {
                commands.push(Command::SpeedMode { world, slot: at, mode: NO_CHECKS });
                commands.push(Command::SetSpeed { world, slot: at, speed: 0.0 });
            }
        }
        self.let_depart(task, world, now, spawned, slots, commands);
    }

    /// Lets the vehicles depart whose time has come: those at spawn places, and those of the route
    /// files as long as slots are free and not reserved; the others wait. Those that have waited
    /// longest depart first, in steps for background traffic and in seconds for agents, so that no
    /// flow gets every slot that becomes free.
    fn let_depart(
        &mut self,
        task: &Task,
        world: u32,
        now: f64,
        spawned: &Spawned,
        slots: &mut [Slot],
        commands: &mut Vec<Command>,
    ) {
        self.pending.retain(|pending| {
            let due = pending.placed.time <= now + MARGIN;
            if due {
                pending.depart(task, world, &mut slots[pending.slot], commands);
            }
            !due
        });
        let sources = &task.map.plan.sources;
        let interval = task.scenario.control.interval;
        let mut vacant = task.agents + task.placed;
        loop {
            // The first of the background traffic and the first agent, each with its order.
            let mut first: [Option<(f64, usize, Due)>; 2] = [None; 2];
            for (index, (source, clock)) in sources.iter().zip(&mut self.clocks).enumerate() {
                let Some(due) = clock.due(task, source, now) else { continue };
                let steps = ((due.time - MARGIN) / interval).ceil();
                let order = if due.is_agent { due.time } else { steps };
                let known = &mut first[usize::from(due.is_agent)];
                if known.is_none_or(|(least, ..)| order < least) {
                    *known = Some((order, index, due));
                }
            }
            if let [Some((_, index, due)), None] = first
                && self.is_last_chance(task, sources[index].source, due.kind)
            {
                self.clocks[index].due = Some(Due { is_agent: true, ..due });
                continue;
            }
            let [other, agent] = first;
            let found = (vacant..slots.len()).find(|&i| slots[i].is_free() && other.is_some());
            vacant = found.map_or(vacant, |i| i + 1);
            if let (Some((_, index, due)), Some(i)) = (other, found) {
                self.clocks[index].take(task, &sources[index]);
                let (vehicle_type, size) = task.demand_type(due.kind);
                let route = task.map.plan.departures[due.departure].route;
                slots[i] = Slot { route, assigned: route, size, added: true, ..Slot::default() };
                commands.push(Command::Depart {
                    world,
                    slot: i as u32,
                    departure: due.departure as u32,
                    vehicle_type,
                    // The stops of a flow are timed from its first departure.
                    until_from_now: due.time - sources[index].begin - now,
                });
                continue;
            }
            let free = |&i: &usize| slots[i].is_free() && !spawned.is_reserved(i);
            let free = (0..task.agents).find(free);
            let (Some((_, index, due)), Some(i)) = (agent, free) else { return };
            self.clocks[index].take(task, &sources[index]);
            self.has_agents = true;
            let (vehicle_type, size) = task.agent_type(self.driver, due.kind);
            let planned = &task.map.plan.departures;
            let route = planned[due.departure].route;
            let departure = Some(Departure::new(task, due.departure, due.time));
            let class = task.demand.types[due.kind].class;
            slots[i] = Slot {
                route,
                assigned: route,
                class,
                size,
                added: true,
                departure,
                ..Slot::default()
            };
            let (slot, departure) = (i as u32, (planned.len() + due.departure) as u32);
            let mode = if self.driver == Driver::Sumo { SUMO_CHECKS } else { NO_CHECKS };
            // Agents make no stops.
            let until_from_now = 0.0;
            commands.push(Command::Depart { world, slot, departure, vehicle_type, until_from_now });
            commands.push(Command::SpeedMode { world, slot, mode });
            commands.extend(lane_change_mode(task, self.driver, world, slot));
        }
    }

    /// Returns whether a vehicle that is about to depart has to be an agent, so that the episode has
    /// one: it may be an agent, and nobody was before or may be later.
    fn is_last_chance(&self, task: &Task, source: usize, kind: usize) -> bool {
        !self.has_agents && task.may_be_agent(source, kind) && !self.expects_agents(task)
    }

    /// Returns whether vehicles that may be agents will depart from now on.
    pub(super) fn expects_agents(&self, task: &Task) -> bool {
        let sources = task.map.plan.sources.iter().zip(&self.clocks);
        sources.into_iter().any(|(source, clock)| {
            let due = clock.due.is_some_and(|due| due.is_agent || due.count > 1);
            task.may_be_agents(source.source) && (due || clock.left > 0 && clock.next < source.end)
        })
    }

    /// Returns how many agents wait for a free slot, `now` seconds after the start of the episode.
    pub(super) fn queued(&self, task: &Task, now: f64) -> u32 {
        let sources = task.map.plan.sources.iter().zip(&self.clocks);
        let waiting = sources.filter(|(source, _)| task.may_be_agents(source.source));
        let waiting = waiting.map(|(source, clock)| {
            let (mut clock, mut count) = (clock.clone(), 0);
            while let Some(due) = clock.due(task, source, now) {
                count += u32::from(due.is_agent);
                clock.take(task, source);
            }
            count
        });
        waiting.sum()
    }

    /// Notes that the slot of an agent gets another agent.
    pub(super) fn renew(&mut self, agent: usize) {
        self.effects.renew(agent);
    }

    /// Reads from the snapshot where the vehicles are, and which have come or gone.
    pub(super) fn place(
        &mut self,
        task: &Task,
        world: u32,
        snapshot: &Snapshot,
        slots: &mut [Slot],
    ) {
        let first = world as usize * task.slots() + task.agents;
        for (i, slot) in slots.iter_mut().enumerate() {
            let (body, state) = (snapshot.bodies.get(first + i), snapshot.vehicles.get(first + i));
            let (Some(body), Some(state)) = (body.copied().flatten(), state.copied().flatten())
            else {
                if slot.departed {
                    // The vehicle came to the end of its route.
                    self.effects.dismiss(i, task.map.routes[slot.route].is_walked());
                    *slot = Slot::default();
                }
                continue;
            };
            let (sin, cos) = body.heading.sin_cos();
            let half = slot.size[0] / 2.0;
            let pose =
                Pose { x: body.x - half * cos, y: body.y - half * sin, heading: body.heading };
            let front = [body.x, body.y];
            let path = |slot: &Slot| task.map.routes[slot.route].lanes();
            let road_user = &mut self.effects.road_users[i];
            let changed = task.map.lane_routes.follow(&task.map.routes, slot, &body);
            let (s, lateral, segment) = match changed {
                Some(on_new_lane) => on_new_lane,
                None if slot.departed => path(slot).project(front, slot.segment),
                None => path(slot).nearest(front),
            };
            let route = &task.map.routes[slot.route];
            (slot.s, slot.segment) = (route.on_path(s - half), segment);
            // Pedestrians cut corners, so that their offset says nothing about the path ahead.
            slot.lateral = if route.is_walked() { 0.0 } else { lateral };
            slot.age = if slot.departed { slot.age + 1 } else { 0 };
            if slot.departed {
                slot.before = match changed {
                    // A lane change takes no time: nobody is between two lanes.
                    Some(_) => pose.behind(state.speed * task.scenario.control.interval),
                    None => slot.pose,
                };
                if slot.status == Status::Active {
                    let braking = (slot.speed - state.speed) / task.scenario.control.interval;
                    road_user.braking = road_user.braking.max(braking);
                }
            } else {
                slot.before = pose;
                (slot.departed, slot.status) = (true, Status::Active);
            }
            (slot.pose, slot.speed) = (pose, state.speed);
            if slot.status == Status::Active {
                road_user.time_loss = body.time_loss;
            }
        }
    }

    /// Turns vehicles that crashed in the step into wrecks, and records how near agents came to the
    /// others. `slots` are those of the agents and of the background traffic.
    pub(super) fn meet_agents(
        &mut self,
        task: &Task,
        now: f64,
        collisions: &Collisions,
        slots: &mut [Slot],
    ) {
        let (agents, others) = slots.split_at_mut(task.agents);
        for (i, other) in others.iter_mut().enumerate() {
            if other.status != Status::Active {
                continue;
            }
            if collisions.partner(task.agents + i).is_some() {
                (other.status, other.wreck_steps, other.speed) =
                    (Status::Wreck, task.wreck_steps(), 0.0);
                self.effects.crash(i);
            } else {
                self.effects.watch(&task.map, agents, i, other, now);
            }
        }
    }

    /// Returns the summary of the episode.
    pub(super) fn metrics(&self, task: &Task, slots: &[Slot], watched: bool) -> BackgroundMetrics {
        self.effects.metrics(&task.map, slots, watched)
    }
}

impl Pending {
    /// Fills the vehicle's slot and appends the command that puts it on the road.
    fn depart(&self, task: &Task, world: u32, slot: &mut Slot, commands: &mut Vec<Command>) {
        let Placed { route, pos, speed, .. } = self.placed;
        let (size, vehicle_type) = (self.size, self.vehicle_type);
        *slot = Slot { route, assigned: route, size, added: true, ..Slot::default() };
        commands.push(Command::Add {
            world,
            slot: self.slot as u32,
            route: route as u32,
            vehicle_type,
            depart_pos: task.map.routes[route].path.ahead(pos, size[0] / 2.0),
            depart_speed: speed,
        });
    }
}

impl Clock {
    /// Returns the vehicles of a vehicle or flow that are due at `now`, which it draws if none is.
    fn due(&mut self, task: &Task, source: &PlannedSource, now: f64) -> Option<Due> {
        while self.due.is_none()
            && self.left > 0
            && self.next <= now + MARGIN
            && self.next < source.end
        {
            let kind = draw(&task.demand.sources[source.source].types, &mut self.rng);
            let departure = draw(&source.departures, &mut self.rng);
            let time = self.next;
            self.next += gap(source.spacing, &mut self.rng);
            self.left -= 1;
            let scale = task.demand.types[kind].scale;
            let part = scale.fract() > 0.0 && self.rng.random::<f64>() < scale.fract();
            let count = scale as u64 + u64::from(part);
            if let Some(departure) = departure.filter(|_| count > 0) {
                let is_agent = self.is_agent(task, source, kind);
                self.due = Some(Due { kind, departure, count, time, is_agent });
            }
        }
        self.due
    }

    /// Removes the first of the vehicles that are due, which departs.
    fn take(&mut self, task: &Task, source: &PlannedSource) {
        self.due = self.due.filter(|due| due.count > 1).map(|due| Due {
            count: due.count - 1,
            is_agent: self.is_agent(task, source, due.kind),
            ..due
        });
    }

    /// Draws whether a vehicle of this type is an agent.
    fn is_agent(&mut self, task: &Task, source: &PlannedSource, kind: usize) -> bool {
        let share = task.scenario.traffic.penetration;
        task.may_be_agent(source.source, kind)
            && (share >= 1.0 || self.roles.random::<f64>() < share)
    }
}

/// Returns the seconds to the next departure.
fn gap(spacing: Spacing, rng: &mut Rng) -> f64 {
    match spacing {
        Spacing::Equal(gap) => gap,
        Spacing::Poisson(rate) => -(1.0 - rng.random::<f64>()).ln() / rate,
        // Number of attempts, one per second, until the first success.
        Spacing::Chance(p) if p >= 1.0 => 1.0,
        Spacing::Chance(p) => ((1.0 - rng.random::<f64>()).ln() / (-p).ln_1p()).ceil().max(1.0),
    }
}

/// Draws an entry from a list of entries and weights; the default, if the list is empty.
fn draw<T: Copy + Default>(mix: &[(T, f64)], rng: &mut Rng) -> T {
    if let [(only, _)] = mix {
        return *only;
    }
    let mut left = rng.random::<f64>() * mix.iter().map(|entry| entry.1).sum::<f64>();
    let hit = mix.iter().find(|(_, weight)| {
        left -= weight;
        left < 0.0
    });
    hit.or(mix.last()).map_or_else(T::default, |entry| entry.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_of_departures_have_their_means() {
        let mut rng = Seed::new(1).rng();
        for (spacing, mean) in
            [(Spacing::Equal(7.0), 7.0), (Spacing::Poisson(0.2), 5.0), (Spacing::Chance(0.25), 4.0)]
        {
            let sum: f64 = (0..20_000).map(|_| gap(spacing, &mut rng)).sum();
            assert!((sum / 20_000.0 - mean).abs() < 0.03 * mean, "{spacing:?}: {}", sum / 20_000.0);
        }
        let mut counts = [0; 3];
        for _ in 0..10_000 {
            counts[draw(&[(0, 1.0), (1, 0.0), (2, 3.0)], &mut rng)] += 1;
        }
        assert!(counts[1] == 0 && (2300..2700).contains(&counts[0]), "{counts:?}");
    }
}
