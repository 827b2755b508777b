//! Tests of a world against a fake simulator that carries out the commands exactly: vehicles move
//! along their route's path by speed times the step length. What SUMO itself does is tested in
//! `tests/`.

mod blind;
mod episodes;
mod flow;
mod intention;
mod no_lane;
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
use crate::env::spec::Feature;
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
    /// Route, position of the front and speed of each slot's vehicle.
    vehicles: Vec<Option<(usize, f64, f64)>>,
    /// Slots of vehicles that wait until their place on the road is free.
    waiting: HashSet<usize>,
    /// Position at which each vehicle departed, if the fake simulator chose it.
    departed: Vec<f64>,
}

/// Position at which vehicles of route files depart \[m\].
const DEPARTURE: f64 = 5.0;

impl Rails {
    fn new(task: &Arc<Task>) -> Self {
        let (vehicles, departed) = (vec![None; task.slots()], vec![0.0; task.slots()]);
        Self { task: Arc::clone(task), vehicles, waiting: HashSet::new(), departed }
    }

    fn step(&mut self, commands: &[Command]) -> Snapshot {
        for command in commands {
            match *command {
                Command::Add { slot, route, depart_pos, depart_speed, .. } => {
                    let vehicle = &mut self.vehicles[slot as usize];
                    assert!(vehicle.is_none(), "slot {slot} already holds a vehicle");
                    *vehicle = Some((route as usize, depart_pos, depart_speed));
                    self.departed[slot as usize] = 0.0;
                }
                Command::Remove { slot, .. } => {
                    assert!(self.vehicles[slot as usize].take().is_some(), "slot {slot} is empty");
                    self.waiting.remove(&(slot as usize));
                }
                Command::SetSpeed { slot, speed, .. } => {
                    let vehicle =
                        self.vehicles[slot as usize].as_mut().expect("only vehicles have a speed");
                    assert!(
                        !self.waiting.contains(&(slot as usize)),
                        "slot {slot} is not yet there"
                    );
                    assert!(
                        (0.0..=self.task.scenario.vehicle.max_speed + 1e-9).contains(&speed),
                        "speed {speed}"
                    );
                    vehicle.2 = speed;
                }
                Command::SpeedMode { slot, .. } | Command::LaneChangeMode { slot, .. } => {
                    assert!(self.vehicles[slot as usize].is_some());
                }
                Command::Depart { slot, departure, .. } => {
                    let (planned, slot) = (&self.task.map.plan.departures, slot as usize);
                    let is_agent = departure as usize >= planned.len();
                    let theirs = if is_agent {
                        slot < self.task.agents
                    } else {
                        slot >= self.task.agents + self.task.placed
                    };
                    assert!(theirs, "slot {slot} is not theirs");
                    let vehicle = &mut self.vehicles[slot];
                    assert!(vehicle.is_none(), "slot {slot} already holds a vehicle");
                    let route = planned[departure as usize % planned.len()].route;
                    *vehicle = Some((route, DEPARTURE, 10.0));
                    self.departed[slot] = DEPARTURE;
                    // Background vehicles depart on top of each other here, as nobody drives them.
                    if is_agent {
                        self.waiting.insert(slot);
                    }
                }
                Command::MoveTo { .. } | Command::ChangeLane { .. } => {
                    panic!("everyone keeps the lane here")
                }
                Command::StartPhase { .. } => panic!("no traffic lights here"),
            }
        }
        let step = self.task.scenario.control.interval;
        let near = |s: f64| s < DEPARTURE + 8.0;
        let mut ready: Vec<usize> = self.waiting.iter().copied().collect();
        ready.sort_unstable();
        for slot in ready {
            let here = |other: usize| self.vehicles[other].map(|(route, s, _)| (route, s));
            let (route, _) = here(slot).expect("who waits has a route");
            let blocked = (0..self.task.agents)
                .filter(|other| !self.waiting.contains(other))
                .any(|other| here(other).is_some_and(|(r, s)| r == route && near(s)));
            if !blocked {
                self.waiting.remove(&slot);
            }
        }
        let mut snapshot = Snapshot::default();
        for (slot, vehicle) in self.vehicles.iter_mut().enumerate() {
            let route = |route: usize| &self.task.map.routes[route].path;
            if self.waiting.contains(&slot) {
                snapshot.vehicles.push(None);
                snapshot.bodies.push(None);
                continue;
            }
            let chosen = self.departed[slot] > 0.0;
            if slot >= self.task.agents && vehicle.is_some_and(|(r, s, _)| s > route(r).length()) {
                *vehicle = None;
            }
            let departed = self.departed[slot];
            snapshot.vehicles.push(vehicle.as_mut().map(|(_, s, speed)| {
                *s += *speed * step;
                VehicleState {
                    distance: if departed > 0.0 { *s - departed } else { *s },
                    speed: *speed,
                }
            }));
            // SUMO removes vehicles in the step in which they reach the end.
            if slot < self.task.agents
                && chosen
                && vehicle.is_some_and(|(r, s, _)| s >= route(r).length())
            {
                *vehicle = None;
                snapshot.vehicles[slot] = None;
            }
            let posed = slot >= self.task.agents || self.task.has_flow();
            snapshot.bodies.push(vehicle.filter(|_| posed).map(|(r, s, _)| {
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
