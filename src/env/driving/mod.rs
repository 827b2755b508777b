//! Driving on SUMO's roads: what the net says ([`Map`]), what an agent observes (`layout` and
//! `observation`), and the stages of a world's step, which [`World`] puts in order.

pub(super) mod agents;
mod area;
mod audit;
mod background;
mod collisions;
mod comm;
mod conflicts;
mod departure;
mod detour;
mod effects;

mod failures;
mod finish;
mod foresight;
mod forks;
mod frame;
pub(super) mod geometry;
pub(super) mod intention;
pub(crate) mod lane_routes;
mod layout;
mod levels;
mod loitering;
mod map;
mod metrics;
mod motion;
mod observation;
mod occlusion;

mod refusals;
mod reward;
pub(super) mod right_of_way;
mod road;
mod routes;
mod shared;
mod signals;
mod spawn;
mod state;
mod surface;
pub(super) mod task;
mod traffic;
mod trip;
mod trips;
mod vec;
mod vehicle;
pub(super) mod world;

#[cfg(test)]
pub(super) mod tests;

pub use agents::Outcome;
pub use audit::Audit;
pub use comm::physical_mask;
pub use effects::MAX_TIME_APART;

pub use failures::Failures;
pub use frame::{AgentView, BackgroundVehicle};
pub use geometry::{Pose, Size, boxes_overlap};
pub use map::{Map, RoutePosition};
pub use metrics::{BackgroundMetrics, DrivingRecord};

pub use refusals::Refused;
pub use routes::{Conflict, OpposingStretch, RouteGeometry};
pub use task::{Driver, Task};
pub use traffic::Traffic;
pub use trips::FlowMetrics;
pub use vec::{Resets, VecEnv, VecOptions};
pub use vehicle::longitudinal::{acceleration, advance};
pub use vehicle::tyres::Motion;
pub use world::World;
