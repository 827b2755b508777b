//! Numbers of the TraCI protocol, under SUMO's own names. A [`Domain`] carries the four command
//! identifiers of one kind of object, so that a new domain is one line here.

/// Lowest TraCI version that is accepted (SUMO 1.15).
pub const MINIMUM_API_VERSION: i32 = 20;
/// Longest message that is accepted or sent \[bytes\].
pub const MAXIMUM_MESSAGE: usize = 64 << 20;

/// Asks for the TraCI version.
pub const CMD_GETVERSION: u8 = 0x00;
/// Loads another simulation.
pub const CMD_LOAD: u8 = 0x01;
/// Sets the place of a client among several.
pub const CMD_SETORDER: u8 = 0x03;
/// Restricts the context subscription that was made last.
pub const CMD_ADD_SUBSCRIPTION_FILTER: u8 = 0x7e;
/// Advances the simulation.
pub const CMD_SIMSTEP: u8 = 0x02;
/// Ends the connection.
pub const CMD_CLOSE: u8 = 0x7f;

/// Status: done.
pub const RTYPE_OK: u8 = 0x00;

/// What SUMO reports where there is no value, for instance the position of a vehicle that has not departed.
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

/// Variable: identifiers of all objects of a domain.
pub const ID_LIST: u8 = 0x00;
/// Vehicle, vehicle type: speed; in the set domain of vehicles the speed to keep.
pub const VAR_SPEED: u8 = 0x40;
/// Highest speed.
pub const VAR_MAXSPEED: u8 = 0x41;
/// Position; of vehicles the centre of the front bumper.
pub const VAR_POSITION: u8 = 0x42;
/// Navigational angle in degrees.
pub const VAR_ANGLE: u8 = 0x43;
/// Length.
pub const VAR_LENGTH: u8 = 0x44;
/// Acceleration ability.
pub const VAR_ACCEL: u8 = 0x46;
/// Comfortable deceleration.
pub const VAR_DECEL: u8 = 0x47;
/// Desired time headway.
pub const VAR_TAU: u8 = 0x48;
/// Gap to the leader when standing.
pub const VAR_MINGAP: u8 = 0x4c;
/// Width.
pub const VAR_WIDTH: u8 = 0x4d;
/// Driver imperfection (sigma).
pub const VAR_IMPERFECTION: u8 = 0x5d;
/// Factor on the speed limit.
pub const VAR_SPEED_FACTOR: u8 = 0x5e;
/// Deviation of the speed factor.
pub const VAR_SPEED_DEVIATION: u8 = 0x5f;
/// Strongest deceleration.
pub const VAR_EMERGENCY_DECEL: u8 = 0x7b;
/// Distance that a vehicle has driven since it departed.
pub const VAR_DISTANCE: u8 = 0x84;
/// Speed mode bits of a vehicle.
pub const VAR_SPEEDSETMODE: u8 = 0xb3;
/// Simulation time in seconds.
pub const VAR_TIME: u8 = 0x66;
/// Vehicles that came to the end of their routes in the step.
pub const VAR_ARRIVED_VEHICLES_IDS: u8 = 0x7a;
/// Collisions of the step, with all their attributes.
pub const VAR_COLLISIONS: u8 = 0x23;
/// Vehicle: those beside it.
pub const VAR_NEIGHBORS: u8 = 0xbf;
/// Set variable: adds an object.
pub const ADD: u8 = 0x80;
/// Set variable: removes an object.
pub const REMOVE: u8 = 0x81;
/// Set variable: adds a vehicle with all attributes.
pub const ADD_FULL: u8 = 0x85;
/// Set variable: places a vehicle.
pub const MOVE_TO_XY: u8 = 0xb4;
/// Set variable: copies an object.
pub const COPY: u8 = 0x88;
/// Reason of a removal: taken out without arriving.
pub const REMOVE_VAPORIZED: i8 = 0x03;

/// A kind of simulation object, by its command identifiers. An answer's identifier is 0x10 higher.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Domain {
    /// Reads a variable.
    pub get: u8,
    /// Changes a variable.
    pub set: u8,
    /// Subscribes to variables of one object.
    pub subscribe: u8,
    /// Subscribes to variables of the objects around one object.
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

    /// The other identifiers follow from that of the context subscription.
    const fn based_on(context: u8) -> Self {
        Domain { get: context + 0x20, set: context + 0x40, subscribe: context + 0x50, context }
    }
}
