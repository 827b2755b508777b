//! Conditions on cells: `when` of rules, skips and evaluations, and those of contrasts.

use toml::{Table, Value};

use crate::config::{full_name, plain};

/// Returns whether every key has the wanted value, or one of a list of wanted values.
pub(super) fn holds<'a>(when: &Table, value: impl Fn(&str) -> Option<&'a Value>) -> bool {
    when.iter().all(|(key, wanted)| {
        value(key).is_some_and(|own| values(wanted).iter().any(|wanted| wanted == own))
    })
}

/// Formats a condition for a message.
pub(super) fn listed(when: &Table) -> String {
    toml::to_string(when).unwrap_or_default().trim().replace('\n', " and ")
}

/// Checks that the grid has each value that a condition names for one of the grid's keys.
///
/// # Errors
/// The key, the value that the grid lacks, and those that it has.
pub(super) fn check_values(when: &Table, grid: &Table) -> Result<(), String> {
    for (key, wanted) in when {
        let same = |(own, _): &(&String, &Value)| full_name(own) == full_name(key);
        let Some((_, own)) = grid.iter().find(same) else { continue };
        let own = values(own);
        if let Some(absent) = values(wanted).iter().find(|wanted| !own.contains(wanted)) {
            let own: Vec<String> = own.iter().map(plain).collect();
            return Err(format!(
                "`when` names {key} = {}, and [grid] {key} has only {}",
                plain(absent),
                own.join(", ")
            ));
        }
    }
    Ok(())
}

/// Returns the values of a list; any other value is a list of one.
fn values(value: &Value) -> &[Value] {
    value.as_array().map_or(std::slice::from_ref(value), Vec::as_slice)
}
