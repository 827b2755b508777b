//! The road surface: the areas that lanes cover, and the lines beside them that a vehicle must not
//! touch.
//!
//! With [`Border::Line`], every normal edge has a line to the left of its leftmost lane and one to
//! the right of its rightmost lane. On a junction, a connection from a rightmost lane into a
//! rightmost lane has a line to its right if no other lane of the junction crosses that line,
//! because such a connection follows the outside of the junction. A vehicle whose centre is on no
//! lane is off-road, too.
//!
//! With [`Border::Kerb`], only the line between the two directions of a road remains, and no part
//! of a vehicle may be beyond the kerb. Where a road ends in the net, neither a line nor a kerb
//! crosses it: only the vehicle's centre must not be beyond the end.

use std::collections::{BTreeSet, HashMap, HashSet};

use super::Error;
use super::geometry::{Pose, Size, stretch};
use super::routes::crossing;
use crate::scenario::{Border, Termination};
use crate::sumo::net::{Edge, EdgeFunction, Lane, Net};

/// Side of the grid cells in which lines and lanes are looked up \[m\].
const CELL: f64 = 8.0;
/// Side of the grid blocks in which lines in sight are looked up (`BLOCK`), and the greatest
/// length of a piece of a line in them (`PIECE`) \[m\].
const BLOCK: f64 = 64.0;
const PIECE: f64 = 32.0;
/// Greatest total length of lanes and lines \[m\]; a longer net is an [`Error::Long`].
const LONGEST: f64 = 5e6;
/// How far beyond a lane's edge a vehicle's centre still counts as on the lane \[m\], as measured
/// on the paper's simulator. The kerb is at the same distance.
pub(super) const BESIDE: f64 = 0.6;
/// Lines of two edges whose ends are at most this far apart are one line \[m\].
const SAME: f64 = 0.1;
/// Distance from which a vehicle's body touches a line \[m\], as measured on the paper's
/// simulator.
const TOUCH: f64 = 0.035;

type Point = [f64; 2];

/// A segment of a lane's centre line, with half the lane's width \[m\].
#[derive(Debug, Clone, Copy)]
struct Strip {
    ends: [Point; 2],
    half: f64,
    /// Whether the road ends at the first and at the second end. Where it does, no point beyond
    /// that end counts as on the lane; elsewhere the points in a half circle beyond the end do.
    last: [bool; 2],
}

impl Strip {
    /// Returns whether a point counts as on the lane.
    fn covers(&self, point: Point) -> bool {
        let [a, b] = self.ends;
        let direction = [b[0] - a[0], b[1] - a[1]];
        let from =
            |end: Point| (point[0] - end[0]) * direction[0] + (point[1] - end[1]) * direction[1];
        let beyond = (self.last[0] && from(a) < 0.0) || (self.last[1] && from(b) > 0.0);
        !beyond && distance(self.ends, point) <= self.half + BESIDE
    }

    /// Returns the distance from a point along a unit vector to where the ray leaves the area that
    /// counts as on the lane \[m\]; `None` if the point is outside that area.
    fn exit(&self, from: Point, along: Point) -> Option<f64> {
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
struct End {
    /// Middle of the lane at the end \[m\].
    at: Point,
    /// Unit vector that points out of the road.
    out: Point,
    /// Half the lane's width \[m\].
    half: f64,
}

#[derive(Debug, Clone, Default)]
struct Cell {
    strips: Vec<u32>,
    lines: Vec<u32>,
    ends: Vec<u32>,
}

/// The lanes and lines of a net, indexed by place.
#[derive(Debug, Clone)]
pub(super) struct Road {
    strips: Vec<Strip>,
    ends: Vec<End>,
    /// Lines that end the road: a vehicle that touches one is off-road.
    lines: Vec<[Point; 2]>,
    cells: HashMap<[i32; 2], Cell>,
    /// Pieces of the lines, by the block that contains their middle.
    blocks: HashMap<[i32; 2], Vec<[Point; 2]>>,
    /// Half the diagonal of a vehicle, plus [`TOUCH`] \[m\].
    reach: f64,
    /// Half the length and half the width of a vehicle, each plus [`TOUCH`] \[m\].
    half: [f64; 2],
    border: Border,
}

impl Road {
    /// Builds the roads of `net` for vehicles of `length` and `width` \[m\].
    ///
    /// # Errors
    /// [`Error::Long`] if lanes and lines together are too long.
    pub(super) fn new(
        net: &Net,
        [length, width]: Size,
        termination: &Termination,
    ) -> Result<Self, Error> {
        let border = termination.border;
        let mut road = Self {
            strips: Vec::new(),
            ends: Vec::new(),
            lines: Vec::new(),
            cells: HashMap::new(),
            blocks: HashMap::new(),
            reach: length.hypot(width) / 2.0 + TOUCH,
            half: [length / 2.0 + TOUCH, width / 2.0 + TOUCH],
            border,
        };
        road.lay_lanes(net);
        match border {
            Border::Line => road.draw_all(net, &termination.broken_lines),
            Border::Kerb => road.draw_between_directions(net, &termination.broken_lines),
        }
        // Two roads side by side share one line, which was drawn for each of them.
        let mut drawn = HashSet::new();
        road.lines.retain(|&[a, b]| {
            let [a, b] = [a, b].map(|end| end.map(f64::to_bits));
            drawn.insert(if a < b { [a, b] } else { [b, a] })
        });
        let lengths = road.strips.iter().map(|strip| &strip.ends).chain(&road.lines);
        let metres: f64 = lengths.map(|[a, b]| (b[0] - a[0]).hypot(b[1] - a[1])).sum();
        if metres.is_nan() || metres > LONGEST {
            return Err(Error::Long {
                net: net.path.display().to_string(),
                metres,
                limit: LONGEST,
            });
        }
        for i in 0..road.strips.len() {
            let Strip { ends, half, .. } = road.strips[i];
            for cell in cells_along(ends, half + BESIDE) {
                road.cells.entry(cell).or_default().strips.push(i as u32);
            }
        }
        for i in 0..road.ends.len() {
            let End { at, half, .. } = road.ends[i];
            for cell in cells_along([at, at], half + 2.0 * road.reach) {
                road.cells.entry(cell).or_default().ends.push(i as u32);
            }
        }
        for i in 0..road.lines.len() {
            for cell in cells_along(road.lines[i], road.reach) {
                road.cells.entry(cell).or_default().lines.push(i as u32);
            }
        }
        for &[a, b] in &road.lines {
            let count = ((b[0] - a[0]).hypot(b[1] - a[1]) / PIECE).ceil().max(1.0);
            let at = |k: f64| [0, 1].map(|axis| a[axis] + (b[axis] - a[axis]) * k / count);
            for k in 0..count as u32 {
                let [from, middle, to] = [0.0, 0.5, 1.0].map(|part| at(f64::from(k) + part));
                road.blocks.entry(middle.map(block_of)).or_default().push([from, to]);
            }
        }
        Ok(road)
    }

    /// Adds the lanes, and the ends of roads: edges without an incoming or without an outgoing
    /// connection.
    fn lay_lanes(&mut self, net: &Net) {
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
                let strip = |(i, pair): (usize, &[Point])| {
                    let last = [begins && i == 0, ends && i + 1 == segments];
                    Strip { ends: [pair[0], pair[1]], half, last }
                };
                self.strips.extend(lane.shape.windows(2).enumerate().map(strip));
                let mut end = |at: Point, before: Point| {
                    let (dx, dy) = (at[0] - before[0], at[1] - before[1]);
                    let length = dx.hypot(dy).max(f64::MIN_POSITIVE);
                    self.ends.push(End { at, out: [dx / length, dy / length], half });
                };
                if begins {
                    end(lane.shape[0], lane.shape[1]);
                }
                if ends {
                    end(lane.shape[segments], lane.shape[segments - 1]);
                }
            }
        }
    }

    /// Adds the lines at both sides of edges, and those along the outside of junctions. Edges in
    /// `broken` get no line to their left.
    fn draw_all(&mut self, net: &Net, broken: &[String]) {
        for edge in net.edges.iter().filter(|edge| edge.function == EdgeFunction::Normal) {
            let lanes = net.carriageway(edge);
            let (right, left) = (&net.lanes[lanes.start], &net.lanes[lanes.end - 1]);
            self.line(&parallel(&right.shape, -right.width / 2.0));
            if !broken.contains(&edge.id) {
                self.line(&parallel(&left.shape, left.width / 2.0));
            }
        }
        for lane in outer_ways(net) {
            self.line(&parallel(&lane.shape, -lane.width / 2.0));
        }
    }

    /// Adds the lines between the two directions of a road, which are edges that connect the same
    /// two junctions. Edges in `broken` get none.
    fn draw_between_directions(&mut self, net: &Net, broken: &[String]) {
        let left = |edge: &Edge| {
            let lane = &net.lanes[net.carriageway(edge).end - 1];
            parallel(&lane.shape, lane.width / 2.0)
        };
        let near = |a: Point, b: Point| (a[0] - b[0]).hypot(a[1] - b[1]) < SAME;
        let normal =
            |edge: &&Edge| edge.function == EdgeFunction::Normal && !broken.contains(&edge.id);
        for (i, edge) in net.edges.iter().enumerate().filter(|(_, edge)| normal(edge)) {
            let line = left(edge);
            let back = |other: &Edge| {
                let other = left(other);
                near(other[0], line[line.len() - 1]) && near(other[other.len() - 1], line[0])
            };
            let mut others = net.edges[..i].iter().filter(normal);
            if others.any(|other| (&other.from, &other.to) == (&edge.to, &edge.from) && back(other))
            {
                self.line(&line);
            }
        }
    }

    /// Returns the distance from a point along a unit vector to the kerb, which is where the area
    /// that counts as on a lane ends; `range` if there is no kerb within `range`, and always with
    /// [`Border::Line`] \[m\].
    pub(super) fn to_kerb(&self, from: Point, along: Point, range: f64) -> f64 {
        let mut reached = if self.border == Border::Kerb { 0.0 } else { range };
        while reached < range {
            let at = [from[0] + reached * along[0], from[1] + reached * along[1]];
            let strips = self.cells.get(&cell_of(at)).map_or(&[][..], |cell| &cell.strips);
            let exits = strips.iter().filter_map(|&i| self.strips[i as usize].exit(at, along));
            let further = exits.fold(0.0, f64::max);
            // A step this small could be lost in rounding, and the loop would not end.
            if further < 1e-9 {
                return reached;
            }
            reached += further;
        }
        range
    }

    /// Calls `visit` with the pieces of all lines that come within `range` of a point \[m\], and
    /// with some pieces that are a little further away. No piece is longer than [`PIECE`].
    pub(super) fn lines_around(&self, from: Point, range: f64, mut visit: impl FnMut([Point; 2])) {
        let reach = range + PIECE / 2.0;
        let near = |[a, b]: &[Point; 2]| {
            let [x, y] = [0, 1].map(|axis| f64::midpoint(a[axis], b[axis]) - from[axis]);
            x * x + y * y <= reach * reach
        };
        let [low, high] = [-reach, reach].map(|by| from.map(|v| block_of(v + by)));
        for i in low[0]..=high[0] {
            for j in low[1]..=high[1] {
                let pieces = self.blocks.get(&[i, j]).into_iter().flatten();
                pieces.filter(|piece| near(piece)).for_each(|&piece| visit(piece));
            }
        }
    }

    /// Returns the distances from a vehicle's sides to the nearest lines, at most `range` \[m\]:
    /// beside its body on the left and on the right, then beside the area `ahead` metres in front
    /// of it on the left and on the right. A distance is 0 where a line crosses.
    pub(super) fn margins(&self, pose: &Pose, ahead: f64, range: f64) -> [f64; 4] {
        let [length, width] = self.half;
        let (sin, cos) = pose.heading.sin_cos();
        let own = |p: Point| {
            let (dx, dy) = (p[0] - pose.x, p[1] - pose.y);
            [dx * cos + dy * sin, dy * cos - dx * sin]
        };
        let mut margins = [range; 4];
        self.lines_around([pose.x, pose.y], (length + ahead).hypot(width + range), |line| {
            let [a, b] = line.map(own);
            for (part, [from, to]) in
                [[-length, length], [length, length + ahead]].into_iter().enumerate()
            {
                let [low, high] = if a[0] <= b[0] { [a, b] } else { [b, a] };
                if high[0] < from || low[0] > to {
                    continue;
                }
                let slope = (high[1] - low[1]) / (high[0] - low[0]).max(1e-9);
                let at = |x: f64| {
                    (low[1] + (x - low[0]) * slope).clamp(low[1].min(high[1]), low[1].max(high[1]))
                };
                let [one, other] =
                    if high[0] - low[0] < 1e-9 { [low[1], high[1]] } else { [from, to].map(at) };
                let (least, most) = (one.min(other), one.max(other));
                if most > 0.0 {
                    margins[2 * part] = margins[2 * part].min((least - width).max(0.0));
                }
                if least < 0.0 {
                    margins[2 * part + 1] = margins[2 * part + 1].min((-most - width).max(0.0));
                }
            }
        });
        margins
    }

    fn line(&mut self, points: &[Point]) {
        self.lines.extend(points.windows(2).map(|pair| [pair[0], pair[1]]));
    }

    /// Returns whether a vehicle is off-road: it touches a line, its centre is on no lane, or
    /// (with [`Border::Kerb`]) a part of it is beyond the kerb.
    pub(super) fn left_by(&self, pose: &Pose) -> bool {
        let Some(cell) = self.cells.get(&cell_of([pose.x, pose.y])) else { return true };
        let (sin, cos) = pose.heading.sin_cos();
        let part = |along: f64, across: f64| {
            let (along, across) = (along * (self.half[0] - TOUCH), across * (self.half[1] - TOUCH));
            [pose.x + along * cos - across * sin, pose.y + along * sin + across * cos]
        };
        // The corners, and points on both sides between them: a side meets a convex kerb before
        // any corner does.
        let beyond_kerb = || {
            let mut parts = [-1.0, -0.5, 0.0, 0.5, 1.0]
                .into_iter()
                .flat_map(|along| [part(along, 1.0), part(along, -1.0)]);
            parts.any(|part| !self.on_lane(part) && !self.beyond_end(part))
        };
        !self.on_lane([pose.x, pose.y])
            || cell.lines.iter().any(|&i| self.touches(pose, self.lines[i as usize]))
            || (self.border == Border::Kerb && beyond_kerb())
    }

    /// Returns whether a point counts as on any lane.
    pub(super) fn on_lane(&self, point: Point) -> bool {
        let strips = self.cells.get(&cell_of(point)).map_or(&[][..], |cell| &cell.strips);
        strips.iter().any(|&i| self.strips[i as usize].covers(point))
    }

    /// Returns whether a point is beyond the end of a road, where there is no kerb and a vehicle
    /// with its centre on a lane may reach.
    fn beyond_end(&self, point: Point) -> bool {
        let ends = self.cells.get(&cell_of(point)).map_or(&[][..], |cell| &cell.ends);
        ends.iter().any(|&i| {
            let End { at, out, half } = self.ends[i as usize];
            let (dx, dy) = (point[0] - at[0], point[1] - at[1]);
            let (beyond, aside) = (dx * out[0] + dy * out[1], dx * out[1] - dy * out[0]);
            (0.0..=self.reach).contains(&beyond) && aside.abs() <= half + self.reach
        })
    }

    /// Returns whether a vehicle's box, enlarged by [`TOUCH`] on all sides, meets a segment.
    fn touches(&self, pose: &Pose, line: [Point; 2]) -> bool {
        let (sin, cos) = pose.heading.sin_cos();
        let own = |p: Point| {
            let (dx, dy) = (p[0] - pose.x, p[1] - pose.y);
            [dx * cos + dy * sin, dy * cos - dx * sin]
        };
        let [a, b] = line.map(own);
        stretch(a, [b[0] - a[0], b[1] - a[1]], self.half)
            .is_some_and(|[from, to]| from <= 1.0 && to >= 0.0)
    }
}

/// Returns the lanes over junctions that follow the outside of the junction, with the road's
/// border to their right.
fn outer_ways(net: &Net) -> impl Iterator<Item = &Lane> {
    let outermost = |lane: usize| net.carriageway(&net.edges[net.lanes[lane].edge]).start == lane;
    let joins =
        net.connections.iter().filter(move |join| outermost(join.from) && outermost(join.to));
    let lanes = joins.filter_map(|join| join.via).map(|via| &net.lanes[via]);
    lanes.filter(|lane| {
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

fn block_of(v: f64) -> i32 {
    (v / BLOCK).floor() as i32
}

fn cell_of(point: Point) -> [i32; 2] {
    point.map(|v| (v / CELL).floor() as i32)
}

/// Returns the cells that contain a point within `margin` of a segment.
fn cells_along([a, b]: [Point; 2], margin: f64) -> BTreeSet<[i32; 2]> {
    let steps = ((b[0] - a[0]).hypot(b[1] - a[1]) / CELL).ceil().max(1.0);
    let reach = margin + CELL / 2.0;
    let mut cells = BTreeSet::new();
    for k in 0..=steps as u32 {
        let t = f64::from(k) / steps;
        let [x, y] = [a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])];
        let ([i0, j0], [i1, j1]) =
            (cell_of([x - reach, y - reach]), cell_of([x + reach, y + reach]));
        cells.extend((i0..=i1).flat_map(|i| (j0..=j1).map(move |j| [i, j])));
    }
    cells
}

/// Returns the distance from a point to a segment \[m\].
fn distance([a, b]: [Point; 2], p: Point) -> f64 {
    let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
    let along =
        ((p[0] - a[0]) * dx + (p[1] - a[1]) * dy) / (dx * dx + dy * dy).max(f64::MIN_POSITIVE);
    let t = along.clamp(0.0, 1.0);
    (p[0] - a[0] - t * dx).hypot(p[1] - a[1] - t * dy)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use proptest::prelude::*;

    use super::*;

    const LENGTH: f64 = 4.515;
    const WIDTH: f64 = 1.852;

    fn ends_at(border: Border) -> Termination {
        Termination { horizon: 1, wreck_time: 0.0, border, broken_lines: Vec::new() }
    }

    fn road() -> Road {
        let path =
            Path::new(env!("CARGO_MANIFEST_DIR")).join("sumo_nets/intersection/arm30.net.xml");
        Road::new(
            &Net::load(&path).expect("the shipped net is valid"),
            [LENGTH, WIDTH],
            &ends_at(Border::Line),
        )
        .expect("a small net")
    }

    #[test]
    fn a_vehicle_may_stray_as_far_as_measured() {
        let road = road();
        // Eastbound, in the middle of the arm. The centre line is y = 0 plus an offset in the
        // net's coordinates.
        let path =
            Path::new(env!("CARGO_MANIFEST_DIR")).join("sumo_nets/intersection/arm30.net.xml");
        let net = Net::load(&path).unwrap();
        let edge = net.edge_index("west_in").unwrap();
        let lane = &net.lanes[net.edges[edge].lanes.start];
        let y = lane.shape[0][1];
        let x = f64::midpoint(lane.shape[0][0], lane.shape[1][0]);
        let left = |lateral: f64, heading: f64| road.left_by(&Pose { x, y: y + lateral, heading });
        for side in [-1.0, 1.0] {
            assert!(!left(side * 0.78, 0.0) && left(side * 0.80, 0.0));
        }
        assert!(!left(0.0, 0.3) && left(0.0, 0.6), "a vehicle across its lane touches the lines");
        assert!(road.left_by(&Pose { x: 1e5, y: 0.0, heading: 0.0 }));
    }

    /// Margins show on which side of a vehicle a line is, and how close it is. A road with two
    /// lanes has its lines to the right of the right lane and to the left of the left lane.
    #[test]
    fn margins_tell_on_which_side_a_line_is_and_how_close() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("sumo_nets/intersection_turns/two_lanes.net.xml");
        let net = Net::load(&path).expect("the shipped net is valid");
        let road = Road::new(&net, [LENGTH, WIDTH], &ends_at(Border::Line)).expect("a small net");
        let edge = &net.edges[net.edge_index("west_in").unwrap()];
        let [right, left] = [0, 1].map(|k| &net.lanes[edge.lanes.start + k]);
        let margins = |lane: &Lane, lateral: f64| {
            let x = f64::midpoint(lane.shape[0][0], lane.shape[1][0]);
            road.margins(&Pose { x, y: lane.shape[0][1] + lateral, heading: 0.0 }, 4.0, 2.0)
        };
        let free = (right.width - WIDTH) / 2.0 - TOUCH;
        let close = |found: [f64; 4], expected: [f64; 4]| {
            found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6)
        };
        for lateral in [0.0, 0.3, -0.5] {
            let [above, below] = [margins(left, lateral), margins(right, lateral)];
            assert!(close(above, [free - lateral, 2.0, free - lateral, 2.0]), "{above:?}");
            assert!(close(below, [2.0, free + lateral, 2.0, free + lateral]), "{below:?}");
        }
        assert_eq!(margins(right, -1.2)[1], 0.0);
    }

    proptest! {
        /// The margin beside the body is 0 exactly where a vehicle touches a line.
        #[test]
        fn who_touches_a_line_has_no_margin(x in 0.0..1.0, y in 0.0..1.0, heading in -3.2..3.2) {
            let road = road();
            let [low, high] = road.lines.iter().flatten().fold([[f64::MAX; 2], [f64::MIN; 2]], |[low, high], p| {
                [[low[0].min(p[0]), low[1].min(p[1])], [high[0].max(p[0]), high[1].max(p[1])]]
            });
            let at = |share: f64, axis: usize| low[axis] + share * (high[axis] - low[axis]);
            let pose = Pose { x: at(x, 0), y: at(y, 1), heading };
            let margins = road.margins(&pose, 4.0, 2.0);
            let touched = road.lines.iter().any(|line| road.touches(&pose, *line));
            prop_assert_eq!(touched, margins[0].min(margins[1]) == 0.0, "{:?} {:?}", pose, margins);
            prop_assert!(margins.iter().all(|margin| (0.0..=2.0).contains(margin)));
        }
    }

    #[test]
    fn no_line_is_there_twice() {
        let lines = road().lines;
        for (i, &[a, b]) in lines.iter().enumerate() {
            assert!(!lines[..i].contains(&[a, b]) && !lines[..i].contains(&[b, a]), "{a:?} {b:?}");
        }
    }

    #[test]
    fn no_line_crosses_a_way_over_the_junction() {
        let road = road();
        let path =
            Path::new(env!("CARGO_MANIFEST_DIR")).join("sumo_nets/intersection/arm30.net.xml");
        let net = Net::load(&path).unwrap();
        for [from, to] in [["west_in", "east_out"], ["south_in", "north_out"]] {
            let path = net.route_path(&[from.to_owned(), to.to_owned()]).unwrap();
            for k in 0..=(path.length() / 0.5) as usize {
                let ([x, y], heading) = path.at(0.5 * k as f64);
                assert!(
                    !road.left_by(&Pose { x, y, heading }),
                    "on the path from {from} to {to}, at {x} {y}"
                );
            }
        }
    }

    #[test]
    fn kerbs_and_the_line_between_directions_border_a_parking_lot() {
        let path =
            Path::new(env!("CARGO_MANIFEST_DIR")).join("sumo_nets/parking_lot/parking_lot.net.xml");
        let net = Net::load(&path).unwrap();
        let [kerbs, lines] = [Border::Kerb, Border::Line]
            .map(|border| Road::new(&net, [LENGTH, WIDTH], &ends_at(border)).unwrap());
        let up = std::f64::consts::FRAC_PI_2;
        // (x, y, heading, off-road by kerbs, off-road by lines, description)
        let places = [
            (15.0, 0.0, 0.0, false, false, "on the road"),
            (15.0, 0.9, 0.0, true, true, "over the line between the directions"),
            (15.0, -1.3, 0.0, false, true, "over the line at the right"),
            (15.0, -1.5, 0.0, true, true, "over the kerb at the right"),
            (37.75, 11.5, up, false, true, "between two spaces"),
            (41.5, 11.5, up, true, true, "beside the last space"),
            (36.0, 1.75, up, false, false, "across the lot"),
            (61.0, 2.0, up, false, false, "straight on along the outside of the junction"),
            (62.0, 2.0, up, false, true, "over its border"),
            (62.6, 2.0, up, true, true, "over its kerb"),
        ];
        for (x, y, heading, by_kerbs, by_lines, what) in places {
            let pose = Pose { x, y, heading };
            assert_eq!(
                [kerbs.left_by(&pose), lines.left_by(&pose)],
                [by_kerbs, by_lines],
                "{what}"
            );
        }
    }

    /// The parking lot is bordered as measured on the paper's simulator.
    #[test]
    fn only_the_centre_counts_where_roads_end_and_sides_where_kerbs_are_convex() {
        let path =
            Path::new(env!("CARGO_MANIFEST_DIR")).join("sumo_nets/parking_lot/parking_lot.net.xml");
        let net = Net::load(&path).unwrap();
        let broken = ["east_in", "east_out"].map(String::from).to_vec();
        let whole = ends_at(Border::Kerb);
        let measured = Termination { broken_lines: broken, ..whole.clone() };
        let [whole, measured] =
            [whole, measured].map(|t| Road::new(&net, [LENGTH, WIDTH], &t).unwrap());
        // (x, y, heading in degrees, off-road, description)
        let places = [
            (45.5, 1.75, 0.0, false, "over the broken line between lot and junction"),
            (36.0, 15.4, 90.0, false, "its front beyond the end of a space"),
            (36.9, 15.4, 90.0, false, "the same, aside"),
            (39.5, 15.4, 45.0, false, "a corner there, beside the last space"),
            (36.0, 15.6, 90.0, true, "its centre beyond the end of a space"),
            (36.0, 15.6, 0.0, true, "the same, across"),
            (0.1, 0.0, 180.0, false, "its front beyond the end of the road"),
            (-0.1, 0.0, 180.0, true, "its centre there"),
            (61.0, 23.4, 90.0, false, "its front beyond the end of an arm"),
            (61.0, -20.1, 90.0, true, "its centre there"),
            (41.3, 13.0, 90.0, true, "beside the last space"),
        ];
        for (x, y, heading, out, what) in places {
            let pose = Pose { x, y, heading: f64::to_radians(heading) };
            assert_eq!(measured.left_by(&pose), out, "{what}");
        }
        assert!(
            whole.left_by(&Pose { x: 45.5, y: 1.75, heading: 0.0 }),
            "a whole line must not be touched"
        );
        // The kerb is convex where the last space meets the curve out of the lot: there are poses
        // with all corners on lanes and a side beyond the kerb.
        let corners_only = |pose: &Pose| {
            let (sin, cos) = pose.heading.sin_cos();
            let corner = |a: f64, b: f64| {
                let (along, across) = (a * LENGTH / 2.0, b * WIDTH / 2.0);
                measured.on_lane([
                    pose.x + along * cos - across * sin,
                    pose.y + along * sin + across * cos,
                ])
            };
            [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)].iter().all(|&(a, b)| corner(a, b))
        };
        let poses = (0..40).flat_map(|i| {
            (0..40).map(move |j| [38.0 + 0.1 * f64::from(i), 4.0 + 0.1 * f64::from(j)])
        });
        let poses = poses.map(|[x, y]| Pose { x, y, heading: -std::f64::consts::FRAC_PI_4 });
        let hit = poses.filter(|pose| corners_only(pose) && measured.left_by(pose)).count();
        assert!(hit > 0, "no side meets the kerb first");
    }

    proptest! {
        /// A vehicle's box touches a segment exactly if a point of the segment is inside the box.
        #[test]
        fn touching_agrees_with_boxes(x in -6.0..6.0f64, y in -6.0..6.0f64, h in -4.0..4.0f64, g in -4.0..4.0f64) {
            let road = road();
            let pose = Pose { x, y, heading: h };
            let (sin, cos) = g.sin_cos();
            let long = road.half[0];
            let line = [[-long * cos, -long * sin], [long * cos, long * sin]];
            let oracle = (0..=4000).any(|k| {
                let t = f64::from(k) / 2000.0 - 1.0;
                let (px, py) = (t * long * cos - x, t * long * sin - y);
                let (s, c) = h.sin_cos();
                (px * c + py * s).abs() <= road.half[0] && (py * c - px * s).abs() <= road.half[1]
            });
            let found = road.touches(&pose, line);
            // The sampled points may miss a corner that the segment cuts by less than their
            // spacing.
            prop_assert!(found || !oracle);
            let smaller = Road { half: road.half.map(|v| v - 0.005), ..road };
            prop_assert!(oracle || !smaller.touches(&pose, line));
        }
    }
}
