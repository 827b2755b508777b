//! Test of the whole use of a policy: train, export, evaluate at other sizes, start training from
//! it, plot.

use std::fs;
use std::path::Path;
use std::process::Command;

use iwol_sumo::algo::{self, Capabilities};
use iwol_sumo::scenario::Scenario;
use serde_json::Value;

use crate::support::{self, folder, in_parallel, iwol, succeeds};

const SMALL: [&str; 9] = [
    "train.envs=2",
    "train.rollout_steps=32",
    "train.validate_every=64",
    "train.validation_episodes=1",
    "network.hidden=8",
    "iwol.message=8",
    "iwol.latent=4",
    "ppo.minibatch=64",
    "scenario.termination.horizon=40",
];

fn train(out: &Path, more: &[&str]) -> Command {
    support::train(out, &SMALL, &[&["--steps", "128"], more].concat())
}

fn text(command: &mut Command) -> String {
    support::text(&succeeds(command).stdout)
}

fn refused(command: &mut Command) -> String {
    let output = command.output().expect("it ran");
    assert_eq!(output.status.code(), Some(2));
    String::from_utf8(output.stderr).expect("text")
}

#[test]
fn a_policy_is_trained_exported_evaluated_and_gone_on_from() {
    let folder = folder();
    let at = |name: &str| folder.path().join(name);
    let name = |name: &str| at(name).display().to_string();
    let use_policy = |algorithm: &str| {
        let Capabilities { any_number, latent, .. } = algo::capabilities(algorithm).expect("known");
        // Numbers of vehicles that the policy is used with after training.
        let (more, next_agents) = if any_number { ("16", "5") } else { ("4", "4") };
        let run = format!("{algorithm}_0");
        text(&mut train(&at(&run), &["--algorithm", algorithm, "--agents", "4"]));
        let small = name(&format!("{algorithm}_small"));
        assert_eq!(text(&mut iwol(&["export", &name(&run), "--out", &small])).trim(), small);
        let size = |folder: &str| {
            let path = Path::new(folder).join("checkpoints/best.safetensors");
            fs::metadata(path).expect("a checkpoint").len()
        };
        assert!(size(&small) < size(&name(&run)) / 2);
        // The copy of the scenario finds its net from the new folder.
        Scenario::load(&Path::new(&small).join("scenario.xml")).expect("the scenario of the run");

        // The copy gives the same results as the run, and controls other numbers of vehicles.
        let evaluate = |run: &str, agents: &str| -> Value {
            let args = ["evaluate", run, "--episodes", "2", "--agents", agents, "--json"];
            serde_json::from_str(&text(&mut iwol(&args))).expect("JSON")
        };
        assert_eq!(evaluate(&name(&run), "4"), evaluate(&small, "4"));
        if !any_number {
            let refused = refused(&mut iwol(&["evaluate", &small, "--agents", "16"]));
            assert!(refused.contains("cannot be used with 16"), "{refused}");
        }
        let wide = evaluate(&small, more);
        let reconstruction = wide["metrics"]["reconstruction"].as_array().expect("a list");
        assert_eq!(reconstruction.len(), latent.len(), "{algorithm}");
        assert!(
            reconstruction.iter().all(|k| k["error"].as_f64().is_some_and(|e| e > 0.0)),
            "{wide}"
        );

        // Training starts from the copy with more vehicles; its metrics contain the quality of the
        // latent.
        let next = format!("{algorithm}_next");
        text(&mut train(
            &at(&next),
            &["--algorithm", algorithm, "--agents", next_agents, "--init-from", &small],
        ));
        let metrics = fs::read_to_string(at(&next).join("metrics.jsonl")).expect("metrics");
        for name in ["world", "interaction"] {
            assert_eq!(
                metrics.contains(&format!("validation/{name}_explained")),
                latent.contains(&name),
                "{algorithm}"
            );
        }

        // These refusals do not depend on the algorithm, so they are tested once.
        if algorithm != algo::NAMES[0] {
            return;
        }
        let other_numbers = [
            "--set",
            "scenario.observation.heading=false",
            "--set",
            "scenario.observation.ownTurn=true",
        ];
        std::fs::write(at("a.toml"), "steps = 1\n").expect("written");
        let refusals = [
            (
                refused(&mut train(Path::new(&small), &["--algorithm", algorithm])),
                "contains a policy; start from it",
            ),
            (
                refused(&mut iwol(&["train", "--resume", "--out", &small])),
                "contains a policy, but not the state from which a training continues",
            ),
            // As many numbers, but other ones: every number would be in the wrong place.
            (
                refused(iwol(&["evaluate", &small]).args(other_numbers)),
                "number 2 of observation is `ego.heading_cos`; by the task",
            ),
            (
                refused(
                    train(&at("x"), &["--algorithm", algorithm, "--init-from", &small])
                        .args(other_numbers),
                ),
                "number 2 of observation is `ego.heading_cos`; by the task",
            ),
            (
                refused(&mut iwol(&["export", &name(&run), "--out", &small])),
                "already contains a checkpoint",
            ),
            (
                refused(&mut iwol(&[
                    "train",
                    "--resume",
                    "--out",
                    &name(&run),
                    "--init-from",
                    &small,
                ])),
                "omit --init-from",
            ),
            (
                refused(&mut train(
                    &at("x"),
                    &[
                        "--algorithm",
                        algorithm,
                        "--init-from",
                        &small,
                        "--set",
                        "scenario.observation.groups=nearest",
                    ],
                )),
                "do not fit this run's networks and observations",
            ),
            (
                refused(&mut train(&at("x"), &["--algorithm", "icp-dec", "--init-from", &small])),
                "contains a policy of mappo, but this run trains icp-dec",
            ),
            (
                refused(&mut iwol(&["evaluate", &small, "--set", "seed=5"])),
                "--seed determines the episodes",
            ),
            (
                refused(&mut iwol(&["evaluate", &small, "--out", "x.safetensors"])),
                "reserved for checkpoints",
            ),
            (
                refused(&mut iwol(&[
                    "evaluate",
                    &small,
                    "--out",
                    &name("x"),
                    "--record",
                    &name("x"),
                ])),
                "choose two different files",
            ),
            (
                refused(iwol(&["evaluate", &small, "--out"]).arg(at("a.toml"))),
                "the file exists and is no earlier",
            ),
            (
                refused(&mut iwol(&["evaluate", &small, "--set", "network.hidden=16"])),
                "does not fit the observations and networks",
            ),
            (
                refused(&mut iwol(&[
                    "train",
                    "--resume",
                    "--out",
                    &name(&run),
                    "--set",
                    "network.encoder=gru",
                ])),
                "written with another `network.encoder`",
            ),
            (
                refused(&mut train(&at("x"), &["--algorithm", algorithm, "--device", "cuda:99"])),
                "there is no device cuda:99",
            ),
        ];
        for (found, expected) in refusals {
            assert!(found.contains(expected), "{found}");
        }
    };
    in_parallel(algo::NAMES.to_vec(), use_policy);

    // Two seeds form one curve; runs with another observation form another curve.
    text(&mut train(&at("mappo_1"), &["--algorithm", "mappo", "--agents", "4", "--seed", "1"]));
    let nearest =
        ["--algorithm", "mappo", "--agents", "4", "--set", "scenario.observation.groups=nearest"];
    text(&mut train(&at("nearest"), &nearest));
    for axis in ["steps", "time"] {
        let picture = name(&format!("{axis}.png"));
        let runs = [name("mappo_0"), name("mappo_1"), name("nearest")];
        text(&mut iwol(&["plot", &runs[0], &runs[1], &runs[2], "--x", axis, "--out", &picture]));
        assert!(fs::metadata(&picture).expect("a picture").len() > 10_000);
    }
    text(&mut iwol(&["plot", &name("mappo_0"), "--out", &name("curve.svg")]));
    let svg = fs::read_to_string(name("curve.svg")).expect("a picture");
    assert!(svg.starts_with("<svg ") && svg.contains("environment steps"), "{svg}");
    let found = refused(&mut iwol(&["plot", &name("mappo_0"), "--out", &name("curve.pdf")]));
    assert!(found.contains("curve.pdf") && found.contains(".png or .svg"), "{found}");
    // A line of another task is drawn, and the user is told.
    let reference = name("throttle.json");
    for (agents, is_told) in [("4", false), ("8", true)] {
        let rule = ["evaluate", "--policy", "throttle:0.2", "--scenario", support::INTERSECTION];
        let more = ["--agents", agents, "--episodes", "1", "--out", &reference];
        text(&mut iwol(&[&rule[..], &more].concat()));
        let drawing =
            ["plot", &name("mappo_0"), "--reference", &reference, "--out", &name("curve.svg")];
        let said = support::text(&succeeds(&mut iwol(&drawing)).stderr);
        assert_eq!(
            said.contains("is a result on intersection with 8 agents, which is not"),
            is_told,
            "{said}"
        );
    }
    // A run that a report kept contains only its settings and validations.
    let kept = at("kept");
    fs::create_dir(&kept).expect("a folder");
    fs::copy(at("mappo_0").join("config.toml"), kept.join("config.toml")).expect("copied");
    let metrics = fs::read_to_string(at("mappo_0").join("metrics.jsonl")).expect("metrics");
    let validations: Vec<&str> =
        metrics.lines().filter(|line| line.contains("validation/success")).collect();
    assert!(!validations.is_empty() && validations.len() < metrics.lines().count());
    fs::write(kept.join("metrics.jsonl"), validations.join("\n") + "\n").expect("written");
    text(&mut iwol(&["plot", &name("kept"), "--out", &name("kept.png")]));
    assert!(fs::metadata(name("kept.png")).expect("a picture").len() > 10_000);

    // A file that says what a policy was trained with is not ignored in silence if it is damaged.
    fs::write(at("mappo_0").join("meta.json"), "{\"steps\":").expect("written");
    let output = iwol(&["evaluate", &name("mappo_0"), "--episodes", "1"]).output().expect("it ran");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && said.contains("mappo_0/meta.json` is damaged"), "{said}");
}
