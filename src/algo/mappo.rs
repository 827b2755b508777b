//! MAPPO: shared parameters, local policy, centralised value (marlbenchmark/on-policy, `r_mappo.py`, `r_actor_critic.py`).
//!
//! The value reads the agent's own observation and its view of the privileged state, own first, so that agents with
//! individual rewards get individual values from one network.

use tch::{Device, Kind, Tensor, no_grad};

use super::core::{Batch, Core, GaussianHead, Means, Minibatch, PolicyTerms, scalar, value_terms};
use super::encoder::Encoder;
use super::{ActMode, Algorithm, Decision, Error, Losses, Observation, Settings};
use crate::env::EnvSpec;
use crate::nn::{Init, Linear, Params};
use crate::rng::Seed;
use crate::rollout::Rollout;

/// Multi-agent proximal policy optimisation.
pub struct Mappo {
    encoder: Encoder,
    head: GaussianHead,
    critic: Encoder,
    value: Linear,
    core: Core,
}

impl Mappo {
    /// A learner with weights drawn from `seed`.
    pub fn new(spec: &EnvSpec, settings: &Settings, seed: Seed) -> Self {
        let (mut actor, mut critic) = (Params::new(Device::Cpu), Params::new(Device::Cpu));
        let network = &settings.network;
        let mut rng = seed.child("actor").rng();
        let mut root = actor.root(&mut rng);
        let encoder = Encoder::new(root.sub("encoder"), &spec.observation, network);
        let head = GaussianHead::new(root.sub("head"), network.hidden, spec.actions as i64, &settings.exploration);
        let mut rng = seed.child("critic").rng();
        let mut root = critic.root(&mut rng);
        let privileged = spec.observation.join(&spec.state);
        let value_encoder = Encoder::new(root.sub("encoder"), &privileged, network);
        let value = Linear::new(root.sub("value"), network.hidden, 1, Init::Orthogonal(1.0));
        Self { encoder, head, critic: value_encoder, value, core: Core::new(actor, critic, settings) }
    }

    /// Values (normalised) of all rows, `[(T + 1) · E, N]`, and the memory before each, `[(T + 1) · E, N, M]`.
    fn values(&mut self, batch: &Batch, privileged: &Tensor, steps: i64) -> (Tensor, Tensor) {
        let (rows, agents, features) = privileged.size3().expect("features are [rows, N, O + S]");
        let width = self.critic.memory();
        let envs = rows / (steps + 1);
        no_grad(|| {
            let first = self
                .core
                .critic_memory
                .take()
                .unwrap_or_else(|| Tensor::zeros([envs * agents, width], (Kind::Float, Device::Cpu)));
            let x = privileged.view([steps + 1, envs * agents, features]);
            let (f, after) = self.critic.forward(&x, &first, &batch.keep.view([steps + 1, envs * agents, 1]));
            let value = self.value.forward(&f).view([rows, agents]);
            let Some(after) = after else {
                return (value, privileged.new_zeros([rows, agents, 0], (Kind::Float, Device::Cpu)));
            };
            let before = Tensor::cat(&[&first.unsqueeze(0), &after.narrow(0, 0, steps)], 0);
            self.core.critic_memory = Some(after.get(steps - 1).copy());
            (value, before.view([rows, agents, width]))
        })
    }
}

/// Embeddings of a minibatch's active samples, `[B, H]`, by an encoder with the given memory before each row.
pub(super) fn encode_active(
    encoder: &Encoder,
    mini: &Minibatch,
    features: &Tensor,
    memory: &Tensor,
    keep: &Tensor,
) -> Tensor {
    if encoder.memory() == 0 {
        // Without memory, inactive samples need not be computed at all.
        let x = mini.active(features).unsqueeze(0);
        return encoder.forward(&x, &x.new_zeros([0], (Kind::Float, Device::Cpu)), &x).0.squeeze_dim(0);
    }
    let x = mini.take(features);
    let (rows, agents, width) = x.size3().expect("features are [rows, N, F]");
    let together = rows / mini.length * agents;
    let first = memory.index_select(0, &mini.first).reshape([together, -1]);
    let keep = mini.take(keep).view([mini.length, together, 1]);
    let (f, _) = encoder.forward(&x.view([mini.length, together, width]), &first, &keep);
    mini.pick(&f.view([rows, agents, -1]))
}

/// One decision of an encoder on local observations: embeddings `[E, N, H]` and the memory after it, `[E, N, M]`.
pub(super) fn encode_locally(encoder: &Encoder, input: &Observation) -> (Tensor, Tensor) {
    let (envs, agents, features) = input.observation.size3().expect("observations are [E, N, O]");
    let x = input.observation.view([1, envs * agents, features]);
    let keep = input.keep().reshape([1, envs * agents, 1]);
    let (f, memory) = encoder.forward(&x, &input.memory.reshape([envs * agents, -1]), &keep);
    let memory = memory.map_or_else(|| input.memory.shallow_clone(), |m| m.view([envs, agents, -1]));
    (f.view([envs, agents, -1]), memory)
}

impl Algorithm for Mappo {
    fn name(&self) -> &'static str {
        "mappo"
    }

    fn memory(&self) -> usize {
        self.encoder.memory() as usize
    }

    fn act(&self, input: &Observation, mode: &ActMode<'_>) -> Decision {
        no_grad(|| {
            let (f, memory) = encode_locally(&self.encoder, input);
            let (action, log_prob) = self.head.sample(&f, mode.action_noise());
            Decision { action, log_prob, memory }
        })
    }

    fn update(&mut self, rollout: &Rollout, progress: f64, seed: Seed) -> Result<Losses, Error> {
        let ppo = self.core.settings.ppo.clone();
        let length = if self.encoder.memory() > 0 { self.core.settings.network.chunk_length } else { 1 };
        let mut batch = Batch::new(rollout);
        let privileged = Tensor::cat(&[&batch.observation, &batch.state], -1);
        let (outputs, memory) = self.values(&batch, &privileged, rollout.sizes.steps as i64);
        batch.estimate(rollout, &outputs, &self.core.value_norm, &ppo);
        let mut means = Means::default();
        for epoch in 0..ppo.epochs {
            for mini in Minibatch::epoch(rollout, length, ppo.minibatch, seed.child("epoch").index(epoch as u64)) {
                if mini.is_empty() {
                    continue;
                }
                let f = encode_active(&self.encoder, &mini, &batch.observation, &batch.memory, &batch.keep);
                let policy = PolicyTerms::new(&batch, &mini, &self.head, &f, &ppo);
                let f = encode_active(&self.critic, &mini, &privileged, &memory, &batch.keep);
                let values = self.value.forward(&f).squeeze_dim(-1);
                let value = value_terms(&batch, &mini, &values, &mut self.core.value_norm, &ppo);
                (&policy.loss + &value).backward();
                let norms = self.core.step(progress)?;
                means.add(&[
                    ("loss/policy", scalar(&policy.policy)),
                    ("loss/value", scalar(&value)),
                    ("loss/entropy", scalar(&policy.entropy)),
                    ("ppo/approx_kl", scalar(&policy.approx_kl)),
                    ("ppo/clip_fraction", scalar(&policy.clip_fraction)),
                    ("ppo/grad_norm_actor", norms.0),
                    ("ppo/grad_norm_critic", norms.1),
                ]);
            }
        }
        self.head.schedule(&self.core.settings.exploration, progress);
        means.finish(&[
            ("ppo/explained_variance", batch.explained_variance),
            ("ppo/std", self.head.std()),
            ("ppo/learning_rate", self.core.learning_rate(progress)),
        ])
    }

    fn state(&self) -> Vec<(String, Tensor)> {
        self.core.state()
    }

    fn load(&mut self, state: &[(String, Tensor)]) -> Result<(), Error> {
        self.core.load(state)
    }

    fn parameters(&self) -> (i64, i64) {
        (self.core.actor.count(), self.core.actor.count() + self.core.critic.count())
    }
}
