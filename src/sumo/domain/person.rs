//! Persons. SUMO 1.15 refuses most of the calls that change attributes that persons have in common
//! with vehicles; it accepts those for length, width, height, minimum gap, speed factor and colour.

use super::{Color, simulation::Stage};
use crate::sumo::{Client, Error, constants as c};

domain! {
    /// Calls for persons.
    Person, "person", PERSON
}
identifiers! { Person, "person" }
type_attributes! { Person, "person" }

record! {
    /// A person's request for a taxi.
    Reservation {
        /// Reservation identifier.
        id: String,
        /// Persons who travel together.
        persons: Vec<String>,
        /// Identifier of the group.
        group: String,
        /// Edge where the persons wait.
        from_edge: String,
        /// Destination edge.
        to_edge: String,
        /// Distance from the start of the first edge \[m\].
        depart_pos: f64,
        /// Distance from the start of the last edge \[m\].
        arrival_pos: f64,
        /// Time at which the persons are ready \[s\].
        depart: f64,
        /// Time of the request \[s\].
        reservation_time: f64,
        /// State. 1: new, 2: known, 4: assigned, 8: picked up.
        state: i32,
    }
}
nested_list! { Reservation }

getters! { Person, "person";
    /// Speed \[m/s\].
    get_speed "getSpeed" VAR_SPEED 0x40 -> f64;
    /// Position \[m\].
    get_position "getPosition" VAR_POSITION 0x42 -> [f64; 2];
    /// Position with height \[m\].
    get_position3d "getPosition3D" VAR_POSITION3D 0x39 -> [f64; 3];
    /// Navigational angle \[deg\].
    get_angle "getAngle" VAR_ANGLE 0x43 -> f64;
    /// Slope of the road \[deg\].
    get_slope "getSlope" VAR_SLOPE 0x36 -> f64;
    /// Edge where the person is.
    get_road_id "getRoadID" VAR_ROAD_ID 0x50 -> String;
    /// Lane where the person is; empty for none.
    get_lane_id "getLaneID" VAR_LANE_ID 0x51 -> String;
    /// Person type.
    get_type_id "getTypeID" VAR_TYPE 0x4f -> String;
    /// Distance from the start of the edge \[m\].
    get_lane_position "getLanePosition" VAR_LANEPOSITION 0x56 -> f64;
    /// Time since the person last moved \[s\].
    get_waiting_time "getWaitingTime" VAR_WAITING_TIME 0x7a -> f64;
    /// The next edge of the current walk; empty on the last edge.
    get_next_edge "getNextEdge" VAR_NEXT_EDGE 0xc1 -> String;
    /// Edges of a stage; stage 0 is the current one.
    get_edges "getEdges" 0x54 (stage: i32) -> Vec<String>;
    /// A stage; 0 is the current one, negative numbers are past stages.
    get_stage "getStage" 0xc0 (stage: i32) -> Stage;
    /// Number of remaining stages, including the current one.
    get_remaining_stages "getRemainingStages" VAR_STAGES_REMAINING 0xc2 -> i32;
    /// The vehicle in which the person rides; empty for none.
    get_vehicle "getVehicle" VAR_VEHICLE 0xc3 -> String;
    /// Moves some persons of a reservation to a new reservation and returns its identifier. The
    /// identifier of the old reservation is that of the call's object. SUMO 1.15 terminates if the
    /// persons are all persons of the reservation.
    split_taxi_reservation "splitTaxiReservation" 0xc7 (persons: &[impl AsRef<str>]) -> String;
}

setters! { Person, "person";
    /// Adds a person without a plan: person type, edge, departure \[s\] (-3: now), distance from
    /// the start of the edge \[m\]. The person waits for stages.
    add "add" 0x80 [kind: &str, edge: &str, depart: f64, pos: f64];
    /// Removes a stage; removing stage 0, the current one, ends it.
    remove_stage "removeStage" 0xc5 (stage: i32);
    /// Removes the person; `reason` is as for vehicles.
    remove "remove" 0x81 (reason: i8);
    /// Moves the person to a distance from the start of a lane of its walk \[m\] and to a lateral
    /// offset from the lane's centre line \[m\] ([`c::INVALID_DOUBLE_VALUE`]: unchanged).
    move_to "moveTo" 0x5c [lane: &str, pos: f64, pos_lat: f64];
    /// Sets the walking speed \[m/s\].
    set_speed "setSpeed" 0x40 (speed: f64);
    /// Sets the person type.
    set_type "setType" 0x4f (kind: &str);
    /// Computes the fastest walk again.
    reroute_traveltime "rerouteTraveltime" 0x90 [];
    /// Appends a wait of a duration \[s\] to the plan; `stop` is the place, or empty.
    append_waiting_stage "appendWaitingStage" 0xc4
        {duration: f64, description: &str, stop: &str} => (1, duration, description, stop);
    /// Appends a walk to the plan.
    append_walking_stage "appendWalkingStage" 0xc4
        {edges: &[impl AsRef<str>], walk: &Walk<'_>}
        => (2, edges, walk.arrival_pos, walk.duration, walk.speed, walk.stop);
    /// Appends a ride to an edge to the plan, with a vehicle of any of the `lines`, which are
    /// separated by spaces; `stop` is the destination stop, or empty.
    append_driving_stage "appendDrivingStage" 0xc4
        {to: &str, lines: &str, stop: &str} => (3, to, lines, stop);
    /// Appends a stage to the plan.
    append_stage "appendStage" 0xc4 (stage: &Stage);
    /// Replaces a stage; 0 is the current one.
    replace_stage "replaceStage" 0xcd [index: i32, stage: &Stage];
    /// Moves the person to a position \[m\], see [`Place`].
    move_to_xy "moveToXY" 0xb4 {position: [f64; 2], place: &Place<'_>} => {
        let ([x, y], Place { edge, angle, keep_route, match_threshold }) = (position, *place);
        (edge, x, y, angle, keep_route.cast_signed(), match_threshold)
    };
}

global_getters! { Person, "person";
    /// The reservations of taxis: all of them, or, with `only_new`, the new ones.
    get_taxi_reservations "getTaxiReservations" 0xc6
        {only_new: bool} -> Vec<Reservation> => i32::from(only_new);
}

impl Person<'_, Client> {
    /// Removes all stages. The person leaves the simulation if no stage is added before the next
    /// step. Takes two exchanges.
    ///
    /// # Errors
    /// As for all calls.
    pub fn remove_stages(&mut self, id: &str) -> Result<(), Error> {
        let count = self.get_remaining_stages(id)?;
        let mut batch = self.0.batch();
        for _ in 1..count {
            batch.person().remove_stage(id, 1);
        }
        batch.person().remove_stage(id, 0);
        batch.send()?.check()
    }
}

/// Options of [`Person::append_walking_stage`] besides the edges.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Walk<'a> {
    /// Distance from the start of the last edge \[m\].
    pub arrival_pos: f64,
    /// Duration \[s\]; negative: the duration follows from the speed.
    pub duration: f64,
    /// Speed \[m/s\]; negative: the speed of the person type.
    pub speed: f64,
    /// Stop where the walk ends; empty: none.
    pub stop: &'a str,
}

impl Walk<'_> {
    /// Returns a walk to a distance from the start of the last edge \[m\].
    pub const fn to(arrival_pos: f64) -> Self {
        Walk { arrival_pos, duration: -1.0, speed: -1.0, stop: "" }
    }
}

/// Options for how [`Person::move_to_xy`] matches a position to the net.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place<'a> {
    /// The preferred edge; empty: none.
    pub edge: &'a str,
    /// Navigational angle \[deg\]; [`c::INVALID_DOUBLE_VALUE`]: the angle of the edge.
    pub angle: f64,
    /// Bits. 1: the closest position on the walk; without this bit, the closest position in the
    /// net. 2: exactly the given position, on an edge or not. 4: also lanes that the person may not
    /// use.
    pub keep_route: u8,
    /// Greatest distance between the given and the matched position \[m\].
    pub match_threshold: f64,
}

impl Default for Place<'_> {
    fn default() -> Self {
        Place { edge: "", angle: c::INVALID_DOUBLE_VALUE, keep_route: 1, match_threshold: 100.0 }
    }
}
