//! Multi-entry multi-exit detectors (E3 detectors).

domain! {
    /// Calls for multi-entry multi-exit detectors (E3 detectors).
    MultiEntryExit, "multientryexit", MULTI_ENTRY_EXIT
}
identifiers! { MultiEntryExit, "multientryexit" }

getters! { MultiEntryExit, "multientryexit";
    /// Lanes of the entries.
    get_entry_lanes "getEntryLanes" VAR_LANES 0x30 -> Vec<String>;
    /// Lanes of the exits.
    get_exit_lanes "getExitLanes" VAR_EXIT_LANES 0x31 -> Vec<String>;
    /// Distances of the entries from the starts of their lanes \[m\].
    get_entry_positions "getEntryPositions" VAR_POSITION 0x42 -> Vec<f64>;
    /// Distances of the exits from the starts of their lanes \[m\].
    get_exit_positions "getExitPositions" VAR_EXIT_POSITIONS 0x43 -> Vec<f64>;
    /// Number of vehicles between entry and exit within the last step.
    get_last_step_vehicle_number "getLastStepVehicleNumber" LAST_STEP_VEHICLE_NUMBER 0x10 -> i32;
    /// Mean speed of these vehicles \[m/s\]; -1 without one.
    get_last_step_mean_speed "getLastStepMeanSpeed" LAST_STEP_MEAN_SPEED 0x11 -> f64;
    /// Vehicles between entry and exit within the last step.
    get_last_step_vehicle_ids "getLastStepVehicleIDs" LAST_STEP_VEHICLE_ID_LIST 0x12 -> Vec<String>;
    /// Number of these vehicles that were halted.
    get_last_step_halting_number "getLastStepHaltingNumber" LAST_STEP_VEHICLE_HALTING_NUMBER 0x14 -> i32;
    /// Mean travel time of the vehicles that passed in the last interval \[s\].
    get_last_interval_mean_travel_time "getLastIntervalMeanTravelTime" VAR_LAST_INTERVAL_TRAVELTIME 0x58 -> f64;
    /// Mean number of halts of the vehicles that passed in the last interval.
    get_last_interval_mean_halts_per_vehicle "getLastIntervalMeanHaltsPerVehicle" VAR_LAST_INTERVAL_MEAN_HALTING_NUMBER 0x20 -> f64;
    /// Mean time loss of the vehicles that passed in the last interval \[s\].
    get_last_interval_mean_time_loss "getLastIntervalMeanTimeLoss" VAR_TIMELOSS 0x8c -> f64;
    /// Number of vehicles that passed in the last interval.
    get_last_interval_vehicle_sum "getLastIntervalVehicleSum" VAR_LAST_INTERVAL_VEHICLE_NUMBER 0x21 -> i32;
}
