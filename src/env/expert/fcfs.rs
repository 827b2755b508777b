//! The driver that gives way first come, first served: when it brakes.

use crate::env::driving::OpposingStretch;
use crate::env::driving::agents::{NextSignal, Slot, Status, Traffic};
use crate::env::driving::intention::Knowledge;
use crate::env::driving::right_of_way::{Free, RESERVE, free, inherit, to_entry};
use crate::env::driving::task::Task;
use crate::sumo::net::Aspect;

/// Braking that the rule plans with; less where the vehicle cannot brake as hard \[m/s²\].
const BRAKING: f64 = 6.0;

/// Distance that a vehicle keeps from the stop line of a signal \[m\].
const BEFORE_LINE: f64 = 1.0;

/// Returns for every slot whether its vehicle brakes now: for a vehicle that has priority, is
/// ahead, or stands in its way, or for a signal that is red, or yellow with room to stop.
pub(super) fn giving_way(task: &Task, traffic: &Traffic) -> Vec<bool> {
    let (mut priorities, mut blocked) = (Vec::new(), Vec::new());
    let knowledge = Knowledge::full(&task.map.routes, traffic);
    inherit(knowledge, &mut priorities, &mut blocked);
    let hardest = |slot: &Slot| {
        let control = &task.abilities[slot.kind].0;
        control.brake.last().map_or(control.accel, |(_, brakes)| *brakes).min(BRAKING)
    };
    let control = &task.scenario.control;
    let gives_way = |(slot, own): (usize, &Slot)| {
        let brakes = hardest(own);
        let seen = |space: Free, j| space.min(free(knowledge, &priorities, slot, j));
        let space = (0..priorities.len()).fold(Free::ALL, seen);
        let rules = |j: usize| {
            let behind = behind_leader(knowledge, slot, j, hardest(&traffic.slots[j]));
            before_opposing(knowledge, &priorities, slot, j).min(behind)
        };
        let others = (0..priorities.len()).filter(|&j| j != slot);
        let room = others.map(rules).fold(f64::INFINITY, f64::min);
        let braking = own.speed * own.speed / (2.0 * brakes);
        // A vehicle that has not entered the junction waits outside, where it blocks nobody.
        let outside = to_entry(&task.map, own).is_some_and(|entry| entry < braking);
        let stops = |next: NextSignal| {
            let yellow = next.aspect == Aspect::Yellow && next.distance >= braking;
            (next.aspect.demands_stop() || yellow)
                && next.distance < braking + own.speed * control.interval + BEFORE_LINE
        };
        own.status == Status::Active
            && (own.next_signal.is_some_and(stops)
                || space.distance.min(room) < braking + RESERVE
                || space.blocked < RESERVE
                || outside && space.distance.min(space.slow) < f64::INFINITY)
    };
    traffic.slots.iter().enumerate().map(gives_way).collect()
}

/// Returns how far the vehicle of `slot` can drive if the vehicle of slot `j`, which is ahead of
/// it, brakes with the deceleration `brakes` \[m/s²\] (Gipps, Transportation Research B 1981)
/// \[m\]; infinite if that vehicle is not ahead.
fn behind_leader(knowledge: Knowledge<'_>, slot: usize, j: usize, brakes: f64) -> f64 {
    let [own, other] = [slot, j].map(|slot| &knowledge.traffic.slots[slot]);
    let route = &knowledge.routes[own.route];
    // What stands already has its place in the way by its outline (`free`), also beside a fork.
    let drives = other.status == Status::Active && other.speed > 0.0;
    let gap = route.gap_to_leader(own.s, other.route, other.s).filter(|_| drives);
    gap.map_or(f64::INFINITY, |gap| {
        let lengths = f64::midpoint(own.size[0], other.size[0]);
        gap - lengths + other.speed * other.speed / (2.0 * brakes)
    })
}

/// Returns how far the vehicle of `slot` can drive until it has to wait for the vehicle of slot `j`
/// before a stretch that both use in opposite directions, such as a lane for two directions \[m\]:
/// for one that is on the stretch, or comes to it with priority. Infinite if it need not wait.
fn before_opposing(knowledge: Knowledge<'_>, priorities: &[u32], slot: usize, j: usize) -> f64 {
    let (routes, slots) = (knowledge.routes, &knowledge.traffic.slots);
    let [own, other] = [slot, j].map(|slot| &slots[slot]);
    let [nose, other_nose] = [own, other].map(|slot| slot.s + slot.size[0] / 2.0);
    let waits = |stretch: &&OpposingStretch| {
        let on_it = other_nose > stretch.other[0];
        let has_left = other.s - other.size[0] / 2.0 > stretch.other[1];
        nose < stretch.own[0] && !has_left && (on_it || priorities[j] < priorities[slot])
    };
    let stretches = routes[own.route].opposing_stretches(other.route);
    let first = stretches.iter().filter(|_| other.status != Status::Empty).find(waits);
    first.map_or(f64::INFINITY, |stretch| stretch.own[0] - nose)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::env::driving::agents::Candidate;
    use crate::env::driving::geometry::{Pose, separation};
    use crate::env::driving::right_of_way::{assign, is_behind, keep_back};
    use crate::env::driving::tests::scenario;

    fn task() -> Task {
        Task::new(&scenario("intersection_turns_small"), 8).expect("a task")
    }

    /// Traffic with one vehicle per entry, on the named route and the given distance \[m\] before
    /// its first conflict point.
    fn traffic(task: &Task, vehicles: &[(&str, f64)]) -> Traffic {
        let mut traffic = Traffic::new(vehicles.len(), task.map.routes.len());
        for (slot, (name, distance)) in traffic.slots.iter_mut().zip(vehicles) {
            let is_named = |route: &usize| task.map.route_id(*route) == *name;
            let route = (0..task.map.routes.len()).find(is_named).expect("a route");
            *slot = at(task, route, task.map.routes[route].to_first_conflict(0.0) - distance);
        }
        traffic.refresh();
        traffic
    }

    fn at(task: &Task, route: usize, s: f64) -> Slot {
        let path = &task.map.routes[route].path;
        let ([x, y], heading) = path.at(s);
        let segment = path.project([x, y], 0).2;
        Slot {
            status: Status::Active,
            route,
            s,
            segment,
            pose: Pose { x, y, heading },
            size: [4.5, 1.85],
            ..Slot::default()
        }
    }

    fn inherited(task: &Task, traffic: &Traffic) -> Vec<u32> {
        let mut priorities = Vec::new();
        inherit(Knowledge::full(&task.map.routes, traffic), &mut priorities, &mut Vec::new());
        priorities
    }

    #[test]
    fn priority_goes_to_the_vehicle_that_comes_near_first() {
        let task = task();
        let at = [
            ("west_straight", 25.0),
            ("south_straight", 12.0),
            ("east_straight", 15.0),
            ("north_straight", 30.0),
        ];
        let mut traffic = traffic(&task, &at);
        assign(&mut traffic, &task.map.routes, None, 20.0, &[]);
        let priorities =
            |traffic: &Traffic| traffic.slots.iter().map(|slot| slot.priority).collect::<Vec<_>>();
        assert_eq!(priorities(&traffic), [0, 1, 2, 0]);
        // A vehicle that comes later has a later priority, however close it gets.
        traffic.slots[0].s += 24.0;
        assign(&mut traffic, &task.map.routes, None, 20.0, &[]);
        assert_eq!(priorities(&traffic), [3, 1, 2, 0]);
        traffic.refresh();
        assert_eq!(
            inherited(&task, &traffic),
            [2, 0, 1, u32::MAX],
            "those who have not come near are last"
        );
    }

    #[test]
    fn nobody_waits_for_background_traffic_that_waits_by_its_own_rules() {
        let task = task();
        let mut traffic = traffic(&task, &[("west_straight", 15.0), ("south_straight", 6.0)]);
        traffic.agents = 1;
        let priorities = |traffic: &mut Traffic, speed: f64| {
            traffic.slots[1].speed = speed;
            assign(traffic, &task.map.routes, None, 20.0, &[]);
            [traffic.slots[0].priority, traffic.slots[1].priority]
        };
        assert_eq!(priorities(&mut traffic, 5.0), [2, 1], "it was there first");
        assert_eq!(priorities(&mut traffic, 0.0), [2, 0]);
        assert_eq!(priorities(&mut traffic, 0.2), [2, 3], "it goes after the agent");
        // In the junction, it keeps its priority.
        let route = traffic.slots[1].route;
        traffic.slots[1] = Slot { priority: 1, ..at(&task, route, traffic.slots[1].s + 7.0) };
        assert_eq!(priorities(&mut traffic, 0.0), [2, 1]);
        // Agents that stand keep theirs.
        traffic.agents = 2;
        traffic.slots[1] = Slot { priority: 1, ..at(&task, route, traffic.slots[1].s - 7.0) };
        assert_eq!(priorities(&mut traffic, 0.0), [2, 1]);
    }

    /// Agent 1 is behind background vehicle 2, which stands before the crossing: neither has
    /// priority, so that agent 0 does not wait for them.
    #[test]
    fn nobody_waits_for_an_agent_behind_traffic_that_waits_by_its_own_rules() {
        let task = task();
        let mut traffic = traffic(
            &task,
            &[("west_straight", 15.0), ("south_straight", 12.0), ("south_straight", 3.0)],
        );
        traffic.agents = 2;
        let priorities = |traffic: &mut Traffic, speed: f64| {
            traffic.slots[2].speed = speed;
            let (routes, mut kept_back) = (&task.map.routes, Vec::new());
            keep_back(traffic, routes, &mut kept_back);
            assign(traffic, routes, None, 20.0, &kept_back);
            traffic.slots.iter().map(|slot| slot.priority).collect::<Vec<_>>()
        };
        assert_eq!(priorities(&mut traffic, 5.0), [3, 2, 1], "in the order of their distances");
        assert_eq!(priorities(&mut traffic, 0.0), [3, 0, 0]);
        assert_eq!(priorities(&mut traffic, 0.2), [3, 5, 4], "once it drives");
        // Where it blocks the agent, it does not inherit the agent's priority.
        traffic.slots[2].speed = 0.0;
        traffic.slots[1].priority = 1;
        assert_eq!(inherited(&task, &traffic)[2], 3, "its own one");
    }

    #[test]
    fn a_blocking_vehicle_inherits_the_priority_of_the_vehicle_that_it_blocks() {
        let task = task();
        // The second vehicle stands in the path of the first, which has priority over it; the third
        // waits outside and blocks nobody.
        let mut traffic = traffic(
            &task,
            &[("west_straight", 0.0), ("south_straight", 0.0), ("east_straight", 6.0)],
        );
        let routes = [0, 1].map(|i| traffic.slots[i].route);
        let met = task.map.routes[routes[0]].conflict_with(routes[1]).expect("they cross");
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

    #[test]
    fn a_vehicle_stops_for_a_signal_and_has_no_priority_before_red() {
        let task = task();
        let mut traffic = traffic(&task, &[("west_straight", 19.0), ("south_straight", 12.0)]);
        let say = |traffic: &mut Traffic, speed: f64, distance: f64, aspect: Aspect| {
            traffic.slots[1].speed = speed;
            traffic.slots[1].next_signal = Some(NextSignal { distance, aspect, to_change: None });
            assign(traffic, &task.map.routes, None, 20.0, &[]);
            (traffic.slots[1].priority, giving_way(&task, traffic)[1])
        };
        assert_eq!(say(&mut traffic, 0.0, 0.5, Aspect::Red), (0, true));
        assert_eq!(traffic.slots[0].priority, 1, "the other vehicle does not wait for it");
        traffic.slots[0].status = Status::Empty;
        assert_eq!(say(&mut traffic, 0.0, 0.5, Aspect::Priority), (2, false));
        // The vehicle needs 8.3 m to stop.
        assert_eq!(say(&mut traffic, 10.0, 8.0, Aspect::Yellow), (2, false), "no room to stop");
        assert_eq!(say(&mut traffic, 10.0, 9.0, Aspect::Yellow), (2, true));
        assert_eq!(say(&mut traffic, 10.0, 30.0, Aspect::Red), (2, false), "beyond the conflict");
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
            let names = routes.map(|route| task.map.route_id(route).to_owned());
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
            let blocked = free(Knowledge::full(&task.map.routes, &traffic), &priorities, 0, 1).blocked < RESERVE;
            let places = [0, 1].map(|k| Candidate::of(&traffic.slots[k]));
            let behind = is_behind(&task.map.routes, &places[1], &places[0]);
            prop_assert!(!waits[0] || blocked || behind, "{names:?} {waits:?}");
        }
    }
}
