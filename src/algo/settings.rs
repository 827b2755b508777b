//! Settings of the learning algorithms. Each field states its meaning, unit and effect; `Default`
//! has the values that docs/reference/settings.md lists.

use serde::{Deserialize, Serialize};

use tch::Tensor;

use crate::env::EnvSpec;
use crate::nn::MaskMode;

/// All settings of a learner.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Networks, common to all methods.
    pub network: Network,
    /// Proximal policy optimisation, common to all methods.
    pub ppo: Ppo,
    /// Exploration noise of the Gaussian policy.
    pub exploration: Exploration,
    /// Settings of IWoL.
    pub iwol: Iwol,
    /// The transformer of MAT and CommFormer.
    pub transformer: Transformer,
    /// Settings of MAGIC.
    pub magic: Magic,
    /// Settings of CommFormer.
    pub commformer: CommFormer,
    /// Settings of ICP.
    pub icp: Icp,
    /// Settings of MADDPG.
    pub maddpg: Maddpg,
}

impl Settings {
    /// Names of the groups that only some methods read.
    pub const OWN: [&'static str; 6] =
        ["iwol", "transformer", "magic", "commformer", "icp", "maddpg"];

    /// Returns these settings with all groups at their defaults, except those common to all methods
    /// and those named in `groups`.
    #[must_use]
    pub fn only(&self, groups: &[&str]) -> Self {
        fn part<T: Clone + Default>(told: bool, group: &T) -> T {
            if told { group.clone() } else { T::default() }
        }
        let [iwol, transformer, magic, commformer, icp, maddpg] =
            Self::OWN.map(|group| groups.contains(&group));
        Self {
            network: self.network.clone(),
            ppo: self.ppo.clone(),
            exploration: self.exploration.clone(),
            iwol: part(iwol, &self.iwol),
            transformer: part(transformer, &self.transformer),
            magic: part(magic, &self.magic),
            commformer: part(commformer, &self.commformer),
            icp: part(icp, &self.icp),
            maddpg: part(maddpg, &self.maddpg),
        }
    }
}

/// Networks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Network {
    /// Observation encoder: `mlp` (fastest, and sufficient where observations come in a fixed
    /// order), `attention` over entity tokens (paper) or `gru` (released code).
    pub encoder: EncoderKind,
    /// Width H of embeddings and of policy and value layers.
    pub hidden: i64,
    /// Number of layers after the first one in the encoder's perceptron.
    pub extra_layers: usize,
    /// Width of an entity token (attention encoder).
    pub token_width: i64,
    /// Number of heads of the entity attention.
    pub token_heads: i64,
    /// Steps per sequence in the update of a recurrent encoder.
    pub chunk_length: usize,
}

impl Default for Network {
    fn default() -> Self {
        Self {
            encoder: EncoderKind::Mlp,
            hidden: 128,
            extra_layers: 1,
            token_width: 32,
            token_heads: 1,
            chunk_length: 8,
        }
    }
}

/// The kind of observation encoder.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum EncoderKind {
    /// Self-attention over entity tokens.
    Attention,
    /// Perceptron followed by a gated recurrent unit, which has a memory.
    Gru,
    /// Perceptron.
    Mlp,
}

/// Proximal policy optimisation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ppo {
    /// Adam's learning rate for policy and value function.
    pub learning_rate: f64,
    /// Whether the learning rate is proportional to the imposed standard deviation of the actions,
    /// and `learning_rate` is that for a standard deviation of 1. A step of the same size changes a
    /// policy more if the policy has less noise.
    pub learning_rate_follows_noise: bool,
    /// Share of the learning rate that is left when annealing is over.
    pub learning_rate_end: f64,
    /// Largest number of passes over a rollout.
    pub epochs: usize,
    /// Limit of a pass's mean approximate KL divergence from the policy that acted: a pass above
    /// the limit is the last one over its rollout; 0: no limit. It serves policies whose steps are
    /// too large at the common learning rate.
    pub target_kl: f64,
    /// Samples (agent × step) per minibatch; by default half as many for off-policy methods.
    /// Smaller minibatches give more gradient steps.
    pub minibatch: usize,
    /// Number of parts of a minibatch that are processed in parallel, each on its own thread with
    /// its own copy of the networks. One per core is fastest. Another number changes rounding and
    /// the samples from which decoders learn; therefore it is a setting and not read from the
    /// machine. On a GPU there is one part.
    pub shards: usize,
    /// Decay per update of the averaged policy weights, which validation, evaluation and a finished
    /// run use (but not of CommFormer's scores, of which the latest are used); 0: the latest
    /// weights are used.
    pub average: f64,
    /// Discount per step.
    pub gamma: f64,
    /// Discount after [`Exploration::explore_steps`]; 0: [`Ppo::gamma`] throughout. A low discount
    /// keeps vehicles moving early in training; a high one afterwards makes driving safe. At 0.99,
    /// arriving ten steps earlier outweighs a crash risk of one in ten
    /// (docs/lab/0.1.0.md#vehicles-that-steer).
    pub gamma_explored: f64,
    /// λ of generalised advantage estimation.
    pub gae_lambda: f64,
    /// Clip range ε of the ratio and of the value.
    pub clip_range: f64,
    /// Weight of the penalty on mean actions beyond -1 to 1, where actions are clipped: half the
    /// squared excess, in units of the noise's standard deviation; 0: no penalty. Beyond the bounds
    /// noise changes no action, so that the policy learns nothing from it
    /// (docs/lab/0.1.0.md#few-vehicles).
    pub bounds: f64,
    /// Error of the normalised value at which the Huber loss becomes linear.
    pub huber_delta: f64,
    /// Weight of the entropy bonus; 0 where a schedule imposes the noise.
    pub entropy_coefficient: f64,
    /// Largest gradient norm, of policy and value function separately.
    pub max_grad_norm: f64,
    /// Decay of the running statistics that normalise values.
    pub value_norm_beta: f64,
}

impl Default for Ppo {
    fn default() -> Self {
        Self {
            learning_rate: 7e-4,
            learning_rate_follows_noise: true,
            learning_rate_end: 0.02,
            epochs: 5,
            target_kl: 0.0,
            minibatch: 2048,
            shards: 2,
            average: 0.9,
            gamma: 0.99,
            gamma_explored: 0.0,
            gae_lambda: 0.95,
            clip_range: 0.2,
            bounds: 0.1,
            huber_delta: 10.0,
            entropy_coefficient: 0.0,
            max_grad_norm: 10.0,
            value_norm_beta: 0.99999,
        }
    }
}

/// Exploration noise.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Exploration {
    /// `schedule`: the logarithm of the standard deviation is imposed; `learned`: it is a parameter
    /// (released code).
    pub mode: NoiseMode,
    /// Logarithm of the standard deviation at the beginning (initial value of the parameter where
    /// it is learned). An imposed standard deviation also scales the noise of sampled communication
    /// graphs, except that of Im-IWoL, whose graph only the value function has.
    pub log_std_start: f64,
    /// Logarithm of the standard deviation after [`Exploration::explore_steps`], kept until
    /// annealing begins. A value that is too low freezes a run that has not succeeded by then.
    pub log_std_explore: f64,
    /// Logarithm of the standard deviation when annealing is over.
    pub log_std_end: f64,
    /// Environment steps over which the logarithm of the standard deviation falls linearly from
    /// `log_std_start` to `log_std_explore`.
    pub explore_steps: u64,
    /// Correlation of the noise of actions from step to step (first-order
    /// autoregressive, of constant variance) until annealing begins; then there is none. Correlated
    /// noise moves a vehicle further from its mean trajectory and so finds other orders of passing;
    /// but vehicles that must allow for it drive slowly (Hollenstein et al., AAAI 2024).
    /// Probabilities of actions are conditional on the noise of the step before.
    pub correlation: f64,
}

impl Default for Exploration {
    fn default() -> Self {
        Self {
            mode: NoiseMode::Schedule,
            log_std_start: 0.0,
            log_std_explore: -1.0,
            log_std_end: -2.0,
            explore_steps: 250_000,
            correlation: 0.0,
        }
    }
}

/// The source of the actions' standard deviation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum NoiseMode {
    /// A schedule imposes it.
    Schedule,
    /// It is a parameter and is learned.
    Learned,
}

/// Settings of IWoL. Defaults follow the paper; alternatives of the released code are named.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Iwol {
    /// Width Z of Im-IWoL's latent z (paper: 32).
    pub latent: i64,
    /// Width D of a message and of the graph transformer that computes it (paper: 128).
    pub message: i64,
    /// Number of rounds L of the graph transformer (released scripts: 4).
    pub rounds: usize,
    /// Number of attention heads of the graph transformer (paper: 4).
    pub heads: i64,
    /// λ_W, weight of the world decoder's loss (paper: 0.05).
    pub lambda_world: f64,
    /// λ_I, weight of the interaction decoder's loss (paper: 0.05).
    pub lambda_interaction: f64,
    /// Share of a minibatch's samples, chosen at random, from which the decoders learn. All samples
    /// would cost more than the policy itself, for a mean that a part estimates as well.
    pub decoded: f64,
    /// Slope of the leaky rectifier in the additive attention (released: 1.2 for driving).
    pub slope: f64,
    /// Number added to the score of every edge. With 3, nineteen of twenty edges are open at the
    /// beginning of training, and learning closes some of them; with 0 (released) about half of
    /// them are open.
    pub graph_bias: f64,
    /// Temperature of the Gumbel-softmax.
    pub temperature: f64,
    /// Effect of the graph on attention: `hard` lets nothing pass a closed edge; `logit-mul`
    /// multiplies logits (released).
    pub mask: MaskMode,
    /// Whether the physical mask cuts edges (released: no).
    pub physical_mask: bool,
    /// Noise of sampled graphs in the update, also of MAGIC and CommFormer: `stored` keeps the
    /// sampled graph through all epochs, `resampled` draws new noise in each epoch (released).
    pub graph_noise: GraphNoise,
    /// Input of Im-IWoL's policy head: `latent-embedding` (z and f; released) or `latent` (z alone;
    /// Algorithm 1).
    pub policy_input: PolicyInput,
    /// Target of the world decoder: the privileged `state` (paper) or the agent's own `observation`
    /// (released scripts).
    pub world_target: WorldTarget,
    /// Whether the interaction decoder ends in tanh (released) or is linear.
    pub interaction_tanh: bool,
}

impl Default for Iwol {
    fn default() -> Self {
        Self {
            latent: 32,
            message: 64,
            rounds: 1,
            heads: 4,
            lambda_world: 0.05,
            lambda_interaction: 0.05,
            decoded: 0.25,
            slope: 0.2,
            graph_bias: 0.0,
            temperature: 1.0,
            mask: MaskMode::Hard,
            physical_mask: true,
            graph_noise: GraphNoise::Stored,
            policy_input: PolicyInput::LatentEmbedding,
            world_target: WorldTarget::State,
            interaction_tanh: false,
        }
    }
}

/// The transformer of MAT and CommFormer, as wide as the network's layers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Transformer {
    /// Number of blocks of the encoder, and of the decoder.
    pub blocks: usize,
    /// Number of attention heads (scripts of MAT and CommFormer: 1; the paper has 4 for every
    /// method).
    pub heads: i64,
}

impl Default for Transformer {
    fn default() -> Self {
        Self { blocks: 1, heads: 4 }
    }
}

/// Settings of MAGIC.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Magic {
    /// Weight of the loss of a world decoder on the messages, as in Ex-IWoL (paper, RQ3); 0: no
    /// decoder.
    pub lambda_world: f64,
}

/// Settings of CommFormer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CommFormer {
    /// Share of the agents that each agent listens to.
    pub sparsity: f64,
    /// Period of graph training in passes over a rollout: the last pass of each period trains the
    /// graph alone, the others train everything else.
    pub graph_every: usize,
    /// Learning rate of the graph, as a share of that of the other parameters (reference: 1e-4 and
    /// 5e-4, a share of 0.2).
    pub graph_rate: f64,
    /// Weight of the loss of a world decoder on the representations, as in Ex-IWoL (paper, RQ3); 0:
    /// no decoder.
    pub lambda_world: f64,
    /// Dropout rate of the encoder blocks in updates (reference: 0.1). Acting has no dropout, so
    /// that with a rate above 0 ratios compare different networks.
    pub dropout: f64,
}

impl Default for CommFormer {
    fn default() -> Self {
        Self { sparsity: 0.4, graph_every: 5, graph_rate: 0.2, lambda_world: 0.0, dropout: 0.0 }
    }
}

/// Settings of ICP.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Icp {
    /// Number K of symbols that an action can show.
    pub symbols: i64,
    /// Weight of the loss of the decoder, which predicts from a symbol what its sender saw and did.
    pub lambda_message: f64,
}

impl Default for Icp {
    fn default() -> Self {
        Self { symbols: 16, lambda_message: 0.05 }
    }
}

/// Settings of MADDPG. Of the common settings, MADDPG reads learning rates, minibatch, discounts,
/// value normalisation, largest gradient norm and averaging.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Maddpg {
    /// Number of rollouts in the replay buffer. Checkpoints contain the buffer, so that their size
    /// grows with this number.
    pub replay: usize,
    /// Number of minibatches drawn from the replay buffer after each rollout.
    pub updates: usize,
    /// Number of steps whose rewards are added before the critic's value of the last one:
    /// multi-step returns (Lowe et al., 2017: 1), without a correction for changes of the policy
    /// since. With one step, vehicles learned to stop before the crossing permanently
    /// (docs/lab/0.1.0.md#maddpg).
    pub n_step: usize,
    /// Share τ of the distance to the trained networks by which target networks move after each
    /// minibatch.
    pub target_rate: f64,
    /// Weight in the policy's loss of the squared mean actions before the tanh (Lowe et al., 2017:
    /// 1e-3).
    pub action_penalty: f64,
}

impl Default for Maddpg {
    fn default() -> Self {
        Self { replay: 16, updates: 64, n_step: 10, target_rate: 0.005, action_penalty: 1e-3 }
    }
}

/// The noise of sampled graphs in the update; see [`Iwol::graph_noise`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum GraphNoise {
    /// The noise of the rollout, in all epochs.
    Stored,
    /// New noise in each epoch.
    Resampled,
}

/// The input of Im-IWoL's policy head; see [`Iwol::policy_input`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PolicyInput {
    /// Latent z and embedding f.
    LatentEmbedding,
    /// Latent z alone.
    Latent,
}

/// The target of the world decoder; see [`Iwol::world_target`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum WorldTarget {
    /// The privileged state.
    State,
    /// The agent's own observation.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::algo::{NAMES, capabilities};

    #[test]
    fn methods_are_told_of_groups_that_there_are() {
        let mut settings = Settings::default();
        (settings.ppo.epochs, settings.iwol.rounds, settings.transformer.blocks) = (1, 7, 3);
        (settings.magic.lambda_world, settings.commformer.graph_every) = (0.5, 2);
        (settings.icp.symbols, settings.maddpg.n_step) = (5, 3);
        assert_eq!(settings.only(&Settings::OWN), settings);
        let common = Settings { ppo: settings.ppo.clone(), ..Settings::default() };
        assert_eq!(settings.only(&[]), common);
        let mut told: Vec<&str> = Vec::new();
        for name in NAMES {
            let groups = capabilities(name).expect("a method").settings;
            assert!(groups.iter().all(|group| Settings::OWN.contains(group)), "{name}: {groups:?}");
            told.extend(groups);
        }
        for group in Settings::OWN {
            assert!(told.contains(&group), "nobody is told of {group}");
            assert_ne!(settings.only(&[group]), common, "{group}");
        }
    }
}
