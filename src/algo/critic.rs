//! The centralised value function: what a method's value reads when it is told the privileged state.

use tch::Tensor;

use super::Observation;
use super::batch::{Batch, Shard};
use super::encoder::{Encoder, encode_active, encode_rows};
use super::settings::Network;
use crate::env::EnvSpec;
use crate::nn::{Init, Linear, Path};

/// V(o, s) of each agent's own observation and its own view of the privileged state, own first, so that agents with individual
/// rewards get individual values from one network.
#[derive(Debug)]
pub(super) struct PrivilegedCritic {
    encoder: Encoder,
    value: Linear,
}

impl PrivilegedCritic {
    pub(super) fn new(mut path: Path<'_>, spec: &EnvSpec, network: &Network) -> Self {
        Self {
            encoder: Encoder::new(path.sub("encoder"), &spec.observation.join(&spec.state), network),
            value: Linear::new(path.sub("value"), network.hidden, 1, Init::Orthogonal(1.0)),
        }
    }

    /// Memory per agent.
    pub(super) fn memory(&self) -> i64 {
        self.encoder.memory()
    }

    /// Values (normalised) at one decision, `[E, N]`; only without memory, as that of the value is not kept outside training.
    pub(super) fn value(&self, input: &Observation, state: &Tensor) -> Option<Tensor> {
        let value = || {
            let x = Tensor::cat(&[&input.observation, state], -1);
            let memory = input.memory.narrow(2, 0, 0);
            self.value.forward(&encode_rows(&self.encoder, &x, &memory, &input.keep(), 1).0).squeeze_dim(-1)
        };
        (self.encoder.memory() == 0).then(value)
    }

    /// Values (normalised) of sequences of `length` steps, `[rows, N]`, and the memory after each step.
    pub(super) fn values(&self, batch: &Batch, length: i64, memory: &Tensor) -> (Tensor, Option<Tensor>) {
        let x = Tensor::cat(&[&batch.observation, &batch.state], -1);
        let (f, after) = encode_rows(&self.encoder, &x, memory, &batch.keep, length);
        (self.value.forward(&f).squeeze_dim(-1), after)
    }

    /// Values (normalised) of a shard's active samples, `[B]`.
    pub(super) fn shard(&self, batch: &Batch, shard: &Shard) -> Tensor {
        let privileged = [&batch.observation, &batch.state];
        let f = encode_active(&self.encoder, shard, &privileged, &batch.value_memory, &batch.keep);
        self.value.forward(&f).squeeze_dim(-1)
    }
}
