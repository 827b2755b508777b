//! Vehicles.

use super::Scope;
use crate::sumo::{
    batch::Call,
    value::{Color, Nothing, OnRoad, Untyped},
};

mod changes;
mod filters;
mod values;

pub use changes::{Addition, Gap, Placement, Stop, StopChange};
pub use values::{BestLane, LaneChangeState, Neighbor, NextStop, NextTls, Side, StopData};

domain! {
    /// Calls for vehicles.
    Vehicle, "vehicle", VEHICLE
}
identifiers! { Vehicle, "vehicle" }
type_attributes! { Vehicle, "vehicle" }
emissions! { Vehicle, "vehicle" }

getters! { Vehicle, "vehicle";
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
    /// A parameter of a stop ahead, by the index of the stop; empty if the stop does not have it.
    /// SUMO refuses names that are none of its attributes of stops.
    get_stop_parameter "getStopParameter" 0x55 [stop: i32, key: &str] -> String;
    /// Bits of the stop state. 1: stopped, 2: parking, 4 and 8: waits for a person or a container,
    /// 16: at a bus stop, 32: at a container stop, 64: at a charging station, 128: at a parking
    /// area.
    get_stop_state "getStopState" VAR_STOPSTATE 0xb5 -> i32;
    /// State of a lane change to one side.
    get_lane_change_state "getLaneChangeState" 0x13 (side: Side) -> LaneChangeState;
    /// Routing mode. 0: travel times that were set for this vehicle, else those that were loaded,
    /// else those of free flow; 1: aggregated travel times; 4: aggregated travel times, with those
    /// that were set for this vehicle.
    get_routing_mode "getRoutingMode" VAR_ROUTING_MODE 0x89 -> i32;
    /// The distance along the route \[m\] to a position, which is given by edge, distance from the
    /// start of the lane \[m\] and lane.
    get_driving_distance "getDrivingDistance" 0x83 {edge: &str, pos: f64, lane: u8} -> f64
        => (OnRoad(edge, pos, lane), DRIVING);
    /// The distance along the route to a position \[m\].
    get_driving_distance2d "getDrivingDistance2D" 0x83 {position: [f64; 2]} -> f64
        => (position, DRIVING);
}

/// Says that a distance is one along the roads.
const DRIVING: Untyped = Untyped(1);

global_getters! { Vehicle, "vehicle";
    /// The taxis in a state. -1: all, 0: empty, 1: on the way to a customer, 2: with a customer, 3:
    /// with a customer and on the way to another.
    get_taxi_fleet "getTaxiFleet" 0x20 {state: i32} -> Vec<String> => state;
}

/// Defines calls that read neighbouring vehicles; the columns are as in [`getters`], with the mode
/// of [`Vehicle::get_neighbors`] in place of the number.
macro_rules! neighbors {
    ($($(#[$doc:meta])* $method:ident $sumo:literal $mode:literal;)+) => {
        impl<S: Scope> Vehicle<'_, S> {
            $(
                $(#[$doc])*
                #[doc(alias = $sumo)]
                pub fn $method(
                    &mut self,
                    id: &str,
                    blocking_only: bool,
                ) -> S::Output<Vec<Neighbor>> {
                    self.get_neighbors(id, if blocking_only { $mode | 4 } else { $mode })
                }
            )+
        }
    };
}

neighbors! {
    /// The vehicles behind on the lane to the right, or only those that block a lane change.
    get_right_followers "getRightFollowers" 1;
    /// The vehicles ahead on the lane to the right, or only those that block a lane change.
    get_right_leaders "getRightLeaders" 3;
    /// The vehicles behind on the lane to the left, or only those that block a lane change.
    get_left_followers "getLeftFollowers" 0;
    /// The vehicles ahead on the lane to the left, or only those that block a lane change.
    get_left_leaders "getLeftLeaders" 2;
}

/// Defines calls that read bits of [`Vehicle::get_stop_state`]; the columns are as in [`getters`],
/// with the bits in place of the number.
macro_rules! stop_states {
    ($($(#[$doc:meta])* $method:ident $sumo:literal $bits:literal;)+) => {
        impl<S: Scope> Vehicle<'_, S> {
            $(
                $(#[$doc])*
                #[doc(alias = $sumo)]
                pub fn $method(&mut self, id: &str) -> S::Output<bool> {
                    let number = VAR_STOPSTATE.number();
                    let call = Call::get("vehicle.getStopState", DOMAIN, number);
                    super::get_as(self.0, call, id, Nothing, |state| {
                        Ok(super::value::<i32>(state)? & $bits != 0)
                    })
                }
            )+
        }
    };
}

stop_states! {
    /// Whether the vehicle has stopped at a planned stop.
    is_stopped "isStopped" 0b1;
    /// Whether the vehicle has stopped beside the road.
    is_stopped_parking "isStoppedParking" 0b10;
    /// Whether the vehicle has stopped until a person boards or a container is loaded.
    is_stopped_triggered "isStoppedTriggered" 0b1100;
    /// Whether the vehicle has stopped at a bus stop.
    is_at_bus_stop "isAtBusStop" 0b1_0000;
    /// Whether the vehicle has stopped at a container stop.
    is_at_container_stop "isAtContainerStop" 0b10_0000;
}

impl<S: Scope> Vehicle<'_, S> {
    /// Subscribes to the vehicle ahead within `distance` \[m\]; each step reports it as
    /// [`VAR_LEADER`].
    pub fn subscribe_leader(&mut self, id: &str, distance: f64) -> S::Output<()> {
        self.subscribe_with(id, VAR_LEADER, distance)
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
        let call = Call::get("vehicle.getLaneChangeState", DOMAIN, 0x13);
        super::get_as(self.0, call, id, side, decode)
    }
}
