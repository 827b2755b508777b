//! Reads scenario files strictly: a misspelt key is an error, not a default, and every error has
//! its position. The schema decides about single values; this file checks how values fit together.

use std::collections::{HashMap, HashSet};
use std::path::Path;
use std::sync::Arc;

use super::attribute::Field;
use super::reader::{Element, MAX_BYTES, Reader, document, text};
use super::{
    AgentRange, Communication, Control, Demand, DemandPlan, Error, Intention, Jitter, LaneChange,
    Net, Observation, Occlusion, PlaceDeparture, Reward, Route, Scenario, SpawnRow, Termination,
    Traffic, Vehicle, VehicleVariant, check,
};
use crate::sumo::net::{CARS, NetError, did_you_mean, nearest, shorten};

/// Largest number of spawn places in a net.
const MAX_PLACES: u32 = 10_000;

impl Scenario {
    /// Reads a scenario file and checks it against its nets.
    ///
    /// # Errors
    /// [`Error`], with its position in the file, if the file cannot be read, contains something
    /// invalid, or does not fit its nets.
    pub fn load(path: &Path) -> Result<Self, Error> {
        Self::load_text(&text(path)?, path)
    }

    /// Does the same as [`Scenario::load`] with the text of a file.
    pub(super) fn load_text(text: &str, path: &Path) -> Result<Self, Error> {
        let document = document(text, path)?;
        let reader = Reader::new(path, &document);
        let scenario = reader.scenario()?;
        let errors = check::files(&scenario, &reader).errors;
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
        Reader::new(path, &document(text, path)?).scenario()
    }

    /// Returns the path of a route of this scenario through a net; with lane changes, if agents make
    /// any.
    ///
    /// # Errors
    /// As [`Net::route_path_from`](crate::sumo::net::Net::route_path_from).
    pub fn route_path(
        &self,
        net: &crate::sumo::net::Net,
        route: &Route,
    ) -> Result<crate::sumo::net::Path, NetError> {
        match self.control.lane_change {
            LaneChange::None => net.route_path_from(&route.edges, route.lane),
            _ => net.route_path_with_changes(&route.edges, route.lane, &[CARS]),
        }
    }

    /// Returns what of the route files departs in an episode in a net.
    ///
    /// # Errors
    /// As [`Demand::plan`]; the first vehicle that cannot be used, if [`Traffic::strict`].
    pub fn plan(&self, demand: &Demand, net: &crate::sumo::net::Net) -> Result<DemandPlan, Error> {
        let horizon = f64::from(self.termination.horizon) * self.control.interval;
        let keeps_lane = |source| {
            self.control.lane_change == LaneChange::None
                && self.agents.come_from_files()
                && self.agents.includes_some(demand, source)
        };
        let plan = demand.plan_where(net, self.traffic.begin.0, horizon, &keeps_lane)?;
        match plan.left_out.first() {
            Some(first) if self.traffic.strict => Err(first.error()),
            _ => Ok(plan),
        }
    }

    /// Returns the smallest net with a spawn place for each of `agents` agents, or for as many as
    /// the largest net has places if further agents come from route files.
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
        let placed = if self.agents.come_from_files() { agents.min(largest) } else { agents };
        let large_enough = self.nets.iter().filter(|net| net.capacity() >= placed);
        large_enough.min_by_key(|net| net.capacity()).ok_or_else(|| refuse(largest))
    }
}

impl Reader<'_, '_> {
    /// Reads the scenario without its nets.
    pub(super) fn scenario(&self) -> Result<Scenario, Error> {
        let root = &self.root()?;
        let name: String = Field::read(root, "name")?;
        if !Scenario::is_name(&name) {
            let allowed = "1 to 64 letters, digits, `-` and `_`";
            return Err(self.value(root.node, "name", allowed));
        }
        let description: String = require(root, "description")?
            .node
            .children()
            .filter_map(|node| node.text().filter(|_| node.is_text()))
            .collect();
        let routes = routes(root)?;
        let nets = nets(root, &routes)?;
        Ok(Scenario {
            name,
            path: self.path.into(),
            description: description.split_whitespace().collect::<Vec<_>>().join(" "),
            agents: agents(root, &nets)?,
            routes,
            vehicle: part::<Vehicle>(root, "vehicle")?,
            kinds: kinds(root)?,
            jitter: match root.child("jitter") {
                Some(jitter) => Jitter::read(&jitter, "")?,
                None if nets.iter().all(|net| net.spawns.is_empty()) => Jitter::default(),
                None => return Err(root.lacks("element", "jitter")),
            },
            control: control(root)?,
            observation: observation(root)?,
            reward: part::<Reward>(root, "reward")?,
            nets,
            termination: part::<Termination>(root, "termination")?,
            communication: part::<Communication>(root, "communication")?,
            occlusion: occlusion(root)?,
            traffic: traffic(root)?,
        })
    }
}

/// Reads a required child element that has only attributes.
fn part<T: Field>(root: &Element, name: &'static str) -> Result<T, Error> {
    T::read(&require(root, name)?, "")
}

/// Returns a required child element.
fn require<'a, 'input>(
    parent: &Element<'a, 'input>,
    name: &'static str,
) -> Result<Element<'a, 'input>, Error> {
    parent.child(name).ok_or_else(|| parent.lacks("element", name))
}

fn agents(root: &Element, nets: &[Net]) -> Result<AgentRange, Error> {
    let element = require(root, "agents")?;
    let range = AgentRange::read(&element, "")?;
    let largest = nets.iter().map(Net::capacity).max().unwrap_or(0);
    let refuse = |key, allowed: String| Err(element.reader.value(element.node, key, allowed));
    let from_files = range.come_from_files();
    if from_files && root.child("traffic").is_none_or(|t| t.attribute("files").is_none()) {
        let key = if range.types.is_empty() { "vehicles" } else { "types" };
        return refuse(key, "no value unless <traffic> has the attribute `files`".into());
    }
    if !from_files && largest == 0 {
        let net = require(root, "nets")?.children("net").next();
        let error = net.map(|net| net.lacks("element", "spawn"));
        let hint = "add spawn places, or name vehicles of route files in the attribute types or vehicles of <agents>";
        return Err(error.map_or_else(|| root.lacks("element", "nets"), |error| error.hinted(hint)));
    }
    if let (0, Some(second)) = (largest, require(root, "nets")?.children("net").nth(1)) {
        let message = "a second net without spawn places: the number of places chooses the net";
        return Err(second.reader.invalid(second.node.range().start, message.into()));
    }
    let places = "the number of places of the largest net";
    if range.min > largest && !from_files {
        return refuse("min", format!("1 to {largest}, {places}"));
    }
    if range.max < range.min || (range.max > largest && !from_files) {
        let most = if from_files { "more".into() } else { format!("{largest}, {places}") };
        return refuse("max", format!("{} (`min`) to {most}", range.min));
    }
    if !(range.min..=range.max).contains(&range.default) {
        return refuse("default", format!("whole number from {} to {}", range.min, range.max));
    }
    Ok(range)
}

fn routes(root: &Element) -> Result<Vec<Route>, Error> {
    let (mut routes, mut ids) = (Vec::new(), HashSet::new());
    for element in root.child("routes").iter().flat_map(|routes| routes.children("route")) {
        let route = Route::read(&element, "")?;
        let special = |c: char| c.is_whitespace() || "|\\'\";,<>&".contains(c);
        if route.id.is_empty() || route.id.chars().any(special) {
            let allowed = "a word without spaces, quotes and any of |\\;,<>&";
            return Err(element.reader.value(element.node, "id", allowed));
        }
        if !ids.insert(route.id.clone()) {
            return Err(element.reader.duplicate(element.node, "route"));
        }
        routes.push(route);
    }
    Ok(routes)
}

/// Reads the nets, in ascending order of their numbers of places.
fn nets(root: &Element, routes: &[Route]) -> Result<Vec<Net>, Error> {
    let index: HashMap<&str, usize> =
        routes.iter().enumerate().map(|(i, route)| (route.id.as_str(), i)).collect();
    let folder = root.reader.path.parent().unwrap_or(Path::new(""));
    let mut nets = Vec::new();
    for element in require(root, "nets")?.children("net") {
        let file: String = Field::read(&element, "file")?;
        let (mut spawns, mut room) = (Vec::new(), MAX_PLACES);
        for spawn in element.children("spawn") {
            let row = row(&spawn, routes, &index)?;
            let Some(left) = room.checked_sub(row.count) else {
                let allowed = format!("at most {MAX_PLACES} places in a net");
                return Err(spawn.reader.value(spawn.node, "count", allowed));
            };
            room = left;
            spawns.push(row);
        }
        destinations(&element, &spawns, routes)?;
        nets.push(Net { file: folder.join(file), spawns });
    }
    nets.sort_by_key(Net::capacity);
    Ok(nets)
}

/// Checks that every vehicle that needs a reserved destination finds a free one, whichever routes
/// the other vehicles draw.
fn destinations(net: &Element, rows: &[SpawnRow], routes: &[Route]) -> Result<(), Error> {
    let reserved = |&i: &usize| routes[i].reserved;
    let wanted: u32 =
        rows.iter().filter(|row| row.routes.iter().any(reserved)).map(|row| row.count).sum();
    for (row, spawn) in rows.iter().zip(net.children("spawn")) {
        let ends: HashSet<_> = row.routes.iter().map(|&i| routes[i].edges.last()).collect();
        if row.routes.iter().all(reserved) && (ends.len() as u32) < wanted {
            let allowed = format!(
                "reserved routes to at least {wanted} edges, because up to {wanted} vehicles need a reserved destination"
            );
            return Err(net.reader.value(spawn.node, "route", allowed));
        }
    }
    Ok(())
}

fn row(
    element: &Element,
    routes: &[Route],
    index: &HashMap<&str, usize>,
) -> Result<SpawnRow, Error> {
    let ids: Vec<String> = Field::read(element, "route")?;
    let mut drawn = Vec::new();
    for id in &ids {
        let Some(&route) = index.get(id.as_str()) else {
            let similar = did_you_mean(nearest(id, routes.iter().map(|r| r.id.as_str())));
            let message = format!("route `{}` is not the id of a route{similar}", shorten(id));
            let place = element.reader.place(element.node, "route");
            return Err(Error::Invalid { place, message, hint: None });
        };
        drawn.push(route);
    }
    let begins = |&route: &usize| (&routes[route].edges[0], routes[route].lane);
    if drawn.iter().any(|route| begins(route) != begins(&drawn[0])) {
        let allowed = "routes that begin on the same edge and have the same `lane`";
        return Err(element.reader.value(element.node, "route", allowed));
    }
    let departure = PlaceDeparture::read(element, "")?;
    if departure.end < departure.begin {
        let allowed = format!("at least {} (`begin`)", departure.begin);
        return Err(element.reader.value(element.node, "end", allowed));
    }
    Ok(SpawnRow {
        routes: Arc::from(drawn),
        first: Field::read(element, "first")?,
        spacing: Field::read(element, "spacing")?,
        count: Field::read(element, "count")?,
        departure,
    })
}

fn kinds(root: &Element) -> Result<Vec<VehicleVariant>, Error> {
    let element = require(root, "vehicle")?;
    let largest = Vehicle::read(&element, "")?;
    let (mut kinds, mut shares): (Vec<VehicleVariant>, f64) = (Vec::new(), 0.0);
    for child in element.children("kind") {
        let kind = VehicleVariant::read(&child, "")?;
        let refuse = |key, allowed: String| Err(child.reader.value(child.node, key, allowed));
        if kinds.iter().any(|known| known.id == kind.id) {
            return Err(child.reader.duplicate(child.node, "kind"));
        }
        shares += kind.share;
        if shares > 1.0 + 1e-9 {
            return refuse("share", "shares that sum up to at most 1".into());
        }
        for (key, own, most) in [
            ("length", kind.length, largest.length),
            ("width", kind.width, largest.width),
            ("maxSpeed", kind.max_speed, largest.max_speed),
        ] {
            if own > most {
                return refuse(key, format!("at most {most}, the value of <vehicle>"));
            }
        }
        is_braking_curve(&child, &kind.brake)?;
        kinds.push(kind);
    }
    if !kinds.is_empty()
        && root.child("control").is_some_and(|c| c.attribute("mode") == Some("steering"))
    {
        let first = element.children("kind").next();
        let message = "<kind> is not allowed with mode `steering` of <control>".to_owned();
        return Err(root.reader.invalid(first.map_or(0, |kind| kind.node.range().start), message));
    }
    Ok(kinds)
}

/// Checks the attribute `brake` of an element.
fn is_braking_curve(element: &Element, curve: &[(f64, f64)]) -> Result<(), Error> {
    let positive = curve.first().is_some_and(|&(m, d)| m > 0.0 && d > 0.0);
    let ascending = curve.windows(2).all(|w| w[0].0 < w[1].0 && w[0].1 <= w[1].1);
    let limited = curve.last().is_some_and(|last| last.0 == 1.0 && last.1 <= 1e9);
    if positive && ascending && limited {
        return Ok(());
    }
    let allowed = "pairs magnitude:deceleration with numbers above 0, magnitudes that ascend to 1, and decelerations that do not decrease";
    Err(element.reader.value(element.node, "brake", allowed))
}

fn control(root: &Element) -> Result<Control, Error> {
    let element = require(root, "control")?;
    let control = Control::read(&element, "")?;
    let refuse = |key, allowed: &str| Err(element.reader.value(element.node, key, allowed));
    match (element.attribute("mode"), &control.steering) {
        (Some("steering"), None) => {
            return Err(element.lacks("element", "steering"));
        }
        (Some("throttle"), Some(_)) => {
            return refuse("mode", "`steering`, because the element contains <steering>");
        }
        (Some("steering"), Some(_)) if control.lane_change != LaneChange::None => {
            return refuse(
                "laneChange",
                "`none`, because vehicles that steer change lanes by steering",
            );
        }
        _ => {}
    }
    let milliseconds = control.interval * 1000.0;
    if (milliseconds - milliseconds.round()).abs() >= 1e-6 {
        return refuse("interval", "a multiple of 0.001 from 0.001 to 10");
    }
    is_braking_curve(&element, &control.brake)?;
    Ok(control)
}

fn observation(root: &Element) -> Result<Observation, Error> {
    let element = require(root, "observation")?;
    let observation = Observation::read(&element, "")?;
    let given = element.node.has_attribute("signalDistance");
    if given && observation.intention != Intention::Signalled {
        let allowed =
            "no value unless intention is `signalled`: otherwise no vehicle has an indicator";
        return Err(element.reader.value(element.node, "signalDistance", allowed));
    }
    Ok(observation)
}

fn occlusion(root: &Element) -> Result<Option<Occlusion>, Error> {
    let Some(element) = root.child("occlusion") else { return Ok(None) };
    let mut occlusion = Occlusion::read(&element, "")?;
    let folder = root.reader.path.parent().unwrap_or(Path::new(""));
    occlusion.file = folder.join(&occlusion.file);
    let observes = require(root, "observation")?;
    let priority: f64 = Field::read(&observes, "priorityDistance")?;
    if occlusion.sight && priority > 0.0 {
        let allowed = "0 in a scenario whose <occlusion> blocks sight: priorities depend on vehicles that the agent does not see";
        return Err(observes.reader.value(observes.node, "priorityDistance", allowed));
    }
    Ok(Some(occlusion))
}

fn traffic(root: &Element) -> Result<Traffic, Error> {
    let Some(element) = root.child("traffic") else { return Ok(Traffic::default()) };
    let mut traffic = Traffic::read(&element, "")?;
    if traffic.kind.is_some() && traffic.files.is_empty() {
        return Err(element.lacks("attribute", "files"));
    }
    let folder = root.reader.path.parent().unwrap_or(Path::new(""));
    traffic.files.iter_mut().for_each(|file| *file = folder.join(&*file));
    Ok(traffic)
}

#[cfg(test)]
mod tests {
    use super::super::{Lidar, Steering, describe};
    use super::*;

    /// Every attribute in the schema is a field, and every field is in the schema.
    #[test]
    fn fields_and_schema_agree() {
        fn names<T: Field>(more: &[&str]) -> Vec<String> {
            let mut names = more.iter().map(ToString::to_string).collect();
            T::names("", &mut names);
            names
        }
        let read = |element: &str| match element {
            "scenario" => vec!["name".into()],
            "net" => vec!["file".into()],
            "spawn" => names::<PlaceDeparture>(&["route", "first", "spacing", "count"]),
            "agents" => names::<AgentRange>(&[]),
            "route" => names::<Route>(&[]),
            "vehicle" => names::<Vehicle>(&[]),
            "kind" => names::<VehicleVariant>(&[]),
            "jitter" => names::<Jitter>(&[]),
            "control" => names::<Control>(&["mode"]),
            "steering" => names::<Steering>(&[]),
            "observation" => names::<Observation>(&[]),
            "reward" => names::<Reward>(&[]),
            "termination" => names::<Termination>(&[]),
            "communication" => names::<Communication>(&[]),
            "occlusion" => names::<Occlusion>(&[]),
            "traffic" => names::<Traffic>(&[]),
            _ => Vec::new(),
        };
        for element in describe().all() {
            let mut read = read(&element.name);
            read.sort();
            let mut declared: Vec<_> = element.attributes.iter().map(|a| a.name.clone()).collect();
            declared.sort();
            assert_eq!(read, declared, "<{}>", element.name);
        }
    }

    #[test]
    fn defaults_of_structs_are_those_of_the_schema() {
        let default = |element: &str, attribute: &str| {
            let all = describe().all();
            let element = all.into_iter().find(|known| known.name == element).unwrap();
            element.attribute(attribute).unwrap().default.clone().unwrap()
        };
        let steering = Steering::default();
        for (element, attribute, value) in [
            ("steering", "frontAxle", steering.front_axle),
            ("steering", "rearAxle", steering.rear_axle),
            ("steering", "track", steering.track),
            ("steering", "friction", steering.friction),
            ("steering", "yawInertia", steering.yaw_inertia),
            ("control", "initialThrottle", Control::INITIAL_THROTTLE),
            ("observation", "signalDistance", Observation::SIGNAL_DISTANCE),
            ("observation", "lidarBeams", Lidar::default().beams as f64),
            ("observation", "lidarRange", Lidar::default().range),
            ("spawn", "presence", PlaceDeparture::default().presence),
            ("spawn", "begin", PlaceDeparture::default().begin),
            ("spawn", "end", PlaceDeparture::default().end),
            ("spawn", "departSpeed", PlaceDeparture::default().depart_speed),
            ("traffic", "penetration", Traffic::default().penetration),
            ("traffic", "capacity", f64::from(Traffic::default().capacity)),
        ] {
            assert_eq!(default(element, attribute), value.to_string(), "{attribute}");
        }
    }
}
