//! Background traffic on the real SUMO: it is reproducible on every backend, every kind of
//! observation contains it, and collisions with it end as they should.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::sync::Arc;

use iwol_sumo::driving::Policy;
use iwol_sumo::env::{
    BackgroundVehicle, EpisodeRecord, Task, VecEnv, VecOptions, World, boxes_overlap,
};
use iwol_sumo::evaluate::Evaluation;
use iwol_sumo::rng::{self, Seed};
use iwol_sumo::scenario::{Demand, ObservationGroups, Scenario};
use iwol_sumo::stats::Estimate;
use iwol_sumo::sumo::process::{Options, Process};
use iwol_sumo::sumo::{Backend, Hosting};

use crate::support::{self, agents_drive, folder, root, shipped, turn};

fn task_of(name: &str, change: impl FnOnce(&mut Scenario)) -> Arc<Task> {
    let mut scenario = shipped(name);
    change(&mut scenario);
    Arc::new(Task::new(&scenario, 8).expect("a task"))
}

fn task(change: impl FnOnce(&mut Scenario)) -> Arc<Task> {
    task_of("mixed_cross", change)
}

fn options(worlds: usize, seed: u64, backend: Backend) -> VecOptions {
    agents_drive(worlds, seed, Hosting { backend, ..Hosting::default() })
}

/// Writes actions that depend only on a world's episode and step: around a moderate throttle, so
/// that some agents crash and some arrive.
fn actions(world: &World, out: &mut [f32]) {
    let seed = Seed::new(5).index(world.episode()).index(u64::from(world.step_count()));
    rng::fill_normal(&mut seed.rng(), out);
    for action in out {
        *action = 0.6 + 0.5 * *action;
    }
}

fn step(env: &mut VecEnv, agents: usize) -> Vec<EpisodeRecord> {
    let mut all = vec![0.0; env.len() * agents];
    for (world, out) in env.worlds().zip(all.chunks_mut(agents)) {
        actions(world, out);
    }
    env.step(&all).expect("a step");
    env.take_finished()
}

/// Returns the frame and the background vehicles of a single world after each step.
fn watch(
    task: &Arc<Task>,
    seed: u64,
    steps: usize,
    backend: Backend,
) -> Vec<(Vec<f32>, Vec<BackgroundVehicle>)> {
    let _turn = turn(backend);
    let mut env = VecEnv::new(task, &options(1, seed, backend)).expect("SUMO runs");
    let mut seen = Vec::new();
    for _ in 0..steps {
        step(&mut env, task.agents);
        let world = env.worlds().next().expect("one world");
        let frame = world.frame();
        let all = [&frame.observation, &frame.state, &frame.reward, &frame.comm, &frame.terminated];
        seen.push((
            all.into_iter().flatten().copied().collect(),
            world.background_vehicles().collect(),
        ));
    }
    seen
}

/// Pedestrians walk along their paths, at most twelve at a time, while all vehicles stand.
#[test]
fn pedestrians_walk_along_their_ways() {
    let task = task_of("pedestrians_cross", |_| {});
    assert_eq!((task.agents, task.others), (8, 12));
    let mut env = VecEnv::new(&task, &options(1, 3, Backend::Traci)).expect("SUMO runs");
    let (mut crossed, mut most) = (0, 0);
    for _ in 0..900 {
        env.step(&[-1.0; 8]).expect("a step");
        let world = env.worlds().next().expect("one world");
        let walkers: Vec<BackgroundVehicle> = world.background_vehicles().collect();
        most = most.max(walkers.len());
        for walker in walkers {
            assert_eq!(walker.size, [0.215, 0.478]);
            assert!(!walker.wreck && (0.0..4.0).contains(&walker.speed), "{walker:?}");
            let ([x, y], _) = task.map.routes[walker.route].path.at(walker.position);
            let aside = (walker.pose.x - x).hypot(walker.pose.y - y);
            // Sidewalks are 2 m wide, crossings are 4 m wide, and pedestrians cut the corners of
            // walking areas.
            assert!(aside < 2.5, "{aside} m beside the way: {walker:?}");
            crossed += usize::from(walker.pose.x.abs() < 3.5 || walker.pose.y.abs() < 3.5);
        }
    }
    assert!(most > 3 && crossed > 50, "at most {most} at a time, {crossed} steps on the road");
}

/// Persons who walk the same path are one stream, even if a file lists every person separately.
#[test]
fn who_walks_the_same_way_is_one_stream() {
    let folder = folder();
    let person = |id: u32, edges: &str| {
        format!(
            "<person id=\"{id}\" depart=\"{id}\" departPos=\"{}\"><walk edges=\"{edges}\" arrivalPos=\"{}\"/></person>",
            30 + id,
            10 + id
        )
    };
    let south = (0..4).map(|id| person(id, "south_in south_out"));
    let all: String =
        south.chain([person(4, "south_out south_in"), person(5, "north_in north_out")]).collect();
    let file = folder.path().join("people.rou.xml");
    fs::write(&file, format!("<routes>{all}</routes>")).expect("written");
    let task = task_of("pedestrians_cross", |scenario| scenario.traffic.files = vec![file]);
    let own =
        task_of("pedestrians_cross", |scenario| scenario.traffic.files.clear()).map.routes.len();
    assert_eq!(task.map.routes.len(), own + 3);
    let mut env = VecEnv::new(&task, &options(1, 3, Backend::Traci)).expect("SUMO runs");
    let mut most = 0;
    for _ in 0..120 {
        env.step(&[-1.0; 8]).expect("a step");
        most = most.max(env.worlds().next().expect("one world").background_vehicles().count());
    }
    assert_eq!(most, 6, "they all walk");
}

#[test]
fn pedestrians_cross_the_ways_of_vehicles_and_are_hit_by_those_who_do_not_wait() {
    let task = task_of("pedestrians_cross", |_| {});
    let over_north = task.map.routes.len() - 1;
    let meets = |route: usize| task.map.routes[route].conflict_with(over_north).is_some();
    assert_eq!([0, 1, 2, 3].map(meets), [false, false, true, true], "who uses the northern arm");
    let of = |policy: Policy<'_>| play(&task, &policy, 15).metrics().expect("episodes");
    // Several speeds, so that some vehicles reach the crossing when a pedestrian is on it.
    let rude = [0.15, 0.2, 0.25, 0.3].map(|throttle| of(Policy::Throttle(throttle)));
    let others = rude.iter().map(|metrics| metrics.driving().others.as_ref().expect("others"));
    let hit = others.clone().map(|others| others.pedestrian_crash.expect("some walk").mean);
    assert!(hit.sum::<f64>() > 0.0, "{rude:?}");
    assert!(
        others.clone().all(|o| o.vehicles.mean == 0.0 && o.crash.is_none() && o.delay.is_none()),
        "nobody drives"
    );
    // SUMO's driver waits for pedestrians, but brushes a few of them.
    let polite = of(Policy::Sumo);
    assert!(polite.success.mean > 0.8 && rude[1].success.mean < 0.2, "{polite:?}");
    let met = polite.driving().others.clone().expect("others");
    assert!(met.pedestrians.mean > 1.0 && met.pet.expect("they meet").mean > 0.1, "{met:?}");
}

#[test]
fn a_pedestrian_that_was_hit_stands_until_it_is_cleared_away() {
    let task = task_of("pedestrians_cross", |_| {});
    let mut env = VecEnv::new(&task, &options(1, 5, Backend::Traci)).expect("SUMO runs");
    let (mut hit, mut lying) = (0, Vec::<BackgroundVehicle>::new());
    let mut throttle = 0.0;
    for k in 0..5000 {
        // Northbound vehicles drive, a little faster each time; all other vehicles stand.
        let northbound = |world: &World| {
            world.agents().map(|a| if a.route == 2 { throttle } else { -1.0 }).collect()
        };
        let actions: Vec<f32> = northbound(env.worlds().next().expect("one world"));
        env.step(&actions).expect("a step");
        if k % 250 == 0 {
            throttle = 0.18 + 0.01 * (k / 250) as f32;
        }
        let world = env.worlds().next().expect("one world");
        let wrecks: Vec<BackgroundVehicle> =
            world.background_vehicles().filter(|other| other.wreck).collect();
        for old in &lying {
            let stays = wrecks.iter().find(|new| new.route == old.route);
            assert!(
                stays.is_none_or(|new| new.pose.distance(&old.pose) < 0.2),
                "{old:?} {stays:?}"
            );
        }
        hit += usize::from(wrecks.len() > lying.len());
        lying = wrecks;
        if world.step_count() > 250 {
            env.reset();
            lying.clear();
        }
    }
    assert!(hit > 0 && lying.len() < 3, "{hit} were hit");
}

#[test]
fn the_same_seed_gives_the_same_pedestrians_on_both_backends() {
    let task = task_of("pedestrians_cross", |_| {});
    let first = watch(&task, 3, 400, Backend::Traci);
    assert!(first.iter().any(|(_, others)| others.len() > 1));
    assert!(first == watch(&task, 3, 400, Backend::Traci), "the same again");
    if cfg!(feature = "libsumo") {
        assert!(first == watch(&task, 3, 400, Backend::Libsumo), "the same in process");
    }
}

#[test]
fn the_same_seed_gives_the_same_traffic_on_both_backends() {
    let task = task(|_| {});
    let first = watch(&task, 3, 500, Backend::Traci);
    assert!(
        first.iter().any(|(_, others)| others.len() > 4),
        "some arrive beside the four at places"
    );
    assert!(first == watch(&task, 3, 500, Backend::Traci), "the same again");
    if cfg!(feature = "libsumo") {
        assert!(first == watch(&task, 3, 500, Backend::Libsumo), "the same in process");
    }
    let other = watch(&task, 4, 100, Backend::Traci);
    assert!(first[0].1 != other[0].1, "another seed is other traffic");
    assert!(first[50].1.iter().zip(&other[50].1).all(|(a, b)| a != b));
}

/// Returns the records of the first `episodes` episodes by episode number, played in `worlds`
/// worlds.
fn records(task: &Arc<Task>, worlds: usize, episodes: u64) -> BTreeMap<u64, EpisodeRecord> {
    let options = VecOptions { episodes: 0..episodes, ..options(worlds, 7, Backend::Traci) };
    let mut env = VecEnv::new(task, &options).expect("SUMO runs");
    let mut records = BTreeMap::new();
    while !env.is_finished() {
        records
            .extend(step(&mut env, task.agents).into_iter().map(|record| (record.episode, record)));
    }
    records
}

#[test]
fn an_episode_does_not_depend_on_those_before_it() {
    let task = task(|_| {});
    let one = records(&task, 1, 9);
    assert_eq!(one.len(), 9);
    for worlds in [2, 5] {
        assert!(one == records(&task, worlds, 9), "{worlds} worlds");
    }
    let others: Vec<_> =
        one.values().map(|record| record.driving().others.expect("there are others")).collect();
    assert!(others.iter().all(|o| o.vehicles >= 4), "four at places in each: {others:?}");
    assert!(others.windows(2).any(|w| w[0] != w[1]));
    assert!(
        one.values().any(|r| r.driving().crash > 0.0) && one.values().any(|r| r.success > 0.0),
        "both happen"
    );
}

#[test]
fn pedestrians_of_an_episode_do_not_depend_on_those_before_it() {
    let task = task_of("pedestrians_cross", |scenario| scenario.termination.horizon = 300);
    let one = records(&task, 1, 6);
    assert!(one == records(&task, 3, 6), "3 worlds");
    assert!(
        one.values()
            .any(|record| record.driving().others.is_some_and(|others| others.pedestrians > 1))
    );
}

#[test]
fn goes_on_from_a_state_as_without_a_break() {
    for name in ["mixed_cross", "pedestrians_cross"] {
        goes_on(&task_of(name, |_| {}));
    }
}

fn goes_on(task: &Arc<Task>) {
    let options = options(2, 9, Backend::Traci);
    let mut env = VecEnv::new(task, &options).expect("SUMO runs");
    let mut finished = 0;
    while finished < 3 || env.worlds().any(|world| world.step_count() < 4) {
        finished += step(&mut env, task.agents).len();
    }
    let mut resumed = VecEnv::restore(task, &options, &env.states()).expect("SUMO runs");
    for _ in 0..150 {
        let (a, b) = (step(&mut env, task.agents), step(&mut resumed, task.agents));
        assert!(a == b);
        for (x, y) in env.worlds().zip(resumed.worlds()) {
            assert!(
                x.frame() == y.frame() && x.background_vehicles().eq(y.background_vehicles()),
                "step {}",
                x.step_count()
            );
        }
    }
}

/// Returns a world after `steps` steps, in which one agent stands still among seven vehicles that
/// SUMO drives.
fn stand(change: impl FnOnce(&mut Scenario), steps: usize) -> (Arc<Task>, World) {
    let task = task(|scenario| {
        scenario.traffic.penetration = 0.125;
        change(scenario);
    });
    assert_eq!((task.agents, task.spec.agents), (1, 1));
    let mut env = VecEnv::new(&task, &options(1, 1, Backend::Traci)).expect("SUMO runs");
    for _ in 0..steps {
        env.step(&[0.0]).expect("a step");
    }
    let world = env.worlds().next().expect("one world").clone();
    (task, world)
}

/// Returns the features of a group, one slice per token.
fn tokens<'a>(task: &Task, world: &'a World, group: &str) -> Vec<&'a [f32]> {
    let found = task.spec.observation.groups.iter().find(|g| g.name == group).expect("the group");
    let seen = &world.frame().observation[found.offset..found.offset + found.width * found.count];
    seen.chunks(found.width).collect()
}

#[test]
fn others_are_seen_as_the_nearest_vehicles() {
    let nearest = |s: &mut Scenario| {
        (s.observation.groups, s.observation.neighbours) = (ObservationGroups::Nearest, 5);
    };
    let (task, world) = stand(nearest, 12);
    let own = world.agents().next().expect("an agent").pose;
    let mut expected: Vec<BackgroundVehicle> = world.background_vehicles().collect();
    expected.sort_by(|a, b| own.distance(&a.pose).total_cmp(&own.distance(&b.pose)));
    let (sin, cos) = own.heading.sin_cos();
    for (token, other) in tokens(&task, &world, "neighbour").iter().zip(&expected) {
        let (dx, dy) = (other.pose.x - own.x, other.pose.y - own.y);
        let place = [(dx * cos + dy * sin) / 50.0, (dy * cos - dx * sin) / 50.0]
            .map(|v| v.clamp(-1.0, 1.0) as f32);
        assert!(
            (token[0] - place[0]).abs() < 1e-5 && (token[1] - place[1]).abs() < 1e-5,
            "{token:?} {other:?}"
        );
        assert_eq!(token[4..], [1.0, 1.0], "it moves, and is there");
    }
    assert_eq!(world.frame().comm, [1.0], "nobody else is there to hear");
}

#[test]
fn others_are_seen_on_streams_and_as_encounters() {
    let (task, world) = stand(|s| s.observation.encounters = 3, 12);
    let own = world.agents().next().expect("an agent");
    let others: Vec<BackgroundVehicle> = world.background_vehicles().collect();
    for (stream, conflict) in task.map.routes[own.route].conflicts.iter().take(2).enumerate() {
        let mut ways: Vec<f64> = others
            .iter()
            .filter(|o| o.route == conflict.route)
            .map(|o| conflict.other - o.position)
            .collect();
        ways.sort_by(f64::total_cmp);
        let count = tokens(&task, &world, &format!("stream{stream}"))[0][2];
        assert!((f64::from(count) - ways.len() as f64 / 12.0).abs() < 1e-6, "stream {stream}");
        assert!(!ways.is_empty());
        for (token, way) in
            tokens(&task, &world, &format!("stream{stream}_vehicle")).iter().zip(&ways)
        {
            assert!(
                (f64::from(token[0]) - (way / 50.0).clamp(-1.0, 1.0)).abs() < 1e-5,
                "{token:?} {way}"
            );
            assert_eq!(token[4], 1.0);
        }
    }
    assert!(tokens(&task, &world, "encounter").iter().all(|token| token[8] == 1.0));
}

#[test]
fn beams_end_at_others() {
    let (task, world) =
        stand(|s| (s.observation.lidar.beams, s.observation.lidar.range) = (72, 60.0), 12);
    let own = world.agents().next().expect("an agent").pose;
    let seen: Vec<f32> = tokens(&task, &world, "lidar").iter().map(|token| token[0]).collect();
    let mut hits = 0;
    for other in world.background_vehicles() {
        let (dx, dy) = (other.pose.x - own.x, other.pose.y - own.y);
        let beam = ((dy.atan2(dx) - own.heading).rem_euclid(std::f64::consts::TAU)
            / std::f64::consts::TAU
            * 72.0)
            .round();
        let distance = f64::from(seen[beam as usize % 72]) * 60.0;
        // No beam passes through a vehicle.
        assert!(distance <= dx.hypot(dy) + other.size[0] / 2.0, "{distance} {other:?}");
        hits += usize::from((distance - dx.hypot(dy)).abs() < other.size[0] / 2.0 + 0.5);
    }
    assert!(hits > 0, "some are in plain sight");
}

/// Background vehicles stop behind agents that steer and stand still, and do not touch them.
#[test]
fn others_wait_behind_agents_that_steer() {
    let task = task_of("intersection_turns_small", |scenario| scenario.traffic.penetration = 0.5);
    assert_eq!((task.agents, task.others), (4, 4));
    let mut waiting = 0;
    for seed in 0..8 {
        let mut env = VecEnv::new(&task, &options(1, seed, Backend::Traci)).expect("SUMO runs");
        for _ in 0..150 {
            env.step(&[0.0, -1.0].repeat(4)).expect("a step");
        }
        let world = env.worlds().next().expect("one world");
        let agents: Vec<_> = world.agents().collect();
        assert!(agents.iter().all(|agent| !agent.outcome.crashed), "seed {seed}: {agents:?}");
        for other in world.background_vehicles().filter(|other| other.speed < 0.1 && !other.wreck) {
            let (sin, cos) = other.pose.heading.sin_cos();
            let behind = agents.iter().any(|agent| {
                let (dx, dy) = (agent.pose.x - other.pose.x, agent.pose.y - other.pose.y);
                let (ahead, aside) = (dx * cos + dy * sin, dy * cos - dx * sin);
                (4.0..10.0).contains(&ahead) && aside.abs() < 1.0 && agent.driving
            });
            waiting += usize::from(behind);
        }
    }
    assert!(waiting >= 4, "{waiting} stand behind an agent");
}

#[test]
fn an_agent_that_hits_one_has_crashed_and_both_stand_as_wrecks() {
    // One agent at full throttle among seven background vehicles runs into the vehicle ahead.
    let task = task(|scenario| scenario.traffic.penetration = 0.125);
    let mut env = VecEnv::new(&task, &options(1, 2, Backend::Traci)).expect("SUMO runs");
    let mut crashes = 0;
    for _ in 0..3000 {
        env.step(&[1.0]).expect("a step");
        let finished = env.take_finished();
        let world = env.worlds().next().expect("one world");
        let (agent, wrecks) = (
            world.agents().next().expect("an agent"),
            world.background_vehicles().filter(|o| o.wreck),
        );
        let wrecks: Vec<BackgroundVehicle> = wrecks.collect();
        if let Some(record) = finished.first() {
            let others = record.driving().others.expect("there are others");
            assert_eq!(record.driving().crash > 0.0, others.crash > 0.0, "it takes two");
            crashes += usize::from(record.driving().crash > 0.0);
            if record.driving().crash > 0.0 {
                assert!(agent.outcome.crashed && record.driving().own_collisions > 0);
                let hit = |other: &BackgroundVehicle| {
                    let size =
                        [task.scenario.vehicle.length + 0.5, task.scenario.vehicle.width + 0.5];
                    boxes_overlap((&agent.pose, size), (&other.pose, other.size))
                };
                assert!(wrecks.iter().any(hit), "{agent:?} {wrecks:?}");
                assert_eq!((others.ttc, others.pet), (Some(0.0), Some(0.0)));
            } else {
                assert!(agent.outcome.arrived && wrecks.is_empty());
            }
        }
    }
    assert!(crashes >= 5, "{crashes}");
}

#[test]
fn a_wreck_of_theirs_is_cleared_away() {
    // One of the two agents stands still, so that the episode goes on.
    let task = task(|scenario| scenario.traffic.penetration = 0.25);
    let wreck_steps =
        (task.scenario.termination.wreck_time / task.scenario.control.interval).round() as usize;
    let mut env = VecEnv::new(&task, &options(1, 2, Backend::Traci)).expect("SUMO runs");
    let (mut lives, mut last) = (Vec::new(), Vec::<(BackgroundVehicle, usize)>::new());
    for _ in 0..2000 {
        env.step(&[1.0, -1.0]).expect("a step");
        let world = env.worlds().next().expect("one world");
        let wrecks: Vec<BackgroundVehicle> =
            world.background_vehicles().filter(|other| other.wreck).collect();
        let mut next = Vec::new();
        for wreck in &wrecks {
            let before = last
                .iter()
                .find(|(old, _)| old.pose.distance(&wreck.pose) < 0.01 && old.route == wreck.route);
            assert_eq!(wreck.speed, 0.0);
            next.push((*wreck, before.map_or(1, |(_, steps)| steps + 1)));
        }
        let gone = last
            .iter()
            .filter(|(old, _)| !wrecks.iter().any(|w| w.pose.distance(&old.pose) < 0.01));
        if world.is_running() && world.step_count() > 1 {
            lives.extend(gone.map(|(_, steps)| *steps));
        }
        last = next;
        if world.step_count() > 200 {
            env.reset();
        }
    }
    assert!(lives.len() >= 3, "{lives:?}");
    // Besides the wreck time, a wreck takes one step to come to a stop and one step to be removed.
    assert!(
        lives.iter().all(|steps| (wreck_steps..=wreck_steps + 2).contains(steps)),
        "{lives:?} {wreck_steps}"
    );
}

fn play(task: &Arc<Task>, policy: &Policy<'_>, episodes: u64) -> Evaluation {
    support::play(task, policy, episodes, Seed::new(0))
}

#[test]
fn metrics_of_others_tell_who_gives_way() {
    let task = task(|scenario| scenario.traffic.penetration = 0.25);
    let of = |policy: Policy<'_>| {
        play(&task, &policy, 40)
            .metrics()
            .expect("episodes")
            .driving()
            .others
            .clone()
            .expect("others")
    };
    let (rude, polite) = (of(Policy::Throttle(1.0)), of(Policy::Sumo));
    let met = |of: Option<Estimate>| of.expect("others drive");
    assert!(met(rude.crash).low > 0.0 && met(polite.crash).mean == 0.0, "{rude:?} {polite:?}");
    assert!(met(rude.crash).mean <= met(rude.close).mean, "{rude:?}");
    assert!(met(polite.ttc).low > 0.0 && met(polite.pet).low > 0.0, "{polite:?}");
    assert!(rude.pedestrians.mean == 0.0 && rude.pedestrian_crash.is_none(), "nobody walks");
    // Vehicles that wait lose time; wrecks and vehicles that were let through lose less.
    assert!(
        met(polite.delay).low > met(rude.delay).high
            && met(rude.delay).low > 0.0
            && met(polite.braking).low > 0.0,
        "{rude:?} {polite:?}"
    );
    // Without background traffic, there are no metrics of it.
    let alone = self::task(|scenario| {
        (scenario.traffic.penetration, scenario.traffic.files) = (1.0, Vec::new());
    });
    assert_eq!((alone.agents, alone.others), (8, 0));
    assert!(
        play(&alone, &Policy::Throttle(1.0), 4)
            .metrics()
            .expect("episodes")
            .driving()
            .others
            .is_none()
    );
}

#[test]
fn penetration_is_the_share_that_learns() {
    for (share, agents) in [(0.01, 1), (0.125, 1), (0.25, 2), (0.5, 4), (0.8, 6), (1.0, 8)] {
        let task = task(|scenario| scenario.traffic.penetration = share);
        assert_eq!((task.agents, task.others), (agents, 8 - agents + 8), "{share}");
    }
}

/// The sizes of vehicle classes are SUMO's own.
#[test]
fn vehicles_are_as_large_as_sumo_has_them() {
    let folder = folder();
    let file = folder.path().join("classes.rou.xml");
    let classes = [
        "passenger",
        "private",
        "taxi",
        "evehicle",
        "hov",
        "vip",
        "authority",
        "army",
        "emergency",
        "delivery",
        "truck",
        "bus",
        "coach",
        "motorcycle",
        "moped",
        "bicycle",
        "pedestrian",
        "trailer",
        "custom1",
        "custom2",
        "ignoring",
    ];
    let types =
        classes.map(|class| format!("<vType id=\"a_{class}\" vClass=\"{class}\"/>")).concat();
    fs::write(&file, format!("<routes>{types}</routes>")).expect("a file");
    let demand = Demand::load(&[&file]).expect("types");
    let net = root().join("sumo_nets/intersection/arm30.net.xml");
    let arguments = [
        "--net-file".into(),
        net.into(),
        "--additional-files".into(),
        file.into(),
        "--no-step-log".into(),
    ];
    let options = Options { arguments: arguments.to_vec(), ..Options::default() };
    let (_process, mut sumo, _) = Process::start(&options).expect("SUMO runs");
    assert_eq!(demand.types.len(), classes.len() + 2);
    for kind in &demand.types {
        let size = (
            sumo.vehicle_type().get_length(&kind.id).unwrap(),
            sumo.vehicle_type().get_width(&kind.id).unwrap(),
        );
        assert_eq!(size, (kind.length, kind.width), "{}", kind.id);
        let max_speed = sumo.vehicle_type().get_max_speed(&kind.id).unwrap();
        assert!((max_speed - kind.max_speed).abs() < 1e-2, "{}: {max_speed}", kind.id);
    }
}

#[test]
fn trips_take_the_routes_that_lead_there() {
    let folder = folder();
    let file = folder.path().join("trips.rou.xml");
    let trips = "<trip id=\"a\" depart=\"0\" from=\"west_in\" to=\"east_out\"/>\
                 <flow id=\"b\" period=\"9\" from=\"south_in\" to=\"north_out\"/>";
    fs::write(&file, format!("<routes>{trips}</routes>")).expect("a file");
    let task = task(|scenario| {
        (scenario.traffic.files, scenario.traffic.kind) = (vec![file.clone()], None);
    });
    assert_eq!(task.map.routes.len(), 4, "they are those of the scenario");
    let mut env = VecEnv::new(&task, &options(1, 3, Backend::Traci)).expect("SUMO runs");
    env.step(&vec![-1.0; task.agents]).expect("a step");
    let routes = |world: &World| {
        world
            .background_vehicles()
            .map(|other| task.map.route_id(other.route).to_owned())
            .collect::<Vec<_>>()
    };
    let seen = routes(env.worlds().next().expect("one world"));
    assert!(
        seen.iter().any(|id| id == "eastbound") && seen.iter().any(|id| id == "northbound"),
        "{seen:?}"
    );
}

/// Returns the first error of the check of the shipped scenario, after its `<traffic>` and, if
/// given, its route file have been changed.
fn mistake(traffic: &str, file: Option<(&str, &str)>) -> String {
    let folder = folder();
    let text = fs::read_to_string(root().join("scenarios/mixed_cross.xml")).expect("the scenario");
    let (head, rest) = text.split_once("<traffic ").expect("it has traffic");
    let (_, tail) = rest.split_once("/>").expect("an element");
    let nets = root().join("sumo_nets");
    let text = format!("{head}<traffic {traffic}/>{tail}")
        .replace("../sumo_nets/intersection", &nets.join("intersection").display().to_string());
    let demand =
        fs::read_to_string(nets.join("mixed_cross/humans.rou.xml")).expect("the route file");
    let demand = file.map_or(demand.clone(), |(from, to)| {
        assert!(demand.contains(from));
        demand.replacen(from, to, 1)
    });
    fs::write(folder.path().join("humans.rou.xml"), demand).expect("a file");
    let path = folder.path().join("a.xml");
    fs::write(&path, text).expect("a file");
    let found = Scenario::check(&path);
    let first = found
        .list
        .iter()
        .find(|finding| finding.severity == iwol_sumo::scenario::Severity::Error)
        .expect("a mistake");
    let text = format!(
        "{}:{} {}",
        Path::new(&first.file).file_name().unwrap().to_string_lossy(),
        first.at.map_or(0, |at| at.line),
        first.message
    );
    assert!(Scenario::load(&path).is_err());
    text
}

#[test]
fn mistakes_in_traffic_are_pointed_at() {
    let files = "files=\"humans.rou.xml\"";
    let cases = [
        (format!("penetration=\"0\" {files}"), None, "a.xml:40 `0` is not a valid penetration"),
        (format!("type=\"humn\" {files}"), None, "a.xml:40 `humn` is not a valid type"),
        ("type=\"human\"".into(), None, "a.xml:40 <traffic> lacks the attribute `files`"),
        ("files=\"none.rou.xml\"".into(), None, "a.xml:40 `"),
        (
            format!("strict=\"true\" {files}"),
            Some(("edges=\"west_in east_out\"", "edges=\"west_in north_out\"")),
            "humans.rou.xml:18 the flow `from_west` cannot be used: ",
        ),
        (
            files.into(),
            Some(("exp(0.025)", "exp(x)")),
            "humans.rou.xml:18 `exp(x)` is not a valid period",
        ),
    ];
    for (traffic, file, expected) in cases {
        let found = mistake(&traffic, file);
        assert!(found.starts_with(expected), "{found}");
    }
    let found = mistake("files=\"none.rou.xml\"", None);
    assert!(found.contains("none.rou.xml` is not a valid files of <traffic>"), "{found}");
}
