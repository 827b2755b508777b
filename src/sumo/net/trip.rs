//! Fastest routes of cars between edges.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap};

use super::{EdgeFunction, Net, NetError, Problem, nearest, shorten};

/// A lane, and the number of the trip's edges that have been reached there.
type Node = (usize, usize);

impl Net {
    /// Returns the edges of the fastest route at the speed limits that begins on an edge of the
    /// first of `stages`, passes an edge of each in order and ends on one of the last. A route without
    /// lane changes comes before any other. Vehicles of all `classes` (SUMO's names) may drive it.
    ///
    /// # Errors
    /// [`Problem::EmptyRoute`], [`Problem::NoEdge`], [`Problem::NotRoad`],
    /// [`Problem::NotAllowed`], or [`Problem::NoTrip`] if no such route exists.
    pub fn trip(&self, stages: &[Vec<String>], classes: &[&str]) -> Result<Vec<String>, NetError> {
        let road = |id: &String| {
            self.edge_for(id, classes)?;
            self.edge_index(id).ok_or_else(|| self.error(Problem::EmptyRoute))
        };
        let mut edges: Vec<Vec<usize>> = stages
            .iter()
            .map(|ids| ids.iter().map(road).collect::<Result<_, _>>())
            .collect::<Result<_, _>>()?;
        edges.dedup();
        let route = self.fastest(&edges, classes, false);
        if let Some(route) = route.or_else(|| self.fastest(&edges, classes, true)) {
            return Ok(route);
        }
        if edges.is_empty() {
            return Err(self.error(Problem::EmptyRoute));
        }
        let name = |stage: &Vec<String>| shorten(&stage.join(" "));
        let (from, to) = (name(&stages[0]), name(&stages[stages.len() - 1]));
        Err(self.error(Problem::NoTrip { from, to }))
    }

    /// Returns the edges of the fastest route past an edge of each of `stages`, in order. `changed`:
    /// whether vehicles on it may change lanes.
    fn fastest(
        &self,
        edges: &[Vec<usize>],
        classes: &[&str],
        changed: bool,
    ) -> Option<Vec<String>> {
        let first = edges.first()?;
        let mut before: HashMap<Node, (u64, Node)> = HashMap::new();
        let mut open = BinaryHeap::new();
        let lanes = first.iter().flat_map(|&edge| self.edges[edge].lanes.clone());
        for lane in lanes.filter(|&lane| self.is_open(lane, classes)) {
            before.insert((lane, 1), (0, (lane, 1)));
            open.push(Reverse((0, (lane, 1))));
        }
        while let Some(Reverse((time, node))) = open.pop() {
            let (lane, reached) = node;
            if reached == edges.len() {
                return Some(self.edges_of(node, &before));
            }
            if before[&node].0 < time {
                continue;
            }
            let mut reach = |next: Node, later: u64| {
                if before.get(&next).is_none_or(|known| later < known.0) {
                    before.insert(next, (later, node));
                    open.push(Reverse((later, next)));
                }
            };
            for connection in self.connections_from(lane).filter(|c| self.admits(c, classes)) {
                let to = &self.lanes[connection.to];
                let reached = reached + usize::from(edges[reached].contains(&to.edge));
                // Whole milliseconds are integers, which the heap can order.
                let later = time + (1e3 * to.length / to.speed.max(0.1)) as u64 + 1;
                reach((connection.to, reached), later);
            }
            let lanes = self.edges[self.lanes[lane].edge].lanes.clone().filter(|_| changed);
            for beside in lanes.filter(|&beside| self.is_open(beside, classes)) {
                reach((beside, reached), time + 1);
            }
        }
        None
    }

    /// Returns the roads that leave a junction, or those that lead to it, and that vehicles of all
    /// `classes` may use.
    ///
    /// # Errors
    /// [`Problem::NoJunction`] if there is none.
    pub fn roads_at(
        &self,
        junction: &str,
        leaving: bool,
        classes: &[&str],
    ) -> Result<Vec<String>, NetError> {
        let at = |edge: &&super::Edge| {
            let end = if leaving { &edge.from } else { &edge.to };
            edge.function == EdgeFunction::Normal
                && end.as_deref() == Some(junction)
                && edge.lanes.clone().any(|lane| self.is_open(lane, classes))
        };
        let roads: Vec<String> = self.edges.iter().filter(at).map(|edge| edge.id.clone()).collect();
        if roads.is_empty() {
            let known = self.junctions.iter().map(|known| known.id.as_str());
            let nearest = nearest(junction, known.filter(|id| *id != junction)).map(Into::into);
            let direction = if leaving { "from" } else { "to" };
            let junction = shorten(junction);
            return Err(self.error(Problem::NoJunction { junction, direction, nearest }));
        }
        Ok(roads)
    }

    /// Returns the edges of the route to a node, in driving order.
    fn edges_of(&self, last: Node, before: &HashMap<Node, (u64, Node)>) -> Vec<String> {
        let back = |node: &Node| Some(before[node].1).filter(|earlier| earlier != node);
        // A lane change stays on its edge.
        let moves_on = |node: &Node| {
            back(node).is_none_or(|from| self.connections_from(from.0).any(|c| c.to == node.0))
        };
        let mut edges: Vec<String> = std::iter::successors(Some(last), back)
            .filter(moves_on)
            .map(|(lane, _)| &self.edges[self.lanes[lane].edge])
            .filter(|edge| edge.function == EdgeFunction::Normal)
            .map(|edge| edge.id.clone())
            .collect();
        edges.reverse();
        edges
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_fastest_route_passes_all_stages() {
        let net = Net::load(std::path::Path::new("sumo_nets/intersection_turns/one_lane.net.xml"))
            .expect("the net");
        let trip = |stages: &[&str]| {
            net.trip(&stages.iter().map(|&id| vec![id.into()]).collect::<Vec<_>>(), &["passenger"])
        };
        let ids: Vec<&str> = net.roads().map(|edge| edge.id.as_str()).collect();
        let mut longest = 0;
        for from in &ids {
            assert_eq!(trip(&[from]).expect("a route along one edge"), [from.to_owned()]);
            for to in ids.iter().filter(|to| *to != from) {
                let Ok(edges) = trip(&[from, to]) else { continue };
                assert_eq!((edges[0].as_str(), edges[edges.len() - 1].as_str()), (*from, *to));
                assert!(net.route_path(&edges).is_ok(), "{edges:?}");
                longest = longest.max(edges.len());
            }
        }
        assert!(longest >= 2);
        assert_eq!(trip(&[ids[0], ids[0]]).expect("there already"), [ids[0].to_owned()]);
        assert!(matches!(
            trip(&[ids[0], "nowhere"]),
            Err(NetError { problem: Problem::NoEdge { .. }, .. })
        ));
        // This net has no turns, so no route leads round a corner.
        let net = Net::load(std::path::Path::new("sumo_nets/intersection/arm42.net.xml"))
            .expect("the net");
        let stages = |to: &str| ["west_in", to].map(|id| vec![id.to_owned()]);
        let trip = |to: &str| net.trip(&stages(to), &["passenger"]);
        assert_eq!(trip("east_out").expect("straight on"), stages("east_out").concat());
        assert!(matches!(trip("north_out"), Err(NetError { problem: Problem::NoTrip { .. }, .. })));
    }
}
