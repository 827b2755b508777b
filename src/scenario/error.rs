//! Errors of scenario files. Messages begin with `path:line:column`, name the key and, if there is
//! a similar valid name, the name that was probably meant.

use std::fmt::{self, Display};
use std::{io, path::PathBuf};

use crate::sumo::net::{NetError, XmlError, did_you_mean, shorten};

/// A place in a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Place {
    /// The file.
    pub path: PathBuf,
    /// Line, from 1.
    pub line: u32,
    /// Column, from 1.
    pub column: u32,
}

impl Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}:{}", self.path.display(), self.line, self.column)
    }
}

/// Error of a scenario that cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The file does not exist or cannot be read as text.
    #[error("{}: cannot read the scenario", path.display())]
    Read {
        /// The scenario file.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// The file is larger than the limit.
    #[error("{}: the scenario is larger than {limit} bytes", path.display())]
    TooLarge {
        /// The scenario file.
        path: PathBuf,
        /// Largest accepted size \[bytes\].
        limit: u64,
    },
    /// The file is not XML, or contains XML that the reader does not accept.
    #[error("{place}: cannot be read as XML")]
    Parse {
        /// Place of the error.
        place: Place,
        /// Error of the XML parser.
        source: XmlError,
    },
    /// An element, attribute or text is not allowed at this place.
    #[error("{place}: unknown {kind} `{key}` in {parent}{}", did_you_mean(*nearest))]
    Unknown {
        /// Place of the element, attribute or text.
        place: Place,
        /// `element`, `attribute` or `text`.
        kind: &'static str,
        /// Name of the element or attribute, or the text.
        key: String,
        /// Element that contains it, as `<agents>`.
        parent: String,
        /// Most similar valid name, if one is similar.
        nearest: Option<&'static str>,
        /// All names that are valid at this place.
        valid: Vec<&'static str>,
    },
    /// Something is missing, occurs too often, or has a value that is not allowed.
    #[error("{place}: {message}")]
    Invalid {
        /// Place of the mistake.
        place: Place,
        /// What is wrong, and what is allowed.
        message: String,
        /// What the user can do, if the message does not say it.
        hint: Option<&'static str>,
    },
    /// A net file is missing or cannot be used.
    #[error("{place}: the net cannot be used")]
    Net {
        /// Place of the attribute `file`.
        place: Place,
        /// Error of the net.
        source: Box<NetError>,
    },
    /// A route cannot be driven in one of the nets.
    #[error("{place}: the route `{route}` cannot be driven")]
    Route {
        /// Place of the route's edges.
        place: Place,
        /// Id of the route.
        route: String,
        /// Reason.
        source: Box<NetError>,
    },
    /// The scenario does not accept the requested number of agents.
    #[error("{}: {agents} agents are not allowed, allowed: {min} to {max}", path.display())]
    Agents {
        /// The scenario file.
        path: PathBuf,
        /// Requested number.
        agents: u32,
        /// Smallest number.
        min: u32,
        /// Largest number.
        max: u32,
    },
}

/// Returns the message that an attribute has a value that is not allowed.
pub(super) fn invalid(element: &str, key: &str, value: &str, allowed: impl Display) -> String {
    format!("`{}` is not a valid {key} of <{element}>, allowed: {allowed}", shorten(value))
}

impl Error {
    /// Returns an error: an attribute has a value that is not allowed.
    pub(super) fn value(
        place: Place,
        element: &str,
        key: &str,
        value: &str,
        allowed: impl Display,
    ) -> Self {
        Self::Invalid { place, message: invalid(element, key, value, allowed), hint: None }
    }

    /// Returns the message without the place, which the message of [`Error::Invalid`] begins with.
    #[must_use]
    pub fn message(&self) -> String {
        match self {
            Self::Invalid { message, .. } => message.clone(),
            other => other.to_string(),
        }
    }

    pub(super) fn place_mut(&mut self) -> Option<&mut Place> {
        match self {
            Self::Read { .. } | Self::TooLarge { .. } | Self::Agents { .. } => None,
            Self::Parse { place, .. }
            | Self::Unknown { place, .. }
            | Self::Invalid { place, .. }
            | Self::Net { place, .. }
            | Self::Route { place, .. } => Some(place),
        }
    }

    /// Returns the error with a hint.
    pub(super) fn hinted(mut self, advice: &'static str) -> Self {
        if let Self::Invalid { hint, .. } = &mut self {
            *hint = Some(advice);
        }
        self
    }

    /// Returns the file with the error: the scenario file, or a file that it names.
    pub fn path(&self) -> &std::path::Path {
        match self {
            Self::Read { path, .. } | Self::TooLarge { path, .. } | Self::Agents { path, .. } => {
                path
            }
            Self::Parse { place, .. }
            | Self::Unknown { place, .. }
            | Self::Invalid { place, .. }
            | Self::Net { place, .. }
            | Self::Route { place, .. } => &place.path,
        }
    }

    /// Returns the kind of the error as a word.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Read { .. } => "read",
            Self::TooLarge { .. } => "size",
            Self::Parse { .. } => "xml",
            Self::Unknown { .. } => "unknown",
            Self::Invalid { .. } => "value",
            Self::Net { .. } => "net",
            Self::Route { .. } => "route",
            Self::Agents { .. } => "agents",
        }
    }

    /// Returns line and column of the error, both from 1, if it has a position in the file.
    pub fn position(&self) -> Option<(u32, u32)> {
        match self {
            Self::Read { .. } | Self::TooLarge { .. } | Self::Agents { .. } => None,
            Self::Parse { place, .. }
            | Self::Unknown { place, .. }
            | Self::Invalid { place, .. }
            | Self::Net { place, .. }
            | Self::Route { place, .. } => Some((place.line, place.column)),
        }
    }

    /// Returns what the user can do about the error, unless the message already says it.
    #[must_use]
    pub fn hint(&self) -> Option<String> {
        match self {
            Self::Read { source, .. } if source.kind() == io::ErrorKind::NotFound => Some(
                "give the path of a scenario file, e.g. scenarios/intersection.xml; the settings of a run contain the path \
                 relative to the folder in which the run was started: change to that folder, or give --scenario"
                    .into(),
            ),
            Self::Read { source, .. } if source.kind() == io::ErrorKind::InvalidData => Some(
                "name the file's encoding in its first line, as in <?xml version=\"1.0\" encoding=\"ISO-8859-1\"?>".into(),
            ),
            Self::Unknown { parent, valid, .. } if !valid.is_empty() => {
                Some(format!("valid in {parent}: {}", valid.join(", ")))
            }
            Self::Invalid { hint, .. } => hint.map(Into::into),
            Self::Net { source, .. } | Self::Route { source, .. } => source.hint(),
            Self::Agents { min, max, .. } => Some(format!(
                "choose {min} to {max} agents, or write a scenario with a larger net and a larger `max` of <agents>"
            )),
            _ => None,
        }
    }
}
