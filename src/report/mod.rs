//! The report of a sweep: tables, figures and data for other programs, made only from the files of
//! its cells.
//!
//! The unit is the seed: the mean of a row is over trained runs, and its interval is Student's t.
//! Each table or figure has one unit of interval and names it (`Unit`). Aggregates over several
//! places of the horizontal axis (numbers of vehicles, ranges) follow Agarwal et al. (2021), see
//! [`crate::stats::aggregate`].

#![cfg(feature = "learn")]

mod block;
mod comparisons;
mod document;
mod export;
mod figures;
mod tables;

use std::path::{Path, PathBuf};

use toml::Table;

use crate::metrics::{EvaluationResult, Shown};
use crate::plot::{self, Format};
use crate::provenance::Training;
use crate::record::{self, write_atomic};
use crate::sweep::{self, Cell, Evaluate, Sweep};

use block::{Block, Unit};

/// Returns what a cell was trained with, from its run folder or otherwise from one of its results.
fn training(cell: &Cell, found: Option<&EvaluationResult>) -> Option<Training> {
    cell.run().training().or_else(|| found?.run.clone())
}

/// Writes the report of a sweep into a folder: `report.md`, `report.html`, figures in the given
/// format, `summary.json` (the metrics of every run) and `marl_eval.json` (the format of InstaDeep's
/// marl-eval). Returns the paths of the written files.
///
/// # Errors
/// If no cell is evaluated yet, or a file cannot be read or written.
pub fn write(
    sweep: &Sweep,
    command: &str,
    out: &Path,
    format: Format,
) -> Result<Vec<PathBuf>, Error> {
    let figure = |name: &str| out.join(format!("{name}.{}", format.extension()));
    for cell in &sweep.cells {
        cell.check()?;
    }
    let blocks: Vec<Block<'_>> = sweep
        .evaluations
        .iter()
        .map(|evaluate| block::block(sweep, evaluate))
        .collect::<Result<_, _>>()?;
    blocks.iter().try_for_each(|block| block::check_references(sweep, block))?;
    let found = |block: &Block<'_>| {
        block.series.iter().flat_map(|s| &s.rows).flat_map(|r| &r.runs).any(|r| r.1.is_some())
    };
    if !blocks.iter().any(found) {
        return Err(Error::Nothing { name: sweep.name.clone() });
    }
    std::fs::create_dir_all(out).map_err(record::Error::io("create", out))?;
    let mut written = Vec::new();
    let mut document = document::Document::new(&sweep.title);
    tables::introduce(&mut document, sweep, command);
    for block in blocks.iter().filter(|block| found(block)) {
        document.heading(2, &heading(sweep, block));
        let file = figure(&block.evaluate.name);
        figures::results(&file, sweep, block)?;
        let all: Vec<&str> = block.metrics(Shown::InFigures).map(|metric| metric.title).collect();
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
            let file = figure(&format!("{}_profile", block.evaluate.name));
            if figures::profile(&file, block)? {
                document
                    .figure(&file, "Performance profile: share of runs above each success rate");
                written.push(file);
            }
        }
    }
    comparisons::add(&mut document, sweep)?;
    let file = figure("learning_curves");
    let as_trained = as_trained(sweep);
    if figures::learning_curves(&file, &block::block(sweep, &as_trained)?)? {
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
    save("summary.json", export::summary(sweep, &blocks, command).as_bytes())?;
    save("marl_eval.json", format!("{}\n", export::marl_eval(&blocks)?).as_bytes())?;
    Ok(written)
}

/// Returns what sorts every cell into lines and places by the settings of its training.
fn as_trained(sweep: &Sweep) -> Evaluate {
    let first = &sweep.evaluations[0];
    let x = first.x.clone().filter(|x| sweep.grid.contains_key(x));
    Evaluate { x, panels: None, grid: Table::new(), when: Table::new(), ..first.clone() }
}

/// Returns a key in words: its last part, and the element of a value in the scenario.
fn in_words(key: &str) -> String {
    let name =
        key.strip_prefix("scenario.").unwrap_or_else(|| key.rsplit('.').next().unwrap_or(key));
    let spaced = |c: char| match c {
        '.' | '_' => vec![' '],
        c if c.is_uppercase() => vec![' ', c.to_ascii_lowercase()],
        c => vec![c],
    };
    name.chars().flat_map(spaced).collect()
}

fn heading(sweep: &Sweep, block: &Block<'_>) -> String {
    match &block.evaluate.title {
        none if none.is_empty() && sweep.evaluations.len() == 1 => "Results".to_owned(),
        none if none.is_empty() => block.evaluate.name.clone(),
        title => title.clone(),
    }
}

/// An error of a report.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// Nothing is evaluated yet.
    #[error(
        "the sweep `{name}` has no result yet; run it first with `iwol sweep`, or name the folder of its runs with --runs"
    )]
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
    /// Published values stand beside a series that the evaluation does not have.
    #[error("[[reference]] `{reference}`: beside = \"{beside}\" must be one of {}", quoted(series))]
    Beside {
        /// The label of the published values.
        reference: String,
        /// The name of the series.
        beside: String,
        /// The labels of the evaluation's series.
        series: Vec<String>,
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

/// Returns names in quotation marks, separated by commas.
fn quoted(names: &[String]) -> String {
    format!("`{}`", names.join("`, `"))
}
