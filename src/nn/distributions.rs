//! The policy's distribution over continuous actions: an independent normal distribution for each action dimension `A`.
//!
//! An action is `mean + std * noise`, with noise from the caller, and is not clipped: the environment clips, and the log
//! density is that of the action before clipping.

use tch::{Kind, Tensor};

/// `ln(2π) / 2`.
const HALF_LN_TAU: f64 = 0.918_938_533_204_672_7;

/// Log density of each dimension of `action: [.., A]` for `mean: [.., A]` and a logarithm of the standard deviation that
/// broadcasts to it (usually `[A]`): `[.., A]`. The action's is their sum.
pub fn gaussian_log_prob(mean: &Tensor, log_std: &Tensor, action: &Tensor) -> Tensor {
    let z = (action - mean) * (-log_std).exp();
    z.square() * -0.5 - log_std - HALF_LN_TAU
}

/// Differential entropy for `log_std: [.., A]`, summed over the action dimensions: `[..]`; a scalar for `[A]`.
pub fn gaussian_entropy(log_std: &Tensor) -> Tensor {
    (log_std + (0.5 + HALF_LN_TAU)).sum_dim_intlist(-1, false, Kind::Float)
}
