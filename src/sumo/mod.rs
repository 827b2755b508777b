//! The interface to SUMO: the TraCI client ([`Client`], [`Batch`], the calls in [`domain`]), its
//! wire format ([`codec`], [`reply`]), the SUMO process ([`process`]) and SUMO's net files
//! ([`net`]). The rest of the program controls SUMO only through the trait [`Simulation`].
//! [`start`] starts a simulation with a [`Backend`], and [`Hosting`] distributes the worlds over
//! SUMO processes.

pub mod batch;
pub mod client;
pub mod codec;
pub mod constants;
pub mod domain;
mod error;
mod fleet;
#[cfg(test)]
mod fuzz;
mod hosting;
#[cfg(feature = "libsumo")]
mod libsumo;
pub mod net;
pub mod process;
pub mod replies;
pub mod reply;
mod simulation;
mod traci;
mod value;
mod variable;

pub use batch::{Batch, CallResult};
pub use client::{Client, ClientBatch, Version};
pub use codec::Value;
pub use constants::Domain;
pub use domain::{Scope, Ticket};
pub use error::Error;
pub use hosting::{Backend, Choice, Hosting, arguments, start, usable};
#[cfg(feature = "libsumo")]
pub use libsumo::{LibsumoModule, LibsumoSimulation};
pub use process::{Installation, also_look_in, find_program};
pub use replies::{Replies, Reports, StepReply};
pub use simulation::{
    BackgroundTraffic, Body, Collision, Command, Departure, Dropped, Meter, Renewal, Route,
    RouteStop, Simulation, SimulationConfig, Snapshot, TrafficLightState, VehicleState,
    VehicleType,
};
pub use traci::TraciSimulation;
pub use value::FromValue;
pub use variable::{Variable, VariableId, VariableWith};
