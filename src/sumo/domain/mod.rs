//! The TraCI calls of all kinds of objects in SUMO 1.15, defined once and usable alone or in a
//! batch. [`Batch::get`], [`Batch::get_with`], [`Batch::set`] and [`Batch::subscribe`] reach what
//! later releases have added, by number.
//!
//! Each kind of object has one module, with a handle whose methods have SUMO's names in snake case:
//! `getSpeed` of a vehicle is [`Vehicle::get_speed`](vehicle::Vehicle::get_speed). A handle belongs
//! to a [`Scope`]. On a handle from a [`Client`] (`client.vehicle()`), each call is one exchange,
//! that is, one message to SUMO and its reply, and returns the result. On a handle from a [`Batch`]
//! (`batch.vehicle()`), each call returns a [`Ticket`]: all calls of the batch are sent in one
//! message, and [`Replies`](super::Replies) gives the result for each ticket. The cost of an
//! exchange is far greater than the cost of a call.
//!
//! A variable that SUMO accepts in subscriptions is also a constant of its module, such as
//! [`vehicle::VAR_SPEED`]: a [`Variable`], or a [`VariableWith`] if the variable needs an argument,
//! such as [`vehicle::VAR_LEADER`]. SUMO 1.15 crashes on subscriptions to other variables.
//!
//! Units are metres, seconds and their combinations; angles are navigational degrees (0 is north,
//! clockwise). SUMO reports [`INVALID_DOUBLE_VALUE`](super::constants::INVALID_DOUBLE_VALUE) where
//! it has no value.
//!
//! # Errors
//! All calls of a client fail in the same way. The connection stays usable after [`Error::Refused`]
//! (SUMO refuses the call), [`Error::Invalid`] (the call is not sent) and [`Error::Type`] (the
//! result has an unexpected type). It is not usable after [`Error::Closed`], [`Error::Timeout`] and
//! [`Error::Protocol`]. In a batch, the error of a refused call is returned when its ticket is
//! taken, or otherwise by [`Replies::check`](super::Replies::check); SUMO carries out the other
//! calls.
//!
//! # Examples
//! ```
//! use iwol_sumo::sumo::{domain::vehicle, process::{Options, Process}};
//!
//! # fn main() -> Result<(), iwol_sumo::sumo::Error> {
//! let net = concat!(env!("CARGO_MANIFEST_DIR"), "/sumo_nets/intersection/arm30.net.xml");
//! let options =
//!     Options { arguments: vec!["--net-file".into(), net.into()], ..Options::default() };
//! let (_process, mut client, _version) = Process::start(&options)?;
//!
//! // One exchange for each call.
//! let edges = client.edge().get_id_list()?;
//! let road = edges.iter().find(|edge| !edge.starts_with(':')).expect("a road");
//! client.route().add("r", &[road])?;
//! let addition = vehicle::Addition { depart_speed: "3", ..vehicle::Addition::on_route("r") };
//! client.vehicle().add("v0", &addition)?;
//!
//! // One exchange for all of them, the step included.
//! let mut batch = client.batch();
//! batch.vehicle().subscribe("v0", &[vehicle::VAR_SPEED.id()]);
//! let time = batch.simulation().get_time();
//! let nobody = batch.vehicle().set_speed("nobody", 1.0);
//! let mut reply = batch.step(0.0)?;
//! assert_eq!(reply.take(time)?, 0.0);
//! assert!(reply.take(nobody).is_err());
//! reply.check()?; // All others were carried out.
//! assert_eq!(reply.get("v0", vehicle::VAR_SPEED).transpose()?, Some(3.0));
//!
//! // What is within 50 m of the vehicle, after each step from now on.
//! use iwol_sumo::sumo::Domain;
//! client.vehicle().subscribe_context("v0", Domain::VEHICLE, 50.0, &[vehicle::VAR_SPEED.id()])?;
//! let reply = client.simulation_step(0.0)?;
//! let around = reply.around(Domain::VEHICLE, "v0");
//! assert_eq!(around.objects().collect::<Vec<_>>(), ["v0"]);
//! assert!(around.get("v0", vehicle::VAR_SPEED).is_some());
//! # Ok(())
//! # }
//! ```

use std::{fmt, ops::Range};

use super::{Batch, Client, ClientBatch, Error, batch::Call, codec::Value, constants::Domain};

#[macro_use]
mod macros;
#[macro_use]
mod common;

pub mod bus_stop;
pub mod calibrator;
pub mod charging_station;
pub mod edge;
pub mod gui;
pub mod induction_loop;
pub mod junction;
pub mod lane;
pub mod lane_area;
pub mod mean_data;
pub mod multi_entry_exit;
pub mod overhead_wire;
pub mod parking_area;
pub mod person;
pub mod poi;
pub mod polygon;
pub mod rerouter;
pub mod route;
pub mod route_probe;
pub mod simulation;
pub mod traffic_light;
pub mod variable_speed_sign;
pub mod vehicle;
pub mod vehicle_type;

pub use super::value::{Argument, Color, FromValue, Highlight, RoadPosition};
pub use super::variable::{Reported, SubscriptionArgument, Variable, VariableId, VariableWith};

/// Converts SUMO's answer to a call, the requested value or nothing, to the result of the call.
pub type Decode<T> = fn(Option<Value>) -> Result<T, Error>;

/// Destination of calls: SUMO at once ([`Client`]), or a message that is sent later ([`Batch`]).
pub trait Scope {
    /// The return type of a call whose result is a `T`.
    type Output<T>;

    /// Puts one or more commands into a batch by means of `fill` and treats them as one call: the
    /// result is the first refusal, or otherwise the last answer.
    fn request<T>(&mut self, fill: impl FnOnce(&mut Batch), decode: Decode<T>) -> Self::Output<T>;

    /// Like `request`, for commands on which SUMO 1.15 crashes if `object` does not exist. A client
    /// first reads the object in an exchange of its own, and sends nothing more if SUMO refuses
    /// that.
    fn request_for<T>(
        &mut self,
        domain: Domain,
        object: &str,
        fill: impl FnOnce(&mut Batch),
        decode: Decode<T>,
    ) -> Self::Output<T>;
}

impl Scope for Batch {
    type Output<T> = Ticket<T>;

    fn request<T>(&mut self, fill: impl FnOnce(&mut Batch), decode: Decode<T>) -> Ticket<T> {
        let start = self.len();
        fill(self);
        Ticket { batch: self.number(), commands: start..self.len(), decode }
    }

    fn request_for<T>(
        &mut self,
        _: Domain,
        _: &str,
        fill: impl FnOnce(&mut Batch),
        decode: Decode<T>,
    ) -> Ticket<T> {
        self.request(fill, decode)
    }
}

/// Placeholder for the result of a call in a batch; [`Replies::take`](super::Replies::take) returns
/// the result.
pub struct Ticket<T> {
    /// Number of the batch that the call belongs to.
    pub(super) batch: u64,
    /// Range of the call's commands in the batch.
    pub(super) commands: Range<usize>,
    pub(super) decode: Decode<T>,
}

impl<T> fmt::Debug for Ticket<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Ticket")
            .field("batch", &self.batch)
            .field("commands", &self.commands)
            .finish_non_exhaustive()
    }
}

fn get<S: Scope, T: FromValue>(
    scope: &mut S,
    call: Call,
    object: &str,
    argument: impl Argument,
) -> S::Output<T> {
    get_as(scope, call, object, argument, value)
}

fn get_as<S: Scope, T>(
    scope: &mut S,
    call: Call,
    object: &str,
    argument: impl Argument,
    decode: Decode<T>,
) -> S::Output<T> {
    scope.request(|batch| batch.call(call, object, |w| argument.write(w)), decode)
}

fn set<S: Scope>(
    scope: &mut S,
    call: Call,
    object: &str,
    argument: impl Argument,
) -> S::Output<()> {
    get_as(scope, call, object, argument, done)
}

/// Converts the answer to a call that has a value.
fn value<T: FromValue>(answer: Option<Value>) -> Result<T, Error> {
    match answer {
        Some(value) => T::from_value(value),
        None => Err(Error::other_type("a value", "none")),
    }
}

/// Accepts the answer to a call that has no value.
#[expect(clippy::unnecessary_wraps, reason = "a `Decode`")]
fn done(_: Option<Value>) -> Result<(), Error> {
    Ok(())
}

/// Defines the methods that return the handles of the domains.
macro_rules! handles {
    ($($(#[$doc:meta])* $method:ident -> $module:ident::$handle:ident;)+) => {
        impl Client {
            $($(#[$doc])* pub fn $method(&mut self) -> $module::$handle<'_, Client> {
                $module::$handle(self)
            })+
        }

        impl Batch {
            $($(#[$doc])* pub fn $method(&mut self) -> $module::$handle<'_, Batch> {
                $module::$handle(self)
            })+
        }

        impl ClientBatch<'_> {
            $($(#[$doc])* pub fn $method(&mut self) -> $module::$handle<'_, Batch> {
                $module::$handle(&mut self.batch)
            })+
        }
    };
}

handles! {
    /// Calls for bus stops.
    bus_stop -> bus_stop::BusStop;
    /// Calls for calibrators.
    calibrator -> calibrator::Calibrator;
    /// Calls for charging stations.
    charging_station -> charging_station::ChargingStation;
    /// Calls for edges.
    edge -> edge::Edge;
    /// Calls for the views of the graphical interface.
    gui -> gui::Gui;
    /// Calls for induction loops (E1 detectors).
    induction_loop -> induction_loop::InductionLoop;
    /// Calls for junctions.
    junction -> junction::Junction;
    /// Calls for lanes.
    lane -> lane::Lane;
    /// Calls for lane area detectors (E2 detectors).
    lane_area -> lane_area::LaneArea;
    /// Calls for collectors of mean data.
    mean_data -> mean_data::MeanData;
    /// Calls for multi-entry multi-exit detectors (E3 detectors).
    multi_entry_exit -> multi_entry_exit::MultiEntryExit;
    /// Calls for segments of overhead wires.
    overhead_wire -> overhead_wire::OverheadWire;
    /// Calls for parking areas.
    parking_area -> parking_area::ParkingArea;
    /// Calls for persons.
    person -> person::Person;
    /// Calls for points of interest.
    poi -> poi::Poi;
    /// Calls for polygons.
    polygon -> polygon::Polygon;
    /// Calls for rerouters.
    rerouter -> rerouter::Rerouter;
    /// Calls for routes.
    route -> route::Route;
    /// Calls for route probes.
    route_probe -> route_probe::RouteProbe;
    /// Calls for the simulation as a whole.
    simulation -> simulation::Simulation;
    /// Calls for traffic lights.
    traffic_light -> traffic_light::TrafficLight;
    /// Calls for variable speed signs.
    variable_speed_sign -> variable_speed_sign::VariableSpeedSign;
    /// Calls for vehicles.
    vehicle -> vehicle::Vehicle;
    /// Calls for vehicle types.
    vehicle_type -> vehicle_type::VehicleType;
}
