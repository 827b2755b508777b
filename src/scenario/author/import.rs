//! Makes a first scenario from a map, as a basis for editing: one junction of the map, the routes
//! over it, and spawn places upstream.

use std::borrow::Cow;
use std::collections::HashSet;
use std::fs;
use std::path::{Path, PathBuf};

use super::files::{Layout, Site, Steers};
use super::left_out::LeftOut;
use super::site::{Candidate, Survey, sites};
use super::{Error, netconvert};
use crate::record::write_atomic;
use crate::sumo::net::{Net, Path as LanePath, cut, did_you_mean, nearest, shorten};

/// netconvert's options for OpenStreetMap: roads for cars, simple shapes, and traffic lights at
/// junctions, also where the map has their signals at the stop lines.
const OSM_OPTIONS: [(&str, &str); 8] = [
    ("geometry.remove", "true"),
    ("roundabouts.guess", "true"),
    ("junctions.join", "true"),
    ("tls.guess-signals", "true"),
    ("tls.join", "true"),
    ("keep-edges.by-vclass", "passenger"),
    ("remove-edges.isolated", "true"),
    ("no-turnarounds", "true"),
];
/// Largest top speed, which otherwise is the lowest speed limit on the routes \[m/s\].
pub(super) const SPEED: f64 = 22.222;
/// Junctions up to this distance from the routes belong to the scenario's part of a large net: the
/// range in which agents observe others \[m\].
const NEAR: f64 = 100.0;
/// Size from which a net is large \[bytes\]. Smaller ones stay whole.
const LARGE: usize = 500_000;

/// Map from which a scenario is made.
#[derive(Debug, Clone, Copy)]
pub enum Map<'a> {
    /// An extract of OpenStreetMap, as XML.
    Osm(&'a Path),
    /// A SUMO net.
    Net(&'a Path),
}

/// Choices of an import.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Choices<'a> {
    /// Id of the junction; without one, the junction with the most arms and places.
    pub junction: Option<&'a str>,
    /// Default number of agents, limited by the number of places.
    pub agents: u32,
    /// Whether vehicles steer instead of following their lanes.
    pub steering: bool,
    /// Whether vehicles drive on the left, in a map of OpenStreetMap. They also do if the map says
    /// so (`driving_side`).
    pub left_hand: bool,
    /// Whether a large net stays whole. Otherwise only what is near the routes stays.
    pub whole_net: bool,
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
    /// What the scenario does not have of its map, and what was assumed.
    pub notes: Vec<String>,
}

/// Makes a scenario `name` from a map, below the folder `root`.
///
/// # Errors
/// [`Error`]; no file is left behind in this case.
pub fn import(root: &Path, name: &str, map: Map, choices: &Choices) -> Result<Imported, Error> {
    let layout = Layout::new(root, name)?;
    layout.fill(|| {
        let mut notes = Vec::new();
        let copy = |from: &Path, to: &Path| {
            fs::copy(from, to).map(drop).map_err(|source| Error::Read { path: from.into(), source })
        };
        let (source, warnings) = match map {
            Map::Osm(file) => {
                copy(file, &layout.file("osm.xml"))?;
                let left = choices.left_hand || drives_left(file, &mut notes)?;
                let lefthand = left.then_some(("lefthand", "true"));
                let options: Vec<_> = OSM_OPTIONS.into_iter().chain(lefthand).collect();
                layout.configure(&[("osm-files", format!("{name}.osm.xml"))], &options)?;
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
                (layout.net.as_path(), warnings)
            }
            Map::Net(file) => (file, Vec::new()),
        };
        let text = Net::text(source)?;
        let net = Net::parse(&text, source)?;
        let mut survey = sites(&net);
        let chosen = match choices.junction {
            None => Some(0).filter(|_| !survey.proposals.is_empty()),
            Some(id) => survey.proposals.iter().position(|site| site.is_at(id)),
        };
        let Some(chosen) = chosen else {
            let (Map::Osm(file) | Map::Net(file)) = map;
            return Err(no_site(file, &net, choices.junction, &survey));
        };
        let proposal = survey.proposals.remove(chosen);
        let candidates = std::iter::once(&proposal).chain(&survey.proposals);
        let candidates = candidates.map(|site| site.candidate.clone()).collect();
        notes.extend(proposal.left_out.lines());
        let near = near(&net, &proposal.paths);
        let part = (!choices.whole_net && text.len() >= LARGE).then(|| cut(&text, source, &near));
        match (part.transpose()?.filter(|part| part.len() < text.len() / 2), map) {
            (Some(part), _) => {
                write_atomic(&layout.net, part.as_bytes())?;
                let roads = |net: &Net| net.roads().count();
                notes.push(format!(
                    "the net is cut to {} of {} roads, those at junctions up to {NEAR} m from the routes; --whole-net keeps all",
                    roads(&Net::parse(&part, &layout.net)?),
                    roads(&net)
                ));
            }
            (None, Map::Net(_)) => write_atomic(&layout.net, in_utf8(&text).as_bytes())?,
            (None, Map::Osm(_)) => {}
        }
        let description = format!(
            "Vehicles pass the junction {} of an imported map.",
            proposal.candidate.junction
        );
        let has_signals =
            proposal.paths.iter().any(|path| !net.signals_on(path).is_empty());
        let scenario = layout.scenario(Site {
            has_signals,
            description,
            routes: proposal.routes,
            paths: proposal.paths,
            rows: proposal.rows,
            agents: choices.agents,
            speed: proposal.speed.min(SPEED),
            steers: if choices.steering { Steers::Road } else { Steers::No },
        })?;
        layout.write(&scenario)?;
        Ok(Imported { scenario: layout.scenario.clone(), candidates, warnings, notes })
    })
}

/// Returns whether most roads of an extract of OpenStreetMap that say on which side vehicles drive
/// say that it is the left. Adds a note on what the extract says.
fn drives_left(file: &Path, notes: &mut Vec<String>) -> Result<bool, Error> {
    let text = crate::markup::read(file, u64::MAX - 1);
    let text = text.map_err(|source| Error::Read { path: file.into(), source })?;
    let text = text.unwrap_or_default();
    let mut sides = [0; 2];
    for (at, _) in text.match_indices("driving_side") {
        let tag = text[..at].rfind('<').unwrap_or(at);
        let tag = text[tag..].split('>').next().unwrap_or_default();
        let says = |side: &str| ['"', '\''].iter().any(|q| tag.contains(&format!("{q}{side}{q}")));
        sides[0] += usize::from(says("left"));
        sides[1] += usize::from(says("right"));
    }
    let left = sides[0] > sides[1];
    if left {
        notes.push("vehicles drive on the left, as the map says (driving_side)".into());
    } else if sides == [0; 2] {
        notes.push(
            "the map does not say on which side vehicles drive (driving_side): they drive on the right; --left-hand changes it"
                .into(),
        );
    }
    Ok(left)
}

/// Returns the text of a net that declares no other encoding than its own.
pub(super) fn in_utf8(text: &str) -> Cow<'_, str> {
    let rest = text.strip_prefix("<?xml").and_then(|text| text.split_once("?>"));
    match rest {
        Some((declared, rest)) if !declared.to_ascii_uppercase().contains("UTF-8") => {
            format!("<?xml version=\"1.0\" encoding=\"UTF-8\"?>{rest}").into()
        }
        _ => text.into(),
    }
}

/// Returns the junctions that are near a route.
fn near<'n>(net: &'n Net, paths: &[LanePath]) -> HashSet<&'n str> {
    let distance = |[x, y]: [f64; 2], a: [f64; 2], b: [f64; 2]| {
        let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
        let along =
            ((x - a[0]) * dx + (y - a[1]) * dy) / (dx * dx + dy * dy).max(f64::MIN_POSITIVE);
        let t = along.clamp(0.0, 1.0);
        (x - a[0] - t * dx).hypot(y - a[1] - t * dy)
    };
    let is_near = |at: [f64; 2]| {
        let mut segments = paths.iter().flat_map(|path| path.points.windows(2));
        segments.any(|pair| distance(at, pair[0], pair[1]) <= NEAR)
    };
    let junctions = net.junctions.iter().filter(|junction| is_near([junction.x, junction.y]));
    let passed = paths
        .iter()
        .flat_map(|path| &path.edges)
        .filter_map(|id| net.edges[net.edge_index(id)?].to.as_deref());
    junctions.map(|junction| junction.id.as_str()).chain(passed).collect()
}

/// What to do about a map without a site.
const LARGER: &str = "take a map that contains a junction of at least two streets for cars, with some 50 m of each street";
/// What to do about a junction that is no site.
const OTHER: &str = "choose another id with --junction, or leave the option out: the best junction is then chosen, and the others are listed";
/// Maximum number of junctions that an error lists.
const LISTED: usize = 5;

/// Returns the error that no scenario can be made of a map, or of one of its junctions.
fn no_site(map: &Path, net: &Net, junction: Option<&str>, survey: &Survey<'_>) -> Error {
    let needed = "vehicles from two roads conflict and have room for spawn places on their lanes";
    let ids = || net.junctions.iter().map(|junction| junction.id.as_str());
    let sites = &survey.proposals;
    let (what, left_out) = match junction {
        Some(id) if !ids().any(|known| known == id) => {
            let similar = did_you_mean(nearest(id, ids()));
            (format!("the map has no junction `{}`{similar}", shorten(id)), LeftOut::default())
        }
        Some(id) => {
            let own = survey.refused.iter().find(|(junctions, _)| junctions.contains(&id));
            let left_out = own.map(|(_, left_out)| left_out.clone()).unwrap_or_default();
            (format!("`{}` is not a junction where {needed}", shorten(id)), left_out)
        }
        None => {
            let all =
                survey.refused.iter().fold(LeftOut::default(), |all, (_, more)| all.and(more));
            (format!("the map has no junction where {needed}"), all)
        }
    };
    let mut why: Vec<String> = std::iter::once(what).chain(left_out.lines()).collect();
    let possible: Vec<String> = sites
        .iter()
        .take(LISTED)
        .map(|site| format!("`{}`", shorten(&site.candidate.junction)))
        .collect();
    if !possible.is_empty() {
        why.push(format!("possible: {}", possible.join(", ")));
    }
    let hint = if sites.is_empty() { LARGER } else { OTHER };
    Error::NoSite { path: map.into(), why: why.join("; "), hint }
}
