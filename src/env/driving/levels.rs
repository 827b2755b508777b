//! Which places of a net's lanes are on one level, so that vehicles there can meet. A net says so by
//! its edges and junctions: lanes that cross in the plane without a junction pass over each other.

use crate::sumo::net::{EdgeFunction, Net, Path};

/// Distance from a junction up to which lanes that lead to it or away from it are on its level, and
/// distance within which places of one road are beside each other \[m\].
const NEAR: f64 = 15.0;
/// Difference in height from which one vehicle passes below another \[m\].
const CLEARANCE: f64 = 2.0;

/// The levels of a net.
pub(super) struct Levels<'a> {
    net: &'a Net,
    /// Junctions at the start and at the end of each edge, which are the same within a junction.
    junctions: Vec<[Option<usize>; 2]>,
}

impl<'a> Levels<'a> {
    pub(super) fn new(net: &'a Net) -> Self {
        let numbers = net.junctions.iter().map(|junction| junction.id.as_str());
        let numbers: std::collections::HashMap<&str, usize> =
            numbers.enumerate().map(|(k, id)| (id, k)).collect();
        let junctions = net.edges.iter().map(|edge| {
            let end = |id: Option<&str>| id.and_then(|id| numbers.get(id)).copied();
            match edge.id.strip_prefix(':').and_then(|id| id.rsplit_once('_')) {
                Some((junction, _)) if edge.function != EdgeFunction::Normal => {
                    [end(Some(junction)); 2]
                }
                _ => [end(edge.from.as_deref()), end(edge.to.as_deref())],
            }
        });
        Self { net, junctions: junctions.collect() }
    }

    /// Returns whether vehicles at these positions of two paths, where the centre lines touch in the
    /// plane, are on one level. `along`: whether the lines run along each other there.
    pub(super) fn meet(&self, own: (&Path, f64), other: (&Path, f64), along: bool) -> bool {
        let place = |(path, s): (&Path, f64)| path.lane_at(self.net, s);
        // Paths of points, which belong to no net, are on one level.
        let (Some(own), Some(other)) = (place(own), place(other)) else { return true };
        self.lanes_meet(own, other, along)
    }

    /// Returns the same for two places as a lane and a position on it in SUMO's metres.
    pub(super) fn lanes_meet(&self, own: (usize, f64), other: (usize, f64), along: bool) -> bool {
        let [a, b] = [own, other].map(|(lane, _)| self.net.lanes[lane].edge);
        if (self.height(own) - self.height(other)).abs() > CLEARANCE {
            return false;
        }
        let length = |(lane, _): (usize, f64)| self.net.lanes[lane].length;
        let beside = |s: f64| (own.1 - s).abs() <= NEAR;
        if a == b && beside(other.1)
            || self.net.edges[a].bidi == Some(b) && beside(length(other) - other.1)
        {
            return true;
        }
        self.to_junctions(a, own, length(own)).into_iter().any(|(at, from)| {
            self.to_junctions(b, other, length(other)).into_iter().any(|(same, to)| {
                let near = from <= NEAR && to <= NEAR || along && (from - to).abs() <= NEAR;
                at.is_some() && at == same && near
            })
        })
    }

    /// Returns the junctions of a place on an edge, with its distance to them along the lane \[m\].
    fn to_junctions(
        &self,
        edge: usize,
        (_, s): (usize, f64),
        length: f64,
    ) -> [(Option<usize>, f64); 2] {
        let [start, end] = self.junctions[edge];
        let inside = self.net.edges[edge].function != EdgeFunction::Normal;
        let distance = |metres: f64| if inside { 0.0 } else { metres.max(0.0) };
        [(start, distance(s)), (end, distance(length - s))]
    }

    /// Returns the height of a place on a lane \[m\]; 0 where the net gives none, as in SUMO.
    fn height(&self, (lane, s): (usize, f64)) -> f64 {
        let lane = &self.net.lanes[lane];
        let all = lane.heights.windows(2);
        if lane.heights.is_empty() {
            return 0.0;
        }
        let step = |pair: &[[f64; 2]]| (pair[1][0] - pair[0][0]).hypot(pair[1][1] - pair[0][1]);
        let metres: f64 = lane.shape.windows(2).map(step).sum();
        let mut left = (s / lane.length).clamp(0.0, 1.0) * metres;
        for (points, heights) in lane.shape.windows(2).zip(all) {
            let metres = step(points);
            if left <= metres {
                let share = if metres > 0.0 { left / metres } else { 0.0 };
                return heights[0] + share * (heights[1] - heights[0]);
            }
            left -= metres;
        }
        lane.heights.last().copied().unwrap_or(0.0)
    }
}
