//! Copies of one net side by side in one file, so that one SUMO process can host many worlds.
//!
//! Copy `w` has the prefix `w<w>.` before each id (after the colon of internal ids) and lies far
//! from the other copies. The file states lane lengths, and all copies keep them, so that positions
//! along a route, unlike coordinates, are the same numbers in every copy.

use std::{fmt::Write as _, path::Path as FilePath};

use roxmltree::Node;

use super::{NetError, read::document};
use crate::markup::escape_attribute;

/// Free space between two copies, in addition to the diagonal of one copy \[m\].
const GAP: f64 = 100.0;

/// A net file that holds all copies.
#[derive(Debug, Clone, PartialEq)]
pub struct Tiled {
    /// Content of the `.net.xml` file.
    pub text: String,
    /// Offset of each copy's coordinates from the original ones \[m\].
    pub offsets: Vec<[f64; 2]>,
}

/// Returns the id that an edge, lane or junction has in the copy `world`.
pub fn tiled_id(world: u32, id: &str) -> String {
    match id.strip_prefix(':') {
        Some(internal) => format!(":w{world}.{internal}"),
        None => format!("w{world}.{id}"),
    }
}

/// Writes `worlds` copies of a net into one file; `path` is used only in messages.
///
/// # Errors
/// As for [`super::Net::parse`].
pub fn tile(text: &str, path: &FilePath, worlds: u32) -> Result<Tiled, NetError> {
    let net = super::Net::parse(text, path)?;
    let document = document(text, path)?;
    let [low, high] = net.extent();
    let gap = GAP + (high[0] - low[0]).hypot(high[1] - low[1]);
    // Offsets are whole metres, so that the decimals of the coordinates stay the same.
    let pitch = [0, 1].map(|axis| (high[axis] - low[axis] + gap).ceil());
    let columns = f64::from(worlds).sqrt().ceil().max(1.0) as u32;
    let place = |w: u32| [pitch[0] * f64::from(w % columns), pitch[1] * f64::from(w / columns)];
    let offsets: Vec<[f64; 2]> = (0..worlds).map(place).collect();
    let root = document.root_element();
    let mut out = String::with_capacity(text.len() * worlds as usize);
    out.push_str("<net");
    for attribute in root.attributes().filter(|a| a.namespace().is_none()) {
        write_attribute(&mut out, attribute.name(), attribute.value());
    }
    out.push_str(">\n");
    let _ = writeln!(
        out,
        "<location netOffset=\"0,0\" convBoundary=\"{0},{1},{2},{3}\" origBoundary=\"{0},{1},{2},{3}\" projParameter=\"!\"/>",
        low[0],
        low[1],
        high[0] + pitch[0] * f64::from(columns - 1),
        high[1] + pitch[1] * f64::from(worlds.saturating_sub(1) / columns)
    );
    let children: Vec<Node> = root.children().filter(Node::is_element).collect();
    // SUMO expects the elements of a kind together: all edges before all junctions before all
    // connections.
    for kind in children.chunk_by(|a, b| a.tag_name() == b.tag_name()) {
        match kind[0].tag_name().name() {
            "location" => {}
            // Edge types belong to no copy: the file holds them once.
            "type" => kind.iter().for_each(|node| write_element(&mut out, *node, None)),
            _ => {
                for (world, offset) in offsets.iter().enumerate() {
                    for node in kind {
                        write_element(&mut out, *node, Some((world as u32, *offset)));
                    }
                }
            }
        }
    }
    out.push_str("</net>\n");
    Ok(Tiled { text: out, offsets })
}

fn write_element(out: &mut String, node: Node<'_, '_>, copy: Option<(u32, [f64; 2])>) {
    let name = node.tag_name().name();
    out.push('<');
    out.push_str(name);
    for attribute in node.attributes().filter(|a| a.namespace().is_none()) {
        let value = match copy {
            Some((world, offset)) => {
                moved(name, attribute.name(), attribute.value(), world, offset)
            }
            None => attribute.value().to_owned(),
        };
        write_attribute(out, attribute.name(), &value);
    }
    out.push('>');
    node.children().filter(Node::is_element).for_each(|child| write_element(out, child, copy));
    let _ = writeln!(out, "</{name}>");
}

pub(super) fn write_attribute(out: &mut String, name: &str, value: &str) {
    let _ = write!(out, " {name}=\"{}\"", escape_attribute(value));
}

/// Returns the value of an attribute in a copy.
fn moved(element: &str, attribute: &str, value: &str, world: u32, offset: [f64; 2]) -> String {
    let ids =
        || value.split_whitespace().map(|id| tiled_id(world, id)).collect::<Vec<_>>().join(" ");
    match (element, attribute) {
        (_, "shape" | "outlineShape") => value
            .split_whitespace()
            .map(|point| {
                let parts = point.split(',').enumerate();
                let parts = parts
                    .map(|(axis, text)| shifted(text, offset.get(axis).copied().unwrap_or(0.0)));
                parts.collect::<Vec<_>>().join(",")
            })
            .collect::<Vec<_>>()
            .join(" "),
        ("junction", "x") => shifted(value, offset[0]),
        ("junction", "y") => shifted(value, offset[1]),
        ("edge" | "lane" | "junction" | "tlLogic", "id")
        | ("edge" | "connection", "from" | "to")
        | ("edge", "bidi")
        | ("neigh", "lane")
        | ("connection", "via" | "tl") => tiled_id(world, value),
        ("edge", "crossingEdges")
        | ("junction", "incLanes" | "intLanes")
        | ("roundabout", "nodes" | "edges") => ids(),
        ("prohibition", _) => value
            .split("->")
            .map(|edge| tiled_id(world, edge.trim()))
            .collect::<Vec<_>>()
            .join("->"),
        _ => value.to_owned(),
    }
}

/// Returns a coordinate moved by whole metres, with as many decimals as before.
fn shifted(text: &str, by: f64) -> String {
    let decimals = text.split_once('.').map_or(0, |(_, decimals)| decimals.len()).min(9);
    match text.parse::<f64>() {
        Ok(value) if by != 0.0 => format!("{:.decimals$}", value + by),
        _ => text.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sumo::net::Net;

    #[test]
    fn copies_have_the_same_lengths_and_shapes_elsewhere() {
        let path = FilePath::new("sumo_nets/intersection/arm30.net.xml");
        let text = std::fs::read_to_string(path).unwrap();
        let one = Net::parse(&text, path).unwrap();
        let tiled = tile(&text, path, 5).unwrap();
        let many = Net::parse(&tiled.text, path).unwrap();
        assert_eq!(many.lanes.len(), 5 * one.lanes.len());
        assert_eq!(many.junctions.len(), 5 * one.junctions.len());
        assert_eq!(many.connections.len(), 5 * one.connections.len());
        for (world, offset) in tiled.offsets.iter().enumerate() {
            for edge in &one.edges {
                let copy = &many.edges[many.edge_index(&tiled_id(world as u32, &edge.id)).unwrap()];
                for (a, b) in
                    one.lanes[edge.lanes.clone()].iter().zip(&many.lanes[copy.lanes.clone()])
                {
                    assert_eq!((a.length, a.width, a.speed), (b.length, b.width, b.speed));
                    for (p, q) in a.shape.iter().zip(&b.shape) {
                        assert!(
                            (0..2).all(|i| (p[i] + offset[i] - q[i]).abs() < 1e-9),
                            "{p:?} {q:?}"
                        );
                    }
                }
            }
        }
        let far = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]) >= GAP;
        for (i, a) in tiled.offsets.iter().enumerate() {
            assert!(tiled.offsets[..i].iter().all(|b| far(*a, *b)));
        }
    }

    #[test]
    fn ids_and_coordinates() {
        assert_eq!(tiled_id(3, ":centre_0_0"), ":w3.centre_0_0");
        assert_eq!(moved("prohibition", "prohibitor", "a->b", 1, [0.0; 2]), "w1.a->w1.b");
        assert_eq!(
            moved("lane", "shape", "1.50,-2.25,3 4,5", 0, [10.0, 20.0]),
            "11.50,17.75,3 14,25"
        );
        assert_eq!(moved("lane", "speed", "13.9", 4, [10.0, 20.0]), "13.9");
    }
}
