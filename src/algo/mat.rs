//! MAT: the agents of an environment as a sequence whose actions are decoded one after another (Wen
//! et al. 2022, "Multi-agent reinforcement learning is a sequence modeling problem";
//! PKU-MARL/Multi-Agent-Transformer, `ma_transformer.py`, `transformer_act.py`, `mat_trainer.py`).
//!
//! 1. encoder: post-norm blocks of attention among all agents, without an embedding of an agent's
//!    position or identity (`EncodeBlock`, `Encoder`)
//! 2. value of each agent from its representation (`Encoder.head`)
//! 3. decoder: each agent reads the previous agent's action (zeros for the first agent); attention
//!    goes among the actions so far, then from the agent's representation to them, with the
//!    representation as residual (`DecodeBlock`, `TransformerDecoder`)
//! 4. acting decodes one agent after another; an update decodes all agents at once from the actions
//!    taken (`continuous_autoregreesive_act`, `continuous_parallel_act`)
//! 5. each dimension of the action has its own clipped ratio, and the surrogates are added
//!    (`mat_trainer.py`)
//! 6. one optimiser for all parameters; the value's gradient reaches the encoder
//!
//! Differences on purpose: the observation encoder of all methods comes first; the value also reads
//! the privileged state, as in most methods; the Gaussian head and its noise are those of all
//! methods (reference: standard deviation ½ σ(parameter)); absent agents are left out of attention
//! and sequence (reference: of the loss alone).
//!
//! Shapes: representations `[rows, N, H]`; previous actions `[rows, N, A]`; values `[rows, N]`.
//!
//! Execution is central: one place needs the observations of all agents.

use tch::Tensor;

use super::CommunicationScope;
use super::batch::{Batch, Shard};
use super::critic::{ValueFunction, value_loss};
use super::decision::{ActMode, Decision, Observation};
use super::head::{GaussianHead, PolicyTerms, Ratio};
use super::networks::{Loss, Networks};
use super::parameters::{ACTOR, ParameterBuilder};
use super::scene::Scene;
use super::sequence::{Input, Order, Sequence, ValueHead};
use super::settings::Settings;
use crate::env::EnvSpec;
use crate::nn::graph::with_self_loops;
use crate::nn::transformer::Block;
use crate::nn::{Mask, Packing, Reach, TransformerDecoder, ValueNorm};

/// The networks of MAT (multi-agent transformer).
pub(super) struct Mat {
    input: Input,
    blocks: Vec<Block>,
    value: ValueHead,
    sequence: Sequence,
}

impl Mat {
    /// Returns the representations of all agents, `[rows, N, H]`, the order in which agents decide,
    /// and the memory after the last step.
    fn represent(&self, scene: &Scene) -> (Tensor, Order, Option<Tensor>) {
        let (rows, agents) = scene.size();
        let (x, memory) = self.input.forward(scene);
        let present = scene.present();
        let seen = with_self_loops(&present.unsqueeze(1).expand([-1, agents, -1], false));
        let (reach, packing) = (Reach::of(&seen), Packing::full(rows, agents));
        let forward =
            |x: Tensor, block: &Block| block.forward(&x, &packing, Mask::Add(reach.bias()));
        let x = self.blocks.iter().fold(x.flatten(0, 1), forward);
        (packing.unpack(&x), Order::new(&present, &seen, &reach), memory)
    }
}

impl Networks for Mat {
    const NAME: &'static str = "mat";
    const SCOPE: CommunicationScope = CommunicationScope::All;
    const SETTINGS: &'static [&'static str] = &["transformer"];
    const TRAINING_ONLY: &'static [&'static str] = &["value."];

    fn new(spec: &EnvSpec, settings: &Settings, builder: &mut ParameterBuilder) -> Self {
        let (hidden, actions, transformer) =
            (settings.network.hidden, spec.actions.len() as i64, &settings.transformer);
        let (count, heads) = (transformer.blocks, transformer.heads);
        let block = |i| Block::new(builder.of(ACTOR).sub("blocks").sub(i), hidden, heads);
        let blocks = (0..count).map(block).collect();
        Self {
            input: Input::new(builder.of(ACTOR), spec, settings),
            blocks,
            value: ValueHead::new(builder.of(ACTOR).sub("value"), spec, hidden),
            sequence: Sequence {
                decoder: TransformerDecoder::new(
                    builder.of(ACTOR).sub("decoder"),
                    actions,
                    hidden,
                    count,
                    heads,
                    None,
                ),
                head: GaussianHead::of_actor(builder, hidden, spec, settings),
                actions,
            },
        }
    }

    fn head(&self) -> &GaussianHead {
        &self.sequence.head
    }

    fn memory(&self) -> i64 {
        self.input.memory()
    }

    fn critic(&self) -> &dyn ValueFunction {
        self
    }

    fn act(&self, input: &Observation, mode: &ActMode<'_>) -> Decision {
        let (representation, order, memory) = self.represent(&Scene::of(input, None));
        let (action, log_prob) = self.sequence.act(&representation, &order, mode);
        Decision { action, log_prob, memory: input.memory_after(memory) }
    }

    fn loss(&self, batch: &Batch, shard: &Shard, settings: &Settings, norm: &ValueNorm) -> Loss {
        let scene = Scene::of_shard(batch, shard, &batch.memory, &batch.policy_graph);
        let (representation, order, _) = self.represent(&scene);
        let values = shard.pick(&self.value.forward(&representation, &shard.take(&batch.state)));
        let value = value_loss(batch, shard, &values, norm, &settings.ppo);
        let read = self.sequence.of_actions(&representation, &shard.take(&batch.action), &order);
        let policy = PolicyTerms::new(
            batch,
            shard,
            self.head(),
            &shard.pick(&read),
            &settings.ppo,
            Ratio::PerDimension,
        );
        Loss::new(&policy.loss + &value, &value, [], &policy)
    }
}

impl ValueFunction for Mat {
    fn memory(&self) -> i64 {
        0
    }

    fn value(&self, input: &Observation, state: &Tensor) -> Option<Tensor> {
        Some(self.value.forward(&self.represent(&Scene::of(input, None)).0, state))
    }

    fn values(&self, batch: &Batch, _length: i64, _memory: &Tensor) -> (Tensor, Option<Tensor>) {
        // The rollout holds the policy's memory before each row, so that every row is a sequence of
        // its own.
        let rows = Scene::of_batch(batch, 1, &batch.memory, &batch.policy_graph);
        let values = rows.in_parts(&batch.state, |scene, state| {
            self.value.forward(&self.represent(scene).0, state)
        });
        (values, None)
    }
}
