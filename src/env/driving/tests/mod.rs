//! Tests of a world against a fake simulator that carries out the commands exactly: vehicles move
//! along their route's path by speed times the step length. What SUMO itself does is tested in
//! `tests/`.

mod driving;
mod intention;
mod others;
mod paths;

use std::collections::HashSet;
use std::path::Path;
use std::sync::Arc;

use proptest::prelude::*;

use super::agents::CLEARED;
use super::*;
use crate::env::Pursuit;
use crate::rng::Seed;
use crate::scenario::{NeighbourOrder, ObservationGroups, Scenario};
use crate::sumo::{Body, Command, Snapshot, VehicleState};

/// A fake simulator whose vehicles keep to their routes' paths, and which checks every command.
struct Rails {
    task: Arc<Task>,
    vehicles: Vec<Option<(usize, f64, f64)>>,
}

impl Rails {
    fn new(task: &Arc<Task>) -> Self {
        Self { task: Arc::clone(task), vehicles: vec![None; task.slots()] }
    }

    fn step(&mut self, commands: &[Command]) -> Snapshot {
        for command in commands {
            match *command {
                Command::Add { slot, route, depart_pos, depart_speed, .. } => {
                    let vehicle = &mut self.vehicles[slot as usize];
                    assert!(vehicle.is_none(), "slot {slot} already holds a vehicle");
                    *vehicle = Some((route as usize, depart_pos, depart_speed));
                }
                Command::Remove { slot, .. } => {
                    assert!(self.vehicles[slot as usize].take().is_some(), "slot {slot} is empty");
                }
                Command::SetSpeed { slot, speed, .. } => {
                    let vehicle =
                        self.vehicles[slot as usize].as_mut().expect("only vehicles have a speed");
                    assert!(
                        (0.0..=self.task.scenario.vehicle.max_speed + 1e-9).contains(&speed),
                        "speed {speed}"
                    );
                    vehicle.2 = speed;
                }
                Command::SpeedMode { slot, .. } | Command::KeepLane { slot, .. } => {
                    assert!(self.vehicles[slot as usize].is_some());
                }
                Command::Depart { slot, departure, .. } => {
                    assert!(
                        slot as usize >= self.task.agents + self.task.placed,
                        "slot {slot} is not theirs"
                    );
                    let vehicle = &mut self.vehicles[slot as usize];
                    assert!(vehicle.is_none(), "slot {slot} already holds a vehicle");
                    let route = self.task.map.demand_routes
                        [self.task.demand.sources[departure as usize].route]
                        .route;
                    *vehicle = Some((route, 5.0, 10.0));
                }
                Command::MoveTo { .. } => panic!("nobody steers here"),
            }
        }
        let step = self.task.scenario.control.interval;
        let mut snapshot = Snapshot::default();
        for (slot, vehicle) in self.vehicles.iter_mut().enumerate() {
            let route = |route: usize| &self.task.map.routes[route].path;
            if slot >= self.task.agents && vehicle.is_some_and(|(r, s, _)| s > route(r).length()) {
                *vehicle = None;
            }
            snapshot.vehicles.push(vehicle.as_mut().map(|(_, s, speed)| {
                *s += *speed * step;
                VehicleState { distance: *s, speed: *speed }
            }));
            snapshot.bodies.push(vehicle.filter(|_| slot >= self.task.agents).map(|(r, s, _)| {
                let ([x, y], heading) = route(r).at(s);
                Body { x, y, heading, time_loss: 0.0 }
            }));
        }
        snapshot
    }

    /// Returns the centre of a slot's vehicle on its route's path.
    fn centre(&self, slot: usize) -> Option<[f64; 2]> {
        let half = self.task.scenario.vehicle.length / 2.0;
        self.vehicles[slot].map(|(route, s, _)| self.task.map.routes[route].path.at(s - half).0)
    }
}

fn task(agents: u32, change: impl FnOnce(&mut Scenario)) -> Arc<Task> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/intersection.xml");
    let mut scenario = Scenario::load(&path).expect("the shipped scenario is valid");
    change(&mut scenario);
    Arc::new(Task::new(&scenario, agents).expect("a task"))
}

fn world(task: &Arc<Task>, seed: u64) -> World {
    World::new(Arc::clone(task), Driver::Agents, Seed::new(seed), 0, 1, u64::MAX)
}

/// Returns a world for a driver that gives way.
fn ruled_world(task: &Arc<Task>, seed: u64) -> World {
    World::new(Arc::clone(task), Driver::Rules, Seed::new(seed), 0, 1, u64::MAX)
}

fn exchange(world: &mut World, rails: &mut Rails, actions: &[f32]) {
    let mut commands = Vec::new();
    world.act(0, actions, &mut commands);
    let snapshot = rails.step(&commands);
    world.observe(0, &snapshot).expect("nothing vanishes on rails");
}

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
            if frame.start {
                dead.clear();
                let active_agents = frame.active.iter().filter(|&&a| a == 1.0).count();
                prop_assert!(active_agents >= fewest.min(n));
            }
            for i in 0..n {
                let (active, was_active) = (frame.active[i] > 0.0, before.active[i] > 0.0);
                let (terminated, truncated) = (frame.terminated[i] > 0.0, frame.truncated[i] > 0.0);
                let present = frame.comm[i * n + i] > 0.0;
                prop_assert!(!(terminated && truncated), "an end is one or the other");
                if frame.start {
                    prop_assert!(!terminated && !truncated);
                } else {
                    prop_assert_eq!(terminated || truncated, was_active && !active, "an end is where activity ends");
                    prop_assert!(!dead.contains(&i) || !active, "slot {} revived", i);
                }
                prop_assert_eq!(present, active || truncated, "seen while active, and once more when cut short");
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
                let failures = &record.failures;
                let active_agents = f64::from(failures.crashed() + failures.out_of_road + failures.unfinished)
                    / (1.0 - record.success).max(1e-9);
                prop_assert!(record.success > 1.0 - 1e-9 || (active_agents - active_agents.round()).abs() < 1e-6, "{:?}", failures);
                prop_assert!(record.success + record.safety <= 2.0 && record.crash + record.safety <= 1.0 + 1e-9);
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
fn the_reward_is_way_and_speed_and_then_the_arrival() {
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
    assert_eq!((record.safety, record.crash, record.episode_length), (1.0, 0.0, 120));
    assert!((record.efficiency - 0.25 * 4.0 / 120.0).abs() < 1e-12);
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
    let failures = &record.failures;
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
    let failures = &record.failures;
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
    assert_eq!(f64::from(failures.crashed()), record.crash * 8.0);

    let both = failures.clone().plus(failures);
    assert_eq!((both.crossing, both.unfinished, both.steps), (4, 12, 2 * failures.steps));
    assert_eq!(both.routes.values().sum::<u32>(), 4);
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
    let mut crews = std::collections::BTreeSet::new();
    let (mut active_agents, mut reward) = (0, 0.0);
    while crews.len() < 6 {
        exchange(&mut world, &mut rails, &[0.6; 8]);
        let frame = world.frame();
        if frame.start {
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
            let shares = [record.success, record.crash].map(|share| share * active_agents as f64);
            assert!(shares.iter().all(|share| (share - share.round()).abs() < 1e-9));
            assert!((3..=8).contains(&active_agents));
            crews.insert(active_agents);
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
fn an_interrupted_episode_is_cut_short_and_the_next_one_starts_clean() {
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
    assert!(world.frame().start && !world.frame().interrupted);
    assert_eq!(world.episode(), 1);
}

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

#[test]
fn a_reserved_destination_is_one_vehicles() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/parking_lot.xml");
    let scenario = Scenario::load(&path).expect("the shipped scenario is valid");
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
        turns in prop_oneof![Just(0.0), Just(20.0)],
    ) {
        let task = task(agents, |s| {
            s.observation.groups = ObservationGroups::Nearest;
            s.observation.neighbours = 0;
            s.observation.encounters = count;
            s.observation.foresight = foresight;
            s.observation.priority_distance = turns;
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
            let told = usize::from(turns > 0.0);
            let token = if foresight > 0.0 { 14 } else { 10 } + told;
            // The encounters are followed by the free-space features.
            let (first, end) = (i * width, (i + 1) * width - 3 * told);
            let seen = &world.frame().observation[end - token * count..end];
            prop_assert!(end - token * count >= first);
            for (k, token) in seen.chunks(token).enumerate() {
                let Some(distances) = expected.get(k) else {
                    prop_assert!(token.iter().all(|x| *x == 0.0), "padding: {token:?}");
                    continue;
                };
                prop_assert_eq!(token[token.len() - 1], 1.0);
                for passing in token[8..token.len() - 2 - told].chunks(2) {
                    prop_assert!(passing.iter().all(|x| (0.0..=1.0).contains(x)), "{token:?}");
                    // A vehicle that is near ahead now will come at least as near.
                    let near = 1.0 - 15.0 * token[2] / 3.0;
                    prop_assert!(token[0] == 0.0 || passing[0] >= near.min(1.0) - 1e-4, "{token:?}");
                }
                prop_assert_eq!(token[0] > 0.0, distances[1] == 0.0);
                for (distance, at) in distances.iter().zip([1, 3]) {
                    prop_assert!((f64::from(token[at]) - (distance / 50.0).clamp(-1.0, 1.0)).abs() < 1e-5, "{token:?} {distances:?}");
                }
            }
        }
    }
}

/// With the rule first come, first served, all vehicles arrive, also in queues; without it, they
/// crash.
#[test]
fn first_come_first_served_brings_all_home() {
    for (agents, gives_way) in [(4, true), (8, true), (16, true), (48, true), (8, false)] {
        let task = task(agents, |s| s.termination.horizon = 5000);
        let (mut world, mut rails) = (ruled_world(&task, 7), Rails::new(&task));
        world.reset(0);
        let (mut actions, mut records) = (vec![0.0; agents as usize], Vec::new());
        while records.len() < 10 {
            world.pursue(Pursuit { speed: 6.0, gives_way }, &mut actions);
            exchange(&mut world, &mut rails, &actions);
            records.extend(world.take_finished());
        }
        let home = records.iter().filter(|record| record.success == 1.0).count();
        assert!(
            if gives_way { home == 10 } else { home < 5 },
            "{agents} agents, {gives_way}: {home} of 10"
        );
    }
}

/// Agents that observe priority can tell when the rule first come, first served waits, unless the
/// reason is beyond the observed distance.
#[test]
fn agents_are_told_what_the_rule_goes_by() {
    let task = task(8, |s| s.observation.priority_distance = 50.0);
    let (mut world, mut rails) = (world(&task, 11), Rails::new(&task));
    world.reset(0);
    let named = |name: &str| {
        task.spec.observation.list.iter().position(|f| f.name.ends_with(name)).expect("a feature")
    };
    let [free, slow, blocked, entry] =
        ["free", "free_slow", "free_blocked", "to_entry_near"].map(named);
    let (width, mut actions, mut told) = (task.spec.observation.len(), [0.0; 8], [0; 2]);
    for _ in 0..600 {
        world.pursue(Pursuit { speed: 6.0, gives_way: true }, &mut actions);
        for (i, view) in world.agents().enumerate().filter(|(_, view)| view.driving) {
            let seen = &world.frame().observation[i * width..(i + 1) * width];
            let at = |k: usize| 15.0 * f64::from(seen[k]);
            let braking = view.speed * view.speed / 12.0;
            // Comparisons within the rounding of 32 bits are undecided; a value of 15 m stands for
            // any greater distance.
            let below = |x: f64, least: f64| x < least - 1e-4;
            let above = |x: f64, least: f64| x > least + 1e-4;
            let outside = seen[entry] >= 0.0 && below(at(entry), braking);
            let something = at(free).min(at(slow)) < 15.0;
            let waits =
                below(at(free), braking + 4.0) || below(at(blocked), 4.0) || outside && something;
            let entered = seen[entry] < 0.0 || above(at(entry), braking);
            let drives = above(at(free), braking + 4.0) && above(at(blocked), 4.0) && entered;
            assert!(!waits || actions[i] == -1.0, "{seen:?}");
            assert!(!drives || actions[i] > -1.0, "{seen:?}");
            told[0] += usize::from(drives);
            told[1] += usize::from(waits);
        }
        exchange(&mut world, &mut rails, &actions);
    }
    assert!(told.iter().all(|&n| n > 100), "{told:?}");
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
