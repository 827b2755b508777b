//! Benchmarks of a decision, a respawn and an update: `make bench`. Needs SUMO.

use std::hint::black_box;
use std::path::Path;
use std::sync::Arc;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use iwol_sumo::algo::{self, ActMode, Observation, Settings, UpdateParameters};
use iwol_sumo::env::{Driver, Pose, Task, VecEnv, VecOptions, World, boxes_overlap, physical_mask};
use iwol_sumo::rng::{self, Seed};
use iwol_sumo::rollout::{Rollout, Sizes};
use iwol_sumo::scenario::Scenario;
use iwol_sumo::sumo::codec::{Reader, Writer};
use iwol_sumo::sumo::{Batch, Hosting, Simulation as _, TraciSimulation};
use tch::{Device, Kind, Tensor};

fn task(agents: u32) -> Arc<Task> {
    task_of("intersection", agents, 0)
}

fn task_of(scenario: &str, agents: u32, lidar_beams: usize) -> Arc<Task> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("scenarios/{scenario}.xml"));
    let mut scenario = Scenario::load(&path).expect("a shipped scenario");
    scenario.observation.lidar.beams = lidar_beams;
    Arc::new(Task::new(&scenario, agents).expect("a task"))
}

fn env(agents: u32, worlds: usize) -> VecEnv {
    let options = VecOptions {
        repeat_failed: 0.0,
        worlds,
        stride: worlds as u64,
        driver: Driver::Agents,
        seed: Seed::new(0),
        episodes: 0..u64::MAX,
        hosting: Hosting::default(),
    };
    VecEnv::new(&task(agents), &options).expect("SUMO runs; else run scripts/bootstrap")
}

/// Complete decisions of one world and of sixteen worlds: SUMO, dynamics, collisions, observations,
/// respawns.
fn step(c: &mut Criterion) {
    let mut group = c.benchmark_group("env/step");
    for (agents, worlds) in [(8, 1), (8, 16), (48, 1), (48, 16)] {
        let mut env = env(agents, worlds);
        let actions = vec![0.3; worlds * agents as usize];
        group.throughput(Throughput::Elements(worlds as u64));
        group.bench_function(format!("{agents} vehicles, {worlds} worlds"), |b| {
            b.iter(|| env.step(black_box(&actions)).expect("a step"));
        });
    }
    group.finish();
}

/// Decisions of one world without SUMO: dynamics, collisions, rewards, masks, observations and
/// privileged state, over the first 60 steps of an episode whose snapshots were recorded.
fn world(c: &mut Criterion) {
    const STEPS: usize = 60;
    let mut group = c.benchmark_group("env/world, beside SUMO");
    let turns = "intersection_turns";
    for (scenario, agents, lidar_beams) in [
        ("intersection", 8, 0),
        ("intersection", 24, 0),
        ("intersection", 48, 0),
        (turns, 48, 0),
        (turns, 48, 72),
    ] {
        let task = task_of(scenario, agents, lidar_beams);
        let per_agent =
            if task.scenario.control.steering.is_some() { &[0.0, 0.4][..] } else { &[0.4] };
        let actions = per_agent.repeat(agents as usize);
        let mut simulation =
            TraciSimulation::start(task.simulation_config(0, 1, &Hosting::default()))
                .expect("SUMO runs");
        let mut world = World::new(Arc::clone(&task), Driver::Agents, Seed::new(0), 0, 1, u64::MAX);
        let (mut commands, mut snapshots) = (Vec::new(), Vec::new());
        world.reset(0);
        for _ in 0..STEPS {
            commands.clear();
            world.act(0, &actions, &mut commands);
            snapshots.push(simulation.step(&commands).expect("a step").clone());
            world.observe(0, snapshots.last().expect("one")).expect("no vehicle is lost");
        }
        group.throughput(Throughput::Elements(STEPS as u64));
        group.bench_function(
            format!("{scenario}, {agents} vehicles, {lidar_beams} beams, {STEPS} steps"),
            |b| {
                b.iter(|| {
                    world.reset(0);
                    for snapshot in &snapshots {
                        commands.clear();
                        world.act(0, black_box(&actions), &mut commands);
                        world.observe(0, black_box(snapshot)).expect("no vehicle is lost");
                    }
                });
            },
        );
    }
    group.finish();
}

/// The physical mask and the collision test on their own.
fn parts(c: &mut Criterion) {
    let poses: Vec<Pose> = (0..48)
        .map(|i| Pose {
            x: f64::from(i % 7) * 9.0,
            y: f64::from(i / 7) * 6.0,
            heading: f64::from(i),
        })
        .collect();
    let (present, mut mask) = (vec![true; 48], vec![0.0; 48 * 48]);
    c.bench_function("physical mask/48 vehicles", |b| {
        b.iter(|| physical_mask(black_box(&poses), &present, 30.0, &mut mask));
    });
    c.bench_function("boxes overlap/one pair", |b| {
        b.iter(|| {
            boxes_overlap(
                (black_box(&poses[0]), [4.515, 1.852]),
                (black_box(&poses[8]), [4.515, 1.852]),
            )
        });
    });
}

/// The codec for 48 vehicles: writing the commands of a step, and reading values as a step reports
/// them.
fn codec(c: &mut Criterion) {
    let names: Vec<String> = (0..48).map(|i| format!("w0s{i}")).collect();
    let mut batch = Batch::new();
    c.bench_function("codec/write 48 speeds", |b| {
        b.iter(|| {
            batch.clear();
            for name in &names {
                batch.vehicle().set_speed(name, black_box(7.5));
            }
        });
    });
    let mut writer = Writer::default();
    for name in &names {
        writer.str(name).double(12.5).double(7.5);
    }
    c.bench_function("codec/read 48 vehicles", |b| {
        b.iter(|| {
            let mut reader = Reader::new(black_box(&writer.bytes()[4..]), 4);
            let mut sum = 0.0;
            for _ in 0..48 {
                sum += reader.str().expect("a name").len() as f64;
                sum += reader.double().expect("a number") + reader.double().expect("a number");
            }
            sum
        });
    });
}

/// Decisions of a policy for sixteen worlds of eight vehicles.
fn act(c: &mut Criterion) {
    let (worlds, agents) = (16_i64, 8_i64);
    let task = task(8);
    let zeros = |shape: &[i64]| Tensor::zeros(shape, (Kind::Float, Device::Cpu));
    for name in algo::NAMES {
        let learner =
            algo::build(name, &task.spec, &Settings::default(), Seed::new(0), Device::Cpu)
                .expect("a learner");
        let input = Observation {
            observation: zeros(&[worlds, agents, task.spec.observation.len() as i64]),
            comm: zeros(&[worlds, agents, agents]) + 1.0,
            start: zeros(&[worlds, agents]),
            memory: zeros(&[worlds, agents, learner.memory() as i64]),
            disturbance: zeros(&[0]),
            available: zeros(&[0]),
        };
        c.bench_function(&format!("act/{name}"), |b| {
            b.iter(|| learner.act(black_box(&input), &ActMode::Deterministic));
        });
    }
}

/// Updates on a rollout of 16 steps, 16 worlds and eight vehicles.
fn update(c: &mut Criterion) {
    let task = task(8);
    let mut group = c.benchmark_group("update");
    group.sample_size(10);
    let parameters =
        UpdateParameters { learning_rate: 0.0, log_std: 0.0, entropy_coefficient: 0.0 };
    for name in algo::NAMES {
        let mut learner =
            algo::build(name, &task.spec, &Settings::default(), Seed::new(0), Device::Cpu)
                .expect("a learner");
        let sizes = Sizes {
            steps: 16,
            envs: 16,
            agents: 8,
            observation: task.spec.observation.len(),
            state: task.spec.state.len(),
            actions: 1,
            choices: 0,
            memory: learner.memory(),
            graph_noise: learner.graph_noise(8),
        };
        let mut rollout = Rollout::new(sizes);
        rng::fill_normal(&mut Seed::new(1).rng(), &mut rollout.observation);
        rng::fill_normal(&mut Seed::new(2).rng(), &mut rollout.reward);
        rollout.active.fill(1.0);
        rollout.comm.fill(1.0);
        group.throughput(Throughput::Elements((sizes.steps * sizes.envs) as u64));
        group.bench_function(name, |b| {
            b.iter(|| {
                learner.update(black_box(&rollout), &parameters, Seed::new(3)).expect("finite")
            });
        });
    }
    group.finish();
}

criterion_group!(benches, codec, parts, world, step, act, update);
criterion_main!(benches);
