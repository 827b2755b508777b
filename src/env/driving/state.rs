//! The privileged state: what training may use beyond an agent's own observation (paper: s, "task
//! specific state").
//!
//! The state is described from the viewpoint of one agent, without range limits: the agent's
//! internal state, the nearest vehicles on its lanes, and the nearest vehicles on the routes of its
//! next conflicts (as many as the observation has streams, but at least one) with their speeds and
//! last actions, and whether they are wrecks. In scenarios with encounters, the nearest encounters
//! follow. Its size depends only on the scenario's settings and never on the number of vehicles, so
//! that one checkpoint serves any number.

use super::agents::{Status, cleared};
use super::observation::encounter::Encounters;
use super::observation::group::{COUNT, SPEED, moving};
use super::observation::signals;
use super::observation::{FeatureGroup, View, Writer};
use crate::env::spec::Described;
use crate::scenario::Scenario;

/// Number of vehicles described ahead on the agent's own lanes, and number described behind.
const OWN_LANE: usize = 2;
/// Encounters that the state describes if the observation has any. Foresight and priority are left
/// out, since the observation contains them and value functions read the observation as well.
const ENCOUNTERS: Encounters = Encounters { count: 8, foresight: 0.0, priority: false };
/// Number of vehicles described per conflicting route.
const PER_STREAM: usize = 4;

const OWN: [Described; 8] = [
    ("x", "half the width of the routes' bounding box, from its middle", -1.0, 1.0),
    ("y", "half the height of the routes' bounding box, from its middle", -1.0, 1.0),
    ("heading_cos", "1", -1.0, 1.0),
    ("heading_sin", "1", -1.0, 1.0),
    ("speed", "22.2 m/s, negative backwards", -1.0, 1.0),
    ("last_action", "1", -1.0, 1.0),
    ("to_arrival", "{long} m", -1.0, 1.0),
    ("time_left", "share of the horizon", 0.0, 1.0),
];
const VEHICLE: [Described; 5] = [
    ("distance", "{far} m", -1.0, 1.0),
    ("speed", "22.2 m/s, negative backwards", -1.0, 1.0),
    ("last_action", "1", -1.0, 1.0),
    ("moving", "flag", 0.0, 1.0),
    ("present", "flag", 0.0, 1.0),
];
const COUNTS: [Described; 2] =
    [("moving", "12 vehicles", 0.0, 1.0), ("wrecks", "4 vehicles", 0.0, 1.0)];

/// The feature groups, in their order in the state.
pub(super) static GROUPS: &[FeatureGroup] = &[
    FeatureGroup { describe: |_, features| features.push("own", 1, &OWN), write: write_own },
    FeatureGroup {
        describe: |_, features| {
            features.push("lane_ahead", OWN_LANE, &VEHICLE);
            features.push("lane_behind", OWN_LANE, &VEHICLE);
            features.push("lane_count", 1, &COUNTS);
        },
        write: write_lane,
    },
    FeatureGroup {
        describe: |scenario, features| {
            for stream in 0..streams(scenario) {
                features.push(&format!("stream{stream}"), PER_STREAM, &VEHICLE);
                features.push(&format!("stream{stream}_count"), 1, &COUNTS);
            }
        },
        write: write_streams,
    },
    FeatureGroup {
        describe: |scenario, features| {
            if scenario.observation.encounters > 0 {
                ENCOUNTERS.describe(features);
            }
        },
        write: |view, w| ENCOUNTERS.write(view, |_| true, w),
    },
    FeatureGroup {
        describe: |_, features| {
            features.push("apart", PER_STREAM, &VEHICLE);
            features.push("apart_count", 1, &COUNTS);
        },
        write: write_apart,
    },
    signals::KNOWN,
];

/// Returns the number of conflicting routes that are described.
fn streams(scenario: &Scenario) -> usize {
    scenario.observation.conflict_streams.max(1)
}

fn write_own(view: &View<'_>, w: &mut Writer<'_>) {
    let own = view.own();
    let [x0, y0, x1, y1] = view.map.bounds;
    let (sin, cos) = own.pose.heading.sin_cos();
    let centred = |v: f64, low: f64, high: f64| (2.0 * v - low - high) / (high - low).max(1.0);
    w.put([
        centred(own.pose.x, x0, x1),
        centred(own.pose.y, y0, y1),
        cos,
        sin,
        own.speed / SPEED,
        own.action,
        (own.finish(view.map) - own.s) / view.scales().long,
        view.time_left,
    ]);
}

/// Writes the vehicles on the agent's lanes: those of its route and, where vehicles change lanes, those
/// of other routes that use the same lanes.
fn write_lane(view: &View<'_>, w: &mut Writer<'_>) {
    let own = view.own();
    if view.map.lane_routes.are_used() {
        return write_shared_lanes(view, w);
    }
    let queue = &view.traffic.by_route[own.route];
    let place = queue.iter().position(|&j| j == view.slot).unwrap_or(queue.len());
    let gap = |&j: &usize| (view.traffic.slots[j].s - own.s, j);
    put_vehicles(view, w, queue[..place].iter().rev().map(gap), OWN_LANE);
    put_vehicles(view, w, queue[(place + 1).min(queue.len())..].iter().map(gap), OWN_LANE);
    put_counts(view, w, queue.iter().copied());
}

/// Writes the vehicles of all routes on the agent's lanes.
fn write_shared_lanes(view: &View<'_>, w: &mut Writer<'_>) {
    let (own, routes, slots) = (view.own(), &view.map.routes, &view.traffic.slots);
    let others =
        || (0..slots.len()).filter(|&j| j != view.slot && slots[j].status != Status::Empty);
    let ahead = |j: usize| Some((view.route().gap_to(own.s, slots[j].route, slots[j].s)?, j));
    let behind = |j: usize| Some((routes[slots[j].route].gap_to(slots[j].s, own.route, own.s)?, j));
    let mut sides = [others().filter_map(ahead).collect(), others().filter_map(behind).collect()];
    for (side, sign) in sides.iter_mut().zip([1.0, -1.0]) {
        let side: &mut Vec<(f64, usize)> = side;
        side.sort_by(|a, b| a.0.total_cmp(&b.0));
        put_vehicles(view, w, side.iter().map(|&(gap, j)| (sign * gap, j)), OWN_LANE);
    }
    put_counts(view, w, sides.iter().flatten().map(|entry| entry.1).chain([view.slot]));
}

/// Writes the vehicles on the routes that conflict with the agent's.
fn write_streams(view: &View<'_>, w: &mut Writer<'_>) {
    let (route, s) = (view.route(), view.own().s);
    // Where encounters stand for streams, the state describes the first conflict of the group.
    let conflicts = match view.scenario.observation.conflict_streams {
        0 => route.group_from(s),
        count => route.upcoming(s, count),
    };
    for stream in 0..streams(view.scenario) {
        let Some(conflict) = conflicts.get(stream) else {
            w.skip(PER_STREAM * VEHICLE.len() + COUNTS.len());
            continue;
        };
        let queue = || {
            let queue = view.traffic.by_route[conflict.route].iter();
            queue.filter(|&&j| j != view.slot)
        };
        let approaching = queue().map(|&j| (conflict.other - view.traffic.slots[j].s, j)).filter(
            |&(distance, j)| distance > -cleared(view.own().size, view.traffic.slots[j].size),
        );
        put_vehicles(view, w, approaching, PER_STREAM);
        put_counts(view, w, queue().copied());
    }
}

/// Writes the vehicles on the routes that have no conflict with the agent's.
fn write_apart(view: &View<'_>, w: &mut Writer<'_>) {
    let View { map, traffic, .. } = *view;
    let on_route = |&r: &usize| {
        let distance = move |j: usize| map.routes[r].to_first_conflict(traffic.slots[j].s);
        traffic.by_route[r].iter().map(move |&j| (distance(j), j))
    };
    let apart = || view.route().apart.iter().flat_map(on_route);
    put_vehicles(view, w, apart(), PER_STREAM);
    put_counts(view, w, apart().map(|(_, j)| j));
}

/// Writes the first `count` of `vehicles` (distance \[m\], slot) and padding.
fn put_vehicles(
    view: &View<'_>,
    w: &mut Writer<'_>,
    vehicles: impl Iterator<Item = (f64, usize)>,
    count: usize,
) {
    let vehicle = |(distance, j): (f64, usize)| {
        let other = &view.traffic.slots[j];
        let speed = other.speed / SPEED;
        [distance / view.scales().far, speed, other.action, moving(other.status), 1.0]
    };
    w.tokens(&VEHICLE, count, vehicles.map(vehicle));
}

/// Writes the numbers of moving vehicles and of wrecks.
fn put_counts(view: &View<'_>, w: &mut Writer<'_>, slots: impl Iterator<Item = usize>) {
    let (mut alive, mut wrecks) = (0.0, 0.0);
    for j in slots {
        if view.traffic.slots[j].status == Status::Active {
            alive += 1.0;
        } else {
            wrecks += 1.0;
        }
    }
    w.put([alive / COUNT, wrecks / 4.0]);
}
