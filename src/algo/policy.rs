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
                let fresh = &log_std + shard.active(&batch.log_fresh);
                Self {
                    log_prob: gaussian_log_prob(&expected, &fresh, &action),
                    entropy: gaussian_entropy(&fresh),
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

#[cfg(test)]
mod tests {
    use tch::Device;

    use super::*;
    use crate::algo::batch::minibatches;
    use crate::algo::settings::{Exploration, NoiseMode};
    use crate::env::ActionDimension;
    use crate::nn::Params;
    use crate::rng::{self, Seed};
    use crate::rollout::{Rollout, Sizes};

    const STEPS: usize = 4;
    const ENVS: usize = 20_000;
    const KEPT: f32 = 0.95;

    /// Returns a rollout of one agent per world with noise that lasts, and a head whose mean is a
    /// parameter of its own at each step, and its parameters: what it reads is the number of the
    /// step, one-hot.
    fn played(mode: NoiseMode) -> (Rollout, PolicyHead, Params) {
        let (mut params, mut weights) = (Params::new(Device::Cpu), Seed::new(0).rng());
        let exploration = Exploration { mode, log_std_start: 0.0, ..Exploration::default() };
        let dimension = ActionDimension::named("x");
        let head =
            GaussianHead::new(params.root(&mut weights), STEPS as i64, &[dimension], &exploration);
        let mut rollout = Rollout::new(Sizes {
            steps: STEPS,
            envs: ENVS,
            agents: 1,
            observation: STEPS,
            state: 0,
            actions: 1,
            choices: 0,
            memory: 0,
            graph_noise: 0,
        });
        rollout.active.fill(1.0);
        rollout.log_fresh = vec![0.5 * (1.0 - KEPT * KEPT).ln(); STEPS];
        rollout.log_fresh[0] = 0.0;
        rollout.carried = vec![0.0; STEPS * ENVS];
        let mut drawn = vec![0.0; STEPS * ENVS];
        rng::fill_normal(&mut Seed::new(1).rng(), &mut drawn);
        for row in 0..(STEPS + 1) * ENVS {
            rollout.observation[row * STEPS + (row / ENVS) % STEPS] = 1.0;
        }
        // The standard deviation is 1. The means are close to 0, and are taken as 0 here.
        for (row, drawn) in drawn.into_iter().enumerate() {
            let log_fresh = rollout.log_fresh[row / ENVS];
            let carried = if row >= ENVS { KEPT * rollout.action[row - ENVS] } else { 0.0 };
            rollout.carried[row] = carried;
            rollout.action[row] = carried + log_fresh.exp() * drawn;
            let half_ln_tau = 0.5 * std::f32::consts::TAU.ln();
            rollout.log_prob[row] = -0.5 * drawn * drawn - log_fresh - half_ln_tau;
        }
        (rollout, PolicyHead::Gaussian(head), params)
    }

    /// Returns the parameters whose name ends so.
    fn named(params: &Params, end: &str) -> Tensor {
        let named = params.named();
        named.iter().find(|(name, _)| name.ends_with(end)).expect("is one").1.shallow_clone()
    }

    /// Returns the whole loss and the policy's part of it for a whole rollout, whose advantage is the
    /// last action to the power of `power`.
    fn losses(rollout: &Rollout, head: &PolicyHead, ppo: &Ppo, power: i64) -> [Tensor; 2] {
        let mut batch = Batch::new(rollout, Device::Cpu);
        let last = batch.action.narrow(0, ((STEPS - 1) * ENVS) as i64, ENVS as i64);
        let last = last.pow_tensor_scalar(power);
        batch.advantage = last.squeeze_dim(-1).repeat([STEPS as i64, 1]);
        let all = STEPS * ENVS;
        let minibatches = minibatches(rollout, 1, all, 1, Device::Cpu, Seed::new(2));
        assert!(minibatches.len() == 1);
        let mut sums = [Tensor::from(0.0_f32), Tensor::from(0.0_f32)];
        for shard in minibatches.iter().flatten().flatten() {
            let input = shard.active(&batch.observation);
            let terms = PolicyTerms::new(&batch, shard, head, &input, ppo, Ratio::Joint);
            let [all, policy] = &sums;
            sums = [all + terms.loss * shard.weight, policy + terms.policy * shard.weight];
        }
        sums
    }

    /// An earlier mean is credited with a later action by the correlation to the power of the steps
    /// between them, since a deviation from it would last.
    #[test]
    fn the_gradient_under_lasting_noise_is_that_of_deviations_that_last() {
        let (rollout, head, params) = played(NoiseMode::Schedule);
        let ppo = Ppo { entropy_coefficient: 0.0, bounds: 0.0, ..Ppo::default() };
        let [loss, _] = losses(&rollout, &head, &ppo, 1);
        let means = named(&params, "mean.weight");
        let gradient = Tensor::run_backward(&[loss], &[&means], false, false);
        // The loss is a mean over all steps, and the last action's mean raises the return by 1.
        let found = Vec::<f32>::try_from((&gradient[0] * -(STEPS as f64)).view([-1]));
        for (t, found) in found.expect("numbers").iter().enumerate() {
            let wanted = KEPT.powi((STEPS - 1 - t) as i32);
            // At least five standard errors.
            assert!((found - wanted).abs() < 0.12, "{t}: {found} {wanted}");
        }
    }

    /// A standard deviation that is learned is credited with what is drawn with it, and not with the
    /// earlier noise: the last action is normal with this deviation, so its square rises by 2 with
    /// its logarithm.
    #[test]
    fn learned_noise_is_credited_with_its_own_draws() {
        let (rollout, head, params) = played(NoiseMode::Learned);
        let ppo = Ppo { entropy_coefficient: 0.0, bounds: 0.0, ..Ppo::default() };
        let [loss, _] = losses(&rollout, &head, &ppo, 2);
        let log_std = named(&params, "log_std");
        let gradient = Tensor::run_backward(&[loss], &[&log_std], false, false);
        let found = -(STEPS as f64) * gradient[0].double_value(&[0]);
        assert!((found - 2.0).abs() < 0.3, "{found}");
    }

    /// The penalty on means out of bounds has its unit from the whole noise, however much of it is
    /// that of the step before.
    #[test]
    fn noise_that_lasts_changes_no_penalty_on_means() {
        let (mut rollout, head, params) = played(NoiseMode::Schedule);
        let _ = no_grad(|| named(&params, "mean.weight").fill_(2.0));
        let ppo = Ppo { entropy_coefficient: 0.0, bounds: 1.0, ..Ppo::default() };
        let penalty = |rollout: &Rollout| {
            let [loss, policy] = losses(rollout, &head, &ppo, 1);
            (loss - policy).double_value(&[])
        };
        let lasting = penalty(&rollout);
        rollout.carried.clear();
        rollout.log_fresh.clear();
        let independent = penalty(&rollout);
        assert!((independent - 0.5).abs() < 1e-5, "half the squared excess: {independent}");
        assert!((lasting - independent).abs() < 1e-5, "{lasting} {independent}");
    }
}
