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
//! SUMO ends. If the program `sumo` is a script that runs SUMO as a child, all processes of the
//! group count as SUMO and end together.
//!
//! SUMO opens its port before it loads its files and answers afterwards. How long that takes
//! depends on the size of the files and on what else the machine does. A SUMO that uses processor
//! time is therefore waited for, and one that does nothing is not.

mod group;
mod installation;
mod spawn;

use std::{
    collections::VecDeque,
    ffi::OsString,
    fs, io,
    io::{Read as _, Write as _},
    net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream},
    path::PathBuf,
    process::{Child, ChildStderr, ExitStatus, Stdio},
    sync::{Arc, Mutex, PoisonError},
    thread,
    time::{Duration, Instant},
};

use rustix::process::Pid;

use super::{
    Error,
    client::{self, Client, Version},
};
use group::{Group, Loading, Patience};
#[cfg(feature = "libsumo")]
pub(super) use installation::sites;
pub use installation::{Installation, also_look_in, find_program};
use spawn::{Guard, spawn_from_lasting_thread};

/// Maximum number of ports that are tried.
const PORT_ATTEMPTS: u32 = 8;
/// Pause between two looks at the process.
const POLL: Duration = Duration::from_millis(1);
/// Longest time between the end of a connection and the end of its process, and longest wait for
/// the rest of its standard error.
const LAST_WORDS: Duration = Duration::from_millis(500);
/// Shortest time for which a SUMO that loads its files may do nothing.
const LEAST_IDLE: Duration = Duration::from_secs(10);
/// How much of SUMO's standard error is kept \[bytes\].
const TAIL_BYTES: usize = 4096;
/// How many lines of the kept standard error are reported.
const TAIL_LINES: usize = 10;

/// Options for starting SUMO.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Options {
    /// The program; `None`: the one that [`Installation::find`] finds.
    pub binary: Option<PathBuf>,
    /// Arguments, without `--remote-port`.
    pub arguments: Vec<OsString>,
    /// TCP port; `None`: a free one, replaced by another if it is taken before SUMO opens it.
    pub port: Option<u16>,
    /// Longest processor time that SUMO may use to load its files, besides 10 s for each megabyte
    /// that it reads.
    pub load_timeout: Duration,
    /// Longest time that SUMO may take to answer one message. A SUMO that does nothing for this
    /// time, and for 10 s, while it loads its files has failed.
    pub reply_timeout: Duration,
}

impl Default for Options {
    fn default() -> Self {
        Options {
            binary: None,
            arguments: Vec::new(),
            port: None,
            load_timeout: Duration::from_secs(60),
            reply_timeout: Duration::from_secs(60),
        }
    }
}

/// A running SUMO process, which is killed when this value is dropped. Where SUMO writes output
/// files, [`Client::close`] and then [`Process::wait`] let it finish them.
#[derive(Debug)]
pub struct Process {
    child: Child,
    group: Group,
    /// How the process ended, if it has.
    status: Option<ExitStatus>,
    /// Only for a script, which may start processes of its own.
    guard: Option<Guard>,
    patience: Patience,
    port: u16,
    stderr: Arc<Mutex<VecDeque<u8>>>,
    reader: Option<thread::JoinHandle<()>>,
}

impl Process {
    /// Starts SUMO, connects to it, and checks that the process that answers is the one that was
    /// started. With `--num-clients`, SUMO answers once the other clients have connected as well.
    ///
    /// # Errors
    /// [`Error::NotFound`] and [`Error::Spawn`] if SUMO cannot be found or started; [`Error::Io`] if
    /// the given port, or any port, cannot be opened; [`Error::Invalid`] if `reply_timeout` is zero;
    /// [`Error::Exited`] if SUMO ends while it loads; [`Error::PortTaken`] if the given port, or
    /// each of several free ports, is taken by another program; [`Error::NotLoaded`] if SUMO hangs
    /// while it loads; the errors of [`Client::handshake`].
    pub fn start(options: &Options) -> Result<(Process, Client, Version), Error> {
        Self::start_on(options, free_port)
    }

    fn start_on(
        options: &Options,
        mut choose: impl FnMut() -> Result<u16, Error>,
    ) -> Result<(Process, Client, Version), Error> {
        let sumo = match &options.binary {
            Some(binary) => Installation::at(binary, "named by the caller"),
            None => Installation::find()?,
        };
        let mut attempt = 0;
        loop {
            attempt += 1;
            let port = match options.port {
                Some(port) => port,
                None => choose()?,
            };
            match Self::try_start(&sumo, options, port) {
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
        sumo: &Installation,
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
        let mut process = Self::spawn(sumo, options, port)?;
        match process.connect(options) {
            Ok((client, version)) => Ok((process, client, version)),
            Err(error) => Err(process.port_lost().unwrap_or(error)),
        }
    }

    fn spawn(sumo: &Installation, options: &Options, port: u16) -> Result<Process, Error> {
        let mut command = sumo.command(sumo.binary());
        command.args(&options.arguments).arg("--remote-port").arg(port.to_string());
        command.stdout(Stdio::null()).stderr(Stdio::piped());
        let spawn_error = |source| Error::Spawn { binary: sumo.binary().to_owned(), source };
        let mut child = spawn_from_lasting_thread(command).map_err(spawn_error)?;
        let stderr = Arc::new(Mutex::new(VecDeque::new()));
        let (pipe, pid) = (child.stderr.take(), child.id());
        let mut process = Process {
            group: Group::new(Pid::from_child(&child), !sumo.is_script()),
            child,
            status: None,
            guard: None,
            patience: Patience {
                idle: options.reply_timeout.max(LEAST_IDLE),
                processor: options.load_timeout,
            },
            port,
            stderr: Arc::clone(&stderr),
            reader: None,
        };
        if sumo.is_script() {
            process.guard = Some(Guard::of(pid).map_err(spawn_error)?);
        }
        if let Some(pipe) = pipe {
            let reader = thread::Builder::new().name("sumo-stderr".to_owned());
            process.reader =
                Some(reader.spawn(move || keep_tail(pipe, &stderr)).map_err(spawn_error)?);
        }
        Ok(process)
    }

    fn connect(&mut self, options: &Options) -> Result<(Client, Version), Error> {
        let address = SocketAddr::from((Ipv4Addr::LOCALHOST, self.port));
        let mut loading = Loading::begin(&self.group, self.patience);
        let stream = client::open(address, Duration::MAX, || self.is_loading(&mut loading))?;
        let mut client = Client::new(stream, options.reply_timeout)?;
        // Only an answer proves that SUMO has accepted the connection and therefore owns its end of
        // it.
        let answer = client.handshake_while(|| self.is_loading(&mut loading));
        let owned = self.owns_other_end(client.stream());
        match (answer, owned) {
            (Ok(version), Ok(true)) => Ok((client, version)),
            (Ok(_), Err(source)) => {
                Err(Error::Io { doing: "find out whose port it is that answers", source })
            }
            // A SUMO that hangs before it accepts the connection does not own its end yet.
            (Err(error @ Error::NotLoaded { .. }), _) => Err(error),
            (_, Ok(false)) => Err(Error::PortTaken { port: self.port }),
            // A connection that is reset has no other end. A SUMO that runs does not close one
            // before it has answered, so another program did.
            (Err(error), _) => Err(match self.explain(error) {
                Error::Closed { .. } => Error::PortTaken { port: self.port },
                error => error,
            }),
        }
    }

    /// Replaces the simulation as [`Client::load`] does, but waits for SUMO as [`Process::start`]
    /// does while it loads its files.
    ///
    /// # Errors
    /// [`Error::Exited`] if SUMO cannot load the simulation; [`Error::NotLoaded`] if it hangs; the
    /// errors of [`Client::handshake`].
    pub fn load(
        &mut self,
        client: &mut Client,
        arguments: &[impl AsRef<str>],
    ) -> Result<Version, Error> {
        client.begin_load(arguments).map_err(|error| self.explain(error))?;
        let mut loading = Loading::begin(&self.group, self.patience);
        let answer = client.handshake_while(|| self.is_loading(&mut loading));
        answer.map_err(|error| self.explain(error))
    }

    /// Returns an error if SUMO has ended, or hangs.
    fn is_loading(&mut self, loading: &mut Loading) -> Result<(), Error> {
        if let Some(error) = self.exited(Duration::ZERO) {
            return Err(error);
        }
        loading.fault(&self.group).map_or(Ok(()), |why| Err(Error::NotLoaded { why }))
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
        self.group.holds(&socket)
    }

    /// Waits until SUMO has ended by itself, as it does after [`Client::close`] once it has written
    /// its output files; at most as long as `patience`. A SUMO that is killed before leaves
    /// incomplete files.
    ///
    /// # Errors
    /// [`Error::Timeout`] if SUMO still runs; [`Error::Exited`] if it ended with a failure.
    pub fn wait(&mut self, patience: Duration) -> Result<(), Error> {
        match (self.exited(patience), self.status) {
            (_, Some(status)) if status.success() => Ok(()),
            (Some(error), _) => Err(error),
            (None, _) => Err(Error::Timeout {
                command: "close",
                seconds: patience.as_secs_f64(),
                sim_time_s: None,
            }),
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
        let begin = Instant::now();
        while self.status.is_none() {
            if self.group.leader_has_ended() {
                // What the leader started ends with it.
                self.guard = None;
                self.group.kill();
                self.status = self.child.wait().ok();
            } else if begin.elapsed() >= patience {
                return None;
            } else {
                thread::sleep(POLL);
            }
        }
        let status = self.status?;
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
        // The group's number may belong to others as soon as this process has ended and has been
        // waited for.
        self.guard = None;
        if self.status.is_none() {
            self.group.kill();
            // Fails only if the process has already been waited for.
            let _ = self.child.wait();
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

/// Returns a net without roads, whose file exists as long as its handle, and arguments that start
/// SUMO with it. Without a net SUMO does not answer the handshake.
fn empty_net() -> Result<(tempfile::NamedTempFile, Vec<OsString>), Error> {
    let doing = "write a net to a temporary file";
    let mut file = tempfile::NamedTempFile::with_suffix(".net.xml")
        .map_err(|source| Error::Io { doing, source })?;
    file.write_all(b"<net version=\"1.0\"/>\n").map_err(|source| Error::Io { doing, source })?;
    let words = ["--xml-validation", "never", "--no-step-log", "--net-file"].map(OsString::from);
    let arguments = words.into_iter().chain([file.path().into()]).collect();
    Ok((file, arguments))
}

#[cfg(test)]
mod tests;
