//! The learners. An algorithm is one file: networks that decide and say what they lose. [`ppo`] holds the losses as pure
//! functions, `core` the passes over a rollout; a method that does not fit them implements [`Algorithm`] itself.

mod batch;
mod channel;
mod core;
mod device;
mod encoder;
mod ex_iwol;
mod head;
mod im_iwol;
mod mappo;
mod message;
pub mod ppo;
pub mod settings;

pub use channel::{Channel, ChannelNoise};
pub use device::{ComputeDevice, NoDevice};
pub use settings::Settings;

use tch::{Device, Tensor};

use self::core::ActorCritic;

use crate::env::EnvSpec;
use crate::nn;
use crate::rng::Seed;
use crate::rollout::Rollout;

/// Names of the algorithms, as on the command line.
pub const NAMES: [&str; 3] = ["mappo", "im-iwol", "ex-iwol"];

/// What a policy sees at one decision of E environments with N agents each.
#[derive(Debug)]
pub struct Observation {
    /// `[E, N, O]`
    pub observation: Tensor,
    /// Physical mask, `[E, N, N]`.
    pub comm: Tensor,
    /// `[E]`, 1 where a trajectory starts.
    pub start: Tensor,
    /// Memory after the last decision, `[E, N, M]`.
    pub memory: Tensor,
}

impl Observation {
    /// 0 where memories are cleared before the decision, 1 elsewhere, `[E, N]`.
    fn keep(&self) -> Tensor {
        let (envs, agents, _) = self.observation.size3().expect("observations are [E, N, O]");
        (self.start.ones_like() - &self.start).view([envs, 1]).expand([envs, agents], false)
    }
}

/// How to choose actions.
#[derive(Debug)]
pub enum ActMode<'a> {
    /// The mean, with the most likely communication graph.
    Deterministic,
    /// A sample from the given noise, so that the caller owns all randomness.
    Sample {
        /// Standard normal, `[E, N, A]`.
        action: &'a Tensor,
        /// Standard logistic, `[E, N, N]`; empty for policies without a graph.
        graph: &'a Tensor,
        /// Added to the logarithm of the standard deviation, `[E]`: how much quieter each environment is.
        quiet: &'a Tensor,
    },
}

/// What a policy decided.
#[derive(Debug)]
pub struct Decision {
    /// `[E, N, A]`, not clipped.
    pub action: Tensor,
    /// `[E, N]`
    pub log_prob: Tensor,
    /// `[E, N, M]`
    pub memory: Tensor,
}

impl Observation {
    fn map(&self, change: impl Fn(&Tensor) -> Tensor) -> Self {
        Self {
            observation: change(&self.observation),
            comm: change(&self.comm),
            start: change(&self.start),
            memory: change(&self.memory),
        }
    }
}

impl Decision {
    fn map(&self, change: impl Fn(&Tensor) -> Tensor) -> Self {
        Self { action: change(&self.action), log_prob: change(&self.log_prob), memory: change(&self.memory) }
    }
}

/// What a latent says about something, beside the truth.
#[derive(Debug)]
pub struct Reconstruction {
    /// Of what: `world` or `interaction`.
    pub name: &'static str,
    /// What the decoder makes of the latent, `[E, N, K]`.
    pub found: Tensor,
    /// The truth, `[E, N, K]`.
    pub truth: Tensor,
}

/// What a policy thinks at one decision.
#[derive(Debug, Default)]
pub struct Insight {
    /// Value of each agent's future, in units of the reward, `[E, N]`; `None` where that needs a memory of its own.
    pub value: Option<Tensor>,
    /// Who listens to whom at run time, `[E, N, N]`; `None` for methods without messages.
    pub graph: Option<Tensor>,
}

/// How fast to learn, and how much to explore afterwards.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pace {
    /// Learning rate of this update.
    pub learning_rate: f64,
    /// Logarithm of the standard deviation of the actions from this update on, where it is imposed.
    pub log_std: f64,
}

/// Named diagnostics of an update, in the field's usual names.
pub type Losses = Vec<(&'static str, f64)>;

/// A learner: policy, value function and their optimisers.
pub trait Algorithm {
    /// Name, as on the command line.
    fn name(&self) -> &'static str;

    /// Memory of the policy per agent, M.
    fn memory(&self) -> usize;

    /// Whether the policy samples a communication graph.
    fn samples_graph(&self) -> bool {
        false
    }

    /// Chooses actions; no gradients, nothing of the learner changes.
    fn act(&self, input: &Observation, mode: &ActMode<'_>) -> Decision;

    /// Width of the messages that agents send at run time; 0 for methods without.
    fn message_width(&self) -> usize;

    /// Deterministic actions where messages pass through `channel`; the observation's memory, and the decision's, are
    /// [`Channel::memory`] numbers wider than [`Algorithm::memory`]. For methods without messages the same as
    /// [`Algorithm::act`].
    fn act_through(&self, input: &Observation, channel: &Channel, noise: &ChannelNoise) -> Decision;

    /// What the policy thinks, given `state [E, N, S]`.
    fn inspect(&self, input: &Observation, state: &Tensor) -> Insight;

    /// What the latent says about `state [E, N, S]` and about messages; empty for methods without a latent.
    fn reconstruct(&self, input: &Observation, state: &Tensor) -> Vec<Reconstruction>;

    /// Learns from one rollout; `seed` is the source of all noise.
    ///
    /// # Errors
    /// [`Error::NonFinite`] when a loss is not finite.
    fn update(&mut self, rollout: &Rollout, pace: &Pace, seed: Seed) -> Result<Losses, Error>;

    /// Exchanges the policy's weights with their average, if one is kept: once before [`Algorithm::act`] in an evaluation,
    /// once more before training goes on.
    fn swap_average(&mut self);

    /// Weights, optimiser moments, value normalisation: everything that [`Algorithm::load`] needs to go on bit for bit.
    fn state(&self) -> Vec<(String, Tensor)>;

    /// Takes over a state.
    ///
    /// # Errors
    /// [`Error::State`] when it is of another network.
    fn load(&mut self, state: &[(String, Tensor)]) -> Result<(), Error>;

    /// Takes over the weights (the averaged ones, where there are any) and the value normalisation of a state, and nothing
    /// else: training starts from them.
    ///
    /// # Errors
    /// [`Error::State`] when they are of another network.
    fn load_weights(&mut self, state: &[(String, Tensor)]) -> Result<(), Error>;

    /// Number of parameters that a deployed policy needs, and of all.
    fn parameters(&self) -> (i64, i64);
}

/// Builds an algorithm by name on `device`, with weights drawn from `seed`.
///
/// # Errors
/// [`Error::UnknownAlgorithm`].
pub fn build(
    name: &str,
    spec: &EnvSpec,
    settings: &Settings,
    seed: Seed,
    device: Device,
) -> Result<Box<dyn Algorithm>, Error> {
    match name {
        "mappo" => Ok(Box::new(ActorCritic::<mappo::Mappo>::new(spec, settings, seed, device))),
        "im-iwol" => Ok(Box::new(ActorCritic::<im_iwol::ImIwol>::new(spec, settings, seed, device))),
        "ex-iwol" => Ok(Box::new(ActorCritic::<ex_iwol::ExIwol>::new(spec, settings, seed, device))),
        _ => Err(Error::UnknownAlgorithm { name: name.to_owned() }),
    }
}

/// What can go wrong in a learner.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// No algorithm has this name.
    #[error("there is no algorithm `{name}`; choose one of {}", NAMES.join(", "))]
    UnknownAlgorithm {
        /// The name.
        name: String,
    },
    /// Training diverged.
    #[error("training diverged: {what} is not finite; try a lower ppo.learning_rate")]
    NonFinite {
        /// Which quantity.
        what: &'static str,
    },
    /// A stored state is of another network.
    #[error(transparent)]
    State(#[from] nn::Error),
}
