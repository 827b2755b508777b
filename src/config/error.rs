//! Errors in settings.

use std::path::PathBuf;

use crate::scenario;

/// An error in a configuration.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The file cannot be read.
    #[error("cannot read `{}`", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// The text is not valid TOML.
    #[error("{place}: {message}")]
    Syntax {
        /// File, line and column.
        place: String,
        /// What is wrong.
        message: String,
    },
    /// No setting has this name.
    #[error("{place}: there is no setting `{key}`{}", nearest.as_ref().map(|n| format!("; did you mean `{n}`?")).unwrap_or_default())]
    UnknownKey {
        /// Origin of the key.
        place: String,
        /// The unknown name.
        key: String,
        /// The nearest valid name.
        nearest: Option<String>,
    },
    /// The value is not allowed.
    #[error("{place}: bad value for `{key}`: {message}")]
    Value {
        /// Origin of the value.
        place: String,
        /// The setting.
        key: String,
        /// What is wrong.
        message: String,
    },
    /// No source names a scenario.
    #[error(
        "no scenario given; name one with --scenario, or an environment without SUMO with --environment, e.g. --scenario scenarios/intersection.xml"
    )]
    NoScenario,
    /// The settings are those of an environment without a scenario.
    #[error("{name} is an environment without a scenario, which this command needs")]
    WithoutScenario {
        /// Name of the environment.
        name: &'static str,
    },
    /// The scenario is not valid together with settings that override parts of it.
    #[error("{error} (with {places})")]
    Overridden {
        /// The origins of the settings.
        places: String,
        /// The error in the scenario.
        error: scenario::Error,
    },
    /// The scenario is not valid.
    #[error(transparent)]
    Scenario(#[from] scenario::Error),
}
