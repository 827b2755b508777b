//! Which lanes SUMO compares when it looks for collisions.
//!
//! On a road, SUMO tests vehicles of one lane, and those of the two directions of a road with
//! `bidi`. It tests a vehicle within a junction against those on the lanes that the junction's logic
//! names as foes of the vehicle's lane, and against those on lanes that begin where that lane
//! begins. The logic of a netconvert that saw no conflict, such as that of two opposing left turns
//! that cross, leaves lanes out that vehicles on both touch.

use std::collections::{HashMap, HashSet};

use roxmltree::Node;

use super::Net;

/// The pairs of lanes, as indices into [`Net::lanes`]: SUMO tests the vehicles on the first against
/// those on the second.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Foes(HashSet<(usize, usize)>);

impl Foes {
    /// Reads the logic of the junctions of a net. Parts that SUMO could not read either are left
    /// out.
    pub(super) fn read(root: Node, lanes: &HashMap<String, usize>, net: &Net) -> Self {
        let mut foes = Self::default();
        for edge in &net.edges {
            let back = edge.bidi.map(|back| net.edges[back].lanes.clone());
            for other in back.into_iter().flatten() {
                foes.0.extend(edge.lanes.clone().map(|lane| (lane, other)));
            }
        }
        let mut before: HashMap<usize, usize> = HashMap::new();
        let mut begun: HashMap<usize, Vec<usize>> = HashMap::new();
        for join in &net.connections {
            if let Some(via) = join.via {
                before.insert(via, join.from);
                begun.entry(join.from).or_default().push(via);
            }
        }
        for (k, &a) in begun.values().flat_map(|all| all.iter().enumerate()) {
            let from = before[&a];
            foes.0.extend(begun[&from][..k].iter().flat_map(|&b| [(a, b), (b, a)]));
        }
        let ids = |node: Node, key| -> Vec<Option<usize>> {
            let text = node.attribute(key).unwrap_or_default();
            text.split_whitespace().map(|id| lanes.get(id).copied()).collect()
        };
        for node in root.children().filter(|node| node.has_tag_name("junction")) {
            let inner = ids(node, "intLanes");
            if node.attribute("type") == Some("internal") {
                // Vehicles wait at the end of the first lane that comes in, and go on along the
                // lane after which the junction is named.
                let next = node.attribute("id").and_then(|id| lanes.get(id).copied());
                let first = ids(node, "incLanes").first().copied().flatten();
                for own in [first, next].into_iter().flatten() {
                    foes.0.extend(inner.iter().flatten().map(|&other| (own, other)));
                }
                continue;
            }
            for request in node.children().filter(|node| node.has_tag_name("request")) {
                let attribute = |key| request.attribute(key).unwrap_or_default();
                let index = attribute("index").parse::<usize>().ok();
                let own = index.and_then(|index| inner.get(index).copied().flatten());
                let (Some(own), false) = (own, matches!(attribute("cont"), "1" | "true")) else {
                    continue;
                };
                // The last character belongs to the first lane.
                let mut yields = attribute("response").bytes().rev();
                for (foe, &other) in attribute("foes").bytes().rev().zip(&inner) {
                    let yields = yields.next() == Some(b'1');
                    let (Some(other), b'1') = (other, foe) else { continue };
                    foes.0.insert((own, other));
                    if let (true, Some(&earlier)) = (yields, before.get(&other)) {
                        foes.0.insert((own, earlier));
                    }
                }
            }
        }
        foes
    }

    /// Returns whether SUMO tests vehicles on the first of two different lanes against those on the
    /// second.
    pub fn contain(&self, own: usize, other: usize) -> bool {
        self.0.contains(&(own, other))
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use crate::sumo::net::Net;

    /// In the nets that netconvert makes, SUMO compares lanes that cross or begin in one place, and
    /// none of two roads.
    #[test]
    fn lanes_that_cross_are_foes() {
        let net = Net::load(Path::new("sumo_nets/intersection_turns/two_lanes.net.xml"));
        let net = net.expect("a shipped net");
        let ways = |dir: &str| -> Vec<_> {
            let all = net.connections.iter().filter(|c| c.dir == dir);
            all.filter_map(|c| Some((net.lanes[c.from].edge, c.from, c.via?))).collect()
        };
        let (straight, left) = (ways("s"), ways("l"));
        assert!(!straight.is_empty() && !left.is_empty());
        for &(_, from, way) in &straight {
            assert!(!net.foes.contain(way, from) && !net.foes.contain(way, way));
            assert!(straight.iter().any(|&(_, _, other)| net.foes.contain(way, other)));
            for &(_, also, other) in left.iter().filter(|(_, also, _)| *also == from) {
                assert!(net.foes.contain(way, other) && net.foes.contain(other, way), "{also}");
            }
        }
    }

    #[test]
    fn the_logic_names_the_foes() {
        let edge = |id: &str, inner: &str| {
            format!(
                r#"<edge id="{id}" {inner}><lane id="{id}_0" index="0" speed="9" length="9" shape="0,0 9,0"/></edge>"#
            )
        };
        let roads: String = ["a", "b", "c", "d"].map(|id| edge(id, r#"from="x" to="y""#)).concat();
        let inner: String =
            [":y_0", ":y_1", ":y_2", ":y_3"].map(|id| edge(id, r#"function="internal""#)).concat();
        let text = format!(
            r#"<net><location convBoundary="0,0,9,9"/>{inner}{roads}
            <junction id="y" type="priority" x="0" y="0" incLanes="a_0 b_0 c_0" intLanes=":y_0_0 :y_1_0 :y_3_0">
            <request index="0" response="100" foes="100" cont="0"/><request index="1" response="000" foes="000" cont="0"/>
            <request index="2" response="000" foes="111" cont="1"/></junction>
            <junction id=":y_3_0" type="internal" x="0" y="0" incLanes=":y_2_0 a_0" intLanes=":y_0_0"/>
            <connection from="a" to="d" fromLane="0" toLane="0" via=":y_0_0"/><connection from="b" to="d" fromLane="0" toLane="0" via=":y_1_0"/>
            <connection from="c" to="d" fromLane="0" toLane="0" via=":y_2_0"/><connection from=":y_2" to="d" fromLane="0" toLane="0" via=":y_3_0"/></net>"#
        );
        let net = Net::parse(&text, Path::new("x.net.xml")).expect("a net");
        let lane = |id: &str| net.lanes.iter().position(|lane| lane.id == id).expect("a lane");
        let foes = |a, b| net.foes.contain(lane(a), lane(b));
        // A vehicle yields to those that wait within the junction, too, who are not tested against it.
        assert!(foes(":y_0_0", ":y_3_0") && foes(":y_3_0", ":y_0_0"));
        assert!(foes(":y_0_0", ":y_2_0") && foes(":y_2_0", ":y_0_0"));
        assert!(
            !foes(":y_0_0", ":y_1_0") && !foes(":y_1_0", ":y_2_0") && !foes(":y_1_0", ":y_3_0")
        );
    }
}
