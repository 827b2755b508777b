//! Background traffic: the vehicles that SUMO drives, and pedestrians. This module decides when
//! the vehicles of the route files depart and which of them are agents, reads where background
//! traffic is, and turns its vehicles into wrecks after collisions.
//!
//! Background traffic occupies the slots behind the agents'. First come the vehicles that start at
//! spawn places, then those of the route files, as many as the scenario's capacity allows. Agents
//! from route files get free slots among the agents'. A
//! background vehicle that collides with an agent or a wreck becomes a wreck itself, for as long
//! as an agent's wreck. Collisions of background vehicles with each other are left to SUMO.

use rand::RngExt as _;

use super::agents::{Slot, Status};
use super::collisions::Collisions;
use super::effects::Effects;
use super::geometry::Pose;
use super::metrics::BackgroundMetrics;
use super::motion::{NO_CHECKS, SUMO_CHECKS};
use super::task::{Driver, Task};
use super::trips::Departure;
use crate::rng::{Rng, Seed};
use crate::scenario::{Source, Spacing};
use crate::sumo::{Command, Snapshot};

/// Departure times of a vehicle or flow of the route files.
#[derive(Debug, Clone)]
struct Clock {
    rng: Rng,
    /// Next departure, counted from the start of the episode \[s\].
    next: f64,
    /// Number of departures left.
    left: u64,
    /// The vehicle that departs next, once it is drawn.
    upcoming: Option<Upcoming>,
    /// Source of the decisions which vehicles are agents.
    roles: Rng,
}

/// A vehicle that departs next.
#[derive(Debug, Clone, Copy)]
struct Upcoming {
    /// Index of its type in the route files.
    kind: usize,
    is_agent: bool,
}

impl Clock {
    /// Whether a vehicle of `source` is to depart `now` seconds after the start of the episode.
    fn is_due(&self, source: &Source, now: f64) -> bool {
        // The margin is half a millisecond: SUMO's times are whole milliseconds, and our sums are
        // rounded.
        self.left > 0 && self.next <= now + 5e-4 && self.next < source.end
    }

    /// Returns the vehicle that departs next, of source number `index` of the route files.
    fn upcoming(&mut self, task: &Task, index: usize) -> Upcoming {
        *self.upcoming.get_or_insert_with(|| {
            let kind = draw(&task.demand.sources[index].types, &mut self.rng);
            let share = task.scenario.traffic.penetration;
            let is_agent = task.recruits.get(index).is_some_and(|recruits| recruits[kind])
                && (share >= 1.0 || self.roles.random::<f64>() < share);
            Upcoming { kind, is_agent }
        })
    }

    /// Goes on to the next departure.
    fn advance(&mut self, source: &Source) {
        self.next += gap(source.spacing, &mut self.rng);
        self.left -= 1;
        self.upcoming = None;
    }
}

/// The background traffic of an episode. Its slots are given to the methods as a slice without
/// those of the agents.
#[derive(Debug, Clone)]
pub(super) struct Background {
    driver: Driver,
    clocks: Vec<Clock>,
    effects: Effects,
}

impl Background {
    pub(super) fn new(task: &Task, driver: Driver) -> Self {
        let clocks = Vec::with_capacity(task.demand.sources.len());
        Self { driver, clocks, effects: Effects::new(task.agents, task.others) }
    }

    /// Begins a new episode: empties the slots and adds the vehicles that start at spawn places,
    /// given as route and position of the centre \[m\]. `slots` are those of the agents and of the
    /// background traffic.
    pub(super) fn spawn(
        &mut self,
        task: &Task,
        world: u32,
        seed: Seed,
        places: &[(usize, f64)],
        slots: &mut [Slot],
        commands: &mut Vec<Command>,
    ) {
        self.effects.begin();
        self.clocks.clear();
        for (index, source) in task.demand.sources.iter().enumerate() {
            let mut rng = seed.index(index as u64).rng();
            let mut next = source.begin;
            if !matches!(source.spacing, Spacing::Equal(_)) {
                next += gap(source.spacing, &mut rng);
            }
            let roles = seed.child("agents").index(index as u64).rng();
            self.clocks.push(Clock { rng, next, left: source.number, upcoming: None, roles });
        }
        let mut rng = seed.child("places").rng();
        let others = &mut slots[task.agents..];
        for (slot, i) in others.iter_mut().zip(task.agents as u32..) {
            if slot.added {
                commands.push(Command::Remove { world, slot: i });
            }
            *slot = Slot::default();
        }
        for ((slot, i), &(route, s)) in others.iter_mut().zip(task.agents as u32..).zip(places) {
            let (vehicle_type, size) = task.place_type(draw(&task.place_mix, &mut rng));
            *slot = Slot { route, size, added: true, ..Slot::default() };
            commands.push(Command::Add {
                world,
                slot: i,
                route: route as u32,
                vehicle_type,
                depart_pos: s + size[0] / 2.0,
                depart_speed: 0.0,
            });
        }
        self.let_depart(task, world, 0.0, slots, commands);
    }

    /// Appends the commands of the coming exchange, `now` seconds after the start of the episode.
    /// `slots` are those of the agents and of the background traffic.
    pub(super) fn act(
        &mut self,
        task: &Task,
        world: u32,
        now: f64,
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
        self.let_depart(task, world, now, slots, commands);
    }

    /// Lets the vehicles of the route files depart whose time has come, as long as slots are free;
    /// the other vehicles wait. Agents that wait depart in the order of their times, so that no flow
    /// gets every slot that becomes free.
    fn let_depart(
        &mut self,
        task: &Task,
        world: u32,
        now: f64,
        slots: &mut [Slot],
        commands: &mut Vec<Command>,
    ) {
        let sources = &task.demand.sources;
        loop {
            let mut agent: Option<(usize, f64)> = None;
            for (index, (source, clock)) in sources.iter().zip(&mut self.clocks).enumerate() {
                while clock.is_due(source, now) {
                    let Upcoming { kind, is_agent } = clock.upcoming(task, index);
                    if is_agent {
                        if agent.is_none_or(|(_, due)| clock.next < due) {
                            agent = Some((index, clock.next));
                        }
                        break;
                    }
                    let mut room = task.agents + task.placed..slots.len();
                    let Some(i) = room.find(|&i| slots[i].is_free()) else { break };
                    clock.advance(source);
                    let (vehicle_type, size) = task.demand_type(kind);
                    let route = task.map.demand_routes[source.route].route;
                    slots[i] = Slot { route, size, added: true, ..Slot::default() };
                    let (slot, departure) = (i as u32, index as u32);
                    commands.push(Command::Depart { world, slot, departure, vehicle_type });
                }
            }
            let free = (0..task.agents).find(|&i| slots[i].is_free());
            let (Some((index, due)), Some(i)) = (agent, free) else { return };
            let (clock, source) = (&mut self.clocks[index], &sources[index]);
            let (vehicle_type, size) =
                task.agent_type(self.driver, clock.upcoming(task, index).kind);
            clock.advance(source);
            let route = task.map.demand_routes[source.route].route;
            let departure = Some(Departure { due, ..Departure::default() });
            slots[i] = Slot { route, size, added: true, departure, ..Slot::default() };
            let (slot, departure) = (i as u32, (sources.len() + index) as u32);
            let mode = if self.driver == Driver::Sumo { SUMO_CHECKS } else { NO_CHECKS };
            commands.push(Command::Depart { world, slot, departure, vehicle_type });
            commands.push(Command::SpeedMode { world, slot, mode });
            if task.map.several_lanes {
                commands.push(Command::KeepLane { world, slot });
            }
        }
    }

    /// Returns whether agents will depart from now on, of which none is due.
    pub(super) fn expects_agents(&self, task: &Task) -> bool {
        let sources = task.demand.sources.iter().zip(&self.clocks).zip(&task.recruits);
        sources.into_iter().any(|((source, clock), recruits)| {
            let agents = source.types.iter().any(|entry| recruits[entry.0]);
            agents && clock.left > 0 && clock.next < source.end
        })
    }

    /// Returns how many agents wait for a free slot, `now` seconds after the start of the episode.
    pub(super) fn queued(&self, task: &Task, now: f64) -> u32 {
        let sources = task.demand.sources.iter().zip(&self.clocks).enumerate();
        let waiting = sources.filter(|(index, _)| !task.recruits[*index].is_empty());
        let waiting = waiting.map(|(index, (source, clock))| {
            let (mut clock, mut count) = (clock.clone(), 0);
            while clock.is_due(source, now) {
                count += u32::from(clock.upcoming(task, index).is_agent);
                clock.advance(source);
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
            let route = &task.map.routes[slot.route];
            let (body, state) = (snapshot.bodies.get(first + i), snapshot.vehicles.get(first + i));
            let (Some(body), Some(state)) = (body.copied().flatten(), state.copied().flatten())
            else {
                if slot.departed {
                    // The vehicle came to the end of its route.
                    self.effects.dismiss(i, route.is_walked());
                    *slot = Slot::default();
                }
                continue;
            };
            let (sin, cos) = body.heading.sin_cos();
            let half = slot.size[0] / 2.0;
            let pose =
                Pose { x: body.x - half * cos, y: body.y - half * sin, heading: body.heading };
            let front = [body.x, body.y];
            let road_user = &mut self.effects.road_users[i];
            let (s, _, segment) = if slot.departed {
                route.lanes().project(front, slot.segment)
            } else {
                route.lanes().nearest(front)
            };
            (slot.s, slot.segment) = (route.on_path(s - half), segment);
            if slot.departed {
                slot.before = slot.pose;
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
    pub(super) fn metrics(&self, task: &Task, slots: &[Slot]) -> BackgroundMetrics {
        self.effects.metrics(&task.map, slots)
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

/// Draws an index from a list of indices and weights.
fn draw(mix: &[(usize, f64)], rng: &mut Rng) -> usize {
    if let [(only, _)] = mix {
        return *only;
    }
    let mut left = rng.random::<f64>() * mix.iter().map(|entry| entry.1).sum::<f64>();
    let hit = mix.iter().find(|(_, weight)| {
        left -= weight;
        left < 0.0
    });
    hit.or(mix.last()).map_or(0, |entry| entry.0)
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
