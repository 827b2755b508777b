//! The message transformer: `L` rounds of attention over the communication graph turn the agents'
//! features into messages.
//!
//! The architecture is that of the released IWoL code (`transformer_comm.py`), which is the encoder
//! of MAT (Wen et al. 2022): post-norm blocks whose output layers start near zero. Attention is
//! limited to open edges: what is sent over a closed edge changes nothing, bit for bit. (The
//! released code multiplies logits by the graph, so that closed edges leak.)

use std::f64::consts::SQRT_2;

use tch::Tensor;

use super::{
    Activation, Graph, Init, Layer, LayerNorm, Linear, Mask, Packing, Path, SelfAttention,
};

/// The second half of a post-norm transformer block: a perceptron of the same width, whose output is
/// added to its input and normalised.
#[derive(Debug)]
pub(super) struct FeedForward {
    up: Linear,
    down: Linear,
    norm: LayerNorm,
    activation: Activation,
}

impl FeedForward {
    /// Creates the layers `up`, `down` and `mlp_norm` below `path`, whose weights are drawn by `init`.
    pub(super) fn new(
        path: &mut Path<'_>,
        width: i64,
        init: [Init; 2],
        activation: Activation,
    ) -> Self {
        Self {
            up: Linear::new(path.sub("up"), width, width, init[0]),
            down: Linear::new(path.sub("down"), width, width, init[1]),
            norm: LayerNorm::new(path.sub("mlp_norm"), width),
            activation,
        }
    }

    /// Creates the layers of MAT: the activation is GELU, and the output starts near zero.
    pub(super) fn of_mat(path: &mut Path<'_>, width: i64) -> Self {
        let init = [Init::Orthogonal(SQRT_2), Init::Orthogonal(0.01)];
        Self::new(path, width, init, Activation::Gelu)
    }

    /// Maps `x: [.., width]` to the same shape.
    pub(super) fn forward(&self, x: &Tensor) -> Tensor {
        let change = self.down.forward(&self.activation.apply(&self.up.forward(x)));
        self.norm.forward(&(x + change))
    }
}

/// A post-norm transformer block: self-attention, then a perceptron of the same width with GELU.
/// The output layers of both start near zero (MAT's encoder, `ma_transformer.py`).
#[derive(Debug)]
pub struct Block {
    attention: SelfAttention,
    attention_norm: LayerNorm,
    perceptron: FeedForward,
}

impl Block {
    /// Creates a block over tokens of `width` features.
    ///
    /// # Panics
    /// If the heads do not divide the width.
    pub fn new(mut path: Path<'_>, width: i64, heads: i64) -> Self {
        Block {
            attention: SelfAttention::new(
                path.sub("attention"),
                width,
                heads,
                Init::Orthogonal(0.01),
            ),
            attention_norm: LayerNorm::new(path.sub("attention_norm"), width),
            perceptron: FeedForward::of_mat(&mut path, width),
        }
    }

    /// Maps tokens `x: [P, width]` of the occupied slots of a packing to the same shape.
    pub fn forward(&self, x: &Tensor, packing: &Packing, mask: Mask<'_>) -> Tensor {
        self.rest(&(x + self.attention.forward(x, packing, mask)))
    }

    /// Computes [`Block::forward`] for one token of each row, where every slot is occupied, as
    /// [`SelfAttention::forward_one`] does.
    fn forward_one(&self, x: &Tensor, place: &Tensor, mask: Mask<'_>) -> Tensor {
        let (batch, _, width) = x.size3().expect("tokens are [B, T, width]");
        let index = place.view([batch, 1, 1]).expand([batch, 1, width], false);
        let own = x.gather(1, &index, false).squeeze_dim(1);
        self.rest(&(own + self.attention.forward_one(x, place, mask)))
    }

    /// Applies the rest of the block to the sum of input and attention, `[P, width]`.
    fn rest(&self, x: &Tensor) -> Tensor {
        self.perceptron.forward(&self.attention_norm.forward(x))
    }
}

/// The transformer: input layer (normalisation, linear, GELU, normalisation), `L` post-norm blocks
/// over the graph, and output head (linear, GELU, normalisation, linear with gain 0.01).
#[derive(Debug)]
pub struct GraphTransformer {
    in_norm: LayerNorm,
    input: Layer,
    blocks: Vec<Block>,
    head: Layer,
    out: Linear,
}

impl GraphTransformer {
    /// Creates a transformer from features of `inputs` entries to messages of `width` entries, with
    /// `rounds` rounds and `heads` attention heads.
    ///
    /// # Panics
    /// If the heads do not divide the width.
    pub fn new(mut path: Path<'_>, inputs: i64, width: i64, rounds: usize, heads: i64) -> Self {
        let in_norm = LayerNorm::new(path.sub("in_norm"), inputs);
        let names = ["input", "embed_norm"];
        let input = Layer::new(&mut path, names, inputs, width, Activation::Gelu);
        let mut blocks = path.sub("rounds");
        let blocks = (0..rounds).map(|i| Block::new(blocks.sub(i), width, heads)).collect();
        GraphTransformer {
            in_norm,
            input,
            blocks,
            head: Layer::new(&mut path, ["head", "head_norm"], width, width, Activation::Gelu),
            out: Linear::new(path.sub("out"), width, width, Init::Orthogonal(0.01)),
        }
    }

    /// Maps features `f: [P, H]` of the agents in the `B` rows of a packing to messages `[P, D]`,
    /// over a graph in which no agent listens to an empty slot.
    pub fn forward(&self, f: &Tensor, packing: &Packing, graph: &Graph) -> Tensor {
        let full;
        let mask = match graph {
            Graph::Full(graph) => {
                full = graph.unsqueeze(1);
                Mask::Graph(&full)
            }
            Graph::Listed { neighbours, edges } => Mask::Listed(neighbours, edges),
        };
        let round = |x: Tensor, block: &Block| block.forward(&x, packing, mask);
        self.output(&self.blocks.iter().fold(self.embed(f), round))
    }

    /// Computes [`GraphTransformer::forward`] for one agent of each row, with all agents present
    /// and one round: maps features `f: [B, N, H]` and the edges `graph: [B, 1, N]` of the agent in
    /// slot `place: [B]` to its message `[B, D]`.
    ///
    /// # Panics
    /// If there is not exactly one round: with more, a message depends on other agents' edges.
    pub fn forward_one(&self, f: &Tensor, place: &Tensor, graph: &Tensor) -> Tensor {
        let [block] = &self.blocks[..] else { panic!("{} rounds, and not one", self.blocks.len()) };
        let x = self.embed(&f.flatten(0, 1)).view([f.size()[0], f.size()[1], -1]);
        self.output(&block.forward_one(&x, place, Mask::Graph(&graph.unsqueeze(1))))
    }

    /// Returns the number of rounds L.
    pub fn rounds(&self) -> usize {
        self.blocks.len()
    }

    fn embed(&self, f: &Tensor) -> Tensor {
        self.input.forward(&self.in_norm.forward(f))
    }

    fn output(&self, x: &Tensor) -> Tensor {
        self.out.forward(&self.head.forward(x))
    }
}

#[cfg(test)]
mod tests {
    use tch::{Device, Kind};

    use super::*;
    use crate::nn::{CommGraph, Params};
    use crate::rng::Seed;

    const AGENTS: i64 = 5;
    const WIDTH: i64 = 8;

    fn transformer() -> GraphTransformer {
        let mut params = Params::new(Device::Cpu);
        let network =
            GraphTransformer::new(params.root(&mut Seed::new(1).rng()), WIDTH, WIDTH, 3, 2);
        // Larger matrices: with the gain of 0.01, rounding would hide any flow of information.
        tch::no_grad(|| {
            for (name, tensor) in params.named() {
                if name.ends_with("qkv.weight")
                    || name.ends_with("out.weight")
                    || name.ends_with("down.weight")
                {
                    let _ = tensor.shallow_clone().multiply_scalar_(100.0);
                }
            }
        });
        network
    }

    /// Returns the messages `[B, N, H]` where all agents are present.
    fn messages(network: &GraphTransformer, f: &Tensor, graph: &Tensor) -> Tensor {
        let packing = Packing::full(f.size()[0], AGENTS);
        packing.unpack(&network.forward(
            &f.flatten(0, 1),
            &packing,
            &Graph::Full(graph.shallow_clone()),
        ))
    }

    fn uniform(shape: &[i64], seed: u64) -> Tensor {
        let values = Init::Uniform(1.0).sample(shape, &mut Seed::new(seed).rng());
        Tensor::from_slice(&values).view(shape)
    }

    fn perturbed(f: &Tensor, agent: i64) -> Tensor {
        let other = f.copy();
        other.select(1, agent).copy_(&(uniform(&[f.size()[0], f.size()[2]], 99) * 50.0));
        other
    }

    /// Returns the complete graph without the edges from `sender` to other agents.
    fn silenced(sender: i64) -> Tensor {
        let graph = Tensor::ones([3, AGENTS, AGENTS], (Kind::Float, Device::Cpu));
        let _ = graph.select(2, sender).fill_(0.0);
        let _ = graph.select(2, sender).select(1, sender).fill_(1.0);
        graph
    }

    fn others(t: &Tensor, agent: i64) -> Tensor {
        let index: Vec<i64> = (0..AGENTS).filter(|i| *i != agent).collect();
        t.index_select(1, &Tensor::from_slice(&index))
    }

    #[test]
    fn a_cut_sender_changes_nothing_bit_for_bit() {
        let (network, f) = (transformer(), uniform(&[3, AGENTS, WIDTH], 2).set_requires_grad(true));
        let graph = silenced(2);
        let out = messages(&network, &f, &graph);
        let out_perturbed = messages(&network, &perturbed(&f.detach(), 2), &graph);
        assert!(others(&out, 2).equal(&others(&out_perturbed, 2)), "others hear a cut sender");
        assert!(!out.select(1, 2).equal(&out_perturbed.select(1, 2)), "the sender hears itself");
        let gradient =
            Tensor::run_backward(&[others(&out, 2).square().sum(Kind::Float)], &[&f], false, false)
                .remove(0);
        assert_eq!(gradient.select(1, 2).abs().max().double_value(&[]), 0.0);
        assert!(gradient.select(1, 1).abs().max().double_value(&[]) > 0.0);
    }

    #[test]
    fn an_open_edge_lets_information_through() {
        let (network, f) = (transformer(), uniform(&[3, AGENTS, WIDTH], 2));
        let graph = Tensor::ones([3, AGENTS, AGENTS], (Kind::Float, Device::Cpu));
        let difference =
            messages(&network, &f, &graph) - messages(&network, &perturbed(&f, 2), &graph);
        assert!(others(&difference, 2).abs().max().double_value(&[]) > 1e-3);
    }

    /// One agent of each row alone, in one round, gets the same message as among all agents.
    #[test]
    fn one_agent_reads_as_it_does_among_all() {
        let mut params = Params::new(Device::Cpu);
        let mut rng = Seed::new(1).rng();
        let mut path = params.root(&mut rng);
        let scheduler = CommGraph::new(path.sub("graph"), WIDTH, WIDTH, 0.0);
        let network = GraphTransformer::new(path.sub("transformer"), WIDTH, WIDTH, 1, 2);
        let (f, physical) =
            (uniform(&[3, AGENTS, WIDTH], 2), uniform(&[3, AGENTS, AGENTS], 3).gt(-0.3));
        let (flat, packing) = (f.flatten(0, 1), Packing::full(3, AGENTS));
        let graph = scheduler.forward(&flat, &packing, &physical, None);
        let all =
            packing.unpack(&network.forward(&flat, &packing, &Graph::Full(graph.shallow_clone())));
        let places = [4_i64, 0, 2];
        let place = Tensor::from_slice(&places);
        let of = |x: &Tensor| {
            let rows: Vec<_> =
                (0..3).zip(places).map(|(row, place)| x.get(row).get(place)).collect();
            Tensor::stack(&rows, 0)
        };
        let possible = of(&physical).unsqueeze(1).to_kind(Kind::Float);
        let heard = scheduler.forward_one(&f, &place, &possible, None);
        assert!(heard.squeeze_dim(1).equal(&of(&graph)));
        assert!(heard.sum(Kind::Float).double_value(&[]) > 3.0, "somebody listens to another");
        let one = network.forward_one(&f, &place, &heard);
        assert!((one - of(&all)).abs().max().double_value(&[]) < 1e-6);
    }

    /// An absent agent changes nothing through scheduler and transformer, because it has no
    /// physical edges, whatever the scheduler decides.
    #[test]
    fn a_dead_agent_changes_nothing_through_the_learned_graph() {
        let mut params = Params::new(Device::Cpu);
        let scheduler = CommGraph::new(params.root(&mut Seed::new(3).rng()), WIDTH, WIDTH, 0.0);
        let network = transformer();
        let physical = silenced(4);
        let _ = physical.select(1, 4).fill_(0.0);
        let noise = uniform(&[3, AGENTS, AGENTS], 4) * 3.0;
        let f = uniform(&[3, AGENTS, WIDTH], 5).set_requires_grad(true);
        let run = |f: &Tensor| {
            let graph = scheduler.forward(
                &f.flatten(0, 1),
                &Packing::full(3, AGENTS),
                &physical,
                Some(&noise),
            );
            others(&messages(&network, f, &graph), 4)
        };
        let out = run(&f);
        assert!(out.equal(&run(&perturbed(&f.detach(), 4))));
        let mut inputs = vec![f.shallow_clone()];
        inputs.extend(params.named().iter().map(|(_, t)| t.shallow_clone()));
        let gradients =
            Tensor::run_backward(&[out.square().sum(Kind::Float)], &inputs, false, false);
        assert_eq!(gradients[0].select(1, 4).abs().max().double_value(&[]), 0.0);
        assert!(
            gradients[1..].iter().all(|g| g.abs().max().double_value(&[]) > 0.0),
            "the scheduler is trained"
        );
    }

    /// Edges that the scheduler closes have a gradient, unless they are physically impossible.
    #[test]
    fn closed_edges_have_a_gradient_where_they_are_possible() {
        let scheduler_gradient = |physical: &Tensor| {
            let mut params = Params::new(Device::Cpu);
            let scheduler = CommGraph::new(params.root(&mut Seed::new(3).rng()), WIDTH, WIDTH, 0.0);
            let network = transformer();
            let f = uniform(&[3, AGENTS, WIDTH], 5);
            // Far below zero: no edge is sampled, though the soft sample is slightly above 0.
            let noise = Tensor::full([3, AGENTS, AGENTS], -20.0, (Kind::Float, Device::Cpu));
            let graph = scheduler.forward(
                &f.flatten(0, 1),
                &Packing::full(3, AGENTS),
                physical,
                Some(&noise),
            );
            let eye =
                Tensor::eye(AGENTS, (Kind::Float, Device::Cpu)).expand([3, AGENTS, AGENTS], false);
            assert!(graph.equal(&eye), "all edges are closed");
            messages(&network, &f, &graph).square().sum(Kind::Float).backward();
            let named = params.named();
            let largest = named.iter().map(|(_, t)| t.grad()).filter(Tensor::defined);
            largest.map(|grad| grad.abs().max().double_value(&[])).fold(0.0, f64::max)
        };
        assert!(
            scheduler_gradient(&Tensor::ones([3, AGENTS, AGENTS], (Kind::Float, Device::Cpu)))
                > 0.0
        );
        let alone = Tensor::eye(AGENTS, (Kind::Float, Device::Cpu))
            .expand([3, AGENTS, AGENTS], false)
            .contiguous();
        assert_eq!(scheduler_gradient(&alone), 0.0);
    }

    /// Leaving absent agents out of the layers changes nothing for the agents that are present.
    #[test]
    fn packed_agents_send_the_same_messages() {
        let network = transformer();
        let mut present = Tensor::ones([3, AGENTS], (Kind::Float, Device::Cpu));
        let _ = present.get(0).get(2).fill_(0.0);
        let _ = present.get(2).narrow(0, 0, 2).fill_(0.0);
        let graph =
            crate::nn::graph::with_self_loops(&(present.unsqueeze(1) * present.unsqueeze(2)));
        let f = uniform(&[3, AGENTS, WIDTH], 5);
        let packing = Packing::of(&present);
        let packed = packing.unpack(&network.forward(
            &packing.pack(&f),
            &packing,
            &Graph::Full(graph.shallow_clone()),
        ));
        let all = messages(&network, &f, &graph) * present.unsqueeze_(-1);
        assert!((packed - all).abs().max().double_value(&[]) < 1e-5);
    }
}
