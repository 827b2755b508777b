//! Decoders that predict a target from a latent, so that the latent comes to contain it.

use tch::{Kind, Tensor};

use super::batch::{Batch, Shard};
use super::decision::{Observation, Reconstruction};
use super::parameters::{ACTOR, ParameterBuilder};
use super::settings::{Settings, WorldTarget};
use crate::env::EnvSpec;
use crate::nn::{Init, Linear, Path};

/// A decoder of three layers, optionally with a tanh at its end.
pub(super) struct LatentDecoder {
    layers: [Linear; 3],
    tanh: bool,
}

impl LatentDecoder {
    pub(super) fn new(
        mut path: Path<'_>,
        inputs: i64,
        hidden: i64,
        outputs: i64,
        tanh: bool,
    ) -> Self {
        let layers = [
            Linear::new(path.sub(0), inputs, hidden, Init::Orthogonal(1.0)),
            Linear::new(path.sub(1), hidden, hidden, Init::Orthogonal(1.0)),
            Linear::new(path.sub(2), hidden, outputs, Init::Orthogonal(0.01)),
        ];
        Self { layers, tanh }
    }

    pub(super) fn forward(&self, x: &Tensor) -> Tensor {
        let [first, second, third] = &self.layers;
        let output = third.forward(&second.forward(&first.forward(x).relu()).relu());
        if self.tanh { output.tanh() } else { output }
    }

    /// Returns the mean squared error against `target`, over samples and dimensions.
    pub(super) fn loss(&self, x: &Tensor, target: &Tensor) -> Tensor {
        (self.forward(x) - target).square().mean(Kind::Float)
    }
}

/// A decoder that predicts the privileged state, or what `iwol.world_target` sets, from a latent.
pub(super) struct WorldDecoder {
    decoder: LatentDecoder,
    target: WorldTarget,
    /// Share of the samples from which the decoder learns.
    share: f64,
}

impl WorldDecoder {
    /// Creates a decoder of latents of width `inputs`.
    pub(super) fn new(path: Path<'_>, spec: &EnvSpec, settings: &Settings, inputs: i64) -> Self {
        let target = settings.iwol.world_target;
        let decoder =
            LatentDecoder::new(path, inputs, settings.network.hidden, target.width(spec), true);
        Self { decoder, target, share: settings.iwol.decoded }
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
        let target = shard.active(self.target.of(&batch.observation, &batch.state));
        self.decoder.loss(&shard.part(x, self.share), &shard.part(&target, self.share))
    }

    /// Returns the mean squared error on samples with latents `x: [B, D]` and these observations
    /// and states.
    pub(super) fn error(&self, x: &Tensor, observation: &Tensor, state: &Tensor) -> Tensor {
        self.decoder.loss(x, self.target.of(observation, state))
    }

    /// Returns the predictions from latents `x: [E, N, D]`, with their targets.
    pub(super) fn reconstruct(
        &self,
        x: &Tensor,
        input: &Observation,
        state: &Tensor,
    ) -> Reconstruction {
        let target = self.target.of(&input.observation, state).shallow_clone();
        Reconstruction { name: "world", prediction: self.decoder.forward(x), target }
    }
}
