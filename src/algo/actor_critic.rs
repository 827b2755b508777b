//! Training by proximal policy optimisation, for all methods that implement [`Networks`]: passes
//! over a rollout, on as many threads as minibatches have shards.
//!
//! Every shard has a copy of the networks. The copies share their weights and have gradients of
//! their own, which are added up before a step. Where a step of a rollout has many decisions, each
//! copy decides for some of the worlds. All cores are busy without a thread pool inside libtorch, and
//! the result depends on the number of shards, not on the number of cores.

use std::ops::Range;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use rayon::prelude::*;
use tch::{Device, Kind, Tensor, no_grad};

use super::batch::{Batch, Part, graph_noise, minibatches};
use super::decision::{ActMode, Decision, Diagnostics, Observation, Reconstruction};
use super::device::act_on;
use super::means::{Means, scalar};
use super::networks::Networks;
use super::parameters::{
    ParameterBuilder, ParameterGroup, Weights, load_value_norm, part, value_norm_entry,
};
use super::ppo::MAX_GRAD_NORM;
use super::settings::{NoiseMode, Settings};
use super::{
    Algorithm, Channel, ChannelNoise, Error, Losses, Stop, UpdateParameters, check_agents,
};
use crate::env::EnvSpec;
use crate::nn::ValueNorm;
use crate::ranks::{self, Ranks};
use crate::rng::Seed;
use crate::rollout::Rollout;

/// Locks a copy of the networks for this thread.
fn locked<N>(copy: &Mutex<N>) -> MutexGuard<'_, N> {
    copy.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A part of a step's decisions (one per world and agent) has at least this many; smaller parts take
/// longer than they save (docs/lab/speed.md#two-processes).
const FEWEST_DECISIONS: usize = 128;

/// Returns into how many parts the decisions of a step are divided: at most `most`.
fn parts_of_decisions(envs: i64, agents: i64, most: usize) -> usize {
    let least = FEWEST_DECISIONS.div_ceil(agents.max(1) as usize);
    (envs as usize / least).clamp(1, most)
}

/// Divides worlds into `parts` ranges of about the same size.
fn divided(envs: i64, parts: usize) -> Vec<Range<i64>> {
    let part = |k| ranks::part_of(k, parts, envs as usize);
    (0..parts).map(part).map(|part| part.start as i64..part.end as i64).collect()
}

/// The value function reads at most this many samples (of an agent and a step) at once, or one
/// world's, so that the memory it takes does not grow with the rollout.
const MOST_VALUES: i64 = 1 << 16;

/// Divides worlds into ranges whose samples the value function reads at once.
fn pieces_of(worlds: Range<i64>, samples_per_world: i64) -> impl Iterator<Item = Range<i64>> {
    let most = (MOST_VALUES / samples_per_world.max(1)).max(1);
    let count = worlds.end - worlds.start;
    let pieces = divided(count, (count as usize).div_ceil(most as usize));
    pieces.into_iter().map(move |piece| worlds.start + piece.start..worlds.start + piece.end)
}

/// Named numbers of a minibatch or of a part of one.
type Report = Vec<(&'static str, f64)>;

/// Adds the numbers of another part of the same minibatch to `sums`.
fn add(sums: &mut Report, other: impl Iterator<Item = (&'static str, f64)>) {
    if sums.is_empty() {
        sums.extend(other);
    } else {
        sums.iter_mut().zip(other).for_each(|(sum, (_, value))| sum.1 += value);
    }
}

/// An algorithm whose networks are trained by proximal policy optimisation.
pub(super) struct ActorCritic<N> {
    /// One copy of the networks for each of this rank's shards. A tensor must not be used by two
    /// threads at once, so each copy has a lock. Nobody waits for it, because each thread uses a copy
    /// of its own.
    copies: Vec<Mutex<N>>,
    ranks: Arc<dyn Ranks>,
    /// Number of shards of all ranks.
    shards: usize,
    pool: Option<rayon::ThreadPool>,
    settings: Settings,
    device: Device,
    weights: Weights,
    value_norm: ValueNorm,
    /// Number of passes over rollouts so far.
    passes: usize,
    /// Memory of a recurrent critic after the last rollout, `[E · N, M]`.
    critic_memory: Option<Tensor>,
}

impl<N: Networks> ActorCritic<N> {
    /// Creates a learner with initial weights drawn from `seed`.
    pub(super) fn new(
        spec: &EnvSpec,
        settings: &Settings,
        seed: Seed,
        device: Device,
        ranks: Arc<dyn Ranks>,
    ) -> Self {
        let build = || {
            let mut builder = ParameterBuilder::new(seed, device);
            let networks = N::new(spec, settings, &mut builder);
            (networks, builder)
        };
        let (networks, builder) = build();
        let mut weights = Weights::new(builder, settings.ppo.average > 0.0);
        let mut copies = vec![Mutex::new(networks)];
        // A GPU works on one shard at a time, so that a second one would bring nothing.
        let shards = if device.is_cuda() { ranks.size() } else { settings.ppo.shards.max(1) };
        let own = ranks::part(&*ranks, shards).len().max(1);
        for _ in 1..own {
            let (networks, builder) = build();
            builder.replicate(&mut weights);
            copies.push(Mutex::new(networks));
        }
        let threads =
            rayon::ThreadPoolBuilder::new().num_threads(own).thread_name(|k| format!("shard{k}"));
        // Libtorch keeps its number of threads for each calling thread.
        let threads = threads.start_handler(|_| tch::set_num_threads(1));
        Self {
            copies,
            ranks,
            shards,
            pool: (own > 1).then(|| threads.build().expect("threads can be started")),
            settings: settings.clone(),
            device,
            weights,
            value_norm: ValueNorm::default(),
            passes: 0,
            critic_memory: None,
        }
    }

    /// Applies `work` in parallel to each item, each with its own copy of the networks. Returns the
    /// results in order.
    fn parallel<T: Send, R: Send>(
        &self,
        items: Vec<T>,
        work: impl Fn(&N, T) -> R + Sync,
    ) -> Vec<R> {
        assert!(items.len() <= self.copies.len(), "each item needs a copy of the networks");
        let pairs = self.copies.iter().zip(items);
        let work = |(copy, item): (&Mutex<N>, T)| work(&locked(copy), item);
        match &self.pool {
            None => pairs.map(work).collect(),
            Some(pool) => {
                let pairs: Vec<_> = pairs.collect();
                pool.install(|| pairs.into_par_iter().map(work).collect())
            }
        }
    }

    /// Locks the first copy of the networks. Let go of it before [`ActorCritic::parallel`], which
    /// locks it as well.
    fn networks(&self) -> MutexGuard<'_, N> {
        locked(&self.copies[0])
    }

    /// Returns the values (normalised) of all rows, `[(T + 1) · E, N]`, and writes the value
    /// function's memory before each row into `batch`.
    fn values(&mut self, batch: &mut Batch, rollout: &Rollout) -> Tensor {
        let (steps, envs) = (rollout.sizes.steps as i64, rollout.sizes.envs as i64);
        let (agents, width) = (rollout.sizes.agents as i64, self.networks().critic().memory());
        let carried = self.critic_memory.take();
        let carried = carried
            .unwrap_or_else(|| Tensor::zeros([envs * agents, width], (Kind::Float, self.device)));
        let carried = carried.view([envs, agents, width]);
        let worlds = divided(envs, self.shards.min(envs as usize));
        let counts: Vec<i64> = worlds.iter().map(|worlds| worlds.end - worlds.start).collect();
        let parts = self.own(worlds).into_iter();
        let parts = parts.map(|worlds| (worlds, batch.share(), carried.shallow_clone())).collect();
        let parts = self.parallel(parts, |networks, (worlds, batch, carried)| {
            let pieces = pieces_of(worlds, (steps + 1) * agents).map(|piece| {
                let (first, count) = (piece.start, piece.end - piece.start);
                let memory = carried.narrow(0, first, count).reshape([count * agents, width]);
                let batch = batch.of_envs(envs, first, count);
                let (values, after) =
                    no_grad(|| networks.critic().values(&batch, steps + 1, &memory));
                let values = values.view([steps + 1, count, agents]);
                let memory = after.map(|after| {
                    let before =
                        Tensor::cat(&[&memory.unsqueeze(0), &after.narrow(0, 0, steps)], 0);
                    let last = after.get(steps - 1).view([count, agents, width]);
                    (before.view([steps + 1, count, agents, width]), last)
                });
                (values, memory)
            });
            let (values, memories): (Vec<_>, Vec<_>) = pieces.unzip();
            let (before, last): (Vec<_>, Vec<_>) = memories.into_iter().flatten().unzip();
            let memory = (width > 0).then(|| (Tensor::cat(&before, 1), Tensor::cat(&last, 0)));
            (Tensor::cat(&values, 1), memory)
        });
        let (values, memories): (Vec<_>, Vec<_>) = parts.into_iter().unzip();
        let of = |shape: fn([i64; 4]) -> Vec<i64>| -> Vec<Vec<i64>> {
            counts.iter().map(|count| shape([steps + 1, *count, agents, width])).collect()
        };
        if width > 0 {
            let (before, last) = memories.into_iter().flatten().unzip();
            let before = self.gather(before, &of(|shape| shape.to_vec()));
            let last =
                self.gather(last, &of(|[_, count, agents, width]| vec![count, agents, width]));
            let all = Tensor::cat(&before, 1);
            batch.value_memory = all.view([(steps + 1) * envs, agents, width]);
            self.critic_memory = Some(Tensor::cat(&last, 0).view([envs * agents, width]));
        }
        let values =
            self.gather(values, &of(|[steps, count, agents, _]| vec![steps, count, agents]));
        Tensor::cat(&values, 1).view([-1, agents])
    }

    /// Returns this rank's pieces of the work. There must not be more pieces than shards.
    fn own<T>(&self, all: Vec<T>) -> Vec<T> {
        let (own, count) = (ranks::part(&*self.ranks, self.shards), all.len());
        assert!(count <= self.shards, "{count} pieces of work for {} shards", self.shards);
        let pieces = all.into_iter().enumerate();
        pieces.filter(|(k, _)| own.contains(&(k * self.shards / count))).map(|(_, it)| it).collect()
    }

    /// Returns the tensors of all parts, in order, from those that this rank has computed. `shapes`
    /// has the shape of each.
    fn gather(&self, own: Vec<Tensor>, shapes: &[Vec<i64>]) -> Vec<Tensor> {
        if self.ranks.size() == 1 {
            return own;
        }
        let flat = own.iter().flat_map(|tensor| {
            Vec::<f32>::try_from(tensor.reshape([-1])).expect("values are floats")
        });
        let all = ranks::gather_numbers(&*self.ranks, &flat.collect::<Vec<f32>>());
        let mut rest = &all[..];
        let tensor = |shape: &Vec<i64>| {
            let (first, others) = rest.split_at(shape.iter().product::<i64>() as usize);
            rest = others;
            Tensor::from_slice(first).view(&shape[..]).to_device(self.device)
        };
        shapes.iter().map(tensor).collect()
    }

    /// Adds up the reports of all ranks' shards, in their order.
    fn gather_reports(&self, own: &[Report]) -> Report {
        let values: Vec<f64> = own.iter().flatten().map(|(_, value)| *value).collect();
        let all = ranks::gather_numbers(&*self.ranks, &values);
        // A rank without a shard in this minibatch does not know the names; the first rank does.
        let Some(first) = own.first() else { return Report::new() };
        let mut sums = vec![0.0; first.len()];
        for (number, shard) in all.chunks_exact(first.len()).enumerate() {
            for (sum, value) in sums.iter_mut().zip(shard) {
                *sum = if number == 0 { *value } else { *sum + value };
            }
        }
        first.iter().zip(sums).map(|((name, _), sum)| (*name, sum)).collect()
    }

    /// Makes one gradient step on a minibatch and returns the diagnostics. `rate` is
    /// [`Networks::rate`] of this pass.
    fn step(
        &mut self,
        batch: &Batch,
        parts: Vec<Part>,
        settings: &Settings,
        rate: impl Fn(ParameterGroup) -> Option<f64>,
    ) -> Result<Report, Error> {
        // The reference updates the normalisation in every evaluation of the value loss.
        let returns: Vec<Tensor> =
            parts.iter().flatten().map(|shard| shard.active(&batch.returns)).collect();
        self.value_norm.update(&Tensor::cat(&returns, 0));
        let norm = self.value_norm;
        let items: Vec<_> = parts.into_iter().map(|part| (batch.share(), part)).collect();
        let reports = self.parallel(self.own(items), |networks, (batch, part)| {
            let mut sums = Report::new();
            for shard in &part {
                let loss = networks.loss(&batch, shard, settings, &norm);
                (&loss.total * shard.weight).backward();
                let weighted = |(name, value)| (name, shard.weight * scalar(&value));
                add(&mut sums, loss.report.into_iter().map(weighted));
            }
            sums
        });
        let mut report = self.gather_reports(&reports);
        if self.ranks.size() > 1 {
            self.weights.gather_from(&*self.ranks);
        }
        report.extend(self.weights.step_all(MAX_GRAD_NORM, rate)?);
        Ok(report)
    }
}

impl<N: Networks> Algorithm for ActorCritic<N> {
    fn name(&self) -> &'static str {
        N::NAME
    }

    fn memory(&self) -> usize {
        self.networks().memory() as usize
    }

    fn training_memory(&self) -> usize {
        self.memory() + self.networks().radio().map_or(0, |radio| radio.memory() as usize)
    }

    fn graph_noise(&self, agents: usize) -> usize {
        self.networks().graph_noise(agents as i64) as usize
    }

    fn graph_lasts(&self) -> bool {
        N::GRAPH_LASTS
    }

    fn deviations(&self) -> Vec<f32> {
        self.networks().head().deviations()
    }

    fn act(&self, input: &Observation, mode: &ActMode) -> Decision {
        let device = self.device;
        let decide = |networks: &N, input: &Observation, mode: &ActMode| {
            act_on(device, input, mode, |input, mode| networks.act(input, mode))
        };
        let ActMode::Sample { action, .. } = mode else {
            // Evaluations are not divided, so that their results do not depend on the shards.
            return decide(&self.networks(), input, mode);
        };
        let (envs, agents, actions) = action.size3().expect("[E, N, A]");
        // Most of what a GPU needs for a decision is the start of operations.
        let most = if device.is_cuda() { 1 } else { self.shards };
        let worlds = divided(envs, parts_of_decisions(envs, agents, most));
        if worlds.len() == 1 {
            return decide(&self.networks(), input, mode);
        }
        let parts = worlds.iter().map(|worlds| (input.of(worlds), mode.of(worlds))).collect();
        let parts = self.parallel(self.own(parts), |networks, (input, mode)| {
            decide(networks, &input, &mode).joined()
        });
        let memory = input.memory.size()[2];
        let shape =
            |worlds: &Range<i64>| vec![worlds.end - worlds.start, agents, 2 * actions + memory];
        let shapes: Vec<Vec<i64>> = worlds.iter().map(shape).collect();
        Decision::parted(&Tensor::cat(&self.gather(parts, &shapes), 0), actions)
    }

    fn message_width(&self) -> usize {
        self.networks().message_width() as usize
    }

    fn has_radio(&self) -> bool {
        self.networks().radio().is_some()
    }

    fn act_through(
        &self,
        input: &Observation,
        channel: &Channel,
        noise: &ChannelNoise,
    ) -> Decision {
        let (input, noise) = (input.to(self.device), noise.to(self.device));
        no_grad(|| self.networks().act_through(&input, channel, &noise)).to(Device::Cpu)
    }

    fn inspect(&self, input: &Observation, state: &Tensor) -> Diagnostics {
        let (input, state) = (input.to(self.device), state.to_device(self.device));
        let networks = self.networks();
        let (value, graph) =
            no_grad(|| (networks.critic().value(&input, &state), networks.graph(&input)));
        Diagnostics {
            value: value.map(|value| self.value_norm.denormalize(&value).to_device(Device::Cpu)),
            graph: graph.map(|graph| graph.to_device(Device::Cpu)),
        }
    }

    fn reconstruct(&self, input: &Observation, state: &Tensor) -> Vec<Reconstruction> {
        let (input, state) = (input.to(self.device), state.to_device(self.device));
        let all = no_grad(|| self.networks().reconstruct(&input, &state));
        all.iter().map(|one| one.to(Device::Cpu)).collect()
    }

    fn update_until(
        &mut self,
        rollout: &Rollout,
        parameters: &UpdateParameters,
        seed: Seed,
        stop: Stop<'_>,
    ) -> Result<Losses, Error> {
        // The state consists of views of weights and moments.
        let before: Vec<_> =
            self.state().into_iter().map(|(name, tensor)| (name, tensor.copy())).collect();
        let mut settings = self.settings.clone();
        settings.ppo.entropy_coefficient = parameters.entropy_coefficient;
        let (ppo, network) = (&settings.ppo, &settings.network);
        let length = if self.networks().is_recurrent() { network.chunk_length } else { 1 };
        let mut batch = Batch::new(rollout, self.device);
        // Where the policy samples graphs, the noise of graphs follows the schedule, in the policy
        // and in the value function.
        let imposed =
            rollout.sizes.graph_noise > 0 && self.settings.exploration.mode == NoiseMode::Schedule;
        let scale = if imposed { parameters.log_std.exp() } else { 1.0 };
        let width = self.networks().critic().graph_noise(rollout.sizes.agents as i64);
        if width > 0 {
            batch.value_graph =
                graph_noise(rollout, width, scale, self.device, seed.child("graph"));
        }
        let outputs = self.values(&mut batch, rollout);
        batch.estimate(rollout, &outputs, &self.value_norm, [ppo.gamma, ppo.gae_lambda], N::TEAM);
        let mut means = Means::default();
        for epoch in 0..ppo.epochs {
            let order = seed.child("epoch").index(epoch as u64);
            let pass = self.passes;
            for parts in
                minibatches(rollout, length, ppo.minibatch, self.shards, self.device, order)
            {
                if stop() {
                    self.load(&before)?;
                    return Err(Error::Stopped);
                }
                let rate = |group| N::rate(group, pass, parameters.learning_rate);
                means.add(&self.step(&batch, parts, &settings, rate)?);
            }
            self.passes += 1;
        }
        self.networks().head().impose(parameters.log_std);
        self.weights.follow_average(ppo.average);
        let mut more = vec![("ppo/explained_variance", batch.explained_variance)];
        more.extend(self.networks().head().std().map(|std| ("ppo/std", std)));
        more.push(("ppo/learning_rate", parameters.learning_rate));
        means.finish(&more)
    }

    fn swap_average(&mut self) {
        self.weights.swap_average();
    }

    fn state(&self) -> Vec<(String, Tensor)> {
        let mut state = self.weights.state();
        state.push(value_norm_entry(&self.value_norm));
        state.push(("passes/count".to_owned(), Tensor::from(self.passes as i64)));
        if let Some(memory) = &self.critic_memory {
            state.push(("critic_memory/last".to_owned(), memory.to_device(Device::Cpu).copy()));
        }
        state
    }

    fn load(&mut self, state: &[(String, Tensor)]) -> Result<(), Error> {
        self.weights.load(state)?;
        load_value_norm(&mut self.value_norm, state)?;
        // Checkpoints without a count are from runs whose rollouts ended whole periods of passes.
        let passes = part(state, "passes");
        self.passes = passes.first().map_or(0, |(_, count)| count.int64_value(&[]) as usize);
        self.critic_memory =
            part(state, "critic_memory").first().map(|(_, t)| t.to_device(self.device).copy());
        Ok(())
    }

    fn load_weights(&mut self, state: &[(String, Tensor)]) -> Result<(), Error> {
        if let Some(path) = N::PER_AGENT {
            let trained = state.iter().find(|(name, _)| name == path).map(|(_, t)| t.size()[0]);
            if let (Some(trained), Some(agents)) = (trained, self.weights.rows(path)) {
                check_agents(N::NAME, trained, agents)?;
            }
        }
        self.weights.load_weights(state)?;
        load_value_norm(&mut self.value_norm, state)
    }

    fn parameters(&self) -> (i64, i64) {
        self.weights.parameters(N::TRAINING_ONLY)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decisions_are_divided_where_there_are_enough() {
        let count = |envs, agents, most| parts_of_decisions(envs, agents, most);
        assert_eq!((count(16, 8, 8), count(16, 16, 8), count(16, 48, 8)), (1, 2, 5));
        // Other tests count on these.
        assert_eq!((count(8, 33, 2), count(52, 5, 3)), (2, 2));
        for (envs, agents) in [(1, 1), (3, 86), (7, 48), (16, 48), (100, 3), (5, 700)] {
            for most in 1..9 {
                let worlds = divided(envs, parts_of_decisions(envs, agents, most));
                let all: Vec<i64> = worlds.iter().cloned().flatten().collect();
                assert_eq!(all, (0..envs).collect::<Vec<_>>());
                let enough = |part: &Range<i64>| (part.end - part.start) * agents >= 128;
                assert!(worlds.len() == 1 || worlds.iter().all(enough), "{envs} {agents} {most}");
            }
        }
    }

    /// The value function reads each world once, and not more samples at once than it may.
    #[test]
    fn values_are_computed_in_pieces() {
        for (first, last, samples) in [(0, 16, 1032), (8, 16, 6192), (3, 8, 99_072), (0, 1, 1)] {
            let pieces: Vec<_> = pieces_of(first..last, samples).collect();
            let all: Vec<i64> = pieces.iter().cloned().flatten().collect();
            assert_eq!(all, (first..last).collect::<Vec<_>>());
            let count = |piece: &Range<i64>| piece.end - piece.start;
            let few = |piece| count(piece) == 1 || count(piece) * samples <= MOST_VALUES;
            assert!(pieces.iter().all(few), "{pieces:?}");
        }
        assert_eq!(pieces_of(0..16, 1032).count(), 1, "small rollouts are read at once");
    }
}
