//! Tests of which module may import which: the layers that separate simulator, environments,
//! networks and learners.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use crate::support::root;

/// Modules of the library, each with the modules that it may name.
const ALLOWED: [(&str, &[&str]); 30] = [
    ("rng", &["fnv"]),
    ("fnv", &[]),
    ("markup", &[]),
    ("stats", &[]),
    ("suggest", &[]),
    ("words", &[]),
    ("sumo", &["markup", "words"]),
    ("provenance", &["sumo"]),
    ("scenario", &["fnv", "markup", "record", "sumo", "suggest", "words"]),
    ("env", &["scenario", "sumo", "rng", "words"]),
    ("nn", &["rng"]),
    ("rollout", &[]),
    ("onnx", &[]),
    ("ranks", &["env"]),
    ("algo", &["nn", "onnx", "ranks", "rollout", "rng", "env"]),
    ("record", &[]),
    ("plot", &["markup", "record", "words"]),
    ("config", &["algo", "env", "scenario", "suggest", "sumo"]),
    ("checkpoint", &["env", "record"]),
    ("metrics", &["env", "provenance", "stats"]),
    ("curves", &["metrics", "plot", "record", "stats"]),
    ("evaluate", &["algo", "env", "metrics", "replay", "rng", "rollout"]),
    (
        "driving",
        &["checkpoint", "config", "env", "evaluate", "ranks", "rng", "scenario", "sumo", "train"],
    ),
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
            "ranks",
            "record",
            "rng",
            "rollout",
        ],
    ),
    ("sweep", &["config", "metrics", "record", "train"]),
    (
        "report",
        &[
            "curves",
            "markup",
            "metrics",
            "plot",
            "provenance",
            "record",
            "scenario",
            "stats",
            "sweep",
            "words",
        ],
    ),
    ("replay", &["env", "markup", "plot", "record"]),
    ("inspect", &["env", "markup", "plot", "rng", "scenario", "sumo", "words"]),
    ("cli", &[]),
    ("main", &[]),
];
/// Crates that only some modules may use.
const CRATES: [(&str, &[&str]); 9] = [
    ("tch", &["nn", "algo", "checkpoint", "evaluate", "train", "cli"]),
    ("rten", &["evaluate"]),
    ("clarabel", &["env"]),
    ("bytemuck", &["ranks"]),
    ("ciborium", &["ranks"]),
    ("mpi", &["ranks"]),
    ("clap", &["cli"]),
    ("anyhow", &["cli"]),
    ("indicatif", &["cli"]),
];

/// Files that other files of their folder import although they import those: the settings of all
/// methods are one struct, whose groups are declared by the methods that read them.
const IN_CIRCLES: [&str; 1] = ["algo::settings"];

/// A file of the library or the program.
struct Source {
    /// Names of the modules from the crate to the file's own: none for `lib.rs`.
    module: Vec<String>,
    path: PathBuf,
    /// The code without unit tests and comments, which may name any module.
    code: String,
}

impl Source {
    /// Returns the name of the module below the crate that contains the file.
    fn top(&self) -> &str {
        self.module.first().map_or("lib", String::as_str)
    }
}

fn sources() -> Vec<Source> {
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
            let inside = path.strip_prefix(&root).expect("inside").with_extension("");
            let module = inside.iter().map(|name| name.to_string_lossy().into_owned());
            let module = module.filter(|name| name != "mod" && name != "lib").collect();
            let text = fs::read_to_string(&path).expect("text");
            let code = text.split("#[cfg(test)]\nmod tests {").next().unwrap_or_default();
            let code = code
                .lines()
                .filter(|line| !line.trim_start().starts_with("//"))
                .collect::<Vec<_>>()
                .join("\n");
            Source { module, path, code }
        })
        .collect()
}

/// Returns the paths that follow `prefix` in code, of those in braces each one.
fn paths_after(code: &str, prefix: &str) -> BTreeSet<String> {
    fn expand(before: &str, text: &str, paths: &mut BTreeSet<String>) {
        let text = text.trim_start();
        let end = text.find(|c: char| !(c.is_alphanumeric() || "_:".contains(c)));
        let (word, rest) = text.split_at(end.unwrap_or(text.len()));
        let path = format!("{before}{word}");
        let Some(list) = rest.strip_prefix('{').filter(|_| path.is_empty() || path.ends_with("::"))
        else {
            paths.insert(path);
            return;
        };
        let mut depth = 0;
        let mut from = 0;
        for (at, c) in list.char_indices() {
            let ends = c == '}' && depth == 0;
            if ends || c == ',' && depth == 0 {
                expand(&path, &list[from..at], paths);
                from = at + 1;
            }
            match c {
                '{' => depth += 1,
                '}' if ends => break,
                '}' => depth -= 1,
                _ => {}
            }
        }
    }
    let mut paths = BTreeSet::new();
    for (at, _) in code.match_indices(prefix) {
        // `super::` may follow another one, and a module's name may be a part of a longer path.
        if !code[..at].ends_with(|c: char| c.is_alphanumeric() || "_:$".contains(c)) {
            expand("", &code[at + prefix.len()..], &mut paths);
        }
    }
    paths.remove("");
    paths
}

#[test]
fn modules_import_only_what_they_may() {
    let modules: BTreeSet<&str> = ALLOWED.iter().map(|(name, _)| *name).collect();
    let mut wrong = Vec::new();
    let mut links = 0;
    for source in sources() {
        let (module, path) = (source.top(), &source.path);
        if module == "lib" || module == "cli" || module == "main" {
            continue;
        }
        let allowed = ALLOWED.iter().find(|(name, _)| *name == module);
        let Some((_, allowed)) = allowed else {
            wrong.push(format!("{}: `{module}` has no rule; add one", path.display()));
            continue;
        };
        let paths = paths_after(&source.code, "crate::");
        let names: BTreeSet<&str> =
            paths.iter().filter_map(|path| path.split("::").next()).collect();
        for name in names {
            if modules.contains(name) && name != module {
                links += 1;
                if !allowed.contains(&name) {
                    wrong.push(format!("{}: `{module}` may not import `{name}`", path.display()));
                }
            }
        }
    }
    assert!(links > 20, "the scan finds imports");
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// Learners and evaluations work in any environment: they know nothing of vehicles or of SUMO.
#[test]
fn learners_know_no_vehicles() {
    const ANY: [&str; 21] = [
        "ActionDimension",
        "ActionSpace",
        "Backdrop",
        "DrivingRecord",
        "EnvSpec",
        "Environment",
        "EpisodeRecord",
        "Error",
        "Feature",
        "Features",
        "Frame",
        "Group",
        "OwnMetric",
        "Picture",
        "Stream",
        "WorldPhase",
        "WorldState",
        "WorldView",
        "Worlds",
        "names_differ",
        "self",
    ];
    let mut found = 0;
    for source in sources().iter().filter(|s| ["algo", "evaluate", "train"].contains(&s.top())) {
        for path in paths_after(&source.code, "crate::env::") {
            let name = path.split("::").next().unwrap_or_default();
            found += 1;
            assert!(
                ANY.contains(&name),
                "{}: `{name}` is not of every environment",
                source.path.display()
            );
        }
    }
    assert!(found > 20, "the scan finds imports: {found}");
}

/// A file and the parts in its folder may know each other; any other two files may not.
#[test]
fn no_two_files_import_each_other() {
    let sources: Vec<Source> = sources()
        .into_iter()
        .filter(|source| !source.module.iter().any(|name| name == "tests" || name == "main"))
        .collect();
    let files: BTreeSet<&[String]> = sources.iter().map(|source| &source.module[..]).collect();
    let mut links: BTreeSet<(&[String], &[String])> = BTreeSet::new();
    for Source { module, code, .. } in &sources {
        let parts =
            files.iter().filter(|file| file.split_last().is_some_and(|(_, at)| at == module));
        let parts: Vec<String> = parts.map(|file| format!("{}::", file[file.len() - 1])).collect();
        let mut starts = vec![("crate::", Vec::new()), ("self::", module.clone())];
        starts.extend((1..=module.len()).map(|up| {
            let prefix = ["super::", "super::super::", "super::super::super::"][up.min(3) - 1];
            (prefix, module[..module.len() - up].to_vec())
        }));
        starts.extend(parts.iter().map(|part| {
            (part.as_str(), [&module[..], &[part.trim_end_matches(':').to_owned()]].concat())
        }));
        for (prefix, from) in starts {
            for path in paths_after(code, prefix) {
                let mut full = from.clone();
                full.extend(path.split("::").map(str::to_owned));
                let file = (0..=full.len()).rev().find_map(|k| files.get(&full[..k]));
                if let Some(file) = file.filter(|file| **file != &module[..]) {
                    links.insert((module, *file));
                }
            }
        }
    }
    assert!(links.len() > 300, "the scan finds imports: {}", links.len());
    let circles: Vec<String> = links
        .iter()
        .filter(|(a, b)| a < b && links.contains(&(*b, *a)))
        .filter(|(a, b)| !a.starts_with(b) && !b.starts_with(a))
        .map(|(a, b)| (a.join("::"), b.join("::")))
        .filter(|(a, b)| !IN_CIRCLES.iter().any(|known| known == a || known == b))
        .map(|(a, b)| format!("`{a}` and `{b}` import each other"))
        .collect();
    assert!(circles.is_empty(), "{}", circles.join("\n"));
}

#[test]
fn crates_stay_in_their_modules() {
    let mut wrong = Vec::new();
    for source in sources() {
        let (module, path, code) = (source.top(), &source.path, &source.code);
        for (name, allowed) in CRATES {
            let starts_word =
                |at: usize| !code[..at].ends_with(|c: char| c.is_alphanumeric() || c == '_');
            let used = code.match_indices(&format!("{name}::")).any(|(at, _)| starts_word(at));
            if used && !allowed.contains(&module) {
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
