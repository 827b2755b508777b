//! Lane area detectors (E2 detectors).

domain! {
    /// Calls for lane area detectors (E2 detectors).
    LaneArea, "lanearea", LANE_AREA
}
identifiers! { LaneArea, "lanearea" }

getters! { LaneArea, "lanearea";
    /// Number of vehicles in the jam.
    get_jam_length_vehicle "getJamLengthVehicle" JAM_LENGTH_VEHICLE 0x18 -> i32;
    /// Length of the jam \[m\].
    get_jam_length_meters "getJamLengthMeters" JAM_LENGTH_METERS 0x19 -> f64;
    /// Mean speed of the vehicles within the last step \[m/s\]; -1: no vehicle was on the detector.
    get_last_step_mean_speed "getLastStepMeanSpeed" LAST_STEP_MEAN_SPEED 0x11 -> f64;
    /// Vehicles within the last step.
    get_last_step_vehicle_ids "getLastStepVehicleIDs" LAST_STEP_VEHICLE_ID_LIST 0x12 -> Vec<String>;
    /// Fraction of the length that vehicles covered within the last step \[%\].
    get_last_step_occupancy "getLastStepOccupancy" LAST_STEP_OCCUPANCY 0x13 -> f64;
    /// Distance of the detector's start from the start of the lane \[m\].
    get_position "getPosition" VAR_POSITION 0x42 -> f64;
    /// The lane of the detector.
    get_lane_id "getLaneID" VAR_LANE_ID 0x51 -> String;
    /// Length \[m\].
    get_length "getLength" VAR_LENGTH 0x44 -> f64;
    /// Number of vehicles within the last step.
    get_last_step_vehicle_number "getLastStepVehicleNumber" LAST_STEP_VEHICLE_NUMBER 0x10 -> i32;
    /// Number of vehicles that were halted within the last step.
    get_last_step_halting_number "getLastStepHaltingNumber" LAST_STEP_VEHICLE_HALTING_NUMBER 0x14 -> i32;
}

setters! { LaneArea, "lanearea";
    /// Overrides the reported number of vehicles; a negative number ends the override.
    override_vehicle_number "overrideVehicleNumber" 0x22 (vehicles: i32);
}
