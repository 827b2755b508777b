//! What a task is, as data: read from `scenarios/<name>.xml` (schema: `scenarios/scenario.xsd`).
//!
//! Units are SI. Positions on lanes are those of the vehicle's **centre** unless a field says otherwise.

mod advice;
pub mod author;
mod check;
mod demand;
mod error;
mod finding;
mod fingerprint;
mod load;
mod reader;
mod schema;
mod write;

pub use demand::{Demand, DemandRoute, Laid, Source, Spacing, Start, VehicleKind, Way};
pub use error::Error;
pub use finding::{Finding, Findings, Severity};
pub use schema::{Attribute, Element, SCHEMA, describe, markdown};

use std::path::PathBuf;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

/// One task.
#[derive(Debug, Clone, PartialEq)]
pub struct Scenario {
    /// Name; also the run folder's first level.
    pub name: String,
    /// Where it was read from.
    pub path: PathBuf,
    /// One sentence for people.
    pub description: String,
    /// How many agents it takes.
    pub agents: AgentRange,
    /// Nets by size, ascending by [`Net::capacity`].
    pub nets: Vec<Net>,
    /// Routes that agents follow.
    pub routes: Vec<Route>,
    /// The agents' vehicle.
    pub vehicle: Vehicle,
    /// How spawn places are disturbed.
    pub jitter: Jitter,
    /// How actions become motion.
    pub control: Control,
    /// What an agent sees.
    pub observation: Observation,
    /// Reward terms.
    pub reward: Reward,
    /// When an episode or an agent ends.
    pub termination: Termination,
    /// Who can hear whom.
    pub communication: Communication,
    /// Vehicles that SUMO drives, beside the agents.
    pub traffic: Traffic,
}

/// Number of agents that a scenario takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AgentRange {
    /// Fewest.
    pub min: u32,
    /// Most.
    pub max: u32,
    /// When the user does not say.
    pub default: u32,
}

/// A net and its spawn places.
#[derive(Debug, Clone, PartialEq)]
pub struct Net {
    /// The `.net.xml`, resolved against the scenario file's folder.
    pub file: PathBuf,
    /// Rows of spawn places.
    pub spawns: Vec<SpawnRow>,
}

/// Equally spaced spawn places at the start of routes.
#[derive(Debug, Clone, PartialEq)]
pub struct SpawnRow {
    /// Indices into [`Scenario::routes`], all of which begin on one lane. One of them is drawn in each episode.
    pub routes: Arc<[usize]>,
    /// Position of the first place on the route's first edge \[m\].
    pub first: f64,
    /// Distance between places \[m\].
    pub spacing: f64,
    /// Number of places.
    pub count: u32,
}

/// One spawn place.
#[derive(Debug, Clone, PartialEq)]
pub struct SpawnPlace {
    /// As in [`SpawnRow::routes`].
    pub routes: Arc<[usize]>,
    /// Position on the route's first edge \[m\].
    pub pos: f64,
}

/// A route through the net.
#[derive(Debug, Clone, PartialEq)]
pub struct Route {
    /// Name.
    pub id: String,
    /// Edge ids in driving order.
    pub edges: Vec<String>,
    /// Lane of the first edge, counted from the right and starting at 0; without it, the rightmost from which the route can be
    /// driven without changing lanes.
    pub lane: Option<u32>,
    /// Where the agent has arrived, on the last edge \[m\]; a negative value counts from its end.
    pub arrival_pos: f64,
    /// Its last edge is a destination for one vehicle: an episode draws no two reserved routes that end on the same edge.
    pub reserved: bool,
    /// Progress and speed count this many times while the vehicle is off the route's lanes.
    pub off_lane: f64,
}

/// The agents' vehicle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Vehicle {
    /// \[m\]
    pub length: f64,
    /// \[m\]
    pub width: f64,
    /// \[m/s\]
    pub max_speed: f64,
}

/// Uniform disturbance of spawn places, plus or minus.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Jitter {
    /// Along the lane \[m\].
    pub longitudinal: f64,
    /// Across the lane \[m\].
    pub lateral: f64,
}

/// How actions become motion.
#[derive(Debug, Clone, PartialEq)]
pub struct Control {
    /// Decision interval \[s\]; also SUMO's step length.
    pub interval: f64,
    /// Acceleration at full throttle \[m/s²\].
    pub accel: f64,
    /// Deceleration at zero throttle, and the least of a brake \[m/s²\].
    pub drag: f64,
    /// Braking curve: (action magnitude, deceleration \[m/s²\]), ascending; linear between, from the origin.
    pub brake: Vec<(f64, f64)>,
    /// How the vehicle steers, as a first action before throttle and brake. Without it, that is the only action, and SUMO keeps the
    /// vehicle on its route.
    pub steering: Option<Steering>,
    /// Mean throttle of an untrained policy, -1 to 1. At 0 vehicles hardly move under noise where
    /// brakes are stronger than the engine; the larger it is, the sooner all drive at full
    /// throttle.
    pub initial_throttle: f64,
}

impl Control {
    /// Mean throttle of an untrained policy where a scenario does not say.
    pub const INITIAL_THROTTLE: f64 = 0.5;
}

/// How a vehicle steers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Steering {
    /// Angle of the front wheels at full lock \[deg\].
    pub max_angle: f64,
    /// Distance of the front axle from the centre of mass, which is the middle of the vehicle
    /// \[m\].
    pub front_axle: f64,
    /// Distance of the rear axle from it \[m\].
    pub rear_axle: f64,
    /// Distance between the left and the right wheels \[m\].
    pub track: f64,
    /// Friction of the tyres: they hold so many times their load.
    pub friction: f64,
    /// Moment of inertia about the vertical axis, per mass \[m²\].
    pub yaw_inertia: f64,
    /// Whether a negative throttle drives backwards: then it is thrust, and only zero throttle
    /// brakes.
    pub reverse: bool,
}

impl Default for Steering {
    /// The vehicle of the paper's simulator (MetaDrive's default vehicle).
    fn default() -> Self {
        Self {
            max_angle: 40.0,
            front_axle: 1.05234,
            rear_axle: 1.4166,
            track: 1.63,
            friction: 0.9,
            yaw_inertia: 1.985,
            reverse: false,
        }
    }
}

impl Steering {
    /// Distance between the axles \[m\].
    pub fn wheelbase(&self) -> f64 {
        self.front_axle + self.rear_axle
    }
}

/// How an agent sees others.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ObservationGroups {
    /// The nearest vehicles, in any direction (paper).
    Nearest,
    /// The vehicle ahead, and those next to where routes cross or merge with the agent's own.
    Conflict,
    /// One after the other.
    Both,
}

impl ObservationGroups {
    /// As in XML and settings.
    pub const NAMES: [(&str, Self); 3] =
        [("nearest", Self::Nearest), ("conflict", Self::Conflict), ("both", Self::Both)];

    /// Whether the nearest vehicles are described.
    pub fn nearest(self) -> bool {
        self != Self::Conflict
    }

    /// Whether the vehicle ahead and crossing streams are described.
    pub fn conflict(self) -> bool {
        self != Self::Nearest
    }

    /// The name in XML and settings.
    pub fn name(self) -> &'static str {
        Self::NAMES.iter().find(|entry| entry.1 == self).map_or("", |entry| entry.0)
    }
}

/// In which order the nearest vehicles are described.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum NeighbourOrder {
    /// Nearest first (paper).
    #[default]
    Distance,
    /// From those straight ahead to those behind, so that a vehicle keeps its place as distances change; in the same direction, nearest
    /// first. Positions are told on a second scale, on which gaps in a queue differ.
    Bearing,
}

impl NeighbourOrder {
    /// As in XML and settings.
    pub const NAMES: [(&str, Self); 2] = [("distance", Self::Distance), ("bearing", Self::Bearing)];

    /// The name in XML and settings.
    pub fn name(self) -> &'static str {
        Self::NAMES.iter().find(|entry| entry.1 == self).map_or("", |entry| entry.0)
    }
}

/// What an agent knows of another vehicle's intention: the part of the route that the vehicle has
/// not yet begun.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Intention {
    /// The whole route.
    #[default]
    Seen,
    /// The direction at the next junction, from the vehicle's indicator: within
    /// [`Observation::signal_distance`] of the junction, within the detection range and with no
    /// other vehicle in between. Otherwise nothing.
    Signalled,
    /// Nothing: the vehicle may take every route that its position leaves open (paper).
    Hidden,
}

impl Intention {
    /// As in XML and settings.
    pub const NAMES: [(&str, Self); 3] =
        [("seen", Self::Seen), ("signalled", Self::Signalled), ("hidden", Self::Hidden)];

    /// The name in XML and settings.
    pub fn name(self) -> &'static str {
        Self::NAMES.iter().find(|entry| entry.1 == self).map_or("", |entry| entry.0)
    }
}

/// What an agent sees.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observation {
    /// How others are described.
    pub groups: ObservationGroups,
    /// Others further away than this are not seen \[m\].
    pub detection_range: f64,
    /// Nearest vehicles described one by one.
    pub neighbours: usize,
    /// In which order.
    pub neighbour_order: NeighbourOrder,
    /// What is known of where others will go.
    pub intention: Intention,
    /// How far before a junction a vehicle's indicator is on, where intentions are signalled;
    /// [`Observation::SIGNAL_DISTANCE`] where they are not \[m\].
    pub signal_distance: f64,
    /// Crossing or merging streams described, in the order in which the agent meets them.
    pub conflict_streams: usize,
    /// Vehicles described per stream, those next to the conflict point first.
    pub stream_vehicles: usize,
    /// Vehicles described one by one whose routes cross or merge with the agent's, or that are ahead of it, those first that will
    /// soonest be with it where they meet.
    pub encounters: usize,
    /// How far ahead encounters tell how closely the two will pass if both keep to their ways and speeds \[s\]; 0: they do not.
    pub foresight: f64,
    /// How near to where its way first meets another's a vehicle is when it gets its turn, which encounters tell \[m\]; 0: they do not.
    pub turns: f64,
    /// Distance up to which an agent is told how close its sides are to the lines that it must not touch \[m\]; 0: it is not.
    pub borders: f64,
    /// Distances to whatever is around.
    pub lidar: Lidar,
}

impl Observation {
    /// How far before a junction an indicator is on where the scenario does not say \[m\].
    pub const SIGNAL_DISTANCE: f64 = 30.0;
}

/// Beams in all directions, which end at vehicles and where the road ends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lidar {
    /// How many; 0: none.
    pub beams: usize,
    /// How far \[m\].
    pub range: f64,
}

impl Lidar {
    /// Most beams.
    pub const MOST: usize = 360;
}

impl Default for Lidar {
    fn default() -> Self {
        Self { beams: 0, range: 50.0 }
    }
}

/// Reward terms and their weights.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reward {
    /// Per metre along the route.
    pub progress: f64,
    /// Per step at [`Reward::SPEED_UNIT`], in proportion to speed.
    pub speed: f64,
    /// Replaces the step's reward on arrival.
    pub arrive: f64,
    /// Replaces the step's reward when leaving the road.
    pub out_of_road: f64,
    /// Replaces the step's reward in a crash.
    pub crash: f64,
    /// Weight in training of each other agent's advantage beside one's own, which has weight 1; 0
    /// to 1.
    pub cooperation: f64,
    /// How far apart agents share in each other's advantages \[m\]; infinite: all agents of a
    /// world.
    pub share_range: f64,
}

impl Reward {
    /// 80 km/h, the speed that the speed term counts as one \[m/s\].
    pub const SPEED_UNIT: f64 = 80.0 / 3.6;
}

/// When an episode or an agent ends.
#[derive(Debug, Clone, PartialEq)]
pub struct Termination {
    /// Truncation after this many steps.
    pub horizon: u32,
    /// A crashed vehicle stays as an obstacle for this time \[s\].
    pub wreck_time: f64,
    /// What ends the road for a vehicle that steers.
    pub border: Border,
    /// Edges beside whose lanes no line parts the two directions that would end the road: a broken
    /// one, which vehicles may cross.
    pub broken_lines: Vec<String>,
}

/// What ends the road for a vehicle that steers. Whoever's centre is on no lane has left it, too.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Border {
    /// The lines at both sides of a road.
    Line,
    /// The line between two directions, and the kerb, a little beyond the outermost lanes: no line keeps lanes of one direction, or
    /// places to park, apart.
    Kerb,
}

impl Border {
    /// As in XML.
    pub const NAMES: [(&str, Self); 2] = [("line", Self::Line), ("kerb", Self::Kerb)];

    /// The name in XML.
    pub fn name(self) -> &'static str {
        Self::NAMES.iter().find(|entry| entry.1 == self).map_or("", |entry| entry.0)
    }
}

/// Vehicles that SUMO drives, beside the agents.
#[derive(Debug, Clone, PartialEq)]
pub struct Traffic {
    /// Share of the vehicles at spawn places that learn, above 0 to 1; SUMO drives the others.
    pub penetration: f64,
    /// Type of those others, an id of the files; without it they are of the agents' size and abilities.
    pub kind: Option<String>,
    /// SUMO route files, resolved against the scenario file's folder.
    pub files: Vec<PathBuf>,
    /// Most vehicles of the files on the road at a time.
    pub capacity: u32,
}

impl Default for Traffic {
    fn default() -> Self {
        Self { penetration: 1.0, kind: None, files: Vec::new(), capacity: 16 }
    }
}

impl Traffic {
    /// Whether SUMO drives some, with so many at spawn places.
    pub fn is_mixed(&self, vehicles: u32) -> bool {
        self.learners(vehicles) < vehicles || !self.files.is_empty()
    }

    /// How many of so many vehicles learn: at least one.
    pub fn learners(&self, vehicles: u32) -> u32 {
        ((self.penetration * f64::from(vehicles)).round() as u32).clamp(1, vehicles.max(1))
    }
}

/// Who can hear whom.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Communication {
    /// Range d_comm of the physical mask \[m\].
    pub range: f64,
}

impl Net {
    /// Number of spawn places.
    #[must_use]
    pub fn capacity(&self) -> u32 {
        self.spawns.iter().map(|row| row.count).sum()
    }

    /// The places, row by row.
    pub fn places(&self) -> impl Iterator<Item = SpawnPlace> + '_ {
        self.spawns.iter().flat_map(|row| {
            (0..row.count).map(|i| SpawnPlace {
                routes: Arc::clone(&row.routes),
                pos: row.first + row.spacing * f64::from(i),
            })
        })
    }
}
