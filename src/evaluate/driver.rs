//! Computes the actions of a policy in the worlds of an evaluation.

use rand::RngExt as _;
use tch::{Device, Kind, Tensor};

use super::{Policy, WORLDS, Watch};
use crate::algo::{ActMode, Channel, ChannelNoise, Diagnostics, Observation};
use crate::env::{Frame, Task, VecEnv};
use crate::replay::RecordedDiagnostics;
use crate::rng::{self, Seed};

/// Computes actions from frames. All randomness depends only on seed, episode and step.
pub(super) struct PolicyDriver<'a> {
    policy: &'a Policy<'a>,
    task: &'a Task,
    seed: Seed,
    pub(super) actions: Vec<f32>,
    observation: Vec<f32>,
    comm: Vec<f32>,
    start: Vec<f32>,
    state: Vec<f32>,
    active: Vec<f32>,
    memory: Tensor,
    decisions: u64,
}

/// Number of decisions between two samples of the latent.
const LOOK: u64 = 8;

impl<'a> PolicyDriver<'a> {
    pub(super) fn new(policy: &'a Policy<'a>, task: &'a Task, seed: Seed) -> Self {
        let (worlds, n) = (WORLDS, task.agents);
        let memory = match policy {
            Policy::Learned(learner, channel) => {
                learner.memory() + channel.memory(learner.message_width())
            }
            _ => 0,
        };
        Self {
            policy,
            task,
            seed,
            actions: vec![0.0; worlds * n * task.spec.actions.len()],
            observation: vec![0.0; worlds * n * task.spec.observation.len()],
            comm: vec![0.0; worlds * n * n],
            start: vec![0.0; worlds],
            state: vec![0.0; worlds * n * task.spec.state.len()],
            active: vec![0.0; worlds * n],
            decisions: 0,
            memory: Tensor::zeros(
                [worlds as i64, n as i64, memory as i64],
                (Kind::Float, Device::Cpu),
            ),
        }
    }

    pub(super) fn act(&mut self, env: &VecEnv, watch: &mut Watch<'_>) {
        let worlds = env.worlds();
        let watched = env
            .worlds()
            .enumerate()
            .find(|(_, world)| watch.recorder.as_ref().is_some_and(|r| r.watches(world)));
        let mut diagnostics = RecordedDiagnostics::default();
        let width = self.task.agents * self.task.spec.actions.len();
        match self.policy {
            Policy::Throttle(throttle) => {
                // With two actions, the first is the steering.
                let actions = self.task.spec.actions.len();
                for action in self.actions.chunks_mut(actions) {
                    action.fill(0.0);
                    action[actions - 1] = *throttle;
                }
            }
            Policy::Pursuit(pursuit) => {
                worlds
                    .zip(self.actions.chunks_mut(width))
                    .for_each(|(world, acts)| world.pursue(*pursuit, acts));
            }
            Policy::Sumo => {}
            Policy::Gaussian | Policy::Uniform => {
                for (world, actions) in worlds.zip(self.actions.chunks_mut(width)) {
                    let mut rng =
                        self.seed.index(world.episode()).index(u64::from(world.step_count())).rng();
                    if matches!(self.policy, Policy::Gaussian) {
                        rng::fill_normal(&mut rng, actions);
                    } else {
                        actions.fill_with(|| rng.random_range(-1.0..1.0));
                    }
                }
            }
            Policy::Learned(learner, channel) => {
                let n = self.task.agents;
                let copy = |from: &[f32], to: &mut [f32], e: usize| {
                    to[e * from.len()..(e + 1) * from.len()].copy_from_slice(from);
                };
                let mut sources = [Seed::new(0); WORLDS];
                let mut episodes = [0; WORLDS];
                for (e, world) in worlds.enumerate() {
                    episodes[e] = world.episode();
                    sources[e] =
                        self.seed.index(world.episode()).index(u64::from(world.step_count()));
                    let frame: &Frame = world.frame();
                    copy(&frame.observation, &mut self.observation, e);
                    copy(&frame.comm, &mut self.comm, e);
                    copy(&frame.state, &mut self.state, e);
                    copy(&frame.active, &mut self.active, e);
                    self.start[e] = f32::from(u8::from(frame.start));
                }
                let (e, n) = (self.start.len() as i64, n as i64);
                let observation = Observation {
                    observation: Tensor::from_slice(&self.observation).view([e, n, -1]),
                    comm: Tensor::from_slice(&self.comm).view([e, n, n]),
                    start: Tensor::from_slice(&self.start),
                    memory: self.memory.shallow_clone(),
                };
                let decision = if channel.is_perfect() {
                    learner.act(&observation, &ActMode::Deterministic)
                } else {
                    let noise = channel_noise(
                        channel,
                        &sources,
                        &self.comm,
                        self.task.agents,
                        learner.message_width(),
                    );
                    learner.act_through(&observation, channel, &noise)
                };
                // Latents are evaluated only with undisturbed messages.
                if self.decisions.is_multiple_of(LOOK) && channel.is_perfect() {
                    let state = Tensor::from_slice(&self.state).view([e, n, -1]);
                    let active = Tensor::from_slice(&self.active).view([e, n]);
                    let reconstructions = learner.reconstruct(&observation, &state);
                    watch.knowledge.add(
                        &reconstructions,
                        &observation.observation,
                        &active,
                        &episodes,
                    );
                }
                self.decisions += 1;
                if let Some((world, _)) = watched.filter(|_| channel.is_perfect()) {
                    let state = Tensor::from_slice(&self.state).view([e, n, -1]);
                    diagnostics = recorded(&learner.inspect(&observation, &state), world as i64);
                }
                self.memory = decision.memory;
                let count = self.actions.len();
                decision.action.reshape([-1]).copy_data(&mut self.actions, count);
            }
        }
        if let (Some(recorder), Some((e, world))) = (&mut watch.recorder, watched) {
            let actions = if matches!(self.policy, Policy::Sumo) {
                &[][..]
            } else {
                &self.actions[e * width..][..width]
            };
            recorder.decide(world, actions, &diagnostics);
        }
    }
}

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
        let in_range = pair / agents != pair % agents && comm[k] > 0.0;
        if in_range && f64::from(falsified[k]) < channel.falsified {
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
