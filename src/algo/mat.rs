//! MAT: the agents of an environment as a sequence, whose actions are decoded one after another (Wen et al. 2022, "Multi-agent
//! reinforcement learning is a sequence modeling problem"; PKU-MARL/Multi-Agent-Transformer, `ma_transformer.py`,
//! `transformer_act.py`, `mat_trainer.py`).
//!
//! 1. encoder: post-norm blocks of attention among all agents, no place or name of an agent (`EncodeBlock`, `Encoder`)
//! 2. value of each agent from its representation (`Encoder.head`)
//! 3. decoder: an agent reads the action before its own, zeros for the first; attention among the actions so far, then from its
//!    representation to those, whose residual is the representation (`DecodeBlock`, `Decoder`)
//! 4. acting decodes one agent after another, an update all at once from the actions taken
//!    (`continuous_autoregreesive_act`, `continuous_parallel_act`)
//! 5. a clipped ratio for each dimension of the action, whose surrogates are added (`mat_trainer.py`)
//! 6. one optimiser for everything; the gradient of the value reaches the encoder
//!
//! It differs on purpose: the observation encoder that all methods share comes first; the value also reads the privileged
//! state, as every method's does; the Gaussian head and its noise are the common ones (reference: deviation ½ σ(parameter));
//! agents who are gone are left out of attention and sequence (reference: of the loss alone).
//!
//! One place decides for all: every agent's observation is needed there.

use tch::Tensor;

use super::batch::{Batch, Shard};
use super::core::{Loss, Networks};
use super::head::{GaussianHead, PolicyTerms, Ratio};
use super::parameters::{ACTOR, Places};
use super::scene::Scene;
use super::sequence::{Input, Order, Sequence, ValueHead};
use super::{ActMode, Decision, Hears, Observation, Settings, ppo};
use crate::env::EnvSpec;
use crate::nn::graph::with_self_loops;
use crate::nn::transformer::Block;
use crate::nn::{Decoder, Mask, Packing, Reach, ValueNorm};

/// Multi-agent transformer.
pub(super) struct Mat {
    input: Input,
    blocks: Vec<Block>,
    value: ValueHead,
    sequence: Sequence,
}

impl Mat {
    /// Representations of everyone, `[rows, N, H]`, the order in which they decide, and the memory after the last step.
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
    const HEARS: Hears = Hears::Everyone;
    const SETTINGS: &'static [&'static str] = &["transformer"];
    const TRAINING_ONLY: &'static [&'static str] = &["value."];

    fn new(spec: &EnvSpec, settings: &Settings, places: &mut Places) -> Self {
        let (hidden, actions, transformer) =
            (settings.network.hidden, spec.actions.len() as i64, &settings.transformer);
        let (count, heads) = (transformer.blocks, transformer.heads);
        let block = |i| Block::new(places.of(ACTOR).sub("blocks").sub(i), hidden, heads);
        let blocks = (0..count).map(block).collect();
        Self {
            input: Input::new(places.of(ACTOR), spec, settings),
            blocks,
            value: ValueHead::new(places.of(ACTOR).sub("value"), spec, hidden),
            sequence: Sequence {
                decoder: Decoder::new(
                    places.of(ACTOR).sub("decoder"),
                    actions,
                    hidden,
                    count,
                    heads,
                    None,
                ),
                head: GaussianHead::new(
                    places.of(ACTOR).sub("head"),
                    hidden,
                    &spec.actions,
                    &settings.exploration,
                ),
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

    fn act(&self, input: &Observation, mode: &ActMode<'_>) -> Decision {
        let (representation, order, memory) = self.represent(&Scene::of(input, None));
        let (action, log_prob) = self.sequence.act(&representation, &order, mode);
        let memory = memory
            .map_or_else(|| input.memory.shallow_clone(), |memory| memory.view_as(&input.memory));
        Decision { action, log_prob, memory }
    }

    fn value(&self, input: &Observation, state: &Tensor) -> Option<Tensor> {
        Some(self.value.forward(&self.represent(&Scene::of(input, None)).0, state))
    }

    fn values(&self, batch: &Batch, _length: i64, _memory: &Tensor) -> (Tensor, Option<Tensor>) {
        // The policy's own memory is known before each row.
        let rows = Scene::of_batch(batch, 1, &batch.memory, &batch.policy_graph);
        let values = rows.in_parts(&batch.state, |scene, state| {
            self.value.forward(&self.represent(scene).0, state)
        });
        (values, None)
    }

    fn loss(&self, batch: &Batch, shard: &Shard, settings: &Settings, norm: &ValueNorm) -> Loss {
        let scene = Scene::of_shard(batch, shard, &batch.memory, &batch.policy_graph);
        let (representation, order, _) = self.represent(&scene);
        let values = shard.pick(&self.value.forward(&representation, &shard.take(&batch.state)));
        let value = ppo::value_terms(batch, shard, &values, norm, &settings.ppo);
        let read = self.sequence.of_actions(&representation, &shard.take(&batch.action), &order);
        let policy = PolicyTerms::new(
            batch,
            shard,
            self.head(),
            &shard.pick(&read),
            &settings.ppo,
            Ratio::PerDimension,
        );
        let mut report = vec![("loss/value", value.detach())];
        report.extend(policy.report());
        Loss { total: &policy.loss + &value, report }
    }
}
