//! Tests of batches: their bytes, and which commands are not sent.

use super::*;
use crate::sumo::domain::{person, vehicle};

#[test]
fn the_step_is_always_the_last_command() {
    let mut batch = Batch::new();
    batch.vehicle().set_speed("a", 1.0);
    let once = batch.seal(Some(0.0)).unwrap().to_vec();
    assert_eq!(batch.seal(Some(0.0)).unwrap(), once);
    batch.vehicle().set_speed("b", 2.0);
    batch.seal(Some(0.0)).unwrap();
    let (queued, stepped) = batch.sealed();
    assert!(stepped);
    assert_eq!(
        queued.iter().map(|q| q.call.command).collect::<Vec<_>>(),
        [0xc4, 0xc4, c::CMD_SIMSTEP]
    );
    assert_eq!(queued.iter().map(|q| batch.object(q)).collect::<Vec<_>>(), ["a", "b", ""]);
    batch.seal(None).unwrap();
    assert_eq!(batch.sealed().0.len(), 2);
    batch.clear();
    assert_eq!(batch.seal(None).unwrap(), [0, 0, 0, 4]);
}

#[test]
fn a_long_command_keeps_the_name_of_its_object() {
    let mut batch = Batch::new();
    batch.route().add("route", &["a_rather_long_edge_name"; 50]);
    batch.subscribe(Domain::VEHICLE, "v", &[vehicle::VAR_SPEED.id()]);
    let names: Vec<_> = batch.sealed().0.iter().map(|q| batch.object(q)).collect();
    assert_eq!(names, ["route", "v"]);
}

#[test]
fn what_sumo_dies_of_is_not_in_the_message() {
    let mut batch = Batch::new();
    let speed = vehicle::VAR_SPEED.id();
    batch.subscribe(Domain::PERSON, "p", &[person::VAR_SPEED.id(), speed]);
    batch.subscribe(Domain::VEHICLE, "v", &[speed; 256]);
    batch.subscribe_with(Domain::LANE, "l", vehicle::VAR_LEADER, 1.0);
    batch.subscribe_context(Domain::VEHICLE, "v", Domain::PERSON, 9.0, &[speed]);
    for around in [
        Domain::TRAFFIC_LIGHT,
        Domain::VEHICLE_TYPE,
        Domain::ROUTE,
        Domain::SIMULATION,
        Domain::GUI,
        Domain::MULTI_ENTRY_EXIT,
    ] {
        batch.subscribe_context(Domain::VEHICLE, "v", around, 9.0, &[]);
    }
    assert_eq!(batch.seal(None).unwrap(), [0, 0, 0, 4]);
    assert!(batch.is_silent() && batch.len() == 10);
    assert!(batch.sealed().0.iter().all(|queued| queued.invalid.is_some()));
    batch.subscribe(Domain::VEHICLE, "v", &[speed; 255]);
    batch.subscribe_context(Domain::PERSON, "p", Domain::VEHICLE, 9.0, &[speed]);
    assert!(
        !batch.is_silent() && batch.sealed().0[10..].iter().all(|queued| queued.invalid.is_none())
    );
}

#[test]
fn a_step_goes_to_a_time() {
    let mut batch = Batch::new();
    batch.vehicle().set_speed("a", 1.0);
    let message = batch.seal(None).unwrap().to_vec();
    for until in [-1.0, f64::NAN, f64::INFINITY] {
        assert!(matches!(batch.seal(Some(until)), Err(Error::Invalid { .. })), "{until}");
    }
    assert_eq!(batch.seal(None).unwrap(), message);
}

#[test]
fn bytes_of_a_set_speed_are_those_of_the_protocol() {
    let mut batch = Batch::new();
    batch.vehicle().set_speed("v0", 3.0);
    let expected = [
        0, 0, 0, 31, // message length
        17, 0xc4, 0x40, 0, 0, 0, 2, b'v', b'0', 0x0b, 0x40, 0x08, 0, 0, 0, 0, 0,
        0, // set speed
        10, 0x02, 0, 0, 0, 0, 0, 0, 0, 0, // step
    ];
    let mut expected = expected.to_vec();
    expected[3] = expected.len() as u8;
    expected[4] = (expected.len() - 14) as u8;
    assert_eq!(batch.seal(Some(0.0)).unwrap(), expected);
}
