//! Compares the TraCI client with SUMO's Python client: every variable of every object of a small
//! world has the same value, and no call of the Python client is missing.

use std::{collections::BTreeMap, path::Path};

use iwol_sumo::sumo::{
    Batch, Domain, Error, Installation, Replies, Ticket, Value, Variable,
    domain::{
        simulation::{IntermodalQuery, RouteQuery},
        vehicle::Side,
    },
};
use serde_json::Value as Json;

use super::{is_old, json::ToJson, world::World};

const SECONDS: f64 = 50.0;

/// A call in the batch: its name and object, and a function that converts its result to JSON.
type Read = (String, Box<dyn FnOnce(&mut Replies) -> Json>);

fn read<T: ToJson + 'static>(reads: &mut Vec<Read>, key: String, ticket: Ticket<T>) {
    let take = |replies: &mut Replies| match replies.take(ticket) {
        Ok(value) => value.json(),
        Err(Error::Refused { message, .. }) => format!("refused: {message}").into(),
        Err(other) => format!("{other:?}").into(),
    };
    reads.push((key, Box::new(take)));
}

/// Puts calls into the batch: calls without an object, and calls for each of the objects.
macro_rules! reads {
    ($reads:ident, $batch:ident, $module:ident, $domain:literal, $ids:ident;
     { $($alone:ident($($alone_argument:expr),*));* } { $($method:ident$(($($argument:expr),*))?);* }) => {
        $(read(
            &mut $reads,
            concat!($domain, ".", stringify!($alone)).to_owned(),
            $batch.$module().$alone($($alone_argument),*),
        );)*
        for id in &$ids {
            $(read(
                &mut $reads,
                format!(concat!($domain, ".", stringify!($method), " {}"), id),
                $batch.$module().$method(id $($(, $argument)*)?),
            );)*
        }
    };
}

fn ours(world: &World) -> BTreeMap<String, Json> {
    let (_process, mut client) = world.start();
    client.simulation_step(SECONDS).unwrap();
    let mut batch = Batch::new();
    let mut reads = Vec::new();
    let by_car = RouteQuery { vehicle_type: "car", ..RouteQuery::default() };
    let on_foot =
        IntermodalQuery { depart_pos: 10.0, arrival_pos: 50.0, ..IntermodalQuery::default() };
    let ids = client.edge().get_id_list().unwrap();
    reads! { reads, batch, edge, "edge", ids;
        {
            get_id_count(); get_id_list()
        }
        {
            get_adapted_traveltime(60.0); get_co2_emission; get_co_emission; get_effort(60.0);
            get_electricity_consumption; get_fuel_consumption; get_hc_emission; get_lane_number;
            get_last_step_halting_number; get_last_step_length; get_last_step_mean_speed; get_last_step_occupancy;
            get_last_step_person_ids; get_last_step_vehicle_ids; get_last_step_vehicle_number; get_mean_friction;
            get_nox_emission; get_noise_emission; get_pmx_emission; get_parameter("key");
            get_parameter_with_key("key"); get_pending_vehicles; get_street_name; get_traveltime; get_waiting_time
        }
    }
    let ids = client.induction_loop().get_id_list().unwrap();
    reads! { reads, batch, induction_loop, "inductionloop", ids;
        {
            get_id_count(); get_id_list()
        }
        {
            get_lane_id; get_last_step_mean_length; get_last_step_mean_speed; get_last_step_occupancy;
            get_last_step_vehicle_ids; get_last_step_vehicle_number; get_parameter("key");
            get_parameter_with_key("key"); get_position; get_time_since_detection; get_vehicle_data
        }
    }
    let ids = client.junction().get_id_list().unwrap();
    reads! { reads, batch, junction, "junction", ids;
        {
            get_id_count(); get_id_list()
        }
        {
            get_parameter("key"); get_parameter_with_key("key"); get_position; get_shape
        }
    }
    let ids = client.lane().get_id_list().unwrap();
    reads! { reads, batch, lane, "lane", ids;
        {
            get_id_count(); get_id_list()
        }
        {
            get_allowed; get_co2_emission; get_co_emission; get_disallowed; get_edge_id;
            get_electricity_consumption; get_foes("ce_1"); get_friction; get_fuel_consumption; get_hc_emission;
            get_internal_foes; get_last_step_halting_number; get_last_step_length; get_last_step_mean_speed;
            get_last_step_occupancy; get_last_step_vehicle_ids; get_last_step_vehicle_number; get_length;
            get_link_number; get_links; get_max_speed; get_nox_emission; get_noise_emission; get_pmx_emission;
            get_parameter("key"); get_parameter_with_key("key"); get_pending_vehicles; get_shape; get_traveltime;
            get_waiting_time; get_width
        }
    }
    let ids = client.lane_area().get_id_list().unwrap();
    reads! { reads, batch, lane_area, "lanearea", ids;
        {
            get_id_count(); get_id_list()
        }
        {
            get_jam_length_meters; get_jam_length_vehicle; get_lane_id; get_last_step_halting_number;
            get_last_step_mean_speed; get_last_step_occupancy; get_last_step_vehicle_ids;
            get_last_step_vehicle_number; get_length; get_parameter("key"); get_parameter_with_key("key");
            get_position
        }
    }
    let ids = client.parking_area().get_id_list().unwrap();
    reads! { reads, batch, parking_area, "parkingarea", ids;
        {
            get_id_count(); get_id_list()
        }
        {
            get_end_pos; get_lane_id; get_name; get_parameter("key"); get_parameter_with_key("key"); get_start_pos;
            get_vehicle_count; get_vehicle_ids
        }
    }
    let ids = client.person().get_id_list().unwrap();
    reads! { reads, batch, person, "person", ids;
        {
            get_id_count(); get_id_list(); get_taxi_reservations(false)
        }
        {
            get_accel; get_action_step_length; get_angle; get_apparent_decel; get_color; get_decel; get_edges(0);
            get_emergency_decel; get_emission_class; get_height; get_imperfection; get_lane_id; get_lane_position;
            get_lateral_alignment; get_length; get_max_speed; get_max_speed_lat; get_min_gap; get_min_gap_lat;
            get_next_edge; get_parameter("key"); get_parameter_with_key("key"); get_person_capacity; get_position;
            get_position3d; get_remaining_stages; get_road_id; get_shape_class; get_slope; get_speed;
            get_speed_deviation; get_speed_factor; get_stage(0); get_tau; get_type_id; get_vehicle;
            get_vehicle_class; get_waiting_time; get_width
        }
    }
    let ids = client.poi().get_id_list().unwrap();
    reads! { reads, batch, poi, "poi", ids;
        {
            get_id_count(); get_id_list()
        }
        {
            get_angle; get_color; get_height; get_image_file; get_parameter("key"); get_parameter_with_key("key");
            get_position; get_type; get_width
        }
    }
    let ids = client.polygon().get_id_list().unwrap();
    reads! { reads, batch, polygon, "polygon", ids;
        {
            get_id_count(); get_id_list()
        }
        {
            get_color; get_filled; get_line_width; get_parameter("key"); get_parameter_with_key("key"); get_shape;
            get_type
        }
    }
    let ids = client.route().get_id_list().unwrap();
    reads! { reads, batch, route, "route", ids;
        {
            get_id_count(); get_id_list()
        }
        {
            get_edges; get_parameter("key"); get_parameter_with_key("key")
        }
    }
    let ids = vec![String::new()];
    reads! { reads, batch, simulation, "simulation", ids;
        {
            get_arrived_id_list(); get_arrived_number(); get_arrived_person_id_list(); get_arrived_person_number();
            get_bus_stop_id_list(); get_bus_stop_waiting("stop"); get_bus_stop_waiting_id_list("stop");
            get_colliding_vehicles_id_list(); get_colliding_vehicles_number(); get_collisions(); get_current_time();
            get_delta_t(); get_departed_id_list(); get_departed_number(); get_departed_person_id_list();
            get_departed_person_number(); get_distance2d([600.0, 195.0], [800.0, 195.0], false, true);
            get_distance_road(("wc", 10.0), ("ce", 30.0), true); get_emergency_stopping_vehicles_id_list();
            get_emergency_stopping_vehicles_number(); get_end_time(); get_ending_teleport_id_list();
            get_ending_teleport_number(); get_loaded_id_list(); get_loaded_number(); get_min_expected_number();
            get_net_boundary(); get_option("seed"); get_parking_ending_vehicles_id_list();
            get_parking_ending_vehicles_number(); get_parking_starting_vehicles_id_list();
            get_parking_starting_vehicles_number(); get_pending_vehicles(); get_scale();
            get_starting_teleport_id_list(); get_starting_teleport_number(); get_stop_ending_vehicles_id_list();
            get_stop_ending_vehicles_number(); get_stop_starting_vehicles_id_list();
            get_stop_starting_vehicles_number(); get_time(); convert2d("wc", 10.0, 1, false);
            convert3d("wc", 10.0, 1, true); convert_road([700.0, 195.0], false, "passenger");
            convert_geo([700.0, 195.0], false); find_route("wc", "ce", &by_car);
            find_intermodal_route("wc", "ce", &on_foot)
        }
        {
            get_parameter("key"); get_parameter_with_key("key")
        }
    }
    let ids = client.traffic_light().get_id_list().unwrap();
    reads! { reads, batch, traffic_light, "trafficlight", ids;
        {
            get_id_count(); get_id_list()
        }
        {
            get_all_program_logics; get_blocking_vehicles(0); get_constraints(""); get_constraints_by_foe("");
            get_controlled_lanes; get_controlled_links; get_nema_phase_calls; get_next_switch; get_parameter("key");
            get_parameter_with_key("key"); get_phase; get_phase_duration; get_phase_name; get_priority_vehicles(0);
            get_program; get_red_yellow_green_state; get_rival_vehicles(0); get_served_person_count(0)
        }
    }
    let ids = client.vehicle().get_id_list().unwrap();
    reads! { reads, batch, vehicle, "vehicle", ids;
        {
            get_id_count(); get_id_list(); get_taxi_fleet(-1)
        }
        {
            could_change_lane(Side::Left); get_accel; get_acceleration; get_accumulated_waiting_time; get_action_step_length;
            get_adapted_traveltime(60.0, "ce"); get_allowed_speed; get_angle; get_apparent_decel; get_best_lanes;
            get_co2_emission; get_co_emission; get_color; get_decel; get_distance;
            get_driving_distance("ce", 30.0, 1); get_driving_distance2d([800.0, 195.0]); get_effort(60.0, "ce");
            get_electricity_consumption; get_emergency_decel; get_emission_class;
            get_follow_speed(10.0, 20.0, 5.0, 4.5, ""); get_follower(100.0); get_fuel_consumption; get_hc_emission;
            get_height; get_imperfection; get_lane_change_mode; get_lane_change_state(Side::Left);
            get_lane_change_state_pretty(Side::Right); get_lane_id; get_lane_index; get_lane_position; get_last_action_time;
            get_lateral_alignment; get_lateral_lane_position; get_lateral_speed; get_leader(100.0);
            get_left_followers(false); get_left_leaders(true); get_length; get_line; get_max_speed;
            get_max_speed_lat; get_min_gap; get_min_gap_lat; get_nox_emission; get_neighbors(2); get_next_stops;
            get_next_tls; get_noise_emission; get_pmx_emission; get_parameter("key"); get_parameter_with_key("key");
            get_person_capacity; get_person_id_list; get_person_number; get_position; get_position3d;
            get_right_followers(false); get_right_leaders(false); get_road_id; get_route; get_route_id;
            get_route_index; get_routing_mode; get_secure_gap(10.0, 5.0, 4.5, ""); get_shape_class; get_signals;
            get_slope; get_speed; get_speed_deviation; get_speed_factor; get_speed_mode; get_speed_without_traci;
            get_stop_arrival_delay; get_stop_delay; get_stop_parameter(0, "duration"); get_stop_speed(10.0, 20.0);
            get_stop_state; get_stops(0); get_tau; get_time_loss; get_type_id; get_vehicle_class; get_via;
            get_waiting_time; get_width; is_at_bus_stop; is_at_container_stop; is_route_valid; is_stopped;
            is_stopped_parking; is_stopped_triggered; wants_and_could_change_lane(Side::Right)
        }
    }
    let ids = client.vehicle_type().get_id_list().unwrap();
    reads! { reads, batch, vehicle_type, "vehicletype", ids;
        {
            get_id_count(); get_id_list()
        }
        {
            get_accel; get_action_step_length; get_apparent_decel; get_color; get_decel; get_emergency_decel;
            get_emission_class; get_height; get_imperfection; get_lateral_alignment; get_length; get_max_speed;
            get_max_speed_lat; get_min_gap; get_min_gap_lat; get_parameter("key"); get_parameter_with_key("key");
            get_person_capacity; get_scale; get_shape_class; get_speed_deviation; get_speed_factor; get_tau;
            get_vehicle_class; get_width
        }
    }
    let ids = client.bus_stop().get_id_list().unwrap();
    reads! { reads, batch, bus_stop, "busstop", ids;
        {
            get_id_count(); get_id_list()
        }
        {
            get_end_pos; get_lane_id; get_name; get_parameter("key"); get_parameter_with_key("key"); get_person_count;
            get_person_ids; get_start_pos; get_vehicle_count; get_vehicle_ids
        }
    }
    let ids = client.calibrator().get_id_list().unwrap();
    reads! { reads, batch, calibrator, "calibrator", ids;
        {
            get_id_count(); get_id_list()
        }
        {
            get_begin; get_edge_id; get_end; get_inserted; get_lane_id; get_parameter("key"); get_parameter_with_key("key");
            get_passed; get_removed; get_route_id; get_route_probe_id; get_speed; get_type_id; get_vtypes;
            get_vehs_per_hour
        }
    }
    let ids = client.charging_station().get_id_list().unwrap();
    reads! { reads, batch, charging_station, "chargingstation", ids;
        {
            get_id_count(); get_id_list()
        }
        {
            get_end_pos; get_lane_id; get_name; get_parameter("key"); get_parameter_with_key("key"); get_start_pos;
            get_vehicle_count; get_vehicle_ids
        }
    }
    let ids = client.mean_data().get_id_list().unwrap();
    reads! { reads, batch, mean_data, "meandata", ids;
        {
            get_id_count(); get_id_list()
        }
        {
            get_parameter("key"); get_parameter_with_key("key")
        }
    }
    let ids = client.multi_entry_exit().get_id_list().unwrap();
    reads! { reads, batch, multi_entry_exit, "multientryexit", ids;
        {
            get_id_count(); get_id_list()
        }
        {
            get_entry_lanes; get_entry_positions; get_exit_lanes; get_exit_positions; get_last_interval_mean_halts_per_vehicle;
            get_last_interval_mean_time_loss; get_last_interval_mean_travel_time; get_last_interval_vehicle_sum;
            get_last_step_halting_number; get_last_step_mean_speed; get_last_step_vehicle_ids;
            get_last_step_vehicle_number; get_parameter("key"); get_parameter_with_key("key")
        }
    }
    let ids = client.overhead_wire().get_id_list().unwrap();
    reads! { reads, batch, overhead_wire, "overheadwire", ids;
        {
            get_id_count(); get_id_list()
        }
        {
            get_end_pos; get_lane_id; get_name; get_parameter("key"); get_parameter_with_key("key"); get_start_pos;
            get_vehicle_count; get_vehicle_ids
        }
    }
    let ids = client.rerouter().get_id_list().unwrap();
    reads! { reads, batch, rerouter, "rerouter", ids;
        {
            get_id_count(); get_id_list()
        }
        {
            get_parameter("key"); get_parameter_with_key("key")
        }
    }
    let ids = client.route_probe().get_id_list().unwrap();
    reads! { reads, batch, route_probe, "routeprobe", ids;
        {
            get_id_count(); get_id_list()
        }
        {
            get_edge_id; get_parameter("key"); get_parameter_with_key("key")
        }
    }
    let ids = client.variable_speed_sign().get_id_list().unwrap();
    reads! { reads, batch, variable_speed_sign, "variablespeedsign", ids;
        {
            get_id_count(); get_id_list()
        }
        {
            get_lanes; get_parameter("key"); get_parameter_with_key("key")
        }
    }
    let mut replies = client.run(&mut batch).unwrap();
    reads.into_iter().map(|(key, take)| (key, take(&mut replies))).collect()
}

/// Returns what the Python client reads in the same world, and the list of its calls.
fn theirs(world: &World) -> (BTreeMap<String, Json>, Json) {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/integration/traci/dump.py");
    let sumo = Installation::find().unwrap();
    let output = sumo
        .command(Path::new("/usr/bin/python3"))
        .args(["-I", script, &SECONDS.to_string()])
        .arg(sumo.binary())
        .args(world.arguments())
        .output();
    let output = output.unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).unwrap();
    // The Python client prints messages while it waits for SUMO.
    let mut dump: Json = serde_json::from_str(&text[text.find("{\"values\"").unwrap()..]).unwrap();
    let Json::Object(values) = dump["values"].take() else { panic!("no values") };
    (values.into_iter().collect(), dump["methods"].take())
}

/// Calls that SUMO refuses in this world for some or all objects, in both clients with the same
/// message.
const REFUSED: [&str; 8] = [
    // The routes that a route probe has seen are a distribution, which is listed and not known.
    "route.get_edges",
    "route.get_parameter",
    "route.get_parameter_with_key",
    // Not every lane leads to the lane in the argument.
    "lane.get_foes",
    // Only rail signals have constraints.
    "trafficlight.get_constraints",
    // Only NEMA controllers have phase calls.
    "trafficlight.get_nema_phase_calls",
    // A rail signal has no phases.
    "trafficlight.get_served_person_count",
    // Not every vehicle has a stop.
    "vehicle.get_stop_parameter",
];

#[test]
fn every_variable_is_read_as_pythons_client_reads_it() {
    let world = World::with_all_kinds();
    let (ours, (mut theirs, methods)) = (ours(&world), theirs(&world));
    // SUMO has no identifiers in this domain, so this crate does not have these calls.
    for key in ["simulation.get_id_count", "simulation.get_id_list"] {
        let refused = theirs.remove(key).unwrap();
        assert!(refused.as_str().unwrap().starts_with("refused"), "{refused}");
    }
    let sumo = Installation::find().unwrap().version().unwrap();
    let old = is_old(sumo.release());
    if !old {
        // Calls that SUMO has added since.
        theirs.retain(|key, _| ours.contains_key(key));
    }
    let keys = |values: &BTreeMap<String, Json>| values.keys().cloned().collect::<Vec<_>>();
    assert_eq!(keys(&ours), keys(&theirs));
    let mut different = Vec::new();
    for (key, value) in &theirs {
        if ours[key] != *value {
            different.push(format!("{key}: {} instead of {value}", ours[key]));
        }
        let call = key.split(' ').next().unwrap();
        let refused = value.as_str().is_some_and(|text| text.starts_with("refused"));
        assert!(!refused || REFUSED.contains(&call), "{key}: {value}");
    }
    assert!(
        different.is_empty(),
        "{} of {}:\n{}",
        different.len(),
        theirs.len(),
        different.join("\n")
    );
    // The world must be rich enough: 23 domains, with many values that are neither empty nor zero.
    let told = |v: &&Json| {
        !matches!(v.to_string().as_str(), "[]" | "\"\"" | "0" | "null" | "\"0000000000000000\"")
    };
    assert!(
        theirs.values().filter(told).count() > 3000,
        "{}",
        theirs.values().filter(told).count()
    );
    if old {
        nothing_is_missing(&methods);
    }
}

/// Source files that define the calls of each domain; `macros.rs` defines the calls of several
/// domains.
const SOURCES: [(&str, &str); 24] = [
    ("busstop", include_str!("../../../src/sumo/domain/bus_stop.rs")),
    ("calibrator", include_str!("../../../src/sumo/domain/calibrator.rs")),
    ("chargingstation", include_str!("../../../src/sumo/domain/charging_station.rs")),
    ("meandata", include_str!("../../../src/sumo/domain/mean_data.rs")),
    ("multientryexit", include_str!("../../../src/sumo/domain/multi_entry_exit.rs")),
    ("overheadwire", include_str!("../../../src/sumo/domain/overhead_wire.rs")),
    ("rerouter", include_str!("../../../src/sumo/domain/rerouter.rs")),
    ("routeprobe", include_str!("../../../src/sumo/domain/route_probe.rs")),
    ("variablespeedsign", include_str!("../../../src/sumo/domain/variable_speed_sign.rs")),
    ("edge", include_str!("../../../src/sumo/domain/edge.rs")),
    ("gui", include_str!("../../../src/sumo/domain/gui.rs")),
    ("inductionloop", include_str!("../../../src/sumo/domain/induction_loop.rs")),
    ("junction", include_str!("../../../src/sumo/domain/junction.rs")),
    ("lane", include_str!("../../../src/sumo/domain/lane.rs")),
    ("lanearea", include_str!("../../../src/sumo/domain/lane_area.rs")),
    ("parkingarea", include_str!("../../../src/sumo/domain/parking_area.rs")),
    ("person", include_str!("../../../src/sumo/domain/person.rs")),
    ("poi", include_str!("../../../src/sumo/domain/poi.rs")),
    ("polygon", include_str!("../../../src/sumo/domain/polygon.rs")),
    ("route", include_str!("../../../src/sumo/domain/route.rs")),
    ("simulation", include_str!("../../../src/sumo/domain/simulation.rs")),
    ("trafficlight", include_str!("../../../src/sumo/domain/traffic_light.rs")),
    (
        "vehicle",
        concat!(
            include_str!("../../../src/sumo/domain/vehicle.rs"),
            include_str!("../../../src/sumo/domain/vehicle/changes.rs"),
            include_str!("../../../src/sumo/domain/vehicle/filters.rs")
        ),
    ),
    ("vehicletype", include_str!("../../../src/sumo/domain/vehicle_type.rs")),
];
const SHARED: &str = concat!(
    include_str!("../../../src/sumo/domain/macros.rs"),
    include_str!("../../../src/sumo/domain/common.rs")
);

/// Calls of the Python client without a method in this crate, and the reasons.
const ABSENT: [&str; 10] = [
    // The reply to a step contains the reports of subscriptions.
    "getSubscriptionResults",
    "getAllSubscriptionResults",
    "getContextSubscriptionResults",
    "getAllContextSubscriptionResults",
    // Older names or forms of other calls.
    "addFull",
    "addLegacy",
    "getCompleteRedYellowGreenDefinition",
    "setCompleteRedYellowGreenDefinition",
    // This crate has `Client::simulation_step` instead.
    "step",
    // This crate has `Stage::walking` instead.
    "walkingStage",
];

fn nothing_is_missing(methods: &Json) {
    let words = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
    let shared = words(SHARED);
    for (domain, source) in SOURCES {
        let source = words(source);
        for (python, snake) in methods[domain].as_object().unwrap() {
            let refused =
                domain == "simulation" && ["getIDList", "getIDCount"].contains(&python.as_str());
            if refused || ABSENT.contains(&python.as_str()) {
                continue;
            }
            let snake = snake.as_str().unwrap();
            let here = |text: &str| {
                text.contains(&format!(" {snake} \"{python}\" "))
                    || text.contains(&format!("fn {snake}("))
            };
            assert!(here(&source) || here(&shared), "{domain}.{python}: no {snake}");
        }
    }
}

/// Returns the variables for which the tables in a source text define constants: those without and
/// those with an argument.
fn constants(source: &str) -> [Vec<(&str, u8)>; 2] {
    let words: Vec<&str> = source.split_whitespace().collect();
    let mut found = [Vec::new(), Vec::new()];
    for row in words.windows(4) {
        let [sumo, name, number, next] = row else { continue };
        let number =
            number.strip_prefix("0x").and_then(|digits| u8::from_str_radix(digits, 16).ok());
        if let (true, Some(number)) = (sumo.starts_with('"') && sumo.ends_with('"'), number) {
            found[usize::from(*next != "->")].push((*name, number));
        }
    }
    found
}

#[test]
fn sumo_takes_subscriptions_to_all_constants() {
    let world = World::with_all_kinds();
    let (_process, mut client) = world.start();
    client.simulation_step(SECONDS).unwrap();
    let shared = |name: &str| {
        let start = SHARED.find(&format!("macro_rules! {name} ")).unwrap();
        let text = &SHARED[start..];
        &text[..text.find("\n}\n").unwrap()]
    };
    let mut told = 0;
    // The kinds of objects that do not leave come last.
    for (name, source) in SOURCES.into_iter().cycle().skip(9).take(SOURCES.len()) {
        let domain = match name {
            "busstop" => Domain::BUS_STOP,
            "calibrator" => Domain::CALIBRATOR,
            "chargingstation" => Domain::CHARGING_STATION,
            "meandata" => Domain::MEAN_DATA,
            "multientryexit" => Domain::MULTI_ENTRY_EXIT,
            "overheadwire" => Domain::OVERHEAD_WIRE,
            "rerouter" => Domain::REROUTER,
            "routeprobe" => Domain::ROUTE_PROBE,
            "variablespeedsign" => Domain::VARIABLE_SPEED_SIGN,
            "edge" => Domain::EDGE,
            "inductionloop" => Domain::INDUCTION_LOOP,
            "junction" => Domain::JUNCTION,
            "lane" => Domain::LANE,
            "lanearea" => Domain::LANE_AREA,
            "parkingarea" => Domain::PARKING_AREA,
            "person" => Domain::PERSON,
            "poi" => Domain::POI,
            "polygon" => Domain::POLYGON,
            "route" => Domain::ROUTE,
            "simulation" => Domain::SIMULATION,
            "trafficlight" => Domain::TRAFFIC_LIGHT,
            "vehicle" => Domain::VEHICLE,
            "vehicletype" => Domain::VEHICLE_TYPE,
            // SUMO without a window refuses the calls of `gui`.
            _ => continue,
        };
        let mut batch = Batch::new();
        batch.get(domain, 0, "");
        let ids = client.run(&mut batch).unwrap().into_iter().next();
        let object = match ids {
            // The bus stays for the whole test; other vehicles may leave.
            Some(Ok(Some(Value::StringList(ids)))) => {
                ids.iter().find(|id| *id == "bus").unwrap_or(&ids[0]).clone()
            }
            _ => String::new(),
        };
        let mut text = format!("{source} {}", shared("domain"));
        for macro_name in ["identifiers", "type_attributes", "emissions", "stopping_place"] {
            if source.contains(&format!("\n{macro_name}! {{")) {
                text.push_str(shared(macro_name));
            }
        }
        let [plain, with] = constants(&text);
        // These variables take a stop or an option instead of an object.
        let takes_stop =
            |number| domain == Domain::SIMULATION && [0x67, 0xef, 0x32].contains(&number);
        for (constant, number) in plain {
            let variable = Variable::<Value>::new(domain, number);
            let object = if takes_stop(number) {
                if number == 0x32 { "seed" } else { "stop" }
            } else {
                &object
            };
            batch.subscribe(domain, object, &[variable.id()]);
            let reply =
                client.step(&mut batch, 0.0).unwrap_or_else(|e| panic!("{name} {constant}: {e}"));
            reply.check().unwrap_or_else(|e| panic!("{name} {constant}: {e}"));
            assert!(
                reply.get(object, variable).is_some_and(|value| value.is_ok()),
                "{name} {constant}"
            );
            told += 1;
        }
        let mut names: Vec<_> = with.into_iter().map(|(constant, _)| constant).collect();
        names.sort_unstable();
        let leaders =
            if domain == Domain::VEHICLE { &["VAR_FOLLOWER", "VAR_LEADER"][..] } else { &[] };
        assert_eq!(
            names,
            [leaders, &["VAR_PARAMETER", "VAR_PARAMETER_WITH_KEY"]].concat(),
            "{name}"
        );
    }
    assert!(told > 250, "{told}");
}
