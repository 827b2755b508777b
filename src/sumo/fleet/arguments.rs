//! SUMO's command line, and the files that SUMO reads from this process.

use std::{
    ffi::OsString,
    fs::File,
    io::{Seek as _, Write as _},
    os::fd::AsRawFd as _,
    path::PathBuf,
    sync::Arc,
};

use rustix::fs::{MemfdFlags, memfd_create};

use super::Fleet;
use crate::sumo::{Error, SimulationConfig, net::tile};

impl Fleet {
    /// Returns SUMO's command line, without the program and the port.
    pub(in crate::sumo) fn arguments(&self) -> Result<Vec<OsString>, Error> {
        let config = &self.config;
        let milliseconds = config.step_length * 1000.0;
        // SUMO counts time in whole milliseconds.
        if !((1.0..=1e6).contains(&milliseconds)
            && (milliseconds - milliseconds.round()).abs() < 1e-6)
        {
            let length = config.step_length;
            return Err(Error::invalid(format!(
                "the step length must be a whole number of milliseconds of at least 1 ms, not {length} s"
            )));
        }
        // SUMO's seed is a non-negative 32 bit number.
        let seed = config.seed % (1 << 31);
        let text = format!("--step-length {} --seed {seed}", config.step_length);
        let net = self.tiled.as_deref().map_or_else(|| config.net.clone(), path_of);
        let mut arguments: Vec<OsString> = vec!["--net-file".into(), net.into()];
        arguments.extend(text.split(' ').chain(ALWAYS).map(OsString::from));
        if let Some(file) = &self.definitions {
            arguments.extend(["--additional-files".into(), path_of(file).into()]);
        }
        if config.audit {
            arguments.push("--collision.check-junctions".into());
        }
        Ok(arguments)
    }
}

/// Writes the net with one copy for each world; returns the file and the offsets of the copies.
pub(super) fn write_tiles(
    config: &SimulationConfig,
    text: &str,
) -> Result<(Arc<File>, Vec<[f64; 2]>), Error> {
    let tiled = tile(text, &config.net, config.worlds).map_err(Box::new)?;
    Ok((in_memory("tiles.net.xml", &tiled.text)?, tiled.offsets))
}

/// Returns a file in memory for SUMO to read, so that no folder needs to be writable.
pub(super) fn in_memory(name: &str, text: &str) -> Result<Arc<File>, Error> {
    let io = |source| Error::Io { doing: "keep a file for SUMO in memory", source };
    let memory = memfd_create(name, MemfdFlags::CLOEXEC).map_err(|e| io(e.into()))?;
    let mut file = File::from(memory);
    file.write_all(text.as_bytes()).and_then(|()| file.rewind()).map_err(io)?;
    Ok(Arc::new(file))
}

/// Returns the path under which SUMO can open an unnamed file of this process.
fn path_of(file: &File) -> PathBuf {
    PathBuf::from(format!("/proc/{}/fd/{}", std::process::id(), file.as_raw_fd()))
}

/// SUMO options of every simulation.
const ALWAYS: [&str; 12] = [
    // A vehicle that cannot be inserted does not delay the others that depart on its edge.
    "--eager-insert",
    // `none` disables the reports of collisions. `warn` does not move or remove vehicles either.
    "--collision.action",
    "warn",
    // Only vehicles that overlap collide, not those with a gap below the minimum gap.
    "--collision.mingap-factor",
    "0",
    "--time-to-teleport",
    "-1",
    "--xml-validation",
    "never",
    "--no-warnings",
    "--no-step-log",
    "--duration-log.disable",
];
