//! Reads scenario files strictly: a misspelt key is an error, not a default, and every error has
//! its position.

use std::{
    collections::{HashMap, HashSet},
    path::Path,
};

use roxmltree::Node;

use super::{
    AgentRange, Border, Communication, Control, Error, Intention, Jitter, Lidar, NeighbourOrder,
    Net, Observation, ObservationGroups, Reward, Route, Scenario, SpawnRow, Steering, Termination,
    Traffic, Vehicle, check,
    check::{NetPlaces, RoutePlaces, StartPlaces},
    reader::{Names, Reader, document, finite, in_element},
};
use crate::sumo::net::{nearest, shorten, xml};

/// Largest file that is read \[bytes\].
const MAX_BYTES: u64 = 4 << 20;

/// Largest number of spawn places in a net.
const MAX_PLACES: u32 = 10_000;

/// Largest number of nets, of routes, and of edges of a route. The check locates every route in
/// every net.
const MAX_NETS: usize = 64;
const MAX_ROUTES: usize = 256;
const MAX_EDGES: usize = 4096;

/// Child elements of `<scenario>`.
const PARTS: Names = &[
    "description",
    "agents",
    "routes",
    "nets",
    "vehicle",
    "jitter",
    "control",
    "observation",
    "reward",
    "termination",
    "communication",
    "traffic",
];
const OBSERVATION: Names = &[
    "groups",
    "detectionRange",
    "neighbours",
    "neighbourOrder",
    "intention",
    "signalDistance",
    "conflictStreams",
    "streamVehicles",
    "encounters",
    "foresight",
    "priorityDistance",
    "borders",
    "lidarBeams",
    "lidarRange",
];
const REWARD: Names =
    &["progress", "speed", "arrive", "outOfRoad", "crash", "cooperation", "shareRange"];

impl Scenario {
    /// Reads a scenario file and checks it against its nets.
    ///
    /// # Errors
    /// [`Error`], with its position in the file, if the file cannot be read, contains something
    /// invalid, or does not fit its nets.
    pub fn load(path: &Path) -> Result<Self, Error> {
        let text = text(path)?;
        let document = document(&text, path)?;
        let reader = Reader { path, document: &document };
        let (scenario, places) = reader.scenario()?;
        let (errors, _) = check::nets(&scenario, &places, &reader);
        errors.into_iter().next().map_or(Ok(scenario), Err)
    }

    /// Reads a scenario file without its nets, which may be missing.
    ///
    /// # Errors
    /// As [`Scenario::load`], without errors of the nets.
    pub fn read(path: &Path) -> Result<Self, Error> {
        Self::parse(&text(path)?, path)
    }

    /// Returns whether `name` can be the name of a scenario, which is also the name of a folder.
    pub fn is_name(name: &str) -> bool {
        let valid = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_');
        (1..=64).contains(&name.len()) && name.chars().all(valid)
    }

    /// Reads a scenario from its text, without its nets. Paths of nets are relative to the folder
    /// of `path`.
    ///
    /// # Errors
    /// As [`Scenario::load`], without errors of the nets.
    pub fn parse(text: &str, path: &Path) -> Result<Self, Error> {
        if text.len() as u64 > MAX_BYTES {
            return Err(Error::TooLarge { path: path.into(), limit: MAX_BYTES });
        }
        let document = document(text, path)?;
        Reader { path, document: &document }.scenario().map(|(scenario, _)| scenario)
    }

    /// Returns the smallest net with a spawn place for each of `agents` agents.
    ///
    /// # Errors
    /// [`Error::Agents`] if the scenario does not accept this number.
    pub fn net_for(&self, agents: u32) -> Result<&Net, Error> {
        let AgentRange { min, max, .. } = self.agents;
        let refuse = |max| Error::Agents { path: self.path.clone(), agents, min, max };
        if !(min..=max).contains(&agents) {
            return Err(refuse(max));
        }
        let largest = self.nets.iter().map(Net::capacity).max().unwrap_or(0);
        let large_enough = self.nets.iter().filter(|net| net.capacity() >= agents);
        large_enough.min_by_key(|net| net.capacity()).ok_or_else(|| refuse(largest))
    }
}

/// Returns the text of a scenario or route file.
pub(super) fn text(path: &Path) -> Result<String, Error> {
    let text =
        xml::read(path, MAX_BYTES).map_err(|source| Error::Read { path: path.into(), source })?;
    text.ok_or_else(|| Error::TooLarge { path: path.into(), limit: MAX_BYTES })
}

impl<'a, 'input> Reader<'a, 'input> {
    pub(super) fn scenario(&self) -> Result<(Scenario, StartPlaces), Error> {
        let root = self.document.root_element();
        if !root.has_tag_name("scenario") {
            return Err(self.unknown(
                root,
                "element",
                root.tag_name().name(),
                "the file".into(),
                &["scenario"],
            ));
        }
        self.expect(root, &["name"], PARTS)?;
        let part = |name| self.child(root, name);

        let (routes, route_places) = self.routes(part("routes")?)?;
        let (nets, net_places) = self.nets(part("nets")?, &routes)?;
        let agents = self.agents(part("agents")?, &nets)?;
        let jitter = self.leaf(part("jitter")?, &["longitudinal", "lateral"])?;
        let traffic = root.children().find(|node| node.has_tag_name("traffic")).unwrap_or(root);
        let termination =
            self.leaf(part("termination")?, &["horizon", "wreckTime", "border", "brokenLines"])?;
        let places = StartPlaces {
            routes: route_places,
            nets: net_places,
            lateral: Self::offset(jitter, "lateral"),
            traffic_type: Self::offset(traffic, "type"),
            traffic_files: Self::offset(traffic, "files"),
            broken_lines: Self::offset(termination, "brokenLines"),
        };
        let vehicle = self.leaf(part("vehicle")?, &["length", "width", "maxSpeed"])?;
        let observation = self.leaf(part("observation")?, OBSERVATION)?;
        let intention = self.intention(observation)?;
        let reward = self.leaf(part("reward")?, REWARD)?;
        let communication = self.leaf(part("communication")?, &["range"])?;

        let scenario = Scenario {
            name: self.name(root)?,
            path: self.path.into(),
            description: self.description(part("description")?)?,
            agents,
            nets,
            routes,
            vehicle: Vehicle {
                length: self.positive(vehicle, "length")?,
                width: self.positive(vehicle, "width")?,
                max_speed: self.positive(vehicle, "maxSpeed")?,
            },
            jitter: Jitter {
                longitudinal: self.not_negative(jitter, "longitudinal")?,
                lateral: self.not_negative(jitter, "lateral")?,
            },
            control: self.control(part("control")?)?,
            observation: Observation {
                groups: self.groups(observation)?,
                detection_range: self.positive(observation, "detectionRange")?,
                neighbours: self.whole(observation, "neighbours", 0, 16)? as usize,
                neighbour_order: self.neighbour_order(observation)?,
                intention,
                signal_distance: self.signal_distance(observation, intention)?,
                conflict_streams: self.whole(observation, "conflictStreams", 0, 16)? as usize,
                stream_vehicles: self.whole(observation, "streamVehicles", 0, 16)? as usize,
                encounters: self.whole_or(observation, "encounters", 0, 16)? as usize,
                foresight: match observation.attribute("foresight") {
                    None => 0.0,
                    Some(_) => self.number(observation, "foresight", "0 to 10", |v| {
                        (0.0..=10.0).contains(&v)
                    })?,
                },
                priority_distance: match observation.attribute("priorityDistance") {
                    None => 0.0,
                    Some(_) => self.number(observation, "priorityDistance", "0 to 100", |v| {
                        (0.0..=100.0).contains(&v)
                    })?,
                },
                borders: match observation.attribute("borders") {
                    None => 0.0,
                    Some(_) => self
                        .number(observation, "borders", "0 to 20", |v| (0.0..=20.0).contains(&v))?,
                },
                lidar: Lidar {
                    beams: self.whole_or(observation, "lidarBeams", 0, Lidar::MOST as u32)?
                        as usize,
                    range: match observation.attribute("lidarRange") {
                        None => Lidar::default().range,
                        Some(_) => self.number(observation, "lidarRange", "1 to 200", |v| {
                            (1.0..=200.0).contains(&v)
                        })?,
                    },
                },
            },
            reward: Reward {
                progress: self.any(reward, "progress")?,
                speed: self.any(reward, "speed")?,
                arrive: self.any(reward, "arrive")?,
                out_of_road: self.any(reward, "outOfRoad")?,
                crash: self.any(reward, "crash")?,
                cooperation: self
                    .number(reward, "cooperation", "0 to 1", |v| (0.0..=1.0).contains(&v))?,
                share_range: match reward.attribute("shareRange") {
                    None => f64::INFINITY,
                    Some(_) => self.not_negative(reward, "shareRange")?,
                },
            },
            termination: Termination {
                horizon: self.whole(termination, "horizon", 1, 1_000_000)?,
                wreck_time: self.not_negative(termination, "wreckTime")?,
                border: self.border(termination)?,
                broken_lines: termination
                    .attribute("brokenLines")
                    .unwrap_or_default()
                    .split_whitespace()
                    .map(Into::into)
                    .collect(),
            },
            communication: Communication { range: self.not_negative(communication, "range")? },
            traffic: self.traffic(root)?,
        };
        Ok((scenario, places))
    }

    /// Returns an attribute as a whole number from 0 to `max`, or `otherwise` if the attribute is
    /// missing.
    fn whole_or(
        &self,
        node: Node<'a, 'input>,
        key: &'static str,
        otherwise: u32,
        max: u32,
    ) -> Result<u32, Error> {
        if node.has_attribute(key) { self.whole(node, key, 0, max) } else { Ok(otherwise) }
    }

    /// Reads the element `<traffic>`, which is optional.
    fn traffic(&self, root: Node<'a, 'input>) -> Result<Traffic, Error> {
        if !root.children().any(|node| node.has_tag_name("traffic")) {
            return Ok(Traffic::default());
        }
        let node =
            self.leaf(self.child(root, "traffic")?, &["penetration", "type", "files", "capacity"])?;
        let folder = self.path.parent().unwrap_or(Path::new(""));
        let otherwise = Traffic::default();
        let share = |v: f64| v > 0.0 && v <= 1.0;
        let files: Vec<_> = node
            .attribute("files")
            .unwrap_or("")
            .split_whitespace()
            .map(|f| folder.join(f))
            .collect();
        let kind = node.attribute("type").map(Into::into);
        if kind.is_some() && files.is_empty() {
            return Err(self.missing(node, "attribute", "files"));
        }
        Ok(Traffic {
            penetration: match node.attribute("penetration") {
                None => otherwise.penetration,
                Some(_) => self.number(node, "penetration", "above 0, to 1", share)?,
            },
            kind,
            files,
            capacity: match node.attribute("capacity") {
                None => otherwise.capacity,
                Some(_) => self.whole(node, "capacity", 1, 1000)?,
            },
        })
    }

    fn border(&self, node: Node<'a, 'input>) -> Result<Border, Error> {
        if !node.has_attribute("border") {
            return Ok(Border::Line);
        }
        let name = self.text(node, "border")?;
        let known = Border::NAMES.iter().find(|entry| entry.0 == name);
        known.map(|entry| entry.1).ok_or_else(|| self.value(node, "border", "line or kerb"))
    }

    fn groups(&self, node: Node<'a, 'input>) -> Result<ObservationGroups, Error> {
        let name = self.text(node, "groups")?;
        let known = ObservationGroups::NAMES.iter().find(|entry| entry.0 == name);
        known
            .map(|entry| entry.1)
            .ok_or_else(|| self.value(node, "groups", "nearest, conflict or both"))
    }

    fn neighbour_order(&self, node: Node<'a, 'input>) -> Result<NeighbourOrder, Error> {
        let Some(name) = node.attribute("neighbourOrder") else {
            return Ok(NeighbourOrder::default());
        };
        let known = NeighbourOrder::NAMES.iter().find(|entry| entry.0 == name);
        known
            .map(|entry| entry.1)
            .ok_or_else(|| self.value(node, "neighbourOrder", "distance or bearing"))
    }

    fn intention(&self, node: Node<'a, 'input>) -> Result<Intention, Error> {
        let Some(name) = node.attribute("intention") else { return Ok(Intention::default()) };
        let known = Intention::NAMES.iter().find(|entry| entry.0 == name);
        known.map(|entry| entry.1).ok_or_else(|| {
            let similar = nearest(name, Intention::NAMES.iter().map(|entry| entry.0));
            let similar =
                similar.map_or_else(String::new, |name| format!("; did you mean `{name}`?"));
            self.value(node, "intention", format!("seen, signalled or hidden{similar}"))
        })
    }

    fn signal_distance(&self, node: Node<'a, 'input>, intention: Intention) -> Result<f64, Error> {
        if !node.has_attribute("signalDistance") {
            return Ok(Observation::SIGNAL_DISTANCE);
        }
        if intention != Intention::Signalled {
            let allowed =
                "only with intention=\"signalled\": otherwise no vehicle has an indicator";
            return Err(self.value(node, "signalDistance", allowed));
        }
        self.number(node, "signalDistance", "1 to 200", |v| (1.0..=200.0).contains(&v))
    }

    fn name(&self, root: Node<'a, 'input>) -> Result<String, Error> {
        let name = self.text(root, "name")?;
        if !Scenario::is_name(name) {
            return Err(self.value(root, "name", "1 to 64 letters, digits, `-` and `_`"));
        }
        Ok(name.into())
    }

    fn description(&self, node: Node<'a, 'input>) -> Result<String, Error> {
        self.expect_attributes(node, &[])?;
        if let Some(inner) = node.children().find(Node::is_element) {
            return Err(self.unknown(
                inner,
                "element",
                inner.tag_name().name(),
                in_element(node),
                &[],
            ));
        }
        let text: String = node.children().filter(Node::is_text).filter_map(|n| n.text()).collect();
        Ok(text.split_whitespace().collect::<Vec<_>>().join(" "))
    }

    fn agents(&self, node: Node<'a, 'input>, nets: &[Net]) -> Result<AgentRange, Error> {
        self.leaf(node, &["min", "max", "default"])?;
        let largest = nets.iter().map(Net::capacity).max().unwrap_or(0);
        let min = self.whole(node, "min", 1, MAX_PLACES)?;
        let max = self.whole(node, "max", min, MAX_PLACES)?;
        if max > largest {
            let allowed = format!("{min} to {largest}, the number of places of the largest net");
            return Err(self.value(node, "max", allowed));
        }
        Ok(AgentRange { min, max, default: self.whole(node, "default", min, max)? })
    }

    fn routes(&self, node: Node<'a, 'input>) -> Result<(Vec<Route>, Vec<RoutePlaces>), Error> {
        self.expect(node, &[], &["route"])?;
        let (mut routes, mut places, mut ids) = (Vec::new(), Vec::new(), HashSet::new());
        for route in self.few(node, MAX_ROUTES)? {
            self.leaf(route, &["id", "edges", "lane", "arrivalPos", "reserved", "offLane"])?;
            let id = self.text(route, "id")?;
            if id.is_empty() || id.chars().any(|c| c.is_whitespace() || "|\\'\";,<>&".contains(c)) {
                return Err(self.value(
                    route,
                    "id",
                    "a word without spaces, quotes and any of |\\;,<>&",
                ));
            }
            if !ids.insert(id) {
                return Err(self.duplicate(
                    Self::offset(route, "id"),
                    format!("route with the id `{}`", shorten(id)),
                ));
            }
            let edges: Vec<String> =
                self.text(route, "edges")?.split_whitespace().map(Into::into).collect();
            if !(1..=MAX_EDGES).contains(&edges.len()) {
                return Err(self.value(
                    route,
                    "edges",
                    format!("1 to {MAX_EDGES} edge ids separated by spaces"),
                ));
            }
            let lane = match route.attribute("lane") {
                None => None,
                Some(_) => Some(self.whole(route, "lane", 0, 63)?),
            };
            let reserved = route.has_attribute("reserved") && self.flag(route, "reserved")?;
            let off_lane =
                if route.has_attribute("offLane") { self.any(route, "offLane")? } else { 1.0 };
            let arrival_pos = self.any(route, "arrivalPos")?;
            routes.push(Route { id: id.into(), edges, lane, arrival_pos, reserved, off_lane });
            places.push(RoutePlaces {
                edges: Self::offset(route, "edges"),
                arrival_pos: Self::offset(route, "arrivalPos"),
            });
        }
        if routes.is_empty() {
            return Err(self.missing(node, "element", "route"));
        }
        Ok((routes, places))
    }

    fn nets(
        &self,
        node: Node<'a, 'input>,
        routes: &[Route],
    ) -> Result<(Vec<Net>, Vec<NetPlaces>), Error> {
        self.expect(node, &[], &["net"])?;
        let index: HashMap<&str, usize> =
            routes.iter().enumerate().map(|(i, r)| (r.id.as_str(), i)).collect();
        let folder = self.path.parent().unwrap_or(Path::new(""));
        let mut nets = Vec::new();
        for net in self.few(node, MAX_NETS)? {
            self.expect(net, &["file"], &["spawn"])?;
            let file = self.text(net, "file")?;
            if file.is_empty() {
                return Err(self.value(net, "file", "a .net.xml"));
            }
            let (mut spawns, mut places, mut room) = (Vec::new(), Vec::new(), MAX_PLACES);
            for spawn in net.children().filter(Node::is_element) {
                let row = self.spawn(spawn, routes, &index, room)?;
                room -= row.count;
                spawns.push(row);
                places.push(spawn.range().start);
            }
            if spawns.is_empty() {
                return Err(self.missing(net, "element", "spawn"));
            }
            self.destinations(net, &spawns, routes)?;
            let at = NetPlaces { file: Self::offset(net, "file"), spawns: places };
            nets.push((Net { file: folder.join(file), spawns }, at));
        }
        if nets.is_empty() {
            return Err(self.missing(node, "element", "net"));
        }
        nets.sort_by_key(|(net, _)| net.capacity());
        Ok(nets.into_iter().unzip())
    }

    /// Checks that every vehicle that needs a reserved destination finds a free one, whichever
    /// routes the other vehicles draw.
    fn destinations(
        &self,
        net: Node<'a, 'input>,
        rows: &[SpawnRow],
        routes: &[Route],
    ) -> Result<(), Error> {
        let reserved = |&i: &usize| routes[i].reserved;
        let wanted: u32 =
            rows.iter().filter(|row| row.routes.iter().any(reserved)).map(|row| row.count).sum();
        for (row, node) in rows.iter().zip(net.children().filter(Node::is_element)) {
            let ends: HashSet<_> = row.routes.iter().map(|&i| routes[i].edges.last()).collect();
            if row.routes.iter().all(reserved) && (ends.len() as u32) < wanted {
                let allowed = format!(
                    "reserved routes to {wanted} edges or more: so many vehicles may want one"
                );
                return Err(self.value(node, "route", allowed));
            }
        }
        Ok(())
    }

    fn spawn(
        &self,
        node: Node<'a, 'input>,
        routes: &[Route],
        index: &HashMap<&str, usize>,
        room: u32,
    ) -> Result<SpawnRow, Error> {
        self.leaf(node, &["route", "first", "spacing", "count"])?;
        let mut drawn = Vec::new();
        for id in self.text(node, "route")?.split_whitespace() {
            let Some(&route) = index.get(id) else {
                let (line, column) = self.position(Self::offset(node, "route"));
                let nearest = nearest(id, routes.iter().map(|r| r.id.as_str())).map(Into::into);
                let value = shorten(id);
                return Err(Error::Reference {
                    path: self.path.into(),
                    line,
                    column,
                    key: "route",
                    value,
                    nearest,
                });
            };
            let begins = |r: &Route| (r.edges[0].clone(), r.lane);
            if drawn
                .first()
                .is_some_and(|&first: &usize| begins(&routes[first]) != begins(&routes[route]))
            {
                return Err(self.value(
                    node,
                    "route",
                    "routes that begin on the same edge and the same `lane`",
                ));
            }
            drawn.push(route);
        }
        if drawn.is_empty() {
            return Err(self.value(
                node,
                "route",
                "the id of a route, or several separated by spaces",
            ));
        }
        let count = self.whole(node, "count", 1, MAX_PLACES)?;
        if count > room {
            return Err(self.value(node, "count", format!("at most {MAX_PLACES} places in a net")));
        }
        Ok(SpawnRow {
            routes: drawn.into(),
            first: self.not_negative(node, "first")?,
            spacing: self.positive(node, "spacing")?,
            count,
        })
    }

    fn control(&self, node: Node<'a, 'input>) -> Result<Control, Error> {
        let attributes = &["mode", "interval", "accel", "drag", "brake", "initialThrottle"];
        let steered = match self.text(node, "mode")? {
            "throttle" => false,
            "steering" => true,
            _ => return Err(self.value(node, "mode", "throttle or steering")),
        };
        self.expect(node, attributes, if steered { &["steering"] } else { &[] })?;
        let in_milliseconds = |v: f64| (v * 1000.0 - (v * 1000.0).round()).abs() < 1e-6;
        let interval = |v: f64| (0.001..=10.0).contains(&v) && in_milliseconds(v);
        let interval =
            self.number(node, "interval", "0.001 to 10, a multiple of 0.001", interval)?;
        let steering =
            if steered { Some(self.steering(self.child(node, "steering")?)?) } else { None };
        Ok(Control {
            interval,
            steering,
            accel: self.positive(node, "accel")?,
            drag: self.not_negative(node, "drag")?,
            brake: self.brake(node)?,
            initial_throttle: match node.attribute("initialThrottle") {
                None => Control::INITIAL_THROTTLE,
                Some(_) => {
                    self.number(node, "initialThrottle", "-1 to 1", |v| (-1.0..=1.0).contains(&v))?
                }
            },
        })
    }

    fn steering(&self, node: Node<'a, 'input>) -> Result<Steering, Error> {
        self.leaf(
            node,
            &["maxAngle", "frontAxle", "rearAxle", "track", "friction", "yawInertia", "reverse"],
        )?;
        let angle = |v: f64| (0.1..=80.0).contains(&v);
        let otherwise = Steering::default();
        // Every car is well within these bounds, which keep the motion stable.
        let or = |key: &'static str, otherwise: f64, least: f64, most: f64| match node
            .attribute(key)
        {
            None => Ok(otherwise),
            Some(_) => self
                .number(node, key, &format!("{least} to {most}"), |v| (least..=most).contains(&v)),
        };
        Ok(Steering {
            max_angle: self.number(node, "maxAngle", "an angle from 0.1 to 80", angle)?,
            front_axle: or("frontAxle", otherwise.front_axle, 0.1, 20.0)?,
            rear_axle: or("rearAxle", otherwise.rear_axle, 0.1, 20.0)?,
            track: or("track", otherwise.track, 0.1, 5.0)?,
            friction: or("friction", otherwise.friction, 0.01, 5.0)?,
            yaw_inertia: or("yawInertia", otherwise.yaw_inertia, 0.01, 200.0)?,
            reverse: self.flag(node, "reverse")?,
        })
    }

    fn flag(&self, node: Node<'a, 'input>, key: &'static str) -> Result<bool, Error> {
        match self.text(node, key)? {
            "true" => Ok(true),
            "false" => Ok(false),
            _ => Err(self.value(node, key, "true or false")),
        }
    }

    fn brake(&self, node: Node<'a, 'input>) -> Result<Vec<(f64, f64)>, Error> {
        let pair = |text: &str| {
            let (magnitude, deceleration) = text.split_once(':')?;
            Some((finite(magnitude)?, finite(deceleration)?))
        };
        let curve: Option<Vec<(f64, f64)>> =
            self.text(node, "brake")?.split_whitespace().map(pair).collect();
        let curve = curve.filter(|curve| {
            let from_origin = curve.first().is_some_and(|&(m, d)| m > 0.0 && d > 0.0);
            let ascending = curve.windows(2).all(|w| w[0].0 < w[1].0 && w[0].1 <= w[1].1);
            from_origin && ascending && curve.last().is_some_and(|last| last.0 == 1.0)
        });
        let allowed = "pairs magnitude:deceleration, both greater than 0, magnitudes ascending to 1, decelerations never falling";
        curve.ok_or_else(|| self.value(node, "brake", allowed))
    }
}
