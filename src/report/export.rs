//! The results of a report for other programs, as JSON.

use std::collections::HashSet;

use serde_json::{Value, json};

use super::block::Block;
use super::{Error, training};
use crate::curves;
use crate::metrics::{self, EvaluationResult, SUCCESS, Shown};
use crate::sweep::{Cell, Sweep};

/// Returns the metrics of every run, with a description of the run, as JSON with one line per run and
/// evaluation.
pub(super) fn summary(sweep: &Sweep, blocks: &[Block<'_>], command: &str) -> String {
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
                        "cell": cell.id, "algorithm": cell.config.algorithm, "agents": found.agents,
                        "seed": cell.config.seed, "episodes": found.episodes,
                        "training_steps": trained.as_ref().map(|t| t.steps),
                        "training_seconds": trained.map(|t| t.seconds), "run": training(cell, Some(found)),
                        "program": found.program, "metrics": found.metrics,
                    }));
                }
            }
        }
    }
    let rows = rows.iter().map(Value::to_string).collect::<Vec<_>>().join(",\n");
    let (name, command) = (json!(sweep.name), json!(command));
    format!("{{\"sweep\":{name},\"command\":{command},\"rows\":[\n{rows}\n]}}\n")
}

/// Returns the results in the format of marl-eval: environment, task, algorithm, run, then steps
/// with their values, and the final values. The final values of a cell are those of the first
/// evaluation that applies to it.
pub(super) fn marl_eval(blocks: &[Block<'_>]) -> Result<Value, Error> {
    let mut tree = json!({});
    let mut known: HashSet<&str> = HashSet::new();
    for block in blocks {
        let mut own: HashSet<&str> = HashSet::new();
        for line in &block.series {
            for (category, row) in block.categories.iter().zip(&line.rows) {
                for (cell, found) in
                    row.runs.iter().filter_map(|(cell, found)| Some((cell, found.as_ref()?)))
                {
                    if known.contains(cell.id.as_str()) {
                        continue;
                    }
                    own.insert(&cell.id);
                    let task = match &block.x {
                        Some(x) => format!("{x}={category}"),
                        None => "all".to_owned(),
                    };
                    let seed = format!("seed_{}", cell.config.seed);
                    tree[environment(cell)][&task][&line.label][seed] = run(cell, found)?;
                }
            }
        }
        known.extend(own);
    }
    Ok(tree)
}

/// Returns the name of the environment, or that of the scenario's file.
fn environment(cell: &Cell) -> String {
    match cell.config.environment.as_str() {
        "" => {
            let scenario = cell.config.scenario.file.file_stem().unwrap_or_default();
            scenario.to_string_lossy().into_owned()
        }
        built_in => built_in.to_owned(),
    }
}

/// Returns the validations of a run and its final values.
fn run(cell: &Cell, found: &EvaluationResult) -> Result<Value, Error> {
    let mut run = json!({});
    let lines = curves::read(&cell.run().metrics())?;
    let validations = lines.iter().filter(|line| line.validation(SUCCESS).is_some());
    for (k, line) in validations.enumerate() {
        let mut step = json!({ "step_count": line.step, "elapsed_time": line.seconds });
        for metric in metrics::shown(Shown::Everywhere) {
            step[metric.id] = json!([line.validation(metric)]);
        }
        run[format!("step_{k}")] = step;
    }
    for metric in metrics::shown(Shown::Everywhere) {
        let mean = metric.unscaled(&found.metrics).map(|estimate| estimate.mean);
        run["absolute_metrics"][metric.id] = json!([mean]);
    }
    Ok(run)
}
