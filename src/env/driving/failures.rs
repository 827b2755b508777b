//! Failure statistics: why agents did not arrive, from the step of each agent's first crash.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::agents::Crash;
use super::trip::Trip;
use crate::words::counted;

/// A crash counts as upstream when the first conflict point of the agent's route is farther ahead
/// than this \[m\].
pub(super) const UPSTREAM: f64 = 6.0;

/// Counts of agents that did not arrive, by cause.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Failures {
    /// Agents that crashed into a moving vehicle on a crossing or merging route.
    pub crossing: u32,
    /// Agents that crashed into a moving vehicle ahead of or behind them on the same path: on a
    /// lane that both routes use, or just behind a fork.
    pub rear_end: u32,
    /// Agents that crashed into a wreck.
    pub wreck: u32,
    /// Agents that crashed for any of these reasons, more than 6 m before the first conflict point
    /// of their route.
    pub upstream: u32,
    /// Agents that went off-road without a crash.
    pub out_of_road: u32,
    /// Agents that had neither arrived nor failed when the episode ended.
    pub unfinished: u32,
    /// Sum of the steps at which agents crashed.
    pub steps: u64,
    /// Sum of the speeds at which agents crashed \[m/s\].
    pub speeds: f64,
    /// The agents of `crossing`, counted by the pair of routes.
    pub routes: BTreeMap<String, u32>,
    /// The agents of `out_of_road`, counted by route; empty in files of older versions.
    #[serde(default)]
    pub off_road: BTreeMap<String, u32>,
}

/// Adds the counts in `from` to those in `to`, by name.
fn add(to: &mut BTreeMap<String, u32>, from: &BTreeMap<String, u32>) {
    for (name, count) in from {
        *to.entry(name.clone()).or_default() += count;
    }
}

/// Returns the six most frequent names with their counts, as text.
fn most(counts: &BTreeMap<String, u32>) -> String {
    let mut counts: Vec<_> = counts.iter().collect();
    counts.sort_by(|a, b| b.1.cmp(a.1).then(a.0.cmp(b.0)));
    let parts: Vec<String> =
        counts.iter().take(6).map(|(name, count)| format!("{name} {count}")).collect();
    parts.join(", ")
}

impl Failures {
    /// Returns why agents have not arrived. `routes` are the names of the routes.
    pub(super) fn of(trips: &[Trip], routes: &[String]) -> Self {
        let mut failures = Self::default();
        for trip in trips {
            failures.unfinished += u32::from(trip.unfinished);
            if trip.outcome.out_of_road && trip.crash.is_none() {
                failures.leave(&routes[trip.route]);
            }
            if let Some(crash) = trip.crash.filter(|_| !trip.outcome.arrived) {
                failures.add(&crash, [trip.route, crash.other].map(|route| routes[route].as_str()));
            }
        }
        failures
    }

    /// Adds an agent that crashed. `routes`: names of the agent's route and of the other vehicle's.
    fn add(&mut self, crash: &Crash, routes: [&str; 2]) {
        let count = |flag: bool| u32::from(flag);
        self.wreck += count(crash.wreck);
        self.rear_end += count(!crash.wreck && crash.same_path);
        if !crash.wreck && !crash.same_path {
            self.crossing += 1;
            let [a, b] = if routes[0] <= routes[1] { routes } else { [routes[1], routes[0]] };
            *self.routes.entry(format!("{a} × {b}")).or_default() += 1;
        }
        self.upstream += count(crash.upstream);
        self.steps += u64::from(crash.step);
        self.speeds += crash.speed;
    }

    /// Adds an agent that went off-road on `route` without a crash.
    fn leave(&mut self, route: &str) {
        self.out_of_road += 1;
        *self.off_road.entry(route.to_owned()).or_default() += 1;
    }

    /// Returns the number of agents that crashed.
    pub fn crashed(&self) -> u32 {
        self.crossing + self.rear_end + self.wreck
    }

    /// Returns the sum of both statistics, field by field.
    #[must_use]
    pub fn plus(mut self, other: &Self) -> Self {
        self.crossing += other.crossing;
        self.rear_end += other.rear_end;
        self.wreck += other.wreck;
        self.upstream += other.upstream;
        self.out_of_road += other.out_of_road;
        self.unfinished += other.unfinished;
        self.steps += other.steps;
        self.speeds += other.speeds;
        add(&mut self.routes, &other.routes);
        add(&mut self.off_road, &other.off_road);
        self
    }

    /// Returns the statistics in words, one fact per line; empty where no agent failed.
    pub fn describe(&self) -> Vec<String> {
        let crashed = self.crashed();
        let mut lines = Vec::new();
        if crashed > 0 {
            let share = |count: u32| 100.0 * f64::from(count) / f64::from(crashed);
            lines.push(format!(
                "{} crashed: {:.0} % with a vehicle on a crossing route, \
                 {:.0} % with one on their own route, {:.0} % into a wreck",
                counted(crashed, "vehicle"),
                share(self.crossing),
                share(self.rear_end),
                share(self.wreck)
            ));
            lines.push(format!(
                "{:.0} % of them more than {UPSTREAM} m before the first conflict point; on average at step {:.0}, at {:.1} m/s",
                share(self.upstream),
                self.steps as f64 / f64::from(crashed),
                self.speeds / f64::from(crashed)
            ));
        }
        if self.crossing > 0 {
            lines.push(format!("crossing: {}", most(&self.routes)));
        }
        if self.out_of_road > 0 {
            let routes = if self.off_road.is_empty() {
                String::new()
            } else {
                format!(": {}", most(&self.off_road))
            };
            lines.push(format!("{} went off-road{routes}", counted(self.out_of_road, "vehicle")));
        }
        if self.unfinished > 0 {
            lines.push(format!(
                "{} had not arrived at the end of the episode",
                counted(self.unfinished, "vehicle")
            ));
        }
        lines
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn off_road_agents_are_counted_by_route() {
        let mut first = Failures::default();
        first.leave("b");
        let mut second = first.clone();
        second.leave("a");
        second.leave("a");
        assert_eq!(first.plus(&second).describe(), ["4 vehicles went off-road: a 2, b 2"]);
        let one = Failures { unfinished: 1, ..Failures::default() };
        assert_eq!(one.describe(), ["1 vehicle had not arrived at the end of the episode"]);
        let older = Failures { out_of_road: 3, ..Failures::default() };
        assert_eq!(older.describe(), ["3 vehicles went off-road"]);
    }
}
