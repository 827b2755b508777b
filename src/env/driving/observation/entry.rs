//! How far the agent is from the next place where it can wait without blocking others.

use super::group::FeatureGroup;
use crate::env::driving::right_of_way::to_entry;
use crate::env::spec::Described;

const FEATURES: [Described; 2] = [
    ("to_entry_near", "{near} m, -1 where it has entered", -1.0, 1.0),
    ("to_entry_far", "{far} m, -1 where it has entered", -1.0, 1.0),
];

/// In scenarios whose agents observe priorities.
pub const GROUP: FeatureGroup = FeatureGroup {
    describe: |scenario, features| {
        let shown = scenario.observation.priority_distance > 0.0;
        features.push("entry", usize::from(shown), &FEATURES);
    },
    write: |view, w| {
        let entry = to_entry(view.map, view.own());
        let scales = view.scales();
        w.put(
            [scales.near, scales.far]
                .map(|scale| entry.map_or(-1.0, |distance| distance.max(0.0) / scale)),
        );
    },
};
