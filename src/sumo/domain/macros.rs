//! Macros for the tables of calls. A row of [`getters`] defines a method and, if the row names one,
//! a constant for subscriptions; a row of [`setters`] defines a method. The columns are:
//! documentation, name, SUMO's name, constant, number, arguments, type.
//!
//! Arguments in parentheses are one typed value; arguments in brackets are the items of a compound.
//! Arguments in braces are written as the value after `=>`, an
//! [`Argument`](super::Argument): a tuple is a compound.
//!
//! SUMO 1.15 crashes on a subscription to a variable that needs an argument, except to those
//! variables that have a constant here: SUMO accepts their argument in the subscription.

/// Defines a handle with the calls that all domains have.
macro_rules! domain {
    ($(#[$doc:meta])* $handle:ident, $name:literal, $domain:ident) => {
        $(#[$doc])*
        #[derive(Debug)]
        pub struct $handle<'a, S>(pub(super) &'a mut S);

        const DOMAIN: crate::sumo::Domain = crate::sumo::Domain::$domain;

        getters! { $handle, $name;
            /// A generic parameter of the object; empty if the object has no parameter of that
            /// name.
            get_parameter "getParameter" VAR_PARAMETER 0x7e (key: &str) -> String;
            /// Like `get_parameter`, together with the name of the parameter.
            get_parameter_with_key "getParameterWithKey" VAR_PARAMETER_WITH_KEY 0x3e (key: &str) -> (String, String);
        }

        setters! { $handle, $name;
            /// Sets a generic parameter of the object.
            set_parameter "setParameter" 0x7e [key: &str, value: &str];
        }

        impl<S: crate::sumo::domain::Scope> $handle<'_, S> {
            /// Subscribes to variables of the object: SUMO reports them now and after each later
            /// step, in addition to the variables of earlier subscriptions. Call
            /// [`unsubscribe`](Self::unsubscribe) first to replace those. In a batch,
            /// `Replies::first` has the current values; a client's call drops them.
            ///
            /// # Errors
            /// Besides the errors of all calls, `Error::Invalid` for a variable of another domain
            /// and for more than 255 variables; nothing is sent then.
            pub fn subscribe(
                &mut self,
                id: &str,
                variables: &[crate::sumo::domain::VariableId],
            ) -> S::Output<()> {
                let fill = |batch: &mut crate::sumo::Batch| batch.subscribe(DOMAIN, id, variables);
                self.0.request(fill, crate::sumo::domain::done)
            }

            /// Like `subscribe`, from the simulation time `begin` to `end` \[s\]. Subscriptions
            /// with different times exist side by side, and SUMO reports each.
            ///
            /// # Errors
            /// As for `subscribe`.
            pub fn subscribe_during(
                &mut self,
                id: &str,
                variables: &[crate::sumo::domain::VariableId],
                begin: f64,
                end: f64,
            ) -> S::Output<()> {
                let fill = |batch: &mut crate::sumo::Batch| {
                    batch.subscribe_during(DOMAIN, id, variables, [begin, end]);
                };
                self.0.request(fill, crate::sumo::domain::done)
            }

            /// Like `subscribe`, for one variable that needs an argument.
            ///
            /// # Errors
            /// As for `subscribe`.
            pub fn subscribe_with<A: crate::sumo::domain::SubscriptionArgument, T>(
                &mut self,
                id: &str,
                variable: crate::sumo::domain::VariableWith<A, T>,
                argument: A::Given<'_>,
            ) -> S::Output<()> {
                let fill = |batch: &mut crate::sumo::Batch| {
                    batch.subscribe_with(DOMAIN, id, variable, argument);
                };
                self.0.request(fill, crate::sumo::domain::done)
            }

            /// Like `subscribe`, for a generic parameter, which is reported as
            /// `VAR_PARAMETER_WITH_KEY`. With several keys, `Reports::get` returns the last one;
            /// `Reports::subscriptions` holds all.
            pub fn subscribe_parameter_with_key(&mut self, id: &str, key: &str) -> S::Output<()> {
                self.subscribe_with(id, VAR_PARAMETER_WITH_KEY, key)
            }

            /// Ends all subscriptions to variables of the object.
            pub fn unsubscribe(&mut self, id: &str) -> S::Output<()> {
                self.subscribe(id, &[])
            }

            /// Subscribes to variables of the objects of the domain `around` within `range` \[m\]
            /// of this object: SUMO reports them now and after each later step. If the range is
            /// that of an earlier subscription, the variables are added to it. If the range
            /// differs, both subscriptions exist, and the reports hold the values of the last one.
            ///
            /// SUMO 1.15 crashes if this object does not exist. A client therefore reads the object
            /// first, in an exchange of its own; in a batch, name only objects that exist when SUMO
            /// reaches the command. SUMO also crashes if a call removes this object while the
            /// subscription lasts: end the subscription first.
            ///
            /// # Errors
            /// Besides the errors of all calls, `Error::Invalid` if the domain `around` has no
            /// objects with a position (traffic lights, routes, vehicle types and others), for a
            /// variable of another domain than `around`, and for more than 255 variables; nothing
            /// is sent then.
            pub fn subscribe_context(
                &mut self,
                id: &str,
                around: crate::sumo::Domain,
                range: f64,
                variables: &[crate::sumo::domain::VariableId],
            ) -> S::Output<()> {
                let fill = |batch: &mut crate::sumo::Batch| {
                    batch.subscribe_context(DOMAIN, id, around, range, variables);
                };
                self.0.request_for(DOMAIN, id, fill, crate::sumo::domain::done)
            }

            /// Ends all subscriptions, of any range, to objects of the domain `around` near this
            /// object.
            pub fn unsubscribe_context(
                &mut self,
                id: &str,
                around: crate::sumo::Domain,
            ) -> S::Output<()> {
                let fill = |batch: &mut crate::sumo::Batch| {
                    batch.subscribe_context(DOMAIN, id, around, 0.0, &[]);
                };
                self.0.request(fill, crate::sumo::domain::done)
            }
        }
    };
}

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

/// Defines calls that read a variable of an object.
macro_rules! getters {
    ($handle:ident, $name:literal; $(
        $(#[$doc:meta])*
        $method:ident $sumo:literal $($constant:ident)? $id:literal
        $(($argument:ident: $kind:ty))? $([$($item:ident: $item_kind:ty),+])?
        $({$($given:ident: $given_kind:ty),*})? -> $result:ty $(=> $value:expr)?;
    )+) => {
        $(
            variable! { [$(#[$doc])*] [$($constant)?] [$($kind)?] $id $result }
        )+

        impl<S: crate::sumo::domain::Scope> $handle<'_, S> {
            $(
                $(#[$doc])*
                pub fn $method(
                    &mut self,
                    id: &str,
                    $($argument: $kind,)? $($($item: $item_kind),+)? $($($given: $given_kind),*)?
                ) -> S::Output<$result> {
                    let name = concat!($name, ".", $sumo);
                    let call = crate::sumo::batch::Call::get(name, DOMAIN, $id);
                    crate::sumo::domain::get(
                        self.0,
                        call,
                        id,
                        arguments!($(($argument))? $([$($item)+])? $({$value})?),
                    )
                }
            )+
        }
    };
}

/// Defines the constant of a variable: none, one without an argument, or one with an argument.
macro_rules! variable {
    ([$($doc:tt)*] [] [$($kind:ty)?] $id:literal $result:ty) => {};
    ([$($doc:tt)*] [$constant:ident] [] $id:literal $result:ty) => {
        $($doc)*
        pub const $constant: crate::sumo::domain::Variable<$result> =
            crate::sumo::domain::Variable::new(DOMAIN, $id);
    };
    ([$($doc:tt)*] [$constant:ident] [$kind:ty] $id:literal $result:ty) => {
        $($doc)*
        pub const $constant: crate::sumo::domain::VariableWith<$kind, $result> =
            crate::sumo::domain::VariableWith::new(DOMAIN, $id);
    };
}

/// Defines calls that read a variable of the domain as a whole.
macro_rules! global_getters {
    ($handle:ident, $name:literal; $(
        $(#[$doc:meta])* $method:ident $sumo:literal $($constant:ident)? $id:literal
        $({$($given:ident: $given_kind:ty),*})? -> $result:ty $(=> $value:expr)?;
    )+) => {
        $(
            variable! { [$(#[$doc])*] [$($constant)?] [] $id $result }
        )+

        impl<S: crate::sumo::domain::Scope> $handle<'_, S> {
            $(
                $(#[$doc])*
                pub fn $method(&mut self, $($($given: $given_kind),*)?) -> S::Output<$result> {
                    let name = concat!($name, ".", $sumo);
                    let call = crate::sumo::batch::Call::get(name, DOMAIN, $id);
                    crate::sumo::domain::get(self.0, call, "", arguments!($({$value})?))
                }
            )+
        }
    };
}

/// Defines calls that change an object.
macro_rules! setters {
    ($handle:ident, $name:literal; $(
        $(#[$doc:meta])*
        $method:ident $sumo:literal $id:literal
        $(($argument:ident: $kind:ty))? $([$($item:ident: $item_kind:ty),*])?
        $({$($given:ident: $given_kind:ty),*} => $value:expr)?;
    )+) => {
        impl<S: crate::sumo::domain::Scope> $handle<'_, S> {
            $(
                $(#[$doc])*
                pub fn $method(
                    &mut self,
                    id: &str,
                    $($argument: $kind,)? $($($item: $item_kind),*)? $($($given: $given_kind),*)?
                ) -> S::Output<()> {
                    let name = concat!($name, ".", $sumo);
                    let call = crate::sumo::batch::Call::set(name, DOMAIN, $id);
                    crate::sumo::domain::set(
                        self.0,
                        call,
                        id,
                        arguments!($(($argument))? $([$($item)*])? $({$value})?),
                    )
                }
            )+
        }
    };
}

/// Defines calls that change the domain as a whole.
macro_rules! global_setters {
    ($handle:ident, $name:literal; $(
        $(#[$doc:meta])* $method:ident $sumo:literal $id:literal ($argument:ident: $kind:ty);
    )+) => {
        impl<S: crate::sumo::domain::Scope> $handle<'_, S> {
            $(
                $(#[$doc])*
                pub fn $method(&mut self, $argument: $kind) -> S::Output<()> {
                    let name = concat!($name, ".", $sumo);
                    let call = crate::sumo::batch::Call::set(name, DOMAIN, $id);
                    crate::sumo::domain::set(self.0, call, "", $argument)
                }
            )+
        }
    };
}

/// Gives the arguments of a call as one [`Argument`](super::Argument).
macro_rules! arguments {
    () => {
        crate::sumo::domain::value::Nothing
    };
    (($argument:ident)) => {
        $argument
    };
    ([]) => {
        crate::sumo::domain::value::Empty
    };
    ([$($item:ident)+]) => {
        ($($item,)+)
    };
    ({$value:expr}) => {
        $value
    };
}

/// Defines a struct that SUMO sends as consecutive values, in the order of the fields.
macro_rules! record {
    ($(#[$doc:meta])* $name:ident { $($(#[$field_doc:meta])* $field:ident: $kind:ty,)+ }) => {
        $(#[$doc])*
        #[derive(Debug, Clone, PartialEq)]
        #[non_exhaustive]
        pub struct $name {
            $($(#[$field_doc])* pub $field: $kind,)+
        }

        impl crate::sumo::domain::value::FromFields for $name {
            fn from_fields(
                fields: &mut crate::sumo::domain::Fields,
            ) -> Result<Self, crate::sumo::Error> {
                Ok($name { $($field: fields.take()?,)+ })
            }
        }
    };
}

/// Implements `FromValue` for a list of records: SUMO sends their number and then all their values.
macro_rules! flat_list {
    ($($name:ident),+) => {
        $(impl crate::sumo::domain::FromValue for Vec<$name> {
            fn from_value(value: crate::sumo::Value) -> Result<Self, crate::sumo::Error> {
                crate::sumo::domain::compound(value, crate::sumo::domain::Fields::records)
            }
        })+
    };
}

/// Implements `FromValue` for a record and for a list of records: SUMO sends each as a compound.
macro_rules! nested_list {
    ($($name:ident),+) => {
        $(impl crate::sumo::domain::FromValue for $name {
            fn from_value(value: crate::sumo::Value) -> Result<Self, crate::sumo::Error> {
                let read = crate::sumo::domain::value::FromFields::from_fields;
                crate::sumo::domain::compound(value, read)
            }
        }

        impl crate::sumo::domain::FromValue for Vec<$name> {
            fn from_value(value: crate::sumo::Value) -> Result<Self, crate::sumo::Error> {
                crate::sumo::domain::compound(value, crate::sumo::domain::Fields::rest)
            }
        })+
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
            /// the next decision is at the next step; without it, the next decision keeps its time.
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
