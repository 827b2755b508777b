//! Simulations on the real SUMO: exchanges, departures and arrivals of vehicles, refusals. These
//! tests fail if SUMO is missing.

use std::path::{Path, PathBuf};
use std::process::Command as Program;
use std::sync::OnceLock;
use std::time::Duration;

use iwol_sumo::sumo::constants::Domain;
use iwol_sumo::sumo::{
    Collision, Command, Error, Route, Simulation, SimulationConfig, TraciSimulation, VehicleState,
    VehicleType, find_program,
};

const LENGTH: f64 = 4.515;

pub(super) const EAST: u32 = 0;

pub(super) const NORTH: u32 = 1;

/// Returns a net of two straight roads, each 300 m long, that cross at the origin; SUMO's
/// netconvert builds it once.
pub(super) fn net() -> &'static Path {
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
        let netconvert = find_program("netconvert")
            .unwrap_or_else(|e| panic!("{e}; hint: {}", e.hint().unwrap_or_default()));
        let output = Program::new(netconvert)
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
        waits: false,
        others: None,
        traffic_lights: Vec::new(),
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

pub(super) fn start(slots: u32) -> TraciSimulation {
    TraciSimulation::start(config(slots))
        .unwrap_or_else(|e| panic!("{e}; hint: {}", e.hint().unwrap_or_default()))
}

pub(super) fn add(slot: u32, route: u32, depart_pos: f64) -> [Command; 2] {
    let add =
        Command::Add { world: 0, slot, route, vehicle_type: 0, depart_pos, depart_speed: 0.0 };
    [add, Command::SpeedMode { world: 0, slot, mode: 32 }]
}

pub(super) fn remove(slot: u32) -> Command {
    Command::Remove { world: 0, slot }
}

pub(super) fn speed(slot: u32, speed: f64) -> Command {
    Command::SetSpeed { world: 0, slot, speed }
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
    // The same edges lead over a crossing with signals.
    tiled.net = crate::support::root().join("sumo_nets/signals/signals.net.xml");
    tiled.traffic_lights = vec!["centre".into()];
    let mut simulation = TraciSimulation::start(tiled).unwrap();
    let all = || (0..3).flat_map(|world| (0..8).map(move |slot| (world, slot)));
    let mut begin = Vec::new();
    for (world, slot) in all() {
        let depart_pos = 10.0 + 6.0 * f64::from(slot);
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
