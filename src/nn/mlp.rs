//! The feed-forward trunk of MAPPO (Yu et al. 2022, reference code
//! `onpolicy/algorithms/utils/mlp.py`), which all learners here share.

use std::f64::consts::SQRT_2;

use tch::Tensor;

use super::{Init, LayerNorm, Linear, Path};

/// A trunk: layer normalisation of the input, then blocks of a linear layer (orthogonal weights,
/// gain √2), a rectifier and layer normalisation.
#[derive(Debug)]
pub struct Mlp {
    norm: LayerNorm,
    layers: Vec<(Linear, LayerNorm)>,
}

impl Mlp {
    /// Creates a trunk from `inputs` to `hidden` features with `1 + extra_layers` blocks (MAPPO's
    /// default: one extra layer).
    pub fn new(mut path: Path<'_>, inputs: i64, hidden: i64, extra_layers: usize) -> Self {
        let norm = LayerNorm::new(path.sub("norm"), inputs);
        let mut layers_path = path.sub("layers");
        let layers = (0..=extra_layers)
            .map(|i| {
                let mut path = layers_path.sub(i);
                let width = if i == 0 { inputs } else { hidden };
                let linear =
                    Linear::new(path.sub("linear"), width, hidden, Init::Orthogonal(SQRT_2));
                (linear, LayerNorm::new(path.sub("norm"), hidden))
            })
            .collect();
        Mlp { norm, layers }
    }

    /// Maps `x: [.., inputs]` to `[.., hidden]`.
    pub fn forward(&self, x: &Tensor) -> Tensor {
        let x = self.norm.forward(x);
        self.layers.iter().fold(x, |x, (linear, norm)| norm.forward(&linear.forward(&x).relu()))
    }
}
