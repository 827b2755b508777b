//! The processes that SUMO consists of: one, or a script and what it started.

use std::{
    ffi::OsStr,
    fs, io,
    time::{Duration, Instant},
};

use rustix::process::{Pid, Signal, WaitId, WaitIdOptions, kill_process_group, waitid};

/// Shortest time between two looks at what the processes use.
const LOOK: Duration = Duration::from_millis(100);
/// Linux counts processor time in hundredths of a second.
const TICKS_PER_SECOND: f64 = 100.0;
/// Processor time that SUMO may use for each megabyte that it reads, about thirty times what it
/// needs \[s\].
const SECONDS_PER_MEGABYTE: f64 = 10.0;

/// A process group, whose number is that of the process that was started.
#[derive(Debug)]
pub(super) struct Group {
    leader: Pid,
    /// Whether the leader is the only process that counts.
    alone: bool,
}

/// What the processes have used so far.
#[derive(Debug, Clone, Copy, Default)]
struct Usage {
    /// Processor time \[s\].
    processor: f64,
    /// Megabytes read; infinite if the system does not tell.
    read: f64,
    /// Whether any of them waits for a disk.
    waits_for_disk: bool,
}

impl Group {
    pub(super) fn new(leader: Pid, alone: bool) -> Self {
        Group { leader, alone }
    }

    /// Whether the leader has ended. It stays unwaited for, so that no other group gets its number.
    pub(super) fn leader_has_ended(&self) -> bool {
        let options = WaitIdOptions::EXITED | WaitIdOptions::NOHANG | WaitIdOptions::NOWAIT;
        matches!(waitid(WaitId::Pid(self.leader), options), Ok(Some(_)))
    }

    /// Kills all processes. The leader must not have been waited for.
    pub(super) fn kill(&self) {
        // Fails only if all processes have ended.
        let _ = kill_process_group(self.leader, Signal::KILL);
    }

    /// Whether any process holds the socket of this name, such as `socket:[1234]`.
    pub(super) fn holds(&self, socket: &str) -> io::Result<bool> {
        for pid in self.processes() {
            match fs::read_dir(format!("/proc/{pid}/fd")) {
                Ok(entries) => {
                    let target = |e: fs::DirEntry| fs::read_link(e.path()).ok();
                    if entries
                        .flatten()
                        .filter_map(target)
                        .any(|t| t.as_os_str() == OsStr::new(socket))
                    {
                        return Ok(true);
                    }
                }
                // The process has ended.
                Err(e) if e.kind() == io::ErrorKind::NotFound => {}
                Err(e) => return Err(e),
            }
        }
        Ok(false)
    }

    fn processes(&self) -> Vec<i32> {
        let leader = self.leader.as_raw_nonzero().get();
        if self.alone {
            return vec![leader];
        }
        let member = |entry: fs::DirEntry| {
            let pid = entry.file_name().to_str()?.parse().ok()?;
            let group: i32 = stat(pid)?.get(2)?.parse().ok()?;
            (group == leader).then_some(pid)
        };
        fs::read_dir("/proc").into_iter().flatten().flatten().filter_map(member).collect()
    }

    fn usage(&self) -> Usage {
        let mut all = Usage::default();
        for pid in self.processes() {
            let Some(stat) = stat(pid) else { continue };
            let ticks = |i: usize| stat.get(i)?.parse::<f64>().ok();
            all.processor +=
                (ticks(11).unwrap_or(0.0) + ticks(12).unwrap_or(0.0)) / TICKS_PER_SECOND;
            all.waits_for_disk |= stat.first().is_some_and(|state| state == "D");
            let read = fs::read_to_string(format!("/proc/{pid}/io")).ok().and_then(|text| {
                text.lines().find_map(|line| line.strip_prefix("rchar: ")?.parse::<f64>().ok())
            });
            all.read += read.map_or(f64::INFINITY, |bytes| bytes / 1e6);
        }
        all
    }
}

/// Returns the fields of a process's state that follow its name: state, parent, group, …
fn stat(pid: i32) -> Option<Vec<String>> {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    // The name may contain spaces and brackets.
    Some(stat.rsplit_once(')')?.1.split_whitespace().map(str::to_owned).collect())
}

/// How long SUMO may take to load its files.
#[derive(Debug, Clone, Copy)]
pub(super) struct Patience {
    /// Longest time in which SUMO does nothing.
    pub(super) idle: Duration,
    /// Longest processor time besides that for reading.
    pub(super) processor: Duration,
}

/// Tells a SUMO that loads its files from one that hangs, by the processor time that it uses. That
/// does not depend on what else the machine does.
#[derive(Debug)]
pub(super) struct Loading {
    patience: Patience,
    began: Instant,
    first: Usage,
    last: Usage,
    looked: Instant,
    active: Instant,
}

impl Loading {
    pub(super) fn begin(group: &Group, patience: Patience) -> Self {
        let (first, now) = (group.usage(), Instant::now());
        Loading { patience, began: now, first, last: first, looked: now, active: now }
    }

    /// Returns what is wrong in words if SUMO hangs.
    pub(super) fn fault(&mut self, group: &Group) -> Option<String> {
        if self.looked.elapsed() < LOOK {
            return None;
        }
        let now = group.usage();
        self.looked = Instant::now();
        if now.waits_for_disk || now.processor != self.last.processor {
            self.active = self.looked;
        }
        self.last = now;
        let (seconds, idle) = (self.began.elapsed().as_secs_f64(), self.active.elapsed());
        let used = now.processor - self.first.processor;
        let read = now.read - self.first.read;
        if idle >= self.patience.idle {
            return Some(format!(
                "it did nothing for the last {:.0} of {seconds:.0} s",
                idle.as_secs_f64()
            ));
        }
        // Without a number of bytes there is no limit: infinity minus infinity is not a number.
        (used > self.patience.processor.as_secs_f64() + read * SECONDS_PER_MEGABYTE).then(|| {
            format!("it used {used:.0} s of processor time in {seconds:.0} s and read {read:.0} MB")
        })
    }
}
