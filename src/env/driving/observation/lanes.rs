//! The lanes beside the agent: whether it may change to them, and the vehicles next to it there.

use super::group::{FeatureGroup, View, Writer};
use crate::env::driving::lane_routes::Side;
use crate::env::driving::motion::LANE_TIME;
use crate::env::spec::Described;
use crate::scenario::LaneChange;

/// Features of the lane that the agent is on.
const OWN: [Described; 2] = [
    ("to_lane_change", "{long} m, to where the route needs another lane, 1: nowhere", 0.0, 1.0),
    ("lane_time", "3 s, until the agent may change lanes again", 0.0, 1.0),
];

/// Features of a lane beside the agent. Gaps are from bumper to bumper, negative where the vehicles
/// are beside each other.
const BESIDE: [Described; 10] = [
    ("to_lane_change", "{long} m, to where the route needs another lane, 1: nowhere", 0.0, 1.0),
    ("leader_gap_near", "10 m", -1.0, 1.0),
    ("leader_gap_far", "{far} m", -1.0, 1.0),
    ("leader_relative_speed", "10 m/s", -1.0, 1.0),
    ("leader", "flag", 0.0, 1.0),
    ("follower_gap_near", "10 m", -1.0, 1.0),
    ("follower_gap_far", "{far} m", -1.0, 1.0),
    ("follower_relative_speed", "10 m/s", -1.0, 1.0),
    ("follower", "flag", 0.0, 1.0),
    ("present", "flag: the agent may change to the lane", 0.0, 1.0),
];

/// In scenarios whose agents change lanes.
pub const GROUP: FeatureGroup = FeatureGroup {
    describe: |scenario, features| {
        if scenario.control.lane_change != LaneChange::None {
            features.push("lane", 1, &OWN);
            features.push("lane_left", 1, &BESIDE);
            features.push("lane_right", 1, &BESIDE);
        }
    },
    write,
};

fn write(view: &View<'_>, w: &mut Writer<'_>) {
    let own = view.own();
    let time = f64::from(own.lane_steps) * view.scenario.control.interval;
    w.put([to_lane_change(view, own.route, own.s), time / LANE_TIME]);
    for side in [Side::Left, Side::Right] {
        let beside = view.map.lane_routes.route_beside(&view.map.routes, own, side);
        let token = beside.map(|(route, s)| {
            let [leader, follower] = neighbours(view, route, s);
            let [near, far, speed, some] = described(view, leader);
            let [behind_near, behind_far, behind_speed, any] = described(view, follower);
            let room = to_lane_change(view, route, s);
            [room, near, far, speed, some, behind_near, behind_far, behind_speed, any, 1.0]
        });
        w.tokens(&BESIDE, 1, token.into_iter());
    }
}

/// Returns the distance from the front of the agent, whose centre is at `s` on a route, to where the
/// route needs another lane, in units of 100 m, at most 1.
fn to_lane_change(view: &View<'_>, route: usize, s: f64) -> f64 {
    let front = s + view.own().size[0] / 2.0;
    ((view.map.lane_change[route] - front) / view.scales().long).clamp(0.0, 1.0)
}

/// Returns the nearest vehicles ahead of and behind the position `s` on a route, each with the distance
/// between the centres \[m\]. A vehicle whose route is hidden counts on every route that it could
/// still take.
fn neighbours(view: &View<'_>, route: usize, s: f64) -> [Option<(f64, usize)>; 2] {
    /// Of two vehicles at the same position, each is ahead of the other \[m\].
    const LEVEL: f64 = 1e-6;
    let routes = &view.map.routes;
    let mut nearest: [Option<(f64, usize)>; 2] = [None; 2];
    for j in view.detected() {
        let candidates = || view.knowledge.candidates(j);
        let ahead =
            candidates().filter_map(|there| routes[route].gap_to(s - LEVEL, there.route, there.s));
        let behind =
            candidates().filter_map(|there| routes[there.route].gap_to(there.s + LEVEL, route, s));
        let gaps = [ahead.min_by(f64::total_cmp), behind.min_by(f64::total_cmp)];
        for (nearest, gap) in nearest.iter_mut().zip(gaps) {
            if let Some(gap) = gap
                && nearest.is_none_or(|(least, _)| gap < least)
            {
                *nearest = Some((gap, j));
            }
        }
    }
    nearest
}

/// Returns the features of a neighbour; zeros where there is none.
fn described(view: &View<'_>, neighbour: Option<(f64, usize)>) -> [f64; 4] {
    let Some((distance, j)) = neighbour else { return [0.0; 4] };
    let (own, other) = (view.own(), &view.traffic.slots[j]);
    let gap = distance - f64::midpoint(own.size[0], other.size[0]);
    [gap / 10.0, gap / view.scales().far, (other.speed - own.speed) / 10.0, 1.0]
}
