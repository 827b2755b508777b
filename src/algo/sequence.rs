//! The parts shared by the methods that treat the agents of an environment as a sequence (MAT,
//! CommFormer): the transformer's input, the value from its encoder, and acting one agent after
//! another.
//!
//! Absent agents are left out of the sequence. An agent reads the action of the last present agent
//! before it, and no agent attends to an empty slot, so that agents with empty slots among them
//! decide as they would without these slots. (In CommFormer with a sparsity below 1, absent agents
//! take up some of the links.)

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use smart_default::SmartDefault;
use tch::{Kind, Tensor};

use super::batch::{Batch, Shard};
use super::critic::{ValueFunction, value_loss};
use super::decision::{ActMode, Decision, Observation};
use super::encoder::Encoder;
use super::parameters::ParameterBuilder;
use super::policy::{PolicyHead, PolicyTerms, Ratio};
use super::scene::Scene;
use super::settings::Settings;
use crate::env::EnvSpec;
use crate::nn::{
    Activation, Decoded, Init, Layer, LayerNorm, Linear, Path, Reach, TransformerDecoder, ValueNorm,
};

/// The transformer of MAT and CommFormer, as wide as the network's layers, with four attention heads.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema, SmartDefault)]
#[serde(deny_unknown_fields)]
#[schemars(default)]
pub struct TransformerSettings {
    /// Number of blocks of the encoder, and of the decoder.
    #[default = 1]
    #[schemars(range(min = 1, max = 64))]
    pub blocks: usize,
}

/// The observation encoder and the transformer's input layer: normalisation, linear, GELU,
/// normalisation.
pub(super) struct Input {
    encoder: Encoder,
    norm: LayerNorm,
    layer: Layer,
}

impl Input {
    pub(super) fn new(mut path: Path<'_>, spec: &EnvSpec, settings: &Settings) -> Self {
        let hidden = settings.network.hidden;
        Self {
            encoder: Encoder::new(path.sub("encoder"), &spec.observation, &settings.network),
            norm: LayerNorm::new(path.sub("input_norm"), hidden),
            layer: Layer::new(&mut path, ["input", "embed_norm"], hidden, hidden, Activation::Gelu),
        }
    }

    /// Returns the width of the memory per agent.
    pub(super) fn memory(&self) -> i64 {
        self.encoder.memory()
    }

    /// Returns the transformer's input for all agents, `[L · C, N, H]`, and the memory after each
    /// step, `[L, C · N, M]`.
    pub(super) fn forward(&self, scene: &Scene) -> (Tensor, Option<Tensor>) {
        let (f, memory) = scene.embed(&self.encoder);
        (self.layer.forward(&self.norm.forward(&f)), memory)
    }
}

/// The value of each agent from its representation in the transformer's encoder and from the
/// privileged state: linear, GELU, normalisation, linear with gain 0.01.
pub(super) struct ValueHead {
    first: Layer,
    second: Linear,
}

impl ValueHead {
    pub(super) fn new(mut path: Path<'_>, spec: &EnvSpec, hidden: i64) -> Self {
        let inputs = hidden + spec.state.len() as i64;
        Self {
            first: Layer::new(&mut path, ["first", "norm"], inputs, hidden, Activation::Gelu),
            second: Linear::new(path.sub("second"), hidden, 1, Init::Orthogonal(0.01)),
        }
    }

    /// Returns the values (normalised), `[..]`, for `representation: [.., H]` and `state: [.., S]`.
    pub(super) fn forward(&self, representation: &Tensor, state: &Tensor) -> Tensor {
        let x = self.first.forward(&Tensor::cat(&[representation, state], -1));
        self.second.forward(&x).squeeze_dim(-1)
    }
}

/// Networks whose encoder represents the agents of an environment together.
pub(super) trait Represents {
    /// Returns the representations of all agents of a scene.
    fn represent(&self, scene: &Scene) -> Represented;

    /// Returns the value on a representation.
    fn value_head(&self) -> &ValueHead;
}

/// Result of an encoder for a scene.
pub(super) struct Represented {
    /// Representations of the agents, `[rows, N, H]`.
    pub(super) representation: Tensor,
    pub(super) order: Order,
    /// Communication graph, `[rows, N, N]`, row = listener.
    pub(super) graph: Tensor,
    /// Memory of the observation encoder after the last step.
    pub(super) memory: Option<Tensor>,
}

impl<R: Represents> ValueFunction for R {
    fn memory(&self) -> i64 {
        0
    }

    fn value(&self, input: &Observation, state: &Tensor) -> Option<Tensor> {
        let known = self.represent(&Scene::of(input, None)).representation;
        Some(self.value_head().forward(&known, state))
    }

    fn values(&self, batch: &Batch, _length: i64, _memory: &Tensor) -> (Tensor, Option<Tensor>) {
        // The rollout holds the policy's memory before each row, so that every row is a sequence of
        // its own.
        let rows = Scene::of_batch(batch, 1, &batch.memory, &batch.policy_graph);
        let value = |scene: &Scene, state: &Tensor| {
            self.value_head().forward(&self.represent(scene).representation, state)
        };
        (rows.in_parts(&batch.state, value), None)
    }
}

/// A decoder of actions, agent by agent in the order of slots.
pub(super) struct Sequence {
    decoder: TransformerDecoder,
    pub(super) head: PolicyHead,
    /// Number of numbers with which an action is read.
    actions: i64,
}

/// The order of decisions in rows `[B]`: which agents are present, and whose action each agent reads.
pub(super) struct Order {
    /// True where an agent is present, `[B, N]`.
    present: Tensor,
    /// Number, counted from 1, of the slot of the last present agent before each slot, `[B, N]`; 0
    /// where there is none.
    before: Tensor,
    /// 1 where an agent listens to the last present agent before it, `[B, N]`.
    heard: Tensor,
    /// Attention among the agents up to and including each agent.
    reach: Reach,
}

impl Order {
    /// Creates the order. `present: [B, N]` is 1 where an agent is present, `graph: [B, N, N]` is 1
    /// where the agent of the row listens to that of the column; `reach` is the graph for attention.
    pub(super) fn new(present: &Tensor, graph: &Tensor, reach: &Reach) -> Self {
        let agents = present.size()[1];
        let present = present.gt(0.5);
        let numbers = Tensor::arange(agents, (Kind::Int64, present.device())) + 1;
        let last = (numbers * present.to_kind(Kind::Int64)).cummax(1).0;
        // No slot comes before the first one.
        let before = last.narrow(1, 0, agents - 1).constant_pad_nd([1, 0]);
        let heard = graph
            .detach()
            .constant_pad_nd([1, 0])
            .gather(2, &before.unsqueeze(-1), false)
            .squeeze_dim(-1);
        Self { present, before, heard: heard.gt(0.5).to_kind(Kind::Float), reach: reach.causal() }
    }
}

impl Sequence {
    /// Creates the decoder, with relations for CommFormer, and the head, of as many actions as the
    /// environment has.
    pub(super) fn new(
        decoder: TransformerDecoder,
        builder: &mut ParameterBuilder,
        spec: &EnvSpec,
        settings: &Settings,
    ) -> Self {
        let head = PolicyHead::of_actor(builder, settings.network.hidden, spec, settings);
        Self { decoder, head, actions: spec.actions.encoded() as i64 }
    }

    /// Returns the terms of the policy's loss, whose ratio is that of each dimension of the action,
    /// and the value's loss on the active samples of a shard.
    pub(super) fn losses(
        &self,
        batch: &Batch,
        shard: &Shard,
        known: &Represented,
        value: &ValueHead,
        settings: &Settings,
        norm: &ValueNorm,
    ) -> (PolicyTerms, Tensor) {
        let Represented { representation, order, .. } = known;
        let values = shard.pick(&value.forward(representation, &shard.take(&batch.state)));
        let value = value_loss(batch, shard, &values, norm);
        let taken = self.head.encoded(&shard.take(&batch.action));
        let read = self.of_actions(representation, &taken, order);
        let (ppo, ratio) = (&settings.ppo, Ratio::PerDimension);
        (PolicyTerms::new(batch, shard, &self.head, &shard.pick(&read), ppo, ratio), value)
    }

    /// Returns the head's input for all agents at once, `[B, N, W]`, given the actions taken, as
    /// networks read them.
    fn of_actions(&self, representation: &Tensor, actions: &Tensor, order: &Order) -> Tensor {
        let width = actions.size()[2];
        let all = actions.constant_pad_nd([0, 0, 1, 0]);
        let previous =
            all.gather(1, &order.before.unsqueeze(-1).expand([-1, -1, width], false), false);
        let previous = previous * order.heard.unsqueeze(-1);
        self.decoder.forward(&previous, representation, &order.reach, &mut Decoded::default())
    }

    /// Decides agent by agent in all environments at once.
    pub(super) fn act(&self, input: &Observation, known: Represented, mode: &ActMode) -> Decision {
        let Represented { representation, order, memory, .. } = known;
        let (mut actions, mut log_probs, mut decoded) =
            (Vec::new(), Vec::new(), Decoded::default());
        let like = (Kind::Float, representation.device());
        let mut last = Tensor::zeros([representation.size()[0], 1, self.actions], like);
        for i in 0..representation.size()[1] {
            let of = |x: &Tensor| x.narrow(1, i, 1);
            let previous = &last * of(&order.heard).unsqueeze(-1);
            let read = self.decoder.forward(
                &previous,
                &of(&representation),
                &order.reach.up_to(i),
                &mut decoded,
            );
            let available = &input.available;
            let available =
                if available.numel() > 0 { of(available) } else { available.shallow_clone() };
            let (action, log_prob) = match mode {
                ActMode::Deterministic => {
                    self.head.sample(&read, &available, &ActMode::Deterministic)
                }
                ActMode::Sample { action, carried, graph, log_fresh } => {
                    let carried =
                        if carried.numel() > 0 { of(carried) } else { carried.shallow_clone() };
                    let (graph, log_fresh) = (graph.shallow_clone(), log_fresh.clone());
                    let mode = ActMode::Sample { action: of(action), carried, graph, log_fresh };
                    self.head.sample(&read, &available, &mode)
                }
            };
            last = self.head.encoded(&action).where_self(&of(&order.present).unsqueeze(-1), &last);
            actions.push(action);
            log_probs.push(log_prob);
        }
        let (action, log_prob) = (Tensor::cat(&actions, 1), Tensor::cat(&log_probs, 1));
        Decision { action, log_prob, memory: input.memory_after(memory) }
    }
}
