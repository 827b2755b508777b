//! Vehicles.

use super::{Argument, Color, FromValue, Scope};
use crate::sumo::{
    Error,
    batch::Call,
    codec::{Value, Writer},
    constants::Domain,
};

mod changes;
mod filters;

pub use changes::{Addition, Gap, Placement, Stop, StopChange};

domain! {
    /// Calls for vehicles.
    Vehicle, "vehicle", VEHICLE
}
identifiers! { Vehicle, "vehicle", VEHICLE }
type_attributes! { Vehicle, "vehicle", VEHICLE }
emissions! { Vehicle, "vehicle", VEHICLE }

record! {
    /// A neighbouring vehicle and the gap to it.
    Neighbor {
        /// Vehicle identifier.
        id: String,
        /// Distance from bumper to bumper, minus the minimum gap of the rear vehicle \[m\].
        gap: f64,
    }
}
flat_list! { Neighbor }

impl FromValue for Option<Neighbor> {
    fn from_value(value: Value) -> Result<Self, Error> {
        let neighbor: Neighbor = super::compound(value, super::value::FromFields::from_fields)?;
        Ok(Some(neighbor).filter(|neighbor| !neighbor.id.is_empty()))
    }
}

record! {
    /// A lane of the vehicle's edge and its suitability for the route.
    BestLane {
        /// Lane identifier.
        lane: String,
        /// Distance that the vehicle can drive without a lane change \[m\].
        length: f64,
        /// Length that other vehicles occupy on that distance \[m\].
        occupation: f64,
        /// Number of lanes from this lane to the best lane, to the left; negative: to the right.
        offset: i32,
        /// Whether the route continues from this lane.
        allows_continuation: bool,
        /// The lanes that follow on the route.
        next: Vec<String>,
    }
}
flat_list! { BestLane }

record! {
    /// A traffic light on the route ahead.
    NextTls {
        /// Traffic light identifier.
        id: String,
        /// Index of the signal.
        index: i32,
        /// Distance \[m\].
        distance: f64,
        /// State of the signal.
        state: char,
    }
}
flat_list! { NextTls }

record! {
    /// A stop ahead, in short form.
    NextStop {
        /// Lane.
        lane: String,
        /// Distance of the stop's end from the start of the lane \[m\].
        end_pos: f64,
        /// Bus stop, parking area or another kind of stopping place; empty for none.
        stopping_place: String,
        /// Bits. 1: stopped, 2: beside the road, 4: until a person boards, 8: until a container is
        /// loaded, 16: bus stop, 32: container stop, 64: charging station, 128: parking area.
        flags: i32,
        /// Duration \[s\].
        duration: f64,
        /// Earliest departure \[s\].
        until: f64,
    }
}
flat_list! { NextStop }

record! {
    /// A past stop or a stop ahead.
    StopData {
        /// Lane.
        lane: String,
        /// Distance of the stop's end from the start of the lane \[m\].
        end_pos: f64,
        /// Bus stop, parking area or another kind of stopping place; empty for none.
        stopping_place: String,
        /// Bits, see [`Stop::flags`].
        flags: i32,
        /// Duration \[s\].
        duration: f64,
        /// Earliest departure \[s\].
        until: f64,
        /// Distance of the stop's start from the start of the lane \[m\].
        start_pos: f64,
        /// Planned arrival \[s\].
        intended_arrival: f64,
        /// Arrival \[s\].
        arrival: f64,
        /// Departure \[s\].
        depart: f64,
        /// The vehicle that is split off at the stop.
        split: String,
        /// The vehicle that joins with this one at the stop.
        join: String,
        /// Purpose of the stop.
        act_type: String,
        /// Trip after the stop.
        trip_id: String,
        /// Line after the stop.
        line: String,
        /// Speed at a stop that the vehicle only passes \[m/s\].
        speed: f64,
    }
}
flat_list! { StopData }

record! {
    /// State of a lane change to one side; bits as in SUMO's `LaneChangeAction`.
    LaneChangeState {
        /// State from SUMO's lane change model alone.
        state: i32,
        /// State after the requests that came through TraCI.
        state_traci: i32,
    }
}
impl FromValue for LaneChangeState {
    fn from_value(value: Value) -> Result<Self, Error> {
        super::compound(value, super::value::FromFields::from_fields)
    }
}

/// A side of a vehicle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// To the left.
    Left,
    /// To the right.
    Right,
}

impl Side {
    /// Returns SUMO's number of the neighbouring lane on this side, relative to the vehicle's lane.
    const fn offset(self) -> i8 {
        match self {
            Side::Left => 1,
            Side::Right => -1,
        }
    }

    /// Returns the bit of [`LaneChangeState`] that says that the vehicle wants to change to this
    /// side.
    const fn bit(self) -> i32 {
        match self {
            Side::Left => 1 << 1,
            Side::Right => 1 << 2,
        }
    }
}

impl Argument for Side {
    fn write(self, w: &mut Writer) {
        w.integer(self.offset().into());
    }
}

/// Bits of [`LaneChangeState`] for a change that is blocked by leaders, followers, space or speed.
const BLOCKED: i32 = 0b1111 << 9 | 1 << 14 | 1 << 28;
/// Bit of [`LaneChangeState`] that says that no state is known.
const UNKNOWN: i32 = 1 << 30;

impl LaneChangeState {
    fn blocked(state: i32) -> bool {
        state & BLOCKED != 0
    }

    /// Whether the vehicle changed to this side in the last step, so that the state before the
    /// change no longer applies.
    fn changed(&self, side: Side) -> bool {
        self.state_traci & side.bit() != 0 && !Self::blocked(self.state_traci)
    }

    fn could(&self, side: Side) -> bool {
        !self.changed(side) && self.state != UNKNOWN && !Self::blocked(self.state)
    }

    fn wants_and_could(&self, side: Side) -> bool {
        !self.changed(side) && self.state & side.bit() != 0 && !Self::blocked(self.state)
    }

    /// Returns SUMO's names of the bits of a state.
    pub fn words(state: i32) -> Vec<&'static str> {
        let bits = STATE_WORDS.iter().enumerate().filter(|(bit, _)| state & (1 << bit) != 0);
        bits.map(|(_, word)| *word).collect()
    }
}

const STATE_WORDS: [&str; 16] = [
    "stay",
    "left",
    "right",
    "strategic",
    "cooperative",
    "speedGain",
    "keepRight",
    "TraCI",
    "urgent",
    "blocked by left leader",
    "blocked by left follower",
    "blocked by right leader",
    "blocked by right follower",
    "overlapping",
    "insufficient space",
    "sublane",
];

getters! { Vehicle, "vehicle", VEHICLE;
    /// Speed \[m/s\].
    get_speed "getSpeed" VAR_SPEED 0x40 -> f64;
    /// Speed to the left \[m/s\].
    get_lateral_speed "getLateralSpeed" VAR_SPEED_LAT 0x32 -> f64;
    /// Acceleration within the last step \[m/s²\].
    get_acceleration "getAcceleration" VAR_ACCELERATION 0x72 -> f64;
    /// Speed that the vehicle would have without commands through TraCI \[m/s\].
    get_speed_without_traci "getSpeedWithoutTraCI" VAR_SPEED_WITHOUT_TRACI 0xb1 -> f64;
    /// Position of the centre of the front bumper \[m\].
    get_position "getPosition" VAR_POSITION 0x42 -> [f64; 2];
    /// Position of the centre of the front bumper, with height \[m\].
    get_position3d "getPosition3D" VAR_POSITION3D 0x39 -> [f64; 3];
    /// Navigational angle \[deg\].
    get_angle "getAngle" VAR_ANGLE 0x43 -> f64;
    /// Edge where the vehicle is.
    get_road_id "getRoadID" VAR_ROAD_ID 0x50 -> String;
    /// Lane where the vehicle is.
    get_lane_id "getLaneID" VAR_LANE_ID 0x51 -> String;
    /// Index of the lane, 0 is the rightmost.
    get_lane_index "getLaneIndex" VAR_LANE_INDEX 0x52 -> i32;
    /// Vehicle type.
    get_type_id "getTypeID" VAR_TYPE 0x4f -> String;
    /// Identifier of the route.
    get_route_id "getRouteID" VAR_ROUTE_ID 0x53 -> String;
    /// Index of the current edge in the route; -1: not departed.
    get_route_index "getRouteIndex" VAR_ROUTE_INDEX 0x69 -> i32;
    /// Edges of the route.
    get_route "getRoute" VAR_EDGES 0x54 -> Vec<String>;
    /// Distance of the front bumper from the start of the lane \[m\].
    get_lane_position "getLanePosition" VAR_LANEPOSITION 0x56 -> f64;
    /// Number of persons on board.
    get_person_number "getPersonNumber" VAR_PERSON_NUMBER 0x67 -> i32;
    /// Persons on board.
    get_person_id_list "getPersonIDList" LAST_STEP_PERSON_ID_LIST 0x1a -> Vec<String>;
    /// Travel time of an edge that the vehicle's routing assumes at a simulation time \[s\].
    get_adapted_traveltime "getAdaptedTraveltime" 0x58 [time: f64, edge: &str] -> f64;
    /// Effort of an edge that the vehicle's routing assumes at a simulation time \[s\].
    get_effort "getEffort" 0x59 [time: f64, edge: &str] -> f64;
    /// Whether the route is connected.
    is_route_valid "isRouteValid" VAR_ROUTE_VALID 0x92 -> bool;
    /// Bits of the lights and indicators.
    get_signals "getSignals" VAR_SIGNALS 0x5b -> i32;
    /// Lateral offset from the centre line of the lane \[m\], positive to the left.
    get_lateral_lane_position "getLateralLanePosition" VAR_LANEPOSITION_LAT 0xb8 -> f64;
    /// Highest speed at which the vehicle may drive on the lane \[m/s\].
    get_allowed_speed "getAllowedSpeed" VAR_ALLOWED_SPEED 0xb7 -> f64;
    /// Time since the vehicle last moved, without planned stops \[s\].
    get_waiting_time "getWaitingTime" VAR_WAITING_TIME 0x7a -> f64;
    /// Sum of the waiting times within SUMO's `--waiting-time-memory` \[s\].
    get_accumulated_waiting_time "getAccumulatedWaitingTime" VAR_ACCUMULATED_WAITING_TIME 0x87 -> f64;
    /// Bits of the lane change mode.
    get_lane_change_mode "getLaneChangeMode" VAR_LANECHANGE_MODE 0xb6 -> i32;
    /// Bits of the speed mode.
    get_speed_mode "getSpeedMode" VAR_SPEEDSETMODE 0xb3 -> i32;
    /// Slope of the road \[deg\].
    get_slope "getSlope" VAR_SLOPE 0x36 -> f64;
    /// Line of public transport.
    get_line "getLine" VAR_LINE 0xbd -> String;
    /// Edges that the route must pass after rerouting.
    get_via "getVia" VAR_VIA 0xbe -> Vec<String>;
    /// Time of the vehicle's last decision \[s\].
    get_last_action_time "getLastActionTime" VAR_LASTACTIONTIME 0x7f -> f64;
    /// The lanes of the edge and their suitability for the route.
    get_best_lanes "getBestLanes" VAR_BEST_LANES 0xb2 -> Vec<BestLane>;
    /// The vehicle ahead within `distance` \[m\] (0: the braking distance).
    get_leader "getLeader" VAR_LEADER 0x68 (distance: f64) -> Option<Neighbor>;
    /// The vehicle behind within `distance` \[m\] (0: the braking distance).
    get_follower "getFollower" VAR_FOLLOWER 0x78 (distance: f64) -> Option<Neighbor>;
    /// The vehicles on a neighbouring lane. Bits of `mode`: 1: to the right, otherwise to the left;
    /// 2: ahead, otherwise behind; 4: only vehicles that block a lane change.
    get_neighbors "getNeighbors" 0xbf (mode: u8) -> Vec<Neighbor>;
    /// Speed at which the vehicle would follow a leader \[m/s\], for the vehicle's own speed, the
    /// gap \[m\], the leader's speed and greatest deceleration \[m/s²\], and the leader's
    /// identifier (may be empty).
    get_follow_speed "getFollowSpeed" 0x1c
        [speed: f64, gap: f64, leader_speed: f64, leader_max_decel: f64, leader: &str] -> f64;
    /// Gap at which the vehicle follows a leader safely \[m\], for the vehicle's own speed, the
    /// leader's speed and greatest deceleration \[m/s²\], and the leader's identifier (may be
    /// empty).
    get_secure_gap "getSecureGap" 0x1e
        [speed: f64, leader_speed: f64, leader_max_decel: f64, leader: &str] -> f64;
    /// Speed that the car-following model chooses for stopping within a gap \[m/s\], for the
    /// vehicle's own speed and the gap \[m\].
    get_stop_speed "getStopSpeed" 0x1d [speed: f64, gap: f64] -> f64;
    /// Expected delay at the departure from the next stop \[s\]; -1: no departure is planned.
    get_stop_delay "getStopDelay" VAR_STOP_DELAY 0x1f -> f64;
    /// Expected delay at the arrival at the next stop \[s\].
    get_stop_arrival_delay "getStopArrivalDelay" VAR_STOP_ARRIVALDELAY 0x22 -> f64;
    /// Time lost since departure by driving slower than desired \[s\].
    get_time_loss "getTimeLoss" VAR_TIMELOSS 0x8c -> f64;
    /// Traffic lights on the route ahead.
    get_next_tls "getNextTLS" VAR_NEXT_TLS 0x70 -> Vec<NextTls>;
    /// Stops ahead, in short form.
    get_next_stops "getNextStops" VAR_NEXT_STOPS 0x73 -> Vec<NextStop>;
    /// Stops ahead, at most `limit` of them (0: all); negative: that many past stops.
    get_stops "getStops" 0x74 (limit: i32) -> Vec<StopData>;
    /// Distance since departure \[m\].
    get_distance "getDistance" VAR_DISTANCE 0x84 -> f64;
    /// A parameter of a stop ahead, by the index of the stop; empty if the stop has no parameter of
    /// that name.
    get_stop_parameter "getStopParameter" 0x55 [stop: i32, key: &str] -> String;
    /// Bits of the stop state. 1: stopped, 2: parking, 4 and 8: waits for a person or a container,
    /// 16: at a bus stop, 32: at a container stop, 64: at a charging station, 128: at a parking
    /// area.
    get_stop_state "getStopState" VAR_STOPSTATE 0xb5 -> i32;
    /// State of a lane change to one side.
    get_lane_change_state "getLaneChangeState" 0x13 (side: Side) -> LaneChangeState;
    /// Routing mode. 0: default, 1: aggregated travel times, 2: effort, 3: both, 4: travel times
    /// and efforts that were set for this vehicle.
    get_routing_mode "getRoutingMode" VAR_ROUTING_MODE 0x89 -> i32;
}

const STOP_STATE: Call = Call::get("vehicle.getStopState", Domain::VEHICLE, VAR_STOPSTATE.number());
const DISTANCE: u8 = 0x83;
const DRIVING: u8 = 1;

impl<S: Scope> Vehicle<'_, S> {
    /// Returns the vehicles behind on the lane to the right, or only those that block a lane
    /// change.
    pub fn get_right_followers(
        &mut self,
        id: &str,
        blocking_only: bool,
    ) -> S::Output<Vec<Neighbor>> {
        self.get_neighbors(id, if blocking_only { 5 } else { 1 })
    }

    /// Returns the vehicles ahead on the lane to the right, or only those that block a lane change.
    pub fn get_right_leaders(&mut self, id: &str, blocking_only: bool) -> S::Output<Vec<Neighbor>> {
        self.get_neighbors(id, if blocking_only { 7 } else { 3 })
    }

    /// Returns the vehicles behind on the lane to the left, or only those that block a lane change.
    pub fn get_left_followers(
        &mut self,
        id: &str,
        blocking_only: bool,
    ) -> S::Output<Vec<Neighbor>> {
        self.get_neighbors(id, if blocking_only { 4 } else { 0 })
    }

    /// Returns the vehicles ahead on the lane to the left, or only those that block a lane change.
    pub fn get_left_leaders(&mut self, id: &str, blocking_only: bool) -> S::Output<Vec<Neighbor>> {
        self.get_neighbors(id, if blocking_only { 6 } else { 2 })
    }

    /// Subscribes to the vehicle ahead within `distance` \[m\]; each step reports it as
    /// [`VAR_LEADER`].
    pub fn subscribe_leader(&mut self, id: &str, distance: f64) -> S::Output<()> {
        self.subscribe_with(id, VAR_LEADER, distance)
    }

    /// Returns the distance along the route \[m\] to a position, which is given by edge, distance
    /// from the start of the lane \[m\] and lane.
    pub fn get_driving_distance(
        &mut self,
        id: &str,
        edge: &str,
        pos: f64,
        lane: u8,
    ) -> S::Output<f64> {
        let call = Call::get("vehicle.getDrivingDistance", Domain::VEHICLE, DISTANCE);
        super::get(self.0, call, id, |w| {
            w.compound(2).road_position(edge, pos, lane).u8(DRIVING);
        })
    }

    /// Returns the distance along the route to a position \[m\].
    pub fn get_driving_distance2d(&mut self, id: &str, position: [f64; 2]) -> S::Output<f64> {
        let call = Call::get("vehicle.getDrivingDistance2D", Domain::VEHICLE, DISTANCE);
        super::get(self.0, call, id, |w| {
            w.compound(2).position(position, false).u8(DRIVING);
        })
    }

    /// Returns the taxis in a state. -1: all, 0: empty, 1: on the way to a customer, 2: with a
    /// customer, 3: with a customer and on the way to another.
    pub fn get_taxi_fleet(&mut self, state: i32) -> S::Output<Vec<String>> {
        super::get(self.0, Call::get("vehicle.getTaxiFleet", Domain::VEHICLE, 0x20), "", |w| {
            w.integer(state);
        })
    }

    /// Whether the vehicle has stopped at a planned stop.
    pub fn is_stopped(&mut self, id: &str) -> S::Output<bool> {
        super::get_as(self.0, STOP_STATE, id, |_| {}, |v| Ok(super::value::<i32>(v)? & 0b1 != 0))
    }

    /// Whether the vehicle has stopped beside the road.
    pub fn is_stopped_parking(&mut self, id: &str) -> S::Output<bool> {
        super::get_as(self.0, STOP_STATE, id, |_| {}, |v| Ok(super::value::<i32>(v)? & 0b10 != 0))
    }

    /// Whether the vehicle has stopped until a person boards or a container is loaded.
    pub fn is_stopped_triggered(&mut self, id: &str) -> S::Output<bool> {
        super::get_as(self.0, STOP_STATE, id, |_| {}, |v| Ok(super::value::<i32>(v)? & 0b1100 != 0))
    }

    /// Whether the vehicle has stopped at a bus stop.
    pub fn is_at_bus_stop(&mut self, id: &str) -> S::Output<bool> {
        super::get_as(
            self.0,
            STOP_STATE,
            id,
            |_| {},
            |v| Ok(super::value::<i32>(v)? & 0b1_0000 != 0),
        )
    }

    /// Whether the vehicle has stopped at a container stop.
    pub fn is_at_container_stop(&mut self, id: &str) -> S::Output<bool> {
        super::get_as(
            self.0,
            STOP_STATE,
            id,
            |_| {},
            |v| Ok(super::value::<i32>(v)? & 0b10_0000 != 0),
        )
    }

    /// Like `get_lane_change_state`, as SUMO's names of the bits: from the lane change model alone,
    /// and after the requests through TraCI.
    pub fn get_lane_change_state_pretty(
        &mut self,
        id: &str,
        side: Side,
    ) -> S::Output<(Vec<&'static str>, Vec<&'static str>)> {
        self.lane_change(id, side, |v| {
            let LaneChangeState { state, state_traci } = super::value(v)?;
            Ok((LaneChangeState::words(state), LaneChangeState::words(state_traci)))
        })
    }

    /// Whether the vehicle could change lanes; `false` right after a lane change.
    pub fn could_change_lane(&mut self, id: &str, side: Side) -> S::Output<bool> {
        let decode: super::Decode<bool> = match side {
            Side::Left => |v| Ok(super::value::<LaneChangeState>(v)?.could(Side::Left)),
            Side::Right => |v| Ok(super::value::<LaneChangeState>(v)?.could(Side::Right)),
        };
        self.lane_change(id, side, decode)
    }

    /// Whether the vehicle wants to change lanes and could; `false` right after a lane change.
    pub fn wants_and_could_change_lane(&mut self, id: &str, side: Side) -> S::Output<bool> {
        let decode: super::Decode<bool> = match side {
            Side::Left => |v| Ok(super::value::<LaneChangeState>(v)?.wants_and_could(Side::Left)),
            Side::Right => |v| Ok(super::value::<LaneChangeState>(v)?.wants_and_could(Side::Right)),
        };
        self.lane_change(id, side, decode)
    }

    fn lane_change<T>(&mut self, id: &str, side: Side, decode: super::Decode<T>) -> S::Output<T> {
        let call = Call::get("vehicle.getLaneChangeState", Domain::VEHICLE, 0x13);
        super::get_as(self.0, call, id, |w| side.write(w), decode)
    }
}
