//! Settings of a run: defaults < `--config file.toml` < `--set key=value` < flags, checked key by
//! key.
//!
//! The scenario's own numbers are the table `[env]`, so that the resolved configuration is
//! complete. It is stored with the run and is itself a valid `--config`. Every error names the
//! file, line and column, and the nearest valid key.

mod defaults;
mod flat;
mod layers;
mod rules;
mod uses;

pub(crate) use flat::between;
pub use flat::{Change, changes, flatten, plain};
pub use layers::{Document, Error, Layers};
pub use uses::no_matter_of_evaluation;

use std::path::PathBuf;
use std::time::Duration;

use serde::{Deserialize, Serialize};
use toml::Table;

use crate::algo::{self, settings};
use crate::scenario::{Intention, Lidar, NeighbourOrder, ObservationGroups, Scenario};
use crate::sumo::{Choice, Hosting};

/// The method that is trained unless another one is set.
const DEFAULT_ALGORITHM: &str = "im-iwol";

/// All settings that define a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// File of the scenario.
    pub scenario: PathBuf,
    /// Name of the method.
    pub algorithm: String,
    /// Number of vehicles at spawn places. All of them are agents, unless [`Env::penetration`] is
    /// below 1.
    pub agents: u32,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Largest number of environment steps (of one world each) to train for.
    pub steps: u64,
    /// Device on which the networks are computed: `cpu`, `cuda` or `cuda:<number>`.
    pub device: algo::ComputeDevice,
    /// A run folder or checkpoint whose weights training starts from. It may be of any number of
    /// agents (CommFormer: of as many). Empty: training starts from new weights.
    pub init_from: PathBuf,
    /// The training loop.
    pub train: Train,
    /// The simulator. It affects neither what is learned nor any metric but SUMO's own collision
    /// counts.
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
    pub transformer: settings::Transformer,
    /// Settings of MAGIC.
    pub magic: settings::Magic,
    /// Settings of CommFormer.
    pub commformer: settings::CommFormer,
    /// Settings of ICP.
    pub icp: settings::Icp,
    /// Settings of MADDPG.
    pub maddpg: settings::Maddpg,
    /// The radio between agents; only for evaluation.
    pub channel: algo::Channel,
    /// The numbers of the scenario.
    pub env: Env,
}

/// Settings of the training loop. The defaults of lengths and counts are for 8 agents; those for
/// another number of agents follow from them ([`Config::resolve`]).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Train {
    /// Number E of worlds that are simulated in lock-step.
    pub envs: usize,
    /// Number T of steps per rollout and world.
    pub rollout_steps: usize,
    /// Factor on the steps of a rollout and on the samples of a minibatch once the noise has fallen
    /// to `log_std_explore` (after [`Exploration::explore_steps`](settings::Exploration)). Small
    /// batches are themselves noisy and can make the performance of a nearly successful policy
    /// collapse. 1: no change.
    pub batch_growth: usize,
    /// Least number of agents in an episode. Each episode of training and validation has a random
    /// number of agents, from this one to `agents`, on the same net, so that the policy learns to
    /// drive among any number. 0: always all agents.
    pub fewest_agents: u32,
    /// Probability that a world repeats a failed training episode instead of playing the next one.
    /// A world remembers the last 16 episodes that failed when last played, so that rare failures
    /// are trained on more often. 0: never.
    pub repeat_failed: f64,
    /// Whether the value of the last observation stands for the rewards after the horizon, as if
    /// episodes went on. Otherwise the horizon is a deadline: an agent that has not arrived by then
    /// earns nothing more.
    pub bootstrap_horizon: bool,
    /// Environment steps between validations. A checkpoint follows each validation.
    pub validate_every: u64,
    /// Episodes per validation, with deterministic actions, on seeds other than those of training.
    pub validation_episodes: u64,
    /// Share of agents that must succeed in each of the last [`Train::stop_validations`]
    /// validations for training to stop, once annealing is over. 0: training never stops early.
    pub stop_success: f64,
    /// Number of validations that decide whether to stop ([`Train::stop_success`]).
    pub stop_validations: u32,
    /// Share of agents that must succeed in validations for annealing (of noise, then of the
    /// learning rate) to proceed. Below it, annealing waits, unless the run would end before
    /// annealing is over; 0: annealing takes place only then. If the run is not good enough to stop
    /// once annealing is over, it goes on with as little noise, and explores again if success falls
    /// below this share. Success in training episodes would be misleading, because agents may
    /// succeed only thanks to their noise.
    pub anneal_success: f64,
    /// Environment steps that annealing takes, at most half of the run.
    pub anneal_steps: u64,
}

impl Default for Train {
    fn default() -> Self {
        Self {
            envs: 16,
            rollout_steps: 128,
            batch_growth: 1,
            fewest_agents: 0,
            repeat_failed: 0.5,
            bootstrap_horizon: false,
            validate_every: 16_384,
            validation_episodes: 64,
            stop_success: 0.995,
            stop_validations: 4,
            anneal_success: 0.95,
            anneal_steps: 180_000,
        }
    }
}

/// Settings of the simulator.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Simulation {
    /// `traci`: SUMO processes; `libsumo`: SUMO inside this process; `auto`: the faster of the two.
    pub backend: Choice,
    /// Number of SUMO processes over which the worlds are spread; 0: as many as there are cores.
    pub processes: usize,
    /// Time without an answer after which SUMO counts as dead \[s\].
    pub timeout: f64,
    /// Whether SUMO also looks for collisions in junctions, to be compared with this program's own.
    /// With many vehicles, this is most of SUMO's work.
    pub audit: bool,
}

impl Default for Simulation {
    fn default() -> Self {
        let Hosting { processes, timeout, audit, .. } = Hosting::default();
        Self { backend: Choice::default(), processes, timeout: timeout.as_secs_f64(), audit }
    }
}

/// The scenario's numbers that a run may change. Their defaults are the scenario's own values.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Env {
    /// How other vehicles are observed: `nearest`, `conflict` or `both`.
    pub observation: ObservationGroups,
    /// Distance beyond which other vehicles are not observed \[m\].
    pub detection_range: f64,
    /// Number of nearest vehicles in the observation.
    pub neighbours: usize,
    /// Order of the nearest vehicles. `distance`: nearest first. `bearing`: from those straight
    /// ahead to those behind, in the same direction nearest first, and with positions on a second,
    /// finer scale.
    pub neighbour_order: NeighbourOrder,
    /// What is observed of the part of another vehicle's route that it has not begun: `seen`,
    /// `signalled` or `hidden`.
    pub intention: Intention,
    /// Distance to a junction from which a vehicle's indicator is on, where intentions are
    /// signalled \[m\].
    pub signal_distance: f64,
    /// Number of crossing or merging streams in the observation.
    pub conflict_streams: usize,
    /// Number of vehicles per stream in the observation.
    pub stream_vehicles: usize,
    /// Number of vehicles on crossing or merging routes that are observed one by one (encounters).
    pub encounters: usize,
    /// Time ahead for which an encounter contains how closely and how soon the two vehicles will
    /// pass, if both keep to their routes and speeds \[s\]; 0: not observed.
    pub foresight: f64,
    /// Distance to the first conflict of its route at which a vehicle gets its priority, first
    /// come, first served; encounters contain the priorities \[m\]. 0: not observed.
    pub priority_distance: f64,
    /// Distance up to which an agent observes how close its sides are to the lines of the road that
    /// it must not touch \[m\]; 0: not observed.
    pub borders: f64,
    /// Number of beams of the lidar.
    pub lidar_beams: usize,
    /// Range of the beams \[m\].
    pub lidar_range: f64,
    /// Range d_comm of the radio, which gives the physical mask \[m\].
    pub communication_range: f64,
    /// Weight in training of each other agent's advantage, beside the agent's own with weight 1.
    pub cooperation: f64,
    /// Distance up to which agents share in each other's advantages \[m\]; `inf`: all agents of a
    /// world share.
    pub share_range: f64,
    /// Mean throttle of an untrained policy, -1 to 1.
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
    pub horizon: u32,
    /// Time for which a crashed vehicle stays as an obstacle \[s\].
    pub wreck_time: f64,
    /// Share of the vehicles at spawn places that learn; the others are background traffic.
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
