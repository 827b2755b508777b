//! Settings of the learners. Each field says meaning, unit and what turning it does; `Default` is what docs/settings.md reports.

use serde::{Deserialize, Serialize};

use tch::Tensor;

use crate::env::EnvSpec;
use crate::nn::MaskMode;

/// Everything a learner can be told.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Networks, the same for every method.
    pub network: Network,
    /// Proximal policy optimisation, the same for every method.
    pub ppo: Ppo,
    /// Exploration noise of the Gaussian policy.
    pub exploration: Exploration,
    /// IWoL's own.
    pub iwol: Iwol,
    /// The transformer of MAT and CommFormer.
    pub transformer: Transformer,
    /// MAGIC's own.
    pub magic: Magic,
    /// CommFormer's own.
    pub commformer: CommFormer,
    /// ICP's own.
    pub icp: Icp,
    /// MADDPG's own.
    pub maddpg: Maddpg,
}

impl Settings {
    /// Names of the groups that not every method is told of.
    pub const OWN: [&'static str; 6] =
        ["iwol", "transformer", "magic", "commformer", "icp", "maddpg"];

    /// Those of all methods, and of the others the `groups` that are named; the rest by default.
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
    /// Observation encoder: `mlp` (fastest, and enough where observations come in a fixed order), `attention` over entity
    /// tokens (paper) or `gru` (released code).
    pub encoder: EncoderKind,
    /// Width H of embeddings, policy and value layers.
    pub hidden: i64,
    /// Layers after the first in the encoder's perceptron.
    pub extra_layers: usize,
    /// Width of an entity token (attention encoder).
    pub token_width: i64,
    /// Heads of the entity attention.
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

/// Kind of observation encoder.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum EncoderKind {
    /// Self-attention over entity tokens.
    Attention,
    /// Perceptron and gated recurrent unit with memory.
    Gru,
    /// Perceptron.
    Mlp,
}

/// Proximal policy optimisation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ppo {
    /// Adam's learning rate for policy and value.
    pub learning_rate: f64,
    /// Whether that rate is for a standard deviation of 1 of the actions, and falls with the imposed one: a step of the same
    /// size changes a policy with less noise by more.
    pub learning_rate_follows_noise: bool,
    /// Share of the rate that is left when annealing is over.
    pub learning_rate_end: f64,
    /// Passes over a rollout, at most.
    pub epochs: usize,
    /// A pass in which the policy has moved further than this from the one that acted (mean approximate KL divergence of the pass) is the
    /// last over its rollout, unless it imitates then; 0: never. For policies whose steps turn out too large at the common learning rate.
    pub target_kl: f64,
    /// Samples (agent × step) per minibatch (half as many for methods that replay); more gradient steps with smaller ones.
    pub minibatch: usize,
    /// Parts of a minibatch that are worked on at the same time, each on a thread of its own with a copy of the networks.
    /// As many as there are cores is fastest. Another number gives other roundings, and lets decoders learn from other
    /// samples, so that it is a setting, and not found out from the machine. A graphics processor does everything at once.
    pub shards: usize,
    /// Decay per update of the averaged policy weights that validation, evaluation and a finished run use (not of CommFormer's scores, which
    /// are the newest); 0: the last weights are used.
    pub average: f64,
    /// Discount per step.
    pub gamma: f64,
    /// Discount once [`Exploration::explore_steps`] are over; 0: as before. A short view finds a way sooner, among vehicles that
    /// move; a long one then makes it safe: at 0.99, arriving ten steps earlier is worth a crash in ten.
    pub gamma_explored: f64,
    /// λ of generalised advantage estimation.
    pub gae_lambda: f64,
    /// ε of the clipped ratio and of the clipped value.
    pub clip: f64,
    /// Weight in the loss of how far the actions' means lie beyond -1 to 1, where actions are clipped: half the square, in units of
    /// their noise. Beyond, noise changes nothing that is done, and the policy learns nothing from it: among 4 vehicles, one way of 70
    /// to begin failed for a million steps, in which both drove at full throttle. In worlds with less noise it weighs more, as it is not
    /// divided among them like the policy's loss: at a spread of 1.2 its gradient is four times that without, on average. 0: not at all.
    pub bounds: f64,
    /// Where the Huber loss of the (normalised) value turns linear.
    pub huber_delta: f64,
    /// Weight of the entropy bonus; 0 where the noise is imposed by a schedule.
    pub entropy: f64,
    /// Largest gradient norm, policy and value separately.
    pub max_grad_norm: f64,
    /// Decay of the value normalisation's running statistics.
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
            clip: 0.2,
            bounds: 0.1,
            huber_delta: 10.0,
            entropy: 0.0,
            max_grad_norm: 10.0,
            value_norm_beta: 0.99999,
        }
    }
}

/// Exploration noise.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Exploration {
    /// `schedule`: the logarithm of the standard deviation is imposed; `learned`: it is a parameter (released code).
    pub mode: NoiseMode,
    /// Logarithm of the standard deviation at the beginning (of the parameter, when learned). An imposed one scales the noise
    /// of sampled communication graphs, too (not of Im-IWoL's, which its value alone has).
    pub log_std_start: f64,
    /// … after [`Exploration::explore_steps`], held until annealing begins. Too low freezes a run that has not found the
    /// way yet.
    pub log_std_explore: f64,
    /// … when annealing is over.
    pub log_std_end: f64,
    /// Environment steps over which it falls linearly from the first to the second.
    pub explore_steps: u64,
    /// Correlation of the noise of throttle and brake with that of the step before (first-order
    /// autoregressive, of the same variance), until annealing begins; none after it. Such noise
    /// moves a vehicle further from where it would be, and so finds other orders of going first;
    /// but vehicles that must reckon with it drive slowly (Hollenstein et al., AAAI 2024).
    /// Probabilities of actions are those given the noise of the step before.
    pub correlation: f64,
    /// Environment steps over which it falls to 0; 0: it stays.
    pub correlation_steps: u64,
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
            correlation_steps: 0,
        }
    }
}

/// Where the standard deviation comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum NoiseMode {
    /// Imposed.
    Schedule,
    /// A parameter.
    Learned,
}

/// IWoL's own settings. Defaults follow the paper; each alternative that the released code uses is named.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Iwol {
    /// Width D of Im-IWoL's latent z (paper: 32).
    pub latent: i64,
    /// Width of a message, and of the graph transformer that makes it (paper: 128).
    pub message: i64,
    /// Rounds L of the graph transformer (released scripts: 4).
    pub rounds: usize,
    /// Attention heads of the graph transformer (paper: 4).
    pub heads: i64,
    /// λ_W, weight of the world decoder's loss (paper: 0.05).
    pub lambda_world: f64,
    /// λ_I, weight of the interaction decoder's loss (paper: 0.05).
    pub lambda_interaction: f64,
    /// Share of a minibatch's samples (at random) from which the decoders learn. All of them would cost more than the policy
    /// itself does, for a mean that a part estimates as well.
    pub decoded: f64,
    /// Slope of the leaky rectifier in the additive attention (released: 1.2 for driving).
    pub slope: f64,
    /// Added to the score of every edge: with 3, nineteen of twenty edges exist at the beginning of training, and learning
    /// cuts them (released: 0, where about half of them exist).
    pub graph_bias: f64,
    /// Temperature of the Gumbel-softmax.
    pub temperature: f64,
    /// How the graph enters attention: `hard` lets nothing through a cut edge; `logit-mul` multiplies logits (released).
    pub mask: MaskMode,
    /// Whether the physical mask applies (released: no).
    pub physical_mask: bool,
    /// Noise of sampled graphs (also MAGIC's and CommFormer's) in the update: `stored` keeps the sampled graph through all epochs, `resampled` draws anew in
    /// each (released).
    pub graph_noise: GraphNoise,
    /// What Im-IWoL's policy head reads: `latent-embedding` (z and f; released) or `latent` (z alone; Algorithm 1).
    pub policy_input: PolicyInput,
    /// What the world decoder predicts: the privileged `state` (paper) or the agent's own `observation` (released scripts).
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
    /// Blocks of its encoder, and of its decoder.
    pub blocks: usize,
    /// Attention heads (MAT's and CommFormer's scripts: 1; the paper has 4 for every method).
    pub heads: i64,
}

impl Default for Transformer {
    fn default() -> Self {
        Self { blocks: 1, heads: 4 }
    }
}

/// MAGIC's own settings.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Magic {
    /// Weight of the loss of a world decoder on the messages, as Ex-IWoL has one (paper, RQ3); 0: no decoder.
    pub lambda_world: f64,
}

/// CommFormer's own settings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CommFormer {
    /// Share of the agents that each one listens to.
    pub sparsity: f64,
    /// Of so many passes over a rollout, the last trains the graph, and nothing else.
    pub graph_every: usize,
    /// Learning rate of the graph, as a share of the others' (reference: 1e-4 beside 5e-4).
    pub graph_rate: f64,
    /// Weight of the loss of a world decoder on the representations, as Ex-IWoL has one (paper, RQ3); 0: no decoder.
    pub lambda_world: f64,
    /// Share of what encoder blocks bring that is dropped in updates, and in updates alone, so that ratios compare different
    /// networks (reference: 0.1).
    pub dropout: f64,
}

impl Default for CommFormer {
    fn default() -> Self {
        Self { sparsity: 0.4, graph_every: 5, graph_rate: 0.2, lambda_world: 0.0, dropout: 0.0 }
    }
}

/// ICP's own settings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Icp {
    /// Symbols K that an action can show.
    pub symbols: i64,
    /// Weight of the loss of the decoder, which tells from a symbol what its sender saw and did.
    pub lambda_message: f64,
}

impl Default for Icp {
    fn default() -> Self {
        Self { symbols: 16, lambda_message: 0.05 }
    }
}

/// MADDPG's own settings. Of the common ones it takes learning rates, minibatch, discounts, value normalisation, largest gradient norm and
/// averaging.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Maddpg {
    /// Rollouts that are kept and replayed. They stand in checkpoints, whose size grows with them.
    pub replay: usize,
    /// Minibatches of replayed steps that are learned from after each rollout.
    pub updates: usize,
    /// Steps whose rewards are counted before the critic's value of the last: multi-step returns (Lowe et al., 2017: 1), not corrected for
    /// the policy being another by now. With one, vehicles learned to stop before the crossing for good.
    pub n_step: usize,
    /// Share τ of their distance by which target networks follow after each.
    pub target_rate: f64,
    /// Weight of the squared mean actions before the tanh in the policy's loss (Lowe et al., 2017: 1e-3).
    pub action_penalty: f64,
}

impl Default for Maddpg {
    fn default() -> Self {
        Self { replay: 16, updates: 64, n_step: 10, target_rate: 0.005, action_penalty: 1e-3 }
    }
}

/// See [`Iwol::graph_noise`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum GraphNoise {
    /// One graph per step, kept.
    Stored,
    /// A new graph in each epoch.
    Resampled,
}

/// See [`Iwol::policy_input`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PolicyInput {
    /// z and f.
    LatentEmbedding,
    /// z.
    Latent,
}

/// See [`Iwol::world_target`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum WorldTarget {
    /// Privileged state.
    State,
    /// Own observation.
    Observation,
}

impl WorldTarget {
    /// Features of the target.
    pub(super) fn width(self, spec: &EnvSpec) -> i64 {
        match self {
            Self::State => spec.state.len() as i64,
            Self::Observation => spec.observation.len() as i64,
        }
    }

    /// The target among the two.
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
