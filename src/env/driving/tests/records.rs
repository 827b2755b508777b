//! Tests of what an episode's record says about driving: causes of failures, distance, crashes, loitering.

use super::*;
use crate::env::EpisodeRecord;

/// Plays an episode in which the slots that `drives` picks, by route and place in its queue (0:
/// first), drive at full throttle and the others stand. Returns the episode's record and the task.
fn failures_of(agents: u32, drives: impl Fn(usize, usize) -> bool) -> (EpisodeRecord, Arc<Task>) {
    let task = task(agents, |s| s.termination.horizon = 60);
    let (mut world, mut rails) = (world(&task, 1), Rails::new(&task));
    world.reset(0);
    exchange(&mut world, &mut rails, &vec![0.0; agents as usize]);
    let start: Vec<(usize, f64)> =
        rails.vehicles.iter().flatten().map(|(route, s, _)| (*route, *s)).collect();
    let place = |(route, s): (usize, f64)| {
        start.iter().filter(|other| other.0 == route && other.1 > s).count()
    };
    let actions: Vec<f32> =
        start.iter().map(|&at| f32::from(u8::from(drives(at.0, place(at))))).collect();
    loop {
        exchange(&mut world, &mut rails, &actions);
        if let Some(record) = world.take_finished() {
            return (record, task);
        }
    }
}

#[test]
fn failures_say_how_a_crash_came_about() {
    // On one lane, the second vehicle hits the first, which stands, and the third hits the wreck;
    // the fourth stands.
    let (record, _) = failures_of(16, |route, place| route == 0 && (place == 1 || place == 2));
    let failures = &record.driving().failures;
    assert_eq!((failures.rear_end, failures.wreck, failures.crossing), (2, 1, 0), "{failures:?}");
    assert_eq!((failures.upstream, failures.unfinished, failures.out_of_road), (3, 13, 0));
    assert!(failures.steps > 3 * 10 && failures.speeds > 3.0, "{failures:?}");
    let text = failures.describe().join("\n");
    for part in [
        "3 vehicles crashed: 0 % with a vehicle on a crossing route",
        "67 % with one on their own route",
        "33 % into a wreck",
        "100 % of them",
    ] {
        assert!(text.contains(part), "{text}");
    }
    assert!(text.contains("13 vehicles had not arrived") && !text.contains("off-road"), "{text}");

    // The first vehicles of two routes that cross.
    let (record, task) = failures_of(8, |route, place| place == 0 && (route == 1 || route == 2));
    let failures = &record.driving().failures;
    let names = [2, 1].map(|route| task.scenario.routes[route].id.clone());
    assert_eq!(
        failures.routes.keys().collect::<Vec<_>>(),
        [&format!("{} × {}", names[0], names[1])],
        "{failures:?}"
    );
    assert_eq!(
        (failures.crossing, failures.rear_end, failures.wreck, failures.upstream),
        (2, 0, 0, 0)
    );
    assert_eq!(f64::from(failures.crashed()), record.driving().crash * 8.0);

    let both = failures.clone().plus(failures);
    assert_eq!((both.crossing, both.unfinished, both.steps), (4, 12, 2 * failures.steps));
    assert_eq!(both.routes.values().sum::<u32>(), 4);
}

/// Plays an episode in which agent `k` of one lane, counted from the first, stops `stops[k]`
/// metres before the finish, or drives through at full throttle if there is no stop; all other
/// agents stand at their spawn places. Returns the record, and the distance driven by SUMO's
/// count \[km\].
fn lane(stops: &[Option<f64>]) -> (EpisodeRecord, f64) {
    let task = task(16, |s| s.termination.horizon = 300);
    let (mut world, mut rails) = (world(&task, 1), Rails::new(&task));
    world.reset(0);
    exchange(&mut world, &mut rails, &[0.0; 16]);
    let start: Vec<(usize, f64)> =
        rails.vehicles.iter().flatten().map(|(route, s, _)| (*route, *s)).collect();
    let mut lane: Vec<usize> = (0..16).filter(|&i| start[i].0 == 0).collect();
    lane.sort_by(|&a, &b| start[b].1.total_cmp(&start[a].1));
    let half = task.scenario.vehicle.length / 2.0;
    let mut last = start.clone();
    loop {
        let mut actions = [0.0; 16];
        for (&i, stop) in lane.iter().zip(stops) {
            let Some((route, front, speed)) = rails.vehicles[i] else { continue };
            let left = stop.map(|stop| task.map.routes[route].arrival + half - stop - front);
            // Brakes so that the vehicle stops at the wanted position.
            let wanted = left.map_or(f64::INFINITY, |left| (8.0 * left.max(0.0)).sqrt());
            actions[i] = if speed >= wanted { -0.3 } else { 1.0 };
        }
        exchange(&mut world, &mut rails, &actions);
        for (last, vehicle) in last.iter_mut().zip(&rails.vehicles) {
            last.1 = vehicle.map_or(last.1, |(_, s, _)| s);
        }
        if let Some(record) = world.take_finished() {
            let driven: f64 = last.iter().zip(&start).map(|(last, start)| last.1 - start.1).sum();
            return (record, driven / 1000.0);
        }
    }
}

#[test]
fn an_agent_that_waits_before_its_finish_loiters() {
    let share = |stops: &[Option<f64>]| lane(stops).0.driving().loitering * 16.0;
    assert_eq!(share(&[Some(5.0)]), 1.0, "it stands 5 m before its finish, with nobody ahead");
    assert_eq!(share(&[Some(20.0)]), 0.0, "it is not near its finish");
    assert_eq!(share(&[None]), 0.0, "it drives through");
    // The second vehicle stands 12 m before the finish, behind the first. Only the first loiters.
    let (queue, _) = lane(&[Some(5.0), Some(12.0)]);
    assert_eq!((queue.driving().loitering * 16.0, queue.driving().crashes), (1.0, 0));
    assert_eq!(share(&[None, Some(12.0)]), 1.0, "the first has arrived and is in nobody's way");
}

#[test]
fn an_agent_that_has_not_moved_yet_does_not_loiter() {
    let task = task(4, |s| s.termination.horizon = 60);
    let half = task.scenario.vehicle.length / 2.0;
    // Searches for an episode whose first agent is alone on its lane. The finish of its route is
    // then moved to 8 m ahead of the agent.
    let begin = |seed| {
        let (mut world, mut rails) = (world(&task, seed), Rails::new(&task));
        world.reset(0);
        exchange(&mut world, &mut rails, &[0.0; 4]);
        let vehicles: Vec<_> = rails.vehicles.iter().flatten().copied().collect();
        let (route, front, _) = vehicles[0];
        vehicles[1..].iter().all(|other| other.0 != route).then_some((seed, route, front))
    };
    let (seed, route, front) = (0..).find_map(begin).expect("there is one");
    let mut close = Task::clone(&task);
    close.map.routes[route].arrival = front - half + 8.0;
    let close = Arc::new(close);
    // Returns the share of agents that loiter if agent 0 drives for this number of steps and then
    // stands.
    let loitering = |steps: usize| {
        let (mut world, mut rails) = (world(&close, seed), Rails::new(&close));
        world.reset(0);
        for step in 0.. {
            exchange(
                &mut world,
                &mut rails,
                &[if step <= steps { 0.5 } else { -1.0 }, 0.0, 0.0, 0.0],
            );
            if let Some(record) = world.take_finished() {
                return record.driving().loitering;
            }
        }
        unreachable!()
    };
    assert_eq!(loitering(0), 0.0);
    assert_eq!(loitering(8), 0.25);
}

#[test]
fn distance_and_crashes_are_counted() {
    let (record, driven) = lane(&[None]);
    assert!(
        driven > 0.05 && (record.driving().distance_km - driven).abs() < 1e-3,
        "{} {driven}",
        record.driving().distance_km
    );
    assert_eq!(record.driving().crashes, 0);
    // The second vehicle of the lane hits the first, which stands: one crash of two agents. The
    // third hits the wrecks: one more crash.
    let (record, _) = failures_of(16, |route, place| route == 0 && (place == 1 || place == 2));
    assert_eq!(
        (record.driving().crashes, record.driving().failures.crashed()),
        (2, 3),
        "{record:?}"
    );
}
