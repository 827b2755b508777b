//! Where the work of a training is done, in words.

#![cfg(feature = "learn")]

use crate::config::{Config, TaskSource};
use crate::words::counted;

/// Describes the worlds and their SUMOs in words, in a training of so many processes.
pub(super) fn worlds_of(config: &Config, place: &TaskSource, processes: usize) -> String {
    let (hosting, all) = (config.hosting(), config.train.envs);
    let worlds = all.div_ceil(processes);
    let own = match place {
        TaskSource::Scenario(_) if is_mixed(config, place) => {
            hosting.alone(worlds).describe(worlds)
        }
        TaskSource::Scenario(_) => hosting.describe(worlds),
        TaskSource::Environment(_) => format!("{} without SUMO", counted(worlds, "world")),
    };
    if processes == 1 {
        return own;
    }
    let most = if all.is_multiple_of(processes) { "" } else { "at most " };
    format!("{}, in each of {processes} processes {most}{own}", counted(all, "world"))
}

/// Returns whether there is background traffic, which needs a SUMO per world.
pub(super) fn is_mixed(config: &Config, place: &TaskSource) -> bool {
    place.scenario().is_some_and(|scenario| scenario.traffic.is_mixed(config.agents))
}

/// Describes how updates are divided.
pub(super) fn update_of(config: &Config) -> String {
    let ppo = &config.learner.ppo;
    let shards = if config.reads("ppo.shards") {
        format!(" in {}", counted(ppo.shards, "shard"))
    } else {
        String::new()
    };
    format!("minibatches of {} samples{shards} on {}", ppo.minibatch, String::from(config.device))
}
