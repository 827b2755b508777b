//! The program as users meet it: exit codes and messages.

use std::path::Path;

use assert_cmd::Command;
use insta::assert_snapshot;

const SCENARIO: &str = "scenarios/intersection.xml";

fn iwol(args: &[&str]) -> Command {
    let mut command = Command::cargo_bin("iwol").expect("the program is built");
    command
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .args(args)
        .env("NO_COLOR", "1");
    command
}

/// Exit code and standard error of a call that must print nothing to standard output.
fn failure(command: &mut Command) -> String {
    let output = command.output().expect("it ran");
    assert_eq!(String::from_utf8_lossy(&output.stdout), "", "stdout is for data");
    format!(
        "{}\n{}",
        output.status.code().unwrap_or(-1),
        String::from_utf8_lossy(&output.stderr)
    )
}

fn folder() -> tempfile::TempDir {
    tempfile::tempdir().expect("a folder")
}

#[test]
fn wrong_names_are_told_what_there_is() {
    assert_snapshot!(failure(&mut iwol(&["train", "--scenario", SCENARIO, "--algorithm", "im-iwool"])), @"");
    assert_snapshot!(failure(&mut iwol(&["evaluate", "--scenario", SCENARIO, "--policy", "throtle:1"])), @"");
    assert_snapshot!(failure(&mut iwol(&["train", "--scenario", SCENARIO, "--set", "ppo.gama=0.9"])), @"");
    assert_snapshot!(failure(&mut iwol(&["train", "--scenario", SCENARIO, "--set", "ppo.gamma=1.9"])), @"");
}

#[test]
fn too_many_agents() {
    assert_snapshot!(failure(&mut iwol(&["train", "--scenario", SCENARIO, "--agents", "49"])), @"");
    assert_snapshot!(failure(&mut iwol(&["evaluate", "--scenario", SCENARIO, "--agents", "49", "--policy", "sumo"])), @"");
}

#[test]
fn a_mistake_in_a_scenario_is_located() {
    let dir = folder();
    let text = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(SCENARIO)).expect("a scenario");
    let nets = Path::new(env!("CARGO_MANIFEST_DIR")).join("sumo_nets");
    let text = text.replace("../sumo_nets", &nets.display().to_string());
    let file = dir.path().join("mine.xml");
    std::fs::write(&file, text.replace("horizon=", "horizn=")).expect("written");
    let output = failure(iwol(&["evaluate", "--policy", "sumo", "--scenario"]).arg(&file));
    let output = output.replace(&dir.path().display().to_string(), "DIR");
    assert_snapshot!(output, @"");
    assert_snapshot!(failure(&mut iwol(&["evaluate", "--policy", "sumo", "--scenario", "nowhere.xml"])), @"");
}

#[test]
fn a_missing_sumo_is_named() {
    let mut command = iwol(&["evaluate", "--scenario", SCENARIO, "--policy", "sumo"]);
    assert_snapshot!(failure(command.env("PATH", "/nowhere").env_remove("SUMO_HOME")), @"");
}

#[test]
fn damaged_checkpoints_are_refused() {
    let dir = folder();
    let run = dir.path().join("run");
    let tiny = [
        "train.envs=2",
        "train.segment=16",
        "train.validation_episodes=1",
        "network.hidden=8",
        "iwol.rounds=1",
        "env.horizon=40",
    ];
    let mut train = iwol(&[
        "train",
        "--scenario",
        SCENARIO,
        "--agents",
        "4",
        "--steps",
        "64",
        "--out",
    ]);
    train.arg(&run);
    for set in tiny {
        train.args(["--set", set]);
    }
    let output = train.output().expect("it ran");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(
        String::from_utf8_lossy(&output.stdout).trim(),
        run.display().to_string()
    );
    for file in [
        "config.toml",
        "metrics.jsonl",
        "eval.jsonl",
        "checkpoints/best.safetensors",
        "checkpoints/last.safetensors",
    ] {
        assert!(run.join(file).exists(), "{file}");
    }
    assert!(
        std::fs::read_dir(&run).expect("a folder").any(|e| e
            .expect("an entry")
            .file_name()
            .to_string_lossy()
            .contains("tfevents"))
    );

    // The run evaluates, also on another number of agents, and the JSON is what the README promises.
    let output = iwol(&["evaluate", "--episodes", "2", "--seed", "3", "--agents", "6", "--json"])
        .arg(&run)
        .output()
        .expect("it ran");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).expect("one JSON object");
    assert_eq!(
        (json["scenario"].as_str(), json["policy"].as_str()),
        (Some("intersection"), Some("im-iwol"))
    );
    assert_eq!(
        (
            json["agents"].as_u64(),
            json["episodes"].as_u64(),
            json["seed"].as_u64()
        ),
        (Some(6), Some(2), Some(3))
    );
    let names = [
        "success",
        "safety",
        "crash",
        "out_of_road",
        "reward",
        "window_reward",
        "episode_length",
        "efficiency",
        "sumo_collisions",
    ];
    for name in names {
        assert!(json["metrics"][name]["mean"].is_number(), "{name}");
    }
    let success = &json["metrics"]["success"];
    assert!(
        success["low"].as_f64() <= success["mean"].as_f64() && success["mean"].as_f64() <= success["high"].as_f64()
    );

    // A second run into the same folder must be asked for.
    let tidy = |text: String| text.replace(&dir.path().display().to_string(), "DIR");
    assert_snapshot!(tidy(failure(iwol(&["train", "--scenario", SCENARIO, "--out"]).arg(&run))), @"");
    // Another algorithm's checkpoint.
    let mut other = iwol(&["train", "--resume", "--algorithm", "mappo", "--out"]);
    assert_snapshot!(tidy(failure(other.arg(&run))), @"");
    // Another network.
    let mut wider = iwol(&["train", "--resume", "--set", "network.hidden=16", "--out"]);
    assert_snapshot!(tidy(failure(wider.arg(&run))), @"");
    // Truncated.
    let file = run.join("checkpoints/last.safetensors");
    let bytes = std::fs::read(&file).expect("a file");
    std::fs::write(&file, &bytes[..bytes.len() / 2]).expect("written");
    assert_snapshot!(tidy(failure(iwol(&["train", "--resume", "--out"]).arg(&run))), @"");
    assert_snapshot!(tidy(failure(iwol(&["evaluate"]).arg(&file))), @"");
    assert_snapshot!(tidy(failure(iwol(&["evaluate"]).arg(dir.path().join("nothing")))), @"");
}

#[test]
fn usage_errors_end_with_two() {
    for args in [&["evaluate"][..], &["train", "--steps", "x"], &["fly"]] {
        assert!(failure(&mut iwol(args)).starts_with("2\n"), "{args:?}");
    }
    // Help goes to stdout and is no error.
    iwol(&["train", "--help"]).assert().success();
}
