//! The nearest vehicles in any direction, listed by distance (paper) or by bearing.

use std::f64::consts::PI;

use super::group::{FeatureGroup, SPEED, View, Writer, moving};
use crate::env::spec::Described;
use crate::scenario::NeighbourOrder;

/// Features of a neighbour that is listed by distance.
const BY_DISTANCE: [Described; 6] = [
    ("forward", "{far} m", -1.0, 1.0),
    ("left", "{far} m", -1.0, 1.0),
    ("velocity_forward", "22.2 m/s", -1.0, 1.0),
    ("velocity_left", "22.2 m/s", -1.0, 1.0),
    ("moving", "flag", 0.0, 1.0),
    ("present", "flag", 0.0, 1.0),
];

/// Features of a neighbour that is listed by bearing: also distances on a scale that resolves the
/// gaps in a queue.
const BY_BEARING: [Described; 8] = [
    BY_DISTANCE[0],
    BY_DISTANCE[1],
    ("forward_near", "{near} m", -1.0, 1.0),
    ("left_near", "{near} m", -1.0, 1.0),
    BY_DISTANCE[2],
    BY_DISTANCE[3],
    BY_DISTANCE[4],
    BY_DISTANCE[5],
];

/// Width of the sectors into which bearings to either side are grouped \[rad\]. Within a sector
/// neighbours are listed by distance: on a lane, the vehicle ahead before the one ahead of it.
const SECTOR: f64 = 15.0 * PI / 180.0;

/// Greatest number of neighbours.
const MOST: usize = 16;

/// In scenarios whose agents observe the nearest vehicles.
pub const GROUP: FeatureGroup = FeatureGroup {
    describe: |scenario, features| {
        let settings = &scenario.observation;
        let tokens: &[_] = match settings.neighbour_order {
            NeighbourOrder::Distance => &BY_DISTANCE,
            NeighbourOrder::Bearing => &BY_BEARING,
        };
        let count = if settings.groups.nearest() { settings.neighbours } else { 0 };
        features.push("neighbour", count, tokens);
    },
    write,
};

fn write(view: &View<'_>, w: &mut Writer<'_>) {
    let (traffic, settings, scales) = (view.traffic, &view.scenario.observation, view.scales());
    let mut nearest = [(f64::INFINITY, usize::MAX); MOST];
    let nearest = &mut nearest[..settings.neighbours];
    for j in view.detected() {
        let distance = traffic.distance(view.slot, j);
        if nearest.last().is_some_and(|last| distance < last.0) {
            let at = nearest.partition_point(|entry| entry.0 <= distance);
            nearest[at..].rotate_right(1);
            nearest[at] = (distance, j);
        }
    }
    let by_bearing = settings.neighbour_order == NeighbourOrder::Bearing;
    let place = |j: usize| traffic.relative(view.slot, traffic.slots[j].pose.point());
    if by_bearing {
        let sector = |&(_, j): &(f64, usize)| {
            if j == usize::MAX {
                return u32::MAX;
            }
            let there = place(j);
            (there.y.atan2(there.x).abs() / SECTOR) as u32
        };
        // The sort is stable: within a sector the nearest vehicle stays first.
        nearest.sort_by_key(sector);
    }
    let found = nearest.iter().map(|&(_, j)| j).filter(|&j| j != usize::MAX);
    let seen = |j: usize| {
        let (there, other) = (place(j), &traffic.slots[j]);
        let velocity = traffic.relative_velocity(view.slot, j);
        let (forward, left) = (velocity.x / SPEED, velocity.y / SPEED);
        [there.x, there.y, forward, left, moving(other.status)]
    };
    if by_bearing {
        let token = |j| {
            let [x, y, forward, left, moving] = seen(j);
            [
                x / scales.far,
                y / scales.far,
                x / scales.near,
                y / scales.near,
                forward,
                left,
                moving,
                1.0,
            ]
        };
        w.tokens(&BY_BEARING, nearest.len(), found.map(token));
    } else {
        let token = |j| {
            let [x, y, forward, left, moving] = seen(j);
            [x / scales.far, y / scales.far, forward, left, moving, 1.0]
        };
        w.tokens(&BY_DISTANCE, nearest.len(), found.map(token));
    }
}
