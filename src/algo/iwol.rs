//! Settings of IWoL, which Im-IWoL, Ex-IWoL and MADDPG with IWoL share.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use smart_default::SmartDefault;
use tch::Tensor;

use crate::env::EnvSpec;
use crate::nn::MaskMode;

/// Settings of IWoL. Defaults follow the paper; alternatives of the released code are named.
/// Im-IWoL reads all of them; Ex-IWoL all but `interaction_tanh`, `lambda_interaction`, `latent`
/// and `policy_input`; MADDPG with IWoL all but `decoded` and `graph_noise`; MAGIC and CommFormer
/// only `graph_noise` and, for their world decoder, `decoded` and `world_target`; the other methods
/// none.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema, SmartDefault)]
#[serde(deny_unknown_fields)]
#[schemars(default)]
pub struct Iwol {
    /// Width Z of Im-IWoL's latent z (paper: 32).
    #[default = 32]
    #[schemars(range(min = 1, max = 4096))]
    pub latent: i64,
    /// Width D of a message and of the graph transformer that computes it (paper: 128).
    #[default = 64]
    #[schemars(range(min = 1, max = 4096))]
    pub message: i64,
    /// Number of rounds L of the graph transformer (released scripts: 4).
    #[default = 1]
    #[schemars(range(min = 1, max = 64))]
    pub rounds: usize,
    /// Number of attention heads of the graph transformer (paper: 4); a divisor of `iwol.message`.
    #[default = 4]
    #[schemars(range(min = 1))]
    pub heads: i64,
    /// λ_W, weight of the world decoder's loss (paper: 0.05).
    #[default = 0.05]
    #[schemars(range(min = 0))]
    pub lambda_world: f64,
    /// λ_I, weight of the interaction decoder's loss (paper: 0.05).
    #[default = 0.05]
    #[schemars(range(min = 0))]
    pub lambda_interaction: f64,
    /// Share of a minibatch's samples, chosen at random, from which the decoders learn. All samples
    /// would cost more than the policy itself, for a mean that a part estimates as well.
    #[default = 0.25]
    #[schemars(range(max = 1), extend("exclusiveMinimum" = 0))]
    pub decoded: f64,
    /// Slope of the leaky rectifier in the additive attention (released: 1.2 for driving).
    #[default = 0.2]
    pub slope: f64,
    /// Number added to the score of every edge. With 3, nineteen of twenty edges are open at the
    /// beginning of training, and learning closes some of them; with 0 (released) about half of
    /// them are open. `graph/edge_rate` in `metrics.jsonl` says how many are.
    pub graph_bias: f64,
    /// Temperature of the Gumbel-softmax.
    #[default = 1.0]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub temperature: f64,
    /// Effect of the graph on attention.
    #[default(MaskMode::Hard)]
    pub mask: MaskMode,
    /// Whether the radio's range cuts edges (released: no).
    #[default = true]
    pub physical_mask: bool,
    /// Noise of sampled graphs in the update, also of MAGIC and CommFormer.
    #[default(GraphNoise::Stored)]
    pub graph_noise: GraphNoise,
    /// Input of Im-IWoL's policy head.
    #[default(PolicyInput::LatentEmbedding)]
    pub policy_input: PolicyInput,
    /// Target of the world decoder.
    #[default(WorldTarget::State)]
    pub world_target: WorldTarget,
    /// Whether the interaction decoder ends in tanh (released) or is linear.
    pub interaction_tanh: bool,
}

/// The noise of sampled graphs in the update; see [`Iwol::graph_noise`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum GraphNoise {
    /// The noise of the rollout, in all epochs.
    Stored,
    /// New noise in each epoch (released code).
    Resampled,
}

/// The input of Im-IWoL's policy head; see [`Iwol::policy_input`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum PolicyInput {
    /// Latent z and embedding f (released code).
    LatentEmbedding,
    /// Latent z alone (paper, Algorithm 1).
    Latent,
}

/// The target of the world decoder; see [`Iwol::world_target`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum WorldTarget {
    /// The privileged state (paper).
    State,
    /// The agent's own observation (released scripts).
    Observation,
}

impl WorldTarget {
    /// Returns the number of features of the target.
    pub(super) fn width(self, spec: &EnvSpec) -> i64 {
        match self {
            Self::State => spec.state.len() as i64,
            Self::Observation => spec.observation.len() as i64,
        }
    }

    /// Returns the one of `observation` and `state` that is the target.
    pub(super) fn of<'a>(self, observation: &'a Tensor, state: &'a Tensor) -> &'a Tensor {
        match self {
            Self::State => state,
            Self::Observation => observation,
        }
    }
}
