//! Learned policies in an evaluation: they act deterministically, and messages pass through a
//! channel.

use std::collections::BTreeMap;

use rand::RngExt as _;
use tch::{Device, Kind, Tensor};

use super::knowledge::Sums;
use super::{Actor, Controller, Knowledge, WORLDS};
use crate::algo::{
    ActMode, Algorithm, Channel, ChannelNoise, Diagnostics, Observation, store_frames,
};
use crate::env::{self, EnvSpec, WorldPhase, Worlds};
use crate::replay::RecordedDiagnostics;
use crate::rng::{self, Seed};
use crate::rollout::{Rollout, Sizes};

/// Number of decisions between two samples of the latent.
const LOOK: u64 = 8;

/// A trained policy, which acts deterministically, and the channel through which its messages pass.
pub struct LearnedPolicy<'a> {
    /// The policy.
    pub learner: &'a dyn Algorithm,
    /// The radio through which its messages pass.
    pub channel: Channel,
}

impl Controller for LearnedPolicy<'_> {
    fn actor<'a>(&'a self, spec: &'a EnvSpec, seed: Seed) -> Box<dyn Actor + 'a> {
        let mut actor = LearnedActor {
            policy: self,
            spec,
            seed,
            sums: Sums::default(),
            sent: BTreeMap::new(),
            decisions: 0,
            frames: Rollout::new(Sizes {
                steps: 0,
                envs: WORLDS,
                agents: spec.agents,
                observation: spec.observation.len(),
                state: spec.state.len(),
                actions: 0,
                choices: spec.actions.choices().unwrap_or(0),
                memory: 0,
                graph_noise: 0,
            }),
            memory: Tensor::new(),
        };
        actor.begin();
        Box::new(actor)
    }
}

struct LearnedActor<'a> {
    policy: &'a LearnedPolicy<'a>,
    spec: &'a EnvSpec,
    seed: Seed,
    sums: Sums,
    /// Bits sent, and decisions, of each episode.
    sent: BTreeMap<u64, (f64, f64)>,
    decisions: u64,
    /// The present frames of [`WORLDS`] worlds, in its only row.
    frames: Rollout,
    memory: Tensor,
}

impl Actor for LearnedActor<'_> {
    fn begin(&mut self) {
        let LearnedPolicy { learner, channel } = self.policy;
        self.frames = Rollout::new(self.frames.sizes);
        let memory = learner.memory() + channel.memory(learner.message_width());
        self.memory = Tensor::zeros(
            [WORLDS as i64, self.spec.agents as i64, memory as i64],
            (Kind::Float, Device::Cpu),
        );
        self.decisions = 0;
    }

    fn act(
        &mut self,
        worlds: &dyn Worlds,
        actions: &mut [f32],
        watched: Option<usize>,
    ) -> Result<RecordedDiagnostics, env::Error> {
        let LearnedPolicy { learner, channel } = self.policy;
        let mut sources = [Seed::new(0); WORLDS];
        let mut episodes = [0; WORLDS];
        for e in 0..worlds.count() {
            let view = worlds.view(e);
            episodes[e] = view.episode;
            if view.step == 0 {
                // An episode that SUMO's death has ended is played again.
                self.sent.remove(&view.episode);
            }
            sources[e] = self.seed.index(view.episode).index(u64::from(view.step));
        }
        store_frames(worlds, &mut self.frames, 0);
        // A world with nothing left to play keeps its last frame, whose agents are gone.
        for e in (0..worlds.count()).filter(|&e| worlds.view(e).phase == WorldPhase::Idle) {
            let pairs = self.frames.cell(0, e, self.spec.agents);
            self.frames.comm[pairs].fill(0.0);
        }
        let observation = Observation::at(&self.frames, 0, &self.memory);
        let per_agent = |array: &[f32], shape: &[i64]| {
            let shape = [&[WORLDS as i64, self.spec.agents as i64][..], shape].concat();
            Tensor::from_slice(array).view(&shape[..])
        };
        let noise = (!channel.is_perfect()).then(|| {
            channel_noise(
                channel,
                &sources,
                &self.frames.comm,
                self.spec.agents,
                learner.message_width(),
            )
        });
        let decision = match &noise {
            None => learner.act(&observation, &ActMode::Deterministic),
            Some(noise) => learner.act_through(&observation, channel, noise),
        };
        let state = || per_agent(&self.frames.state, &[self.frames.sizes.state as i64]);
        // Latents are evaluated only with undisturbed messages.
        if noise.is_none() && self.decisions.is_multiple_of(LOOK) {
            let active = per_agent(&self.frames.active, &[]);
            let all = learner.reconstruct(&observation, &state());
            self.sums.add(&all, &observation.observation, &active, &episodes);
        }
        let diagnostics = watched.map_or_else(RecordedDiagnostics::default, |world| {
            let own = self.memory.narrow(2, 0, learner.memory() as i64);
            let mut all = learner.inspect(&observation.with_memory(own), &state());
            if let (Some(graph), Some(noise)) = (&mut all.graph, &noise) {
                // Only messages that are not lost are heard.
                *graph *= channel.arrived(noise);
            }
            recorded(&all, world as i64)
        });
        let bits = channel.message_bits(learner.message_width());
        if bits > 0.0 {
            count_bits(&self.frames, &episodes, bits, &mut self.sent);
        }
        self.decisions += 1;
        self.memory = decision.memory;
        decision.action.reshape([-1]).copy_data(actions, actions.len());
        Ok(diagnostics)
    }

    fn knowledge(&self) -> Vec<Knowledge> {
        self.sums.finish()
    }

    fn message_bits(&self) -> Vec<f64> {
        let decided = self.sent.values().filter(|(_, decisions)| *decisions > 0.0);
        decided.map(|(bits, decisions)| bits / decisions).collect()
    }
}

/// Adds the bits that each world's active agents send in a decision, and the number of these
/// agents, to the sums of the world's episode. An agent with no other agent in range sends nothing.
fn count_bits(frames: &Rollout, episodes: &[u64], bits: f64, sent: &mut BTreeMap<u64, (f64, f64)>) {
    let n = frames.sizes.agents;
    let worlds = frames.active.chunks(n).zip(frames.comm.chunks(n * n)).zip(episodes);
    for ((active, comm), episode) in worlds {
        let sum = sent.entry(*episode).or_default();
        for sender in (0..n).filter(|&sender| active[sender] > 0.5) {
            let heard = (0..n).any(|other| other != sender && comm[other * n + sender] > 0.5);
            sum.0 += if heard { bits } else { 0.0 };
            sum.1 += 1.0;
        }
    }
}

/// Returns the diagnostics of one world.
fn recorded(diagnostics: &Diagnostics, world: i64) -> RecordedDiagnostics {
    let numbers = |tensor: &Option<Tensor>| {
        let tensor = tensor.as_ref().map(|t| t.get(world).reshape([-1]));
        tensor.and_then(|t| Vec::try_from(t).ok()).unwrap_or_default()
    };
    RecordedDiagnostics { value: numbers(&diagnostics.value), graph: numbers(&diagnostics.graph) }
}

/// Returns the randomness of a channel, which depends only on each world's episode and step.
/// Falsified messages get a content where a receiver is in range according to `comm [E, N, N]`;
/// elsewhere the content is zero.
fn channel_noise(
    channel: &Channel,
    sources: &[Seed],
    comm: &[f32],
    agents: usize,
    width: usize,
) -> ChannelNoise {
    let (e, n) = (sources.len() as i64, agents as i64);
    let uniform = |what: &str| -> Vec<f32> {
        let draws = sources.iter().flat_map(|seed| {
            let mut rng = seed.child(what).rng();
            std::iter::repeat_with(move || rng.random::<f32>()).take(agents * agents)
        });
        draws.collect()
    };
    let (lost, falsified) = (uniform("lost"), uniform("falsified"));
    // Without falsified messages, or for algorithms without messages, a content of width 1
    // suffices.
    let width = if channel.falsified > 0.0 { width.max(1) } else { 1 };
    let mut content = vec![0.0; falsified.len() * width];
    for (k, content) in content.chunks_mut(width).enumerate() {
        let (world, pair) = (k / (agents * agents), k % (agents * agents));
        let arrives = pair / agents != pair % agents && comm[k] > 0.0;
        if arrives && f64::from(falsified[k]) < channel.falsified {
            rng::fill_normal(
                &mut sources[world].child("content").index(pair as u64).rng(),
                content,
            );
        }
    }
    let view = |values: &[f32]| Tensor::from_slice(values).view([e, n, n, -1]);
    let flat = |values: &[f32]| view(values).squeeze_dim(-1);
    ChannelNoise { lost: flat(&lost), falsified: flat(&falsified), content: view(&content) }
}
