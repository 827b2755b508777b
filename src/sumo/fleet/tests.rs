//! Tests of SUMO's command line and of commands that are not sent.

use super::*;
use crate::sumo::{BackgroundTraffic, Batch, Command, Departure};

#[test]
fn step_lengths_that_sumo_cannot_have_are_refused() {
    let arguments = |step_length| {
        let config =
            SimulationConfig { step_length, seed: u64::MAX, ..SimulationConfig::crossing(2) };
        Fleet::new(config).unwrap().arguments()
    };
    for bad in [0.0, -0.1, 0.0005, 0.10005, f64::NAN, f64::INFINITY] {
        assert!(matches!(arguments(bad), Err(Error::Invalid { .. })), "{bad}");
    }
    let words = arguments(0.1).unwrap();
    assert_eq!(words[2..6], ["--step-length", "0.1", "--seed", "2147483647"]);
}

#[test]
fn commands_that_are_refused_do_not_make_a_pedestrian_of_a_vehicle() {
    let others = BackgroundTraffic {
        types: vec!["walker".into()],
        departures: vec![Departure::Walk { route: 0, pos: 0.0, arrival: 1.0 }],
        ..BackgroundTraffic::default()
    };
    let edges = vec!["west_in".into()];
    let walk = Route { id: "walk".into(), edges, lane: 0, walked: true };
    let crossing = SimulationConfig::crossing(2);
    let config = SimulationConfig { others: Some(others), routes: vec![walk], ..crossing };
    let mut fleet = Fleet::new(config).unwrap();
    let mut batch = Batch::new();
    let mut message = |fleet: &mut Fleet, commands: &[Command]| {
        batch.clear();
        fleet.write(commands, &mut batch)?;
        Ok::<_, Error>(batch.seal(None)?.to_vec())
    };
    let (world, slot) = (0, 0);
    let speed = |speed| Command::SetSpeed { world, slot, speed };
    let before = message(&mut fleet, &[speed(1.0)]).unwrap();
    let departure =
        Command::Depart { world, slot, departure: 0, vehicle_type: 0, until_from_now: 0.0 };
    assert!(message(&mut fleet, &[departure, speed(f64::NAN)]).is_err());
    assert_eq!(message(&mut fleet, &[speed(1.0)]).unwrap(), before);
    // The commands after a departure concern the pedestrian.
    let after = message(&mut fleet, &[departure, speed(1.0)]).unwrap();
    assert!(after.windows(2).any(|ids| ids == [crate::sumo::Domain::PERSON.set, 0x40]));
}
