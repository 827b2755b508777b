//! The defaults, which follow the number of agents: see [`Config::resolve`] for the rules in words.

use std::path::PathBuf;

use toml::Table;

use super::{Config, DEFAULT_ALGORITHM, Env, Simulation, Train};
use crate::algo::{self, settings};
use crate::scenario::Scenario;

impl Config {
    /// Those of `algorithm` with so many agents; `trained`: it begins with a trained policy.
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
        // Lengths are meant for 8 agents. A step of N brings N samples, so that more steps of fewer agents are needed, and fewer
        // of more; but among more the way takes longer to find.
        let scaled = |length: u64| length * 8 / u64::from(agents.clamp(4, 48));
        let at_least_half = |length: u64| scaled(length).max(length / 2);
        let envs = train.envs as u64;
        // To stay on the road is imitated; what a vehicle that steers must find out is when to wait.
        let steers = scenario.control.steering.is_some();
        // Few who go straight start in one of many ways: in rollouts half as large a policy settled too early on a careful one.
        let few = agents < 8 && !steers;
        let on_policy = algo::capabilities(algorithm).is_ok_and(|c| c.on_policy);
        let imitates = steers && !trained && on_policy;
        let train = Train {
            growth: if steers && on_policy { 4 } else { train.growth },
            envs: if few {
                2 * scaled(envs)
            } else {
                scaled(envs).max(envs.min(2 * scaled(envs))).max(8)
            } as usize,
            validate_every: scaled(train.validate_every).max(train.validate_every / 4),
            validation_episodes: scaled(train.validation_episodes).max(16),
            // Vehicles become faster as long as annealing lasts: with a sixth of it, 48 drove at
            // four fifths of their throughput.
            anneal_steps: at_least_half(if steers { 300_000 } else { train.anneal_steps }),
            imitate_steps: if imitates { 60_000 } else { train.imitate_steps },
            // Vehicles that steer reach more than this with less noise only.
            anneal_success: if steers { 0.9 } else { train.anneal_success },
            ..train
        };
        let exploration = settings::Exploration {
            // Of many routes, each meeting is seen seldom: noise that lasts makes one vehicle wait for the other more often, and is
            // needed for longer.
            correlation: if steers { 0.8 } else { exploration.correlation },
            // It fades, as agents must come to do without it; methods that replay get worse as it
            // does.
            correlation_steps: if steers && on_policy {
                scaled(exploration.explore_steps)
            } else {
                exploration.correlation_steps
            },
            explore_steps: scaled(exploration.explore_steps).max(exploration.explore_steps)
                * if steers { 2 } else { 1 },
            // At the noise of new weights a policy forgets what it knows.
            log_std_start: if trained {
                exploration.log_std_explore
            } else {
                exploration.log_std_start
            },
            ..exploration
        };
        let ppo = settings::Ppo {
            // With a long view from the beginning, vehicles that steer learn to wait; without one in the end, that a crash is worth
            // the time it saves.
            gamma_explored: if steers { 0.995 } else { ppo.gamma_explored },
            // What is replayed is learned from many times; half of it each time takes about half the time.
            minibatch: if on_policy { ppo.minibatch } else { ppo.minibatch / 2 },
            ..ppo
        };
        // A team's return is the sum of its agents' own rewards; shares of those who are gone would be lost.
        let (team, env) = (algo::capabilities(algorithm).is_ok_and(|c| c.team), Env::of(scenario));
        let config = Self {
            scenario: scenario.path.clone(),
            algorithm: DEFAULT_ALGORITHM.to_owned(),
            agents: scenario.agents.default,
            seed: 0,
            steps: scaled(600_000).max(600_000) * if steers { 4 } else { 1 },
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
