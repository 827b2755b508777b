//! What learners and observers get to see of a world.

use crate::env::geometry::{Pose, Size};
use crate::env::slots::Outcome;

/// What a world gives to agents and learners after an exchange. Reused from step to step.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// Observations, `[N, O]`; zeros where no agent is present.
    pub observation: Vec<f32>,
    /// Privileged states, `[N, S]`; zeros where no agent is present.
    pub state: Vec<f32>,
    /// Physical mask G_p, `[N, N]`. Its diagonal is 1 for the agents that are present.
    pub comm: Vec<f32>,
    /// `[N]`, 1 where an agent acts in the coming step.
    pub active: Vec<f32>,
    /// Whether a new episode starts with this frame, so that memories are cleared.
    pub start: bool,
    /// `[N]`, each agent's own reward of the last step.
    pub reward: Vec<f32>,
    /// Which agents share in each other's advantages, `[N, N]`: 1 where they are no further apart
    /// than the scenario's share range. Empty if the scenario has no share range and all agents
    /// share.
    pub sharing: Vec<f32>,
    /// `[N]`, 1 where the last step ended an agent's trajectory by arrival or failure.
    pub terminated: Vec<f32>,
    /// `[N]`, 1 where the last step truncated an agent's trajectory: at the horizon, or because
    /// the simulation broke off.
    pub truncated: Vec<f32>,
    /// Whether the simulation broke off in the last step.
    pub interrupted: bool,
}

/// An agent as an observer sees it.
#[derive(Debug, Clone, Copy)]
pub struct AgentView {
    /// Whether the agent is driving.
    pub driving: bool,
    /// Whether the agent's vehicle is a wreck on the road.
    pub wreck: bool,
    /// How the episode has ended for the agent.
    pub outcome: Outcome,
    /// Pose of the vehicle's centre; the last one if the vehicle is gone.
    pub pose: Pose,
    /// Index of the agent's route.
    pub route: usize,
    /// Position of the centre along the route \[m\].
    pub position: f64,
    /// Offset from the route's path, positive to the left \[m\].
    pub lateral: f64,
    /// Forward speed, negative backwards \[m/s\].
    pub speed: f64,
    /// The agent's own reward of the last step.
    pub reward: f64,
}

/// A background vehicle as an observer sees it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OtherView {
    /// Whether the vehicle is a wreck.
    pub wreck: bool,
    /// Pose of the vehicle's centre.
    pub pose: Pose,
    /// Length and width \[m\].
    pub size: Size,
    /// Index of the vehicle's route.
    pub route: usize,
    /// Position of the centre along the route \[m\].
    pub position: f64,
    /// Forward speed \[m/s\].
    pub speed: f64,
}
