//! A road network before netconvert builds it: SUMO's plain XML, and the routes through it.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;

use super::super::{Route, write::escape};

/// Width of every lane \[m\].
pub(super) const LANE_WIDTH: f64 = 3.5;
/// Location of SUMO's schemas, for editors.
const XSD: &str = "http://sumo.dlr.de/xsd";

/// Nodes, edges and connections of a network, and the routes through it.
#[derive(Debug, Default)]
pub(super) struct Plan {
    pub(super) nodes: Vec<Node>,
    pub(super) edges: Vec<Edge>,
    pub(super) links: Vec<Link>,
    /// Ids of the nodes and edges of a roundabout.
    pub(super) ring: Option<(Vec<String>, Vec<String>)>,
    pub(super) routes: Vec<Route>,
    /// Edges whose first spawn place is further ahead than on other edges, and by how much \[m\].
    pub(super) ahead: BTreeMap<String, f64>,
    /// Edges with only one spawn place.
    pub(super) single: BTreeSet<String>,
    pub(super) spaces: Vec<Space>,
    /// Whether the site is a parking lot, in which vehicles always steer and can reverse.
    pub(super) lot: bool,
}

#[derive(Debug)]
pub(super) struct Node {
    pub(super) id: String,
    /// Position \[m\].
    pub(super) at: [f64; 2],
    /// SUMO's type of junction.
    pub(super) kind: &'static str,
    /// Outline \[m\]; empty: netconvert computes it.
    pub(super) shape: Vec<[f64; 2]>,
}

#[derive(Debug)]
pub(super) struct Edge {
    pub(super) id: String,
    pub(super) from: String,
    pub(super) to: String,
    pub(super) lanes: u32,
    /// Points between the ends \[m\]; empty: straight.
    pub(super) shape: Vec<[f64; 2]>,
    /// Whether the lanes lie on both sides of the edge's line instead of to the right of it.
    pub(super) centred: bool,
}

/// A connection from a lane to a lane of the next edge.
#[derive(Debug)]
pub(super) struct Link {
    pub(super) from: String,
    pub(super) to: String,
    pub(super) lanes: [u32; 2],
    /// Path from one lane to the other \[m\]; empty: netconvert computes it.
    pub(super) shape: Vec<[f64; 2]>,
}

/// A parking space.
#[derive(Debug)]
pub(super) struct Space {
    pub(super) id: String,
    /// Edge into the space, with one lane.
    pub(super) edge: String,
    /// Length of this edge \[m\].
    pub(super) depth: f64,
}

impl Plan {
    pub(super) fn node(
        &mut self,
        id: impl Into<String>,
        at: [f64; 2],
        kind: &'static str,
    ) -> &mut Node {
        self.nodes.push(Node { id: id.into(), at, kind, shape: Vec::new() });
        self.nodes.last_mut().expect("just added")
    }

    pub(super) fn edge(
        &mut self,
        id: impl Into<String>,
        [from, to]: [&str; 2],
        lanes: u32,
    ) -> &mut Edge {
        let (id, from, to) = (id.into(), from.into(), to.into());
        self.edges.push(Edge { id, from, to, lanes, shape: Vec::new(), centred: false });
        self.edges.last_mut().expect("just added")
    }

    pub(super) fn link(&mut self, from: &str, to: &str, lanes: [u32; 2]) {
        self.links.push(Link { from: from.into(), to: to.into(), lanes, shape: Vec::new() });
    }

    /// Connects the rightmost lanes of two edges by a path through the given points \[m\].
    pub(super) fn connection(&mut self, from: &str, to: &str, shape: Vec<[f64; 2]>) {
        self.links.push(Link { from: from.into(), to: to.into(), lanes: [0, 0], shape });
    }

    /// Adds a route on each of `lanes` lanes. If there are several, the lane's index is appended to
    /// the id.
    pub(super) fn route(&mut self, id: &str, edges: &[String], lanes: u32) {
        for lane in 0..lanes {
            let (id, lane) = if lanes > 1 {
                (format!("{id}_{lane}"), Some(lane))
            } else {
                (id.to_owned(), None)
            };
            self.routes.push(Route {
                id,
                edges: edges.to_vec(),
                lane,
                arrival_pos: -5.0,
                reserved: false,
                off_lane: 1.0,
            });
        }
    }

    /// Returns the sources as file endings and texts. Roads have `lanes` lanes and the limit
    /// `speed` \[m/s\] by default.
    pub(super) fn sources(&self, lanes: u32, speed: f64) -> [(&'static str, String); 4] {
        let mut nodes = opening(
            "nodes",
            "Junctions: where they are, their shape [m], and who gives way. `unregulated` is not advised: SUMO sees no collisions there.",
        );
        for Node { id, at, kind, shape } in &self.nodes {
            let ([x, y], id, shape) = (at.map(centimetres), escape(id), outline(shape));
            let _ = writeln!(
                nodes,
                "    <node id=\"{id}\" x=\"{x}\" y=\"{y}\" type=\"{kind}\"{shape}/>"
            );
        }
        let mut edges = opening(
            "edges",
            "Roads from junction to junction, one for each direction; numLanes, speed [m/s], shape [m] and spreadType may be given here too.",
        );
        for Edge { id, from, to, lanes: own, shape, centred } in &self.edges {
            let _ = write!(
                edges,
                "    <edge id=\"{}\" from=\"{from}\" to=\"{to}\" type=\"street\"",
                escape(id)
            );
            if *own != lanes {
                let _ = write!(edges, " numLanes=\"{own}\"");
            }
            if *centred {
                let _ = write!(edges, " spreadType=\"center\"");
            }
            let _ = writeln!(edges, "{}/>", outline(shape));
        }
        if let Some((nodes, paths)) = &self.ring {
            let _ = writeln!(
                edges,
                "    <roundabout nodes=\"{}\" edges=\"{}\"/>",
                nodes.join(" "),
                paths.join(" ")
            );
        }
        let mut links = opening(
            "connections",
            "Which lane leads to which, counted from the right and starting at 0; a shape [m] is the path of the vehicles there.",
        );
        for Link { from, to, lanes: [a, b], shape } in &self.links {
            let shape = outline(shape);
            let _ = writeln!(
                links,
                "    <connection from=\"{from}\" to=\"{to}\" fromLane=\"{a}\" toLane=\"{b}\"{shape}/>"
            );
        }
        let mut types = opening(
            "types",
            "What all roads have in common: lanes, speed limit [m/s], width of a lane [m].",
        );
        let _ = writeln!(
            types,
            "    <type id=\"street\" priority=\"1\" numLanes=\"{lanes}\" speed=\"{speed}\" width=\"{LANE_WIDTH}\"/>"
        );
        let end = |text: String, name: &str| format!("{text}</{name}>\n");
        [
            ("nod.xml", end(nodes, "nodes")),
            ("edg.xml", end(edges, "edges")),
            ("con.xml", end(links, "connections")),
            ("typ.xml", end(types, "types")),
        ]
    }

    /// Returns the spaces as parking areas in a SUMO additional file, or `None` if there are no
    /// spaces.
    pub(super) fn additional(&self) -> Option<String> {
        let mut text = format!(
            "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<!-- The spaces, for SUMO alone: `iwol` does not read this file. -->\n\
             <additional xmlns:xsi=\"http://www.w3.org/2001/XMLSchema-instance\" xsi:noNamespaceSchemaLocation=\"{XSD}/additional_file.xsd\">\n"
        );
        for Space { id, edge, depth } in &self.spaces {
            let _ = writeln!(
                text,
                "    <parkingArea id=\"{id}\" lane=\"{edge}_0\" startPos=\"1\" endPos=\"{depth}\" roadsideCapacity=\"1\" onRoad=\"true\"/>"
            );
        }
        (!self.spaces.is_empty()).then(|| text + "</additional>\n")
    }
}

/// Returns points as an attribute, without repetitions, or an empty string if there are none.
fn outline(points: &[[f64; 2]]) -> String {
    let mut points: Vec<[f64; 2]> = points.iter().map(|point| point.map(centimetres)).collect();
    points.dedup();
    let points: Vec<String> = points.into_iter().map(|[x, y]| format!("{x},{y}")).collect();
    if points.is_empty() { String::new() } else { format!(" shape=\"{}\"", points.join(" ")) }
}

/// Rounds to centimetres, without negative zeros.
fn centimetres(metres: f64) -> f64 {
    (100.0 * metres).round() / 100.0 + 0.0
}

/// Returns the beginning of a source file.
fn opening(root: &str, comment: &str) -> String {
    format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<!-- {comment}\n     After a change: iwol scenario build. -->\n\
         <{root} xmlns:xsi=\"http://www.w3.org/2001/XMLSchema-instance\" xsi:noNamespaceSchemaLocation=\"{XSD}/{root}_file.xsd\">\n"
    )
}
