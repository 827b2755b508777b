//! Collects a rollout: observations of the worlds, noisy actions of the policy, and their results.

use tch::Tensor;

use super::last_action::LastAction;
use super::noise::CorrelatedNoise;
use super::{Error, Mark, Stops, Timers, timed};
use crate::algo::settings::NoiseMode;
use crate::algo::{self, ActMode, Algorithm, Channel, Observation};
use crate::config::Config;
use crate::env::{EpisodeRecord, Worlds};
use crate::rng::{self, Rng, Seed};
use crate::rollout::Rollout;

const FLOAT: (tch::Kind, tch::Device) = (tch::Kind::Float, tch::Device::Cpu);

/// The worlds of a training, and what playing them needs.
pub(super) struct Collector {
    pub worlds: Box<dyn Worlds>,
    /// Memory of the policy before the next decision, `[E, N, M]`.
    pub memory: Tensor,
    /// Whether the noise of each dimension of an action may last.
    pub noise_lasts: Vec<bool>,
    pub last_action: LastAction,
    /// Training episodes that ended in the rollout from which the last iteration learned.
    pub finished: Vec<EpisodeRecord>,
    pub timers: Timers,
}

/// A policy as it plays in training.
#[derive(Clone, Copy)]
pub(super) struct Exploring<'a> {
    pub policy: &'a dyn Algorithm,
    /// Logarithm of the scheduled standard deviation of actions.
    pub log_std: f64,
}

impl Collector {
    /// Returns the present state of the worlds and of the memory.
    pub(super) fn mark(&self) -> Mark {
        Mark { worlds: self.worlds.states(), memory: self.memory.shallow_clone() }
    }

    /// Plays as many steps as the rollout has, in all worlds, and stores them.
    ///
    /// # Errors
    /// If a world fails and the environment cannot recover it ([`Error::Env`]), and
    /// [`Error::Stopped`].
    pub(super) fn collect(
        &mut self,
        config: &Config,
        player: Exploring<'_>,
        rollout: &mut Rollout,
        seed: Seed,
        stops: Stops<'_>,
    ) -> Result<(), Error> {
        let Exploring { policy, log_std } = player;
        let s = rollout.sizes;
        let (e, n, a) = (s.envs as i64, s.agents as i64, s.actions as i64);
        // The noise starts anew in each iteration: it depends on the iteration's number alone.
        let exploration = &config.learner.exploration;
        let correlation = exploration.correlation as f32;
        let each = self.noise_lasts.iter().map(|&lasts| if lasts { correlation } else { 0.0 });
        let mut noise = CorrelatedNoise::new(s.envs * s.agents, each.collect());
        let correlated = noise.is_correlated();
        rollout.carried.resize(if correlated { rollout.action.len() } else { 0 }, 0.0);
        rollout.log_fresh.resize(if correlated { s.steps * s.actions } else { 0 }, 0.0);
        // A scheduled standard deviation also scales the noise of communication graphs.
        let imposed = exploration.mode == NoiseMode::Schedule;
        let schedule = if imposed { log_std as f32 } else { 0.0 };
        let deviations = policy.deviations();
        for t in 0..s.steps {
            timed(&mut self.timers.copy, || {
                store_row(&*self.worlds, &self.memory, rollout, t);
                if correlated && t > 0 {
                    self.last_action.show(rollout, t);
                }
            });
            disturb_messages(config.channel, policy, rollout, t, &seed);
            let decision = timed(&mut self.timers.act, || {
                let mut rng = seed.index(t as u64).rng();
                if correlated && t > 0 {
                    renew(
                        &mut noise,
                        &*self.worlds,
                        s.actions,
                        &seed.child("noise").index(t as u64),
                    );
                }
                noise.advance(&mut rng);
                let mut carried = Tensor::zeros([0], FLOAT);
                if correlated {
                    let actions = rollout.at(t, s.actions);
                    rollout.carried[actions].copy_from_slice(noise.carried());
                    rollout.log_fresh[t * s.actions..][..s.actions]
                        .copy_from_slice(noise.log_fresh());
                    carried = Tensor::from_slice(noise.carried()).view([e, n, a]);
                }
                let log_fresh = if correlated { noise.log_fresh().to_vec() } else { Vec::new() };
                let graph = if s.graph_noise > 0 {
                    if policy.graph_lasts() {
                        rng = seed.child("graph").rng();
                    }
                    store_graph_noise(rollout, t, schedule, rng);
                    let cell = rollout.at(t, s.graph_noise);
                    Tensor::from_slice(&rollout.graph_noise[cell]).view([e, n, -1])
                } else {
                    Tensor::zeros([0], FLOAT)
                };
                let action = Tensor::from_slice(noise.drawn()).view([e, n, a]);
                let observation = Observation::at(rollout, t, &self.memory);
                policy.act(&observation, &ActMode::Sample { action, carried, graph, log_fresh })
            });
            timed(&mut self.timers.copy, || {
                copy_out(&decision.action, &mut rollout.action, t);
                copy_out(&decision.log_prob, &mut rollout.log_prob, t);
                if correlated {
                    let actions = &rollout.action[rollout.at(t, s.actions)];
                    self.last_action.note(actions, noise.values(), &deviations);
                }
            });
            self.memory = decision.memory;
            let actions = rollout.at(t, s.actions);
            timed(&mut self.timers.simulate, || self.worlds.step(&rollout.action[actions]))?;
            self.finished.extend(self.worlds.take_finished());
            if (stops.rollout)() {
                return Err(Error::Stopped);
            }
            timed(&mut self.timers.copy, || {
                for e in 0..self.worlds.count() {
                    let (frame, cell) = (self.worlds.view(e).frame, rollout.cell(t, e, 1));
                    rollout.reward[cell.clone()].copy_from_slice(&frame.reward);
                    rollout.terminated[cell.clone()].copy_from_slice(&frame.terminated);
                    rollout.truncated[cell].copy_from_slice(&frame.truncated);
                    rollout.interrupted[t * s.envs + e] = f32::from(u8::from(frame.interrupted));
                }
            });
        }
        timed(&mut self.timers.copy, || {
            store_row(&*self.worlds, &self.memory, rollout, s.steps);
            if correlated {
                self.last_action.show(rollout, s.steps);
            }
        });
        disturb_messages(config.channel, policy, rollout, s.steps, &seed);
        if policy.graph_lasts() {
            // The last observation is valued over the same graph as the rollout.
            store_graph_noise(rollout, s.steps, schedule, seed.child("graph").rng());
        }
        Ok(())
    }
}

/// Draws what the channel does to the messages of decision `t`: what becomes of each message, for a
/// policy with a radio, or else which ones are cut from the physical masks.
fn disturb_messages(
    channel: Channel,
    policy: &dyn Algorithm,
    rollout: &mut Rollout,
    t: usize,
    seed: &Seed,
) {
    if policy.message_width() == 0 {
        return;
    }
    let row = rollout.at(t, rollout.sizes.agents);
    let (agents, seed) = (rollout.sizes.agents, seed.child("channel").index(t as u64));
    if policy.has_radio() {
        rollout.disturbance.resize(rollout.comm.len(), 0.0);
        channel.disturb(&mut rollout.disturbance[row], agents, &seed);
    } else if channel.loss > 0.0 {
        channel.cut(&mut rollout.comm[row], agents, &seed);
    }
}

/// Makes the noise of agents that departed in the middle of an episode independent of the agents
/// that had their slots before.
fn renew(noise: &mut CorrelatedNoise, worlds: &dyn Worlds, actions: usize, seed: &Seed) {
    let mut first = 0;
    for e in 0..worlds.count() {
        let view = worlds.view(e);
        for (i, start) in view.frame.start.iter().enumerate() {
            if *start > 0.0 && view.step > 0 {
                let at = first + i * actions;
                noise.renew(at..at + actions, &mut seed.index(e as u64).index(i as u64).rng());
            }
        }
        first += view.frame.start.len() * actions;
    }
}

/// Stores row `t` of the rollout: the worlds' frames before decision `t`, and the policy's memory.
fn store_row(worlds: &dyn Worlds, memory: &Tensor, rollout: &mut Rollout, t: usize) {
    algo::store_frames(worlds, rollout, t);
    if rollout.sizes.memory > 0 {
        let range = rollout.at(t, rollout.sizes.memory);
        let count = range.len();
        memory.reshape([-1]).copy_data(&mut rollout.memory[range], count);
    }
}

/// Stores row `t` of the communication graphs' noise, whose scale is e to the power of `schedule`.
fn store_graph_noise(rollout: &mut Rollout, t: usize, schedule: f32, mut rng: Rng) {
    let row = rollout.at(t, rollout.sizes.graph_noise);
    let noise = &mut rollout.graph_noise[row];
    rng::fill_logistic(&mut rng, noise);
    for noise in noise {
        *noise *= schedule.exp();
    }
}

fn copy_out(tensor: &Tensor, to: &mut [f32], t: usize) {
    let count = tensor.numel();
    tensor.reshape([-1]).copy_data(&mut to[t * count..(t + 1) * count], count);
}

#[cfg(test)]
mod tests {
    use toml::Value;

    use super::*;
    use crate::algo::UpdateParameters;
    use crate::config::Layers;

    /// Where vehicles steer and noise is correlated, each action has the log density of the process
    /// that drew it, given the noise of the step before, in every world and at every step.
    #[test]
    fn actions_under_lasting_noise_have_the_probability_of_its_process() {
        let scenario = concat!(env!("CARGO_MANIFEST_DIR"), "/scenarios/parking_lot.xml");
        let flags = [("scenario", scenario), ("algorithm", "mappo")];
        let flags = flags.map(|(key, value)| (key, Value::String(value.to_owned()))).to_vec();
        let (mut config, scenario) =
            Config::resolve(&Layers { flags, ..Layers::default() }).expect("valid settings");
        (config.train.envs, config.train.rollout_steps) = (2, 6);
        let (correlation, log_std) =
            (config.learner.exploration.correlation, config.learner.exploration.log_std_start);
        let mut trainer = crate::driving::trainer(config, &scenario).expect("a trainer");
        // The second rollout must contain nothing of the first.
        trainer.collect(Seed::new(1), Stops::NEVER).expect("SUMO runs");
        trainer.collect(Seed::new(2), Stops::NEVER).expect("SUMO runs");
        let (rollout, s) = (&trainer.rollout, trainer.rollout.sizes);
        let (e, n) = (s.envs as i64, s.agents as i64);
        for t in 0..s.steps {
            let part = |array: &[f32], width: usize| {
                Tensor::from_slice(&array[rollout.at(t, width)]).view([e, n, -1])
            };
            let input = Observation::at(rollout, t, &Tensor::zeros([e, n, 0], FLOAT));
            let mean = trainer.learner.act(&input, &ActMode::Deterministic).action;
            let [mean, action, carried, log_prob] = [
                &mean,
                &part(&rollout.action, 2),
                &part(&rollout.carried, 2),
                &part(&rollout.log_prob, 2),
            ]
            .map(|x| Vec::<f32>::try_from(x.reshape([-1])).expect("numbers"));
            for (k, found) in log_prob.iter().enumerate() {
                // The dimensions are steering, whose noise never lasts, and throttle.
                let kept = if t == 0 || k % 2 == 0 { 0.0 } else { correlation };
                let deviation = log_std.exp() * (1.0 - kept * kept).sqrt();
                let expected = f64::from(mean[k]) + log_std.exp() * f64::from(carried[k]);
                assert_eq!(carried[k] == 0.0, kept == 0.0, "step {t}, entry {k}");
                let z = (f64::from(action[k]) - expected) / deviation;
                let density = -0.5 * z * z - deviation.ln() - 0.5 * std::f64::consts::TAU.ln();
                assert!(
                    (f64::from(*found) - density).abs() < 1e-3,
                    "step {t}, entry {k}: {found} {density}"
                );
            }
        }
        // An update that changes nothing scores the actions alike.
        let parameters = UpdateParameters { learning_rate: 0.0, log_std, entropy_coefficient: 0.0 };
        let losses = trainer.learner.update(&trainer.rollout, &parameters, Seed::new(3));
        let losses = losses.expect("finite");
        let divergence =
            losses.iter().find(|(name, _)| *name == "ppo/approx_kl").expect("reported").1;
        assert!(divergence.abs() < 1e-6, "{divergence}");
    }

    /// Where noise lasts (of the throttle, not of steering), agents observe their last mean action,
    /// and otherwise their last action.
    #[test]
    fn agents_do_not_observe_noise_that_lasts() {
        let scenario = concat!(env!("CARGO_MANIFEST_DIR"), "/scenarios/parking_lot.xml");
        for correlation in [0.95, 0.0] {
            let flags = [("scenario", scenario), ("algorithm", "mappo")];
            let flags = flags.map(|(key, value)| (key, Value::String(value.to_owned()))).to_vec();
            let (mut config, scenario) =
                Config::resolve(&Layers { flags, ..Layers::default() }).expect("valid settings");
            (config.train.envs, config.train.rollout_steps) = (2, 6);
            config.learner.exploration.correlation = correlation;
            let mut trainer = crate::driving::trainer(config, &scenario).expect("a trainer");
            let spec = trainer.environment.spec();
            let place = |name: &str| {
                spec.observation.list.iter().position(|f| f.name == name).expect("a feature")
            };
            let features = [place("steering.last_steer"), place("ego.last_action")];
            trainer.collect(Seed::new(1), Stops::NEVER).expect("SUMO runs");
            let (rollout, s) = (&trainer.rollout, trainer.rollout.sizes);
            let mut differing = 0;
            // The row after the last action is one of them, because it is valued as the others are.
            for t in 1..=s.steps {
                let input = Observation::at(rollout, t - 1, &Tensor::zeros([2, 5, 0], FLOAT));
                let mean = trainer.learner.act(&input, &ActMode::Deterministic).action;
                let means = Vec::<f32>::try_from(mean.reshape([-1])).expect("numbers");
                let actions = &rollout.action[rollout.at(t - 1, 2)];
                for agent in 0..s.envs * s.agents {
                    let row = rollout.at(t, 1).start + agent;
                    if rollout.active[row] == 0.0 || rollout.start[row] > 0.0 {
                        continue;
                    }
                    for (d, feature) in features.into_iter().enumerate() {
                        let seen = rollout.observation[row * s.observation + feature];
                        let done =
                            [&means[..], actions].map(|of| of[agent * 2 + d].clamp(-1.0, 1.0));
                        let expected = if correlation > 0.0 && d == 1 { done[0] } else { done[1] };
                        assert!((seen - expected).abs() < 1e-5, "{t} {agent} {d}: {seen} {done:?}");
                        differing += usize::from((done[0] - done[1]).abs() > 0.1);
                    }
                }
            }
            assert!(differing > 20, "{differing}");
        }
    }

    /// The scenario says how much the advantages of others count.
    #[test]
    fn rollouts_have_the_cooperation_of_the_scenario() {
        let scenario = concat!(env!("CARGO_MANIFEST_DIR"), "/scenarios/intersection.xml");
        let flags = [("scenario", scenario), ("algorithm", "mappo")];
        let flags = flags.map(|(key, value)| (key, Value::String(value.to_owned()))).to_vec();
        let sets = vec!["scenario.reward.cooperation=0.4".to_owned()];
        let layers = Layers { sets, flags, ..Layers::default() };
        let (config, scenario) = Config::resolve(&layers).expect("valid settings");
        let trainer = crate::driving::trainer(config, &scenario).expect("a trainer");
        assert_eq!(trainer.rollout.cooperation, 0.4);
    }

    /// In a training with losses, rollouts contain the masks of what arrived.
    #[test]
    fn lost_messages_are_lost_in_training() {
        let scenario = concat!(env!("CARGO_MANIFEST_DIR"), "/scenarios/intersection.xml");
        let heard = |algorithm: &str, loss: f64| {
            let flags = [("scenario", scenario), ("algorithm", algorithm)];
            let flags = flags.map(|(key, value)| (key, Value::String(value.to_owned()))).to_vec();
            let sets = vec![format!("channel.loss={loss}")];
            let layers = Layers { sets, flags, ..Layers::default() };
            let (mut config, scenario) = Config::resolve(&layers).expect("valid settings");
            assert_eq!(config.cannot_be_trained(), None);
            (config.train.envs, config.train.rollout_steps) = (2, 8);
            let mut trainer = crate::driving::trainer(config, &scenario).expect("a trainer");
            trainer.collect(Seed::new(1), Stops::NEVER).expect("SUMO runs");
            let (n, comm) = (trainer.rollout.sizes.agents, &trainer.rollout.comm);
            let own = |pair: usize| pair / n % n == pair % n;
            let sum = |of: bool| -> f32 {
                (0..comm.len()).filter(|&pair| own(pair) == of).map(|pair| comm[pair]).sum()
            };
            (sum(true), sum(false))
        };
        let (own, others) = heard("ex-iwol", 0.0);
        assert!(own > 0.0 && others > 0.0);
        let (same, half) = heard("ex-iwol", 0.5);
        assert!(same == own && (half / others - 0.5).abs() < 0.1, "{half} of {others}");
        assert_eq!(heard("ex-iwol", 1.0), (own, 0.0));
        // The masks of methods without messages serve their training only.
        assert_eq!(heard("im-iwol", 1.0).1, heard("im-iwol", 0.0).1);
    }

    /// In the training of a policy with a radio, rollouts say which messages are lost or false.
    #[test]
    fn rollouts_tell_what_becomes_of_messages() {
        let scenario = concat!(env!("CARGO_MANIFEST_DIR"), "/scenarios/intersection.xml");
        let share = |algorithm: &str, channel: &[&str], which: fn(f32) -> bool| {
            let flags = [("scenario", scenario), ("algorithm", algorithm)];
            let flags = flags.map(|(key, value)| (key, Value::String(value.to_owned()))).to_vec();
            let sets = channel.iter().map(|&set| set.to_owned()).collect();
            let layers = Layers { sets, flags, ..Layers::default() };
            let (mut config, scenario) = Config::resolve(&layers).expect("valid settings");
            (config.train.envs, config.train.rollout_steps) = (2, 8);
            let mut trainer = crate::driving::trainer(config, &scenario).expect("a trainer");
            trainer.collect(Seed::new(1), Stops::NEVER).expect("SUMO runs");
            trainer.iterate().expect("an update");
            let numbers = trainer.rollout.disturbance;
            numbers.iter().filter(|number| which(**number)).count() as f64 / numbers.len() as f64
        };
        let falsified = ["channel.falsified=0.3", "channel.delay=1"];
        assert!((share("magic", &falsified, |number| number > 0.0) - 0.3).abs() < 0.05);
        assert!(share("im-iwol", &falsified, |number| number > 0.0).is_nan(), "nobody talks");
        // MAGIC has two rounds, so that a mask could not keep lost messages from coming by others.
        // An agent's message to itself, one of eight, is never lost.
        let lost = share("magic", &["channel.loss=0.4"], |number| number == -1.0);
        assert!((lost - 0.4 * 7.0 / 8.0).abs() < 0.05, "{lost}");
        let mask = share("ex-iwol", &["channel.loss=0.4"], |number| number == -1.0);
        assert!(mask.is_nan(), "with one round, a mask is enough");
    }

    /// The end of a rollout is valued over the same graph as its steps.
    #[test]
    fn a_graph_for_a_whole_rollout_is_that_of_its_end_as_well() {
        let scenario = concat!(env!("CARGO_MANIFEST_DIR"), "/scenarios/intersection.xml");
        let flags = [("scenario", scenario), ("algorithm", "commformer")];
        let flags = flags.map(|(key, value)| (key, Value::String(value.to_owned()))).to_vec();
        let (mut config, scenario) =
            Config::resolve(&Layers { flags, ..Layers::default() }).expect("valid settings");
        (config.train.envs, config.train.rollout_steps) = (2, 8);
        let mut trainer = crate::driving::trainer(config, &scenario).expect("a trainer");
        trainer.collect(Seed::new(1), Stops::NEVER).expect("SUMO runs");
        let rollout = &trainer.rollout;
        let row = |t: usize| &rollout.graph_noise[rollout.at(t, rollout.sizes.graph_noise)];
        assert!(row(0).iter().any(|&noise| noise != 0.0), "{:?}", row(0));
        for t in 1..=rollout.sizes.steps {
            assert_eq!(row(t), row(0), "{t}");
        }
    }
}
