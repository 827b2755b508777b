//! Layer normalisation.

use tch::Tensor;

use super::{Init, Path};

/// A layer that normalises the last dimension to mean 0 and variance 1 (`eps` 1e-5), then scales
/// and shifts it by learned parameters.
#[derive(Debug)]
pub struct LayerNorm {
    weight: Tensor,
    bias: Tensor,
}

impl LayerNorm {
    /// Creates a layer for inputs whose last dimension is `width`, with scale 1 and shift 0.
    pub fn new(mut path: Path<'_>, width: i64) -> Self {
        let weight = path.create("weight", &[width], Init::Constant(1.0));
        LayerNorm { weight, bias: path.create("bias", &[width], Init::Zeros) }
    }

    /// Maps `x: [.., width]` to the same shape.
    pub fn forward(&self, x: &Tensor) -> Tensor {
        x.layer_norm(self.weight.size(), Some(&self.weight), Some(&self.bias), 1e-5, false)
    }
}
