//! An agent's knowledge of the routes of the other vehicles.
//!
//! Where the scenario hides intentions, an agent has to expect every route that a vehicle could
//! still take: its *candidates*. Candidates follow from where the vehicle began and where it is
//! now, never from the route that it is on: all routes that begin like the vehicle's are
//! candidates, and a candidate is open until its path has parted from where the vehicle is. Every
//! feature group reads other vehicles' routes through [`Knowledge::candidates`] and
//! [`Knowledge::on_route`] only.

use super::agents::{Candidate, Slot, Status, Traffic};
use super::foresight::{Closest, Course};
use super::forks::{Forks, Passage};
use super::geometry::{Stance, direction, to_box};
use super::map::Map;
use super::routes::RouteGeometry;
use crate::scenario::{Intention, Observation};

/// A route is open while its path is at most this much farther from the vehicle than the path of
/// the nearest candidate \[m\].
const PARTED: f64 = 1.0;
/// Distance that is added for a path at right angles to the vehicle's heading; a path in the
/// opposite direction counts as twice as far \[m\].
const ACROSS: f64 = 3.0;

/// A candidate route of a vehicle, as of the last update.
#[derive(Debug, Clone, Copy)]
struct Tracked {
    candidate: Candidate,
    /// Distance of the vehicle from the route's path, increased for a different heading \[m\].
    apart: f64,
    /// Whether the vehicle could still take the route.
    open: bool,
    /// Whether the route agrees with the vehicle's indicator.
    agrees: bool,
}

/// A vehicle in the queue of one of its candidate routes.
#[derive(Debug, Clone, Copy)]
struct Queued {
    slot: usize,
    s: f64,
    agrees: bool,
}

/// The candidates of all vehicles of a world.
#[derive(Debug, Clone)]
pub(crate) struct Intentions {
    /// What the scenario lets agents observe.
    observation: Observation,
    /// Number of agents, whose slots come first.
    agents: usize,
    /// Largest number of candidates that a vehicle can have.
    most: usize,
    /// Candidates of all slots, `[slots, most]`.
    tracked: Vec<Tracked>,
    /// Number of candidates per slot; 0 where the slot is empty or no other route begins like the
    /// vehicle's.
    counts: Vec<usize>,
    /// Vehicles by candidate route, furthest along first.
    queues: Vec<Vec<Queued>>,
    /// Whether the agent of the first slot sees the indicator of the vehicle in the second,
    /// `[slots, slots]`.
    sees_indicator: Vec<bool>,
}

impl Intentions {
    /// Returns the candidates of `slots` vehicles, of which the first `agents` are agents, before an
    /// episode; `None` where all routes are known.
    pub(crate) fn new(
        map: &Map,
        observation: Observation,
        agents: usize,
        slots: usize,
    ) -> Option<Self> {
        let most = map.forks.alike.iter().map(Vec::len).max().unwrap_or(0);
        if observation.intention == Intention::Seen || most < 2 {
            return None;
        }
        let none = Candidate { route: 0, s: 0.0, lateral: 0.0, segment: 0 };
        let none = Tracked { candidate: none, apart: 0.0, open: false, agrees: false };
        Some(Self {
            observation,
            agents,
            most,
            tracked: vec![none; slots * most],
            counts: vec![0; slots],
            queues: vec![Vec::with_capacity(slots); map.routes.len()],
            sees_indicator: vec![false; slots * slots],
        })
    }

    /// Begins a new episode: forgets where vehicles have been.
    pub(crate) fn begin(&mut self) {
        self.counts.fill(0);
    }

    /// Updates the candidates from the vehicles' poses. `steers`: whether agents steer, so that
    /// they follow their routes' paths; SUMO keeps all other vehicles on lanes.
    pub(crate) fn update(&mut self, map: &Map, traffic: &Traffic, steers: bool) {
        let signals = (self.observation.intention == Intention::Signalled)
            .then_some(self.observation.signal_distance);
        self.queues.iter_mut().for_each(Vec::clear);
        for (j, slot) in traffic.slots.iter().enumerate() {
            // A slot may be empty and taken again between two frames.
            let begins = std::mem::take(&mut self.counts[j]) == 0 || slot.age == 0;
            let alike = &map.forks.alike[slot.route];
            if slot.status == Status::Empty {
                continue;
            }
            if alike.len() == 1 {
                self.queues[slot.route].push(Queued { slot: j, s: slot.s, agrees: true });
                continue;
            }
            self.counts[j] = alike.len();
            let tracked = &mut self.tracked[j * self.most..][..alike.len()];
            // A background vehicle that has changed lanes may be on a route with other candidates.
            let begins = begins || tracked[0].candidate.route != alike[0];
            for (entry, &route) in tracked.iter_mut().zip(alike) {
                let hint = (!begins).then_some(entry.candidate.segment);
                let geometry = &map.routes[route];
                *entry = locate(
                    geometry,
                    route,
                    slot,
                    traffic.stance(j),
                    hint,
                    steers && j < self.agents,
                );
            }
            close_parted(tracked);
            if let Some(distance) = signals {
                read_indicator(&map.forks, slot, distance, tracked);
            }
            for entry in tracked.iter().filter(|entry| entry.open) {
                let queued = Queued { slot: j, s: entry.candidate.s, agrees: entry.agrees };
                self.queues[entry.candidate.route].push(queued);
            }
        }
        for queue in &mut self.queues {
            queue.sort_unstable_by(|a, b| b.s.total_cmp(&a.s).then(a.slot.cmp(&b.slot)));
        }
        if signals.is_some() {
            self.look(traffic);
        }
    }

    /// Returns the candidates of a slot's vehicle, closed ones included; empty where its route is
    /// known.
    fn of(&self, slot: usize) -> &[Tracked] {
        &self.tracked[slot * self.most..][..self.counts[slot]]
    }

    /// Returns the vehicle's distance to the first conflict point on any open route \[m\]; `None`
    /// where its route is known.
    pub(crate) fn to_first_conflict(&self, routes: &[RouteGeometry], slot: usize) -> Option<f64> {
        let open = self.of(slot).iter().filter(|entry| entry.open);
        open.map(|entry| routes[entry.candidate.route].to_first_conflict(entry.candidate.s))
            .min_by(f64::total_cmp)
    }

    /// Determines which agents see which indicators.
    fn look(&mut self, traffic: &Traffic) {
        let (slots, n) = (&traffic.slots, traffic.slots.len());
        self.sees_indicator.fill(false);
        for j in 0..n {
            if self.of(j).iter().all(|entry| entry.agrees || !entry.open) {
                continue;
            }
            for i in (0..self.agents).filter(|&i| i != j && slots[i].status == Status::Active) {
                let near = traffic.distance(i, j) <= self.observation.detection_range;
                self.sees_indicator[i * n + j] = near && in_sight(traffic, i, j);
            }
        }
    }
}

/// Locates a vehicle on a route. The search begins near the segment `hint`, or covers the whole
/// path where there is none. `on_path`: search on the path and not on the lanes' centre line.
fn locate(
    geometry: &RouteGeometry,
    route: usize,
    slot: &Slot,
    stance: Stance,
    hint: Option<usize>,
    on_path: bool,
) -> Tracked {
    let path = if on_path { &geometry.path } else { geometry.lanes() };
    let centre = [slot.pose.x, slot.pose.y];
    let (s, lateral, segment) =
        hint.map_or_else(|| path.nearest(centre), |hint| path.project(centre, hint));
    let s = if on_path { s } else { geometry.on_path(s) };
    let outside = (-s).max(s - geometry.path.length()) - slot.size[0];
    let candidate = Candidate { route, s, lateral, segment };
    let ([x, y], [u, v]) = (direction(&stance), path.direction(segment));
    let apart = lateral.abs() + outside.max(0.0) + ACROSS * (1.0 - x * u - y * v);
    Tracked { candidate, apart, open: true, agrees: true }
}

/// Closes the candidates whose paths have parted from where the vehicle is.
fn close_parted(tracked: &mut [Tracked]) {
    let nearest = tracked.iter().map(|entry| entry.apart).fold(f64::INFINITY, f64::min);
    for entry in tracked {
        entry.open = entry.apart <= nearest + PARTED;
    }
}

/// Marks the candidates that agree with the vehicle's indicator. The indicator shows the direction
/// at the next junction, from `distance` metres before the junction until the vehicle has left it.
fn read_indicator(forks: &Forks, slot: &Slot, distance: f64, tracked: &mut [Tracked]) {
    let next = |entry: &Tracked, of: &dyn Fn(&Passage) -> bool| {
        let Candidate { route, s, .. } = entry.candidate;
        forks.passages[route].iter().find(|passage| passage.to >= s && of(passage)).copied()
    };
    let own = tracked.iter().find(|entry| entry.candidate.route == slot.route).copied();
    let shown = own.and_then(|own| {
        let front = own.candidate.s + slot.size[0] / 2.0;
        next(&own, &|_| true).filter(|passage| passage.from - front <= distance)
    });
    let Some(shown) = shown else { return };
    for entry in &mut *tracked {
        let there = next(entry, &|passage| passage.junction == shown.junction);
        entry.agrees = there.is_some_and(|there| there.indicator == shown.indicator);
    }
    // A vehicle far beside its route may signal a direction that no open route has; its indicator
    // is ignored then.
    if !tracked.iter().any(|entry| entry.open && entry.agrees) {
        for entry in &mut *tracked {
            entry.agrees = true;
        }
    }
}

/// Whether no third vehicle's body is on the line between the centres of two vehicles.
fn in_sight(traffic: &Traffic, i: usize, j: usize) -> bool {
    let distance = traffic.distance(i, j);
    let [from, to] = [i, j].map(|k| traffic.stance(k).translation.vector);
    let along = ((to - from) / distance.max(f64::MIN_POSITIVE)).into();
    let hides = |(k, body): (usize, &Slot)| {
        let half = body.size.map(|side| side / 2.0);
        let third = k != i && k != j && body.status != Status::Empty;
        third
            && traffic.distance(i, k) <= distance + half[0] + half[1]
            && to_box(from.into(), traffic.stance(k), half)(along)
                .is_some_and(|to_body| to_body < distance)
    };
    !traffic.slots.iter().enumerate().any(hides)
}

/// Knowledge of the vehicles' routes, of one agent or common to all.
#[derive(Clone, Copy)]
pub(crate) struct Knowledge<'a> {
    pub(crate) routes: &'a [RouteGeometry],
    pub(crate) traffic: &'a Traffic,
    hidden: Option<(&'a Intentions, &'a Forks)>,
    /// The agent whose sight decides which indicators are known; without an agent, none is.
    reader: Option<usize>,
}

impl<'a> Knowledge<'a> {
    /// All routes are known: for the privileged state and for drivers that follow rules.
    pub(crate) fn full(routes: &'a [RouteGeometry], traffic: &'a Traffic) -> Self {
        Self { routes, traffic, hidden: None, reader: None }
    }

    /// All routes are known, except for those that the scenario hides: what every agent knows
    /// without seeing indicators.
    pub(crate) fn public(
        map: &'a Map,
        traffic: &'a Traffic,
        intentions: Option<&'a Intentions>,
    ) -> Self {
        let hidden = intentions.map(|intentions| (intentions, &map.forks));
        Self { hidden, ..Self::full(&map.routes, traffic) }
    }

    /// Knowledge of the agent of slot `reader` about the other vehicles.
    pub(crate) fn to(self, reader: usize) -> Self {
        Self { reader: Some(reader), ..self }
    }

    /// Returns the routes that the vehicle of a slot may take, at least one, in ascending order.
    pub(crate) fn candidates(
        self,
        slot: usize,
    ) -> impl Iterator<Item = Candidate> + Clone + use<'a> {
        let tracked = self.hidden.map_or(&[][..], |(intentions, _)| intentions.of(slot));
        let known = tracked.is_empty().then(|| Candidate::of(&self.traffic.slots[slot]));
        let reads = !tracked.is_empty() && self.sees_indicator(slot);
        let open = tracked.iter().filter(move |entry| entry.open && (entry.agrees || !reads));
        known.into_iter().chain(open.map(|entry| entry.candidate))
    }

    /// Returns the [`Knowledge::candidates`], each with the distance that it has in common with an
    /// earlier candidate \[m\].
    pub(crate) fn branches(self, slot: usize) -> impl Iterator<Item = (Candidate, f64)> + use<'a> {
        let all = self.candidates(slot);
        let branch = move |(k, one): (usize, Candidate)| {
            let common = |other: Candidate| self.until_parted(&other, &one);
            (one, all.clone().take(k).map(common).fold(0.0, f64::max))
        };
        self.candidates(slot).enumerate().map(branch)
    }

    /// Returns how far a vehicle can drive along two of its candidate routes until their paths part
    /// \[m\]; 0 where they have parted.
    pub(crate) fn until_parted(self, a: &Candidate, b: &Candidate) -> f64 {
        let same = a.s == b.s && a.lateral == b.lateral;
        let together = self.hidden.and_then(|(_, forks)| {
            let k = forks.alike[a.route].iter().position(|&route| same && route == b.route)?;
            Some((forks.together[a.route][k] - a.s).max(0.0))
        });
        together.unwrap_or(0.0)
    }

    /// Returns the closest passing, as [`passing`](super::foresight::passing) does, of a course and
    /// the vehicle of `slot` at `speed` \[m/s\] on any of its candidate routes, within `horizon`
    /// \[s\].
    pub(crate) fn closest(
        self,
        course: Course<'_>,
        slot: usize,
        speed: f64,
        horizon: f64,
    ) -> [f64; 2] {
        let mut closest = Closest::within(horizon);
        for (place, common) in self.branches(slot) {
            // Up to this time, the search on an earlier candidate covers the same path.
            let from = if common > 0.0 && speed <= 0.0 {
                f64::INFINITY
            } else {
                common / speed.max(f64::MIN_POSITIVE)
            };
            closest.look(
                course,
                Course::on(self.routes, place, self.traffic.slots[slot].size, speed),
                from,
            );
        }
        closest.numbers()
    }

    /// Returns positions \[m\] and slots of the vehicles that may be on a route, furthest along
    /// first.
    pub(crate) fn on_route(
        self,
        route: usize,
    ) -> impl Iterator<Item = (f64, usize)> + Clone + use<'a> {
        let (known, open) = match self.hidden {
            None => (&self.traffic.by_route[route][..], &[][..]),
            Some((intentions, _)) => (&[][..], &intentions.queues[route][..]),
        };
        let open =
            open.iter().filter(move |entry| entry.agrees || !self.sees_indicator(entry.slot));
        known
            .iter()
            .map(move |&j| (self.traffic.slots[j].s, j))
            .chain(open.map(|entry| (entry.s, entry.slot)))
    }

    fn sees_indicator(self, slot: usize) -> bool {
        let n = self.traffic.slots.len();
        match (self.hidden, self.reader) {
            (Some((intentions, _)), Some(reader)) => intentions.sees_indicator[reader * n + slot],
            _ => false,
        }
    }
}
