//! The description of a metric in the registry.

use super::{KmPerCrash, Metrics};
pub use crate::env::Better;
use crate::env::MAX_TIME_APART;
use crate::stats::Estimate;

/// A metric of the registry.
#[derive(Debug, Clone, Copy)]
pub struct Metric {
    /// Key in the JSON output; the parts of a nested key are separated by dots.
    pub id: &'static str,
    /// Key of the mean in the validations of a training, in a run's `metrics.jsonl`.
    pub validation: &'static str,
    /// Heading in tables, without the unit.
    pub title: &'static str,
    /// Label of an axis, with the unit.
    pub axis: &'static str,
    /// Unit in which people see the metric.
    pub scale: Scale,
    /// Which values are better.
    pub better: Better,
    /// The outputs that show the metric.
    pub shown: Shown,
    /// Meaning of the metric, and how to read it.
    pub explanation: &'static str,
    pub(super) source: Source,
}

/// Where the estimate of a metric is.
#[derive(Debug, Clone, Copy)]
pub(super) enum Source {
    /// In a field of [`Metrics`] or of its parts.
    Field(fn(&Metrics) -> Option<Estimate>),
    /// Among the metrics that the environment defines by itself.
    Own,
}

/// How a number is shown.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scale {
    /// Unit of the shown number.
    pub unit: &'static str,
    /// Factor from the number in the JSON output to the shown number.
    pub factor: f64,
    /// Decimals in the table of `iwol evaluate`.
    pub digits: usize,
    /// Smallest and largest possible number in the JSON output.
    pub bounds: (f64, f64),
}

pub(super) const PERCENT: Scale = Scale { unit: "%", factor: 100.0, digits: 1, bounds: (0.0, 1.0) };
/// A number of any sign.
pub(super) const NUMBER: Scale =
    Scale { unit: "", factor: 1.0, digits: 1, bounds: (f64::NEG_INFINITY, f64::INFINITY) };
pub(super) const FINE: Scale = Scale { digits: 3, ..NUMBER };
pub(super) const COUNT: Scale = Scale { bounds: (0.0, f64::INFINITY), ..NUMBER };
pub(super) const FINE_COUNT: Scale = Scale { digits: 3, ..COUNT };
pub(super) const KILOMETRES: Scale = Scale { digits: 2, ..COUNT };
pub(super) const SECONDS: Scale = Scale { unit: "s", ..COUNT };
/// A time against driving at the speed limits: negative for who drives faster.
pub(super) const TIME_LOSS: Scale = Scale { unit: "s", ..NUMBER };
/// A time between two road users.
pub(super) const APART: Scale = Scale { digits: 3, bounds: (0.0, MAX_TIME_APART), ..SECONDS };
pub(super) const SPEED: Scale = Scale { unit: "m/s", digits: 2, ..COUNT };
pub(super) const BRAKING: Scale = Scale { unit: "m/s²", ..COUNT };

impl Scale {
    /// Returns an estimate whose interval contains only possible numbers. Infinite bounds, which
    /// say that the values give none, stay.
    pub(super) fn possible(&self, estimate: Estimate) -> Estimate {
        let (least, most) = self.bounds;
        let within = |bound: f64| if bound.is_finite() { bound.clamp(least, most) } else { bound };
        Estimate { low: within(estimate.low), high: within(estimate.high), ..estimate }
    }
}

/// The outputs that show a metric. Each output shows what the ones above it show.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Shown {
    /// Learning curves, and every report.
    Everywhere,
    /// Figures of reports, if results contain the metric.
    InFigures,
    /// Tables of reports, if results contain the metric.
    InTables,
    /// Only the output of `iwol evaluate`.
    InEvaluations,
}

impl Metric {
    /// Returns mean and interval in the shown unit; `None` if the results do not contain the
    /// metric.
    pub fn estimate(&self, metrics: &Metrics) -> Option<Estimate> {
        let e = self.unscaled(metrics)?;
        let factor = self.scale.factor;
        Some(Estimate { mean: factor * e.mean, low: factor * e.low, high: factor * e.high })
    }

    /// Returns mean and interval as the JSON output contains them; `None` if the results do not
    /// contain the metric.
    pub fn unscaled(&self, metrics: &Metrics) -> Option<Estimate> {
        let found = match self.source {
            Source::Field(field) => field(metrics),
            Source::Own => metrics.own.get(self.id).map(|own| own.estimate),
        };
        found.filter(|e| !e.mean.is_nan() || e.low.is_finite())
    }

    /// Returns the heading in tables, with the unit.
    pub fn heading(&self) -> String {
        format!("{} {}", self.title, self.scale.unit).trim_end().to_owned()
    }

    /// Returns whether an environment defines the metric by itself.
    pub fn is_own(&self) -> bool {
        matches!(self.source, Source::Own)
    }

    /// Returns whether the metric is a rate in percent.
    pub fn is_rate(&self) -> bool {
        self.scale == PERCENT
    }

    /// Returns the ends of the axis of a rate; `None` for other metrics.
    pub fn range(&self) -> Option<(f64, f64)> {
        self.is_rate().then_some((0.0, 100.0))
    }

    /// Returns an estimate in the shown unit whose interval contains only possible numbers.
    /// Infinite bounds, which say that the values give none, stay.
    pub fn possible(&self, estimate: Estimate) -> Estimate {
        let (least, most) = self.scale.bounds;
        let bounds = (self.scale.factor * least, self.scale.factor * most);
        Scale { bounds, ..self.scale }.possible(estimate)
    }
}

/// Returns how the reference says which values are better.
pub(super) fn better(better: Better) -> &'static str {
    match better {
        Better::Higher => "higher",
        Better::Lower => "lower",
        Better::Neither => "–",
    }
}

/// A field of [`Metrics`] that contains an estimate.
pub(super) trait Field: Sized {
    fn estimate(&self) -> Option<Estimate>;

    /// Returns the field with an interval of possible numbers only.
    fn possible(self, scale: &Scale) -> Self;
}

impl Field for Estimate {
    fn estimate(&self) -> Option<Estimate> {
        Some(*self)
    }

    fn possible(self, scale: &Scale) -> Self {
        scale.possible(self)
    }
}

impl Field for Option<Estimate> {
    fn estimate(&self) -> Option<Estimate> {
        *self
    }

    fn possible(self, scale: &Scale) -> Self {
        self.map(|estimate| scale.possible(estimate))
    }
}

impl Field for Option<KmPerCrash> {
    fn estimate(&self) -> Option<Estimate> {
        self.map(|driven| driven.estimate)
    }

    /// The exact interval needs no bounds.
    fn possible(self, _: &Scale) -> Self {
        self
    }
}
