//! Findings of a scenario check: all errors that make the scenario unusable, and warnings about
//! settings that are probably not intended.

use std::fmt;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::reader::{Reader, document};
use super::{Error, Scenario, advice, check, load};

/// Severity of a finding.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    /// The scenario cannot be used, or no agent can succeed in it.
    Error,
    /// The scenario can be used, but probably not as its author intended.
    Warning,
}

/// An error or a warning of a scenario check.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// Severity.
    pub severity: Severity,
    /// The scenario file.
    pub file: PathBuf,
    /// Position in the file, if the finding has one.
    #[serde(flatten)]
    pub at: Option<Position>,
    /// What is wrong, without the position.
    pub message: String,
    /// What the user can do about it.
    pub hint: Option<String>,
}

/// A position in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Position {
    /// Line, from 1.
    pub line: u32,
    /// Column, from 1.
    pub column: u32,
}

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
        Findings { scenario, list }
    }
}

/// Returns the scenario if it can be used, and appends the findings to `list`.
fn inspect(path: &Path, list: &mut Vec<Finding>) -> Result<Option<Scenario>, Error> {
    let text = load::text(path)?;
    let document = document(&text, path)?;
    let reader = Reader { path, document: &document };
    let (scenario, places) = reader.scenario()?;
    let (errors, maps) = check::nets(&scenario, &places, &reader);
    list.extend(errors.iter().map(|error| Finding::of(error, error.path())));
    list.extend(advice::advise(&scenario, &maps, &reader));
    Ok(errors.is_empty().then_some(scenario))
}

impl Findings {
    /// Returns whether at least one finding is an error.
    pub fn has_errors(&self) -> bool {
        self.list.iter().any(|finding| finding.severity == Severity::Error)
    }
}

impl Finding {
    /// Converts an error to a finding about the scenario file `path`.
    pub fn of(error: &Error, path: &Path) -> Self {
        let at = error.position().map(|(line, column)| Position { line, column });
        let text = error.to_string();
        // The finding has the position in a field of its own: the message must not repeat it.
        let place =
            at.map_or_else(|| path.display().to_string(), |at| format!("{}:{at}", path.display()));
        let text = text.strip_prefix(&format!("{place}: ")).unwrap_or(&text);
        let causes =
            std::iter::successors(std::error::Error::source(error), |cause| cause.source());
        let message = causes.fold(text.to_owned(), |text, cause| format!("{text}: {cause}"));
        // The message may quote control characters from the file.
        let message = message.replace(char::is_control, "\u{fffd}");
        Self { severity: Severity::Error, file: path.into(), at, message, hint: error.hint() }
    }
}

impl fmt::Display for Position {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}", self.line, self.column)
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.file.display())?;
        if let Some(at) = self.at {
            write!(f, ":{at}")?;
        }
        let severity = match self.severity {
            Severity::Error => "error",
            Severity::Warning => "warning",
        };
        write!(f, ": {severity}: {}", self.message)?;
        match &self.hint {
            Some(hint) => write!(f, "\n  hint: {hint}"),
            None => Ok(()),
        }
    }
}
