//! The valid name nearest to a mistyped one, for the hint with an "unknown name" error. This module
//! imports nothing of this crate.

use std::path::{Path, PathBuf};

/// Longest name that is compared, in bytes. Longer names are no typing errors, and the comparison
/// takes time quadratic in the length.
const LONGEST: usize = 128;

/// Similarity (`0..=1`) from which a name is suggested.
const ALIKE: f64 = 0.8;

/// Returns the entry of `valid` that `name` was most likely meant to be, or `None` if no entry is
/// similar.
///
/// Case and the choice between `-`, `_` and a space do not matter. Of equally similar names the
/// first wins.
pub fn nearest<'a>(name: &str, valid: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let name = plain(name)?;
    let mut best: Option<(f64, &str)> = None;
    for candidate in valid {
        let Some(plain_candidate) = plain(candidate) else {
            continue;
        };
        let likeness = likeness(&name, &plain_candidate);
        if likeness >= ALIKE && best.is_none_or(|(most, _)| likeness > most) {
            best = Some((likeness, candidate));
        }
    }
    best.map(|(_, candidate)| candidate)
}

/// Returns the path of an existing file or folder that `path` was most likely meant to be, or `None`
/// if `path` itself exists or no path is similar.
///
/// Each part of the path that does not exist is replaced by the most similar entry of its folder.
pub fn nearest_path(path: &Path) -> Option<PathBuf> {
    if path.exists() {
        return None;
    }
    let mut found = PathBuf::new();
    for part in path.components() {
        if found.join(part).exists() {
            found.push(part);
            continue;
        }
        let folder = if found.as_os_str().is_empty() { Path::new(".") } else { &found };
        let entries = std::fs::read_dir(folder).ok()?.filter_map(Result::ok);
        let mut names: Vec<String> =
            entries.filter_map(|entry| entry.file_name().into_string().ok()).collect();
        names.sort();
        let name =
            nearest(part.as_os_str().to_str()?, names.iter().map(String::as_str))?.to_owned();
        found.push(name);
    }
    Some(found)
}

/// Returns the similarity of two names: the larger of Jaro–Winkler, which tolerates a wrong ending,
/// and edit distance relative to the length, which tolerates a missing beginning. If one name
/// contains the other, they are just similar enough for a suggestion.
fn likeness(a: &str, b: &str) -> f64 {
    let contained = a.len().min(b.len()) >= 3 && (a.contains(b) || b.contains(a));
    strsim::jaro_winkler(a, b).max(strsim::normalized_damerau_levenshtein(a, b)).max(if contained {
        ALIKE
    } else {
        0.0
    })
}

/// Returns the name without the differences that do not matter; `None` if it is empty or too long
/// to compare.
fn plain(name: &str) -> Option<String> {
    (!name.is_empty() && name.len() <= LONGEST)
        .then(|| name.trim().to_lowercase().replace(['_', ' '], "-"))
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALGORITHMS: [&str; 3] = ["mappo", "im-iwol", "ex-iwol"];
    const KEYS: [&str; 10] = [
        "horizon",
        "detection_range",
        "comm_range",
        "neighbours",
        "agents",
        "seed",
        "learning_rate",
        "gamma",
        "gae_lambda",
        "entropy_coefficient",
    ];

    #[test]
    fn finds_what_was_meant() {
        for (typed, meant) in [
            ("mapo", "mappo"),
            ("ppo", "mappo"),
            ("MAPPO", "mappo"),
            ("im_iwol", "im-iwol"),
            ("imiwol", "im-iwol"),
            ("ex-iwoll", "ex-iwol"),
            ("iwol", "im-iwol"),
        ] {
            assert_eq!(nearest(typed, ALGORITHMS), Some(meant), "{typed}");
        }
        for (typed, meant) in [
            ("horizn", "horizon"),
            ("detection-range", "detection_range"),
            ("range", "detection_range"),
            ("com-range", "comm_range"),
            ("neighbors", "neighbours"),
            ("agnets", "agents"),
            ("lerning_rate", "learning_rate"),
            ("lambda", "gae_lambda"),
            ("entropy", "entropy_coefficient"),
        ] {
            assert_eq!(nearest(typed, KEYS), Some(meant), "{typed}");
        }
    }

    #[test]
    fn finds_the_path_that_was_meant() {
        let folder = tempfile::tempdir().unwrap();
        let at = |path: &str| folder.path().join(path);
        std::fs::create_dir_all(at("policies/im-iwol-8")).unwrap();
        std::fs::write(at("policies/README.md"), "").unwrap();
        for (typed, meant) in [
            ("policies/im-iwoll-8", Some("policies/im-iwol-8")),
            ("polices/im-iwol-8", Some("policies/im-iwol-8")),
            ("Policies/im_iwol", Some("policies/im-iwol-8")),
            ("policies/README.md", None),
            ("policies/banana", None),
            ("policies/README.md/more", None),
        ] {
            assert_eq!(nearest_path(&at(typed)), meant.map(at), "{typed}");
        }
    }

    #[test]
    fn suggests_nothing_for_something_else() {
        for typed in ["", "x", "dqn", "banana", &"mappo".repeat(100)] {
            assert_eq!(nearest(typed, ALGORITHMS), None, "{typed}");
        }
        assert_eq!(nearest("wheelbase", KEYS), None);
        assert_eq!(nearest("mappo", []), None);
    }
}
