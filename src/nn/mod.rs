//! Neural-network layers on libtorch, from which the learners of `algo` are built.
//!
//! A layer is a small struct that owns shallow copies of its tensors. The tensors themselves are
//! registered by name and in order in a [`Params`] store, which optimisers ([`optim::Adam`]) and
//! checkpoints use. Initial weights and all sampling noise come from a Rust generator, never from
//! libtorch's global one, so that a run is a function of its seed. All tensors are `f32` unless a
//! comment says otherwise.
//!
//! Sizes in the comments: `B` batch, `N` agent slots, `P` occupied slots of a [`Packing`], `L`
//! steps of a sequence (in a transformer: rounds), `T` tokens, `Q` queries, `H` hidden width, `W`
//! width of a sequence, `d` token width or width of an attention head, `O` observation, `S`
//! privileged state, `A` action.

#![cfg(feature = "learn")]

pub mod attention;
pub mod decoder;
pub mod distributions;
pub mod entity;
mod error;
pub mod graph;
pub mod gru;
pub mod init;
pub mod linear;
pub mod magic;
pub mod mixer;
pub mod mlp;
pub mod neighbours;
pub mod norm;
pub mod optim;
pub mod packing;
pub mod params;
pub mod transformer;
pub mod value_norm;

pub use attention::{Mask, SelfAttention};
pub use decoder::{Attention, Decoded, Reach, RelationBlock, TransformerDecoder};
pub use distributions::{
    categorical_entropy, categorical_log_probs, gaussian_entropy, gaussian_log_prob,
};
pub use entity::{Entity, TokenGroup};
pub use error::Error;
pub use graph::{CommGraph, Graph, SLOPE};
pub use gru::Gru;
pub use init::Init;
pub use linear::Linear;
pub use magic::{GraphAttention, Scheduler};
pub use mixer::Mixer;
pub use mlp::{Activation, Layer, Mlp};
pub use neighbours::Neighbours;
pub use norm::LayerNorm;
pub use optim::{Adam, AdamConfig};
pub use packing::Packing;
pub use params::{Params, Path, copy_named, named_views};
pub use transformer::GraphTransformer;
pub use value_norm::ValueNorm;
