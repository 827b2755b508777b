//! Variables that subscriptions can report.

use std::{fmt, marker::PhantomData};

use super::constants::Domain;
use super::value::{Argument, FromValue};

/// A variable that can be subscribed to, with the type of its value.
pub struct Variable<T> {
    id: VariableId,
    value: PhantomData<fn() -> T>,
}

/// A variable that can be subscribed to only with an argument of type `A`, see
/// [`Vehicle::subscribe_with`](super::domain::vehicle::Vehicle::subscribe_with). SUMO 1.15 accepts
/// arguments only for the variables that are constants of this type.
pub struct VariableWith<A, T> {
    variable: Variable<T>,
    argument: PhantomData<fn(A)>,
}

/// A variable without the type of its value: its domain and its number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct VariableId {
    domain: Domain,
    number: u8,
}

impl VariableId {
    /// Returns the kind of object that has the variable.
    pub const fn domain(self) -> Domain {
        self.domain
    }

    /// Returns the number of the variable, unique within its domain.
    pub const fn number(self) -> u8 {
        self.number
    }
}

impl<T> Variable<T> {
    /// Returns the variable of a domain that has this number. SUMO 1.15 crashes on a subscription
    /// to a variable that needs an argument: use the constants of the domains where they exist.
    pub const fn new(domain: Domain, number: u8) -> Self {
        Variable { id: VariableId { domain, number }, value: PhantomData }
    }

    /// Returns the identifier that subscriptions take.
    pub const fn id(self) -> VariableId {
        self.id
    }

    /// Like [`VariableId::number`].
    pub const fn number(self) -> u8 {
        self.id.number
    }
}

impl<A, T> VariableWith<A, T> {
    pub(super) const fn new(domain: Domain, number: u8) -> Self {
        VariableWith { variable: Variable::new(domain, number), argument: PhantomData }
    }

    /// Like [`VariableId::domain`].
    pub const fn domain(self) -> Domain {
        self.variable.id.domain
    }

    /// Like [`VariableId::number`].
    pub const fn number(self) -> u8 {
        self.variable.id.number
    }
}

/// A variable whose value a subscription can report: a [`Variable`] or a [`VariableWith`].
pub trait Reported: Identified {
    /// The type of the variable's value.
    type Value: FromValue;
}

/// Gives the identifier of a variable. Code outside this crate cannot name this trait, because the
/// identifier of a [`VariableWith`] must not be used in subscriptions.
pub trait Identified {
    fn identify(self) -> VariableId;
}

impl<T: FromValue> Reported for Variable<T> {
    type Value = T;
}

impl<T> Identified for Variable<T> {
    fn identify(self) -> VariableId {
        self.id
    }
}

impl<A, T: FromValue> Reported for VariableWith<A, T> {
    type Value = T;
}

impl<A, T> Identified for VariableWith<A, T> {
    fn identify(self) -> VariableId {
        self.variable.id
    }
}

/// A type that the argument of a subscription can have.
pub trait SubscriptionArgument {
    /// The type of the value that the caller passes; a string only needs to live as long as the
    /// call.
    type Given<'a>: Argument;
}

impl SubscriptionArgument for f64 {
    type Given<'a> = f64;
}

impl SubscriptionArgument for &str {
    type Given<'a> = &'a str;
}

impl<T> Clone for Variable<T> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<T> Copy for Variable<T> {}

impl<T> fmt::Debug for Variable<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Variable").field(&self.id).finish()
    }
}

impl<A, T> Clone for VariableWith<A, T> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<A, T> Copy for VariableWith<A, T> {}

impl<A, T> fmt::Debug for VariableWith<A, T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("VariableWith").field(&self.variable.id).finish()
    }
}
