//! Everything that knows SUMO: its wire ([`codec`], [`batch`], [`client`], [`reply`]), its process ([`process`]),
//! its net files ([`net`]), and the boundary behind which all of that lies for the rest of the program
//! ([`Simulation`], served by [`TraciSimulation`]).

pub mod batch;
pub mod client;
pub mod codec;
pub mod constants;
mod error;
#[cfg(test)]
mod fuzz;
pub mod net;
pub mod process;
pub mod reply;
mod simulation;
mod traci;

pub use batch::{Batch, Departure, Outcome};
pub use client::{Client, Version};
pub use codec::Value;
pub use error::Error;
pub use process::{find_sumo, sumo_version, traci_version};
pub use simulation::{Collision, Command, Route, Simulation, SimulationConfig, Snapshot, VehicleState, VehicleType};
pub use traci::TraciSimulation;
