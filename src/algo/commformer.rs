//! CommFormer: MAT over a static communication graph that is learned (Hu et al. 2024, "Learning
//! multi-agent communication from graph modeling perspective"; charleshsc/CommFormer, `cformer.py`,
//! `transformer_policy.py`, `mat_trainer.py`, with `--dec_actor`).
//!
//! 1. graph: each agent listens to the `sparsity · N` agents (at least one) with the highest scores
//!    in its row of the score matrix; all scores are 1 at first; the agent itself may be among the
//!    chosen agents, although it always listens to itself (`edges`, `edge_return`)
//! 2. relations: linked and not linked each have an embedding, from which every attention layer
//!    makes a vector added to queries and one added to keys; scores are scaled twice
//!    (`RelationMultiheadAttention`)
//! 3. attention: agents that are not linked have weight 0; agents always listen to themselves
//! 4. bi-level optimisation: every fifth pass over a rollout trains the scores alone, and the others
//!    train everything else (`mat_trainer.py`); passes are counted over all rollouts
//! 5. encoder blocks have a rectifier, decoder blocks are those of MAT; each dimension of the
//!    action has its own ratio
//!
//! Differences on purpose:
//!
//! - Each world samples one graph per rollout, with the logistic noise of all methods with graphs,
//!   and an update sees the graph that acted. Reference: no noise in acting and new Gumbel noise in
//!   every update, so that ratios compare different graphs.
//! - There is no warm-up of ten updates with the complete graph, because noise tries all links.
//! - Every link has weight 1. Reference: an agent's link to itself has weight 2 where it is also
//!   chosen.
//! - A pair is linked where its edge is above ½. Reference: edges are cut to integers, which is the
//!   same after the warm-up, because (1 − s) + s is 1 for every 32-bit number s from 0 to 1.
//! - Weights are proportional to the graph's entry times the exponential of the attention's score,
//!   so that a closed link has a gradient as well. Reference: the weights after the softmax are
//!   multiplied by the graph, so that only open links have one.
//! - The score of a pair reads whether the listener listens to the sender (reference: whether the
//!   sender listens to the listener), from embeddings that begin small (reference: of deviation 1).
//! - There is no dropout, because it changes the ratio. Reference: a rate of 0.1.
//! - One action head serves all agents. Reference: one head for each agent.
//! - Edges beyond the radio range do not exist, and an agent reads the previous agent's action only
//!   if it listens to that agent.
//!
//! Observation encoder, value, noise, shared advantages and absent agents are as in
//! [`mat`](super::mat).
//! `commformer.lambda_world` adds IWoL's world decoder.
//!
//! Shapes: scores of the links `[N, N]`, row = listener; graph `[rows, N, N]`; representations
//! `[rows, N, H]`.
//!
//! The graph links N slots, so that a policy serves only as many agents as it was trained with,
//! though some may be absent. Their links are not given to others, as in the reference, whose graph
//! does not change while agents are gone either: where few agents are left, some hear nobody. Where slots are assigned anew in each episode, as on the
//! intersection, no link is better than another, and the graph has nothing to learn.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use smart_default::SmartDefault;
use tch::{Kind, Tensor};

use super::CommunicationScope;
use super::batch::{Batch, EDGES, Shard};
use super::critic::ValueFunction;
use super::decision::{ActMode, Decision, Observation, Reconstruction};
use super::decoder::WorldDecoder;
use super::iwol::Iwol;
use super::networks::{HEADS, Loss, Networks};
use super::parameters::{ACTOR, ParameterBuilder, ParameterGroup};
use super::policy::PolicyHead;
use super::scene::Scene;
use super::sequence::{Input, Order, Represented, Represents, Sequence, ValueHead};
use super::settings::Settings;
use crate::env::EnvSpec;
use crate::nn::graph::{sample_best, with_self_loops};
use crate::nn::{AdamConfig, Init, Reach, RelationBlock, TransformerDecoder, ValueNorm};

/// Settings of CommFormer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema, SmartDefault)]
#[serde(deny_unknown_fields)]
#[schemars(default)]
pub struct CommFormerSettings {
    /// Share of the agents that each agent listens to.
    #[default = 0.4]
    #[schemars(range(max = 1), extend("exclusiveMinimum" = 0))]
    pub sparsity: f64,
    /// Weight of the loss of a world decoder on the representations, as in Ex-IWoL (paper, RQ3:
    /// 0.05); 0: no decoder.
    #[schemars(range(min = 0))]
    pub lambda_world: f64,
}

/// Period of graph training in passes over rollouts: the last pass of each period trains the graph
/// alone, the others train everything else (`mat_trainer.py`).
const GRAPH_EVERY: usize = 5;
/// Learning rate of the graph, as a share of that of the other parameters (reference: 1e-4 and
/// 5e-4).
const GRAPH_RATE: f64 = 0.2;

/// The group of the graph's scores.
const GRAPH: ParameterGroup = ParameterGroup {
    name: "graph",
    gradient: "the graph's gradient",
    norm: "ppo/grad_norm_graph",
    adam: AdamConfig::TORCH,
};

/// The networks of CommFormer (communication transformer).
pub(super) struct CommFormer {
    /// Scores of the links, `[N, N]`, row = listener.
    edges: Tensor,
    /// Number of agents that each agent listens to.
    links: i64,
    /// Embeddings of the two relations (not linked, linked), `[2, H]`.
    relations: Tensor,
    input: Input,
    blocks: Vec<RelationBlock>,
    value: ValueHead,
    sequence: Sequence,
    world: Option<WorldDecoder>,
}

impl Represents for CommFormer {
    fn represent(&self, scene: &Scene) -> Represented {
        let (x, memory) = self.input.forward(scene);
        let scores = self.edges.unsqueeze(0);
        let scores =
            scene.noise.as_ref().map_or_else(|| scores.shallow_clone(), |noise| &scores + noise);
        let links = sample_best(&scores, self.links) * &scene.comm;
        let graph = with_self_loops(&links);
        let reach = Reach::over(&graph, &links.gt(0.5).to_kind(Kind::Float));
        let representation =
            self.blocks.iter().fold(x, |x, block| block.forward(&x, &reach, &self.relations));
        let order = Order::new(&scene.present(), &graph, &reach);
        Represented { representation, order, graph, memory }
    }

    fn value_head(&self) -> &ValueHead {
        &self.value
    }
}

impl Networks for CommFormer {
    const NAME: &'static str = "commformer";
    const SCOPE: CommunicationScope = CommunicationScope::InRange;
    const SETTINGS: &'static [&'static str] = &["commformer", "transformer", "iwol"];
    const UNREAD: &'static [&'static str] = Iwol::ALL_BUT_DECODED;
    const GRAPH_LASTS: bool = true;
    const TRAINING_ONLY: &'static [&'static str] = &["value.", "world."];
    const PER_AGENT: Option<&'static str> = Some("graph/edges");

    fn new(spec: &EnvSpec, settings: &Settings, builder: &mut ParameterBuilder) -> Self {
        let (hidden, actions, agents) =
            (settings.network.hidden, spec.actions.encoded() as i64, spec.agents as i64);
        let count = settings.transformer.blocks;
        let relations = builder.of(ACTOR).create("relations", &[2, hidden], Init::Normal(0.02));
        let block = |i| RelationBlock::new(builder.of(ACTOR).sub("blocks").sub(i), hidden, HEADS);
        let blocks = (0..count).map(block).collect();
        let (mut path, related) = (builder.of(ACTOR), Some(&relations));
        let path = path.sub("decoder");
        let decoder = TransformerDecoder::new(path, actions, hidden, count, HEADS, related);
        let lambda = settings.commformer.lambda_world;
        Self {
            edges: builder.of(GRAPH).create("edges", &[agents, agents], Init::Constant(1.0)),
            links: ((agents as f64 * settings.commformer.sparsity) as i64).clamp(1, agents),
            relations,
            input: Input::new(builder.of(ACTOR), spec, settings),
            blocks,
            value: ValueHead::new(builder.of(ACTOR).sub("value"), spec, hidden),
            sequence: Sequence::new(decoder, builder, spec, settings),
            world: WorldDecoder::of_actor(builder, spec, settings, hidden, lambda),
        }
    }

    fn rate(group: ParameterGroup, pass: usize, learning_rate: f64) -> Option<f64> {
        let trains_graph = (pass + 1).is_multiple_of(GRAPH_EVERY);
        if group == GRAPH {
            trains_graph.then_some(learning_rate * GRAPH_RATE)
        } else {
            (!trains_graph).then_some(learning_rate)
        }
    }

    fn head(&self) -> &PolicyHead {
        &self.sequence.head
    }

    fn memory(&self) -> i64 {
        self.input.memory()
    }

    fn graph_noise(&self, agents: i64) -> i64 {
        agents
    }

    fn critic(&self) -> &dyn ValueFunction {
        self
    }

    fn act(&self, input: &Observation, mode: &ActMode) -> Decision {
        self.sequence.act(input, self.represent(&Scene::of(input, mode.graph_noise())), mode)
    }

    fn graph(&self, input: &Observation) -> Option<Tensor> {
        Some(self.represent(&Scene::of(input, None)).graph)
    }

    fn loss(&self, batch: &Batch, shard: &Shard, settings: &Settings, norm: &ValueNorm) -> Loss {
        let scene = Scene::of_shard(batch, shard, &batch.memory, &batch.policy_graph);
        let known = self.represent(&scene);
        let [open, possible] = shard.edges(&known.graph, &scene.comm);
        let (policy, value) =
            self.sequence.losses(batch, shard, &known, &self.value, settings, norm);
        let world =
            |world: &WorldDecoder| world.loss(batch, shard, &shard.pick(&known.representation));
        Loss::new(
            &policy.loss + &value,
            &value,
            [(EDGES[0], &open), (EDGES[1], &possible)],
            &policy,
        )
        .with_world(settings.commformer.lambda_world, self.world.as_ref().map(world))
    }

    fn reconstruct(&self, input: &Observation, state: &Tensor) -> Vec<Reconstruction> {
        let reconstruct = |world: &WorldDecoder| {
            world.reconstruct(&self.represent(&Scene::of(input, None)).representation, state)
        };
        self.world.as_ref().map(reconstruct).into_iter().collect()
    }
}
