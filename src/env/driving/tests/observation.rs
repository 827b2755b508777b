//! Tests of the feature groups and what they show.

use super::super::agents::Traffic;
use super::super::intention::Knowledge;
use super::super::layout::Layout;
use super::super::observation::FeatureGroup;
use super::*;

#[test]
fn features_are_named_once_and_covered_by_their_groups() {
    for agents in [4, 48] {
        let task = task(agents, |_| {});
        for features in [
            &task.spec.observation,
            &task.spec.state,
            &task.spec.observation.join(&task.spec.state),
        ] {
            let covered: usize = features.groups.iter().map(|g| g.width * g.count).sum();
            assert_eq!(covered, features.len());
            assert!(
                features
                    .groups
                    .windows(2)
                    .all(|g| g[0].offset + g[0].width * g[0].count == g[1].offset)
            );
        }
        let names: HashSet<_> = task.spec.observation.list.iter().map(|f| &f.name).collect();
        assert_eq!(names.len(), task.spec.observation.len());
    }
    assert_eq!(
        task(4, |_| {}).spec.state,
        task(48, |_| {}).spec.state,
        "the state does not grow with the agents"
    );
}

/// In every build, a group that writes fewer features than it describes ends the program.
#[test]
#[should_panic(expected = "as many features as it describes")]
fn a_group_must_write_what_it_describes() {
    static SHORT: &[FeatureGroup] = &[FeatureGroup {
        describe: |_, features| {
            features.push("short", 1, &[("one", "1", 0.0, 1.0), ("two", "1", 0.0, 1.0)]);
        },
        write: |_, w| w.put([1.0]),
    }];
    let task = task(4, |_| {});
    let traffic = Traffic::new(task.slots(), task.map.routes.len());
    let knowledge = Knowledge::full(&task.map.routes, &traffic);
    let view = intention::view(&task, &traffic, knowledge, &[], 0);
    let (layout, features) = Layout::new(SHORT, &task.scenario);
    layout.write(&view, &mut vec![0.0; features.len()]);
}

/// Observations with `both` consist of those with `nearest` followed by those with `conflict`, and
/// their size does not depend on the number of agents.
#[test]
fn observation_groups_show_the_same_traffic() {
    for agents in [4, 8, 48] {
        let of = |groups| task(agents, |scenario| scenario.observation.groups = groups);
        let tasks =
            [ObservationGroups::Nearest, ObservationGroups::Conflict, ObservationGroups::Both]
                .map(of);
        let widths = tasks.each_ref().map(|task| task.spec.observation.len());
        assert_eq!(widths, [32, 67, 91]);
        let ego = tasks[0].spec.observation.groups[0].width;
        let mut worlds = tasks.each_ref().map(|task| (world(task, 5), Rails::new(task)));
        for (world, _) in &mut worlds {
            world.reset(0);
        }
        let mut seen = 0;
        for step in 0..150 {
            let actions: Vec<f32> =
                (0..agents).map(|i| if (step / 20 + i) % 3 == 0 { -0.2 } else { 0.9 }).collect();
            for (world, rails) in &mut worlds {
                exchange(world, rails, &actions);
            }
            let frames = worlds.each_ref().map(|(world, _)| world.frame());
            for i in 0..agents as usize {
                let of = |k: usize| &frames[k].observation[i * widths[k]..(i + 1) * widths[k]];
                let (nearest, conflict, both) = (of(0), of(1), of(2));
                assert_eq!(&both[..widths[0]], nearest, "step {step}, agent {i}");
                assert_eq!(&both[..ego], &conflict[..ego], "step {step}, agent {i}");
                assert_eq!(&both[widths[0]..], &conflict[ego..], "step {step}, agent {i}");
                seen += usize::from(nearest[ego..].iter().any(|x| *x != 0.0));
            }
        }
        assert!(seen > 100, "{seen}");
    }
}

/// Both orders contain the same vehicles: nearest first, or from ahead to behind with the nearest
/// vehicle ahead in the first place.
#[test]
fn neighbours_come_in_the_order_that_is_asked_for() {
    let orders = [NeighbourOrder::Distance, NeighbourOrder::Bearing];
    let tasks = orders.map(|order| {
        task(16, |s| {
            (s.observation.groups, s.observation.neighbour_order) =
                (ObservationGroups::Nearest, order);
        })
    });
    let groups = tasks.each_ref().map(|task| {
        let groups = &task.spec.observation.groups;
        (
            task.spec.observation.len(),
            groups.iter().find(|group| group.name == "neighbour").expect("seen"),
        )
    });
    let mut worlds = tasks.each_ref().map(|task| (world(task, 5), Rails::new(task)));
    for (world, _) in &mut worlds {
        world.reset(0);
    }
    let mut differ = 0;
    for step in 0..120 {
        let actions: Vec<f32> =
            (0..16).map(|i| if (step / 20 + i) % 3 == 0 { -0.2 } else { 0.9 }).collect();
        for (world, rails) in &mut worlds {
            exchange(world, rails, &actions);
        }
        for i in 0..16 {
            let seen = [0, 1].map(|order| {
                let (width, group) = groups[order];
                let all = &worlds[order].0.frame().observation[i * width + group.offset..]
                    [..group.count * group.width];
                let there = all.chunks(group.width).filter(|one| one[group.width - 1] > 0.0);
                // In the order by bearing, positions are given on a second scale, too.
                let one = |one: &[f32]| {
                    assert!(
                        order == 0
                            || one[0].abs() > 0.29
                            || (one[2] / one[0] - 50.0 / 15.0).abs() < 1e-3,
                        "{one:?}"
                    );
                    [&one[..2], &one[group.width - 4..]].concat()
                };
                there.map(one).collect::<Vec<_>>()
            });
            let [near, around] = &seen;
            let far = |one: &Vec<f32>| one[0].hypot(one[1]);
            let behind = |one: &Vec<f32>| one[1].atan2(one[0]).abs();
            assert!(
                near.is_sorted_by(|a, b| far(a) <= far(b) + 1e-5),
                "step {step}, agent {i}: {near:?}"
            );
            // Vehicles in clearly different directions are ordered by direction, others by
            // distance.
            let apart = |a: &Vec<f32>, b: &Vec<f32>| behind(a) - behind(b) > 15.1_f32.to_radians();
            assert!(around.is_sorted_by(|a, b| !apart(a, b)), "step {step}, agent {i}: {around:?}");
            let leader = near.iter().find(|one| behind(one) < 14.9_f32.to_radians());
            assert!(
                leader.is_none_or(|leader| around.first() == Some(leader)),
                "step {step}, agent {i}: {around:?}"
            );
            assert!(
                near.len() == around.len() && near.iter().all(|one| around.contains(one)),
                "step {step}, agent {i}"
            );
            differ += usize::from(near != around);
        }
    }
    assert!(differ > 100, "{differ} of 1,920 lists differ");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    /// Encounters are the vehicles that will soonest be with an agent at their conflict point, in
    /// that order, as computed from the routes' geometry.
    #[test]
    fn encounters_come_in_order(
        agents in 4u32..17,
        seed in any::<u64>(),
        steps in 1usize..80,
        count in 1usize..6,
        foresight in prop_oneof![Just(0.0), Just(4.0)],
        priority in prop_oneof![Just(0.0), Just(20.0)],
    ) {
        let task = task(agents, |s| {
            s.observation.groups = ObservationGroups::Nearest;
            s.observation.neighbours = 0;
            s.observation.encounters = count;
            s.observation.foresight = foresight;
            s.observation.priority_distance = priority;
        });
        let (mut world, mut rails) = (world(&task, seed), Rails::new(&task));
        world.reset(0);
        let actions = vec![0.4; agents as usize];
        (0..=steps).for_each(|_| exchange(&mut world, &mut rails, &actions));
        let (width, views) = (task.spec.observation.len(), world.agents().collect::<Vec<_>>());
        for (i, own) in views.iter().enumerate().filter(|(_, view)| view.driving) {
            let mut expected: Vec<[f64; 2]> = Vec::new();
            for (j, other) in views.iter().enumerate() {
                let far = own.pose.distance(&other.pose) > task.scenario.observation.detection_range;
                if i == j || far || !(other.driving || other.wreck) {
                    continue;
                }
                // A vehicle ahead is met at the end of the gap to it.
                let gap = other.position - own.position - task.scenario.vehicle.length;
                if other.route == own.route && other.position > own.position {
                    expected.push([gap, 0.0]);
                    continue;
                }
                let met = task.map.routes[own.route].conflicts.iter().find(|conflict| conflict.route == other.route);
                let distances = met.map(|met| [met.own - own.position, met.other - other.position]);
                expected.extend(distances.filter(|distances| distances.iter().all(|distance| *distance >= -CLEARED)));
            }
            expected.sort_by(|a, b| a[0].max(a[1]).total_cmp(&b[0].max(b[1])));
            let shown = usize::from(priority > 0.0);
            let token = if foresight > 0.0 { 18 } else { 14 } + shown;
            // The encounters are followed by the free-space features.
            let (first, end) = (i * width, (i + 1) * width - 3 * shown);
            let seen = &world.frame().observation[end - token * count..end];
            prop_assert!(end - token * count >= first);
            for (k, token) in seen.chunks(token).enumerate() {
                let Some(distances) = expected.get(k) else {
                    prop_assert!(token.iter().all(|x| *x == 0.0), "padding: {token:?}");
                    continue;
                };
                prop_assert_eq!(token[token.len() - 1], 1.0);
                for passing in token[12..token.len() - 2 - shown].chunks(2) {
                    prop_assert!(passing.iter().all(|x| (0.0..=1.0).contains(x)), "{token:?}");
                    // A vehicle that is near ahead now will come at least as near.
                    let near = 1.0 - 15.0 * token[2] / 3.0;
                    prop_assert!(token[0] == 0.0 || passing[0] >= near.min(1.0) - 1e-4, "{token:?}");
                }
                prop_assert_eq!(token[0] > 0.0, distances[1] == 0.0);
                // The routes cross at right angles.
                let half = f64::midpoint(task.scenario.vehicle.length, task.scenario.vehicle.width);
                let ends = [distances[0] - half, distances[0] + half, distances[1] - half, distances[1] + half];
                for (end, shown) in ends.iter().zip(&token[5..9]).filter(|_| token[0] == 0.0) {
                    // Areas are found in steps of a quarter of a metre.
                    prop_assert!((f64::from(*shown) - (end / 15.0).clamp(-1.0, 1.0)).abs() < 0.02, "{token:?} {distances:?}");
                }
                for (distance, at) in distances.iter().zip([1, 3]) {
                    prop_assert!((f64::from(token[at]) - (distance / 50.0).clamp(-1.0, 1.0)).abs() < 1e-5, "{token:?} {distances:?}");
                }
            }
        }
    }
}

/// Vehicles that drive backwards have a negative speed, for others in the observation and for all
/// in the state.
#[test]
fn speeds_backwards_are_negative() {
    let mut scenario = scenario("parking_lot");
    scenario.observation.groups = ObservationGroups::Both;
    scenario.observation.conflict_streams = 2;
    scenario.observation.stream_vehicles = 3;
    let task = Arc::new(Task::new(&scenario, 5).expect("a task"));
    let there = Snapshot {
        vehicles: vec![Some(VehicleState { distance: 0.0, speed: 0.0 }); 5],
        ..Snapshot::default()
    };
    let mut world = world(&task, 0);
    world.reset(0);
    for _ in 0..8 {
        world.act(0, &[0.0, -1.0].repeat(5), &mut Vec::new());
        world.observe(0, &there).expect("all are there");
    }
    let frame = world.frame();
    let active: Vec<usize> = (0..5).filter(|&i| frame.active[i] > 0.0).collect();
    assert!(!active.is_empty(), "some drive");
    let (mut own, mut others) = (0, [0; 2]);
    for (part, features, values) in
        [(0, &task.spec.observation, &frame.observation), (1, &task.spec.state, &frame.state)]
    {
        let width = features.len();
        for &i in &active {
            let row = &values[i * width..(i + 1) * width];
            let named = |name: &str| features.list.iter().position(|f| f.name == name);
            for (feature, &value) in features.list.iter().zip(row) {
                let Some(token) = feature.name.strip_suffix(".speed") else { continue };
                if token == "own" {
                    assert!(value < 0.0, "{} = {value}", feature.name);
                    own += 1;
                }
                if let Some(present) = named(&format!("{token}.present"))
                    && row[present] > 0.0
                {
                    assert!(value < 0.0, "{} = {value}", feature.name);
                    others[part] += 1;
                }
            }
        }
    }
    assert_eq!(own, active.len());
    assert!(others.iter().all(|&seen| seen > 0), "others are seen: {others:?}");
}
