//! The task as data, read from `scenarios/<name>.xml` (schema: `scenarios/scenario.xsd`).
//!
//! Units are SI. A position on a lane is the position of the vehicle's **centre** unless a field
//! says otherwise.

mod advice;
mod attribute;
pub mod author;
mod check;
mod demand;
mod error;
mod finding;
mod fingerprint;
mod load;
mod model;
mod observation;
mod occlusion;
mod overrides;
mod places;
mod reader;
mod reference;
mod schema;
mod verify;
mod write;

pub use advice::without_effect;
pub use demand::{
    Demand, DemandPlan, DemandRoute, Finish, Halt, Itinerary, Laid, LeftOut, PlannedDeparture,
    PlannedSource, RouteEdge, Source, Spacing, Start, Terminal, VehicleKind, route_files,
};
pub use error::{Error, Place};
pub use finding::{Finding, Severity};
pub use model::{
    AgentRange, Border, Communication, Control, FileTime, Jitter, Kind as VehicleVariant,
    LaneChange, Reward, Route, Scenario, Steering, Termination, Traffic, Vehicle,
};
pub use observation::{Intention, Lidar, NeighbourOrder, Observation, ObservationGroups};
pub use occlusion::{Occlusion, Polygon};
pub use overrides::{Overridable, Override, Refused, ScenarioFile, cannot_override, overridable};
pub use places::{Net, PlaceDeparture, SpawnPlace, SpawnRow};
pub use reference::markdown;
pub use schema::{Attribute, Element, Kind, SCHEMA, describe};
pub use verify::Findings;
