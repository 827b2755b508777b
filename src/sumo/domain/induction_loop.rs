//! Induction loops (E1 detectors).

domain! {
    /// Calls for induction loops (E1 detectors).
    InductionLoop, "inductionloop", INDUCTION_LOOP
}
identifiers! { InductionLoop, "inductionloop" }

record! {
    /// A vehicle that was on the loop within the last step.
    VehicleData {
        /// Vehicle identifier.
        id: String,
        /// Length \[m\].
        length: f64,
        /// Time at which the vehicle's front reached the loop \[s\].
        entry_time: f64,
        /// Time at which the vehicle's rear left the loop \[s\]; -1: the vehicle is still on the
        /// loop.
        leave_time: f64,
        /// Vehicle type identifier.
        type_id: String,
    }
}
flat_list! { VehicleData }

getters! { InductionLoop, "inductionloop";
    /// Distance from the start of the lane \[m\].
    get_position "getPosition" VAR_POSITION 0x42 -> f64;
    /// The lane of the loop.
    get_lane_id "getLaneID" VAR_LANE_ID 0x51 -> String;
    /// Number of vehicles within the last step.
    get_last_step_vehicle_number "getLastStepVehicleNumber" LAST_STEP_VEHICLE_NUMBER 0x10 -> i32;
    /// Mean speed of the vehicles within the last step \[m/s\]; -1: no vehicle was on the loop.
    get_last_step_mean_speed "getLastStepMeanSpeed" LAST_STEP_MEAN_SPEED 0x11 -> f64;
    /// Vehicles within the last step.
    get_last_step_vehicle_ids "getLastStepVehicleIDs" LAST_STEP_VEHICLE_ID_LIST 0x12 -> Vec<String>;
    /// Fraction of the last step in which a vehicle was on the loop \[%\].
    get_last_step_occupancy "getLastStepOccupancy" LAST_STEP_OCCUPANCY 0x13 -> f64;
    /// Mean length of the vehicles within the last step \[m\].
    get_last_step_mean_length "getLastStepMeanLength" LAST_STEP_LENGTH 0x15 -> f64;
    /// Time since a vehicle was last on the loop \[s\].
    get_time_since_detection "getTimeSinceDetection" LAST_STEP_TIME_SINCE_DETECTION 0x16 -> f64;
    /// Data of the vehicles that were on the loop within the last step.
    get_vehicle_data "getVehicleData" LAST_STEP_VEHICLE_DATA 0x17 -> Vec<VehicleData>;
}

setters! { InductionLoop, "inductionloop";
    /// Overrides the reported time since the last detection \[s\]; a negative time ends the
    /// override.
    override_time_since_detection "overrideTimeSinceDetection" 0x22 (time: f64);
}
