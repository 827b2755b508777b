//! The multi-agent environments: observations, rewards and masks as outputs, in plain slices
//! without tensors.
//!
//! - [`EnvSpec`]: what a learner must know about an environment.
//! - [`Environment`] and [`Worlds`]: what learners and evaluations use. They know no other.
//! - [`MultiAgentEnv`]: a world of your own, of which [`Simple`] makes an environment.
//! - [`NamedEnvironment`]: environments without SUMO by name: those that come along (the traffic
//!   junction, and the tasks of `robotarium` and `quadruped`), and yours ([`register`]).
//! - `driving`: vehicles in SUMO. A [`Task`] is a scenario prepared for a number of vehicles; a
//!   [`World`] is the traffic of one episode, which needs no simulator: it emits commands and takes
//!   in snapshots; a [`VecEnv`] is many worlds in lock-step on the simulators that host them.
//! - `expert`: drivers without training ([`Pursuit`]).

mod driving;
mod environment;
mod episode;
mod error;
mod expert;
mod frame;
mod junction;
mod multi_agent;
mod named;
mod order;
mod picture;
mod quadruped;
mod record;
mod robotarium;
mod spec;

pub use driving::{
    AgentView, Audit, BackgroundMetrics, BackgroundVehicle, Conflict, Driver, DrivingRecord,
    Failures, FlowMetrics, MAX_TIME_APART, Map, Motion, Outcome, Pose, Refused, Resets,
    RouteGeometry, RoutePosition, Size, Task, Traffic, VecEnv, VecOptions, World, acceleration,
    advance, boxes_overlap, physical_mask,
};
pub use environment::{Environment, Stream, WorldPhase, WorldView, Worlds};
pub use episode::WorldState;
pub use error::Error;
pub use expert::Pursuit;
pub use frame::Frame;
pub use junction::{JunctionSize, TrafficJunction};
pub use multi_agent::{MultiAgentEnv, Simple};
pub use named::{NamedEnvironment, register};
pub use order::Position;
pub use picture::{Backdrop, Figure, FigureStatus, Lane, Picture, SignalPlace, Zone};
pub use quadruped::{GateSurrogate, SheepSurrogate};
pub use record::EpisodeRecord;
pub use robotarium::{Navigation, Transport};
pub use spec::{
    ActionDimension, ActionSpace, Better, Described, EnvSpec, Feature, Features, Group, OwnMetric,
    Values, names_differ,
};
