//! Origin of results: the versions of the program, of SUMO and of libtorch, the program's commit,
//! and the machine.

use std::fs;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::sumo;

/// Stands for a version or commit that is not known.
pub const UNKNOWN: &str = "unknown";

/// A program that computed something, with the versions of the libraries that it used.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Program {
    /// Version of this package. Files of older versions name this field `iwol`.
    #[serde(alias = "iwol", default = "unknown")]
    pub version: String,
    /// Commit of the checkout from which the program was built, or [`UNKNOWN`].
    #[serde(default = "unknown")]
    pub commit: String,
    /// Whether the sources had uncommitted changes; `None` if the commit is unknown.
    #[serde(default)]
    pub dirty: Option<bool>,
    /// Version of SUMO.
    #[serde(default = "unknown")]
    pub sumo: String,
    /// Version of libtorch.
    #[serde(default = "unknown")]
    pub libtorch: String,
}

fn unknown() -> String {
    UNKNOWN.to_owned()
}

impl Default for Program {
    /// Returns a program about which nothing is known.
    fn default() -> Self {
        Self {
            version: unknown(),
            commit: unknown(),
            dirty: None,
            sumo: unknown(),
            libtorch: unknown(),
        }
    }
}

impl Program {
    /// Returns the running program, with the SUMO that it would start.
    pub fn current() -> Self {
        let sumo = sumo::Installation::find().and_then(|found| found.version());
        let dirty = match env!("IWOL_DIRTY") {
            "true" => Some(true),
            "false" => Some(false),
            _ => None,
        };
        Self {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            commit: env!("IWOL_COMMIT").to_owned(),
            dirty,
            sumo: sumo.map_or_else(|_| unknown(), |version| version.release().to_owned()),
            libtorch: libtorch_version().unwrap_or_else(unknown),
        }
    }

    /// Returns version and commit for people, such as `0.1.0 (1a2b3c4d5e, changed)`.
    pub fn describe(&self) -> String {
        if self.commit == UNKNOWN {
            return self.version.clone();
        }
        let commit = self.commit.get(..10).unwrap_or(&self.commit);
        let changed = if self.dirty == Some(true) { ", changed" } else { "" };
        format!("{} ({commit}{changed})", self.version)
    }
}

/// The programs that trained a policy.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Training {
    /// The program that trained the policy, or the last of several.
    #[serde(flatten)]
    pub program: Program,
    /// Other programs that trained the policy before it was resumed.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub earlier: Vec<Program>,
}

/// A machine on which the program runs.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Host {
    /// Number of CPU cores that the program may use.
    pub cores: usize,
    /// Model of the CPU.
    pub processor: Option<String>,
    /// Memory \[GiB\].
    pub memory_gib: Option<f64>,
    /// Operating system, architecture and kernel.
    pub system: String,
}

impl Host {
    /// Returns the machine on which this process runs.
    pub fn current() -> Self {
        let value = |path: &str, key: &str| {
            let text = fs::read_to_string(path).ok()?;
            let line = text.lines().find(|line| line.starts_with(key))?;
            Some(line.split_once(':')?.1.trim().to_owned())
        };
        let kibibytes = value("/proc/meminfo", "MemTotal")
            .and_then(|v| v.split_whitespace().next()?.parse().ok());
        let kernel = fs::read_to_string("/proc/sys/kernel/osrelease").unwrap_or_default();
        let system =
            format!("{} {} {}", std::env::consts::OS, std::env::consts::ARCH, kernel.trim());
        Self {
            cores: std::thread::available_parallelism().map_or(1, std::num::NonZero::get),
            processor: value("/proc/cpuinfo", "model name"),
            memory_gib: kibibytes.map(|k: f64| (k / 1024.0 / 1024.0 * 10.0).round() / 10.0),
            system: system.trim().to_owned(),
        }
    }
}

/// Returns the most memory that this process has used so far \[GiB\]; that of SUMO's processes is not
/// in it. `None` if the system does not say.
pub fn peak_memory_gib() -> Option<f64> {
    let text = fs::read_to_string("/proc/self/status").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kibibytes: f64 = line.split_whitespace().next()?.parse().ok()?;
    Some((kibibytes / 1024.0 / 1024.0 * 100.0).round() / 100.0)
}

/// Returns the version of the libtorch that this process has loaded, from the file `build-version`
/// in its folder; `None` if it cannot be read.
pub fn libtorch_version() -> Option<String> {
    let library = loaded_library("libtorch_cpu.so")?;
    let text = fs::read_to_string(library.parent()?.parent()?.join("build-version")).ok()?;
    Some(text.trim().to_owned())
}

/// Returns the path of a shared library that this process has loaded, by its file name.
pub fn loaded_library(name: &str) -> Option<PathBuf> {
    let maps = fs::read_to_string("/proc/self/maps").ok()?;
    maps.lines().find_map(|line| library_path(line, name))
}

/// Returns the path in a line of `/proc/self/maps`, if its file name is `name`. The path is the
/// sixth column and may contain spaces; the columns before it contain no slash.
fn library_path(line: &str, name: &str) -> Option<PathBuf> {
    let path = Path::new(&line[line.find('/')?..]);
    (path.file_name()? == name).then(|| path.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_path_of_a_loaded_library_may_hold_spaces() {
        let line = "7f00-7f10 r-xp 00001000 08:01 42                 /home/a b/lib/libtorch_cpu.so";
        assert_eq!(
            library_path(line, "libtorch_cpu.so"),
            Some(PathBuf::from("/home/a b/lib/libtorch_cpu.so"))
        );
        assert_eq!(library_path(line, "libtorch_cuda.so"), None);
        assert_eq!(library_path("7f00-7f10 rw-p 00000000 00:00 0 ", "libtorch_cpu.so"), None);
    }

    #[cfg(feature = "learn")]
    #[test]
    fn this_process_has_loaded_libtorch() {
        assert_eq!(tch::Tensor::from_slice(&[1.0_f32]).size(), [1]);
        let path = loaded_library("libtorch_cpu.so").expect("libtorch is linked");
        assert!(path.is_file(), "{} is no file", path.display());
        assert!(
            libtorch_version()
                .is_some_and(|version| version.starts_with(|c: char| c.is_ascii_digit()))
        );
    }

    #[test]
    fn a_program_knows_its_commit_or_says_that_it_does_not() {
        let program = Program::current();
        let commit = program.commit.as_str();
        let is_hash = commit.len() >= 40 && commit.chars().all(|c| c.is_ascii_hexdigit());
        assert!(
            commit == UNKNOWN && program.dirty.is_none() || is_hash && program.dirty.is_some(),
            "{program:?}"
        );
        let of = |commit: &str, dirty| Program {
            version: "1.2.3".into(),
            commit: commit.into(),
            dirty,
            ..Program::default()
        };
        assert_eq!(of("0123456789abcdef", Some(true)).describe(), "1.2.3 (0123456789, changed)");
        assert_eq!(of("0123456789abcdef", Some(false)).describe(), "1.2.3 (0123456789)");
        assert_eq!(of(UNKNOWN, None).describe(), "1.2.3");
    }

    #[test]
    fn what_older_runs_noted_is_read() {
        let older: Training =
            serde_json::from_str(r#"{"iwol": "0.1.0", "sumo": "1.15.0", "cores": 2}"#).unwrap();
        assert_eq!(
            (older.program.version.as_str(), older.program.sumo.as_str()),
            ("0.1.0", "1.15.0")
        );
        assert_eq!((older.program.commit.as_str(), older.earlier.len()), (UNKNOWN, 0));
        let resumed = Training { earlier: vec![older.program.clone()], ..older };
        let text = serde_json::to_string(&resumed).unwrap();
        assert_eq!(serde_json::from_str::<Training>(&text).unwrap(), resumed);
    }
}
