//! The networks of MADDPG: a policy on the agent's own observation, and a critic that reads all
//! agents.

use tch::{Kind, Tensor};

use super::replay_buffer::View;
use crate::algo::encoder::Encoder;
use crate::algo::head::GaussianHead;
use crate::algo::im_iwol::LatentPolicy;
use crate::algo::message::MessageTrunk;
use crate::algo::parameters::{ACTOR, CRITIC, ParameterBuilder};
use crate::algo::scene::Scene;
use crate::algo::settings::Settings;
use crate::env::EnvSpec;
use crate::nn::graph::with_self_loops;
use crate::nn::{Activation, Attention, Init, Layer, Linear, Mlp, Reach};

/// A policy on the agent's own observation.
pub(super) enum Actor {
    Plain { encoder: Encoder, head: GaussianHead },
    Latent(LatentPolicy),
}

impl Actor {
    pub(super) fn new(
        spec: &EnvSpec,
        settings: &Settings,
        builder: &mut ParameterBuilder,
        iwol: bool,
    ) -> Self {
        if iwol {
            return Self::Latent(LatentPolicy::new(spec, settings, builder).bounded());
        }
        let hidden = settings.network.hidden;
        let encoder =
            Encoder::new(builder.of(ACTOR).sub("encoder"), &spec.observation, &settings.network);
        let head = GaussianHead::of_actor(builder, hidden, spec, settings);
        Self::Plain { encoder, head: head.bounded() }
    }

    pub(super) fn encoder(&self) -> &Encoder {
        match self {
            Self::Plain { encoder, .. } => encoder,
            Self::Latent(policy) => &policy.encoder,
        }
    }

    pub(super) fn head(&self) -> &GaussianHead {
        match self {
            Self::Plain { head, .. } => head,
            Self::Latent(policy) => policy.head.gaussian(),
        }
    }

    /// Returns the head's input for embeddings `[.., H]`.
    pub(super) fn read(&self, f: &Tensor) -> Tensor {
        match self {
            Self::Plain { .. } => f.shallow_clone(),
            Self::Latent(policy) => policy.read(f).1,
        }
    }

    /// Embeds observations `[R, N, O]`.
    pub(super) fn embed(&self, observation: &Tensor) -> Tensor {
        let nothing = Tensor::zeros([0], (Kind::Float, observation.device()));
        self.encoder().forward(observation, &nothing, &nothing).0
    }

    /// Returns the mean actions `[R, N, A]` for observations `[R, N, O]`.
    pub(super) fn mean(&self, observation: &Tensor) -> Tensor {
        self.head().forward(&self.read(&self.embed(observation))).0
    }
}

/// The part of each agent that the critic reads.
pub(super) enum CriticInput {
    /// The agent's observation and its view of the privileged state.
    Privileged(Encoder),
    /// The agent's embedding and the message that it receives, and its view of the privileged state
    /// if the settings say so.
    Messages(Box<MessageTrunk>, Option<Mlp>),
}

/// The critic: Q of each agent, from its features and its own action, and by attention from the
/// features and actions of the other agents.
pub(super) struct Critic {
    input: CriticInput,
    join: Layer,
    attention: Attention,
    deep: Layer,
    pub(super) value: Linear,
}

impl Critic {
    pub(super) fn new(
        spec: &EnvSpec,
        settings: &Settings,
        builder: &mut ParameterBuilder,
        iwol: bool,
    ) -> Self {
        let (network, hidden) = (&settings.network, settings.network.hidden);
        let layer = |builder: &mut ParameterBuilder, names: [&str; 2], inputs: i64| {
            Layer::new(&mut builder.of(CRITIC), names, inputs, hidden, Activation::Relu)
        };
        let (input, seen) = if iwol {
            let trunk = MessageTrunk::new(
                builder.of(CRITIC).sub("trunk"),
                &spec.observation,
                network,
                &settings.iwol,
                None,
            );
            let (known, normalised) = (spec.state.len() as i64, spec.state.normalised);
            let state = settings
                .iwol
                .privileged_value
                .then(|| Mlp::build(builder.of(CRITIC).sub("state"), known, hidden, normalised));
            let seen = hidden + settings.iwol.message + if state.is_some() { hidden } else { 0 };
            (CriticInput::Messages(Box::new(trunk), state), seen)
        } else {
            let features = spec.observation.join(&spec.state);
            (
                CriticInput::Privileged(Encoder::new(
                    builder.of(CRITIC).sub("encoder"),
                    &features,
                    network,
                )),
                hidden,
            )
        };
        Self {
            input,
            join: layer(builder, ["join", "join_norm"], seen + spec.actions.len() as i64),
            attention: Attention::new(
                builder.of(CRITIC).sub("others"),
                hidden,
                1,
                Init::Orthogonal(1.0),
                false,
            ),
            deep: layer(builder, ["deep", "deep_norm"], 2 * hidden),
            value: Linear::new(builder.of(CRITIC).sub("value"), hidden, 1, Init::Orthogonal(1.0)),
        }
    }

    /// Returns the features of all agents, `[R, N, W]`, and the messages among them, `[R, N, D]`,
    /// if there are any. `noise` is that of the graph, `[R, N, N]`; without it, the graph is the
    /// most likely one.
    pub(super) fn look(&self, view: &View, noise: Option<Tensor>) -> (Tensor, Option<Tensor>) {
        let nothing = Tensor::zeros([0], (Kind::Float, view.comm.device()));
        match &self.input {
            CriticInput::Privileged(encoder) => {
                let x = Tensor::cat(&[&view.observation, &view.state], -1);
                (encoder.forward(&x, &nothing, &nothing).0, None)
            }
            CriticInput::Messages(trunk, state) => {
                let scene = Scene {
                    observation: view.observation.shallow_clone(),
                    keep: view.comm.diagonal(0, 1, 2).ones_like(),
                    memory: nothing,
                    comm: view.comm.shallow_clone(),
                    disturbance: None,
                    noise,
                    length: 1,
                    pack: true,
                };
                let heard = trunk.forward(&scene, None);
                let message = heard.packing.unpack(&heard.message);
                let read = Tensor::cat(&[&message, &heard.packing.unpack(&heard.embedding)], -1);
                let read = match state {
                    None => read,
                    Some(mlp) => Tensor::cat(&[&read, &mlp.forward(&view.state)], -1),
                };
                (read, Some(message))
            }
        }
    }

    /// Returns the values (normalised) `[R, N]` of each agent's own `action`, while the other
    /// agents do what was `done`, both `[R, N, A]`. The diagonal of `comm` is 1 where an agent is
    /// present.
    pub(super) fn value(
        &self,
        seen: &Tensor,
        action: &Tensor,
        done: &Tensor,
        comm: &Tensor,
    ) -> Tensor {
        let agents = comm.size()[1];
        let together = |act: &Tensor| self.join.forward(&Tensor::cat(&[seen, act], -1));
        let (own, others) = (together(action), together(done));
        // The first key belongs to no agent, so that an agent alone has something to attend to.
        let others = others.constant_pad_nd([0, 0, 1, 0]);
        let there = comm.diagonal(0, 1, 2).unsqueeze(1).expand([-1, agents, -1], false);
        let reached =
            (&there - with_self_loops(&there.zeros_like())).clamp_min(0.0).constant_pad_nd([1, 0]);
        let _ = reached.narrow(2, 0, 1).fill_(1.0);
        let attended = self.attention.forward(
            &own,
            &self.attention.keys_values(&others),
            &Reach::of(&reached),
            None,
        );
        let x = self.deep.forward(&Tensor::cat(&[own, attended], -1));
        self.value.forward(&x).squeeze_dim(-1)
    }
}

/// Policy and critic.
pub(super) struct MaddpgNetworks {
    pub(super) actor: Actor,
    pub(super) critic: Critic,
}

impl MaddpgNetworks {
    pub(super) fn new(
        spec: &EnvSpec,
        settings: &Settings,
        builder: &mut ParameterBuilder,
        iwol: bool,
    ) -> Self {
        let actor = Actor::new(spec, settings, builder, iwol);
        Self { actor, critic: Critic::new(spec, settings, builder, iwol) }
    }
}
