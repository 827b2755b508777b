//! Fastest routes of cars between edges.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap};

use super::{EdgeFunction, Net, NetError, Problem, shorten};

/// A lane, and the number of the trip's edges that have been reached there.
type Node = (usize, usize);

impl Net {
    /// Returns the edges of the fastest route at the speed limits that begins on the first of
    /// `stages`, passes all of them in order and ends on the last, without lane changes.
    ///
    /// # Errors
    /// [`Problem::EmptyRoute`], [`Problem::NoEdge`], [`Problem::NotRoad`], or
    /// [`Problem::NoTrip`] if no such route exists.
    pub fn trip(&self, stages: &[String]) -> Result<Vec<String>, NetError> {
        let mut edges: Vec<usize> =
            stages.iter().map(|id| self.road(id)).collect::<Result<_, _>>()?;
        edges.dedup();
        let Some(&first) = edges.first() else {
            return Err(self.error(Problem::EmptyRoute));
        };
        let mut before: HashMap<Node, (u64, Node)> = HashMap::new();
        let mut open = BinaryHeap::new();
        for lane in self.edges[first].lanes.clone().filter(|&lane| self.lanes[lane].cars) {
            before.insert((lane, 1), (0, (lane, 1)));
            open.push(Reverse((0, (lane, 1))));
        }
        while let Some(Reverse((time, node))) = open.pop() {
            let (lane, reached) = node;
            if reached == edges.len() {
                return Ok(self.edges_of(node, &before));
            }
            if before[&node].0 < time {
                continue;
            }
            for connection in self.connections_from(lane).filter(|c| self.lanes[c.to].cars) {
                let to = &self.lanes[connection.to];
                let reached = reached + usize::from(to.edge == edges[reached]);
                // Whole milliseconds are integers, which the heap can order.
                let later = time + (1e3 * to.length / to.speed.max(0.1)) as u64 + 1;
                let next = (connection.to, reached);
                if before.get(&next).is_none_or(|known| later < known.0) {
                    before.insert(next, (later, node));
                    open.push(Reverse((later, next)));
                }
            }
        }
        let (from, to) = (shorten(&stages[0]), shorten(&stages[stages.len() - 1]));
        Err(self.error(Problem::NoTrip { from, to }))
    }

    fn road(&self, id: &str) -> Result<usize, NetError> {
        self.edge_named(id)?;
        self.edge_index(id).ok_or_else(|| self.error(Problem::EmptyRoute))
    }

    /// Returns the edges of the route to a node, in driving order.
    fn edges_of(&self, last: Node, before: &HashMap<Node, (u64, Node)>) -> Vec<String> {
        let back = |node: &Node| Some(before[node].1).filter(|earlier| earlier != node);
        let mut edges: Vec<String> = std::iter::successors(Some(last), back)
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
        let trip =
            |stages: &[&str]| net.trip(&stages.iter().map(|&id| id.into()).collect::<Vec<_>>());
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
        let stages = |to: &str| ["west_in".to_owned(), to.to_owned()];
        assert_eq!(net.trip(&stages("east_out")).expect("straight on"), stages("east_out"));
        assert!(matches!(
            net.trip(&stages("north_out")),
            Err(NetError { problem: Problem::NoTrip { .. }, .. })
        ));
    }
}
