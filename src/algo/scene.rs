//! The input of networks that look across agents: rows with all N agents of an environment.

use tch::Tensor;

use super::batch::{Batch, Shard};
use super::decision::Observation;
use super::encoder::{Encoder, encode_rows};
use crate::nn::{Graph, Packing};

/// Rows `[L · C]` of C sequences of L steps, with all N agents.
pub(super) struct Scene {
    /// Observations, `[L · C, N, O]`.
    pub(super) observation: Tensor,
    /// Memory before the first step, `[C, N, M]`.
    pub(super) memory: Tensor,
    /// 0 where memories are cleared before the step, else 1, `[L · C, N]`.
    pub(super) keep: Tensor,
    /// Physical masks, `[L · C, N, N]`.
    pub(super) comm: Tensor,
    /// What becomes of the message that each agent hears from another: -1 if it is lost, the number
    /// of the false message that replaces it, counted from 1, or 0, `[L · C, N, N]`; see `radio.rs`.
    pub(super) disturbance: Option<Tensor>,
    /// Noise of the communication graphs, `[L · C, N, G · N]`, or `[L · C, N, K]` where graphs are
    /// lists of K neighbours; without it, graphs are the most likely ones.
    pub(super) noise: Option<Tensor>,
    /// Number of steps L.
    pub(super) length: i64,
    /// Whether to leave out absent agents, whom no agent can hear. A single decision computes all
    /// slots, so that its rounding does not depend on which agents are present in other
    /// environments.
    pub(super) pack: bool,
}

/// Result of a message path for the P present agents of a scene.
pub(super) struct Messages {
    /// Messages m, `[P, D]`.
    pub(super) message: Tensor,
    /// Embeddings f, `[P, H]`.
    pub(super) embedding: Tensor,
    /// Communication graph of the rows.
    pub(super) graph: Graph,
    /// Positions of the present agents among `[L · C, N]`.
    pub(super) packing: Packing,
    /// Memory of the encoder after each step, `[L, C · N, M]`.
    pub(super) memory: Option<Tensor>,
}

impl Messages {
    /// Returns the graph as an edge of 0 or 1 for every ordered pair of slots, `[L · C, N, N]`.
    pub(super) fn full_graph(&self) -> Tensor {
        self.graph.full(&self.packing)
    }

    /// Returns how many edges of the graph are open and how many are physically possible per
    /// listener, means over the active samples of a shard, whose rows are `scene`.
    pub(super) fn edges(&self, shard: &Shard, scene: &Scene) -> [Tensor; 2] {
        shard.mean_edges(&self.graph.count_edges(&scene.comm, &self.packing))
    }
}

/// Returns a tensor that has elements.
fn some(tensor: &Tensor) -> Option<&Tensor> {
    (tensor.numel() > 0).then_some(tensor)
}

impl Scene {
    /// Returns the physical masks without the edges whose messages are lost, `[L · C, N, N]`.
    pub(super) fn heard(&self) -> Tensor {
        let arrives = |numbers: &Tensor| numbers.ge(0.0).to_kind(self.comm.kind());
        match &self.disturbance {
            Some(numbers) => &self.comm * arrives(numbers),
            None => self.comm.shallow_clone(),
        }
    }

    /// Returns the scene of one decision, with all slots.
    pub(super) fn of(input: &Observation, noise: Option<&Tensor>) -> Self {
        Self {
            observation: input.observation.shallow_clone(),
            memory: input.memory.shallow_clone(),
            keep: input.keep(),
            comm: input.comm.shallow_clone(),
            disturbance: some(&input.disturbance).map(Tensor::shallow_clone),
            noise: noise.map(Tensor::shallow_clone),
            length: 1,
            pack: false,
        }
    }

    /// Returns the rows of a shard. `memory` and `noise` hold all rows of the batch; `noise` is
    /// empty for networks without a graph.
    pub(super) fn of_shard(batch: &Batch, shard: &Shard, memory: &Tensor, noise: &Tensor) -> Self {
        Self {
            observation: shard.take(&batch.observation),
            memory: memory.index_select(0, &shard.first),
            keep: shard.take(&batch.keep),
            comm: shard.take(&batch.comm),
            disturbance: some(&batch.disturbance).map(|numbers| shard.take(numbers)),
            noise: some(noise).map(|noise| shard.take(noise)),
            length: shard.length,
            pack: true,
        }
    }

    /// Returns all rows of a batch as C sequences of `length` steps, with `memory` before the first
    /// step, `[C, N, M]`.
    pub(super) fn of_batch(batch: &Batch, length: i64, memory: &Tensor, noise: &Tensor) -> Self {
        Self {
            observation: batch.observation.shallow_clone(),
            memory: memory.shallow_clone(),
            keep: batch.keep.shallow_clone(),
            comm: batch.comm.shallow_clone(),
            disturbance: some(&batch.disturbance).map(Tensor::shallow_clone),
            noise: some(noise).map(Tensor::shallow_clone),
            length,
            pack: true,
        }
    }

    /// Returns the numbers of rows and of agent slots.
    pub(super) fn size(&self) -> (i64, i64) {
        let (rows, agents, _) = self.observation.size3().expect("observations are [rows, N, O]");
        (rows, agents)
    }

    /// Returns 1 where an agent is present, else 0, `[L · C, N]`.
    pub(super) fn present(&self) -> Tensor {
        self.comm.diagonal(0, 1, 2)
    }

    /// Returns the positions of the agents that a message path computes.
    pub(super) fn packing(&self) -> Packing {
        let (rows, agents) = self.size();
        if self.pack { Packing::of(&self.present()) } else { Packing::full(rows, agents) }
    }

    /// Returns the embeddings of all slots, `[L · C, N, H]`, and the memory after each step,
    /// `[L, C · N, M]`, if there is one.
    pub(super) fn embed(&self, encoder: &Encoder) -> (Tensor, Option<Tensor>) {
        encode_rows(encoder, &self.observation, &self.memory, &self.keep, self.length)
    }

    /// Returns the embeddings of the present agents, `[P, H]`, packed by `packing`, and the memory
    /// after each step.
    pub(super) fn embed_packed(
        &self,
        encoder: &Encoder,
        packing: &Packing,
    ) -> (Tensor, Option<Tensor>) {
        if encoder.memory() == 0 {
            // Without memory, only the present agents need to be embedded.
            let x = packing.pack(&self.observation).unsqueeze(0);
            return (encoder.forward(&x, &self.memory, &self.keep).0.squeeze_dim(0), None);
        }
        let (f, memories) = self.embed(encoder);
        (packing.pack(&f), memories)
    }

    /// Returns `count` rows from row `first` on; rows must be single steps.
    fn part(&self, first: i64, count: i64) -> Self {
        debug_assert_eq!(self.length, 1);
        let cut = |tensor: &Tensor| tensor.narrow(0, first, count);
        Self {
            observation: cut(&self.observation),
            memory: if self.memory.numel() > 0 {
                cut(&self.memory)
            } else {
                self.memory.shallow_clone()
            },
            keep: cut(&self.keep),
            comm: cut(&self.comm),
            disturbance: self.disturbance.as_ref().map(cut),
            noise: self.noise.as_ref().map(cut),
            ..*self
        }
    }

    /// Applies `work` to single steps and to `others`, which has as many rows, and returns the
    /// joined results. The rows are processed in parts, which only bounds the peak memory.
    pub(super) fn in_parts(
        &self,
        others: &Tensor,
        work: impl Fn(&Self, &Tensor) -> Tensor,
    ) -> Tensor {
        let (rows, agents) = self.size();
        let size = (4096 / agents).max(1);
        let part = |first: i64| {
            let count = size.min(rows - first);
            work(&self.part(first, count), &others.narrow(0, first, count))
        };
        Tensor::cat(&(0..rows).step_by(size as usize).map(part).collect::<Vec<_>>(), 0)
    }
}
