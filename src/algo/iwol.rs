//! Settings of IWoL, which Im-IWoL, Ex-IWoL and MADDPG with IWoL share.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use smart_default::SmartDefault;

use super::networks::HEADS;

/// Settings of IWoL. Im-IWoL reads all of them; Ex-IWoL all but `lambda_interaction` and `latent`;
/// MADDPG with IWoL all but `decoded`; MAGIC and CommFormer only `decoded`, for their world decoder;
/// the other methods none.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema, SmartDefault)]
#[serde(deny_unknown_fields)]
#[schemars(default)]
pub struct Iwol {
    /// Width Z of Im-IWoL's latent z (paper: 32).
    #[default = 32]
    #[schemars(range(min = 1, max = 4096))]
    pub latent: i64,
    /// Width D of a message and of the graph transformer that computes it, which has four attention
    /// heads (paper: 128).
    #[default = 64]
    #[schemars(range(min = 4, max = 4096), extend("multipleOf" = HEADS))]
    pub message: i64,
    /// Number of rounds L of the graph transformer (released scripts: 4).
    #[default = 1]
    #[schemars(range(min = 1, max = 64))]
    pub rounds: usize,
    /// λ_W, weight of the world decoder's loss (paper: 0.05).
    #[default = 0.05]
    #[schemars(range(min = 0))]
    pub lambda_world: f64,
    /// λ_I, weight of the interaction decoder's loss (paper: 0.05).
    #[default = 0.05]
    #[schemars(range(min = 0))]
    pub lambda_interaction: f64,
    /// Share of a minibatch's samples, chosen at random, from which the decoders learn. With 1, the
    /// decoders take more time than the policy. The loss is a mean over samples, which a part
    /// estimates well.
    #[default = 0.25]
    #[schemars(range(max = 1), extend("exclusiveMinimum" = 0))]
    pub decoded: f64,
    /// Number added to the score of every edge. With 3, nineteen of twenty edges are open at the
    /// beginning of training, and learning closes some of them; with 0 (released) about half of
    /// them are open. `graph/open_edges` of
    /// `graph/possible_edges` in `metrics.jsonl` says how many are.
    pub graph_bias: f64,
    /// Whether the value function also reads the privileged state, as those of most other methods
    /// do. Otherwise it reads local observations and messages only (paper). This setting changes
    /// nothing about what the policy reads.
    pub privileged_value: bool,
}

impl Iwol {
    /// What methods do not read that have a world decoder, and no other part of IWoL.
    pub(super) const ALL_BUT_DECODED: &'static [&'static str] = &[
        "iwol.latent",
        "iwol.message",
        "iwol.rounds",
        "iwol.lambda_world",
        "iwol.lambda_interaction",
        "iwol.graph_bias",
        "iwol.privileged_value",
    ];
}
