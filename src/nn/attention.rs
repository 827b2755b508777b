//! Multi-head self-attention with masks, for the entity encoder and the message transformer.

use tch::{Kind, Tensor};

use super::{Init, Linear, Neighbours, Packing, Path};

/// A mask on attention with logits `[B, heads, T, T]`.
#[derive(Debug, Clone, Copy)]
pub enum Mask<'a> {
    /// Added to the logits: 0 for a key that is seen, minus infinity for a key that is not. The
    /// tensor broadcasts to the shape of the logits. Every row needs at least one key that is seen.
    Add(&'a Tensor),
    /// A graph `[B, 1, Q, T]` of 0 and 1, by which the weights are multiplied before they are
    /// normalised (`graph_softmax`).
    Graph(&'a Tensor),
    /// Edges `[P, K]` of 0 and 1 to the agents that each of the P tokens can hear. Every token also
    /// has an open edge to itself.
    Listed(&'a Neighbours, &'a Tensor),
}

/// Scaled dot-product self-attention. Queries, keys and values come from one fused linear layer.
#[derive(Debug)]
pub struct SelfAttention {
    heads: i64,
    qkv: Linear,
    out: Linear,
}

impl SelfAttention {
    /// Creates a layer over tokens of `width` features, which `heads` must divide. All weights are
    /// drawn by `init`, biases are zero.
    ///
    /// # Panics
    /// If `heads` does not divide `width`.
    pub fn new(mut path: Path<'_>, width: i64, heads: i64, init: Init) -> Self {
        assert!(
            heads > 0 && width % heads == 0,
            "{heads} attention heads do not divide a width of {width}"
        );
        let qkv = Linear::fused(path.sub("qkv"), width, width, 3, init);
        SelfAttention { heads, qkv, out: Linear::new(path.sub("out"), width, width, init) }
    }

    /// Maps tokens `x: [P, width]` of the occupied slots of a packing to the same shape. The mask
    /// must exclude empty slots.
    pub fn forward(&self, x: &Tensor, packing: &Packing, mask: Mask<'_>) -> Tensor {
        if let Mask::Listed(neighbours, edges) = mask {
            return self.forward_listed(x, neighbours, edges);
        }
        let [queries, keys, values] = self.project(&packing.unpack(&self.qkv.forward(x)));
        self.out.forward(&packing.pack(&Self::mix(&queries, &keys, &values, mask)))
    }

    /// Computes [`SelfAttention::forward`] over [`Mask::Listed`].
    fn forward_listed(&self, x: &Tensor, neighbours: &Neighbours, edges: &Tensor) -> Tensor {
        let (tokens, most) = neighbours.size();
        let qkv = self.qkv.forward(x).view([tokens, 3, -1]).unbind(1);
        let head = qkv[0].size()[1] / self.heads;
        let heard = |x: &Tensor| {
            neighbours.of_self_and_senders(x).view([tokens, 1 + most, self.heads, head])
        };
        let queries = qkv[0].view([tokens, 1, self.heads, head]) * (1.0 / (head as f64).sqrt());
        let logits = (heard(&qkv[1]) * queries).sum_dim_intlist(-1, false, Kind::Float);
        let graph =
            Tensor::cat(&[&edges.new_ones([tokens, 1], (Kind::Float, edges.device())), edges], 1);
        let weights = graph_softmax(&logits.transpose(1, 2), &graph.unsqueeze(1)).transpose(1, 2);
        let mixed = heard(&qkv[2]) * weights.unsqueeze(-1);
        let mixed = mixed.sum_dim_intlist(1, false, Kind::Float);
        self.out.forward(&mixed.view([tokens, -1]))
    }

    /// Computes [`SelfAttention::forward`] for one token of each row, where every slot is occupied:
    /// maps `x: [B, T, width]` to `[B, width]` for the tokens in the slots `place: [B]`. The mask
    /// has one row, `[B, 1, 1, T]`.
    pub fn forward_one(&self, x: &Tensor, place: &Tensor, mask: Mask<'_>) -> Tensor {
        let (batch, tokens, _) = x.size3().expect("tokens are [B, T, width]");
        let [queries, keys, values] =
            self.project(&self.qkv.forward(&x.flatten(0, 1)).view([batch, tokens, -1]));
        let index =
            place.view([batch, 1, 1, 1]).expand([batch, self.heads, 1, queries.size()[3]], false);
        let mixed = Self::mix(&queries.gather(2, &index, false), &keys, &values, mask);
        self.out.forward(&mixed.squeeze_dim(1))
    }

    /// Splits `[B, T, 3 · width]` into queries, keys and values, each `[B, heads, T, d]`.
    fn project(&self, qkv: &Tensor) -> [Tensor; 3] {
        let (batch, tokens, width) =
            qkv.size3().expect("queries, keys and values are [B, T, 3 · width]");
        let split = qkv
            .view([batch, tokens, 3, self.heads, width / (3 * self.heads)])
            .permute([2, 0, 3, 1, 4]);
        split.unbind(0).try_into().expect("three of them")
    }

    /// Returns what `queries: [B, heads, Q, d]` read, `[B, Q, width]`, before the output layer.
    fn mix(queries: &Tensor, keys: &Tensor, values: &Tensor, mask: Mask<'_>) -> Tensor {
        let (batch, heads, count, head) = queries.size4().expect("queries are [B, heads, Q, d]");
        let logits = (queries * (1.0 / (head as f64).sqrt())).matmul(&keys.transpose(-2, -1));
        let weights = match mask {
            Mask::Add(bias) => softmax(&(logits + bias)),
            Mask::Graph(graph) => graph_softmax(&logits, graph),
            Mask::Listed(..) => unreachable!("lists have attention of their own"),
        };
        weights.matmul(values).transpose(1, 2).reshape([batch, count, heads * head])
    }
}

/// Returns attention weights over a graph G of 0 and 1, normalised over the last dimension:
/// `G_ij exp(logit_ij) / Σ_k G_ik exp(logit_ik)`. Every row needs an open edge.
///
/// A closed edge has weight 0 exactly, whatever its logit, but it has a gradient. For the output
/// `out_i = Σ_j weight_ij v_j` it is `∂out_i/∂G_ij = exp(logit_ij) (v_j - out_i) / Σ`, so that a
/// learned graph is trained on what opening an edge would change. Edges that are physically
/// impossible get no gradient if the graph is a product with the physical mask.
pub(super) fn graph_softmax(logits: &Tensor, graph: &Tensor) -> Tensor {
    /// Largest logit of a closed edge above the strongest open one; a limit prevents overflow.
    const MOST: f64 = 9.0;
    let top = tch::no_grad(|| logits.masked_fill(&graph.le(0.5), f64::NEG_INFINITY).amax(-1, true));
    let exponentials = (logits - top).clamp_max(MOST).exp() * graph;
    &exponentials / exponentials.sum_dim_intlist(-1, true, Kind::Float)
}

/// Softmax over the last dimension. For rows of fewer than 16 keys, libtorch's own softmax takes
/// about twice as long as elementwise operations; from 16 keys on, which fill a vector register, a
/// fifth of their time.
pub(super) fn softmax(logits: &Tensor) -> Tensor {
    if logits.size().last().is_some_and(|&keys| keys >= 16) {
        return logits.softmax(-1, Kind::Float);
    }
    let top = tch::no_grad(|| logits.amax(-1, true));
    let exponentials = (logits - top).exp();
    &exponentials / exponentials.sum_dim_intlist(-1, true, Kind::Float)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nn::Params;
    use crate::rng::Seed;

    /// Short and long rows, which use different code, follow one formula; masked keys have no
    /// weight.
    #[test]
    fn softmax_is_one_formula_for_short_and_long_rows_and_cut_keys_have_no_part_in_it() {
        for keys in [2, 15, 16, 17, 48] {
            let draw = |seed: u64| {
                let values = Init::Uniform(5.0).sample(&[6, keys], &mut Seed::new(seed).rng());
                Tensor::from_slice(&values).view([6, keys])
            };
            // Some keys of each row are masked, but never the first.
            let cut = draw(keys as u64).gt(1.0);
            let _ = cut.select(1, 0).fill_(0.0);
            let logits = draw(1).set_requires_grad(true);
            let found = softmax(&(&logits + cut.to_kind(Kind::Float) * -1e30));

            let weights = logits.detach().to_kind(Kind::Double).exp()
                * cut.logical_not().to_kind(Kind::Double);
            let expected = &weights / weights.sum_dim_intlist(-1, true, Kind::Double);
            let worst = (&found - &expected).abs().max().double_value(&[]);
            assert!(worst < 1e-6, "{keys} keys: {worst}");
            assert_eq!(
                found.masked_select(&cut).abs().sum(Kind::Float).double_value(&[]),
                0.0,
                "{keys} keys"
            );

            let along = draw(2);
            (&found * &along).sum(Kind::Float).backward();
            let mean = (&expected * &along).sum_dim_intlist(-1, true, Kind::Double);
            let worst = (logits.grad() - expected * (along - mean)).abs().max().double_value(&[]);
            assert!(worst < 1e-5, "gradient, {keys} keys: {worst}");
            assert_eq!(
                logits.grad().masked_select(&cut).abs().sum(Kind::Float).double_value(&[]),
                0.0
            );
        }
    }

    #[test]
    fn closed_edges_have_no_weight_and_the_gradient_of_the_formula() {
        for keys in [5, 20] {
            let draw = |seed: u64, width: i64| {
                let values = Init::Uniform(2.0).sample(&[keys, width], &mut Seed::new(seed).rng());
                Tensor::from_slice(&values).view([keys, width])
            };
            let graph = draw(1, keys).gt(0.0).to_kind(Kind::Float);
            let _ = graph.diagonal(0, 0, 1).fill_(1.0);
            let graph = graph.set_requires_grad(true);
            let (logits, values, along) = (draw(2, keys), draw(3, 4), draw(4, 4));
            let weights = graph_softmax(&logits, &graph);
            let closed = graph.detach().lt(0.5);
            assert_eq!(
                weights.masked_select(&closed).abs().sum(Kind::Float).double_value(&[]),
                0.0
            );
            let other = logits.where_self(&closed.logical_not(), &(&logits * 3.0 - 1.0));
            assert!(
                graph_softmax(&other, &graph).equal(&weights),
                "a closed edge's logit changes nothing"
            );
            assert!(
                (&weights - softmax(&logits.masked_fill(&closed, -1e30)))
                    .abs()
                    .max()
                    .double_value(&[])
                    < 1e-6
            );

            let out = weights.matmul(&values);
            (&out * &along).sum(Kind::Float).backward();
            let sum = (logits.exp() * graph.detach()).sum_dim_intlist(-1, true, Kind::Float);
            let change = values.matmul(&along.transpose(0, 1)).transpose(0, 1);
            let mean = (out.detach() * &along).sum_dim_intlist(-1, true, Kind::Float);
            let expected = logits.exp() / sum * (change - mean);
            let worst = (graph.grad() - &expected).abs().max().double_value(&[]);
            assert!(worst < 1e-4, "{keys}: {worst}");
            assert!(
                graph.grad().masked_select(&closed).abs().min().double_value(&[]) > 0.0,
                "closed ones too"
            );
        }
    }

    /// A masked key changes nothing in rows that are long enough for libtorch's softmax.
    #[test]
    fn a_cut_key_changes_nothing_among_many() {
        let layer = SelfAttention::new(
            Params::new(tch::Device::Cpu).root(&mut Seed::new(3).rng()),
            8,
            2,
            Init::Orthogonal(1.0),
        );
        let x = Tensor::from_slice(&Init::Uniform(1.0).sample(&[20, 8], &mut Seed::new(4).rng()))
            .view([20, 8]);
        let bias = Tensor::zeros([1, 1, 20, 20], (Kind::Float, tch::Device::Cpu));
        let _ = bias.select(3, 7).fill_(-1e30);
        let read = |x: &Tensor| layer.forward(x, &Packing::full(1, 20), Mask::Add(&bias));
        let (before, other) = (read(&x), x.copy());
        let _ = other.get(7).fill_(50.0);
        let after = read(&other);
        assert!(before.narrow(0, 0, 7).equal(&after.narrow(0, 0, 7)));
        assert!(before.narrow(0, 8, 12).equal(&after.narrow(0, 8, 12)));
        assert!(!before.get(7).equal(&after.get(7)), "its own queries do change");
    }
}
