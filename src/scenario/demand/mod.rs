//! Demand: background traffic from ordinary SUMO route files, which contain vehicle types, routes,
//! vehicles, trips, persons who walk, and flows of vehicles and persons.
//!
//! [`Demand::load`] reads what the files say, [`Demand::plan`] works out which of it can be driven
//! in a net within an episode. SUMO itself reads the types. The environment draws the departures
//! from the seed of each episode, because episodes restart while SUMO's clock goes on.

mod ends;
mod left_out;
mod plan;
mod read;
mod stops;
mod table;
#[cfg(test)]
mod tests;
mod times;
mod types;

use std::collections::{BTreeMap, HashMap, HashSet};
use std::path::Path;

pub use left_out::LeftOut;
pub use plan::{DemandPlan, PlannedDeparture, PlannedSource};
pub(super) use table::is_taken;
pub use table::route_files;
pub(super) use times::seconds;

use super::reader::{Reader, document, text_up_to};
use super::{Error, Place};
use crate::sumo::net;

/// Returns the text of a route file.
pub(super) fn text(path: &Path) -> Result<String, Error> {
    text_up_to(path, MAX_BYTES)
}

/// Largest route file that is read, uncompressed \[bytes\].
const MAX_BYTES: u64 = 256 << 20;

/// SUMO's default types of vehicles and of persons, for elements that name no type.
const DEFAULT_TYPES: [&str; 2] = ["DEFAULT_VEHTYPE", "DEFAULT_PEDTYPE"];

/// A vehicle class, with SUMO's defaults for types that do not specify these values (SUMO 1.15).
#[derive(Clone, Copy)]
struct Class {
    name: &'static str,
    /// Length \[m\].
    length: f64,
    /// Width \[m\].
    width: f64,
    /// Largest speed \[m/s\].
    max_speed: f64,
}

const fn class(name: &'static str, length: f64, width: f64, kmh: f64) -> Class {
    Class { name, length, width, max_speed: kmh / 3.6 }
}

/// The vehicle classes of SUMO that types may have.
const CLASSES: [Class; 21] = [
    class("passenger", 5.0, 1.8, 200.0),
    class("private", 5.0, 1.8, 200.0),
    class("taxi", 5.0, 1.8, 200.0),
    class("evehicle", 5.0, 1.8, 200.0),
    class("hov", 5.0, 1.8, 200.0),
    class("vip", 5.0, 1.8, 200.0),
    class("authority", 5.0, 1.8, 200.0),
    class("army", 5.0, 1.8, 200.0),
    class("emergency", 6.5, 2.16, 200.0),
    class("delivery", 6.5, 2.16, 200.0),
    class("truck", 7.1, 2.4, 130.0),
    class("trailer", 16.5, 2.55, 130.0),
    class("bus", 12.0, 2.5, 100.0),
    class("coach", 14.0, 2.6, 100.0),
    class("motorcycle", 2.2, 0.9, 200.0),
    class("moped", 2.1, 0.78, 60.0),
    class("bicycle", 1.6, 0.65, 50.0),
    class("custom1", 5.0, 1.8, 200.0),
    class("custom2", 5.0, 1.8, 200.0),
    class("ignoring", 5.0, 1.8, 200.0),
    class(WALKERS, 0.215, 0.478, 37.58),
];
/// SUMO's vehicle class of pedestrians.
const WALKERS: &str = "pedestrian";

fn class_named(name: &str) -> Option<&'static Class> {
    CLASSES.iter().find(|class| class.name == name)
}

/// Contents of the route files.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Demand {
    /// The `<vType>` elements as they stand in the files, which SUMO reads.
    pub definitions: String,
    /// Types of vehicles and of persons.
    pub types: Vec<VehicleKind>,
    /// Routes of vehicles and flows, and walks of persons.
    pub routes: Vec<DemandRoute>,
    /// Vehicles, persons, and flows of both, in the order of the files.
    pub sources: Vec<Source>,
    /// Distributions of types by id: indices into `types`, and weights.
    mixes: HashMap<String, Vec<(usize, f64)>>,
    /// Routes and distributions of routes by id: indices into `routes`, and weights.
    named_routes: HashMap<String, Vec<(usize, f64)>>,
    /// Places where vehicles stop, by element and id, as stops without a duration.
    stopping_places: HashMap<(String, String), Halt>,
    /// Ids of sources, of those who walk and of vehicles.
    ids: HashSet<(bool, String)>,
    /// Attributes and elements without effect, as element and attribute, with the number of
    /// occurrences and the place of the first.
    pub(super) unused: BTreeMap<(String, String), (usize, Place)>,
    /// Vehicles, trips and flows that depart earlier than one before them in their file, which SUMO
    /// ignores: their number, and id and place of the first.
    pub(super) unsorted: Option<(usize, String, Place)>,
    /// Departure of the last vehicle of the present file that SUMO does not ignore \[s\].
    last_departure: f64,
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
    /// Whether this is a type of persons.
    pub walks: bool,
    /// SUMO's vehicle class.
    pub class: &'static str,
    /// Largest speed \[m/s\].
    pub max_speed: f64,
    /// Number of vehicles of this type that depart instead of one; fractions are drawn.
    pub scale: f64,
}

/// A route or walk of the route files.
#[derive(Debug, Clone, PartialEq)]
pub struct DemandRoute {
    /// Id of the route, or of the vehicle, person or flow that has it.
    pub id: String,
    /// How the file specifies it.
    pub itinerary: Itinerary,
    /// Stops of all vehicles on the route, or why they cannot be made.
    pub stops: Result<Vec<Halt>, String>,
    /// File, line and column.
    pub place: Place,
}

/// How a route file specifies a route or walk. Edges are given by their ids.
#[derive(Debug, Clone, PartialEq)]
pub enum Itinerary {
    /// All edges in driving order.
    Route(Vec<String>),
    /// The ends of a route, and edges to pass. The fastest path through them is the route.
    Trip {
        /// Where the route begins.
        from: Terminal,
        /// Edges to pass, in driving order.
        via: Vec<String>,
        /// Where the route ends.
        to: Terminal,
    },
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

/// An end of a trip.
#[derive(Debug, Clone, PartialEq)]
pub enum Terminal {
    /// An edge.
    Edge(String),
    /// Any edge that leaves a junction, or leads to it.
    Junction(String),
}

/// A stop as a route file specifies it.
#[derive(Debug, Clone, PartialEq)]
pub struct Halt {
    /// Edge.
    pub edge: String,
    /// Lane, counted from the right and starting at 0; `None`: the lane of the route.
    pub lane: Option<u32>,
    /// `startPos` \[m\].
    pub start: Option<f64>,
    /// `endPos` \[m\].
    pub end: Option<f64>,
    /// Whether positions beyond the ends of the lane are moved onto it.
    pub friendly: bool,
    /// Least duration \[s\].
    pub duration: f64,
    /// Time before which the vehicle does not go on, in the file's time \[s\].
    pub until: Option<f64>,
    /// Whether the vehicle stands beside the road.
    pub parking: bool,
}

/// A route or walk in a net.
#[derive(Debug, Clone, PartialEq)]
pub struct Laid {
    /// Id of the route, or of the vehicle, person or flow that has it.
    pub id: String,
    /// Centre line.
    pub path: net::Path,
    /// All edges.
    pub edges: Vec<String>,
}

impl Laid {
    /// Whether a path along these edges is this one. The paths of walks have no lanes, so that
    /// walks are compared by edges and points.
    pub fn is_same(&self, path: &net::Path, edges: &[String]) -> bool {
        let walked = path.lanes.is_empty();
        self.path.lanes == path.lanes
            && (!walked || self.edges == edges && self.path.points == path.points)
    }
}

/// A vehicle, a person, or a flow of either.
#[derive(Debug, Clone, PartialEq)]
pub struct Source {
    /// Id in the file.
    pub id: String,
    /// Name of the element: `vehicle`, `trip`, `flow`, `person` or `personFlow`.
    pub element: &'static str,
    /// File, line and column.
    pub place: Place,
    /// Types of the vehicles or persons: indices into [`Demand::types`], and weights.
    pub types: Vec<(usize, f64)>,
    /// Routes: indices into [`Demand::routes`], and weights.
    pub routes: Vec<(usize, f64)>,
    /// Where and how fast a vehicle departs; unused for persons.
    pub start: Start,
    /// Where and how fast a vehicle arrives; unused for persons.
    pub finish: Finish,
    /// Edge of the route on which a vehicle departs.
    pub depart_edge: RouteEdge,
    /// Edge of the route on which a vehicle arrives.
    pub arrival_edge: RouteEdge,
    /// SUMO's `line`; empty: none.
    pub line: String,
    /// Number of persons in a vehicle.
    pub persons: u32,
    /// Factor of a vehicle on speed limits; `None`: as its type says.
    pub speed_factor: Option<f64>,
    /// Stops of a vehicle, beside those of its route.
    pub stops: Vec<Halt>,
    /// First departure, in the file's time \[s\].
    pub begin: f64,
    /// End of departures, in the file's time \[s\].
    pub end: f64,
    /// Largest number of vehicles or persons.
    pub number: u64,
    /// Times between departures.
    pub spacing: Spacing,
    /// Why the file's vehicle or person is left out, if it has something that is not taken.
    pub not_taken: Option<String>,
}

/// An edge of a route on which a vehicle departs or arrives.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RouteEdge {
    /// The first edge for departures, the last for arrivals.
    End,
    /// The edge with this index.
    Index(usize),
    /// Any edge, each as likely as the others.
    Random,
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

/// Where and how fast a vehicle arrives, in SUMO's notation.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Finish {
    /// `arrivalLane`.
    pub lane: String,
    /// `arrivalPos`.
    pub pos: String,
    /// `arrivalSpeed`.
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

impl Source {
    /// Returns how messages call this vehicle, person or flow.
    pub fn name(&self) -> String {
        let file = self.place.path.file_name().unwrap_or_default().to_string_lossy();
        format!("{} ({file}:{})", net::shorten(&self.id), self.place.line)
    }
}

impl Demand {
    /// Reads route files and additional files of SUMO, in this order: types and routes must stand
    /// above what names them.
    ///
    /// # Errors
    /// [`Error`], with file, line and column, if a file cannot be read or contains something that
    /// is not supported.
    pub fn load(files: &[impl AsRef<Path>]) -> Result<Self, Error> {
        let default = |id: &str, class: &Class| {
            let &Class { name, length, width, max_speed } = class;
            let (id, walks) = (id.into(), name == WALKERS);
            VehicleKind { id, length, width, walks, class: name, max_speed, scale: 1.0 }
        };
        let types = vec![
            default(DEFAULT_TYPES[0], &CLASSES[0]),
            default(DEFAULT_TYPES[1], &CLASSES[CLASSES.len() - 1]),
        ];
        let mut demand = Self { types, ..Self::default() };
        for path in files.iter().map(AsRef::as_ref) {
            let text = text(path)?;
            let document = document(&text, path)?;
            demand.read(&Reader::new(path, &document), &text)?;
        }
        Ok(demand)
    }

    /// Returns the type with this id, or the types of the distribution with this id: indices into
    /// [`Demand::types`], and weights.
    pub fn mix(&self, id: &str) -> Option<Vec<(usize, f64)>> {
        // A distribution may have the id of a default type, in whose place it then is.
        let one = || Some(vec![(self.types.iter().position(|kind| kind.id == id)?, 1.0)]);
        self.mixes.get(id).cloned().or_else(one)
    }
}
