//! Loitering: an agent crawls or stands just before its finish although nobody is in its way.
//!
//! A policy that earns something for being on the road may learn to wait in front of its finish.
//! Such an agent is safe and arrives at last, so that success, safety and crashes say nothing about
//! it.

use super::geometry::{Pose, Size, boxes_overlap};
use super::slots::{Slot, Status};
use super::task::Task;

/// An agent loiters only at most this far before or behind its finish, centre to line \[m\].
const NEAR: f64 = 15.0;
/// An agent that is at least this fast does not loiter \[m/s\].
const SLOW: f64 = 3.0;
/// An agent has loitered once the time that it was slow, near and free adds up to more than this
/// \[s\].
const LONGEST: f64 = 2.0;
/// An agent has started to move once it was faster than this \[m/s\].
const MOVING: f64 = 0.1;
/// Distance between the places on the rest of the way at which a body is looked for \[m\].
const SPACING: f64 = 1.0;

/// How long an agent has loitered in its episode.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Loitering {
    /// Whether the agent has moved since its spawn. Until then nothing counts, since some agents
    /// begin close to their finish, at a standstill.
    pub(super) has_moved: bool,
    /// Time for which the agent was slow, near its finish and had nobody ahead \[s\].
    pub(super) time: f64,
}

impl Loitering {
    /// Whether the agent has loitered for longer than a stop may take.
    pub(super) fn is_long(&self) -> bool {
        // Sums of steps of 0.1 s are a little off.
        self.time > LONGEST + 1e-6
    }
}

/// Adds a step to the time of every agent that loiters in it.
pub(super) fn watch(task: &Task, slots: &mut [Slot]) {
    for agent in 0..task.agents {
        let own = &slots[agent];
        if own.status != Status::Active {
            continue;
        }
        let has_moved = own.loitering.has_moved || own.speed.abs() > MOVING;
        let slow = has_moved && own.speed.abs() < SLOW;
        let near = (task.routes[own.route].arrival - own.s).abs() <= NEAR;
        let loiters = slow && near && !is_anyone_ahead(task, slots, agent);
        let loitering = &mut slots[agent].loitering;
        loitering.has_moved = has_moved;
        if loiters {
            loitering.time += task.scenario.control.interval;
        }
    }
}

/// Whether a vehicle, a wreck or a pedestrian is on the rest of the agent's way to its finish: on
/// the lanes that both use, or with its body where the agent's body has to pass.
fn is_anyone_ahead(task: &Task, slots: &[Slot], agent: usize) -> bool {
    let own = &slots[agent];
    let route = &task.routes[own.route];
    let end = route.arrival + own.size[0] / 2.0;
    let places: Vec<Pose> = places_to_finish(task, own).collect();
    slots.iter().enumerate().any(|(j, other)| {
        let there = j != agent && other.departed && other.status != Status::Empty;
        let reach = NEAR + own.size[0] + other.size[0];
        if !there || own.pose.distance(&other.pose) > reach {
            return false;
        }
        let shared = route.shared_position(other.route, other.s);
        let on_way = shared.is_some_and(|s| s > own.s && s - other.size[0] / 2.0 < end);
        on_way || places.iter().any(|place| touches((place, own.size), other))
    })
}

fn touches((pose, size): (&Pose, Size), other: &Slot) -> bool {
    boxes_overlap((pose, size), (&other.pose, other.size))
}

/// The agent's poses on the rest of its way, as far beside the centre line as it is now.
fn places_to_finish<'a>(task: &'a Task, own: &'a Slot) -> impl Iterator<Item = Pose> + 'a {
    let route = &task.routes[own.route];
    let steps = ((route.arrival - own.s).max(0.0) / SPACING).ceil() as u32;
    (1..=steps).map(move |k| {
        let (point, heading) = route.path.at((own.s + f64::from(k) * SPACING).min(route.arrival));
        Pose::beside(point, heading, own.lateral)
    })
}
