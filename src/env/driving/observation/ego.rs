//! The agent's own speed, heading and place on its route, and what else it knows of itself.

use super::group::{FeatureGroup, SPEED, View, Writer};
use crate::env::driving::forks::Indicator;
use crate::env::spec::Described;

const MOTION: [Described; 2] = [("speed", "22.2 m/s", 0.0, 1.0), ("last_action", "1", -1.0, 1.0)];
/// In scenarios in which agents know their compass heading.
const HEADING: [Described; 2] = [("heading_cos", "1", -1.0, 1.0), ("heading_sin", "1", -1.0, 1.0)];
const PLACE: [Described; 4] = [
    ("to_conflict_far", "{far} m", -1.0, 1.0),
    ("to_conflict_near", "{near} m", -1.0, 1.0),
    ("to_arrival", "{long} m", -1.0, 1.0),
    ("lateral", "1.75 m, positive left", -1.0, 1.0),
];
/// In scenarios in which agents know the time.
const CLOCK: [Described; 1] = [("time", "share of the horizon that has passed", 0.0, 1.0)];
/// In scenarios in which agents observe where their own route goes.
const TURN: [Described; 2] =
    [("turns_left", "flag: at the next junction", 0.0, 1.0), ("turns_right", "flag", 0.0, 1.0)];

/// In scenarios with several kinds of vehicles.
const KIND: [Described; 4] = [
    ("length", "20 m", 0.0, 1.0),
    ("max_speed", "22.2 m/s", 0.0, 1.0),
    ("accel", "5 m/s²", 0.0, 1.0),
    ("brake", "15 m/s², hardest", 0.0, 1.0),
];

pub const GROUP: FeatureGroup = FeatureGroup {
    describe: |scenario, features| {
        let settings = &scenario.observation;
        let part = |shown: bool, part: &'static [Described]| if shown { part } else { &[] };
        let heading = part(settings.heading, &HEADING);
        let clock = part(settings.clock, &CLOCK);
        let turn = part(settings.own_turn, &TURN);
        let kind = part(!scenario.kinds.is_empty(), &KIND);
        features.push("ego", 1, &[&MOTION, heading, &PLACE, clock, turn, kind].concat());
    },
    write,
};

fn write(view: &View<'_>, w: &mut Writer<'_>) {
    let (own, route, scales) = (view.own(), view.route(), view.scales());
    let settings = &view.scenario.observation;
    w.put([own.speed.max(0.0) / SPEED, own.action]);
    if settings.heading {
        let (sin, cos) = own.pose.heading.sin_cos();
        w.put([cos, sin]);
    }
    let to_conflict = route.to_first_conflict(own.s);
    w.put([
        to_conflict / scales.far,
        to_conflict / scales.near,
        (own.finish(view.map) - own.s) / scales.long,
        own.lateral / 1.75,
    ]);
    if settings.clock {
        w.put([1.0 - view.time_left]);
    }
    if settings.own_turn {
        let mut passages = view.map.forks.passages[own.route].iter();
        let next = passages.find(|passage| passage.to >= own.s).map(|passage| passage.indicator);
        w.put([Indicator::Left, Indicator::Right].map(|turn| f64::from(next == Some(turn))));
    }
    if let Some((control, vehicle)) = view.abilities() {
        let hardest = control.brake.last().map_or(control.drag, |point| point.1);
        w.put([own.size[0] / 20.0, vehicle.max_speed / SPEED, control.accel / 5.0, hardest / 15.0]);
    }
}
