//! The road's border lines beside the vehicle and beside the area in front of it.

use super::group::FeatureGroup;
use crate::env::spec::Described;

/// Length of the area in front of a vehicle beside which border lines are observed \[m\].
const AHEAD: f64 = 4.0;

const fn border(name: &'static str) -> Described {
    (name, "1 touching, 0 at the range or further", 0.0, 1.0)
}
const FEATURES: [Described; 4] =
    [border("left"), border("right"), border("left_ahead"), border("right_ahead")];

/// In scenarios with a range of border observation.
pub const GROUP: FeatureGroup = FeatureGroup {
    describe: |scenario, features| {
        let on = scenario.observation.borders > 0.0;
        features.push("borders", usize::from(on), &FEATURES);
    },
    write: |view, w| {
        let range = view.scenario.observation.borders;
        let margins = view.map.road().margins(&view.own().pose, AHEAD, range);
        w.put(margins.map(|margin| 1.0 - margin / range));
    },
};
