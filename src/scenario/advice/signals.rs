//! Advice on traffic lights.

use std::collections::BTreeSet;

use super::{Adviser, Finding, Map, Net};
use crate::sumo::net::shorten;

/// Returns the traffic light of each signal on the routes of agents.
pub(super) fn on_routes(map: &Map) -> impl Iterator<Item = usize> + '_ {
    let signals = map.paths.iter().flat_map(|path| map.net.signals_on(path));
    signals.map(|(_, signal)| signal.traffic_light)
}

impl Adviser<'_, '_, '_> {
    /// Warns of signals that agents do not observe or need not obey, and of programs of traffic
    /// lights about which agents know less, or which cost more time.
    pub(super) fn signals(&self, maps: &[(&Net, &Map)], findings: &mut Vec<Finding>) {
        let mut ruled = false;
        for (net, map) in maps {
            let lights: BTreeSet<usize> = on_routes(map).collect();
            ruled |= !lights.is_empty();
            for light in lights.into_iter().map(|light| &map.net.traffic_lights[light]) {
                let id = shorten(&light.id);
                if light.kind == "off" {
                    findings.push(self.net_warning(
                        "signals-off",
                        net,
                        format!("the program of traffic light `{id}` is off, so that the signs of the junction count, which agents do not observe"),
                        "give the traffic light a program with phases as the last one in the net",
                    ));
                } else if !light.is_static() {
                    findings.push(self.net_warning(
                        "signals-react",
                        net,
                        format!(
                            "the program of traffic light `{id}` is of type `{}`: agents do not observe when it changes, and each world needs a SUMO process \
                             of its own, which is renewed for each episode",
                            shorten(&light.kind)
                        ),
                        "a program of type `static` makes training faster",
                    ));
                }
            }
        }
        if ruled && !self.scenario.observation.signals {
            findings.push(self.warning(
                "signals",
                ["observation", "signals"],
                "signals rule routes of agents, which do not observe them".into(),
                "set signals=\"true\"",
            ));
        }
        if ruled && self.scenario.reward.red_light == 0.0 {
            findings.push(self.warning(
                "red-light",
                ["reward", "redLight"],
                "signals rule routes of agents, but nothing keeps agents from passing red".into(),
                "set redLight to a number below 0, such as ten times the reward of a crash",
            ));
        }
    }
}
