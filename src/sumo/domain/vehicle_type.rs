//! Vehicle types.

use super::Color;

domain! {
    /// Calls for vehicle types.
    VehicleType, "vehicletype", VEHICLE_TYPE
}
identifiers! { VehicleType, "vehicletype" }
type_attributes! { VehicleType, "vehicletype" }

getters! { VehicleType, "vehicletype";
    /// Factor on the number of vehicles of the type.
    get_scale "getScale" VAR_SCALE 0x8e -> f64;
}

setters! { VehicleType, "vehicletype";
    /// Sets the standard deviation of the speed factor.
    set_speed_deviation "setSpeedDeviation" 0x5f (deviation: f64);
    /// Sets the factor on the number of vehicles of the type.
    set_scale "setScale" 0x8e (scale: f64);
    /// Creates a copy of this type under a new identifier (`DEFAULT_VEHTYPE` always exists).
    copy "copy" 0x88 (new: &str);
}
