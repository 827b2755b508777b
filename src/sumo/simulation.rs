//! The interface between the environments and SUMO: worlds, commands to SUMO, and a snapshot of the
//! result.
//!
//! A *world* is the traffic of one episode: `slots` vehicle slots on one copy of the net, in its
//! own coordinates. The environments see only world and slot numbers. How worlds run (one process
//! each, tiles of one net, libsumo) is hidden behind [`Simulation`]. One decision is one exchange.
//! It is split into [`Simulation::send`] and [`Simulation::receive`], so that many SUMO instances
//! can work at the same time.
//!
//! SUMO reports the position of a vehicle as the distance along its route instead of coordinates.
//! SUMO sums lane lengths, which are the same numbers in every copy of a net, whereas coordinates
//! far from the origin are rounded differently. The results of a world are therefore bit-identical
//! however it is hosted.

use std::time::Duration;

use super::Error;

/// State of one vehicle after a step.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct VehicleState {
    /// Distance of the front bumper from the start of the route's first edge, as the sum of SUMO's
    /// lane lengths \[m\].
    pub distance: f64,
    /// Speed \[m/s\].
    pub speed: f64,
}

/// The pose of a vehicle or pedestrian that SUMO drives, after a step.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Body {
    /// Centre of the front bumper, x in the world's coordinates \[m\].
    pub x: f64,
    /// Centre of the front bumper, y in the world's coordinates \[m\].
    pub y: f64,
    /// Heading \[rad\], counter-clockwise from +x.
    pub heading: f64,
    /// Lane of the front bumper, as an index into [`Net::lanes`](super::net::Net::lanes); `None` for
    /// a pedestrian, and where SUMO has the vehicle on no lane.
    pub lane: Option<u32>,
    /// Time lost since departure by driving below the speed that its lane and type allow \[s\].
    pub time_loss: f64,
}

/// State of a traffic light in a step.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TrafficLightState {
    /// What the signals said in the step, one letter for each as in SUMO's programs.
    pub state: String,
    /// Index of the phase.
    pub phase: i32,
    /// Simulation time of the step that begins with the next phase \[s\].
    pub next_switch: f64,
}

/// One command of a decision. SUMO carries out the commands of one [`Simulation::send`] in order,
/// before the step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Command {
    /// Adds a vehicle to a slot that is empty (or that an earlier [`Command::Remove`] of the same
    /// [`Simulation::send`] empties).
    Add {
        /// World number.
        world: u32,
        /// Slot of the world.
        slot: u32,
        /// Index into [`SimulationConfig::routes`].
        route: u32,
        /// Index into [`SimulationConfig::vehicle_types`], continued by [`BackgroundTraffic::types`].
        vehicle_type: u32,
        /// Position of the front bumper on the route's first edge \[m\].
        depart_pos: f64,
        /// Speed at departure \[m/s\].
        depart_speed: f64,
    },
    /// Adds a vehicle whose position and speed SUMO chooses, or a pedestrian, to an empty slot.
    Depart {
        /// World number.
        world: u32,
        /// Slot of the world.
        slot: u32,
        /// Index into [`BackgroundTraffic::departures`].
        departure: u32,
        /// Index as in [`Command::Add`].
        vehicle_type: u32,
        /// What to add to [`RouteStop::until`] for SUMO's clock, in seconds after the last step.
        until_from_now: f64,
    },
    /// Removes the vehicle of a slot from the simulation; has no effect on an empty slot.
    Remove {
        /// World number.
        world: u32,
        /// Slot of the world.
        slot: u32,
    },
    /// Sets the speed that the vehicle has after the step \[m/s\]; a negative value returns control
    /// of the speed to SUMO's car-following model.
    SetSpeed {
        /// World number.
        world: u32,
        /// Slot of the world.
        slot: u32,
        /// Speed \[m/s\].
        speed: f64,
    },
    /// Sets SUMO's speed mode bits (32: no checks; 31: all checks of SUMO's car-following model and
    /// right of way).
    SpeedMode {
        /// World number.
        world: u32,
        /// Slot of the world.
        slot: u32,
        /// Speed mode bits.
        mode: i32,
    },
    /// Sets SUMO's lane change mode bits (0: SUMO changes lanes only on request, and then whoever is
    /// in the way).
    LaneChangeMode {
        /// World number.
        world: u32,
        /// Slot of the world.
        slot: u32,
        /// Lane change mode bits.
        mode: i32,
    },
    /// Changes to a neighbouring lane in the coming step.
    ChangeLane {
        /// World number.
        world: u32,
        /// Slot of the world.
        slot: u32,
        /// SUMO's index of the lane on its edge.
        lane: u32,
    },
    /// Moves the vehicle to a pose, which it has at the end of the next step (TraCI's `moveToXY`).
    MoveTo {
        /// World number.
        world: u32,
        /// Slot of the world.
        slot: u32,
        /// Centre of the front bumper, x in the world's coordinates \[m\].
        x: f64,
        /// Centre of the front bumper, y in the world's coordinates \[m\].
        y: f64,
        /// Heading \[rad\], counter-clockwise from +x.
        heading: f64,
        /// SUMO's bits: 1 maps the position to the vehicle's route only, 2 takes the exact
        /// position, also off the road.
        keep_route: u8,
    },
    /// Puts a traffic light into a phase of its program, which goes on from there.
    StartPhase {
        /// World number.
        world: u32,
        /// Index into [`SimulationConfig::traffic_lights`].
        traffic_light: u32,
        /// Index of the phase.
        phase: u32,
        /// How long the phase takes from now on \[s\].
        remaining: f64,
    },
}

/// A vehicle type, which is defined in SUMO when the simulation starts.
#[derive(Debug, Clone, PartialEq)]
pub struct VehicleType {
    /// SUMO id of the type.
    pub id: String,
    /// Length \[m\].
    pub length: f64,
    /// Width \[m\].
    pub width: f64,
    /// Vehicle class; `None`: SUMO's default, a passenger car.
    pub class: Option<String>,
    /// Highest speed \[m/s\].
    pub max_speed: f64,
    /// Acceleration ability in SUMO's car-following model \[m/s²\].
    pub accel: f64,
    /// Comfortable deceleration in SUMO's car-following model \[m/s²\].
    pub decel: f64,
    /// Maximum deceleration in SUMO's car-following model \[m/s²\].
    pub emergency_decel: f64,
    /// Gap to the leader at standstill \[m\].
    pub min_gap: f64,
    /// Desired time headway in SUMO's car-following model \[s\].
    pub tau: f64,
}

/// A route, which is defined in SUMO when the simulation starts.
#[derive(Debug, Clone, PartialEq)]
pub struct Route {
    /// SUMO id of the route.
    pub id: String,
    /// Edge ids in driving order.
    pub edges: Vec<String>,
    /// Lane of the first edge on which vehicles depart, counted from the right and starting at 0.
    pub lane: u32,
    /// Whether pedestrians walk the route. Such a route is not defined in SUMO in advance; a
    /// pedestrian gets its edges at departure.
    pub walked: bool,
}

/// Background traffic: vehicles that SUMO drives, and pedestrians.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct BackgroundTraffic {
    /// First slot whose pose [`Snapshot::bodies`] gives, as it does for all following slots: that
    /// of the background traffic, or 0 if agents depart where SUMO chooses.
    pub first_slot: u32,
    /// `<vType>` elements in SUMO's format.
    pub definitions: String,
    /// Ids of these types and of SUMO's built-in types; commands refer to them by index.
    pub types: Vec<String>,
    /// Possible departures; commands refer to them by index.
    pub departures: Vec<Departure>,
    /// What messages call the vehicle or pedestrian of each departure; a missing name is the one
    /// that the vehicle has in SUMO.
    pub names: Vec<String>,
}

/// A stop on a vehicle's route.
#[derive(Debug, Clone, PartialEq)]
pub struct RouteStop {
    /// Edge.
    pub edge: String,
    /// Lane, counted from the right and starting at 0.
    pub lane: u32,
    /// Where the stop begins and ends on the edge \[m\].
    pub range: [f64; 2],
    /// Least duration \[s\].
    pub duration: f64,
    /// Time before which the vehicle does not go on \[s\]; see [`Command::Depart`].
    pub until: Option<f64>,
}

/// The departure of a vehicle or a pedestrian, in SUMO's terms.
#[derive(Debug, Clone, PartialEq)]
pub enum Departure {
    /// A vehicle.
    Drive {
        /// Index into [`SimulationConfig::routes`].
        route: u32,
        /// SUMO's `departLane`.
        lane: String,
        /// SUMO's `departPos`.
        pos: String,
        /// SUMO's `departSpeed`.
        speed: String,
        /// SUMO's `arrivalLane`.
        arrival_lane: String,
        /// SUMO's `arrivalPos`.
        arrival_pos: String,
        /// SUMO's `arrivalSpeed`.
        arrival_speed: String,
        /// SUMO's `line`; empty: none.
        line: String,
        /// SUMO's `personNumber`.
        persons: u32,
        /// SUMO's `speedFactor`; without it, SUMO draws it as the type says.
        speed_factor: Option<f64>,
        /// Stops on the way, in driving order.
        stops: Vec<RouteStop>,
    },
    /// A pedestrian.
    Walk {
        /// Index into [`SimulationConfig::routes`].
        route: u32,
        /// Position on the first edge, from its beginning in its direction \[m\].
        pos: f64,
        /// Position on the last edge where the walk ends, from the beginning of that edge in its
        /// direction \[m\].
        arrival: f64,
    },
}

impl Departure {
    /// Returns the index into [`SimulationConfig::routes`].
    pub fn route(&self) -> u32 {
        match self {
            Self::Drive { route, .. } | Self::Walk { route, .. } => *route,
        }
    }
}

/// The configuration with which a simulation starts.
#[derive(Debug, Clone, PartialEq)]
pub struct SimulationConfig {
    /// Path of the `.net.xml` file.
    pub net: std::path::PathBuf,
    /// Length of a simulation step \[s\].
    pub step_length: f64,
    /// Seed of SUMO's own random numbers.
    pub seed: u64,
    /// Number of worlds, each on its own copy of the net.
    pub worlds: u32,
    /// Number of vehicle slots per world.
    pub slots: u32,
    /// Vehicle types; commands refer to them by index.
    pub vehicle_types: Vec<VehicleType>,
    /// Routes; commands refer to them by index.
    pub routes: Vec<Route>,
    /// Longest wait for an answer before SUMO counts as dead.
    pub timeout: Duration,
    /// Whether SUMO also detects collisions on junctions. In dense traffic this takes most of
    /// SUMO's time.
    pub audit: bool,
    /// Whether vehicles of [`Command::Add`] may have to wait for room on the road, so that SUMO may
    /// drop them ([`Snapshot::dropped`]).
    pub waits: bool,
    /// Background traffic; `None` if there is none.
    pub others: Option<BackgroundTraffic>,
    /// Ids of the traffic lights whose states [`Snapshot::traffic_lights`] gives.
    pub traffic_lights: Vec<String>,
}

#[cfg(test)]
impl SimulationConfig {
    /// Returns a configuration of one world on a crossing, without vehicle types and routes.
    pub(super) fn crossing(slots: u32) -> Self {
        SimulationConfig {
            net: "sumo_nets/intersection/arm30.net.xml".into(),
            step_length: 0.1,
            seed: 0,
            worlds: 1,
            slots,
            vehicle_types: Vec::new(),
            routes: Vec::new(),
            timeout: Duration::from_secs(60),
            audit: true,
            waits: false,
            others: None,
            traffic_lights: Vec::new(),
        }
    }
}

/// How a simulation was reset to an empty state.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Renewal {
    /// The SUMO instance loaded its net again.
    Loaded,
    /// A new SUMO instance replaced the old one.
    Restarted,
}

/// Counts of the exchanges with SUMO so far.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Meter {
    /// Number of exchanges.
    pub exchanges: u64,
    /// Number of bytes sent; 0 for SUMO in this process.
    pub sent: u64,
    /// Number of bytes received; 0 for SUMO in this process.
    pub received: u64,
    /// Process identifier of SUMO; `None` for SUMO in this process.
    pub pid: Option<u32>,
}

/// A collision that SUMO reports.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Collision {
    /// World number.
    pub world: u32,
    /// Slot of the vehicle that ran into the other, SUMO's collider.
    pub collider: u32,
    /// Slot of the other vehicle, SUMO's victim.
    pub victim: u32,
}

/// A departure of a vehicle that SUMO has refused, or has discarded when the vehicle was to enter the
/// road, for example because it could not depart at its speed; or one of whose stops SUMO has refused.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Dropped {
    /// World number.
    pub world: u32,
    /// Slot of the vehicle, which is empty now unless the vehicle drives.
    pub slot: u32,
    /// Index into [`BackgroundTraffic::departures`]; `None` for a vehicle of [`Command::Add`].
    pub departure: Option<u32>,
    /// SUMO's reason, if it gives one.
    pub reason: Option<String>,
    /// Whether the vehicle drives, without one of its stops.
    pub drives: bool,
}

/// The result of one step. Its buffers are reused from step to step.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Snapshot {
    /// Simulation time after the step \[s\].
    pub time: f64,
    /// States of the vehicles, `[worlds * slots]`, world-major; `None` if no vehicle of the slot is
    /// on the road.
    pub vehicles: Vec<Option<VehicleState>>,
    /// Poses of the background traffic, indexed as `vehicles`; empty if there is no background
    /// traffic ([`SimulationConfig::others`]).
    pub bodies: Vec<Option<Body>>,
    /// States of the traffic lights, `[worlds * traffic lights]`, world-major.
    pub traffic_lights: Vec<TrafficLightState>,
    /// Collisions that SUMO reports for this step. A lasting overlap is reported in each step.
    pub collisions: Vec<Collision>,
    /// Departures that SUMO refused or discarded in this step, at least in part.
    pub dropped: Vec<Dropped>,
}

/// One SUMO instance, which runs one or more worlds.
pub trait Simulation: Send {
    /// Returns the number of worlds in this instance.
    fn worlds(&self) -> u32;

    /// Returns the number of vehicle slots per world.
    fn slots(&self) -> u32;

    /// Sends the commands of one decision and a step of one step length.
    ///
    /// # Errors
    /// [`Error`]; a fatal error means that this instance is lost.
    fn send(&mut self, commands: &[Command]) -> Result<(), Error>;

    /// Waits for the answer to the last [`Simulation::send`].
    ///
    /// # Errors
    /// [`Error`]; a fatal error means that this instance is lost.
    fn receive(&mut self) -> Result<&Snapshot, Error>;

    /// Resets the simulation to an empty state: SUMO loads its net again if it still answers;
    /// otherwise a new SUMO instance replaces it.
    ///
    /// # Errors
    /// [`Error`] if no new instance can be started.
    fn renew(&mut self) -> Result<Renewal, Error>;

    /// Sets SUMO's seed, with effect from the next [`Simulation::renew`].
    fn reseed(&mut self, seed: u64);

    /// Returns the counts of the exchanges so far.
    fn meter(&self) -> Meter;

    /// Combines [`Simulation::send`] and [`Simulation::receive`] in one exchange for all worlds.
    ///
    /// # Errors
    /// As [`Simulation::send`] and [`Simulation::receive`].
    fn step(&mut self, commands: &[Command]) -> Result<&Snapshot, Error> {
        self.send(commands)?;
        self.receive()
    }
}
