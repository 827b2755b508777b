//! The routes' paths and how they relate to each other: shared lanes, crossings and merges.

use super::geometry::{Pose, Size, boxes_overlap};
use crate::sumo::net::Path;

/// A route's path and its relation to the other routes. All positions are arc lengths from the
/// route's start \[m\].
#[derive(Debug, Clone)]
pub struct RouteGeometry {
    /// Curve that vehicles follow: the centre line of the route's lanes, with a detour where the
    /// centre line turns back more sharply than a vehicle that steers can.
    pub path: Path,
    /// Centre line of the route's lanes, if [`RouteGeometry::path`] differs from it.
    pub avoided: Option<Path>,
    /// SUMO's index of the lane of the first edge on which the route begins.
    pub first_lane: u32,
    /// Position that the centre of an agent must reach to arrive.
    pub arrival: f64,
    /// Lateral offsets, right and left, between which an agent that steers arrives: they span all
    /// lanes of the last edge \[m\].
    pub finish: [f64; 2],
    /// The first conflict with each route that crosses or merges with this one, in the order in
    /// which they lie along this route.
    pub conflicts: Vec<Conflict>,
    /// Routes without a conflict with this one.
    pub apart: Vec<usize>,
    /// Conflicts with every route, in the order in which they lie along this route. The first of
    /// each route is its entry in [`RouteGeometry::conflicts`].
    by_route: Vec<Vec<Conflict>>,
    /// For every route, the stretches that it shares with this one.
    shared: Vec<Vec<Shared>>,
}

/// A conflict with another route: the point where the two paths cross or merge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Conflict {
    /// The other route.
    pub route: usize,
    /// Position of the conflict point on this route.
    pub own: f64,
    /// Position of the conflict point on the other route.
    pub other: f64,
}

/// A stretch of another route on which vehicles count as on this route, too.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Shared {
    /// Beginning of the stretch, as a position on the other route.
    from: f64,
    /// End of the stretch, as a position on the other route.
    to: f64,
    /// Position on this route minus the position of the same place on the other route.
    shift: f64,
}

/// Lateral distance between paths from which vehicles on them pass each other \[m\].
const APART: f64 = 2.5;
/// Distance between the positions at which paths are compared \[m\].
const STEP: f64 = 0.25;

impl RouteGeometry {
    /// Returns the centre line of the route's lanes, along which SUMO positions vehicles.
    pub fn lanes(&self) -> &Path {
        self.avoided.as_ref().unwrap_or(&self.path)
    }

    /// Converts a position on [`RouteGeometry::lanes`] into a position on [`RouteGeometry::path`].
    pub fn on_path(&self, s: f64) -> f64 {
        self.avoided.as_ref().map_or(s, |lanes| self.path.arc_of_distance(lanes.distance_of_arc(s)))
    }

    /// Returns the position on this route of a vehicle at `s` on `route`, if that vehicle is on a
    /// lane of both routes, or so close behind a fork or before a merge that it still blocks this
    /// route; `None` otherwise.
    pub fn shared_position(&self, route: usize, s: f64) -> Option<f64> {
        self.shared[route].iter().find(|k| (k.from..=k.to).contains(&s)).map(|k| s + k.shift)
    }

    /// Returns whether pedestrians walk this route.
    pub fn is_walked(&self) -> bool {
        self.path.lanes.is_empty()
    }

    /// Returns the first conflict with `route`, in the order of this route.
    pub fn conflict_with(&self, route: usize) -> Option<Conflict> {
        self.by_route[route].first().copied()
    }

    /// Returns the next conflict between a vehicle at `own` on this route and one at `other` on
    /// `route`. A conflict counts until one of the two is more than `cleared` metres past it.
    pub fn next_conflict(
        &self,
        own: f64,
        route: usize,
        other: f64,
        cleared: f64,
    ) -> Option<Conflict> {
        let ahead = |met: &&Conflict| met.own - own >= -cleared && met.other - other >= -cleared;
        self.by_route[route].iter().find(ahead).copied()
    }

    /// Returns the distance from `s` to the first conflict point, or to the arrival if the route
    /// has no conflict \[m\].
    pub fn to_first_conflict(&self, s: f64) -> f64 {
        self.conflicts.first().map_or(self.arrival, |c| c.own) - s
    }
}

/// Works out the geometry of route number `a` of `paths` for vehicles of this size. `detoured`
/// marks the paths that leave their lanes for a detour; `arrival_pos` is the finish on the route's
/// last edge \[m\], and a negative value counts from the edge's end.
pub(super) fn geometry(
    paths: &[Path],
    detoured: &[bool],
    a: usize,
    arrival_pos: f64,
    size: Size,
) -> RouteGeometry {
    let path = &paths[a];
    let arrival = path.edges.len().checked_sub(1).and_then(|last| path.arc(last, arrival_pos));
    let arrival = arrival.unwrap_or_else(|| path.length());
    let shared: Vec<Vec<Shared>> =
        (0..paths.len()).map(|b| shared_stretches(path, &paths[b], a == b)).collect();
    let mut by_route = vec![Vec::new(); paths.len()];
    for (b, other) in paths.iter().enumerate().filter(|&(b, _)| b != a) {
        let met = if detoured[a] || detoured[b] {
            conflicts_around(path, other, &shared[b], size)
        } else {
            let first = first_conflict(path, other, &shared[b]);
            first.or_else(|| near_miss(path, other, &shared[b])).into_iter().collect()
        };
        by_route[b] =
            met.into_iter().map(|(own, other)| Conflict { route: b, own, other }).collect();
    }
    let mut conflicts: Vec<Conflict> =
        by_route.iter().filter_map(|met| met.first().copied()).collect();
    let apart = (0..paths.len()).filter(|&b| b != a && by_route[b].is_empty()).collect();
    conflicts.sort_by(|x, y| x.own.total_cmp(&y.own).then(x.route.cmp(&y.route)));
    let pairs = shared.into_iter().zip(paths).zip(&by_route);
    let shared = pairs.map(|((mut stretches, other), met)| {
        stretches.extend(met.first().and_then(|met| coinciding_stretch(path, other, *met)));
        extended(path, other, stretches, size)
    });
    let shared = shared.collect();
    let half = path.widths.last().copied().unwrap_or_default() / 2.0;
    RouteGeometry {
        path: path.clone(),
        avoided: None,
        first_lane: 0,
        arrival,
        finish: [-half, half],
        conflicts,
        apart,
        by_route,
        shared,
    }
}

/// Returns the first metre of a stretch on which the two centre lines coincide although they
/// belong to different lanes, if the conflict `met` is the beginning of such a stretch.
fn coinciding_stretch(own: &Path, other: &Path, met: Conflict) -> Option<Shared> {
    let together = |distance: f64| {
        let ([x, y], [u, v]) = (other.at(met.other + distance).0, own.at(met.own + distance).0);
        (x - u).hypot(y - v) < 0.1
    };
    let stretch = Shared { from: met.other, to: met.other + 1.0, shift: met.own - met.other };
    [0.0, 0.5, 1.0].into_iter().all(together).then_some(stretch)
}

/// Returns where the centre lines of two routes that share no lane are nearest, if they are so
/// close there that vehicles in a curve would touch.
fn near_miss(own: &Path, other: &Path, shared: &[Shared]) -> Option<(f64, f64)> {
    let driven = !own.lanes.is_empty() && !other.lanes.is_empty() && shared.is_empty();
    // Of two lines that do not cross, the nearest place is at a point of one of them.
    let beside = |line: &Path, points: &Path| {
        let near = |(point, &at): (&[f64; 2], &f64)| {
            let (s, lateral, _) = line.nearest(*point);
            ((0.0..=line.length()).contains(&s) && lateral.abs() < APART).then_some((
                lateral.abs(),
                s,
                at,
            ))
        };
        points
            .points
            .iter()
            .zip(&points.cumulative)
            .filter_map(near)
            .min_by(|x, y| x.0.total_cmp(&y.0))
    };
    let both = || {
        beside(own, other).into_iter().chain(beside(other, own).map(|(gap, s, at)| (gap, at, s)))
    };
    if driven { both().min_by(|x, y| x.0.total_cmp(&y.0)).map(|(_, s, at)| (s, at)) } else { None }
}

/// Extends each stretch as far as a vehicle on `other` blocks a vehicle on `own`: behind a fork,
/// until its rear no longer reaches into the path of `own`; before a merge, to where the two
/// centre lines begin to coincide.
fn extended(own: &Path, other: &Path, stretches: Vec<Shared>, size: Size) -> Vec<Shared> {
    /// Centre lines at most this far apart coincide \[m\].
    const CLOSE: f64 = 0.3;
    /// Margin added to the length and width of the vehicle on the other route, since no vehicle
    /// keeps to the centre line exactly \[m\].
    const MARGIN: f64 = 0.3;
    let in_the_way = |s: f64, shift: f64| {
        let (there, grown) = (Pose::on(other, s), size.map(|x| x + MARGIN));
        let reach = (2.0 * size[0] / STEP) as i32;
        (-reach..=reach).any(|k| {
            boxes_overlap((&Pose::on(own, s + shift + f64::from(k) * STEP), size), (&there, grown))
        })
    };
    let one = |s: f64, shift: f64| Pose::on(other, s).distance(&Pose::on(own, s + shift)) < CLOSE;
    let (end, own_end) = (other.length(), own.length());
    let extend = |mut stretch: Shared| {
        while stretch.to < end
            && stretch.to + stretch.shift < own_end
            && in_the_way(stretch.to, stretch.shift)
        {
            stretch.to += STEP;
        }
        while stretch.from > 0.0
            && stretch.from + stretch.shift > 0.0
            && one(stretch.from, stretch.shift)
        {
            stretch.from -= STEP;
        }
        stretch
    };
    stretches.into_iter().map(extend).collect()
}

/// Returns the stretches of lanes that both routes use, without any extension.
fn shared_stretches(own: &Path, other: &Path, same: bool) -> Vec<Shared> {
    if same {
        return vec![Shared { from: f64::NEG_INFINITY, to: f64::INFINITY, shift: 0.0 }];
    }
    let mut stretches = Vec::new();
    for (lane, start, _) in own.lane_stretches() {
        if let Some((_, from, to)) = other.lane_stretches().find(|stretch| stretch.0 == lane) {
            stretches.push(Shared { from, to, shift: start - from });
        }
    }
    stretches
}

/// Returns the first point, in driving order of `own`, where the centre line of `other` crosses or
/// touches it outside the lanes that both use, as positions on `own` and `other`.
fn first_conflict(own: &Path, other: &Path, shared: &[Shared]) -> Option<(f64, f64)> {
    if let Some(exit_conflict) = exit_conflict(own, other) {
        return Some(exit_conflict);
    }
    for i in 1..own.points.len() {
        let mut best: Option<(f64, f64)> = None;
        for j in 1..other.points.len() {
            let middle = f64::midpoint(other.cumulative[j - 1], other.cumulative[j]);
            if shared.iter().any(|k| (k.from..=k.to).contains(&middle)) {
                continue;
            }
            let [a, b] = [own.points[i - 1], own.points[i]];
            let [c, d] = [other.points[j - 1], other.points[j]];
            if let Some((t, u)) =
                crossing(a, b, c, d).or_else(|| overlap(a, b, c, d).map(|lies| lies[0]))
            {
                let found = (along(own, i, t), along(other, j, u));
                // Two routes that fork from one lane touch at the fork, which is no conflict.
                let fork = shared.iter().any(|k| (found.1 - k.to).abs() < 0.5);
                if !fork && best.is_none_or(|b| found.0 < b.0) {
                    best = Some(found);
                }
            }
        }
        if best.is_some() {
            return best;
        }
    }
    None
}

/// Returns the conflicts between two paths of which at least one has a detour, in driving order of
/// `own`, as positions on `own` and `other`. Such paths may come near each other several times.
/// Each stretch on which vehicles of this size would touch gives the place where the paths are
/// nearest and, if the stretch is long, further places before and behind it.
fn conflicts_around(own: &Path, other: &Path, shared: &[Shared], size: Size) -> Vec<(f64, f64)> {
    /// Distance between the places of one stretch, in steps of [`STEP`].
    const SPACING: usize = (4.0 / STEP) as usize;
    let diagonal = size[0].hypot(size[1]);
    let reach = (diagonal / STEP) as i32;
    // `stretch` holds the gaps and places of the current stretch. A stretch that begins at a fork
    // is no conflict.
    let (mut found, mut stretch, mut forked) = (Vec::new(), Vec::new(), false);
    for s in (0..=(own.length() / STEP) as u32).map(|k| f64::from(k) * STEP) {
        let here = Pose::on(own, s);
        let (at, gap, _) = other.nearest([here.x, here.y]);
        let gap = gap.abs();
        let common = shared
            .iter()
            .any(|k| (k.from..=k.to).contains(&at) && (at + k.shift - s).abs() < 2.0 * STEP);
        let touch = |k: i32| {
            boxes_overlap((&here, size), (&Pose::on(other, at + f64::from(k) * STEP), size))
        };
        let near = gap < APART || gap < diagonal && (-reach..=reach).any(touch);
        forked = common || forked && near;
        if near && !forked {
            stretch.push((gap, (s, at)));
        } else {
            found.extend(spaced(&std::mem::take(&mut stretch), SPACING));
        }
    }
    found.extend(spaced(&stretch, SPACING));
    found
}

/// Returns the place with the smallest gap, and the places at multiples of `spacing` from it.
fn spaced(places: &[(f64, (f64, f64))], spacing: usize) -> impl Iterator<Item = (f64, f64)> {
    let nearest =
        (0..places.len()).min_by(|&i, &j| places[i].0.total_cmp(&places[j].0)).unwrap_or(0);
    places.iter().skip(nearest % spacing).step_by(spacing).map(|(_, place)| *place)
}

/// Returns the conflict of a route that begins on the path by which `other` arrives, such as a
/// route out of a parking space that `other` ends in. The conflict is at the end of their common
/// stretch, where the vehicle on `own` is out and the one on `other` is not yet in. It is not at
/// the start of `own`, which that vehicle would have passed at once.
fn exit_conflict(own: &Path, other: &Path) -> Option<(f64, f64)> {
    /// Common stretches whose distance is at most this are one stretch \[m\].
    const GAP: f64 = 0.1;
    let mut end: Option<(f64, f64)> = None;
    for i in 1..own.points.len() {
        let reached = end.map_or(0.0, |(s, _)| s);
        let common = (1..other.points.len()).rev().find_map(|j| {
            let lies =
                overlap(own.points[i - 1], own.points[i], other.points[j - 1], other.points[j])?;
            let [first, last] = lies.map(|(t, u)| (along(own, i, t), along(other, j, u)));
            (last.1 < first.1 && first.0 <= reached + GAP && last.0 > reached + GAP).then_some(last)
        });
        if common.is_none() {
            break;
        }
        end = common;
    }
    end
}

/// Returns the position on a path at fraction `t` of its segment that ends at point number `k`.
fn along(path: &Path, k: usize, t: f64) -> f64 {
    path.cumulative[k - 1] + t * (path.cumulative[k] - path.cumulative[k - 1])
}

/// Returns where the segments `ab` and `cd` cross, as fractions of both. Parallel segments do not
/// cross.
pub(super) fn crossing(a: [f64; 2], b: [f64; 2], c: [f64; 2], d: [f64; 2]) -> Option<(f64, f64)> {
    let (r, s) = ([b[0] - a[0], b[1] - a[1]], [d[0] - c[0], d[1] - c[1]]);
    let cross = r[0] * s[1] - r[1] * s[0];
    if cross.abs() < 1e-12 {
        return None;
    }
    let q = [c[0] - a[0], c[1] - a[1]];
    let t = (q[0] * s[1] - q[1] * s[0]) / cross;
    let u = (q[0] * r[1] - q[1] * r[0]) / cross;
    let inside = |x: f64| (-1e-9..=1.0 + 1e-9).contains(&x);
    (inside(t) && inside(u)).then_some((t, u))
}

/// Returns where `cd` begins and ceases to coincide with `ab`, in the direction of `ab` and as
/// fractions of both.
fn overlap(a: [f64; 2], b: [f64; 2], c: [f64; 2], d: [f64; 2]) -> Option<[(f64, f64); 2]> {
    /// Segments at most this far apart coincide \[m\].
    const CLOSE: f64 = 0.1;
    let (r, length) = ([b[0] - a[0], b[1] - a[1]], (b[0] - a[0]).hypot(b[1] - a[1]));
    if length == 0.0 {
        return None;
    }
    let along = |p: [f64; 2]| ((p[0] - a[0]) * r[0] + (p[1] - a[1]) * r[1]) / (length * length);
    let beside = |p: [f64; 2]| ((p[1] - a[1]) * r[0] - (p[0] - a[0]) * r[1]).abs() / length;
    let (from, to) = (along(c), along(d));
    let (first, last) = (from.min(to).max(0.0), from.max(to).min(1.0));
    let lies_on = beside(c) < CLOSE && beside(d) < CLOSE && (last - first) * length > CLOSE;
    lies_on.then(|| [first, last].map(|t| (t, (t - from) / (to - from))))
}
