//! Who gives way to whom, first come, first served, as a junction does that grants ways in the order in which vehicles ask for them
//! (Dresner and Stone, JAIR 2008): vehicles' turns, and a driver that needs no training.

use super::foresight::{Course, DRIVING, passing};
use super::intention::{Candidate, Knowledge};
use super::routes::RouteGeometry;
use super::slots::{Slot, Status, Traffic};
use super::task::Task;

/// How far ahead it looks \[s\].
const HORIZON: f64 = 5.0;
/// Shares of what foresight takes for close: who would come within 1 m is given way to; who stands 0.3 m beside the way is passed.
const TOO_CLOSE: f64 = 2.0 / 3.0;
const IN_THE_WAY: f64 = 0.9;
/// It stops so far, from centre to centre, from where it would be too close \[m\].
const RESERVE: f64 = 4.0;
/// Whose nose is farther than this past the line where it could have waited has entered \[m\].
const OVER: f64 = 3.0;
/// How hard it plans to brake, if it can \[m/s²\].
const BRAKING: f64 = 6.0;
/// Whoever comes to another that stands within this time is blocked by it \[s\].
const BLOCKED: f64 = 3.0;
/// Nobody so far away does \[m\].
const FAR: f64 = 30.0;

/// How far an agent can drive until it comes too close to others, at 6 m/s at least \[m\]; nothing is in the way where that is
/// infinite.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Free {
    /// To one that comes before it, is ahead, or is a wreck, at its speed or at 6 m/s.
    pub(super) way: f64,
    /// The same, where the agent drives half as fast.
    pub(super) slow: f64,
    /// To one that comes after it, but stands in its way now.
    pub(super) blocked: f64,
}

impl Free {
    pub(super) const ALL: Self =
        Self { way: f64::INFINITY, slow: f64::INFINITY, blocked: f64::INFINITY };

    /// The nearer of each.
    pub(super) fn min(self, other: Self) -> Self {
        Self {
            way: self.way.min(other.way),
            slow: self.slow.min(other.slow),
            blocked: self.blocked.min(other.blocked),
        }
    }
}

/// How another vehicle stands to an agent.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Standing {
    /// It is behind the agent.
    Behind,
    /// It is ahead of the agent, or a wreck.
    Ahead,
    /// Its turn is before the agent's.
    Before,
    /// Its turn is after the agent's.
    After,
}

/// How far the vehicle of `slot` can drive, as far as that of slot `j` is concerned: on whichever
/// of the routes that the other may take the agent can drive least far.
pub(super) fn free(knowledge: Knowledge<'_>, turns: &[u32], slot: usize, j: usize) -> Free {
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
        } else if turns[j] < turns[slot] {
            Standing::Before
        } else {
            Standing::After
        }
    };
    let on = |place: Candidate| {
        let way = |least: f64, at: f64, close_to: f64| {
            let speed = own.speed.max(least);
            let course = Course::on(routes, place, other.size, at);
            let [close, soon] = passing(Course::new(routes, own, speed), course, HORIZON);
            if close > close_to { speed * HORIZON * (1.0 - soon) } else { f64::INFINITY }
        };
        let before = |at: f64| Free {
            way: way(DRIVING, at, TOO_CLOSE),
            slow: way(DRIVING / 2.0, at, TOO_CLOSE),
            ..Free::ALL
        };
        match standing(&place) {
            Standing::Behind => Free::ALL,
            Standing::Ahead => before(other.speed),
            Standing::Before => before(other.speed).min(before(other.speed.max(DRIVING))),
            Standing::After => Free { blocked: way(DRIVING, 0.0, IN_THE_WAY), ..Free::ALL },
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

/// Which vehicles brake now: for one that comes before them, is ahead, or stands in their way.
pub(super) fn giving_way(task: &Task, traffic: &Traffic) -> Vec<bool> {
    let (mut turns, mut blocked) = (Vec::new(), Vec::new());
    let knowledge = Knowledge::full(&task.routes, traffic);
    inherit(knowledge, &mut turns, &mut blocked);
    let control = &task.scenario.control;
    let brakes = control.brake.last().map_or(control.accel, |(_, brakes)| *brakes).min(BRAKING);
    let gives_way = |(slot, own): (usize, &Slot)| {
        let seen = |free: Free, j| free.min(self::free(knowledge, &turns, slot, j));
        let free = (0..turns.len()).fold(Free::ALL, seen);
        let braking = own.speed * own.speed / (2.0 * brakes);
        // Who has not entered yet waits outside, where it is in nobody's way.
        let outside = to_entry(task, own).is_some_and(|entry| entry < braking);
        own.status == Status::Active
            && (free.way < braking + RESERVE
                || free.blocked < RESERVE
                || outside && free.way.min(free.slow) < f64::INFINITY)
    };
    traffic.slots.iter().enumerate().map(gives_way).collect()
}

/// How far a vehicle has to go to the next place where it can wait outside: before a junction, or before its way first meets another's
/// \[m\]; none where it has entered.
pub(super) fn to_entry(task: &Task, slot: &Slot) -> Option<f64> {
    let nose = slot.s + slot.size[0] / 2.0;
    let meeting = task.routes[slot.route].to_first_conflict(slot.s) - RESERVE;
    let lines = task.junctions[slot.route].iter().map(|junction| junction.from - nose);
    lines.chain([meeting]).filter(|way| *way > -OVER).min_by(f64::total_cmp)
}

/// Whether `behind` comes to where `ahead` is on its way.
fn is_behind(routes: &[RouteGeometry], ahead: &Candidate, behind: &Candidate) -> bool {
    routes[behind.route].shared_position(ahead.route, ahead.s).is_some_and(|s| s > behind.s)
}

/// The vehicles' `turns`, of which the smallest is first. Whoever stands in the way of another has
/// that one's turn, if it is before its own: otherwise each of them would wait for the other. One
/// that may take several routes is in the way of another if it is so for any route that the other
/// may take. `blocked` is scratch.
pub(super) fn inherit(
    knowledge: Knowledge<'_>,
    turns: &mut Vec<u32>,
    blocked: &mut Vec<(usize, usize)>,
) {
    let Knowledge { routes, traffic, .. } = knowledge;
    let slots = &traffic.slots;
    turns.clear();
    // Who has not come near is after all who have.
    turns.extend(slots.iter().map(|slot| slot.turn.wrapping_sub(1)));
    let drives = |i: usize| slots[i].status == Status::Active;
    let stands_in_the_way = |i: usize, j: usize| {
        let waits_behind =
            |own: Candidate| knowledge.candidates(j).any(|other| is_behind(routes, &other, &own));
        // Where it stands is the same on all of its routes.
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
    // Along chains of any length.
    let mut changed = true;
    while std::mem::take(&mut changed) {
        for &(i, j) in &*blocked {
            changed |= turns[j] < turns[i];
            turns[i] = turns[i].min(turns[j]);
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

    /// Vehicles so many metres before where their ways first meet others', on routes of these names.
    fn traffic(task: &Task, vehicles: &[(&str, f64)]) -> Traffic {
        let mut traffic = Traffic::new(vehicles.len(), task.routes.len());
        for (slot, (name, way)) in traffic.slots.iter_mut().zip(vehicles) {
            let route = task.route_ids.iter().position(|id| id == name).expect("a route");
            *slot = at(task, route, task.routes[route].to_first_conflict(0.0) - way);
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
        let mut turns = Vec::new();
        inherit(Knowledge::full(&task.routes, traffic), &mut turns, &mut Vec::new());
        turns
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
        let turns =
            |traffic: &Traffic| traffic.slots.iter().map(|slot| slot.turn).collect::<Vec<_>>();
        assert_eq!(turns(&traffic), [0, 1, 2, 0]);
        // Who comes later is behind, however close it gets.
        traffic.slots[0].s += 24.0;
        traffic.take_turns(&task.routes, None, 20.0);
        assert_eq!(turns(&traffic), [3, 1, 2, 0]);
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
        // The second stands across the way of the first, which came before it; the third is outside, and in nobody's way.
        let mut traffic = traffic(
            &task,
            &[("west_straight", 0.0), ("south_straight", 0.0), ("east_straight", 6.0)],
        );
        let routes = [0, 1].map(|i| traffic.slots[i].route);
        let met = task.routes[routes[0]].meeting(routes[1]).expect("they cross");
        traffic.slots[0] = at(&task, routes[0], met.own - 7.0);
        traffic.slots[1] = at(&task, routes[1], met.other);
        traffic.refresh();
        for (slot, turn) in traffic.slots.iter_mut().zip([2, 3, 1]) {
            slot.turn = turn;
        }
        assert_eq!(inherited(&task, &traffic), [1, 1, 0], "by itself the second would be last");
        assert_eq!(giving_way(&task, &traffic), [true, false, false]);
        // Once it is gone, the first drives; a wreck is waited for, whatever its turn was.
        traffic.slots[1].status = Status::Wreck;
        assert!(giving_way(&task, &traffic)[0]);
        traffic.slots[1].status = Status::Empty;
        assert!(!giving_way(&task, &traffic)[0]);
    }

    proptest! {
        /// The one that came first gives way only where the other stands in its way or is ahead.
        #[test]
        fn two_do_not_wait_for_each_other(
            routes in [0usize..12, 0usize..12],
            way in [-15.0..25.0, -15.0..25.0],
            speed in [0.0..8.0, 0.0..8.0],
        ) {
            let task = task();
            let names = routes.map(|route| task.route_ids[route].clone());
            let mut traffic = traffic(&task, &[(&names[0], way[0]), (&names[1], way[1])]);
            for (k, slot) in traffic.slots.iter_mut().enumerate() {
                (slot.turn, slot.speed) = (1 + k as u32, speed[k]);
            }
            let touch = separation(
                (traffic.stance(0), traffic.slots[0].size),
                (traffic.stance(1), traffic.slots[1].size),
            );
            prop_assume!(touch > 1.2);
            let (turns, waits) = (inherited(&task, &traffic), giving_way(&task, &traffic));
            let blocked = free(Knowledge::full(&task.routes, &traffic), &turns, 0, 1).blocked < RESERVE;
            let places = [0, 1].map(|k| Candidate::of(&traffic.slots[k]));
            let behind = is_behind(&task.routes, &places[1], &places[0]);
            prop_assert!(!waits[0] || blocked || behind, "{names:?} {waits:?}");
        }
    }
}
