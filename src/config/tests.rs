//! Tests of layers, defaults, ranges and messages.

use std::path::Path;

use toml::Value;

use super::{Config, Document, Error, Layers, Origin, PRESETS, Train, flatten};
use crate::algo::settings;

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
    }
}

fn message(text: &str, sets: &[&str]) -> String {
    resolve(text, sets).expect_err("must be refused").to_string()
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
    assert_eq!((config.seed, config.ppo.gamma, config.ppo.epochs), (3, 1.0, 2));
    assert_eq!(config.network.encoder, settings::EncoderKind::Mlp);
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
    assert!([&four, &most].iter().all(|c| c.ppo.minibatch == eight.ppo.minibatch));
    let replays = resolve("agents = 8", &["algorithm=maddpg"]).unwrap();
    assert_eq!(2 * replays.ppo.minibatch, eight.ppo.minibatch);
    assert_eq!(
        (2 * most.train.anneal_steps, 2 * at(16).train.anneal_steps),
        (eight.train.anneal_steps, eight.train.anneal_steps)
    );
    assert_eq!(most.exploration.explore_steps, eight.exploration.explore_steps);
    assert_eq!(most.train.validation_episodes, 16);
    assert_eq!(at(16).train.envs, eight.train.envs);
    // Defaults do not replace values that are given.
    assert_eq!(resolve("agents = 48\nsteps = 5", &["train.envs=3"]).unwrap().train.envs, 3);
    // These settings are the same for every number of agents.
    let searched = |c: &Config| {
        (c.train.repeat_failed, c.train.anneal_success, c.train.stop_success, c.ppo.gamma)
    };
    assert_eq!([&four, &eight, &most].map(searched), [(0.5, 0.95, 0.995, 0.99); 3]);
    assert_eq!(four.train.validation_episodes, 128);
    let shared =
        |name: &str| resolve(&format!("algorithm = '{name}'"), &[]).unwrap().env.cooperation;
    assert_eq!(
        ["mappo", "icp-dec", "icp-sum", "icp-monotonic"].map(shared),
        [0.06, 0.06, 0.0, 0.0]
    );
}

#[test]
fn vehicles_that_steer_have_defaults_of_their_own() {
    let five = resolve_on("parking_lot", "", &[]).unwrap();
    assert_eq!((five.exploration.correlation, five.train.envs), (0.95, 25));
    assert_eq!(five.steps, 2_400_000 * 8 / 5);
    let view = |c: &Config| (c.ppo.gamma, c.ppo.gamma_explored);
    assert_eq!((view(&five), view(&resolve("", &[]).unwrap())), ((0.99, 0.995), (0.99, 0.0)));
    assert_eq!(
        view(&resolve_on("parking_lot", "", &["algorithm=maddpg"]).unwrap()),
        view(&five),
        "one task for all"
    );
    assert_eq!((five.train.repeat_failed, five.train.anneal_success), (0.5, 0.9));
}

#[test]
fn a_trained_policy_begins_with_less_noise() {
    let start = |sets: &[&str]| resolve("", sets).unwrap().exploration.log_std_start;
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
        ["env.cooperation=0.25", "train.envs=3"],
        ["train.rollout_steps=256", "network.chunk_length=200"],
    ] {
        let config = resolve("", &sets).unwrap();
        assert_eq!(resolve(&config.to_toml(), &[]).unwrap(), config);
    }
}

#[test]
fn every_setting_is_documented_and_every_default_allowed() {
    let config = resolve("", &[]).unwrap();
    let page = Config::reference();
    for key in flatten(&config.to_toml().parse().unwrap()).keys() {
        let row = page.lines().find(|line| line.starts_with(&format!("| `{key}` | ")));
        let row = row.unwrap_or_else(|| panic!("{key} is not on the page"));
        assert!(row.matches(" | ").count() == 4 && !row.ends_with("|  |"), "{row}");
    }
    assert!(page.contains("| `ppo.gamma` |  | 0 to 1 | `0.99` | Discount per step. |"));
    assert!(
        page.contains("| `train.batch_growth` |  | whole number, 1 to 64 | `1`; steering `4` |")
    );
    assert!(page.contains("| `env.share_range` | m | 0 or more, or inf | the scenario's |"));
    assert!(page.contains("| `network.encoder` |  | `attention`, `gru`, `mlp` | `mlp` |"));
    let schema = Config::schema();
    assert_eq!(schema["$defs"]["Ppo"]["properties"]["gamma"]["maximum"], 1.0);
    assert_eq!(schema.pointer("/properties/preset/enum/1").unwrap(), "paper");
    assert!(schema.get("required").is_none());
}

#[test]
fn presets_lie_between_defaults_and_files() {
    let of = |text: &str, sets: &[&str]| resolve(text, sets).unwrap();
    let paper = of("preset = 'paper'\n", &[]);
    assert_eq!((paper.train.rollout_steps, paper.env.cooperation), (1000, 0.0));
    assert_eq!(of("", &["preset=paper"]), paper);
    assert_eq!(of("train.rollout_steps = 10\n", &["preset=paper"]).train.rollout_steps, 10);
    assert_eq!(
        message("preset = 'papr'\n", &[]),
        "c.toml:1:10: bad value for `preset`: there is no preset `papr` (available: steering, paper); did you mean `paper`?"
    );
    for preset in &PRESETS {
        // As a file, every key is checked.
        assert!(resolve(preset.text, &["ppo.shards=1"]).is_ok(), "{}", preset.name);
    }
}

#[test]
fn each_value_has_an_origin() {
    let sets = ["algorithm=maddpg", "init_from=runs/any", "train.envs=3"];
    let resolved = layers_on("parking_lot", "seed = 4\n", &sets).resolve().unwrap();
    let origin = |key: &str| resolved.origins[key].to_string();
    assert_eq!(origin("ppo.gamma"), "default");
    assert_eq!(origin("ppo.gamma_explored"), "preset steering");
    assert_eq!(origin("train.anneal_steps"), "default for this number of agents");
    assert_eq!(origin("ppo.minibatch"), "default for this method");
    assert_eq!(origin("exploration.log_std_start"), "default for this init_from");
    assert_eq!(origin("env.horizon"), "scenario");
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
    assert_eq!(resolve(&explained, &[]).unwrap().train, resolved.config.train);
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
    assert!(
        message("[ppo]\ngamma = \"x\"\n", &[])
            .starts_with("c.toml:2:9: bad value for `ppo.gamma`: invalid type")
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
    assert_eq!(
        message("", &["env.intention=hiden"]),
        "--set env.intention=hiden: bad value for `env.intention`: unknown variant `hiden`, expected one of `seen`, \
         `signalled`, `hidden`; did you mean `hidden`?"
    );
    assert_eq!(
        message("", &["env.signal_distance=20"]),
        "--set env.signal_distance=20: bad value for `env.signal_distance`: allowed: 30, the default, unless \
         env.intention is signalled: otherwise no vehicle has an indicator"
    );
    assert!(
        message("", &["env.intention=signalled", "env.signal_distance=0"])
            .contains("allowed: 1 to 200")
    );
    let signalled = resolve("", &["env.intention=signalled", "env.signal_distance=20"]).unwrap();
    assert_eq!(signalled.env.signal_distance, 20.0);
    assert!(message("", &["env.observation=all"]).contains("unknown variant"));
    assert!(message("", &["env.reward_crash=nan"]).contains("a finite number"));
    assert!(message("", &["agents=49"]).contains("49"), "{}", message("", &["agents=49"]));
    assert!(
        message("", &["ppo.epochs=4", "algorithm=commformer"])
            .contains("5 or more with CommFormer")
    );
}
