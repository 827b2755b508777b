//! Tests of rewards and of what becomes of a vehicle that crashed.

use super::*;
use crate::env::EpisodeRecord;
use crate::env::Frame;

/// Plays an episode in which slot 0 drives at full throttle on a free lane and the other slots
/// stand. Returns the task, the frames, the front's first position of slot 0 \[m\], and the
/// episode's record.
fn lone_driver(change: fn(&mut Scenario)) -> (Arc<Task>, Vec<Frame>, f64, EpisodeRecord) {
    let task = task(4, |s| {
        s.termination.horizon = 120;
        change(s);
    });
    // Searches for an episode whose first agent has a free lane.
    for episode in 0.. {
        let (mut world, mut rails) = (world(&task, 3), Rails::new(&task));
        world.reset(episode);
        exchange(&mut world, &mut rails, &[0.0; 4]);
        let begin = rails.vehicles[0].expect("spawned").1;
        let mut frames = vec![world.frame().clone()];
        while world.frame().active[1] > 0.0 {
            exchange(&mut world, &mut rails, &[1.0, 0.0, 0.0, 0.0]);
            frames.push(world.frame().clone());
        }
        let record = world.take_finished().expect("the horizon ends it");
        if record.success == 0.25 {
            return (task, frames, begin, record);
        }
    }
    unreachable!()
}

#[test]
fn the_reward_is_for_distance_and_speed_and_then_the_arrival() {
    let (task, frames, _, record) = lone_driver(|_| {});
    let scenario = &task.scenario;
    let end = frames.iter().position(|f| f.terminated[0] > 0.0).expect("it arrives");
    // Expected rewards by their definition and the longitudinal law.
    let (mut v, mut total) = (0.0, 0.0);
    for frame in &frames[1..end] {
        let (distance, speed) = advance(&scenario.control, &scenario.vehicle, v, 1.0);
        v = speed;
        let expected = distance + 0.1 * v / (80.0 / 3.6);
        assert!(
            (f64::from(frame.reward[0]) - expected).abs() < 1e-5,
            "{} {expected}",
            frame.reward[0]
        );
        total += expected;
    }
    assert_eq!(frames[end].reward[0], 10.0);
    assert!((record.reward - (total + 10.0) / 4.0).abs() < 1e-4);
    assert_eq!(
        (record.driving().safety, record.driving().crash, record.episode_length),
        (1.0, 0.0, 120)
    );
    assert!((record.driving().efficiency - 0.25 * 4.0 / 120.0).abs() < 1e-12);
}

/// Rewards in the environment depend neither on the share in other agents' advantages nor on the
/// communication range.
#[test]
fn rewards_depend_neither_on_cooperation_nor_on_the_radio() {
    let own = lone_driver(|_| {}).1;
    let changes: [fn(&mut Scenario); 3] = [
        |s| s.reward.cooperation = 1.0,
        |s| s.communication.range = 5.0,
        |s| (s.reward.cooperation, s.communication.range) = (0.5, 0.0),
    ];
    for change in changes {
        for (own, other) in own.iter().zip(&lone_driver(change).1) {
            assert_eq!(own.reward, other.reward);
            assert!(other.sharing.is_empty(), "all agents of the world share");
        }
    }
    // The share range is independent of the communication range.
    for frame in lone_driver(|s| s.reward.share_range = 0.0).1 {
        let alone = |i: usize, j: usize| f32::from(u8::from(i == j)) * frame.comm[i * 4 + i];
        assert!((0..16).all(|k| frame.sharing[k] == alone(k / 4, k % 4)), "{:?}", frame.sharing);
    }
}

/// With `time`, each step on the road costs the same, driving or standing and in the last step, and
/// nothing afterwards.
#[test]
fn time_on_the_road_costs_the_same_in_every_step() {
    let (free, paid) = (lone_driver(|_| {}).1, lone_driver(|s| s.reward.time = 0.4).1);
    assert_eq!(free.len(), paid.len());
    let mut after = 0;
    for (step, (free, paid)) in free.iter().zip(&paid).enumerate().skip(1) {
        for i in 0..4 {
            let on_road = free.active[i] + free.terminated[i] + free.truncated[i] > 0.0;
            let cost = if on_road { 0.04 } else { 0.0 };
            let paid = free.reward[i] - paid.reward[i];
            assert!((paid - cost).abs() < 1e-5, "step {step}, agent {i}: {paid} {cost}");
            after += usize::from(!on_road);
        }
    }
    assert!(after > 0, "one arrives before the others");
}

#[test]
fn a_crash_replaces_the_reward_of_its_step() {
    let task = task(8, |_| {});
    let (mut world, mut rails) = (world(&task, 1), Rails::new(&task));
    world.reset(0);
    let mut crashes = 0;
    for _ in 0..150 {
        exchange(&mut world, &mut rails, &[1.0; 8]);
        let frame = world.frame();
        for (i, agent) in world.agents().enumerate() {
            let failed =
                frame.terminated[i] > 0.0 && agent.outcome.crashed && !agent.outcome.arrived;
            assert!(!failed || frame.reward[i] == -10.0);
            assert!(failed || frame.reward[i] >= 0.0);
            crashes += usize::from(failed);
        }
    }
    assert!(crashes > 2, "{crashes} crashes at full throttle");
}

#[test]
fn wrecks_stay_for_their_time_and_others_crash_into_them() {
    let task = task(8, |s| s.termination.horizon = 1000);
    let (mut world, mut rails) = (world(&task, 1), Rails::new(&task));
    world.reset(0);
    exchange(&mut world, &mut rails, &[0.0; 8]);
    let mut crashed_at: Vec<Option<usize>> = vec![None; 8];
    let mut wrecks_gone = 0;
    for step in 1..400 {
        let on_road: Vec<bool> = rails.vehicles.iter().map(Option::is_some).collect();
        // Slot 7 stands and keeps the episode going.
        let mut actions = [1.0; 8];
        actions[7] = 0.0;
        exchange(&mut world, &mut rails, &actions);
        for i in 0..8 {
            if world.frame().terminated[i] > 0.0 {
                crashed_at[i] = (world.frame().reward[i] < 0.0).then_some(step);
            }
            if let (Some(at), true, false) =
                (crashed_at[i], on_road[i], rails.vehicles[i].is_some())
            {
                // A wreck time of 2.5 s is 25 further steps; the next exchange removes the
                // vehicle.
                assert_eq!(step - at, 26, "slot {i}");
                wrecks_gone += 1;
            }
        }
        if world.frame().active[7] == 0.0 {
            break;
        }
    }
    assert!(wrecks_gone >= 2, "full throttle crashes");
}
