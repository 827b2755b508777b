//! Tests of layers, defaults, ranges and messages.

use std::path::Path;

use toml::Value;

use super::{
    Config, Document, Error, Layers, Origin, PRESETS, Profile, Resolution, Train, changes, flatten,
};
use crate::algo::settings::Ppo;
use crate::algo::{ComputeDevice, settings};
use crate::scenario::Scenario;

fn resolve(text: &str, sets: &[&str]) -> Result<Config, Error> {
    resolve_on("intersection", text, sets)
}

fn resolve_on(scenario: &str, text: &str, sets: &[&str]) -> Result<Config, Error> {
    Config::resolve(&layers_on(scenario, text, sets)).map(|(config, _)| config)
}

fn layers_on(scenario: &str, text: &str, sets: &[&str]) -> Layers {
    let scenario = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("scenarios/{scenario}.xml"));
    Layers {
        document: Document { name: "c.toml".to_owned(), text: text.to_owned(), generated: false },
        sets: sets.iter().map(|s| (*s).to_owned()).collect(),
        flags: vec![("scenario", Value::String(scenario.display().to_string()))],
        ..Layers::default()
    }
}

fn message(text: &str, sets: &[&str]) -> String {
    resolve(text, sets).expect_err("must be refused").to_string()
}

fn number(config: &Config, element: &str, attribute: &str) -> f64 {
    let value = config.scenario.value(element, attribute).expect("the scenario has it");
    value.as_float().unwrap_or_else(|| value.as_integer().expect("a number") as f64)
}

#[test]
fn the_reference_is_up_to_date() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/reference/settings.md");
    let page = std::fs::read_to_string(path).expect("the page");
    assert!(
        page == Config::reference(),
        "out of date: run `iwol config --reference > docs/reference/settings.md`"
    );
}

#[test]
fn later_layers_win() {
    let config = resolve(
        "seed = 3\n[ppo]\ngamma = 0.5\nepochs = 2\n",
        &["ppo.gamma=1", "network.encoder=mlp"],
    )
    .unwrap();
    assert_eq!((config.seed, config.learner.ppo.gamma, config.learner.ppo.epochs), (3, 1.0, 2));
    assert_eq!(config.learner.network.encoder, settings::EncoderKind::Mlp);
}

#[test]
fn lengths_follow_the_number_of_agents() {
    let at = |agents: u32| {
        let config = resolve(&format!("agents = {agents}"), &[]).unwrap();
        for set in [format!("agents={agents}"), format!(" agents = {agents:#x} ")] {
            assert_eq!(config, resolve("agents = 7", &[&set]).unwrap());
        }
        config
    };
    let samples = |c: &Config| c.train.envs * c.agents as usize;
    let (four, eight, most) = (at(4), at(8), at(48));
    assert_eq!((eight.train.clone(), eight.steps), (Train::default(), 1_200_000));
    assert_eq!((samples(&four), four.steps), (2 * samples(&eight), eight.steps));
    assert!([&four, &most].iter().all(|c| c.learner.ppo.minibatch == eight.learner.ppo.minibatch));
    let replays = resolve("agents = 8", &["algorithm=maddpg"]).unwrap();
    assert_eq!(2 * replays.learner.ppo.minibatch, eight.learner.ppo.minibatch);
    assert_eq!(
        (2 * most.train.anneal_steps, 2 * at(16).train.anneal_steps),
        (eight.train.anneal_steps, eight.train.anneal_steps)
    );
    assert_eq!(most.learner.exploration.explore_steps, eight.learner.exploration.explore_steps);
    assert_eq!(most.train.validation_episodes, 16);
    assert_eq!(at(16).train.envs, eight.train.envs);
    // Defaults do not replace values that are given.
    assert_eq!(resolve("agents = 48\nsteps = 5", &["train.envs=3"]).unwrap().train.envs, 3);
    // These settings are the same for every number of agents.
    let searched = |c: &Config| {
        (c.train.repeat_failed, c.train.anneal_success, c.train.stop_success, c.learner.ppo.gamma)
    };
    assert_eq!([&four, &eight, &most].map(searched), [(0.5, 0.95, 0.995, 0.9925); 3]);
    assert_eq!(four.train.validation_episodes, 128);
    let shared = |name: &str| {
        number(&resolve(&format!("algorithm = '{name}'"), &[]).unwrap(), "reward", "cooperation")
    };
    assert_eq!(
        ["mappo", "icp-dec", "icp-sum", "icp-monotonic"].map(shared),
        [0.06, 0.06, 0.0, 0.0]
    );
}

#[test]
fn vehicles_that_steer_have_defaults_of_their_own() {
    let five = resolve_on("parking_lot", "", &[]).unwrap();
    assert_eq!((five.learner.exploration.correlation, five.train.envs), (0.95, 25));
    assert_eq!(five.steps, 2_400_000 * 8 / 5);
    let view = |c: &Config| c.learner.ppo.gamma;
    assert_eq!((view(&five), view(&resolve("", &[]).unwrap())), (0.998, 0.9925));
    assert_eq!(
        view(&resolve_on("parking_lot", "", &["algorithm=maddpg"]).unwrap()),
        view(&five),
        "one task for all"
    );
    assert_eq!((five.train.repeat_failed, five.train.anneal_success), (0.5, 0.95));
}

#[test]
fn a_trained_policy_begins_with_less_noise() {
    let start = |sets: &[&str]| resolve("", sets).unwrap().learner.exploration.log_std_start;
    let noise = settings::Exploration::default();
    assert_eq!((start(&[]), start(&["init_from="])), (noise.log_std_start, noise.log_std_start));
    assert_eq!(start(&["init_from=runs/any"]), -1.0);
    assert_eq!(start(&["init_from=runs/any", "exploration.log_std_start=-0.5"]), -0.5);
}

#[test]
fn the_resolved_configuration_is_a_configuration() {
    // Some settings are valid only together, and the order in which they are read must not
    // matter.
    for sets in [
        ["scenario.reward.cooperation=0.25", "train.envs=3"],
        ["train.rollout_steps=600", "network.chunk_length=200"],
    ] {
        let config = resolve("", &sets).unwrap();
        assert_eq!(resolve(&config.to_toml(), &[]).unwrap(), config);
    }
}

/// A preset with numbers of scenarios serves environments without one.
#[test]
fn presets_serve_environments() {
    let layers = Layers {
        flags: [("environment", "navigation"), ("preset", "paper")]
            .map(|(key, value)| (key, Value::String(value.to_owned())))
            .to_vec(),
        ..Layers::default()
    };
    let Resolution { config, .. } = layers.resolve().expect("valid settings");
    assert_eq!((config.environment.as_str(), config.train.rollout_steps), ("navigation", 1000));
}

/// A number that is none has a place, as any other that is not allowed.
#[test]
fn what_is_not_a_number_is_refused_with_its_place() {
    let said = message("", &["ppo.gamma=nan"]);
    assert!(said.contains("--set ppo.gamma") && said.contains("allowed: 0 to 1"), "{said}");
}

/// What would be left out, or would have no effect, is refused.
#[test]
fn settings_that_do_not_go_together_are_refused() {
    let said = |sets: &[&str]| resolve("", sets).err().map(|e| e.to_string()).unwrap_or_default();
    let memory = "network.encoder=gru";
    assert_eq!(said(&[memory, "network.chunk_length=64"]), "");
    let rest = said(&[memory, "network.chunk_length=65"]);
    assert!(rest.contains("a divisor of it"), "{rest}");
    let shared = |algorithm: &str| {
        said(&[&format!("algorithm={algorithm}"), "scenario.reward.cooperation=0.5"])
    };
    assert_eq!((shared("mappo"), shared("maddpg")), (String::new(), String::new()));
    assert!(shared("icp-sum").contains("return of the whole team"), "{}", shared("icp-sum"));
    assert_eq!(said(&["algorithm=icp-sum"]), "");
}

#[test]
fn every_setting_is_documented_and_every_default_allowed() {
    let config = resolve("", &[]).unwrap();
    let page = Config::reference();
    let all = flatten(&config.to_toml().parse().unwrap());
    for key in all.keys() {
        if let Some(path) = key.strip_prefix("scenario.").filter(|path| *path != "file") {
            let (group, name) = path.rsplit_once('.').unwrap();
            let row = page.lines().find(|l| l.starts_with(&format!("| `scenario.{group}` | ")));
            assert!(row.is_some_and(|row| row.contains(&format!("`{name}`"))), "{key}");
            continue;
        }
        let key = if key == "scenario.file" { "scenario" } else { key };
        let row = page.lines().find(|line| line.starts_with(&format!("| `{key}` | ")));
        let row = row.unwrap_or_else(|| panic!("{key} is not on the page"));
        assert!(row.matches(" | ").count() == 4 && !row.ends_with("|  |"), "{row}");
    }
    assert!(page.contains("| `ppo.gae_lambda` |  | 0 to 1 | `0.95` |"));
    assert!(
        page.contains("| `exploration.correlation` |  | 0 to below 1 | `0.0`; steering `0.95` |")
    );
    assert!(page.contains("| `scenario` |  | text | required |"));
    assert!(page.contains("| `network.encoder` |  | `attention`, `gru`, `mlp` | `mlp` |"));
    let schema = Config::schema();
    assert_eq!(schema["$defs"]["Ppo"]["properties"]["gamma"]["maximum"], 1.0);
    assert_eq!(schema.pointer("/properties/preset/enum/1").unwrap(), "paper");
    assert!(schema.get("required").is_none());
    assert_eq!(schema["additionalProperties"], false);
    let observation = &schema["properties"]["scenario"]["anyOf"][1]["properties"]["observation"];
    let neighbours = &observation["properties"]["neighbours"];
    assert_eq!((&neighbours["type"], &neighbours["maximum"]), (&"integer".into(), &16.0.into()));
    assert_eq!(observation["properties"]["intention"]["enum"][1], "signalled");
}

#[test]
fn presets_lie_between_defaults_and_files() {
    let of = |text: &str, sets: &[&str]| resolve(text, sets).unwrap();
    let paper = of("preset = 'paper'\n", &[]);
    assert_eq!((paper.train.rollout_steps, number(&paper, "reward", "cooperation")), (1000, 0.0));
    assert_eq!(of("", &["preset=paper"]), paper);
    assert_eq!(of("train.rollout_steps = 10\n", &["preset=paper"]).train.rollout_steps, 10);
    assert_eq!(
        message("preset = 'papr'\n", &[]),
        "c.toml:1:10: bad value for `preset`: there is no preset `papr` (available: steering, paper, messages, traffic_junction); did you mean `paper`?"
    );
    for preset in &PRESETS {
        // As a file, every key is checked.
        assert!(resolve(preset.text, &["ppo.shards=1"]).is_ok(), "{}", preset.name);
    }
}

#[test]
fn profiles_give_sizes_below_presets_and_files() {
    let of = |text: &str, sets: &[&str]| resolve(text, sets).unwrap();
    let sizes = |c: &Config| (c.train.envs, c.learner.ppo.minibatch, c.learner.ppo.shards);
    let rate = |c: &Config| c.learner.ppo.learning_rate;
    let laptop = of("", &[]);
    assert_eq!(of("profile = 'laptop'", &[]), laptop, "the same on every machine");
    let (envs, minibatch, _) = sizes(&laptop);
    let station = of("profile = 'workstation'", &[]);
    assert_eq!(sizes(&station), (envs, minibatch, 8));
    assert_eq!(rate(&station), rate(&laptop));
    let gpu = of("", &["profile=gpu"]);
    assert_eq!((sizes(&gpu), gpu.device), ((4 * envs, 4 * minibatch, 1), ComputeDevice::Cuda(0)));
    assert_eq!(4 * gpu.train.rollout_steps, laptop.train.rollout_steps);
    assert_eq!(rate(&gpu), 2.0 * rate(&laptop));
    let given = "profile = 'workstation'\ntrain.envs = 3\nppo.shards = 5\nppo.minibatch = 300";
    assert_eq!(sizes(&of(given, &[])), (3, 300, 5));
    // A preset is for a purpose, whatever the machine; parts of its minibatches are not too small.
    let paper = of("profile = 'workstation'\npreset = 'paper'", &["ppo.minibatch=1300"]);
    assert_eq!(sizes(&paper), (16, 1300, 5));
    let learns = |c: &Config| (c.train.clone(), Ppo { shards: 1, ..c.learner.ppo.clone() });
    for preset in &PRESETS {
        let on = |profile: &str| of("", &[&format!("preset={}", preset.name), profile]);
        assert_eq!(learns(&on("profile=gpu")), learns(&on("profile=laptop")), "{}", preset.name);
    }
    assert_eq!(of("", &["ppo.minibatch=100"]).learner.ppo.shards, 1);
    // The machine counts only where no layer names a profile.
    let mut layers = layers_on("intersection", "", &[]);
    layers.profile = Profile::named("workstation");
    let resolved = layers.resolve().unwrap();
    assert_eq!(resolved.config, station);
    assert_eq!(resolved.origins["ppo.shards"].to_string(), "profile workstation");
    assert!(resolved.explained().starts_with("# profile workstation (for 8 cores or more)\n"));
    layers.sets.push("profile=laptop".to_owned());
    assert_eq!(Config::resolve(&layers).unwrap().0, laptop);
    // What is stored has the sizes, and no profile changes them.
    layers.sets = vec!["profile=gpu".to_owned()];
    layers.document = Document::of_run("run".to_owned(), station.to_toml());
    assert_eq!(Config::resolve(&layers).unwrap().0, station);
    assert_eq!(
        message("profile = 'auto'\n", &[]),
        "c.toml:1:11: bad value for `profile`: there is no profile `auto` (available: laptop, workstation, gpu)"
    );
}

#[test]
fn each_value_has_an_origin() {
    let sets = ["algorithm=maddpg", "init_from=runs/any", "train.envs=3"];
    let resolved = layers_on("parking_lot", "seed = 4\n", &sets).resolve().unwrap();
    let origin = |key: &str| resolved.origins[key].to_string();
    assert_eq!(origin("ppo.gae_lambda"), "default");
    assert_eq!(origin("ppo.gamma"), "preset steering");
    assert_eq!(origin("train.anneal_steps"), "default for this number of agents");
    assert_eq!(origin("ppo.minibatch"), "default for this method");
    assert_eq!(origin("exploration.log_std_start"), "default for this init_from");
    assert_eq!(origin("scenario.termination.horizon"), "scenario");
    assert_eq!(origin("seed"), "c.toml:1:8");
    assert_eq!(resolved.origins["train.envs"], Origin::Given("--set train.envs=3".to_owned()));
    let explained = resolved.explained();
    assert!(
        explained
            .lines()
            .any(|line| line == "seed = 4                                     # c.toml:1:8")
    );
    assert!(explained.contains("[maddpg]") && !explained.contains("[magic]"));
    // What is printed is a configuration.
    let again = resolve_on("parking_lot", &explained, &[]).unwrap();
    assert_eq!((again.train, again.scenario), (resolved.config.train, resolved.config.scenario));
    // On another scenario, too, it says what does not fit.
    assert!(message(&explained, &[]).ends_with("the scenario has no element <steering>"));
}

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
}
