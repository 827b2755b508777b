//! Tests of settings: layers, defaults and ranges.

mod messages;
mod scenario;

use std::collections::BTreeSet;
use std::path::Path;

use toml::Value;

use super::{
    Config, Document, Error, Layers, Origin, PRESETS, PROFILES, Profile, Resolution, Train,
    changes, flatten, overruled,
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
    assert_eq!((view(&five), view(&resolve("", &[]).unwrap())), (0.9995, 0.9925));
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
        "c.toml:1:11: bad value for `profile`: there is no profile `auto` (available: laptop, workstation, gpu); --profile auto is that of this machine"
    );
}

#[test]
fn options_without_effect_are_told() {
    let told = |text: &str, sets: &[&str], flags: &[(&'static str, &str)]| {
        let mut layers = layers_on("intersection", text, sets);
        layers.flags.extend(flags.iter().map(|(key, name)| (*key, Value::from(*name))));
        let origins = layers.resolve().unwrap().origins;
        overruled(&layers, &origins)
    };
    let whole = resolve("", &[]).unwrap().to_toml();
    assert_eq!(
        told(&whole, &["seed=3"], &[("preset", "steering"), ("profile", "gpu")]),
        [
            "--preset steering has no effect: c.toml gives all of its settings",
            "--profile gpu has no effect: c.toml gives all of its settings"
        ]
    );
    assert_eq!(
        told(&whole, &["preset=paper"], &[]),
        ["--set preset=paper has no effect: c.toml gives all of its settings"]
    );
    assert_eq!(
        told("", &["algorithm=mat", "seed=3"], &[("algorithm", "mappo")]),
        ["--set algorithm=mat has no effect: --algorithm is given, too"]
    );
    assert_eq!(
        told("", &["ppo.gamma=0.9", "seed=3", "ppo.gamma = 0.8", "ppo.gamma=0.7"], &[]),
        [
            "--set ppo.gamma=0.9 has no effect: --set ppo.gamma=0.7 is given, too",
            "--set ppo.gamma = 0.8 has no effect: --set ppo.gamma=0.7 is given, too"
        ]
    );
    assert!(told("", &["ppo.gamma=0.9", "ppo.gamma = 0.9"], &[]).is_empty());
    let environment = "environment = \"navigation\"\n";
    let layers = |text: String| Layers {
        document: Document::of_run("c.toml".to_owned(), text),
        flags: vec![("preset", "paper".into())],
        ..Layers::default()
    };
    let whole = layers(environment.to_owned()).resolve().unwrap().config.to_toml();
    let resumed = layers(whole);
    assert_eq!(
        overruled(&resumed, &resumed.resolve().unwrap().origins),
        ["--preset paper has no effect: c.toml gives all of its settings"]
    );
    let some = [("preset", "steering"), ("profile", "workstation")];
    assert!(told("ppo.gamma = 0.5\ntrain.envs = 3", &["seed=3"], &some).is_empty());
    // These are the settings that profiles change.
    let mut changed = BTreeSet::new();
    for profile in &PROFILES {
        let origins = layers_on("intersection", "", &[&format!("profile={}", profile.name)])
            .resolve()
            .unwrap()
            .origins;
        let of_profile =
            origins.into_iter().filter(|(_, from)| *from == Origin::Profile(profile.name));
        changed.extend(of_profile.map(|(key, _)| key));
    }
    assert!(changed.iter().eq(Profile::SETTINGS), "{changed:?}");
}

#[test]
fn each_value_has_an_origin() {
    let sets = ["algorithm=maddpg", "init_from=runs/any", "train.envs=3"];
    let resolved = layers_on("parking_lot", "seed = 4\n", &sets).resolve().unwrap();
    let origin = |key: &str| resolved.origins[key].to_string();
    assert_eq!(origin("ppo.gae_lambda"), "default");
    assert_eq!(origin("ppo.gamma"), "preset steering");
    assert_eq!(origin("train.anneal_steps"), "default, by the number of agents");
    assert_eq!(origin("ppo.minibatch"), "default, by the method");
    assert_eq!(origin("exploration.log_std_start"), "default, by the initial policy");
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
