//! Cuts a part out of a net: some junctions, and the roads that begin or end there.

use std::collections::{HashMap, HashSet};
use std::fmt::Write as _;
use std::path::Path as FilePath;

use roxmltree::Node;

use super::read::document;
use super::tile::write_attribute;
use super::{EdgeFunction, Net, NetError};

/// Returns the part of a net with the given junctions, and with all roads that begin or end at one
/// of them. `path` is used only in messages.
///
/// The part has the ids, numbers and geometry of the whole net: its elements are copied. Junctions
/// at the far ends of the roads become dead ends. A traffic light that controls several junctions
/// stays whole, with all of them.
///
/// # Errors
/// As for [`Net::parse`].
pub(crate) fn cut(
    text: &str,
    path: &FilePath,
    junctions: &HashSet<&str>,
) -> Result<String, NetError> {
    let net = Net::parse(text, path)?;
    let document = document(text, path)?;
    let root = document.root_element();
    let part = Part::new(&net, root, junctions);
    let mut out = String::from("<net");
    for attribute in root.attributes().filter(|a| a.namespace().is_none()) {
        write_attribute(&mut out, attribute.name(), attribute.value());
    }
    out.push_str(">\n");
    for node in root.children().filter(Node::is_element) {
        match node.tag_name().name() {
            "location" => part.location(&mut out, node),
            "junction" => part.junction(&mut out, node, text),
            _ if part.has(node) => {
                let _ = writeln!(out, "    {}", &text[node.range()]);
            }
            _ => {}
        }
    }
    out.push_str("</net>\n");
    Ok(out)
}

/// Which elements of a net belong to a part of it.
struct Part<'a> {
    net: &'a Net,
    /// Ids of the junctions that stay whole.
    whole: HashSet<&'a str>,
    /// Ids of the traffic lights.
    lights: HashSet<&'a str>,
    /// For each edge of the net, whether it belongs to the part.
    edges: Vec<bool>,
    /// Ids of the junctions that become dead ends.
    ends: HashSet<&'a str>,
}

impl<'a> Part<'a> {
    fn new(net: &'a Net, root: Node<'a, 'a>, junctions: &HashSet<&str>) -> Self {
        let ids = net.junctions.iter().map(|junction| junction.id.as_str());
        let mut part = Self {
            net,
            whole: ids.filter(|id| junctions.contains(id)).collect(),
            lights: HashSet::new(),
            edges: Vec::new(),
            ends: HashSet::new(),
        };
        let mut controlled: HashMap<&str, HashSet<&str>> = HashMap::new();
        for node in root.children().filter(|node| node.tag_name().name() == "connection") {
            if let (Some(light), Some(from)) = (node.attribute("tl"), node.attribute("from")) {
                controlled.entry(light).or_default().extend(part.end_of(from));
            }
        }
        loop {
            let added = controlled.iter().filter(|(light, junctions)| {
                !part.lights.contains(*light) && junctions.iter().any(|id| part.whole.contains(id))
            });
            let Some((&light, more)) = added.min_by_key(|(light, _)| **light) else { break };
            part.lights.insert(light);
            part.whole.extend(more);
        }
        let whole = &part.whole;
        let touches = |id: &Option<String>| id.as_deref().is_some_and(|id| whole.contains(id));
        let inside = |edge: &super::Edge| match junction_of(&edge.id) {
            Some(junction) => whole.contains(junction),
            None => touches(&edge.from) || touches(&edge.to),
        };
        part.edges = net.edges.iter().map(inside).collect();
        let kept = net.edges.iter().zip(&part.edges).filter(|(_, kept)| **kept);
        let ends = kept.flat_map(|(edge, _)| [&edge.from, &edge.to]).flatten();
        part.ends = ends.map(String::as_str).filter(|id| !part.whole.contains(id)).collect();
        part
    }

    /// Returns the junction at the end of an edge, or the junction to which an internal edge
    /// belongs.
    fn end_of(&self, edge: &'a str) -> Option<&'a str> {
        let end = || self.net.edges[self.net.edge_index(edge)?].to.as_deref();
        junction_of(edge).or_else(end)
    }

    fn has_edge(&self, id: &str) -> bool {
        self.net.edge_index(id).is_some_and(|edge| self.edges[edge])
    }

    /// Returns whether an element, except a junction, belongs to the part.
    fn has(&self, node: Node<'a, '_>) -> bool {
        let attribute = |key| node.attribute(key).unwrap_or_default();
        match node.tag_name().name() {
            "edge" => self.has_edge(attribute("id")),
            "tlLogic" => self.lights.contains(attribute("id")),
            "roundabout" => attribute("edges").split_whitespace().all(|id| self.has_edge(id)),
            "prohibition" => {
                let edges = ["prohibitor", "prohibited"].into_iter().flat_map(|key| {
                    node.attribute(key).unwrap_or_default().split("->").map(str::trim)
                });
                edges.into_iter().all(|id| self.has_edge(id))
            }
            "connection" => {
                let (from, to) = (attribute("from"), attribute("to"));
                let index = |id: &str| self.net.edge_index(id).map(|i| &self.net.edges[i]);
                let roads = [from, to]
                    .iter()
                    .all(|id| index(id).is_some_and(|edge| edge.function == EdgeFunction::Normal));
                let over = index(from).and_then(|edge| edge.to.as_deref());
                self.has_edge(from)
                    && self.has_edge(to)
                    && (!roads || over.is_some_and(|junction| self.whole.contains(junction)))
            }
            _ => true,
        }
    }

    /// Writes a junction: a copy of one that stays whole, and a dead end for one at the far end of a
    /// road.
    fn junction(&self, out: &mut String, node: Node<'a, '_>, text: &str) {
        let id = node.attribute("id").unwrap_or_default();
        // Where vehicles wait inside a junction, the net has a further junction, named after a lane.
        let own = junction_of(id).and_then(|edge| Some(edge.rsplit_once('_')?.0)).unwrap_or(id);
        if self.whole.contains(own) {
            let _ = writeln!(out, "    {}", &text[node.range()]);
        } else if self.ends.contains(id) {
            out.push_str("    <junction");
            for attribute in node.attributes().filter(|a| a.namespace().is_none()) {
                let lanes = || {
                    let edge = |lane: &&str| {
                        lane.rsplit_once('_').is_some_and(|(id, _)| self.has_edge(id))
                    };
                    attribute.value().split_whitespace().filter(edge).collect::<Vec<_>>().join(" ")
                };
                let value = match attribute.name() {
                    "type" => "dead_end".to_owned(),
                    "incLanes" => lanes(),
                    "intLanes" => String::new(),
                    _ => attribute.value().to_owned(),
                };
                write_attribute(out, attribute.name(), &value);
            }
            out.push_str("/>\n");
        }
    }

    /// Writes the element `<location>` with the boundary of the part.
    fn location(&self, out: &mut String, node: Node<'a, '_>) {
        let lanes = self.net.lanes.iter().filter(|lane| self.edges[lane.edge]);
        let points = lanes.flat_map(|lane| &lane.shape);
        let [low, high] =
            points.fold([[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]], |[low, high], p| {
                [[low[0].min(p[0]), low[1].min(p[1])], [high[0].max(p[0]), high[1].max(p[1])]]
            });
        out.push_str("    <location");
        for attribute in node.attributes().filter(|a| a.namespace().is_none()) {
            match attribute.name() {
                "convBoundary" if low[0] <= high[0] => {
                    let value =
                        format!("{:.2},{:.2},{:.2},{:.2}", low[0], low[1], high[0], high[1]);
                    write_attribute(out, "convBoundary", &value);
                }
                name => write_attribute(out, name, attribute.value()),
            }
        }
        out.push_str("/>\n");
    }
}

/// Returns the junction to which an edge belongs, as `:centre_0` to `centre`; `None` for roads.
fn junction_of(edge: &str) -> Option<&str> {
    Some(edge.strip_prefix(':')?.rsplit_once('_')?.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_part_has_the_ids_and_the_geometry_of_the_whole() {
        let path = FilePath::new("sumo_nets/parking_lot/parking_lot.net.xml");
        let text = std::fs::read_to_string(path).expect("a shipped net");
        let whole = Net::parse(&text, path).expect("a net");
        let leaving =
            |id: &str| whole.edges.iter().filter(|e| e.from.as_deref() == Some(id)).count();
        let busiest = whole.junctions.iter().map(|j| j.id.as_str()).max_by_key(|id| leaving(id));
        let one = busiest.expect("a junction");
        let part = cut(&text, path, &HashSet::from([one])).expect("a part");
        let part = Net::parse(&part, path).expect("a net");
        assert!(part.edges.len() < whole.edges.len());
        for edge in &part.edges {
            let same = &whole.edges[whole.edge_index(&edge.id).expect("an edge of the net")];
            assert_eq!((&edge.from, &edge.to), (&same.from, &same.to));
            for (a, b) in
                part.lanes[edge.lanes.clone()].iter().zip(&whole.lanes[same.lanes.clone()])
            {
                assert_eq!((&a.id, &a.shape, a.length), (&b.id, &b.shape, b.length));
            }
        }
        for edge in part.edges.iter().filter(|edge| edge.function == EdgeFunction::Normal) {
            let ends = [&edge.from, &edge.to].map(|id| id.as_deref());
            assert!(ends.contains(&Some(one)), "{edge:?}");
        }
        let all: HashSet<&str> = whole.junctions.iter().map(|j| j.id.as_str()).collect();
        let same = Net::parse(&cut(&text, path, &all).expect("all of it"), path).expect("a net");
        assert_eq!(same.lanes, whole.lanes);
        assert_eq!(same.connections, whole.connections);
    }
}
