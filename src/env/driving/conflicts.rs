//! Where two paths have conflicts: where they cross, merge or run along one strip on one level.
//! Paths that only pass over each other have none.

use super::agents::CLEARED;
use super::geometry::{Pose, Size, boxes_overlap};
use super::levels::Levels;
use super::shared::{STEP, Shared};
use crate::sumo::net::Path;

/// Lateral distance between paths from which vehicles on them pass each other \[m\].
const APART: f64 = 2.5;
/// Sum of half the widths of two wide vehicles, with a margin \[m\].
const WIDE: f64 = 3.0;
/// Centre lines at most this far apart lie on one strip \[m\].
const STRIP: f64 = 0.5;
/// Distance between two positions of one path within which its own bends are no conflict \[m\].
const BEND: f64 = 5.0;

/// A place where two vehicles could collide, as positions on both paths \[m\].
#[derive(Debug, Clone, Copy)]
pub(super) struct Place {
    pub(super) own: f64,
    pub(super) other: f64,
    /// Whether the paths come together here, in driving order of the first; otherwise a strip that
    /// they have in common goes on.
    pub(super) first: bool,
}

/// Stretches on which one path passes over or under another.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bridge {
    /// The other route.
    pub(super) route: usize,
    own: [f64; 2],
    other: [f64; 2],
}

impl Bridge {
    /// Whether two vehicles are on the stretches, at most `more` metres before or behind them.
    pub(super) fn covers(&self, own: f64, other: f64, more: f64) -> bool {
        let near = |[from, to]: [f64; 2], s: f64| (from - more..=to + more).contains(&s);
        near(self.own, own) && near(self.other, other)
    }
}

/// Where the centre lines of two paths cross or begin to coincide, as positions on both.
#[derive(Debug, Clone, Copy)]
struct Touch {
    at: (f64, f64),
    /// Where the two segments cease to coincide.
    to: (f64, f64),
    /// Whether the segments coincide and do not cross.
    along: bool,
    /// How far on both paths vehicles at the crossing overlap in the plane \[m\].
    reach: f64,
}

/// Two paths, or a path and itself.
pub(super) struct PathPair<'a> {
    pub(super) levels: &'a Levels<'a>,
    pub(super) own: &'a Path,
    pub(super) other: &'a Path,
    /// Stretches of lanes that both use.
    pub(super) shared: &'a [Shared],
    /// Whether both are one path.
    pub(super) same: bool,
    /// Length and width of a vehicle \[m\].
    pub(super) size: Size,
}

impl PathPair<'_> {
    /// Returns the conflicts, in driving order of the first path, and adds to `bridges` where the
    /// path of route number `route`, the second one, passes over or under the first. `around`:
    /// whether one of the paths has a detour.
    pub(super) fn meet(&self, route: usize, around: bool, bridges: &mut Vec<Bridge>) -> Vec<Place> {
        let mut found = Found { pair: self, places: Vec::new(), bands: Vec::new(), forked: false };
        if !self.same
            && let Some(end) = exit_conflict(self.own, self.other)
            && self.on_one_level(end, true)
        {
            found.add(end);
        }
        for i in 1..self.own.points.len() {
            let mut touches = self.touches(i);
            touches.sort_by(|a, b| a.at.0.total_cmp(&b.at.0));
            for touch in touches {
                if self.on_one_level(touch.at, touch.along) {
                    found.add(touch.at);
                } else {
                    let [own, other] = [[touch.at.0, touch.to.0], [touch.at.1, touch.to.1]]
                        .map(|[a, b]| [a.min(b) - touch.reach, a.max(b) + touch.reach]);
                    bridges.push(Bridge { route, own, other });
                }
            }
        }
        for (own, other) in self.passings() {
            let known = |b: &Bridge| b.route == route && b.covers(own, other, 0.0);
            if !bridges.iter().any(known) {
                bridges.push(self.bridge(route, (own, other)));
            }
        }
        if around {
            return conflicts_around(self);
        }
        for place in self.near_misses() {
            found.add(place);
        }
        let Found { mut places, .. } = found;
        places.sort_by(|a, b| a.own.total_cmp(&b.own));
        places
    }

    /// Whether vehicles at these positions of both paths are on one level. `along`: whether the
    /// paths run along each other there.
    fn on_one_level(&self, (own, other): (f64, f64), along: bool) -> bool {
        self.levels.meet((self.own, own), (self.other, other), along)
    }

    /// Returns where the second path crosses or touches segment number `i` of the first, outside
    /// the lanes that both use.
    fn touches(&self, i: usize) -> Vec<Touch> {
        let PathPair { own, other, shared, same, .. } = *self;
        let [a, b] = [own.points[i - 1], own.points[i]];
        let touch = |j: usize| {
            let ends = [other.cumulative[j - 1], other.cumulative[j]];
            let middle = f64::midpoint(ends[0], ends[1]);
            // On a common lane, one vehicle follows the other. A path that uses the lane several
            // times also comes to it from elsewhere.
            let common = |k: &Shared| {
                let [from, to] = ends.map(|u| u + k.shift);
                (k.from..=k.to).contains(&middle)
                    && from <= own.cumulative[i] + BEND
                    && own.cumulative[i - 1] <= to + BEND
            };
            if shared.iter().any(common) {
                return None;
            }
            let [c, d] = [other.points[j - 1], other.points[j]];
            let place = |(t, u)| (along(own, i, t), along(other, j, u));
            let touch = if let Some(at) = crossing(a, b, c, d) {
                let ([x, y], [u, v]) = (own.direction(i - 1), other.direction(j - 1));
                let reach = WIDE / (x * v - y * u).abs().max(0.1);
                Touch { at: place(at), to: place(at), along: false, reach }
            } else {
                let [first, last] = overlap(a, b, c, d)?.map(place);
                Touch { at: first, to: last, along: true, reach: 0.0 }
            };
            let (s, u) = touch.at;
            // Two routes that fork from one lane touch at the fork, which is no conflict.
            let fork =
                shared.iter().any(|k| (u - k.to).abs() < 0.5 && (s - k.to - k.shift).abs() < BEND);
            let bend = same && (s - u).abs() < BEND;
            // Nobody comes to a lane along the route that begins there.
            let begin = (s < 0.1 || u < 0.1)
                && shared
                    .iter()
                    .any(|k| (u - k.from).abs() < 0.5 && (s - k.from - k.shift).abs() < 0.5);
            (!fork && !bend && !begin).then_some(touch)
        };
        (1..other.points.len()).filter_map(touch).collect()
    }

    /// Returns where the centre lines of two routes that share no lane are so close that vehicles
    /// in a curve would touch, nearest first.
    fn near_misses(&self) -> Vec<(f64, f64)> {
        let PathPair { own, other, .. } = *self;
        if self.same || !self.shared.is_empty() || own.lanes.is_empty() || other.lanes.is_empty() {
            return Vec::new();
        }
        // Of two lines that do not cross, the nearest place is at a point of one of them.
        let beside = |line: &Path, points: &Path| {
            let mut places = Vec::new();
            for (point, &at) in points.points.iter().zip(&points.cumulative) {
                let (s, lateral, _) = line.nearest(*point);
                if (0.0..=line.length()).contains(&s) && lateral.abs() < APART {
                    places.push((lateral.abs(), s, at));
                }
            }
            places
        };
        let mut near = beside(own, other);
        near.extend(beside(other, own).into_iter().map(|(gap, s, at)| (gap, at, s)));
        near.retain(|&(_, s, at)| self.on_one_level((s, at), true));
        near.sort_by(|x, y| x.0.total_cmp(&y.0));
        near.into_iter().map(|(_, s, at)| (s, at)).collect()
    }

    /// Returns the places at which a point of one of the paths is beside the other path on another
    /// level, so near that vehicles there overlap in the plane.
    fn passings(&self) -> Vec<(f64, f64)> {
        let beside = |line: &Path, points: &Path| {
            let mut places = Vec::new();
            for (&point, &at) in points.points.iter().zip(&points.cumulative) {
                for (segment, ends) in line.points.windows(2).enumerate() {
                    let far = |axis: usize| {
                        let [a, b] = [ends[0][axis] - point[axis], ends[1][axis] - point[axis]];
                        a.min(b) > APART || a.max(b) < -APART
                    };
                    if far(0) || far(1) {
                        continue;
                    }
                    let (s, lateral, _) = line.nearest_of(point, segment..segment + 1);
                    if lateral.abs() < APART && (0.0..=line.length()).contains(&s) {
                        places.push((s, at));
                    }
                }
            }
            places
        };
        let mut places = beside(self.own, self.other);
        let others = beside(self.other, self.own);
        places.extend(others.into_iter().map(|(other, own)| (own, other)));
        places.retain(|&place| !self.on_one_level(place, true));
        places
    }

    /// Returns the stretches around a place along which the paths are beside each other on two
    /// levels.
    fn bridge(&self, route: usize, place: (f64, f64)) -> Bridge {
        let mut bridge = Bridge { route, own: [place.0; 2], other: [place.1; 2] };
        let band = self.band(place);
        let (before, behind) = band.split_at(band.partition_point(|(s, ..)| *s < place.0));
        let apart = |&&(s, at, _): &&(f64, f64, f64)| !self.on_one_level((s, at), true);
        let before = before.iter().rev().take_while(apart);
        for &(s, at, _) in behind.iter().take_while(apart).chain(before) {
            for (stretch, s) in [(&mut bridge.own, s), (&mut bridge.other, at)] {
                *stretch = [stretch[0].min(s), stretch[1].max(s)];
            }
        }
        bridge
    }

    /// Returns the positions on both paths around a place, in driving order of the first, at which
    /// vehicles on them touch, up to the lanes that both use; with the distance between the paths
    /// \[m\].
    fn band(&self, (own, other): (f64, f64)) -> Vec<(f64, f64, f64)> {
        let walk = |sign: f64| {
            let mut segment = self.other.locate(other).1;
            let mut last = other;
            (1..).map_while(move |k| {
                let s = own + sign * STEP * f64::from(k);
                let inside = (0.0..=self.own.length()).contains(&s);
                let (at, lateral, on) = self.other.project(self.own.at(s).0, segment);
                let common = self.shared.iter().any(|k| (k.from..=k.to).contains(&at));
                let on_band = inside
                    && lateral.abs() < APART
                    && (at - last).abs() < BEND
                    && (0.0..=self.other.length()).contains(&at)
                    && !(common && k > 2);
                (segment, last) = (on, at);
                on_band.then_some((s, at, lateral.abs()))
            })
        };
        let mut band: Vec<_> = walk(-1.0).collect();
        band.reverse();
        band.push((own, other, 0.0));
        band.extend(walk(1.0));
        band
    }
}

/// The conflicts of two paths that have been found so far.
struct Found<'a> {
    pair: &'a PathPair<'a>,
    places: Vec<Place>,
    /// The [`PathPair::band`] of each conflict, and of each fork of the paths.
    bands: Vec<Vec<(f64, f64, f64)>>,
    /// Whether `bands` contains those of the forks.
    forked: bool,
}

impl Found<'_> {
    /// Adds the conflict at a place, unless the place belongs to one that has been found.
    fn add(&mut self, (own, other): (f64, f64)) {
        /// Positions on the second path that differ by less are one place of a band \[m\].
        const SAME: f64 = 4.0;
        if !self.places.is_empty() && !std::mem::replace(&mut self.forked, true) {
            // Where two routes fork, they touch for a while.
            let forks = self.pair.shared.iter().map(|k| (k.to + k.shift, k.to));
            self.bands.extend(forks.map(|fork| self.pair.band(fork)));
        }
        let known = self.bands.iter().any(|band| {
            let near = |k: usize| {
                let (s, at, _) = band[k];
                (s - own).abs() <= 2.0 * STEP && (at - other).abs() < SAME
            };
            let k = band.partition_point(|(s, ..)| *s < own);
            k < band.len() && near(k) || k > 0 && near(k - 1)
        });
        if known {
            return;
        }
        let band = self.pair.band((own, other));
        self.places.push(Place { own, other, first: true });
        // Two vehicles that come from both ends of one strip have a conflict all along it.
        let strip = || band.iter().filter(|(_, _, apart)| *apart < STRIP);
        if let (Some(&(from, at, _)), Some(&(to, end, _))) = (strip().next(), strip().next_back())
            && to - from > 2.0 * CLEARED
            && end < at
        {
            let mut next = from;
            for &(s, at, _) in strip() {
                if s < next {
                    continue;
                }
                next = s + CLEARED;
                if (s - own).abs() >= CLEARED {
                    self.places.push(Place { own: s, other: at, first: false });
                }
            }
        }
        self.bands.push(band);
    }
}

/// Returns the conflicts between two paths of which at least one has a detour, in driving order of
/// `own`, as positions on `own` and `other`. Such paths may come near each other several times.
/// Each stretch on which vehicles of this size would touch gives the place where the paths are
/// nearest and, if the stretch is long, further places before and behind it.
fn conflicts_around(pair: &PathPair<'_>) -> Vec<Place> {
    /// Distance between the places of one stretch, in steps of [`STEP`].
    const SPACING: usize = (4.0 / STEP) as usize;
    let PathPair { own, other, shared, size, .. } = *pair;
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
        let near = (gap < APART || gap < diagonal && (-reach..=reach).any(touch))
            && pair.on_one_level((s, at), true);
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
fn spaced(places: &[(f64, (f64, f64))], spacing: usize) -> impl Iterator<Item = Place> {
    let nearest =
        (0..places.len()).min_by(|&i, &j| places[i].0.total_cmp(&places[j].0)).unwrap_or(0);
    let places = places.iter().skip(nearest % spacing).step_by(spacing).enumerate();
    places.map(|(k, &(_, (own, other)))| Place { own, other, first: k == 0 })
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
