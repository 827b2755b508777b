//! What an episode amounts to (definitions of the paper's released evaluation, `driving_tasks`: success, safety, efficiency).

use serde::{Deserialize, Serialize};

use super::audit::Audit;
use super::failures::Failures;

/// One finished episode. Rates are fractions of the episode's N agents.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EpisodeRecord {
    /// Number of the episode in its seed stream.
    pub episode: u64,
    /// Steps from the first decision to the end.
    pub episode_length: u32,
    /// Share of agents that arrived.
    pub success: f64,
    /// Share of agents that neither crashed nor left the road.
    pub safety: f64,
    /// Share of agents that crashed.
    pub crash: f64,
    /// Share of agents that left the road.
    pub out_of_road: f64,
    /// Reward per agent, before any cooperative mix.
    pub reward: f64,
    /// (success − danger) · N / steps, agents per step.
    pub efficiency: f64,
    /// Distinct pairs in SUMO's collision report.
    pub sumo_collisions: u32,
    /// Distinct pairs of overlapping boxes by our own test.
    pub own_collisions: u32,
    /// Where the two differ, and why.
    pub audit: Audit,
    /// Why agents did not arrive.
    pub failures: Failures,
    /// Cut short because SUMO died; not to be counted.
    pub interrupted: bool,
    /// It had been played before ([`super::VecOptions::replay`]).
    #[serde(skip)]
    pub replayed: bool,
    /// Mean reward over agents in each step.
    #[serde(skip)]
    pub step_rewards: Vec<f32>,
}
