//! An agent's trip.

use super::agents::{Crash, Outcome, Slot, Status};
use super::departure::Departure;
use super::loitering::Loitering;

/// An agent's trip.
#[derive(Debug, Clone, Copy)]
pub(super) struct Trip {
    pub(super) slot: usize,
    pub(super) route: usize,
    pub(super) outcome: Outcome,
    pub(super) crash: Option<Crash>,
    /// Whether the agent had neither arrived nor failed.
    pub(super) unfinished: bool,
    pub(super) loitered: bool,
    /// Steps that the agent took longer than alone; `None` if it did not arrive.
    pub(super) delay: Option<u32>,
    /// Number of red signals that the agent passed.
    pub(super) red_lights: u32,
    /// Step after which the agent was first on the road.
    pub(super) entered: u32,
    /// `None` for an agent that began at a spawn place.
    pub(super) departure: Option<Departure>,
}

impl Trip {
    /// Returns the trip of the agent in a slot after step number `step`.
    pub(super) fn of(slot: usize, agent: &Slot, loitering: &Loitering, step: u32) -> Self {
        let late = step.saturating_sub(agent.alone_arrival);
        Self {
            delay: (agent.outcome.arrived && agent.departure.is_none()).then_some(late),
            slot,
            route: agent.assigned,
            outcome: agent.outcome,
            crash: agent.crash,
            unfinished: agent.status == Status::Active || agent.is_waiting(),
            loitered: loitering.is_long(),
            red_lights: agent.red_lights,
            entered: agent.entered,
            departure: agent.departure,
        }
    }
}
