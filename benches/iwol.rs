//! What a decision, a respawn and an update cost: `make bench`. Needs SUMO.

use std::hint::black_box;
use std::path::Path;
use std::sync::Arc;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use iwol_sumo::algo::{self, ActMode, Observation, Settings};
use iwol_sumo::env::{Driver, Task, VecEnv, VecOptions};
use iwol_sumo::rng::{self, Seed};
use iwol_sumo::rollout::{Rollout, Sizes};
use iwol_sumo::scenario::Scenario;
use iwol_sumo::sumo::Hosting;
use tch::{Device, Kind, Tensor};

fn task(agents: u32) -> Arc<Task> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/intersection.xml");
    Arc::new(Task::new(&Scenario::load(&path).expect("the shipped scenario"), agents).expect("a task"))
}

fn env(agents: u32, worlds: usize) -> VecEnv {
    let options = VecOptions {
        worlds,
        driver: Driver::Agents,
        seed: Seed::new(0),
        episodes: 0..u64::MAX,
        hosting: Hosting::default(),
    };
    VecEnv::new(&task(agents), &options).expect("SUMO runs; else run scripts/bootstrap")
}

/// One decision of one world and of sixteen, everything included: SUMO, dynamics, collisions, observations, respawns.
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

/// A policy's decision for sixteen worlds of eight vehicles.
fn act(c: &mut Criterion) {
    let (worlds, agents) = (16_i64, 8_i64);
    let task = task(8);
    let zeros = |shape: &[i64]| Tensor::zeros(shape, (Kind::Float, Device::Cpu));
    for name in algo::NAMES {
        let learner = algo::build(name, &task.spec, &Settings::default(), Seed::new(0)).expect("a learner");
        let input = Observation {
            observation: zeros(&[worlds, agents, task.spec.observation.len() as i64]),
            comm: zeros(&[worlds, agents, agents]) + 1.0,
            start: zeros(&[worlds]),
            memory: zeros(&[worlds, agents, 0]),
        };
        c.bench_function(&format!("act/{name}"), |b| {
            b.iter(|| learner.act(black_box(&input), &ActMode::Deterministic));
        });
    }
}

/// An update on a rollout of 16 steps of 16 worlds of eight vehicles.
fn update(c: &mut Criterion) {
    let task = task(8);
    let mut group = c.benchmark_group("update");
    group.sample_size(10);
    for name in algo::NAMES {
        let mut learner = algo::build(name, &task.spec, &Settings::default(), Seed::new(0)).expect("a learner");
        let sizes = Sizes {
            steps: 16,
            envs: 16,
            agents: 8,
            observation: task.spec.observation.len(),
            state: task.spec.state.len(),
            actions: 1,
            memory: 0,
            graph_noise: learner.samples_graph(),
        };
        let mut rollout = Rollout::new(sizes);
        rng::fill_normal(&mut Seed::new(1).rng(), &mut rollout.observation);
        rng::fill_normal(&mut Seed::new(2).rng(), &mut rollout.reward);
        rollout.active.fill(1.0);
        rollout.comm.fill(1.0);
        group.throughput(Throughput::Elements((sizes.steps * sizes.envs) as u64));
        group.bench_function(name, |b| {
            b.iter(|| learner.update(black_box(&rollout), 0.0, Seed::new(3)).expect("finite"));
        });
    }
    group.finish();
}

criterion_group!(benches, step, act, update);
criterion_main!(benches);
