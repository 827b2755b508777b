//! The motion of an agent that steers, relative to its route.

use super::group::FeatureGroup;
use crate::env::spec::Described;

const FEATURES: [Described; 7] = [
    ("last_steer", "1, positive left", -1.0, 1.0),
    ("heading_error_sin", "1, heading left of the route's", -1.0, 1.0),
    ("heading_error_cos", "1", -1.0, 1.0),
    ("yaw_rate", "1 rad/s", -1.0, 1.0),
    ("lateral_speed", "5 m/s, positive left", -1.0, 1.0),
    ("reverse_speed", "5 m/s, backwards", 0.0, 1.0),
    ("lateral_far", "10 m, positive left", -1.0, 1.0),
];

/// In scenarios whose vehicles steer.
pub const GROUP: FeatureGroup = FeatureGroup {
    describe: |scenario, features| {
        let steers = scenario.control.steering.is_some();
        features.push("steering", usize::from(steers), &FEATURES);
    },
    write: |view, w| {
        let own = view.own();
        let error = own.pose.heading - view.route().path.smooth_heading(own.s);
        w.put([
            own.steer,
            error.sin(),
            error.cos(),
            own.motion.yaw_rate,
            own.motion.velocity.y / 5.0,
            (-own.speed).max(0.0) / 5.0,
            own.lateral / 10.0,
        ]);
    },
};
