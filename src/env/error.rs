//! Errors of the driving environment.

use crate::{scenario, sumo};

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
    /// The policy that drives the vehicles cannot choose an action.
    #[error("the policy cannot choose an action: {0}")]
    Policy(String),
    /// A world of an environment of one's own did something that learners cannot use.
    #[error("episode {episode}, step {step}: {what}")]
    Own {
        /// Number of the episode.
        episode: u64,
        /// Step of the episode.
        step: u32,
        /// The agent, and what is wrong.
        what: String,
    },
    /// An application registers an environment under a name that cannot be used.
    #[error("an environment cannot be called `{name}`: {why}")]
    Name {
        /// The name.
        name: String,
        /// Why not.
        why: String,
    },
    /// Another process of the same training cannot go on.
    #[error("process {rank} of this training: {what}")]
    Rank {
        /// Number of the process.
        rank: usize,
        /// Its error.
        what: String,
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
    /// Returns the message of a panic.
    pub(super) fn text_of(panic: &(dyn std::any::Any + Send)) -> String {
        let text = panic.downcast_ref::<&str>().map(ToString::to_string);
        text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_default()
    }

    /// Returns what the user can do about the error, where that is known.
    pub fn hint(&self) -> Option<String> {
        match self {
            Self::Scenario(e) => e.hint(),
            Self::Sumo { source, .. } => source.hint(),
            _ => None,
        }
    }
}
