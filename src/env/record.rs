//! What is kept of a finished episode.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::driving::DrivingRecord;

/// Record of one finished episode.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct EpisodeRecord {
    /// Number of the episode in its seed stream.
    pub episode: u64,
    /// Steps from the first decision to the end of the episode.
    pub episode_length: u32,
    /// Share of agents that reached their goal; of vehicles, of those that arrived. See
    /// [`Self::success`] for episodes in which no agent counts.
    pub success: f64,
    /// Sum of the agents' own rewards over the episode, mean over agents; where slots change hands
    /// in an environment without vehicles, mean over slots.
    pub reward: f64,
    /// Metrics of vehicles; `None` in environments without them.
    #[serde(flatten, skip_serializing_if = "Option::is_none")]
    pub driving: Option<DrivingRecord>,
    /// Metrics that an environment defines by itself, by name
    /// ([`MultiAgentEnv::metrics`](super::MultiAgentEnv::metrics)).
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub own: BTreeMap<String, f64>,
    /// Whether the simulation broke off in the episode; such an episode does not count.
    pub interrupted: bool,
    /// Whether the episode repeats one that failed before ([`super::Stream::repeat_failed`]).
    #[serde(skip)]
    pub repeated: bool,
    /// Mean reward over agents in each step.
    #[serde(skip)]
    pub step_rewards: Vec<f32>,
}

impl EpisodeRecord {
    /// Returns the mean of the episodes' [`Self::success`]; `None` if no agent counts in any.
    pub fn mean_success<'a>(records: impl Iterator<Item = &'a Self>) -> Option<f64> {
        let known: Vec<f64> = records.filter_map(Self::success).collect();
        (!known.is_empty()).then(|| known.iter().sum::<f64>() / known.len() as f64)
    }

    /// Returns the share of agents that reached their goal; `None` if no agent counts.
    pub fn success(&self) -> Option<f64> {
        let undecided = self.driving.as_ref().is_some_and(|driving| driving.undecided);
        (!undecided).then_some(self.success)
    }

    /// Returns the metrics of vehicles.
    ///
    /// # Panics
    /// In environments without vehicles.
    pub fn driving(&self) -> &DrivingRecord {
        self.driving.as_ref().expect("an episode of vehicles")
    }
}
