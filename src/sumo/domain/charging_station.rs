//! Charging stations.

domain! {
    /// Calls for charging stations.
    ChargingStation, "chargingstation", CHARGING_STATION
}
identifiers! { ChargingStation, "chargingstation" }
stopping_place! { ChargingStation, "chargingstation" }
