//! The beginning of an episode: draws the agents' routes and positions.

use super::agents::{Slot, Status};
use super::geometry::Pose;
use super::motion::{NO_CHECKS, SUMO_CHECKS, lane_change_mode};
use super::task::{AGENT_TYPE, Driver, SUMO_TYPE, Task};
use super::vehicle::tyres::Motion;
use crate::rng::{self, Rng};
use crate::sumo::Command;
use crate::sumo::net::CARS;

/// The vehicles with which an episode begins.
pub(super) struct Spawned {
    /// Number of agents, which occupy the first slots.
    pub(super) active_agents: usize,
    /// Background vehicles at spawn places: their routes and the positions of their centres along
    /// them \[m\].
    pub(super) others: Vec<(usize, f64)>,
}

/// Fills the agents' slots for a new episode and appends the commands that replace the vehicles on
/// the road.
pub(super) fn spawn(
    task: &Task,
    driver: Driver,
    world: u32,
    rng: &mut Rng,
    agents: &mut [Slot],
    commands: &mut Vec<Command>,
) -> Spawned {
    let mut places: Vec<usize> = (0..task.places.len()).collect();
    rng::shuffle(rng, &mut places);
    let half = task.scenario.vehicle.length / 2.0;
    let (vehicle_type, mode) =
        if driver == Driver::Sumo { (SUMO_TYPE, SUMO_CHECKS) } else { (AGENT_TYPE, NO_CHECKS) };
    // The number is drawn only if there is a choice, so that the other random numbers do not
    // depend on this setting.
    let choice = task.starting - task.fewest;
    let active_agents = task.fewest + if choice > 0 { rng::below(rng, choice + 1) } else { 0 };
    let mut taken = Vec::new();
    let mut draw = |place: usize, rng: &mut Rng| {
        let place = &task.places[places[place]];
        let free = |route: &&usize| task.reserved[**route].is_none_or(|end| !taken.contains(&end));
        let choice = place.routes.iter().filter(free).count();
        let drawn = if choice > 1 { rng::below(rng, choice) } else { 0 };
        // The scenario's check guarantees that a route is free.
        let route = *place.routes.iter().filter(free).nth(drawn).unwrap_or(&place.routes[0]);
        taken.extend(task.reserved[route]);
        (route, place.pos + rng::symmetric(rng) * task.scenario.jitter.longitudinal)
    };
    for (i, slot) in agents.iter_mut().enumerate() {
        let at = i as u32;
        if slot.added {
            commands.push(Command::Remove { world, slot: at });
        }
        if i >= active_agents {
            *slot = Slot::default();
            continue;
        }
        let (route, place) = draw(i, rng);
        let lateral = rng::symmetric(rng) * task.scenario.jitter.lateral;
        let path = &task.map.routes[route].path;
        let s = path.arc(0, place).unwrap_or(place);
        let front = path.ahead(place, half);
        let (point, heading) = path.at(s);
        let pose = Pose::beside(point, heading, lateral);
        *slot = Slot {
            status: Status::Active,
            route,
            assigned: route,
            class: CARS,
            size: [task.scenario.vehicle.length, task.scenario.vehicle.width],
            pose,
            before: pose,
            motion: Motion::at(pose),
            s,
            lateral,
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
            depart_speed: 0.0,
        });
        commands.push(Command::SpeedMode { world, slot: at, mode });
        commands.extend(lane_change_mode(task, driver, world, at));
        if driver != Driver::Sumo {
            commands.push(Command::SetSpeed { world, slot: at, speed: 0.0 });
        }
    }
    let others =
        (task.starting..task.starting + task.placed).map(|place| draw(place, rng)).collect();
    Spawned { active_agents, others }
}
