//! User-defined scenarios: templates, builds, checks, pictures, imports, and the documentation of
//! the file format.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use iwol_sumo::env::{Driver, Task, World};
use iwol_sumo::evaluate::Policy;
use iwol_sumo::inspect::{Trial, page, picture};
use iwol_sumo::rng::Seed;
use iwol_sumo::scenario::author::{
    self, Choices, Error, Imported, Map, Sizes, State, Template, build, create,
};
use iwol_sumo::scenario::{self, Element, Finding, Scenario, Severity, SpawnRow};
use iwol_sumo::sumo::net::Net;
use iwol_sumo::sumo::{Hosting, Snapshot, VehicleState, find_program};

use crate::support::{folder, play, root};

const SIZES: Sizes =
    Sizes { lanes: None, arm_length: None, agents: 8, speed: 13.889, steering: false };

fn import(
    root: &Path,
    name: &str,
    map: Map,
    junction: Option<&str>,
    agents: u32,
    steering: bool,
) -> Result<Imported, Error> {
    let choices = Choices { junction, agents, steering, left_hand: false, whole_net: false };
    author::import(root, name, map, &choices)
}

/// Runs one of SUMO's programs; returns its error output if it fails.
pub fn run(program: &str, arguments: &[&str], folder: &Path) -> Result<(), String> {
    let program = find_program(program).unwrap();
    let output = Command::new(program).args(arguments).current_dir(folder).output().unwrap();
    if output.status.success() {
        Ok(())
    } else {
        Err(String::from_utf8_lossy(&output.stderr).into_owned())
    }
}

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

fn errors(list: &[Finding]) -> Vec<&Finding> {
    list.iter().filter(|finding| finding.severity == Severity::Error).collect()
}

/// Returns the findings of a check without the folder's name, one per line.
fn findings(file: &Path) -> String {
    let list = Scenario::check(file).list;
    let lines: Vec<String> = list.iter().map(ToString::to_string).collect();
    lines
        .join("\n")
        .replace(&format!("{}/scenarios/", file.parent().unwrap().parent().unwrap().display()), "")
}

#[test]
fn every_template_builds_checks_and_runs() {
    for template in Template::ALL {
        for (lanes, agents) in [(None, 8), (Some(2), 20)] {
            // A parking lot has one lane in each direction.
            let lanes = lanes.filter(|_| template != Template::Parking);
            let folder = folder();
            let sizes = Sizes { lanes, agents, ..SIZES };
            let file = create(folder.path(), "site", template, &sizes)
                .unwrap_or_else(|e| panic!("{template:?}: {e}"));
            let checked = Scenario::check(&file);
            assert!(checked.list.is_empty(), "{template:?} of {lanes:?} lanes: {:?}", checked.list);
            let scenario = checked.scenario.unwrap();
            assert_eq!(scenario.agents.default, agents);
            // Long enough for vehicles to overtake, if SUMO let them.
            let trial =
                Trial::run(&scenario, agents, 400, Seed::new(1), &Hosting::default()).unwrap();
            let found = trial.findings(&scenario);
            assert!(errors(&found).is_empty(), "{template:?} of {lanes:?} lanes: {found:?}");
            let range = trial.observation.iter().find(|range| range.name == "ego.speed").unwrap();
            assert!(range.least == 0.0 && range.most > 0.2, "vehicles drive: {range:?}");
            // SUMO alone accepts the files as they are.
            let sumo =
                ["-c", "site.sumocfg", "--end", "5", "--xml-validation", "never", "--no-step-log"];
            run("sumo", &sumo, &folder.path().join("sumo_nets/site"))
                .unwrap_or_else(|e| panic!("{template:?}: {e}"));
        }
    }
}

#[test]
fn no_template_is_solved_by_full_throttle_and_all_by_giving_way() {
    for template in Template::ALL {
        let folder = folder();
        let scenario =
            Scenario::load(&create(folder.path(), "site", template, &SIZES).unwrap()).unwrap();
        let task = Arc::new(Task::new(&scenario, 8).unwrap());
        let success = |task: &Arc<Task>, policy| {
            play(task, &policy, 8, Seed::new(0)).metrics().unwrap().success.mean
        };
        // `iwol scenario check` warns if full throttle does no harm in any episode.
        let trial = Trial::run(&scenario, 8, 600, Seed::new(0), &Hosting::default()).unwrap();
        let [played, unharmed] = trial.flat_out;
        assert!(
            played > unharmed,
            "{template:?}: {unharmed} of {played} episodes at full throttle go well"
        );
        let flat_out = success(&task, Policy::Throttle(1.0));
        assert!(flat_out < 0.8, "{template:?}: full throttle succeeds at {flat_out}");
        if template == Template::Parking {
            // SUMO's own driver does not see a vehicle that leaves a space while it drives on the
            // edge into the space. Pursuit by a single vehicle shows that all routes can be driven.
            let alone = success(
                &Arc::new(Task::new(&scenario, 1).unwrap()),
                Policy::by_name("pursuit:3").expect("a policy"),
            );
            let blind = success(&task, Policy::Sumo);
            assert!(alone == 1.0, "{template:?}: pursuit of one vehicle succeeds at {alone}");
            assert!(blind > 0.3, "{template:?}: SUMO's own driver succeeds at {blind}");
        } else {
            let sumo = success(&task, Policy::Sumo);
            assert!(sumo > 0.9, "{template:?}: SUMO's own driver succeeds at {sumo}");
        }
    }
}

#[test]
fn a_parking_lot_has_room_for_any_mix_of_vehicles() {
    for agents in [1, 5, 6, 60] {
        let folder = folder();
        let sizes = Sizes { agents, ..SIZES };
        let scenario =
            Scenario::load(&create(folder.path(), "lot", Template::Parking, &sizes).unwrap())
                .unwrap();
        let (outside, spaces): (Vec<&SpawnRow>, Vec<&SpawnRow>) =
            scenario.nets[0].spawns.iter().partition(|row| scenario.routes[row.routes[0]].reserved);
        assert_eq!(spaces.len(), agents.next_multiple_of(2).max(4) as usize);
        assert!(spaces.iter().all(|row| row.count == 1 && row.routes.len() == 2), "{spaces:?}");
        let from_outside: u32 = outside.iter().map(|row| row.count).sum();
        assert!(
            agents <= from_outside && from_outside as usize <= spaces.len(),
            "{agents}: {from_outside}"
        );
        assert!(outside.len() == 2 && outside.iter().all(|row| row.routes.len() == spaces.len()));
        assert_eq!((scenario.agents.min, scenario.agents.default), (1, agents));
        // SUMO alone shows each space as a parking area.
        let shown = |ending: &str| {
            fs::read_to_string(folder.path().join("sumo_nets/lot/lot").with_extension(ending))
        };
        assert_eq!(shown("add.xml").unwrap().matches("<parkingArea ").count(), spaces.len());
        assert!(shown("sumocfg").unwrap().contains("<additional-files value=\"lot.add.xml\"/>"));
    }
}

#[test]
fn on_a_parking_lot_pursuit_leads_from_every_place_to_every_destination() {
    for (agents, arm_length) in [(1, None), (9, Some(60.0))] {
        let folder = folder();
        let sizes = Sizes { agents, arm_length, ..SIZES };
        let whole =
            Scenario::load(&create(folder.path(), "lot", Template::Parking, &sizes).unwrap())
                .unwrap();
        for place in whole.nets[0].places() {
            for &route in &*place.routes {
                let mut scenario = whole.clone();
                scenario.routes = vec![whole.routes[route].clone()];
                scenario.nets[0].spawns =
                    vec![SpawnRow { routes: [0].into(), first: place.pos, spacing: 8.0, count: 1 }];
                let task = Arc::new(Task::new(&scenario, 1).unwrap());
                for speed in [2.0, 3.0, 4.0] {
                    let arrived = alone(&task, speed, 3);
                    let from = (place.pos, &whole.routes[route].id);
                    assert_eq!(
                        arrived, [1.0; 3],
                        "{agents} agents, from {} m on {} at {speed} m/s",
                        from.0, from.1
                    );
                }
            }
        }
    }
}

/// Returns the success of a single vehicle that pursues its route at `speed` \[m/s\], for each of
/// `episodes` episodes. No simulator is needed, because the world moves vehicles that steer.
fn alone(task: &Arc<Task>, speed: f64, episodes: u64) -> Vec<f64> {
    let there = Snapshot {
        vehicles: vec![Some(VehicleState { distance: 0.0, speed: 0.0 })],
        ..Snapshot::default()
    };
    let mut world = World::new(Arc::clone(task), Driver::Agents, Seed::new(0), 0, 1, episodes);
    let mut success = Vec::new();
    world.reset(0);
    while !world.is_idle() {
        let actions = world.pursuit(0, speed).map(|action| action as f32);
        world.act(0, &actions, &mut Vec::new());
        world.observe(0, &there).unwrap();
        success.extend(world.take_finished().map(|record| record.success));
    }
    success
}

#[test]
fn where_vehicles_steer_pursuit_leads_along_every_route_of_every_template() {
    for template in Template::ALL.into_iter().filter(|template| *template != Template::Parking) {
        let folder = folder();
        let file =
            create(folder.path(), "site", template, &Sizes { steering: true, ..SIZES }).unwrap();
        let checked = Scenario::check(&file);
        assert!(checked.list.is_empty(), "{template:?}: {:?}", checked.list);
        let task = Arc::new(Task::new(&checked.scenario.unwrap(), 1).unwrap());
        assert_eq!((task.spec.actions.len(), task.spec.agents), (2, 1));
        assert_eq!(alone(&task, 6.0, 40), [1.0; 40], "{template:?}: at the speed that is imitated");
    }
}

#[test]
fn sizes_that_do_not_go_together_are_refused_and_nothing_is_left() {
    let folder = folder();
    let refused =
        |template, sizes| create(folder.path(), "site", template, &sizes).unwrap_err().to_string();
    assert_eq!(
        refused(Template::Cross, Sizes { lanes: Some(5), ..SIZES }),
        "--lanes 5: allowed: 1 to 4 for `cross`"
    );
    assert_eq!(
        refused(Template::Bottleneck, Sizes { lanes: Some(1), ..SIZES }),
        "--lanes 1: allowed: 2 to 4 for `bottleneck`"
    );
    assert_eq!(
        refused(Template::Tee, Sizes { agents: 30, arm_length: Some(40.0), ..SIZES }),
        "--arm-length 40: allowed: 90 to 5000 m for 30 agents on 3 lanes"
    );
    assert_eq!(
        refused(Template::Cross, Sizes { agents: 0, ..SIZES }),
        "--agents 0: allowed: 1 to 200"
    );
    assert_eq!(
        refused(Template::Parking, Sizes { lanes: Some(2), ..SIZES }),
        "--lanes 2: allowed: 1 for `parking`"
    );
    assert_eq!(
        refused(Template::Parking, Sizes { agents: 61, ..SIZES }),
        "--agents 61: allowed: 1 to 60 for `parking`"
    );
    assert_eq!(
        refused(Template::Parking, Sizes { speed: 30.0, ..SIZES }),
        "--speed 30: allowed: 1 to 22.222 m/s for `parking`"
    );
    assert_eq!(
        refused(Template::Parking, Sizes { arm_length: Some(41.0), ..SIZES }),
        "--arm-length 41: allowed: 42 to 5000 m for 8 agents on 2 lanes"
    );
    assert!(
        refused(Template::Cross, Sizes { speed: f64::NAN, ..SIZES }).starts_with("--speed NaN")
    );
    for name in ["", "../x", "a b"] {
        assert!(
            matches!(create(folder.path(), name, Template::Cross, &SIZES), Err(Error::Name { .. })),
            "{name}"
        );
    }
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    create(folder.path(), "fast", Template::Cross, &Sizes { speed: 70.0, ..SIZES }).unwrap();
    create(folder.path(), "alone", Template::Cross, &Sizes { agents: 1, ..SIZES }).unwrap();
    create(folder.path(), "site", Template::Cross, &SIZES).unwrap();
    let again = create(folder.path(), "site", Template::Tee, &SIZES).unwrap_err();
    assert!(matches!(again, Error::Exists { .. }), "{again}");
}

#[test]
fn a_changed_source_is_built_and_a_wrong_one_leaves_the_net_alone() {
    let folder = folder();
    let file = create(folder.path(), "site", Template::Cross, &SIZES).unwrap();
    let source = folder.path().join("sumo_nets/site/site.typ.xml");
    let change = |from: &str, to: &str, seconds| {
        let text = fs::read_to_string(&source).unwrap();
        assert!(text.contains(from), "{text}");
        fs::write(&source, text.replace(from, to)).unwrap();
        let later = SystemTime::now() + Duration::from_secs(seconds);
        fs::File::options().append(true).open(&source).unwrap().set_modified(later).unwrap();
    };
    let text = fs::read_to_string(&file).unwrap();
    fs::write(&file, text.replacen("first=\"4\"", "first=\"5\"", 1)).unwrap();
    let net = build(&file, false).unwrap().remove(0);
    assert_eq!(net.before, State::UpToDate);
    let shown = fs::read_to_string(folder.path().join("sumo_nets/site/site.rou.xml")).unwrap();
    assert!(
        shown.contains("departPos=\"7.2575\""),
        "what SUMO shows follows the scenario: {shown}"
    );
    let before = fs::read(&net.net).unwrap();
    assert_eq!(build(&file, true).unwrap()[0].before, State::UpToDate);
    assert_eq!(fs::read(&net.net).unwrap(), before, "the same sources give the same bytes");

    change("speed=\"13.889\"", "speed=\"9\"", 5);
    assert!(findings(&file).contains("is older than its sources"), "{}", findings(&file));
    assert_eq!(build(&file, false).unwrap()[0].before, State::OutOfDate);
    assert!(Net::load(&net.net).unwrap().roads().count() == 8);
    let slow = fs::read_to_string(&net.net).unwrap();
    assert!(slow.contains("speed=\"9.000\""));

    change("speed=\"9\"", "speed=\"fast\"", 10);
    let error = build(&file, false).unwrap_err().to_string();
    assert!(error.contains("netconvert cannot build") && error.contains("fast"), "{error}");
    assert_eq!(fs::read_to_string(&net.net).unwrap(), slow);
    let files = fs::read_dir(folder.path().join("sumo_nets/site")).unwrap().count();
    assert_eq!(files, 8, "no temporary file is left");
}

#[test]
fn the_shipped_nets_are_what_their_sources_give() {
    let folder = folder();
    for name in ["intersection", "intersection_turns"] {
        let (from, to) =
            (root().join("sumo_nets").join(name), folder.path().join("sumo_nets").join(name));
        fs::create_dir_all(&to).unwrap();
        for entry in fs::read_dir(&from).unwrap().map(|entry| entry.unwrap().path()) {
            fs::copy(&entry, to.join(entry.file_name().unwrap())).unwrap();
        }
    }
    let scenarios = folder.path().join("scenarios");
    fs::create_dir(&scenarios).unwrap();
    for name in ["intersection.xml", "intersection_turns.xml", "intersection_turns_small.xml"] {
        fs::copy(root().join("scenarios").join(name), scenarios.join(name)).unwrap();
        for net in build(&scenarios.join(name), true).unwrap() {
            assert_ne!(net.before, State::NoSources, "{}", net.net.display());
            let path = root()
                .join("sumo_nets")
                .join(net.net.strip_prefix(scenarios.join("../sumo_nets")).unwrap());
            assert!(fs::read(&net.net).unwrap() == fs::read(&path).unwrap(), "{}", path.display());
        }
    }
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
    site.xml:22:35: error: the route `west_straight` cannot be driven: ../sumo_nets/site/site.net.xml: the net has no edge `east_ou`; did you mean `east_out`?
    site.xml:25:36: error: the route `south_straight` cannot be driven: ../sumo_nets/site/site.net.xml: the edge `south_in` does not lead to `south_out`
    "#);
}

#[test]
fn a_check_warns_of_what_was_probably_not_meant() {
    let warned = |changes: &[(&str, &str)]| {
        let folder = folder();
        findings(&changed(folder.path(), changes))
    };
    insta::assert_snapshot!(warned(&[("horizon=\"500\"", "horizon=\"60\"")]), @r#"
    site.xml:113:18: error: route `north_left` takes 62 steps at the speed limit, but the horizon is 60 steps
      hint: set the horizon to 248 steps or more, because vehicles have to wait
    "#);
    insta::assert_snapshot!(warned(&[("horizon=\"500\"", "horizon=\"120\"")]), @r#"
    site.xml:113:18: warning: route `north_left` takes 62 steps at the speed limit, but the horizon is 120 steps
      hint: set the horizon to 248 steps or more, because vehicles have to wait
    "#);
    insta::assert_snapshot!(warned(&[("range=\"50\"", "range=\"500\"")]), @r#"
    site.xml:117:20: warning: all agents can communicate with each other: the range is 500 m, and the largest net is 122 m across
      hint: reduce the range if communication should depend on the distance between agents
    "#);
    insta::assert_snapshot!(warned(&[("range=\"50\"", "range=\"5\"")]), @r#"
    site.xml:117:20: warning: agents cannot communicate with the next agent in their row: the range is 5 m, the distance 8 m
      hint: increase the range, unless agents should not communicate
    "#);
    insta::assert_snapshot!(warned(&[("detectionRange=\"100\"", "detectionRange=\"6\"")]), @r#"
    site.xml:96:36: warning: at 13.889 m/s a vehicle needs 8 m to stop, but agents observe only 6 m
      hint: increase detectionRange, or reduce maxSpeed
    "#);
    insta::assert_snapshot!(warned(&[("conflictStreams=\"6\"", "conflictStreams=\"0\"")]), @r#"
    site.xml:96:18: warning: agents observe no vehicle that crosses their route
      hint: set one of neighbours (with groups `nearest`), conflictStreams (with groups `conflict`), encounters and lidarBeams to a number above 0
    "#);
    let encounters = ("conflictStreams=\"6\"", "conflictStreams=\"0\" encounters=\"4\"");
    assert!(!warned(&[encounters]).contains("observe no vehicle"), "encounters show them");
    insta::assert_snapshot!(warned(&[("maxSpeed=\"13.889\"", "maxSpeed=\"20\"")]), @r#"
    site.xml:57:43: warning: agents may drive 20 m/s, but the speed limit of lane `west_in_0` of ../sumo_nets/site/site.net.xml is 13.889 m/s
      hint: speed limits of lanes do not slow agents down; reduce maxSpeed if agents should keep the limit
    "#);
    insta::assert_snapshot!(warned(&[("crash=\"-10\"", "crash=\"10\"")]), @r#"
    site.xml:106:66: warning: the reward of a crash is not below the reward of an arrival
      hint: scenarios/intersection.xml has weights with which agents learn
    "#);
    insta::assert_snapshot!(warned(&[("route=\"west_straight west_left west_right\"", "route=\"west_straight west_left\"")]), @r#"
    site.xml:24:16: warning: no spawn place uses the route `west_right`
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
    assert!(findings(&file).contains("junction `centre` has signals"), "{}", findings(&file));
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
fn pictures_show_net_places_and_meeting_points() {
    let folder = folder();
    let scenario =
        Scenario::load(&create(folder.path(), "site", Template::Tee, &SIZES).unwrap()).unwrap();
    let task = Task::new(&scenario, 6).unwrap();
    let net = Net::load(task.map.net_file()).unwrap();
    let drawn = picture(&task, &net);
    let svg = drawn.svg();
    let document = roxmltree::Document::parse(&svg).unwrap();
    let count = |color: &str| {
        document.descendants().filter(|node| node.attribute("fill") == Some(color)).count()
    };
    assert_eq!(count("#3c3c3c"), task.places.len(), "places");
    // The streams of a T-junction cross in three points and merge in three.
    assert!((3..=9).contains(&count("#d55e00")), "{} meeting points", count("#d55e00"));
    assert!(svg.contains("site: 9 places, 6 routes"), "{svg}");
    drawn.png(&folder.path().join("site.png")).unwrap();
    assert!(fs::metadata(folder.path().join("site.png")).unwrap().len() > 5000);
    let html = page(&task, &net);
    assert!(
        html.contains("<svg") && html.contains("west_straight") && html.contains("at "),
        "{html}"
    );
}

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
    assert!(error.to_string().contains("the net has no junction `Z9`"), "{error}");
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

#[test]
fn the_page_on_scenario_files_is_what_the_schema_says() {
    let page = fs::read_to_string(root().join("docs/reference/scenario.md")).unwrap();
    assert!(
        page == scenario::markdown(),
        "out of date: run `iwol scenario reference > docs/reference/scenario.md`"
    );
    for element in scenario::describe().all() {
        assert!(!element.text.is_empty(), "<{}> is not explained", element.name);
        for attribute in &element.attributes {
            assert!(
                !attribute.text.is_empty(),
                "{} of <{}> is not explained",
                attribute.name,
                element.name
            );
        }
    }
}

/// Returns the names of attributes and elements that the reader's error messages list as valid, by
/// parent element.
fn accepted(text: &str) -> BTreeMap<String, BTreeSet<String>> {
    let mut accepted = BTreeMap::<String, BTreeSet<String>>::new();
    let document = roxmltree::Document::parse(text).unwrap();
    for node in document.descendants().filter(roxmltree::Node::is_element) {
        let name = node.tag_name().name();
        let at = node.range().start + 1 + name.len();
        for extra in [" zzz=\"1\"", "><zzz/></"] {
            let damaged = if extra.starts_with(' ') {
                format!("{}{extra}{}", &text[..at], &text[at..])
            } else {
                // The new child goes into the element, whether the element is empty or not.
                let open = at + text[at..].find('>').unwrap();
                match text[..open].strip_suffix('/') {
                    Some(start) => format!("{start}><zzz/></{name}{}", &text[open..]),
                    None => format!("{}<zzz/>{}", &text[..=open], &text[open + 1..]),
                }
            };
            let error = Scenario::parse(&damaged, Path::new("x.xml")).unwrap_err();
            let iwol_sumo::scenario::Error::Unknown { valid, key, .. } = error else {
                panic!("{name}: {error}")
            };
            assert_eq!(key, "zzz");
            accepted
                .entry(name.to_owned())
                .or_default()
                .extend(valid.iter().map(ToString::to_string));
        }
    }
    accepted
}

#[test]
fn all_that_the_reader_accepts_is_documented_and_nothing_else() {
    let text = fs::read_to_string(root().join("scenarios/intersection_turns_small.xml")).unwrap();
    let accepted =
        accepted(&text.replace("</scenario>", "<traffic penetration=\"0.5\"/></scenario>"));
    let describe = |element: &Element| {
        let attributes = element.attributes.iter().map(|attribute| attribute.name.clone());
        (
            element.name.clone(),
            attributes.chain(element.children.iter().map(|child| child.name.clone())).collect(),
        )
    };
    let documented: BTreeMap<String, BTreeSet<String>> =
        scenario::describe().all().into_iter().map(describe).collect();
    assert_eq!(accepted, documented);
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
