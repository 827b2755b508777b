//! Failure statistics: why agents did not arrive, from the moment at which each crashed first.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// A crash further than this before the first meeting point is one on the way to it \[m\].
pub(super) const UPSTREAM: f64 = 6.0;

/// How an agent crashed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Crash {
    /// Route of one that it overlapped with in the step of its crash, the lowest slot of several.
    pub(super) other: usize,
    /// One was ahead of the other on its way.
    pub(super) same_way: bool,
    /// The other was a wreck by then.
    pub(super) wreck: bool,
    pub(super) step: u32,
    /// \[m/s\]
    pub(super) speed: f64,
    /// More than [`UPSTREAM`] before the first meeting point of its route.
    pub(super) upstream: bool,
}

/// Sums over agents that did not arrive.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Failures {
    /// Crashed into a moving vehicle that came another way.
    pub crossing: u32,
    /// Crashed into a moving vehicle on their own way, from in front or behind: on a lane that both use, or just behind its fork.
    pub rear_end: u32,
    /// Crashed into a wreck.
    pub wreck: u32,
    /// Of all crashed: more than 6 m before the first meeting point of their route.
    pub upstream: u32,
    /// Left the road, without a crash.
    pub out_of_road: u32,
    /// Neither arrived nor failed when the episode was cut off.
    pub unfinished: u32,
    /// Sum of the steps at which they crashed.
    pub steps: u64,
    /// Sum of the speeds before they crashed \[m/s\].
    pub speeds: f64,
    /// Those of `crossing` by the two routes, agents each.
    pub routes: BTreeMap<String, u32>,
    /// Those of `out_of_road` by their route; older files do not say.
    #[serde(default)]
    pub off_road: BTreeMap<String, u32>,
}

/// Sums of counts by name.
fn add(to: &mut BTreeMap<String, u32>, from: &BTreeMap<String, u32>) {
    for (name, count) in from {
        *to.entry(name.clone()).or_default() += count;
    }
}

/// The most frequent, with their counts.
fn most(counts: &BTreeMap<String, u32>) -> String {
    let mut counts: Vec<_> = counts.iter().collect();
    counts.sort_by(|a, b| b.1.cmp(a.1).then(a.0.cmp(b.0)));
    let parts: Vec<String> =
        counts.iter().take(6).map(|(name, count)| format!("{name} {count}")).collect();
    parts.join(", ")
}

impl Failures {
    /// Adds an agent that crashed. `routes`: names of its own and the other's.
    pub(super) fn add(&mut self, crash: &Crash, routes: [&str; 2]) {
        let count = |flag: bool| u32::from(flag);
        self.wreck += count(crash.wreck);
        self.rear_end += count(!crash.wreck && crash.same_way);
        if !crash.wreck && !crash.same_way {
            self.crossing += 1;
            let [a, b] = if routes[0] <= routes[1] { routes } else { [routes[1], routes[0]] };
            *self.routes.entry(format!("{a} × {b}")).or_default() += 1;
        }
        self.upstream += count(crash.upstream);
        self.steps += u64::from(crash.step);
        self.speeds += crash.speed;
    }

    /// Adds an agent on this route that left the road, without a crash.
    pub(super) fn leave(&mut self, route: &str) {
        self.out_of_road += 1;
        *self.off_road.entry(route.to_owned()).or_default() += 1;
    }

    /// Agents that crashed.
    pub fn crashed(&self) -> u32 {
        self.crossing + self.rear_end + self.wreck
    }

    /// Sums, field by field.
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

    /// In words, one fact per line; empty where nothing failed.
    pub fn describe(&self) -> Vec<String> {
        let crashed = self.crashed();
        let mut lines = Vec::new();
        if crashed > 0 {
            let share = |count: u32| 100.0 * f64::from(count) / f64::from(crashed);
            lines.push(format!(
                "{crashed} vehicles crashed: {:.0} % crossing another's way, {:.0} % with one on their own, {:.0} % into a wreck",
                share(self.crossing),
                share(self.rear_end),
                share(self.wreck)
            ));
            lines.push(format!(
                "{:.0} % of them more than {UPSTREAM} m before the first meeting point; on average at step {:.0}, at {:.1} m/s",
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
            lines.push(format!("{} vehicles left the road{routes}", self.out_of_road));
        }
        if self.unfinished > 0 {
            lines.push(format!(
                "{} vehicles had not arrived when their episode was cut off",
                self.unfinished
            ));
        }
        lines
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_leaves_the_road_is_told_by_route() {
        let mut first = Failures::default();
        first.leave("b");
        let mut second = first.clone();
        second.leave("a");
        second.leave("a");
        assert_eq!(first.plus(&second).describe(), ["4 vehicles left the road: a 2, b 2"]);
        let older = Failures { out_of_road: 3, ..Failures::default() };
        assert_eq!(older.describe(), ["3 vehicles left the road"]);
    }
}
