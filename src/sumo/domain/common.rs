//! Tables of calls that several kinds of objects have.

/// Defines the calls that list the objects of a domain.
macro_rules! identifiers {
    ($handle:ident, $name:literal) => {
        global_getters! { $handle, $name;
            /// Identifiers of all objects.
            get_id_list "getIDList" TRACI_ID_LIST 0x00 -> Vec<String>;
            /// Number of objects.
            get_id_count "getIDCount" ID_COUNT 0x01 -> i32;
        }
    };
}

/// Defines the calls that vehicles, persons and vehicle types have in common.
macro_rules! type_attributes {
    ($handle:ident, $name:literal) => {
        getters! { $handle, $name;
            /// Length \[m\].
            get_length "getLength" VAR_LENGTH 0x44 -> f64;
            /// Highest speed \[m/s\].
            get_max_speed "getMaxSpeed" VAR_MAXSPEED 0x41 -> f64;
            /// Time between two decisions of the driver model \[s\].
            get_action_step_length "getActionStepLength" VAR_ACTIONSTEPLENGTH 0x7d -> f64;
            /// Factor on the speed limit.
            get_speed_factor "getSpeedFactor" VAR_SPEED_FACTOR 0x5e -> f64;
            /// Standard deviation of the speed factor.
            get_speed_deviation "getSpeedDeviation" VAR_SPEED_DEVIATION 0x5f -> f64;
            /// Greatest acceleration \[m/s²\].
            get_accel "getAccel" VAR_ACCEL 0x46 -> f64;
            /// Comfortable deceleration \[m/s²\].
            get_decel "getDecel" VAR_DECEL 0x47 -> f64;
            /// Strongest deceleration \[m/s²\].
            get_emergency_decel "getEmergencyDecel" VAR_EMERGENCY_DECEL 0x7b -> f64;
            /// Deceleration that other drivers expect of this vehicle \[m/s²\].
            get_apparent_decel "getApparentDecel" VAR_APPARENT_DECEL 0x7c -> f64;
            /// Imperfection of the driver (sigma), 0 to 1.
            get_imperfection "getImperfection" VAR_IMPERFECTION 0x5d -> f64;
            /// Desired time headway \[s\].
            get_tau "getTau" VAR_TAU 0x48 -> f64;
            /// Vehicle class, such as `passenger`.
            get_vehicle_class "getVehicleClass" VAR_VEHICLECLASS 0x49 -> String;
            /// Emission class, such as `HBEFA3/PC_G_EU4`.
            get_emission_class "getEmissionClass" VAR_EMISSIONCLASS 0x4a -> String;
            /// Shape in the graphical interface.
            get_shape_class "getShapeClass" VAR_SHAPECLASS 0x4b -> String;
            /// Gap to the leader when standing \[m\].
            get_min_gap "getMinGap" VAR_MINGAP 0x4c -> f64;
            /// Width \[m\].
            get_width "getWidth" VAR_WIDTH 0x4d -> f64;
            /// Height \[m\].
            get_height "getHeight" VAR_HEIGHT 0xbc -> f64;
            /// Colour.
            get_color "getColor" VAR_COLOR 0x45 -> Color;
            /// Lateral gap at 50 km/h \[m\].
            get_min_gap_lat "getMinGapLat" VAR_MINGAP_LAT 0xbb -> f64;
            /// Highest lateral speed \[m/s\].
            get_max_speed_lat "getMaxSpeedLat" VAR_MAXSPEED_LAT 0xba -> f64;
            /// Preferred lateral position in the lane, such as `center`.
            get_lateral_alignment "getLateralAlignment" VAR_LATALIGNMENT 0xb9 -> String;
            /// Number of persons that the vehicle can carry.
            get_person_capacity "getPersonCapacity" VAR_PERSON_CAPACITY 0x38 -> i32;
        }

        setters! { $handle, $name;
            /// Sets the length \[m\].
            set_length "setLength" 0x44 (length: f64);
            /// Sets the highest speed \[m/s\].
            set_max_speed "setMaxSpeed" 0x41 (speed: f64);
            /// Sets the vehicle class.
            set_vehicle_class "setVehicleClass" 0x49 (class: &str);
            /// Sets the factor on the speed limit.
            set_speed_factor "setSpeedFactor" 0x5e (factor: f64);
            /// Sets the emission class.
            set_emission_class "setEmissionClass" 0x4a (class: &str);
            /// Sets the shape in the graphical interface.
            set_shape_class "setShapeClass" 0x4b (class: &str);
            /// Sets the width \[m\].
            set_width "setWidth" 0x4d (width: f64);
            /// Sets the height \[m\].
            set_height "setHeight" 0xbc (height: f64);
            /// Sets the gap to the leader when standing \[m\].
            set_min_gap "setMinGap" 0x4c (gap: f64);
            /// Sets the greatest acceleration \[m/s²\].
            set_accel "setAccel" 0x46 (accel: f64);
            /// Sets the comfortable deceleration \[m/s²\].
            set_decel "setDecel" 0x47 (decel: f64);
            /// Sets the strongest deceleration \[m/s²\].
            set_emergency_decel "setEmergencyDecel" 0x7b (decel: f64);
            /// Sets the deceleration that other drivers expect of this vehicle \[m/s²\].
            set_apparent_decel "setApparentDecel" 0x7c (decel: f64);
            /// Sets the imperfection of the driver (sigma), 0 to 1.
            set_imperfection "setImperfection" 0x5d (sigma: f64);
            /// Sets the desired time headway \[s\].
            set_tau "setTau" 0x48 (tau: f64);
            /// Sets the colour.
            set_color "setColor" 0x45 (color: Color);
            /// Sets the lateral gap at 50 km/h \[m\].
            set_min_gap_lat "setMinGapLat" 0xbb (gap: f64);
            /// Sets the highest lateral speed \[m/s\].
            set_max_speed_lat "setMaxSpeedLat" 0xba (speed: f64);
            /// Sets the preferred lateral position in the lane.
            set_lateral_alignment "setLateralAlignment" 0xb9 (alignment: &str);
            /// Sets the time between two decisions of the driver model \[s\]. With `reset_offset`,
            /// the next decision is at the next step; without it, the next decision is one new
            /// length after the last one, or at the next step if that time has passed.
            set_action_step_length "setActionStepLength" 0x7d
                {length: f64, reset_offset: bool} => if reset_offset { length } else { -length };
        }
    };
}

/// Defines the calls that read emissions and consumption within the last step.
macro_rules! emissions {
    ($handle:ident, $name:literal) => {
        getters! { $handle, $name;
            /// CO2 emission within the last step \[mg/s\].
            get_co2_emission "getCO2Emission" VAR_CO2EMISSION 0x60 -> f64;
            /// CO emission within the last step \[mg/s\].
            get_co_emission "getCOEmission" VAR_COEMISSION 0x61 -> f64;
            /// HC emission within the last step \[mg/s\].
            get_hc_emission "getHCEmission" VAR_HCEMISSION 0x62 -> f64;
            /// Particle emission within the last step \[mg/s\].
            get_pmx_emission "getPMxEmission" VAR_PMXEMISSION 0x63 -> f64;
            /// NOx emission within the last step \[mg/s\].
            get_nox_emission "getNOxEmission" VAR_NOXEMISSION 0x64 -> f64;
            /// Fuel consumption within the last step \[mg/s\].
            get_fuel_consumption "getFuelConsumption" VAR_FUELCONSUMPTION 0x65 -> f64;
            /// Noise within the last step \[dBA\].
            get_noise_emission "getNoiseEmission" VAR_NOISEEMISSION 0x66 -> f64;
            /// Electricity consumption within the last step \[Wh/s\].
            get_electricity_consumption "getElectricityConsumption" VAR_ELECTRICITYCONSUMPTION 0x71 -> f64;
        }
    };
}

/// Defines the calls that read a place beside a lane where vehicles stop.
macro_rules! stopping_place {
    ($handle:ident, $name:literal) => {
        getters! { $handle, $name;
            /// The lane beside which the place lies.
            get_lane_id "getLaneID" VAR_LANE_ID 0x51 -> String;
            /// Distance of the place's start from the start of the lane \[m\].
            get_start_pos "getStartPos" VAR_POSITION 0x42 -> f64;
            /// Distance of the place's end from the start of the lane \[m\].
            get_end_pos "getEndPos" VAR_LANEPOSITION 0x56 -> f64;
            /// Name.
            get_name "getName" VAR_NAME 0x1b -> String;
            /// Number of vehicles that are stopped there.
            get_vehicle_count "getVehicleCount" VAR_STOP_STARTING_VEHICLES_NUMBER 0x68 -> i32;
            /// Vehicles that are stopped there.
            get_vehicle_ids "getVehicleIDs" VAR_STOP_STARTING_VEHICLES_IDS 0x69 -> Vec<String>;
        }
    };
}
