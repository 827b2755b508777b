//! MAPPO: shared parameters, local policy, centralised value (marlbenchmark/on-policy, `r_mappo.py`, `r_actor_critic.py`).
//!
//! The value reads the agent's own observation and its view of the privileged state, own first, so that agents with
//! individual rewards get individual values from one network.

use tch::Tensor;

use super::batch::{Batch, Shard};
use super::core::{Loss, Networks};
use super::encoder::{Encoder, encode_active, encode_locally};
use super::head::{GaussianHead, PolicyTerms};
use super::{ActMode, Decision, Observation, Settings, ppo};
use crate::env::EnvSpec;
use crate::nn::{Init, Linear, Path, ValueNorm};

/// Multi-agent proximal policy optimisation.
pub(super) struct Mappo {
    encoder: Encoder,
    head: GaussianHead,
    critic: Encoder,
    value: Linear,
}

impl Networks for Mappo {
    const NAME: &'static str = "mappo";

    fn new(spec: &EnvSpec, settings: &Settings, mut actor: Path<'_>, mut critic: Path<'_>) -> Self {
        let network = &settings.network;
        let privileged = spec.observation.join(&spec.state);
        Self {
            encoder: Encoder::new(actor.sub("encoder"), &spec.observation, network),
            head: GaussianHead::new(actor.sub("head"), network.hidden, spec.actions as i64, &settings.exploration),
            critic: Encoder::new(critic.sub("encoder"), &privileged, network),
            value: Linear::new(critic.sub("value"), network.hidden, 1, Init::Orthogonal(1.0)),
        }
    }

    fn head(&self) -> &GaussianHead {
        &self.head
    }

    fn memory(&self) -> i64 {
        self.encoder.memory()
    }

    fn value_memory(&self) -> i64 {
        self.critic.memory()
    }

    fn act(&self, input: &Observation, mode: &ActMode<'_>) -> Decision {
        let (f, memory) = encode_locally(&self.encoder, input);
        let (action, log_prob) = self.head.sample(&f, mode);
        Decision { action, log_prob, memory }
    }

    fn value(&self, input: &Observation, state: &Tensor) -> Option<Tensor> {
        let (envs, agents, _) = state.size3().expect("states are [E, N, S]");
        let x = Tensor::cat(&[&input.observation, state], -1).view([1, envs * agents, -1]);
        let keep = input.keep().reshape([1, envs * agents, 1]);
        (self.critic.memory() == 0).then(|| {
            let (f, _) = self.critic.forward(&x, &input.memory.reshape([envs * agents, -1]).narrow(1, 0, 0), &keep);
            self.value.forward(&f).view([envs, agents])
        })
    }

    fn values(&self, batch: &Batch, length: i64, memory: &Tensor) -> (Tensor, Option<Tensor>) {
        let x = Tensor::cat(&[&batch.observation, &batch.state], -1);
        let (rows, agents, features) = x.size3().expect("features are [rows, N, O + S]");
        let together = rows / length * agents;
        let keep = batch.keep.view([length, together, 1]);
        let (f, after) = self.critic.forward(&x.view([length, together, features]), memory, &keep);
        (self.value.forward(&f).view([rows, agents]), after)
    }

    fn loss(&self, batch: &Batch, shard: &Shard, settings: &Settings, norm: &ValueNorm) -> Loss {
        let f = encode_active(&self.encoder, shard, &[&batch.observation], &batch.memory, &batch.keep);
        let policy = PolicyTerms::new(batch, shard, &self.head, &f, &settings.ppo);
        let privileged = [&batch.observation, &batch.state];
        let f = encode_active(&self.critic, shard, &privileged, &batch.value_memory, &batch.keep);
        let value = ppo::value_terms(batch, shard, &self.value.forward(&f).squeeze_dim(-1), norm, &settings.ppo);
        let mut report = vec![("loss/value", value.detach())];
        report.extend(policy.report());
        Loss { total: &policy.loss + &value, report }
    }
}
