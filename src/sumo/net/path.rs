//! The centre line of a route as a polyline, with arc length along it.
//!
//! `s` is the arc length \[m\] from the start of the route's first edge. The lateral offset is the
//! distance from the centre line \[m\], positive to the LEFT. Beyond both ends, the first and the
//! last segment continue straight, so that positions and projections are inverse to each other
//! there too.

use std::ops::Range;

use super::Net;

/// Points closer to each other than this count as one point \[m\].
const SAME_POINT: f64 = 1e-6;

/// The centre line of a route, built by [`Net::route_path`] or [`Path::from_points`].
#[derive(Debug, Clone, PartialEq)]
pub struct Path {
    /// Points in driving order \[m\]: at least two, with no two consecutive points equal.
    pub points: Vec<[f64; 2]>,
    /// `s` of each point \[m\], ascending from 0.
    pub cumulative: Vec<f64>,
    /// Width of the lane at each segment \[m\]; one value fewer than points.
    pub widths: Vec<f64>,
    /// Ids of the route's edges; empty if the path was built from points.
    pub edges: Vec<String>,
    /// `s` at the start of each of [`Path::edges`] \[m\].
    pub edge_start: Vec<f64>,
    /// Length of each of [`Path::edges`] along the centre line \[m\].
    pub edge_length: Vec<f64>,
    /// All lanes of the route, including internal ones, as indices into [`Net::lanes`]; empty if
    /// the path was built from points.
    pub lanes: Vec<usize>,
    /// Metres of centre line per metre of SUMO's lane position, for each of [`Path::edges`]; 1 in
    /// most nets.
    scale: Vec<f64>,
    /// Heading of each segment \[rad\].
    headings: Vec<f64>,
    /// Unit vector of each segment.
    directions: Vec<[f64; 2]>,
    /// Start of each of [`Path::lanes`] in SUMO's distance along the route \[m\].
    lane_position: Vec<f64>,
    /// `s` at the start of each of [`Path::lanes`] \[m\].
    lane_start: Vec<f64>,
    /// Like `scale`, for each of [`Path::lanes`].
    lane_scale: Vec<f64>,
    /// Lanes of a walk: the lane, whether it is walked against its shape, and the `s` where it
    /// begins \[m\]; empty if vehicles drive the path.
    walked: Vec<(usize, bool, f64)>,
}

impl Path {
    /// Returns the path along points \[m\] on a lane of the given width \[m\]; `None` if all points
    /// coincide.
    pub fn from_points(points: impl IntoIterator<Item = [f64; 2]>, width: f64) -> Option<Self> {
        let mut path = Self::empty();
        points.into_iter().for_each(|point| path.push(point, width));
        (path.points.len() >= 2).then_some(path)
    }

    /// Returns the path along lanes of a net; `None` if the path has no extent.
    pub(super) fn through(net: &Net, lanes: &[usize]) -> Option<Self> {
        let mut path = Self::empty();
        let mut position = 0.0;
        for &index in lanes {
            let lane = &net.lanes[index];
            let edge = &net.edges[lane.edge];
            // Without internal lanes, the junction leaves a gap between the edges; the segment
            // across it belongs to neither edge.
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

    /// Returns the path of a walk along lanes, each with a flag for walking against its shape;
    /// `None` if the path has no extent.
    pub(super) fn on_foot(net: &Net, steps: &[(usize, bool)]) -> Option<Self> {
        let mut path = Self::empty();
        for &(index, backwards) in steps {
            let lane = &net.lanes[index];
            let (first, last) = (lane.shape.first(), lane.shape.last());
            if let Some(&start) = if backwards { last } else { first } {
                path.push(start, lane.width);
            }
            path.walked.push((index, backwards, path.length()));
            if backwards {
                lane.shape.iter().rev().for_each(|&point| path.push(point, lane.width));
            } else {
                lane.shape.iter().for_each(|&point| path.push(point, lane.width));
            }
        }
        (path.points.len() >= 2).then_some(path)
    }

    /// Returns the path with the part between the points at the indices `from` and `to` replaced by
    /// `points`. The lanes there keep their lengths in SUMO, so that their metres of path per metre
    /// of SUMO's distance change in proportion.
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
            walked: self.walked.clone(),
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
            walked: Vec::new(),
        }
    }

    fn push(&mut self, point: [f64; 2], width: f64) {
        match self.points.last() {
            None => self.cumulative.push(0.0),
            Some(&[x, y]) => {
                let [dx, dy] = [point[0] - x, point[1] - y];
                let distance = dx.hypot(dy);
                let s = self.length() + distance;
                // The rounded sum counts: at the end of a very long path, short distances vanish in
                // rounding.
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

    /// Returns the length of the whole path \[m\].
    pub fn length(&self) -> f64 {
        self.cumulative.last().copied().unwrap_or(0.0)
    }

    /// Returns the `s` of a SUMO lane position \[m\] on one of [`Path::edges`]; a negative position
    /// counts from the edge's end. `None` if no such edge exists.
    pub fn arc(&self, edge: usize, pos: f64) -> Option<f64> {
        let (start, length, scale) =
            (self.edge_start.get(edge)?, self.edge_length.get(edge)?, self.scale.get(edge)?);
        Some(start + scale * pos + if pos < 0.0 { *length } else { 0.0 })
    }

    /// Returns the SUMO lane position \[m\] that lies `metres` of path ahead of the position `pos` on
    /// the first edge.
    pub fn ahead(&self, pos: f64, metres: f64) -> f64 {
        self.arc(0, pos).map_or(pos + metres, |s| self.distance_of_arc(s + metres))
    }

    /// Returns the lanes of the route, as indices into [`Net::lanes`], with the `s` where each
    /// begins and ends.
    pub fn lane_stretches(&self) -> impl Iterator<Item = (usize, f64, f64)> + '_ {
        let ends = self.lane_start.iter().skip(1).copied().chain([self.length()]);
        self.lanes
            .iter()
            .zip(&self.lane_start)
            .zip(ends)
            .map(|((lane, start), end)| (*lane, *start, end))
    }

    /// Returns the positions at the ends of lanes at which the path changes to another lane of the
    /// same edge \[m\].
    pub fn lane_changes<'p>(&'p self, net: &'p Net) -> impl Iterator<Item = f64> + 'p {
        let stretches = || self.lane_stretches();
        let pairs = stretches().zip(stretches().skip(1));
        let leads = |from: usize, to: usize| {
            net.connections_from(from).any(|c| c.via.unwrap_or(c.to) == to || c.to == to)
        };
        pairs.filter(move |((from, ..), (to, ..))| !leads(*from, *to)).map(|((.., end), _)| end)
    }

    /// Returns the lane at `s`, as an index into [`Net::lanes`], and the position on it in SUMO's
    /// metres, also for walks. A position beyond a lane's end is in a gap of the path between two
    /// lanes. `None` if the path was built from points.
    pub(crate) fn lane_at(&self, net: &Net, s: f64) -> Option<(usize, f64)> {
        let last = |starts: usize| starts.saturating_sub(1);
        if self.lanes.is_empty() {
            let at = last(self.walked.partition_point(|(_, _, start)| *start <= s));
            let &(lane, backwards, start) = self.walked.get(at)?;
            let length = net.lanes[lane].length;
            return Some((lane, if backwards { length - (s - start) } else { s - start }));
        }
        let at = last(self.lane_start.partition_point(|&start| start <= s));
        Some((*self.lanes.get(at)?, (s - self.lane_start[at]) / self.lane_scale[at]))
    }

    /// Returns the `s` at `distance` metres from the start of the route in SUMO's distance, which
    /// adds up lengths of lanes. The result equals `distance` where lanes are as long as their
    /// shapes.
    pub fn arc_of_distance(&self, distance: f64) -> f64 {
        let lane = self.lane_position.partition_point(|&p| p <= distance).saturating_sub(1);
        match (self.lane_position.get(lane), self.lane_start.get(lane), self.lane_scale.get(lane)) {
            (Some(position), Some(start), Some(scale)) => start + scale * (distance - position),
            _ => distance,
        }
    }

    /// Returns SUMO's distance from the start of the route to `s` \[m\], the inverse of
    /// [`Path::arc_of_distance`].
    pub fn distance_of_arc(&self, s: f64) -> f64 {
        let lane = self.lane_start.partition_point(|&start| start <= s).saturating_sub(1);
        match (self.lane_position.get(lane), self.lane_start.get(lane), self.lane_scale.get(lane)) {
            (Some(position), Some(start), Some(scale)) => position + (s - start) / scale,
            _ => s,
        }
    }

    /// Returns the point \[m\] and the segment at `s`.
    pub fn locate(&self, s: f64) -> ([f64; 2], usize) {
        let after = self.cumulative.partition_point(|&c| c <= s);
        let segment = after.saturating_sub(1).min(self.last_segment());
        (self.point_on(segment, s), segment)
    }

    /// Like [`Path::locate`], with a search that starts at the segment `hint`: for successive
    /// positions that lie close together.
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

    /// Returns the pose of a body of `length` metres whose front is at `s` and whose rear follows
    /// on the path: the front point \[m\], the heading \[rad\], and the segment of the front. SUMO
    /// computes the poses of vehicles on lanes in the same way.
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

    /// Returns the point \[m\] and the heading \[rad, counter-clockwise from +x\] at `s`.
    pub fn at(&self, s: f64) -> ([f64; 2], f64) {
        let (point, segment) = self.locate(s);
        (point, self.headings[segment])
    }

    /// Returns the heading at `s` of a smooth curve through the points \[rad\]: in the middle of a
    /// segment the heading of the segment, and between two middles a linear interpolation.
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

    /// Projects a point onto the path: returns `s`, lateral offset (positive to the left) and
    /// segment of the closest position.
    ///
    /// The search starts at the segment `hint` and moves to neighbouring segments as long as they
    /// are closer. For a vehicle that has moved a little, pass the segment of the last call;
    /// otherwise see [`Path::nearest`].
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

    /// Like [`Path::project`], with a search over all segments.
    pub fn nearest(&self, point: [f64; 2]) -> (f64, f64, usize) {
        self.nearest_of(point, 0..self.last_segment() + 1)
    }

    /// Like [`Path::nearest`], with a search over the given segments.
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

    /// Returns the unit vector of a segment.
    pub fn direction(&self, segment: usize) -> [f64; 2] {
        self.directions[segment]
    }

    /// Projects a point onto one segment: returns `s` and the signed distance.
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
