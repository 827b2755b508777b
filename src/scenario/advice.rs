//! Warnings about settings of a scenario that are allowed but probably not intended: one function
//! per rule.

use super::author::{State, state};
use super::check::Map;
use super::finding::{Finding, Position, Severity};
use super::reader::Reader;
use super::{Net, Scenario};
use crate::sumo::net::{EdgeFunction, Path, shorten};

/// A horizon shorter than this multiple of the longest trip at the speed limits gives a warning.
const PATIENCE: f64 = 2.0;

/// Returns all advice on a scenario. `maps` are its nets, with `None` for nets that have errors.
pub(super) fn advise(scenario: &Scenario, maps: &[Option<Map>], reader: &Reader) -> Vec<Finding> {
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
        adviser.limits(net, map, &mut findings);
        adviser.forks(net, map, &mut findings);
    }
    for net in &scenario.nets {
        findings.extend(adviser.sources(net));
    }
    findings.extend(adviser.horizon(&sound));
    findings.extend(adviser.radio(&sound));
    findings.extend(adviser.sight());
    findings.extend(adviser.reward());
    adviser.unused(&mut findings);
    findings
}

struct Adviser<'a, 'doc, 'input> {
    scenario: &'a Scenario,
    reader: &'a Reader<'doc, 'input>,
}

impl Adviser<'_, '_, '_> {
    /// Returns a warning about the attribute `key`, at the first element `element` for which
    /// `which` accepts the attribute's value.
    fn warning(
        &self,
        element: &str,
        key: &str,
        which: impl Fn(&str) -> bool,
        message: String,
        hint: &str,
    ) -> Finding {
        let elements = self.reader.document.descendants().filter(|node| node.has_tag_name(element));
        let node = elements.into_iter().find(|node| node.attribute(key).is_some_and(&which));
        let at = node.map(|node| {
            let (line, column) = self.reader.position(Reader::offset(node, key));
            Position { line, column }
        });
        let file = self.scenario.path.clone();
        Finding { severity: Severity::Warning, file, at, message, hint: Some(hint.to_owned()) }
    }

    fn net_warning(&self, net: &Net, message: String, hint: &str) -> Finding {
        let folder = self.scenario.path.parent().unwrap_or(std::path::Path::new(""));
        self.warning("net", "file", |file| folder.join(file) == net.file, message, hint)
    }

    /// Warns of junctions with rules that do not suit agents, which observe neither signals nor
    /// signs.
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
            if junction.kind == "unregulated" {
                findings.push(self.net_warning(
                    net,
                    format!("junction `{id}` is of type `unregulated`, in which SUMO sees no collisions"),
                    "make it `priority` or `right_before_left` in the sources and build again, or live without SUMO's half of the audit",
                ));
            }
            if junction.kind.starts_with("traffic_light") || junction.kind == "rail_signal" {
                findings.push(self.net_warning(
                    net,
                    format!("junction `{id}` has signals, which agents do not see"),
                    "make it `priority` in the sources, or give netconvert `--tls.discard-loaded`, and build again",
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
                net,
                "the net has no lanes over its junctions: vehicles jump from road to road".into(),
                "build it without netconvert's `--no-internal-links`",
            ));
        }
    }

    /// Warns of lanes that lead to several lanes of the next road: SUMO chooses between them and
    /// may not choose the lane of the route.
    fn forks(&self, net: &Net, map: &Map, findings: &mut Vec<Finding>) {
        if self.scenario.control.steering.is_some() {
            return;
        }
        for (route, path) in self.scenario.routes.iter().zip(&map.paths) {
            if let Some(lane) = map.net.fork(path) {
                findings.push(self.warning(
                    "route",
                    "id",
                    |id| id == route.id,
                    format!(
                        "in {} lane `{}` leads to several lanes of the next road, of which SUMO may choose another than the route `{}`",
                        net.file.display(),
                        shorten(&map.net.lanes[lane].id),
                        shorten(&route.id)
                    ),
                    "leave one of its connections in the .con.xml, and build again",
                ));
            }
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
                "vehicle",
                "maxSpeed",
                |_| true,
                format!(
                    "agents may drive {top} m/s, but the limit of lane `{id}` of {} is {limit} m/s",
                    net.file.display()
                ),
                "nothing holds agents to limits but maxSpeed; lower it if they count",
            ));
        }
    }

    /// Warns of a net that is older than its sources, or whose configuration cannot be read.
    fn sources(&self, net: &Net) -> Option<Finding> {
        match state(&net.file) {
            Ok(State::OutOfDate) if net.file.exists() => Some(self.net_warning(
                net,
                format!("{} is older than its sources", net.file.display()),
                "run `iwol scenario build` on the scenario",
            )),
            Err(error) => Some(self.net_warning(
                net,
                error.to_string(),
                "correct or delete the configuration",
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
                Some((self.time(map, path, path.arc(0, row.first)?, end), route))
            };
            net.spawns
                .iter()
                .flat_map(move |row| row.routes.iter().filter_map(move |&route| trip(row, route)))
        });
        let (time, route) = trips.max_by(|a, b| a.0.total_cmp(&b.0))?;
        let (steps, horizon) =
            (time / self.scenario.control.interval, f64::from(self.scenario.termination.horizon));
        if PATIENCE * steps <= horizon {
            return None;
        }
        let id = shorten(&self.scenario.routes[route].id);
        let message = format!(
            "route `{id}` takes {steps:.0} steps at the speed limit, and the horizon is {horizon}"
        );
        let hint = format!(
            "give the horizon {:.0} steps or more, as vehicles have to wait",
            (4.0 * steps).ceil()
        );
        let finding = self.warning("termination", "horizon", |_| true, message, &hint);
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
            Some(self.warning("communication", "range", |_| true, message, hint))
        };
        let spacings =
            self.scenario.nets.iter().flat_map(|net| &net.spawns).filter(|row| row.count > 1);
        let nearest = spacings.map(|row| row.spacing).fold(f64::INFINITY, f64::min);
        if range < nearest && nearest.is_finite() {
            return warn(
                format!(
                    "with a range of {range} m no vehicle hears the next one in its row, {nearest} m away"
                ),
                "make the range longer, unless nobody is to communicate",
            );
        }
        let diagonal = |(_, map): &(&Net, &Map)| {
            let [[left, bottom], [right, top]] = map.net.extent();
            (right - left).hypot(top - bottom)
        };
        let largest = maps.iter().map(diagonal).fold(0.0, f64::max);
        if largest > 0.0 && range >= largest {
            return warn(
                format!(
                    "with a range of {range} m every vehicle hears every other: the largest net is {largest:.0} m across"
                ),
                "make the range shorter if it is to matter who is near whom",
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
                "observation",
                "groups",
                |_| true,
                "agents observe no vehicle that crosses their route".into(),
                "set neighbours (nearest), conflictStreams (conflict), encounters or lidarBeams above 0",
            ));
        }
        let hardest = c.brake.last().map_or(c.drag, |point| point.1).max(1e-3);
        let needed = v.max_speed * v.max_speed / (2.0 * hardest) + v.max_speed * c.interval;
        (o.detection_range < needed).then(|| {
            self.warning(
                "observation",
                "detectionRange",
                |_| true,
                format!(
                    "at {} m/s a vehicle needs {needed:.0} m to stop, and sees {} m",
                    v.max_speed, o.detection_range
                ),
                "make the range longer, or maxSpeed lower",
            )
        })
    }

    /// Warns of rewards under which standing still or crashing is the best policy.
    fn reward(&self) -> Option<Finding> {
        let reward = self.scenario.reward;
        let warn = |key: &str, message: &str| {
            Some(self.warning(
                "reward",
                key,
                |_| true,
                message.into(),
                "see the weights in scenarios/intersection.xml",
            ))
        };
        if reward.progress <= 0.0 && reward.arrive <= 0.0 && reward.speed <= 0.0 {
            return warn("arrive", "nothing rewards a vehicle that gets on or arrives");
        }
        if reward.crash >= reward.arrive {
            return warn("crash", "a crash is rewarded no less than an arrival");
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
                findings.push(self.warning(
                    "route",
                    "id",
                    |id| id == route.id,
                    format!("no vehicle takes the route `{}`", shorten(&route.id)),
                    "name it in a <spawn>, or delete it",
                ));
            }
        }
    }
}
