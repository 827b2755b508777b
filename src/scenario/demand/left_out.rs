//! Vehicles, persons and flows that cannot be used, and what messages say about them.

use crate::scenario::{Error, Finding, Place};
use crate::sumo::net::shorten;

/// Number of vehicles that a message names.
const NAMED: usize = 3;
/// Hint for vehicles that are left out.
const STRICT: &str = "correct the file; with strict=\"true\" of <traffic>, such a file is refused";

/// A vehicle, person or flow that cannot be used.
#[derive(Debug, Clone, PartialEq)]
pub struct LeftOut {
    /// Id in the file.
    pub id: String,
    /// Name of the element.
    pub element: &'static str,
    /// File, line and column.
    pub place: Place,
    /// Why it cannot be used.
    pub reason: String,
}

impl LeftOut {
    /// Returns the error of a scenario that refuses such files.
    pub fn error(&self) -> Error {
        let (element, id, reason) = (self.element, shorten(&self.id), &self.reason);
        let message = format!("the {element} `{id}` cannot be used: {reason}");
        let hint = Some("correct or delete it");
        Error::Invalid { place: self.place.clone(), message, hint }
    }

    /// Returns the finding that some of `all` vehicles, persons and flows did something, such as
    /// `left out`; `None` if nobody did.
    pub fn finding(list: &[Self], all: usize, did: &str) -> Option<Finding> {
        let (message, hint) = warning(list, all, did)?;
        Some(Finding::warning("left-out", list[0].place.clone(), message, hint))
    }
}

/// Returns a line about those of `all` vehicles, persons and flows who did something, and what to
/// do; `None` if nobody did.
pub(super) fn warning(
    left_out: &[LeftOut],
    all: usize,
    did: &str,
) -> Option<(String, &'static str)> {
    let count = left_out.len();
    let first = left_out.iter().take(NAMED).map(|out| {
        let (element, id, place) = (out.element, shorten(&out.id), &out.place);
        format!("the {element} `{id}` (line {}: {})", place.line, out.reason)
    });
    let first = first.collect::<Vec<_>>().join(", ");
    let more = if count > NAMED { ", …" } else { "" };
    let what = format!("{all} vehicles, persons and flows of the route files");
    (count > 0).then(|| (format!("{count} of {what} {did}: {first}{more}"), STRICT))
}
