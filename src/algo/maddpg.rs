//! MADDPG: deterministic policies trained with the gradient of a centralised critic, from a replay
//! buffer (Lowe et al. 2017; marlbenchmark/off-policy, `maddpg.py`, `MADDPGPolicy.py`,
//! `actor_critic.py`), and the same with IWoL inside (`maddpg-iwol`; paper, appendix on off-policy
//! learning).
//!
//! 1. target: y = r + γ Q'(s', μ'(o')), from copies of both networks that follow slowly
//!    (`soft_update`, τ = 0.005); here the target contains the rewards of ten steps
//!    (`maddpg.n_step`; as in D4PG, Barth-Maron et al. 2018), because at ten decisions per second
//!    the effects of a decision come seconds later
//! 2. policy: follows the critic's gradient with respect to the agent's own action; the other
//!    agents' actions are those in the buffer
//! 3. reward and end of the trajectory are the agent's own (reference: agent 0's reward for a
//!    shared policy)
//! 4. actions: tanh of a linear layer, plus Gaussian noise (reference: no tanh, noise of standard
//!    deviation 0.1); a penalty keeps the values before the tanh small, as in the code of Lowe et
//!    al.
//! 5. IWoL: the critic is Q(m, f, a), with message m and embedding f from its own message path; the
//!    policy acts on [z; f], and both decoder losses shape its latent z
//! 6. values are normalised as in all methods; both critics are rescaled when the statistics change
//!    (PopArt), because their targets contain values
//!
//! Differences on purpose: the observation encoder, the noise schedule, learning rates, value
//! normalisation and averaged weights are those of all methods (the encoder has no memory, because
//! single steps are replayed); the critic attends to the other agents' observations, privileged
//! states and actions (reference: reads all of them side by side), so that any number of agents may
//! be present and absent agents have no influence; the critic reads the privileged state, as the
//! value functions of most methods do, except with IWoL, where messages take its place.

use std::f64::consts::SQRT_2;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use smart_default::SmartDefault;
use tch::{Device, Kind, Tensor, no_grad};

use super::core::{Means, act_on, scalar};
use super::encoder::{Encoder, encode_locally};
use super::head::{GaussianHead, NoiseMode};
use super::im_iwol::LatentPolicy;
use super::message::MessageTrunk;
use super::parameters::{
    ACTOR, CRITIC, ParameterBuilder, Weights, load_value_norm, part, value_norm_entry,
};
use super::replay::{Replay, Transitions, View};
use super::scene::Scene;
use super::{
    ActMode, Algorithm, Capabilities, Channel, ChannelNoise, CommunicationScope, Decision,
    Diagnostics, Error, Losses, Method, Observation, Reconstruction, Settings, UpdateParameters,
    ppo,
};
use crate::env::EnvSpec;
use crate::nn::graph::with_self_loops;
use crate::nn::{Attention, Init, LayerNorm, Linear, Reach, ValueNorm};
use crate::rng::{self, Seed};
use crate::rollout::Rollout;

/// Settings of MADDPG. Of the common settings, MADDPG reads learning rates, minibatch, discounts,
/// value normalisation, largest gradient norm and averaging.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema, SmartDefault)]
#[serde(deny_unknown_fields)]
#[schemars(default)]
pub struct MaddpgSettings {
    /// Number of rollouts in the replay buffer. Checkpoints contain the buffer, so that their size
    /// grows with this number.
    #[default = 16]
    #[schemars(range(min = 1, max = 10_000))]
    pub replay: usize,
    /// Number of minibatches drawn from the replay buffer after each rollout.
    #[default = 64]
    #[schemars(range(min = 1, max = 100_000))]
    pub updates: usize,
    /// Number of steps whose rewards are added before the critic's value of the last one:
    /// multi-step returns (Lowe et al., 2017: 1), without a correction for changes of the policy
    /// since. With one step, vehicles learned to stop before the crossing permanently
    /// (docs/lab/0.1.0.md#maddpg).
    #[default = 10]
    #[schemars(range(min = 1, max = 1000))]
    pub n_step: usize,
    /// Share τ of the distance to the trained networks by which target networks move after each
    /// minibatch.
    #[default = 0.005]
    #[schemars(range(max = 1), extend("exclusiveMinimum" = 0))]
    pub target_rate: f64,
    /// Weight in the policy's loss of the squared mean actions before the tanh (Lowe et al., 2017:
    /// 1e-3).
    #[default = 1e-3]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub action_penalty: f64,
}

/// Multi-agent deep deterministic policy gradient.
pub(super) const MADDPG: Method =
    method("maddpg", &[], &["maddpg"], |spec, settings, seed, device| {
        Box::new(Maddpg::new(spec, settings, seed, device, false))
    });
/// MADDPG with IWoL's latent and messages.
pub(super) const MADDPG_IWOL: Method = method(
    "maddpg-iwol",
    &["world", "interaction"],
    &["maddpg", "iwol"],
    |spec, settings, seed, device| Box::new(Maddpg::new(spec, settings, seed, device, true)),
);

const fn method(
    name: &'static str,
    latent: &'static [&'static str],
    settings: &'static [&'static str],
    build: fn(&EnvSpec, &Settings, Seed, Device) -> Box<dyn Algorithm>,
) -> Method {
    let capabilities = Capabilities {
        scope: CommunicationScope::None,
        messages: false,
        any_number: true,
        team: false,
        recurrent: false,
        on_policy: false,
        latent,
        settings,
    };
    Method { name, capabilities, build }
}

/// A policy on the agent's own observation.
enum Actor {
    Plain { encoder: Encoder, head: GaussianHead },
    Latent(LatentPolicy),
}

impl Actor {
    fn new(
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
        let head = GaussianHead::new(
            builder.of(ACTOR).sub("head"),
            hidden,
            &spec.actions,
            &settings.exploration,
        );
        Self::Plain { encoder, head: head.bounded() }
    }

    fn encoder(&self) -> &Encoder {
        match self {
            Self::Plain { encoder, .. } => encoder,
            Self::Latent(policy) => &policy.encoder,
        }
    }

    fn head(&self) -> &GaussianHead {
        match self {
            Self::Plain { head, .. } => head,
            Self::Latent(policy) => &policy.head,
        }
    }

    /// Returns the head's input for embeddings `[.., H]`.
    fn read(&self, f: &Tensor) -> Tensor {
        match self {
            Self::Plain { .. } => f.shallow_clone(),
            Self::Latent(policy) => policy.read(f).1,
        }
    }

    /// Embeds observations `[R, N, O]`.
    fn embed(&self, observation: &Tensor) -> Tensor {
        let nothing = Tensor::zeros([0], (Kind::Float, observation.device()));
        self.encoder().forward(observation, &nothing, &nothing).0
    }

    /// Returns the mean actions `[R, N, A]` for observations `[R, N, O]`.
    fn mean(&self, observation: &Tensor) -> Tensor {
        self.head().forward(&self.read(&self.embed(observation))).0
    }
}

/// What the critic reads of each agent.
enum Eyes {
    /// The agent's observation and its view of the privileged state.
    Privileged(Encoder),
    /// The agent's embedding and the message that it receives.
    Messages(Box<MessageTrunk>),
}

/// The critic: Q of each agent, from its features and its own action, and by attention from the
/// features and actions of the other agents.
struct Critic {
    eyes: Eyes,
    join: Linear,
    join_norm: LayerNorm,
    attention: Attention,
    deep: Linear,
    deep_norm: LayerNorm,
    value: Linear,
}

impl Critic {
    fn new(
        spec: &EnvSpec,
        settings: &Settings,
        builder: &mut ParameterBuilder,
        iwol: bool,
    ) -> Self {
        let (network, hidden) = (&settings.network, settings.network.hidden);
        let root = |builder: &mut ParameterBuilder, name: &str, inputs: i64| {
            Linear::new(builder.of(CRITIC).sub(name), inputs, hidden, Init::Orthogonal(SQRT_2))
        };
        let (eyes, seen) = if iwol {
            let trunk = MessageTrunk::new(
                builder.of(CRITIC).sub("trunk"),
                &spec.observation,
                network,
                &settings.iwol,
            );
            (Eyes::Messages(Box::new(trunk)), hidden + settings.iwol.message)
        } else {
            let features = spec.observation.join(&spec.state);
            (
                Eyes::Privileged(Encoder::new(
                    builder.of(CRITIC).sub("encoder"),
                    &features,
                    network,
                )),
                hidden,
            )
        };
        Self {
            eyes,
            join: root(builder, "join", seen + spec.actions.len() as i64),
            join_norm: LayerNorm::new(builder.of(CRITIC).sub("join_norm"), hidden),
            attention: Attention::new(
                builder.of(CRITIC).sub("others"),
                hidden,
                1,
                Init::Orthogonal(1.0),
                false,
            ),
            deep: root(builder, "deep", 2 * hidden),
            deep_norm: LayerNorm::new(builder.of(CRITIC).sub("deep_norm"), hidden),
            value: Linear::new(builder.of(CRITIC).sub("value"), hidden, 1, Init::Orthogonal(1.0)),
        }
    }

    /// Returns the features of all agents, `[R, N, W]`, and the messages among them, `[R, N, D]`,
    /// if there are any. `noise` is that of the graph, `[R, N, N]`; without it, the graph is the
    /// most likely one.
    fn look(&self, view: &View, noise: Option<Tensor>) -> (Tensor, Option<Tensor>) {
        let nothing = Tensor::zeros([0], (Kind::Float, view.comm.device()));
        match &self.eyes {
            Eyes::Privileged(encoder) => {
                let x = Tensor::cat(&[&view.observation, &view.state], -1);
                (encoder.forward(&x, &nothing, &nothing).0, None)
            }
            Eyes::Messages(trunk) => {
                let scene = Scene {
                    observation: view.observation.shallow_clone(),
                    keep: view.comm.diagonal(0, 1, 2).ones_like(),
                    memory: nothing,
                    comm: view.comm.shallow_clone(),
                    noise,
                    length: 1,
                    pack: true,
                };
                let heard = trunk.forward(&scene);
                let message = heard.packing.unpack(&heard.message);
                (
                    Tensor::cat(&[&message, &heard.packing.unpack(&heard.embedding)], -1),
                    Some(message),
                )
            }
        }
    }

    /// Returns the values (normalised) `[R, N]` of each agent's own `action`, while the other
    /// agents do what was `done`, both `[R, N, A]`. The diagonal of `comm` is 1 where an agent is
    /// present.
    fn value(&self, seen: &Tensor, action: &Tensor, done: &Tensor, comm: &Tensor) -> Tensor {
        let agents = comm.size()[1];
        let together = |act: &Tensor| {
            self.join_norm.forward(&self.join.forward(&Tensor::cat(&[seen, act], -1)).relu())
        };
        let (own, others) = (together(action), together(done));
        // The first key belongs to no agent, so that an agent alone has something to attend to.
        let others = others.constant_pad_nd([0, 0, 1, 0]);
        let there = comm.diagonal(0, 1, 2).unsqueeze(1).expand([-1, agents, -1], false);
        let reached =
            (&there - with_self_loops(&there.zeros_like())).clamp_min(0.0).constant_pad_nd([1, 0]);
        let _ = reached.narrow(2, 0, 1).fill_(1.0);
        let told = self.attention.forward(
            &own,
            &self.attention.keys_values(&others),
            &Reach::of(&reached),
            None,
        );
        let x = self.deep.forward(&Tensor::cat(&[own, told], -1)).relu();
        self.value.forward(&self.deep_norm.forward(&x)).squeeze_dim(-1)
    }
}

/// Policy and critic.
struct MaddpgNetworks {
    actor: Actor,
    critic: Critic,
}

impl MaddpgNetworks {
    fn new(
        spec: &EnvSpec,
        settings: &Settings,
        builder: &mut ParameterBuilder,
        iwol: bool,
    ) -> Self {
        let actor = Actor::new(spec, settings, builder, iwol);
        Self { actor, critic: Critic::new(spec, settings, builder, iwol) }
    }
}

struct Maddpg {
    name: &'static str,
    settings: Settings,
    device: Device,
    networks: MaddpgNetworks,
    weights: Weights,
    /// Target networks: copies whose weights follow those of `networks` slowly.
    targets: MaddpgNetworks,
    target_weights: Weights,
    value_norm: ValueNorm,
    replay: Replay,
}

impl Maddpg {
    fn new(spec: &EnvSpec, settings: &Settings, seed: Seed, device: Device, iwol: bool) -> Self {
        let build = || {
            let mut builder = ParameterBuilder::new(seed, device);
            (MaddpgNetworks::new(spec, settings, &mut builder, iwol), builder)
        };
        let ((networks, builder), (targets, following)) = (build(), build());
        Self {
            name: if iwol { MADDPG_IWOL.name } else { MADDPG.name },
            settings: settings.clone(),
            device,
            networks,
            weights: Weights::new(builder, settings.ppo.average > 0.0),
            targets,
            target_weights: Weights::new(following, false),
            value_norm: ValueNorm::new(settings.ppo.value_norm_beta),
            replay: Replay::new(settings.maddpg.replay, device),
        }
    }

    /// Updates critic, policy and target networks from sampled transitions. Returns the
    /// diagnostics; none if no agent acted in these transitions.
    ///
    /// # Errors
    /// [`Error::NonFinite`] when a gradient is not finite.
    fn step(
        &mut self,
        steps: &Transitions,
        parameters: &UpdateParameters,
        seed: Seed,
    ) -> Result<Vec<(&'static str, f64)>, Error> {
        let Transitions { before, after, action, reward, active, discount } = steps;
        // The noise of the graphs falls with the schedule, as the noise of the policies' graphs
        // does.
        let imposed = self.settings.exploration.mode == NoiseMode::Schedule;
        let quiet = if imposed { parameters.log_std.exp() } else { 1.0 };
        let noise = |of: &str| {
            let mut noise = vec![0.0; before.comm.numel()];
            rng::fill_logistic(&mut seed.child(of).rng(), &mut noise);
            Some((Tensor::from_slice(&noise).view_as(&before.comm) * quiet).to_device(self.device))
        };
        let target = no_grad(|| {
            let next = self.targets.actor.mean(&after.observation);
            let (seen, _) = self.targets.critic.look(after, noise("after"));
            let value = self.targets.critic.value(&seen, &next, &next, &after.comm);
            reward + discount * self.value_norm.denormalize(&value)
        });
        let samples = active.reshape([-1]).nonzero().squeeze_dim(-1);
        let of_active = |x: &Tensor| x.flatten(0, 1).index_select(0, &samples);
        if samples.numel() == 0 {
            return Ok(Vec::new());
        }
        let old = self.value_norm;
        self.value_norm.update(&of_active(&target));
        // Targets contain values. If values grew with the statistics, each would increase the
        // other.
        if let Some((scale, shift)) = self.value_norm.rescaling(&old) {
            for networks in [&self.networks, &self.targets] {
                networks.critic.value.rescale(scale, shift);
            }
        }
        let target = self.value_norm.normalize(&target);
        let (seen, message) = self.networks.critic.look(before, noise("before"));
        let value = self.networks.critic.value(&seen, action, action, &before.comm);
        let value_loss = ppo::masked_mean(&(value - target).square(), active);
        value_loss.backward();
        let mut report =
            self.weights.step(CRITIC, self.settings.ppo.max_grad_norm, parameters.learning_rate)?;

        let f = self.networks.actor.embed(&before.observation);
        let unbounded = self.networks.actor.head().unbounded(&self.networks.actor.read(&f));
        let mean = unbounded.tanh();
        // Features from before the critic's step are reused, which saves another forward pass.
        let value = self.networks.critic.value(&seen.detach(), &mean, action, &before.comm);
        let policy_loss = -ppo::masked_mean(&value, active);
        report.extend([("loss/value", scalar(&value_loss)), ("loss/policy", scalar(&policy_loss))]);
        // Without a penalty, means that a wrong value has driven far beyond the bounds would stay
        // there, because the tanh passes no gradient.
        let far = ppo::masked_mean(&unbounded.square().mean_dim(-1, false, Kind::Float), active);
        let mut total = policy_loss + self.settings.maddpg.action_penalty * far;
        if let (Actor::Latent(policy), Some(message)) = (&self.networks.actor, message) {
            let iwol = &self.settings.iwol;
            let (z, _) = policy.read(&of_active(&f));
            let world =
                policy.world.error(&z, &of_active(&before.observation), &of_active(&before.state));
            let interaction = policy.interaction.loss(&z, &of_active(&message.detach()));
            report.extend([
                ("loss/world", scalar(&world)),
                ("loss/interaction", scalar(&interaction)),
            ]);
            total = total + iwol.lambda_world * world + iwol.lambda_interaction * interaction;
        }
        total.backward();
        report.extend(self.weights.step(
            ACTOR,
            self.settings.ppo.max_grad_norm,
            parameters.learning_rate,
        )?);
        self.target_weights.follow(&self.weights, self.settings.maddpg.target_rate);
        Ok(report)
    }
}

impl Algorithm for Maddpg {
    fn name(&self) -> &'static str {
        self.name
    }

    fn memory(&self) -> usize {
        0
    }

    fn act(&self, input: &Observation, mode: &ActMode<'_>) -> Decision {
        act_on(self.device, input, mode, |input, mode| {
            let (f, memory) = encode_locally(self.networks.actor.encoder(), input);
            let (action, log_prob) =
                self.networks.actor.head().sample(&self.networks.actor.read(&f), mode);
            Decision { action, log_prob, memory }
        })
    }

    fn message_width(&self) -> usize {
        0
    }

    fn act_through(
        &self,
        input: &Observation,
        _channel: &Channel,
        _noise: &ChannelNoise,
    ) -> Decision {
        // No messages are sent, so that the channel's part of the memory stays unchanged.
        let own = Observation {
            memory: input.memory.narrow(2, 0, 0),
            ..input.map(Tensor::shallow_clone)
        };
        Decision { memory: input.memory.shallow_clone(), ..self.act(&own, &ActMode::Deterministic) }
    }

    fn inspect(&self, input: &Observation, state: &Tensor) -> Diagnostics {
        let value = no_grad(|| {
            let there = |tensor: &Tensor| tensor.to_device(self.device);
            let view = View {
                observation: there(&input.observation),
                state: there(state),
                comm: there(&input.comm),
            };
            let mean = self.networks.actor.mean(&view.observation);
            let (seen, _) = self.networks.critic.look(&view, None);
            self.value_norm
                .denormalize(&self.networks.critic.value(&seen, &mean, &mean, &view.comm))
        });
        Diagnostics { value: Some(value.to_device(Device::Cpu)), graph: None }
    }

    fn reconstruct(&self, input: &Observation, state: &Tensor) -> Vec<Reconstruction> {
        let Actor::Latent(policy) = &self.networks.actor else {
            return Vec::new();
        };
        no_grad(|| {
            let there = |tensor: &Tensor| tensor.to_device(self.device);
            let (input, state) = (input.map(there), there(state));
            let (z, _) = policy.read(&self.networks.actor.embed(&input.observation));
            let view = View {
                observation: input.observation.shallow_clone(),
                state: state.shallow_clone(),
                comm: input.comm.shallow_clone(),
            };
            let (_, messages) = self.networks.critic.look(&view, None);
            let back = |r: Reconstruction| Reconstruction {
                found: r.found.to_device(Device::Cpu),
                truth: r.truth.to_device(Device::Cpu),
                ..r
            };
            policy.reconstruct(&z, &input, &state, messages).into_iter().map(back).collect()
        })
    }

    fn update(
        &mut self,
        rollout: &Rollout,
        parameters: &UpdateParameters,
        seed: Seed,
    ) -> Result<Losses, Error> {
        self.replay.add(rollout);
        let rows = (self.settings.ppo.minibatch / rollout.sizes.agents).max(1);
        let returns = self.settings.maddpg.n_step;
        let mut means = Means::default();
        for update in 0..self.settings.maddpg.updates {
            let seed = seed.index(update as u64);
            let steps =
                self.replay.draw(rows, returns, parameters.gamma, &mut seed.child("steps").rng());
            let losses = self.step(&steps, parameters, seed.child("graph"))?;
            if !losses.is_empty() {
                means.add(&losses);
            }
        }
        let head = self.networks.actor.head();
        head.impose(parameters.log_std);
        self.weights.follow_average(self.settings.ppo.average);
        means.finish(&[("ppo/std", head.std()), ("ppo/learning_rate", parameters.learning_rate)])
    }

    fn swap_average(&mut self) {
        self.weights.swap_average();
    }

    fn state(&self) -> Vec<(String, Tensor)> {
        let mut state = self.weights.state();
        state.extend(self.target_weights.values("_target"));
        state.push(value_norm_entry(&self.value_norm));
        let replay = self.replay.state().into_iter();
        state.extend(
            replay.map(|(name, t)| {
                (format!("replay_memory/{name}"), t.to_device(Device::Cpu).copy())
            }),
        );
        state
    }

    fn load(&mut self, state: &[(String, Tensor)]) -> Result<(), Error> {
        self.weights.load(state)?;
        self.target_weights.load_values(state, "_target")?;
        load_value_norm(&mut self.value_norm, state)?;
        Ok(self.replay.load(&part(state, "replay_memory"))?)
    }

    fn load_weights(&mut self, state: &[(String, Tensor)]) -> Result<(), Error> {
        self.weights.load_weights(state)?;
        self.target_weights.follow(&self.weights, 1.0);
        load_value_norm(&mut self.value_norm, state)
    }

    fn parameters(&self) -> (i64, i64) {
        self.weights.parameters(&["world.", "interaction."])
    }
}
