//! The affine layer.

use tch::{Tensor, no_grad};

use super::{Init, Path};

/// An affine layer `y = x Wᵀ + b`, with `W: [out, in]` and `b: [out]`.
#[derive(Debug)]
pub struct Linear {
    weight: Tensor,
    bias: Tensor,
}

impl Linear {
    /// Creates a layer with weights drawn by `init` (for instance [`Init::Orthogonal`] with the
    /// gain of the activation that follows) and zero bias.
    pub fn new(mut path: Path<'_>, inputs: i64, outputs: i64, init: Init) -> Self {
        let weight = path.create("weight", &[outputs, inputs], init);
        Linear { weight, bias: path.create("bias", &[outputs], Init::Zeros) }
    }

    /// Creates a layer with PyTorch's default initialisation: weights and bias are uniform in
    /// ±`1 / sqrt(inputs)`.
    pub fn torch_default(mut path: Path<'_>, inputs: i64, outputs: i64) -> Self {
        let init = Init::Uniform(1.0 / (inputs as f64).sqrt());
        let weight = path.create("weight", &[outputs, inputs], init);
        Linear { weight, bias: path.create("bias", &[outputs], init) }
    }

    /// Creates `blocks` layers of the same input, fused into one layer. Each block is drawn
    /// separately; the bias is zero.
    pub fn fused(mut path: Path<'_>, inputs: i64, outputs: i64, blocks: i64, init: Init) -> Self {
        let weight = path.create_stacked("weight", blocks, [outputs, inputs], init);
        Linear { weight, bias: path.create("bias", &[blocks * outputs], Init::Zeros) }
    }

    /// Changes weights and bias in place so that an output `y` becomes `scale · y + shift`.
    pub fn rescale(&self, scale: f64, shift: f64) {
        no_grad(|| {
            let _ = self.weight.shallow_clone().g_mul_scalar_(scale);
            let _ = self.bias.shallow_clone().g_mul_scalar_(scale).g_add_scalar_(shift);
        });
    }

    /// Returns the bias `b: [out]`.
    pub fn bias(&self) -> &Tensor {
        &self.bias
    }

    /// Maps `x: [.., in]` to `[.., out]`.
    pub fn forward(&self, x: &Tensor) -> Tensor {
        x.linear(&self.weight, Some(&self.bias))
    }
}
