//! The routes that background vehicles come to be on by changing lanes: for each lane of the edges
//! of a route, the rest of the route from that lane on.

use std::ops::RangeInclusive;

use super::agents::Slot;
use super::routes::RouteGeometry;
use crate::sumo::net::{EdgeFunction, Net, Path};

/// A lane of a route.
#[derive(Debug, Clone, Copy)]
struct Entry {
    /// Index into the net's lanes.
    lane: usize,
    /// Number of the edge on the route that the vehicle was given; within a junction, of the edge
    /// before.
    edge: usize,
    /// Index of the route along the lane.
    route: usize,
    /// Number of the lane on that route.
    nth: usize,
}

/// The routes by lane.
#[derive(Debug, Clone, Default)]
pub(super) struct LaneRoutes {
    /// Lanes by the route that a vehicle was given, those of this route itself first.
    of: Vec<Vec<Entry>>,
    /// For each route that was added, the route whose edges it uses.
    pub(super) like: Vec<usize>,
}

impl LaneRoutes {
    /// Works out the routes by lane of background vehicles that are given the routes `bases`, and
    /// appends the paths of those that are new. `edges` are the edges of the routes.
    pub(super) fn new(
        net: &Net,
        bases: &[usize],
        edges: &[Vec<String>],
        paths: &mut Vec<Path>,
    ) -> Self {
        let mut routes = Self { of: vec![Vec::new(); edges.len()], like: Vec::new() };
        for &base in bases {
            if !routes.of[base].is_empty() {
                continue;
            }
            let mut entries = entries_of(net, &paths[base], base, 0);
            for (k, id) in edges[base].iter().enumerate() {
                let edge = net.edge_index(id).map(|edge| net.carriageway(&net.edges[edge]));
                for lane in edge.into_iter().flatten() {
                    if entries.iter().any(|entry| (entry.lane, entry.edge) == (lane, k)) {
                        continue;
                    }
                    let Some(path) = net.route_path_on(&edges[base][k..], lane) else { continue };
                    let known = paths.iter().position(|other| other.lanes == path.lanes);
                    let route = known.unwrap_or(paths.len());
                    entries.extend(entries_of(net, &path, route, k));
                    if known.is_none() {
                        paths.push(path);
                        routes.like.push(base);
                    }
                }
            }
            routes.of[base] = entries;
        }
        routes
    }

    /// Returns the route along the lane on which SUMO reports the vehicle of a slot, and the segments
    /// of its path along the lane; `None` where the vehicle's present route uses the lane, or no
    /// route does.
    pub(super) fn change(
        &self,
        routes: &[RouteGeometry],
        slot: &Slot,
    ) -> Option<(usize, RangeInclusive<usize>)> {
        let (entries, lane) = (self.of.get(slot.assigned)?, slot.lane? as usize);
        let now = self.edge_of(routes, slot).unwrap_or(0);
        let here = entries.iter().filter(|entry| entry.lane == lane);
        let best =
            here.min_by_key(|entry| (entry.edge.abs_diff(now), entry.route != slot.route))?;
        if best.route == slot.route {
            return None;
        }
        let path = routes[best.route].lanes();
        let (_, from, to) = path.lane_stretches().nth(best.nth)?;
        let segment = |s: f64| path.locate(s).1;
        Some((best.route, segment(from + 1e-6)..=segment(to - 1e-6)))
    }

    /// Returns the number of the edge of its route on which the front of a vehicle is.
    fn edge_of(&self, routes: &[RouteGeometry], slot: &Slot) -> Option<usize> {
        let front = slot.s + slot.size[0] / 2.0;
        let path = routes[slot.route].lanes();
        let nth = path.lane_stretches().take_while(|(_, from, _)| *from <= front).count();
        let entries = self.of.get(slot.assigned)?;
        let here = |entry: &&Entry| entry.route == slot.route && entry.nth + 1 == nth;
        entries.iter().find(here).map(|entry| entry.edge)
    }
}

/// Returns the lanes of a route whose first edge has this number.
fn entries_of(net: &Net, path: &Path, route: usize, first: usize) -> Vec<Entry> {
    let mut edge = first;
    let entry = |(nth, &lane): (usize, &usize)| {
        let road = net.edges[net.lanes[lane].edge].function == EdgeFunction::Normal;
        edge += usize::from(road && nth > 0);
        Entry { lane, edge, route, nth }
    };
    path.lanes.iter().enumerate().map(entry).collect()
}
