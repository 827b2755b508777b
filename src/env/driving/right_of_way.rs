//! Right of way by first come, first served, as at a junction that grants passage in the order of
//! requests (Dresner and Stone, JAIR 2008): the vehicles' priorities, of which the smallest number
//! goes first, and how far a vehicle can drive under them.

use super::agents::{Candidate, Slot, Status, Traffic};
use super::foresight::{Course, DRIVING, passing};
use super::intention::{Intentions, Knowledge};
use super::map::Map;
use super::routes::RouteGeometry;
use super::signals::STANDING;
use crate::scenario::Observation;

/// Distance to the first conflict point at which vehicles get their priority, in scenarios whose
/// observations do not contain priority \[m\].
const PRIORITY_DISTANCE: f64 = 50.0;
/// How far ahead the rule predicts motion \[s\].
const HORIZON: f64 = 5.0;
/// Closeness ([`passing`]) from which a vehicle gives way: a predicted gap below 1 m.
const TOO_CLOSE: f64 = 2.0 / 3.0;
/// Closeness from which a standing vehicle is in the way: a gap below 0.3 m.
const IN_THE_WAY: f64 = 0.9;
/// Distance that a vehicle's centre keeps, when it stops, from the position where the vehicle would
/// be too close to another \[m\].
pub(crate) const RESERVE: f64 = 4.0;
/// A vehicle whose front is more than this past a waiting place has entered \[m\].
const OVER: f64 = 3.0;
/// A vehicle blocks another that would reach its present position within this time \[s\].
const BLOCKED: f64 = 3.0;
/// A vehicle blocks only vehicles whose centres are closer than this \[m\].
const FAR: f64 = 30.0;

/// The right of way in one world.
#[derive(Debug, Clone)]
pub(super) struct RightOfWay {
    /// Distance to the first conflict point at which vehicles get their priority \[m\]; `None`
    /// where neither agents nor rules use priorities.
    near: Option<f64>,
    /// Whether agents observe the effective priorities.
    observed: bool,
    /// Effective priorities of all slots' vehicles; empty if agents do not observe them.
    pub(super) priorities: Vec<u32>,
    /// Scratch: pairs of slots of which the first vehicle blocks the second.
    blocked: Vec<(usize, usize)>,
    /// Whether each agent is close behind a vehicle that waits by its own rules.
    kept_back: Vec<bool>,
}

impl RightOfWay {
    /// Keeps the right of way where agents observe it, or where `rules` control the agents.
    pub(super) fn new(observation: &Observation, rules: bool, slots: usize) -> Self {
        let observed = observation.priority_distance > 0.0;
        let near = if observed { observation.priority_distance } else { PRIORITY_DISTANCE };
        Self {
            near: (observed || rules).then_some(near),
            observed,
            priorities: Vec::with_capacity(slots),
            blocked: Vec::with_capacity(slots),
            kept_back: Vec::with_capacity(slots),
        }
    }

    /// Returns whether the vehicles get priorities.
    pub(super) fn is_kept(&self) -> bool {
        self.near.is_some()
    }

    /// Assigns priorities after a step.
    pub(super) fn update(
        &mut self,
        map: &Map,
        traffic: &mut Traffic,
        intentions: Option<&Intentions>,
    ) {
        if let Some(near) = self.near {
            keep_back(traffic, &map.routes, &mut self.kept_back);
            assign(traffic, &map.routes, intentions, near, &self.kept_back);
        }
        if self.observed {
            let knowledge = Knowledge::public(map, traffic, intentions);
            inherit(knowledge, &mut self.priorities, &mut self.blocked);
        }
    }
}

/// How far an agent can drive before it comes too close to other vehicles \[m\]; infinite where
/// nothing is in the way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Free {
    /// Distance to a vehicle that has priority, is ahead, or is a wreck, at the agent's speed but
    /// at least 6 m/s.
    pub(crate) distance: f64,
    /// The same at the agent's speed but at least 3 m/s.
    pub(crate) slow: f64,
    /// Distance to a vehicle without priority whose present position is in the agent's way, at the
    /// agent's speed but at least 6 m/s.
    pub(crate) blocked: f64,
}

impl Free {
    /// Nothing is in the way.
    pub(crate) const ALL: Self =
        Self { distance: f64::INFINITY, slow: f64::INFINITY, blocked: f64::INFINITY };

    /// Returns the smaller of each distance.
    pub(crate) fn min(self, other: Self) -> Self {
        Self {
            distance: self.distance.min(other.distance),
            slow: self.slow.min(other.slow),
            blocked: self.blocked.min(other.blocked),
        }
    }
}

/// Relation of another vehicle to an agent.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Standing {
    /// The other vehicle is behind the agent.
    Behind,
    /// The other vehicle is ahead of the agent, or a wreck.
    Ahead,
    /// The other vehicle has priority over the agent.
    Before,
    /// The agent has priority over the other vehicle.
    After,
}

/// Returns how far the vehicle of `slot` can drive with regard to the vehicle of slot `j`: the
/// smallest distances over all candidate routes of the latter.
pub(crate) fn free(knowledge: Knowledge<'_>, priorities: &[u32], slot: usize, j: usize) -> Free {
    let (routes, slots) = (knowledge.routes, &knowledge.traffic.slots);
    let (own, other) = (&slots[slot], &slots[j]);
    if j == slot || other.status == Status::Empty {
        return Free::ALL;
    }
    let standing = |place: &Candidate| {
        if is_behind(routes, &Candidate::of(own), place) {
            Standing::Behind
        } else if is_behind(routes, place, &Candidate::of(own)) || other.status == Status::Wreck {
            Standing::Ahead
        } else if priorities[j] < priorities[slot] {
            Standing::Before
        } else {
            Standing::After
        }
    };
    let on = |place: Candidate| {
        let distance = |least: f64, at: f64, close_to: f64| {
            let speed = own.speed.max(least);
            let course = Course::on(routes, place, other.size, at);
            let [close, soon] = passing(Course::new(routes, own, speed), course, HORIZON);
            if close > close_to { speed * HORIZON * (1.0 - soon) } else { f64::INFINITY }
        };
        let before = |at: f64| Free {
            distance: distance(DRIVING, at, TOO_CLOSE),
            slow: distance(DRIVING / 2.0, at, TOO_CLOSE),
            ..Free::ALL
        };
        match standing(&place) {
            Standing::Behind => Free::ALL,
            Standing::Ahead => before(other.speed),
            Standing::Before => before(other.speed).min(before(other.speed.max(DRIVING))),
            Standing::After => Free { blocked: distance(DRIVING, 0.0, IN_THE_WAY), ..Free::ALL },
        }
    };
    let reach = other.speed.max(DRIVING) * HORIZON;
    let new = |(k, place): &(usize, Candidate)| {
        let same = |earlier: Candidate| {
            knowledge.until_parted(&earlier, place) > reach && standing(&earlier) == standing(place)
        };
        !knowledge.candidates(j).take(*k).any(same)
    };
    knowledge
        .candidates(j)
        .enumerate()
        .filter(new)
        .map(|(_, place)| on(place))
        .fold(Free::ALL, Free::min)
}

/// Returns how far a vehicle has to drive to the next place where it can wait without blocking
/// others: before a junction, or before the next group of conflicts of its route \[m\]. Places that
/// its front has passed by more than [`OVER`] do not count; `None` where none is left.
pub(crate) fn to_entry(map: &Map, slot: &Slot) -> Option<f64> {
    let nose = slot.s + slot.size[0] / 2.0;
    let meeting = map.routes[slot.route].to_first_conflict(slot.s) - RESERVE;
    let lines = map.junctions[slot.route].iter().map(|junction| junction.from - nose);
    lines.chain([meeting]).filter(|distance| *distance > -OVER).min_by(f64::total_cmp)
}

/// Whether the vehicle at `behind` will come to the position of the vehicle at `ahead` on its
/// route, and before any conflict with it. On a ring, the shorter way around counts.
pub(crate) fn is_behind(routes: &[RouteGeometry], ahead: &Candidate, behind: &Candidate) -> bool {
    let gap =
        |from: &Candidate, to: &Candidate| routes[from.route].gap_to_leader(from.s, to.route, to.s);
    gap(behind, ahead).is_some_and(|gap_ahead| {
        gap(ahead, behind).is_none_or(|gap_behind| gap_ahead <= gap_behind)
    })
}

/// Whether a red signal holds a vehicle back before its next conflict point.
fn is_held(routes: &[RouteGeometry], slot: &Slot) -> bool {
    slot.next_signal.is_some_and(|next| {
        next.aspect.demands_stop() && next.distance < routes[slot.route].to_first_conflict(slot.s)
    })
}

/// Whether a vehicle of background traffic stands before its next conflict point. SUMO lets it go
/// by its own rules, perhaps not before an agent has passed: an agent that waited for it could wait
/// for ever.
fn waits_by_own_rules(routes: &[RouteGeometry], slot: &Slot) -> bool {
    slot.status == Status::Active
        && slot.speed < STANDING
        && routes[slot.route].to_first_conflict(slot.s) > 0.0
}

/// Writes for each agent whether it is close behind a vehicle of background traffic that waits by
/// its own rules. Others must not wait for such an agent, which cannot go.
pub(crate) fn keep_back(traffic: &Traffic, routes: &[RouteGeometry], kept_back: &mut Vec<bool>) {
    let slots = &traffic.slots;
    let waits = |i: &usize| waits_by_own_rules(routes, &slots[*i]);
    let is_kept_back = |j: usize| {
        let close = |i: usize| {
            let [ahead, own] = [i, j].map(|k| Candidate::of(&slots[k]));
            traffic.distance(i, j) < FAR && is_behind(routes, &ahead, &own)
        };
        slots[j].status == Status::Active && (traffic.agents..slots.len()).filter(waits).any(close)
    };
    kept_back.clear();
    kept_back.extend((0..traffic.agents).map(is_kept_back));
}

/// Assigns priority to the vehicles that have come within `near` metres of their first conflict
/// point, the closest vehicle first. If a vehicle's route is hidden, its distance is the one to the
/// first conflict point on any route that it could still take. A vehicle before a red signal has
/// no priority until the signal lets it pass, and a vehicle of background traffic none while it
/// stands before its conflicts. Agents for which `kept_back` is true have none either.
pub(crate) fn assign(
    traffic: &mut Traffic,
    routes: &[RouteGeometry],
    intentions: Option<&Intentions>,
    near: f64,
    kept_back: &[bool],
) {
    let to_conflict = |j: usize, slot: &Slot| {
        let hidden = intentions.and_then(|intentions| intentions.to_first_conflict(routes, j));
        hidden.unwrap_or_else(|| routes[slot.route].to_first_conflict(slot.s))
    };
    let agents = traffic.agents;
    let has_none = |j: usize, slot: &Slot| {
        is_held(routes, slot)
            || kept_back.get(j) == Some(&true)
            || j >= agents && waits_by_own_rules(routes, slot)
    };
    // A vehicle that has left a group of conflicts gets a new priority at the next one.
    let slots = traffic.slots.iter_mut().enumerate();
    for (j, slot) in slots.filter(|(_, slot)| slot.status != Status::Empty) {
        let group = routes[slot.route].group_at(slot.s);
        if std::mem::replace(&mut slot.conflict_group, group) != group || has_none(j, slot) {
            slot.priority = 0;
        }
    }
    loop {
        let waiting = traffic.slots.iter_mut().enumerate().filter_map(|(j, slot)| {
            let waits = slot.status != Status::Empty && slot.priority == 0 && !has_none(j, slot);
            let distance = if waits { to_conflict(j, slot) } else { f64::INFINITY };
            (distance <= near).then_some((distance, slot))
        });
        let Some((_, next)) = waiting.min_by(|a, b| a.0.total_cmp(&b.0)) else {
            return;
        };
        traffic.last_priority += 1;
        next.priority = traffic.last_priority;
    }
}

/// Writes the effective priorities of all slots to `priorities`; the smallest number goes first.
///
/// A vehicle whose present position blocks another inherits the blocked vehicle's priority if that
/// is earlier than its own; otherwise the two would wait for each other. A vehicle with several
/// candidate routes is blocked if it is blocked on any of them. A vehicle of background traffic
/// that stands before its conflicts inherits nothing, because it waits by its own rules. `blocked`
/// is scratch.
pub(crate) fn inherit(
    knowledge: Knowledge<'_>,
    priorities: &mut Vec<u32>,
    blocked: &mut Vec<(usize, usize)>,
) {
    let Knowledge { routes, traffic, .. } = knowledge;
    let slots = &traffic.slots;
    priorities.clear();
    // Vehicles that have no priority yet (0) come last.
    priorities.extend(slots.iter().map(|slot| slot.priority.wrapping_sub(1)));
    let drives = |i: usize| slots[i].status == Status::Active;
    let stands_in_the_way = |i: usize, j: usize| {
        let waits_behind =
            |own: Candidate| knowledge.candidates(j).any(|other| is_behind(routes, &other, &own));
        // The vehicle's present position is the same on all of its candidate routes.
        let own = knowledge.candidates(i).next().unwrap_or_else(|| Candidate::of(&slots[i]));
        let course = Course::on(routes, own, slots[i].size, 0.0);
        !knowledge.candidates(i).any(waits_behind)
            && knowledge.closest(course, j, DRIVING, BLOCKED)[0] > IN_THE_WAY
    };
    blocked.clear();
    let inherits =
        |i: usize| drives(i) && (i < traffic.agents || !waits_by_own_rules(routes, &slots[i]));
    for i in (0..slots.len()).filter(|&i| inherits(i)) {
        let near = |&j: &usize| {
            j != i && drives(j) && traffic.distance(i, j) < FAR && stands_in_the_way(i, j)
        };
        blocked.extend((0..slots.len()).filter(near).map(|j| (i, j)));
    }
    // Priorities are inherited along chains of any length.
    let mut changed = true;
    while std::mem::take(&mut changed) {
        for &(i, j) in &*blocked {
            changed |= priorities[j] < priorities[i];
            priorities[i] = priorities[i].min(priorities[j]);
        }
    }
}
