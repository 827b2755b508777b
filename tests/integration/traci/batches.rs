//! Tests of batches and tickets without a simulator: a warm batch allocates nothing, a wrong ticket
//! gives no value, no message from the peer causes a panic, and no wait exceeds the timeout.

use std::{
    hint::black_box,
    io::{Read as _, Write as _},
    net::{Ipv4Addr, TcpListener, TcpStream},
    thread,
    time::{Duration, Instant},
};

use allocation_counter::measure;
use iwol_sumo::sumo::{
    Batch, Client, Domain, Error, StepReply,
    codec::Writer,
    domain::vehicle::{self, Addition, Placement, Side},
};
use proptest::{collection::vec, prelude::*};

fn fill(batch: &mut Batch) {
    let edges = ["a_rather_long_edge_name"; 30];
    batch.route().add("r", &edges);
    batch.vehicle().add("v", &Addition::on_route("r"));
    for id in ["v0", "v1", "v2"] {
        batch.vehicle().set_speed(id, 3.0);
        batch.vehicle().change_lane(id, 1, 2.0);
        batch.vehicle().move_to_xy(id, [1.0, 2.0], &Placement::default());
        batch.vehicle().subscribe(id, &[vehicle::VAR_SPEED.id()]);
        batch.vehicle().get_speed(id);
    }
}

#[test]
fn a_warm_batch_is_filled_without_allocation() {
    let mut batch = Batch::new();
    fill(&mut batch);
    let commands = batch.len();
    batch.clear();
    assert_eq!(measure(|| fill(&mut batch)).count_total, 0);
    assert_eq!(batch.len(), commands);
    assert_eq!(measure(|| drop(black_box(Box::new(1)))).count_total, 1, "the counter counts");
}

/// Returns a client whose peer answers one message with `answer`, keeps the connection open for
/// `hold`, and then closes it.
fn client_of(answer: Vec<u8>, hold: Duration) -> (Client, thread::JoinHandle<()>) {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    let stream = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
    let peer = thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        let mut length = [0; 4];
        let read = stream.read_exact(&mut length).and_then(|()| {
            let left = u32::from_be_bytes(length) as usize - 4;
            stream.read_exact(&mut vec![0; left])
        });
        if read.is_ok() && stream.write_all(&answer).is_ok() {
            thread::sleep(hold);
        }
    });
    (Client::new(stream, Duration::from_secs(5)).unwrap(), peer)
}

/// Returns a message of statuses and answers, in the form that SUMO sends.
fn message(fill: impl FnOnce(&mut Writer)) -> Vec<u8> {
    let mut writer = Writer::default();
    fill(&mut writer);
    writer.finish().unwrap().to_vec()
}

fn status(w: &mut Writer, id: u8) {
    w.command(id, |w| {
        w.u8(0).str("");
    });
}

fn speed(w: &mut Writer, value: impl FnOnce(&mut Writer)) {
    status(w, Domain::VEHICLE.get);
    w.command(Domain::VEHICLE.get + 0x10, |w| {
        w.u8(vehicle::VAR_SPEED.number()).str("v");
        value(w);
    });
}

#[test]
fn a_ticket_is_good_for_the_replies_to_its_batch_only() {
    let answer = message(|w| {
        speed(w, |w| {
            w.double(2.5);
        });
        speed(w, |w| {
            w.double(3.5);
        });
    });
    let (mut client, peer) = client_of(answer, Duration::ZERO);
    let (mut batch, mut other) = (Batch::new(), Batch::new());
    let stale = batch.vehicle().get_speed("v");
    batch.clear();
    let strange = other.vehicle().get_speed("v");
    let first = batch.vehicle().get_speed("v");
    let second = batch.vehicle().get_speed("v");
    let mut replies = client.run(&mut batch).unwrap();
    let early = batch.vehicle().get_speed("v");
    for ticket in [stale, strange, early] {
        let error = replies.take(ticket).unwrap_err();
        assert!(matches!(error, Error::Invalid { .. }) && !error.is_fatal(), "{error}");
    }
    assert_eq!(replies.take(second).unwrap(), 3.5);
    assert_eq!(replies.take(first).unwrap(), 2.5);
    peer.join().unwrap();
}

#[test]
fn a_value_of_another_type_names_both_types_and_the_call() {
    let answer = message(|w| {
        speed(w, |w| {
            w.string("fast");
        });
    });
    let (mut client, peer) = client_of(answer, Duration::ZERO);
    match client.vehicle().get_speed("v") {
        Err(error @ Error::Type { .. }) => {
            assert!(!error.is_fatal());
            assert_eq!(
                error.to_string(),
                "vehicle.getSpeed gives a string where a double should be"
            );
        }
        other => panic!("{other:?}"),
    }
    peer.join().unwrap();
}

#[test]
fn a_silent_peer_costs_no_more_than_the_timeout() {
    let (mut client, peer) = client_of(Vec::new(), Duration::from_millis(400));
    assert!(matches!(client.set_timeout(Duration::ZERO), Err(Error::Invalid { .. })));
    client.set_timeout(Duration::from_millis(50)).unwrap();
    let start = Instant::now();
    match client.vehicle().get_speed("v") {
        Err(error @ Error::Timeout { command, .. }) => {
            assert_eq!(command, "vehicle.getSpeed");
            assert!(error.is_fatal());
        }
        other => panic!("{other:?}"),
    }
    assert!(start.elapsed() < Duration::from_millis(300), "{:?}", start.elapsed());
    // The client does not use the connection again.
    assert!(matches!(client.vehicle().get_speed("v"), Err(Error::Closed { .. })));
    peer.join().unwrap();
}

#[test]
fn a_client_waits_for_a_listener_as_long_as_it_is_told() {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    let address = listener.local_addr().unwrap();
    drop(listener);
    let start = Instant::now();
    match Client::connect_within(address, Duration::from_millis(100), Duration::from_secs(1)) {
        Err(Error::Connect { port, attempts, .. }) => {
            assert!(port == address.port() && attempts > 1);
        }
        other => panic!("{other:?}"),
    }
    assert!((100..2000).contains(&start.elapsed().as_millis()), "{:?}", start.elapsed());
    let late = thread::spawn(move || {
        thread::sleep(Duration::from_millis(100));
        TcpListener::bind(address).unwrap().accept().unwrap();
    });
    Client::connect_within(address, Duration::from_secs(10), Duration::from_secs(1)).unwrap();
    late.join().unwrap();
}

/// Takes one result; returns `true` if the result has a value.
type Take = Box<dyn FnOnce(&mut StepReply) -> bool>;

/// Puts calls of many forms into a batch and takes all their results from the reply.
fn ask(client: &mut Client, calls: &[u8]) -> Result<usize, Error> {
    let mut batch = Batch::new();
    let mut takes: Vec<Take> = Vec::new();
    macro_rules! call {
        ($($domain:ident.$call:ident($($argument:expr),*)),+ $(,)?) => {{
            let fill: &[fn(&mut Batch) -> Take] = &[$(|batch| {
                let ticket = batch.$domain().$call($($argument),*);
                Box::new(move |reply| reply.take(ticket).is_ok())
            }),+];
            for call in calls {
                takes.push(fill[usize::from(*call) % fill.len()](&mut batch));
            }
        }};
    }
    call!(
        vehicle.get_speed("v"),
        vehicle.set_speed("v", 1.0),
        vehicle.get_best_lanes("v"),
        vehicle.get_neighbors("v", 0),
        vehicle.get_next_tls("v"),
        vehicle.get_stops("v", 0),
        vehicle.get_leader("v", 1.0),
        vehicle.get_lane_change_state_pretty("v", Side::Left),
        vehicle.is_stopped("v"),
        vehicle.add_subscription_filter_cf_maneuver(),
        vehicle.subscribe("v", &[vehicle::VAR_SPEED.id(), vehicle::VAR_NEXT_STOPS.id()]),
        junction.subscribe_context("j", Domain::VEHICLE, 9.0, &[vehicle::VAR_SPEED.id()]),
        junction.get_shape("j"),
        lane.get_links("l"),
        traffic_light.get_all_program_logics("t"),
        traffic_light.get_controlled_links("t"),
        traffic_light.get_constraints("t", ""),
        person.get_stage("p", 0),
        person.get_taxi_reservations(false),
        simulation.get_collisions(),
        simulation.convert_road([1.0, 2.0], false, ""),
        induction_loop.get_vehicle_data("i"),
    );
    let mut reply = client.step(&mut batch, 0.0)?;
    for observed in &reply.subscriptions {
        let _ = reply.get(&observed.object, vehicle::VAR_SPEED);
        let _ = reply.get(&observed.object, vehicle::VAR_NEXT_STOPS);
        let _ = reply.around(Domain::JUNCTION, "j").objects().count();
    }
    Ok(takes.into_iter().filter_map(|take| take(&mut reply).then_some(())).count())
}

/// Generates the bytes of one value, which may be malformed.
fn value() -> impl Strategy<Value = Vec<u8>> {
    let kind = prop::sample::select(vec![0_u8, 1, 3, 4, 6, 7, 8, 9, 11, 12, 14, 15, 16, 17]);
    let small = 0..4_i32;
    prop_oneof![
        (kind, vec(any::<u8>(), 0..30)).prop_map(|(kind, bytes)| [vec![kind], bytes].concat()),
        // A compound that begins like SUMO's compounds and lists.
        (small.clone(), small, vec(any::<u8>(), 0..60)).prop_map(|(items, count, bytes)| {
            let head =
                [vec![15], items.to_be_bytes().to_vec(), vec![9], count.to_be_bytes().to_vec()];
            [head.concat(), bytes].concat()
        }),
    ]
}

/// Returns replies whose statuses fit the calls, but whose values do not.
fn almost(calls: &[u8], values: &[Vec<u8>]) -> Vec<u8> {
    // Command, variable, and whether SUMO answers with a value, in the order of the calls in `ask`.
    const ANSWERS: [(u8, u8, bool); 22] = [
        (0xa4, 0x40, true),
        (0xc4, 0x40, false),
        (0xa4, 0xb2, true),
        (0xa4, 0xbf, true),
        (0xa4, 0x70, true),
        (0xa4, 0x74, true),
        (0xa4, 0x68, true),
        (0xa4, 0x13, true),
        (0xa4, 0xb5, true),
        (0x7e, 0, false),
        (0xd4, 0, true),
        (0x89, 0, true),
        (0xa9, 0x4e, true),
        (0xa3, 0x33, true),
        (0xa2, 0x2b, true),
        (0xa2, 0x27, true),
        (0xa2, 0x2f, true),
        (0xae, 0xc0, true),
        (0xae, 0xc6, true),
        (0xab, 0x23, true),
        (0xab, 0x82, true),
        (0xa0, 0x17, true),
    ];
    message(|w| {
        for (call, value) in calls.iter().zip(values) {
            let (command, variable, answered) = ANSWERS[usize::from(*call) % ANSWERS.len()];
            status(w, command);
            if command == 0x7e {
                status(w, command);
            }
            if answered {
                w.command(command + 0x10, |w| {
                    if variable != 0 {
                        w.u8(variable);
                    }
                    w.str("v");
                    for byte in value {
                        w.u8(*byte);
                    }
                });
            }
        }
        status(w, 0x02);
        w.i32(0);
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn no_reply_makes_the_client_panic(calls in vec(any::<u8>(), 1..6), bytes in vec(any::<u8>(), 0..300)) {
        let length = (bytes.len() as u32 + 4).to_be_bytes();
        let (mut client, peer) = client_of([&length, &bytes[..]].concat(), Duration::ZERO);
        prop_assert!(ask(&mut client, &calls).is_err());
        peer.join().unwrap();
    }

    #[test]
    fn no_value_makes_the_client_panic(calls in vec(any::<u8>(), 1..6), values in vec(value(), 6)) {
        let (mut client, peer) = client_of(almost(&calls, &values), Duration::ZERO);
        match ask(&mut client, &calls) {
            Ok(taken) => prop_assert!(taken <= calls.len()),
            Err(error) => prop_assert!(matches!(error, Error::Protocol { .. }), "{error}"),
        }
        peer.join().unwrap();
    }

    #[test]
    fn answers_that_fit_are_taken(calls in vec(prop::sample::select(vec![0_u8, 1, 9]), 1..9), speed in any::<f64>()) {
        let value = [vec![11], speed.to_be_bytes().to_vec()].concat();
        let (mut client, peer) = client_of(almost(&calls, &vec![value; calls.len()]), Duration::ZERO);
        prop_assert_eq!(ask(&mut client, &calls).unwrap(), calls.len());
        peer.join().unwrap();
    }
}
