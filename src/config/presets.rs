//! Presets: sets of settings for a purpose, as data.

use toml::Table;

/// Settings for a purpose, as TOML. A preset changes defaults; files, `--set` and flags override
/// it.
#[derive(Debug)]
pub struct Preset {
    /// Name on the command line and in files.
    pub name: &'static str,
    /// The settings, as TOML.
    pub text: &'static str,
}

/// Defaults of scenarios in which vehicles steer, for 8 agents.
pub(super) const STEERING: Preset =
    Preset { name: "steering", text: include_str!("../../presets/steering.toml") };

/// All presets.
pub const PRESETS: [Preset; 4] = [
    STEERING,
    Preset { name: "paper", text: include_str!("../../presets/paper.toml") },
    Preset { name: "messages", text: include_str!("../../presets/messages.toml") },
    Preset { name: "traffic_junction", text: include_str!("../../presets/traffic_junction.toml") },
];

impl Preset {
    /// Returns the preset called `name`.
    pub fn named(name: &str) -> Option<&'static Self> {
        PRESETS.iter().find(|preset| preset.name == name)
    }

    /// Returns the settings of the preset.
    pub(super) fn table(&self) -> Table {
        self.text.parse().expect("a preset is TOML")
    }
}
