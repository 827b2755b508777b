//! The observation of an agent: itself, and other vehicles in one of two ways or both, as the
//! scenario chooses.
//!
//! - `nearest`: the nearest vehicles in any direction (paper), nearest first or by bearing.
//! - `conflict`: the vehicle ahead and, for each route that crosses or merges with the agent's own,
//!   the vehicles next to the conflict point. The size of this description does not depend on the
//!   number of vehicles, and it is the same for every approach to an intersection.
//!
//! In addition, `encounters` describes one by one the vehicles that are ahead of the agent or whose
//! routes cross or merge with its own: for scenarios with many routes. Where agents change lanes, they
//! observe the gaps on the lanes beside them.
//!
//! All values are clipped to -1..=1. Padding tokens and the observations of absent agents are
//! zeros.
//!
//! Each feature group is a file with its constant `GROUP` and a place in [`GROUPS`].

mod borders;
mod ego;
pub mod encounter;
mod entry;
mod free;
pub mod group;
mod lanes;
mod leader;
mod lidar;
mod neighbour;
mod preview;
pub mod signals;
mod steering;
mod streams;

pub use group::{FeatureGroup, Scales, View, Writer};

/// The feature groups, in their order in the observation.
pub static GROUPS: &[FeatureGroup] = &[
    ego::GROUP,
    steering::GROUP,
    preview::GROUP,
    entry::GROUP,
    borders::GROUP,
    neighbour::GROUP,
    encounter::GROUP,
    free::GROUP,
    leader::GROUP,
    streams::GROUP,
    lidar::GROUP,
    signals::GROUP,
    lanes::GROUP,
];
