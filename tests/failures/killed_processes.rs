//! Tests of processes that die: a killed SUMO costs only its world's episode, an interrupted run
//! keeps a checkpoint, and no SUMO outlives the program.

use std::fs;
use std::path::Path;
use std::process::{Child, Stdio};
use std::thread;
use std::time::Duration;

use iwol_sumo::env::VecEnv;
use iwol_sumo::sumo::Hosting;

use crate::support::{self, agents_drive, folder, task};
use crate::{alone, beside_others, signal, sumo_children, wait_until};

#[test]
fn a_killed_sumo_costs_its_episode_only() {
    let _alone = alone();
    let options = agents_drive(3, 1, Hosting { processes: 3, ..Hosting::default() });
    let task = task("intersection", 8);
    let mut env = VecEnv::new(&task, &options).expect("SUMO runs");
    let mut undisturbed = VecEnv::new(&task, &options).expect("SUMO runs");
    let actions = [0.4; 24];
    for _ in 0..30 {
        env.step(&actions).expect("a step");
        undisturbed.step(&actions).expect("a step");
    }
    // One of the six processes is killed; the results show which environment and world it hosted.
    signal(sumo_children(std::process::id())[0], "KILL");
    let mut interrupted = Vec::new();
    for _ in 0..3 {
        env.step(&actions).expect("the world is restarted");
        undisturbed.step(&actions).expect("a step");
        interrupted.extend(env.take_finished());
        interrupted.extend(undisturbed.take_finished());
    }
    assert_eq!(interrupted.iter().filter(|record| record.interrupted).count(), 1);
    assert_eq!(env.resets().restarts + undisturbed.resets().restarts, 1);
    let hit = if env.resets().restarts == 1 { &env } else { &undisturbed };
    let restored = VecEnv::restore(&task, &options, &hit.states()).expect("SUMO runs");
    assert_eq!(
        restored.states(),
        hit.states(),
        "a world that waits for its next episode goes on waiting for it"
    );
    drop(restored);
    let (hit, spared) =
        if env.resets().restarts == 1 { (&env, &undisturbed) } else { (&undisturbed, &env) };
    assert_eq!(spared.resets().restarts, 0);
    let mut fresh = 0;
    for (world, reference) in hit.worlds().zip(spared.worlds()) {
        if world.episode() == reference.episode() {
            assert_eq!(world.frame(), reference.frame(), "the other worlds do not notice");
        } else {
            fresh += 1;
            assert_eq!(world.frame().active, vec![1.0; 8], "the next episode has begun");
        }
    }
    assert_eq!(fresh, 1);
    drop((env, undisturbed));
    assert_eq!(sumo_children(std::process::id()), [0_u32; 0], "no process is left");
}

fn train(run: &Path, more: &[&str]) -> Child {
    let mut settings = vec![
        "train.envs=2",
        "train.rollout_steps=16",
        "network.hidden=8",
        "iwol.rounds=1",
        "simulation.processes=2",
    ];
    settings.extend(more);
    let mut train = support::train(run, &settings, &["--agents", "4", "--steps", "1000000"]);
    train.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().expect("the program runs")
}

#[test]
fn an_interrupted_run_leaves_a_checkpoint_and_no_process() {
    let _beside = beside_others();
    let folder = folder();
    let run = folder.path().join("run");
    let mut child = train(&run, &[]);
    wait_until("the first iterations", 60, || {
        fs::read_to_string(run.join("metrics.jsonl")).is_ok_and(|text| text.lines().count() >= 2)
    });
    let workers = sumo_children(child.id());
    assert_eq!(workers.len(), 2);
    signal(child.id(), "INT");
    let status = child.wait().expect("it ends");
    assert_eq!(status.code(), Some(130));
    assert!(run.join("checkpoints/last.safetensors").exists());
    for pid in workers {
        wait_until("SUMO is gone", 5, || !Path::new(&format!("/proc/{pid}")).exists());
    }
    let lines = fs::read_to_string(run.join("metrics.jsonl")).expect("metrics");
    assert!(
        lines.lines().all(|line| serde_json::from_str::<serde_json::Value>(line).is_ok()),
        "whole lines"
    );
}

/// An interrupt gives up the current iteration, here one with an update that takes long. The
/// checkpoint is the state before it.
#[test]
fn an_interrupt_does_not_wait_for_an_update() {
    let _beside = beside_others();
    let folder = folder();
    let run = folder.path().join("run");
    let mut child = train(&run, &["ppo.epochs=1000", "ppo.minibatch=8"]);
    wait_until("SUMO runs", 60, || {
        run.join("metrics.jsonl").exists() && sumo_children(child.id()).len() == 2
    });
    // The rollout has 16 steps and ends soon.
    thread::sleep(Duration::from_secs(2));
    signal(child.id(), "INT");
    let mut code = None;
    wait_until("the program ends", 10, || {
        code = child.try_wait().expect("its state").map(|status| status.code());
        code.is_some()
    });
    assert_eq!(code, Some(Some(130)));
    assert!(run.join("checkpoints/last.safetensors").exists());
    assert_eq!(fs::read_to_string(run.join("metrics.jsonl")).expect("metrics"), "");
}

/// The first interrupt lets an update of MADDPG finish, here a long one; a second interrupt ends the
/// program at once.
#[test]
fn a_second_interrupt_ends_it_at_once() {
    let _beside = beside_others();
    let folder = folder();
    let run = folder.path().join("run");
    let settings = ["algorithm=maddpg", "maddpg.updates=5000", "ppo.minibatch=8"];
    let mut child = train(&run, &settings);
    wait_until("the first iteration", 120, || {
        fs::read(run.join("metrics.jsonl")).is_ok_and(|text| !text.is_empty())
    });
    let workers = sumo_children(child.id());
    assert_eq!(workers.len(), 2);
    // The next rollout has 16 steps and ends soon.
    thread::sleep(Duration::from_secs(1));
    signal(child.id(), "INT");
    thread::sleep(Duration::from_secs(1));
    assert_eq!(
        child.try_wait().expect("its state"),
        None,
        "it did not wait for an update of 5,000 steps"
    );
    signal(child.id(), "INT");
    let mut code = None;
    wait_until("the program ends", 5, || {
        code = child.try_wait().expect("its state").map(|status| status.code());
        code.is_some()
    });
    assert_eq!(code, Some(Some(130)));
    for pid in workers {
        wait_until("SUMO is gone", 5, || !Path::new(&format!("/proc/{pid}")).exists());
    }
}

#[test]
fn even_a_killed_program_leaves_no_process() {
    let _beside = beside_others();
    let folder = folder();
    let run = folder.path().join("run");
    let mut child = train(&run, &[]);
    wait_until("SUMO runs", 60, || {
        run.join("metrics.jsonl").exists() && sumo_children(child.id()).len() == 2
    });
    let workers = sumo_children(child.id());
    signal(child.id(), "KILL");
    child.wait().expect("it ends");
    for pid in workers {
        wait_until("SUMO is gone", 5, || !Path::new(&format!("/proc/{pid}")).exists());
    }
}
