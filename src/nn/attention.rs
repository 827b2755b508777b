//! Multi-head self attention with masks, shared by the entity encoder and the message transformer.

use tch::{Kind, Tensor};

use super::{Init, Linear, Packing, Path};

/// What is done to the attention logits `[B, heads, T, T]` before the softmax.
#[derive(Debug, Clone, Copy)]
pub enum Mask<'a> {
    /// Added: 0 for a key that is seen, minus infinity for one that is not. Broadcast to the shape of the logits. Every
    /// row needs at least one key that is seen.
    Add(&'a Tensor),
    /// Multiplied: a key with factor 0 keeps the logit 0, hence still gets weight.
    Multiply(&'a Tensor),
}

/// Scaled dot-product self attention; queries, keys and values come from one fused linear layer.
#[derive(Debug)]
pub struct SelfAttention {
    heads: i64,
    qkv: Linear,
    out: Linear,
}

impl SelfAttention {
    /// A layer over tokens of `width` features, which `heads` must divide; all weights drawn by `init`, zero biases.
    ///
    /// # Panics
    /// If `heads` does not divide `width`.
    pub fn new(mut path: Path<'_>, width: i64, heads: i64, init: Init) -> Self {
        assert!(heads > 0 && width % heads == 0, "{heads} attention heads do not divide a width of {width}");
        let qkv = Linear::fused(path.sub("qkv"), width, width, 3, init);
        SelfAttention { heads, qkv, out: Linear::new(path.sub("out"), width, width, init) }
    }

    /// Tokens `x: [P, width]` of the rows of a packing to the same shape. What stands in empty places must be masked.
    pub fn forward(&self, x: &Tensor, packing: &Packing, mask: Mask<'_>) -> Tensor {
        let (batch, tokens) = packing.size();
        let [queries, keys, values] = self.project(&packing.unpack(&self.qkv.forward(x)));
        let mixed = Self::mix(&queries, &keys, &values, mask);
        self.out.forward(&packing.pack(&mixed.view([batch, tokens, -1])))
    }

    /// As [`SelfAttention::forward`] where every place is filled, for one token of each row alone: `x: [B, T, width]`, of which
    /// `place: [B]` asks, to `[B, width]`; the mask has one row, `[B, 1, 1, T]`.
    pub fn forward_one(&self, x: &Tensor, place: &Tensor, mask: Mask<'_>) -> Tensor {
        let (batch, tokens, _) = x.size3().expect("tokens are [B, T, width]");
        let [queries, keys, values] = self.project(&self.qkv.forward(&x.flatten(0, 1)).view([batch, tokens, -1]));
        let asks = place.view([batch, 1, 1, 1]).expand([batch, self.heads, 1, queries.size()[3]], false);
        let mixed = Self::mix(&queries.gather(2, &asks, false), &keys, &values, mask);
        self.out.forward(&mixed.squeeze_dim(1))
    }

    /// Queries, keys and values, each `[B, heads, T, d]`, of `[B, T, 3 · width]`.
    fn project(&self, qkv: &Tensor) -> [Tensor; 3] {
        let (batch, tokens, width) = qkv.size3().expect("queries, keys and values are [B, T, 3 · width]");
        let split = qkv.view([batch, tokens, 3, self.heads, width / (3 * self.heads)]).permute([2, 0, 3, 1, 4]);
        [split.get(0), split.get(1), split.get(2)]
    }

    /// What `queries: [B, heads, Q, d]` read, `[B, Q, width]`.
    fn mix(queries: &Tensor, keys: &Tensor, values: &Tensor, mask: Mask<'_>) -> Tensor {
        let (batch, heads, count, head) = queries.size4().expect("queries are [B, heads, Q, d]");
        let logits = (queries * (1.0 / (head as f64).sqrt())).matmul(&keys.transpose(-2, -1));
        let logits = match mask {
            Mask::Add(bias) => logits + bias,
            Mask::Multiply(factor) => logits * factor,
        };
        softmax(&logits).matmul(values).transpose(1, 2).reshape([batch, count, heads * head])
    }
}

/// Softmax over the last dimension from elementwise operations. libtorch's own takes several times as long on rows of a
/// dozen keys, where it was the dearest part of an encoder.
pub(super) fn softmax(logits: &Tensor) -> Tensor {
    let top = tch::no_grad(|| logits.amax(-1, true));
    let exponentials = (logits - top).exp();
    &exponentials / exponentials.sum_dim_intlist(-1, true, Kind::Float)
}
