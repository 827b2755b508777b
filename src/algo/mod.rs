//! The learning algorithms. Each algorithm is one file with networks that act and compute their
//! loss (`networks`). `actor_critic` trains them by proximal policy optimisation, with the losses of
//! [`ppo`]; a method that is trained otherwise implements [`Algorithm`] itself.
//!
//! Where all methods differ from their references: the advantages of other agents are added to an
//! agent's own with the weight `cooperation` of the environment
//! ([`Rollout::share_advantages`](crate::rollout::Rollout::share_advantages); MADDPG adds their
//! penalties, and the teams of ICP have one return); the noise of actions follows a schedule, and so
//! does the noise of graphs that a policy samples, which has its reference's scale only while the
//! scheduled standard deviation is 1. The files of the methods have their further differences.
//!
//! A new method of this crate needs a file, its `mod` line and an entry in `METHODS` below. Commands,
//! messages and tests follow from that entry. An application adds a method of its own by
//! [`register`]; [`method`] has what such a method is made of.

#![cfg(feature = "learn")]

mod actor_critic;
mod batch;
mod categorical;
mod channel;
mod commformer;
mod critic;
mod decision;
mod decoder;
mod device;
mod encoder;
mod error;
mod ex_iwol;
mod frames;
mod head;
mod icp;
mod im_iwol;
mod iwol;
mod maddpg;
mod magic;
mod mappo;
mod mat;
mod means;
mod message;
mod networks;
pub mod onnx;
mod parameters;
mod policy;
pub mod ppo;
mod radio;
mod scene;
mod sequence;
pub mod settings;

pub use channel::{Channel, ChannelNoise};
pub use decision::{ActMode, Decision, Diagnostics, Observation, Reconstruction};
pub use device::{ComputeDevice, NoDevice};
pub use error::Error;
pub use frames::store_frames;
pub use settings::Settings;

use std::sync::{Arc, RwLock};

use tch::{Device, Tensor};

use self::actor_critic::ActorCritic;
use self::networks::Networks;

use crate::env::EnvSpec;
use crate::ranks::{Alone, Ranks};
use crate::rng::Seed;
use crate::rollout::Rollout;

/// What a method that is trained by proximal policy optimisation is made of: it implements
/// [`Networks`], and is then trained, stored, resumed and evaluated as the methods of this crate
/// are.
pub mod method {
    pub use super::batch::{Batch, Shard};
    pub use super::critic::{Critic, PrivilegedCritic, ValueFunction, value_loss};
    pub use super::encoder::{Encoder, encode_active, encode_locally, encode_rows, encode_shard};
    pub use super::networks::{Loss, Networks};
    pub use super::parameters::{ACTOR, CRITIC, ParameterBuilder, ParameterGroup};
    pub use super::policy::{PolicyHead, PolicyTerms, Ratio};
}

/// All methods of this crate, in the order in which commands and messages list them.
const METHODS: &[Method] = &[
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

/// Names of the methods of this crate, as on the command line.
pub const NAMES: [&str; METHODS.len()] = {
    let mut names = [""; METHODS.len()];
    let mut i = 0;
    while i < names.len() {
        names[i] = METHODS[i].name;
        i += 1;
    }
    names
};

/// Methods that applications added.
static REGISTERED: RwLock<Vec<Method>> = RwLock::new(Vec::new());

/// Adds a method of your own, under its name, for all trainings and evaluations of this process.
///
/// # Errors
/// [`Error::NameTaken`] if another method has this name; [`Error::OwnMessages`] if its agents send
/// messages ([`Networks::MESSAGES`]), which only methods of this crate can pass through a
/// [`Channel`].
pub fn register<N: Networks + 'static>() -> Result<(), Error> {
    if N::MESSAGES {
        return Err(Error::OwnMessages { name: N::NAME });
    }
    let mut registered = REGISTERED.write().unwrap_or_else(std::sync::PoisonError::into_inner);
    if METHODS.iter().chain(&*registered).any(|method| method.name == N::NAME) {
        return Err(Error::NameTaken { name: N::NAME });
    }
    registered.push(Method::of::<N>());
    Ok(())
}

/// Returns all methods: those of this crate, then those that applications added.
fn methods() -> Vec<Method> {
    let registered = REGISTERED.read().unwrap_or_else(std::sync::PoisonError::into_inner);
    METHODS.iter().chain(&*registered).copied().collect()
}

/// Returns the names of all methods: those of this crate, then those that applications added.
pub fn names() -> Vec<&'static str> {
    methods().iter().map(|method| method.name).collect()
}

/// Lists the names of the methods with a property, for messages.
fn those_that(can: impl Fn(&Capabilities) -> bool) -> String {
    let all = methods();
    let names = all.iter().filter(|method| can(&method.capabilities)).map(|method| method.name);
    names.collect::<Vec<_>>().join(", ")
}

/// The static description of a method, and the function that builds it.
#[derive(Clone, Copy)]
struct Method {
    name: &'static str,
    capabilities: Capabilities,
    build: Build,
}

/// Builds a method for an environment.
type Build = fn(&EnvSpec, &Settings, Seed, Device, &Arc<dyn Ranks>) -> Box<dyn Algorithm>;

impl Method {
    /// A method whose networks are trained by proximal policy optimisation.
    const fn of<N: Networks + 'static>() -> Self {
        let capabilities = Capabilities {
            scope: N::SCOPE,
            messages: N::MESSAGES,
            any_number: N::PER_AGENT.is_none(),
            team: N::TEAM,
            discrete: true,
            recurrent: true,
            on_policy: true,
            latent: N::LATENT,
            settings: N::SETTINGS,
            unread: N::UNREAD,
        };
        Self {
            name: N::NAME,
            capabilities,
            build: |spec, settings, seed, device, ranks| {
                Box::new(ActorCritic::<N>::new(spec, settings, seed, device, Arc::clone(ranks)))
            },
        }
    }

    fn named(name: &str) -> Result<Self, Error> {
        let found = methods().into_iter().find(|method| method.name == name);
        found.ok_or_else(|| Error::UnknownAlgorithm { name: name.to_owned() })
    }
}

/// The properties of a method that are known before it is built.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[expect(clippy::struct_excessive_bools, reason = "any of them may be without the others")]
pub struct Capabilities {
    /// The agents whose observations can change an agent's action at run time.
    pub scope: CommunicationScope,
    /// Whether agents send messages that each receiver reads by itself, so that a [`Channel`] can
    /// disturb them.
    pub messages: bool,
    /// Whether one policy serves any number of agents.
    pub any_number: bool,
    /// Whether agents learn from the return of their team instead of each from its own return.
    pub team: bool,
    /// Whether actions may be discrete.
    pub discrete: bool,
    /// Whether the encoder may have a memory (`network.encoder = "gru"`).
    pub recurrent: bool,
    /// Whether the method learns from the last rollout alone, by the probabilities of its actions
    /// (proximal policy optimisation).
    pub on_policy: bool,
    /// What the latent is trained to predict by default: `world` (the privileged state),
    /// `interaction` (messages).
    pub latent: &'static [&'static str],
    /// Groups of settings that the method reads, besides those common to all methods. Settings in
    /// other groups have no effect on it.
    pub settings: &'static [&'static str],
    /// Single settings of these and of the common groups that have no effect on the method either.
    pub unread: &'static [&'static str],
}

/// The agents, besides itself, whose observations can change an agent's action at run time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CommunicationScope {
    /// No other agent. The policy needs no radio.
    None,
    /// Agents within range, by messages. With several rounds, or along a sequence, agents within
    /// range of those as well.
    InRange,
    /// Agents within range, one step later, because their actions show it.
    InRangeNextStep,
    /// All agents: one central policy decides for everyone.
    All,
}

/// Returns what the algorithm called `name` can do.
///
/// # Errors
/// [`Error::UnknownAlgorithm`].
pub fn capabilities(name: &str) -> Result<Capabilities, Error> {
    Ok(Method::named(name)?.capabilities)
}

/// Checks that the algorithm called `name` can be evaluated with `channel`: the channel is perfect,
/// or the agents send messages that it can disturb, or actions depend on no other agent, so that
/// there is nothing to disturb.
///
/// # Errors
/// [`Error::NoMessages`], [`Error::UnknownAlgorithm`].
pub fn check_channel(name: &str, channel: &Channel) -> Result<(), Error> {
    let Method { name, capabilities, .. } = Method::named(name)?;
    let fits = channel.is_perfect()
        || capabilities.messages
        || capabilities.scope == CommunicationScope::None;
    if fits { Ok(()) } else { Err(Error::NoMessages { algorithm: name }) }
}

/// Checks that the algorithm called `name` can be trained with the actions of an environment.
///
/// # Errors
/// [`Error::Discrete`], [`Error::UnknownAlgorithm`].
pub fn check_actions(name: &str, spec: &EnvSpec) -> Result<(), Error> {
    let Method { name, capabilities, .. } = Method::named(name)?;
    let fits = spec.actions.choices().is_none() || capabilities.discrete;
    if fits { Ok(()) } else { Err(Error::Discrete { algorithm: name }) }
}

/// Checks that a policy of the algorithm called `name` that was trained with `trained` agents can
/// be used with `agents` agents.
///
/// # Errors
/// [`Error::FixedAgents`], [`Error::UnknownAlgorithm`].
pub fn check_agents(name: &str, trained: i64, agents: i64) -> Result<(), Error> {
    let Method { name, capabilities, .. } = Method::named(name)?;
    let fits = capabilities.any_number || trained == agents;
    if fits { Ok(()) } else { Err(Error::FixedAgents { algorithm: name, trained, agents }) }
}

/// Parameters of one update, and the noise of the actions after it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct UpdateParameters {
    /// Learning rate of this update.
    pub learning_rate: f64,
    /// Logarithm of the actions' standard deviation that the update leaves in the policy, where a
    /// schedule imposes it. Its exponential also scales the graph noise that the update draws.
    pub log_std: f64,
    /// Weight of the entropy bonus in this update.
    pub entropy_coefficient: f64,
}

/// Says whether an update is to be given up.
pub type Stop<'a> = &'a (dyn Fn() -> bool + Sync);

/// Named diagnostics of an update, under the names that are usual in the field.
pub type Losses = Vec<(&'static str, f64)>;

/// A learner: policy, value function and their optimisers.
pub trait Algorithm: Send {
    /// Returns the algorithm's name, as on the command line.
    fn name(&self) -> &'static str;

    /// Returns the width M of the policy's memory per agent.
    fn memory(&self) -> usize;

    /// Returns the width of what an agent remembers from one decision of a training to the next:
    /// the policy's memory, or messages that are under way.
    fn training_memory(&self) -> usize {
        self.memory()
    }

    /// Whether a world keeps the noise of its graphs for a whole rollout.
    fn graph_lasts(&self) -> bool {
        false
    }

    /// Returns how many numbers per agent the noise of the policy's communication graphs has, among
    /// `agents` agents; 0 for policies that sample no graph.
    fn graph_noise(&self, _agents: usize) -> usize {
        0
    }

    /// Returns the standard deviation of each action dimension under [`ActMode::Sample`]; empty
    /// where actions are discrete.
    fn deviations(&self) -> Vec<f32>;

    /// Chooses actions, without gradients and without changing the learner.
    fn act(&self, input: &Observation, mode: &ActMode) -> Decision;

    /// Returns the width of the messages that agents send at run time; 0 for methods without
    /// messages.
    fn message_width(&self) -> usize;

    /// Whether explored decisions and updates read what the channel does to each message
    /// ([`Observation::disturbance`]). Otherwise lost messages are cut from the physical masks.
    fn has_radio(&self) -> bool {
        false
    }

    /// Chooses deterministic actions where messages pass through `channel`. The memory in the
    /// observation and in the decision is [`Channel::memory`] numbers wider than
    /// [`Algorithm::memory`]. Methods without messages choose the same actions as in
    /// [`Algorithm::act`].
    fn act_through(&self, input: &Observation, channel: &Channel, noise: &ChannelNoise)
    -> Decision;

    /// Returns diagnostics of the policy, given the privileged `state [E, N, S]`.
    fn inspect(&self, input: &Observation, state: &Tensor) -> Diagnostics;

    /// Returns the decoders' predictions of `state [E, N, S]` and of messages from the latent, with
    /// their targets; empty for methods without a latent.
    fn reconstruct(&self, input: &Observation, state: &Tensor) -> Vec<Reconstruction>;

    /// Updates policy and value from one rollout. `seed` is the source of all noise.
    ///
    /// # Errors
    /// [`Error::NonFinite`] when a loss is not finite.
    fn update(
        &mut self,
        rollout: &Rollout,
        parameters: &UpdateParameters,
        seed: Seed,
    ) -> Result<Losses, Error> {
        self.update_until(rollout, parameters, seed, &|| false)
    }

    /// Updates policy and value as [`Algorithm::update`] does, and gives the update up once `stop`,
    /// which it may ask before each gradient step, returns true. The learner is then as before.
    /// Among several processes, all ask equally often.
    ///
    /// # Errors
    /// As [`Algorithm::update`], and [`Error::Stopped`] when the update was given up.
    fn update_until(
        &mut self,
        rollout: &Rollout,
        parameters: &UpdateParameters,
        seed: Seed,
        stop: Stop<'_>,
    ) -> Result<Losses, Error>;

    /// Exchanges the policy's weights with their average, if one is kept. An evaluation calls it
    /// once before [`Algorithm::act`] and once more before training continues.
    fn swap_average(&mut self);

    /// Returns weights, optimiser moments and value normalisation: everything that
    /// [`Algorithm::load`] needs to continue bit for bit.
    fn state(&self) -> Vec<(String, Tensor)>;

    /// Loads a state that [`Algorithm::state`] returned.
    ///
    /// # Errors
    /// [`Error::State`] when the state belongs to another network.
    fn load(&mut self, state: &[(String, Tensor)]) -> Result<(), Error>;

    /// Loads only the weights (the averaged ones, where the state has any) and the value
    /// normalisation of a state, as the start of a new training.
    ///
    /// # Errors
    /// [`Error::State`] when the weights belong to another network, [`Error::FixedAgents`] when
    /// they belong to another number of agents to which the algorithm is bound.
    fn load_weights(&mut self, state: &[(String, Tensor)]) -> Result<(), Error>;

    /// Returns the number of parameters that a deployed policy needs, and the number of all
    /// parameters.
    fn parameters(&self) -> (i64, i64);
}

/// Builds an algorithm by name on `device`, with initial weights drawn from `seed`.
///
/// # Errors
/// [`Error::UnknownAlgorithm`]; [`Error::Channel`] where the settings' channel cannot be trained
/// with; [`Error::Discrete`] where the method cannot have the environment's actions.
pub fn build(
    name: &str,
    spec: &EnvSpec,
    settings: &Settings,
    seed: Seed,
    device: Device,
) -> Result<Box<dyn Algorithm>, Error> {
    let alone: Arc<dyn Ranks> = Arc::new(Alone);
    build_among(name, spec, settings, seed, device, &alone)
}

/// Builds an algorithm as [`build`] does, whose updates the ranks divide among them.
///
/// # Errors
/// As [`build`].
pub fn build_among(
    name: &str,
    spec: &EnvSpec,
    settings: &Settings,
    seed: Seed,
    device: Device,
    ranks: &Arc<dyn Ranks>,
) -> Result<Box<dyn Algorithm>, Error> {
    let method = Method::named(name)?;
    if let Some(why) = settings.channel.cannot_train(settings.network.encoder) {
        return Err(Error::Channel { why });
    }
    check_actions(method.name, spec)?;
    let settings = settings.only(method.capabilities.settings);
    Ok((method.build)(spec, &settings, seed, device, ranks))
}
