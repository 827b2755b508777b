//! Tests of sessions with the real simulator: steps, loading of states and simulations, kinds of
//! objects without a module, and several clients.

use std::{
    net::{Ipv4Addr, SocketAddr, TcpListener},
    process::{Child, Command, Stdio},
    thread,
    time::Duration,
};

use iwol_sumo::sumo::{
    Batch, Client, Domain, Error, Value, Variable, Version,
    domain::vehicle,
    find_program,
    process::{Options, Process},
};

use super::{NET, world::World};

fn start() -> (Process, Client) {
    let arguments = ["--net-file", NET].map(Into::into).to_vec();
    let (process, client, _) =
        Process::start(&Options { arguments, ..Options::default() }).unwrap();
    (process, client)
}

#[test]
fn a_step_goes_to_a_time_in_the_future_or_nowhere() {
    let (process, mut client) = start();
    for until in [-1.0, f64::NAN, f64::INFINITY] {
        assert!(matches!(client.simulation_step(until), Err(Error::Invalid { .. })), "{until}");
    }
    assert_eq!(client.simulation().get_time().unwrap(), 0.0);
    client.simulation_step(7.0).unwrap();
    for until in [3.0, 7.0] {
        client.simulation_step(until).unwrap();
        assert_eq!(client.simulation().get_time().unwrap(), 7.0);
    }
    client.simulation_step(0.0).unwrap();
    assert_eq!(client.simulation().get_time().unwrap(), 8.0);
    // An error contains the last known simulation time.
    drop(process);
    match client.simulation_step(0.0) {
        Err(Error::Closed { sim_time_s, .. }) => assert_eq!(sim_time_s, Some(8.0)),
        other => panic!("{other:?}"),
    }
    let (process, mut client) = start();
    drop(process);
    match client.simulation_step(0.0) {
        Err(error @ Error::Closed { sim_time_s: None, .. }) => {
            assert!(!error.to_string().contains("time"));
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn kinds_of_objects_are_reached_by_number() {
    let world = World::new();
    let (_process, mut client) = world.start();
    let (list, name) = (0x00, 0x1b);
    for (domain, ids) in [
        (Domain::BUS_STOP, &["stop"][..]),
        (Domain::CALIBRATOR, &[]),
        (Domain::CHARGING_STATION, &[]),
        (Domain::MEAN_DATA, &[]),
        (Domain::MULTI_ENTRY_EXIT, &[]),
        (Domain::OVERHEAD_WIRE, &[]),
        (Domain::REROUTER, &[]),
        (Domain::ROUTE_PROBE, &[]),
        (Domain::VARIABLE_SPEED_SIGN, &[]),
    ] {
        let answer = client.call(|batch| batch.get(domain, list, "")).unwrap();
        assert_eq!(
            answer,
            Some(Value::StringList(ids.iter().map(|&id| id.to_owned()).collect())),
            "{domain:?}"
        );
    }
    let name = Variable::<String>::new(Domain::BUS_STOP, name);
    let mut batch = Batch::new();
    batch.subscribe(Domain::BUS_STOP, "stop", &[name.id()]);
    let reply = client.step(&mut batch, 0.0).unwrap();
    reply.check().unwrap();
    assert_eq!(reply.get("stop", name).unwrap().unwrap(), "Halt");
}

#[test]
fn states_and_simulations_are_loaded() {
    let world = World::new();
    let (_process, mut client) = world.start();
    client.simulation_step(30.0).unwrap();
    let file = world.file("state.xml");
    let file = file.to_str().unwrap();
    client.simulation().save_state(file).unwrap();
    client.vehicle().subscribe("bus", &[vehicle::VAR_SPEED.id()]).unwrap();
    assert!(client.simulation_step(40.0).unwrap().get("bus", vehicle::VAR_SPEED).is_some());
    client.simulation().load_state(file).unwrap();
    assert_eq!(client.simulation().get_time().unwrap(), 30.0);
    assert!(
        client.simulation_step(0.0).unwrap().subscriptions.is_empty(),
        "subscriptions are lost"
    );
    assert!(matches!(client.simulation().load_state("/nowhere.xml"), Err(Error::Refused { .. })));
    assert!(client.load(&world.arguments()).unwrap().software.contains("SUMO"));
    assert_eq!(client.simulation().get_time().unwrap(), 0.0);
    client.simulation_step(2.0).unwrap();
    assert!(client.vehicle().get_id_list().unwrap().contains(&"parker".to_owned()));
}

/// A simulation that SUMO cannot load is an error of the call that asks for it.
#[test]
fn a_simulation_that_cannot_be_loaded_is_an_error_at_once() {
    let (mut process, mut client) = start();
    let missing = client.load(&["--net-file", "/nowhere.net.xml"]);
    assert!(matches!(missing, Err(Error::Closed { .. })), "{missing:?}");
    let (mut other, mut client) = start();
    let missing = other.load(&mut client, &["--net-file", "/nowhere.net.xml"]);
    assert!(matches!(missing, Err(Error::Exited { .. })), "{missing:?}");
    assert!(matches!(process.wait(Duration::from_secs(20)), Err(Error::Exited { .. })));
}

/// After a connection is closed, SUMO finishes its output files, if it is given the time.
#[test]
fn output_files_are_complete_after_a_wait() {
    let world = World::new();
    let [trips, summary] = ["trips.xml", "summary.xml"].map(|name| world.file(name));
    let mut arguments: Vec<_> = world.arguments().into_iter().map(Into::into).collect();
    let outputs = [("--tripinfo-output", &trips), ("--summary-output", &summary)];
    arguments.extend(outputs.iter().flat_map(|(option, file)| [(*option).into(), (*file).into()]));
    let options = Options { arguments, ..Options::default() };
    let (mut process, mut client, _) = Process::start(&options).unwrap();
    client.simulation_step(600.0).unwrap();
    let early = process.wait(Duration::ZERO);
    assert!(matches!(early, Err(Error::Timeout { .. })), "{early:?}");
    client.close().unwrap();
    process.wait(Duration::from_secs(20)).unwrap();
    for (file, end) in [(trips, "</tripinfos>"), (summary, "</summary>")] {
        let text = std::fs::read_to_string(&file).unwrap();
        assert!(text.trim_end().ends_with(end), "{}", file.display());
    }
}

/// Variables with an argument can be read in kinds of objects that have no module.
#[test]
fn variables_with_an_argument_are_read_by_number() {
    let (_process, mut client) = World::new().start();
    client
        .call(|batch| {
            batch.set(Domain::BUS_STOP, 0x7e, "stop", |w| {
                w.u8(0x0f).i32(2).string("key").string("value");
            });
        })
        .unwrap();
    let answer = client.call(|batch| {
        batch.get_with(Domain::BUS_STOP, 0x7e, "stop", |w| {
            w.string("key");
        });
    });
    assert_eq!(answer.unwrap(), Some(Value::String("value".to_owned())));
}

/// A SUMO process that is killed when this value is dropped.
struct Owned(Child);

impl Drop for Owned {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn two_clients_take_turns() {
    let port = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap().local_addr().unwrap().port();
    let mut sumo = Command::new(find_program("sumo").unwrap());
    sumo.args(["--net-file", NET, "--num-clients", "2", "--remote-port", &port.to_string()]);
    let _sumo = Owned(sumo.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap());
    let address = SocketAddr::from((Ipv4Addr::LOCALHOST, port));
    let connect = || {
        Client::connect_within(address, Duration::from_secs(20), Duration::from_secs(20)).unwrap()
    };
    let (mut first, mut second) = (connect(), connect());
    let other = thread::spawn(move || {
        second.set_order(2).unwrap();
        let Version { api, .. } = second.handshake().unwrap();
        // SUMO carries out the first client's commands before those of this client.
        let routes = second.route().get_id_list().unwrap();
        second.simulation_step(0.0).unwrap();
        let time = second.simulation().get_time().unwrap();
        second.close().unwrap();
        (api, routes, time)
    });
    first.set_order(1).unwrap();
    let edges = first.edge().get_id_list().unwrap();
    first.route().add("r", &[edges.iter().find(|edge| !edge.starts_with(':')).unwrap()]).unwrap();
    first.simulation_step(0.0).unwrap();
    assert_eq!(first.simulation().get_time().unwrap(), 1.0);
    first.close().unwrap();
    assert_eq!(other.join().unwrap(), (20, vec!["r".to_owned()], 1.0));
}
