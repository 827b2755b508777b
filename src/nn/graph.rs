//! The learned communication graph: which agent listens to which.
//!
//! Additive attention scores each ordered pair. A hard Gumbel-softmax turns the score into an edge
//! with a straight-through gradient, and the physical mask removes edges that are physically
//! impossible (paper, "Graph-attention Communication Protocol"; MAGIC, Niu et al. 2021). The caller
//! can pass the noise, and so store it and use it again: an update then sees the graphs of its
//! rollout.

use std::f64::consts::SQRT_2;

use tch::{Kind, Tensor};

use super::{Init, Mlp, Neighbours, Packing, Path};

/// A communication graph: which agents each agent listens to. Every agent listens to itself.
#[derive(Debug)]
pub enum Graph {
    /// An edge of 0 or 1 for every ordered pair of slots, `[B, N, N]`, row = listener.
    Full(Tensor),
    /// Edges to the agents that each of the P agents of a packing can hear.
    Listed {
        /// The lists of the agents that each agent can hear.
        neighbours: Neighbours,
        /// 0 or 1 for each entry of the lists, `[P, K]`.
        edges: Tensor,
    },
}

impl Graph {
    /// Returns the graph as an edge of 0 or 1 for every ordered pair of slots, `[B, N, N]`.
    pub fn full(&self, packing: &Packing) -> Tensor {
        match self {
            Self::Full(graph) => graph.shallow_clone(),
            Self::Listed { neighbours, edges } => {
                with_self_loops(&neighbours.to_full(edges, packing))
            }
        }
    }

    /// Returns for each listener how many of its edges to other agents are open and how many are
    /// physically possible, `[B, N, 2]`, without gradient.
    pub fn count_edges(&self, physical: &Tensor, packing: &Packing) -> Tensor {
        match self {
            Self::Full(graph) => count_edges(graph, physical),
            Self::Listed { neighbours, edges } => tch::no_grad(|| {
                let sum = |x: &Tensor| x.sum_dim_intlist(-1, false, Kind::Float);
                packing.unpack(&Tensor::stack(&[sum(edges), sum(neighbours.possible())], -1))
            }),
        }
    }
}

/// Scores pairs of agents and decides on edges.
#[derive(Debug)]
pub struct CommGraph {
    base: Mlp,
    receiver: Tensor,
    sender: Tensor,
    bias: f64,
}

/// Slope of the leaky rectifier for negative scores (Veličković et al. 2018; the released code of
/// IWoL has 1.2 in its driving tasks).
pub const SLOPE: f32 = 0.2;

impl CommGraph {
    /// Creates a graph over features of width `inputs`, with its own trunk of width `hidden`.
    /// `bias` is added to every score.
    pub fn new(mut path: Path<'_>, inputs: i64, hidden: i64, bias: f64) -> Self {
        let base = Mlp::new(path.sub("base"), inputs, hidden);
        let init = Init::XavierNormal(SQRT_2);
        let receiver = path.create("receiver", &[1, hidden], init);
        CommGraph { base, receiver, sender: path.create("sender", &[1, hidden], init), bias }
    }

    /// Returns scores `e: [B, N, N]` from features `f: [P, H]` of the agents in the `B` rows of a
    /// packing. `e[b, i, j]` is the score of `i` listening to `j`; the probability of that edge is
    /// `sigmoid(e)`.
    pub fn scores(&self, f: &Tensor, packing: &Packing) -> Tensor {
        let halves = packing.unpack(&self.halves(f));
        self.leaky(&(halves.narrow(2, 0, 1) + halves.narrow(2, 1, 1).transpose(1, 2)))
    }

    /// Returns the parts of a score that agents `[P, H]` add as receiver and as sender, `[P, 2]`.
    fn halves(&self, f: &Tensor) -> Tensor {
        self.base
            .forward(f)
            .linear(&Tensor::cat(&[&self.receiver, &self.sender], 0), None::<Tensor>)
    }

    fn leaky(&self, sum: &Tensor) -> Tensor {
        let scores = sum.prelu(&Tensor::from(SLOPE).to_device(sum.device()));
        if self.bias == 0.0 { scores } else { scores + self.bias }
    }

    /// Returns the graph `G: [B, N, N]` for features `f: [P, H]`. Its values are exactly 0 or 1,
    /// and its gradient is that of the soft sample. Row `i` marks the agents that `i` listens to.
    ///
    /// `physical: [B, N, N]` (any kind; 0 cuts) removes edges. Every slot always listens to itself,
    /// even if its agent is absent. `noise: [B, N, N]` is logistic (the difference of two Gumbel
    /// variables); without it, an edge exists where its probability exceeds one half.
    pub fn forward(
        &self,
        f: &Tensor,
        packing: &Packing,
        physical: &Tensor,
        noise: Option<&Tensor>,
    ) -> Tensor {
        sample_edges(&self.scores(f, packing), physical, noise)
    }

    /// Returns the edges of [`CommGraph::forward`] to the agents that each agent can hear, `[P, K]`.
    /// `noise` is `[P, K]`.
    pub fn forward_listed(
        &self,
        f: &Tensor,
        neighbours: &Neighbours,
        noise: Option<&Tensor>,
    ) -> Tensor {
        let halves = self.halves(f);
        let possible = neighbours.possible();
        let senders = neighbours.of_senders(&halves.select(1, 1)).view_as(possible);
        possible_edges(&self.leaky(&(halves.narrow(1, 0, 1) + senders)), possible, noise)
    }

    /// Returns one row of [`CommGraph::forward`], with all agents present: which agents the agent in
    /// slot `place: [B]` listens to, `[B, 1, N]`, from features `f: [B, N, H]`, where
    /// `physical: [B, 1, N]` allows an edge. `noise` is `[B, N]`.
    pub fn forward_one(
        &self,
        f: &Tensor,
        place: &Tensor,
        physical: &Tensor,
        noise: Option<&Tensor>,
    ) -> Tensor {
        let (rows, agents, _) = f.size3().expect("features are [B, N, H]");
        let halves = self.halves(&f.flatten(0, 1)).view([rows, agents, 2]);
        let (receivers, senders) = (halves.select(2, 0), halves.select(2, 1));
        let own = place.view([rows, 1]);
        let scores = self.leaky(&(receivers.gather(1, &own, false) + senders));
        let heard = possible_edges(&scores, &physical.squeeze_dim(1), noise);
        heard.scatter_value(1, &own, 1.0).unsqueeze(1)
    }
}

/// Samples a graph from scores, as [`CommGraph::forward`] describes. All tensors are `[B, N, N]`.
pub fn sample_edges(scores: &Tensor, physical: &Tensor, noise: Option<&Tensor>) -> Tensor {
    with_self_loops(&possible_edges(scores, physical, noise))
}

/// Samples edges from scores of the same shape, without those from agents to themselves.
fn possible_edges(scores: &Tensor, physical: &Tensor, noise: Option<&Tensor>) -> Tensor {
    let scores = noise.map_or_else(|| scores.shallow_clone(), |noise| scores + noise);
    let soft = scores.sigmoid();
    let learned = scores.gt(0.0).to_kind(Kind::Float) + (&soft - soft.detach());
    learned * physical.to_kind(Kind::Float)
}

/// Marks the `count` largest entries of each row of `scores: [.., N]` with 1 and the others with 0.
/// The gradient is that of the row's softmax (CommFormer's static graph).
pub fn sample_best(scores: &Tensor, count: i64) -> Tensor {
    let (_, best) = tch::no_grad(|| scores.topk(count, -1, true, true));
    let hard = scores.zeros_like().scatter_value(-1, &best, 1.0).detach();
    let soft = scores.softmax(-1, Kind::Float);
    hard + (&soft - soft.detach())
}

/// Returns for each listener how many of its edges to other agents are open and how many are
/// physically possible, `[B, N, 2]`, without gradient. Both arguments are `[B, N, N]`.
pub fn count_edges(graph: &Tensor, physical: &Tensor) -> Tensor {
    tch::no_grad(|| {
        let physical = physical.to_kind(Kind::Float);
        let others = |x: &Tensor| x.sum_dim_intlist(-1, false, Kind::Float) - x.diagonal(0, 1, 2);
        Tensor::stack(&[others(&(graph * &physical)), others(&physical)], -1)
    })
}

/// Returns `graph: [B, N, N]` (floating point) with its diagonal set to 1. No gradient flows
/// through the diagonal.
pub fn with_self_loops(graph: &Tensor) -> Tensor {
    let eye = Tensor::eye(graph.size()[1], (Kind::Float, graph.device()));
    graph * (1.0 - &eye) + eye
}

#[cfg(test)]
mod tests {
    use tch::Device;

    use super::*;
    use crate::nn::Params;
    use crate::rng::{Seed, fill_logistic};

    const CPU: (Kind, Device) = (Kind::Float, Device::Cpu);

    fn uniform(shape: &[i64], seed: u64) -> Tensor {
        let values = Init::Uniform(0.5).sample(shape, &mut Seed::new(seed).rng());
        Tensor::from_slice(&values).view(shape) * 0.999 + 0.5
    }

    fn logistic(shape: &[i64], seed: u64) -> Tensor {
        let mut noise = vec![0.0; shape.iter().product::<i64>() as usize];
        fill_logistic(&mut Seed::new(seed).rng(), &mut noise);
        Tensor::from_slice(&noise).view(shape)
    }

    fn everyone(f: &Tensor) -> (Tensor, Packing) {
        (f.flatten(0, 1), Packing::full(f.size()[0], f.size()[1]))
    }

    fn scheduler() -> CommGraph {
        CommGraph::new(Params::new(Device::Cpu).root(&mut Seed::new(6).rng()), 5, 5, 0.0)
    }

    #[test]
    fn edges_are_zero_or_one_and_follow_the_physical_mask() {
        let f = uniform(&[40, 6, 5], 1);
        let noise = logistic(&[40, 6, 6], 2);
        let physical = uniform(&[40, 6, 6], 3).gt(0.3);
        let (f, packing) = everyone(&f);
        for noise in [Some(&noise), None] {
            let graph = scheduler().forward(&f, &packing, &physical, noise);
            assert!(
                (graph.eq(0.0) + graph.eq(1.0)).all().int64_value(&[]) != 0,
                "values are exactly 0 or 1"
            );
            assert!(graph.diagonal(0, 1, 2).eq(1.0).all().int64_value(&[]) != 0, "self loops");
            let off_diagonal: Tensor = 1.0 - Tensor::eye(6, CPU);
            let cut: Tensor = physical.logical_not().to_kind(Kind::Float) * off_diagonal;
            assert_eq!((&graph * cut).sum(Kind::Float).double_value(&[]), 0.0, "cut edges");
            let edges = graph.sum(Kind::Float).double_value(&[]);
            assert!(edges > 240.0 + 50.0, "some edges exist beside the self loops: {edges}");
        }
    }

    #[test]
    fn edges_appear_as_often_as_their_probability_says() {
        let (f, scheduler) = (uniform(&[1, 4, 5], 4), scheduler());
        let (draws, all) = (20_000, Tensor::ones([1, 4, 4], CPU));
        let (f_many, packing) = everyone(&f.expand([draws, 4, 5], false));
        let noise = logistic(&[draws, 4, 4], 5);
        let frequency = scheduler.forward(&f_many, &packing, &all, Some(&noise)).mean_dim(
            0,
            false,
            Kind::Float,
        );
        let expected =
            with_self_loops(&scheduler.scores(&f.get(0), &Packing::full(1, 4)).sigmoid()).get(0);
        let worst = (frequency - expected).abs().max().double_value(&[]);
        assert!(worst < 0.02, "{worst}");
    }

    #[test]
    fn only_possible_edges_between_different_agents_are_counted() {
        let graph =
            Tensor::from_slice(&[1_f32, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0]).view([1, 3, 3]);
        let physical =
            Tensor::from_slice(&[1_f32, 1.0, 1.0, 1.0, 1.0, 0.0, 1.0, 0.0, 1.0]).view([1, 3, 3]);
        // Possible edges: 0-1, 0-2, 1-0, 2-0; open: 0-1. Edge 1-2 is open but not possible.
        let counts = |physical: &Tensor| {
            Vec::<f32>::try_from(count_edges(&graph, physical).view([-1])).expect("numbers")
        };
        assert_eq!(counts(&physical), [1.0, 2.0, 0.0, 1.0, 0.0, 1.0]);
        assert_eq!(counts(&physical.zeros_like()), [0.0; 6]);
    }

    #[test]
    fn gradient_reaches_the_scores_through_possible_edges_only() {
        let f = uniform(&[50, 3, 5], 7).set_requires_grad(true);
        let physical =
            Tensor::from_slice(&[1_f32, 1.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0]).view([1, 3, 3]);
        let (flat, packing) = everyone(&f);
        let graph =
            scheduler().forward(&flat, &packing, &physical, Some(&logistic(&[50, 3, 3], 8)));
        let gradient = Tensor::run_backward(&[graph.sum(Kind::Float)], &[&f], false, false)
            .remove(0)
            .transpose(0, 1);
        assert!(gradient.get(0).abs().max().double_value(&[]) > 0.0);
        assert_eq!(gradient.get(2).abs().max().double_value(&[]), 0.0, "the third agent is dead");
    }
}
