//! The scenario's numbers that a run may change, as settings.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::scenario::{Intention, Lidar, NeighbourOrder, ObservationGroups, Scenario};

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

/// Says which number of the scenario each setting is.
macro_rules! numbers_of_the_scenario {
    ($($setting:ident: $($field:ident).+,)+) => {
        impl Env {
            /// Returns the scenario's own numbers.
            pub(super) fn of(scenario: &Scenario) -> Self {
                Self { $($setting: scenario.$($field).+,)+ }
            }

            /// Sets the scenario's numbers.
            pub(super) fn apply(&self, scenario: &mut Scenario) {
                $(scenario.$($field).+ = self.$setting;)+
            }
        }
    };
}

numbers_of_the_scenario! {
    observation: observation.groups,
    detection_range: observation.detection_range,
    neighbours: observation.neighbours,
    neighbour_order: observation.neighbour_order,
    intention: observation.intention,
    signal_distance: observation.signal_distance,
    conflict_streams: observation.conflict_streams,
    stream_vehicles: observation.stream_vehicles,
    encounters: observation.encounters,
    foresight: observation.foresight,
    priority_distance: observation.priority_distance,
    borders: observation.borders,
    lidar_beams: observation.lidar.beams,
    lidar_range: observation.lidar.range,
    communication_range: communication.range,
    cooperation: reward.cooperation,
    share_range: reward.share_range,
    initial_throttle: control.initial_throttle,
    reward_progress: reward.progress,
    reward_speed: reward.speed,
    reward_arrive: reward.arrive,
    reward_out_of_road: reward.out_of_road,
    reward_crash: reward.crash,
    horizon: termination.horizon,
    wreck_time: termination.wreck_time,
    penetration: traffic.penetration,
}
