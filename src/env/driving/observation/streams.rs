//! The vehicles next to each conflict point of the agent's route, and those whose routes have no
//! conflict with it. A route with more conflicts than streams shows those that come next.

use super::group::{COUNT, FeatureGroup, SPEED, View, Writer, moving};
use crate::env::driving::agents::{CLEARED, Candidate, cleared};
use crate::env::spec::Described;

/// Features of a conflict point.
const STREAM: [Described; 4] = [
    ("own_far", "{far} m", -1.0, 1.0),
    ("own_near", "{near} m", -1.0, 1.0),
    ("vehicles", "12 vehicles", 0.0, 1.0),
    ("present", "flag", 0.0, 1.0),
];

/// Features of a vehicle.
const VEHICLE: [Described; 5] = [
    ("to_conflict_far", "{far} m", -1.0, 1.0),
    ("to_conflict_near", "{near} m", -1.0, 1.0),
    ("speed", "22.2 m/s, negative backwards", -1.0, 1.0),
    ("moving", "flag", 0.0, 1.0),
    ("present", "flag", 0.0, 1.0),
];

/// In scenarios whose agents observe conflicts.
pub const GROUP: FeatureGroup = FeatureGroup {
    describe: |scenario, features| {
        let settings = &scenario.observation;
        if !settings.groups.conflict() {
            return;
        }
        for stream in 0..settings.conflict_streams {
            features.push(&format!("stream{stream}"), 1, &STREAM);
            let name = format!("stream{stream}_vehicle");
            features.push(&name, settings.stream_vehicles, &VEHICLE);
        }
        features.push("apart_vehicle", settings.stream_vehicles, &VEHICLE);
    },
    write,
};

/// A vehicle whose route is hidden is in the stream of every route that it could still take, but
/// only once among those without conflict.
fn write(view: &View<'_>, w: &mut Writer<'_>) {
    let View { map, knowledge, .. } = *view;
    let (own, route) = (view.own(), view.route());
    let (settings, scales) = (&view.scenario.observation, view.scales());
    let vehicle = |(distance, j): (f64, usize)| {
        let other = &view.traffic.slots[j];
        let speed = other.speed / SPEED;
        [distance / scales.far, distance / scales.near, speed, moving(other.status), 1.0]
    };
    let conflicts = route.upcoming(own.s, settings.conflict_streams);
    for stream in 0..settings.conflict_streams {
        let Some(conflict) = conflicts.get(stream) else {
            w.skip(STREAM.len() + VEHICLE.len() * settings.stream_vehicles);
            continue;
        };
        let own_distance = conflict.own - own.s;
        let approaching = || {
            // Queues have the vehicle furthest along first, which is next to the conflict point.
            let distances =
                knowledge.on_route(conflict.route).map(|(s, j)| (conflict.other - s, j));
            let here = |j: usize| cleared(own.size, view.traffic.slots[j].size);
            distances.filter(move |&(distance, j)| distance > -here(j) && view.detects(j))
        };
        let count = approaching().count() as f64 / COUNT;
        w.put([own_distance / scales.far, own_distance / scales.near, count, 1.0]);
        w.tokens(&VEHICLE, settings.stream_vehicles, approaching().map(vehicle));
    }
    let distances = route.apart.iter().flat_map(|&r| {
        let to_conflict = move |(s, j): (f64, usize)| (map.routes[r].to_first_conflict(s), j);
        let listed = move |j: usize| {
            let before = |place: Candidate| place.route < r && route.apart.contains(&place.route);
            knowledge.candidates(j).any(before)
        };
        knowledge.on_route(r).filter(move |&(_, j)| !listed(j)).map(to_conflict)
    });
    let near = distances.filter(|&(u, j)| u > -2.0 * CLEARED && view.detects(j));
    w.tokens(&VEHICLE, settings.stream_vehicles, near.map(vehicle));
}
