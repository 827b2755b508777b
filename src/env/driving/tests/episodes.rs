//! Tests of episodes: slots, masks, ends, and who takes part.

use super::*;

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// Slots, masks, ends of episodes and observations are consistent over several episodes of
    /// erratic driving.
    #[test]
    fn invariants_hold_under_any_actions(
        agents in 4u32..49,
        seed in any::<u64>(),
        mean in -0.3f32..1.2,
        horizon in 5u32..150,
        range in 0.0f64..120.0,
        fewest in 1usize..60,
    ) {
        let task = task(agents, |s| {
            s.termination.horizon = horizon;
            s.communication.range = range;
        });
        let task = Arc::new(Task::clone(&task).with_fewest(fewest));
        let n = agents as usize;
        let (o, s) = (task.spec.observation.len(), task.spec.state.len());
        let (mut world, mut rails) = (world(&task, seed), Rails::new(&task));
        world.reset(0);
        let mut rng = Seed::new(seed).child("actions").rng();
        let mut actions = vec![0.0; n];
        let mut dead = HashSet::new();
        let mut episodes = 0;
        for _ in 0..400 {
            crate::rng::fill_normal(&mut rng, &mut actions);
            for action in &mut actions {
                *action = if *action > 2.5 { f32::NAN } else { *action + mean };
            }
            let before = world.frame().clone();
            exchange(&mut world, &mut rails, &actions);
            let finished = world.take_finished();
            let frame = world.frame();
            if frame.start[0] > 0.0 {
                dead.clear();
                let active_agents = frame.active.iter().filter(|&&a| a == 1.0).count();
                prop_assert!(active_agents >= fewest.min(n));
            }
            for i in 0..n {
                let (active, was_active) = (frame.active[i] > 0.0, before.active[i] > 0.0);
                let (terminated, truncated) = (frame.terminated[i] > 0.0, frame.truncated[i] > 0.0);
                let present = frame.comm[i * n + i] > 0.0;
                prop_assert!(!(terminated && truncated), "an end is one or the other");
                if frame.start[0] > 0.0 {
                    prop_assert!(!terminated && !truncated);
                } else {
                    prop_assert_eq!(terminated || truncated, was_active && !active, "an end is where activity ends");
                    prop_assert!(!dead.contains(&i) || !active, "slot {} revived", i);
                }
                prop_assert_eq!(present, active || truncated, "seen while active, and once more when truncated");
                if !active {
                    dead.insert(i);
                }
                let seen = &frame.observation[i * o..(i + 1) * o];
                let known = &frame.state[i * s..(i + 1) * s];
                if present {
                    for (value, feature) in seen.iter().zip(&task.spec.observation.list)
                        .chain(known.iter().zip(&task.spec.state.list))
                    {
                        prop_assert!((feature.low..=feature.high).contains(value), "{} = {}", feature.name, value);
                    }
                } else {
                    prop_assert!(seen.iter().chain(known).all(|&v| v == 0.0), "a dead agent sees nothing");
                }
                for j in 0..n {
                    let both = present && frame.comm[j * n + j] > 0.0;
                    let linked = frame.comm[i * n + j] > 0.0;
                    prop_assert!(both || !linked, "the absent are cut off");
                    if let (true, Some(a), Some(b)) = (both && i != j, rails.centre(i), rails.centre(j)) {
                        // Lateral jitter moves each centre by up to 0.25 m.
                        let d = (a[0] - b[0]).hypot(a[1] - b[1]);
                        prop_assert!(linked || d > range - 0.6, "{} {}", d, range);
                        prop_assert!(!linked || d < range + 0.6, "{} {}", d, range);
                    }
                }
            }
            if let Some(record) = finished {
                episodes += 1;
                prop_assert!(frame.active.iter().all(|&a| a == 0.0));
                prop_assert!(record.episode_length <= horizon);
                prop_assert_eq!(record.step_rewards.len(), record.episode_length as usize);
                let failures = &record.driving().failures;
                let active_agents = f64::from(failures.crashed() + failures.out_of_road + failures.unfinished)
                    / (1.0 - record.success).max(1e-9);
                prop_assert!(record.success > 1.0 - 1e-9 || (active_agents - active_agents.round()).abs() < 1e-6, "{:?}", failures);
                prop_assert!(record.success + record.driving().safety <= 2.0 && record.driving().crash + record.driving().safety <= 1.0 + 1e-9);
                let sum: f64 = record.step_rewards.iter().map(|&r| f64::from(r)).sum();
                prop_assert!((sum - record.reward).abs() < 1e-3);
            }
        }
        prop_assert!(episodes >= 2, "400 steps of at most 150 each");
    }

    /// An episode depends only on the seed and its number, not on what was played before.
    #[test]
    fn episodes_do_not_depend_on_the_past(seed in any::<u64>(), episode in 1u64..1000) {
        let task = task(8, |_| {});
        let play = |world: &mut World, rails: &mut Rails| {
            world.reset(episode);
            (0..60).map(|_| { exchange(world, rails, &[0.7; 8]); world.frame().clone() }).collect::<Vec<_>>()
        };
        let (mut fresh, mut rails) = (world(&task, seed), Rails::new(&task));
        let expected = play(&mut fresh, &mut rails);
        let (mut used, mut rails) = (world(&task, seed), Rails::new(&task));
        used.reset(0);
        for _ in 0..90 {
            exchange(&mut used, &mut rails, &[1.0; 8]);
        }
        prop_assert_eq!(play(&mut used, &mut rails), expected);
    }
}

#[test]
fn episodes_may_have_fewer_agents() {
    // All agents are within communication range.
    let task = task(8, |s| {
        s.termination.horizon = 120;
        s.communication.range = 1e6;
    });
    let task = Arc::new(Task::clone(&task).with_fewest(3));
    let (mut world, mut rails) = (world(&task, 1), Rails::new(&task));
    world.reset(0);
    let mut counts = std::collections::BTreeSet::new();
    let (mut active_agents, mut reward) = (0, 0.0);
    while counts.len() < 6 {
        exchange(&mut world, &mut rails, &[0.6; 8]);
        let frame = world.frame();
        if frame.start[0] > 0.0 {
            active_agents = frame.active.iter().filter(|&&active| active > 0.0).count();
            assert!(
                frame.active[..active_agents].iter().all(|&active| active > 0.0),
                "the first slots are theirs"
            );
            assert_eq!(rails.vehicles.iter().flatten().count(), active_agents);
            reward = 0.0;
        }
        for i in active_agents..8 {
            assert_eq!((frame.active[i], frame.reward[i], frame.comm[i * 8 + i]), (0.0, 0.0, 0.0));
            assert!(frame.terminated[i] == 0.0 && frame.truncated[i] == 0.0);
        }
        reward += frame.reward.iter().map(|&r| f64::from(r)).sum::<f64>() / active_agents as f64;
        if let Some(record) = world.take_finished() {
            assert!(
                (record.reward - reward).abs() < 1e-3 * reward.abs().max(1.0),
                "{} {reward}",
                record.reward
            );
            let shares =
                [record.success, record.driving().crash].map(|share| share * active_agents as f64);
            assert!(shares.iter().all(|share| (share - share.round()).abs() < 1e-9));
            assert!((3..=8).contains(&active_agents));
            counts.insert(active_agents);
        }
    }
}

#[test]
fn idle_worlds_send_nothing() {
    let task = task(4, |s| s.termination.horizon = 3);
    let mut world = World::new(Arc::clone(&task), Driver::Agents, Seed::new(0), 0, 1, 1);
    let mut rails = Rails::new(&task);
    let mut commands = Vec::new();
    world.act(0, &[0.0; 4], &mut commands);
    assert!(commands.is_empty(), "idle until the first reset");
    world.reset(0);
    for _ in 0..6 {
        exchange(&mut world, &mut rails, &[0.0; 4]);
    }
    assert!(world.is_idle(), "there is only one episode");
    world.act(0, &[0.0; 4], &mut commands);
    assert!(commands.is_empty());
}

#[test]
fn an_interrupted_episode_is_truncated_and_the_next_one_starts_clean() {
    let task = task(4, |_| {});
    let (mut world, mut rails) = (world(&task, 0), Rails::new(&task));
    world.reset(0);
    for _ in 0..10 {
        exchange(&mut world, &mut rails, &[0.5; 4]);
    }
    world.interrupt();
    assert_eq!(world.frame().truncated, [1.0; 4]);
    assert_eq!(world.frame().active, [0.0; 4]);
    assert!(world.frame().interrupted, "which is no deadline");
    assert!(world.take_finished().expect("a record").interrupted);
    // The fresh simulator is empty: a `Remove` would fail the check in `Rails`.
    let mut rails = Rails::new(&task);
    exchange(&mut world, &mut rails, &[0.0; 4]);
    assert!(world.frame().start == [1.0; 4] && !world.frame().interrupted);
    assert_eq!(world.episode(), 1);
}

#[test]
fn a_reserved_destination_is_one_vehicles() {
    let scenario = scenario("parking_lot");
    let task = Arc::new(Task::new(&scenario, 11).expect("a task"));
    let mut world = world(&task, 0);
    let mut drawn = HashSet::new();
    for episode in 0..300 {
        world.reset(episode);
        let mut commands = Vec::new();
        world.act(0, &[0.0; 22], &mut commands);
        let added = commands.iter().filter_map(|command| match command {
            Command::Add { route, .. } => Some(&scenario.routes[*route as usize]),
            _ => None,
        });
        let routes: Vec<_> = added.collect();
        assert_eq!(routes.len(), 11);
        let ends: Vec<_> =
            routes.iter().filter(|r| r.reserved).filter_map(|r| r.edges.last()).collect();
        assert_eq!((ends.len(), ends.iter().collect::<HashSet<_>>().len()), (3, 3), "{ends:?}");
        drawn.extend(routes.iter().map(|route| route.id.clone()));
    }
    assert_eq!(drawn.len(), scenario.routes.len(), "every route is drawn at some time");
}
