//! The comparisons that a sweep names (`[[contrast]]`).

use std::fmt::Write as _;

use super::Error;
use super::document::Document;
use crate::curves::{self, Along};
use crate::metrics::Metric;
use crate::stats::Estimate;
use crate::stats::contrast::{Contrast as Found, contrast, holm};
use crate::sweep::{Cell, Compared, Contrast, Evaluate, Sweep};

/// Adds a table with a row per comparison. Comparisons whose runs are not all finished are made with
/// those that are, and say so.
pub(super) fn add(document: &mut Document, sweep: &Sweep) -> Result<(), Error> {
    if sweep.contrasts.is_empty() {
        return Ok(());
    }
    let rows: Vec<Row<'_>> =
        sweep.contrasts.iter().map(|contrast| row(sweep, contrast)).collect::<Result<_, _>>()?;
    // A comparison that has no p-value yet counts as one, since it was named.
    let found: Vec<f64> =
        rows.iter().map(|row| row.found.and_then(|found| found.p).unwrap_or(1.0)).collect();
    let corrected = holm(&found);
    document.heading(2, "Comparisons");
    document.text(
        "Differences of interquartile means over seeds, as the sweep file names them, with the 95 % intervals of a stratified \
         bootstrap with seeds as the unit, which are too narrow with fewer than five seeds in a group. Two-sided p-values are those \
         of a permutation test, or of the bootstrap where two differences are compared; the last column is corrected for all rows \
         together (Holm).",
    );
    let with_margin = rows.iter().any(|row| row.contrast.margin.is_some());
    if with_margin {
        document.text(
            "A difference is *within* the margin that the sweep file names if its whole interval is, and *beyond* it if none of its \
             interval is; otherwise, and with fewer than five runs in a group, the runs leave it open.",
        );
    }
    let table = rows.iter().zip(corrected).map(|(row, corrected)| {
        let mut cells = vec![row.contrast.title.clone(), row.heading(), row.runs()];
        match row.found {
            Some(found) => {
                let digits = row.metric.scale.digits;
                cells.push(format!("{:.digits$}", found.difference));
                let p = found.p.map(|p| [p, corrected]);
                cells.extend(p.map_or_else(|| ["–"; 2].map(str::to_owned), |p| p.map(chance)));
            }
            None => cells.extend(["–", "–", "–"].map(str::to_owned)),
        }
        cells.extend(with_margin.then(|| row.against_margin()));
        cells
    });
    let table = table.collect();
    let header = ["comparison", "metric", "runs", "difference", "p", "p (Holm)"];
    let header = header.into_iter().chain(with_margin.then_some("margin"));
    document.table(header.map(str::to_owned).collect(), table);
    Ok(())
}

/// Returns whether an interval lies within or beyond a margin around 0.
fn against(margin: f64, difference: Estimate) -> &'static str {
    let Estimate { low, high, .. } = difference;
    if low > -margin && high < margin {
        "within"
    } else if low > margin || high < -margin {
        "beyond"
    } else {
        "open"
    }
}

/// Number of runs in each group from which on the interval of the bootstrap is wide enough for a
/// verdict: where the difference is the margin, about one verdict in forty is "within" with five runs
/// in each of two groups, and one in ten with three.
const RUNS_FOR_MARGIN: usize = 5;

fn chance(p: f64) -> String {
    if p < 0.001 { "< 0.001".to_owned() } else { format!("{p:.3}") }
}

/// Numbers of runs of a group.
struct Count {
    all: usize,
    finished: usize,
    /// How many of the finished runs have the metric: those in which nobody arrives have no delay.
    with_value: usize,
}

/// A row of the table.
struct Row<'a> {
    contrast: &'a Contrast,
    metric: &'static Metric,
    counts: Vec<Count>,
    /// `None` if a group has fewer than two finished runs, or one without a value.
    found: Option<Found>,
}

impl Row<'_> {
    /// Returns what is compared.
    fn heading(&self) -> String {
        let heading = self.metric.heading();
        match self.contrast.of {
            Compared::Evaluation => heading,
            Compared::Training => format!("{heading} over training"),
        }
    }

    /// Returns whether the difference is within the margin, if there is one.
    fn against_margin(&self) -> String {
        let Some(margin) = self.contrast.margin else { return String::new() };
        let verdict = match self.found {
            None => "–",
            Some(_) if self.counts.iter().any(|group| group.finished < RUNS_FOR_MARGIN) => "open",
            Some(found) => against(margin, found.difference),
        };
        format!("{verdict} ±{margin}")
    }

    /// Returns the numbers of runs of the groups.
    fn runs(&self) -> String {
        let show = |&Count { all, finished, with_value }: &Count| {
            let mut text =
                if finished == all { all.to_string() } else { format!("{finished} of {all}") };
            if with_value < finished {
                let _ = write!(text, " ({} without a value)", finished - with_value);
            }
            text
        };
        self.counts.iter().map(show).collect::<Vec<_>>().join(", ")
    }
}

fn row<'a>(sweep: &'a Sweep, named: &'a Contrast) -> Result<Row<'a>, Error> {
    let evaluate = named.evaluation(&sweep.evaluations).expect("checked with the file");
    let metric = named.metric().expect("checked with the file");
    let (mut groups, mut counts) = (Vec::new(), Vec::new());
    let of = |when| named.cells(&sweep.cells, when, Some(evaluate));
    // Curves of runs with different limits are compared up to the largest.
    let longest = named.groups().flat_map(|(_, when)| of(when)).map(|cell| cell.config.steps);
    let end = longest.max().unwrap_or(0) as f64;
    for (weight, when) in named.groups() {
        let cells: Vec<&Cell> = of(when).collect();
        let found = match named.of {
            Compared::Evaluation => evaluated(&cells, named, evaluate, metric)?,
            Compared::Training => areas(&cells, metric, end)?,
        };
        let finished = found.len();
        let values: Vec<f64> = found.into_iter().flatten().collect();
        counts.push(Count { all: cells.len(), finished, with_value: values.len() });
        groups.push((weight, values));
    }
    // Without the runs that have no value, the others of their group would count for it.
    let whole = counts.iter().all(|count| count.with_value == count.finished);
    let found = if whole { contrast(&groups) } else { None };
    Ok(Row { contrast: named, metric, counts, found })
}

/// Returns a metric of the cells that have been evaluated; `None` of those without a value.
fn evaluated(
    cells: &[&Cell],
    named: &Contrast,
    evaluate: &Evaluate,
    metric: &Metric,
) -> Result<Vec<Option<f64>>, Error> {
    let combination = named.combination(evaluate).expect("checked with the file");
    let mut values = Vec::new();
    for cell in cells {
        let Some(found) = cell.evaluation(evaluate, &combination)? else { continue };
        let mean = metric.estimate(&found.metrics).map(|estimate| estimate.mean);
        values.push(mean.filter(|mean| !mean.is_nan()));
    }
    Ok(values)
}

/// Returns the areas under the curves of the cells that have been trained, up to step `end`; `None`
/// of those without a curve.
fn areas(cells: &[&Cell], metric: &Metric, end: f64) -> Result<Vec<Option<f64>>, Error> {
    let mut values = Vec::new();
    for cell in cells.iter().filter(|cell| cell.trained().is_some()) {
        let lines = curves::read(&cell.run().metrics())?;
        let curve = curves::curve(&lines, Along::Steps, metric, curves::Line::validation);
        values.push(curves::mean_height(&curve, end));
    }
    Ok(values)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn margins_are_kept_exceeded_or_left_open() {
        for (low, high, verdict) in [
            (-1.0, 1.5, "within"),
            (0.5, 1.9, "within"),
            (-1.0, 2.5, "open"),
            (-9.0, 9.0, "open"),
            (2.1, 4.0, "beyond"),
            (-4.0, -2.1, "beyond"),
        ] {
            let difference = Estimate { mean: f64::midpoint(low, high), low, high };
            assert_eq!(against(2.0, difference), verdict, "{low} {high}");
        }
    }
}
