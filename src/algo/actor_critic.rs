//! Training by proximal policy optimisation, for all methods that implement [`Networks`]: passes
//! over a rollout, on as many threads as minibatches have shards.
//!
//! Every shard has a copy of the networks. The copies share their weights and have gradients of
//! their own, which are added up before a step. All cores are busy in forward and backward passes
//! without a thread pool inside libtorch, and the result depends on the number of shards alone, not
//! on the machine.

use rayon::prelude::*;
use tch::{Device, Kind, Tensor, no_grad};

use super::batch::{Batch, Shard, graph_noise, minibatches};
use super::decision::{ActMode, Decision, Diagnostics, Observation, Reconstruction};
use super::device::act_on;
use super::means::{Means, scalar};
use super::networks::Networks;
use super::parameters::{
    ParameterBuilder, ParameterGroup, Weights, load_value_norm, part, value_norm_entry,
};
use super::ppo::MAX_GRAD_NORM;
use super::settings::{NoiseMode, Settings};
use super::{Algorithm, Channel, ChannelNoise, Error, Losses, UpdateParameters, check_agents};
use crate::env::EnvSpec;
use crate::nn::ValueNorm;
use crate::rng::Seed;
use crate::rollout::Rollout;

/// An algorithm whose networks are trained by proximal policy optimisation.
pub(super) struct ActorCritic<N> {
    /// One copy of the networks per shard.
    copies: Vec<N>,
    pool: Option<rayon::ThreadPool>,
    settings: Settings,
    device: Device,
    weights: Weights,
    value_norm: ValueNorm,
    /// Memory of a recurrent critic after the last rollout, `[E · N, M]`.
    critic_memory: Option<Tensor>,
}

impl<N: Networks> ActorCritic<N> {
    /// Creates a learner with initial weights drawn from `seed`.
    pub(super) fn new(spec: &EnvSpec, settings: &Settings, seed: Seed, device: Device) -> Self {
        let build = || {
            let mut builder = ParameterBuilder::new(seed, device);
            let networks = N::new(spec, settings, &mut builder);
            (networks, builder)
        };
        let (networks, builder) = build();
        let mut weights = Weights::new(builder, settings.ppo.average > 0.0);
        let mut copies = vec![networks];
        // A GPU works on one shard at a time, so that a second one would bring nothing.
        let shards = if device.is_cuda() { 1 } else { settings.ppo.shards.max(1) };
        for _ in 1..shards {
            let (networks, builder) = build();
            builder.replicate(&mut weights);
            copies.push(networks);
        }
        let threads = rayon::ThreadPoolBuilder::new()
            .num_threads(shards)
            .thread_name(|k| format!("shard{k}"));
        // Libtorch keeps its number of threads for each calling thread.
        let threads = threads.start_handler(|_| tch::set_num_threads(1));
        Self {
            copies,
            pool: (shards > 1).then(|| threads.build().expect("threads can be started")),
            settings: settings.clone(),
            device,
            weights,
            value_norm: ValueNorm::default(),
            critic_memory: None,
        }
    }

    /// Applies `work` in parallel to each item, each with its own copy of the networks. Returns the
    /// results in order.
    fn parallel<T: Send, R: Send>(
        &mut self,
        items: Vec<T>,
        work: impl Fn(&N, T) -> R + Sync,
    ) -> Vec<R> {
        let pairs = self.copies.iter_mut().zip(items);
        match &self.pool {
            None => pairs.map(|(networks, item)| work(networks, item)).collect(),
            Some(pool) => {
                let pairs: Vec<_> = pairs.collect();
                pool.install(|| {
                    pairs.into_par_iter().map(|(networks, item)| work(networks, item)).collect()
                })
            }
        }
    }

    /// Returns the values (normalised) of all rows, `[(T + 1) · E, N]`, and writes the value
    /// function's memory before each row into `batch`.
    fn values(&mut self, batch: &mut Batch, rollout: &Rollout) -> Tensor {
        let (steps, envs) = (rollout.sizes.steps as i64, rollout.sizes.envs as i64);
        let (agents, width) = (rollout.sizes.agents as i64, self.copies[0].critic().memory());
        let carried = self.critic_memory.take();
        let carried = carried
            .unwrap_or_else(|| Tensor::zeros([envs * agents, width], (Kind::Float, self.device)));
        let share = (envs as usize).div_ceil(self.copies.len()) as i64;
        let parts: Vec<_> = (0..envs)
            .step_by(share as usize)
            .map(|first| {
                let count = share.min(envs - first);
                let memory = carried
                    .view([envs, agents, width])
                    .narrow(0, first, count)
                    .reshape([count * agents, width]);
                (count, batch.of_envs(envs, first, count), memory)
            })
            .collect();
        let parts = self.parallel(parts, |networks, (count, part, memory)| {
            no_grad(|| {
                let (values, after) = networks.critic().values(&part, steps + 1, &memory);
                let values = values.view([steps + 1, count, agents]);
                let memory = after.map(|after| {
                    let before =
                        Tensor::cat(&[&memory.unsqueeze(0), &after.narrow(0, 0, steps)], 0);
                    let last = after.get(steps - 1).view([count, agents, width]);
                    (before.view([steps + 1, count, agents, width]), last)
                });
                (values, memory)
            })
        });
        let joined = |tensors: Vec<&Tensor>, dim: i64| Tensor::cat(&tensors, dim);
        if width > 0 {
            let memories = || parts.iter().filter_map(|(_, memory)| memory.as_ref());
            batch.value_memory = joined(memories().map(|m| &m.0).collect(), 1).view([
                (steps + 1) * envs,
                agents,
                width,
            ]);
            self.critic_memory =
                Some(joined(memories().map(|m| &m.1).collect(), 0).view([envs * agents, width]));
        }
        joined(parts.iter().map(|(values, _)| values).collect(), 1).view([-1, agents])
    }

    /// Makes one gradient step on a minibatch and returns the diagnostics. `rate` is
    /// [`Networks::rate`] of this pass.
    fn step(
        &mut self,
        batch: &Batch,
        shards: Vec<Shard>,
        rate: impl Fn(ParameterGroup) -> Option<f64>,
    ) -> Result<Vec<(&'static str, f64)>, Error> {
        // The reference updates the normalisation in every evaluation of the value loss.
        let returns: Vec<Tensor> =
            shards.iter().map(|shard| shard.active(&batch.returns)).collect();
        self.value_norm.update(&Tensor::cat(&returns, 0));
        let (norm, settings) = (self.value_norm, self.settings.clone());
        let items: Vec<_> = shards.into_iter().map(|shard| (batch.share(), shard)).collect();
        let reports = self.parallel(items, |networks, (batch, shard)| {
            let loss = networks.loss(&batch, &shard, &settings, &norm);
            (&loss.total * shard.weight).backward();
            loss.report
                .iter()
                .map(|(name, value)| (*name, shard.weight * scalar(value)))
                .collect::<Vec<_>>()
        });
        let mut report = reports.into_iter().reduce(|mut sums, part| {
            sums.iter_mut().zip(part).for_each(|(sum, value)| sum.1 += value.1);
            sums
        });
        let report = report.get_or_insert_default();
        report.extend(self.weights.step_all(MAX_GRAD_NORM, rate)?);
        Ok(std::mem::take(report))
    }
}

impl<N: Networks> Algorithm for ActorCritic<N> {
    fn name(&self) -> &'static str {
        N::NAME
    }

    fn memory(&self) -> usize {
        self.copies[0].memory() as usize
    }

    fn training_memory(&self) -> usize {
        self.memory() + self.copies[0].radio().map_or(0, |radio| radio.memory() as usize)
    }

    fn graphs(&self) -> usize {
        N::GRAPHS
    }

    fn graph_lasts(&self) -> bool {
        N::GRAPH_LASTS
    }

    fn act(&self, input: &Observation, mode: &ActMode<'_>) -> Decision {
        act_on(self.device, input, mode, |input, mode| self.copies[0].act(input, mode))
    }

    fn message_width(&self) -> usize {
        self.copies[0].message_width() as usize
    }

    fn act_through(
        &self,
        input: &Observation,
        channel: &Channel,
        noise: &ChannelNoise,
    ) -> Decision {
        let (input, noise) = (input.to(self.device), noise.to(self.device));
        no_grad(|| self.copies[0].act_through(&input, channel, &noise)).to(Device::Cpu)
    }

    fn inspect(&self, input: &Observation, state: &Tensor) -> Diagnostics {
        let (input, state) = (input.to(self.device), state.to_device(self.device));
        let networks = &self.copies[0];
        let (value, graph) =
            no_grad(|| (networks.critic().value(&input, &state), networks.graph(&input)));
        Diagnostics {
            value: value.map(|value| self.value_norm.denormalize(&value).to_device(Device::Cpu)),
            graph: graph.map(|graph| graph.to_device(Device::Cpu)),
        }
    }

    fn reconstruct(&self, input: &Observation, state: &Tensor) -> Vec<Reconstruction> {
        let (input, state) = (input.to(self.device), state.to_device(self.device));
        let all = no_grad(|| self.copies[0].reconstruct(&input, &state));
        all.iter().map(|one| one.to(Device::Cpu)).collect()
    }

    fn update(
        &mut self,
        rollout: &Rollout,
        parameters: &UpdateParameters,
        seed: Seed,
    ) -> Result<Losses, Error> {
        let settings = self.settings.clone();
        let (ppo, network) = (&settings.ppo, &settings.network);
        let length = if self.copies[0].is_recurrent() { network.chunk_length } else { 1 };
        let mut batch = Batch::new(rollout, self.device);
        // Where the policy samples graphs, the noise of graphs follows the schedule, in the policy
        // and in the value function.
        let imposed = N::GRAPHS > 0 && self.settings.exploration.mode == NoiseMode::Schedule;
        let scale = if imposed { parameters.log_std.exp() } else { 1.0 };
        if N::VALUE_SAMPLES_GRAPH {
            batch.value_graph = graph_noise(rollout, scale, self.device, seed.child("graph"));
        }
        let outputs = self.values(&mut batch, rollout);
        batch.estimate(
            rollout,
            &outputs,
            &self.value_norm,
            [parameters.gamma, ppo.gae_lambda],
            N::TEAM,
        );
        let mut means = Means::default();
        let size = ppo.minibatch * parameters.batch_growth;
        for epoch in 0..ppo.epochs {
            let order = seed.child("epoch").index(epoch as u64);
            for shards in minibatches(rollout, length, size, self.copies.len(), self.device, order)
            {
                let rate = |group| N::rate(group, epoch, parameters.learning_rate);
                means.add(&self.step(&batch, shards, rate)?);
            }
        }
        let head = self.copies[0].head();
        head.impose(parameters.log_std);
        self.weights.follow_average(ppo.average);
        let mut more = vec![("ppo/explained_variance", batch.explained_variance)];
        more.extend(head.std().map(|std| ("ppo/std", std)));
        more.push(("ppo/learning_rate", parameters.learning_rate));
        means.finish(&more)
    }

    fn swap_average(&mut self) {
        self.weights.swap_average();
    }

    fn state(&self) -> Vec<(String, Tensor)> {
        let mut state = self.weights.state();
        state.push(value_norm_entry(&self.value_norm));
        if let Some(memory) = &self.critic_memory {
            state.push(("critic_memory/last".to_owned(), memory.to_device(Device::Cpu).copy()));
        }
        state
    }

    fn load(&mut self, state: &[(String, Tensor)]) -> Result<(), Error> {
        self.weights.load(state)?;
        load_value_norm(&mut self.value_norm, state)?;
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
