//! Cells that would be the same training, and cells that would not be seeds of the same training.

use std::collections::BTreeMap;

use toml::Value;

use super::{Cell, label, value_of};
use crate::config;

/// Checks that no two cells are the same training.
///
/// # Errors
/// Two cells that differ only in settings that their algorithm does not read.
pub(super) fn check_distinct(cells: &[Cell]) -> Result<(), String> {
    let mut known: BTreeMap<String, &Cell> = BTreeMap::new();
    for cell in cells {
        let Some(other) = known.insert(cell.config.read_settings(), cell) else { continue };
        let differs = |(key, value): &&(String, Value)| value_of(&other.values, key) != Some(value);
        let keys: Vec<&str> =
            cell.values.iter().filter(differs).map(|(key, _)| key.as_str()).collect();
        let algorithm = &cell.config.algorithm;
        return Err(format!(
            "[grid]: the cells {} and {} are the same training, because {algorithm} with these settings does not read {}; leave one of them out with [[skip]], e.g. when = {{ algorithm = \"{algorithm}\", {} }}",
            other.id,
            cell.id,
            keys.join(" and "),
            keys.iter()
                .filter_map(|key| Some(format!("{key:?} = {}", value_of(&cell.values, key)?)))
                .collect::<Vec<_>>()
                .join(", "),
        ));
    }
    Ok(())
}

/// Checks that cells which differ in their seed alone have the same settings otherwise: reports and
/// comparisons take them for seeds of one training.
///
/// # Errors
/// A rule that gives some seeds other settings.
pub(super) fn check_seeds(cells: &[Cell]) -> Result<(), String> {
    let mut known: BTreeMap<String, (&Cell, BTreeMap<String, Value>)> = BTreeMap::new();
    for cell in cells {
        let others = cell.values.iter().filter(|(key, _)| key != "seed").cloned();
        let settings = toml::from_str(&cell.config.read_settings()).expect("settings are TOML");
        let mut settings = config::flatten(&settings);
        // Each seed may begin with a policy of its own.
        settings.retain(|key, _| key != "seed" && key != "init_from");
        let id = label(&others.collect::<Vec<_>>());
        let Some((first, same)) = known.get(&id) else {
            known.insert(id, (cell, settings));
            continue;
        };
        if let Some(change) = config::flat_changes(same, &settings).into_iter().next() {
            return Err(format!(
                "the cells {} and {} differ in more than their seed, so that they are no seeds of one training ({change}); make the setting a key of [grid], or leave seed out of the rule",
                first.id, cell.id
            ));
        }
    }
    Ok(())
}
