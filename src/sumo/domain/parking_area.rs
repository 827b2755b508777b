//! Parking areas.

domain! {
    /// Calls for parking areas.
    ParkingArea, "parkingarea", PARKING_AREA
}
identifiers! { ParkingArea, "parkingarea" }
stopping_place! { ParkingArea, "parkingarea" }
