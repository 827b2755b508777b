//! `iwol export`

#![cfg(feature = "learn")]

use std::path::PathBuf;

use anyhow::{Context as _, bail};
use iwol_sumo::checkpoint::Checkpoint;
use iwol_sumo::record;
use iwol_sumo::scenario::Scenario;
use iwol_sumo::train::RunDir;

use super::Verdict;

/// The copy lacks the data that only `iwol train --resume` needs: the optimisers' moments and the
/// state of the worlds.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Run folder, whose best checkpoint is copied, or checkpoint file.
    run: PathBuf,
    /// Folder to create.
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
}

pub(super) fn run(args: &Args) -> anyhow::Result<Verdict> {
    let checkpoint = Checkpoint::load(&RunDir::checkpoint(&args.run))?.weights();
    let dir = RunDir::new(&args.out);
    if dir.best().exists() || dir.last().exists() {
        bail!("`{}` already contains a checkpoint; choose another --out", args.out.display());
    }
    if dir.config().exists() {
        bail!("`{}` already exists; choose another --out", dir.config().display());
    }
    std::fs::create_dir_all(args.out.join("checkpoints"))
        .with_context(|| format!("cannot create the folder `{}`", args.out.display()))?;
    record::write_atomic(&dir.config(), checkpoint.config.as_bytes())?;
    // The record of what the policy was trained with is copied along with the policy.
    let meta = RunDir::of(&args.run).map(|run| run.meta()).filter(|meta| meta.is_file());
    if let Some(meta) = meta {
        let bytes =
            std::fs::read(&meta).with_context(|| format!("cannot read `{}`", meta.display()))?;
        record::write_atomic(&dir.meta(), &bytes)?;
    }
    // So is the scenario, whose paths are relative to its folder.
    let scenario = RunDir::of(&args.run).map(|run| run.scenario()).filter(|file| file.is_file());
    if let Some(file) = scenario {
        let text = Scenario::read(&file)?.to_xml_in(&args.out).with_context(|| {
            format!("cannot find the net or the route files of `{}`", file.display())
        })?;
        record::write_atomic(&dir.scenario(), text.as_bytes())?;
    }
    checkpoint.save(&dir.best())?;
    tell!("{}", args.out.display());
    Ok(Verdict::Good)
}
