//! The policy's distribution over continuous actions: an independent normal distribution for each
//! of the `A` action dimensions.
//!
//! An action is `mean + std * noise`, where the caller provides the noise. The action is not
//! clipped here: the environment clips it, and the log density is that of the action before
//! clipping.

use tch::{Kind, Tensor};

/// `ln(2π) / 2`.
const HALF_LN_TAU: f64 = 0.918_938_533_204_672_7;

/// Returns the log density of each dimension of `action: [.., A]`, `[.., A]`, for `mean: [.., A]`
/// and a logarithm of the standard deviation that broadcasts to it (usually `[A]`). The log density
/// of the whole action is the sum over its dimensions.
pub fn gaussian_log_prob(mean: &Tensor, log_std: &Tensor, action: &Tensor) -> Tensor {
    let z = (action - mean) * (-log_std).exp();
    z.square() * -0.5 - log_std - HALF_LN_TAU
}

/// Returns the differential entropy for `log_std: [.., A]`, summed over the action dimensions:
/// `[..]`, or a scalar for `[A]`.
pub fn gaussian_entropy(log_std: &Tensor) -> Tensor {
    (log_std + (0.5 + HALF_LN_TAU)).sum_dim_intlist(-1, false, Kind::Float)
}
