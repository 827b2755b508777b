//! The parameters of a learner, in groups that each have their own optimiser.

use tch::{Device, Kind, Tensor, no_grad};

use super::Error;
use crate::nn::{self, Adam, AdamConfig, Params, Path, ValueNorm, named_views};
use crate::ranks::{self, Ranks};
use crate::rng::{Rng, Seed};

/// The names of a parameter group, and the coefficients of its optimiser.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ParameterGroup {
    /// Name in checkpoints; the state of the group's optimiser is stored under `<name>_adam`.
    pub name: &'static str,
    /// Name of the group's gradient in messages.
    pub gradient: &'static str,
    /// Name of the gradient norm in reports.
    pub norm: &'static str,
    /// Adam's coefficients.
    pub adam: AdamConfig,
}

/// The group of the policy and of everything that is trained together with it.
pub const ACTOR: ParameterGroup = ParameterGroup {
    name: "actor",
    gradient: "the policy's gradient",
    norm: "ppo/grad_norm_actor",
    adam: AdamConfig::MAPPO,
};
/// The group of a value function that is trained separately.
pub const CRITIC: ParameterGroup = ParameterGroup {
    name: "critic",
    gradient: "the value's gradient",
    norm: "ppo/grad_norm_critic",
    adam: AdamConfig::MAPPO,
};

/// A builder of parameters, which networks use to create theirs. A group is created at its first
/// request; the first one must be [`ACTOR`].
pub struct ParameterBuilder {
    device: Device,
    seed: Seed,
    sets: Vec<(ParameterGroup, Params, Rng)>,
}

impl ParameterBuilder {
    /// Creates a builder without groups. The initial values of each group are drawn from a stream
    /// of its own, derived from `seed`.
    pub(super) fn new(seed: Seed, device: Device) -> Self {
        Self { device, seed, sets: Vec::new() }
    }

    /// Returns the device of the parameters.
    pub fn device(&self) -> Device {
        self.device
    }

    /// Returns the root path of a group.
    pub fn of(&mut self, set: ParameterGroup) -> Path<'_> {
        let at = self.sets.iter().position(|(own, ..)| *own == set).unwrap_or_else(|| {
            self.sets.push((set, Params::new(self.device), self.seed.child(set.name).rng()));
            self.sets.len() - 1
        });
        let (_, params, rng) = &mut self.sets[at];
        params.root(rng)
    }

    /// Makes the groups share the weights of another copy of the same networks.
    pub(super) fn replicate(mut self, weights: &mut Weights) {
        for (other, (_, params, _)) in weights.sets.iter_mut().zip(&mut self.sets) {
            other.adam.replica(params);
        }
    }
}

/// A parameter group and its optimiser.
struct Optimised {
    set: ParameterGroup,
    params: Params,
    adam: Adam,
}

/// All parameter groups of a learner, and the average of the policy's weights.
pub(super) struct Weights {
    /// The groups; the first one is the policy's.
    sets: Vec<Optimised>,
    /// Averaged weights of the first group, `[count]`.
    average: Option<Tensor>,
}

impl Weights {
    /// Takes over all groups, whose networks must be complete. Keeps an average of the policy's
    /// weights if `average` is true.
    pub(super) fn new(builder: ParameterBuilder, average: bool) -> Self {
        let optimised = |(set, mut params, _): (ParameterGroup, Params, Rng)| {
            let adam = Adam::with_config(&mut params, set.adam);
            Optimised { set, params, adam }
        };
        let sets: Vec<_> = builder.sets.into_iter().map(optimised).collect();
        let average = average.then(|| sets[0].adam.weights().copy());
        Self { sets, average }
    }

    /// Replaces the gradient of every group by the sum of those of all ranks' shards.
    pub(super) fn gather_from(&mut self, ranks: &dyn Ranks) {
        for own in &mut self.sets {
            own.adam.gather_from(|gradients| ranks::gather_numbers(ranks, gradients));
        }
    }

    /// Clips the gradient of every group to the norm `limit`, and steps every group that has a
    /// learning rate by `rate`. Returns the norms before clipping.
    ///
    /// # Errors
    /// [`Error::NonFinite`] when a gradient is not finite; then no weight has changed.
    pub(super) fn step_all(
        &mut self,
        limit: f64,
        rate: impl Fn(ParameterGroup) -> Option<f64>,
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

    /// Steps one group, as [`Weights::step_all`] does, and drops the gradients of the others.
    pub(super) fn step(
        &mut self,
        set: ParameterGroup,
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

    /// Moves the average towards the policy's weights; the old average keeps the weight `decay`.
    pub(super) fn follow_average(&mut self, decay: f64) {
        if let Some(average) = &mut self.average {
            let _ = no_grad(|| average.lerp_(self.sets[0].adam.weights(), 1.0 - decay));
        }
    }

    /// Moves all weights towards those of another copy of the same networks, by the share `rate`.
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

    /// Returns the values of all groups, named `<group><suffix>/<name>`.
    pub(super) fn values(&self, suffix: &str) -> Vec<(String, Tensor)> {
        self.sets
            .iter()
            .flat_map(|own| prefixed(&format!("{}{suffix}", own.set.name), own.params.named()))
            .collect()
    }

    /// Loads values that [`Weights::values`] returned.
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

    /// Returns the values, the average and the optimisers' moments.
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

    /// Loads a state that [`Weights::state`] returned.
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

    /// Loads only the weights of a state, as
    /// [`Algorithm::load_weights`](super::Algorithm::load_weights) does.
    ///
    /// # Errors
    /// [`Error::State`].
    pub(super) fn load_weights(&mut self, state: &[(String, Tensor)]) -> Result<(), Error> {
        let averaged = part(state, "actor_average");
        // Training continues from the weights that are evaluated, but with the new run's own noise.
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

    /// Returns the number of the policy's weights, without the parts that only training needs, and
    /// the number of all weights.
    pub(super) fn parameters(&self, training_only: &[&str]) -> (i64, i64) {
        let needed = |name: &str| !training_only.iter().any(|part| name.starts_with(part));
        let policy = self.sets[0].params.named().iter().filter(|(name, _)| needed(name));
        let deployed = policy.map(|(_, t)| t.numel() as i64).sum();
        (deployed, self.sets.iter().map(|own| own.params.count()).sum())
    }

    /// Returns the number of rows of the parameter `<group>/<name>`.
    pub(super) fn rows(&self, path: &str) -> Option<i64> {
        let named = self.values("");
        named.iter().find(|(name, _)| name == path).map(|(_, t)| t.size()[0])
    }
}

impl Optimised {
    /// Clips the gradient. Returns the name and the value of its norm before clipping.
    fn clip(&mut self, limit: f64) -> Result<(&'static str, f64), Error> {
        let norm = self.adam.clip_grad_norm(limit);
        if norm.is_finite() {
            Ok((self.set.norm, norm))
        } else {
            Err(Error::NonFinite { what: self.set.gradient })
        }
    }
}

/// Returns copies of tensors, named `prefix/<name>`, for a state.
fn prefixed(prefix: &str, tensors: &[(String, Tensor)]) -> Vec<(String, Tensor)> {
    let copy = |tensor: &Tensor| tensor.detach().to_device(Device::Cpu).copy();
    tensors.iter().map(|(name, tensor)| (format!("{prefix}/{name}"), copy(tensor))).collect()
}

/// Returns the tensors of a state whose names begin with `prefix/`, under the rest of their names.
pub(super) fn part(state: &[(String, Tensor)], prefix: &str) -> Vec<(String, Tensor)> {
    let strip = |(name, t): &(String, Tensor)| {
        Some((name.strip_prefix(prefix)?.strip_prefix('/')?.to_owned(), t.shallow_clone()))
    };
    state.iter().filter_map(strip).collect()
}

/// Returns the value normalisation, for a state.
pub(super) fn value_norm_entry(norm: &ValueNorm) -> (String, Tensor) {
    ("value_norm/statistics".to_owned(), Tensor::from_slice(&norm.state()))
}

/// Loads the entry that [`value_norm_entry`] returned.
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
