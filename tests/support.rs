//! What several tests need: the project's files, tasks and evaluations of shipped scenarios, and
//! runs of the program `iwol`.

use std::{
    path::Path,
    process::{Command, Output},
    sync::{Arc, Mutex, MutexGuard, PoisonError, atomic::AtomicBool},
};

use iwol_sumo::{
    driving::{Policy, evaluate},
    env::{Driver, Task, VecOptions},
    evaluate::{Evaluation, EvaluationObserver},
    rng::Seed,
    scenario::Scenario,
    sumo::{Backend, Hosting},
};
use rayon::prelude::*;
use tempfile::TempDir;

pub const INTERSECTION: &str = "scenarios/intersection.xml";

/// Returns the project's folder.
pub fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Creates a temporary folder.
pub fn folder() -> TempDir {
    tempfile::tempdir().expect("a folder")
}

/// Applies `work` to all items, on half of the cores: other tests run at the same time.
pub fn in_parallel<T: Send>(items: Vec<T>, work: impl Fn(T) + Sync + Send) {
    // A test's own threads write what they say into the test's output; those of a common pool would
    // write into that of another test.
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(cores.div_ceil(2)).stack_size(8 << 20);
    let pool = pool.build().expect("threads");
    pool.install(|| items.into_par_iter().for_each(work));
}

/// Loads the scenario `scenarios/NAME.xml`.
pub fn shipped(name: &str) -> Scenario {
    Scenario::load(&root().join(format!("scenarios/{name}.xml"))).expect("the shipped scenario")
}

/// Returns the task of the scenario `scenarios/NAME.xml` for a number of agents.
pub fn task(name: &str, agents: u32) -> Arc<Task> {
    Arc::new(Task::new(&shipped(name), agents).expect("a task"))
}

/// Returns options of worlds whose vehicles the agents drive, in an endless stream of episodes.
pub fn agents_drive(worlds: usize, seed: u64, hosting: Hosting) -> VecOptions {
    VecOptions {
        repeat_failed: 0.0,
        worlds,
        stride: worlds as u64,
        driver: Driver::Agents,
        seed: Seed::new(seed),
        episodes: 0..u64::MAX,
        hosting,
    }
}

/// Evaluates a policy over a number of episodes, with SUMO processes.
pub fn play(task: &Arc<Task>, policy: &Policy<'_>, episodes: u64, seed: Seed) -> Evaluation {
    let observer = EvaluationObserver {
        stop: &AtomicBool::new(false),
        report: &mut |_| {},
        recorder: None,
        beside: false,
    };
    evaluate(task, policy, episodes, seed, &Hosting::default(), observer)
        .expect("SUMO runs; else run scripts/bootstrap")
}

/// Waits for libsumo, if `backend` is libsumo, and returns the right to use it: a process holds one
/// simulation of libsumo at a time.
pub fn turn(backend: Backend) -> Option<MutexGuard<'static, ()>> {
    static LIBSUMO: Mutex<()> = Mutex::new(());
    (backend == Backend::Libsumo).then(|| LIBSUMO.lock().unwrap_or_else(PoisonError::into_inner))
}

/// Returns a command that runs `iwol` in the project's folder.
pub fn iwol(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_iwol"));
    command.current_dir(root()).args(arguments).env("NO_COLOR", "1");
    command
}

/// Returns a command that trains on the shipped intersection, with settings `name=value`.
pub fn train(out: &Path, settings: &[&str], more: &[&str]) -> Command {
    let mut command = iwol(&["train", "--out"]);
    command.arg(out);
    if !more.contains(&"--resume") {
        command.args(["--scenario", INTERSECTION]);
    }
    command.args(settings.iter().flat_map(|setting| ["--set", setting])).args(more);
    command
}

pub fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Runs a command to its end; panics if it fails.
pub fn succeeds(command: &mut Command) -> Output {
    let output = command.output().expect("it ran");
    assert!(output.status.success(), "{command:?}: {}", text(&output.stderr));
    output
}

/// Runs a command that fails, and returns its exit code and standard error, one per line; panics if
/// the command prints to standard output, which is for data.
pub fn failure(command: &mut Command) -> String {
    let output = command.output().expect("it ran");
    assert_eq!(text(&output.stdout), "", "stdout is for data");
    format!("{}\n{}", output.status.code().unwrap_or(-1), text(&output.stderr))
}
