//! Steering control with the real simulator: the scenarios with turns, and what SUMO makes of the poses that it is given.

use std::path::Path;
use std::sync::Arc;

use iwol_sumo::env::{Driver, Task, VecEnv, VecOptions};
use iwol_sumo::evaluate::{Onlooker, Policy, evaluate};
use iwol_sumo::rng::Seed;
use iwol_sumo::scenario::Scenario;
use iwol_sumo::sumo::domain::vehicle::{Addition, Placement};
use iwol_sumo::sumo::net::Net;
use iwol_sumo::sumo::process::{Options, Process};
use iwol_sumo::sumo::{Backend, Client, Hosting};

const SCENARIOS: [(&str, u32); 3] = [("intersection_turns", 8), ("intersection_turns_small", 8), ("parking_lot", 5)];

fn task(name: &str, agents: u32) -> Arc<Task> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("scenarios/{name}.xml"));
    Arc::new(Task::new(&Scenario::load(&path).expect("the shipped scenario is valid"), agents).expect("a task"))
}

/// Where one vehicle was put after a decision.
struct Placed {
    /// Front bumper \[m\] and heading \[rad\].
    front: [f64; 2],
    heading: f64,
    route: usize,
}

/// Poses of one episode of pure pursuit, per step and slot, until each agent's end.
fn episode(task: &Arc<Task>, speed: f64, episode: u64) -> Vec<Vec<Option<Placed>>> {
    let options = VecOptions {
        worlds: 1,
        driver: Driver::Agents,
        seed: Seed::new(3),
        episodes: episode..episode + 1,
        replay: 0.0,
        hosting: Hosting { backend: Backend::Traci, ..Hosting::default() },
    };
    let mut env = VecEnv::new(task, &options).expect("SUMO runs");
    let half = task.scenario.vehicle.length / 2.0;
    let mut poses = Vec::new();
    while !env.is_finished() && poses.len() < 600 {
        let world = env.worlds().next().expect("one world");
        poses.push(
            world
                .agents()
                .map(|agent| {
                    let (sin, cos) = agent.pose.heading.sin_cos();
                    let front = [agent.pose.x + half * cos, agent.pose.y + half * sin];
                    agent.driving.then_some(Placed { front, heading: agent.pose.heading, route: agent.route })
                })
                .collect(),
        );
        let actions: Vec<f32> =
            (0..task.agents).flat_map(|i| world.pursuit(i, speed)).map(|action| action as f32).collect();
        env.step(&actions).expect("a step");
    }
    poses
}

/// Distance of a point from a polyline \[m\].
fn beside(shape: &[[f64; 2]], p: [f64; 2]) -> f64 {
    let apart = |w: &[[f64; 2]]| {
        let (dx, dy) = (w[1][0] - w[0][0], w[1][1] - w[0][1]);
        let t = ((p[0] - w[0][0]) * dx + (p[1] - w[0][1]) * dy) / (dx * dx + dy * dy);
        let t = t.clamp(0.0, 1.0);
        (p[0] - w[0][0] - t * dx).hypot(p[1] - w[0][1] - t * dy)
    };
    shape.windows(2).map(apart).fold(f64::INFINITY, f64::min)
}

#[test]
fn sumo_finds_every_vehicle_where_it_was_put() {
    for (name, agents) in SCENARIOS {
        let task = task(name, agents);
        let net = Net::load(task.net_file()).unwrap();
        let arguments = ["--net-file".into(), task.net_file().into(), "--step-length".into(), "0.1".into()].to_vec();
        let (_process, mut sumo, _) = Process::start(&Options { arguments, ..Options::default() }).unwrap();
        for (route, geometry) in task.scenario.routes.iter().zip(&task.routes) {
            let edges: Vec<&str> = geometry.path.edges.iter().map(String::as_str).collect();
            sumo.route().add(&route.id, &edges).unwrap();
        }
        let (mut compared, mut on_junction, mut stood) = (0, 0, 0);
        for number in 0..3 {
            for (t, poses) in episode(&task, 6.0, number).iter().enumerate() {
                for (slot, placed) in poses.iter().enumerate() {
                    let id = format!("e{number}s{slot}");
                    let Some(Placed { front, heading, route }) = placed else { continue };
                    let geometry = &task.routes[*route];
                    if t == 0 {
                        let lane = geometry.first_lane.to_string();
                        let s = geometry.path.nearest(*front).0.to_string();
                        let route = &task.scenario.routes[*route].id;
                        let addition = Addition { depart_lane: &lane, depart_pos: &s, ..Addition::on_route(route) };
                        sumo.vehicle().add(&id, &addition).unwrap();
                        sumo.vehicle().set_speed_mode(&id, 32).unwrap();
                        continue;
                    }
                    let angle = (90.0 - heading.to_degrees()).rem_euclid(360.0);
                    sumo.vehicle().set_speed(&id, 0.0).unwrap();
                    let keep_route = task.place(*route, *front, geometry.path.nearest(*front).2).keep_route();
                    let placement = Placement { angle, keep_route, ..Placement::default() };
                    sumo.vehicle().move_to_xy(&id, *front, &placement).unwrap();
                }
                sumo.simulation_step(0.0).unwrap();
                for (slot, placed) in poses.iter().enumerate().filter(|_| t > 0) {
                    let Some(Placed { front, route, .. }) = placed else { continue };
                    let id = format!("e{number}s{slot}");
                    let path = &task.routes[*route].path;
                    let (s, lateral, _) = path.nearest(*front);
                    // Who has missed a turn may come back against the traffic: SUMO sees vehicles drive forwards only.
                    if (placed.as_ref().map_or(0.0, |p| p.heading) - path.at(s).1).cos() < 0.5 {
                        continue;
                    }
                    let stretch = path.lane_stretches().find(|&(_, from, to)| (from..to).contains(&s));
                    let (lane, from, to) = stretch.expect("every position lies on a lane");
                    // Next to a border between lanes SUMO may take either.
                    if s - from < 0.1 || to - s < 0.1 {
                        continue;
                    }
                    let lane = &net.lanes[lane];
                    let found = sumo.vehicle().get_lane_id(&id).unwrap();
                    // Over a junction lanes lie on each other, and SUMO takes the nearest.
                    if lane.id.starts_with(':') && found != lane.id {
                        let other = net.lanes.iter().find(|other| other.id == found).expect("a lane of the net");
                        assert!(beside(&other.shape, *front) < lateral.abs() + 0.1, "{name}, step {t}: {found}");
                        continue;
                    }
                    assert_eq!(found, lane.id, "{name}, step {t}, at {front:?}");
                    let position = sumo.vehicle().get_lane_position(&id).unwrap();
                    let ours = (s - from) * lane.length / (to - from);
                    assert!(
                        (position - ours).abs() < 0.1,
                        "{name}, {}, step {t}, {id}, {front:?}: SUMO {position}, ours {ours}",
                        lane.id
                    );
                    // On the roads of its route SUMO lays a vehicle on the middle of its lane.
                    let [x, y] = sumo.vehicle().get_position(&id).unwrap();
                    let apart = (x - front[0]).hypot(y - front[1]);
                    let expected = if lane.id.starts_with(':') { 0.0 } else { lateral.abs() };
                    assert!((apart - expected).abs() < 0.1, "{name}, {}: {apart} apart, {lateral} aside", lane.id);
                    compared += 1;
                    on_junction += usize::from(lane.id.starts_with(':'));
                }
            }
            // Whoever stands still is not put anywhere any more, and stays where it is.
            let standing = sumo.vehicle().get_id_list().unwrap();
            let places = |sumo: &mut Client| {
                let place = |id: &String| sumo.vehicle().get_position(id).unwrap();
                standing.iter().map(place).collect::<Vec<_>>()
            };
            let before = places(&mut sumo);
            for _ in 0..30 {
                sumo.simulation_step(0.0).unwrap();
            }
            for (id, (a, b)) in standing.iter().zip(before.iter().zip(places(&mut sumo))) {
                assert!((a[0] - b[0]).hypot(a[1] - b[1]) < 0.1, "{name}: {id} has moved from {a:?} to {b:?}");
            }
            stood += standing.len();
        }
        assert!(stood >= 3, "{name}: {stood} vehicles stood still");
        assert!(
            compared > 500 && on_junction > 100,
            "{name}: {compared} places, {on_junction} of them on the junction"
        );
    }
}

#[test]
fn pursuit_follows_every_way_and_full_throttle_leaves_the_bends() {
    let play = |name: &str, agents: u32, policy: Policy<'static>| {
        let task = task(name, agents);
        let stop = std::sync::atomic::AtomicBool::new(false);
        let onlooker = Onlooker { stop: &stop, report: &mut |_| {}, recorder: None };
        let hosting = Hosting { backend: Backend::Traci, ..Hosting::default() };
        evaluate(&task, &policy, 24, Seed::new(5), &hosting, onlooker).expect("SUMO runs").metrics().expect("episodes")
    };
    let pursuit = play("intersection_turns_small", 4, Policy::Pursuit(5.0));
    assert_eq!(pursuit.out_of_road.mean, 0.0, "pure pursuit stays on the road");
    assert!(pursuit.success.mean > 0.3 && pursuit.crash.mean > 0.05, "{pursuit:?}");
    let straight = play("intersection_turns_small", 4, Policy::Throttle(1.0));
    assert!(straight.out_of_road.mean > 0.2, "who should turn and does not ends beside the road: {straight:?}");
    assert!(straight.success.mean < 0.4, "{straight:?}");
}
