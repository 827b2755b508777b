//! A method of your own: IPPO (de Witt et al. 2020, "Is independent learning all you need in the
//! StarCraft multi-agent challenge?"), which differs from MAPPO in its value function: each agent
//! values what it observes by itself, without the privileged state.
//!
//! The program has the whole command line of `iwol`, with this method beside the others:
//!
//! ```sh
//! cargo run --release --example own_method -- train --environment navigation --algorithm ippo --steps 100000
//! cargo run --release --example own_method -- evaluate runs/navigation/ippo/seed_0
//! ```

use std::process::ExitCode;

use iwol_sumo::algo::method::{
    ACTOR, Batch, CRITIC, Critic, Encoder, Loss, Networks, ParameterBuilder, PolicyHead,
    PolicyTerms, Ratio, Shard, ValueFunction, encode_active, encode_locally, value_loss,
};
use iwol_sumo::algo::{self, ActMode, Decision, Observation, Settings};
use iwol_sumo::env::EnvSpec;
use iwol_sumo::nn::ValueNorm;
use iwol_sumo::tch::Tensor;

/// The networks of IPPO.
pub(crate) struct Ippo {
    encoder: Encoder,
    head: PolicyHead,
    critic: LocalCritic,
}

/// V(o) of each agent's own observation.
struct LocalCritic(Critic);

impl ValueFunction for LocalCritic {
    fn memory(&self) -> i64 {
        self.0.memory()
    }

    fn value(&self, input: &Observation, _state: &Tensor) -> Option<Tensor> {
        self.0.value(&input.observation, input)
    }

    fn values(&self, batch: &Batch, length: i64, memory: &Tensor) -> (Tensor, Option<Tensor>) {
        self.0.values(&batch.observation, &batch.keep, length, memory)
    }
}

impl Networks for Ippo {
    const NAME: &'static str = "ippo";

    fn new(spec: &EnvSpec, settings: &Settings, builder: &mut ParameterBuilder) -> Self {
        let network = &settings.network;
        Self {
            encoder: Encoder::new(builder.of(ACTOR).sub("encoder"), &spec.observation, network),
            head: PolicyHead::of_actor(builder, network.hidden, spec, settings),
            critic: LocalCritic(Critic::new(builder.of(CRITIC), &spec.observation, network)),
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
        let values = self.critic.0.shard(&[&batch.observation], batch, shard);
        let value = value_loss(batch, shard, &values, norm);
        Loss::new(&policy.loss + &value, &value, [], &policy)
    }
}

fn main() -> ExitCode {
    algo::register::<Ippo>().expect("no other method is called ippo");
    iwol_sumo::cli::main()
}
