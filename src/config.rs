//! Settings of a run: defaults < `--config file.toml` < `--set key=value` < flags, checked key by key.
//!
//! The scenario's own numbers appear as the table `[env]`, so that the resolved configuration is complete, is stored with
//! the run, and is itself a valid `--config`. Every mistake names the file, line and column, and the nearest valid key.

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

/// What is trained when nothing names a method.
const DEFAULT_ALGORITHM: &str = "im-iwol";

/// Everything that defines a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// The scenario's file.
    pub scenario: PathBuf,
    /// Name of the algorithm.
    pub algorithm: String,
    /// Number of vehicles at spawn places; all are agents unless [`Env::penetration`] says otherwise.
    pub agents: u32,
    /// Seed of everything random.
    pub seed: u64,
    /// Environment steps (of one world each) to train for, at most.
    pub steps: u64,
    /// Where the networks are computed: `cpu`, `cuda` or `cuda:<number>`.
    pub device: algo::ComputeDevice,
    /// A run folder or checkpoint, of any number of agents, whose weights training starts from; empty: from new ones.
    pub init_from: PathBuf,
    /// The training loop.
    pub train: Train,
    /// Where the worlds run; what is learned does not depend on it, nor any metric but SUMO's own collision counts.
    pub simulation: Simulation,
    /// Networks.
    pub network: settings::Network,
    /// Proximal policy optimisation.
    pub ppo: settings::Ppo,
    /// Exploration noise.
    pub exploration: settings::Exploration,
    /// IWoL.
    pub iwol: settings::Iwol,
    /// The transformer of MAT and CommFormer.
    pub transformer: settings::Transformer,
    /// MAGIC.
    pub magic: settings::Magic,
    /// CommFormer.
    pub commformer: settings::CommFormer,
    /// ICP.
    pub icp: settings::Icp,
    /// MADDPG.
    pub maddpg: settings::Maddpg,
    /// The radio between agents, in evaluation.
    pub channel: algo::Channel,
    /// The scenario's numbers.
    pub env: Env,
}

/// The training loop. Lengths and counts are for 8 agents; those of another number follow from them where they are not given
/// ([`Config::resolve`]).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Train {
    /// Worlds E simulated in lock-step.
    pub envs: usize,
    /// Steps T per rollout.
    pub segment: usize,
    /// Once noise has fallen to what is kept until validations succeed ([`Exploration::explore_steps`](settings::Exploration)),
    /// rollouts have so many times the steps, and minibatches so many times the samples: a policy that has found most of its way
    /// is lost again to the noise of small ones. 1: as before.
    pub growth: usize,
    /// Each episode of training and validation has a random number of agents, from this one to `agents`, on the same net, so
    /// that the policy drives among any number; 0: always all.
    pub fewest_agents: u32,
    /// Chance that a world plays an episode of training again that failed before, where it remembers one (the last 16 that failed
    /// when last played), instead of the next: what seldom goes wrong is seldom seen otherwise.
    pub replay_failed: f64,
    /// At first the policy imitates pure pursuit of the route ([`Train::imitate_speed`]) on its own episodes, and over so many
    /// environment steps does so ever less and learns from rewards ever more (kickstarting: Schmitt et al., 2018); 0: not at all.
    pub imitate_steps: u64,
    /// Speed of the pursuit that is imitated \[m/s\].
    pub imitate_speed: f64,
    /// Whether the value of the last observation stands for what would come after the horizon, as
    /// if episodes went on. Without it the horizon is a deadline: an agent that has not arrived by
    /// then earns nothing more.
    pub bootstrap_horizon: bool,
    /// Environment steps between validations; each is followed by a checkpoint.
    pub validate_every: u64,
    /// Episodes per validation, with deterministic actions on seeds of their own.
    pub validation_episodes: u64,
    /// Stop when annealing is over and this share of agents succeeded in each of the last [`Train::stop_validations`]
    /// validations; 0 never stops early.
    pub stop_success: f64,
    /// See [`Train::stop_success`].
    pub stop_validations: u32,
    /// Annealing (of noise, then of the learning rate) goes on while this share of agents succeeds in validations, waits while
    /// it does not, and goes on in any case when the run would otherwise end before it is over; 0: only then. Training episodes
    /// would tell too early: agents that only succeed thanks to their noise do not yet know how. A run that is not good
    /// enough to stop when annealing is over learns on with as little noise, and explores again if it falls below this.
    pub anneal_success: f64,
    /// Environment steps that annealing takes, at most half of the run.
    pub anneal_steps: u64,
}

impl Default for Train {
    fn default() -> Self {
        Self {
            envs: 16,
            segment: 128,
            growth: 1,
            fewest_agents: 0,
            replay_failed: 0.5,
            imitate_steps: 0,
            imitate_speed: 6.0,
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

/// Where the worlds run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Simulation {
    /// `traci`: SUMO processes; `libsumo`: SUMO inside this process; `auto`: the faster.
    pub backend: Choice,
    /// SUMO processes over which the worlds are spread; 0: as many as there are cores.
    pub processes: usize,
    /// A SUMO that takes longer for an answer counts as dead \[s\].
    pub timeout: f64,
    /// Whether SUMO looks for collisions in junctions, too, to be compared with ours; most of its time at many vehicles.
    pub audit: bool,
}

impl Default for Simulation {
    fn default() -> Self {
        let Hosting { processes, timeout, audit, .. } = Hosting::default();
        Self { backend: Choice::default(), processes, timeout: timeout.as_secs_f64(), audit }
    }
}

/// The scenario's numbers that a run may change. Defaults are the scenario's own.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Env {
    /// How others are seen: `nearest`, `conflict` or `both`.
    pub observation: ObservationGroups,
    /// Others further away are not seen \[m\].
    pub detection_range: f64,
    /// Nearest vehicles in the observation.
    pub neighbours: usize,
    /// In which order: `distance`, nearest first, or `bearing`, from those straight ahead to those behind, in the same direction nearest first
    /// and with positions on a second, finer scale.
    pub neighbour_order: NeighbourOrder,
    /// What is known of where others will go: `seen`, `signalled` or `hidden`.
    pub intention: Intention,
    /// How far before a junction a vehicle's indicator is on, where intentions are signalled \[m\].
    pub signal_distance: f64,
    /// Streams in the observation.
    pub conflict_streams: usize,
    /// Vehicles per stream in the observation.
    pub stream_vehicles: usize,
    /// Vehicles on crossing or merging routes in the observation.
    pub encounters: usize,
    /// How far ahead they tell how closely the two will pass if both keep to their ways and speeds \[s\]; 0: they do not.
    pub foresight: f64,
    /// How near to where its way first meets another's a vehicle is when it gets its turn, which they tell \[m\]; 0: they do not.
    pub turns: f64,
    /// Up to which distance agents are told how close their sides are to the lines of the road \[m\]; 0: they are not.
    pub borders: f64,
    /// Beams of the lidar.
    pub lidar_beams: usize,
    /// How far they reach \[m\].
    pub lidar_range: f64,
    /// Range d_comm of the physical mask \[m\].
    pub communication_range: f64,
    /// Weight in training of each other agent's advantage beside one's own, which has weight 1.
    pub cooperation: f64,
    /// How far apart agents share in each other's advantages \[m\]; `inf`: all agents of a world.
    pub share_range: f64,
    /// Mean throttle of an untrained policy.
    pub initial_throttle: f64,
    /// Reward per metre.
    pub reward_progress: f64,
    /// Reward per step at 80 km/h.
    pub reward_speed: f64,
    /// Reward of an arrival.
    pub reward_arrive: f64,
    /// Reward of leaving the road.
    pub reward_out_of_road: f64,
    /// Reward of a crash.
    pub reward_crash: f64,
    /// Steps until truncation.
    pub horizon: u32,
    /// A crashed vehicle stays this long \[s\].
    pub wreck_time: f64,
    /// Share of the vehicles at spawn places that learn; SUMO drives the others.
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
            turns: seen.turns,
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
        seen.turns = self.turns;
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

/// Takes out of a configuration what `algorithm` is not told of: the settings of other methods.
pub fn remove_untold(table: &mut Table, algorithm: &str) {
    let told = algo::capabilities(algorithm).map_or(&[][..], |method| method.settings);
    for group in algo::Settings::OWN.iter().filter(|group| !told.contains(group)) {
        table.remove(*group);
    }
}

impl Config {
    /// The learner's settings.
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

    /// Where the worlds run.
    pub fn hosting(&self) -> Hosting {
        let Simulation { backend, processes, timeout, audit } = self.simulation;
        Hosting {
            backend: backend.backend(),
            processes,
            timeout: Duration::from_secs_f64(timeout),
            audit,
        }
    }

    /// As TOML.
    pub fn to_toml(&self) -> String {
        toml::to_string_pretty(self).expect("a configuration is plain data")
    }
}
