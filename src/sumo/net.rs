//! Reader of SUMO's `.net.xml` files: lanes, edges, junctions and connections, and the paths of
//! routes.
//!
//! A net file is untrusted input. For any content, [`Net::load`] returns either a net in which all
//! references resolve, or an error that names file, line and column. Elements that this program
//! does not need, such as types of edges, are skipped. A net may be
//! compressed (`.net.xml.gz`), and in any encoding that it declares.
//!
//! Units are SI units, coordinates are those of the net file, and angles are radians
//! counter-clockwise from +x.

mod classes;
mod cut;
mod error;
mod foes;
mod path;
mod programs;
mod read;
mod route;
mod tile;
mod traffic_light;
mod trip;
mod walk;
pub(crate) mod xml;

use std::{
    collections::HashMap,
    ops::Range,
    path::{Path as FilePath, PathBuf},
};

pub use classes::{CARS, Classes, PEDESTRIANS, class_of_sumo};
pub(crate) use cut::cut;
pub use error::{NetError, Problem};
pub(crate) use error::{did_you_mean, nearest, shorten};
pub use foes::Foes;
pub use path::Path;
pub(crate) use programs::with_programs;
pub use tile::{Tiled, tile, tiled_id};
pub use traffic_light::{Aspect, Phase, Signal, TrafficLight};
pub use walk::Walk;
pub use xml::XmlError;

/// Width of a lane for which the file gives no width \[m\].
pub const DEFAULT_LANE_WIDTH: f64 = 3.2;

/// Maximum number of points of all lanes of a route together.
const MAX_POINTS: usize = 1 << 16;

/// Difference between a lane's length and the length of its shape that can be netconvert's
/// rounding \[m\].
const ROUNDING: f64 = 0.05;
/// Length that netconvert gives to lanes without any \[m\].
const SHORTEST: f64 = 0.1;

/// A road network.
#[derive(Debug, Clone, PartialEq)]
pub struct Net {
    /// The file that the net was read from.
    pub path: PathBuf,
    /// All lanes. Those of one edge are adjacent, in the order of [`Lane::index`].
    pub lanes: Vec<Lane>,
    /// All edges, including internal ones.
    pub edges: Vec<Edge>,
    /// All junctions.
    pub junctions: Vec<Junction>,
    /// All lane-to-lane connections.
    pub connections: Vec<Connection>,
    /// Roundabouts.
    pub roundabouts: Vec<Roundabout>,
    /// Traffic lights.
    pub traffic_lights: Vec<TrafficLight>,
    /// Lower left and upper right corner of the net \[m\].
    pub boundary: [[f64; 2]; 2],
    /// Whether vehicles drive on the left. Lanes are then counted from the left, too.
    pub left_hand: bool,
    /// Lanes that SUMO compares when it looks for collisions.
    pub foes: Foes,
    edge_by_id: HashMap<String, usize>,
    /// Indices into `connections`, for each lane from which they start.
    leaving: Vec<Vec<usize>>,
}

/// A lane.
#[derive(Debug, Clone, PartialEq)]
pub struct Lane {
    /// SUMO id.
    pub id: String,
    /// Index into [`Net::edges`].
    pub edge: usize,
    /// Index on its edge, from the right (in a left-hand net from the left), starting at 0.
    pub index: u32,
    /// Speed limit \[m/s\].
    pub speed: f64,
    /// Length as SUMO counts it \[m\]; it may differ from the length of the shape.
    pub length: f64,
    /// Width \[m\].
    pub width: f64,
    /// Centre line in driving direction, at least two points \[m\].
    pub shape: Vec<[f64; 2]>,
    /// Height of each point of the shape \[m\]; empty if the file gives none.
    pub heights: Vec<f64>,
    /// Vehicle classes that may use the lane.
    pub classes: Classes,
}

impl Lane {
    /// Whether the lane is for pedestrians and not for cars.
    pub fn is_sidewalk(&self) -> bool {
        self.classes.contain(PEDESTRIANS) && !self.classes.contain(CARS)
    }

    /// Returns SUMO's metres along the lane per metre of its shape, at least 1. The positions of
    /// places that lie a number of metres apart on the shape, and in SUMO, are so much further
    /// apart. Differences that are netconvert's rounding count as none, and so does the length that
    /// it gives to a lane without any.
    pub fn stretch(&self) -> f64 {
        let metres = self
            .shape
            .windows(2)
            .map(|w| (w[1][0] - w[0][0]).hypot(w[1][1] - w[0][1]))
            .sum::<f64>();
        let is_point = metres < SHORTEST && self.length < SHORTEST + ROUNDING;
        if self.length - metres < ROUNDING || is_point { 1.0 } else { self.length / metres }
    }
}

/// The function of an edge.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum EdgeFunction {
    /// A road.
    Normal,
    /// A path of vehicles across a junction.
    Internal,
    /// A crossing, where pedestrians cross a road.
    Crossing,
    /// A walking area, which connects sidewalks and crossings.
    WalkingArea,
    /// Any other function, such as `connector`.
    Other,
}

/// An edge: the lanes of one direction between two junctions.
#[derive(Debug, Clone, PartialEq)]
pub struct Edge {
    /// SUMO id.
    pub id: String,
    /// Id of the junction at its start; `None` for internal edges.
    pub from: Option<String>,
    /// Id of the junction at its end; `None` for internal edges.
    pub to: Option<String>,
    /// Function of the edge.
    pub function: EdgeFunction,
    /// Edge of the opposite direction on the same strip of road (SUMO's `bidi`), index into
    /// [`Net::edges`].
    pub bidi: Option<usize>,
    /// Range of its lanes in [`Net::lanes`]; never empty.
    pub lanes: Range<usize>,
}

/// A roundabout.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Roundabout {
    /// Ids of its junctions.
    pub junctions: Vec<String>,
    /// Ids of its edges.
    pub edges: Vec<String>,
}

/// A junction.
#[derive(Debug, Clone, PartialEq)]
pub struct Junction {
    /// SUMO id.
    pub id: String,
    /// SUMO type, such as `right_before_left` or `priority`.
    pub kind: String,
    /// Position, x \[m\].
    pub x: f64,
    /// Position, y \[m\].
    pub y: f64,
    /// Outline \[m\]; empty if the file gives none.
    pub shape: Vec<[f64; 2]>,
}

impl Junction {
    /// Whether SUMO knows of no conflicts in the junction and does not look for collisions there.
    pub fn is_unregulated(&self) -> bool {
        ["unregulated", "traffic_light_unregulated"].contains(&self.kind.as_str())
    }
}

/// A connection from one lane to the next.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Connection {
    /// Lane at its start, index into [`Net::lanes`].
    pub from: usize,
    /// Lane at its end, index into [`Net::lanes`].
    pub to: usize,
    /// Internal lane across the junction, index into [`Net::lanes`]; `None` if the net was built
    /// without internal lanes.
    pub via: Option<usize>,
    /// Direction in SUMO's notation: `s` straight, `l` left, `r` right, `t` U-turn, ...; empty if
    /// the file gives none.
    pub dir: String,
    /// Signal that vehicles obey at the end of the lane `from`; `None` if there is none.
    pub signal: Option<Signal>,
    /// Vehicle classes that may use the connection and its internal lanes.
    pub classes: Classes,
}

impl Net {
    /// Reads a net file.
    ///
    /// # Errors
    /// [`NetError`] if the file cannot be read, is not a net, or refers to edges and lanes that it
    /// does not contain.
    pub fn load(path: &FilePath) -> Result<Self, NetError> {
        Self::parse(&Self::text(path)?, path)
    }

    /// Returns the lower left and the upper right corner of the bounding box of the boundary, all
    /// lanes and all junctions \[m\].
    pub fn extent(&self) -> [[f64; 2]; 2] {
        let shapes = self
            .lanes
            .iter()
            .flat_map(|l| &l.shape)
            .chain(self.junctions.iter().flat_map(|j| &j.shape));
        let points = self
            .boundary
            .iter()
            .chain(shapes)
            .copied()
            .chain(self.junctions.iter().map(|j| [j.x, j.y]));
        points.fold([[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]], |[low, high], p| {
            [[low[0].min(p[0]), low[1].min(p[1])], [high[0].max(p[0]), high[1].max(p[1])]]
        })
    }

    /// Returns the index of an edge in [`Net::edges`].
    pub fn edge_index(&self, id: &str) -> Option<usize> {
        self.edge_by_id.get(id).copied()
    }

    /// Returns the connections that start from a lane, given by its index in [`Net::lanes`].
    pub fn connections_from(&self, lane: usize) -> impl Iterator<Item = &Connection> + '_ {
        self.leaving.get(lane).into_iter().flatten().map(|&c| &self.connections[c])
    }

    /// Returns the net as it is in a mirror that swaps left and right.
    #[must_use]
    pub fn mirrored(&self) -> Self {
        let mut net = self.clone();
        let shapes = net.lanes.iter_mut().map(|lane| &mut lane.shape);
        let outlines = net.junctions.iter_mut().map(|junction| &mut junction.shape);
        shapes.chain(outlines).flatten().for_each(|[_, y]| *y = -*y);
        net.junctions.iter_mut().for_each(|junction| junction.y = -junction.y);
        net.boundary = self.boundary.map(|[x, y]| [x, -y]);
        let [[_, low], [_, high]] = &mut net.boundary;
        std::mem::swap(low, high);
        net.left_hand = !self.left_hand;
        net
    }

    /// Returns the road with this id, which each of `classes` may use.
    fn edge_for(&self, id: &str, classes: &[&str]) -> Result<&Edge, NetError> {
        let Some(edge) = self.edge_index(id).map(|i| &self.edges[i]) else {
            return Err(self.no_edge(id, self.roads()));
        };
        if edge.function != EdgeFunction::Normal {
            return Err(self.error(Problem::NotRoad { edge: shorten(id) }));
        }
        let closed = |class: &&&str| {
            !self.lanes[edge.lanes.clone()].iter().any(|lane| lane.classes.contain(class))
        };
        if let Some(class) = classes.iter().find(closed) {
            let (edge, class) = (shorten(id), shorten(class));
            return Err(self.error(Problem::NotAllowed { edge, class }));
        }
        Ok(edge)
    }

    /// Returns the error for an edge that the net does not have; `valid` are those that could be
    /// meant.
    fn no_edge<'e>(&self, id: &str, valid: impl Iterator<Item = &'e Edge>) -> NetError {
        let nearest = nearest(id, valid.map(|edge| edge.id.as_str())).map(Into::into);
        self.error(Problem::NoEdge { edge: shorten(id), nearest })
    }

    /// Returns the error for a route or walk through this net.
    fn error(&self, problem: Problem) -> NetError {
        NetError { path: self.path.clone(), place: None, problem }
    }

    /// Whether an edge is outside of junctions and cars may use it.
    fn is_road(&self, edge: &Edge) -> bool {
        edge.function == EdgeFunction::Normal
            && self.lanes[edge.lanes.clone()].iter().any(|lane| lane.classes.contain(CARS))
    }

    /// Returns the lanes of an edge without the sidewalks on both sides.
    pub fn carriageway(&self, edge: &Edge) -> Range<usize> {
        let mut lanes = edge.lanes.clone();
        while lanes.len() > 1 && self.lanes[lanes.start].is_sidewalk() {
            lanes.start += 1;
        }
        while lanes.len() > 1 && self.lanes[lanes.end - 1].is_sidewalk() {
            lanes.end -= 1;
        }
        lanes
    }

    /// Returns the edges that the route of a car may contain.
    pub fn roads(&self) -> impl Iterator<Item = &Edge> {
        self.edges.iter().filter(|edge| self.is_road(edge))
    }
}

#[cfg(test)]
mod tests;
