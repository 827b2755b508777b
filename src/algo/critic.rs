//! Value functions that read an agent's own observation and, for most methods, the privileged
//! state.

use tch::Tensor;

use super::batch::{Batch, Shard};
use super::decision::Observation;
use super::encoder::{Encoder, encode_active, encode_rows};
use super::ppo;
use super::settings::Network;
use crate::env::{EnvSpec, Features};
use crate::nn::{Init, Linear, Path, ValueNorm};

/// The value function of a method.
pub trait ValueFunction {
    /// Returns the width of its memory per agent; 0 where it has none of its own.
    fn memory(&self) -> i64;

    /// Returns how many numbers per agent the noise of its communication graph has, among N agents,
    /// as [`Networks::graph_noise`](super::networks::Networks::graph_noise) does for the policy's.
    fn graph_noise(&self, _agents: i64) -> i64 {
        0
    }

    /// Returns the values (normalised) at one decision, `[E, N]`; `None` where the value function
    /// has a memory, because that memory is not kept outside training.
    fn value(&self, input: &Observation, state: &Tensor) -> Option<Tensor>;

    /// Returns the values (normalised) of all rows of C sequences of `length` steps, `[rows, N]`,
    /// and the memory after each step, `[length, C · N, M]`, if there is one. `memory` is the
    /// memory before the first step, `[C · N, M]`.
    fn values(&self, batch: &Batch, length: i64, memory: &Tensor) -> (Tensor, Option<Tensor>);
}

/// A value function of given features: an encoder and a linear layer.
#[derive(Debug)]
pub struct Critic {
    encoder: Encoder,
    value: Linear,
}

impl Critic {
    /// Creates a value function of these features.
    pub fn new(mut path: Path<'_>, features: &Features, network: &Network) -> Self {
        Self {
            encoder: Encoder::new(path.sub("encoder"), features, network),
            value: Linear::new(path.sub("value"), network.hidden, 1, Init::Orthogonal(1.0)),
        }
    }

    /// Returns the width of the memory per agent.
    pub fn memory(&self) -> i64 {
        self.encoder.memory()
    }

    /// Returns the values (normalised) of `features: [E, N, ..]` at one decision, `[E, N]`; `None`
    /// where the critic has a memory, because that memory is not kept outside training.
    pub fn value(&self, features: &Tensor, input: &Observation) -> Option<Tensor> {
        let nothing = input.memory.narrow(2, 0, 0);
        (self.encoder.memory() == 0).then(|| self.values(features, &input.keep(), 1, &nothing).0)
    }

    /// Returns the values (normalised) of sequences of `length` steps, `features: [rows, N, ..]` to
    /// `[rows, N]`, and the memory after each step.
    pub fn values(
        &self,
        features: &Tensor,
        keep: &Tensor,
        length: i64,
        memory: &Tensor,
    ) -> (Tensor, Option<Tensor>) {
        let (f, after) = encode_rows(&self.encoder, features, memory, keep, length);
        (self.value.forward(&f).squeeze_dim(-1), after)
    }

    /// Returns the values (normalised) of a shard's active samples, `[B]`, from features of all rows
    /// side by side, `[rows, N, ..]` each.
    pub fn shard(&self, features: &[&Tensor], batch: &Batch, shard: &Shard) -> Tensor {
        let f = encode_active(&self.encoder, shard, features, &batch.value_memory, &batch.keep);
        self.value.forward(&f).squeeze_dim(-1)
    }
}

/// V(o, s) of each agent's own observation and its own view of the privileged state. Both views
/// begin with the agent itself, so that one network gives agents with individual rewards individual
/// values.
#[derive(Debug)]
pub struct PrivilegedCritic(Critic);

impl PrivilegedCritic {
    /// Creates the value function.
    pub fn new(path: Path<'_>, spec: &EnvSpec, network: &Network) -> Self {
        Self(Critic::new(path, &spec.observation.join(&spec.state), network))
    }

    /// Returns the values (normalised) of a shard's active samples, `[B]`.
    pub fn shard(&self, batch: &Batch, shard: &Shard) -> Tensor {
        self.0.shard(&[&batch.observation, &batch.state], batch, shard)
    }
}

impl ValueFunction for PrivilegedCritic {
    fn memory(&self) -> i64 {
        self.0.memory()
    }

    fn value(&self, input: &Observation, state: &Tensor) -> Option<Tensor> {
        self.0.value(&Tensor::cat(&[&input.observation, state], -1), input)
    }

    fn values(&self, batch: &Batch, length: i64, memory: &Tensor) -> (Tensor, Option<Tensor>) {
        let privileged = Tensor::cat(&[&batch.observation, &batch.state], -1);
        self.0.values(&privileged, &batch.keep, length, memory)
    }
}

/// Returns the value loss of a shard from the critic's outputs for its active samples.
pub fn value_loss(batch: &Batch, shard: &Shard, values: &Tensor, norm: &ValueNorm) -> Tensor {
    let target = norm.normalize(&shard.active(&batch.returns));
    ppo::value_loss(values, &shard.active(&batch.value), &target, &target.ones_like())
}
