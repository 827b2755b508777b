//! The comparisons that a sweep names (`[[contrast]]`).

use super::Error;
use super::document::Document;
use crate::curves::{self, Along};
use crate::metrics::Metric;
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
    let found: Vec<f64> = rows.iter().filter_map(|row| Some(row.found?.p)).collect();
    let mut corrected = holm(&found).into_iter();
    document.heading(2, "Comparisons");
    document.text(
        "Differences of interquartile means over seeds, as the sweep file names them, with 95 % intervals and two-sided p-values \
         of a stratified bootstrap with seeds as the unit, and p-values corrected for all rows together (Holm). With fewer than \
         about five seeds the intervals are too narrow and the p-values too small.",
    );
    let table = rows.iter().map(|row| {
        let mut cells = vec![row.contrast.title.clone(), row.heading(), row.runs()];
        match row.found {
            Some(found) => {
                cells.push(found.difference.to_string());
                cells.push(chance(found.p));
                cells.extend(corrected.next().map(chance));
            }
            None => cells.extend(["–", "–", "–"].map(str::to_owned)),
        }
        cells
    });
    let table = table.collect();
    let header = ["comparison", "metric", "runs", "difference", "p", "p (Holm)"];
    document.table(header.map(str::to_owned).to_vec(), table);
    Ok(())
}

fn chance(p: f64) -> String {
    if p < 0.001 { "< 0.001".to_owned() } else { format!("{p:.3}") }
}

/// A row of the table.
struct Row<'a> {
    contrast: &'a Contrast,
    metric: &'static Metric,
    /// Numbers of finished and of all runs of each group.
    counts: Vec<(usize, usize)>,
    /// `None` if a group has fewer than two finished runs.
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

    /// Returns the numbers of runs of the groups.
    fn runs(&self) -> String {
        let show = |&(finished, all): &(usize, usize)| {
            if finished == all { all.to_string() } else { format!("{finished} of {all}") }
        };
        self.counts.iter().map(show).collect::<Vec<_>>().join(", ")
    }
}

fn row<'a>(sweep: &'a Sweep, named: &'a Contrast) -> Result<Row<'a>, Error> {
    let evaluate = named.evaluation(&sweep.evaluations).expect("checked with the file");
    let metric = named.metric().expect("checked with the file");
    let (mut groups, mut counts) = (Vec::new(), Vec::new());
    for (weight, when) in named.groups() {
        let cells: Vec<&Cell> = named.cells(&sweep.cells, when, Some(evaluate)).collect();
        let values = match named.of {
            Compared::Evaluation => evaluated(&cells, named, evaluate, metric)?,
            Compared::Training => areas(&cells, metric)?,
        };
        counts.push((values.len(), cells.len()));
        groups.push((weight, values));
    }
    Ok(Row { contrast: named, metric, counts, found: contrast(&groups) })
}

/// Returns a metric of the cells that have been evaluated.
fn evaluated(
    cells: &[&Cell],
    named: &Contrast,
    evaluate: &Evaluate,
    metric: &Metric,
) -> Result<Vec<f64>, Error> {
    let combination = named.combination(evaluate).expect("checked with the file");
    let mut values = Vec::new();
    for cell in cells {
        let found = cell.evaluation(evaluate, &combination)?;
        let mean = found.and_then(|found| Some(metric.estimate(&found.metrics)?.mean));
        values.extend(mean.filter(|mean| !mean.is_nan()));
    }
    Ok(values)
}

/// Returns the areas under the curves of the cells that have been trained.
fn areas(cells: &[&Cell], metric: &Metric) -> Result<Vec<f64>, Error> {
    let mut values = Vec::new();
    for cell in cells.iter().filter(|cell| cell.trained().is_some()) {
        let lines = curves::read(&cell.run().metrics())?;
        let curve = curves::curve(&lines, Along::Steps, metric, curves::Line::validation);
        values.extend(curves::mean_height(&curve, cell.config.steps as f64));
    }
    Ok(values)
}
