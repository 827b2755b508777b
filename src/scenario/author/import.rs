//! A first scenario for a map: one junction of it, the routes over that, and places upstream, for people to go on from.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use super::super::Route;
use super::files::{Layout, Row, Site, Steers, meet};
use super::{Error, FIRST, SPACING, netconvert};
use crate::sumo::net::{Connection, EdgeFunction, Junction, Net, Path as Way};

/// netconvert's options for OpenStreetMap: roads for cars, simple shapes, and rules instead of signals, which agents do not see.
const OSM_OPTIONS: [(&str, &str); 7] = [
    ("geometry.remove", "true"),
    ("roundabouts.guess", "true"),
    ("junctions.join", "true"),
    ("tls.discard-loaded", "true"),
    ("keep-edges.by-vclass", "passenger"),
    ("remove-edges.isolated", "true"),
    ("no-turnarounds", "true"),
];
/// What a place needs behind the last one on its lane: half a vehicle and the jitter \[m\].
const BEHIND: f64 = 3.3;
/// Least width of a lane that a vehicle and its jitter need \[m\].
const WIDTH: f64 = 2.4;
/// How far before the end of a long lane the last place is \[m\].
const AHEAD: f64 = 20.0;
/// Places on a lane for which it is not worth going further upstream, most places in a row, and most routes.
const ENOUGH: u32 = 4;
const ROW: u32 = 12;
const ROUTES: usize = 64;
/// How far upstream places are looked for, and how far downstream a finish: edges and metres.
const EDGES: usize = 8;
const UPSTREAM: f64 = 300.0;
/// Shortest last edge: the finish lies 5 m before its end \[m\].
const LAST: f64 = 6.0;
/// Bounds of the top speed, which is the lowest limit on the way \[m/s\].
const SPEED: (f64, f64) = (5.0, 22.222);

/// What a scenario is made of.
#[derive(Debug, Clone, Copy)]
pub enum Map<'a> {
    /// An extract of OpenStreetMap, as XML.
    Osm(&'a Path),
    /// A net for SUMO.
    Net(&'a Path),
}

/// A junction that may be a site.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Candidate {
    /// Its id.
    pub junction: String,
    /// SUMO's type.
    pub kind: String,
    /// Roads that vehicles come from.
    pub arms: usize,
    /// Ways over it.
    pub routes: usize,
    /// Places for vehicles.
    pub places: u32,
}

/// What an import made.
#[derive(Debug, Clone)]
pub struct Imported {
    /// The scenario file.
    pub scenario: PathBuf,
    /// All junctions that could be the site, the chosen one first, then by arms and places.
    pub candidates: Vec<Candidate>,
    /// What netconvert warned of.
    pub warnings: Vec<String>,
}

/// Makes a scenario called `name` of a map, below the folder `root`, at the junction of this id or, without one, at that with the most
/// arms and places; by default for so many agents, where there is room, which steer or follow their lanes.
///
/// # Errors
/// [`Error`]; nothing is left behind then.
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
                let warnings = netconvert::convert(&layout.net)?;
                let text = fs::read_to_string(&layout.net);
                if !text.is_ok_and(|net| net.contains("<edge ")) {
                    return Err(Error::NoSite {
                        path: file.into(),
                        why: "there are no roads for cars that lead to others".into(),
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
            Some(id) => sites.iter().position(|site| site.candidate.junction == id).unwrap_or(sites.len()),
        };
        if chosen >= sites.len() {
            let why = junction.map_or_else(
                || {
                    "there is no junction where cars from two roads meet and have room to begin on their lanes"
                        .to_owned()
                },
                |id| {
                    format!("at the junction `{id}` no cars from two roads meet that have room to begin on their lanes")
                },
            );
            return Err(Error::NoSite { path: net.path.clone(), why });
        }
        let proposal = sites.remove(chosen);
        let candidates = std::iter::once(&proposal).chain(&sites).map(|site| site.candidate.clone()).collect();
        let description = format!("Vehicles pass the junction {} of an imported map.", proposal.candidate.junction);
        layout.write(&layout.scenario(Site {
            description,
            routes: proposal.routes,
            ways: proposal.ways,
            rows: proposal.rows,
            agents,
            speed: proposal.speed.clamp(SPEED.0, SPEED.1),
            steers: if steering { Steers::Road } else { Steers::No },
        }))?;
        Ok(Imported { scenario: layout.scenario.clone(), candidates, warnings })
    })
}

/// A junction with what a scenario on it needs.
struct Proposal {
    candidate: Candidate,
    routes: Vec<Route>,
    rows: Vec<Row>,
    /// Lowest limit on the way \[m/s\].
    speed: f64,
    /// In order of the routes.
    ways: Vec<Way>,
}

/// All junctions at which vehicles from two roads or more can begin.
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

/// A net's lanes for cars, and how one gets there.
struct Streets<'a> {
    net: &'a Net,
    /// Lanes that lead to each lane and to no other one beside it, those straight on first.
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

    /// Whether a car, somewhat to the side, fits on a lane of a road.
    fn fits(&self, lane: usize) -> bool {
        let (lane, edge) = (&self.net.lanes[lane], &self.net.edges[self.net.lanes[lane].edge]);
        lane.cars && lane.width >= WIDTH && edge.function == EdgeFunction::Normal
    }

    /// Places on a lane.
    fn room(&self, lane: usize) -> u32 {
        let free = self.net.lanes[lane].length - FIRST - BEHIND;
        if free < 0.0 { 0 } else { ((free / SPACING) as u32 + 1).min(ROW) }
    }

    /// The edges from where there is the most room, upstream of a lane, to the lane's edge, and the lane to begin on.
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

    /// A lane's edge and those after it, until one is long enough to end on.
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

    /// The routes over a junction from each of its lanes, and the places where they begin.
    fn site(&self, junction: &Junction) -> Option<Proposal> {
        let incoming = self.leading.get(junction.id.as_str())?;
        if incoming.len() < 2 {
            return None;
        }
        let mut routes: Vec<(Route, usize, usize, Way)> = Vec::new();
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
        let meeting = |(_, a, _, one): &(Route, usize, usize, Way)| {
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
            routes.iter().flat_map(|(_, _, _, way)| &way.lanes).filter(|&&lane| self.fits(lane));
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
            ways: routes.into_iter().map(|(_, _, _, way)| way).collect(),
            rows,
        })
    }

    /// A route along edges from a lane, if it can be driven without changing lanes.
    fn route(&self, chain: &[usize], exit: &[usize], start: usize) -> Option<(Route, Way)> {
        // A loop would lead back onto places.
        if exit.iter().any(|edge| chain.contains(edge)) {
            return None;
        }
        let id = |edge: &usize| self.net.edges[*edge].id.clone();
        let edges: Vec<String> = chain.iter().chain(exit).map(id).collect();
        let lane = Some(self.net.lanes[start].index);
        // Where a lane forks towards one road, SUMO may choose another way than ours.
        let way = self
            .net
            .route_path_from(&edges, lane)
            .ok()
            .filter(|way| self.net.fork(way).is_none())?;
        let name = format!("{}_to_{}", edges[chain.len() - 1], edges[chain.len()]);
        let id = name
            .chars()
            .map(|c| if c.is_alphanumeric() || "_-#.".contains(c) { c } else { '_' })
            .collect();
        Some((Route { id, edges, lane, arrival_pos: -5.0, reserved: false, off_lane: 1.0 }, way))
    }
}
