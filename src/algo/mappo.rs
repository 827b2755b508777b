//! MAPPO: shared parameters, local policy, centralised value function (marlbenchmark/on-policy,
//! `r_mappo.py`, `r_actor_critic.py`).

use tch::Tensor;

use super::batch::{Batch, Shard};
use super::core::{Loss, Networks};
use super::critic::PrivilegedCritic;
use super::encoder::{Encoder, encode_active, encode_locally};
use super::head::{GaussianHead, PolicyTerms, Ratio};
use super::parameters::{ACTOR, CRITIC, ParameterBuilder};
use super::{ActMode, Decision, Observation, Settings, ppo};
use crate::env::EnvSpec;
use crate::nn::ValueNorm;

/// The networks of MAPPO (multi-agent proximal policy optimisation).
pub(super) struct Mappo {
    encoder: Encoder,
    head: GaussianHead,
    critic: PrivilegedCritic,
}

impl Networks for Mappo {
    const NAME: &'static str = "mappo";

    fn new(spec: &EnvSpec, settings: &Settings, builder: &mut ParameterBuilder) -> Self {
        let network = &settings.network;
        Self {
            encoder: Encoder::new(builder.of(ACTOR).sub("encoder"), &spec.observation, network),
            head: GaussianHead::new(
                builder.of(ACTOR).sub("head"),
                network.hidden,
                &spec.actions,
                &settings.exploration,
            ),
            critic: PrivilegedCritic::new(builder.of(CRITIC), spec, network),
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
        self.critic.value(input, state)
    }

    fn values(&self, batch: &Batch, length: i64, memory: &Tensor) -> (Tensor, Option<Tensor>) {
        self.critic.values(batch, length, memory)
    }

    fn loss(&self, batch: &Batch, shard: &Shard, settings: &Settings, norm: &ValueNorm) -> Loss {
        let f =
            encode_active(&self.encoder, shard, &[&batch.observation], &batch.memory, &batch.keep);
        let policy = PolicyTerms::new(batch, shard, &self.head, &f, &settings.ppo, Ratio::Joint);
        let value =
            ppo::value_terms(batch, shard, &self.critic.shard(batch, shard), norm, &settings.ppo);
        let mut report = vec![("loss/value", value.detach())];
        report.extend(policy.report());
        Loss { total: &policy.loss + &value, report }
    }
}
