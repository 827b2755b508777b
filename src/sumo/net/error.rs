//! Errors of nets and of routes through them, and how their messages show names.

use std::{error::Error, fmt, io, path::PathBuf};

use super::XmlError;

/// A reason why a net cannot be read or a route cannot be built on it.
#[derive(Debug)]
pub struct NetError {
    /// The net file.
    pub path: PathBuf,
    /// Line and column in the file, from 1, where the problem has a place there.
    pub place: Option<(u32, u32)>,
    /// What is wrong.
    pub problem: Problem,
}

impl fmt::Display for NetError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.path.display())?;
        if let Some((line, column)) = self.place {
            write!(f, ":{line}:{column}")?;
        }
        write!(f, ": {}", self.problem)
    }
}

impl Error for NetError {
    fn source(&self) -> Option<&(dyn Error + 'static)> {
        self.problem.source()
    }
}

/// What is wrong with a net, or with a route through it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Problem {
    /// The file does not exist or cannot be read as text.
    #[error("cannot read the net")]
    Read {
        /// The operating system's reason.
        source: io::Error,
    },
    /// The file is larger than this program reads.
    #[error("the net is larger than {limit} bytes")]
    TooLarge {
        /// Largest size \[bytes\].
        limit: u64,
    },
    /// The file is not XML, or uses XML that this program does not read.
    #[error("cannot be read as XML")]
    Xml {
        /// The parser's reason.
        source: XmlError,
    },
    /// The file is XML, but not a net.
    #[error("expected the element <net>, found <{found}>")]
    NotNet {
        /// Name of the root element.
        found: String,
    },
    /// A required element or attribute is missing.
    #[error("<{element}> lacks {what}")]
    Missing {
        /// Element in which something is missing.
        element: String,
        /// The missing element or attribute.
        what: String,
    },
    /// An attribute has a value that is not allowed.
    #[error("`{value}` is not a valid {key} of <{element}>, allowed: {allowed}")]
    Value {
        /// Element.
        element: String,
        /// Attribute.
        key: String,
        /// The value, shortened if long.
        value: String,
        /// Allowed values.
        allowed: &'static str,
    },
    /// A connection names an edge or lane that the net does not have.
    #[error("{key}=`{value}` names nothing in this net{}", did_you_mean(nearest.as_deref()))]
    Reference {
        /// Attribute.
        key: String,
        /// The id or lane number.
        value: String,
        /// A similar id that the net has.
        nearest: Option<String>,
    },
    /// An id occurs twice.
    #[error("a second {kind} with the id `{id}`")]
    Duplicate {
        /// `edge`, `lane` or `junction`.
        kind: &'static str,
        /// The id.
        id: String,
    },
    /// A route has no edge or no length.
    #[error("a route needs at least one edge of some length")]
    EmptyRoute,
    /// A route names an edge that the net does not have.
    #[error("the net has no edge `{edge}`{}", did_you_mean(nearest.as_deref()))]
    NoEdge {
        /// The unknown id.
        edge: String,
        /// A similar edge that the net has.
        nearest: Option<String>,
    },
    /// A route names an edge that is part of a junction.
    #[error("the edge `{edge}` is not a road, so no route can name it")]
    NotRoad {
        /// The id.
        edge: String,
    },
    /// A route names an edge that vehicles of a class may not use.
    #[error("vehicles of class `{class}` may not use the edge `{edge}`")]
    NotAllowed {
        /// The id.
        edge: String,
        /// SUMO's vehicle class.
        class: String,
    },
    /// A trip names a junction that the net does not have, or that has no road of the direction
    /// that the trip needs.
    #[error("the net has no junction `{junction}` with a road {direction} it{}", did_you_mean(nearest.as_deref()))]
    NoJunction {
        /// The id.
        junction: String,
        /// `from` or `to`.
        direction: &'static str,
        /// A similar junction that the net has.
        nearest: Option<String>,
    },
    /// The connections from an edge to the route's next edge are closed to a class of its vehicles.
    #[error(
        "no connection from the edge `{from}` to `{to}` is open to vehicles of class `{classes}`"
    )]
    Closed {
        /// Edge.
        from: String,
        /// The route's next edge.
        to: String,
        /// SUMO's vehicle classes, separated by spaces.
        classes: String,
    },
    /// No lane of an edge leads to the route's next edge.
    #[error("the edge `{from}` does not lead to `{to}`")]
    NotConnected {
        /// Edge.
        from: String,
        /// The route's next edge.
        to: String,
    },
    /// No route connects the edges of a trip.
    #[error("no route leads from the edge `{from}` to `{to}`")]
    NoTrip {
        /// First edge.
        from: String,
        /// Last edge.
        to: String,
    },
    /// A walk names an edge without a lane for pedestrians.
    #[error(
        "pedestrians cannot walk along the edge `{edge}`: build the net with sidewalks (netconvert --sidewalks.guess)"
    )]
    NoSidewalk {
        /// The id.
        edge: String,
    },
    /// A walk begins or ends beyond the end of its edge.
    #[error("{position} m is not on the edge `{edge}`, which is {length} m long")]
    OffEdge {
        /// The id.
        edge: String,
        /// Position from the start of the edge \[m\].
        position: f64,
        /// Length of the edge \[m\].
        length: f64,
    },
    /// Two consecutive edges of a walk are not connected by walking areas and crossings, except by
    /// turning round.
    #[error(
        "no walk leads from the edge `{from}` straight to `{to}`: name the edges between them, since walks are not routed here as SUMO routes them (SUMO's duarouter writes routed walks), or build the net with crossings (netconvert --crossings.guess, or <crossing> in its connections) if it has none"
    )]
    NotWalkable {
        /// Edge.
        from: String,
        /// The walk's next edge.
        to: String,
    },
    /// Consecutive edges are connected, but only with lane changes between them.
    #[error("the route `{route}` needs a lane change")]
    LaneChange {
        /// The route's edges, shortened if many.
        route: String,
    },
    /// The lanes of a route have more points than this program allows.
    #[error("a route of {points} points is longer than the {limit} that are allowed")]
    LongRoute {
        /// Number of points of the route's lanes.
        points: usize,
        /// Greatest number of points.
        limit: usize,
    },
}

impl NetError {
    /// Returns advice for the user, where the message alone does not suggest what to do.
    #[must_use]
    pub fn hint(&self) -> Option<String> {
        Some(match &self.problem {
            Problem::Read { source } if source.kind() == io::ErrorKind::NotFound => {
                "build the net (`iwol scenario build`), or correct the file name".into()
            }
            Problem::Read { source } if source.kind() == io::ErrorKind::InvalidData => {
                "name the file's encoding in its first line, as in <?xml version=\"1.0\" encoding=\"ISO-8859-1\"?>".into()
            }
            Problem::NotNet { .. } => {
                "give the .net.xml that netconvert writes, not its sources".into()
            }
            Problem::Reference { .. }
            | Problem::Duplicate { .. }
            | Problem::Missing { .. }
            | Problem::Value { .. } => {
                "build the net again with netconvert rather than editing it by hand".into()
            }
            Problem::NotAllowed { .. } | Problem::Closed { .. } => {
                "give the vType another vClass, or permit the class in the net (allow and disallow of lanes and connections)".into()
            }
            Problem::LaneChange { .. } => {
                "let agents change lanes (attribute laneChange of <control>), split the route, or connect the lanes that it uses".into()
            }
            _ => return None,
        })
    }
}

/// Returns the name in `valid` that `name` was most likely meant to be, if one is similar; among
/// equally similar names, one that differs only in upper and lower case, else the first in
/// alphabetical order.
pub(crate) fn nearest<'v>(name: &str, valid: impl Iterator<Item = &'v str>) -> Option<&'v str> {
    let letters = name.chars().count();
    if letters > 100 {
        return None;
    }
    let within = (letters / 3).max(2);
    let similar = valid
        .filter(|v| v.len() <= 400 && v.chars().count().abs_diff(letters) <= within)
        .map(|v| (strsim::osa_distance(name, v), !v.eq_ignore_ascii_case(name), v));
    let similar = similar.filter(|&(distance, other, _)| distance <= within || !other);
    similar
        .min_by_key(|&(distance, other, v)| (if other { distance } else { 1 }, other, v))
        .map(|(.., v)| v)
}

/// Formats a value for a message: at most 80 characters, with control characters escaped.
pub(crate) fn shorten(value: &str) -> String {
    let mut short: String = value.chars().take(80).flat_map(char::escape_debug).collect();
    if value.chars().nth(80).is_some() {
        short.push('…');
    }
    short
}

/// Returns the end of a message that suggests a name.
pub(crate) fn did_you_mean(nearest: Option<&str>) -> String {
    nearest.map_or_else(String::new, |name| format!("; did you mean `{}`?", shorten(name)))
}
