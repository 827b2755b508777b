//! `iwol plot`

use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use iwol_sumo::plot::{Panel, Series, figure};
use iwol_sumo::record::read_json_lines;
use iwol_sumo::stats::Estimate;
use iwol_sumo::train::RunDir;
use serde_json::Value;

use super::Verdict;

/// Points of a curve over time.
const TIMES: usize = 60;

/// Learning curves of validation: one run beside its training episodes, or several runs, where those that differ in their
/// seed alone become one curve, their mean with a 95 % interval.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Run folders
    #[arg(value_name = "RUN", required = true)]
    runs: Vec<PathBuf>,
    /// What lies along the horizontal axis: environment steps, or minutes of training (rollouts and updates)
    #[arg(long, value_enum, default_value_t = Axis::Steps)]
    x: Axis,
    /// Picture to write, or a folder for it [default: learning_curve.png in the first run folder]
    #[arg(long, short, value_name = "FILE")]
    out: Option<PathBuf>,
    /// JSON of `iwol evaluate`; policies without training in it become reference lines
    #[arg(long, value_name = "FILE")]
    reference: Option<PathBuf>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Axis {
    Steps,
    Time,
}

/// What is drawn of each validation: key, factor, title, unit, range.
type Measure = (&'static str, f64, &'static str, &'static str, Option<(f64, f64)>);
const MEASURES: [Measure; 3] = [
    ("validation/success", 100.0, "Success", "agents that arrive (%)", Some((0.0, 100.0))),
    ("validation/safety", 100.0, "Safety", "agents that do not crash (%)", Some((0.0, 100.0))),
    ("validation/window_reward", 1.0, "Throughput", "reward per agent in 1000 steps", None),
];

/// Runs that differ in their seed alone.
struct Group {
    label: String,
    settings: toml::Table,
    folder: PathBuf,
    runs: Vec<Curves>,
}

/// A run's curves: `(x, y)` for each of [`MEASURES`], and success of the training episodes.
struct Curves {
    measures: Vec<Vec<(f64, f64)>>,
    exploring: Vec<(f64, f64)>,
}

pub(super) fn run(args: &Args) -> anyhow::Result<Verdict> {
    let alone = args.runs.len() == 1;
    let mut panels: Vec<Panel> = MEASURES
        .iter()
        // Safety of one run is all but its success.
        .filter(|measure| !alone || measure.2 != "Safety")
        .map(|measure| Panel {
            title: measure.2.to_owned(),
            x_label: if args.x == Axis::Steps { "environment steps" } else { "minutes of training" }.to_owned(),
            y_label: measure.3.to_owned(),
            y_range: measure.4,
            categories: Vec::new(),
            series: Vec::new(),
            references: Vec::new(),
        })
        .collect();
    let mut groups: Vec<Group> = Vec::new();
    for run in args.runs.iter().collect::<std::collections::BTreeSet<_>>() {
        let (label, settings) = identity(run);
        let curves = read(run, args.x)?;
        match groups.iter_mut().find(|group| group.settings == settings) {
            Some(group) => group.runs.push(curves),
            None => groups.push(Group { label, settings, folder: run.clone(), runs: vec![curves] }),
        }
    }
    for i in 0..groups.len() {
        // What the label does not tell apart, the folder does.
        if groups.iter().filter(|group| group.label == groups[i].label).count() > 1 {
            let folder = groups[i].folder.display().to_string();
            groups[i].label = format!("{} {folder}", groups[i].label);
        }
    }
    for group in &groups {
        let name = match group.runs.len() {
            1 => group.label.clone(),
            seeds => format!("{} ({seeds} seeds)", group.label),
        };
        for panel in &mut panels {
            let measure = MEASURES.iter().position(|m| m.2 == panel.title).expect("a panel shows a measure");
            let curves = group.runs.iter().map(|run| &run.measures[measure][..]).filter(|curve| !curve.is_empty());
            panel.series.push(mean_curve(name.clone(), &curves.collect::<Vec<_>>(), args.x, panel.y_range));
        }
    }
    if alone {
        let exploring = groups[0].runs[0].exploring.clone();
        panels[0].series.push(Series::curve(format!("{}, exploring", groups[0].label), exploring, None));
    }
    if let Some(path) = &args.reference {
        for (policy, metrics) in references(path)? {
            for panel in &mut panels {
                let (_, factor, title, ..) = MEASURES.iter().find(|m| m.2 == panel.title).expect("as above");
                let key = if *title == "Throughput" { "window_reward".to_owned() } else { title.to_lowercase() };
                let mean = metrics[&key]["mean"].as_f64();
                let mean = mean.with_context(|| format!("`{}` has no {key}", path.display()))?;
                panel.references.push((policy.clone(), factor * mean));
            }
        }
    }
    let out = args.out.as_ref().unwrap_or(&args.runs[0]);
    let out = if out.is_dir() { out.join("learning_curve.png") } else { out.clone() };
    let title = if alone { format!("Learning curve of {}", groups[0].label) } else { "Learning curves".to_owned() };
    figure(&out, &title, &panels, (700 * panels.len() as u32, 640))?;
    tell!("{}", out.display());
    Ok(Verdict::Good)
}

fn read(run: &Path, x: Axis) -> anyhow::Result<Curves> {
    let path = RunDir::new(run).metrics();
    let lines: Vec<Value> = read_json_lines(&path).with_context(|| format!("`{}` is no run folder", run.display()))?;
    let place = |line: &Value| match x {
        Axis::Steps => line["step"].as_f64(),
        Axis::Time => line["time/total_s"].as_f64().map(|seconds| seconds / 60.0),
    };
    let curve = |key: &str, factor: f64| -> Vec<(f64, f64)> {
        lines.iter().filter_map(|line| Some((place(line)?, factor * line[key].as_f64()?))).collect()
    };
    let exploring = curve("episode/success", 100.0);
    if exploring.is_empty() {
        bail!("`{}` has no finished episode yet; train longer", run.display());
    }
    Ok(Curves { measures: MEASURES.iter().map(|m| curve(m.0, m.1)).collect(), exploring })
}

/// The mean over runs, each of which keeps its last value where it ended before the others.
fn mean_curve(label: String, runs: &[&[(f64, f64)]], x: Axis, range: Option<(f64, f64)>) -> Series {
    if let [only] = runs {
        return Series::curve(label, only.to_vec(), None);
    }
    let mut places: Vec<f64> = runs.iter().flat_map(|run| run.iter().map(|point| point.0)).collect();
    places.sort_by(f64::total_cmp);
    places.dedup();
    if x == Axis::Time {
        // No two runs are validated at the same time.
        let (first, last) = (places.first().copied().unwrap_or(0.0), places.last().copied().unwrap_or(0.0));
        places = (0..=TIMES).map(|k| first + (last - first) * k as f64 / TIMES as f64).collect();
    }
    let (mut points, mut band) = (Vec::new(), Vec::new());
    for place in places {
        let value = |run: &&[(f64, f64)]| run.iter().take_while(|point| point.0 <= place).last().map(|point| point.1);
        let values: Option<Vec<f64>> = runs.iter().map(value).collect();
        let Some(estimate) = values.and_then(|values| Estimate::t(&values)) else {
            continue;
        };
        let (low, high) = range.unwrap_or((f64::NEG_INFINITY, f64::INFINITY));
        points.push((place, estimate.mean));
        band.push((place, estimate.low.max(low), estimate.high.min(high)));
    }
    Series::curve(label, points, Some(band))
}

/// What the run's own settings call it (the algorithm, and how others are seen where that is not the usual way), and those
/// settings of which learning is made, without the seed.
fn identity(run: &Path) -> (String, toml::Table) {
    let text = std::fs::read_to_string(RunDir::new(run).config()).unwrap_or_default();
    let mut settings: toml::Table = toml::from_str(&text).unwrap_or_default();
    let Some(algorithm) = settings.get("algorithm").and_then(toml::Value::as_str).map(str::to_owned) else {
        settings.insert("folder".to_owned(), run.display().to_string().into());
        return (run.display().to_string(), settings);
    };
    for key in ["seed", "device", "simulation", "scenario"] {
        settings.remove(key);
    }
    let label = match settings.get("env").and_then(|env| env.get("observation")).and_then(toml::Value::as_str) {
        Some(groups) if groups != "conflict" => format!("{algorithm}, {groups}"),
        _ => algorithm,
    };
    (label, settings)
}

/// Policies that need no training, with their metrics.
fn references(path: &Path) -> anyhow::Result<Vec<(String, Value)>> {
    let text = std::fs::read_to_string(path).with_context(|| format!("cannot read `{}`", path.display()))?;
    let value: Value = serde_json::from_str(&text).with_context(|| format!("`{}` is not JSON", path.display()))?;
    let rows = if let Value::Array(rows) = value { rows } else { vec![value] };
    Ok(rows
        .into_iter()
        .filter_map(|row| Some((row["policy"].as_str()?.to_owned(), row["metrics"].clone())))
        .filter(|(policy, _)| !iwol_sumo::algo::NAMES.contains(&policy.as_str()))
        .collect())
}
