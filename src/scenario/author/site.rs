//! Searches the junctions of a net that are possible sites of a scenario: the routes over each of
//! them, and the spawn places upstream.

use std::collections::{BTreeMap, HashMap, HashSet};

use super::super::Route;
use super::files::{Row, meet};
use super::left_out::LeftOut;
use super::{FIRST, SPACING};
use crate::sumo::net::{
    CARS, Connection, EdgeFunction, Junction, Lane, Net, Path as LanePath, Problem,
};

/// Distance between the last spawn place and the end of its lane: half a vehicle and the jitter
/// \[m\].
const BEHIND: f64 = 3.3;
/// Smallest width of a lane on which a vehicle fits with its jitter \[m\].
const WIDTH: f64 = 2.4;
/// Distance of the last spawn place from the end of a long lane \[m\].
const AHEAD: f64 = 20.0;
/// Number of places on a lane that ends the search upstream, largest number of places in a row, and
/// largest number of routes.
const ENOUGH: u32 = 4;
const ROW: u32 = 12;
const ROUTES: usize = 64;
/// Limits of the searches for spawn places upstream and for a finish line downstream: number of
/// edges, and distance upstream \[m\].
const EDGES: usize = 8;
const UPSTREAM: f64 = 300.0;
/// Length of the shortest last edge, and distance of the finish line from its end \[m\].
const LAST: f64 = 6.0;
const FINISH: f64 = 5.0;

/// A junction that is a possible site of the scenario.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Candidate {
    /// Id of the junction, or of one junction of a roundabout.
    pub junction: String,
    /// SUMO's type of junction, or `roundabout`.
    pub kind: String,
    /// Number of roads that vehicles come from.
    pub arms: usize,
    /// Number of routes over the junction.
    pub routes: usize,
    /// Number of spawn places.
    pub places: u32,
}

/// The junctions of a net.
pub(super) struct Survey<'n> {
    /// All possible sites, in descending order of arms and places.
    pub(super) proposals: Vec<Proposal<'n>>,
    /// The ids of all other junctions, and what was left out there.
    pub(super) refused: Vec<(Vec<&'n str>, LeftOut)>,
}

/// A junction with the parts of a scenario at it.
pub(super) struct Proposal<'n> {
    pub(super) candidate: Candidate,
    pub(super) routes: Vec<Route>,
    pub(super) rows: Vec<Row>,
    /// Lowest speed limit on the routes \[m/s\].
    pub(super) speed: f64,
    /// Paths of the routes, in the order of the routes.
    pub(super) paths: Vec<LanePath>,
    /// What the routes do not contain.
    pub(super) left_out: LeftOut,
    /// Ids of the junction, or of all junctions of the roundabout.
    junctions: Vec<&'n str>,
}

impl Proposal<'_> {
    /// Returns whether the site is at this junction.
    pub(super) fn is_at(&self, junction: &str) -> bool {
        self.junctions.contains(&junction)
    }
}

/// Returns all junctions, and those at which paths of vehicles from at least two roads conflict as
/// proposals.
pub(super) fn sites(net: &Net) -> Survey<'_> {
    let map = Streets::new(net);
    let (mut proposals, mut refused) = (Vec::new(), Vec::new());
    for place in places(net) {
        match map.site(&place) {
            Ok(proposal) => proposals.push(proposal),
            Err(left_out) => refused.push((place.junctions, left_out)),
        }
    }
    let rank = |site: &Proposal| (site.candidate.arms, site.candidate.places);
    proposals.sort_by(|a, b| {
        rank(b).cmp(&rank(a)).then_with(|| a.candidate.junction.cmp(&b.candidate.junction))
    });
    Survey { proposals, refused }
}

/// A junction, or the junctions of a roundabout.
struct Place<'n> {
    kind: &'n str,
    junctions: Vec<&'n str>,
    /// Edges of the roundabout.
    ring: HashSet<usize>,
}

/// Returns the roundabouts of a net and its other junctions.
fn places(net: &Net) -> Vec<Place<'_>> {
    let known: HashSet<&str> = net.junctions.iter().map(|junction| junction.id.as_str()).collect();
    let mut places = Vec::new();
    for roundabout in &net.roundabouts {
        let mut junctions: Vec<&str> = roundabout.junctions.iter().map(String::as_str).collect();
        junctions.retain(|id| known.contains(id));
        junctions.sort_unstable();
        let ring = roundabout.edges.iter().filter_map(|id| net.edge_index(id)).collect();
        if !junctions.is_empty() {
            places.push(Place { kind: "roundabout", junctions, ring });
        }
    }
    let round: HashSet<&str> =
        places.iter().flat_map(|place| place.junctions.iter().copied()).collect();
    let single = |junction: &&Junction| {
        !junction.id.starts_with(':') && !round.contains(junction.id.as_str())
    };
    places.extend(net.junctions.iter().filter(single).map(|junction| Place {
        kind: &junction.kind,
        junctions: vec![&junction.id],
        ring: HashSet::new(),
    }));
    places
}

/// The lanes of a net that cars can use, and their predecessors.
struct Streets<'n> {
    net: &'n Net,
    /// For each lane, the lanes that lead to it; straight connections come first.
    before: Vec<Vec<usize>>,
    /// Edges that lead to each junction.
    leading: HashMap<&'n str, Vec<usize>>,
}

/// A route from a junction's lane, with the edge to the junction, the lane on which it begins, and
/// its path.
type Found = (Route, usize, usize, LanePath);

impl<'n> Streets<'n> {
    fn new(net: &'n Net) -> Self {
        let mut before = vec![Vec::new(); net.lanes.len()];
        let mut leading = HashMap::<&str, Vec<usize>>::new();
        for edge in net.roads() {
            if let (Some(to), Some(index)) = (edge.to.as_deref(), net.edge_index(&edge.id)) {
                leading.entry(to).or_default().push(index);
            }
        }
        let streets = Self { net, before: Vec::new(), leading };
        for connection in net.connections.iter().filter(|c| streets.leads_on(c).is_ok()) {
            let list: &mut Vec<usize> = &mut before[connection.to];
            list.insert(if connection.dir == "s" { 0 } else { list.len() }, connection.from);
        }
        Self { before, ..streets }
    }

    /// Returns whether a car, with its lateral jitter, fits on a lane of a road, or why not.
    fn fits(&self, lane: usize) -> Result<(), &'static str> {
        let (lane, edge) = (&self.net.lanes[lane], &self.net.edges[self.net.lanes[lane].edge]);
        match () {
            () if edge.function != EdgeFunction::Normal => Err("lanes outside of roads"),
            () if !lane.classes.contain(CARS) => Err("lanes closed to cars"),
            () if lane.width < WIDTH => Err("lanes narrower than 2.4 m"),
            () if lane.speed <= 0.0 => Err("lanes with the speed limit 0"),
            () => Ok(()),
        }
    }

    /// Returns whether a car can take a connection between lanes of roads, or why not.
    fn leads_on(&self, connection: &Connection) -> Result<(), &'static str> {
        self.fits(connection.from)?;
        self.fits(connection.to)?;
        if self.net.admits(connection, &[CARS]) {
            Ok(())
        } else {
            Err("connections closed to cars")
        }
    }

    /// Returns the number of spawn places that fit on a lane.
    fn room(&self, lane: usize) -> u32 {
        let lane = &self.net.lanes[lane];
        let free = lane.length - along(lane, FIRST) - along(lane, BEHIND);
        if free < 0.0 { 0 } else { ((free / along(lane, SPACING)) as u32 + 1).min(ROW) }
    }

    /// Searches `lane` and the lanes upstream for the one with the most room. Returns the edges
    /// from there to the edge of `lane`, and the lane with the most room.
    fn upstream(&self, lane: usize) -> (Vec<usize>, usize) {
        let edge = |lane: usize| self.net.lanes[lane].edge;
        let (mut chain, mut lane) = (vec![edge(lane)], lane);
        let mut best = (chain.clone(), lane);
        let mut metres = 0.0;
        while self.room(lane) < ENOUGH && chain.len() < EDGES && metres < UPSTREAM {
            metres += self.net.lanes[lane].length;
            let Some(&next) = self.before[lane].iter().find(|&&next| !chain.contains(&edge(next)))
            else {
                break;
            };
            lane = next;
            chain.insert(0, edge(lane));
            if self.room(lane) > self.room(best.1) {
                best = (chain.clone(), lane);
            }
        }
        best
    }

    /// Returns a lane's edge and the edges after it, up to the first edge that is long enough for a
    /// finish line.
    fn downstream(&self, mut lane: usize) -> Option<Vec<usize>> {
        let mut chain = Vec::new();
        loop {
            let here = &self.net.lanes[lane];
            chain.push(here.edge);
            if here.length >= along(here, LAST) {
                return Some(chain);
            }
            let onward = self
                .net
                .connections_from(lane)
                .filter(|c| !turns_back(c) && self.leads_on(c).is_ok());
            let next = onward.min_by_key(|c| c.dir != "s")?.to;
            if chain.len() >= EDGES || chain.contains(&self.net.lanes[next].edge) {
                return None;
            }
            lane = next;
        }
    }

    /// Appends the ways from a lane over the place to a lane behind it: the edges of the roundabout
    /// on the way, and that lane.
    fn over(
        &self,
        place: &Place,
        lane: usize,
        ring: &[usize],
        ways: &mut Vec<(Vec<usize>, usize)>,
        left_out: &mut LeftOut,
    ) {
        let sidewalk = |lane: usize| self.net.lanes[lane].is_sidewalk();
        for link in self.net.connections_from(lane).filter(|link| !sidewalk(link.to)) {
            let next = self.net.lanes[link.to].edge;
            if turns_back(link) {
                left_out.add("U-turns", self.name(link));
            } else if let Err(why) = self.leads_on(link) {
                left_out.add(why, self.name(link));
            } else if !place.ring.contains(&next) {
                ways.push((ring.to_vec(), link.to));
            } else if !ring.contains(&next) {
                let further: Vec<usize> = ring.iter().copied().chain([next]).collect();
                self.over(place, link.to, &further, ways, left_out);
            }
        }
    }

    /// Returns the name of a connection for messages.
    fn name(&self, link: &Connection) -> String {
        format!("{} to {}", self.net.lanes[link.from].id, self.net.lanes[link.to].id)
    }

    /// Returns the routes over a place from each of its lanes, and the rows of places where the
    /// routes begin. If there are no conflicts, returns what was left out.
    fn site(&self, place: &Place<'n>) -> Result<Proposal<'n>, LeftOut> {
        let mut left_out = LeftOut::default();
        let incoming = place.junctions.iter().filter_map(|id| self.leading.get(id)).flatten();
        let incoming = incoming.copied().filter(|edge| !place.ring.contains(edge));
        let incoming: Vec<usize> = incoming.collect();
        if incoming.len() < 2 {
            return Err(left_out);
        }
        let mut routes: Vec<Found> = Vec::new();
        for edge in incoming {
            for lane in self.net.edges[edge].lanes.clone() {
                self.routes_of(place, edge, lane, &mut routes, &mut left_out);
            }
        }
        let mut arms: Vec<usize> = routes.iter().map(|(_, edge, ..)| *edge).collect();
        arms.dedup();
        let meeting = |(_, a, _, one): &Found| {
            routes.iter().any(|(_, b, _, other)| a != b && meet(one, other))
        };
        if !routes.iter().any(meeting) {
            return Err(left_out);
        }
        let mut rows = BTreeMap::<usize, Vec<usize>>::new();
        for (i, (_, _, start, _)) in routes.iter().enumerate() {
            rows.entry(*start).or_default().push(i);
        }
        let row = |(start, routes): (usize, Vec<usize>)| {
            let (count, lane) = (self.room(start), &self.net.lanes[start]);
            let spacing = along(lane, SPACING);
            let first = lane.length - along(lane, AHEAD) - spacing * f64::from(count - 1);
            Row { routes, first: first.floor().max(along(lane, FIRST)), spacing, count }
        };
        let rows: Vec<Row> = rows.into_iter().map(row).collect();
        let lanes = routes.iter().flat_map(|(_, _, _, path)| &path.lanes);
        let lanes = lanes.filter(|&&lane| self.fits(lane).is_ok());
        Ok(Proposal {
            candidate: Candidate {
                junction: place.junctions[0].to_owned(),
                kind: place.kind.to_owned(),
                arms: arms.len(),
                routes: routes.len(),
                places: rows.iter().map(|row| row.count).sum(),
            },
            speed: lanes.map(|&lane| self.net.lanes[lane].speed).fold(f64::INFINITY, f64::min),
            routes: routes
                .iter()
                .enumerate()
                .map(|(i, (route, ..))| Route { id: format!("{i}_{}", route.id), ..route.clone() })
                .collect(),
            paths: routes.into_iter().map(|(_, _, _, path)| path).collect(),
            rows,
            left_out,
            junctions: place.junctions.clone(),
        })
    }

    /// Adds the routes over a place from one of the lanes that lead to it.
    fn routes_of(
        &self,
        place: &Place,
        edge: usize,
        lane: usize,
        routes: &mut Vec<Found>,
        left_out: &mut LeftOut,
    ) {
        if self.net.lanes[lane].is_sidewalk() {
            return;
        }
        let name = || self.net.lanes[lane].id.clone();
        if let Err(why) = self.fits(lane) {
            return left_out.add(why, name());
        }
        let (chain, start) = self.upstream(lane);
        if self.room(start) == 0 {
            return left_out.add("lanes too short for a spawn place", name());
        }
        let mut ways = Vec::new();
        self.over(place, lane, &[], &mut ways, left_out);
        for (ring, to) in ways {
            let way = || format!("{} to {}", name(), self.net.lanes[to].id);
            // Round a roundabout and back.
            let ends = [edge, self.net.lanes[to].edge].map(|edge| &self.net.edges[edge]);
            if !ring.is_empty() && ends[0].from == ends[1].to {
                left_out.add("U-turns", way());
                continue;
            }
            let Some(exit) = self.downstream(to) else {
                left_out.add("ways to roads too short for a finish line", way());
                continue;
            };
            let (route, path) = match self.route([&chain, &ring, &exit], start) {
                Ok(found) => found,
                Err(why) => {
                    left_out.add(why, way());
                    continue;
                }
            };
            let same = |(known, ..): &Found| known.edges == route.edges && known.lane == route.lane;
            if routes.iter().any(same) {
                left_out.add(
                    "ways beside one to another lane of the same road, which SUMO takes",
                    way(),
                );
            } else if routes.len() == ROUTES {
                left_out.add("routes beyond the 64 that are allowed", way());
            } else {
                routes.push((route, edge, start, path));
            }
        }
    }

    /// Returns a route from a lane along edges to a place, round it and away from it, and its path,
    /// or why there is none.
    fn route(
        &self,
        [chain, ring, exit]: [&[usize]; 3],
        start: usize,
    ) -> Result<(Route, LanePath), &'static str> {
        // A loop would lead back over spawn places.
        if ring.iter().chain(exit).any(|edge| chain.contains(edge)) {
            return Err("ways back to where they begin");
        }
        let id = |edge: &usize| self.net.edges[*edge].id.clone();
        let edges: Vec<String> = [chain, ring, exit].concat().iter().map(id).collect();
        let lane = Some(self.net.lanes[start].index);
        let path = self.net.route_path_from(&edges, lane).map_err(|error| match error.problem {
            Problem::LaneChange { .. } => "ways with a lane change",
            _ => "ways that cars cannot drive",
        })?;
        let name = format!("{}_to_{}", edges[chain.len() - 1], edges[chain.len() + ring.len()]);
        let id = name
            .chars()
            .map(|c| if c.is_alphanumeric() || "_-#.".contains(c) { c } else { '_' })
            .collect();
        let last = path.lanes.last().map_or(FINISH, |&lane| along(&self.net.lanes[lane], FINISH));
        let route = Route { id, edges, lane, arrival_pos: -last, reserved: false, off_lane: 1.0 };
        Ok((route, path))
    }
}

/// Returns whether a connection is a U-turn.
fn turns_back(connection: &Connection) -> bool {
    matches!(connection.dir.as_str(), "t" | "T")
}

/// Returns how far apart in SUMO's metres along a lane places must be that need `metres`. Where
/// SUMO's metres are not those of the shape, the result is a multiple of 0.1.
fn along(lane: &Lane, metres: f64) -> f64 {
    let stretch = lane.stretch();
    if stretch > 1.0 { (10.0 * metres * stretch).ceil() / 10.0 } else { metres }
}
