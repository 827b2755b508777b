//! `iwol replay`

use std::path::{Path, PathBuf};

use anyhow::bail;

use crate::record::{is_same_file, write_atomic};
use crate::replay::Recording;

use super::Verdict;

/// Writes an HTML file that plays a recording in any browser, without a network connection, or a
/// picture of one step.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Recording that `iwol evaluate --record` wrote.
    recording: PathBuf,
    /// HTML file to write.
    #[arg(long, short, value_name = "FILE", required_unless_present = "svg")]
    out: Option<PathBuf>,
    /// SVG picture to write: one step, and where the agents have driven until then.
    #[arg(long, value_name = "FILE")]
    svg: Option<PathBuf>,
    /// Step that the picture shows [default: the middle of the episode].
    #[arg(long, value_name = "STEP", requires = "svg")]
    at: Option<usize>,
}

/// Words of which each file that this command writes has one: a player, or a picture.
const MARKS: [&str; 2] =
    ["<script id=\"recording\"", "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox"];

/// Refuses to replace a file that this command has not written.
fn refuse_foreign(path: &Path) -> anyhow::Result<()> {
    if !path.exists() {
        return Ok(());
    }
    let content = std::fs::read_to_string(path).unwrap_or_default();
    let is_own = MARKS.iter().any(|mark| content.contains(mark));
    if !is_own {
        bail!(
            "`{}` already exists and is neither a player nor a picture of a recording; choose another file",
            path.display()
        );
    }
    Ok(())
}

pub(super) fn run(args: &Args) -> anyhow::Result<Verdict> {
    let recording = Recording::load(&args.recording)?;
    let outputs: Vec<&Path> = [&args.out, &args.svg].into_iter().flatten().map(|p| &**p).collect();
    if let Some(path) = outputs.iter().find(|path| is_same_file(path, &args.recording)) {
        bail!("`{}` is the recording itself; choose another file to write", path.display());
    }
    for (option, path, end) in [("--out", &args.out, "html"), ("--svg", &args.svg, "svg")] {
        let other = |path: &&PathBuf| path.extension().is_none_or(|e| !e.eq_ignore_ascii_case(end));
        if let Some(path) = path.as_ref().filter(other) {
            bail!("{option} {}: the file's name must end in .{end}", path.display());
        }
    }
    if let Some(at) = args.at.filter(|&at| at >= recording.steps) {
        bail!("--at {at}: there is no such step; allowed: 0 to {}", recording.steps - 1);
    }
    for path in outputs {
        refuse_foreign(path)?;
    }
    if let Some(path) = &args.out {
        write_atomic(path, recording.player().as_bytes())?;
        tell!("{}", path.display());
    }
    if let Some(path) = &args.svg {
        write_atomic(path, recording.still(args.at.unwrap_or(recording.steps / 2)).as_bytes())?;
        tell!("{}", path.display());
    }
    Ok(Verdict::Good)
}
