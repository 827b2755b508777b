//! Scenario files: the shipped intersection and its geometry, errors and their messages, and the
//! conversion back to XML.

use std::{
    collections::BTreeSet,
    error::Error as _,
    fs,
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
};

use iwol_sumo::{
    algo::{self, Channel},
    driving::{Policy, evaluate},
    env::{EpisodeRecord, Task},
    evaluate::{EvaluationObserver, LearnedPolicy},
    rng::Seed,
    scenario::{
        AgentRange, Border, Communication, Control, Error, FileTime, Intention, Jitter, LaneChange,
        Lidar, NeighbourOrder, Net, Observation, ObservationGroups, Occlusion, PlaceDeparture,
        Reward, Route, Scenario, Severity, SpawnRow, Steering, Termination, Traffic, Vehicle,
        VehicleVariant,
    },
    sumo::{
        Hosting,
        net::{self, EdgeFunction},
    },
};
use proptest::prelude::*;
use tch::Device;

use crate::support::{self, INTERSECTION, folder, in_parallel, root};

fn shipped() -> Scenario {
    support::shipped("intersection")
}

fn shipped_text() -> String {
    fs::read_to_string(root().join(INTERSECTION)).unwrap()
}

/// Arm length \[m\] and number of spawn places of each shipped net.
const SIZES: [(f64, u32); 4] = [(30.0, 8), (42.0, 16), (74.0, 32), (106.0, 48)];

fn close(a: [f64; 2], b: [f64; 2]) -> bool {
    (a[0] - b[0]).hypot(a[1] - b[1]) < 1e-9
}

#[test]
fn the_shipped_scenario_is_the_task() {
    let scenario = shipped();
    assert_eq!(scenario.name, "intersection");
    assert_eq!(
        scenario.agents,
        AgentRange { min: 4, max: 48, default: 8, ..AgentRange::default() }
    );
    assert_eq!(scenario.nets.iter().map(Net::capacity).collect::<Vec<_>>(), [8, 16, 32, 48]);
    assert_eq!(scenario.vehicle, Vehicle { length: 4.515, width: 1.852, max_speed: 22.222 });
    assert_eq!(scenario.jitter, Jitter { longitudinal: 1.0, lateral: 0.25 });
    assert_eq!(scenario.control.brake, [(0.3, 8.2), (0.5, 10.2), (1.0, 14.7)]);
    assert_eq!(
        (scenario.control.interval, scenario.control.accel, scenario.control.drag),
        (0.1, 2.909, 0.364)
    );
    let termination = Termination {
        horizon: 1000,
        wreck_time: 2.5,
        border: Border::Line,
        broken_lines: Vec::new(),
    };
    assert_eq!(scenario.termination, termination);
}

#[test]
fn the_smallest_net_with_room_is_taken() {
    let scenario = shipped();
    for (agents, capacity) in [(4, 8), (8, 8), (9, 16), (16, 16), (17, 32), (33, 48), (48, 48)] {
        assert_eq!(scenario.net_for(agents).unwrap().capacity(), capacity, "{agents} agents");
    }
    let error = scenario.net_for(49).unwrap_err();
    assert!(
        error
            .to_string()
            .ends_with("intersection.xml: 49 agents are not allowed, allowed: 4 to 48"),
        "{error}"
    );
    assert!(error.hint().unwrap().contains("4 to 48"));
    assert!(matches!(scenario.net_for(3), Err(Error::Agents { agents: 3, .. })));
}

#[test]
fn lanes_lie_where_the_task_has_them() {
    for (net, (arm, _)) in shipped().nets.iter().zip(SIZES) {
        let map = net::Net::load(&net.file).unwrap();
        assert_eq!(map.boundary, [[0.0, -10.0 - arm], [2.0 * arm + 23.5, 13.5 + arm]]);
        let (west, east, south, north) = (arm, arm + 23.5, -10.0, 13.5);
        let (southbound, northbound) = (arm + 10.0, arm + 13.5);
        let expected = [
            ("west_in", [0.0, 0.0], [west, 0.0]),
            ("east_out", [east, 0.0], [east + arm, 0.0]),
            ("east_in", [east + arm, 3.5], [east, 3.5]),
            ("west_out", [west, 3.5], [0.0, 3.5]),
            ("south_in", [northbound, south - arm], [northbound, south]),
            ("north_out", [northbound, north], [northbound, north + arm]),
            ("north_in", [southbound, north + arm], [southbound, north]),
            ("south_out", [southbound, south], [southbound, south - arm]),
        ];
        for (id, start, end) in expected {
            let edge = &map.edges[map.edge_index(id).unwrap()];
            let [lane] = &map.lanes[edge.lanes.clone()] else { panic!("{id} has one lane") };
            assert_eq!(lane.shape, [start, end], "{id}");
            assert_eq!((lane.length, lane.width, lane.speed), (arm, 3.5, 22.222), "{id}");
        }
        let internal: Vec<_> =
            map.edges.iter().filter(|e| e.function == EdgeFunction::Internal).collect();
        assert_eq!(internal.len(), 4, "straight streams only");
        for edge in internal {
            let [lane] = &map.lanes[edge.lanes.clone()] else { panic!("one lane") };
            let [a, b] = lane.shape[..] else { panic!("{} is straight", lane.id) };
            assert_eq!((lane.length, (b[0] - a[0]).hypot(b[1] - a[1])), (23.5, 23.5));
        }
        let centre = map.junctions.iter().find(|j| j.id == "centre").unwrap();
        assert_eq!(centre.kind, "right_before_left");
    }
}

#[test]
fn spawn_places_and_finish_lines_of_the_30_m_net_are_those_of_the_task() {
    let scenario = shipped();
    let net = scenario.net_for(8).unwrap();
    let map = net::Net::load(&net.file).unwrap();
    let (mut starts, mut ways) = (Vec::new(), Vec::new());
    for place in net.places() {
        let route = &scenario.routes[place.routes[0]];
        let path = map.route_path(&route.edges).unwrap();
        let start = path.arc(0, place.pos).unwrap();
        let finish = path.arc(route.edges.len() - 1, route.arrival_pos).unwrap();
        starts.push(path.at(start).0);
        ways.push(finish - start);
    }
    let expected = [
        [14.0, 0.0],
        [22.0, 0.0],
        [79.5, 3.5],
        [71.5, 3.5],
        [43.5, -36.0],
        [43.5, -28.0],
        [40.0, 39.5],
        [40.0, 31.5],
    ];
    assert!(starts.iter().zip(expected).all(|(&a, b)| close(a, b)), "{starts:?}");
    assert_eq!(ways, [64.5, 56.5, 64.5, 56.5, 74.5, 66.5, 74.5, 66.5]);
    assert_eq!(ways.iter().sum::<f64>() / 8.0, 65.5);
}

#[test]
fn finish_lines_and_queues_scale_with_the_arms() {
    let scenario = shipped();
    for (net, (arm, capacity)) in scenario.nets.iter().zip(SIZES) {
        let map = net::Net::load(&net.file).unwrap();
        assert_eq!(net.capacity(), capacity);
        assert_eq!(capacity / 4, ((arm - 10.0) / 8.0).floor() as u32);
        let finishes = scenario.routes.iter().map(|route| {
            let path = map.route_path(&route.edges).unwrap();
            assert_eq!(path.length(), 2.0 * arm + 23.5);
            (route.id.as_str(), path.at(path.arc(1, route.arrival_pos).unwrap()).0)
        });
        let expected = [
            ("eastbound", [2.0 * arm + 18.5, 0.0]),
            ("westbound", [15.0, 3.5]),
            ("northbound", [arm + 13.5, arm + 8.5]),
            ("southbound", [arm + 10.0, -arm - 5.0]),
        ];
        assert!(finishes.zip(expected).all(|(a, b)| a.0 == b.0 && close(a.1, b.1)));
        // The vehicle at the last place of each queue, with jitter, has its front bumper before the
        // stop line.
        let front = net.places().map(|place| place.pos + 1.0 + 4.515 / 2.0).fold(0.0, f64::max);
        assert!(front < arm);
    }
}

#[test]
fn the_schema_declares_the_keys_of_the_shipped_scenarios_and_no_others() {
    let text = fs::read_to_string(root().join("scenarios/scenario.xsd")).unwrap();
    let schema = roxmltree::Document::parse(&text).unwrap();
    let declarations =
        schema.descendants().filter(|n| matches!(n.tag_name().name(), "element" | "attribute"));
    let declared: BTreeSet<&str> = declarations.filter_map(|n| n.attribute("name")).collect();

    let mut used = BTreeSet::new();
    for path in all_shipped() {
        let text = fs::read_to_string(&path).unwrap();
        let scenario = roxmltree::Document::parse(&text).unwrap();
        for node in scenario.descendants().filter(roxmltree::Node::is_element) {
            used.insert(node.tag_name().name().to_owned());
            let attributes = node.attributes().filter(|a| a.namespace().is_none());
            used.extend(attributes.map(|a| a.name().to_owned()));
        }
    }
    assert_eq!(declared, used.iter().map(String::as_str).collect());
}

fn all_shipped() -> Vec<PathBuf> {
    let files = fs::read_dir(root().join("scenarios")).unwrap().map(|entry| entry.unwrap().path());
    let scenarios: Vec<_> =
        files.filter(|path| path.extension().is_some_and(|e| e == "xml")).collect();
    assert!(scenarios.len() >= 3, "{scenarios:?}");
    scenarios
}

#[test]
fn every_shipped_scenario_survives_its_xml() {
    for path in all_shipped() {
        let scenario = Scenario::load(&path).unwrap();
        assert_eq!(Scenario::parse(&scenario.to_xml(), &path).unwrap(), scenario);
    }
}

/// Every shipped scenario passes its check, and every algorithm drives in it for some steps.
#[test]
fn every_shipped_scenario_is_for_every_method() {
    in_parallel(all_shipped(), |path| {
        let checked = Scenario::check(&path);
        assert!(
            checked.list.iter().all(|finding| finding.severity != Severity::Error),
            "{:?}",
            checked.list
        );
        let mut scenario = checked.scenario.unwrap();
        scenario.termination.horizon = 5;
        let task = Arc::new(Task::new(&scenario, scenario.agents.min.max(2)).unwrap());
        for name in algo::NAMES {
            let settings = algo::Settings::default();
            let learner =
                algo::build(name, &task.spec, &settings, Seed::new(0), Device::Cpu).unwrap();
            let learned = LearnedPolicy { learner: &*learner, channel: Channel::default() };
            let policy = Policy::Learned(&learned);
            // One episode is enough; a whole window of the throughput metric would take hundreds.
            let stop = AtomicBool::new(false);
            let observer = EvaluationObserver {
                stop: &stop,
                report: &mut |_| stop.store(true, Ordering::Relaxed),
                recorder: None,
                beside: false,
            };
            let played =
                evaluate(&task, &policy, 1, Seed::new(0), &Hosting::default(), observer).unwrap();
            let driven =
                |record: &EpisodeRecord| record.episode_length > 0 && record.reward.is_finite();
            assert!(
                !played.episodes.is_empty() && played.episodes.iter().all(driven),
                "{name} on {path:?}"
            );
        }
    });
}

/// Returns message, causes and hint of the error that the shipped scenario gives when `from` is
/// replaced by `to`.
fn mistake(from: &str, to: &str) -> String {
    let folder = folder();
    let text = shipped_text();
    assert!(text.contains(from), "{from}");
    let nets = root().join("sumo_nets");
    let text = text.replacen(from, to, 1).replace("../sumo_nets", nets.to_str().unwrap());
    let file = folder.path().join("task.xml");
    fs::write(&file, text).unwrap();
    let error = Scenario::load(&file).unwrap_err();
    let mut message = error.to_string();
    let mut cause = error.source();
    while let Some(source) = cause {
        message = format!("{message}: {source}");
        cause = source.source();
    }
    if let Some(hint) = error.hint() {
        message = format!("{message} (hint: {hint})");
    }
    let message = message.replace(nets.to_str().unwrap(), "NETS");
    message.replace(&format!("{}/", folder.path().display()), "")
}

#[test]
fn misspelt_names_are_pointed_at() {
    insta::assert_snapshot!(mistake("<jitter longitudinal", "<jitter longitudnal"), @"task.xml:55:13: unknown attribute `longitudnal` in <jitter>; did you mean `longitudinal`? (hint: valid in <jitter>: longitudinal, lateral)");
    insta::assert_snapshot!(mistake("<vehicle ", "<vehicel "), @"task.xml:52:5: unknown element `vehicel` in <scenario>; did you mean `vehicle`? (hint: valid in <scenario>: description, agents, routes, nets, vehicle, jitter, control, observation, reward, termination, communication, occlusion, traffic)");
    insta::assert_snapshot!(mistake("<spawn route=\"westbound\"", "<spawn route=\"westbund\""), @"task.xml:27:20: route `westbund` is not the id of a route; did you mean `westbound`?");
    insta::assert_snapshot!(mistake("<communication range=\"100\"/>", "<communication range=\"100\">far</communication>"), @"task.xml:74:32: unknown text `far` in <communication>");
    insta::assert_snapshot!(mistake("xsi:noNamespace", "xmlns:o=\"o\" o:a=\"1\" xsi:noNamespace"), @"task.xml:8:97: unknown attribute `a` in <scenario> (hint: valid in <scenario>: name)");
    insta::assert_snapshot!(mistake("mode=\"throttle\"", "mode=\"thrttle\""), @"task.xml:59:14: `thrttle` is not a valid mode of <control>, allowed: `throttle`, `steering`; did you mean `throttle`?");
}

#[test]
fn missing_and_doubled_parts_are_named() {
    insta::assert_snapshot!(mistake(" width=\"1.852\"", ""), @"task.xml:52:5: <vehicle> lacks the attribute `width` (hint: `iwol scenario reference` prints all elements and attributes)");
    insta::assert_snapshot!(mistake("<jitter longitudinal=\"1\" lateral=\"0.25\"/>", ""), @"task.xml:8:1: <scenario> lacks the element `jitter` (hint: `iwol scenario reference` prints all elements and attributes)");
    insta::assert_snapshot!(mistake("<communication range=\"100\"/>", "<communication range=\"1\"/><communication range=\"2\"/>"), @"task.xml:74:31: a second element <communication>");
    insta::assert_snapshot!(mistake("<route id=\"westbound\"", "<route id=\"eastbound\""), @"task.xml:17:16: a second route with the id `eastbound`");
    insta::assert_snapshot!(mistake("</scenario>", ""), @"task.xml:1:1: cannot be read as XML: the root node was opened but never closed");
}

#[test]
fn more_than_a_scenario_has_is_refused() {
    let route = |i| format!("<route id=\"r{i}\" edges=\"west_in east_out\" arrivalPos=\"-5\"/>");
    let routes: String = (0..253).map(route).collect();
    insta::assert_snapshot!(mistake("<routes>", &format!("<routes>{routes}")), @"task.xml:19:9: more than 256 elements <route>");
    let net =
        "<net file=\"n\"><spawn route=\"eastbound\" first=\"1\" spacing=\"1\" count=\"1\"/></net>";
    insta::assert_snapshot!(mistake("</nets>", &format!("{}</nets>", net.repeat(61))), @"task.xml:49:4685: more than 64 elements <net>");
    let edges = "e ".repeat(4097);
    assert!(
        mistake("west_in east_out", &edges)
            .ends_with("allowed: 1 to 4096 words, separated by spaces")
    );
}

#[test]
fn values_out_of_range_are_refused() {
    insta::assert_snapshot!(mistake("accel=\"2.909\"", "accel=\"2,909\""), @"task.xml:59:45: `2,909` is not a valid accel of <control>, allowed: number above 0");
    insta::assert_snapshot!(mistake("max=\"48\"", "max=\"49\""), @"task.xml:12:21: `49` is not a valid max of <agents>, allowed: 4 (`min`) to 48, the number of places of the largest net");
    insta::assert_snapshot!(mistake("min=\"4\" max=\"48\"", "min=\"9\" max=\"8\""), @"task.xml:12:21: `8` is not a valid max of <agents>, allowed: 9 (`min`) to 48, the number of places of the largest net");
    insta::assert_snapshot!(mistake("min=\"4\" max=\"48\"", "min=\"49\" max=\"48\""), @"task.xml:12:13: `49` is not a valid min of <agents>, allowed: 1 to 48, the number of places of the largest net");
    insta::assert_snapshot!(mistake("wreckTime=\"2.5\"", "wreckTime=\"1e300\""), @"task.xml:71:33: `1e300` is not a valid wreckTime of <termination>, allowed: number of at least 0, at most 1e9 in magnitude");
    insta::assert_snapshot!(mistake("default=\"8\"", "default=\"3\""), @"task.xml:12:30: `3` is not a valid default of <agents>, allowed: whole number from 4 to 48");
    insta::assert_snapshot!(mistake("cooperation=\"0.06\"", "cooperation=\"1.5\""), @"task.xml:68:78: `1.5` is not a valid cooperation of <reward>, allowed: number from 0 to 1");
    insta::assert_snapshot!(mistake("0.5:10.2", "0.2:10.2"), @"task.xml:59:72: `0.3:8.2 0.2:10.2 1:14.7` is not a valid brake of <control>, allowed: pairs magnitude:deceleration with numbers above 0, magnitudes that ascend to 1, and decelerations that do not decrease");
    insta::assert_snapshot!(mistake("interval=\"0.1\"", "interval=\"0.0005\""), @"task.xml:59:30: `0.0005` is not a valid interval of <control>, allowed: number from 0.001 to 10");
    insta::assert_snapshot!(mistake("horizon=\"1000\"", "horizon=\"0\""), @"task.xml:71:18: `0` is not a valid horizon of <termination>, allowed: whole number from 1 to 1000000");
    insta::assert_snapshot!(mistake("detectionRange=\"100\"", "detectionRange=\"inf\""), @"task.xml:64:36: `inf` is not a valid detectionRange of <observation>, allowed: number above 0, at most 1e9 in magnitude");
    insta::assert_snapshot!(mistake("intention=\"hidden\"", "intention=\"hiden\""), @"task.xml:64:72: `hiden` is not a valid intention of <observation>, allowed: `seen`, `signalled`, `hidden`; did you mean `hidden`?");
    insta::assert_snapshot!(mistake("intention=\"hidden\"", "intention=\"hidden\" signalDistance=\"20\""), @"task.xml:64:91: `20` is not a valid signalDistance of <observation>, allowed: no value unless intention is `signalled`: otherwise no vehicle has an indicator");
    insta::assert_snapshot!(mistake("intention=\"hidden\"", "intention=\"signalled\" signalDistance=\"0\""), @"task.xml:64:94: `0` is not a valid signalDistance of <observation>, allowed: number from 1 to 200");
    insta::assert_snapshot!(mistake("name=\"intersection\"", "name=\"../out\""), @"task.xml:8:11: `../out` is not a valid name of <scenario>, allowed: 1 to 64 letters, digits, `-` and `_`");
}

#[test]
fn what_does_not_go_with_the_nets_is_refused() {
    insta::assert_snapshot!(mistake("arm42.net.xml", "arm43.net.xml"), @"task.xml:31:14: the net cannot be used: NETS/intersection/arm43.net.xml: cannot read the net: No such file or directory (os error 2) (hint: build the net (`iwol scenario build`), or correct the file name)");
    insta::assert_snapshot!(mistake("west_in east_out", "west_in east_ou"), @"task.xml:16:31: the route `eastbound` cannot be driven: NETS/intersection/arm30.net.xml: the net has no edge `east_ou`; did you mean `east_out`?");
    insta::assert_snapshot!(mistake("west_in east_out", ":centre_3"), @"task.xml:16:31: the route `eastbound` cannot be driven: NETS/intersection/arm30.net.xml: the edge `:centre_3` is not a road, so no route can name it");
    insta::assert_snapshot!(mistake("west_in east_out", "west_in north_out"), @"task.xml:16:31: the route `eastbound` cannot be driven: NETS/intersection/arm30.net.xml: the edge `west_in` does not lead to `north_out`");
    insta::assert_snapshot!(mistake("arrivalPos=\"-15\"", "arrivalPos=\"-35\""), @"task.xml:17:56: `-35` is not a valid arrivalPos of <route>, allowed: -30 to 30 m on edge `west_out`");
    insta::assert_snapshot!(mistake("first=\"14\" spacing=\"8\" count=\"2\"", "first=\"14\" spacing=\"8\" count=\"3\""), @"task.xml:26:13: the spawn place at 30 m of route `eastbound` does not fit on edge `west_in`: a place needs 3.2575 m on both sides within 0 to 30 m (hint: move the places, lower their number, or make the longitudinal jitter smaller)");
    insta::assert_snapshot!(mistake("first=\"14\" spacing=\"8\" count=\"2\"", "first=\"14\" spacing=\"6\" count=\"2\""), @"task.xml:26:13: the spawn places at 14 m and 20 m of lane `west_in_0` overlap: vehicle and jitter need 6.515 m (hint: move the places, lower their number, or make the longitudinal jitter smaller)");
    insta::assert_snapshot!(mistake("wreckTime=\"2.5\"", "wreckTime=\"2.5\" brokenLines=\"west_inn\""), @"task.xml:71:49: `west_inn` is not a valid brokenLines of <termination>, allowed: edges of NETS/intersection/arm30.net.xml; did you mean `west_in`?");
    insta::assert_snapshot!(mistake("lateral=\"0.25\"", "lateral=\"0.9\""), @"task.xml:55:30: `0.9` is not a valid lateral of <jitter>, allowed: at most half of the width that a vehicle 1.852 m wide leaves free on lane `west_in_0`, 3.5 m wide, less 0.035 m");
}

#[test]
fn files_that_are_no_scenario_are_refused() {
    let missing = Scenario::load(Path::new("none.xml")).unwrap_err();
    assert_eq!(missing.to_string(), "none.xml: cannot read the scenario");
    assert!(missing.hint().unwrap().contains("scenarios/intersection.xml"));
    let parse = |text: &str| Scenario::parse(text, Path::new("x.xml")).unwrap_err();
    assert_eq!(
        parse("<scenari/>").to_string(),
        "x.xml:1:1: unknown element `scenari` in the file; did you mean `scenario`?"
    );
    assert!(matches!(parse(&" ".repeat((4 << 20) + 1)), Error::TooLarge { .. }));
    assert!(matches!(
        parse("<!DOCTYPE a [<!ENTITY b 'c'>]><scenario name='&b;'/>"),
        Error::Parse { .. }
    ));
    assert!(matches!(parse(&"<scenario>".repeat(100_000)), Error::Parse { .. }));
}

fn positive() -> impl Strategy<Value = f64> {
    prop_oneof![1e-6..1e6_f64, (1_u32..1000).prop_map(f64::from)]
}

fn number() -> impl Strategy<Value = f64> {
    prop_oneof![-1e6..1e6_f64, (-1000_i32..1000).prop_map(f64::from)]
}

fn word() -> impl Strategy<Value = String> {
    "[a-zA-ZäöüЖ0-9_:#/.-]{1,12}"
}

prop_compose! {
    fn nets(routes: usize)(
        rows in prop::collection::vec(
            (word(), prop::collection::vec((0..routes, positive(), positive(), 1_u32..50), 1..5)), 1..4,
        )
    ) -> Vec<Net> {
        let mut nets: Vec<Net> = rows.into_iter().map(|(file, rows)| Net {
            file: Path::new("some/folder").join(format!("../a&<\"'> {file}.net.xml")),
            spawns: rows.into_iter().map(|(route, first, spacing, count)| SpawnRow { routes: [route].into(), first, spacing, count, departure: PlaceDeparture { presence: f64::from(count).recip(), begin: first, end: first + spacing, depart_speed: spacing } }).collect(),
        }).collect();
        nets.sort_by_key(Net::capacity);
        nets
    }
}

prop_compose! {
    fn scenarios()(routes in prop::collection::btree_map(word(), (prop::collection::vec(word(), 1..4), number()), 1..5))(
        nets in nets(routes.len()),
        routes in Just(routes),
        name in "[a-zA-Z0-9_-]{1,64}",
        words in prop::collection::vec("[!-~äß]{1,9}", 0..6),
        (share, fewer) in (0.0..=1.0, 0.0..1.0_f64),
        p in prop::collection::vec(positive(), 10),
        n in prop::collection::vec(number(), 5),
        steps in prop::collection::vec((0.01..1.0, 0.01..5.0), 1..5),
        milliseconds in 1_u32..10_000,
        counts in prop::collection::vec(0_usize..=16, 3),
        horizon in 1_u32..=1_000_000,
    ) -> Scenario {
        let max = nets.iter().map(Net::capacity).max().unwrap();
        let min = 1 + (f64::from(max - 1) * fewer) as u32;
        let total: f64 = steps.iter().map(|(m, _)| m).sum();
        let (mut magnitude, mut deceleration) = (0.0, 0.0);
        let mut brake: Vec<(f64, f64)> = steps.iter().map(|(m, d)| {
            magnitude += m / total;
            deceleration += d;
            (magnitude, deceleration)
        }).collect();
        brake.last_mut().unwrap().0 = 1.0;
        Scenario {
            name,
            path: "some/folder/x.xml".into(),
            description: words.join(" "),
            agents: AgentRange {
                min, max, default: min,
                types: ["car", "bus"].iter().take(counts[2] % 3).map(|&id| id.into()).collect(),
                vehicles: ["*"].iter().take(counts[0] % 2).map(|&id| id.into()).collect(),
            },
            nets,
            routes: routes.into_iter().map(|(id, (edges, arrival_pos))| Route { id, edges, lane: None, arrival_pos, reserved: false, off_lane: [1.0, -1.0][counts[1] % 2] }).collect(),
            vehicle: Vehicle { length: p[0], width: p[1], max_speed: p[2] },
            kinds: (0..if counts[0] % 2 == 1 { 0 } else { counts[2] % 3 }).map(|k| VehicleVariant {
                id: format!("kind{k}"), share: 0.3, length: p[0] * fewer.max(0.1), width: p[1] * fewer.max(0.1), max_speed: p[2],
                accel: p[3], brake: vec![(0.5, p[4]), (1.0, p[4] + 1.0)],
            }).collect(),
            jitter: Jitter { longitudinal: p[3], lateral: p[4] },
            control: Control {
                interval: f64::from(milliseconds) / 1000.0, accel: p[5], drag: p[6], brake,
                initial_throttle: 2.0 * share - 1.0,
                // Vehicles that steer have no other lane changes.
                lane_change: LaneChange::NAMES[if counts[0] % 2 == 1 { 0 } else { counts[1] % 3 }].1,
                steering: (counts[0] % 2 == 1).then(|| Steering {
                    max_angle: 0.1 + f64::from(counts[2] as u32), track: 0.1 + share, friction: 0.01 + fewer,
                    reverse: counts[1] % 2 == 1, ..Steering::default()
                }),
            },
            observation: Observation {
                groups: ObservationGroups::NAMES[counts[0] % 3].1, detection_range: p[7], neighbours: counts[0],
                distance_scale: p[6], heading: counts[0] % 2 == 0, clock: counts[1] % 2 == 0, own_turn: counts[2] % 2 == 1,
                neighbour_order: NeighbourOrder::NAMES[counts[2] % 2].1,
                intention: Intention::NAMES[counts[1] % 3].1,
                signal_distance: if counts[1] % 3 == 1 { 1.0 + f64::from(counts[2] as u32) } else { 30.0 },
                conflict_streams: counts[1], stream_vehicles: counts[2], encounters: counts[0] / 2,
                foresight: f64::from(counts[2] as u32) / 2.0,
                priority_distance: f64::from(counts[1] as u32) / 2.0,
                borders: f64::from(counts[0] as u32) / 2.0,
                signals: counts[2] % 2 == 0,
                lidar: Lidar { beams: 9 * counts[1], range: 1.0 + f64::from(counts[2] as u32) },
            },
            reward: Reward { progress: n[0], speed: n[1], lane_keeping: fewer, time: 0.5, arrive: n[2], out_of_road: n[3], crash: n[4], red_light: -p[6], cooperation: share,
                share_range: if counts[0] % 2 == 0 { f64::INFINITY } else { p[9] },
            },
            termination: Termination {
                horizon, wreck_time: p[8], border: Border::NAMES[counts[1] % 2].1,
                broken_lines: ["a", "b_1"].iter().take(counts[2] % 3).map(|&edge| edge.into()).collect(),
            },
            communication: Communication { range: p[9], nearest: counts[2] },
            occlusion: (counts[1] % 4 == 0).then(|| Occlusion {
                file: "some/folder/walls.add.xml".into(),
                types: ["building", "wall"].iter().take(counts[0] % 3).map(|&kind| kind.into()).collect(),
                sight: counts[1] == 0, radio: counts[2] % 2 == 0,
            }),
            traffic: Traffic {
                penetration: share.max(0.01),
                kind: (counts[0] > 8).then(|| "some type".into()),
                files: ["a b%20,c;d.rou.xml", "b/c.xml"].iter().take(1 + counts[1] % 2).map(|file| format!("some/folder/{file}").into()).collect(),
                capacity: 1 + counts[2] as u32,
                begin: FileTime(if counts[0] > 4 { p[9] } else { 0.0 }),
                strict: counts[1] % 2 == 0,
            },
        }
    }
}

proptest! {
    #[test]
    fn a_scenario_survives_its_xml(scenario in scenarios()) {
        prop_assert_eq!(Scenario::parse(&scenario.to_xml(), &scenario.path).unwrap(), scenario);
    }

    #[test]
    fn a_damaged_scenario_never_panics(at in 0.0..1.0_f64, length in 0_usize..40, filler in "[ -~]{0,6}") {
        let text = shipped().to_xml();
        let start = (text.len() as f64 * at) as usize;
        let end = (start + length).min(text.len());
        let damaged = format!("{}{filler}{}", &text[..start], &text[end..]);
        if let Ok(scenario) = Scenario::parse(&damaged, Path::new("x.xml")) {
            prop_assert!(scenario.net_for(scenario.agents.max).is_ok());
        }
    }
}
