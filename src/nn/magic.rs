//! The layers of MAGIC (Niu et al. 2021, CORE-Robotics-Lab/MAGIC, `magic.py`, `gnn_layers.py`): a
//! scheduler that decides on the edges of a communication graph, and graph attention over that
//! graph.

use std::f64::consts::SQRT_2;

use tch::{Kind, Tensor};

use super::attention::graph_softmax;
use super::graph::sample_edges;
use super::{Init, Linear, Packing, Path};

/// Decides which agent listens to which: a perceptron over the features of both agents gives each
/// ordered pair two logits, one for no edge and one for an edge. For features of width `H` its
/// three layers have `H / 2`, `H / 8` and 2 outputs.
#[derive(Debug)]
pub struct Scheduler {
    /// Weights of the first layer, `[H / 2, 2 H]` with the listener's part first, and its bias.
    first: Tensor,
    shift: Tensor,
    second: Linear,
    third: Linear,
}

impl Scheduler {
    /// Creates a scheduler over features of width `inputs`, with PyTorch's default initial weights.
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

    /// Returns scores `[B, N, N]` (row = listener) from features `f: [P, H]` of the agents in the
    /// rows of a packing. A score is the logarithm of the ratio between the probabilities of an
    /// edge and of no edge.
    pub fn scores(&self, f: &Tensor, packing: &Packing) -> Tensor {
        let inputs = f.size()[1];
        // A pair's first layer is the sum of a listener's and a speaker's part.
        let part = |from: i64, shift: Option<&Tensor>| {
            packing.unpack(&f.linear(&self.first.narrow(1, from, inputs), shift))
        };
        let pairs = part(0, Some(&self.shift)).unsqueeze(2) + part(inputs, None).unsqueeze(1);
        let logits = self.third.forward(&self.second.forward(&pairs.relu()).relu());
        logits.select(-1, 1) - logits.select(-1, 0)
    }

    /// Returns the graph, as [`CommGraph::forward`](super::CommGraph::forward) does.
    pub fn forward(
        &self,
        f: &Tensor,
        packing: &Packing,
        physical: &Tensor,
        noise: Option<&Tensor>,
    ) -> Tensor {
        sample_edges(&self.scores(f, packing), physical, noise)
    }
}

/// Multi-head graph attention with additive scores, whose weights are normalised over the graph's
/// open edges. The reference multiplies scores, weights and normalised weights by the graph, which
/// gives the same weights but no gradient for a closed edge.
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
    /// Creates a layer from `inputs` features to `heads` heads of `width` features, which are
    /// concatenated if `joined` and averaged otherwise. Weights are Xavier normal with gain √2; the
    /// bias is zero.
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

    /// Maps features `f: [P, inputs]` of the agents in the rows of a packing, over
    /// `graph: [B, N, N]` (row = listener), to `[P, heads · width]` if the heads are concatenated
    /// and to `[P, width]` otherwise. Every agent must listen to at least one agent, usually
    /// itself.
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
