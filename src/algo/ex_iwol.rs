//! Ex-IWoL: agents exchange messages at run time. The message m is the latent z: policy and value both read [m; f], and the
//! world decoder shapes m (paper: eq. for L_Ex; DongsuLeeTech/IWoL, `ExIWoL_net.py`, `ExIWoL.py`).
//!
//! Policy and value have a message path each. The graph of the policy is sampled once per decision; its noise is kept with
//! the rollout, so that the update sees the graph that acted. Deployed policies take the most likely graph.

use tch::{Device, Tensor, no_grad};

use super::core::{Batch, Core, GaussianHead, Means, Minibatch, PolicyTerms, graph_noise, scalar, value_terms};
use super::im_iwol::Decoder;
use super::message::{MessageCritic, MessageTrunk};
use super::settings::{GraphNoise, WorldTarget};
use super::{ActMode, Algorithm, Decision, Error, Losses, Observation, Settings};
use crate::env::EnvSpec;
use crate::nn::Params;
use crate::rng::Seed;
use crate::rollout::Rollout;

/// Explicit IWoL.
pub struct ExIwol {
    trunk: MessageTrunk,
    head: GaussianHead,
    world: Decoder,
    critic: MessageCritic,
    deployed: i64,
    core: Core,
}

impl ExIwol {
    /// A learner with weights drawn from `seed`.
    pub fn new(spec: &EnvSpec, settings: &Settings, seed: Seed) -> Self {
        let (mut actor, mut critic) = (Params::new(Device::Cpu), Params::new(Device::Cpu));
        let (network, iwol) = (&settings.network, &settings.iwol);
        let hidden = network.hidden;
        let mut rng = seed.child("actor").rng();
        let mut root = actor.root(&mut rng);
        let trunk = MessageTrunk::new(root.sub("trunk"), &spec.observation, network, iwol);
        let head = GaussianHead::new(root.sub("head"), 2 * hidden, spec.actions as i64, &settings.exploration);
        let target = if iwol.world_target == WorldTarget::State { spec.state.len() } else { spec.observation.len() };
        let world = Decoder::new(root.sub("world"), hidden, hidden, target as i64, true);
        let deployed =
            actor.named().iter().filter(|(name, _)| !name.starts_with("world.")).map(|(_, t)| t.numel() as i64).sum();
        let mut rng = seed.child("critic").rng();
        let message_critic = MessageCritic::new(critic.root(&mut rng), &spec.observation, network, iwol);
        Self { trunk, head, world, critic: message_critic, deployed, core: Core::new(actor, critic, settings) }
    }
}

impl Algorithm for ExIwol {
    fn name(&self) -> &'static str {
        "ex-iwol"
    }

    fn memory(&self) -> usize {
        self.trunk.memory() as usize
    }

    fn samples_graph(&self) -> bool {
        true
    }

    fn act(&self, input: &Observation, mode: &ActMode<'_>) -> Decision {
        no_grad(|| {
            let (envs, agents, _) = input.observation.size3().expect("observations are [E, N, O]");
            let keep = input.keep();
            let graph = match mode {
                ActMode::Deterministic => None,
                ActMode::Sample { graph, .. } => Some(*graph),
            };
            let messages = self.trunk.forward(&input.observation, &input.memory, &keep, 1, &input.comm, graph);
            let read = Tensor::cat(&[&messages.message, &messages.embedding], -1);
            let (action, log_prob) = self.head.sample(&read, mode.action_noise());
            let memory = messages.memory.map_or_else(|| input.memory.shallow_clone(), |m| m.view([envs, agents, -1]));
            Decision { action, log_prob, memory }
        })
    }

    fn update(&mut self, rollout: &Rollout, progress: f64, seed: Seed) -> Result<Losses, Error> {
        let (ppo, iwol) = (self.core.settings.ppo.clone(), self.core.settings.iwol.clone());
        let length = if self.trunk.memory() > 0 { self.core.settings.network.chunk_length } else { 1 };
        let mut batch = Batch::new(rollout);
        let mut policy_noise = Tensor::from_slice(&rollout.graph_noise).view_as(&batch.comm);
        let mut noise = graph_noise(rollout, seed.child("graph"));
        let steps = rollout.sizes.steps as i64;
        let (outputs, memory) = self.critic.values(&batch, steps, &mut self.core.critic_memory, &noise);
        batch.estimate(rollout, &outputs, &self.core.value_norm, &ppo);
        let mut means = Means::default();
        for epoch in 0..ppo.epochs {
            if iwol.graph_noise == GraphNoise::Resampled {
                noise = graph_noise(rollout, seed.child("resampled").index(epoch as u64));
                policy_noise = graph_noise(rollout, seed.child("resampled policy").index(epoch as u64));
            }
            for mini in Minibatch::epoch(rollout, length, ppo.minibatch, seed.child("epoch").index(epoch as u64)) {
                if mini.is_empty() {
                    continue;
                }
                let (values, _) = self.critic.minibatch(&batch, &mini, &memory, &noise);
                let value = value_terms(&batch, &mini, &mini.pick(&values), &mut self.core.value_norm, &ppo);

                let messages = self.trunk.minibatch(&batch, &mini, &batch.memory, &policy_noise);
                let m = mini.pick(&messages.message);
                let input = Tensor::cat(&[&m, &mini.pick(&messages.embedding)], -1);
                let policy = PolicyTerms::new(&batch, &mini, &self.head, &input, &ppo);
                let truth = match iwol.world_target {
                    WorldTarget::State => mini.active(&batch.state),
                    WorldTarget::Observation => mini.active(&batch.observation),
                };
                let world = self.world.loss(&m, &truth);

                (&policy.loss + iwol.lambda_world * &world + &value).backward();
                let norms = self.core.step(progress)?;
                means.add(&[
                    ("loss/policy", scalar(&policy.policy)),
                    ("loss/value", scalar(&value)),
                    ("loss/world", scalar(&world)),
                    ("loss/entropy", scalar(&policy.entropy)),
                    ("ppo/approx_kl", scalar(&policy.approx_kl)),
                    ("ppo/clip_fraction", scalar(&policy.clip_fraction)),
                    ("ppo/grad_norm_actor", norms.0),
                    ("ppo/grad_norm_critic", norms.1),
                ]);
            }
        }
        self.head.schedule(&self.core.settings.exploration, progress);
        means.finish(&[
            ("ppo/explained_variance", batch.explained_variance),
            ("ppo/std", self.head.std()),
            ("ppo/learning_rate", self.core.learning_rate(progress)),
        ])
    }

    fn state(&self) -> Vec<(String, Tensor)> {
        self.core.state()
    }

    fn load(&mut self, state: &[(String, Tensor)]) -> Result<(), Error> {
        self.core.load(state)
    }

    fn parameters(&self) -> (i64, i64) {
        (self.deployed, self.core.actor.count() + self.core.critic.count())
    }
}
