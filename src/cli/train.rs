//! `iwol train`

#![cfg(feature = "learn")]

use std::io::IsTerminal as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use anyhow::{Context as _, bail};
use indicatif::{ProgressBar, ProgressStyle};

use crate::checkpoint::Checkpoint;
use crate::config::{self, Config, Document, PROFILES, Profile, Resolution, TaskSource};
use crate::driving;
use crate::ranks::{self, Ranks, Team};
use crate::sumo::Choice;
use crate::train::{Report, RunDir, TrainingEnd, human_duration};
use crate::words::counted;

use super::config::SettingsArgs;
use super::{Verdict, program, word};

/// Settings in rising priority: defaults, `--profile`, `--preset`, `--config`, `--set`, other flags.
/// The resolved settings are stored in the run folder; `iwol config` prints them without training.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    settings: SettingsArgs,
    /// Run folder [default: runs/SCENARIO/ALGORITHM/seed_N]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Continue from the last checkpoint in the run folder, with the settings stored there.
    #[arg(long)]
    resume: bool,
}

/// Refuses a folder that contains files with the names of a run's files but no run.
fn refuse_strange(dir: &RunDir, config: Option<&Path>) -> anyhow::Result<()> {
    let own = |path: &Path| config.is_some_and(|config| same_file(config, path));
    let strange = |path: &PathBuf| path.exists() && !dir.meta().exists() && !own(path);
    match [dir.config(), dir.scenario(), dir.metrics(), dir.episodes()].into_iter().find(strange) {
        Some(path) => {
            bail!(
                "`{}` already exists and does not belong to a run; choose another --out",
                path.display()
            )
        }
        None => Ok(()),
    }
}

/// Refuses a folder with the history of a run whose checkpoints are gone: validations come with
/// checkpoints.
fn refuse_remains(dir: &RunDir) -> anyhow::Result<()> {
    let history = dir.episodes();
    if std::fs::metadata(&history).is_ok_and(|file| file.len() > 0) {
        bail!(
            "`{}` belongs to a run whose checkpoints are gone; choose another --out, or delete the folder",
            history.display()
        );
    }
    Ok(())
}

/// Returns the scenario's file, or the name of the environment.
fn place_of(config: &Config) -> String {
    if config.environment.is_empty() {
        config.scenario.file.display().to_string()
    } else {
        config.environment.clone()
    }
}

fn same_file(a: &Path, b: &Path) -> bool {
    a.canonicalize().is_ok_and(|a| b.canonicalize().is_ok_and(|b| a == b))
}

pub(super) fn run(args: &Args) -> anyhow::Result<Verdict> {
    let ranks = ranks::of_this_process()?;
    if ranks.size() == 1 {
        return train(args, ranks);
    }
    let end = train(args, Arc::clone(&ranks));
    let known = |error: &anyhow::Error| {
        use crate::train::Error;
        matches!(
            error.downcast_ref(),
            Some(Error::Env(_) | Error::Algorithm(_) | Error::Diverged { .. })
        )
    };
    match &end {
        // All processes have failed together, and end once the first one has written the run.
        Err(error) if known(error) => drop(ranks.all_gather(&[])),
        Err(error) => {
            say!("error: {error:#}");
            ranks.abort();
        }
        Ok(_) => {}
    }
    end
}

/// Returns the profile of the first process's machine, so that all processes have the same
/// settings.
fn common_profile(ranks: &dyn Ranks) -> &'static Profile {
    let own = Profile::of_this_machine();
    let number = PROFILES.iter().position(|profile| profile.name == own.name).unwrap_or(0);
    let numbers = ranks.all_gather(&[number as u8]);
    &PROFILES[usize::from(numbers[0][0])]
}

fn train(args: &Args, ranks: Arc<dyn Ranks>) -> anyhow::Result<Verdict> {
    let given = &args.settings;
    let mut layers = given.layers(common_profile(&*ranks))?;
    if let (None, Some(out), true) = (&given.config, &args.out, args.resume) {
        // A resumed run uses its own settings.
        layers.document = Document::read(&RunDir::new(out).config())?;
    }
    let mut resolution = layers.resolve()?;
    if let Some(why) = resolution.config.cannot_be_trained() {
        bail!(why);
    }
    let first = ranks.rank() == 0;
    for line in config::unread(&given.set, &resolution.config).into_iter().filter(|_| first) {
        say!("{line}");
    }
    let scenario = resolution.place.scenario();
    for line in config::without_effect(&given.set, scenario).into_iter().filter(|_| first) {
        say!("{line}");
    }
    let dir = RunDir::new(args.out.clone().unwrap_or_else(|| {
        PathBuf::from("runs")
            .join(resolution.place.name())
            .join(&resolution.config.algorithm)
            .join(format!("seed_{}", resolution.config.seed))
    }));
    if args.resume && given.config.is_none() && args.out.is_none() {
        // The run folder is known only now; a resumed run uses its own settings.
        layers.document = Document::read(&dir.config())?;
        resolution = layers.resolve()?;
    }
    let replacement = resolution.replacement().filter(|_| args.resume);
    let Resolution { config, place, profile, origins, .. } = resolution;
    for line in config::overruled(&layers, &origins).into_iter().filter(|_| first) {
        say!("{line}");
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
    if !args.resume {
        refuse_remains(&dir)?;
    }
    if args.resume && !dir.last().exists() && dir.best().exists() {
        bail!(
            "`{}` contains a policy, but not the state from which a training continues (checkpoints/last.safetensors); start from the policy with --init-from, and choose another --out",
            dir.path().display()
        );
    }
    if args.resume && !dir.last().exists() {
        bail!(
            "`{}` contains no checkpoint to continue from; a training writes the first one before its first validation. Start it without --resume",
            dir.path().display()
        );
    }
    if args.resume && given.init_from.is_some() {
        bail!("--resume continues with the weights of the run; omit --init-from");
    }
    let fingerprint = place.fingerprint();
    let is_other = args.resume && dir.fingerprint().is_some_and(|was| was != fingerprint);
    if is_other && place.scenario().is_none() {
        bail!("`{}` was started in another environment than {fingerprint}", dir.path().display());
    }
    if is_other {
        bail!(
            "`{}` was started with another scenario, or `{}` or a net or route file that it names has changed since then; resume with \
             the original scenario, or start a new run from this run's policy with --init-from",
            dir.path().display(),
            place_of(&config)
        );
    }
    if !args.resume {
        refuse_strange(&dir, given.config.as_deref())?;
    }
    let (first, size) = (ranks.rank() == 0, ranks.size());
    let _claim = first.then(|| dir.lock()).transpose()?;
    let team = Team::new(ranks, super::stop_flag()?);
    let stop = Arc::clone(&team.stop);
    let mut agents = counted(config.agents, "agent");
    let mut mixed = false;
    if let TaskSource::Scenario(scenario) = &place {
        let learners = scenario.slots(config.agents);
        if learners < config.agents {
            agents = format!("{}, of which {learners} learn", counted(config.agents, "vehicle"));
        }
        mixed = scenario.traffic.is_mixed(config.agents);
    }
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
        driving::train_in(config.clone(), &place, Some(&checkpoint), &team)?
    } else {
        driving::train_in(config.clone(), &place, None, &team)?
    };
    // The first process writes the run. The others, which compute the same, keep what they write to
    // themselves, and say nothing.
    let aside = tempfile::tempdir().context("cannot create a temporary folder")?;
    let dir = if first { dir } else { RunDir::new(aside.path()) };
    super::be_quiet(!first);
    if let Some(change) = changes.first().filter(|_| trainer.is_over()) {
        bail!(
            "`{}` is over after {} steps, so {change} would change nothing; allow more with --steps, or start a new run with --init-from",
            dir.path().display(),
            trainer.progress().step
        );
    }
    let (deployed, all) = trainer.learner().parameters();
    say!(
        "{} on {} with {agents}, seed {}: {} parameters ({} in the deployed policy)",
        config.algorithm,
        place_of(&config),
        config.seed,
        all,
        deployed
    );
    if let Some(line) = replacement {
        say!("{line}");
    }
    for change in changes {
        say!("the run continues with another setting: {change}");
    }
    let hosting = config.hosting();
    let worlds = match &place {
        TaskSource::Scenario(_) if mixed => {
            hosting.alone(config.train.envs).describe(config.train.envs)
        }
        TaskSource::Scenario(_) => hosting.describe(config.train.envs),
        TaskSource::Environment(_) => {
            format!("{} without SUMO", counted(config.train.envs, "world"))
        }
    };
    let ppo = &config.learner.ppo;
    say!(
        "{worlds}, minibatches of {} samples in {} on {}{}",
        ppo.minibatch,
        counted(ppo.shards, "shard"),
        String::from(config.device),
        if args.resume { String::new() } else { format!(" (profile {})", profile.name) }
    );
    let (exploration, annealing) =
        (config.learner.exploration.explore_steps, config.train.anneal_steps);
    if config.steps < exploration + annealing && !args.resume {
        say!(
            "{} steps are fewer than exploration ({exploration}) and annealing ({annealing}) take: the run anneals in its last {}",
            config.steps,
            annealing.min(config.steps / 2)
        );
    }
    if size > 1 {
        say!("{size} processes divide worlds and updates among them");
    }
    if mixed && config.simulation.backend == Choice::Libsumo && config.train.envs > 1 {
        say!(
            "mixed traffic needs a SUMO per world, and libsumo runs one per process: TraCI is used"
        );
    }
    dir.begin_meta(&config, trainer.progress(), &fingerprint, &worlds)?;
    let bar = ProgressBar::new(config.steps);
    bar.set_style(
        ProgressStyle::with_template("{bar:30} {human_pos}/{human_len} steps  {msg}  ETA {eta}")
            .expect("a valid template"),
    );
    bar.set_position(trainer.progress().step);
    bar.reset_eta();
    let terminal = first && std::io::stderr().is_terminal();
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
            format!("; continue with: {} train --resume --out {}", program(), word(dir.path()))
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
        say!("continue with: {} train --resume --out {}", program(), word(dir.path()));
    }
    tell!("{}", dir.path().display());
    Ok(if stop.load(Ordering::Relaxed) { Verdict::Interrupted } else { Verdict::Good })
}
