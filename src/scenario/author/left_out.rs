//! What an import leaves out of a map.

use std::collections::BTreeMap;

use crate::words::counted;

/// Largest number of names in a line about what was left out.
const NAMED: usize = 6;

/// Lanes, connections and routes that a site does not use, by reason.
#[derive(Debug, Clone, Default)]
pub(super) struct LeftOut(BTreeMap<&'static str, Vec<String>>);

impl LeftOut {
    pub(super) fn add(&mut self, reason: &'static str, name: String) {
        let names = self.0.entry(reason).or_default();
        if !names.contains(&name) {
            names.push(name);
        }
    }

    /// Returns what was left out here and elsewhere.
    pub(super) fn and(mut self, other: &Self) -> Self {
        for (reason, names) in &other.0 {
            self.0.entry(reason).or_default().extend_from_slice(names);
        }
        self
    }

    /// Returns a line for each reason: number, reason and names.
    pub(super) fn lines(&self) -> impl Iterator<Item = String> + '_ {
        self.0.iter().map(|(reason, names)| {
            let more = if names.len() > NAMED { ", ..." } else { "" };
            let shown = names.iter().take(NAMED).cloned().collect::<Vec<_>>().join(", ");
            // The first word of a reason is a noun in the plural.
            let (things, rest) = reason.split_once(' ').unwrap_or((reason, ""));
            let counted = counted(names.len(), things.strip_suffix('s').unwrap_or(things));
            let rest = if rest.is_empty() { String::new() } else { format!(" {rest}") };
            format!("left out: {counted}{rest} ({shown}{more})")
        })
    }
}
