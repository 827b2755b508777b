//! Where worlds run: with which backend, and in how many SUMO processes.

use std::{ffi::OsString, fmt, str::FromStr, thread, time::Duration};

use serde::{Deserialize, Serialize};

use super::{Error, Simulation, SimulationConfig, TraciSimulation, fleet::Fleet};
use crate::words::counted;

/// The way in which this program talks to SUMO.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Backend {
    /// Separate SUMO processes, over TCP.
    Traci,
    /// SUMO within this process, through the Python module `libsumo`; one simulation per process.
    Libsumo,
}

impl Backend {
    /// All backends.
    pub const ALL: [Backend; 2] = [Backend::Traci, Backend::Libsumo];

    /// Returns the name on the command line.
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

/// The user's choice of the backend.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "learn", derive(schemars::JsonSchema))]
#[serde(rename_all = "lowercase")]
pub enum Choice {
    /// The fastest backend: libsumo on a machine with one core if this build includes it and the
    /// module has the release of the program `sumo`, otherwise TraCI with one SUMO process per core.
    #[default]
    Auto,
    /// SUMO processes, over TCP.
    Traci,
    /// SUMO inside of this process.
    Libsumo,
}

impl Choice {
    /// Returns the backend to use.
    pub fn backend(self) -> Backend {
        match self {
            Choice::Auto if cores() == 1 && usable(Backend::Libsumo).is_ok() => Backend::Libsumo,
            Choice::Auto | Choice::Traci => Backend::Traci,
            Choice::Libsumo => Backend::Libsumo,
        }
    }
}

fn cores() -> usize {
    thread::available_parallelism().map_or(1, std::num::NonZero::get)
}

/// Where worlds run. It affects the speed only, not the results.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Hosting {
    /// Backend of all worlds.
    pub backend: Backend,
    /// Number of SUMO processes over which the worlds are distributed; 0: one per core. libsumo
    /// always runs all worlds in this process.
    pub processes: usize,
    /// Longest wait for an answer before SUMO counts as dead; it has no effect with libsumo.
    pub timeout: Duration,
    /// Whether SUMO detects collisions on junctions, for comparison with this program's own test.
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
    /// Returns the hosting for worlds that run at the same time as worlds under `self`. It always
    /// uses TraCI, because libsumo runs only one simulation per process.
    #[must_use]
    pub fn beside(self) -> Self {
        Hosting { backend: Backend::Traci, ..self }
    }

    /// Returns the hosting with one SUMO instance per world. It keeps libsumo, which runs only one
    /// simulation, if `worlds` is 1, and uses TraCI otherwise.
    #[must_use]
    pub fn alone(self, worlds: usize) -> Self {
        Hosting { processes: worlds, ..if worlds == 1 { self } else { self.beside() } }
    }

    /// Describes the hosting of this number of worlds in words.
    pub fn describe(&self, worlds: usize) -> String {
        let hosts = self.hosts(worlds);
        let worlds = counted(worlds, "world");
        match (self.backend, hosts) {
            (Backend::Libsumo, _) => format!("{worlds} in one libsumo, in process"),
            (Backend::Traci, 1) => format!("{worlds} in one SUMO process (TraCI)"),
            (Backend::Traci, hosts) => format!("{worlds} in {hosts} SUMO processes (TraCI)"),
        }
    }

    /// Returns the number of SUMO instances over which this number of worlds is distributed.
    pub fn hosts(&self, worlds: usize) -> usize {
        let wanted = match (self.backend, self.processes) {
            (Backend::Libsumo, _) => 1,
            (Backend::Traci, 0) => cores(),
            (Backend::Traci, processes) => processes,
        };
        wanted.min(worlds)
    }
}

/// Starts a simulation with a backend.
///
/// # Errors
/// The errors of the backend's `start`; [`Error::NotBuiltIn`] if this build lacks the backend.
pub fn start(backend: Backend, config: SimulationConfig) -> Result<Box<dyn Simulation>, Error> {
    match backend {
        Backend::Traci => Ok(Box::new(TraciSimulation::start(config)?)),
        #[cfg(feature = "libsumo")]
        Backend::Libsumo => Ok(Box::new(super::LibsumoSimulation::start(config)?)),
        #[cfg(not(feature = "libsumo"))]
        Backend::Libsumo => Err(Error::NotBuiltIn { backend }),
    }
}

/// Whether a backend works on this machine.
///
/// # Errors
/// [`Error::NotFound`] without a program `sumo`; [`Error::NotBuiltIn`] and [`Error::Libsumo`] if
/// libsumo cannot be used, or has another release than the program `sumo`.
pub fn usable(backend: Backend) -> Result<(), Error> {
    match backend {
        Backend::Traci => super::Installation::find().map(drop),
        #[cfg(feature = "libsumo")]
        Backend::Libsumo => match &super::LibsumoModule::load()?.difference {
            None => Ok(()),
            Some(difference) => {
                Err(Error::Libsumo { doing: "stand in for sumo", message: difference.clone() })
            }
        },
        #[cfg(not(feature = "libsumo"))]
        Backend::Libsumo => Err(Error::NotBuiltIn { backend }),
    }
}

/// Returns the arguments of the program `sumo`, without the port, for a simulation of one world.
///
/// # Errors
/// [`Error::Invalid`] for a configuration that SUMO does not support, with several worlds, or with
/// background traffic; [`Error::Net`] if the net cannot be read.
pub fn arguments(config: &SimulationConfig) -> Result<Vec<OsString>, Error> {
    if config.worlds != 1 || config.others.is_some() {
        return Err(Error::invalid(
            "files that are kept in memory for SUMO end with their simulation",
        ));
    }
    Fleet::new(config.clone())?.arguments()
}
