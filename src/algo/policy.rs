//! The head of a policy, whatever its actions are, and its loss.

use tch::{Kind, Tensor, no_grad};

use super::batch::{Batch, Shard};
use super::categorical::CategoricalHead;
use super::decision::ActMode;
use super::head::{GaussianHead, shifted};
use super::parameters::ParameterBuilder;
use super::ppo::{self, CLIP_RANGE, Ppo};
use super::settings::Settings;
use crate::env::{ActionSpace, EnvSpec};
use crate::nn::{gaussian_entropy, gaussian_log_prob};

/// The head of a policy.
#[derive(Debug)]
pub enum PolicyHead {
    /// Of continuous actions.
    Gaussian(GaussianHead),
    /// Of discrete actions.
    Categorical(CategoricalHead),
}

impl PolicyHead {
    /// Creates the head of a policy that reads `inputs` features, as the actor's `head`.
    pub fn of_actor(
        builder: &mut ParameterBuilder,
        inputs: i64,
        spec: &EnvSpec,
        settings: &Settings,
    ) -> Self {
        match &spec.actions {
            ActionSpace::Continuous(_) => {
                Self::Gaussian(GaussianHead::of_actor(builder, inputs, spec, settings))
            }
            ActionSpace::Discrete(choices) => {
                Self::Categorical(CategoricalHead::of_actor(builder, inputs, choices.len()))
            }
        }
    }

    /// Returns the head of continuous actions.
    ///
    /// # Panics
    /// Where actions are discrete.
    pub(super) fn gaussian(&self) -> &GaussianHead {
        let Self::Gaussian(head) = self else { panic!("continuous actions") };
        head
    }

    /// Returns the head with a tanh on the means of continuous actions.
    #[must_use]
    pub fn bounded(self) -> Self {
        match self {
            Self::Gaussian(head) => Self::Gaussian(head.bounded()),
            other @ Self::Categorical(_) => other,
        }
    }

    /// Returns actions `[E, N, A]` and the log-probabilities of their dimensions, `[E, N, A]`, from
    /// what the policy reads, `[E, N, W]`. `available [E, N, K]` is 1 where a choice is open; empty
    /// where all are.
    pub fn sample(&self, x: &Tensor, available: &Tensor, mode: &ActMode) -> (Tensor, Tensor) {
        match self {
            Self::Gaussian(head) => head.sample(x, mode),
            Self::Categorical(head) => head.sample(x, available, mode),
        }
    }

    /// Returns actions `[.., A]` as networks read them: as they are, or with 1 in the place of the
    /// choice, `[.., K]`.
    pub fn encoded(&self, action: &Tensor) -> Tensor {
        match self {
            Self::Gaussian(_) => action.shallow_clone(),
            Self::Categorical(head) => head.one_hot(action),
        }
    }

    /// Sets the logarithm of the standard deviation of continuous actions, unless it is learned.
    pub(super) fn impose(&self, log_std: f64) {
        if let Self::Gaussian(head) = self {
            head.impose(log_std);
        }
    }

    /// Returns the standard deviation of each dimension of continuous actions; empty for discrete
    /// ones.
    pub(super) fn deviations(&self) -> Vec<f32> {
        match self {
            Self::Gaussian(head) => head.deviations(),
            Self::Categorical(_) => Vec::new(),
        }
    }

    /// Returns the standard deviation of continuous actions, averaged over their dimensions.
    pub(super) fn std(&self) -> Option<f64> {
        match self {
            Self::Gaussian(head) => Some(head.std()),
            Self::Categorical(_) => None,
        }
    }
}

/// The probability whose ratio is clipped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ratio {
    /// The probability of the whole action.
    Joint,
    /// The probability of each dimension of the action (MAT, CommFormer).
    PerDimension,
}

/// Loss and diagnostics of the policy on the active samples of a shard.
pub struct PolicyTerms {
    /// The loss of the policy, with the entropy bonus and the penalty on means out of bounds.
    pub loss: Tensor,
    policy: Tensor,
    entropy: Tensor,
    /// Distance of the policy from the policy that acted, as the mean of `(ρ - 1) - ln ρ`.
    approx_kl: Tensor,
    clip_fraction: Tensor,
}

impl PolicyTerms {
    /// Computes the terms from what the head reads of each active sample, `input [B, W]`.
    pub fn new(
        batch: &Batch,
        shard: &Shard,
        head: &PolicyHead,
        input: &Tensor,
        ppo: &Ppo,
        ratio: Ratio,
    ) -> Self {
        let Scored { log_prob, entropy, bounds } = Scored::new(batch, shard, head, input);
        let counted = |log_prob: Tensor| match ratio {
            Ratio::Joint => log_prob.sum_dim_intlist(-1, true, Kind::Float),
            Ratio::PerDimension => log_prob,
        };
        let (log_prob, old) = (counted(log_prob), counted(shard.active(&batch.log_prob)));
        let advantage = shard.active(&batch.advantage);
        let policy = ppo::policy_loss(&log_prob, &old, &advantage, &advantage.ones_like());
        let entropy = entropy.mean(Kind::Float);
        let (approx_kl, clip_fraction) = no_grad(|| {
            let difference = &log_prob - &old;
            let outside = (difference.exp() - 1.0).abs().gt(CLIP_RANGE).to_kind(Kind::Float);
            let difference = difference.sum_dim_intlist(-1, false, Kind::Float);
            ((difference.exp() - 1.0 - difference).mean(Kind::Float), outside.mean(Kind::Float))
        });
        let mut loss = &policy - ppo.entropy_coefficient * &entropy;
        if let Some(bounds) = bounds {
            loss += ppo.bounds * bounds;
        }
        Self { loss, policy, entropy, approx_kl, clip_fraction }
    }

    /// Returns the diagnostics to report.
    pub(super) fn report(&self) -> [(&'static str, Tensor); 4] {
        [
            ("loss/policy", self.policy.detach()),
            ("loss/entropy", self.entropy.detach()),
            ("ppo/approx_kl", self.approx_kl.shallow_clone()),
            ("ppo/clip_fraction", self.clip_fraction.shallow_clone()),
        ]
    }
}

/// What the present policy says of the actions that were taken.
struct Scored {
    /// Log-probability of each dimension, `[B, A]`.
    log_prob: Tensor,
    entropy: Tensor,
    /// Penalty on means beyond the bounds of continuous actions.
    bounds: Option<Tensor>,
}

impl Scored {
    fn new(batch: &Batch, shard: &Shard, head: &PolicyHead, input: &Tensor) -> Self {
        let action = shard.active(&batch.action);
        let some = |tensor: &Tensor| {
            if tensor.numel() > 0 { shard.active(tensor) } else { tensor.shallow_clone() }
        };
        match head {
            PolicyHead::Gaussian(head) => {
                let (mean, log_std) = head.forward(input);
                let expected = shifted(&mean, &log_std, &some(&batch.carried));
                let log_std = log_std + shard.active(&batch.log_fresh);
                Self {
                    log_prob: gaussian_log_prob(&expected, &log_std, &action),
                    entropy: gaussian_entropy(&log_std),
                    bounds: Some(ppo::bounds_loss(&mean, &log_std)),
                }
            }
            PolicyHead::Categorical(head) => {
                let (log_prob, entropy) = head.score(input, &some(&batch.available), &action);
                Self { log_prob, entropy, bounds: None }
            }
        }
    }
}
