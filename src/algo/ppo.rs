//! Proximal policy optimisation as pure functions, which all on-policy methods share
//! (marlbenchmark/on-policy, `r_mappo.py`).

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use smart_default::SmartDefault;
use tch::{Kind, Tensor};

/// Clip range ε of the ratio and of the value (paper, table of hyperparameters).
pub(super) const CLIP_RANGE: f64 = 0.2;
/// Error of the normalised value at which the Huber loss becomes linear (same table).
const HUBER_DELTA: f64 = 10.0;
/// Largest gradient norm, of policy and value function separately (same table).
pub(super) const MAX_GRAD_NORM: f64 = 10.0;

/// Proximal policy optimisation. MADDPG, which learns from a replay buffer, reads neither
/// `bounds`, `entropy_coefficient`, `entropy_end`, `epochs`, `gae_lambda` nor `shards`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema, SmartDefault)]
#[serde(deny_unknown_fields)]
#[schemars(default)]
pub struct Ppo {
    /// Adam's learning rate for policy and value function.
    #[default = 7e-4]
    #[schemars(range(min = 0))]
    pub learning_rate: f64,
    /// Whether the learning rate is proportional to the imposed standard deviation of the actions,
    /// and `ppo.learning_rate` is that for a standard deviation of 1. A step of the same size
    /// changes a policy more if the policy has less noise. By default false where actions are
    /// discrete.
    #[default = true]
    pub learning_rate_follows_noise: bool,
    /// Share of the learning rate that is left when annealing is over.
    #[default = 0.02]
    #[schemars(range(min = 0, max = 1))]
    pub learning_rate_end: f64,
    /// Number of passes over a rollout (docs/lab/0.1.0.md#five-passes-over-a-rollout).
    #[default = 5]
    #[schemars(range(min = 1, max = 1000))]
    pub epochs: usize,
    /// Samples (agent × step) per minibatch; by default half as many for off-policy methods.
    /// Smaller minibatches give more gradient steps.
    #[default = 2048]
    #[schemars(range(min = 1))]
    pub minibatch: usize,
    /// Number of parts of a minibatch that are processed in parallel, each on its own thread with
    /// its own copy of the networks. The decisions of a rollout are divided as well, where a step has
    /// at least 256. One part per core is fastest; 1 where each core has a run of its own. Another
    /// number changes rounding and the samples from which decoders learn; therefore it is a setting
    /// and not read from the machine. On a GPU there is one part per process.
    #[default = 2]
    #[schemars(range(min = 1, max = 64))]
    pub shards: usize,
    /// Decay per update of the averaged policy weights, which validation, evaluation and a finished
    /// run use (but not of CommFormer's scores, of which the latest are used); 0: the latest
    /// weights are used.
    #[default = 0.9]
    #[schemars(range(min = 0), extend("exclusiveMaximum" = 1))]
    pub average: f64,
    /// Discount per step. The lower it is, the more time is worth: at 0.99, arriving ten steps earlier
    /// outweighs a crash risk of one in ten. With a higher discount, vehicles crash less and drive
    /// more slowly (docs/lab/decision-process.md#the-discount).
    #[default = 0.9925]
    #[schemars(range(min = 0, max = 1))]
    pub gamma: f64,
    /// λ of generalised advantage estimation.
    #[default = 0.95]
    #[schemars(range(min = 0, max = 1))]
    pub gae_lambda: f64,
    /// Weight of the penalty on mean actions beyond -1 to 1, where actions are clipped: half the
    /// squared excess, in units of the noise's standard deviation; 0: no penalty. Beyond the bounds
    /// noise changes no action, so that the policy learns nothing from it
    /// (docs/lab/0.1.0.md#few-vehicles).
    #[default = 0.1]
    #[schemars(range(min = 0))]
    pub bounds: f64,
    /// Weight of the entropy bonus, which keeps a policy with discrete actions or with learned noise
    /// exploring; by default 0.01 where actions are discrete.
    pub entropy_coefficient: f64,
    /// Share of the weight of the entropy bonus that is left when annealing is over. The logarithm
    /// of the weight falls linearly while annealing lowers the noise
    /// (docs/lab/messages.md#the-traffic-junction-how-the-settings-were-found).
    #[default = 1.0]
    #[schemars(range(max = 1), extend("exclusiveMinimum" = 0))]
    pub entropy_end: f64,
}

/// Returns the clipped surrogate loss −Σ min(ρA, clip(ρ, 1 ± ε)A) · active / Σ active.
/// Log-probabilities are `[B, K]`, and the surrogates of a sample's K ratios are added. The other
/// arguments are `[B]`.
pub fn policy_loss(
    log_prob: &Tensor,
    old_log_prob: &Tensor,
    advantage: &Tensor,
    active: &Tensor,
) -> Tensor {
    let (ratio, advantage) = ((log_prob - old_log_prob).exp(), advantage.unsqueeze(-1));
    let clipped = ratio.clamp(1.0 - CLIP_RANGE, 1.0 + CLIP_RANGE);
    let surrogate = (&ratio * &advantage).minimum(&(clipped * &advantage));
    -masked_mean(&surrogate.sum_dim_intlist(-1, false, Kind::Float), active)
}

/// Returns the clipped Huber loss of normalised values: per sample, the larger one of the plain and
/// the clipped loss. All tensors are `[B]`.
pub fn value_loss(value: &Tensor, old_value: &Tensor, target: &Tensor, active: &Tensor) -> Tensor {
    let clipped = old_value + (value - old_value).clamp(-CLIP_RANGE, CLIP_RANGE);
    let loss = huber(&(target - value)).maximum(&huber(&(target - clipped)));
    masked_mean(&loss, active)
}

/// Returns the penalty on means `[B, A]` beyond -1 to 1: half the squared excess, in units of the
/// standard deviation, added over dimensions and averaged over samples. No gradient reaches
/// `log_std`.
pub fn bounds_loss(mean: &Tensor, log_std: &Tensor) -> Tensor {
    let excess = (mean.abs() - 1.0).relu() / log_std.detach().exp();
    excess.square().sum_dim_intlist(-1, false, Kind::Float).mean(Kind::Float) * 0.5
}

/// Returns e²/2 up to an error of δ, [`HUBER_DELTA`], and a linear function beyond.
fn huber(error: &Tensor) -> Tensor {
    let size = error.abs();
    // min(e, δ) · (e − min(e, δ)/2) equals both branches.
    let inner = size.clamp_max(HUBER_DELTA);
    &inner * (size - &inner * 0.5)
}

/// Returns Σ x · weight / Σ weight, and 0 where all weights are 0.
pub fn masked_mean(x: &Tensor, weight: &Tensor) -> Tensor {
    (x * weight).sum(Kind::Float) / weight.sum(Kind::Float).clamp_min(1e-8)
}

/// Normalises to mean 0 and standard deviation 1 over entries with `active > 0`; the others become
/// 0.
pub fn normalize_advantages(advantage: &mut [f32], active: &[f32]) {
    let chosen = || {
        advantage
            .iter()
            .zip(active)
            .filter(|(_, active)| **active > 0.0)
            .map(|(a, _)| f64::from(*a))
    };
    let count = chosen().count().max(1) as f64;
    let mean = chosen().sum::<f64>() / count;
    let deviation = (chosen().map(|a| (a - mean).powi(2)).sum::<f64>() / count).sqrt() + 1e-5;
    for (a, &active) in advantage.iter_mut().zip(active) {
        *a = if active > 0.0 { ((f64::from(*a) - mean) / deviation) as f32 } else { 0.0 };
    }
}

/// Returns the share of the returns' variance that the values explain, over active entries; 0 where
/// returns do not vary.
pub fn explained_variance(values: &[f32], returns: &[f32], active: &[f32]) -> f64 {
    let variance = |of: &dyn Fn(usize) -> f64| {
        let chosen: Vec<f64> = (0..active.len()).filter(|&i| active[i] > 0.0).map(of).collect();
        let mean = chosen.iter().sum::<f64>() / chosen.len().max(1) as f64;
        chosen.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / chosen.len().max(1) as f64
    };
    let total = variance(&|i| f64::from(returns[i]));
    if total < 1e-12 { 0.0 } else { 1.0 - variance(&|i| f64::from(returns[i] - values[i])) / total }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normalized_advantages_ignore_inactive_entries() {
        let mut advantage = vec![1.0, 2.0, 3.0, 1e9];
        normalize_advantages(&mut advantage, &[1.0, 1.0, 1.0, 0.0]);
        assert_eq!(advantage[3], 0.0);
        assert!((advantage[0] + 1.224_7).abs() < 1e-3 && advantage[1].abs() < 1e-6);
    }

    /// With one ratio for each dimension of the action, each is clipped by itself.
    #[test]
    fn ratios_of_single_dimensions_are_clipped_by_themselves() {
        let loss = |ratios: &[f32]| {
            let new = Tensor::from_slice(ratios).log().unsqueeze(0);
            let one = Tensor::from_slice(&[1.0_f32]);
            policy_loss(&new, &new.zeros_like(), &one, &one).double_value(&[])
        };
        assert!((loss(&[1.5, 0.5]) + 1.2 + 0.5).abs() < 1e-6);
        assert!((loss(&[1.5 * 0.5]) + 0.75).abs() < 1e-6);
    }

    /// The first gradient step on a whole rollout is that of REINFORCE with a baseline
    /// (`presets/magic_reinforce.toml`).
    #[test]
    fn the_first_step_follows_the_policy_gradient() {
        let old = Tensor::from_slice(&[-0.3_f32, -2.0, 0.4, -1.0]).view([4, 1]);
        let new = old.copy().set_requires_grad(true);
        let advantage = Tensor::from_slice(&[0.5_f32, -8.0, 9.0, 3.0]);
        let active = Tensor::from_slice(&[1.0_f32, 1.0, 1.0, 0.0]);
        policy_loss(&new, &old, &advantage, &active).backward();
        // -A ∇ log π, averaged over the active samples.
        let expected = Tensor::from_slice(&[-0.5_f32 / 3.0, 8.0 / 3.0, -3.0, 0.0]);
        let difference = (new.grad().view([-1]) - expected).abs().max().double_value(&[]);
        assert!(difference < 1e-6, "{:?}", new.grad());
    }

    #[test]
    fn means_beyond_the_bounds_are_pushed_back() {
        let mean =
            Tensor::from_slice(&[0.9_f32, -3.0, 1.5, -1.0]).view([2, 2]).set_requires_grad(true);
        let log_std = Tensor::from_slice(&[0.0_f32, 2.0_f32.ln()]);
        let loss = bounds_loss(&mean, &log_std);
        // Half of 0.5² and of (2 / 2)², over two samples.
        assert!((loss.double_value(&[]) - 0.3125).abs() < 1e-6, "{loss:?}");
        loss.backward();
        assert_eq!(
            Vec::<f32>::try_from(mean.grad().view([-1])).expect("numbers"),
            [0.0, -0.25, 0.25, 0.0]
        );
    }

    #[test]
    fn explained_variance_knows_the_extremes() {
        let returns = [1.0, 2.0, 4.0, 99.0];
        let active = [1.0, 1.0, 1.0, 0.0];
        assert_eq!(explained_variance(&returns, &returns, &active), 1.0);
        assert!(explained_variance(&[7.0 / 3.0; 4], &returns, &active).abs() < 1e-6);
    }
}
