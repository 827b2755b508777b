//! Where the values of settings come from.

use std::collections::BTreeMap;
use std::fmt;

/// The source of a setting's value.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Origin {
    /// The default that the struct of its group declares.
    Declared,
    /// The scenario.
    Scenario,
    /// The preset with this name.
    Preset(&'static str),
    /// The profile with this name.
    Profile(&'static str),
    /// A rule by which defaults follow from the thing with this name.
    Rule(&'static str),
    /// The user, in this place: file, line and column, `--set key=value` or a flag.
    Given(String),
}

/// The origins of settings, by their full names.
pub type Origins = BTreeMap<String, Origin>;

impl fmt::Display for Origin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Declared => f.write_str("default"),
            Self::Scenario => f.write_str("scenario"),
            Self::Preset(name) => write!(f, "preset {name}"),
            Self::Profile(name) => write!(f, "profile {name}"),
            Self::Rule(what) => write!(f, "default, by the {what}"),
            Self::Given(place) => f.write_str(place),
        }
    }
}
