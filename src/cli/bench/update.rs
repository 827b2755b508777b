//! `iwol bench update`: measures how long learning from a rollout takes, compared with PyTorch.

use std::path::PathBuf;
use std::process::Command as Program;
use std::time::Instant;

use anyhow::{Context as _, ensure};
use serde::Serialize;
use toml::Value;

use crate::algo::settings::{Iwol, Network};
use crate::algo::{self, Algorithm, ComputeDevice, Settings, UpdateParameters};
use crate::config::{Config, Layers};
use crate::env::Task;
use crate::rng::{self, Seed};
use crate::rollout::{Rollout, Sizes};

use super::median;

const REFERENCE: &str = include_str!("../../../benches/reference_update.py");
/// Percentage of the agents that are active in the random rollout, as with a trained policy.
const ACTIVE: usize = 75;

#[derive(Debug, clap::Args)]
pub(super) struct Update {
    /// Scenario file, which determines the sizes of observations.
    #[arg(long, default_value = "scenarios/intersection.xml")]
    scenario: PathBuf,
    /// Number of vehicles per world.
    #[arg(long, default_value_t = 8)]
    agents: u32,
    /// Algorithms [default: all].
    #[arg(long, value_delimiter = ',')]
    algorithm: Vec<String>,
    /// One setting, e.g. --set network.hidden=128. The option may be repeated.
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Number of timed updates.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=1000))]
    repetitions: u32,
    /// Python interpreter with PyTorch, which computes the same updates in turn
    /// (benches/reference_update.py) with one thread per shard [default: no comparison].
    #[arg(long, value_name = "PYTHON")]
    reference: Option<PathBuf>,
    /// Print JSON lines instead of a table.
    #[arg(long)]
    json: bool,
}

/// One line of the table.
#[derive(Debug, Serialize)]
struct Row {
    algorithm: String,
    agents: u32,
    /// Number of samples (agent × step) in the rollout; each is used once per epoch.
    samples: usize,
    /// Passes over the rollout; `None` for algorithms with a replay buffer, which run
    /// `maddpg.updates` minibatches instead.
    epochs: Option<usize>,
    median_ms: f64,
    /// Time per sample of the rollout, over all epochs.
    per_sample_us: f64,
    reference_ms: Option<f64>,
    /// Time of the PyTorch reference divided by the time of this program.
    ratio: Option<f64>,
}

pub(super) fn run(args: &Update) -> anyhow::Result<()> {
    let names: Vec<&str> = match &args.algorithm[..] {
        [] => algo::names(),
        names => names.iter().map(String::as_str).collect(),
    };
    if !args.json {
        tell!(
            "{:9} {:>6} {:>8} {:>7} {:>11} {:>12} {:>12} {:>7}",
            "algorithm",
            "agents",
            "samples",
            "epochs",
            "median",
            "per sample",
            "PyTorch",
            "ratio"
        );
    }
    for name in names {
        let flags = vec![
            ("scenario", Value::String(args.scenario.display().to_string())),
            ("agents", Value::Integer(args.agents.into())),
            ("algorithm", Value::String(name.to_owned())),
        ];
        let layers = Layers { sets: args.set.clone(), flags, ..Layers::default() };
        super::refuse_own(&layers)?;
        let (config, scenario) = Config::resolve(&layers)?;
        let row = measure(name, &config, &Task::new(&scenario, config.agents)?, args)?;
        if args.json {
            tell!("{}", serde_json::to_string(&row)?);
            continue;
        }
        let optional = |value: Option<f64>, unit: &str| {
            value.map_or("-".to_owned(), |v| format!("{v:.1} {unit}"))
        };
        tell!(
            "{name:9} {:>6} {:>8} {:>7} {:>8.1} ms {:>9.2} µs {:>12} {:>7}",
            row.agents,
            row.samples,
            row.epochs.map_or("-".to_owned(), |epochs| epochs.to_string()),
            row.median_ms,
            row.per_sample_us,
            optional(row.reference_ms, "ms"),
            row.ratio.map_or("-".to_owned(), |r| format!("{r:.2}")),
        );
    }
    Ok(())
}

fn measure(name: &str, config: &Config, task: &Task, args: &Update) -> anyhow::Result<Row> {
    let device = config.device.find()?;
    let mut learner = algo::build(name, &task.spec, &config.learner, Seed::new(0), device)?;
    let rollout = random_rollout(&*learner, config, task);
    let ppo = &config.learner.ppo;
    let parameters = UpdateParameters {
        learning_rate: ppo.learning_rate,
        log_std: 0.0,
        entropy_coefficient: ppo.entropy_coefficient,
    };
    let (mut ours, mut theirs) = (Vec::new(), Vec::new());
    for repetition in 0..=args.repetitions {
        let begin = Instant::now();
        learner.update(&rollout, &parameters, Seed::new(u64::from(repetition)))?;
        // The first update warms up caches.
        if repetition > 0 {
            ours.push(1e3 * begin.elapsed().as_secs_f64());
            if let Some(python) = &args.reference {
                theirs.extend(reference(python, name, config, task)?);
            }
        }
    }
    let s = rollout.sizes;
    let samples = s.steps * s.envs * s.agents;
    let median_ms = median(&mut ours);
    let reference_ms = (!theirs.is_empty()).then(|| median(&mut theirs));
    Ok(Row {
        algorithm: name.to_owned(),
        agents: config.agents,
        samples,
        epochs: algo::capabilities(name)?.on_policy.then_some(config.learner.ppo.epochs),
        median_ms,
        per_sample_us: 1e3 * median_ms / samples as f64,
        reference_ms,
        ratio: reference_ms.map(|r| r / median_ms),
    })
}

/// Returns a rollout of random numbers, of the same shape as a real one.
fn random_rollout(learner: &dyn Algorithm, config: &Config, task: &Task) -> Rollout {
    let mut rollout = Rollout::new(Sizes {
        steps: config.train.rollout_steps,
        envs: config.train.envs,
        agents: task.agents,
        observation: task.spec.observation.len(),
        state: task.spec.state.len(),
        actions: task.spec.actions.len(),
        choices: 0,
        memory: learner.memory(),
        graph_noise: learner.graph_noise(task.agents),
    });
    let mut rng = Seed::new(1).rng();
    let s = rollout.sizes;
    for array in
        [&mut rollout.observation, &mut rollout.state, &mut rollout.action, &mut rollout.reward]
    {
        rng::fill_normal(&mut rng, array);
    }
    rng::fill_logistic(&mut rng, &mut rollout.graph_noise);
    rollout.log_prob.fill(-1.4);
    rollout
        .active
        .iter_mut()
        .for_each(|active| *active = f32::from(u8::from(rng::below(&mut rng, 100) < ACTIVE)));
    for (k, link) in rollout.comm.iter_mut().enumerate() {
        let (row, i, j) = (k / (s.agents * s.agents), k / s.agents % s.agents, k % s.agents);
        let both = rollout.active[row * s.agents + i] * rollout.active[row * s.agents + j];
        *link = if super::hears(k, &task.spec) { both } else { 0.0 };
    }
    rollout
        .terminated
        .iter_mut()
        .for_each(|end| *end = f32::from(u8::from(rng::below(&mut rng, 100) == 0)));
    rollout
}

/// Returns the milliseconds of one update in PyTorch, after one update that is not timed.
fn reference(
    python: &PathBuf,
    name: &str,
    config: &Config,
    task: &Task,
) -> anyhow::Result<Vec<f64>> {
    let sizes = [
        ("agents", i64::from(config.agents)),
        ("envs", config.train.envs as i64),
        ("steps", config.train.rollout_steps as i64),
        ("observation", task.spec.observation.len() as i64),
        ("state", task.spec.state.len() as i64),
        ("hidden", config.learner.network.hidden),
        ("message", config.learner.iwol.message),
        ("rounds", config.learner.iwol.rounds as i64),
        ("latent", config.learner.iwol.latent),
        ("epochs", config.learner.ppo.epochs as i64),
        ("minibatch", config.learner.ppo.minibatch as i64),
        ("threads", config.learner.ppo.shards as i64),
        ("repeat", 1),
    ];
    // The reference supports only some settings; with others the two programs would not do the
    // same.
    let usual = Settings {
        network: Network { hidden: config.learner.network.hidden, ..Network::default() },
        iwol: Iwol {
            rounds: config.learner.iwol.rounds,
            latent: config.learner.iwol.latent,
            message: config.learner.iwol.message,
            decoded: config.learner.iwol.decoded,
            ..Iwol::default()
        },
        ..config.learner.clone()
    };
    ensure!(
        usual == config.learner && config.device == ComputeDevice::Cpu,
        "the reference supports only network.hidden, iwol.{{rounds,latent,message,decoded}} and the sizes of a rollout; leave \
         all other settings at their defaults"
    );
    let mut program = Program::new(python);
    program.args(["-c", REFERENCE, "--algorithm", name]);
    program.args(["--decoded", &config.learner.iwol.decoded.to_string()]);
    program.args(sizes.iter().flat_map(|(key, value)| [format!("--{key}"), value.to_string()]));
    let output = program.output().with_context(|| format!("cannot run `{}`", python.display()))?;
    let (text, errors) =
        (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    ensure!(
        output.status.success(),
        "the reference failed: {}",
        errors.lines().last().unwrap_or("it printed no message")
    );
    let last = text.lines().last().unwrap_or_default();
    serde_json::from_str(last).with_context(|| format!("the reference printed `{last}`"))
}
