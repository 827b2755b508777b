//! Checks of scenario files and trials of their tasks.

use std::fs;
use std::path::{Path, PathBuf};

use iwol_sumo::inspect::Trial;
use iwol_sumo::rng::Seed;
use iwol_sumo::scenario::Scenario;
use iwol_sumo::scenario::author::{Map, Template, build, create};
use iwol_sumo::sumo::Hosting;

use super::{SIZES, errors, findings, import, run};
use crate::support::folder;

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

#[test]
fn a_check_warns_of_what_was_probably_not_meant() {
    let warned = |changes: &[(&str, &str)]| {
        let folder = folder();
        findings(&changed(folder.path(), changes))
    };
    insta::assert_snapshot!(warned(&[("horizon=\"500\"", "horizon=\"60\"")]), @r#"
    site.xml:117:18: error: route `north_left` takes 62 steps at the speed limit, but the horizon is 60 steps
      hint: set the horizon to 248 steps or more, because vehicles have to wait
    "#);
    insta::assert_snapshot!(warned(&[("horizon=\"500\"", "horizon=\"120\"")]), @r#"
    site.xml:117:18: warning: route `north_left` takes 62 steps at the speed limit, but the horizon is 120 steps
      hint: set the horizon to 248 steps or more, because vehicles have to wait
    "#);
    insta::assert_snapshot!(warned(&[("range=\"50\"", "range=\"500\"")]), @r#"
    site.xml:121:20: warning: all agents can communicate with each other: the range is 500 m, and the largest net is 122 m across
      hint: reduce the range if communication should depend on the distance between agents
    "#);
    insta::assert_snapshot!(warned(&[("range=\"50\"", "range=\"5\"")]), @r#"
    site.xml:121:20: warning: agents cannot communicate with the next agent in their row: the range is 5 m, the distance 8 m
      hint: increase the range, unless agents should not communicate
    "#);
    insta::assert_snapshot!(warned(&[("detectionRange=\"100\"", "detectionRange=\"6\"")]), @r#"
    site.xml:99:36: warning: at 13.889 m/s a vehicle needs 8 m to stop, but agents observe only 6 m
      hint: increase detectionRange, or reduce maxSpeed
    "#);
    insta::assert_snapshot!(warned(&[("conflictStreams=\"6\"", "conflictStreams=\"0\"")]), @r#"
    site.xml:99:18: warning: agents observe no vehicle that crosses their route
      hint: set one of neighbours (with groups `nearest`), conflictStreams (with groups `conflict`), encounters and lidarBeams to a number above 0
    "#);
    let encounters = ("conflictStreams=\"6\"", "conflictStreams=\"0\" encounters=\"4\"");
    assert!(!warned(&[encounters]).contains("observe no vehicle"), "encounters show them");
    insta::assert_snapshot!(warned(&[("maxSpeed=\"13.889\"", "maxSpeed=\"20\"")]), @r#"
    site.xml:59:43: warning: agents may drive 20 m/s, but the speed limit of lane `west_in_0` of ../sumo_nets/site/site.net.xml is 13.889 m/s
      hint: speed limits of lanes do not slow agents down; reduce maxSpeed if agents should keep the limit
    "#);
    insta::assert_snapshot!(warned(&[("crash=\"-10\"", "crash=\"10\"")]), @r#"
    site.xml:110:66: warning: the reward of a crash is not below the reward of an arrival
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
