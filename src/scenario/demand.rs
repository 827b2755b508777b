//! Demand: background traffic from ordinary SUMO route files, which contain vehicle types, routes,
//! vehicles, trips, persons who walk, and flows of vehicles and persons.
//!
//! SUMO itself reads the types. The environment draws the departures from the seed of each episode,
//! because episodes restart while SUMO's clock goes on; times in the files count from the start of
//! an episode.

use std::{collections::HashMap, fmt::Write as _, path::Path};

use roxmltree::Node;

use super::reader::{Names, Reader, document, finite, in_element};
use super::{Error, load};
use crate::sumo::net::{self, Net, NetError};

/// Largest number of routes, and largest number of vehicles, persons and flows, in all files of a
/// scenario.
const MAX_ROUTES: usize = 1000;
const MAX_SOURCES: usize = 1000;
/// Largest number of edges of a route.
const MAX_EDGES: usize = 4096;
/// SUMO's default types of vehicles and of persons, for elements that name no type.
const DEFAULT_TYPES: [&str; 2] = ["DEFAULT_VEHTYPE", "DEFAULT_PEDTYPE"];
/// Ids of types that the environments define themselves.
const TAKEN: [&str; 2] = ["agent", "sumo_driver"];
/// Length and width of each vehicle class of SUMO \[m\] (SUMO 1.15), for types that do not specify
/// them.
const SIZES: [(&str, [f64; 2]); 17] = [
    ("passenger", [5.0, 1.8]),
    ("private", [5.0, 1.8]),
    ("taxi", [5.0, 1.8]),
    ("evehicle", [5.0, 1.8]),
    ("hov", [5.0, 1.8]),
    ("vip", [5.0, 1.8]),
    ("authority", [5.0, 1.8]),
    ("army", [5.0, 1.8]),
    ("emergency", [6.5, 2.16]),
    ("delivery", [6.5, 2.16]),
    ("truck", [7.1, 2.4]),
    ("bus", [12.0, 2.5]),
    ("coach", [14.0, 2.6]),
    ("motorcycle", [2.2, 0.9]),
    ("moped", [2.1, 0.78]),
    ("bicycle", [1.6, 0.65]),
    (WALKERS, [0.215, 0.478]),
];
/// SUMO's vehicle class of pedestrians.
const WALKERS: &str = "pedestrian";

const ELEMENTS: Names =
    &["vType", "vTypeDistribution", "route", "vehicle", "trip", "flow", "person", "personFlow"];

/// Contents of the route files.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Demand {
    /// The `<vType>` elements as they stand in the files, which SUMO reads.
    pub definitions: String,
    /// Types of vehicles and of persons.
    pub types: Vec<VehicleKind>,
    /// Routes of vehicles and flows, and walks of persons.
    pub routes: Vec<DemandRoute>,
    /// Vehicles, persons, and flows of both.
    pub sources: Vec<Source>,
    /// Distributions of types by id: indices into `types`, and weights.
    mixes: HashMap<String, Vec<(usize, f64)>>,
}

/// A type of vehicles or persons.
#[derive(Debug, Clone, PartialEq)]
pub struct VehicleKind {
    /// Id in SUMO.
    pub id: String,
    /// Length \[m\].
    pub length: f64,
    /// Width \[m\].
    pub width: f64,
    /// Whether this is a type of persons.
    pub walks: bool,
}

/// A route or walk of the route files.
#[derive(Debug, Clone, PartialEq)]
pub struct DemandRoute {
    /// Id of the route, or of the vehicle, person or flow that has it.
    pub id: String,
    /// How the file specifies it.
    pub itinerary: Itinerary,
    /// File, line and column.
    pub(super) place: (std::path::PathBuf, u32, u32),
}

/// How a route file specifies a route or walk. Edges are given by their ids.
#[derive(Debug, Clone, PartialEq)]
pub enum Itinerary {
    /// All edges in driving order.
    Route(Vec<String>),
    /// The first edge, edges to pass, and the last edge. The fastest path through them is the
    /// route.
    Trip(Vec<String>),
    /// A walk of a person.
    Walk {
        /// Edges in walking order.
        edges: Vec<String>,
        /// `departPos` of the person: position on the first edge, from its beginning \[m\].
        depart: f64,
        /// `arrivalPos` of the walk: position on the last edge, from its beginning \[m\]. Without
        /// it, the walk ends at the far end of the edge.
        arrival: Option<f64>,
    },
}

/// A route or walk in a net.
#[derive(Debug, Clone, PartialEq)]
pub struct Laid {
    /// Centre line.
    pub path: net::Path,
    /// All edges.
    pub edges: Vec<String>,
    /// Positions, on the first and the last edge, where a walk begins and ends \[m\]; `None` for
    /// vehicles.
    pub walk: Option<[f64; 2]>,
}

impl DemandRoute {
    /// Returns the route or walk in a net.
    ///
    /// # Errors
    /// [`NetError`] if it cannot be driven or walked in the net.
    pub fn lay(&self, net: &Net) -> Result<Laid, NetError> {
        let driven = |edges: Vec<String>| {
            let path = net.route_path_from(&edges, None)?;
            Ok(Laid { path, edges, walk: None })
        };
        match &self.itinerary {
            Itinerary::Route(edges) => driven(edges.clone()),
            Itinerary::Trip(stages) => driven(net.trip(stages)?),
            Itinerary::Walk { edges, depart, arrival } => {
                let walk = net.walk(edges, *depart, *arrival)?;
                Ok(Laid { path: walk.path, edges: edges.clone(), walk: Some([*depart, walk.end]) })
            }
        }
    }
}

/// A vehicle, a person, or a flow of either.
#[derive(Debug, Clone, PartialEq)]
pub struct Source {
    /// Id in SUMO.
    pub id: String,
    /// Types of the vehicles or persons: indices into [`Demand::types`], and weights.
    pub types: Vec<(usize, f64)>,
    /// Index into [`Demand::routes`].
    pub route: usize,
    /// Where and how fast a vehicle departs; unused for persons.
    pub start: Start,
    /// First departure, from the start of the episode \[s\].
    pub begin: f64,
    /// End of departures, from the start of the episode \[s\].
    pub end: f64,
    /// Largest number of vehicles or persons.
    pub number: u64,
    /// Times between departures.
    pub spacing: Spacing,
}

/// Where and how fast a vehicle departs, in SUMO's notation.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Start {
    /// `departLane`.
    pub lane: String,
    /// `departPos`.
    pub pos: String,
    /// `departSpeed`.
    pub speed: String,
}

/// Times between the departures of a flow.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Spacing {
    /// Equal intervals \[s\].
    Equal(f64),
    /// Exponentially distributed intervals, with this mean number of departures per second.
    Poisson(f64),
    /// One departure in each second with this probability.
    Chance(f64),
}

impl Demand {
    /// Reads route files.
    ///
    /// # Errors
    /// [`Error`], with file, line and column, if a file cannot be read or contains something that
    /// is not supported.
    pub fn load(files: &[impl AsRef<Path>]) -> Result<Self, Error> {
        let default = |id: &str, class: &str| {
            let [length, width] =
                SIZES.iter().find(|entry| entry.0 == class).map_or([1.0; 2], |entry| entry.1);
            VehicleKind { id: id.into(), length, width, walks: class == WALKERS }
        };
        let types = vec![default(DEFAULT_TYPES[0], SIZES[0].0), default(DEFAULT_TYPES[1], WALKERS)];
        let mut demand = Self { types, ..Self::default() };
        for path in files.iter().map(AsRef::as_ref) {
            let text = load::text(path)?;
            let document = document(&text, path)?;
            demand.read(&Reader { path, document: &document }, &text)?;
        }
        Ok(demand)
    }

    /// Returns the type with this id, or the types of the distribution with this id: indices into
    /// [`Demand::types`], and weights.
    pub fn mix(&self, id: &str) -> Option<Vec<(usize, f64)>> {
        let one = self.types.iter().position(|kind| kind.id == id).map(|index| vec![(index, 1.0)]);
        one.or_else(|| self.mixes.get(id).cloned())
    }

    fn read(&mut self, reader: &Reader, text: &str) -> Result<(), Error> {
        let root = reader.document.root_element();
        if !["routes", "additional"].contains(&root.tag_name().name()) {
            return Err(reader.unknown(
                root,
                "element",
                root.tag_name().name(),
                "the file".into(),
                &["routes"],
            ));
        }
        let mut routes = HashMap::new();
        for node in root.children().filter(Node::is_element) {
            match node.tag_name().name() {
                "vType" => drop(self.vehicle_type(reader, node, text)?),
                "vTypeDistribution" => self.distribution(reader, node, text)?,
                "route" => {
                    let route = self.route(reader, node, reader.text(node, "id")?)?;
                    if routes.insert(reader.text(node, "id")?, route).is_some() {
                        return Err(
                            reader.duplicate(Reader::offset(node, "id"), "route of this id".into())
                        );
                    }
                }
                "vehicle" | "trip" | "flow" | "person" | "personFlow" => {
                    let source = self.source(reader, node, &routes)?;
                    if self.sources.len() == MAX_SOURCES {
                        return Err(reader.value(
                            node,
                            "id",
                            format!("at most {MAX_SOURCES} vehicles, persons and flows"),
                        ));
                    }
                    self.sources.push(source);
                }
                other => {
                    return Err(reader.unknown(node, "element", other, in_element(root), ELEMENTS));
                }
            }
        }
        Ok(())
    }

    fn vehicle_type(&mut self, reader: &Reader, node: Node, text: &str) -> Result<usize, Error> {
        let id = reader.text(node, "id")?;
        if TAKEN.contains(&id) || id.is_empty() {
            return Err(reader.value(
                node,
                "id",
                format!("another id than {}, which are ours", TAKEN.join(" and ")),
            ));
        }
        let default = DEFAULT_TYPES.iter().position(|known| *known == id);
        if self.mixes.contains_key(id)
            || default.is_none() && self.types.iter().any(|kind| kind.id == id)
        {
            return Err(
                reader.duplicate(Reader::offset(node, "id"), "vehicle type of this id".into())
            );
        }
        let class = node.attribute("vClass").unwrap_or(if default == Some(1) {
            WALKERS
        } else {
            SIZES[0].0
        });
        let [length, width] =
            SIZES.iter().find(|entry| entry.0 == class).map(|entry| entry.1).ok_or_else(|| {
                let classes: Vec<&str> = SIZES.iter().map(|entry| entry.0).collect();
                reader.value(node, "vClass", classes.join(", "))
            })?;
        let size = |key, otherwise| match node.attribute(key) {
            None => Ok(otherwise),
            Some(_) => reader.number(node, key, "0.1 to 100", |v| (0.1..=100.0).contains(&v)),
        };
        let (length, width) = (size("length", length)?, size("width", width)?);
        let kind = VehicleKind { id: id.into(), length, width, walks: class == WALKERS };
        let _ = writeln!(self.definitions, "    {}", &text[node.range()]);
        if let Some(index) = default {
            if kind.walks != self.types[index].walks {
                let allowed = if index == 1 { WALKERS } else { "a class of vehicles" };
                return Err(reader.value(node, "vClass", allowed));
            }
            self.types[index] = kind;
            return Ok(index);
        }
        self.types.push(kind);
        Ok(self.types.len() - 1)
    }

    fn distribution(&mut self, reader: &Reader, node: Node, text: &str) -> Result<(), Error> {
        let id = reader.text(node, "id")?;
        if self.mix(id).is_some() {
            return Err(
                reader.duplicate(Reader::offset(node, "id"), "vehicle type of this id".into())
            );
        }
        let mut mix = Vec::new();
        for child in node.children().filter(Node::is_element) {
            if !child.has_tag_name("vType") {
                return Err(reader.unknown(
                    child,
                    "element",
                    child.tag_name().name(),
                    in_element(node),
                    &["vType"],
                ));
            }
            let index = self.vehicle_type(reader, child, text)?;
            mix.push((index, weight(reader, child)?));
        }
        let named: Vec<&str> =
            node.attribute("vTypes").unwrap_or_default().split_whitespace().collect();
        let weights: Option<Vec<f64>> = match node.attribute("probabilities") {
            None => Some(vec![1.0; named.len()]),
            Some(text) => {
                text.split_whitespace().map(|word| finite(word).filter(|v| *v >= 0.0)).collect()
            }
        };
        let weights = weights.filter(|weights| weights.len() == named.len());
        let weights = weights.ok_or_else(|| {
            reader.value(node, "probabilities", "a number of at least 0 for each of vTypes")
        })?;
        for (name, weight) in named.into_iter().zip(weights) {
            let known = self.types.iter().position(|kind| kind.id == name);
            mix.push((
                known
                    .ok_or_else(|| reader.value(node, "vTypes", "ids of types that stand above"))?,
                weight,
            ));
        }
        if mix.iter().map(|entry| entry.1).sum::<f64>() <= 0.0 {
            return Err(reader.value(
                node,
                "id",
                "a distribution with a type whose probability is above 0",
            ));
        }
        self.mixes.insert(id.into(), mix);
        Ok(())
    }

    fn route(&mut self, reader: &Reader, node: Node, id: &str) -> Result<usize, Error> {
        let edges = reader.text(node, "edges")?.split_whitespace().map(Into::into).collect();
        self.add(reader, node, id, Itinerary::Route(edges))
    }

    /// Adds the walk of a person; returns its index in [`Demand::routes`].
    fn walk(
        &mut self,
        reader: &Reader,
        person: Node,
        walk: Node,
        id: &str,
    ) -> Result<usize, Error> {
        let edges = if walk.has_attribute("from") {
            let ends = ["from", "to"].into_iter().map(|key| reader.text(walk, key).map(Into::into));
            let mut ends: Vec<String> = ends.collect::<Result<_, _>>()?;
            ends.dedup();
            ends
        } else {
            reader.text(walk, "edges")?.split_whitespace().map(Into::into).collect()
        };
        let position = |node: Node, key| {
            let number =
                || reader.number(node, key, "metres from the beginning of the edge", |v| v >= 0.0);
            if node.has_attribute(key) { number().map(Some) } else { Ok(None) }
        };
        let depart = position(person, "departPos")?.unwrap_or(0.0);
        let arrival = position(walk, "arrivalPos")?;
        self.add(reader, walk, id, Itinerary::Walk { edges, depart, arrival })
    }

    /// Adds the trip from `from` via `via` to `to`; returns its index in [`Demand::routes`].
    fn trip(&mut self, reader: &Reader, node: Node, id: &str) -> Result<usize, Error> {
        let (from, to) = (reader.text(node, "from")?, reader.text(node, "to")?);
        let via = node.attribute("via").unwrap_or_default().split_whitespace();
        let stages = std::iter::once(from).chain(via).chain([to]).map(Into::into).collect();
        self.add(reader, node, id, Itinerary::Trip(stages))
    }

    fn add(
        &mut self,
        reader: &Reader,
        node: Node,
        id: &str,
        itinerary: Itinerary,
    ) -> Result<usize, Error> {
        let (Itinerary::Route(edges) | Itinerary::Trip(edges) | Itinerary::Walk { edges, .. }) =
            &itinerary;
        if !(1..=MAX_EDGES).contains(&edges.len()) {
            return Err(reader.value(
                node,
                "edges",
                format!("1 to {MAX_EDGES} edge ids separated by spaces"),
            ));
        }
        if self.routes.len() == MAX_ROUTES {
            return Err(reader.value(node, "edges", format!("at most {MAX_ROUTES} routes")));
        }
        let (line, column) = reader.position(Reader::offset(
            node,
            if matches!(itinerary, Itinerary::Trip(_)) { "from" } else { "edges" },
        ));
        self.routes.push(DemandRoute {
            id: id.into(),
            itinerary,
            place: (reader.path.into(), line, column),
        });
        Ok(self.routes.len() - 1)
    }

    fn source(
        &mut self,
        reader: &Reader,
        node: Node,
        routes: &HashMap<&str, usize>,
    ) -> Result<Source, Error> {
        let id = reader.text(node, "id")?;
        let walks = node.tag_name().name().starts_with("person");
        let name = node.attribute("type").unwrap_or(DEFAULT_TYPES[usize::from(walks)]);
        let (kind, inner) = if walks { ("a person", "walk") } else { ("a vehicle", "route") };
        let unknown = || {
            reader.value(
                node,
                "type",
                format!("the id of {kind}'s vType or vTypeDistribution that stands above"),
            )
        };
        let types =
            self.mix(name).filter(|mix| mix.iter().all(|entry| self.types[entry.0].walks == walks));
        let types = types.ok_or_else(unknown)?;
        let children: Vec<Node> = node.children().filter(Node::is_element).collect();
        let child = children
            .first()
            .filter(|child| child.has_tag_name(inner) && !node.has_attribute("route"));
        if let Some(child) = children.get(usize::from(child.is_some())) {
            let allowed: Names = if walks { &["walk"] } else { &["route"] };
            return Err(reader.unknown(
                *child,
                "element",
                child.tag_name().name(),
                in_element(node),
                allowed,
            ));
        }
        let route = match (node.attribute("route"), child) {
            (_, Some(child)) if walks => self.walk(reader, node, *child, id)?,
            (_, Some(child)) => self.route(reader, *child, id)?,
            _ if walks => return Err(reader.missing(node, "element", "walk")),
            (Some(route), None) => *routes.get(route).ok_or_else(|| {
                reader.value(node, "route", "the id of a route that stands above it in the file")
            })?,
            (None, None) if node.has_attribute("from") || node.has_tag_name("trip") => {
                self.trip(reader, node, id)?
            }
            (None, None) => return Err(reader.missing(node, "attribute", "route")),
        };
        let text = |key: &'static str, otherwise: &str, words: &[&str]| {
            let value = node.attribute(key).unwrap_or(otherwise);
            let fits = words.contains(&value) || finite(value).is_some_and(|v| v >= 0.0);
            let allowed =
                || reader.value(node, key, format!("a number of at least 0, {}", words.join(", ")));
            if fits { Ok(value.to_owned()) } else { Err(allowed()) }
        };
        let start = if walks {
            Start::default()
        } else {
            Start {
                lane: text("departLane", "first", &["random", "free", "allowed", "best", "first"])?,
                pos: text("departPos", "base", &["random", "free", "random_free", "base", "last"])?,
                speed: text(
                    "departSpeed",
                    "0",
                    &["random", "max", "desired", "speedLimit", "last", "avg"],
                )?,
            }
        };
        let time = |key: &'static str, otherwise: f64| match node.attribute(key) {
            None => Ok(otherwise),
            Some(text) => seconds(text)
                .ok_or_else(|| reader.value(node, key, "seconds of at least 0, or h:m:s")),
        };
        let single = ["vehicle", "trip", "person"].contains(&node.tag_name().name());
        let begin = if single {
            reader.text(node, "depart").and(time("depart", 0.0))?
        } else {
            time("begin", 0.0)?
        };
        let end = if single { f64::INFINITY } else { time("end", f64::INFINITY)? };
        let (spacing, number) =
            if single { (Spacing::Equal(1.0), 1) } else { spacing(reader, node, begin, end)? };
        Ok(Source { id: id.into(), types, route, start, begin, end, number, spacing })
    }
}

fn weight(reader: &Reader, node: Node) -> Result<f64, Error> {
    if node.has_attribute("probability") {
        reader.not_negative(node, "probability")
    } else {
        Ok(1.0)
    }
}

/// Returns the times between a flow's departures, and the largest number of departures.
fn spacing(reader: &Reader, node: Node, begin: f64, end: f64) -> Result<(Spacing, u64), Error> {
    let rate = |key| reader.number(node, key, "above 0, to 1e6", |v| v > 0.0 && v <= 1e6);
    let number = match node.attribute("number") {
        None => u64::MAX,
        Some(_) => u64::from(reader.whole(node, "number", 1, 1_000_000)?),
    };
    let spacing = if let Some(text) = node.attribute("period") {
        let gap = |text: &str| finite(text).filter(|v| (0.001..=1e6).contains(v));
        let random = text.strip_prefix("exp(").and_then(|rest| rest.strip_suffix(')'));
        let found = match random {
            Some(rate) => gap(rate).map(Spacing::Poisson),
            None => gap(text).map(Spacing::Equal),
        };
        found.ok_or_else(|| {
            reader.value(node, "period", "seconds, or exp(vehicles per second), 0.001 to 1e6")
        })?
    } else if node.has_attribute("vehsPerHour") {
        Spacing::Equal(3600.0 / rate("vehsPerHour")?)
    } else if node.has_attribute("perHour") {
        Spacing::Equal(3600.0 / rate("perHour")?)
    } else if node.has_attribute("probability") {
        Spacing::Chance(
            reader.number(node, "probability", "above 0, to 1", |v| v > 0.0 && v <= 1.0)?,
        )
    } else if number < u64::MAX && end.is_finite() && end > begin {
        Spacing::Equal((end - begin) / number as f64)
    } else {
        return Err(reader.missing(node, "attribute", "period"));
    };
    Ok((spacing, number))
}

/// Returns the seconds of a time such as `12.5`, `1:02:03` or `1:00:00:00`.
fn seconds(text: &str) -> Option<f64> {
    let parts: Option<Vec<f64>> =
        text.split(':').map(|part| finite(part).filter(|v| *v >= 0.0)).collect();
    match parts?[..] {
        [s] => Some(s),
        [h, m, s] => Some((h * 60.0 + m) * 60.0 + s),
        [d, h, m, s] => Some(((d * 24.0 + h) * 60.0 + m) * 60.0 + s),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn demand(text: &str) -> Result<Demand, Error> {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a.rou.xml");
        std::fs::write(&file, text).unwrap();
        Demand::load(&[file])
    }

    fn mistake(text: &str) -> String {
        let message = demand(text).unwrap_err().to_string();
        message.split_once("a.rou.xml:").map_or(message.clone(), |(_, rest)| rest.to_owned())
    }

    #[test]
    fn reads_types_routes_vehicles_and_flows() {
        let found = demand(
            "<routes>\n<vType id=\"car\" carFollowModel=\"IDM\" length=\"4.5\"/>\n\
             <vTypeDistribution id=\"mix\"><vType id=\"truck\" vClass=\"truck\" probability=\"0.25\"/></vTypeDistribution>\n\
             <vTypeDistribution id=\"all\" vTypes=\"car truck\" probabilities=\"3 1\"/>\n\
             <route id=\"r\" edges=\"a b\"/>\n<vehicle id=\"v\" depart=\"0:01:05\" route=\"r\"/>\n\
             <flow id=\"f\" type=\"all\" end=\"10\" number=\"5\" departSpeed=\"max\"><route edges=\"b\"/></flow>\n\
             <flow id=\"g\" type=\"mix\" route=\"r\" period=\"exp(0.5)\"/>\n\
             <trip id=\"t\" depart=\"4\" from=\"a\" to=\"c\" via=\"d e\"/></routes>",
        )
        .unwrap();
        let sizes: Vec<_> =
            found.types.iter().map(|kind| (kind.id.as_str(), kind.length, kind.width)).collect();
        let [car, walker] = DEFAULT_TYPES;
        assert_eq!(
            sizes,
            [(car, 5.0, 1.8), (walker, 0.215, 0.478), ("car", 4.5, 1.8), ("truck", 7.1, 2.4)]
        );
        assert_eq!(found.definitions.matches("<vType ").count(), 2);
        assert!(found.definitions.contains("carFollowModel=\"IDM\""));
        let [v, f, g, t] = &found.sources[..] else { panic!("{:?}", found.sources) };
        assert_eq!((v.begin, v.number, v.route, &v.types[..]), (65.0, 1, 0, &[(0, 1.0)][..]));
        assert_eq!((f.spacing, f.number, f.route), (Spacing::Equal(2.0), 5, 1));
        assert_eq!((f.start.speed.as_str(), f.start.lane.as_str()), ("max", "first"));
        assert_eq!(f.types, [(2, 3.0), (3, 1.0)]);
        assert_eq!((g.spacing, g.types.clone()), (Spacing::Poisson(0.5), vec![(3, 0.25)]));
        assert_eq!((t.begin, t.number), (4.0, 1));
        assert_eq!(
            found.routes[t.route].itinerary,
            Itinerary::Trip(["a", "d", "e", "c"].map(Into::into).to_vec())
        );
    }

    #[test]
    fn reads_persons_who_walk() {
        let found = demand(
            "<routes>\n<vType id=\"child\" vClass=\"pedestrian\" width=\"0.4\"/>\n\
             <person id=\"p\" depart=\"3\"><walk edges=\"a b c\" arrivalPos=\"7\"/></person>\n\
             <personFlow id=\"f\" type=\"child\" period=\"exp(0.1)\" departPos=\"5\"><walk from=\"a\" to=\"b\"/></personFlow></routes>",
        )
        .unwrap();
        let [p, f] = &found.sources[..] else { panic!("{:?}", found.sources) };
        assert_eq!((p.begin, p.number, &p.types[..]), (3.0, 1, &[(1, 1.0)][..]));
        let walk = |edges: &[&str], depart, arrival| Itinerary::Walk {
            edges: edges.iter().map(|&e| e.into()).collect(),
            depart,
            arrival,
        };
        assert_eq!(found.routes[0].itinerary, walk(&["a", "b", "c"], 0.0, Some(7.0)));
        assert_eq!((f.route, &f.types[..]), (1, &[(2, 1.0)][..]));
        assert_eq!(found.routes[1].itinerary, walk(&["a", "b"], 5.0, None));
        assert!(found.types[2].walks);
        assert_eq!((found.types[2].length, found.types[2].width), (0.215, 0.4));
    }

    #[test]
    fn mistakes_have_their_place() {
        let cases = [
            ("<trip id=\"t\" from=\"a\" depart=\"0\"/>", "<trip> lacks the attribute `to`"),
            ("<trip id=\"t\" depart=\"0\"/>", "<trip> lacks the attribute `from`"),
            (
                "<vehicle id=\"v\" depart=\"0\" route=\"r\"/>",
                "`r` is not a valid route of <vehicle>",
            ),
            (
                "<vehicle id=\"v\" depart=\"triggered\"><route edges=\"a\"/></vehicle>",
                "`triggered` is not a valid depart",
            ),
            ("<flow id=\"f\"><route edges=\"a\"/></flow>", "<flow> lacks the attribute `period`"),
            (
                "<flow id=\"f\" period=\"0\"><route edges=\"a\"/></flow>",
                "`0` is not a valid period",
            ),
            ("<vType id=\"agent\"/>", "`agent` is not a valid id of <vType>"),
            ("<vType id=\"x\" vClass=\"ship\"/>", "`ship` is not a valid vClass"),
            ("<vType id=\"x\"/><vType id=\"x\"/>", "a second vehicle type"),
            (
                "<vehicle id=\"v\" type=\"y\" depart=\"0\"><route edges=\"a\"/></vehicle>",
                "`y` is not a valid type",
            ),
            (
                "<vehicle id=\"v\" depart=\"0\"><route edges=\"a\"/><stop lane=\"a_0\"/></vehicle>",
                "unknown element `stop`",
            ),
            ("<vTypeDistribution id=\"d\"/>", "`d` is not a valid id"),
            ("<person id=\"p\" depart=\"0\"/>", "<person> lacks the element `walk`"),
            (
                "<person id=\"p\" depart=\"0\"><walk edges=\"a\"/><ride from=\"a\" to=\"b\"/></person>",
                "unknown element `ride`",
            ),
            (
                "<person id=\"p\" type=\"DEFAULT_VEHTYPE\" depart=\"0\"><walk edges=\"a\"/></person>",
                "not a valid type",
            ),
            (
                "<vehicle id=\"v\" type=\"DEFAULT_PEDTYPE\" depart=\"0\"><route edges=\"a\"/></vehicle>",
                "not a valid type",
            ),
            ("<vType id=\"DEFAULT_PEDTYPE\" vClass=\"bus\"/>", "`bus` is not a valid vClass"),
            (
                "<personFlow id=\"f\" period=\"9\"><walk from=\"a\"/></personFlow>",
                "<walk> lacks the attribute `to`",
            ),
            ("<containerFlow id=\"c\"/>", "unknown element `containerFlow`"),
        ];
        for (text, expected) in cases {
            let found = mistake(&format!("<routes>\n{text}</routes>"));
            assert!(found.starts_with("2:") && found.contains(expected), "{text}: {found}");
        }
    }
}
