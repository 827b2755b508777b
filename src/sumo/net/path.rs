//! The centre line of a route as a polyline, with arc length along it.
//!
//! `s` is the arc length \[m\] from the start of the route's first edge; the lateral offset is the distance from the
//! centre line \[m\], positive to the LEFT. Beyond both ends the first and last segment go on straight, so that
//! positions and projections stay inverse to each other there.

use std::ops::Range;

use super::Net;

/// Points closer to each other than this are one point \[m\].
const SAME_POINT: f64 = 1e-6;

/// The centre line of a route. Made by [`Net::route_path`] or [`Path::from_points`].
#[derive(Debug, Clone, PartialEq)]
pub struct Path {
    /// Points in driving order, two or more, no two consecutive ones equal \[m\].
    pub points: Vec<[f64; 2]>,
    /// `s` of each point \[m\]; ascending from 0, as many as points.
    pub cumulative: Vec<f64>,
    /// Width of the lane at each segment \[m\]; one fewer than points.
    pub widths: Vec<f64>,
    /// Ids of the route's edges; empty if made from points.
    pub edges: Vec<String>,
    /// `s` at which each of [`Path::edges`] begins \[m\].
    pub edge_start: Vec<f64>,
    /// Length of each of [`Path::edges`] along the centre line \[m\].
    pub edge_length: Vec<f64>,
    /// All lanes passed, internal ones too: indices into [`Net::lanes`]; empty if made from points.
    pub lanes: Vec<usize>,
    /// Metres of centre line per metre of SUMO's lane position, for each of [`Path::edges`]; 1 in most nets.
    scale: Vec<f64>,
    /// Heading of each segment \[rad\].
    headings: Vec<f64>,
    /// Unit vector of each segment.
    directions: Vec<[f64; 2]>,
    /// Where each of [`Path::lanes`] begins in SUMO's count of the distance along the route \[m\].
    lane_position: Vec<f64>,
    /// `s` at which each of [`Path::lanes`] begins \[m\].
    lane_start: Vec<f64>,
    /// As `scale`, for each of [`Path::lanes`].
    lane_scale: Vec<f64>,
}

impl Path {
    /// A path along the given points \[m\] on a lane of the given width \[m\]; `None` if all points are one.
    pub fn from_points(points: impl IntoIterator<Item = [f64; 2]>, width: f64) -> Option<Self> {
        let mut path = Self::empty();
        points.into_iter().for_each(|point| path.push(point, width));
        (path.points.len() >= 2).then_some(path)
    }

    /// The path along lanes of a net; `None` if it has no extent.
    pub(super) fn through(net: &Net, lanes: &[usize]) -> Option<Self> {
        let mut path = Self::empty();
        let mut position = 0.0;
        for &index in lanes {
            let lane = &net.lanes[index];
            let edge = &net.edges[lane.edge];
            // Without internal lanes there is a gap at the junction: the way over it belongs to neither edge.
            if let Some(&first) = lane.shape.first() {
                path.push(first, lane.width);
            }
            let start = path.length();
            lane.shape.iter().for_each(|&point| path.push(point, lane.width));
            path.lane_position.push(position);
            path.lane_start.push(start);
            path.lane_scale.push((path.length() - start) / lane.length);
            position += lane.length;
            if edge.function == super::EdgeFunction::Normal {
                path.edges.push(edge.id.clone());
                path.edge_start.push(start);
                path.edge_length.push(path.length() - start);
                path.scale.push((path.length() - start) / lane.length);
            }
        }
        path.lanes = lanes.to_vec();
        (path.points.len() >= 2).then_some(path)
    }

    /// The path of a walk: lanes, and whether each is walked against its shape; `None` if it has no extent.
    pub(super) fn on_foot(net: &Net, steps: &[(usize, bool)]) -> Option<Self> {
        let mut path = Self::empty();
        for &(index, backwards) in steps {
            let lane = &net.lanes[index];
            if backwards {
                lane.shape.iter().rev().for_each(|&point| path.push(point, lane.width));
            } else {
                lane.shape.iter().for_each(|&point| path.push(point, lane.width));
            }
        }
        (path.points.len() >= 2).then_some(path)
    }

    /// The same with what lies between two of its points, by their indices, replaced by `points`. The lanes there are as much longer in
    /// metres of this path per metre of SUMO's.
    #[must_use]
    pub fn detoured(
        &self,
        from: usize,
        to: usize,
        points: impl IntoIterator<Item = [f64; 2]>,
    ) -> Self {
        let mut path = Self::empty();
        let width = self.widths[from.saturating_sub(1)];
        self.points[..=from]
            .iter()
            .zip([width].iter().chain(&self.widths))
            .for_each(|(&point, &w)| path.push(point, w));
        points.into_iter().for_each(|point| path.push(point, width));
        path.push(self.points[to], width);
        let (begin, old, new) = (self.cumulative[from], self.cumulative[to], path.length());
        self.points[to + 1..]
            .iter()
            .zip(&self.widths[to..])
            .for_each(|(&point, &w)| path.push(point, w));
        let factor = (new - begin) / (old - begin);
        let moved = |s: f64| {
            if s <= begin {
                s
            } else if s < old {
                begin + (s - begin) * factor
            } else {
                s + new - old
            }
        };
        let longer = |start: f64, end: f64| (moved(end) - moved(start)) / (end - start);
        let starts = |starts: &[f64]| starts.iter().map(|&s| moved(s)).collect::<Vec<_>>();
        let edges = || self.edge_start.iter().zip(&self.edge_length);
        Self {
            edges: self.edges.clone(),
            edge_start: starts(&self.edge_start),
            edge_length: edges()
                .map(|(&start, &length)| moved(start + length) - moved(start))
                .collect(),
            scale: edges()
                .zip(&self.scale)
                .map(|((&s, &length), scale)| scale * longer(s, s + length))
                .collect(),
            lanes: self.lanes.clone(),
            lane_position: self.lane_position.clone(),
            lane_start: starts(&self.lane_start),
            lane_scale: self
                .lane_stretches()
                .zip(&self.lane_scale)
                .map(|((_, s, end), scale)| scale * longer(s, end))
                .collect(),
            ..path
        }
    }

    fn empty() -> Self {
        Self {
            points: Vec::new(),
            cumulative: Vec::new(),
            widths: Vec::new(),
            edges: Vec::new(),
            edge_start: Vec::new(),
            edge_length: Vec::new(),
            lanes: Vec::new(),
            scale: Vec::new(),
            headings: Vec::new(),
            directions: Vec::new(),
            lane_position: Vec::new(),
            lane_start: Vec::new(),
            lane_scale: Vec::new(),
        }
    }

    fn push(&mut self, point: [f64; 2], width: f64) {
        match self.points.last() {
            None => self.cumulative.push(0.0),
            Some(&[x, y]) => {
                let [dx, dy] = [point[0] - x, point[1] - y];
                let distance = dx.hypot(dy);
                let s = self.length() + distance;
                // At the far end of a very long path, short ways are lost in rounding.
                if s - self.length() < SAME_POINT {
                    return;
                }
                self.cumulative.push(s);
                self.widths.push(width);
                self.headings.push(dy.atan2(dx));
                self.directions.push([dx / distance, dy / distance]);
            }
        }
        self.points.push(point);
    }

    /// Length of the whole path \[m\].
    pub fn length(&self) -> f64 {
        self.cumulative.last().copied().unwrap_or(0.0)
    }

    /// `s` of a SUMO lane position \[m\] on one of [`Path::edges`]; a negative position counts from the edge's end.
    /// `None` if there is no such edge.
    pub fn arc(&self, edge: usize, pos: f64) -> Option<f64> {
        let (start, length, scale) =
            (self.edge_start.get(edge)?, self.edge_length.get(edge)?, self.scale.get(edge)?);
        Some(start + scale * pos + if pos < 0.0 { *length } else { 0.0 })
    }

    /// The lanes passed, as indices into [`Net::lanes`], and the `s` at which each begins and ends.
    pub fn lane_stretches(&self) -> impl Iterator<Item = (usize, f64, f64)> + '_ {
        let ends = self.lane_start.iter().skip(1).copied().chain([self.length()]);
        self.lanes
            .iter()
            .zip(&self.lane_start)
            .zip(ends)
            .map(|((lane, start), end)| (*lane, *start, end))
    }

    /// `s` of a place that lies `distance` metres from the start of the route in SUMO's count, which adds up lengths of
    /// lanes. The same as `distance` where lanes are as long as their shapes.
    pub fn arc_of_distance(&self, distance: f64) -> f64 {
        let lane = self.lane_position.partition_point(|&p| p <= distance).saturating_sub(1);
        match (self.lane_position.get(lane), self.lane_start.get(lane), self.lane_scale.get(lane)) {
            (Some(position), Some(start), Some(scale)) => start + scale * (distance - position),
            _ => distance,
        }
    }

    /// SUMO's count of the way from the start to `s` \[m\]: what [`Path::arc_of_distance`] takes.
    pub fn distance_of_arc(&self, s: f64) -> f64 {
        let lane = self.lane_start.partition_point(|&start| start <= s).saturating_sub(1);
        match (self.lane_position.get(lane), self.lane_start.get(lane), self.lane_scale.get(lane)) {
            (Some(position), Some(start), Some(scale)) => position + (s - start) / scale,
            _ => s,
        }
    }

    /// Point \[m\] and segment at `s`.
    pub fn locate(&self, s: f64) -> ([f64; 2], usize) {
        let after = self.cumulative.partition_point(|&c| c <= s);
        let segment = after.saturating_sub(1).min(self.last_segment());
        (self.point_on(segment, s), segment)
    }

    /// As [`Path::locate`], looked for from the segment `hint` on: for places that follow upon one another.
    pub fn locate_from(&self, s: f64, hint: usize) -> ([f64; 2], usize) {
        let mut segment = hint.min(self.last_segment());
        while segment < self.last_segment() && self.cumulative[segment + 1] <= s {
            segment += 1;
        }
        while segment > 0 && self.cumulative[segment] > s {
            segment -= 1;
        }
        (self.point_on(segment, s), segment)
    }

    fn point_on(&self, segment: usize, s: f64) -> [f64; 2] {
        let ([x, y], [dx, dy]) = (self.points[segment], self.directions[segment]);
        let along = s - self.cumulative[segment];
        [x + along * dx, y + along * dy]
    }

    /// Pose of a body of `length` metres whose front is at `s` and whose back follows on the path: the front point
    /// \[m\], the heading \[rad\], and the segment of the front. SUMO lays vehicles on lanes in this way.
    pub fn body(&self, s: f64, length: f64) -> ([f64; 2], f64, usize) {
        let (front, segment) = self.locate(s);
        let (back, last) = self.locate(s - length);
        let heading = if segment == last {
            self.headings[segment]
        } else {
            (front[1] - back[1]).atan2(front[0] - back[0])
        };
        (front, heading, segment)
    }

    /// Point \[m\] and heading \[rad, counter-clockwise from +x\] at `s`.
    pub fn at(&self, s: f64) -> ([f64; 2], f64) {
        let (point, segment) = self.locate(s);
        (point, self.headings[segment])
    }

    /// Heading at `s` as of a curve through the points: that of a segment in its middle, and in between by how far it is from one middle to
    /// the next \[rad\].
    pub fn smooth_heading(&self, s: f64) -> f64 {
        let (_, segment) = self.locate(s);
        let middle = |i: usize| f64::midpoint(self.cumulative[i], self.cumulative[i + 1]);
        let other = if s < middle(segment) {
            segment.saturating_sub(1)
        } else {
            (segment + 1).min(self.last_segment())
        };
        if other == segment {
            return self.headings[segment];
        }
        let share = ((s - middle(segment)) / (middle(other) - middle(segment))).clamp(0.0, 1.0);
        let turn = self.headings[other] - self.headings[segment];
        self.headings[segment] + turn.sin().atan2(turn.cos()) * share
    }

    /// `s`, lateral offset (positive to the left) and segment of the place on the path next to a point.
    ///
    /// The search starts at the segment `hint` and goes on to neighbouring segments as long as they are nearer: give
    /// the segment of the last call for a vehicle that has moved on a little, or see [`Path::nearest`].
    pub fn project(&self, point: [f64; 2], hint: usize) -> (f64, f64, usize) {
        let mut segment = hint.min(self.last_segment());
        let mut best = self.project_on(point, segment);
        loop {
            let neighbours = [segment + 1, segment.wrapping_sub(1)];
            let nearer =
                neighbours.into_iter().filter(|&i| i <= self.last_segment()).find_map(|i| {
                    let projected = self.project_on(point, i);
                    (projected.1.abs() < best.1.abs()).then_some((i, projected))
                });
            match nearer {
                Some((i, projected)) => (segment, best) = (i, projected),
                None => return (best.0, best.1, segment),
            }
        }
    }

    /// As [`Path::project`], over all segments.
    pub fn nearest(&self, point: [f64; 2]) -> (f64, f64, usize) {
        self.nearest_of(point, 0..self.last_segment() + 1)
    }

    /// As [`Path::nearest`], over some segments.
    pub fn nearest_of(&self, point: [f64; 2], segments: Range<usize>) -> (f64, f64, usize) {
        let all = segments.map(|i| {
            let (s, lateral) = self.project_on(point, i);
            (s, lateral, i)
        });
        all.min_by(|a, b| a.1.abs().total_cmp(&b.1.abs())).unwrap_or_default()
    }

    fn last_segment(&self) -> usize {
        self.points.len().saturating_sub(2)
    }

    /// Unit vector of a segment.
    pub fn direction(&self, segment: usize) -> [f64; 2] {
        self.directions[segment]
    }

    /// `s` and signed distance of the point of one segment next to `point`.
    fn project_on(&self, point: [f64; 2], segment: usize) -> (f64, f64) {
        let ([x, y], [dx, dy]) = (self.points[segment], self.directions[segment]);
        let length = self.cumulative[segment + 1] - self.cumulative[segment];
        let (px, py) = (point[0] - x, point[1] - y);
        let (along, left) = (px * dx + py * dy, dx * py - dy * px);
        let least = if segment == 0 { f64::NEG_INFINITY } else { 0.0 };
        let most = if segment == self.last_segment() { f64::INFINITY } else { length };
        let clamped = along.max(least).min(most);
        let beyond = along - clamped;
        let lateral = (beyond * beyond + left * left).sqrt().copysign(left);
        (self.cumulative[segment] + clamped, lateral)
    }
}
