//! Errors of scenario files. Messages begin with `path:line:column`, name the key and, if there is
//! a similar valid name, the name that was probably meant.

use std::{io, path::PathBuf};

use crate::sumo::net::{NetError, XmlError, did_you_mean};

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
    #[error("{}:{line}:{column}: cannot be read as XML", path.display())]
    Parse {
        /// The scenario file.
        path: PathBuf,
        /// Line, from 1.
        line: u32,
        /// Column, from 1.
        column: u32,
        /// Error of the XML parser.
        source: XmlError,
    },
    /// An element, attribute or text is not allowed at this place.
    #[error("{}:{line}:{column}: unknown {kind} `{key}` in {parent}{}", path.display(), did_you_mean(*nearest))]
    Unknown {
        /// The scenario file.
        path: PathBuf,
        /// Line, from 1.
        line: u32,
        /// Column, from 1.
        column: u32,
        /// `element`, `attribute` or `text`.
        kind: &'static str,
        /// Name of the element or attribute, or the text.
        key: String,
        /// Element that contains it, as `<agents>`.
        parent: Box<str>,
        /// Most similar valid name, if one is similar.
        nearest: Option<&'static str>,
        /// All names that are valid at this place.
        valid: &'static [&'static str],
    },
    /// A required element or attribute is missing.
    #[error("{}:{line}:{column}: <{parent}> lacks the {kind} `{key}`", path.display())]
    Missing {
        /// The scenario file.
        path: PathBuf,
        /// Line of the parent, from 1.
        line: u32,
        /// Column of the parent, from 1.
        column: u32,
        /// `element` or `attribute`.
        kind: &'static str,
        /// Name of the missing element or attribute.
        key: &'static str,
        /// Name of the parent element.
        parent: String,
    },
    /// Something that may occur once occurs twice.
    #[error("{}:{line}:{column}: a second {key}", path.display())]
    Duplicate {
        /// The scenario file.
        path: PathBuf,
        /// Line of the second occurrence, from 1.
        line: u32,
        /// Column of the second occurrence, from 1.
        column: u32,
        /// What occurs twice, as `element <agents>`.
        key: String,
    },
    /// There are more elements of a kind than a scenario may have.
    #[error("{}:{line}:{column}: more than {limit} elements <{element}>", path.display())]
    TooMany {
        /// The scenario file.
        path: PathBuf,
        /// Line of the first element beyond the limit, from 1.
        line: u32,
        /// Column, from 1.
        column: u32,
        /// Name of the element.
        element: String,
        /// Largest number of elements.
        limit: usize,
    },
    /// An attribute's value cannot be read or is out of range.
    #[error("{}:{line}:{column}: `{value}` is not a valid {key} of <{element}>, allowed: {allowed}", path.display())]
    Value {
        /// The scenario file.
        path: PathBuf,
        /// Line, from 1.
        line: u32,
        /// Column, from 1.
        column: u32,
        /// Name of the element.
        element: String,
        /// Name of the attribute.
        key: &'static str,
        /// The value, shortened if long.
        value: String,
        /// Allowed values.
        allowed: String,
    },
    /// A spawn row names a route that the scenario does not have.
    #[error("{}:{line}:{column}: {key} `{value}` is not the id of a route{}", path.display(), did_you_mean(nearest.as_deref()))]
    Reference {
        /// The scenario file.
        path: PathBuf,
        /// Line, from 1.
        line: u32,
        /// Column, from 1.
        column: u32,
        /// Name of the attribute.
        key: &'static str,
        /// Id that is not found.
        value: String,
        /// Most similar route id, if one is similar.
        nearest: Option<String>,
    },
    /// A net file is missing or cannot be used.
    #[error("{}:{line}:{column}: file: the net cannot be used", path.display())]
    Net {
        /// The scenario file.
        path: PathBuf,
        /// Line, from 1.
        line: u32,
        /// Column, from 1.
        column: u32,
        /// Error of the net.
        source: Box<NetError>,
    },
    /// A route cannot be driven in one of the nets.
    #[error("{}:{line}:{column}: edges: the route `{route}` cannot be driven", path.display())]
    Route {
        /// The scenario file.
        path: PathBuf,
        /// Line, from 1.
        line: u32,
        /// Column, from 1.
        column: u32,
        /// Id of the route.
        route: String,
        /// Reason.
        source: Box<NetError>,
    },
    /// A spawn place, with the vehicle's length and the jitter, extends beyond its edge or beyond
    /// the finish line.
    #[error(
        "{}:{line}:{column}: spawn: the place at {pos} m of route `{route}` does not fit on edge `{edge}`: \
         it needs {half} m on both sides within 0 to {end} m", path.display()
    )]
    Place {
        /// The scenario file.
        path: PathBuf,
        /// Line, from 1.
        line: u32,
        /// Column, from 1.
        column: u32,
        /// Id of the route.
        route: String,
        /// Position of the place \[m\].
        pos: f64,
        /// Id of the edge.
        edge: String,
        /// Half the vehicle's length plus the longitudinal jitter \[m\].
        half: f64,
        /// Position up to which vehicles may begin: the end of the edge or the finish line \[m\].
        end: f64,
    },
    /// Two spawn places of one net are so close that vehicles could touch.
    #[error(
        "{}:{line}:{column}: spawn: the places at {first} m and {second} m of lane `{lane}` overlap: \
         vehicle and jitter need {needed} m", path.display()
    )]
    Overlap {
        /// The scenario file.
        path: PathBuf,
        /// Line of one of the spawn rows, from 1.
        line: u32,
        /// Column, from 1.
        column: u32,
        /// Id of the lane.
        lane: String,
        /// Position of the first place \[m\].
        first: f64,
        /// Position of the second place \[m\].
        second: f64,
        /// Smallest allowed distance between places \[m\].
        needed: f64,
    },
    /// The scenario does not accept the requested number of agents.
    #[error("{}: agents: {agents} is outside of {min} to {max}", path.display())]
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

impl Error {
    /// Returns the file with the error: the scenario file, or a file that it names.
    pub fn path(&self) -> &std::path::Path {
        match self {
            Self::Read { path, .. }
            | Self::TooLarge { path, .. }
            | Self::Parse { path, .. }
            | Self::Unknown { path, .. }
            | Self::Missing { path, .. }
            | Self::Duplicate { path, .. }
            | Self::TooMany { path, .. }
            | Self::Value { path, .. }
            | Self::Reference { path, .. }
            | Self::Net { path, .. }
            | Self::Route { path, .. }
            | Self::Place { path, .. }
            | Self::Overlap { path, .. }
            | Self::Agents { path, .. } => path,
        }
    }

    /// Returns line and column of the error, both from 1, if it has a position in the file.
    pub fn position(&self) -> Option<(u32, u32)> {
        match *self {
            Self::Parse { line, column, .. }
            | Self::Unknown { line, column, .. }
            | Self::Missing { line, column, .. }
            | Self::Duplicate { line, column, .. }
            | Self::TooMany { line, column, .. }
            | Self::Value { line, column, .. }
            | Self::Reference { line, column, .. }
            | Self::Net { line, column, .. }
            | Self::Route { line, column, .. }
            | Self::Place { line, column, .. }
            | Self::Overlap { line, column, .. } => Some((line, column)),
            Self::Read { .. } | Self::TooLarge { .. } | Self::Agents { .. } => None,
        }
    }

    /// Returns what the user can do about the error, unless the message already says it.
    #[must_use]
    pub fn hint(&self) -> Option<String> {
        match self {
            Self::Read { source, .. } if source.kind() == io::ErrorKind::NotFound => {
                Some(
                    "give the path of a scenario file, as scenarios/intersection.xml; a run names its own from the folder in which it was \
                     begun: go there, or give --scenario"
                        .into(),
                )
            }
            Self::Unknown { parent, valid, .. } if !valid.is_empty() => {
                Some(format!("valid in {parent}: {}", valid.join(", ")))
            }
            Self::Missing { .. } => Some("scenarios/intersection.xml shows every element and attribute, scenarios/intersection_turns.xml those of steering".into()),
            Self::Net { source, .. } | Self::Route { source, .. } => source.hint(),
            Self::Place { .. } | Self::Overlap { .. } => {
                Some("move the places, lower their number, or make the longitudinal jitter smaller".into())
            }
            Self::Agents { min, max, .. } => Some(format!(
                "ask for {min} to {max} agents, or write a scenario with a larger net and a larger `max` of <agents>"
            )),
            _ => None,
        }
    }
}
