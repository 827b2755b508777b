//! The Adam optimiser, with access to its state.
//!
//! libtorch's optimisers cannot be saved from tch, so a resumed run would differ from an
//! uninterrupted one. [`Adam`] keeps parameters, gradients and moments as flat tensors, so that
//! clipping and a step take a handful of operations for any number of parameters. The gradients of
//! the parameters are views of the flat gradient, into which `loss.backward()` accumulates.

use tch::{Kind, Tensor};

use super::params::{match_by_name, views};
use super::{Error, Params};

/// Coefficients of [`Adam`]. The learning rate is passed at each step instead.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AdamConfig {
    /// Decay rate of the running mean of the gradients.
    pub beta1: f64,
    /// Decay rate of the running mean of the squared gradients.
    pub beta2: f64,
    /// Constant that is added to the square root of the second moment.
    pub eps: f64,
}

impl AdamConfig {
    /// The coefficients of MAPPO's reference code.
    pub const MAPPO: Self = AdamConfig { beta1: 0.9, beta2: 0.999, eps: 1e-5 };
    /// PyTorch's default coefficients.
    pub const TORCH: Self = AdamConfig { eps: 1e-8, ..Self::MAPPO };
}

/// Adam (Kingma and Ba 2015) with PyTorch's bias correction, over all parameters of one store.
#[derive(Debug)]
pub struct Adam {
    config: AdamConfig,
    names: Vec<String>,
    shapes: Vec<Vec<i64>>,
    weights: Tensor,
    gradient: Tensor,
    /// Gradients of the replicas, which are added to `gradient` before it is used.
    others: Vec<Tensor>,
    first: Tensor,
    second: Tensor,
    steps: i64,
}

impl Adam {
    /// Creates an optimiser of `params` with MAPPO's coefficients. It flattens the parameters, so
    /// the network must be complete.
    ///
    /// # Panics
    /// If there are no parameters (a bug).
    pub fn new(params: &mut Params) -> Self {
        Adam::with_config(params, AdamConfig::MAPPO)
    }

    /// Creates an optimiser as [`Adam::new`] does, with the coefficients `config`.
    ///
    /// # Panics
    /// If there are no parameters (a bug).
    pub fn with_config(params: &mut Params, config: AdamConfig) -> Self {
        let weights = params.flatten();
        Adam {
            config,
            names: params.named().iter().map(|(name, _)| name.clone()).collect(),
            shapes: params.shapes(),
            gradient: flat_gradient(params, &weights),
            others: Vec::new(),
            first: weights.zeros_like(),
            second: weights.zeros_like(),
            weights,
            steps: 0,
        }
    }

    /// Makes `params`, the parameters of a second copy of the network, share the weights of the
    /// first. The copy has its own gradients, so that both copies can be differentiated at the same
    /// time; [`Adam::clip_grad_norm`] and [`Adam::step`] add the gradients up in the order of the
    /// copies.
    ///
    /// # Panics
    /// If `params` are the parameters of another network (a bug).
    pub fn replica(&mut self, params: &mut Params) {
        assert!(params.shapes() == self.shapes, "a replica is of another network");
        params.share(&self.weights);
        self.others.push(flat_gradient(params, &self.weights));
    }

    /// Returns all weights that the optimiser updates, `[count]`.
    pub fn weights(&self) -> &Tensor {
        &self.weights
    }

    /// Sets the gradient to zero. [`Adam::step`] also does this.
    pub fn zero_grad(&mut self) {
        self.gather();
        let _ = tch::no_grad(|| self.gradient.zero_());
    }

    /// Adds the replicas' gradients to the gradient of the first copy and sets them to zero.
    fn gather(&mut self) {
        tch::no_grad(|| {
            for other in &mut self.others {
                self.gradient += &*other;
                let _ = other.zero_();
            }
        });
    }

    /// Replaces the gradient by the sum of those of all shards, of which the copies here are a part.
    /// `all` gets the copies' gradients one after the other, and returns those of all shards in
    /// their order.
    pub fn gather_from(&mut self, all: impl FnOnce(&[f32]) -> Vec<f32>) {
        let copies: Vec<Tensor> = std::iter::once(&self.gradient)
            .chain(&self.others)
            .map(Tensor::shallow_clone)
            .collect();
        let own = Vec::try_from(Tensor::cat(&copies, 0)).expect("gradients are of floats");
        let all = all(&own);
        tch::no_grad(|| {
            for copy in copies {
                let _ = copy.shallow_clone().zero_();
            }
            for (number, shard) in all.chunks_exact(self.weights.numel()).enumerate() {
                let shard = Tensor::from_slice(shard).to_device(self.gradient.device());
                if number == 0 {
                    self.gradient.copy_(&shard);
                } else {
                    self.gradient += shard;
                }
            }
        });
    }

    /// Scales the gradient so that its Euclidean norm is at most `max` (as PyTorch's
    /// `clip_grad_norm_`), and returns the norm before scaling. If that norm is not finite, the
    /// gradient is left unchanged and must not be used for a step.
    pub fn clip_grad_norm(&mut self, max: f64) -> f64 {
        self.gather();
        let norm = self.gradient.norm().double_value(&[]);
        let coefficient = max / (norm + 1e-6);
        if norm.is_finite() && coefficient < 1.0 {
            let _ = tch::no_grad(|| self.gradient.multiply_scalar_(coefficient));
        }
        norm
    }

    /// Moves the parameters against the gradient with learning rate `lr` and clears the gradient.
    ///
    /// The parameters change in place, which libtorch's own checks do not notice: differentiate
    /// every loss before this call.
    pub fn step(&mut self, lr: f64) {
        let AdamConfig { beta1, beta2, eps } = self.config;
        self.gather();
        self.steps += 1;
        let correction1 = 1.0 - beta1.powf(self.steps as f64);
        let correction2 = (1.0 - beta2.powf(self.steps as f64)).sqrt();
        tch::no_grad(|| {
            let _ = self.first.lerp_(&self.gradient, 1.0 - beta1);
            let _ = self.second.lerp_(&self.gradient.square_(), 1.0 - beta2);
            // lr / c1 * m / (sqrt(v) / c2 + eps), with c2 moved out of the denominator.
            let mut denominator = self.second.sqrt();
            denominator += eps * correction2;
            let _ = self
                .weights
                .addcdiv_(&(&self.first * (-lr * correction2 / correction1)), &denominator);
            let _ = self.gradient.zero_();
        });
    }

    /// Returns moments and step count by name, for a checkpoint: `<parameter>.m`, `<parameter>.v`
    /// and `step` (`i64`). The tensors are views: copy or write them before the next step.
    pub fn state(&self) -> Vec<(String, Tensor)> {
        let mut state = vec![("step".to_owned(), Tensor::from(self.steps))];
        for (suffix, flat) in [("m", &self.first), ("v", &self.second)] {
            let named = self.names.iter().zip(views(flat, &self.shapes));
            state.extend(named.map(|(name, view)| (format!("{name}.{suffix}"), view)));
        }
        state
    }

    /// Restores a state that [`Adam::state`] returned. On an error nothing changes.
    ///
    /// # Errors
    /// [`Error::Missing`], [`Error::Unexpected`] or [`Error::Shape`] if the state belongs to other
    /// parameters.
    pub fn load_state(&mut self, state: &[(String, Tensor)]) -> Result<(), Error> {
        let own = self.state();
        let pairs = match_by_name(&own, state)?;
        self.steps = pairs[0].1.int64_value(&[]).max(0);
        for (own, value) in &pairs[1..] {
            own.shallow_clone().copy_(value);
        }
        Ok(())
    }
}

/// Creates a flat tensor for the gradients of parameters that are views of `weights`;
/// `loss.backward()` accumulates into it.
fn flat_gradient(params: &Params, weights: &Tensor) -> Tensor {
    let gradient = weights.zeros_like();
    // A first backward pass makes libtorch create the gradients; views then replace their memory.
    let all: Vec<Tensor> = params.named().iter().map(|(_, t)| t.sum(Kind::Float)).collect();
    Tensor::stack(&all, 0).sum(Kind::Float).backward();
    for ((_, parameter), view) in params.named().iter().zip(views(&gradient, &params.shapes())) {
        parameter.grad().set_data(&view);
    }
    gradient
}

#[cfg(test)]
mod tests {
    use tch::Device;

    use super::*;
    use crate::nn::Mlp;
    use crate::rng::Seed;

    fn network() -> (Params, Mlp, Tensor) {
        let mut params = Params::new(Device::Cpu);
        let mlp = Mlp::new(params.root(&mut Seed::new(1).rng()), 4, 8);
        (
            params,
            mlp,
            Tensor::linspace(-1.0, 1.0, 12, (Kind::Float, Device::Cpu)).view([3, 4]).sin(),
        )
    }

    fn loss(mlp: &Mlp, x: &Tensor) -> Tensor {
        (mlp.forward(x) - 0.5).square().mean(Kind::Float)
    }

    fn bits(params: &Params) -> Vec<u32> {
        let flat: Vec<Tensor> =
            params.named().iter().map(|(_, t)| t.detach().reshape([-1])).collect();
        Vec::<f32>::try_from(Tensor::cat(&flat, 0)).unwrap().into_iter().map(f32::to_bits).collect()
    }

    #[test]
    fn learns_and_a_rate_of_zero_does_not() {
        let (mut params, mlp, x) = network();
        let mut adam = Adam::new(&mut params);
        let (start, before) = (bits(&params), loss(&mlp, &x).double_value(&[]));
        for _ in 0..10 {
            loss(&mlp, &x).backward();
            adam.step(0.0);
        }
        assert_eq!(start, bits(&params));
        for _ in 0..100 {
            loss(&mlp, &x).backward();
            adam.step(1e-2);
        }
        let after = loss(&mlp, &x).double_value(&[]);
        assert!(after < 0.05 * before, "{before} -> {after}");
    }

    #[test]
    fn resuming_is_bit_equal() {
        let train = |adam: &mut Adam, mlp: &Mlp, x: &Tensor, steps: i32| {
            for _ in 0..steps {
                loss(mlp, x).backward();
                adam.clip_grad_norm(0.1);
                adam.step(1e-3);
            }
        };
        let (mut params, mlp, x) = network();
        let mut adam = Adam::new(&mut params);
        train(&mut adam, &mlp, &x, 3);
        let (mut params_2, mlp_2, _) = network();
        let mut adam_2 = Adam::new(&mut params_2);
        params_2.copy_from(params.named()).unwrap();
        adam_2.load_state(&adam.state()).unwrap();
        train(&mut adam, &mlp, &x, 3);
        train(&mut adam_2, &mlp_2, &x, 3);
        assert_eq!(bits(&params), bits(&params_2));
        let state = adam.state();
        assert!(
            matches!(adam.load_state(&state[1..]), Err(Error::Missing { name }) if name == "step")
        );
    }

    /// Half a batch on each of two copies moves the weights as the whole batch on one copy does.
    #[test]
    fn replicas_add_their_gradients() {
        let (mut params, mlp, x) = network();
        let (mut alone, mlp_alone, _) = network();
        let (mut copy, mlp_copy, _) = network();
        let (mut adam, mut single) = (Adam::new(&mut params), Adam::new(&mut alone));
        adam.replica(&mut copy);
        let norm = |adam: &mut Adam| adam.clip_grad_norm(f64::INFINITY);
        for _ in 0..3 {
            (loss(&mlp, &x.narrow(0, 0, 1)) / 3.0).backward();
            (loss(&mlp_copy, &x.narrow(0, 1, 2)) * 2.0 / 3.0).backward();
            loss(&mlp_alone, &x).backward();
            let (split, whole) = (norm(&mut adam), norm(&mut single));
            assert!((split - whole).abs() < 1e-5 * whole, "{split} {whole}");
            adam.step(1e-2);
            single.step(1e-2);
            assert_eq!(bits(&params), bits(&copy), "one set of weights");
        }
        let distance = (adam.weights() - single.weights()).abs().max().double_value(&[]);
        assert!(distance < 1e-4, "{distance}");
    }

    #[test]
    fn gradients_add_up_and_unused_parameters_get_none() {
        let (mut params, mlp, x) = network();
        let rest = params.root(&mut Seed::new(2).rng()).create(
            "unused",
            &[3],
            crate::nn::Init::Constant(1.0),
        );
        let mut adam = Adam::new(&mut params);
        loss(&mlp, &x).backward();
        let norm = adam.clip_grad_norm(f64::INFINITY);
        loss(&mlp, &x).backward();
        let twice = adam.clip_grad_norm(norm);
        assert!((twice - 2.0 * norm).abs() < 1e-6 * norm);
        assert!((adam.clip_grad_norm(1e9) - norm).abs() < 1e-4 * norm);
        adam.step(0.1);
        assert_eq!(Vec::<f32>::try_from(&rest.detach()).unwrap(), [1.0; 3]);
        assert_eq!(adam.clip_grad_norm(1.0), 0.0, "a step clears the gradient");
        loss(&mlp, &x).backward();
        assert!(adam.clip_grad_norm(1.0) > 0.0, "gradients still arrive after a step");
        adam.zero_grad();
        assert_eq!(adam.clip_grad_norm(1.0), 0.0);
    }
}
