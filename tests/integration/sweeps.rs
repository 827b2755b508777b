//! Tests of sweeps with real SUMO: interruptions do not change results, and failures are reported.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use iwol_sumo::config::{Config, Document, Layers};
use iwol_sumo::sweep::Sweep;
use serde_json::Value;

use crate::support::{folder, iwol, root, succeeds, text};

const FILE: &str = r#"
title = "Tiny"
[settings]
scenario.file = "scenarios/intersection.xml"
scenario.termination.horizon = 400
agents = 4
steps = 4096
train = { envs = 2, rollout_steps = 64, validate_every = 512, validation_episodes = 2, anneal_steps = 512 }
[grid]
algorithm = ["mappo"]
seed = [0, 1]
[[evaluate]]
name = "range"
episodes = 3
grid = { "scenario.communication.range" = [100.0, 10.0] }
[[reference]]
label = "published"
beside = "mappo"
metric = "success"
x = [100.0]
y = [0.5]
[[evaluate]]
name = "plain"
episodes = 2
[[reference]]
label = "published, plain"
beside = "mappo"
metric = "success"
evaluate = "plain"
y = [0.25]
[[reference]]
label = "published, plain"
beside = "mappo"
metric = "window_reward"
evaluate = "plain"
y = [300.0]
"#;

fn sweep_file(folder: &Path, text: &str) -> PathBuf {
    let path = folder.join("tiny.toml");
    std::fs::write(&path, text).expect("written");
    path
}

fn sweep(file: &Path, out: &Path, more: &[&str]) -> Command {
    let mut command = iwol(&["sweep"]);
    command.arg(file).arg("--out").arg(out).args(more);
    command
}

/// Returns all results of a sweep, without times.
fn findings(out: &Path) -> BTreeMap<String, String> {
    let mut findings = BTreeMap::new();
    for seed in [0, 1] {
        let folder = out.join(format!("tiny/mappo/seed_{seed}"));
        let metrics = std::fs::read_to_string(folder.join("metrics.jsonl")).expect("metrics");
        let lines = metrics.lines().map(|line| {
            let mut line: Value = serde_json::from_str(line).expect("JSON");
            let object = line.as_object_mut().expect("an object");
            object.retain(|key, _| {
                !key.starts_with("time/")
                    && key != "steps_per_second"
                    && !key.starts_with("resets/")
            });
            line.to_string()
        });
        findings.insert(format!("{seed} metrics"), lines.collect::<Vec<_>>().join("\n"));
        for file in std::fs::read_dir(folder.join("evaluations")).expect("evaluations") {
            let path = file.expect("a file").path();
            let name = format!("{seed} {}", path.file_name().expect("a name").to_string_lossy());
            findings.insert(name, std::fs::read_to_string(&path).expect("JSON"));
        }
    }
    assert_eq!(findings.len(), 8, "two runs with three evaluations each");
    findings
}

/// Returns the child processes of a process, over all of its threads.
fn children(parent: u32) -> Vec<u32> {
    let threads = std::fs::read_dir(format!("/proc/{parent}/task")).expect("it runs");
    let of_thread =
        |path: PathBuf| std::fs::read_to_string(path.join("children")).unwrap_or_default();
    let all: String = threads.flatten().map(|thread| of_thread(thread.path())).collect();
    all.split_whitespace().map(|pid| pid.parse().expect("a number")).collect()
}

/// A child process that is killed on drop, e.g. when a test fails.
struct Killed(Child);

impl Drop for Killed {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn until(what: &str, condition: impl Fn() -> bool) {
    let since = Instant::now();
    while !condition() {
        assert!(since.elapsed() < Duration::from_secs(120), "{what} does not come");
        std::thread::sleep(Duration::from_millis(20));
    }
}

#[test]
fn a_sweep_that_is_killed_goes_on_and_finds_the_same() {
    let folder = folder();
    let file = sweep_file(folder.path(), FILE);
    let (undisturbed, cut) = (folder.path().join("undisturbed"), folder.path().join("cut"));

    let output = succeeds(&mut sweep(&file, &undisturbed, &["--jobs", "2"]));
    assert!(
        text(&output.stdout).contains("2 of 2 cells finished, 0 failed"),
        "{}",
        text(&output.stdout)
    );

    let mut first = Killed(
        sweep(&file, &cut, &[])
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("it starts"),
    );
    let checkpoint = cut.join("tiny/mappo/seed_0/checkpoints/last.safetensors");
    until("a checkpoint", || checkpoint.exists());
    // After a SIGKILL the sweep cannot stop its child; the child must end by itself and unlock its
    // folder.
    first.0.kill().expect("killed");
    first.0.wait().expect("gone");
    let lock = cut.join("tiny/mappo/seed_0/.lock");
    until("the end of the child", || {
        std::fs::File::open(&lock).is_ok_and(|lock| lock.try_lock().is_ok())
    });
    assert!(!cut.join("tiny/mappo/seed_1").exists());
    let output = succeeds(&mut sweep(&file, &cut, &["--dry-run"]));
    assert!(text(&output.stdout).contains("0 of 2 cells finished"), "{}", text(&output.stdout));

    // If only the child is stopped, the cell has not failed, and the other cell runs.
    let metrics = || {
        std::fs::metadata(cut.join("tiny/mappo/seed_0/metrics.jsonl")).map_or(0, |file| file.len())
    };
    let had = metrics();
    let log = folder.path().join("second.log");
    let stderr = std::fs::File::create(&log).expect("a file");
    let mut second = Killed(
        sweep(&file, &cut, &[]).stdout(Stdio::null()).stderr(stderr).spawn().expect("it starts"),
    );
    until("progress", || metrics() > had);
    let [child] = children(second.0.id())[..] else { panic!("one child") };
    succeeds(Command::new("kill").arg(child.to_string()));
    let status = second.0.wait().expect("it ran");
    let said = std::fs::read_to_string(&log).expect("text");
    assert_eq!(status.code(), Some(1), "{said}");
    assert!(
        said.contains("mappo/seed_0 interrupted after")
            && said.contains("1 of 2 cells are not finished"),
        "{said}"
    );

    let output = succeeds(&mut sweep(&file, &cut, &[]));
    assert!(text(&output.stderr).contains("1 of 2 cells to do"), "{}", text(&output.stderr));
    assert_eq!(findings(&cut), findings(&undisturbed));

    // Everything is finished, so nothing runs again.
    let output = succeeds(&mut sweep(&file, &cut, &[]));
    assert!(text(&output.stderr).contains("0 of 2 cells to do"), "{}", text(&output.stderr));
    report(&file, &cut, folder.path());
}

#[test]
fn two_sweeps_of_one_folder_share_its_cells() {
    let folder = folder();
    let file = sweep_file(folder.path(), FILE);
    let out = folder.path().join("runs");
    let start = |log: &Path| {
        let log = std::fs::File::create(log).expect("a file");
        let mut command = sweep(&file, &out, &["--jobs", "2"]);
        Killed(command.stdout(Stdio::null()).stderr(log).spawn().expect("it starts"))
    };
    let logs = ["first.log", "second.log"].map(|name| folder.path().join(name));
    let mut both = logs.each_ref().map(|log| start(log));
    for sweep in &mut both {
        sweep.0.wait().expect("it ran");
    }
    let said = logs.map(|log| std::fs::read_to_string(log).expect("text")).concat();
    assert!(!said.contains("FAILED"), "{said}");
    assert!(said.contains("left to another process after 0.0 s"), "nobody waits: {said}");
    for seed in [0, 1] {
        let cell = out.join(format!("tiny/mappo/seed_{seed}"));
        let log = std::fs::read_to_string(cell.join("sweep.log")).expect("text");
        assert_eq!(log.matches("parameters").count(), 1, "trained once: {log}");
        assert!(!log.contains("error:"), "{log}");
    }
    assert_eq!(findings(&out).len(), 8);
}

/// Checks the contents of the report of a finished sweep.
fn report(file: &Path, runs: &Path, folder: &Path) {
    let (out, kept) = (folder.join("report"), folder.join("kept"));
    let make = |runs: &Path, more: &[&Path]| {
        let files = [file, Path::new("--runs"), runs, Path::new("-o"), &out];
        succeeds(iwol(&["report"]).args(files).args(more));
        std::fs::read_to_string(out.join("report.md")).expect("written")
    };
    // The report from the kept files, which contain no weights, is the same but for the command.
    let first = make(runs, &[Path::new("--keep"), &kept]);
    let [from, to] = [runs, &kept].map(|folder| folder.display().to_string());
    assert_eq!(make(&kept, &[]), first.replace(&from, &to));
    assert!(!kept.join("tiny/mappo/seed_0/checkpoints").exists());
    let read = |name: &str| std::fs::read_to_string(out.join(name)).expect("written");
    let markdown = read("report.md");
    for part in [
        "2 of 2 runs are finished",
        "| success % at communication range (± t-interval over seeds) | 100.0 | 10.0 |",
        "| published | 50.0 | – |",
        // With a single place, all metrics are columns of one table; delay only if somebody arrives.
        "| ± t-interval over seeds | success % | safety % | crash % |",
        "| reward | window reward (throughput) | loitering % |",
        "| published, plain | 25.0 | – | – |",
        "| – | 300.0 | – |",
        "km per crash",
        "Evaluated by iwol",
    ] {
        assert!(markdown.contains(part), "{part} is missing in {markdown}");
    }
    assert!(read("report.html").contains("data:image/png;base64,"));
    let summary: Value = serde_json::from_str(&read("summary.json")).expect("JSON");
    assert_eq!(summary["rows"].as_array().map(Vec::len), Some(6));
    for row in summary["rows"].as_array().expect("rows") {
        assert_eq!(&row["run"]["version"], &env!("CARGO_PKG_VERSION"));
        assert_eq!(row["run"]["sumo"], row["program"]["sumo"]);
    }
    let marl: Value = serde_json::from_str(&read("marl_eval.json")).expect("JSON");
    let run = &marl["intersection"]["scenario.communication.range=100.0"]["mappo"]["seed_1"];
    assert_eq!(
        run["absolute_metrics"]["success"][0],
        summary["rows"]
            .as_array()
            .expect("rows")
            .iter()
            .find(|row| row["seed"] == 1 && row["at"] == "100.0")
            .expect("a row")["metrics"]["success"]["mean"]
    );
    assert_eq!(run["step_0"]["step_count"], 512);
}

#[test]
fn reports_of_mixed_traffic_say_what_the_others_met_with() {
    let folder = folder();
    let (runs, out) = (folder.path().join("runs"), folder.path().join("report"));
    let changes = [
        ("scenarios/intersection.xml", "scenarios/mixed_cross.xml"),
        ("steps = 4096", "steps = 256"),
        ("seed = [0, 1]", "seed = [0]"),
    ];
    let file = sweep_file(
        folder.path(),
        &changes.iter().fold(FILE.to_owned(), |all, (from, to)| all.replace(from, to)),
    );
    succeeds(&mut sweep(&file, &runs, &[]));
    let files = [file.as_path(), Path::new("--runs"), &runs, Path::new("-o"), &out];
    succeeds(iwol(&["report"]).args(files));
    let markdown = std::fs::read_to_string(out.join("report.md")).expect("written");
    let result = runs.join("tiny/mappo/seed_0/evaluations/range_range=10.0.json");
    let found: Value =
        serde_json::from_str(&std::fs::read_to_string(result).expect("a result")).expect("JSON");
    let delay = found["metrics"]["others"]["delay"]["mean"].as_f64().expect("others lose time");
    let heading = "| background delay s at communication range ([interval] over the episodes of a single run) | 100.0 | 10.0 |";
    let table = markdown.split(heading).nth(1).expect("a table");
    let row = table.lines().find(|line| line.starts_with("| mappo |")).expect("a row");
    assert!(
        row.rsplit('|').nth(1).is_some_and(|cell| cell.trim().starts_with(&format!("{delay:.1}"))),
        "{row}, {delay}"
    );
}

#[test]
fn failures_are_told_and_retried_on_request() {
    let folder = folder();
    let out = folder.path().join("runs");
    // The second seed cannot start, because its folder has a file of somebody else.
    let broken = FILE.replace("steps = 4096", "steps = 256");
    let file = sweep_file(folder.path(), &broken);
    let taken = out.join("tiny/mappo/seed_1");
    std::fs::create_dir_all(&taken).expect("a folder");
    std::fs::write(taken.join("scenario.xml"), "mine").expect("written");
    let run = |more: &[&str]| {
        let output = sweep(&file, &out, more).output().expect("it ran");
        (output.status.code(), text(&output.stdout), text(&output.stderr))
    };
    let (code, stdout, stderr) = run(&[]);
    assert_eq!(code, Some(1), "{stderr}");
    assert!(stdout.contains("1 of 2 cells finished, 1 failed"), "{stdout}");
    assert!(
        stderr.contains("mappo/seed_1 failed") && stderr.contains("does not belong to a run"),
        "{stderr}"
    );
    let (code, _, stderr) = run(&[]);
    assert_eq!(code, Some(1));
    assert!(
        stderr.contains("0 of 2 cells to do"),
        "a failure is not tried again by itself: {stderr}"
    );
    let (code, _, stderr) = run(&["--retry"]);
    assert_eq!(code, Some(1));
    assert!(stderr.contains("1 of 2 cells to do"), "{stderr}");
    sweep_file(
        folder.path(),
        &broken.replace("steps = 256", "steps = 256\nexploration = { correlation = 0.5 }"),
    );
    let (code, _, stderr) = run(&[]);
    assert_eq!(code, Some(2));
    assert!(
        stderr.contains("another `exploration.correlation`: 0.0 in the run, 0.5 in the sweep file"),
        "{stderr}"
    );
    // MAPPO does not read MAGIC's settings, so changing them is no change of the run.
    sweep_file(
        folder.path(),
        &broken.replace("steps = 256", "steps = 256\nmagic = { lambda_world = 0.5 }"),
    );
    let (code, _, stderr) = run(&[]);
    assert_eq!(code, Some(1));
    assert!(stderr.contains("0 of 2 cells to do"), "{stderr}");
    // A cell with other settings than its folder's run is refused.
    sweep_file(folder.path(), &broken.replace("steps = 256", "steps = 512"));
    let (code, _, stderr) = run(&[]);
    assert_eq!(code, Some(2));
    assert!(
        stderr
            .contains("contains a run with another `steps`: 256 in the run, 512 in the sweep file"),
        "{stderr}"
    );
}

#[test]
fn a_sweep_goes_on_where_its_program_is_replaced() {
    let folder = folder();
    let out = folder.path().join("runs");
    let short = FILE.replace("steps = 4096", "steps = 256").replace("seed = [0, 1]", "seed = [0]");
    let file = sweep_file(folder.path(), &short);
    let program = folder.path().join("iwol");
    // Another process copies it: processes that other tests start meanwhile would inherit this
    // one's open file, and a program that is open for writing cannot be started.
    let mut copy = Command::new("cp");
    assert!(copy.arg(env!("CARGO_BIN_EXE_iwol")).arg(&program).status().expect("cp").success());
    let mut command = Command::new(&program);
    command.current_dir(root()).arg("sweep").arg(file).arg("--out").arg(&out);
    command.stdout(Stdio::null()).stderr(Stdio::null());
    let mut running = Killed(command.spawn().expect("it starts"));
    until("a child process", || !children(running.0.id()).is_empty());
    std::fs::remove_file(&program).expect("removed");
    // The training is followed by three evaluations, each with a process of its own.
    assert!(running.0.wait().expect("it ends").success());
    let found = std::fs::read_dir(out.join("tiny/mappo/seed_0/evaluations")).expect("evaluations");
    assert_eq!(found.count(), 3);
}

#[test]
fn shards_divide_the_grid() {
    let folder = folder();
    let file = sweep_file(folder.path(), &FILE.replace("seed = [0, 1]", "seed = [0, 1, 2, 3, 4]"));
    let cells = |shard: &str| {
        let output = succeeds(&mut sweep(&file, folder.path(), &["--dry-run", "--shard", shard]));
        let stdout = text(&output.stdout);
        stdout
            .lines()
            .filter_map(|line| line.split_whitespace().next()?.parse().ok())
            .collect::<Vec<usize>>()
    };
    let numbers = |shard: &str| cells(shard)[..cells(shard).len() - 1].to_vec();
    assert_eq!((numbers("1/2"), numbers("2/2")), (vec![0, 2, 4], vec![1, 3]));
    let output =
        sweep(&file, folder.path(), &["--dry-run", "--shard", "3/2"]).output().expect("it ran");
    assert!(text(&output.stderr).contains("write it as i/n"), "{}", text(&output.stderr));
}

#[test]
fn a_cell_waits_for_the_one_whose_policy_it_begins_with() {
    let folder = folder();
    let out = folder.path().join("runs");
    // The waiting cell comes first in the file.
    let rule = "[[rule]]\nwhen = { agents = 5 }\nset = { init_from = { agents = 4 } }\n[[evaluate]]\nname = \"range\"";
    let changes = [
        ("agents = 4\n", ""),
        ("steps = 4096", "steps = 256"),
        ("seed = [0, 1]", "agents = [5, 4]\nseed = [0]"),
        ("[[evaluate]]\nname = \"range\"", rule),
        ("evaluate = \"plain\"\n", "evaluate = \"plain\"\nx = [4]\n"),
    ];
    let file = sweep_file(
        folder.path(),
        &changes.iter().fold(FILE.to_owned(), |all, (from, to)| all.replace(from, to)),
    );
    let alone = sweep(&file, &out, &["--cell", "mappo_agents=5/seed_0"]).output().expect("it ran");
    assert_eq!(alone.status.code(), Some(1), "{}", text(&alone.stderr));
    assert!(
        text(&alone.stderr).contains("1 of 1 cell must wait for other cells"),
        "{}",
        text(&alone.stderr)
    );
    assert!(
        text(&alone.stdout).contains("waits for mappo_agents=4/seed_0"),
        "{}",
        text(&alone.stdout)
    );

    let both = succeeds(&mut sweep(&file, &out, &["--jobs", "2"]));
    assert!(
        text(&both.stdout).contains("2 of 2 cells finished, 0 failed"),
        "{}",
        text(&both.stdout)
    );
    let config = std::fs::read_to_string(out.join("tiny/mappo_agents=5/seed_0/config.toml"))
        .expect("written");
    assert!(
        config.contains("init_from = ") && config.contains("tiny/mappo_agents=4/seed_0"),
        "{config}"
    );

    // What was learned from another policy than the present one is no result of this sweep.
    let again = succeeds(&mut sweep(&file, &out, &[]));
    assert!(text(&again.stdout).contains("2 of 2 cells finished, 0 failed"));
    let first = out.join("tiny/mappo_agents=4/seed_0/checkpoints");
    for name in ["best.safetensors", "last.safetensors"] {
        let mut policy = std::fs::read(first.join(name)).expect("a policy");
        *policy.last_mut().expect("weights") ^= 1;
        std::fs::write(first.join(name), policy).expect("written");
    }
    let stale = sweep(&file, &out, &[]).output().expect("it ran");
    let stale = text(&stale.stderr);
    assert!(
        stale.contains("seed_0` began with an earlier policy of the cell mappo_agents=4/seed_0"),
        "{stale}"
    );
}

/// All sweeps and configurations in `experiments` name existing settings.
#[test]
fn the_experiments_that_come_along_load() {
    let mut sweeps = 0;
    let folder = root().join("experiments");
    let folders = ["", "ablations", "beyond", "paper"].map(|name| folder.join(name));
    for entry in folders.iter().flat_map(|folder| std::fs::read_dir(folder).expect("the folder")) {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            continue;
        }
        let text = std::fs::read_to_string(&path).expect("text");
        if text.contains("[grid]") || text.contains("base = ") {
            let sweep = Sweep::load(&path, Path::new("runs"))
                .unwrap_or_else(|e| panic!("{}: {e}", path.display()));
            assert!(!sweep.cells.is_empty(), "{}", path.display());
            // An initial policy must be that of another cell, because a policy from elsewhere may
            // need another version of the program.
            for cell in &sweep.cells {
                let init_from = &cell.config.init_from;
                assert!(
                    init_from.as_os_str().is_empty() || cell.after.is_some(),
                    "{}: {}",
                    path.display(),
                    init_from.display()
                );
            }
            sweeps += 1;
        } else {
            let document = Document { name: path.display().to_string(), text, generated: false };
            Config::resolve(&Layers { document, ..Layers::default() })
                .unwrap_or_else(|e| panic!("{e}"));
        }
    }
    assert!(sweeps > 8);
}

/// A cell that begins with the policy of another cell cannot start before that one is trained.
#[test]
fn slurm_gets_the_cells_that_can_begin() {
    use std::os::unix::fs::PermissionsExt as _;
    let folder = folder();
    let sbatch = folder.path().join("sbatch");
    std::fs::write(&sbatch, "#!/bin/sh\necho 7\n").expect("written");
    std::fs::set_permissions(&sbatch, std::fs::Permissions::from_mode(0o755)).expect("a program");
    let rule = "[[rule]]\nwhen = { agents = 6 }\nset = { init_from = { agents = 4 } }\n[grid]\nagents = [4, 6]\n";
    let (cells, _) = FILE.split_once("[[evaluate]]").expect("evaluations");
    let file =
        sweep_file(folder.path(), &cells.replace("agents = 4\n", "").replace("[grid]\n", rule));
    let path = format!("{}:{}", folder.path().display(), std::env::var("PATH").expect("a path"));
    let out = folder.path().join("runs");
    let output = succeeds(sweep(&file, &out, &["--slurm"]).env("PATH", path));
    let said = text(&output.stderr);
    assert!(said.contains("2 cells left out, because they begin with policies"), "{said}");
    let jobs = std::fs::read_dir(out.join("tiny/slurm")).expect("a folder");
    let mut jobs = jobs.map(|entry| entry.expect("an entry").path());
    let list = jobs.find(|path| path.extension().is_some_and(|end| end == "cells"));
    let cells = std::fs::read_to_string(list.expect("a list")).expect("text");
    let mut cells: Vec<&str> = cells.lines().collect();
    cells.sort_unstable();
    assert_eq!(cells, ["agents=4_mappo/seed_0", "agents=4_mappo/seed_1"]);
}

/// Slurm runs every cell, on one machine with Debian's packages (`scripts/bootstrap --tests`
/// installs them).
#[test]
fn slurm_runs_every_cell() {
    let folder = folder();
    let (cluster, out) = (folder.path().join("slurm"), folder.path().join("runs"));
    let script = root().join("scripts/one-machine-slurm");
    let slurm = |verb: &str| {
        Command::new(&script).arg(verb).arg(&cluster).output().expect("the script runs")
    };
    let started = slurm("start");
    assert!(started.status.success(), "{}", text(&started.stderr));
    let variable = text(&started.stdout);
    let configuration = variable
        .trim()
        .strip_prefix("export SLURM_CONF=")
        .expect("where the cluster is")
        .trim_matches('\'')
        .to_owned();
    let result = std::panic::catch_unwind(|| {
        let file = sweep_file(folder.path(), &FILE.replace("steps = 4096", "steps = 512"));
        let mut submit = sweep(&file, &out, &["--slurm", "--slurm-option", "time=00:10:00"]);
        let output = succeeds(submit.env("SLURM_CONF", &configuration));
        assert!(
            text(&output.stdout).trim().parse::<u32>().is_ok(),
            "the job's number: {}",
            text(&output.stdout)
        );
        until("the end of the jobs", || {
            let output = succeeds(&mut sweep(&file, &out, &["--dry-run"]));
            let table = text(&output.stdout);
            assert!(!table.contains(" 1 failed") && !table.contains(" 2 failed"), "{table}");
            table.contains("2 of 2 cells finished")
        });
        findings(&out);
    });
    let stopped = slurm("stop");
    if let Err(panic) = result {
        std::panic::resume_unwind(panic);
    }
    assert!(stopped.status.success(), "{}", text(&stopped.stderr));
}
