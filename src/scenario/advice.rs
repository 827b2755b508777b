//! Warnings about settings of a scenario that are allowed but probably not intended: one function
//! per rule.

mod driver;
mod idle;
mod signals;

use std::collections::BTreeSet;

pub use idle::without_effect;

use super::author::{State, state};
use super::check::{Map, net_nodes};
use super::reader::Reader;
use super::{Demand, Finding, LeftOut, Net, Occlusion, Scenario, Severity, Vehicle, describe};
use crate::sumo::net::{EdgeFunction, Path, shorten};
use crate::words::counted;

/// A horizon shorter than this multiple of the longest trip at the speed limits gives a warning.
const PATIENCE: f64 = 2.0;
/// The same for agents of route files: one that departs later than this multiple before the horizon
/// does not count.
const PATIENCE_OF_FILES: f64 = 4.0;
/// Length of a vehicle up to which it has left a conflict point with its whole body where observations
/// show the conflict as left \[m\].
const LONGEST: f64 = 12.0;
/// Speed that observations show as 1, with half a metre per second for rounding \[m/s\].
const FASTEST: f64 = 22.7;

/// Returns all advice on a scenario. `maps` are its nets and `demand` its route files, with `None` for
/// those that have errors.
pub(super) fn advise(
    scenario: &Scenario,
    maps: &[Option<Map>],
    demand: Option<&Demand>,
    reader: &Reader,
) -> Vec<Finding> {
    let adviser = Adviser { scenario, reader };
    let mut findings = Vec::new();
    let sound: Vec<(&Net, &Map)> = scenario
        .nets
        .iter()
        .zip(maps)
        .filter_map(|(net, map)| Some((net, map.as_ref()?)))
        .collect();
    for (net, map) in &sound {
        adviser.junctions(net, map, &mut findings);
        adviser.internal_lanes(net, map, &mut findings);
        adviser.zippers(net, map, &mut findings);
        findings.extend(adviser.stretched(net, map));
        adviser.limits(net, map, &mut findings);
    }
    adviser.signals(&sound, &mut findings);
    for net in &scenario.nets {
        findings.extend(adviser.sources(net));
    }
    findings.extend(adviser.horizon(&sound));
    findings.extend(adviser.radio(&sound));
    findings.extend(adviser.sight());
    findings.extend(scenario.occlusion.as_ref().and_then(Occlusion::others));
    findings.extend(adviser.reward());
    adviser.vehicle(&mut findings);
    adviser.unused(&mut findings);
    adviser.without_effect(&sound, &mut findings);
    findings.extend(left_out(&sound));
    if let Some(demand) = demand {
        findings.extend(unused(demand));
        findings.extend(unsorted(demand));
        findings.extend(adviser.outside(&sound, demand));
        findings.extend(adviser.stops(&sound, demand));
    }
    findings
}

struct Adviser<'a, 'doc, 'input> {
    scenario: &'a Scenario,
    reader: &'a Reader<'doc, 'input>,
}

impl Adviser<'_, '_, '_> {
    /// Returns a warning about the attribute `key` of the first element called `element`.
    fn warning(
        &self,
        kind: &'static str,
        [element, key]: [&'static str; 2],
        message: String,
        hint: &str,
    ) -> Finding {
        Finding::warning(kind, self.reader.place_in(element, key), message, hint)
    }

    fn net_warning(&self, kind: &'static str, net: &Net, message: String, hint: &str) -> Finding {
        let index = self.scenario.nets.iter().position(|other| std::ptr::eq(other, net));
        let node = index.and_then(|index| net_nodes(self.reader).get(index).copied());
        let place = node.map_or_else(|| self.reader.at(0), |node| self.reader.place(node, "file"));
        Finding::warning(kind, place, message, hint)
    }

    /// Returns a warning about a route with the index `route`.
    fn route_warning(
        &self,
        kind: &'static str,
        route: usize,
        message: String,
        hint: &str,
    ) -> Finding {
        let node = self.reader.all("route").nth(route);
        let place = node.map_or_else(|| self.reader.at(0), |node| self.reader.place(node, "id"));
        Finding::warning(kind, place, message, hint)
    }

    /// Warns of vehicles that observations were not made for.
    fn vehicle(&self, findings: &mut Vec<Finding>) {
        let Vehicle { length, max_speed, .. } = self.scenario.vehicle;
        if length > LONGEST {
            findings.push(self.warning(
                "long-vehicle",
                ["vehicle", "length"],
                format!("observations show a conflict as left while a vehicle of {length} m still covers it"),
                "make vehicles at most 12 m long",
            ));
        }
        if max_speed > FASTEST {
            findings.push(self.warning(
                "fast-vehicle",
                ["vehicle", "maxSpeed"],
                format!("observations show all speeds from {FASTEST} m/s on as the same, and vehicles drive {max_speed} m/s"),
                "set maxSpeed to 22.222 or less, or expect agents that cannot tell these speeds apart",
            ));
        }
    }

    /// Warns of junctions in which SUMO detects no collisions.
    fn junctions(&self, net: &Net, map: &Map, findings: &mut Vec<Finding>) {
        let passed = |id: &str| {
            let inner = |path: &Path| {
                let edges = path.edges.iter().take(path.edges.len() - 1);
                edges
                    .filter_map(|edge| map.net.edge_index(edge))
                    .any(|i| map.net.edges[i].to.as_deref() == Some(id))
            };
            map.paths.iter().any(inner)
        };
        for junction in map.net.junctions.iter().filter(|junction| passed(&junction.id)) {
            let id = shorten(&junction.id);
            if junction.is_unregulated() {
                findings.push(self.net_warning(
                    "unregulated-junction",
                    net,
                    format!("junction `{id}` is of type `{}`, where SUMO detects no collisions", junction.kind),
                    "set the type `priority` or `right_before_left` in the net's sources and run `iwol scenario build`; otherwise SUMO \
                     cannot confirm the collisions that this program detects",
                ));
            }
        }
    }

    /// Warns of nets without lanes over junctions, in which vehicles jump from road to road.
    fn internal_lanes(&self, net: &Net, map: &Map, findings: &mut Vec<Finding>) {
        let road =
            |lane: usize| map.net.edges[map.net.lanes[lane].edge].function == EdgeFunction::Normal;
        let jumps = |path: &&Path| path.lanes.windows(2).any(|pair| road(pair[0]) && road(pair[1]));
        if map.paths.iter().any(|path| jumps(&path)) {
            findings.push(self.net_warning(
                "no-internal-lanes",
                net,
                "the net has no lanes over its junctions: vehicles jump from road to road".into(),
                "build the net without netconvert's option `no-internal-links`",
            ));
        }
    }

    /// Warns of agents that can drive faster than the speed limit of a lane.
    fn limits(&self, net: &Net, map: &Map, findings: &mut Vec<Finding>) {
        let top = self.scenario.vehicle.max_speed;
        let lanes = map.paths.iter().flat_map(|path| &path.lanes).map(|&lane| &map.net.lanes[lane]);
        let roads = lanes.filter(|lane| map.net.edges[lane.edge].function == EdgeFunction::Normal);
        let slowest = roads.min_by(|a, b| a.speed.total_cmp(&b.speed));
        if let Some(lane) = slowest.filter(|lane| lane.speed < 0.99 * top) {
            let (id, limit) = (shorten(&lane.id), lane.speed);
            findings.push(self.warning(
                "speed-limit",
                ["vehicle", "maxSpeed"],
                format!(
                    "agents may drive {top} m/s, but the speed limit of lane `{id}` of {} is {limit} m/s",
                    net.file.display()
                ),
                "speed limits of lanes do not slow agents down; reduce maxSpeed if agents should keep the limit",
            ));
        }
    }

    /// Warns of a net that is older than its sources, or whose configuration cannot be read.
    fn sources(&self, net: &Net) -> Option<Finding> {
        match state(&net.file) {
            Ok(State::OutOfDate) if net.file.exists() => Some(self.net_warning(
                "outdated-net",
                net,
                format!("{} is older than its sources", net.file.display()),
                "run `iwol scenario build` on the scenario",
            )),
            Err(error) => Some(self.net_warning(
                "netconvert-configuration",
                net,
                error.to_string(),
                "correct or delete the configuration of netconvert",
            )),
            Ok(_) => None,
        }
    }

    /// Warns of a horizon that is short for the longest trip. If the trip exceeds the horizon even
    /// at the speed limits, the finding is an error.
    fn horizon(&self, maps: &[(&Net, &Map)]) -> Option<Finding> {
        let trips = maps.iter().flat_map(|(net, map)| {
            let trip = |row: &super::SpawnRow, route: usize| {
                let path = &map.paths[route];
                let end =
                    path.arc(path.edges.len() - 1, self.scenario.routes[route].arrival_pos)?;
                let id = self.scenario.routes[route].id.as_str();
                Some((self.time(map, path, path.arc(0, row.first)?, end), id))
            };
            let of_files = map.paths[self.scenario.routes.len()..].iter().zip(&map.of_files);
            // Vehicles that drive laps are meant to drive until the episode ends.
            let of_files = of_files.filter(|(path, _)| !path.edges[1..].contains(&path.edges[0]));
            let of_files =
                of_files.map(|(path, id)| (self.time(map, path, 0.0, path.length()), id.as_str()));
            let placed = net.spawns.iter();
            placed
                .flat_map(move |row| row.routes.iter().filter_map(move |&route| trip(row, route)))
                .chain(of_files)
        });
        let (time, id) = trips.max_by(|a, b| a.0.total_cmp(&b.0))?;
        let (steps, horizon) =
            (time / self.scenario.control.interval, f64::from(self.scenario.termination.horizon));
        let id = shorten(id);
        let from_files = self.scenario.agents.come_from_files();
        let need = (PATIENCE_OF_FILES * steps).ceil();
        if from_files && (PATIENCE * steps..=need).contains(&horizon) {
            let message = format!(
                "agents on route `{id}` never count in results: one counts if it departs more than {need} steps before the horizon of {horizon}"
            );
            let hint = format!("set the horizon to {:.0} steps or more", 2.0 * need);
            return Some(self.warning("horizon", ["termination", "horizon"], message, &hint));
        }
        if PATIENCE * steps <= horizon {
            return None;
        }
        let message = format!(
            "route `{id}` takes {steps:.0} steps at the speed limit, but the horizon is {horizon} steps"
        );
        let hint = format!(
            "set the horizon to {:.0} steps or more, because vehicles have to wait",
            if from_files { 2.0 * need } else { (4.0 * steps).ceil() }
        );
        let finding = self.warning("horizon", ["termination", "horizon"], message, &hint);
        let severity = if steps > horizon { Severity::Error } else { Severity::Warning };
        Some(Finding { severity, ..finding })
    }

    /// Returns the travel time between two positions on a path at the speed limits of lanes and
    /// vehicle \[s\].
    fn time(&self, map: &Map, path: &Path, from: f64, to: f64) -> f64 {
        let stretch = |(lane, begin, end): (usize, f64, f64)| {
            let speed = map.net.lanes[lane].speed.min(self.scenario.vehicle.max_speed).max(0.1);
            (end.min(to) - begin.max(from)).max(0.0) / speed
        };
        path.lane_stretches().map(stretch).sum()
    }

    /// Warns of a communication range that reaches every agent or no other agent: training then
    /// says nothing about communication.
    fn radio(&self, maps: &[(&Net, &Map)]) -> Option<Finding> {
        let range = self.scenario.communication.range;
        let warn = |message: String, hint: &str| {
            Some(self.warning("range", ["communication", "range"], message, hint))
        };
        let spacings =
            self.scenario.nets.iter().flat_map(|net| &net.spawns).filter(|row| row.count > 1);
        let nearest = spacings.map(|row| row.spacing).fold(f64::INFINITY, f64::min);
        if range < nearest && nearest.is_finite() {
            return warn(
                format!(
                    "agents cannot communicate with the next agent in their row: the range is {range} m, the distance {nearest} m"
                ),
                "increase the range, unless agents should not communicate",
            );
        }
        let diagonal = |(_, map): &(&Net, &Map)| {
            let [[left, bottom], [right, top]] = map.net.extent();
            (right - left).hypot(top - bottom)
        };
        let largest = maps.iter().map(diagonal).fold(0.0, f64::max);
        if largest > 0.0 && range >= largest && self.scenario.everybody_is_nearest() {
            return warn(
                format!(
                    "all agents can communicate with each other: the range is {range} m, and the largest net is {largest:.0} m across"
                ),
                "reduce the range if communication should depend on the distance between agents",
            );
        }
        None
    }

    /// Warns of observations that do not contain the vehicles that an agent must stop for.
    fn sight(&self) -> Option<Finding> {
        let (v, c, o) = (self.scenario.vehicle, &self.scenario.control, self.scenario.observation);
        let blind = (!o.groups.nearest() || o.neighbours == 0)
            && (!o.groups.conflict() || o.conflict_streams == 0)
            && o.encounters == 0
            && o.lidar.beams == 0;
        if blind {
            return Some(self.warning(
                "blind",
                ["observation", "groups"],
                "agents observe no vehicle that crosses their route".into(),
                "set one of neighbours (with groups `nearest`), conflictStreams (with groups `conflict`), encounters and lidarBeams \
                 to a number above 0",
            ));
        }
        let hardest = c.brake.last().map_or(c.drag, |point| point.1).max(1e-3);
        let needed = v.max_speed * v.max_speed / (2.0 * hardest) + v.max_speed * c.interval;
        (o.detection_range < needed).then(|| {
            self.warning(
                "sight",
                ["observation", "detectionRange"],
                format!(
                    "at {} m/s a vehicle needs {needed:.0} m to stop, but agents observe only {} m",
                    v.max_speed, o.detection_range
                ),
                "increase detectionRange, or reduce maxSpeed",
            )
        })
    }

    /// Warns of rewards under which standing still or crashing is the best policy.
    fn reward(&self) -> Option<Finding> {
        let reward = self.scenario.reward;
        let warn = |key, message: &str| {
            Some(self.warning(
                "reward",
                ["reward", key],
                message.into(),
                "scenarios/intersection.xml has weights with which agents learn",
            ))
        };
        if reward.progress <= 0.0 && reward.arrive <= 0.0 && reward.speed <= 0.0 {
            return warn("arrive", "no weight rewards progress, speed or arrival");
        }
        if reward.crash >= reward.arrive {
            return warn("crash", "the reward of a crash is not below the reward of an arrival");
        }
        None
    }

    /// Warns of routes that no spawn place uses.
    fn unused(&self, findings: &mut Vec<Finding>) {
        for (i, route) in self.scenario.routes.iter().enumerate() {
            let used = self
                .scenario
                .nets
                .iter()
                .flat_map(|net| &net.spawns)
                .any(|row| row.routes.contains(&i));
            if !used {
                findings.push(self.route_warning(
                    "unused-route",
                    i,
                    format!("no spawn place uses the route `{}`", shorten(&route.id)),
                    "name the route in a <spawn>, or delete the route",
                ));
            }
        }
    }

    /// Warns of route files of which nobody, or not everybody, departs within an episode.
    fn outside(&self, maps: &[(&Net, &Map)], demand: &Demand) -> Option<Finding> {
        let (_, map) = maps.first()?;
        let traffic = &self.scenario.traffic;
        let warn = |kind, message, hint: &str| {
            Some(self.warning(kind, ["traffic", "files"], message, hint))
        };
        let Some(first) = demand.first_departure() else {
            // Files may be there for the types of the vehicles at spawn places only.
            let unused = !traffic.files.is_empty() && traffic.kind.is_none();
            let message = "no vehicle or person of the route files ever departs".to_owned();
            let hint = "name a file with vehicles, trips, flows or persons";
            return if unused { warn("nobody-departs", message, hint) } else { None };
        };
        let begin = traffic.begin.0;
        let duration =
            f64::from(self.scenario.termination.horizon) * self.scenario.control.interval;
        let episode = format!(
            "within an episode, from {begin} s to {} s of the files' time",
            (1000.0 * (begin + duration)).round() / 1000.0
        );
        let (wanted, outside) = (map.plan.wanted, map.plan.outside);
        if wanted == 0 {
            let message = format!(
                "nobody of the route files departs {episode}: their first departure is at {first} s"
            );
            let hint = format!("set begin=\"{first}\" of <traffic>, or another time of the files");
            return warn("nobody-departs", message, &hint);
        }
        let message = format!(
            "{outside} of {} vehicles, persons and flows of the route files do not depart {episode}",
            wanted + outside
        );
        let hint = "lengthen the horizon or set begin of <traffic>, if they should";
        if outside > 0 { warn("departs-outside", message, hint) } else { None }
    }

    /// Warns of agents from route files that have stops.
    fn stops(&self, maps: &[(&Net, &Map)], demand: &Demand) -> Option<Finding> {
        let departures = maps.iter().flat_map(|(_, map)| &map.plan.departures);
        let stops = departures.filter(|departure| !departure.stops.is_empty());
        let stops: BTreeSet<usize> = stops
            .map(|departure| departure.source)
            .filter(|&source| self.scenario.agents.includes_some(demand, source))
            .collect();
        let first = &demand.sources[*stops.first()?];
        let message = format!(
            "agents make no stops, but {} of the route files' vehicles and flows that are agents have some, first the {} `{}`",
            stops.len(),
            first.element,
            shorten(&first.id)
        );
        let hint = "delete the stops, or let other types and vehicles be agents";
        Some(Finding::warning("agents-stop", first.place.clone(), message, hint))
    }

    /// Warns of attributes that other values of the scenario make ineffective.
    fn without_effect(&self, maps: &[(&Net, &Map)], findings: &mut Vec<Finding>) {
        let signals = |(_, map): &(&Net, &Map)| signals::on_routes(map).next().is_some();
        let free = !maps.is_empty() && !maps.iter().any(signals);
        let ruled = [
            ("observation", "signals", free, "no signal rules a route"),
            ("reward", "redLight", free, "no signal rules a route"),
        ];
        let ruled = ruled.into_iter().filter(|rule| rule.2).map(|(e, key, _, why)| (e, key, why));
        for (element, key, why) in without_effect(self.scenario).chain(ruled) {
            let known = describe().all().into_iter().find(|known| known.name == element);
            let default = known.and_then(|known| known.attribute(key)?.default.clone());
            let given = |node: &roxmltree::Node| {
                node.attribute(key).is_some_and(|value| Some(value) != default.as_deref())
            };
            if let Some(node) = self.reader.all(element).find(given) {
                let message = format!("{key} of <{element}> has no effect, because {why}");
                let hint = "delete the attribute, or change the other value";
                let place = self.reader.place(node, key);
                findings.push(Finding::warning("no-effect", place, message, hint));
            }
        }
    }
}

/// Warns of vehicles that are left out, of those in the net that lacks most.
fn left_out(maps: &[(&Net, &Map)]) -> Option<Finding> {
    let plans = maps.iter().map(|(_, map)| &map.plan);
    let plan = plans.max_by_key(|plan| plan.left_out.len())?;
    LeftOut::finding(&plan.left_out, plan.wanted, "left out")
}

/// Warns of attributes of the route files that have no effect: SUMO does not know them, or SUMO
/// uses them and this program does not.
/// Warns of vehicles that SUMO itself would ignore.
fn unsorted(demand: &Demand) -> Option<Finding> {
    let (count, id, place) = demand.unsorted.as_ref()?;
    let message = format!(
        "the file is not sorted by departure time: SUMO's own run ignores {count} of its vehicles and flows, which depart earlier than one before them, such as `{}`; here they drive",
        shorten(id)
    );
    let hint =
        "sort the file (SUMO's tools/route/sort_routes.py) before you compare with SUMO's own run";
    Some(Finding::warning("unsorted", place.clone(), message, hint))
}

fn unused(demand: &Demand) -> impl Iterator<Item = Finding> {
    demand.unused.iter().map(|((element, key), (count, place))| {
        let message = format!("{key} of <{element}> has no effect ({})", counted(count, "time"));
        let hint = "correct its name, or delete the attribute if the traffic does not depend on it";
        Finding::warning("no-effect", place.clone(), message, hint)
    })
}

#[cfg(test)]
mod tests;
