//! What all actor-critic learners here carry: two parameter sets with their optimisers, value normalisation, the Gaussian
//! head, and the tensors of a rollout.

use tch::{Device, Kind, Tensor, no_grad};

use super::ppo;
use super::settings::{Exploration, NoiseMode, Ppo, Settings};
use super::{Error, Losses};
use crate::nn::{Adam, Init, Linear, Params, Path, ValueNorm, gaussian_entropy, gaussian_log_prob};
use crate::rng::{self, Seed};
use crate::rollout::Rollout;

/// Parameters, optimisers and value normalisation.
pub(super) struct Core {
    pub(super) actor: Params,
    pub(super) critic: Params,
    pub(super) actor_adam: Adam,
    pub(super) critic_adam: Adam,
    pub(super) value_norm: ValueNorm,
    pub(super) settings: Settings,
    /// Memory of a recurrent critic after the last rollout, `[E · N, M]`.
    pub(super) critic_memory: Option<Tensor>,
}

impl Core {
    pub(super) fn new(mut actor: Params, mut critic: Params, settings: &Settings) -> Self {
        Self {
            actor_adam: Adam::new(&mut actor),
            critic_adam: Adam::new(&mut critic),
            actor,
            critic,
            value_norm: ValueNorm::new(settings.ppo.value_norm_beta),
            settings: settings.clone(),
            critic_memory: None,
        }
    }

    pub(super) fn state(&self) -> Vec<(String, Tensor)> {
        let mut state = Vec::new();
        let mut add = |prefix: &str, tensors: &[(String, Tensor)]| {
            state.extend(tensors.iter().map(|(name, tensor)| (format!("{prefix}/{name}"), tensor.detach().copy())));
        };
        add("actor", self.actor.named());
        add("critic", self.critic.named());
        add("actor_adam", &self.actor_adam.state());
        add("critic_adam", &self.critic_adam.state());
        add("value_norm", &[("statistics".to_owned(), Tensor::from_slice(&self.value_norm.state()))]);
        if let Some(memory) = &self.critic_memory {
            add("critic_memory", &[("last".to_owned(), memory.shallow_clone())]);
        }
        state
    }

    pub(super) fn load(&mut self, state: &[(String, Tensor)]) -> Result<(), Error> {
        let part = |prefix: &str| -> Vec<(String, Tensor)> {
            let prefix = format!("{prefix}/");
            let strip =
                |(name, t): &(String, Tensor)| name.strip_prefix(&prefix).map(|n| (n.to_owned(), t.shallow_clone()));
            state.iter().filter_map(strip).collect()
        };
        self.actor.copy_from(&part("actor"))?;
        self.critic.copy_from(&part("critic"))?;
        self.actor_adam.load_state(&part("actor_adam"))?;
        self.critic_adam.load_state(&part("critic_adam"))?;
        let statistics = part("value_norm");
        let values =
            statistics.first().map(|(_, t)| Vec::<f64>::try_from(t.to_kind(Kind::Double))).and_then(Result::ok);
        let values: [f64; 3] = values
            .and_then(|v| v.try_into().ok())
            .ok_or_else(|| crate::nn::Error::Missing { name: "value_norm/statistics".to_owned() })?;
        self.value_norm.load_state(values);
        self.critic_memory = part("critic_memory").first().map(|(_, t)| t.copy());
        Ok(())
    }

    /// Learning rate at this point of the run.
    pub(super) fn learning_rate(&self, progress: f64) -> f64 {
        let Ppo { learning_rate, learning_rate_constant: constant, learning_rate_end: end, .. } = self.settings.ppo;
        let decayed = ((progress - constant) / (1.0 - constant).max(1e-9)).clamp(0.0, 1.0);
        learning_rate * (1.0 - (1.0 - end) * decayed)
    }

    /// Clips the gradient norms and moves both networks; gives the norms before clipping. A gradient that is not finite
    /// moves nothing.
    pub(super) fn step(&mut self, progress: f64) -> Result<(f64, f64), Error> {
        let (rate, limit) = (self.learning_rate(progress), self.settings.ppo.max_grad_norm);
        let norms = (self.actor_adam.clip_grad_norm(limit), self.critic_adam.clip_grad_norm(limit));
        for (what, norm) in [("the policy's gradient", norms.0), ("the value's gradient", norms.1)] {
            if !norm.is_finite() {
                return Err(Error::NonFinite { what });
            }
        }
        self.actor_adam.step(rate);
        self.critic_adam.step(rate);
        Ok(norms)
    }
}

/// Mean and standard deviation of the actions.
#[derive(Debug)]
pub(super) struct GaussianHead {
    mean: Linear,
    log_std: Tensor,
    mode: NoiseMode,
}

impl GaussianHead {
    pub(super) fn new(mut path: Path<'_>, inputs: i64, actions: i64, exploration: &Exploration) -> Self {
        let mean = Linear::new(path.sub("mean"), inputs, actions, Init::Orthogonal(0.01));
        let _ = no_grad(|| mean.bias().shallow_clone().fill_(exploration.mean_bias));
        let log_std = path.create("log_std", &[actions], Init::Zeros);
        let _ = no_grad(|| log_std.shallow_clone().fill_(exploration.log_std_start));
        Self { mean, log_std, mode: exploration.mode }
    }

    /// Imposes the scheduled noise for an update and the rollout after it.
    pub(super) fn schedule(&self, exploration: &Exploration, progress: f64) {
        if self.mode == NoiseMode::Schedule {
            let Exploration { log_std_start: start, log_std_end: end, log_std_share: share, .. } = *exploration;
            let value = start + (end - start) * (progress / share.max(1e-9)).clamp(0.0, 1.0);
            let _ = no_grad(|| self.log_std.shallow_clone().fill_(value));
        }
    }

    /// Mean `[.., A]` and logarithm of the standard deviation `[A]`.
    pub(super) fn forward(&self, x: &Tensor) -> (Tensor, Tensor) {
        let log_std =
            if self.mode == NoiseMode::Schedule { self.log_std.detach() } else { self.log_std.shallow_clone() };
        (self.mean.forward(x), log_std)
    }

    /// Action `[.., A]` and its log-probability `[..]`.
    pub(super) fn sample(&self, x: &Tensor, noise: Option<&Tensor>) -> (Tensor, Tensor) {
        let (mean, log_std) = self.forward(x);
        let action = match noise {
            Some(noise) => &mean + log_std.exp() * noise,
            None => mean.shallow_clone(),
        };
        let log_prob = gaussian_log_prob(&mean, &log_std, &action);
        (action, log_prob)
    }

    /// Current standard deviation, averaged over action dimensions.
    pub(super) fn std(&self) -> f64 {
        self.log_std.exp().mean(Kind::Float).double_value(&[])
    }
}

/// A rollout as tensors; the first dimension is the row `t · E + e`.
pub(super) struct Batch {
    /// `[(T + 1) · E, N, O]`
    pub(super) observation: Tensor,
    /// `[(T + 1) · E, N, S]`
    pub(super) state: Tensor,
    /// `[(T + 1) · E, N, N]`
    pub(super) comm: Tensor,
    /// `[T · E, N]`
    pub(super) active: Tensor,
    /// 1 − start, `[(T + 1) · E, N]`
    pub(super) keep: Tensor,
    /// `[(T + 1) · E, N, M]`
    pub(super) memory: Tensor,
    /// `[T · E, N, A]`
    pub(super) action: Tensor,
    /// `[T · E, N]`
    pub(super) log_prob: Tensor,
    /// Normalised, `[T · E, N]`.
    pub(super) advantage: Tensor,
    /// In units of the reward, `[T · E, N]`.
    pub(super) returns: Tensor,
    /// The network's outputs before the update, `[T · E, N]`.
    pub(super) value: Tensor,
    /// Share of the returns' variance that the values explained.
    pub(super) explained_variance: f64,
}

impl Batch {
    pub(super) fn new(rollout: &Rollout) -> Self {
        let s = rollout.sizes;
        let (rows, closed, n) = ((s.steps * s.envs) as i64, ((s.steps + 1) * s.envs) as i64, s.agents as i64);
        let tensor = |data: &[f32], shape: &[i64]| Tensor::from_slice(data).view(shape);
        let start = Tensor::from_slice(&rollout.start).view([closed, 1]);
        let keep = (start.ones_like() - start).expand([closed, n], false).contiguous();
        let empty = || Tensor::zeros([rows, n], (Kind::Float, Device::Cpu));
        Self {
            observation: tensor(&rollout.observation, &[closed, n, s.observation as i64]),
            state: tensor(&rollout.state, &[closed, n, s.state as i64]),
            comm: tensor(&rollout.comm, &[closed, n, n]),
            active: tensor(&rollout.active[..s.steps * s.envs * s.agents], &[rows, n]),
            keep,
            memory: tensor(&rollout.memory, &[closed, n, s.memory as i64]),
            action: tensor(&rollout.action, &[rows, n, s.actions as i64]),
            log_prob: tensor(&rollout.log_prob, &[rows, n]),
            advantage: empty(),
            returns: empty(),
            value: empty(),
            explained_variance: 0.0,
        }
    }

    /// Takes the critic's outputs for all rows, `[(T + 1) · E, N]` normalised, and fills advantages and returns.
    pub(super) fn estimate(&mut self, rollout: &Rollout, outputs: &Tensor, norm: &ValueNorm, ppo: &Ppo) {
        let values = Vec::<f32>::try_from(norm.denormalize(outputs).reshape([-1])).expect("values are floats");
        let (mut advantage, returns) = rollout.advantages(&values, ppo.gamma, ppo.gae_lambda);
        let count = advantage.len();
        self.explained_variance = ppo::explained_variance(&values[..count], &returns, &rollout.active[..count]);
        ppo::normalize_advantages(&mut advantage, &rollout.active[..count]);
        let shape = self.active.size();
        self.advantage = Tensor::from_slice(&advantage).view(&shape[..]);
        self.returns = Tensor::from_slice(&returns).view(&shape[..]);
        self.value = outputs.narrow(0, 0, shape[0]).copy();
    }
}

/// Part of a rollout for one gradient step.
pub(super) struct Minibatch {
    /// Sequence length L and number of sequences C: rows come as `[L, C]`.
    pub(super) length: i64,
    /// Rows `t · E + e`, step-major, `[L · C]`.
    pub(super) rows: Tensor,
    /// Rows of the first steps, `[C]`.
    pub(super) first: Tensor,
    /// Active samples among the `L · C · N`.
    pub(super) samples: Tensor,
}

impl Minibatch {
    /// Shuffled minibatches of one epoch that hold about `size` samples each.
    pub(super) fn epoch(rollout: &Rollout, length: usize, size: usize, seed: Seed) -> Vec<Self> {
        let agents = rollout.sizes.agents;
        let mut chunks = rollout.chunks(length);
        rng::shuffle(&mut seed.rng(), &mut chunks);
        let count =
            (rollout.sizes.steps * rollout.sizes.envs * agents).div_ceil(size.max(1)).clamp(1, chunks.len().max(1));
        let per_batch = chunks.len().div_ceil(count).max(1);
        chunks
            .chunks(per_batch)
            .map(|chunks| {
                let rows = rollout.rows(chunks, length);
                let samples: Vec<i64> = (0..rows.len() * agents)
                    .filter(|&i| rollout.active[rows[i / agents] as usize * agents + i % agents] > 0.0)
                    .map(|i| i as i64)
                    .collect();
                Self {
                    length: length as i64,
                    first: Tensor::from_slice(&rows[..chunks.len()]),
                    rows: Tensor::from_slice(&rows),
                    samples: Tensor::from_slice(&samples),
                }
            })
            .collect()
    }

    /// Whether there is nothing to learn from.
    pub(super) fn is_empty(&self) -> bool {
        self.samples.numel() == 0
    }

    /// The rows of a tensor, `[L · C, …]`.
    pub(super) fn take(&self, tensor: &Tensor) -> Tensor {
        tensor.index_select(0, &self.rows)
    }

    /// The active samples of a tensor with one entry per agent, `[rows, N, …]` to `[B, …]`.
    pub(super) fn active(&self, tensor: &Tensor) -> Tensor {
        self.pick(&self.take(tensor))
    }

    /// The active samples of a tensor that holds this minibatch's rows only, `[L · C, N, …]` to `[B, …]`.
    pub(super) fn pick(&self, tensor: &Tensor) -> Tensor {
        tensor.flatten(0, 1).index_select(0, &self.samples)
    }
}

/// Standard logistic noise for the graphs of all rows, `[(T + 1) · E, N, N]`.
pub(super) fn graph_noise(rollout: &Rollout, seed: Seed) -> Tensor {
    let s = rollout.sizes;
    let mut noise = vec![0.0; (s.steps + 1) * s.envs * s.agents * s.agents];
    rng::fill_logistic(&mut seed.rng(), &mut noise);
    Tensor::from_slice(&noise).view([((s.steps + 1) * s.envs) as i64, s.agents as i64, s.agents as i64])
}

/// Running means of diagnostics over the gradient steps of an update.
#[derive(Default)]
pub(super) struct Means {
    sums: Losses,
    count: f64,
}

impl Means {
    pub(super) fn add(&mut self, values: &[(&'static str, f64)]) {
        if self.sums.is_empty() {
            self.sums = values.iter().map(|(name, _)| (*name, 0.0)).collect();
        }
        for (sum, value) in self.sums.iter_mut().zip(values) {
            sum.1 += value.1;
        }
        self.count += 1.0;
    }

    /// The means; an error when one is not finite.
    pub(super) fn finish(self, extra: &[(&'static str, f64)]) -> Result<Losses, Error> {
        let mut losses: Losses = self.sums.into_iter().map(|(name, sum)| (name, sum / self.count.max(1.0))).collect();
        losses.extend_from_slice(extra);
        match losses.iter().find(|(_, value)| !value.is_finite()) {
            Some((what, _)) => Err(Error::NonFinite { what }),
            None => Ok(losses),
        }
    }
}

/// Loss and diagnostics of the policy on the active samples of a minibatch.
pub(super) struct PolicyTerms {
    pub(super) loss: Tensor,
    pub(super) policy: Tensor,
    pub(super) entropy: Tensor,
    pub(super) approx_kl: Tensor,
    pub(super) clip_fraction: Tensor,
}

impl PolicyTerms {
    pub(super) fn new(batch: &Batch, mini: &Minibatch, head: &GaussianHead, input: &Tensor, ppo: &Ppo) -> Self {
        let (mean, log_std) = head.forward(input);
        let log_prob = gaussian_log_prob(&mean, &log_std, &mini.active(&batch.action));
        let old = mini.active(&batch.log_prob);
        let advantage = mini.active(&batch.advantage);
        let policy = ppo::policy_loss(&log_prob, &old, &advantage, &log_prob.ones_like().detach(), ppo.clip);
        let entropy = gaussian_entropy(&log_std);
        let (approx_kl, clip_fraction) = no_grad(|| {
            let difference = &log_prob - &old;
            let ratio = difference.exp();
            let outside = (&ratio - 1.0).abs().gt(ppo.clip).to_kind(Kind::Float).mean(Kind::Float);
            ((ratio - 1.0 - difference).mean(Kind::Float), outside)
        });
        Self { loss: &policy - ppo.entropy * &entropy, policy, entropy, approx_kl, clip_fraction }
    }
}

/// Value loss of a minibatch from the critic's outputs for its active samples; updates the normalisation first, as the
/// reference does in every evaluation of the loss.
pub(super) fn value_terms(batch: &Batch, mini: &Minibatch, values: &Tensor, norm: &mut ValueNorm, ppo: &Ppo) -> Tensor {
    let returns = mini.active(&batch.returns);
    norm.update(&returns);
    let target = norm.normalize(&returns);
    ppo::value_loss(values, &mini.active(&batch.value), &target, &target.ones_like(), ppo.clip, ppo.huber_delta)
}

/// The scalar of a tensor.
pub(super) fn scalar(tensor: &Tensor) -> f64 {
    tensor.double_value(&[])
}
