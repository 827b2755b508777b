//! The observation of an agent: itself, and other vehicles in one of two ways or both, as the
//! scenario chooses.
//!
//! - `nearest`: the nearest vehicles in any direction (paper), nearest first or by bearing.
//! - `conflict`: the vehicle ahead and, for each route that crosses or merges with the agent's own,
//!   the vehicles next to the conflict point. The size of this description does not depend on the
//!   number of vehicles, and it is the same for every approach to an intersection.
//!
//! In addition, `encounters` describes one by one the vehicles that are ahead of the agent or whose
//! routes cross or merge with its own: for scenarios with many routes.
//!
//! All values are clipped to -1..=1. Padding tokens and the observations of absent agents are
//! zeros.

use std::f64::consts::PI;

use super::fcfs::{self, Free};
use super::foresight::{Course, DRIVING};
use super::intention::{Candidate, Knowledge};
use super::routes::RouteGeometry;
use super::slots::{CLEARED, Slot, Status, Traffic};
use super::task::Task;
use super::{Features, Writer, lidar};
use crate::scenario::{NeighbourOrder, Observation, Scenario};

/// Distance scale of far features \[m\].
const FAR: f64 = 50.0;
/// Distance scale of near features \[m\].
const NEAR: f64 = 15.0;
/// Speed scale \[m/s\].
pub(super) const SPEED: f64 = 22.2;
/// Number of vehicles that a count feature shows as 1.
pub(super) const COUNT: f64 = 12.0;

/// Distances along the path to the points ahead that an agent that steers observes \[m\]. Each
/// point's coordinates are in units of its distance.
const PREVIEW: [f64; 4] = [4.0, 8.0, 16.0, 32.0];

/// Features of a vehicle in the `conflict` description.
const VEHICLE: [(&str, &str, f32, f32); 5] = [
    ("to_conflict_far", "50 m", -1.0, 1.0),
    ("to_conflict_near", "15 m", -1.0, 1.0),
    ("speed", "22.2 m/s", 0.0, 1.0),
    ("moving", "flag", 0.0, 1.0),
    ("present", "flag", 0.0, 1.0),
];

/// Features of an encounter; `own_*` and `other_*` are distances to the conflict point.
const ENCOUNTER: [(&str, &str, f32, f32); 10] = [
    ("ahead", "flag: on the agent's way, own_* is the gap", 0.0, 1.0),
    ("own_far", "50 m", -1.0, 1.0),
    ("own_near", "15 m", -1.0, 1.0),
    ("other_far", "50 m", -1.0, 1.0),
    ("other_near", "15 m", -1.0, 1.0),
    ("speed", "22.2 m/s, negative backwards", -1.0, 1.0),
    ("heading_cos", "1, to the agent's", -1.0, 1.0),
    ("heading_sin", "1, left of the agent's", -1.0, 1.0),
    ("moving", "flag", 0.0, 1.0),
    ("present", "flag", 0.0, 1.0),
];

/// Foresight features of an encounter, before its last two features; only in scenarios with
/// foresight.
const FORESEEN: [(&str, &str, f32, f32); 4] = [
    (
        "close",
        "1 touching, 0 no closer than 3 m, if both keep to their routes and speeds",
        0.0,
        1.0,
    ),
    ("soon", "1 closest now, 0 at the end of the foresight", 0.0, 1.0),
    ("close_driving", "likewise, if the agent drives 6 m/s at least", 0.0, 1.0),
    ("soon_driving", "likewise", 0.0, 1.0),
];

/// Priority feature of an encounter, after the foresight features; only in scenarios that show
/// priorities.
const PRIORITY: [(&str, &str, f32, f32); 1] = [(
    "priority",
    "1 the agent has priority, -1 the other vehicle has it, 0 neither has come near",
    -1.0,
    1.0,
)];

/// Free-space features, common to all encounters.
const FREE: [(&str, &str, f32, f32); 3] = [
    (
        "free",
        "15 m, to the first conflict with a vehicle that has priority, is ahead, or is a wreck",
        0.0,
        1.0,
    ),
    ("free_slow", "the same at half the speed", 0.0, 1.0),
    ("free_blocked", "15 m, to the present position of a vehicle without priority", 0.0, 1.0),
];

/// Appends the features of encounters.
pub(super) fn describe_encounters(
    features: &mut Features,
    Encounters { count, foresight, priority: with_priority }: Encounters,
) {
    let (seen, flags) = ENCOUNTER.split_at(8);
    let foreseen: &[_] = if foresight > 0.0 { &FORESEEN } else { &[] };
    let priority: &[_] = if with_priority { &PRIORITY } else { &[] };
    features.push("encounter", count, &[seen, foreseen, priority, flags].concat());
    if with_priority {
        features.push("free", 1, &FREE);
    }
}

/// Returns the features of an observation.
pub(super) fn describe(scenario: &Scenario) -> Features {
    let settings = &scenario.observation;
    let mut features = Features::default();
    features.push(
        "ego",
        1,
        &[
            ("speed", "22.2 m/s", 0.0, 1.0),
            ("last_action", "1", -1.0, 1.0),
            ("heading_cos", "1", -1.0, 1.0),
            ("heading_sin", "1", -1.0, 1.0),
            ("to_conflict_far", "50 m", -1.0, 1.0),
            ("to_conflict_near", "15 m", -1.0, 1.0),
            ("to_arrival", "100 m", -1.0, 1.0),
            ("lateral", "1.75 m, positive left", -1.0, 1.0),
        ],
    );
    if scenario.control.steering.is_some() {
        features.push(
            "steering",
            1,
            &[
                ("last_steer", "1, positive left", -1.0, 1.0),
                ("heading_error_sin", "1, heading left of the route's", -1.0, 1.0),
                ("heading_error_cos", "1", -1.0, 1.0),
                ("yaw_rate", "1 rad/s", -1.0, 1.0),
                ("lateral_speed", "5 m/s, positive left", -1.0, 1.0),
                ("reverse_speed", "5 m/s, backwards", 0.0, 1.0),
                ("lateral_far", "10 m, positive left", -1.0, 1.0),
            ],
        );
        features.push(
            "preview",
            PREVIEW.len(),
            &[("forward", "way ahead", -1.0, 1.0), ("left", "way ahead", -1.0, 1.0)],
        );
    }
    if settings.priority_distance > 0.0 {
        features.push(
            "entry",
            1,
            &[
                ("to_entry_near", "15 m, -1 where it has entered", -1.0, 1.0),
                ("to_entry_far", "50 m, likewise", -1.0, 1.0),
            ],
        );
    }
    if settings.borders > 0.0 {
        let border = |name| (name, "1 touching, 0 at the range or further", 0.0, 1.0);
        features.push("borders", 1, &["left", "right", "left_ahead", "right_ahead"].map(border));
    }
    if settings.groups.nearest() {
        let tokens: &[_] = match settings.neighbour_order {
            NeighbourOrder::Distance => &NEIGHBOUR,
            NeighbourOrder::Bearing => &NEIGHBOUR_NEAR,
        };
        features.push("neighbour", settings.neighbours, tokens);
    }
    describe_encounters(&mut features, Encounters::of(settings));
    if settings.groups.conflict() {
        describe_streams(settings, &mut features);
    }
    lidar::describe(settings.lidar, &mut features);
    features
}

/// Appends the features of the `conflict` description.
fn describe_streams(settings: &Observation, features: &mut Features) {
    features.push(
        "leader",
        1,
        &[
            ("vehicles_ahead", "12 vehicles", 0.0, 1.0),
            ("gap_near", "10 m", -1.0, 1.0),
            ("gap_far", "50 m", -1.0, 1.0),
            ("relative_speed", "10 m/s", -1.0, 1.0),
            ("moving", "flag", 0.0, 1.0),
            ("present", "flag", 0.0, 1.0),
        ],
    );
    for stream in 0..settings.conflict_streams {
        features.push(
            &format!("stream{stream}"),
            1,
            &[
                ("own_far", "50 m", -1.0, 1.0),
                ("own_near", "15 m", -1.0, 1.0),
                ("vehicles", "12 vehicles", 0.0, 1.0),
                ("present", "flag", 0.0, 1.0),
            ],
        );
        features.push(&format!("stream{stream}_vehicle"), settings.stream_vehicles, &VEHICLE);
    }
    features.push("apart_vehicle", settings.stream_vehicles, &VEHICLE);
}

/// Features of a neighbour that is listed by distance.
const NEIGHBOUR: [(&str, &str, f32, f32); 6] = [
    ("forward", "50 m", -1.0, 1.0),
    ("left", "50 m", -1.0, 1.0),
    ("velocity_forward", "22.2 m/s", -1.0, 1.0),
    ("velocity_left", "22.2 m/s", -1.0, 1.0),
    ("moving", "flag", 0.0, 1.0),
    ("present", "flag", 0.0, 1.0),
];

/// Features of a neighbour that is listed by bearing: also distances on a scale that resolves the
/// gaps in a queue.
const NEIGHBOUR_NEAR: [(&str, &str, f32, f32); 8] = [
    NEIGHBOUR[0],
    NEIGHBOUR[1],
    ("forward_near", "15 m", -1.0, 1.0),
    ("left_near", "15 m", -1.0, 1.0),
    NEIGHBOUR[2],
    NEIGHBOUR[3],
    NEIGHBOUR[4],
    NEIGHBOUR[5],
];

/// Length of the strip ahead of a vehicle in which border lines are observed \[m\].
const BORDERS_AHEAD: f64 = 4.0;

/// Width of the sectors into which bearings to either side are grouped \[rad\]. Within a sector
/// neighbours are listed by distance: on a lane, the vehicle ahead before the one ahead of it.
const SECTOR: f64 = 15.0 * PI / 180.0;

/// Inputs of one agent's observation.
struct View<'a> {
    scenario: &'a Scenario,
    routes: &'a [RouteGeometry],
    traffic: &'a Traffic,
    knowledge: Knowledge<'a>,
    slot: usize,
}

/// Writes the observation of the agent in `slot`, `[O]`. `turns` are the priorities of all slots,
/// in scenarios that show them. `knowledge` limits what the agent observes of other vehicles'
/// routes.
pub(super) fn write(
    task: &Task,
    knowledge: Knowledge<'_>,
    priorities: &[u32],
    slot: usize,
    out: &mut [f32],
) {
    let (scenario, routes, traffic) = (&task.scenario, &task.routes[..], knowledge.traffic);
    let knowledge = knowledge.to(slot);
    let own = &traffic.slots[slot];
    let route = &routes[own.route];
    let mut w = Writer::new(out);
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
    if scenario.control.steering.is_some() {
        let error = own.pose.heading - route.path.smooth_heading(own.s);
        w.put([
            own.steer,
            error.sin(),
            error.cos(),
            own.motion.yaw_rate,
            own.motion.velocity.y / 5.0,
            (-own.speed).max(0.0) / 5.0,
            own.lateral / 10.0,
        ]);
        for ahead in PREVIEW {
            let ([x, y], _) = route.path.at(own.s + ahead);
            let (dx, dy) = (x - own.pose.x, y - own.pose.y);
            w.put([(dx * cos + dy * sin) / ahead, (dy * cos - dx * sin) / ahead]);
        }
    }
    if scenario.observation.priority_distance > 0.0 {
        let entry = fcfs::to_entry(task, own);
        w.put([NEAR, FAR].map(|scale| entry.map_or(-1.0, |distance| distance.max(0.0) / scale)));
    }
    let borders = scenario.observation.borders;
    if let Some(road) = task.road.as_ref().filter(|_| borders > 0.0) {
        w.put(road.margins(&own.pose, BORDERS_AHEAD, borders).map(|margin| 1.0 - margin / borders));
    }
    let view = View { scenario, routes, traffic, knowledge, slot };
    let groups = scenario.observation.groups;
    if groups.nearest() {
        view.put_nearest(&mut w);
    }
    put_encounters(
        &mut w,
        knowledge,
        priorities,
        slot,
        Encounters::of(&scenario.observation),
        |j| view.seen(j),
    );
    if groups.conflict() {
        view.put_leader(&mut w);
        view.put_streams(&mut w);
    }
    if let Some(road) = task.road.as_ref().filter(|_| scenario.observation.lidar.beams > 0) {
        let lidar = scenario.observation.lidar;
        lidar::write(lidar, road, traffic, slot, w.take(lidar.beams));
    }
    debug_assert_eq!(w.at, w.out.len());
}

impl View<'_> {
    /// Whether the vehicle of slot `j` is another one and within the detection range.
    fn seen(&self, j: usize) -> bool {
        j != self.slot
            && self.traffic.distance(self.slot, j) <= self.scenario.observation.detection_range
    }

    /// Writes the nearest vehicles.
    fn put_nearest(&self, w: &mut Writer) {
        let traffic = self.traffic;
        let own = &traffic.slots[self.slot];
        let (sin, cos) = own.pose.heading.sin_cos();
        let mut nearest = [(f64::INFINITY, usize::MAX); 16];
        let k = self.scenario.observation.neighbours.min(nearest.len());
        if k > 0 {
            for j in (0..traffic.slots.len())
                .filter(|&j| traffic.slots[j].status != Status::Empty && self.seen(j))
            {
                let d = traffic.distance(self.slot, j);
                if d < nearest[k - 1].0 {
                    let at = nearest[..k].partition_point(|entry| entry.0 <= d);
                    nearest[at..k].rotate_right(1);
                    nearest[at] = (d, j);
                }
            }
        }
        let by_bearing = self.scenario.observation.neighbour_order == NeighbourOrder::Bearing;
        if by_bearing {
            let sector = |&(_, j): &(f64, usize)| {
                traffic.slots.get(j).map_or(u32::MAX, |other| {
                    let (dx, dy) = (other.pose.x - own.pose.x, other.pose.y - own.pose.y);
                    ((dy * cos - dx * sin).atan2(dx * cos + dy * sin).abs() / SECTOR) as u32
                })
            };
            // The sort is stable: within a sector the nearest vehicle stays first.
            nearest[..k].sort_by_key(sector);
        }
        for &(_, j) in &nearest[..k] {
            let Some(other) = traffic.slots.get(j) else {
                w.skip(if by_bearing { NEIGHBOUR_NEAR.len() } else { NEIGHBOUR.len() });
                continue;
            };
            let (dx, dy) = (other.pose.x - own.pose.x, other.pose.y - own.pose.y);
            let (other_sin, other_cos) = other.pose.heading.sin_cos();
            let (vx, vy) = (
                other.speed * other_cos - own.speed * cos,
                other.speed * other_sin - own.speed * sin,
            );
            let (forward, left) = (dx * cos + dy * sin, dy * cos - dx * sin);
            w.put([forward / FAR, left / FAR]);
            if by_bearing {
                w.put([forward / NEAR, left / NEAR]);
            }
            w.put([
                (vx * cos + vy * sin) / SPEED,
                (vy * cos - vx * sin) / SPEED,
                moving(other.status),
                1.0,
            ]);
        }
    }

    /// Writes the nearest vehicle ahead on the agent's lanes, and how many are ahead. A vehicle
    /// whose route is hidden counts on every route that it could still take.
    fn put_leader(&self, w: &mut Writer) {
        let traffic = self.traffic;
        let own = &traffic.slots[self.slot];
        let mut ahead = 0;
        let mut leader: Option<(f64, usize)> = None;
        let route = &self.routes[own.route];
        let gap_on =
            |place: Candidate| route.shared_position(place.route, place.s).map(|s| s - own.s);
        for j in (0..traffic.slots.len())
            .filter(|&j| traffic.slots[j].status != Status::Empty && self.seen(j))
        {
            let gaps = self.knowledge.candidates(j).filter_map(gap_on).filter(|&gap| gap > 0.0);
            if let Some(gap) = gaps.min_by(f64::total_cmp) {
                ahead += 1;
                if leader.is_none_or(|(best, _)| gap < best) {
                    leader = Some((gap, j));
                }
            }
        }
        let Some((centre_gap, j)) = leader else {
            w.skip(6);
            return;
        };
        let other = &traffic.slots[j];
        let gap = centre_gap - f64::midpoint(own.size[0], other.size[0]);
        let closing = (other.speed - own.speed) / 10.0;
        w.put([
            f64::from(ahead) / COUNT,
            gap / 10.0,
            gap / FAR,
            closing,
            moving(other.status),
            1.0,
        ]);
    }

    /// Writes the vehicles next to each conflict point, and those whose routes have no conflict
    /// with the agent's. A vehicle whose route is hidden is in the stream of every route that it
    /// could still take, but only once among those without conflict.
    fn put_streams(&self, w: &mut Writer) {
        let (traffic, knowledge, settings) =
            (self.traffic, self.knowledge, &self.scenario.observation);
        let own = &traffic.slots[self.slot];
        let route = &self.routes[own.route];
        for stream in 0..settings.conflict_streams {
            let Some(conflict) = route.conflicts.get(stream) else {
                w.skip(4 + VEHICLE.len() * settings.stream_vehicles);
                continue;
            };
            let own_distance = conflict.own - own.s;
            let approaching = || {
                // Queues have the vehicle furthest along first, which is next to the conflict
                // point.
                let queue = knowledge.on_route(conflict.route);
                queue
                    .map(|(s, j)| (conflict.other - s, j))
                    .filter(|&(u, j)| u > -CLEARED && self.seen(j))
            };
            w.put([
                own_distance / FAR,
                own_distance / NEAR,
                approaching().count() as f64 / COUNT,
                1.0,
            ]);
            put_vehicles(w, traffic, approaching(), settings.stream_vehicles);
        }
        let distances = route.apart.iter().flat_map(|&r| {
            let to_conflict = move |(s, j): (f64, usize)| (self.routes[r].to_first_conflict(s), j);
            let listed = move |j: usize| {
                let before =
                    |place: Candidate| place.route < r && route.apart.contains(&place.route);
                knowledge.candidates(j).any(before)
            };
            knowledge.on_route(r).filter(move |&(_, j)| !listed(j)).map(to_conflict)
        });
        let near = distances.filter(|&(u, j)| u > -2.0 * CLEARED && self.seen(j));
        put_vehicles(w, traffic, near, settings.stream_vehicles);
    }
}

/// How many encounters are described, for how long ahead passings are foreseen \[s\] (0: not), and
/// whether priorities are shown.
#[derive(Clone, Copy)]
pub(super) struct Encounters {
    pub(super) count: usize,
    pub(super) foresight: f64,
    pub(super) priority: bool,
}

impl Encounters {
    fn of(settings: &Observation) -> Self {
        Self {
            count: settings.encounters,
            foresight: settings.foresight,
            priority: settings.priority_distance > 0.0,
        }
    }
}

/// Writes the encounters of the agent of `slot`, nearest first by the larger of both vehicles'
/// distances to their next conflict point, then the free-space features. A vehicle ahead on the
/// agent's path is flagged, and its distance is the gap. Of a vehicle's candidate routes the one
/// with the nearest encounter counts; foresight uses the one with the closest passing.
pub(super) fn put_encounters(
    w: &mut Writer,
    knowledge: Knowledge<'_>,
    priorities: &[u32],
    slot: usize,
    Encounters { count, foresight, priority: told }: Encounters,
    seen: impl Fn(usize) -> bool,
) {
    let Knowledge { routes, traffic, .. } = knowledge;
    let own = &traffic.slots[slot];
    let mut soonest = [(f64::INFINITY, 0.0, 0.0, false, usize::MAX); 16];
    let count = count.min(soonest.len());
    for (j, other) in traffic.slots.iter().enumerate().filter(|_| count > 0) {
        if j == slot || other.status == Status::Empty || !seen(j) {
            continue;
        }
        let met = knowledge
            .candidates(j)
            .filter_map(|place| meet(&routes[own.route], own, &place, other));
        // `min_by` returns the first of equal elements, so the route with the smallest number.
        let first = met.min_by(|a, b| a.0.max(a.1).total_cmp(&b.0.max(b.1)));
        let Some((own_way, other_way, ahead)) = first else { continue };
        let entry = (own_way.max(other_way), own_way, other_way, ahead, j);
        if entry.0 < soonest[count - 1].0 {
            let at = soonest[..count].partition_point(|other| other.0 <= entry.0);
            soonest[at..count].rotate_right(1);
            soonest[at] = entry;
        }
    }
    for &(_, own_way, other_way, ahead, j) in &soonest[..count] {
        let Some(other) = traffic.slots.get(j) else {
            let foreseen = if foresight > 0.0 { FORESEEN.len() } else { 0 };
            w.skip(ENCOUNTER.len() + foreseen + if told { PRIORITY.len() } else { 0 });
            continue;
        };
        let (sin, cos) = (other.pose.heading - own.pose.heading).sin_cos();
        w.put([
            f64::from(u8::from(ahead)),
            own_way / FAR,
            own_way / NEAR,
            other_way / FAR,
            other_way / NEAR,
            other.speed / SPEED,
            cos,
            sin,
        ]);
        if foresight > 0.0 {
            let at_speed = |speed| {
                knowledge.closest(Course::new(routes, own, speed), j, other.speed, foresight)
            };
            let foreseen = at_speed(own.speed);
            w.put(foreseen);
            w.put(if own.speed < DRIVING { at_speed(DRIVING) } else { foreseen });
        }
        if told {
            w.put([f64::from(priorities[j].cmp(&priorities[slot]) as i8)]);
        }
        w.put([moving(other.status), 1.0]);
    }
    if told {
        let of = |j| fcfs::free(knowledge, priorities, slot, j);
        let free = (0..traffic.slots.len()).filter(|&j| seen(j)).map(of).fold(Free::ALL, Free::min);
        w.put([free.distance, free.slow, free.blocked].map(|distance| distance / NEAR));
    }
}

/// Returns where an agent on `route` next meets another vehicle on one of that vehicle's candidate
/// routes: the distances of both to that point \[m\], and whether the other vehicle is ahead on the
/// agent's path. For a vehicle ahead, the first distance is the gap and the second 0.
fn meet(
    route: &RouteGeometry,
    own: &Slot,
    place: &Candidate,
    other: &Slot,
) -> Option<(f64, f64, bool)> {
    let ahead =
        route.shared_position(place.route, place.s).map(|s| s - own.s).filter(|way| *way > 0.0);
    if let Some(distance) = ahead {
        return Some((distance - f64::midpoint(own.size[0], other.size[0]), 0.0, true));
    }
    let met = route.next_meeting(own.s, place.route, place.s, CLEARED)?;
    Some((met.own - own.s, met.other - place.s, false))
}

/// Writes the first `count` of `vehicles` (distance to the conflict point \[m\], slot) and padding.
fn put_vehicles(
    w: &mut Writer,
    traffic: &Traffic,
    vehicles: impl Iterator<Item = (f64, usize)>,
    count: usize,
) {
    let mut written = 0;
    for (u, j) in vehicles.take(count) {
        let other = &traffic.slots[j];
        w.put([u / FAR, u / NEAR, other.speed.max(0.0) / SPEED, moving(other.status), 1.0]);
        written += 1;
    }
    w.skip((count - written) * VEHICLE.len());
}

/// Returns 1 for a vehicle that is under way and 0 for a wreck.
pub(super) fn moving(status: Status) -> f64 {
    f64::from(u8::from(status == Status::Active))
}
