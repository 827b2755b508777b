//! The environments that come along and need no SUMO, by name.

use super::environment::Environment;
use super::junction::{JunctionSize, TrafficJunction};

/// Probability that a car comes at an entry in a step (MAGIC's script; IC3Net's README).
const ARRIVALS: [f64; 2] = [0.2, 0.2];

/// An environment that comes along.
#[derive(Debug, Clone, Copy)]
pub struct BuiltIn {
    /// Name, as on the command line.
    pub name: &'static str,
    make: fn() -> Box<dyn Environment>,
}

impl PartialEq for BuiltIn {
    fn eq(&self, other: &Self) -> bool {
        self.name == other.name
    }
}

/// All environments that come along.
const ALL: [BuiltIn; 2] = [
    BuiltIn {
        name: "traffic_junction",
        make: || Box::new(TrafficJunction::environment(JunctionSize::Medium, ARRIVALS)),
    },
    BuiltIn {
        name: "traffic_junction_easy",
        make: || Box::new(TrafficJunction::environment(JunctionSize::Easy, ARRIVALS)),
    },
];

impl BuiltIn {
    /// Names of all of them.
    pub const NAMES: [&'static str; ALL.len()] = {
        let mut names = [""; ALL.len()];
        let mut i = 0;
        while i < names.len() {
            names[i] = ALL[i].name;
            i += 1;
        }
        names
    };

    /// Returns the environment with this name.
    pub fn named(name: &str) -> Option<Self> {
        ALL.into_iter().find(|one| one.name == name)
    }

    /// Creates the environment.
    pub fn environment(self) -> Box<dyn Environment> {
        (self.make)()
    }
}
