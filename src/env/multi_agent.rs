//! Environments of one's own: what one world does, without SUMO, and how many of them become an
//! [`Environment`].

mod lock_step;

use self::lock_step::{LockStep, World};
use super::environment::{Environment, Stream, Worlds};
use super::episode::{Episode, WorldState};
use super::error::Error;
use super::frame::Frame;
use super::picture::{Backdrop, Picture};
use super::spec::EnvSpec;
use crate::rng::Seed;

/// One world of an environment of your own. Implement it, and give a function that makes such
/// worlds to [`Simple`]: the methods that support its actions can then be trained in it.
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

    /// Begins an episode, which depends on `seed` alone, and not on earlier episodes: a run that is
    /// resumed begins its episodes again and repeats their actions. The frame comes with zeros
    /// everywhere: write who acts (`active`), who hears whom (`comm`), the observations, and the
    /// privileged states if there are any. With discrete actions all choices are open at first
    /// (`available`).
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
    /// Rewards of slots that did not act in this step do not count.
    ///
    /// The episode is over when no agent acts any more, unless it [goes on](Self::goes_on).
    fn step(&mut self, actions: &[f32], frame: &mut Frame);

    /// Returns whether the episode goes on although nobody acts, because agents are still to come.
    fn goes_on(&self) -> bool {
        false
    }

    /// Returns how far an episode was a success, from 0 to 1, at its end: the share of agents that
    /// have reached their goal, or another share that says what the task is about. Policies are
    /// compared by it, exploration anneals and training stops by it (`train.anneal_success`,
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

/// Names of metrics that all environments, or all scenarios, have.
const TAKEN: [&str; 12] = [
    "success",
    "reward",
    "window_reward",
    "episode_length",
    "length",
    "message_bits",
    "safety",
    "crash",
    "delay",
    "unfinished",
    "efficiency",
    "loitering",
];

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
            () => return self.check_metrics(),
        };
        Err(Error::Own { episode: 0, step: 0, what: format!("the environment has {what}") })
    }

    /// Checks that no metric has the name of another one.
    fn check_metrics(&self) -> Result<(), Error> {
        let names = || self.spec.metrics.iter().map(|metric| metric.name);
        let wrong = names()
            .enumerate()
            .find(|(k, name)| TAKEN.contains(name) || names().take(*k).any(|other| other == *name));
        let Some((_, name)) = wrong else { return Ok(()) };
        let what = format!("another metric is called `{name}`; give this one another name");
        Err(Error::Own { episode: 0, step: 0, what })
    }

    fn idle(&self, stream: &Stream) -> LockStep<E> {
        let world = |e: u64| {
            let Stream { seed, episodes, repeat_failed, stride, .. } = stream;
            let first = episodes.start + e;
            let episode = Episode::new(*seed, first, *stride, episodes.end);
            let episode = episode.with_repeat_failed(*repeat_failed);
            World::new((self.make)(), episode, stream.training)
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
                world.check_against(state, state.actions.len() / width)?;
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
