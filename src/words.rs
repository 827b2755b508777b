//! Words of messages. This module imports nothing of this crate.

use std::fmt::Display;

/// Returns a count with its noun, e.g. `1 error` and `2 errors`.
pub fn counted(count: impl Display, noun: &str) -> String {
    let count = count.to_string();
    let ending = if count == "1" { "" } else { "s" };
    format!("{count} {noun}{ending}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_thing_has_a_noun_in_the_singular() {
        let said = [0, 1, 2, 21].map(|count| counted(count, "error"));
        assert_eq!(said, ["0 errors", "1 error", "2 errors", "21 errors"]);
    }
}
