//! Metrics that environments define by themselves.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::sync::Mutex;

use serde::{Deserialize, Serialize};

use super::Metrics;
use super::metric::{FINE, FINE_COUNT, Metric, PERCENT, Scale, Shown, Source};
use crate::env::{Better, EpisodeRecord, NamedEnvironment, OwnMetric, Values};
use crate::stats::Estimate;

/// A metric of an environment: mean with its 95 % interval over episodes, and which values are
/// better.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
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
    /// What the metric means; empty where the environment does not say it.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub meaning: String,
}

/// Summarises the metrics of an environment over episodes, by name.
pub(super) fn summary(
    metrics: &[OwnMetric],
    records: &[EpisodeRecord],
) -> BTreeMap<String, OwnEstimate> {
    let summary = |metric: &OwnMetric| {
        let values: Vec<f64> =
            records.iter().filter_map(|record| record.own.get(metric.name)).copied().collect();
        let OwnMetric { name, better, values: possible, meaning } = *metric;
        let estimate = match possible {
            Values::Rate => Estimate::rate(&values)?,
            Values::Any | Values::Positive => scale(possible).possible(Estimate::t(&values)?),
        };
        Some((
            name.to_owned(),
            OwnEstimate { estimate, better, values: possible, meaning: meaning.to_owned() },
        ))
    };
    metrics.iter().filter_map(summary).collect()
}

/// Returns the metrics that environments define by themselves, of all these results.
pub fn own<'a>(results: impl Iterator<Item = &'a Metrics>) -> Vec<&'static Metric> {
    let all: BTreeMap<&String, &OwnEstimate> = results.flat_map(|metrics| &metrics.own).collect();
    let entry = |(name, own): (&String, &OwnEstimate)| {
        registered(name, own.better, own.values, &own.meaning)
    };
    all.into_iter().map(entry).collect()
}

/// Returns the metrics that environments with a name define by themselves.
pub fn of_environments() -> impl Iterator<Item = &'static Metric> {
    let metrics = NamedEnvironment::all()
        .into_iter()
        .flat_map(|one| one.environment().spec().metrics.clone());
    let named: BTreeMap<&str, OwnMetric> = metrics.map(|metric| (metric.name, metric)).collect();
    named
        .into_values()
        .map(|metric| registered(metric.name, metric.better, metric.values, metric.meaning))
}

/// Returns the part of the reference about the built-in environments.
pub(super) fn reference() -> String {
    let mut text = String::from(
        "\n## Of built-in environments\n\nIn the JSON output they are under `own`; they are in the tables and figures of reports.\n\n\
         | environment | metric | key | better | meaning |\n|---|---|---|---|---|\n",
    );
    for named in NamedEnvironment::BUILT_IN.into_iter().filter_map(NamedEnvironment::find) {
        for OwnMetric { name, better, values, meaning } in &named.environment().spec().metrics {
            let heading = registered(name, *better, *values, meaning).heading();
            let (environment, better) = (named.name, super::metric::better(*better));
            let row = format!("| `{environment}` | {heading} | `{name}` | {better} | {meaning} |");
            let _ = writeln!(text, "{row}");
        }
    }
    text
}

/// Returns how the values of a metric are shown.
fn scale(values: Values) -> Scale {
    match values {
        Values::Any => FINE,
        Values::Positive => FINE_COUNT,
        Values::Rate => PERCENT,
    }
}

/// Returns the entry of a metric, which lives as long as the program.
fn registered(name: &str, better: Better, values: Values, meaning: &str) -> &'static Metric {
    static KNOWN: Mutex<Vec<&'static Metric>> = Mutex::new(Vec::new());
    let mut known = KNOWN.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    let explanation = match meaning {
        "" => "A metric that the environment defines by itself.",
        meaning => meaning,
    };
    let same = |m: &&&Metric| {
        let shown = (m.better, m.scale) == (better, scale(values));
        m.id == name && shown && m.explanation == explanation
    };
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
        explanation: forever(explanation.to_owned()),
        source: Source::Own,
    }));
    known.push(metric);
    metric
}
