//! The groups of settings of a learner. Each group is a struct in the file that reads it, whose
//! fields declare the settings: documentation, default and range.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use toml::Table;

use super::channel::Channel;
pub use super::commformer::CommFormerSettings;
pub use super::encoder::{EncoderKind, Network};
pub use super::head::{Exploration, NoiseMode};
pub use super::icp::IcpSettings;
pub use super::iwol::Iwol;
pub use super::maddpg::MaddpgSettings;
pub use super::magic::MagicSettings;
pub use super::ppo::Ppo;
pub use super::sequence::TransformerSettings;

/// All settings of a learner.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// The networks.
    pub network: Network,
    /// Proximal policy optimisation.
    pub ppo: Ppo,
    /// Exploration noise.
    pub exploration: Exploration,
    /// Settings of IWoL.
    pub iwol: Iwol,
    /// The transformer of MAT and CommFormer.
    pub transformer: TransformerSettings,
    /// Settings of MAGIC.
    pub magic: MagicSettings,
    /// Settings of CommFormer.
    pub commformer: CommFormerSettings,
    /// Settings of ICP.
    pub icp: IcpSettings,
    /// Settings of MADDPG.
    pub maddpg: MaddpgSettings,
    /// The channel that messages pass through in training. In a run's settings it stands outside of
    /// the learner's, because evaluations read it as well.
    #[serde(skip)]
    #[schemars(skip)]
    pub channel: Channel,
}

impl Settings {
    /// Names of the groups that only some methods read.
    pub const OWN: [&'static str; 6] =
        ["iwol", "transformer", "magic", "commformer", "icp", "maddpg"];

    /// Returns these settings with all groups at their defaults, except those common to all methods
    /// and those named in `groups`.
    #[must_use]
    pub fn only(&self, groups: &[&str]) -> Self {
        let mut table = Table::try_from(self).expect("settings are plain data");
        table.retain(|group, _| !Self::OWN.contains(&group) || groups.contains(&group));
        let groups: Self = table.try_into().expect("groups that are missing have defaults");
        Self { channel: self.channel, ..groups }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::algo::{NAMES, capabilities};

    #[test]
    fn methods_are_told_of_groups_that_there_are() {
        let mut settings = Settings::default();
        (settings.ppo.epochs, settings.iwol.rounds, settings.transformer.blocks) = (1, 7, 3);
        (settings.magic.lambda_world, settings.commformer.sparsity) = (0.5, 0.2);
        (settings.icp.symbols, settings.maddpg.n_step) = (5, 3);
        assert_eq!(settings.only(&Settings::OWN), settings);
        let common = Settings { ppo: settings.ppo.clone(), ..Settings::default() };
        assert_eq!(settings.only(&[]), common);
        let mut told: Vec<&str> = Vec::new();
        for name in NAMES {
            let groups = capabilities(name).expect("a method").settings;
            assert!(groups.iter().all(|group| Settings::OWN.contains(group)), "{name}: {groups:?}");
            told.extend(groups);
        }
        for group in Settings::OWN {
            assert!(told.contains(&group), "nobody is told of {group}");
            assert_ne!(settings.only(&[group]), common, "{group}");
        }
    }
}
