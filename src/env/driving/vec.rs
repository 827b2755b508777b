//! Many worlds in lock-step. Each host is one simulator with one or more worlds. All hosts are
//! sent their commands before the first answer is awaited, and the work before and after the
//! exchange runs on all cores.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, PoisonError};

use rayon::prelude::*;

use super::task::{Driver, Task};
use super::world::World;
use crate::env::episode::WorldState;
use crate::env::error::Error;
use crate::env::expert::Pursuit;
use crate::env::record::EpisodeRecord;
use crate::env::spec::EnvSpec;
use crate::rng::Seed;
use crate::sumo::{self, Command, Hosting, Renewal, Simulation};

/// How to set up a [`VecEnv`].
#[derive(Debug, Clone)]
pub struct VecOptions {
    /// Number of worlds E.
    pub worlds: usize,
    /// Distance between the numbers of consecutive episodes of one world: E, or, where several
    /// processes divide the worlds of a run, the number of worlds of all processes.
    pub stride: u64,
    /// What controls the agents' vehicles.
    pub driver: Driver,
    /// Seed of the episode stream.
    pub seed: Seed,
    /// Episodes of the stream to play: world `e` plays `start + e`, `start + e + stride`, …, and
    /// then idles.
    pub episodes: std::ops::Range<u64>,
    /// Chance that a world repeats one of its failed episodes, if it has any, instead of playing
    /// the next episode of the stream.
    pub repeat_failed: f64,
    /// Where the worlds run. It affects the speed only, not the results.
    pub hosting: Hosting,
}

/// How often worlds were emptied for a new episode, by the means used, the cheapest first.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Resets {
    /// Resets that removed and added vehicles while the simulation went on.
    pub respawns: u64,
    /// Resets in which SUMO loaded its net again.
    pub loads: u64,
    /// Resets in which SUMO was started again.
    pub restarts: u64,
}

/// A simulator and the worlds that it hosts.
struct Host {
    simulation: Box<dyn Simulation>,
    /// Whether SUMO is renewed for each episode, because the behaviour of its own driver depends
    /// on what it did before.
    forgetful: bool,
    /// Whether the renewed SUMO gets a seed from the episode, because its drivers may be random.
    seeded: bool,
    /// Number of this host's first world.
    first: usize,
    worlds: Vec<World>,
    commands: Vec<Command>,
    /// Error of the first half of the exchange.
    failed: Option<Error>,
    /// Failures since an episode was last played to its end.
    failures: u32,
    loads: u64,
    restarts: u64,
    /// How many of these renewals followed a failure of SUMO.
    lost: u64,
}

/// E worlds in lock-step.
pub struct VecEnv {
    task: Arc<Task>,
    hosts: Vec<Host>,
    worlds: usize,
    /// The rule whose actions [`Worlds::follow_rule`](crate::env::Worlds::follow_rule) writes.
    rule: Option<Pursuit>,
}

impl VecEnv {
    /// Starts the simulators and spawns the vehicles of every world's first episode.
    ///
    /// # Errors
    /// If SUMO cannot be started or driven.
    pub fn new(task: &Arc<Task>, options: &VecOptions) -> Result<Self, Error> {
        let mut env = Self::idle(task, options)?;
        for (e, world) in env.worlds_mut().enumerate() {
            world.reset(options.episodes.start + e as u64);
        }
        let actions = vec![0.0; env.worlds * task.agents * task.spec.actions.len()];
        env.step(&actions)?;
        Ok(env)
    }

    /// Starts the simulators and restores the states that [`VecEnv::states`] returned earlier, by
    /// repeating the actions of the current episodes.
    ///
    /// # Errors
    /// As [`VecEnv::new`], and [`Error::Replay`] if SUMO dies meanwhile.
    ///
    /// # Panics
    /// If the number of `states` differs from the number of worlds.
    pub fn restore(
        task: &Arc<Task>,
        options: &VecOptions,
        states: &[WorldState],
    ) -> Result<Self, Error> {
        assert_eq!(states.len(), options.worlds, "one state per world");
        let mut env = Self::idle(task, options)?;
        let width = task.agents * task.spec.actions.len();
        let steps: Vec<usize> = states.iter().map(|state| state.actions.len() / width).collect();
        let longest = steps.iter().copied().max().unwrap_or(0);
        let mut actions = vec![0.0; env.worlds * width];
        // A world's respawn takes the exchange before its first step. Worlds with fewer steps
        // start later, so that all end together.
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
                    actions[e * width..(e + 1) * width]
                        .copy_from_slice(&states[e].actions[from..from + width]);
                }
            }
            env.step(&actions)?;
        }
        for (e, world) in env.worlds_mut().enumerate() {
            world.take_finished();
            world.restore(&states[e]);
        }
        if env.hosts.iter().any(|host| host.lost > 0) {
            return Err(Error::Replay);
        }
        Ok(env)
    }

    /// Starts the simulators with worlds that are idle.
    fn idle(task: &Arc<Task>, options: &VecOptions) -> Result<Self, Error> {
        let hosting = match options.driver {
            _ if task.needs_fresh_sumo() => options.hosting.alone(options.worlds),
            Driver::Sumo => Hosting { processes: options.worlds, ..options.hosting.beside() },
            Driver::Agents | Driver::Rules => options.hosting,
        };
        let count = hosting.hosts(options.worlds);
        let hosts = (0..count)
            .map(|h| {
                let (first, end) = (h * options.worlds / count, (h + 1) * options.worlds / count);
                let seed = options.seed.child("sumo").word();
                let config = task.simulation_config(seed, (end - first) as u32, &hosting);
                let failed = |source| Error::Sumo { world: first, episode: 0, step: 0, source };
                let simulation = sumo::start(hosting.backend, config).map_err(failed)?;
                let world = |e: usize| {
                    let episode = options.episodes.start + e as u64;
                    World::new(
                        Arc::clone(task),
                        options.driver,
                        options.seed,
                        episode,
                        options.stride,
                        options.episodes.end,
                    )
                    .with_repeat_failed(options.repeat_failed)
                };
                Ok(Host {
                    simulation,
                    forgetful: options.driver == Driver::Sumo || task.needs_fresh_sumo(),
                    seeded: task.needs_fresh_sumo(),
                    first,
                    worlds: (first..end).map(world).collect(),
                    commands: Vec::new(),
                    failed: None,
                    failures: 0,
                    loads: 0,
                    restarts: 0,
                    lost: 0,
                })
            })
            .collect::<Result<Vec<_>, Error>>()?;
        Ok(Self { task: Arc::clone(task), hosts, worlds: options.worlds, rule: None })
    }

    /// Returns the same worlds, with a rule whose actions
    /// [`Worlds::follow_rule`](crate::env::Worlds::follow_rule) writes.
    pub(super) fn with_rule(self, rule: Option<Pursuit>) -> Self {
        Self { rule, ..self }
    }

    pub(super) fn rule(&self) -> Option<Pursuit> {
        self.rule
    }

    /// Returns the shapes and features.
    pub fn spec(&self) -> &EnvSpec {
        &self.task.spec
    }

    /// Returns the number of worlds E.
    pub fn len(&self) -> usize {
        self.worlds
    }

    /// Returns whether there are no worlds.
    pub fn is_empty(&self) -> bool {
        self.worlds == 0
    }

    /// Returns the number of resets so far, by kind.
    pub fn resets(&self) -> Resets {
        let (loads, restarts) =
            (self.hosts.iter().map(|h| h.loads).sum(), self.hosts.iter().map(|h| h.restarts).sum());
        Resets { respawns: self.worlds().map(World::respawns).sum(), loads, restarts }
    }

    /// Returns whether every world has played all its episodes.
    pub fn is_finished(&self) -> bool {
        self.worlds().all(World::is_idle)
    }

    /// Returns the worlds in order.
    pub fn worlds(&self) -> impl Iterator<Item = &World> {
        self.hosts.iter().flat_map(|host| &host.worlds)
    }

    /// Returns world `e`.
    ///
    /// # Panics
    /// If there are not as many worlds.
    pub fn world(&self, e: usize) -> &World {
        let host = self.hosts.partition_point(|host| host.first <= e) - 1;
        let host = &self.hosts[host];
        &host.worlds[e - host.first]
    }

    fn worlds_mut(&mut self) -> impl Iterator<Item = &mut World> {
        self.hosts.iter_mut().flat_map(|host| &mut host.worlds)
    }

    /// Makes every world start its next episode with the coming step, whatever is on the road now.
    pub fn reset(&mut self) {
        self.worlds_mut().for_each(World::start_next);
    }

    /// Makes every world start another stream with the coming step, whatever is on the road now:
    /// world `e` plays the episodes `episodes.start + e`, `episodes.start + e + E`, … of the stream
    /// `seed`. The episodes are those of a new [`VecEnv`] with these options, and the simulators go
    /// on.
    pub fn restart(&mut self, seed: Seed, episodes: std::ops::Range<u64>) {
        let stride = self.worlds as u64;
        for (e, world) in self.worlds_mut().enumerate() {
            world.restart(seed, episodes.start + e as u64, stride, episodes.end);
        }
    }

    /// Returns the state of every world, for [`VecEnv::restore`].
    pub fn states(&self) -> Vec<WorldState> {
        self.worlds().map(World::state).collect()
    }

    /// Takes the records of the episodes that the last step ended.
    pub fn take_finished(&mut self) -> Vec<EpisodeRecord> {
        self.worlds_mut().filter_map(World::take_finished).collect()
    }

    /// Performs one decision in all worlds; `actions` is `[E, N, A]`.
    ///
    /// If SUMO dies or refuses a command, the current episodes of its worlds are truncated and
    /// flagged as interrupted, and SUMO is renewed. If a vehicle vanishes, only the episode of its
    /// world is truncated. The error is returned if there was another failure since an episode was
    /// last played to its end.
    ///
    /// # Errors
    /// [`Error`].
    pub fn step(&mut self, actions: &[f32]) -> Result<(), Error> {
        let width = self.task.agents * self.task.spec.actions.len();
        self.hosts.par_iter_mut().for_each(|host| {
            host.failed = guarded(|| host.act(actions, width)).err();
        });
        self.hosts.par_iter_mut().try_for_each(|host| guarded(|| host.finish()))
    }
}

/// Turns a panic into an error, so that after a defect in one world the run ends in an orderly
/// way, with a message and with complete files.
fn guarded<T>(work: impl FnOnce() -> Result<T, Error>) -> Result<T, Error> {
    catch_unwind(AssertUnwindSafe(work))
        .unwrap_or_else(|panic| Err(Error::Panicked { message: Error::text_of(&*panic) }))
}

/// Returns an error and its causes as one line.
fn chain(error: &Error) -> String {
    let causes = std::iter::successors(std::error::Error::source(error), |cause| cause.source());
    causes.fold(error.to_string(), |text, cause| format!("{text}: {cause}"))
}

impl Host {
    /// Performs the first half of the exchange: sends the commands of all worlds.
    fn act(&mut self, actions: &[f32], width: usize) -> Result<(), Error> {
        let stale =
            |world: &World| world.is_between_episodes() && (world.respawns() > 0 || self.seeded);
        if self.forgetful && self.worlds.iter().any(stale) {
            if self.seeded {
                self.simulation.reseed(self.worlds[0].simulator_seed());
            }
            self.renew()?;
            self.worlds.iter_mut().for_each(World::forget_vehicles);
        }
        self.commands.clear();
        for (k, world) in self.worlds.iter_mut().enumerate() {
            let e = self.first + k;
            world.act(k as u32, &actions[e * width..(e + 1) * width], &mut self.commands);
        }
        self.simulation.send(&self.commands).map_err(|source| self.place(source))
    }

    /// Performs the second half of the exchange: receives the snapshot and handles failures.
    fn finish(&mut self) -> Result<(), Error> {
        let outcome = match self.failed.take() {
            Some(error) => Err(error),
            None => self.take_in(),
        };
        match outcome {
            Ok(None) => {
                // A respawn alone does not reset the count: a SUMO that dies in every episode must
                // not be started again for ever.
                if self.worlds.iter().any(World::has_finished) {
                    self.failures = 0;
                }
                Ok(())
            }
            Ok(Some(vanished)) => self
                .fail(vanished)
                .map(|error| tracing::warn!("{}; that world's episode is dropped", chain(&error))),
            Err(error) => {
                let error = self.fail(error)?;
                let (first, last) = (self.first, self.first + self.worlds.len() - 1);
                tracing::warn!(
                    "{}; the episodes of worlds {first} to {last} are dropped and SUMO starts afresh",
                    chain(&error)
                );
                self.lost += 1;
                self.renew()?;
                self.worlds.iter_mut().for_each(World::interrupt);
                Ok(())
            }
        }
    }

    /// Counts a failure and returns it as `Ok` if the run can go on, which is the case for the
    /// first failure since an episode was played to its end, except a panic.
    fn fail(&mut self, error: Error) -> Result<Error, Error> {
        self.failures += 1;
        if self.failures > 1 || matches!(error, Error::Panicked { .. }) {
            Err(error)
        } else {
            Ok(error)
        }
    }

    /// Renews the simulation and counts how this was done.
    fn renew(&mut self) -> Result<(), Error> {
        match self.simulation.renew().map_err(|source| self.place(source))? {
            Renewal::Loaded => self.loads += 1,
            Renewal::Restarted => self.restarts += 1,
        }
        Ok(())
    }

    /// Receives the snapshot and lets the worlds observe it. If a world lost a vehicle, its
    /// episode is given up and the reason is returned as `Some`; the simulation and the other
    /// worlds are sound.
    fn take_in(&mut self) -> Result<Option<Error>, Error> {
        match self.simulation.receive() {
            Ok(snapshot) => {
                let vanished = Mutex::new(None);
                self.worlds.par_iter_mut().enumerate().try_for_each(|(k, world)| {
                    match world.observe(k as u32, snapshot) {
                        Err(error @ Error::Vanished { .. }) => {
                            world.abandon();
                            *vanished.lock().unwrap_or_else(PoisonError::into_inner) = Some(error);
                            Ok(())
                        }
                        other => other,
                    }
                })?;
                Ok(vanished.into_inner().unwrap_or_else(PoisonError::into_inner))
            }
            Err(source) => Err(self.place(source)),
        }
    }

    /// Wraps an error of SUMO with the place where it occurred.
    fn place(&self, source: sumo::Error) -> Error {
        let world = &self.worlds[0];
        Error::Sumo {
            world: self.first,
            episode: world.episode(),
            step: world.step_count(),
            source,
        }
    }
}

#[cfg(test)]
mod tests;
