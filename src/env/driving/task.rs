//! A scenario made ready for one number of agents: its net, routes, spawn places and feature
//! lists.

use std::ops::Range;

use super::geometry::Size;
use super::intention::Forks;
use super::pursuit::path_around;
use super::road::Road;
use super::routes::{RouteGeometry, geometry};
use super::{ActionDimension, EnvSpec, Error, observation, state};
use crate::scenario::{Control, Demand, Laid, Scenario, Source, SpawnPlace, VehicleKind};
use crate::sumo::net::{EdgeFunction, Net, Path};
use crate::sumo::{BackgroundTraffic, Departure, Hosting, Route, SimulationConfig, VehicleType};

/// Index of the agents' vehicle type in [`SimulationConfig::vehicle_types`].
pub(super) const AGENT_TYPE: u32 = 0;
/// Index of the vehicle type whose speed SUMO's own driver chooses.
pub(super) const SUMO_TYPE: u32 = 1;

/// A part of a route that lies in a junction.
#[derive(Debug, Clone, Copy)]
pub(super) struct JunctionStretch {
    /// Beginning of the part, as arc length along the route \[m\].
    pub(super) from: f64,
    /// End of the part, as arc length along the route \[m\].
    pub(super) to: f64,
    /// Whether the junction is of SUMO's type `unregulated`, in which SUMO does not look for
    /// collisions.
    pub(super) unregulated: bool,
}

/// Where a vehicle is relative to its route.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RoutePosition {
    /// On a lane of its route, on a road.
    Road,
    /// On a lane of its route, over a junction.
    Junction,
    /// Beside the lanes of its route.
    Beside,
}

impl RoutePosition {
    /// Bits for `moveToXY` by which SUMO finds the lane of the vehicle. 1 searches the edges of
    /// the vehicle's route, which is three times as fast but never finds a lane over a junction
    /// (SUMO 1.15). 2 takes the exact place, on any lane or on none.
    pub fn keep_route(self) -> u8 {
        if self == Self::Road { 1 } else { 2 }
    }
}

/// Everything about a task that is the same in all episodes; shared by all worlds.
#[derive(Debug, Clone)]
pub struct Task {
    /// The scenario.
    pub scenario: Scenario,
    /// Agent slots N.
    pub agents: usize,
    /// Slots of background traffic, which come after the agents' slots.
    pub others: usize,
    /// Least number of agents in an episode: each episode has a random number from this one to N.
    pub fewest: usize,
    /// Spawn places, at least as many as vehicles that start at spawn places.
    pub places: Vec<SpawnPlace>,
    /// Routes: the scenario's in its order, then those that occur only in route files.
    pub routes: Vec<RouteGeometry>,
    /// Ids of the routes.
    pub(super) route_ids: Vec<String>,
    /// Edges of the routes.
    route_edges: Vec<Vec<String>>,
    /// Contents of the route files.
    pub(super) demand: Demand,
    /// Routes of the route files, as indices into `routes`.
    pub(super) demand_routes: Vec<usize>,
    /// Where each walk of the route files begins on its first edge and where it ends on its last
    /// edge \[m\]; `None` for routes of vehicles.
    walk_ends: Vec<Option<[f64; 2]>>,
    /// Vehicle types of the background traffic at spawn places, with their weights; empty if these
    /// vehicles have the agents' size and abilities.
    pub(super) place_mix: Vec<(usize, f64)>,
    /// For every route with a reserved destination, the first route that ends on the same edge.
    pub(super) reserved: Vec<Option<usize>>,
    /// Shapes and features for the learners.
    pub spec: EnvSpec,
    /// Whether some route has edges with several lanes, so that SUMO could change the lane of a
    /// vehicle on it.
    pub(super) several_lanes: bool,
    /// The road surface, if agents steer, have a lidar or observe the road's borders.
    pub(super) road: Option<Road>,
    /// Parts of each route that lie in junctions.
    pub(super) junctions: Vec<Vec<JunctionStretch>>,
    /// Which routes begin alike, and where they part.
    pub(super) forks: Forks,
    /// Corners of the bounding box of all routes: `[x_min, y_min, x_max, y_max]` \[m\].
    pub bounds: [f64; 4],
    net_file: std::path::PathBuf,
}

impl Task {
    /// Loads the net for `vehicles` vehicles at spawn places, of which the scenario's share are
    /// agents, and works out the conflicts between the routes.
    ///
    /// # Errors
    /// If the scenario does not take this number of vehicles, or if its net or route files cannot
    /// be read or driven.
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
            // The paths of walks have no lanes, so that walks are compared by edges and points.
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
        let mut driven = paths.clone();
        let mut detoured = vec![false; paths.len()];
        if let Some(steering) = &scenario.control.steering {
            for (path, detoured) in driven.iter_mut().zip(&mut detoured) {
                if let Some(around) = path_around(path, steering) {
                    (*path, *detoured) = (around, true);
                }
            }
        }
        let routes = (0..paths.len())
            .map(|a| {
                // Vehicles of route files arrive where SUMO removes them: at the end of the route.
                let arrival = scenario.routes.get(a).map(|route| route.arrival_pos);
                let mut route = geometry(
                    &driven,
                    &detoured,
                    a,
                    arrival.unwrap_or(-1.0),
                    [scenario.vehicle.length, scenario.vehicle.width],
                );
                if arrival.is_none() {
                    route.arrival = driven[a].length();
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

    /// Returns the same task with a random number of agents in each episode, from `fewest` (at
    /// least 1) to N.
    #[must_use]
    pub fn with_fewest(self, fewest: usize) -> Self {
        Self { fewest: fewest.clamp(1, self.agents), ..self }
    }

    /// Returns the number of slots of a world: those of agents and of background traffic.
    pub(super) fn slots(&self) -> usize {
        self.agents + self.others
    }

    /// Returns the number of background vehicles that start at spawn places.
    pub(super) fn placed(&self) -> usize {
        let capacity = if self.demand.sources.is_empty() {
            0
        } else {
            self.scenario.traffic.capacity as usize
        };
        self.others - capacity
    }

    /// Returns the index in SUMO's list and the size of vehicle type number `kind` of the route
    /// files.
    pub(super) fn demand_type(&self, kind: usize) -> (u32, Size) {
        let VehicleKind { length, width, .. } = self.demand.types[kind];
        (SUMO_TYPE + 1 + kind as u32, [length, width])
    }

    /// Returns the index in SUMO's list and the size of a vehicle type for background traffic at
    /// spawn places; `kind` is drawn from `place_mix`.
    pub(super) fn place_type(&self, kind: usize) -> (u32, Size) {
        if self.place_mix.is_empty() {
            let vehicle = &self.scenario.vehicle;
            return (SUMO_TYPE, [vehicle.length, vehicle.width]);
        }
        self.demand_type(kind)
    }

    /// Returns the name of a route: the scenario's id, or the id in a route file with a note that
    /// it is from there.
    pub fn route_id(&self, route: usize) -> &str {
        &self.route_ids[route]
    }

    /// Returns the path of the net's file.
    pub fn net_file(&self) -> &std::path::Path {
        &self.net_file
    }

    /// Returns where the front bumper of a vehicle is relative to its route, and the front's arc
    /// length along the route's lanes \[m\]. `front` is in the world's coordinates \[m\], and
    /// `segment` is the segment of the route's path on which the vehicle was last.
    pub fn locate(&self, route: usize, front: [f64; 2], segment: usize) -> (RoutePosition, f64) {
        let geometry = &self.routes[route];
        let path = geometry.lanes();
        let (s, lateral, segment) = match geometry.avoided {
            None => path.project(front, segment),
            // The segments of a path with a detour are not those of the lanes.
            Some(_) => path.nearest(front),
        };
        let place = if lateral.abs() > path.widths[segment] / 2.0 {
            RoutePosition::Beside
        } else if self.junctions[route].iter().any(|k| (k.from..k.to).contains(&s)) {
            RoutePosition::Junction
        } else {
            RoutePosition::Road
        };
        (place, s)
    }

    /// Returns what a simulation of `worlds` worlds of this task needs to start.
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
            others: (self.others > 0).then(|| self.road_users()),
            timeout: hosting.timeout,
            audit: hosting.audit,
            // Agents may spawn as close to each other as the places allow. SUMO's driver keeps a
            // gap, but one that is small enough for vehicles to depart from neighbouring places
            // under the largest jitter.
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

    /// Returns what SUMO needs to know about background traffic.
    fn road_users(&self) -> BackgroundTraffic {
        let departure = |source: &Source| {
            let route = self.demand_routes[source.route] as u32;
            if let Some([pos, arrival]) = self.walk_ends[source.route] {
                return Departure::Walk { route, pos, arrival };
            }
            let crate::scenario::Start { lane, pos, speed } = source.start.clone();
            Departure::Drive { route, lane, pos, speed }
        };
        BackgroundTraffic {
            first_slot: self.agents as u32,
            definitions: self.demand.definitions.clone(),
            types: self.demand.types.iter().map(|kind| kind.id.clone()).collect(),
            departures: self.demand.sources.iter().map(departure).collect(),
        }
    }
}

/// Returns the dimensions of the agents' actions: steering, if vehicles steer, then throttle and
/// brake.
///
/// Untrained policies accelerate on average: brakes are stronger than engines, so that a vehicle
/// with a mean throttle of 0 hardly moves under noise.
fn actions(control: &Control) -> Vec<ActionDimension> {
    let steer = ActionDimension::named("steer");
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
        // An internal edge's id begins with that of its junction, as in `:centre_2`.
        let name = edge.id.strip_prefix(':')?.rsplit_once('_')?.0;
        let unregulated = net.junctions.iter().any(|j| j.id == name && j.kind == "unregulated");
        Some(JunctionStretch { from, to, unregulated })
    });
    stretches.collect()
}
