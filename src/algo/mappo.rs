//! MAPPO: shared parameters, local policy, centralised value function (Yu et al. 2022, "The
//! surprising effectiveness of PPO in cooperative multi-agent games"; marlbenchmark/on-policy,
//! `r_mappo.py`, `r_actor_critic.py`).
//!
//! - policy: embedding f `[B, H]` of the own observation `[B, O]`, Gaussian head on f
//!   (`R_Actor`)
//! - value function: its own encoder of `[B, O + S]`, V(o, s) `[B]` (`R_Critic`)
//!
//! Differences on purpose: the value reads each agent's own observation beside the privileged state
//! (reference: the concatenation of all observations), so that one network serves any number of
//! agents; the noise of actions follows a schedule (reference: a learned parameter, as with
//! `exploration.mode = "learned"`); and what is common to [all methods](super).

use super::batch::{Batch, Shard};
use super::critic::{PrivilegedCritic, ValueFunction, value_loss};
use super::decision::{ActMode, Decision, Observation};
use super::encoder::{Encoder, encode_active, encode_locally};
use super::networks::{Loss, Networks};
use super::parameters::{ACTOR, CRITIC, ParameterBuilder};
use super::policy::{PolicyHead, PolicyTerms, Ratio};
use super::settings::Settings;
use crate::env::EnvSpec;
use crate::nn::ValueNorm;

/// The networks of MAPPO (multi-agent proximal policy optimisation).
pub(super) struct Mappo {
    encoder: Encoder,
    head: PolicyHead,
    critic: PrivilegedCritic,
}

impl Networks for Mappo {
    const NAME: &'static str = "mappo";

    fn new(spec: &EnvSpec, settings: &Settings, builder: &mut ParameterBuilder) -> Self {
        let network = &settings.network;
        Self {
            encoder: Encoder::new(builder.of(ACTOR).sub("encoder"), &spec.observation, network),
            head: PolicyHead::of_actor(builder, network.hidden, spec, settings),
            critic: PrivilegedCritic::new(builder.of(CRITIC), spec, network),
        }
    }

    fn head(&self) -> &PolicyHead {
        &self.head
    }

    fn memory(&self) -> i64 {
        self.encoder.memory()
    }

    fn critic(&self) -> &dyn ValueFunction {
        &self.critic
    }

    fn act(&self, input: &Observation, mode: &ActMode) -> Decision {
        let (f, memory) = encode_locally(&self.encoder, input);
        let (action, log_prob) = self.head.sample(&f, &input.available, mode);
        Decision { action, log_prob, memory }
    }

    fn loss(&self, batch: &Batch, shard: &Shard, settings: &Settings, norm: &ValueNorm) -> Loss {
        let f =
            encode_active(&self.encoder, shard, &[&batch.observation], &batch.memory, &batch.keep);
        let policy = PolicyTerms::new(batch, shard, &self.head, &f, &settings.ppo, Ratio::Joint);
        let value = value_loss(batch, shard, &self.critic.shard(batch, shard), norm);
        Loss::new(&policy.loss + &value, &value, [], &policy)
    }
}
