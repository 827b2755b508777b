//! Built-in environments, and the examples of an environment and of a method of one's own.

use std::path::Path;
use std::process::Command;
use std::sync::atomic::AtomicBool;

use iwol_sumo::algo::{self, CommunicationScope};
use iwol_sumo::checkpoint::Checkpoint;
use iwol_sumo::config::{Config, Layers};
use iwol_sumo::env::{self, EnvSpec, Environment, NamedEnvironment, Simple, Stream, WorldPhase};
use iwol_sumo::rng::{self, Seed};
use iwol_sumo::train::Trainer;
use toml::Value;

use crate::support::{folder, iwol, root, succeeds, text};

#[path = "../../examples/own_env.rs"]
#[allow(dead_code)]
mod own_env;
#[path = "../../examples/own_method.rs"]
#[allow(dead_code)]
mod own_method;

fn stream(worlds: usize, training: bool) -> Stream {
    Stream {
        worlds,
        stride: worlds as u64,
        seed: Seed::new(4),
        episodes: 0..u64::MAX,
        training,
        repeat_failed: if training { 0.5 } else { 0.0 },
        beside: false,
    }
}

/// Returns random actions of all agents, `[E, N, A]`.
fn random(spec: &EnvSpec, worlds: usize, rng: &mut rng::Rng) -> Vec<f32> {
    let one = |rng: &mut rng::Rng| match spec.actions.choices() {
        Some(choices) => rng::below(rng, choices) as f32,
        None => rng::symmetric(rng) as f32,
    };
    (0..worlds * spec.agents * spec.actions.len()).map(|_| one(rng)).collect()
}

/// Every environment plays many episodes without a mistake in its frames, and worlds that are
/// restored go on as those that were not interrupted.
#[test]
fn worlds_come_back_to_where_they_were() {
    for name in NamedEnvironment::BUILT_IN {
        let one = NamedEnvironment::find(name).expect("it is there");
        let environment = one.environment();
        let spec = environment.spec();
        let stream = stream(3, true);
        let mut rng = Seed::new(8).rng();
        let mut worlds = environment.start(&stream).expect(one.name);
        let mut episodes = 0;
        for _ in 0..333 {
            worlds.step(&random(spec, 3, &mut rng)).expect(one.name);
            // Features are within the ranges of the specification.
            for e in 0..3 {
                let frame = worlds.view(e).frame;
                let both = [(&frame.observation, &spec.observation), (&frame.state, &spec.state)];
                for (numbers, features) in both {
                    for (value, k) in numbers.iter().zip((0..features.len()).cycle()) {
                        let feature = &features.list[k];
                        // Zeros stand for agents that are not there.
                        let range = feature.low.min(0.0) - 1e-5..=feature.high + 1e-5;
                        assert!(range.contains(value), "{}: {feature:?} {value}", one.name);
                    }
                }
            }
            let records = worlds.take_finished();
            episodes += records.len();
            for record in records {
                assert!((0.0..=1.0).contains(&record.success), "{}: {record:?}", one.name);
                assert!(record.reward.is_finite(), "{}: {record:?}", one.name);
                let names: Vec<&str> = spec.metrics.iter().map(|metric| metric.name).collect();
                assert_eq!(record.own.len(), names.len(), "{}: {record:?}", one.name);
            }
        }
        assert!(episodes >= 3, "{}: {episodes} episodes", one.name);
        let mut again = environment.restore(&stream, &worlds.states()).expect(one.name);
        for _ in 0..50 {
            let actions = random(spec, 3, &mut rng);
            worlds.step(&actions).expect(one.name);
            again.step(&actions).expect(one.name);
            for e in 0..3 {
                let (a, b) = (worlds.view(e), again.view(e));
                assert_eq!((a.episode, a.step), (b.episode, b.step), "{}", one.name);
                // What a world shows between two episodes is not kept.
                if a.phase == WorldPhase::Running {
                    assert_eq!(a.frame.observation, b.frame.observation, "{}", one.name);
                    assert_eq!(a.frame.state, b.frame.state, "{}", one.name);
                    assert_eq!(a.frame.reward, b.frame.reward, "{}", one.name);
                }
            }
        }
    }
}

/// Cars come less often in some episodes of a training than in any of an evaluation.
#[test]
fn training_may_have_easier_episodes() {
    let cars = |training: bool| {
        let environment =
            NamedEnvironment::find("traffic_junction").expect("it is there").environment();
        let mut worlds = environment.start(&stream(1, training)).expect("worlds");
        let mut found = Vec::new();
        while found.len() < 40 {
            worlds.step(&[0.0; 10]).expect("a step");
            found.extend(worlds.take_finished().into_iter().map(|record| record.own["cars"]));
        }
        found
    };
    let least = |cars: Vec<f64>| cars.into_iter().fold(f64::INFINITY, f64::min);
    assert!(least(cars(true)) < 8.0 && least(cars(false)) > 12.0);
}

fn config(method: &str, environment: &dyn Environment, sets: &[&str]) -> Config {
    let flags = vec![("algorithm", Value::String(method.to_owned()))];
    let sets = sets.iter().map(|set| (*set).to_owned()).collect();
    Layers { flags, sets, ..Layers::default() }.for_environment(environment).expect("settings")
}

fn success(trainer: &mut Trainer) -> f64 {
    let found = trainer.validate(&AtomicBool::new(false)).expect("it runs").metrics();
    found.expect("episodes").success.mean
}

/// An application's environment has a name in settings once it is registered, and only once.
#[test]
fn environments_are_registered_once() {
    env::register(|| Box::new(Simple::new("registered", own_env::Square::new))).expect("new");
    let flags = vec![("environment", Value::String("registered".to_owned()))];
    let found = Layers { flags, ..Layers::default() }.resolve().expect("it is known");
    assert_eq!(
        (found.place.name(), found.config.environment.as_str()),
        ("registered", "registered")
    );
    assert_eq!(found.config.agents, 4);
    assert!(iwol_sumo::metrics::of_environments().any(|metric| metric.id == "distance_left"));
    let refused = |make| env::register(make).expect_err("refused").to_string();
    let taken = refused(|| Box::new(Simple::new("registered", own_env::Square::new)));
    assert!(taken.contains("`registered`: another environment has this name"), "{taken}");
    let taken = refused(|| Box::new(Simple::new("navigation", own_env::Square::new)));
    assert!(taken.contains("another environment has this name"), "{taken}");
    let path = refused(|| Box::new(Simple::new("a/b", own_env::Square::new)));
    assert!(path.contains("allowed: letters, digits, `_` and `-`"), "{path}");
}

/// The example of an environment is learned within seconds.
#[test]
fn the_example_of_an_environment_is_learned() {
    let environment = || Box::new(Simple::new("square", own_env::Square::new));
    let settings = config("mappo", &*environment(), &["train.envs=8"]);
    let mut trainer = Trainer::new(settings, environment()).expect("a trainer");
    for _ in 0..40 {
        trainer.iterate().expect("an iteration");
    }
    assert!(success(&mut trainer) > 0.95, "{}", success(&mut trainer));
}

/// A method of an application is trained, stored, resumed bit for bit and evaluated as those of the
/// crate are, and its name is taken from then on.
#[test]
fn the_example_of_a_method_is_one_of_the_methods() {
    algo::register::<own_method::Ippo>().expect("a new name");
    let taken = algo::register::<own_method::Ippo>().expect_err("it is there").to_string();
    assert_eq!(taken, "there is a method called `ippo` already; give yours another `NAME`");
    assert!(algo::names().contains(&"ippo") && !algo::NAMES.contains(&"ippo"));
    let can = algo::capabilities("ippo").expect("it is known");
    assert!(can.scope == CommunicationScope::None && can.any_number && can.discrete);

    let environment = || NamedEnvironment::find("navigation").expect("it is there").environment();
    let sets = ["train.envs=8", "train.rollout_steps=100", "train.validation_episodes=16"];
    let settings = || config("ippo", &*environment(), &sets);
    let mut trainer = Trainer::new(settings(), environment()).expect("a trainer");
    let before = success(&mut trainer);
    for _ in 0..3 {
        trainer.iterate().expect("an iteration");
    }
    let folder = folder();
    let file = folder.path().join("last.safetensors");
    trainer.checkpoint().save(&file).expect("saved");
    let stored = Checkpoint::load(&file).expect("loaded");
    assert_eq!(stored.algorithm, "ippo");
    let mut again = Trainer::resume(settings(), environment(), &stored).expect("resumed");
    for _ in 0..2 {
        trainer.iterate().expect("an iteration");
        again.iterate().expect("an iteration");
    }
    let weights = |trainer: &Trainer| {
        let state = trainer.checkpoint().learner;
        state.iter().map(|(_, t)| t.double_value(&vec![0; t.dim()])).collect::<Vec<_>>()
    };
    assert_eq!(weights(&trainer), weights(&again));
    for _ in 0..35 {
        trainer.iterate().expect("an iteration");
    }
    let after = success(&mut trainer);
    assert!(after > before + 0.1, "it learns: {before} to {after}");
}

/// Every environment has a picture, with the ground and the agents.
#[test]
fn episodes_are_recorded_and_played_back() {
    let folder = folder();
    for name in NamedEnvironment::BUILT_IN {
        let play = |arguments: &[&str]| {
            let output = iwol(arguments).current_dir(folder.path()).output().expect("it runs");
            let text = String::from_utf8(output.stderr).expect("text");
            assert!(output.status.success(), "{name}: {text}");
        };
        let few = ["--policy", "uniform", "--episodes", "1", "--record", "one.json"];
        play(&[&["evaluate", "--environment", name][..], &few].concat());
        play(&["replay", "one.json", "--out", "one.html", "--svg", "one.svg"]);
        let still = std::fs::read_to_string(folder.path().join("one.svg")).expect("a still");
        let agents = still.matches("fill=\"#0072b2\"").count();
        let ground = still.matches("#d2d6da").count();
        assert!(agents > 0 && ground > 0, "{name}: {agents} agents\n{still}");
    }
}

/// Reports have the metrics of environments beside those of all tasks, with published values.
/// With `channel.shuffled`, an episode that is played alone hears nobody: the agents of worlds that
/// have nothing left to play are gone. Of 17 episodes, 16 are played at the same time.
#[test]
fn the_last_episode_hears_nobody_of_earlier_ones() {
    let folder = folder();
    let run = root().join("policies/traffic-junction-ex-iwol").display().to_string();
    let played = |set: &str| {
        let file = folder.path().join(format!("{set}.json")).display().to_string();
        let episode = ["--episodes", "17", "--record-episode", "16", "--record", &file];
        succeeds(iwol(&["evaluate", &run, "--set", set]).args(episode));
        let text = std::fs::read_to_string(file).expect("a recording");
        let recording: serde_json::Value = serde_json::from_str(&text).expect("JSON");
        (recording["columns"].clone(), recording["summary"].clone())
    };
    let alone = played("channel.shuffled=true");
    assert_eq!(alone, played("channel.loss=1"));
    assert_ne!(alone, played("channel.loss=0"));
}

#[test]
fn reports_have_the_metrics_of_environments() {
    let folder = folder();
    let sweep = folder.path().join("robots.toml");
    let file = "title = \"Robots\"\n[settings]\nsteps = 200\n\
                train = { envs = 2, rollout_steps = 50, validation_episodes = 2 }\n\
                [grid]\nenvironment = [\"navigation\", \"material_transport\"]\n\
                algorithm = [\"mappo\"]\nseed = [0]\n\
                [[evaluate]]\nepisodes = 4\nx = \"environment\"\n\
                [[reference]]\nlabel = \"paper, MAPPO\"\nmetric = \"left_materials\"\n\
                x = [\"material_transport\"]\ny = [18.3]\n";
    std::fs::write(&sweep, file).expect("written");
    let play = |arguments: &[&str]| {
        let output = iwol(arguments).current_dir(folder.path()).output().expect("it runs");
        let text =
            [output.stdout, output.stderr].map(|text| String::from_utf8(text).expect("text"));
        (output.status.success(), text.concat())
    };
    let (fine, text) = play(&["sweep", "robots.toml"]);
    assert!(fine, "{text}");
    let (fine, text) = play(&["report", "robots.toml", "--out", "report"]);
    assert!(fine, "{text}");
    let page = std::fs::read_to_string(folder.path().join("report/report.md")).expect("a report");
    assert!(page.contains("safe robots % at") && !page.contains("safety"), "{page}");
    for expected in ["left materials at", "distance at", "18.3", "reward at"] {
        assert!(page.contains(expected), "{expected}: {page}");
    }
    let wrong = file.replace("left_materials", "left_material");
    std::fs::write(&sweep, wrong).expect("written");
    let (fine, text) = play(&["sweep", "robots.toml", "--dry-run"]);
    assert!(!fine && text.contains("metric must be one of"), "{text}");
}

/// A benchmark of training says when a run reached the asked success, and that it did not.
#[test]
fn training_is_measured_until_it_succeeds() {
    let measure = |success: &str| {
        let mut command = iwol(&["bench", "train", "--environment", "navigation", "--json"]);
        command.args(["--algorithm", "mappo", "--seeds", "2", "--success", success]);
        for set in ["steps=96", "train.envs=2", "train.rollout_steps=16", "network.hidden=8"] {
            command.args(["--set", set]);
        }
        command.args(["--set", "train.validate_every=32", "--set", "train.validation_episodes=2"]);
        let lines = text(&succeeds(&mut command).stdout);
        lines.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect::<Vec<_>>()
    };
    let reached: Vec<serde_json::Value> = measure("0");
    assert_eq!(
        reached.iter().map(|row| row["seed"].as_u64()).collect::<Vec<_>>(),
        [Some(0), Some(1)]
    );
    for row in &reached {
        // Every validation reaches 0 %, so the first one does.
        assert_eq!((row["reached_steps"].as_u64(), row["steps"].as_u64()), (Some(32), Some(96)));
        let (until, whole) = (row["reached_seconds"].as_f64(), row["seconds"].as_f64());
        assert!(Some(0.0) < until && until < whole, "{row}");
    }
    for row in measure("100") {
        assert!(row["reached_steps"].is_null() && row["reached_seconds"].is_null(), "{row}");
    }
    for slip in ["0.971", "101", "nan", "-1"] {
        let output = iwol(&["bench", "train", &format!("--success={slip}")]).output();
        let output = output.expect("it runs");
        let said = text(&output.stderr);
        assert!(!output.status.success() && said.contains("1 to 100 (per cent)"), "{slip}: {said}");
    }
}

/// The programs of the examples have the command line of `iwol`, with what they register.
#[test]
fn applications_have_the_command_line() {
    let folder = folder();
    let examples = Path::new(env!("CARGO_BIN_EXE_iwol")).with_file_name("examples");
    let play = |name: &str, arguments: &[&str]| {
        let program = examples.join(name);
        assert!(program.exists(), "`cargo test` without --test builds {}", program.display());
        let output = Command::new(program).args(arguments).current_dir(folder.path()).output();
        let output = output.expect("it runs");
        let all = [output.stdout, output.stderr].map(|all| String::from_utf8(all).expect("text"));
        assert!(output.status.success(), "{name} {arguments:?}: {}", all.concat());
        all.concat()
    };
    let small = ["--steps", "160", "--set", "train.envs=2", "--set", "train.rollout_steps=20"];
    let few = ["--set", "train.validation_episodes=2", "--out", "run"];
    let square = ["train", "--environment", "square", "--algorithm", "magic"];
    play("own_env", &[&square[..], &small, &few].concat());
    let record = ["--record", "episode.json"];
    let text = play("own_env", &[&["evaluate", "run", "--episodes", "2"][..], &record].concat());
    assert!(text.contains("distance left"), "{text}");
    play("own_env", &["replay", "episode.json", "--out", "episode.html"]);
    let sweep = "title = \"Square\"\n[settings]\nenvironment = \"square\"\nsteps = 80\n\
                 train = { envs = 2, rollout_steps = 20, validation_episodes = 2 }\n\
                 [grid]\nalgorithm = [\"mappo\"]\nseed = [0]\n[[evaluate]]\nepisodes = 2\n";
    std::fs::write(folder.path().join("square.toml"), sweep).expect("written");
    let text = play("own_env", &["sweep", "square.toml"]);
    assert!(text.contains("own_env report square.toml"), "{text}");
    play("own_env", &["report", "square.toml", "-o", "report"]);
    let report = std::fs::read_to_string(folder.path().join("report/report.md")).expect("a report");
    assert!(report.contains("own_env sweep square.toml"), "{report}");
    assert!(report.contains("distance left"), "{report}");

    let ippo = ["train", "--environment", "traffic_junction_easy", "--algorithm", "ippo"];
    let few = ["--set", "train.validation_episodes=2", "--out", "ippo"];
    play("own_method", &[&ippo[..], &small, &few].concat());
    let text = play("own_method", &["evaluate", "ippo", "--episodes", "2"]);
    assert!(text.contains("collisions"), "{text}");
}
