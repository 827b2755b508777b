//! Ex-IWoL: agents exchange messages at run time. The message m is the latent z: policy and value
//! function both read [m; f], and the world decoder shapes m (paper: eq. for L_Ex;
//! DongsuLeeTech/IWoL, `ExIWoL_net.py`, `ExIWoL.py`).
//!
//! Policy and value function each have their own message path. The policy's graph is sampled once
//! per decision, and its noise is stored with the rollout, so that the update sees the graph that
//! acted. A deployed policy uses the most likely graph.

use tch::{Kind, Tensor};

use super::batch::{Batch, Shard};
use super::core::{EDGE_RATE, Loss, Networks};
use super::decoder::WorldDecoder;
use super::head::{GaussianHead, PolicyTerms, Ratio};
use super::message::{MessageCritic, MessageTrunk, Messages};
use super::parameters::{ACTOR, CRITIC, ParameterBuilder};
use super::scene::Scene;
use super::{
    ActMode, Channel, ChannelNoise, CommunicationScope, Decision, Observation, Reconstruction,
    Settings, ppo,
};
use crate::env::EnvSpec;
use crate::nn::ValueNorm;
use crate::nn::graph::edge_rate;

/// The networks of explicit IWoL.
pub(super) struct ExIwol {
    trunk: MessageTrunk,
    head: GaussianHead,
    world: WorldDecoder,
    /// Whether the world decoder is trained.
    told: bool,
    critic: MessageCritic,
}

impl ExIwol {
    /// Computes the messages of one decision. `graph` is the noise of the graph; without it, the
    /// graph is the most likely one.
    fn exchange(&self, input: &Observation, graph: Option<&Tensor>) -> Messages {
        self.trunk.forward(&Scene::of(input, graph))
    }
}

impl Networks for ExIwol {
    const NAME: &'static str = "ex-iwol";
    const SCOPE: CommunicationScope = CommunicationScope::InRange;
    const LATENT: &'static [&'static str] = &["world"];
    const SETTINGS: &'static [&'static str] = &["iwol"];
    const MESSAGES: bool = true;
    const GRAPHS: usize = 1;
    const VALUE_SAMPLES_GRAPH: bool = true;
    const TRAINING_ONLY: &'static [&'static str] = &["world."];

    fn new(spec: &EnvSpec, settings: &Settings, builder: &mut ParameterBuilder) -> Self {
        let (network, iwol) = (&settings.network, &settings.iwol);
        let (hidden, message) = (network.hidden, iwol.message);
        Self {
            trunk: MessageTrunk::new(
                builder.of(ACTOR).sub("trunk"),
                &spec.observation,
                network,
                iwol,
            ),
            head: GaussianHead::new(
                builder.of(ACTOR).sub("head"),
                message + hidden,
                &spec.actions,
                &settings.exploration,
            ),
            world: WorldDecoder::new(builder.of(ACTOR).sub("world"), spec, settings, message),
            told: iwol.lambda_world > 0.0,
            critic: MessageCritic::new(builder.of(CRITIC), &spec.observation, network, iwol),
        }
    }

    fn head(&self) -> &GaussianHead {
        &self.head
    }

    fn memory(&self) -> i64 {
        self.trunk.memory()
    }

    fn value_memory(&self) -> i64 {
        self.critic.memory()
    }

    fn act(&self, input: &Observation, mode: &ActMode<'_>) -> Decision {
        let (envs, agents, _) = input.observation.size3().expect("observations are [E, N, O]");
        let graph = match mode {
            ActMode::Deterministic => None,
            ActMode::Sample { graph, .. } => Some(*graph),
        };
        let messages = self.exchange(input, graph);
        let read =
            messages.packing.unpack(&Tensor::cat(&[&messages.message, &messages.embedding], -1));
        let (action, log_prob) = self.head.sample(&read, mode);
        let memory = messages
            .memory
            .map_or_else(|| input.memory.shallow_clone(), |m| m.view([envs, agents, -1]));
        Decision { action, log_prob, memory }
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
        let (action, log_prob) =
            self.head.sample(&Tensor::cat(&[&message, &embedding], -1), &ActMode::Deterministic);
        Decision { action, log_prob, memory }
    }

    fn value(&self, input: &Observation, _state: &Tensor) -> Option<Tensor> {
        self.critic.value(input)
    }

    fn graph(&self, input: &Observation) -> Option<Tensor> {
        Some(self.exchange(input, None).graph)
    }

    fn values(&self, batch: &Batch, length: i64, memory: &Tensor) -> (Tensor, Option<Tensor>) {
        self.critic.values(batch, length, memory)
    }

    fn loss(&self, batch: &Batch, shard: &Shard, settings: &Settings, norm: &ValueNorm) -> Loss {
        let (ppo, iwol) = (&settings.ppo, &settings.iwol);
        let (values, ..) = self.critic.shard(batch, shard);
        let value = ppo::value_terms(batch, shard, &values, norm, ppo);

        let scene = Scene::of_shard(batch, shard, &batch.memory, &batch.policy_graph);
        let messages = self.trunk.forward(&scene);
        let edges =
            shard.pick(&edge_rate(&messages.graph, &scene.comm).unsqueeze(-1)).mean(Kind::Float);
        let [m, f] = shard.unpacked(&messages.packing, [&messages.message, &messages.embedding]);
        let input = Tensor::cat(&[&m, &f], -1);
        let policy = PolicyTerms::new(batch, shard, &self.head, &input, ppo, Ratio::Joint);
        let world = self.world.loss(batch, shard, &m);

        let mut report = vec![
            ("loss/value", value.detach()),
            ("loss/world", world.detach()),
            (EDGE_RATE, edges),
        ];
        report.extend(policy.report());
        Loss { total: &policy.loss + iwol.lambda_world * &world + value, report }
    }

    fn reconstruct(&self, input: &Observation, state: &Tensor) -> Vec<Reconstruction> {
        if !self.told {
            return Vec::new();
        }
        let messages = self.exchange(input, None);
        vec![self.world.reconstruct(&messages.packing.unpack(&messages.message), input, state)]
    }
}
