//! Tests that no observation reveals what the scenario hides of the vehicles' routes.

use std::collections::BTreeMap;
use std::sync::Mutex;

use super::super::agents::{Candidate, Slot, Status, Traffic};
use super::super::intention::{Intentions, Knowledge};
use super::super::observation::View;
use super::super::right_of_way::{assign, inherit};
use super::*;
use crate::scenario::{Intention, Lidar, Observation, PlaceDeparture, SpawnRow};

/// Scenarios with routes that begin alike.
const FORKED: [&str; 3] = ["intersection_turns_small", "intersection_turns", "parking_lot"];
/// Number of vehicles in a scene.
const VEHICLES: usize = 8;

/// Returns a scenario with every feature group in its agents' observations.
fn full_scenario(name: &str, intention: Intention, signal_distance: f64) -> Scenario {
    let mut scenario = scenario(name);
    scenario.observation = Observation {
        groups: ObservationGroups::Both,
        neighbours: 8,
        conflict_streams: 12,
        stream_vehicles: 4,
        encounters: 8,
        foresight: 4.0,
        priority_distance: 20.0,
        borders: 3.0,
        lidar: Lidar { beams: 24, range: 50.0 },
        intention,
        signal_distance,
        ..scenario.observation
    };
    scenario
}

/// Returns the task of a scenario, which is built once and then kept.
fn task_of(name: &str, intention: Intention, signal_distance: f64) -> Arc<Task> {
    static MADE: Mutex<BTreeMap<String, Arc<Task>>> = Mutex::new(BTreeMap::new());
    let make = || {
        Arc::new(
            Task::new(&full_scenario(name, intention, signal_distance), VEHICLES as u32)
                .expect("a task"),
        )
    };
    let mut made = MADE.lock().expect("no test has panicked while it made a task");
    Arc::clone(made.entry(format!("{name} {intention:?} {signal_distance}")).or_insert_with(make))
}

/// A vehicle's route and position along it as shares of their number and of its length, its
/// lateral offset \[m\], its heading relative to the route's \[rad\], and its speed \[m/s\].
type RoutePosition = (f64, f64, f64, f64, f64);

fn place() -> impl Strategy<Value = RoutePosition> {
    (0.0..1.0, 0.0..1.0, -1.5..1.5, -0.4..0.4, -1.0..14.0)
}

/// Puts the vehicle of a slot on another route, at its present pose.
fn send(task: &Task, slot: &mut Slot, route: usize) {
    slot.route = route;
    (slot.s, slot.lateral, slot.segment) =
        task.map.routes[route].path.nearest([slot.pose.x, slot.pose.y]);
}

/// Returns traffic with a vehicle at each of these places.
fn scene(task: &Task, places: &[RoutePosition]) -> Traffic {
    let mut traffic = Traffic::new(places.len(), task.map.routes.len());
    for (k, (slot, &(route, at, lateral, turned, speed))) in
        traffic.slots.iter_mut().zip(places).enumerate()
    {
        let route = (route * task.map.routes.len() as f64) as usize;
        let path = &task.map.routes[route].path;
        let (point, heading) = path.at(at * path.length());
        let pose = Pose { heading: heading + turned, ..Pose::beside(point, heading, lateral) };
        // One in eight is a wreck.
        let status = if k % 8 == 7 { Status::Wreck } else { Status::Active };
        *slot =
            Slot { status, size: [4.515, 1.852], pose, speed, departed: true, ..Slot::default() };
        send(task, slot, route);
    }
    traffic
}

fn route(task: &Task, id: &str) -> usize {
    (0..task.map.routes.len()).find(|&k| task.map.route_id(k) == id).expect("a route")
}

/// Returns a vehicle at this position of a route.
fn vehicle(task: &Task, route: usize, at: f64) -> Slot {
    let pose = Pose::on(&task.map.routes[route].path, at);
    let mut slot = Slot { status: Status::Active, size: [4.5, 1.8], pose, ..Slot::default() };
    slot.departed = true;
    send(task, &mut slot, route);
    slot
}

fn intentions_of(task: &Task) -> Option<Intentions> {
    Intentions::new(&task.map, task.scenario.observation, task.agents, task.slots())
}

pub(super) fn view<'a>(
    task: &'a Task,
    traffic: &'a Traffic,
    knowledge: Knowledge<'a>,
    priorities: &'a [u32],
    slot: usize,
) -> View<'a> {
    let (scenario, map, knowledge) = (&task.scenario, &task.map, knowledge.to(slot));
    View {
        scenario,
        map,
        traffic,
        knowledge,
        priorities,
        time_left: 1.0,
        slot,
        kinds: &task.abilities,
    }
}

/// Returns all agents' observations, as a world makes them in the first step of an episode.
fn observe(task: &Task, traffic: &Traffic) -> Vec<Vec<f32>> {
    let mut traffic = traffic.clone();
    traffic.refresh();
    let mut intentions = intentions_of(task);
    if let Some(intentions) = &mut intentions {
        intentions.update(&task.map, &traffic, true);
    }
    let near = task.scenario.observation.priority_distance;
    assign(&mut traffic, &task.map.routes, intentions.as_ref(), near, &[]);
    let knowledge = Knowledge::public(&task.map, &traffic, intentions.as_ref());
    let (mut priorities, mut seen) =
        (Vec::new(), vec![vec![0.0; task.spec.observation.len()]; traffic.slots.len()]);
    inherit(knowledge, &mut priorities, &mut Vec::new());
    for (i, seen) in seen.iter_mut().enumerate() {
        task.observation.write(&view(task, &traffic, knowledge, &priorities, i), seen);
    }
    seen
}

/// Returns the features that differ between two sets of observations, for all agents except `but`.
fn differing(task: &Task, a: &[Vec<f32>], b: &[Vec<f32>], but: usize) -> Vec<String> {
    let mut names = Vec::new();
    for (i, (a, b)) in a.iter().zip(b).enumerate().filter(|(i, _)| *i != but) {
        let values = a.iter().zip(b).zip(&task.spec.observation.list);
        let differ = values.filter(|((a, b), _)| a.to_bits() != b.to_bits());
        names
            .extend(differ.map(|((a, b), feature)| format!("agent {i}: {} {a} {b}", feature.name)));
    }
    names
}

/// Checks that the other agents' observations do not depend on which of the routes that begin alike
/// the vehicle of slot `sent` is on.
fn hides(task: &Task, traffic: &Traffic, sent: usize) -> Result<(), TestCaseError> {
    let before = observe(task, traffic);
    for route in alike(task, traffic.slots[sent].route) {
        let mut other = traffic.clone();
        send(task, &mut other.slots[sent], route);
        let differ = differing(task, &before, &observe(task, &other), sent);
        let name = task.map.route_id(route);
        prop_assert!(differ.is_empty(), "vehicle {sent} on {name}: {differ:?}");
    }
    Ok(())
}

/// Returns the other routes that begin on the same lane as `route`.
fn alike(task: &Task, route: usize) -> Vec<usize> {
    let begin = |k: usize| task.map.routes[k].path.lanes.first();
    (0..task.map.routes.len()).filter(|&k| k != route && begin(k) == begin(route)).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]

    /// The other agents' observations do not depend on which of the routes that begin alike a
    /// vehicle is on, wherever it is.
    #[test]
    fn a_hidden_route_changes_no_observation(
        name in prop::sample::select(&FORKED[..]),
        places in prop::collection::vec(place(), VEHICLES),
        sent in 0..VEHICLES,
    ) {
        let task = task_of(name, Intention::Hidden, 30.0);
        let traffic = scene(&task, &places);
        hides(&task, &traffic, sent)?;
    }

    /// While a vehicle's indicator is not yet on, the other agents' observations do not depend on
    /// the vehicle's route.
    #[test]
    fn a_route_is_hidden_until_it_is_signalled(
        name in prop::sample::select(&FORKED[..]),
        places in prop::collection::vec(place(), VEHICLES),
        sent in 0..VEHICLES,
    ) {
        let task = task_of(name, Intention::Signalled, 2.0);
        let mut traffic = scene(&task, &places);
        // The vehicle is on its first lane, farther from the next junction than the signal
        // distance.
        let slot = &mut traffic.slots[sent];
        let path = &task.map.routes[slot.route].path;
        let end = path.lane_stretches().next().map_or(0.0, |(_, _, end)| end);
        let (point, heading) = path.at(places[sent].1 * (end - slot.size[0] / 2.0 - 3.0));
        slot.pose = Pose::beside(point, heading, places[sent].2 / 5.0);
        send(&task, slot, slot.route);
        hides(&task, &traffic, sent)?;
    }

    /// The candidates of a vehicle that is on its route contain that route, at the vehicle's
    /// position.
    #[test]
    fn a_vehicle_on_its_route_may_take_it(
        name in prop::sample::select(&FORKED[..]),
        places in prop::collection::vec(place(), VEHICLES),
    ) {
        let task = task_of(name, Intention::Hidden, 30.0);
        let places: Vec<RoutePosition> = places.iter().map(|&(r, at, lateral, h, v)| (r, at, lateral / 5.0, h, v)).collect();
        let mut traffic = scene(&task, &places);
        traffic.refresh();
        let mut intentions = intentions_of(&task).expect("something is hidden");
        intentions.update(&task.map, &traffic, true);
        let knowledge = Knowledge::public(&task.map, &traffic, Some(&intentions));
        for (j, slot) in traffic.slots.iter().enumerate() {
            let own = Candidate::of(slot);
            prop_assert!(knowledge.candidates(j).any(|one| one == own), "{own:?} of {name}");
            prop_assert!(knowledge.on_route(slot.route).any(|one| one == (slot.s, j)));
        }
    }

    /// Hiding routes changes nothing for vehicles on a lane on which only one route begins.
    #[test]
    fn a_route_that_is_the_only_one_is_known(places in prop::collection::vec(place(), VEHICLES)) {
        let of = |intention| {
            let mut scenario = full_scenario("intersection_turns_small", intention, 30.0);
            // The straight routes of all arms, then the left turn of the west arm.
            let kept = [3, 6, 9, 0, 1];
            scenario.routes = kept.iter().map(|&route| scenario.routes[route].clone()).collect();
            let row = SpawnRow { routes: [0].into(), first: 4.0, spacing: 8.0, count: 8, departure: PlaceDeparture::default() };
            scenario.nets[0].spawns = vec![row];
            Task::new(&scenario, VEHICLES as u32).expect("a task")
        };
        let [seen, hidden] = [Intention::Seen, Intention::Hidden].map(of);
        prop_assert!(intentions_of(&hidden).is_some() && intentions_of(&seen).is_none());
        // The vehicles are on one of the first three routes.
        let places: Vec<RoutePosition> = places.iter().map(|&(r, at, lateral, h, v)| (0.59 * r, at, lateral, h, v)).collect();
        let traffic = scene(&seen, &places);
        let differ = differing(&seen, &observe(&seen, &traffic), &observe(&hidden, &traffic), VEHICLES);
        prop_assert!(differ.is_empty(), "{differ:?}");
    }
}

/// Routes that are seen or signalled change the feature groups that depend on routes, so that the
/// tests above can fail; hidden routes change none.
#[test]
fn a_seen_route_changes_what_depends_on_it() {
    let places = |k: usize| -> Vec<RoutePosition> {
        let mut rng = Seed::new(k as u64).rng();
        let mut draw = |low: f64, high: f64| {
            let share = crate::rng::below(&mut rng, 10_000) as f64 / 1e4;
            low + share * (high - low)
        };
        (0..VEHICLES).map(|_| (draw(0.0, 1.0), draw(0.0, 0.6), 0.0, 0.0, draw(0.0, 10.0))).collect()
    };
    for (intention, shown) in
        [(Intention::Seen, true), (Intention::Signalled, true), (Intention::Hidden, false)]
    {
        let mut groups = HashSet::new();
        for name in FORKED {
            let task = task_of(name, intention, 30.0);
            for k in 0..40 {
                let traffic = scene(&task, &places(k));
                let before = observe(&task, &traffic);
                for route in alike(&task, traffic.slots[0].route) {
                    let mut other = traffic.clone();
                    send(&task, &mut other.slots[0], route);
                    for feature in differing(&task, &before, &observe(&task, &other), 0) {
                        let group = feature
                            .split(' ')
                            .nth(2)
                            .and_then(|name| name.split(['.', '_']).next());
                        groups.insert(
                            group
                                .unwrap_or_default()
                                .trim_end_matches(|c: char| c.is_ascii_digit())
                                .to_owned(),
                        );
                    }
                }
            }
        }
        for group in ["leader", "stream", "apart", "encounter", "free"] {
            assert_eq!(groups.contains(group), shown, "{intention:?}: {groups:?}");
        }
        assert!(
            !["ego", "neighbour", "lidar", "borders"].iter().any(|group| groups.contains(*group)),
            "{groups:?}"
        );
    }
}

/// An indicator is observed where it is on and in sight, and shows the direction at the next
/// junction.
#[test]
fn an_indicator_is_hidden_behind_another_vehicle() {
    let task = task_of("intersection_turns_small", Intention::Signalled, 30.0);
    let mut traffic = Traffic::new(VEHICLES, task.map.routes.len());
    let mut put = |k: usize, id: &str, at: f64| {
        traffic.slots[k] = vehicle(&task, route(&task, id), at);
    };
    let end =
        task.map.routes[route(&task, "west_left")].path.lane_stretches().next().expect("a lane").2;
    // Vehicle 0 is behind vehicle 1, vehicle 2 comes towards both, and vehicle 3 is behind vehicle
    // 0.
    put(0, "west_straight", end - 20.0);
    put(1, "west_left", end - 8.0);
    put(2, "east_straight", 20.0);
    put(3, "west_right", end - 29.0);
    traffic.refresh();
    let mut intentions = intentions_of(&task).expect("something is hidden");
    intentions.update(&task.map, &traffic, true);
    let known = |to: usize, of: usize| {
        let knowledge = Knowledge::public(&task.map, &traffic, Some(&intentions)).to(to);
        knowledge.candidates(of).map(|one| task.map.route_id(one.route)).collect::<Vec<_>>()
    };
    let all = ["west_straight", "west_left", "west_right"];
    assert_eq!(known(0, 1), ["west_left"]);
    assert_eq!(known(2, 1), ["west_left"], "from the front as well");
    assert_eq!(known(3, 1), all, "the first is in between");
    assert_eq!(known(1, 0), ["west_straight"], "an indicator that is off");
    let everybody = Knowledge::public(&task.map, &traffic, Some(&intentions));
    assert_eq!(everybody.candidates(1).count(), 3, "nobody's sight");
    // Beyond the detection range, and before the indicator is on.
    for (signal_distance, detection_range) in [(30.0, 5.0), (4.0, 100.0)] {
        let mut task = Task::clone(&task);
        task.scenario.observation.signal_distance = signal_distance;
        task.scenario.observation.detection_range = detection_range;
        let mut intentions = intentions_of(&task).expect("something is hidden");
        intentions.update(&task.map, &traffic, true);
        let knowledge = Knowledge::public(&task.map, &traffic, Some(&intentions)).to(0);
        assert_eq!(knowledge.candidates(1).count(), 3);
    }
}

/// Candidate routes close one after the other in the course of a left turn, and scenarios without
/// routes that begin alike hide nothing.
#[test]
fn routes_close_where_they_part() {
    let task = task_of("intersection_turns_small", Intention::Hidden, 30.0);
    let left = route(&task, "west_left");
    let path = &task.map.routes[left].path;
    let end = path.lane_stretches().next().expect("a lane").2;
    let mut intentions = intentions_of(&task).expect("something is hidden");
    let mut open = Vec::new();
    for k in 0..60 {
        let mut traffic = Traffic::new(VEHICLES, task.map.routes.len());
        traffic.slots[0] = vehicle(&task, left, end - 10.0 + f64::from(k) / 2.0);
        traffic.refresh();
        intentions.update(&task.map, &traffic, true);
        open.push(Knowledge::public(&task.map, &traffic, Some(&intentions)).candidates(0).count());
    }
    assert!(open.is_sorted_by(|a, b| a >= b), "{open:?}");
    assert!(
        open[..20].iter().all(|&count| count == 3) && open[40..].iter().all(|&count| count == 1),
        "{open:?}"
    );
    // Hiding has no effect if the route of every vehicle is the only one from its lane.
    for name in ["intersection", "mixed_cross", "pedestrians_cross"] {
        let scenario = scenario(name);
        assert_eq!(scenario.observation.intention, Intention::Hidden);
        assert!(intentions_of(&Task::new(&scenario, 8).expect("a task")).is_none(), "{name}");
    }
}

/// Over whole episodes of agents that steer, no observation depends on the route that another
/// vehicle intends to take, as long as the vehicle's actions are the same.
#[test]
fn an_intention_shows_only_in_actions() {
    let mut differences = [0; 2];
    for (seed, name) in (0..4).flat_map(|seed| FORKED.map(|name| (seed, name))) {
        for (k, intention) in [Intention::Seen, Intention::Hidden].into_iter().enumerate() {
            let task = task_of(name, intention, 30.0);
            let mut worlds = [0, 1].map(|_| ruled_world(&task, seed));
            let snapshot = Snapshot {
                vehicles: vec![Some(VehicleState { distance: 0.0, speed: 0.0 }); VEHICLES],
                ..Snapshot::default()
            };
            let mut actions = vec![0.0; 2 * VEHICLES];
            for world in &mut worlds {
                world.reset(0);
                world.act(0, &actions, &mut Vec::new());
            }
            let agents = worlds[0].agents().collect::<Vec<_>>();
            // Every second vehicle of the second world is assigned another route than the one it
            // drives.
            let mut sent = [false; VEHICLES];
            for (j, agent) in agents.iter().enumerate().filter(|(j, _)| j % 2 == 1) {
                if let Some(&route) = alike(&task, agent.route).first() {
                    worlds[1].send(j, route);
                    sent[j] = true;
                }
            }
            for step in 0..120 {
                for world in &mut worlds {
                    world.observe(0, &snapshot).expect("nothing vanishes");
                }
                let ends = |world: &World| {
                    world.agents().map(|agent| (agent.driving, agent.wreck)).collect::<Vec<_>>()
                };
                if ends(&worlds[0]) != ends(&worlds[1]) || !worlds[0].is_running() {
                    break;
                }
                let width = task.spec.observation.len();
                let [a, b] = worlds.each_ref().map(|world| world.frame().observation.chunks(width));
                for (i, (a, b)) in a.zip(b).enumerate().filter(|(i, _)| !sent[*i]) {
                    differences[k] += usize::from(a != b);
                    assert!(
                        a == b || intention == Intention::Seen,
                        "{name}, seed {seed}, step {step}, agent {i}"
                    );
                }
                worlds[0].pursue(Pursuit { speed: 6.0, gives_way: step % 40 < 30 }, &mut actions);
                for world in &mut worlds {
                    world.act(0, &actions, &mut Vec::new());
                }
            }
        }
    }
    assert!(differences[0] > 100 && differences[1] == 0, "{differences:?}");
}

/// After the first step, tracking hidden routes and writing observations allocates no memory.
#[test]
fn tracking_hidden_routes_allocates_no_memory() {
    for intention in [Intention::Hidden, Intention::Signalled] {
        let task = task_of("intersection_turns", intention, 30.0);
        let places: Vec<RoutePosition> =
            (0..VEHICLES).map(|k| (k as f64 / 8.5, 0.1 + k as f64 / 20.0, 0.0, 0.0, 5.0)).collect();
        let mut traffic = scene(&task, &places);
        let mut intentions = intentions_of(&task).expect("something is hidden");
        let (mut priorities, mut blocked) = (Vec::new(), Vec::new());
        let mut seen = vec![0.0; task.spec.observation.len()];
        let mut step = || {
            traffic.refresh();
            intentions.update(&task.map, &traffic, true);
            assign(&mut traffic, &task.map.routes, Some(&intentions), 20.0, &[]);
            let knowledge = Knowledge::public(&task.map, &traffic, Some(&intentions));
            inherit(knowledge, &mut priorities, &mut blocked);
            for i in 0..VEHICLES {
                task.observation
                    .write(&view(&task, &traffic, knowledge, &priorities, i), &mut seen);
            }
        };
        step();
        assert_eq!(allocation_counter::measure(step).count_total, 0, "{intention:?}");
    }
}
