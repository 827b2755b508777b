//! The policy's distributions: over continuous actions an independent normal distribution for each
//! of the `A` action dimensions, over discrete ones a categorical distribution over the choices
//! that are open.
//!
//! A continuous action is `mean + std * noise`, where the caller provides the noise. The action is
//! not clipped here: the environment clips it, and the log density is that of the action before
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

/// Logit of a choice that is not open.
const CLOSED: f64 = -1e9;

/// Returns the logarithms of the probabilities of K choices, `[.., K]`, for `logits: [.., K]`.
/// `available: [.., K]` is 1 where a choice is open; if it is empty, all are. Where none is open, all
/// are equally likely.
pub fn categorical_log_probs(logits: &Tensor, available: &Tensor) -> Tensor {
    let open = (available.numel() > 0).then(|| logits.masked_fill(&available.lt(0.5), CLOSED));
    open.as_ref().unwrap_or(logits).log_softmax(-1, Kind::Float)
}

/// Returns the entropy, `[..]`, from the logarithms of the probabilities, `[.., K]`.
pub fn categorical_entropy(log_probs: &Tensor) -> Tensor {
    // A choice that is not open has no part in the entropy.
    let parts = log_probs.exp() * log_probs.clamp_min(-100.0);
    -parts.sum_dim_intlist(-1, false, Kind::Float)
}
