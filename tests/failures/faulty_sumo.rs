//! Tests of failures of SUMO and of this program: a run continues without the affected episodes, or
//! ends with one clear error and a checkpoint to resume from; nothing hangs, and no process is
//! left.

use std::fs;
use std::os::unix::fs::{PermissionsExt as _, symlink};
use std::path::PathBuf;
use std::process::{Child, Command, Output, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use iwol_sumo::env::VecEnv;
use iwol_sumo::sumo::{Hosting, Installation, Renewal, Simulation as _, TraciSimulation};

use crate::support::{self, agents_drive, root, task, text};
use crate::{alone, beside_others, signal, sumo_children, wait_until};

/// Returns the processes whose environment contains `word`, the name of a temporary folder.
fn processes_with(word: &str) -> Vec<u32> {
    let of = |entry: fs::DirEntry| {
        let pid = entry.file_name().to_string_lossy().parse().ok()?;
        let line = fs::read(entry.path().join("environ")).ok()?;
        (pid != std::process::id() && String::from_utf8_lossy(&line).contains(word)).then_some(pid)
    };
    fs::read_dir("/proc").expect("proc").flatten().filter_map(of).collect()
}

/// A folder for a run, with a `SUMO_HOME` whose `sumo` misbehaves.
struct Stage {
    folder: tempfile::TempDir,
}

impl Stage {
    fn new() -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let bin = folder.path().join("home/bin");
        fs::create_dir_all(&bin).expect("a folder");
        let script = bin.join("sumo");
        fs::write(&script, include_str!("sumo.py")).expect("a file");
        fs::set_permissions(&script, fs::Permissions::from_mode(0o755)).expect("rights");
        Stage { folder }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn run(&self) -> PathBuf {
        self.path("run")
    }

    /// Returns the command of a small `iwol train`; its processes have the folder's name in their
    /// environment.
    fn train(&self, more: &[&str]) -> Command {
        let settings = [
            "train.envs=4",
            "train.rollout_steps=32",
            "train.validate_every=1000000",
            "train.validation_episodes=1",
            "network.hidden=8",
            "simulation.processes=2",
            "simulation.timeout=1",
        ];
        let more = [&["--agents", "4", "--algorithm", "mappo"], more].concat();
        let mut command = support::train(&self.run(), &settings, &more);
        command.env("FAULT_STAGE", self.folder.path()).stdout(Stdio::null()).stderr(Stdio::piped());
        command
    }

    fn faulty(&self, kind: &str, once: bool, more: &[&str]) -> Command {
        let mut command = self.train(more);
        command
            .env("SUMO_HOME", self.path("home"))
            .env("FAULT_REAL", Installation::find().expect("SUMO").binary())
            .env("FAULT_KIND", kind);
        command
            .env("FAULT_AFTER", "20")
            .env("FAULT_ONCE", if once { self.path("once") } else { PathBuf::new() });
        command
    }

    fn nobody_is_left(&self) {
        let word = self.folder.path().display().to_string();
        wait_until("every process is gone", 5, || processes_with(&word).is_empty());
    }
}

/// Runs a command to its end, within a time limit.
fn finish(command: &mut Command, seconds: u64) -> Output {
    let child = command.spawn().expect("the program runs");
    let pid = child.id();
    let waiting = thread::spawn(move || child.wait_with_output());
    let begin = Instant::now();
    while !waiting.is_finished() {
        if begin.elapsed() > Duration::from_secs(seconds) {
            signal(pid, "KILL");
            panic!("not done after {seconds} s");
        }
        thread::sleep(Duration::from_millis(10));
    }
    waiting.join().expect("no panic").expect("an end")
}

/// Kinds of faults, each with a part of the message that reports it.
const KINDS: [(&str, &str); 5] = [
    ("garbage", "not a TraCI answer"),
    ("cut", "closed the connection"),
    ("slow", "no answer to"),
    ("silent", "no answer to"),
    ("exit", "out of fuel"),
];

#[test]
fn a_run_goes_on_when_one_sumo_fails() {
    let _beside = beside_others();
    for (kind, reason) in KINDS {
        let stage = Stage::new();
        let output = finish(&mut stage.faulty(kind, true, &["--steps", "512"]), 60);
        let errors = text(&output.stderr);
        assert_eq!(output.status.code(), Some(0), "{kind}: {errors}");
        let warned = ["WARN", reason, "are dropped and SUMO starts afresh"]
            .iter()
            .all(|words| errors.contains(words));
        assert!(warned, "{kind}: {errors}");
        let metrics = fs::read_to_string(stage.run().join("metrics.jsonl")).expect("metrics");
        let mut restarts = metrics.lines().filter_map(|line| {
            serde_json::from_str::<serde_json::Value>(line).expect("whole lines")["resets/restarts"].as_f64()
        });
        assert_eq!(restarts.next_back(), Some(1.0), "{kind}");
        stage.nobody_is_left();
    }
}

#[test]
fn a_run_whose_sumos_all_fail_ends_with_an_error_and_a_checkpoint() {
    let _beside = beside_others();
    for (kind, reason) in KINDS {
        let stage = Stage::new();
        let output = finish(&mut stage.faulty(kind, false, &["--steps", "512"]), 60);
        let errors = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{kind}: {errors}");
        assert_eq!(errors.matches("error:").count(), 1, "{kind}: {errors}");
        assert!(errors.contains(reason) && errors.contains("--resume"), "{kind}: {errors}");
        stage.nobody_is_left();
        // With a working SUMO, the run resumes and ends normally.
        let output = finish(&mut stage.train(&["--steps", "256", "--resume"]), 60);
        assert_eq!(output.status.code(), Some(0), "{kind}: {}", text(&output.stderr));
    }
}

#[test]
fn a_validation_that_fails_costs_nothing_that_was_learned() {
    let _beside = beside_others();
    let stage = Stage::new();
    // Of the processes that open a port, the fourth and all later ones fail: those are the ones of
    // the validation. The first is asked for its version, the next two train.
    let script = r#"#!/bin/sh
case "$*" in *--remote-port*)
    n=$(cat "$FAULT_STAGE/starts" 2>/dev/null || echo 0)
    echo $((n + 1)) > "$FAULT_STAGE/starts"
    [ "$n" -lt 3 ] || { echo "Error: no fuel" >&2; exit 1; } ;;
esac
exec "$FAULT_REAL" "$@"
"#;
    fs::write(stage.path("home/bin/sumo"), script).expect("a file");
    let more = ["--steps", "512", "--set", "train.validate_every=256"];
    let output = finish(&mut stage.faulty("none", true, &more), 60);
    let errors = text(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{errors}");
    assert!(
        errors.contains("no fuel")
            && errors.contains("after 256 steps")
            && errors.contains("--resume"),
        "{errors}"
    );
    stage.nobody_is_left();
    let output = finish(
        &mut stage.train(&["--steps", "512", "--set", "train.validate_every=256", "--resume"]),
        60,
    );
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
}

fn env(worlds: usize, processes: usize) -> VecEnv {
    let hosting = Hosting { processes, timeout: Duration::from_millis(500), ..Hosting::default() };
    VecEnv::new(&task("intersection", 8), &agents_drive(worlds, 1, hosting)).expect("SUMO runs")
}

fn sumos_of_this_process() -> Vec<u32> {
    sumo_children(std::process::id())
}

#[test]
fn a_stopped_sumo_costs_its_worlds_episodes() {
    let _alone = alone();
    let mut env = env(4, 2);
    let actions = [0.4; 32];
    for _ in 0..10 {
        env.step(&actions).expect("a step");
    }
    let stopped = sumos_of_this_process()[0];
    signal(stopped, "STOP");
    let begin = Instant::now();
    env.step(&actions).expect("the worlds are taken over by another SUMO");
    assert!(begin.elapsed() < Duration::from_secs(5));
    assert_eq!((env.resets().loads, env.resets().restarts), (0, 1));
    let interrupted = env.take_finished();
    assert_eq!(interrupted.len(), 2);
    assert!(interrupted.iter().all(|record| record.interrupted));
    assert!(!sumos_of_this_process().contains(&stopped), "a stopped SUMO is ended all the same");
    for _ in 0..10 {
        env.step(&actions).expect("a step");
    }
    drop(env);
    assert_eq!(sumos_of_this_process(), [0_u32; 0]);
}

#[test]
fn a_simulation_is_made_fresh_by_the_cheapest_means_that_is_sound() {
    let _beside = beside_others();
    let task = task("intersection", 8);
    for worlds in [1, 3] {
        let mut simulation =
            TraciSimulation::start(task.simulation_config(1, worlds, &Hosting::default()))
                .expect("SUMO");
        let pid = simulation.pid();
        for _ in 0..5 {
            simulation.step(&[]).expect("a step");
        }
        assert_eq!(simulation.renew().expect("fresh"), Renewal::Loaded);
        assert_eq!(simulation.pid(), pid);
        let time = simulation.step(&[]).expect("a step").time;
        assert!((time - 0.1).abs() < 1e-9, "{time}");
        // During an exchange, only a new process is in a known state.
        simulation.send(&[]).expect("sent");
        assert_eq!(simulation.renew().expect("fresh"), Renewal::Restarted);
        assert_ne!(simulation.pid(), pid);
    }
}

#[test]
fn a_full_disk_leaves_the_last_checkpoint_whole() {
    let _beside = beside_others();
    let stage = Stage::new();
    let train = |more: &[&str]| stage.train(&[&["--set", "network.hidden=128"], more].concat());
    let output = finish(&mut train(&["--steps", "128"]), 60);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let last = stage.run().join("checkpoints/last.safetensors");
    let before = fs::read(&last).expect("a checkpoint");
    // Files may grow to 256 blocks of 512 bytes, less than a checkpoint; further writes fail as on
    // a full disk.
    assert!(before.len() > 2 * 256 * 512, "a checkpoint of {} bytes", before.len());
    let mut limited = Command::new("sh");
    limited.args(["-c", "ulimit -f 256; exec \"$@\"", "sh"]);
    let resume = train(&["--steps", "256", "--resume"]);
    limited.arg(resume.get_program()).args(resume.get_args()).current_dir(root());
    limited.stdout(Stdio::null()).stderr(Stdio::piped()).env("FAULT_STAGE", stage.folder.path());
    let output = finish(&mut limited, 60);
    let errors = text(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{errors}");
    assert!(errors.contains("checkpoints"), "names the file: {errors}");
    assert!(fs::read(&last).expect("a checkpoint") == before, "the old checkpoint is untouched");
    let names: Vec<_> =
        fs::read_dir(stage.run().join("checkpoints")).expect("a folder").flatten().collect();
    assert!(names.len() <= 2, "no litter: {names:?}");
    stage.nobody_is_left();
    let output = finish(&mut train(&["--steps", "256", "--resume"]), 60);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
}

#[test]
fn a_signal_at_any_moment_ends_the_run_in_order() {
    let _beside = beside_others();
    for milliseconds in [0, 20, 60, 120, 250, 500, 900] {
        let stage = Stage::new();
        let mut child: Child =
            stage.train(&["--steps", "1000000"]).spawn().expect("the program runs");
        thread::sleep(Duration::from_millis(milliseconds));
        // SIGINT is not used: if this test runs in the background, SIGINT may be ignored until the
        // program handles it.
        signal(child.id(), "TERM");
        let begin = Instant::now();
        let status = loop {
            if let Some(status) = child.try_wait().expect("a child") {
                break status;
            }
            if begin.elapsed() > Duration::from_secs(20) {
                signal(child.id(), "KILL");
                panic!("no end after {milliseconds} ms");
            }
            thread::sleep(Duration::from_millis(5));
        };
        // Before the program handles the signal, the signal simply ends it.
        assert!(
            status.code() == Some(130) || status.code().is_none(),
            "after {milliseconds} ms: {status}"
        );
        stage.nobody_is_left();
        if status.code() == Some(130) && stage.run().join("config.toml").exists() {
            let output = finish(&mut stage.train(&["--steps", "128", "--resume"]), 60);
            assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        }
    }
}

#[test]
fn sixty_four_sumos_start_at_once() {
    let _alone = alone();
    let task = task("intersection", 8);
    let config = task.simulation_config(1, 1, &Hosting::default());
    let mut all: Vec<TraciSimulation> = thread::scope(|scope| {
        let starting: Vec<_> = (0..64)
            .map(|_| scope.spawn(|| TraciSimulation::start(config.clone()).expect("SUMO")))
            .collect();
        starting.into_iter().map(|thread| thread.join().expect("no panic")).collect()
    });
    for simulation in &mut all {
        assert!(
            (simulation.step(&[]).expect("a step").time - 0.1).abs() < 1e-9,
            "each talks to its own"
        );
    }
    drop(all);
    assert_eq!(sumos_of_this_process(), [0_u32; 0]);
}

fn resident_kilobytes(pid: u32) -> u64 {
    let status = fs::read_to_string(format!("/proc/{pid}/status")).expect("a process");
    let line = status.lines().find(|line| line.starts_with("VmRSS")).expect("memory");
    line.split_whitespace().nth(1).and_then(|n| n.parse().ok()).expect("a number")
}

#[test]
fn ten_thousand_resets_take_no_memory() {
    let _alone = alone();
    let mut env = env(1, 1);
    let (sumo, this) = (sumos_of_this_process()[0], std::process::id());
    let mut memory = Vec::new();
    for reset in 0..=10_000 {
        if reset % 2000 == 0 {
            memory.push((resident_kilobytes(sumo), resident_kilobytes(this)));
        }
        env.reset();
        env.step(&[0.5; 8]).expect("a step");
    }
    assert_eq!(env.resets().respawns, 10_002);
    let (first, last) = (memory[1], memory[memory.len() - 1]);
    assert!(
        last.0 < first.0 + 1024 && last.1 < first.1 + 1024,
        "[SUMO, this program] in kB: {memory:?}"
    );
}

#[test]
fn loading_again_and_again_takes_no_memory() {
    let _beside = beside_others();
    let task = task("intersection", 8);
    let mut simulation =
        TraciSimulation::start(task.simulation_config(1, 1, &Hosting::default())).expect("SUMO");
    let mut memory = Vec::new();
    for round in 0..=400 {
        if round % 100 == 0 {
            memory.push(resident_kilobytes(simulation.pid()));
        }
        assert_eq!(simulation.renew().expect("fresh"), Renewal::Loaded);
        simulation.step(&[]).expect("a step");
    }
    assert!(memory[4] < memory[1] + 2048, "SUMO in kB: {memory:?}");
}

#[test]
fn another_sumo_home_is_used() {
    let _beside = beside_others();
    let stage = Stage::new();
    // This `SUMO_HOME` contains only a link to the real program.
    let home = stage.path("linked/bin");
    fs::create_dir_all(&home).expect("a folder");
    symlink(Installation::find().expect("SUMO").binary(), home.join("sumo")).expect("a link");
    let mut train = stage.train(&["--steps", "128"]);
    let output = finish(train.env("SUMO_HOME", stage.path("linked")), 60);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
}
