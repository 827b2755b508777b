//! `iwol train`

#![cfg(feature = "learn")]

use std::io::IsTerminal as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use anyhow::{Context as _, bail};

use crate::checkpoint::Checkpoint;
use crate::config::{
    self, Change, Config, Document, Layers, PROFILES, Profile, Resolution, TaskSource,
};
use crate::driving;
use crate::ranks::{self, Ranks, Team};
use crate::sumo::Choice;
use crate::train::{Report, RunDir, Trainer, TrainingEnd, human_duration};
use crate::words::counted;

use super::config::SettingsArgs;
use super::progress::ProgressView;
use super::work::{is_mixed, update_of, worlds_of};
use super::{Verdict, program, word};

/// Settings in rising priority: defaults, `--profile`, `--preset`, `--config`, `--set`, other
/// flags. The resolved settings are stored in the run folder; `iwol config` prints them without
/// training.
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

/// Refuses a folder that contains files with the names of a run's files but no run. The file of
/// `--config` may lie there if it has what the run would write anyway, as a sweep's does.
fn refuse_strange(dir: &RunDir, given: Option<&Path>, config: &Config) -> anyhow::Result<()> {
    if dir.meta().exists() {
        return Ok(());
    }
    let own = dir.config();
    let is_given = given.is_some_and(|given| same_file(given, &own));
    if is_given && std::fs::read_to_string(&own).is_ok_and(|text| text != config.to_toml()) {
        bail!(
            "the run would replace `{}` by its resolved settings; rename the file, or choose another --out",
            own.display()
        );
    }
    let strange = |path: &PathBuf| path.exists() && !(is_given && *path == own);
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
    let Err(error) = &end else { return end };
    let first = ranks.rank() == 0;
    if known(error) {
        // All processes have failed together. The first one says why, and all end after that.
        super::be_quiet(!first);
        super::say_error(error);
        drop(ranks.all_gather(&[]));
        super::be_quiet(true);
        return end;
    }
    super::be_quiet(false);
    if !first {
        // A wrong setting fails in all processes. The first one says so, and ends the others.
        std::thread::sleep(BEFORE_OTHERS);
    }
    super::say_error(error);
    ranks.abort();
    end
}

/// How long the first process has for its own error before the others print theirs.
const BEFORE_OTHERS: Duration = Duration::from_secs(1);

/// Returns the profile of the first process's machine, so that all processes have the same
/// settings.
fn common_profile(ranks: &dyn Ranks) -> &'static Profile {
    let own = Profile::of_this_machine();
    let number = PROFILES.iter().position(|profile| profile.name == own.name).unwrap_or(0);
    let numbers = ranks.all_gather(&[number as u8]);
    &PROFILES[usize::from(numbers[0][0])]
}

/// Resolves the settings, and returns them with the run folder. A run that is resumed has the
/// settings of its folder.
fn resolved(args: &Args, layers: &mut Layers) -> anyhow::Result<(Resolution, RunDir)> {
    let own_settings = args.resume && args.settings.config.is_none();
    if let (Some(out), true) = (&args.out, own_settings) {
        layers.document = Document::read(&RunDir::new(out).config())?;
    }
    let resolution = layers.resolve()?;
    if let Some(why) = resolution.config.cannot_be_trained() {
        bail!(why);
    }
    if let Some(out) = &args.out {
        return Ok((resolution, RunDir::new(out)));
    }
    let config = &resolution.config;
    let folder = PathBuf::from("runs")
        .join(resolution.place.name())
        .join(&config.algorithm)
        .join(format!("seed_{}", config.seed));
    let dir = RunDir::new(folder);
    if !own_settings {
        return Ok((resolution, dir));
    }
    // The folder is known only now.
    layers.document = Document::read(&dir.config())?;
    Ok((layers.resolve()?, dir))
}

/// Checks that the folder has the run that is to be resumed, or room for a new one.
fn check_folder(
    args: &Args,
    dir: &RunDir,
    config: &Config,
    place: &TaskSource,
) -> anyhow::Result<()> {
    let folder = dir.path().display();
    let (resumable, has_policy) = (dir.last().exists(), dir.best().exists());
    if !args.resume {
        if resumable {
            bail!(
                "`{folder}` already contains a run; add --resume to continue it, or choose another --out"
            );
        }
        if has_policy {
            bail!(
                "`{folder}` contains a policy; start from it with --init-from, and choose another --out"
            );
        }
        refuse_remains(dir)?;
        return refuse_strange(dir, args.settings.config.as_deref(), config);
    }
    if !resumable && has_policy {
        bail!(
            "`{folder}` contains a policy, but not the state from which a training continues (checkpoints/last.safetensors); start from the policy with --init-from, and choose another --out"
        );
    }
    if !resumable {
        bail!(
            "`{folder}` contains no checkpoint to continue from; a training writes the first one before its first validation. Start it without --resume"
        );
    }
    if args.settings.init_from.is_some() {
        bail!("--resume continues with the weights of the run; omit --init-from");
    }
    let fingerprint = place.fingerprint();
    match dir.fingerprint().filter(|was| *was != fingerprint) {
        None => Ok(()),
        Some(_) if place.scenario().is_none() => {
            bail!("`{folder}` was started in another environment than {fingerprint}")
        }
        Some(_) => bail!(
            "`{folder}` was started with another scenario, or `{}` or a net or route file that it names has changed since then; resume with \
             the original scenario, or start a new run from this run's policy with --init-from",
            place_of(config)
        ),
    }
}

/// Returns the trainer of a new run, or of the run in the folder with the settings that have
/// changed since its checkpoint.
fn trainer_of(
    args: &Args,
    dir: &RunDir,
    config: &Config,
    place: &TaskSource,
    team: &Team,
) -> anyhow::Result<(Trainer, Vec<Change>)> {
    if !args.resume {
        return Ok((driving::train_in(config.clone(), place, None, team)?, Vec::new()));
    }
    let checkpoint = Checkpoint::load(&dir.last())?;
    if checkpoint.algorithm != config.algorithm {
        bail!(
            "`{}` is a run of {}, not of {}",
            dir.path().display(),
            checkpoint.algorithm,
            config.algorithm
        );
    }
    let changes = config::changes(&checkpoint.config, &config.to_toml());
    let trainer = driving::train_in(config.clone(), place, Some(&checkpoint), team)?;
    Ok((trainer, changes))
}

/// Says what is trained, where and with which settings that a user may not expect.
fn announce(
    args: &Args,
    resolution: &Resolution,
    trainer: &Trainer,
    changes: &[Change],
    processes: usize,
) {
    let Resolution { config, place, profile, .. } = resolution;
    let learners = place.scenario().map_or(config.agents, |scenario| scenario.slots(config.agents));
    let agents = if learners < config.agents {
        format!("{}, of which {learners} learn", counted(config.agents, "vehicle"))
    } else {
        counted(config.agents, "agent")
    };
    let (deployed, all) = trainer.learner().parameters();
    say!(
        "{} on {} with {agents}, seed {}: {all} parameters ({deployed} in the deployed policy)",
        config.algorithm,
        place_of(config),
        config.seed
    );
    if let Some(line) = resolution.replacement().filter(|_| args.resume) {
        say!("{line}");
    }
    for change in changes {
        say!("the run continues with another setting: {change}");
    }
    say!(
        "{}, {}{}",
        worlds_of(config, place, processes),
        update_of(config),
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
    if processes > 1 {
        say!("{processes} processes divide worlds and updates among them");
    }
    let libsumo = config.simulation.backend == Choice::Libsumo;
    if libsumo && config.train.envs > 1 && is_mixed(config, place) {
        say!(
            "mixed traffic needs a SUMO per world, and libsumo runs one per process: TraCI is used"
        );
    }
}

fn train(args: &Args, ranks: Arc<dyn Ranks>) -> anyhow::Result<Verdict> {
    let (first, processes) = (ranks.rank() == 0, ranks.size());
    let given = &args.settings;
    let mut layers = given.layers(common_profile(&*ranks))?;
    let (resolution, dir) = resolved(args, &mut layers)?;
    let Resolution { config, place, origins, .. } = &resolution;
    let idle = config::unread(&given.set, config)
        .into_iter()
        .chain(config::without_effect(&given.set, place.scenario(), config.agents))
        .chain(config::overruled(&layers, origins));
    for line in idle.filter(|_| first) {
        say!("{line}");
    }
    check_folder(args, &dir, config, place)?;
    let _claim = first.then(|| dir.lock()).transpose()?;
    let team = Team::new(ranks, super::stop_flag()?);
    let stop = Arc::clone(&team.stop);
    let (mut trainer, changes) = trainer_of(args, &dir, config, place, &team)?;
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
    announce(args, &resolution, &trainer, &changes, processes);
    let worlds = worlds_of(config, place, processes);
    dir.begin_meta(config, trainer.progress(), &place.fingerprint(), &worlds)?;
    let terminal = first && std::io::stderr().is_terminal();
    let begun = trainer.progress().step;
    let view = ProgressView::new(config.steps, begun, config.train.envs, terminal);
    let outcome = view.beside(&trainer.activity(), |view| {
        trainer.run(&dir, &stop, &mut |report: &Report| view(report))
    });
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
