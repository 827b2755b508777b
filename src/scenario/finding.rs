//! What a check of a scenario file finds: all that stops it from being used, and what will probably surprise.

use std::fmt;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::reader::{Reader, document};
use super::{Error, Scenario, advice, check, load};

/// How bad a finding is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    /// The scenario cannot be used, or no agent can succeed in it.
    Error,
    /// It can be used, but probably not as it was meant.
    Warning,
}

/// Something that is wrong, or seems to be.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// How bad it is.
    pub severity: Severity,
    /// The scenario file.
    pub file: PathBuf,
    /// Line and column, both from 1, where it has a place in the file.
    #[serde(flatten)]
    pub at: Option<Position>,
    /// What is wrong.
    pub message: String,
    /// What to do about it.
    pub hint: Option<String>,
}

/// A place in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Position {
    /// From 1.
    pub line: u32,
    /// From 1.
    pub column: u32,
}

/// What [`Scenario::check`] finds.
#[derive(Debug)]
pub struct Findings {
    /// The scenario, if it can be used.
    pub scenario: Option<Scenario>,
    /// In order of their places.
    pub list: Vec<Finding>,
}

impl Scenario {
    /// Reads a scenario file and says everything that is wrong with it, where [`Scenario::load`] stops at the first mistake, and
    /// what will probably surprise. Mistakes in how it is written end the search: what follows from them would only mislead.
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

/// The scenario, if nothing is wrong with it.
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
    /// Whether there is an error among them.
    pub fn has_errors(&self) -> bool {
        self.list.iter().any(|finding| finding.severity == Severity::Error)
    }
}

impl Finding {
    /// The finding that an error is.
    pub fn of(error: &Error, path: &Path) -> Self {
        let at = error.position().map(|(line, column)| Position { line, column });
        let text = error.to_string();
        // The error's own text begins with its place.
        let place =
            at.map_or_else(|| path.display().to_string(), |at| format!("{}:{at}", path.display()));
        let text = text.strip_prefix(&format!("{place}: ")).unwrap_or(&text);
        let causes =
            std::iter::successors(std::error::Error::source(error), |cause| cause.source());
        let message = causes.fold(text.to_owned(), |text, cause| format!("{text}: {cause}"));
        // Files are quoted in it.
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
