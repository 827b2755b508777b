//! Tests of the crates that this project depends on: each is used, and each has a licence that goes
//! with the project's own.

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use serde_json::Value;

use crate::support::{root, succeeds};

/// Licences under which a crate may be linked into the program: permissive ones.
const LICENCES: [&str; 12] = [
    "0BSD",
    "Apache-2.0",
    "Apache-2.0 WITH LLVM-exception",
    "BSD-2-Clause",
    "BSD-3-Clause",
    "CC0-1.0",
    "ISC",
    "MIT",
    "OFL-1.1",
    "Ubuntu-font-1.0",
    "Unicode-3.0",
    "Zlib",
];

/// Returns the texts of all Rust files under a folder.
fn sources(folder: &Path) -> String {
    let entries =
        fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry").path());
    let text = |path: PathBuf| match path.extension() {
        _ if path.is_dir() => sources(&path),
        Some(ending) if ending == "rs" => fs::read_to_string(&path).expect("text"),
        _ => String::new(),
    };
    entries.map(text).collect()
}

#[test]
fn every_dependency_is_used() {
    let manifest = fs::read_to_string(root().join("Cargo.toml")).expect("the manifest");
    let manifest: toml::Table = manifest.parse().expect("TOML");
    let (own, tests) =
        (sources(&root().join("src")), ["tests", "benches"].map(|at| sources(&root().join(at))));
    let all = format!("{own}{}", tests.concat());
    for (table, code) in [("dependencies", &own), ("dev-dependencies", &all)] {
        for name in manifest[table].as_table().expect("a table").keys() {
            let name = name.replace('-', "_");
            let used = ["::", ";", "{"].iter().any(|end| {
                let word = format!("{name}{end}");
                let starts_word =
                    |at: usize| !code[..at].ends_with(|c: char| c.is_alphanumeric() || c == '_');
                code.match_indices(&word).any(|(at, _)| starts_word(at))
            });
            assert!(used, "no file uses `{name}` of [{table}]; remove it from Cargo.toml");
        }
    }
}

#[test]
fn every_licence_goes_with_ours() {
    let mut metadata = Command::new(env!("CARGO"));
    // Cargo fetches what the Python package needs besides, which is not built here.
    metadata.current_dir(root()).args(["metadata", "--format-version", "1", "--locked"]);
    let platform = format!("{}-unknown-linux-gnu", std::env::consts::ARCH);
    metadata.args(["--filter-platform", &platform]);
    for (used, feature) in [(cfg!(feature = "libsumo"), "libsumo"), (cfg!(feature = "mpi"), "mpi")]
    {
        if used {
            metadata.args(["--features", feature]);
        }
    }
    let output = succeeds(&mut metadata);
    let found: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let packages = found["packages"].as_array().expect("packages");
    // Such as `(MIT OR Apache-2.0) AND Unicode-3.0`; a slash stands for OR in old manifests.
    let goes = |licence: &str| {
        licence.split(" AND ").all(|choice| {
            let choice = choice.trim_matches(['(', ')']).replace('/', " OR ");
            choice.split(" OR ").any(|one| LICENCES.contains(&one.trim()))
        })
    };
    let strange: Vec<String> = packages
        .iter()
        .filter(|package| !package["license"].as_str().is_some_and(goes))
        .map(|package| format!("{}: {}", package["name"], package["license"]))
        .collect();
    assert!(packages.len() > 50 && strange.is_empty(), "nobody has looked at {strange:#?}");
}
