//! Calls that change vehicles.

use super::Vehicle;
use crate::sumo::{
    batch::Call,
    codec::Writer,
    constants::{self as c, Domain},
    domain::{Highlight, Scope, set},
};

/// A new vehicle, see [`Vehicle::add`]. Departure and arrival are texts because most of them can be words.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Addition<'a> {
    /// Route identifier; empty: somewhere in the net.
    pub route: &'a str,
    /// Vehicle type identifier.
    pub vehicle_type: &'a str,
    /// Time \[s\], `now` or `triggered`.
    pub depart: &'a str,
    /// Index of the lane, `first`, `free`, `allowed`, `best` or `random`.
    pub depart_lane: &'a str,
    /// Distance of the front bumper from the start of the first edge \[m\], `base`, `free`, `random`, `last`…
    pub depart_pos: &'a str,
    /// Speed \[m/s\], `max`, `desired`, `random`…
    pub depart_speed: &'a str,
    /// Index of the lane, or `current`.
    pub arrival_lane: &'a str,
    /// Distance from the start of the last edge \[m\], `max` or `random`.
    pub arrival_pos: &'a str,
    /// Speed \[m/s\], or `current`.
    pub arrival_speed: &'a str,
    /// Traffic assignment zone where it departs; empty: none.
    pub from_taz: &'a str,
    /// Traffic assignment zone where it arrives; empty: none.
    pub to_taz: &'a str,
    /// Line of public transport; empty: none.
    pub line: &'a str,
    /// Number of persons that find room, besides the driver.
    pub person_capacity: i32,
    /// Number of persons on board.
    pub person_number: i32,
}

impl<'a> Addition<'a> {
    /// A vehicle of the default type that departs now from the start of a route, standing.
    pub const fn on_route(route: &'a str) -> Self {
        Addition {
            route,
            vehicle_type: "DEFAULT_VEHTYPE",
            depart: "now",
            depart_lane: "first",
            depart_pos: "base",
            depart_speed: "0",
            arrival_lane: "current",
            arrival_pos: "max",
            arrival_speed: "current",
            from_taz: "",
            to_taz: "",
            line: "",
            person_capacity: 0,
            person_number: 0,
        }
    }
}

/// A stop, see [`Vehicle::set_stop`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stop<'a> {
    /// Edge, or the bus stop, container stop, charging station or parking area that the flags tell of.
    pub place: &'a str,
    /// Distance of its end from the start of the lane \[m\].
    pub pos: f64,
    /// Index of the lane, 0 is the rightmost.
    pub lane: i8,
    /// Duration \[s\]; [`c::INVALID_DOUBLE_VALUE`]: until told to go on.
    pub duration: f64,
    /// Bits: 1: beside the road, 2: until a person boards, 4: until a container is loaded, 8: bus stop,
    /// 16: container stop, 32: charging station, 64: parking area, 128: overhead wire.
    pub flags: u8,
    /// Distance of its start from the start of the lane \[m\]; [`c::INVALID_DOUBLE_VALUE`]: close to its end.
    pub start_pos: f64,
    /// Not before this time \[s\]; [`c::INVALID_DOUBLE_VALUE`]: no such limit.
    pub until: f64,
}

impl<'a> Stop<'a> {
    const BUS_STOP: u8 = 8;
    const CONTAINER_STOP: u8 = 16;
    const CHARGING_STATION: u8 = 32;
    const PARKING_AREA: u8 = 64;
    const PARKING: u8 = 1;

    /// A stop without end on the rightmost lane of an edge, at a distance from its start \[m\].
    pub const fn on_edge(edge: &'a str, pos: f64) -> Self {
        let unknown = c::INVALID_DOUBLE_VALUE;
        Stop {
            place: edge,
            pos,
            lane: 0,
            duration: unknown,
            flags: 0,
            start_pos: unknown,
            until: unknown,
        }
    }

    /// The same for so long \[s\].
    #[must_use]
    pub const fn lasting(self, duration: f64) -> Self {
        Stop { duration, ..self }
    }

    const fn at(place: &'a str, duration: f64, until: f64, flags: u8) -> Self {
        Stop { duration, flags, until, ..Stop::on_edge(place, 1.0) }
    }
}

/// How a stop changes the plan, see [`Vehicle::replace_stop`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StopChange<'a> {
    /// Index of the stop on the way.
    pub index: i32,
    /// The stop; with an empty place, the one of the index is removed.
    pub stop: Stop<'a>,
    /// Bits: 1: the vehicle jumps over the part of the route that the change cuts off…
    pub teleport: i8,
}

impl StopChange<'_> {
    fn write(&self, w: &mut Writer) {
        let Stop { place, pos, lane, duration, flags, start_pos, until } = self.stop;
        w.compound(9)
            .string(place)
            .double(pos)
            .u8(c::TYPE_BYTE)
            .u8(lane.cast_unsigned())
            .double(duration);
        w.integer(flags.into()).double(start_pos).double(until).integer(self.index);
        w.u8(c::TYPE_BYTE).u8(self.teleport.cast_unsigned());
    }
}

/// A greater gap to the leader, see [`Vehicle::open_gap`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gap<'a> {
    /// Time headway to reach \[s\]; negative: as before.
    pub time_headway: f64,
    /// Space headway to reach \[m\]; negative: as before.
    pub space_headway: f64,
    /// How long to keep it \[s\].
    pub duration: f64,
    /// How fast to reach it \[1/s\].
    pub change_rate: f64,
    /// Greatest deceleration for it \[m/s²\]; negative: that of the vehicle.
    pub max_decel: f64,
    /// The vehicle to keep the gap to; empty: the leader.
    pub reference: &'a str,
}

/// How [`Vehicle::move_to_xy`] finds the place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Placement<'a> {
    /// The edge to prefer; empty: none.
    pub edge: &'a str,
    /// Index of the lane to prefer; -1: none.
    pub lane: i32,
    /// Navigational angle \[deg\]; [`c::INVALID_DOUBLE_VALUE`]: that of the lane.
    pub angle: f64,
    /// Bits: 1: the closest place of the route, else of the net, and the route is that one edge then;
    /// 2: exactly there, on a road or not; 4: also where the vehicle is not allowed.
    pub keep_route: u8,
    /// How far away a place may be \[m\].
    pub match_threshold: f64,
}

impl Default for Placement<'_> {
    fn default() -> Self {
        Placement {
            edge: "",
            lane: -1,
            angle: c::INVALID_DOUBLE_VALUE,
            keep_route: 1,
            match_threshold: 100.0,
        }
    }
}

const fn call(name: &'static str, variable: u8) -> Call {
    Call::set(name, Domain::VEHICLE, variable)
}

setters! { Vehicle, "vehicle", VEHICLE;
    /// Sends the vehicle to another parking area on its way.
    reroute_parking_area "rerouteParkingArea" 0xc2 [parking_area: &str];
    /// Sets a parameter of a stop on the way, by its index.
    set_stop_parameter "setStopParameter" 0x55 [stop: i32, key: &str, value: &str];
    /// Ends the stop.
    resume "resume" 0x19 [];
    /// Changes to a lane, by its index, and stays there for a duration \[s\].
    change_lane "changeLane" 0x13 [lane: i8, duration: f64];
    /// Moves so far to the left \[m\], in the sublane model.
    change_sublane "changeSublane" 0x15 (distance: f64);
    /// Reaches a speed \[m/s\] within a duration \[s\].
    slow_down "slowDown" 0x14 [speed: f64, duration: f64];
    /// Drives to another edge, by a new route.
    change_target "changeTarget" 0x31 (edge: &str);
    /// Sets the vehicle type.
    set_type "setType" 0x4f (kind: &str);
    /// Sets the route, by its identifier.
    set_route_id "setRouteID" 0x53 (route: &str);
    /// Sets the edges of the route; the first is the edge where the vehicle is.
    set_route "setRoute" 0x57 (edges: &[impl AsRef<str>]);
    /// Looks anew which lanes suit the route.
    update_best_lanes "updateBestLanes" 0x6a;
    /// Forgets the travel time of an edge that was set for the vehicle's routing.
    reset_adapted_traveltime "setAdaptedTraveltime" 0x58 [edge: &str];
    /// Sets the travel time of an edge \[s\] for the vehicle's routing.
    set_adapted_traveltime "setAdaptedTraveltime" 0x58 [edge: &str, time: f64];
    /// As `set_adapted_traveltime`, from the simulation time `begin` to `end` \[s\].
    set_adapted_traveltime_during "setAdaptedTraveltime" 0x58 [begin: f64, end: f64, edge: &str, time: f64];
    /// Forgets the effort of an edge that was set for the vehicle's routing.
    reset_effort "setEffort" 0x59 [edge: &str];
    /// Sets the effort of an edge for the vehicle's routing.
    set_effort "setEffort" 0x59 [edge: &str, effort: f64];
    /// As `set_effort`, from the simulation time `begin` to `end` \[s\].
    set_effort_during "setEffort" 0x59 [begin: f64, end: f64, edge: &str, effort: f64];
    /// Sets how the vehicle finds routes, see `get_routing_mode`.
    set_routing_mode "setRoutingMode" 0x89 (mode: i32);
    /// Finds the fastest route anew, by the vehicle's routing mode. (Python's client switches to mode 4 for
    /// the call if the mode is 0; here that is left to the caller.)
    reroute_traveltime "rerouteTraveltime" 0x90 [];
    /// Finds the route of least effort anew.
    reroute_effort "rerouteEffort" 0x91 [];
    /// Sets the bits of the lights and indicators.
    set_signals "setSignals" 0x5b (signals: i32);
    /// Puts the vehicle at a distance from the start of a lane \[m\] on its route; `reason`: 0: automatic,
    /// 1: teleport, 2: as if it had driven there.
    move_to "moveTo" 0x5c [lane: &str, pos: f64, reason: i32];
    /// Sets the speed to keep \[m/s\]; a negative value gives the speed back to SUMO's driver.
    set_speed "setSpeed" 0x40 (speed: f64);
    /// Sets the acceleration \[m/s²\] for a duration \[s\].
    set_acceleration "setAcceleration" 0x72 [acceleration: f64, duration: f64];
    /// Pretends that the last step ended with a speed \[m/s\] and an acceleration \[m/s²\]
    /// ([`c::INVALID_DOUBLE_VALUE`]: what follows from the speeds).
    set_previous_speed "setPreviousSpeed" 0x3c [speed: f64, acceleration: f64];
    /// Sets the line of public transport.
    set_line "setLine" 0xbd (line: &str);
    /// Sets the edges that rerouting must keep.
    set_via "setVia" 0xbe (edges: &[impl AsRef<str>]);
    /// Sets the bits of the lane change mode (1621: as SUMO's driver, 512: none of its own).
    set_lane_change_mode "setLaneChangeMode" 0xb6 (mode: i32);
    /// Sets which checks SUMO's driver applies to the set speed (31: all, 32: none).
    set_speed_mode "setSpeedMode" 0xb3 (mode: i32);
    /// Sends a taxi to reservations; with several of them, each stands in the order twice: pick-up, drop-off.
    dispatch_taxi "dispatchTaxi" 0x21 (reservations: &[impl AsRef<str>]);
    /// Removes the vehicle; `reason`: 0: teleport, 1: parking, 2: arrived, 3: vaporized, 4: arrived by teleport.
    remove "remove" 0x81 (reason: i8);
}

impl<S: Scope> Vehicle<'_, S> {
    /// Makes a new vehicle.
    pub fn add(&mut self, id: &str, addition: &Addition<'_>) -> S::Output<()> {
        set(self.0, call("vehicle.add", 0x85), id, |w| {
            w.compound(14);
            for text in [
                addition.route,
                addition.vehicle_type,
                addition.depart,
                addition.depart_lane,
                addition.depart_pos,
                addition.depart_speed,
                addition.arrival_lane,
                addition.arrival_pos,
                addition.arrival_speed,
                addition.from_taz,
                addition.to_taz,
                addition.line,
            ] {
                w.string(text);
            }
            w.integer(addition.person_capacity).integer(addition.person_number);
        })
    }

    /// Adds a stop to the plan, or changes that on the same place.
    pub fn set_stop(&mut self, id: &str, stop: &Stop<'_>) -> S::Output<()> {
        self.stop("vehicle.setStop", id, stop)
    }

    /// As `set_stop`, at a bus stop, for a duration \[s\] and not before the time `until` \[s\]
    /// ([`c::INVALID_DOUBLE_VALUE`]: no such limit).
    pub fn set_bus_stop(
        &mut self,
        id: &str,
        stop: &str,
        duration: f64,
        until: f64,
    ) -> S::Output<()> {
        self.stop("vehicle.setBusStop", id, &Stop::at(stop, duration, until, Stop::BUS_STOP))
    }

    /// As `set_bus_stop`, at a container stop.
    pub fn set_container_stop(
        &mut self,
        id: &str,
        stop: &str,
        duration: f64,
        until: f64,
    ) -> S::Output<()> {
        self.stop(
            "vehicle.setContainerStop",
            id,
            &Stop::at(stop, duration, until, Stop::CONTAINER_STOP),
        )
    }

    /// As `set_bus_stop`, at a charging station.
    pub fn set_charging_station_stop(
        &mut self,
        id: &str,
        stop: &str,
        duration: f64,
        until: f64,
    ) -> S::Output<()> {
        let stop = Stop::at(stop, duration, until, Stop::CHARGING_STATION);
        self.stop("vehicle.setChargingStationStop", id, &stop)
    }

    /// As `set_bus_stop`, at a parking area.
    pub fn set_parking_area_stop(
        &mut self,
        id: &str,
        area: &str,
        duration: f64,
        until: f64,
    ) -> S::Output<()> {
        let stop = Stop::at(area, duration, until, Stop::PARKING_AREA | Stop::PARKING);
        self.stop("vehicle.setParkingAreaStop", id, &stop)
    }

    fn stop(&mut self, name: &'static str, id: &str, stop: &Stop<'_>) -> S::Output<()> {
        set(self.0, call(name, 0x12), id, |w| {
            let Stop { place, pos, lane, duration, flags, start_pos, until } = *stop;
            w.compound(7)
                .string(place)
                .double(pos)
                .u8(c::TYPE_BYTE)
                .u8(lane.cast_unsigned())
                .double(duration);
            w.u8(c::TYPE_BYTE).u8(flags).double(start_pos).double(until);
        })
    }

    /// Replaces a stop on the way; the route between the stops before and after it changes with it.
    pub fn replace_stop(&mut self, id: &str, change: &StopChange<'_>) -> S::Output<()> {
        set(self.0, call("vehicle.replaceStop", 0x17), id, |w| change.write(w))
    }

    /// Puts a stop before the one of that index; the route changes with it. SUMO 1.15 may die of a second call
    /// of this or of [`Vehicle::replace_stop`] for the same vehicle.
    pub fn insert_stop(&mut self, id: &str, change: &StopChange<'_>) -> S::Output<()> {
        set(self.0, call("vehicle.insertStop", 0x18), id, |w| change.write(w))
    }

    /// Changes so many lanes to the left (negative: to the right), and stays there for a duration \[s\].
    pub fn change_lane_relative(&mut self, id: &str, offset: i8, duration: f64) -> S::Output<()> {
        set(self.0, call("vehicle.changeLaneRelative", 0x13), id, |w| {
            w.compound(3).u8(c::TYPE_BYTE).u8(offset.cast_unsigned()).double(duration);
            w.u8(c::TYPE_BYTE).u8(1);
        })
    }

    /// Opens a gap to the leader.
    pub fn open_gap(&mut self, id: &str, gap: &Gap<'_>) -> S::Output<()> {
        self.gap("vehicle.openGap", id, gap)
    }

    /// No longer keeps a gap that was opened.
    pub fn deactivate_gap_control(&mut self, id: &str) -> S::Output<()> {
        let off = -1.0;
        let gap = Gap {
            time_headway: off,
            space_headway: off,
            duration: off,
            change_rate: off,
            max_decel: off,
            reference: "",
        };
        self.gap("vehicle.deactivateGapControl", id, &gap)
    }

    fn gap(&mut self, name: &'static str, id: &str, gap: &Gap<'_>) -> S::Output<()> {
        set(self.0, call(name, 0x16), id, |w| {
            w.compound(if gap.reference.is_empty() { 5 } else { 6 });
            w.double(gap.time_headway).double(gap.space_headway).double(gap.duration);
            w.double(gap.change_rate).double(gap.max_decel);
            if !gap.reference.is_empty() {
                w.string(gap.reference);
            }
        })
    }

    /// Asks the driver to take over from the automation within a time \[s\].
    pub fn request_toc(&mut self, id: &str, lead_time: f64) -> S::Output<()> {
        self.set_parameter(id, "device.toc.requestToC", &lead_time.to_string())
    }

    /// Draws a circle around the vehicle in the graphical interface.
    pub fn highlight(&mut self, id: &str, highlight: &Highlight) -> S::Output<()> {
        set(self.0, call("vehicle.highlight", 0x6c), id, |w| highlight.write(w))
    }

    /// Puts the centre of the front bumper at a position \[m\], after the next step's movement.
    pub fn move_to_xy(
        &mut self,
        id: &str,
        position: [f64; 2],
        placement: &Placement<'_>,
    ) -> S::Output<()> {
        set(self.0, call("vehicle.moveToXY", 0xb4), id, |w| {
            let Placement { edge, lane, angle, keep_route, match_threshold } = *placement;
            w.compound(7)
                .string(edge)
                .integer(lane)
                .double(position[0])
                .double(position[1])
                .double(angle);
            w.u8(c::TYPE_BYTE).u8(keep_route).double(match_threshold);
        })
    }
}
