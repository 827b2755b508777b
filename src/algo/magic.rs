//! MAGIC: two rounds of graph attention, each over its own learned graph (Niu et al. 2021,
//! "Multi-agent graph-attention communication and teaming"; CORE-Robotics-Lab/MAGIC, `magic.py`,
//! `gnn_layers.py`).
//!
//! 1. in each round, a scheduler decides on the edges from the agents' embeddings, by a hard
//!    Gumbel-softmax (`sub_scheduler_mlp1`, `sub_scheduler_mlp2`)
//! 2. the first round has attention with four heads side by side (scripts of traffic junction and
//!    predator-prey; football's has one) and an ELU; the second round has one head
//!    (`sub_processor1`, `sub_processor2`)
//! 3. attention weights are normalised over the edges (`GATLayer`)
//! 4. the policy reads [f; m] (`action_head`)
//!
//! Shapes: embeddings f and messages m `[P, H]` of the P present agents; graphs of both rounds
//! `[rows, N, N]`, row = listener, with noise `[rows, N, 2 · N]`.
//!
//! Differences on purpose:
//!
//! - Observation encoder, proximal policy optimisation and Gaussian head are those of all methods
//!   (reference: LSTM, REINFORCE, discrete actions). `presets/magic_reinforce.toml` trains by
//!   REINFORCE with the value as baseline, as the reference does.
//! - A separate value function reads the privileged state (reference: hidden state and message).
//! - Agents always listen to themselves (reference: with complete graphs they do; with learned
//!   graphs this is learned as well).
//! - Schedulers read the embeddings directly, and messages are sent as they are (football's script:
//!   another attention before the schedulers, and layers that encode and decode messages).
//! - Graphs are learned in every task (scripts for the traffic junction: complete graphs, and a layer
//!   that decodes messages).
//! - Edges beyond the radio range do not exist.
//! - The noise of the graphs is stored with the rollout, and evaluation has none (reference: always
//!   new noise).
//! - `magic.lambda_world` adds IWoL's world decoder.
//! - Shared advantages and the scale of the graphs' noise are those of [all methods](super).

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use tch::Tensor;

use super::CommunicationScope;
use super::batch::{Batch, EDGES, Shard};
use super::channel::{Channel, ChannelNoise, exchange, of_everyone, of_receivers};
use super::critic::{PrivilegedCritic, ValueFunction, value_loss};
use super::decision::{ActMode, Decision, Observation, Reconstruction};
use super::decoder::WorldDecoder;
use super::encoder::Encoder;
use super::iwol::Iwol;
use super::networks::{HEADS, Loss, Networks};
use super::parameters::{ACTOR, CRITIC, ParameterBuilder};
use super::policy::{PolicyHead, PolicyTerms, Ratio};
use super::radio::Radio;
use super::scene::{Messages, Scene};
use super::settings::Settings;
use crate::env::EnvSpec;
use crate::nn::{Graph, GraphAttention, Packing, Scheduler, ValueNorm};

/// Settings of MAGIC.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(default)]
pub struct MagicSettings {
    /// Weight of the loss of a world decoder on the messages, as in Ex-IWoL (paper, RQ3: 0.05); 0:
    /// no decoder.
    #[schemars(range(min = 0))]
    pub lambda_world: f64,
}

/// The networks of MAGIC (multi-agent graph-attention communication).
pub(super) struct Magic {
    encoder: Encoder,
    schedulers: [Scheduler; 2],
    rounds: [GraphAttention; 2],
    head: PolicyHead,
    world: Option<WorldDecoder>,
    critic: PrivilegedCritic,
    hidden: i64,
    radio: Option<Radio>,
}

impl Magic {
    /// Returns messages `[P, H]` and the graphs of both rounds, from embeddings `f: [P, H]`.
    /// `physical: [rows, N, N]` is 1 where an agent can hear another one, `noise` is
    /// `[rows, N, 2 N]`.
    fn communicate(
        &self,
        f: &Tensor,
        packing: &Packing,
        physical: &Tensor,
        noise: Option<&Tensor>,
    ) -> (Tensor, [Tensor; 2]) {
        let agents = physical.size()[2];
        let graph = |round: usize| {
            let noise = noise.map(|noise| noise.narrow(2, round as i64 * agents, agents));
            self.schedulers[round].forward(f, packing, physical, noise.as_ref())
        };
        let graphs = [graph(0), graph(1)];
        let first = self.rounds[0].forward(f, packing, &graphs[0]).elu();
        (self.rounds[1].forward(&first, packing, &graphs[1]), graphs)
    }

    /// Returns each receiver's message, `[rows · N, H]`, and its rows of the graphs of both rounds,
    /// from the embeddings that it knows, `[rows · N, N, H]`, and 1 where one `arrived`,
    /// `[rows · N, 1, N]`. `physical` and `noise` are those of [`Magic::communicate`].
    fn read(
        &self,
        known: &Tensor,
        physical: &Tensor,
        arrived: &Tensor,
        noise: Option<&Tensor>,
    ) -> (Tensor, [Tensor; 2]) {
        let (rows, agents, _) = known.size3().expect("embeddings are [rows · N, N, H]");
        let packing = Packing::full(rows, agents);
        let edges = of_everyone(physical) * arrived;
        let noise = noise.map(of_everyone);
        let (made, graphs) =
            self.communicate(&known.flatten(0, 1), &packing, &edges, noise.as_ref());
        (of_receivers(&packing.unpack(&made)), graphs.map(|graph| of_receivers(&graph)))
    }

    /// Computes the messages. They pass through the radio of training, or arrive as they were sent.
    fn exchange(&self, scene: &Scene, radio: Option<&Radio>) -> Messages {
        if let Some(radio) = radio {
            return radio.exchange(&self.encoder, scene, |known, arrived| {
                let (made, [first, second]) =
                    self.read(known, &scene.comm, arrived, scene.noise.as_ref());
                (made, first.maximum(&second))
            });
        }
        let packing = scene.packing();
        let (embedding, memory) = scene.embed_packed(&self.encoder, &packing);
        let (message, [first, second]) =
            self.communicate(&embedding, &packing, &scene.comm, scene.noise.as_ref());
        let graph = Graph::Full(first.maximum(&second));
        Messages { message, embedding, graph, packing, memory }
    }
}

impl Networks for Magic {
    const NAME: &'static str = "magic";
    const SCOPE: CommunicationScope = CommunicationScope::InRange;
    const MESSAGES: bool = true;
    const SETTINGS: &'static [&'static str] = &["magic", "iwol"];
    const UNREAD: &'static [&'static str] = Iwol::ALL_BUT_DECODED;
    const TRAINING_ONLY: &'static [&'static str] = &["world."];

    fn new(spec: &EnvSpec, settings: &Settings, builder: &mut ParameterBuilder) -> Self {
        let (network, hidden) = (&settings.network, settings.network.hidden);
        // Four heads, each with a quarter of the width.
        let width = hidden / HEADS;
        let lambda = settings.magic.lambda_world;
        Self {
            encoder: Encoder::new(builder.of(ACTOR).sub("encoder"), &spec.observation, network),
            schedulers: [0, 1]
                .map(|i| Scheduler::new(builder.of(ACTOR).sub("scheduler").sub(i), hidden)),
            rounds: [
                GraphAttention::new(
                    builder.of(ACTOR).sub("round").sub(0),
                    hidden,
                    HEADS,
                    width,
                    true,
                ),
                GraphAttention::new(
                    builder.of(ACTOR).sub("round").sub(1),
                    HEADS * width,
                    1,
                    hidden,
                    false,
                ),
            ],
            head: PolicyHead::of_actor(builder, 2 * hidden, spec, settings),
            world: WorldDecoder::of_actor(builder, spec, settings, hidden, lambda),
            critic: PrivilegedCritic::new(builder.of(CRITIC), spec, network),
            hidden,
            radio: Radio::new(settings, spec.observation.len(), hidden, 2, builder.device()),
        }
    }

    fn head(&self) -> &PolicyHead {
        &self.head
    }

    fn memory(&self) -> i64 {
        self.encoder.memory()
    }

    fn graph_noise(&self, agents: i64) -> i64 {
        2 * agents
    }

    fn critic(&self) -> &dyn ValueFunction {
        &self.critic
    }

    fn act(&self, input: &Observation, mode: &ActMode) -> Decision {
        let radio = Radio::in_use(self.radio.as_ref(), mode);
        let Messages { message, embedding, packing, memory, .. } =
            self.exchange(&Scene::of(input, mode.graph_noise()), radio);
        let read = packing.unpack(&Tensor::cat(&[&embedding, &message], -1));
        let (action, log_prob) = self.head.sample(&read, &input.available, mode);
        Decision { action, log_prob, memory: Radio::memory_after(radio, input, memory) }
    }

    fn radio(&self) -> Option<&Radio> {
        self.radio.as_ref()
    }

    fn message_width(&self) -> i64 {
        self.hidden
    }

    fn act_through(
        &self,
        input: &Observation,
        channel: &Channel,
        noise: &ChannelNoise,
    ) -> Decision {
        let (message, f, memory) =
            exchange(&self.encoder, input, channel, noise, |known, arrived| {
                self.read(known, &input.comm, arrived, None).0
            });
        let (action, log_prob) = {
            let read = Tensor::cat(&[&f, &message], -1);
            self.head.sample(&read, &input.available, &ActMode::Deterministic)
        };
        Decision { action, log_prob, memory }
    }

    fn graph(&self, input: &Observation) -> Option<Tensor> {
        Some(self.exchange(&Scene::of(input, None), None).full_graph())
    }

    fn loss(&self, batch: &Batch, shard: &Shard, settings: &Settings, norm: &ValueNorm) -> Loss {
        let value = value_loss(batch, shard, &self.critic.shard(batch, shard), norm);
        let scene = Scene::of_shard(batch, shard, &batch.memory, &batch.policy_graph);
        let messages = self.exchange(&scene, self.radio.as_ref());
        let [open, possible] = messages.edges(shard, &scene);
        let [message, embedding] =
            shard.unpacked(&messages.packing, [&messages.message, &messages.embedding]);
        let read = Tensor::cat(&[&embedding, &message], -1);
        let policy = PolicyTerms::new(batch, shard, &self.head, &read, &settings.ppo, Ratio::Joint);
        Loss::new(
            &policy.loss + &value,
            &value,
            [(EDGES[0], &open), (EDGES[1], &possible)],
            &policy,
        )
        .with_world(
            settings.magic.lambda_world,
            self.world.as_ref().map(|world| world.loss(batch, shard, &message)),
        )
    }

    fn reconstruct(&self, input: &Observation, state: &Tensor) -> Vec<Reconstruction> {
        let reconstruct = |world: &WorldDecoder| {
            let messages = self.exchange(&Scene::of(input, None), None);
            world.reconstruct(&messages.packing.unpack(&messages.message), state)
        };
        self.world.as_ref().map(reconstruct).into_iter().collect()
    }
}
