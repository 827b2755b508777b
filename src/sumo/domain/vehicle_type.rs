//! Vehicle types.

use super::{Color, Scope};
use crate::sumo::{batch::Call, constants::Domain};

domain! {
    /// Calls for vehicle types.
    VehicleType, "vehicletype", VEHICLE_TYPE
}
identifiers! { VehicleType, "vehicletype", VEHICLE_TYPE }
type_attributes! { VehicleType, "vehicletype", VEHICLE_TYPE }

getters! { VehicleType, "vehicletype", VEHICLE_TYPE;
    /// Factor on the number of vehicles of the type.
    get_scale "getScale" VAR_SCALE 0x8e -> f64;
}

setters! { VehicleType, "vehicletype", VEHICLE_TYPE;
    /// Sets the standard deviation of the speed factor.
    set_speed_deviation "setSpeedDeviation" 0x5f (deviation: f64);
    /// Sets the factor on the number of vehicles of the type.
    set_scale "setScale" 0x8e (scale: f64);
    /// Creates a copy of this type under a new identifier (`DEFAULT_VEHTYPE` always exists).
    copy "copy" 0x88 (new: &str);
}
