//! Running normalisation of value targets (ValueNorm of MAPPO's reference code,
//! `onpolicy/utils/valuenorm.py`).
//!
//! With the reference's decay of 0.99999, the statistics are in effect cumulative means over all
//! batches seen. The state is in `f64`.

use tch::{Kind, Tensor};

/// Factor by which every batch multiplies the weight of the old statistics.
const DECAY: f64 = 0.99999;
const MIN_WEIGHT: f64 = 1e-5;
const MIN_VARIANCE: f64 = 1e-2;

/// Running mean and mean square of the returns, with a common debiasing weight. The default has
/// seen no returns: mean 0, standard deviation 0.1.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct ValueNorm {
    mean: f64,
    mean_square: f64,
    weight: f64,
}

impl ValueNorm {
    /// Adds a batch of returns of any shape to the statistics. The caller passes the returns of
    /// active agents only. An empty batch changes nothing.
    pub fn update(&mut self, returns: &Tensor) {
        if returns.numel() == 0 {
            return;
        }
        let x = returns.detach().to_kind(Kind::Double);
        let (mean, mean_square) = (x.mean(Kind::Double), x.square().mean(Kind::Double));
        let (mean, mean_square) = (mean.double_value(&[]), mean_square.double_value(&[]));
        self.mean = DECAY * self.mean + (1.0 - DECAY) * mean;
        self.mean_square = DECAY * self.mean_square + (1.0 - DECAY) * mean_square;
        self.weight = DECAY * self.weight + (1.0 - DECAY);
    }

    /// Returns the debiased mean and standard deviation (at least 0.1) of the returns seen.
    pub fn mean_std(&self) -> (f64, f64) {
        let weight = self.weight.max(MIN_WEIGHT);
        let mean = self.mean / weight;
        let variance = self.mean_square / weight - mean * mean;
        (mean, variance.max(MIN_VARIANCE).sqrt())
    }

    /// Returns the scale and shift that convert values normalised by the statistics `old` to values
    /// normalised by these ones, so that they stand for the same returns; `None` if `old` has seen
    /// no returns (PopArt: van Hasselt et al. 2016, "Learning values across many orders of
    /// magnitude", proposition 1).
    pub fn rescaling(&self, old: &Self) -> Option<(f64, f64)> {
        let ((old_mean, old_std), (mean, std)) = (old.mean_std(), self.mean_std());
        (old.weight > 0.0).then_some((old_std / std, (old_mean - mean) / std))
    }

    /// Converts returns to the network's scale, elementwise.
    pub fn normalize(&self, returns: &Tensor) -> Tensor {
        let (mean, std) = self.mean_std();
        (returns - mean) / std
    }

    /// Converts the network's values to the scale of the returns, elementwise.
    pub fn denormalize(&self, values: &Tensor) -> Tensor {
        let (mean, std) = self.mean_std();
        values * std + mean
    }

    /// Returns running mean, mean square and weight, for a checkpoint.
    pub fn state(&self) -> [f64; 3] {
        [self.mean, self.mean_square, self.weight]
    }

    /// Restores a state that [`ValueNorm::state`] returned.
    pub fn load_state(&mut self, [mean, mean_square, weight]: [f64; 3]) {
        *self = ValueNorm { mean, mean_square, weight };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn starts_narrow_then_follows_the_returns() {
        let mut norm = ValueNorm::default();
        assert_eq!(norm.mean_std(), (0.0, 0.1));
        let x = Tensor::from_slice(&[2.0_f32, 6.0]);
        norm.update(&x.narrow(0, 0, 0));
        assert_eq!(norm, ValueNorm::default(), "an empty batch");
        norm.update(&x);
        let (mean, std) = norm.mean_std();
        assert!((mean - 4.0).abs() < 1e-9 && (std - 2.0).abs() < 1e-9, "{mean} {std}");
        assert!(norm.denormalize(&norm.normalize(&x)).allclose(&x, 1e-6, 1e-6, false));
        let before = norm;
        norm.update(&(&x * 7.0));
        let (scale, shift) = norm.rescaling(&before).expect("something was seen");
        let rescaled = before.normalize(&x) * scale + shift;
        assert!(
            norm.denormalize(&rescaled).allclose(&x, 1e-6, 1e-6, false),
            "values keep their meaning"
        );
        assert_eq!(norm.rescaling(&ValueNorm::default()), None);
        let mut restored = ValueNorm::default();
        restored.load_state(norm.state());
        assert_eq!(restored, norm);
    }
}
