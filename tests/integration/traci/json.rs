//! Conversion of results to JSON, with the fields in the order of the Python client; floating-point
//! numbers become the hexadecimal digits of their bits.

use iwol_sumo::sumo::domain::{
    Color, RoadPosition,
    induction_loop::VehicleData,
    lane::Connection,
    person::Reservation,
    simulation::{Collision, Stage},
    traffic_light::{Constraint, Link, Logic, Phase},
    vehicle::{BestLane, LaneChangeState, Neighbor, NextStop, NextTls, StopData},
};
use serde_json::Value as Json;

pub trait ToJson {
    fn json(self) -> Json;
}

impl ToJson for f64 {
    fn json(self) -> Json {
        format!("{:016x}", self.to_bits()).into()
    }
}

impl<T: ToJson, const N: usize> ToJson for [T; N] {
    fn json(self) -> Json {
        self.into_iter().map(T::json).collect()
    }
}

impl<T: ToJson> ToJson for Vec<T> {
    fn json(self) -> Json {
        self.into_iter().map(T::json).collect()
    }
}

impl<T: ToJson> ToJson for Option<T> {
    fn json(self) -> Json {
        self.map_or(Json::Null, T::json)
    }
}

impl<A: ToJson, B: ToJson> ToJson for (A, B) {
    fn json(self) -> Json {
        Json::Array(vec![self.0.json(), self.1.json()])
    }
}

impl ToJson for char {
    fn json(self) -> Json {
        self.to_string().into()
    }
}

macro_rules! plain {
    ($($kind:ty),+) => {
        $(impl ToJson for $kind {
            fn json(self) -> Json {
                self.into()
            }
        })+
    };
}

plain! { bool, i32, u8, String, &'static str }

/// Implements `ToJson` for structs, with the fields in the Python client's order.
macro_rules! fields {
    ($($kind:ident: $($field:ident),+;)+) => {
        $(impl ToJson for $kind {
            fn json(self) -> Json {
                Json::Array(vec![$(self.$field.json()),+])
            }
        })+
    };
}

fields! {
    BestLane: lane, length, occupation, offset, allows_continuation, next;
    Collision: collider, victim, collider_type, victim_type, collider_speed, victim_speed, kind, lane, pos;
    Color: r, g, b, a;
    Connection: approached_lane, has_prio, is_open, has_foe, approached_internal, state, direction, length;
    Constraint: signal_id, trip_id, foe_id, foe_signal, limit, kind, must_wait, active, parameters;
    LaneChangeState: state, state_traci;
    Link: from, to, via;
    Logic: program_id, kind, current_phase_index, phases, parameters;
    Neighbor: id, gap;
    NextStop: lane, end_pos, stopping_place, flags, duration, until;
    NextTls: id, index, distance, state;
    Phase: duration, state, min_dur, max_dur, next, name;
    Reservation: id, persons, group, from_edge, to_edge, arrival_pos, depart_pos, depart, reservation_time, state;
    RoadPosition: edge, position, lane;
    Stage: kind, vehicle_type, line, destination_stop, edges, travel_time, cost, length, intended, depart, depart_pos,
        arrival_pos, description;
    StopData: lane, start_pos, end_pos, stopping_place, flags, duration, until, intended_arrival, arrival, depart, split,
        join, act_type, trip_id, line, speed;
    VehicleData: id, length, entry_time, leave_time, type_id;
}
