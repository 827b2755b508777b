//! Transformers over the agents of a world as a sequence: attention from one sequence to another,
//! and the decoder in which each agent reads the actions of the agents before it (MAT, Wen et al.
//! 2022, PKU-MARL/Multi-Agent-Transformer, `ma_transformer.py`). With relations, the decoder is
//! that of CommFormer (Hu et al. 2024, charleshsc/CommFormer, `cformer.py`).

use tch::{Kind, Tensor};

use super::attention::{graph_softmax, softmax};
use super::transformer::FeedForward;
use super::{Activation, Init, Layer, LayerNorm, Linear, Path};

/// Which agent attends to which, among the N agents of B worlds.
#[derive(Debug)]
pub struct Reach {
    bias: Tensor,
    /// A learned graph, and the kind of relation of each pair (0 or 1), both `[B, 1, Q, N]`.
    graph: Option<(Tensor, Tensor)>,
}

impl Reach {
    /// Creates a reach in which an agent attends to those for which `seen: [B, N, N]` (row =
    /// reader) is above 0.5. Every agent must attend to at least one agent, usually itself.
    pub fn of(seen: &Tensor) -> Self {
        let bias =
            seen.zeros_like().masked_fill(&seen.le(0.5), f64::NEG_INFINITY).unsqueeze(1).detach();
        Self { bias, graph: None }
    }

    /// Creates a reach over a learned graph `[B, N, N]` of 0 and 1 (row = reader), whose edges have
    /// gradients whether they are open or closed. `relation: [B, N, N]` (0 or 1) is the kind of
    /// relation of each pair, for attention with relations.
    pub fn over(graph: &Tensor, relation: &Tensor) -> Self {
        let graph = graph.unsqueeze(1);
        Self {
            bias: graph.zeros_like().detach(),
            graph: Some((graph, relation.detach().unsqueeze(1))),
        }
    }

    /// Returns this reach without the agents that come later in the sequence than the reader.
    #[must_use]
    pub fn causal(&self) -> Self {
        let later = Tensor::ones_like(&self.bias).triu(1).gt(0.5);
        let graph =
            self.graph.as_ref().map(|(graph, relation)| (graph.tril(0), relation.shallow_clone()));
        Self { bias: self.bias.masked_fill(&later, f64::NEG_INFINITY), graph }
    }

    /// Returns the tensor that is added to attention logits, `[B, 1, Q, N]`: 0 where a key is seen,
    /// minus infinity elsewhere. A learned graph acts in addition to it.
    pub fn bias(&self) -> &Tensor {
        &self.bias
    }

    /// Returns the reach of agent `i` alone, among the agents of the sequence up to `i` itself.
    #[must_use]
    pub fn up_to(&self, i: i64) -> Self {
        let cut = |x: &Tensor| x.narrow(2, i, 1).narrow(3, 0, i + 1);
        Self {
            bias: cut(&self.bias),
            graph: self.graph.as_ref().map(|(graph, relation)| (cut(graph), cut(relation))),
        }
    }
}

/// Keys and values of a sequence, each `[B, heads, N, d]`.
#[derive(Debug)]
pub struct KeysValues(Tensor, Tensor);

impl KeysValues {
    fn join(&self, next: &Self) -> Self {
        let join = |a: &Tensor, b: &Tensor| Tensor::cat(&[a, b], 2);
        Self(join(&self.0, &next.0), join(&self.1, &next.1))
    }
}

/// Scaled dot-product attention from one sequence to another, optionally with relations: each pair
/// has one of two kinds of relation. The embedding of a kind yields one vector that is added to the
/// query and one that is added to the key.
#[derive(Debug)]
pub struct Attention {
    heads: i64,
    query: Linear,
    keys_values: Linear,
    out: Linear,
    relations: Option<Linear>,
}

impl Attention {
    /// Creates attention among sequences of `width` features, which `heads` must divide; with
    /// relations if `related`. All weights are drawn by `init`, biases are zero.
    ///
    /// # Panics
    /// If `heads` does not divide `width`.
    pub fn new(mut path: Path<'_>, width: i64, heads: i64, init: Init, related: bool) -> Self {
        assert!(
            heads > 0 && width % heads == 0,
            "{heads} attention heads do not divide a width of {width}"
        );
        Self {
            heads,
            query: Linear::new(path.sub("query"), width, width, init),
            keys_values: Linear::fused(path.sub("keys_values"), width, width, 2, init),
            out: Linear::new(path.sub("out"), width, width, init),
            relations: related.then(|| Linear::fused(path.sub("relations"), width, width, 2, init)),
        }
    }

    /// Reshapes `x: [B, T, heads · d]` to `[B, heads, T, d]`.
    fn split(&self, x: &Tensor) -> Tensor {
        let (batch, count, width) = x.size3().expect("sequences are [B, T, W]");
        x.view([batch, count, self.heads, width / self.heads]).transpose(1, 2)
    }

    /// Returns the keys and values of a sequence `[B, N, W]`, for queries that attend to it.
    pub fn keys_values(&self, x: &Tensor) -> KeysValues {
        let parts = self.keys_values.forward(x).chunk(2, -1);
        KeysValues(self.split(&parts[0].contiguous()), self.split(&parts[1].contiguous()))
    }

    /// Returns what `queries: [B, Q, W]` read from the sequence `among`, `[B, Q, W]`.
    /// `relations: [2, W]` are the embeddings of the two kinds of relation; attention without
    /// relations ignores them.
    pub fn forward(
        &self,
        queries: &Tensor,
        among: &KeysValues,
        reach: &Reach,
        relations: Option<&Tensor>,
    ) -> Tensor {
        let KeysValues(keys, values) = among;
        let query = self.split(&self.query.forward(queries));
        let scale = 1.0 / (query.size()[3] as f64).sqrt();
        let mut logits = (&query * scale).matmul(&keys.transpose(-2, -1));
        if let (Some(layer), Some(embeddings), Some((_, kinds))) =
            (&self.relations, relations, &reach.graph)
        {
            // (q + a)(k + b) for both kinds; each pair has one. The reference, too, scales twice.
            let both = layer.forward(embeddings).chunk(2, -1);
            let of = |kind: i64| {
                let part = |x: &Tensor| x.get(kind).view([self.heads, 1, -1]);
                let (a, b) = (part(&both[0]), part(&both[1]));
                let sum = |x: Tensor| x.sum_dim_intlist(-1, true, Kind::Float);
                sum(&query * &b) + sum(keys * &a).transpose(-2, -1) + sum(&a * &b)
            };
            let (none, one) = (of(0), of(1));
            logits = (logits + (&none + (one - &none) * kinds) * scale) * scale;
        }
        let logits = logits + &reach.bias;
        let weights = match &reach.graph {
            Some((graph, _)) => graph_softmax(&logits, graph),
            None => softmax(&logits),
        };
        let mixed = weights.matmul(values).transpose(1, 2);
        let (batch, count, heads, head) = mixed.size4().expect("[B, Q, heads, d]");
        self.out.forward(&mixed.reshape([batch, count, heads * head]))
    }
}

/// A block of the decoder: self-attention among the actions so far, attention from the agents'
/// representations to the result, then a perceptron for each agent.
#[derive(Debug)]
struct DecoderBlock {
    own: Attention,
    own_norm: LayerNorm,
    cross: Attention,
    cross_norm: LayerNorm,
    perceptron: FeedForward,
}

/// Keys and values of a block's two attentions for the agents decoded so far, if there are any.
type Remembered = Option<(KeysValues, KeysValues)>;

impl DecoderBlock {
    fn new(mut path: Path<'_>, width: i64, heads: i64, init: Init, related: bool) -> Self {
        Self {
            own: Attention::new(path.sub("own"), width, heads, init, related),
            own_norm: LayerNorm::new(path.sub("own_norm"), width),
            cross: Attention::new(path.sub("cross"), width, heads, init, related),
            cross_norm: LayerNorm::new(path.sub("cross_norm"), width),
            perceptron: FeedForward::of_mat(&mut path, width),
        }
    }

    /// Computes the next agents of a sequence, after those in `remembered`, and adds them to it.
    fn forward(
        &self,
        x: &Tensor,
        representation: &Tensor,
        reach: &Reach,
        relations: Option<&Tensor>,
        remembered: &mut Remembered,
    ) -> Tensor {
        let joined = |before: Option<&KeysValues>, next: KeysValues| match before {
            Some(before) => before.join(&next),
            None => next,
        };
        let own = joined(remembered.as_ref().map(|r| &r.0), self.own.keys_values(x));
        let x = self.own_norm.forward(&(x + self.own.forward(x, &own, reach, relations)));
        let cross = joined(remembered.as_ref().map(|r| &r.1), self.cross.keys_values(&x));
        let heard = self.cross.forward(representation, &cross, reach, relations);
        let x = self.cross_norm.forward(&(representation + heard));
        *remembered = Some((own, cross));
        self.perceptron.forward(&x)
    }
}

/// A decoder that decodes agents one after another: each agent reads the actions of the agents
/// before it and its own representation.
#[derive(Debug)]
pub struct TransformerDecoder {
    embed: Layer,
    blocks: Vec<DecoderBlock>,
    head: Layer,
    /// Embeddings of the two kinds of relation, `[2, W]`; `None` without relations.
    relations: Option<Tensor>,
}

/// Keys and values of all blocks for the agents decoded so far.
#[derive(Debug, Default)]
pub struct Decoded(Vec<Remembered>);

impl TransformerDecoder {
    /// Creates a decoder for actions of `actions` dimensions and representations of `width`
    /// features. Attention weights are orthogonal with gain 0.01 without relations (MAT), and
    /// normal with standard deviation 0.02 with relations (CommFormer).
    ///
    /// # Panics
    /// If the heads do not divide the width.
    pub fn new(
        mut path: Path<'_>,
        actions: i64,
        width: i64,
        blocks: usize,
        heads: i64,
        relations: Option<&Tensor>,
    ) -> Self {
        let init = if relations.is_some() { Init::Normal(0.02) } else { Init::Orthogonal(0.01) };
        let names = ["embed", "embed_norm"];
        let embed = Layer::new(&mut path, names, actions, width, Activation::Gelu);
        let mut below = path.sub("blocks");
        let blocks = (0..blocks)
            .map(|i| DecoderBlock::new(below.sub(i), width, heads, init, relations.is_some()))
            .collect();
        Self {
            embed,
            blocks,
            head: Layer::new(&mut path, ["head", "head_norm"], width, width, Activation::Gelu),
            relations: relations.map(Tensor::shallow_clone),
        }
    }

    /// Computes the next agents of a sequence, after those in `decoded`, and adds them to it.
    /// `previous: [B, Q, A]` is, for each agent, the action of the agent before it (zeros for the
    /// first agent, or if the agent does not listen to the one before it);
    /// `representation: [B, Q, W]` is the agent's own representation. Returns `[B, Q, W]` for the
    /// action head. Decoding all agents at once, with the actions that were taken, gives the same
    /// result as decoding one agent after another.
    pub fn forward(
        &self,
        previous: &Tensor,
        representation: &Tensor,
        reach: &Reach,
        decoded: &mut Decoded,
    ) -> Tensor {
        decoded.0.resize_with(self.blocks.len(), || None);
        let mut x = self.embed.forward(previous);
        for (block, remembered) in self.blocks.iter().zip(&mut decoded.0) {
            x = block.forward(&x, representation, reach, self.relations.as_ref(), remembered);
        }
        self.head.forward(&x)
    }
}

/// A block of CommFormer's encoder: attention with relations over the graph, then a perceptron with
/// a rectifier. Both are post-norm; weights are normal with standard deviation 0.02.
#[derive(Debug)]
pub struct RelationBlock {
    attention: Attention,
    attention_norm: LayerNorm,
    perceptron: FeedForward,
}

impl RelationBlock {
    /// Creates a block over agents of `width` features.
    ///
    /// # Panics
    /// If the heads do not divide the width.
    pub fn new(mut path: Path<'_>, width: i64, heads: i64) -> Self {
        let init = Init::Normal(0.02);
        Self {
            attention: Attention::new(path.sub("attention"), width, heads, init, true),
            attention_norm: LayerNorm::new(path.sub("attention_norm"), width),
            perceptron: FeedForward::new(&mut path, width, [init; 2], Activation::Relu),
        }
    }

    /// Maps agents `x: [B, N, W]` to the same shape. `relations: [2, W]` are the embeddings of the
    /// two kinds of relation.
    pub fn forward(&self, x: &Tensor, reach: &Reach, relations: &Tensor) -> Tensor {
        let among = self.attention.keys_values(x);
        let change = self.attention.forward(x, &among, reach, Some(relations));
        self.perceptron.forward(&self.attention_norm.forward(&(x + change)))
    }
}

#[cfg(test)]
mod tests {
    use tch::Device;

    use super::*;
    use crate::nn::Params;
    use crate::rng::Seed;

    const AGENTS: i64 = 5;

    fn uniform(shape: &[i64], seed: u64) -> Tensor {
        let values = Init::Uniform(1.0).sample(shape, &mut Seed::new(seed).rng());
        Tensor::from_slice(&values).view(shape)
    }

    /// Decoding all agents at once equals decoding one after another, and no agent depends on
    /// actions of later agents.
    #[test]
    fn at_once_is_one_after_another() {
        for related in [false, true] {
            let mut params = Params::new(Device::Cpu);
            let mut rng = Seed::new(1).rng();
            let table = related
                .then(|| params.root(&mut rng).create("relations", &[2, 8], Init::Normal(1.0)));
            let decoder = TransformerDecoder::new(
                params.root(&mut rng).sub("decoder"),
                2,
                8,
                2,
                2,
                table.as_ref(),
            );
            tch::no_grad(|| {
                for (name, tensor) in params.named() {
                    if name.ends_with("weight") && tensor.dim() == 2 {
                        let _ = tensor.shallow_clone().multiply_scalar_(8.0);
                    }
                }
            });
            let (actions, known) = (uniform(&[3, AGENTS, 2], 2), uniform(&[3, AGENTS, 8], 3));
            let seen = uniform(&[3, AGENTS, AGENTS], 4).gt(-0.3).to_kind(Kind::Float);
            let graph = crate::nn::graph::with_self_loops(&seen);
            let reach =
                if related { Reach::over(&graph, &seen) } else { Reach::of(&graph) }.causal();
            let all = decoder.forward(&actions, &known, &reach, &mut Decoded::default());
            let mut decoded = Decoded::default();
            for i in 0..AGENTS {
                let of = |x: &Tensor| x.narrow(1, i, 1);
                let one =
                    decoder.forward(&of(&actions), &of(&known), &reach.up_to(i), &mut decoded);
                assert!(
                    (one - of(&all)).abs().max().double_value(&[]) < 1e-5,
                    "{related} agent {i}"
                );
            }
            let later = actions.copy();
            let _ = later.select(1, 3).fill_(9.0);
            let other = decoder.forward(&later, &known, &reach, &mut Decoded::default());
            assert!(other.narrow(1, 0, 3).equal(&all.narrow(1, 0, 3)));
            assert!(!other.select(1, 3).equal(&all.select(1, 3)));
        }
    }
}
