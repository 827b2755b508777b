//! The observation encoder that every method shares: features to embedding f.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use smart_default::SmartDefault;
use tch::Tensor;

use super::batch::Shard;
use super::decision::Observation;
use super::networks::HEADS;
use crate::env::Features;
use crate::nn::{Entity, Gru, LayerNorm, Mlp, Path, TokenGroup};

/// Networks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema, SmartDefault)]
#[serde(deny_unknown_fields)]
#[schemars(default)]
pub struct Network {
    /// Observation encoder. An `mlp` is sufficient where observations come in a fixed order.
    #[default(EncoderKind::Mlp)]
    pub encoder: EncoderKind,
    /// Width H of embeddings and of policy and value layers.
    #[default = 128]
    #[schemars(range(min = 4, max = 4096), extend("multipleOf" = HEADS))]
    pub hidden: i64,
    /// Steps per sequence in the update of a recurrent encoder (`gru`), a divisor of
    /// `train.rollout_steps`.
    #[default = 8]
    pub chunk_length: usize,
}

/// Width of an entity token of the attention encoder (the paper names none).
const TOKEN_WIDTH: i64 = 32;

/// The kind of observation encoder.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum EncoderKind {
    /// Self-attention over entity tokens (paper).
    Attention,
    /// Perceptron followed by a gated recurrent unit, which has a memory (released code).
    Gru,
    /// Perceptron, which is fastest.
    Mlp,
}

/// An encoder from a feature vector to an embedding of width H.
#[derive(Debug)]
pub struct Encoder {
    kind: Kind,
    hidden: i64,
}

#[derive(Debug)]
enum Kind {
    Attention(Box<Entity>),
    Gru { base: Mlp, cell: Gru, norm: LayerNorm },
    Mlp(Mlp),
}

impl Encoder {
    /// Creates an encoder of these features.
    pub fn new(mut path: Path<'_>, features: &Features, network: &Network) -> Self {
        let (inputs, hidden) = (features.len() as i64, network.hidden);
        let mlp = |path: Path<'_>| Mlp::build(path, inputs, hidden, features.normalised);
        let kind = match network.encoder {
            EncoderKind::Mlp => Kind::Mlp(mlp(path.sub("mlp"))),
            EncoderKind::Gru => Kind::Gru {
                base: mlp(path.sub("mlp")),
                cell: Gru::new(path.sub("gru"), hidden, hidden),
                norm: LayerNorm::new(path.sub("norm"), hidden),
            },
            EncoderKind::Attention => {
                let groups: Vec<_> = features
                    .groups
                    .iter()
                    .map(|group| TokenGroup {
                        offset: group.offset as i64,
                        width: group.width as i64,
                        count: group.count as i64,
                        presence: group.presence.map(|i| i as i64),
                    })
                    .collect();
                Kind::Attention(Box::new(Entity::new(
                    path.sub("entity"),
                    &groups,
                    TOKEN_WIDTH,
                    1,
                    hidden,
                )))
            }
        };
        Self { kind, hidden }
    }

    /// Returns the width of the memory per agent; 0 for an encoder without memory.
    pub fn memory(&self) -> i64 {
        if matches!(self.kind, Kind::Gru { .. }) { self.hidden } else { 0 }
    }

    /// Embeds sequences `x [L, R, O]`, with `memory [R, M]` before the first step and
    /// `keep [L, R, 1]` (0 clears the memory before a step). Returns embeddings `f [L, R, H]` and
    /// the memory after each step, `[L, R, M]`, if there is one.
    pub fn forward(&self, x: &Tensor, memory: &Tensor, keep: &Tensor) -> (Tensor, Option<Tensor>) {
        match &self.kind {
            Kind::Mlp(mlp) => (mlp.forward(x), None),
            Kind::Attention(entity) => {
                let size = x.size();
                let f = entity.forward(&x.reshape([-1, size[2]]));
                (f.view([size[0], size[1], self.hidden]), None)
            }
            Kind::Gru { base, cell, norm } => {
                let memories = cell.sequence(&base.forward(x), memory, keep);
                (norm.forward(&memories), Some(memories))
            }
        }
    }
}

/// Embeds rows of all N agents, features `[L · C, N, O]` to `[L · C, N, H]`. `memory` (`C · N · M`
/// numbers) is that before the first of L steps, and `keep` is `[L · C, N]`. Also returns the
/// memory after each step, `[L, C · N, M]`, if there is one.
pub fn encode_rows(
    encoder: &Encoder,
    features: &Tensor,
    memory: &Tensor,
    keep: &Tensor,
    length: i64,
) -> (Tensor, Option<Tensor>) {
    let (rows, agents, width) = features.size3().expect("features are [rows, N, O]");
    let together = rows / length * agents;
    let x = features.reshape([length, together, width]);
    let keep = keep.reshape([length, together, 1]);
    let (f, after) = encoder.forward(&x, &memory.reshape([together, -1]), &keep);
    (f.view([rows, agents, -1]), after)
}

/// Embeds a shard's active samples, `[B, H]`, from one or more feature tensors side by side.
/// `memory` is the encoder's memory before each row of the batch.
pub fn encode_active(
    encoder: &Encoder,
    shard: &Shard,
    features: &[&Tensor],
    memory: &Tensor,
    keep: &Tensor,
) -> Tensor {
    let parts: Vec<Tensor> = features.iter().map(|f| shard.take(f)).collect();
    let x = if parts.len() == 1 { parts[0].shallow_clone() } else { Tensor::cat(&parts, -1) };
    encode_shard(encoder, shard, &x, memory, keep)
}

/// Embeds a shard's active samples, as [`encode_active`], from features of the shard's rows only,
/// `[L · C, N, O]`. `memory` and `keep` hold all rows of the batch.
pub fn encode_shard(
    encoder: &Encoder,
    shard: &Shard,
    x: &Tensor,
    memory: &Tensor,
    keep: &Tensor,
) -> Tensor {
    if encoder.memory() == 0 {
        // Without memory, inactive samples do not influence the others and are left out.
        return encoder.forward(&shard.pick(x).unsqueeze(0), memory, keep).0.squeeze_dim(0);
    }
    let first = memory.index_select(0, &shard.first);
    shard.pick(&encode_rows(encoder, x, &first, &shard.take(keep), shard.length).0)
}

/// Embeds the local observations of one decision, `[E, N, H]`. Also returns the memory after the
/// decision, `[E, N, M]`.
pub fn encode_locally(encoder: &Encoder, input: &Observation) -> (Tensor, Tensor) {
    let (f, memory) = encode_rows(encoder, &input.observation, &input.memory, &input.keep(), 1);
    (f, input.memory_after(memory))
}
