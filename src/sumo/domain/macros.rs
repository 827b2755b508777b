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
            /// [`unsubscribe`](Self::unsubscribe) first to replace those. An empty list
            /// unsubscribes. In a batch, `Replies::first` has the current values; a client's call
            /// drops them.
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

            /// Ends all subscriptions to variables of the object. SUMO refuses this if there are
            /// none, also because the object has left the simulation.
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
            /// object. SUMO refuses this if there are none.
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
        crate::sumo::value::Nothing
    };
    (($argument:ident)) => {
        $argument
    };
    ([]) => {
        crate::sumo::value::Empty
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

        impl crate::sumo::value::FromFields for $name {
            fn from_fields(
                fields: &mut crate::sumo::value::Fields,
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
                crate::sumo::value::compound(value, crate::sumo::value::Fields::records)
            }
        })+
    };
}

/// Implements `FromValue` for a record and for a list of records: SUMO sends each as a compound.
macro_rules! nested_list {
    ($($name:ident),+) => {
        $(impl crate::sumo::domain::FromValue for $name {
            fn from_value(value: crate::sumo::Value) -> Result<Self, crate::sumo::Error> {
                let read = crate::sumo::value::FromFields::from_fields;
                crate::sumo::value::compound(value, read)
            }
        }

        impl crate::sumo::domain::FromValue for Vec<$name> {
            fn from_value(value: crate::sumo::Value) -> Result<Self, crate::sumo::Error> {
                crate::sumo::value::compound(value, crate::sumo::value::Fields::rest)
            }
        })+
    };
}
