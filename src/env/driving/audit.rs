//! Comparison of the collisions that our box test finds in an episode with those that SUMO reports.
//!
//! The box test is the one that counts: it tests the vehicles' boxes at their true poses five times
//! per step. SUMO tests once per step, with vehicles on the centre lines of their lanes, and inside
//! junctions only where it knows which vehicle has to yield. Where the two tests differ, the reason
//! is worked out from the vehicles' states at the moment of first detection.

use serde::{Deserialize, Serialize};

use super::agents::{Slot, Status};
use super::geometry::{Pose, Size, beside, boxes_overlap, direction, separation};
use super::map::{JunctionStretch, Map};
use crate::sumo::Collision;

/// Change in a box's length and width for tests of near contact \[m\]: half of it on every side.
const NEAR: f64 = 0.2;

/// Numbers of colliding vehicle pairs in an episode, by the tests that saw them and the reason for
/// a difference.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Audit {
    /// Pairs that both tests saw.
    pub agreed: u32,
    /// Only the box test: the junction is of SUMO's type `unregulated`, where SUMO never tests.
    pub ours_unregulated: u32,
    /// Only the box test: the boxes overlapped within a step, but no longer at its end.
    pub ours_between_steps: u32,
    /// Only the box test: the boxes would not have overlapped on the centre lines of their lanes.
    pub ours_lateral_offset: u32,
    /// Only the box test: in a junction, with at least one vehicle's front outside the junction.
    pub ours_junction_edge: u32,
    /// Only the box test: the boxes do not overlap when each is 0.1 m smaller on every side.
    pub ours_touching: u32,
    /// Only the box test: SUMO reports one of the two vehicles as colliding with a third.
    pub ours_one_of_several: u32,
    /// Only the box test, for no known reason.
    pub ours_other: u32,
    /// Only SUMO: a vehicle was already gone, or both had ended before, and the box test no longer
    /// tested the pair.
    pub sumo_ended: u32,
    /// Only SUMO: the boxes overlap when each is 0.1 m larger on every side.
    pub sumo_touching: u32,
    /// Only SUMO: in a junction, within a vehicle's length of the front of a vehicle that steers.
    /// SUMO bends the body of such a vehicle along the lane that it assigns to the vehicle, which
    /// may be a lane of another route that lies close.
    pub sumo_bent: u32,
    /// Only SUMO, for no known reason.
    pub sumo_other: u32,
}

impl Audit {
    /// Returns the sum of both audits, field by field.
    #[must_use]
    pub fn plus(self, other: &Self) -> Self {
        Self {
            agreed: self.agreed + other.agreed,
            ours_unregulated: self.ours_unregulated + other.ours_unregulated,
            ours_between_steps: self.ours_between_steps + other.ours_between_steps,
            ours_lateral_offset: self.ours_lateral_offset + other.ours_lateral_offset,
            ours_junction_edge: self.ours_junction_edge + other.ours_junction_edge,
            ours_touching: self.ours_touching + other.ours_touching,
            ours_one_of_several: self.ours_one_of_several + other.ours_one_of_several,
            ours_other: self.ours_other + other.ours_other,
            sumo_ended: self.sumo_ended + other.sumo_ended,
            sumo_touching: self.sumo_touching + other.sumo_touching,
            sumo_bent: self.sumo_bent + other.sumo_bent,
            sumo_other: self.sumo_other + other.sumo_other,
        }
    }

    /// Returns the reasons for which the two tests differ, in words, with the number of pairs for
    /// each; empty where they agree.
    pub fn differences(&self) -> Vec<(&'static str, u32)> {
        let all = [
            ("only ours: unregulated junction", self.ours_unregulated),
            ("only ours: between two steps", self.ours_between_steps),
            ("only ours: off the lane's centre line", self.ours_lateral_offset),
            ("only ours: one front outside the junction", self.ours_junction_edge),
            ("only ours: an overlap below about 0.2 m", self.ours_touching),
            ("only ours: one of several at once", self.ours_one_of_several),
            ("only ours: no known reason", self.ours_other),
            ("only SUMO: with a vehicle that had ended", self.sumo_ended),
            ("only SUMO: a gap below about 0.2 m", self.sumo_touching),
            ("only SUMO: a body that it bends along a lane", self.sumo_bent),
            ("only SUMO: no known reason", self.sumo_other),
        ];
        all.into_iter().filter(|(_, count)| *count > 0).collect()
    }
}

/// Returns the size of a vehicle with `more` metres added to its length and width.
fn grown(slot: &Slot, more: f64) -> Size {
    slot.size.map(|side| side + more)
}

/// Whether a part of the vehicle lies in a junction of its route for which `which` returns true.
fn touches_junction(map: &Map, slot: &Slot, which: fn(&JunctionStretch) -> bool) -> bool {
    let body = (slot.s - slot.size[0] / 2.0, slot.s + slot.size[0] / 2.0);
    map.junctions[slot.route].iter().any(|j| which(j) && body.0 <= j.to && j.from <= body.1)
}

/// Whether the body of `a`, bent in any way behind its front, could touch `b`.
fn bent_meets(a: &Slot, b: &Slot) -> bool {
    let [length, width] = a.size;
    let along = direction(&(&a.pose).into());
    let front = [a.pose.x + along[0] * length / 2.0, a.pose.y + along[1] * length / 2.0];
    let front = beside(front, along, 0.0);
    separation((front, [0.0; 2]), ((&b.pose).into(), b.size)) <= length + width / 2.0
}

/// Why the box test alone may see a collision. The variants are the `ours_*` fields of [`Audit`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Ours {
    Unregulated,
    BetweenSteps,
    LateralOffset,
    JunctionEdge,
    Touching,
    OneOfSeveral,
    Other,
}

impl Ours {
    /// Returns why SUMO would not report that the two vehicles of `pair` overlap. `reported`
    /// contains all collisions that SUMO reports of their world.
    pub(super) fn reason<'a>(
        map: &Map,
        pair: [(u32, &Slot); 2],
        mut reported: impl Iterator<Item = &'a Collision>,
    ) -> Self {
        let [a, b] = pair.map(|(_, slot)| slot);
        let overlap =
            |p: &Pose, q: &Pose, more: f64| boxes_overlap((p, grown(a, more)), (q, grown(b, more)));
        let centred = |slot: &Slot| {
            Pose::beside([slot.pose.x, slot.pose.y], slot.pose.heading, -slot.lateral)
        };
        let front_inside = |slot: &Slot| {
            let front = slot.s + slot.size[0] / 2.0;
            map.junctions[slot.route].iter().any(|j| (j.from..=j.to).contains(&front))
        };
        let touches =
            |slot: &Slot, which: fn(&JunctionStretch) -> bool| touches_junction(map, slot, which);
        let of_pair = |slot: u32| pair.iter().any(|(other, _)| *other == slot);
        if touches(a, |j| j.unregulated) || touches(b, |j| j.unregulated) {
            Ours::Unregulated
        } else if !overlap(&a.pose, &b.pose, 0.0) {
            Ours::BetweenSteps
        } else if !overlap(&centred(a), &centred(b), 0.0) {
            Ours::LateralOffset
        } else if (touches(a, |_| true) || touches(b, |_| true))
            && !(front_inside(a) && front_inside(b))
        {
            Ours::JunctionEdge
        } else if !overlap(&a.pose, &b.pose, -NEAR) {
            Ours::Touching
        } else if reported.any(|c| of_pair(c.collider) != of_pair(c.victim)) {
            Ours::OneOfSeveral
        } else {
            Ours::Other
        }
    }
}

/// Why SUMO alone may see a collision. The variants are the `sumo_*` fields of [`Audit`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Sumos {
    Ended,
    Touching,
    Bent,
    Other,
}

impl Sumos {
    /// Returns why the box test would not see a collision of `a` and `b` that SUMO reports.
    /// `steer`: whether agents steer.
    pub(super) fn reason(map: &Map, steer: bool, a: &Slot, b: &Slot) -> Self {
        let ended = |slot: &Slot| slot.status != Status::Active;
        let in_junction = |slot: &Slot| touches_junction(map, slot, |_| true);
        if a.status == Status::Empty || b.status == Status::Empty || (ended(a) && ended(b)) {
            Sumos::Ended
        } else if boxes_overlap((&a.pose, grown(a, NEAR)), (&b.pose, grown(b, NEAR))) {
            Sumos::Touching
        } else if steer
            && (in_junction(a) || in_junction(b))
            && (bent_meets(a, b) || bent_meets(b, a))
        {
            Sumos::Bent
        } else {
            Sumos::Other
        }
    }
}

#[derive(Debug, Clone, Copy)]
struct Pair {
    slots: (u32, u32),
    ours: Option<Ours>,
    sumo: Option<Sumos>,
}

/// The colliding pairs of an episode so far.
#[derive(Debug, Clone, Default)]
pub(super) struct Pairs(Vec<Pair>);

impl Pairs {
    pub(super) fn clear(&mut self) {
        self.0.clear();
    }

    /// Records that the box test sees the pair. `reason` is called only the first time.
    pub(super) fn ours(&mut self, a: u32, b: u32, reason: impl FnOnce() -> Ours) {
        let pair = self.entry(a, b);
        if pair.ours.is_none() {
            pair.ours = Some(reason());
        }
    }

    /// Records that SUMO reports the pair. `reason` is called only the first time.
    pub(super) fn sumo(&mut self, a: u32, b: u32, reason: impl FnOnce() -> Sumos) {
        let pair = self.entry(a, b);
        if pair.sumo.is_none() {
            pair.sumo = Some(reason());
        }
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
                (Some(_), Some(_)) | (None, None) => &mut audit.agreed,
                (Some(Ours::Unregulated), None) => &mut audit.ours_unregulated,
                (Some(Ours::BetweenSteps), None) => &mut audit.ours_between_steps,
                (Some(Ours::LateralOffset), None) => &mut audit.ours_lateral_offset,
                (Some(Ours::JunctionEdge), None) => &mut audit.ours_junction_edge,
                (Some(Ours::Touching), None) => &mut audit.ours_touching,
                (Some(Ours::OneOfSeveral), None) => &mut audit.ours_one_of_several,
                (Some(Ours::Other), None) => &mut audit.ours_other,
                (None, Some(Sumos::Ended)) => &mut audit.sumo_ended,
                (None, Some(Sumos::Touching)) => &mut audit.sumo_touching,
                (None, Some(Sumos::Bent)) => &mut audit.sumo_bent,
                (None, Some(Sumos::Other)) => &mut audit.sumo_other,
            } += 1;
        }
        audit
    }
}
