//! Sweeps: a grid of settings. Each combination is a training run in its own folder, evaluated in
//! one or more ways.
//!
//! ```toml
//! title = "Success against the number of vehicles"
//! [settings]                              # of every run, as in `--config`
//! scenario = "scenarios/intersection.xml"
//! [grid]                                  # every combination is a cell
//! algorithm = ["im-iwol", "mappo"]
//! agents = [4, 8]
//! seed = [0, 1, 2]
//! [[rule]]                                # settings of the cells that match
//! when = { agents = 8 }
//! set = { "train.envs" = 8 }
//! [[skip]]                                # combinations that are no cells
//! when = { agents = 4, seed = 2 }
//! [[evaluate]]                            # an evaluation of each policy, for each combination
//! name = "range"
//! episodes = 200
//! grid = { "scenario.communication.range" = [100.0, 10.0] }
//! [[contrast]]                            # a comparison, named before the runs
//! title = "Im-IWoL against MAPPO"
//! metric = "success"
//! plus = [{ algorithm = "im-iwol", agents = 8 }]
//! minus = [{ algorithm = "mappo", agents = 8 }]
//! ```
//!
//! A file may name another file as its `base` and then contains only what differs from it.
//!
//! The progress of a sweep follows only from the files in the cells' folders, so that a sweep can
//! be interrupted at any moment, divided over machines, and continued.

#![cfg(feature = "learn")]

mod base;
mod cell;
mod conditions;
mod contrast;
mod distinct;
mod error;
mod file;

use std::path::Path;

use serde::Deserialize;
use toml::{Table, Value};

pub use cell::{Cell, Job, State};
pub use contrast::{Compared, Contrast};
pub use error::Error;

use conditions::holds;
use file::File;

pub use crate::config::plain;

/// A sweep file.
#[derive(Debug, Clone)]
pub struct Sweep {
    /// Name of the sweep: the file name without its extension.
    pub name: String,
    /// Title of the report.
    pub title: String,
    /// Keys of the grid, in the file's order, each with its number of values.
    pub keys: Vec<(String, usize)>,
    /// The grid.
    pub grid: Table,
    /// The cells. Seeds vary slowest, so that an interrupted sweep has complete rows for its first
    /// seeds.
    pub cells: Vec<Cell>,
    /// Evaluations of each trained policy.
    pub evaluations: Vec<Evaluate>,
    /// Published values to compare with.
    pub references: Vec<Reference>,
    /// Comparisons of trained runs.
    pub contrasts: Vec<Contrast>,
}

/// One way of evaluating the policy of each cell.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Evaluate {
    /// Name, in file names and headings.
    #[serde(default = "Evaluate::default_name")]
    pub name: String,
    /// Heading in the report.
    #[serde(default)]
    pub title: String,
    /// Number of episodes, the same for all cells and combinations.
    #[serde(default = "Evaluate::default_episodes")]
    pub episodes: u64,
    /// Which checkpoint is evaluated: the last one, or the one with the best validation.
    #[serde(default)]
    pub checkpoint: Which,
    /// Settings of the task and of the policy that differ from training. Each combination is a
    /// separate evaluation.
    #[serde(default)]
    pub grid: Table,
    /// Selects the cells that are evaluated: those with these values, or with one of a list of
    /// values [default: all].
    #[serde(default)]
    pub when: Table,
    /// The key along the horizontal axis of the figure [default: the only key of this grid, or else
    /// `agents` if it varies, or else the first key that varies, except `algorithm` and `seed`].
    #[serde(default)]
    pub x: Option<String>,
    /// A key whose values each get their own panel in the figure, which then shows only success.
    #[serde(default)]
    pub panels: Option<String>,
}

impl Evaluate {
    fn default_name() -> String {
        "evaluation".to_owned()
    }

    fn default_episodes() -> u64 {
        200
    }

    /// Returns the name of the file with the result for a combination of this grid.
    fn result(&self, combination: &[(String, Value)]) -> String {
        match label(combination) {
            none if none.is_empty() => format!("{}.json", self.name),
            label => format!("{}_{label}.json", self.name),
        }
    }

    /// Returns whether this evaluation applies to a cell.
    pub fn applies(&self, cell: &Cell) -> bool {
        holds(&self.when, |key| cell.value(key))
    }

    /// Returns the combinations of this grid, each a list of keys and values; a single empty
    /// combination without a grid.
    pub fn combinations(&self) -> Vec<Vec<(String, Value)>> {
        combinations(&self.grid)
    }

    /// Returns a combination as values of `--set`.
    pub fn sets(&self, combination: &[(String, Value)]) -> Vec<String> {
        combination.iter().map(|(key, value)| format!("{key}={}", plain(value))).collect()
    }
}

/// Which checkpoint is evaluated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Which {
    /// The checkpoint at the end of training.
    #[default]
    Last,
    /// The checkpoint with the best validation.
    Best,
}

impl Which {
    /// Returns the file name of the checkpoint.
    pub fn file(self) -> &'static str {
        match self {
            Self::Last => "last.safetensors",
            Self::Best => "best.safetensors",
        }
    }
}

/// Published values, drawn and tabulated beside those of the sweep.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Reference {
    /// Name in legend and table.
    pub label: String,
    /// Label of the series of this sweep with which the values are compared; they are drawn in its
    /// colour.
    #[serde(default)]
    pub beside: String,
    /// Metric, as in the JSON of `iwol evaluate`.
    pub metric: String,
    /// Values along the horizontal axis, as in the grid; empty if the evaluation has no axis.
    #[serde(default)]
    pub x: Vec<Value>,
    /// The published values at `x`, in the metric's unit (rates from 0 to 1).
    pub y: Vec<f64>,
    /// Name of the evaluation to which the values belong [default: the first].
    #[serde(default)]
    pub evaluate: Option<String>,
}

impl Sweep {
    /// Reads a sweep file and resolves every cell. The run folders lie below `out`.
    ///
    /// # Errors
    /// An [`Error`] that names file, cell and key.
    pub fn load(path: &Path, out: &Path) -> Result<Self, Error> {
        let text = base::read(path)?;
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        Self::parse(&text, &path.display().to_string(), &name, out)
    }

    /// Does the same as [`Sweep::load`] for a given text. Messages call the text `file`; the path
    /// of its base is relative to the folder of `file`.
    ///
    /// # Errors
    /// See [`Sweep::load`].
    pub fn parse(text: &str, file: &str, name: &str, out: &Path) -> Result<Self, Error> {
        let parsed = File::read(text, file)?;
        let cells = parsed.cells(file, &out.join(name))?;
        let count = |value: &Value| value.as_array().map_or(1, Vec::len);
        Ok(Self {
            name: name.to_owned(),
            title: if parsed.title.is_empty() { name.to_owned() } else { parsed.title },
            grid: parsed.grid.clone(),
            keys: parsed.grid.iter().map(|(key, value)| (key.clone(), count(value))).collect(),
            cells,
            evaluations: parsed.evaluate,
            references: parsed.reference,
            contrasts: parsed.contrast,
        })
    }

    /// Returns the cell that must be trained before this one; `None` if there is none or it is
    /// trained.
    pub fn waits_for(&self, cell: &Cell) -> Option<&Cell> {
        let first = self.cells.iter().find(|other| cell.after.as_ref() == Some(&other.id))?;
        (cell.trained().is_none() && first.trained().is_none()).then_some(first)
    }
}

fn value_of<'a>(values: &'a [(String, Value)], key: &str) -> Option<&'a Value> {
    values.iter().find(|(own, _)| own == key).map(|(_, value)| value)
}

/// Returns all combinations of a grid's values; the last key varies fastest.
fn combinations(grid: &Table) -> Vec<Vec<(String, Value)>> {
    let mut all = vec![Vec::new()];
    for (key, values) in grid {
        let values = values.as_array().map_or(&[][..], Vec::as_slice);
        all = all
            .into_iter()
            .flat_map(|chosen: Vec<(String, Value)>| {
                values
                    .iter()
                    .map(move |value| [&chosen[..], &[(key.clone(), value.clone())]].concat())
            })
            .collect();
    }
    all
}

/// Returns `key=value` pairs joined by `_`, fit for a file name, with the last part of each key; of
/// the algorithm only the value.
fn label(values: &[(String, Value)]) -> String {
    let safe = |text: String| {
        text.chars()
            .map(|c| if c.is_alphanumeric() || "-.+=".contains(c) { c } else { '-' })
            .collect::<String>()
    };
    let part = |(key, value): &(String, Value)| {
        let value = safe(plain(value));
        if key == "algorithm" {
            value
        } else {
            format!("{}={value}", key.rsplit('.').next().unwrap_or(key))
        }
    };
    values.iter().map(part).collect::<Vec<_>>().join("_")
}

#[cfg(test)]
mod tests;
