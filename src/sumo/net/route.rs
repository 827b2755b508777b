//! The lanes and the paths of routes.

use std::collections::{HashMap, HashSet};

use super::{CARS, Connection, Edge, MAX_POINTS, Net, NetError, Path, Problem, shorten};

/// How a route goes on from a lane of one of its edges.
struct Onward<'n> {
    /// Number of lane changes up to the end of the route, in lanes.
    changes: u32,
    /// Lane of the same edge from which the route goes on.
    from: usize,
    /// Connection to the next edge.
    connection: &'n Connection,
}

impl Net {
    /// Returns the path of a car's route: the centre lines of its lanes from edge to edge along
    /// connections, including internal lanes.
    ///
    /// Of the lanes from which the rest of the route can be driven without a lane change, the path
    /// takes the one with the smallest index, as SUMO does where a lane leads to several lanes of
    /// the next edge.
    ///
    /// # Errors
    /// [`Problem::EmptyRoute`], [`Problem::NoEdge`], [`Problem::NotRoad`], [`Problem::NotAllowed`],
    /// [`Problem::NotConnected`], [`Problem::LaneChange`] or [`Problem::LongRoute`].
    pub fn route_path(&self, edges: &[String]) -> Result<Path, NetError> {
        self.route_path_from(edges, None)
    }

    /// Returns the path of a car's route that starts on a given lane of the first edge, counted from the
    /// right and starting at 0; `None`: on any lane, as [`Net::route_path`].
    ///
    /// # Errors
    /// As [`Net::route_path`], with [`Problem::LaneChange`] if the route cannot be driven from
    /// that lane.
    pub fn route_path_from(&self, edges: &[String], lane: Option<u32>) -> Result<Path, NetError> {
        self.route_path_for(edges, lane, &[CARS])
    }

    /// Like [`Net::route_path_from`], for vehicles of all `classes` (SUMO's names): each of them may use
    /// all lanes and connections of the path.
    ///
    /// # Errors
    /// As [`Net::route_path_from`].
    pub fn route_path_for(
        &self,
        edges: &[String],
        lane: Option<u32>,
        classes: &[&str],
    ) -> Result<Path, NetError> {
        let lanes = self.route_lanes(edges, lane, classes, false)?;
        self.path_along(&lanes)
    }

    /// Like [`Net::route_path_for`], with as few lane changes as possible. Where a lane change is
    /// needed, the path changes at the lane's end; [`Path::lane_changes`] says where.
    ///
    /// # Errors
    /// As [`Net::route_path_for`].
    pub fn route_path_with_changes(
        &self,
        edges: &[String],
        lane: Option<u32>,
        classes: &[&str],
    ) -> Result<Path, NetError> {
        let lanes = self.route_lanes(edges, lane, classes, true)?;
        self.path_along(&lanes)
    }

    /// Returns the path of the rest of a route for a vehicle on `lane` of the first of `edges`, with
    /// lane changes as in [`Net::route_path_with_changes`]. Permissions do not count, because SUMO has
    /// decided that the vehicle is on the lane. The path ends with the lane if the route cannot be
    /// driven; `None` if it has no extent.
    pub(crate) fn route_path_on(&self, edges: &[String], lane: usize) -> Option<Path> {
        let lanes = self.route_lanes(edges, Some(self.lanes[lane].index), &[], true);
        self.path_along(&lanes.unwrap_or_else(|_| vec![lane])).ok()
    }

    /// Returns the path along lanes.
    fn path_along(&self, lanes: &[usize]) -> Result<Path, NetError> {
        let points: usize = lanes.iter().map(|&lane| self.lanes[lane].shape.len()).sum();
        if points > MAX_POINTS {
            return Err(self.error(Problem::LongRoute { points, limit: MAX_POINTS }));
        }
        Path::through(self, lanes).ok_or_else(|| self.error(Problem::EmptyRoute))
    }

    /// Returns the lanes of a route in driving order, with the internal lanes between those of its
    /// edges; if lanes may be `changed`, those with the fewest changes.
    fn route_lanes(
        &self,
        edges: &[String],
        first: Option<u32>,
        classes: &[&str],
        changed: bool,
    ) -> Result<Vec<usize>, NetError> {
        let Some(last) = edges.len().checked_sub(1) else {
            return Err(self.error(Problem::EmptyRoute));
        };
        let route: Vec<&Edge> =
            edges.iter().map(|id| self.edge_for(id, classes)).collect::<Result<_, _>>()?;
        // From the last edge to the first: for each lane, the best connection from which the
        // route's end can be reached.
        let mut onward: Vec<HashMap<usize, Onward>> = Vec::new();
        onward.resize_with(last, HashMap::new);
        for i in (0..last).rev() {
            let next = &route[i + 1].lanes;
            let (mut connected, mut permitted) = (false, false);
            for lane in route[i].lanes.clone() {
                let connections = self
                    .connections_from(lane)
                    .filter(|c| next.contains(&c.to))
                    .inspect(|_| connected = true)
                    .filter(|c| self.admits(c, classes))
                    .inspect(|_| permitted = true);
                let later = |c: &Connection| match onward.get(i + 1) {
                    Some(later) => later.get(&c.to).map(|onward| onward.changes),
                    None => Some(0),
                };
                let onwards = connections.filter_map(|connection| {
                    Some(Onward { changes: later(connection)?, from: lane, connection })
                });
                if let Some(best) = onwards.min_by_key(|o| (o.changes, o.connection.to)) {
                    onward[i].insert(lane, best);
                }
            }
            if changed {
                onward[i] = beside(route[i], &onward[i]);
            }
            let (from, to) = (|| shorten(&edges[i]), || shorten(&edges[i + 1]));
            if !connected {
                return Err(self.error(Problem::NotConnected { from: from(), to: to() }));
            }
            if !permitted {
                let classes = shorten(&classes.join(" "));
                return Err(self.error(Problem::Closed { from: from(), to: to(), classes }));
            }
        }
        let lane_change = || self.error(Problem::LaneChange { route: shorten(&edges.join(" ")) });
        let wanted = |lane: usize| {
            self.is_open(lane, classes) && first.is_none_or(|first| self.lanes[lane].index == first)
        };
        let good = |lane: &usize| {
            wanted(*lane) && onward.first().is_none_or(|first| first.contains_key(lane))
        };
        let changes = |lane: &usize| onward.first().map(|first| first[lane].changes);
        let start = route[0].lanes.clone().filter(good).min_by_key(changes);
        let mut lane = start.ok_or_else(lane_change)?;
        let mut lanes = vec![lane];
        for onward in &onward {
            let Onward { connection, .. } = onward.get(&lane).ok_or_else(lane_change)?;
            self.follow_internal(connection, &mut lanes);
            lane = connection.to;
            lanes.push(lane);
        }
        Ok(lanes)
    }

    /// Whether vehicles of all these classes may use a lane.
    pub fn is_open(&self, lane: usize, classes: &[&str]) -> bool {
        classes.iter().all(|class| self.lanes[lane].classes.contain(class))
    }

    /// Whether vehicles of all these classes may use a connection and the lanes that it joins.
    pub fn admits(&self, connection: &Connection, classes: &[&str]) -> bool {
        self.is_open(connection.from, classes)
            && self.is_open(connection.to, classes)
            && classes.iter().all(|class| connection.classes.contain(class))
    }

    /// Appends the internal lanes of a connection. There are several where vehicles may wait inside
    /// the junction.
    pub(super) fn follow_internal(&self, connection: &Connection, lanes: &mut Vec<usize>) {
        let mut via = connection.via;
        let mut passed = HashSet::new();
        while let Some(lane) = via {
            if !passed.insert(lane) {
                break; // A cycle, which occurs only in an invalid net.
            }
            lanes.push(lane);
            via = self.connections_from(lane).find(|c| c.to == connection.to).and_then(|c| c.via);
        }
    }
}

/// Returns how a route goes on from each lane of an edge if vehicles change to one of the lanes
/// from which it goes on, with the fewest changes.
fn beside<'n>(edge: &Edge, onward: &HashMap<usize, Onward<'n>>) -> HashMap<usize, Onward<'n>> {
    let from = |lane: usize| {
        let all = onward.values().map(move |straight| {
            let apart = lane.abs_diff(straight.from) as u32;
            Onward { changes: straight.changes + apart, ..*straight }
        });
        all.min_by_key(|o| (o.changes, lane.abs_diff(o.from), o.from))
    };
    edge.lanes.clone().filter_map(|lane| Some((lane, from(lane)?))).collect()
}
