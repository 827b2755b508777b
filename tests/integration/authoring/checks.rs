//! Checks of scenario files and trials of their tasks.

use std::fs;
use std::path::{Path, PathBuf};

use iwol_sumo::inspect::Trial;
use iwol_sumo::rng::Seed;
use iwol_sumo::scenario::author::{Map, Template, build, create};
use iwol_sumo::scenario::{Scenario, Severity};
use iwol_sumo::sumo::Hosting;

use super::{SIZES, errors, findings, import, run};
use crate::support::{folder, iwol, root, succeeds, text};

/// Creates a scenario from the template `cross` and replaces parts of its text.
fn changed(folder: &Path, changes: &[(&str, &str)]) -> PathBuf {
    let file = create(folder, "site", Template::Cross, &SIZES).unwrap();
    let mut text = fs::read_to_string(&file).unwrap();
    for (from, to) in changes {
        assert!(text.contains(from), "{from}");
        text = text.replacen(from, to, 1);
    }
    fs::write(&file, text).unwrap();
    file
}

#[test]
fn a_check_names_every_mistake_with_its_place() {
    let folder = folder();
    let wrong = [
        ("\"west_in east_out\"", "\"west_in east_ou\""),
        ("\"south_in north_out\"", "\"south_in south_out\""),
    ];
    let file = changed(folder.path(), &wrong);
    insta::assert_snapshot!(findings(&file), @r#"
    site.xml:24:35: error: the route `west_straight` cannot be driven: ../sumo_nets/site/site.net.xml: the net has no edge `east_ou`; did you mean `east_out`?
    site.xml:27:36: error: the route `south_straight` cannot be driven: ../sumo_nets/site/site.net.xml: the edge `south_in` does not lead to `south_out`
    "#);
}

/// What is wrong with a route of several nets is said once.
#[test]
fn a_check_names_a_mistake_of_all_nets_once() {
    let folder = folder();
    let text = fs::read_to_string(root().join("scenarios/intersection.xml")).unwrap();
    let nets = root().join("sumo_nets").display().to_string();
    let text = text
        .replace("../sumo_nets", &nets)
        .replace("<vehicle length=\"4.515\"", "<vehicle length=\"500\"");
    let file = folder.path().join("long.xml");
    fs::write(&file, text).unwrap();
    let said = Scenario::check(&file).list;
    let places: Vec<_> = said.iter().map(|finding| (finding.at, &finding.message)).collect();
    let count = said.iter().filter(|f| f.message.contains("arrivalPos")).count();
    assert!(count > 1, "{places:?}");
    for (k, place) in places.iter().enumerate() {
        assert!(!places[..k].contains(place), "{place:?}");
    }
}

#[test]
fn a_check_warns_of_what_was_probably_not_meant() {
    let warned = |changes: &[(&str, &str)]| {
        let folder = folder();
        findings(&changed(folder.path(), changes))
    };
    insta::assert_snapshot!(warned(&[("horizon=\"500\"", "horizon=\"60\"")]), @r#"
    site.xml:136:18: error: route `north_left` takes 62 steps at the speed limit, but the horizon is 60 steps
      hint: set the horizon to 248 steps or more, because vehicles have to wait
    "#);
    insta::assert_snapshot!(warned(&[("horizon=\"500\"", "horizon=\"120\"")]), @r#"
    site.xml:136:18: warning: route `north_left` takes 62 steps at the speed limit, but the horizon is 120 steps
      hint: set the horizon to 248 steps or more, because vehicles have to wait
    "#);
    insta::assert_snapshot!(warned(&[("range=\"50\"", "range=\"500\"")]), @r#"
    site.xml:141:20: warning: all agents can communicate with each other: the range is 500 m, and the largest net is 122 m across
      hint: reduce the range if communication should depend on the distance between agents
    "#);
    let heard = |nearest: &str| {
        warned(&[("range=\"50\"", &format!("range=\"500\" nearest=\"{nearest}\""))])
    };
    assert_eq!(heard("4"), "", "not everybody can communicate with everybody");
    insta::assert_snapshot!(heard("7"), @r#"
    site.xml:141:20: warning: all agents can communicate with each other: the range is 500 m, and the largest net is 122 m across
      hint: reduce the range if communication should depend on the distance between agents
    site.xml:141:32: warning: nearest of <communication> has no effect, because there are never more other agents
      hint: delete the attribute, or change the other value
    "#);
    insta::assert_snapshot!(warned(&[("range=\"50\"", "range=\"5\"")]), @r#"
    site.xml:141:20: warning: agents cannot communicate with the next agent in their row: the range is 5 m, the distance 8 m
      hint: increase the range, unless agents should not communicate
    "#);
    insta::assert_snapshot!(warned(&[("detectionRange=\"100\"", "detectionRange=\"6\"")]), @r#"
    site.xml:116:36: warning: at 13.889 m/s a vehicle needs 8 m to stop, but agents observe only 6 m
      hint: increase detectionRange, or reduce maxSpeed
    "#);
    insta::assert_snapshot!(warned(&[("conflictStreams=\"6\"", "conflictStreams=\"0\"")]), @r#"
    site.xml:116:18: warning: agents observe no vehicle that crosses their route
      hint: set one of neighbours (with groups `nearest`), conflictStreams (with groups `conflict`), encounters and lidarBeams to a number above 0
    "#);
    let encounters = ("conflictStreams=\"6\"", "conflictStreams=\"0\" encounters=\"4\"");
    assert!(!warned(&[encounters]).contains("observe no vehicle"), "encounters show them");
    insta::assert_snapshot!(warned(&[("maxSpeed=\"13.889\"", "maxSpeed=\"20\"")]), @r#"
    site.xml:71:43: warning: agents may drive 20 m/s, but the speed limit of lane `west_in_0` of ../sumo_nets/site/site.net.xml is 13.889 m/s
      hint: speed limits of lanes do not slow agents down; reduce maxSpeed if agents should keep the limit
    "#);
    insta::assert_snapshot!(warned(&[("crash=\"-10\"", "crash=\"10\"")]), @r#"
    site.xml:129:66: warning: the reward of a crash is not below the reward of an arrival
      hint: scenarios/intersection.xml has weights with which agents learn
    "#);
    insta::assert_snapshot!(warned(&[("route=\"west_straight west_left west_right\"", "route=\"west_straight west_left\"")]), @r#"
    site.xml:26:16: warning: no spawn place uses the route `west_right`
      hint: name the route in a <spawn>, or delete the route
    "#);
}

#[test]
fn a_check_looks_at_the_net() {
    let folder = folder();
    let file = create(folder.path(), "site", Template::Cross, &SIZES).unwrap();
    let nodes = folder.path().join("sumo_nets/site/site.nod.xml");
    let text = fs::read_to_string(&nodes).unwrap();
    fs::write(&nodes, text.replace("\"right_before_left\"", "\"unregulated\"")).unwrap();
    build(&file, true).unwrap();
    assert!(
        findings(&file).contains("junction `centre` is of type `unregulated`"),
        "{}",
        findings(&file)
    );
    fs::write(&nodes, text.replace("\"right_before_left\"", "\"traffic_light\"")).unwrap();
    build(&file, true).unwrap();
    let found = findings(&file);
    assert!(found.contains("nothing keeps agents from passing red"), "{found}");
    let config = folder.path().join("sumo_nets/site/site.netccfg");
    let options = fs::read_to_string(&config).unwrap();
    let bare = "<no-turnarounds value=\"true\"/>\n        <no-internal-links value=\"true\"/>";
    fs::write(&config, options.replace("<no-turnarounds value=\"true\"/>", bare)).unwrap();
    build(&file, true).unwrap();
    assert!(
        findings(&file).contains("the net has no lanes over its junctions"),
        "{}",
        findings(&file)
    );
    fs::write(&config, "<configuration").unwrap();
    assert!(
        findings(&file).contains("is not a configuration of netconvert"),
        "{}",
        findings(&file)
    );
}

#[test]
fn a_trial_finds_vehicles_that_begin_in_each_other() {
    // Two lanes lie on the same ground, but SUMO and the reader take them for two roads.
    let folder = folder();
    let nodes = r#"<nodes><node id="a" x="0" y="0"/><node id="b" x="0" y="0.5"/><node id="c" x="100" y="0"/><node id="d" x="200" y="0"/></nodes>"#;
    let edges = r#"<edges><edge id="ac" from="a" to="c"/><edge id="bc" from="b" to="c"/><edge id="cd" from="c" to="d"/></edges>"#;
    fs::write(folder.path().join("x.nod.xml"), nodes).unwrap();
    fs::write(folder.path().join("x.edg.xml"), edges).unwrap();
    run("netconvert", &["-n", "x.nod.xml", "-e", "x.edg.xml", "-o", "x.net.xml"], folder.path())
        .unwrap();
    import(folder.path(), "twins", Map::Net(&folder.path().join("x.net.xml")), None, 4, false)
        .unwrap();
    let file = folder.path().join("scenarios/twins.xml");
    let scenario = Scenario::load(&file).unwrap();
    let most = scenario.agents.max;
    let trial = Trial::run(&scenario, most, 20, Seed::new(0), &Hosting::default()).unwrap();
    let found = trial.findings(&scenario);
    assert!(errors(&found)[0].message.contains("collide where they begin"), "{found:?}");
}

#[test]
fn a_trial_says_when_there_is_little_to_coordinate() {
    let folder = folder();
    let mut scenario =
        Scenario::load(&create(folder.path(), "site", Template::Cross, &SIZES).unwrap()).unwrap();
    // All vehicles begin in one row, go straight on and drive at one speed.
    scenario.nets[0].spawns.truncate(1);
    scenario.nets[0].spawns[0].routes = [0].into();
    let trial = Trial::run(&scenario, 2, 600, Seed::new(0), &Hosting::default()).unwrap();
    assert!(
        trial.flat_out[0] > 0 && trial.flat_out[0] == trial.flat_out[1],
        "{:?}",
        trial.flat_out
    );
    let found = trial.findings(&scenario);
    assert!(
        found.iter().any(|finding| finding.message.contains("there is little to coordinate")),
        "{found:?}"
    );
}

/// Background vehicles at spawn places drive the agents' routes, so that a type of another class must
/// be allowed there.
#[test]
fn types_at_spawn_places_are_judged_by_their_class() {
    let folder = folder();
    let traffic = |kind: &str| {
        let file = folder.path().join("scenarios/site.xml");
        let _ = fs::remove_file(&file);
        let _ = fs::remove_dir_all(folder.path().join("sumo_nets"));
        let traffic = format!(
            "<traffic penetration=\"0.5\" type=\"{kind}\" files=\"types.xml\"/>\n</scenario>"
        );
        changed(folder.path(), &[("</scenario>", &traffic)])
    };
    let types = "<routes><vType id=\"lorry\" vClass=\"truck\"/><vType id=\"tram\" vClass=\"tram\"/></routes>";
    fs::create_dir_all(folder.path().join("scenarios")).unwrap();
    fs::write(folder.path().join("scenarios/types.xml"), types).unwrap();
    let wrong = |file: &Path| {
        let list = Scenario::check(file).list;
        errors(&list).iter().map(ToString::to_string).collect::<Vec<_>>()
    };
    assert_eq!(wrong(&traffic("lorry")), Vec::<String>::new());
    let net = folder.path().join("sumo_nets/site/site.typ.xml");
    let file = traffic("lorry");
    let text = fs::read_to_string(&net).unwrap();
    fs::write(&net, text.replace("<type id=", "<type disallow=\"truck\" id=")).unwrap();
    build(&file, true).unwrap();
    let [error] = &wrong(&file)[..] else { panic!("{:?}", wrong(&file)) };
    assert!(error.contains("`lorry` is not a valid type of <traffic>"), "{error}");
}

/// SUMO ends at such junctions if it drives there, so that a check must not pass.
#[test]
fn zippers_of_three_lanes_are_named() {
    let folder = folder();
    let write = |name: &str, text: String| fs::write(folder.path().join(name), text).unwrap();
    let nodes = r#"<nodes><node id="a" x="0" y="0"/><node id="b" x="200" y="0" type="zipper"/><node id="c" x="400" y="0"/></nodes>"#;
    let found = |lanes: u32, traffic: &str| {
        let edges = format!(
            "<edges><edge id=\"ab\" from=\"a\" to=\"b\" numLanes=\"{lanes}\"/><edge id=\"bc\" from=\"b\" to=\"c\"/></edges>"
        );
        let link =
            |lane| format!("<connection from=\"ab\" to=\"bc\" fromLane=\"{lane}\" toLane=\"0\"/>");
        let links: String = (0..lanes).map(link).collect();
        write("z.nod.xml", nodes.into());
        write("z.edg.xml", edges);
        write("z.con.xml", format!("<connections>{links}</connections>"));
        let sources = ["-n", "z.nod.xml", "-e", "z.edg.xml", "-x", "z.con.xml", "-o", "z.net.xml"];
        run("netconvert", &sources, folder.path()).unwrap();
        let text = fs::read_to_string(root().join("scenarios/intersection.xml")).unwrap();
        let (head, rest) = text.split_once("<routes>").unwrap();
        let (_, tail) = rest.split_once("</nets>").unwrap();
        let head = head.split_once("<agents ").unwrap().0;
        let site = "<agents min=\"1\" max=\"4\" default=\"4\"/><routes><route id=\"r\" edges=\"ab bc\" arrivalPos=\"-20\"/></routes>\
                    <nets><net file=\"z.net.xml\"><spawn route=\"r\" first=\"20\" spacing=\"10\" count=\"4\"/></net></nets>";
        write(
            "z.xml",
            format!(
                "{head}{site}{}",
                tail.replace("</scenario>", &format!("{traffic}</scenario>"))
            ),
        );
        let list = Scenario::check(&folder.path().join("z.xml")).list;
        list.into_iter().filter(|finding| finding.kind == "zipper-junction").collect::<Vec<_>>()
    };
    assert_eq!(found(2, "").len(), 0);
    let [alone] = &found(3, "")[..] else { panic!("one finding") };
    assert!(alone.message.starts_with("the zipper junction `b` joins 3 lanes to one"), "{alone}");
    let [mixed] = &found(3, "<traffic penetration=\"0.5\"/>")[..] else { panic!("one finding") };
    assert_eq!([alone.severity, mixed.severity], [Severity::Warning, Severity::Error]);
}

/// On lanes that are three times as long for SUMO as on the ground, SUMO's gaps are shorter than
/// vehicles.
#[test]
fn lanes_longer_than_their_shapes_are_named() {
    let folder = folder();
    let file = create(folder.path(), "site", Template::Cross, &SIZES).unwrap();
    assert!(!findings(&file).contains("longer for SUMO"));
    let net = folder.path().join("sumo_nets/site/site.net.xml");
    let text = fs::read_to_string(&net).unwrap();
    let edge = text.split("<edge id=\"east_out\"").nth(1).unwrap().split("</edge>").next().unwrap();
    let length = edge.split("length=\"").nth(1).unwrap().split('"').next().unwrap();
    let long = edge.replace(&format!("length=\"{length}\""), "length=\"300\"");
    fs::write(&net, text.replace(edge, &long)).unwrap();
    let scenario = fs::read_to_string(&file).unwrap();
    fs::write(&file, scenario.replace("arrivalPos=\"-5\"", "arrivalPos=\"-30\"")).unwrap();
    let said = findings(&file);
    assert!(
        said.contains(
            "a lane of the routes is longer for SUMO than by shape, most of all `east_out_0`, 300 m"
        ),
        "{said}"
    );
}

#[test]
fn a_trial_without_agents_says_so() {
    let file = root().join("scenarios/flow_cross.xml").display().to_string();
    let said = text(&succeeds(&mut iwol(&["scenario", "check", &file, "--steps", "50"])).stdout);
    assert!(said.contains("no agent was on the road in 50 steps of the trial"), "{said}");
    assert!(!said.contains(" inf ") && !said.contains("never changed"), "{said}");
}
