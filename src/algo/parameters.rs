//! A learner's parameters, in sets that each have an optimiser of their own.

use tch::{Device, Kind, Tensor, no_grad};

use super::Error;
use crate::nn::{self, Adam, AdamConfig, Params, Path, ValueNorm, named_views};
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
pub(super) const ACTOR: Set = Set {
    name: "actor",
    gradient: "the policy's gradient",
    norm: "ppo/grad_norm_actor",
    adam: AdamConfig::MAPPO,
};
/// Of a value function that is trained by itself.
pub(super) const CRITIC: Set = Set {
    name: "critic",
    gradient: "the value's gradient",
    norm: "ppo/grad_norm_critic",
    adam: AdamConfig::MAPPO,
};

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

    /// Makes the sets share the weights of those of another copy of the same networks.
    pub(super) fn replicate(mut self, weights: &mut Weights) {
        for (other, (_, params, _)) in weights.sets.iter_mut().zip(&mut self.sets) {
            other.adam.replica(params);
        }
    }
}

/// A set and its optimiser.
struct Optimised {
    set: Set,
    params: Params,
    adam: Adam,
}

/// All sets of a learner, and the average of the policy's.
pub(super) struct Weights {
    /// The first one is the policy's.
    sets: Vec<Optimised>,
    /// Averaged weights of the first set, `[count]`.
    average: Option<Tensor>,
}

impl Weights {
    /// Those of all sets, whose networks must be complete; with an average of the policy's, if it is wanted.
    pub(super) fn new(places: Places, average: bool) -> Self {
        let optimised = |(set, mut params, _): (Set, Params, Rng)| {
            let adam = Adam::with_config(&mut params, set.adam);
            Optimised { set, params, adam }
        };
        let sets: Vec<_> = places.sets.into_iter().map(optimised).collect();
        let average = average.then(|| sets[0].adam.weights().copy());
        Self { sets, average }
    }

    /// Clips the gradient of every set to the norm `limit` and moves it at its `rate`, if it has one. Gives the norms before.
    ///
    /// # Errors
    /// [`Error::NonFinite`], with nothing moved.
    pub(super) fn step_all(
        &mut self,
        limit: f64,
        rate: impl Fn(Set) -> Option<f64>,
    ) -> Result<Vec<(&'static str, f64)>, Error> {
        let norms = self.sets.iter_mut().map(|own| own.clip(limit)).collect::<Result<_, _>>()?;
        for Optimised { set, adam, .. } in &mut self.sets {
            match rate(*set) {
                Some(rate) => adam.step(rate),
                None => adam.zero_grad(),
            }
        }
        Ok(norms)
    }

    /// As [`Weights::step_all`], of one set; the gradients of the others are dropped.
    pub(super) fn step(
        &mut self,
        set: Set,
        limit: f64,
        rate: f64,
    ) -> Result<Vec<(&'static str, f64)>, Error> {
        let mut norms = Vec::new();
        for own in &mut self.sets {
            if own.set == set {
                norms.push(own.clip(limit)?);
                own.adam.step(rate);
            } else {
                own.adam.zero_grad();
            }
        }
        Ok(norms)
    }

    /// Moves the average towards the policy's weights, of which it keeps `decay` of itself.
    pub(super) fn follow_average(&mut self, decay: f64) {
        if let Some(average) = &mut self.average {
            let _ = no_grad(|| average.lerp_(self.sets[0].adam.weights(), 1.0 - decay));
        }
    }

    /// Moves all weights towards those of other copies of the same networks, by the share `rate`.
    pub(super) fn follow(&mut self, others: &Self, rate: f64) {
        for (own, other) in self.sets.iter().zip(&others.sets) {
            let _ =
                no_grad(|| own.adam.weights().shallow_clone().lerp_(other.adam.weights(), rate));
        }
    }

    /// Exchanges the policy's weights with their average.
    pub(super) fn swap_average(&mut self) {
        if let Some(average) = &mut self.average {
            let mut weights = self.sets[0].adam.weights().shallow_clone();
            no_grad(|| {
                let training = weights.copy();
                weights.copy_(average);
                average.copy_(&training);
            });
        }
    }

    /// The values of all sets, as `<set><suffix>/<name>`.
    pub(super) fn values(&self, suffix: &str) -> Vec<(String, Tensor)> {
        self.sets
            .iter()
            .flat_map(|own| prefixed(&format!("{}{suffix}", own.set.name), own.params.named()))
            .collect()
    }

    /// Takes over what [`Weights::values`] gave.
    ///
    /// # Errors
    /// [`Error::State`].
    pub(super) fn load_values(
        &self,
        state: &[(String, Tensor)],
        suffix: &str,
    ) -> Result<(), Error> {
        for Optimised { set, params, .. } in &self.sets {
            params.copy_from(&part(state, &format!("{}{suffix}", set.name)))?;
        }
        Ok(())
    }

    /// Values, average and the optimisers' moments.
    pub(super) fn state(&self) -> Vec<(String, Tensor)> {
        let mut state = self.values("");
        if let Some(average) = &self.average {
            state.extend(prefixed("actor_average", &named_views(average, &self.sets[0].params)));
        }
        for Optimised { set, adam, .. } in &self.sets {
            state.extend(prefixed(&format!("{}_adam", set.name), &adam.state()));
        }
        state
    }

    /// Takes over what [`Weights::state`] gave.
    ///
    /// # Errors
    /// [`Error::State`].
    pub(super) fn load(&mut self, state: &[(String, Tensor)]) -> Result<(), Error> {
        self.load_values(state, "")?;
        for Optimised { set, adam, .. } in &mut self.sets {
            adam.load_state(&part(state, &format!("{}_adam", set.name)))?;
        }
        if let Some(average) = &self.average {
            nn::copy_named(
                &named_views(average, &self.sets[0].params),
                &part(state, "actor_average"),
            )?;
        }
        Ok(())
    }

    /// As [`Algorithm::load_weights`](super::Algorithm::load_weights), of weights alone.
    ///
    /// # Errors
    /// [`Error::State`].
    pub(super) fn load_weights(&mut self, state: &[(String, Tensor)]) -> Result<(), Error> {
        let averaged = part(state, "actor_average");
        // What is evaluated is what is gone on from. The noise is this run's own matter.
        let mut actor = if averaged.is_empty() { part(state, "actor") } else { averaged };
        let (policy, others) = self.sets.split_first().expect("a learner has a policy");
        for (name, tensor) in &mut actor {
            if let Some((_, own)) =
                policy.params.named().iter().find(|(own, _)| own == name && name == "head.log_std")
            {
                *tensor = own.detach().copy();
            }
        }
        policy.params.copy_from(&actor)?;
        for Optimised { set, params, .. } in others {
            params.copy_from(&part(state, set.name))?;
        }
        if let Some(average) = &mut self.average {
            no_grad(|| average.copy_(policy.adam.weights()));
        }
        Ok(())
    }

    /// Number of the policy's weights, without the parts that only training needs, and of all.
    pub(super) fn parameters(&self, training_only: &[&str]) -> (i64, i64) {
        let needed = |name: &str| !training_only.iter().any(|part| name.starts_with(part));
        let policy = self.sets[0].params.named().iter().filter(|(name, _)| needed(name));
        let deployed = policy.map(|(_, t)| t.numel() as i64).sum();
        (deployed, self.sets.iter().map(|own| own.params.count()).sum())
    }

    /// Rows of the parameter at `<set>/<name>`.
    pub(super) fn rows(&self, path: &str) -> Option<i64> {
        let named = self.values("");
        named.iter().find(|(name, _)| name == path).map(|(_, t)| t.size()[0])
    }
}

impl Optimised {
    /// Clips the gradient; gives its norm before.
    fn clip(&mut self, limit: f64) -> Result<(&'static str, f64), Error> {
        let norm = self.adam.clip_grad_norm(limit);
        if norm.is_finite() {
            Ok((self.set.norm, norm))
        } else {
            Err(Error::NonFinite { what: self.set.gradient })
        }
    }
}

/// Copies of tensors under `prefix/`, for a state.
fn prefixed(prefix: &str, tensors: &[(String, Tensor)]) -> Vec<(String, Tensor)> {
    let copy = |tensor: &Tensor| tensor.detach().to_device(Device::Cpu).copy();
    tensors.iter().map(|(name, tensor)| (format!("{prefix}/{name}"), copy(tensor))).collect()
}

/// The tensors of a state below `prefix/`.
pub(super) fn part(state: &[(String, Tensor)], prefix: &str) -> Vec<(String, Tensor)> {
    let strip = |(name, t): &(String, Tensor)| {
        Some((name.strip_prefix(prefix)?.strip_prefix('/')?.to_owned(), t.shallow_clone()))
    };
    state.iter().filter_map(strip).collect()
}

/// The value normalisation, for a state.
pub(super) fn value_norm_entry(norm: &ValueNorm) -> (String, Tensor) {
    ("value_norm/statistics".to_owned(), Tensor::from_slice(&norm.state()))
}

/// Takes over what [`value_norm_entry`] gave.
///
/// # Errors
/// [`Error::State`].
pub(super) fn load_value_norm(
    norm: &mut ValueNorm,
    state: &[(String, Tensor)],
) -> Result<(), Error> {
    let statistics = part(state, "value_norm");
    let values = statistics
        .first()
        .map(|(_, t)| Vec::<f64>::try_from(t.to_kind(Kind::Double)))
        .and_then(Result::ok);
    let values: [f64; 3] = values
        .and_then(|v| v.try_into().ok())
        .ok_or_else(|| nn::Error::Missing { name: "value_norm/statistics".to_owned() })?;
    norm.load_state(values);
    Ok(())
}
