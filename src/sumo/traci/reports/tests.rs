//! Tests of reports in any order, incomplete reports, and numbers that are none.

use super::*;
use crate::sumo::{
    BackgroundTraffic, Batch, Body, Collision, SimulationConfig, VehicleState, codec::Writer,
    domain::VariableId, reply::parse_reply,
};

fn fleet(others: Option<BackgroundTraffic>) -> Fleet {
    Fleet::new(SimulationConfig { others, ..SimulationConfig::crossing(2) }).unwrap()
}

/// Reads the reply to a step in which `report` writes the only report of a subscription.
fn read(fleet: &mut Fleet, report: impl FnOnce(&mut Writer)) -> Result<(), Error> {
    let mut batch = Batch::new();
    batch.seal(Some(0.0))?;
    let mut w = Writer::default();
    w.command(c::CMD_SIMSTEP, |w| {
        w.u8(c::RTYPE_OK).str("");
    });
    w.i32(1);
    report(&mut w);
    fleet.begin_step();
    parse_reply(w.finish()?, &batch, &mut StepSink::new(fleet))
}

/// Writes the report of a world with one vehicle and these variables, in this order.
fn around(w: &mut Writer, vehicle: &str, variables: &[VariableId]) {
    w.command(Domain::JUNCTION.context + 0x10, |w| {
        w.str("j").u8(Domain::VEHICLE.get).u8(variables.len() as u8).i32(1).str(vehicle);
        for variable in variables {
            w.u8(variable.number()).u8(c::RTYPE_OK);
            match variable.number() {
                POSITION => w.position([3.0, 4.0], false),
                DISTANCE => w.double(5.0),
                SPEED => w.double(6.0),
                ANGLE => w.double(90.0),
                LANE => w.string("south_in_0"),
                _ => w.double(7.0),
            };
        }
    });
}

#[test]
fn the_order_of_the_variables_does_not_matter() {
    let mut fleet = fleet(Some(BackgroundTraffic::default()));
    let mut variables = [
        VAR_DISTANCE.id(),
        VAR_SPEED.id(),
        VAR_POSITION.id(),
        VAR_ANGLE.id(),
        VAR_LANE_ID.id(),
        VAR_TIMELOSS.id(),
    ];
    let lane = fleet.lane("south_in_0");
    assert!(lane.is_some(), "the net has this lane");
    for i in 0..30 {
        variables.swap(i % 5, i % 5 + 1);
        read(&mut fleet, |w| around(w, "w0s1", &variables)).unwrap();
        let vehicle = VehicleState { distance: 5.0, speed: 6.0 };
        assert_eq!(fleet.snapshot.vehicles, [None, Some(vehicle)], "{variables:?}");
        let body = Body { x: 3.0, y: 4.0, heading: 0.0, lane, time_loss: 7.0 };
        assert_eq!(fleet.snapshot.bodies, [None, Some(body)], "{variables:?}");
    }
}

#[test]
fn a_missing_variable_is_named() {
    let mut fleet = fleet(Some(BackgroundTraffic::default()));
    let all = [
        (VAR_DISTANCE.id(), "distance"),
        (VAR_SPEED.id(), "speed"),
        (VAR_POSITION.id(), "position"),
        (VAR_ANGLE.id(), "angle"),
        (VAR_LANE_ID.id(), "lane"),
        (VAR_TIMELOSS.id(), "time loss"),
    ];
    for (missing, name) in all {
        let others: Vec<_> = all.iter().map(|(id, _)| *id).filter(|id| *id != missing).collect();
        let error = read(&mut fleet, |w| around(w, "w0s1", &others)).unwrap_err();
        assert!(matches!(error, Error::Protocol { .. }));
        let text = error.to_string();
        assert!(text.contains(&format!("`{name}`")) && text.contains("`w0s1`"), "{text}");
        // The report of a vehicle that belongs to no slot is not used.
        read(&mut fleet, |w| around(w, "stranger", &others)).unwrap();
    }
}

#[test]
fn a_time_that_is_no_number_is_refused() {
    for (time, good) in [(1.5, true), (f64::NAN, false), (f64::INFINITY, false)] {
        let mut fleet = fleet(None);
        let result = read(&mut fleet, |w| {
            w.command(Domain::SIMULATION.subscribe + 0x10, |w| {
                w.str("").u8(1).u8(TIME).u8(c::RTYPE_OK).double(time);
            });
        });
        assert_eq!((result.is_ok(), fleet.snapshot.time == time), (good, good), "{time}");
    }
}

#[test]
fn collisions_of_strangers_or_of_one_vehicle_and_hostile_counts_are_no_collisions() {
    let mut w = Writer::default();
    w.compound(28).integer(3);
    for pair in [["w0s1", "w0s0"], ["w0s1", "w0s2"], ["w0s1", "w0s1"]] {
        w.string(pair[0]).string(pair[1]).string("car").string("car").double(1.0).double(2.0);
        w.string("junction").string(":c_0_0").double(3.0);
    }
    let mut fleet = fleet(None);
    read_collisions(&mut Reader::new(&w.bytes()[4..], 4), &mut fleet).unwrap();
    assert_eq!(fleet.snapshot.collisions, [Collision { world: 0, collider: 1, victim: 0 }]);
    let mut w = Writer::default();
    w.compound(1).integer(i32::MAX);
    assert!(read_collisions(&mut Reader::new(&w.bytes()[4..], 4), &mut fleet).is_err());
}
