//! MADDPG: deterministic policies trained with the gradient of a centralised critic, from a replay
//! buffer (Lowe et al. 2017; marlbenchmark/off-policy, `maddpg.py`, `MADDPGPolicy.py`,
//! `actor_critic.py`), and the same with IWoL inside (`maddpg-iwol`; paper, appendix on off-policy
//! learning).
//!
//! 1. target: y = r + γ Q'(s', μ'(o')), from copies of both networks that follow slowly
//!    (`soft_update`); here the target contains the rewards of ten steps
//!    (`maddpg.n_step`; as in D4PG, Barth-Maron et al. 2018), because at ten decisions per second
//!    the effects of a decision come seconds later
//! 2. policy: follows the critic's gradient with respect to the agent's own action; the other
//!    agents' actions are those in the buffer
//! 3. the end of the trajectory is the agent's own, and so is the reward, to which the penalties of
//!    other agents are added with the weight `cooperation`
//!    ([`Rollout::rewards_with_penalties`](crate::rollout::Rollout::rewards_with_penalties);
//!    reference: agent 0's reward for a shared policy)
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
//!
//! Shapes: R sampled steps of all N agents, so observations `[R, N, O]`, actions `[R, N, A]`, values
//! `[R, N]`.

mod networks;
mod replay_buffer;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use smart_default::SmartDefault;
use tch::{Device, Kind, Tensor, no_grad};

use self::networks::{Actor, MaddpgNetworks};
use self::replay_buffer::{ReplayBuffer, Transitions, View};
use super::decision::{ActMode, Decision, Diagnostics, Observation, Reconstruction};
use super::decoder::mean_squared_error;
use super::device::act_on;
use super::encoder::encode_locally;
use super::head::NoiseMode;
use super::means::{Means, scalar};
use super::parameters::{
    ACTOR, CRITIC, ParameterBuilder, Weights, load_value_norm, part, value_norm_entry,
};
use super::ppo::{MAX_GRAD_NORM, masked_mean};
use super::settings::Settings;
use super::{
    Algorithm, Build, Capabilities, Channel, ChannelNoise, CommunicationScope, Error, Losses,
    Method, Stop, UpdateParameters,
};
use crate::env::EnvSpec;
use crate::nn::ValueNorm;
use crate::rng::{self, Seed};
use crate::rollout::Rollout;

/// Settings of MADDPG. Of the common settings, MADDPG reads learning rates, minibatch, discounts and
/// averaging.
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
}

/// Share τ of the distance to the trained networks by which target networks move after each
/// minibatch (marlbenchmark/off-policy).
const TARGET_RATE: f64 = 0.005;
/// Weight in the policy's loss of the squared mean actions before the tanh (code of Lowe et al.,
/// 2017).
const ACTION_PENALTY: f64 = 1e-3;

/// Multi-agent deep deterministic policy gradient.
pub(super) const MADDPG: Method =
    method("maddpg", &[], &["maddpg"], |spec, settings, seed, device, _| {
        Box::new(Maddpg::new(spec, settings, seed, device, false))
    });
/// MADDPG with IWoL's latent and messages.
pub(super) const MADDPG_IWOL: Method = method(
    "maddpg-iwol",
    &["world", "interaction"],
    &["maddpg", "iwol"],
    |spec, settings, seed, device, _| Box::new(Maddpg::new(spec, settings, seed, device, true)),
);

const fn method(
    name: &'static str,
    latent: &'static [&'static str],
    settings: &'static [&'static str],
    build: Build,
) -> Method {
    let capabilities = Capabilities {
        scope: CommunicationScope::None,
        messages: false,
        any_number: true,
        team: false,
        discrete: false,
        recurrent: false,
        on_policy: false,
        latent,
        settings,
        unread: &[
            "iwol.decoded",
            "ppo.epochs",
            "ppo.gae_lambda",
            "ppo.bounds",
            "ppo.entropy_coefficient",
            "ppo.entropy_end",
            "ppo.shards",
        ],
    };
    Method { name, capabilities, build }
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
    replay: ReplayBuffer,
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
            value_norm: ValueNorm::default(),
            replay: ReplayBuffer::new(settings.maddpg.replay, device),
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
        let noise_scale = if imposed { parameters.log_std.exp() } else { 1.0 };
        let noise = |of: &str| {
            let mut noise = vec![0.0; before.comm.numel()];
            rng::fill_logistic(&mut seed.child(of).rng(), &mut noise);
            Some(
                (Tensor::from_slice(&noise).view_as(&before.comm) * noise_scale)
                    .to_device(self.device),
            )
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
        let value_loss = masked_mean(&(value - target).square(), active);
        value_loss.backward();
        let mut report = self.weights.step(CRITIC, MAX_GRAD_NORM, parameters.learning_rate)?;

        let f = self.networks.actor.embed(&before.observation);
        let unbounded = self.networks.actor.head().unbounded(&self.networks.actor.read(&f));
        let mean = unbounded.tanh();
        // Features from before the critic's step are reused, which saves another forward pass.
        let value = self.networks.critic.value(&seen.detach(), &mean, action, &before.comm);
        let policy_loss = -masked_mean(&value, active);
        report.extend([("loss/value", scalar(&value_loss)), ("loss/policy", scalar(&policy_loss))]);
        // Without a penalty, means that a wrong value has driven far beyond the bounds would stay
        // there, because the tanh passes no gradient.
        let far = masked_mean(&unbounded.square().mean_dim(-1, false, Kind::Float), active);
        let mut total = policy_loss + ACTION_PENALTY * far;
        if let (Actor::Latent(policy), Some(message)) = (&self.networks.actor, message) {
            let iwol = &self.settings.iwol;
            let (z, _) = policy.read(&of_active(&f));
            let world = policy.world.error(&z, &of_active(&before.state));
            let prediction = policy.interaction.forward(&z);
            let interaction = mean_squared_error(&prediction, &of_active(&message.detach()));
            report.extend([
                ("loss/world", scalar(&world)),
                ("loss/interaction", scalar(&interaction)),
            ]);
            total = total + iwol.lambda_world * world + iwol.lambda_interaction * interaction;
        }
        total.backward();
        report.extend(self.weights.step(ACTOR, MAX_GRAD_NORM, parameters.learning_rate)?);
        self.target_weights.follow(&self.weights, TARGET_RATE);
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

    fn deviations(&self) -> Vec<f32> {
        self.networks.actor.head().deviations()
    }

    fn act(&self, input: &Observation, mode: &ActMode) -> Decision {
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
        let own = input.with_memory(input.memory.narrow(2, 0, 0));
        Decision { memory: input.memory.shallow_clone(), ..self.act(&own, &ActMode::Deterministic) }
    }

    fn inspect(&self, input: &Observation, state: &Tensor) -> Diagnostics {
        let view = View::of(&input.to(self.device), &state.to_device(self.device));
        let value = no_grad(|| {
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
        let (input, state) = (input.to(self.device), state.to_device(self.device));
        let all = no_grad(|| {
            let (z, _) = policy.read(&self.networks.actor.embed(&input.observation));
            let (_, messages) = self.networks.critic.look(&View::of(&input, &state), None);
            policy.reconstruct(&z, &state, messages)
        });
        all.iter().map(|one| one.to(Device::Cpu)).collect()
    }

    fn update_until(
        &mut self,
        rollout: &Rollout,
        parameters: &UpdateParameters,
        seed: Seed,
        _stop: Stop<'_>,
    ) -> Result<Losses, Error> {
        // To give an update up, the replay buffer would have to be copied.
        self.replay.add(rollout);
        let rows = (self.settings.ppo.minibatch / rollout.sizes.agents).max(1);
        let (returns, gamma) = (self.settings.maddpg.n_step, self.settings.ppo.gamma);
        let mut means = Means::default();
        for update in 0..self.settings.maddpg.updates {
            let seed = seed.index(update as u64);
            let steps = self.replay.draw(rows, returns, gamma, &mut seed.child("steps").rng());
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
