//! `iwol scenario build`

use std::path::PathBuf;

use crate::scenario::author::{State, build};

use super::Verdict;

/// Builds each net whose sources, which its .netccfg names, are newer than the net.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Scenario file.
    scenario: PathBuf,
    /// Build all nets that have sources, even if they are up to date.
    #[arg(long)]
    all: bool,
}

pub(super) fn run(args: &Args) -> anyhow::Result<Verdict> {
    for net in build(&args.scenario, args.all)? {
        let done = match net.before {
            State::NoSources => "has no sources (no .netccfg next to it)",
            State::UpToDate if !args.all => "up to date",
            State::UpToDate | State::OutOfDate => "built",
        };
        tell!("{}: {done}", net.net.display());
        for warning in net.warnings {
            say!("netconvert: {warning}");
        }
    }
    Ok(Verdict::Good)
}
