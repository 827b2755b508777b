//! Loitering: an agent crawls or stands just before its finish although nobody is in its way.
//!
//! A policy that is rewarded for being on the road may learn to wait in front of its finish. Such
//! an agent is safe and arrives in the end, so success, safety and crashes do not reveal it.

use super::agents::{Slot, Status};
use super::geometry::{Pose, boxes_overlap};
use super::map::Map;
use super::routes::RouteGeometry;

/// Largest distance from an agent's centre to its finish line, on either side, at which it can
/// loiter \[m\].
const NEAR: f64 = 15.0;
/// Speed from which an agent does not loiter \[m/s\].
const SLOW: f64 = 3.0;
/// An agent has loitered once the time for which it was slow, near its finish and had nobody ahead
/// exceeds this \[s\].
const LONGEST: f64 = 2.0;
/// Speed above which an agent has started to move \[m/s\].
const MOVING: f64 = 0.1;
/// Spacing of the poses on the rest of an agent's path that are tested for overlap with other
/// bodies \[m\].
const SPACING: f64 = 1.0;

/// How long an agent has loitered in its episode.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Loitering {
    /// Whether the agent has moved since its spawn. Until then no time counts, since some agents
    /// begin at a standstill close to their finish.
    pub(super) has_moved: bool,
    /// Time for which the agent was slow, near its finish and had nobody ahead \[s\].
    pub(super) time: f64,
}

impl Loitering {
    /// Whether the agent has loitered for longer than [`LONGEST`], the time that a stop may take.
    pub(super) fn is_long(&self) -> bool {
        // Sums of steps of 0.1 s are inexact.
        self.time > LONGEST + 1e-6
    }
}

/// Adds one step of `interval` seconds to the loitering time of every agent that loiters in it.
/// `agents` are those of the first slots.
pub(super) fn watch(map: &Map, interval: f64, slots: &[Slot], agents: &mut [Loitering]) {
    for (agent, loitering) in agents.iter_mut().enumerate() {
        let own = &slots[agent];
        if own.status != Status::Active {
            continue;
        }
        loitering.has_moved |= own.speed.abs() > MOVING;
        let slow = loitering.has_moved && own.speed.abs() < SLOW;
        let route = &map.routes[own.route];
        let finish = own.finish(map);
        let near = (finish - own.s).abs() <= NEAR;
        if slow && near && !is_anyone_ahead(route, finish, slots, agent) {
            loitering.time += interval;
        }
    }
}

/// Whether a vehicle, a wreck or a pedestrian is on the rest of the agent's path to its `finish`: on
/// a lane that both routes use, or with its body where the agent's body has to pass.
fn is_anyone_ahead(route: &RouteGeometry, finish: f64, slots: &[Slot], agent: usize) -> bool {
    let own = &slots[agent];
    let end = finish + own.size[0] / 2.0;
    slots.iter().enumerate().any(|(j, other)| {
        let there = j != agent && other.departed && other.status != Status::Empty;
        let reach = NEAR + own.size[0] + other.size[0];
        if !there || own.pose.distance(&other.pose) > reach {
            return false;
        }
        let gap = route.gap_to(own.s, other.route, other.s);
        let on_path = gap.is_some_and(|gap| own.s + gap - other.size[0] / 2.0 < end);
        let body = (&other.pose, other.size);
        let lengths = own.size[0] + other.size[0];
        on_path
            || !route.passes_over(own.s, other.route, other.s, lengths)
                && poses_to_finish(route, finish, own)
                    .any(|pose| boxes_overlap((&pose, own.size), body))
    })
}

/// Returns the agent's poses on the rest of its path, at its present lateral offset.
fn poses_to_finish(route: &RouteGeometry, finish: f64, own: &Slot) -> impl Iterator<Item = Pose> {
    let steps = ((finish - own.s).max(0.0) / SPACING).ceil() as u32;
    (1..=steps).map(move |k| {
        let (point, heading) = route.path.at((own.s + f64::from(k) * SPACING).min(finish));
        Pose::beside(point, heading, own.lateral)
    })
}
