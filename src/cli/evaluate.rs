//! `iwol evaluate`

#[cfg(feature = "learn")]
mod setup;
#[cfg(not(feature = "learn"))]
#[path = "evaluate/setup_without_learn.rs"]
mod setup;

use std::fmt::Write as _;
use std::path::PathBuf;
use std::sync::atomic::Ordering;

use anyhow::{Context as _, bail};
use indicatif::{ProgressBar, ProgressStyle};
use iwol_sumo::evaluate::{
    BackgroundSummary, DETERMINED, EvaluationObserver, Knowledge, Metrics, POLICIES, Policy,
    evaluate,
};
use iwol_sumo::provenance::{Program, Training};
use iwol_sumo::record;
use iwol_sumo::replay::Recorder;
use iwol_sumo::rng::Seed;
use iwol_sumo::stats::Estimate;
use serde::Serialize;

use self::setup::Setup;
use super::Verdict;

/// Policies act deterministically, on seeds that training does not use. Results are means with 95 %
/// intervals.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Run folder (its best checkpoint) or checkpoint file
    #[arg(value_name = "RUN_OR_CHECKPOINT", required_unless_present = "policy")]
    run: Option<PathBuf>,
    /// Policy without training: throttle:A (constant throttle A in -1..1), pursuit:SPEED (pure
    /// pursuit of the route at SPEED in m/s), fcfs:SPEED (pure pursuit that gives way first come,
    /// first served), gaussian, uniform or sumo; may be repeated
    #[arg(long, value_name = "P")]
    policy: Vec<String>,
    /// Scenario file [default: the run's]
    #[arg(long, required_unless_present = "run")]
    scenario: Option<PathBuf>,
    /// Number of vehicles [default: the run's, or the scenario's]
    #[arg(long)]
    agents: Option<u32>,
    /// Episodes per policy
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u64).range(1..))]
    episodes: u64,
    /// Seed of the evaluation's episodes
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Device on which the networks are computed; may differ from the device of training
    #[arg(long, value_name = "cpu|cuda", default_value = "cpu")]
    device: String,
    /// Interface to SUMO; results do not depend on it
    #[arg(long, value_name = "auto|traci|libsumo")]
    backend: Option<String>,
    /// One setting of the task, e.g. --set env.detection_range=20; may be repeated
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Record an episode of the first policy, for `iwol replay`
    #[arg(long, value_name = "FILE")]
    record: Option<PathBuf>,
    /// Index of the episode to record; the first episode is 0
    #[arg(long, value_name = "NUMBER", default_value_t = 0, requires = "record")]
    record_episode: u64,
    /// Print one JSON object (a list for several policies) instead of a table
    #[arg(long)]
    json: bool,
    /// Also write the JSON to this file
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

/// One evaluated policy, as printed with `--json`.
#[derive(Debug, Serialize)]
struct Row {
    scenario: String,
    agents: u32,
    /// Number of vehicles that the policy controls; present only if SUMO drives some of the
    /// vehicles at start places.
    #[serde(skip_serializing_if = "Option::is_none")]
    learners: Option<usize>,
    /// Whether SUMO checked for collisions inside junctions as well (`simulation.audit`).
    #[serde(skip)]
    audited: bool,
    policy: String,
    episodes: u64,
    seed: u64,
    /// File name of the checkpoint; present only for a learned policy.
    #[serde(skip_serializing_if = "Option::is_none")]
    checkpoint: Option<String>,
    /// The values of `--set`, in order.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    set: Vec<String>,
    /// The program that evaluated the policy.
    program: Program,
    /// Provenance of the training; present only for a learned policy.
    #[serde(skip_serializing_if = "Option::is_none")]
    run: Option<Training>,
    metrics: Metrics,
}

pub(super) fn run(args: &Args) -> anyhow::Result<Verdict> {
    let mut policies = Vec::new();
    for name in &args.policy {
        let policy = Policy::by_name(name).with_context(|| {
            format!(
                "there is no policy `{name}`; choose one of {} with a in -1..1 and speed in m/s, above 0",
                POLICIES.join(", ")
            )
        })?;
        policies.push((name.clone(), policy));
    }
    let setup = Setup::new(args)?;
    let Setup { task, hosting, .. } = &setup;
    let trained = setup.controller();
    if let Some((name, controller)) = &trained {
        policies.insert(0, ((*name).to_owned(), Policy::Learned(&**controller)));
    }

    if args.record_episode >= args.episodes {
        bail!(
            "--record-episode {}: there is no such episode; allowed: 0 to {}",
            args.record_episode,
            args.episodes - 1
        );
    }
    for path in [&args.out, &args.record].into_iter().flatten() {
        record::check_writable(path)?;
    }
    for (flag, path) in [("out", &args.out), ("record", &args.record)] {
        if let Some(path) =
            path.as_ref().filter(|path| path.extension().is_some_and(|end| end == "safetensors"))
        {
            bail!(
                "--{flag} {}: names that end in .safetensors are reserved for checkpoints",
                path.display()
            );
        }
    }
    if let Some(path) = args.out.as_ref().filter(|_| args.out == args.record) {
        bail!("--out and --record are both {}; choose two different files", path.display());
    }
    let stop = super::stop_flag()?;
    let program = Program::current();
    let mut rows = Vec::new();
    let mut recorded = None;
    for (name, policy) in &policies {
        let bar = ProgressBar::new(args.episodes);
        bar.set_style(
            ProgressStyle::with_template("{msg} {bar:30} {pos}/{len} episodes  ETA {eta}")
                .expect("a valid template"),
        );
        bar.set_message(name.clone());
        let seed = Seed::new(args.seed).child("evaluation");
        let mut recorder = args
            .record
            .as_ref()
            .filter(|_| rows.is_empty())
            .map(|_| Recorder::new(task, args.record_episode));
        let mut show = |done| bar.set_position(done);
        let observer =
            EvaluationObserver { stop: &stop, report: &mut show, recorder: recorder.as_mut() };
        let evaluation = evaluate(task, policy, args.episodes, seed, hosting, observer)
            .with_context(|| format!("the evaluation of {name} failed"))?;
        bar.finish_and_clear();
        if stop.load(Ordering::Relaxed) {
            say!(
                "interrupted after {} of {} episodes of {name}",
                evaluation.episodes.len(),
                args.episodes
            );
            return Ok(Verdict::Interrupted);
        }
        if let (Some(recorder), Some(path)) = (recorder, &args.record) {
            let record =
                evaluation.episodes.iter().find(|record| record.episode == args.record_episode);
            let driver = args
                .run
                .as_ref()
                .map_or_else(|| name.clone(), |run| format!("{name} ({})", run.display()));
            let recording = recorder.finish(task, &driver, args.seed, record)?;
            recorded =
                Some((recording.context("the recorded episode did not reach its end")?, path));
        }
        let metrics = evaluation.metrics().context("no episode finished")?;
        rows.push(Row {
            scenario: setup.scenario.clone(),
            agents: setup.agents,
            audited: hosting.audit,
            learners: (task.agents < setup.agents as usize).then_some(task.agents),
            policy: name.clone(),
            episodes: args.episodes,
            seed: args.seed,
            checkpoint: setup.checkpoint.clone().filter(|_| matches!(policy, Policy::Learned(_))),
            set: args.set.clone(),
            program: program.clone(),
            run: setup.training.clone().filter(|_| matches!(policy, Policy::Learned(_))),
            metrics,
        });
    }
    let json = match &rows[..] {
        [row] => serde_json::to_string(row)?,
        rows => serde_json::to_string(rows)?,
    };
    if args.json {
        tell!("{json}");
    } else {
        super::print(format_args!("{}", table(&rows)));
    }
    // Results are printed first, so that they are shown even if the files cannot be written.
    if let Some(path) = &args.out {
        record::write_atomic(path, json.as_bytes())?;
    }
    if let Some((recording, path)) = recorded {
        recording.save(path)?;
    }
    Ok(Verdict::Good)
}

/// A function that formats one metric.
type Cell<'a> = &'a dyn Fn(&Metrics) -> String;

/// Formats a metric of background traffic and pedestrians; a dash if there was none.
fn others(
    metrics: &Metrics,
    of: fn(&BackgroundSummary) -> Option<Estimate>,
    write: fn(&Estimate) -> String,
) -> String {
    metrics.others.as_ref().and_then(of).as_ref().map_or_else(|| "–".to_owned(), write)
}

/// Describes how much of the variance of a target a latent explains: of the whole target, and of
/// the features that the observation does not determine.
fn describe(Knowledge { name, error, explained, probe }: &Knowledge) -> String {
    let percent = |share: f64| format!("{:.1} %", 100.0 * share);
    let whole = format!(
        "{} of the variance of the {name} target (mean squared error {error:.4})",
        percent(*explained)
    );
    let Some(probe) = probe else {
        return format!(
            "{whole}; there are too few episodes for a linear probe from the observation"
        );
    };
    let (Some(own), Some(probed)) =
        (probe.undetermined_explained, probe.undetermined_probe_explained)
    else {
        return format!("{whole}; the observation determines all {} features", probe.features);
    };
    format!(
        "{whole}; the observation does not determine {} of {} features (a linear probe from the observation explains less \
         than {:.0} % of their variance): of the variance of these features, the latent explains {} and the probe {}",
        probe.undetermined,
        probe.features,
        100.0 * DETERMINED,
        percent(own),
        percent(probed)
    )
}

/// Formats all policies side by side: one metric per line, with mean and 95 % interval per policy.
fn table(rows: &[Row]) -> String {
    let percent: fn(&Estimate) -> String =
        |e| Estimate { mean: 100.0 * e.mean, low: 100.0 * e.low, high: 100.0 * e.high }.to_string();
    let number: fn(&Estimate) -> String = Estimate::to_string;
    let fine: fn(&Estimate) -> String = |e| format!("{e:.3}");
    let kilometres: fn(&Metrics) -> String =
        |m| m.km_per_crash.map_or_else(|| "–".to_owned(), |k| format!("{:.2}", k.estimate));
    let of_agents: [(&str, Cell<'_>); 12] = [
        ("success %", &|m| percent(&m.success)),
        ("safety %", &|m| percent(&m.safety)),
        ("crash %", &|m| percent(&m.crash)),
        ("off-road %", &|m| percent(&m.out_of_road)),
        ("reward", &|m| number(&m.reward)),
        ("window reward (throughput)", &|m| number(&m.window_reward)),
        ("episode length", &|m| number(&m.episode_length)),
        ("efficiency", &|m| fine(&m.efficiency)),
        ("collisions", &|m| fine(&m.own_collisions)),
        ("SUMO collisions", &|m| fine(&m.sumo_collisions)),
        ("km per crash", &kilometres),
        ("loitering %", &|m| percent(&m.loitering)),
    ];
    let of_vehicles: [(&str, Cell<'_>); 6] = [
        ("background vehicles", &|m| others(m, |o| Some(o.vehicles), number)),
        ("background crash %", &|m| others(m, |o| o.crash, percent)),
        ("background delay s", &|m| others(m, |o| o.delay, number)),
        ("background braking m/s²", &|m| others(m, |o| o.braking, number)),
        ("background hard braking %", &|m| others(m, |o| o.hard_braking, percent)),
        ("background TTC < 1.5 s %", &|m| others(m, |o| o.close, percent)),
    ];
    let of_pedestrians: [(&str, Cell<'_>); 3] = [
        ("pedestrians", &|m| others(m, |o| Some(o.pedestrians), number)),
        ("pedestrians hit %", &|m| others(m, |o| o.pedestrian_crash, percent)),
        ("pedestrian TTC < 1.5 s %", &|m| others(m, |o| o.pedestrian_close, percent)),
    ];
    let of_both: [(&str, Cell<'_>); 2] = [
        ("smallest TTC s", &|m| others(m, |o| o.ttc, fine)),
        ("smallest PET s", &|m| others(m, |o| o.pet, fine)),
    ];
    let any = |of: fn(&BackgroundSummary) -> f64| {
        rows.iter().any(|row| row.metrics.others.as_ref().is_some_and(|others| of(others) > 0.0))
    };
    let (driven, walked) = (any(|o| o.vehicles.mean), any(|o| o.pedestrians.mean));
    let mut lines = of_agents.to_vec();
    lines.extend(of_vehicles.iter().filter(|_| driven));
    lines.extend(of_pedestrians.iter().filter(|_| walked));
    lines.extend(of_both.iter().filter(|_| driven || walked));
    let mut columns: Vec<Vec<String>> =
        vec![std::iter::once(String::new()).chain(lines.iter().map(|l| l.0.to_owned())).collect()];
    for row in rows {
        columns.push(
            std::iter::once(row.policy.clone())
                .chain(lines.iter().map(|l| (l.1)(&row.metrics)))
                .collect(),
        );
    }
    let width =
        |column: &[String]| column.iter().map(|cell| cell.chars().count()).max().unwrap_or(0);
    let mut text = String::new();
    if let Some(first) = rows.first() {
        let _ = writeln!(
            text,
            "{}, {}, {} episodes, seed {}: mean [95 % interval]",
            first.scenario,
            first.learners.map_or_else(
                || format!("{} agents", first.agents),
                |learners| format!(
                    "{learners} agents among {} vehicles at spawn places",
                    first.agents
                )
            ),
            first.episodes,
            first.seed
        );
    }
    for line in 0..=lines.len() {
        for (i, column) in columns.iter().enumerate() {
            let (cell, width) = (&column[line], width(column));
            let _ = if i == 0 {
                write!(text, "{cell:<width$}")
            } else {
                write!(text, "   {cell:>width$}")
            };
        }
        text.push('\n');
    }
    for row in rows.iter().filter(|row| !row.metrics.reconstruction.is_empty()) {
        for known in &row.metrics.reconstruction {
            let _ = writeln!(text, "latent of {}: explains {}", row.policy, describe(known));
        }
    }
    for row in rows {
        for line in row.metrics.failures.describe() {
            let _ = writeln!(text, "failures of {}: {line}", row.policy);
        }
    }
    for row in rows {
        let audit = &row.metrics.audit;
        if audit.differences().is_empty() {
            continue;
        }
        if !row.audited {
            let _ = writeln!(
                text,
                "audit of {}: none, because SUMO did not check for collisions in junctions (simulation.audit)",
                row.policy
            );
            continue;
        }
        let _ = writeln!(
            text,
            "audit of {}: {:>5} colliding pairs are in both reports",
            row.policy, audit.agreed
        );
        let indent = "audit of : ".len() + row.policy.chars().count();
        for (reason, count) in audit.differences() {
            let _ = writeln!(text, "{:indent$}{count:>5} {reason}", "");
        }
    }
    text
}
