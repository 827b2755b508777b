//! The monotonic mixer of QMIX (Rashid et al. 2018; marlbenchmark/off-policy, `q_mixer.py`), for
//! any number of agents.

use tch::{Kind, Tensor};

use super::{Init, Linear, Path};

/// Width of the mixing layer.
const MIXED: i64 = 32;
/// Width of the hypernetworks' hidden layers.
const HYPER: i64 = 64;

/// A team value that increases with the value of each agent: two layers with an ELU in between,
/// whose weights are absolute values of the outputs of hypernetworks over the state. Unlike in the
/// reference, an agent's weights come from its own view of the state, by the same hypernetwork for
/// all agents, and everything that belongs to the team is a mean over its agents. So any number of
/// agents may be present.
#[derive(Debug)]
pub struct Mixer {
    weights: [Linear; 2],
    shift: Linear,
    out_weights: [Linear; 2],
    offset: [Linear; 2],
}

impl Mixer {
    /// Creates a mixer for state views with `inputs` features; weights are orthogonal with gain 1.
    pub fn new(mut path: Path<'_>, inputs: i64) -> Self {
        let mut layer = |name: &str, inputs, outputs| {
            Linear::new(path.sub(name), inputs, outputs, Init::Orthogonal(1.0))
        };
        Self {
            weights: [layer("weights.0", inputs, HYPER), layer("weights.1", HYPER, MIXED)],
            shift: layer("shift", inputs, MIXED),
            out_weights: [
                layer("out_weights.0", inputs, HYPER),
                layer("out_weights.1", HYPER, MIXED),
            ],
            offset: [layer("offset.0", inputs, HYPER), layer("offset.1", HYPER, 1)],
        }
    }

    /// Maps values `[B, N]`, each agent's view of the state `[B, N, S]` and the agents' presence
    /// `[B, N]` (0 or 1) to the team's value `[B]`.
    pub fn forward(&self, values: &Tensor, state: &Tensor, present: &Tensor) -> Tensor {
        let two = |[first, second]: &[Linear; 2]| second.forward(&first.forward(state).relu());
        let there = present.unsqueeze(-1);
        let count = there.sum_dim_intlist(1, false, Kind::Float).clamp_min(1.0);
        let sum = |x: Tensor| (x * &there).sum_dim_intlist(1, false, Kind::Float);
        let mean = |x: Tensor| sum(x) / &count;
        let mixed =
            sum(two(&self.weights).abs() * values.unsqueeze(-1)) + mean(self.shift.forward(state));
        let out = (mixed.elu() * mean(two(&self.out_weights)).abs()).sum_dim_intlist(
            -1,
            false,
            Kind::Float,
        );
        out + mean(two(&self.offset)).squeeze_dim(-1)
    }
}

#[cfg(test)]
mod tests {
    use tch::Device;

    use super::*;
    use crate::nn::Params;
    use crate::rng::Seed;

    fn uniform(shape: &[i64], seed: u64) -> Tensor {
        let values = Init::Uniform(2.0).sample(shape, &mut Seed::new(seed).rng());
        Tensor::from_slice(&values).view(shape)
    }

    #[test]
    fn the_team_gains_when_anyone_there_does() {
        let mixer = Mixer::new(Params::new(Device::Cpu).root(&mut Seed::new(1).rng()), 3);
        let (values, state) =
            (uniform(&[50, 4], 2).set_requires_grad(true), uniform(&[50, 4, 3], 3));
        let present = uniform(&[50, 4], 4).gt(-1.0).to_kind(Kind::Float);
        let team = mixer.forward(&values, &state, &present);
        let gradient =
            Tensor::run_backward(&[team.sum(Kind::Float)], &[&values], false, false).remove(0);
        assert!(gradient.ge(0.0).all().int64_value(&[]) != 0);
        let gone: Tensor = 1.0 - &present;
        assert_eq!(
            (&gradient * gone).abs().max().double_value(&[]),
            0.0,
            "absent agents do not count"
        );
        assert!(gradient.gt(0.0).to_kind(Kind::Float).mean(Kind::Float).double_value(&[]) > 0.5);
    }
}
