//! Simulations that run the workload in lock-step.

use rayon::prelude::*;

use crate::sumo::{self, Backend, Command, Simulation, Snapshot};

use super::workload::Workload;

/// A simulation with its number of worlds.
pub(super) struct Host {
    pub(super) simulation: Box<dyn Simulation>,
    pub(super) worlds: u32,
    commands: Vec<Command>,
}

impl Host {
    pub(super) fn start(
        workload: &Workload,
        backend: Backend,
        worlds: usize,
        processes: usize,
    ) -> Result<Vec<Host>, sumo::Error> {
        let host = |h: usize| {
            let worlds = ((h + 1) * worlds / processes - h * worlds / processes) as u32;
            let simulation = sumo::start(backend, workload.config(worlds))?;
            Ok(Host { simulation, worlds, commands: Vec::new() })
        };
        (0..processes).map(host).collect()
    }

    /// Runs one exchange with all hosts. `commands` appends the commands of one world; `read`
    /// evaluates the report of one host. Returns the value of `read` for the first host.
    pub(super) fn exchange(
        hosts: &mut [Host],
        commands: impl Fn(u32, &mut Vec<Command>) + Sync,
        read: impl Fn(&Snapshot) -> f64 + Sync,
    ) -> Result<f64, sumo::Error> {
        hosts.par_iter_mut().try_for_each(|host| {
            host.commands.clear();
            (0..host.worlds).for_each(|world| commands(world, &mut host.commands));
            host.simulation.send(&host.commands)
        })?;
        let values: Result<Vec<f64>, sumo::Error> =
            hosts.par_iter_mut().map(|host| host.simulation.receive().map(&read)).collect();
        Ok(values?.first().copied().unwrap_or_default())
    }
}
