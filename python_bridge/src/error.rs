//! Errors of the library as Python exceptions.

use iwol_sumo::scenario::author;
use iwol_sumo::{env, scenario, sumo};
use pyo3::prelude::*;

/// Returns the exception of this name in `iwol_sumo.errors`, with a text.
pub(crate) fn exception(py: Python<'_>, name: &str, text: String) -> PyErr {
    let class = py.import("iwol_sumo.errors").and_then(|errors| errors.getattr(name));
    match class.and_then(|class| class.call1((text,))) {
        Ok(exception) => PyErr::from_value(exception),
        Err(error) => error,
    }
}

/// Runs `work` without the interpreter's lock, and returns the exception that Python code raised
/// meanwhile: Ctrl-C, or a handler of log messages.
pub(crate) fn detached<T: Send>(py: Python<'_>, work: impl FnOnce() -> T + Send) -> PyResult<T> {
    let done = py.detach(work);
    PyErr::take(py).map_or(Ok(done), Err)
}

/// Returns an error with all its causes, and the hint, as one text.
fn text(error: &(dyn std::error::Error + 'static), hint: Option<String>) -> String {
    let causes = std::iter::successors(Some(error), |error| error.source());
    let mut parts: Vec<String> = causes.map(ToString::to_string).collect();
    // An error that shows its cause as its own text would say it twice.
    parts.dedup();
    let text = parts.join(": ");
    hint.map_or(text.clone(), |hint| format!("{text}\nhint: {hint}"))
}

/// Returns the exception for an error of an environment.
pub(crate) fn of_env(py: Python<'_>, error: &env::Error) -> PyErr {
    let name = match error {
        env::Error::Scenario(_) | env::Error::Net(_) | env::Error::Long { .. } => "ScenarioError",
        env::Error::Sumo { .. } | env::Error::Vanished { .. } | env::Error::KeepsFailing { .. } => {
            "SumoError"
        }
        _ => "Error",
    };
    exception(py, name, text(error, error.hint()))
}

/// Returns the exception for an error of a scenario.
pub(crate) fn of_scenario(py: Python<'_>, error: &scenario::Error) -> PyErr {
    exception(py, "ScenarioError", text(error, error.hint()))
}

/// Returns a text with what Python calls the command line's options: the argument `left_hand` for
/// `--left-hand`, the function `import_osm` for `--osm`.
pub(crate) fn in_python(text: &str) -> String {
    let words = text.split_inclusive(' ').map(|word| {
        let Some(option) = word.strip_prefix("--") else { return word.to_owned() };
        let option = option.replace('-', "_");
        let import = ["osm", "net", "sumocfg"].contains(&option.trim_end());
        if import { format!("import_{option}") } else { option }
    });
    words.collect()
}

/// Returns the exception for an error of a scenario that is made.
pub(crate) fn of_author(py: Python<'_>, error: &author::Error) -> PyErr {
    if let author::Error::Sumo(error) = error {
        return of_sumo(py, error);
    }
    exception(py, "ScenarioError", in_python(&text(error, error.hint())))
}

/// Returns the exception for an error of a net.
pub(crate) fn of_net(py: Python<'_>, error: &sumo::net::NetError) -> PyErr {
    exception(py, "ScenarioError", text(error, error.hint()))
}

/// Returns the exception for an error of SUMO.
pub(crate) fn of_sumo(py: Python<'_>, error: &sumo::Error) -> PyErr {
    exception(py, "SumoError", text(error, error.hint()))
}
