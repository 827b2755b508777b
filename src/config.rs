//! Settings of a run: defaults < preset < `--config file.toml` < `--set key=value` < flags, checked
//! key by key.
//!
//! A setting is declared once, as a field of the struct of its group: documentation, default and
//! range. The scenario's own numbers are the table `[env]`, so that the resolved configuration is
//! complete. It is stored with the run and is itself a valid `--config`. Every error names the
//! file, line and column, and the nearest valid key.

mod defaults;
mod document;
mod error;
mod flat;
mod layers;
mod presets;
mod rules;
mod schema;
#[cfg(test)]
mod tests;
mod uses;
mod values;

pub use document::Document;
pub use error::Error;
pub(crate) use flat::between;
pub use flat::{Change, changes, flatten, plain};
pub use layers::{Layers, Resolution};
pub use presets::{PRESETS, Preset};
pub use uses::no_matter_of_evaluation;
pub use values::{Origin, Origins};

use std::path::PathBuf;
use std::time::Duration;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use smart_default::SmartDefault;
use toml::Table;

use crate::algo::{self, settings};
use crate::scenario::{Intention, Lidar, NeighbourOrder, ObservationGroups, Scenario};
use crate::sumo::{Choice, Hosting};

/// The method that is trained unless another one is set.
const DEFAULT_ALGORITHM: &str = "im-iwol";
/// Largest number of environment steps of a run, and of a period within one.
const MOST_STEPS: u64 = 1 << 50;

/// All settings that define a run. Each field declares a setting: its documentation (the unit in
/// brackets), default and range. Resolution, [`Config::schema`] and [`Config::reference`] follow
/// from the declarations.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// File of the scenario.
    pub scenario: PathBuf,
    /// Name of the method.
    #[schemars(extend("enum" = algo::NAMES, "default" = DEFAULT_ALGORITHM))]
    pub algorithm: String,
    /// Number of vehicles at spawn places. All of them are agents, unless `env.penetration` is
    /// below 1. By default the scenario's.
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
    /// The training loop.
    pub train: Train,
    /// The simulator.
    pub simulation: Simulation,
    /// The networks.
    pub network: settings::Network,
    /// Proximal policy optimisation.
    pub ppo: settings::Ppo,
    /// Exploration noise.
    pub exploration: settings::Exploration,
    /// Settings of IWoL.
    pub iwol: settings::Iwol,
    /// The transformer of MAT and CommFormer.
    pub transformer: settings::TransformerSettings,
    /// Settings of MAGIC.
    pub magic: settings::MagicSettings,
    /// Settings of CommFormer.
    pub commformer: settings::CommFormerSettings,
    /// Settings of ICP.
    pub icp: settings::IcpSettings,
    /// Settings of MADDPG.
    pub maddpg: settings::MaddpgSettings,
    /// The radio between agents; only for evaluation.
    pub channel: algo::Channel,
    /// The numbers of the scenario.
    pub env: Env,
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
    /// × `batch_growth` × `envs` × `agents`.
    #[default = 128]
    #[schemars(range(min = 1, max = 100_000))]
    pub rollout_steps: usize,
    /// Factor on the steps of a rollout and on the samples of a minibatch once the noise has fallen
    /// to `exploration.log_std_explore` (after `exploration.explore_steps`). Small batches are
    /// themselves noisy and can make the performance of a nearly successful policy collapse. 1: no
    /// change, as always with MADDPG.
    #[default = 1]
    #[schemars(range(min = 1, max = 64))]
    pub batch_growth: usize,
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
    /// Whether the value of the last observation stands for the rewards after the horizon, as if
    /// episodes went on. Otherwise the horizon is a deadline: an agent that has not arrived by then
    /// earns nothing more.
    pub bootstrap_horizon: bool,
    /// Environment steps between validations; by default × 8/N, but at least a quarter. A
    /// checkpoint follows each validation.
    #[default = 16_384]
    #[schemars(range(min = 1, max = MOST_STEPS))]
    pub validate_every: u64,
    /// Episodes per validation, with deterministic actions, on seeds other than those of training;
    /// by default × 8/N, but at least a quarter. With 4 vehicles on 8 places, the default of 128
    /// misses about 11 of the 70 ways to begin; 400 miss hardly any.
    #[default = 64]
    #[schemars(range(min = 1, max = 100_000))]
    pub validation_episodes: u64,
    /// Share of agents that must succeed in each of the last `train.stop_validations` validations
    /// for training to stop, once annealing is over. 0: training never stops early.
    #[default = 0.995]
    #[schemars(range(min = 0, max = 1))]
    pub stop_success: f64,
    /// Number of validations that decide whether to stop (`train.stop_success`).
    #[default = 4]
    #[schemars(range(min = 1, max = 1000))]
    pub stop_validations: u32,
    /// Share of agents that must succeed in validations for annealing (of noise, then of the
    /// learning rate) to proceed. Below it, annealing waits, unless the run would end before
    /// annealing is over; 0: annealing takes place only then. If the run is not good enough to stop
    /// once annealing is over, it goes on with as little noise, and explores again if success falls
    /// below this share. Success in training episodes would be misleading, because agents may
    /// succeed only thanks to their noise.
    #[default = 0.95]
    #[schemars(range(min = 0, max = 1))]
    pub anneal_success: f64,
    /// Environment steps that annealing takes, at most half of the run; by default × 8/N, but at
    /// least half.
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

/// Numbers of the scenario that a run may change. Their defaults are the
/// scenario's own values.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Env {
    /// How other vehicles are observed.
    pub observation: ObservationGroups,
    /// Distance beyond which other vehicles are not observed \[m\]. The paper's released code sees
    /// vehicles up to about 12.4 m away.
    #[schemars(range(min = 0))]
    pub detection_range: f64,
    /// Number of nearest vehicles in the observation.
    #[schemars(range(max = 16))]
    pub neighbours: usize,
    /// Order of the nearest vehicles.
    pub neighbour_order: NeighbourOrder,
    /// What is observed of the part of another vehicle's route that it has not begun.
    pub intention: Intention,
    /// Distance to a junction from which a vehicle's indicator is on, where intentions are
    /// signalled \[m\].
    #[schemars(range(min = 1, max = 200))]
    pub signal_distance: f64,
    /// Number of crossing or merging streams in the observation.
    #[schemars(range(max = 16))]
    pub conflict_streams: usize,
    /// Number of vehicles per stream in the observation.
    #[schemars(range(max = 16))]
    pub stream_vehicles: usize,
    /// Number of vehicles on crossing or merging routes that are observed one by one (encounters).
    #[schemars(range(max = 16))]
    pub encounters: usize,
    /// Time ahead for which an encounter contains how closely and how soon the two vehicles will
    /// pass, if both keep to their routes and speeds \[s\]; 0: not observed.
    #[schemars(range(min = 0, max = 10))]
    pub foresight: f64,
    /// Distance to the first conflict of its route at which a vehicle gets its priority, first
    /// come, first served \[m\]; encounters contain the priorities, and agents observe how far they
    /// can drive before they must wait. 0: not observed.
    #[schemars(range(min = 0, max = 100))]
    pub priority_distance: f64,
    /// Distance up to which an agent observes how close its sides are to the lines of the road that
    /// it must not touch, beside its body and 4 m ahead \[m\]; 0: not observed. Kerbs are not lines.
    #[schemars(range(min = 0, max = 20))]
    pub borders: f64,
    /// Number of beams of the lidar, which vehicles and lines reflect.
    #[schemars(range(max = Lidar::MOST as u64))]
    pub lidar_beams: usize,
    /// Range of the beams \[m\].
    #[schemars(range(min = 1, max = 200))]
    pub lidar_range: f64,
    /// Range d_comm of the radio, which gives the physical mask \[m\]. It does not decide who shares
    /// rewards.
    #[schemars(range(min = 0))]
    pub communication_range: f64,
    /// Weight in training of each other agent's advantage, beside the agent's own with weight 1.
    /// 0: agents are selfish, as in the paper's scripts and by default with methods that learn from
    /// the team's return (`icp-sum`, `icp-monotonic`).
    #[schemars(range(min = 0, max = 1))]
    pub cooperation: f64,
    /// Distance up to which agents share in each other's advantages \[m\]; `inf`: all agents of a
    /// world share.
    #[schemars(range(min = 0), extend("infinite" = true))]
    pub share_range: f64,
    /// Mean throttle of an untrained policy. Above 0, vehicles move at once; at 0 they hardly move
    /// under noise where brakes are stronger than the engine.
    #[schemars(range(min = -1, max = 1))]
    pub initial_throttle: f64,
    /// Reward per metre along the route.
    pub reward_progress: f64,
    /// Reward per step at 80 km/h, in proportion to the speed.
    pub reward_speed: f64,
    /// Reward for arriving.
    pub reward_arrive: f64,
    /// Reward for going off-road.
    pub reward_out_of_road: f64,
    /// Reward for a crash.
    pub reward_crash: f64,
    /// Number of steps after which an episode is truncated.
    #[schemars(range(min = 1, max = 1_000_000))]
    pub horizon: u32,
    /// Time for which a crashed vehicle stays as an obstacle \[s\].
    #[schemars(range(min = 0, max = 3600))]
    pub wreck_time: f64,
    /// Share of the vehicles at spawn places that learn; the others are background traffic.
    #[schemars(range(max = 1), extend("exclusiveMinimum" = 0))]
    pub penetration: f64,
}

impl Env {
    fn of(scenario: &Scenario) -> Self {
        let (seen, reward) = (&scenario.observation, &scenario.reward);
        Self {
            observation: seen.groups,
            detection_range: seen.detection_range,
            neighbours: seen.neighbours,
            neighbour_order: seen.neighbour_order,
            intention: seen.intention,
            signal_distance: seen.signal_distance,
            conflict_streams: seen.conflict_streams,
            stream_vehicles: seen.stream_vehicles,
            encounters: seen.encounters,
            foresight: seen.foresight,
            priority_distance: seen.priority_distance,
            borders: seen.borders,
            lidar_beams: seen.lidar.beams,
            lidar_range: seen.lidar.range,
            communication_range: scenario.communication.range,
            cooperation: reward.cooperation,
            share_range: reward.share_range,
            initial_throttle: scenario.control.initial_throttle,
            reward_progress: reward.progress,
            reward_speed: reward.speed,
            reward_arrive: reward.arrive,
            reward_out_of_road: reward.out_of_road,
            reward_crash: reward.crash,
            horizon: scenario.termination.horizon,
            wreck_time: scenario.termination.wreck_time,
            penetration: scenario.traffic.penetration,
        }
    }

    fn apply(&self, scenario: &mut Scenario) {
        let (seen, reward) = (&mut scenario.observation, &mut scenario.reward);
        seen.groups = self.observation;
        seen.detection_range = self.detection_range;
        seen.neighbours = self.neighbours;
        seen.neighbour_order = self.neighbour_order;
        seen.intention = self.intention;
        seen.signal_distance = self.signal_distance;
        seen.conflict_streams = self.conflict_streams;
        seen.stream_vehicles = self.stream_vehicles;
        seen.encounters = self.encounters;
        seen.foresight = self.foresight;
        seen.priority_distance = self.priority_distance;
        seen.borders = self.borders;
        seen.lidar = Lidar { beams: self.lidar_beams, range: self.lidar_range };
        scenario.communication.range = self.communication_range;
        reward.cooperation = self.cooperation;
        reward.share_range = self.share_range;
        scenario.control.initial_throttle = self.initial_throttle;
        reward.progress = self.reward_progress;
        reward.speed = self.reward_speed;
        reward.arrive = self.reward_arrive;
        reward.out_of_road = self.reward_out_of_road;
        reward.crash = self.reward_crash;
        scenario.termination.horizon = self.horizon;
        scenario.termination.wreck_time = self.wreck_time;
        scenario.traffic.penetration = self.penetration;
    }
}

/// Removes the settings that `algorithm` does not read from a configuration: those of other
/// methods.
pub fn remove_untold(table: &mut Table, algorithm: &str) {
    let told = algo::capabilities(algorithm).map_or(&[][..], |method| method.settings);
    for group in algo::Settings::OWN.iter().filter(|group| !told.contains(group)) {
        table.remove(*group);
    }
}

impl Config {
    /// Default of [`Config::steps`]: a limit. Without steering, most runs stop long before it.
    const STEPS: u64 = 1_200_000;

    /// Returns the declared defaults, with the scenario's own numbers.
    fn declared(scenario: &Scenario) -> Self {
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
        Self {
            scenario: scenario.path.clone(),
            algorithm: DEFAULT_ALGORITHM.to_owned(),
            agents: scenario.agents.default,
            seed: 0,
            steps: Self::STEPS,
            device: algo::ComputeDevice::Cpu,
            init_from: PathBuf::new(),
            train: Train::default(),
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
            env: Env::of(scenario),
        }
    }

    /// Returns the learner's settings.
    pub fn settings(&self) -> algo::Settings {
        algo::Settings {
            network: self.network.clone(),
            ppo: self.ppo.clone(),
            exploration: self.exploration.clone(),
            iwol: self.iwol.clone(),
            transformer: self.transformer.clone(),
            magic: self.magic.clone(),
            commformer: self.commformer.clone(),
            icp: self.icp.clone(),
            maddpg: self.maddpg.clone(),
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
