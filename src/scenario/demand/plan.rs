//! Works out which vehicles and persons of the route files can drive or walk in a net within an
//! episode, and how.

use std::collections::HashMap;

use super::left_out::{self, LeftOut};
use super::{Demand, Halt, Itinerary, Laid, RouteEdge, Source, Spacing, Terminal, class_named};
use crate::scenario::Error;
use crate::sumo::RouteStop;
use crate::sumo::net::{Net, NetError, Path, Problem, shorten};

/// Largest number of different routes and walks of those who depart within an episode: the program
/// compares each route with each other.
const MAX_ROUTES: usize = 2000;
/// Length of a stop whose beginning is not given \[m\].
const STOP_LENGTH: f64 = 0.2;

/// What departs in an episode, and what is left out.
#[derive(Debug, Clone, Default)]
pub struct DemandPlan {
    /// The different routes and walks.
    pub routes: Vec<Laid>,
    /// Ways to depart.
    pub departures: Vec<PlannedDeparture>,
    /// Vehicles, persons and flows that depart within the episode.
    pub sources: Vec<PlannedSource>,
    /// Vehicles, persons and flows that cannot be used, in the order of the files.
    pub left_out: Vec<LeftOut>,
    /// Number of vehicles, persons and flows that the files let depart within the episode.
    pub wanted: usize,
    /// Number of those that depart only before or after it.
    pub outside: usize,
}

impl DemandPlan {
    /// Returns a line about what is left out, and what to do; `None` if nothing is.
    pub fn warning(&self) -> Option<(String, &'static str)> {
        left_out::warning(&self.left_out, self.wanted, "left out")
    }
}

/// A way to depart: a route with all that belongs to it.
#[derive(Debug, Clone)]
pub struct PlannedDeparture {
    /// Index into [`Demand::sources`].
    pub source: usize,
    /// Index into [`DemandPlan::routes`].
    pub route: usize,
    /// Positions, on the first and the last edge, where a walk begins and ends \[m\]; `None` for
    /// vehicles.
    pub walk: Option<[f64; 2]>,
    /// Stops in driving order. Times count from the start of the episode.
    pub stops: Vec<RouteStop>,
}

/// A vehicle, person or flow that departs in an episode. Times count from its start.
#[derive(Debug, Clone)]
pub struct PlannedSource {
    /// Index into [`Demand::sources`].
    pub source: usize,
    /// Indices into [`DemandPlan::departures`], and weights; `None` for routes that cannot be used.
    pub departures: Vec<(Option<usize>, f64)>,
    /// First departure \[s\].
    pub begin: f64,
    /// End of departures \[s\].
    pub end: f64,
    /// Largest number of vehicles or persons.
    pub number: u64,
    /// Times between departures.
    pub spacing: Spacing,
}

impl Demand {
    /// Returns what departs in an episode of `horizon` seconds, which begins at `begin` of the
    /// files' time \[s\].
    ///
    /// # Errors
    /// If there are more different routes than the program takes.
    pub fn plan(&self, net: &Net, begin: f64, horizon: f64) -> Result<DemandPlan, Error> {
        self.plan_where(net, begin, horizon, &|_| false)
    }

    /// Does the same as [`Demand::plan`], and leaves out the vehicles that need lane changes and keep
    /// their lanes. `keeps_lane` says for an index into [`Demand::sources`] whether its vehicles do.
    ///
    /// # Errors
    /// As [`Demand::plan`].
    pub fn plan_where(
        &self,
        net: &Net,
        begin: f64,
        horizon: f64,
        keeps_lane: &dyn Fn(usize) -> bool,
    ) -> Result<DemandPlan, Error> {
        let (plan, laid) = (DemandPlan::default(), HashMap::new());
        let mut planner = Planner { demand: self, net, begin, keeps_lane, plan, laid };
        for (index, source) in self.sources.iter().enumerate() {
            if let Some((first, number)) = source.within(begin, horizon) {
                planner.plan.wanted += 1;
                planner.add(index, first, number);
                if planner.plan.routes.len() > MAX_ROUTES {
                    let message = format!(
                        "more than {MAX_ROUTES} different routes within an episode: the program compares \
                         each with each other"
                    );
                    let hint = Some("shorten the horizon, or split the file by time");
                    return Err(Error::Invalid { place: source.place.clone(), message, hint });
                }
            } else if source.number > 0 {
                planner.plan.outside += 1;
            }
        }
        Ok(planner.plan)
    }

    /// Returns the first departure of the files, in their time \[s\].
    pub fn first_departure(&self) -> Option<f64> {
        let some = self.sources.iter().filter(|source| source.number > 0);
        some.map(|source| source.begin).min_by(f64::total_cmp)
    }
}

/// What makes a route in the net: its edges, its first lane, the classes of vehicles on it, and
/// whether they keep their lanes.
type Key = (Vec<String>, Option<u32>, Vec<&'static str>, bool);

struct Planner<'a> {
    demand: &'a Demand,
    net: &'a Net,
    begin: f64,
    keeps_lane: &'a dyn Fn(usize) -> bool,
    plan: DemandPlan,
    /// Indices of routes of vehicles in the plan, or why they cannot be driven.
    laid: HashMap<Key, Result<usize, String>>,
}

impl Planner<'_> {
    /// Adds a vehicle, person or flow to the plan.
    fn add(&mut self, index: usize, first: f64, number: u64) {
        let source = &self.demand.sources[index];
        let mut departures = Vec::new();
        let mut wrong = source.not_taken.clone();
        // No route of a source that is not taken is used.
        let routes = if wrong.is_none() { &source.routes[..] } else { &[] };
        for &(route, weight) in routes.iter().filter(|entry| entry.1 > 0.0) {
            match self.departures(index, source, route) {
                Ok(found) => {
                    let share = weight / found.len() as f64;
                    departures.extend(found.into_iter().map(|departure| (Some(departure), share)));
                }
                Err(reason) => {
                    wrong.get_or_insert(reason);
                    departures.push((None, weight));
                }
            }
        }
        if let Some(mut reason) = wrong {
            let usable = departures.iter().filter(|entry| entry.0.is_some()).count();
            if usable > 0 {
                reason += " (its other routes are used)";
            }
            let (id, element, place) = (source.id.clone(), source.element, source.place.clone());
            self.plan.left_out.push(LeftOut { id, element, place, reason });
            if usable == 0 {
                return;
            }
        }
        self.plan.sources.push(PlannedSource {
            source: index,
            departures,
            begin: first,
            end: source.end - self.begin,
            number,
            spacing: source.spacing,
        });
    }

    /// Returns the ways to depart on a route, or why there is none.
    fn departures(
        &mut self,
        index: usize,
        source: &Source,
        route: usize,
    ) -> Result<Vec<usize>, String> {
        let route = &self.demand.routes[route];
        if let Itinerary::Walk { edges, depart, arrival } = &route.itinerary {
            let walk = self.net.walk(edges, *depart, *arrival).map_err(|error| reason(&error))?;
            let laid = Laid { id: route.id.clone(), path: walk.path, edges: edges.clone() };
            let route = self.route(laid);
            return Ok(vec![self.departure(index, route, Some([*depart, walk.end]), Vec::new())]);
        }
        let kinds = || {
            let present = source.types.iter().filter(|entry| entry.1 > 0.0);
            present.map(|entry| &self.demand.types[entry.0])
        };
        let mut classes: Vec<&'static str> = kinds().map(|kind| kind.class).collect();
        classes.sort_unstable();
        classes.dedup();
        if let Some(class) = classes.iter().find(|class| class_named(class).is_none()) {
            return Err(format!("vehicles of class `{class}` are not taken"));
        }
        let speed = source.start.speed.parse::<f64>().ok();
        if let Some(slow) = kinds().find(|kind| speed.is_some_and(|v| v > kind.max_speed)) {
            return Err(format!(
                "departSpeed is {} m/s, but its type `{}` drives at most {:.2} m/s",
                source.start.speed,
                shorten(&slow.id),
                slow.max_speed
            ));
        }
        let edges = self.edges(&route.itinerary, &classes).map_err(|error| reason(&error))?;
        let count = edges.len();
        let choices = |key, edge, end| match edge {
            RouteEdge::End => Ok(end..end + 1),
            RouteEdge::Random => Ok(0..count),
            RouteEdge::Index(index) if index < count => Ok(index..index + 1),
            RouteEdge::Index(index) => {
                Err(format!("{key} is {index}, but the route has {count} edges"))
            }
        };
        let firsts = choices("departEdge", source.depart_edge, 0)?;
        let lasts = choices("arrivalEdge", source.arrival_edge, count - 1)?;
        let mut found = Vec::new();
        for (first, last) in firsts.flat_map(|first| lasts.clone().map(move |last| (first, last))) {
            if first > last {
                continue;
            }
            let edges = &edges[first..=last];
            let lane = source.start.lane.parse::<u32>().ok();
            let laid = self.lay(&route.id, edges, lane, &classes, (self.keeps_lane)(index))?;
            self.ends(source, edges, laid, &classes)?;
            let halts = route.stops.as_ref().map_err(Clone::clone)?.iter().chain(&source.stops);
            let stops = self.stops(halts, source.start.pos.parse().ok(), edges, laid)?;
            found.push(self.departure(index, laid, None, stops));
        }
        if found.is_empty() {
            return Err("arrivalEdge lies before departEdge".into());
        }
        Ok(found)
    }

    fn departure(
        &mut self,
        source: usize,
        route: usize,
        walk: Option<[f64; 2]>,
        stops: Vec<RouteStop>,
    ) -> usize {
        self.plan.departures.push(PlannedDeparture { source, route, walk, stops });
        self.plan.departures.len() - 1
    }

    /// Returns the edges of a route or trip.
    fn edges(&self, itinerary: &Itinerary, classes: &[&str]) -> Result<Vec<String>, NetError> {
        let terminal = |end: &Terminal, leaving| match end {
            Terminal::Edge(id) => Ok(vec![id.clone()]),
            Terminal::Junction(id) => self.net.roads_at(id, leaving, classes),
        };
        match itinerary {
            Itinerary::Route(edges) | Itinerary::Walk { edges, .. } => Ok(edges.clone()),
            Itinerary::Trip { from, via, to } => {
                let via = via.iter().map(|id| vec![id.clone()]);
                let stages: Vec<Vec<String>> = std::iter::once(terminal(from, true)?)
                    .chain(via)
                    .chain([terminal(to, false)?])
                    .collect();
                self.net.trip(&stages, classes)
            }
        }
    }

    /// Returns the index in the plan of the route along these edges.
    fn lay(
        &mut self,
        id: &str,
        edges: &[String],
        lane: Option<u32>,
        classes: &[&'static str],
        keeps_lane: bool,
    ) -> Result<usize, String> {
        let key = (edges.to_vec(), lane, classes.to_vec(), keeps_lane);
        if let Some(known) = self.laid.get(&key) {
            return known.clone();
        }
        let from = |lane| match self.net.route_path_for(edges, lane, classes) {
            Err(NetError { problem: Problem::LaneChange { .. }, .. }) if !keeps_lane => {
                self.net.route_path_with_changes(edges, lane, classes)
            }
            path => path,
        };
        let path = from(None).map_err(|error| reason(&error));
        let path = match lane {
            None => path,
            Some(lane) => path.and_then(|_| self.path_from(edges, lane, classes, from)),
        };
        let laid = path.map(|path| self.route(Laid { id: id.into(), path, edges: edges.to_vec() }));
        self.laid.insert(key, laid.clone());
        laid
    }

    /// Returns the index of a route or walk in the plan, to which it is added if it is new.
    fn route(&mut self, laid: Laid) -> usize {
        let known =
            self.plan.routes.iter().position(|known| known.is_same(&laid.path, &laid.edges));
        known.unwrap_or_else(|| {
            self.plan.routes.push(laid);
            self.plan.routes.len() - 1
        })
    }

    /// Returns the path along edges that can be driven from some lane, from this one.
    fn path_from(
        &self,
        edges: &[String],
        lane: u32,
        classes: &[&str],
        from: impl Fn(Option<u32>) -> Result<Path, NetError>,
    ) -> Result<Path, String> {
        let edge = self.net.edge_index(&edges[0]).map(|index| &self.net.edges[index]);
        let lanes = edge.map_or(0..0, |edge| edge.lanes.clone());
        let (name, count) = (shorten(&edges[0]), lanes.len());
        let Some(index) = lanes.clone().nth(lane as usize) else {
            return Err(format!("departLane is {lane}, but the edge `{name}` has {count} lanes"));
        };
        if let Some(class) =
            classes.iter().find(|class| !self.net.lanes[index].classes.contain(class))
        {
            return Err(format!(
                "departLane is {lane}, but vehicles of class `{class}` may not use this lane of the edge `{name}`"
            ));
        }
        from(Some(lane)).map_err(|error| format!("from departLane {lane}, {}", reason(&error)))
    }

    /// Checks where a vehicle departs and arrives.
    fn ends(
        &self,
        source: &Source,
        edges: &[String],
        route: usize,
        classes: &[&str],
    ) -> Result<(), String> {
        let lanes = &self.plan.routes[route].path.lanes;
        let (Some(&first), Some(&last)) = (lanes.first(), lanes.last()) else { return Ok(()) };
        for (key, text, lane) in
            [("departPos", &source.start.pos, first), ("arrivalPos", &source.finish.pos, last)]
        {
            let length = self.net.lanes[lane].length;
            if text.parse::<f64>().is_ok_and(|pos| pos.abs() > length) {
                let edge = shorten(&self.net.edges[self.net.lanes[lane].edge].id);
                return Err(format!("{key} is {text} m, but the edge `{edge}` is {length} m long"));
            }
        }
        if let Ok(lane) = source.finish.lane.parse::<usize>() {
            let edge = &self.net.edges[self.net.lanes[last].edge];
            let name = shorten(edges.last().map_or("", String::as_str));
            match edge.lanes.clone().nth(lane) {
                None => {
                    let count = edge.lanes.len();
                    return Err(format!(
                        "arrivalLane is {lane}, but the edge `{name}` has {count} lanes"
                    ));
                }
                Some(index) if !self.net.is_open(index, classes) => {
                    return Err(format!(
                        "arrivalLane {lane} of the edge `{name}` is closed to its class"
                    ));
                }
                Some(_) => {}
            }
        }
        Ok(())
    }

    /// Returns the stops on a route, in driving order.
    fn stops<'h>(
        &self,
        halts: impl Iterator<Item = &'h Halt>,
        depart: Option<f64>,
        edges: &[String],
        route: usize,
    ) -> Result<Vec<RouteStop>, String> {
        let path = &self.plan.routes[route].path;
        let mut stops: Vec<RouteStop> = Vec::new();
        // The edge of the route with the departure or the stop before, and where on it that is.
        let length = path.lanes.first().map_or(0.0, |&lane| self.net.lanes[lane].length);
        let mut passed = (0, depart.map_or(0.0, |pos| if pos < 0.0 { length + pos } else { pos }));
        for halt in halts {
            let name = shorten(&halt.edge);
            if halt.parking {
                return Err(format!("its stop on the edge `{name}` is beside the road (parking)"));
            }
            if !edges.contains(&halt.edge) {
                return Err(format!("its stop on the edge `{name}` is not on its route"));
            }
            let lanes =
                self.net.edge_index(&halt.edge).map_or(0..0, |i| self.net.edges[i].lanes.clone());
            let own = path.lanes.iter().copied().find(|lane| lanes.contains(lane));
            let lane = match halt.lane {
                Some(index) => lanes.clone().nth(index as usize),
                None => own,
            };
            let Some(lane) = lane else {
                return Err(format!("the edge `{name}` of its stop has {} lanes", lanes.len()));
            };
            let length = self.net.lanes[lane].length;
            let from_start = |pos: f64| if pos < 0.0 { length + pos } else { pos };
            let mut end = halt.end.map_or(length, from_start);
            let mut start = halt.start.map_or((end - STOP_LENGTH).max(0.0), from_start);
            if halt.friendly {
                end = end.clamp(STOP_LENGTH.min(length), length);
                start = start.clamp(0.0, (end - STOP_LENGTH).max(0.0));
            }
            if !(0.0 <= start && start < end && end <= length) {
                return Err(format!(
                    "its stop from {start} m to {end} m is not on the edge `{name}`, which is {length} m long; \
                     friendlyPos moves it there"
                ));
            }
            // SUMO takes the stops of the route first, and looks for each behind the one before.
            let behind = |i: &usize| edges[*i] == halt.edge && (*i > passed.0 || end >= passed.1);
            let Some(order) = (passed.0..edges.len()).find(behind) else {
                let before = if stops.is_empty() { "its departPos" } else { "the stop above it" };
                return Err(format!(
                    "its stop on the edge `{name}` at {end} m lies before {before}"
                ));
            };
            passed = (order, end);
            stops.push(RouteStop {
                edge: halt.edge.clone(),
                lane: self.net.lanes[lane].index,
                range: [start, end],
                duration: halt.duration,
                until: halt.until.map(|until| until - self.begin),
            });
        }
        Ok(stops)
    }
}

/// Returns what is wrong with a route, without the net's path.
fn reason(error: &NetError) -> String {
    let agents = match error.problem {
        Problem::LaneChange { .. } => ", and agents keep their lanes (laneChange of <control>)",
        _ => "",
    };
    format!("{}{agents}", error.problem)
}
