//! Linear axes: the range that the data needs, the positions of the ticks, and their labels.

use std::ops::Range;

use plotters::coord::ranged1d::{KeyPointHint, NoDefaultFormatting, Ranged, ValueFormatter};

/// Returns whether a number can be placed on an axis. Beyond the bound, pixel arithmetic and labels
/// are meaningless.
pub(super) fn usable(v: f64) -> bool {
    v.abs() <= 1e30
}

/// Returns the runs of consecutive present items.
pub(super) fn runs<T>(items: impl Iterator<Item = Option<T>>) -> Vec<Vec<T>> {
    let mut runs = vec![Vec::new()];
    for item in items {
        match (item, runs.last_mut()) {
            (Some(item), Some(run)) => run.push(item),
            _ => runs.push(Vec::new()),
        }
    }
    runs.retain(|run| !run.is_empty());
    runs
}

/// Returns the range of the usable values plus `margin` of its span on both sides. The range begins
/// at 0 if all values are non-negative and the smallest is close to 0. The range is never empty.
pub(super) fn enclosing(values: impl Iterator<Item = f64>, margin: f64) -> Range<f64> {
    let (low, high) = values
        .filter(|v| usable(*v))
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
    if low > high {
        return 0.0..1.0;
    }
    let span = high - low;
    if span <= low.abs().max(high.abs()) * 1e-6 {
        let half = if low == 0.0 { 1.0 } else { low.abs() * 0.1 };
        return low - half..high + half;
    }
    let from = if low >= 0.0 && low < 0.3 * high { 0.0 } else { low - margin * span };
    from..high + margin * span
}

/// A linear axis with round ticks. Values outside its range are placed at the nearer end.
#[derive(Clone)]
pub(super) struct Axis {
    pub(super) range: Range<f64>,
    pub(super) ticks: Vec<f64>,
    step: f64,
    /// Unit of the labels, and its letter (k, M, G).
    unit: (f64, &'static str),
}

impl Axis {
    /// Creates an axis with ticks at multiples of 1, 2 or 5 times a power of ten and about `count`
    /// intervals. `range` must not be empty.
    pub(super) fn new(range: Range<f64>, count: u32) -> Self {
        let rough = (range.end - range.start) / f64::from(count);
        let power = 10f64.powf(rough.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0]
            .map(|m| m * power)
            .into_iter()
            .find(|s| *s >= rough * 0.99)
            .unwrap_or(rough);
        let first = (range.start / step - 1e-6).ceil();
        let last = (range.end / step + 1e-6).floor();
        let ticks = (0..=(last - first).max(0.0) as u32)
            .map(|i| ((first + f64::from(i)) * step).clamp(range.start, range.end));
        let unit = match range.start.abs().max(range.end.abs()) {
            v if v >= 1e9 => (1e9, "G"),
            v if v >= 1e6 => (1e6, "M"),
            v if v >= 1e4 => (1e3, "k"),
            _ => (1.0, ""),
        };
        Self { ticks: ticks.collect(), range, step, unit }
    }

    pub(super) fn label(&self, value: f64) -> String {
        if value.abs() < self.step * 1e-3 {
            return "0".to_owned();
        }
        let (unit, letter) = self.unit;
        let largest = self.range.start.abs().max(self.range.end.abs());
        let text = if (1e-3..1e13).contains(&largest) {
            let decimals = (-(self.step / unit).log10() - 1e-9).ceil().clamp(0.0, 9.0) as usize;
            format!("{:.decimals$}{letter}", value / unit)
        } else {
            format!("{value:.1e}")
        };
        // The Unicode minus sign is as wide as a digit.
        text.replace('-', "\u{2212}")
    }
}

impl Ranged for Axis {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, (first, last): (i32, i32)) -> i32 {
        let share = (value - self.range.start) / (self.range.end - self.range.start);
        first + (share.clamp(0.0, 1.0) * f64::from(last - first)).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, hint: Hint) -> Vec<f64> {
        if hint.weight().allow_light_points() { Vec::new() } else { self.ticks.clone() }
    }

    fn range(&self) -> Range<f64> {
        self.range.clone()
    }
}

impl ValueFormatter<f64> for Axis {
    fn format(value: &f64) -> String {
        value.to_string()
    }

    fn format_ext(&self, value: &f64) -> String {
        self.label(*value)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(range: Range<f64>) -> Vec<String> {
        let axis = Axis::new(range, 5);
        axis.ticks.iter().map(|&v| axis.label(v)).collect()
    }

    #[test]
    fn ticks_are_round_and_readable() {
        assert_eq!(labels(0.0..200_000.0), ["0", "50k", "100k", "150k", "200k"]);
        assert_eq!(labels(0.0..1.0), ["0", "0.2", "0.4", "0.6", "0.8", "1.0"]);
        assert_eq!(labels(0.0..1_200_000.0), ["0", "0.5M", "1.0M"]);
        assert_eq!(labels(-20.0..30.0), ["\u{2212}20", "\u{2212}10", "0", "10", "20", "30"]);
        assert_eq!(labels(0.0..8_000.0), ["0", "2000", "4000", "6000", "8000"]);
        assert_eq!(labels(1e-5..6e-5)[0], "1.0e\u{2212}5");
        assert_eq!(labels(1e20..6e20)[0], "1.0e20");
    }

    #[test]
    fn ranges_enclose_the_usable_values_and_are_never_empty() {
        let nan = f64::NAN;
        assert_eq!(enclosing([].into_iter(), 0.1), 0.0..1.0);
        assert_eq!(enclosing([nan, f64::INFINITY].into_iter(), 0.1), 0.0..1.0);
        assert_eq!(enclosing([10.0, nan, 20.0].into_iter(), 0.1), 9.0..21.0);
        assert_eq!(enclosing([1.0, 21.0].into_iter(), 0.0), 0.0..21.0);
        assert_eq!(enclosing([5.0, 5.0].into_iter(), 0.1), 4.5..5.5);
        assert_eq!(enclosing([0.0].into_iter(), 0.1), -1.0..1.0);
    }

    #[test]
    fn missing_points_interrupt_the_line() {
        assert_eq!(
            runs([None, Some(1), Some(2), None, None, Some(3), None].into_iter()),
            [vec![1, 2], vec![3]]
        );
        assert!(runs([None::<i32>, None].into_iter()).is_empty());
    }
}
