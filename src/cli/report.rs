//! `iwol report`

use std::path::PathBuf;

use iwol_sumo::report;
use iwol_sumo::sweep::Sweep;

use super::Verdict;

/// Tables, figures, Markdown, HTML and JSON of a sweep, from the files of its runs; may be asked
/// for while it runs.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Sweep file
    file: PathBuf,
    /// Folder of run folders, as in `iwol sweep`
    #[arg(long, value_name = "DIR", default_value = "runs")]
    runs: PathBuf,
    /// Folder to write [default: results/ and the name of the sweep]
    #[arg(long, short, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Copy what the report is made from to another folder of run folders: settings, validations
    /// and evaluations of every trained run, without weights. `--runs DIR` makes the report from
    /// them
    #[arg(long, value_name = "DIR")]
    keep: Option<PathBuf>,
}

pub(super) fn run(args: &Args) -> anyhow::Result<Verdict> {
    let sweep = Sweep::load(&args.file, &args.runs)?;
    let out = args.out.clone().unwrap_or_else(|| PathBuf::from("results").join(&sweep.name));
    let command = format!("iwol sweep {0}\niwol report {0}", args.file.display());
    for path in report::write(&sweep, &command, &out)? {
        tell!("{}", path.display());
    }
    if let Some(keep) = &args.keep {
        for cell in &sweep.cells {
            cell.keep(keep, &sweep.name)?;
        }
        tell!("{}", keep.join(&sweep.name).display());
    }
    Ok(Verdict::Good)
}
