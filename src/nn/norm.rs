//! Layer normalisation.

use tch::Tensor;

use super::{Init, Path};

/// Normalises the last dimension to mean 0 and variance 1 (`eps` 1e-5), then scales and shifts by learned weights.
#[derive(Debug)]
pub struct LayerNorm {
    weight: Tensor,
    bias: Tensor,
}

impl LayerNorm {
    /// For inputs whose last dimension is `width`; scale 1, shift 0.
    pub fn new(mut path: Path<'_>, width: i64) -> Self {
        let weight = path.create("weight", &[width], Init::Constant(1.0));
        LayerNorm { weight, bias: path.create("bias", &[width], Init::Zeros) }
    }

    /// `x: [.., width]` to the same shape.
    pub fn forward(&self, x: &Tensor) -> Tensor {
        x.layer_norm(self.weight.size(), Some(&self.weight), Some(&self.bias), 1e-5, false)
    }
}
