//! Defaults of settings: those that the structs declare, the preset of the scenario's kind, the
//! rules by which defaults follow from the number of agents, the method and the initial weights, and
//! the profile.

use super::Config;
use super::origin::Origin;
use super::presets::STEERING;
use super::profiles::Profile;
use super::values::Values;
use crate::algo;
use crate::algo::settings::Exploration;
use crate::env::EnvSpec;
use crate::scenario::ScenarioFile;

/// Entropy coefficient where actions are discrete (usual in PPO, and that of MAPPO's scripts).
const ENTROPY_OF_CHOICES: f64 = 0.01;

/// Where agents act.
#[derive(Clone, Copy)]
pub(super) enum Setting<'a> {
    /// In a scenario.
    Scenario(&'a ScenarioFile),
    /// In an environment that has no scenario.
    Environment {
        /// Name of the environment.
        name: &'a str,
        spec: &'a EnvSpec,
    },
}

impl Setting<'_> {
    /// Returns the number of agents unless another one is set.
    pub(super) fn agents(self) -> u32 {
        match self {
            Self::Scenario(file) => file.scenario.agents.default,
            Self::Environment { spec, .. } => u32::try_from(spec.agents).unwrap_or(u32::MAX),
        }
    }
}

impl Values {
    /// Returns the defaults for `algorithm` with `agents` agents on a machine of this `profile`;
    /// `trained`: training starts from a trained policy. `purpose`: a preset is taken over next, for
    /// which the profile must not change sizes.
    pub(super) fn defaults(
        setting: Setting<'_>,
        algorithm: &str,
        agents: u32,
        trained: bool,
        profile: &Profile,
        purpose: bool,
    ) -> Self {
        let (file, spec) = match setting {
            Setting::Scenario(file) => (Some(file), None),
            Setting::Environment { spec, .. } => (None, Some(spec)),
        };
        let mut values = Self::of(&Config::declared(setting), |key| {
            let own = key.starts_with("scenario.") || key == "agents";
            if own && file.is_some() { Origin::Scenario } else { Origin::Declared }
        });
        let steers = file.is_some_and(|file| file.scenario.control.steering.is_some());
        if steers {
            values.preset(&STEERING);
        }
        let rule = Origin::Rule;
        values.follow(&rule("number of agents"), |config| config.follow_agents(agents, steers));
        if file.is_some_and(|file| file.scenario.agents.come_from_files()) {
            // The horizon of an open-ended flow is no deadline.
            values.follow(&rule("agents from route files"), |config| {
                config.train.bootstrap_horizon = true;
            });
        }
        if spec.is_some_and(|spec| spec.actions.choices().is_some()) {
            // There is no noise to follow, and nothing else keeps the policy exploring.
            values.follow(&rule("discrete actions"), |config| {
                config.learner.ppo.entropy_coefficient = ENTROPY_OF_CHOICES;
                config.learner.ppo.learning_rate_follows_noise = false;
            });
        }
        values.follow(&rule("method"), |config| config.follow_method(algorithm));
        if trained {
            // With the noise for new weights, a trained policy would forget what it has learned.
            values.follow(&rule("initial policy"), |config| {
                config.learner.exploration.log_std_start = Exploration::LOG_STD_EXPLORED;
            });
        }
        values.follow(&Origin::Profile(profile.name), |config| {
            config.use_cores(profile);
            if !purpose {
                config.use_sizes(profile);
            }
        });
        values
    }
}

impl Config {
    /// Scales lengths and counts, which are declared for 8 agents. A step with N agents brings N
    /// samples, so fewer agents need more steps, and more agents fewer; but with more agents, a
    /// successful policy takes longer to find.
    fn follow_agents(&mut self, agents: u32, steers: bool) {
        let scaled = |length: u64| length * 8 / u64::from(agents.clamp(4, 48));
        let lengthened = |length: u64| scaled(length).max(length);
        let train = &mut self.train;
        let envs = train.envs as u64;
        train.envs = if agents < 8 && !steers {
            // A few vehicles that do not steer can start in many ways: with rollouts of half the
            // size, policies converged too early to careful driving.
            2 * scaled(envs)
        } else {
            scaled(envs).max(envs.min(2 * scaled(envs))).max(8)
        } as usize;
        train.validate_every = scaled(train.validate_every).max(train.validate_every / 4);
        train.validation_episodes =
            scaled(train.validation_episodes).max(train.validation_episodes / 4);
        // Throughput rises as long as annealing lasts, so annealing is not shortened further
        // (docs/lab/decision-process.md).
        train.anneal_steps = scaled(train.anneal_steps).max(train.anneal_steps / 2);
        let exploration = &mut self.learner.exploration;
        exploration.explore_steps = lengthened(exploration.explore_steps);
        if steers {
            self.steps = lengthened(self.steps);
        }
    }

    /// Adapts defaults to what the method learns from.
    fn follow_method(&mut self, algorithm: &str) {
        let Ok(method) = algo::capabilities(algorithm) else { return };
        if !method.on_policy {
            // Samples of a replay buffer are used many times; half as many at once take about half
            // the time.
            self.learner.ppo.minibatch /= 2;
        }
        if method.team {
            // A team's return is the sum of its agents' own rewards; shares of agents that have
            // left would be lost.
            self.scenario.set("reward", "cooperation", 0.0.into());
        }
    }
}
