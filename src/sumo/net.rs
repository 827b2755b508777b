//! Reader of SUMO's `.net.xml` files: lanes, edges, junctions and connections, and the paths of
//! routes.
//!
//! A net file is untrusted input. For any content, [`Net::load`] returns either a net in which all
//! references resolve, or an error that names file, line and column. Elements that this program
//! does not need (traffic lights, roundabouts) are skipped. Compressed nets (`.net.xml.gz`) are not
//! supported.
//!
//! Units are SI units, coordinates are those of the net file, and angles are radians
//! counter-clockwise from +x.

mod error;
mod path;
mod tile;
mod trip;
mod walk;
pub(crate) mod xml;

use std::{
    collections::{HashMap, HashSet},
    ops::Range,
    path::{Path as FilePath, PathBuf},
};

use roxmltree::{Document, Node};

pub use error::NetError;
pub(crate) use error::{did_you_mean, nearest, shorten};
pub use path::Path;
pub use tile::{Tiled, tile, tiled_id};
pub use walk::Walk;
pub use xml::XmlError;

/// Width of a lane for which the file gives no width \[m\].
pub const DEFAULT_LANE_WIDTH: f64 = 3.2;

/// Maximum size of a net file \[bytes\].
const MAX_BYTES: u64 = 256 << 20;

/// Maximum number of points of all lanes of a route together.
const MAX_POINTS: usize = 1 << 16;

/// Minimum length of a lane as SUMO counts it \[m\]; keeps ratios of lengths finite.
const MIN_LENGTH: f64 = 1e-3;

/// SUMO's vehicle class of the vehicles in this program.
const CARS: &str = "passenger";

/// SUMO's vehicle class of pedestrians.
const PEDESTRIANS: &str = "pedestrian";

/// Maximum magnitude of any number in a net; keeps sums and products finite.
const MAX_NUMBER: f64 = 1e9;

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
    /// Lower left and upper right corner of the net \[m\].
    pub boundary: [[f64; 2]; 2],
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
    /// Index on its edge, from the right, starting at 0.
    pub index: u32,
    /// Speed limit \[m/s\].
    pub speed: f64,
    /// Length as SUMO counts it \[m\]; it may differ from the length of the shape.
    pub length: f64,
    /// Width \[m\].
    pub width: f64,
    /// Centre line in driving direction, at least two points \[m\].
    pub shape: Vec<[f64; 2]>,
    /// Whether passenger cars may use the lane.
    pub cars: bool,
    /// Whether pedestrians may use the lane.
    pub pedestrians: bool,
}

impl Lane {
    /// Whether the lane is for pedestrians and not for cars.
    pub fn is_sidewalk(&self) -> bool {
        self.pedestrians && !self.cars
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
    /// Range of its lanes in [`Net::lanes`]; never empty.
    pub lanes: Range<usize>,
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

    /// Returns the text of a net file.
    pub(super) fn text(path: &FilePath) -> Result<String, NetError> {
        let text = xml::read(path, MAX_BYTES)
            .map_err(|source| NetError::Read { path: path.into(), source })?;
        text.ok_or_else(|| NetError::TooLarge { path: path.into(), limit: MAX_BYTES })
    }

    /// Reads a net from its text; `path` is for messages only.
    ///
    /// # Errors
    /// As [`Net::load`].
    pub fn parse(text: &str, path: &FilePath) -> Result<Self, NetError> {
        let document = xml::parse(text).map_err(|(source, at)| NetError::Xml {
            path: path.into(),
            line: at.row,
            column: at.col,
            source,
        })?;
        Reader { path, document: &document }.net()
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

    /// Returns the path of a route: the centre lines of its lanes from edge to edge along
    /// connections, including internal lanes.
    ///
    /// Of the lanes from which the rest of the route can be driven without a lane change, the path
    /// takes the rightmost one.
    ///
    /// # Errors
    /// [`NetError::EmptyRoute`], [`NetError::NoEdge`], [`NetError::NotRoad`],
    /// [`NetError::NotConnected`], [`NetError::LaneChange`] or [`NetError::LongRoute`].
    pub fn route_path(&self, edges: &[String]) -> Result<Path, NetError> {
        self.route_path_from(edges, None)
    }

    /// Returns the path of a route that starts on a given lane of the first edge, counted from the
    /// right and starting at 0; `None`: on any lane, as [`Net::route_path`].
    ///
    /// # Errors
    /// As [`Net::route_path`], with [`NetError::LaneChange`] if the route cannot be driven from
    /// that lane.
    pub fn route_path_from(&self, edges: &[String], lane: Option<u32>) -> Result<Path, NetError> {
        let lanes = self.route_lanes(edges, lane)?;
        let points: usize = lanes.iter().map(|&lane| self.lanes[lane].shape.len()).sum();
        if points > MAX_POINTS {
            return Err(NetError::LongRoute { path: self.path.clone(), points, limit: MAX_POINTS });
        }
        Path::through(self, &lanes).ok_or_else(|| NetError::EmptyRoute { path: self.path.clone() })
    }

    /// Returns the lanes of a route in driving order, with the internal lanes between those of its
    /// edges.
    fn route_lanes(&self, edges: &[String], first: Option<u32>) -> Result<Vec<usize>, NetError> {
        let Some(last) = edges.len().checked_sub(1) else {
            return Err(NetError::EmptyRoute { path: self.path.clone() });
        };
        let route: Vec<&Edge> =
            edges.iter().map(|id| self.edge_named(id)).collect::<Result<_, _>>()?;
        // From the last edge to the first: for each lane, the best connection from which the
        // route's end can be reached.
        let mut ways: Vec<HashMap<usize, &Connection>> = vec![HashMap::new(); last];
        for i in (0..last).rev() {
            let next = &route[i + 1].lanes;
            let mut connected = false;
            for lane in route[i].lanes.clone().filter(|&lane| self.lanes[lane].cars) {
                let onward = self
                    .connections_from(lane)
                    .filter(|c| next.contains(&c.to) && self.lanes[c.to].cars);
                let onward = onward.inspect(|_| connected = true);
                let onward =
                    onward.filter(|c| ways.get(i + 1).is_none_or(|ways| ways.contains_key(&c.to)));
                if let Some(best) = onward.min_by_key(|c| c.to) {
                    ways[i].insert(lane, best);
                }
            }
            if !connected {
                let (from, to) = (shorten(&edges[i]), shorten(&edges[i + 1]));
                return Err(NetError::NotConnected { path: self.path.clone(), from, to });
            }
        }
        let lane_change =
            || NetError::LaneChange { path: self.path.clone(), route: shorten(&edges.join(" ")) };
        let wanted = |lane: usize| {
            self.lanes[lane].cars && first.is_none_or(|first| self.lanes[lane].index == first)
        };
        let good =
            |lane: &usize| wanted(*lane) && ways.first().is_none_or(|ways| ways.contains_key(lane));
        let mut lane = route[0].lanes.clone().find(good).ok_or_else(lane_change)?;
        let mut lanes = vec![lane];
        for way in &ways {
            let connection = way.get(&lane).ok_or_else(lane_change)?;
            self.follow_internal(connection, &mut lanes);
            lane = connection.to;
            lanes.push(lane);
        }
        Ok(lanes)
    }

    /// Returns the first lane of a path from which several connections lead to the next road.
    pub fn fork(&self, path: &Path) -> Option<usize> {
        let road =
            |lane: &usize| self.edges[self.lanes[*lane].edge].function == EdgeFunction::Normal;
        let roads: Vec<usize> = path.lanes.iter().copied().filter(road).collect();
        let forks = |pair: &&[usize]| {
            let next = self.lanes[pair[1]].edge;
            self.connections_from(pair[0]).filter(|c| self.lanes[c.to].edge == next).count() > 1
        };
        roads.windows(2).find(forks).map(|pair| pair[0])
    }

    /// Appends the internal lanes of a connection. There are several where vehicles may wait inside
    /// the junction.
    fn follow_internal(&self, connection: &Connection, lanes: &mut Vec<usize>) {
        let mut via = connection.via;
        let mut passed = HashSet::new();
        while let Some(lane) = via {
            if !passed.insert(lane) {
                break; // A cycle, which occurs only in an invalid net.
            }
            lanes.push(lane);
            via = self.connections_from(lane).find(|c| c.to == connection.to).and_then(|c| c.via);
        }
    }

    /// Returns the road with this id.
    fn edge_named(&self, id: &str) -> Result<&Edge, NetError> {
        match self.edge_index(id).map(|i| &self.edges[i]) {
            Some(edge) if self.is_road(edge) => Ok(edge),
            Some(_) => Err(NetError::NotRoad { path: self.path.clone(), edge: shorten(id) }),
            None => Err(NetError::NoEdge {
                path: self.path.clone(),
                edge: shorten(id),
                nearest: nearest(id, self.roads().map(|e| e.id.as_str())).map(Into::into),
            }),
        }
    }

    /// Whether an edge is outside of junctions and cars may use it.
    fn is_road(&self, edge: &Edge) -> bool {
        edge.function == EdgeFunction::Normal
            && self.lanes[edge.lanes.clone()].iter().any(|lane| lane.cars)
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

/// Turns the elements of a net file into a [`Net`].
struct Reader<'a, 'input> {
    path: &'a FilePath,
    document: &'a Document<'input>,
}

impl Reader<'_, '_> {
    fn net(&self) -> Result<Net, NetError> {
        let root = self.document.root_element();
        if root.tag_name().name() != "net" {
            let (line, column) = self.position(root.range().start);
            let found = shorten(root.tag_name().name());
            return Err(NetError::NotNet { path: self.path.into(), line, column, found });
        }
        let mut net = Net {
            path: self.path.into(),
            lanes: Vec::new(),
            edges: Vec::new(),
            junctions: Vec::new(),
            connections: Vec::new(),
            boundary: self.boundary(root)?,
            edge_by_id: HashMap::new(),
            leaving: Vec::new(),
        };
        let mut lane_by_id = HashMap::new();
        for node in elements(root, "edge") {
            self.edge(node, &mut net, &mut lane_by_id)?;
        }
        let mut junction_ids = HashSet::new();
        for node in elements(root, "junction") {
            let junction = Junction {
                id: self.text(node, "id")?.into(),
                kind: node.attribute("type").unwrap_or_default().into(),
                x: self.number(node, "x", f64::NEG_INFINITY)?,
                y: self.number(node, "y", f64::NEG_INFINITY)?,
                shape: self.points(node, 0)?,
            };
            if !junction_ids.insert(junction.id.clone()) {
                return Err(self.duplicate(node, "junction", &junction.id));
            }
            net.junctions.push(junction);
        }
        net.leaving = vec![Vec::new(); net.lanes.len()];
        for node in elements(root, "connection") {
            let via = match node.attribute("via") {
                None => None,
                Some(id) => match lane_by_id.get(id) {
                    Some(&lane)
                        if net.edges[net.lanes[lane].edge].function == EdgeFunction::Normal =>
                    {
                        return Err(self.value(node, "via", "a lane within a junction"));
                    }
                    Some(&lane) => Some(lane),
                    None => {
                        return Err(self.reference(
                            node,
                            "via",
                            id,
                            lane_by_id.keys().map(String::as_str),
                        ));
                    }
                },
            };
            let from = self.lane_end(node, &net, "from", "fromLane")?;
            let to = self.lane_end(node, &net, "to", "toLane")?;
            let dir = node.attribute("dir").unwrap_or_default().to_owned();
            net.leaving[from].push(net.connections.len());
            net.connections.push(Connection { from, to, via, dir });
        }
        Ok(net)
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
            let lane = self.lane(lane_node, edge)?;
            if lane.index as usize != net.lanes.len() - start {
                return Err(self.value(
                    lane_node,
                    "index",
                    "lanes numbered 0, 1, 2, ... in this order",
                ));
            }
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
            lanes: start..net.lanes.len(),
        });
        Ok(())
    }

    fn lane(&self, node: Node, edge: usize) -> Result<Lane, NetError> {
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
            shape: self.points(node, 2)?,
            cars: allows(node, CARS),
            pedestrians: allows(node, PEDESTRIANS),
        })
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
            return Err(self.reference(
                node,
                edge_key,
                id,
                net.edges.iter().map(|e| e.id.as_str()),
            ));
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

    /// Reads the attribute `shape`: points `x,y` or `x,y,z`, separated by spaces.
    fn points(&self, node: Node, least: usize) -> Result<Vec<[f64; 2]>, NetError> {
        let text = if least == 0 {
            node.attribute("shape").unwrap_or_default()
        } else {
            self.text(node, "shape")?
        };
        let point = |text: &str| {
            let numbers: Vec<f64> = text.split(',').map(finite).collect::<Option<_>>()?;
            matches!(numbers.len(), 2 | 3).then(|| [numbers[0], numbers[1]])
        };
        let points: Option<Vec<_>> = text.split_whitespace().map(point).collect();
        let points = points.filter(|points| points.len() >= least);
        points.ok_or_else(|| {
            self.value(node, "shape", "points x,y separated by spaces, two or more for a lane")
        })
    }

    fn position(&self, offset: usize) -> (u32, u32) {
        let at = self.document.text_pos_at(offset);
        (at.row, at.col)
    }

    fn attribute_position(&self, node: Node, key: &str) -> (u32, u32) {
        let attribute = node.attribute_node(key);
        self.position(attribute.map_or(node.range().start, |a| a.range().start))
    }

    fn missing(&self, node: Node, what: &str) -> NetError {
        let (line, column) = self.position(node.range().start);
        let element = node.tag_name().name().to_owned();
        NetError::Missing { path: self.path.into(), line, column, element, what: what.into() }
    }

    fn value(&self, node: Node, key: &str, allowed: &'static str) -> NetError {
        let (line, column) = self.attribute_position(node, key);
        NetError::Value {
            path: self.path.into(),
            line,
            column,
            element: node.tag_name().name().into(),
            key: key.into(),
            value: shorten(node.attribute(key).unwrap_or_default()),
            allowed,
        }
    }

    fn reference<'v>(
        &self,
        node: Node,
        key: &str,
        value: &str,
        valid: impl Iterator<Item = &'v str>,
    ) -> NetError {
        let (line, column) = self.attribute_position(node, key);
        NetError::Reference {
            path: self.path.into(),
            line,
            column,
            key: key.into(),
            value: shorten(value),
            nearest: nearest(value, valid).map(Into::into),
        }
    }

    fn duplicate(&self, node: Node, kind: &'static str, id: &str) -> NetError {
        let (line, column) = self.attribute_position(node, "id");
        NetError::Duplicate { path: self.path.into(), line, column, kind, id: shorten(id) }
    }
}

/// Whether a vehicle class may use a lane.
fn allows(lane: Node, class: &str) -> bool {
    let named = |list: &str| list.split_whitespace().any(|name| name == "all" || name == class);
    lane.attribute("allow").is_none_or(named) && !lane.attribute("disallow").is_some_and(named)
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

#[cfg(test)]
mod tests;
