//! A road network before netconvert has built it: SUMO's plain XML, with the routes through it.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;

use super::super::{Route, write::escape};

/// Width of every lane \[m\].
pub(super) const LANE_WIDTH: f64 = 3.5;
/// Where SUMO's schemas are, for editors.
const XSD: &str = "http://sumo.dlr.de/xsd";

/// Nodes, edges, connections, and how vehicles drive through them.
#[derive(Debug, Default)]
pub(super) struct Plan {
    pub(super) nodes: Vec<Node>,
    pub(super) edges: Vec<Edge>,
    pub(super) links: Vec<Link>,
    /// Ids of the nodes and edges of a roundabout.
    pub(super) ring: Option<(Vec<String>, Vec<String>)>,
    pub(super) routes: Vec<Route>,
    /// Edges on which the first place is so much further ahead than on others \[m\].
    pub(super) ahead: BTreeMap<String, f64>,
    /// Edges with one place only.
    pub(super) single: BTreeSet<String>,
    pub(super) spaces: Vec<Space>,
    /// Vehicles can only steer there, and reverse.
    pub(super) lot: bool,
}

#[derive(Debug)]
pub(super) struct Node {
    pub(super) id: String,
    /// \[m\]
    pub(super) at: [f64; 2],
    /// SUMO's type of junction.
    pub(super) kind: &'static str,
    /// Its outline \[m\]; empty: netconvert's choice.
    pub(super) shape: Vec<[f64; 2]>,
}

#[derive(Debug)]
pub(super) struct Edge {
    pub(super) id: String,
    pub(super) from: String,
    pub(super) to: String,
    pub(super) lanes: u32,
    /// Points between its ends \[m\]; empty: straight.
    pub(super) shape: Vec<[f64; 2]>,
    /// Its lanes lie on both sides of its line, not to the right of it.
    pub(super) centred: bool,
}

/// A lane leads to a lane of the next edge.
#[derive(Debug)]
pub(super) struct Link {
    pub(super) from: String,
    pub(super) to: String,
    pub(super) lanes: [u32; 2],
    /// The way from one to the other \[m\]; empty: netconvert's choice.
    pub(super) shape: Vec<[f64; 2]>,
}

/// A space to park in.
#[derive(Debug)]
pub(super) struct Space {
    pub(super) id: String,
    /// The edge into it, of one lane.
    pub(super) edge: String,
    /// Length of that \[m\].
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

    /// The rightmost lanes lead to each other along points \[m\].
    pub(super) fn way(&mut self, from: &str, to: &str, shape: Vec<[f64; 2]>) {
        self.links.push(Link { from: from.into(), to: to.into(), lanes: [0, 0], shape });
    }

    /// A route on each of `lanes` lanes, called after its lane where there are several.
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

    /// The sources by the ending of their names, for vehicles that keep to `speed` \[m/s\].
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
        if let Some((nodes, ways)) = &self.ring {
            let _ = writeln!(
                edges,
                "    <roundabout nodes=\"{}\" edges=\"{}\"/>",
                nodes.join(" "),
                ways.join(" ")
            );
        }
        let mut links = opening(
            "connections",
            "Which lane leads to which, counted from the right and starting at 0; a shape [m] is the way there.",
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

    /// The spaces as parking areas, in one of SUMO's additional files; `None` without any.
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

/// Points as an attribute, each once; nothing where there are none.
fn outline(points: &[[f64; 2]]) -> String {
    let mut points: Vec<[f64; 2]> = points.iter().map(|point| point.map(centimetres)).collect();
    points.dedup();
    let points: Vec<String> = points.into_iter().map(|[x, y]| format!("{x},{y}")).collect();
    if points.is_empty() { String::new() } else { format!(" shape=\"{}\"", points.join(" ")) }
}

/// Rounded, and never a negative zero.
fn centimetres(metres: f64) -> f64 {
    (100.0 * metres).round() / 100.0 + 0.0
}

/// The beginning of a source file.
fn opening(root: &str, comment: &str) -> String {
    format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<!-- {comment}\n     After a change: iwol scenario build. -->\n\
         <{root} xmlns:xsi=\"http://www.w3.org/2001/XMLSchema-instance\" xsi:noNamespaceSchemaLocation=\"{XSD}/{root}_file.xsd\">\n"
    )
}
