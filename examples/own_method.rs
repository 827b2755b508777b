//! A method of your own: IPPO (de Witt et al. 2020, "Is independent learning all you need in the
//! StarCraft multi-agent challenge?"), which differs from MAPPO in its value function: each agent
//! values what it observes by itself, without the privileged state.
//!
//! `cargo run --release --example own_method -- ippo 100000` trains it for 100,000 steps to navigate
//! in the Robotarium; with `mappo`, or the name of another method, in its place, that one.

use std::sync::atomic::AtomicBool;

use iwol_sumo::algo::method::{
    ACTOR, Batch, CRITIC, Critic, Encoder, Loss, Networks, ParameterBuilder, PolicyHead,
    PolicyTerms, Ratio, Shard, ValueFunction, encode_active, encode_locally, value_loss,
};
use iwol_sumo::algo::{self, ActMode, Decision, Observation, Settings};
use iwol_sumo::config::Layers;
use iwol_sumo::env::{BuiltIn, EnvSpec};
use iwol_sumo::nn::ValueNorm;
use iwol_sumo::train::{RunDir, Trainer};
use tch::Tensor;
use toml::Value;

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

    fn act(&self, input: &Observation, mode: &ActMode<'_>) -> Decision {
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

fn main() -> Result<(), Box<dyn std::error::Error>> {
    algo::register::<Ippo>()?;
    let mut args = std::env::args().skip(1);
    let method = args.next().unwrap_or_else(|| "ippo".to_owned());
    let steps = args.next().map_or(Ok(100_000), |steps| steps.parse())?;
    let environment = BuiltIn::named("navigation").ok_or("no such environment")?.environment();
    let flags = vec![("algorithm", Value::String(method)), ("steps", Value::Integer(steps))];
    let layers = Layers { flags, sets: args.collect(), ..Layers::default() };
    let config = layers.without_scenario(environment.spec())?;
    let folder = tempfile::tempdir()?;
    let mut trainer = Trainer::new(config, environment)?;
    trainer.run(&RunDir::new(folder.path()), &AtomicBool::new(false), &mut |report| {
        println!("{:>7} steps  success {:?}", report.step, report.training_success);
    })?;
    let found = trainer.validate(&AtomicBool::new(false))?.metrics().ok_or("no episode")?;
    println!("robots that end near the goal: {:.1} %", 100.0 * found.success.mean);
    Ok(())
}
