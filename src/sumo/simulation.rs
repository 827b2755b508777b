//! The boundary between the environments and SUMO: worlds, commands out, a snapshot back.
//!
//! A *world* is one episode's traffic: `slots` vehicle slots on one copy of the net, in coordinates of
//! its own. How worlds are hosted (a process each, tiles of one net, libsumo) is the host's business;
//! the environments see world and slot numbers only. One decision is ONE exchange, split in two halves
//! ([`Simulation::send`], [`Simulation::receive`]) so that many hosts can be set going before the first
//! answer is awaited.
//!
//! A vehicle is reported by its way along the route, not by coordinates: SUMO adds up lengths of lanes, which are the
//! same numbers in every copy of a net, while coordinates far from the origin are rounded otherwise. So a world's
//! results are the same, to the bit, however it is hosted.

use std::time::Duration;

use super::Error;

/// State of one vehicle after a step.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct VehicleState {
    /// Front bumper, from the start of the route's first edge, as the sum of SUMO's lane lengths \[m\].
    pub distance: f64,
    /// Speed \[m/s\].
    pub speed: f64,
}

/// Where a vehicle is that SUMO drives, after a step.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Body {
    /// Centre of the front bumper, x in the world's coordinates \[m\].
    pub x: f64,
    /// Centre of the front bumper, y in the world's coordinates \[m\].
    pub y: f64,
    /// Heading \[rad\], counter-clockwise from +x.
    pub heading: f64,
    /// Time lost since it departed, by driving below the speed that its lane and type allow \[s\].
    pub time_loss: f64,
}

/// One instruction of a decision. Commands of one [`Simulation::send`] are carried out in order, before the step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Command {
    /// Puts a vehicle into a slot that is empty (or was emptied by [`Command::Remove`] in the same batch).
    Add {
        /// World number.
        world: u32,
        /// Slot of the world.
        slot: u32,
        /// Index into [`SimulationConfig::routes`].
        route: u32,
        /// Index into [`SimulationConfig::vehicle_types`], and beyond these into [`Others::types`].
        vehicle_type: u32,
        /// Position of the front bumper on the route's first edge \[m\].
        depart_pos: f64,
        /// Speed at departure \[m/s\].
        depart_speed: f64,
    },
    /// As [`Command::Add`], where SUMO finds the place and the speed, or of a pedestrian.
    Depart {
        /// World number.
        world: u32,
        /// Slot of the world.
        slot: u32,
        /// Index into [`Others::departures`].
        departure: u32,
        /// As in [`Command::Add`].
        vehicle_type: u32,
    },
    /// Takes the vehicle of a slot out of the simulation; nothing happens if the slot is empty.
    Remove {
        /// World number.
        world: u32,
        /// Slot of the world.
        slot: u32,
    },
    /// Speed that the vehicle has after the step \[m/s\]; a negative value gives the speed back to SUMO's driver.
    SetSpeed {
        /// World number.
        world: u32,
        /// Slot of the world.
        slot: u32,
        /// Speed \[m/s\].
        speed: f64,
    },
    /// SUMO's speed mode bits (32: no check at all, 31: SUMO's own driver and right of way).
    SpeedMode {
        /// World number.
        world: u32,
        /// Slot of the world.
        slot: u32,
        /// The bits.
        mode: i32,
    },
    /// SUMO no longer changes the vehicle's lane of its own accord.
    KeepLane {
        /// World number.
        world: u32,
        /// Slot of the world.
        slot: u32,
    },
    /// Places the vehicle, from the end of the coming step on (TraCI's `moveToXY`).
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
        /// SUMO's bits: 1 maps the place to the vehicle's route only, 2 takes exactly the place, also off the road.
        keep_route: u8,
    },
}

/// A kind of vehicle, made known to SUMO when the simulation starts.
#[derive(Debug, Clone, PartialEq)]
pub struct VehicleType {
    /// SUMO id of the type.
    pub id: String,
    /// Length \[m\].
    pub length: f64,
    /// Width \[m\].
    pub width: f64,
    /// Highest speed \[m/s\].
    pub max_speed: f64,
    /// Acceleration ability of SUMO's driver \[m/s²\].
    pub accel: f64,
    /// Comfortable deceleration of SUMO's driver \[m/s²\].
    pub decel: f64,
    /// Strongest deceleration of SUMO's driver \[m/s²\].
    pub emergency_decel: f64,
    /// Gap to the leader when standing \[m\].
    pub min_gap: f64,
    /// Desired time headway of SUMO's driver \[s\].
    pub tau: f64,
}

/// A route, made known to SUMO when the simulation starts.
#[derive(Debug, Clone, PartialEq)]
pub struct Route {
    /// SUMO id of the route.
    pub id: String,
    /// Edge ids in driving order.
    pub edges: Vec<String>,
    /// Lane of the first edge on which vehicles depart, from the right, starting at 0.
    pub lane: u32,
    /// Whether it is for pedestrians, who need not know of it before they depart.
    pub walked: bool,
}

/// Vehicles that SUMO drives, and pedestrians, beside those that are told what to do.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Others {
    /// The slots from this one on are theirs: [`Snapshot::bodies`] tells where they are.
    pub first_slot: u32,
    /// `<vType>` elements, as SUMO reads them.
    pub definitions: String,
    /// Ids of these types and of SUMO's own, addressed by index.
    pub types: Vec<String>,
    /// Ways to depart, addressed by index.
    pub departures: Vec<Departure>,
}

/// How a vehicle or a pedestrian departs, in SUMO's words.
#[derive(Debug, Clone, PartialEq)]
pub enum Departure {
    /// A vehicle.
    Drive {
        /// Index into [`SimulationConfig::routes`].
        route: u32,
        /// `departLane`.
        lane: String,
        /// `departPos`.
        pos: String,
        /// `departSpeed`.
        speed: String,
    },
    /// A pedestrian.
    Walk {
        /// Index into [`SimulationConfig::routes`].
        route: u32,
        /// From the beginning of the first edge, in its direction \[m\].
        pos: f64,
        /// Likewise on the last edge, where the walk ends \[m\].
        arrival: f64,
    },
}

impl Departure {
    /// Index into [`SimulationConfig::routes`].
    pub fn route(&self) -> u32 {
        match self {
            Self::Drive { route, .. } | Self::Walk { route, .. } => *route,
        }
    }
}

/// What a host needs to start.
#[derive(Debug, Clone, PartialEq)]
pub struct SimulationConfig {
    /// The `.net.xml`.
    pub net: std::path::PathBuf,
    /// Length of a simulation step \[s\].
    pub step_length: f64,
    /// SUMO's own seed.
    pub seed: u64,
    /// Worlds, each on its own copy of the net.
    pub worlds: u32,
    /// Vehicle slots per world.
    pub slots: u32,
    /// Vehicle types, addressed by index.
    pub vehicle_types: Vec<VehicleType>,
    /// Routes, addressed by index.
    pub routes: Vec<Route>,
    /// How long SUMO may take for an answer before it counts as dead.
    pub timeout: Duration,
    /// Whether SUMO looks for collisions in junctions, too. It takes most of SUMO's time where vehicles crowd.
    pub audit: bool,
    /// Vehicles that SUMO drives, if there are any.
    pub others: Option<Others>,
}

/// How a simulation was brought back to a fresh and empty state.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Renewal {
    /// The instance loaded its net again.
    Loaded,
    /// A new instance took its place.
    Restarted,
}

/// What has gone over the boundary so far.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Meter {
    /// Exchanges with SUMO.
    pub exchanges: u64,
    /// Bytes sent; 0 in process.
    pub sent: u64,
    /// Bytes received; 0 in process.
    pub received: u64,
    /// SUMO's process; `None` where it is this one.
    pub pid: Option<u32>,
}

/// A collision as SUMO reports it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Collision {
    /// World number.
    pub world: u32,
    /// Slot of the vehicle that ran into the other.
    pub collider: u32,
    /// Slot of the other vehicle.
    pub victim: u32,
}

/// What came back from one step. Reused from step to step.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Snapshot {
    /// Simulation time after the step \[s\].
    pub time: f64,
    /// `[worlds * slots]`, world-major; `None`: no vehicle of that slot is on the road.
    pub vehicles: Vec<Option<VehicleState>>,
    /// As `vehicles`, of those that SUMO drives; empty where there are none ([`SimulationConfig::others`]).
    pub bodies: Vec<Option<Body>>,
    /// Collisions that SUMO reports for this step (a lasting overlap is reported in each step).
    pub collisions: Vec<Collision>,
}

/// One SUMO instance, hosting one or more worlds.
pub trait Simulation: Send {
    /// Worlds hosted here.
    fn worlds(&self) -> u32;

    /// Vehicle slots per world.
    fn slots(&self) -> u32;

    /// Sends the commands of one decision together with the step of one step length.
    ///
    /// # Errors
    /// [`Error`]; fatal ones mean that this instance is gone.
    fn send(&mut self, commands: &[Command]) -> Result<(), Error>;

    /// Waits for the answer to the last [`Simulation::send`].
    ///
    /// # Errors
    /// [`Error`]; fatal ones mean that this instance is gone.
    fn receive(&mut self) -> Result<&Snapshot, Error>;

    /// Makes the simulation fresh and empty: SUMO loads its net again if it still answers, else a new SUMO takes its
    /// place.
    ///
    /// # Errors
    /// [`Error`] when no new instance can be started.
    fn renew(&mut self) -> Result<Renewal, Error>;

    /// SUMO's seed from the next [`Simulation::renew`] on.
    fn reseed(&mut self, seed: u64);

    /// What has gone over the boundary so far.
    fn meter(&self) -> Meter;

    /// [`Simulation::send`] and [`Simulation::receive`] in one: ONE exchange for all worlds.
    ///
    /// # Errors
    /// As those two.
    fn step(&mut self, commands: &[Command]) -> Result<&Snapshot, Error> {
        self.send(commands)?;
        self.receive()
    }
}
