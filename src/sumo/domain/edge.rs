//! Edges.

domain! {
    /// Calls for edges.
    Edge, "edge", EDGE
}
identifiers! { Edge, "edge" }
emissions! { Edge, "edge" }

getters! { Edge, "edge";
    /// Travel time that routing assumes at a simulation time \[s\]; -1: none was set.
    get_adapted_traveltime "getAdaptedTraveltime" 0x58 (time: f64) -> f64;
    /// Sum of the waiting times of the vehicles \[s\].
    get_waiting_time "getWaitingTime" VAR_WAITING_TIME 0x7a -> f64;
    /// Effort that routing assumes at a simulation time \[s\]; -1: none was set.
    get_effort "getEffort" 0x59 (time: f64) -> f64;
    /// Mean speed within the last step \[m/s\].
    get_last_step_mean_speed "getLastStepMeanSpeed" LAST_STEP_MEAN_SPEED 0x11 -> f64;
    /// Mean friction of the lanes, 0 to 1.
    get_mean_friction "getMeanFriction" VAR_FRICTION 0x3d -> f64;
    /// Fraction of the length that vehicles covered within the last step, 0 to 1.
    get_last_step_occupancy "getLastStepOccupancy" LAST_STEP_OCCUPANCY 0x13 -> f64;
    /// Mean length of the vehicles within the last step \[m\].
    get_last_step_length "getLastStepLength" LAST_STEP_LENGTH 0x15 -> f64;
    /// Number of lanes.
    get_lane_number "getLaneNumber" VAR_LANE_INDEX 0x52 -> i32;
    /// Name of the street.
    get_street_name "getStreetName" VAR_NAME 0x1b -> String;
    /// Travel time estimated from the mean speed of the last step \[s\].
    get_traveltime "getTraveltime" VAR_CURRENT_TRAVELTIME 0x5a -> f64;
    /// Number of vehicles within the last step.
    get_last_step_vehicle_number "getLastStepVehicleNumber" LAST_STEP_VEHICLE_NUMBER 0x10 -> i32;
    /// Number of vehicles that were halted within the last step.
    get_last_step_halting_number "getLastStepHaltingNumber" LAST_STEP_VEHICLE_HALTING_NUMBER 0x14 -> i32;
    /// Vehicles within the last step.
    get_last_step_vehicle_ids "getLastStepVehicleIDs" LAST_STEP_VEHICLE_ID_LIST 0x12 -> Vec<String>;
    /// Persons within the last step.
    get_last_step_person_ids "getLastStepPersonIDs" LAST_STEP_PERSON_ID_LIST 0x1a -> Vec<String>;
    /// Vehicles that wait to depart on this edge.
    get_pending_vehicles "getPendingVehicles" VAR_PENDING_VEHICLES 0x94 -> Vec<String>;
}

setters! { Edge, "edge";
    /// Sets the travel time that routing assumes \[s\].
    adapt_traveltime "adaptTraveltime" 0x58 [time: f64];
    /// Like `adapt_traveltime`, from the simulation time `begin` to `end` \[s\].
    adapt_traveltime_during "adaptTraveltime" 0x58 [begin: f64, end: f64, time: f64];
    /// Sets the effort that routing assumes.
    set_effort "setEffort" 0x59 [effort: f64];
    /// Like `set_effort`, from the simulation time `begin` to `end` \[s\].
    set_effort_during "setEffort" 0x59 [begin: f64, end: f64, effort: f64];
    /// Sets the vehicle classes that may use the lanes. SUMO 1.15 refuses this call; use the call
    /// for lanes.
    set_allowed "setAllowed" 0x34 (classes: &[impl AsRef<str>]);
    /// Sets the vehicle classes that may not use the lanes. SUMO 1.15 refuses this call; use the
    /// call for lanes.
    set_disallowed "setDisallowed" 0x35 (classes: &[impl AsRef<str>]);
    /// Sets the speed limit of the lanes \[m/s\].
    set_max_speed "setMaxSpeed" 0x41 (speed: f64);
    /// Sets the friction of the lanes, 0 to 1. SUMO 1.15 refuses this call.
    set_friction "setFriction" 0x3d (friction: f64);
}
