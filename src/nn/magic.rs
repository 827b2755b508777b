//! The layers of MAGIC (Niu et al. 2021, CORE-Robotics-Lab/MAGIC, `magic.py`, `gnn_layers.py`): a scheduler that decides on the
//! edges of a communication graph, and graph attention over it.

use std::f64::consts::SQRT_2;

use tch::{Kind, Tensor};

use super::attention::graph_softmax;
use super::graph::sample_edges;
use super::{Init, Linear, Packing, Path};

/// Decides who listens to whom: a perceptron over both agents' features gives each ordered pair two logits, of no edge and of an
/// edge; its three layers have a quarter, a sixteenth and two of the pair's features.
#[derive(Debug)]
pub struct Scheduler {
    /// The first layer, `[H / 2, 2 H]`, listener first, and its shift.
    first: Tensor,
    shift: Tensor,
    second: Linear,
    third: Linear,
}

impl Scheduler {
    /// A scheduler over features of width `inputs`; weights as PyTorch draws them by default.
    pub fn new(mut path: Path<'_>, inputs: i64) -> Self {
        let (wide, narrow) = ((inputs / 2).max(1), (inputs / 8).max(1));
        let init = Init::Uniform(1.0 / ((2 * inputs) as f64).sqrt());
        let mut first = path.sub("first");
        Self {
            first: first.create("weight", &[wide, 2 * inputs], init),
            shift: first.create("bias", &[wide], init),
            second: Linear::torch_default(path.sub("second"), wide, narrow),
            third: Linear::torch_default(path.sub("third"), narrow, 2),
        }
    }

    /// Scores `[B, N, N]` from features `f: [P, H]` of the agents in the rows of a packing: how much more likely an edge (row =
    /// listener) is than none, as the logarithm of their ratio.
    pub fn scores(&self, f: &Tensor, packing: &Packing) -> Tensor {
        let inputs = f.size()[1];
        // The first layer of a pair is a sum of a part of each.
        let part = |from: i64, shift: Option<&Tensor>| {
            packing.unpack(&f.linear(&self.first.narrow(1, from, inputs), shift))
        };
        let pairs = part(0, Some(&self.shift)).unsqueeze(2) + part(inputs, None).unsqueeze(1);
        let logits = self.third.forward(&self.second.forward(&pairs.relu()).relu());
        logits.select(-1, 1) - logits.select(-1, 0)
    }

    /// The graph, as [`CommGraph::forward`](super::CommGraph::forward) gives it, at temperature 1.
    pub fn forward(
        &self,
        f: &Tensor,
        packing: &Packing,
        physical: &Tensor,
        noise: Option<&Tensor>,
    ) -> Tensor {
        sample_edges(&self.scores(f, packing), physical, noise, 1.0)
    }
}

/// Multi-head graph attention by additive scores, whose weights are normalised over the graph's
/// open edges. The reference multiplies scores, weights and normalised weights by the graph: the
/// same weights, but no gradient for a closed edge.
#[derive(Debug)]
pub struct GraphAttention {
    heads: i64,
    width: i64,
    joined: bool,
    weight: Tensor,
    listener: Tensor,
    speaker: Tensor,
    bias: Tensor,
}

impl GraphAttention {
    /// A layer from `inputs` features to `heads` times `width`, side by side if `joined`, else their mean. Weights Xavier normal
    /// with gain √2, zero shift.
    pub fn new(mut path: Path<'_>, inputs: i64, heads: i64, width: i64, joined: bool) -> Self {
        let init = Init::XavierNormal(SQRT_2);
        Self {
            heads,
            width,
            joined,
            weight: path.create("weight", &[heads * width, inputs], init),
            listener: path.create("listener", &[heads, width], init),
            speaker: path.create("speaker", &[heads, width], init),
            bias: path.create("bias", &[if joined { heads * width } else { width }], Init::Zeros),
        }
    }

    /// Features `f: [P, inputs]` of the agents in the rows of a packing over `graph: [B, N, N]` (row = listener) to
    /// `[P, heads · width]` or `[P, width]`. Every agent must listen to somebody, usually itself.
    pub fn forward(&self, f: &Tensor, packing: &Packing, graph: &Tensor) -> Tensor {
        let (batch, agents) = packing.size();
        let h = packing
            .unpack(&f.linear(&self.weight, None::<Tensor>))
            .view([batch, agents, self.heads, self.width]);
        let score = |by: &Tensor| (&h * by).sum_dim_intlist(-1, false, Kind::Float).transpose(1, 2);
        let sum = score(&self.listener).unsqueeze(3) + score(&self.speaker).unsqueeze(2);
        let scores = &sum * 0.2 + sum.relu() * 0.8;
        let weights = graph_softmax(&scores, &graph.unsqueeze(1));
        let mixed = weights.matmul(&h.transpose(1, 2)).transpose(1, 2);
        let out = if self.joined {
            mixed.reshape([batch, agents, self.heads * self.width])
        } else {
            mixed.mean_dim(2, false, Kind::Float)
        };
        packing.pack(&(out + &self.bias))
    }
}
