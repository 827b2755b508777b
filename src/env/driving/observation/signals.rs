//! The signal that the agent comes to next.

use super::group::{FeatureGroup, View, Writer};
use crate::env::spec::Described;
use crate::scenario::Scenario;
use crate::sumo::net::Aspect;

const FEATURES: [Described; 12] = [
    ("to_line_far", "{far} m", 0.0, 1.0),
    ("to_line_near", "{near} m", 0.0, 1.0),
    ("red", "flag", 0.0, 1.0),
    ("yellow", "flag", 0.0, 1.0),
    ("green", "flag", 0.0, 1.0),
    ("priority", "flag, green without foes that have priority", 0.0, 1.0),
    ("stop", "flag, stop first and then give way", 0.0, 1.0),
    ("off", "flag", 0.0, 1.0),
    ("to_change_far", "60 s, 0 where it is not known", 0.0, 1.0),
    ("to_change_near", "10 s, 0 where it is not known", 0.0, 1.0),
    ("change_known", "flag, the program is static", 0.0, 1.0),
    ("present", "flag", 0.0, 1.0),
];
/// Scales of the time until the signal says something else \[s\].
const LONG: f64 = 60.0;
const SHORT: f64 = 10.0;

/// In scenarios with signals on their routes: the next signal within the detection range.
pub const GROUP: FeatureGroup = FeatureGroup {
    describe,
    write: |view, w| write(view, view.scenario.observation.detection_range, w),
};

/// The same for the privileged state, without a limit of range.
pub const KNOWN: FeatureGroup =
    FeatureGroup { describe, write: |view, w| write(view, f64::INFINITY, w) };

fn describe(scenario: &Scenario, features: &mut crate::env::spec::Features) {
    features.push("signal", usize::from(scenario.observation.signals), &FEATURES);
}

fn write(view: &View<'_>, range: f64, w: &mut Writer<'_>) {
    let next = view.own().next_signal.filter(|next| next.distance <= range);
    let token = next.map(|next| {
        let flag = |aspects: &[Aspect]| f64::from(u8::from(aspects.contains(&next.aspect)));
        let to_change = next.to_change.unwrap_or(0.0).max(0.0);
        [
            next.distance / view.scales().far,
            next.distance / view.scales().near,
            flag(&[Aspect::Red, Aspect::RedYellow]),
            flag(&[Aspect::Yellow, Aspect::RedYellow]),
            flag(&[Aspect::Green, Aspect::Priority]),
            flag(&[Aspect::Priority]),
            flag(&[Aspect::Stop]),
            flag(&[Aspect::Off]),
            to_change / LONG,
            to_change / SHORT,
            f64::from(u8::from(next.to_change.is_some())),
            1.0,
        ]
    });
    w.tokens(&FEATURES, 1, token.into_iter());
}
