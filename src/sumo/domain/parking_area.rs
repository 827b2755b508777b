//! Parking areas.

domain! {
    /// Calls for parking areas.
    ParkingArea, "parkingarea", PARKING_AREA
}
identifiers! { ParkingArea, "parkingarea" }

getters! { ParkingArea, "parkingarea";
    /// The lane beside which the parking area lies.
    get_lane_id "getLaneID" VAR_LANE_ID 0x51 -> String;
    /// Distance of the parking area's start from the start of the lane \[m\].
    get_start_pos "getStartPos" VAR_POSITION 0x42 -> f64;
    /// Distance of the parking area's end from the start of the lane \[m\].
    get_end_pos "getEndPos" VAR_LANEPOSITION 0x56 -> f64;
    /// Name.
    get_name "getName" VAR_NAME 0x1b -> String;
    /// Number of parked vehicles.
    get_vehicle_count "getVehicleCount" VAR_STOP_STARTING_VEHICLES_NUMBER 0x68 -> i32;
    /// Parked vehicles.
    get_vehicle_ids "getVehicleIDs" VAR_STOP_STARTING_VEHICLES_IDS 0x69 -> Vec<String>;
}
