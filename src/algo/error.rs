//! Errors of learners.

use super::{names, those_that};
use crate::nn;

/// Errors of a learner.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// No algorithm has this name.
    #[error("there is no algorithm `{name}`; choose one of {}", names().join(", "))]
    UnknownAlgorithm {
        /// The unknown name.
        name: String,
    },
    /// A method from outside of this crate says that its agents send messages.
    #[error(
        "{name}: `Networks::MESSAGES` is for methods of this crate, which pass their messages through a channel; agents of your method \
         can hear each other all the same: read the masks of who hears whom, and leave it false"
    )]
    OwnMessages {
        /// Name of the method.
        name: &'static str,
    },
    /// A method is to be registered under a name that another method has.
    #[error("there is a method called `{name}` already; give yours another `NAME`")]
    NameTaken {
        /// The name.
        name: &'static str,
    },
    /// Training diverged.
    #[error(
        "training diverged: {what} is not finite; try a lower ppo.learning_rate, and check the scale of observations and rewards"
    )]
    NonFinite {
        /// The quantity that is not finite.
        what: &'static str,
    },
    /// The caller gave up an update.
    #[error("the update was stopped")]
    Stopped,
    /// A stored state was trained with another number of agents, to which the algorithm is bound.
    #[error(
        "{algorithm} has parameters for each of {trained} agents and cannot be used with {agents}; use the same number of agents as \
         in its training (--agents, scenario.traffic.penetration), or choose a method for any number of agents: {}",
        those_that(|method| method.any_number)
    )]
    FixedAgents {
        /// Name of the algorithm.
        algorithm: &'static str,
        /// Number of agents of the stored state.
        trained: i64,
        /// Number of agents of the task.
        agents: i64,
    },
    /// A channel is set for an algorithm whose agents send no messages that it could disturb.
    #[error(
        "[channel] applies to messages that agents send at the same time and each receiver reads by itself; {algorithm} has none: omit [channel]"
    )]
    NoMessages {
        /// Name of the algorithm.
        algorithm: &'static str,
    },
    /// A method for continuous actions is to be trained where actions are discrete.
    #[error(
        "{algorithm} is for continuous actions only, and the environment's are discrete; choose one of {}",
        those_that(|method| method.discrete)
    )]
    Discrete {
        /// Name of the algorithm.
        algorithm: &'static str,
    },
    /// A policy cannot be trained with this channel.
    #[error("{why}")]
    Channel {
        /// The reason, and what to do.
        why: &'static str,
    },
    /// A stored state belongs to another network.
    #[error(transparent)]
    State(#[from] nn::Error),
}
