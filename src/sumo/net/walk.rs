//! Paths of pedestrians along sidewalks, in both directions, and over the walking areas and
//! crossings of junctions.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap};

use super::{EdgeFunction, MAX_POINTS, Net, NetError, PEDESTRIANS, Path, Problem, shorten};

/// A walk through a net.
#[derive(Debug, Clone, PartialEq)]
pub struct Walk {
    /// Centre line of the sidewalks and crossings, in walking direction; straight across walking
    /// areas.
    pub path: Path,
    /// SUMO's position on the last edge where the walk ends \[m\]; by default the far end of the
    /// edge in walking direction.
    pub end: f64,
}

/// A lane of a walk: its index, and whether the pedestrian walks against the direction of its
/// shape.
type Step = (usize, bool);

/// The shortest path whose last edge is walked in this direction.
struct Leg {
    /// Length of the path \[m\].
    metres: f64,
    backwards: bool,
    /// Index of the path to the previous edge that this path continues, and the lanes in between.
    before: Option<(usize, Vec<usize>)>,
}

impl Net {
    /// Returns the shortest walk along `edges`, the one that SUMO's pedestrians take. Pedestrians
    /// use sidewalks in both directions and go from edge to edge over walking areas and crossings.
    ///
    /// The walk begins at `depart` on the first edge and ends at `arrival` on the last edge; both
    /// count from the start of the edge \[m\]. Without `arrival`, the walk ends at the far end of
    /// the last edge, and a walk along a single edge goes in the edge's direction.
    ///
    /// # Errors
    /// [`Problem::EmptyRoute`], [`Problem::NoEdge`], [`Problem::NoSidewalk`],
    /// [`Problem::OffEdge`], [`Problem::NotWalkable`] or [`Problem::LongRoute`].
    pub fn walk(
        &self,
        edges: &[String],
        depart: f64,
        arrival: Option<f64>,
    ) -> Result<Walk, NetError> {
        let empty = || self.error(Problem::EmptyRoute);
        let lanes: Vec<usize> =
            edges.iter().map(|id| self.sidewalk(id)).collect::<Result<_, _>>()?;
        let (&first, &last) = (lanes.first().ok_or_else(empty)?, lanes.last().ok_or_else(empty)?);
        let length = |lane: usize| self.lanes[lane].length;
        for (edge, lane, at) in
            [(edges.first(), first, Some(depart)), (edges.last(), last, arrival)]
        {
            if let Some(position) = at.filter(|at| !(0.0..=length(lane)).contains(at)) {
                let edge = shorten(edge.map_or("", String::as_str));
                let length = length(lane);
                return Err(self.error(Problem::OffEdge { edge, position, length }));
            }
        }
        let left = |backwards: bool| if backwards { depart } else { length(first) - depart };
        let to_go = |backwards: bool| {
            let forwards = arrival.unwrap_or(if backwards { 0.0 } else { length(last) });
            if backwards { length(last) - forwards } else { forwards }
        };
        if lanes.len() == 1 {
            let backwards = arrival.is_some_and(|arrival| arrival < depart);
            let path = Path::on_foot(self, &[(first, backwards)]).ok_or_else(empty)?;
            return Ok(Walk { path, end: arrival.unwrap_or(length(last)) });
        }
        let links = self.links_on_foot();
        let mut legs: Vec<Leg> = [false, true]
            .map(|backwards| Leg { metres: left(backwards), backwards, before: None })
            .into();
        let mut junctions: Vec<Vec<Leg>> = Vec::with_capacity(lanes.len());
        for (i, pair) in lanes.windows(2).enumerate() {
            let mut onward: Vec<Leg> = Vec::new();
            for backwards in [false, true] {
                let joined = legs.iter().enumerate().filter_map(|(k, leg)| {
                    let (metres, areas) =
                        self.over_junction((pair[0], leg.backwards), (pair[1], backwards), &links)?;
                    let more =
                        if i + 2 == lanes.len() { to_go(backwards) } else { length(pair[1]) };
                    Some(Leg {
                        metres: leg.metres + metres + more,
                        backwards,
                        before: Some((k, areas)),
                    })
                });
                onward.extend(joined.min_by(|a, b| a.metres.total_cmp(&b.metres)));
            }
            if onward.is_empty() {
                let (from, to) = (shorten(&edges[i]), shorten(&edges[i + 1]));
                return Err(self.error(Problem::NotWalkable { from, to }));
            }
            junctions.push(std::mem::replace(&mut legs, onward));
        }
        let mut leg =
            legs.into_iter().min_by(|a, b| a.metres.total_cmp(&b.metres)).ok_or_else(empty)?;
        let (mut directions, mut between) = (vec![leg.backwards], Vec::new());
        while let (Some((k, areas)), Some(mut earlier)) = (leg.before, junctions.pop()) {
            leg = earlier.swap_remove(k);
            directions.push(leg.backwards);
            between.push(areas);
        }
        directions.reverse();
        between.reverse();
        let mut steps: Vec<Step> = Vec::new();
        for (i, (&lane, &backwards)) in lanes.iter().zip(&directions).enumerate() {
            steps.push((lane, backwards));
            for pair in between.get(i).map_or(&[][..], Vec::as_slice).windows(2) {
                if self.edges[self.lanes[pair[1]].edge].function == EdgeFunction::Crossing {
                    // In a net, one connection leads from a walking area to the start of a
                    // crossing, and another from the end of the crossing to a walking area.
                    steps.push((pair[1], self.connections_from(pair[1]).any(|c| c.to == pair[0])));
                }
            }
        }
        let points = steps.iter().map(|&(lane, _)| self.lanes[lane].shape.len()).sum();
        if points > MAX_POINTS {
            return Err(self.error(Problem::LongRoute { points, limit: MAX_POINTS }));
        }
        let path = Path::on_foot(self, &steps).ok_or_else(empty)?;
        let far =
            if directions.last().is_some_and(|backwards| *backwards) { 0.0 } else { length(last) };
        Ok(Walk { path, end: arrival.unwrap_or(far) })
    }

    /// Returns the lane of an edge for pedestrians: if possible, one that cars may not use.
    fn sidewalk(&self, id: &str) -> Result<usize, NetError> {
        let walkable = |edge: &&super::Edge| {
            edge.function == EdgeFunction::Normal
                && edge.lanes.clone().any(|lane| self.lanes[lane].classes.contain(PEDESTRIANS))
        };
        let Some(edge) = self.edge_index(id).map(|i| &self.edges[i]) else {
            return Err(self.no_edge(id, self.edges.iter().filter(walkable)));
        };
        let lanes =
            || edge.lanes.clone().filter(|&lane| self.lanes[lane].classes.contain(PEDESTRIANS));
        let lane = lanes().find(|&lane| self.lanes[lane].is_sidewalk()).or_else(|| lanes().next());
        let lane = lane.filter(|_| edge.function == EdgeFunction::Normal);
        lane.ok_or_else(|| self.error(Problem::NoSidewalk { edge: shorten(id) }))
    }

    /// Returns the adjacent lanes of each lane for pedestrians, who walk in both directions: lanes
    /// are adjacent if a connection joins them and one of them is a walking area.
    fn links_on_foot(&self) -> HashMap<usize, Vec<usize>> {
        let area =
            |lane: usize| self.edges[self.lanes[lane].edge].function == EdgeFunction::WalkingArea;
        let mut links: HashMap<usize, Vec<usize>> = HashMap::new();
        for connection in self.connections.iter().filter(|c| area(c.from) || area(c.to)) {
            links.entry(connection.from).or_default().push(connection.to);
            links.entry(connection.to).or_default().push(connection.from);
        }
        links
    }

    /// Returns the shortest path from the end of one sidewalk to the start of another, in walking
    /// direction, over the walking areas and crossings of the junction between them: its length
    /// \[m\] and its lanes.
    fn over_junction(
        &self,
        from: Step,
        to: Step,
        links: &HashMap<usize, Vec<usize>>,
    ) -> Option<(f64, Vec<usize>)> {
        let end = |(lane, backwards): Step, at_end: bool| {
            let edge = &self.edges[self.lanes[lane].edge];
            if backwards == at_end { edge.from.as_deref() } else { edge.to.as_deref() }
        };
        let junction = end(from, true)?;
        if end(to, false)? != junction {
            return None;
        }
        // Whole millimetres are integers, which the heap can order.
        let millimetres = |lane: usize| (self.lanes[lane].length * 1e3) as u64;
        let mut before: HashMap<usize, (u64, usize)> = HashMap::from([(from.0, (0, from.0))]);
        let mut open = BinaryHeap::from([Reverse((0, from.0))]);
        while let Some(Reverse((length, lane))) = open.pop() {
            if before[&lane].0 < length {
                continue;
            }
            for &next in links.get(&lane).into_iter().flatten() {
                if next == to.0 {
                    let back =
                        |lane: &usize| Some(before[lane].1).filter(|&before| before != from.0);
                    let mut lanes: Vec<usize> = std::iter::successors(Some(lane), back).collect();
                    lanes.reverse();
                    return Some((length as f64 / 1e3, lanes));
                }
                let longer = length + millimetres(next);
                if self.joins(next, junction)
                    && before.get(&next).is_none_or(|known| longer < known.0)
                {
                    before.insert(next, (longer, lane));
                    open.push(Reverse((longer, next)));
                }
            }
        }
        None
    }

    /// Returns whether a walking area or crossing belongs to a junction, as `:centre_w0` to
    /// `centre`.
    fn joins(&self, lane: usize, junction: &str) -> bool {
        let edge = &self.edges[self.lanes[lane].edge];
        let of_pedestrians =
            matches!(edge.function, EdgeFunction::Crossing | EdgeFunction::WalkingArea);
        let name = edge.id.strip_prefix(':').and_then(|id| id.rsplit_once('_'));
        of_pedestrians && name.is_some_and(|(name, _)| name == junction)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn net() -> Net {
        Net::load(std::path::Path::new("sumo_nets/pedestrians_cross/pedestrians_cross.net.xml"))
            .expect("the shipped net")
    }

    fn walk(edges: &str, depart: f64) -> Result<Walk, NetError> {
        net().walk(&edges.split(' ').map(Into::into).collect::<Vec<_>>(), depart, None)
    }

    fn reversed(path: &Path) -> Vec<[f64; 2]> {
        path.points.iter().rev().copied().collect()
    }

    #[test]
    fn walks_go_in_both_directions_over_the_crossings_that_lie_between() {
        let straight = walk("south_in north_out", 0.0).expect("over the eastern arm");
        let lanes = net();
        let length = |edge: &str| lanes.lanes[lanes.sidewalk(edge).expect("a sidewalk")].length;
        assert_eq!(straight.end, length("north_out"));
        let metres = straight.path.length();
        assert!((90.0..110.0).contains(&metres), "two sidewalks and a crossing: {metres} m");
        // The crossing of the eastern arm lies at x = 5.5.
        assert!(
            straight.path.points.contains(&[5.5, -3.5])
                && straight.path.points.contains(&[5.5, 3.5])
        );
        let back = walk("north_out south_in", length("north_out")).expect("the same walk back");
        assert_eq!((back.end, straight.path.points.clone()), (0.0, reversed(&back.path)));
        let around = walk("west_in south_out east_out", 40.0);
        assert!(
            matches!(around, Err(NetError { problem: Problem::NotWalkable { .. }, .. })),
            "the south leads nowhere else"
        );
    }

    #[test]
    fn the_walk_depends_on_where_it_begins() {
        // From the far end of the arm, the walk goes round that end; from near the junction, over
        // the crossing.
        let [far, near] =
            [0.0, 30.0].map(|depart| walk("west_in west_out", depart).expect("a walk").path);
        assert!(
            near.points.contains(&[-5.5, 3.5]) && !far.points.contains(&[-5.5, 3.5]),
            "{:?}",
            near.points
        );
        let one =
            net().walk(&["west_in".into()], 30.0, Some(10.0)).expect("along one edge, backwards");
        assert_eq!((one.path.points[0], one.end), ([-7.5, -4.5], 10.0));
        assert_eq!(walk("west_in", 0.0).expect("along it").path.points[0], [-50.0, -4.5]);
    }

    #[test]
    fn walks_that_are_not_possible_are_refused() {
        assert!(
            matches!(walk("west_inn", 0.0), Err(NetError { problem: Problem::NoEdge { nearest: Some(id), .. }, .. }) if id == "west_in")
        );
        assert!(matches!(
            walk(":centre_c0", 0.0),
            Err(NetError { problem: Problem::NoSidewalk { .. }, .. })
        ));
        assert!(net().walk(&[], 0.0, None).is_err());
        assert!(
            matches!(
                walk("west_in west_out", 42.6),
                Err(NetError { problem: Problem::OffEdge { .. }, .. })
            ),
            "the edge has 42.5 m"
        );
        let beyond = net()
            .walk(&["west_in".into(), "west_out".into()], 30.0, Some(50.0))
            .unwrap_err()
            .to_string();
        assert!(beyond.contains("50 m") && beyond.contains("`west_out`"), "{beyond}");
        let bare = Net::load(std::path::Path::new("sumo_nets/intersection/arm42.net.xml"))
            .expect("the shipped net");
        assert!(matches!(
            bare.walk(&["west_in".into(), "west_out".into()], 0.0, None),
            Err(NetError { problem: Problem::NotWalkable { .. }, .. })
        ));
    }
}
