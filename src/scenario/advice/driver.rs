//! Advice on parts of nets that SUMO's driver does not master.

use std::collections::{BTreeSet, HashMap};

use super::{Adviser, Finding, Map, Net, Severity, shorten};

/// Largest number of lanes that a zipper junction may join to one, for SUMO's driver.
const JOINED: usize = 2;

/// SUMO's metres per metre of shape of a lane from which on its driver's gaps become shorter than
/// vehicles: a vehicle and its gap of 2.5 m have the length of the vehicle alone on the ground.
const STRETCHED: f64 = 1.5;

impl Adviser<'_, '_, '_> {
    /// Reports the zipper junctions at which SUMO ends when one of its vehicles comes near: an error
    /// where SUMO drives some of the vehicles, and a warning where it does so only in an evaluation
    /// of its driver.
    pub(super) fn zippers(&self, net: &Net, map: &Map, findings: &mut Vec<Finding>) {
        let mixed = self.scenario.traffic.is_mixed(self.scenario.agents.default);
        for junction in map.net.junctions.iter().filter(|junction| junction.kind == "zipper") {
            let mut joined: HashMap<usize, usize> = HashMap::new();
            for connection in &map.net.connections {
                let edge = &map.net.edges[map.net.lanes[connection.from].edge];
                if edge.to.as_ref() == Some(&junction.id) {
                    *joined.entry(connection.to).or_default() += 1;
                }
            }
            let most = joined.into_values().max().unwrap_or(0);
            if most <= JOINED {
                continue;
            }
            let message = format!(
                "the zipper junction `{}` joins {most} lanes to one: SUMO ends when one of its own vehicles comes near",
                shorten(&junction.id)
            );
            let hint = "join at most two lanes to one in the net's sources, or set the type `priority`, and run `iwol scenario build`";
            let finding = self.net_warning("zipper-junction", net, message, hint);
            let severity = if mixed { Severity::Error } else { Severity::Warning };
            findings.push(Finding { severity, ..finding });
        }
    }

    /// Warns of lanes whose length for SUMO is much larger than that of their shape, on which the
    /// vehicles that SUMO drives overlap.
    pub(super) fn stretched(&self, net: &Net, map: &Map) -> Option<Finding> {
        let lanes: BTreeSet<usize> = map.paths.iter().flat_map(|path| path.lanes.clone()).collect();
        let lanes = lanes.into_iter().map(|lane| &map.net.lanes[lane]);
        let stretched: Vec<_> = lanes.filter(|lane| lane.stretch() > STRETCHED).collect();
        let most = stretched.iter().max_by(|a, b| a.stretch().total_cmp(&b.stretch()))?;
        let (id, length) = (shorten(&most.id), most.length);
        let message = format!(
            "{} for SUMO than by shape, most of all `{id}`, {length} m instead of {:.0} m: \
             SUMO's driver keeps its distances in SUMO's metres, so that its vehicles can overlap on the ground",
            match stretched.len() {
                1 => "a lane of the routes is longer".to_owned(),
                count => format!("{count} lanes of the routes are longer"),
            },
            length / most.stretch()
        );
        let hint = "delete `length` of the edges in the net's sources and run `iwol scenario build`, or do not compare with SUMO's driver";
        Some(self.net_warning("stretched-lane", net, message, hint))
    }
}
