//! `iwol bench sim`: measures how fast worlds are simulated.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Context as _, ensure};
use serde::Serialize;

use crate::env::Task;
use crate::scenario::Scenario;
use crate::sumo::{self, Backend, Command, Meter};

use super::super::chain;
use super::host::Host;
use super::workload::{Control, EPISODE, Workload};
use super::{compare, median};

#[derive(Debug, clap::Args)]
pub(super) struct Sim {
    /// Scenario file.
    #[arg(long, default_value = "scenarios/intersection.xml")]
    scenario: PathBuf,
    /// Numbers of vehicles per world.
    #[arg(long, value_delimiter = ',', default_value = "8,48")]
    agents: Vec<u32>,
    /// Interfaces to SUMO [default: all that this machine has].
    #[arg(long, value_delimiter = ',')]
    backend: Vec<Backend>,
    /// How commands move the vehicles.
    #[arg(long, value_enum, default_value_t = Control::Throttle)]
    control: Control,
    /// Number of worlds and number of SUMO processes that share them, as WORLDS/PROCESSES. libsumo
    /// always has one process.
    #[arg(long, value_delimiter = ',', default_value = "1/1,16/1,16/2,16/16", value_parser = layout)]
    worlds: Vec<(usize, usize)>,
    /// Duration of a measurement in seconds.
    #[arg(long, default_value_t = 3.0, value_parser = seconds)]
    seconds: f64,
    /// Let SUMO check for collisions in junctions, as the environments do for their audit.
    #[arg(long, default_value_t = true, action = clap::ArgAction::Set, value_name = "true|false")]
    audit: bool,
    /// Compare with Python's traci and libsumo and with traci-rs, in turn on the same commands.
    #[arg(long)]
    compare: bool,
    /// Number of timed steps of the comparison.
    #[arg(long, default_value_t = 2000, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    steps: u32,
    /// Number of repetitions of the comparison.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=1000))]
    repetitions: u32,
    /// Print JSON lines instead of a table.
    #[arg(long)]
    json: bool,
}

fn layout(text: &str) -> Result<(usize, usize), String> {
    let (worlds, processes) = text
        .split_once('/')
        .and_then(|(w, p)| Some((w.parse().ok()?, p.parse().ok()?)))
        .ok_or_else(|| "allowed: WORLDS/PROCESSES, e.g. 16/2".to_owned())?;
    if (1..=1024).contains(&worlds) && (1..=worlds).contains(&processes) {
        return Ok((worlds, processes));
    }
    Err("allowed: 1 to 1024 worlds, and 1 process up to one per world".to_owned())
}

fn seconds(text: &str) -> Result<f64, String> {
    let parsed = text.parse().ok().filter(|s| (0.01..=3600.0).contains(s));
    parsed.ok_or_else(|| "allowed: 0.01 to 3600 seconds".to_owned())
}

/// The result of one measurement.
#[derive(Debug, Serialize)]
struct Row {
    backend: &'static str,
    control: &'static str,
    /// Whether SUMO looks for collisions in junctions.
    audit: bool,
    agents: u32,
    worlds: usize,
    processes: usize,
    /// Steps per second, counted per world and summed over all worlds.
    steps_per_second: f64,
    /// Exchanges per second, summed over all processes.
    exchanges_per_second: f64,
    /// Share of the time in which a SUMO process was computing, mean over the processes; `None` for
    /// libsumo, which runs in this process.
    sumo_share: Option<f64>,
    /// Bytes sent and received per exchange.
    sent: f64,
    received: f64,
    /// Median duration of an exchange that respawns all vehicles of one world per process, minus
    /// that of an exchange without a respawn \[ms\]; `None` if one of the two did not occur.
    respawn_ms: Option<f64>,
}

pub(super) fn run(args: &Sim) -> anyhow::Result<()> {
    let scenario = Scenario::load(&args.scenario)?;
    let mut backends = args.backend.clone();
    if backends.is_empty() {
        for backend in Backend::ALL {
            match sumo::usable(backend) {
                Ok(()) => backends.push(backend),
                Err(error) => say!("{backend} is left out: {}", chain(&error)),
            }
        }
        ensure!(!backends.is_empty(), "no backend can be used; `iwol doctor` says more");
    }
    let mut workloads = Vec::new();
    for &agents in &args.agents {
        let task = Task::new(&scenario, agents)?;
        if task.starting < task.agents {
            anyhow::bail!(
                "`{}` has agents that do not start at spawn places; the benchmark needs a scenario without `types` and `vehicles` in <agents>",
                args.scenario.display()
            );
        }
        workloads.push(Workload::new(task, args.control, args.audit));
    }
    if args.compare {
        let mut lines = Vec::new();
        for workload in &workloads {
            lines.extend(compare::run(
                workload,
                &backends,
                &args.worlds,
                args.steps,
                args.repetitions,
            )?);
        }
        if args.json {
            lines
                .iter()
                .try_for_each(|line| serde_json::to_string(line).map(|text| tell!("{text}")))?;
        } else {
            crate::cli::print(format_args!("{}", compare::table(&lines)));
        }
        return Ok(());
    }
    if !args.json {
        tell!(
            "{:8} {:>6} {:>6} {:>9} {:>14} {:>12} {:>10} {:>16} {:>10}",
            "backend",
            "agents",
            "worlds",
            "processes",
            "world steps/s",
            "exchanges/s",
            "SUMO share",
            "bytes out/in",
            "respawn"
        );
    }
    for workload in &workloads {
        for &backend in &backends {
            for &(worlds, processes) in &args.worlds {
                if backend == Backend::Libsumo && processes > 1 {
                    if !args.backend.is_empty() {
                        say!("libsumo always has one process; {worlds}/{processes} is skipped");
                    }
                    continue;
                }
                let row = measure(workload, backend, worlds, processes, args.seconds)
                    .with_context(|| {
                        format!("{backend}, {worlds} worlds in {processes} processes")
                    })?;
                if args.json {
                    tell!("{}", serde_json::to_string(&row)?);
                } else {
                    let share = row
                        .sumo_share
                        .map_or_else(|| "-".to_owned(), |s| format!("{:.0} %", 100.0 * s));
                    let respawn =
                        row.respawn_ms.map_or_else(|| "-".to_owned(), |ms| format!("{ms:.2} ms"));
                    tell!(
                        "{:8} {:>6} {worlds:>6} {processes:>9} {:>14.0} {:>12.0} {share:>10} {:>16} {respawn:>10}",
                        backend.name(),
                        row.agents,
                        row.steps_per_second,
                        row.exchanges_per_second,
                        format!("{:.0}/{:.0}", row.sent, row.received)
                    );
                }
            }
        }
    }
    Ok(())
}

fn measure(
    workload: &Workload,
    backend: Backend,
    worlds: usize,
    processes: usize,
    seconds: f64,
) -> anyhow::Result<Row> {
    let mut hosts = Host::start(workload, backend, worlds, processes)?;
    let per_host = hosts[0].worlds;
    // Worlds respawn one after the other, like episodes of different lengths.
    let late = |world: u32| world * EPISODE / per_host;
    let advance = |hosts: &mut Vec<Host>, step: u32| -> Result<f64, sumo::Error> {
        let begin = Instant::now();
        let commands = |world: u32, out: &mut Vec<Command>| {
            if let Some(own) = step.checked_sub(late(world)) {
                workload.commands(world, own, out);
            }
        };
        Host::exchange(hosts, commands, |_| 0.0)?;
        Ok(begin.elapsed().as_secs_f64())
    };
    let first = 2 * EPISODE;
    for step in 0..first {
        advance(&mut hosts, step)?;
    }
    let before: Vec<_> = hosts.iter().map(|host| host.simulation.meter()).collect();
    let cpu_before: Vec<_> = before.iter().map(|m| m.pid.and_then(cpu_seconds)).collect();
    let begin = Instant::now();
    let mut step = first;
    let (mut plain, mut respawning) = (Vec::new(), Vec::new());
    while begin.elapsed().as_secs_f64() < seconds {
        let took = advance(&mut hosts, step)?;
        let respawns = (0..per_host).any(|w| (step - late(w)).is_multiple_of(EPISODE));
        if respawns {
            respawning.push(took);
        } else {
            plain.push(took);
        }
        step += 1;
    }
    let elapsed = begin.elapsed().as_secs_f64();
    let after: Vec<_> = hosts.iter().map(|host| host.simulation.meter()).collect();
    let cpu = |(m, before): (&Meter, &Option<f64>)| {
        Some((m.pid.and_then(cpu_seconds)? - (*before)?) / elapsed)
    };
    let share = after
        .iter()
        .zip(&cpu_before)
        .map(cpu)
        .sum::<Option<f64>>()
        .map(|sum| sum / processes as f64);
    let total = |of: fn(&Meter) -> u64| {
        after.iter().zip(&before).map(|(a, b)| (of(a) - of(b)) as f64).sum::<f64>()
    };
    let exchanges = total(|m| m.exchanges);
    Ok(Row {
        backend: backend.name(),
        control: workload.control.name(),
        audit: workload.audit,
        agents: workload.task.agents as u32,
        worlds,
        processes,
        steps_per_second: f64::from(step - first) * worlds as f64 / elapsed,
        exchanges_per_second: exchanges / elapsed,
        sumo_share: share,
        sent: total(|m| m.sent) / exchanges,
        received: total(|m| m.received) / exchanges,
        respawn_ms: Some(1000.0 * (median(&mut respawning) - median(&mut plain)))
            .filter(|ms| ms.is_finite()),
    })
}

/// Returns the processor time that a process has used \[s\].
fn cpu_seconds(pid: u32) -> Option<f64> {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    // The process name may contain spaces. After it, the 12th and 13th fields are user and system
    // time in hundredths of a second.
    let fields: Vec<&str> = stat.rsplit_once(')')?.1.split_whitespace().collect();
    let ticks = |i: usize| fields.get(i)?.parse::<f64>().ok();
    Some((ticks(11)? + ticks(12)?) / 100.0)
}
