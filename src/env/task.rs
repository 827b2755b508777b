//! A scenario made ready for one number of agents: its net, routes, spawn places and feature lists.

use std::ops::Range;

use super::geometry::Size;
use super::intention::Forks;
use super::pursuit::way_around;
use super::road::Road;
use super::routes::{RouteGeometry, geometry};
use super::{ActionDimension, EnvSpec, Error, observation, state};
use crate::scenario::{Control, Demand, Laid, Scenario, Source, SpawnPlace, VehicleKind};
use crate::sumo::net::{EdgeFunction, Net, Path};
use crate::sumo::{Departure, Hosting, Others, Route, SimulationConfig, VehicleType};

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
    /// Slots of vehicles that SUMO drives, which come after the agents'.
    pub others: usize,
    /// Each episode has a random number of agents from this one to N.
    pub fewest: usize,
    /// Spawn places, at least as many as vehicles that start at them.
    pub places: Vec<SpawnPlace>,
    /// Routes in the scenario's order, then those that only route files have.
    pub routes: Vec<RouteGeometry>,
    /// Their ids and edges.
    pub(super) route_ids: Vec<String>,
    route_edges: Vec<Vec<String>>,
    /// What route files say.
    pub(super) demand: Demand,
    /// The files' routes, as indices into `routes`.
    pub(super) demand_routes: Vec<usize>,
    /// Of those that are walked, where on the first edge they begin and where on the last they end \[m\].
    walk_ends: Vec<Option<[f64; 2]>>,
    /// Types of those at spawn places that SUMO drives, and their weights; empty: as the agents'.
    pub(super) place_mix: Vec<(usize, f64)>,
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
    /// Which routes begin alike, and where they part.
    pub(super) forks: Forks,
    /// Corners of the net's bounding box: `[x_min, y_min, x_max, y_max]` \[m\].
    pub bounds: [f64; 4],
    net_file: std::path::PathBuf,
}

impl Task {
    /// Loads the net for so many `vehicles` at spawn places, of which the scenario's share are agents, and works out how its
    /// routes meet.
    ///
    /// # Errors
    /// When the scenario does not take so many, or its net or route files cannot be read or driven.
    pub fn new(scenario: &Scenario, vehicles: u32) -> Result<Self, Error> {
        let choice = scenario.net_for(vehicles)?;
        let agents = scenario.traffic.learners(vehicles);
        let demand = Demand::load(&scenario.traffic.files)?;
        let place_mix =
            scenario.traffic.kind.as_ref().and_then(|kind| demand.mix(kind)).unwrap_or_default();
        let capacity = if demand.sources.is_empty() { 0 } else { scenario.traffic.capacity };
        let net = Net::load(&choice.file)?;
        let mut paths = Vec::with_capacity(scenario.routes.len());
        for route in &scenario.routes {
            paths.push(net.route_path_from(&route.edges, route.lane)?);
        }
        let mut route_ids: Vec<String> =
            scenario.routes.iter().map(|route| route.id.clone()).collect();
        let mut route_edges: Vec<Vec<String>> =
            scenario.routes.iter().map(|route| route.edges.clone()).collect();
        let mut demand_routes = Vec::with_capacity(demand.routes.len());
        let mut walk_ends = Vec::with_capacity(demand.routes.len());
        for route in &demand.routes {
            let Laid { path, edges, walk } = route.lay(&net)?;
            // Walks have no lanes, but edges and sides of them.
            let same = |(other, at): (&Path, &Vec<String>)| {
                other.lanes == path.lanes
                    && (walk.is_none() || *at == edges && other.points == path.points)
            };
            let known = paths.iter().zip(&route_edges).position(same);
            walk_ends.push(walk);
            demand_routes.push(known.unwrap_or(paths.len()));
            if known.is_none() {
                paths.push(path);
                route_ids.push(format!("{} of a route file", route.id));
                route_edges.push(edges);
            }
        }
        let mut ways = paths.clone();
        let mut detoured = vec![false; paths.len()];
        if let Some(steering) = &scenario.control.steering {
            for (way, detoured) in ways.iter_mut().zip(&mut detoured) {
                if let Some(around) = way_around(way, steering) {
                    (*way, *detoured) = (around, true);
                }
            }
        }
        let routes = (0..paths.len())
            .map(|a| {
                // Vehicles of route files arrive where SUMO takes them off the road: at the end.
                let arrival = scenario.routes.get(a).map(|route| route.arrival_pos);
                let mut route = geometry(
                    &ways,
                    &detoured,
                    a,
                    arrival.unwrap_or(-1.0),
                    [scenario.vehicle.length, scenario.vehicle.width],
                );
                if arrival.is_none() {
                    route.arrival = ways[a].length();
                }
                if let Some(&last) = paths[a].lanes.last() {
                    let lanes = net.carriageway(&net.edges[net.lanes[last].edge]);
                    let beside =
                        |lanes: Range<usize>| lanes.map(|lane| net.lanes[lane].width).sum::<f64>();
                    // Lanes are counted from the right.
                    route.finish[0] -= beside(lanes.start..last);
                    route.finish[1] += beside(last + 1..lanes.end);
                }
                route.avoided = detoured[a].then(|| paths[a].clone());
                route.first_lane = paths[a].lanes.first().map_or(0, |&lane| net.lanes[lane].index);
                route
            })
            .collect::<Vec<_>>();
        let forks = Forks::new(&net, &routes);
        let end = |route: &crate::scenario::Route| route.edges.last().cloned();
        let first = |route| scenario.routes.iter().position(|other| end(other) == end(route));
        let reserved =
            scenario.routes.iter().map(|route| first(route).filter(|_| route.reserved)).collect();
        let junctions = paths.iter().map(|path| junction_stretches(&net, path)).collect();
        let mut bounds = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
        for point in paths.iter().flat_map(|path| &path.points) {
            for axis in 0..2 {
                bounds[axis] = bounds[axis].min(point[axis]);
                bounds[axis + 2] = bounds[axis + 2].max(point[axis]);
            }
        }
        let lanes = |&lane: &usize| net.carriageway(&net.edges[net.lanes[lane].edge]).len() > 1;
        let several_lanes = paths.iter().any(|path| path.lanes.iter().any(lanes));
        let (length, width) = (scenario.vehicle.length, scenario.vehicle.width);
        let needed = scenario.control.steering.is_some()
            || scenario.observation.lidar.beams > 0
            || scenario.observation.borders > 0.0;
        let road =
            needed.then(|| Road::new(&net, [length, width], &scenario.termination)).transpose()?;
        let spec = EnvSpec {
            agents: agents as usize,
            actions: actions(&scenario.control),
            observation: observation::describe(scenario),
            state: state::describe(scenario),
        };
        Ok(Self {
            agents: agents as usize,
            others: (vehicles - agents + capacity) as usize,
            fewest: agents as usize,
            places: choice.places().collect(),
            routes,
            route_ids,
            route_edges,
            place_mix,
            demand_routes,
            walk_ends,
            demand,
            reserved,
            several_lanes,
            road,
            junctions,
            forks,
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

    /// Slots of a world: agents and others.
    pub(super) fn slots(&self) -> usize {
        self.agents + self.others
    }

    /// Vehicles at spawn places that SUMO drives.
    pub(super) fn placed(&self) -> usize {
        let capacity = if self.demand.sources.is_empty() {
            0
        } else {
            self.scenario.traffic.capacity as usize
        };
        self.others - capacity
    }

    /// Vehicle type, in SUMO's list, and size of a type of the route files.
    pub(super) fn demand_type(&self, kind: usize) -> (u32, Size) {
        let VehicleKind { length, width, .. } = self.demand.types[kind];
        (SUMO_TYPE + 1 + kind as u32, [length, width])
    }

    /// As [`Task::demand_type`], of a vehicle at a spawn place, drawn from `place_mix`.
    pub(super) fn place_type(&self, kind: usize) -> (u32, Size) {
        if self.place_mix.is_empty() {
            let vehicle = &self.scenario.vehicle;
            return (SUMO_TYPE, [vehicle.length, vehicle.width]);
        }
        self.demand_type(kind)
    }

    /// What a route is called: its id, or that of a route file.
    pub fn route_id(&self, route: usize) -> &str {
        &self.route_ids[route]
    }

    /// The net.
    pub fn net_file(&self) -> &std::path::Path {
        &self.net_file
    }

    /// Where the front bumper of a vehicle on a route is that was last on one of its way's segments, `front` in metres, and its
    /// arc length along the route's lanes \[m\].
    pub fn locate(&self, route: usize, front: [f64; 2], segment: usize) -> (Place, f64) {
        let geometry = &self.routes[route];
        let path = geometry.lanes();
        let (s, lateral, segment) = match geometry.avoided {
            None => path.project(front, segment),
            // The way's segments are not those of the lanes.
            Some(_) => path.nearest(front),
        };
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
            slots: self.slots() as u32,
            others: (self.others > 0).then(|| self.guests()),
            timeout: hosting.timeout,
            audit: hosting.audit,
            // Agents may spawn as close as the places allow; SUMO's driver keeps a gap, but one that lets
            // vehicles depart from neighbouring places in the worst jitter.
            vehicle_types: vec![vehicle_type("agent", 0.0), vehicle_type("sumo_driver", 1.0)],
            routes: (self.route_ids.iter().zip(&self.route_edges).zip(&self.routes))
                .map(|((id, edges), geometry)| Route {
                    id: id.clone(),
                    edges: edges.clone(),
                    lane: geometry.first_lane,
                    walked: geometry.is_walked(),
                })
                .collect(),
        }
    }

    /// What SUMO must know of the vehicles that it drives.
    fn guests(&self) -> Others {
        let departure = |source: &Source| {
            let route = self.demand_routes[source.route] as u32;
            if let Some([pos, arrival]) = self.walk_ends[source.route] {
                return Departure::Walk { route, pos, arrival };
            }
            let crate::scenario::Start { lane, pos, speed } = source.start.clone();
            Departure::Drive { route, lane, pos, speed }
        };
        Others {
            first_slot: self.agents as u32,
            definitions: self.demand.definitions.clone(),
            types: self.demand.types.iter().map(|kind| kind.id.clone()).collect(),
            departures: self.demand.sources.iter().map(departure).collect(),
        }
    }
}

/// The agents' actions: steering, where vehicles steer, then throttle and brake.
///
/// A vehicle whose mean throttle is 0 hardly moves under noise, as brakes are stronger than
/// engines, so untrained policies accelerate. To stay on the road takes a steadier hand than to
/// find a speed: steering has less noise, and a wheel that is held wrong for long leads off the
/// road, so its noise is independent from step to step.
fn actions(control: &Control) -> Vec<ActionDimension> {
    let steer =
        ActionDimension { noise_scale: 0.37, correlated: false, ..ActionDimension::named("steer") };
    let throttle = ActionDimension {
        initial_mean: control.initial_throttle as f32,
        ..ActionDimension::named("throttle")
    };
    if control.steering.is_some() { vec![steer, throttle] } else { vec![throttle] }
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
