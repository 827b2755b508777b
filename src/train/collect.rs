//! Filling a rollout: what the worlds show, what the policy does with noise, what comes of it.

use rand::RngExt as _;
use tch::Tensor;

use super::noise::CorrelatedNoise;
use super::{Error, Trainer, schedule, timed};
use crate::algo::settings::NoiseMode;
use crate::algo::{ActMode, Observation};
use crate::env::{VecEnv, World};
use crate::rng::{self, Rng, Seed};
use crate::rollout::Rollout;

const FLOAT: (tch::Kind, tch::Device) = (tch::Kind::Float, tch::Device::Cpu);

impl Trainer {
    /// Plays as many steps as the rollout has, in all worlds.
    ///
    /// # Errors
    /// When SUMO fails twice in a row.
    pub(super) fn collect(&mut self, seed: Seed) -> Result<(), Error> {
        let s = self.rollout.sizes;
        let (e, n, a) = (s.envs as i64, s.agents as i64, s.actions as i64);
        let mut drawn = vec![0.0; s.envs * s.agents * s.actions];
        // Each iteration begins anew: what it draws depends on its number alone.
        let correlation = schedule::correlation(&self.config, &self.progress);
        let mut noise = CorrelatedNoise::new(s.envs * s.agents, &self.task.spec.actions, correlation);
        let correlated = noise.is_correlated();
        self.rollout.carried.resize(if correlated { self.rollout.action.len() } else { 0 }, 0.0);
        self.rollout.log_fresh.resize(if correlated { s.steps * s.actions } else { 0 }, 0.0);
        let world_offset = Tensor::from_slice(&self.rollout.log_std_offset).view([e, 1, 1]);
        // An imposed schedule is for all noise there is.
        let imposed = self.config.exploration.mode == NoiseMode::Schedule;
        let schedule = if imposed { schedule::pace(&self.config, &self.progress).log_std as f32 } else { 0.0 };
        let taught = schedule::pace(&self.config, &self.progress).imitation > 0.0;
        self.rollout.teacher.resize(if taught { self.rollout.action.len() } else { 0 }, 0.0);
        for t in 0..s.steps {
            timed(&mut self.timers.copy, || store_frames(&self.env, &self.memory, &mut self.rollout, t));
            self.store_potential(t);
            if let Some(teacher) = self.teacher.as_ref().filter(|_| taught) {
                let actions = self.rollout.at(t, s.actions);
                timed(&mut self.timers.act, || teacher.show(&self.env, &mut self.rollout.teacher[actions]));
            }
            let late: Vec<bool> = self.env.worlds().map(|world| self.is_late(world)).collect();
            for (e, late) in late.iter().enumerate() {
                self.rollout.sampled[t * s.envs + e] = f32::from(u8::from(!late));
            }
            let decision = timed(&mut self.timers.act, || {
                let mut rng = seed.index(t as u64).rng();
                noise.advance(&mut rng);
                drawn.copy_from_slice(noise.drawn());
                let width = s.agents * s.actions;
                for (noise, _) in drawn.chunks_mut(width).zip(&late).filter(|(_, late)| **late) {
                    noise.fill(0.0);
                }
                let (mut carried, mut offset) = (Tensor::zeros([0], FLOAT), world_offset.shallow_clone());
                if correlated {
                    let actions = self.rollout.at(t, s.actions);
                    let row = &mut self.rollout.carried[actions];
                    row.copy_from_slice(noise.carried());
                    for ((row, offset), late) in row.chunks_mut(width).zip(&self.rollout.log_std_offset).zip(&late) {
                        let scale = if *late { 0.0 } else { offset.exp() };
                        for carried in row {
                            *carried *= scale;
                        }
                    }
                    carried = Tensor::from_slice(row).view([e, n, a]);
                    self.rollout.log_fresh[t * s.actions..(t + 1) * s.actions].copy_from_slice(noise.log_fresh());
                    offset = &world_offset + Tensor::from_slice(noise.log_fresh()).view([1, 1, a]);
                }
                let graph = if s.graphs > 0 {
                    if self.learner.graph_lasts() {
                        rng = seed.child("graph").rng();
                    }
                    store_graph_noise(&mut self.rollout, t, &late, schedule, rng);
                    let cell = self.rollout.at(t, s.agents * s.graphs);
                    Tensor::from_slice(&self.rollout.graph_noise[cell]).view([e, n, -1])
                } else {
                    Tensor::zeros([0], FLOAT)
                };
                let action = Tensor::from_slice(&drawn).view([e, n, a]);
                let observation = Observation {
                    observation: Tensor::from_slice(&self.rollout.observation[self.rollout.at(t, s.observation)])
                        .view([e, n, -1]),
                    comm: Tensor::from_slice(&self.rollout.comm[self.rollout.at(t, s.agents)]).view([e, n, n]),
                    start: Tensor::from_slice(&self.rollout.start[t * s.envs..(t + 1) * s.envs]),
                    memory: self.memory.shallow_clone(),
                };
                let (action, carried, graph, log_std_offset) = (&action, &carried, &graph, &offset);
                self.learner.act(&observation, &ActMode::Sample { action, carried, graph, log_std_offset })
            });
            timed(&mut self.timers.copy, || {
                copy_out(&decision.action, &mut self.rollout.action, t);
                copy_out(&decision.log_prob, &mut self.rollout.log_prob, t);
            });
            self.memory = decision.memory;
            let actions = self.rollout.at(t, s.actions);
            timed(&mut self.timers.simulate, || self.env.step(&self.rollout.action[actions]))?;
            self.finished.extend(self.env.take_finished());
            timed(&mut self.timers.copy, || {
                for (e, world) in self.env.worlds().enumerate() {
                    let (frame, cell) = (world.frame(), self.rollout.cell(t, e, 1));
                    self.rollout.reward[cell.clone()].copy_from_slice(&frame.reward);
                    self.rollout.terminated[cell.clone()].copy_from_slice(&frame.terminated);
                    self.rollout.truncated[cell].copy_from_slice(&frame.truncated);
                    self.rollout.interrupted[t * s.envs + e] = f32::from(u8::from(frame.interrupted));
                }
            });
        }
        timed(&mut self.timers.copy, || store_frames(&self.env, &self.memory, &mut self.rollout, s.steps));
        self.store_potential(s.steps);
        if self.learner.graph_lasts() {
            // The value of what the rollout ends with is that of the same graph.
            let late: Vec<bool> = self.env.worlds().map(|world| self.is_late(world)).collect();
            store_graph_noise(&mut self.rollout, s.steps, &late, schedule, seed.child("graph").rng());
        }
        Ok(())
    }

    /// The potential that shapes rewards, of what is observed at step `t` of the rollout.
    fn store_potential(&mut self, t: usize) {
        let weight = self.config.train.shaping;
        if weight == 0.0 {
            return;
        }
        self.rollout.potential.resize(self.rollout.active.len(), 0.0);
        for (e, world) in self.env.worlds().enumerate() {
            let cell = self.rollout.cell(t, e, 1);
            for (i, potential) in self.rollout.potential[cell].iter_mut().enumerate() {
                *potential = (-weight * world.danger(i)) as f32;
            }
        }
    }

    /// Whether a world's episode still goes without noise.
    fn is_late(&self, world: &World) -> bool {
        let late = self.config.exploration.late_steps;
        let mut rng = self.seed.child("late").index(world.turn()).rng();
        late > 0 && rng.random_bool(0.5) && world.step_count() < rng.random_range(0..late)
    }
}

/// Row `t` of the rollout: what the worlds show before decision `t`, and the memory that comes with it.
fn store_frames(env: &VecEnv, memory: &Tensor, rollout: &mut Rollout, t: usize) {
    let s = rollout.sizes;
    for (e, world) in env.worlds().enumerate() {
        let frame = world.frame();
        let cell = |width| rollout.cell(t, e, width);
        let (observation, state, comm, active) = (cell(s.observation), cell(s.state), cell(s.agents), cell(1));
        rollout.observation[observation].copy_from_slice(&frame.observation);
        rollout.state[state].copy_from_slice(&frame.state);
        rollout.comm[comm].copy_from_slice(&frame.comm);
        rollout.active[active].copy_from_slice(&frame.active);
        if !frame.sharing.is_empty() && t < s.steps {
            rollout.sharing.resize(s.steps * s.envs * s.agents * s.agents, 0.0);
            let cell = rollout.cell(t, e, s.agents);
            rollout.sharing[cell].copy_from_slice(&frame.sharing);
        }
        rollout.start[t * s.envs + e] = f32::from(u8::from(frame.start));
    }
    if s.memory > 0 {
        let range = rollout.at(t, s.memory);
        let count = range.len();
        memory.reshape([-1]).copy_data(&mut rollout.memory[range], count);
    }
}

/// Row `t` of the noise of graphs. Worlds with less noise of actions have less noise of graphs.
fn store_graph_noise(rollout: &mut Rollout, t: usize, late: &[bool], schedule: f32, mut rng: Rng) {
    let s = rollout.sizes;
    let row = rollout.at(t, s.agents * s.graphs);
    rng::fill_logistic(&mut rng, &mut rollout.graph_noise[row]);
    for (e, late) in late.iter().enumerate() {
        let of_world = rollout.cell(t, e, s.agents * s.graphs);
        let scale = f32::from(u8::from(!late)) * (rollout.log_std_offset[e] + schedule).exp();
        rollout.graph_noise[of_world].iter_mut().for_each(|noise| *noise *= scale);
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
    use crate::config::{Config, Layers};

    /// Where vehicles steer and noise lasts, each action has the probability of the process that
    /// drew it, given the noise of the step before, in every world and at every step.
    #[test]
    fn actions_under_lasting_noise_have_the_probability_of_its_process() {
        let scenario = concat!(env!("CARGO_MANIFEST_DIR"), "/scenarios/parking_lot.xml");
        let flags = [("scenario", scenario), ("algorithm", "mappo")];
        let flags = flags.map(|(key, value)| (key, Value::String(value.to_owned()))).to_vec();
        let (mut config, scenario) = Config::resolve(&Layers { flags, ..Layers::default() }).expect("valid settings");
        (config.train.envs, config.train.segment, config.exploration.spread) = (2, 6, 0.7);
        let (correlation, log_std) = (config.exploration.correlation, config.exploration.log_std_start);
        let mut trainer = Trainer::new(config, scenario).expect("a trainer");
        // Nothing is left over from the rollout before.
        trainer.collect(Seed::new(1)).expect("SUMO runs");
        trainer.collect(Seed::new(2)).expect("SUMO runs");
        let (rollout, s) = (&trainer.rollout, trainer.rollout.sizes);
        let (e, n) = (s.envs as i64, s.agents as i64);
        for t in 0..s.steps {
            let part = |array: &[f32], width: usize| Tensor::from_slice(&array[rollout.at(t, width)]).view([e, n, -1]);
            let input = Observation {
                observation: part(&rollout.observation, s.observation),
                comm: part(&rollout.comm, s.agents),
                start: Tensor::zeros([e], FLOAT),
                memory: Tensor::zeros([e, n, 0], FLOAT),
            };
            let mean = trainer.learner.act(&input, &ActMode::Deterministic).action;
            let [mean, action, carried, log_prob] =
                [&mean, &part(&rollout.action, 2), &part(&rollout.carried, 2), &part(&rollout.log_prob, 2)]
                    .map(|x| Vec::<f32>::try_from(x.reshape([-1])).expect("numbers"));
            for (k, found) in log_prob.iter().enumerate() {
                let (world, dimension) = (k / (2 * s.agents), k % 2);
                let steers = dimension == 0;
                let scheduled = log_std + if steers { f64::from(0.37_f32.ln()) } else { 0.0 };
                let kept = if steers || t == 0 { 0.0 } else { correlation };
                let deviation =
                    (scheduled + f64::from(rollout.log_std_offset[world])).exp() * (1.0 - kept * kept).sqrt();
                let expected = f64::from(mean[k]) + scheduled.exp() * f64::from(carried[k]);
                assert!(!(steers || t == 0) || carried[k] == 0.0, "only throttle and brake have lasting noise");
                let z = (f64::from(action[k]) - expected) / deviation;
                let density = -0.5 * z * z - deviation.ln() - 0.5 * std::f64::consts::TAU.ln();
                assert!((f64::from(*found) - density).abs() < 1e-3, "step {t}, entry {k}: {found} {density}");
            }
        }
    }

    /// What a rollout ends with is valued over the graph that acted, as all else of it.
    #[test]
    fn a_graph_for_a_whole_rollout_is_that_of_its_end_as_well() {
        let scenario = concat!(env!("CARGO_MANIFEST_DIR"), "/scenarios/intersection.xml");
        let flags = [("scenario", scenario), ("algorithm", "commformer")];
        let flags = flags.map(|(key, value)| (key, Value::String(value.to_owned()))).to_vec();
        let (mut config, scenario) = Config::resolve(&Layers { flags, ..Layers::default() }).expect("valid settings");
        config.exploration.late_steps = 0;
        (config.train.envs, config.train.segment) = (2, 8);
        let mut trainer = Trainer::new(config, scenario).expect("a trainer");
        trainer.collect(Seed::new(1)).expect("SUMO runs");
        let rollout = &trainer.rollout;
        let row = |t: usize| &rollout.graph_noise[rollout.at(t, rollout.sizes.agents * rollout.sizes.graphs)];
        assert!(row(0).iter().any(|&noise| noise != 0.0), "{:?}", row(0));
        for t in 1..=rollout.sizes.steps {
            assert_eq!(row(t), row(0), "{t}");
        }
    }
}
