//! Defaults of settings, which depend on the number of agents; [`Config::resolve`] lists the rules.

use std::path::PathBuf;

use toml::Table;

use super::{Config, DEFAULT_ALGORITHM, Env, Simulation, Train};
use crate::algo::{self, settings};
use crate::scenario::Scenario;

impl Config {
    /// Returns the defaults for `algorithm` with `agents` agents; `trained`: training starts from a
    /// trained policy.
    pub(super) fn defaults(
        scenario: &Scenario,
        algorithm: &str,
        agents: u32,
        trained: bool,
    ) -> Table {
        let algo::Settings {
            network,
            ppo,
            exploration,
            iwol,
            transformer,
            magic,
            commformer,
            icp,
            maddpg,
        } = algo::Settings::default();
        let train = Train::default();
        // Lengths are for 8 agents. A step with N agents brings N samples, so fewer agents need
        // more steps, and more agents fewer; but with more agents, a successful policy takes longer
        // to find.
        let scaled = |length: u64| length * 8 / u64::from(agents.clamp(4, 48));
        let at_least_half = |length: u64| scaled(length).max(length / 2);
        let envs = train.envs as u64;
        let steers = scenario.control.steering.is_some();
        // A few vehicles that do not steer can start in many ways: with rollouts of half the size,
        // policies converged too early to careful driving.
        let few = agents < 8 && !steers;
        let on_policy = algo::capabilities(algorithm).is_ok_and(|c| c.on_policy);
        let train = Train {
            batch_growth: if steers && on_policy { 4 } else { train.batch_growth },
            envs: if few {
                2 * scaled(envs)
            } else {
                scaled(envs).max(envs.min(2 * scaled(envs))).max(8)
            } as usize,
            validate_every: scaled(train.validate_every).max(train.validate_every / 4),
            validation_episodes: scaled(train.validation_episodes).max(16),
            // Throughput rises as long as annealing lasts, so annealing is not shortened further
            // (docs/lab/decision-process.md).
            anneal_steps: at_least_half(if steers { 300_000 } else { train.anneal_steps }),
            // Vehicles that steer exceed this success only once there is less noise.
            anneal_success: if steers { 0.9 } else { train.anneal_success },
            ..train
        };
        let exploration = settings::Exploration {
            // A turn takes a second or two of steering to one side, which noise that is independent
            // from step to step never does (docs/lab/decision-process.md).
            correlation: if steers { 0.95 } else { exploration.correlation },
            explore_steps: scaled(exploration.explore_steps).max(exploration.explore_steps)
                * if steers { 2 } else { 1 },
            // With the noise for new weights, a trained policy would forget what it has learned.
            log_std_start: if trained {
                exploration.log_std_explore
            } else {
                exploration.log_std_start
            },
            ..exploration
        };
        let ppo = settings::Ppo {
            // With a high discount from the beginning, vehicles that steer learn to wait; with a
            // low one at the end, a crash is worth the time that it saves (docs/lab/0.1.0.md).
            gamma_explored: if steers { 0.995 } else { ppo.gamma_explored },
            // Samples of a replay buffer are used many times; half as many at once take about half
            // the time.
            minibatch: if on_policy { ppo.minibatch } else { ppo.minibatch / 2 },
            ..ppo
        };
        // A team's return is the sum of its agents' own rewards; shares of agents that have left
        // would be lost.
        let (team, env) = (algo::capabilities(algorithm).is_ok_and(|c| c.team), Env::of(scenario));
        let config = Self {
            scenario: scenario.path.clone(),
            algorithm: DEFAULT_ALGORITHM.to_owned(),
            agents: scenario.agents.default,
            seed: 0,
            // A limit: without steering, most runs stop long before it.
            steps: if steers { scaled(2_400_000).max(2_400_000) } else { 1_200_000 },
            device: algo::ComputeDevice::Cpu,
            init_from: PathBuf::new(),
            train,
            simulation: Simulation::default(),
            network,
            ppo,
            exploration,
            iwol,
            transformer,
            magic,
            commformer,
            icp,
            maddpg,
            channel: algo::Channel::default(),
            env: if team { Env { cooperation: 0.0, ..env } } else { env },
        };
        Table::try_from(config).expect("a configuration is plain data")
    }
}
