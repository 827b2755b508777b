//! Why a scenario cannot be made or built.

use std::{io, path::PathBuf};

use super::super::Error as ScenarioError;
use crate::{record, sumo};

/// Why a scenario cannot be made or built.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A size that the template does not have.
    #[error("--{option} {value}: allowed: {allowed}")]
    Size {
        /// Which.
        option: &'static str,
        /// What was asked for.
        value: String,
        /// What may be asked for.
        allowed: String,
    },
    /// The name is no name of a scenario.
    #[error("`{name}` cannot be the name of a scenario: 1 to 64 letters, digits, `-` and `_`")]
    Name {
        /// The name.
        name: String,
    },
    /// There is something already where the scenario would go.
    #[error("`{}` is there already; choose another name, or move it away", path.display())]
    Exists {
        /// What is there.
        path: PathBuf,
    },
    /// A file cannot be read.
    #[error("cannot read `{}`", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A folder cannot be made, or a file of the system's cannot be written.
    #[error("cannot write `{}`", path.display())]
    Write {
        /// The folder or file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A file cannot be written.
    #[error(transparent)]
    Record(#[from] record::Error),
    /// A `.netccfg` is no configuration of netconvert.
    #[error("`{}` is no configuration of netconvert: {why}", path.display())]
    Configuration {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        why: String,
    },
    /// netconvert refused the sources.
    #[error("netconvert cannot build `{}`: {message}", config.display())]
    Netconvert {
        /// The configuration it was given.
        config: PathBuf,
        /// What it said.
        message: String,
    },
    /// netconvert is not there.
    #[error(transparent)]
    Sumo(#[from] sumo::Error),
    /// The net of an import cannot be read.
    #[error(transparent)]
    Net(#[from] sumo::net::NetError),
    /// A map has nowhere to coordinate.
    #[error("{}: {why}", path.display())]
    NoSite {
        /// The net.
        path: PathBuf,
        /// What it lacks.
        why: String,
    },
    /// The scenario is not valid.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
}

impl Error {
    pub(super) fn size(option: &'static str, value: &impl ToString, allowed: String) -> Self {
        Self::Size { option, value: value.to_string(), allowed }
    }

    /// What the user may do about it, where that is not plain from the message.
    #[must_use]
    pub fn hint(&self) -> Option<String> {
        match self {
            Self::Sumo(e) => e.hint(),
            Self::Net(e) => e.hint(),
            Self::Scenario(e) => e.hint(),
            Self::NoSite { .. } => Some(
                "netedit shows what is there; --junction takes the id of a junction".to_owned(),
            ),
            _ => None,
        }
    }
}
