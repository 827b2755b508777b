//! Tests of vehicles that are not there yet, and of polygons that block sight and radio: what is
//! hidden does not leak.

use super::*;
use crate::scenario::Occlusion;

/// Numbers of features of one agent whose names begin with `prefix` and end with `suffix`.
fn shown(features: &[Feature], values: &[f32], prefix: &str, suffix: &str) -> Vec<f32> {
    let wanted = |feature: &(&Feature, &f32)| {
        feature.0.name.starts_with(prefix) && feature.0.name.ends_with(suffix)
    };
    features.iter().zip(values).filter(wanted).map(|(_, value)| *value).collect()
}

/// The lane for two directions, with agents that would see everything.
fn one_lane(agents: u32) -> Arc<Task> {
    let mut scenario = scenario("one_lane");
    scenario.observation.detection_range = 1e6;
    scenario.observation.groups = ObservationGroups::Both;
    scenario.observation.encounters = 2;
    scenario.communication.range = 1e6;
    Arc::new(Task::new(&scenario, agents).expect("a task"))
}

#[test]
fn vehicles_come_with_their_probability_within_their_window_and_not_before() {
    let task = one_lane(2);
    let (o, s) = (task.spec.observation.len(), task.spec.state.len());
    let (mut world, mut rails) = (world(&task, 3), Rails::new(&task));
    let (mut present, mut entries, mut alone) = (0, Vec::new(), 0);
    for episode in 0..600 {
        world.reset(episode);
        let mut entered = [None; 2];
        for step in 0..40 {
            exchange(&mut world, &mut rails, &[-1.0, -1.0]);
            let frame = world.frame();
            let on_road = [0, 1].map(|i| frame.comm[3 * i] > 0.0);
            for i in 0..2 {
                if on_road[i] && entered[i].is_none() {
                    assert_eq!(frame.start[i], 1.0, "a trajectory begins with the entry");
                    entered[i] = Some(step);
                } else if on_road[i] {
                    assert_eq!(frame.start[i], 0.0);
                }
                assert_eq!(frame.active[i] > 0.0, on_road[i]);
                let seen = &frame.observation[i * o..(i + 1) * o];
                let known = &frame.state[i * s..(i + 1) * s];
                if !on_road[i] {
                    assert!(seen.iter().chain(known).all(|value| *value == 0.0));
                    assert_eq!(frame.reward[i], 0.0);
                } else if !on_road[1 - i] {
                    // The other vehicle is not there: nobody sees, knows or hears of it.
                    alone += 1;
                    for (features, values) in
                        [(&task.spec.observation.list, seen), (&task.spec.state.list, known)]
                    {
                        for feature in ["neighbour", "encounter", "stream", "apart", "leader"] {
                            let flags = shown(features, values, feature, "_vehicle.present");
                            assert!(flags.iter().all(|flag| *flag == 0.0), "{feature}");
                        }
                        let others = shown(features, values, "neighbour", "present");
                        assert!(others.iter().all(|flag| *flag == 0.0));
                    }
                    assert_eq!(frame.comm[2 * i + 1 - i], 0.0);
                }
            }
        }
        assert!(entered.iter().any(Option::is_some), "somebody comes in each episode");
        present += entered.iter().flatten().count();
        entries.extend(entered.iter().flatten());
    }
    assert!(alone > 100);
    // Two of two with 0.8², one with 2 · 0.8 · 0.2 + 0.2² where none would come.
    let expected = 600.0 * (2.0 * 0.64 + 0.36);
    assert!((present as f64 - expected).abs() < 60.0, "{present} of {expected}");
    let mean = entries.iter().sum::<usize>() as f64 / entries.len() as f64;
    assert!((mean * 0.2 - 3.6).abs() < 0.25, "mean entry at {} s", mean * 0.2);
    assert!(entries.iter().all(|step| *step <= 36), "nobody comes after the window");
}

#[test]
fn delay_is_what_an_agent_takes_longer_than_alone() {
    let task = one_lane(2);
    let mut scenario = task.scenario.clone();
    for spawn in scenario.nets.iter_mut().flat_map(|net| &mut net.spawns) {
        spawn.departure.end = 0.0;
    }
    let at_once = Arc::new(Task::new(&scenario, 2).expect("a task"));
    let delay = |task: &Arc<Task>, waits: u32| {
        let (mut world, mut rails) = (world(task, 3), Rails::new(task));
        // An episode in which one vehicle comes.
        for episode in 0.. {
            world.reset(episode);
            let mut driven = [0; 2];
            let record = loop {
                let actions = driven.map(|steps: u32| if steps <= waits { -1.0 } else { 1.0 });
                exchange(&mut world, &mut rails, &actions);
                for (steps, active) in driven.iter_mut().zip(&world.frame().active) {
                    *steps += u32::from(*active > 0.0);
                }
                if let Some(record) = world.take_finished() {
                    break record;
                }
            };
            if driven.iter().filter(|steps| **steps > 0).count() == 1 {
                assert_eq!(record.success, 1.0);
                return (record.driving().delay.expect("it arrived"), record.episode_length);
            }
        }
        unreachable!("an episode with one vehicle comes")
    };
    // Vehicles that depart within a window, and vehicles that depart with the episode, at speed.
    for task in [&task, &at_once] {
        let ((none, length), (late, longer)) = (delay(task, 0), delay(task, 30));
        assert_eq!(none, 0.0);
        let expected = f64::from(longer - length) * task.scenario.control.interval;
        assert!((late - expected).abs() < 1e-9 && (6.0..8.0).contains(&late), "{late} {expected}");
    }
}

/// The four buildings at the corners of the intersection, whose centre is at (41.75, 1.75), as a SUMO
/// file.
fn buildings(folder: &Path) -> Occlusion {
    let corner = |x: f64, y: f64| {
        let square = [[6.0, 6.0], [40.0, 6.0], [40.0, 40.0], [6.0, 40.0]];
        let shape: Vec<String> =
            square.iter().map(|p| format!("{},{}", 41.75 + x * p[0], 1.75 + y * p[1])).collect();
        format!("<poly id=\"{x}{y}\" type=\"building\" shape=\"{}\"/>", shape.join(" "))
    };
    let all: String =
        [(1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0)].map(|(x, y)| corner(x, y)).concat();
    let file = folder.join("buildings.add.xml");
    std::fs::write(&file, format!("<additional>{all}</additional>")).unwrap();
    Occlusion { file, types: Vec::new(), sight: true, radio: true }
}

fn blind_intersection(folder: &Path) -> Arc<Task> {
    let mut blind = scenario("intersection");
    blind.occlusion = Some(buildings(folder));
    blind.observation.groups = ObservationGroups::Both;
    blind.observation.encounters = 4;
    blind.observation.foresight = 3.0;
    Arc::new(Task::new(&blind, 4).expect("a task"))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    /// Two worlds differ only in how those agents drive that are behind buildings at first. As long as
    /// they are behind buildings in both, the first agent observes and hears the same in both.
    #[test]
    fn what_is_behind_a_polygon_changes_nothing(seed in any::<u64>(), throttles in prop::array::uniform2(0.1f32..1.0)) {
        let folder = tempfile::tempdir().unwrap();
        let task = blind_intersection(folder.path());
        let o = task.spec.observation.len();
        let mut worlds = throttles.map(|throttle| (world(&task, seed), Rails::new(&task), throttle));
        for (world, rails, _) in &mut worlds {
            world.reset(0);
            exchange(world, rails, &[0.3; 4]);
        }
        let behind = |world: &World, j: usize| {
            world.traffic().slots[j].status == agents::Status::Empty || world.traffic().is_blocked(0, j)
        };
        let hidden: Vec<usize> = (1..4).filter(|&j| behind(&worlds[0].0, j)).collect();
        // On the agent's own arm and on the one that faces it, nobody is hidden.
        prop_assume!(!hidden.is_empty());
        let mut compared = 0;
        for _ in 0..80 {
            for (world, rails, throttle) in &mut worlds {
                let own = |j: usize| if hidden.contains(&j) { *throttle } else { 0.3 };
                exchange(world, rails, &[0, 1, 2, 3].map(own));
            }
            let goes_on = |world: &World| {
                world.is_running() && hidden.iter().all(|&j| behind(world, j))
            };
            if !worlds.iter().all(|(world, ..)| goes_on(world)) {
                break;
            }
            let frames = worlds.each_ref().map(|(world, ..)| world.frame());
            for frame in frames {
                prop_assert!(hidden.iter().all(|&j| frame.comm[j] == 0.0));
            }
            prop_assert_eq!(&frames[0].observation[..o], &frames[1].observation[..o]);
            compared += 1;
        }
        prop_assert!(compared > 5, "{compared} steps, {hidden:?} hidden");
    }
}

#[test]
fn lidar_beams_end_at_polygons() {
    let folder = tempfile::tempdir().unwrap();
    let mut blind = scenario("intersection");
    blind.occlusion = Some(buildings(folder.path()));
    blind.observation.lidar.beams = 36;
    let task = Arc::new(Task::new(&blind, 4).expect("a task"));
    let o = task.spec.observation.len();
    let (mut world, mut rails) = (world(&task, 1), Rails::new(&task));
    world.reset(0);
    let mut hits = 0;
    for _ in 0..60 {
        exchange(&mut world, &mut rails, &[0.5; 4]);
        for i in (0..4).filter(|&i| world.frame().active[i] > 0.0) {
            let seen = &world.frame().observation[i * o..(i + 1) * o];
            let beams = shown(&task.spec.observation.list, seen, "lidar", "distance");
            let pose = world.traffic().slots[i].pose;
            for (beam, distance) in beams.iter().enumerate() {
                let angle = pose.heading + beam as f64 * std::f64::consts::TAU / 36.0;
                let to = 50.0 * f64::from(*distance) - 1e-3;
                let end = [pose.x + to * angle.cos(), pose.y + to * angle.sin()];
                assert!(!task.map.walls.block(pose.point(), end), "beam {beam} is in a wall");
                hits += u32::from(*distance < 1.0);
            }
        }
    }
    assert!(hits > 100, "{hits}");
}

#[test]
fn polygons_block_in_some_places_and_not_in_others() {
    let folder = tempfile::tempdir().unwrap();
    let task = blind_intersection(folder.path());
    let (mut world, mut rails) = (world(&task, 1), Rails::new(&task));
    let mut counts = [0; 2];
    for episode in 0..20 {
        world.reset(episode);
        for _ in 0..60 {
            exchange(&mut world, &mut rails, &[0.5, 0.8, 0.6, 0.9]);
            for j in 1..4 {
                let present = world.traffic().slots[j].status != agents::Status::Empty;
                counts[usize::from(world.traffic().is_blocked(0, j))] += u32::from(present);
            }
        }
    }
    assert!(counts.iter().all(|count| *count > 100), "{counts:?}");
}

#[test]
fn an_agent_knows_of_itself_what_the_scenario_says() {
    let names = |change: fn(&mut Scenario)| -> Vec<String> {
        let task = task(4, change);
        let ego = task.spec.observation.list.iter().filter(|f| f.name.starts_with("ego."));
        ego.map(|feature| format!("{} [{}]", feature.name, feature.unit)).collect()
    };
    let usual = names(|_| {});
    assert!(usual.contains(&"ego.to_conflict_far [50 m]".into()), "{usual:?}");
    assert!(usual.contains(&"ego.heading_cos [1]".into()));
    let other = names(|scenario| {
        let observation = &mut scenario.observation;
        (observation.heading, observation.clock, observation.own_turn) = (false, true, true);
        observation.distance_scale = 120.0;
    });
    for name in
        ["ego.to_conflict_far [120 m]", "ego.to_conflict_near [36 m]", "ego.to_arrival [240 m]"]
    {
        assert!(other.contains(&name.into()), "{other:?}");
    }
    assert!(other.iter().all(|name| !name.contains("heading")));
    assert!(
        ["ego.time", "ego.turns_left"].iter().all(|new| other.iter().any(|n| n.starts_with(new)))
    );
}

#[test]
fn agents_drive_and_know_their_own_kind_of_vehicle() {
    let scenario = scenario("blind_crossing");
    let task = Arc::new(Task::new(&scenario, 4).expect("a task"));
    let o = task.spec.observation.len();
    let (mut world, mut rails) = (world(&task, 3), Rails::new(&task));
    let (mut counts, car) = ([0; 2], &scenario.kinds[0]);
    for episode in 0..300 {
        world.reset(episode);
        let mut before: [Option<f64>; 4] = [None; 4];
        for _ in 0..45 {
            exchange(&mut world, &mut rails, &[1.0; 4]);
            let slots = &world.traffic().slots;
            for i in (0..4).filter(|&i| slots[i].status == agents::Status::Active) {
                let own = &world.frame().observation[i * o..(i + 1) * o];
                let length = shown(&task.spec.observation.list, own, "ego.length", "")[0];
                assert_eq!(length, (slots[i].size[0] / 20.0) as f32);
                let is_car = slots[i].size[0] == car.length;
                let accel = if is_car { car.accel } else { scenario.control.accel };
                match before[i] {
                    None => counts[usize::from(is_car)] += 1,
                    Some(speed) if speed + accel * 0.2 <= 14.0 => {
                        assert!((slots[i].speed - speed - accel * 0.2).abs() < 1e-9);
                    }
                    Some(_) => {}
                }
                before[i] = Some(slots[i].speed);
            }
        }
    }
    let share = f64::from(counts[1]) / f64::from(counts[0] + counts[1]);
    assert!((share - 0.7).abs() < 0.06, "{counts:?}");
    let of_others = |name: &str| {
        let names = task.spec.observation.list.iter().map(|feature| &feature.name);
        names.filter(|feature| !feature.starts_with("ego.") && feature.contains(name)).count()
    };
    assert_eq!(["length", "accel", "brake"].map(of_others), [0; 3], "others' kinds are private");
}
