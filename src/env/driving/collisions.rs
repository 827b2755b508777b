//! Collisions, by our own test of the vehicles' boxes several times per step.

use super::agents::{Crash, Slot, Status};
use super::audit::{Pairs, reason_of_ours, reason_of_sumo};
use super::failures::UPSTREAM;
use super::geometry::boxes_overlap;
use super::map::Map;
use super::routes::RouteGeometry;
use crate::sumo::Collision;

/// Least number of times per step at which boxes are tested for overlap: with steps of 0.1 s every
/// 0.02 s, as in the simulator of the paper's task.
const SUBSTEPS: u32 = 5;
/// Largest distance that two vehicles move between two tests, together \[m\]: two vehicles at
/// 22 m/s in steps of 0.2 s are tested [`SUBSTEPS`] times, and faster ones, or in longer steps, more
/// often.
const SPACING: f64 = 1.8;

/// Another vehicle that a vehicle overlaps with.
#[derive(Debug, Clone, Copy)]
pub(super) struct Partner {
    /// Route of the other vehicle.
    route: usize,
    /// Whether one of the two is ahead of the other on its route.
    same_path: bool,
    /// Whether the other vehicle is a wreck.
    wreck: bool,
}

impl Partner {
    /// Returns the crash of an agent on `route` with this vehicle.
    pub(super) fn crash(&self, route: &RouteGeometry, agent: &Slot, step: u32) -> Crash {
        let Self { route: other, same_path, wreck } = *self;
        let upstream = !route.conflicts.is_empty() && route.to_first_conflict(agent.s) > UPSTREAM;
        Crash { other, same_path, wreck, step, speed: agent.speed, upstream }
    }
}

/// The collisions of an episode.
#[derive(Debug, Clone)]
pub(super) struct Collisions {
    /// The vehicle that the vehicle of each slot overlapped with in the last step.
    partners: Vec<Option<Partner>>,
    /// The colliding pairs, for comparison with SUMO's.
    pub(super) pairs: Pairs,
    /// Number of colliding pairs with an agent that was driving.
    pub(super) crashes: u32,
    /// The slots of these pairs.
    crashed: Vec<(usize, usize)>,
}

impl Collisions {
    pub(super) fn new(slots: usize) -> Self {
        let crashed = Vec::with_capacity(slots);
        Self { partners: vec![None; slots], pairs: Pairs::default(), crashes: 0, crashed }
    }

    /// Begins a new episode.
    pub(super) fn begin(&mut self) {
        self.pairs.clear();
        self.crashes = 0;
        self.crashed.clear();
    }

    /// Notes that an agent's slot gets another vehicle, which forms pairs of its own.
    pub(super) fn renew(&mut self, slot: usize) {
        self.pairs.renew(slot as u32);
        self.crashed.retain(|&(j, i)| j != slot && i != slot);
    }

    /// Returns the vehicle that the vehicle of a slot overlapped with in the last step.
    pub(super) fn partner(&self, slot: usize) -> Option<Partner> {
        self.partners[slot]
    }

    /// Tests the boxes of active vehicles against all other vehicles on the road. Two background
    /// vehicles that both drive are not tested against each other; background vehicles have the
    /// slots after the first `agents`. `reported` returns SUMO's collisions of the world.
    pub(super) fn find<'a, R: Iterator<Item = &'a Collision>>(
        &mut self,
        map: &Map,
        agents: usize,
        slots: &[Slot],
        reported: impl Fn() -> R,
    ) {
        self.partners.fill(None);
        let moving = |k: usize| slots[k].status == Status::Active;
        for i in 0..slots.len() {
            for j in 0..i {
                let on_road = |k: usize| slots[k].status != Status::Empty && slots[k].departed;
                let strangers = j >= agents && moving(i) && moving(j);
                if !on_road(i)
                    || !on_road(j)
                    || !(moving(i) || moving(j))
                    || strangers
                    || !overlap_in_step(&slots[i], &slots[j])
                    || on_two_levels(map, &slots[i], &slots[j])
                {
                    continue;
                }
                let drives = |k: usize| k < agents && moving(k);
                // An agent that overlaps with another as it enters crashes one step later.
                if (drives(i) || drives(j)) && !self.crashed.contains(&(j, i)) {
                    self.crashes += 1;
                    self.crashed.push((j, i));
                }
                let follows = |a: usize, b: usize| {
                    let gap =
                        map.routes[slots[a].route].gap_to(slots[a].s, slots[b].route, slots[b].s);
                    // On a path that meets itself, a vehicle that crosses is far ahead on it.
                    gap.is_some_and(|gap| gap < slots[a].size[0] + slots[b].size[0])
                };
                let same_path = follows(i, j) || follows(j, i);
                for (own, other) in [(i, j), (j, i)] {
                    let (route, wreck) = (slots[other].route, !moving(other));
                    self.partners[own].get_or_insert(Partner { route, same_path, wreck });
                }
                // SUMO gives pedestrians other shapes, so that their collisions cannot be compared.
                if j < agents && !map.routes[slots[i].route].is_walked() {
                    let pair = [i, j].map(|k| (k as u32, &slots[k]));
                    self.pairs.ours(j as u32, i as u32, || reason_of_ours(map, pair, reported()));
                }
            }
        }
    }

    /// Notes the collisions with agents that SUMO reports. `steer`: whether agents steer.
    pub(super) fn compare<'a>(
        &mut self,
        map: &Map,
        steer: bool,
        agents: usize,
        slots: &[Slot],
        reported: impl Iterator<Item = &'a Collision>,
    ) {
        for &Collision { collider, victim, .. } in reported {
            if (collider.min(victim) as usize) < agents {
                let (a, b) = (&slots[collider as usize], &slots[victim as usize]);
                self.pairs.sumo(collider, victim, || reason_of_sumo(map, steer, a, b));
            }
        }
    }
}

/// Whether one vehicle is on a bridge and the other below it.
pub(super) fn on_two_levels(map: &Map, a: &Slot, b: &Slot) -> bool {
    map.routes[a.route].passes_over(a.s, b.route, b.s, a.size[0] + b.size[0])
}

/// Whether the boxes of two vehicles overlap at some time of the last step at which both were on the
/// road.
fn overlap_in_step(a: &Slot, b: &Slot) -> bool {
    let half = |slot: &Slot| f64::midpoint(slot.size[0], slot.size[1]);
    let reach = half(a) + half(b);
    let travelled = a.pose.distance(&a.before) + b.pose.distance(&b.before);
    if a.pose.distance(&b.pose) > reach + travelled {
        return false;
    }
    let substeps = SUBSTEPS.max((travelled / SPACING).ceil() as u32);
    let first = if a.age.min(b.age) == 0 { substeps } else { 1 };
    (first..=substeps).any(|k| {
        let t = f64::from(k) / f64::from(substeps);
        let [at, other] = [a, b].map(|slot| slot.before.towards(&slot.pose, t));
        boxes_overlap((&at, a.size), (&other, b.size))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::env::driving::geometry::Pose;

    /// Vehicles do not pass through each other, however far they drive in a step.
    #[test]
    fn vehicles_that_cross_in_a_long_step_collide() {
        let slot = |before: Pose, now: Pose| Slot {
            status: Status::Active,
            pose: now,
            before,
            size: [4.5, 1.8],
            age: 5,
            ..Slot::default()
        };
        // Their boxes overlap while both centres are within this distance of the crossing.
        let reach = f64::midpoint(4.5, 1.8);
        for length in [2.0, 4.4, 10.0, 44.0, 220.0] {
            for late in [0.0, 1.0, 3.0, 5.0, 7.0] {
                let east = |x: f64| Pose { x, y: 0.0, heading: 0.0 };
                let north = |y: f64| Pose { x: 0.0, y, heading: std::f64::consts::FRAC_PI_2 };
                let (from, to) = (-0.4 * length, 0.6 * length);
                let own = slot(east(from), east(to));
                let other = slot(north(from - late), north(to - late));
                let overlap = to.min(reach) - from.max(late - reach);
                if !(0.0..=SPACING / 2.0).contains(&overlap) {
                    assert_eq!(
                        overlap_in_step(&own, &other),
                        overlap > 0.0,
                        "{length} m, {late} m"
                    );
                }
            }
        }
    }

    /// SUMO puts a vehicle on the road behind one that has just passed its place.
    #[test]
    fn a_new_vehicle_does_not_collide_with_one_that_has_passed() {
        let at = |x: f64| Pose { x, y: 0.0, heading: 0.0 };
        let slot = |before: f64, now: f64, age: u32| Slot {
            status: Status::Active,
            pose: at(now),
            before: at(before),
            size: [4.5, 1.8],
            age,
            ..Slot::default()
        };
        let passes = slot(17.0, 19.8, 5);
        assert!(!overlap_in_step(&passes, &slot(14.0, 14.0, 0)));
        assert!(overlap_in_step(&passes, &slot(14.0, 14.0, 1)), "it was there before");
        assert!(overlap_in_step(&passes, &slot(16.0, 16.0, 0)), "it is in the way");
    }
}
