//! The areas that a net's lanes cover, and the lines beside them that a vehicle must not touch.
//!
//! With [`Border::Line`], every normal edge has a line to the left of its leftmost lane and one to
//! the right of its rightmost lane. On a junction, a connection from a rightmost lane into a
//! rightmost lane has a line to its right if no other lane of the junction crosses that line,
//! because such a connection follows the outside of the junction. A vehicle whose centre is on no
//! lane is off-road, too.
//!
//! In left-hand nets, left and right are the other way round.
//!
//! Where a road passes over or under another, the lines of each have a gap on the lanes of the other.
//!
//! With [`Border::Kerb`], only the line between the two directions of a road remains, and no part
//! of a vehicle may be beyond the kerb. Where a road ends in the net, neither a line nor a kerb
//! crosses it: only the vehicle's centre must not be beyond the end.

use std::collections::HashSet;

use super::conflicts::crossing;
use super::geometry::stretch;
use super::levels::Levels;
use crate::scenario::{Border, Termination};
use crate::sumo::net::{Edge, EdgeFunction, Lane, Net};

/// How far beyond a lane's edge a vehicle's centre still counts as on the lane \[m\], as measured
/// on the paper's simulator. The kerb is at the same distance.
pub(super) const BESIDE: f64 = 0.6;
/// Lines of two edges whose ends are at most this far apart are one line \[m\].
const SAME: f64 = 0.1;
/// Length of the pieces of which a line loses those that lie on a road of another level \[m\].
const PIECE: f64 = 0.5;

pub(super) type Point = [f64; 2];

/// A segment of a lane's centre line, with half the lane's width \[m\].
#[derive(Debug, Clone, Copy)]
pub(super) struct LaneSegment {
    pub(super) ends: [Point; 2],
    pub(super) half: f64,
    /// Whether the road ends at the first and at the second end. Where it does, no point beyond
    /// that end counts as on the lane; elsewhere the points in a half circle beyond the end do.
    last: [bool; 2],
}

impl LaneSegment {
    /// Returns whether a point counts as on the lane.
    pub(super) fn covers(&self, point: Point) -> bool {
        let [a, b] = self.ends;
        let direction = [b[0] - a[0], b[1] - a[1]];
        let from =
            |end: Point| (point[0] - end[0]) * direction[0] + (point[1] - end[1]) * direction[1];
        let beyond = (self.last[0] && from(a) < 0.0) || (self.last[1] && from(b) > 0.0);
        !beyond && distance(self.ends, point) <= self.half + BESIDE
    }

    /// Returns the distance from a point along a unit vector to where the ray leaves the area that
    /// counts as on the lane \[m\]; `None` if the point is outside that area.
    pub(super) fn exit(&self, from: Point, along: Point) -> Option<f64> {
        let reach = self.half + BESIDE;
        if !self.covers(from) {
            return None;
        }
        // The area is convex: a circle around each end at which the road goes on, and the box
        // between the ends. The ray leaves the area where it leaves the last of these.
        let circle = |end: usize| {
            if self.last[end] {
                return None;
            }
            let centre = self.ends[end];
            let (dx, dy) = (from[0] - centre[0], from[1] - centre[1]);
            let (middle, rest) = (dx * along[0] + dy * along[1], dx * dx + dy * dy - reach * reach);
            (middle * middle >= rest).then(|| (middle * middle - rest).sqrt() - middle)
        };
        let [a, b] = self.ends;
        let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
        let length = dx.hypot(dy).max(f64::MIN_POSITIVE);
        let own = |x: f64, y: f64| [(x * dx + y * dy) / length, (y * dx - x * dy) / length];
        let at = own(from[0] - f64::midpoint(a[0], b[0]), from[1] - f64::midpoint(a[1], b[1]));
        let between =
            stretch(at, own(along[0], along[1]), [length / 2.0, reach]).map(|[_, leave]| leave);
        Some([circle(0), circle(1), between].into_iter().flatten().fold(0.0, f64::max))
    }
}

/// An end of a road in the net.
#[derive(Debug, Clone, Copy)]
pub(super) struct End {
    /// Middle of the lane at the end \[m\].
    pub(super) at: Point,
    /// Unit vector that points out of the road.
    pub(super) out: Point,
    /// Half the lane's width \[m\].
    pub(super) half: f64,
}

/// Returns the lanes of a net, and the ends of roads: edges without an incoming or without an
/// outgoing connection.
pub(super) fn lay_lanes(net: &Net) -> (Vec<LaneSegment>, Vec<End>) {
    let (mut lane_segments, mut road_ends) = (Vec::new(), Vec::new());
    let reached: HashSet<usize> = net.connections.iter().map(|join| join.to).collect();
    let left: HashSet<usize> = net.connections.iter().map(|join| join.from).collect();
    for edge in &net.edges {
        let normal = edge.function == EdgeFunction::Normal;
        if !normal && edge.function != EdgeFunction::Internal {
            continue;
        }
        let alone = |joined: &HashSet<usize>| {
            normal && !edge.lanes.clone().any(|lane| joined.contains(&lane))
        };
        let (begins, ends) = (alone(&reached), alone(&left));
        for lane in net.lanes[edge.lanes.clone()].iter().filter(|lane| !lane.is_sidewalk()) {
            let half = lane.width / 2.0;
            let segments = lane.shape.len() - 1;
            let lane_segment = |(i, pair): (usize, &[Point])| {
                let last = [begins && i == 0, ends && i + 1 == segments];
                LaneSegment { ends: [pair[0], pair[1]], half, last }
            };
            lane_segments.extend(lane.shape.windows(2).enumerate().map(lane_segment));
            let mut end = |at: Point, before: Point| {
                let (dx, dy) = (at[0] - before[0], at[1] - before[1]);
                let length = dx.hypot(dy).max(f64::MIN_POSITIVE);
                road_ends.push(End { at, out: [dx / length, dy / length], half });
            };
            if begins {
                end(lane.shape[0], lane.shape[1]);
            }
            if ends {
                end(lane.shape[segments], lane.shape[segments - 1]);
            }
        }
    }
    (lane_segments, road_ends)
}

/// Lines that end the road, each with the lane beside which it lies, and its segment there.
type Lines = Vec<([Point; 2], usize, usize)>;

/// Returns the lines of a net: a vehicle that touches one is off-road. The lines of a left-hand net
/// are the mirror image of those of its mirror image.
pub(super) fn draw_lines(net: &Net, termination: &Termination) -> Vec<[Point; 2]> {
    if net.left_hand {
        let lines = draw_lines(&net.mirrored(), termination);
        return lines.into_iter().map(|line| line.map(|[x, y]| [x, -y])).collect();
    }
    let mut lines = Vec::new();
    match termination.border {
        Border::Line => draw_all(net, &termination.broken_lines, &mut lines),
        Border::Kerb => draw_between_directions(net, &termination.broken_lines, &mut lines),
    }
    // Two roads side by side share one line, which was drawn for each of them.
    let mut drawn = HashSet::new();
    lines.retain(|&([a, b], ..)| {
        let [a, b] = [a, b].map(|end| end.map(f64::to_bits));
        drawn.insert(if a < b { [a, b] } else { [b, a] })
    });
    cut_at_bridges(net, lines)
}

/// Returns the lines without their parts on the lanes of roads that pass over or under theirs.
fn cut_at_bridges(net: &Net, lines: Lines) -> Vec<[Point; 2]> {
    let levels = Levels::new(net);
    let bounds = |points: &[Point]| {
        let mut bounds = [[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]];
        for point in points {
            for axis in 0..2 {
                bounds[0][axis] = bounds[0][axis].min(point[axis]);
                bounds[1][axis] = bounds[1][axis].max(point[axis]);
            }
        }
        bounds
    };
    let lane_bounds: Vec<_> = net.lanes.iter().map(|lane| bounds(&lane.shape)).collect();
    let mut cut = Vec::with_capacity(lines.len());
    for (line, beside, segment) in lines {
        let [low, high] = bounds(&line);
        let mut over: Vec<([Point; 2], f64)> = Vec::new();
        for (index, lane) in net.lanes.iter().enumerate() {
            let [from, to] = lane_bounds[index];
            if lane.edge == net.lanes[beside].edge
                || lane.is_sidewalk()
                || (0..2).any(|axis| from[axis] > high[axis] || to[axis] < low[axis])
            {
                continue;
            }
            for (k, pair) in lane.shape.windows(2).enumerate() {
                let Some((t, u)) = crossing(line[0], line[1], pair[0], pair[1]) else { continue };
                let (own, other) = (position(net, beside, segment, t), position(net, index, k, u));
                if !levels.lanes_meet((beside, own), (index, other), false) {
                    over.push(([pair[0], pair[1]], lane.width / 2.0 + BESIDE));
                }
            }
        }
        if over.is_empty() {
            cut.push(line);
            continue;
        }
        let [a, b] = line;
        let count = ((b[0] - a[0]).hypot(b[1] - a[1]) / PIECE).ceil().max(1.0);
        let at = |k: f64| [0, 1].map(|axis| a[axis] + (b[axis] - a[axis]) * k / count);
        let pieces = (0..count as u32).map(f64::from).filter(|k| {
            let middle = at(k + 0.5);
            !over.iter().any(|(lane, half)| distance(*lane, middle) <= *half)
        });
        // Pieces that follow each other are one line.
        let mut open: Option<(f64, f64)> = None;
        for k in pieces {
            open = match open {
                Some((first, next)) if next == k => Some((first, k + 1.0)),
                Some((first, next)) => {
                    cut.push([at(first), at(next)]);
                    Some((k, k + 1.0))
                }
                None => Some((k, k + 1.0)),
            };
        }
        cut.extend(open.map(|(first, next)| [at(first), at(next)]));
    }
    cut
}

/// Returns the position on a lane, in SUMO's metres, of a place at fraction `t` of a segment of its
/// shape.
fn position(net: &Net, lane: usize, segment: usize, t: f64) -> f64 {
    let lane = &net.lanes[lane];
    let steps: Vec<f64> = (lane.shape.windows(2))
        .map(|pair| (pair[1][0] - pair[0][0]).hypot(pair[1][1] - pair[0][1]))
        .collect();
    let before: f64 = steps[..segment].iter().sum();
    let metres = steps.iter().sum::<f64>().max(f64::MIN_POSITIVE);
    (before + t * steps[segment]) / metres * lane.length
}

/// Adds the line at `offset` metres to the left of a lane.
fn draw(net: &Net, lane: usize, offset: f64, lines: &mut Lines) {
    let points = parallel(&net.lanes[lane].shape, offset);
    let segments = points.windows(2).enumerate();
    lines.extend(segments.map(|(k, pair)| ([pair[0], pair[1]], lane, k)));
}

/// Adds the lines at both sides of edges, and those along the outside of junctions. Edges in
/// `broken` get no line to their left.
fn draw_all(net: &Net, broken: &[String], lines: &mut Lines) {
    for edge in net.edges.iter().filter(|edge| edge.function == EdgeFunction::Normal) {
        let lanes = net.carriageway(edge);
        let (right, left) = (lanes.start, lanes.end - 1);
        draw(net, right, -net.lanes[right].width / 2.0, lines);
        if !broken.contains(&edge.id) {
            draw(net, left, net.lanes[left].width / 2.0, lines);
        }
    }
    for lane in outer_lanes(net) {
        draw(net, lane, -net.lanes[lane].width / 2.0, lines);
    }
}

/// Adds the lines between the two directions of a road, which are edges that connect the same
/// two junctions. Edges in `broken` get none.
fn draw_between_directions(net: &Net, broken: &[String], lines: &mut Lines) {
    let leftmost = |edge: &Edge| net.carriageway(edge).end - 1;
    let left = |edge: &Edge| {
        let lane = &net.lanes[leftmost(edge)];
        parallel(&lane.shape, lane.width / 2.0)
    };
    let near = |a: Point, b: Point| (a[0] - b[0]).hypot(a[1] - b[1]) < SAME;
    let normal = |edge: &&Edge| edge.function == EdgeFunction::Normal && !broken.contains(&edge.id);
    for (i, edge) in net.edges.iter().enumerate().filter(|(_, edge)| normal(edge)) {
        let line = left(edge);
        let back = |other: &Edge| {
            let other = left(other);
            near(other[0], line[line.len() - 1]) && near(other[other.len() - 1], line[0])
        };
        let mut others = net.edges[..i].iter().filter(normal);
        if others.any(|other| (&other.from, &other.to) == (&edge.to, &edge.from) && back(other)) {
            let lane = leftmost(edge);
            draw(net, lane, net.lanes[lane].width / 2.0, lines);
        }
    }
}

/// Returns the lanes over junctions that follow the outside of the junction, with the road's
/// border to their right.
fn outer_lanes(net: &Net) -> impl Iterator<Item = usize> {
    let outermost = |lane: usize| net.carriageway(&net.edges[net.lanes[lane].edge]).start == lane;
    let joins =
        net.connections.iter().filter(move |join| outermost(join.from) && outermost(join.to));
    joins.filter_map(|join| join.via).filter(|&lane| {
        let lane = &net.lanes[lane];
        let border = parallel(&lane.shape, -lane.width / 2.0);
        let inside = |lane: &&Lane| net.edges[lane.edge].function == EdgeFunction::Internal;
        !net.lanes.iter().filter(inside).any(|other| meet(&border, &other.shape))
    })
}

/// Returns whether two polylines cross.
fn meet(a: &[Point], b: &[Point]) -> bool {
    a.windows(2).any(|a| b.windows(2).any(|b| crossing(a[0], a[1], b[0], b[1]).is_some()))
}

/// Returns the polyline at `offset` metres to the left of another.
fn parallel(points: &[Point], offset: f64) -> Vec<Point> {
    let normal = |a: Point, b: Point| {
        let length = (b[0] - a[0]).hypot(b[1] - a[1]).max(f64::MIN_POSITIVE);
        [(a[1] - b[1]) / length, (b[0] - a[0]) / length]
    };
    let last = points.len() - 1;
    let beside = |i: usize| {
        let before = normal(points[i.max(1) - 1], points[i.max(1)]);
        let after = normal(points[i.min(last - 1)], points[i.min(last - 1) + 1]);
        // At a bend, the point where the parallels of both segments meet.
        let scale = offset / (1.0 + before[0] * after[0] + before[1] * after[1]).max(0.1);
        [
            points[i][0] + scale * (before[0] + after[0]),
            points[i][1] + scale * (before[1] + after[1]),
        ]
    };
    (0..points.len()).map(beside).collect()
}

/// Returns the distance from a point to a segment \[m\].
fn distance([a, b]: [Point; 2], p: Point) -> f64 {
    let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
    let along =
        ((p[0] - a[0]) * dx + (p[1] - a[1]) * dy) / (dx * dx + dy * dy).max(f64::MIN_POSITIVE);
    let t = along.clamp(0.0, 1.0);
    (p[0] - a[0] - t * dx).hypot(p[1] - a[1] - t * dy)
}
