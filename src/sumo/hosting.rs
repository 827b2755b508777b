//! Where worlds run: by which backend, and in how many SUMO processes.

use std::{ffi::OsString, fmt, str::FromStr, thread, time::Duration};

use serde::{Deserialize, Serialize};

use super::{Error, Simulation, SimulationConfig, TraciSimulation, fleet::Fleet};

/// How SUMO is spoken to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Backend {
    /// SUMO processes, over TCP.
    Traci,
    /// SUMO in this process, through Debian's Python module. One simulation per process.
    Libsumo,
}

impl Backend {
    /// All backends.
    pub const ALL: [Backend; 2] = [Backend::Traci, Backend::Libsumo];

    /// As it is named on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Backend::Traci => "traci",
            Backend::Libsumo => "libsumo",
        }
    }
}

impl fmt::Display for Backend {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Backend {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self, Error> {
        let found = Self::ALL.into_iter().find(|backend| backend.name() == name);
        found.ok_or_else(|| {
            Error::invalid(format!("there is no backend `{name}`: choose traci or libsumo"))
        })
    }
}

/// What a user says about the backend.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Choice {
    /// The fastest that this program has: libsumo where there is one core, and TraCI with a SUMO on each core elsewhere.
    #[default]
    Auto,
    /// As [`Backend::Traci`].
    Traci,
    /// As [`Backend::Libsumo`].
    Libsumo,
}

impl Choice {
    /// The backend to use.
    pub fn backend(self) -> Backend {
        match self {
            Choice::Auto if cores() == 1 && available().any(|b| b == Backend::Libsumo) => {
                Backend::Libsumo
            }
            Choice::Auto | Choice::Traci => Backend::Traci,
            Choice::Libsumo => Backend::Libsumo,
        }
    }
}

fn cores() -> usize {
    thread::available_parallelism().map_or(1, std::num::NonZero::get)
}

/// Where worlds run. Nothing but speed depends on it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Hosting {
    /// How SUMO is spoken to.
    pub backend: Backend,
    /// SUMO processes over which the worlds are spread; 0: as many as there are cores. libsumo has one, this one.
    pub processes: usize,
    /// How long SUMO may take for an answer before it counts as dead; libsumo cannot be timed.
    pub timeout: Duration,
    /// Whether SUMO looks for collisions in junctions, to be compared with ours.
    pub audit: bool,
}

impl Default for Hosting {
    fn default() -> Self {
        Hosting {
            backend: Backend::Traci,
            processes: 0,
            timeout: Duration::from_secs(20),
            audit: true,
        }
    }
}

impl Hosting {
    /// For worlds beside others that are hosted like this: libsumo has one place only.
    #[must_use]
    pub fn beside(self) -> Self {
        Hosting { backend: Backend::Traci, ..self }
    }

    /// One SUMO for each of so many worlds: libsumo, which has one place, only where there is one.
    #[must_use]
    pub fn alone(self, worlds: usize) -> Self {
        Hosting { processes: worlds, ..if worlds == 1 { self } else { self.beside() } }
    }

    /// In words, for so many worlds.
    pub fn describe(&self, worlds: usize) -> String {
        match (self.backend, self.hosts(worlds)) {
            (Backend::Libsumo, _) => format!("{worlds} worlds in one libsumo, in process"),
            (Backend::Traci, 1) => format!("{worlds} worlds in one SUMO process (TraCI)"),
            (Backend::Traci, hosts) => format!("{worlds} worlds in {hosts} SUMO processes (TraCI)"),
        }
    }

    /// Simulations over which so many worlds are spread.
    pub fn hosts(&self, worlds: usize) -> usize {
        let wanted = match (self.backend, self.processes) {
            (Backend::Libsumo, _) => 1,
            (Backend::Traci, 0) => cores(),
            (Backend::Traci, processes) => processes,
        };
        wanted.min(worlds)
    }
}

/// Starts a simulation.
///
/// # Errors
/// What the backend returns.
pub fn start(backend: Backend, config: SimulationConfig) -> Result<Box<dyn Simulation>, Error> {
    match backend {
        Backend::Traci => Ok(Box::new(TraciSimulation::start(config)?)),
        #[cfg(feature = "libsumo")]
        Backend::Libsumo => Ok(Box::new(super::LibsumoSimulation::start(config)?)),
        #[cfg(not(feature = "libsumo"))]
        Backend::Libsumo => Err(Error::NotBuiltIn { backend }),
    }
}

/// The backends that this program was built with.
pub fn available() -> impl Iterator<Item = Backend> {
    Backend::ALL
        .into_iter()
        .filter(|backend| *backend == Backend::Traci || cfg!(feature = "libsumo"))
}

/// The arguments of the program `sumo`, without the port, for a simulation of a single world.
///
/// # Errors
/// [`Error::Invalid`] for a configuration that SUMO cannot have, or of more worlds; [`Error::Net`].
pub fn arguments(config: &SimulationConfig) -> Result<Vec<OsString>, Error> {
    if config.worlds != 1 || config.others.is_some() {
        return Err(Error::invalid(
            "files that are kept in memory for SUMO end with their simulation",
        ));
    }
    Fleet::new(config.clone())?.arguments()
}
