//! Environments without SUMO by name: the built-in ones, and those that applications register.

use std::sync::{PoisonError, RwLock};

use super::environment::Environment;
use super::error::Error;
use super::junction::{JunctionSize, TrafficJunction};
use super::quadruped::{GateSurrogate, SheepSurrogate};
use super::robotarium::{Navigation, Transport};

/// Range of the probability that a car comes at an entry in a step. Evaluations have its upper end,
/// which is that of MAGIC's `train_tj_medium.sh` and `train_tj_easy.sh`; the lower end is a choice
/// of this project.
const MEDIUM: [f64; 2] = [0.02, 0.2];
const EASY: [f64; 2] = [0.1, 0.3];

/// Makes an environment.
type Make = fn() -> Box<dyn Environment>;

/// An environment without SUMO that settings, sweep files and the command line know by its name.
#[derive(Debug, Clone, Copy)]
pub struct NamedEnvironment {
    /// Name, as on the command line.
    pub name: &'static str,
    make: Make,
}

/// The built-in environments.
const BUILT_IN: [NamedEnvironment; 6] = [
    NamedEnvironment {
        name: "traffic_junction",
        make: || Box::new(TrafficJunction::environment(JunctionSize::Medium, MEDIUM)),
    },
    NamedEnvironment {
        name: "traffic_junction_easy",
        make: || Box::new(TrafficJunction::environment(JunctionSize::Easy, EASY)),
    },
    NamedEnvironment { name: "navigation", make: || Box::new(Navigation::environment()) },
    NamedEnvironment { name: "material_transport", make: || Box::new(Transport::environment()) },
    NamedEnvironment { name: "gate_surrogate", make: || Box::new(GateSurrogate::environment()) },
    NamedEnvironment { name: "sheep_surrogate", make: || Box::new(SheepSurrogate::environment()) },
];

/// The environments that applications registered.
static REGISTERED: RwLock<Vec<NamedEnvironment>> = RwLock::new(Vec::new());

/// Adds an environment of an application to those that settings, sweep files and the command line
/// know by name (`environment = "…"`, `--environment`): its name is that of the environment that
/// `make` returns. Call it before anything else looks an environment up, then `cli::main` to get
/// the whole command line; `examples/own_env.rs` does both.
///
/// # Errors
/// [`Error::Name`] if another environment has the name, or if it is not made of letters, digits,
/// `_` and `-`.
pub fn register(make: Make) -> Result<(), Error> {
    let name = make().name().to_owned();
    let refused = |why: String| Err(Error::Name { name: name.clone(), why });
    let allowed = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    if name.is_empty() || !name.chars().all(allowed) {
        return refused("allowed: letters, digits, `_` and `-`".to_owned());
    }
    let mut registered = REGISTERED.write().unwrap_or_else(PoisonError::into_inner);
    if BUILT_IN.iter().chain(&*registered).any(|one| one.name == name) {
        return refused("another environment has this name".to_owned());
    }
    registered.push(NamedEnvironment { name: name.leak(), make });
    Ok(())
}

impl NamedEnvironment {
    /// Names of the built-in environments.
    pub const BUILT_IN: [&'static str; BUILT_IN.len()] = {
        let mut names = [""; BUILT_IN.len()];
        let mut i = 0;
        while i < names.len() {
            names[i] = BUILT_IN[i].name;
            i += 1;
        }
        names
    };

    /// Returns all of them: the built-in ones, then those that applications registered.
    pub fn all() -> Vec<Self> {
        let registered = REGISTERED.read().unwrap_or_else(PoisonError::into_inner);
        BUILT_IN.iter().chain(&*registered).copied().collect()
    }

    /// Returns the names of all of them.
    pub fn names() -> Vec<&'static str> {
        Self::all().iter().map(|one| one.name).collect()
    }

    /// Returns the environment with this name.
    pub fn find(name: &str) -> Option<Self> {
        Self::all().into_iter().find(|one| one.name == name)
    }

    /// Creates the environment.
    pub fn environment(self) -> Box<dyn Environment> {
        (self.make)()
    }
}
