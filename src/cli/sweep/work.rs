//! Runs cells in parallel, each in a child process that ends with this process.

use std::collections::VecDeque;
use std::fs::File;
use std::io::IsTerminal as _;
use std::process::{Child, Command, Stdio};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use anyhow::Context as _;
use indicatif::{MultiProgress, ProgressBar, ProgressStyle};

use crate::sweep::{Cell, Job, State, Sweep};
use crate::train::human_duration;
use crate::words::counted;

use super::super::{INTERRUPTED, program};
use super::time_left;

/// Interval at which the child processes are polled.
const TICK: Duration = Duration::from_millis(100);
/// How long a cell waits for another process to leave its folder, e.g. for a child of a killed
/// sweep that still writes its checkpoint.
const PATIENCE: Duration = Duration::from_secs(120);

/// Runs the unfinished cells among `cells`, `jobs` at a time, until all are done or `stop` is
/// raised. A cell that fails is marked as failed and does not stop the others.
pub(super) fn run(
    sweep: &Sweep,
    cells: &[(usize, &Cell)],
    jobs: usize,
    stop: &AtomicBool,
) -> anyhow::Result<()> {
    let open = cells.iter().filter(|(_, cell)| {
        !matches!(cell.state(&sweep.evaluations), State::Finished | State::Failed(_))
    });
    let queue: Mutex<VecDeque<&Cell>> = Mutex::new(open.map(|(_, cell)| *cell).collect());
    let count = queue.lock().expect("no worker panics").len();
    say!("{count} of {} to do, {jobs} at a time", counted(cells.len(), "cell"));
    let screen = Screen::new(count, jobs);
    // Number of cells in work; cells that wait for one of them may still become ready.
    let busy = AtomicUsize::new(0);
    let next = || loop {
        let mut queue = queue.lock().expect("no worker panics");
        if let Some(ready) = queue.iter().position(|cell| sweep.waits_for(cell).is_none()) {
            busy.fetch_add(1, Ordering::Relaxed);
            return queue.remove(ready);
        }
        if queue.is_empty() || busy.load(Ordering::Relaxed) == 0 || stop.load(Ordering::Relaxed) {
            return None;
        }
        drop(queue);
        std::thread::sleep(TICK);
    };
    let worker = |number: usize| -> anyhow::Result<()> {
        while let Some(cell) = next() {
            if stop.load(Ordering::Relaxed) {
                break;
            }
            let begin = Instant::now();
            let end = finish(sweep, cell, stop, &mut |what| screen.show(number, cell, what));
            busy.fetch_sub(1, Ordering::Relaxed);
            let end = end?;
            screen.done(number, cell, end, begin.elapsed(), time_left(sweep, cells), jobs);
        }
        Ok(())
    };
    let results: Vec<anyhow::Result<()>> = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..jobs.min(count))
            .map(|k| {
                scope.spawn({
                    let worker = &worker;
                    move || worker(k)
                })
            })
            .collect();
        threads.into_iter().map(|thread| thread.join().expect("no worker panics")).collect()
    });
    screen.clear();
    results.into_iter().collect()
}

/// How the work on a cell ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum End {
    Finished,
    Failed,
    Stopped,
    /// Someone else asked the cell's process to stop.
    Interrupted,
    /// Another process works in the cell's folder.
    Busy,
}

/// Does everything that is left to do for a cell, unless another sweep's process does.
fn finish(
    sweep: &Sweep,
    cell: &Cell,
    stop: &AtomicBool,
    show: &mut dyn FnMut(&str),
) -> anyhow::Result<End> {
    let Some(_claim) = cell.claim()? else { return Ok(End::Busy) };
    // Another sweep may have tried the cell since this one began.
    if matches!(cell.state(&sweep.evaluations), State::Failed(_)) {
        return Ok(End::Failed);
    }
    loop {
        // The next job depends on what another process leaves in the folder.
        let since = Instant::now();
        while cell.run().is_locked() && !stop.load(Ordering::Relaxed) {
            if since.elapsed() > PATIENCE {
                return Ok(End::Busy);
            }
            std::thread::sleep(TICK);
        }
        let Some(job) = cell.next(&sweep.evaluations)? else { return Ok(End::Finished) };
        show(&job.what);
        if stop.load(Ordering::Relaxed) {
            return Ok(End::Stopped);
        }
        let logged = std::fs::metadata(cell.log()).map_or(0, |log| log.len());
        match wait(&mut start(cell, &job)?, stop, || show(&job.what))? {
            Some(0) if job.what == "train" => cell.mark_trained()?,
            Some(0) if cell.next(&sweep.evaluations)?.as_ref() != Some(&job) => {}
            _ if stop.load(Ordering::Relaxed) => return Ok(End::Stopped),
            _ if cell.run().is_locked() => return Ok(End::Busy),
            Some(code) if code == i32::from(INTERRUPTED) => return Ok(End::Interrupted),
            code => {
                let how = code.map_or_else(
                    || "was killed".to_owned(),
                    |code| format!("ended with code {code}"),
                );
                let what = format!("{} {} {how}", program(), job.arguments.join(" "));
                cell.mark_failed(&what, logged)?;
                return Ok(End::Failed);
            }
        }
    }
}

fn start(cell: &Cell, job: &Job) -> anyhow::Result<Child> {
    use std::os::unix::process::CommandExt as _;
    let log = cell.log();
    let open = || File::options().create(true).append(true).open(&log);
    let log = open().with_context(|| format!("cannot write `{}`", log.display()))?;
    // The program that runs, also where its file has been replaced since, as a build does.
    let mut command = Command::new("/proc/self/exe");
    command
        .arg0(program())
        .args(["--die-with-parent", &std::process::id().to_string()])
        .args(&job.arguments);
    command.env("RUST_BACKTRACE", "0");
    // A cell is a run of its own, also where MPI's launcher started this sweep.
    for name in crate::ranks::launcher_variables() {
        command.env_remove(name);
    }
    // The child gets its own process group, so that Ctrl-C reaches only this program, which passes
    // one signal on. A second signal would make the child end at once, without a checkpoint.
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(log).process_group(0);
    command.spawn().context("cannot start a process of this program")
}

/// Waits for a child process and returns its exit code; `None` if a signal ended it. When `stop` is
/// raised, the child is asked to stop and given time to write its checkpoint.
fn wait(
    child: &mut Child,
    stop: &AtomicBool,
    mut show: impl FnMut(),
) -> anyhow::Result<Option<i32>> {
    let mut asked = false;
    loop {
        if let Some(status) = child.try_wait().context("cannot wait for a child process")? {
            return Ok(status.code());
        }
        if stop.load(Ordering::Relaxed) && !asked {
            asked = true;
            let pid = rustix::process::Pid::from_child(child);
            // The child may have ended already and then needs no signal.
            let _ = rustix::process::kill_process(pid, rustix::process::Signal::TERM);
        }
        show();
        std::thread::sleep(TICK);
    }
}

/// The progress display while cells run: bars on a terminal, otherwise a line at the beginning and
/// the end of each job.
struct Screen {
    bars: Vec<ProgressBar>,
    all: ProgressBar,
    terminal: bool,
    /// The last message of each worker.
    last: Mutex<Vec<String>>,
}

impl Screen {
    fn new(cells: usize, jobs: usize) -> Self {
        let group = MultiProgress::new();
        let style =
            |template: &str| ProgressStyle::with_template(template).expect("a valid template");
        let bar = |_| {
            let bar = group.add(ProgressBar::new(1));
            bar.set_style(style("{bar:20} {human_pos:>9}/{human_len} steps  {msg}"));
            bar
        };
        let bars = (0..jobs.min(cells)).map(bar).collect();
        let all = group.add(ProgressBar::new(cells as u64));
        all.set_style(style("{bar:20} {pos}/{len} cells  {elapsed}  {msg}"));
        let terminal = std::io::stderr().is_terminal();
        Self { bars, all, terminal, last: Mutex::new(vec![String::new(); jobs]) }
    }

    /// Shows what worker `number` is doing.
    fn show(&self, number: usize, cell: &Cell, what: &str) {
        let said = format!("{}: {what}", cell.id);
        let mut last = self.last.lock().expect("no worker panics");
        let new = last[number] != said;
        if self.terminal {
            let bar = &self.bars[number];
            bar.set_length(cell.config.steps);
            bar.set_position(cell.steps());
            if new {
                bar.set_message(said.clone());
            }
        } else if new {
            say!("{said}");
        }
        last[number] = said;
    }

    fn done(
        &self,
        number: usize,
        cell: &Cell,
        end: End,
        took: Duration,
        left: Option<Duration>,
        jobs: usize,
    ) {
        let end = match end {
            End::Finished => "finished in",
            End::Failed => "FAILED after",
            End::Interrupted => "interrupted after",
            End::Busy => "left to another process after",
            End::Stopped => return,
        };
        self.all.inc(1);
        let left = left.map_or_else(String::new, |left| {
            format!(", about {} left", human_duration(left / jobs as u32))
        });
        let line = format!("{} {end} {}{left}", cell.id, human_duration(took));
        if self.terminal {
            self.bars[number].println(line);
            self.all.set_message(left.trim_start_matches(", ").to_owned());
        } else {
            say!("{line} ({} of {})", self.all.position(), self.all.length().unwrap_or(0));
        }
    }

    fn clear(&self) {
        self.bars.iter().for_each(ProgressBar::finish_and_clear);
        self.all.finish_and_clear();
    }
}
