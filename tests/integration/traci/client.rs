//! The public client on the real SUMO.

use iwol_sumo::sumo::constants::{self as c, Domain};
use iwol_sumo::sumo::domain::simulation;
use iwol_sumo::sumo::domain::vehicle::{self, Addition};
use iwol_sumo::sumo::process::{Options, Process};
use iwol_sumo::sumo::{Batch, Error, Value};

use super::simulation::net;

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
