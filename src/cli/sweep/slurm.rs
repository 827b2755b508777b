//! Submits a sweep to Slurm as a job array. Each task runs `iwol sweep --cell`.

use std::fmt::Write as _;
use std::path::Path;
use std::process::Command;
use std::time::SystemTime;

use anyhow::{Context as _, bail};

use crate::record::write_atomic;
use crate::sweep::{Cell, State, Sweep};
use crate::words::counted;

use super::Args;
use crate::cli::{Verdict, program};

/// Writes the job script and submits it with `sbatch`.
pub(super) fn submit(args: &Args, sweep: &Sweep) -> anyhow::Result<Verdict> {
    let open =
        |cell: &Cell| !matches!(cell.state(&sweep.evaluations), State::Finished | State::Failed(_));
    let open = (0..sweep.cells.len()).filter(|&number| open(&sweep.cells[number]));
    let (waiting, numbers): (Vec<usize>, Vec<usize>) =
        open.partition(|&number| sweep.waits_for(&sweep.cells[number]).is_some());
    if !waiting.is_empty() {
        say!(
            "{} left out, because they begin with policies that are not trained yet; submit again after this job",
            counted(waiting.len(), "cell")
        );
    }
    if numbers.is_empty() {
        say!(
            "nothing to submit: all other cells are finished or failed (--retry runs failed cells again)"
        );
        return Ok(Verdict::Good);
    }
    for option in &args.slurm_option {
        let known = option
            .split_once('=')
            .is_some_and(|(key, _)| !matches!(key, "array" | "job-name" | "output"));
        if !known {
            bail!(
                "--slurm-option {option}: write it as key=value; the sweep itself sets array, job-name and output"
            );
        }
    }
    let folder = args.out.join(&sweep.name);
    std::fs::create_dir_all(folder.join("slurm"))
        .with_context(|| format!("cannot create `{}`", folder.display()))?;
    // Queued tasks read this list, so later changes of the sweep file and later submissions do not
    // affect them.
    let stamp = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).map_or(0, |d| d.as_secs());
    let list = folder.join(format!("slurm/{stamp}.cells"));
    let names: Vec<&str> = numbers.iter().map(|&number| sweep.cells[number].id.as_str()).collect();
    write_atomic(&list, (names.join("\n") + "\n").as_bytes())?;
    let path = folder.join(format!("slurm/{stamp}.sh"));
    write_atomic(&path, script(args, sweep, &list, numbers.len())?.as_bytes())?;
    let output = Command::new("sbatch")
        .arg("--parsable")
        .arg(&path)
        .output()
        .context("cannot run sbatch, which submits jobs to Slurm; use a machine on which Slurm's client is installed")?;
    if !output.status.success() {
        let why = String::from_utf8_lossy(&output.stderr);
        bail!(
            "sbatch refused `{}`: {} ({}; the cluster's MaxArraySize, 1001 by default, limits their number: divide a larger sweep among several files)",
            path.display(),
            why.trim(),
            counted(numbers.len(), "task")
        );
    }
    let job = String::from_utf8_lossy(&output.stdout).trim().to_owned();
    say!("{} submitted with {}", counted(numbers.len(), "cell"), path.display());
    say!(
        "watch them with: squeue --job {job}; {} sweep {} --dry-run",
        program(),
        args.file.display()
    );
    tell!("{job}");
    Ok(Verdict::Good)
}

/// Returns the job script: one task per cell, of which Slurm runs at most `--jobs` at a time if
/// that option is given.
fn script(args: &Args, sweep: &Sweep, list: &Path, count: usize) -> anyhow::Result<String> {
    let here = std::env::current_dir().context("cannot determine the current folder")?;
    let program = std::env::current_exe().context("cannot find the executable of this program")?;
    let quoted = |path: &Path| -> anyhow::Result<String> {
        let text =
            path.to_str().filter(|text| !text.contains(['\'', '\n'])).with_context(|| {
                format!("the path {} cannot be written into a script", path.display())
            })?;
        Ok(format!("'{text}'"))
    };
    let mut text = String::from("#!/bin/sh\n");
    let throttle = args.jobs.map_or_else(String::new, |jobs| format!("%{jobs}"));
    let logs = here.join(&args.out).join(&sweep.name).join("slurm/%A_%a.log");
    let _ = writeln!(text, "#SBATCH --job-name=iwol-{}", sweep.name);
    let _ = writeln!(text, "#SBATCH --array=1-{count}{throttle}");
    let _ = writeln!(text, "#SBATCH --output={}", quoted(&logs)?);
    // Slurm signals a task 60 s before it ends it, which leaves time to write a checkpoint; a
    // requeued task continues from there.
    let _ =
        writeln!(text, "#SBATCH --signal=B:TERM@60\n#SBATCH --requeue\n#SBATCH --open-mode=append");
    for option in &args.slurm_option {
        let _ = writeln!(text, "#SBATCH --{option}");
    }
    let _ = writeln!(text, "cd {}", quoted(&here)?);
    let _ = writeln!(text, "cell=$(sed -n \"${{SLURM_ARRAY_TASK_ID}}p\" {})", quoted(list)?);
    let _ = writeln!(
        text,
        "exec {} sweep {} --out {} --cell \"$cell\"",
        quoted(&program)?,
        quoted(&args.file)?,
        quoted(&args.out)?
    );
    Ok(text)
}
