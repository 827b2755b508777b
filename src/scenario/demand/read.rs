//! Reads route files: routes, and who drives or walks on them. What each element may have is in
//! the table.

use roxmltree::Node;

use super::super::Error;
use super::super::reader::Reader;
use super::ends::{finish, start};
use super::times::{departures, time};
use super::types::{named, possible, probability};
use super::{
    DEFAULT_TYPES, Demand, DemandRoute, Finish, Halt, Itinerary, RouteEdge, Source, Spacing, Start,
    Terminal, table,
};
use crate::sumo::net::{did_you_mean, nearest};

/// Largest number of edges of a route.
const MAX_EDGES: usize = 4096;

/// Names of the root element: those that SUMO's tools write today, and those of older releases.
/// SUMO takes any name.
const ROOTS: [&str; 8] = [
    "routes",
    "additional",
    "route-alternatives",
    "trips",
    "flows",
    "additionals",
    "add",
    "tlLogics",
];

/// Values of `depart` that are no times.
const TRIGGERED: [&str; 3] = ["triggered", "containerTriggered", "split"];
/// Why vehicles with such a value are left out.
const WITHOUT_TIME: &str =
    "it departs when persons or containers have boarded, which is not taken: give a time";

/// The interval around a flow, which has its default times.
type Interval = Option<(f64, f64)>;

impl Demand {
    pub(super) fn read(&mut self, reader: &Reader, text: &str) -> Result<(), Error> {
        let root = reader.document.root_element();
        reader.expect_root(root, &ROOTS)?;
        reader.expect_attributes(root, &[])?;
        self.expect_children(reader, root, &table::ROOT)?;
        self.last_departure = f64::NEG_INFINITY;
        for node in root.children().filter(Node::is_element) {
            match node.tag_name().name() {
                "vType" => drop(self.vehicle_type(reader, node, text)?),
                "vTypeDistribution" => self.type_distribution(reader, node, text)?,
                "route" => {
                    let id = reader.text(node, "id")?;
                    let route = self.route(reader, node, id)?;
                    self.name(reader, node, "route", vec![(route, 1.0)])?;
                }
                "routeDistribution" => {
                    let routes = self.route_distribution(reader, node)?;
                    self.name(reader, node, "route", routes)?;
                }
                "interval" => {
                    self.expect(reader, node, &table::INTERVAL)?;
                    let begin = time(reader, node, "begin", 0.0)?;
                    let end = time(reader, node, "end", f64::INFINITY)?;
                    for flow in node.children().filter(Node::is_element) {
                        self.source(reader, flow, Some((begin, end)))?;
                    }
                }
                element if table::STOPPING_PLACES.contains(&element) => {
                    self.stopping_place(reader, node)?;
                }
                "include" => {
                    let why = table::left_out(root, &table::ROOT).unwrap_or_default();
                    return Err(reader.invalid(node.range().start, why));
                }
                element if table::is_taken(element) => {
                    self.source(reader, node, None)?;
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// Remembers the id of a route or of a distribution of routes.
    fn name(
        &mut self,
        reader: &Reader,
        node: Node,
        what: &str,
        routes: Vec<(usize, f64)>,
    ) -> Result<(), Error> {
        if self.named_routes.insert(reader.text(node, "id")?.into(), routes).is_some() {
            return Err(reader.duplicate(node, what));
        }
        Ok(())
    }

    fn route_distribution(
        &mut self,
        reader: &Reader,
        node: Node,
    ) -> Result<Vec<(usize, f64)>, Error> {
        self.expect(reader, node, &table::ROUTES)?;
        let mut routes = Vec::new();
        for child in node.children().filter(Node::is_element) {
            let weight = probability(reader, child)?;
            let id = child.attribute("id").or(node.attribute("id")).unwrap_or("route");
            if child.has_attribute("refId") {
                self.expect(reader, child, &table::ROUTE)?;
                routes.extend(self.known_route(reader, child, "refId", weight)?);
                continue;
            }
            let route = self.route(reader, child, id)?;
            if child.has_attribute("id") {
                self.name(reader, child, "route", vec![(route, 1.0)])?;
            }
            routes.push((route, weight));
        }
        for (id, weight) in named(reader, node, "routes")? {
            let known = self
                .named_routes
                .get(id)
                .ok_or_else(|| self.no_route(reader, node, "routes", id))?;
            routes.extend(known.iter().map(|&(route, share)| (route, share * weight)));
        }
        possible(reader, node, &routes)?;
        Ok(routes)
    }

    /// Notes whether a vehicle or flow departs earlier than one before it in the file. SUMO reads on
    /// until the present time only, and ignores it.
    ///
    /// Source: SUMO, `src/utils/vehicle/SUMORouteHandler.cpp` (`checkLastDepart`).
    fn note_order(&mut self, reader: &Reader, node: Node, id: &str, departure: f64) {
        if departure < self.last_departure {
            let first = || (0, id.to_owned(), reader.at(node.range().start));
            self.unsorted.get_or_insert_with(first).0 += 1;
        } else if !node.has_attribute("line") {
            self.last_departure = departure;
        }
    }

    /// Returns the routes of the route or distribution that an attribute names.
    fn known_route(
        &self,
        reader: &Reader,
        node: Node,
        key: &str,
        weight: f64,
    ) -> Result<Vec<(usize, f64)>, Error> {
        let id = reader.text(node, key)?;
        let known = self.named_routes.get(id);
        let known = known.ok_or_else(|| self.no_route(reader, node, key, id))?;
        Ok(known.iter().map(|&(route, share)| (route, share * weight)).collect())
    }

    fn no_route(&self, reader: &Reader, node: Node, key: &str, id: &str) -> Error {
        let similar = nearest(id, self.named_routes.keys().map(String::as_str));
        let allowed = "the id of a route or routeDistribution that stands above in the files";
        reader.value(node, key, format!("{allowed}{}", did_you_mean(similar)))
    }

    /// Adds a route; returns its index in [`Demand::routes`].
    fn route(&mut self, reader: &Reader, node: Node, id: &str) -> Result<usize, Error> {
        self.expect(reader, node, &table::ROUTE)?;
        let once: Vec<String> =
            reader.text(node, "edges")?.split_whitespace().map(Into::into).collect();
        let times = match node.attribute("repeat") {
            None => 1,
            Some(text) => {
                let allowed = format!("whole number from 0 to {MAX_EDGES}");
                let repeat = text.trim().parse::<usize>().ok().filter(|n| *n <= MAX_EDGES);
                1 + repeat.ok_or_else(|| reader.value(node, "repeat", allowed))?
            }
        };
        if once.len().saturating_mul(times) > MAX_EDGES {
            let allowed = format!("repetitions of a route up to {MAX_EDGES} edges");
            return Err(reader.value(node, if times > 1 { "repeat" } else { "edges" }, allowed));
        }
        let stops = self.stops(reader, node)?.map(|stops| repeat(&stops, times));
        self.add(reader, node, id, Itinerary::Route(repeat(&once, times)), stops)
    }

    /// Adds the walk of a person; returns its index in [`Demand::routes`].
    fn walk(
        &mut self,
        reader: &Reader,
        person: Node,
        walk: Node,
        id: &str,
    ) -> Result<usize, Error> {
        self.expect(reader, walk, &table::WALK)?;
        let edges = if walk.has_attribute("from") {
            if walk.has_attribute("edges") {
                return Err(reader.value(walk, "edges", "no value beside `from` and `to`"));
            }
            let ends = ["from", "to"].into_iter().map(|key| reader.text(walk, key).map(Into::into));
            let mut ends: Vec<String> = ends.collect::<Result<_, _>>()?;
            ends.dedup();
            ends
        } else {
            reader.text(walk, "edges")?.split_whitespace().map(Into::into).collect()
        };
        let position = |node: Node, key| {
            let allowed = "number of at least 0: metres from the beginning of the edge";
            let number = || reader.number(node, key, allowed, |v| v >= 0.0);
            if node.has_attribute(key) { number().map(Some) } else { Ok(None) }
        };
        let depart = position(person, "departPos")?.unwrap_or(0.0);
        let arrival = position(walk, "arrivalPos")?;
        self.add(reader, walk, id, Itinerary::Walk { edges, depart, arrival }, Ok(Vec::new()))
    }

    /// Adds the trip of a vehicle, trip or flow, which passes the edges of `stops`; returns its
    /// index in [`Demand::routes`].
    fn trip(
        &mut self,
        reader: &Reader,
        node: Node,
        id: &str,
        stops: &[Halt],
    ) -> Result<usize, Error> {
        let terminal = |edge: &'static str, junction: &'static str| match (
            node.attribute(edge),
            node.attribute(junction),
        ) {
            (Some(_), Some(_)) => {
                Err(reader.value(node, junction, format!("no value beside `{edge}`")))
            }
            (Some(id), None) => Ok(Terminal::Edge(id.into())),
            (None, Some(id)) => Ok(Terminal::Junction(id.into())),
            // The trip begins or ends at a stop.
            (None, None) => {
                let stop = if edge == "from" { stops.first() } else { stops.last() };
                stop.map(|stop| Terminal::Edge(stop.edge.clone()))
                    .ok_or_else(|| reader.missing(node, "attribute", edge))
            }
        };
        let (from, to) = (terminal("from", "fromJunction")?, terminal("to", "toJunction")?);
        let mut via: Vec<String> = match node.attribute("via") {
            Some(via) => via.split_whitespace().map(Into::into).collect(),
            None => Vec::new(),
        };
        for stop in stops {
            let ends =
                [&from, &to].into_iter().any(|end| *end == Terminal::Edge(stop.edge.clone()));
            if !ends && !via.contains(&stop.edge) {
                via.push(stop.edge.clone());
            }
        }
        self.add(reader, node, id, Itinerary::Trip { from, via, to }, Ok(Vec::new()))
    }

    fn add(
        &mut self,
        reader: &Reader,
        node: Node,
        id: &str,
        itinerary: Itinerary,
        stops: Result<Vec<Halt>, String>,
    ) -> Result<usize, Error> {
        let (key, edges) = match &itinerary {
            Itinerary::Route(edges) | Itinerary::Walk { edges, .. } => ("edges", edges.len()),
            Itinerary::Trip { via, .. } => ("from", via.len() + 2),
        };
        if !(1..=MAX_EDGES).contains(&edges) {
            let allowed = format!("1 to {MAX_EDGES} edge ids separated by spaces");
            return Err(reader.value(node, key, allowed));
        }
        let place = reader.place(node, key);
        self.routes.push(DemandRoute { id: id.into(), itinerary, stops, place });
        Ok(self.routes.len() - 1)
    }

    /// Reads a vehicle, trip, person or flow, the last perhaps in an interval.
    fn source(&mut self, reader: &Reader, node: Node, interval: Interval) -> Result<(), Error> {
        let (known, element): (_, &'static str) = match node.tag_name().name() {
            "vehicle" => (&table::VEHICLE, "vehicle"),
            "trip" => (&table::TRIP, "trip"),
            "flow" => (&table::FLOW, "flow"),
            "person" => (&table::PERSON, "person"),
            _ => (&table::PERSON_FLOW, "personFlow"),
        };
        let walks = element.starts_with("person");
        let single = ["vehicle", "trip", "person"].contains(&element);
        if !single && node.has_attribute("depart") {
            return Err(reader.value(node, "depart", "no value: a flow has `begin` and `end`"));
        }
        self.expect(reader, node, known)?;
        let id = reader.text(node, "id")?;
        if !self.ids.insert((walks, id.into())) {
            return Err(reader.duplicate(node, if walks { "person" } else { "vehicle or flow" }));
        }
        let types = self.types_of(reader, node, walks)?;
        let stops = self.stops(reader, node)?;
        let reason = not_taken(node, known).or(stops.as_ref().err().cloned());
        let reason = reason.or_else(|| half_way(node, stops.as_ref().map_or(0, Vec::len)));
        let stops = stops.unwrap_or_default();
        let routes = match &reason {
            None => self.itinerary(reader, node, id, walks, &stops)?,
            Some(_) => Vec::new(),
        };
        let triggered = single && node.attribute("depart").is_some_and(|t| TRIGGERED.contains(&t));
        let not_taken = reason.or(triggered.then(|| WITHOUT_TIME.to_owned()));
        let (begin, (spacing, number, end)) = if triggered {
            (0.0, (Spacing::Equal(1.0), 1, f64::INFINITY))
        } else if single {
            let depart = reader.text(node, "depart").and(time(reader, node, "depart", 0.0))?;
            (depart, (Spacing::Equal(1.0), 1, f64::INFINITY))
        } else {
            let (first, last) = interval.unwrap_or((0.0, f64::INFINITY));
            let (begin, end) =
                (time(reader, node, "begin", first)?, time(reader, node, "end", last)?);
            if end < begin {
                let (key, allowed) = if node.has_attribute("end") {
                    ("end", "`begin` or a time after it")
                } else {
                    ("begin", "a time before the end of the <interval>")
                };
                return Err(reader.value(node, key, allowed));
            }
            (begin, departures(reader, node, begin, end)?)
        };
        if !walks && !triggered {
            self.note_order(reader, node, id, begin);
        }
        let (start, finish) = if walks {
            (Start::default(), Finish::default())
        } else {
            (start(reader, node)?, finish(reader, node)?)
        };
        let index = |key| match node.attribute(key) {
            None => Ok(RouteEdge::End),
            Some("random") => Ok(RouteEdge::Random),
            Some(text) => text.trim().parse().map(RouteEdge::Index).map_err(|_| {
                reader.value(node, key, "the index of an edge of the route, from 0, or random")
            }),
        };
        let persons =
            match node.attribute("personNumber") {
                None => 0,
                Some(text) => text.trim().parse().ok().filter(|n| *n <= 1000).ok_or_else(|| {
                    reader.value(node, "personNumber", "whole number from 0 to 1000")
                })?,
            };
        let speed_factor = match node.attribute("speedFactor") {
            Some(_) if !walks => {
                Some(reader.number(node, "speedFactor", "number above 0", |v| v > 0.0)?)
            }
            _ => None,
        };
        self.sources.push(Source {
            id: id.into(),
            element,
            place: reader.at(node.range().start),
            types,
            routes,
            start,
            finish,
            depart_edge: index("departEdge")?,
            arrival_edge: index("arrivalEdge")?,
            line: node.attribute("line").unwrap_or_default().into(),
            persons,
            speed_factor,
            stops,
            begin,
            end,
            number,
            spacing,
            not_taken,
        });
        Ok(())
    }

    /// Returns the types of a vehicle, person or flow.
    fn types_of(
        &self,
        reader: &Reader,
        node: Node,
        walks: bool,
    ) -> Result<Vec<(usize, f64)>, Error> {
        let name = node.attribute("type").unwrap_or(DEFAULT_TYPES[usize::from(walks)]);
        let types =
            self.mix(name).filter(|mix| mix.iter().all(|entry| self.types[entry.0].walks == walks));
        types.ok_or_else(|| {
            let kind = if walks { "a person" } else { "a vehicle" };
            let ids = self.types.iter().filter(|kind| kind.walks == walks).map(|kind| &kind.id);
            let similar = nearest(name, ids.chain(self.mixes.keys()).map(String::as_str));
            let allowed = format!(
                "the id of {kind}'s vType or vTypeDistribution that stands above{}",
                did_you_mean(similar)
            );
            reader.value(node, "type", allowed)
        })
    }

    /// Returns the routes or the walk of a vehicle, person or flow: indices in [`Demand::routes`],
    /// and weights.
    fn itinerary(
        &mut self,
        reader: &Reader,
        node: Node,
        id: &str,
        walks: bool,
        stops: &[Halt],
    ) -> Result<Vec<(usize, f64)>, Error> {
        let given = node.attribute("route");
        let route = |child: &Node| {
            ["route", "routeDistribution", "walk"].iter().any(|&name| child.has_tag_name(name))
        };
        let mut children = node.children().filter(route);
        let child = children.next();
        if let Some(second) = children.next() {
            let name = second.tag_name().name();
            let message = format!("a second element <{name}>: one is allowed");
            return Err(reader.invalid(second.range().start, message));
        }
        if let (Some(child), Some(_)) = (child, given) {
            let message = "a route within an element that has the attribute `route`".to_owned();
            return Err(reader.invalid(child.range().start, message));
        }
        let ends = ["from", "to", "via", "fromJunction", "toJunction"];
        let ends = ends.into_iter().find(|key| node.has_attribute(*key));
        if let (Some(key), true) = (ends, given.is_some() || child.is_some()) {
            return Err(reader.value(node, key, "no value beside a route"));
        }
        match (given, child) {
            (_, Some(child)) if walks => Ok(vec![(self.walk(reader, node, child, id)?, 1.0)]),
            (_, Some(child)) if child.has_tag_name("routeDistribution") => {
                self.route_distribution(reader, child)
            }
            (_, Some(child)) => {
                if child.has_attribute("refId") {
                    return Err(reader.value(
                        child,
                        "refId",
                        "no value outside a routeDistribution",
                    ));
                }
                Ok(vec![(self.route(reader, child, id)?, 1.0)])
            }
            _ if walks => Err(reader.missing(node, "element", "walk")),
            (Some(_), None) => self.known_route(reader, node, "route", 1.0),
            (None, None) if ends.is_some() || node.has_tag_name("trip") => {
                Ok(vec![(self.trip(reader, node, id, stops)?, 1.0)])
            }
            (None, None) => Err(reader
                .missing(node, "attribute", "route")
                .hinted("give `route`, `from` and `to`, or a <route> within the element")),
        }
    }
}

/// Returns why a vehicle, trip, person or flow is left out; `None` if it has nothing that is not
/// taken.
fn not_taken(node: Node, known: &table::Known) -> Option<String> {
    let walks = || node.children().filter(|child| child.has_tag_name("walk"));
    let walk = || walks().find_map(|walk| table::left_out(walk, &table::WALK));
    let second = || walks().nth(1).map(|_| format!("it has several walks: {}", table::ONE_WALK));
    table::left_out(node, known).or_else(walk).or_else(second)
}

/// Returns why a vehicle, trip or flow with an edge at one end of its way alone is left out; `None`
/// if it has both, or neither, or one of its `stops` instead.
fn half_way(node: Node, stops: usize) -> Option<String> {
    let has = |keys: [&str; 2]| keys.iter().any(|key| node.has_attribute(*key));
    let (from, to) = (has(["from", "fromJunction"]), has(["to", "toJunction"]));
    let missing = if from { "to" } else { "from" };
    (from != to && stops == 0).then(|| format!("it has no `{missing}`: give both ends of its way"))
}

fn repeat<T: Clone>(list: &[T], times: usize) -> Vec<T> {
    std::iter::repeat_n(list, times).flatten().cloned().collect()
}
