//! Tests of background traffic in the fake simulator.

use super::*;

/// Returns the intersection with background traffic of `scenarios/mixed_cross.xml`.
fn mixed(penetration: f64, capacity: u32, horizon: u32) -> Arc<Task> {
    let mut scenario = scenario("mixed_cross");
    (scenario.traffic.penetration, scenario.traffic.capacity) = (penetration, capacity);
    (scenario.termination.horizon, scenario.observation.groups) =
        (horizon, ObservationGroups::Both);
    Arc::new(Task::new(&scenario, 8).expect("a task"))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// Agents and background traffic keep to their slots (the fake simulator checks that no slot
    /// is used twice), the number of background vehicles is at most the capacity, and masks and
    /// observations cover agents only.
    #[test]
    fn others_keep_to_their_slots(
        penetration in 0.01f64..1.0, capacity in 1u32..6, horizon in 20u32..400, seed in any::<u64>(), mean in -0.2f32..1.0,
    ) {
        let task = mixed(penetration, capacity, horizon);
        let (n, slots) = (task.agents, task.slots());
        prop_assert_eq!(slots, 8 + capacity as usize);
        let (mut world, mut rails) = (world(&task, seed), Rails::new(&task));
        world.reset(0);
        let mut rng = Seed::new(seed).child("actions").rng();
        let (mut actions, mut most, mut episodes) = (vec![0.0; n], 0, 0);
        for _ in 0..600 {
            crate::rng::fill_normal(&mut rng, &mut actions);
            for action in &mut actions {
                *action = 0.5 * *action + mean;
            }
            exchange(&mut world, &mut rails, &actions);
            let others: Vec<BackgroundVehicle> = world.background_vehicles().collect();
            most = most.max(others.len());
            prop_assert!(others.len() <= slots - n);
            let frame = world.frame();
            prop_assert_eq!((frame.comm.len(), frame.active.len()), (n * n, n));
            prop_assert!(frame.observation.iter().chain(&frame.state).all(|x| x.is_finite() && x.abs() <= 1.0));
            for (i, agent) in world.agents().enumerate() {
                prop_assert!(frame.comm[i * n + i] == 0.0 || agent.driving);
            }
            if let Some(record) = world.take_finished() {
                episodes += 1;
                let met = record.driving().others.expect("there are others");
                prop_assert!(met.vehicles as usize >= 8 - n);
                let apart = [met.ttc, met.pet].map(|time| time.expect("there are agents"));
                prop_assert!(apart.iter().all(|time| (0.0..=5.0).contains(time)));
                prop_assert!(met.crash <= met.close && met.close <= 1.0);
                prop_assert!(met.crash == 0.0 || record.driving().crash > 0.0 || n > 1, "it takes an agent");
            }
        }
        prop_assert!(most > 0 && (episodes > 0 || horizon > 100));
    }

    /// The departures of an episode depend on its seed alone and not on the agents' actions, as
    /// long as there is room on the road.
    #[test]
    fn departures_follow_from_the_seed(seed in any::<u64>(), throttles in (-1.0f32..1.0, -1.0f32..1.0)) {
        let task = mixed(0.5, 64, 600);
        let departures = |throttle: f32| {
            let (mut world, mut rails) = (world(&task, seed), Rails::new(&task));
            world.reset(3);
            let mut departures = Vec::new();
            let mut commands = Vec::new();
            for step in 0..500 {
                commands.clear();
                world.act(0, &[throttle; 4], &mut commands);
                departures.extend(commands.iter().filter_map(|command| match command {
                    Command::Depart { departure, vehicle_type, .. } => Some((step, *departure, *vehicle_type)),
                    _ => None,
                }));
                let snapshot = rails.step(&commands);
                world.observe(0, &snapshot).expect("nothing vanishes on rails");
                if !world.is_running() {
                    break;
                }
            }
            departures
        };
        let (a, b) = (departures(throttles.0), departures(throttles.1));
        let both = a.len().min(b.len());
        prop_assert_eq!(&a[..both], &b[..both]);
    }
}

#[test]
fn flows_have_the_rates_that_they_say() {
    let task = mixed(0.5, 64, 1_000_000);
    let mut counts = [0_u32; 4];
    for episode in 0..400 {
        let (mut world, mut rails) = (world(&task, 1), Rails::new(&task));
        world.reset(episode);
        let mut commands = Vec::new();
        for _ in 0..=400 {
            commands.clear();
            world.act(0, &[-1.0; 4], &mut commands);
            for command in &commands {
                if let Command::Depart { departure, .. } = command {
                    counts[*departure as usize] += 1;
                }
            }
            let snapshot = rails.step(&commands);
            world.observe(0, &snapshot).expect("nothing vanishes on rails");
        }
    }
    // Each arm has one departure in 40 s. In 400 episodes of 40 s, 400 are expected; the limits
    // are four standard deviations away.
    assert!(counts.iter().all(|count| (320..=480).contains(count)), "{counts:?}");
}
