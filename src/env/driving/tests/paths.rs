//! Tests of routes, their conflicts, and the paths that vehicles drive on them.

use super::super::geometry::{Pose, boxes_overlap};
use super::super::routes::RouteGeometry;
use super::super::surface::BESIDE;
use super::super::vehicle::tyres::Motion;
use super::*;

/// Behind a fork, a vehicle on the other route counts as ahead as long as vehicles on both would
/// touch.
#[test]
fn a_vehicle_behind_a_fork_is_still_ahead() {
    let scenario = scenario("intersection_turns_small");
    let task = Task::new(&scenario, 8).expect("a task");
    let route = |id: &str| task.map.route_ids.iter().position(|own| own == id).expect("a route");
    let (left, right) = (route("west_left"), route("west_right"));
    let (own, other) = (&task.map.routes[left], &task.map.routes[right]);
    let fork = other.path.arc(0, -1e-6).expect("the end of its first edge");
    for s in [fork - 10.0, fork - 0.1, fork + 2.0] {
        let there = own.gap_to(0.0, right, s).unwrap_or_else(|| panic!("{s} of {fork}"));
        assert!((there - s).abs() < 0.1, "{s}: {there}");
    }
    assert_eq!(own.gap_to(0.0, right, other.path.length() - 1.0), None);
    // A vehicle that counts as ahead is close to the path.
    for (a, own) in task.map.routes.iter().enumerate() {
        for (b, other) in task.map.routes.iter().enumerate().filter(|(b, _)| *b != a) {
            for s in (0..other.path.length() as u32).map(f64::from) {
                let Some(there) = own.gap_to(0.0, b, s) else { continue };
                let ([x, y], [u, v]) = (other.path.at(s).0, own.path.at(there).0);
                assert!(
                    (x - u).hypot(y - v) < 5.0,
                    "{} at {s} is not ahead of {}",
                    task.map.route_ids[b],
                    task.map.route_ids[a]
                );
            }
        }
    }
}

/// Every vehicle that an agent could touch on its path is an encounter: it is ahead, or the two
/// routes have a conflict.
#[test]
fn every_vehicle_in_the_way_is_an_encounter() {
    for name in ["intersection_turns_small", "intersection_turns", "parking_lot"] {
        let scenario = scenario(name);
        let task = Task::new(&scenario, scenario.agents.default).expect("a task");
        let size = [scenario.vehicle.length, scenario.vehicle.width];
        let mut unseen = Vec::new();
        for (a, own) in task.map.routes.iter().enumerate() {
            for (b, other) in task.map.routes.iter().enumerate().filter(|(b, _)| *b != a) {
                // Positions up to the arrival.
                let samples = |route: &RouteGeometry| {
                    (0..=(2.0 * route.arrival) as u32).map(|k| f64::from(k) / 2.0)
                };
                for s in samples(other) {
                    if own.gap_to(f64::NEG_INFINITY, b, s).is_some() {
                        continue;
                    }
                    let live = |t: f64| own.next_conflict(t, b, s, CLEARED).is_some();
                    // A vehicle past the conflict point drives on.
                    let ahead =
                        |t: f64| own.next_conflict(t, b, f64::NEG_INFINITY, CLEARED).is_some();
                    let past = |t: f64| own.conflict_with(b).is_some() && !ahead(t);
                    let there = Pose::on(&other.path, s);
                    let touched =
                        |t: &f64| boxes_overlap((&Pose::on(&own.path, *t), size), (&there, size));
                    if let Some(t) = samples(own).find(|t| touched(t) && !live(*t) && !past(*t)) {
                        unseen.push(format!(
                            "{name}: {} at {s} for {} at {t}",
                            task.map.route_ids[b], task.map.route_ids[a]
                        ));
                        break;
                    }
                }
            }
        }
        assert!(unseen.is_empty(), "{}:\n{}", unseen.len(), unseen.join("\n"));
    }
}

/// A conflict's area ends where no vehicle on the other route is touched any more.
#[test]
fn the_area_of_a_conflict_is_where_vehicles_touch() {
    let straight = scenario("intersection");
    let task = Task::new(&straight, 8).expect("a task");
    let half = f64::midpoint(straight.vehicle.length, straight.vehicle.width);
    for conflict in task.map.routes.iter().flat_map(|route| &route.conflicts) {
        // Two straight paths at right angles.
        for ([enters, leaves], at) in
            [(conflict.own_area, conflict.own), (conflict.other_area, conflict.other)]
        {
            assert!((at - enters - half).abs() < 0.3 && (leaves - at - half).abs() < 0.3);
        }
    }
    let scenario = scenario("intersection_turns_small");
    let task = Task::new(&scenario, 8).expect("a task");
    let size = [scenario.vehicle.length, scenario.vehicle.width];
    let (mut merges, mut crossings) = (0, 0);
    for own in &task.map.routes {
        for conflict in &own.conflicts {
            let other = &task.map.routes[conflict.route];
            let touches = |t: f64| {
                let there = |k: i32| Pose::on(&other.path, conflict.other + f64::from(k) * 0.25);
                let here = Pose::on(&own.path, t);
                (-80..=80).any(|k| boxes_overlap((&here, size), (&there(k), size)))
            };
            let [enters, leaves] = conflict.own_area;
            assert!(enters <= conflict.own && conflict.own <= leaves);
            let inside = (0..=20).map(|k| enters + (leaves - enters) * f64::from(k) / 20.0);
            assert!(inside.into_iter().all(touches), "{conflict:?}");
            assert!(!touches(enters - 0.3), "{conflict:?}");
            let merges_here = leaves - conflict.own > 19.5;
            assert!(merges_here || !touches(leaves + 0.3), "{conflict:?}");
            *(if merges_here { &mut merges } else { &mut crossings }) += 1;
        }
    }
    assert!(merges > 0 && crossings > 0, "{merges} merges, {crossings} crossings");
}

/// Pure pursuit stays on the road on every route, also where a route turns back within 3.5 m,
/// which no vehicle can follow exactly.
#[test]
fn pursuit_stays_on_the_road_of_every_route() {
    let mut around = 0;
    for name in ["intersection_turns_small", "intersection_turns"] {
        let scenario = scenario(name);
        let task = Task::new(&scenario, 8).expect("a task");
        let (control, road) = (&scenario.control, task.map.road());
        let steering = control.steering.as_ref().expect("vehicles steer");
        for (route, id) in task.map.routes.iter().zip(&task.map.route_ids) {
            around += usize::from(route.avoided.is_some());
            let mut motion = Motion::at(Pose::on(&route.path, 6.0));
            let (mut s, mut segment) = (6.0, 0);
            for _ in 0..500 {
                let throttle = (6.0 - motion.velocity.x) / (0.5 * control.accel);
                let at = [motion.pose.x, motion.pose.y];
                let lateral;
                (s, lateral, segment) = route.path.project(at, segment);
                assert!(
                    lateral.abs() < 1.0,
                    "{name}: {id} is {lateral} m from its path, at {at:?}"
                );
                let steer = crate::env::expert::steer(steering, &route.path, s, &motion.pose);
                motion = motion.advance(
                    control,
                    steering,
                    &scenario.vehicle,
                    steer,
                    throttle.clamp(-1.0, 1.0),
                );
                assert!(!road.is_off_road(&motion.pose), "{name}: {id} at {:?}", motion.pose);
                if s > route.path.length() - 4.0 {
                    break;
                }
            }
            assert!(
                s > route.path.length() - 4.0,
                "{name}: {id} has come to {s:.1} m of {:.1}",
                route.path.length()
            );
        }
    }
    assert_eq!(around, 4, "the inner lane of each arm of the large intersection");
}

/// An agent that steers arrives on any lane of its last edge, but not beside the road or on lanes
/// of the other direction.
#[test]
fn an_agent_that_steers_arrives_on_any_lane() {
    let scenario = scenario("intersection_turns");
    let task = Task::new(&scenario, 8).expect("a task");
    let mut ends = HashSet::new();
    for route in &task.map.routes {
        let [right, left] = route.finish;
        let width = route.path.widths.last().expect("a path has segments");
        // The finish spans two lanes: the route's own and the one beside it.
        assert!((left - right - 2.0 * width).abs() < 1e-9, "{right} {left}");
        ends.insert(if left > -right { "right lane" } else { "left lane" });
    }
    assert_eq!(ends.len(), 2);
}

#[test]
fn conflicts_lie_where_lanes_cross() {
    let task = task(8, |_| {});
    let route = |id: &str| task.scenario.routes.iter().position(|r| r.id == id).expect("a route");
    let (east, west, south, north) =
        (route("eastbound"), route("westbound"), route("southbound"), route("northbound"));
    // Eastbound (y = 0, from x = 0) has conflicts with southbound at x = 40 and with northbound at
    // x = 43.5, and none with westbound.
    let conflicts = &task.map.routes[east].conflicts;
    assert_eq!(conflicts.iter().map(|c| c.route).collect::<Vec<_>>(), [south, north]);
    assert!((conflicts[0].own - 40.0).abs() < 1e-6 && (conflicts[1].own - 43.5).abs() < 1e-6);
    // Southbound starts at y = 43.5 and reaches y = 0 after 43.5 m.
    assert!((conflicts[0].other - 43.5).abs() < 1e-6);
    assert_eq!(task.map.routes[east].apart, [west]);
    for (a, own) in task.map.routes.iter().enumerate() {
        for c in &own.conflicts {
            let back =
                task.map.routes[c.route].conflicts.iter().find(|d| d.route == a).expect("mutual");
            assert!((back.own - c.other).abs() < 1e-9 && (back.other - c.own).abs() < 1e-9);
        }
    }
}

#[test]
fn overlapping_paths_have_a_conflict() {
    let scenario = scenario("parking_lot");
    let task = Task::new(&scenario, 5).expect("a task");
    let index =
        |id: &str| scenario.routes.iter().position(|route| route.id == id).expect("a route");
    let meeting = |a: &str, b: &str| task.map.routes[index(a)].conflict_with(index(b));
    // A route into a space and a route out of it share the space and the last metres before it.
    let met = meeting("west_space1", "space1_north").expect("they meet");
    assert!((met.own - (25.0 + 10.5)).abs() < 4.0 * 1.6 + 3.6, "{met:?}");
    for (leaves, enters) in [
        ("space1_north", "west_space1"),
        ("space5_west", "north_space5"),
        ("space7_south", "west_space7"),
    ] {
        // The conflict of a route out of a space with a route into it is at the end of their
        // common stretch, where the vehicle is out of the space. The space is 7 m long.
        let met = meeting(leaves, enters).expect("they meet");
        assert!((2.0..12.0).contains(&met.own), "{leaves}, {enters}: {met:?}");
        let place = |id: &str, s: f64| task.map.routes[index(id)].path.at(s).0;
        let (a, b) = (place(leaves, met.own), place(enters, met.other));
        assert!((a[0] - b[0]).hypot(a[1] - b[1]) < 0.2, "one place for both: {a:?} {b:?}");
        let back = meeting(enters, leaves).expect("they meet");
        assert!(
            (met.own - back.other).abs() < 0.2 && (met.other - back.own).abs() < 0.2,
            "{met:?} {back:?}"
        );
    }
    assert!(meeting("west_space1", "space8_west").is_some(), "paths over the lot cross");
    assert!(
        meeting("west_space2", "space1_west").is_some()
            && meeting("west_space5", "space1_west").is_none()
    );
}

/// The reward for speed depends on its magnitude, as in the paper's simulator: driving backwards
/// is rewarded as well.
#[test]
fn the_reward_for_speed_is_for_its_magnitude() {
    let scenario = scenario("parking_lot");
    let task = Arc::new(Task::new(&scenario, 1).expect("a task"));
    let there = Snapshot {
        vehicles: vec![Some(VehicleState { distance: 0.0, speed: 0.0 })],
        ..Snapshot::default()
    };
    for steer in [0.0, 1.0] {
        let mut world = world(&task, 0);
        world.reset(0);
        let mut before = 0.0;
        for step in 0..6 {
            world.act(0, &[steer, -1.0], &mut Vec::new());
            world.observe(0, &there).expect("it is there");
            let agent = world.agents().next().expect("an agent");
            if step > 0 {
                let speed = agent.reward - scenario.reward.progress * (agent.position - before);
                assert!(agent.driving && agent.speed < 0.0 && speed > 0.0, "{agent:?}");
            }
            before = agent.position;
        }
    }
}

/// With `laneKeeping`, an agent loses a share of its reward for progress in proportion to its
/// distance from the centre line of its route, up to half a lane's width. Where it drives back, or
/// off the lane with a negative `offLane`, nothing is lost.
#[test]
fn keeping_the_lane_is_rewarded_where_the_scenario_asks_for_it() {
    let there = Snapshot {
        vehicles: vec![Some(VehicleState { distance: 0.0, speed: 0.0 })],
        ..Snapshot::default()
    };
    // Rewards, distances driven, and lateral offsets of a vehicle that steers off its route and
    // then drives backwards.
    let drive = |weight: f64| {
        let mut scenario = scenario("parking_lot");
        scenario.reward.lane_keeping = weight;
        scenario.routes.iter_mut().for_each(|route| route.off_lane = -1.0);
        let task = Arc::new(Task::new(&scenario, 1).expect("a task"));
        let mut world = world(&task, 0);
        world.reset(0);
        let mut steps = Vec::new();
        for step in 0..60 {
            let throttle = if step < 35 { 1.0 } else { -1.0 };
            world.act(0, &[0.1, throttle], &mut Vec::new());
            world.observe(0, &there).expect("it is there");
            let agent = world.agents().next().expect("an agent");
            let slot = &world.traffic().slots[0];
            let width = task.map.routes[slot.route].path.widths[slot.segment];
            let driven = slot.s - slot.s_before;
            steps.push((agent.driving, agent.reward, driven, slot.lateral.abs(), width));
        }
        steps
    };
    let (mut beside, mut off) = (0.0_f64, 0);
    for (free, kept) in drive(0.0).iter().zip(&drive(0.5)).skip(1) {
        let &(driving, reward, driven, lateral, width) = kept;
        assert_eq!((free.0, free.2, free.3), (driving, driven, lateral), "the same drive");
        assert!(reward <= free.1, "nothing is gained: {free:?} {kept:?}");
        let is_off = lateral > width / 2.0 + BESIDE;
        let lost = if driving {
            let progress = if is_off { -driven.abs() } else { driven };
            0.5 * (lateral / (width / 2.0)).min(1.0) * progress.max(0.0)
        } else {
            0.0
        };
        assert!((free.1 - reward - lost).abs() < 1e-9, "{free:?} {kept:?}");
        beside = beside.max(lost);
        off += usize::from(driving && is_off);
    }
    assert!(beside > 0.05, "the vehicle leaves its route's centre line: {beside}");
    assert!(off > 0, "the vehicle leaves its lane");
}
