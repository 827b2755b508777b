//! Runs a workload with the crate traci-rs and prints the time that it takes, as one line of JSON.
//!
//! The workload is a JSON file that `iwol` writes for such comparisons. It contains SUMO's
//! arguments, the vehicle types and routes, and the commands of every simulation step. After every
//! step the client reads the time, the number of colliding vehicles, and the position, angle and
//! speed of every vehicle on the road.
//!
//! `traci-rs-player plain|subscribed WORKLOAD [--steps N]` reads with one call per value, or with
//! variable subscriptions. With `--steps` only the first N timed steps run.

mod session;
mod workload;

use std::{
    hint::black_box,
    process::ExitCode,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result, bail};
use rustix::time::{ClockId, clock_gettime};
use session::{Reading, Session};
use workload::{Command, Workload};

fn main() -> ExitCode {
    match run() {
        Ok(line) => {
            println!("{line}");
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("traci-rs-player: {error:#}");
            ExitCode::FAILURE
        }
    }
}

/// Runs the workload that the command line names; returns the line to print.
fn run() -> Result<serde_json::Value> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let (mode, path, limit) = match arguments[..] {
        [mode, path] => (mode, path, None),
        [mode, path, "--steps", steps] => (mode, path, Some(steps.parse::<usize>().context("--steps takes a number")?)),
        _ => bail!("usage: traci-rs-player plain|subscribed WORKLOAD [--steps N]"),
    };
    let (client, reading) = match mode {
        "plain" => ("traci-rs", Reading::Getters),
        "subscribed" => ("traci-rs-subscribed", Reading::Subscriptions),
        _ => bail!("{mode:?} is neither \"plain\" nor \"subscribed\""),
    };
    let workload = Workload::read(path.as_ref())?;
    let (warmup, timed) = workload
        .steps
        .split_at_checked(workload.warmup)
        .context("the workload has fewer steps than its warm-up takes")?;
    let timed = &timed[..limit.unwrap_or(timed.len()).min(timed.len())];

    let mut session = Session::start(&workload, reading)?;
    black_box(play(&mut session, warmup)?);
    let (started, started_cpu) = (Instant::now(), cpu_time());
    let checksum = play(&mut session, timed)?;
    let (seconds, seconds_cpu) = (started.elapsed(), cpu_time().saturating_sub(started_cpu));
    session.close()?;

    Ok(serde_json::json!({
        "client": client,
        "version": "0.2.0",
        "steps": timed.len(),
        "seconds": seconds.as_secs_f64(),
        "seconds_cpu": seconds_cpu.as_secs_f64(),
        "checksum": checksum,
    }))
}

/// Runs the steps; returns the sum of all values that were read of the vehicles.
fn play(session: &mut Session, steps: &[Vec<Command>]) -> Result<f64> {
    let mut checksum = 0.0;
    for commands in steps {
        for command in commands {
            session.command(command)?;
        }
        checksum += session.step()?;
    }
    Ok(checksum)
}

/// Returns the processor time that this process has used.
fn cpu_time() -> Duration {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    Duration::new(time.tv_sec.unsigned_abs(), u32::try_from(time.tv_nsec).unwrap_or_default())
}
