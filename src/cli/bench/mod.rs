//! `iwol bench`: measures the speed of simulation, decisions, updates and whole trainings.

#![cfg(feature = "learn")]

mod act;
mod compare;
mod host;
mod sim;
mod train;
mod update;
mod workload;

use anyhow::bail;

use super::Verdict;
use crate::config::{Layers, full_name};
use crate::env::EnvSpec;
use crate::stats::aggregate::percentile;

/// Measures the speed of simulation, decisions, updates and whole trainings.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    /// Measure the simulation: steps per second, SUMO's share of the time, bytes, respawns.
    Sim(sim::Sim),
    /// Measure decisions: median, 99th percentile, time per vehicle, ratio to the first algorithm.
    Act(act::Act),
    /// Measure updates: time per rollout and per sample, ratio to the same networks in PyTorch.
    Update(update::Update),
    /// Measure trainings: steps and seconds until validations succeed for good.
    Train(train::Train),
}

pub(super) fn run(args: &Args) -> anyhow::Result<Verdict> {
    match &args.what {
        What::Sim(args) => sim::run(args)?,
        What::Act(args) => act::run(args)?,
        What::Update(args) => update::run(args)?,
        What::Train(args) => return train::run(args),
    }
    Ok(Verdict::Good)
}

/// Refuses a `--set` of what a benchmark's own options determine.
fn refuse_own(layers: &Layers) -> anyhow::Result<()> {
    let is_own = |set: &&String| {
        let key = set.split_once('=').map_or("", |(key, _)| full_name(key.trim()));
        layers.flags.iter().any(|(own, _)| full_name(own) == key)
    };
    match layers.sets.iter().find(is_own) {
        Some(set) => bail!("--set {set}: the benchmark's own options determine this setting"),
        None => Ok(()),
    }
}

/// Returns whether pair `k` of a mask `[.., N, N]` of random rollouts is linked: agents hear
/// themselves and all others, or those in the next slots if the number of others is limited.
fn hears(k: usize, spec: &EnvSpec) -> bool {
    let (listener, sender) = (k / spec.agents % spec.agents, k % spec.agents);
    let apart = (sender + spec.agents - listener) % spec.agents;
    spec.most_heard.is_none_or(|most| apart <= most)
}

fn median(values: &mut [f64]) -> f64 {
    quantile(values, 0.5)
}

/// Sorts the values and returns the `q`-quantile of them; NaN without values.
fn quantile(values: &mut [f64], q: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    percentile(values, q)
}
