//! Types of the values that the calls for vehicles return.

use crate::sumo::{
    Error,
    codec::{Value, Writer},
    value::{Argument, FromFields, FromValue, compound},
};

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
        let neighbor: Neighbor = compound(value, FromFields::from_fields)?;
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
        /// Bits, see [`Stop::flags`](super::Stop::flags).
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
        compound(value, FromFields::from_fields)
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
    pub(super) const fn offset(self) -> i8 {
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

    pub(super) fn could(&self, side: Side) -> bool {
        !self.changed(side) && self.state != UNKNOWN && !Self::blocked(self.state)
    }

    pub(super) fn wants_and_could(&self, side: Side) -> bool {
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
