//! Sets up a run: learner, worlds and rollout, new or from a checkpoint.

use std::sync::Arc;

use tch::Tensor;

use super::ahead::Ahead;
use super::collect::Collector;
use super::last_action::LastAction;
use super::{Error, RunDir, Timers, Trainer, schedule};
use crate::algo::{self, Settings};
use crate::checkpoint::{Checkpoint, Progress};
use crate::config::{self, Config};
use crate::env::{Environment, Stream};
use crate::ranks::{Divided, Team};
use crate::rng::Seed;
use crate::rollout::{Rollout, Sizes};

impl Trainer {
    pub(super) fn build(
        config: Config,
        environment: Box<dyn Environment>,
        checkpoint: Option<&Checkpoint>,
        team: &Team,
    ) -> Result<Self, Error> {
        let seed = Seed::new(config.seed);
        let environment = divided(&config, environment, team)?;
        let spec = environment.spec();
        let device = config.device.find()?;
        let settings = Settings { channel: config.channel, ..config.learner.clone() };
        let (name, ranks) = (&config.algorithm, &team.ranks);
        let new = || algo::build_among(name, spec, &settings, seed.child("weights"), device, ranks);
        let mut learner = new()?;
        let player = config.train.overlap.then(new).transpose()?;
        let envs = config.train.envs;
        let stream = Stream {
            worlds: envs,
            stride: envs as u64,
            seed: seed.child("episodes"),
            episodes: 0..u64::MAX,
            training: true,
            repeat_failed: config.train.repeat_failed,
            beside: false,
        };
        let sizes = Sizes {
            steps: config.train.rollout_steps,
            envs,
            agents: spec.agents,
            observation: spec.observation.len(),
            state: spec.state.len(),
            actions: spec.actions.len(),
            choices: spec.actions.choices().unwrap_or(0),
            memory: learner.training_memory(),
            graph_noise: learner.graph_noise(spec.agents),
        };
        let shape = [envs as i64, spec.agents as i64, learner.training_memory() as i64];
        let count = envs * spec.agents * learner.training_memory();
        let (worlds, memory, progress) = match checkpoint {
            None => {
                let path = &config.init_from;
                if !path.as_os_str().is_empty() {
                    let stored = Checkpoint::load(&RunDir::checkpoint(path))?;
                    if stored.algorithm != config.algorithm {
                        let (of, trained) = (stored.algorithm, config.algorithm);
                        return Err(Error::OtherMethod { path: path.clone(), of, trained });
                    }
                    let unfit = |source| Error::InitFrom { path: path.clone(), source };
                    learner.load_weights(&stored.learner).map_err(unfit)?;
                    if let Some(difference) = stored.misplaced(&spec.observation) {
                        return Err(Error::OtherObservation { path: path.clone(), difference });
                    }
                }
                let first = Progress {
                    next_validation: config.train.validate_every,
                    ..Progress::default()
                };
                (environment.start(&stream)?, vec![0.0; count], first)
            }
            Some(stored) => {
                same_run(&config, stored)?;
                let width = spec.agents * spec.actions.len();
                let whole = stored.worlds.iter().all(|world| world.actions.len() % width == 0);
                let carried = stored.learner.iter().find(|(name, _)| name == "critic_memory/last");
                let fits = carried.is_none_or(|(_, t)| {
                    t.size() == [(envs * spec.agents) as i64, config.learner.network.hidden]
                });
                if stored.worlds.len() != envs || stored.memory.len() != count || !whole || !fits {
                    return Err(Error::OtherRun { key: other_shape(&config, stored) });
                }
                learner.load(&stored.learner)?;
                let before = toml::from_str::<toml::Table>(&stored.config)
                    .ok()
                    .and_then(|t| t.get("steps")?.as_integer());
                let mut progress = stored.progress.clone();
                schedule::extended(&config, &mut progress, before.map_or(0, i64::cast_unsigned));
                (environment.restore(&stream, &stored.worlds)?, stored.memory.clone(), progress)
            }
        };
        let last_action = LastAction::new(environment.spec());
        let noise_lasts = environment.spec().actions.noise_lasts();
        let mut rollout = Rollout::new(sizes);
        rollout.cooperation = environment.cooperation();
        rollout.bootstrap_horizon = config.train.bootstrap_horizon;
        let mut trainer = Self {
            rollout,
            ahead: None,
            collector: Collector {
                worlds,
                memory: Tensor::from_slice(&memory).view(shape),
                noise_lasts,
                last_action,
                finished: Vec::new(),
                timers: Timers::default(),
            },
            config,
            environment,
            learner,
            team: team.clone(),
            progress,
            activity: Arc::default(),
            seed,
        };
        if let Some(player) = player {
            trainer.ahead = Some(Ahead::new(player, &trainer, checkpoint)?);
        }
        Ok(trainer)
    }
}

/// Returns the environment with its worlds divided among the processes of a team, if there are
/// several.
fn divided(
    config: &Config,
    environment: Box<dyn Environment>,
    team: &Team,
) -> Result<Box<dyn Environment>, Error> {
    let size = team.ranks.size();
    if size == 1 {
        return Ok(environment);
    }
    if config.train.overlap {
        return Err(Error::OverlapAmongRanks { size });
    }
    for (key, count) in
        [("train.envs", config.train.envs), ("ppo.shards", config.learner.ppo.shards)]
    {
        if count < size && config.reads(key) {
            return Err(Error::TooManyRanks { key, count, size });
        }
    }
    Ok(Box::new(Divided::new(environment, team)))
}

/// Refuses to resume a run with settings under which its worlds cannot be restored.
fn same_run(config: &Config, stored: &Checkpoint) -> Result<(), Error> {
    const ONCE: [&str; 7] = [
        "algorithm",
        "environment",
        "agents",
        "seed",
        "train.envs",
        "train.rollout_steps",
        "train.fewest_agents",
    ];
    // Where the scenario's file is does not matter; its content is compared otherwise.
    let other =
        |key: &str| ONCE.contains(&key) || key.starts_with("scenario.") && key != "scenario.file";
    let changed = config::changes(&stored.config, &config.to_toml());
    changed
        .into_iter()
        .find(|c| other(&c.key))
        .map_or(Ok(()), |c| Err(Error::OtherRun { key: c.key }))
}

/// Returns the setting that gives a run memories or worlds of another shape than the checkpoint's.
fn other_shape(config: &Config, stored: &Checkpoint) -> String {
    let changed =
        config::changes(&stored.config, &config.to_toml()).into_iter().map(|change| change.key);
    let of_networks = |key: &String| {
        !["train.", "ppo.", "simulation."].iter().any(|group| key.starts_with(group))
    };
    changed
        .filter(|key| key.contains('.'))
        .find(of_networks)
        .unwrap_or_else(|| "train.envs".to_owned())
}
