//! `iwol bench act`: measures how long a policy takes to decide.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::bail;
use serde::Serialize;
use tch::{Device, Tensor};

use crate::algo::{self, ActMode, Observation, Settings};
use crate::env::Task;
use crate::rng::{self, Seed};
use crate::rollout::{Rollout, Sizes};
use crate::scenario::Scenario;

use super::quantile;

#[derive(Debug, clap::Args)]
pub(super) struct Act {
    /// Scenario file.
    #[arg(long, default_value = "scenarios/intersection.xml")]
    scenario: PathBuf,
    /// Numbers of vehicles per world.
    #[arg(long, value_delimiter = ',', default_value = "8,48")]
    agents: Vec<u32>,
    /// Algorithms [default: all].
    #[arg(long, value_delimiter = ',')]
    algorithm: Vec<String>,
    /// Number of worlds per decision.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=1024))]
    worlds: u16,
    /// Number of timed decisions.
    #[arg(long, default_value_t = 2000, value_parser = clap::value_parser!(u32).range(1..=10_000_000))]
    decisions: u32,
    /// Number of threads of libtorch.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: u16,
    /// Print JSON lines instead of a table.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Serialize)]
struct Row {
    algorithm: String,
    agents: u32,
    worlds: u16,
    /// One decision of all vehicles: median and 99th percentile \[µs\].
    median_us: f64,
    p99_us: f64,
    /// `median_us` divided by the number of vehicles in all worlds \[µs\].
    per_vehicle_us: f64,
    /// Number of weights of the deployed policy.
    parameters: i64,
}

pub(super) fn run(args: &Act) -> anyhow::Result<()> {
    let scenario = Scenario::load(&args.scenario)?;
    let names: Vec<&str> = match &args.algorithm[..] {
        [] => algo::names(),
        names => names.iter().map(String::as_str).collect(),
    };
    if let Some(unknown) = names.iter().find(|name| !algo::names().contains(name)) {
        bail!("there is no algorithm `{unknown}`; choose from {}", algo::names().join(", "));
    }
    tch::set_num_threads(i32::from(args.threads));
    if !args.json {
        tell!(
            "{:9} {:>6} {:>6} {:>11} {:>11} {:>13} {:>8} {:>10}",
            "algorithm",
            "agents",
            "worlds",
            "median",
            "99 %",
            "per vehicle",
            "× first",
            "weights"
        );
    }
    for &agents in &args.agents {
        let task = Task::new(&scenario, agents)?;
        let mut first = None;
        for name in &names {
            let row = measure(name, &task, args)?;
            let ratio = row.median_us / *first.get_or_insert(row.median_us);
            if args.json {
                tell!("{}", serde_json::to_string(&row)?);
            } else {
                tell!(
                    "{name:9} {agents:>6} {:>6} {:>8.1} µs {:>8.1} µs {:>10.2} µs {ratio:>8.2} {:>10}",
                    row.worlds,
                    row.median_us,
                    row.p99_us,
                    row.per_vehicle_us,
                    row.parameters
                );
            }
        }
    }
    Ok(())
}

/// Times decisions on random observations of vehicles that are all in communication range of each
/// other, or hear as many as the scenario allows.
fn measure(name: &str, task: &Task, args: &Act) -> anyhow::Result<Row> {
    let learner = algo::build(name, &task.spec, &Settings::default(), Seed::new(0), Device::Cpu)?;
    let sizes = Sizes {
        steps: 0,
        envs: args.worlds.into(),
        agents: task.agents,
        observation: task.spec.observation.len(),
        state: 0,
        actions: 0,
        choices: 0,
        memory: learner.memory(),
        graph_noise: 0,
    };
    let mut rollout = Rollout::new(sizes);
    rng::fill_normal(&mut Seed::new(1).rng(), &mut rollout.observation);
    rollout.observation.iter_mut().for_each(|x| *x = x.clamp(-1.0, 1.0));
    for (k, link) in rollout.comm.iter_mut().enumerate() {
        *link = f32::from(u8::from(super::hears(k, &task.spec)));
    }
    let (e, n) = (i64::from(args.worlds), task.agents as i64);
    let memory = Tensor::zeros([e, n, sizes.memory as i64], (tch::Kind::Float, Device::Cpu));
    let mut input = Observation::at(&rollout, 0, &memory);
    let mut times = Vec::new();
    let warm_up = (args.decisions / 10).max(10);
    for decision in 0..args.decisions + warm_up {
        let begin = Instant::now();
        let decided = learner.act(&input, &ActMode::Deterministic);
        let took = begin.elapsed().as_secs_f64() * 1e6;
        input.memory = decided.memory;
        // The first decisions warm up caches.
        if decision >= warm_up {
            times.push(took);
        }
    }
    let median = quantile(&mut times, 0.5);
    Ok(Row {
        algorithm: name.to_owned(),
        agents: task.agents as u32,
        worlds: args.worlds,
        median_us: median,
        p99_us: quantile(&mut times, 0.99),
        per_vehicle_us: median / (e * n) as f64,
        parameters: learner.parameters().0,
    })
}
