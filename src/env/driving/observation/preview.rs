//! Points of the path ahead of an agent that steers.

use super::group::FeatureGroup;
use crate::env::spec::Described;

/// Distances along the path to the points \[m\]. Each point's coordinates are in units of its
/// distance.
const PREVIEW: [f64; 4] = [4.0, 8.0, 16.0, 32.0];

const POINT: [Described; 2] =
    [("forward", "distance ahead", -1.0, 1.0), ("left", "distance ahead", -1.0, 1.0)];

/// In scenarios whose vehicles steer.
pub const GROUP: FeatureGroup = FeatureGroup {
    describe: |scenario, features| {
        let steers = scenario.control.steering.is_some();
        features.push("preview", if steers { PREVIEW.len() } else { 0 }, &POINT);
    },
    write: |view, w| {
        let own = view.own();
        let point = |ahead: f64| {
            let seen = view.traffic.relative(view.slot, view.route().path.at(own.s + ahead).0);
            [seen.x / ahead, seen.y / ahead]
        };
        w.tokens(&POINT, PREVIEW.len(), PREVIEW.into_iter().map(point));
    },
};
