//! The built-in environments, which need no SUMO, by name.

use super::environment::Environment;
use super::junction::{JunctionSize, TrafficJunction};
use super::quadruped::{GateSurrogate, SheepSurrogate};
use super::robotarium::{Navigation, Transport};

/// Range of the probability that a car comes at an entry in a step. Evaluations have its upper end,
/// which is that of MAGIC's `train_tj_medium.sh` and `train_tj_easy.sh`; the lower end is a choice
/// of this project.
const MEDIUM: [f64; 2] = [0.02, 0.2];
const EASY: [f64; 2] = [0.1, 0.3];

/// A built-in environment.
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

/// All built-in environments.
const ALL: [BuiltIn; 6] = [
    BuiltIn {
        name: "traffic_junction",
        make: || Box::new(TrafficJunction::environment(JunctionSize::Medium, MEDIUM)),
    },
    BuiltIn {
        name: "traffic_junction_easy",
        make: || Box::new(TrafficJunction::environment(JunctionSize::Easy, EASY)),
    },
    BuiltIn { name: "navigation", make: || Box::new(Navigation::environment()) },
    BuiltIn { name: "material_transport", make: || Box::new(Transport::environment()) },
    BuiltIn { name: "gate_surrogate", make: || Box::new(GateSurrogate::environment()) },
    BuiltIn { name: "sheep_surrogate", make: || Box::new(SheepSurrogate::environment()) },
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

    /// Returns all of them.
    pub fn all() -> impl Iterator<Item = Self> {
        ALL.into_iter()
    }

    /// Returns the environment with this name.
    pub fn named(name: &str) -> Option<Self> {
        ALL.into_iter().find(|one| one.name == name)
    }

    /// Creates the environment.
    pub fn environment(self) -> Box<dyn Environment> {
        (self.make)()
    }
}
