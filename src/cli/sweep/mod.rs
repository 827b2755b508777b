//! `iwol sweep`

#![cfg(feature = "learn")]

mod progress;
mod slurm;
mod work;

use std::path::PathBuf;
use std::sync::atomic::Ordering;

use anyhow::bail;
use globset::Glob;

use crate::sweep::{Cell, State, Sweep};
use crate::words::counted;

use self::progress::{table, time_left};
use super::{Verdict, program, word};

/// Trains and evaluates every cell of a grid, each in its own process and folder. Finished cells
/// are skipped and interrupted cells continue, so that the same command resumes a sweep.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Sweep file, e.g. experiments/paper/scalability.toml
    file: PathBuf,
    /// Number of cells that run at the same time [default: 1, as a cell learns on the cores that
    /// `ppo.shards` says; with --slurm as many as Slurm allows]
    #[arg(long, short, value_parser = clap::value_parser!(u16).range(1..))]
    jobs: Option<u16>,
    /// Run only every N-th cell, starting with the I-th, to divide the grid among N machines
    #[arg(long, value_name = "I/N", value_parser = parse_shard)]
    shard: Option<(usize, usize)>,
    /// Run only the cells with this name or number, as `--dry-run` shows them; may be repeated.
    /// Names may be glob patterns, e.g. 'mappo*/seed_[0-4]': `*` matches any part of a name, `/`
    /// included, `?` one character, `[0-4]` one of these, and `{a,b}` either
    #[arg(long, value_name = "CELL", conflicts_with = "shard")]
    cell: Vec<Glob>,
    /// Show the cells, their progress and the estimated remaining time; run nothing
    #[arg(long)]
    dry_run: bool,
    /// Run failed cells again
    #[arg(long)]
    retry: bool,
    /// Submit the unfinished cells to Slurm as a job array
    #[arg(long, conflicts_with_all = ["shard", "cell", "dry_run"])]
    slurm: bool,
    /// An option for Slurm's sbatch, e.g. --slurm-option time=04:00:00; may be repeated
    #[arg(long, value_name = "KEY=VALUE", requires = "slurm")]
    slurm_option: Vec<String>,
    /// Folder for run folders; the sweep gets a subfolder with the name of its file
    #[arg(long, short, value_name = "DIR", default_value = "runs")]
    out: PathBuf,
}

fn parse_shard(text: &str) -> Result<(usize, usize), String> {
    let parsed = text.split_once('/').and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)));
    match parsed {
        Some((i, n)) if 1 <= i && i <= n => Ok((i, n)),
        _ => Err("write it as i/n with 1 <= i <= n, e.g. 2/4".to_owned()),
    }
}

/// Returns whether a pattern selects a cell, by its name or number.
fn selects(wanted: &Glob, number: usize, name: &str) -> bool {
    wanted.glob() == number.to_string() || wanted.compile_matcher().is_match(name)
}

pub(super) fn run(args: &Args) -> anyhow::Result<Verdict> {
    let sweep = Sweep::load(&args.file, &args.out)?;
    let mine = |(number, cell): &(usize, &Cell)| match args.shard {
        Some((i, n)) => number % n == i - 1,
        None => {
            args.cell.is_empty()
                || args.cell.iter().any(|wanted| selects(wanted, *number, &cell.id))
        }
    };
    let count = counted(sweep.cells.len(), "cell");
    let unknown = |wanted: &&Glob| {
        !sweep.cells.iter().enumerate().any(|(number, cell)| selects(wanted, number, &cell.id))
    };
    if let Some(wanted) = args.cell.iter().find(unknown) {
        bail!(
            "there is no cell `{}`; the sweep has {count}, numbered from 0; --dry-run without --cell lists them",
            wanted.glob()
        );
    }
    let cells: Vec<(usize, &Cell)> = sweep.cells.iter().enumerate().filter(mine).collect();
    if cells.is_empty() {
        bail!("this shard contains no cell; the sweep has only {count}");
    }
    for (_, cell) in &cells {
        cell.check()?;
    }
    if args.dry_run {
        super::print(format_args!("{}", table(&sweep, &cells)));
        return Ok(Verdict::Good);
    }
    if args.retry {
        for (_, cell) in &cells {
            cell.retry()?;
        }
    }
    if args.slurm {
        return slurm::submit(args, &sweep);
    }
    let stop = super::stop_flag()?;
    work::run(&sweep, &cells, usize::from(args.jobs.unwrap_or(1)), &stop)?;
    super::print(format_args!("{}", table(&sweep, &cells)));
    let states = || cells.iter().map(|(_, cell)| cell.state(&sweep.evaluations));
    let failed: Vec<_> =
        cells.iter().zip(states()).filter(|(_, state)| matches!(state, State::Failed(_))).collect();
    for ((_, cell), state) in &failed {
        if let State::Failed(lines) = state {
            say!("\n{} failed; its messages are in {}\n{lines}", cell.id, cell.log().display());
        }
    }
    if !failed.is_empty() {
        let all = counted(cells.len(), "cell");
        say!("\n{} of {all} failed; run them again with --retry", failed.len());
    }
    if stop.load(Ordering::Relaxed) {
        say!("stopped; run the same command again to continue");
        return Ok(Verdict::Interrupted);
    }
    let waiting = cells.iter().filter(|(_, cell)| sweep.waits_for(cell).is_some()).count();
    if waiting > 0 {
        say!(
            "{waiting} of {} must wait for other cells that failed or are not in this part of the grid; run the same command again to continue",
            counted(cells.len(), "cell")
        );
        return Ok(Verdict::Bad);
    }
    let open =
        states().filter(|state| !matches!(state, State::Finished | State::Failed(_))).count();
    if open > 0 {
        say!(
            "{open} of {} are not finished: they were stopped, or another process works on them; run the same command again to continue",
            counted(cells.len(), "cell")
        );
        return Ok(Verdict::Bad);
    }
    if failed.is_empty() {
        say!("report: {} report {} --runs {}", program(), word(&args.file), word(&args.out));
    }
    Ok(if failed.is_empty() { Verdict::Good } else { Verdict::Bad })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn selects(wanted: &str, name: &str) -> bool {
        super::selects(&Glob::new(wanted).expect("a pattern"), 12, name)
    }

    #[test]
    fn a_pattern_selects_cells_by_name_or_number() {
        for wanted in [
            "mappo_agents=8/seed_0",
            "*",
            "mappo*",
            "*seed_0",
            "mappo*/seed_0",
            "*agents=8*",
            "m*p*8*0",
            "mappo_agents=8/seed_0*",
            "12",
            "mappo_agents=?/seed_[0-4]",
            "{mappo,mat}_*",
        ] {
            assert!(selects(wanted, "mappo_agents=8/seed_0"), "{wanted}");
        }
        for wanted in
            ["", "mappo", "*seed_1", "mappo*/seed_", "mappo_agents=8/seed_0*0", "agents=8*", "1"]
        {
            assert!(!selects(wanted, "mappo_agents=8/seed_0"), "{wanted}");
        }
    }
}
