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
//! and sequence (reference: of the loss alone); and what is common to [all methods](super).
//!
//! Shapes: representations `[rows, N, H]`; previous actions `[rows, N, A]`; values `[rows, N]`.
//!
//! Execution is central: one place needs the observations of all agents.

use tch::Tensor;

use super::CommunicationScope;
use super::batch::{Batch, Shard};
use super::critic::ValueFunction;
use super::decision::{ActMode, Decision, Observation};
use super::networks::{HEADS, Loss, Networks};
use super::parameters::{ACTOR, ParameterBuilder};
use super::policy::PolicyHead;
use super::scene::Scene;
use super::sequence::{Input, Order, Represented, Represents, Sequence, ValueHead};
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

impl Represents for Mat {
    fn represent(&self, scene: &Scene) -> Represented {
        let (rows, agents) = scene.size();
        let (x, memory) = self.input.forward(scene);
        let present = scene.present();
        let seen = with_self_loops(&present.unsqueeze(1).expand([-1, agents, -1], false));
        let (reach, packing) = (Reach::of(&seen), Packing::full(rows, agents));
        let forward =
            |x: Tensor, block: &Block| block.forward(&x, &packing, Mask::Add(reach.bias()));
        let x = self.blocks.iter().fold(x.flatten(0, 1), forward);
        let order = Order::new(&present, &seen, &reach);
        Represented { representation: packing.unpack(&x), order, graph: seen, memory }
    }

    fn value_head(&self) -> &ValueHead {
        &self.value
    }
}

impl Networks for Mat {
    const NAME: &'static str = "mat";
    const SCOPE: CommunicationScope = CommunicationScope::All;
    const SETTINGS: &'static [&'static str] = &["transformer"];
    const TRAINING_ONLY: &'static [&'static str] = &["value."];

    fn new(spec: &EnvSpec, settings: &Settings, builder: &mut ParameterBuilder) -> Self {
        let (hidden, count) = (settings.network.hidden, settings.transformer.blocks);
        let block = |i| Block::new(builder.of(ACTOR).sub("blocks").sub(i), hidden, HEADS);
        let blocks = (0..count).map(block).collect();
        let input = Input::new(builder.of(ACTOR), spec, settings);
        let value = ValueHead::new(builder.of(ACTOR).sub("value"), spec, hidden);
        let (mut path, actions) = (builder.of(ACTOR), spec.actions.encoded() as i64);
        let path = path.sub("decoder");
        let decoder = TransformerDecoder::new(path, actions, hidden, count, HEADS, None);
        let sequence = Sequence::new(decoder, builder, spec, settings);
        Self { input, blocks, value, sequence }
    }

    fn head(&self) -> &PolicyHead {
        &self.sequence.head
    }

    fn memory(&self) -> i64 {
        self.input.memory()
    }

    fn critic(&self) -> &dyn ValueFunction {
        self
    }

    fn act(&self, input: &Observation, mode: &ActMode) -> Decision {
        self.sequence.act(input, self.represent(&Scene::of(input, None)), mode)
    }

    fn loss(&self, batch: &Batch, shard: &Shard, settings: &Settings, norm: &ValueNorm) -> Loss {
        let scene = Scene::of_shard(batch, shard, &batch.memory, &batch.policy_graph);
        let known = self.represent(&scene);
        let (policy, value) =
            self.sequence.losses(batch, shard, &known, &self.value, settings, norm);
        Loss::new(&policy.loss + &value, &value, [], &policy)
    }
}
