//! `iwol plot`

use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use iwol_sumo::plot::{Panel, Series, figure};
use iwol_sumo::record::read_json_lines;
use iwol_sumo::train::RunDir;
use serde_json::Value;

use super::Verdict;

/// Validation success and window reward over environment steps.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Run folders
    #[arg(value_name = "RUN", required = true)]
    runs: Vec<PathBuf>,
    /// Picture to write [default: learning_curve.png in the first run folder]
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// JSON of `iwol evaluate`; policies without training in it become reference lines
    #[arg(long, value_name = "FILE")]
    reference: Option<PathBuf>,
}

pub(super) fn run(args: &Args) -> anyhow::Result<Verdict> {
    let mut success = Panel {
        title: "Success".to_owned(),
        x_label: "environment steps".to_owned(),
        y_label: "agents that arrive (%)".to_owned(),
        y_range: Some((0.0, 100.0)),
        series: Vec::new(),
        references: Vec::new(),
    };
    let mut window = Panel {
        title: "Throughput".to_owned(),
        y_label: "reward per agent in 1000 steps".to_owned(),
        y_range: None,
        ..success.clone()
    };
    for run in &args.runs {
        let path = RunDir::new(run).metrics();
        let lines: Vec<Value> =
            read_json_lines(&path).with_context(|| format!("`{}` is no run folder", run.display()))?;
        let name = label(run, args.runs.len());
        let curve = |key: &str, factor: f64| -> Vec<(f64, f64)> {
            lines.iter().filter_map(|line| Some((line["step"].as_f64()?, factor * line[key].as_f64()?))).collect()
        };
        let exploring = curve("episode/success", 100.0);
        if exploring.is_empty() {
            bail!("`{}` has no finished episode yet; train longer", run.display());
        }
        success.series.push(Series {
            label: format!("{name}, deterministic"),
            points: curve("validation/success", 100.0),
            band: None,
        });
        success.series.push(Series { label: format!("{name}, exploring"), points: exploring, band: None });
        window.series.push(Series {
            label: format!("{name}, deterministic"),
            points: curve("validation/window_reward", 1.0),
            band: None,
        });
    }
    if let Some(path) = &args.reference {
        for (policy, metrics) in references(path)? {
            let mean =
                |key: &str| metrics[key]["mean"].as_f64().with_context(|| format!("`{}` has no {key}", path.display()));
            success.references.push((policy.clone(), 100.0 * mean("success")?));
            window.references.push((policy, mean("window_reward")?));
        }
    }
    let out = args.out.clone().unwrap_or_else(|| args.runs[0].join("learning_curve.png"));
    let title = if args.runs.len() == 1 {
        format!("Learning curve of {}", label(&args.runs[0], 1))
    } else {
        "Learning curves".to_owned()
    };
    figure(&out, &title, &[success, window], (1400, 640))?;
    println!("{}", out.display());
    Ok(Verdict::Good)
}

/// What the run's own settings call it.
fn label(run: &Path, runs: usize) -> String {
    let settings = std::fs::read_to_string(RunDir::new(run).config()).unwrap_or_default();
    let table: toml::Table = toml::from_str(&settings).unwrap_or_default();
    match (table.get("algorithm").and_then(toml::Value::as_str), table.get("seed").and_then(toml::Value::as_integer)) {
        (Some(algorithm), Some(_)) if runs == 1 => algorithm.to_owned(),
        (Some(algorithm), Some(seed)) => format!("{algorithm} seed {seed}"),
        _ => run.display().to_string(),
    }
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
