//! What learners and onlookers see of a world.

use crate::env::geometry::{Pose, Size};
use crate::env::slots::Fate;

/// What agents and learners get from a world after an exchange. Reused from step to step.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// `[N, O]`; zeros where no agent is present.
    pub observation: Vec<f32>,
    /// `[N, S]`; zeros where no agent is present.
    pub state: Vec<f32>,
    /// Physical mask G_p, `[N, N]`; its diagonal tells who is present.
    pub comm: Vec<f32>,
    /// `[N]`, 1 where an agent acts in the coming step.
    pub active: Vec<f32>,
    /// Whether a new trajectory starts here (memories are cleared).
    pub start: bool,
    /// `[N]`: each agent's own reward of the last step.
    pub reward: Vec<f32>,
    /// Which agents share in each other's advantages, `[N, N]`: 1 where they are no further apart
    /// than the scenario's share range; empty where it has none, and all agents share.
    pub sharing: Vec<f32>,
    /// `[N]`, 1 where the last step ended an agent's trajectory for good.
    pub terminated: Vec<f32>,
    /// `[N]`, 1 where the last step truncated an agent's trajectory: at the horizon, or because the
    /// simulation broke off.
    pub truncated: Vec<f32>,
    /// Whether the simulation broke off in the last step.
    pub interrupted: bool,
}

/// An agent as an onlooker sees it.
#[derive(Debug, Clone, Copy)]
pub struct AgentView {
    /// Whether it drives.
    pub driving: bool,
    /// Whether it stands there as a wreck.
    pub wreck: bool,
    /// How it ended.
    pub fate: Fate,
    /// Of its centre, the last one where it is gone.
    pub pose: Pose,
    /// Its route's number.
    pub route: usize,
    /// Position of its centre along that \[m\].
    pub position: f64,
    /// Offset from the route's centre line, positive to the left \[m\].
    pub lateral: f64,
    /// \[m/s\]
    pub speed: f64,
    /// Its own reward of the last step.
    pub reward: f64,
}

/// A vehicle that SUMO drives, as an onlooker sees it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OtherView {
    /// Whether it stands there as a wreck.
    pub wreck: bool,
    /// Of its centre.
    pub pose: Pose,
    /// Length and width.
    pub size: Size,
    /// Its route's number.
    pub route: usize,
    /// Position of its centre along that \[m\].
    pub position: f64,
    /// \[m/s\]
    pub speed: f64,
}
