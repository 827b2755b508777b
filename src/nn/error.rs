//! Errors for tensors that come from outside (a checkpoint).
//!
//! Wrong shapes between this program's own layers are bugs: they panic in libtorch and have no
//! error here.

/// An error about a tensor that cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The tensors to load lack a tensor of the network.
    #[error(
        "tensor `{name}` is missing; the weights are of another network or of another configuration"
    )]
    Missing {
        /// Name of the tensor in the network.
        name: String,
    },
    /// The tensors to load contain a tensor that the network does not have.
    #[error(
        "tensor `{name}` is not part of this network; the weights are of another network or configuration"
    )]
    Unexpected {
        /// Name of the unexpected tensor.
        name: String,
    },
    /// A tensor to load has another shape than the network's tensor of the same name.
    #[error(
        "tensor `{name}` has shape {found:?}, but this network needs {expected:?}; check the configuration"
    )]
    Shape {
        /// Name of the tensor.
        name: String,
        /// Shape in the network.
        expected: Vec<i64>,
        /// Shape of the tensor to load.
        found: Vec<i64>,
    },
}
