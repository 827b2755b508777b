//! The check of a scenario: all errors and warnings.

use std::path::Path;

use super::check::{self, Checked};
use super::reader::{Reader, document, text};
use super::{Error, Finding, Scenario, Severity, advice};

/// Result of [`Scenario::check`].
#[derive(Debug)]
pub struct Findings {
    /// The scenario, if it can be used.
    pub scenario: Option<Scenario>,
    /// All findings, sorted by position in the file.
    pub list: Vec<Finding>,
}

impl Scenario {
    /// Reads a scenario file and returns all errors and warnings, where [`Scenario::load`] stops at
    /// the first error. A mistake in the file's syntax, names or values ends the check, because
    /// further findings would be misleading consequences of this mistake.
    pub fn check(path: &Path) -> Findings {
        let mut list = Vec::new();
        let scenario = inspect(path, &mut list).unwrap_or_else(|error| {
            list.push(Finding::of(&error, path));
            None
        });
        list.sort_by_key(|finding| finding.at.map(|at| (at.line, at.column)));
        // What is wrong with a route is found in each net that has it.
        let mut once: Vec<Finding> = Vec::new();
        for finding in list {
            if !once.contains(&finding) {
                once.push(finding);
            }
        }
        Findings { scenario, list: once }
    }
}

/// Returns the scenario if it can be used, and appends the findings to `list`.
fn inspect(path: &Path, list: &mut Vec<Finding>) -> Result<Option<Scenario>, Error> {
    let text = text(path)?;
    let document = document(&text, path)?;
    let reader = Reader::new(path, &document);
    let scenario = reader.scenario()?;
    let Checked { errors, maps, demand } = check::files(&scenario, &reader);
    list.extend(errors.iter().map(|error| Finding::of(error, error.path())));
    list.extend(advice::advise(&scenario, &maps, demand.as_ref(), &reader));
    Ok(errors.is_empty().then_some(scenario))
}

impl Findings {
    /// Returns whether at least one finding is an error.
    pub fn has_errors(&self) -> bool {
        self.list.iter().any(|finding| finding.severity == Severity::Error)
    }
}
