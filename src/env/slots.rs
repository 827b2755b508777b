//! The vehicle slots of a world, and how their vehicles stand to each other: what observations and rewards are made from.
//!
//! The agents' slots come first, then those of vehicles that SUMO drives. Life of an agent's slot: *empty* → *active* (an agent drives) → arrived (empty again) or crashed (*wreck*, an obstacle for a
//! while, then empty). No slot revives within an episode.

use super::failures::Crash;
use super::geometry::{Pose, Size, Stance};
use super::intention::Intentions;
use super::loitering::Loitering;
use super::routes::RouteGeometry;
use super::steering::Motion;

/// A vehicle this far behind a meeting point has left it, body and all \[m\].
pub(super) const CLEARED: f64 = 7.0;
/// What a slot holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Status {
    Empty,
    Active,
    Wreck,
}

/// Where SUMO has a vehicle that steers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Track {
    /// On its route.
    Route,
    /// It has been beside its route: SUMO may have given it another.
    Astray,
    /// On no road any more.
    Lost,
}

#[derive(Debug, Clone)]
pub(super) struct Slot {
    pub(super) status: Status,
    pub(super) route: usize,
    /// Length and width.
    pub(super) size: Size,
    /// Pose of the centre.
    pub(super) pose: Pose,
    pub(super) before: Pose,
    /// Position of the centre along the route \[m\].
    pub(super) s: f64,
    /// Forward speed, negative backwards \[m/s\].
    pub(super) speed: f64,
    /// Offset from the lane's centre line, positive to the left \[m\].
    pub(super) lateral: f64,
    /// Last throttle.
    pub(super) action: f64,
    /// Last steering command, where it steers.
    pub(super) steer: f64,
    /// Where it steers: what moves it.
    pub(super) motion: Motion,
    /// Segment of the route's polyline where the vehicle was last.
    pub(super) segment: usize,
    /// SUMO has been given the vehicle and has not been told to remove it.
    pub(super) added: bool,
    /// Where SUMO has it, of those that steer.
    pub(super) track: Track,
    /// Where it steers: pose when SUMO was last told of it, and the speed that SUMO was given then \[m/s\].
    pub(super) sent: Option<(Pose, f64)>,
    /// Where it steers: how far along its route SUMO has its front, in SUMO's count \[m\]; none where SUMO may have it elsewhere.
    pub(super) held: Option<f64>,
    /// SUMO has put the vehicle on the road.
    pub(super) departed: bool,
    pub(super) wreck_steps: u32,
    /// Its turn: those with a smaller number came near to where ways meet before it; 0: it has not yet.
    pub(super) turn: u32,
    pub(super) fate: Fate,
    /// The first crash.
    pub(super) crash: Option<Crash>,
    /// How long it has loitered, of an agent.
    pub(super) loitering: Loitering,
}

/// How an agent ended; several may hold at once.
#[derive(Debug, Clone, Copy, Default)]
pub struct Fate {
    /// It crossed the line at the end of its route.
    pub arrived: bool,
    /// It hit another vehicle.
    pub crashed: bool,
    /// It left the road.
    pub out_of_road: bool,
}

pub(super) const EMPTY: Slot = Slot {
    status: Status::Empty,
    route: 0,
    size: [0.0; 2],
    pose: Pose { x: 0.0, y: 0.0, heading: 0.0 },
    before: Pose { x: 0.0, y: 0.0, heading: 0.0 },
    s: 0.0,
    speed: 0.0,
    lateral: 0.0,
    action: 0.0,
    steer: 0.0,
    motion: Motion::at(Pose { x: 0.0, y: 0.0, heading: 0.0 }),
    segment: 0,
    added: false,
    track: Track::Route,
    sent: None,
    held: None,
    departed: false,
    wreck_steps: 0,
    turn: 0,
    fate: Fate { arrived: false, crashed: false, out_of_road: false },
    crash: None,
    loitering: Loitering { has_moved: false, time: 0.0 },
};

/// The vehicles of a world and how they stand to each other; what observations are made from.
#[derive(Debug, Clone)]
pub(super) struct Traffic {
    pub(super) slots: Vec<Slot>,
    /// Slots on the road by route, furthest along first.
    pub(super) by_route: Vec<Vec<usize>>,
    /// Centre distances, between all slots \[m\].
    distances: Vec<f64>,
    stances: Vec<Stance>,
    /// The last turn that was given.
    turn: u32,
}

impl Traffic {
    /// No vehicle anywhere.
    pub(super) fn new(slots: usize, routes: usize) -> Self {
        Self {
            slots: vec![EMPTY; slots],
            by_route: vec![Vec::with_capacity(slots); routes],
            distances: vec![0.0; slots * slots],
            stances: vec![(&EMPTY.pose).into(); slots],
            turn: 0,
        }
    }

    /// Centre distance \[m\].
    pub(super) fn distance(&self, i: usize, j: usize) -> f64 {
        self.distances[i * self.slots.len() + j]
    }

    /// Where the vehicle of a slot is, and its direction.
    pub(super) fn stance(&self, slot: usize) -> Stance {
        self.stances[slot]
    }

    /// Distance that the active ones of the first `agents` slots moved in the last step \[m\].
    pub(super) fn driven_by_agents(&self, agents: usize) -> f64 {
        let active = self.slots[..agents].iter().filter(|slot| slot.status == Status::Active);
        active.map(|slot| slot.pose.distance(&slot.before)).sum()
    }

    /// Queues, distances and directions from the slots' poses.
    pub(super) fn refresh(&mut self) {
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

    /// Gives turns to those who have come within `near` metres of where their ways first meet
    /// others', the closest first. Of a vehicle whose route is hidden, the distance is that to the
    /// first conflict point on any route that it could still take.
    pub(super) fn take_turns(
        &mut self,
        routes: &[RouteGeometry],
        intentions: Option<&Intentions>,
        near: f64,
    ) {
        let way = |j: usize, slot: &Slot| {
            let hidden = intentions.and_then(|intentions| intentions.to_first_conflict(routes, j));
            hidden.unwrap_or_else(|| routes[slot.route].to_first_conflict(slot.s))
        };
        loop {
            let waiting = self.slots.iter_mut().enumerate().filter_map(|(j, slot)| {
                let waits = slot.status != Status::Empty && slot.turn == 0;
                let distance = if waits { way(j, slot) } else { f64::INFINITY };
                (distance <= near).then_some((distance, slot))
            });
            let Some((_, next)) = waiting.min_by(|a, b| a.0.total_cmp(&b.0)) else {
                return;
            };
            self.turn += 1;
            next.turn = self.turn;
        }
    }
}
