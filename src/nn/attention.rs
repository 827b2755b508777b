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
        let ((batch, tokens), width) = (packing.size(), x.size()[1]);
        let head = width / self.heads;
        let qkv = packing.unpack(&self.qkv.forward(x));
        let qkv = qkv.view([batch, tokens, 3, self.heads, head]).permute([2, 0, 3, 1, 4]).unbind(0);
        let scaled = &qkv[0] * (1.0 / (head as f64).sqrt());
        let logits = scaled.matmul(&qkv[1].transpose(-2, -1));
        let logits = match mask {
            Mask::Add(bias) => logits + bias,
            Mask::Multiply(factor) => logits * factor,
        };
        let mixed = softmax(&logits).matmul(&qkv[2]);
        self.out.forward(&packing.pack(&mixed.transpose(1, 2).reshape([batch, tokens, width])))
    }
}

/// Softmax over the last dimension from elementwise operations. libtorch's own takes several times as long on rows of a
/// dozen keys, where it was the dearest part of an encoder.
pub(super) fn softmax(logits: &Tensor) -> Tensor {
    let top = tch::no_grad(|| logits.amax(-1, true));
    let exponentials = (logits - top).exp();
    &exponentials / exponentials.sum_dim_intlist(-1, true, Kind::Float)
}
