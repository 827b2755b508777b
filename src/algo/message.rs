//! The communication protocol of IWoL: embeddings, a learned graph cut by the physical mask, and rounds of attention over it
//! (paper: "Graph-attention Communication Protocol"; DongsuLeeTech/IWoL, `scheduler.py` and `transformer_comm.py`).

use tch::Tensor;

use super::Observation;
use super::batch::{Batch, Shard};
use super::channel::{Channel, ChannelNoise, Heard};
use super::encoder::Encoder;
use super::settings::{Iwol, Network};
use crate::env::Features;
use crate::nn::{CommGraph, GraphTransformer, Init, Linear, MaskMode, Packing, Path};

/// Observations of all agents in, messages m and embeddings f out.
#[derive(Debug)]
pub(super) struct MessageTrunk {
    encoder: Encoder,
    graph: CommGraph,
    transformer: GraphTransformer,
    hidden: i64,
    physical_mask: bool,
    /// Whether agents who are gone still influence others, as in the released code.
    leaks: bool,
}

/// What the message path needs to know of rows `[L · C]` of all N agents.
#[derive(Clone, Copy)]
pub(super) struct Scene<'a> {
    /// `[L · C, N, O]`
    pub(super) observation: &'a Tensor,
    /// Before the first step, `[C, N, M]`.
    pub(super) memory: &'a Tensor,
    /// `[L · C, N]`
    pub(super) keep: &'a Tensor,
    /// `[L · C, N, N]`
    pub(super) comm: &'a Tensor,
    /// Of the graph, `[L · C, N, N]`; without it, the most likely one.
    pub(super) noise: Option<&'a Tensor>,
    /// Steps L.
    pub(super) length: i64,
    /// Whether to leave out those whom nobody can hear. One decision computes everyone, so that its rounding does not depend
    /// on who is there in other environments.
    pub(super) pack: bool,
}

impl<'a> Scene<'a> {
    /// One decision, with everyone.
    pub(super) fn of(input: &'a Observation, keep: &'a Tensor, noise: Option<&'a Tensor>) -> Self {
        let Observation { observation, comm, memory, .. } = input;
        Self { observation, memory, keep, comm, noise, length: 1, pack: false }
    }
}

/// Result of the message path for the P agents who are there.
pub(super) struct Messages {
    /// `[P, D]`
    pub(super) message: Tensor,
    /// `[P, H]`
    pub(super) embedding: Tensor,
    /// Who listens to whom, `[L · C, N, N]`.
    pub(super) graph: Tensor,
    /// Where they belong among `[L · C, N]`.
    pub(super) packing: Packing,
    /// Memory after each step of the encoder, `[L, C · N, M]`.
    pub(super) memory: Option<Tensor>,
}

impl MessageTrunk {
    pub(super) fn new(mut path: Path<'_>, features: &Features, network: &Network, iwol: &Iwol) -> Self {
        let (hidden, message) = (network.hidden, iwol.message);
        let transformer = path.sub("transformer");
        let transformer = GraphTransformer::new(transformer, hidden, message, iwol.rounds, iwol.heads, iwol.mask);
        Self {
            encoder: Encoder::new(path.sub("encoder"), features, network),
            graph: CommGraph::new(path.sub("graph"), hidden, message, iwol.slope, iwol.graph_bias, iwol.temperature),
            transformer,
            hidden,
            physical_mask: iwol.physical_mask,
            leaks: !iwol.physical_mask || iwol.mask != MaskMode::Hard,
        }
    }

    pub(super) fn memory(&self) -> i64 {
        self.encoder.memory()
    }

    /// Width of an embedding, which is what agents send.
    pub(super) fn width(&self) -> i64 {
        self.hidden
    }

    /// One decision where embeddings pass through a channel: messages `[E, N, D]`, own embeddings `[E, N, H]`, memory. Each
    /// agent computes a graph and messages of its own, from what it heard.
    pub(super) fn through(
        &self,
        input: &Observation,
        channel: &Channel,
        noise: &ChannelNoise,
    ) -> (Tensor, Tensor, Tensor) {
        let (envs, agents, _) = input.observation.size3().expect("observations are [E, N, O]");
        let (own, total) = (self.encoder.memory(), input.memory.size()[2]);
        let memory = input.memory.narrow(2, 0, own);
        let x = input.observation.view([1, envs * agents, -1]);
        let keep = input.keep().reshape([1, envs * agents, 1]);
        let (f, memories) = self.encoder.forward(&x, &memory.reshape([envs * agents, own]), &keep);
        let f = f.view([envs, agents, -1]);
        let anyone = if self.physical_mask { input.comm.shallow_clone() } else { input.comm.ones_like() };
        let past = input.memory.narrow(2, own, total - own);
        let (Heard { embedding, arrived }, past) = channel.send(&f, &input.keep(), &past, noise);
        // A row of agents for each receiver: what it knows of all of them. Those it did not hear reach it by no way.
        let rows = envs * agents;
        let edges = (anyone.unsqueeze(1) * arrived.unsqueeze(2)).reshape([rows, agents, agents]);
        let (all, packing) = (embedding.reshape([rows * agents, -1]), Packing::full(rows, agents));
        let graph = self.graph.forward(&all, &packing, &edges, None);
        let message = self.transformer.forward(&all, &packing, &graph).view([envs, agents, agents, -1]);
        let message = message.diagonal(0, 1, 2).transpose(1, 2);
        let memory = match memories {
            Some(after) => after.view([envs, agents, own]),
            None => memory,
        };
        (message.contiguous(), f, Tensor::cat(&[&memory, &past], -1))
    }

    /// The message path, where every message arrives as it was sent.
    pub(super) fn forward(&self, scene: &Scene<'_>) -> Messages {
        let Scene { observation, memory, keep, comm, noise, length, pack } = *scene;
        let (rows, agents, features) = observation.size3().expect("observations are [rows, N, O]");
        // Where cut edges leak, everyone is heard.
        let packing =
            if pack && !self.leaks { Packing::of(&comm.diagonal(0, 1, 2)) } else { Packing::full(rows, agents) };
        let (embedding, memories) = if self.encoder.memory() == 0 {
            let (f, _) = self.encoder.forward(&packing.pack(observation).unsqueeze(0), memory, keep);
            (f.squeeze_dim(0), None)
        } else {
            let together = rows / length * agents;
            let x = observation.view([length, together, features]);
            let keep = keep.reshape([length, together, 1]);
            let (f, memories) = self.encoder.forward(&x, &memory.reshape([together, -1]), &keep);
            (packing.pack(&f.view([rows, agents, -1])), memories)
        };
        let anyone = if self.physical_mask { comm.shallow_clone() } else { comm.ones_like() };
        let graph = self.graph.forward(&embedding, &packing, &anyone, noise);
        let message = self.transformer.forward(&embedding, &packing, &graph);
        Messages { message, embedding, graph, packing, memory: memories }
    }

    /// As [`MessageTrunk::forward`], on the rows of a shard; `memory` is the trunk's own, for all rows.
    pub(super) fn shard(&self, batch: &Batch, shard: &Shard, memory: &Tensor, noise: &Tensor) -> Messages {
        self.forward(&Scene {
            observation: &shard.take(&batch.observation),
            memory: &memory.index_select(0, &shard.first),
            keep: &shard.take(&batch.keep),
            comm: &shard.take(&batch.comm),
            noise: Some(&shard.take(noise)),
            length: shard.length,
            pack: true,
        })
    }
}

/// A critic on the message path: V(m, f), local observations and messages only (paper: decentralised value).
#[derive(Debug)]
pub(super) struct MessageCritic {
    trunk: MessageTrunk,
    value: Linear,
}

impl MessageCritic {
    pub(super) fn new(mut path: Path<'_>, features: &Features, network: &Network, iwol: &Iwol) -> Self {
        Self {
            trunk: MessageTrunk::new(path.sub("trunk"), features, network, iwol),
            value: Linear::new(path.sub("value"), iwol.message + network.hidden, 1, Init::Orthogonal(1.0)),
        }
    }

    /// Memory per agent.
    pub(super) fn memory(&self) -> i64 {
        self.trunk.memory()
    }

    /// Values (normalised) of a shard's active samples, `[B]`, and the messages behind them, `[B, D]`.
    pub(super) fn shard(&self, batch: &Batch, shard: &Shard) -> (Tensor, Tensor) {
        let messages = self.trunk.shard(batch, shard, &batch.value_memory, &batch.value_graph);
        let positions = shard.positions(&messages.packing);
        let message = messages.message.index_select(0, &positions);
        (self.head(&messages).index_select(0, &positions), message)
    }

    /// The messages at one decision, over the most likely graph, `[E, N, D]`. Only without memory: that of the value is
    /// not kept outside training.
    pub(super) fn messages(&self, input: &Observation) -> Option<Tensor> {
        let messages = |keep: &Tensor| {
            let messages = self.trunk.forward(&Scene::of(input, keep, None));
            messages.packing.unpack(&messages.message)
        };
        (self.trunk.memory() == 0).then(|| messages(&input.keep()))
    }

    /// Values (normalised) at one decision, over the most likely graph, `[E, N]`; only without memory.
    pub(super) fn value(&self, input: &Observation) -> Option<Tensor> {
        let value = || {
            let keep = input.keep();
            let messages = self.trunk.forward(&Scene::of(input, &keep, None));
            messages.packing.unpack(&self.head(&messages).unsqueeze(-1)).squeeze_dim(-1)
        };
        (self.trunk.memory() == 0).then(value)
    }

    fn head(&self, messages: &Messages) -> Tensor {
        self.value.forward(&Tensor::cat(&[&messages.message, &messages.embedding], -1)).squeeze_dim(-1)
    }

    /// Values (normalised) of sequences of `length` steps, `[rows, N]`, and the memory after each step.
    pub(super) fn values(&self, batch: &Batch, length: i64, memory: &Tensor) -> (Tensor, Option<Tensor>) {
        let rows = |messages: &Messages| messages.packing.unpack(&self.head(messages).unsqueeze(-1)).squeeze_dim(-1);
        let whole = Scene {
            observation: &batch.observation,
            memory,
            keep: &batch.keep,
            comm: &batch.comm,
            noise: Some(&batch.value_graph),
            length,
            pack: true,
        };
        if self.trunk.memory() > 0 {
            let messages = self.trunk.forward(&whole);
            return (rows(&messages), messages.memory);
        }
        let (count, agents, _) = batch.observation.size3().expect("observations are [rows, N, O]");
        let part = |from: i64, count: i64| {
            let cut = |t: &Tensor| t.narrow(0, from, count);
            let (observation, keep, comm) = (&cut(whole.observation), &cut(whole.keep), &cut(whole.comm));
            let noise = &cut(&batch.value_graph);
            let scene = Scene { observation, keep, comm, noise: Some(noise), length: 1, ..whole };
            rows(&self.trunk.forward(&scene))
        };
        // Parts bound the peak of memory; they change nothing else.
        let size = (4096 / agents).max(1);
        let parts: Vec<Tensor> = (0..count).step_by(size as usize).map(|k| part(k, size.min(count - k))).collect();
        (Tensor::cat(&parts, 0), None)
    }
}
