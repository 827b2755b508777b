//! The communication protocol of IWoL: embeddings, a learned graph cut by the physical mask, and
//! rounds of attention over the graph (paper: "Graph-attention Communication Protocol";
//! DongsuLeeTech/IWoL, `scheduler.py` and `transformer_comm.py`).

use tch::{Kind, Tensor};

use super::batch::{Batch, Shard};
use super::channel::{Channel, ChannelNoise, exchange, of_everyone, of_receivers};
use super::critic::ValueFunction;
use super::decision::Observation;
use super::encoder::Encoder;
use super::networks::HEADS;
use super::radio::Radio;
use super::scene::{Messages, Scene};
use super::settings::{Iwol, Network};
use crate::env::{EnvSpec, Features};
use crate::nn::{CommGraph, Graph, GraphTransformer, Init, Linear, Mlp, Neighbours, Packing, Path};

/// The message path: from the observations of all agents to embeddings f and messages m.
#[derive(Debug)]
pub(super) struct MessageTrunk {
    encoder: Encoder,
    graph: CommGraph,
    transformer: GraphTransformer,
    hidden: i64,
    /// Number K of neighbours in a list, where the graph has only edges to listed neighbours.
    most: Option<i64>,
}

/// A graph over lists of K neighbours takes less time than one of all pairs if there are more than
/// this many times as many agents (docs/lab/speed.md).
const AGENTS_PER_NEIGHBOUR: i64 = 8;

/// Returns the length of the lists of neighbours in graphs among the agents of an environment;
/// `None` where a graph of all pairs is no slower.
pub(super) fn most_listed(spec: &EnvSpec) -> Option<i64> {
    let most = spec.most_heard? as i64;
    (spec.agents as i64 > AGENTS_PER_NEIGHBOUR * most).then_some(most)
}

impl MessageTrunk {
    pub(super) fn new(
        mut path: Path<'_>,
        features: &Features,
        network: &Network,
        iwol: &Iwol,
        most: Option<i64>,
    ) -> Self {
        let (hidden, message) = (network.hidden, iwol.message);
        let transformer = path.sub("transformer");
        let transformer = GraphTransformer::new(transformer, hidden, message, iwol.rounds, HEADS);
        Self {
            encoder: Encoder::new(path.sub("encoder"), features, network),
            graph: CommGraph::new(path.sub("graph"), hidden, message, iwol.graph_bias),
            transformer,
            hidden,
            most,
        }
    }

    pub(super) fn memory(&self) -> i64 {
        self.encoder.memory()
    }

    /// Returns how many numbers per agent the noise of the graph has, among N agents.
    pub(super) fn graph_noise(&self, agents: i64) -> i64 {
        self.most.unwrap_or(agents)
    }

    /// Returns the width of an embedding, which is what agents send.
    pub(super) fn width(&self) -> i64 {
        self.hidden
    }

    /// Computes one decision in which embeddings pass through a channel. Returns messages
    /// `[E, N, D]`, the agents' own embeddings `[E, N, H]` and the memory. Each agent computes its
    /// own graph and messages from the embeddings that it received.
    pub(super) fn through(
        &self,
        input: &Observation,
        channel: &Channel,
        noise: &ChannelNoise,
    ) -> (Tensor, Tensor, Tensor) {
        // With one round, no agent passes on what it heard.
        let one = self.transformer.rounds() == 1;
        if one && channel.only_loses() {
            // A channel that only loses messages is a mask on the graph that all agents share.
            let scene = Scene::of(input, None);
            let heard =
                self.forward(&Scene { comm: &scene.comm * channel.arrived(noise), ..scene }, None);
            return (
                heard.packing.unpack(&heard.message),
                heard.packing.unpack(&heard.embedding),
                input.memory_after(heard.memory),
            );
        }
        exchange(&self.encoder, input, channel, noise, |known, arrived| {
            self.read(known, &input.comm, arrived, None).0
        })
    }

    /// Computes the message of each receiver, `[E · N, D]`, and the edges of its graph that lead to
    /// it, `[E · N, N]`, from the embeddings known there, `[E · N, N, H]`, and 1 where an embedding
    /// `arrived`, `[E · N, 1, N]`. `comm` is the physical mask and `noise` the graphs' noise, both
    /// `[E, N, N]`.
    fn read(
        &self,
        known: &Tensor,
        comm: &Tensor,
        arrived: &Tensor,
        noise: Option<&Tensor>,
    ) -> (Tensor, Tensor) {
        let (rows, agents, _) = known.size3().expect("embeddings are [rows, N, H]");
        if self.transformer.rounds() == 1 {
            let own = Tensor::arange(agents, (Kind::Int64, known.device())).repeat([rows / agents]);
            let edges = comm.reshape([rows, 1, agents]) * arrived;
            let noise = noise.map(|noise| noise.reshape([rows, agents]));
            let graph = self.graph.forward_one(known, &own, &edges, noise.as_ref());
            return (self.transformer.forward_one(known, &own, &graph), graph.squeeze_dim(1));
        }
        let edges = of_everyone(comm) * arrived;
        let (all, packing) = (known.reshape([rows * agents, -1]), Packing::full(rows, agents));
        let graph = self.graph.forward(&all, &packing, &edges, noise.map(of_everyone).as_ref());
        let graph = Graph::Full(graph);
        let made = packing.unpack(&self.transformer.forward(&all, &packing, &graph));
        (of_receivers(&made), of_receivers(&graph.full(&packing)))
    }

    /// Computes the message path. Messages pass through the radio of training. Without it, those that
    /// are not lost arrive as they were sent.
    pub(super) fn forward(&self, scene: &Scene, radio: Option<&Radio>) -> Messages {
        if let Some(radio) = radio {
            return radio.exchange(&self.encoder, scene, |known, arrived| {
                self.read(known, &scene.comm, arrived, scene.noise.as_ref())
            });
        }
        let packing = scene.packing();
        let (embedding, memory) = scene.embed_packed(&self.encoder, &packing);
        let (noise, heard) = (scene.noise.as_ref(), scene.heard());
        let graph = match self.most {
            None => Graph::Full(self.graph.forward(&embedding, &packing, &heard, noise)),
            Some(most) => {
                let neighbours = Neighbours::of(&heard, &packing, most);
                let noise = noise.map(|noise| packing.pack(noise));
                let edges = self.graph.forward_listed(&embedding, &neighbours, noise.as_ref());
                Graph::Listed { neighbours, edges }
            }
        };
        let message = self.transformer.forward(&embedding, &packing, &graph);
        Messages { message, embedding, graph, packing, memory }
    }
}

/// A critic on the message path: V(m, f) from local observations and messages only (paper:
/// decentralised value), or V(m, f, s) if the settings say so, with the agent's own view of the
/// privileged state.
#[derive(Debug)]
pub(super) struct MessageCritic {
    trunk: MessageTrunk,
    state: Option<Mlp>,
    value: Linear,
}

impl MessageCritic {
    pub(super) fn new(mut path: Path<'_>, spec: &EnvSpec, network: &Network, iwol: &Iwol) -> Self {
        let hidden = network.hidden;
        let known = spec.state.len() as i64;
        let normalised = spec.state.normalised;
        let mlp = |path: Path<'_>| Mlp::build(path, known, hidden, normalised);
        let state = iwol.privileged_value.then(|| mlp(path.sub("state")));
        let read = iwol.message + hidden + if state.is_some() { hidden } else { 0 };
        Self {
            trunk: MessageTrunk::new(
                path.sub("trunk"),
                &spec.observation,
                network,
                iwol,
                most_listed(spec),
            ),
            state,
            value: Linear::new(path.sub("value"), read, 1, Init::Orthogonal(1.0)),
        }
    }

    /// Returns the values (normalised) of a shard's active samples, `[B]`, the messages that they
    /// read, `[B, D]`, and the numbers of open and of possible edges per listener.
    pub(super) fn shard(&self, batch: &Batch, shard: &Shard) -> (Tensor, Tensor, [Tensor; 2]) {
        let scene = Scene::of_shard(batch, shard, &batch.value_memory, &batch.value_graph);
        let messages = self.trunk.forward(&scene, None);
        let edges = messages.edges(shard, &scene);
        let Some(state) = &self.state else {
            let read = Tensor::cat(&[&messages.message, &messages.embedding], -1);
            let value = self.value.forward(&read).squeeze_dim(-1);
            let [values, message] = shard.unpacked(&messages.packing, [&value, &messages.message]);
            return (values, message, edges);
        };
        let both = [&messages.message, &messages.embedding];
        let [message, embedding] = shard.unpacked(&messages.packing, both);
        let state = state.forward(&shard.active(&batch.state));
        let values = self.value.forward(&Tensor::cat(&[&message, &embedding, &state], -1));
        (values.squeeze_dim(-1), message, edges)
    }

    /// Returns the messages at one decision, over the most likely graph, `[E, N, D]`; `None` where
    /// the critic has a memory, because that memory is not kept outside training.
    pub(super) fn messages(&self, input: &Observation) -> Option<Tensor> {
        let messages = || {
            let messages = self.trunk.forward(&Scene::of(input, None), None);
            messages.packing.unpack(&messages.message)
        };
        (self.trunk.memory() == 0).then(messages)
    }

    /// Returns the values (normalised) of all agents, `[rows, N]`, from their messages and the
    /// privileged `state: [rows, N, S]`.
    fn rows(&self, messages: &Messages, state: &Tensor) -> Tensor {
        let read = Tensor::cat(&[&messages.message, &messages.embedding], -1);
        let values = match &self.state {
            None => messages.packing.unpack(&self.value.forward(&read)),
            Some(mlp) => {
                let read = messages.packing.unpack(&read);
                self.value.forward(&Tensor::cat(&[&read, &mlp.forward(state)], -1))
            }
        };
        values.squeeze_dim(-1)
    }
}

impl ValueFunction for MessageCritic {
    fn memory(&self) -> i64 {
        self.trunk.memory()
    }

    fn graph_noise(&self, agents: i64) -> i64 {
        self.trunk.graph_noise(agents)
    }

    /// Returns the values over the most likely graph.
    fn value(&self, input: &Observation, state: &Tensor) -> Option<Tensor> {
        let messages = || self.trunk.forward(&Scene::of(input, None), None);
        (self.trunk.memory() == 0).then(|| self.rows(&messages(), state))
    }

    fn values(&self, batch: &Batch, length: i64, memory: &Tensor) -> (Tensor, Option<Tensor>) {
        if self.trunk.memory() > 0 {
            let messages = self
                .trunk
                .forward(&Scene::of_batch(batch, length, memory, &batch.value_graph), None);
            return (self.rows(&messages, &batch.state), messages.memory);
        }
        let whole = Scene::of_batch(batch, 1, memory, &batch.value_graph);
        let part =
            |scene: &Scene, state: &Tensor| self.rows(&self.trunk.forward(scene, None), state);
        (whole.in_parts(&batch.state, part), None)
    }
}
