//! The feed-forward trunk of MAPPO (Yu et al. 2022, reference code
//! `onpolicy/algorithms/utils/mlp.py`), which all learners here share, and its layers.

use std::f64::consts::SQRT_2;

use tch::Tensor;

use super::{Init, LayerNorm, Linear, Path};

/// A linear layer (orthogonal weights, gain √2), an activation and layer normalisation.
#[derive(Debug)]
pub struct Layer {
    linear: Linear,
    norm: LayerNorm,
    activation: Activation,
}

/// The activation of a [`Layer`].
#[derive(Debug, Clone, Copy)]
pub enum Activation {
    /// The rectifier.
    Relu,
    /// The Gaussian error linear unit.
    Gelu,
}

impl Activation {
    /// Applies the activation elementwise.
    pub fn apply(self, x: &Tensor) -> Tensor {
        match self {
            Self::Relu => x.relu(),
            Self::Gelu => x.gelu("none"),
        }
    }
}

impl Layer {
    /// Creates a layer from `inputs` to `outputs` features, whose parts have the names `linear` and
    /// `norm` below `path`.
    pub fn new(
        path: &mut Path<'_>,
        [linear, norm]: [&str; 2],
        inputs: i64,
        outputs: i64,
        activation: Activation,
    ) -> Self {
        let linear = Linear::new(path.sub(linear), inputs, outputs, Init::Orthogonal(SQRT_2));
        Self { linear, norm: LayerNorm::new(path.sub(norm), outputs), activation }
    }

    /// Maps `x: [.., inputs]` to `[.., outputs]`.
    pub fn forward(&self, x: &Tensor) -> Tensor {
        self.norm.forward(&self.activation.apply(&self.linear.forward(x)))
    }
}

/// A trunk: layer normalisation of the input, unless it is left out, then two layers with rectifiers
/// (MAPPO's default).
#[derive(Debug)]
pub struct Mlp {
    norm: Option<LayerNorm>,
    layers: [Layer; 2],
}

impl Mlp {
    /// Creates a trunk from `inputs` to `hidden` features.
    pub fn new(path: Path<'_>, inputs: i64, hidden: i64) -> Self {
        Self::build(path, inputs, hidden, true)
    }

    /// Creates a trunk that takes its input as it is, or normalised.
    pub fn build(mut path: Path<'_>, inputs: i64, hidden: i64, normalised: bool) -> Self {
        let norm = normalised.then(|| LayerNorm::new(path.sub("norm"), inputs));
        let mut path = path.sub("layers");
        let layers = [(0, inputs), (1, hidden)].map(|(i, width)| {
            Layer::new(&mut path.sub(i), ["linear", "norm"], width, hidden, Activation::Relu)
        });
        Mlp { norm, layers }
    }

    /// Maps `x: [.., inputs]` to `[.., hidden]`.
    pub fn forward(&self, x: &Tensor) -> Tensor {
        let [first, second] = &self.layers;
        match &self.norm {
            Some(norm) => second.forward(&first.forward(&norm.forward(x))),
            None => second.forward(&first.forward(x)),
        }
    }
}
