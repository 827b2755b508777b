//! Tests of the crates that this project depends on: each is used, and each has a licence that goes
//! with the project's own.

use std::{collections::BTreeSet, fs, path::Path, process::Command};

use serde_json::Value;

use crate::support::{root, succeeds};

/// Licences of dependencies that may be linked into and shipped with the program. Each is permissive,
/// or asks for no more than that changes to the crate's own files stay under it (MPL-2.0).
const LICENCES: [&str; 1] = [""];

/// Returns the texts of all Rust files under a folder.
fn sources(folder: &Path) -> String {
    let entries = fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry").path());
    let text = |path: std::path::PathBuf| match path.extension() {
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
    let (own, tests) = (sources(&root().join("src")), ["tests", "benches"].map(|at| sources(&root().join(at))));
    let all = format!("{own}{}", tests.concat());
    for (table, code) in [("dependencies", &own), ("dev-dependencies", &all)] {
        for name in manifest[table].as_table().expect("a table").keys() {
            let name = name.replace('-', "_");
            let used = ["::", ";", "{"].iter().any(|end| {
                let word = format!("{name}{end}");
                let starts_word = |at: usize| !code[..at].ends_with(|c: char| c.is_alphanumeric() || c == '_');
                code.match_indices(&word).any(|(at, _)| starts_word(at))
            });
            assert!(used, "no file uses `{name}` of [{table}]; remove it from Cargo.toml");
        }
    }
}

#[test]
fn every_licence_goes_with_ours() {
    let mut metadata = Command::new(env!("CARGO"));
    metadata.current_dir(root()).args(["metadata", "--format-version", "1", "--locked", "--offline"]);
    let platform = format!("{}-unknown-linux-gnu", std::env::consts::ARCH);
    let output = succeeds(metadata.args(["--all-features", "--filter-platform", &platform]));
    let found: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let packages = found["packages"].as_array().expect("packages");
    let licence = |package: &Value| package["license"].as_str().unwrap_or("none").to_owned();
    let strange: BTreeSet<(String, &str)> = packages
        .iter()
        .map(|package| (licence(package), package["name"].as_str().expect("a name")))
        .filter(|(licence, _)| !LICENCES.contains(&licence.as_str()))
        .collect();
    assert!(strange.is_empty(), "licences that nobody has looked at yet: {strange:#?}");
}
