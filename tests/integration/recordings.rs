//! Tests of recordings, and of the player in a real browser (`scripts/bootstrap --tests` installs
//! it).

use std::path::Path;
use std::process::Command;

use crate::support::{INTERSECTION, failure, folder, iwol, root, succeeds, text, train};

fn check(html: &Path) -> serde_json::Value {
    let script = root().join("scripts/check-player.mjs");
    let output = Command::new("node")
        .arg(script)
        .arg(html)
        .output()
        .expect("node runs; scripts/bootstrap --tests");
    let (stdout, stderr) = (text(&output.stdout), text(&output.stderr));
    assert!(output.status.success(), "{stdout}{stderr}");
    serde_json::from_str(&stdout).expect("a line of JSON")
}

/// An episode at full throttle, with crashes, wrecks and arrivals, plays in a browser.
#[test]
fn a_recorded_episode_plays_in_a_browser() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (recording, html, svg, json) =
        (path("r.json"), path("r.html"), path("r.svg"), path("e.json"));
    succeeds(&mut iwol(&[
        "evaluate",
        "--policy",
        "throttle:1",
        "--scenario",
        INTERSECTION,
        "--agents",
        "8",
        "--episodes",
        "3",
        "--record",
        &recording,
        "--record-episode",
        "2",
        "--out",
        &json,
    ]));
    succeeds(&mut iwol(&["replay", &recording, "-o", &html, "--svg", &svg]));
    let recorded: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(&recording).expect("written")).expect("JSON");
    let found = check(Path::new(&html));
    assert_eq!(found["steps"], recorded["steps"]);
    // There is one row per decision, and one for the end.
    let length = recorded["summary"]["episode_length"].as_f64().expect("a length");
    assert_eq!(recorded["steps"].as_f64(), Some(length + 1.0));
    // The policy sends no messages, so lines show mere range.
    let still = std::fs::read_to_string(&svg).expect("written");
    assert!(still.contains("<rect") && still.contains("stroke-dasharray"), "{still}");
    let before = std::fs::read(&recording).expect("written");
    for (arguments, message) in [
        (["--out", &recording, "--at", "0"], "is the recording itself"),
        (["--svg", "picture.png", "--at", "0"], "the file's name must end in .svg"),
        (["--out", &svg, "--at", "0"], "the file's name must end in .html"),
        (["--out", &html, "--at", "100000"], "there is no such step; allowed: 0 to"),
    ] {
        let mut replay = iwol(&["replay", &recording]);
        if !arguments.contains(&"--svg") {
            replay.args(["--svg", &svg]);
        }
        let said = failure(replay.args(arguments));
        assert!(said.contains(message), "{said}");
    }
    assert_eq!(std::fs::read(&recording).expect("written"), before);
    // Earlier players are replaced, other files are not.
    succeeds(&mut iwol(&["replay", &recording, "-o", &html]));
    std::fs::write(&html, "<html>a page of somebody</html>").expect("written");
    let said = failure(&mut iwol(&["replay", &recording, "-o", &html]));
    assert!(said.contains("is neither a player nor a picture"), "{said}");
}

/// An evaluation lists the episodes in which not every agent succeeded, and a recording of one of them
/// shows a failure.
#[test]
fn failed_episodes_are_listed_for_recordings() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (json, recording) = (path("e.json"), path("r.json"));
    let evaluate = ["evaluate", "--policy", "uniform", "--policy", "sumo"];
    let task = ["--scenario", INTERSECTION, "--agents", "8", "--episodes", "6", "--out", &json];
    let said = text(&succeeds(iwol(&evaluate).args(task)).stdout);
    let found: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(&json).expect("written")).expect("JSON");
    let failed: Vec<u64> =
        serde_json::from_value(found[0]["failed_episodes"].clone()).expect("some");
    let list = failed.iter().map(u64::to_string).collect::<Vec<_>>().join(", ");
    assert!(
        said.contains(&format!("failures of uniform: in {} of 6 episodes: {list}", failed.len()))
    );
    assert!(found[1]["failed_episodes"].is_null() && !said.contains("failures of sumo: in"));

    let last = failed.last().expect("a failure").to_string();
    let recorded = ["--record", &recording, "--record-episode", &last];
    succeeds(iwol(&evaluate).args(task).args(recorded));
    let recorded: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(&recording).expect("written")).expect("JSON");
    let success = recorded["summary"]["success"].as_f64().expect("a share");
    assert!(success < 1.0, "{success}");
}

/// The rewards of a recording add up to the reward of the episode.
#[test]
fn a_recording_says_what_the_evaluation_says() {
    use base64::Engine as _;
    let folder = folder();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (recording, run) = (path("r.json"), path("run"));
    // The run is small, and its learned graph has nearly all edges.
    let settings = [
        "train.envs=2",
        "train.rollout_steps=32",
        "train.validate_every=64",
        "train.validation_episodes=1",
        "network.hidden=8",
        "iwol.message=8",
        "iwol.graph_bias=4",
        "ppo.minibatch=64",
    ];
    let more = ["--algorithm", "ex-iwol", "--agents", "8", "--steps", "128"];
    succeeds(&mut train(Path::new(&run), &settings, &more));
    let record = ["--record", &recording, "--record-episode", "1"];
    succeeds(iwol(&["evaluate", &run, "--episodes", "2"]).args(record));
    let recorded: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(&recording).expect("written")).expect("JSON");
    let bytes = |text: &serde_json::Value| {
        base64::engine::general_purpose::STANDARD
            .decode(text.as_str().expect("text"))
            .expect("base64")
    };
    let column = |name: &str| -> Vec<f64> {
        let column = &recorded["columns"][name];
        let scale = column["scale"].as_f64().expect("a scale");
        let numbers = bytes(&column["data"]);
        let number = |pair: &[u8]| match i16::from_le_bytes([pair[0], pair[1]]) {
            i16::MIN => 0.0,
            number => f64::from(number) * scale,
        };
        numbers.chunks_exact(2).map(number).collect()
    };
    let agents = recorded["agents"].as_f64().expect("agents");
    let reward = column("reward").iter().sum::<f64>() / agents;
    let expected = recorded["summary"]["reward"].as_f64().expect("a reward");
    assert!((reward - expected).abs() < 0.05, "{reward} {expected}");
    // Vehicles start at rest and drive no faster than 80 km/h.
    let (speed, value) = (column("speed"), column("value"));
    assert!(
        speed[..8].iter().all(|v| v.abs() < 1e-3) && speed.iter().all(|v| *v <= 22.3),
        "{speed:?}"
    );
    assert!(value[..8].iter().any(|v| *v != 0.0), "{:?}", &value[..8]);
    // The agents communicate within range, and no agent receives its own messages.
    let (edges, n) = (bytes(&recorded["edges"]), agents as usize);
    assert!(
        recorded["communicates"].as_bool().expect("a flag") && edges.iter().any(|byte| *byte != 0)
    );
    assert!(edges.chunks_exact(n).all(|rows| (0..n).all(|i| rows[i] >> i & 1 == 0)));
}
