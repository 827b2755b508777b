//! Reads a net from the XML of its file.

use std::{
    collections::{HashMap, HashSet},
    path::Path as FilePath,
};

use roxmltree::{Document, Node};

use super::{
    Classes, Connection, DEFAULT_LANE_WIDTH, Edge, EdgeFunction, Foes, Junction, Lane, Net,
    NetError, Phase, Problem, Roundabout, Signal, TrafficLight, nearest, shorten, xml,
};
use crate::markup;

/// Maximum size of a net file \[bytes\].
const MAX_BYTES: u64 = 256 << 20;

/// Minimum length of a lane as SUMO counts it \[m\]; keeps ratios of lengths finite.
const MIN_LENGTH: f64 = 1e-3;

/// Maximum magnitude of any number in a net; keeps sums and products finite.
const MAX_NUMBER: f64 = 1e9;

impl Net {
    /// Returns the text of a net file.
    pub(crate) fn text(path: &FilePath) -> Result<String, NetError> {
        let text = markup::read(path, MAX_BYTES)
            .map_err(|source| error(path, None, Problem::Read { source }))?;
        text.ok_or_else(|| error(path, None, Problem::TooLarge { limit: MAX_BYTES }))
    }

    /// Reads a net from its text; `path` is for messages only.
    ///
    /// # Errors
    /// As [`Net::load`].
    pub fn parse(text: &str, path: &FilePath) -> Result<Self, NetError> {
        Reader { path, document: &document(text, path)? }.net()
    }
}

/// Reads the XML of a net file.
pub(super) fn document<'t>(text: &'t str, path: &FilePath) -> Result<Document<'t>, NetError> {
    xml::parse(text)
        .map_err(|(source, at)| error(path, Some((at.row, at.col)), Problem::Xml { source }))
}

fn error(path: &FilePath, place: Option<(u32, u32)>, problem: Problem) -> NetError {
    NetError { path: path.into(), place, problem }
}

/// Turns the elements of a net file into a [`Net`].
struct Reader<'a, 'input> {
    path: &'a FilePath,
    document: &'a Document<'input>,
}

impl Reader<'_, '_> {
    fn net(&self) -> Result<Net, NetError> {
        let root = self.document.root_element();
        if root.tag_name().name() != "net" {
            let found = shorten(root.tag_name().name());
            return Err(self.error(root.range().start, Problem::NotNet { found }));
        }
        let mut net = Net {
            path: self.path.into(),
            lanes: Vec::new(),
            edges: Vec::new(),
            junctions: Vec::new(),
            connections: Vec::new(),
            roundabouts: self.roundabouts(root)?,
            traffic_lights: self.traffic_lights(root)?,
            boundary: self.boundary(root)?,
            left_hand: root.attribute("lefthand").is_some_and(|text| matches!(text, "true" | "1")),
            foes: Foes::default(),
            edge_by_id: HashMap::new(),
            leaving: Vec::new(),
        };
        let mut lane_by_id = HashMap::new();
        for node in elements(root, "edge") {
            self.edge(node, &mut net, &mut lane_by_id)?;
        }
        for node in elements(root, "edge") {
            let Some(id) = node.attribute("bidi").filter(|id| !id.is_empty()) else { continue };
            let partner = net.edge_index(id).ok_or_else(|| {
                self.reference(node, "bidi", id, net.edges.iter().map(|edge| edge.id.as_str()))
            })?;
            let edge = node.attribute("id").and_then(|id| net.edge_index(id));
            if let Some(edge) = edge {
                net.edges[edge].bidi = Some(partner);
            }
        }
        let mut junction_ids = HashSet::new();
        for node in elements(root, "junction") {
            let junction = Junction {
                id: self.text(node, "id")?.into(),
                kind: node.attribute("type").unwrap_or_default().into(),
                x: self.number(node, "x", f64::NEG_INFINITY)?,
                y: self.number(node, "y", f64::NEG_INFINITY)?,
                shape: self.points(node, 0)?.0,
            };
            if !junction_ids.insert(junction.id.clone()) {
                return Err(self.duplicate(node, "junction", &junction.id));
            }
            net.junctions.push(junction);
        }
        net.leaving = vec![Vec::new(); net.lanes.len()];
        for node in elements(root, "connection") {
            let via = node.attribute("via").map(|id| {
                let &lane = lane_by_id.get(id).ok_or_else(|| {
                    self.reference(node, "via", id, lane_by_id.keys().map(String::as_str))
                })?;
                if net.edges[net.lanes[lane].edge].function == EdgeFunction::Normal {
                    return Err(self.value(node, "via", "a lane within a junction"));
                }
                Ok(lane)
            });
            let via = via.transpose()?;
            let from = self.lane_end(node, &net, "from", "fromLane")?;
            let to = self.lane_end(node, &net, "to", "toLane")?;
            let dir = node.attribute("dir").unwrap_or_default().to_owned();
            net.leaving[from].push(net.connections.len());
            let signal = self.signal(node, &mut net)?;
            let classes = self.classes(node)?;
            net.connections.push(Connection { from, to, via, dir, signal, classes });
        }
        net.foes = Foes::read(root, &lane_by_id, &net);
        for i in 0..net.connections.len() {
            let mut inner = Vec::new();
            net.follow_internal(&net.connections[i], &mut inner);
            let classes = inner.iter().map(|&lane| net.lanes[lane].classes);
            net.connections[i].classes = classes.fold(net.connections[i].classes, Classes::and);
        }
        Ok(net)
    }

    fn roundabouts(&self, root: Node) -> Result<Vec<Roundabout>, NetError> {
        let ids = |node, key| -> Result<Vec<String>, NetError> {
            Ok(self.text(node, key)?.split_whitespace().map(Into::into).collect())
        };
        let read =
            |node| Ok(Roundabout { junctions: ids(node, "nodes")?, edges: ids(node, "edges")? });
        elements(root, "roundabout").map(read).collect()
    }

    /// Returns the traffic lights, each with its last program, which is the one that SUMO starts.
    fn traffic_lights(&self, root: Node) -> Result<Vec<TrafficLight>, NetError> {
        let mut lights: Vec<TrafficLight> = Vec::new();
        for node in elements(root, "tlLogic") {
            let phases: Vec<Phase> =
                elements(node, "phase").map(|phase| self.phase(phase)).collect::<Result<_, _>>()?;
            let beyond = |phase: &Phase| phase.next.is_some_and(|next| next >= phases.len());
            let wrong = elements(node, "phase").zip(&phases).find(|(_, phase)| beyond(phase));
            if let Some((phase, _)) = wrong {
                return Err(self.value(phase, "next", "the indices of phases"));
            }
            let kind = node.attribute("type").unwrap_or("static");
            let light = TrafficLight {
                id: self.text(node, "id")?.to_owned(),
                kind: if node.attribute("programID") == Some("off") { "off" } else { kind }.into(),
                offset: node.attribute("offset").and_then(finite).map_or(0, milliseconds),
                phases,
            };
            match lights.iter_mut().find(|other| other.id == light.id) {
                Some(other) => *other = light,
                None => lights.push(light),
            }
        }
        Ok(lights)
    }

    fn phase(&self, node: Node) -> Result<Phase, NetError> {
        // Newer releases of SUMO know actuated phases with a minimum duration only.
        let key = ["duration", "minDur"].into_iter().find(|key| node.has_attribute(*key));
        let key = key.unwrap_or("duration");
        let next = node.attribute("next").and_then(|text| text.split([' ', ',']).next());
        let next = next.filter(|text| !text.is_empty()).map(str::parse).transpose();
        Ok(Phase {
            duration: milliseconds(self.number(node, key, MIN_LENGTH)?).max(1),
            state: self.text(node, "state")?.to_owned(),
            next: next.map_err(|_| self.value(node, "next", "the indices of phases"))?,
        })
    }

    /// Returns the signal of a connection. At rail crossings and rail signals, SUMO makes a traffic
    /// light of the junction itself, and gives connections without a signal the index -1.
    fn signal(&self, node: Node, net: &mut Net) -> Result<Option<Signal>, NetError> {
        let Some(id) = node.attribute("tl").filter(|id| !id.is_empty()) else { return Ok(None) };
        if node.attribute("linkIndex") == Some("-1") {
            return Ok(None);
        }
        let index = self.integer(node, "linkIndex")? as usize;
        let known = net.traffic_lights.iter().position(|light| light.id == id);
        let rail = |junction: &&Junction| junction.id == id && junction.kind.starts_with("rail_");
        if let (None, Some(junction)) = (known, net.junctions.iter().find(rail)) {
            let (id, kind) = (id.to_owned(), junction.kind.clone());
            net.traffic_lights.push(TrafficLight { id, kind, offset: 0, phases: Vec::new() });
            return Ok(Some(Signal { traffic_light: net.traffic_lights.len() - 1, index }));
        }
        let traffic_light = known.ok_or_else(|| {
            let ids = net.traffic_lights.iter().map(|light| light.id.as_str());
            self.reference(node, "tl", id, ids)
        })?;
        let phases = &net.traffic_lights[traffic_light].phases;
        if phases.iter().any(|phase| phase.state.len() <= index) {
            let allowed = "the place of a letter in every state of the traffic light";
            return Err(self.value(node, "linkIndex", allowed));
        }
        Ok(Some(Signal { traffic_light, index }))
    }

    fn boundary(&self, root: Node) -> Result<[[f64; 2]; 2], NetError> {
        let location = elements(root, "location")
            .next()
            .ok_or_else(|| self.missing(root, "the element <location>"))?;
        let text = self.text(location, "convBoundary")?;
        let numbers: Option<Vec<f64>> = text.split(',').map(finite).collect();
        match numbers.as_deref() {
            Some(&[x0, y0, x1, y1]) if x0 <= x1 && y0 <= y1 => Ok([[x0, y0], [x1, y1]]),
            _ => Err(self.value(location, "convBoundary", "left,bottom,right,top")),
        }
    }

    fn edge(
        &self,
        node: Node,
        net: &mut Net,
        lane_by_id: &mut HashMap<String, usize>,
    ) -> Result<(), NetError> {
        let id = self.text(node, "id")?.to_owned();
        let edge = net.edges.len();
        let start = net.lanes.len();
        for lane_node in elements(node, "lane") {
            let (mut lane, place) = (self.lane(lane_node, edge)?, net.lanes.len() - start);
            // SUMO numbers lanes in their order. Older versions of netconvert repeat an index.
            if lane.index as usize > place {
                let allowed = "lanes numbered 0, 1, 2, ... in this order";
                return Err(self.value(lane_node, "index", allowed));
            }
            lane.index = place as u32;
            if lane_by_id.insert(lane.id.clone(), net.lanes.len()).is_some() {
                return Err(self.duplicate(lane_node, "lane", &lane.id));
            }
            net.lanes.push(lane);
        }
        if net.lanes.len() == start {
            return Err(self.missing(node, "the element <lane>"));
        }
        if net.edge_by_id.insert(id.clone(), edge).is_some() {
            return Err(self.duplicate(node, "edge", &id));
        }
        net.edges.push(Edge {
            id,
            from: node.attribute("from").map(Into::into),
            to: node.attribute("to").map(Into::into),
            function: match node.attribute("function") {
                None | Some("normal") => EdgeFunction::Normal,
                Some("internal") => EdgeFunction::Internal,
                Some("crossing") => EdgeFunction::Crossing,
                Some("walkingarea") => EdgeFunction::WalkingArea,
                Some(_) => EdgeFunction::Other,
            },
            bidi: None,
            lanes: start..net.lanes.len(),
        });
        Ok(())
    }

    fn lane(&self, node: Node, edge: usize) -> Result<Lane, NetError> {
        let (shape, heights) = self.points(node, 2)?;
        Ok(Lane {
            id: self.text(node, "id")?.into(),
            edge,
            index: self.integer(node, "index")?,
            speed: self.number(node, "speed", 0.0)?,
            length: self.number(node, "length", MIN_LENGTH)?,
            width: match node.attribute("width") {
                None => DEFAULT_LANE_WIDTH,
                Some(_) => self.number(node, "width", 0.0)?,
            },
            shape,
            heights,
            classes: self.classes(node)?,
        })
    }

    /// Returns the vehicle classes that may use a lane or a connection.
    fn classes(&self, node: Node) -> Result<Classes, NetError> {
        let classes = Classes::of(node.attribute("allow"), node.attribute("disallow"));
        classes.map_err(|key| self.value(node, key, "vehicle classes of SUMO, separated by spaces"))
    }

    /// Returns the lane to which the edge id and the lane index of a connection refer.
    fn lane_end(
        &self,
        node: Node,
        net: &Net,
        edge_key: &str,
        lane_key: &str,
    ) -> Result<usize, NetError> {
        let id = self.text(node, edge_key)?;
        let Some(edge) = net.edge_index(id) else {
            let valid = net.edges.iter().map(|e| e.id.as_str());
            return Err(self.reference(node, edge_key, id, valid));
        };
        let index = self.integer(node, lane_key)?;
        let lane = net.edges[edge].lanes.clone().nth(index as usize);
        lane.ok_or_else(|| self.reference(node, lane_key, &index.to_string(), std::iter::empty()))
    }

    fn text<'n>(&self, node: Node<'n, '_>, key: &str) -> Result<&'n str, NetError> {
        node.attribute(key).ok_or_else(|| self.missing(node, &format!("the attribute `{key}`")))
    }

    fn number(&self, node: Node, key: &str, least: f64) -> Result<f64, NetError> {
        let number = finite(self.text(node, key)?).filter(|&n| n >= least);
        let allowed = match least {
            0.0 => "a number of at least 0",
            f64::NEG_INFINITY => "a number",
            _ => "a number of at least 0.001",
        };
        number.ok_or_else(|| self.value(node, key, allowed))
    }

    fn integer(&self, node: Node, key: &str) -> Result<u32, NetError> {
        self.text(node, key)?
            .parse()
            .map_err(|_| self.value(node, key, "a whole number of at least 0"))
    }

    /// Reads the attribute `shape`: points `x,y` or `x,y,z`, separated by spaces. The second result
    /// holds the heights `z`, 0 where a point has none; it is empty if no point has one.
    fn points(&self, node: Node, least: usize) -> Result<(Vec<[f64; 2]>, Vec<f64>), NetError> {
        let text = if least == 0 {
            node.attribute("shape").unwrap_or_default()
        } else {
            self.text(node, "shape")?
        };
        let point = |text: &str| {
            let numbers: Vec<f64> = text.split(',').map(finite).collect::<Option<_>>()?;
            matches!(numbers.len(), 2 | 3)
                .then(|| ([numbers[0], numbers[1]], numbers.get(2).copied()))
        };
        let points: Option<Vec<_>> = text.split_whitespace().map(point).collect();
        let points = points.filter(|points| points.len() >= least).ok_or_else(|| {
            self.value(node, "shape", "points x,y separated by spaces, two or more for a lane")
        })?;
        let any = points.iter().any(|(_, height)| height.is_some());
        let heights = points.iter().filter(|_| any).map(|(_, height)| height.unwrap_or(0.0));
        let heights = heights.collect();
        Ok((points.into_iter().map(|(point, _)| point).collect(), heights))
    }

    fn error(&self, offset: usize, problem: Problem) -> NetError {
        let at = self.document.text_pos_at(offset);
        error(self.path, Some((at.row, at.col)), problem)
    }

    /// Returns an error at an attribute of an element, or at the element if it lacks the attribute.
    fn error_at(&self, node: Node, key: &str, problem: Problem) -> NetError {
        let attribute = node.attribute_node(key);
        self.error(attribute.map_or(node.range().start, |a| a.range().start), problem)
    }

    fn missing(&self, node: Node, what: &str) -> NetError {
        let element = node.tag_name().name().to_owned();
        self.error(node.range().start, Problem::Missing { element, what: what.into() })
    }

    fn value(&self, node: Node, key: &str, allowed: &'static str) -> NetError {
        let value = shorten(node.attribute(key).unwrap_or_default());
        let element = node.tag_name().name().into();
        self.error_at(node, key, Problem::Value { element, key: key.into(), value, allowed })
    }

    fn reference<'v>(
        &self,
        node: Node,
        key: &str,
        value: &str,
        valid: impl Iterator<Item = &'v str>,
    ) -> NetError {
        let nearest = nearest(value, valid).map(Into::into);
        let (key_name, value) = (key.into(), shorten(value));
        self.error_at(node, key, Problem::Reference { key: key_name, value, nearest })
    }

    fn duplicate(&self, node: Node, kind: &'static str, id: &str) -> NetError {
        self.error_at(node, "id", Problem::Duplicate { kind, id: shorten(id) })
    }
}

fn elements<'a, 'i>(
    parent: Node<'a, 'i>,
    name: &'static str,
) -> impl Iterator<Item = Node<'a, 'i>> {
    parent.children().filter(move |n| n.is_element() && n.tag_name().name() == name)
}

fn finite(text: &str) -> Option<f64> {
    text.trim().parse::<f64>().ok().filter(|n| n.abs() <= MAX_NUMBER)
}

/// Converts a time in seconds into SUMO's milliseconds.
fn milliseconds(seconds: f64) -> i64 {
    (seconds * 1000.0).round() as i64
}
