//! Tests of calls that change something, against the real simulator: getters return what setters
//! set, and a refused call does not affect other calls.

use iwol_sumo::sumo::{
    Batch, Client, Domain, Error,
    constants::INVALID_DOUBLE_VALUE,
    domain::{
        Color, Highlight, gui,
        person::{Place, Walk},
        poi, polygon,
        simulation::{self, Stage},
        traffic_light::{Logic, Phase},
        vehicle::{Addition, Gap, Placement, Stop, StopChange},
    },
    process::{Options, Process},
};

use super::{NET, is_old, refused, world::World};

/// Calls setters, and compares what the getters return.
macro_rules! sets {
    ($client:ident, $domain:ident, $id:literal; $($set:ident($($argument:expr),*), $get:ident, $value:expr;)+) => {
        $(
            $client.$domain().$set($id, $($argument),*).unwrap_or_else(|e| panic!("{}: {e}", stringify!($set)));
            assert_eq!($client.$domain().$get($id).unwrap(), $value, stringify!($domain.$get));
        )+
    };
}

/// Calls methods that SUMO must not refuse.
macro_rules! calls {
    ($client:ident, $domain:ident; $($call:ident($($argument:expr),*);)+) => {
        $($client.$domain().$call($($argument),*).unwrap_or_else(|e| panic!("{}: {e}", stringify!($call)));)+
    };
}

fn strings(texts: &[&str]) -> Vec<String> {
    texts.iter().map(|&text| text.to_owned()).collect()
}

#[test]
fn what_is_set_can_be_read_back() {
    let world = World::new();
    let (_process, mut client) = world.start();
    client.simulation_step(50.0).unwrap();
    let blue = Color { r: 1, g: 2, b: 250, a: 90 };
    macro_rules! type_attributes {
        ($domain:ident $id:literal) => {
            sets! { client, $domain, $id;
                set_length(6.5), get_length, 6.5;
                set_speed_factor(1.25), get_speed_factor, 1.25;
                set_width(2.25), get_width, 2.25;
                set_height(3.5), get_height, 3.5;
                set_min_gap(1.75), get_min_gap, 1.75;
                set_color(blue), get_color, blue;
            }
        };
    }
    macro_rules! driver_attributes {
        ($domain:ident $id:literal) => {
            sets! { client, $domain, $id;
                set_max_speed(31.0), get_max_speed, 31.0;
                set_vehicle_class("delivery"), get_vehicle_class, "delivery";
                set_emission_class("HBEFA3/LDV_G_EU6"), get_emission_class, "HBEFA3/LDV_G_EU6";
                set_shape_class("truck"), get_shape_class, "truck";
                set_accel(1.5), get_accel, 1.5;
                set_emergency_decel(8.5), get_emergency_decel, 8.5;
                set_decel(3.5), get_decel, 3.5;
                set_apparent_decel(4.5), get_apparent_decel, 4.5;
                set_imperfection(0.125), get_imperfection, 0.125;
                set_tau(1.5), get_tau, 1.5;
                set_min_gap_lat(0.75), get_min_gap_lat, 0.75;
                set_max_speed_lat(0.5), get_max_speed_lat, 0.5;
                set_lateral_alignment("right"), get_lateral_alignment, "right";
                set_action_step_length(2.0, true), get_action_step_length, 2.0;
            }
        };
    }
    type_attributes!(vehicle "many.11");
    driver_attributes!(vehicle "many.11");
    type_attributes!(vehicle_type "taxi");
    driver_attributes!(vehicle_type "taxi");
    type_attributes!(person "walker");
    // SUMO 1.15 refuses the other setters for persons.
    if is_old(client.get_version().unwrap().release()) {
        assert_eq!(refused(client.person().set_tau("walker", 1.0)).0, "person.setTau");
    }
    sets! { client, vehicle_type, "taxi";
        set_speed_deviation(0.25), get_speed_deviation, 0.25;
        set_scale(2.0), get_scale, 2.0;
    }
    sets! { client, vehicle, "many.12";
        set_type("taxi"), get_type_id, "taxi";
        set_route_id("through"), get_route_id, "through";
        set_route(&["wc", "ce"]), get_route, strings(&["wc", "ce"]);
        set_routing_mode(1), get_routing_mode, 1;
        set_signals(8), get_signals, 8;
        set_line("12"), get_line, "12";
        set_via(&["ce"]), get_via, strings(&["ce"]);
        set_lane_change_mode(512), get_lane_change_mode, 512;
        set_speed_mode(32), get_speed_mode, 32;
        set_stop(&Stop::on_edge("ce", 90.0).lasting(20.0)), is_stopped, false;
    }
    sets! { client, person, "walker";
        set_type("DEFAULT_PEDTYPE"), get_type_id, "DEFAULT_PEDTYPE";
    }
    sets! { client, lane, "cn_2";
        set_allowed(&["taxi", "bus"]), get_allowed, strings(&["taxi", "bus"]);
        set_disallowed(&["bus"]), get_disallowed, strings(&["bus"]);
        set_max_speed(9.5), get_max_speed, 9.5;
        set_length(180.0), get_length, 180.0;
    }
    sets! { client, poi, "poi";
        set_type("kiosk"), get_type, "kiosk";
        set_position([3.0, 4.0]), get_position, [3.0, 4.0];
        set_color(blue), get_color, blue;
        set_width(5.0), get_width, 5.0;
        set_height(6.0), get_height, 6.0;
        set_angle(7.0), get_angle, 7.0;
        set_image_file("none.png"), get_image_file, "none.png";
    }
    let shape = [[0.0, 0.0], [5.0, 0.0], [5.0, 5.0]];
    let many: Vec<_> = (0..300).map(|i| [f64::from(i), 1.0]).collect();
    sets! { client, polygon, "poly";
        set_type("lake"), get_type, "lake";
        set_shape(&many), get_shape, many;
        set_shape(&shape), get_shape, shape;
        set_color(blue), get_color, blue;
        set_filled(false), get_filled, false;
        set_filled(true), get_filled, true;
        set_line_width(0.5), get_line_width, 0.5;
    }
    sets! { client, traffic_light, "c";
        set_phase(2), get_phase, 2;
        set_phase_name("second"), get_phase_name, "second";
        set_phase_duration(30.0), get_next_switch, 80.0;
        set_red_yellow_green_state("rrrrrrrrrrrrrr"), get_red_yellow_green_state, "rrrrrrrrrrrrrr";
    }
    client.traffic_light().set_link_state("c", 3, 'G').unwrap();
    assert_eq!(client.traffic_light().get_red_yellow_green_state("c").unwrap(), "rrrGrrrrrrrrrr");
    assert!(matches!(
        client.traffic_light().set_link_state("c", 14, 'G'),
        Err(Error::Invalid { .. })
    ));
    // A program that is set reads back unchanged.
    let mut phases = vec![Phase::new(10.0, "GGGGrrrrrrrrrr"), Phase::new(5.0, "rrrrGGGGrrrrrr")];
    phases[1] = Phase {
        min_dur: 4.0,
        max_dur: 6.0,
        next: vec![0, 1],
        name: "other".into(),
        ..phases[1].clone()
    };
    let parameters = vec![("note".to_owned(), "mine".to_owned())];
    let mine =
        Logic { program_id: "mine".into(), kind: 0, current_phase_index: 1, phases, parameters };
    client.traffic_light().set_program_logic("c", &mine).unwrap();
    assert_eq!(client.traffic_light().get_program("c").unwrap(), "mine");
    let logics = client.traffic_light().get_all_program_logics("c").unwrap();
    let back = logics.iter().find(|logic| logic.program_id == "mine").unwrap();
    // SUMO fills in values that a phase leaves open, so only the complete phase is compared.
    assert_eq!((&back.phases[1], &back.parameters), (&mine.phases[1], &mine.parameters));
    client.traffic_light().set_program("c", "0").unwrap();
    assert_eq!(client.traffic_light().get_program("c").unwrap(), "0");
    calls! { client, edge;
        adapt_traveltime("ce", 12.5);
        adapt_traveltime_during("cn", 100.0, 200.0, 22.5);
        set_effort("ce", 13.5);
        set_effort_during("cn", 100.0, 200.0, 23.5);
        set_max_speed("cw", 11.0);
    }
    // Python's client has these calls, but SUMO refuses them: 1.18 the first one, 1.15 all.
    refused(client.lane().set_friction("cn_2", 0.5));
    let others = [
        client.edge().set_allowed("sc", &["taxi"]),
        client.edge().set_disallowed("cw", &["bus"]),
        client.edge().set_friction("cw", 0.75),
    ];
    let old = is_old(client.get_version().unwrap().release());
    for answer in others {
        if old {
            refused(answer);
        } else {
            answer.unwrap();
        }
    }
    let mut edge = client.edge();
    assert_eq!(edge.get_adapted_traveltime("ce", 60.0).unwrap(), 12.5);
    assert_eq!(edge.get_adapted_traveltime("cn", 150.0).unwrap(), 22.5);
    assert_eq!(
        (edge.get_effort("ce", 60.0).unwrap(), edge.get_effort("cn", 150.0).unwrap()),
        (13.5, 23.5)
    );
    assert_eq!(client.lane().get_max_speed("cw_0").unwrap(), 11.0);
    // Every domain has generic parameters.
    macro_rules! parameters {
        ($($domain:ident $id:literal),+) => {
            $(
                client.$domain().set_parameter($id, "key", "value").unwrap();
                assert_eq!(client.$domain().get_parameter($id, "key").unwrap(), "value");
                let pair = client.$domain().get_parameter_with_key($id, "key").unwrap();
                assert_eq!(pair, ("key".to_owned(), "value".to_owned()));
            )+
        };
    }
    parameters!(vehicle "bus", vehicle_type "car", person "walker", lane "wc_1", edge "wc", junction "c", poi "poi");
    parameters!(polygon "poly", route "through", traffic_light "c", induction_loop "loop", lane_area "area");
    client.simulation().set_scale(1.5).unwrap();
    assert_eq!(client.simulation().get_scale().unwrap(), 1.5);
    client.simulation_step(0.0).unwrap();
}

#[test]
fn objects_come_and_go() {
    let world = World::new();
    let (_process, mut client) = world.start();
    client.simulation_step(50.0).unwrap();
    let appearance = poi::Appearance {
        color: Color::rgb(1, 2, 3),
        kind: "tree",
        layer: 2,
        ..poi::Appearance::default()
    };
    client.poi().add("tree", [1.0, 2.0], &appearance).unwrap();
    assert_eq!(client.poi().get_color("tree").unwrap(), Color::rgb(1, 2, 3));
    assert_eq!(client.poi().get_type("tree").unwrap(), "tree");
    client
        .poi()
        .highlight("tree", &Highlight { fade: Some((200, 5.0)), ..Highlight::default() })
        .unwrap();
    client.poi().remove("tree", 2).unwrap();
    assert_eq!(client.poi().get_id_list().unwrap(), ["poi"]);
    let shape = [[0.0, 0.0], [5.0, 0.0], [5.0, 5.0]];
    let appearance =
        polygon::Appearance { fill: true, line_width: 3.0, ..polygon::Appearance::default() };
    client.polygon().add("p", &shape, &appearance).unwrap();
    assert_eq!(client.polygon().get_shape("p").unwrap(), shape);
    assert!(client.polygon().get_filled("p").unwrap());
    assert_eq!(client.polygon().get_line_width("p").unwrap(), 3.0);
    let dynamics = polygon::Dynamics {
        tracked: "many.11",
        time_span: &[0.0, 1.0],
        ..polygon::Dynamics::default()
    };
    client.polygon().add_dynamics("p", &dynamics).unwrap();
    client.simulation_step(0.0).unwrap();
    assert_ne!(client.polygon().get_shape("p").unwrap(), shape);
    client.polygon().remove("poly", 0).unwrap();
    client.vehicle_type().copy("car", "copy").unwrap();
    assert_eq!(client.vehicle_type().get_accel("copy").unwrap(), 2.5);
    client.route().add("back", &strings(&["ec", "cw"])).unwrap();
    assert_eq!(client.route().get_edges("back").unwrap(), ["ec", "cw"]);
    let addition = Addition {
        vehicle_type: "copy",
        depart_pos: "free",
        depart_speed: "5",
        depart_lane: "free",
        line: "9",
        person_capacity: 3,
        person_number: 1,
        ..Addition::on_route("back")
    };
    client.vehicle().add("new", &addition).unwrap();
    client.simulation_step(0.0).unwrap();
    assert_eq!(client.vehicle().get_road_id("new").unwrap(), "ec");
    assert_eq!(client.vehicle().get_line("new").unwrap(), "9");
    assert_eq!(client.vehicle().get_person_number("new").unwrap(), 1);
    client.vehicle().remove("new", 3).unwrap();
    client.person().add("pedestrian", "DEFAULT_PEDTYPE", "wc", -3.0, 5.0).unwrap();
    calls! { client, person;
        append_walking_stage("pedestrian", &["wc", "ce"], &Walk::to(30.0));
        append_waiting_stage("pedestrian", 5.0, "rests", "");
        append_driving_stage("pedestrian", "ce", "ANY", "");
        append_stage("pedestrian", &Stage::walking(strings(&["ce"]), 60.0));
    }
    client.simulation_step(0.0).unwrap();
    assert_eq!(client.person().get_remaining_stages("pedestrian").unwrap(), 4);
    assert_eq!(client.person().get_edges("pedestrian", 0).unwrap(), ["wc", "ce"]);
    assert_eq!(client.person().get_stage("pedestrian", 1).unwrap().description, "waiting (rests)");
    let [x, y] = client.person().get_position("pedestrian").unwrap();
    calls! { client, person;
        replace_stage("pedestrian", 1, &Stage::waiting(7.0, "waits"));
        remove_stage("pedestrian", 2);
        set_speed("pedestrian", 2.0);
        reroute_traveltime("pedestrian");
        move_to_xy("pedestrian", [x + 20.0, y], &Place::default());
    }
    assert_eq!(client.person().get_remaining_stages("pedestrian").unwrap(), 3);
    client.simulation_step(0.0).unwrap();
    let [moved, _] = client.person().get_position("pedestrian").unwrap();
    assert!((x + 15.0..x + 25.0).contains(&moved), "{x} {moved}");
    client.person().remove_stages("pedestrian").unwrap();
    client.simulation_step(0.0).unwrap();
    client.simulation_step(0.0).unwrap();
    assert!(!client.person().get_id_list().unwrap().contains(&"pedestrian".to_owned()));
    client.person().remove("sleeper", 3).unwrap();
    let two = client
        .person()
        .get_taxi_reservations(false)
        .unwrap()
        .into_iter()
        .find(|r| r.persons.len() == 2)
        .unwrap();
    let one = client.person().split_taxi_reservation(&two.id, &["guest.a"]).unwrap();
    assert!(
        client
            .person()
            .get_taxi_reservations(false)
            .unwrap()
            .iter()
            .any(|r| r.id == one && r.persons == ["guest.a"])
    );
    client.vehicle().dispatch_taxi("cab", &["0"]).unwrap();
    client.simulation().clear_pending("").unwrap();
    client.simulation().write_message("a line").unwrap();
}

#[test]
fn vehicles_do_as_they_are_told() {
    let world = World::new();
    let (_process, mut client) = world.start();
    client.simulation_step(50.0).unwrap();
    let unlimited = INVALID_DOUBLE_VALUE;
    calls! { client, vehicle;
        set_bus_stop("many.14", "stop", 5.0, unlimited);
        set_stop("many.13", &Stop::on_edge("ce", 120.0).lasting(9.0));
        insert_stop("many.13", &StopChange { index: 0, stop: Stop::on_edge("ce", 60.0).lasting(8.0), teleport: 0 });
        set_parking_area_stop("many.15", "park", 30.0, unlimited);
        replace_stop("many.15", &StopChange { index: 0, stop: Stop::on_edge("ce", 99.0).lasting(9.0), teleport: 0 });
        set_stop_parameter("many.13", 0, "duration", "7");
        set_adapted_traveltime("many.13", "ce", 77.0);
        set_adapted_traveltime_during("many.13", 100.0, 200.0, "cn", 78.0);
        set_effort("many.13", "ce", 87.0);
        set_effort_during("many.13", 100.0, 200.0, "cn", 88.0);
        change_lane("many.11", 1, 5.0);
        slow_down("many.9", 3.0, 4.0);
        open_gap("many.12", &Gap {
            time_headway: 3.0, space_headway: 10.0, duration: 5.0, change_rate: 0.5, max_decel: 1.0, reference: "many.10"
        });
        deactivate_gap_control("many.12");
        update_best_lanes("many.12");
        set_acceleration("west.4", 1.0, 2.0);
        set_previous_speed("west.5", 4.0, unlimited);
        set_line("many.12", "5");
        reroute_traveltime("many.12");
        reroute_effort("many.12");
        change_target("many.10", "ce");
        highlight("many.12", &Highlight { fade: Some((99, 3.0)), ..Highlight::default() });
        highlight("many.12", &Highlight { kind: 1, ..Highlight::default() });
        move_to("north.6", "sc_1", 70.0, 0);
        move_to_xy("west.3", [700.0, 205.0], &Placement { keep_route: 2, angle: 90.0, ..Placement::default() });
        set_speed("many.7", 1.5);
        resume("bus");
        change_lane_relative("many.8", 1, 5.0);
    }
    let old = is_old(client.get_version().unwrap().release());
    let stops = client.vehicle().get_stops("many.13", 0).unwrap();
    assert_eq!(
        stops.iter().map(|stop| (stop.end_pos, stop.duration)).collect::<Vec<_>>(),
        // SUMO 1.15 tells the parameter, and not the stop, what was set.
        [(60.0, if old { 8.0 } else { 7.0 }), (120.0, 9.0)]
    );
    assert_eq!(client.vehicle().get_stop_parameter("many.13", 0, "duration").unwrap(), "7.00");
    assert_eq!(client.vehicle().get_next_stops("many.15").unwrap()[0].end_pos, 99.0);
    let next = |client: &mut Client, id| {
        let stop = client.vehicle().get_next_stops(id).unwrap().remove(0);
        (stop.stopping_place, stop.flags)
    };
    assert_eq!(next(&mut client, "many.14"), ("stop".to_owned(), 16));
    assert_eq!(next(&mut client, "parker"), ("park".to_owned(), 1 | 2 | 128));
    assert_eq!(client.vehicle().get_adapted_traveltime("many.13", 60.0, "ce").unwrap(), 77.0);
    assert_eq!(client.vehicle().get_adapted_traveltime("many.13", 150.0, "cn").unwrap(), 78.0);
    assert_eq!(client.vehicle().get_effort("many.13", 60.0, "ce").unwrap(), 87.0);
    client.vehicle().reset_adapted_traveltime("many.13", "ce").unwrap();
    client.vehicle().reset_effort("many.13", "ce").unwrap();
    assert_ne!(client.vehicle().get_adapted_traveltime("many.13", 60.0, "ce").unwrap(), 77.0);
    client.simulation_step(0.0).unwrap();
    let mut vehicle = client.vehicle();
    assert_eq!(vehicle.get_position("west.3").unwrap(), [700.0, 205.0]);
    assert!(!vehicle.is_stopped("bus").unwrap());
    assert_eq!(vehicle.get_lane_id("many.11").unwrap(), "wc_1");
    let brakes = vehicle.get_acceleration("many.7").unwrap();
    assert!(brakes < -4.0, "{brakes}");
}

#[test]
fn a_refused_command_harms_no_other_of_its_batch() {
    let (_process, mut client) = start(&["--net-file", NET]);
    let edges = client.edge().get_id_list().unwrap();
    let road = edges.iter().find(|edge| !edge.starts_with(':')).unwrap();
    client.route().add("r", &[road]).unwrap();
    let addition = Addition { depart_speed: "3", ..Addition::on_route("r") };
    let mut batch = Batch::new();
    let add = batch.vehicle().add("v", &addition);
    let nobody = batch.vehicle().set_speed("nobody", 1.0);
    let speed = batch.vehicle().set_speed("v", 2.0);
    let ids = batch.vehicle().get_id_list();
    let time = batch.simulation().get_time();
    let mut reply = client.step(&mut batch, 0.0).unwrap();
    assert!(batch.is_empty());
    reply.take(add).unwrap();
    let (call, id, message) = refused(reply.take(nobody));
    assert_eq!(
        (call.as_str(), id.as_str(), message.as_str()),
        ("vehicle.setSpeed", "nobody", "Vehicle 'nobody' is not known")
    );
    // The refusal was returned with its ticket, so the check passes. If no ticket is taken, the
    // check returns the first refusal.
    reply.check().unwrap();
    batch.vehicle().set_speed("v", 2.0);
    batch.vehicle().set_speed("stranger", 1.0);
    batch.vehicle().remove("another", 3);
    let replies = client.run(&mut batch).unwrap();
    for _ in 0..2 {
        assert_eq!(refused(replies.check()).1, "stranger");
    }
    reply.take(speed).unwrap();
    assert_eq!(reply.take(ids).unwrap(), Vec::<String>::new());
    assert_eq!(reply.take(time).unwrap(), 0.0);
    batch.vehicle().set_speed("stranger", 1.0);
    assert_eq!(refused(client.step(&mut batch, 0.0).unwrap().check()).1, "stranger");
    assert_eq!(client.vehicle().get_speed("v").unwrap(), 2.0);
    let (call, id, _) = refused(client.vehicle().get_speed("nobody"));
    assert_eq!((call.as_str(), id.as_str()), ("vehicle.getSpeed", "nobody"));
    // Errors of calls without a name give their numbers.
    let (call, ..) = refused(client.call(|batch| batch.get(Domain::VEHICLE, 0xfe, "v")));
    assert_eq!(call, "command 0xa4 for variable 0xfe");
    // A call of several commands fails as a whole if one command fails.
    let filter = client.vehicle().add_subscription_filter_lc_maneuver(None);
    assert_eq!(refused(filter).0, "vehicle.addSubscriptionFilterLCManeuver");
    assert_eq!(client.get_version().unwrap().api, 20);
    client.close().unwrap();
}

fn start(arguments: &[&str]) -> (Process, Client) {
    let arguments = arguments.iter().map(Into::into).collect();
    let (process, client, _) =
        Process::start(&Options { arguments, ..Options::default() }).unwrap();
    (process, client)
}

#[test]
fn collisions_are_told_one_by_one() {
    let net = ["--net-file", NET, "--xml-validation", "never", "--no-warnings", "--eager-insert"];
    let (_process, mut client) = start(
        &[&net[..], &["--collision.action", "warn", "--collision.mingap-factor", "0"]].concat(),
    );
    let edges = client.edge().get_id_list().unwrap();
    let road = edges.iter().find(|edge| !edge.starts_with(':')).unwrap();
    client.route().add("r", &[road]).unwrap();
    let mut batch = client.batch();
    for (id, depart_pos, speed) in
        [("first", "29", 0.0), ("second", "21.4", 2.0), ("third", "13.8", 3.5)]
    {
        batch.vehicle().add(id, &Addition { depart_pos, ..Addition::on_route("r") });
        batch.vehicle().set_speed_mode(id, 32);
        batch.vehicle().set_speed(id, speed);
    }
    batch.simulation().subscribe("", &[simulation::VAR_COLLISIONS.id()]);
    let mut reply = batch.step(0.0).unwrap();
    let mut most = 0;
    for _ in 0..10 {
        let told = reply.get("", simulation::VAR_COLLISIONS).unwrap().unwrap();
        assert_eq!(told, client.simulation().get_collisions().unwrap());
        most = most.max(told.len());
        if let Some(one) = told.iter().find(|collision| collision.collider == "second") {
            assert_eq!(
                (one.victim.as_str(), one.victim_speed, one.kind.as_str()),
                ("first", 0.0, "collision")
            );
        }
        reply = client.batch().step(0.0).unwrap();
    }
    assert!(most >= 2, "{most}");
}

#[test]
fn detectors_signals_and_windows() {
    let world = World::new();
    let (_process, mut client) = world.start();
    client.simulation_step(50.0).unwrap();
    client.induction_loop().override_time_since_detection("loop", 3.0).unwrap();
    assert_eq!(client.induction_loop().get_time_since_detection("loop").unwrap(), 3.0);
    client.lane_area().override_vehicle_number("area", 12).unwrap();
    assert_eq!(client.lane_area().get_last_step_vehicle_number("area").unwrap(), 12);
    // First the slow train waits for the fast one, then the fast one for the slow one, then
    // neither.
    let swapped = client.traffic_light().swap_constraints("rb", "slow", "rb", "fast").unwrap();
    assert_eq!(swapped, []);
    let constraints = client.traffic_light().get_constraints("rb", "").unwrap();
    let [one] = &constraints[..] else { panic!("{constraints:?}") };
    assert_eq!((one.trip_id.as_str(), one.foe_id.as_str()), ("fast", "slow"));
    client.traffic_light().update_constraints("fast", "").unwrap();
    client.traffic_light().remove_constraints("rb", "fast", "rb", "slow").unwrap();
    assert_eq!(client.traffic_light().get_constraints("rb", "").unwrap(), []);
    // The net has no such stop, controller or device, and SUMO has no window: SUMO must refuse
    // these calls for that reason, not because they are malformed.
    let unlimited = INVALID_DOUBLE_VALUE;
    refused(client.vehicle().set_container_stop("bus", "none", 1.0, unlimited));
    refused(client.vehicle().set_charging_station_stop("bus", "none", 1.0, unlimited));
    refused(client.vehicle().reroute_parking_area("parker", "none"));
    refused(client.vehicle().request_toc("bus", 5.0));
    refused(client.traffic_light().set_nema_splits("c", "1 2"));
    refused(client.traffic_light().set_nema_offset("c", 1.0));
    let view = gui::DEFAULT_VIEW;
    let mut gui = client.gui();
    for call in
        [gui.set_zoom(view, 2.0), gui.set_offset(view, [1.0, 2.0]), gui.add_view("v", "", true)]
    {
        assert!(refused(call).0.starts_with("gui."));
    }
    refused(gui.get_boundary(view));
    refused(gui.screenshot(view, "none.png", -1, -1));
    client.simulation_step(0.0).unwrap();
}
