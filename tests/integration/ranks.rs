//! One training over several processes, started by MPI's own launcher, on the real SUMO.

#![cfg(feature = "mpi")]

use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use iwol_sumo::checkpoint::Checkpoint;
use tch::Kind;

use crate::support::folder;

/// On SUMO, and in an environment without it, whose worlds have no counters to exchange.
const SUMO: [&str; 4] = [
    "scenario=scenarios/intersection.xml",
    "agents=4",
    "simulation.backend=traci",
    "simulation.processes=2",
];
const WITHOUT: [&str; 3] = [
    "environment=traffic_junction_easy",
    // So many that decisions are divided.
    "train.envs=52",
    "train.rollout_steps=16",
];

const SETTINGS: [&str; 8] = [
    "train.envs=4",
    "train.rollout_steps=128",
    "train.validate_every=1000",
    "train.validation_episodes=6",
    "ppo.shards=4",
    "ppo.minibatch=512",
    "seed=3",
    "algorithm=ex-iwol",
];

/// Returns a training for `steps` steps, in `size` processes of MPI if there are several.
fn training(size: usize, out: &Path, steps: u32, place: &[&str]) -> Command {
    let program = env!("CARGO_BIN_EXE_iwol");
    let mut command = match size {
        1 => Command::new(program),
        _ => Command::new("mpirun"),
    };
    if size > 1 {
        // More processes than cores, also for root in a container.
        command.args(["--allow-run-as-root", "--oversubscribe", "-n", &size.to_string(), program]);
    }
    command.args(["train", "--steps", &steps.to_string(), "--out"]).arg(out);
    for set in SETTINGS.iter().chain(place) {
        command.args(["--set", set]);
    }
    command.current_dir(env!("CARGO_MANIFEST_DIR")).stdout(Stdio::null()).stderr(Stdio::piped());
    command
}

fn end(child: Child) -> (bool, String) {
    let output = child.wait_with_output().expect("it ends");
    (output.status.success(), String::from_utf8_lossy(&output.stderr).into_owned())
}

/// Returns all numbers of a run's last checkpoint, and the lines of its validations.
fn content(run: &Path) -> (BTreeMap<String, Vec<f64>>, String) {
    let stored = Checkpoint::load(&run.join("checkpoints/last.safetensors")).expect("a checkpoint");
    let numbers = |tensor: &tch::Tensor| {
        Vec::try_from(tensor.to_kind(Kind::Double).reshape([-1])).expect("numbers")
    };
    let named = stored.learner.iter().map(|(name, tensor)| (name.clone(), numbers(tensor)));
    let validations = std::fs::read_to_string(run.join("eval.jsonl")).expect("validations");
    (named.collect(), validations)
}

/// Two and four processes have the weights and the validations of one, to the bit, and one folder.
#[test]
fn processes_train_as_one_does() {
    let folder = folder();
    let run = |size: usize, name: &str, place: &[&str]| {
        let out = folder.path().join(format!("{name}_{size}"));
        let (fine, text) =
            end(training(size, &out, 2048, place).spawn().expect("mpirun is installed"));
        assert!(fine, "{size}: {text}");
        let divided = format!("{size} processes divide worlds and updates");
        assert_eq!(text.matches(&divided).count(), usize::from(size > 1), "{text}");
        content(&out)
    };
    for (name, place, sizes) in [("sumo", &SUMO[..], &[2, 4][..]), ("without", &WITHOUT, &[2])] {
        let alone = run(1, name, place);
        assert!(alone.1.lines().count() >= 12, "{}", alone.1);
        for size in sizes {
            assert!(run(*size, name, place) == alone, "{name}: {size} processes differ");
        }
    }
    let folders = std::fs::read_dir(folder.path()).expect("a folder").count();
    assert_eq!(folders, 5, "each run has one folder");
}

fn children(of: u32) -> Vec<u32> {
    let threads = std::fs::read_dir(format!("/proc/{of}/task")).into_iter().flatten();
    let text = threads
        .flatten()
        .map(|thread| std::fs::read_to_string(thread.path().join("children")).unwrap_or_default());
    let text: String = text.collect();
    text.split_whitespace().filter_map(|id| id.parse().ok()).collect()
}

/// A process that dies ends the run with an error. The checkpoint of the last validation is there,
/// from which as many processes go on, and no SUMO is left.
#[test]
fn a_process_that_dies_ends_the_run() {
    let folder = folder();
    let out = folder.path().join("run");
    let child = training(2, &out, 1_000_000, &SUMO).spawn().expect("mpirun is installed");
    let begin = Instant::now();
    let last = out.join("checkpoints/last.safetensors");
    while !last.exists() {
        assert!(begin.elapsed() < Duration::from_secs(120), "no checkpoint");
        std::thread::sleep(Duration::from_millis(50));
    }
    let ranks = children(child.id());
    assert_eq!(ranks.len(), 2, "{ranks:?}");
    let simulators: Vec<u32> = ranks.iter().flat_map(|rank| children(*rank)).collect();
    assert!(!simulators.is_empty(), "each process has SUMO");
    let killed = Command::new("kill").args(["-9", &ranks[1].to_string()]).status();
    assert!(killed.expect("kill is installed").success());
    let (fine, text) = end(child);
    assert!(!fine && text.contains("exited on signal 9"), "{text}");
    let gone = |id: &u32| !Path::new(&format!("/proc/{id}")).exists();
    while !simulators.iter().all(gone) {
        assert!(begin.elapsed() < Duration::from_secs(180), "SUMO is left");
        std::thread::sleep(Duration::from_millis(50));
    }
    let stored = Checkpoint::load(&last).expect("a whole checkpoint");
    let more = (stored.progress.step + 512) as u32;
    let mut again = training(2, &out, more, &SUMO);
    let (fine, text) = end(again.arg("--resume").spawn().expect("mpirun is installed"));
    assert!(fine && text.contains(&format!("finished after {more} steps")), "{text}");
}

/// Processes without work to do are refused by all of them, with the setting.
#[test]
fn more_processes_than_shards_are_refused() {
    let folder = folder();
    let mut command = training(3, &folder.path().join("run"), 1000, &SUMO);
    command.args(["--set", "ppo.shards=2"]);
    let (fine, text) = end(command.spawn().expect("mpirun is installed"));
    assert!(!fine && text.contains("ppo.shards is 2, so that 3 processes"), "{text}");
}
