//! `iwol plot`

use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use iwol_sumo::config;
use iwol_sumo::plot::{Panel, Series, figure};
use iwol_sumo::record::read_json_lines;
use iwol_sumo::stats::Estimate;
use iwol_sumo::train::RunDir;
use serde_json::Value;

use super::Verdict;

/// Number of intervals at whose bounds a mean curve over time is sampled.
const TIMES: usize = 60;

/// Draws success, safety and throughput in validation during training: of one run, together with
/// success in its training episodes, or of several runs. Runs that differ only in their seed become
/// one curve: their mean with a 95 % interval.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Run folders
    #[arg(value_name = "RUN", required = true)]
    runs: Vec<PathBuf>,
    /// Quantity on the horizontal axis: environment steps, or minutes of training (rollouts and
    /// updates)
    #[arg(long, value_enum, default_value_t = Axis::Steps)]
    x: Axis,
    /// Picture to write, or a folder for it [default: learning_curve.png in the first run folder]
    #[arg(long, short, value_name = "FILE")]
    out: Option<PathBuf>,
    /// JSON file of `iwol evaluate`; its policies without training become reference lines
    #[arg(long, value_name = "FILE")]
    reference: Option<PathBuf>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Axis {
    Steps,
    Time,
}

/// A metric of the validations that is drawn: key, factor, title, unit, range.
type Measure = (&'static str, f64, &'static str, &'static str, Option<(f64, f64)>);
const MEASURES: [Measure; 3] = [
    ("validation/success", 100.0, "Success", "agents that arrive (%)", Some((0.0, 100.0))),
    ("validation/safety", 100.0, "Safety", "agents that do not crash (%)", Some((0.0, 100.0))),
    ("validation/window_reward", 1.0, "Throughput", "reward per agent in 1000 steps", None),
];

/// Runs that differ only in their seed.
struct Group {
    label: String,
    settings: toml::Table,
    folder: PathBuf,
    runs: Vec<Curves>,
}

/// The curves of a run: `(x, y)` points of each of [`MEASURES`], and success in the training
/// episodes.
struct Curves {
    measures: Vec<Vec<(f64, f64)>>,
    exploring: Vec<(f64, f64)>,
}

pub(super) fn run(args: &Args) -> anyhow::Result<Verdict> {
    let alone = args.runs.len() == 1;
    let mut panels: Vec<Panel> = MEASURES
        .iter()
        // The safety panel of a single run is left out, because it nearly repeats the success
        // panel.
        .filter(|measure| !alone || measure.2 != "Safety")
        .map(|measure| Panel {
            title: measure.2.to_owned(),
            x_label: if args.x == Axis::Steps {
                "environment steps"
            } else {
                "minutes of training"
            }
            .to_owned(),
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
    let labels: Vec<String> = groups.iter().map(|group| group.label.clone()).collect();
    for group in &mut groups {
        // Groups with the same label are told apart by their folders.
        if labels.iter().filter(|label| **label == group.label).count() > 1 {
            group.label = format!("{} {}", group.label, group.folder.display());
        }
    }
    for group in &groups {
        let name = match group.runs.len() {
            1 => group.label.clone(),
            seeds => format!("{} ({seeds} seeds)", group.label),
        };
        for panel in &mut panels {
            let measure =
                MEASURES.iter().position(|m| m.2 == panel.title).expect("a panel shows a measure");
            let curves = group
                .runs
                .iter()
                .map(|run| &run.measures[measure][..])
                .filter(|curve| !curve.is_empty());
            panel.series.push(mean_curve(
                name.clone(),
                &curves.collect::<Vec<_>>(),
                args.x,
                panel.y_range,
            ));
        }
    }
    let exploring = groups[0].runs[0].exploring.clone();
    // Runs that `iwol report --keep` copied contain only validations.
    if alone && !exploring.is_empty() {
        panels[0].series.push(Series::curve(
            format!("{}, exploring", groups[0].label),
            exploring,
            None,
        ));
    }
    if let Some(path) = &args.reference {
        for (policy, metrics) in references(path)? {
            for panel in &mut panels {
                let (_, factor, title, ..) =
                    MEASURES.iter().find(|m| m.2 == panel.title).expect("as above");
                let key = if *title == "Throughput" {
                    "window_reward".to_owned()
                } else {
                    title.to_lowercase()
                };
                let mean = metrics[&key]["mean"].as_f64();
                let mean = mean.with_context(|| format!("`{}` has no {key}", path.display()))?;
                panel.references.push((policy.clone(), factor * mean));
            }
        }
    }
    let out = args.out.as_ref().unwrap_or(&args.runs[0]);
    let out = if out.is_dir() { out.join("learning_curve.png") } else { out.clone() };
    let title = if alone {
        format!("Learning curve of {}", groups[0].label)
    } else {
        "Learning curves".to_owned()
    };
    figure(&out, &title, &panels, (700 * panels.len() as u32, 640))?;
    tell!("{}", out.display());
    Ok(Verdict::Good)
}

fn read(run: &Path, x: Axis) -> anyhow::Result<Curves> {
    let path = RunDir::new(run).metrics();
    let lines: Vec<Value> = read_json_lines(&path)
        .with_context(|| format!("`{}` is not a run folder", run.display()))?;
    let place = |line: &Value| match x {
        Axis::Steps => line["step"].as_f64(),
        Axis::Time => line["time/total_s"].as_f64().map(|seconds| seconds / 60.0),
    };
    let curve = |key: &str, factor: f64| -> Vec<(f64, f64)> {
        lines.iter().filter_map(|line| Some((place(line)?, factor * line[key].as_f64()?))).collect()
    };
    let exploring = curve("episode/success", 100.0);
    let measures: Vec<_> = MEASURES.iter().map(|m| curve(m.0, m.1)).collect();
    if exploring.is_empty() && measures.iter().all(Vec::is_empty) {
        bail!("`{}` contains no finished episode yet; train longer", run.display());
    }
    Ok(Curves { measures, exploring })
}

/// Returns the mean curve of several runs; a run that ended before the others keeps its last value.
fn mean_curve(label: String, runs: &[&[(f64, f64)]], x: Axis, range: Option<(f64, f64)>) -> Series {
    if let [only] = runs {
        return Series::curve(label, only.to_vec(), None);
    }
    let mut places: Vec<f64> =
        runs.iter().flat_map(|run| run.iter().map(|point| point.0)).collect();
    places.sort_by(f64::total_cmp);
    places.dedup();
    if x == Axis::Time {
        // Runs are validated at different times, so the curves are sampled at evenly spaced times.
        let (first, last) =
            (places.first().copied().unwrap_or(0.0), places.last().copied().unwrap_or(0.0));
        places = (0..=TIMES).map(|k| first + (last - first) * k as f64 / TIMES as f64).collect();
    }
    let (mut points, mut band) = (Vec::new(), Vec::new());
    for place in places {
        let value = |run: &&[(f64, f64)]| {
            run.iter().take_while(|point| point.0 <= place).last().map(|point| point.1)
        };
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

/// Returns the label of a run (the algorithm, and the observation if it is not `conflict`) and the
/// settings that determine its training, without the seed.
fn identity(run: &Path) -> (String, toml::Table) {
    let text = std::fs::read_to_string(RunDir::new(run).config()).unwrap_or_default();
    let mut settings: toml::Table = toml::from_str(&text).unwrap_or_default();
    let Some(algorithm) =
        settings.get("algorithm").and_then(toml::Value::as_str).map(str::to_owned)
    else {
        settings.insert("folder".to_owned(), run.display().to_string().into());
        return (run.display().to_string(), settings);
    };
    for key in ["seed", "device", "simulation"] {
        settings.remove(key);
    }
    // Settings that the algorithm does not read make no difference.
    config::remove_untold(&mut settings, &algorithm);
    // The folder of the scenario file does not matter, and runs that start from a policy of their
    // own seed differ only in their seed.
    shorten(&mut settings, "scenario", Path::file_name);
    shorten(&mut settings, "init_from", |path| {
        let of_seed =
            path.file_name().is_some_and(|name| name.to_string_lossy().starts_with("seed_"));
        if of_seed { path.parent().map(Path::as_os_str) } else { Some(path.as_os_str()) }
    });
    let label = match settings
        .get("env")
        .and_then(|env| env.get("observation"))
        .and_then(toml::Value::as_str)
    {
        Some(groups) if groups != "conflict" => format!("{algorithm}, {groups}"),
        _ => algorithm,
    };
    (label, settings)
}

/// Replaces the path in a setting by the part of it that `keep` returns.
fn shorten(
    settings: &mut toml::Table,
    key: &str,
    keep: impl Fn(&Path) -> Option<&std::ffi::OsStr>,
) {
    if let Some(toml::Value::String(path)) = settings.get_mut(key) {
        *path = keep(Path::new(path)).unwrap_or_default().to_string_lossy().into_owned();
    }
}

/// Returns the policies without training in a JSON file of `iwol evaluate`, with their metrics.
fn references(path: &Path) -> anyhow::Result<Vec<(String, Value)>> {
    let text = std::fs::read_to_string(path)
        .with_context(|| format!("cannot read `{}`", path.display()))?;
    let value: Value =
        serde_json::from_str(&text).with_context(|| format!("`{}` is not JSON", path.display()))?;
    let rows = if let Value::Array(rows) = value { rows } else { vec![value] };
    Ok(rows
        .into_iter()
        .filter_map(|row| Some((row["policy"].as_str()?.to_owned(), row["metrics"].clone())))
        .filter(|(policy, _)| !iwol_sumo::algo::NAMES.contains(&policy.as_str()))
        .collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Runs that differ only in their seed form one group, whatever the folder of the scenario file
    /// and the seed of the initial policy; runs of different tasks do not.
    #[test]
    fn runs_that_differ_in_their_seed_alone_are_the_same() {
        let folder = tempfile::tempdir().expect("a folder");
        let run = |number: u32, text: &str| {
            let run = folder.path().join(number.to_string());
            std::fs::create_dir(&run).expect("a folder");
            std::fs::write(run.join("config.toml"), text).expect("written");
            identity(&run)
        };
        let (label, first) = run(
            0,
            "algorithm = \"mappo\"\nseed = 0\nscenario = \"a/cross.xml\"\ninit_from = \"x/m/seed_0\"",
        );
        assert_eq!(label, "mappo");
        let (_, second) = run(
            1,
            "algorithm = \"mappo\"\nseed = 1\nscenario = \"b/cross.xml\"\ninit_from = \"x/m/seed_1\"",
        );
        assert_eq!(first, second);
        let (_, task) = run(
            2,
            "algorithm = \"mappo\"\nseed = 1\nscenario = \"a/slow.xml\"\ninit_from = \"x/m/seed_1\"",
        );
        assert_ne!(first, task);
        let (_, begun) = run(
            3,
            "algorithm = \"mappo\"\nseed = 1\nscenario = \"a/cross.xml\"\ninit_from = \"x/n/seed_1\"",
        );
        assert_ne!(first, begun);
        // MAPPO does not read the settings of MAGIC.
        let (_, without) = run(4, "algorithm = \"mappo\"\nseed = 0\n[train]\nenvs = 4");
        let (_, with) = run(
            5,
            "algorithm = \"mappo\"\nseed = 1\n[train]\nenvs = 4\n[magic]\nlambda_world = 0.5",
        );
        assert_eq!(without, with);
    }
}
