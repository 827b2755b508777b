//! The tensors of a rollout, and their division into minibatches and shards.

use tch::{Device, Kind, Tensor};

use super::ppo;
use crate::nn::graph::count_edges;
use crate::nn::{Packing, ValueNorm};
use crate::rng::{self, Seed};
use crate::rollout::Rollout;

/// Names of diagnostics: the mean numbers of edges per listener that the learned graph opens and
/// that are physically possible.
pub(super) const EDGES: [&str; 2] = ["graph/open_edges", "graph/possible_edges"];

/// A rollout as tensors. The first dimension is the row `t · E + e` of step t and environment e.
pub struct Batch {
    /// Observations, `[(T + 1) · E, N, O]`.
    pub observation: Tensor,
    /// Privileged states, `[(T + 1) · E, N, S]`.
    pub state: Tensor,
    /// Physical masks, `[(T + 1) · E, N, N]`.
    pub comm: Tensor,
    /// -1 where a message is lost, the numbers of false messages, or 0, `[(T + 1) · E, N, N]`; empty
    /// where the policy has no radio.
    pub disturbance: Tensor,
    /// 1 where a choice is open, `[(T + 1) · E, N, K]`; empty where actions are continuous.
    pub available: Tensor,
    /// 1 where an agent acts, `[T · E, N]`.
    pub active: Tensor,
    /// 0 where a trajectory starts and memories are cleared, else 1, `[(T + 1) · E, N]`.
    pub keep: Tensor,
    /// Memory of the policy before each decision, `[(T + 1) · E, N, M]`.
    pub memory: Tensor,
    /// Memory of the value function before each row, `[(T + 1) · E, N, M]`.
    pub value_memory: Tensor,
    /// Noise of the policy's communication graphs, `[(T + 1) · E, N, ..]`; empty for policies
    /// without a graph.
    pub policy_graph: Tensor,
    /// Noise of the value function's communication graph, `[(T + 1) · E, N, ..]`; empty for value
    /// functions without a graph.
    pub value_graph: Tensor,
    /// Actions as sampled, not clipped, `[T · E, N, A]`.
    pub action: Tensor,
    /// Log-probability of each dimension of the action, `[T · E, N, A]`.
    pub log_prob: Tensor,
    /// Shift of the means by noise of earlier steps, in units of the scheduled standard deviation,
    /// `[T · E, N, A]`; empty where noise is independent from step to step.
    pub carried: Tensor,
    /// Logarithm of the share of each dimension's standard deviation that is drawn anew,
    /// `[T · E, N, A]`; `[T · E, N, 1]` with zeros where noise is independent from step to step.
    pub log_fresh: Tensor,
    /// Advantages, normalised over the active samples, `[T · E, N]`.
    pub advantage: Tensor,
    /// Returns in units of the reward, `[T · E, N]`.
    pub returns: Tensor,
    /// Outputs of the value network (normalised) before the update, `[T · E, N]`.
    pub value: Tensor,
    /// Share of the returns' variance that the values explained before the update.
    pub explained_variance: f64,
}

impl Batch {
    pub(super) fn new(rollout: &Rollout, device: Device) -> Self {
        let s = rollout.sizes;
        let (rows, closed, n) =
            ((s.steps * s.envs) as i64, ((s.steps + 1) * s.envs) as i64, s.agents as i64);
        let tensor =
            |data: &[f32], shape: &[i64]| Tensor::from_slice(data).view(shape).to_device(device);
        let start = tensor(&rollout.start, &[closed, n]);
        let empty = || Tensor::zeros([rows, n], (Kind::Float, device));
        let steps = s.steps as i64;
        let (fresh, dimensions) = if rollout.log_fresh.is_empty() {
            (Tensor::zeros([steps, 1, 1, 1], (Kind::Float, device)), 1)
        } else {
            let dimensions = s.actions as i64;
            (tensor(&rollout.log_fresh, &[steps, 1, 1, dimensions]), dimensions)
        };
        let policy_graph = if s.graph_noise > 0 { closed } else { 0 };
        Self {
            observation: tensor(&rollout.observation, &[closed, n, s.observation as i64]),
            state: tensor(&rollout.state, &[closed, n, s.state as i64]),
            comm: tensor(&rollout.comm, &[closed, n, n]),
            disturbance: tensor(&rollout.disturbance, &[-1, n, n]),
            available: tensor(&rollout.available, &[-1, n, s.choices.max(1) as i64]),
            active: tensor(&rollout.active[..s.steps * s.envs * s.agents], &[rows, n]),
            keep: start.ones_like() - start,
            memory: tensor(&rollout.memory, &[closed, n, s.memory as i64]),
            value_memory: Tensor::zeros([closed, n, 0], (Kind::Float, device)),
            policy_graph: tensor(&rollout.graph_noise, &[policy_graph, n, s.graph_noise as i64]),
            value_graph: Tensor::zeros([0, n, n], (Kind::Float, device)),
            action: tensor(&rollout.action, &[rows, n, s.actions as i64]),
            log_prob: tensor(&rollout.log_prob, &[rows, n, s.actions as i64]),
            carried: tensor(&rollout.carried, &[-1, n, s.actions as i64]),
            log_fresh: fresh
                .expand([steps, s.envs as i64, n, dimensions], false)
                .reshape([rows, n, dimensions]),
            advantage: empty(),
            returns: empty(),
            value: empty(),
            explained_variance: 0.0,
        }
    }

    /// Computes advantages and returns from the critic's outputs for all rows (normalised),
    /// `[(T + 1) · E, N]`: each agent's own, or those of its team, in which case all outputs of a
    /// row are equal.
    pub(super) fn estimate(
        &mut self,
        rollout: &Rollout,
        outputs: &Tensor,
        norm: &ValueNorm,
        [gamma, lambda]: [f64; 2],
        team: bool,
    ) {
        let agents = rollout.sizes.agents;
        let values = norm.denormalize(outputs).reshape([-1]).to_device(Device::Cpu);
        let values = Vec::<f32>::try_from(values).expect("values are floats");
        let (mut advantage, returns) = if team {
            let values: Vec<f32> = values.iter().copied().step_by(agents).collect();
            let (advantage, returns) = rollout.team().advantages(&values, gamma, lambda);
            let shared = |of: &[f32]| {
                of.iter().flat_map(|&x| std::iter::repeat_n(x, agents)).collect::<Vec<_>>()
            };
            (shared(&advantage), shared(&returns))
        } else {
            let (mut advantage, returns) = rollout.advantages(&values, gamma, lambda);
            rollout.share_advantages(&mut advantage);
            (advantage, returns)
        };
        let count = advantage.len();
        self.explained_variance =
            ppo::explained_variance(&values[..count], &returns, &rollout.active[..count]);
        ppo::normalize_advantages(&mut advantage, &rollout.active[..count]);
        let tensor = |data: &[f32]| {
            Tensor::from_slice(data).view_as(&self.active).to_device(outputs.device())
        };
        (self.advantage, self.returns) = (tensor(&advantage), tensor(&returns));
        self.value = outputs.narrow(0, 0, self.active.size()[0]).copy();
    }

    /// Returns a second handle on the same tensors, for another thread.
    pub(super) fn share(&self) -> Self {
        self.map(Tensor::shallow_clone)
    }

    /// Returns the batch of `count` environments from number `first` on, as far as the value
    /// function reads it. `envs` is the number of all environments.
    pub(super) fn of_envs(&self, envs: i64, first: i64, count: i64) -> Self {
        self.map(|tensor| {
            let size = tensor.size();
            if size[0] % envs != 0 || tensor.numel() == 0 {
                return tensor.shallow_clone();
            }
            let mut shape = vec![size[0] / envs, envs];
            shape.extend(&size[1..]);
            tensor.view(&shape[..]).narrow(1, first, count).flatten(0, 1)
        })
    }

    fn map(&self, change: impl Fn(&Tensor) -> Tensor) -> Self {
        Self {
            observation: change(&self.observation),
            state: change(&self.state),
            comm: change(&self.comm),
            disturbance: change(&self.disturbance),
            available: change(&self.available),
            active: change(&self.active),
            keep: change(&self.keep),
            memory: change(&self.memory),
            value_memory: change(&self.value_memory),
            policy_graph: change(&self.policy_graph),
            value_graph: change(&self.value_graph),
            action: change(&self.action),
            log_prob: change(&self.log_prob),
            carried: change(&self.carried),
            log_fresh: change(&self.log_fresh),
            advantage: change(&self.advantage),
            returns: change(&self.returns),
            value: change(&self.value),
            explained_variance: self.explained_variance,
        }
    }
}

/// Most samples that networks on a CPU take at once. A larger part of a minibatch is taken in several
/// passes, whose gradients are added up: the results of operations on more samples leave the caches,
/// and their memory is fetched from the system anew (docs/lab/speed.md#minibatches-in-parts).
const MOST_SAMPLES: usize = 8192;

/// The shards of a minibatch that one copy of the networks takes, one after the other.
pub(super) type Part = Vec<Shard>;

/// Samples of a minibatch that the networks take at once.
pub struct Shard {
    /// Sequence length L. Rows come as `[L, C]` for C sequences.
    pub length: i64,
    /// Rows `t · E + e`, step-major, `[L · C]`.
    rows: Tensor,
    /// Rows of the first steps, `[C]`.
    pub first: Tensor,
    /// Indices of the active samples among the `L · C · N`, ascending, `[B]`.
    samples: Tensor,
    /// Number of agent slots N.
    agents: i64,
    /// Share of the minibatch's active samples that belong to this shard.
    pub weight: f64,
}

/// Returns the shuffled minibatches of one epoch. Each holds about `size` samples in up to `parts`
/// parts for the copies of the networks; parts without an active sample are left out.
pub(super) fn minibatches(
    rollout: &Rollout,
    length: usize,
    size: usize,
    parts: usize,
    device: Device,
    seed: Seed,
) -> Vec<Vec<Part>> {
    let agents = rollout.sizes.agents;
    let mut chunks = rollout.chunks(length);
    rng::shuffle(&mut seed.rng(), &mut chunks);
    let count = (rollout.sizes.steps * rollout.sizes.envs * agents)
        .div_ceil(size.max(1))
        .clamp(1, chunks.len().max(1));
    let per_batch = chunks.len().div_ceil(count).max(1);
    let indices = |values: &[i64]| Tensor::from_slice(values).to_device(device);
    let shard = |chunks: &[(usize, usize)]| {
        let rows = rollout.rows(chunks, length);
        let samples: Vec<i64> = (0..rows.len() * agents)
            .filter(|&i| rollout.active[rows[i / agents] as usize * agents + i % agents] > 0.0)
            .map(|i| i as i64)
            .collect();
        Shard {
            length: length as i64,
            agents: agents as i64,
            first: indices(&rows[..chunks.len()]),
            rows: indices(&rows),
            weight: samples.len() as f64,
            samples: indices(&samples),
        }
    };
    let most = if device.is_cuda() { usize::MAX } else { MOST_SAMPLES / (length * agents).max(1) };
    let part = |chunks: &[(usize, usize)]| -> Part {
        let passes = chunks.len().div_ceil(most.max(1));
        let shards = chunks.chunks(chunks.len().div_ceil(passes)).map(shard);
        shards.filter(|shard| shard.weight > 0.0).collect()
    };
    let minibatch = |chunks: &[(usize, usize)]| {
        let parts = chunks.chunks(chunks.len().div_ceil(parts.max(1)).max(1)).map(part);
        let mut parts: Vec<Part> = parts.filter(|part| !part.is_empty()).collect();
        let all: f64 = parts.iter().flatten().map(|shard| shard.weight).sum();
        for shard in parts.iter_mut().flatten() {
            shard.weight /= all;
        }
        parts
    };
    chunks.chunks(per_batch).map(minibatch).filter(|parts| !parts.is_empty()).collect()
}

impl Shard {
    /// Returns this shard's rows of a tensor, `[L · C, …]`.
    pub fn take(&self, tensor: &Tensor) -> Tensor {
        tensor.index_select(0, &self.rows)
    }

    /// Returns the active samples of a tensor with one entry per agent, `[rows, N, …]` to `[B, …]`.
    pub fn active(&self, tensor: &Tensor) -> Tensor {
        self.pick(&self.take(tensor))
    }

    /// Returns about the share `share` of `x: [B, ..]`, which has a row for each active sample. The
    /// part is random because the chunks are shuffled.
    pub fn part(&self, x: &Tensor, share: f64) -> Tensor {
        let some = |count: i64| ((count as f64 * share).ceil() as i64).clamp(1, count);
        if self.length == 1 {
            return x.narrow(0, 0, some(x.size()[0]));
        }
        // Whole chunks are taken, so that every step of a chunk is equally likely.
        let chunks = self.first.size()[0];
        let chunk = self.samples.floor_divide_scalar(self.agents).remainder(chunks);
        let chosen = chunk.lt(some(chunks)).nonzero().squeeze_dim(-1);
        if chosen.numel() == 0 { x.shallow_clone() } else { x.index_select(0, &chosen) }
    }

    /// Returns the active samples of tensors that hold the present agents of this shard's rows,
    /// `[P, …]` to `[B, …]`.
    pub fn unpacked<const K: usize>(
        &self,
        packing: &Packing,
        tensors: [&Tensor; K],
    ) -> [Tensor; K] {
        packing.take(tensors, &self.samples)
    }

    /// Returns how many edges of a graph are open and how many are physically possible per
    /// listener, means over the active samples. `graph` and `comm` hold this shard's rows,
    /// `[L · C, N, N]`.
    pub fn edges(&self, graph: &Tensor, comm: &Tensor) -> [Tensor; 2] {
        self.mean_edges(&count_edges(graph, comm))
    }

    /// Returns the means of `counts [L · C, N, 2]` of this shard's rows over the active samples.
    pub(super) fn mean_edges(&self, counts: &Tensor) -> [Tensor; 2] {
        let means = self.pick(counts).mean_dim(0, false, Kind::Float);
        [means.get(0), means.get(1)]
    }

    /// Returns the active samples of a tensor that holds this shard's rows only, `[L · C, N, …]` to
    /// `[B, …]`.
    pub fn pick(&self, tensor: &Tensor) -> Tensor {
        tensor.flatten(0, 1).index_select(0, &self.samples)
    }
}

/// Draws logistic noise times `scale` for a graph in each row, with `width` numbers per agent,
/// `[(T + 1) · E, N, width]`.
pub(super) fn graph_noise(
    rollout: &Rollout,
    width: i64,
    scale: f64,
    device: Device,
    seed: Seed,
) -> Tensor {
    let s = rollout.sizes;
    let mut noise = vec![0.0; (s.steps + 1) * s.envs * s.agents * width as usize];
    rng::fill_logistic(&mut seed.rng(), &mut noise);
    (Tensor::from_slice(&noise).view([-1, s.agents as i64, width]) * scale).to_device(device)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::rollout::Sizes;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]

        /// The minibatches of an epoch have every active sample once, in parts that networks take in
        /// passes of bounded size, and each has a whole weight.
        #[test]
        fn minibatches_hold_every_active_sample_once(
            steps in 1usize..80,
            envs in 1usize..30,
            agents in 1usize..20,
            length in 1usize..11,
            size in 1usize..60_000,
            parts in 1usize..5,
            seed in any::<u64>(),
        ) {
            let mut rollout = Rollout::new(Sizes {
                steps, envs, agents,
                observation: 0, state: 0, actions: 0, choices: 0, memory: 0, graph_noise: 0,
            });
            rng::fill_normal(&mut Seed::new(seed).rng(), &mut rollout.active);
            rollout.active.iter_mut().for_each(|x| *x = f32::from(*x > -1.0));
            let all = minibatches(&rollout, length, size, parts, Device::Cpu, Seed::new(seed));
            let mut found = Vec::new();
            for minibatch in &all {
                prop_assert!((1..=parts).contains(&minibatch.len()));
                let weight: f64 = minibatch.iter().flatten().map(|shard| shard.weight).sum();
                prop_assert!((weight - 1.0).abs() < 1e-9, "{}", weight);
                for shard in minibatch.iter().flatten() {
                    let rows = Vec::<i64>::try_from(&shard.rows).expect("indices");
                    let samples = Vec::<i64>::try_from(&shard.samples).expect("indices");
                    let agents = agents as i64;
                    prop_assert!(rows.len() * agents as usize <= MOST_SAMPLES.max(length * agents as usize));
                    let place = |i: i64| (rows[(i / agents) as usize] * agents + i % agents) as usize;
                    found.extend(samples.into_iter().map(place));
                }
            }
            found.sort_unstable();
            // A shorter chunk at the end of a world is left out.
            let learned = steps / length * length * envs * agents;
            let active: Vec<usize> = (0..learned).filter(|&i| rollout.active[i] > 0.0).collect();
            prop_assert_eq!(found, active);
        }
    }
}
