//! Reads route files. Each element may have the attributes that this program uses, and attributes
//! of SUMO that are known to have no effect here, which are counted for a warning.

use std::{collections::HashMap, fmt::Write as _};

use roxmltree::Node;

use super::super::Error;
use super::super::reader::{Reader, finite};
use super::{
    DEFAULT_TYPES, Demand, DemandRoute, Itinerary, SIZES, Source, Spacing, Start, VehicleKind,
    WALKERS,
};
use crate::sumo::net::shorten;

/// Largest number of routes, and largest number of vehicles, persons and flows, in all files of a
/// scenario.
const MAX_ROUTES: usize = 1000;
const MAX_SOURCES: usize = 1000;
/// Largest number of edges of a route.
const MAX_EDGES: usize = 4096;
/// Ids of types that the environments define themselves.
const TAKEN: [&str; 2] = ["agent", "sumo_driver"];

const ELEMENTS: [&str; 8] =
    ["vType", "vTypeDistribution", "route", "vehicle", "trip", "flow", "person", "personFlow"];
const ROUTE: &str = "id edges";
const WALK: &str = "edges from to arrivalPos";
const DISTRIBUTION: &str = "id vTypes probabilities";
const VEHICLE: &str = "id type depart route from to via departLane departPos departSpeed";
const PERSON: &str = "id type depart departPos";
/// Attributes of a flow that say when its vehicles or persons depart.
const TIMES: &str = "begin end number period vehsPerHour perHour probability";
/// Attributes of SUMO that have no effect here: the colour, the end of a trip, and results of
/// SUMO's tools.
const UNUSED: &str = "color departPosLat arrivalLane arrivalPos arrivalPosLat arrivalSpeed speedFactor \
    line personNumber reroute insertionChecks cost exitTimes";
/// Attributes of vehicle types in SUMO 1.15, which SUMO reads. SUMO ignores all others in silence.
const TYPE: &str = "Mbegin Mflatness accel actionStepLength adaptFactor adaptTime apProb apparentDecel \
    applyDriverState boardingDuration c1 carFollowModel cc1 cc2 cc3 cc4 cc5 cc6 cc7 cc8 cc9 ccAccel \
    ccDecel ccoolness collisionAvoidanceGainGap collisionAvoidanceGainGapDot \
    collisionAvoidanceGainSpace collisionAvoidanceGainSpeed collisionAvoidanceOverride \
    collisionMinGapFactor color constSpacing containerCapacity decel delta desiredMaxSpeed \
    emergencyDecel emissionClass epsilonacc estimation flatbedD flatbedH flatbedKa flatbedKp \
    flatbedKv gapClosingControlGainGap gapClosingControlGainGapDot gapClosingControlGainSpace \
    gapClosingControlGainSpeed gapControlGainGap gapControlGainGapDot gapControlGainSpace \
    gapControlGainSpeed guiShape hasDriverState height id imgFile impatience jerkmax jmCrossingGap \
    jmDriveAfterRedTime jmDriveAfterYellowTime jmDriveRedSpeed jmIgnoreFoeProb jmIgnoreFoeSpeed \
    jmIgnoreJunctionFoeProb jmIgnoreKeepClearTime jmSigmaMinor jmStoplineGap jmTimegapMinor k kp \
    lambda laneChangeModel lanesCount latAlignment lcAccelLat lcAssertive lcCooperative \
    lcCooperativeRoundabout lcCooperativeSpeed lcImpatience lcKeepRight lcKeepRightAcceptanceTime \
    lcLaneDiscipline lcLookaheadLeft lcMaxDistLatStanding lcMaxSpeedLatFactor lcMaxSpeedLatStanding \
    lcOpposite lcOvertakeDeltaSpeedFactor lcOvertakeRight lcPushy lcPushyGap lcSigma lcSpeedGain \
    lcSpeedGainLookahead lcSpeedGainRight lcStrategic lcSublane lcTimeToImpatience \
    lcTurnAlignmentDistance length loadingDuration maneuverAngleTimes maxSpeed maxSpeedLat \
    maxvehpreview minGap minGapLat omegaN osgFile personCapacity phi ploegH ploegKd ploegKp \
    probability scale security sigma sigmaStep sigmaerror sigmagap sigmaleader speedControlGain \
    speedControlGainCACC speedControlMinGap speedDev speedFactor startupDelay stepping tPersDrive \
    tPersEstimate taccmax tau tauCACCToACC tauEngine tauLast timeToTeleport timeToTeleportBidi \
    tpreview trainType treaction vClass vehdynamics width xi";

impl Demand {
    pub(super) fn read(&mut self, reader: &Reader, text: &str) -> Result<(), Error> {
        let root = reader.document.root_element();
        reader.expect_root(root, &["routes", "additional"])?;
        reader.expect_attributes(root, &[])?;
        reader.expect_children(root, &ELEMENTS, false)?;
        let mut routes = HashMap::new();
        for node in root.children().filter(Node::is_element) {
            match node.tag_name().name() {
                "vType" => drop(self.vehicle_type(reader, node, text)?),
                "vTypeDistribution" => self.distribution(reader, node, text)?,
                "route" => {
                    let route = self.route(reader, node, reader.text(node, "id")?)?;
                    if routes.insert(reader.text(node, "id")?, route).is_some() {
                        return Err(reader.duplicate(node, "route"));
                    }
                }
                _ => {
                    let source = self.source(reader, node, &routes)?;
                    if self.sources.len() == MAX_SOURCES {
                        let allowed = format!("at most {MAX_SOURCES} vehicles, persons and flows");
                        return Err(reader.value(node, "id", allowed));
                    }
                    self.sources.push(source);
                }
            }
        }
        Ok(())
    }

    /// Checks that an element has only the attributes in `used` and [`UNUSED`], and counts the
    /// latter.
    fn expect(&mut self, reader: &Reader, node: Node, used: &[&'static str]) -> Result<(), Error> {
        let used: Vec<&str> = used.iter().flat_map(|names| names.split_whitespace()).collect();
        let unused = || UNUSED.split_whitespace().filter(|key| !used.contains(key));
        let valid: Vec<&str> = used.iter().copied().chain(unused()).collect();
        reader.expect_attributes(node, &valid)?;
        unused()
            .filter(|key| node.has_attribute(*key))
            .for_each(|key| self.count(reader, node, key));
        Ok(())
    }

    /// Counts an attribute without effect.
    fn count(&mut self, reader: &Reader, node: Node, key: &str) {
        let entry = self.unused.entry((node.tag_name().name().into(), shorten(key)));
        entry.or_insert_with(|| (0, reader.place(node, key))).0 += 1;
    }

    fn vehicle_type(&mut self, reader: &Reader, node: Node, text: &str) -> Result<usize, Error> {
        let id = reader.text(node, "id")?;
        if TAKEN.contains(&id) || id.is_empty() {
            let allowed =
                format!("an id other than {}, which this program defines", TAKEN.join(" and "));
            return Err(reader.value(node, "id", allowed));
        }
        for attribute in node.attributes() {
            if !TYPE.split_whitespace().any(|known| known == attribute.name()) {
                self.count(reader, node, attribute.name());
            }
        }
        let default = DEFAULT_TYPES.iter().position(|known| *known == id);
        if self.mixes.contains_key(id)
            || default.is_none() && self.types.iter().any(|kind| kind.id == id)
        {
            return Err(reader.duplicate(node, "vehicle type"));
        }
        let class = node.attribute("vClass").unwrap_or(if default == Some(1) {
            WALKERS
        } else {
            SIZES[0].0
        });
        let (_, [length, width]) =
            *SIZES.iter().find(|entry| entry.0 == class).ok_or_else(|| {
                let classes: Vec<&str> = SIZES.iter().map(|entry| entry.0).collect();
                reader.value(node, "vClass", classes.join(", "))
            })?;
        let size = |key, otherwise| match node.attribute(key) {
            None => Ok(otherwise),
            Some(_) => {
                reader.number(node, key, "number from 0.1 to 100", |v| (0.1..=100.0).contains(&v))
            }
        };
        let (length, width) = (size("length", length)?, size("width", width)?);
        let walks = class == WALKERS;
        let kind = VehicleKind { id: id.into(), length, width, class: class.into(), walks };
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
        self.expect(reader, node, &[DISTRIBUTION])?;
        reader.expect_children(node, &["vType"], false)?;
        let id = reader.text(node, "id")?;
        if self.mix(id).is_some() {
            return Err(reader.duplicate(node, "vehicle type"));
        }
        let weight = |text: &str| finite(text).filter(|v| *v >= 0.0);
        let mut mix = Vec::new();
        for child in node.children().filter(Node::is_element) {
            let index = self.vehicle_type(reader, child, text)?;
            let weight = weight(child.attribute("probability").unwrap_or("1"))
                .ok_or_else(|| reader.value(child, "probability", "number of at least 0"))?;
            mix.push((index, weight));
        }
        let named: Vec<&str> =
            node.attribute("vTypes").unwrap_or_default().split_whitespace().collect();
        let weights: Option<Vec<f64>> = match node.attribute("probabilities") {
            None => Some(vec![1.0; named.len()]),
            Some(text) => text.split_whitespace().map(weight).collect(),
        };
        let weights = weights.filter(|weights| weights.len() == named.len()).ok_or_else(|| {
            reader.value(node, "probabilities", "a number of at least 0 for each of vTypes")
        })?;
        for (name, weight) in named.into_iter().zip(weights) {
            let known = self.types.iter().position(|kind| kind.id == name).ok_or_else(|| {
                reader.value(node, "vTypes", "ids of types that stand above in the files")
            })?;
            mix.push((known, weight));
        }
        if mix.iter().map(|entry| entry.1).sum::<f64>() <= 0.0 {
            let allowed = "a distribution with a type whose probability is above 0";
            return Err(reader.value(node, "id", allowed));
        }
        self.mixes.insert(id.into(), mix);
        Ok(())
    }

    fn route(&mut self, reader: &Reader, node: Node, id: &str) -> Result<usize, Error> {
        self.expect(reader, node, &[ROUTE])?;
        reader.expect_children(node, &[], false)?;
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
        self.expect(reader, walk, &[WALK])?;
        reader.expect_children(walk, &[], false)?;
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
            let allowed = format!("1 to {MAX_EDGES} edge ids separated by spaces");
            return Err(reader.value(node, "edges", allowed));
        }
        if self.routes.len() == MAX_ROUTES {
            return Err(reader.value(node, "edges", format!("at most {MAX_ROUTES} routes")));
        }
        let key = if matches!(itinerary, Itinerary::Trip(_)) { "from" } else { "edges" };
        let place = reader.place(node, key);
        self.routes.push(DemandRoute { id: id.into(), itinerary, place });
        Ok(self.routes.len() - 1)
    }

    /// Reads a vehicle, trip, person or flow. `routes` are the routes above it by their ids.
    fn source(
        &mut self,
        reader: &Reader,
        node: Node,
        routes: &HashMap<&str, usize>,
    ) -> Result<Source, Error> {
        let element = node.tag_name().name();
        let walks = element.starts_with("person");
        let single = ["vehicle", "trip", "person"].contains(&element);
        let used = if walks { PERSON } else { VEHICLE };
        self.expect(reader, node, &[used, if single { "" } else { TIMES }])?;
        let id = reader.text(node, "id")?;
        let name = node.attribute("type").unwrap_or(DEFAULT_TYPES[usize::from(walks)]);
        let types =
            self.mix(name).filter(|mix| mix.iter().all(|entry| self.types[entry.0].walks == walks));
        let types = types.ok_or_else(|| {
            let kind = if walks { "a person" } else { "a vehicle" };
            let allowed =
                format!("the id of {kind}'s vType or vTypeDistribution that stands above");
            reader.value(node, "type", allowed)
        })?;
        let route = self.itinerary(reader, node, id, walks, routes)?;
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
        let time = |key: &str, otherwise: f64| match node.attribute(key) {
            None => Ok(otherwise),
            Some(text) => seconds(text)
                .ok_or_else(|| reader.value(node, key, "seconds of at least 0, or h:m:s")),
        };
        let (begin, end, (spacing, number)) = if single {
            let depart = reader.text(node, "depart").and(time("depart", 0.0))?;
            (depart, f64::INFINITY, (Spacing::Equal(1.0), 1))
        } else {
            if node.has_attribute("depart") {
                return Err(reader.value(node, "depart", "no value: a flow has `begin` and `end`"));
            }
            let (begin, end) = (time("begin", 0.0)?, time("end", f64::INFINITY)?);
            if end <= begin {
                return Err(reader.value(node, "end", "a time after `begin`"));
            }
            (begin, end, departures(reader, node, begin, end)?)
        };
        Ok(Source { id: id.into(), types, route, start, begin, end, number, spacing })
    }

    /// Returns the index in [`Demand::routes`] of the route or walk of a vehicle, person or flow.
    fn itinerary(
        &mut self,
        reader: &Reader,
        node: Node,
        id: &str,
        walks: bool,
        routes: &HashMap<&str, usize>,
    ) -> Result<usize, Error> {
        let (inner, given): (&[&'static str], _) =
            if walks { (&["walk"], None) } else { (&["route"], node.attribute("route")) };
        reader.expect_children(node, if given.is_some() { &[] } else { inner }, false)?;
        let mut children = node.children().filter(Node::is_element);
        let child = children.next();
        if let Some(second) = children.next() {
            let message = format!("a second element <{}>: one is allowed", inner[0]);
            return Err(reader.invalid(second.range().start, message));
        }
        let ends = ["from", "to", "via"].into_iter().find(|key| node.has_attribute(*key));
        if let (Some(key), true) = (ends, given.is_some() || child.is_some()) {
            return Err(reader.value(node, key, "no value beside a route"));
        }
        match (given, child) {
            (_, Some(child)) if walks => self.walk(reader, node, child, id),
            (_, Some(child)) => self.route(reader, child, id),
            _ if walks => Err(reader.missing(node, "element", "walk")),
            (Some(route), None) => routes.get(route).copied().ok_or_else(|| {
                reader.value(node, "route", "the id of a route that stands above it in the file")
            }),
            (None, None) if ends.is_some() || node.has_tag_name("trip") => {
                self.trip(reader, node, id)
            }
            (None, None) => Err(reader.missing(node, "attribute", "route")),
        }
    }
}

/// Returns the times between a flow's departures, and the largest number of departures.
fn departures(reader: &Reader, node: Node, begin: f64, end: f64) -> Result<(Spacing, u64), Error> {
    let mut given = ["period", "vehsPerHour", "perHour", "probability"]
        .into_iter()
        .filter(|key| node.has_attribute(*key));
    let (first, second) = (given.next(), given.next());
    if let (Some(first), Some(second)) = (first, second) {
        return Err(reader.value(node, second, format!("no value beside `{first}`")));
    }
    let number = match node.attribute("number") {
        None => u64::MAX,
        Some(text) => text
            .trim()
            .parse::<u64>()
            .ok()
            .filter(|number| (1..=1_000_000).contains(number))
            .ok_or_else(|| reader.value(node, "number", "whole number from 1 to 1000000"))?,
    };
    let spacing = match first {
        Some("period") => {
            let text = reader.text(node, "period")?;
            let gap = |text: &str| finite(text).filter(|v| (0.001..=1e6).contains(v));
            let random = text.strip_prefix("exp(").and_then(|rest| rest.strip_suffix(')'));
            let found = match random {
                Some(rate) => gap(rate).map(Spacing::Poisson),
                None => gap(text).map(Spacing::Equal),
            };
            let allowed = "seconds, or exp(vehicles per second), from 0.001 to 1000000";
            found.ok_or_else(|| reader.value(node, "period", allowed))?
        }
        Some("probability") => {
            let allowed = "number above 0, up to 1";
            Spacing::Chance(reader.number(node, "probability", allowed, |v| v > 0.0 && v <= 1.0)?)
        }
        Some(key) => {
            let allowed = "number above 0, up to 1000000";
            Spacing::Equal(3600.0 / reader.number(node, key, allowed, |v| v > 0.0 && v <= 1e6)?)
        }
        None if number < u64::MAX && end.is_finite() => {
            Spacing::Equal((end - begin) / number as f64)
        }
        None => return Err(reader.missing(node, "attribute", "period")),
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
