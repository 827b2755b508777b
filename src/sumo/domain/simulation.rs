//! The simulation as a whole.

use crate::sumo::{
    Error,
    batch::Call,
    codec::Writer,
    constants as c,
    value::{Argument, Fields, FromFields, OnPlane, OnRoad, RoadPosition, Untyped},
};

domain! {
    /// Calls for the simulation as a whole. The object that the calls of all domains take is the
    /// empty string here. Exception: for keys of stops, such as `parkingArea.capacity` and keys
    /// that begin with `chargingStation.`, `get_parameter` takes the identifier of the stop.
    Simulation, "simulation", SIMULATION
}

/// A part of a journey: a vehicle's route, or a walk, a ride or a wait of a person.
#[derive(Debug, Clone, PartialEq)]
pub struct Stage {
    /// Kind of stage. 1: waits, 2: walks, 3: drives or rides, 4: access, 5: trip, 6: tranship.
    pub kind: i32,
    /// Vehicle type.
    pub vehicle_type: String,
    /// Line of the vehicle in which the person rides.
    pub line: String,
    /// Identifier of the stop where the stage ends, or empty.
    pub destination_stop: String,
    /// Edges in driving or walking order.
    pub edges: Vec<String>,
    /// Expected duration \[s\].
    pub travel_time: f64,
    /// Cost that routing minimises.
    pub cost: f64,
    /// Length \[m\].
    pub length: f64,
    /// The vehicle in which the person is meant to ride.
    pub intended: String,
    /// Planned start \[s\].
    pub depart: f64,
    /// Distance from the start of the first edge \[m\].
    pub depart_pos: f64,
    /// Distance from the start of the last edge \[m\].
    pub arrival_pos: f64,
    /// Purpose of the stage.
    pub description: String,
}

impl Stage {
    /// Returns a wait of `duration` \[s\].
    pub fn waiting(duration: f64, description: impl Into<String>) -> Self {
        Stage {
            kind: 1,
            travel_time: duration,
            description: description.into(),
            ..Stage::default()
        }
    }

    /// Returns a walk along `edges` to a position on the last edge \[m\].
    pub fn walking(edges: Vec<String>, arrival_pos: f64) -> Self {
        Stage { kind: 2, edges, travel_time: -1.0, arrival_pos, ..Stage::default() }
    }

    /// Returns a ride to an edge with any vehicle of a line, or with the vehicle of that
    /// identifier.
    pub fn driving(to: impl Into<String>, line: impl Into<String>) -> Self {
        Stage { kind: 3, edges: vec![to.into()], line: line.into(), ..Stage::default() }
    }
}

impl Argument for &Stage {
    fn write(self, w: &mut Writer) {
        w.compound(13).integer(self.kind).string(&self.vehicle_type).string(&self.line);
        w.string(&self.destination_stop).string_list(&self.edges);
        w.double(self.travel_time).double(self.cost).double(self.length).string(&self.intended);
        w.double(self.depart).double(self.depart_pos).double(self.arrival_pos);
        w.string(&self.description);
    }
}

impl Default for Stage {
    /// Returns a stage of no kind; unknown values are [`c::INVALID_DOUBLE_VALUE`] or empty.
    fn default() -> Self {
        let unknown = c::INVALID_DOUBLE_VALUE;
        Stage {
            kind: -1_073_741_824,
            vehicle_type: String::new(),
            line: String::new(),
            destination_stop: String::new(),
            edges: Vec::new(),
            travel_time: unknown,
            cost: unknown,
            length: unknown,
            intended: String::new(),
            depart: unknown,
            depart_pos: unknown,
            arrival_pos: unknown,
            description: String::new(),
        }
    }
}

impl FromFields for Stage {
    fn from_fields(fields: &mut Fields) -> Result<Self, Error> {
        Ok(Stage {
            kind: fields.take()?,
            vehicle_type: fields.take()?,
            line: fields.take()?,
            destination_stop: fields.take()?,
            edges: fields.take()?,
            travel_time: fields.take()?,
            cost: fields.take()?,
            length: fields.take()?,
            intended: fields.take()?,
            depart: fields.take()?,
            depart_pos: fields.take()?,
            arrival_pos: fields.take()?,
            description: fields.take()?,
        })
    }
}
nested_list! { Stage }

record! {
    /// A collision of two vehicles, or of a vehicle and a person.
    Collision {
        /// The vehicle that runs into the victim.
        collider: String,
        /// The vehicle or person that the collider runs into.
        victim: String,
        /// Type of the collider.
        collider_type: String,
        /// Type of the victim.
        victim_type: String,
        /// Speed of the collider \[m/s\].
        collider_speed: f64,
        /// Speed of the victim \[m/s\].
        victim_speed: f64,
        /// Kind of collision, such as `collision` or `junction`.
        kind: String,
        /// Lane of the collision.
        lane: String,
        /// Distance of the collision from the start of the lane \[m\].
        pos: f64,
    }
}
flat_list! { Collision }

global_getters! { Simulation, "simulation";
    /// Simulation time \[s\].
    get_time "getTime" VAR_TIME 0x66 -> f64;
    /// Simulation time \[ms\].
    get_current_time "getCurrentTime" VAR_TIME_STEP 0x70 -> i32;
    /// End of the simulation \[s\]; -1: not known.
    get_end_time "getEndTime" VAR_END 0x1d -> f64;
    /// Number of vehicles loaded within the last step.
    get_loaded_number "getLoadedNumber" VAR_LOADED_VEHICLES_NUMBER 0x71 -> i32;
    /// Vehicles loaded within the last step.
    get_loaded_id_list "getLoadedIDList" VAR_LOADED_VEHICLES_IDS 0x72 -> Vec<String>;
    /// Number of vehicles that departed within the last step.
    get_departed_number "getDepartedNumber" VAR_DEPARTED_VEHICLES_NUMBER 0x73 -> i32;
    /// Vehicles that departed within the last step.
    get_departed_id_list "getDepartedIDList" VAR_DEPARTED_VEHICLES_IDS 0x74 -> Vec<String>;
    /// Number of vehicles that arrived within the last step.
    get_arrived_number "getArrivedNumber" VAR_ARRIVED_VEHICLES_NUMBER 0x79 -> i32;
    /// Vehicles that arrived within the last step.
    get_arrived_id_list "getArrivedIDList" VAR_ARRIVED_VEHICLES_IDS 0x7a -> Vec<String>;
    /// Number of persons that departed within the last step.
    get_departed_person_number "getDepartedPersonNumber" VAR_DEPARTED_PERSONS_NUMBER 0x24 -> i32;
    /// Persons that departed within the last step.
    get_departed_person_id_list "getDepartedPersonIDList" VAR_DEPARTED_PERSONS_IDS 0x25 -> Vec<String>;
    /// Number of persons that arrived within the last step.
    get_arrived_person_number "getArrivedPersonNumber" VAR_ARRIVED_PERSONS_NUMBER 0x26 -> i32;
    /// Persons that arrived within the last step.
    get_arrived_person_id_list "getArrivedPersonIDList" VAR_ARRIVED_PERSONS_IDS 0x27 -> Vec<String>;
    /// Number of vehicles that began to park within the last step.
    get_parking_starting_vehicles_number "getParkingStartingVehiclesNumber" VAR_PARKING_STARTING_VEHICLES_NUMBER 0x6c
        -> i32;
    /// Vehicles that began to park within the last step.
    get_parking_starting_vehicles_id_list "getParkingStartingVehiclesIDList" VAR_PARKING_STARTING_VEHICLES_IDS 0x6d
        -> Vec<String>;
    /// Number of vehicles that stopped parking within the last step.
    get_parking_ending_vehicles_number "getParkingEndingVehiclesNumber" VAR_PARKING_ENDING_VEHICLES_NUMBER 0x6e -> i32;
    /// Vehicles that stopped parking within the last step.
    get_parking_ending_vehicles_id_list "getParkingEndingVehiclesIDList" VAR_PARKING_ENDING_VEHICLES_IDS 0x6f
        -> Vec<String>;
    /// Number of vehicles that reached a stop within the last step.
    get_stop_starting_vehicles_number "getStopStartingVehiclesNumber" VAR_STOP_STARTING_VEHICLES_NUMBER 0x68 -> i32;
    /// Vehicles that reached a stop within the last step.
    get_stop_starting_vehicles_id_list "getStopStartingVehiclesIDList" VAR_STOP_STARTING_VEHICLES_IDS 0x69
        -> Vec<String>;
    /// Number of vehicles that left a stop within the last step.
    get_stop_ending_vehicles_number "getStopEndingVehiclesNumber" VAR_STOP_ENDING_VEHICLES_NUMBER 0x6a -> i32;
    /// Vehicles that left a stop within the last step.
    get_stop_ending_vehicles_id_list "getStopEndingVehiclesIDList" VAR_STOP_ENDING_VEHICLES_IDS 0x6b -> Vec<String>;
    /// Number of vehicles that began to collide within the last step.
    get_colliding_vehicles_number "getCollidingVehiclesNumber" VAR_COLLIDING_VEHICLES_NUMBER 0x80 -> i32;
    /// Vehicles that began to collide within the last step.
    get_colliding_vehicles_id_list "getCollidingVehiclesIDList" VAR_COLLIDING_VEHICLES_IDS 0x81 -> Vec<String>;
    /// Number of vehicles that braked harder within the last step than their deceleration allows.
    get_emergency_stopping_vehicles_number "getEmergencyStoppingVehiclesNumber"
        VAR_EMERGENCYSTOPPING_VEHICLES_NUMBER 0x89 -> i32;
    /// Vehicles that braked harder within the last step than their deceleration allows.
    get_emergency_stopping_vehicles_id_list "getEmergencyStoppingVehiclesIDList"
        VAR_EMERGENCYSTOPPING_VEHICLES_IDS 0x8a -> Vec<String>;
    /// Number of vehicles and persons in the net or yet to depart.
    get_min_expected_number "getMinExpectedNumber" VAR_MIN_EXPECTED_VEHICLES 0x7d -> i32;
    /// Identifiers of the bus stops.
    get_bus_stop_id_list "getBusStopIDList" VAR_BUS_STOP_ID_LIST 0x9f -> Vec<String>;
    /// Number of vehicles that SUMO began to teleport within the last step.
    get_starting_teleport_number "getStartingTeleportNumber" VAR_TELEPORT_STARTING_VEHICLES_NUMBER 0x75 -> i32;
    /// Vehicles that SUMO began to teleport within the last step.
    get_starting_teleport_id_list "getStartingTeleportIDList" VAR_TELEPORT_STARTING_VEHICLES_IDS 0x76 -> Vec<String>;
    /// Number of vehicles that SUMO put back on the road within the last step.
    get_ending_teleport_number "getEndingTeleportNumber" VAR_TELEPORT_ENDING_VEHICLES_NUMBER 0x77 -> i32;
    /// Vehicles that SUMO put back on the road within the last step.
    get_ending_teleport_id_list "getEndingTeleportIDList" VAR_TELEPORT_ENDING_VEHICLES_IDS 0x78 -> Vec<String>;
    /// Collisions within the last step; SUMO reports a collision again in each step while it lasts.
    get_collisions "getCollisions" VAR_COLLISIONS 0x23 -> Vec<Collision>;
    /// Vehicles that wait to depart.
    get_pending_vehicles "getPendingVehicles" VAR_PENDING_VEHICLES 0x94 -> Vec<String>;
    /// Factor on the number of vehicles.
    get_scale "getScale" VAR_SCALE 0x8e -> f64;
    /// Step length \[s\].
    get_delta_t "getDeltaT" VAR_DELTA_T 0x7b -> f64;
    /// Lower left and upper right corner of the net \[m\].
    get_net_boundary "getNetBoundary" VAR_NET_BOUNDING_BOX 0x7c -> Vec<[f64; 2]>;
}

getters! { Simulation, "simulation";
    /// Number of persons that wait at a bus stop.
    get_bus_stop_waiting "getBusStopWaiting" VAR_BUS_STOP_WAITING 0x67 -> i32;
    /// Persons that wait at a bus stop.
    get_bus_stop_waiting_id_list "getBusStopWaitingIDList" VAR_BUS_STOP_WAITING_IDS 0xef -> Vec<String>;
    /// An option of SUMO's command line, by its long name without dashes.
    get_option "getOption" VAR_OPTION 0x32 -> String;
}

/// Options of [`Simulation::find_route`] besides the first and the last edge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RouteQuery<'a> {
    /// Vehicle type; empty: the default one.
    pub vehicle_type: &'a str,
    /// Departure \[s\]; negative: the current time.
    pub depart: f64,
    /// Routing mode. 0: default, 1: aggregated travel times.
    pub routing_mode: i32,
}

impl Default for RouteQuery<'_> {
    fn default() -> Self {
        RouteQuery { vehicle_type: "", depart: -1.0, routing_mode: 0 }
    }
}

/// Options of [`Simulation::find_intermodal_route`] besides the first and the last edge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IntermodalQuery<'a> {
    /// Modes of travel besides walking, separated by spaces: `car`, `bicycle`, `public`, `taxi`.
    pub modes: &'a str,
    /// Departure \[s\]; negative: the current time.
    pub depart: f64,
    /// Routing mode. 0: default, 1: aggregated travel times.
    pub routing_mode: i32,
    /// Walking speed \[m/s\]; negative: the speed of the person type.
    pub speed: f64,
    /// Factor on the walking speed for routing; negative: the default.
    pub walk_factor: f64,
    /// Distance from the start of the first edge \[m\].
    pub depart_pos: f64,
    /// Distance from the start of the last edge \[m\]; [`c::INVALID_DOUBLE_VALUE`]: its middle.
    pub arrival_pos: f64,
    /// Lateral position on the first edge \[m\].
    pub depart_pos_lat: f64,
    /// Person type; empty: the default one.
    pub person_type: &'a str,
    /// Vehicle type; empty: the default one.
    pub vehicle_type: &'a str,
    /// Stop where the journey ends; empty: none.
    pub destination_stop: &'a str,
}

impl Default for IntermodalQuery<'_> {
    fn default() -> Self {
        IntermodalQuery {
            modes: "",
            depart: -1.0,
            routing_mode: 0,
            speed: -1.0,
            walk_factor: -1.0,
            depart_pos: 0.0,
            arrival_pos: c::INVALID_DOUBLE_VALUE,
            depart_pos_lat: 0.0,
            person_type: "",
            vehicle_type: "",
            destination_stop: "",
        }
    }
}

pub(in crate::sumo) const LOAD_STATE: Call = Call::set("simulation.loadState", DOMAIN, 0x96);

global_getters! { Simulation, "simulation";
    /// The coordinates of a position on a lane: x and y \[m\], or longitude and latitude \[deg\]
    /// if `to_geo`.
    convert2d "convert2D" 0x82 {edge: &str, pos: f64, lane: u8, to_geo: bool} -> [f64; 2]
        => (OnRoad(edge, pos, lane), plane(to_geo));
    /// Like `convert2d`, with the height \[m\].
    convert3d "convert3D" 0x82 {edge: &str, pos: f64, lane: u8, to_geo: bool} -> [f64; 3]
        => (OnRoad(edge, pos, lane), if to_geo { c::POSITION_LON_LAT_ALT } else { c::POSITION_3D });
    /// The position on a lane that is closest to x and y \[m\], or to longitude and latitude
    /// \[deg\] if `is_geo`. Only lanes that the vehicle class may use count; with the class
    /// `ignoring`, all lanes count.
    convert_road "convertRoad" 0x82 {position: [f64; 2], is_geo: bool, class: &str} -> RoadPosition
        => (OnPlane(position, is_geo), c::POSITION_ROADMAP, class);
    /// Converts x and y \[m\] to longitude and latitude \[deg\]; the reverse if `from_geo`.
    convert_geo "convertGeo" 0x82 {position: [f64; 2], from_geo: bool} -> [f64; 2]
        => (OnPlane(position, from_geo), plane(!from_geo));
    /// The distance \[m\] between two positions, straight or, if `is_driving`, along the roads. A
    /// position is x and y \[m\], or longitude and latitude \[deg\] if `is_geo`.
    get_distance2d "getDistance2D" 0x83
        {from: [f64; 2], to: [f64; 2], is_geo: bool, is_driving: bool} -> f64
        => (OnPlane(from, is_geo), OnPlane(to, is_geo), Untyped(is_driving.into()));
    /// The distance \[m\] between two positions, straight or, if `is_driving`, along the roads. A
    /// position is an edge and the distance from its start \[m\].
    get_distance_road "getDistanceRoad" 0x83
        {from: (&str, f64), to: (&str, f64), is_driving: bool} -> f64
        => (OnRoad(from.0, from.1, 0), OnRoad(to.0, to.1, 0), Untyped(is_driving.into()));
    /// The fastest route of a vehicle from one edge to another.
    find_route "findRoute" 0x86 {from: &str, to: &str, query: &RouteQuery<'_>} -> Stage => {
        let RouteQuery { vehicle_type, depart, routing_mode } = *query;
        (from, to, vehicle_type, depart, routing_mode)
    };
    /// The fastest journey of a person from one edge to another.
    find_intermodal_route "findIntermodalRoute" 0x87
        {from: &str, to: &str, query: &IntermodalQuery<'_>} -> Vec<Stage> => {
        let IntermodalQuery { modes, depart, routing_mode, speed, walk_factor, .. } = *query;
        let IntermodalQuery { depart_pos, arrival_pos, depart_pos_lat, person_type, .. } = *query;
        let IntermodalQuery { vehicle_type, destination_stop, .. } = *query;
        (
            from,
            to,
            modes,
            depart,
            routing_mode,
            speed,
            walk_factor,
            depart_pos,
            arrival_pos,
            depart_pos_lat,
            person_type,
            vehicle_type,
            destination_stop,
        )
    };
}

/// Returns the type of a position on the plane.
fn plane(geographic: bool) -> u8 {
    if geographic { c::POSITION_LON_LAT } else { c::POSITION_2D }
}

global_setters! { Simulation, "simulation";
    /// Sets the factor on the number of vehicles.
    set_scale "setScale" 0x8e (scale: f64);
    /// Removes the vehicles of a route that wait to depart; of all routes if `route` is empty.
    clear_pending "clearPending" 0x94 (route: &str);
    /// Writes the state of the simulation to a file. SUMO's options `--save-state.precision` and
    /// `--save-state.rng` set the precision and whether the file holds the state of the random
    /// number generators.
    save_state "saveState" 0x95 (file: &str);
    /// Restores the state that a file holds. All subscriptions are lost. SUMO 1.15 needs
    /// `SUMO_HOME`, or `--xml-validation never` among its arguments.
    load_state "loadState" 0x96 (file: &str);
    /// Writes a line to SUMO's message output.
    write_message "writeMessage" 0x65 (message: &str);
}
