//! Metrics of an episode of vehicles. Success, safety and efficiency are defined as in the paper's
//! released evaluation (`driving_tasks`).

use serde::{Deserialize, Serialize};

use super::audit::Audit;
use super::failures::Failures;
use super::trips::FlowMetrics;

/// Metrics of one finished episode of vehicles. Shares are fractions of the episode's agents,
/// without those from route files that came too late to arrive (`trips.rs`).
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct DrivingRecord {
    /// Whether no agent counts, because all came too late to arrive. Shares of agents are then
    /// unknown: the fields contain 0, and 1 for `safety`.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub undecided: bool,
    /// Share of agents that neither crashed nor went off-road.
    pub safety: f64,
    /// Share of agents that crashed.
    pub crash: f64,
    /// Share of agents that went off-road.
    pub out_of_road: f64,
    /// Share of agents that neither arrived nor failed; 0 in files of older versions.
    #[serde(default)]
    pub unfinished: f64,
    /// Time that an agent took longer than it would alone, at full throttle from its departure
    /// time, mean over the agents from spawn places that arrived \[s\]; `None` if none did.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub delay: Option<f64>,
    /// (success − danger) · N / steps, in agents per step; danger is the share of agents that
    /// crashed or went off-road.
    pub efficiency: f64,
    /// Distinct colliding pairs with at least one agent in SUMO's report.
    pub sumo_collisions: u32,
    /// Distinct colliding pairs of vehicles with at least one agent by our own box test, without
    /// pedestrians.
    pub own_collisions: u32,
    /// Distance that all agents drove together \[km\]; 0 in files of older versions.
    #[serde(default)]
    pub distance_km: f64,
    /// Crashes of agents: colliding pairs with at least one agent that was still driving. Two
    /// agents that collide are one crash; the other party may also be a wreck, background traffic
    /// or a pedestrian.
    #[serde(default)]
    pub crashes: u32,
    /// Share of agents that loitered: slower than 3 m/s for more than 2 s in total, at most 15 m
    /// from their finish and with nobody ahead. 0 in files of older versions.
    #[serde(default)]
    pub loitering: f64,
    /// Red signals passed per agent; `None` in tasks without signals on their routes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub red_lights: Option<f64>,
    /// Where SUMO's report and our own box test differ, and why.
    pub audit: Audit,
    /// Why agents did not arrive.
    pub failures: Failures,
    /// Flow of the agents from route files; `None` in tasks without them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub flow: Option<FlowMetrics>,
    /// Effects on background traffic; `None` in tasks without background traffic.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub others: Option<BackgroundMetrics>,
}

/// Effects of an episode on background vehicles and pedestrians, while agents were on the road.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct BackgroundMetrics {
    /// Number of background vehicles.
    pub vehicles: u32,
    /// Share of the vehicles that collided with an agent or a wreck.
    pub crash: f64,
    /// Time that a vehicle loses against driving as fast as its lane and type allow (SUMO's time
    /// loss), mean over vehicles \[s\].
    pub delay: f64,
    /// Hardest braking of a vehicle, mean over vehicles \[m/s²\].
    pub braking: f64,
    /// Share of the vehicles that had to brake harder than 6 m/s² at some time.
    pub hard_braking: f64,
    /// Share of the vehicles with a time to collision with an agent below 1.5 s, or with a
    /// collision.
    pub close: f64,
    /// Number of pedestrians, who are not counted among the vehicles.
    #[serde(default)]
    pub pedestrians: u32,
    /// Share of the pedestrians that were hit by an agent or a wreck.
    #[serde(default)]
    pub pedestrian_crash: f64,
    /// Share of the pedestrians with a time to collision with an agent below 1.5 s, or that were
    /// hit.
    #[serde(default)]
    pub pedestrian_close: f64,
    /// Smallest time to collision of an agent with a background vehicle or pedestrian if both keep
    /// their headings and speeds \[s\]; 5 where it was never less, 0 after a collision; `None`
    /// without an agent.
    pub ttc: Option<f64>,
    /// Smallest post-encroachment time \[s\]: from when the first of an agent and a background
    /// vehicle or pedestrian leaves the conflict point of their routes until the second reaches it;
    /// 5 where it was never less, 0 after a collision; `None` without an agent.
    pub pet: Option<f64>,
}
