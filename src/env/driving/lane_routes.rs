//! The routes that vehicles come to be on by changing lanes: for each lane of the edges of a route,
//! the rest of the route from that lane on.

use super::agents::Slot;
use super::routes::RouteGeometry;
use crate::sumo::Body;
use crate::sumo::net::{Classes, EdgeFunction, Net, Path};

/// A side of a vehicle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Side {
    Left,
    Right,
}

/// A lane of the net.
#[derive(Debug, Clone, Copy)]
struct NetLane {
    /// Index into the net's edges.
    edge: usize,
    /// SUMO's index on the edge.
    index: u32,
    classes: Classes,
    /// Whether the lane is outside of junctions.
    road: bool,
}

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
    /// The net's lanes.
    lanes: Vec<NetLane>,
    /// Whether lanes are counted from the left.
    left_hand: bool,
    are_used: bool,
}

impl LaneRoutes {
    /// Works out the routes by lane of vehicles that are given the routes `bases`, and appends the
    /// paths of those that are new. `edges` are the edges of the routes, and `finish` are their finish
    /// lines: routes share a route by lane only if they have the same.
    pub(super) fn new(
        net: &Net,
        bases: &[usize],
        edges: &[Vec<String>],
        finish: &[Option<f64>],
        paths: &mut Vec<Path>,
    ) -> Self {
        let lane = |lane: &crate::sumo::net::Lane| NetLane {
            edge: lane.edge,
            index: lane.index,
            classes: lane.classes,
            road: net.edges[lane.edge].function == EdgeFunction::Normal,
        };
        let mut routes = Self {
            of: vec![Vec::new(); edges.len()],
            like: Vec::new(),
            lanes: net.lanes.iter().map(lane).collect(),
            left_hand: net.left_hand,
            are_used: false,
        };
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
                    let same = |(other, known): (usize, &Path)| {
                        let base_of = other.checked_sub(edges.len()).map(|k| routes.like[k]);
                        known.lanes == path.lanes
                            && finish[base_of.unwrap_or(other)] == finish[base]
                    };
                    let known = paths.iter().enumerate().position(same);
                    let route = known.unwrap_or(paths.len());
                    entries.extend(entries_of(net, &path, route, k));
                    if known.is_none() {
                        paths.push(path);
                        routes.like.push(base);
                    }
                }
            }
            routes.are_used |= entries.iter().any(|entry| entry.route != base);
            routes.of[base] = entries;
        }
        routes
    }

    /// Whether some vehicles may come to be on other routes by changing lanes.
    pub(super) fn are_used(&self) -> bool {
        self.are_used
    }

    /// Puts the vehicle of a slot on the lane that SUMO reports. Returns position on the route's
    /// lanes \[m\], lateral offset \[m\] and segment of its front if its route is now another, the one
    /// along the lane; `None` where the vehicle's route uses the lane, or no route does.
    pub(super) fn follow(
        &self,
        routes: &[RouteGeometry],
        slot: &mut Slot,
        body: &Body,
    ) -> Option<(f64, f64, usize)> {
        if slot.lane == body.lane {
            return None;
        }
        slot.lane = body.lane;
        let best = self.entry(routes, slot, body.lane? as usize)?;
        if best.route == slot.route {
            return None;
        }
        slot.route = best.route;
        let path = routes[best.route].lanes();
        let (_, from, to) = path.lane_stretches().nth(best.nth)?;
        let segment = |s: f64| path.locate(s).1;
        let (first, last) = (segment(from + 1e-6), segment(to - 1e-6));
        Some(path.nearest_of([body.x, body.y], first..last + 1))
    }

    /// Returns whether two lanes belong to one edge outside of junctions. Lanes are indices into the
    /// net's.
    pub(super) fn are_beside(&self, a: u32, b: u32) -> bool {
        let [a, b] = [a, b].map(|lane| self.lanes[lane as usize]);
        a.edge == b.edge && a.road
    }

    /// Returns the lane on a side of an agent, as an index into the net's lanes, and SUMO's index of
    /// it on its edge; `None` where there is none that the agent may use, and within junctions.
    pub(super) fn beside(&self, slot: &Slot, side: Side) -> Option<(usize, u32)> {
        let lane = slot.lane? as usize;
        let own = self.lanes[lane];
        let up = (side == Side::Left) != self.left_hand;
        let other = if up { lane + 1 } else { lane.checked_sub(1)? };
        let there = self.lanes.get(other)?;
        let open = own.road && there.edge == own.edge && there.classes.contain(slot.class);
        open.then_some((other, there.index))
    }

    /// Returns the route along the lane on a side of an agent, and the position of the agent's centre
    /// on it \[m\]; `None` as [`LaneRoutes::beside`].
    pub(super) fn route_beside(
        &self,
        routes: &[RouteGeometry],
        slot: &Slot,
        side: Side,
    ) -> Option<(usize, f64)> {
        let (lane, _) = self.beside(slot, side)?;
        let own = self.entry(routes, slot, slot.lane? as usize)?;
        let other = self.entry(routes, slot, lane)?;
        let start = |entry: &Entry| {
            let path = routes[entry.route].lanes();
            let (_, from, _) = path.lane_stretches().nth(entry.nth)?;
            Some((path, path.distance_of_arc(from)))
        };
        let half = slot.size[0] / 2.0;
        let ((path, from), (beside, to)) = (start(own)?, start(other)?);
        let on_lane = path.distance_of_arc(slot.s + half) - from;
        Some((other.route, beside.arc_of_distance(to + on_lane) - half))
    }

    /// Returns the entry of a lane nearest to where the vehicle of a slot is on its route.
    fn entry(&self, routes: &[RouteGeometry], slot: &Slot, lane: usize) -> Option<&Entry> {
        let entries = self.of.get(slot.assigned)?;
        let now = self.edge_of(routes, slot).unwrap_or(0);
        let here = entries.iter().filter(|entry| entry.lane == lane);
        here.min_by_key(|entry| (entry.edge.abs_diff(now), entry.route != slot.route))
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
