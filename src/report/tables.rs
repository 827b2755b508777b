//! Tables of a report.

use std::fmt::Write as _;

use super::block::{Block, Line, Row, Unit, aggregate, references, resamples, scores};
use super::document::Document;
use super::in_words;
use crate::metrics::{EvaluationResult, KmPerCrash, Knowledge, Metric, SUCCESS, Shown};
use crate::stats::aggregate::{
    bootstrap, interquartile_mean, median, optimality_gap, probability_of_improvement, task_mean,
};
use crate::stats::{self, Estimate};
use crate::sweep::{State, Sweep};
use crate::words::counted;

/// Adds the command that makes the report, and the numbers of runs that are finished, trained and
/// failed.
pub(super) fn introduce(document: &mut Document, sweep: &Sweep, command: &str) {
    document.code(command);
    let states: Vec<State> =
        sweep.cells.iter().map(|cell| cell.state(&sweep.evaluations)).collect();
    let finished = states.iter().filter(|state| **state == State::Finished).count();
    let mut text = format!("{finished} of {} are finished", counted(states.len(), "run"));
    let trained = states.iter().filter(|state| matches!(state, State::Trained(_))).count();
    if trained > 0 {
        let _ = write!(text, ", {trained} more are trained, with evaluations missing");
    }
    let failed = states.iter().filter(|state| matches!(state, State::Failed(_))).count();
    if failed > 0 {
        let _ = write!(text, ", {failed} failed");
    }
    text += ". Intervals are 95 % intervals. The heading of each table names their unit: trained runs (seeds), or the episodes of \
             a single run, which say nothing about other seeds. Policies act deterministically, in episodes that training \
             and validation do not use.";
    document.text(text);
}

/// Adds one table per metric, with a row per line and a column per place, and published values
/// below. If there is only one place, a single table has a column per metric. Lines with several
/// seeds and lines with one seed get separate tables, because their intervals have different units.
pub(super) fn results(document: &mut Document, sweep: &Sweep, block: &Block<'_>) {
    let (several, single): (Vec<&Line<'_>>, Vec<&Line<'_>>) =
        block.series.iter().partition(|line| line.has_seeds());
    let metrics: Vec<&Metric> = block.metrics(Shown::InTables).collect();
    let tables: Vec<Vec<&Metric>> = if block.x.is_none() {
        vec![metrics]
    } else {
        metrics.into_iter().map(|metric| vec![metric]).collect()
    };
    for metrics in tables {
        let mut published = true;
        for (lines, unit) in [(&several, Unit::Seeds), (&single, Unit::Episodes)] {
            if !lines.is_empty() {
                table(
                    document,
                    sweep,
                    block,
                    (lines, &metrics, unit),
                    std::mem::take(&mut published),
                );
            }
        }
        // Rates of background traffic are over the episodes that had some, whose number is not known
        // here.
        let pooled = |metric: &&Metric| metric.is_rate() && !metric.id.contains('.');
        let ties = |metric: &&Metric| {
            pooled(metric)
                && several.iter().flat_map(|line| &line.rows).any(|row| row.is_tied(metric))
        };
        let rates: Vec<&Metric> = metrics.iter().copied().filter(|metric| pooled(metric)).collect();
        if rates.iter().any(ties) {
            document.text(
                "Where all seeds have the same result, the interval over seeds is a point. The following table has intervals \
                 over episodes. They apply to these policies and say nothing about other seeds:",
            );
            table(document, sweep, block, (&several, &rates, Unit::Together), false);
        }
    }
}

/// Adds a table of some lines and metrics with intervals of one unit, and published values below if
/// `published`.
fn table(
    document: &mut Document,
    sweep: &Sweep,
    block: &Block<'_>,
    (lines, metrics, unit): (&[&Line<'_>], &[&Metric], Unit),
    published: bool,
) {
    let places = block.categories.len();
    let mut rows: Vec<Vec<String>> = Vec::new();
    for line in lines {
        let cells =
            metrics.iter().flat_map(|metric| line.rows.iter().map(|row| cell(row, metric, unit)));
        rows.push(std::iter::once(line.label.clone()).chain(cells).collect());
    }
    for (number, metric) in metrics.iter().enumerate().filter(|_| published) {
        for (reference, points) in references(sweep, block, metric) {
            let known = (lines.len()..rows.len()).find(|&i| rows[i][0] == reference.label);
            let row = known.unwrap_or_else(|| {
                rows.push(vec!["–".to_owned(); metrics.len() * places + 1]);
                rows.len() - 1
            });
            rows[row][0].clone_from(&reference.label);
            for (place, value) in points {
                let digits = metric.scale.digits;
                rows[row][1 + number * places + place] = format!("{value:.digits$}");
            }
        }
    }
    let unit = unit.describe();
    let header: Vec<String> = match (axis(block), metrics) {
        (Some(axis), [metric]) => {
            let title = format!("{} at {axis} ({unit})", metric.heading());
            std::iter::once(title).chain(block.categories.iter().cloned()).collect()
        }
        _ => std::iter::once(unit.to_owned())
            .chain(metrics.iter().map(|metric| metric.heading()))
            .collect(),
    };
    document.table(header, rows);
}

/// Returns the name in words of the key along the horizontal axis; `None` without an axis.
fn axis(block: &Block<'_>) -> Option<String> {
    block.x.as_deref().map(in_words)
}

/// Formats mean ± half width over seeds, or mean and interval in brackets over episodes; for a
/// single seed only the mean.
fn cell(row: &Row<'_>, metric: &Metric, unit: Unit) -> String {
    let Some(e) = row.estimate(metric, unit) else { return "–".to_owned() };
    let values = row.values(metric);
    let partial = partial(row, values.len());
    let digits = metric.scale.digits;
    match unit {
        Unit::Seeds => format!("{}{partial}", over_seeds(&values, digits)),
        Unit::Episodes | Unit::Together => format!("{e:.digits$}{partial}"),
    }
}

/// Returns how many of a row's runs have a value, unless all have one.
fn partial(row: &Row<'_>, values: usize) -> String {
    let runs = row.runs.len();
    if values < runs { format!(" ({values} of {runs})") } else { String::new() }
}

/// Formats mean ± half the width of the t-interval over seeds; for a single value only the mean,
/// without values a dash.
fn over_seeds(values: &[f64], digits: usize) -> String {
    match Estimate::t(values) {
        None => "–".to_owned(),
        Some(e) if e.high.is_infinite() => format!("{:.digits$}", e.mean),
        Some(e) => format!("{:.digits$} ± {:.digits$}", e.mean, e.high - e.mean),
    }
}

/// Formats the distance per crash: of one run with the exact interval of its count; of several runs
/// together, whose rates may differ, with the crashes of each and without an interval. Where no run
/// has a crash, there is the lower bound of the interval of all kilometres.
fn per_crash(row: &Row<'_>) -> String {
    let runs = row.km_per_crash();
    let km: f64 = runs.iter().map(|run| run.km).sum();
    let crashes = runs.iter().fold(0_u64, |sum, run| sum.saturating_add(run.crashes));
    let Some(together) = KmPerCrash::new(km, crashes) else { return "–".to_owned() };
    let counts = runs.iter().map(|run| run.crashes.to_string()).collect::<Vec<_>>().join(", ");
    let ratio = if runs.len() == 1 || crashes == 0 {
        format!("{:.2}", together.estimate)
    } else {
        format!("{:.2}", together.estimate.mean)
    };
    format!("{ratio} ({counts} in {km:.1} km){}", partial(row, runs.len()))
}

/// Adds the distance per crash, over all episodes of a place together.
pub(super) fn kilometres(document: &mut Document, block: &Block<'_>) {
    let rows: Vec<Vec<String>> = (block.series.iter())
        .map(|line| {
            let cells = line.rows.iter().map(per_crash);
            std::iter::once(line.label.clone()).chain(cells).collect()
        })
        .collect();
    if rows.iter().flat_map(|row| &row[1..]).all(|cell| cell == "–") {
        return;
    }
    let at = axis(block).map_or_else(String::new, |axis| format!(" at {axis}"));
    let unit = if block.unit() == Unit::Seeds {
        "all runs together; in parentheses the crashes of each run"
    } else {
        "[exact Poisson interval]"
    };
    let title = format!("km per crash{at} ({unit})");
    let places =
        if at.is_empty() { vec!["km per crash".to_owned()] } else { block.categories.clone() };
    document.table(std::iter::once(title).chain(places).collect(), rows);
}

/// A number about what a latent explains.
type Number = fn(&Knowledge) -> Option<f64>;

/// Adds what the latents explain, compared with a linear probe from the observation, in total and
/// of the features that the observation does not determine.
pub(super) fn knowledge(document: &mut Document, block: &Block<'_>) {
    for target in ["world", "interaction"] {
        let mut rows: Vec<Vec<String>> = Vec::new();
        for line in &block.series {
            for (category, row) in block.categories.iter().zip(&line.rows) {
                let finished = row.known(target, |k| Some(k.explained)).len();
                if finished == 0 {
                    continue;
                }
                let partial = partial(row, finished);
                let percent = |of: Number| {
                    let values: Vec<f64> =
                        row.known(target, of).iter().map(|share| 100.0 * share).collect();
                    over_seeds(&values, 1)
                };
                let features = |of: Number| {
                    let mean = stats::mean(&row.known(target, of));
                    mean.map_or_else(|| "–".to_owned(), |mean| format!("{mean:.0}"))
                };
                let place =
                    if category.is_empty() { String::new() } else { format!(", {category}") };
                rows.push(vec![
                    format!("{}{place}{partial}", line.label),
                    percent(|k| Some(k.explained)),
                    percent(|k| Some(k.probe.as_ref()?.explained)),
                    format!(
                        "{} of {}",
                        features(|k| Some(k.probe.as_ref()?.undetermined as f64)),
                        features(|k| Some(k.probe.as_ref()?.features as f64))
                    ),
                    percent(|k| k.probe.as_ref()?.undetermined_explained),
                    percent(|k| k.probe.as_ref()?.undetermined_probe_explained),
                ]);
            }
        }
        if rows.is_empty() {
            continue;
        }
        let unit =
            if block.unit() == Unit::Seeds { "± t-interval over seeds" } else { "one run each" };
        let title = format!("explained variance of the {target}, % ({unit})");
        let header = [
            title.as_str(),
            "by the latent",
            "by a linear probe from the observation",
            "features that the observation does not determine",
            "explained variance of these features, by the latent",
            "explained variance of these features, by the probe",
        ];
        document.table(header.map(str::to_owned).to_vec(), rows);
    }
}

/// Adds aggregates over all places, and the probability that one line is better than another.
pub(super) fn aggregates(document: &mut Document, block: &Block<'_>) {
    let success = SUCCESS;
    let lines: Vec<_> = block.series.iter().filter(|line| line.is_whole(success)).collect();
    if lines.is_empty() {
        return;
    }
    let missing = block.series.len() - lines.len();
    document.heading(3, "Aggregated success");
    if missing > 0 {
        let left_out = counted(missing, "line");
        document.text(format!(
            "Left out, because a run or a value of the horizontal axis has no result: {left_out}."
        ));
    }
    document.text(
        "Aggregates over all runs and all values of the horizontal axis, as in rliable: interquartile mean (IQM), median and \
         mean of the means at each value (with a single value, the median is that of the seeds), and optimality gap to 100 %. Brackets contain 95 % intervals of a stratified bootstrap \
         with seeds as the unit. With fewer than about five seeds the intervals are too narrow; with one seed there are none.",
    );
    let show = |e: Option<Estimate>| e.map_or_else(|| "–".to_owned(), |e| e.to_string());
    let same_runs = block.same_runs();
    let header =
        ["", "IQM", "median", "mean", "optimality gap", "worst run"].map(str::to_owned).to_vec();
    let rows = lines.iter().map(|line| {
        let worst = scores(line, success).into_iter().flatten().fold(f64::INFINITY, f64::min);
        vec![
            line.label.clone(),
            show(aggregate(line, success, same_runs, &interquartile_mean)),
            show(aggregate(line, success, same_runs, &median)),
            show(aggregate(line, success, same_runs, &task_mean)),
            show(aggregate(line, success, same_runs, &|scores| optimality_gap(scores, 100.0))),
            format!("{worst:.1}"),
        ]
    });
    document.table(header, rows.collect());
    if lines.len() < 2 || !lines.iter().all(|line| resamples(line)) {
        return;
    }
    let header = std::iter::once("probability that the row is better than the column".to_owned());
    let header = header.chain(lines.iter().map(|line| line.label.clone())).collect();
    let rows = lines.iter().map(|line| {
        let versus = |other: &&&Line<'_>| {
            if std::ptr::eq(*line, **other) {
                return "–".to_owned();
            }
            let (x, y) = (scores(line, success), scores(other, success));
            let e = bootstrap([&x, &y], same_runs, |[x, y]| probability_of_improvement(x, y));
            e.map_or_else(|| "–".to_owned(), |e| format!("{e:.2}"))
        };
        std::iter::once(line.label.clone())
            .chain(lines.iter().map(|other| versus(&other)))
            .collect()
    });
    document.table(header, rows.collect());
}

/// The trained runs that differ only in their seed.
#[derive(Default)]
struct Group {
    /// Steps and seconds of each run.
    runs: Vec<(f64, f64)>,
    /// The programs that trained the runs, and their versions of SUMO.
    programs: Vec<String>,
    sumo: Vec<String>,
}

/// Adds the cost of training and the programs that trained, per cell without its seed, and the
/// programs that evaluated the policies.
pub(super) fn training(document: &mut Document, sweep: &Sweep, blocks: &[Block<'_>]) {
    let mut groups: Vec<(String, Group)> = Vec::new();
    for cell in &sweep.cells {
        let Some(trained) = cell.trained() else { continue };
        let name = match cell.id.rsplit_once("/seed_") {
            Some((name, _)) => name.to_owned(),
            None if cell.id.starts_with("seed_") => cell.config.algorithm.clone(),
            None => cell.id.clone(),
        };
        let place = groups.iter().position(|group| group.0 == name).unwrap_or_else(|| {
            groups.push((name, Group::default()));
            groups.len() - 1
        });
        let group = &mut groups[place].1;
        group.runs.push((trained.steps as f64, trained.seconds));
        let found = results_of(blocks, &cell.id).next();
        let known = super::training(cell, found).unwrap_or_default();
        for program in known.earlier.iter().chain([&known.program]) {
            add(&mut group.programs, program.describe());
            add(&mut group.sumo, program.sumo.clone());
        }
    }
    if groups.is_empty() {
        return;
    }
    document.heading(2, "Training");
    let header = ["runs", "seeds", "steps", "minutes", "steps/s", "iwol", "SUMO"];
    let rows = groups.into_iter().map(|(name, group)| {
        let runs = &group.runs;
        let column = |of: fn(&(f64, f64)) -> f64| runs.iter().map(of).collect::<Vec<_>>();
        let mean = |values: Vec<f64>| values.iter().sum::<f64>() / values.len() as f64;
        vec![
            name,
            runs.len().to_string(),
            format!("{:.0}", mean(column(|run| run.0))),
            over_seeds(&column(|run| run.1 / 60.0), 1),
            format!("{:.0}", mean(column(|run| run.0 / run.1.max(1e-9)))),
            group.programs.join("; "),
            group.sumo.join("; "),
        ]
    });
    document.table(header.map(str::to_owned).to_vec(), rows.collect());
    let mut programs = Vec::new();
    for found in blocks.iter().flat_map(|block| results_of(std::slice::from_ref(block), "")) {
        let program = &found.program;
        add(&mut programs, format!("iwol {} with SUMO {}", program.describe(), program.sumo));
    }
    document.text(format!("Evaluated by {}.", programs.join("; ")));
}

/// Returns the results of the cell with this id, or of all cells if the id is empty.
fn results_of<'a>(
    blocks: &'a [Block<'_>],
    id: &'a str,
) -> impl Iterator<Item = &'a EvaluationResult> {
    let rows = blocks.iter().flat_map(|block| &block.series).flat_map(|line| &line.rows);
    let runs =
        rows.flat_map(|row| &row.runs).filter(move |(cell, _)| id.is_empty() || cell.id == id);
    runs.filter_map(|(_, found)| found.as_ref())
}

fn add(known: &mut Vec<String>, value: String) {
    if !known.contains(&value) {
        known.push(value);
    }
}
