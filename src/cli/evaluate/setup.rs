//! The task and the trained policy that the command line of `iwol evaluate` names.

use std::path::Path;
use std::sync::Arc;

use anyhow::bail;
use toml::Value;

use crate::algo::{self, Algorithm, Channel};
use crate::checkpoint::Checkpoint;
use crate::config::{self, Config, Document, Layers, Resolution, TaskSource};
use crate::env::{EnvSpec, Task};
use crate::evaluate::{Controller, LearnedPolicy, OnnxPolicy};
use crate::provenance::Training;
use crate::rng::Seed;
use crate::scenario::Scenario;
use crate::train::RunDir;

use super::Args;
use super::arena::Arena;

/// The task of an evaluation, and the trained policy if there is one.
pub(super) struct Setup {
    pub(super) arena: Arena,
    /// Name of the scenario.
    pub(super) scenario: String,
    /// [`TaskSource::fingerprint`] of the task.
    pub(super) fingerprint: String,
    /// Number of vehicles at spawn places.
    pub(super) agents: u32,
    /// File name of the trained policy's checkpoint.
    pub(super) checkpoint: Option<String>,
    /// Provenance of the trained policy.
    pub(super) training: Option<Training>,
    learned: Option<(Box<dyn Algorithm>, Channel)>,
}

impl Setup {
    pub(super) fn new(args: &Args) -> anyhow::Result<Self> {
        if let Some(why) = args.set.iter().find_map(|set| config::no_matter_of_evaluation(set)) {
            bail!("--set {why}");
        }
        let checkpoint = args.run.as_deref().map(checkpoint_of).transpose()?;
        let mut layers = Layers { sets: args.set.clone(), ..Layers::default() };
        if let (Some(checkpoint), Some(run)) = (&checkpoint, &args.run) {
            layers.document = Document::of_run(
                format!("{} (stored settings)", run.display()),
                checkpoint.config.clone(),
            );
        }
        if let Some(path) = &args.scenario {
            layers.flags.push(("scenario", Value::String(path.display().to_string())));
        }
        if let Some(agents) = args.agents {
            layers.flags.push(("agents", Value::Integer(agents.into())));
        }
        if let Some(name) = &args.environment {
            layers.flags.push(("environment", Value::String(name.clone())));
        }
        layers.flags.push(("device", Value::String(args.device.clone())));
        if let Some(backend) = &args.backend {
            layers.flags.push(("simulation.backend", Value::String(backend.clone())));
        }
        let resolution = layers.resolve()?;
        let replacement = resolution.replacement();
        let Resolution { config, place, origins, .. } = resolution;
        for line in config::overruled(&layers, &origins) {
            say!("{line}");
        }
        let onnx = args.policy.iter().any(|name| name.starts_with(super::ONNX));
        if onnx && args.set.iter().any(|set| set.trim_start().starts_with("channel.")) {
            bail!(
                "an ONNX file contains the policy without a channel, so that settings of `channel` have no effect on it: evaluate the run instead, or omit these settings"
            );
        }
        if checkpoint.is_some() {
            for line in config::unread(&args.set, &config) {
                say!("{line}");
            }
        }
        if checkpoint.is_none() {
            // An ONNX file contains its policy's settings.
            let of_task =
                |key: &str| ["scenario", "simulation", "environment", "agents"].contains(&key);
            for set in &args.set {
                let group = set.split(['=', '.']).next().unwrap_or_default().trim();
                if !of_task(group) {
                    say!("--set {set} has no effect: no policy of a run is evaluated");
                }
            }
        }
        for line in config::without_effect(&args.set, place.scenario(), config.agents) {
            say!("{line}");
        }
        let run = args.run.as_deref().and_then(RunDir::of);
        if let (Some(run), Some(checkpoint)) = (&run, &checkpoint) {
            tell_edits(run, &checkpoint.config);
        }
        if let (Some(run), TaskSource::Scenario(scenario)) = (&run, &place) {
            tell_changes(args, run, scenario, replacement);
        }
        let arena = match &place {
            TaskSource::Scenario(scenario) => Arena::Roads {
                task: Arc::new(Task::new(scenario, config.agents)?),
                hosting: config.hosting(),
            },
            TaskSource::Environment(named) => Arena::Other(named.environment()),
        };
        let learned = match &checkpoint {
            Some(checkpoint) => Some((build(checkpoint, &config, arena.spec())?, config.channel)),
            None => None,
        };
        Ok(Self {
            arena,
            scenario: place.name().to_owned(),
            fingerprint: place.fingerprint(),
            agents: config.agents,
            checkpoint: args
                .run
                .as_deref()
                .map(RunDir::checkpoint)
                .and_then(|path| Some(path.file_name()?.to_string_lossy().into_owned())),
            training: args
                .run
                .as_deref()
                .map(|path| RunDir::of(path).and_then(|run| run.training()).unwrap_or_default()),
            learned,
        })
    }

    /// Returns the trained policy and its name.
    pub(super) fn controller(&self) -> Option<(&'static str, Box<dyn Controller + '_>)> {
        let (learner, channel) = self.learned.as_ref()?;
        Some((learner.name(), Box::new(LearnedPolicy { learner: &**learner, channel: *channel })))
    }

    /// Whether the trained policy's agents hear those of other episodes.
    pub(super) fn is_shuffled(&self) -> bool {
        self.learned.as_ref().is_some_and(|(_, channel)| channel.shuffled)
    }

    /// Returns the policy of an ONNX file.
    pub(super) fn model(&self, file: &Path) -> anyhow::Result<Box<dyn Controller>> {
        Ok(Box::new(OnnxPolicy::load(file, self.arena.spec(), self.arena.interval())?))
    }
}

/// Says which values in the run's `config.toml` are not those of its checkpoint, `stored`. An
/// evaluation has the checkpoint's.
fn tell_edits(run: &RunDir, stored: &str) {
    let file = run.config();
    let Ok(text) = std::fs::read_to_string(&file) else { return };
    if text.parse::<toml::Table>().is_err() {
        say!("{} is damaged; the settings of the checkpoint count", file.display());
        return;
    }
    let mut edits = config::changes(stored, &text);
    edits.retain(|edit| {
        let set = format!("{}=", edit.key);
        edit.key != "scenario.file" && config::no_matter_of_evaluation(&set).is_none()
    });
    if !edits.is_empty() {
        let edits: Vec<String> = edits.iter().map(ToString::to_string).collect();
        say!(
            "{} is not what the checkpoint was trained with, whose settings count; use --set for others: {}",
            file.display(),
            edits.join(", ")
        );
    }
}

/// Says whether the scenario's files have changed since training, and how the task differs from them.
fn tell_changes(args: &Args, run: &RunDir, scenario: &Scenario, replacement: Option<String>) {
    let file = scenario.path.display();
    let given = |set: &String| set.trim_start().starts_with("scenario=");
    let is_other = args.scenario.is_some() || args.set.iter().any(given);
    if !is_other && run.fingerprint().is_some_and(|trained| trained != scenario.fingerprint()) {
        let whole = Some(run.scenario()).filter(|path| path.exists());
        let whole = whole.map_or_else(String::new, |path| {
            format!("; --scenario {} is the scenario of training", path.display())
        });
        say!("{file}, or a net or route file that it names, has changed since training{whole}");
    }
    if let Some(line) = replacement {
        say!("{line}");
    }
}

/// Builds the networks of a checkpoint for an environment, with the checkpoint's weights.
fn build(
    checkpoint: &Checkpoint,
    config: &Config,
    spec: &EnvSpec,
) -> anyhow::Result<Box<dyn Algorithm>> {
    let device = config.device.find()?;
    let mut learner =
        algo::build(&checkpoint.algorithm, spec, &config.learner, Seed::new(0), device)?;
    learner.load_weights(&checkpoint.learner).map_err(|unfit| match unfit {
        algo::Error::State(_) => anyhow::Error::new(unfit).context(
            "the checkpoint does not fit the observations and networks that the scenario and the settings define",
        ),
        other => other.into(),
    })?;
    if let Some(difference) = checkpoint.misplaced(&spec.observation) {
        bail!(
            "the policy observes other numbers than the scenario and the settings define: {difference}"
        );
    }
    algo::check_channel(learner.name(), &config.channel)?;
    Ok(learner)
}

fn checkpoint_of(run: &Path) -> anyhow::Result<Checkpoint> {
    let path = RunDir::checkpoint(run);
    if run.is_dir() && !path.exists() {
        bail!(
            "`{}` contains no checkpoint (checkpoints/best.safetensors or last.safetensors); a training writes the first one before its first validation",
            run.display()
        );
    }
    if run.is_dir() && !path.ends_with("best.safetensors") {
        say!("`{}` has no best checkpoint: {} is evaluated", run.display(), path.display());
    }
    let checkpoint = Checkpoint::load(&path)?;
    if !algo::names().contains(&checkpoint.algorithm.as_str()) {
        bail!(
            "`{}` is a checkpoint of the algorithm `{}`, which this program does not support",
            path.display(),
            checkpoint.algorithm
        );
    }
    Ok(checkpoint)
}
