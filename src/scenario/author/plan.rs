//! A road network before netconvert builds it: SUMO's plain XML, and the routes through it.

use std::collections::{BTreeMap, BTreeSet};

use super::super::Route;
use crate::markup::Writer;

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
            "Junctions: position and shape [m], and the type, which decides who has priority. In junctions of type `unregulated`, SUMO \
             detects no collisions.",
        );
        for Node { id, at: [x, y], kind, shape } in &self.nodes {
            nodes.open("node").attribute("id", id).attribute("x", centimetres(*x));
            nodes.attribute("y", centimetres(*y)).attribute("type", kind);
            outline(&mut nodes, shape);
        }
        let mut edges = opening(
            "edges",
            "Roads from junction to junction, one for each direction. An edge may also have numLanes, speed [m/s], shape [m] and \
             spreadType.",
        );
        for Edge { id, from, to, lanes: own, shape, centred } in &self.edges {
            edges.open("edge").attribute("id", id).attribute("from", from).attribute("to", to);
            edges.attribute("type", "street");
            if *own != lanes {
                edges.attribute("numLanes", own);
            }
            if *centred {
                edges.attribute("spreadType", "center");
            }
            outline(&mut edges, shape);
        }
        if let Some((nodes, paths)) = &self.ring {
            edges.open("roundabout").attribute("nodes", nodes.join(" "));
            edges.attribute("edges", paths.join(" ")).close();
        }
        let mut links = opening(
            "connections",
            "Which lane leads to which, counted from the right and starting at 0. A shape [m] is the path of the vehicles there.",
        );
        for Link { from, to, lanes: [a, b], shape } in &self.links {
            links.open("connection").attribute("from", from).attribute("to", to);
            links.attribute("fromLane", a).attribute("toLane", b);
            outline(&mut links, shape);
        }
        let mut types = opening(
            "types",
            "What all roads have in common: number of lanes, speed limit [m/s], width of a lane [m].",
        );
        types.open("type").attribute("id", "street").attribute("priority", 1);
        types.attribute("numLanes", lanes).attribute("speed", speed);
        types.attribute("width", LANE_WIDTH);
        [
            ("nod.xml", nodes.finish()),
            ("edg.xml", edges.finish()),
            ("con.xml", links.finish()),
            ("typ.xml", types.finish()),
        ]
    }

    /// Returns the spaces as parking areas in a SUMO additional file, or `None` if there are no
    /// spaces.
    pub(super) fn additional(&self) -> Option<String> {
        let mut xml = Writer::new();
        xml.comment("The parking spaces, for SUMO alone: `iwol` does not read this file.");
        root(&mut xml, "additional");
        for Space { id, edge, depth } in &self.spaces {
            xml.open("parkingArea").attribute("id", id).attribute("lane", format!("{edge}_0"));
            xml.attribute("startPos", 1).attribute("endPos", depth);
            xml.attribute("roadsideCapacity", 1).attribute("onRoad", true).close();
        }
        (!self.spaces.is_empty()).then(|| xml.finish())
    }
}

/// Ends an element with its shape, without repeated points.
fn outline(xml: &mut Writer, points: &[[f64; 2]]) {
    let mut points: Vec<[f64; 2]> = points.iter().map(|point| point.map(centimetres)).collect();
    points.dedup();
    let points: Vec<String> = points.into_iter().map(|[x, y]| format!("{x},{y}")).collect();
    if !points.is_empty() {
        xml.attribute("shape", points.join(" "));
    }
    xml.close();
}

/// Rounds to centimetres, without negative zeros.
fn centimetres(metres: f64) -> f64 {
    (100.0 * metres).round() / 100.0 + 0.0
}

/// Returns the beginning of a source file.
fn opening(name: &'static str, comment: &str) -> Writer {
    let mut xml = Writer::new();
    xml.comment(&format!("{comment}\n     After a change: iwol scenario build."));
    root(&mut xml, name);
    xml
}

/// Opens a root element that names SUMO's schema, for editors.
fn root(xml: &mut Writer, name: &'static str) {
    xml.open(name)
        .attribute("xmlns:xsi", "http://www.w3.org/2001/XMLSchema-instance")
        .attribute("xsi:noNamespaceSchemaLocation", format!("{XSD}/{name}_file.xsd"));
}
