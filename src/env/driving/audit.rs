//! Comparison of the collisions that our box test finds in an episode with those that SUMO reports.
//!
//! The box test is the one that counts: it tests the vehicles' boxes at their true poses five times
//! per step. SUMO tests once per step, with vehicles on the centre lines of their lanes, and inside
//! junctions only where it knows which vehicle has to yield. Where the two tests differ, the reason
//! is worked out from the vehicles' states at the moment of first detection.

use nalgebra::Point2;
use serde::{Deserialize, Serialize};

use super::agents::{Slot, Status};
use super::geometry::{Pose, Size, Stance, beside, boxes_overlap, direction, separation};
use super::map::{JunctionStretch, Map};
use crate::sumo::Collision;
use crate::sumo::net::CARS;

/// Change in a box's length and width for tests of near contact \[m\]: half of it on every side.
const NEAR: f64 = 0.2;

/// Declares the counts of an audit, each but the first with the reason for a difference.
macro_rules! audit {
    ($(#[$doc:meta])* $agreed:ident, $($(#[$docs:meta])* $field:ident: $reason:literal,)*) => {
        /// Numbers of colliding vehicle pairs in an episode, by the tests that saw them and the
        /// reason for a difference.
        #[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
        #[serde(default)]
        pub struct Audit {
            $(#[$doc])* pub $agreed: u32,
            $($(#[$docs])* pub $field: u32,)*
        }

        impl Audit {
            /// Returns the sum of both audits, field by field.
            #[must_use]
            pub fn plus(self, other: &Self) -> Self {
                Self {
                    $agreed: self.$agreed + other.$agreed,
                    $($field: self.$field + other.$field,)*
                }
            }

            /// Returns the reasons for which the two tests differ, in words, with the number of
            /// pairs for each; empty where they agree.
            pub fn differences(&self) -> Vec<(&'static str, u32)> {
                let all = [$(($reason, self.$field),)*];
                all.into_iter().filter(|(_, count)| *count > 0).collect()
            }
        }
    };
}

audit! {
    /// Pairs that both tests saw.
    agreed,
    /// Only the box test: the junction is of SUMO's type `unregulated` or
    /// `traffic_light_unregulated`, where SUMO never tests.
    ours_unregulated: "only the box test: unregulated junction",
    /// Only the box test: the boxes overlapped within a step, but no longer at its end.
    ours_between_steps: "only the box test: between two steps",
    /// Only the box test: the boxes would not have overlapped on the centre lines of their lanes.
    ours_lateral_offset: "only the box test: off the lane's centre line",
    /// Only the box test: in a junction, with at least one vehicle's front outside the junction.
    ours_junction_edge: "only the box test: one front outside the junction",
    /// Only the box test: the boxes do not overlap when each is 0.1 m smaller on every side.
    ours_touching: "only the box test: an overlap below about 0.2 m",
    /// Only the box test: SUMO's metres at one of the vehicles are not those of its lane's shape,
    /// so that a vehicle is longer or shorter there, or the net has no lanes over its junctions.
    ours_metres: "only the box test: where SUMO's metres are not those of the shape",
    /// Only the box test: the vehicles are on one lane, on which SUMO sees a gap. The boxes overlap
    /// because the lane bends.
    ours_bend: "only the box test: in a bend, with a gap along the lane",
    /// Only the box test: the vehicles are on lanes that SUMO does not compare, such as two roads on
    /// one strip without `bidi`, or lanes of a junction that its logic does not name as foes.
    ours_not_compared: "only the box test: on lanes that SUMO does not compare",
    /// Only the box test: no corner of the outline that SUMO gives one vehicle lies within that of a
    /// vehicle that SUMO tests it against. SUMO's outlines of cars have no corners: a tenth of the
    /// length and a fifth of the width are cut off. Of two outlines, SUMO tests whether corners of the
    /// first lie within the second.
    ours_outline: "only the box test: corners that SUMO cuts off or does not test",
    /// Only the box test: SUMO reports one of the two vehicles as colliding with a third.
    ours_one_of_several: "only the box test: one of several at once",
    /// Only the box test, for no known reason.
    ours_other: "only the box test: no known reason",
    /// Only SUMO: a vehicle was already gone, or both had ended before, and the box test no longer
    /// tested the pair.
    sumo_ended: "only SUMO: with a vehicle that had ended",
    /// Only SUMO: the boxes overlap when each is 0.1 m larger on every side.
    sumo_touching: "only SUMO: a gap below about 0.2 m",
    /// Only SUMO: the boxes would overlap on the centre lines of their lanes.
    sumo_lateral_offset: "only SUMO: off the lane's centre line",
    /// Only SUMO: in a junction, within a vehicle's length of the front of a vehicle that steers.
    /// SUMO bends the body of such a vehicle along the lane that it assigns to the vehicle, which
    /// may be a lane of another route that lies close.
    sumo_bent: "only SUMO: a body that it bends along a lane",
    /// Only SUMO: SUMO's metres at one of the vehicles are not those of its lane's shape, as for the
    /// box test.
    sumo_metres: "only SUMO: where its metres are not those of the shape",
    /// Only SUMO, for no known reason.
    sumo_other: "only SUMO: no known reason",
}

/// Returns the size of a vehicle with `more` metres added to its length and width.
fn grown(slot: &Slot, more: f64) -> Size {
    slot.size.map(|side| side + more)
}

/// Whether a part of the vehicle lies in a junction of its route for which `which` returns true.
fn touches_junction(map: &Map, slot: &Slot, which: fn(&JunctionStretch) -> bool) -> bool {
    let [rear, front] = body(slot);
    map.junctions[slot.route].iter().any(|j| which(j) && rear <= j.to && j.from <= front)
}

/// Returns the positions of a vehicle's rear and front along the lanes of its route \[m\].
fn body(slot: &Slot) -> [f64; 2] {
    [slot.s - slot.size[0] / 2.0, slot.s + slot.size[0] / 2.0]
}

/// Whether a vehicle is as long in SUMO's metres along the lanes as it is on their shapes.
fn is_to_scale(map: &Map, slot: &Slot) -> bool {
    let [rear, front] = body(slot).map(|s| map.routes[slot.route].lanes().distance_of_arc(s));
    (front - rear - slot.size[0]).abs() <= NEAR / 2.0
}

/// Whether one of two vehicles on one route is ahead of the other with a gap in between.
fn has_gap(map: &Map, a: &Slot, b: &Slot) -> bool {
    let gap = |a: &Slot, b: &Slot| map.routes[a.route].gap_to(a.s, b.route, b.s);
    let lengths = f64::midpoint(a.size[0], b.size[0]);
    gap(a, b).or_else(|| gap(b, a)).is_some_and(|distance| distance >= lengths)
}

/// Whether SUMO tests a vehicle that is on the lanes below `a` against one on the lanes below `b`.
fn is_tested(map: &Map, a: &Slot, b: &Slot) -> bool {
    let lanes = |slot: &Slot| {
        let [rear, front] = body(slot);
        let stretches = map.routes[slot.route].lanes().lane_stretches();
        let below = stretches.filter(|(_, from, to)| *from <= front && rear <= *to);
        below.map(|(lane, ..)| lane).collect::<Vec<_>>()
    };
    let others = lanes(b);
    lanes(a).iter().any(|&a| others.iter().any(|&b| a == b || map.foes.contain(a, b)))
}

/// Whether a corner of the outline that SUMO gives `a` lies within that of `b`. SUMO has both on the
/// centre lines of their lanes.
fn has_corner_within(a: &Slot, b: &Slot) -> bool {
    // Halves and cuts are shares of length and width.
    let is_cut = |slot: &Slot| slot.class == CARS;
    let corners = if is_cut(a) { [[0.5, 0.3], [0.4, 0.5]] } else { [[0.5, 0.5]; 2] };
    let most = if is_cut(b) { 0.65 } else { 0.75 };
    let to_b = Stance::from(&centred(b)).inverse() * Stance::from(&centred(a));
    let mut corners = corners.into_iter().flat_map(|[x, y]| [[x, y], [x, -y], [-x, y], [-x, -y]]);
    corners.any(|[x, y]| {
        let corner = to_b * Point2::new(x * a.size[0], y * a.size[1]);
        let [x, y] = [corner.x.abs() / b.size[0], corner.y.abs() / b.size[1]];
        x <= 0.5 && y <= 0.5 && x + y / 2.0 <= most
    })
}

/// Returns the pose of a vehicle on the centre line of its lane.
fn centred(slot: &Slot) -> Pose {
    Pose::beside([slot.pose.x, slot.pose.y], slot.pose.heading, -slot.lateral)
}

/// Whether the body of `a`, bent in any way behind its front, could touch `b`.
fn bent_meets(a: &Slot, b: &Slot) -> bool {
    let [length, width] = a.size;
    let along = direction(&(&a.pose).into());
    let front = [a.pose.x + along[0] * length / 2.0, a.pose.y + along[1] * length / 2.0];
    let front = beside(front, along, 0.0);
    separation((front, [0.0; 2]), ((&b.pose).into(), b.size)) <= length + width / 2.0
}

/// The count of an [`Audit`] to which a pair belongs that only one of the two tests sees.
pub(super) type Count = fn(&mut Audit) -> &mut u32;

/// Returns why SUMO would not report that the two vehicles of `pair` overlap, as the box test finds.
/// `reported` contains all collisions that SUMO reports of their world.
pub(super) fn reason_of_ours<'a>(
    map: &Map,
    pair: [(u32, &Slot); 2],
    mut reported: impl Iterator<Item = &'a Collision>,
) -> Count {
    let [a, b] = pair.map(|(_, slot)| slot);
    let overlap =
        |p: &Pose, q: &Pose, more: f64| boxes_overlap((p, grown(a, more)), (q, grown(b, more)));
    let front_inside = |slot: &Slot| {
        let front = slot.s + slot.size[0] / 2.0;
        map.junctions[slot.route].iter().any(|j| (j.from..=j.to).contains(&front))
    };
    let touches =
        |slot: &Slot, which: fn(&JunctionStretch) -> bool| touches_junction(map, slot, which);
    let of_pair = |slot: u32| pair.iter().any(|(other, _)| *other == slot);
    if touches(a, |j| j.unregulated) || touches(b, |j| j.unregulated) {
        |audit| &mut audit.ours_unregulated
    } else if !overlap(&a.pose, &b.pose, 0.0) {
        |audit| &mut audit.ours_between_steps
    } else if !overlap(&centred(a), &centred(b), 0.0) {
        |audit| &mut audit.ours_lateral_offset
    } else if (touches(a, |_| true) || touches(b, |_| true))
        && !(front_inside(a) && front_inside(b))
    {
        |audit| &mut audit.ours_junction_edge
    } else if !overlap(&a.pose, &b.pose, -NEAR) {
        |audit| &mut audit.ours_touching
    } else if !is_to_scale(map, a) || !is_to_scale(map, b) {
        |audit| &mut audit.ours_metres
    } else if has_gap(map, a, b) {
        |audit| &mut audit.ours_bend
    } else if !is_tested(map, a, b) && !is_tested(map, b, a) {
        |audit| &mut audit.ours_not_compared
    } else if a.route != b.route
        && ![(a, b), (b, a)].iter().any(|(a, b)| is_tested(map, a, b) && has_corner_within(a, b))
    {
        |audit| &mut audit.ours_outline
    } else if reported.any(|c| of_pair(c.collider) != of_pair(c.victim)) {
        |audit| &mut audit.ours_one_of_several
    } else {
        |audit| &mut audit.ours_other
    }
}

/// Returns why the box test would not see a collision of `a` and `b` that SUMO reports.
/// `steer`: whether agents steer.
pub(super) fn reason_of_sumo(map: &Map, steer: bool, a: &Slot, b: &Slot) -> Count {
    let ended = |slot: &Slot| slot.status != Status::Active;
    let in_junction = |slot: &Slot| touches_junction(map, slot, |_| true);
    if a.status == Status::Empty || b.status == Status::Empty || (ended(a) && ended(b)) {
        |audit| &mut audit.sumo_ended
    } else if boxes_overlap((&a.pose, grown(a, NEAR)), (&b.pose, grown(b, NEAR))) {
        |audit| &mut audit.sumo_touching
    } else if boxes_overlap((&centred(a), a.size), (&centred(b), b.size)) {
        |audit| &mut audit.sumo_lateral_offset
    } else if steer && (in_junction(a) || in_junction(b)) && (bent_meets(a, b) || bent_meets(b, a))
    {
        |audit| &mut audit.sumo_bent
    } else if !is_to_scale(map, a) || !is_to_scale(map, b) {
        |audit| &mut audit.sumo_metres
    } else {
        |audit| &mut audit.sumo_other
    }
}

#[derive(Debug, Clone, Copy)]
struct Pair {
    slots: (u32, u32),
    ours: Option<Count>,
    sumo: Option<Count>,
}

/// The colliding pairs of an episode so far.
#[derive(Debug, Clone, Default)]
pub(super) struct Pairs(Vec<Pair>);

impl Pairs {
    pub(super) fn clear(&mut self) {
        self.0.clear();
    }

    /// Records that the box test sees the pair. `reason` is called only the first time.
    pub(super) fn ours(&mut self, a: u32, b: u32, reason: impl FnOnce() -> Count) {
        let pair = self.entry(a, b);
        if pair.ours.is_none() {
            pair.ours = Some(reason());
        }
    }

    /// Records that SUMO reports the pair. `reason` is called only the first time.
    pub(super) fn sumo(&mut self, a: u32, b: u32, reason: impl FnOnce() -> Count) {
        let pair = self.entry(a, b);
        if pair.sumo.is_none() {
            pair.sumo = Some(reason());
        }
    }

    /// Notes that the slot gets another vehicle, which forms pairs of its own.
    pub(super) fn renew(&mut self, slot: u32) {
        let old = self.0.iter_mut().filter(|pair| pair.slots.0 == slot || pair.slots.1 == slot);
        old.for_each(|pair| pair.slots = (u32::MAX, u32::MAX));
    }

    fn entry(&mut self, a: u32, b: u32) -> &mut Pair {
        let slots = (a.min(b), a.max(b));
        let at = self.0.iter().position(|pair| pair.slots == slots).unwrap_or_else(|| {
            self.0.push(Pair { slots, ours: None, sumo: None });
            self.0.len() - 1
        });
        &mut self.0[at]
    }

    /// Number of pairs that the box test saw.
    pub(super) fn of_ours(&self) -> u32 {
        self.0.iter().filter(|pair| pair.ours.is_some()).count() as u32
    }

    /// Number of pairs that SUMO reported.
    pub(super) fn of_sumo(&self) -> u32 {
        self.0.iter().filter(|pair| pair.sumo.is_some()).count() as u32
    }

    pub(super) fn audit(&self) -> Audit {
        let mut audit = Audit::default();
        for pair in &self.0 {
            *match (pair.ours, pair.sumo) {
                (Some(count), None) | (None, Some(count)) => count(&mut audit),
                _ => &mut audit.agreed,
            } += 1;
        }
        audit
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x: f64, y: f64, degrees: f64, class: &'static str) -> Slot {
        let pose = Pose { x, y, heading: degrees.to_radians() };
        Slot { pose, size: [4.5, 2.0], class, ..Slot::default() }
    }

    #[test]
    fn sumos_outlines_of_cars_have_no_corners() {
        let within = |a: &Slot, b: &Slot| [has_corner_within(a, b), has_corner_within(b, a)];
        for (class, touch) in [(CARS, false), ("truck", true)] {
            let (a, b) = (at(0.0, 0.0, 0.0, class), at(4.3, 1.8, 0.0, class));
            assert!(boxes_overlap((&a.pose, a.size), (&b.pose, b.size)));
            assert_eq!(within(&a, &b), [touch; 2]);
            assert_eq!(within(&a, &at(3.0, 1.0, 0.0, class)), [true; 2]);
            // The front of one in the side of the other, and a cross.
            assert_eq!(within(&at(0.0, -2.75, 90.0, class), &a), [true, false]);
            assert_eq!(within(&at(0.0, 0.0, 90.0, class), &a), [false; 2]);
        }
        // SUMO has them on the centre lines of their lanes.
        let beside = Slot { lateral: 1.5, ..at(0.0, 1.5, 0.0, CARS) };
        assert_eq!(within(&beside, &at(1.0, -0.9, 0.0, CARS)), [true; 2]);
    }
}
