//! The multi-agent environments: observations, rewards and masks as outputs, in plain slices
//! without tensors.
//!
//! - [`EnvSpec`]: what a learner must know about an environment.
//! - `driving`: vehicles in SUMO. A [`Task`] is a scenario prepared for a number of vehicles; a
//!   [`World`] is the traffic of one episode, which needs no simulator: it emits commands and takes
//!   in snapshots; a [`VecEnv`] is many worlds in lock-step on the simulators that host them.
//! - `expert`: drivers without training ([`Pursuit`]).

mod driving;
mod expert;
mod spec;

pub use driving::{
    AgentView, Audit, BackgroundMetrics, Conflict, Driver, EpisodeRecord, Error, Failures,
    FlowMetrics, Frame, MAX_TIME_APART, Map, Motion, OtherView, Outcome, Pose, Position, Refused,
    Resets, RouteGeometry, RoutePosition, Size, Task, VecEnv, VecOptions, World, WorldState,
    acceleration, advance, boxes_overlap, physical_mask,
};
pub use expert::Pursuit;
pub use spec::{ActionDimension, EnvSpec, Feature, Features, Group};
