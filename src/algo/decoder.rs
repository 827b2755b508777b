//! Decoders that predict a target from a latent, so that the latent comes to contain it.

use tch::{Kind, Tensor};

use super::batch::{Batch, Shard};
use super::decision::Reconstruction;
use super::parameters::{ACTOR, ParameterBuilder};
use super::settings::Settings;
use crate::env::{EnvSpec, Feature};
use crate::nn::{Init, Linear, Path};

/// A decoder of three layers, of which the last one is linear.
pub(super) struct LatentDecoder([Linear; 3]);

impl LatentDecoder {
    pub(super) fn new(mut path: Path<'_>, inputs: i64, hidden: i64, outputs: i64) -> Self {
        Self([
            Linear::new(path.sub(0), inputs, hidden, Init::Orthogonal(1.0)),
            Linear::new(path.sub(1), hidden, hidden, Init::Orthogonal(1.0)),
            Linear::new(path.sub(2), hidden, outputs, Init::Orthogonal(0.01)),
        ])
    }

    pub(super) fn forward(&self, x: &Tensor) -> Tensor {
        let [first, second, third] = &self.0;
        third.forward(&second.forward(&first.forward(x).relu()).relu())
    }
}

/// Returns the mean squared error of a prediction, over samples and dimensions.
pub(super) fn mean_squared_error(prediction: &Tensor, target: &Tensor) -> Tensor {
    (prediction - target).square().mean(Kind::Float)
}

/// Magnitude of a feature's limits from which on it counts as unbounded.
const UNBOUNDED: f32 = 1e6;

/// A decoder that predicts the privileged state from a latent. It ends in tanh, so that its targets
/// are features divided by their largest magnitude, where that is above 1. Features without limits
/// stay as they are, so that it does not reach values beyond -1 and 1.
pub(super) struct WorldDecoder {
    decoder: LatentDecoder,
    /// What the features are divided by, `[S]`; `None` if all of them are between -1 and 1.
    scale: Option<Tensor>,
    /// Share of the samples from which the decoder learns.
    share: f64,
}

impl WorldDecoder {
    /// Creates a decoder of latents of width `inputs`.
    pub(super) fn new(path: Path<'_>, spec: &EnvSpec, settings: &Settings, inputs: i64) -> Self {
        let outputs = spec.state.len() as i64;
        let magnitude = |feature: &Feature| feature.low.abs().max(feature.high.abs());
        let scales = spec.state.list.iter().map(magnitude);
        let scales: Vec<f32> =
            scales.map(|most| if most < UNBOUNDED { most.max(1.0) } else { 1.0 }).collect();
        let device = path.device();
        let scale = || Tensor::from_slice(&scales).to_device(device);
        Self {
            scale: scales.iter().any(|scale| *scale > 1.0).then(scale),
            decoder: LatentDecoder::new(path, inputs, settings.network.hidden, outputs),
            share: settings.iwol.decoded,
        }
    }

    /// Returns the targets for privileged states `[.., S]`.
    fn target(&self, state: &Tensor) -> Tensor {
        self.scale.as_ref().map_or_else(|| state.shallow_clone(), |scale| state / scale)
    }

    /// Creates the actor's `world` decoder of latents of width `inputs`, where its loss has a
    /// weight.
    pub(super) fn of_actor(
        builder: &mut ParameterBuilder,
        spec: &EnvSpec,
        settings: &Settings,
        inputs: i64,
        weight: f64,
    ) -> Option<Self> {
        (weight > 0.0).then(|| Self::new(builder.of(ACTOR).sub("world"), spec, settings, inputs))
    }

    /// Returns the mean squared error on a part of a shard's active samples, whose latents are
    /// `x: [B, D]`.
    pub(super) fn loss(&self, batch: &Batch, shard: &Shard, x: &Tensor) -> Tensor {
        let target = shard.active(&batch.state);
        self.error(&shard.part(x, self.share), &shard.part(&target, self.share))
    }

    /// Returns the mean squared error on samples with latents `x: [B, D]` and these states.
    pub(super) fn error(&self, x: &Tensor, state: &Tensor) -> Tensor {
        mean_squared_error(&self.decoder.forward(x).tanh(), &self.target(state))
    }

    /// Returns the predictions from latents `x: [E, N, D]`, with their targets.
    pub(super) fn reconstruct(&self, x: &Tensor, state: &Tensor) -> Reconstruction {
        let prediction = self.decoder.forward(x).tanh();
        Reconstruction { name: "world", prediction, target: self.target(state) }
    }
}
