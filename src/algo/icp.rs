//! ICP (implicit channel protocol): implicit communication through actions. An agent's action shows
//! a symbol, and agents that see it read the symbol one step later (Wang et al. 2025, "Learning to
//! Communicate Through Implicit Communication Channels", arXiv 2411.01553, for discrete actions; as
//! adapted to continuous control in IWoL's appendix, "Comparison with ICP", which leaves most
//! details open; there is no public code).
//!
//! 1. with every action, each agent shows one of K symbols: a sample of a distribution that depends
//!    on its embedding, with the gradient of the softmax
//! 2. all agents share one encoder and one decoder: from a symbol, the decoder predicts what the
//!    sender saw (its embedding) and did (its action); both learn this from the samples of all
//!    agents
//! 3. in the next step, an agent observes the symbols of the agents within range: for each symbol,
//!    the share of them that have shown it
//! 4. three value functions: `icp-dec` has one value for each agent, from its own observation, and
//!    its own return; `icp-sum` adds these values up to one value of the team; `icp-monotonic`
//!    mixes them as QMIX does, with the privileged state; these two learn from the team's return,
//!    and their agents share its advantage
//!
//! Differences from the original on purpose: a continuous action space has no spare scouting
//! actions, so that the symbol accompanies the action and has no physical effect; the shares of
//! symbols serve any number of other agents (adaptation: one input for each). They are numbers of
//! the observation, which stay the same in an update; to decode them is a linear map, which the
//! policy's first layer can learn. The noise of symbols is logistic, follows the schedule of the
//! other noise and is stored with the rollout (original: Gumbel noise). In evaluation, agents show
//! the most likely symbol. Proximal policy optimisation, the Gaussian head and, for `icp-dec`,
//! shared advantages are those of [all methods](super).
//!
//! Shapes: symbols `[rows, N, K]`, which end the policy's memory, and what an agent reads of others,
//! `[rows, N, K]`; what the decoder predicts, `[rows, N, H + A]`.

use std::marker::PhantomData;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use smart_default::SmartDefault;
use tch::{Kind, Tensor};

use super::CommunicationScope;
use super::batch::{Batch, Shard};
use super::critic::{Critic, ValueFunction, value_loss};
use super::decision::{ActMode, Decision, Observation};
use super::decoder::{LatentDecoder, mean_squared_error};
use super::encoder::{Encoder, encode_rows, encode_shard};
use super::networks::{Loss, Networks};
use super::parameters::{ACTOR, CRITIC, ParameterBuilder};
use super::policy::{PolicyHead, PolicyTerms, Ratio};
use super::settings::Settings;
use crate::env::{EnvSpec, Feature, Features, Group};
use crate::nn::graph::sample_best;
use crate::nn::{Init, Linear, Mixer, ValueNorm};

/// Settings of ICP.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema, SmartDefault)]
#[serde(deny_unknown_fields)]
#[schemars(default)]
pub struct IcpSettings {
    /// Number K of symbols that an action can show.
    #[default = 16]
    #[schemars(range(min = 2, max = 4096))]
    pub symbols: i64,
}

/// Weight of the loss of the decoder, which predicts from a symbol what its sender saw and did: that
/// of IWoL's decoders (the adaptation names none).
const LAMBDA_MESSAGE: f64 = 0.05;

/// How the agents' values form the value that is trained.
pub(super) trait Decomposition: Send + 'static {
    /// Name of the method.
    const NAME: &'static str;
    /// Whether the team has one value and one return.
    const TEAM: bool;
    /// Whether the team's value is a monotonic mix of the agents' values instead of their sum.
    const MIXED: bool;
}

/// One value for each agent.
pub(super) struct Separate;
/// One value for the team: the sum of the agents' values.
pub(super) struct Sum;
/// One value for the team: a function that increases with each agent's value.
pub(super) struct Monotonic;

impl Decomposition for Separate {
    const NAME: &'static str = "icp-dec";
    const TEAM: bool = false;
    const MIXED: bool = false;
}

impl Decomposition for Sum {
    const NAME: &'static str = "icp-sum";
    const TEAM: bool = true;
    const MIXED: bool = false;
}

impl Decomposition for Monotonic {
    const NAME: &'static str = "icp-monotonic";
    const TEAM: bool = true;
    const MIXED: bool = true;
}

/// The networks of implicit communication, with a decomposition of the value.
pub(super) struct Icp<D> {
    encoder: Encoder,
    head: PolicyHead,
    symbol: Linear,
    decoder: LatentDecoder,
    critic: Critic,
    mixer: Option<Mixer>,
    /// Number K of symbols.
    symbols: i64,
    decomposition: PhantomData<D>,
}

impl<D: Decomposition> Icp<D> {
    /// Returns the symbols `[.., K]` that embeddings `[.., H]` show: 0 or 1, with the gradient of
    /// the softmax. With `noise [.., K]` they are samples; without, the most likely symbols.
    fn show(&self, f: &Tensor, noise: Option<&Tensor>) -> Tensor {
        let scores = self.symbol.forward(f);
        sample_best(&noise.map_or_else(|| scores.shallow_clone(), |noise| &scores + noise), 1)
    }

    /// Returns what agents read besides their observation, `[rows, N, K]`: the share of the others
    /// within range that have shown each symbol. `memory [rows, N, M]` ends with the symbols of the
    /// last step, which are cleared where `keep [rows, N]` is 0; `comm [rows, N, N]` is 1 within
    /// range. Agents without a symbol do not count.
    fn heard(&self, memory: &Tensor, keep: &Tensor, comm: &Tensor) -> Tensor {
        let shown = memory.narrow(2, self.encoder.memory(), self.symbols) * keep.unsqueeze(-1);
        // 1 for agents that have shown a symbol; those whose trajectory begins have not.
        let speaks = shown.amax([-1], false).unsqueeze(1);
        let others = (comm - comm.diagonal(0, 1, 2).diag_embed(0, 1, 2)) * speaks;
        let count = others.sum_dim_intlist(-1, true, Kind::Float).clamp_min(1.0);
        (others / count).matmul(&shown)
    }

    /// Returns the encoder's input at one decision, and the encoder's own memory.
    fn read(&self, input: &Observation) -> (Tensor, Tensor) {
        let heard = self.heard(&input.memory, &input.keep(), &input.comm);
        (
            Tensor::cat(&[&input.observation, &heard], -1),
            input.memory.narrow(2, 0, self.encoder.memory()),
        )
    }

    /// Returns the trained values of rows, `[rows, N]`, from the values of all agents, `[rows, N]`.
    /// The diagonal of `comm [rows, N, N]` is 1 where an agent is present.
    fn decomposed(&self, values: Tensor, state: &Tensor, comm: &Tensor) -> Tensor {
        if !D::TEAM {
            return values;
        }
        let present = comm.diagonal(0, 1, 2);
        let team = match &self.mixer {
            Some(mixer) => mixer.forward(&values, state, &present),
            None => (&values * present).sum_dim_intlist(-1, false, Kind::Float),
        };
        team.unsqueeze(-1).expand_as(&values)
    }
}

impl<D: Decomposition> Networks for Icp<D> {
    const NAME: &'static str = D::NAME;
    const SCOPE: CommunicationScope = CommunicationScope::InRangeNextStep;
    const SETTINGS: &'static [&'static str] = &["icp"];
    const TRAINING_ONLY: &'static [&'static str] = &["decoder."];
    const TEAM: bool = D::TEAM;

    fn new(spec: &EnvSpec, settings: &Settings, builder: &mut ParameterBuilder) -> Self {
        let (network, symbols, actions) =
            (&settings.network, settings.icp.symbols, spec.actions.encoded() as i64);
        let (hidden, decoded) = (network.hidden, network.hidden + actions);
        let heard =
            |i| Feature { name: format!("heard.{i}"), unit: "1".to_owned(), low: 0.0, high: 1.0 };
        let group = Group {
            name: "heard".to_owned(),
            offset: 0,
            width: symbols as usize,
            count: 1,
            presence: None,
        };
        let heard = Features {
            list: (0..symbols).map(heard).collect(),
            groups: vec![group],
            normalised: false,
        };
        let mixer = |builder: &mut ParameterBuilder| {
            Mixer::new(builder.of(CRITIC).sub("mixer"), spec.state.len() as i64)
        };
        Self {
            encoder: Encoder::new(
                builder.of(ACTOR).sub("encoder"),
                &spec.observation.join(&heard),
                network,
            ),
            head: PolicyHead::of_actor(builder, hidden, spec, settings),
            symbol: Linear::new(
                builder.of(ACTOR).sub("symbol"),
                hidden,
                symbols,
                Init::Orthogonal(1.0),
            ),
            decoder: LatentDecoder::new(builder.of(ACTOR).sub("decoder"), symbols, hidden, decoded),
            critic: Critic::new(builder.of(CRITIC), &spec.observation, network),
            mixer: D::MIXED.then(|| mixer(builder)),
            symbols,
            decomposition: PhantomData,
        }
    }

    fn head(&self) -> &PolicyHead {
        &self.head
    }

    fn memory(&self) -> i64 {
        self.encoder.memory() + self.symbols
    }

    fn graph_noise(&self, _agents: i64) -> i64 {
        self.symbols
    }

    fn is_recurrent(&self) -> bool {
        self.encoder.memory() > 0
    }

    fn critic(&self) -> &dyn ValueFunction {
        self
    }

    fn act(&self, input: &Observation, mode: &ActMode) -> Decision {
        let (x, memory) = self.read(input);
        let (f, after) = encode_rows(&self.encoder, &x, &memory, &input.keep(), 1);
        let after = after.map_or_else(|| memory.shallow_clone(), |after| after.view_as(&memory));
        let (action, log_prob) = self.head.sample(&f, &input.available, mode);
        let shown = self.show(&f, mode.graph_noise());
        Decision { action, log_prob, memory: Tensor::cat(&[&after, &shown], -1) }
    }

    fn loss(&self, batch: &Batch, shard: &Shard, settings: &Settings, norm: &ValueNorm) -> Loss {
        let (comm, keep) = (shard.take(&batch.comm), shard.take(&batch.keep));
        let first = batch.value_memory.index_select(0, &shard.first);
        let (values, _) =
            self.critic.values(&shard.take(&batch.observation), &keep, shard.length, &first);
        let values = shard.pick(&self.decomposed(values, &shard.take(&batch.state), &comm));
        let value = value_loss(batch, shard, &values, norm);

        let heard = self.heard(&shard.take(&batch.memory), &keep, &comm);
        let x = Tensor::cat(&[shard.take(&batch.observation), heard], -1);
        let own = batch.memory.narrow(2, 0, self.encoder.memory());
        let f = encode_shard(&self.encoder, shard, &x, &own, &batch.keep);
        let policy = PolicyTerms::new(batch, shard, &self.head, &f, &settings.ppo, Ratio::Joint);
        // Other agents see the executed action, which is clipped to its bounds.
        let action = self.head.encoded(&shard.active(&batch.action)).clamp(-1.0, 1.0);
        let target = Tensor::cat(&[f.detach(), action], -1);
        let shown = self.show(&f, Some(&shard.active(&batch.policy_graph)));
        let message = mean_squared_error(&self.decoder.forward(&shown), &target);

        let total = &policy.loss + &value + LAMBDA_MESSAGE * &message;
        Loss::new(total, &value, [("loss/message", &message)], &policy)
    }
}

impl<D: Decomposition> ValueFunction for Icp<D> {
    fn memory(&self) -> i64 {
        self.critic.memory()
    }

    fn value(&self, input: &Observation, state: &Tensor) -> Option<Tensor> {
        let values = self.critic.value(&input.observation, input);
        values.map(|values| self.decomposed(values, state, &input.comm))
    }

    fn values(&self, batch: &Batch, length: i64, memory: &Tensor) -> (Tensor, Option<Tensor>) {
        let (values, after) = self.critic.values(&batch.observation, &batch.keep, length, memory);
        (self.decomposed(values, &batch.state, &batch.comm), after)
    }
}
