//! Learning itself, in games of two agents.

use iwol_sumo::algo::settings::EncoderKind;
use iwol_sumo::algo::{self, ActMode, CommunicationScope, Observation, UpdateParameters};
use iwol_sumo::rng::{self, Seed};
use iwol_sumo::rollout::{Rollout, Sizes};
use tch::{Device, Kind, Tensor};

use crate::support::in_parallel;

use super::{PACE, build, complete, noise, nothing, observation, random_rollout, small, spec};

/// Games of two agents that each see a number.
#[derive(Clone, Copy, PartialEq)]
enum Game {
    /// The best action is the other agent's number.
    Other,
    /// The best action is the number that the other agent had one step before.
    OtherBefore,
    /// Both agents see both numbers and share a reward: the sum of what they drive, minus a penalty
    /// for driving at the same time.
    Crossing,
}

impl Game {
    /// Returns the number of steps of an episode.
    fn steps(self) -> usize {
        if self == Self::OtherBefore { 2 } else { 1 }
    }

    /// Returns the rewards for `actions` of pairs of agents whose first features are `x` and were
    /// `before` one step earlier.
    fn rewards(self, x: &[f32], before: &[f32], actions: &[f32]) -> Vec<f32> {
        let off = |k: usize, aim: f32| -(actions[k] - aim).powi(2);
        let driven = |k: usize| actions[k].clamp(0.0, 1.0);
        let reward = |k: usize| match self {
            Self::Other => off(k, x[k ^ 1]),
            Self::OtherBefore if before.is_empty() => 0.0,
            Self::OtherBefore => off(k, before[k ^ 1]),
            Self::Crossing => driven(k) + driven(k ^ 1) - 4.0 * driven(k) * driven(k ^ 1),
        };
        (0..actions.len()).map(reward).collect()
    }
}

/// Trains a learner for `updates` updates and returns the mean reward of the last one.
fn play(name: &str, game: Game, updates: u64) -> f32 {
    let (e, n, o) = (32_usize, 2, 4);
    let mut settings = small(EncoderKind::Mlp);
    settings.exploration.log_std_start = -0.5;
    settings.ppo.minibatch = 256;
    // A second shard would double the number of operations, whose number takes the time here.
    settings.ppo.shards = 1;
    let mut learner = build(name, &spec(n), &settings, 1);
    let sizes = Sizes {
        steps: 16,
        envs: e,
        agents: n,
        observation: o,
        state: 3,
        actions: 1,
        choices: 0,
        memory: learner.memory(),
        graph_noise: learner.graph_noise(n),
    };
    let mut rollout = Rollout::new(sizes);
    rollout.active.fill(1.0);
    rollout.comm.fill(1.0);
    for t in (0..=sizes.steps).step_by(game.steps()) {
        let cell = rollout.at(t, 1);
        rollout.start[cell].fill(1.0);
    }
    for t in (game.steps() - 1..sizes.steps).step_by(game.steps()) {
        let cell = rollout.at(t, 1);
        rollout.terminated[cell].fill(1.0);
    }
    let shaped = |values: &[f32], width: usize| {
        Tensor::from_slice(values).view([e as i64, n as i64, width as i64])
    };
    let mut mean = 0.0;
    for update in 0..updates {
        let mut rng = Seed::new(2).index(update).rng();
        rollout.observation.iter_mut().for_each(|x| *x = rng::symmetric(&mut rng) as f32);
        for pair in rollout.observation.chunks_mut(n * o) {
            match game {
                Game::Crossing => (pair[1], pair[o + 1]) = (pair[o], pair[0]),
                // A symbol is about all that its sender saw, so that only the number is left to
                // encode.
                Game::OtherBefore => (0..n * o).filter(|i| i % o > 0).for_each(|i| pair[i] = 0.0),
                Game::Other => {}
            }
        }
        rng::fill_logistic(&mut rng, &mut rollout.graph_noise);
        let mut eps = vec![0.0; e * n];
        let (mut before, mut memory) = (Vec::new(), vec![0.0_f32; e * n * sizes.memory]);
        mean = 0.0;
        for t in 0..sizes.steps {
            let first = t % game.steps() == 0;
            if first {
                before.clear();
                memory.fill(0.0);
            }
            rng::fill_normal(&mut rng, &mut eps);
            let cell = rollout.at(t, sizes.memory);
            rollout.memory[cell].copy_from_slice(&memory);
            let x = &rollout.observation[rollout.at(t, o)];
            let input = Observation {
                observation: shaped(x, o),
                comm: Tensor::ones([e as i64, n as i64, n as i64], (Kind::Float, Device::Cpu)),
                start: shaped(&rollout.start[rollout.at(t, 1)], 1).squeeze_dim(-1),
                memory: shaped(&memory, sizes.memory),
                disturbance: nothing(),
                available: nothing(),
            };
            let graph = if sizes.graph_noise > 0 {
                shaped(&rollout.graph_noise[rollout.at(t, sizes.graph_noise)], sizes.graph_noise)
            } else {
                Tensor::zeros([0], (Kind::Float, Device::Cpu))
            };
            let (action, carried, log_fresh) = (shaped(&eps, 1), nothing(), Vec::new());
            let decision =
                learner.act(&input, &ActMode::Sample { action, carried, graph, log_fresh });
            let numbers =
                |tensor: &Tensor| Vec::<f32>::try_from(tensor.reshape([-1])).expect("numbers");
            let (actions, log_probs) = (numbers(&decision.action), numbers(&decision.log_prob));
            let seen: Vec<f32> = x.iter().step_by(o).copied().collect();
            let rewards = game.rewards(&seen, &before, &actions);
            (before, memory) = (seen, numbers(&decision.memory));
            // The first step of an `OtherBefore` episode has no reward and does not count.
            let asked = sizes.steps / game.steps();
            mean += rewards.iter().sum::<f32>() / (e * n * asked) as f32;
            let cell = rollout.at(t, 1);
            rollout.action[cell.clone()].copy_from_slice(&actions);
            rollout.log_prob[cell.clone()].copy_from_slice(&log_probs);
            rollout.reward[cell].copy_from_slice(&rewards);
        }
        let share = (update + 1) as f64 / updates as f64;
        let parameters = UpdateParameters {
            learning_rate: 3e-3 * (1.0 - 0.9 * (2.5 * share - 1.5).max(0.0)),
            log_std: -0.5 - share,
            ..PACE
        };
        learner.update(&rollout, &parameters, Seed::new(3).index(update)).expect("finite");
    }
    mean
}

/// Every method learns who goes first. The pair earns at most 1, when one agent drives and the
/// other waits; equal actions earn at most 0.25, at a quarter of the speed, so that the order must
/// follow from the numbers.
#[test]
fn every_algorithm_learns_who_goes_first() {
    in_parallel(algo::NAMES.to_vec(), |name| {
        let reward = play(name, Game::Crossing, 60);
        assert!(reward > 0.6, "{name}: {reward}");
    });
}

#[test]
fn messages_help_where_they_are_needed() {
    let scope = |name: &str| algo::capabilities(name).expect("known").scope;
    // MAPPO stands for all methods without communication; another test checks for each method that
    // no observation reaches an agent that it must not reach.
    let without = play("mappo", Game::Other, 60);
    assert!(without < -0.3, "what the other sees cannot be guessed: {without}");
    let told = algo::NAMES.into_iter().filter(|name| {
        !matches!(scope(name), CommunicationScope::None | CommunicationScope::InRangeNextStep)
    });
    in_parallel(told.collect(), |name| {
        // The bound is wide, because rounding differs between processors and a run then takes
        // another course.
        let with = play(name, Game::Other, 120);
        assert!(with > -0.25, "{name}: but it can be told: {with}");
    });
}

#[test]
fn symbols_help_where_they_are_needed() {
    let without = play("mappo", Game::OtherBefore, 60);
    assert!(without < -0.3, "what the other saw cannot be guessed: {without}");
    let scope = |name: &str| algo::capabilities(name).expect("known").scope;
    for name in
        algo::NAMES.into_iter().filter(|name| scope(name) == CommunicationScope::InRangeNextStep)
    {
        let with = play(name, Game::OtherBefore, 120);
        assert!(with > -0.2, "{name}: but a symbol can tell: {with}");
    }
}

/// A reward of 1 in every step without end has the value 1 / (1 - γ), however fast the statistics
/// that normalise values follow the values.
#[test]
fn values_do_not_feed_on_their_own_normalisation() {
    const GAMMA: f64 = 0.9;
    for name in ["maddpg", "maddpg-iwol"] {
        let mut settings = small(EncoderKind::Mlp);
        (settings.ppo.average, settings.ppo.gamma, settings.maddpg.updates) = (0.0, GAMMA, 100);
        let mut learner = build(name, &spec(2), &settings, 1);
        let mut rollout = random_rollout(&*learner, 2, 3);
        rollout.reward.fill(1.0);
        rollout.active.fill(1.0);
        rollout.comm.fill(1.0);
        rollout.terminated.fill(0.0);
        let parameters = UpdateParameters { learning_rate: 3e-3, log_std: -1.0, ..PACE };
        let input = observation(&*learner, noise(4, &[1, 2, 4]), complete(1, 2));
        let state = noise(5, &[1, 2, 3]);
        let mut values = Vec::new();
        for round in 0..20 {
            learner.update(&rollout, &parameters, Seed::new(round)).expect("finite");
            values.push(
                learner.inspect(&input, &state).value.expect("a value").double_value(&[0, 0]),
            );
        }
        let truth = 1.0 / (1.0 - GAMMA);
        assert!(values.iter().all(|value| *value < 1.1 * truth), "{name}: {values:?}");
        assert!((values[19] - truth).abs() < 0.1 * truth, "{name}: {values:?}");
    }
}
