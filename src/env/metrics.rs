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
    /// Distinct pairs of overlapping boxes by our own test, of vehicles.
    pub own_collisions: u32,
    /// Distance that the agents drove, all together \[km\]; 0 in files of older versions.
    #[serde(default)]
    pub distance_km: f64,
    /// Crashes of agents: pairs of which at least one was an agent that was still driving. Two
    /// agents that collide are one crash; the other may also be a wreck, background traffic or a
    /// pedestrian.
    #[serde(default)]
    pub crashes: u32,
    /// Share of agents that loitered: slower than 3 m/s for more than 2 s in total, at most 15 m
    /// from their finish and with nobody ahead. 0 in files of older versions.
    #[serde(default)]
    pub loitering: f64,
    /// Where the two differ, and why.
    pub audit: Audit,
    /// Why agents did not arrive.
    pub failures: Failures,
    /// What vehicles met with that SUMO drove, in tasks that have some.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub others: Option<Others>,
    /// Cut short because SUMO died; not to be counted.
    pub interrupted: bool,
    /// It had been played before ([`super::VecOptions::replay`]).
    #[serde(skip)]
    pub replayed: bool,
    /// Mean reward over agents in each step.
    #[serde(skip)]
    pub step_rewards: Vec<f32>,
}

/// What the vehicles of an episode met with that SUMO drove, and the pedestrians, while agents were on the road.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Others {
    /// How many there were.
    pub vehicles: u32,
    /// Share that collided with an agent or a wreck.
    pub crash: f64,
    /// Time that each lost against driving as fast as its lane and type allow: SUMO's time loss, mean \[s\].
    pub delay: f64,
    /// Hardest braking of each, mean \[m/s²\].
    pub braking: f64,
    /// Share that had to brake harder than 6 m/s² at some time.
    pub hard_braking: f64,
    /// Share that an agent came closer to than 1.5 s in time to collision, or collided.
    pub close: f64,
    /// How many pedestrians there were; none of them is among the vehicles.
    #[serde(default)]
    pub pedestrians: u32,
    /// Share of the pedestrians that were hit by an agent or a wreck.
    #[serde(default)]
    pub pedestrian_crash: f64,
    /// Share of the pedestrians that an agent came closer to than 1.5 s in time to collision, or hit.
    #[serde(default)]
    pub pedestrian_close: f64,
    /// Smallest time to collision of any of them with an agent, if both went on as they did; 5 where it was never less, 0 after a collision \[s\].
    pub ttc: f64,
    /// Smallest post-encroachment time: from when the first of an agent and another left the place where their ways meet until the
    /// second came there; 5 where it was never less, 0 after a collision \[s\].
    pub pet: f64,
}
