//! Learning curves: what the validations of a run measured against steps or time, and the mean of
//! several runs.

#![cfg(feature = "learn")]

use std::path::Path;

use serde::Deserialize;

use crate::metrics::Metric;
use crate::plot::Series;
use crate::record::{self, JsonObject, read_json_lines};
use crate::stats::aggregate::sample_efficiency;

/// Number of intervals at whose bounds the mean of curves over time is sampled.
const TIMES: usize = 60;

/// A line of a run's `metrics.jsonl`.
#[derive(Debug, Clone, Deserialize)]
pub struct Line {
    /// Environment steps of the training so far.
    pub step: u64,
    /// Duration of rollouts and updates so far \[s\].
    #[serde(rename = "time/total_s")]
    pub seconds: Option<f64>,
    #[serde(flatten)]
    values: JsonObject,
}

impl Line {
    /// Returns the mean of a metric in a validation, as the file contains it; `None` if the line
    /// does not describe a validation.
    pub fn validation(&self, metric: &Metric) -> Option<f64> {
        self.values.get(metric.validation)?.as_f64()
    }

    /// Returns the mean of a metric in the training episodes that ended in this iteration, as the
    /// file contains it.
    pub fn exploration(&self, metric: &Metric) -> Option<f64> {
        self.values.get(&format!("episode/{}", metric.id))?.as_f64()
    }
}

/// Reads the lines of a run's `metrics.jsonl`.
///
/// # Errors
/// [`record::Error`] if the file cannot be read or is damaged.
pub fn read(path: &Path) -> Result<Vec<Line>, record::Error> {
    read_json_lines(path)
}

/// Quantity along the horizontal axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Along {
    /// Environment steps.
    Steps,
    /// Minutes of training (rollouts and updates).
    Minutes,
}

impl Along {
    /// Returns the label of the axis.
    pub fn label(self) -> &'static str {
        match self {
            Self::Steps => "environment steps",
            Self::Minutes => "minutes of training",
        }
    }
}

/// Points `(x, y)` in the order of `x`.
pub type Curve = Vec<(f64, f64)>;

/// Returns the curve of a metric, in its shown unit; `of` is [`Line::validation`] or
/// [`Line::exploration`].
pub fn curve(
    lines: &[Line],
    along: Along,
    metric: &Metric,
    of: fn(&Line, &Metric) -> Option<f64>,
) -> Curve {
    let point = |line: &Line| {
        let x = match along {
            Along::Steps => line.step as f64,
            Along::Minutes => line.seconds? / 60.0,
        };
        Some((x, metric.scale.factor * of(line, metric)?))
    };
    lines.iter().filter_map(point).collect()
}

/// Returns the mean height of a curve from 0 to `end`, the area under it divided by `end`. The first
/// value also holds before it, and a run that ended early keeps its last value. `None` for an empty
/// curve.
pub fn mean_height(curve: &[(f64, f64)], end: f64) -> Option<f64> {
    let (first, last) = (curve.first()?, curve.last()?);
    let end = end.max(last.0);
    let between = curve.windows(2).map(|pair| {
        let [(from, low), (to, high)] = [pair[0], pair[1]];
        (to - from) * f64::midpoint(low, high)
    });
    Some((first.0 * first.1 + between.sum::<f64>() + (end - last.0) * last.1) / end)
}

/// Returns where a curve reached `level` for good: the place of its first point after which no point
/// is lower. `None` if the last point is.
pub fn reached_for_good(curve: &[(f64, f64)], level: f64) -> Option<f64> {
    let high = curve.iter().rev().take_while(|(_, y)| *y >= level).count();
    curve[curve.len() - high..].first().map(|(x, _)| *x)
}

/// Returns the mean curve of several runs of a metric with its 95 % interval, which contains
/// only possible numbers; of a single run, the curve itself. A run that ended before the others keeps its
/// last value.
pub fn mean_curve(label: String, runs: &[Curve], along: Along, metric: &Metric) -> Series {
    if let [only] = runs {
        return Series::curve(label, only.clone(), None);
    }
    let mut places: Vec<f64> = runs.iter().flatten().map(|point| point.0).collect();
    places.sort_by(f64::total_cmp);
    places.dedup();
    if along == Along::Minutes {
        // Runs are validated at different times, so the curves are sampled at evenly spaced times.
        let (first, last) =
            (places.first().copied().unwrap_or(0.0), places.last().copied().unwrap_or(0.0));
        places = (0..=TIMES).map(|k| first + (last - first) * k as f64 / TIMES as f64).collect();
    }
    let curve = sample_efficiency(runs, &places);
    let points = curve.iter().map(|(x, e)| (*x, e.mean)).collect();
    let bounds = curve.iter().map(|(x, e)| (*x, metric.possible(*e)));
    let band = bounds.map(|(x, e)| (x, e.low, e.high)).collect();
    Series::curve(label, points, Some(band))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mean_height_is_the_area_under_the_curve() {
        let curve = [(10.0, 20.0), (20.0, 40.0), (40.0, 100.0)];
        // 10 · 20 + 10 · 30 + 20 · 70 + 10 · 100, divided by 50.
        assert_eq!(mean_height(&curve, 50.0), Some(58.0));
        assert_eq!(mean_height(&curve, 30.0), mean_height(&curve, 40.0));
        assert_eq!(mean_height(&[], 5.0), None);
    }

    #[test]
    fn a_level_is_reached_for_good_when_no_later_point_is_lower() {
        let curve = [(1.0, 50.0), (2.0, 98.0), (3.0, 97.0), (4.0, 97.1), (5.0, 99.0)];
        assert_eq!(reached_for_good(&curve, 97.1), Some(4.0));
        assert_eq!(reached_for_good(&curve, 97.0), Some(2.0));
        assert_eq!(reached_for_good(&curve, 99.5), None);
        assert_eq!(reached_for_good(&[], 0.0), None);
    }
}
