//! `iwol doctor`: shows which of the program's requirements this machine meets, and what is wrong.
//! Each check is a trial: SUMO is started and asked for its TraCI version, and libtorch computes a
//! sum.

use std::env;
use std::fmt::{self, Display, Write as _};
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use crate::provenance::Program;
#[cfg(feature = "learn")]
use crate::provenance::{libtorch_version, loaded_library};
use crate::scenario::Scenario;
use crate::sumo::{self, Installation, Simulation as _, SimulationConfig, TraciSimulation};
use crate::words::counted;

use super::chain;

/// The libtorch version that the `tch` crate is made for.
#[cfg(feature = "learn")]
const TORCH: &str = "2.13.0";
/// A small net to start SUMO with; it is compiled in, so the check does not depend on the current
/// folder.
const NET: &str = include_str!("../../sumo_nets/intersection/arm30.net.xml");

/// Runs all checks and prints what they found; returns `true` if nothing is wrong.
pub fn run() -> bool {
    let mut findings = Findings::default();
    findings.row("iwol", format!("{}, {}", Program::current().describe(), program()));
    check_sumo(&mut findings);
    #[cfg(feature = "learn")]
    check_torch(&mut findings);
    check_threads(&mut findings);
    check_files(&mut findings);
    super::print(format_args!("{findings}"));
    findings.faults.is_empty()
}

/// The results of all checks, in the order of printing.
#[derive(Default)]
struct Findings {
    rows: Vec<(&'static str, String)>,
    faults: Vec<Fault>,
}

/// Something that is wrong, and a hint on how to fix it.
struct Fault {
    what: String,
    hint: Option<String>,
}

impl Findings {
    fn row(&mut self, name: &'static str, value: impl Into<String>) {
        self.rows.push((name, value.into()));
    }

    /// Adds a fault, and a row that refers to it in place of a value.
    fn fault(&mut self, name: &'static str, what: impl Into<String>, hint: Option<&str>) {
        self.row(name, "see below");
        self.faults.push(Fault {
            what: format!("{name}: {}", what.into()),
            hint: hint.map(str::to_owned),
        });
    }
}

impl Display for Findings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let width = self.rows.iter().map(|(name, _)| name.len()).max().unwrap_or(0);
        for (name, value) in &self.rows {
            writeln!(f, "{name:width$}  {value}")?;
        }
        writeln!(f)?;
        if self.faults.is_empty() {
            return writeln!(f, "nothing is wrong");
        }
        for Fault { what, hint } in &self.faults {
            writeln!(f, "wrong: {what}")?;
            if let Some(hint) = hint {
                writeln!(f, "  hint: {hint}")?;
            }
        }
        Ok(())
    }
}

fn program() -> String {
    env::current_exe()
        .map_or_else(|error| format!("path unknown: {error}"), |path| path.display().to_string())
}

fn check_sumo(findings: &mut Findings) {
    findings.row("SUMO_HOME", env::var("SUMO_HOME").unwrap_or_else(|_| "not set".to_owned()));
    let found = match Installation::find() {
        Ok(found) => found,
        Err(error) => {
            findings.fault("SUMO", chain(&error), error.hint().as_deref());
            return;
        }
    };
    findings.row("SUMO", format!("{} ({})", found.binary().display(), found.reason()));
    match found.program("netconvert") {
        Ok(program) => {
            let data = found.home().map_or_else(
                || "; SUMO's data folder was not found".to_owned(),
                |home| format!(", with the data in {}", home.display()),
            );
            findings.row("netconvert", format!("{}{data}", program.display()));
        }
        Err(error) => {
            let hint = "the verbs `scenario new`, `import` and `build` need it: set SUMO_HOME to a whole installation";
            findings.fault("netconvert", chain(&error), Some(hint));
        }
    }
    let net = tempfile::tempdir().and_then(|folder| {
        let net = folder.path().join("doctor.net.xml");
        fs::write(&net, NET).map(|()| (folder, net))
    });
    match net {
        Ok((_folder, net)) => match exchange(net) {
            Ok(answer) => findings.row("TraCI", answer),
            Err(error) => findings.fault("TraCI", chain(&error), error.hint().as_deref()),
        },
        Err(error) => {
            let place = std::env::temp_dir();
            findings.fault(
                "TraCI",
                format!("could not write to `{}`: {error}", place.display()),
                Some("set TMPDIR to a writable folder"),
            );
        }
    }
    check_libsumo(findings);
}

/// Shows libsumo. To be without it is not a fault, because everything works over TraCI, too.
#[cfg(feature = "libsumo")]
fn check_libsumo(findings: &mut Findings) {
    let refused = |error: &sumo::Error| {
        let hint = error.hint().map_or_else(String::new, |hint| format!("; hint: {hint}"));
        format!("{}{hint}", chain(error))
    };
    findings.row(
        "libsumo",
        match sumo::LibsumoModule::load() {
            Err(error) => format!("not usable: {}", refused(&error)),
            Ok(module) => {
                let usable = sumo::usable(sumo::Backend::Libsumo);
                let rest = usable
                    .map_or_else(|error| format!("; {}", refused(&error)), |()| String::new());
                let (release, file) = (&module.release, module.file.display());
                format!("{release} ({file}), in the embedded Python ({}){rest}", module.python)
            }
        },
    );
}

#[cfg(not(feature = "libsumo"))]
fn check_libsumo(findings: &mut Findings) {
    findings.row("libsumo", "not built in");
}

/// Starts SUMO, makes one step, and returns the protocol version and the start-up time as text.
fn exchange(net: PathBuf) -> Result<String, sumo::Error> {
    let config = SimulationConfig {
        net,
        step_length: 0.1,
        seed: 0,
        worlds: 1,
        slots: 0,
        vehicle_types: Vec::new(),
        routes: Vec::new(),
        timeout: Duration::from_secs(60),
        audit: true,
        waits: false,
        others: None,
        traffic_lights: Vec::new(),
    };
    let begin = Instant::now();
    let mut simulation = TraciSimulation::start(config)?;
    let started = begin.elapsed();
    simulation.step(&[])?;
    let version = simulation.version();
    Ok(format!(
        "API {} of {}, started in {} ms",
        version.api,
        version.software,
        started.as_millis()
    ))
}

#[cfg(feature = "learn")]
fn check_torch(findings: &mut Findings) {
    let library = loaded_library("libtorch_cpu.so");
    let folder = library.as_deref().and_then(Path::parent);
    // A libtorch from another source may lack the version file; its version is then not checked.
    let version = libtorch_version().unwrap_or_else(|| "version unknown".to_owned());
    let place =
        folder.map_or_else(|| "path unknown".to_owned(), |folder| folder.display().to_string());
    let release = version.split('+').next().unwrap_or_default();
    if release.starts_with(|c: char| c.is_ascii_digit()) && release != TORCH {
        let what = format!("{place} contains version {version}, but the program needs {TORCH}");
        findings.fault("libtorch", what, Some("run `scripts/bootstrap` and build again"));
    } else {
        findings.row("libtorch", format!("{version} ({place})"));
    }
    match tch::Tensor::from_slice(&[1.0_f64, 2.0])
        .f_sum(tch::Kind::Double)
        .and_then(|sum| f64::try_from(&sum))
    {
        Ok(3.0) => {}
        Ok(sum) => findings.fault("arithmetic", format!("libtorch computes 1 + 2 = {sum}"), None),
        Err(error) => findings.fault(
            "arithmetic",
            format!("libtorch could not add two numbers: {error}"),
            None,
        ),
    }
    let with_cuda = loaded_library("libtorch_cuda.so").is_some();
    findings.row(
        "device",
        if tch::Cuda::is_available() {
            format!(
                "cpu (CUDA finds {}; use `iwol train --device cuda`)",
                counted(tch::Cuda::device_count(), "device")
            )
        } else if with_cuda {
            "cpu (libtorch supports CUDA but finds no device: does `nvidia-smi` list one?)"
                .to_owned()
        } else {
            "cpu".to_owned()
        },
    );
}

fn check_threads(findings: &mut Findings) {
    let cores = std::thread::available_parallelism()
        .map_or_else(|_| "unknown".to_owned(), |n| n.to_string());
    #[cfg(feature = "learn")]
    let libtorch = format!(", libtorch {}", tch::get_num_threads());
    #[cfg(not(feature = "learn"))]
    let libtorch = "";
    findings
        .row("threads", format!("cores {cores}, rayon {}{libtorch}", rayon::current_num_threads()));
}

/// Checks the scenarios and counts the nets below the current folder. Finding none is not a fault:
/// the program may run in any folder.
fn check_files(findings: &mut Findings) {
    let mut good = String::new();
    for path in files_below(Path::new("scenarios"), ".xml") {
        // The folder contains route files as well.
        let text = fs::read_to_string(&path).unwrap_or_default();
        if !text.contains("<scenario") && !text.is_empty() {
            continue;
        }
        match Scenario::load(&path) {
            Ok(scenario) => {
                let separator = if good.is_empty() { "" } else { ", " };
                let nets = counted(scenario.nets.len(), "net");
                let _ = write!(good, "{separator}{} ({nets})", path.display());
            }
            Err(error) => findings.faults.push(Fault { what: chain(&error), hint: error.hint() }),
        }
    }
    findings.row(
        "scenarios",
        if good.is_empty() { "none in the folder ./scenarios".to_owned() } else { good },
    );
    let nets = files_below(Path::new("sumo_nets"), ".net.xml").len();
    findings.row("nets", format!("{nets} in the folder ./sumo_nets"));
}

/// Returns all files below a folder whose name ends with `ending`, sorted; none if the folder
/// cannot be read.
fn files_below(folder: &Path, ending: &str) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = entry.path();
        // Links to folders are not followed: they may form a cycle.
        if entry.file_type().is_ok_and(|kind| kind.is_dir()) {
            found.extend(files_below(&path, ending));
        } else if entry.file_name().to_string_lossy().ends_with(ending) {
            found.push(path);
        }
    }
    found.sort();
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fault_is_a_row_and_a_line_with_its_hint() {
        let mut findings = Findings::default();
        findings.row("iwol", "0.1.0");
        assert_eq!(findings.to_string(), "iwol  0.1.0\n\nnothing is wrong\n");
        findings.fault("SUMO", "`sumo` was not found", Some("run `scripts/bootstrap`"));
        assert_eq!(
            findings.to_string(),
            "iwol  0.1.0\nSUMO  see below\n\nwrong: SUMO: `sumo` was not found\n  hint: run `scripts/bootstrap`\n"
        );
    }

    #[test]
    fn only_files_with_the_ending_are_listed_and_in_order() {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join("inner")).unwrap();
        for name in ["b.net.xml", "a.nod.xml", "inner/a.net.xml"] {
            fs::write(folder.path().join(name), "").unwrap();
        }
        let expected = [folder.path().join("b.net.xml"), folder.path().join("inner/a.net.xml")];
        assert_eq!(files_below(folder.path(), ".net.xml"), expected);
        assert!(files_below(&folder.path().join("absent"), ".xml").is_empty());
    }
}
