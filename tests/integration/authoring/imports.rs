//! Scenarios from maps and from generated nets.

use std::fs;
use std::path::Path;

use iwol_sumo::inspect::Trial;
use iwol_sumo::rng::Seed;
use iwol_sumo::scenario::Scenario;
use iwol_sumo::scenario::author::{Error, Map, State, build, import_configuration};
use iwol_sumo::sumo::Hosting;

use super::{errors, import, run};
use crate::support::{folder, root};

/// A crossing of two streets in OpenStreetMap's XML, with a footway.
const OSM: &str = r#"<osm version="0.6"><bounds minlat="52.0" minlon="13.0" maxlat="52.01" maxlon="13.01"/>
<node id="1" lat="52.0050" lon="13.0000"/><node id="2" lat="52.0050" lon="13.0050"/><node id="3" lat="52.0050" lon="13.0100"/>
<node id="4" lat="52.0000" lon="13.0050"/><node id="5" lat="52.0100" lon="13.0050"/><node id="6" lat="52.0060" lon="13.0060"/>
<way id="10"><nd ref="1"/><nd ref="2"/><nd ref="3"/><tag k="highway" v="residential"/></way>
<way id="11"><nd ref="4"/><nd ref="2"/><nd ref="5"/><tag k="highway" v="residential"/></way>
<way id="12"><nd ref="2"/><nd ref="6"/><tag k="highway" v="footway"/></way></osm>"#;

#[test]
fn a_map_becomes_a_scenario_that_runs() {
    let folder = folder();
    fs::write(folder.path().join("map.osm"), OSM).unwrap();
    let map = folder.path().join("map.osm");
    let imported = import(folder.path(), "town", Map::Osm(&map), None, 8, false).unwrap();
    let first = &imported.candidates[0];
    assert_eq!(
        (first.junction.as_str(), first.arms, first.routes),
        ("2", 4, 12),
        "{:?}",
        imported.candidates
    );
    let checked = Scenario::check(&imported.scenario);
    assert!(errors(&checked.list).is_empty(), "{:?}", checked.list);
    let scenario = checked.scenario.unwrap();
    assert_eq!(scenario.agents.max, first.places);
    Trial::run(&scenario, 8, 50, Seed::new(0), &Hosting::default()).unwrap();
    assert_eq!(build(&imported.scenario, false).unwrap()[0].before, State::UpToDate);
}

#[test]
fn generated_nets_are_imported() {
    let folder = folder();
    let kinds: [(&str, &[&str]); 3] = [
        ("grid", &["--grid", "--grid.number", "3", "--default.lanenumber", "2"]),
        ("spider", &["--spider", "--spider.arm-number", "5"]),
        ("rand", &["--rand", "--rand.iterations", "40", "--seed", "3"]),
    ];
    for (name, arguments) in kinds {
        let file = format!("{name}.net.xml");
        run("netgenerate", &[arguments, &["-o", &file]].concat(), folder.path()).unwrap();
        let imported =
            import(folder.path(), name, Map::Net(&folder.path().join(&file)), None, 8, false)
                .unwrap();
        let checked = Scenario::check(&imported.scenario);
        assert!(errors(&checked.list).is_empty(), "{name}: {:?}", checked.list);
        let scenario = checked.scenario.unwrap();
        Trial::run(&scenario, scenario.agents.default, 50, Seed::new(0), &Hosting::default())
            .unwrap();
    }
    // A junction other than the first one, and an id that is not a junction.
    let net = folder.path().join("grid.net.xml");
    let other = import(folder.path(), "other", Map::Net(&net), Some("B0"), 8, false).unwrap();
    assert_eq!(other.candidates[0].junction, "B0");
    let error = import(folder.path(), "none", Map::Net(&net), Some("Z9"), 8, false).unwrap_err();
    assert!(error.to_string().contains("the map has no junction `Z9`"), "{error}");
    assert!(!folder.path().join("sumo_nets/none").exists());
}

#[test]
fn maps_without_a_site_are_refused() {
    let folder = folder();
    let no_road = OSM.replace("residential", "footway");
    let file = |name: &str, text: &str| {
        fs::write(folder.path().join(name), text).unwrap();
        folder.path().join(name)
    };
    // Two roads end to end, on which vehicles from opposite directions only pass each other.
    let nodes = r#"<nodes><node id="a" x="0" y="0"/><node id="b" x="100" y="0"/><node id="c" x="200" y="0"/></nodes>"#;
    let edge =
        |from: char, to: char| format!("<edge id=\"{from}{to}\" from=\"{from}\" to=\"{to}\"/>");
    let edges = format!(
        "<edges>{}{}{}{}</edges>",
        edge('a', 'b'),
        edge('b', 'c'),
        edge('c', 'b'),
        edge('b', 'a')
    );
    file("x.nod.xml", nodes);
    file("x.edg.xml", &edges);
    run("netconvert", &["-n", "x.nod.xml", "-e", "x.edg.xml", "-o", "x.net.xml"], folder.path())
        .unwrap();
    let error =
        import(folder.path(), "road", Map::Net(&folder.path().join("x.net.xml")), None, 8, false)
            .unwrap_err();
    assert!(error.to_string().contains("x.net.xml`: the map has no junction where"), "{error}");
    assert!(error.hint().unwrap().contains("take a map that contains a junction"), "{error}");
    let paths = file("paths.osm", &no_road);
    let error = import(folder.path(), "paths", Map::Osm(&paths), None, 8, false).unwrap_err();
    let said = error.to_string();
    assert!(said.contains("paths.osm`: ") && said.contains("No edges loaded"), "{said}");
    assert!(error.hint().unwrap().contains("streets for cars"), "{error}");
    let single = file(
        "single.osm",
        &OSM.replace("way id=\"11\"><nd ref=\"4\"/>", "way id=\"11\">")
            .replace("<nd ref=\"2\"/><nd ref=\"5\"/>", ""),
    );
    let error = import(folder.path(), "single", Map::Osm(&single), None, 8, false).unwrap_err();
    assert!(error.to_string().contains("no roads for cars that lead to others"), "{error}");
    let broken = file("broken.osm", "<osm><node id='1'");
    let error = import(folder.path(), "broken", Map::Osm(&broken), None, 8, false).unwrap_err();
    assert!(matches!(error, Error::Map { .. }), "{error}");
    let error = import(folder.path(), "net", Map::Net(&broken), None, 8, false).unwrap_err();
    assert!(matches!(error, Error::Net(_)), "{error}");
    let error = import(folder.path(), "gone", Map::Osm(Path::new("/nowhere.osm")), None, 8, false)
        .unwrap_err();
    assert!(error.to_string().contains("/nowhere.osm"), "{error}");
    assert_eq!(
        fs::read_dir(folder.path().join("sumo_nets")).unwrap().count(),
        0,
        "nothing is left behind"
    );
}

/// Lanes for pedestrians are no part of a scenario of cars, and no fault of the net.
#[test]
fn sidewalks_are_not_reported() {
    let folder = folder();
    let net = root().join("sumo_nets/pedestrians_cross/pedestrians_cross.net.xml");
    let imported = import(folder.path(), "walk", Map::Net(&net), None, 4, false).unwrap();
    assert!(!imported.notes.iter().any(|note| note.contains("closed to cars")), "{imported:?}");
}

/// A configuration of SUMO becomes a scenario with all of its demand, whose files stand beside the
/// net, and the programs of signals in additional files.
#[test]
fn a_configuration_of_sumo_becomes_a_scenario_that_runs() {
    let folder = folder();
    let write = |name: &str, text: &str| fs::write(folder.path().join(name), text).unwrap();
    let grid =
        ["--grid", "--grid.number", "2", "--grid.attach-length", "100", "-j", "traffic_light"];
    let grid = [&grid[..], &["--tls.guess", "-o", "grid.net.xml"]].concat();
    run("netgenerate", &grid, folder.path()).unwrap();
    let net = fs::read_to_string(folder.path().join("grid.net.xml")).unwrap();
    let signals = net.matches("<tlLogic ").count();
    let program = |number: usize| {
        let program = net.split("<tlLogic ").nth(number).unwrap().split("</tlLogic>").next();
        let own = program.unwrap().replace("programID=\"0\"", "programID=\"own\"");
        format!("<tlLogic {own}</tlLogic>")
    };
    write("own programs.add.xml", &format!("<add>{}</add>", program(1)));
    write("shapes.add.xml", "<additional><poly id=\"p\"/></additional>");
    let sign = "<variableSpeedSign id=\"s\" lanes=\"A0A1_0\"/>";
    write("speeds.add.xml", &format!("<add>{sign}<poly id=\"p\"/>{}</add>", program(3)));
    let types = "<vTypeDistribution id=\"DEFAULT_VEHTYPE\"><vType id=\"car\" probability=\"3\"/>\
         <vType id=\"lorry\" vClass=\"truck\" probability=\"1\"/></vTypeDistribution>\
         <busStop id=\"b\" lane=\"A0A1_0\" startPos=\"20\" endPos=\"40\"/>";
    write("types.add.xml", &format!("<add>{types}{}</add>", program(2)));
    write(
        "a.rou.xml",
        "<routes><flow id=\"f\" begin=\"0\" end=\"9999\" period=\"3\" from=\"left0A0\" to=\"B0right0\"/>\
         <flow id=\"g\" begin=\"0\" end=\"9999\" period=\"exp(0.2)\" from=\"bottom0A0\" to=\"A1top0\"/>\
         <trip id=\"bus\" depart=\"620\" from=\"bottom0A0\" to=\"A1top0\"><stop busStop=\"b\" duration=\"5\"/></trip></routes>",
    );
    write(
        "a.sumocfg",
        "<configuration><input><net-file value=\"grid.net.xml\"/><route-files value=\"a.rou.xml\"/>\
         <additional-files value=\"types.add.xml, shapes.add.xml,speeds.add.xml,own programs.add.xml\"/></input>\
         <time><begin value=\"600\"/><end value=\"0:20:00\"/><step-length value=\"0.2\"/></time>\
         <processing><time-to-teleport value=\"60\"/></processing><report><verbose value=\"true\"/></report>\
         <output><tripinfo-output value=\"t.xml\"/></output></configuration>",
    );
    let path = folder.path().join("a.sumocfg");
    let imported = import_configuration(folder.path(), "city", &path, None).unwrap();
    let notes = imported.notes.join("\n");
    for expected in [
        "options without effect here: time-to-teleport",
        "speeds.add.xml has no effect here, with all that it has: <variableSpeedSign> (1 time)",
        "files that are not written: tripinfo-output",
        "episodes last 300 s of 600 s",
        "20 % of the cars are agents",
    ] {
        assert!(notes.contains(expected), "{notes}");
    }
    let checked = Scenario::check(&imported.scenario);
    let said: Vec<String> = checked.list.iter().map(ToString::to_string).collect();
    assert!(errors(&checked.list).is_empty() && !said.concat().contains("left out"), "{said:?}");
    assert!(!said.concat().contains("tlLogic"), "its program is part of the net: {said:?}");
    let scenario = checked.scenario.unwrap();
    assert_eq!((scenario.traffic.begin.0, scenario.control.interval), (600.0, 0.2));
    assert_eq!(
        (scenario.termination.horizon, scenario.agents.types.clone()),
        (1500, vec!["car".into()])
    );
    let net = fs::read_to_string(&scenario.nets[0].file).unwrap();
    assert_eq!(
        (net.matches("programID=\"own\"").count(), net.matches("<tlLogic ").count()),
        (3, signals)
    );
    let trial =
        Trial::run(&scenario, scenario.agents.default, 200, Seed::new(0), &Hosting::default());
    assert_eq!(trial.unwrap().lost, 0);
    // What is wrong with a configuration is said with its place, and nothing is left behind.
    let refused = |text: &str| {
        write("b.sumocfg", text);
        let path = folder.path().join("b.sumocfg");
        import_configuration(folder.path(), "other", &path, None).unwrap_err().to_string()
    };
    let input = "<configuration>\n<net-file value=\"grid.net.xml\"/>";
    write(
        "late.rou.xml",
        "<routes><trip id=\"t\" depart=\"25200\" from=\"left0A0\" to=\"B0right0\"/></routes>",
    );
    // SUMO reads the values of options in two more forms.
    let late = refused(
        "<configuration><net-file v=\"grid.net.xml\"/><route-files>late.rou.xml</route-files></configuration>",
    );
    assert!(
        late.contains(
            "b.sumocfg`: nobody departs from 0 s to 300 s; the first departure is at 25200 s"
        ),
        "{late}"
    );
    write("none.rou.xml", "<routes/>");
    let none = refused(&format!("{input}<route-files value=\"none.rou.xml\"/></configuration>"));
    assert!(none.contains("its files have no vehicles, trips or flows"), "{none}");
    write(
        "lost.rou.xml",
        "<routes><trip id=\"t\" depart=\"0\" from=\"left0A0\" to=\"nope\"/></routes>",
    );
    let lost = refused(&format!("{input}<r value=\"lost.rou.xml\"/></configuration>"));
    assert!(lost.contains("b.sumocfg`: 1 of 1 vehicles") && lost.contains("`nope`"), "{lost}");
    let lacks = refused("<configuration>\n</configuration>");
    assert!(
        lacks.contains("b.sumocfg:1:1: <configuration> lacks the element `net-file`"),
        "{lacks}"
    );
    let time = refused(&format!("{input}<begin value=\"now\"/></configuration>"));
    assert!(time.contains("b.sumocfg:2:40: `now` is not a valid value of <begin>"), "{time}");
    let gone = refused(&format!("{input}<r value=\"gone.rou.xml\"/></configuration>"));
    assert!(gone.starts_with("cannot read `") && gone.contains("gone.rou.xml"), "{gone}");
    write("bad.rou.xml", "<routes><vehicle id=\"v\" depart=\"0\" route=\"none\"/></routes>");
    let bad = refused(&format!("{input}<r value=\"bad.rou.xml\"/></configuration>"));
    let user = folder.path().join("bad.rou.xml").display().to_string();
    assert!(bad.starts_with(&user), "the user's file is named: {bad}");
    let missing = folder.path().join("missing.sumocfg");
    let missing = import_configuration(folder.path(), "other", &missing, None).unwrap_err();
    assert!(missing.to_string().starts_with("cannot read `"), "{missing}");
    assert_eq!(missing.hint(), None, "the hint for scenario files does not fit");
    assert!(!folder.path().join("sumo_nets/other").exists());
}

/// A route file that this program has not written stays as it is, although it has the name of the
/// one that it writes for SUMO.
#[test]
fn route_files_of_the_user_are_not_replaced() {
    let folder = folder();
    let grid = ["--grid", "--grid.number", "2", "--grid.attach-length", "100", "-o", "a.net.xml"];
    run("netgenerate", &grid, folder.path()).unwrap();
    let net = folder.path().join("a.net.xml");
    let imported = import(folder.path(), "site", Map::Net(&net), None, 4, false).unwrap();
    let own = folder.path().join("sumo_nets/site/site.rou.xml");
    let written = fs::read_to_string(&own).unwrap();
    fs::write(&own, "<routes><vType id=\"mine\"/></routes>").unwrap();
    build(&imported.scenario, true).unwrap();
    assert!(fs::read_to_string(&own).unwrap().contains("mine"));
    fs::write(&own, written.replace("agent", "other")).unwrap();
    fs::write(folder.path().join("sumo_nets/site/site.netccfg"), CONFIGURATION).unwrap();
    // Newer than its configuration, so that it is not built.
    let net = folder.path().join("sumo_nets/site/site.net.xml");
    fs::write(&net, fs::read(&net).unwrap()).unwrap();
    build(&imported.scenario, false).unwrap();
    assert_eq!(fs::read_to_string(&own).unwrap(), written, "its own file is up to date again");
}

/// A configuration of netconvert without sources.
const CONFIGURATION: &str = "<configuration><input/></configuration>";

/// Two files whose names differ in a space alone are both copied.
#[test]
fn copies_of_route_files_have_names_of_their_own() {
    let folder = folder();
    let write = |name: &str, text: &str| fs::write(folder.path().join(name), text).unwrap();
    let grid = ["--grid", "--grid.number", "2", "--grid.attach-length", "100", "-o", "a.net.xml"];
    run("netgenerate", &grid, folder.path()).unwrap();
    let flow = |id: &str| {
        format!(
            "<routes><flow id=\"{id}\" begin=\"0\" end=\"99\" period=\"9\" from=\"left0A0\" to=\"B0right0\" calledBy=\"x\"/></routes>"
        )
    };
    write("a b.rou.xml", &flow("one"));
    write("a_b.rou.xml", &flow("two"));
    write(
        "c.sumocfg",
        "<configuration><net-file value=\"a.net.xml\"/><route-files value=\"a b.rou.xml,a_b.rou.xml\"/>\
         <step-length value=\"0.1234\"/><scale value=\"3\"/><a1 value=\"1\"/><b1 value=\"1\"/><c1 value=\"1\"/>\
         <d1 value=\"1\"/><e1 value=\"1\"/><f1 value=\"1\"/></configuration>",
    );
    let path = folder.path().join("c.sumocfg");
    let imported = import_configuration(folder.path(), "both", &path, None).unwrap();
    let notes = imported.notes.join("\n");
    assert!(notes.contains("scale, a1, b1, c1, d1, e1, f1"), "all options are named: {notes}");
    let checked = Scenario::check(&imported.scenario);
    assert!(errors(&checked.list).is_empty(), "{:?}", checked.list);
    let said: Vec<String> = checked.list.iter().map(ToString::to_string).collect();
    assert!(said.concat().contains("calledBy of <flow> has no effect"), "{said:?}");
    let scenario = checked.scenario.unwrap();
    assert_eq!((scenario.traffic.files.len(), scenario.control.interval), (2, 0.123));
}

/// A compressed map says on which side vehicles drive, as the same map does as it is.
#[test]
fn compressed_maps_say_on_which_side_vehicles_drive() {
    let folder = folder();
    let left = OSM.replace(
        "k=\"highway\" v=\"residential\"/>",
        "k=\"highway\" v=\"residential\"/><tag k=\"driving_side\" v=\"left\"/>",
    );
    let map = folder.path().join("map.osm");
    fs::write(&map, left).unwrap();
    run("gzip", &["map.osm"], folder.path()).unwrap();
    let map = folder.path().join("map.osm.gz");
    let imported = import(folder.path(), "town", Map::Osm(&map), None, 8, false).unwrap();
    assert!(imported.notes.iter().any(|n| n.contains("drive on the left")), "{imported:?}");
}
