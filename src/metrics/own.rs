//! Metrics that environments define by themselves.

use std::collections::BTreeMap;
use std::sync::Mutex;

use serde::{Deserialize, Serialize};

use super::Metrics;
use super::metric::{FINE, FINE_COUNT, Metric, PERCENT, Scale, Shown, Source};
use crate::env::{Better, EpisodeRecord, NamedEnvironment, OwnMetric, Values};
use crate::stats::Estimate;

/// A metric of an environment: mean with its 95 % interval over episodes, and which values are
/// better.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct OwnEstimate {
    /// Mean and interval.
    #[serde(flatten)]
    pub estimate: Estimate,
    /// Which values are better.
    #[serde(default)]
    pub better: Better,
    /// Which values are possible.
    #[serde(default)]
    pub values: Values,
}

/// Summarises the metrics of an environment over episodes, by name.
pub(super) fn summary(
    metrics: &[OwnMetric],
    records: &[EpisodeRecord],
) -> BTreeMap<String, OwnEstimate> {
    let summary = |metric: &OwnMetric| {
        let values: Vec<f64> =
            records.iter().filter_map(|record| record.own.get(metric.name)).copied().collect();
        let OwnMetric { name, better, values: possible, .. } = *metric;
        let estimate = match possible {
            Values::Rate => Estimate::rate(&values)?,
            Values::Any | Values::Positive => scale(possible).possible(Estimate::t(&values)?),
        };
        Some((name.to_owned(), OwnEstimate { estimate, better, values: possible }))
    };
    metrics.iter().filter_map(summary).collect()
}

/// Returns the metrics that environments define by themselves, of all these results.
pub fn own<'a>(results: impl Iterator<Item = &'a Metrics>) -> Vec<&'static Metric> {
    let all: BTreeMap<&String, &OwnEstimate> = results.flat_map(|metrics| &metrics.own).collect();
    all.into_iter().map(|(name, own)| registered(name, own.better, own.values)).collect()
}

/// Returns the metrics that environments with a name define by themselves.
pub fn of_environments() -> impl Iterator<Item = &'static Metric> {
    let metrics = NamedEnvironment::all()
        .into_iter()
        .flat_map(|one| one.environment().spec().metrics.clone());
    let named: BTreeMap<&str, OwnMetric> = metrics.map(|metric| (metric.name, metric)).collect();
    named.into_values().map(|metric| registered(metric.name, metric.better, metric.values))
}

/// Returns how the values of a metric are shown.
fn scale(values: Values) -> Scale {
    match values {
        Values::Any => FINE,
        Values::Positive => FINE_COUNT,
        Values::Rate => PERCENT,
    }
}

/// Returns what a metric means, if an environment with a name says so.
fn meaning(name: &str) -> &'static str {
    let metrics = NamedEnvironment::all()
        .into_iter()
        .flat_map(|one| one.environment().spec().metrics.clone());
    let known = metrics.filter(|metric| metric.name == name).map(|metric| metric.meaning);
    known
        .into_iter()
        .find(|meaning| !meaning.is_empty())
        .unwrap_or("A metric that the environment defines by itself.")
}

/// Returns the entry of a metric, which lives as long as the program.
fn registered(name: &str, better: Better, values: Values) -> &'static Metric {
    static KNOWN: Mutex<Vec<&'static Metric>> = Mutex::new(Vec::new());
    let mut known = KNOWN.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    let same = |m: &&&Metric| m.id == name && m.better == better && m.scale == scale(values);
    if let Some(metric) = known.iter().find(same) {
        return metric;
    }
    let forever = |text: String| -> &'static str { Box::leak(text.into_boxed_str()) };
    let title = forever(name.replace('_', " "));
    let metric: &'static Metric = Box::leak(Box::new(Metric {
        id: forever(name.to_owned()),
        validation: forever(format!("validation/{name}")),
        title,
        axis: title,
        scale: scale(values),
        better,
        shown: Shown::InFigures,
        explanation: meaning(name),
        source: Source::Own,
    }));
    known.push(metric);
    metric
}
