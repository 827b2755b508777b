//! Configurations as flat maps from a setting's full name to its value.

use std::collections::{BTreeMap, BTreeSet};

use toml::{Table, Value};

/// Returns the settings of a table and of its subtables, by full names such as `ppo.gamma`.
pub fn flatten(table: &Table) -> BTreeMap<String, Value> {
    let mut flat = BTreeMap::new();
    collect(table, "", &mut flat);
    flat
}

/// Returns the full name of a setting: `scenario` is short for `scenario.file`.
pub fn full_name(key: &str) -> &str {
    if key == "scenario" { "scenario.file" } else { key }
}

fn collect(table: &Table, prefix: &str, out: &mut BTreeMap<String, Value>) {
    for (key, value) in table {
        let name = if prefix.is_empty() { key.clone() } else { format!("{prefix}.{key}") };
        match value {
            Value::Table(inner) => collect(inner, &name, out),
            _ => _ = out.insert(full_name(&name).to_owned(), value.clone()),
        }
    }
}

/// Returns a value as people write it: strings without quotes.
pub fn plain(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}

/// A setting in which two configurations differ.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Change {
    /// Full name of the setting.
    pub key: String,
    /// The old value, or `not set`.
    pub was: String,
    /// The new value, or `not set`.
    pub is: String,
}

impl std::fmt::Display for Change {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} = {} (was {})", self.key, self.is, self.was)
    }
}

/// Returns the settings in which a configuration `is` differs from `was`, sorted by name.
pub(super) fn between(was: &BTreeMap<String, Value>, is: &BTreeMap<String, Value>) -> Vec<Change> {
    let keys: BTreeSet<_> =
        was.keys().chain(is.keys()).filter(|key| was.get(*key) != is.get(*key)).collect();
    let show = |value: Option<&Value>| value.map_or_else(|| "not set".to_owned(), plain);
    keys.into_iter()
        .map(|key| Change { key: key.clone(), was: show(was.get(key)), is: show(is.get(key)) })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn changes_name_the_settings_that_differ_and_nothing_else() {
        let said = |was: &str, is: &str| {
            let flat = |text: &str| flatten(&text.parse().unwrap());
            between(&flat(was), &flat(is)).iter().map(ToString::to_string).collect::<Vec<_>>()
        };
        let was = "algorithm = \"mat\"\nsteps = 5\n[ppo]\ngamma = 0.99\nclip = 0.2\n";
        assert!(said(was, was).is_empty());
        let is = "algorithm = \"magic\"\nsteps = 5\n[ppo]\ngamma = 0.5\nclip = 0.2\nepochs = 3\n";
        let found = said(was, is);
        assert_eq!(
            found,
            [
                "algorithm = magic (was mat)",
                "ppo.epochs = 3 (was not set)",
                "ppo.gamma = 0.5 (was 0.99)"
            ]
        );
    }
}
