//! Cells that would be the same training.

use std::collections::BTreeMap;

use toml::Value;

use super::{Cell, value_of};

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
