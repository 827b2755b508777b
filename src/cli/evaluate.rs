//! `iwol evaluate`

mod arena;
#[cfg(feature = "learn")]
mod setup;
#[cfg(not(feature = "learn"))]
#[path = "evaluate/setup_without_learn.rs"]
mod setup;
mod table;

use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;

use anyhow::{Context as _, bail};
use indicatif::{ProgressBar, ProgressStyle};

use crate::driving::{POLICIES, Policy};
use crate::env::NamedEnvironment;
use crate::evaluate::{Controller, EvaluationObserver};
use crate::metrics::EvaluationResult;
use crate::provenance::Program;
use crate::record;
use crate::replay::{Recorder, Title};
use crate::rng::Seed;

use self::setup::Setup;
use super::Verdict;

/// Beginning of the names of policies from ONNX files.
const ONNX: &str = "onnx:";

/// Policies act deterministically, on seeds that training does not use. Results are means with 95 %
/// intervals.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Run folder (its best checkpoint) or checkpoint file
    #[arg(value_name = "RUN_OR_CHECKPOINT", required_unless_present = "policy")]
    run: Option<PathBuf>,
    /// Policy without a run: throttle:A (constant throttle A in -1..1), pursuit:SPEED (pure
    /// pursuit of the route at SPEED in m/s), fcfs:SPEED (pure pursuit that gives way first come,
    /// first served), gaussian, uniform, sumo, or onnx:FILE (a policy from an ONNX file); may be
    /// repeated
    #[arg(long, value_name = "P")]
    policy: Vec<String>,
    /// Scenario file [default: the run's]
    #[arg(long)]
    scenario: Option<PathBuf>,
    #[arg(long, value_name = "NAME", conflicts_with = "scenario", help = format!("Environment without SUMO, instead of a scenario: {} [default: the run's]", NamedEnvironment::names().join(", ")))]
    environment: Option<String>,
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
    /// One setting of the task, e.g. --set scenario.termination.horizon=500; may be repeated
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

pub(super) fn run(args: &Args) -> anyhow::Result<Verdict> {
    let mut known = Vec::new();
    for name in &args.policy {
        let policy = Policy::by_name(name);
        if policy.is_none() && !name.starts_with(ONNX) {
            bail!(
                "there is no policy `{name}`; choose one of {ONNX}<file>, {} with a in -1..1 and speed in m/s, above 0",
                POLICIES.join(", ")
            );
        }
        known.push((name.clone(), policy));
    }
    if args.run.is_none() && args.scenario.is_none() && args.environment.is_none() {
        bail!("--policy without a run also needs --scenario or --environment");
    }
    let setup = Setup::new(args)?;
    let models = args.policy.iter().filter_map(|name| name.strip_prefix(ONNX));
    let models: Vec<Box<dyn Controller>> =
        models.map(|file| setup.model(Path::new(file))).collect::<anyhow::Result<_>>()?;
    let mut next = models.iter();
    let mut policies: Vec<(String, Policy<'_>)> = Vec::new();
    for (name, policy) in known {
        let model = || Policy::Learned(&**next.next().expect("a model for each name"));
        policies.push((name, policy.unwrap_or_else(model)));
    }
    let arena = &setup.arena;
    for (name, policy) in &policies {
        arena.check(name, policy)?;
    }
    if let Some(line) = arena.left_out() {
        say!("{line}");
    }
    let trained = setup.controller();
    if let Some((name, controller)) = &trained {
        policies.insert(0, ((*name).to_owned(), Policy::Learned(&**controller)));
    }
    let of_run = |number: usize| trained.is_some() && number == 0;

    if args.record_episode >= args.episodes {
        bail!(
            "--record-episode {}: there is no such episode; allowed: 0 to {}",
            args.record_episode,
            args.episodes - 1
        );
    }
    if args.episodes < 2 && setup.is_shuffled() {
        bail!(
            "--episodes {}: with channel.shuffled, agents hear those of another episode; allowed: 2 or more",
            args.episodes
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
    if let Some(path) = args.out.as_ref().filter(|path| record::is_other_than::<Earlier>(path)) {
        bail!(
            "--out {}: the file exists and is no earlier result of `iwol evaluate`; choose another file",
            path.display()
        );
    }
    let recording = args.record.as_ref();
    if let Some(path) = recording.filter(|path| record::is_other_than::<EarlierRecording>(path)) {
        bail!(
            "--record {}: the file exists and is no earlier recording; choose another file",
            path.display()
        );
    }
    if let (Some(path), Some(record)) = (&args.out, &args.record)
        && record::is_same_file(path, record)
    {
        bail!("--out and --record are both {}; choose two different files", path.display());
    }
    let stop = super::stop_flag()?;
    let program = Program::current();
    let mut rows = Vec::new();
    let mut recorded = None;
    // What ended the work before all policies were evaluated.
    let mut end = None;
    for (number, (name, policy)) in policies.iter().enumerate() {
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
            .filter(|_| number == 0)
            .map(|_| Recorder::new(arena.spec(), args.record_episode));
        let mut show = |done| bar.set_position(done);
        let observer = EvaluationObserver {
            stop: &stop,
            report: &mut show,
            recorder: recorder.as_mut(),
            beside: false,
        };
        let evaluation = arena
            .evaluate(policy, args.episodes, seed, observer)
            .with_context(|| format!("the evaluation of {name} failed"));
        bar.finish_and_clear();
        let evaluation = match evaluation {
            Ok(evaluation) => evaluation,
            Err(error) => {
                end = Some(Err(error));
                break;
            }
        };
        if stop.load(Ordering::Relaxed) {
            say!(
                "interrupted after {} of {} episodes of {name}",
                evaluation.episodes.len(),
                args.episodes
            );
            end = Some(Ok(Verdict::Interrupted));
            break;
        }
        if let (Some(recorder), Some(path)) = (recorder, &args.record) {
            let record =
                evaluation.episodes.iter().find(|record| record.episode == args.record_episode);
            let driver = args
                .run
                .as_ref()
                .map_or_else(|| name.clone(), |run| format!("{name} ({})", run.display()));
            let title = Title { environment: &setup.scenario, policy: &driver, seed: args.seed };
            let recording = recorder.finish(&arena.backdrop()?, &title, record);
            let why = match record {
                Some(record) if !record.interrupted => {
                    "there is nothing to record: the environment returns no `picture`"
                }
                _ => "the recorded episode did not reach its end",
            };
            recorded = Some((recording.context(why)?, path));
        }
        let metrics = evaluation.metrics().context("no episode finished")?;
        rows.push(EvaluationResult {
            scenario: setup.scenario.clone(),
            fingerprint: Some(setup.fingerprint.clone()),
            agents: setup.agents,
            audited: arena.is_audited(),
            learners: arena.learners(setup.agents),
            policy: name.clone(),
            episodes: args.episodes,
            seed: args.seed,
            checkpoint: setup.checkpoint.clone().filter(|_| of_run(number)),
            set: args.set.clone(),
            program: program.clone(),
            run: setup.training.clone().filter(|_| of_run(number)),
            metrics,
            failed_episodes: evaluation.failed_episodes(),
        });
    }
    if let Some(end) = end.take_if(|_| rows.is_empty()) {
        return end;
    }
    let json = match &rows[..] {
        [row] => serde_json::to_string(row)?,
        rows => serde_json::to_string(rows)?,
    };
    if args.json {
        tell!("{json}");
    } else {
        super::print(format_args!("{}", table::table(&rows)));
    }
    // Results are printed first, so that they are shown even if the files cannot be written.
    if let Some(path) = &args.out {
        record::write_atomic(path, json.as_bytes())?;
    }
    if let Some((recording, path)) = recorded {
        recording.save(path)?;
    }
    end.unwrap_or(Ok(Verdict::Good))
}

/// What `--out` may replace.
#[derive(serde::Deserialize)]
#[serde(untagged)]
#[allow(dead_code, reason = "only whether a file can be read as one matters")]
enum Earlier {
    One(Box<EvaluationResult>),
    Several(Vec<EvaluationResult>),
}

/// What `--record` may replace: the parts of a recording of any version.
#[derive(serde::Deserialize)]
#[allow(dead_code, reason = "only whether a file can be read as one matters")]
struct EarlierRecording {
    format: u32,
    columns: serde::de::IgnoredAny,
    status: serde::de::IgnoredAny,
}
