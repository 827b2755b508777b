//! The head of policies with discrete actions: a categorical distribution over the choices that the
//! environment leaves open.

use std::f64::consts::SQRT_2;

use tch::{Kind, Tensor};

use super::decision::ActMode;
use super::parameters::{ACTOR, ParameterBuilder};
use crate::nn::{Init, Linear, categorical_entropy, categorical_log_probs};

/// A policy head that gives the probabilities of K choices.
#[derive(Debug)]
pub struct CategoricalHead {
    logits: Linear,
    choices: i64,
}

impl CategoricalHead {
    /// Creates the head of a policy that reads `inputs` features, as the actor's `head`.
    pub(super) fn of_actor(builder: &mut ParameterBuilder, inputs: i64, choices: usize) -> Self {
        let choices = choices as i64;
        let init = Init::Orthogonal(0.01);
        let logits =
            Linear::new(builder.of(ACTOR).sub("head").sub("logits"), inputs, choices, init);
        Self { logits, choices }
    }

    /// Returns the logarithms of the probabilities, `[.., K]`. `available [.., K]` is 1 where a
    /// choice is open; if it is empty, all are.
    pub(super) fn log_probs(&self, x: &Tensor, available: &Tensor) -> Tensor {
        categorical_log_probs(&self.logits.forward(x), available)
    }

    /// Returns the numbers of choices, and the logarithms of their probabilities, both `[E, N, 1]`.
    /// A sample takes the first choice at which the cumulative probability reaches the quantile of
    /// its standard normal noise.
    pub(super) fn sample(
        &self,
        x: &Tensor,
        available: &Tensor,
        mode: &ActMode,
    ) -> (Tensor, Tensor) {
        let log_probs = self.log_probs(x, available);
        let choice = match mode {
            ActMode::Deterministic => log_probs.argmax(-1, true),
            ActMode::Sample { action: noise, .. } => {
                let quantile = (((noise / SQRT_2).erf() + 1.0) * 0.5).clamp_min(1e-7);
                let sums = log_probs.exp().cumsum(-1, Kind::Float);
                // The last sum is 1 but for rounding.
                let sums = &sums / sums.narrow(-1, self.choices - 1, 1);
                let below = sums.lt_tensor(&quantile).to_kind(Kind::Int64);
                below.sum_dim_intlist(-1, true, Kind::Int64).clamp_max(self.choices - 1)
            }
        };
        (choice.to_kind(Kind::Float), log_probs.gather(-1, &choice, false))
    }

    /// Returns the logarithms of the probabilities of choices, `[B, 1]`, and the entropy, `[B]`.
    pub(super) fn score(
        &self,
        x: &Tensor,
        available: &Tensor,
        choice: &Tensor,
    ) -> (Tensor, Tensor) {
        let log_probs = self.log_probs(x, available);
        let log_prob = log_probs.gather(-1, &choice.to_kind(Kind::Int64), false);
        (log_prob, categorical_entropy(&log_probs))
    }

    /// Returns choices `[.., 1]` with 1 in the place of each, `[.., K]`.
    pub(super) fn one_hot(&self, choice: &Tensor) -> Tensor {
        let index = choice.squeeze_dim(-1).to_kind(Kind::Int64);
        index.one_hot(self.choices).to_kind(Kind::Float)
    }
}

#[cfg(test)]
mod tests {
    use tch::Device;

    use super::*;
    use crate::rng::{self, Seed};

    const CPU: (Kind, Device) = (Kind::Float, Device::Cpu);

    fn head() -> CategoricalHead {
        let mut builder = ParameterBuilder::new(Seed::new(1), Device::Cpu);
        CategoricalHead::of_actor(&mut builder, 3, 4)
    }

    /// Choices come as often as their probabilities say, and closed ones never.
    #[test]
    fn choices_come_as_often_as_they_should() {
        let (head, draws) = (head(), 40_000);
        let x = (Tensor::from_slice(&[40.0_f32, -60.0, 90.0])).expand([1, draws, 3], false);
        let open = Tensor::from_slice(&[0.0_f32, 1.0, 1.0, 1.0]).expand([1, draws, 4], false);
        let mut noise = vec![0.0_f32; draws as usize];
        rng::fill_normal(&mut Seed::new(2).rng(), &mut noise);
        (noise[0], noise[1]) = (-9.0, 9.0);
        let noise = Tensor::from_slice(&noise).view([1, draws, 1]);
        let (carried, graph) = (Tensor::zeros([0], CPU), Tensor::zeros([0], CPU));
        let mode = ActMode::Sample { action: noise, carried, graph, log_fresh: Vec::new() };
        let (choice, log_prob) = head.sample(&x, &open, &mode);
        let wanted = head.log_probs(&x, &open).get(0).get(0).exp();
        assert_eq!(wanted.double_value(&[0]), 0.0);
        for k in 0..4 {
            let found = choice.eq(k).to_kind(Kind::Float).mean(Kind::Float).double_value(&[]);
            let wanted = wanted.double_value(&[k]);
            assert!((found - wanted).abs() < 0.01, "{k}: {found}, {wanted}");
            assert!(k == 0 || wanted > 0.05, "{k}: {wanted}");
        }
        let first = choice.int64_value(&[0, 0, 0]);
        let of_first = wanted.double_value(&[first]).ln();
        assert!((log_prob.double_value(&[0, 0, 0]) - of_first).abs() < 1e-5);
        let (best, _) = head.sample(&x, &open, &ActMode::Deterministic);
        assert_eq!(best.int64_value(&[0, 5, 0]), wanted.argmax(-1, false).int64_value(&[]));
    }
}
