//! Templates: what they create, how their nets are built, and that their tasks can be solved.

use std::collections::BTreeMap;
use std::fs;
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use iwol_sumo::driving::Policy;
use iwol_sumo::env::{Driver, Task, World};
use iwol_sumo::inspect::{Trial, page, picture};
use iwol_sumo::rng::Seed;
use iwol_sumo::scenario::author::{Error, Sizes, State, Template, build, create};
use iwol_sumo::scenario::{PlaceDeparture, Scenario, SpawnRow};
use iwol_sumo::sumo::net::Net;
use iwol_sumo::sumo::{Hosting, Snapshot, VehicleState};

use super::{SIZES, errors, findings, run};
use crate::support::{folder, play, root};

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

/// What helps policies on the shipped parking lot helps them on a new one.
#[test]
fn a_new_parking_lot_observes_steers_and_rewards_as_the_shipped_one() {
    let folder = folder();
    let new = create(folder.path(), "lot", Template::Parking, &SIZES).unwrap();
    let elements = |path: &std::path::Path| -> Vec<String> {
        let text = fs::read_to_string(path).unwrap();
        let kept =
            ["<observation groups", "<control mode", "<steering maxAngle", "<reward progress"];
        let line = |start| text.lines().map(str::trim).find(|line| line.starts_with(start));
        kept.map(|start| line(start).unwrap_or_else(|| panic!("no {start}")).to_owned()).to_vec()
    };
    assert_eq!(elements(&new), elements(&root().join("scenarios/parking_lot.xml")));
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
                scenario.nets[0].spawns = vec![SpawnRow {
                    routes: [0].into(),
                    first: place.pos,
                    spacing: 8.0,
                    count: 1,
                    departure: PlaceDeparture::default(),
                }];
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
        "--agents 0: allowed: 1 to 768"
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
            let [made, shipped] = [&net.net, &path].map(|file| fs::read_to_string(file).unwrap());
            // The shipped nets are of SUMO 1.15; later releases add attributes.
            if version(&made) == version(&shipped) {
                assert!(made == shipped, "{}", path.display());
            }
            let [made, shipped] = [&made, &shipped].map(|text| lanes(text));
            assert!(made.keys().eq(shipped.keys()), "{}: {made:?}", path.display());
            for (lane, [made, shipped]) in made.iter().map(|(id, at)| (id, [at, &shipped[id]])) {
                assert_eq!(made.len(), shipped.len(), "{}, {lane}", path.display());
                let far = made.iter().zip(shipped).find(|(a, b)| (*a - *b).abs() > 0.05);
                assert_eq!(far, None, "{}, {lane}", path.display());
            }
        }
    }
}

/// Returns the version of the format of a net.
fn version(net: &str) -> String {
    let xml = roxmltree::Document::parse(net).unwrap();
    xml.root_element().attribute("version").unwrap().to_owned()
}

/// Returns the length and the points of every lane of a net \[m\].
fn lanes(net: &str) -> BTreeMap<String, Vec<f64>> {
    let xml = roxmltree::Document::parse(net).unwrap();
    let lanes = xml.descendants().filter(|node| node.has_tag_name("lane"));
    let numbers = |lane: roxmltree::Node<'_, '_>| {
        let text = [lane.attribute("length").unwrap(), lane.attribute("shape").unwrap()].join(" ");
        text.split([' ', ',']).map(|number| number.parse().unwrap()).collect()
    };
    lanes.map(|lane| (lane.attribute("id").unwrap().to_owned(), numbers(lane))).collect()
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

#[test]
fn pictures_show_what_blocks_sight() {
    let scenario = Scenario::load(&root().join("scenarios/blind_crossing.xml")).unwrap();
    let task = Task::new(&scenario, scenario.agents.default).unwrap();
    let svg = picture(&task, &Net::load(task.map.net_file()).unwrap()).svg();
    assert_eq!(svg.matches("Z\" fill=\"#b9a78f\"").count(), 4, "a building at each corner");
    assert!(svg.contains("polygons that block sight<"), "{svg}");
}
