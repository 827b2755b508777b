//! `iwol scenario check`

use std::path::PathBuf;

use anyhow::{Context as _, ensure};

use crate::inspect::{Report, Trial, check};
use crate::rng::Seed;
use crate::scenario::Severity;
use crate::words::counted;

use super::Verdict;

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

pub(super) fn run(args: &Args) -> anyhow::Result<Verdict> {
    let file = std::fs::metadata(&args.scenario);
    let file = file.with_context(|| format!("cannot read `{}`", args.scenario.display()))?;
    ensure!(file.is_file(), "`{}` is not a file", args.scenario.display());
    let report = check(&args.scenario, args.agents, args.steps, Seed::new(args.seed))
        .context("the trial could not be run")?;
    if args.json {
        tell!("{}", serde_json::to_string(&report)?);
    } else {
        print(&report);
        tell!(
            "{}: {}, {}",
            args.scenario.display(),
            counted(report.errors, "error"),
            counted(report.warnings, "warning")
        );
    }
    Ok(if report.errors > 0 { Verdict::Bad } else { Verdict::Good })
}

/// Prints the trial first, so that the findings stand at the end.
fn print(report: &Report) {
    if let Some(trial) = &report.trial {
        print_trial(trial);
    }
    for severity in [Severity::Error, Severity::Warning] {
        for finding in report.findings.iter().filter(|finding| finding.severity == severity) {
            tell!("{finding}");
        }
    }
}

fn print_trial(trial: &Trial) {
    if trial.saw_agents() {
        tell!("{:<32} {:>8} {:>8}  unit", "observation", "minimum", "maximum");
    }
    for range in trial.observation.iter().filter(|_| trial.saw_agents()) {
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
