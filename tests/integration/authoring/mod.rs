//! User-defined scenarios: templates, builds, checks, pictures, imports, and the documentation of
//! the file format.

mod checks;
mod documentation;
mod imports;
mod templates;

use std::path::Path;
use std::process::Command;

use iwol_sumo::scenario::author::Sizes;
use iwol_sumo::scenario::{Finding, Scenario, Severity};
use iwol_sumo::sumo::find_program;

const SIZES: Sizes =
    Sizes { lanes: None, arm_length: None, agents: 8, speed: 13.889, steering: false };

/// Runs one of SUMO's programs; returns its error output if it fails.
fn run(program: &str, arguments: &[&str], folder: &Path) -> Result<(), String> {
    let program = find_program(program).unwrap();
    let output = Command::new(program).args(arguments).current_dir(folder).output().unwrap();
    if output.status.success() {
        Ok(())
    } else {
        Err(String::from_utf8_lossy(&output.stderr).into_owned())
    }
}

fn errors(list: &[Finding]) -> Vec<&Finding> {
    list.iter().filter(|finding| finding.severity == Severity::Error).collect()
}

/// Returns the findings of a check without the folder's name, one per line.
fn findings(file: &Path) -> String {
    let list = Scenario::check(file).list;
    let lines: Vec<String> = list.iter().map(ToString::to_string).collect();
    lines
        .join("\n")
        .replace(&format!("{}/scenarios/", file.parent().unwrap().parent().unwrap().display()), "")
}
