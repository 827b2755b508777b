//! Ex-IWoL: agents exchange messages at run time. The message m is the latent z: policy and value
//! function both read [m; f], and the world decoder shapes m (paper: eq. for L_Ex;
//! DongsuLeeTech/IWoL, `ExIWoL_net.py`, `ExIWoL.py`).
//!
//! Policy and value function each have their own message path. The policy's graph is sampled once
//! per decision, and its noise is stored with the rollout, so that the update sees the graph that
//! acted. A deployed policy uses the most likely graph.
//!
//! Shapes: embeddings f `[B, H]`, messages m `[B, D]`, policy and value on `[B, D + H]`, world
//! decoder from m to the privileged state `[B, S]`. Differences from the paper are those of
//! [`im_iwol`](super::im_iwol); the scale of the policy's graph noise is that of [all
//! methods](super).

use tch::Tensor;

use super::batch::{Batch, EDGES, Shard};
use super::critic::{ValueFunction, value_loss};
use super::decision::{ActMode, Decision, Observation, Reconstruction};
use super::decoder::WorldDecoder;
use super::message::{MessageCritic, MessageTrunk, most_listed};
use super::networks::{Loss, Networks};
use super::parameters::{ACTOR, CRITIC, ParameterBuilder};
use super::policy::{PolicyHead, PolicyTerms, Ratio};
use super::radio::Radio;
use super::scene::{Messages, Scene};
use super::settings::Settings;
use super::{Channel, ChannelNoise, CommunicationScope};
use crate::env::EnvSpec;
use crate::nn::ValueNorm;

/// The networks of explicit IWoL.
pub(super) struct ExIwol {
    trunk: MessageTrunk,
    head: PolicyHead,
    world: WorldDecoder,
    /// Whether the world decoder is trained.
    trained: bool,
    critic: MessageCritic,
    radio: Option<Radio>,
}

impl ExIwol {
    /// Computes the messages of one decision over the most likely graph.
    fn exchange(&self, input: &Observation) -> Messages {
        self.trunk.forward(&Scene::of(input, None), None)
    }
}

impl Networks for ExIwol {
    const NAME: &'static str = "ex-iwol";
    const SCOPE: CommunicationScope = CommunicationScope::InRange;
    const LATENT: &'static [&'static str] = &["world"];
    const SETTINGS: &'static [&'static str] = &["iwol"];
    const UNREAD: &'static [&'static str] = &["iwol.latent", "iwol.lambda_interaction"];
    const MESSAGES: bool = true;
    const TRAINING_ONLY: &'static [&'static str] = &["world."];

    fn new(spec: &EnvSpec, settings: &Settings, builder: &mut ParameterBuilder) -> Self {
        let (network, iwol) = (&settings.network, &settings.iwol);
        let (hidden, message) = (network.hidden, iwol.message);
        let features = spec.observation.len();
        let radio = Radio::new(settings, features, hidden, iwol.rounds, builder.device());
        // What passes through the radio of training is different for each pair of agents.
        let most = most_listed(spec).filter(|_| radio.is_none());
        Self {
            trunk: MessageTrunk::new(
                builder.of(ACTOR).sub("trunk"),
                &spec.observation,
                network,
                iwol,
                most,
            ),
            head: PolicyHead::of_actor(builder, message + hidden, spec, settings),
            world: WorldDecoder::new(builder.of(ACTOR).sub("world"), spec, settings, message),
            trained: iwol.lambda_world > 0.0,
            critic: MessageCritic::new(builder.of(CRITIC), spec, network, iwol),
            radio,
        }
    }

    fn head(&self) -> &PolicyHead {
        &self.head
    }

    fn memory(&self) -> i64 {
        self.trunk.memory()
    }

    fn graph_noise(&self, agents: i64) -> i64 {
        self.trunk.graph_noise(agents)
    }

    fn critic(&self) -> &dyn ValueFunction {
        &self.critic
    }

    fn radio(&self) -> Option<&Radio> {
        self.radio.as_ref()
    }

    fn act(&self, input: &Observation, mode: &ActMode) -> Decision {
        let radio = Radio::in_use(self.radio.as_ref(), mode);
        let messages = self.trunk.forward(&Scene::of(input, mode.graph_noise()), radio);
        let read =
            messages.packing.unpack(&Tensor::cat(&[&messages.message, &messages.embedding], -1));
        let (action, log_prob) = self.head.sample(&read, &input.available, mode);
        Decision { action, log_prob, memory: Radio::memory_after(radio, input, messages.memory) }
    }

    fn message_width(&self) -> i64 {
        self.trunk.width()
    }

    fn act_through(
        &self,
        input: &Observation,
        channel: &Channel,
        noise: &ChannelNoise,
    ) -> Decision {
        let (message, embedding, memory) = self.trunk.through(input, channel, noise);
        let (action, log_prob) = {
            let read = Tensor::cat(&[&message, &embedding], -1);
            self.head.sample(&read, &input.available, &ActMode::Deterministic)
        };
        Decision { action, log_prob, memory }
    }

    fn graph(&self, input: &Observation) -> Option<Tensor> {
        Some(self.exchange(input).full_graph())
    }

    fn loss(&self, batch: &Batch, shard: &Shard, settings: &Settings, norm: &ValueNorm) -> Loss {
        let (ppo, iwol) = (&settings.ppo, &settings.iwol);
        let (values, ..) = self.critic.shard(batch, shard);
        let value = value_loss(batch, shard, &values, norm);

        let scene = Scene::of_shard(batch, shard, &batch.memory, &batch.policy_graph);
        let messages = self.trunk.forward(&scene, self.radio.as_ref());
        let [open, possible] = messages.edges(shard, &scene);
        let [m, f] = shard.unpacked(&messages.packing, [&messages.message, &messages.embedding]);
        let input = Tensor::cat(&[&m, &f], -1);
        let policy = PolicyTerms::new(batch, shard, &self.head, &input, ppo, Ratio::Joint);
        let world = self.world.loss(batch, shard, &m);

        let total = &policy.loss + iwol.lambda_world * &world + &value;
        let own = [("loss/world", &world), (EDGES[0], &open), (EDGES[1], &possible)];
        Loss::new(total, &value, own, &policy)
    }

    fn reconstruct(&self, input: &Observation, state: &Tensor) -> Vec<Reconstruction> {
        if !self.trained {
            return Vec::new();
        }
        let messages = self.exchange(input);
        vec![self.world.reconstruct(&messages.packing.unpack(&messages.message), state)]
    }
}
