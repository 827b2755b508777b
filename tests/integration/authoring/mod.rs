//! User-defined scenarios: templates, builds, checks, pictures, imports, and the documentation of
//! the file format.

mod checks;
mod documentation;
mod imports;
mod templates;

use std::path::Path;
use std::process::Command;

use iwol_sumo::scenario::author::{self, Choices, Error, Imported, Map, Sizes};
use iwol_sumo::scenario::{Finding, Scenario, Severity};
use iwol_sumo::sumo::find_program;

const SIZES: Sizes =
    Sizes { lanes: None, arm_length: None, agents: 8, speed: 13.889, steering: false };

fn import(
    root: &Path,
    name: &str,
    map: Map,
    junction: Option<&str>,
    agents: u32,
    steering: bool,
) -> Result<Imported, Error> {
    let choices = Choices { junction, agents, steering, left_hand: false, whole_net: false };
    author::import(root, name, map, &choices)
}

/// Runs one of SUMO's programs; returns its error output if it fails.
pub fn run(program: &str, arguments: &[&str], folder: &Path) -> Result<(), String> {
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
