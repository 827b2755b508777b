//! Bus stops.

domain! {
    /// Calls for bus stops.
    BusStop, "busstop", BUS_STOP
}
identifiers! { BusStop, "busstop" }
stopping_place! { BusStop, "busstop" }

getters! { BusStop, "busstop";
    /// Number of persons who wait there.
    get_person_count "getPersonCount" VAR_BUS_STOP_WAITING 0x67 -> i32;
    /// Persons who wait there.
    get_person_ids "getPersonIDs" VAR_BUS_STOP_WAITING_IDS 0xef -> Vec<String>;
}
