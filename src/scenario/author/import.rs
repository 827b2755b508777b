//! Makes a first scenario from a map, as a basis for editing: one junction of the map, the routes
//! over it, and spawn places upstream.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use super::super::Route;
use super::files::{Layout, Row, Site, Steers, meet};
use super::{Error, FIRST, SPACING, netconvert};
use crate::sumo::net::{
    Connection, EdgeFunction, Junction, Net, Path as LanePath, did_you_mean, nearest, shorten,
};

/// netconvert's options for OpenStreetMap: roads for cars, simple shapes, and priority rules
/// instead of traffic lights, which agents do not observe.
const OSM_OPTIONS: [(&str, &str); 7] = [
    ("geometry.remove", "true"),
    ("roundabouts.guess", "true"),
    ("junctions.join", "true"),
    ("tls.discard-loaded", "true"),
    ("keep-edges.by-vclass", "passenger"),
    ("remove-edges.isolated", "true"),
    ("no-turnarounds", "true"),
];
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
/// Length of the shortest last edge \[m\]; the finish line is 5 m before its end.
const LAST: f64 = 6.0;
/// Bounds of the top speed, which is the lowest speed limit on the routes \[m/s\].
const SPEED: (f64, f64) = (5.0, 22.222);

/// Map from which a scenario is made.
#[derive(Debug, Clone, Copy)]
pub enum Map<'a> {
    /// An extract of OpenStreetMap, as XML.
    Osm(&'a Path),
    /// A SUMO net.
    Net(&'a Path),
}

/// A junction that is a possible site of the scenario.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Candidate {
    /// Id.
    pub junction: String,
    /// SUMO's type of junction.
    pub kind: String,
    /// Number of roads that vehicles come from.
    pub arms: usize,
    /// Number of routes over the junction.
    pub routes: usize,
    /// Number of spawn places.
    pub places: u32,
}

/// Result of an import.
#[derive(Debug, Clone)]
pub struct Imported {
    /// The scenario file.
    pub scenario: PathBuf,
    /// All possible junctions: the chosen one first, the others in descending order of arms and
    /// places.
    pub candidates: Vec<Candidate>,
    /// Warnings of netconvert.
    pub warnings: Vec<String>,
}

/// Makes a scenario `name` from a map, below the folder `root`. Its site is the junction with the
/// given id or, without one, the junction with the most arms and places. `agents` is the default
/// number of agents, limited by the number of places. With `steering`, vehicles steer instead of
/// following their lanes.
///
/// # Errors
/// [`Error`]; no file is left behind in this case.
pub fn import(
    root: &Path,
    name: &str,
    map: Map,
    junction: Option<&str>,
    agents: u32,
    steering: bool,
) -> Result<Imported, Error> {
    let layout = Layout::new(root, name)?;
    layout.fill(|| {
        let copy = |from: &Path, to: &Path| {
            fs::copy(from, to).map(drop).map_err(|source| Error::Read { path: from.into(), source })
        };
        let warnings = match map {
            Map::Osm(file) => {
                copy(file, &layout.file("osm.xml"))?;
                layout.configure(&[("osm-files", format!("{name}.osm.xml"))], &OSM_OPTIONS)?;
                // The configuration is not left behind; the user's file is the map.
                let warnings = netconvert::convert(&layout.net).map_err(|error| match error {
                    Error::Netconvert { message, .. } => Error::Map { path: file.into(), message },
                    error => error,
                })?;
                let text = fs::read_to_string(&layout.net);
                if !text.is_ok_and(|net| net.contains("<edge ")) {
                    return Err(Error::NoSite {
                        path: file.into(),
                        why: "the map has no roads for cars that lead to others".into(),
                        hint: LARGER,
                    });
                }
                warnings
            }
            Map::Net(file) => {
                Net::load(file)?;
                copy(file, &layout.net)?;
                Vec::new()
            }
        };
        let net = Net::load(&layout.net)?;
        let mut sites = sites(&net);
        let chosen = match junction {
            None => 0,
            Some(id) => {
                sites.iter().position(|site| site.candidate.junction == id).unwrap_or(sites.len())
            }
        };
        if chosen >= sites.len() {
            let (Map::Osm(file) | Map::Net(file)) = map;
            return Err(no_site(file, &net, junction, &sites));
        }
        let proposal = sites.remove(chosen);
        let candidates =
            std::iter::once(&proposal).chain(&sites).map(|site| site.candidate.clone()).collect();
        let description = format!(
            "Vehicles pass the junction {} of an imported map.",
            proposal.candidate.junction
        );
        let scenario = layout.scenario(Site {
            description,
            routes: proposal.routes,
            paths: proposal.paths,
            rows: proposal.rows,
            agents,
            speed: proposal.speed.clamp(SPEED.0, SPEED.1),
            steers: if steering { Steers::Road } else { Steers::No },
        })?;
        layout.write(&scenario)?;
        Ok(Imported { scenario: layout.scenario.clone(), candidates, warnings })
    })
}

/// What to do about a map without a site.
const LARGER: &str = "take a map that contains a junction of at least two streets for cars, with some 50 m of each street";
/// What to do about a junction that is no site.
const OTHER: &str = "choose another id with --junction, or leave the option out: the best junction is then chosen, and the others are listed";
/// Maximum number of junctions that an error lists.
const LISTED: usize = 5;

/// Returns the error that no scenario can be made of a map, or of one of its junctions; `sites` are
/// the junctions of which one can be made.
fn no_site(map: &Path, net: &Net, junction: Option<&str>, sites: &[Proposal]) -> Error {
    let needed = "vehicles from two roads conflict and have room for spawn places on their lanes";
    let mut ids = net.junctions.iter().map(|junction| junction.id.as_str());
    let why = match junction {
        _ if sites.is_empty() => format!("the map has no junction where {needed}"),
        Some(id) if !ids.any(|known| known == id) => {
            let ids = net.junctions.iter().map(|junction| junction.id.as_str());
            let similar = did_you_mean(nearest(id, ids));
            format!("the map has no junction `{}`{similar}", shorten(id))
        }
        id => {
            format!("`{}` is not a junction where {needed}", shorten(id.unwrap_or_default()))
        }
    };
    let listed: Vec<String> = sites
        .iter()
        .take(LISTED)
        .map(|site| format!("`{}`", shorten(&site.candidate.junction)))
        .collect();
    let why =
        if sites.is_empty() { why } else { format!("{why}; possible: {}", listed.join(", ")) };
    let hint = if sites.is_empty() { LARGER } else { OTHER };
    Error::NoSite { path: map.into(), why, hint }
}

/// A junction with the parts of a scenario at it.
struct Proposal {
    candidate: Candidate,
    routes: Vec<Route>,
    rows: Vec<Row>,
    /// Lowest speed limit on the routes \[m/s\].
    speed: f64,
    /// Paths of the routes, in the order of the routes.
    paths: Vec<LanePath>,
}

/// Returns all junctions at which paths of vehicles from at least two roads conflict, in descending
/// order of arms and places.
fn sites(net: &Net) -> Vec<Proposal> {
    let map = Streets::new(net);
    let mut sites: Vec<Proposal> =
        net.junctions.iter().filter_map(|junction| map.site(junction)).collect();
    let rank = |site: &Proposal| (site.candidate.arms, site.candidate.places);
    sites.sort_by(|a, b| {
        rank(b).cmp(&rank(a)).then_with(|| a.candidate.junction.cmp(&b.candidate.junction))
    });
    sites
}

/// The lanes of a net that cars can use, and their predecessors.
struct Streets<'a> {
    net: &'a Net,
    /// For each lane, the lanes that lead to it and to no other lane of its edge; straight
    /// connections come first.
    before: Vec<Vec<usize>>,
    /// Edges that lead to each junction.
    leading: BTreeMap<&'a str, Vec<usize>>,
}

impl<'a> Streets<'a> {
    fn new(net: &'a Net) -> Self {
        let mut before = vec![Vec::new(); net.lanes.len()];
        let mut leading = BTreeMap::<&str, Vec<usize>>::new();
        for edge in net.roads() {
            if let (Some(to), Some(index)) = (edge.to.as_deref(), net.edge_index(&edge.id)) {
                leading.entry(to).or_default().push(index);
            }
        }
        let streets = Self { net, before: Vec::new(), leading };
        let only = |c: &Connection| {
            let next = net.lanes[c.to].edge;
            net.connections_from(c.from).filter(|other| net.lanes[other.to].edge == next).count()
                == 1
        };
        let fits = |c: &Connection| streets.fits(c.from) && streets.fits(c.to);
        for connection in net.connections.iter().filter(|c| fits(c) && only(c)) {
            let list: &mut Vec<usize> = &mut before[connection.to];
            list.insert(if connection.dir == "s" { 0 } else { list.len() }, connection.from);
        }
        Self { before, ..streets }
    }

    /// Returns whether a car, with its lateral jitter, fits on a lane of a road.
    fn fits(&self, lane: usize) -> bool {
        let (lane, edge) = (&self.net.lanes[lane], &self.net.edges[self.net.lanes[lane].edge]);
        lane.cars && lane.width >= WIDTH && edge.function == EdgeFunction::Normal
    }

    /// Returns the number of spawn places that fit on a lane.
    fn room(&self, lane: usize) -> u32 {
        let free = self.net.lanes[lane].length - FIRST - BEHIND;
        if free < 0.0 { 0 } else { ((free / SPACING) as u32 + 1).min(ROW) }
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
            if here.length >= LAST {
                return Some(chain);
            }
            let onward =
                self.net.connections_from(lane).filter(|c| c.dir != "t" && self.fits(c.to));
            let next = onward.min_by_key(|c| c.dir != "s")?.to;
            if chain.len() >= EDGES || chain.contains(&self.net.lanes[next].edge) {
                return None;
            }
            lane = next;
        }
    }

    /// Returns the routes over a junction from each of its lanes, and the rows of places where the
    /// routes begin.
    fn site(&self, junction: &Junction) -> Option<Proposal> {
        let incoming = self.leading.get(junction.id.as_str())?;
        if incoming.len() < 2 {
            return None;
        }
        let mut routes: Vec<(Route, usize, usize, LanePath)> = Vec::new();
        for &edge in incoming {
            for lane in self.net.edges[edge].lanes.clone().filter(|&lane| self.fits(lane)) {
                let (chain, start) = self.upstream(lane);
                if self.room(start) == 0 {
                    continue;
                }
                for link in
                    self.net.connections_from(lane).filter(|c| c.dir != "t" && self.fits(c.to))
                {
                    let Some(exit) = self.downstream(link.to) else { continue };
                    let Some(route) = self.route(&chain, &exit, start) else { continue };
                    let known = routes.iter().any(|(known, ..)| {
                        known.edges == route.0.edges && known.lane == route.0.lane
                    });
                    if !known && routes.len() < ROUTES {
                        routes.push((route.0, edge, start, route.1));
                    }
                }
            }
        }
        let mut arms: Vec<usize> = routes.iter().map(|(_, edge, ..)| *edge).collect();
        arms.dedup();
        let meeting = |(_, a, _, one): &(Route, usize, usize, LanePath)| {
            routes.iter().any(|(_, b, _, other)| a != b && meet(one, other))
        };
        if !routes.iter().any(meeting) {
            return None;
        }
        let mut rows = BTreeMap::<usize, Vec<usize>>::new();
        for (i, (_, _, start, _)) in routes.iter().enumerate() {
            rows.entry(*start).or_default().push(i);
        }
        let row = |(start, routes): (usize, Vec<usize>)| {
            let (count, length) = (self.room(start), self.net.lanes[start].length);
            let first = (length - AHEAD - SPACING * f64::from(count - 1)).floor().max(FIRST);
            Row { routes, first, count }
        };
        let rows: Vec<Row> = rows.into_iter().map(row).collect();
        let lanes =
            routes.iter().flat_map(|(_, _, _, path)| &path.lanes).filter(|&&lane| self.fits(lane));
        Some(Proposal {
            candidate: Candidate {
                junction: junction.id.clone(),
                kind: junction.kind.clone(),
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
        })
    }

    /// Returns a route along edges from a lane, and its path, if the route can be driven without
    /// changing lanes.
    fn route(&self, chain: &[usize], exit: &[usize], start: usize) -> Option<(Route, LanePath)> {
        // A loop would lead back over spawn places.
        if exit.iter().any(|edge| chain.contains(edge)) {
            return None;
        }
        let id = |edge: &usize| self.net.edges[*edge].id.clone();
        let edges: Vec<String> = chain.iter().chain(exit).map(id).collect();
        let lane = Some(self.net.lanes[start].index);
        // Where a lane leads to several lanes of one road, SUMO may choose another lane than the
        // route.
        let path = self
            .net
            .route_path_from(&edges, lane)
            .ok()
            .filter(|path| self.net.fork(path).is_none())?;
        let name = format!("{}_to_{}", edges[chain.len() - 1], edges[chain.len()]);
        let id = name
            .chars()
            .map(|c| if c.is_alphanumeric() || "_-#.".contains(c) { c } else { '_' })
            .collect();
        Some((Route { id, edges, lane, arrival_pos: -5.0, reserved: false, off_lane: 1.0 }, path))
    }
}
