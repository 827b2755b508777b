//! The observation encoder that every method shares: features in, embedding f out.

use tch::Tensor;

use super::settings::{EncoderKind, Network};
use crate::env::Features;
use crate::nn::{Entity, Gru, LayerNorm, Mlp, Path, TokenGroup};

/// From a feature vector to an embedding of width H.
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
    /// An encoder of these features.
    pub fn new(mut path: Path<'_>, features: &Features, network: &Network) -> Self {
        let (inputs, hidden) = (features.len() as i64, network.hidden);
        let kind = match network.encoder {
            EncoderKind::Mlp => Kind::Mlp(Mlp::new(path.sub("mlp"), inputs, hidden, network.extra_layers)),
            EncoderKind::Gru => Kind::Gru {
                base: Mlp::new(path.sub("mlp"), inputs, hidden, network.extra_layers),
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
                    network.token_width,
                    network.token_heads,
                    hidden,
                )))
            }
        };
        Self { kind, hidden }
    }

    /// Width of the memory per agent; 0 without one.
    pub fn memory(&self) -> i64 {
        if matches!(self.kind, Kind::Gru { .. }) { self.hidden } else { 0 }
    }

    /// Embeds sequences: `x [L, R, O]`, `memory [R, M]` before the first step, `keep [L, R, 1]` (0 clears the memory
    /// before a step). Gives `f [L, R, H]` and the memory after each step, `[L, R, M]`, if there is one.
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
