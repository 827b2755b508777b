//! SUMO's route files as background traffic on the real SUMO: where vehicles depart and stop, what
//! is left out, and whom SUMO refuses.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use iwol_sumo::env::{BackgroundVehicle, Task, VecEnv};
use iwol_sumo::scenario::{FileTime, Scenario, Severity};
use iwol_sumo::sumo::{Backend, Hosting};

use crate::support::{agents_drive, folder, iwol, root, turn};

/// Writes a scenario with a route file of these elements; returns its path.
fn scenario(folder: &Path, traffic: &str, elements: &str) -> PathBuf {
    let text = fs::read_to_string(root().join("scenarios/mixed_cross.xml")).expect("the scenario");
    let (head, rest) = text.split_once("<traffic ").expect("it has traffic");
    let (_, tail) = rest.split_once("/>").expect("an element");
    let nets = root().join("sumo_nets/intersection").display().to_string();
    let text = format!("{head}<traffic files=\"a.rou.xml\" {traffic}/>{tail}")
        .replace("../sumo_nets/intersection", &nets);
    fs::write(folder.join("a.rou.xml"), format!("<routes>\n{elements}</routes>")).expect("a file");
    let path = folder.join("a.xml");
    fs::write(&path, text).expect("a file");
    path
}

/// Returns the background vehicles after each step in which the agents stand.
fn watch(path: &Path, steps: usize, backend: Backend) -> Vec<Vec<BackgroundVehicle>> {
    let _turn = turn(backend);
    let task = Arc::new(Task::new(&Scenario::load(path).expect("a scenario"), 4).expect("a task"));
    let hosting = Hosting { backend, ..Hosting::default() };
    let mut env = VecEnv::new(&task, &agents_drive(1, 7, hosting)).expect("SUMO runs");
    let mut seen = Vec::new();
    for _ in 0..steps {
        env.step(&vec![-1.0; task.agents]).expect("a step");
        seen.push(env.worlds().next().expect("one world").background_vehicles().collect());
    }
    seen
}

#[test]
fn vehicles_depart_and_stop_where_the_file_says() {
    let folder = folder();
    let stop = "<stop lane=\"west_out_0\" endPos=\"20\" duration=\"3\" until=\"25210\"/>";
    let path = scenario(
        folder.path(),
        "begin=\"07:00:00\"",
        &format!(
            "<route id=\"r\" edges=\"east_in west_out\"/>\
             <trip id=\"early\" depart=\"25100\" from=\"east_in\" to=\"west_out\"/>\
             <vehicle id=\"v\" depart=\"07:00:00.5\" departEdge=\"1\" departPos=\"6\" speedFactor=\"1\" route=\"r\">{stop}</vehicle>"
        ),
    );
    let mut backends = vec![Backend::Traci, Backend::Libsumo];
    backends.retain(|backend| iwol_sumo::sumo::usable(*backend).is_ok());
    let mut all = backends.into_iter().map(|backend| watch(&path, 150, backend));
    let seen = all.next().expect("over TraCI");
    assert!(all.all(|other| other == seen), "the backends have the same bits");
    let departed = seen.iter().position(|others| !others.is_empty()).expect("it departs");
    assert!((4..=7).contains(&departed), "{departed}");
    assert!(seen.iter().all(|others| others.len() <= 1), "the early one is not there");
    // The front bumper departs at 6 m of the second edge; the position is the vehicle's centre.
    let first = &seen[departed][0];
    let length = first.size[0];
    assert!((first.position + length / 2.0 - 6.0).abs() < 0.5, "{first:?}");
    let stands: Vec<usize> = (departed + 10..seen.len())
        .filter(|&step| seen[step].first().is_some_and(|other| other.speed < 0.01))
        .collect();
    let (from, to) = (stands[0], stands[stands.len() - 1]);
    assert!(to - from >= 30, "it stands for three seconds, from {from} to {to}");
    assert!((98..=104).contains(&to), "and until 10 s: {to}");
    let front = seen[from][0].position + length / 2.0;
    assert!((18.0..=20.1).contains(&front), "{front}");
}

#[test]
fn types_have_a_scale_and_routes_are_drawn() {
    let folder = folder();
    let path = scenario(
        folder.path(),
        "capacity=\"40\"",
        "<vType id=\"none\" scale=\"0\"/><vType id=\"two\" scale=\"2\"/>\
         <routeDistribution id=\"d\"><route edges=\"east_in west_out\"/><route edges=\"north_in south_out\"/></routeDistribution>\
         <flow id=\"n\" type=\"none\" period=\"1\" route=\"d\"/>\
         <flow id=\"t\" type=\"two\" period=\"1\" number=\"6\" route=\"d\" departPos=\"random_free\"/>",
    );
    let seen = watch(&path, 80, Backend::Traci);
    let most = seen.iter().map(Vec::len).max().expect("steps");
    assert!((6..=12).contains(&most), "{most}");
    let mut routes: Vec<usize> = seen.iter().flatten().map(|other| other.route).collect();
    routes.sort_unstable();
    routes.dedup();
    assert_eq!(routes.len(), 2);
}

#[test]
fn the_check_says_what_is_left_out_and_who_never_departs() {
    let folder = folder();
    let good = "<trip id=\"good\" depart=\"1\" from=\"east_in\" to=\"west_out\"/>";
    let bad =
        "\n<trip id=\"bad\" depart=\"1\" from=\"east_in\" to=\"west_out\" departSpeed=\"99\"/>";
    let path = scenario(folder.path(), "", &format!("{good}{bad}"));
    let found = Scenario::check(&path);
    let [finding] = &found.list[..] else { panic!("{:?}", found.list) };
    let line = "1 of 2 vehicles, persons and flows of the route files left out: the trip `bad` (line 3: departSpeed";
    assert_eq!((finding.severity, finding.at.map(|at| at.line)), (Severity::Warning, Some(3)));
    assert!(finding.message.starts_with(line), "{finding}");
    let evaluate =
        ["evaluate", "--policy", "throttle:-1", "--episodes", "1", "--agents", "4", "--scenario"];
    let output = iwol(&evaluate).arg(&path).output().expect("iwol runs");
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success() && said.contains(line), "{said}");
    let strict = scenario(folder.path(), "strict=\"true\"", &format!("{good}{bad}"));
    let message = Scenario::load(&strict).unwrap_err().to_string();
    assert!(
        message.contains("a.rou.xml:3:1: the trip `bad` cannot be used: departSpeed"),
        "{message}"
    );
    let late = scenario(folder.path(), "", &good.replace("\"1\"", "\"25201\""));
    let found = Scenario::check(&late);
    let [finding] = &found.list[..] else { panic!("{:?}", found.list) };
    assert!(
        finding.message.contains("nobody of the route files departs within an episode"),
        "{finding}"
    );
    let mut scenario = Scenario::load(&late).expect("a scenario");
    scenario.traffic.begin = FileTime(25_200.0);
    let task = Task::new(&scenario, 4).expect("a task");
    assert!(task.others > 0 && task.left_out().is_none());
}

/// A route file with an error has vehicles all the same, so that nothing else is said about it.
#[test]
fn an_error_in_a_route_file_is_the_only_finding() {
    let folder = folder();
    for wrong in ["depart=\"soon\"", "depart=\"1\" type=\"nowhere\""] {
        let trip = format!("\n<trip id=\"v\" {wrong} from=\"east_in\" to=\"west_out\"/>");
        let found = Scenario::check(&scenario(folder.path(), "", &trip));
        let [finding] = &found.list[..] else { panic!("{wrong}: {:?}", found.list) };
        assert_eq!(finding.severity, Severity::Error, "{finding}");
    }
}

#[test]
fn the_check_names_those_whom_sumo_refuses() {
    let folder = folder();
    // SUMO lets it be added, and drops it where the junction is too close for its speed.
    let fast =
        "\n<trip id=\"fast\" depart=\"1\" from=\"east_in\" to=\"west_out\" departSpeed=\"50\"/>";
    let path = scenario(folder.path(), "", fast);
    let output = iwol(&["scenario", "check"]).arg(&path).output().expect("iwol runs");
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    let line = "a.rou.xml:3:1: warning: 1 of 1 vehicles, persons and flows of the route files left out: the trip `fast` (line 3: SUMO drops it";
    assert!(output.status.success() && said.contains(line), "{said}");
    let strict = scenario(folder.path(), "strict=\"true\"", fast);
    let output = iwol(&["scenario", "check"]).arg(&strict).output().expect("iwol runs");
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains("a.rou.xml:3:1: error: the trip `fast` cannot be used: SUMO"), "{said}");
}

/// A vehicle that SUMO drops at its departure leaves its slot to the next one, and is named once.
#[test]
fn a_dropped_vehicle_leaves_its_slot() {
    let folder = folder();
    let good = "<trip id=\"good\" depart=\"2\" from=\"east_in\" to=\"west_out\"/>";
    let fast =
        "\n<trip id=\"fast\" depart=\"1\" from=\"east_in\" to=\"west_out\" departSpeed=\"50\"/>";
    let path = scenario(folder.path(), "capacity=\"1\"", &format!("{good}{fast}"));
    let mut backends = vec![Backend::Traci, Backend::Libsumo];
    backends.retain(|backend| iwol_sumo::sumo::usable(*backend).is_ok());
    for backend in backends {
        let seen = watch(&path, 40, backend);
        assert!(seen[39].len() == 1 && seen[15].is_empty(), "{backend:?}: {seen:?}");
    }
    let evaluate =
        ["evaluate", "--policy", "throttle:-1", "--episodes", "3", "--agents", "4", "--scenario"];
    let output = iwol(&evaluate).arg(&path).output().expect("iwol runs");
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    let times = said.matches("SUMO drops the trip fast (a.rou.xml:3)").count();
    assert!(output.status.success() && times == 1, "{said}");
}

/// A stop that SUMO refuses at run time, here on a lane that is closed to the vehicle, costs the stop
/// and neither the vehicle nor the run.
#[test]
fn a_vehicle_drives_on_without_a_stop_that_sumo_refuses() {
    let folder = folder();
    let net = root().join("sumo_nets/intersection_turns/two_lanes.net.xml");
    let net = fs::read_to_string(net).expect("a net");
    let (before, after) = net.split_once("<lane id=\"east_in_1\"").expect("a lane");
    let closed = format!("{before}<lane disallow=\"truck\" id=\"east_in_1\"{after}");
    fs::write(folder.path().join("a.net.xml"), closed).expect("a file");
    let lorry = "\n<vehicle id=\"v\" type=\"lorry\" depart=\"0\"><route edges=\"east_in west_out\"/>\
                 <stop lane=\"east_in_1\" endPos=\"40\" duration=\"300\"/></vehicle>\
                 <trip id=\"a\" depart=\"0\" from=\"west_in\" to=\"east_out\"/>";
    let path =
        scenario(folder.path(), "", &format!("<vType id=\"lorry\" vClass=\"truck\"/>{lorry}"));
    let text = fs::read_to_string(&path).expect("the scenario");
    let (head, rest) = text.split_once("<agents ").expect("agents");
    let (_, tail) = rest.split_once("</nets>").expect("nets");
    let agents = "<agents min=\"1\" max=\"4\" default=\"4\" vehicles=\"a\"/><nets><net file=\"a.net.xml\"/></nets>";
    fs::write(&path, format!("{head}{agents}{tail}")).expect("a file");
    let mut backends = vec![Backend::Traci, Backend::Libsumo];
    backends.retain(|backend| iwol_sumo::sumo::usable(*backend).is_ok());
    let mut all = backends.into_iter().map(|backend| watch(&path, 60, backend));
    let seen = all.next().expect("over TraCI");
    assert!(all.all(|other| other == seen), "the backends have the same bits");
    assert!(seen[30..].iter().flatten().any(|other| other.speed > 2.0), "it drives: {seen:?}");
    let output = iwol(&["scenario", "check"]).arg(&path).output().expect("iwol runs");
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    let line = "1 of 2 vehicles, persons and flows of the route files drive on without a stop: the vehicle `v` (line 3: SUMO refuses its stop";
    assert!(output.status.success() && said.contains(line), "{said}");
    let evaluate =
        ["evaluate", "--policy", "throttle:-1", "--episodes", "3", "--agents", "4", "--scenario"];
    let output = iwol(&evaluate).arg(&path).output().expect("iwol runs");
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    let times = said.matches("SUMO refuses a stop of the vehicle v (a.rou.xml:3)").count();
    assert!(output.status.success() && times == 1, "{said}");
}

/// At a small capacity, vehicles that have waited longer depart first, wherever they stand in the
/// file.
#[test]
fn no_flow_starves_at_a_small_capacity() {
    let folder = folder();
    let path = scenario(
        folder.path(),
        "capacity=\"1\"",
        "<flow id=\"a\" period=\"0.5\" departEdge=\"1\"><route edges=\"east_in west_out\"/></flow>\
         <flow id=\"b\" begin=\"1\" period=\"1\" departEdge=\"1\"><route edges=\"north_in south_out\"/></flow>",
    );
    let seen = watch(&path, 500, Backend::Traci);
    let routes: std::collections::BTreeSet<usize> =
        seen.iter().flatten().map(|other| other.route).collect();
    assert_eq!(routes.len(), 2, "both flows depart");
}

/// An agent whom SUMO drops leaves its slot to the next one.
#[test]
fn a_dropped_agent_leaves_its_slot() {
    let folder = folder();
    let trip = |id: &str, depart: f64, speed: &str| {
        format!(
            "<trip id=\"{id}\" depart=\"{depart}\" from=\"east_in\" to=\"west_out\" departPos=\"{speed}/>"
        )
    };
    let fast = trip("fast", 0.0, "last\" departSpeed=\"22\"");
    let good = trip("good", 1.0, "base\"");
    let path = scenario(folder.path(), "", &(fast + &good));
    let text = fs::read_to_string(&path).expect("the scenario");
    let (head, rest) = text.split_once("<agents ").expect("agents");
    let (_, tail) = rest.split_once("/>").expect("an element");
    let agents = "<agents min=\"1\" max=\"1\" default=\"1\" vehicles=\"*\"/>";
    let (head, tail) = (head.to_owned() + agents, tail.to_owned());
    let spawns = |text: String| -> String {
        text.lines().filter(|line| !line.contains("<spawn ")).collect::<Vec<_>>().join("\n")
    };
    fs::write(&path, spawns(head + &tail)).expect("a file");
    let _turn = turn(Backend::Traci);
    let task = Arc::new(Task::new(&Scenario::load(&path).expect("a scenario"), 1).expect("a task"));
    let mut env = VecEnv::new(&task, &agents_drive(1, 7, Hosting::default())).expect("SUMO runs");
    let mut active = Vec::new();
    for _ in 0..30 {
        env.step(&[0.0]).expect("a step");
        active.push(env.worlds().next().expect("one world").frame().active[0]);
    }
    assert!(active[5] == 0.0 && active[29] == 1.0, "{active:?}");
}
