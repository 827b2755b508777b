//! What the net says: routes, their paths and conflicts, junctions, and the road's surface. No
//! episode changes it.

use std::ops::Range;
use std::path::PathBuf;

use rayon::prelude::*;

use super::agents::Slot;
use super::detour::path_around;
use super::forks::Forks;
use super::geometry::Size;
use super::lane_routes::LaneRoutes;
use super::levels::Levels;
use super::occlusion::Walls;
use super::road::Road;
use super::routes::{RouteGeometry, geometry};
use super::signals::TrafficLights;
use crate::env::error::Error;
use crate::scenario::{Demand, DemandPlan, LaneChange, Occlusion, Scenario};
use crate::sumo::net::{EdgeFunction, Foes, Net, Path};

/// A part of a route that lies in a junction.
#[derive(Debug, Clone, Copy)]
pub(super) struct JunctionStretch {
    /// Beginning of the part, as arc length along the route \[m\].
    pub(super) from: f64,
    /// End of the part, as arc length along the route \[m\].
    pub(super) to: f64,
    /// Whether SUMO does not look for collisions in the junction, because of its type.
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

/// The net and the routes of a task.
#[derive(Debug, Clone)]
pub struct Map {
    /// Routes: the scenario's in its order, then those that occur only in route files.
    pub routes: Vec<RouteGeometry>,
    /// Corners of the bounding box of all routes: `[x_min, y_min, x_max, y_max]` \[m\].
    pub bounds: [f64; 4],
    /// Number of the routes that vehicles are given; those behind them lie on other lanes of the
    /// same edges, and vehicles come to be on them by changing lanes.
    pub(super) given: usize,
    /// The routes by lane, for vehicles that may change lanes.
    pub(super) lane_routes: LaneRoutes,
    /// For each route, the position at which its first lane change has to be complete, as arc length
    /// along its lanes \[m\]; infinite if it needs none.
    pub(super) lane_change: Vec<f64>,
    /// Ids of the routes.
    pub(super) route_ids: Vec<String>,
    /// Edges of the routes.
    pub(super) route_edges: Vec<Vec<String>>,
    /// Time that each route takes at the speed limits of lanes and vehicle \[s\].
    pub(super) free_time: Vec<f64>,
    /// The departures of vehicles and persons of the route files. Their routes are indices into
    /// [`Map::routes`].
    pub(super) plan: DemandPlan,
    /// Parts of each route that lie in junctions.
    pub(super) junctions: Vec<Vec<JunctionStretch>>,
    /// Traffic lights that rule the routes.
    pub traffic_lights: TrafficLights,
    /// Lanes that SUMO compares when it looks for collisions.
    pub(super) foes: Foes,
    /// Which routes begin alike, and where they part.
    pub(super) forks: Forks,
    /// Whether some route has edges with several lanes, so that SUMO could change the lane of a
    /// vehicle on it.
    pub(super) several_lanes: bool,
    /// Polygons that block sight and radio; none, if the scenario has none.
    pub(crate) walls: Walls,
    /// The road surface, if agents steer, have a lidar or observe the road's borders.
    road: Option<Road>,
    net_file: PathBuf,
}

impl Map {
    /// Loads a net and works out the paths of the routes of `scenario` and `demand`, and their
    /// conflicts.
    ///
    /// # Errors
    /// If the net cannot be read, or its routes cannot be driven.
    pub(super) fn new(
        scenario: &Scenario,
        demand: &Demand,
        net_file: &std::path::Path,
    ) -> Result<Self, Error> {
        let net = Net::load(net_file)?;
        let mut lanes = Vec::with_capacity(scenario.routes.len());
        for route in &scenario.routes {
            lanes.push(scenario.route_path(&net, route)?);
        }
        let mut route_ids: Vec<String> =
            scenario.routes.iter().map(|route| route.id.clone()).collect();
        let mut route_edges: Vec<Vec<String>> =
            scenario.routes.iter().map(|route| route.edges.clone()).collect();
        let mut plan = scenario.plan(demand, &net)?;
        let mut places = Vec::with_capacity(plan.routes.len());
        for laid in std::mem::take(&mut plan.routes) {
            let same = |(path, edges): (&Path, &Vec<String>)| laid.is_same(path, edges);
            let known = lanes.iter().zip(&route_edges).position(same);
            places.push(known.unwrap_or(lanes.len()));
            if known.is_none() {
                lanes.push(laid.path);
                // Routes of a distribution, and parts of a route, have one id.
                let mut names = (2..).map(|nth| format!("{} ({nth}) of a route file", laid.id));
                let mut id = format!("{} of a route file", laid.id);
                while route_ids.contains(&id) {
                    id = names.next().unwrap_or(id);
                }
                route_ids.push(id);
                route_edges.push(laid.edges);
            }
        }
        for departure in &mut plan.departures {
            departure.route = places[departure.route];
        }
        let given = lanes.len();
        let mut bases: Vec<usize> = Vec::new();
        let agents_change = scenario.control.lane_change != LaneChange::None;
        if scenario.traffic.penetration < 1.0 || agents_change {
            bases.extend(0..scenario.routes.len());
        }
        let driven = plan.departures.iter().filter(|departure| departure.walk.is_none());
        bases.extend(driven.map(|departure| departure.route));
        // Vehicles of route files arrive where SUMO removes them: at the end of the route.
        let mut finish: Vec<Option<f64>> =
            scenario.routes.iter().map(|route| Some(route.arrival_pos)).collect();
        finish.resize(given, None);
        // Background vehicles arrive nowhere, so that they share routes by lane.
        let shared = vec![None; given];
        let of_lanes = if agents_change { &finish } else { &shared };
        let lane_routes = LaneRoutes::new(&net, &bases, &route_edges, of_lanes, &mut lanes);
        for &route in &lane_routes.like {
            route_ids.push(route_ids[route].clone());
            route_edges.push(route_edges[route].clone());
            finish.push(finish[route].filter(|_| agents_change));
        }
        let size = [scenario.vehicle.length, scenario.vehicle.width];
        let routes = lay_routes(&net, scenario, &lanes, &finish, size);
        let several = |&lane: &usize| net.carriageway(&net.edges[net.lanes[lane].edge]).len() > 1;
        let road_is_needed = scenario.control.steering.is_some()
            || scenario.observation.lidar.beams > 0
            || scenario.observation.borders > 0.0;
        let road = road_is_needed.then(|| Road::new(&net, size, &scenario.termination));
        let polygons = scenario.occlusion.as_ref().map(Occlusion::polygons).transpose()?;
        Ok(Self {
            walls: Walls::new(polygons.unwrap_or_default()),
            foes: net.foes.clone(),
            traffic_lights: TrafficLights::new(&net, &lanes, &routes),
            forks: Forks::new(&net, &routes),
            bounds: bounds(&lanes),
            free_time: lanes.iter().map(|path| free_time(&net, scenario, path)).collect(),
            junctions: lanes.iter().map(|path| junction_stretches(&net, path)).collect(),
            given,
            lane_change: (lanes.iter())
                .map(|path| path.lane_changes(&net).next().unwrap_or(f64::INFINITY))
                .collect(),
            lane_routes,
            several_lanes: lanes.iter().any(|path| path.lanes.iter().any(several)),
            road: road.transpose()?,
            net_file: net_file.to_owned(),
            routes,
            route_ids,
            route_edges,
            plan,
        })
    }

    /// Returns the road surface.
    ///
    /// # Panics
    /// If agents neither steer nor have a lidar nor observe the road's borders.
    pub(super) fn road(&self) -> &Road {
        self.road.as_ref().expect("the task needs the road surface")
    }

    /// Returns the name of a route: the scenario's id, or the id in a route file with a note that
    /// it is from there.
    pub fn route_id(&self, route: usize) -> &str {
        &self.route_ids[route]
    }

    /// Returns the ids of a route's edges.
    pub fn route_edges(&self, route: usize) -> &[String] {
        &self.route_edges[route]
    }

    /// Returns the path of the net's file.
    pub fn net_file(&self) -> &std::path::Path {
        &self.net_file
    }

    /// Returns whether the front of a vehicle is still on its lane after it has driven `distance`
    /// metres.
    pub(super) fn stays_on_lane(&self, slot: &Slot, distance: f64) -> bool {
        let front = slot.s + slot.size[0] / 2.0;
        let mut stretches = self.routes[slot.route].lanes().lane_stretches();
        stretches.any(|(lane, from, to)| {
            Some(lane as u32) == slot.lane
                && (from..to).contains(&(front + distance))
                && from <= front
        })
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
}

/// Works out the routes along `lanes` with the finish lines `finish` on their last edges; `None`: at
/// the end.
fn lay_routes(
    net: &Net,
    scenario: &Scenario,
    lanes: &[Path],
    finish: &[Option<f64>],
    size: Size,
) -> Vec<RouteGeometry> {
    let detour = |path: &Path| path_around(path, &scenario.control.steering?);
    let (mut driven, mut detoured) = (lanes.to_vec(), vec![false; lanes.len()]);
    for (path, detoured) in driven.iter_mut().zip(&mut detoured) {
        if let Some(around) = detour(path) {
            (*path, *detoured) = (around, true);
        }
    }
    let levels = Levels::new(net);
    let lay = |a: usize| {
        let arrival = finish[a];
        let mut route = geometry(&levels, &driven, &detoured, a, arrival.unwrap_or(-1.0), size);
        if arrival.is_none() {
            route.arrival = driven[a].length();
        }
        if let Some(&last) = lanes[a].lanes.last() {
            let all = net.carriageway(&net.edges[net.lanes[last].edge]);
            let width = |lanes: Range<usize>| lanes.map(|lane| net.lanes[lane].width).sum::<f64>();
            // Lanes are counted from the right, in left-hand nets from the left.
            let [mut right, mut left] = [width(all.start..last), width(last + 1..all.end)];
            if net.left_hand {
                std::mem::swap(&mut right, &mut left);
            }
            route.finish[0] -= right;
            route.finish[1] += left;
        }
        route.avoided = detoured[a].then(|| lanes[a].clone());
        route.first_lane = lanes[a].lanes.first().map_or(0, |&lane| net.lanes[lane].index);
        route
    };
    (0..lanes.len()).into_par_iter().map(lay).collect()
}

fn free_time(net: &Net, scenario: &Scenario, path: &Path) -> f64 {
    let time = |&lane: &usize| {
        let speed = net.lanes[lane].speed.min(scenario.vehicle.max_speed).max(0.1);
        net.lanes[lane].length / speed
    };
    path.lanes.iter().map(time).sum()
}

fn bounds(paths: &[Path]) -> [f64; 4] {
    let mut bounds = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
    for point in paths.iter().flat_map(|path| &path.points) {
        for axis in 0..2 {
            bounds[axis] = bounds[axis].min(point[axis]);
            bounds[axis + 2] = bounds[axis + 2].max(point[axis]);
        }
    }
    bounds
}

fn junction_stretches(net: &Net, path: &Path) -> Vec<JunctionStretch> {
    let stretches = path.lane_stretches().filter_map(|(lane, from, to)| {
        let edge = &net.edges[net.lanes[lane].edge];
        if edge.function != EdgeFunction::Internal {
            return None;
        }
        // An internal edge's id begins with that of its junction, as in `:centre_2`.
        let name = edge.id.strip_prefix(':')?.rsplit_once('_')?.0;
        let unregulated = net.junctions.iter().any(|j| j.id == name && j.is_unregulated());
        Some(JunctionStretch { from, to, unregulated })
    });
    stretches.collect()
}
