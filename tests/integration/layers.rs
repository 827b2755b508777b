//! Tests of which module may import which: the layers that separate simulator, environments,
//! networks and learners.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use crate::support::root;

/// Modules of the library, each with the modules that it may name.
const ALLOWED: [(&str, &[&str]); 26] = [
    ("rng", &["fnv"]),
    ("fnv", &[]),
    ("markup", &[]),
    ("stats", &[]),
    ("suggest", &[]),
    ("sumo", &["markup"]),
    ("provenance", &["sumo"]),
    ("scenario", &["fnv", "markup", "record", "sumo", "suggest"]),
    ("env", &["scenario", "sumo", "rng"]),
    ("nn", &["rng"]),
    ("rollout", &[]),
    ("algo", &["nn", "rollout", "rng", "env"]),
    ("record", &[]),
    ("plot", &["markup", "record"]),
    ("config", &["algo", "scenario", "suggest", "sumo"]),
    ("checkpoint", &["env", "record"]),
    ("metrics", &["env", "provenance", "stats"]),
    ("curves", &["metrics", "plot", "record", "stats"]),
    ("evaluate", &["algo", "env", "metrics", "replay", "rng", "rollout", "sumo"]),
    (
        "train",
        &[
            "algo",
            "checkpoint",
            "config",
            "env",
            "evaluate",
            "fnv",
            "metrics",
            "provenance",
            "record",
            "rng",
            "rollout",
            "scenario",
        ],
    ),
    ("sweep", &["config", "metrics", "record", "train"]),
    ("report", &["curves", "markup", "metrics", "plot", "provenance", "record", "stats", "sweep"]),
    ("replay", &["env", "markup", "plot", "record", "sumo"]),
    ("inspect", &["env", "markup", "plot", "rng", "scenario", "sumo"]),
    ("cli", &[]),
    ("main", &[]),
];
/// Crates that only some modules may use.
const CRATES: [(&str, &[&str]); 4] = [
    ("tch", &["nn", "algo", "checkpoint", "evaluate", "train", "cli"]),
    ("clap", &["cli"]),
    ("anyhow", &["cli"]),
    ("indicatif", &["cli"]),
];

fn sources() -> Vec<(String, PathBuf, String)> {
    fn walk(dir: &Path, out: &mut Vec<PathBuf>) {
        for entry in fs::read_dir(dir).expect("a folder").map(|e| e.expect("an entry").path()) {
            if entry.is_dir() {
                walk(&entry, out);
            } else if entry.extension().is_some_and(|e| e == "rs") {
                out.push(entry);
            }
        }
    }
    let root = root().join("src");
    let mut files = Vec::new();
    walk(&root, &mut files);
    files
        .into_iter()
        .map(|path| {
            let first =
                path.strip_prefix(&root).expect("inside").components().next().expect("a name");
            let module = first.as_os_str().to_string_lossy().trim_end_matches(".rs").to_owned();
            let text = fs::read_to_string(&path).expect("text");
            // Unit tests and comments may name any module.
            let code = text.split("#[cfg(test)]\nmod tests {").next().unwrap_or_default();
            let code = code
                .lines()
                .filter(|line| !line.trim_start().starts_with("//"))
                .collect::<Vec<_>>()
                .join("\n");
            (module, path, code)
        })
        .collect()
}

/// Returns the names that follow `prefix` in code, including those in one level of braces.
fn names_after(code: &str, prefix: &str) -> BTreeSet<String> {
    let mut names = BTreeSet::new();
    for (at, _) in code.match_indices(prefix) {
        let rest = &code[at + prefix.len()..];
        let word = |text: &str| {
            text.trim().chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect::<String>()
        };
        if let Some(list) = rest.strip_prefix('{') {
            let mut depth = 0;
            let mut item = String::new();
            for c in list.chars() {
                match c {
                    '{' => depth += 1,
                    '}' if depth == 0 => break,
                    '}' => depth -= 1,
                    ',' if depth == 0 => {
                        names.insert(word(&item));
                        item.clear();
                        continue;
                    }
                    _ => {}
                }
                item.push(c);
            }
            names.insert(word(&item));
        } else {
            names.insert(word(rest));
        }
    }
    names.remove("");
    names
}

#[test]
fn modules_import_only_what_they_may() {
    let modules: BTreeSet<&str> = ALLOWED.iter().map(|(name, _)| *name).collect();
    let mut wrong = Vec::new();
    let mut links = 0;
    for (module, path, code) in sources() {
        if module == "lib" || module == "cli" || module == "main" {
            continue;
        }
        let allowed = ALLOWED.iter().find(|(name, _)| *name == module);
        let Some((_, allowed)) = allowed else {
            wrong.push(format!("{}: `{module}` has no rule; add one", path.display()));
            continue;
        };
        for name in names_after(&code, "crate::") {
            if modules.contains(name.as_str()) && name != module {
                links += 1;
                if !allowed.contains(&name.as_str()) {
                    wrong.push(format!("{}: `{module}` may not import `{name}`", path.display()));
                }
            }
        }
    }
    assert!(links > 20, "the scan finds imports");
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn crates_stay_in_their_modules() {
    let mut wrong = Vec::new();
    for (module, path, code) in sources() {
        for (name, allowed) in CRATES {
            let starts_word =
                |at: usize| !code[..at].ends_with(|c: char| c.is_alphanumeric() || c == '_');
            let used = code.match_indices(&format!("{name}::")).any(|(at, _)| starts_word(at));
            if used && !allowed.contains(&module.as_str()) {
                wrong.push(format!("{}: `{module}` may not use `{name}`", path.display()));
            }
        }
        let prints =
            ["println!(", "print!(", "eprintln!(", "eprint!("].iter().any(|p| code.contains(p));
        if prints && module != "cli" {
            wrong.push(format!("{}: only `cli` prints", path.display()));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
