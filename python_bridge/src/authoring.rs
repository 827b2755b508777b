//! Scenarios that are made, checked and drawn.

use std::path::PathBuf;

use iwol_sumo::env::Task;
use iwol_sumo::inspect;
use iwol_sumo::rng::Seed;
use iwol_sumo::scenario::Scenario;
use iwol_sumo::scenario::author::{
    self, Choices, Imported, Map, Sizes, Template, import_configuration,
};
use iwol_sumo::sumo::net::Net;
use pyo3::prelude::*;

use crate::env::refuse_after_fork;
use crate::error::{detached, exception, in_python, of_author, of_env, of_net, of_scenario};

/// What an import has made: the scenario file, the junctions (id, kind, arms, routes, places),
/// netconvert's warnings, and notes.
type Import = (PathBuf, Vec<(String, String, usize, usize, u32)>, Vec<String>, Vec<String>);

/// Writes a scenario from a template below the folder `root`, and builds its net. `sizes` are lanes,
/// length of the arms, agents, speed, and whether vehicles steer.
#[pyfunction]
pub(crate) fn new_scenario(
    py: Python<'_>,
    root: PathBuf,
    name: &str,
    template: &str,
    sizes: (Option<u32>, Option<f64>, u32, f64, bool),
) -> PyResult<PathBuf> {
    let Some(template) = Template::by_name(template) else {
        let names: Vec<&str> = Template::ALL.iter().map(|template| template.name()).collect();
        let text = format!("there is no template `{template}`; choose one of {}", names.join(", "));
        return Err(exception(py, "ScenarioError", text));
    };
    let (lanes, arm_length, agents, speed, steering) = sizes;
    let sizes = Sizes { lanes, arm_length, agents, speed, steering };
    let made = detached(py, || author::create(&root, name, template, &sizes))?;
    made.map_err(|error| of_author(py, &error))
}

/// Makes a scenario from a map below the folder `root`: `osm` says whether the file is an extract of
/// OpenStreetMap or else a net. `choices` are the junction, agents, whether vehicles steer, whether
/// they drive on the left, and whether a large net stays whole.
#[pyfunction]
pub(crate) fn import_map(
    py: Python<'_>,
    root: PathBuf,
    name: &str,
    file: PathBuf,
    osm: bool,
    choices: (Option<String>, u32, bool, bool, bool),
) -> PyResult<Import> {
    let (junction, agents, steering, left_hand, whole_net) = choices;
    let junction = junction.as_deref();
    let choices = Choices { junction, agents, steering, left_hand, whole_net };
    let map = if osm { Map::Osm(&file) } else { Map::Net(&file) };
    let imported = detached(py, || author::import(&root, name, map, &choices))?;
    imported.map(parts).map_err(|error| of_author(py, &error))
}

/// Makes a scenario from a configuration of SUMO below the folder `root`.
#[pyfunction]
pub(crate) fn import_sumocfg(
    py: Python<'_>,
    root: PathBuf,
    name: &str,
    file: PathBuf,
    agents: Option<u32>,
) -> PyResult<Import> {
    let imported = detached(py, || import_configuration(&root, name, &file, agents))?;
    imported.map(parts).map_err(|error| of_author(py, &error))
}

fn parts(imported: Imported) -> Import {
    let row =
        |site: author::Candidate| (site.junction, site.kind, site.arms, site.routes, site.places);
    let candidates = imported.candidates.into_iter().map(row).collect();
    let notes = imported.notes.iter().map(|note| in_python(note)).collect();
    (imported.scenario, candidates, imported.warnings, notes)
}

/// Checks a scenario, with a trial of so many steps, and returns the JSON that
/// `iwol scenario check --json` prints.
#[pyfunction]
pub(crate) fn check_scenario(
    py: Python<'_>,
    file: PathBuf,
    agents: Option<u32>,
    steps: u32,
    seed: u64,
) -> PyResult<String> {
    refuse_after_fork(py)?;
    let report = detached(py, || inspect::check(&file, agents, steps, Seed::new(seed)))?;
    let report = report.map_err(|error| of_env(py, &error))?;
    serde_json::to_string(&report).map_err(|error| exception(py, "Error", error.to_string()))
}

/// Draws a scenario as SVG, or as a web page with a table of the routes.
#[pyfunction]
pub(crate) fn show_scenario(
    py: Python<'_>,
    file: PathBuf,
    agents: Option<u32>,
    html: bool,
) -> PyResult<String> {
    let scenario = Scenario::load(&file).map_err(|error| of_scenario(py, &error))?;
    let agents = agents.unwrap_or(scenario.agents.default);
    let task =
        detached(py, || Task::new(&scenario, agents))?.map_err(|error| of_env(py, &error))?;
    let net = Net::load(task.map.net_file()).map_err(|error| of_net(py, &error))?;
    Ok(py.detach(|| {
        if html { inspect::page(&task, &net) } else { inspect::picture(&task, &net).svg() }
    }))
}
