//! Agents that change lanes on the real SUMO: where their route needs another lane, by their
//! actions, and what they observe of the lanes beside them.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use iwol_sumo::driving::Policy;
use iwol_sumo::env::{Driver, Frame, Pursuit, Task, VecEnv, World};
use iwol_sumo::rng::{self, Seed};
use iwol_sumo::scenario::author::import_configuration;
use iwol_sumo::scenario::{LaneChange, Scenario};
use iwol_sumo::sumo::domain::vehicle::Addition;
use iwol_sumo::sumo::net::Net;
use iwol_sumo::sumo::process::{Options, Process};
use iwol_sumo::sumo::{
    Backend, Body, Client, Command, Hosting, Installation, Snapshot, VehicleState,
};

use super::authoring::run;
use crate::support::{agents_drive, folder, play, shipped, turn};

/// A road of two lanes that forks: only the left lane leads on, only the right lane leads off.
const NODES: &str = r#"<nodes>
    <node id="west" x="0" y="0"/><node id="middle" x="200" y="0"/><node id="fork" x="400" y="0"/>
    <node id="east" x="600" y="0"/><node id="south" x="500" y="-100"/>
</nodes>"#;
const EDGES: &str = r#"<edges>
    <edge id="in" from="west" to="middle" numLanes="2" speed="20"/>
    <edge id="mid" from="middle" to="fork" numLanes="2" speed="20"/>
    <edge id="on" from="fork" to="east" numLanes="1" speed="20"/>
    <edge id="off" from="fork" to="south" numLanes="1" speed="20"/>
</edges>"#;
const CONNECTIONS: &str = r#"<connections>
    <connection from="in" to="mid" fromLane="0" toLane="0"/>
    <connection from="in" to="mid" fromLane="1" toLane="1"/>
    <connection from="mid" to="on" fromLane="1" toLane="0"/>
    <connection from="mid" to="off" fromLane="0" toLane="0"/>
</connections>"#;

/// Writes the net and a scenario with agents on routes that begin on the wrong lane; `more` are
/// attributes of `<control>`, `files` stands before the end of the scenario.
fn forked(folder: &Path, more: &str, files: &str) -> PathBuf {
    forked_at(folder, NODES, more, files)
}

/// Does the same with these nodes.
fn forked_at(folder: &Path, nodes: &str, more: &str, files: &str) -> PathBuf {
    let sources = [("node", nodes), ("edge", EDGES), ("connection", CONNECTIONS)];
    let mut arguments = Vec::new();
    for (kind, text) in sources {
        fs::write(folder.join(format!("fork.{kind}.xml")), text).unwrap();
        arguments.extend([format!("--{kind}-files"), format!("fork.{kind}.xml")]);
    }
    arguments.extend(["--no-turnarounds", "-o", "fork.net.xml"].map(String::from));
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    run("netconvert", &arguments, folder).unwrap();
    let (agents, places) = if files.is_empty() {
        (
            "",
            r#"<spawn route="on" first="15" spacing="60" count="2"/>
               <spawn route="off" first="45" spacing="60" count="2"/>"#,
        )
    } else {
        (r#" vehicles="*""#, "")
    };
    let text = format!(
        r#"<scenario name="fork">
    <description>Agents change to the lane of their route.</description>
    <agents min="1" max="4" default="4"{agents}/>
    <routes>
        <route id="on" edges="in mid on" lane="0" arrivalPos="-5"/>
        <route id="off" edges="in mid off" lane="1" arrivalPos="-5"/>
    </routes>
    <nets><net file="fork.net.xml">{places}</net></nets>
    <vehicle length="4.5" width="1.8" maxSpeed="20"/>
    <jitter longitudinal="2" lateral="0"/>
    <control mode="throttle" interval="0.1" accel="2.9" drag="0.4" brake="1:9" {more}/>
    <observation groups="conflict" detectionRange="100" neighbours="4" conflictStreams="1" streamVehicles="2"/>
    <reward progress="1" speed="0.1" arrive="10" outOfRoad="-10" crash="-10" cooperation="0.1"/>
    <termination horizon="1000" wreckTime="2.5"/>
    <communication range="100"/>
    {files}
</scenario>"#
    );
    let text = if files.is_empty() {
        text
    } else {
        let from = text.find("<routes>").unwrap();
        let to = text.find("</routes>").unwrap() + "</routes>".len();
        format!("{}{}", &text[..from], &text[to..])
    };
    let file = folder.join("fork.xml");
    fs::write(&file, text).unwrap();
    file
}

fn task(file: &Path, agents: u32) -> Arc<Task> {
    Arc::new(Task::new(&Scenario::load(file).expect("a scenario"), agents).expect("a task"))
}

/// Returns the road with two lanes of `scenarios/overtaking.xml`, without slow vehicles.
fn road(agents: u32, change: LaneChange) -> Arc<Task> {
    let mut scenario = shipped("overtaking");
    (scenario.traffic.penetration, scenario.agents.min) = (1.0, 1);
    (scenario.jitter.lateral, scenario.control.lane_change) = (0.0, change);
    Arc::new(Task::new(&scenario, agents).expect("a task"))
}

/// Everyone drives at 10 m/s, and gives way.
fn steady() -> Policy<'static> {
    Policy::Pursuit(Pursuit { speed: 10.0, gives_way: true })
}

#[test]
fn sumo_changes_to_the_lane_that_the_route_needs() {
    let folder = folder();
    let task = task(&forked(folder.path(), r#"laneChange="route""#, ""), 4);
    let evaluation = play(&task, &steady(), 4, Seed::new(3));
    let metrics = evaluation.metrics().expect("episodes");
    assert_eq!((metrics.success.mean, metrics.driving().crash.mean), (1.0, 0.0), "{metrics:?}");
    // Everybody drives as far as on the right lane, whatever the route that they are on is called.
    let reward = metrics.reward.mean;
    assert!((500.0..600.0).contains(&reward), "progress from 15..105 m to 595 m, and 10: {reward}");

    // An agent that keeps the wrong lane stands at its end.
    let folder = crate::support::folder();
    let asked = self::task(&forked(folder.path(), r#"laneChange="action""#, ""), 4);
    let metrics = play(&asked, &steady(), 2, Seed::new(3)).metrics().expect("episodes");
    assert_eq!((metrics.success.mean, metrics.driving().crash.mean), (0.0, 0.0), "{metrics:?}");
}

#[test]
fn sumos_driver_changes_lanes_where_agents_may() {
    let folder = folder();
    let task = task(&forked(folder.path(), r#"laneChange="action""#, ""), 4);
    let metrics = play(&task, &Policy::Sumo, 3, Seed::new(3)).metrics().expect("episodes");
    assert_eq!((metrics.success.mean, metrics.driving().crash.mean), (1.0, 0.0), "{metrics:?}");
}

#[test]
fn a_route_with_a_lane_change_is_refused_where_agents_keep_their_lanes() {
    let folder = folder();
    let error = Scenario::load(&forked(folder.path(), "", "")).expect_err("it needs a lane change");
    let hint = error.hint().expect("a hint");
    assert!(error.to_string().contains("fork.xml:5:"), "{error}");
    assert!(hint.contains("laneChange"), "{hint}");
    let wrong = forked(folder.path(), r#"laneChange="rout""#, "");
    let error = Scenario::load(&wrong).expect_err("no such value").to_string();
    assert!(error.contains("laneChange") && error.contains("route"), "{error}");
}

/// Writes a route file in which vehicles begin on the wrong lanes, one every `gap` seconds and on
/// alternate routes; returns the element that names it.
fn flows(folder: &Path, gap: u32) -> &'static str {
    let flow = |id: &str, lane: u32| {
        let (begin, period) = (lane * gap, 2 * gap);
        format!(
            r#"<flow id="{id}" type="car" from="in" to="{id}" begin="{begin}" period="{period}" departLane="{lane}" departSpeed="5"/>"#
        )
    };
    let text = format!(
        r#"<routes><vType id="car" length="4.5" maxSpeed="15"/>{}{}</routes>"#,
        flow("on", 0),
        flow("off", 1)
    );
    fs::write(folder.join("flows.rou.xml"), text).unwrap();
    r#"<traffic files="flows.rou.xml" capacity="12"/>"#
}

#[test]
fn agents_of_route_files_change_lanes_or_are_left_out_with_a_hint() {
    let folder = folder();
    let files = flows(folder.path(), 12);
    let error = Scenario::load(&forked(folder.path(), "", files)).expect_err("nobody is left");
    let text = error.to_string();
    assert!(text.contains("flow `on`") && text.contains("laneChange of <control>"), "{text}");

    let file = forked(folder.path(), r#"laneChange="route""#, files);
    let mut scenario = Scenario::load(&file).expect("a scenario");
    scenario.termination.horizon = 1000;
    let task = Arc::new(Task::new(&scenario, 4).expect("a task"));
    assert_eq!(task.left_out(), None);
    let fast = Policy::Pursuit(Pursuit { speed: 15.0, gives_way: true });
    let episodes = play(&task, &fast, 2, Seed::new(3)).episodes;
    let flows = episodes.iter().map(|record| record.driving().flow.expect("a flow"));
    assert!(flows.clone().all(|flow| flow.arrived >= 4), "{:?}", flows.collect::<Vec<_>>());
    assert!(episodes.iter().all(|record| record.driving().crash == 0.0), "nobody crashes");

    // Vehicles that SUMO drives change lanes in any case.
    let text = fs::read_to_string(&file).unwrap().replace(r#" laneChange="route""#, "");
    let text = text.replace(r#" vehicles="*""#, "").replace(
        r#"<net file="fork.net.xml"></net>"#,
        r#"<net file="fork.net.xml"><spawn route="straight" first="100" spacing="30" count="1"/></net>"#,
    );
    let text = text.replace(r#"max="4" default="4""#, r#"max="1" default="1""#).replace(
        "<nets>",
        r#"<routes><route id="straight" edges="in mid on" lane="1" arrivalPos="-5"/></routes><nets>"#,
    );
    fs::write(&file, text).unwrap();
    let task = self::task(&file, 1);
    assert_eq!(task.left_out(), None);
    let mut env = VecEnv::new(&task, &agents_drive(1, 3, Hosting::default())).expect("SUMO runs");
    let mut furthest = 0.0_f64;
    for _ in 0..600 {
        env.step(&[-1.0]).expect("a step");
        let world = env.worlds().next().expect("one world");
        furthest = world.background_vehicles().map(|other| other.pose.x).fold(furthest, f64::max);
    }
    assert!(furthest > 420.0, "they pass the fork: {furthest}");
}

/// SUMO's lane changes take no time, so that nobody is between two lanes: a vehicle that pulls out of
/// a queue does not sweep over the one ahead.
#[test]
fn lane_changes_of_sumos_driver_are_no_collisions() {
    let folder = folder();
    let game = Installation::find().unwrap().home().unwrap().join("tools/game");
    fs::create_dir(folder.path().join("bs3d")).unwrap();
    for file in ["bs3d.sumocfg", "input_additional.add.xml", "bs3d/bs.net.xml", "bs3d/bs3d.rou.xml"]
    {
        fs::copy(game.join(file), folder.path().join(file)).unwrap();
    }
    let configuration = folder.path().join("bs3d.sumocfg");
    let imported =
        import_configuration(folder.path(), "braunschweig", &configuration, None).unwrap();
    let scenario = Scenario::load(&imported.scenario).unwrap();
    let task = Arc::new(Task::new(&scenario, scenario.agents.default).unwrap());
    let episodes = play(&task, &Policy::Sumo, 2, Seed::new(1).child("evaluation")).episodes;
    let collisions: Vec<u32> =
        episodes.iter().map(|record| record.driving().own_collisions).collect();
    assert_eq!(collisions, [0, 0]);
}

#[test]
fn a_request_ends_on_the_lane_that_it_asks_for() {
    let task = road(1, LaneChange::Action);
    assert_eq!(task.spec.actions.names(), ["throttle", "lane"]);
    let mut env = VecEnv::new(&task, &agents_drive(1, 3, Hosting::default())).expect("SUMO runs");
    let mut step = |asked: f32| {
        env.step(&[0.4, asked]).expect("a step");
        let world = env.worlds().next().expect("one world");
        let agent = world.agents().next().expect("one agent");
        let observed = |name: &str| observed(&task, world.frame(), 0, name);
        assert_eq!(observed("lane_left.present") + observed("lane_right.present"), 1.0);
        (if agent.pose.y > -3.5 { "left" } else { "right" }, observed("lane.lane_time"), agent)
    };
    let (begin, ..) = step(0.0);
    let (to, back) = if begin == "left" { (-1.0, 1.0) } else { (1.0, -1.0) };
    let other = if begin == "left" { "right" } else { "left" };
    assert_eq!(step(back).0, begin, "at the border, a request is keep");
    assert_eq!(step(to / 4.0).0, begin, "a value near 0 is keep");
    let before = step(0.0).2;
    let (lane, left, after) = step(to);
    assert_eq!((lane, left), (other, 1.0));
    assert!((after.pose.y - before.pose.y - f64::from(to) * 3.5).abs() < 1e-9, "{after:?}");
    // The progress is that of the vehicle, not that of the routes by lane.
    assert!((after.reward - before.reward).abs() < 0.3, "{} {}", after.reward, before.reward);
    for k in 1..30 {
        let (lane, left, _) = step(back);
        assert_eq!(lane, other, "step {k}");
        assert!((left - (1.0 - k as f32 / 30.0)).abs() < 1e-5, "{left}");
    }
    assert_eq!(step(back).0, begin, "after 3 s");
}

/// The privileged state has the vehicles ahead on the agent's lane, whatever routes they are given and
/// wherever they have changed lanes.
#[test]
fn the_state_has_all_vehicles_of_the_lane() {
    let folder = folder();
    let task = task(&forked(folder.path(), r#"laneChange="route""#, ""), 4);
    let names: Vec<_> = task.spec.state.list.iter().map(|feature| feature.name.as_str()).collect();
    let width = names.len();
    let at = |name: &str| names.iter().position(|known| *known == name).expect("such a feature");
    let (ahead, behind) = (at("lane_ahead_0.distance"), at("lane_behind_0.distance"));
    let mut env = VecEnv::new(&task, &agents_drive(1, 3, Hosting::default())).expect("SUMO runs");
    let mut compared = [0; 2];
    for _ in 0..250 {
        env.step(&[0.3, 0.35, 0.4, 0.45]).expect("a step");
        let world = env.worlds().next().expect("one world");
        let agents: Vec<_> = world.agents().collect();
        // On the two edges before the fork, everybody on a lane has to pass the same lane.
        let on_road = |k: &usize| agents[*k].driving && agents[*k].pose.x < 380.0;
        for own in (0..4).filter(on_road) {
            let others = (0..4)
                .filter(on_road)
                .filter(|&k| k != own && (agents[k].pose.y - agents[own].pose.y).abs() < 1.0);
            let gaps: Vec<f64> = others.map(|k| agents[k].pose.x - agents[own].pose.x).collect();
            let nearest = |sign: f64| {
                gaps.iter().map(|gap| sign * gap).filter(|gap| *gap > 0.0).min_by(f64::total_cmp)
            };
            for (side, (at, sign)) in [(ahead, 1.0), (behind, -1.0)].into_iter().enumerate() {
                // Vehicles beyond the fork may be the nearest ones further away.
                let Some(gap) = nearest(sign).filter(|gap| *gap < 45.0) else { continue };
                let state = f64::from(world.frame().state[own * width + at]) * 50.0 * sign;
                assert!((state - gap).abs() < 0.1, "agent {own}: {state} m, not {gap} m");
                compared[side] += 1;
            }
        }
    }
    assert!(compared.iter().all(|&count| count > 40), "{compared:?}");
}

/// Where a lane change leads to another signal, the agent observes that one, and passing it counts
/// as it does without a lane change.
#[test]
fn signals_are_those_of_the_lane_after_a_lane_change() {
    let folder = folder();
    let nodes = NODES.replace(r#"y="0"/>"#, r#"y="0" type="traffic_light"/>"#);
    let file = forked_at(folder.path(), &nodes, r#"laneChange="action""#, "");
    let net = folder.path().join("fork.net.xml");
    let text = fs::read_to_string(&net).unwrap();
    // The first traffic light is always green.
    let phases = |id: &str| match id {
        "fork" => {
            r#"<phase duration="6" state="rG"/><phase duration="5" state="Gr"/><phase duration="4" state="rr"/>"#
        }
        _ => r#"<phase duration="60" state="GG"/>"#,
    };
    let mut parts = text.split(r#"<tlLogic id=""#);
    let mut changed = parts.next().unwrap().to_owned();
    for part in parts {
        let (from, to) = (part.find("<phase").unwrap(), part.find("</tlLogic>").unwrap());
        let phases = phases(part.split('"').next().unwrap());
        changed.extend([r#"<tlLogic id=""#, &part[..from], phases, &part[to..]]);
    }
    fs::write(&net, changed).unwrap();
    let task = task(&file, 4);
    let net = Net::load(&net).unwrap();
    let line = net.lanes.iter().find(|lane| lane.id == "mid_0").unwrap().shape[1][0];
    let link = |lane: &str| {
        let mut all = net.connections.iter().filter(|join| net.lanes[join.from].id == lane);
        all.find_map(|join| join.signal).expect("a signal").index
    };
    let links = [("off", link("mid_0")), ("on", link("mid_1"))];
    let half = task.scenario.vehicle.length / 2.0;
    let mut env = VecEnv::new(&task, &agents_drive(1, 3, Hosting::default())).expect("SUMO runs");
    let (mut red, mut passed, mut seen, mut records) = (0, 0, [0; 2], Vec::new());
    let mut fronts = [f64::INFINITY; 4];
    while records.len() < 4 {
        // They ask for their lanes between the two signals.
        let world = env.worlds().next().expect("one world");
        let actions: Vec<f32> = (world.agents())
            .flat_map(|agent| {
                let side = if task.map.route_id(agent.route) == "on" { 1.0 } else { -1.0 };
                [0.5, if agent.pose.x > 215.0 { side } else { 0.0 }]
            })
            .collect();
        env.step(&actions).expect("a step");
        let world = env.worlds().next().expect("one world");
        let state = world.traffic_lights().nth(1).expect("two traffic lights").as_bytes();
        for (own, agent) in world.agents().enumerate() {
            let front = agent.pose.x + half;
            let before = std::mem::replace(&mut fronts[own], front);
            // A new episode begins before the lines.
            if !agent.driving || agent.pose.x < 210.0 {
                continue;
            }
            // The route needs one of the lanes, wherever the agent is now.
            let name = task.map.route_id(agent.route);
            let needed = links.iter().position(|link| link.0 == name).expect("such a route");
            let letter = state[links[needed].1];
            if (before..front).contains(&line) {
                passed += 1;
                red += usize::from(letter == b'r');
            }
            let of = |name: &str| observed(&task, world.frame(), own, &format!("signal.{name}"));
            if front < line && of("present") > 0.0 {
                let distance = f64::from(of("to_line_far")) * 50.0;
                assert!((distance - (line - front).min(50.0)).abs() < 0.01, "{distance} m");
                assert_eq!(
                    [of("red"), of("priority")],
                    [b'r', b'G'].map(|l| f32::from(letter == l))
                );
                let is_there = (agent.pose.y > -3.2) == (name == "on");
                seen[usize::from(is_there)] += 1;
            }
            assert!(front < line || of("present") == 0.0, "one line");
        }
        records.extend(env.take_finished());
    }
    let counted: f64 =
        records.iter().map(|record| 4.0 * record.driving().red_lights.expect("signals")).sum();
    assert!((counted - f64::from(red as u32)).abs() < 1e-9, "{counted} counted, {red} of {passed}");
    assert!(
        red > 0 && passed > red && seen.iter().all(|&count| count > 50),
        "{red} {passed} {seen:?}"
    );
}

/// Returns a feature of the observation of an agent.
fn observed(task: &Task, frame: &Frame, agent: usize, name: &str) -> f32 {
    let list = &task.spec.observation.list;
    let at = list.iter().position(|feature| feature.name == name).expect("such a feature");
    frame.observation[agent * list.len() + at]
}

/// A SUMO process of the test's own, on which the commands of a world of the road are played.
struct Own {
    _process: Process,
    sumo: Client,
    task: Arc<Task>,
    net: Net,
    departed: Vec<f64>,
}

impl Own {
    fn start(task: &Arc<Task>) -> Self {
        let mut arguments = vec!["--net-file".into(), task.map.net_file().into()];
        let options = "--step-length 0.1 --collision.action none --time-to-teleport -1";
        arguments.extend(options.split(' ').map(Into::into));
        let (process, mut sumo, _) =
            Process::start(&Options { arguments, ..Options::default() }).unwrap();
        for route in &task.scenario.routes {
            sumo.route().add(&route.id, &route.edges).unwrap();
        }
        let net = Net::load(task.map.net_file()).unwrap();
        let departed = vec![0.0; task.agents];
        Self { _process: process, sumo, task: Arc::clone(task), net, departed }
    }

    fn play(&mut self, commands: &[Command]) -> Snapshot {
        let vehicle = |slot: u32| format!("v{slot}");
        for command in commands {
            let mut vehicles = self.sumo.vehicle();
            match *command {
                Command::Add { slot, route, depart_pos, .. } => {
                    let route = &self.task.scenario.routes[route as usize];
                    let lane = route.lane.expect("a lane").to_string();
                    let pos = depart_pos.to_string();
                    let (depart_lane, depart_pos_text) = (lane.as_str(), pos.as_str());
                    let addition = Addition {
                        depart_lane,
                        depart_pos: depart_pos_text,
                        ..Addition::on_route(&route.id)
                    };
                    self.departed[slot as usize] = depart_pos;
                    vehicles.add(&vehicle(slot), &addition).unwrap();
                    let length = self.task.scenario.vehicle.length;
                    vehicles.set_length(&vehicle(slot), length).unwrap();
                    vehicles.set_min_gap(&vehicle(slot), 0.0).unwrap();
                }
                Command::SetSpeed { slot, speed, .. } => {
                    vehicles.set_speed(&vehicle(slot), speed).unwrap();
                }
                Command::SpeedMode { slot, mode, .. } => {
                    vehicles.set_speed_mode(&vehicle(slot), mode).unwrap();
                }
                Command::LaneChangeMode { slot, mode, .. } => {
                    vehicles.set_lane_change_mode(&vehicle(slot), mode).unwrap();
                }
                Command::ChangeLane { slot, lane, .. } => {
                    vehicles.change_lane(&vehicle(slot), lane as i8, 0.0).unwrap();
                }
                ref other => panic!("{other:?}"),
            }
        }
        self.sumo.simulation_step(0.0).unwrap();
        let (mut states, mut bodies) = (Vec::new(), Vec::new());
        for slot in 0..self.task.agents as u32 {
            let (name, mut vehicles) = (vehicle(slot), self.sumo.vehicle());
            let distance = self.departed[slot as usize] + vehicles.get_distance(&name).unwrap();
            let speed = vehicles.get_speed(&name).unwrap();
            states.push(Some(VehicleState { distance, speed }));
            let [x, y] = vehicles.get_position(&name).unwrap();
            let heading = (90.0 - vehicles.get_angle(&name).unwrap()).to_radians();
            let id = vehicles.get_lane_id(&name).unwrap();
            let lane = self.net.lanes.iter().position(|lane| lane.id == id).map(|at| at as u32);
            bodies.push(Some(Body { x, y, heading, lane, time_loss: 0.0 }));
        }
        Snapshot { vehicles: states, bodies, ..Snapshot::default() }
    }
}

/// The gaps to the vehicles on the lanes beside an agent are those that SUMO reports.
#[test]
fn observed_gaps_are_sumos() {
    let task = road(8, LaneChange::Action);
    let mut own = Own::start(&task);
    let mut world = World::new(Arc::clone(&task), Driver::Agents, Seed::new(11), 0, 1, u64::MAX);
    world.reset(0);
    let mut rng = Seed::new(4).rng();
    let (mut compared, mut beside) = (0, 0);
    let mut actions = vec![0.0; 16];
    for step in 0..150 {
        rng::fill_normal(&mut rng, &mut actions);
        for pair in actions.chunks_mut(2) {
            // Changes are rare, and nobody stands.
            pair[0] = 0.3 + 0.3 * pair[0];
            pair[1] *= 0.2;
        }
        let mut commands = Vec::new();
        world.act(0, &actions, &mut commands);
        // A wreck would be removed; the gaps are compared before that.
        if commands.iter().any(|command| matches!(command, Command::Remove { .. })) {
            break;
        }
        let snapshot = own.play(&commands);
        world.observe(0, &snapshot).expect("nobody vanishes");
        let frame = world.frame();
        for agent in (0..8).filter(|agent| frame.active[*agent] > 0.0) {
            for (side, mode) in [("lane_left", 0), ("lane_right", 1)] {
                for (who, ahead) in [("leader", 2), ("follower", 0)] {
                    let reported = own
                        .sumo
                        .vehicle()
                        .get_neighbors(&format!("v{agent}"), mode | ahead)
                        .unwrap();
                    let of =
                        |what: &str| observed(&task, frame, agent, &format!("{side}.{who}{what}"));
                    let gap = f64::from(of("_gap_far")) * 50.0;
                    let nearest = reported.iter().map(|neighbour| neighbour.gap);
                    let nearest = nearest.min_by(f64::total_cmp);
                    match nearest {
                        // SUMO counts whoever is beside the agent as follower and leader.
                        Some(sumo) if sumo < 0.0 => beside += 1,
                        Some(sumo) if sumo < 50.0 => {
                            assert!((gap - sumo).abs() < 1e-3, "step {step}: {gap} m, not {sumo}");
                            compared += 1;
                        }
                        Some(_) => assert!(gap == 0.0 || gap > 49.9, "step {step}: {gap} m"),
                        None => assert_eq!(of(""), 0.0, "step {step}: nobody is there"),
                    }
                }
            }
        }
    }
    assert!(compared > 200 && beside > 0, "{compared} {beside}");
}

/// Plays some steps with requests in all directions; the actions depend only on episode and step.
fn steps(env: &mut VecEnv, task: &Task, count: usize) -> Vec<Vec<Frame>> {
    let width = task.agents * task.spec.actions.len();
    let mut frames = Vec::new();
    for _ in 0..count {
        let mut actions = vec![0.0; env.len() * width];
        for (world, out) in env.worlds().zip(actions.chunks_mut(width)) {
            let seed = Seed::new(5).index(world.episode()).index(u64::from(world.step_count()));
            rng::fill_normal(&mut seed.rng(), out);
            for action in out.chunks_mut(task.spec.actions.len()) {
                action[0] = 0.4 + 0.3 * action[0];
            }
        }
        env.step(&actions).expect("a step");
        frames.push(env.worlds().map(|world| world.frame().clone()).collect());
    }
    frames
}

#[test]
fn lane_changes_are_the_same_on_both_backends_and_after_a_restart() {
    let folder = folder();
    let files = flows(folder.path(), 3);
    for mode in ["route", "action"] {
        let file = forked(folder.path(), &format!("laneChange=\"{mode}\""), files);
        let task = task(&file, 4);
        let options =
            |worlds, backend| agents_drive(worlds, 4, Hosting { backend, ..Hosting::default() });
        let watch = |backend| {
            let _turn = turn(backend);
            let mut env = VecEnv::new(&task, &options(1, backend)).expect("SUMO runs");
            steps(&mut env, &task, 800)
        };
        let frames = watch(Backend::Traci);
        let began = frames[1..].iter().map(|frame| frame[0].start.iter().sum::<f32>());
        let began = began.sum::<f32>();
        assert!(began > 4.0, "{mode}: slots are used again: {began}");
        // Nothing of the lane changes of a slot's last agent is left.
        for frame in &frames {
            for agent in
                (0..4).filter(|agent| frame[0].start[*agent] > 0.0 && frame[0].active[*agent] > 0.0)
            {
                assert_eq!(observed(&task, &frame[0], agent, "lane.lane_time"), 0.0);
            }
        }
        assert!(watch(Backend::Libsumo) == frames, "{mode} differs with libsumo");

        let options = options(2, Backend::Traci);
        let mut env = VecEnv::new(&task, &options).expect("SUMO runs");
        steps(&mut env, &task, 230);
        let states = env.states();
        let expected = steps(&mut env, &task, 100);
        let mut again = VecEnv::restore(&task, &options, &states).expect("SUMO runs");
        assert!(steps(&mut again, &task, 100) == expected, "{mode} differs after a restart");
    }
}
