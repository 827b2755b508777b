//! Numbers of the TraCI protocol, under SUMO's own names. A [`Domain`] holds the four command
//! identifiers of one kind of object, so that a new domain takes one line in this file.

/// Lowest TraCI version that this program accepts (that of SUMO 1.15).
pub const MINIMUM_API_VERSION: i32 = 20;
/// Maximum length of a message in either direction \[bytes\].
pub const MAXIMUM_MESSAGE: usize = 64 << 20;

/// Command that asks for the TraCI version.
pub const CMD_GETVERSION: u8 = 0x00;
/// Command that loads another simulation.
pub const CMD_LOAD: u8 = 0x01;
/// Command that sets the rank of a client among several.
pub const CMD_SETORDER: u8 = 0x03;
/// Command that restricts the most recent context subscription.
pub const CMD_ADD_SUBSCRIPTION_FILTER: u8 = 0x7e;
/// Command that advances the simulation.
pub const CMD_SIMSTEP: u8 = 0x02;
/// Command that ends the connection.
pub const CMD_CLOSE: u8 = 0x7f;

/// Status of a command that succeeded.
pub const RTYPE_OK: u8 = 0x00;

/// Number that SUMO reports where there is no value, for instance for the position of a vehicle
/// that has not departed.
pub const INVALID_DOUBLE_VALUE: f64 = -1_073_741_824.0;

/// Type: longitude, latitude.
pub const POSITION_LON_LAT: u8 = 0x00;
/// Type: x, y.
pub const POSITION_2D: u8 = 0x01;
/// Type: longitude, latitude, altitude.
pub const POSITION_LON_LAT_ALT: u8 = 0x02;
/// Type: x, y, z.
pub const POSITION_3D: u8 = 0x03;
/// Type: edge, position, lane index.
pub const POSITION_ROADMAP: u8 = 0x04;
/// Type: list of points.
pub const TYPE_POLYGON: u8 = 0x06;
/// Type: unsigned byte.
pub const TYPE_UBYTE: u8 = 0x07;
/// Type: signed byte.
pub const TYPE_BYTE: u8 = 0x08;
/// Type: 32 bit integer.
pub const TYPE_INTEGER: u8 = 0x09;
/// Type: 64 bit floating point number.
pub const TYPE_DOUBLE: u8 = 0x0b;
/// Type: string.
pub const TYPE_STRING: u8 = 0x0c;
/// Type: list of strings.
pub const TYPE_STRINGLIST: u8 = 0x0e;
/// Type: sequence of typed values.
pub const TYPE_COMPOUND: u8 = 0x0f;
/// Type: list of floating point numbers.
pub const TYPE_DOUBLELIST: u8 = 0x10;
/// Type: red, green, blue, alpha.
pub const TYPE_COLOR: u8 = 0x11;

/// Reason of a removal: the vehicle or person is taken out without arriving.
pub const REMOVE_VAPORIZED: i8 = 0x03;

/// Departure time with which a person departs at once.
pub const DEPART_NOW: f64 = -3.0;

/// A kind of simulation object, given by its command identifiers. The identifier of an answer is
/// that of its command plus 0x10.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Domain {
    /// Command that reads a variable.
    pub get: u8,
    /// Command that changes a variable.
    pub set: u8,
    /// Command that subscribes to variables of one object.
    pub subscribe: u8,
    /// Command that subscribes to variables of the objects around one object.
    pub context: u8,
}

impl Domain {
    /// Induction loops (E1 detectors).
    pub const INDUCTION_LOOP: Domain = Domain::based_on(0x80);
    /// Traffic lights.
    pub const TRAFFIC_LIGHT: Domain = Domain::based_on(0x82);
    /// Lanes.
    pub const LANE: Domain = Domain::based_on(0x83);
    /// Vehicles.
    pub const VEHICLE: Domain = Domain::based_on(0x84);
    /// Vehicle types.
    pub const VEHICLE_TYPE: Domain = Domain::based_on(0x85);
    /// Routes.
    pub const ROUTE: Domain = Domain::based_on(0x86);
    /// Points of interest.
    pub const POI: Domain = Domain::based_on(0x87);
    /// Polygons.
    pub const POLYGON: Domain = Domain::based_on(0x88);
    /// Junctions.
    pub const JUNCTION: Domain = Domain::based_on(0x89);
    /// Edges.
    pub const EDGE: Domain = Domain::based_on(0x8a);
    /// The simulation as a whole; its object identifier is the empty string.
    pub const SIMULATION: Domain = Domain::based_on(0x8b);
    /// Views of the graphical interface.
    pub const GUI: Domain = Domain::based_on(0x8c);
    /// Lane area detectors (E2 detectors).
    pub const LANE_AREA: Domain = Domain::based_on(0x8d);
    /// Persons.
    pub const PERSON: Domain = Domain::based_on(0x8e);
    /// Parking areas.
    pub const PARKING_AREA: Domain = Domain::based_on(0x04);
    /// Bus stops.
    pub const BUS_STOP: Domain = Domain::based_on(0x8f);
    /// Calibrators.
    pub const CALIBRATOR: Domain = Domain::based_on(0x07);
    /// Charging stations.
    pub const CHARGING_STATION: Domain = Domain::based_on(0x05);
    /// Collectors of mean data.
    pub const MEAN_DATA: Domain = Domain::based_on(0x0a);
    /// Multi entry exit detectors (E3 detectors).
    pub const MULTI_ENTRY_EXIT: Domain = Domain::based_on(0x81);
    /// Overhead wires.
    pub const OVERHEAD_WIRE: Domain = Domain::based_on(0x0b);
    /// Rerouters.
    pub const REROUTER: Domain = Domain::based_on(0x08);
    /// Route probes.
    pub const ROUTE_PROBE: Domain = Domain::based_on(0x06);
    /// Variable speed signs.
    pub const VARIABLE_SPEED_SIGN: Domain = Domain::based_on(0x09);

    /// Whether SUMO 1.15 can search for objects of the domain around an object. SUMO terminates on
    /// a context subscription to any other domain.
    pub(super) fn has_places(self) -> bool {
        [
            Self::BUS_STOP,
            Self::CALIBRATOR,
            Self::CHARGING_STATION,
            Self::EDGE,
            Self::INDUCTION_LOOP,
            Self::JUNCTION,
            Self::LANE,
            Self::LANE_AREA,
            Self::PARKING_AREA,
            Self::PERSON,
            Self::POI,
            Self::POLYGON,
            Self::VEHICLE,
        ]
        .contains(&self)
    }

    /// Derives the other identifiers from that of the context subscription.
    const fn based_on(context: u8) -> Self {
        Domain { get: context + 0x20, set: context + 0x40, subscribe: context + 0x50, context }
    }
}
