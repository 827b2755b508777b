//! What networks that look across agents read: rows with all N agents of an environment.

use tch::Tensor;

use super::Observation;
use super::batch::{Batch, Shard};
use super::encoder::{Encoder, encode_rows};
use crate::nn::Packing;

/// Rows of C sequences of L steps, `[L · C]`, of all N agents.
pub(super) struct Scene {
    /// `[L · C, N, O]`
    pub(super) observation: Tensor,
    /// Before the first step, `[C, N, M]`.
    pub(super) memory: Tensor,
    /// `[L · C, N]`
    pub(super) keep: Tensor,
    /// `[L · C, N, N]`
    pub(super) comm: Tensor,
    /// Of the communication graphs, `[L · C, N, G · N]`; without it, the most likely ones.
    pub(super) noise: Option<Tensor>,
    /// Steps L.
    pub(super) length: i64,
    /// Whether to leave out those whom nobody can hear. One decision computes everyone, so that its rounding does not depend
    /// on who is there in other environments.
    pub(super) pack: bool,
}

impl Scene {
    /// One decision, with everyone.
    pub(super) fn of(input: &Observation, noise: Option<&Tensor>) -> Self {
        Self {
            observation: input.observation.shallow_clone(),
            memory: input.memory.shallow_clone(),
            keep: input.keep(),
            comm: input.comm.shallow_clone(),
            noise: noise.map(Tensor::shallow_clone),
            length: 1,
            pack: false,
        }
    }

    /// The rows of a shard; `memory` and `noise` are for all rows of the batch, the latter empty for networks without a graph.
    pub(super) fn of_shard(batch: &Batch, shard: &Shard, memory: &Tensor, noise: &Tensor) -> Self {
        Self {
            observation: shard.take(&batch.observation),
            memory: memory.index_select(0, &shard.first),
            keep: shard.take(&batch.keep),
            comm: shard.take(&batch.comm),
            noise: (noise.numel() > 0).then(|| shard.take(noise)),
            length: shard.length,
            pack: true,
        }
    }

    /// All rows of a batch as sequences of `length` steps, from `memory` before the first, `[C, N, M]`.
    pub(super) fn of_batch(batch: &Batch, length: i64, memory: &Tensor, noise: &Tensor) -> Self {
        Self {
            observation: batch.observation.shallow_clone(),
            memory: memory.shallow_clone(),
            keep: batch.keep.shallow_clone(),
            comm: batch.comm.shallow_clone(),
            noise: (noise.numel() > 0).then(|| noise.shallow_clone()),
            length,
            pack: true,
        }
    }

    /// Rows and agents.
    pub(super) fn size(&self) -> (i64, i64) {
        let (rows, agents, _) = self.observation.size3().expect("observations are [rows, N, O]");
        (rows, agents)
    }

    /// Who is there, `[L · C, N]`.
    pub(super) fn present(&self) -> Tensor {
        self.comm.diagonal(0, 1, 2)
    }

    /// Embeddings of everyone, `[L · C, N, H]`, and the memory after each step, `[L, C · N, M]`, if there is one.
    pub(super) fn embed(&self, encoder: &Encoder) -> (Tensor, Option<Tensor>) {
        encode_rows(encoder, &self.observation, &self.memory, &self.keep, self.length)
    }

    /// Embeddings of those who are there, `[P, H]`, as `packing` says, and the memory after each step.
    pub(super) fn embed_packed(
        &self,
        encoder: &Encoder,
        packing: &Packing,
    ) -> (Tensor, Option<Tensor>) {
        if encoder.memory() == 0 {
            // Those who are left out need not be embedded.
            let x = packing.pack(&self.observation).unsqueeze(0);
            return (encoder.forward(&x, &self.memory, &self.keep).0.squeeze_dim(0), None);
        }
        let (f, memories) = self.embed(encoder);
        (packing.pack(&f), memories)
    }

    /// `count` rows from `first` on, of single steps.
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
            noise: self.noise.as_ref().map(cut),
            ..*self
        }
    }

    /// What `work` makes of single steps and of `others`, which have as many rows, row by row: in parts that bound the peak
    /// of memory, and change nothing else.
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
