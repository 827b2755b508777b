//! The SUMO process: this module finds, starts and connects to SUMO, and ensures that no SUMO
//! process outlives this program.
//!
//! Any program can connect to SUMO's port until its one client has connected, and another program
//! may take the port after this program has chosen it and before SUMO opens it. The client
//! therefore connects as early as possible and then checks in the system's connection table that
//! the other end belongs to the process that was started. A port that another program has taken is
//! replaced by another port.
//!
//! SUMO always terminates with this program: [`Process`] kills SUMO when it is dropped (also after
//! a panic), and the kernel kills SUMO when the thread that started it ends (`PR_SET_PDEATHSIG`).
//! For this reason one thread, which lives as long as the program, starts every SUMO process. SUMO
//! has its own process group, so that Ctrl-C reaches only this program, which then decides when
//! SUMO ends.

use std::{
    collections::VecDeque,
    ffi::{OsStr, OsString},
    fs, io,
    io::{Read as _, Write as _},
    net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream},
    os::unix::{fs::PermissionsExt as _, process::CommandExt as _},
    path::{Path, PathBuf},
    process::{Child, ChildStderr, Command, ExitStatus, Stdio},
    sync::{Arc, Mutex, PoisonError, mpsc},
    thread,
    time::{Duration, Instant},
};

use super::{
    Error,
    client::{self, Client, Version},
};

/// Maximum number of ports that are tried.
const PORT_ATTEMPTS: u32 = 8;
/// Pause between two looks at the process.
const POLL: Duration = Duration::from_millis(1);
/// Longest time between the end of a connection and the end of its process, and longest wait for
/// the rest of its standard error.
const LAST_WORDS: Duration = Duration::from_millis(500);
/// How much of SUMO's standard error is kept \[bytes\].
const TAIL_BYTES: usize = 4096;
/// How many lines of the kept standard error are reported.
const TAIL_LINES: usize = 10;

/// Options for starting SUMO.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Options {
    /// The program; `None`: the one that [`find_sumo`] finds.
    pub binary: Option<PathBuf>,
    /// Arguments, without `--remote-port`.
    pub arguments: Vec<OsString>,
    /// TCP port; `None`: a free one, replaced by another if it is taken before SUMO opens it.
    pub port: Option<u16>,
    /// Longest time that SUMO may take to load its files and open its port.
    pub connect_timeout: Duration,
    /// Longest time that SUMO may take to answer one message.
    pub reply_timeout: Duration,
}

impl Default for Options {
    fn default() -> Self {
        Options {
            binary: None,
            arguments: Vec::new(),
            port: None,
            connect_timeout: Duration::from_secs(60),
            reply_timeout: Duration::from_secs(60),
        }
    }
}

/// A running SUMO process, which is killed when this value is dropped.
#[derive(Debug)]
pub struct Process {
    child: Child,
    port: u16,
    stderr: Arc<Mutex<VecDeque<u8>>>,
    reader: Option<thread::JoinHandle<()>>,
}

impl Process {
    /// Starts SUMO, connects to it, and checks that the process that answers is the one that was
    /// started.
    ///
    /// # Errors
    /// [`Error::NotFound`] and [`Error::Spawn`] if SUMO cannot be found or started;
    /// [`Error::Exited`] if SUMO ends while it loads; [`Error::PortTaken`] if the given port, or
    /// each of several free ports, is taken by another program; [`Error::Connect`] if SUMO does not
    /// open its port in time; the errors of [`Client::handshake`].
    pub fn start(options: &Options) -> Result<(Process, Client, Version), Error> {
        Self::start_on(options, free_port)
    }

    fn start_on(
        options: &Options,
        mut choose: impl FnMut() -> Result<u16, Error>,
    ) -> Result<(Process, Client, Version), Error> {
        let binary = match &options.binary {
            Some(binary) => binary.clone(),
            None => find_sumo()?,
        };
        let mut attempt = 0;
        loop {
            attempt += 1;
            let port = match options.port {
                Some(port) => port,
                None => choose()?,
            };
            match Self::try_start(&binary, options, port) {
                Err(Error::PortTaken { port })
                    if options.port.is_none() && attempt < PORT_ATTEMPTS =>
                {
                    tracing::debug!(port, "another program was faster; trying another port");
                }
                result => return result,
            }
        }
    }

    fn try_start(
        binary: &Path,
        options: &Options,
        port: u16,
    ) -> Result<(Process, Client, Version), Error> {
        // SUMO makes this check itself, but only after loading its net.
        if let Err(e) = TcpListener::bind((Ipv4Addr::UNSPECIFIED, port)) {
            return Err(match e.kind() {
                io::ErrorKind::AddrInUse => Error::PortTaken { port },
                _ => Error::Io { doing: "open a port for sumo", source: e },
            });
        }
        let mut process = Self::spawn(binary, &options.arguments, port)?;
        match process.connect(options) {
            Ok((client, version)) => Ok((process, client, version)),
            Err(error) => Err(process.port_lost().unwrap_or(error)),
        }
    }

    fn spawn(binary: &Path, arguments: &[OsString], port: u16) -> Result<Process, Error> {
        let mut command = Command::new(binary);
        command.args(arguments).arg("--remote-port").arg(port.to_string());
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
        let spawn_error = |source| Error::Spawn { binary: binary.to_owned(), source };
        let mut child = spawn_from_lasting_thread(command).map_err(spawn_error)?;
        let stderr = Arc::new(Mutex::new(VecDeque::new()));
        let pipe = child.stderr.take();
        let mut process = Process { child, port, stderr: Arc::clone(&stderr), reader: None };
        if let Some(pipe) = pipe {
            let reader = thread::Builder::new().name("sumo-stderr".to_owned());
            process.reader =
                Some(reader.spawn(move || keep_tail(pipe, &stderr)).map_err(spawn_error)?);
        }
        Ok(process)
    }

    fn connect(&mut self, options: &Options) -> Result<(Client, Version), Error> {
        let address = SocketAddr::from((Ipv4Addr::LOCALHOST, self.port));
        let alive = || self.exited(Duration::ZERO).map_or(Ok(()), Err);
        let stream = client::open(address, options.connect_timeout, alive)?;
        let mut client = Client::new(stream, options.reply_timeout)?;
        // Only an answer proves that SUMO has accepted the connection and therefore owns its end of
        // it.
        let answer = client.handshake();
        let owned = self.owns_other_end(client.stream());
        match (answer, owned) {
            (Ok(version), Ok(true)) => Ok((client, version)),
            (Ok(_), Err(source)) => {
                Err(Error::Io { doing: "find out whose port it is that answers", source })
            }
            (_, Ok(false)) => Err(Error::PortTaken { port: self.port }),
            (Err(error), _) => Err(self.explain(error)),
        }
    }

    /// Whether the other end of the connection belongs to the process that was started.
    fn owns_other_end(&self, stream: &TcpStream) -> io::Result<bool> {
        let (SocketAddr::V4(ours), SocketAddr::V4(theirs)) =
            (stream.local_addr()?, stream.peer_addr()?)
        else {
            return Ok(false);
        };
        // The table's notation: the four address bytes as a native-endian number, then the port.
        let cell = |a: std::net::SocketAddrV4| {
            format!("{:08X}:{:04X}", u32::from_ne_bytes(a.ip().octets()), a.port())
        };
        let (local, remote) = (cell(theirs), cell(ours));
        let table = fs::read_to_string("/proc/net/tcp")?;
        let inode = table.lines().find_map(|line| {
            let cells: Vec<&str> = line.split_whitespace().collect();
            (cells.len() > 9 && cells[1] == local && cells[2] == remote)
                .then(|| cells[9].to_owned())
        });
        let Some(socket) = inode.map(|inode| format!("socket:[{inode}]")) else {
            return Ok(false);
        };
        match fs::read_dir(format!("/proc/{}/fd", self.child.id())) {
            Ok(entries) => Ok(entries.flatten().any(|e| {
                fs::read_link(e.path()).is_ok_and(|t| t.as_os_str() == OsStr::new(&socket))
            })),
            // The process has ended.
            Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(false),
            Err(e) => Err(e),
        }
    }

    /// Returns the process identifier.
    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    /// Returns the TCP port that SUMO opened.
    pub fn port(&self) -> u16 {
        self.port
    }

    /// Replaces a connection error by [`Error::Exited`] if the end of the process is its cause.
    #[must_use]
    pub fn explain(&mut self, error: Error) -> Error {
        match error {
            Error::Closed { .. } => self.exited(LAST_WORDS).unwrap_or(error),
            Error::Timeout { .. } | Error::Protocol { .. } => {
                self.exited(Duration::ZERO).unwrap_or(error)
            }
            other => other,
        }
    }

    /// Returns the error for a process that has ended or that ends within `patience`.
    fn exited(&mut self, patience: Duration) -> Option<Error> {
        let status = wait(&mut self.child, patience)?;
        // The pipe closes with the process unless another process inherited it, hence the time
        // limit.
        let start = Instant::now();
        while self.reader.as_ref().is_some_and(|r| !r.is_finished()) && start.elapsed() < LAST_WORDS
        {
            thread::sleep(POLL);
        }
        Some(Error::Exited { status: status.to_string(), stderr_tail: self.stderr_tail() })
    }

    /// Returns [`Error::PortTaken`] if SUMO ended because its port was taken, or because another
    /// program connected by mistake and then disconnected.
    fn port_lost(&mut self) -> Option<Error> {
        match self.exited(Duration::ZERO) {
            Some(Error::Exited { stderr_tail, .. })
                if ["listening socket", "peer shutdown"]
                    .iter()
                    .any(|words| stderr_tail.contains(words)) =>
            {
                Some(Error::PortTaken { port: self.port })
            }
            _ => None,
        }
    }

    /// Returns the last lines that SUMO wrote to its standard error.
    pub fn stderr_tail(&self) -> String {
        let bytes: Vec<u8> =
            self.stderr.lock().unwrap_or_else(PoisonError::into_inner).iter().copied().collect();
        let text = String::from_utf8_lossy(&bytes);
        let lines: Vec<&str> = text.lines().map(str::trim_end).filter(|l| !l.is_empty()).collect();
        lines[lines.len().saturating_sub(TAIL_LINES)..].join("\n")
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        // Both calls fail only if the process has already ended.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn wait(child: &mut Child, patience: Duration) -> Option<ExitStatus> {
    let start = Instant::now();
    loop {
        match child.try_wait() {
            Ok(Some(status)) => return Some(status),
            _ if start.elapsed() >= patience => return None,
            _ => thread::sleep(POLL),
        }
    }
}

fn keep_tail(mut pipe: ChildStderr, tail: &Mutex<VecDeque<u8>>) {
    let mut chunk = [0; 1024];
    while let Ok(n) = pipe.read(&mut chunk) {
        if n == 0 {
            break;
        }
        tracing::debug!(stderr = %String::from_utf8_lossy(&chunk[..n]).trim_end(), "sumo");
        let mut tail = tail.lock().unwrap_or_else(PoisonError::into_inner);
        tail.extend(&chunk[..n]);
        let excess = tail.len().saturating_sub(TAIL_BYTES);
        tail.drain(..excess);
    }
}

fn free_port() -> Result<u16, Error> {
    let bound =
        TcpListener::bind((Ipv4Addr::UNSPECIFIED, 0)).and_then(|listener| listener.local_addr());
    bound
        .map(|address| address.port())
        .map_err(|source| Error::Io { doing: "find a free port", source })
}

type Job = (Command, mpsc::Sender<io::Result<Child>>);

/// Starts a command whose process is killed when this program ends. The one thread that lives as
/// long as the program starts it.
fn spawn_from_lasting_thread(command: Command) -> io::Result<Child> {
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

/// Finds the program `sumo` in `$SUMO_HOME/bin`, then in `PATH`.
///
/// # Errors
/// [`Error::NotFound`] with the folders that were searched.
pub fn find_sumo() -> Result<PathBuf, Error> {
    find_program("sumo")
}

/// Finds another SUMO program, such as `netconvert`, in the same folders as [`find_sumo`].
///
/// # Errors
/// As [`find_sumo`].
pub fn find_program(binary: &str) -> Result<PathBuf, Error> {
    find_in(binary, std::env::var_os("SUMO_HOME").as_deref(), std::env::var_os("PATH").as_deref())
}

fn find_in(binary: &str, home: Option<&OsStr>, path: Option<&OsStr>) -> Result<PathBuf, Error> {
    let home = home.filter(|h| !h.is_empty()).map(|h| Path::new(h).join("bin"));
    let path = path.map(|p| std::env::split_paths(p).collect::<Vec<_>>()).unwrap_or_default();
    let looked_in: Vec<PathBuf> =
        home.into_iter().chain(path).filter(|f| !f.as_os_str().is_empty()).collect();
    let found = looked_in.iter().map(|folder| folder.join(binary)).find(|file| {
        fs::metadata(file).is_ok_and(|m| m.is_file() && m.permissions().mode() & 0o111 != 0)
    });
    found.ok_or(Error::NotFound { binary: binary.to_owned(), looked_in })
}

/// Returns the version that a SUMO program reports, for example `1.15.0`.
///
/// # Errors
/// [`Error::Spawn`] if the program cannot be run; [`Error::Exited`] if it reports no version.
pub fn sumo_version(binary: &Path) -> Result<String, Error> {
    let run = Command::new(binary).arg("--version").stdin(Stdio::null()).output();
    let output = run.map_err(|source| Error::Spawn { binary: binary.to_owned(), source })?;
    let text = String::from_utf8_lossy(&output.stdout);
    let version = text
        .lines()
        .next()
        .and_then(|line| line.split_once("Version "))
        .map(|(_, v)| v.trim().to_owned());
    version.filter(|v| !v.is_empty()).ok_or_else(|| Error::Exited {
        status: output.status.to_string(),
        stderr_tail: String::from_utf8_lossy(&output.stderr).trim().to_owned(),
    })
}

/// Starts SUMO on an empty net, performs the handshake, ends SUMO, and returns its version.
///
/// # Errors
/// As [`Process::start`].
pub fn traci_version() -> Result<Version, Error> {
    let (_net, options) = empty_net()?;
    Process::start(&options).map(|(_, _, version)| version)
}

/// Returns a net without roads, whose file exists as long as its handle, and options that start
/// SUMO with it. Without a net SUMO does not answer the handshake.
fn empty_net() -> Result<(tempfile::NamedTempFile, Options), Error> {
    let doing = "write a net to a temporary file";
    let mut file = tempfile::NamedTempFile::with_suffix(".net.xml")
        .map_err(|source| Error::Io { doing, source })?;
    file.write_all(b"<net version=\"1.0\"/>\n").map_err(|source| Error::Io { doing, source })?;
    let words = ["--xml-validation", "never", "--no-step-log", "--net-file"].map(OsString::from);
    let arguments = words.into_iter().chain([file.path().into()]).collect();
    Ok((file, Options { arguments, ..Options::default() }))
}

#[cfg(test)]
mod tests;
