//! The nearest vehicle ahead on the agent's lanes, and how many vehicles are ahead.

use super::group::{COUNT, FeatureGroup, View, Writer, moving};
use crate::env::driving::agents::Candidate;
use crate::env::spec::Described;

const FEATURES: [Described; 6] = [
    ("vehicles_ahead", "12 vehicles", 0.0, 1.0),
    ("gap_near", "10 m", -1.0, 1.0),
    ("gap_far", "{far} m", -1.0, 1.0),
    ("relative_speed", "10 m/s", -1.0, 1.0),
    ("moving", "flag", 0.0, 1.0),
    ("present", "flag", 0.0, 1.0),
];

/// In scenarios whose agents observe conflicts.
pub const GROUP: FeatureGroup = FeatureGroup {
    describe: |scenario, features| {
        let on = scenario.observation.groups.conflict();
        features.push("leader", usize::from(on), &FEATURES);
    },
    write,
};

/// A vehicle whose route is hidden counts on every route that it could still take.
fn write(view: &View<'_>, w: &mut Writer<'_>) {
    let (own, route) = (view.own(), view.route());
    let mut ahead = 0;
    let mut leader: Option<(f64, usize)> = None;
    let gap_on = |place: Candidate| route.gap_to(own.s, place.route, place.s);
    for j in view.detected() {
        let gaps = view.knowledge.candidates(j).filter_map(gap_on);
        if let Some(gap) = gaps.min_by(f64::total_cmp) {
            ahead += 1;
            if leader.is_none_or(|(best, _)| gap < best) {
                leader = Some((gap, j));
            }
        }
    }
    let token = leader.map(|(centre_gap, j)| {
        let other = &view.traffic.slots[j];
        let gap = centre_gap - f64::midpoint(own.size[0], other.size[0]);
        let closing = (other.speed - own.speed) / 10.0;
        [
            f64::from(ahead) / COUNT,
            gap / 10.0,
            gap / view.scales().far,
            closing,
            moving(other.status),
            1.0,
        ]
    });
    w.tokens(&FEATURES, 1, token.into_iter());
}
