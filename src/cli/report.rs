//! `iwol report`

#![cfg(feature = "learn")]

use std::path::{Path, PathBuf};

use clap::builder::{PossibleValuesParser, TypedValueParser};

use crate::plot::Format;
use crate::report;
use crate::sweep::Sweep;
use crate::words::counted;

use super::{Verdict, program, word};

/// Writes the results of a sweep as tables and figures in Markdown, HTML and JSON, from the files
/// of its runs. The sweep may still be running.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Sweep file
    file: PathBuf,
    /// Folder that contains the run folders, as `--out` of `iwol sweep`
    #[arg(long, value_name = "DIR", default_value = "runs")]
    runs: PathBuf,
    /// Folder to write to [default: results/SWEEP]
    #[arg(long, short, value_name = "DIR")]
    out: Option<PathBuf>,
    /// File format of the figures
    #[arg(long, value_name = "png|svg", default_value = "png", value_parser = format())]
    figures: Format,
    /// Also copy the data of the report to this folder: settings, validations and evaluations of
    /// every trained run, without weights. `--runs DIR` makes the report from this copy
    #[arg(long, value_name = "DIR")]
    keep: Option<PathBuf>,
}

fn format() -> impl TypedValueParser<Value = Format> {
    let names = PossibleValuesParser::new(["png", "svg"]);
    names.map(|name| if name == "svg" { Format::Svg } else { Format::Png })
}

pub(super) fn run(args: &Args) -> anyhow::Result<Verdict> {
    let sweep = Sweep::load(&args.file, &args.runs)?;
    let out = args.out.clone().unwrap_or_else(|| PathBuf::from("results").join(&sweep.name));
    let file = word(&args.file);
    let is_usual = args.runs == Path::new("runs");
    let runs = if is_usual { String::new() } else { format!(" --runs {}", word(&args.runs)) };
    let into = if is_usual { String::new() } else { format!(" --out {}", word(&args.runs)) };
    let command = format!("{0} sweep {file}{into}\n{0} report {file}{runs}", program());
    for path in report::write(&sweep, &command, &out, args.figures)? {
        tell!("{}", path.display());
    }
    if let Some(keep) = &args.keep {
        let mut earlier = 0;
        for cell in &sweep.cells {
            earlier += usize::from(cell.keep(keep, &sweep.name)?);
        }
        if earlier > 0 {
            say!(
                "{} in {} are of earlier copies: their runs are not trained in {}",
                counted(earlier, "cell"),
                keep.display(),
                args.runs.display()
            );
        }
        tell!("{}", keep.join(&sweep.name).display());
    }
    Ok(Verdict::Good)
}
