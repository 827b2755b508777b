//! The multi-agent environments: a scenario and SUMO as inputs; observations, rewards and masks as
//! outputs, in plain slices without tensors.
//!
//! - [`Task`]: a scenario prepared for a number of vehicles (net, routes, conflict points, feature
//!   lists).
//! - [`World`]: the traffic of one episode. It needs no simulator: it emits commands and takes in
//!   snapshots.
//! - [`VecEnv`]: many worlds in lock-step on the simulators that host them.

mod audit;
mod comm;
mod dynamics;
mod failures;
mod fcfs;
mod foresight;
mod geometry;
mod intention;
mod lidar;
mod loitering;
mod metrics;
mod observation;
mod order;
mod pursuit;
mod road;
mod routes;
mod slots;
mod state;
mod steering;
mod task;
mod vec;
mod world;

#[cfg(test)]
mod tests;

pub use audit::Audit;
pub use comm::physical_mask;
pub use dynamics::{acceleration, advance};
pub use failures::Failures;
pub use geometry::{Pose, Size, boxes_overlap};
pub use metrics::{BackgroundMetrics, EpisodeRecord};
pub use order::Position;
pub use routes::{Conflict, RouteGeometry};
pub use slots::Outcome;
pub use steering::Motion;
pub use task::{RoutePosition, Task};
pub use vec::{Resets, VecEnv, VecOptions};
pub use world::{AgentView, Driver, Frame, OtherView, Pursuit, World, WorldState};

use crate::{scenario, sumo};

/// What a learner must know about an environment. Only [`EnvSpec::agents`] depends on the number of
/// vehicles.
#[derive(Debug, Clone, PartialEq)]
pub struct EnvSpec {
    /// Number of agent slots N.
    pub agents: usize,
    /// The A dimensions of an action, each in -1..=1.
    pub actions: Vec<ActionDimension>,
    /// The O features of one agent's observation.
    pub observation: Features,
    /// The S features of the privileged state as seen from one agent.
    pub state: Features,
}

/// One dimension of the agents' actions, and the initial behaviour of an untrained policy in it.
#[derive(Debug, Clone, PartialEq)]
pub struct ActionDimension {
    /// Name, such as `throttle`.
    pub name: &'static str,
    /// Mean action of an untrained policy.
    pub initial_mean: f32,
    /// Factor on the scheduled standard deviation of the exploration noise.
    pub noise_scale: f32,
}

impl ActionDimension {
    /// Returns a dimension with an initial mean of 0 and the scheduled noise.
    pub const fn named(name: &'static str) -> Self {
        Self { name, initial_mean: 0.0, noise_scale: 1.0 }
    }
}

/// A vector of named features, in groups that attention encoders take as tokens.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Features {
    /// The features, in order.
    pub list: Vec<Feature>,
    /// Consecutive groups that cover the list.
    pub groups: Vec<Group>,
}

/// One number of an observation or a privileged state.
#[derive(Debug, Clone, PartialEq)]
pub struct Feature {
    /// Name, such as `neighbour_0.forward`.
    pub name: String,
    /// What one unit of the number means, such as `22.2 m/s`.
    pub unit: String,
    /// Smallest value.
    pub low: f32,
    /// Largest value.
    pub high: f32,
}

/// `count` tokens of `width` features each, starting at `offset`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Group {
    /// Name, such as `neighbour`.
    pub name: String,
    /// Index of the first feature.
    pub offset: usize,
    /// Features per token.
    pub width: usize,
    /// Number of tokens.
    pub count: usize,
    /// Index within the token of the feature that is 1 for a token that describes something and 0
    /// for padding; `None` for tokens without padding.
    pub presence: Option<usize>,
}

impl Features {
    /// Number of features.
    pub fn len(&self) -> usize {
        self.list.len()
    }

    /// Whether there are no features.
    pub fn is_empty(&self) -> bool {
        self.list.is_empty()
    }

    /// Returns these features followed by those of `other`.
    #[must_use]
    pub fn join(&self, other: &Self) -> Self {
        let mut joined = self.clone();
        let shift = self.len();
        joined.list.extend_from_slice(&other.list);
        joined.groups.extend(
            other
                .groups
                .iter()
                .map(|group| Group { offset: group.offset + shift, ..group.clone() }),
        );
        joined
    }

    /// Appends a group of `count` tokens with these `(name, unit, low, high)` features. A feature
    /// called `present` becomes the presence flag.
    fn push(&mut self, name: &str, count: usize, features: &[(&str, &str, f32, f32)]) {
        if count == 0 {
            return;
        }
        let presence = features.iter().position(|f| f.0 == "present");
        self.groups.push(Group {
            name: name.to_owned(),
            offset: self.len(),
            width: features.len(),
            count,
            presence,
        });
        for token in 0..count {
            for &(feature, unit, low, high) in features {
                let name = if count == 1 {
                    format!("{name}.{feature}")
                } else {
                    format!("{name}_{token}.{feature}")
                };
                self.list.push(Feature { name, unit: unit.to_owned(), low, high });
            }
        }
    }
}

/// Writes features one after the other into a slice, clipped to -1..=1.
struct Writer<'a> {
    out: &'a mut [f32],
    at: usize,
}

impl<'a> Writer<'a> {
    fn new(out: &'a mut [f32]) -> Self {
        Self { out, at: 0 }
    }

    fn put<const K: usize>(&mut self, values: [f64; K]) {
        for value in values {
            self.out[self.at] = value.clamp(-1.0, 1.0) as f32;
            self.at += 1;
        }
    }

    /// Returns the slice of the next `count` features, for another function to fill.
    fn take(&mut self, count: usize) -> &mut [f32] {
        self.at += count;
        &mut self.out[self.at - count..self.at]
    }

    fn skip(&mut self, count: usize) {
        self.out[self.at..self.at + count].fill(0.0);
        self.at += count;
    }
}

/// An error of an environment.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The scenario is invalid, or cannot have that many vehicles.
    #[error(transparent)]
    Scenario(#[from] scenario::Error),
    /// The net cannot be read, or its routes cannot be driven.
    #[error(transparent)]
    Net(#[from] sumo::net::NetError),
    /// Lanes and border lines of the net are together too long. They are needed where vehicles
    /// steer, have lidar or observe the road's borders.
    #[error(
        "{net}: lanes of {metres:.0} m and lines beside them are too much for steering control, which takes {limit:.0} m"
    )]
    Long {
        /// File of the net.
        net: String,
        /// Total length of lanes and lines \[m\].
        metres: f64,
        /// Greatest length allowed \[m\].
        limit: f64,
    },
    /// SUMO cannot be started, or failed again after it was renewed and before an episode ended.
    #[error("world {world}, episode {episode}, step {step}")]
    Sumo {
        /// World number.
        world: usize,
        /// Number of the episode of that world.
        episode: u64,
        /// Step of the episode.
        step: u32,
        /// The error of the simulator.
        source: sumo::Error,
    },
    /// SUMO died while the run's current episodes were played again to resume it.
    #[error("SUMO died while the run's episodes were played again to resume; try once more")]
    Replay,
    /// An episode cannot be played: SUMO dies or loses a vehicle in every attempt.
    #[error("the simulation broke off {times} times in episode {episode}; the warnings say why")]
    KeepsFailing {
        /// Number of the episode.
        episode: u64,
        /// Number of attempts.
        times: u32,
    },
    /// A worker panicked, which is a defect of this program.
    #[error("a worker panicked, which is a defect of this program: {message}")]
    Panicked {
        /// Message of the panic.
        message: String,
    },
    /// An agent's vehicle is not on the road.
    #[error(
        "slot {slot}: its vehicle is not on SUMO's roads at step {step} of an episode, on route `{route}` at {position:.1} m of \
         {length:.1} m; SUMO had no room at its spawn place, or its route ends before the arrival position"
    )]
    Vanished {
        /// The agent's slot.
        slot: usize,
        /// Name of the agent's route.
        route: String,
        /// Last known position of the vehicle's centre along the route \[m\].
        position: f64,
        /// Length of the route \[m\].
        length: f64,
        /// Step of the episode.
        step: u32,
    },
}

impl Error {
    /// Returns what the user can do about the error, where that is known.
    pub fn hint(&self) -> Option<String> {
        match self {
            Self::Scenario(e) => e.hint(),
            Self::Sumo { source, .. } => source.hint(),
            _ => None,
        }
    }
}
