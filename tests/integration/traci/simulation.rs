//! Tests of the SUMO interface against the real simulator: exchanges, departures and arrivals of
//! vehicles, refusals, termination of SUMO, and that no SUMO process outlives its owner. These
//! tests fail if SUMO is missing.

use std::{
    io::{Read as _, Write as _},
    net::{Ipv4Addr, SocketAddr, TcpListener},
    path::{Path, PathBuf},
    process::{Command as Program, Stdio},
    sync::OnceLock,
    thread,
    time::{Duration, Instant},
};

use iwol_sumo::sumo::{
    Batch, Client, Collision, Command, Error, Renewal, Route, Simulation, SimulationConfig,
    TraciSimulation, Value, VehicleState, VehicleType,
    constants::{self as c, Domain},
    domain::{
        simulation,
        vehicle::{self, Addition},
    },
    find_sumo,
    process::{Options, Process},
    sumo_version, traci_version,
};

const LENGTH: f64 = 4.515;
const EAST: u32 = 0;
const NORTH: u32 = 1;

/// Returns a net of two straight roads, each 300 m long, that cross at the origin; SUMO's
/// netconvert builds it once.
fn net() -> &'static Path {
    static NET: OnceLock<(tempfile::TempDir, PathBuf)> = OnceLock::new();
    let (_, path) = NET.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str, text: &str| {
            let path = folder.path().join(name);
            std::fs::write(&path, text).unwrap();
            path
        };
        let nodes = file(
            "cross.nod.xml",
            r#"<nodes><node id="c" x="0" y="0" type="right_before_left"/><node id="w" x="-150" y="0"/>
            <node id="e" x="150" y="0"/><node id="s" x="0" y="-150"/><node id="n" x="0" y="150"/></nodes>"#,
        );
        let edges = file(
            "cross.edg.xml",
            r#"<edges><edge id="west_in" from="w" to="c" speed="30"/><edge id="east_out" from="c" to="e" speed="30"/>
            <edge id="south_in" from="s" to="c" speed="30"/><edge id="north_out" from="c" to="n" speed="30"/></edges>"#,
        );
        let path = folder.path().join("cross.net.xml");
        let sumo = find_sumo().unwrap_or_else(|e| panic!("{e}; hint: {}", e.hint().unwrap_or_default()));
        let output = Program::new(sumo.with_file_name("netconvert"))
            .args(["--offset.disable-normalization", "true", "--xml-validation", "never", "-n"])
            .arg(nodes)
            .arg("-e")
            .arg(edges)
            .arg("-o")
            .arg(&path)
            .output()
            .unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        (folder, path)
    });
    path
}

fn config(slots: u32) -> SimulationConfig {
    let route = |id: &str, edges: [&str; 2]| Route {
        id: id.into(),
        edges: edges.map(String::from).to_vec(),
        lane: 0,
        walked: false,
    };
    SimulationConfig {
        net: net().to_owned(),
        step_length: 0.1,
        seed: 7,
        worlds: 1,
        slots,
        timeout: Duration::from_secs(60),
        audit: true,
        others: None,
        vehicle_types: vec![VehicleType {
            class: None,
            id: "car".into(),
            length: LENGTH,
            width: 1.852,
            max_speed: 22.222,
            accel: 3.0,
            decel: 4.5,
            emergency_decel: 9.0,
            min_gap: 1.0,
            tau: 1.0,
        }],
        routes: vec![
            route("eastbound", ["west_in", "east_out"]),
            route("northbound", ["south_in", "north_out"]),
        ],
    }
}

fn start(slots: u32) -> TraciSimulation {
    TraciSimulation::start(config(slots))
        .unwrap_or_else(|e| panic!("{e}; hint: {}", e.hint().unwrap_or_default()))
}

fn add(slot: u32, route: u32, depart_pos: f64) -> [Command; 2] {
    let add =
        Command::Add { world: 0, slot, route, vehicle_type: 0, depart_pos, depart_speed: 0.0 };
    [add, Command::SpeedMode { world: 0, slot, mode: 32 }]
}

fn remove(slot: u32) -> Command {
    Command::Remove { world: 0, slot }
}

fn speed(slot: u32, speed: f64) -> Command {
    Command::SetSpeed { world: 0, slot, speed }
}

fn lives(pid: u32) -> bool {
    // A zombie process still has a folder in `/proc`, but an empty command line.
    std::fs::read(format!("/proc/{pid}/cmdline")).is_ok_and(|line| !line.is_empty())
}

/// Waits until the process ends; returns `false` if it is still there after 10 s.
fn ends(pid: u32) -> bool {
    let start = Instant::now();
    while lives(pid) && start.elapsed() < Duration::from_secs(10) {
        thread::sleep(Duration::from_millis(2));
    }
    !lives(pid)
}

fn signal(name: &str, pid: u32) {
    let status = Program::new("kill").args([name, &pid.to_string()]).status().unwrap();
    assert!(status.success());
}

#[test]
fn the_handshake_names_the_version_and_connecting_is_quick() {
    let mut times = Vec::new();
    for _ in 0..5 {
        let begin = Instant::now();
        let simulation = start(1);
        times.push(begin.elapsed().as_millis());
        assert!(simulation.version().api >= c::MINIMUM_API_VERSION);
        assert!(simulation.version().software.starts_with("SUMO"));
    }
    println!("from nothing to the first answer: {times:?} ms");
    let version = traci_version().unwrap();
    let program = sumo_version(&find_sumo().unwrap()).unwrap();
    assert_eq!(version.software, format!("SUMO {program}"));
}

#[test]
fn a_commanded_speed_is_the_speed_of_the_whole_step() {
    let mut simulation = start(2);
    let snapshot = simulation.step(&[add(0, EAST, 50.0), add(1, NORTH, 50.0)].concat()).unwrap();
    assert_eq!(snapshot.time, 0.1);
    let (east, north) = (snapshot.vehicles[0].unwrap(), snapshot.vehicles[1].unwrap());
    assert_eq!((east.distance, east.speed), (50.0, 0.0));
    assert_eq!((north.distance, north.speed), (50.0, 0.0));
    let (mut way, mut old) = (50.0, 0.0);
    for step in 1..100 {
        let new = if step < 50 { old + 0.29 } else { f64::max(old - 0.83, 0.0) };
        let snapshot = simulation.step(&[speed(0, new), speed(1, new)]).unwrap();
        way += new * 0.1;
        old = new;
        let (east, north) = (snapshot.vehicles[0].unwrap(), snapshot.vehicles[1].unwrap());
        for vehicle in [east, north] {
            let exact =
                (vehicle.distance - way).abs() < 1e-9 && (vehicle.speed - new).abs() < 1e-12;
            assert!(exact, "step {step}: {vehicle:?}, not {way} m");
        }
    }
}

#[test]
fn a_queue_departs_complete_and_exact_in_any_order() {
    let mut simulation = start(14);
    // SUMO inserts vehicles in the order of their names. The first queue is inserted from its rear,
    // the second from its front.
    for backwards in [false, true] {
        let place = |slot: u32| 60.0 + 6.0 * f64::from(if backwards { 13 - slot } else { slot });
        let mut commands: Vec<Command> = (0..14).map(remove).collect();
        commands.extend((0..14).flat_map(|slot| add(slot, EAST, place(slot))));
        let snapshot = simulation.step(&commands).unwrap();
        for (slot, vehicle) in (0..).zip(&snapshot.vehicles) {
            let vehicle =
                vehicle.unwrap_or_else(|| panic!("slot {slot} is empty, backwards: {backwards}"));
            assert!((vehicle.distance - place(slot)).abs() < 1e-9, "{vehicle:?} in slot {slot}");
        }
        assert_eq!(snapshot.collisions, []);
    }
}

#[test]
fn a_slot_is_emptied_filled_and_filled_again_in_one_batch() {
    let mut simulation = start(3);
    assert_eq!(simulation.step(&[remove(0), remove(2)]).unwrap().vehicles, [None; 3]);
    simulation.step(&[add(0, EAST, 50.0), add(1, NORTH, 20.0)].concat()).unwrap();
    for round in 0..20 {
        let place = 30.0 + f64::from(round);
        let route = if round % 2 == 0 { EAST } else { NORTH };
        let batch: Vec<Command> =
            [remove(0)].into_iter().chain(add(0, route, place)).chain([speed(1, 1.0)]).collect();
        let snapshot = simulation.step(&batch).unwrap();
        let vehicle = snapshot.vehicles[0].unwrap();
        assert!((vehicle.distance - place).abs() < 1e-9);
        assert!(snapshot.vehicles[1].is_some() && snapshot.vehicles[2].is_none());
    }
    // A slot that is emptied, filled and emptied in one batch holds no vehicle and is free.
    let batch: Vec<Command> =
        [remove(0)].into_iter().chain(add(0, EAST, 9.0)).chain([remove(0), remove(0)]).collect();
    assert!(simulation.step(&batch).unwrap().vehicles[0].is_none());
    assert!(simulation.step(&[]).unwrap().vehicles[0].is_none());
    assert!(simulation.step(&add(0, EAST, 9.0)).unwrap().vehicles[0].is_some());
}

#[test]
fn a_vehicle_that_finds_no_room_is_absent_and_holds_up_no_other() {
    let mut simulation = start(3);
    simulation.step(&[add(0, EAST, 50.0).as_slice(), &[speed(0, 0.0)]].concat()).unwrap();
    let snapshot = simulation.step(&[add(1, EAST, 49.0), add(2, EAST, 20.0)].concat()).unwrap();
    assert_eq!(
        snapshot.vehicles.iter().map(Option::is_some).collect::<Vec<_>>(),
        [true, false, true]
    );
    assert!(simulation.step(&[]).unwrap().vehicles[1].is_none());
    // A vehicle that waits for insertion can be replaced by one that has room.
    let batch: Vec<Command> = [remove(1)].into_iter().chain(add(1, EAST, 30.0)).collect();
    assert_eq!(simulation.step(&batch).unwrap().vehicles[1].unwrap().distance, 30.0);
}

#[test]
fn a_vehicle_that_reaches_the_end_of_its_route_is_gone() {
    let mut simulation = start(2);
    simulation.step(&[add(0, EAST, 145.0), add(1, NORTH, 10.0)].concat()).unwrap();
    let mut last = VehicleState::default();
    let mut steps = 0;
    while let Some(vehicle) = simulation.step(&[speed(0, 20.0), speed(1, 0.0)]).unwrap().vehicles[0]
    {
        last = vehicle;
        steps += 1;
        assert!(steps < 200, "still at {vehicle:?}");
    }
    assert!(last.distance > 290.0 && last.distance <= 300.0, "{last:?}");
    assert!(simulation.snapshot().vehicles[1].is_some());
    // The slot of an arrived vehicle is free.
    assert!(simulation.step(&add(0, EAST, 10.0)).unwrap().vehicles[0].is_some());
}

#[test]
fn collisions_are_reported_and_change_nothing() {
    let mut simulation = start(3);
    simulation
        .step(&[add(0, EAST, 140.0), add(1, NORTH, 140.0), add(2, EAST, 20.0)].concat())
        .unwrap();
    let mut seen = Vec::new();
    for _ in 0..100 {
        let snapshot = simulation.step(&[speed(0, 2.0), speed(1, 2.0), speed(2, 0.0)]).unwrap();
        seen.extend_from_slice(&snapshot.collisions);
        let east = snapshot.vehicles[0].expect("nobody is taken away");
        assert_eq!((east.speed, snapshot.vehicles[1].map(|v| v.speed)), (2.0, Some(2.0)));
    }
    assert!(seen.len() > 5, "{seen:?}");
    let involved = |c: &Collision| (c.collider.min(c.victim), c.collider.max(c.victim)) == (0, 1);
    assert!(seen.iter().all(involved), "{seen:?}");
}

#[test]
fn the_same_commands_give_the_same_bits() {
    let run = || {
        let mut simulation = start(4);
        let begin: Vec<Command> =
            (0..4).flat_map(|s| add(s, s % 2, 100.0 - 10.0 * f64::from(s))).collect();
        simulation.step(&begin).unwrap();
        let mut bits = Vec::new();
        for step in 0..60 {
            let commands: Vec<Command> =
                (0..4).map(|s| speed(s, f64::from(step) * 0.1 + f64::from(s))).collect();
            let snapshot = simulation.step(&commands).unwrap();
            for v in snapshot.vehicles.iter().flatten() {
                bits.push([v.distance, v.speed].map(f64::to_bits));
            }
        }
        bits
    };
    assert_eq!(run(), run());
}

#[test]
fn a_step_in_the_steady_state_allocates_nothing() {
    let mut tiled = config(8);
    tiled.worlds = 3;
    let mut simulation = TraciSimulation::start(tiled).unwrap();
    let all = || (0..3).flat_map(|world| (0..8).map(move |slot| (world, slot)));
    let mut begin = Vec::new();
    for (world, slot) in all() {
        let depart_pos = 10.0 + 8.0 * f64::from(slot);
        begin.push(Command::Add {
            world,
            slot,
            route: slot % 2,
            vehicle_type: 0,
            depart_pos,
            depart_speed: 0.0,
        });
        begin.push(Command::SpeedMode { world, slot, mode: 32 });
    }
    let speeds: Vec<Command> =
        all().map(|(world, slot)| Command::SetSpeed { world, slot, speed: 5.0 }).collect();
    let round: Vec<Command> =
        all().map(|(world, slot)| Command::Remove { world, slot }).chain(begin).collect();
    let mut play = || {
        simulation.step(&round).unwrap();
        for _ in 0..150 {
            simulation.step(&speeds).unwrap();
        }
    };
    // The buffers grow on the first respawns, removals and collisions.
    play();
    play();
    let allocated = allocation_counter::measure(&mut play);
    assert_eq!(allocated.count_total, 0);
    assert_eq!(simulation.snapshot().vehicles.iter().flatten().count(), 24);
}

#[test]
fn a_refusal_leaves_the_connection_usable() {
    let mut simulation = start(2);
    simulation.step(&add(0, EAST, 50.0)).unwrap();
    match simulation.step(&[speed(1, 3.0), speed(0, 1.0)]) {
        Err(Error::Refused { command, id, message, .. }) => {
            assert_eq!((command, id.as_str()), (Domain::VEHICLE.set, "w0s1"));
            assert!(message.contains("w0s1"), "{message}");
        }
        other => panic!("{other:?}"),
    }
    // SUMO carried out the other command and the step.
    assert_eq!(simulation.snapshot().vehicles[0].map(|v| v.speed), Some(1.0));
    let time = simulation.step(&[speed(0, 2.0)]).unwrap().time;
    assert!((time - 0.3).abs() < 1e-9);
}

#[test]
fn requests_that_cannot_be_sent_change_nothing() {
    let mut simulation = start(2);
    simulation.step(&add(0, EAST, 50.0)).unwrap();
    let add_with = |route, vehicle_type, depart_pos, depart_speed| Command::Add {
        world: 0,
        slot: 1,
        route,
        vehicle_type,
        depart_pos,
        depart_speed,
    };
    for bad in [
        speed(2, 1.0),
        speed(0, f64::NAN),
        add_with(2, 0, 5.0, 0.0),
        add_with(0, 1, 5.0, 0.0),
        add_with(0, 0, f64::INFINITY, 0.0),
        add_with(0, 0, 5.0, f64::NAN),
        Command::Remove { world: 1, slot: 0 },
        Command::SpeedMode { world: 0, slot: u32::MAX, mode: 0 },
    ] {
        let error = simulation.step(&[remove(0), bad]).expect_err("nothing that can be sent");
        assert!(matches!(error, Error::Invalid { .. }) && !error.is_fatal(), "{bad:?}: {error}");
    }
    // A rejected batch does not change the departure position that the client has stored either.
    let moved: Vec<Command> =
        [remove(0)].into_iter().chain(add(0, EAST, 90.0)).chain([speed(0, f64::NAN)]).collect();
    assert!(matches!(simulation.step(&moved), Err(Error::Invalid { .. })));
    // A slot that holds a vehicle does not accept a second one.
    assert!(matches!(simulation.step(&add(0, NORTH, 5.0)), Err(Error::Invalid { .. })));
    let snapshot = simulation.step(&[speed(0, 1.0)]).unwrap();
    assert!((snapshot.time - 0.2).abs() < 1e-9);
    assert_eq!(snapshot.vehicles[0].map(|v| v.speed), Some(1.0));
    assert!(snapshot.vehicles[0].is_some_and(|v| (v.distance - 50.1).abs() < 1e-9), "{snapshot:?}");
    assert_eq!(snapshot.vehicles[1], None);
}

#[test]
fn answers_come_once_for_each_send() {
    let mut simulation = start(1);
    assert!(matches!(simulation.receive(), Err(Error::Invalid { .. })));
    simulation.send(&[]).unwrap();
    assert!(matches!(simulation.send(&[]), Err(Error::Invalid { .. })));
    assert_eq!(simulation.receive().unwrap().time, 0.1);
    assert!(matches!(simulation.receive(), Err(Error::Invalid { .. })));
}

#[test]
fn a_killed_sumo_is_a_fatal_error_and_a_restart_begins_anew() {
    let mut simulation = start(1);
    simulation.step(&add(0, EAST, 50.0)).unwrap();
    let old = simulation.pid();
    signal("-KILL", old);
    let error = (0..3).find_map(|_| simulation.step(&[speed(0, 1.0)]).err()).expect("an error");
    assert!(matches!(&error, Error::Exited { status, .. } if status.contains('9')), "{error}");
    assert!(error.is_fatal());
    assert!(simulation.step(&[]).is_err_and(|e| e.is_fatal()));
    assert_eq!(simulation.renew().unwrap(), Renewal::Restarted);
    assert_ne!(simulation.pid(), old);
    let snapshot = simulation.step(&add(0, NORTH, 20.0)).unwrap();
    assert_eq!(snapshot.time, 0.1);
    assert_eq!(snapshot.vehicles[0].unwrap().distance, 20.0);
    // A restart between send and receive works too, and ends the old process.
    let old = simulation.pid();
    simulation.send(&[]).unwrap();
    simulation.renew().unwrap();
    assert!(!lives(old));
    assert_eq!(simulation.step(&[]).unwrap().vehicles, [None]);
}

#[test]
fn what_sumo_says_when_it_dies_is_in_the_error() {
    let arguments = ["--net-file", "no/such.net.xml"].map(Into::into).to_vec();
    match Process::start(&Options { arguments, ..Options::default() }) {
        Err(Error::Exited { stderr_tail, .. }) => {
            assert!(stderr_tail.contains("such.net.xml"), "{stderr_tail}");
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_route_that_the_net_does_not_have_is_refused_by_name() {
    let mut bad = config(1);
    bad.routes[1].edges[1] = "nowhere".into();
    match TraciSimulation::start(bad) {
        Err(Error::Refused { command, id, message, .. }) => {
            assert_eq!((command, id.as_str()), (Domain::ROUTE.set, "northbound"));
            assert!(message.contains("nowhere"), "{message}");
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn the_public_client_batches_gets_and_subscribes() {
    let options =
        Options { arguments: vec!["--net-file".into(), net().into()], ..Options::default() };
    let (_process, mut client, _) = Process::start(&options).unwrap();
    client.route().add("r", &["west_in", "east_out"]).unwrap();
    let mut batch = Batch::new();
    batch.vehicle().add("v", &Addition { depart_pos: "140", ..Addition::on_route("r") });
    batch.vehicle().set_speed("ghost", 1.0);
    batch.simulation().get_time();
    batch.get(Domain::VEHICLE, vehicle::TRACI_ID_LIST.number(), "");
    batch.subscribe(Domain::SIMULATION, "", &[simulation::VAR_TIME.id()]);
    batch.subscribe_context(
        Domain::JUNCTION,
        "c",
        Domain::VEHICLE,
        100.0,
        &[vehicle::VAR_SPEED.id()],
    );
    let reply = client.step(&mut batch, 0.0).unwrap();
    assert!(batch.is_empty());
    let outcomes: Vec<_> = reply.outcomes.iter().map(|o| o.as_ref().ok()).collect();
    let list = Value::StringList(vec![]);
    assert_eq!(
        outcomes,
        [
            Some(&None),
            None,
            Some(&Some(Value::Double(0.0))),
            Some(&Some(list)),
            Some(&None),
            Some(&None)
        ]
    );
    let find = |around: Option<&str>, object: &str| {
        reply
            .subscriptions
            .iter()
            .find(|o| o.around.as_deref() == around && *o.object == *object)
            .map(|o| &o.value)
    };
    assert_eq!(find(None, ""), Some(&Ok(Value::Double(1.0))));
    assert_eq!(find(Some("c"), "v"), Some(&Ok(Value::Double(0.0))));
    // Ten steps in one exchange; then one value of each kind that SUMO nests.
    let reply = client.step(&mut batch, 11.0).unwrap();
    assert!(reply.subscriptions.iter().any(|o| o.value == Ok(Value::Double(11.0))));
    let collisions = client
        .call(|b| b.get(Domain::SIMULATION, simulation::VAR_COLLISIONS.number(), ""))
        .unwrap();
    assert_eq!(collisions, Some(Value::Compound(vec![Value::Integer(0)])));
    assert!(matches!(
        client.call(|b| b.get(Domain::VEHICLE, 0xfe, "v")),
        Err(Error::Refused { .. })
    ));
    client.vehicle().remove("v", c::REMOVE_VAPORIZED).unwrap();
    client.step(&mut batch, 0.0).unwrap().check().unwrap();
    client.close().unwrap();
}

#[test]
fn the_public_client_reads_collisions_whose_count_sumo_gets_wrong() {
    let words = [
        "--collision.action",
        "warn",
        "--collision.mingap-factor",
        "0",
        "--eager-insert",
        "--no-warnings",
    ];
    let mut options = Options { arguments: words.map(Into::into).to_vec(), ..Options::default() };
    options.arguments.extend(["--net-file".into(), net().into()]);
    let (_process, mut client, _) = Process::start(&options).unwrap();
    let mut batch = Batch::new();
    batch.route().add("r", &["west_in", "east_out"]);
    for (vehicle, position, speed) in
        [("first", "100", 0.0), ("second", "90", 3.0), ("third", "80", 5.0)]
    {
        batch.vehicle().add(vehicle, &Addition { depart_pos: position, ..Addition::on_route("r") });
        batch.vehicle().set_speed_mode(vehicle, 32);
        batch.vehicle().set_speed(vehicle, speed);
    }
    batch.subscribe(Domain::SIMULATION, "", &[simulation::VAR_COLLISIONS.id()]);
    let mut most = 0;
    for _ in 0..10 {
        let reply = client.step(&mut batch, 0.0).unwrap();
        let Ok(Value::Compound(items)) = &reply.subscriptions[0].value else { panic!("{reply:?}") };
        let Value::Integer(count) = items[0] else { panic!("{items:?}") };
        assert_eq!(items.len() as i32, 1 + 9 * count);
        let again = client
            .call(|b| b.get(Domain::SIMULATION, simulation::VAR_COLLISIONS.number(), ""))
            .unwrap();
        assert_eq!(again.as_ref(), reply.subscriptions[0].value.as_ref().ok());
        most = most.max(count);
    }
    assert!(most >= 2, "{most}");
}

/// Starts a listener that answers the first bytes that it receives with `answer`.
fn impostor(answer: &'static [u8]) -> (SocketAddr, thread::JoinHandle<()>) {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    let address = listener.local_addr().unwrap();
    let work = move || {
        let (mut stream, _) = listener.accept().unwrap();
        let _ = stream.read(&mut [0; 64]);
        let _ = stream.write_all(answer);
        let _ = stream.read(&mut [0; 64]);
    };
    (address, thread::spawn(work))
}

#[test]
fn a_stranger_that_speaks_something_else_is_refused() {
    let strangers: [&[u8]; 3] = [
        b"HTTP/1.1 400 Bad Request\r\n\r\n",
        b"SSH-2.0-OpenSSH_9.2\r\n",
        &[0, 0, 0, 9, 1, 2, 3, 4, 5],
    ];
    for answer in strangers {
        let (address, peer) = impostor(answer);
        let mut client = Client::connect(address, Duration::from_secs(5)).unwrap();
        let error = client.handshake().unwrap_err();
        assert!(matches!(error, Error::Protocol { .. }) && error.is_fatal(), "{error}");
        drop(client);
        peer.join().unwrap();
    }
}

#[test]
fn a_stranger_that_says_nothing_is_a_timeout() {
    let (address, peer) = impostor(b"");
    let mut client = Client::connect(address, Duration::from_millis(100)).unwrap();
    assert!(matches!(client.handshake(), Err(Error::Timeout { .. })));
    drop(client);
    peer.join().unwrap();
}

#[test]
fn an_older_traci_is_refused_with_both_numbers() {
    const ANSWER: &[u8] = &[
        0, 0, 0, 31, 7, 0, 0, 0, 0, 0, 0, 20, 0, 0, 0, 0, 19, 0, 0, 0, 10, b'S', b'U', b'M', b'O',
        b' ', b'1', b'.', b'8', b'.', b'0',
    ];
    let (address, peer) = impostor(ANSWER);
    let mut client = Client::connect(address, Duration::from_secs(5)).unwrap();
    match client.handshake() {
        Err(Error::Version { found: 19, minimum: 20, peer }) => assert_eq!(peer, "SUMO 1.8.0"),
        other => panic!("{other:?}"),
    }
    drop(client);
    peer.join().unwrap();
}

#[test]
fn a_busy_port_is_named() {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    let busy = listener.local_addr().unwrap().port();
    let options = Options { port: Some(busy), ..Options::default() };
    match Process::start(&options) {
        Err(error @ Error::PortTaken { port }) => {
            assert_eq!(port, busy);
            assert!(error.to_string().contains(&busy.to_string()) && error.hint().is_some());
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn nothing_listens_where_nobody_is() {
    let address = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap().local_addr().unwrap();
    assert!(matches!(Client::connect(address, Duration::from_secs(1)), Err(Error::Connect { .. })));
}

#[test]
fn no_sumo_is_left_after_a_drop() {
    let simulation = start(1);
    let pid = simulation.pid();
    assert!(lives(pid));
    drop(simulation);
    assert!(!Path::new(&format!("/proc/{pid}")).exists(), "not waited for");
}

#[test]
fn no_sumo_is_left_after_a_panic() {
    let (send, receive) = std::sync::mpsc::channel();
    let panicked = thread::spawn(move || {
        let simulation = start(1);
        send.send(simulation.pid()).unwrap();
        panic!("on purpose, with SUMO {} alive", simulation.pid());
    });
    let pid = receive.recv().unwrap();
    assert!(panicked.join().is_err());
    assert!(!Path::new(&format!("/proc/{pid}")).exists());
}

#[test]
fn sumo_outlives_the_thread_that_asked_for_it() {
    let mut simulation = thread::spawn(|| start(1)).join().unwrap();
    thread::sleep(Duration::from_millis(100));
    simulation.step(&[]).unwrap();
}

/// Environment variable that makes the test below act as the victim: the test runs itself a second
/// time with this variable, and the second run starts SUMO and waits to be killed. The value is the
/// path of the file to which the victim writes SUMO's process identifier.
const VICTIM: &str = "IWOL_TEST_VICTIM";

/// Runs the test below as a victim, kills it, and asserts that its SUMO ends.
fn kill_owner() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("pid");
    let mut victim = Program::new(std::env::current_exe().unwrap())
        .arg("no_sumo_that_loads_is_left_after_its_owner_is_killed")
        .env(VICTIM, &file)
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let begin = Instant::now();
    let pid: u32 = loop {
        let text = std::fs::read_to_string(&file).unwrap_or_default();
        match text.strip_suffix('\n').map(str::parse) {
            Some(pid) => break pid.unwrap(),
            None => assert!(begin.elapsed() < Duration::from_secs(20), "the victim starts no SUMO"),
        }
        thread::sleep(Duration::from_millis(2));
    };
    // During `exec`, a process briefly has no command line.
    while !lives(pid) {
        assert!(begin.elapsed() < Duration::from_secs(20), "SUMO ended by itself");
        thread::sleep(Duration::from_millis(1));
    }
    victim.kill().unwrap();
    victim.wait().unwrap();
    let ended = ends(pid);
    if !ended {
        signal("-KILL", pid);
    }
    assert!(ended, "SUMO {pid} was an orphan");
}

/// Tests that a SUMO that is still loading ends with its owner. While SUMO loads, it has no
/// connection whose end it could notice; the script stands for a SUMO that never finishes loading.
#[test]
fn no_sumo_that_loads_is_left_after_its_owner_is_killed() {
    let Some(file) = std::env::var_os(VICTIM) else {
        return kill_owner();
    };
    let script = "echo $$ > \"$0\"; exec sleep 60";
    let arguments = vec!["-c".into(), script.into(), file];
    let options = Options { binary: Some("/bin/sh".into()), arguments, ..Options::default() };
    panic!("{:?}", Process::start(&options));
}
