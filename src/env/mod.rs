//! The multi-agent environments: scenario and SUMO in, observations, rewards and masks out. Plain slices, no tensors.
//!
//! - [`Task`]: a scenario made ready (net, routes, conflict points, feature lists).
//! - [`World`]: one episode's traffic, without a simulator: commands out, snapshot in.
//! - [`VecEnv`]: many worlds in lock-step over the simulators that host them.

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
pub use metrics::{EpisodeRecord, Others};
pub use order::Position;
pub use routes::{Conflict, RouteGeometry};
pub use slots::Fate;
pub use steering::Motion;
pub use task::{Place, Task};
pub use vec::{Resets, VecEnv, VecOptions};
pub use world::{AgentView, Driver, Frame, OtherView, Pursuit, World, WorldState};

use crate::{scenario, sumo};

/// What a learner must know about an environment. Nothing but [`EnvSpec::agents`] depends on the number of vehicles.
#[derive(Debug, Clone, PartialEq)]
pub struct EnvSpec {
    /// Agent slots N.
    pub agents: usize,
    /// Dimensions of an action, A of them, each in -1..=1.
    pub actions: Vec<ActionDimension>,
    /// One agent's observation, O features.
    pub observation: Features,
    /// One agent's view of the privileged state, S features.
    pub state: Features,
}

/// One dimension of the agents' actions, and how an untrained policy begins in it.
#[derive(Debug, Clone, PartialEq)]
pub struct ActionDimension {
    /// Name, such as `throttle`.
    pub name: &'static str,
    /// Mean action of an untrained policy.
    pub initial_mean: f32,
    /// Factor on the scheduled standard deviation of the exploration noise.
    pub noise_scale: f32,
    /// Whether the noise may be correlated from step to step.
    pub correlated: bool,
}

impl ActionDimension {
    /// A dimension that begins at 0, with the scheduled noise, which may be correlated.
    pub const fn named(name: &'static str) -> Self {
        Self { name, initial_mean: 0.0, noise_scale: 1.0, correlated: true }
    }
}

/// A vector of named features, in groups that attention encoders take as tokens.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Features {
    /// In order.
    pub list: Vec<Feature>,
    /// Consecutive groups that cover the list.
    pub groups: Vec<Group>,
}

/// One number of an observation.
#[derive(Debug, Clone, PartialEq)]
pub struct Feature {
    /// Name, e.g. `neighbour_0.forward`.
    pub name: String,
    /// What one unit of the number means, e.g. `22.22 m/s`.
    pub unit: String,
    /// Smallest value.
    pub low: f32,
    /// Largest value.
    pub high: f32,
}

/// `count` tokens of `width` features each, starting at `offset`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Group {
    /// Name, e.g. `neighbours`.
    pub name: String,
    /// First feature.
    pub offset: usize,
    /// Features per token.
    pub width: usize,
    /// Tokens.
    pub count: usize,
    /// Feature of the token that is 1 when it describes something and 0 when it is padding; `None`: always there.
    pub presence: Option<usize>,
}

impl Features {
    /// Number of features.
    pub fn len(&self) -> usize {
        self.list.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.list.is_empty()
    }

    /// These features followed by others.
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

    /// Appends a group of `count` tokens with these `(name, unit, low, high)` features;
    /// a feature called `present` becomes the presence flag.
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

    /// The place of the next features, for someone else to write.
    fn take(&mut self, count: usize) -> &mut [f32] {
        self.at += count;
        &mut self.out[self.at - count..self.at]
    }

    fn skip(&mut self, count: usize) {
        self.out[self.at..self.at + count].fill(0.0);
        self.at += count;
    }
}

/// What can go wrong in an environment.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The scenario does not fit.
    #[error(transparent)]
    Scenario(#[from] scenario::Error),
    /// The net cannot be read or driven.
    #[error(transparent)]
    Net(#[from] sumo::net::NetError),
    /// Vehicles that steer need the net's lanes at hand, and there are too many.
    #[error(
        "{net}: lanes of {metres:.0} m and lines beside them are too much for steering control, which takes {limit:.0} m"
    )]
    Long {
        /// The net's file.
        net: String,
        /// Length of lanes and lines \[m\].
        metres: f64,
        /// Longest \[m\].
        limit: f64,
    },
    /// SUMO failed and a fresh one did too.
    #[error("world {world}, episode {episode}, step {step}")]
    Sumo {
        /// World number.
        world: usize,
        /// Episode number of that world.
        episode: u64,
        /// Step of the episode.
        step: u32,
        /// What happened.
        source: sumo::Error,
    },
    /// SUMO died while the episodes of a run were played again.
    #[error("SUMO died while the run's episodes were played again to resume; try once more")]
    Replay,
    /// An episode cannot be played: SUMO dies in it, or loses a vehicle, again and again.
    #[error("the simulation broke off {times} times in episode {episode}; the warnings say why")]
    Doomed {
        /// The episode.
        episode: u64,
        /// How often.
        times: u32,
    },
    /// A defect of this program.
    #[error("a worker panicked, which is a defect of this program: {message}")]
    Panicked {
        /// What the panic said.
        message: String,
    },
    /// A vehicle under control is not on the road.
    #[error(
        "slot {slot}: its vehicle is not on SUMO's roads at step {step} of an episode, on route `{route}` at {position:.1} m of \
         {length:.1} m; SUMO had no room at its spawn place, or its route ends before the arrival position"
    )]
    Vanished {
        /// The slot.
        slot: usize,
        /// Its route.
        route: String,
        /// Where its centre was last seen on it \[m\].
        position: f64,
        /// The route's length \[m\].
        length: f64,
        /// Step of the episode.
        step: u32,
    },
}

impl Error {
    /// What the user can do about it.
    pub fn hint(&self) -> Option<String> {
        match self {
            Self::Scenario(e) => e.hint(),
            Self::Sumo { source, .. } => source.hint(),
            _ => None,
        }
    }
}
