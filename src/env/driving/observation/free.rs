//! How far the agent can drive before it comes too close to another vehicle: free-space features,
//! common to all encounters.

use super::group::FeatureGroup;
use crate::env::driving::right_of_way::{Free, free};
use crate::env::spec::Described;

const FEATURES: [Described; 3] = [
    (
        "free",
        "{near} m, to the first conflict with a vehicle that has priority, is ahead, or is a wreck",
        0.0,
        1.0,
    ),
    ("free_slow", "the same at half the speed", 0.0, 1.0),
    ("free_blocked", "{near} m, to the present position of a vehicle without priority", 0.0, 1.0),
];

/// In scenarios whose agents observe priorities.
pub const GROUP: FeatureGroup = FeatureGroup {
    describe: |scenario, features| {
        let shown = scenario.observation.priority_distance > 0.0;
        features.push("free", usize::from(shown), &FEATURES);
    },
    write: |view, w| {
        let of = |j| free(view.knowledge, view.priorities, view.slot, j);
        let free = view.detected().map(of).fold(Free::ALL, Free::min);
        w.put(
            [free.distance, free.slow, free.blocked].map(|distance| distance / view.scales().near),
        );
    },
};
