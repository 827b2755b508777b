//! What can be wrong with a net or a route through it, and how messages name things.

use std::{io, path::PathBuf};

use super::XmlError;

/// Why a net cannot be read or a route cannot be laid through it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum NetError {
    /// The file does not exist or cannot be read as text.
    #[error("{}: cannot read the net", path.display())]
    Read {
        /// The net file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The file is larger than this program reads.
    #[error("{}: the net is larger than {limit} bytes", path.display())]
    TooLarge {
        /// The net file.
        path: PathBuf,
        /// Largest size \[bytes\].
        limit: u64,
    },
    /// The file is not XML, or not XML that is read.
    #[error("{}:{line}:{column}: cannot be read as XML", path.display())]
    Xml {
        /// The net file.
        path: PathBuf,
        /// Line, from 1.
        line: u32,
        /// Column, from 1.
        column: u32,
        /// What is wrong with it.
        source: XmlError,
    },
    /// The file is XML, but no net.
    #[error("{}:{line}:{column}: expected the element <net>, found <{found}>", path.display())]
    NotNet {
        /// The net file.
        path: PathBuf,
        /// Line, from 1.
        line: u32,
        /// Column, from 1.
        column: u32,
        /// Name of the root element.
        found: String,
    },
    /// An element or attribute that a net needs is not there.
    #[error("{}:{line}:{column}: <{element}> lacks {what}", path.display())]
    Missing {
        /// The net file.
        path: PathBuf,
        /// Line, from 1.
        line: u32,
        /// Column, from 1.
        column: u32,
        /// Element that lacks something.
        element: String,
        /// What it lacks.
        what: String,
    },
    /// An attribute has a value that it cannot have.
    #[error("{}:{line}:{column}: `{value}` is not a valid {key} of <{element}>, allowed: {allowed}", path.display())]
    Value {
        /// The net file.
        path: PathBuf,
        /// Line, from 1.
        line: u32,
        /// Column, from 1.
        column: u32,
        /// Element.
        element: String,
        /// Attribute.
        key: String,
        /// The value, shortened if long.
        value: String,
        /// What it may be.
        allowed: &'static str,
    },
    /// A connection names an edge or lane that the net does not have.
    #[error("{}:{line}:{column}: {key}=`{value}` names nothing in this net{}", path.display(), did_you_mean(nearest.as_deref()))]
    Reference {
        /// The net file.
        path: PathBuf,
        /// Line, from 1.
        line: u32,
        /// Column, from 1.
        column: u32,
        /// Attribute.
        key: String,
        /// The id or lane number.
        value: String,
        /// An id that the net has and that looks like it.
        nearest: Option<String>,
    },
    /// An id occurs twice.
    #[error("{}:{line}:{column}: a second {kind} with the id `{id}`", path.display())]
    Duplicate {
        /// The net file.
        path: PathBuf,
        /// Line, from 1.
        line: u32,
        /// Column, from 1.
        column: u32,
        /// `edge`, `lane` or `junction`.
        kind: &'static str,
        /// The id.
        id: String,
    },
    /// A route has no edge, or no extent.
    #[error("{}: a route needs at least one edge of some length", path.display())]
    EmptyRoute {
        /// The net file.
        path: PathBuf,
    },
    /// A route names an edge that the net does not have.
    #[error("{}: the net has no edge `{edge}`{}", path.display(), did_you_mean(nearest.as_deref()))]
    NoEdge {
        /// The net file.
        path: PathBuf,
        /// The id.
        edge: String,
        /// An edge that the net has and that looks like it.
        nearest: Option<String>,
    },
    /// A route names an edge that is a part of a junction or for others than vehicles.
    #[error("{}: the edge `{edge}` is no road that a route can name", path.display())]
    NotRoad {
        /// The net file.
        path: PathBuf,
        /// The id.
        edge: String,
    },
    /// No lane of an edge leads to the route's next edge.
    #[error("{}: the edge `{from}` does not lead to `{to}`", path.display())]
    NotConnected {
        /// The net file.
        path: PathBuf,
        /// Edge.
        from: String,
        /// The route's next edge.
        to: String,
    },
    /// No way leads from one edge of a trip to another without changing lanes.
    #[error("{}: no way leads from the edge `{from}` to `{to}` that can be driven without changing lanes", path.display())]
    NoTrip {
        /// The net file.
        path: PathBuf,
        /// First edge.
        from: String,
        /// Last edge.
        to: String,
    },
    /// A walk names an edge without a lane for pedestrians.
    #[error("{}: nobody can walk along the edge `{edge}`: build the net with sidewalks (netconvert --sidewalks.guess)", path.display())]
    NoSidewalk {
        /// The net file.
        path: PathBuf,
        /// The id.
        edge: String,
    },
    /// A walk begins or ends beyond the end of its edge.
    #[error("{}: {position} m is not on the edge `{edge}`, which is {length} m long", path.display())]
    OffEdge {
        /// The net file.
        path: PathBuf,
        /// The id.
        edge: String,
        /// From the edge's beginning \[m\].
        position: f64,
        /// \[m\]
        length: f64,
    },
    /// No walking areas and crossings lead from an edge of a walk to the next, other than by turning round.
    #[error("{}: no way on foot leads from the edge `{from}` straight to `{to}`: build the net with crossings (netconvert --crossings.guess, or <crossing> in its connections), or name the edges between them", path.display())]
    NotWalkable {
        /// The net file.
        path: PathBuf,
        /// Edge.
        from: String,
        /// The walk's next edge.
        to: String,
    },
    /// Consecutive edges are connected, but only by changing lanes on the way, which a centre line cannot show.
    #[error("{}: the route `{route}` needs a lane change", path.display())]
    LaneChange {
        /// The net file.
        path: PathBuf,
        /// The route's edges, shortened if many.
        route: String,
    },
    /// The lanes of a route have more points than this program keeps.
    #[error("{}: a route of {points} points is longer than the {limit} that are allowed", path.display())]
    LongRoute {
        /// The net file.
        path: PathBuf,
        /// Points of its lanes.
        points: usize,
        /// Most.
        limit: usize,
    },
}

impl NetError {
    /// What the user may do about it, where that is not plain from the message.
    #[must_use]
    pub fn hint(&self) -> Option<String> {
        match self {
            Self::Read { source, .. } if source.kind() == io::ErrorKind::NotFound => {
                Some("build the net (`iwol scenario build`), or correct the file name".into())
            }
            Self::Read { path, .. } if path.extension().is_some_and(|e| e == "gz") => {
                Some("compressed nets are not read; unpack it with gunzip".into())
            }
            Self::NotNet { .. } => {
                Some("give the .net.xml that netconvert writes, not its sources".into())
            }
            Self::Reference { .. }
            | Self::Duplicate { .. }
            | Self::Missing { .. }
            | Self::Value { .. } => {
                Some("build the net again with netconvert rather than editing it by hand".into())
            }
            Self::LaneChange { .. } => {
                Some("split the route, or connect the lanes that it uses".into())
            }
            _ => None,
        }
    }
}

/// The one of `valid` that `name` was most likely meant to be, if any is close; ties go to the first in order of letters.
pub(crate) fn nearest<'v>(name: &str, valid: impl Iterator<Item = &'v str>) -> Option<&'v str> {
    let letters = name.chars().count();
    if letters > 100 {
        return None;
    }
    let within = (letters / 3).max(2);
    let similar = valid
        .filter(|v| v.len() <= 400 && v.chars().count().abs_diff(letters) <= within)
        .map(|v| (strsim::osa_distance(name, v), v));
    similar.filter(|&(distance, _)| distance <= within).min().map(|(_, v)| v)
}

/// A value for a message: at most 80 characters, control characters escaped.
pub(crate) fn shorten(value: &str) -> String {
    let mut short: String = value.chars().take(80).flat_map(char::escape_debug).collect();
    if value.chars().nth(80).is_some() {
        short.push('…');
    }
    short
}

/// The end of a message: the name that was probably meant.
pub(crate) fn did_you_mean(nearest: Option<&str>) -> String {
    nearest.map_or_else(String::new, |name| format!("; did you mean `{}`?", shorten(name)))
}
