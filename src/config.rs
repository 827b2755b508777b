//! Settings of a run: defaults < profile < preset < `--config file.toml` < `--set key=value` < flags,
//! checked key by key.
//!
//! A setting is declared once, as a field of the struct of its group: documentation, default and
//! range. The scenario's numbers, words and flags are declared in the schema of scenario files, and
//! `scenario.<element>.<attribute>` overrides them. The resolved configuration contains them all;
//! it is stored with the run and is itself a valid `--config`. Every error names the file, line and
//! column, and the nearest valid key.

#![cfg(feature = "learn")]

mod defaults;
mod document;
mod error;
mod flat;
mod layers;
mod origin;
mod presets;
mod profiles;
mod rules;
mod scenario;
mod schema;
#[cfg(test)]
mod tests;
mod uses;
mod values;

pub use document::Document;
pub use error::Error;
pub use flat::{Change, flatten, full_name, plain};
pub use layers::{Layers, Resolution, TaskSource};
pub use origin::{Origin, Origins};
pub use presets::{PRESETS, Preset};
pub use profiles::{PROFILES, Profile};
pub(crate) use scenario::flat_changes;
pub use scenario::{ScenarioSettings, changes};
pub use uses::{idle, no_matter_of_evaluation, overruled, unread, without_effect};

use defaults::Setting;
use std::path::PathBuf;
use std::time::Duration;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use smart_default::SmartDefault;
use toml::Table;

use crate::algo;
use crate::env::NamedEnvironment;
use crate::sumo::{Choice, Hosting};

/// The method that is trained unless another one is set.
const DEFAULT_ALGORITHM: &str = "im-iwol";
/// Largest number of environment steps of a run, and of a period within one.
const MOST_STEPS: u64 = 1 << 50;

/// All settings that define a run. Each field declares a setting: its documentation (the unit in
/// brackets), default and range. Resolution, [`Config::schema`] and [`Config::reference`] follow
/// from the declarations.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Config {
    /// Name of the method.
    #[schemars(extend("enum" = algo::NAMES, "default" = DEFAULT_ALGORITHM))]
    pub algorithm: String,
    /// Number of vehicles at spawn places. All of them are agents, unless
    /// `scenario.traffic.penetration` is below 1. Where agents come from route files, the most
    /// agents on the road at a time. By default the scenario's.
    #[schemars(range(min = 1))]
    pub agents: u32,
    /// Seed of all random numbers.
    #[schemars(extend("default" = 0))]
    pub seed: u64,
    /// Largest number of environment steps (of one world each) to train for. Where vehicles steer,
    /// by default × 8/N below 8 agents.
    #[schemars(range(min = 1, max = MOST_STEPS), extend("default" = Self::STEPS))]
    pub steps: u64,
    /// Device on which the networks are computed: `cpu`, `cuda` or `cuda:<number>`.
    #[schemars(with = "String", extend("default" = "cpu", "pattern" = "^(cpu|cuda(:[0-9]+)?)$"))]
    pub device: algo::ComputeDevice,
    /// A run folder or checkpoint whose weights training starts from. It may be of any number of
    /// agents (CommFormer: of as many). Empty: training starts from new weights.
    #[schemars(extend("default" = ""))]
    pub init_from: PathBuf,
    /// Name of an environment that needs no SUMO, instead of a scenario: a built-in one, or one that
    /// an application registers.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    #[schemars(extend("enum" = NamedEnvironment::BUILT_IN, "default" = ""))]
    pub environment: String,
    /// The scenario's file, or a table with the file and values that replace those in the file.
    pub scenario: ScenarioSettings,
    /// The training loop.
    pub train: Train,
    /// The simulator.
    pub simulation: Simulation,
    /// The settings of the learner.
    #[serde(flatten)]
    pub learner: algo::Settings,
    /// The channel between agents, in training and in evaluation.
    pub channel: algo::Channel,
}

/// Settings of the training loop. The defaults of lengths and counts are for 8
/// agents; N stands for the number of agents, between 4 and 48.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema, SmartDefault)]
#[serde(deny_unknown_fields)]
#[schemars(default)]
pub struct Train {
    /// Number E of worlds that are simulated in lock-step; by default 256/N below 8 agents (128/N
    /// where vehicles steer), and 256/N, but at least 8, above 16.
    #[default = 16]
    #[schemars(range(min = 1, max = 1024))]
    pub envs: usize,
    /// Number T of steps per rollout and world. A rollout has at most 2^24 samples: `rollout_steps`
    /// × `envs` × `agents`.
    #[default = 128]
    #[schemars(range(min = 1, max = 100_000))]
    pub rollout_steps: usize,
    /// Least number of agents in an episode. Each episode of training and validation has a random
    /// number of agents, from this one to `agents`, on the same net, so that the policy learns to
    /// drive among any number. 0: always all agents.
    pub fewest_agents: u32,
    /// Probability that a world repeats a failed training episode instead of playing the next one.
    /// A world remembers the last 16 episodes that failed when last played, so that rare failures
    /// are trained on more often. 0: never.
    #[default = 0.5]
    #[schemars(range(min = 0, max = 1))]
    pub repeat_failed: f64,
    /// Whether the next rollout is played while the last one is learned from, so that neither the
    /// simulation nor the learner waits for the other. The policy that plays is then one update
    /// old; the stored probabilities of its actions correct for that. For one process only.
    pub overlap: bool,
    /// Whether the value of the last observation stands for the rewards after the horizon, as if
    /// episodes went on. Otherwise the horizon is a deadline: an agent that has not arrived by then
    /// earns nothing more. True by default with agents from route files, whose flow goes on.
    pub bootstrap_horizon: bool,
    /// Environment steps between validations; by default × 8/N, but at least a quarter. A
    /// checkpoint follows each validation.
    #[default = 16_384]
    #[schemars(range(min = 1, max = MOST_STEPS))]
    pub validate_every: u64,
    /// Episodes per validation, with deterministic actions; training never plays them, and each
    /// validation has others. By default × 8/N, but at least a quarter.
    #[default = 64]
    #[schemars(range(min = 1, max = 100_000))]
    pub validation_episodes: u64,
    /// Share of agents that must succeed in each of the last four validations for training to stop,
    /// once annealing is over. 0: training never stops early.
    #[default = 0.995]
    #[schemars(range(min = 0, max = 1))]
    pub stop_success: f64,
    /// Share of agents that must succeed in validations for annealing (of noise, then of the
    /// learning rate) to proceed before `exploration.explore_steps` are over. After them, annealing
    /// proceeds in any case. If the run is not good enough to stop once annealing is over, it goes on
    /// with as little noise, and the learning rate falls anew. 0: annealing takes place at the end
    /// of the run only. Success in training episodes would be misleading, because agents may succeed
    /// only thanks to their noise.
    #[default = 0.95]
    #[schemars(range(min = 0, max = 1))]
    pub anneal_success: f64,
    /// Environment steps that annealing takes, at most half of the run's. With N agents the default is
    /// this value × 8/N, but at least half of this value.
    #[default = 180_000]
    #[schemars(range(min = 1, max = MOST_STEPS))]
    pub anneal_steps: u64,
}

/// Settings of the simulator. They affect neither what is learned nor any metric
/// but SUMO's own collision counts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema, SmartDefault)]
#[serde(deny_unknown_fields)]
#[schemars(default)]
pub struct Simulation {
    /// Interface to SUMO.
    pub backend: Choice,
    /// Number of SUMO processes over which the worlds are spread; 0: as many as there are cores.
    #[schemars(range(max = 1024))]
    pub processes: usize,
    /// Time without an answer after which SUMO counts as dead \[s\]. SUMO may take 10 s or more to
    /// start.
    #[default(Hosting::default().timeout.as_secs_f64())]
    #[schemars(range(min = 0.1, max = 86_400))]
    pub timeout: f64,
    /// Whether SUMO also looks for collisions in junctions, to be compared with this program's own.
    /// With many vehicles, this is most of SUMO's work.
    #[default = true]
    pub audit: bool,
}

/// Removes the settings that `algorithm` does not read from a configuration: those of other
/// methods.
pub fn remove_untold(table: &mut Table, algorithm: &str) {
    let told = algo::capabilities(algorithm).map_or(&[][..], |method| method.settings);
    for group in algo::Settings::OWN.iter().filter(|group| !told.contains(group)) {
        table.remove(*group);
    }
    let unread = algo::capabilities(algorithm).map_or(&[][..], |method| method.unread);
    for (group, key) in unread.iter().filter_map(|name| name.split_once('.')) {
        if let Some(group) = table.get_mut(group).and_then(toml::Value::as_table_mut) {
            group.remove(key);
        }
    }
}

impl Config {
    /// Default of [`Config::steps`]: a limit. Without steering, most runs stop long before it.
    const STEPS: u64 = 1_200_000;

    /// Returns the declared defaults, with the values of where agents act.
    fn declared(setting: Setting<'_>) -> Self {
        let (file, environment) = match setting {
            Setting::Scenario(file) => (Some(file), ""),
            Setting::Environment { name, .. } => (None, name),
        };
        Self {
            algorithm: DEFAULT_ALGORITHM.to_owned(),
            agents: setting.agents(),
            environment: environment.to_owned(),
            seed: 0,
            steps: Self::STEPS,
            device: algo::ComputeDevice::Cpu,
            init_from: PathBuf::new(),
            scenario: file.map_or_else(ScenarioSettings::none, ScenarioSettings::of),
            train: Train::default(),
            simulation: Simulation::default(),
            learner: algo::Settings::default(),
            channel: algo::Channel::default(),
        }
    }

    /// Returns how and where the worlds are simulated.
    pub fn hosting(&self) -> Hosting {
        let Simulation { backend, processes, timeout, audit } = self.simulation;
        Hosting {
            backend: backend.backend(),
            processes,
            timeout: Duration::from_secs_f64(timeout),
            audit,
        }
    }

    /// Returns the configuration as TOML.
    pub fn to_toml(&self) -> String {
        toml::to_string_pretty(self).expect("a configuration is plain data")
    }
}
