//! The learners. An algorithm is one file: networks that decide and say what they lose. [`ppo`] holds the losses as pure
//! functions, `core` the passes over a rollout; a method that does not fit them implements [`Algorithm`] itself. Another one
//! is a file, its `mod`, and its line among the `METHODS` below, from which all else follows: commands, messages and tests.

mod batch;
mod channel;
mod commformer;
mod core;
mod critic;
mod decoder;
mod device;
mod encoder;
mod ex_iwol;
mod head;
mod icp;
mod im_iwol;
mod maddpg;
mod magic;
mod mappo;
mod mat;
mod message;
mod parameters;
pub mod ppo;
mod replay;
mod scene;
mod sequence;
pub mod settings;

pub use channel::{Channel, ChannelNoise};
pub use device::{ComputeDevice, NoDevice};
pub use settings::Settings;

use tch::{Device, Tensor};

use self::core::{ActorCritic, Networks};

use crate::env::EnvSpec;
use crate::nn;
use crate::rng::Seed;
use crate::rollout::Rollout;

/// The methods, in the order in which they are named.
const METHODS: [Method; 11] = [
    Method::of::<mappo::Mappo>(),
    Method::of::<im_iwol::ImIwol>(),
    Method::of::<ex_iwol::ExIwol>(),
    Method::of::<mat::Mat>(),
    Method::of::<magic::Magic>(),
    Method::of::<commformer::CommFormer>(),
    Method::of::<icp::Icp<icp::Separate>>(),
    Method::of::<icp::Icp<icp::Sum>>(),
    Method::of::<icp::Icp<icp::Monotonic>>(),
    maddpg::MADDPG,
    maddpg::MADDPG_IWOL,
];

/// Names of the algorithms, as on the command line.
pub const NAMES: [&str; METHODS.len()] = {
    let mut names = [""; METHODS.len()];
    let mut i = 0;
    while i < names.len() {
        names[i] = METHODS[i].name;
        i += 1;
    }
    names
};

/// What is known of a method before it is built.
struct Method {
    name: &'static str,
    capabilities: Capabilities,
    build: fn(&EnvSpec, &Settings, Seed, Device) -> Box<dyn Algorithm>,
}

impl Method {
    /// One of networks that are trained by proximal policy optimisation.
    const fn of<N: Networks + 'static>() -> Self {
        let capabilities = Capabilities {
            hears: N::HEARS,
            messages: N::MESSAGES,
            any_number: N::PER_AGENT.is_none(),
            team: N::TEAM,
            recurrent: true,
            on_policy: true,
            latent: N::LATENT,
            settings: N::SETTINGS,
        };
        Self {
            name: N::NAME,
            capabilities,
            build: |spec, settings, seed, device| {
                Box::new(ActorCritic::<N>::new(spec, settings, seed, device))
            },
        }
    }

    fn named(name: &str) -> Result<&'static Self, Error> {
        let found = METHODS.iter().find(|method| method.name == name);
        found.ok_or_else(|| Error::UnknownAlgorithm { name: name.to_owned() })
    }
}

/// What a method can do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[expect(clippy::struct_excessive_bools, reason = "any of them may be without the others")]
pub struct Capabilities {
    /// Whose observations can change an agent's action at run time.
    pub hears: Hears,
    /// Whether agents send messages, each of which its receiver reads by itself, so that a [`Channel`] can disturb them.
    pub messages: bool,
    /// Whether one policy serves any number of agents.
    pub any_number: bool,
    /// Whether agents learn from the return of their team, and not each from its own.
    pub team: bool,
    /// Whether the encoder may have a memory (`network.encoder = "gru"`).
    pub recurrent: bool,
    /// Whether it learns from the last rollout alone, by the probabilities of its actions (proximal policy optimisation).
    pub on_policy: bool,
    /// What its latent is trained to tell, by default: `world` (the privileged state), `interaction` (messages).
    pub latent: &'static [&'static str],
    /// Groups of settings that it is told of, beside those of all methods: what others say makes no difference to it.
    pub settings: &'static [&'static str],
}

/// Whose observations can change an agent's action at run time, besides its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Hears {
    /// Nobody's: no radio is needed.
    Nobody,
    /// Of those within range: messages. In several rounds, or along a sequence, also of those within range of these.
    InRange,
    /// Of those within range, a step later: what they do shows it.
    InRangeLater,
    /// Everyone's: one place decides for all.
    Everyone,
}

/// What an algorithm can do, by its name.
///
/// # Errors
/// [`Error::UnknownAlgorithm`].
pub fn capabilities(name: &str) -> Result<Capabilities, Error> {
    Ok(Method::named(name)?.capabilities)
}

/// Whether the channel can disturb what the agents of an algorithm tell each other, or there is nothing to disturb.
///
/// # Errors
/// [`Error::NoMessages`], [`Error::UnknownAlgorithm`].
pub fn check_channel(name: &str, channel: &Channel) -> Result<(), Error> {
    let Method { name, capabilities, .. } = Method::named(name)?;
    let fits = channel.is_perfect() || capabilities.messages || capabilities.hears == Hears::Nobody;
    if fits { Ok(()) } else { Err(Error::NoMessages { algorithm: name }) }
}

/// Whether a policy of an algorithm that was trained among some agents can be used among others.
///
/// # Errors
/// [`Error::FixedAgents`], [`Error::UnknownAlgorithm`].
pub fn check_agents(name: &str, trained: i64, agents: i64) -> Result<(), Error> {
    let Method { name, capabilities, .. } = Method::named(name)?;
    let fits = capabilities.any_number || trained == agents;
    if fits { Ok(()) } else { Err(Error::FixedAgents { algorithm: name, trained, agents }) }
}

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
        /// Shift of the mean by noise of earlier steps, in units of the scheduled standard
        /// deviation, `[E, N, A]`; empty where noise is independent from step to step.
        carried: &'a Tensor,
        /// Standard logistic, `[E, N, G · N]` for G graphs side by side; empty for policies without one.
        graph: &'a Tensor,
        /// Logarithm of the share of the standard deviation that is drawn anew, `[A]` or `[1]`: 0
        /// where noise is independent from step to step.
        log_fresh: &'a Tensor,
    },
}

/// What a policy decided.
#[derive(Debug)]
pub struct Decision {
    /// `[E, N, A]`, not clipped.
    pub action: Tensor,
    /// Of each dimension of the action, `[E, N, A]`.
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
        Self {
            action: change(&self.action),
            log_prob: change(&self.log_prob),
            memory: change(&self.memory),
        }
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
    /// Discount per step.
    pub gamma: f64,
    /// Weight of imitating the rollout's teacher in the policy's loss, 0 to 1; what it earns has the rest.
    pub imitation: f64,
    /// Minibatches have so many times the samples that are set.
    pub growth: usize,
}

/// Named diagnostics of an update, in the field's usual names.
pub type Losses = Vec<(&'static str, f64)>;

/// A learner: policy, value function and their optimisers.
pub trait Algorithm {
    /// Name, as on the command line.
    fn name(&self) -> &'static str;

    /// Memory of the policy per agent, M.
    fn memory(&self) -> usize;

    /// Whether a world keeps the noise of its graphs for a whole rollout.
    fn graph_lasts(&self) -> bool {
        false
    }

    /// Communication graphs G that the policy samples at each decision.
    fn graphs(&self) -> usize {
        0
    }

    /// Chooses actions; no gradients, nothing of the learner changes.
    fn act(&self, input: &Observation, mode: &ActMode<'_>) -> Decision;

    /// Width of the messages that agents send at run time; 0 for methods without.
    fn message_width(&self) -> usize;

    /// Deterministic actions where messages pass through `channel`; the observation's memory, and the decision's, are
    /// [`Channel::memory`] numbers wider than [`Algorithm::memory`]. For methods without messages the same as
    /// [`Algorithm::act`].
    fn act_through(&self, input: &Observation, channel: &Channel, noise: &ChannelNoise)
    -> Decision;

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
    let method = Method::named(name)?;
    Ok((method.build)(spec, &settings.only(method.capabilities.settings), seed, device))
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
    /// A stored state is of another number of agents, which the algorithm cannot do without.
    #[error(
        "{algorithm} learned something about each of {trained} agents and cannot be used among {agents}; let as many vehicles learn as in \
         its training (--agents, env.penetration), or choose a method for any number: {}",
        METHODS.iter().filter(|method| method.capabilities.any_number).map(|m| m.name).collect::<Vec<_>>().join(", ")
    )]
    FixedAgents {
        /// The algorithm.
        algorithm: &'static str,
        /// Of the state.
        trained: i64,
        /// Of the task.
        agents: i64,
    },
    /// A channel is to disturb messages that the algorithm does not have.
    #[error(
        "[channel] is for messages that agents send at once and each receiver reads by itself; {algorithm} has none: leave it out"
    )]
    NoMessages {
        /// The algorithm.
        algorithm: &'static str,
    },
    /// A stored state is of another network.
    #[error(transparent)]
    State(#[from] nn::Error),
}
