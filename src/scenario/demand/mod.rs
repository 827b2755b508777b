//! Demand: background traffic from ordinary SUMO route files, which contain vehicle types, routes,
//! vehicles, trips, persons who walk, and flows of vehicles and persons.
//!
//! SUMO itself reads the types. The environment draws the departures from the seed of each episode,
//! because episodes restart while SUMO's clock goes on; times in the files count from the start of
//! an episode.

mod read;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, HashMap};
use std::path::Path;

use super::reader::{Reader, document, text};
use super::{Error, Place};
use crate::sumo::net::{self, Net, NetError};

/// SUMO's default types of vehicles and of persons, for elements that name no type.
const DEFAULT_TYPES: [&str; 2] = ["DEFAULT_VEHTYPE", "DEFAULT_PEDTYPE"];
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
    /// Attributes without effect, as element and attribute, with the number of occurrences and the
    /// place of the first.
    pub(super) unused: BTreeMap<(String, String), (usize, Place)>,
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
    /// Vehicle class of SUMO.
    pub class: String,
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
    pub(super) place: Place,
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
            let walks = class == WALKERS;
            VehicleKind { id: id.into(), length, width, class: class.into(), walks }
        };
        let types = vec![default(DEFAULT_TYPES[0], SIZES[0].0), default(DEFAULT_TYPES[1], WALKERS)];
        let mut demand = Self { types, ..Self::default() };
        for path in files.iter().map(AsRef::as_ref) {
            let text = text(path)?;
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
}
