//! Layouts of feature vectors: which feature groups of a list a scenario has, and where they lie.

use super::observation::{FeatureGroup, Scales, View, Writer};
use crate::env::spec::Features;
use crate::scenario::Scenario;

/// The layout of the observation or of the privileged state.
#[derive(Debug, Clone)]
pub(super) struct Layout {
    /// The groups that the scenario has, each with its number of features.
    groups: Vec<(&'static FeatureGroup, usize)>,
}

impl Layout {
    /// Returns the layout of the groups that `scenario` has, and their features.
    pub(super) fn new(groups: &'static [FeatureGroup], scenario: &Scenario) -> (Self, Features) {
        let mut features = Features { normalised: true, ..Features::default() };
        let mut width = |group: &FeatureGroup| {
            let before = features.len();
            (group.describe)(scenario, &mut features);
            features.len() - before
        };
        let groups = groups.iter().map(|group| (group, width(group)));
        let layout = Self { groups: groups.filter(|(_, width)| *width > 0).collect() };
        let scales = Scales::of(scenario);
        for feature in &mut features.list {
            feature.unit = scales.unit(&feature.unit);
        }
        (layout, features)
    }

    /// Writes the features of an agent to `out`.
    ///
    /// # Panics
    /// If a group does not write as many features as it describes.
    pub(super) fn write(&self, view: &View<'_>, mut out: &mut [f32]) {
        for (group, width) in &self.groups {
            let (part, rest) = out.split_at_mut(*width);
            let mut writer = Writer::new(part);
            (group.write)(view, &mut writer);
            writer.finish();
            out = rest;
        }
    }
}
