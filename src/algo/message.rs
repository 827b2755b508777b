//! The communication protocol of IWoL: embeddings, a learned graph cut by the physical mask, and rounds of attention over it
//! (paper: "Graph-attention Communication Protocol"; DongsuLeeTech/IWoL, `scheduler.py` and `transformer_comm.py`).

use tch::{Kind, Tensor, no_grad};

use super::core::{Batch, Minibatch};
use super::encoder::Encoder;
use super::settings::{Iwol, Network};
use crate::env::Features;
use crate::nn::{CommGraph, GraphTransformer, Init, Linear, Path};

/// Observations of all agents in, messages m and embeddings f out.
#[derive(Debug)]
pub(super) struct MessageTrunk {
    encoder: Encoder,
    graph: CommGraph,
    transformer: GraphTransformer,
    physical_mask: bool,
}

/// Result of the message path for B rows.
pub(super) struct Messages {
    /// `[B, N, H]`
    pub(super) message: Tensor,
    /// `[B, N, H]`
    pub(super) embedding: Tensor,
    /// Memory after each step of the encoder, `[L, C · N, M]`.
    pub(super) memory: Option<Tensor>,
}

impl MessageTrunk {
    pub(super) fn new(mut path: Path<'_>, features: &Features, network: &Network, iwol: &Iwol) -> Self {
        let hidden = network.hidden;
        Self {
            encoder: Encoder::new(path.sub("encoder"), features, network),
            graph: CommGraph::new(path.sub("graph"), hidden, iwol.slope, iwol.temperature),
            transformer: GraphTransformer::new(path.sub("transformer"), hidden, iwol.rounds, iwol.heads, iwol.mask),
            physical_mask: iwol.physical_mask,
        }
    }

    pub(super) fn memory(&self) -> i64 {
        self.encoder.memory()
    }

    /// The message path on rows `[L · C]` of all N agents: `observation [L · C, N, O]`, `memory [C, N, M]` before the
    /// first step, `keep [L · C, N]`, `comm` and `noise` `[L · C, N, N]` (no noise: the most likely graph).
    ///
    /// Every message between agents passes through here: this is where bandwidth, loss or attacks act.
    pub(super) fn forward(
        &self,
        observation: &Tensor,
        memory: &Tensor,
        keep: &Tensor,
        length: i64,
        comm: &Tensor,
        noise: Option<&Tensor>,
    ) -> Messages {
        let (rows, agents, features) = observation.size3().expect("observations are [rows, N, O]");
        let agents_of_step = rows / length * agents;
        let x = observation.view([length, agents_of_step, features]);
        let memory = memory.reshape([agents_of_step, -1]);
        let (f, memories) = self.encoder.forward(&x, &memory, &keep.reshape([length, agents_of_step, 1]));
        let embedding = f.view([rows, agents, -1]);
        let anyone = if self.physical_mask { comm.shallow_clone() } else { comm.ones_like() };
        let graph = self.graph.forward(&embedding, &anyone, noise);
        Messages { message: self.transformer.forward(&embedding, &graph), embedding, memory: memories }
    }

    /// As [`MessageTrunk::forward`], on the rows of a minibatch; `memory` is the trunk's own, for all rows.
    pub(super) fn minibatch(&self, batch: &Batch, mini: &Minibatch, memory: &Tensor, noise: &Tensor) -> Messages {
        self.forward(
            &mini.take(&batch.observation),
            &memory.index_select(0, &mini.first),
            &mini.take(&batch.keep),
            mini.length,
            &mini.take(&batch.comm),
            Some(&mini.take(noise)),
        )
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
            value: Linear::new(path.sub("value"), 2 * network.hidden, 1, Init::Orthogonal(1.0)),
        }
    }

    /// Values (normalised) of a minibatch's rows, `[rows, N]`, and the messages behind them.
    pub(super) fn minibatch(
        &self,
        batch: &Batch,
        mini: &Minibatch,
        memory: &Tensor,
        noise: &Tensor,
    ) -> (Tensor, Tensor) {
        let messages = self.trunk.minibatch(batch, mini, memory, noise);
        (self.head(&messages), messages.message)
    }

    fn head(&self, messages: &Messages) -> Tensor {
        self.value.forward(&Tensor::cat(&[&messages.message, &messages.embedding], -1)).squeeze_dim(-1)
    }

    /// Values (normalised) of a whole rollout, `[(T + 1) · E, N]`, with the memory before each of its rows,
    /// `[(T + 1) · E, N, M]`; `carried` is the memory that the last rollout left, and is replaced.
    pub(super) fn values(
        &self,
        batch: &Batch,
        steps: i64,
        carried: &mut Option<Tensor>,
        noise: &Tensor,
    ) -> (Tensor, Tensor) {
        let (rows, agents, _) = batch.observation.size3().expect("observations are [rows, N, O]");
        let width = self.trunk.memory();
        no_grad(|| {
            if width == 0 {
                let memory = batch.observation.new_zeros([rows, agents, 0], (Kind::Float, tch::Device::Cpu));
                let part = |from: i64, count: i64| {
                    let cut = |t: &Tensor| t.narrow(0, from, count);
                    let (o, c, z) = (cut(&batch.observation), cut(&batch.comm), cut(noise));
                    self.head(&self.trunk.forward(&o, &cut(&memory), &cut(&batch.keep), 1, &c, Some(&z)))
                };
                // Parts bound the peak of memory; they change nothing else.
                let size = (16_384 / agents).max(1);
                let parts: Vec<Tensor> =
                    (0..rows).step_by(size as usize).map(|k| part(k, size.min(rows - k))).collect();
                return (Tensor::cat(&parts, 0), memory);
            }
            let envs = rows / (steps + 1);
            let first = carried
                .take()
                .unwrap_or_else(|| Tensor::zeros([envs * agents, width], (Kind::Float, tch::Device::Cpu)));
            let whole = (&batch.observation, &batch.keep, &batch.comm);
            let messages = self.trunk.forward(whole.0, &first, whole.1, steps + 1, whole.2, Some(noise));
            let after = messages.memory.as_ref().expect("a recurrent encoder has memory");
            let before = Tensor::cat(&[&first.unsqueeze(0), &after.narrow(0, 0, steps)], 0);
            *carried = Some(after.get(steps - 1).copy());
            (self.head(&messages), before.view([rows, agents, width]))
        })
    }
}
