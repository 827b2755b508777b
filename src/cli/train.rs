//! `iwol train`

use std::io::IsTerminal as _;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use anyhow::{Context as _, bail};
use indicatif::{ProgressBar, ProgressStyle};
use iwol_sumo::algo;
use iwol_sumo::checkpoint::Checkpoint;
use iwol_sumo::config::{self, Config, Document, Layers};
use iwol_sumo::train::{Report, RunDir, Trainer, TrainingEnd, human_duration};
use toml::Value;

use super::Verdict;

/// Settings have rising priority in this order: defaults, `--config`, `--set`, other options. The
/// resolved settings are stored in the run folder.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Scenario file, e.g. scenarios/intersection.xml.
    #[arg(long)]
    scenario: Option<PathBuf>,
    /// Learning algorithm.
    #[arg(long, value_name = "NAME", help = format!("Learning algorithm: {}", algo::NAMES.join(", ")))]
    algorithm: Option<String>,
    /// Number of vehicles at spawn places, which are all agents unless env.penetration is below 1
    /// [default: the scenario's].
    #[arg(long)]
    agents: Option<u32>,
    /// Seed of all random numbers [default: 0].
    #[arg(long)]
    seed: Option<u64>,
    /// Maximum number of environment steps of all worlds together, rounded up to whole rollouts.
    #[arg(long)]
    steps: Option<u64>,
    /// Start from the weights in a run folder or checkpoint of the same algorithm. The number of
    /// agents may differ, except with CommFormer.
    #[arg(long, value_name = "CHECKPOINT")]
    init_from: Option<PathBuf>,
    /// Device on which the networks are computed [default: cpu].
    #[arg(long, value_name = "cpu|cuda")]
    device: Option<String>,
    /// Interface to SUMO, on which results do not depend [default: auto].
    #[arg(long, value_name = "auto|traci|libsumo")]
    backend: Option<String>,
    /// TOML file with settings, e.g. the config.toml of a run folder.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// One setting, e.g. --set ppo.gamma=0.995. The option may be repeated.
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Run folder [default: runs/SCENARIO/ALGORITHM/seed_N].
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Continue from the last checkpoint in the run folder, with the settings stored there.
    #[arg(long)]
    resume: bool,
}

impl Args {
    fn flags(&self) -> anyhow::Result<Vec<(&'static str, Value)>> {
        let integer = |v: u64| {
            i64::try_from(v)
                .map(Value::Integer)
                .with_context(|| format!("{v} is too large, allowed: numbers below 2^63"))
        };
        let number = |value: Option<u64>| value.map(integer).transpose();
        let text = |value: &Option<String>| value.clone().map(Value::String);
        let path = |value: &Option<PathBuf>| {
            value.as_ref().map(|path| Value::String(path.display().to_string()))
        };
        let flags = [
            ("scenario", path(&self.scenario)),
            ("algorithm", text(&self.algorithm)),
            ("agents", number(self.agents.map(u64::from))?),
            ("seed", number(self.seed)?),
            ("init_from", path(&self.init_from)),
            ("device", text(&self.device)),
            ("simulation.backend", text(&self.backend)),
            ("steps", number(self.steps)?),
        ];
        Ok(flags.into_iter().filter_map(|(key, value)| Some((key, value?))).collect())
    }
}

/// Refuses a folder that contains files with the names of a run's files but no run.
fn refuse_strange(dir: &RunDir, config: Option<&Path>) -> anyhow::Result<()> {
    let own = |path: &Path| config.is_some_and(|config| same_file(config, path));
    let strange = |path: &PathBuf| path.exists() && !dir.meta().exists() && !own(path);
    match [dir.config(), dir.metrics(), dir.episodes()].into_iter().find(strange) {
        Some(path) => {
            bail!(
                "`{}` already exists and does not belong to a run; choose another --out",
                path.display()
            )
        }
        None => Ok(()),
    }
}

fn same_file(a: &Path, b: &Path) -> bool {
    a.canonicalize().is_ok_and(|a| b.canonicalize().is_ok_and(|b| a == b))
}

pub(super) fn run(args: &Args) -> anyhow::Result<Verdict> {
    let document = match (&args.config, &args.out) {
        (Some(path), _) => Document::read(path)?,
        // A resumed run uses its own settings.
        (None, Some(out)) if args.resume => Document::read(&RunDir::new(out).config())?,
        _ => Document::default(),
    };
    let mut layers = Layers { document, sets: args.set.clone(), flags: args.flags()? };
    let (mut config, mut scenario) = Config::resolve(&layers)?;
    if let Some(why) = config.cannot_be_trained() {
        bail!(why);
    }
    let dir = RunDir::new(args.out.clone().unwrap_or_else(|| {
        PathBuf::from("runs")
            .join(&scenario.name)
            .join(&config.algorithm)
            .join(format!("seed_{}", config.seed))
    }));
    if args.resume && args.config.is_none() && args.out.is_none() {
        // The run folder is known only now; a resumed run uses its own settings.
        layers.document = Document::read(&dir.config())?;
        (config, scenario) = Config::resolve(&layers)?;
    }
    if !args.resume && dir.last().exists() {
        bail!(
            "`{}` already contains a run; add --resume to continue it, or choose another --out",
            dir.path().display()
        );
    }
    if !args.resume && dir.best().exists() {
        bail!(
            "`{}` contains a policy; start from it with --init-from, and choose another --out",
            dir.path().display()
        );
    }
    if args.resume && args.init_from.is_some() {
        bail!("--resume continues with the weights of the run; omit --init-from");
    }
    let fingerprint = scenario.fingerprint();
    if args.resume && dir.fingerprint().is_some_and(|was| was != fingerprint) {
        bail!(
            "`{}` was started with another scenario, or `{}` or a net or route file that it names has changed since then; resume with \
             the original scenario, or start a new run from this run's policy with --init-from",
            dir.path().display(),
            config.scenario.display()
        );
    }
    if !args.resume {
        refuse_strange(&dir, args.config.as_deref())?;
    }
    let _claim = dir.lock()?;
    let stop = super::stop_flag()?;
    let learners = scenario.traffic.learners(config.agents);
    let vehicles = if learners < config.agents {
        format!("{} vehicles, of which {learners} learn", config.agents)
    } else {
        format!("{} agents", config.agents)
    };
    let mixed = scenario.traffic.is_mixed(config.agents);
    let mut changes = Vec::new();
    let mut trainer = if args.resume {
        let checkpoint = Checkpoint::load(&dir.last())?;
        if checkpoint.algorithm != config.algorithm {
            bail!(
                "`{}` is a run of {}, not of {}",
                dir.path().display(),
                checkpoint.algorithm,
                config.algorithm
            );
        }
        changes = config::changes(&checkpoint.config, &config.to_toml());
        Trainer::resume(config.clone(), scenario, &checkpoint)?
    } else {
        Trainer::new(config.clone(), scenario)?
    };
    let (deployed, all) = trainer.learner().parameters();
    say!(
        "{} on {} with {vehicles}, seed {}: {} parameters ({} in the deployed policy)",
        config.algorithm,
        config.scenario.display(),
        config.seed,
        all,
        deployed
    );
    for change in changes {
        say!("the run continues with another setting: {change}");
    }
    let hosting = config.hosting();
    let worlds =
        if mixed { hosting.alone(config.train.envs) } else { hosting }.describe(config.train.envs);
    say!("{worlds}");
    dir.begin_meta(&config, trainer.progress(), &fingerprint, &worlds)?;
    let bar = ProgressBar::new(config.steps);
    bar.set_style(
        ProgressStyle::with_template("{bar:30} {human_pos}/{human_len} steps  {msg}  ETA {eta}")
            .expect("a valid template"),
    );
    bar.set_position(trainer.progress().step);
    bar.reset_eta();
    let terminal = std::io::stderr().is_terminal();
    let mut last_line = Instant::now();
    let outcome = trainer.run(&dir, &stop, &mut |report: &Report| {
        let percent = |share: Option<f64>| {
            share.map_or_else(|| "-".to_owned(), |s| format!("{:.1} %", 100.0 * s))
        };
        let message = format!(
            "{:.0} steps/s  success {} (validation {})",
            report.steps_per_second,
            percent(report.training_success),
            percent(report.validation_success)
        );
        if terminal {
            bar.set_position(report.step);
            bar.set_message(message);
        } else if last_line.elapsed() > Duration::from_secs(10) || report.step >= config.steps {
            last_line = Instant::now();
            say!("{:>9} steps  {message}", report.step);
        }
    });
    bar.finish_and_clear();
    let outcome = outcome.with_context(|| {
        let kept = if dir.last().exists() {
            format!("; continue with: iwol train --resume --out {}", dir.path().display())
        } else {
            String::new()
        };
        format!(
            "training {} stopped after {} steps{kept}",
            config.algorithm,
            trainer.progress().step
        )
    })?;
    let progress = trainer.progress();
    let end = match outcome {
        TrainingEnd::Finished => "finished",
        TrainingEnd::Solved => "stopped early (solved)",
        TrainingEnd::Interrupted => "interrupted",
    };
    say!(
        "{end} after {} steps in {}; best validation success {}",
        progress.step,
        human_duration(Duration::try_from_secs_f64(progress.seconds).unwrap_or_default()),
        progress
            .best
            .map_or_else(|| "-".to_owned(), |(success, _)| format!("{:.1} %", 100.0 * success)),
    );
    if outcome == TrainingEnd::Interrupted {
        say!("continue with: iwol train --resume --out {}", dir.path().display());
    }
    tell!("{}", dir.path().display());
    Ok(if stop.load(Ordering::Relaxed) { Verdict::Interrupted } else { Verdict::Good })
}
