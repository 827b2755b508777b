//! The parameters of a network: named tensors in a fixed order.
//!
//! tch's own `VarStore` keeps its variables in an unordered map, and libtorch's optimisers hide
//! their state from tch. Resuming a run bit for bit needs both the order and the state. A
//! [`Params`] keeps the order of creation. After [`Params::flatten`], which an optimiser calls, all
//! tensors are views of one flat tensor, so that an update takes a few operations in all instead of
//! a few for each parameter.

use std::collections::{HashMap, HashSet};
use std::fmt::Display;

use tch::{Device, Tensor};

use super::{Error, Init};
use crate::rng::Rng;

/// Named parameters in the order of their creation. All are `f32` and require gradients.
#[derive(Debug)]
pub struct Params {
    device: Device,
    named: Vec<(String, Tensor)>,
    flat: Option<Tensor>,
}

impl Params {
    /// Returns an empty store whose parameters will live on `device`.
    pub fn new(device: Device) -> Self {
        Params { device, named: Vec::new(), flat: None }
    }

    /// Returns the root path, under which a network creates its parameters; `rng` draws their
    /// initial values.
    pub fn root<'a>(&'a mut self, rng: &'a mut Rng) -> Path<'a> {
        Path { params: self, rng, prefix: String::new() }
    }

    /// Returns the device on which the parameters live.
    pub fn device(&self) -> Device {
        self.device
    }

    /// Returns every parameter with its name, such as `actor.base.layers.0.linear.weight`, in the
    /// order of creation.
    pub fn named(&self) -> &[(String, Tensor)] {
        &self.named
    }

    /// Returns the number of scalar weights.
    pub fn count(&self) -> i64 {
        self.named.iter().map(|(_, t)| t.numel() as i64).sum()
    }

    /// Overwrites the values with those of `tensors`, matched by name. On an error nothing changes.
    ///
    /// # Errors
    /// [`Error::Missing`] or [`Error::Unexpected`] if the sets of names differ, [`Error::Shape`] if
    /// a shape differs.
    pub fn copy_from(&self, tensors: &[(String, Tensor)]) -> Result<(), Error> {
        copy_named(&self.named, tensors)
    }

    /// Moves all parameters into one flat tensor `[count]`, makes them views of that tensor and
    /// returns it. Layers that hold the parameters see the change. No parameter can be added after
    /// this call.
    ///
    /// # Panics
    /// If the store is empty (a bug).
    pub fn flatten(&mut self) -> Tensor {
        if let Some(flat) = &self.flat {
            return flat.shallow_clone();
        }
        let parts: Vec<Tensor> = self.named.iter().map(|(_, t)| t.detach().reshape([-1])).collect();
        let flat = Tensor::cat(&parts, 0);
        let views = views(&flat, &self.shapes());
        for ((_, own), view) in self.named.iter_mut().zip(views) {
            own.set_data(&view);
        }
        self.flat = Some(flat.shallow_clone());
        flat
    }

    /// Makes all parameters views of `flat`, the weights of another copy of the same network.
    ///
    /// # Panics
    /// If `flat` does not have as many elements as this store (a bug).
    pub(super) fn share(&mut self, flat: &Tensor) {
        assert!(flat.numel() as i64 == self.count(), "the shared weights are of another network");
        let views = views(flat, &self.shapes());
        for ((_, own), view) in self.named.iter_mut().zip(views) {
            own.set_data(&view);
        }
        self.flat = Some(flat.shallow_clone());
    }

    /// Returns the shape of every parameter, in order.
    pub(super) fn shapes(&self) -> Vec<Vec<i64>> {
        self.named.iter().map(|(_, t)| t.size()).collect()
    }
}

/// Overwrites the tensors in `own` with the tensors of the same names in `tensors`. On an error
/// nothing changes.
///
/// # Errors
/// As for [`Params::copy_from`].
pub fn copy_named(own: &[(String, Tensor)], tensors: &[(String, Tensor)]) -> Result<(), Error> {
    for (own, value) in match_by_name(own, tensors)? {
        tch::no_grad(|| own.shallow_clone().copy_(value));
    }
    Ok(())
}

/// Returns views of a flat tensor with the names and shapes of `params`.
pub fn named_views(flat: &Tensor, params: &Params) -> Vec<(String, Tensor)> {
    params.named.iter().map(|(name, _)| name.clone()).zip(views(flat, &params.shapes())).collect()
}

/// Cuts a flat tensor into consecutive views of the given shapes.
pub(super) fn views(flat: &Tensor, shapes: &[Vec<i64>]) -> Vec<Tensor> {
    let mut start = 0;
    let cut = |shape: &Vec<i64>| {
        let length = shape.iter().product();
        let view = flat.narrow(0, start, length).view(shape.as_slice());
        start += length;
        view
    };
    shapes.iter().map(cut).collect()
}

/// Pairs each tensor of `own` with the tensor of the same name in `given`. The sets of names and
/// the shapes must agree.
pub(super) fn match_by_name<'a>(
    own: &'a [(String, Tensor)],
    given: &'a [(String, Tensor)],
) -> Result<Vec<(&'a Tensor, &'a Tensor)>, Error> {
    let names: HashSet<&str> = own.iter().map(|(name, _)| name.as_str()).collect();
    if let Some((name, _)) = given.iter().find(|(name, _)| !names.contains(name.as_str())) {
        return Err(Error::Unexpected { name: name.clone() });
    }
    let by_name: HashMap<&str, &Tensor> =
        given.iter().map(|(name, t)| (name.as_str(), t)).collect();
    let pair = |(name, own): &'a (String, Tensor)| {
        let value =
            *by_name.get(name.as_str()).ok_or_else(|| Error::Missing { name: name.clone() })?;
        if value.size() == own.size() {
            Ok((own, value))
        } else {
            Err(Error::Shape { name: name.clone(), expected: own.size(), found: value.size() })
        }
    };
    own.iter().map(pair).collect()
}

/// A node in the name tree of a [`Params`] store, under which a layer creates its parameters,
/// together with the generator of their initial values.
pub struct Path<'a> {
    params: &'a mut Params,
    rng: &'a mut Rng,
    prefix: String,
}

impl Path<'_> {
    /// Returns the device of the parameters.
    pub fn device(&self) -> Device {
        self.params.device()
    }

    /// Returns the path `part` below this one; names are joined by dots.
    pub fn sub(&mut self, part: impl Display) -> Path<'_> {
        let prefix = self.join(part);
        Path { params: self.params, rng: self.rng, prefix }
    }

    /// Creates a parameter, registers it under `name` below this path and returns it.
    ///
    /// # Panics
    /// If the name is taken or the store has been flattened (bugs).
    pub fn create(&mut self, name: &str, shape: &[i64], init: Init) -> Tensor {
        let values = init.sample(shape, self.rng);
        self.register(name, shape, &values)
    }

    /// Creates a parameter of `blocks` matrices, each drawn separately, stacked along the rows.
    ///
    /// # Panics
    /// As for [`Path::create`].
    pub fn create_stacked(
        &mut self,
        name: &str,
        blocks: i64,
        shape: [i64; 2],
        init: Init,
    ) -> Tensor {
        let values: Vec<f32> = (0..blocks).flat_map(|_| init.sample(&shape, self.rng)).collect();
        self.register(name, &[blocks * shape[0], shape[1]], &values)
    }

    fn register(&mut self, name: &str, shape: &[i64], values: &[f32]) -> Tensor {
        let name = self.join(name);
        assert!(self.params.flat.is_none(), "parameter `{name}` is created after the optimiser");
        assert!(
            self.params.named.iter().all(|(other, _)| *other != name),
            "parameter `{name}` exists twice"
        );
        let tensor = Tensor::from_slice(values)
            .view(shape)
            .to_device(self.params.device)
            .set_requires_grad(true);
        self.params.named.push((name, tensor.shallow_clone()));
        tensor
    }

    fn join(&self, part: impl Display) -> String {
        if self.prefix.is_empty() { part.to_string() } else { format!("{}.{part}", self.prefix) }
    }
}

#[cfg(test)]
mod tests {

    use tch::Kind;

    use super::*;
    use crate::nn::Mlp;
    use crate::rng::Seed;

    fn network(seed: u64) -> (Params, Mlp) {
        let mut params = Params::new(Device::Cpu);
        let mlp = Mlp::new(params.root(&mut Seed::new(seed).rng()).sub("actor"), 5, 8);
        (params, mlp)
    }

    fn values(params: &Params) -> Vec<Vec<f32>> {
        params
            .named()
            .iter()
            .map(|(_, t)| Vec::try_from(t.detach().reshape([-1])).unwrap())
            .collect()
    }

    #[test]
    fn weights_are_a_function_of_the_seed() {
        let (a, b, c) = (network(7).0, network(7).0, network(8).0);
        assert_eq!(values(&a), values(&b));
        assert_ne!(values(&a), values(&c));
        assert_eq!(a.named()[2].0, "actor.layers.0.linear.weight");
        assert_eq!(a.count(), 10 + (5 * 8 + 8 + 16) + (8 * 8 + 8 + 16));
    }

    #[test]
    fn flattening_keeps_the_function_and_shares_memory() {
        let (mut params, mlp) = network(1);
        let x = Tensor::linspace(-1.0, 1.0, 10, (Kind::Float, Device::Cpu)).view([2, 5]);
        let before = mlp.forward(&x);
        let mut flat = params.flatten();
        assert!(before.equal(&mlp.forward(&x)));
        let gradient = Tensor::run_backward(
            &[mlp.forward(&x).sum(Kind::Float)],
            &[&params.named()[2].1],
            false,
            false,
        );
        assert_eq!(gradient[0].size(), [8, 5]);
        let _ = tch::no_grad(|| flat.zero_());
        assert_eq!(mlp.forward(&x).abs().max().double_value(&[]), 0.0);
    }

    #[test]
    fn a_copy_can_share_weights_or_take_them_over() {
        let (mut params, _) = network(1);
        let mut flat = params.flatten();
        let (mut other, mlp) = network(2);
        other.copy_from(params.named()).unwrap();
        assert_eq!(values(&params), values(&other));
        let _ = tch::no_grad(|| flat.fill_(1.0));
        assert_ne!(values(&params), values(&other));
        other.share(&flat);
        let _ = tch::no_grad(|| flat.zero_());
        assert_eq!(values(&params), values(&other));
        let x = Tensor::ones([1, 5], (Kind::Float, Device::Cpu));
        assert_eq!(
            mlp.forward(&x).abs().max().double_value(&[]),
            0.0,
            "layers see the shared weights"
        );
        assert!(
            named_views(&flat, &params)
                .iter()
                .zip(params.named())
                .all(|(v, p)| v.0 == p.0 && v.1.size() == p.1.size())
        );
    }

    #[test]
    fn loading_refuses_what_does_not_fit() {
        type Change = fn(&mut Vec<(String, Tensor)>);
        let (params, _) = network(1);
        let before = values(&params);
        let given = |change: Change| {
            let mut list: Vec<_> =
                network(2).0.named().iter().map(|(n, t)| (n.clone(), t.shallow_clone())).collect();
            change(&mut list);
            params.copy_from(&list).unwrap_err()
        };
        let missing = given(|l| drop(l.pop()));
        assert!(
            matches!(missing, Error::Missing { ref name } if name == "actor.layers.1.norm.bias"),
            "{missing}"
        );
        let extra = given(|l| l.push(("x".into(), Tensor::zeros([1], (Kind::Float, Device::Cpu)))));
        assert!(matches!(extra, Error::Unexpected { ref name } if name == "x"), "{extra}");
        let shape = given(|l| l[2].1 = Tensor::zeros([8, 6], (Kind::Float, Device::Cpu)));
        assert_eq!(
            shape.to_string(),
            "tensor `actor.layers.0.linear.weight` has shape [8, 6], but this network needs [8, 5]; check the configuration"
        );
        assert_eq!(values(&params), before, "a refused load changes nothing");
    }

    #[test]
    #[should_panic(expected = "exists twice")]
    fn a_name_is_used_once() {
        let mut params = Params::new(Device::Cpu);
        let mut rng = Seed::new(0).rng();
        let mut root = params.root(&mut rng);
        let _ = root.create("a", &[1], Init::Zeros);
        let _ = root.create("a", &[1], Init::Zeros);
    }
}
