//! The lanes and the paths of routes.

use std::collections::{HashMap, HashSet};

use super::{CARS, Connection, Edge, MAX_POINTS, Net, NetError, Path, Problem, shorten};

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
        let lanes = self.route_lanes(edges, lane, classes)?;
        let points: usize = lanes.iter().map(|&lane| self.lanes[lane].shape.len()).sum();
        if points > MAX_POINTS {
            return Err(self.error(Problem::LongRoute { points, limit: MAX_POINTS }));
        }
        Path::through(self, &lanes).ok_or_else(|| self.error(Problem::EmptyRoute))
    }

    /// Returns the path of the rest of a route for a vehicle on `lane` of the first of `edges`. From a
    /// lane on which the route does not go on, the path changes at the lane's end to the nearest lane
    /// on which it does, or ends there. Permissions do not count, because SUMO has decided that the
    /// vehicle is on the lane. `None` if the path has no extent.
    pub(crate) fn route_path_on(&self, edges: &[String], lane: usize) -> Option<Path> {
        let own = self.lanes[lane].index;
        let lanes = &self.edges[self.lanes[lane].edge].lanes;
        let mut others: Vec<u32> = lanes.clone().map(|lane| self.lanes[lane].index).collect();
        others.sort_by_key(|index| index.abs_diff(own));
        let onward =
            others.into_iter().find_map(|index| self.route_lanes(edges, Some(index), &[]).ok());
        let mut lanes = onward.unwrap_or_else(|| vec![lane]);
        lanes[0] = lane;
        let points: usize = lanes.iter().map(|&lane| self.lanes[lane].shape.len()).sum();
        if points > MAX_POINTS { None } else { Path::through(self, &lanes) }
    }

    /// Returns the lanes of a route in driving order, with the internal lanes between those of its
    /// edges.
    fn route_lanes(
        &self,
        edges: &[String],
        first: Option<u32>,
        classes: &[&str],
    ) -> Result<Vec<usize>, NetError> {
        let Some(last) = edges.len().checked_sub(1) else {
            return Err(self.error(Problem::EmptyRoute));
        };
        let route: Vec<&Edge> =
            edges.iter().map(|id| self.edge_for(id, classes)).collect::<Result<_, _>>()?;
        // From the last edge to the first: for each lane, the best connection from which the
        // route's end can be reached.
        let mut onward: Vec<HashMap<usize, &Connection>> = vec![HashMap::new(); last];
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
                let reaches_end = |c: &&Connection| {
                    onward.get(i + 1).is_none_or(|later| later.contains_key(&c.to))
                };
                if let Some(best) = connections.filter(reaches_end).min_by_key(|c| c.to) {
                    onward[i].insert(lane, best);
                }
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
        let mut lane = route[0].lanes.clone().find(good).ok_or_else(lane_change)?;
        let mut lanes = vec![lane];
        for connections in &onward {
            let connection = connections.get(&lane).ok_or_else(lane_change)?;
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
