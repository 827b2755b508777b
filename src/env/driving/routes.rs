//! The routes' paths and how they relate to each other: shared lanes, crossings and merges.

use super::agents::CLEARED;
use super::area::{self, Stretch};
use super::conflicts::{Bridge, PathPair, Place};
use super::geometry::{Pose, Size, boxes_overlap};
use super::levels::Levels;
use super::shared::{STEP, Shared};
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
    /// The conflicts with all routes, this one included, in the order in which they lie along this
    /// route. Paths that stay close together give one conflict, where they come together.
    pub conflicts: Vec<Conflict>,
    /// Other routes without a conflict with this one.
    pub apart: Vec<usize>,
    /// Conflicts with every route, in the order in which they lie along this route: those of
    /// [`RouteGeometry::conflicts`], and further places of stretches that both paths use in opposite
    /// directions.
    by_route: Vec<Vec<Conflict>>,
    /// For every route, the stretches that both use in opposite directions.
    opposing: Vec<Vec<OpposingStretch>>,
    /// For every route, the stretches that it shares with this one.
    shared: Vec<Vec<Shared>>,
    /// Where other paths pass over or under this one.
    bridges: Vec<Bridge>,
    /// First and last position of each group of conflicts between which no vehicle has room to
    /// wait.
    groups: Vec<[f64; 2]>,
}

/// A conflict of two routes, or of a route with itself: the point where the paths cross or merge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Conflict {
    /// The other route.
    pub route: usize,
    /// Position of the conflict point on this route.
    pub own: f64,
    /// Position of the conflict point on the other route.
    pub other: f64,
    /// Where a vehicle on this route enters and leaves the area of the conflict, in which it touches
    /// some vehicle on the other route \[m\].
    pub own_area: Stretch,
    /// Where a vehicle on the other route enters and leaves the area.
    pub other_area: Stretch,
}

/// A stretch that two routes use in opposite directions, such as a lane for both directions of a road:
/// where a vehicle on each of them enters and leaves it \[m\]. Outside, the vehicles have room
/// beside each other.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OpposingStretch {
    /// Where a vehicle on this route enters and leaves.
    pub own: [f64; 2],
    /// Where a vehicle on the other route enters and leaves.
    pub other: [f64; 2],
}

impl OpposingStretch {
    /// Returns the stretch between two conflicts of the paths, for vehicles of this width \[m\].
    fn between(path: &Path, other: &Path, [first, last]: [Conflict; 2], width: f64) -> Self {
        /// Distance between vehicles that pass each other \[m\].
        const BESIDE: f64 = 0.3;
        let has_room = |s: f64| other.nearest(path.at(s).0).1.abs() > width + BESIDE;
        let end = |mut s: f64, step: f64| {
            while (0.0..=path.length()).contains(&s) && !has_room(s) {
                s += step;
            }
            (s, other.nearest(path.at(s).0).0)
        };
        let (own_from, other_to) = end(first.own, -STEP);
        let (own_to, other_from) = end(last.own, STEP);
        Self { own: [own_from, own_to], other: [other_from, other_to] }
    }
}

/// Conflicts at most this far apart are one group: a vehicle that has left the first with its whole
/// body would already block the second \[m\].
const ROOM: f64 = 20.0;

impl RouteGeometry {
    /// Returns the centre line of the route's lanes, along which SUMO positions vehicles.
    pub fn lanes(&self) -> &Path {
        self.avoided.as_ref().unwrap_or(&self.path)
    }

    /// Converts a position on [`RouteGeometry::lanes`] into a position on [`RouteGeometry::path`].
    pub fn on_path(&self, s: f64) -> f64 {
        self.avoided.as_ref().map_or(s, |lanes| self.path.arc_of_distance(lanes.distance_of_arc(s)))
    }

    /// Returns how far ahead of `own` on this route a vehicle at `s` on `route` is, if that vehicle
    /// is on a lane of both routes, or so close behind a fork or before a merge that it still blocks
    /// this route; `None` if it is not there, or behind \[m\]. Where this route uses the lane several
    /// times, the nearest time counts.
    pub fn gap_to(&self, own: f64, route: usize, s: f64) -> Option<f64> {
        // Stretches of consecutive lanes reach into each other and differ by rounding only, so that
        // the first one counts.
        let nearer = |nearest: Option<f64>, gap: f64| match nearest {
            Some(nearest) if nearest <= gap + 1.0 => Some(nearest),
            _ => Some(gap),
        };
        let on_both = self.shared[route].iter().filter(|k| (k.from..=k.to).contains(&s));
        on_both.map(|k| s + k.shift - own).filter(|gap| *gap > 0.0).fold(None, nearer)
    }

    /// Returns the distance as [`RouteGeometry::gap_to`], but `None` if the two vehicles come to a
    /// conflict before that.
    pub fn gap_to_leader(&self, own: f64, route: usize, s: f64) -> Option<f64> {
        let gap = self.gap_to(own, route, s)?;
        let sooner = |met: Conflict| (met.own - own).max(met.other - s) < gap;
        let met = self.next_conflict(own, route, s, 0.0);
        (!met.is_some_and(sooner)).then_some(gap)
    }

    /// Returns whether the bodies of two vehicles at `own` on this route and at `other` on `route`
    /// are on different levels, although they overlap in the plane. `lengths` is the sum of their
    /// lengths \[m\].
    pub fn passes_over(&self, own: f64, route: usize, other: f64, lengths: f64) -> bool {
        let half = lengths / 2.0;
        self.bridges.iter().any(|bridge| bridge.route == route && bridge.covers(own, other, half))
    }

    /// Returns whether pedestrians walk this route.
    pub fn is_walked(&self) -> bool {
        self.path.lanes.is_empty()
    }

    /// Returns the first conflict with `route`, in the order of this route.
    pub fn conflict_with(&self, route: usize) -> Option<Conflict> {
        self.by_route[route].first().copied()
    }

    /// Returns the first conflict between a vehicle at `own` on this route and one at `other` on
    /// `route` that the two have not both left; the last one if they have left all.
    pub(super) fn conflict_between(&self, own: f64, route: usize, other: f64) -> Option<Conflict> {
        let met = &self.by_route[route];
        let left = |met: &Conflict| (met.own - own).max(met.other - other) < -CLEARED;
        met.iter().find(|met| !left(met)).or(met.last()).copied()
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

    /// Returns the stretches that this route and `route` use in opposite directions.
    pub fn opposing_stretches(&self, route: usize) -> &[OpposingStretch] {
        &self.opposing[route]
    }

    /// Returns the distance from `s` to the first point of the group of conflicts that the vehicle
    /// has not yet left, which is negative in the group; to the last group after all of them; to the
    /// arrival if the route has no conflict \[m\].
    pub fn to_first_conflict(&self, s: f64) -> f64 {
        let group = self.groups.get(self.group_at(s));
        group.map_or(self.arrival, |group| group[0]) - s
    }

    /// Returns the number of the group of conflicts in which or before which a vehicle is.
    pub(super) fn group_at(&self, s: f64) -> usize {
        let left = self.groups.partition_point(|group| group[1] - s < -CLEARED);
        left.min(self.groups.len().saturating_sub(1))
    }

    /// Returns the conflicts from the first one of the group in which or before which a vehicle is.
    pub(super) fn group_from(&self, s: f64) -> &[Conflict] {
        let Some([from, _]) = self.groups.get(self.group_at(s)) else { return &[] };
        &self.conflicts[self.conflicts.partition_point(|conflict| conflict.own < *from)..]
    }

    /// Returns `count` of the conflicts: the first ones, or, where there are more, those that a
    /// vehicle at `s` has not yet left, as long as any are left.
    pub(super) fn upcoming(&self, s: f64, count: usize) -> &[Conflict] {
        let left = self.conflicts.partition_point(|conflict| conflict.own - s < -CLEARED);
        let first = left.min(self.conflicts.len().saturating_sub(count));
        &self.conflicts[first..][..count.min(self.conflicts.len())]
    }
}

/// Works out the geometry of route number `a` of `paths` for vehicles of this size. `detoured`
/// marks the paths that leave their lanes for a detour; `arrival_pos` is the finish on the route's
/// last edge \[m\], and a negative value counts from the edge's end.
pub(super) fn geometry(
    levels: &Levels<'_>,
    paths: &[Path],
    detoured: &[bool],
    a: usize,
    arrival_pos: f64,
    size: Size,
) -> RouteGeometry {
    let path = &paths[a];
    let arrival = path.edges.len().checked_sub(1).and_then(|last| path.arc(last, arrival_pos));
    let arrival = arrival.unwrap_or_else(|| path.length());
    let (mut by_route, mut shared, mut opposing) = (Vec::new(), Vec::new(), Vec::new());
    let (mut conflicts, mut bridges) = (Vec::new(), Vec::new());
    for (b, other) in paths.iter().enumerate() {
        let stretches = shared_stretches(path, other, a == b);
        let pair = PathPair { levels, own: path, other, shared: &stretches, same: a == b, size };
        let met = pair.meet(b, a != b && (detoured[a] || detoured[b]), &mut bridges);
        let conflict = |place: &Place| {
            let [own_area, other_area] =
                area::around([path, other], [place.own, place.other], size);
            Conflict { route: b, own: place.own, other: place.other, own_area, other_area }
        };
        let all: Vec<_> = met.iter().map(conflict).collect();
        let first = met.iter().zip(&all).filter(|(place, _)| place.first);
        let first: Vec<_> = first.map(|(_, conflict)| *conflict).collect();
        let coinciding = first.iter().filter_map(|met| coinciding_stretch(path, other, *met));
        let stretches: Vec<Shared> = stretches.iter().copied().chain(coinciding).collect();
        let identity = (a == b).then_some(Shared::IDENTITY);
        let stretches = identity.into_iter().chain(extended(path, other, &stretches, size));
        shared.push(stretches.collect());
        // A route that crosses itself comes to the same point twice, much further on.
        let backwards =
            all.chunk_by(|one, next| next.other < one.other && next.own - one.own <= ROOM);
        let ends =
            backwards.filter(|part| part.len() > 1).map(|part| [part[0], part[part.len() - 1]]);
        let stretches = ends.map(|ends| OpposingStretch::between(path, other, ends, size[1]));
        opposing.push(stretches.collect());
        by_route.push(all);
        conflicts.extend(first);
    }
    let no_conflict = |b: &usize| *b != a && Vec::<Conflict>::is_empty(&by_route[*b]);
    let apart = (0..paths.len()).filter(no_conflict).collect();
    conflicts.sort_by(|x, y| x.own.total_cmp(&y.own).then(x.route.cmp(&y.route)));
    let half = path.widths.last().copied().unwrap_or_default() / 2.0;
    let groups = conflicts.chunk_by(|x, y| y.own - x.own <= ROOM);
    let groups = groups.map(|group| [group[0].own, group[group.len() - 1].own]).collect();
    RouteGeometry {
        path: path.clone(),
        avoided: None,
        first_lane: 0,
        arrival,
        finish: [-half, half],
        conflicts,
        apart,
        by_route,
        opposing,
        shared,
        bridges,
        groups,
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

/// Extends each stretch as far as a vehicle on `other` blocks a vehicle on `own`: behind a fork,
/// until its rear no longer reaches into the path of `own`; before a merge, to where the two
/// centre lines begin to coincide.
fn extended(own: &Path, other: &Path, stretches: &[Shared], size: Size) -> Vec<Shared> {
    /// Centre lines at most this far apart coincide \[m\].
    const CLOSE: f64 = 0.3;
    /// Margin added to the length and width of the vehicle on the other route, since no vehicle
    /// keeps to the centre line exactly \[m\].
    const MARGIN: f64 = 0.3;
    let in_the_way = |s: f64, shift: f64| {
        let (there, grown) = (Pose::on(other, s), size.map(|x| x + MARGIN));
        let reach = (2.0 * size[0] / STEP) as i32;
        // Vehicles at the same place are the most likely to overlap.
        (0..=reach).flat_map(|k| [k, -k]).any(|k| {
            boxes_overlap((&Pose::on(own, s + shift + f64::from(k) * STEP), size), (&there, grown))
        })
    };
    let one = |s: f64, shift: f64| Pose::on(other, s).distance(&Pose::on(own, s + shift)) < CLOSE;
    // Returns how far ahead (`direction` 1) or behind (-1) of `s` a lane that both routes use goes
    // on, in whole steps: vehicles on it are at one place.
    let lane = |s: f64, shift: f64, direction: f64| {
        let goes_on = |k: &Shared| {
            let is_on = (k.from..=k.to).contains(&s) && (k.shift - shift).abs() < 1e-6;
            let end = if direction > 0.0 { k.to } else { k.from };
            is_on.then_some((end - s) * direction)
        };
        let longest = stretches.iter().filter_map(goes_on).fold(0.0, f64::max);
        (longest / STEP).floor() * STEP
    };
    let (end, own_end) = (other.length(), own.length());
    let extend = |mut stretch: Shared| {
        while stretch.to < end && stretch.to + stretch.shift < own_end {
            let sure = lane(stretch.to, stretch.shift, 1.0);
            if sure == 0.0 && !in_the_way(stretch.to, stretch.shift) {
                break;
            }
            stretch.to += sure.max(STEP);
        }
        while stretch.from > 0.0 && stretch.from + stretch.shift > 0.0 {
            let sure = lane(stretch.from, stretch.shift, -1.0);
            if sure == 0.0 && !one(stretch.from, stretch.shift) {
                break;
            }
            stretch.from -= sure.max(STEP);
        }
        stretch
    };
    stretches.iter().copied().map(extend).collect()
}

/// Returns the stretches of lanes that both routes use, without any extension; of a route with
/// itself (`same`), those that it uses several times.
fn shared_stretches(own: &Path, other: &Path, same: bool) -> Vec<Shared> {
    let mut stretches = Vec::new();
    for (i, (lane, start, _)) in own.lane_stretches().enumerate() {
        let alike = other.lane_stretches().enumerate();
        let alike = alike.filter(|&(j, stretch)| stretch.0 == lane && !(same && i == j));
        stretches.extend(alike.map(|(_, (_, from, to))| Shared { from, to, shift: start - from }));
    }
    stretches
}
