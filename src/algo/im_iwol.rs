//! Im-IWoL: communication in training only. The policy acts on the local observation through the interaction-world latent
//! z; messages reach the value function alone (paper: take-away box, eq. for L_Im; DongsuLeeTech/IWoL, `ImIWoL_net.py`,
//! `ImIWoL.py`).
//!
//! - policy: encoder f, z = Enc_IW(f), Gaussian head on [z; f]
//! - value: message path m of its own, V(m, f)
//! - world decoder: z predicts the privileged state; interaction decoder: z predicts the agent's message m, which is a
//!   target and gets no gradient
//! - deployed: encoder, Enc_IW and head; no message path

use tch::{Device, Kind, Tensor, no_grad};

use super::core::{Batch, Core, GaussianHead, Means, Minibatch, PolicyTerms, graph_noise, scalar, value_terms};
use super::encoder::Encoder;
use super::mappo::{encode_active, encode_locally};
use super::message::MessageCritic;
use super::settings::{GraphNoise, PolicyInput, WorldTarget};
use super::{ActMode, Algorithm, Decision, Error, Losses, Observation, Settings};
use crate::env::EnvSpec;
use crate::nn::{Init, Linear, Params, Path};
use crate::rng::Seed;
use crate::rollout::Rollout;

/// Implicit IWoL.
pub struct ImIwol {
    encoder: Encoder,
    latent: Latent,
    head: GaussianHead,
    world: Decoder,
    interaction: Decoder,
    critic: MessageCritic,
    deployed: i64,
    core: Core,
}

/// Enc_IW: embedding to latent z.
struct Latent {
    first: Linear,
    second: Linear,
}

impl Latent {
    fn forward(&self, f: &Tensor) -> Tensor {
        self.second.forward(&self.first.forward(f).relu())
    }
}

/// A three-layer decoder, optionally ending in tanh.
pub(super) struct Decoder {
    layers: [Linear; 3],
    tanh: bool,
}

impl Decoder {
    pub(super) fn new(mut path: Path<'_>, inputs: i64, hidden: i64, outputs: i64, tanh: bool) -> Self {
        let layers = [
            Linear::new(path.sub(0), inputs, hidden, Init::Orthogonal(1.0)),
            Linear::new(path.sub(1), hidden, hidden, Init::Orthogonal(1.0)),
            Linear::new(path.sub(2), hidden, outputs, Init::Orthogonal(0.01)),
        ];
        Self { layers, tanh }
    }

    /// Mean squared error against `target`, over samples and dimensions.
    pub(super) fn loss(&self, x: &Tensor, target: &Tensor) -> Tensor {
        let [first, second, third] = &self.layers;
        let output = third.forward(&second.forward(&first.forward(x).relu()).relu());
        let output = if self.tanh { output.tanh() } else { output };
        (output - target).square().mean(Kind::Float)
    }
}

impl ImIwol {
    /// A learner with weights drawn from `seed`.
    pub fn new(spec: &EnvSpec, settings: &Settings, seed: Seed) -> Self {
        let (mut actor, mut critic) = (Params::new(Device::Cpu), Params::new(Device::Cpu));
        let (network, iwol) = (&settings.network, &settings.iwol);
        let hidden = network.hidden;
        let mut rng = seed.child("actor").rng();
        let mut root = actor.root(&mut rng);
        let encoder = Encoder::new(root.sub("encoder"), &spec.observation, network);
        let latent = Latent {
            first: Linear::torch_default(root.sub("latent").sub(0), hidden, hidden / 2),
            second: Linear::torch_default(root.sub("latent").sub(1), hidden / 2, iwol.latent),
        };
        let inputs = if iwol.policy_input == PolicyInput::Latent { iwol.latent } else { iwol.latent + hidden };
        let head = GaussianHead::new(root.sub("head"), inputs, spec.actions as i64, &settings.exploration);
        let target = if iwol.world_target == WorldTarget::State { spec.state.len() } else { spec.observation.len() };
        let world = Decoder::new(root.sub("world"), iwol.latent, hidden, target as i64, true);
        let interaction = Decoder::new(root.sub("interaction"), iwol.latent, hidden, hidden, iwol.interaction_tanh);
        let decoders = |name: &str| name.starts_with("world.") || name.starts_with("interaction.");
        let deployed = actor.named().iter().filter(|(name, _)| !decoders(name)).map(|(_, t)| t.numel() as i64).sum();
        let mut rng = seed.child("critic").rng();
        let message_critic = MessageCritic::new(critic.root(&mut rng), &spec.observation, network, iwol);
        Self {
            encoder,
            latent,
            head,
            world,
            interaction,
            critic: message_critic,
            deployed,
            core: Core::new(actor, critic, settings),
        }
    }

    /// Latent z and what the policy head reads.
    fn policy_input(&self, f: &Tensor) -> (Tensor, Tensor) {
        let z = self.latent.forward(f);
        let input = match self.core.settings.iwol.policy_input {
            PolicyInput::Latent => z.shallow_clone(),
            PolicyInput::LatentEmbedding => Tensor::cat(&[&z, f], -1),
        };
        (z, input)
    }
}

impl Algorithm for ImIwol {
    fn name(&self) -> &'static str {
        "im-iwol"
    }

    fn memory(&self) -> usize {
        self.encoder.memory() as usize
    }

    fn act(&self, input: &Observation, mode: &ActMode<'_>) -> Decision {
        no_grad(|| {
            let (f, memory) = encode_locally(&self.encoder, input);
            let (action, log_prob) = self.head.sample(&self.policy_input(&f).1, mode.action_noise());
            Decision { action, log_prob, memory }
        })
    }

    fn update(&mut self, rollout: &Rollout, progress: f64, seed: Seed) -> Result<Losses, Error> {
        let (ppo, iwol) = (self.core.settings.ppo.clone(), self.core.settings.iwol.clone());
        let length = if self.encoder.memory() > 0 { self.core.settings.network.chunk_length } else { 1 };
        let mut batch = Batch::new(rollout);
        let mut noise = graph_noise(rollout, seed.child("graph"));
        let steps = rollout.sizes.steps as i64;
        let (outputs, memory) = self.critic.values(&batch, steps, &mut self.core.critic_memory, &noise);
        batch.estimate(rollout, &outputs, &self.core.value_norm, &ppo);
        let mut means = Means::default();
        for epoch in 0..ppo.epochs {
            if iwol.graph_noise == GraphNoise::Resampled {
                noise = graph_noise(rollout, seed.child("resampled").index(epoch as u64));
            }
            for mini in Minibatch::epoch(rollout, length, ppo.minibatch, seed.child("epoch").index(epoch as u64)) {
                if mini.is_empty() {
                    continue;
                }
                let (values, messages) = self.critic.minibatch(&batch, &mini, &memory, &noise);
                let value = value_terms(&batch, &mini, &mini.pick(&values), &mut self.core.value_norm, &ppo);

                let f = encode_active(&self.encoder, &mini, &batch.observation, &batch.memory, &batch.keep);
                let (z, input) = self.policy_input(&f);
                let policy = PolicyTerms::new(&batch, &mini, &self.head, &input, &ppo);
                let truth = match iwol.world_target {
                    WorldTarget::State => mini.active(&batch.state),
                    WorldTarget::Observation => mini.active(&batch.observation),
                };
                let world = self.world.loss(&z, &truth);
                let interaction = self.interaction.loss(&z, &mini.pick(&messages.detach()));

                let actor = &policy.loss + iwol.lambda_world * &world + iwol.lambda_interaction * &interaction;
                (actor + &value).backward();
                let norms = self.core.step(progress)?;
                means.add(&[
                    ("loss/policy", scalar(&policy.policy)),
                    ("loss/value", scalar(&value)),
                    ("loss/world", scalar(&world)),
                    ("loss/interaction", scalar(&interaction)),
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
