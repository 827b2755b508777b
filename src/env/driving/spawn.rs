//! The beginning of an episode: draws which vehicles at spawn places are there, their routes,
//! positions and departure times.

use super::agents::{Slot, Status};
use super::geometry::Pose;
use super::motion::{NO_CHECKS, SUMO_CHECKS, lane_change_mode};
use super::task::{Driver, Task};
use super::vehicle::longitudinal;
use super::vehicle::tyres::Motion;
use crate::rng::{self, Rng};
use crate::sumo::Command;
use crate::sumo::net::CARS;

/// Half a millisecond \[s\]: SUMO's times are whole milliseconds, and sums of times are rounded.
pub(super) const MARGIN: f64 = 5e-4;

/// A vehicle that departs from a spawn place.
#[derive(Debug, Clone, Copy)]
pub(super) struct Placed {
    pub(super) route: usize,
    /// Position of the centre along the route \[m\].
    pub(super) pos: f64,
    /// Speed at the departure \[m/s\].
    pub(super) speed: f64,
    /// Time of the departure, from the start of the episode \[s\].
    pub(super) time: f64,
    /// Whether the vehicle starts with the episode, standing still, so that SUMO has room for it.
    immediate: bool,
}

/// An agent that departs from a spawn place.
#[derive(Debug, Clone, Copy)]
struct Agent {
    slot: usize,
    placed: Placed,
    /// Kind of the vehicle, an index into the task's abilities.
    kind: usize,
    /// Offset from the route's path, positive to the left \[m\].
    lateral: f64,
}

/// The vehicles at spawn places of an episode.
#[derive(Debug, Clone, Default)]
pub(super) struct Spawned {
    /// Number of agents that are there in the episode. They have the first slots.
    pub(super) active_agents: usize,
    /// The background vehicles, by their places among those at spawn places; `None` for one that
    /// is not there.
    pub(super) others: Vec<Option<Placed>>,
    /// Agents that have not departed yet.
    pending: Vec<Agent>,
}

impl Spawned {
    /// Draws the vehicles of a new episode.
    pub(super) fn draw(task: &Task, rng: &mut Rng) -> Self {
        let mut places: Vec<usize> = (0..task.places.len()).collect();
        rng::shuffle(rng, &mut places);
        // The number is drawn only if there is a choice, so that the other random numbers do not
        // depend on this setting.
        let choice = task.starting - task.fewest;
        let drawn = task.fewest + if choice > 0 { rng::below(rng, choice + 1) } else { 0 };
        let present = presence(task, &places, drawn, rng);
        let mut taken = Vec::new();
        let mut draw = |place: usize, rng: &mut Rng| {
            let place = &task.places[places[place]];
            let free =
                |route: &&usize| task.reserved[**route].is_none_or(|end| !taken.contains(&end));
            let choice = place.routes.iter().filter(free).count();
            let drawn = if choice > 1 { rng::below(rng, choice) } else { 0 };
            // The scenario's check guarantees that a route is free.
            let route = *place.routes.iter().filter(free).nth(drawn).unwrap_or(&place.routes[0]);
            taken.extend(task.reserved[route]);
            let pos = place.pos + rng::symmetric(rng) * task.scenario.jitter.longitudinal;
            let departure = place.departure;
            let window = departure.end - departure.begin;
            let later = if window > 0.0 { window * rng::uniform(rng) } else { 0.0 };
            Placed {
                route,
                pos,
                speed: departure.depart_speed,
                time: departure.begin + later,
                immediate: departure.is_immediate(),
            }
        };
        let mut pending = Vec::new();
        for place in (0..drawn).filter(|&i| present[i]) {
            let placed = draw(place, rng);
            let lateral = rng::symmetric(rng) * task.scenario.jitter.lateral;
            let kind = draw_kind(task, rng);
            pending.push(Agent { slot: pending.len(), placed, kind, lateral });
        }
        let others = task.starting..task.starting + task.placed;
        let others = others.map(|place| present[place].then(|| draw(place, rng))).collect();
        Self { active_agents: pending.len(), others, pending }
    }

    /// Whether an agent that has not departed yet has this slot.
    pub(super) fn is_reserved(&self, slot: usize) -> bool {
        self.pending.iter().any(|agent| agent.slot == slot)
    }

    /// Whether agents have yet to depart.
    pub(super) fn expects_agents(&self) -> bool {
        !self.pending.is_empty()
    }

    /// Lets the agents depart whose time has come, `now` seconds after the start of the episode:
    /// fills their slots and appends the commands.
    pub(super) fn let_depart(
        &mut self,
        task: &Task,
        driver: Driver,
        world: u32,
        now: f64,
        slots: &mut [Slot],
        commands: &mut Vec<Command>,
    ) {
        self.pending.retain(|agent| {
            let due = agent.placed.time <= now + MARGIN;
            if due {
                agent.depart(task, driver, world, &mut slots[agent.slot], commands);
            }
            !due
        });
    }
}

/// Draws the kind of an agent's vehicle, an index into the task's abilities.
fn draw_kind(task: &Task, rng: &mut Rng) -> usize {
    let kinds = &task.scenario.kinds;
    if kinds.is_empty() {
        return 0;
    }
    let mut left = rng::uniform(rng);
    let hit = kinds.iter().position(|kind| {
        left -= kind.share;
        left < 0.0
    });
    hit.map_or(0, |kind| kind + 1)
}

/// Returns for each of the `places`, in their order, whether a vehicle is there: the first `drawn`
/// are agents, of which at least one is there.
fn presence(task: &Task, places: &[usize], drawn: usize, rng: &mut Rng) -> Vec<bool> {
    let certain = task.places.iter().all(|place| place.departure.presence >= 1.0);
    let draw =
        |&place: &usize| certain || rng::uniform(rng) < task.places[place].departure.presence;
    let mut present: Vec<bool> = places.iter().map(draw).collect();
    if drawn > 0 && !present[..drawn].contains(&true) {
        present[rng::below(rng, drawn)] = true;
    }
    present
}

impl Agent {
    /// Returns the step in which the agent would arrive if nobody else were there, at full throttle.
    fn alone_arrival(&self, task: &Task) -> u32 {
        let Placed { route, pos, mut speed, time, immediate } = self.placed;
        let (control, vehicle) = &task.abilities[self.kind];
        // A vehicle that departs later is on the road one step after its time.
        let at_once = immediate || time <= MARGIN;
        let entered =
            if at_once { 0 } else { ((time - MARGIN) / control.interval).ceil() as u32 + 1 };
        let route = &task.map.routes[route];
        let (mut s, mut steps) = (route.path.arc(0, pos).unwrap_or(pos), 0);
        while s < route.arrival && steps < task.scenario.termination.horizon {
            let (distance, faster) = longitudinal::advance(control, vehicle, speed, 1.0);
            (s, speed, steps) = (s + distance, faster, steps + 1);
        }
        entered + steps
    }

    /// Fills the agent's slot and appends the commands that put the vehicle on the road.
    fn depart(
        &self,
        task: &Task,
        driver: Driver,
        world: u32,
        slot: &mut Slot,
        commands: &mut Vec<Command>,
    ) {
        let (at, Placed { route, pos, speed, immediate, .. }) = (self.slot as u32, self.placed);
        let vehicle_type = Task::type_of_kind(driver, self.kind);
        let mode = if driver == Driver::Sumo { SUMO_CHECKS } else { NO_CHECKS };
        let vehicle = task.abilities[self.kind].1;
        let speed = speed.min(vehicle.max_speed);
        let path = &task.map.routes[route].path;
        let s = path.arc(0, pos).unwrap_or(pos);
        let front = path.ahead(pos, vehicle.length / 2.0);
        let (point, heading) = path.at(s);
        let pose = Pose::beside(point, heading, self.lateral);
        *slot = Slot {
            status: if immediate { Status::Active } else { Status::Empty },
            route,
            assigned: route,
            class: CARS,
            kind: self.kind,
            size: [vehicle.length, vehicle.width],
            pose,
            before: pose,
            motion: Motion::driving(pose, speed),
            s,
            speed,
            alone_arrival: self.alone_arrival(task),
            lateral: self.lateral,
            held: Some(front),
            added: true,
            ..Slot::default()
        };
        commands.push(Command::Add {
            world,
            slot: at,
            route: route as u32,
            vehicle_type,
            depart_pos: front,
            depart_speed: speed,
        });
        commands.push(Command::SpeedMode { world, slot: at, mode });
        commands.extend(lane_change_mode(task, driver, world, at));
        if driver != Driver::Sumo {
            commands.push(Command::SetSpeed { world, slot: at, speed });
        }
    }
}
