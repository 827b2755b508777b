//! Tables of a report.

use std::fmt::Write as _;

use super::document::Document;
use super::{Block, METRICS, Metric, Row, aggregate, references, resamples, scores};
use crate::stats::Estimate;
use crate::stats::aggregate::{
    bootstrap_pair, interquartile_mean, median, optimality_gap, probability_of_improvement, task_mean,
};
use crate::sweep::{State, Sweep};

/// How the numbers came about, and what is missing.
pub(super) fn introduce(document: &mut Document, sweep: &Sweep, command: &str) {
    document.code(command);
    let states: Vec<State> = sweep.cells.iter().map(|cell| cell.state(&sweep.evaluations)).collect();
    let finished = states.iter().filter(|state| **state == State::Finished).count();
    let mut text = format!("{finished} of {} runs are finished", states.len());
    let trained = states.iter().filter(|state| matches!(state, State::Trained(_))).count();
    if trained > 0 {
        let _ = write!(text, ", {trained} more are trained, with evaluations missing");
    }
    let failed = states.iter().filter(|state| matches!(state, State::Failed(_))).count();
    if failed > 0 {
        let _ = write!(text, ", {failed} failed");
    }
    text += ". The unit is the seed: ± is the 95 % t-interval over trained runs (brackets hold the interval over \
             episodes, of a single run, or of runs that do not differ). Deterministic policies, episodes that training and validation did not see.";
    document.text(text);
}

/// A table per metric, a line per series, a column per place; published values below. One table with a column per metric where
/// there is but one place.
pub(super) fn results(document: &mut Document, sweep: &Sweep, block: &Block<'_>) {
    if block.x.is_none() {
        return of_one_place(document, sweep, block);
    }
    let axis = block.x.as_deref().map_or("", |x| x.rsplit('.').next().unwrap_or(x)).replace('_', " ");
    for metric in block.metrics() {
        let header = |title: &str| [&[title.to_owned()], &block.categories[..]].concat();
        let title = if axis.is_empty() { metric.title.to_owned() } else { format!("{} at {axis}", metric.title) };
        let mut rows: Vec<Vec<String>> = Vec::new();
        for line in &block.series {
            let cells = line.rows.iter().map(|row| cell(row, metric));
            rows.push(std::iter::once(line.label.clone()).chain(cells).collect());
        }
        for (reference, points) in references(sweep, block, metric) {
            let at =
                |place: usize| points.iter().find(|p| p.0 == place).map_or("–".to_owned(), |p| format!("{:.1}", p.1));
            let cells = (0..block.categories.len()).map(at);
            rows.push(std::iter::once(reference.label.clone()).chain(cells).collect());
        }
        document.table(header(&title), rows);
    }
}

fn of_one_place(document: &mut Document, sweep: &Sweep, block: &Block<'_>) {
    let metrics: Vec<&Metric> = block.metrics().collect();
    let row_of = |line: &super::Line<'_>| {
        let cells = metrics.iter().map(|metric| line.rows.first().map_or("–".to_owned(), |row| cell(row, metric)));
        std::iter::once(line.label.clone()).chain(cells).collect()
    };
    let mut rows: Vec<Vec<String>> = block.series.iter().map(row_of).collect();
    for (place, metric) in metrics.iter().enumerate() {
        for (reference, points) in references(sweep, block, metric) {
            let known = (block.series.len()..rows.len()).find(|&i| rows[i][0] == reference.label);
            let row = known.unwrap_or_else(|| {
                rows.push(vec!["–".to_owned(); metrics.len() + 1]);
                rows.len() - 1
            });
            rows[row][0].clone_from(&reference.label);
            if let Some((_, value)) = points.first() {
                rows[row][place + 1] = format!("{value:.1}");
            }
        }
    }
    let header = std::iter::once(String::new()).chain(metrics.iter().map(|metric| metric.title.to_owned()));
    document.table(header.collect(), rows);
}

/// Mean ± half width over seeds; mean and brackets for one.
fn cell(row: &Row<'_>, metric: &Metric) -> String {
    let Some(e) = row.estimate(metric) else { return "–".to_owned() };
    let values = row.values(metric);
    let partial = if values.len() < row.runs.len() {
        format!(" ({} of {})", values.len(), row.runs.len())
    } else {
        String::new()
    };
    let half = Estimate::t(&values).map_or(f64::NAN, |t| t.high - t.mean);
    if values.len() == 1 || (half == 0.0 && e.low < e.high) {
        return format!("{e}{partial}");
    }
    format!("{:.1} ± {half:.1}{partial}", e.mean)
}

/// Aggregates over all places, and how likely one line beats another.
pub(super) fn aggregates(document: &mut Document, block: &Block<'_>) {
    let success = &METRICS[0];
    let lines: Vec<_> = block.series.iter().filter(|line| line.rows.iter().all(Row::is_complete)).collect();
    if lines.is_empty() {
        return;
    }
    let missing = block.series.len() - lines.len();
    document.heading(3, "Success over all of them");
    if missing > 0 {
        document.text(format!("{missing} lines are not complete yet and left out."));
    }
    document.text(
        "Aggregates over all runs and places as in rliable: interquartile mean (IQM), median and mean of the places' means, \
         optimality gap to 100 %. Brackets: 95 % stratified bootstrap with the seeds as the unit; with fewer than about five \
         seeds they are too narrow, and without a second seed there are none.",
    );
    let show = |e: Option<Estimate>| e.map_or_else(|| "–".to_owned(), |e| e.to_string());
    let same_runs = block.same_runs();
    let header = ["", "IQM", "median", "mean", "optimality gap", "worst run"].map(str::to_owned).to_vec();
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
    let header = std::iter::once("probability that the line beats the column".to_owned());
    let header = header.chain(lines.iter().map(|line| line.label.clone())).collect();
    let rows = lines.iter().map(|line| {
        let versus = |other: &&&super::Line<'_>| {
            if std::ptr::eq(*line, **other) {
                return "–".to_owned();
            }
            let (x, y) = (scores(line, success), scores(other, success));
            let e = bootstrap_pair(&x, &y, same_runs, probability_of_improvement);
            e.map_or_else(|| "–".to_owned(), |e| format!("{e:.2}"))
        };
        std::iter::once(line.label.clone()).chain(lines.iter().map(|other| versus(&other))).collect()
    });
    document.table(header, rows.collect());
}

/// What training took, per cell without its seed.
pub(super) fn training(document: &mut Document, sweep: &Sweep) {
    let mut groups: Vec<(String, Vec<(f64, f64)>)> = Vec::new();
    for cell in &sweep.cells {
        let Some(trained) = cell.trained() else { continue };
        let name = cell.id.rsplit_once("/seed_").map_or(cell.id.as_str(), |(name, _)| name).to_owned();
        let entry = (trained.steps as f64, trained.seconds);
        match groups.iter_mut().find(|group| group.0 == name) {
            Some(group) => group.1.push(entry),
            None => groups.push((name, vec![entry])),
        }
    }
    if groups.is_empty() {
        return;
    }
    document.heading(2, "Training");
    let header = ["runs", "seeds", "steps", "minutes", "steps/s"].map(str::to_owned).to_vec();
    let rows = groups.into_iter().map(|(name, runs)| {
        let column = |of: fn(&(f64, f64)) -> f64| runs.iter().map(of).collect::<Vec<_>>();
        let mean = |values: Vec<f64>| values.iter().sum::<f64>() / values.len() as f64;
        let minutes = column(|run| run.1 / 60.0);
        let half = Estimate::t(&minutes).map(|e| e.high - e.mean).filter(|half| half.is_finite());
        let minutes = mean(minutes);
        vec![
            name,
            runs.len().to_string(),
            format!("{:.0}", mean(column(|run| run.0))),
            half.map_or_else(|| format!("{minutes:.1}"), |half| format!("{minutes:.1} ± {half:.1}")),
            format!("{:.0}", mean(column(|run| run.0 / run.1.max(1e-9)))),
        ]
    });
    document.table(header, rows.collect());
}
