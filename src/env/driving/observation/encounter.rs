//! The vehicles that are ahead of the agent or whose routes cross or merge with its own, nearest
//! first: in ascending order of the longer of both vehicles' distances to the conflict point.

use super::group::{FeatureGroup, SPEED, View, Writer, moving};
use crate::env::driving::agents::{Candidate, Slot, Status, cleared};
use crate::env::driving::foresight::{Course, DRIVING};
use crate::env::driving::routes::RouteGeometry;
use crate::env::spec::{Described, Features};
use crate::scenario::Observation;

/// Features of an encounter; `own_*` and `other_*` are distances to the conflict point, or to where
/// the vehicle enters or leaves the area in which it is in the way of the other.
const ENCOUNTER: [Described; 12] = [
    ("ahead", "flag: ahead on the agent's path, own_* is the gap", 0.0, 1.0),
    ("own_far", "{far} m", -1.0, 1.0),
    ("own_near", "{near} m", -1.0, 1.0),
    ("other_far", "{far} m", -1.0, 1.0),
    ("other_near", "{near} m", -1.0, 1.0),
    ("own_enters", "{near} m", -1.0, 1.0),
    ("own_leaves", "{near} m", -1.0, 1.0),
    ("other_enters", "{near} m", -1.0, 1.0),
    ("other_leaves", "{near} m", -1.0, 1.0),
    ("speed", "22.2 m/s, negative backwards", -1.0, 1.0),
    ("heading_cos", "1, to the agent's", -1.0, 1.0),
    ("heading_sin", "1, left of the agent's", -1.0, 1.0),
];

/// Foresight features of an encounter; only in scenarios with foresight.
const FORESEEN: [Described; 4] = [
    (
        "close",
        "1 touching, 0 no closer than 3 m, if both keep to their routes and speeds",
        0.0,
        1.0,
    ),
    ("soon", "1 closest now, 0 at the end of the foresight", 0.0, 1.0),
    ("close_driving", "as `close`, if the agent drives at least 6 m/s", 0.0, 1.0),
    ("soon_driving", "as `soon`, if the agent drives at least 6 m/s", 0.0, 1.0),
];

/// Priority feature of an encounter; only in scenarios whose agents observe priorities.
const PRIORITY: [Described; 1] = [(
    "priority",
    "1 the agent has priority, -1 the other vehicle has it, 0 neither has come near",
    -1.0,
    1.0,
)];

/// Last features of an encounter.
const FLAGS: [Described; 2] = [("moving", "flag", 0.0, 1.0), ("present", "flag", 0.0, 1.0)];

/// Greatest number of encounters.
const MOST: usize = 16;

/// In scenarios with encounters.
pub const GROUP: FeatureGroup = FeatureGroup {
    describe: |scenario, features| Encounters::of(&scenario.observation).describe(features),
    write: |view, w| {
        Encounters::of(&view.scenario.observation).write(view, |j| view.detects(j), w);
    },
};

/// How many encounters are described, for how long ahead passings are foreseen \[s\] (0: not), and
/// whether priorities are observed.
#[derive(Clone, Copy)]
pub struct Encounters {
    pub count: usize,
    pub foresight: f64,
    pub priority: bool,
}

/// Where an agent next meets another vehicle.
#[derive(Clone, Copy)]
struct Encounter {
    /// The agent's distance to the conflict point; the gap to a vehicle ahead \[m\].
    own: f64,
    /// The other vehicle's distance to the conflict point; 0 for a vehicle ahead \[m\].
    other: f64,
    /// Distances at which the agent enters and leaves the area of the conflict; the gap to a vehicle
    /// ahead \[m\].
    own_area: [f64; 2],
    /// Distances at which the other vehicle enters and leaves it; 0 for a vehicle ahead \[m\].
    other_area: [f64; 2],
    /// Whether the other vehicle is ahead on the agent's path.
    ahead: bool,
}

impl Encounter {
    /// Returns the distance by which encounters are ordered \[m\].
    fn distance(&self) -> f64 {
        self.own.max(self.other)
    }

    /// Returns where an agent on `route` next meets another vehicle on one of that vehicle's
    /// candidate routes.
    fn of(route: &RouteGeometry, own: &Slot, candidate: &Candidate, other: &Slot) -> Option<Self> {
        if let Some(distance) = route.gap_to_leader(own.s, candidate.route, candidate.s) {
            let gap = distance - f64::midpoint(own.size[0], other.size[0]);
            return Some(Self {
                own: gap,
                other: 0.0,
                own_area: [gap; 2],
                other_area: [0.0; 2],
                ahead: true,
            });
        }
        let left = cleared(own.size, other.size).max(cleared(other.size, own.size));
        let met = route.next_conflict(own.s, candidate.route, candidate.s, left)?;
        Some(Self {
            own: met.own - own.s,
            other: met.other - candidate.s,
            own_area: met.own_area.map(|s| s - own.s),
            other_area: met.other_area.map(|s| s - candidate.s),
            ahead: false,
        })
    }
}

impl Encounters {
    fn of(settings: &Observation) -> Self {
        Self {
            count: settings.encounters,
            foresight: settings.foresight,
            priority: settings.priority_distance > 0.0,
        }
    }

    /// Appends the features of encounters.
    pub fn describe(self, features: &mut Features) {
        let foreseen: &[_] = if self.foresight > 0.0 { &FORESEEN } else { &[] };
        let priority: &[_] = if self.priority { &PRIORITY } else { &[] };
        let token = [&ENCOUNTER[..], foreseen, priority, &FLAGS].concat();
        features.push("encounter", self.count, &token);
    }

    /// Writes the encounters with the vehicles of the slots that are `seen`, nearest first by the
    /// larger of both vehicles' distances to their next conflict point. A vehicle ahead on the
    /// agent's path is flagged, and its distance is the gap. Of a vehicle's candidate routes the one
    /// with the nearest encounter counts; foresight uses the one with the closest passing.
    pub fn write(self, view: &View<'_>, seen: impl Fn(usize) -> bool, w: &mut Writer<'_>) {
        let (own, slots, scales) = (view.own(), &view.traffic.slots, view.scales());
        let mut nearest_first: [Option<(Encounter, usize)>; MOST] = [None; MOST];
        let nearest_first = &mut nearest_first[..self.count];
        for (j, other) in slots.iter().enumerate() {
            if j == view.slot || other.status == Status::Empty || !seen(j) {
                continue;
            }
            let met = view
                .knowledge
                .candidates(j)
                .filter_map(|candidate| Encounter::of(view.route(), own, &candidate, other));
            // `min_by` returns the first of equal elements, so the route with the smallest number.
            let first = met.min_by(|a, b| a.distance().total_cmp(&b.distance()));
            let Some(met) = first else { continue };
            let nearer = |other: &Option<(Encounter, usize)>| {
                other.is_some_and(|(other, _)| other.distance() <= met.distance())
            };
            let at = nearest_first.partition_point(nearer);
            if at < nearest_first.len() {
                nearest_first[at..].rotate_right(1);
                nearest_first[at] = Some((met, j));
            }
        }
        let mut written = 0;
        for &(met, j) in nearest_first.iter().flatten() {
            let other = &slots[j];
            let (sin, cos) = (other.pose.heading - own.pose.heading).sin_cos();
            w.put([
                f64::from(u8::from(met.ahead)),
                met.own / scales.far,
                met.own / scales.near,
                met.other / scales.far,
                met.other / scales.near,
                met.own_area[0] / scales.near,
                met.own_area[1] / scales.near,
                met.other_area[0] / scales.near,
                met.other_area[1] / scales.near,
                other.speed / SPEED,
                cos,
                sin,
            ]);
            if self.foresight > 0.0 {
                let at_speed = |speed| {
                    let course = Course::new(&view.map.routes, own, speed);
                    view.knowledge.closest(course, j, other.speed, self.foresight)
                };
                let foreseen = at_speed(own.speed);
                w.put(foreseen);
                w.put(if own.speed < DRIVING { at_speed(DRIVING) } else { foreseen });
            }
            if self.priority {
                let order = view.priorities[j].cmp(&view.priorities[view.slot]);
                w.put([f64::from(order as i8)]);
            }
            w.put([moving(other.status), 1.0]);
            written += 1;
        }
        w.skip((self.count - written) * self.width());
    }

    /// Returns the number of features of one encounter.
    fn width(self) -> usize {
        let foreseen = if self.foresight > 0.0 { FORESEEN.len() } else { 0 };
        let priority = if self.priority { PRIORITY.len() } else { 0 };
        ENCOUNTER.len() + foreseen + priority + FLAGS.len()
    }
}
