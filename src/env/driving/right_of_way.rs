//! Right of way by first come, first served, as at a junction that grants passage in the order of
//! requests (Dresner and Stone, JAIR 2008): the vehicles' priorities (`priorities`, the smallest number
//! goes first), and a rule-based driver.

use super::foresight::{Course, DRIVING, passing};
use super::intention::{Candidate, Knowledge};
use super::routes::RouteGeometry;
use super::slots::{Slot, Status, Traffic};
use super::task::Task;

/// How far ahead the rule predicts motion \[s\].
const HORIZON: f64 = 5.0;
/// Closeness ([`passing`]) from which a vehicle gives way: a predicted gap below 1 m.
const TOO_CLOSE: f64 = 2.0 / 3.0;
/// Closeness from which a standing vehicle is in the way: a gap below 0.3 m.
const IN_THE_WAY: f64 = 0.9;
/// Distance that a vehicle's centre keeps, when it stops, from the position where the vehicle would
/// be too close to another \[m\].
const RESERVE: f64 = 4.0;
/// A vehicle whose front is more than this past a waiting place has entered \[m\].
const OVER: f64 = 3.0;
/// Braking that the rule plans with; less where the vehicle cannot brake as hard \[m/s²\].
const BRAKING: f64 = 6.0;
/// A vehicle blocks another that would reach its present position within this time \[s\].
const BLOCKED: f64 = 3.0;
/// A vehicle blocks only vehicles whose centres are closer than this \[m\].
const FAR: f64 = 30.0;

/// How far an agent can drive before it comes too close to other vehicles \[m\]; infinite where
/// nothing is in the way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Free {
    /// Distance to a vehicle that has priority, is ahead, or is a wreck, at the agent's speed but
    /// at least 6 m/s.
    pub(super) distance: f64,
    /// The same at the agent's speed but at least 3 m/s.
    pub(super) slow: f64,
    /// Distance to a vehicle without priority whose present position is in the agent's way, at the
    /// agent's speed but at least 6 m/s.
    pub(super) blocked: f64,
}

impl Free {
    /// Nothing is in the way.
    pub(super) const ALL: Self =
        Self { distance: f64::INFINITY, slow: f64::INFINITY, blocked: f64::INFINITY };

    /// Returns the smaller of each distance.
    pub(super) fn min(self, other: Self) -> Self {
        Self {
            distance: self.distance.min(other.distance),
            slow: self.slow.min(other.slow),
            blocked: self.blocked.min(other.blocked),
        }
    }
}

/// Relation of another vehicle to an agent.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Standing {
    /// The other vehicle is behind the agent.
    Behind,
    /// The other vehicle is ahead of the agent, or a wreck.
    Ahead,
    /// The other vehicle has priority over the agent.
    Before,
    /// The agent has priority over the other vehicle.
    After,
}

/// Returns how far the vehicle of `slot` can drive with regard to the vehicle of slot `j`: the
/// smallest distances over all candidate routes of the latter.
pub(super) fn free(knowledge: Knowledge<'_>, priorities: &[u32], slot: usize, j: usize) -> Free {
    let (routes, slots) = (knowledge.routes, &knowledge.traffic.slots);
    let (own, other) = (&slots[slot], &slots[j]);
    if j == slot || other.status == Status::Empty {
        return Free::ALL;
    }
    let standing = |place: &Candidate| {
        if is_behind(routes, &Candidate::of(own), place) {
            Standing::Behind
        } else if is_behind(routes, place, &Candidate::of(own)) || other.status == Status::Wreck {
            Standing::Ahead
        } else if priorities[j] < priorities[slot] {
            Standing::Before
        } else {
            Standing::After
        }
    };
    let on = |place: Candidate| {
        let distance = |least: f64, at: f64, close_to: f64| {
            let speed = own.speed.max(least);
            let course = Course::on(routes, place, other.size, at);
            let [close, soon] = passing(Course::new(routes, own, speed), course, HORIZON);
            if close > close_to { speed * HORIZON * (1.0 - soon) } else { f64::INFINITY }
        };
        let before = |at: f64| Free {
            distance: distance(DRIVING, at, TOO_CLOSE),
            slow: distance(DRIVING / 2.0, at, TOO_CLOSE),
            ..Free::ALL
        };
        match standing(&place) {
            Standing::Behind => Free::ALL,
            Standing::Ahead => before(other.speed),
            Standing::Before => before(other.speed).min(before(other.speed.max(DRIVING))),
            Standing::After => Free { blocked: distance(DRIVING, 0.0, IN_THE_WAY), ..Free::ALL },
        }
    };
    let reach = other.speed.max(DRIVING) * HORIZON;
    let new = |(k, place): &(usize, Candidate)| {
        let same = |earlier: Candidate| {
            knowledge.until_parted(&earlier, place) > reach && standing(&earlier) == standing(place)
        };
        !knowledge.candidates(j).take(*k).any(same)
    };
    knowledge
        .candidates(j)
        .enumerate()
        .filter(new)
        .map(|(_, place)| on(place))
        .fold(Free::ALL, Free::min)
}

/// Returns for every slot whether its vehicle brakes now: for a vehicle that has priority, is
/// ahead, or stands in its way.
pub(super) fn giving_way(task: &Task, traffic: &Traffic) -> Vec<bool> {
    let (mut priorities, mut blocked) = (Vec::new(), Vec::new());
    let knowledge = Knowledge::full(&task.routes, traffic);
    inherit(knowledge, &mut priorities, &mut blocked);
    let control = &task.scenario.control;
    let brakes = control.brake.last().map_or(control.accel, |(_, brakes)| *brakes).min(BRAKING);
    let gives_way = |(slot, own): (usize, &Slot)| {
        let seen = |free: Free, j| free.min(self::free(knowledge, &priorities, slot, j));
        let free = (0..priorities.len()).fold(Free::ALL, seen);
        let braking = own.speed * own.speed / (2.0 * brakes);
        // A vehicle that has not entered the junction waits outside, where it blocks nobody.
        let outside = to_entry(task, own).is_some_and(|entry| entry < braking);
        own.status == Status::Active
            && (free.distance < braking + RESERVE
                || free.blocked < RESERVE
                || outside && free.distance.min(free.slow) < f64::INFINITY)
    };
    traffic.slots.iter().enumerate().map(gives_way).collect()
}

/// Returns how far a vehicle has to drive to the next place where it can wait without blocking
/// others: before a junction, or before the first conflict point of its route \[m\]. Places that
/// its front has passed by more than [`OVER`] do not count; `None` where none is left.
pub(super) fn to_entry(task: &Task, slot: &Slot) -> Option<f64> {
    let nose = slot.s + slot.size[0] / 2.0;
    let meeting = task.routes[slot.route].to_first_conflict(slot.s) - RESERVE;
    let lines = task.junctions[slot.route].iter().map(|junction| junction.from - nose);
    lines.chain([meeting]).filter(|distance| *distance > -OVER).min_by(f64::total_cmp)
}

/// Whether the vehicle at `behind` will come to the position of the vehicle at `ahead` on its
/// route.
fn is_behind(routes: &[RouteGeometry], ahead: &Candidate, behind: &Candidate) -> bool {
    routes[behind.route].shared_position(ahead.route, ahead.s).is_some_and(|s| s > behind.s)
}

/// Writes the effective priorities of all slots to `priorities`; the smallest number goes first.
///
/// A vehicle whose present position blocks another inherits the blocked vehicle's priority if that
/// is earlier than its own; otherwise the two would wait for each other. A vehicle with several
/// candidate routes is blocked if it is blocked on any of them. `blocked` is scratch.
pub(super) fn inherit(
    knowledge: Knowledge<'_>,
    priorities: &mut Vec<u32>,
    blocked: &mut Vec<(usize, usize)>,
) {
    let Knowledge { routes, traffic, .. } = knowledge;
    let slots = &traffic.slots;
    priorities.clear();
    // Vehicles that have no priority yet (0) come last.
    priorities.extend(slots.iter().map(|slot| slot.priority.wrapping_sub(1)));
    let drives = |i: usize| slots[i].status == Status::Active;
    let stands_in_the_way = |i: usize, j: usize| {
        let waits_behind =
            |own: Candidate| knowledge.candidates(j).any(|other| is_behind(routes, &other, &own));
        // The vehicle's present position is the same on all of its candidate routes.
        let own = knowledge.candidates(i).next().unwrap_or_else(|| Candidate::of(&slots[i]));
        let course = Course::on(routes, own, slots[i].size, 0.0);
        !knowledge.candidates(i).any(waits_behind)
            && knowledge.closest(course, j, DRIVING, BLOCKED)[0] > IN_THE_WAY
    };
    blocked.clear();
    for i in (0..slots.len()).filter(|&i| drives(i)) {
        let near = |&j: &usize| {
            j != i && drives(j) && traffic.distance(i, j) < FAR && stands_in_the_way(i, j)
        };
        blocked.extend((0..slots.len()).filter(near).map(|j| (i, j)));
    }
    // Priorities are inherited along chains of any length.
    let mut changed = true;
    while std::mem::take(&mut changed) {
        for &(i, j) in &*blocked {
            changed |= priorities[j] < priorities[i];
            priorities[i] = priorities[i].min(priorities[j]);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use proptest::prelude::*;

    use super::super::geometry::{Pose, separation};
    use super::super::slots::EMPTY;
    use super::*;
    use crate::scenario::Scenario;

    fn task() -> Task {
        let path =
            Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/intersection_turns_small.xml");
        Task::new(&Scenario::load(&path).expect("a scenario"), 8).expect("a task")
    }

    /// Traffic with one vehicle per entry, on the named route and the given distance \[m\] before
    /// its first conflict point.
    fn traffic(task: &Task, vehicles: &[(&str, f64)]) -> Traffic {
        let mut traffic = Traffic::new(vehicles.len(), task.routes.len());
        for (slot, (name, distance)) in traffic.slots.iter_mut().zip(vehicles) {
            let route = task.route_ids.iter().position(|id| id == name).expect("a route");
            *slot = at(task, route, task.routes[route].to_first_conflict(0.0) - distance);
        }
        traffic.refresh();
        traffic
    }

    fn at(task: &Task, route: usize, s: f64) -> Slot {
        let path = &task.routes[route].path;
        let ([x, y], heading) = path.at(s);
        let segment = path.project([x, y], 0).2;
        Slot {
            status: Status::Active,
            route,
            s,
            segment,
            pose: Pose { x, y, heading },
            size: [4.5, 1.85],
            ..EMPTY
        }
    }

    fn inherited(task: &Task, traffic: &Traffic) -> Vec<u32> {
        let mut priorities = Vec::new();
        inherit(Knowledge::full(&task.routes, traffic), &mut priorities, &mut Vec::new());
        priorities
    }

    #[test]
    fn turns_go_to_whoever_comes_near_first() {
        let task = task();
        let at = [
            ("west_straight", 25.0),
            ("south_straight", 12.0),
            ("east_straight", 15.0),
            ("north_straight", 30.0),
        ];
        let mut traffic = traffic(&task, &at);
        traffic.take_turns(&task.routes, None, 20.0);
        let priorities =
            |traffic: &Traffic| traffic.slots.iter().map(|slot| slot.priority).collect::<Vec<_>>();
        assert_eq!(priorities(&traffic), [0, 1, 2, 0]);
        // A vehicle that comes later has a later priority, however close it gets.
        traffic.slots[0].s += 24.0;
        traffic.take_turns(&task.routes, None, 20.0);
        assert_eq!(priorities(&traffic), [3, 1, 2, 0]);
        traffic.refresh();
        assert_eq!(
            inherited(&task, &traffic),
            [2, 0, 1, u32::MAX],
            "those who have not come near are last"
        );
    }

    #[test]
    fn who_stands_in_the_way_has_the_turn_of_the_one_that_it_blocks() {
        let task = task();
        // The second vehicle stands in the path of the first, which has priority over it; the third
        // waits outside and blocks nobody.
        let mut traffic = traffic(
            &task,
            &[("west_straight", 0.0), ("south_straight", 0.0), ("east_straight", 6.0)],
        );
        let routes = [0, 1].map(|i| traffic.slots[i].route);
        let met = task.routes[routes[0]].meeting(routes[1]).expect("they cross");
        traffic.slots[0] = at(&task, routes[0], met.own - 7.0);
        traffic.slots[1] = at(&task, routes[1], met.other);
        traffic.refresh();
        for (slot, priority) in traffic.slots.iter_mut().zip([2, 3, 1]) {
            slot.priority = priority;
        }
        assert_eq!(inherited(&task, &traffic), [1, 1, 0], "by itself the second would be last");
        assert_eq!(giving_way(&task, &traffic), [true, false, false]);
        // Once the second vehicle is gone, the first drives; it waits for a wreck, whatever the
        // priorities were.
        traffic.slots[1].status = Status::Wreck;
        assert!(giving_way(&task, &traffic)[0]);
        traffic.slots[1].status = Status::Empty;
        assert!(!giving_way(&task, &traffic)[0]);
    }

    proptest! {
        /// Of two vehicles, the one with priority gives way only where the other blocks it or is
        /// ahead.
        #[test]
        fn two_do_not_wait_for_each_other(
            routes in [0usize..12, 0usize..12],
            distance in [-15.0..25.0, -15.0..25.0],
            speed in [0.0..8.0, 0.0..8.0],
        ) {
            let task = task();
            let names = routes.map(|route| task.route_ids[route].clone());
            let mut traffic = traffic(&task, &[(&names[0], distance[0]), (&names[1], distance[1])]);
            for (k, slot) in traffic.slots.iter_mut().enumerate() {
                (slot.priority, slot.speed) = (1 + k as u32, speed[k]);
            }
            let touch = separation(
                (traffic.stance(0), traffic.slots[0].size),
                (traffic.stance(1), traffic.slots[1].size),
            );
            prop_assume!(touch > 1.2);
            let (priorities, waits) = (inherited(&task, &traffic), giving_way(&task, &traffic));
            let blocked = free(Knowledge::full(&task.routes, &traffic), &priorities, 0, 1).blocked < RESERVE;
            let places = [0, 1].map(|k| Candidate::of(&traffic.slots[k]));
            let behind = is_behind(&task.routes, &places[1], &places[0]);
            prop_assert!(!waits[0] || blocked || behind, "{names:?} {waits:?}");
        }
    }
}
