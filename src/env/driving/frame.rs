//! What learners and observers get to see of a world of vehicles.

use rayon::prelude::*;

use super::agents::{Outcome, Slot, Status};
use super::geometry::{Pose, Size};
use super::intention::Knowledge;
use super::observation::View;
use super::task::Task;
use crate::env::frame::Frame;

impl Frame {
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
pub struct BackgroundVehicle {
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

impl BackgroundVehicle {
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
