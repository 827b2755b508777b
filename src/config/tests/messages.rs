//! Tests of what is said of mistakes in settings.

use super::*;

#[test]
fn mistakes_in_the_scenario_name_place_path_and_what_is_allowed() {
    let said = |sets: &[&str]| message("", sets).replace(env!("CARGO_MANIFEST_DIR"), ".");
    let near = |set: &str, meant: &str| {
        let text = said(&[set]);
        assert!(text.ends_with(&format!("; did you mean `{meant}`?")), "{text}");
    };
    near("scenario.observation.neighbors=2", "scenario.observation.neighbours");
    near("scenario.observaton.neighbours=2", "scenario.observation.neighbours");
    near("scenario.detectionRange=2", "scenario.observation.detectionRange");
    near("env.detection_range=2", "scenario.observation.detectionRange");
    near("observation.groups=both", "scenario.observation.groups");
    assert_eq!(
        message("[scenario.observaton]\nneighbours = 2\n", &[]),
        "c.toml:1:11: there is no setting `scenario.observaton`; did you mean `scenario.observation`?"
    );
    // The same message as for the value in the file.
    let in_file = |attribute: &str, from: &str, to: &str| {
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        let path = root.join("scenarios/intersection.xml");
        let text = std::fs::read_to_string(&path).unwrap();
        let changed =
            text.replacen(&format!("{attribute}=\"{from}\""), &format!("{attribute}=\"{to}\""), 1);
        assert_ne!(text, changed, "{attribute}");
        let said = Scenario::parse(&changed, &path).unwrap_err().to_string();
        said.split_once(": ").unwrap().1.to_owned()
    };
    for (element, attribute, from, to) in [
        ("observation", "neighbours", "4", "99"),
        ("observation", "neighbours", "4", "-1"),
        ("observation", "intention", "hidden", "hiden"),
        ("reward", "cooperation", "0.06", "2"),
        ("reward", "crash", "-10", "nan"),
        ("termination", "horizon", "1000", "0"),
        ("control", "interval", "0.1", "0.0004"),
    ] {
        let key = format!("scenario.{element}.{attribute}");
        let set = format!("{key}={to}");
        assert_eq!(
            said(&[&set]),
            format!("--set {set}: bad value for `{key}`: {}", in_file(attribute, from, to))
        );
    }
    assert_eq!(
        message("[scenario.communication]\nrange = -3\n", &[]),
        "c.toml:2:9: bad value for `scenario.communication.range`: `-3` is not a valid range of <communication>, \
         allowed: number of at least 0"
    );
    // What belongs to the file alone.
    for (set, why) in [
        ("traffic.files=a.xml", "of <traffic>, a run can override penetration, strict, capacity"),
        (
            "control.brake=0.5:3",
            "of <control>, a run can override interval, accel, drag, initialThrottle",
        ),
        (
            "control.mode=steering",
            "of <control>, a run can override interval, accel, drag, initialThrottle",
        ),
        ("routes.route.edges=a", "only the scenario's file can set lists, names and files"),
        ("nets.net.file=a", "only the scenario's file can set lists, names and files"),
        ("name=a", "only the scenario's file can set lists, names and files"),
        ("agents.max=9", "the number of agents is the setting `agents`"),
        ("control.steering.friction=1", "the scenario has no element <steering>"),
        ("observation=both", "this is a group of settings; set one of them"),
    ] {
        let text = said(&[&format!("scenario.{set}")]);
        assert!(text.starts_with(&format!("--set scenario.{set}: bad value")), "{text}");
        assert!(text.contains(why), "{text}");
    }
    assert!(
        message("[scenario.traffic]\nfiles = ['a']\n", &[]).starts_with("c.toml:2:1: bad value")
    );
    // Values that do not fit each other.
    assert_eq!(
        said(&["scenario.observation.signalDistance=20"]),
        "--set scenario.observation.signalDistance=20: bad value for `scenario.observation.signalDistance`: `20.0` is not a \
         valid signalDistance of <observation>, allowed: no value unless intention is `signalled`: otherwise no vehicle has an \
         indicator"
    );
    let signalled =
        ["scenario.observation.intention=signalled", "scenario.observation.signalDistance=20"];
    assert_eq!(number(&resolve("", &signalled).unwrap(), "observation", "signalDistance"), 20.0);
    // An error elsewhere in the file has the file's line and column, and names what led to it.
    let long = said(&["scenario.vehicle.length=30"]);
    assert!(long.starts_with("./scenarios/intersection.xml:"), "{long}");
    assert!(long.ends_with(" (with --set scenario.vehicle.length=30)"), "{long}");
    let longer = said(&["scenario.vehicle.length=30", "scenario.vehicle.width=2.25"]);
    assert_eq!(longer.split(' ').next(), long.split(' ').next());
}

#[test]
fn unknown_keys_are_named_in_every_group() {
    // The groups of the learner lie flat in the configuration; serde does not check their names.
    for (text, key) in
        [("stepz = 3", "stepz"), ("[pppo]\ngamma = 1", "pppo"), ("[ppo]\ngama = 1", "ppo.gama")]
    {
        assert!(message(text, &[]).contains(&format!("there is no setting `{key}`")), "{text}");
    }
}

#[test]
fn mistakes_name_place_key_and_neighbour() {
    assert_eq!(
        message("seed = 1\n\n[ppo]\n  gama = 0.9\n", &[]),
        "c.toml:4:3: there is no setting `ppo.gama`; did you mean `ppo.gamma`?"
    );
    assert_eq!(
        message("[ppo]\ngamma = 1.5\n", &[]),
        "c.toml:2:9: bad value for `ppo.gamma`: allowed: 0 to 1"
    );
    assert_eq!(
        message("[ppo]\ngamma = \"x\"\n", &[]),
        "c.toml:2:9: bad value for `ppo.gamma`: allowed: 0 to 1"
    );
    assert_eq!(
        message("ppo = 3\n", &[]),
        "c.toml:1:7: bad value for `ppo`: this is a group of settings; set one of them"
    );
    assert!(message("[ppo\n", &[]).starts_with("c.toml:1:"));
    assert!(message("", &["exploration.mode=soft"]).starts_with(
        "--set exploration.mode=soft: bad value for `exploration.mode`: unknown variant"
    ));
    assert_eq!(
        message("", &["gamma"]),
        "--set gamma: bad value for `gamma`: write it as key=value"
    );
    assert!(
        message("", &["gamma=1"]).contains("did you mean `ppo.gamma`?"),
        "{}",
        message("", &["gamma=1"])
    );
    assert_eq!(
        message("[iwol]\nmessage = 6\n", &[]),
        "c.toml:2:11: bad value for `iwol.message`: allowed: a multiple of 4, 4 to 4096"
    );
    assert!(message("", &["device=gpu"]).contains("write cpu, cuda or cuda:<number>"));
    assert!(message("", &["agents=49"]).contains("49"), "{}", message("", &["agents=49"]));
}

#[test]
fn a_value_of_another_type_is_refused_with_the_allowed_values() {
    for key in flatten(&resolve("", &[]).unwrap().to_toml().parse().unwrap()).keys() {
        let said = message(&format!("{key} = []\n"), &[]);
        let begin = format!("bad value for `{key}`: ");
        let allowed = ["allowed: ", "expected path string"].iter().any(|why| said.contains(why));
        assert!(said.contains(&begin) && allowed, "{said}");
    }
}

#[test]
fn without_a_scenario_an_unknown_key_is_named() {
    let message = |text: &str| {
        let name = "c.toml".to_owned();
        let document = Document { name, text: text.to_owned(), generated: false };
        let layers = Layers { document, ..Layers::default() };
        layers.resolve().expect_err("must be refused").to_string()
    };
    assert!(
        message("seed = 1\npreset = 'paper'\n[ppo]\ngamma = 1\n").starts_with("no scenario given")
    );
    assert_eq!(
        message("scenari = 'a.xml'\n"),
        "c.toml:1:1: there is no setting `scenari`; did you mean `scenario`?"
    );
    assert_eq!(
        message("[ppo]\ngama = 1\n"),
        "c.toml:2:1: there is no setting `ppo.gama`; did you mean `ppo.gamma`?"
    );
    assert_eq!(message("[po]\ngamma = 1\n"), "c.toml:1:2: there is no setting `po`");
    assert_eq!(
        message("scenario = 3\n"),
        "c.toml: bad value for `scenario`: 3 is no path of a scenario file"
    );
}
