//! The agent's own speed, heading and place on its route.

use super::group::{FAR, FeatureGroup, NEAR, SPEED};
use crate::env::spec::Described;

const FEATURES: [Described; 8] = [
    ("speed", "22.2 m/s", 0.0, 1.0),
    ("last_action", "1", -1.0, 1.0),
    ("heading_cos", "1", -1.0, 1.0),
    ("heading_sin", "1", -1.0, 1.0),
    ("to_conflict_far", "50 m", -1.0, 1.0),
    ("to_conflict_near", "15 m", -1.0, 1.0),
    ("to_arrival", "100 m", -1.0, 1.0),
    ("lateral", "1.75 m, positive left", -1.0, 1.0),
];

pub const GROUP: FeatureGroup = FeatureGroup {
    describe: |_, features| features.push("ego", 1, &FEATURES),
    write: |view, w| {
        let (own, route) = (view.own(), view.route());
        let (sin, cos) = own.pose.heading.sin_cos();
        let to_conflict = route.to_first_conflict(own.s);
        w.put([
            own.speed.max(0.0) / SPEED,
            own.action,
            cos,
            sin,
            to_conflict / FAR,
            to_conflict / NEAR,
            (route.arrival - own.s) / 100.0,
            own.lateral / 1.75,
        ]);
    },
};
