//! Scenarios and tasks.

use std::path::PathBuf;
use std::sync::Arc;

use iwol_sumo::env::{Features, Task};
use iwol_sumo::scenario::{Override, ScenarioFile};
use iwol_sumo::suggest::nearest;
use iwol_sumo::sumo::Installation;
use pyo3::prelude::*;

use crate::env::refuse_after_fork;
use crate::error::{detached, exception, of_env, of_scenario, of_sumo};

/// A scenario prepared for a number of vehicles.
#[pyclass(frozen, module = "iwol_sumo._native")]
pub(crate) struct NativeTask {
    pub(crate) task: Arc<Task>,
    /// Number of vehicles that were asked for.
    pub(crate) vehicles: u32,
}

#[pymethods]
impl NativeTask {
    /// Reads a scenario file; `overrides` are pairs of a path, such as `termination.horizon`, and a
    /// value as in the file, or `None`, which leaves it as it is.
    #[new]
    fn new(
        py: Python<'_>,
        path: PathBuf,
        agents: Option<u32>,
        overrides: Vec<(String, Option<String>)>,
    ) -> PyResult<Self> {
        refuse_after_fork(py)?;
        let file = ScenarioFile::read(&path).map_err(|error| of_scenario(py, &error))?;
        let known = file.values();
        let mut edits = Vec::new();
        for (name, value) in &overrides {
            let parts: Vec<&str> = name.split('.').collect();
            let Some((attribute, present)) = known.iter().find(|(known, _)| known.path == parts)
            else {
                let names: Vec<String> =
                    known.iter().map(|(known, _)| known.path.join(".")).collect();
                let near = nearest(name, names.iter().map(String::as_str));
                let near = near.map(|near| format!("; did you mean `{near}`?")).unwrap_or_default();
                let text = format!("the scenario has no setting `{name}`{near}");
                return Err(exception(py, "ScenarioError", text));
            };
            // What the scenario has already stays as it is, so that all settings can be given back.
            let Some(value) = value.as_ref().filter(|value| present.as_ref() != Some(value)) else {
                continue;
            };
            if let Some(refusal) = attribute.refusal(value) {
                return Err(exception(py, "ScenarioError", format!("{name}: {refusal}")));
            }
            edits.push(Override { path: attribute.path.clone(), text: Some(value.clone()) });
        }
        let scenario = file.load(&edits).map_err(|refused| of_scenario(py, &refused.error))?;
        let vehicles = agents.unwrap_or(scenario.agents.default);
        let task = detached(py, || Task::new(&scenario, vehicles))?;
        let task = Arc::new(task.map_err(|error| of_env(py, &error))?);
        if let Some(line) = task.left_out() {
            detached(py, || tracing::warn!("{line}"))?;
        }
        Ok(Self { task, vehicles })
    }

    /// Length that counts as 1 in observed distances \[m\].
    #[getter]
    fn distance_scale(&self) -> f64 {
        self.task.scenario.observation.distance_scale
    }

    #[getter]
    fn name(&self) -> &str {
        &self.task.scenario.name
    }

    #[getter]
    fn description(&self) -> &str {
        &self.task.scenario.description
    }

    #[getter]
    fn agents(&self) -> usize {
        self.task.agents
    }

    #[getter]
    fn horizon(&self) -> u32 {
        self.task.scenario.termination.horizon
    }

    /// Seconds from one decision to the next.
    #[getter]
    fn interval(&self) -> f64 {
        self.task.scenario.control.interval
    }

    /// Largest number of agents of an episode; more than slots where these are used again.
    #[getter]
    fn most_agents(&self) -> usize {
        self.task.most_agents()
    }

    #[getter]
    fn actions(&self) -> Vec<&'static str> {
        self.task.spec.actions.names()
    }

    /// Name, unit, smallest and largest value of each number of an observation.
    #[getter]
    fn observation(&self) -> Vec<(String, String, f32, f32)> {
        described(&self.task.spec.observation)
    }

    /// The same of each number of an agent's privileged state.
    #[getter]
    fn state(&self) -> Vec<(String, String, f32, f32)> {
        described(&self.task.spec.state)
    }
}

fn described(features: &Features) -> Vec<(String, String, f32, f32)> {
    let row = |f: &iwol_sumo::env::Feature| (f.name.clone(), f.unit.clone(), f.low, f.high);
    features.list.iter().map(row).collect()
}

/// Returns path, present text and documentation of every attribute of a scenario file that a call
/// may override.
#[pyfunction]
pub(crate) fn overridable(
    py: Python<'_>,
    path: PathBuf,
) -> PyResult<Vec<(String, Option<String>, String)>> {
    let file = ScenarioFile::read(&path).map_err(|error| of_scenario(py, &error))?;
    let row = |(known, text): (iwol_sumo::scenario::Overridable, Option<String>)| {
        (known.path.join("."), text, known.attribute.text.clone())
    };
    Ok(file.values().into_iter().map(row).collect())
}

/// Returns SUMO's program, the reason why it is the one that is used, and its version.
#[pyfunction]
pub(crate) fn sumo(py: Python<'_>) -> PyResult<(PathBuf, String, String)> {
    let found = Installation::find().map_err(|error| of_sumo(py, &error))?;
    let version = detached(py, || found.version())?.map_err(|error| of_sumo(py, &error))?;
    Ok((found.binary().to_owned(), found.reason(), version.software))
}

/// Lets SUMO be found in this folder of Python packages as well.
#[pyfunction]
pub(crate) fn also_look_in(folder: PathBuf) {
    iwol_sumo::sumo::also_look_in(&folder);
}
