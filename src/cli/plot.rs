//! `iwol plot`

#![cfg(feature = "learn")]

use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail, ensure};

use crate::config;
use crate::curves::{self, Along, Curve, Line, curve, mean_curve};
use crate::metrics::{self, EvaluationResult, Metric, SUCCESS, Shown};
use crate::plot::{Format, Panel, Series, figure};
use crate::record;
use crate::train::{RunDir, STOP_VALIDATIONS};
use crate::words::counted;

use super::Verdict;

/// Draws success, safety and throughput in validation during training: of one run, together with
/// success in its training episodes, or of several runs. Runs that differ only in their seed become
/// one curve: their mean with a 95 % interval. A run that stopped early keeps its last value in the
/// mean; the curve ends where the first run ends that is not finished.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Run folders
    #[arg(value_name = "RUN", required = true)]
    runs: Vec<PathBuf>,
    /// Quantity on the horizontal axis: environment steps, or minutes of training (rollouts and
    /// updates)
    #[arg(long, value_enum, default_value_t = Axis::Steps)]
    x: Axis,
    /// Picture to write, .png or .svg, or a folder for it [default: learning_curve.png in the first
    /// run folder]
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

/// Runs that differ only in their seed.
struct Group {
    label: String,
    settings: toml::Table,
    folder: PathBuf,
    runs: Vec<Run>,
}

/// What a run recorded.
struct Run {
    lines: Vec<Line>,
    /// Whether nothing is left to train.
    is_over: bool,
}

pub(super) fn run(args: &Args) -> anyhow::Result<Verdict> {
    let alone = args.runs.len() == 1;
    let along = if args.x == Axis::Steps { Along::Steps } else { Along::Minutes };
    let groups = groups(&args.runs, along)?;
    let out = args.out.as_ref().unwrap_or(&args.runs[0]);
    let out = if out.is_dir() { out.join("learning_curve.png") } else { out.clone() };
    Format::of(&out).context("--out")?;
    let references = args.reference.as_deref().map(references).transpose()?.unwrap_or_default();
    for line in references.iter().filter_map(|(path, result)| other_task(&groups, path, result)) {
        say!("{line}");
    }
    // The safety panel of a single run is left out, because it nearly repeats the success panel.
    let metrics =
        metrics::shown(Shown::Everywhere).filter(|metric| !alone || metric.id != "safety");
    let mut panels = Vec::new();
    for metric in metrics {
        let mut series: Vec<Series> =
            groups.iter().map(|group| group.series(along, metric)).collect();
        if alone && metric.id == SUCCESS.id {
            let exploring = curve(&groups[0].runs[0].lines, along, metric, Line::exploration);
            // Runs that `iwol report --keep` copied contain only validations.
            if !exploring.is_empty() {
                let label = format!("{}, exploring", groups[0].label);
                series.push(Series::curve(label, exploring, None));
            }
        }
        // Tasks without vehicles have neither safety nor throughput.
        if metric.id != SUCCESS.id && series.iter().all(|series| series.points.is_empty()) {
            continue;
        }
        let reference = |(_, result): &(&Path, EvaluationResult)| {
            Some((result.policy.clone(), metric.estimate(&result.metrics)?.mean))
        };
        panels.push(Panel {
            title: metric.title.to_owned(),
            x_label: along.label().to_owned(),
            y_label: metric.axis.to_owned(),
            y_range: metric.range(),
            series,
            references: references.iter().filter_map(reference).collect(),
            ..Panel::default()
        });
    }
    let title = if alone {
        format!("Learning curve of {}", groups[0].label)
    } else {
        "Learning curves".to_owned()
    };
    figure(&out, &title, &panels, (700, 640))?;
    tell!("{}", out.display());
    Ok(Verdict::Good)
}

impl Group {
    /// Returns the curve of a metric in validations: of one run, or the mean of several.
    fn series(&self, along: Along, metric: &Metric) -> Series {
        let mut end = f64::INFINITY;
        let mut curves: Vec<Curve> = Vec::new();
        for run in &self.runs {
            let curve = curve(&run.lines, along, metric, Line::validation);
            let Some(last) = curve.last() else { continue };
            if !run.is_over {
                end = end.min(last.0);
            }
            curves.push(curve);
        }
        // Each group has one name, also in panels of metrics that some of its runs lack.
        let name = match self.runs.len() {
            0 | 1 => self.label.clone(),
            seeds => format!("{} ({seeds} seeds)", self.label),
        };
        if curves.len() > 1 {
            for curve in &mut curves {
                curve.retain(|point| point.0 <= end);
            }
        }
        mean_curve(name, &curves, along, metric)
    }
}

/// Reads runs and sorts them into groups with labels that differ.
fn groups(runs: &[PathBuf], along: Along) -> anyhow::Result<Vec<Group>> {
    let mut groups: Vec<Group> = Vec::new();
    let mut known: Vec<(toml::Table, Option<toml::Value>, &PathBuf)> = Vec::new();
    let mut runs: Vec<&PathBuf> = runs.iter().collect();
    runs.sort();
    for run in runs {
        if known.iter().any(|(.., other)| record::is_same_file(run, other)) {
            continue;
        }
        let (label, mut settings, seed) = identity(run);
        // Two runs of one seed, such as those of two versions of the program, are no sample of
        // seeds.
        if known.iter().any(|one| is_same(&one.0, &settings) && one.1 == seed) {
            settings.insert("folder".to_owned(), run.display().to_string().into());
        }
        known.push((settings.clone(), seed, run));
        let lines = read(run, along)?;
        let read = Run { is_over: is_over(&settings, &lines), lines };
        match groups.iter_mut().find(|group| is_same(&group.settings, &settings)) {
            Some(group) => group.runs.push(read),
            None => groups.push(Group { label, settings, folder: run.clone(), runs: vec![read] }),
        }
    }
    let labels: Vec<String> = groups.iter().map(|group| group.label.clone()).collect();
    for group in &mut groups {
        // Groups with the same label are told apart by their folders.
        if labels.iter().filter(|label| **label == group.label).count() > 1 {
            group.label = format!("{} {}", group.label, group.folder.display());
        }
    }
    Ok(groups)
}

/// Returns whether two runs have the same settings. A setting that the run of an earlier version
/// lacks counts as its default.
fn is_same(a: &toml::Table, b: &toml::Table) -> bool {
    let [a, b] = [a, b].map(ToString::to_string);
    config::changes(&a, &b).is_empty() || config::changes(&b, &a).is_empty()
}

/// Returns whether a run has taken all its steps or has solved its task, by its settings.
fn is_over(settings: &toml::Table, lines: &[Line]) -> bool {
    let steps = settings.get("steps").and_then(toml::Value::as_integer);
    let done = lines.last().map(|line| line.step);
    let enough = settings.get("train").and_then(|train| train.get("stop_success")?.as_float());
    let validations = curve(lines, Along::Steps, SUCCESS, Line::validation);
    let last = &validations[validations.len().saturating_sub(STOP_VALIDATIONS)..];
    let solved = |enough: f64| {
        let good = |point: &(f64, f64)| point.1 >= SUCCESS.scale.factor * enough;
        enough > 0.0 && last.len() == STOP_VALIDATIONS && last.iter().all(good)
    };
    steps.zip(done).is_some_and(|(steps, done)| done >= steps.cast_unsigned())
        || enough.is_some_and(solved)
}

fn read(run: &Path, along: Along) -> anyhow::Result<Vec<Line>> {
    let metrics = RunDir::new(run).metrics();
    ensure!(metrics.exists(), "`{}` is not a run folder: it has no metrics.jsonl", run.display());
    let lines = curves::read(&metrics)?;
    let is_empty = |of| curve(&lines, along, SUCCESS, of).is_empty();
    if is_empty(Line::exploration) && is_empty(Line::validation) {
        bail!(
            "`{}` contains no validation and no finished training episode with an agent to draw",
            run.display()
        );
    }
    Ok(lines)
}

/// Returns the label of a run (the algorithm, and the observation if it is not `conflict`) and the
/// settings that determine its training, without the seed; and the seed.
fn identity(run: &Path) -> (String, toml::Table, Option<toml::Value>) {
    let text = std::fs::read_to_string(RunDir::new(run).config()).unwrap_or_default();
    let mut settings: toml::Table = toml::from_str(&text).unwrap_or_default();
    let Some(algorithm) =
        settings.get("algorithm").and_then(toml::Value::as_str).map(str::to_owned)
    else {
        settings.insert("folder".to_owned(), run.display().to_string().into());
        return (run.display().to_string(), settings, None);
    };
    let seed = settings.remove("seed");
    for key in ["device", "simulation"] {
        settings.remove(key);
    }
    // Settings that the algorithm does not read make no difference.
    config::remove_untold(&mut settings, &algorithm);
    // The folder of the scenario file does not matter, and runs that start from a policy of their
    // own seed differ only in their seed.
    if let Some(toml::Value::Table(scenario)) = settings.get_mut("scenario") {
        shorten(scenario, "file", Path::file_name);
    }
    shorten(&mut settings, "init_from", |path| {
        let of_seed =
            path.file_name().is_some_and(|name| name.to_string_lossy().starts_with("seed_"));
        if of_seed { path.parent().map(Path::as_os_str) } else { Some(path.as_os_str()) }
    });
    let label = match settings
        .get("scenario")
        .and_then(|scenario| scenario.get("observation")?.get("groups"))
        .and_then(toml::Value::as_str)
    {
        Some(groups) if groups != "conflict" => format!("{algorithm}, {groups}"),
        _ => algorithm,
    };
    (label, settings, seed)
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

/// Returns the results of policies without training in a JSON file of `iwol evaluate`, each with
/// the file.
fn references(path: &Path) -> anyhow::Result<Vec<(&Path, EvaluationResult)>> {
    let text = std::fs::read_to_string(path)
        .with_context(|| format!("cannot read `{}`", path.display()))?;
    let results = EvaluationResult::read_all(&text)
        .with_context(|| format!("`{}` is no output of `iwol evaluate --json`", path.display()))?;
    let methods = crate::algo::names();
    let trained = |policy: &String| policy.is_empty() || methods.contains(&policy.as_str());
    let untrained: Vec<_> = results
        .into_iter()
        .filter(|result| !trained(&result.policy))
        .map(|result| (path, result))
        .collect();
    if untrained.is_empty() {
        bail!(
            "`{}` contains no result of a policy without training, such as of `iwol evaluate --policy sumo`",
            path.display()
        );
    }
    Ok(untrained)
}

/// Says which run a result cannot be compared with, because it is of another task; `None` if there
/// is no such run.
fn other_task(groups: &[Group], path: &Path, result: &EvaluationResult) -> Option<String> {
    let is_other = |group: &&Group| {
        let agents = group.settings.get("agents").and_then(toml::Value::as_integer);
        let trained = RunDir::new(&group.folder).fingerprint();
        agents.is_some_and(|agents| agents != i64::from(result.agents))
            || (trained.is_some() && result.fingerprint.is_some() && trained != result.fingerprint)
    };
    let group = groups.iter().find(is_other)?;
    let agents = counted(result.agents, "agent");
    Some(format!(
        "`{}` is a result on {} with {agents}, which is not the task of `{}`",
        path.display(),
        result.scenario,
        group.folder.display()
    ))
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
        let (label, first, seed) = run(
            0,
            "algorithm = \"mappo\"\nseed = 0\ninit_from = \"x/m/seed_0\"\n[scenario]\nfile = \"a/cross.xml\"",
        );
        assert_eq!((label.as_str(), seed), ("mappo", Some(0.into())));
        let (_, second, _) = run(
            1,
            "algorithm = \"mappo\"\nseed = 1\ninit_from = \"x/m/seed_1\"\n[scenario]\nfile = \"b/cross.xml\"",
        );
        assert_eq!(first, second);
        assert!(is_same(&first, &second));
        // A setting that an earlier version did not have is the same as its default.
        let (_, newer, _) = run(
            6,
            "algorithm = \"mappo\"\nseed = 1\ninit_from = \"x/m/seed_1\"\n[scenario]\nfile = \"b/cross.xml\"\n[scenario.reward]\ntime = 0.0",
        );
        assert!(is_same(&first, &newer) && is_same(&newer, &first));
        let (_, task, _) = run(
            2,
            "algorithm = \"mappo\"\nseed = 1\ninit_from = \"x/m/seed_1\"\n[scenario]\nfile = \"a/slow.xml\"",
        );
        assert_ne!(first, task);
        let (_, begun, _) = run(
            3,
            "algorithm = \"mappo\"\nseed = 1\ninit_from = \"x/n/seed_1\"\n[scenario]\nfile = \"a/cross.xml\"",
        );
        assert_ne!(first, begun);
        // MAPPO does not read the settings of MAGIC.
        let (_, without, _) = run(4, "algorithm = \"mappo\"\nseed = 0\n[train]\nenvs = 4");
        let (_, with, _) = run(
            5,
            "algorithm = \"mappo\"\nseed = 1\n[train]\nenvs = 4\n[magic]\nlambda_world = 0.5",
        );
        assert_eq!(without, with);
    }

    /// A run counts as finished if it has taken its steps or its last four validations are good
    /// enough to stop. The mean over seeds ends where the first unfinished run ends.
    #[test]
    fn the_mean_of_runs_ends_with_the_first_that_is_not_finished() {
        let settings: toml::Table =
            toml::from_str("steps = 100\n[train]\nstop_success = 0.9").expect("settings");
        let lines = |points: &[(u64, f64)]| -> Vec<Line> {
            let line = |(step, success): &(u64, f64)| {
                serde_json::from_value(
                    serde_json::json!({ "step": step, "validation/success": success }),
                )
            };
            points.iter().map(|point| line(point).expect("a line")).collect()
        };
        let whole = lines(&[(20, 0.2), (60, 0.5), (100, 0.8)]);
        let solved = lines(&[(20, 0.9), (30, 1.0), (40, 1.0), (50, 0.95)]);
        let broken = lines(&[(20, 0.9), (60, 0.4)]);
        let of = |all: [&Vec<Line>; 2]| {
            let run = |lines: &Vec<Line>| Run {
                is_over: is_over(&settings, lines),
                lines: lines.clone(),
            };
            let group = Group {
                label: "mappo".to_owned(),
                settings: settings.clone(),
                folder: PathBuf::new(),
                runs: all.map(run).into(),
            };
            let series = group.series(Along::Steps, SUCCESS);
            series.points.last().copied().expect("points")
        };
        assert_eq!(of([&whole, &solved]).0, 100.0);
        let end = of([&whole, &broken]);
        assert!(end.0 == 60.0 && (end.1 - 45.0).abs() < 1e-9, "{end:?}");
    }
}
