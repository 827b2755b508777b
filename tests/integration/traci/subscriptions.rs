//! Tests of subscriptions against the real simulator: their reports and filters, and that no
//! subscription crashes SUMO.

use iwol_sumo::sumo::{
    Batch, Client, Domain, Error, Reports, Value, Variable, VariableId,
    domain::{
        gui, lane, person, route, simulation, traffic_light,
        vehicle::{self, Side},
        vehicle_type,
    },
};

use super::{refused, world::World};

fn is_invalid<T>(result: &Result<T, Error>) -> bool {
    matches!(result, Err(error @ Error::Invalid { .. }) if !error.is_fatal())
}

#[test]
fn context_subscriptions_are_reported_and_filtered() {
    let world = World::new();
    let (_process, mut client) = world.start();
    client.simulation_step(50.0).unwrap();
    // No subscription exists that a filter could restrict.
    let (call, ..) = refused(client.vehicle().add_subscription_filter_downstream_distance(10.0));
    assert_eq!(call, "vehicle.addSubscriptionFilterDownstreamDistance");
    let variables =
        [vehicle::VAR_SPEED.id(), vehicle::VAR_POSITION.id(), vehicle::VAR_LANE_ID.id()];
    // The junction has context subscriptions to vehicles and persons, the vehicle to other
    // vehicles.
    client.junction().subscribe_context("c", Domain::VEHICLE, 60.0, &variables).unwrap();
    client
        .junction()
        .subscribe_context("c", Domain::PERSON, 500.0, &[person::VAR_SPEED.id()])
        .unwrap();
    client.vehicle().subscribe_context("many.13", Domain::VEHICLE, 100.0, &variables).unwrap();
    client
        .vehicle()
        .subscribe("many.13", &[vehicle::VAR_SPEED.id(), vehicle::VAR_BEST_LANES.id()])
        .unwrap();
    client.vehicle().subscribe_leader("many.14", 150.0).unwrap();
    client.vehicle().subscribe_during("many.15", &[vehicle::VAR_SPEED.id()], 53.0, 54.0).unwrap();
    client.vehicle().subscribe_parameter_with_key("bus", "key").unwrap();
    let reply = client.simulation_step(0.0).unwrap();
    let near = reply.around(Domain::JUNCTION, "c");
    let ids: Vec<_> = near.objects().collect();
    assert!(ids.len() > 4 && ids.contains(&"walker"), "{ids:?}");
    for id in ids {
        let Some(position) = near.get(id, vehicle::VAR_POSITION) else {
            assert!(near.get(id, person::VAR_SPEED).unwrap().unwrap() < 3.0);
            continue;
        };
        assert_eq!(position.unwrap(), client.vehicle().get_position(id).unwrap());
        assert_eq!(
            near.get(id, vehicle::VAR_LANE_ID).unwrap().unwrap(),
            client.vehicle().get_lane_id(id).unwrap()
        );
        assert!(
            near.get(id, vehicle::VAR_ANGLE).is_none() && near.get(id, person::VAR_SPEED).is_none()
        );
    }
    assert_eq!(
        reply.get("many.13", vehicle::VAR_BEST_LANES).unwrap().unwrap(),
        client.vehicle().get_best_lanes("many.13").unwrap()
    );
    assert_eq!(
        reply.get("many.14", vehicle::VAR_LEADER).unwrap().unwrap(),
        client.vehicle().get_leader("many.14", 150.0).unwrap()
    );
    let parameter = reply.get("bus", vehicle::VAR_PARAMETER_WITH_KEY).unwrap().unwrap();
    assert_eq!(parameter, ("key".to_owned(), String::new()));
    assert!(reply.get("many.15", vehicle::VAR_SPEED).is_none());
    assert!(reply.get("nobody", vehicle::VAR_SPEED).is_none());
    // The same variable, read as another type.
    let wrong = Variable::<String>::new(Domain::VEHICLE, vehicle::VAR_SPEED.number());
    match reply.get("many.13", wrong) {
        Some(Err(error @ Error::Type { .. })) => {
            let words = "the subscription to variable 0x40 gives a double where a string should be";
            assert_eq!((error.is_fatal(), error.to_string().as_str()), (false, words));
        }
        other => panic!("{other:?}"),
    }
    let all: Vec<_> =
        reply.around(Domain::VEHICLE, "many.13").objects().map(str::to_owned).collect();
    assert!(all.len() > 5, "{all:?}");
    // Each filter reduces the number of reported vehicles.
    macro_rules! filtered {
        ($($filter:ident($($argument:expr),*)),+) => {{
            let mut batch = client.batch();
            batch.vehicle().subscribe_context("many.13", Domain::VEHICLE, 100.0, &variables);
            let tickets = [$(batch.vehicle().$filter($($argument),*)),+];
            let mut reply = batch.step(0.0).unwrap();
            for ticket in tickets {
                reply.take(ticket).unwrap();
            }
            let ids: Vec<_> = reply.around(Domain::VEHICLE, "many.13").objects().map(str::to_owned).collect();
            assert!(ids.len() < all.len(), "{} {ids:?}", concat!($(stringify!($filter)),+));
            ids
        }};
    }
    assert!(filtered!(add_subscription_filter_vtype(&["taxi"])).is_empty());
    assert!(filtered!(add_subscription_filter_vclass(&["bicycle"])).is_empty());
    filtered!(add_subscription_filter_field_of_vision(40.0));
    filtered!(
        add_subscription_filter_lanes(&[0, 0]),
        add_subscription_filter_no_opposite(),
        add_subscription_filter_downstream_distance(60.0),
        add_subscription_filter_upstream_distance(0.0)
    );
    assert!(filtered!(add_subscription_filter_cf_maneuver()).len() <= 2);
    assert!(filtered!(add_subscription_filter_lc_maneuver(Some(Side::Left))).len() <= 4);
    filtered!(add_subscription_filter_lead_follow(&[-1, 0]));
    filtered!(add_subscription_filter_turn(50.0));
    filtered!(
        add_subscription_filter_lateral_distance(1.0),
        add_subscription_filter_downstream_distance(30.0)
    );
    // Subscriptions end with `unsubscribe` and `unsubscribe_context`.
    client.vehicle().unsubscribe("many.13").unwrap();
    client.vehicle().unsubscribe_context("many.13", Domain::VEHICLE).unwrap();
    let reply = client.simulation_step(0.0).unwrap();
    assert!(reply.get("many.13", vehicle::VAR_SPEED).is_none());
    assert_eq!(reply.around(Domain::VEHICLE, "many.13").objects().count(), 0);
}

#[test]
fn sumo_survives_what_it_would_die_of() {
    let world = World::new();
    let (_process, mut client) = world.start();
    client.simulation_step(50.0).unwrap();
    let speed = [vehicle::VAR_SPEED.id()];
    let mut batch = Batch::new();
    let mut tickets = Vec::new();
    let (sent, _) = client.bytes();
    for (around, variable) in [
        (Domain::TRAFFIC_LIGHT, traffic_light::VAR_NAME.id()),
        (Domain::VEHICLE_TYPE, vehicle_type::VAR_LENGTH.id()),
        (Domain::ROUTE, route::VAR_EDGES.id()),
        (Domain::SIMULATION, simulation::VAR_TIME.id()),
        (Domain::GUI, gui::VAR_ANGLE.id()),
        // A variable that does not belong to the domain around the vehicle.
        (Domain::PERSON, speed[0]),
    ] {
        assert!(
            is_invalid(&client.vehicle().subscribe_context("bus", around, 9.0, &[variable])),
            "{around:?}"
        );
        tickets.push(batch.vehicle().subscribe_context("bus", around, 9.0, &[variable]));
    }
    let foreign = [vehicle::VAR_SPEED.id(), lane::VAR_LENGTH.id()];
    let many = [speed[0]; 256];
    for variables in [&foreign[..], &many] {
        assert!(is_invalid(&client.vehicle().subscribe("bus", variables)));
        assert!(is_invalid(&client.vehicle().subscribe_during("bus", variables, 0.0, 100.0)));
        tickets.push(batch.vehicle().subscribe("bus", variables));
    }
    assert!(is_invalid(&client.vehicle().subscribe_with("bus", lane::VAR_PARAMETER, "key")));
    tickets.push(batch.vehicle().subscribe_with("bus", lane::VAR_PARAMETER, "key"));
    // None of these calls needs an exchange, nor does a batch that consists of them.
    let mut replies = client.run(&mut batch).unwrap();
    assert_eq!(client.bytes().0, sent);
    assert!(is_invalid(&replies.check()));
    assert_eq!(tickets.len(), 9);
    for ticket in tickets {
        assert!(is_invalid(&replies.take(ticket)));
    }
    replies.check().unwrap();
    // SUMO carries out the other calls of such a batch.
    let bad = batch.vehicle().subscribe("bus", &many);
    let time = batch.simulation().get_time();
    let mut replies = client.run(&mut batch).unwrap();
    assert!(is_invalid(&replies.take(bad)));
    assert_eq!(replies.take(time).unwrap(), 50.0);
    // Objects that do not exist, or no longer exist.
    let gone = "many.13";
    client.simulation_step(51.0).unwrap();
    client.vehicle().remove(gone, 3).unwrap();
    let (call, id, _) =
        refused(client.vehicle().subscribe_context(gone, Domain::VEHICLE, 9.0, &speed));
    assert_eq!((call.as_str(), id.as_str()), ("subscribeContext", gone));
    refused(client.junction().subscribe_context("nowhere", Domain::VEHICLE, 9.0, &speed));
    refused(client.person().subscribe_context("nobody", Domain::VEHICLE, 9.0, &speed));
    refused(client.lane_area().subscribe_context("none", Domain::VEHICLE, 9.0, &speed));
    refused(client.vehicle().unsubscribe_context("nobody", Domain::VEHICLE));
    refused(client.vehicle().subscribe("nobody", &speed));
    // SUMO answers a refused subscription too, also in a batch.
    let nobody = batch.vehicle().subscribe("nobody", &speed);
    let unknown = Variable::<Value>::new(Domain::VEHICLE, 0xfe).id();
    let nothing = batch.vehicle().subscribe("bus", &[speed[0], unknown]);
    let bus = batch.vehicle().subscribe("bus", &speed);
    let time = batch.simulation().get_time();
    let mut reply = client.step(&mut batch, 0.0).unwrap();
    assert_eq!(refused(reply.take(nobody)).1, "nobody");
    assert_eq!(refused(reply.take(nothing)).1, "bus");
    reply.take(bus).unwrap();
    assert_eq!(reply.take(time).unwrap(), 51.0);
    assert_eq!(reply.subscriptions.len(), 1);
    client.simulation_step(0.0).unwrap();
    assert_eq!(client.simulation().get_time().unwrap(), 53.0);
}

#[test]
fn objects_of_all_kinds_can_be_at_the_centre() {
    let world = World::new();
    let (_process, mut client) = world.start();
    client.simulation_step(50.0).unwrap();
    macro_rules! around {
        ($($domain:ident $of:ident $id:literal),+) => {
            $(client.$domain().subscribe_context($id, Domain::VEHICLE, 1000.0, &[vehicle::VAR_SPEED.id()]).unwrap();)+
            let reports = client.simulation_step(0.0).unwrap();
            $(assert!(reports.around(Domain::$of, $id).objects().count() > 5, stringify!($domain));)+
        };
    }
    around!(vehicle VEHICLE "bus", junction JUNCTION "c", lane LANE "wc_1", edge EDGE "wc", person PERSON "walker");
    around!(poi POI "poi", polygon POLYGON "poly", induction_loop INDUCTION_LOOP "loop", lane_area LANE_AREA "area");
    around!(parking_area PARKING_AREA "park");
}

#[test]
fn subscriptions_add_up_until_they_end() {
    let world = World::new();
    let (_process, mut client) = world.start();
    client.simulation_step(50.0).unwrap();
    let seen = |client: &mut Client| {
        let reports = client.simulation_step(0.0).unwrap();
        let seen = [vehicle::VAR_SPEED.id(), vehicle::VAR_ANGLE.id(), vehicle::VAR_LENGTH.id()]
            .map(|id: VariableId| {
                reports.get("bus", Variable::<Value>::new(id.domain(), id.number())).is_some()
            });
        (seen, reports.subscriptions.len())
    };
    client.vehicle().subscribe("bus", &[vehicle::VAR_SPEED.id()]).unwrap();
    client.vehicle().subscribe("bus", &[vehicle::VAR_ANGLE.id()]).unwrap();
    assert_eq!(seen(&mut client), ([true, true, false], 2));
    client.vehicle().subscribe_during("bus", &[vehicle::VAR_LENGTH.id()], 0.0, 1000.0).unwrap();
    assert_eq!(seen(&mut client), ([true, true, true], 3));
    client.vehicle().unsubscribe("bus").unwrap();
    client.vehicle().subscribe("bus", &[vehicle::VAR_ANGLE.id()]).unwrap();
    assert_eq!(seen(&mut client), ([false, true, false], 1));
    client.vehicle().unsubscribe("bus").unwrap();
    // With several ranges, the last is reported; all of them end together.
    let mut batch = client.batch();
    let variables = [vehicle::VAR_SPEED.id()];
    batch.vehicle().subscribe_context("many.13", Domain::VEHICLE, 1.0, &variables);
    batch.vehicle().subscribe_context("many.13", Domain::VEHICLE, 200.0, &variables);
    let speed = batch.vehicle().get_speed("many.13");
    let mut reply = batch.step(0.0).unwrap();
    // The first reports describe the time before the step.
    let (before, after) = (&reply.outcomes.first, &reply.reports);
    let of = |reports: &Reports| {
        let around = reports.around(Domain::VEHICLE, "many.13");
        (around.objects().count(), around.get("many.13", vehicle::VAR_SPEED).unwrap().unwrap())
    };
    let (before, after) = (of(before), of(after));
    assert!(before.0 > 2 && after.0 > 2, "{before:?} {after:?}");
    assert_eq!(before.1, reply.take(speed).unwrap());
    assert_eq!(after.1, client.vehicle().get_speed("many.13").unwrap());
    client.vehicle().unsubscribe_context("many.13", Domain::VEHICLE).unwrap();
    assert_eq!(seen(&mut client), ([false; 3], 0));
}

#[test]
fn variables_with_an_argument_are_reported() {
    let world = World::new();
    let (_process, mut client) = world.start();
    client.simulation_step(50.0).unwrap();
    for call in [
        client.vehicle().subscribe_with("bus", vehicle::VAR_LEADER, 100.0),
        client.vehicle().subscribe_with("bus", vehicle::VAR_FOLLOWER, 100.0),
        client.vehicle().subscribe_with("bus", vehicle::VAR_PARAMETER, "key"),
        client.vehicle().subscribe_with("bus", vehicle::VAR_PARAMETER_WITH_KEY, "key"),
        client.simulation().subscribe_with(
            "park",
            simulation::VAR_PARAMETER,
            "parkingArea.capacity",
        ),
    ] {
        call.unwrap();
    }
    let reports = client.simulation_step(0.0).unwrap();
    assert_eq!(reports.get("bus", vehicle::VAR_PARAMETER).unwrap().unwrap(), "");
    assert_eq!(reports.get("park", simulation::VAR_PARAMETER).unwrap().unwrap(), "4");
    let leader = reports.get("bus", vehicle::VAR_LEADER).unwrap().unwrap();
    assert_eq!(leader, client.vehicle().get_leader("bus", 100.0).unwrap());
    let follower = reports.get("bus", vehicle::VAR_FOLLOWER).unwrap().unwrap();
    assert_eq!(follower, client.vehicle().get_follower("bus", 100.0).unwrap());
}
