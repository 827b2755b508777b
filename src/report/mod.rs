//! The report of a sweep: tables, figures and data for other programs, made only from the files of
//! its cells.
//!
//! The unit is the seed: the mean of a row is over trained runs, and its interval is Student's t.
//! Each table or figure has one unit of interval and names it (`Unit`). Aggregates over several
//! places of the horizontal axis (numbers of vehicles, ranges) follow Agarwal et al. (2021), see
//! [`crate::stats::aggregate`].

mod document;
mod figures;
mod tables;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use crate::provenance::Training;
use crate::record::{self, read_json_lines, write_atomic};
use crate::stats::Estimate;
use crate::sweep::{self, Cell, Evaluate, Reference, Sweep, plain};
use crate::{plot, stats};

/// A metric that reports show: key in the JSON of `iwol evaluate`, heading, factor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Metric {
    /// Key in the JSON; the parts of a nested key are separated by dots.
    pub key: &'static str,
    /// Heading of the table, with the unit.
    pub title: &'static str,
    /// Label of the axis.
    pub axis: &'static str,
    /// Factor by which the value is multiplied.
    pub factor: f64,
}

/// Metrics that are tabulated and drawn for each evaluation.
pub const METRICS: [Metric; 3] = [
    Metric { key: "success", title: "success %", axis: "agents (%)", factor: 100.0 },
    Metric { key: "safety", title: "safety %", axis: "agents (%)", factor: 100.0 },
    Metric {
        key: "window_reward",
        title: "window reward (throughput)",
        axis: "reward per agent in 1000 steps",
        factor: 1.0,
    },
];

/// Metrics that are tabulated as well, for results that contain them.
pub const OF_DRIVING: [Metric; 1] =
    [Metric { key: "loitering", title: "loitering %", axis: "agents (%)", factor: 100.0 }];

/// Metrics that are tabulated and drawn as well where SUMO drives some vehicles.
pub const OF_OTHERS: [Metric; 5] = [
    Metric {
        key: "others.crash",
        title: "background crash %",
        axis: "background vehicles (%)",
        factor: 100.0,
    },
    Metric {
        key: "others.delay",
        title: "background delay s",
        axis: "time loss of background vehicles (s)",
        factor: 1.0,
    },
    Metric {
        key: "others.hard_braking",
        title: "background hard braking %",
        axis: "background vehicles (%)",
        factor: 100.0,
    },
    Metric {
        key: "others.pedestrian_crash",
        title: "pedestrians hit %",
        axis: "pedestrians (%)",
        factor: 100.0,
    },
    Metric {
        key: "others.pet",
        title: "smallest PET s",
        axis: "post-encroachment time (s)",
        factor: 1.0,
    },
];

/// One evaluation of all cells.
#[derive(Debug)]
struct Block<'a> {
    evaluate: &'a Evaluate,
    /// The key along the horizontal axis, if there is one.
    x: Option<String>,
    /// The values of that key.
    categories: Vec<String>,
    /// One line per combination of the other keys that vary, in the sweep's order.
    series: Vec<Line<'a>>,
}

/// The results that form one line of a figure.
#[derive(Debug)]
struct Line<'a> {
    label: String,
    /// The label within the panel and the name of the panel; `None` if the figure has no panels of
    /// its own.
    panel: Option<(String, String)>,
    /// One row per category.
    rows: Vec<Row<'a>>,
}

/// The runs of all seeds at one place of a figure.
#[derive(Debug, Default)]
struct Row<'a> {
    /// The cells at this place, each with its result; `None` until the cell is evaluated.
    runs: Vec<(&'a Cell, Option<Value>)>,
}

/// The unit of an interval: the values that count as independent. All intervals of one table or
/// figure have the same unit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Unit {
    /// Trained runs: Student's t interval of their mean, which says what another seed may give. The
    /// interval is a point if all runs have the same value.
    Seeds,
    /// The episodes of a single run: the interval says how that policy performs, not what another
    /// seed would give.
    Episodes,
    /// The episodes of all runs together, for rates: Wilson's interval, which is not a point even
    /// if all runs have the same value. The interval says how these policies perform, not what
    /// another seed would give.
    Together,
}

impl Unit {
    /// Returns the description of the unit in a table's heading.
    fn describe(self) -> &'static str {
        match self {
            Self::Seeds => "± t-interval over seeds",
            Self::Episodes => "[interval] over the episodes of a single run",
            Self::Together => "[Wilson interval] over all episodes together",
        }
    }
}

impl Metric {
    /// Returns a number of this metric (`mean`, `low`, `high`) in a result, multiplied by the
    /// factor.
    fn of(&self, found: &Value, number: &str) -> Option<f64> {
        let metric = self.key.split('.').fold(&found["metrics"], |value, key| &value[key]);
        Some(metric[number].as_f64()? * self.factor)
    }

    /// Returns whether the metric is a rate in percent.
    fn is_rate(&self) -> bool {
        self.factor == 100.0
    }
}

impl Block<'_> {
    /// Returns the metrics that the tables of this block show.
    fn metrics(&self) -> impl Iterator<Item = &'static Metric> {
        METRICS.iter().chain(OF_DRIVING.iter().chain(&OF_OTHERS).filter(|metric| self.has(metric)))
    }

    /// Returns the metrics that the figures of this block show.
    fn drawn(&self) -> impl Iterator<Item = &'static Metric> {
        METRICS.iter().chain(OF_OTHERS.iter().filter(|metric| self.has(metric)))
    }

    fn has(&self, metric: &Metric) -> bool {
        self.series.iter().flat_map(|line| &line.rows).any(|row| !row.values(metric).is_empty())
    }

    /// Returns the unit of a figure's intervals: seeds, unless no line has several.
    fn unit(&self) -> Unit {
        if self.series.iter().any(Line::has_seeds) { Unit::Seeds } else { Unit::Episodes }
    }
}

impl Line<'_> {
    /// Returns whether the sweep has several seeds of this line, finished or not.
    fn has_seeds(&self) -> bool {
        self.rows.iter().any(|row| row.runs.len() > 1)
    }
}

impl Row<'_> {
    /// Returns whether all runs of this row are finished.
    fn is_complete(&self) -> bool {
        !self.runs.is_empty() && self.runs.iter().all(|(_, found)| found.is_some())
    }

    /// Returns the metric of each finished run, multiplied by its factor.
    fn values(&self, metric: &Metric) -> Vec<f64> {
        self.runs.iter().filter_map(|(_, found)| metric.of(found.as_ref()?, "mean")).collect()
    }

    /// Returns mean and interval of a metric. Bounds are infinite where the unit gives none (a
    /// single seed, with seeds as the unit); bounds of rates stay between 0 and 100 %.
    fn estimate(&self, metric: &Metric, unit: Unit) -> Option<Estimate> {
        let finished: Vec<&Value> =
            self.runs.iter().filter_map(|(_, found)| found.as_ref()).collect();
        let values = self.values(metric);
        match unit {
            Unit::Seeds => {
                let e = Estimate::t(&values)?;
                let (low, high) = if metric.is_rate() && e.low.is_finite() {
                    (e.low.max(0.0), e.high.min(100.0))
                } else {
                    (e.low, e.high)
                };
                Some(Estimate { low, high, ..e })
            }
            Unit::Episodes => {
                let [only] = finished[..] else { return None };
                let open = |key: &str, none: f64| metric.of(only, key).unwrap_or(none);
                let (low, high) = (open("low", f64::NEG_INFINITY), open("high", f64::INFINITY));
                Some(Estimate { mean: metric.of(only, "mean")?, low, high })
            }
            Unit::Together => {
                let of =
                    |found: &&Value| Some((found["episodes"].as_u64()?, metric.of(found, "mean")?));
                let runs: Vec<(u64, f64)> = finished.iter().filter_map(of).collect();
                let episodes: u64 = runs.iter().map(|run| run.0).sum();
                let mean =
                    runs.iter().map(|run| run.0 as f64 * run.1).sum::<f64>() / episodes as f64;
                let pooled = Estimate::rate(&vec![mean / 100.0; episodes as usize])?;
                Some(Estimate { mean, low: 100.0 * pooled.low, high: 100.0 * pooled.high })
            }
        }
    }

    /// Returns whether several runs all have the same value.
    fn is_tied(&self, metric: &Metric) -> bool {
        let values = self.values(metric);
        values.len() > 1 && values.iter().all(|value| *value == values[0])
    }

    /// Returns the distance \[km\] and the crashes of all finished runs; `None` if the results do
    /// not contain them.
    fn driven(&self) -> Option<(f64, u64)> {
        let of = |found: &Value| {
            let driven = &found["metrics"]["km_per_crash"];
            Some((driven["km"].as_f64()?, driven["crashes"].as_f64()? as u64))
        };
        let runs = self.runs.iter().filter_map(|(_, found)| of(found.as_ref()?));
        runs.reduce(|sum, run| (sum.0 + run.0, sum.1 + run.1))
    }

    /// Returns, of each finished run, a number about what the latent explains of `target`; `key` is
    /// a field of [`crate::evaluate::Knowledge`] or, after `probe.`, of [`crate::evaluate::Probe`].
    fn known(&self, target: &str, key: &str) -> Vec<f64> {
        let of = |found: &Value| {
            let all = found["metrics"]["reconstruction"].as_array()?;
            let of_target = all.iter().find(|known| known["name"] == target)?;
            key.split('.').fold(of_target, |value, key| &value[key]).as_f64()
        };
        self.runs.iter().filter_map(|(_, found)| of(found.as_ref()?)).collect()
    }
}

/// Returns what a cell was trained with, from its run folder or otherwise from one of its results.
fn training(cell: &Cell, found: Option<&Value>) -> Option<Training> {
    cell.run().training().or_else(|| serde_json::from_value(found?.get("run")?.clone()).ok())
}

/// Writes the report of a sweep into a folder: `report.md`, `report.html`, figures, `summary.json`
/// (the metrics of every run) and `marl_eval.json` (the format of InstaDeep's marl-eval). Returns
/// the paths of the written files.
///
/// # Errors
/// If no cell is evaluated yet, or a file cannot be read or written.
pub fn write(sweep: &Sweep, command: &str, out: &Path) -> Result<Vec<PathBuf>, Error> {
    for cell in &sweep.cells {
        cell.check()?;
    }
    let blocks: Vec<Block<'_>> = sweep
        .evaluations
        .iter()
        .map(|evaluate| block(sweep, evaluate))
        .collect::<Result<_, _>>()?;
    let found = |block: &Block<'_>| {
        block.series.iter().flat_map(|s| &s.rows).flat_map(|r| &r.runs).any(|r| r.1.is_some())
    };
    if !blocks.iter().any(found) {
        return Err(Error::Nothing { name: sweep.name.clone() });
    }
    std::fs::create_dir_all(out).map_err(|source| record::Error::Io {
        action: "create",
        path: out.to_owned(),
        source,
    })?;
    let mut written = Vec::new();
    let mut document = document::Document::new(&sweep.title);
    tables::introduce(&mut document, sweep, command);
    for block in blocks.iter().filter(|block| found(block)) {
        document.heading(2, &heading(sweep, block));
        let file = out.join(format!("{}.png", block.evaluate.name));
        figures::results(&file, sweep, block)?;
        let all: Vec<&str> =
            block.drawn().map(|metric| metric.title.trim_end_matches(" %")).collect();
        let shown =
            if block.evaluate.panels.is_some() { "success".to_owned() } else { all.join(", ") };
        let whiskers = match block.unit() {
            Unit::Seeds => "over seeds",
            _ => "over the episodes of the single run of each line",
        };
        let text =
            format!("{}: {shown}; whiskers are 95 % intervals {whiskers}", heading(sweep, block));
        document.figure(&file, &text);
        written.push(file);
        tables::results(&mut document, sweep, block);
        tables::kilometres(&mut document, block);
        tables::knowledge(&mut document, block);
        if block.categories.len() > 1 && block.series.len() > 1 {
            tables::aggregates(&mut document, block);
            let file = out.join(format!("{}_profile.png", block.evaluate.name));
            if figures::profile(&file, block)? {
                document
                    .figure(&file, "Performance profile: share of runs above each success rate");
                written.push(file);
            }
        }
    }
    let file = out.join("learning_curves.png");
    if figures::learning_curves(&file, &blocks[0])? {
        document.heading(2, "Learning curves");
        document.figure(&file, "Success in validation against environment steps, mean over seeds");
        written.push(file);
    }
    tables::training(&mut document, sweep, &blocks);
    let mut save = |name: &str, bytes: &[u8]| -> Result<(), Error> {
        let path = out.join(name);
        write_atomic(&path, bytes)?;
        written.push(path);
        Ok(())
    };
    save("report.md", document.markdown().as_bytes())?;
    save("report.html", document.html()?.as_bytes())?;
    save("summary.json", format!("{:#}\n", summary(sweep, &blocks, command)).as_bytes())?;
    save("marl_eval.json", format!("{}\n", marl_eval(&blocks[0])?).as_bytes())?;
    Ok(written)
}

fn heading(sweep: &Sweep, block: &Block<'_>) -> String {
    match &block.evaluate.title {
        none if none.is_empty() && sweep.evaluations.len() == 1 => "Results".to_owned(),
        none if none.is_empty() => block.evaluate.name.clone(),
        title => title.clone(),
    }
}

/// Sorts the results of one evaluation into lines and places.
fn block<'a>(sweep: &'a Sweep, evaluate: &'a Evaluate) -> Result<Block<'a>, Error> {
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
    let mut categories: Vec<String> = Vec::new();
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
                let short = key.rsplit('.').next().unwrap_or(key).replace('_', " ");
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
            // The result of an earlier evaluation with other episodes or weights is not a result of
            // this evaluation.
            let found = match read_result(&cell.result(evaluate, &combination))? {
                Some(found) if cell.is_evaluated(evaluate, &combination) => Some(found),
                _ => None,
            };
            series[line].1.entry(category).or_default().runs.push((cell, found));
        }
    }
    let count = categories.len();
    let line = |(line, mut rows): (Line<'a>, BTreeMap<usize, Row<'a>>)| Line {
        rows: (0..count).map(|k| rows.remove(&k).unwrap_or_default()).collect(),
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

fn read_result(path: &Path) -> Result<Option<Value>, Error> {
    match std::fs::read(path) {
        Ok(bytes) => Ok(Some(
            serde_json::from_slice(&bytes)
                .map_err(|source| Error::Damaged { path: path.to_owned(), source })?,
        )),
        Err(source) if source.kind() == std::io::ErrorKind::NotFound => Ok(None),
        Err(source) => {
            Err(record::Error::Io { action: "read", path: path.to_owned(), source }.into())
        }
    }
}

/// Returns the published values for this evaluation and metric, as
/// `(reference, [(category, value)])`.
fn references<'a>(
    sweep: &'a Sweep,
    block: &'a Block<'_>,
    metric: &'a Metric,
) -> impl Iterator<Item = (&'a Reference, Vec<(usize, f64)>)> {
    let first = sweep.evaluations.first().map(|e| e.name.as_str());
    let name = block.evaluate.name.as_str();
    sweep
        .references
        .iter()
        .filter(move |r| r.metric == metric.key && r.evaluate.as_deref().or(first) == Some(name))
        .map(move |r| {
            let place = |x: f64| {
                block.categories.iter().position(|c| c.parse::<f64>().is_ok_and(|c| c == x))
            };
            if r.x.is_empty() && block.categories.len() == 1 {
                return (r, r.y.iter().take(1).map(|y| (0, y * metric.factor)).collect());
            }
            let points =
                r.x.iter().zip(&r.y).filter_map(|(x, y)| Some((place(*x)?, y * metric.factor)));
            (r, points.collect())
        })
}

/// Returns the metrics of every run, with a description of the run.
fn summary(sweep: &Sweep, blocks: &[Block<'_>], command: &str) -> Value {
    let mut rows = Vec::new();
    for block in blocks {
        for line in &block.series {
            for (category, row) in block.categories.iter().zip(&line.rows) {
                for (cell, found) in
                    row.runs.iter().filter_map(|(cell, found)| Some((cell, found.as_ref()?)))
                {
                    let trained = cell.trained();
                    rows.push(json!({
                        "evaluation": block.evaluate.name, "series": line.label, "x": block.x, "at": category,
                        "cell": cell.id, "algorithm": cell.config.algorithm, "agents": cell.config.agents,
                        "seed": cell.config.seed, "episodes": found["episodes"],
                        "training_steps": trained.as_ref().map(|t| t.steps),
                        "training_seconds": trained.map(|t| t.seconds), "run": training(cell, Some(found)),
                        "program": found["program"], "metrics": found["metrics"],
                    }));
                }
            }
        }
    }
    json!({ "sweep": sweep.name, "command": command, "rows": rows })
}

/// Returns the results in the format of marl-eval: environment, task, algorithm, run, then steps
/// with their values, and the final values.
fn marl_eval(block: &Block<'_>) -> Result<Value, Error> {
    let mut tree = json!({});
    for line in &block.series {
        for (category, row) in block.categories.iter().zip(&line.rows) {
            for (cell, found) in
                row.runs.iter().filter_map(|(cell, found)| Some((cell, found.as_ref()?)))
            {
                let environment = cell
                    .config
                    .scenario
                    .file_stem()
                    .unwrap_or_default()
                    .to_string_lossy()
                    .into_owned();
                let task = match &block.x {
                    Some(x) => format!("{x}={category}"),
                    None => "all".to_owned(),
                };
                let mut run = json!({});
                let lines: Vec<Value> = read_json_lines(&cell.run().metrics())?;
                for (k, line) in
                    lines.iter().filter(|line| line["validation/success"].is_number()).enumerate()
                {
                    run[format!("step_{k}")] = json!({
                        "step_count": line["step"], "elapsed_time": line["time/total_s"],
                        "success": [line["validation/success"]], "safety": [line["validation/safety"]],
                        "window_reward": [line["validation/window_reward"]],
                    });
                }
                let finals =
                    METRICS.iter().map(|m| (m.key, json!([found["metrics"][m.key]["mean"]])));
                run["absolute_metrics"] =
                    finals.map(|(key, value)| (key.to_owned(), value)).collect();
                tree[&environment][&task][&line.label][format!("seed_{}", cell.config.seed)] = run;
            }
        }
    }
    Ok(tree)
}

/// Returns the seeds' scores per category: the strata of the bootstrap.
fn scores(line: &Line<'_>, metric: &Metric) -> Vec<Vec<f64>> {
    line.rows.iter().map(|row| row.values(metric)).collect()
}

/// Returns whether a bootstrap over seeds is meaningful: every place has at least two seeds.
fn resamples(line: &Line<'_>) -> bool {
    line.rows.iter().all(|row| row.values(&METRICS[0]).len() > 1)
}

impl Block<'_> {
    /// Returns whether every place contains the same trained runs.
    fn same_runs(&self) -> bool {
        self.x.as_ref().is_some_and(|x| self.evaluate.grid.contains_key(x))
    }
}

/// Returns an aggregate over seeds and places with its interval; the bounds are infinite without a
/// second seed.
fn aggregate(
    line: &Line<'_>,
    metric: &Metric,
    same_runs: bool,
    of: &dyn Fn(&[Vec<f64>]) -> f64,
) -> Option<Estimate> {
    let scores = scores(line, metric);
    if resamples(line) {
        let bootstrap =
            if same_runs { stats::aggregate::bootstrap_runs } else { stats::aggregate::bootstrap };
        return bootstrap(&scores, &of);
    }
    let mean = of(&scores);
    mean.is_finite().then_some(Estimate { mean, low: f64::NEG_INFINITY, high: f64::INFINITY })
}

/// An error of a report.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// Nothing is evaluated yet.
    #[error("the sweep `{name}` has no result yet; run it first: iwol sweep FILE")]
    Nothing {
        /// The sweep.
        name: String,
    },
    /// The key of an axis is not one of the keys that vary.
    #[error(
        "[[evaluate]] `{evaluate}`: {what} = \"{key}\" must be a key with several values in a grid"
    )]
    Axis {
        /// The evaluation.
        evaluate: String,
        /// The setting that names the key: `x` or `panels`.
        what: &'static str,
        /// The key.
        key: String,
    },
    /// A result file does not contain what `iwol evaluate` writes.
    #[error("`{}` is damaged; delete it, and run the sweep again", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// The parser's reason.
        source: serde_json::Error,
    },
    /// A file cannot be read or written.
    #[error(transparent)]
    Record(#[from] record::Error),
    /// A figure cannot be drawn.
    #[error(transparent)]
    Plot(#[from] plot::Error),
    /// The sweep is not valid.
    #[error(transparent)]
    Sweep(#[from] sweep::Error),
}
