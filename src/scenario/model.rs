//! The parts of a task as structs. Fields of structs in `element!` are attributes of the file.

use std::path::PathBuf;

use super::attribute::{Field, Tag, Value, element, words};
use super::demand::seconds;
use super::observation::Observation;
use super::reader::Element;
use super::{Demand, Error, Net, Occlusion, Source};

/// A task: its nets, routes, vehicle, control, observation, reward and background traffic.
#[derive(Debug, Clone, PartialEq)]
pub struct Scenario {
    /// Name, which is also the first level of the run folders.
    pub name: String,
    /// File that the scenario was read from.
    pub path: PathBuf,
    /// Description in one sentence.
    pub description: String,
    /// Number of agents that the scenario accepts.
    pub agents: AgentRange,
    /// Nets of different sizes, ascending by [`Net::capacity`].
    pub nets: Vec<Net>,
    /// Routes of the agents.
    pub routes: Vec<Route>,
    /// Size and top speed of the agents' vehicle.
    pub vehicle: Vehicle,
    /// Further kinds of vehicles that agents may have.
    pub kinds: Vec<Kind>,
    /// Random displacement of vehicles from their spawn places.
    pub jitter: Jitter,
    /// How actions move a vehicle.
    pub control: Control,
    /// What an agent observes.
    pub observation: Observation,
    /// Reward terms.
    pub reward: Reward,
    /// Conditions that end an episode, or an agent's part in it.
    pub termination: Termination,
    /// Communication between agents.
    pub communication: Communication,
    /// Polygons that block sight and radio; `None`: nothing does.
    pub occlusion: Option<Occlusion>,
    /// Background traffic: vehicles and pedestrians that SUMO moves.
    pub traffic: Traffic,
}

element! {
    /// Number of agents that a scenario accepts, and which vehicles of the route files are agents.
    #[derive(Debug, Clone, Default, PartialEq, Eq)]
    pub struct AgentRange {
        /// Smallest number.
        pub min: u32,
        /// Largest number.
        pub max: u32,
        /// Number if the user does not specify one.
        pub default: u32,
        /// Agents among the vehicles of the route files, by the ids of their types or
        /// distributions of types.
        pub types: Vec<String>,
        /// Agents among the vehicles of the route files, by the ids of vehicles and flows; `*`: all
        /// of them.
        pub vehicles: Vec<String>,
    }
}

element! {
    /// A route through the net.
    #[derive(Debug, Clone, PartialEq)]
    pub struct Route {
        /// Id, unique in the scenario.
        pub id: String,
        /// Edge ids in driving order.
        pub edges: Vec<String>,
        /// Lane of the first edge, counted from the right and starting at 0. Default: the rightmost
        /// lane from which the route can be driven with the fewest lane changes.
        pub lane: Option<u32>,
        /// Finish line of the agent: position on the last edge \[m\]; a negative value counts from
        /// the end of the edge.
        pub arrival_pos: f64,
        /// Whether the last edge is a destination for one vehicle only: an episode does not draw
        /// two reserved routes that end on the same edge.
        pub reserved: bool,
        /// Factor on the speed reward, and on the progress reward of driving forwards, while a
        /// vehicle that steers is off the lanes of its route, from -1 to 1. Default: 1.
        pub off_lane: f64,
    }
}

element! {
    /// Size and top speed of the agents' vehicle.
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub struct Vehicle {
        /// Length of the body \[m\].
        pub length: f64,
        /// Width of the body \[m\].
        pub width: f64,
        /// Top speed \[m/s\].
        pub max_speed: f64,
    }
}

impl Vehicle {
    /// Distance from a vehicle's side to the border at which the vehicle is off-road \[m\], as
    /// measured on the paper's simulator.
    pub const BORDER_MARGIN: f64 = 0.035;
}

element! {
    /// A kind of vehicle that an agent at a spawn place may have, no larger and no faster than
    /// [`Scenario::vehicle`].
    #[derive(Debug, Clone, PartialEq)]
    pub struct Kind {
        /// Name, unique in the scenario.
        pub id: String,
        /// Probability that an agent has this kind, above 0 to 1.
        pub share: f64,
        /// Length of the body \[m\].
        pub length: f64,
        /// Width of the body \[m\].
        pub width: f64,
        /// Top speed \[m/s\].
        pub max_speed: f64,
        /// Acceleration at full throttle \[m/s²\].
        pub accel: f64,
        /// Braking curve, as [`Control::brake`].
        pub brake: Vec<(f64, f64)>,
    }
}

element! {
    /// Random displacement of vehicles from their spawn places: uniform in plus or minus each
    /// value.
    #[derive(Debug, Clone, Copy, Default, PartialEq)]
    pub struct Jitter {
        /// Along the lane \[m\].
        pub longitudinal: f64,
        /// Across the lane \[m\].
        pub lateral: f64,
    }
}

element! {
    /// How actions move a vehicle.
    #[derive(Debug, Clone, PartialEq)]
    pub struct Control {
        /// Decision interval \[s\], which is also SUMO's step length.
        pub interval: f64,
        /// Acceleration at full throttle \[m/s²\].
        pub accel: f64,
        /// Deceleration at zero throttle, and the smallest deceleration of a braking action
        /// \[m/s²\].
        pub drag: f64,
        /// Braking curve as points (magnitude of the action, deceleration \[m/s²\]), ascending,
        /// linear between the points and from the origin.
        pub brake: Vec<(f64, f64)>,
        /// Mean throttle of an untrained policy, -1 to 1. At 0, vehicles hardly move under
        /// exploration noise where brakes are stronger than the engine; the larger the value, the
        /// sooner all vehicles drive at full throttle.
        pub initial_throttle: f64,
        /// What decides on the lane changes of vehicles that do not steer.
        pub lane_change: LaneChange,
        /// Parameters of a vehicle that steers. With them, an action has two components: steering,
        /// then throttle and brake. Without them, throttle and brake are the only component, and
        /// SUMO keeps the vehicle on its route.
        pub steering: Option<Steering>,
    }
}

/// What decides on the lane changes of agents that do not steer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum LaneChange {
    /// Nobody: agents keep their lanes.
    #[default]
    None,
    /// SUMO's lane change model, where the route needs another lane or others need room.
    Route,
    /// The agent: a second dimension of its actions asks for the lane to the left or to the right.
    Action,
}

words!(LaneChange { None: "none", Route: "route", Action: "action" });

/// The child element `<steering>`.
impl Field for Option<Steering> {
    fn read(element: &Element, name: &str) -> Result<Self, Error> {
        element.child(name).map(|child| Steering::read(&child, "")).transpose()
    }

    fn write(&self, tag: &mut Tag, name: &str) {
        if let Some(steering) = self {
            tag.element(name, |tag| steering.write(tag, ""));
        }
    }

    #[cfg(test)]
    fn names(_: &str, _: &mut Vec<String>) {}
}

impl Control {
    /// Default of [`Control::initial_throttle`].
    pub const INITIAL_THROTTLE: f64 = 0.5;

    /// Returns the name of the control mode in XML.
    pub(super) fn mode(&self) -> &'static str {
        if self.steering.is_some() { "steering" } else { "throttle" }
    }
}

element! {
    /// Parameters of a vehicle that steers.
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub struct Steering {
        /// Steering angle of the front wheels at full lock \[deg\].
        pub max_angle: f64,
        /// Distance of the front axle from the centre of mass, which is the middle of the vehicle
        /// \[m\].
        pub front_axle: f64,
        /// Distance of the rear axle from the centre of mass \[m\].
        pub rear_axle: f64,
        /// Distance between the left and the right wheels \[m\].
        pub track: f64,
        /// Friction of the tyres: the largest force of a tyre, as a multiple of its load.
        pub friction: f64,
        /// Moment of inertia about the vertical axis, per mass \[m²\].
        pub yaw_inertia: f64,
        /// Whether a negative throttle drives backwards. If so, negative throttle is thrust, and
        /// only zero throttle brakes.
        pub reverse: bool,
    }
}

impl Default for Steering {
    /// Returns the parameters of the vehicle of the paper's simulator (MetaDrive's default
    /// vehicle).
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
    /// Returns the distance between the axles \[m\].
    pub fn wheelbase(&self) -> f64 {
        self.front_axle + self.rear_axle
    }
}

element! {
    /// Reward terms and their weights.
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub struct Reward {
        /// Reward per metre along the route.
        pub progress: f64,
        /// Reward per step at [`Reward::SPEED_UNIT`], in proportion to speed.
        pub speed: f64,
        /// Share of the progress reward that an agent loses half a lane's width beside its path;
        /// nearer to the path in proportion to the lateral offset. 0 to 1.
        pub lane_keeping: f64,
        /// What an agent loses in each second on the road, 0 or more.
        pub time: f64,
        /// Reward of the step in which the agent arrives, in place of the terms for driving.
        pub arrive: f64,
        /// Reward of the step in which the agent goes off-road, in place of the terms for driving.
        pub out_of_road: f64,
        /// Reward of the step in which the agent crashes, in place of the terms for driving.
        pub crash: f64,
        /// Added to the reward of a step in which the agent passes a red signal.
        pub red_light: f64,
        /// Weight of each other agent's advantage in training, 0 to 1; the agent's own advantage
        /// has weight 1.
        pub cooperation: f64,
        /// Largest distance between agents that share in each other's advantages \[m\]. Infinite:
        /// all agents of a world share.
        pub share_range: f64,
    }
}

impl Reward {
    /// Speed at which the speed term equals [`Reward::speed`]: 80 km/h \[m/s\].
    pub const SPEED_UNIT: f64 = 80.0 / 3.6;
}

element! {
    /// Conditions that end an episode, or an agent's part in it.
    #[derive(Debug, Clone, PartialEq)]
    pub struct Termination {
        /// Horizon: number of steps after which an episode is truncated.
        pub horizon: u32,
        /// Time for which a crashed vehicle stays on the road as an obstacle \[s\].
        pub wreck_time: f64,
        /// Border of the road for vehicles that steer.
        pub border: Border,
        /// Edges with a broken line between the two directions, which vehicles that steer may
        /// cross.
        pub broken_lines: Vec<String>,
    }
}

/// Border of the road for vehicles that steer. A vehicle whose centre is on no lane is off-road
/// with either border.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Border {
    /// The lines at both sides of a road.
    Line,
    /// The line between the two directions, and the kerb, a little beyond the outermost lanes. No
    /// line separates lanes of one direction or parking spaces.
    Kerb,
}

words!(Border { Line: "line", Kerb: "kerb" });

element! {
    /// Background traffic: vehicles and pedestrians that SUMO moves.
    #[derive(Debug, Clone, PartialEq)]
    pub struct Traffic {
        /// Share of agents among the vehicles at spawn places, and among those of the route files
        /// that [`AgentRange`] names, above 0 to 1; SUMO drives the others.
        pub penetration: f64,
        /// Type of the background vehicles at spawn places, an id from [`Traffic::files`]. Without
        /// it, these vehicles have the agents' size and abilities.
        pub kind as "type": Option<String>,
        /// SUMO route files, resolved against the scenario file's folder.
        pub files: Vec<PathBuf>,
        /// Largest number of vehicles and pedestrians from the files on the road at a time.
        pub capacity: u32,
        /// Time of the files at which each episode begins.
        pub begin: FileTime,
        /// Whether a file with vehicles that cannot be used is refused. Otherwise those vehicles
        /// are left out.
        pub strict: bool,
    }
}

/// A time of route files \[s\].
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct FileTime(pub f64);

impl Value for FileTime {
    fn parse(text: &str) -> Option<Self> {
        seconds(text).map(Self)
    }

    fn text(&self) -> Option<String> {
        Some(self.0.to_string())
    }
}

impl Default for Traffic {
    fn default() -> Self {
        Self {
            penetration: 1.0,
            kind: None,
            files: Vec::new(),
            capacity: 16,
            begin: FileTime(0.0),
            strict: false,
        }
    }
}

impl Traffic {
    /// Returns whether there is background traffic, with `vehicles` vehicles at spawn places.
    pub fn is_mixed(&self, vehicles: u32) -> bool {
        self.learners(vehicles) < vehicles || !self.files.is_empty()
    }

    /// Returns how many of `vehicles` vehicles are agents: at least one.
    pub fn learners(&self, vehicles: u32) -> u32 {
        ((self.penetration * f64::from(vehicles)).round() as u32).clamp(1, vehicles.max(1))
    }
}

element! {
    /// Communication between agents.
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub struct Communication {
        /// Communication range d_comm of the physical mask \[m\].
        pub range: f64,
        /// Largest number of other agents that an agent can hear, the nearest ones; 0: all within
        /// the range.
        pub nearest: usize,
    }
}

impl Scenario {
    /// Returns how many vehicles start at spawn places if `agents` is the number of agents: all of
    /// them, or as many as there are places if further agents come from route files.
    pub fn placed(&self, agents: u32) -> u32 {
        if !self.agents.come_from_files() {
            return agents;
        }
        agents.min(self.nets.iter().map(Net::capacity).max().unwrap_or(0))
    }

    /// Returns whether `nearest` of `<communication>` excludes nobody from communication.
    pub fn everybody_is_nearest(&self) -> bool {
        let nearest = self.communication.nearest;
        nearest == 0 || nearest >= self.agents.max.saturating_sub(1) as usize
    }

    /// Returns the number of agent slots if `agents` is the number of agents: without the vehicles
    /// at spawn places that SUMO drives, unless further agents come from route files.
    pub fn slots(&self, agents: u32) -> u32 {
        if self.agents.come_from_files() { agents } else { self.traffic.learners(agents) }
    }
}

impl AgentRange {
    /// Returns whether vehicles of the route files are agents.
    pub fn come_from_files(&self) -> bool {
        !self.types.is_empty() || !self.vehicles.is_empty()
    }

    /// Returns whether a vehicle or flow of the route files yields agents if its vehicle has the
    /// type `kind`, an index into [`Demand::types`].
    pub fn includes(&self, demand: &Demand, source: &Source, kind: usize) -> bool {
        let listed =
            |id: &String| demand.mix(id).is_some_and(|mix| mix.iter().any(|m| m.0 == kind));
        let named = self.vehicles.iter().any(|id| id == ALL || *id == source.id);
        !demand.types[kind].walks && (named || self.types.iter().any(listed))
    }

    /// Returns whether some vehicles of a vehicle or flow of the route files, given by its index
    /// into [`Demand::sources`], may be agents.
    pub fn includes_some(&self, demand: &Demand, source: usize) -> bool {
        let source = &demand.sources[source];
        source.types.iter().any(|entry| self.includes(demand, source, entry.0))
    }
}

/// Name of all vehicles of the route files in [`AgentRange::vehicles`].
pub(super) const ALL: &str = "*";
