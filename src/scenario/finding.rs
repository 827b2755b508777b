//! A finding of a scenario check: an error that makes the scenario unusable, or a warning about a
//! setting that is probably not intended.

use std::fmt;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::{Error, Place};

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
    /// Name of the rule that the finding is about, such as `route` or `speed-limit`.
    pub kind: &'static str,
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

impl Finding {
    /// Returns a warning.
    pub(super) fn warning(kind: &'static str, place: Place, message: String, hint: &str) -> Self {
        let Place { path: file, line, column } = place;
        let at = Some(Position { line, column });
        Self { severity: Severity::Warning, kind, file, at, message, hint: Some(hint.to_owned()) }
    }

    /// Moves the finding to a place in another file.
    #[must_use]
    pub fn moved_to(self, place: Place) -> Self {
        let Place { path: file, line, column } = place;
        Self { file, at: Some(Position { line, column }), ..self }
    }

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
        let kind = error.kind();
        Self { severity: Severity::Error, kind, file: path.into(), at, message, hint: error.hint() }
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
