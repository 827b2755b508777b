//! What learners and observers get to see of a world.

use rayon::prelude::*;

use super::agents::{Outcome, Slot, Status};
use super::geometry::{Pose, Size};
use super::intention::Knowledge;
use super::observation::View;
use super::task::Task;

/// What a world gives to agents and learners after an exchange. Reused from step to step.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// Observations, `[N, O]`; zeros where no agent is present.
    pub observation: Vec<f32>,
    /// Privileged states, `[N, S]`; zeros where no agent is present.
    pub state: Vec<f32>,
    /// Physical mask G_p, `[N, N]`: 1 where two agents are within the communication range and, if
    /// the scenario says so, no polygon lies between them. Its diagonal is 1 for the agents that are
    /// present.
    pub comm: Vec<f32>,
    /// `[N]`, 1 where an agent acts in the coming step.
    pub active: Vec<f32>,
    /// `[N]`, 1 where a slot's new trajectory starts with this frame, so that memories are cleared:
    /// in all slots with a new episode, and in the slot of an agent that departs later.
    pub start: Vec<f32>,
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

impl Frame {
    /// Returns the frame of a world without agents.
    pub(super) fn new(task: &Task) -> Self {
        let n = task.agents;
        let shares = task.scenario.reward.share_range.is_finite();
        Self {
            observation: vec![0.0; n * task.spec.observation.len()],
            state: vec![0.0; n * task.spec.state.len()],
            comm: vec![0.0; n * n],
            active: vec![0.0; n],
            start: vec![0.0; n],
            reward: vec![0.0; n],
            sharing: vec![0.0; if shares { n * n } else { 0 }],
            terminated: vec![0.0; n],
            truncated: vec![0.0; n],
            interrupted: false,
        }
    }

    /// Begins the frame after a respawn (`start`) or a step: nobody has ended yet.
    pub(super) fn begin(&mut self, start: bool) {
        self.start.fill(f32::from(u8::from(start)));
        self.terminated.fill(0.0);
        self.truncated.fill(0.0);
    }

    /// Writes the observations and privileged states of the agents that are `present`; `view` is
    /// that of any of them.
    pub(super) fn write_views(&mut self, task: &Task, view: &View<'_>, present: &[bool]) {
        let full = Knowledge::full(&task.map.routes, view.traffic);
        let write = |(slot, (seen, known)): (usize, (&mut [f32], &mut [f32]))| {
            if present[slot] {
                let view = View { slot, knowledge: view.knowledge.to(slot), ..*view };
                task.observation.write(&view, seen);
                task.state.write(&View { knowledge: full, ..view }, known);
            } else {
                seen.fill(0.0);
                known.fill(0.0);
            }
        };
        let (o, s) = (task.spec.observation.len(), task.spec.state.len());
        let looks = &task.scenario.observation;
        if looks.lidar.beams > 0 || looks.foresight > 0.0 || looks.priority_distance > 0.0 {
            let seen = self.observation.par_chunks_exact_mut(o);
            let views = seen.zip(self.state.par_chunks_exact_mut(s)).enumerate();
            // Fewer than 16 agents are not worth another core.
            views.with_min_len(16).for_each(write);
        } else {
            let seen = self.observation.chunks_exact_mut(o);
            seen.zip(self.state.chunks_exact_mut(s)).enumerate().for_each(write);
        }
    }

    /// Truncates all active agents because the simulation broke off.
    pub(super) fn interrupt(&mut self) {
        for (truncated, active) in self.truncated.iter_mut().zip(&mut self.active) {
            *truncated = *active;
            *active = 0.0;
        }
        self.reward.fill(0.0);
        self.terminated.fill(0.0);
        self.start.fill(0.0);
        self.interrupted = true;
    }
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
    /// Length and width of the vehicle \[m\].
    pub size: Size,
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

impl AgentView {
    pub(super) fn new(slot: &Slot, reward: f64) -> Self {
        Self {
            driving: slot.status == Status::Active,
            wreck: slot.status == Status::Wreck,
            outcome: slot.outcome,
            pose: slot.pose,
            size: slot.size,
            route: slot.route,
            position: slot.s,
            lateral: slot.lateral,
            speed: slot.speed,
            reward,
        }
    }
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

impl OtherView {
    pub(super) fn new(slot: &Slot) -> Self {
        Self {
            wreck: slot.status == Status::Wreck,
            pose: slot.pose,
            size: slot.size,
            route: slot.route,
            position: slot.s,
            speed: slot.speed,
        }
    }
}
