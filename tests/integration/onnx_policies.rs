//! Tests of policies in ONNX files: they act as the policy that they were exported from, and files
//! that do not fit the task are refused.

use std::fs;
use std::path::Path;

use iwol_sumo::checkpoint::Checkpoint;
use iwol_sumo::train::RunDir;
use serde_json::Value;

use crate::support::{failure, folder, iwol, root, succeeds, text};

fn export(policy: &str, file: &str) {
    let run = root().join("policies").join(policy);
    succeeds(&mut iwol(&["export", &run.display().to_string(), "--onnx", file]));
}

fn evaluate(args: &[&str]) -> Value {
    let more = ["--agents", "8", "--episodes", "4", "--seed", "3", "--json"];
    let args = [&["evaluate"], args, &more].concat();
    serde_json::from_str(&text(&succeeds(&mut iwol(&args)).stdout)).expect("JSON")
}

/// Asserts that all numbers of two JSON values are equal within rounding.
fn assert_alike(a: &Value, b: &Value, place: &str) {
    match (a, b) {
        (Value::Object(a), Value::Object(b)) => {
            assert_eq!(a.len(), b.len(), "{place}");
            a.iter().for_each(|(key, a)| assert_alike(a, &b[key], &format!("{place}.{key}")));
        }
        (Value::Number(a), Value::Number(b)) => {
            let [a, b] = [a, b].map(|number| number.as_f64().expect("a number"));
            assert!((a - b).abs() <= 1e-4 * a.abs().max(1.0), "{place}: {a} and {b}");
        }
        _ => assert_eq!(a, b, "{place}"),
    }
}

#[test]
fn a_model_plays_the_same_episodes_as_its_run() {
    let folder = folder();
    for policy in ["mappo-8", "im-iwol-8", "ex-iwol-8"] {
        let file = folder.path().join(format!("{policy}.onnx")).display().to_string();
        export(policy, &file);
        let run = root().join("policies").join(policy).display().to_string();
        let both = evaluate(&[&run, "--policy", &format!("onnx:{file}")]);
        let [trained, model] = &both.as_array().expect("a list")[..] else { panic!("{both}") };
        assert_eq!(model["policy"], format!("onnx:{file}"));
        assert!(trained["checkpoint"].is_string() && model["checkpoint"].is_null());
        let (mut trained, model) = (trained["metrics"].clone(), &model["metrics"]);
        // A model has no decoders, and does not say what it sends.
        trained["reconstruction"] = Value::Array(Vec::new());
        trained["message_bits"] = Value::Null;
        assert_alike(&trained, model, policy);
        assert!(model["success"]["mean"].as_f64().expect("a number") > 0.9, "{model}");
    }
}

/// In an environment without SUMO, with discrete actions.
#[test]
fn a_model_of_choices_plays_the_same_episodes_as_its_run() {
    let folder = folder();
    let file = folder.path().join("junction.onnx").display().to_string();
    export("traffic-junction-ex-iwol", &file);
    let run = root().join("policies/traffic-junction-ex-iwol").display().to_string();
    let policy = format!("onnx:{file}");
    let args = ["evaluate", &run, "--policy", &policy, "--episodes", "20", "--seed", "3", "--json"];
    let both: Value =
        serde_json::from_str(&text(&succeeds(&mut iwol(&args)).stdout)).expect("JSON");
    let [trained, model] = &both.as_array().expect("a list")[..] else { panic!("{both}") };
    for metric in ["success", "reward"] {
        let [a, b] = [trained, model].map(|one| &one["metrics"][metric]["mean"]);
        assert_alike(a, b, metric);
        assert!(a.is_number(), "{metric}: {a}");
    }
    assert!(model["metrics"]["success"]["mean"].as_f64().expect("a number") > 0.8, "{model}");
}

#[test]
fn models_that_do_not_fit_are_refused() {
    let folder = folder();
    let at = |name: &str| folder.path().join(format!("{name}.onnx")).display().to_string();
    export("mappo-8", &at("good"));
    let bytes = fs::read(at("good")).expect("a file");
    // Replaces a text of the file by another of the same length.
    let changed = |name: &str, from: &str, to: &str| {
        assert_eq!(from.len(), to.len());
        let mut bytes = bytes.clone();
        let starts: Vec<usize> = (0..bytes.len() - from.len())
            .filter(|&at| &bytes[at..at + from.len()] == from.as_bytes())
            .collect();
        assert!(!starts.is_empty(), "{from}");
        for at in starts {
            bytes[at..at + to.len()].copy_from_slice(to.as_bytes());
        }
        fs::write(at(name), bytes).expect("written");
    };
    changed("feature", "ego.speed", "ego.sqeed");
    changed("input", "observation", "observatiom");
    changed("output", "action", "actiom");
    fs::write(at("text"), "no model").expect("written");
    let refusals = [
        ("absent", "intersection", "cannot be read"),
        ("text", "intersection", "is no ONNX model"),
        ("good", "parking_lot", "observation has 67 numbers per agent; the task and its settings"),
        (
            "feature",
            "intersection",
            "is `ego.sqeed`; by the task and its settings it is `ego.speed`",
        ),
        (
            "input",
            "intersection",
            "has the inputs observatiom; allowed: observation [batch, 8, 67]",
        ),
        ("output", "intersection", "has the outputs actiom, but none called action"),
    ];
    for (file, scenario, expected) in refusals {
        let policy = format!("onnx:{}", at(file));
        let scenario = root().join("scenarios").join(scenario).with_extension("xml");
        let scenario = scenario.display().to_string();
        let args = ["evaluate", "--policy", &policy, "--scenario", &scenario, "--agents", "8"];
        let output = iwol(&args).output().expect("it ran");
        assert_eq!(output.status.code(), Some(2));
        let message = text(&output.stderr);
        assert!(message.contains(expected) && message.contains(&at(file)), "{expected}: {message}");
    }
}

/// A disturbed channel would change what the run does, and not what its model does.
#[test]
fn a_channel_is_refused_beside_a_model() {
    let folder = folder();
    let file = folder.path().join("policy.onnx").display().to_string();
    export("ex-iwol-8", &file);
    let policy = format!("onnx:{file}");
    let scenario = root().join("scenarios/intersection.xml").display().to_string();
    let task = ["evaluate", "--scenario", &scenario, "--policy", &policy, "--episodes", "1"];
    let said = failure(&mut iwol(&[&task[..], &["--set", "channel.loss=1"]].concat()));
    assert!(said.contains("contains the policy without a channel"), "{said}");
}

/// The path in a run's settings is relative to the folder in which the run was started.
#[test]
fn exports_in_another_folder_are_told_the_scenario() {
    let folder = folder();
    let run = root().join("policies/im-iwol-8").display().to_string();
    let export = |more: &[&str]| {
        let mut command = iwol(&[&["export", &run, "--onnx", "policy.onnx"], more].concat());
        command.current_dir(folder.path());
        command
    };
    let refused = failure(&mut export(&[]));
    assert!(refused.contains("or give --scenario"), "{refused}");
    let scenario = |name: &str| root().join("scenarios").join(name).display().to_string();
    let other = scenario("one_lane.xml");
    let refused = failure(&mut export(&["--scenario", &other]));
    assert!(refused.contains("one_lane.xml") || refused.contains("other numbers"), "{refused}");
    succeeds(&mut export(&["--scenario", &scenario("intersection.xml")]));
    assert!(folder.path().join("policy.onnx").is_file());
}

/// A run that was trained with a disturbed channel has a model without one, which is said.
#[test]
fn exports_say_that_they_lack_the_channel() {
    let folder = folder();
    let run = root().join("policies/ex-iwol-8");
    let said = |run: &Path, file: &str| {
        let file = folder.path().join(file).display().to_string();
        let run = run.display().to_string();
        text(&succeeds(&mut iwol(&["export", &run, "--onnx", &file])).stderr)
    };
    assert_eq!(said(&run, "whole.onnx"), "");
    let mut checkpoint = Checkpoint::load(&RunDir::checkpoint(&run)).expect("a policy");
    checkpoint.config = checkpoint.config.replace("[channel]\n", "[channel]\ndelay = 2\n");
    let disturbed = folder.path().join("disturbed.safetensors");
    checkpoint.config = checkpoint.config.replacen("delay = 0\n", "", 1);
    checkpoint.save(&disturbed).expect("saved");
    assert!(said(&disturbed, "disturbed.onnx").contains("has no channel"));
}
