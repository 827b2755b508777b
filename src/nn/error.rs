//! What can go wrong when tensors come from outside (a checkpoint) or leave the finite numbers (a diverging run).
//!
//! Wrong shapes between our own layers are bugs and panic in libtorch; they have no place here.

use tch::Tensor;

/// A tensor that cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The tensors to load lack one that the network has.
    #[error(
        "tensor `{name}` is missing; the weights are of another network or of another configuration"
    )]
    Missing {
        /// Name of the tensor in the network.
        name: String,
    },
    /// The tensors to load hold one that the network does not have.
    #[error(
        "tensor `{name}` is not part of this network; the weights are of another network or configuration"
    )]
    Unexpected {
        /// Name of the superfluous tensor.
        name: String,
    },
    /// A tensor to load has another shape than the network's tensor of that name.
    #[error(
        "tensor `{name}` has shape {found:?}, but this network needs {expected:?}; check the configuration"
    )]
    Shape {
        /// Name of the tensor.
        name: String,
        /// Shape in the network.
        expected: Vec<i64>,
        /// Shape of the tensor that was to be loaded.
        found: Vec<i64>,
    },
    /// A tensor holds NaN or an infinity.
    #[error("`{what}` holds values that are not finite")]
    NonFinite {
        /// What the tensor is.
        what: String,
    },
}

/// Checks that every element of `tensor` is a finite number.
///
/// # Errors
/// [`Error::NonFinite`], naming `what`, if any element is NaN or infinite.
pub fn ensure_finite(what: &str, tensor: &Tensor) -> Result<(), Error> {
    if tensor.isfinite().all().int64_value(&[]) != 0 {
        Ok(())
    } else {
        Err(Error::NonFinite { what: what.to_owned() })
    }
}
