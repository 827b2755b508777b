//! A scenario made ready for one number of agents: its net, routes, spawn places and feature lists.

use super::road::Road;
use super::routes::{RouteGeometry, geometry};
use super::{EnvSpec, Error, observation, state};
use crate::scenario::{Scenario, SpawnPlace};
use crate::sumo::net::{EdgeFunction, Net, Path};
use crate::sumo::{Hosting, Route, SimulationConfig, VehicleType};

/// Index of the agents' vehicle type in [`SimulationConfig::vehicle_types`].
pub(super) const AGENT_TYPE: u32 = 0;
/// Index of the type whose speed SUMO's own driver chooses.
pub(super) const SUMO_TYPE: u32 = 1;

/// A part of a route that lies in a junction.
#[derive(Debug, Clone, Copy)]
pub(super) struct JunctionStretch {
    /// Arc length along the route \[m\].
    pub(super) from: f64,
    pub(super) to: f64,
    /// Of SUMO's type `unregulated`, in which SUMO looks for no collisions.
    pub(super) unregulated: bool,
}

/// Where a vehicle is on its route.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Place {
    /// On its lane, on a road.
    Road,
    /// On its lane, over a junction.
    Junction,
    /// Beside its lane.
    Beside,
}

impl Place {
    /// SUMO's bits for finding the lane of a vehicle that is put there: among the edges of its route (1), which is three times as
    /// fast, but never finds a lane over a junction (SUMO 1.15), or exactly where it is, on any lane or none (2).
    pub fn keep_route(self) -> u8 {
        if self == Self::Road { 1 } else { 2 }
    }
}

/// Everything about a task that no episode changes; shared by all worlds.
#[derive(Debug, Clone)]
pub struct Task {
    /// The scenario.
    pub scenario: Scenario,
    /// Agent slots N.
    pub agents: usize,
    /// Each episode has a random number of agents from this one to N.
    pub fewest: usize,
    /// Spawn places, at least N.
    pub places: Vec<SpawnPlace>,
    /// Routes in the scenario's order.
    pub routes: Vec<RouteGeometry>,
    /// For every route whose destination is reserved, the first one that ends on the same edge.
    pub(super) reserved: Vec<Option<usize>>,
    /// Shapes and features for the learners.
    pub spec: EnvSpec,
    /// Whether SUMO could change the lane of a vehicle that it moves along its route.
    pub(super) several_lanes: bool,
    /// Where vehicles may drive, if they steer or see its borders.
    pub(super) road: Option<Road>,
    /// Where each route lies in junctions.
    pub(super) junctions: Vec<Vec<JunctionStretch>>,
    /// Corners of the net's bounding box: `[x_min, y_min, x_max, y_max]` \[m\].
    pub bounds: [f64; 4],
    net_file: std::path::PathBuf,
}

impl Task {
    /// Loads the net for `agents` vehicles and works out how its routes meet.
    ///
    /// # Errors
    /// When the scenario does not take so many agents, or its net cannot be read or driven.
    pub fn new(scenario: &Scenario, agents: u32) -> Result<Self, Error> {
        let choice = scenario.net_for(agents)?;
        let net = Net::load(&choice.file)?;
        let mut paths = Vec::with_capacity(scenario.routes.len());
        for route in &scenario.routes {
            paths.push(net.route_path_from(&route.edges, route.lane)?);
        }
        let routes = (0..paths.len())
            .map(|a| {
                let mut route = geometry(&paths, a, scenario.routes[a].arrival_pos);
                route.first_lane = paths[a].lanes.first().map_or(0, |&lane| net.lanes[lane].index);
                route
            })
            .collect::<Vec<_>>();
        let end = |route: &crate::scenario::Route| route.edges.last().cloned();
        let first = |route| scenario.routes.iter().position(|other| end(other) == end(route));
        let reserved = scenario.routes.iter().map(|route| first(route).filter(|_| route.reserved)).collect();
        let junctions = paths.iter().map(|path| junction_stretches(&net, path)).collect();
        let mut bounds = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
        for point in paths.iter().flat_map(|path| &path.points) {
            for axis in 0..2 {
                bounds[axis] = bounds[axis].min(point[axis]);
                bounds[axis + 2] = bounds[axis + 2].max(point[axis]);
            }
        }
        let lanes = |&lane: &usize| net.edges[net.lanes[lane].edge].lanes.len() > 1;
        let several_lanes = paths.iter().any(|path| path.lanes.iter().any(lanes));
        let (length, width) = (scenario.vehicle.length, scenario.vehicle.width);
        let border = scenario.termination.border;
        let needed = scenario.control.steering.is_some() || scenario.observation.lidar.beams > 0;
        let road = needed.then(|| Road::new(&net, length, width, border)).transpose()?;
        let spec = EnvSpec {
            agents: agents as usize,
            actions: if scenario.control.steering.is_some() { 2 } else { 1 },
            observation: observation::describe(scenario),
            state: state::describe(scenario),
        };
        Ok(Self {
            agents: agents as usize,
            fewest: agents as usize,
            places: choice.places().collect(),
            routes,
            reserved,
            several_lanes,
            road,
            junctions,
            spec,
            bounds,
            net_file: choice.file.clone(),
            scenario: scenario.clone(),
        })
    }

    /// The same with a random number of agents in each episode, from `fewest` (at least 1) to N.
    #[must_use]
    pub fn with_fewest(self, fewest: usize) -> Self {
        Self { fewest: fewest.clamp(1, self.agents), ..self }
    }

    /// The net.
    pub fn net_file(&self) -> &std::path::Path {
        &self.net_file
    }

    /// Where the front bumper of a vehicle on a route is that was last on one of the route's segments, `front` in metres, and its
    /// arc length along the route \[m\].
    pub fn locate(&self, route: usize, front: [f64; 2], segment: usize) -> (Place, f64) {
        let path = &self.routes[route].path;
        let (s, lateral, segment) = path.project(front, segment);
        let place = if lateral.abs() > path.widths[segment] / 2.0 {
            Place::Beside
        } else if self.junctions[route].iter().any(|k| (k.from..k.to).contains(&s)) {
            Place::Junction
        } else {
            Place::Road
        };
        (place, s)
    }

    /// What a simulation of `worlds` worlds of this task needs to start.
    pub fn simulation_config(&self, seed: u64, worlds: u32, hosting: &Hosting) -> SimulationConfig {
        let (vehicle, control) = (&self.scenario.vehicle, &self.scenario.control);
        let hardest = control.brake.last().map_or(control.drag, |point| point.1);
        let vehicle_type = |id: &str, min_gap: f64| VehicleType {
            id: id.to_owned(),
            length: vehicle.length,
            width: vehicle.width,
            max_speed: vehicle.max_speed,
            accel: control.accel,
            decel: hardest.min(4.5),
            emergency_decel: hardest,
            min_gap,
            tau: 1.0,
        };
        SimulationConfig {
            net: self.net_file.clone(),
            step_length: control.interval,
            seed,
            worlds,
            slots: self.agents as u32,
            timeout: hosting.timeout,
            audit: hosting.audit,
            // Agents may spawn as close as the places allow; SUMO's driver keeps a gap, but one that lets
            // vehicles depart from neighbouring places in the worst jitter.
            vehicle_types: vec![vehicle_type("agent", 0.0), vehicle_type("sumo_driver", 1.0)],
            routes: self
                .scenario
                .routes
                .iter()
                .zip(&self.routes)
                .map(|(route, geometry)| Route {
                    id: route.id.clone(),
                    edges: route.edges.clone(),
                    lane: geometry.first_lane,
                })
                .collect(),
        }
    }
}

fn junction_stretches(net: &Net, path: &Path) -> Vec<JunctionStretch> {
    let stretches = path.lane_stretches().filter_map(|(lane, from, to)| {
        let edge = &net.edges[net.lanes[lane].edge];
        if edge.function != EdgeFunction::Internal {
            return None;
        }
        // Internal edges are called after their junction: `:centre_2`.
        let name = edge.id.strip_prefix(':')?.rsplit_once('_')?.0;
        let unregulated = net.junctions.iter().any(|j| j.id == name && j.kind == "unregulated");
        Some(JunctionStretch { from, to, unregulated })
    });
    stretches.collect()
}
