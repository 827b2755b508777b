//! Tests of the program's exit codes and messages.

use std::path::Path;

use insta::assert_snapshot;

use crate::support::{
    INTERSECTION as SCENARIO, failure, folder, iwol, root, succeeds, text, train,
};

#[test]
fn wrong_names_are_told_what_there_is() {
    assert_snapshot!(failure(&mut iwol(&["train", "--scenario", SCENARIO, "--algorithm", "im-iwool"])), @r#"
    2
    error: --algorithm: bad value for `algorithm`: there is no algorithm `im-iwool` (available: mappo, im-iwol, ex-iwol, mat, magic, commformer, icp-dec, icp-sum, icp-monotonic, maddpg, maddpg-iwol); did you mean `im-iwol`?
    "#);
    assert_snapshot!(failure(&mut iwol(&["evaluate", "--scenario", SCENARIO, "--policy", "throtle:1"])), @r#"
    2
    error: there is no policy `throtle:1`; choose one of onnx:<file>, throttle:<a>, pursuit:<speed>, fcfs:<speed>, gaussian, uniform, sumo with a in -1..1 and speed in m/s, above 0
    "#);
    assert_snapshot!(failure(&mut iwol(&["train", "--scenario", SCENARIO, "--set", "ppo.gama=0.9"])), @r#"
    2
    error: --set ppo.gama=0.9: there is no setting `ppo.gama`; did you mean `ppo.gamma`?
    "#);
    assert_snapshot!(failure(&mut iwol(&["train", "--scenario", SCENARIO, "--set", "ppo.gamma=1.9"])), @r#"
    2
    error: --set ppo.gamma=1.9: bad value for `ppo.gamma`: allowed: 0 to 1
    "#);
}

#[test]
fn a_policy_without_a_task_is_refused() {
    assert_snapshot!(failure(&mut iwol(&["evaluate", "--policy", "sumo"])), @r#"
    2
    error: --policy without a run also needs --scenario or --environment
    "#);
    let said = failure(&mut iwol(&["evaluate"]));
    assert!(said.contains("<RUN_OR_CHECKPOINT>") && !said.contains("--scenario"), "{said}");
}

#[test]
fn a_number_in_quotes_is_told_to_lose_them() {
    let dir = folder();
    let file = dir.path().join("a.toml");
    std::fs::write(&file, "[ppo]\ngamma = \"0.99\"\n").expect("written");
    let output = failure(iwol(&["train", "--scenario", SCENARIO, "--config"]).arg(&file));
    let output = output.replace(&dir.path().display().to_string(), "DIR");
    assert_snapshot!(output, @r#"
    2
    error: DIR/a.toml:2:9: bad value for `ppo.gamma`: allowed: 0 to 1; write it as 0.99
    "#);
}

#[test]
fn too_many_agents() {
    assert_snapshot!(failure(&mut iwol(&["train", "--scenario", SCENARIO, "--agents", "49"])), @r#"
    2
    error: scenarios/intersection.xml: 49 agents are not allowed, allowed: 4 to 48

    hint: choose 4 to 48 agents, or write a scenario with a larger net and a larger `max` of <agents>
    "#);
    assert_snapshot!(failure(&mut iwol(&["evaluate", "--scenario", SCENARIO, "--agents", "49", "--policy", "sumo"])), @r#"
    2
    error: scenarios/intersection.xml: 49 agents are not allowed, allowed: 4 to 48

    hint: choose 4 to 48 agents, or write a scenario with a larger net and a larger `max` of <agents>
    "#);
}

#[test]
fn a_mistake_in_a_scenario_is_located() {
    let dir = folder();
    let text = std::fs::read_to_string(root().join(SCENARIO)).expect("a scenario");
    let nets = root().join("sumo_nets");
    let text = text.replace("../sumo_nets", &nets.display().to_string());
    let file = dir.path().join("mine.xml");
    std::fs::write(&file, text.replace("horizon=", "horizn=")).expect("written");
    let output = failure(iwol(&["evaluate", "--policy", "sumo", "--scenario"]).arg(&file));
    let output = output.replace(&dir.path().display().to_string(), "DIR");
    assert_snapshot!(output, @r#"
    2
    error: DIR/mine.xml:71:18: unknown attribute `horizn` in <termination>; did you mean `horizon`?

    hint: valid in <termination>: horizon, wreckTime, border, brokenLines
    "#);
    assert_snapshot!(failure(&mut iwol(&["evaluate", "--policy", "sumo", "--scenario", "nowhere.xml"])), @r#"
    2
    error: nowhere.xml: cannot read the scenario: No such file or directory (os error 2)

    hint: give the path of a scenario file, e.g. scenarios/intersection.xml; the settings of a run contain the path relative to the folder in which the run was started: change to that folder, or give --scenario
    "#);
}

#[test]
fn a_mistyped_path_is_told_the_nearest() {
    assert_snapshot!(failure(&mut iwol(&["evaluate", "policies/im-iwoll-8"])), @r#"
    2
    error: cannot read the checkpoint `policies/im-iwoll-8`: No such file or directory (os error 2)

    hint: did you mean `policies/im-iwol-8`?
    "#);
    assert_snapshot!(failure(&mut iwol(&["train", "--set", "scenario=scenarios/intersectoin.xml"])), @r#"
    2
    error: scenarios/intersectoin.xml: cannot read the scenario: No such file or directory (os error 2)

    hint: did you mean `scenarios/intersection.xml`?
    "#);
    assert_snapshot!(failure(&mut iwol(&["sweep", "experiment/paper/scalabilty.toml"])), @r#"
    2
    error: cannot read `experiment/paper/scalabilty.toml`: No such file or directory (os error 2)

    hint: did you mean `experiments/paper/scalability.toml`?
    "#);
}

/// A path that is no UTF-8 is an error like any other.
#[test]
fn a_path_of_other_bytes_is_missing_like_any_other() {
    use std::os::unix::ffi::OsStrExt as _;
    let mut command = iwol(&["evaluate"]);
    let output = command.arg(std::ffi::OsStr::from_bytes(b"nope\xff")).output().expect("it ran");
    let said = text(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(said.contains("cannot read the checkpoint") && !said.contains("panicked"), "{said}");
}

#[test]
fn a_missing_sumo_is_named() {
    let mut command = iwol(&["evaluate", "--scenario", SCENARIO, "--policy", "sumo"]);
    assert_snapshot!(failure(command.env("PATH", "/nowhere").env_remove("SUMO_HOME")), @r#"
    2
    error: the evaluation of sumo failed: world 0, episode 0, step 0: sumo was not found; looked in `/nowhere`

    hint: run `scripts/bootstrap`, or `pip install eclipse-sumo` in a virtual environment, or set `SUMO_HOME` to the folder whose `bin` holds `sumo`
    "#);
}

/// The history of a run whose checkpoints are gone is not overwritten.
#[test]
fn the_remains_of_a_run_are_left_alone() {
    let dir = folder();
    let run = dir.path().join("run");
    std::fs::create_dir_all(&run).expect("made");
    for name in ["meta.json", "eval.jsonl"] {
        std::fs::write(run.join(name), "{}\n").expect("written");
    }
    let output = train(&run, &[], &["--agents", "4", "--steps", "64"]).output().expect("it ran");
    let said = text(&output.stderr);
    assert!(said.contains("whose checkpoints are gone"), "{said}");
    assert_eq!(std::fs::read_to_string(run.join("eval.jsonl")).expect("it is there"), "{}\n");
}

#[test]
fn damaged_checkpoints_are_refused() {
    let dir = folder();
    let run = dir.path().join("run");
    let tiny = [
        "train.envs=2",
        "train.rollout_steps=16",
        "train.validation_episodes=1",
        "network.hidden=8",
        "iwol.rounds=1",
        "scenario.termination.horizon=40",
    ];
    let output = succeeds(&mut train(&run, &tiny, &["--agents", "4", "--steps", "64"]));
    assert_eq!(text(&output.stdout).trim(), run.display().to_string());
    for file in [
        "config.toml",
        "scenario.xml",
        "meta.json",
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

    // The run can be evaluated, also with another number of agents, and the JSON has the keys that
    // docs/guide/evaluation.md documents.
    let mut evaluate =
        iwol(&["evaluate", "--episodes", "2", "--seed", "3", "--agents", "6", "--json"]);
    let output = succeeds(evaluate.arg(&run));
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).expect("one JSON object");
    assert_eq!(
        (json["scenario"].as_str(), json["policy"].as_str()),
        (Some("intersection"), Some("im-iwol"))
    );
    assert_eq!(
        (json["agents"].as_u64(), json["episodes"].as_u64(), json["seed"].as_u64()),
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
    assert!(
        json["metrics"]["loitering"]["mean"].is_number()
            && json["metrics"]["km_per_crash"]["km"].is_number()
    );
    // Results and run folder name the versions that produced them.
    let meta: serde_json::Value =
        serde_json::from_slice(&std::fs::read(run.join("meta.json")).expect("it is there"))
            .expect("JSON");
    for key in ["version", "commit", "sumo", "libtorch"] {
        assert!(meta[key].is_string(), "{key}: {meta}");
        assert_eq!((&json["run"][key], &json["program"][key]), (&meta[key], &meta[key]), "{key}");
    }
    assert_eq!(meta["steps"], 64);
    assert!(
        meta["seconds"].as_f64() > Some(0.0) && meta["host"]["cores"].as_u64() > Some(0),
        "{meta}"
    );
    assert!(json["metrics"]["failures"]["crossing"].is_u64());
    let success = &json["metrics"]["success"];
    assert!(
        success["low"].as_f64() <= success["mean"].as_f64()
            && success["mean"].as_f64() <= success["high"].as_f64()
    );

    // The scenario of the run is a file like any other.
    let whole = run.join("scenario.xml");
    iwol_sumo::scenario::Scenario::load(&whole).expect("a scenario whose nets are found");
    let output = succeeds(
        iwol(&["evaluate", "--episodes", "2", "--seed", "3", "--agents", "6", "--json"])
            .arg(&run)
            .arg("--scenario")
            .arg(&whole),
    );
    assert_eq!(text(&output.stderr), "");
    let same: serde_json::Value = serde_json::from_slice(&output.stdout).expect("one JSON object");
    assert_eq!(same["metrics"], json["metrics"]);

    // After a change of the scenario's file, the run is played as it was trained, and says so.
    let site = dir.path().join("site/a.xml");
    std::fs::create_dir(dir.path().join("site")).expect("a folder");
    std::fs::copy(&whole, &site).expect("a file");
    let site_run = dir.path().join("site_run");
    let mut command = iwol(&["train", "--agents", "4", "--steps", "64", "--scenario"]);
    command.arg(&site).arg("--out").arg(&site_run);
    command.args(tiny.iter().flat_map(|setting| ["--set", setting]));
    succeeds(&mut command);
    let evaluation = || {
        let output = succeeds(iwol(&["evaluate", "--episodes", "2", "--json"]).arg(&site_run));
        let json: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
        (json["metrics"].clone(), text(&output.stderr))
    };
    let (before, silent) = evaluation();
    assert_eq!(silent, "");
    let now = std::fs::read_to_string(&site).expect("it is there");
    let now = now.replace("wreckTime=\"2.5\"", "wreckTime=\"0\"");
    std::fs::write(&site, &now).expect("a file");
    let (after, said) = evaluation();
    assert_eq!(after, before);
    assert_snapshot!(said.replace(&dir.path().display().to_string(), "DIR"), @"settings of the run replace values in DIR/site/a.xml: scenario.termination.wreckTime = 2.5 (was 0.0)");
    let mut resumed = iwol(&["train", "--resume", "--steps", "128", "--out"]);
    let said = text(&succeeds(resumed.arg(&site_run)).stderr);
    assert!(said.contains(": scenario.termination.wreckTime = 2.5 (was 0.0)"), "{said}");
    let (before, _) = evaluation();
    // What is no setting is as the file has it now.
    let other = now.replace("max=\"48\"", "max=\"47\"");
    assert_ne!(other, now);
    std::fs::write(&site, other).expect("a file");
    let (after, said) = evaluation();
    assert_eq!(after, before);
    assert_snapshot!(said.replace(&dir.path().display().to_string(), "DIR"), @r#"
    DIR/site/a.xml, or a net or route file that it names, has changed since training; --scenario DIR/site_run/scenario.xml is the scenario of training
    settings of the run replace values in DIR/site/a.xml: scenario.termination.wreckTime = 2.5 (was 0.0)
    "#);

    // An edited config.toml changes nothing, and that is said.
    let config = site_run.join("config.toml");
    let whole = std::fs::read_to_string(&config).expect("it is there");
    let edited =
        whole.replace("seed = 0", "seed = 1").replace("wreckTime = 2.5", "wreckTime = 9.0");
    std::fs::write(&config, edited).expect("a file");
    let (after, said) = evaluation();
    assert_eq!(after, before);
    assert_snapshot!(said.lines().next().expect("a line").replace(&dir.path().display().to_string(), "DIR"), @"DIR/site_run/config.toml is not what the checkpoint was trained with, whose settings count; use --set for others: scenario.termination.wreckTime = 9.0 (was 2.5)");

    // A second run into the same folder is refused without --resume.
    let tidy = |text: String| text.replace(&dir.path().display().to_string(), "DIR");
    assert_snapshot!(tidy(failure(iwol(&["train", "--scenario", SCENARIO, "--out"]).arg(&run))), @r#"
    2
    error: `DIR/run` already contains a run; add --resume to continue it, or choose another --out
    "#);
    // A checkpoint of another algorithm is refused.
    let mut other = iwol(&["train", "--resume", "--algorithm", "mappo", "--out"]);
    assert_snapshot!(tidy(failure(other.arg(&run))), @r#"
    2
    error: `DIR/run` is a run of im-iwol, not of mappo
    "#);
    // Another number of agents or another seed is refused, because the worlds could not be
    // restored.
    let mut fewer = iwol(&["train", "--resume", "--agents", "5", "--out"]);
    assert_snapshot!(tidy(failure(fewer.arg(&run))), @r#"
    2
    error: the checkpoint was written with another `agents`; resume with the settings in the config.toml of its run folder
    "#);
    // Another scenario is refused.
    let mut elsewhere =
        iwol(&["train", "--resume", "--scenario", "scenarios/parking_lot.xml", "--out"]);
    assert_snapshot!(tidy(failure(elsewhere.arg(&run))), @r#"
    2
    error: `DIR/run` was started with another scenario, or `scenarios/parking_lot.xml` or a net or route file that it names has changed since then; resume with the original scenario, or start a new run from this run's policy with --init-from
    "#);
    // Another size of the network is refused.
    let mut wider = iwol(&["train", "--resume", "--set", "network.hidden=16", "--out"]);
    assert_snapshot!(tidy(failure(wider.arg(&run))), @r#"
    2
    error: tensor `encoder.mlp.layers.0.linear.weight` has shape [8, 67], but this network needs [16, 67]; check the configuration
    "#);
    // A run that is over takes no other setting, which would train nothing.
    let stored = std::fs::read(run.join("config.toml")).expect("it is there");
    assert_snapshot!(tidy(failure(&mut train(&run, &["ppo.gamma=0.5"], &["--resume"]))), @r#"
    2
    error: `DIR/run` is over after 64 steps, so ppo.gamma = 0.5 (was 0.9925) would change nothing; allow more with --steps, or start a new run with --init-from
    "#);
    assert_eq!(std::fs::read(run.join("config.toml")).expect("it is there"), stored);
    // With more steps, another discount factor is accepted and reported.
    let mut on = train(&run, &["ppo.gamma=0.5"], &["--resume", "--steps", "96"]);
    let said = text(&succeeds(&mut on).stderr);
    assert!(said.contains("another setting: ppo.gamma = 0.5 (was 0.9925)"), "{said}");
    // A checkpoint with a weight that is not finite, and a truncated one, are refused.
    let file = run.join("checkpoints/last.safetensors");
    let bytes = std::fs::read(&file).expect("a file");
    let data = 8 + u64::from_le_bytes(bytes[..8].try_into().expect("a length")) as usize;
    let entries: serde_json::Value = serde_json::from_slice(&bytes[8..data]).expect("JSON");
    let offset = entries["learner/actor/head.mean.bias"]["data_offsets"][0].as_u64();
    let at = data + offset.expect("an offset") as usize;
    let mut broken = bytes.clone();
    broken[at..at + 4].copy_from_slice(&f32::NAN.to_le_bytes());
    std::fs::write(&file, &broken).expect("written");
    let said = failure(iwol(&["evaluate"]).arg(&file));
    assert!(said.contains("actor/head.mean.bias contains a value that is not finite"), "{said}");
    std::fs::write(&file, &bytes[..bytes.len() / 2]).expect("written");
    assert_snapshot!(tidy(failure(iwol(&["train", "--resume", "--out"]).arg(&run))), @r#"
    2
    error: `DIR/run/checkpoints/last.safetensors` is not a usable checkpoint: incomplete metadata, file not fully covered
    "#);
    assert_snapshot!(tidy(failure(iwol(&["evaluate"]).arg(&file))), @r#"
    2
    error: `DIR/run/checkpoints/last.safetensors` is not a usable checkpoint: incomplete metadata, file not fully covered
    "#);
    assert_snapshot!(tidy(failure(iwol(&["evaluate"]).arg(dir.path().join("nothing")))), @r#"
    2
    error: cannot read the checkpoint `DIR/nothing`: No such file or directory (os error 2)
    "#);
    // As a training leaves its folder that was killed at once.
    std::fs::remove_dir_all(run.join("checkpoints")).expect("removed");
    assert_snapshot!(tidy(failure(iwol(&["train", "--resume", "--out"]).arg(&run))), @r#"
    2
    error: `DIR/run` contains no checkpoint to continue from; a training writes the first one before its first validation. Start it without --resume
    "#);
    assert_snapshot!(tidy(failure(iwol(&["evaluate"]).arg(&run))), @r#"
    2
    error: `DIR/run` contains no checkpoint (checkpoints/best.safetensors or last.safetensors); a training writes the first one before its first validation
    "#);
}

/// Creates a scenario in a folder and replaces a part of its text.
fn scenario(dir: &Path, from: &str, to: &str) -> std::path::PathBuf {
    let mut new =
        iwol(&["scenario", "new", "site", "--template", "tee", "--agents", "6", "--root"]);
    let output = succeeds(new.arg(dir));
    let file = dir.join("scenarios/site.xml");
    assert_eq!(text(&output.stdout).trim(), file.display().to_string());
    let text = std::fs::read_to_string(&file).expect("a scenario");
    assert!(text.contains(from), "{from}");
    if from != to {
        std::fs::write(&file, text.replacen(from, to, 1)).expect("written");
    }
    file
}

#[test]
fn a_check_tells_good_from_bad_by_its_exit_code() {
    let dir = folder();
    let file = scenario(dir.path(), "range=\"50\"", "range=\"500\"");
    let check = |file: &Path, more: &[&str]| {
        let output = iwol(&["scenario", "check"]).arg(file).args(more).output().expect("it ran");
        (
            output.status.code(),
            text(&output.stdout).replace(&dir.path().display().to_string(), "DIR"),
        )
    };
    // Warnings do not make the check fail.
    let (code, text) = check(&file, &["--steps", "40"]);
    assert_eq!(code, Some(0), "{text}");
    assert!(
        text.contains("warning: all agents can communicate with each other")
            && text.contains("trial: 6 agents, 40 steps"),
        "{text}"
    );
    let (code, text) = check(&file, &["--steps", "40", "--json"]);
    let json: serde_json::Value = serde_json::from_str(&text).expect("one JSON object");
    assert_eq!((code, json["errors"].as_u64()), (Some(0), Some(0)));
    let first = &json["findings"][0];
    assert_eq!(first["severity"], "warning");
    assert!(
        first["line"].as_u64() > Some(1) && first["column"].is_u64() && first["hint"].is_string(),
        "{first}"
    );
    assert!(json["trial"]["steps_per_second"].as_f64() > Some(1.0));
    assert!(json["trial"]["observation"][0]["most"].is_number());

    let text = std::fs::read_to_string(&file)
        .expect("a scenario")
        .replace("west_in east_out", "west_in east_ou");
    std::fs::write(&file, text).expect("written");
    let (code, text) = check(&file, &[]);
    assert_eq!(code, Some(1));
    assert!(
        text.contains("DIR/scenarios/site.xml:") && text.contains("did you mean `east_out`?"),
        "{text}"
    );
    let (code, text) = check(&file, &["--json"]);
    let json: serde_json::Value = serde_json::from_str(&text).expect("one JSON object");
    assert_eq!((code, json["trial"].is_null()), (Some(1), true));

    assert_eq!(check(Path::new("nowhere.xml"), &[]).0, Some(2));
    assert_eq!(check(dir.path(), &[]).0, Some(2), "a folder is no scenario");
    let mut without = iwol(&["scenario", "check"]);
    let without = without
        .arg(SCENARIO)
        .env("PATH", "/nowhere")
        .env_remove("SUMO_HOME")
        .output()
        .expect("it ran");
    assert_eq!(without.status.code(), Some(2), "{}", String::from_utf8_lossy(&without.stderr));
}

#[test]
fn a_scenario_is_made_built_and_drawn() {
    let dir = folder();
    let file = scenario(dir.path(), "", "");
    let built = succeeds(iwol(&["scenario", "build"]).arg(&file));
    assert!(text(&built.stdout).ends_with("site.net.xml: up to date\n"));
    for ending in ["svg", "png", "html"] {
        let picture = dir.path().join("site").with_extension(ending);
        succeeds(iwol(&["scenario", "show"]).arg(&file).arg("-o").arg(&picture));
        assert!(picture.exists());
    }
    let tidy = |text: String| text.replace(&dir.path().display().to_string(), "DIR");
    assert_snapshot!(tidy(failure(iwol(&["scenario", "show", "-o", "site.gif"]).arg(&file))), @r#"
    2
    error: `site.gif` is not a picture file: give a name that ends in .svg, .png or .html
    "#);
    assert_snapshot!(tidy(failure(iwol(&["scenario", "new", "site", "--template", "tee", "--root"]).arg(dir.path()))), @r#"
    2
    error: `DIR/scenarios/site.xml` already exists; choose another name, or move the file or folder away
    "#);
    assert_snapshot!(failure(&mut iwol(&["scenario", "new", "site", "--template", "circle"])), @r#"
    2
    error: there is no template `circle`; choose one of cross, signals, tee, roundabout, merge, grid, bottleneck, parking
    "#);
}

/// Training continues if its progress cannot be written; a result that cannot be written is an
/// error without a panic.
#[test]
fn work_goes_on_where_nobody_hears_it() {
    let dir = folder();
    let run = dir.path().join("run");
    let full = || std::fs::File::options().write(true).open("/dev/full").expect("it is there");
    let small = [
        "train.envs=2",
        "train.rollout_steps=16",
        "network.hidden=8",
        "scenario.termination.horizon=40",
    ];
    let mut train = train(&run, &small, &["--agents", "4", "--steps", "64"]);
    let status = train.stderr(full()).status().expect("it ran");
    assert!(status.success() && run.join("checkpoints/last.safetensors").exists(), "{status}");
    let mut evaluate = iwol(&["evaluate", "--episodes", "1"]);
    let output = evaluate.arg(&run).stdout(full()).output().expect("it ran");
    let said = text(&output.stderr);
    assert!(
        output.status.code() == Some(2) && said.contains("error: cannot write to stdout"),
        "{said}"
    );
}

/// Files with the names of a run's files that belong to no run are not overwritten.
#[test]
fn strange_files_are_left_alone() {
    let dir = folder();
    std::fs::write(dir.path().join("config.toml"), "precious = true").expect("written");
    let said = failure(iwol(&["train", "--scenario", SCENARIO, "--out"]).arg(dir.path()));
    assert!(said.contains("config.toml` already exists and does not belong to a run"), "{said}");
    let own = dir.path().join("config.toml");
    std::fs::write(&own, "# precious\nseed = 3\n").expect("written");
    let mut train = iwol(&["train", "--scenario", SCENARIO, "--config"]);
    let said = failure(train.arg(&own).arg("--out").arg(dir.path()));
    assert!(said.contains("config.toml` by its resolved settings; rename the file"), "{said}");
    let left = std::fs::read_to_string(&own).expect("the file");
    assert_eq!(left, "# precious\nseed = 3\n");
    let nowhere = dir.path().join("no/such/file.json");
    let mut evaluate = iwol(&[
        "evaluate",
        "--policy",
        "throttle:1",
        "--scenario",
        SCENARIO,
        "--episodes",
        "100000",
        "--out",
    ]);
    let said = failure(evaluate.arg(nowhere));
    assert!(said.contains("cannot create"), "{said}");
}

#[test]
fn usage_errors_end_with_two() {
    for args in [&["evaluate"][..], &["train", "--steps", "x"], &["fly"]] {
        assert!(failure(&mut iwol(args)).starts_with("2\n"), "{args:?}");
    }
    // Help goes to stdout and is not an error.
    succeeds(&mut iwol(&["train", "--help"]));
}

#[test]
fn config_prints_settings_with_their_origins() {
    let output = |args: &[&str]| {
        let output = iwol(args).output().expect("it ran");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).expect("text")
    };
    let text = output(&["config", "--scenario", SCENARIO, "--agents", "16", "--preset", "paper"]);
    for (line, origin) in [
        ("agents = 16", "--agents"),
        ("anneal_steps = 1", "preset paper"),
        ("validation_episodes = 32", "default, by the number of agents"),
    ] {
        assert!(text.contains(&format!("{line:<44} # {origin}\n")), "{line} in {text}");
    }
    let schema = output(&["config", "--schema"]);
    assert!(serde_json::from_str::<serde_json::Value>(&schema).is_ok(), "{schema}");
    assert!(failure(&mut iwol(&["config"])).contains("no scenario given"));
}

/// `-3` is a value that is not allowed, and no unknown option.
#[test]
fn negative_numbers_are_refused_with_what_is_allowed() {
    for (arguments, allowed) in [
        (
            &["scenario", "new", "s", "--template", "cross", "--speed", "-3"][..],
            "allowed: 1 to 70 m/s",
        ),
        (&["scenario", "new", "s", "--template", "cross", "--agents", "-3"], "-3 is not in 0.."),
        (&["sweep", "s.toml", "--jobs", "-1"], "-1 is not in 1..=65535"),
    ] {
        let said = failure(&mut iwol(arguments));
        assert!(said.contains(allowed), "{said}");
    }
}

/// Values that the method or the scenario does not read are said.
#[test]
fn settings_without_effect_are_said() {
    let run = root().join("policies/ex-iwol-8").display().to_string();
    let sets = ["--set", "iwol.latent=8", "--set", "scenario.observation.foresight=2"];
    let evaluation = [&["evaluate", &run, "--episodes", "1"], &sets[..]].concat();
    let said = text(&succeeds(&mut iwol(&evaluation)).stderr);
    for expected in [
        "--set iwol.latent=8 has no effect: ex-iwol does not read it",
        "--set scenario.observation.foresight=2 has no effect: encounters is 0",
    ] {
        assert!(said.contains(expected), "{said}");
    }
}
