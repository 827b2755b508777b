//! Im-IWoL: communication in training only. The policy acts on the local observation through the
//! interaction-world latent z; messages reach only the value function (paper: take-away box, eq.
//! for L_Im; DongsuLeeTech/IWoL, `ImIWoL_net.py`, `ImIWoL.py`).
//!
//! - policy: encoder f `[B, H]`, z = Enc_IW(f) `[B, Z]`, Gaussian head on [z; f]
//! - value function: V(m, f) `[B]`, with its own message path for m `[B, D]`
//! - world decoder: predicts the privileged state `[B, S]` from z
//! - interaction decoder: predicts the agent's message m from z; m is a target and gets no gradient
//! - deployed policy: encoder, Enc_IW and head, without a message path
//!
//! Differences on purpose: edges beyond the radio range do not exist, and closed edges carry nothing
//! (released code: neither); the noise of graphs is stored with the rollout (released code: new
//! noise in each epoch); the world decoder predicts the privileged state, and the interaction
//! decoder is linear (released code: the observation, and a tanh); the decoders learn from a part of
//! the samples (`iwol.decoded`). The policy reads [z; f], as in the released code (Algorithm 1 of
//! the paper: z alone). Shared advantages are those of [all methods](super).

use tch::Tensor;

use super::batch::{Batch, EDGES, Shard};
use super::critic::{ValueFunction, value_loss};
use super::decision::{ActMode, Decision, Observation, Reconstruction};
use super::decoder::{LatentDecoder, WorldDecoder, mean_squared_error};
use super::encoder::{Encoder, encode_active, encode_locally};
use super::message::MessageCritic;
use super::networks::{Loss, Networks};
use super::parameters::{ACTOR, CRITIC, ParameterBuilder};
use super::policy::{PolicyHead, PolicyTerms, Ratio};
use super::settings::Settings;
use crate::env::EnvSpec;
use crate::nn::{Linear, ValueNorm};

/// The networks of implicit IWoL.
pub(super) struct ImIwol {
    policy: LatentPolicy,
    critic: MessageCritic,
}

/// A policy on the latent of an agent's own observation, from which decoders predict the privileged
/// state and a message.
pub(super) struct LatentPolicy {
    pub(super) encoder: Encoder,
    latent: Latent,
    pub(super) head: PolicyHead,
    pub(super) world: WorldDecoder,
    pub(super) interaction: LatentDecoder,
    /// Whether the world decoder and the interaction decoder are trained.
    trained: [bool; 2],
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

impl LatentPolicy {
    pub(super) fn new(spec: &EnvSpec, settings: &Settings, builder: &mut ParameterBuilder) -> Self {
        let (network, iwol) = (&settings.network, &settings.iwol);
        let hidden = network.hidden;
        let encoder = Encoder::new(builder.of(ACTOR).sub("encoder"), &spec.observation, network);
        let latent = Latent {
            first: Linear::torch_default(
                builder.of(ACTOR).sub("latent").sub(0),
                hidden,
                hidden / 2,
            ),
            second: Linear::torch_default(
                builder.of(ACTOR).sub("latent").sub(1),
                hidden / 2,
                iwol.latent,
            ),
        };
        Self {
            encoder,
            latent,
            head: PolicyHead::of_actor(builder, iwol.latent + hidden, spec, settings),
            world: WorldDecoder::new(builder.of(ACTOR).sub("world"), spec, settings, iwol.latent),
            interaction: LatentDecoder::new(
                builder.of(ACTOR).sub("interaction"),
                iwol.latent,
                hidden,
                iwol.message,
            ),
            trained: [iwol.lambda_world > 0.0, iwol.lambda_interaction > 0.0],
        }
    }

    /// Returns the policy with a tanh on its mean actions.
    pub(super) fn bounded(self) -> Self {
        Self { head: self.head.bounded(), ..self }
    }

    /// Returns the latent z and the input of the policy head.
    pub(super) fn read(&self, f: &Tensor) -> (Tensor, Tensor) {
        let z = self.latent.forward(f);
        let input = Tensor::cat(&[&z, f], -1);
        (z, input)
    }

    /// Returns the predictions of the world and of the agents' `messages` (where they are given)
    /// from latents `z: [E, N, Z]`, with their targets. Decoders that are not trained are left out.
    pub(super) fn reconstruct(
        &self,
        z: &Tensor,
        state: &Tensor,
        messages: Option<Tensor>,
    ) -> Vec<Reconstruction> {
        let [world, interaction] = self.trained;
        let world = world.then(|| self.world.reconstruct(z, state));
        let interaction = messages.filter(|_| interaction).map(|target| {
            let prediction = self.interaction.forward(z);
            Reconstruction { name: "interaction", prediction, target }
        });
        world.into_iter().chain(interaction).collect()
    }
}

impl Networks for ImIwol {
    const NAME: &'static str = "im-iwol";
    const LATENT: &'static [&'static str] = &["world", "interaction"];
    const SETTINGS: &'static [&'static str] = &["iwol"];
    const TRAINING_ONLY: &'static [&'static str] = &["world.", "interaction."];

    fn new(spec: &EnvSpec, settings: &Settings, builder: &mut ParameterBuilder) -> Self {
        Self {
            policy: LatentPolicy::new(spec, settings, builder),
            critic: MessageCritic::new(builder.of(CRITIC), spec, &settings.network, &settings.iwol),
        }
    }

    fn head(&self) -> &PolicyHead {
        &self.policy.head
    }

    fn memory(&self) -> i64 {
        self.policy.encoder.memory()
    }

    fn critic(&self) -> &dyn ValueFunction {
        &self.critic
    }

    fn act(&self, input: &Observation, mode: &ActMode) -> Decision {
        let (f, memory) = encode_locally(&self.policy.encoder, input);
        let (action, log_prob) =
            self.policy.head.sample(&self.policy.read(&f).1, &input.available, mode);
        Decision { action, log_prob, memory }
    }

    fn loss(&self, batch: &Batch, shard: &Shard, settings: &Settings, norm: &ValueNorm) -> Loss {
        let (ppo, iwol) = (&settings.ppo, &settings.iwol);
        let (values, messages, [open, possible]) = self.critic.shard(batch, shard);
        let value = value_loss(batch, shard, &values, norm);

        let f = encode_active(
            &self.policy.encoder,
            shard,
            &[&batch.observation],
            &batch.memory,
            &batch.keep,
        );
        let (z, input) = self.policy.read(&f);
        let policy = PolicyTerms::new(batch, shard, &self.policy.head, &input, ppo, Ratio::Joint);
        let some = |x: &Tensor| shard.part(x, iwol.decoded);
        let world = self.policy.world.loss(batch, shard, &z);
        let prediction = self.policy.interaction.forward(&some(&z));
        let interaction = mean_squared_error(&prediction, &some(&messages.detach()));

        let actor =
            &policy.loss + iwol.lambda_world * &world + iwol.lambda_interaction * &interaction;
        let own = [
            ("loss/world", &world),
            ("loss/interaction", &interaction),
            (EDGES[0], &open),
            (EDGES[1], &possible),
        ];
        Loss::new(actor + &value, &value, own, &policy)
    }

    fn reconstruct(&self, input: &Observation, state: &Tensor) -> Vec<Reconstruction> {
        let z = self.policy.latent.forward(&encode_locally(&self.policy.encoder, input).0);
        self.policy.reconstruct(&z, state, self.critic.messages(input))
    }
}
