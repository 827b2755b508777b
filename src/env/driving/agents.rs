//! The vehicle slots of a world and the relations between their vehicles, from which observations
//! and rewards are made.
//!
//! The agents' slots come first, then those of background traffic. An agent's slot is *empty*,
//! then *active* (an agent drives), then either empty again (the agent has arrived) or a *wreck*
//! (the agent has crashed or is off-road), which is an obstacle for a while before the slot is
//! empty. A slot becomes active again in the same episode only with an agent from a route file, whose
//! first frame may follow the last one of the vehicle before.

use nalgebra::Vector2;

use super::departure::Departure;
use super::geometry::{Pose, Size, Stance};
use super::occlusion::Walls;
use super::vehicle::tyres::Motion;
use crate::sumo::net::Aspect;

/// A vehicle whose centre is more than this far past a conflict point counts as having left it
/// \[m\]. Vehicles of up to 12 m have then left it with their whole bodies; for longer ones see
/// [`cleared`].
pub(crate) const CLEARED: f64 = 7.0;

/// Returns how far the centre of a vehicle of size `other` has to be past a conflict point until the
/// vehicle has left it with its whole body for a vehicle of size `own`: at least [`CLEARED`] \[m\].
pub(crate) fn cleared(own: Size, other: Size) -> f64 {
    CLEARED.max(f64::midpoint(other[0], own[1]))
}

/// What a slot holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) enum Status {
    #[default]
    Empty,
    Active,
    Wreck,
}

/// Where SUMO has an agent that steers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) enum Track {
    /// On its route.
    #[default]
    Route,
    /// The vehicle has been beside its route, or over a junction, so that SUMO may have given it
    /// another route, or have it on no lane.
    Astray,
}

/// A slot and its vehicle; empty by default.
#[derive(Debug, Clone, Default)]
pub(crate) struct Slot {
    pub(crate) status: Status,
    pub(crate) route: usize,
    /// Length and width \[m\].
    pub(crate) size: Size,
    /// Pose of the centre.
    pub(crate) pose: Pose,
    /// Pose of the centre one step before.
    pub(crate) before: Pose,
    /// Position of the centre along the route \[m\].
    pub(crate) s: f64,
    /// The same one step before, on the present route \[m\].
    pub(crate) s_before: f64,
    /// Forward speed, negative backwards \[m/s\].
    pub(crate) speed: f64,
    /// Offset from the route's path, positive to the left \[m\].
    pub(crate) lateral: f64,
    /// Last throttle, -1 to 1.
    pub(crate) action: f64,
    /// Last steering command, -1 to 1 (left); 0 for a vehicle that does not steer.
    pub(crate) steer: f64,
    /// Pose, velocity and yaw rate of a vehicle that steers, from which its motion is computed.
    pub(crate) motion: Motion,
    /// Segment of the route's path on which the vehicle was last.
    pub(crate) segment: usize,
    /// Whether SUMO has been given the vehicle and not yet been told to remove it.
    pub(crate) added: bool,
    /// Where SUMO has the vehicle, if it steers.
    pub(crate) track: Track,
    /// Pose that SUMO was last given for a vehicle that steers, with the speed that went with
    /// it \[m/s\].
    pub(crate) sent: Option<(Pose, f64)>,
    /// How far along its route SUMO has the front of a vehicle that steers, as a sum of SUMO's
    /// lane lengths \[m\]; `None` where SUMO may have the vehicle elsewhere.
    pub(crate) held: Option<f64>,
    /// Whether SUMO has put the vehicle on the road.
    pub(crate) departed: bool,
    /// Steps since the one in which SUMO put the vehicle on the road, after the others had moved.
    pub(crate) age: u32,
    /// Step after which the agent was first on the road; 0 for one that starts with the episode.
    pub(crate) entered: u32,
    /// Step in which an agent from a spawn place would arrive if it departed in time and nobody else
    /// were there, at full throttle.
    pub(crate) alone_arrival: u32,
    /// How an agent from a route file departed; `None` for all other vehicles.
    pub(crate) departure: Option<Departure>,
    /// Steps for which a wreck remains.
    pub(crate) wreck_steps: u32,
    /// Priority: vehicles with a smaller number came near a conflict point earlier. 0: the vehicle
    /// has not come near one yet.
    pub(crate) priority: u32,
    /// Group of the route's conflicts for which the vehicle has its priority.
    pub(crate) conflict_group: usize,
    /// Route that the vehicle was given; `route` is the one along the lane that it is on.
    pub(crate) assigned: usize,
    /// Lane that SUMO last reported for a background vehicle, or for an agent that may change lanes,
    /// as an index into the net's lanes.
    pub(crate) lane: Option<u32>,
    /// Number of stop lines of its route that an agent has passed, or had behind it from the start.
    pub(crate) lines_passed: usize,
    /// Stop line before which the agent has stood last, by the number of lines of its route that it
    /// had passed then.
    pub(crate) stood_at: Option<usize>,
    /// Whether the agent passed a red signal in the last step.
    pub(crate) ran_red: bool,
    /// Number of steps in which the agent passed a red signal.
    pub(crate) red_lights: u32,
    /// The signal that the vehicle comes to next.
    pub(crate) next_signal: Option<NextSignal>,
    /// Steps for which an agent keeps its lane after a lane change.
    pub(crate) lane_steps: u32,
    /// Kind of an agent's vehicle, an index into the task's abilities.
    pub(crate) kind: usize,
    /// SUMO's vehicle class of an agent.
    pub(crate) class: &'static str,
    /// How the agent's episode has ended.
    pub(crate) outcome: Outcome,
    /// The agent's first crash.
    pub(crate) crash: Option<Crash>,
}

impl Slot {
    /// Whether a vehicle can be put into the slot.
    pub(super) fn is_free(&self) -> bool {
        self.status == Status::Empty && !self.added
    }

    /// Whether SUMO has been given the agent and has not yet put the vehicle on the road.
    pub(super) fn is_waiting(&self) -> bool {
        self.status == Status::Empty && self.added && !self.departed
    }
}

/// The signal that a vehicle comes to next.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct NextSignal {
    /// Distance from the vehicle's front to the stop line \[m\].
    pub(crate) distance: f64,
    /// What the signal says.
    pub(crate) aspect: Aspect,
    /// Time until the signal says something else \[s\], infinite if it never does; `None` if the
    /// program is not static.
    pub(crate) to_change: Option<f64>,
}

/// How an agent crashed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Crash {
    /// Route of the vehicle that the agent overlapped with in the step of the crash; the one with
    /// the lowest slot if there are several.
    pub(crate) other: usize,
    /// Whether one of the two vehicles was ahead of the other on the other's route.
    pub(crate) same_path: bool,
    /// Whether the other vehicle was already a wreck.
    pub(crate) wreck: bool,
    pub(crate) step: u32,
    /// Speed of the agent \[m/s\].
    pub(crate) speed: f64,
    /// Whether the agent was more than 6 m before the first conflict point of its route.
    pub(crate) upstream: bool,
}

/// How an episode ended for an agent; several may hold at once.
#[derive(Debug, Clone, Copy, Default)]
pub struct Outcome {
    /// The agent crossed the line at the end of its route.
    pub arrived: bool,
    /// The agent hit another vehicle or a pedestrian.
    pub crashed: bool,
    /// The agent was off-road.
    pub out_of_road: bool,
}

/// A route that a vehicle may be on, and the vehicle's position on it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Candidate {
    pub(crate) route: usize,
    /// Position of the vehicle's centre along the route \[m\].
    pub(crate) s: f64,
    /// Offset from the route's path, positive to the left \[m\].
    pub(crate) lateral: f64,
    /// Segment of the path at which a search for positions begins.
    pub(crate) segment: usize,
}

impl Candidate {
    /// Returns the route that the vehicle is on.
    pub(crate) fn of(slot: &Slot) -> Self {
        Self { route: slot.route, s: slot.s, lateral: slot.lateral, segment: slot.segment }
    }
}

/// The vehicles of a world and the relations between them, from which observations are made.
#[derive(Debug, Clone)]
pub(crate) struct Traffic {
    pub(crate) slots: Vec<Slot>,
    /// Slots of the vehicles on the road by route, furthest along first.
    pub(crate) by_route: Vec<Vec<usize>>,
    /// Distances between the centres of all slots' vehicles, `[slots, slots]` \[m\].
    distances: Vec<f64>,
    /// Whether a polygon lies between two slots' vehicles, `[slots, slots]`; empty in scenarios
    /// without polygons.
    blocked: Vec<bool>,
    /// Place and direction of each slot's vehicle.
    stances: Vec<Stance>,
    /// The last priority number that was assigned.
    pub(crate) last_priority: u32,
    /// Number of slots for agents, which come first; the others are for background traffic.
    pub(crate) agents: usize,
}

impl Traffic {
    /// Creates traffic without any vehicle, whose slots are all for agents.
    pub(crate) fn new(slots: usize, routes: usize) -> Self {
        Self {
            agents: slots,
            slots: vec![Slot::default(); slots],
            by_route: vec![Vec::with_capacity(slots); routes],
            distances: vec![0.0; slots * slots],
            blocked: Vec::new(),
            stances: vec![Stance::identity(); slots],
            last_priority: 0,
        }
    }

    /// Returns the distance between the centres of two slots' vehicles \[m\].
    pub(crate) fn distance(&self, i: usize, j: usize) -> f64 {
        self.distances[i * self.slots.len() + j]
    }

    /// Returns whether a polygon lies between two slots' vehicles.
    pub(crate) fn is_blocked(&self, i: usize, j: usize) -> bool {
        !self.blocked.is_empty() && self.blocked[i * self.slots.len() + j]
    }

    /// Returns the place and direction of a slot's vehicle.
    pub(crate) fn stance(&self, slot: usize) -> Stance {
        self.stances[slot]
    }

    /// Returns a point in the frame of a slot's vehicle, forward and to the left of it \[m\].
    pub(crate) fn relative(&self, slot: usize, point: [f64; 2]) -> Vector2<f64> {
        self.stances[slot].inverse_transform_point(&point.into()).coords
    }

    /// Returns the velocity of vehicle `j` relative to that of `slot`, in the frame of the latter
    /// \[m/s\].
    pub(crate) fn relative_velocity(&self, slot: usize, j: usize) -> Vector2<f64> {
        let [own, other] = [slot, j].map(|k| {
            let direction = self.stances[k].rotation;
            Vector2::new(self.slots[k].speed * direction.re, self.slots[k].speed * direction.im)
        });
        self.stances[slot].inverse_transform_vector(&(other - own))
    }

    /// Returns the total distance that the active agents, in the first `agents` slots, moved in
    /// the last step \[m\].
    pub(crate) fn driven_by_agents(&self, agents: usize) -> f64 {
        let active = self.slots[..agents].iter().filter(|slot| slot.status == Status::Active);
        active.map(|slot| slot.pose.distance(&slot.before)).sum()
    }

    /// Recomputes between which vehicles polygons lie.
    pub(crate) fn look_around(&mut self, walls: &Walls) {
        let n = self.slots.len();
        self.blocked.resize(n * n, false);
        self.blocked.fill(false);
        let present = |slot: &Slot| slot.status != Status::Empty;
        for i in (0..n).filter(|&i| present(&self.slots[i])) {
            for j in (0..i).filter(|&j| present(&self.slots[j])) {
                let [a, b] = [i, j].map(|slot| self.slots[slot].pose.point());
                if walls.block(a, b) {
                    self.blocked[i * n + j] = true;
                    self.blocked[j * n + i] = true;
                }
            }
        }
    }

    /// Recomputes queues, distances and directions from the slots' poses.
    pub(crate) fn refresh(&mut self) {
        let n = self.slots.len();
        self.by_route.iter_mut().for_each(Vec::clear);
        for i in 0..n {
            if self.slots[i].status == Status::Empty {
                continue;
            }
            self.by_route[self.slots[i].route].push(i);
            self.stances[i] = (&self.slots[i].pose).into();
            for j in 0..i {
                let d = self.slots[i].pose.distance(&self.slots[j].pose);
                self.distances[i * n + j] = d;
                self.distances[j * n + i] = d;
            }
        }
        for queue in &mut self.by_route {
            queue.sort_unstable_by(|&a, &b| {
                self.slots[b].s.total_cmp(&self.slots[a].s).then(a.cmp(&b))
            });
        }
    }
}
