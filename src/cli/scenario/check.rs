//! `iwol scenario check`

use std::path::{Path, PathBuf};

use anyhow::{Context as _, ensure};
use iwol_sumo::env;
use iwol_sumo::inspect::Trial;
use iwol_sumo::rng::Seed;
use iwol_sumo::scenario::{Demand, Finding, Findings, Scenario, Severity};
use iwol_sumo::sumo::{self, Hosting};
use iwol_sumo::words::counted;
use serde::Serialize;

use super::Verdict;
use crate::cli::chain;

/// Reads the file and its nets, then runs a trial of the scenario in SUMO.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "The exit code is 0 if the scenario has no errors (warnings are allowed), 1 if it has errors, and 2 if the command line is \
                  wrong or a file or SUMO is missing."
)]
pub(super) struct Args {
    /// Scenario file.
    scenario: PathBuf,
    /// Number of vehicles in the trial [default: the scenario's].
    #[arg(long)]
    agents: Option<u32>,
    /// Number of steps of the trial. With 0, there is no trial, and SUMO is not needed.
    #[arg(long, default_value_t = 1000)]
    steps: u32,
    /// Seed of the trial.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Print the result as one JSON object.
    #[arg(long)]
    json: bool,
}

/// The result, as printed with `--json`.
#[derive(Serialize)]
struct Report<'a> {
    scenario: &'a Path,
    errors: usize,
    warnings: usize,
    findings: &'a [Finding],
    trial: Option<&'a Trial>,
}

pub(super) fn run(args: &Args) -> anyhow::Result<Verdict> {
    let file = std::fs::metadata(&args.scenario);
    let file = file.with_context(|| format!("cannot read `{}`", args.scenario.display()))?;
    ensure!(file.is_file(), "`{}` is not a file", args.scenario.display());
    let mut findings = Scenario::check(&args.scenario);
    let trial = match &findings.scenario {
        Some(scenario) if args.steps > 0 => {
            let agents = args.agents.unwrap_or(scenario.agents.default);
            let hosting = Hosting::default();
            let refused = Trial::refused(scenario, agents, &hosting);
            let trial = refused.and_then(|refused| {
                let seed = Seed::new(args.seed);
                Ok((refused, Trial::run(scenario, agents, args.steps, seed, &hosting)?))
            });
            match trial {
                Ok((refused, trial)) => {
                    findings.list.extend(refused);
                    findings.list.extend(trial.findings(scenario));
                    Some(trial)
                }
                Err(error) if is_fault_of_scenario(&error) => {
                    findings.list.push(failed(&error, scenario));
                    None
                }
                Err(error) => return Err(error).context("the trial could not be run"),
            }
        }
        _ => None,
    };
    let count =
        |severity| findings.list.iter().filter(|finding| finding.severity == severity).count();
    let (errors, warnings) = (count(Severity::Error), count(Severity::Warning));
    if args.json {
        let report = Report {
            scenario: &args.scenario,
            errors,
            warnings,
            findings: &findings.list,
            trial: trial.as_ref(),
        };
        tell!("{}", serde_json::to_string(&report)?);
    } else {
        print(&findings, trial.as_ref());
        tell!(
            "{}: {}, {}",
            args.scenario.display(),
            counted(errors, "error"),
            counted(warnings, "warning")
        );
    }
    Ok(if errors > 0 { Verdict::Bad } else { Verdict::Good })
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
    let message = format!("the trial failed: {}", chain(error));
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

/// Prints the trial first, so that the findings stand at the end.
fn print(findings: &Findings, trial: Option<&Trial>) {
    if let Some(trial) = trial {
        print_trial(trial);
    }
    for severity in [Severity::Error, Severity::Warning] {
        for finding in findings.list.iter().filter(|finding| finding.severity == severity) {
            tell!("{finding}");
        }
    }
}

fn print_trial(trial: &Trial) {
    tell!("{:<32} {:>8} {:>8}  unit", "observation", "minimum", "maximum");
    for range in &trial.observation {
        tell!(
            "{:<32} {:>8.3} {:>8.3}  {}",
            range.name,
            range.least + 0.0,
            range.most + 0.0,
            range.unit
        );
    }
    if trial.lane_changes > 0.0 {
        tell!("lane changes: {:.0} % of the vehicles need one", 100.0 * trial.lane_changes);
    }
    tell!(
        "trial: {}, {}, {} ended, {:.0} steps/s of one world",
        counted(trial.agents, "agent"),
        counted(trial.steps, "step"),
        counted(trial.episodes, "episode"),
        trial.steps_per_second
    );
}
