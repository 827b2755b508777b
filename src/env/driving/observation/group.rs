//! The interface of a feature group: how its features are described, and how they are written.

use crate::env::driving::agents::{Slot, Status, Traffic};
use crate::env::driving::intention::Knowledge;
use crate::env::driving::map::Map;
use crate::env::driving::routes::RouteGeometry;
use crate::env::spec::{Described, Features};
use crate::scenario::{Control, Scenario, Vehicle};

/// Speed scale \[m/s\].
pub const SPEED: f64 = 22.2;
/// Number of vehicles that a count feature shows as 1.
pub const COUNT: f64 = 12.0;

/// Distances that features show as 1 \[m\].
#[derive(Debug, Clone, Copy)]
pub struct Scales {
    /// Of features that resolve the gaps of a queue.
    pub near: f64,
    /// Of features that reach further.
    pub far: f64,
    /// Of features of the agent's own route.
    pub long: f64,
}

impl Scales {
    /// Returns the distance scales of a scenario: 15, 50 and 100 m, times the scenario's distance
    /// scale over 50 m.
    pub fn of(scenario: &Scenario) -> Self {
        let far = scenario.observation.distance_scale;
        Self { near: far * 15.0 / 50.0, far, long: far * 2.0 }
    }

    /// Returns the unit of a feature with the scenario's numbers in place of `{near}`, `{far}` and
    /// `{long}`.
    pub fn unit(&self, unit: &str) -> String {
        let scales = [("{near}", self.near), ("{far}", self.far), ("{long}", self.long)];
        scales
            .iter()
            .fold(unit.to_owned(), |unit, (name, scale)| unit.replace(name, &scale.to_string()))
    }
}

/// A group of features.
#[derive(Debug)]
pub struct FeatureGroup {
    /// Appends the features of the group; none where the scenario leaves the group out.
    pub describe: fn(&Scenario, &mut Features),
    /// Writes the features, as many as `describe` appends. It is not called where there are none.
    pub write: fn(&View<'_>, &mut Writer<'_>),
}

/// What the features of one agent are computed from.
#[derive(Clone, Copy)]
pub struct View<'a> {
    /// The scenario.
    pub scenario: &'a Scenario,
    /// The net and its routes.
    pub map: &'a Map,
    /// All vehicles.
    pub traffic: &'a Traffic,
    /// Knowledge of the vehicles' routes.
    pub knowledge: Knowledge<'a>,
    /// Priorities of all slots' vehicles; empty where agents do not observe them.
    pub priorities: &'a [u32],
    /// Share of the horizon that is left, 1 at the start of an episode.
    pub time_left: f64,
    /// Slot of the agent.
    pub slot: usize,
    /// Control and vehicle of each kind of vehicle; of the scenario alone if it has no kinds.
    pub kinds: &'a [(Control, Vehicle)],
}

impl<'a> View<'a> {
    /// Returns control and vehicle of the agent, if there are several kinds of vehicles.
    pub fn abilities(&self) -> Option<&'a (Control, Vehicle)> {
        (self.kinds.len() > 1).then(|| &self.kinds[self.own().kind])
    }

    /// Returns the distance scales of the scenario's features.
    pub fn scales(&self) -> Scales {
        Scales::of(self.scenario)
    }

    /// Returns the agent's slot.
    pub fn own(&self) -> &'a Slot {
        &self.traffic.slots[self.slot]
    }

    /// Returns the agent's route.
    pub fn route(&self) -> &'a RouteGeometry {
        &self.map.routes[self.own().route]
    }

    /// Whether the vehicle of slot `j` is another one, within the detection range, and not behind a
    /// polygon that blocks sight.
    pub fn detects(&self, j: usize) -> bool {
        j != self.slot
            && self.traffic.distance(self.slot, j) <= self.scenario.observation.detection_range
            && !(self.walls_block_sight() && self.traffic.is_blocked(self.slot, j))
    }

    /// Whether the scenario has polygons that block sight.
    pub fn walls_block_sight(&self) -> bool {
        self.scenario.occlusion.as_ref().is_some_and(|occlusion| occlusion.sight)
    }

    /// Returns the slots of the other vehicles within the detection range.
    pub fn detected(&self) -> impl Iterator<Item = usize> + '_ {
        let here =
            move |&j: &usize| self.traffic.slots[j].status != Status::Empty && self.detects(j);
        (0..self.traffic.slots.len()).filter(here)
    }
}

/// Writes features one after the other into a slice, clipped to -1..=1.
pub struct Writer<'a> {
    out: &'a mut [f32],
    at: usize,
}

impl<'a> Writer<'a> {
    /// Returns a writer that fills `out`.
    pub fn new(out: &'a mut [f32]) -> Self {
        Self { out, at: 0 }
    }

    /// Writes the values of consecutive features.
    pub fn put<const K: usize>(&mut self, values: [f64; K]) {
        for value in values {
            self.out[self.at] = value.clamp(-1.0, 1.0) as f32;
            self.at += 1;
        }
    }

    /// Writes the first `count` of some tokens with the features `described`, and padding.
    pub fn tokens<const K: usize>(
        &mut self,
        _described: &[Described; K],
        count: usize,
        tokens: impl Iterator<Item = [f64; K]>,
    ) {
        let end = self.at + K * count;
        tokens.take(count).for_each(|token| self.put(token));
        self.skip(end - self.at);
    }

    /// Writes zeros.
    pub fn skip(&mut self, count: usize) {
        self.out[self.at..self.at + count].fill(0.0);
        self.at += count;
    }

    /// Returns the slice of all features that are left, for another function to fill.
    pub fn rest(&mut self) -> &mut [f32] {
        let from = std::mem::replace(&mut self.at, self.out.len());
        &mut self.out[from..]
    }

    /// Ends the writing.
    ///
    /// # Panics
    /// If fewer features were written than described.
    pub fn finish(self) {
        assert_eq!(self.at, self.out.len(), "a group writes as many features as it describes");
    }
}

/// Returns 1 for a vehicle that is under way and 0 for a wreck.
pub fn moving(status: Status) -> f64 {
    f64::from(u8::from(status == Status::Active))
}
