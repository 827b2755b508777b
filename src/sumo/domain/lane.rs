//! Lanes.

domain! {
    /// Calls for lanes.
    Lane, "lane", LANE
}
identifiers! { Lane, "lane" }
emissions! { Lane, "lane" }

record! {
    /// A connection across a junction, from one lane to another.
    Connection {
        /// The lane where the connection ends.
        approached_lane: String,
        /// The lane inside the junction; empty for none.
        approached_internal: String,
        /// Whether the connection has priority.
        has_prio: bool,
        /// Whether a vehicle can pass the connection now.
        is_open: bool,
        /// Whether a vehicle with priority approaches.
        has_foe: bool,
        /// State of the signal as a letter, such as `G`.
        state: String,
        /// Direction as a letter: `s`traight, `l`eft, `r`ight, `t`urn…
        direction: String,
        /// Length inside the junction \[m\].
        length: f64,
    }
}
flat_list! { Connection }

getters! { Lane, "lane";
    /// Length \[m\].
    get_length "getLength" VAR_LENGTH 0x44 -> f64;
    /// Speed limit \[m/s\].
    get_max_speed "getMaxSpeed" VAR_MAXSPEED 0x41 -> f64;
    /// Friction, 0 to 1.
    get_friction "getFriction" VAR_FRICTION 0x3d -> f64;
    /// Width \[m\].
    get_width "getWidth" VAR_WIDTH 0x4d -> f64;
    /// Vehicle classes that may use the lane; an empty list: all.
    get_allowed "getAllowed" LANE_ALLOWED 0x34 -> Vec<String>;
    /// Vehicle classes that may not use the lane.
    get_disallowed "getDisallowed" LANE_DISALLOWED 0x35 -> Vec<String>;
    /// Number of connections that start at the lane.
    get_link_number "getLinkNumber" LANE_LINK_NUMBER 0x30 -> i32;
    /// Connections that start at the lane.
    get_links "getLinks" LANE_LINKS 0x33 -> Vec<Connection>;
    /// Centre line \[m\].
    get_shape "getShape" VAR_SHAPE 0x4e -> Vec<[f64; 2]>;
    /// The edge that the lane is part of.
    get_edge_id "getEdgeID" LANE_EDGE_ID 0x31 -> String;
    /// Mean speed within the last step \[m/s\].
    get_last_step_mean_speed "getLastStepMeanSpeed" LAST_STEP_MEAN_SPEED 0x11 -> f64;
    /// Fraction of the length that vehicles covered within the last step, 0 to 1.
    get_last_step_occupancy "getLastStepOccupancy" LAST_STEP_OCCUPANCY 0x13 -> f64;
    /// Mean length of the vehicles within the last step \[m\].
    get_last_step_length "getLastStepLength" LAST_STEP_LENGTH 0x15 -> f64;
    /// Sum of the waiting times of the vehicles \[s\].
    get_waiting_time "getWaitingTime" VAR_WAITING_TIME 0x7a -> f64;
    /// Travel time estimated from the mean speed of the last step \[s\].
    get_traveltime "getTraveltime" VAR_CURRENT_TRAVELTIME 0x5a -> f64;
    /// Number of vehicles within the last step.
    get_last_step_vehicle_number "getLastStepVehicleNumber" LAST_STEP_VEHICLE_NUMBER 0x10 -> i32;
    /// Number of vehicles that were halted within the last step.
    get_last_step_halting_number "getLastStepHaltingNumber" LAST_STEP_VEHICLE_HALTING_NUMBER 0x14 -> i32;
    /// Vehicles within the last step.
    get_last_step_vehicle_ids "getLastStepVehicleIDs" LAST_STEP_VEHICLE_ID_LIST 0x12 -> Vec<String>;
    /// Lanes whose vehicles have priority over the vehicles that drive from this lane to the lane
    /// `to`.
    get_foes "getFoes" 0x37 (to: &str) -> Vec<String>;
    /// The internal lanes that cross this one, which must be an internal lane too.
    get_internal_foes "getInternalFoes" 0x37 {} -> Vec<String> => "";
    /// Vehicles that wait to depart on this lane.
    get_pending_vehicles "getPendingVehicles" VAR_PENDING_VEHICLES 0x94 -> Vec<String>;
}

setters! { Lane, "lane";
    /// Sets the vehicle classes that may use the lane.
    set_allowed "setAllowed" 0x34 (classes: &[impl AsRef<str>]);
    /// Sets the vehicle classes that may not use the lane.
    set_disallowed "setDisallowed" 0x35 (classes: &[impl AsRef<str>]);
    /// Sets the speed limit \[m/s\].
    set_max_speed "setMaxSpeed" 0x41 (speed: f64);
    /// Sets the friction, 0 to 1. SUMO 1.15 and 1.28 refuse this call.
    set_friction "setFriction" 0x3d (friction: f64);
    /// Sets the length \[m\].
    set_length "setLength" 0x44 (length: f64);
}
