//! `iwol bench train`: measures how long training takes until it succeeds for good.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Instant;

use anyhow::Context as _;
use serde::Serialize;
use toml::Value;

use crate::config::{Layers, Profile, Resolution};
use crate::curves::{self, Along, Line};
use crate::driving;
use crate::metrics::SUCCESS;
use crate::provenance::{Host, Program};
use crate::ranks::Team;
use crate::train::{Report, RunDir};

use super::{Verdict, median};
use crate::cli::stop_flag;
use crate::cli::work::{update_of, worlds_of};

#[derive(Debug, clap::Args)]
pub(super) struct Train {
    /// Scenario file
    #[arg(long, default_value = "scenarios/intersection.xml", conflicts_with = "environment")]
    scenario: PathBuf,
    /// Environment without SUMO, instead of a scenario
    #[arg(long, value_name = "NAME")]
    environment: Option<String>,
    /// Number of agents [default: the scenario's or the environment's]
    #[arg(long)]
    agents: Option<u32>,
    /// Algorithms
    #[arg(long, value_delimiter = ',', default_value = "mappo,im-iwol,ex-iwol")]
    algorithm: Vec<String>,
    /// Number of runs of each algorithm. Their seeds are 0, 1 and so on
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u16).range(1..=1000))]
    seeds: u16,
    /// Success in %. A run has reached it for good at the first validation from which on no
    /// validation of the run is lower
    #[arg(long, default_value_t = 97.1, value_parser = percentage)]
    success: f64,
    /// One setting, e.g. --set ppo.shards=1. The option may be repeated
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Print JSON lines instead of a table
    #[arg(long)]
    json: bool,
}

/// Reads a percentage. A share, such as 0.971, is more likely a slip than a success of less than 1 %.
fn percentage(text: &str) -> Result<f64, String> {
    let number: f64 = text.parse().map_err(|_| "not a number".to_owned())?;
    let allowed = number == 0.0 || (1.0..=100.0).contains(&number);
    allowed.then_some(number).ok_or_else(|| "allowed: 0, and 1 to 100 (per cent)".to_owned())
}

/// One run.
#[derive(Debug, Serialize)]
struct Row {
    algorithm: String,
    agents: u32,
    seed: u64,
    /// Environment steps and wall time \[s\] until the policy was trained from which on no
    /// validation was below the asked success; `None` if the last validation was.
    reached_steps: Option<u64>,
    reached_seconds: Option<f64>,
    /// Environment steps and wall time \[s\] of the whole run.
    steps: u64,
    seconds: f64,
    /// Success in the last validation \[%\].
    success: f64,
    /// Where the worlds run and how updates are divided.
    worlds: String,
    updates: String,
    /// Profile, and what `--set` changes.
    profile: &'static str,
    set: Vec<String>,
    program: Program,
    host: Host,
}

pub(super) fn run(args: &Train) -> anyhow::Result<Verdict> {
    let team = Team::new(Team::alone().ranks, stop_flag()?);
    let runs: Vec<(&String, u64, Resolution)> = args
        .algorithm
        .iter()
        .flat_map(|name| (0..u64::from(args.seeds)).map(move |seed| (name, seed)))
        .map(|(name, seed)| Ok((name, seed, args.layers(name, seed)?.resolve()?)))
        .collect::<anyhow::Result<_>>()?;
    if !args.json {
        let (host, program) = (Host::current(), Program::current());
        let processor = host.processor.as_deref().unwrap_or("unknown processor");
        tell!(
            "{} cores of {processor}, iwol {}, SUMO {}, libtorch {}",
            host.cores,
            program.describe(),
            program.sumo,
            program.libtorch
        );
        for (_, _, Resolution { config, place, profile, .. }) in
            runs.iter().filter(|(_, seed, _)| *seed == 0)
        {
            tell!(
                "{}: {}, {} (profile {}){}",
                config.algorithm,
                worlds_of(config, place, 1),
                update_of(config),
                profile.name,
                if args.set.is_empty() {
                    String::new()
                } else {
                    format!(", --set {}", args.set.join(" --set "))
                }
            );
        }
        tell!(
            "{:10} {:>6} {:>4} {:>16} {:>9} {:>12} {:>9} {:>9}",
            "algorithm",
            "agents",
            "seed",
            format!("steps to {} %", args.success),
            "time",
            "all steps",
            "time",
            "success"
        );
    }
    let mut rows: Vec<Row> = Vec::new();
    for (name, seed, resolution) in runs {
        let row = measure(args, seed, resolution, &team)
            .with_context(|| format!("{name} with seed {seed}"))?;
        if team.stop.load(Ordering::Relaxed) {
            return Ok(Verdict::Interrupted);
        }
        if rows.last().is_some_and(|last| last.algorithm != row.algorithm) {
            summarise(&rows, args.json);
            rows.clear();
        }
        row.print(args.json)?;
        rows.push(row);
    }
    summarise(&rows, args.json);
    Ok(Verdict::Good)
}

impl Train {
    /// Returns the settings of a run.
    fn layers(&self, algorithm: &str, seed: u64) -> anyhow::Result<Layers> {
        let place = match &self.environment {
            Some(name) => ("environment", Value::String(name.clone())),
            None => ("scenario", Value::String(self.scenario.display().to_string())),
        };
        let mut flags = vec![
            place,
            ("algorithm", Value::String(algorithm.to_owned())),
            ("seed", Value::Integer(i64::try_from(seed)?)),
        ];
        flags.extend(self.agents.map(|count| ("agents", Value::Integer(count.into()))));
        let profile = Some(Profile::of_this_machine());
        let layers = Layers { profile, sets: self.set.clone(), flags, ..Layers::default() };
        super::refuse_own(&layers)?;
        Ok(layers)
    }
}

/// Trains until the run is solved or has taken all its steps.
fn measure(args: &Train, seed: u64, resolution: Resolution, team: &Team) -> anyhow::Result<Row> {
    let (success, set) = (args.success, &args.set);
    let Resolution { config, place, profile, .. } = resolution;
    let folder = tempfile::tempdir().context("cannot create a temporary folder")?;
    let dir = RunDir::new(folder.path());
    let begin = Instant::now();
    let mut trainer = driving::train_in(config.clone(), &place, None, team)?;
    // Steps and wall time after each iteration.
    let mut times = Vec::new();
    let stop = Arc::clone(&team.stop);
    trainer.run(&dir, &stop, &mut |report: &Report| {
        times.push((report.step, begin.elapsed().as_secs_f64()));
    })?;
    let seconds = begin.elapsed().as_secs_f64();
    let lines = curves::read(&dir.metrics())?;
    let curve = curves::curve(&lines, Along::Steps, SUCCESS, Line::validation);
    let reached = curves::reached_for_good(&curve, success).map(|step| step as u64);
    let at = |step: u64| times.iter().find(|(end, _)| *end >= step).map(|(_, seconds)| *seconds);
    Ok(Row {
        algorithm: config.algorithm.clone(),
        agents: config.agents,
        seed,
        reached_steps: reached,
        reached_seconds: reached.and_then(at),
        steps: trainer.progress().step,
        seconds,
        success: curve.last().map_or(f64::NAN, |(_, success)| *success),
        worlds: worlds_of(&config, &place, 1),
        updates: update_of(&config),
        profile: profile.name,
        set: set.clone(),
        program: Program::current(),
        host: Host::current(),
    })
}

impl Row {
    fn print(&self, json: bool) -> anyhow::Result<()> {
        if json {
            tell!("{}", serde_json::to_string(self)?);
            return Ok(());
        }
        let steps = self.reached_steps.map_or("never".to_owned(), |steps| steps.to_string());
        let time = self.reached_seconds.map_or("-".to_owned(), |s| format!("{s:.1} s"));
        tell!(
            "{:10} {:>6} {:>4} {steps:>16} {time:>9} {:>12} {:>7.1} s {:>7.1} %",
            self.algorithm,
            self.agents,
            self.seed,
            self.steps,
            self.seconds,
            self.success
        );
        Ok(())
    }
}

/// Prints the medians of an algorithm's runs. A run that did not reach the success counts as longer
/// than all others.
fn summarise(rows: &[Row], json: bool) {
    let Some(first) = rows.first().filter(|_| !json && rows.len() > 1) else { return };
    let reached = |of: fn(&Row) -> Option<f64>| {
        let mut values: Vec<f64> =
            rows.iter().map(|row| of(row).unwrap_or(f64::INFINITY)).collect();
        Some(median(&mut values)).filter(|value| value.is_finite())
    };
    let steps = reached(|row| row.reached_steps.map(|steps| steps as f64));
    let time = reached(|row| row.reached_seconds);
    let mut all: Vec<f64> = rows.iter().map(|row| row.seconds).collect();
    tell!(
        "{:10} {:>11} {:>16} {:>9} {:>12} {:>7.1} s",
        first.algorithm,
        "median",
        steps.map_or("never".to_owned(), |steps| format!("{steps:.0}")),
        time.map_or("-".to_owned(), |time| format!("{time:.1} s")),
        "",
        median(&mut all)
    );
}
