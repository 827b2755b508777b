//! The trait that a method trained by proximal policy optimisation implements: its networks act,
//! give values and compute their loss on a shard of a minibatch.

use tch::Tensor;

use super::CommunicationScope;
use super::batch::{Batch, Shard};
use super::channel::{Channel, ChannelNoise};
use super::critic::ValueFunction;
use super::decision::{ActMode, Decision, Observation, Reconstruction};
use super::parameters::{ParameterBuilder, ParameterGroup};
use super::policy::{PolicyHead, PolicyTerms};
use super::radio::Radio;
use super::settings::Settings;
use crate::env::EnvSpec;
use crate::nn::ValueNorm;

/// Number of attention heads of MAGIC's first round and of all transformers (paper, table of
/// hyperparameters; the scripts of MAT and CommFormer have 1).
pub(super) const HEADS: i64 = 4;

/// The networks of one algorithm: their actions, their values, and their loss on a shard.
pub trait Networks: Sized + Send {
    /// Name of the algorithm, as on the command line.
    const NAME: &'static str;
    /// The agents whose observations can change an agent's action.
    const SCOPE: CommunicationScope = CommunicationScope::None;
    /// Whether agents send messages that each receiver reads by itself, so that a channel can
    /// disturb them.
    const MESSAGES: bool = false;
    /// What the latent is trained to predict by default; see
    /// [`Capabilities::latent`](super::Capabilities::latent).
    const LATENT: &'static [&'static str] = &[];
    /// Groups of settings that the networks read, besides those common to all methods.
    const SETTINGS: &'static [&'static str] = &[];
    /// Settings of these groups that the networks do not read.
    const UNREAD: &'static [&'static str] = &[];
    /// Whether a world keeps the noise of its graph for a whole rollout, so that the graph is the
    /// same at each decision.
    const GRAPH_LASTS: bool = false;
    /// Name prefixes of the actor's parameters that a deployed policy does not need.
    const TRAINING_ONLY: &'static [&'static str] = &[];

    /// Whether agents share the value and the return of their team.
    const TEAM: bool = false;
    /// A parameter with a row for each agent, as `<group>/<name>`, where there is one.
    const PER_AGENT: Option<&'static str> = None;

    /// Creates the networks and their parameters.
    fn new(spec: &EnvSpec, settings: &Settings, builder: &mut ParameterBuilder) -> Self;

    /// Returns the learning rate of a parameter group in a pass over a rollout; `None` where that
    /// pass does not train the group. `pass` counts those of all rollouts, from 0.
    fn rate(_group: ParameterGroup, _pass: usize, learning_rate: f64) -> Option<f64> {
        Some(learning_rate)
    }

    /// Returns the policy's head.
    fn head(&self) -> &PolicyHead;

    /// Returns the width M of the policy's memory per agent.
    fn memory(&self) -> i64;

    /// Returns how many numbers per agent the noise of the policy's communication graphs has, among
    /// N agents: N for each graph that the policy samples at a decision, K for a graph over lists of
    /// K neighbours or for one of K symbols that an agent shows, or 0.
    fn graph_noise(&self, _agents: i64) -> i64 {
        0
    }

    /// Returns the radio of training; `None` where cutting lost messages from the physical masks
    /// does the same, and for methods without messages.
    fn radio(&self) -> Option<&Radio> {
        None
    }

    /// Whether the memory is trained through time, on sequences.
    fn is_recurrent(&self) -> bool {
        self.memory() > 0
    }

    /// Returns the value function.
    fn critic(&self) -> &dyn ValueFunction;

    /// Chooses actions.
    fn act(&self, input: &Observation, mode: &ActMode) -> Decision;

    /// Returns the width of the messages that agents send at run time; 0 for methods without
    /// messages.
    fn message_width(&self) -> i64 {
        0
    }

    /// Chooses deterministic actions where messages pass through a channel. Methods without
    /// messages leave the channel's part of the memory, which follows their own, unchanged.
    fn act_through(
        &self,
        input: &Observation,
        _channel: &Channel,
        _noise: &ChannelNoise,
    ) -> Decision {
        let (own, total) = (self.memory(), input.memory.size()[2]);
        let own_input = input.with_memory(input.memory.narrow(2, 0, own));
        let decision = self.act(&own_input, &ActMode::Deterministic);
        let rest = input.memory.narrow(2, own, total - own);
        Decision { memory: Tensor::cat(&[&decision.memory, &rest], -1), ..decision }
    }

    /// Returns the communication graph at run time, `[E, N, N]`, row = listener; `None` for methods
    /// without messages.
    fn graph(&self, _input: &Observation) -> Option<Tensor> {
        None
    }

    /// Returns the loss on the active samples of a shard.
    fn loss(&self, batch: &Batch, shard: &Shard, settings: &Settings, norm: &ValueNorm) -> Loss;

    /// Returns the decoders' predictions of the privileged state and of the messages from the
    /// latent, with their targets; empty for methods without a latent.
    fn reconstruct(&self, _input: &Observation, _state: &Tensor) -> Vec<Reconstruction> {
        Vec::new()
    }
}

/// A loss and its diagnostics, all means over samples.
pub struct Loss {
    /// The loss that is differentiated.
    pub total: Tensor,
    /// Named scalars to report.
    pub report: Vec<(&'static str, Tensor)>,
}

impl Loss {
    /// Creates a loss of policy and value, whose sum is `total`. The report holds the value's loss,
    /// the diagnostics `own`, and those of the policy.
    pub fn new<const K: usize>(
        total: Tensor,
        value: &Tensor,
        own: [(&'static str, &Tensor); K],
        policy: &PolicyTerms,
    ) -> Self {
        let mut report = vec![("loss/value", value.detach())];
        report.extend(own.map(|(name, term)| (name, term.detach())));
        report.extend(policy.report());
        Self { total, report }
    }

    /// Adds the loss of a world decoder with a weight, where there is one.
    #[must_use]
    pub fn with_world(mut self, weight: f64, loss: Option<Tensor>) -> Self {
        if let Some(loss) = loss {
            self.report.push(("loss/world", loss.detach()));
            self.total += weight * loss;
        }
        self
    }
}
