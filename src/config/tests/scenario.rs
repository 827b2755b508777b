//! Tests of settings that are values of the scenario.

use super::*;

#[test]
fn a_setting_is_a_path_into_the_scenario() {
    let file = format!("{}/scenarios/parking_lot.xml", env!("CARGO_MANIFEST_DIR"));
    let short = format!("scenario = '{file}'\n[train]\nenvs = 3\n");
    let long = format!(
        "[train]\nenvs = 3\n[scenario]\nfile = '{file}'\nobservation.groups = 'both'\n\
         [scenario.control.steering]\nreverse = false\n[scenario.reward]\nshareRange = 30\n"
    );
    let of = |text: &str, sets: &[&str]| {
        let mut layers = layers_on("parking_lot", text, sets);
        layers.flags.clear();
        layers.resolve()
    };
    let whole = of(&short, &[]).unwrap();
    assert_eq!(whole.replaced, []);
    let changed = of(&long, &["scenario.observation.neighbours=2"]).unwrap();
    let (was, is) = (whole.place.scenario().unwrap(), changed.place.scenario().unwrap());
    assert_eq!(is.observation.neighbours, 2);
    assert_eq!((is.reward.share_range, was.reward.share_range), (30.0, f64::INFINITY));
    let reverses = |s: &Scenario| s.control.steering.unwrap().reverse;
    assert_eq!((reverses(is), reverses(was)), (false, true));
    assert_eq!(changed.replaced.len(), 4, "{:?}", changed.replaced);
    // A number without a limit is infinite, as if the attribute were missing.
    let again = of(&long, &["scenario.reward.shareRange=inf"]).unwrap();
    assert_eq!(again.place.scenario().unwrap().reward.share_range, f64::INFINITY);
    // An optional element whose absence means its defaults can be overridden too.
    let mixed = resolve("", &["scenario.traffic.penetration=0.5"]).unwrap();
    assert_eq!(number(&mixed, "traffic", "penetration"), 0.5);
    // The last one wins, in both forms.
    for sets in [
        ["scenario=no.xml", "scenario.file=none.xml"],
        ["scenario.file=no.xml", "scenario=none.xml"],
    ] {
        assert!(of(&short, &sets).unwrap_err().to_string().contains("none.xml"));
    }
}

/// A run of an earlier version lacks the attributes that scenarios have got since.
#[test]
fn settings_of_later_versions_count_as_their_defaults() {
    let said =
        |was: &str, is: &str| changes(was, is).iter().map(ToString::to_string).collect::<Vec<_>>();
    let was = "[scenario.control]\naccel = 2.0\n";
    let is = |lane_change: &str| format!("{was}laneChange = \"{lane_change}\"\n");
    assert!(said(was, &is("none")).is_empty(), "none is the default");
    assert_eq!(said(was, &is("route")), ["scenario.control.laneChange = route (was none)"]);
    let iwol = |more: &str| format!("[iwol]\nlatent = 32\n{more}");
    assert!(said(&iwol(""), &iwol("privileged_value = false\ngraph_bias = 0.0\n")).is_empty());
    let said = said(&iwol(""), &iwol("privileged_value = true\n"));
    assert_eq!(said, ["iwol.privileged_value = true (was false)"]);
}

#[test]
fn stored_settings_hold_the_task_when_the_file_changes() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scenarios/a.xml");
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    let text = std::fs::read_to_string(root.join("scenarios/intersection.xml")).unwrap();
    let nets = format!("{}/sumo_nets", root.display());
    let text = text.replace("../sumo_nets", &nets);
    std::fs::write(&path, &text).unwrap();
    let sets = ["scenario.communication.range=30".to_owned()];
    let layers = |text: String, sets: &[String]| Layers {
        document: Document::of_run("run".to_owned(), text),
        sets: sets.to_vec(),
        flags: vec![("scenario", path.display().to_string().into())],
        ..Layers::default()
    };
    let first = layers(String::new(), &sets).resolve().unwrap();
    let stored = first.config.to_toml();
    let changed = text.replace("horizon=\"1000\"", "horizon=\"90\"");
    assert_ne!(changed, text);
    std::fs::write(&path, &changed).unwrap();
    let later = layers(stored.clone(), &[]).resolve().unwrap();
    assert_eq!((later.place.scenario(), &later.config), (first.place.scenario(), &first.config));
    let replaced: Vec<String> = later.replaced.iter().map(ToString::to_string).collect();
    assert_eq!(
        replaced,
        [
            "scenario.termination.horizon = 1000 (was 90)",
            "scenario.communication.range = 30.0 (was 100.0)"
        ]
    );
    // The scenario of the run is a file of its own, which says the same.
    let run = folder.path().join("runs/a");
    std::fs::create_dir_all(&run).unwrap();
    let own = run.join("scenario.xml");
    std::fs::write(&own, first.place.scenario().unwrap().to_xml_in(&run).unwrap()).unwrap();
    let loaded = Scenario::load(&own).unwrap();
    let canonical = |net: &crate::scenario::Net| net.file.canonicalize().unwrap();
    assert_eq!(
        loaded.nets.iter().map(canonical).collect::<Vec<_>>(),
        first.place.scenario().unwrap().nets.iter().map(canonical).collect::<Vec<_>>()
    );
    let nets = first.place.scenario().unwrap().nets.clone();
    assert_eq!(
        Scenario { nets, path: first.place.scenario().unwrap().path.clone(), ..loaded },
        *first.place.scenario().unwrap()
    );
}
