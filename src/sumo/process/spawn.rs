//! Starts processes that end with this program, however it ends.

use std::{
    io,
    os::unix::process::CommandExt as _,
    process::{Child, Command, Stdio},
    sync::{Mutex, PoisonError, mpsc},
    thread,
};

type Job = (Command, mpsc::Sender<io::Result<Child>>);

/// Starts a command whose process is killed when this program ends. The one thread that lives as
/// long as the program starts it.
pub(super) fn spawn_from_lasting_thread(command: Command) -> io::Result<Child> {
    static JOBS: Mutex<Option<mpsc::Sender<Job>>> = Mutex::new(None);
    let mut jobs = JOBS.lock().unwrap_or_else(PoisonError::into_inner);
    let sender = if let Some(sender) = &*jobs {
        sender.clone()
    } else {
        let (sender, receiver) = mpsc::channel::<Job>();
        let work = move || {
            while let Ok((command, answer)) = receiver.recv() {
                // Cannot fail, because the requesting thread waits for the answer.
                let _ = answer.send(spawn_bound(command));
            }
        };
        thread::Builder::new().name("sumo-spawner".to_owned()).spawn(work)?;
        jobs.insert(sender).clone()
    };
    drop(jobs);
    let (answer, result) = mpsc::channel();
    let gone = |_| io::Error::other("the thread that starts sumo is gone");
    sender.send((command, answer)).map_err(|_| gone(mpsc::RecvError))?;
    result.recv().map_err(gone)?
}

#[allow(
    unsafe_code,
    reason = "the kernel's tie between parent and child can be made in the child only"
)]
fn spawn_bound(mut command: Command) -> io::Result<Child> {
    let parent = std::process::id();
    command.process_group(0);
    // SAFETY: between fork and exec only async-signal-safe calls are allowed. The closure makes two
    // system calls and, on failure, creates an error from a number; it neither allocates nor locks.
    unsafe {
        command.pre_exec(move || {
            if libc::prctl(libc::PR_SET_PDEATHSIG, libc::SIGKILL) != 0 {
                return Err(io::Error::last_os_error());
            }
            // The parent may have ended before `prctl` took effect.
            if u32::try_from(libc::getppid()) != Ok(parent) {
                return Err(io::Error::from_raw_os_error(libc::ESRCH));
            }
            Ok(())
        });
    }
    command.spawn()
}

/// A process that kills a process group when this program ends, which the kernel does for the
/// leader of the group alone.
#[derive(Debug)]
pub(super) struct Guard(Child);

impl Guard {
    pub(super) fn of(group: u32) -> io::Result<Self> {
        let mut command = Command::new("/bin/sh");
        // The shell's standard input ends with this program.
        command.args(["-c", "read -r _; kill -s KILL -- \"-$0\"", &group.to_string()]);
        command.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::null()).process_group(0);
        command.spawn().map(Guard)
    }
}

impl Drop for Guard {
    fn drop(&mut self) {
        // Both calls fail only if the process has already ended.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}
