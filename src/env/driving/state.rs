//! The privileged state: what training may use beyond an agent's own observation (paper: s, "task
//! specific state").
//!
//! The state is described from the viewpoint of one agent, without range limits: the agent's
//! internal state, the vehicles on its lanes, and the vehicles near every conflict point with
//! their speeds and last actions, and whether they are wrecks. Its size depends only on the
//! scenario's settings and never on the number of vehicles, so that one checkpoint serves any
//! number.

use super::intention::Knowledge;
use super::observation::{COUNT, Encounters, SPEED, describe_encounters, moving, put_encounters};
use super::slots::{CLEARED, Status, Traffic};
use super::task::Task;
use super::{Features, Writer};
use crate::scenario::Scenario;

/// Number of vehicles described ahead on the agent's own lanes, and number described behind.
const OWN_LANE: usize = 2;
/// Encounters that the state describes if the observation has any. Foresight and priority are left
/// out, since the observation contains them and value functions read the observation as well.
const MET: Encounters = Encounters { count: 8, foresight: 0.0, priority: false };
/// Number of vehicles described per conflicting route.
const PER_STREAM: usize = 4;

const VEHICLE: [(&str, &str, f32, f32); 5] = [
    ("distance", "50 m", -1.0, 1.0),
    ("speed", "22.2 m/s", 0.0, 1.0),
    ("last_action", "1", -1.0, 1.0),
    ("moving", "flag", 0.0, 1.0),
    ("present", "flag", 0.0, 1.0),
];
const COUNTS: [(&str, &str, f32, f32); 2] =
    [("moving", "12 vehicles", 0.0, 1.0), ("wrecks", "4 vehicles", 0.0, 1.0)];

pub(super) fn describe(scenario: &Scenario) -> Features {
    let mut features = Features::default();
    features.push(
        "own",
        1,
        &[
            ("x", "half the width of the routes' bounding box, from its middle", -1.0, 1.0),
            ("y", "half the height of the routes' bounding box, from its middle", -1.0, 1.0),
            ("heading_cos", "1", -1.0, 1.0),
            ("heading_sin", "1", -1.0, 1.0),
            ("speed", "22.2 m/s", 0.0, 1.0),
            ("last_action", "1", -1.0, 1.0),
            ("to_arrival", "100 m", -1.0, 1.0),
            ("time_left", "share of the horizon", 0.0, 1.0),
        ],
    );
    features.push("lane_ahead", OWN_LANE, &VEHICLE);
    features.push("lane_behind", OWN_LANE, &VEHICLE);
    features.push("lane_count", 1, &COUNTS);
    for stream in 0..scenario.observation.conflict_streams.max(1) {
        features.push(&format!("stream{stream}"), PER_STREAM, &VEHICLE);
        features.push(&format!("stream{stream}_count"), 1, &COUNTS);
    }
    let count = if scenario.observation.encounters > 0 { MET.count } else { 0 };
    describe_encounters(&mut features, Encounters { count, ..MET });
    features.push("apart", PER_STREAM, &VEHICLE);
    features.push("apart_count", 1, &COUNTS);
    features
}

/// Writes the privileged state as seen from `slot`, `[S]`. `time_left` is the share of the horizon
/// that is left, 1 at the start of an episode.
pub(super) fn write(task: &Task, traffic: &Traffic, time_left: f64, slot: usize, out: &mut [f32]) {
    let (scenario, routes) = (&task.scenario, &task.routes[..]);
    let own = &traffic.slots[slot];
    let route = &routes[own.route];
    let [x0, y0, x1, y1] = task.bounds;
    let (sin, cos) = own.pose.heading.sin_cos();
    let centred = |v: f64, low: f64, high: f64| (2.0 * v - low - high) / (high - low).max(1.0);
    let mut w = Writer::new(out);
    w.put([
        centred(own.pose.x, x0, x1),
        centred(own.pose.y, y0, y1),
        cos,
        sin,
        own.speed.max(0.0) / SPEED,
        own.action,
        (route.arrival - own.s) / 100.0,
        time_left,
    ]);

    let queue = &traffic.by_route[own.route];
    let place = queue.iter().position(|&j| j == slot).unwrap_or(queue.len());
    let gap = |&j: &usize| (traffic.slots[j].s - own.s, j);
    put(&mut w, traffic, queue[..place].iter().rev().map(gap), OWN_LANE);
    put(&mut w, traffic, queue[(place + 1).min(queue.len())..].iter().map(gap), OWN_LANE);
    put_counts(&mut w, traffic, queue.iter().copied());
    for stream in 0..scenario.observation.conflict_streams.max(1) {
        let Some(conflict) = route.conflicts.get(stream) else {
            w.skip(PER_STREAM * VEHICLE.len() + COUNTS.len());
            continue;
        };
        let queue = &traffic.by_route[conflict.route];
        let approaching = queue
            .iter()
            .map(|&j| (conflict.other - traffic.slots[j].s, j))
            .filter(|v| v.0 > -CLEARED);
        put(&mut w, traffic, approaching, PER_STREAM);
        put_counts(&mut w, traffic, queue.iter().copied());
    }
    if scenario.observation.encounters > 0 {
        put_encounters(&mut w, Knowledge::full(routes, traffic), &[], slot, MET, |_| true);
    }
    let apart =
        || route.apart.iter().flat_map(|&r| traffic.by_route[r].iter().map(move |&j| (r, j)));
    put(
        &mut w,
        traffic,
        apart().map(|(r, j)| (routes[r].to_first_conflict(traffic.slots[j].s), j)),
        PER_STREAM,
    );
    put_counts(&mut w, traffic, apart().map(|(_, j)| j));
    debug_assert_eq!(w.at, w.out.len());
}

fn put(
    w: &mut Writer,
    traffic: &Traffic,
    vehicles: impl Iterator<Item = (f64, usize)>,
    count: usize,
) {
    let mut written = 0;
    for (distance, j) in vehicles.take(count) {
        let other = &traffic.slots[j];
        w.put([
            distance / 50.0,
            other.speed.max(0.0) / SPEED,
            other.action,
            moving(other.status),
            1.0,
        ]);
        written += 1;
    }
    w.skip((count - written) * VEHICLE.len());
}

fn put_counts(w: &mut Writer, traffic: &Traffic, slots: impl Iterator<Item = usize>) {
    let (mut alive, mut wrecks) = (0.0, 0.0);
    for j in slots {
        if traffic.slots[j].status == Status::Active {
            alive += 1.0;
        } else {
            wrecks += 1.0;
        }
    }
    w.put([alive / COUNT, wrecks / 4.0]);
}
