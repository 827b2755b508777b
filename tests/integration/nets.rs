//! Nets of all kinds that SUMO runs: who may drive where, lengths that are not those of the shape,
//! traffic on the left, forks, cities, and what an import leaves out.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use iwol_sumo::driving::Policy;
use iwol_sumo::env::Task;
use iwol_sumo::inspect::Trial;
use iwol_sumo::rng::Seed;
use iwol_sumo::scenario::author::{Choices, Error, Imported, Map, Sizes, Template, create, import};
use iwol_sumo::scenario::{Scenario, Severity};
use iwol_sumo::sumo::Hosting;
use iwol_sumo::sumo::net::Net;

use super::authoring::run;
use crate::support::{folder, play};

const CHOICES: Choices<'static> =
    Choices { junction: None, agents: 8, steering: false, left_hand: false, whole_net: false };

const ARMS: [(&str, f64, f64); 4] =
    [("w", -100.0, 0.0), ("s", 0.0, -100.0), ("e", 100.0, 0.0), ("n", 0.0, 100.0)];

/// Writes the sources of a crossing of two roads and builds its net. `lanes` are those of each
/// edge into and out of the crossing, `out` further attributes of the edges out, and `links` the
/// connections.
fn crossing(
    folder: &Path,
    name: &str,
    lanes: [u32; 2],
    out: &str,
    links: &str,
    options: &[&str],
) -> PathBuf {
    let side = if options.contains(&"--lefthand") { -1.0 } else { 1.0 };
    let nodes = ARMS.map(|(id, x, y)| format!("<node id=\"{id}\" x=\"{x}\" y=\"{}\"/>", side * y));
    let edges = ARMS.map(|(id, ..)| {
        format!(
            "<edge id=\"{id}i\" from=\"{id}\" to=\"C\" numLanes=\"{}\"/><edge id=\"{id}o\" from=\"C\" to=\"{id}\" numLanes=\"{}\" {out}/>",
            lanes[0], lanes[1]
        )
    });
    let files = [
        (
            "nod",
            format!(
                "<nodes><node id=\"C\" x=\"0\" y=\"0\" type=\"priority\"/>{}</nodes>",
                nodes.concat()
            ),
        ),
        ("edg", format!("<edges>{}</edges>", edges.concat())),
        ("con", format!("<connections>{links}</connections>")),
    ];
    for (ending, text) in &files {
        fs::write(folder.join(format!("{name}.{ending}.xml")), text).unwrap();
    }
    let [nod, edg, con, net] = ["nod", "edg", "con", "net"].map(|end| format!("{name}.{end}.xml"));
    let arguments = ["-n", &nod, "-e", &edg, "-x", &con, "-o", &net, "--no-turnarounds", "true"];
    run("netconvert", &[&arguments, options].concat(), folder).unwrap();
    folder.join(net)
}

fn imported(folder: &Path, name: &str, net: &Path, choices: &Choices) -> (Imported, Scenario) {
    let imported = import(folder, name, Map::Net(net), choices).unwrap();
    let checked = Scenario::check(&imported.scenario);
    assert!(!checked.has_errors(), "{name}: {:?}", checked.list);
    (imported, checked.scenario.unwrap())
}

/// Runs a trial, in which SUMO must not lose a vehicle.
fn trial(scenario: &Scenario, steps: u32) -> Trial {
    let agents = scenario.agents.default;
    let trial = Trial::run(scenario, agents, steps, Seed::new(0), &Hosting::default()).unwrap();
    let found = trial.findings(scenario);
    let errors: Vec<_> = found.iter().filter(|f| f.severity == Severity::Error).collect();
    assert!(errors.is_empty(), "{errors:?}");
    trial
}

/// Polygons that hide nobody, and those on a road, are most likely in the wrong place.
#[test]
fn polygons_in_the_wrong_place_are_told() {
    let folder = folder();
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/scenarios/blind_crossing.xml");
    let mut scenario = Scenario::load(Path::new(file)).expect("a scenario");
    let mut told = |shape: Option<&str>| -> Vec<&str> {
        if let Some(shape) = shape {
            let moved = folder.path().join("moved.add.xml");
            let text = format!(
                "<additional><poly id=\"a\" type=\"building\" shape=\"{shape}\"/></additional>"
            );
            fs::write(&moved, text).unwrap();
            scenario.occlusion.as_mut().expect("buildings").file = moved;
        }
        let found = trial(&scenario, 20).findings(&scenario);
        let kinds = found.iter().map(|finding| finding.kind);
        kinds.filter(|kind| ["hides-nobody", "polygon-on-road"].contains(kind)).collect()
    };
    assert_eq!(told(None), [""; 0]);
    assert_eq!(told(Some("-500,-500 -480,-500 -480,-480 -500,-480")), ["hides-nobody"]);
    assert_eq!(
        told(Some("-500,-500 500,-500 500,500 -500,500")),
        ["hides-nobody", "polygon-on-road"]
    );
}

#[test]
fn routes_are_judged_by_the_class_of_who_drives() {
    let folder = folder();
    let links = "<connection from=\"wi\" to=\"no\" fromLane=\"0\" toLane=\"0\" allow=\"bus\"/><connection from=\"wi\" to=\"eo\"/>\
                 <connection from=\"wi\" to=\"so\"/>";
    let net = crossing(folder.path(), "perm", [1, 1], "", links, &[]);
    let (imported, scenario) = imported(folder.path(), "perm", &net, &CHOICES);
    assert!(scenario.routes.iter().all(|route| route.edges != ["wi", "no"]));
    assert_eq!(imported.notes, ["left out: 1 connection closed to cars (wi_0 to no_0)"]);
    trial(&scenario, 50);
    // A bus may take the connection, and a car of a route file may not.
    for (class, right) in [("bus", true), ("passenger", false)] {
        let vehicles = format!(
            "<routes><vType id=\"t\" vClass=\"{class}\"/><flow id=\"f\" type=\"t\" begin=\"0\" period=\"3\"><route edges=\"wi no\"/></flow></routes>"
        );
        fs::write(folder.path().join("scenarios/t.rou.xml"), vehicles).unwrap();
        let text = fs::read_to_string(&imported.scenario).unwrap();
        let text = text.replace("</scenario>", "<traffic files=\"t.rou.xml\"/></scenario>");
        let file = imported.scenario.with_file_name("mixed.xml");
        fs::write(&file, text).unwrap();
        let checked = Scenario::check(&file);
        assert!(!checked.has_errors(), "{:?}", checked.list);
        let closed =
            "no connection from the edge `wi` to `no` is open to vehicles of class `passenger`";
        let refused = checked.list.iter().any(|finding| finding.message.contains(closed));
        assert_eq!(refused, !right, "{:?}", checked.list);
        trial(&checked.scenario.unwrap(), 100);
    }
}

/// SUMO's metres along the lanes out, 200, are not those of their shapes, 93.
#[test]
fn vehicles_arrive_on_lanes_that_are_longer_than_their_shapes() {
    let folder = folder();
    let net = crossing(folder.path(), "long", [1, 1], "length=\"200\"", "", &[]);
    let (_, scenario) = imported(folder.path(), "long", &net, &CHOICES);
    assert!(scenario.routes.iter().all(|route| route.arrival_pos < -10.0), "metres of SUMO");
    trial(&scenario, 600);
    let task = Arc::new(Task::new(&scenario, 8).unwrap());
    let played = play(&task, &Policy::Sumo, 4, Seed::new(0));
    assert!(played.episodes.iter().all(|episode| !episode.interrupted));
    // Vehicles that do not crash arrive.
    assert!(played.episodes.iter().all(|episode| episode.success == episode.driving().safety));
    // A finish line that a vehicle cannot reach before SUMO removes it is refused.
    let text = fs::read_to_string(&scenario.path).unwrap();
    let near = text.replace(
        &format!("arrivalPos=\"{}\"", scenario.routes[0].arrival_pos),
        "arrivalPos=\"-5\"",
    );
    assert_ne!(near, text);
    fs::write(&scenario.path, near).unwrap();
    assert!(Scenario::check(&scenario.path).has_errors());
}

#[test]
fn where_lanes_fork_sumo_takes_the_lane_of_the_route() {
    let folder = folder();
    let link = |from: usize, to: usize, lane: u32| {
        let [from, to] = [from, to].map(|arm| ARMS[arm % 4].0);
        format!("<connection from=\"{from}i\" to=\"{to}o\" fromLane=\"0\" toLane=\"{lane}\"/>")
    };
    let links: String = (0..4)
        .flat_map(|from| (1..4).flat_map(move |by| [0, 1].map(|lane| link(from, from + by, lane))))
        .collect();
    let net = crossing(folder.path(), "fork", [1, 2], "", &links, &[]);
    for (name, steering) in [("follow", false), ("steer", true)] {
        let choices = Choices { steering, ..CHOICES };
        let (imported, scenario) = imported(folder.path(), name, &net, &choices);
        assert_eq!(scenario.routes.len(), 12);
        let note = &imported.notes[0];
        assert!(note.starts_with("left out: 12 ways beside one to another lane"), "{note}");
        let trial = trial(&scenario, 300);
        assert_eq!(trial.lost, 0);
    }
}

/// Of the lanes to which a lane leads, SUMO takes the first from which the route can be driven.
#[test]
fn chains_of_forks_lead_where_sumo_drives() {
    let folder = folder();
    let write = |name: &str, text: &str| fs::write(folder.path().join(name), text).unwrap();
    write(
        "a.nod.xml",
        r#"<nodes><node id="n0" x="0" y="0"/><node id="n1" x="100" y="0"/><node id="n2" x="200" y="0"/><node id="n3" x="300" y="0"/>
        <node id="n4" x="400" y="50"/><node id="n5" x="400" y="-50"/><node id="nx" x="250" y="-80"/><node id="m" x="100" y="-90"/></nodes>"#,
    );
    write(
        "a.edg.xml",
        r#"<edges><edge id="A" from="n0" to="n1"/><edge id="B" from="n1" to="n2" numLanes="3"/><edge id="C" from="n2" to="n3" numLanes="2"/>
        <edge id="D" from="n3" to="n4" numLanes="2"/><edge id="E" from="n3" to="n5" numLanes="2"/><edge id="X" from="n2" to="nx"/>
        <edge id="M" from="m" to="n1"/></edges>"#,
    );
    let link = |text: &str| {
        let parts: Vec<&str> = text.split(' ').collect();
        format!(
            "<connection from=\"{}\" to=\"{}\" fromLane=\"{}\" toLane=\"{}\"/>",
            parts[0], parts[1], parts[2], parts[3]
        )
    };
    let links = "A B 0 0,A B 0 1,A B 0 2,M B 0 1,B X 0 0,B C 1 0,B C 1 1,B C 2 1,C D 0 0,C D 0 1,C D 1 1,C E 1 0,C E 1 1";
    let links: String = links.split(',').map(link).collect();
    write("a.con.xml", &format!("<connections>{links}</connections>"));
    let sources = ["-n", "a.nod.xml", "-e", "a.edg.xml", "-x", "a.con.xml", "-o", "a.net.xml"];
    run("netconvert", &sources, folder.path()).unwrap();
    let net = Net::load(&folder.path().join("a.net.xml")).unwrap();
    let lanes = |edges: &str| {
        let edges: Vec<String> = edges.split(' ').map(Into::into).collect();
        let path = net.route_path(&edges).unwrap();
        let ids = path.lanes.iter().map(|&lane| net.lanes[lane].id.clone());
        ids.filter(|id| !id.starts_with(':')).collect::<Vec<_>>().join(" ")
    };
    // As SUMO 1.15 drives, alone and with slow vehicles on the first lanes.
    assert_eq!(lanes("A B C D"), "A_0 B_1 C_0 D_0");
    assert_eq!(lanes("A B C E"), "A_0 B_1 C_1 E_0");
    assert_eq!(lanes("A B X"), "A_0 B_0 X_0");
}

#[test]
fn left_hand_traffic_is_the_mirror_image() {
    let folder = folder();
    let mut seen = Vec::new();
    for (name, options) in [("right", &[][..]), ("left", &["--lefthand"][..])] {
        let net = crossing(folder.path(), name, [2, 2], "", "", options);
        assert_eq!(Net::load(&net).unwrap().left_hand, name == "left");
        let (imported, _) =
            imported(folder.path(), name, &net, &Choices { steering: true, agents: 1, ..CHOICES });
        let text = fs::read_to_string(&imported.scenario).unwrap();
        let text = text.replace(
            "<jitter longitudinal=\"1\" lateral=\"0.25\"",
            "<jitter longitudinal=\"0\" lateral=\"0\"",
        );
        let text =
            text.replace("<observation ", "<observation lidarBeams=\"12\" lidarRange=\"20\" ");
        fs::write(&imported.scenario, text).unwrap();
        let scenario = Scenario::load(&imported.scenario).unwrap();
        let trial = trial(&scenario, 1);
        let values = |part: &str| {
            let ranges = trial.observation.iter().filter(|range| range.name.contains(part));
            let mut values: Vec<f32> = ranges.map(|range| range.least).collect();
            values.sort_by(f32::total_cmp);
            values
        };
        seen.push([values("lidar"), values("border")]);
    }
    for (right, left) in seen[0].iter().zip(&seen[1]) {
        assert!(!right.is_empty() && right.len() == left.len());
        assert!(right.iter().zip(left).all(|(a, b)| (a - b).abs() < 0.01), "{right:?} {left:?}");
        assert!(right.iter().any(|value| *value < 0.9), "nothing is near: {right:?}");
    }
}

#[test]
fn maps_of_countries_that_drive_on_the_left_become_left_hand_nets() {
    let folder = folder();
    let osm = r#"<osm version="0.6"><node id="1" lat="51.5" lon="-0.1"/><node id="2" lat="51.5" lon="-0.1017316"/><node id="3" lat="51.5" lon="-0.0982684"/>
        <node id="4" lat="51.501078" lon="-0.1"/><node id="5" lat="51.498922" lon="-0.1"/>
        <way id="10"><nd ref="2"/><nd ref="1"/><nd ref="3"/><tag k="highway" v="residential"/>SIDE</way>
        <way id="11"><nd ref="5"/><nd ref="1"/><nd ref="4"/><tag k="highway" v="residential"/></way></osm>"#;
    let left = "<tag k='driving_side' v='left'/>";
    for (name, side, option, expected) in [
        ("says", left, false, true),
        ("told", "", true, true),
        ("right", "<tag k=\"driving_side\" v=\"right\"/>", false, false),
        ("open", "", false, false),
    ] {
        let map = folder.path().join(format!("{name}.osm"));
        fs::write(&map, osm.replace("SIDE", side)).unwrap();
        let choices = Choices { left_hand: option, ..CHOICES };
        let imported = import(folder.path(), name, Map::Osm(&map), &choices).unwrap();
        let scenario = Scenario::load(&imported.scenario).unwrap();
        assert_eq!(Net::load(&scenario.nets[0].file).unwrap().left_hand, expected, "{name}");
        let says = imported.notes.iter().any(|note| note.contains("--left-hand"));
        assert_eq!(says, name == "open", "{:?}", imported.notes);
    }
}

#[test]
fn a_city_is_cut_to_what_is_near_the_routes() {
    let folder = folder();
    let arguments = ["--grid", "--grid.number", "20", "--grid.length", "100", "--no-turnarounds"];
    run("netgenerate", &[&arguments[..], &["-o", "city.net.xml"]].concat(), folder.path()).unwrap();
    let city = folder.path().join("city.net.xml");
    let (cut, part) = imported(folder.path(), "part", &city, &CHOICES);
    let (_, all) = imported(folder.path(), "all", &city, &Choices { whole_net: true, ..CHOICES });
    assert!(cut.notes.iter().any(|note| note.contains("--whole-net keeps all")), "{:?}", cut.notes);
    assert_eq!((&part.routes, &part.nets[0].spawns), (&all.routes, &all.nets[0].spawns));
    let [part_net, whole] = [&part, &all].map(|s| Net::load(&s.nets[0].file).unwrap());
    assert!(10 * part_net.lanes.len() < whole.lanes.len());
    for lane in &part_net.lanes {
        let same = whole.lanes.iter().find(|other| other.id == lane.id).unwrap();
        assert_eq!((&lane.shape, lane.length, lane.speed), (&same.shape, same.length, same.speed));
    }
    for junction in &part_net.junctions {
        let same = whole.junctions.iter().find(|other| other.id == junction.id).unwrap();
        assert_eq!((junction.x, junction.y, &junction.shape), (same.x, same.y, &same.shape));
    }
    // The same vehicles drive in the same way on the part and on the whole net.
    let [a, b] = [&part, &all].map(|scenario| trial(scenario, 100));
    let bits = |trial: &Trial| -> Vec<[u32; 2]> {
        trial.observation.iter().map(|r| [r.least.to_bits(), r.most.to_bits()]).collect()
    };
    assert_eq!(bits(&a), bits(&b));
}

#[test]
fn a_roundabout_is_one_site() {
    let folder = folder();
    let sizes = Sizes { lanes: None, arm_length: None, agents: 8, speed: 13.889, steering: false };
    let file = create(folder.path(), "ring", Template::Roundabout, &sizes).unwrap();
    let template = Scenario::load(&file).unwrap();
    let net = &template.nets[0].file;
    let (imported, scenario) = imported(folder.path(), "copy", net, &CHOICES);
    let first = &imported.candidates[0];
    assert_eq!((first.kind.as_str(), first.arms), ("roundabout", 4), "{:?}", imported.candidates);
    assert_eq!(imported.candidates.len(), 1);
    assert_eq!(scenario.routes.len(), 12, "no vehicle goes back where it came from");
    trial(&scenario, 200);
    // Each of its junctions names it.
    let ring = Net::load(net).unwrap().roundabouts.remove(0);
    for (i, junction) in ring.junctions.iter().enumerate() {
        let choices = Choices { junction: Some(junction), ..CHOICES };
        let again = import(folder.path(), &format!("again{i}"), Map::Net(net), &choices).unwrap();
        assert_eq!(&again.candidates[0], first);
    }
}

#[test]
fn a_refusal_says_what_was_left_out() {
    let folder = folder();
    let net = crossing(folder.path(), "slow", [1, 1], "", "", &[]);
    let text = fs::read_to_string(&net).unwrap();
    let refusal = |name: &str, text: &str, junction| {
        let file = folder.path().join(format!("{name}.net.xml"));
        fs::write(&file, text).unwrap();
        let choices = Choices { junction, ..CHOICES };
        let error = import(folder.path(), name, Map::Net(&file), &choices).unwrap_err();
        assert!(matches!(error, Error::NoSite { .. }), "{error}");
        error.to_string()
    };
    let still = refusal("still", &text.replace("speed=\"13.89\"", "speed=\"0.00\""), None);
    assert!(still.contains("lanes with the speed limit 0 ("), "{still}");
    let buses =
        text.replace("index=\"0\" speed=\"13.89\"", "index=\"0\" allow=\"bus\" speed=\"13.89\"");
    let buses = refusal("buses", &buses, Some("C"));
    assert!(buses.contains("`C` is not a junction where"), "{buses}");
    let other = refusal("other", &text, Some("c"));
    assert!(other.contains("the map has no junction `c`; did you mean `C`?"), "{other}");
}

#[test]
fn traffic_lights_without_regulation_hide_collisions_from_sumo() {
    let folder = folder();
    let options = ["--tls.set", "C", "--tls.default-type", "static"];
    let net = crossing(folder.path(), "lights", [1, 1], "", "", &options);
    let text = fs::read_to_string(&net).unwrap();
    let changed = text.replace("type=\"traffic_light\"", "type=\"traffic_light_unregulated\"");
    assert_ne!(changed, text);
    fs::write(&net, changed).unwrap();
    let imported = import(folder.path(), "lights", Map::Net(&net), &CHOICES).unwrap();
    let kinds: Vec<_> =
        Scenario::check(&imported.scenario).list.iter().map(|finding| finding.kind).collect();
    assert!(kinds.contains(&"unregulated-junction"), "{kinds:?}");
    assert!(!kinds.contains(&"red-light"), "an imported scenario has a reward for red: {kinds:?}");
}
