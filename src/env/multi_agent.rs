//! Environments of one's own: what one world does, without SUMO, and how many of them become an
//! [`Environment`].

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};

use rayon::prelude::*;

use super::environment::{Environment, Stream, WorldPhase, WorldView, Worlds};
use super::episode::{Episode, Phase, WorldState};
use super::error::Error;
use super::frame::Frame;
use super::picture::{Backdrop, Picture};
use super::record::EpisodeRecord;
use super::spec::EnvSpec;
use crate::rng::Seed;

/// One world of an environment of your own. Implement it, and give a function that makes such
/// worlds to [`Simple`]: all methods can then be trained in it.
///
/// The number N of agent slots is fixed; the frame says which of them act. All arrays of the frame
/// have the sizes of [`MultiAgentEnv::spec`] and are reused from step to step.
///
/// ```
/// use iwol_sumo::env::{EnvSpec, Frame, MultiAgentEnv};
/// use iwol_sumo::rng::Seed;
///
/// /// Every agent shall say the number that it sees.
/// struct Echo {
///     spec: EnvSpec,
/// }
///
/// impl MultiAgentEnv for Echo {
///     fn spec(&self) -> &EnvSpec {
///         &self.spec
///     }
///
///     fn reset(&mut self, seed: Seed, frame: &mut Frame) {
///         frame.active.fill(1.0);
///         frame.comm.fill(1.0);
///         iwol_sumo::rng::fill_uniform(&mut seed.rng(), &mut frame.observation);
///     }
///
///     fn step(&mut self, actions: &[f32], frame: &mut Frame) {
///         for (i, action) in actions.iter().enumerate() {
///             frame.reward[i] = -(action - frame.observation[i]).abs();
///             frame.end(i);
///         }
///     }
///
///     fn success(&self) -> f64 {
///         1.0
///     }
/// }
/// ```
pub trait MultiAgentEnv: Send {
    /// Returns sizes, actions and features, which never change.
    fn spec(&self) -> &EnvSpec;

    /// Begins an episode, which depends on `seed` alone. The frame comes with zeros everywhere:
    /// write who acts (`active`), who hears whom (`comm`, with 1 on the diagonal for those who are
    /// there), the observations, and the privileged states if there are any. With discrete actions
    /// all choices are open at first (`available`).
    fn reset(&mut self, seed: Seed, frame: &mut Frame);

    /// Begins an episode of a training, which may be drawn from another distribution than those of
    /// evaluations, such as one with easier episodes among them; it is the same by default.
    fn reset_for_training(&mut self, seed: Seed, frame: &mut Frame) {
        self.reset(seed, frame);
    }

    /// Takes a step with the actions `[N, A]`, of which only those of active agents count; each is
    /// in −1..1, or the number of a choice. The frame comes as it was left, but without rewards and
    /// ends: write rewards, what is observed now, and who has come to an end ([`Frame::end`],
    /// [`Frame::truncate`]). An agent that comes into a slot begins with [`Frame::begin_agent`].
    ///
    /// The episode is over when no agent acts any more, unless it [goes on](Self::goes_on).
    fn step(&mut self, actions: &[f32], frame: &mut Frame);

    /// Returns whether the episode goes on although nobody acts, because agents are still to come.
    fn goes_on(&self) -> bool {
        false
    }

    /// Returns the share of agents that have reached their goal, at the end of an episode: policies
    /// are compared by it, exploration anneals and training stops by it (`train.anneal_success`,
    /// `train.stop_success`), and episodes below 1 are repeated (`train.repeat_failed`).
    fn success(&self) -> f64;

    /// Returns the values of [`EnvSpec::metrics`], in their order, at the end of an episode.
    fn metrics(&self) -> Vec<f64> {
        Vec::new()
    }

    /// Returns what pictures show at present; `None` if there is nothing to draw.
    fn picture(&self) -> Option<Picture> {
        None
    }
}

/// An environment of many worlds that one function makes.
pub struct Simple<F> {
    name: String,
    spec: EnvSpec,
    make: F,
    cooperation: f64,
    backdrop: Backdrop,
}

impl<E: MultiAgentEnv + 'static, F: Fn() -> E + Send + Sync> Simple<F> {
    /// Creates an environment. `make` returns a new world.
    pub fn new(name: &str, make: F) -> Self {
        let spec = make().spec().clone();
        let backdrop = Backdrop {
            step_length: 1.0,
            size: [1.0, 1.0],
            range: f64::INFINITY,
            ..Backdrop::default()
        };
        Self { name: name.to_owned(), spec, make, cooperation: 0.0, backdrop }
    }

    /// Returns the same environment, in which each other agent's advantages have this weight beside
    /// an agent's own.
    #[must_use]
    pub fn with_cooperation(self, cooperation: f64) -> Self {
        Self { cooperation, ..self }
    }

    /// Returns the same environment with something behind the agents in pictures.
    #[must_use]
    pub fn with_backdrop(self, backdrop: Backdrop) -> Self {
        Self { backdrop, ..self }
    }

    /// Checks that there are agents and actions.
    fn check(&self) -> Result<(), Error> {
        let EnvSpec { agents, actions, observation, .. } = &self.spec;
        let what = match () {
            () if *agents == 0 => "no agents",
            () if actions.is_empty() || actions.choices() == Some(0) => "no actions",
            () if observation.is_empty() => "no features in its observation",
            () => return Ok(()),
        };
        Err(Error::Own { episode: 0, step: 0, what: format!("the environment has {what}") })
    }

    fn idle(&self, stream: &Stream) -> LockStep<E> {
        let world = |e: u64| {
            let Stream { seed, episodes, repeat_failed, worlds, .. } = stream;
            let first = episodes.start + e;
            let episode = Episode::new(*seed, first, *worlds as u64, episodes.end);
            let episode = episode.with_replay(*repeat_failed);
            World { training: stream.training, ..World::new((self.make)(), episode) }
        };
        LockStep { worlds: (0..stream.worlds as u64).map(world).collect() }
    }
}

impl<E: MultiAgentEnv + 'static, F: Fn() -> E + Send + Sync> Environment for Simple<F> {
    fn name(&self) -> &str {
        &self.name
    }

    fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    fn cooperation(&self) -> f64 {
        self.cooperation
    }

    fn start(&self, stream: &Stream) -> Result<Box<dyn Worlds>, Error> {
        self.check()?;
        let mut all = self.idle(stream);
        for (e, world) in all.worlds.iter_mut().enumerate() {
            world.episode.go_to(stream.episodes.start + e as u64);
        }
        all.step(&vec![0.0; all.worlds.len() * self.spec.agents * self.spec.actions.len()])?;
        Ok(Box::new(all))
    }

    fn restore(&self, stream: &Stream, states: &[WorldState]) -> Result<Box<dyn Worlds>, Error> {
        let mut all = self.idle(stream);
        let width = self.spec.agents * self.spec.actions.len();
        for (world, state) in all.worlds.iter_mut().zip(states) {
            if !state.interrupted {
                world.episode.go_to(state.episode);
                world.step(&vec![0.0; width])?;
                for actions in state.actions.chunks_exact(width) {
                    world.step(actions)?;
                }
                let back = (world.episode.index, world.episode.step as usize);
                if back != (state.episode, state.actions.len() / width) {
                    return Err(world.wrong_in_all(
                        "the environment does not come back to where it was: it has changed, or an episode does not \
                         depend on its seed and the actions alone",
                    ));
                }
            }
            world.finished = None;
            world.episode.restore(state);
        }
        Ok(Box::new(all))
    }

    fn backdrop(&self) -> Result<Backdrop, Error> {
        Ok(self.backdrop.clone())
    }
}

/// Worlds of an environment of one's own, on all cores.
struct LockStep<E> {
    worlds: Vec<World<E>>,
}

impl<E: MultiAgentEnv> Worlds for LockStep<E> {
    fn count(&self) -> usize {
        self.worlds.len()
    }

    fn view(&self, e: usize) -> WorldView<'_> {
        let World { frame, episode, .. } = &self.worlds[e];
        let phase = match episode.phase {
            Phase::Idle => WorldPhase::Idle,
            Phase::Running => WorldPhase::Running,
            Phase::Ended if episode.step > 0 && !episode.interrupted => WorldPhase::Ended,
            Phase::Ended | Phase::Spawning => WorldPhase::Between,
        };
        WorldView { frame, episode: episode.index, step: episode.step, phase }
    }

    fn step(&mut self, actions: &[f32]) -> Result<(), Error> {
        let Some(first) = self.worlds.first() else { return Ok(()) };
        // An evaluation gives the actions of more worlds than there are at its end.
        let width = first.actions_width();
        let each = self.worlds.par_iter_mut().zip(actions.par_chunks_exact(width));
        // A handful of worlds is not worth another core.
        each.with_min_len(4).try_for_each(|(world, actions)| world.step(actions))
    }

    fn take_finished(&mut self) -> Vec<EpisodeRecord> {
        self.worlds.iter_mut().filter_map(|world| world.finished.take()).collect()
    }

    fn states(&self) -> Vec<WorldState> {
        self.worlds.iter().map(|world| world.episode.state()).collect()
    }

    fn picture(&self, e: usize) -> Option<Picture> {
        self.worlds[e].env.picture()
    }
}

/// One world, and its place in its episodes.
struct World<E> {
    env: E,
    /// Whether the episodes are those of a training.
    training: bool,
    episode: Episode,
    frame: Frame,
    /// Sums of the agents' rewards in this episode, and their mean in each step.
    rewards: Vec<f64>,
    step_rewards: Vec<f32>,
    /// Actions of the coming step, within their bounds.
    actions: Vec<f32>,
    finished: Option<EpisodeRecord>,
}

impl<E: MultiAgentEnv> World<E> {
    fn new(env: E, episode: Episode) -> Self {
        let frame = Frame::new(env.spec(), false);
        let rewards = vec![0.0; env.spec().agents];
        Self {
            env,
            training: false,
            episode,
            frame,
            rewards,
            step_rewards: Vec::new(),
            actions: Vec::new(),
            finished: None,
        }
    }

    /// Returns how many numbers the actions of all agents are.
    fn actions_width(&self) -> usize {
        let spec = self.env.spec();
        spec.agents * spec.actions.len()
    }

    /// Takes a step, or begins the next episode.
    fn step(&mut self, actions: &[f32]) -> Result<(), Error> {
        let worked = catch_unwind(AssertUnwindSafe(|| match self.episode.phase {
            Phase::Idle | Phase::Spawning => Ok(()),
            Phase::Ended => self.begin(),
            Phase::Running => self.go_on(actions),
        }));
        worked.unwrap_or_else(|panic| {
            let Episode { index, step, .. } = &self.episode;
            let what = format!("the environment panicked: {}", Error::text_of(&*panic));
            Err(Error::Own { episode: *index, step: *step, what })
        })
    }

    fn begin(&mut self) -> Result<(), Error> {
        if !self.episode.begin() {
            return Ok(());
        }
        self.frame.clear();
        let seed = self.episode.seed();
        if self.training {
            self.env.reset_for_training(seed, &mut self.frame);
        } else {
            self.env.reset(seed, &mut self.frame);
        }
        self.frame.start.fill(1.0);
        self.episode.phase = Phase::Running;
        self.rewards.fill(0.0);
        self.step_rewards.clear();
        self.check()
    }

    fn go_on(&mut self, actions: &[f32]) -> Result<(), Error> {
        self.episode.note(actions);
        self.actions.clear();
        match self.env.spec().actions.choices() {
            None => self.actions.extend(actions.iter().map(|action| action.clamp(-1.0, 1.0))),
            Some(_) => self.actions.extend_from_slice(actions),
        }
        self.episode.step += 1;
        let before = self.frame.active.clone();
        if let Some(choices) = self.env.spec().actions.choices() {
            let is_choice =
                |choice: f32| choice.fract() == 0.0 && (0.0..choices as f32).contains(&choice);
            let acts = self.frame.active.iter().zip(&self.actions);
            let wrong =
                acts.enumerate().find(|(_, (acts, choice))| **acts > 0.0 && !is_choice(**choice));
            if let Some((i, (_, choice))) = wrong {
                return Err(
                    self.wrong(i, &format!("the action {choice} is none of {choices} choices"))
                );
            }
        }
        self.frame.begin(false);
        self.frame.reward.fill(0.0);
        self.env.step(&self.actions, &mut self.frame);
        self.check()?;
        // An agent that acted and does not any more has come to an end, which somebody must name.
        for (i, acted) in before.iter().enumerate() {
            let frame = &self.frame;
            let (acted, acts, begins) = (*acted > 0.0, frame.active[i] > 0.0, frame.start[i] > 0.0);
            let ended = frame.terminated[i] + frame.truncated[i] > 0.0;
            if acted && !acts && !ended {
                let what = "acts no more, but neither `end` nor `truncate` was called";
                return Err(self.wrong(i, what));
            }
            if !acted && acts && !begins {
                return Err(self.wrong(i, "acts, but `begin_agent` was not called"));
            }
            if acted && begins {
                let what =
                    "begins in a slot that was in use until this step; let it come a step later";
                return Err(self.wrong(i, what));
            }
        }
        let sum: f32 = self.frame.reward.iter().sum();
        self.step_rewards.push(sum / self.rewards.len() as f32);
        for (total, reward) in self.rewards.iter_mut().zip(&self.frame.reward) {
            *total += f64::from(*reward);
        }
        if self.frame.active.iter().all(|active| *active == 0.0) && !self.env.goes_on() {
            self.end()?;
        }
        Ok(())
    }

    fn end(&mut self) -> Result<(), Error> {
        let success = self.env.success();
        let (metrics, values) = (&self.env.spec().metrics, self.env.metrics());
        if metrics.len() != values.len() {
            return Err(self.wrong_in_all(&format!(
                "`metrics` returns {} values, but the spec has {} metrics",
                values.len(),
                metrics.len()
            )));
        }
        let own = metrics.iter().zip(values).map(|(metric, value)| (metric.name.to_owned(), value));
        self.finished = Some(EpisodeRecord {
            episode: self.episode.index,
            episode_length: self.episode.step,
            success,
            reward: self.rewards.iter().sum::<f64>() / self.rewards.len() as f64,
            driving: None,
            own: own.collect::<BTreeMap<_, _>>(),
            interrupted: false,
            replayed: self.episode.is_replayed(),
            step_rewards: std::mem::take(&mut self.step_rewards),
        });
        self.episode.end(success >= 1.0);
        Ok(())
    }

    /// Checks that the frame has the sizes of the spec and contains numbers, since one that does
    /// not would spoil all weights, that flags are 0 or 1, and that every agent that acts hears
    /// itself and has a choice.
    fn check(&self) -> Result<(), Error> {
        let (frame, spec) = (&self.frame, self.env.spec());
        let n = spec.agents;
        let sizes = [
            ("observation", &frame.observation, spec.observation.len()),
            ("state", &frame.state, spec.state.len()),
            ("comm", &frame.comm, n),
            ("available", &frame.available, spec.actions.choices().unwrap_or(0)),
            ("active", &frame.active, 1),
            ("start", &frame.start, 1),
            ("reward", &frame.reward, 1),
            ("terminated", &frame.terminated, 1),
            ("truncated", &frame.truncated, 1),
        ];
        for (what, values, width) in sizes {
            if values.len() != n * width {
                let (found, wanted) = (values.len(), n * width);
                return Err(
                    self.wrong_in_all(&format!("`{what}` has {found} numbers, not {wanted}"))
                );
            }
        }
        for (what, flags) in
            [("comm", &frame.comm), ("available", &frame.available), ("active", &frame.active)]
        {
            if let Some(at) = flags.iter().position(|flag| *flag != 0.0 && *flag != 1.0) {
                let text = format!("a number in `{what}` is {}, neither 0 nor 1", flags[at]);
                return Err(self.wrong(at / (flags.len() / n), &text));
            }
        }
        if let Some(i) = (0..n).find(|&i| frame.active[i] > 0.0 && frame.comm[i * n + i] < 1.0) {
            return Err(self.wrong(i, "it acts, and `comm` does not have 1 on its diagonal for it"));
        }
        if let Some(choices) = self.env.spec().actions.choices() {
            for (i, open) in frame.available.chunks_exact(choices).enumerate() {
                if frame.active[i] > 0.0 && open.iter().all(|one| *one < 0.5) {
                    return Err(self.wrong(i, "no choice is open to it (`available`)"));
                }
            }
        }
        let arrays = [
            ("observation", &frame.observation),
            ("state", &frame.state),
            ("reward", &frame.reward),
        ];
        for (what, values) in arrays {
            let width = values.len() / self.rewards.len().max(1);
            if let Some(at) = values.iter().position(|value| !value.is_finite()) {
                let text = format!("{what} {} is {}", at % width, values[at]);
                return Err(self.wrong(at / width, &text));
            }
        }
        Ok(())
    }

    fn wrong_in_all(&self, what: &str) -> Error {
        let Episode { index, step, .. } = &self.episode;
        Error::Own { episode: *index, step: *step, what: what.to_owned() }
    }

    fn wrong(&self, agent: usize, what: &str) -> Error {
        let Episode { index, step, .. } = &self.episode;
        Error::Own { episode: *index, step: *step, what: format!("agent {agent}: {what}") }
    }
}
