//! Calls that change vehicles.

use super::{DOMAIN, Vehicle};
use crate::sumo::{
    codec::Writer,
    constants as c,
    domain::{Argument, Highlight, Scope},
};

/// A new vehicle, see [`Vehicle::add`]. Departure and arrival are strings because SUMO accepts
/// words as well as numbers for most of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Addition<'a> {
    /// Route identifier; empty: a random place in the net.
    pub route: &'a str,
    /// Vehicle type identifier.
    pub vehicle_type: &'a str,
    /// Departure time \[s\], `now` or `triggered`.
    pub depart: &'a str,
    /// Index of the departure lane, `first`, `free`, `allowed`, `best` or `random`.
    pub depart_lane: &'a str,
    /// Departure position: distance of the front bumper from the start of the first edge \[m\],
    /// `base`, `free`, `random`, `last`…
    pub depart_pos: &'a str,
    /// Departure speed \[m/s\], `max`, `desired`, `random`…
    pub depart_speed: &'a str,
    /// Index of the arrival lane, or `current`.
    pub arrival_lane: &'a str,
    /// Arrival position: distance from the start of the last edge \[m\], `max` or `random`.
    pub arrival_pos: &'a str,
    /// Arrival speed \[m/s\], or `current`.
    pub arrival_speed: &'a str,
    /// Traffic assignment zone of the departure; empty: none.
    pub from_taz: &'a str,
    /// Traffic assignment zone of the arrival; empty: none.
    pub to_taz: &'a str,
    /// Line of public transport; empty: none.
    pub line: &'a str,
    /// Number of persons that the vehicle can carry, besides the driver.
    pub person_capacity: i32,
    /// Number of persons on board.
    pub person_number: i32,
}

impl<'a> Addition<'a> {
    /// Returns a vehicle of the default type that departs now, at rest, from the start of a route.
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

impl Argument for &Addition<'_> {
    fn write(self, w: &mut Writer) {
        w.compound(14);
        for text in [
            self.route,
            self.vehicle_type,
            self.depart,
            self.depart_lane,
            self.depart_pos,
            self.depart_speed,
            self.arrival_lane,
            self.arrival_pos,
            self.arrival_speed,
            self.from_taz,
            self.to_taz,
            self.line,
        ] {
            w.string(text);
        }
        w.integer(self.person_capacity).integer(self.person_number);
    }
}

/// A stop, see [`Vehicle::set_stop`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stop<'a> {
    /// Edge, or the bus stop, container stop, charging station or parking area that the flags
    /// select.
    pub place: &'a str,
    /// Distance of the stop's end from the start of the lane \[m\].
    pub pos: f64,
    /// Index of the lane, 0 is the rightmost.
    pub lane: i8,
    /// Duration \[s\]; [`c::INVALID_DOUBLE_VALUE`]: until [`Vehicle::resume`].
    pub duration: f64,
    /// Bits. 1: beside the road, 2: until a person boards, 4: until a container is loaded, 8: bus
    /// stop, 16: container stop, 32: charging station, 64: parking area, 128: overhead wire.
    pub flags: u8,
    /// Distance of the stop's start from the start of the lane \[m\]; [`c::INVALID_DOUBLE_VALUE`]:
    /// close to its end.
    pub start_pos: f64,
    /// Earliest departure \[s\]; [`c::INVALID_DOUBLE_VALUE`]: no limit.
    pub until: f64,
}

impl<'a> Stop<'a> {
    const BUS_STOP: u8 = 8;
    const CONTAINER_STOP: u8 = 16;
    const CHARGING_STATION: u8 = 32;
    const PARKING_AREA: u8 = 64;
    const PARKING: u8 = 1;

    /// Returns an unlimited stop on the rightmost lane of an edge, at a distance from its start
    /// \[m\].
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

    /// Returns the same stop with a duration \[s\].
    #[must_use]
    pub const fn lasting(self, duration: f64) -> Self {
        Stop { duration, ..self }
    }

    const fn at(place: &'a str, duration: f64, until: f64, flags: u8) -> Self {
        Stop { duration, flags, until, ..Stop::on_edge(place, 1.0) }
    }
}

impl Argument for &Stop<'_> {
    fn write(self, w: &mut Writer) {
        let Stop { place, pos, lane, duration, flags, start_pos, until } = *self;
        (place, pos, lane, duration, flags.cast_signed(), start_pos, until).write(w);
    }
}

/// A change of the planned stops, see [`Vehicle::replace_stop`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StopChange<'a> {
    /// Index among the stops ahead.
    pub index: i32,
    /// The new stop; if its place is empty, the stop at the index is removed.
    pub stop: Stop<'a>,
    /// Bits. 1: the vehicle teleports over the part of the route that the change cuts off…
    pub teleport: i8,
}

impl Argument for &StopChange<'_> {
    fn write(self, w: &mut Writer) {
        let Stop { place, pos, lane, duration, flags, start_pos, until } = self.stop;
        let (flags, index, teleport) = (i32::from(flags), self.index, self.teleport);
        (place, pos, lane, duration, flags, start_pos, until, index, teleport).write(w);
    }
}

/// A larger gap to the leader, see [`Vehicle::open_gap`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gap<'a> {
    /// Time headway to reach \[s\]; negative: unchanged.
    pub time_headway: f64,
    /// Space headway to reach \[m\]; negative: unchanged.
    pub space_headway: f64,
    /// Time for which the vehicle keeps the gap \[s\].
    pub duration: f64,
    /// Rate at which the vehicle opens the gap \[1/s\].
    pub change_rate: f64,
    /// Greatest deceleration for opening the gap \[m/s²\]; negative: the vehicle's own.
    pub max_decel: f64,
    /// The vehicle to which the gap is kept; empty: the leader.
    pub reference: &'a str,
}

impl Gap<'_> {
    /// The end of the control of a gap.
    const OFF: Gap<'static> = Gap {
        time_headway: -1.0,
        space_headway: -1.0,
        duration: -1.0,
        change_rate: -1.0,
        max_decel: -1.0,
        reference: "",
    };
}

impl Argument for &Gap<'_> {
    fn write(self, w: &mut Writer) {
        let Gap { time_headway, space_headway, duration, change_rate, max_decel, reference } =
            *self;
        if reference.is_empty() {
            (time_headway, space_headway, duration, change_rate, max_decel).write(w);
        } else {
            (time_headway, space_headway, duration, change_rate, max_decel, reference).write(w);
        }
    }
}

/// Options for how [`Vehicle::move_to_xy`] matches a position to the net.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Placement<'a> {
    /// The preferred edge; empty: none.
    pub edge: &'a str,
    /// Index of the preferred lane; -1: none.
    pub lane: i32,
    /// Navigational angle \[deg\]; [`c::INVALID_DOUBLE_VALUE`]: the angle of the lane.
    pub angle: f64,
    /// Bits. 1: the closest position on the route; without this bit, the closest position in the
    /// net, and the route becomes that one edge. 2: exactly the given position, on a road or not.
    /// 4: also lanes that the vehicle may not use.
    pub keep_route: u8,
    /// Greatest distance between the given and the matched position \[m\].
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

setters! { Vehicle, "vehicle";
    /// Sends the vehicle to another parking area on its route.
    reroute_parking_area "rerouteParkingArea" 0xc2 [parking_area: &str];
    /// Sets a parameter of a stop ahead, by the index of the stop.
    set_stop_parameter "setStopParameter" 0x55 [stop: i32, key: &str, value: &str];
    /// Ends the current stop.
    resume "resume" 0x19 [];
    /// Changes to a lane, by its index, and keeps the vehicle there for a duration \[s\].
    change_lane "changeLane" 0x13 [lane: i8, duration: f64];
    /// Moves the vehicle to the left by a distance \[m\], in the sublane model.
    change_sublane "changeSublane" 0x15 (distance: f64);
    /// Changes the speed to a value \[m/s\] within a duration \[s\].
    slow_down "slowDown" 0x14 [speed: f64, duration: f64];
    /// Sets the destination edge and computes a new route to it.
    change_target "changeTarget" 0x31 (edge: &str);
    /// Sets the vehicle type.
    set_type "setType" 0x4f (kind: &str);
    /// Sets the route, by its identifier.
    set_route_id "setRouteID" 0x53 (route: &str);
    /// Sets the edges of the route; the first one must be the current edge.
    set_route "setRoute" 0x57 (edges: &[impl AsRef<str>]);
    /// Computes again which lanes suit the route.
    update_best_lanes "updateBestLanes" 0x6a;
    /// Removes the travel time of an edge that was set for the vehicle's routing.
    reset_adapted_traveltime "setAdaptedTraveltime" 0x58 [edge: &str];
    /// Sets the travel time of an edge \[s\] for the vehicle's routing.
    set_adapted_traveltime "setAdaptedTraveltime" 0x58 [edge: &str, time: f64];
    /// Like `set_adapted_traveltime`, from the simulation time `begin` to `end` \[s\].
    set_adapted_traveltime_during "setAdaptedTraveltime" 0x58 [begin: f64, end: f64, edge: &str, time: f64];
    /// Removes the effort of an edge that was set for the vehicle's routing.
    reset_effort "setEffort" 0x59 [edge: &str];
    /// Sets the effort of an edge for the vehicle's routing.
    set_effort "setEffort" 0x59 [edge: &str, effort: f64];
    /// Like `set_effort`, from the simulation time `begin` to `end` \[s\].
    set_effort_during "setEffort" 0x59 [begin: f64, end: f64, edge: &str, effort: f64];
    /// Sets the routing mode, see `get_routing_mode`.
    set_routing_mode "setRoutingMode" 0x89 (mode: i32);
    /// Computes the fastest route again, in the vehicle's routing mode. (Python's client switches
    /// to mode 4 for the call if the mode is 0; this client does not.)
    reroute_traveltime "rerouteTraveltime" 0x90 [];
    /// Computes the route of least effort again.
    reroute_effort "rerouteEffort" 0x91 [];
    /// Sets the bits of the lights and indicators.
    set_signals "setSignals" 0x5b (signals: i32);
    /// Moves the vehicle to a distance from the start of a lane \[m\] on its route. `reason`: 0:
    /// automatic, 1: teleport, 2: as if the vehicle had driven there.
    move_to "moveTo" 0x5c [lane: &str, pos: f64, reason: i32];
    /// Sets the speed to keep \[m/s\]; a negative value returns control of the speed to SUMO.
    set_speed "setSpeed" 0x40 (speed: f64);
    /// Sets the acceleration \[m/s²\] for a duration \[s\].
    set_acceleration "setAcceleration" 0x72 [acceleration: f64, duration: f64];
    /// Overrides the speed \[m/s\] and the acceleration \[m/s²\] at the end of the last step (with
    /// the acceleration [`c::INVALID_DOUBLE_VALUE`], SUMO derives it from the speeds).
    set_previous_speed "setPreviousSpeed" 0x3c [speed: f64, acceleration: f64];
    /// Sets the line of public transport.
    set_line "setLine" 0xbd (line: &str);
    /// Sets the edges that the route must pass after rerouting.
    set_via "setVia" 0xbe (edges: &[impl AsRef<str>]);
    /// Sets the bits of the lane change mode (1621: SUMO's lane change model, 512: no lane changes
    /// by itself).
    set_lane_change_mode "setLaneChangeMode" 0xb6 (mode: i32);
    /// Sets which checks SUMO applies to a speed that was set (31: all, 32: none).
    set_speed_mode "setSpeedMode" 0xb3 (mode: i32);
    /// Sends a taxi to reservations. With several reservations, the list holds each of them twice:
    /// first for the pick-up, then for the drop-off.
    dispatch_taxi "dispatchTaxi" 0x21 (reservations: &[impl AsRef<str>]);
    /// Removes the vehicle. `reason`: 0: teleport, 1: parking, 2: arrived, 3: vaporized, 4: arrived
    /// by teleport.
    remove "remove" 0x81 (reason: i8);
    /// Adds a vehicle.
    add "add" 0x85 (addition: &Addition<'_>);
    /// Adds a stop to the plan, or changes the stop that the plan has at the same place.
    set_stop "setStop" 0x12 (stop: &Stop<'_>);
    /// Like `set_stop`, at a bus stop, for a duration \[s\]; the vehicle departs at the time
    /// `until` \[s\] at the earliest ([`c::INVALID_DOUBLE_VALUE`]: no limit).
    set_bus_stop "setBusStop" 0x12
        {stop: &str, duration: f64, until: f64}
        => &Stop::at(stop, duration, until, Stop::BUS_STOP);
    /// Like `set_bus_stop`, at a container stop.
    set_container_stop "setContainerStop" 0x12
        {stop: &str, duration: f64, until: f64}
        => &Stop::at(stop, duration, until, Stop::CONTAINER_STOP);
    /// Like `set_bus_stop`, at a charging station.
    set_charging_station_stop "setChargingStationStop" 0x12
        {stop: &str, duration: f64, until: f64}
        => &Stop::at(stop, duration, until, Stop::CHARGING_STATION);
    /// Like `set_bus_stop`, at a parking area.
    set_parking_area_stop "setParkingAreaStop" 0x12
        {area: &str, duration: f64, until: f64}
        => &Stop::at(area, duration, until, Stop::PARKING_AREA | Stop::PARKING);
    /// Replaces a stop ahead and adapts the route between the stops before and after it.
    replace_stop "replaceStop" 0x17 (change: &StopChange<'_>);
    /// Inserts a stop before the stop at the index and adapts the route. SUMO 1.15 may crash if
    /// this call or [`Vehicle::replace_stop`] follows for the same vehicle.
    insert_stop "insertStop" 0x18 (change: &StopChange<'_>);
    /// Changes lanes to the left by `offset` (negative: to the right), and keeps the vehicle there
    /// for a duration \[s\].
    change_lane_relative "changeLaneRelative" 0x13
        {offset: i8, duration: f64} => (offset, duration, 1_i8);
    /// Opens a gap to the leader.
    open_gap "openGap" 0x16 (gap: &Gap<'_>);
    /// Ends the control of a gap that was opened.
    deactivate_gap_control "deactivateGapControl" 0x16 {} => &Gap::OFF;
    /// Draws a circle around the vehicle in the graphical interface.
    highlight "highlight" 0x6c (highlight: &Highlight);
    /// Moves the centre of the front bumper to a position \[m\], after the movement of the next
    /// step.
    move_to_xy "moveToXY" 0xb4 {position: [f64; 2], placement: &Placement<'_>} => {
        let Placement { edge, lane, angle, keep_route, match_threshold } = *placement;
        let [x, y] = position;
        (edge, lane, x, y, angle, keep_route.cast_signed(), match_threshold)
    };
}

impl<S: Scope> Vehicle<'_, S> {
    /// Requests that the driver take over from the automation within a time \[s\].
    pub fn request_toc(&mut self, id: &str, lead_time: f64) -> S::Output<()> {
        self.set_parameter(id, "device.toc.requestToC", &lead_time.to_string())
    }
}
