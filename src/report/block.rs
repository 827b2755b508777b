//! The results of one evaluation of a sweep, sorted into lines and places.

use std::collections::BTreeMap;

use toml::Value;

use super::{Error, in_words};
use crate::metrics::{self, EvaluationResult, KmPerCrash, Knowledge, Metric, SUCCESS, Shown};
use crate::stats::aggregate::bootstrap;
use crate::stats::{self, Estimate};
use crate::sweep::{Cell, Evaluate, Reference, Sweep, plain};

/// One evaluation of all cells.
#[derive(Debug)]
pub(super) struct Block<'a> {
    pub(super) evaluate: &'a Evaluate,
    /// The key along the horizontal axis, if there is one.
    pub(super) x: Option<String>,
    /// The values of that key.
    pub(super) categories: Vec<String>,
    /// One line per combination of the other keys that vary, in the sweep's order.
    pub(super) series: Vec<Line<'a>>,
}

/// The results that form one line of a figure.
#[derive(Debug)]
pub(super) struct Line<'a> {
    pub(super) label: String,
    /// The label within the panel and the name of the panel; `None` if the figure has no panels of
    /// its own.
    pub(super) panel: Option<(String, String)>,
    /// One row per category.
    pub(super) rows: Vec<Row<'a>>,
}

/// The runs of all seeds at one place of a figure.
#[derive(Debug, Default)]
pub(super) struct Row<'a> {
    /// The cells at this place, each with its result; `None` until the cell is evaluated.
    pub(super) runs: Vec<(&'a Cell, Option<EvaluationResult>)>,
}

/// The unit of an interval: the values that count as independent. All intervals of one table or
/// figure have the same unit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Unit {
    /// Trained runs: Student's t interval of their mean, which says what another seed may give. The
    /// interval is a point if all runs have the same value.
    Seeds,
    /// The episodes of a single run: the interval says how that policy performs, not what another
    /// seed would give.
    Episodes,
    /// The episodes that all runs play, for rates: Wilson's interval of the mean over the runs,
    /// which is not a point even if all runs have the same value. All runs of a sweep are evaluated
    /// in the same episodes, so that their number is that of one run. The interval says how these
    /// policies perform, not what another seed would give.
    Together,
}

impl Unit {
    /// Returns the description of the unit in a table's heading.
    pub(super) fn describe(self) -> &'static str {
        match self {
            Self::Seeds => "± t-interval over seeds",
            Self::Episodes => "[interval] over the episodes of a single run",
            Self::Together => "[Wilson interval] over the episodes, which all runs play",
        }
    }
}

impl Block<'_> {
    /// Returns the metrics that an output of this block shows.
    pub(super) fn metrics(&self, output: Shown) -> impl Iterator<Item = &'static Metric> {
        let rows = || self.series.iter().flat_map(|line| &line.rows);
        let own = metrics::own(rows().flat_map(Row::finished).map(|found| &found.metrics));
        let finished = rows().flat_map(Row::finished).next().is_some();
        let promised = move |metric: &Metric| !finished && metric.shown == Shown::Everywhere;
        metrics::shown(output)
            .filter(move |metric| promised(metric) || self.has(metric))
            .chain(own.into_iter().filter(move |metric| metric.shown <= output))
    }

    fn has(&self, metric: &Metric) -> bool {
        self.series.iter().flat_map(|line| &line.rows).any(|row| !row.values(metric).is_empty())
    }

    /// Returns the unit of a figure's intervals: seeds, unless no line has several.
    pub(super) fn unit(&self) -> Unit {
        if self.series.iter().any(Line::has_seeds) { Unit::Seeds } else { Unit::Episodes }
    }
}

impl Line<'_> {
    /// Whether all runs at all places have a value of the metric.
    pub(super) fn is_whole(&self, metric: &Metric) -> bool {
        self.rows.iter().all(|row| row.is_complete() && row.values(metric).len() == row.runs.len())
    }

    /// Returns whether the sweep has several seeds of this line, finished or not.
    pub(super) fn has_seeds(&self) -> bool {
        self.rows.iter().any(|row| row.runs.len() > 1)
    }
}

impl Row<'_> {
    /// Returns whether all runs of this row are finished.
    pub(super) fn is_complete(&self) -> bool {
        !self.runs.is_empty() && self.runs.iter().all(|(_, found)| found.is_some())
    }

    fn finished(&self) -> impl Iterator<Item = &EvaluationResult> {
        self.runs.iter().filter_map(|(_, found)| found.as_ref())
    }

    /// Returns the mean of the metric of each finished run, in its shown unit.
    pub(super) fn values(&self, metric: &Metric) -> Vec<f64> {
        let mean = |found: &EvaluationResult| Some(metric.estimate(&found.metrics)?.mean);
        self.finished().filter_map(mean).filter(|mean| !mean.is_nan()).collect()
    }

    /// Returns mean and interval of a metric. Bounds are infinite where the unit gives none (a
    /// single seed, with seeds as the unit).
    pub(super) fn estimate(&self, metric: &Metric, unit: Unit) -> Option<Estimate> {
        let values = self.values(metric);
        match unit {
            Unit::Seeds => Some(metric.possible(Estimate::t(&values)?)),
            Unit::Episodes => {
                let mut finished = self.finished();
                let (only, None) = (finished.next()?, finished.next()) else { return None };
                metric.estimate(&only.metrics).filter(|e| !e.mean.is_nan())
            }
            Unit::Together => {
                let counted =
                    |found: &EvaluationResult| found.metrics.counted.unwrap_or(found.episodes);
                let episodes = self.finished().map(counted).max()?;
                let mean = stats::mean(&values)?;
                let rate = Estimate::rate_of(mean / 100.0, episodes)?;
                Some(Estimate { mean, low: 100.0 * rate.low, high: 100.0 * rate.high })
            }
        }
    }

    /// Returns whether several runs all have the same value.
    pub(super) fn is_tied(&self, metric: &Metric) -> bool {
        let values = self.values(metric);
        values.len() > 1 && values.iter().all(|value| *value == values[0])
    }

    /// Returns the distance per crash of each finished run whose result contains it.
    pub(super) fn km_per_crash(&self) -> Vec<KmPerCrash> {
        let driving = |found: &EvaluationResult| found.metrics.driving.as_ref()?.km_per_crash;
        self.finished().filter_map(driving).collect()
    }

    /// Returns, of each finished run, a number about what the latent explains of `target`.
    pub(super) fn known(&self, target: &str, of: fn(&Knowledge) -> Option<f64>) -> Vec<f64> {
        let of = |found: &EvaluationResult| {
            of(found.metrics.reconstruction.iter().find(|known| known.name == target)?)
        };
        self.finished().filter_map(of).collect()
    }
}

/// Sorts the results of one evaluation into lines and places.
pub(super) fn block<'a>(sweep: &'a Sweep, evaluate: &'a Evaluate) -> Result<Block<'a>, Error> {
    let varying: Vec<&str> = (sweep.keys.iter())
        .filter(|(key, count)| key != "seed" && (*count > 1 || key == "algorithm"))
        .map(|(key, _)| key.as_str())
        .chain(evaluate.grid.keys().map(String::as_str))
        .collect();
    let x = evaluate.x.clone().or_else(|| {
        let own: Vec<&String> = evaluate.grid.keys().collect();
        let many = || varying.iter().filter(|key| **key != "algorithm");
        match own[..] {
            [only] => Some(only.clone()),
            _ if varying.contains(&"agents") => Some("agents".to_owned()),
            _ => many().next().map(|key| (*key).to_owned()),
        }
    });
    for (what, key) in [("x", &evaluate.x), ("panels", &evaluate.panels)] {
        if let Some(key) = key.as_ref().filter(|key| !varying.contains(&key.as_str())) {
            return Err(Error::Axis { evaluate: evaluate.name.clone(), what, key: key.clone() });
        }
    }
    // Places are in the order of the grid.
    let axis = x.as_ref().and_then(|x| evaluate.grid.get(x).or_else(|| sweep.grid.get(x)));
    let axis = axis.and_then(Value::as_array).into_iter().flatten().map(plain);
    let mut categories: Vec<String> = Vec::new();
    for place in axis {
        let _ = position(&mut categories, place);
    }
    // Rows of each line, by place.
    let mut series: Vec<(Line<'a>, BTreeMap<usize, Row<'a>>)> = Vec::new();
    for cell in sweep.cells.iter().filter(|cell| evaluate.applies(cell)) {
        for combination in evaluate.combinations() {
            let value = |key: &str| {
                let own = combination.iter().find(|(own, _)| own == key).map(|(_, value)| value);
                own.or_else(|| cell.value(key)).map(plain)
            };
            let place = x.as_deref().and_then(value).unwrap_or_default();
            let mut parts = Vec::new();
            let mut panel = None;
            for key in &varying {
                let short = in_words(key);
                let evaluated = combination.iter().any(|(own, _)| own == key);
                // A policy that was trained at one value and is evaluated at another is not a seed
                // of the policy trained at the latter.
                if let Some(trained) = cell.value(key).filter(|_| evaluated) {
                    parts.push(format!("trained with {short} {}", plain(trained)));
                }
                let in_panels = evaluate.panels.as_deref() == Some(key);
                match value(key).filter(|_| Some(*key) != x.as_deref()) {
                    Some(value) if in_panels && *key == "algorithm" => panel = Some(value),
                    Some(value) if in_panels => panel = Some(format!("{short} {value}")),
                    Some(value) if *key == "algorithm" => parts.push(value),
                    Some(value) => parts.push(format!("{short} {value}")),
                    None => {}
                }
            }
            let mut label = Vec::new();
            for part in parts {
                position(&mut label, part);
            }
            let label =
                if label.is_empty() { cell.config.algorithm.clone() } else { label.join(", ") };
            let panel = panel.map(|panel| (label.clone(), panel));
            let label = panel.as_ref().map_or(label, |(label, panel)| format!("{label}, {panel}"));
            let category = position(&mut categories, place);
            let known = series.iter().position(|(own, _)| own.label == label);
            let line = known.unwrap_or_else(|| {
                series.push((Line { label, panel, rows: Vec::new() }, BTreeMap::new()));
                series.len() - 1
            });
            let found = cell.evaluation(evaluate, &combination)?;
            series[line].1.entry(category).or_default().runs.push((cell, found));
        }
    }
    let used = |k: &usize| series.iter().any(|(_, rows)| rows.contains_key(k));
    let used: Vec<usize> = (0..categories.len()).filter(used).collect();
    let categories = used.iter().map(|&k| categories[k].clone()).collect();
    let line = |(line, mut rows): (Line<'a>, BTreeMap<usize, Row<'a>>)| Line {
        rows: used.iter().map(|k| rows.remove(k).unwrap_or_default()).collect(),
        ..line
    };
    Ok(Block { evaluate, x, categories, series: series.into_iter().map(line).collect() })
}

fn position(known: &mut Vec<String>, value: String) -> usize {
    known.iter().position(|own| *own == value).unwrap_or_else(|| {
        known.push(value);
        known.len() - 1
    })
}

/// Checks that published values which stand beside a line name one of the evaluation.
pub(super) fn check_references(sweep: &Sweep, block: &Block<'_>) -> Result<(), Error> {
    let labels = || block.series.iter().map(|line| line.label.as_str());
    let unknown = |reference: &&Reference| {
        !reference.beside.is_empty() && !labels().any(|label| label == reference.beside)
    };
    match references_of(sweep, block.evaluate).find(unknown) {
        None => Ok(()),
        Some(reference) => Err(Error::Beside {
            reference: reference.label.clone(),
            beside: reference.beside.clone(),
            series: labels().map(str::to_owned).collect(),
        }),
    }
}

/// Returns the published values that belong to an evaluation.
fn references_of<'a>(
    sweep: &'a Sweep,
    evaluate: &'a Evaluate,
) -> impl Iterator<Item = &'a Reference> {
    let first = sweep.evaluations.first().map(|e| e.name.as_str());
    let own = move |r: &&Reference| r.evaluate.as_deref().or(first) == Some(&evaluate.name[..]);
    sweep.references.iter().filter(own)
}

/// Returns the published values for this evaluation and metric, as
/// `(reference, [(category, value)])`.
pub(super) fn references<'a>(
    sweep: &'a Sweep,
    block: &'a Block<'_>,
    metric: &'a Metric,
) -> impl Iterator<Item = (&'a Reference, Vec<(usize, f64)>)> {
    references_of(sweep, block.evaluate).filter(move |r| r.metric == metric.id).map(move |r| {
        let number = |value: &Value| plain(value).parse::<f64>().ok();
        let place = |x: &Value| {
            let same =
                |c: &String| *c == plain(x) || number(x).is_some_and(|x| c.parse::<f64>() == Ok(x));
            block.categories.iter().position(same)
        };
        if r.x.is_empty() && block.categories.len() == 1 {
            return (r, r.y.iter().take(1).map(|y| (0, y * metric.scale.factor)).collect());
        }
        let points =
            r.x.iter().zip(&r.y).filter_map(|(x, y)| Some((place(x)?, y * metric.scale.factor)));
        (r, points.collect())
    })
}

/// Returns the seeds' scores per category: the strata of the bootstrap.
pub(super) fn scores(line: &Line<'_>, metric: &Metric) -> Vec<Vec<f64>> {
    line.rows.iter().map(|row| row.values(metric)).collect()
}

/// Returns whether a bootstrap over seeds is meaningful: every place has at least two seeds.
pub(super) fn resamples(line: &Line<'_>) -> bool {
    line.rows.iter().all(|row| row.values(SUCCESS).len() > 1)
}

impl Block<'_> {
    /// Returns whether every place contains the same trained runs.
    pub(super) fn same_runs(&self) -> bool {
        self.x.as_ref().is_some_and(|x| self.evaluate.grid.contains_key(x))
    }
}

/// Returns an aggregate over seeds and places with its interval; the bounds are infinite without a
/// second seed.
pub(super) fn aggregate(
    line: &Line<'_>,
    metric: &Metric,
    same_runs: bool,
    of: &dyn Fn(&[Vec<f64>]) -> f64,
) -> Option<Estimate> {
    let scores = scores(line, metric);
    if resamples(line) {
        return bootstrap([&scores], same_runs, |[drawn]| of(drawn));
    }
    let mean = of(&scores);
    mean.is_finite().then_some(Estimate { mean, low: f64::NEG_INFINITY, high: f64::INFINITY })
}
