//! A learner's parameters, in sets that each have an optimiser of their own.

use tch::Device;

use crate::nn::{Adam, AdamConfig, Params, Path};
use crate::rng::{Rng, Seed};

/// What a set of parameters is called.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Set {
    /// In checkpoints; its optimiser's state stands below `<name>_adam`.
    pub(super) name: &'static str,
    /// Its gradient, in messages.
    pub(super) gradient: &'static str,
    /// The norm of its gradient, in reports.
    pub(super) norm: &'static str,
    /// Adam's coefficients.
    pub(super) adam: AdamConfig,
}

/// Of the policy, and of all that is trained together with it.
pub(super) const ACTOR: Set =
    Set { name: "actor", gradient: "the policy's gradient", norm: "ppo/grad_norm_actor", adam: AdamConfig::MAPPO };
/// Of a value function that is trained by itself.
pub(super) const CRITIC: Set =
    Set { name: "critic", gradient: "the value's gradient", norm: "ppo/grad_norm_critic", adam: AdamConfig::MAPPO };

/// Where networks create their parameters. A set begins to exist when it is first asked for; the first one must be
/// [`ACTOR`].
pub(super) struct Places {
    device: Device,
    seed: Seed,
    sets: Vec<(Set, Params, Rng)>,
}

impl Places {
    /// No set yet. The values of each are drawn from a stream of its own, below `seed`.
    pub(super) fn new(seed: Seed, device: Device) -> Self {
        Self { device, seed, sets: Vec::new() }
    }

    /// The root of a set.
    pub(super) fn of(&mut self, set: Set) -> Path<'_> {
        let at = self.sets.iter().position(|(own, ..)| *own == set).unwrap_or_else(|| {
            self.sets.push((set, Params::new(self.device), self.seed.child(set.name).rng()));
            self.sets.len() - 1
        });
        let (_, params, rng) = &mut self.sets[at];
        params.root(rng)
    }

    /// The sets, each with an optimiser.
    pub(super) fn optimised(self) -> Vec<Optimised> {
        let optimised =
            |(set, mut params, _)| Optimised { set, adam: Adam::with_config(&mut params, set.adam), params };
        self.sets.into_iter().map(optimised).collect()
    }

    /// Makes the sets share the weights of those of another copy of the same networks.
    pub(super) fn replicate(mut self, others: &mut [Optimised]) {
        for (other, (_, params, _)) in others.iter_mut().zip(&mut self.sets) {
            other.adam.replica(params);
        }
    }
}

/// A set and its optimiser.
pub(super) struct Optimised {
    pub(super) set: Set,
    pub(super) params: Params,
    pub(super) adam: Adam,
}
