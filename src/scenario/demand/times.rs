//! Times of departures: how route files give them, and which of them fall into an episode.

use roxmltree::Node;

use super::super::Error;
use super::super::reader::{Reader, finite};
use super::{PlannedSource, Source, Spacing};

/// Largest number of vehicles or persons of a flow.
const MAX_NUMBER: u64 = 1_000_000;
/// Duration for which SUMO lets a flow with a `number` and without an `end` depart \[s\].
const DAY: f64 = 86_400.0;

impl PlannedSource {
    /// Returns the expected number of departures within the first `horizon` seconds of an episode.
    pub fn expected_number(&self, horizon: f64) -> f64 {
        let time = (self.end.min(horizon) - self.begin).max(0.0);
        let number = match self.spacing {
            Spacing::Equal(gap) => (time / gap).floor() + 1.0,
            Spacing::Poisson(rate) => time * rate,
            Spacing::Chance(chance) => time * chance,
        };
        number.min(self.number as f64)
    }
}

impl Source {
    /// Returns the first departure in an episode that begins at `begin` of the files' time, counted
    /// from the start of the episode \[s\], and the largest number of departures from then on.
    /// `None`: nobody departs in the `horizon` seconds of the episode.
    pub(super) fn within(&self, begin: f64, horizon: f64) -> Option<(f64, u64)> {
        let mut first = self.begin - begin;
        let mut number = self.number;
        if first < 0.0 {
            match self.spacing {
                Spacing::Equal(gap) => {
                    // The margin is half a millisecond, as SUMO's times are whole milliseconds.
                    let missed = ((-first - 5e-4) / gap).ceil().max(0.0);
                    number = number.saturating_sub(missed as u64);
                    first = (first + missed * gap).max(0.0);
                }
                Spacing::Poisson(_) | Spacing::Chance(_) => first = 0.0,
            }
        }
        (number > 0 && first <= horizon && first < self.end - begin).then_some((first, number))
    }
}

/// Duration for which SUMO lets a flow depart that ends where it begins \[s\].
const MOMENT: f64 = 0.001;

impl PlannedSource {
    /// Returns the times at which vehicles or persons depart before `end` \[s\], random ones at their
    /// mean intervals.
    pub(in crate::scenario) fn expected(&self, end: f64) -> impl Iterator<Item = f64> {
        let gap = match self.spacing {
            Spacing::Equal(gap) => gap,
            Spacing::Poisson(rate) | Spacing::Chance(rate) => 1.0 / rate,
        };
        let (begin, end) = (self.begin, self.end.min(end));
        let times = (0..self.number).map(move |i| begin + i as f64 * gap);
        times.take_while(move |&time| time < end)
    }
}

/// Returns the times between a flow's departures, the largest number of departures, and their end.
pub(super) fn departures(
    reader: &Reader,
    node: Node,
    begin: f64,
    end: f64,
) -> Result<(Spacing, u64, f64), Error> {
    let mut given = ["period", "vehsPerHour", "personsPerHour", "perHour", "probability"]
        .into_iter()
        .filter(|key| node.has_attribute(*key));
    let (first, second) = (given.next(), given.next());
    if let (Some(first), Some(second)) = (first, second) {
        return Err(reader.value(node, second, format!("no value beside `{first}`")));
    }
    let number = match node.attribute("number") {
        None => u64::MAX,
        Some(text) => {
            let allowed = format!("whole number from 0 to {MAX_NUMBER}");
            let number = text.trim().parse::<u64>().ok().filter(|number| *number <= MAX_NUMBER);
            number.ok_or_else(|| reader.value(node, "number", allowed))?
        }
    };
    let spacing = match first {
        Some("period") => {
            let text = reader.text(node, "period")?;
            let gap = |text: &str| finite(text).filter(|v| (0.001..=1e6).contains(v));
            let rate = |text: &str| finite(text).filter(|v| (1e-6..=1e6).contains(v));
            let random = text.strip_prefix("exp(").and_then(|rest| rest.strip_suffix(')'));
            let found = match random {
                Some(text) => rate(text).map(Spacing::Poisson),
                None => gap(text).map(Spacing::Equal),
            };
            let allowed = "seconds from 0.001 to 1000000, or exp(vehicles per second)";
            found.ok_or_else(|| reader.value(node, "period", allowed))?
        }
        Some("probability") => {
            let allowed = "number above 0, up to 1";
            Spacing::Chance(reader.number(node, "probability", allowed, |v| v > 0.0 && v <= 1.0)?)
        }
        Some(key) => {
            let allowed = "number above 0, up to 1000000";
            Spacing::Equal(3600.0 / reader.number(node, key, allowed, |v| v > 0.0 && v <= 1e6)?)
        }
        None if number < u64::MAX => {
            let duration = if end.is_finite() { (end - begin).max(MOMENT) } else { DAY };
            Spacing::Equal(duration / number.max(1) as f64)
        }
        None => return Err(reader.missing(node, "attribute", "period")),
    };
    // As for SUMO, all of such a flow depart together if it has a number, and nobody otherwise.
    match first {
        _ if end > begin => Ok((spacing, number, end)),
        None => Ok((spacing, number, begin + MOMENT)),
        Some(_) => Ok((spacing, 0, end)),
    }
}

/// Returns the seconds of a time such as `12.5`, `1:02:03` or `1:00:00:00`.
pub(in crate::scenario) fn seconds(text: &str) -> Option<f64> {
    let parts: Option<Vec<f64>> =
        text.trim().split(':').map(|part| finite(part).filter(|v| *v >= 0.0)).collect();
    match parts?[..] {
        [s] => Some(s),
        [h, m, s] => Some((h * 60.0 + m) * 60.0 + s),
        [d, h, m, s] => Some(((d * 24.0 + h) * 60.0 + m) * 60.0 + s),
        _ => None,
    }
}

/// Returns the time of an attribute \[s\].
pub(super) fn time(reader: &Reader, node: Node, key: &str, otherwise: f64) -> Result<f64, Error> {
    match node.attribute(key) {
        None => Ok(otherwise),
        Some(text) => {
            seconds(text).ok_or_else(|| reader.value(node, key, "seconds of at least 0, or h:m:s"))
        }
    }
}
