//! A whole check of a scenario: its file, its nets, and a trial in SUMO.

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::Trial;
use crate::env;
use crate::rng::Seed;
use crate::scenario::{Demand, Finding, Scenario, Severity};
use crate::sumo::{self, Hosting};

/// The result of [`check`].
#[derive(Debug, Serialize)]
pub struct Report {
    /// The scenario file.
    pub scenario: PathBuf,
    /// Number of errors.
    pub errors: usize,
    /// Number of warnings.
    pub warnings: usize,
    /// The errors and warnings, those of the trial last.
    pub findings: Vec<Finding>,
    /// What the trial has shown; `None` if there was none, or SUMO failed in it.
    pub trial: Option<Trial>,
}

/// Checks a scenario file and its nets, and runs `steps` steps of it with `agents` agents (the
/// scenario's default number without). With 0 steps, there is no trial, and SUMO is not needed.
///
/// # Errors
/// [`env::Error`] if the trial could not be run, for a reason that is none of the scenario's.
pub fn check(
    path: &Path,
    agents: Option<u32>,
    steps: u32,
    seed: Seed,
) -> Result<Report, env::Error> {
    let found = Scenario::check(path);
    let mut findings = found.list;
    let mut shown = None;
    if let Some(scenario) = found.scenario.filter(|_| steps > 0) {
        let agents = agents.unwrap_or(scenario.agents.default);
        let hosting = Hosting::default();
        let refused = Trial::refused(&scenario, agents, &hosting);
        let trial = refused.and_then(|refused| {
            Ok((refused, Trial::run(&scenario, agents, steps, seed, &hosting)?))
        });
        match trial {
            Ok((refused, trial)) => {
                findings.extend(refused);
                findings.extend(trial.findings(&scenario));
                shown = Some(trial);
            }
            Err(error) if is_fault_of_scenario(&error) => {
                findings.push(failed(&error, &scenario));
            }
            Err(error) => return Err(error),
        }
    }
    let count = |severity| findings.iter().filter(|finding| finding.severity == severity).count();
    Ok(Report {
        scenario: path.to_owned(),
        errors: count(Severity::Error),
        warnings: count(Severity::Warning),
        findings,
        trial: shown,
    })
}

/// Returns whether the scenario or its net made the trial fail, and not the machine or the
/// requested number of agents.
fn is_fault_of_scenario(error: &env::Error) -> bool {
    match error {
        env::Error::Sumo { source, .. } => {
            matches!(
                source,
                sumo::Error::Exited { .. }
                    | sumo::Error::Refused { .. }
                    | sumo::Error::Closed { .. }
            )
        }
        env::Error::Scenario(_) | env::Error::Panicked { .. } | env::Error::Replay => false,
        _ => true,
    }
}

fn failed(error: &env::Error, scenario: &Scenario) -> Finding {
    let causes =
        std::iter::successors(Some(error as &dyn std::error::Error), |error| error.source());
    let causes: Vec<String> = causes.map(ToString::to_string).collect();
    let message = format!("the trial failed: {}", causes.join(": "));
    let (severity, kind) = (Severity::Error, "trial");
    let finding = Finding {
        severity,
        kind,
        file: scenario.path.clone(),
        at: None,
        message,
        hint: error.hint(),
    };
    match Demand::blamed(&scenario.traffic.files, &finding.message) {
        Some(place) => finding.moved_to(place),
        None => finding,
    }
}
