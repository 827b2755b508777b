//! Checks a scenario against its nets: routes must be drivable, and finish lines and spawn places
//! must lie on them.

use super::{Demand, Error, Net, Route, Scenario, reader::Reader};
use crate::sumo::net::{self, EdgeFunction, Path, did_you_mean, nearest, shorten};

/// Tolerance of comparisons of positions \[m\].
const SLACK: f64 = 1e-6;

/// Byte offsets, in the scenario file, of the parts that are checked against the nets.
pub(super) struct StartPlaces {
    /// Parts of each route.
    pub(super) routes: Vec<RoutePlaces>,
    /// Parts of each net.
    pub(super) nets: Vec<NetPlaces>,
    /// Attribute `lateral` of `<jitter>`.
    pub(super) lateral: usize,
    /// Attribute `type` of `<traffic>`.
    pub(super) traffic_type: usize,
    /// Attribute `files` of `<traffic>`.
    pub(super) traffic_files: usize,
    /// Attribute `brokenLines` of `<termination>`.
    pub(super) broken_lines: usize,
}

/// Byte offsets of the parts of a route.
pub(super) struct RoutePlaces {
    pub(super) edges: usize,
    pub(super) arrival_pos: usize,
}

/// Byte offsets of the parts of a net.
pub(super) struct NetPlaces {
    pub(super) file: usize,
    /// Start of each spawn row.
    pub(super) spawns: Vec<usize>,
}

/// A net and the centre lines of all routes through it.
pub(super) struct Map {
    pub(super) net: net::Net,
    pub(super) paths: Vec<Path>,
}

/// Reads every net of a scenario and checks the scenario against it. Returns all errors, and for
/// each net its map if the routes and spawn places fit the net.
pub(super) fn nets(
    scenario: &Scenario,
    places: &StartPlaces,
    reader: &Reader,
) -> (Vec<Error>, Vec<Option<Map>>) {
    let mut errors = Vec::new();
    let demand = demand(scenario, places, reader).unwrap_or_else(|error| {
        errors.push(error);
        Demand::default()
    });
    let mut check = |net: &Net, at: &NetPlaces| {
        let map = net::Net::load(&net.file).map_err(|source| {
            let (line, column) = reader.position(at.file);
            Error::Net { path: scenario.path.clone(), line, column, source: Box::new(source) }
        });
        let map = map.map_err(|error| errors.push(error)).ok()?;
        let paths = scenario
            .routes
            .iter()
            .zip(&places.routes)
            .map(|(r, at)| route(scenario, r, &map, at, reader));
        let (paths, wrong): (Vec<_>, Vec<_>) = paths.partition(Result::is_ok);
        errors.extend(wrong.into_iter().filter_map(Result::err));
        let paths: Vec<Path> = paths.into_iter().flatten().collect();
        if paths.len() < scenario.routes.len() {
            return None;
        }
        errors.extend(undrivable(&demand, &map));
        errors.extend(no_edge(scenario, &map, places, reader));
        let placed = spawns(scenario, net, &map, &paths, &at.spawns, reader);
        let placed = placed.and_then(|()| lanes(scenario, &map, &paths, places, reader));
        placed.map_err(|error| errors.push(error)).ok().map(|()| Map { net: map, paths })
    };
    let maps = scenario.nets.iter().zip(&places.nets).map(|(net, at)| check(net, at)).collect();
    (errors, maps)
}

/// Returns the contents of the route files of `<traffic>`.
fn demand(scenario: &Scenario, places: &StartPlaces, reader: &Reader) -> Result<Demand, Error> {
    let demand = Demand::load(&scenario.traffic.files).map_err(|error| match error {
        Error::Read { path: file, source } => {
            let (line, column) = reader.position(places.traffic_files);
            let allowed = format!("route files that can be read ({source})");
            let (path, value) = (scenario.path.clone(), shorten(&file.to_string_lossy()));
            Error::Value {
                path,
                line,
                column,
                element: "traffic".into(),
                key: "files",
                value,
                allowed,
            }
        }
        other => other,
    })?;
    match &scenario.traffic.kind {
        Some(kind)
            if demand
                .mix(kind)
                .is_none_or(|mix| mix.iter().any(|entry| demand.types[entry.0].walks)) =>
        {
            let (line, column) = reader.position(places.traffic_type);
            let allowed = "the id of a vType or vTypeDistribution of vehicles of the files".into();
            let (path, value) = (scenario.path.clone(), shorten(kind));
            Err(Error::Value {
                path,
                line,
                column,
                element: "traffic".into(),
                key: "type",
                value,
                allowed,
            })
        }
        _ => Ok(demand),
    }
}

/// Returns an error for the first route or walk of the route files that the net does not allow.
fn undrivable(demand: &Demand, map: &net::Net) -> Option<Error> {
    demand.routes.iter().find_map(|route| {
        let source = Box::new(route.lay(map).err()?);
        let (path, line, column) = route.place.clone();
        Some(Error::Route { path, line, column, route: shorten(&route.id), source })
    })
}

/// Returns an error for the first edge of `brokenLines` that the net does not have.
fn no_edge(
    scenario: &Scenario,
    map: &net::Net,
    places: &StartPlaces,
    reader: &Reader,
) -> Option<Error> {
    let edge =
        scenario.termination.broken_lines.iter().find(|edge| map.edge_index(edge).is_none())?;
    let (line, column) = reader.position(places.broken_lines);
    let ids = map
        .edges
        .iter()
        .filter(|edge| edge.function == EdgeFunction::Normal)
        .map(|edge| edge.id.as_str());
    let allowed = format!("edges of {}{}", map.path.display(), did_you_mean(nearest(edge, ids)));
    let (path, value) = (scenario.path.clone(), shorten(edge));
    Some(Error::Value {
        path,
        line,
        column,
        element: "termination".into(),
        key: "brokenLines",
        value,
        allowed,
    })
}

/// Returns the centre line of a route after checking that its edges are connected and that the
/// finish line lies on its last edge.
fn route(
    scenario: &Scenario,
    route: &Route,
    map: &net::Net,
    at: &RoutePlaces,
    reader: &Reader,
) -> Result<Path, Error> {
    let path = map.route_path_from(&route.edges, route.lane).map_err(|source| {
        let (line, column) = reader.position(at.edges);
        Error::Route {
            path: scenario.path.clone(),
            line,
            column,
            route: shorten(&route.id),
            source: Box::new(source),
        }
    })?;
    let length = path.lanes.last().map_or(0.0, |&lane| map.lanes[lane].length);
    let refused = |allowed: String| {
        let (line, column) = reader.position(at.arrival_pos);
        let (path, value) = (scenario.path.clone(), route.arrival_pos.to_string());
        Error::Value {
            path,
            line,
            column,
            element: "route".into(),
            key: "arrivalPos",
            value,
            allowed,
        }
    };
    if route.arrival_pos.abs() > length + SLACK {
        let edge = shorten(route.edges.last().map_or("", String::as_str));
        return Err(refused(format!("{} to {length} m on edge `{edge}`", -length)));
    }
    // The centre must reach the finish line while the front bumper is still on the route; otherwise
    // SUMO removes the vehicle first.
    let ahead =
        scenario.vehicle.length / 2.0 + scenario.vehicle.max_speed * scenario.control.interval;
    let left =
        if route.arrival_pos < 0.0 { -route.arrival_pos } else { length - route.arrival_pos };
    if left < ahead - SLACK {
        return Err(refused(format!(
            "at least {ahead:.2} m before the end: half a vehicle and the way of one step"
        )));
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
    rows: &[usize],
    reader: &Reader,
) -> Result<(), Error> {
    let half = scenario.vehicle.length / 2.0 + scenario.jitter.longitudinal;
    let mut taken = Vec::new();
    for (row, &offset) in net.spawns.iter().zip(rows) {
        // All routes of a row begin on one lane, so that the nearest finish line limits the places.
        let route = &scenario.routes[row.routes[0]];
        let lane = paths[row.routes[0]].lanes[0];
        if let Some(&other) = row.routes.iter().find(|&&other| paths[other].lanes[0] != lane) {
            let (line, column) = reader.position(offset);
            return Err(Error::Value {
                path: scenario.path.clone(),
                line,
                column,
                element: "spawn".into(),
                key: "route",
                value: shorten(&scenario.routes[other].id),
                allowed: format!(
                    "a route that begins on lane `{}`, as `{}` does; say so with its `lane`",
                    shorten(&map.lanes[lane].id),
                    shorten(&route.id)
                ),
            });
        }
        let length = map.lanes[lane].length;
        let ends =
            row.routes.iter().map(|&i| &scenario.routes[i]).map(|route| match route.arrival_pos {
                _ if route.edges.len() > 1 => length,
                pos if pos < 0.0 => length + pos,
                pos => pos,
            });
        let end = ends.fold(length, f64::min);
        for pos in (0..row.count).map(|i| row.first + row.spacing * f64::from(i)) {
            if pos - half < -SLACK || pos + half > end + SLACK {
                let (line, column) = reader.position(offset);
                return Err(Error::Place {
                    path: scenario.path.clone(),
                    line,
                    column,
                    route: shorten(&route.id),
                    pos,
                    edge: shorten(&route.edges[0]),
                    half,
                    end,
                });
            }
            taken.push((lane, pos, offset));
        }
    }
    taken.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let needed = 2.0 * half;
    let close = taken.windows(2).find(|w| w[0].0 == w[1].0 && w[1].1 - w[0].1 < needed - SLACK);
    let Some([(lane, first, a), (_, second, b)]) = close else {
        return Ok(());
    };
    let (line, column) = reader.position(*a.max(b));
    Err(Error::Overlap {
        path: scenario.path.clone(),
        line,
        column,
        lane: shorten(&map.lanes[*lane].id),
        first: *first,
        second: *second,
        needed,
    })
}

/// Checks that the jitter does not move a vehicle beyond the sides of its lane.
fn lanes(
    scenario: &Scenario,
    map: &net::Net,
    paths: &[Path],
    places: &StartPlaces,
    reader: &Reader,
) -> Result<(), Error> {
    let needed = scenario.vehicle.width + 2.0 * scenario.jitter.lateral;
    let starts = paths.iter().map(|path| &map.lanes[path.lanes[0]]);
    let Some(narrow) = starts.into_iter().find(|lane| lane.width < needed - SLACK) else {
        return Ok(());
    };
    let (line, column) = reader.position(places.lateral);
    Err(Error::Value {
        path: scenario.path.clone(),
        line,
        column,
        element: "jitter".into(),
        key: "lateral",
        value: scenario.jitter.lateral.to_string(),
        allowed: format!(
            "what keeps a vehicle {} m wide on lane `{}`, {} m wide",
            scenario.vehicle.width,
            shorten(&narrow.id),
            narrow.width
        ),
    })
}
