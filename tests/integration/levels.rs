//! What agents see is what SUMO's net says: bridges and tunnels are no conflicts, every conflict
//! counts, also of a route with itself, both directions of a `bidi` road are one strip, and
//! background vehicles are on the lane that SUMO reports.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;

use iwol_sumo::driving::Policy;
use iwol_sumo::env::{Driver, Task, VecEnv, World};
use iwol_sumo::rng::Seed;
use iwol_sumo::scenario::Scenario;
use iwol_sumo::sumo::domain::vehicle::Addition;
use iwol_sumo::sumo::net::Net;
use iwol_sumo::sumo::process::{Options, Process};
use iwol_sumo::sumo::{
    Body, Client, Command as Order, Departure, Hosting, Snapshot, VehicleState, find_program,
};

use crate::support::{agents_drive, folder, play};

fn run(program: &Path, arguments: &[&str], folder: &Path) {
    let mut command = Command::new(program);
    // SUMO's tools look for the schemas of their files there.
    command.args(arguments).current_dir(folder).env("SUMO_HOME", "/usr/share/sumo");
    let output = command.output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// Builds a net from nodes and edges; returns its file.
fn net(folder: &Path, nodes: &str, edges: &str, more: &[&str]) -> PathBuf {
    fs::write(folder.join("x.nod.xml"), format!("<nodes>{nodes}</nodes>")).unwrap();
    fs::write(folder.join("x.edg.xml"), format!("<edges>{edges}</edges>")).unwrap();
    let files = ["-n", "x.nod.xml", "-e", "x.edg.xml", "-o", "x.net.xml", "--no-turnarounds"];
    run(&find_program("netconvert").unwrap(), &[&files, more].concat(), folder);
    folder.join("x.net.xml")
}

/// Loads a scenario with these elements `<route>`, `<spawn>` and `<traffic>`; agents see conflicts.
fn scenario(folder: &Path, routes: &str, spawns: &str, traffic: &str, agents: u32) -> Scenario {
    let text = format!(
        r#"<scenario name="x"><description>A test.</description>
<agents min="1" max="{agents}" default="{agents}"/><routes>{routes}</routes>
<nets><net file="x.net.xml">{spawns}</net></nets>
<vehicle length="4.515" width="1.852" maxSpeed="13.9"/><jitter longitudinal="0" lateral="0"/>
<control mode="throttle" interval="0.1" accel="2.909" drag="0.364" brake="0.3:8.2 0.5:10.2 1:14.7"/>
<observation groups="conflict" detectionRange="100" neighbours="4" conflictStreams="2" streamVehicles="3" encounters="2"/>
<reward progress="1" speed="0.1" arrive="10" outOfRoad="-10" crash="-10" cooperation="0.06"/>
<termination horizon="1200" wreckTime="2.5"/><communication range="50"/>{traffic}</scenario>"#
    );
    let file = folder.join("x.xml");
    fs::write(&file, text).unwrap();
    Scenario::load(&file).unwrap()
}

fn task(scenario: &Scenario, agents: u32) -> Arc<Task> {
    Arc::new(Task::new(scenario, agents).unwrap())
}

/// Returns the conflicts of a route with another: positions on both, rounded to metres.
fn conflicts(task: &Task, [own, other]: [usize; 2]) -> Vec<[i32; 2]> {
    let all = task.map.routes[own].conflicts.iter().filter(|conflict| conflict.route == other);
    all.map(|c| [c.own.round() as i32, c.other.round() as i32]).collect()
}

/// Returns the value of a feature of an agent's observation.
fn feature(task: &Task, world: &World, agent: usize, name: &str) -> f32 {
    let all = &task.spec.observation.list;
    let at = all.iter().position(|feature| feature.name == name).expect(name);
    world.frame().observation[agent * all.len() + at]
}

/// A bridge is none of the reasons to meet, whatever heights the net gives: a road over a road, a
/// road over a junction, a tunnel along a road, and a road that crosses one of its own junction's
/// roads far from it.
#[test]
fn roads_at_different_heights_do_not_meet() {
    let cross = |z: &str| {
        format!(
            r#"<node id="W" x="-120" y="0"/><node id="E" x="120" y="0"/><node id="S" x="0" y="-120"{z}/><node id="N" x="0" y="120"{z}/>"#
        )
    };
    let edges = r#"<edge id="a" from="W" to="E"/><edge id="b" from="S" to="N"/>"#;
    let over = r#"<edge id="a1" from="W" to="J"/><edge id="a2" from="J" to="E"/><edge id="b" from="S" to="N"/>"#;
    let along = r#"<node id="P" x="-100" y="1.6"/><node id="Q" x="100" y="1.6"/>"#;
    let tunnel = r#"<edge id="a" from="W" to="E"/><edge id="b" from="P" to="Q"/>"#;
    // The ramp leaves the junction to the north and comes round over the road to the east.
    let ramp = r#"<edge id="a1" from="W" to="J"/><edge id="a2" from="J" to="E"/><edge id="b" from="J" to="S" shape="0,0 0,60 60,60 60,-60 0,-120"/>"#;
    let junction = r#"<node id="J" x="0" y="0"/>"#;
    for (name, nodes, edges, a, b) in [
        ("flat", cross(""), edges, "a", "b"),
        ("high", cross(r#" z="7""#), edges, "a", "b"),
        ("deep", cross(r#" z="-6""#), edges, "a", "b"),
        ("over a junction", cross("") + junction, over, "a1 a2", "b"),
        ("along a road", cross("") + along, tunnel, "a", "b"),
        ("ramp", cross("") + junction, ramp, "a1 a2", "a1 b"),
    ] {
        let folder = folder();
        net(folder.path(), &nodes, edges, &[]);
        let routes = format!(
            r#"<route id="a" edges="{a}" arrivalPos="-5"/><route id="b" edges="{b}" arrivalPos="-5"/>"#
        );
        let spawns = r#"<spawn route="a" first="4" spacing="12" count="4"/><spawn route="b" first="4" spacing="12" count="4"/>"#;
        let apart = name != "ramp";
        let spawns =
            if apart { spawns } else { r#"<spawn route="a b" first="4" spacing="12" count="8"/>"# };
        let task = task(&scenario(folder.path(), &routes, spawns, "", 8), 8);
        assert_eq!(conflicts(&task, [0, 1]), [[0; 2]; 0], "{name}");
        if apart {
            let metrics = play(&task, &Policy::Throttle(1.0), 5, Seed::new(0)).metrics().unwrap();
            assert_eq!(
                (metrics.success.mean, metrics.driving().own_collisions.mean),
                (1.0, 0.0),
                "{name}"
            );
        }
    }
}

/// Two routes that cross on one level, part and cross again have two conflicts, and an agent that
/// has left the first sees the second.
#[test]
fn routes_that_meet_twice_have_two_conflicts() {
    let folder = folder();
    let nodes = r#"<node id="W" x="-100" y="0"/><node id="J" x="0" y="0"/><node id="K" x="100" y="0"/><node id="E" x="200" y="0"/><node id="S" x="0" y="-100"/><node id="T" x="100" y="-100"/>"#;
    let edges = r#"<edge id="a1" from="W" to="J"/><edge id="a2" from="J" to="K"/><edge id="a3" from="K" to="E"/><edge id="b1" from="S" to="J"/><edge id="b2" from="J" to="K" shape="0,0 0,60 100,60 100,0"/><edge id="b3" from="K" to="T"/>"#;
    net(folder.path(), nodes, edges, &[]);
    let routes = r#"<route id="a" edges="a1 a2 a3" arrivalPos="-5"/><route id="b" edges="b1 b2 b3" arrivalPos="-5"/>"#;
    let spawns = r#"<spawn route="a" first="4" spacing="12" count="1"/><spawn route="b" first="4" spacing="12" count="1"/>"#;
    let task = task(&scenario(folder.path(), routes, spawns, "", 2), 2);
    let both = conflicts(&task, [0, 1]);
    assert!(both.len() == 2 && both[1][0] - both[0][0] > 80, "{both:?}");
    let back: Vec<[i32; 2]> = conflicts(&task, [1, 0]).iter().map(|&[a, b]| [b, a]).collect();
    assert_eq!(both, back);
    let first = task.map.routes[0].to_first_conflict(0.0);
    let second = task.map.routes[0].to_first_conflict(first + 10.0);
    assert!(first > 50.0 && second > 50.0, "{first} {second}");
}

const FIGURE_EIGHT: [&str; 2] = [
    r#"<node id="S" x="0" y="-300"/><node id="C" x="0" y="0"/><node id="N" x="0" y="60"/><node id="NE" x="60" y="60"/><node id="E" x="60" y="0"/><node id="W" x="-100" y="0"/>"#,
    r#"<edge id="up" from="S" to="C"/><edge id="l1" from="C" to="N"/><edge id="l2" from="N" to="NE"/><edge id="l3" from="NE" to="E"/><edge id="l4" from="E" to="C"/><edge id="out" from="C" to="W"/>"#,
];
const NO_TURNS: &str =
    r#"<connections><connection from="up" to="l1"/><connection from="l4" to="out"/></connections>"#;

/// A route that crosses itself has a conflict with itself: agents see who comes across, those that
/// give way arrive, and a crash there is one of crossing routes.
#[test]
fn a_route_that_crosses_itself_has_a_conflict() {
    let folder = folder();
    fs::write(folder.path().join("x.con.xml"), NO_TURNS).unwrap();
    net(folder.path(), FIGURE_EIGHT[0], FIGURE_EIGHT[1], &["-x", "x.con.xml"]);
    let routes = r#"<route id="eight" edges="up l1 l2 l3 l4 out" arrivalPos="-5"/>"#;
    let spawns = r#"<spawn route="eight" first="10" spacing="45" count="6"/>"#;
    let task = task(&scenario(folder.path(), routes, spawns, "", 6), 6);
    let met = conflicts(&task, [0, 0]);
    assert!(met.len() == 2 && met[0][1] == met[1][0] && met[0][0] == met[1][1], "{met:?}");
    let mut env = VecEnv::new(&task, &agents_drive(1, 1, Hosting::default())).expect("SUMO runs");
    let mut seen = 0;
    for _ in 0..150 {
        env.step(&[1.0; 6]).unwrap();
        let world = env.worlds().next().unwrap();
        seen +=
            (0..6).filter(|&i| feature(&task, world, i, "stream0_vehicle_0.present") > 0.0).count();
    }
    assert!(seen > 100, "{seen}");
    let of = |policy: Policy<'_>| play(&task, &policy, 3, Seed::new(0)).metrics().unwrap();
    assert_eq!(of(Policy::by_name("fcfs:8").unwrap()).success.mean, 1.0);
    let rude = of(Policy::Throttle(1.0));
    assert!(
        rude.driving().failures.crossing > 0 && rude.driving().failures.rear_end == 0,
        "{:?}",
        rude.driving().failures
    );
}

/// On a ring, the vehicle ahead is the next one on the lane, in whichever lap either is.
#[test]
fn laps_of_a_ring_are_one_lane() {
    let folder = folder();
    let nodes = r#"<node id="S" x="0" y="-100"/><node id="A" x="0" y="0"/><node id="B" x="60" y="0"/><node id="C" x="60" y="60"/><node id="D" x="0" y="60"/><node id="O" x="160" y="60"/>"#;
    let edges = r#"<edge id="in" from="S" to="A"/><edge id="r1" from="A" to="B"/><edge id="r2" from="B" to="C"/><edge id="r3" from="C" to="D"/><edge id="r4" from="D" to="A"/><edge id="out" from="C" to="O"/>"#;
    net(folder.path(), nodes, edges, &[]);
    let routes =
        r#"<route id="laps" edges="in r1 r2 r3 r4 r1 r2 r3 r4 r1 r2 out" arrivalPos="-5"/>"#;
    let spawns = r#"<spawn route="laps" first="4" spacing="12" count="2"/>"#;
    let task = task(&scenario(folder.path(), routes, spawns, "", 2), 2);
    let route = &task.map.routes[0];
    let start = |nth: usize| route.path.edge_start[nth];
    let (r1, again) = (start(1), start(5));
    // A vehicle one lap ahead and 20 m before or behind on the lane.
    let ahead = route.gap_to(r1 + 5.0, 0, again + 25.0).unwrap();
    assert!((ahead - 20.0).abs() < 1e-6, "{ahead}");
    let behind = route.gap_to(again + 25.0, 0, r1 + 45.0).unwrap();
    assert!((behind - 20.0).abs() < 1e-6, "{behind}");
    // A vehicle that enters the ring meets one that is on it.
    let met = conflicts(&task, [0, 0]);
    assert!(met.iter().any(|[own, other]| *own < 110 && *other > 250), "{met:?}");
}

/// Both directions of a road with `bidi` are one strip: vehicles from both ends see each other all
/// along it, and SUMO's reports of a vehicle that collides with itself there do not count.
#[test]
fn both_directions_of_a_bidi_road_are_one_strip() {
    let folder = folder();
    let nodes = r#"<node id="A" x="0" y="0"/><node id="B" x="200" y="0"/>"#;
    let edges = r#"<edge id="ab" from="A" to="B" spreadType="center" bidi="ba"/><edge id="ba" from="B" to="A" spreadType="center" bidi="ab"/>"#;
    net(folder.path(), nodes, edges, &[]);
    let routes =
        r#"<route id="ab" edges="ab" arrivalPos="-5"/><route id="ba" edges="ba" arrivalPos="-5"/>"#;
    let spawns = r#"<spawn route="ab" first="8" spacing="8" count="1"/><spawn route="ba" first="8" spacing="8" count="1"/>"#;
    let scenario = scenario(folder.path(), routes, spawns, "", 2);
    let pair = task(&scenario, 2);
    let route = &pair.map.routes[0];
    for s in (5..190).step_by(10).map(f64::from) {
        for gap in [8.0, 30.0, 60.0] {
            let other = 200.0 - s - gap;
            if other > 0.0 {
                let met = route.next_conflict(s, 1, other, 7.0).expect("they are head on");
                assert!((met.own + met.other - 200.0).abs() < 1.0, "one place: {met:?}");
                assert!((met.own - s).max(met.other - other) <= gap + 7.0, "{met:?}");
            }
        }
    }
    let alone = play(&task(&scenario, 1), &Policy::Throttle(1.0), 5, Seed::new(0));
    let metrics = alone.metrics().unwrap();
    assert_eq!((metrics.driving().sumo_collisions.mean, metrics.success.mean), (0.0, 1.0));
    let both = play(&pair, &Policy::Throttle(1.0), 3, Seed::new(0)).metrics().unwrap();
    assert_eq!(both.driving().failures.crossing, 6, "{:?}", both.driving().failures);
}

/// Without `bidi`, SUMO does not know that the two directions are one strip. The audit says so.
#[test]
fn sumo_does_not_compare_two_roads_on_one_strip() {
    let folder = folder();
    let nodes = r#"<node id="A" x="0" y="0"/><node id="B" x="200" y="0"/>"#;
    let edges = r#"<edge id="ab" from="A" to="B" spreadType="center"/><edge id="ba" from="B" to="A" spreadType="center"/>"#;
    net(folder.path(), nodes, edges, &["--geometry.avoid-overlap", "false"]);
    let routes =
        r#"<route id="ab" edges="ab" arrivalPos="-5"/><route id="ba" edges="ba" arrivalPos="-5"/>"#;
    let spawns = r#"<spawn route="ab" first="8" spacing="8" count="1"/><spawn route="ba" first="8" spacing="8" count="1"/>"#;
    let pair = task(&scenario(folder.path(), routes, spawns, "", 2), 2);
    let audit =
        play(&pair, &Policy::Throttle(1.0), 3, Seed::new(0)).metrics().unwrap().driving().audit;
    assert_eq!(
        audit.differences(),
        [("only the box test: on lanes that SUMO does not compare", 3)]
    );
}

const TWO_LANES: [&str; 2] = [
    r#"<node id="W" x="0" y="0"/><node id="J" x="150" y="0"/><node id="E" x="300" y="0"/>"#,
    r#"<edge id="wi" from="W" to="J" numLanes="2"/><edge id="eo" from="J" to="E" numLanes="2"/>"#,
];

/// A slow car on one lane is the leader of the agent on that lane and of no other.
#[test]
fn the_leader_is_on_the_agents_lane() {
    for (agent, car) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
        let folder = folder();
        net(folder.path(), TWO_LANES[0], TWO_LANES[1], &[]);
        fs::write(
            folder.path().join("slow.rou.xml"),
            format!(
                r#"<routes><vType id="b" maxSpeed="2"/><vehicle id="f" type="b" depart="0" departLane="{car}" departPos="40"><route edges="wi eo"/></vehicle></routes>"#
            ),
        )
        .unwrap();
        let routes = format!(r#"<route id="r" edges="wi eo" lane="{agent}" arrivalPos="-5"/>"#);
        let spawns = r#"<spawn route="r" first="8" spacing="8" count="1"/>"#;
        let traffic = r#"<traffic files="slow.rou.xml"/>"#;
        let task = task(&scenario(folder.path(), &routes, spawns, traffic, 1), 1);
        let mut env = VecEnv::new(&task, &agents_drive(1, 1, Hosting::default())).unwrap();
        // SUMO moves the car from the left lane to the right one after a while.
        for _ in 0..15 {
            env.step(&[-1.0]).unwrap();
        }
        let world = env.worlds().next().unwrap();
        let present = feature(&task, world, 0, "leader.present");
        assert_eq!(present, f32::from(u8::from(agent == car)), "agent {agent}, car {car}");
        assert_eq!(world.background_vehicles().count(), 1);
    }
}

/// SUMO with the vehicles of one world, by single TraCI calls, so that a test can ask it more.
struct Asked {
    _process: Process,
    sumo: Client,
    net: Net,
    departed: BTreeMap<u32, f64>,
}

impl Asked {
    fn start(task: &Task) -> Self {
        let config = task.simulation_config(1, 1, &Hosting::default());
        let net = Net::load(&config.net).unwrap();
        let arguments: Vec<OsString> = ["-n".into(), config.net.into_os_string()].into();
        let more = "--step-length 0.1 --time-to-teleport -1 --no-step-log --no-warnings \
                    --collision.action warn --collision.mingap-factor 0 --xml-validation never";
        let arguments = arguments.into_iter().chain(more.split_whitespace().map(Into::into));
        let options = Options { arguments: arguments.collect(), ..Options::default() };
        let (process, mut sumo, _) = Process::start(&options).unwrap();
        for route in &config.routes {
            sumo.route().add(&route.id, &route.edges).unwrap();
        }
        Self { _process: process, sumo, net, departed: BTreeMap::new() }
    }

    /// Carries out commands and takes a step.
    fn step(&mut self, task: &Task, commands: &[Order]) -> Snapshot {
        let config = task.simulation_config(1, 1, &Hosting::default());
        for command in commands {
            let (slot, addition) = match command {
                Order::Add { slot, route, depart_pos, .. } => {
                    self.departed.insert(*slot, *depart_pos);
                    let route = &config.routes[*route as usize];
                    (
                        slot,
                        [&route.id, &route.lane.to_string(), &depart_pos.to_string(), "0"]
                            .map(String::from),
                    )
                }
                Order::Depart { slot, departure, .. } => {
                    let others = config.others.as_ref().unwrap();
                    let Departure::Drive { route, lane, pos, speed, .. } =
                        &others.departures[*departure as usize]
                    else {
                        panic!("nobody walks")
                    };
                    let route = &config.routes[*route as usize].id;
                    self.departed.insert(*slot, 0.0);
                    (slot, [route, lane, pos, speed].map(String::from))
                }
                Order::LaneChangeMode { slot, mode, .. } => {
                    self.sumo.vehicle().set_lane_change_mode(&slot.to_string(), *mode).unwrap();
                    continue;
                }
                Order::Remove { slot, .. } => {
                    let _ = self.sumo.vehicle().remove(&slot.to_string(), 3);
                    self.departed.remove(slot);
                    continue;
                }
                _ => continue,
            };
            let [route, depart_lane, depart_pos, depart_speed] = &addition;
            let addition =
                Addition { depart_lane, depart_pos, depart_speed, ..Addition::on_route(route) };
            let name = slot.to_string();
            self.sumo.vehicle().add(&name, &addition).unwrap();
            self.sumo.vehicle().set_length(&name, 4.515).unwrap();
            self.sumo.vehicle().set_min_gap(&name, 1.0).unwrap();
        }
        self.sumo.simulation_step(0.0).unwrap();
        let here = self.sumo.vehicle().get_id_list().unwrap();
        let mut snapshot = Snapshot::default();
        let count = config.slots as usize;
        (snapshot.vehicles, snapshot.bodies) = (vec![None; count], vec![None; count]);
        for name in &here {
            let slot: usize = name.parse().unwrap();
            let mut of = self.sumo.vehicle();
            let distance = self.departed[&(slot as u32)] + of.get_distance(name).unwrap();
            let speed = of.get_speed(name).unwrap();
            snapshot.vehicles[slot] = Some(VehicleState { distance, speed });
            let [x, y] = of.get_position(name).unwrap();
            let heading = (90.0 - of.get_angle(name).unwrap()).to_radians();
            let lane = of.get_lane_id(name).unwrap();
            let lane = self.net.lanes.iter().position(|known| known.id == lane);
            let lane = lane.map(|lane| lane as u32);
            snapshot.bodies[slot] = Some(Body { x, y, heading, lane, time_loss: 0.0 });
        }
        snapshot
    }
}

/// Counts by reason how often the leader that an agent sees is SUMO's, in the steps of an episode
/// on a generated net.
fn leaders(kind: &[&str], seed: u32, counts: &mut BTreeMap<String, u32>) {
    const RANGE: f64 = 40.0;
    const LENGTH: f64 = 4.515;
    let folder = folder();
    let at = folder.path();
    let number = seed.to_string();
    let generated = [kind, &["--seed", &number, "-o", "x.net.xml"]].concat();
    run(&find_program("netgenerate").unwrap(), &generated, at);
    let tool = "/usr/share/sumo/tools/randomTrips.py";
    let trips = format!(
        "{tool} -n x.net.xml -o trips.xml -r x.rou.xml --seed {seed} -b 0 -e 60 -p 1.5 --validate --min-distance 150"
    );
    run(Path::new("python3"), &trips.split(' ').collect::<Vec<_>>(), at);
    let text = fs::read_to_string(at.join("x.rou.xml")).unwrap();
    let text = text.replace("<vehicle ", "<vehicle departLane=\"random\" departSpeed=\"max\" ");
    // Vehicles keep to the routes that can be driven without a change of lanes; the agents take the
    // first of them.
    let net = Net::load(&at.join("x.net.xml")).unwrap();
    let edges = text.split("edges=\"").skip(1).filter_map(|rest| rest.split('"').next());
    let fits = |edges: &&str| {
        let edges: Vec<String> = edges.split(' ').map(String::from).collect();
        net.route_path(&edges).is_ok_and(|path| path.edge_length[0] > 40.0)
    };
    let vehicles = text.split_inclusive("</vehicle>").filter_map(|part| {
        let from = part.find("<vehicle ")?;
        let edges = part.split("edges=\"").nth(1)?.split('"').next()?;
        fits(&edges).then(|| &part[from..])
    });
    let vehicles: String = vehicles.collect();
    fs::write(at.join("x.rou.xml"), format!("<routes>{vehicles}</routes>")).unwrap();
    let mut taken: Vec<&str> = Vec::new();
    for edges in edges.filter(fits) {
        let first = edges.split(' ').next();
        if taken.len() < 6 && taken.iter().all(|other| other.split(' ').next() != first) {
            taken.push(edges);
        }
    }
    let route = |(k, edges): (usize, &&str)| {
        format!(r#"<route id="agent{k}" edges="{edges}" arrivalPos="-5"/>"#)
    };
    let routes: String = taken.iter().enumerate().map(route).collect();
    let spawn = |k: usize| format!(r#"<spawn route="agent{k}" first="10" spacing="8" count="1"/>"#);
    let spawns: String = (0..taken.len()).map(spawn).collect();
    let traffic = r#"<traffic files="x.rou.xml" capacity="60"/>"#;
    let agents = taken.len() as u32;
    let task = task(&scenario(at, &routes, &spawns, traffic, agents), agents);
    let mut asked = Asked::start(&task);
    let mut world = World::new(Arc::clone(&task), Driver::Sumo, Seed::new(1), 0, 1, 1);
    world.reset(0);
    let mut commands = Vec::new();
    for _ in 0..400 {
        commands.clear();
        world.act(0, &vec![0.0; task.agents], &mut commands);
        let snapshot = asked.step(&task, &commands);
        world.observe(0, &snapshot).unwrap();
        if !world.is_running() {
            break;
        }
        for (i, agent) in world.agents().enumerate() {
            if !agent.driving || snapshot.vehicles[i].is_none() {
                continue;
            }
            let name = i.to_string();
            let leader = asked.sumo.vehicle().get_leader(&name, RANGE).unwrap();
            // SUMO counts from the gap that a vehicle keeps at standstill.
            let theirs = leader.map(|leader| (leader.id, leader.gap + 1.0));
            let gap = f64::from(feature(&task, &world, i, "leader.gap_far")) * 50.0;
            let ours = Some(gap).filter(|_| feature(&task, &world, i, "leader.present") > 0.0);
            let agree = ours.zip(theirs.as_ref()).is_some_and(|(a, (_, b))| (a - b).abs() < 1.5);
            let is_near = |gap: f64| agree || gap < RANGE - 5.0;
            let ours = ours.filter(|gap| is_near(*gap));
            let theirs = theirs.filter(|(_, gap)| is_near(*gap));
            let lane = |id: &str| {
                let lane = snapshot.bodies[id.parse::<usize>().unwrap()].unwrap().lane;
                lane.map(|lane| lane as usize)
            };
            // The least distance that a body can have whose front is this far away.
            let beeline = |id: &str| {
                let body = |k: usize| snapshot.bodies[k].unwrap();
                let (own, other) = (body(i), body(id.parse().unwrap()));
                (own.x - other.x).hypot(own.y - other.y) - LENGTH
            };
            // Whether the front of a vehicle is on its lane and the centre not yet.
            let comes_in = |id: &str| {
                let body = snapshot.bodies[id.parse::<usize>().unwrap()].unwrap();
                let [x, y] = net.lanes[lane(id).unwrap()].shape[0];
                (body.x - x).hypot(body.y - y) < LENGTH / 2.0 + 0.5
            };
            // SUMO has whoever reaches the finish until the next exchange removes it.
            let has_arrived = |id: &str| {
                let agent = world.agents().nth(id.parse().unwrap());
                agent.is_some_and(|agent| !agent.driving)
            };
            let path = &task.map.routes[agent.route].path;
            let reason = match (ours, &theirs) {
                (None, None) => "both see nobody",
                _ if agree => "the same leader",
                (_, Some((id, _))) if has_arrived(id) => {
                    "SUMO's is an agent that has arrived in this step"
                }
                (_, Some((id, _))) if !lane(id).is_some_and(|lane| path.lanes.contains(&lane)) => {
                    "SUMO's is on a lane that is not the agent's: it crosses, merges or has turned off"
                }
                (_, Some((id, gap))) if *gap < beeline(id) - 1.0 => {
                    "SUMO's is still crossing, and its gap is the one to the crossing"
                }
                (_, Some((id, _))) if comes_in(id) => {
                    "SUMO's merges: its front is on the agent's lane, its centre not yet"
                }
                (Some(a), b) if b.as_ref().is_none_or(|(_, b)| a < *b) => {
                    "ours has not quite left the agent's path behind a fork, or is about to merge"
                }
                _ => "no known reason",
            };
            *counts.entry(reason.into()).or_default() += 1;
            if reason == "no known reason" {
                let more = theirs.as_ref().map(|(id, _)| (lane(id), beeline(id)));
                let lanes = &path.lanes;
                let at = agent.position;
                eprintln!(
                    "net {seed}: agent {i} at {at} m of {lanes:?}: {ours:?}, SUMO's {theirs:?} {more:?}"
                );
            }
        }
    }
}

/// The leader that agents see is the one that SUMO's cars follow. `IWOL_NETS` sets the number of
/// generated nets.
#[test]
fn the_leader_is_the_one_that_sumo_names() {
    let count = std::env::var("IWOL_NETS").map_or(3, |text| text.parse().unwrap());
    let kinds: [&[&str]; 3] = [
        &["--grid", "--grid.number", "3", "--grid.length", "120", "-L", "2", "-j", "priority"],
        &["--rand", "--rand.iterations", "25", "-L", "2", "--bidi-probability", "1"],
        &["--spider", "--spider.arm-number", "5", "--spider.circle-number", "2", "-L", "1"],
    ];
    let mut counts = BTreeMap::new();
    for k in 0..count {
        leaders(kinds[k as usize % kinds.len()], k + 1, &mut counts);
    }
    eprintln!("{counts:#?}");
    assert!(counts["the same leader"] > 100, "{counts:?}");
    assert_eq!(counts.get("no known reason"), None, "{counts:?}");
}
