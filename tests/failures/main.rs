//! Tests of failures: SUMO processes that die, hang or talk nonsense, interrupts, full disks, and
//! leaks over thousands of resets.
//!
//! They are a binary of their own because some look at all children of this process, kill one, or
//! measure this process's memory: see [`alone`].

#[path = "../support.rs"]
#[allow(dead_code, reason = "these tests need only some of the helpers")]
mod support;

mod faulty_sumo;
mod killed_processes;

use std::{
    fs,
    process::Command,
    sync::{PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard},
    thread,
    time::{Duration, Instant},
};

static PROCESS: RwLock<()> = RwLock::new(());

/// Returns a lock that makes a test run alone, because it looks at all children or at the memory of
/// this process.
fn alone() -> RwLockWriteGuard<'static, ()> {
    PROCESS.write().unwrap_or_else(PoisonError::into_inner)
}

/// Returns a lock that lets a test run beside others: it looks only at processes that it started.
fn beside_others() -> RwLockReadGuard<'static, ()> {
    PROCESS.read().unwrap_or_else(PoisonError::into_inner)
}

/// Returns the processes named `sumo` whose parent is `parent`, with those that ended and that the
/// parent did not wait for.
fn sumo_children(parent: u32) -> Vec<u32> {
    let mut children = Vec::new();
    for entry in fs::read_dir("/proc").expect("proc").flatten() {
        let Ok(pid) = entry.file_name().to_string_lossy().parse::<u32>() else {
            continue;
        };
        let Ok(stat) = fs::read_to_string(entry.path().join("stat")) else {
            continue;
        };
        // The fields are: pid (name) state ppid …
        let Some((head, tail)) = stat.rsplit_once(')') else {
            continue;
        };
        let ppid = tail.split_whitespace().nth(1);
        if head.ends_with("(sumo") && ppid == Some(&parent.to_string()) {
            children.push(pid);
        }
    }
    children
}

fn signal(pid: u32, name: &str) {
    let status = Command::new("kill").args([&format!("-{name}"), &pid.to_string()]).status();
    assert!(status.expect("kill runs").success());
}

fn wait_until(what: &str, seconds: u64, mut holds: impl FnMut() -> bool) {
    let begin = Instant::now();
    while !holds() {
        assert!(begin.elapsed() < Duration::from_secs(seconds), "waited {seconds} s: {what}");
        thread::sleep(Duration::from_millis(10));
    }
}
