//! Agents from route files on the real SUMO: reproducible on every backend and after a restart of
//! the worlds, driven by actions or by SUMO, and refused where the files do not have them.

use std::fs;
use std::sync::Arc;

use iwol_sumo::driving::Policy;
use iwol_sumo::env::{Driver, EpisodeRecord, Frame, Task, VecEnv, VecOptions};
use iwol_sumo::rng::{self, Seed};
use iwol_sumo::scenario::{PlaceDeparture, Scenario};
use iwol_sumo::sumo::{Backend, Hosting};

use crate::support::{agents_drive, folder, play, root, shipped, turn};

/// Returns a shipped scenario with agents from a route file; all vehicles that it names are agents.
fn task(name: &str, agents: u32) -> Arc<Task> {
    let mut scenario = shipped(name);
    (scenario.traffic.penetration, scenario.termination.horizon) = (1.0, 400);
    Arc::new(Task::new(&scenario, agents).expect("a task"))
}

fn options(worlds: usize, backend: Backend) -> VecOptions {
    agents_drive(worlds, 4, Hosting { backend, ..Hosting::default() })
}

/// Number of agents in tests of reproducibility.
const AGENTS: u32 = 4;

/// Plays some steps; the actions depend only on episode and step.
fn steps(env: &mut VecEnv, count: usize) -> (Vec<Vec<Frame>>, Vec<EpisodeRecord>) {
    let agents = AGENTS as usize;
    let (mut frames, mut records) = (Vec::new(), Vec::new());
    for _ in 0..count {
        let mut actions = vec![0.0; env.len() * agents];
        for (world, out) in env.worlds().zip(actions.chunks_mut(agents)) {
            let seed = Seed::new(5).index(world.episode()).index(u64::from(world.step_count()));
            rng::fill_normal(&mut seed.rng(), out);
            for action in out {
                *action = 0.5 + 0.5 * *action;
            }
        }
        env.step(&actions).expect("a step");
        frames.push(env.worlds().map(|world| world.frame().clone()).collect());
        records.extend(env.take_finished());
    }
    (frames, records)
}

#[test]
fn flows_are_the_same_on_both_backends_and_after_a_restart() {
    for name in ["flow_cross", "flow_merge"] {
        let task = task(name, AGENTS);
        let watch = |backend| {
            let _turn = turn(backend);
            let mut env = VecEnv::new(&task, &options(1, backend)).expect("SUMO runs");
            steps(&mut env, 900)
        };
        let (frames, records) = watch(Backend::Traci);
        let starts = frames[1..].iter().filter(|frame| frame[0].start.iter().sum::<f32>() == 1.0);
        assert!(starts.count() > 5 && records.len() >= 2, "agents come in the middle of episodes");
        let flow = records[0].driving().flow.expect("a flow");
        assert!(flow.departed > AGENTS, "slots are used again: {flow:?}");
        assert!(watch(Backend::Libsumo) == (frames, records), "{name} differs with libsumo");

        let options = options(2, Backend::Traci);
        let mut env = VecEnv::new(&task, &options).expect("SUMO runs");
        steps(&mut env, 530);
        let states = env.states();
        let expected = steps(&mut env, 200);
        let mut again = VecEnv::restore(&task, &options, &states).expect("SUMO runs");
        assert!(steps(&mut again, 200) == expected, "{name} differs after a restart");
    }
}

/// SUMO drives the same vehicles of the same episodes, and their sizes are those of their types.
#[test]
fn sumo_drives_the_same_demand() {
    let mut scenario = shipped("flow_merge");
    // Long enough for agents that count.
    (scenario.traffic.penetration, scenario.termination.horizon) = (1.0, 1500);
    let task = Arc::new(Task::new(&scenario, 24).expect("a task"));
    let departed = |policy: Policy<'_>| -> Vec<u32> {
        let evaluation = play(&task, &policy, 4, Seed::new(0));
        let flows = evaluation.episodes.iter().map(|record| record.driving().flow.expect("a flow"));
        flows.map(|flow| flow.departed + flow.queued).collect()
    };
    assert_eq!(departed(Policy::Sumo), departed(Policy::Throttle(0.5)));
    let metrics = play(&task, &Policy::Sumo, 4, Seed::new(0)).metrics().expect("episodes");
    let flow = metrics.driving().flow.clone().expect("a flow");
    assert_eq!(metrics.driving().crash.mean, 0.0, "SUMO's drivers do not crash");
    assert!(flow.throughput.expect("arrivals").mean > 100.0, "{flow:?}");
    assert!((0.0..30.0).contains(&flow.delay.expect("arrivals").mean), "{flow:?}");

    let options = VecOptions { driver: Driver::Sumo, ..options(1, Backend::Traci) };
    let mut env = VecEnv::new(&task, &options).expect("SUMO runs");
    let mut most = 0;
    for _ in 0..250 {
        env.step(&[0.0; 24]).expect("a step");
        let world = env.worlds().next().expect("one world");
        for agent in world.agents().filter(|agent| agent.driving) {
            let path = &task.map.routes[agent.route].path;
            assert!((-12.0..=path.length()).contains(&agent.position), "{}", agent.position);
        }
        most = most.max(world.agents().filter(|agent| agent.driving).count());
    }
    assert!(most > 3);
}

/// Returns the error of `scenarios/flow_cross.xml` when `from` is replaced by `to`.
fn mistake(from: &str, to: &str) -> String {
    let text = fs::read_to_string(root().join("scenarios/flow_cross.xml")).expect("a scenario");
    assert!(text.contains(from), "{from}");
    let nets = root().join("sumo_nets");
    let text = text.replacen(from, to, 1).replace("../sumo_nets", nets.to_str().expect("a path"));
    let folder = folder();
    let file = folder.path().join("task.xml");
    fs::write(&file, text).expect("written");
    let error = Scenario::load(&file).expect_err("a mistake");
    error.to_string().replace(&format!("{}/", folder.path().display()), "")
}

/// Agents that depart less than four times the time of their route before the horizon do not count.
#[test]
fn a_horizon_before_which_no_agent_counts_is_told() {
    let folder = folder();
    let file = folder.path().join("merge.xml");
    let text = fs::read_to_string(root().join("scenarios/flow_merge.xml")).expect("a scenario");
    let text = text.replace("../sumo_nets", &root().join("sumo_nets").display().to_string());
    let told = |horizon: &str| {
        let text = text.replace("horizon=\"1800\"", &format!("horizon=\"{horizon}\""));
        fs::write(&file, text).expect("written");
        let findings = Scenario::check(&file).list;
        findings.iter().any(|finding| finding.message.contains("never count in results"))
    };
    assert!(told("600") && !told("1800"));
}

#[test]
fn agents_that_the_files_do_not_have_are_refused() {
    insta::assert_snapshot!(mistake("types=\"car\"", "types=\"cra\""), @"task.xml:12:42: `cra` is not a valid types of <agents>, allowed: ids of vTypes or vTypeDistributions of vehicles in the files; did you mean `car`?");
    insta::assert_snapshot!(mistake("types=\"car\"", "types=\"car, bus\""), @"task.xml:12:42: `car, bus` is not a valid types of <agents>, allowed: one or more words, separated by spaces");
    insta::assert_snapshot!(mistake("types=\"car\"", "vehicles=\"from_wst\""), @"task.xml:12:42: `from_wst` is not a valid vehicles of <agents>, allowed: ids of vehicles, trips and flows of vehicles in the files, or *; did you mean `from_west`?");
    insta::assert_snapshot!(mistake(" types=\"car\"", ""), @"task.xml:16:9: <net> lacks the element `spawn`");
    insta::assert_snapshot!(mistake("files=\"../sumo_nets/flow_cross/cars.rou.xml\" ", ""), @"task.xml:12:42: `car` is not a valid types of <agents>, allowed: no value unless <traffic> has the attribute `files`");
}

/// Agents depart and arrive where the files say, whatever else they say: SUMO loses none of them.
#[test]
fn agents_arrive_where_the_files_say() {
    let folder = folder();
    let file = folder.path().join("cars.rou.xml");
    let elements = "<vType id=\"car\" length=\"4\" width=\"1.8\" scale=\"2\"/>\
        <vType id=\"bus\" vClass=\"bus\" maxSpeed=\"30\"/>\
        <route id=\"a\" edges=\"west_in east_out\"/><route id=\"b\" edges=\"south_in north_out\"/>\
        <routeDistribution id=\"any\" routes=\"a b\"/>\
        <flow id=\"early\" type=\"car\" route=\"a\" begin=\"0\" end=\"60\" period=\"1\"/>\
        <flow id=\"short\" type=\"car\" route=\"any\" begin=\"100\" period=\"12\" arrivalPos=\"20\"/>\
        <flow id=\"any\" type=\"car\" from=\"east_in\" to=\"west_out\" begin=\"100\" period=\"9\" arrivalPos=\"random\" departPos=\"random_free\" departLane=\"best\" departSpeed=\"5\"/>\
        <flow id=\"bus\" type=\"bus\" from=\"north_in\" to=\"south_out\" begin=\"101\" period=\"15\" personNumber=\"3\" arrivalPos=\"-30\" arrivalSpeed=\"3\" speedFactor=\"0.9\">\
            <stop lane=\"north_in_0\" endPos=\"40\" duration=\"20\"/><stop lane=\"south_out_0\" endPos=\"25\" duration=\"20\"/></flow>";
    fs::write(&file, format!("<routes>{elements}</routes>")).expect("written");
    let mut scenario = shipped("flow_cross");
    (scenario.agents.types, scenario.agents.vehicles) = (Vec::new(), vec!["*".into()]);
    (scenario.traffic.penetration, scenario.traffic.files) = (1.0, vec![file]);
    (scenario.traffic.begin.0, scenario.termination.horizon) = (100.0, 900);
    let task = Arc::new(Task::new(&scenario, 12).expect("a task"));
    let features = &task.spec.observation.list;
    let place = features.iter().position(|f| f.name == "ego.to_arrival").expect("a feature");
    let refused = task.refused_departures(&Hosting::default()).expect("SUMO runs");
    assert!(refused.vehicles.is_empty() && refused.stops.is_empty(), "{refused:?}");
    for driver in [Driver::Agents, Driver::Sumo] {
        let options = VecOptions { driver, ..options(1, Backend::Traci) };
        let mut env = VecEnv::new(&task, &options).expect("SUMO runs");
        let mut ended = Vec::new();
        let record = loop {
            let world = env.worlds().next().expect("one world");
            let (before, observed) =
                (world.agents().collect::<Vec<_>>(), world.frame().observation.clone());
            env.step(&[0.25; 12]).expect("SUMO loses no agent");
            let world = env.worlds().next().expect("one world");
            for (slot, (before, after)) in before.iter().zip(world.agents()).enumerate() {
                if before.driving && !after.driving && after.outcome.arrived {
                    let to_arrival = observed[slot * features.len() + place] * 100.0;
                    let route = task.map.route_id(before.route);
                    // "any" may be removed anywhere on its last edge.
                    if !route.starts_with("any ") {
                        assert!(to_arrival.abs() < 3.0, "{driver:?} {route}: {to_arrival}");
                    }
                    ended.push((task.map.route_id(before.route).to_owned(), before.position));
                }
            }
            if let Some(record) = env.take_finished().into_iter().next() {
                break record;
            }
        };
        let flow = record.driving().flow.expect("a flow");
        assert!(!record.interrupted && flow.arrived > 8, "{driver:?}: {record:?}");
        // Fronts one step before the arrival: at most 2.3 m before the place where SUMO removes them.
        for (route, half, end) in [("a ", 2.0, 117.5), ("b ", 2.0, 117.5), ("bus ", 6.0, 141.5)] {
            let here = ended.iter().filter(|(id, _)| id.starts_with(route));
            let here: Vec<f64> = here.map(|(_, position)| position + half).collect();
            let within = end - 2.3..=end + 0.1;
            assert!(here.len() > 1 && here.iter().all(|s| within.contains(s)), "{route}{here:?}");
        }
    }
}

/// Agents of spawn places that depart later keep their slots, also where agents of route files come
/// before them.
#[test]
fn slots_of_agents_that_depart_later_are_reserved() {
    let folder = folder();
    let file = folder.path().join("cars.rou.xml");
    let car = "<routes><vType id=\"car\"/><route id=\"a\" edges=\"west_in east_out\"/>\
        <vehicle id=\"v\" type=\"car\" route=\"a\" depart=\"1\"/></routes>";
    fs::write(&file, car).expect("written");
    let mut scenario = shipped("mixed_cross");
    (scenario.traffic.penetration, scenario.traffic.files) = (1.0, vec![file]);
    (scenario.agents.vehicles, scenario.termination.horizon) = (vec!["v".into()], 300);
    for row in &mut scenario.nets[0].spawns {
        row.departure = PlaceDeparture { begin: 5.0, end: 8.0, ..PlaceDeparture::default() };
    }
    let task = Arc::new(Task::new(&scenario, 4).expect("a task"));
    let played = play(&task, &Policy::Throttle(0.3), 3, Seed::new(1));
    for record in &played.episodes {
        let flow = record.driving().flow.expect("a flow");
        assert!(!record.interrupted && flow.departed == 1, "{record:?}");
    }
}

/// SUMO drops vehicles that cannot stop before a junction where they have to yield. The check names
/// their places, and an episode does not wait for them.
#[test]
fn vehicles_that_sumo_drops_at_spawn_places_are_named() {
    let mut scenario = shipped("intersection_turns_small");
    let hosting = Hosting::default();
    let with = |scenario: &mut Scenario, depart_speed: f64| {
        for row in &mut scenario.nets[0].spawns {
            row.departure = PlaceDeparture { end: 1.0, depart_speed, ..PlaceDeparture::default() };
        }
        Arc::new(Task::new(scenario, 4).expect("a task"))
    };
    let slow = with(&mut scenario, 1.0);
    assert_eq!(slow.dropped_at_places(&hosting).expect("SUMO runs"), Vec::<String>::new());
    let fast = with(&mut scenario, 13.8);
    let dropped = fast.dropped_at_places(&hosting).expect("SUMO runs");
    assert!(!dropped.is_empty() && dropped[0].contains("with 13.8 m/s"), "{dropped:?}");
    for backend in [Backend::Traci, Backend::Libsumo] {
        let _turn = turn(backend);
        let mut env = VecEnv::new(&fast, &options(1, backend)).expect("SUMO runs");
        let mut records = Vec::new();
        // Everybody who came has crossed long before the horizon of 1000 steps.
        for _ in 0..600 {
            env.step(&[0.6; 8]).expect("a step");
            records.extend(env.take_finished());
        }
        assert!(!records.is_empty(), "{backend:?}: the first episode waits");
        assert!(records.iter().all(|record| !record.interrupted), "{backend:?}: {records:?}");
    }
}
