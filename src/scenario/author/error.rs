//! Errors of creating and building scenarios.

use std::{io, path::PathBuf};

use super::super::Error as ScenarioError;
use crate::{record, sumo};

/// Error of a scenario that cannot be created or built.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A size is outside the range of the template.
    #[error("--{option} {value}: allowed: {allowed}")]
    Size {
        /// Name of the option.
        option: &'static str,
        /// Requested value.
        value: String,
        /// Allowed values.
        allowed: String,
    },
    /// The name is not valid for a scenario.
    #[error(
        "`{name}` is not a valid name of a scenario, allowed: 1 to 64 letters, digits, `-` and `_`"
    )]
    Name {
        /// The name.
        name: String,
    },
    /// A file or folder of the new scenario already exists.
    #[error("`{}` already exists; choose another name, or move the file or folder away", path.display())]
    Exists {
        /// Existing file or folder.
        path: PathBuf,
    },
    /// A file cannot be read.
    #[error("cannot read `{}`", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// A folder or a temporary file cannot be created.
    #[error("cannot write `{}`", path.display())]
    Write {
        /// The folder or file.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// A file cannot be written.
    #[error(transparent)]
    Record(#[from] record::Error),
    /// A `.netccfg` is not a configuration of netconvert.
    #[error("`{}` is not a configuration of netconvert: {why}", path.display())]
    Configuration {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        why: String,
    },
    /// A net is missing, and so is the configuration from which it could be built.
    #[error(
        "there is neither the net `{}` nor its configuration for netconvert, `{}`; correct the file name in the scenario",
        net.display(),
        config.display()
    )]
    NoNet {
        /// The net.
        net: PathBuf,
        /// The configuration that would stand beside it.
        config: PathBuf,
    },
    /// Nobody of the demand of an import can be an agent.
    #[error("`{}`: {why}", path.display())]
    NoDemand {
        /// The configuration.
        path: PathBuf,
        /// What is missing.
        why: String,
    },
    /// netconvert rejects the sources.
    #[error("netconvert cannot build `{}`: {message}", config.display())]
    Netconvert {
        /// Configuration that netconvert has read.
        config: PathBuf,
        /// Error message of netconvert.
        message: String,
    },
    /// netconvert is missing or cannot be started.
    #[error(transparent)]
    Sumo(#[from] sumo::Error),
    /// The net of an import cannot be read.
    #[error(transparent)]
    Net(#[from] sumo::net::NetError),
    /// A map has no junction at which vehicles have to coordinate.
    #[error("`{}`: {why}", path.display())]
    NoSite {
        /// The net or map.
        path: PathBuf,
        /// What is missing.
        why: String,
        /// What the user can do.
        hint: &'static str,
    },
    /// netconvert rejects the map of an import.
    #[error("netconvert cannot convert `{}`: {message}", path.display())]
    Map {
        /// The map.
        path: PathBuf,
        /// Error message of netconvert.
        message: String,
    },
    /// The scenario is not valid.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
}

impl Error {
    pub(super) fn size(option: &'static str, value: &impl ToString, allowed: String) -> Self {
        Self::Size { option, value: value.to_string(), allowed }
    }

    /// Returns what the user can do about the error, unless the message already says it.
    #[must_use]
    pub fn hint(&self) -> Option<String> {
        match self {
            Self::Sumo(e) => e.hint(),
            Self::Net(e) => e.hint(),
            Self::Scenario(e) => e.hint(),
            Self::NoSite { hint, .. } => Some((*hint).to_owned()),
            Self::Map { .. } => Some(
                "--osm takes an extract of OpenStreetMap with streets for cars, as XML (.osm), as www.openstreetmap.org exports \
                 it; --net takes a SUMO net"
                    .to_owned(),
            ),
            _ => None,
        }
    }
}
