//! Tests of a world against a fake simulator that carries out the commands exactly: vehicles move
//! along their route's path by speed times the step length. What SUMO itself does is tested in
//! `tests/`.

mod episodes;
mod intention;
mod observation;
mod others;
mod paths;
mod records;
mod reward;
mod right_of_way;

use std::collections::HashSet;
use std::path::Path;
use std::sync::Arc;

use proptest::prelude::*;

use super::agents::CLEARED;
use super::*;
use crate::env::Pursuit;
use crate::rng::Seed;
use crate::scenario::{NeighbourOrder, ObservationGroups, Scenario};
use crate::sumo::net::Net;
use crate::sumo::{Body, Command, Snapshot, VehicleState};

/// Returns a shipped scenario.
pub(crate) fn scenario(name: &str) -> Scenario {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("scenarios/{name}.xml"));
    Scenario::load(&path).expect("a shipped scenario is valid")
}

/// Returns a shipped net.
pub(crate) fn net(name: &str) -> Net {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("sumo_nets/{name}.net.xml"));
    Net::load(&path).expect("a shipped net is valid")
}

/// A fake simulator whose vehicles keep to their routes' paths, and which checks every command.
struct Rails {
    task: Arc<Task>,
    vehicles: Vec<Option<(usize, f64, f64)>>,
}

impl Rails {
    fn new(task: &Arc<Task>) -> Self {
        Self { task: Arc::clone(task), vehicles: vec![None; task.slots()] }
    }

    fn step(&mut self, commands: &[Command]) -> Snapshot {
        for command in commands {
            match *command {
                Command::Add { slot, route, depart_pos, depart_speed, .. } => {
                    let vehicle = &mut self.vehicles[slot as usize];
                    assert!(vehicle.is_none(), "slot {slot} already holds a vehicle");
                    *vehicle = Some((route as usize, depart_pos, depart_speed));
                }
                Command::Remove { slot, .. } => {
                    assert!(self.vehicles[slot as usize].take().is_some(), "slot {slot} is empty");
                }
                Command::SetSpeed { slot, speed, .. } => {
                    let vehicle =
                        self.vehicles[slot as usize].as_mut().expect("only vehicles have a speed");
                    assert!(
                        (0.0..=self.task.scenario.vehicle.max_speed + 1e-9).contains(&speed),
                        "speed {speed}"
                    );
                    vehicle.2 = speed;
                }
                Command::SpeedMode { slot, .. } | Command::KeepLane { slot, .. } => {
                    assert!(self.vehicles[slot as usize].is_some());
                }
                Command::Depart { slot, departure, .. } => {
                    assert!(
                        slot as usize >= self.task.agents + self.task.placed,
                        "slot {slot} is not theirs"
                    );
                    let vehicle = &mut self.vehicles[slot as usize];
                    assert!(vehicle.is_none(), "slot {slot} already holds a vehicle");
                    let route = self.task.map.plan.departures[departure as usize].route;
                    *vehicle = Some((route, 5.0, 10.0));
                }
                Command::MoveTo { .. } => panic!("nobody steers here"),
            }
        }
        let step = self.task.scenario.control.interval;
        let mut snapshot = Snapshot::default();
        for (slot, vehicle) in self.vehicles.iter_mut().enumerate() {
            let route = |route: usize| &self.task.map.routes[route].path;
            if slot >= self.task.agents && vehicle.is_some_and(|(r, s, _)| s > route(r).length()) {
                *vehicle = None;
            }
            snapshot.vehicles.push(vehicle.as_mut().map(|(_, s, speed)| {
                *s += *speed * step;
                VehicleState { distance: *s, speed: *speed }
            }));
            snapshot.bodies.push(vehicle.filter(|_| slot >= self.task.agents).map(|(r, s, _)| {
                let ([x, y], heading) = route(r).at(s);
                Body { x, y, heading, lane: None, time_loss: 0.0 }
            }));
        }
        snapshot
    }

    /// Returns the centre of a slot's vehicle on its route's path.
    fn centre(&self, slot: usize) -> Option<[f64; 2]> {
        let half = self.task.scenario.vehicle.length / 2.0;
        self.vehicles[slot].map(|(route, s, _)| self.task.map.routes[route].path.at(s - half).0)
    }
}

fn task(agents: u32, change: impl FnOnce(&mut Scenario)) -> Arc<Task> {
    let mut scenario = scenario("intersection");
    change(&mut scenario);
    Arc::new(Task::new(&scenario, agents).expect("a task"))
}

fn world(task: &Arc<Task>, seed: u64) -> World {
    World::new(Arc::clone(task), Driver::Agents, Seed::new(seed), 0, 1, u64::MAX)
}

/// Returns a world for a driver that gives way.
fn ruled_world(task: &Arc<Task>, seed: u64) -> World {
    World::new(Arc::clone(task), Driver::Rules, Seed::new(seed), 0, 1, u64::MAX)
}

fn exchange(world: &mut World, rails: &mut Rails, actions: &[f32]) {
    let mut commands = Vec::new();
    world.act(0, actions, &mut commands);
    let snapshot = rails.step(&commands);
    world.observe(0, &snapshot).expect("nothing vanishes on rails");
}
