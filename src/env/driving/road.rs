//! The road surface, indexed by place: where a vehicle is off-road, and how far it is from kerbs and
//! lines.

use std::collections::{BTreeSet, HashMap};

use super::geometry::{Pose, Size, Stance, stretch};
use super::surface::{BESIDE, End, LaneSegment, Point, draw_lines, lay_lanes};
use crate::env::error::Error;
use crate::scenario::{Border, Termination, Vehicle};
use crate::sumo::net::Net;

/// Side of the grid cells in which lines and lanes are looked up \[m\].
const CELL: f64 = 8.0;
/// Side of the grid blocks in which lines in sight are looked up (`BLOCK`), and the greatest
/// length of a piece of a line in them (`PIECE`) \[m\].
const BLOCK: f64 = 64.0;
const PIECE: f64 = 32.0;
/// Greatest total length of lanes and lines \[m\]; a longer net is an [`Error::Long`].
const LONGEST: f64 = 5e6;
/// Distance from which a vehicle's body touches a line \[m\].
const TOUCH: f64 = Vehicle::BORDER_MARGIN;

#[derive(Debug, Clone, Default)]
struct Cell {
    lanes: Vec<u32>,
    lines: Vec<u32>,
    ends: Vec<u32>,
}

/// The lanes and lines of a net, indexed by place.
#[derive(Debug, Clone)]
pub(super) struct Road {
    lanes: Vec<LaneSegment>,
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
        let (lanes, ends) = lay_lanes(net);
        let mut road = Self {
            lanes,
            ends,
            lines: draw_lines(net, termination),
            cells: HashMap::new(),
            blocks: HashMap::new(),
            reach: length.hypot(width) / 2.0 + TOUCH,
            half: [length / 2.0 + TOUCH, width / 2.0 + TOUCH],
            border: termination.border,
        };
        let lengths = road.lanes.iter().map(|segment| &segment.ends).chain(&road.lines);
        let metres: f64 = lengths.map(|[a, b]| (b[0] - a[0]).hypot(b[1] - a[1])).sum();
        if metres.is_nan() || metres > LONGEST {
            return Err(Error::Long {
                net: net.path.display().to_string(),
                metres,
                limit: LONGEST,
            });
        }
        for i in 0..road.lanes.len() {
            let LaneSegment { ends, half, .. } = road.lanes[i];
            for cell in cells_along(ends, half + BESIDE) {
                road.cells.entry(cell).or_default().lanes.push(i as u32);
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

    /// Returns the distance from a point along a unit vector to the kerb, which is where the area
    /// that counts as on a lane ends; `range` if there is no kerb within `range`, and always with
    /// [`Border::Line`] \[m\].
    pub(super) fn to_kerb(&self, from: Point, along: Point, range: f64) -> f64 {
        let mut reached = if self.border == Border::Kerb { 0.0 } else { range };
        while reached < range {
            let at = [from[0] + reached * along[0], from[1] + reached * along[1]];
            let lanes = self.cells.get(&cell_of(at)).map_or(&[][..], |cell| &cell.lanes);
            let exits = lanes.iter().filter_map(|&i| self.lanes[i as usize].exit(at, along));
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
        let stance = Stance::from(pose);
        let own = |p: Point| -> Point { stance.inverse_transform_point(&p.into()).into() };
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

    /// Returns whether a vehicle is off-road: it touches a line, its centre is on no lane, or
    /// (with [`Border::Kerb`]) a part of it is beyond the kerb.
    pub(super) fn is_off_road(&self, pose: &Pose) -> bool {
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
        let lanes = self.cells.get(&cell_of(point)).map_or(&[][..], |cell| &cell.lanes);
        lanes.iter().any(|&i| self.lanes[i as usize].covers(point))
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
        let stance = Stance::from(pose);
        let own = |p: Point| -> Point { stance.inverse_transform_point(&p.into()).into() };
        let [a, b] = line.map(own);
        stretch(a, [b[0] - a[0], b[1] - a[1]], self.half)
            .is_some_and(|[from, to]| from <= 1.0 && to >= 0.0)
    }
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

#[cfg(test)]
mod tests;
