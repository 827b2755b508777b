//! Checks a scenario against its nets: routes must be drivable, and finish lines and spawn places
//! must lie on them.

use std::collections::BTreeSet;

use roxmltree::Node;

use super::model::ALL;
use super::{
    AgentRange, Demand, DemandPlan, Error, Net, Place, Route, Scenario, Vehicle, reader::Reader,
};
use crate::sumo::net::{self, EdgeFunction, Path, did_you_mean, nearest, shorten};

/// Tolerance of comparisons of positions \[m\].
const SLACK: f64 = 1e-6;

/// Hint for spawn places that are too close to each other or to the ends of an edge.
const MOVE: &str = "move the places, lower their number, or make the longitudinal jitter smaller";

/// A net and the centre lines of the agents' routes through it.
pub(super) struct Map {
    pub(super) net: net::Net,
    /// Centre lines of the scenario's routes, then of those of agents from route files.
    pub(super) paths: Vec<Path>,
    /// What of the route files departs in this net.
    pub(super) plan: DemandPlan,
    /// Ids of the routes of agents from route files.
    pub(super) of_files: Vec<String>,
}

/// Result of [`files`].
pub(super) struct Checked {
    pub(super) errors: Vec<Error>,
    /// The nets in the order of [`Scenario::nets`]; `None` for a net that routes or spawn places do
    /// not fit.
    pub(super) maps: Vec<Option<Map>>,
    /// Contents of the route files; `None` if they have errors.
    pub(super) demand: Option<Demand>,
}

/// Reads the nets and route files of a scenario and checks the scenario against them.
pub(super) fn files(scenario: &Scenario, reader: &Reader) -> Checked {
    let mut errors = Vec::new();
    let read = demand(scenario, reader).map_err(|error| errors.push(error));
    let is_read = read.is_ok();
    let demand = read.unwrap_or_default();
    errors.extend(walls(scenario, reader));
    let mut check = |(net, node): (&Net, Node)| {
        let map = net::Net::load(&net.file).map_err(|source| Error::Net {
            place: reader.place(node, "file"),
            source: Box::new(source),
        });
        let map = map.map_err(|error| errors.push(error)).ok()?;
        let routes = scenario.routes.iter().zip(reader.all("route"));
        let (paths, wrong): (Vec<_>, Vec<_>) =
            routes.map(|(r, node)| route(scenario, r, &map, node, reader)).partition(Result::is_ok);
        errors.extend(wrong.into_iter().filter_map(Result::err));
        let mut paths: Vec<Path> = paths.into_iter().flatten().collect();
        if paths.len() < scenario.routes.len() {
            return None;
        }
        let plan = scenario.plan(&demand, &map).map_err(|error| errors.push(error));
        errors.extend(no_edge(scenario, &map, reader));
        let placed = spawns(scenario, net, &map, &paths, node, reader);
        let placed = placed.and_then(|()| lanes(scenario, &map, &paths, reader));
        let placed = placed.and_then(|()| classes(scenario, &demand, net, &map, reader));
        placed.map_err(|error| errors.push(error)).ok()?;
        let plan = plan.ok()?;
        let mut of_files = Vec::new();
        if scenario.agents.come_from_files() {
            let departures = plan.departures.iter();
            let driven: BTreeSet<usize> = departures
                .filter(|departure| scenario.agents.includes_some(&demand, departure.source))
                .map(|departure| departure.route)
                .collect();
            if driven.is_empty() && net.capacity() == 0 && !demand.sources.is_empty() {
                errors.push(no_agent(scenario, &plan, reader));
                return None;
            }
            for route in driven {
                paths.push(plan.routes[route].path.clone());
                of_files.push(plan.routes[route].id.clone());
            }
        }
        Some(Map { net: map, paths, plan, of_files })
    };
    let maps = scenario.nets.iter().zip(net_nodes(reader)).map(&mut check).collect();
    Checked { errors, maps, demand: is_read.then_some(demand) }
}

/// Returns the elements `<net>` in the order of [`Scenario::nets`].
pub(super) fn net_nodes<'a, 'input>(reader: &Reader<'a, 'input>) -> Vec<Node<'a, 'input>> {
    let capacity = |net: &Node| -> u32 {
        let counts = net.children().filter_map(|spawn| spawn.attribute("count"));
        counts.filter_map(|count| count.trim().parse::<u32>().ok()).sum()
    };
    let mut nodes: Vec<_> = reader.all("net").collect();
    nodes.sort_by_key(capacity);
    nodes
}

/// Returns the error of a file of polygons that cannot be used.
fn walls(scenario: &Scenario, reader: &Reader) -> Option<Error> {
    let occlusion = scenario.occlusion.as_ref()?;
    let error = occlusion.polygons().err()?;
    let Error::Read { path, source } = error else { return Some(error) };
    let (path, place) = (path.to_string_lossy(), reader.place_in("occlusion", "file"));
    let allowed = format!("an additional file that can be read ({source})");
    Some(Error::value(place, "occlusion", "file", &path, allowed))
}

/// Returns the contents of the route files of `<traffic>`.
fn demand(scenario: &Scenario, reader: &Reader) -> Result<Demand, Error> {
    let refuse = |key, value: &str, allowed: String| {
        Error::value(reader.place_in("traffic", key), "traffic", key, value, allowed)
    };
    let demand = Demand::load(&scenario.traffic.files).map_err(|error| match error {
        Error::Read { path, source } => refuse(
            "files",
            &path.to_string_lossy(),
            format!("route files that can be read ({source}); a space in a path is written %20"),
        ),
        other => other,
    })?;
    if let Some(kind) = &scenario.traffic.kind {
        let vehicles =
            |mix: Vec<(usize, f64)>| mix.iter().all(|entry| !demand.types[entry.0].walks);
        if !demand.mix(kind).is_some_and(vehicles) {
            let allowed = "the id of a vType or vTypeDistribution of vehicles in the files";
            return Err(refuse("type", kind, allowed.into()));
        }
    }
    agents(scenario, &demand, reader)?;
    Ok(demand)
}

/// Checks that the route files contain the vehicles and types that are agents.
fn agents(scenario: &Scenario, demand: &Demand, reader: &Reader) -> Result<(), Error> {
    let refuse = |key, value: &str, allowed: String| {
        Err(Error::value(reader.place_in("agents", key), "agents", key, value, allowed))
    };
    let walks = |mix: &[(usize, f64)]| mix.iter().any(|entry| demand.types[entry.0].walks);
    let vehicles = || demand.sources.iter().filter(|source| !walks(&source.types));
    for id in &scenario.agents.types {
        if demand.mix(id).is_none_or(|mix| walks(&mix)) {
            let known = demand.types.iter().filter(|kind| !kind.walks);
            let similar = did_you_mean(nearest(id, known.map(|kind| kind.id.as_str())));
            let allowed = "ids of vTypes or vTypeDistributions of vehicles in the files";
            return refuse("types", id, format!("{allowed}{similar}"));
        }
    }
    for id in scenario.agents.vehicles.iter().filter(|id| *id != ALL) {
        if !vehicles().any(|source| source.id == *id) {
            let similar = did_you_mean(nearest(id, vehicles().map(|source| source.id.as_str())));
            let allowed = "ids of vehicles, trips and flows of vehicles in the files, or *";
            return refuse("vehicles", id, format!("{allowed}{similar}"));
        }
    }
    if !scenario.agents.come_from_files() {
        return Ok(());
    }
    let (key, named) = named(scenario);
    if !(0..demand.sources.len()).any(|source| scenario.agents.includes_some(demand, source)) {
        return refuse(key, &named, "types that vehicles or flows of the files have".into());
    }
    if scenario.control.steering.is_some() {
        return refuse(key, &named, "no value unless <control> has the mode `throttle`".into());
    }
    Ok(())
}

/// Returns the error of a scenario without spawn places in which no agent ever departs.
fn no_agent(scenario: &Scenario, plan: &DemandPlan, reader: &Reader) -> Error {
    let (key, named) = named(scenario);
    let why = plan.warning().map(|(left_out, _)| format!(" ({left_out})")).unwrap_or_default();
    let allowed = format!("vehicles that can be used and depart within an episode{why}");
    Error::value(reader.place_in("agents", key), "agents", key, &named, allowed)
}

/// Returns the first attribute that names the agents from route files, and its value.
fn named(scenario: &Scenario) -> (&'static str, String) {
    let AgentRange { types, vehicles, .. } = &scenario.agents;
    if types.is_empty() { ("vehicles", vehicles.join(" ")) } else { ("types", types.join(" ")) }
}

/// Returns an error for the first edge of `brokenLines` that the net does not have.
fn no_edge(scenario: &Scenario, map: &net::Net, reader: &Reader) -> Option<Error> {
    let edge =
        scenario.termination.broken_lines.iter().find(|edge| map.edge_index(edge).is_none())?;
    let roads = map.edges.iter().filter(|edge| edge.function == EdgeFunction::Normal);
    let similar = nearest(edge, roads.map(|edge| edge.id.as_str()));
    let allowed = format!("edges of {}{}", map.path.display(), did_you_mean(similar));
    let place = reader.place_in("termination", "brokenLines");
    Some(Error::value(place, "termination", "brokenLines", edge, allowed))
}

/// Returns the centre line of a route after checking that its edges are connected and that the
/// finish line lies on its last edge.
fn route(
    scenario: &Scenario,
    route: &Route,
    map: &net::Net,
    node: Node,
    reader: &Reader,
) -> Result<Path, Error> {
    let path = scenario.route_path(map, route).map_err(|source| Error::Route {
        place: reader.place(node, "edges"),
        route: shorten(&route.id),
        source: Box::new(source),
    })?;
    let last = path.lanes.last().map(|&lane| &map.lanes[lane]);
    let (length, stretch) = last.map_or((0.0, 1.0), |lane| (lane.length, lane.stretch()));
    if route.arrival_pos.abs() > length + SLACK {
        let edge = shorten(route.edges.last().map_or("", String::as_str));
        let allowed = format!("{} to {length} m on edge `{edge}`", -length);
        return Err(reader.value(node, "arrivalPos", allowed));
    }
    // The centre must reach the finish line while the front bumper is still on the route; otherwise
    // SUMO removes the vehicle first.
    let ahead = stretch * scenario.vehicle.length / 2.0
        + scenario.vehicle.max_speed * scenario.control.interval;
    let left =
        if route.arrival_pos < 0.0 { -route.arrival_pos } else { length - route.arrival_pos };
    if left < ahead - SLACK {
        let allowed = format!(
            "at least {ahead:.2} m before the end of the edge: half a vehicle and the distance of one step at maxSpeed"
        );
        return Err(reader.value(node, "arrivalPos", allowed));
    }
    Ok(path)
}

/// Checks that a vehicle at any spawn place lies on its route's first edge, before the finish line,
/// and clear of all other vehicles.
fn spawns(
    scenario: &Scenario,
    net: &Net,
    map: &net::Net,
    paths: &[Path],
    node: Node,
    reader: &Reader,
) -> Result<(), Error> {
    let refuse = |place: Place, message| Error::Invalid { place, message, hint: Some(MOVE) };
    // The jitter is in SUMO's metres, as the places are.
    let half_on = |lane: usize| {
        scenario.vehicle.length / 2.0 * map.lanes[lane].stretch() + scenario.jitter.longitudinal
    };
    let mut taken = Vec::new();
    for (row, spawn) in net.spawns.iter().zip(node.children().filter(Node::is_element)) {
        // All routes of a row begin on one lane, so that the nearest finish line limits the places.
        let route = &scenario.routes[row.routes[0]];
        let lane = paths[row.routes[0]].lanes[0];
        let place = reader.at(spawn.range().start);
        if let Some(&other) = row.routes.iter().find(|&&other| paths[other].lanes[0] != lane) {
            let allowed = format!(
                "a route that begins on lane `{}`, as `{}` does; set the attribute `lane` of the routes",
                shorten(&map.lanes[lane].id),
                shorten(&route.id)
            );
            let id = &scenario.routes[other].id;
            return Err(Error::value(place, "spawn", "route", id, allowed));
        }
        let (limits, departure) = (&scenario.termination, row.departure);
        if departure.depart_speed > scenario.vehicle.max_speed {
            let allowed = format!("at most {} m/s (`maxSpeed`)", scenario.vehicle.max_speed);
            return Err(reader.value(spawn, "departSpeed", allowed));
        }
        let episode = f64::from(limits.horizon) * scenario.control.interval;
        if departure.end >= episode {
            let allowed = format!("less than {episode} s, the length of an episode (`horizon`)");
            return Err(reader.value(spawn, "end", allowed));
        }
        let (length, half) = (map.lanes[lane].length, half_on(lane));
        let ends =
            row.routes.iter().map(|&i| &scenario.routes[i]).map(|route| match route.arrival_pos {
                _ if route.edges.len() > 1 => length,
                pos if pos < 0.0 => length + pos,
                pos => pos,
            });
        let end = ends.fold(length, f64::min);
        for pos in (0..row.count).map(|i| row.first + row.spacing * f64::from(i)) {
            if pos - half < -SLACK || pos + half > end + SLACK {
                let (id, edge) = (shorten(&route.id), shorten(&route.edges[0]));
                return Err(refuse(
                    place,
                    format!(
                        "the spawn place at {pos} m of route `{id}` does not fit on edge `{edge}`: a place needs {half} m on \
                         both sides within 0 to {end} m"
                    ),
                ));
            }
            taken.push((lane, pos, spawn.range().start));
        }
    }
    taken.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let needed = |lane: usize| 2.0 * half_on(lane);
    let close =
        taken.windows(2).find(|w| w[0].0 == w[1].0 && w[1].1 - w[0].1 < needed(w[0].0) - SLACK);
    let Some([(lane, first, a), (_, second, b)]) = close else {
        return Ok(());
    };
    let (lane, needed) = (shorten(&map.lanes[*lane].id), needed(*lane));
    Err(refuse(
        reader.at(*a.max(b)),
        format!(
            "the spawn places at {first} m and {second} m of lane `{lane}` overlap: vehicle and jitter need {needed} m"
        ),
    ))
}

/// Checks that the background vehicles at spawn places may drive the routes that begin there.
fn classes(
    scenario: &Scenario,
    demand: &Demand,
    net: &Net,
    map: &net::Net,
    reader: &Reader,
) -> Result<(), Error> {
    let Some(kind) = scenario.traffic.kind.as_ref().filter(|_| scenario.traffic.penetration < 1.0)
    else {
        return Ok(());
    };
    let mix = demand.mix(kind).unwrap_or_default();
    let classes: BTreeSet<&str> = mix.iter().map(|entry| demand.types[entry.0].class).collect();
    let classes: Vec<&str> = classes.into_iter().collect();
    let routes = net.spawns.iter().flat_map(|row| row.routes.iter());
    for route in routes.map(|&route| &scenario.routes[route]) {
        map.route_path_for(&route.edges, route.lane, &classes).map_err(|error| {
            let (id, why) = (shorten(&route.id), error.problem);
            let allowed = format!("a type whose vehicles can drive the route `{id}`: {why}");
            Error::value(reader.place_in("traffic", "type"), "traffic", "type", kind, allowed)
        })?;
    }
    Ok(())
}

/// Checks that the jitter does not move a vehicle beyond the sides of its lanes: of all lanes of its
/// route, because a vehicle that does not steer keeps its offset, and otherwise of the first.
fn lanes(
    scenario: &Scenario,
    map: &net::Net,
    paths: &[Path],
    reader: &Reader,
) -> Result<(), Error> {
    let offset = scenario.jitter.lateral;
    let margin = if offset > 0.0 { Vehicle::BORDER_MARGIN } else { 0.0 };
    let needed = scenario.vehicle.width + 2.0 * (offset + margin);
    let kept = if scenario.control.steering.is_some() { 1 } else { usize::MAX };
    let driven = paths.iter().flat_map(|path| path.lanes.iter().take(kept));
    let narrowest = driven.map(|&lane| &map.lanes[lane]).min_by(|a, b| a.width.total_cmp(&b.width));
    let Some(narrow) = narrowest.filter(|lane| lane.width < needed - SLACK) else {
        return Ok(());
    };
    let allowed = format!(
        "at most half of the width that a vehicle {} m wide leaves free on lane `{}`, {} m wide, less {} m",
        scenario.vehicle.width,
        shorten(&narrow.id),
        narrow.width,
        Vehicle::BORDER_MARGIN,
    );
    let value = scenario.jitter.lateral.to_string();
    let place = reader.place_in("jitter", "lateral");
    Err(Error::value(place, "jitter", "lateral", &value, allowed))
}
