//! `iwol bench sim --compare`: runs other clients on the same commands, in turn with this
//! program's.

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;
use std::process::Command as Program;
use std::time::Instant;

use anyhow::{Context as _, bail, ensure};
use serde::{Deserialize, Serialize};

use crate::sumo::{self, Backend, Command, Snapshot};
use crate::words::counted;

use super::super::chain;
use super::host::Host;
use super::median;
use super::workload::{EPISODE, Workload};

/// Number of steps before the timed ones.
const WARMUP: u32 = 2 * EPISODE;
/// The Python that this program embeds, and otherwise Debian's.
const PYTHON: &str = match option_env!("IWOL_PYTHON") {
    Some(python) => python,
    None => "/usr/bin/python3",
};
const PLAYERS: &str = include_str!("../../../python_bridge/players.py");
/// Built separately: `cargo build --release --manifest-path benches/traci_rs/Cargo.toml`.
const TRACI_RS: &str = "benches/traci_rs/target/release/traci-rs-player";
/// Relative tolerance for the difference of two checksums: sums of the same numbers in another
/// order differ by less.
const SAME: f64 = 1e-9;

/// The result of a client, as it prints it in JSON.
#[derive(Debug, Deserialize)]
struct Played {
    steps: u32,
    seconds: f64,
    checksum: f64,
}

/// The result of one client over all repetitions.
#[derive(Debug, Serialize)]
pub(super) struct Line {
    pub(super) agents: u32,
    client: String,
    /// World steps per second: median, minimum, maximum.
    steps_per_second: f64,
    least: f64,
    most: f64,
}

enum Client {
    /// This program: backend, worlds, processes.
    Ours(Backend, usize, usize),
    Python(&'static str),
    TraciRs(&'static str),
}

impl Client {
    fn name(&self) -> String {
        match self {
            Client::Ours(backend, worlds, processes) => {
                let place = match backend {
                    Backend::Libsumo => "in process".to_owned(),
                    Backend::Traci => {
                        format!("{processes} process{}", if *processes == 1 { "" } else { "es" })
                    }
                };
                format!("iwol {backend}, {}, {place}", counted(worlds, "world"))
            }
            Client::Python("libsumo") => "Python libsumo".to_owned(),
            Client::Python("subscribed") => "Python traci, subscribed".to_owned(),
            Client::Python(_) => "Python traci, plain calls".to_owned(),
            Client::TraciRs("subscribed") => "traci-rs, subscribed".to_owned(),
            Client::TraciRs(_) => "traci-rs, plain calls".to_owned(),
        }
    }

    /// Returns the number of timed steps of this client. Plain calls are slow, so a tenth of the
    /// steps suffices.
    fn steps(&self, steps: u32) -> u32 {
        match self {
            Client::Python("traci") | Client::TraciRs("plain") => (steps / 10).max(1),
            _ => steps,
        }
    }
}

/// Runs `steps` timed steps of the workload with every client in turn, `repetitions` times.
pub(super) fn run(
    workload: &Workload,
    backends: &[Backend],
    layouts: &[(usize, usize)],
    steps: u32,
    repetitions: u32,
) -> anyhow::Result<Vec<Line>> {
    let installation = sumo::Installation::find()?;
    let mut clients = Vec::new();
    if installation.home().is_some_and(|home| home.join("tools/traci").is_dir()) {
        clients.extend([Client::Python("traci"), Client::Python("subscribed")]);
    } else {
        say!("Python traci is left out: this SUMO has no folder `tools`");
    }
    match packages() {
        Ok(_) => clients.push(Client::Python("libsumo")),
        Err(error) => say!("Python libsumo is left out: {}", chain(&error)),
    }
    if Path::new(TRACI_RS).exists() {
        clients.extend([Client::TraciRs("plain"), Client::TraciRs("subscribed")]);
    } else {
        say!(
            "traci-rs is skipped; build its player with `cargo build --release --manifest-path benches/traci_rs/Cargo.toml`"
        );
    }
    for &(worlds, processes) in layouts {
        for &backend in
            backends.iter().filter(|backend| **backend == Backend::Traci || processes == 1)
        {
            clients.push(Client::Ours(backend, worlds, processes));
        }
    }
    let config = workload.config(1);
    let arguments: Vec<String> =
        sumo::arguments(&config)?.into_iter().map(|a| a.to_string_lossy().into_owned()).collect();
    let folder = tempfile::tempdir().context("cannot create a temporary folder")?;
    let file = folder.path().join("workload.json");
    let players = folder.path().join("players.py");
    let write = |path: &Path, bytes: &[u8]| {
        std::fs::File::create(path)
            .and_then(|mut f| f.write_all(bytes))
            .context("cannot write the workload")
    };
    write(&file, workload.export(&arguments, WARMUP, steps).to_string().as_bytes())?;
    write(&players, PLAYERS.as_bytes())?;
    let mut rates = vec![Vec::new(); clients.len()];
    let mut checksums: Vec<(u32, f64, String)> = Vec::new();
    for _ in 0..repetitions {
        for (client, rates) in clients.iter().zip(&mut rates) {
            let steps = client.steps(steps);
            let limit = steps.to_string();
            let (played, worlds) = match client {
                Client::Ours(backend, worlds, processes) => {
                    (play(workload, *backend, *worlds, *processes, steps)?, *worlds)
                }
                Client::Python(kind) => {
                    // Isolated: without the variables and packages of the user's own Python.
                    let mut program = installation.command(Path::new(PYTHON));
                    program.arg("-I").arg(&players).arg(kind).arg(&file).args(["--steps", &limit]);
                    program.arg("--sumo").arg(installation.binary());
                    if *kind == "libsumo" {
                        program.arg("--packages").arg(packages()?);
                    }
                    (external(&mut program)?, 1)
                }
                Client::TraciRs(kind) => {
                    let mut program = installation.command(Path::new(TRACI_RS));
                    program.arg(kind).arg(&file).args(["--steps", &limit]);
                    // It looks for `sumo` in PATH.
                    program.env("PATH", installation.binary().parent().unwrap_or(Path::new("")));
                    (external(&mut program)?, 1)
                }
            };
            match checksums.iter().find(|(steps, ..)| *steps == played.steps) {
                None => checksums.push((played.steps, played.checksum, client.name())),
                Some((_, expected, first)) => ensure!(
                    (played.checksum - expected).abs() <= SAME * expected.abs(),
                    "{} did not simulate the same as {first}: its checksum is {}, not {expected}",
                    client.name(),
                    played.checksum
                ),
            }
            rates.push(f64::from(played.steps) * worlds as f64 / played.seconds);
        }
    }
    let line = |(client, mut rates): (&Client, Vec<f64>)| {
        let middle = median(&mut rates);
        let (least, most) =
            (rates.first().copied().unwrap_or(middle), rates.last().copied().unwrap_or(middle));
        Line {
            agents: workload.task.agents as u32,
            client: client.name(),
            steps_per_second: middle,
            least,
            most,
        }
    };
    Ok(clients.iter().zip(rates).map(line).collect())
}

/// Runs the workload with this program: all worlds get the same commands, and all reported vehicles
/// are converted to positions and angles.
fn play(
    workload: &Workload,
    backend: Backend,
    worlds: usize,
    processes: usize,
    steps: u32,
) -> anyhow::Result<Played> {
    let mut hosts = Host::start(workload, backend, worlds, processes)?;
    let mut checksum = 0.0;
    let mut begin = Instant::now();
    for step in 0..WARMUP + steps {
        if step == WARMUP {
            begin = Instant::now();
        }
        let commands = |world: u32, out: &mut Vec<Command>| workload.commands(world, step, out);
        // All reports are evaluated for timing; the checksum is that of the first world, which the
        // other clients simulate too.
        let read = |snapshot: &Snapshot| {
            let mut sums = snapshot.vehicles.chunks(workload.task.agents).map(|world| {
                let vehicles = world.iter().enumerate();
                vehicles
                    .filter_map(|(slot, vehicle)| Some(workload.checksum(slot, vehicle.as_ref()?)))
                    .sum::<f64>()
            });
            let first = sums.next().unwrap_or_default();
            for sum in sums {
                std::hint::black_box(sum);
            }
            first
        };
        let sums = Host::exchange(&mut hosts, commands, read)?;
        if step >= WARMUP {
            checksum += sums;
        }
    }
    Ok(Played { steps, seconds: begin.elapsed().as_secs_f64(), checksum })
}

/// Returns the folder of Python packages with libsumo.
#[cfg(feature = "libsumo")]
fn packages() -> Result<std::path::PathBuf, sumo::Error> {
    sumo::usable(Backend::Libsumo)?;
    let file = &sumo::LibsumoModule::load()?.file;
    Ok(file.ancestors().nth(2).unwrap_or(file).to_owned())
}

#[cfg(not(feature = "libsumo"))]
fn packages() -> Result<std::path::PathBuf, sumo::Error> {
    Err(sumo::Error::NotBuiltIn { backend: Backend::Libsumo })
}

fn external(program: &mut Program) -> anyhow::Result<Played> {
    let output = program.output().with_context(|| format!("cannot run {program:?}"))?;
    if !output.status.success() {
        bail!(
            "{program:?} failed ({}): {}",
            output.status,
            String::from_utf8_lossy(&output.stderr).trim()
        );
    }
    serde_json::from_slice(&output.stdout).with_context(|| format!("{program:?} printed no result"))
}

/// Formats the results as Markdown, with the rates as multiples of the first client's.
pub(super) fn table(lines: &[Line]) -> String {
    let mut text = String::from(
        "| client | vehicles | world steps/s | minimum to maximum | × plain Python |\n|---|--:|--:|--:|--:|\n",
    );
    let mut base = f64::NAN;
    let mut agents = None;
    for line in lines {
        if agents != Some(line.agents) {
            (agents, base) = (Some(line.agents), line.steps_per_second);
        }
        let _ = writeln!(
            text,
            "| {} | {} | {:.0} | {:.0} to {:.0} | {:.1} |",
            line.client,
            line.agents,
            line.steps_per_second,
            line.least,
            line.most,
            line.steps_per_second / base
        );
    }
    text
}
