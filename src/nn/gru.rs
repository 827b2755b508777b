//! A gated recurrent unit whose memory can be reset within a sequence.
//!
//! Gate order and equations are those of PyTorch's `nn.GRUCell`. The memory is multiplied by a mask
//! before every step, as in MAPPO's reference code, so that a trajectory starts from zero memory
//! wherever it begins in a sequence.

use tch::Tensor;

use super::{Init, Path};

/// One gated recurrent layer. Weights are orthogonal with gain 1, biases are zero.
#[derive(Debug)]
pub struct Gru {
    hidden: i64,
    weight_ih: Tensor,
    weight_hh: Tensor,
    bias_ih: Tensor,
    bias_hh: Tensor,
}

impl Gru {
    /// Creates a layer from `inputs` features to a memory of `hidden` features.
    pub fn new(mut path: Path<'_>, inputs: i64, hidden: i64) -> Self {
        Gru {
            hidden,
            weight_ih: path.create("weight_ih", &[3 * hidden, inputs], Init::Orthogonal(1.0)),
            weight_hh: path.create("weight_hh", &[3 * hidden, hidden], Init::Orthogonal(1.0)),
            bias_ih: path.create("bias_ih", &[3 * hidden], Init::Zeros),
            bias_hh: path.create("bias_hh", &[3 * hidden], Init::Zeros),
        }
    }

    /// Computes one step: maps `x: [B, inputs]`, memory `h: [B, H]` and `mask: [B, 1]` (0 where a
    /// trajectory begins, else 1) to the new memory `[B, H]`, which is also the output.
    pub fn step(&self, x: &Tensor, h: &Tensor, mask: &Tensor) -> Tensor {
        self.advance(&x.linear(&self.weight_ih, Some(&self.bias_ih)), h, mask)
    }

    /// Computes all steps of `x: [L, B, inputs]` from the memory `h0: [B, H]` with
    /// `mask: [L, B, 1]`, and returns the memory after each step, `[L, B, H]`. The result equals
    /// `L` calls of [`Gru::step`]. Gradients flow through time except where the mask is 0.
    pub fn sequence(&self, x: &Tensor, h0: &Tensor, mask: &Tensor) -> Tensor {
        let inputs = x.linear(&self.weight_ih, Some(&self.bias_ih)).unbind(0);
        let mut outputs: Vec<Tensor> = Vec::with_capacity(inputs.len());
        for (input, mask) in inputs.iter().zip(mask.unbind(0)) {
            let next = self.advance(input, outputs.last().unwrap_or(h0), &mask);
            outputs.push(next);
        }
        Tensor::stack(&outputs, 0)
    }

    /// Computes a step from its input part `W_i x + b_i: [B, 3H]`.
    fn advance(&self, input: &Tensor, h: &Tensor, mask: &Tensor) -> Tensor {
        let sizes = [2 * self.hidden, self.hidden];
        let h = h * mask;
        let memory = h.linear(&self.weight_hh, Some(&self.bias_hh));
        let (input, memory) = (input.split_with_sizes(sizes, 1), memory.split_with_sizes(sizes, 1));
        let gates = (&input[0] + &memory[0]).sigmoid().chunk(2, 1);
        let (reset, update) = (&gates[0], &gates[1]);
        let candidate = (&input[1] + reset * &memory[1]).tanh();
        &candidate + update * (h - &candidate)
    }
}

#[cfg(test)]
mod tests {
    use tch::{Device, Kind};

    use super::*;
    use crate::nn::Params;
    use crate::rng::Seed;

    fn ramp(shape: &[i64], scale: f64) -> Tensor {
        let count: i64 = shape.iter().product();
        (Tensor::arange(count, (Kind::Float, Device::Cpu)) * scale).sin().view(shape)
    }

    #[test]
    fn a_sequence_is_its_steps_and_a_zero_mask_forgets() {
        let mut params = Params::new(Device::Cpu);
        let gru = Gru::new(params.root(&mut Seed::new(4).rng()), 3, 6);
        let (x, h0) = (ramp(&[5, 2, 3], 0.7), ramp(&[2, 6], 1.3).set_requires_grad(true));
        let mask = Tensor::ones([5, 2, 1], (Kind::Float, Device::Cpu));
        let _ = mask.get(2).get(0).fill_(0.0);
        let all = gru.sequence(&x, &h0, &mask);
        let mut h = h0.shallow_clone();
        for t in 0..5 {
            h = gru.step(&x.get(t), &h, &mask.get(t));
            assert!(h.allclose(&all.get(t), 1e-6, 1e-6, false));
        }
        // The first batch entry starts anew at step 2 and depends on no earlier step.
        let fresh = gru.sequence(
            &x.narrow(0, 2, 3),
            &h0.zeros_like(),
            &Tensor::ones([3, 2, 1], (Kind::Float, Device::Cpu)),
        );
        assert!(all.narrow(0, 2, 3).select(1, 0).equal(&fresh.select(1, 0)));
        assert!(!all.narrow(0, 2, 3).select(1, 1).equal(&fresh.select(1, 1)));
        let gradient =
            Tensor::run_backward(&[all.get(4).sum(Kind::Float)], &[&h0], false, false).remove(0);
        assert_eq!(gradient.get(0).abs().max().double_value(&[]), 0.0);
        assert!(gradient.get(1).abs().max().double_value(&[]) > 0.0);
    }
}
