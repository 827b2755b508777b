//! The head of policies with continuous actions.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use smart_default::SmartDefault;
use tch::{Device, Kind, Tensor, no_grad};

use super::decision::ActMode;
use super::parameters::{ACTOR, ParameterBuilder};
use super::settings::Settings;
use crate::env::{ActionDimension, ActionSpace, EnvSpec};
use crate::nn::{Init, Linear, Path, gaussian_log_prob};

/// Exploration noise.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema, SmartDefault)]
#[serde(deny_unknown_fields)]
#[schemars(default)]
pub struct Exploration {
    /// Source of the actions' standard deviation.
    #[default(NoiseMode::Schedule)]
    pub mode: NoiseMode,
    /// Logarithm of the standard deviation at the beginning (initial value of the parameter where
    /// it is learned); by default -1 with `init_from`. An imposed standard deviation also scales
    /// the noise of sampled communication graphs, except that of Im-IWoL, whose graph only the
    /// value function has.
    #[schemars(range(min = -20, max = 5))]
    pub log_std_start: f64,
    /// Logarithm of the standard deviation when annealing is over.
    #[default(-2.0)]
    #[schemars(range(min = -20, max = 5))]
    pub log_std_end: f64,
    /// Environment steps over which the logarithm of the standard deviation falls linearly from
    /// `exploration.log_std_start` to -1, or stays where it begins if that is lower, after which
    /// annealing lowers it further; by default × 8/N below 8 agents.
    #[default = 250_000]
    #[schemars(range(max = 1_u64 << 50))]
    pub explore_steps: u64,
    /// Correlation of the noise of actions from step to step (first-order autoregressive, of
    /// constant variance). Correlated noise moves a vehicle further from its mean trajectory and so
    /// finds other orders of passing; but vehicles that must allow for it drive slowly (Hollenstein
    /// et al., AAAI 2024). Probabilities of actions are conditional on the noise of the step before.
    /// The noise of steering is always independent from step to step
    /// ([more](../lab/decision-process.md#noise-that-lasts-in-the-throttle-alone)).
    #[schemars(range(min = 0), extend("exclusiveMaximum" = 1))]
    pub correlation: f64,
}

impl Exploration {
    /// Logarithm of the standard deviation after [`Exploration::explore_steps`]. A lower value
    /// freezes a run that has not succeeded by then.
    pub const LOG_STD_EXPLORED: f64 = -1.0;
}

/// The source of the actions' standard deviation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum NoiseMode {
    /// A schedule imposes it.
    Schedule,
    /// The standard deviation is a parameter and is learned (released code).
    Learned,
}

/// A policy head that gives mean and standard deviation of the actions.
#[derive(Debug)]
pub struct GaussianHead {
    mean: Linear,
    log_std: Tensor,
    /// Offset of each dimension's logarithm of the standard deviation from the scheduled one,
    /// `[A]`.
    relative: Tensor,
    mode: NoiseMode,
    /// Whether a tanh bounds the means to -1 to 1.
    bounded: bool,
}

/// Largest magnitude of an initial mean below a tanh, which reaches 1 nowhere.
const MOST_MEAN: f64 = 0.999;

impl GaussianHead {
    /// Creates a head for actions of these dimensions, each of which sets its initial mean and its
    /// factor on the scheduled noise.
    pub(super) fn new(
        mut path: Path<'_>,
        inputs: i64,
        actions: &[ActionDimension],
        exploration: &Exploration,
    ) -> Self {
        let count = actions.len() as i64;
        let mean = Linear::new(path.sub("mean"), inputs, count, Init::Orthogonal(0.01));
        let log_std = path.create("log_std", &[count], Init::Zeros);
        let each = |of: fn(&ActionDimension) -> f32| {
            Tensor::from_slice(&actions.iter().map(of).collect::<Vec<_>>())
                .to_device(log_std.device())
        };
        no_grad(|| mean.bias().shallow_clone().copy_(&each(|action| action.initial_mean)));
        let relative = each(|action| action.noise_scale.ln());
        let head = Self { mean, log_std, relative, mode: exploration.mode, bounded: false };
        head.set(exploration.log_std_start);
        head
    }

    /// Creates the head of a policy that reads `inputs` features, as the actor's `head`.
    ///
    /// # Panics
    /// Where actions are discrete.
    pub(super) fn of_actor(
        builder: &mut ParameterBuilder,
        inputs: i64,
        spec: &EnvSpec,
        settings: &Settings,
    ) -> Self {
        let ActionSpace::Continuous(actions) = &spec.actions else { panic!("continuous actions") };
        Self::new(builder.of(ACTOR).sub("head"), inputs, actions, &settings.exploration)
    }

    fn set(&self, log_std: f64) {
        no_grad(|| self.log_std.shallow_clone().copy_(&(&self.relative + log_std)));
    }

    /// Returns the head with a tanh on its means, of which the initial ones stay the same.
    pub(super) fn bounded(self) -> Self {
        no_grad(|| {
            let bias = self.mean.bias();
            bias.shallow_clone().copy_(&bias.clamp(-MOST_MEAN, MOST_MEAN).atanh());
        });
        Self { bounded: true, ..self }
    }

    /// Sets the logarithm of the standard deviation, unless it is learned.
    pub(super) fn impose(&self, log_std: f64) {
        if self.mode == NoiseMode::Schedule {
            self.set(log_std);
        }
    }

    /// Returns the mean, `[.., A]`, and the logarithm of the standard deviation, `[A]`.
    pub(super) fn forward(&self, x: &Tensor) -> (Tensor, Tensor) {
        let log_std = if self.mode == NoiseMode::Schedule {
            self.log_std.detach()
        } else {
            self.log_std.shallow_clone()
        };
        let mean = self.mean.forward(x);
        (if self.bounded { mean.tanh() } else { mean }, log_std)
    }

    /// Returns the means before the tanh, `[.., A]`.
    pub(super) fn unbounded(&self, x: &Tensor) -> Tensor {
        self.mean.forward(x)
    }

    /// Returns actions and the log-probabilities of their dimensions, both `[E, N, A]`.
    pub(super) fn sample(&self, x: &Tensor, mode: &ActMode) -> (Tensor, Tensor) {
        let (mean, log_std) = self.forward(x);
        let (mean, action, log_std) = match mode {
            ActMode::Sample { action: noise, carried, log_fresh, .. } => {
                let mean = shifted(&mean, &log_std, carried);
                let log_std = if log_fresh.is_empty() {
                    log_std
                } else {
                    let fresh = Tensor::from_slice(log_fresh).to_device(log_std.device());
                    log_std + fresh
                };
                let action = &mean + log_std.exp() * noise;
                (mean, action, log_std)
            }
            ActMode::Deterministic => (mean.shallow_clone(), mean, log_std),
        };
        let log_prob = gaussian_log_prob(&mean, &log_std, &action);
        (action, log_prob)
    }

    /// Returns the current standard deviation of each action dimension.
    pub(super) fn deviations(&self) -> Vec<f32> {
        Vec::try_from(self.log_std.detach().exp().to_device(Device::Cpu)).expect("numbers")
    }

    /// Returns the current standard deviation, averaged over action dimensions.
    pub(super) fn std(&self) -> f64 {
        self.log_std.exp().mean(Kind::Float).double_value(&[])
    }
}

/// Returns the mean of an action given the noise of earlier steps: `carried` is the shift by that
/// noise, in units of the standard deviation, or empty if there is none. The earlier noise was
/// drawn, so a learned standard deviation has no gradient through it.
pub(super) fn shifted(mean: &Tensor, log_std: &Tensor, carried: &Tensor) -> Tensor {
    if carried.numel() == 0 {
        mean.shallow_clone()
    } else {
        mean + log_std.detach().exp() * carried
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nn::Params;
    use crate::rng::Seed;

    #[test]
    fn each_dimension_begins_where_the_environment_says_and_has_noise_of_its_own() {
        let (mut params, mut rng) = (Params::new(Device::Cpu), Seed::new(0).rng());
        let exploration = Exploration { log_std_start: -0.5, ..Exploration::default() };
        let dimension = |name, initial_mean, noise_scale| ActionDimension {
            initial_mean,
            noise_scale,
            ..ActionDimension::named(name)
        };
        let actions = [dimension("steer", 0.0, (-1.0_f32).exp()), dimension("throttle", 0.5, 1.0)];
        let head = GaussianHead::new(params.root(&mut rng), 8, &actions, &exploration);
        let values =
            |t: &Tensor| Vec::<f64>::try_from(t.to_kind(Kind::Double).view([-1])).expect("numbers");
        let forward = || {
            let (mean, log_std) = head.forward(&Tensor::zeros([1, 8], (Kind::Float, Device::Cpu)));
            (values(&mean), values(&log_std))
        };
        let close = |a: &[f64], b: [f64; 2]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-6);
        let (mean, log_std) = forward();
        assert!(mean == [0.0, 0.5] && close(&log_std, [-1.5, -0.5]), "{mean:?} {log_std:?}");
        head.impose(-1.0);
        assert!(close(&forward().1, [-2.0, -1.0]), "{:?}", forward());
        let zeros = Tensor::zeros([1, 8], (Kind::Float, Device::Cpu));
        let mean = values(&head.bounded().forward(&zeros).0);
        assert!(close(&mean, [0.0, 0.5]), "the tanh changes no initial mean: {mean:?}");
    }
}
