//! Many worlds in lock-step. Each host is one simulator with one or more worlds; all are set going before the first
//! answer is awaited, and the work around the exchange runs on all cores.

use std::sync::Arc;

use rayon::prelude::*;

use super::world::{Driver, World, WorldState};
use super::{EnvSpec, EpisodeRecord, Error, Task};
use crate::rng::Seed;
use crate::sumo::{self, Command, Simulation, TraciSimulation};

/// How to set up a [`VecEnv`].
#[derive(Debug, Clone)]
pub struct VecOptions {
    /// Worlds E.
    pub worlds: usize,
    /// Who chooses the speeds.
    pub driver: Driver,
    /// Seed of the episode stream.
    pub seed: Seed,
    /// Which episodes of the stream to play: world `e` plays `start + e`, `start + e + E`, …; when they run out it idles.
    pub episodes: std::ops::Range<u64>,
}

struct Host {
    simulation: Box<dyn Simulation>,
    /// Number of this host's first world.
    first: usize,
    worlds: Vec<World>,
    commands: Vec<Command>,
    /// What went wrong in the first half of the exchange.
    failed: Option<sumo::Error>,
    /// Fatal failures since an episode was last played to its end.
    failures: u32,
}

/// E worlds in lock-step.
pub struct VecEnv {
    task: Arc<Task>,
    hosts: Vec<Host>,
    worlds: usize,
    restarts: u64,
}

impl VecEnv {
    /// Starts the simulators, one process per world, and plays the first respawn of every world.
    ///
    /// # Errors
    /// When SUMO cannot be started or driven.
    pub fn new(task: &Arc<Task>, options: &VecOptions) -> Result<Self, Error> {
        let mut env = Self::idle(task, options)?;
        for (e, world) in env.worlds_mut().enumerate() {
            world.reset(options.episodes.start + e as u64);
        }
        let actions = vec![0.0; env.worlds * task.agents * task.spec.actions];
        env.step(&actions)?;
        Ok(env)
    }

    /// As [`VecEnv::new`], but brought to the states that [`VecEnv::states`] gave earlier, by playing the
    /// current episodes' actions again.
    ///
    /// # Errors
    /// As [`VecEnv::new`].
    ///
    /// # Panics
    /// When `states` are not as many as the worlds.
    pub fn restore(task: &Arc<Task>, options: &VecOptions, states: &[WorldState]) -> Result<Self, Error> {
        assert_eq!(states.len(), options.worlds, "one state per world");
        let mut env = Self::idle(task, options)?;
        let width = task.agents * task.spec.actions;
        let steps: Vec<usize> = states.iter().map(|state| state.actions.len() / width).collect();
        let longest = steps.iter().copied().max().unwrap_or(0);
        let mut actions = vec![0.0; env.worlds * width];
        // A world's respawn takes the exchange before its first step; shorter episodes start later.
        for t in 0..=longest {
            for (e, world) in env.worlds_mut().enumerate() {
                let wait = longest - steps[e];
                if states[e].interrupted {
                    continue;
                }
                if t == wait {
                    world.reset(states[e].episode);
                } else if t > wait {
                    let from = (t - wait - 1) * width;
                    actions[e * width..(e + 1) * width].copy_from_slice(&states[e].actions[from..from + width]);
                }
            }
            env.step(&actions)?;
        }
        for (e, world) in env.worlds_mut().enumerate() {
            world.take_finished();
            if states[e].interrupted {
                world.reset(states[e].episode);
            }
        }
        if env.restarts > 0 {
            return Err(Error::Replay);
        }
        Ok(env)
    }

    fn idle(task: &Arc<Task>, options: &VecOptions) -> Result<Self, Error> {
        let hosts = (0..options.worlds)
            .map(|e| {
                let config = task.simulation_config(options.seed.child("sumo").index(e as u64).word());
                let simulation = TraciSimulation::start(config).map_err(|source| Error::Sumo {
                    world: e,
                    episode: 0,
                    step: 0,
                    source,
                })?;
                let (first, stride) = (options.episodes.start + e as u64, options.worlds as u64);
                let world =
                    World::new(Arc::clone(task), options.driver, options.seed, first, stride, options.episodes.end);
                Ok(Host {
                    simulation: Box::new(simulation),
                    first: e,
                    worlds: vec![world],
                    commands: Vec::new(),
                    failed: None,
                    failures: 0,
                })
            })
            .collect::<Result<Vec<_>, Error>>()?;
        Ok(Self { task: Arc::clone(task), hosts, worlds: options.worlds, restarts: 0 })
    }

    /// Shapes and features.
    pub fn spec(&self) -> &EnvSpec {
        &self.task.spec
    }

    /// Number of worlds E.
    pub fn len(&self) -> usize {
        self.worlds
    }

    /// Whether there are no worlds.
    pub fn is_empty(&self) -> bool {
        self.worlds == 0
    }

    /// SUMO processes that had to be replaced so far.
    pub fn restarts(&self) -> u64 {
        self.restarts
    }

    /// Whether every world has played all its episodes.
    pub fn is_finished(&self) -> bool {
        self.worlds().all(World::is_idle)
    }

    /// The worlds in order.
    pub fn worlds(&self) -> impl Iterator<Item = &World> {
        self.hosts.iter().flat_map(|host| &host.worlds)
    }

    fn worlds_mut(&mut self) -> impl Iterator<Item = &mut World> {
        self.hosts.iter_mut().flat_map(|host| &mut host.worlds)
    }

    /// Where every world stands in its episodes.
    pub fn states(&self) -> Vec<WorldState> {
        self.worlds().map(World::state).collect()
    }

    /// Episodes that the last step ended.
    pub fn take_finished(&mut self) -> Vec<EpisodeRecord> {
        self.worlds_mut().filter_map(World::take_finished).collect()
    }

    /// One decision of all worlds; `actions` is `[E, N, A]`.
    ///
    /// A SUMO that dies costs its worlds' episodes (they are truncated and flagged) and is replaced; when the fresh one
    /// dies before an episode has come to its end as well, the error is returned.
    ///
    /// # Errors
    /// [`Error`].
    pub fn step(&mut self, actions: &[f32]) -> Result<(), Error> {
        let width = self.task.agents * self.task.spec.actions;
        self.hosts.par_iter_mut().for_each(|host| {
            host.commands.clear();
            for (k, world) in host.worlds.iter_mut().enumerate() {
                let e = host.first + k;
                world.act(k as u32, &actions[e * width..(e + 1) * width], &mut host.commands);
            }
            host.failed = host.simulation.send(&host.commands).err();
        });
        let results: Vec<Result<u64, Error>> = self.hosts.par_iter_mut().map(Host::finish).collect();
        for result in results {
            self.restarts += result?;
        }
        Ok(())
    }
}

impl Host {
    /// Second half of the exchange; tells how many simulators had to be replaced.
    fn finish(&mut self) -> Result<u64, Error> {
        let outcome = match self.failed.take() {
            Some(error) => Err(error),
            None => self.simulation.receive(),
        };
        match outcome {
            Ok(snapshot) => {
                for (k, world) in self.worlds.iter_mut().enumerate() {
                    world.observe(k as u32, snapshot)?;
                }
                // A respawn alone proves nothing: a SUMO that dies in every episode must not be started for ever.
                if self.worlds.iter().any(World::has_finished) {
                    self.failures = 0;
                }
                Ok(0)
            }
            Err(source) => {
                let (first, world) = (self.first, &self.worlds[0]);
                let place =
                    |source| Error::Sumo { world: first, episode: world.episode(), step: world.step_count(), source };
                self.failures += 1;
                if !source.is_fatal() || self.failures > 1 {
                    return Err(place(source));
                }
                tracing::warn!("world {first}: {source}; its episode is dropped and SUMO is started again");
                self.simulation.restart().map_err(place)?;
                self.worlds.iter_mut().for_each(World::interrupt);
                Ok(1)
            }
        }
    }
}
