//! The TraCI connection: one message out, one message in. [`Client`] sends a [`Batch`] and passes
//! the parts of the reply to a [`Sink`] without copying them, which matters at thousands of steps
//! per second. [`Client::run`], [`Client::step`] and [`Client::call`] collect the reply into owned
//! values.

mod calls;
mod version;

use std::{
    io::{self, Read as _, Write as _},
    net::{Shutdown, SocketAddr, TcpStream},
    thread,
    time::{Duration, Instant},
};

use super::{
    Error,
    batch::{Batch, CallResult},
    codec::Reader,
    constants as c,
    domain::simulation::LOAD_STATE,
    replies::{Collector, Replies, Reports, StepReply},
    reply::{Sink, parse_reply},
};
pub use calls::ClientBatch;
pub use version::Version;

/// A connection to SUMO. Each method of a domain, such as those of [`Client::vehicle`], is one
/// exchange. [`Client::batch`] combines any number of calls in one exchange.
///
/// For several clients, start SUMO with `--num-clients <n>`. SUMO answers no client before all of
/// them have connected. Each client has to call [`Client::set_order`] before its first step, and
/// every step waits for all clients. SUMO carries out the commands of one client after those of the
/// other, does not support [`Client::load`] in this mode, and reports every subscription to every
/// client.
#[derive(Debug)]
pub struct Client {
    stream: TcpStream,
    /// Receive buffer, as long as the longest reply so far; a reply occupies its first bytes.
    input: Vec<u8>,
    timeout: Duration,
    /// Last known simulation time \[s\].
    time_s: Option<f64>,
    /// Numbers of bytes sent and received so far.
    bytes: (u64, u64),
    /// The batch for calls of one exchange each, kept to reuse its buffers.
    single: Batch,
    /// Whether the reply to the last message has not been read yet.
    awaiting: bool,
}

impl Client {
    /// Connects to a SUMO process that listens on `address`. `timeout` limits the wait for each
    /// reply.
    ///
    /// # Errors
    /// [`Error::Connect`] if no process listens on `address`; [`Error::Invalid`] if `timeout` is
    /// zero.
    pub fn connect(address: SocketAddr, timeout: Duration) -> Result<Self, Error> {
        check_timeout(timeout)?;
        let stream = TcpStream::connect_timeout(&address, timeout)
            .map_err(|source| Error::Connect { port: address.port(), attempts: 1, source })?;
        Self::new(stream, timeout)
    }

    /// Connects as [`Client::connect`] does, but retries for up to `wait` while no process listens
    /// on `address`, for example because SUMO has just been started.
    ///
    /// # Errors
    /// [`Error::Connect`] if no process listens on `address` in that time.
    pub fn connect_within(
        address: SocketAddr,
        wait: Duration,
        timeout: Duration,
    ) -> Result<Self, Error> {
        Self::new(open(address, wait, || Ok(()))?, timeout)
    }

    /// Returns a client for a connection that is already open.
    ///
    /// # Errors
    /// [`Error::Io`] if `TCP_NODELAY` or the timeouts cannot be set; [`Error::Invalid`] if
    /// `timeout` is zero.
    pub fn new(stream: TcpStream, timeout: Duration) -> Result<Self, Error> {
        check_timeout(timeout)?;
        stream.set_nodelay(true).map_err(|source| Error::Io { doing: SETTING_UP, source })?;
        set_timeouts(&stream, timeout)?;
        Ok(Client {
            stream,
            input: Vec::new(),
            timeout,
            time_s: None,
            single: Batch::new(),
            awaiting: false,
            bytes: (0, 0),
        })
    }

    /// Returns the numbers of bytes sent and received so far.
    pub fn bytes(&self) -> (u64, u64) {
        self.bytes
    }

    pub(super) fn stream(&self) -> &TcpStream {
        &self.stream
    }

    /// Sets the limit of the wait for each following reply.
    ///
    /// # Errors
    /// [`Error::Invalid`] if `timeout` is zero; [`Error::Io`] if the timeout cannot be set.
    pub fn set_timeout(&mut self, timeout: Duration) -> Result<(), Error> {
        check_timeout(timeout)?;
        set_timeouts(&self.stream, timeout)?;
        self.timeout = timeout;
        Ok(())
    }

    /// Sets the simulation time that error messages give \[s\].
    pub(super) fn set_time(&mut self, time_s: f64) {
        self.time_s = Some(time_s);
    }

    /// Simulates one step (`until` = 0), or up to the time `until` \[s\], and returns what the
    /// subscriptions report. If `until` is neither 0 nor in the future, SUMO simulates nothing. All
    /// steps up to `until` are one reply, for which the client waits no longer than its timeout
    /// ([`Client::set_timeout`]).
    ///
    /// # Errors
    /// As [`Client::step`].
    pub fn simulation_step(&mut self, until: f64) -> Result<Reports, Error> {
        Ok(self.step(&mut Batch::new(), until)?.reports)
    }

    /// Replaces the simulation by one with other command line arguments (without the program's
    /// name), and waits until SUMO has loaded it, no longer than the client's timeout;
    /// [`Process::load`](super::process::Process::load) waits for as long as SUMO works. All
    /// subscriptions end. SUMO does not support this with several clients.
    ///
    /// # Errors
    /// [`Error::Closed`] if SUMO cannot load the simulation, whereupon it terminates;
    /// [`Error::Timeout`] if it takes longer; the errors of [`Client::handshake`].
    pub fn load(&mut self, arguments: &[impl AsRef<str>]) -> Result<Version, Error> {
        self.begin_load(arguments)?;
        self.handshake()
    }

    /// Tells SUMO to load another simulation. SUMO agrees before it reads the files.
    pub(super) fn begin_load(&mut self, arguments: &[impl AsRef<str>]) -> Result<(), Error> {
        self.call(|batch| batch.load(arguments)).map(drop)
    }

    /// Sets the rank of this client among several; SUMO carries out the commands of lower numbers
    /// first. Each client has to call this before its first step.
    ///
    /// # Errors
    /// As [`Client::call`].
    pub fn set_order(&mut self, order: i32) -> Result<(), Error> {
        self.call(|batch| batch.set_order(order)).map(drop)
    }

    /// Returns an empty batch that is bound to this client.
    pub fn batch(&mut self) -> ClientBatch<'_> {
        ClientBatch { client: self, batch: Batch::new() }
    }

    /// Sends one command, which `fill` adds to an empty batch, and returns its value if it has one.
    ///
    /// # Errors
    /// [`Error::Refused`] if SUMO refuses the command; fatal errors as in [`Client::receive`];
    /// [`Error::Invalid`] if `fill` does not add exactly one command.
    pub fn call(&mut self, fill: impl FnOnce(&mut Batch)) -> CallResult {
        let mut batch = Batch::new();
        fill(&mut batch);
        if batch.len() != 1 {
            return Err(Error::invalid(format!("a call holds one command, not {}", batch.len())));
        }
        self.run(&mut batch)?.pop().unwrap_or(Ok(None))
    }

    /// Sends the commands of a batch without a step, and empties the batch.
    ///
    /// # Errors
    /// As [`Client::send`] and [`Client::receive`]. A refused command does not fail the call: its
    /// error is in the command's place in the replies.
    pub fn run(&mut self, batch: &mut Batch) -> Result<Replies, Error> {
        Ok(self.exchange(batch, None)?.outcomes)
    }

    /// Sends the commands of a batch and a step to the time `until` \[s\] (0: one step length), and
    /// empties the batch. If `until` is neither 0 nor in the future, SUMO simulates nothing.
    ///
    /// # Errors
    /// As [`Client::run`]; [`Error::Refused`] if SUMO refuses the step itself; [`Error::Invalid`]
    /// if `until` is negative or not finite, in which case nothing is sent.
    pub fn step(&mut self, batch: &mut Batch, until: f64) -> Result<StepReply, Error> {
        let mut reply = self.exchange(batch, Some(until))?;
        match reply.outcomes.pop() {
            Some(Err(refused)) => Err(refused),
            _ => Ok(reply),
        }
    }

    fn exchange(&mut self, batch: &mut Batch, until: Option<f64>) -> Result<StepReply, Error> {
        self.send(batch, until)?;
        let mut sink = Collector::new(batch);
        self.receive(batch, &mut sink)?;
        let Collector { reply, time_s, .. } = sink;
        let (queued, _) = batch.sealed();
        if queued
            .iter()
            .any(|queued| queued.call.command == c::CMD_LOAD || queued.call.is(LOAD_STATE))
        {
            self.time_s = None;
        }
        self.time_s = time_s.or(self.time_s);
        if let Some(until) = until.filter(|until| *until > 0.0) {
            self.time_s = Some(self.time_s.map_or(until, |time| time.max(until)));
        }
        batch.clear();
        Ok(reply)
    }

    /// Sends a batch without waiting for the reply, with a step to the time `until` \[s\] as its
    /// last command if `until` is given. A message without commands is not sent.
    ///
    /// # Errors
    /// [`Error::Invalid`] if the message is too long, `until` is negative or not finite, or the reply
    /// to the message before has not been received; [`Error::Closed`] or [`Error::Timeout`] if the
    /// message cannot be sent.
    pub fn send(&mut self, batch: &mut Batch, until: Option<f64>) -> Result<(), Error> {
        if self.awaiting {
            return Err(Error::invalid("the reply to the last message has not been received yet"));
        }
        let message = batch.seal(until)?;
        if message == SILENCE {
            return Ok(());
        }
        self.bytes.0 += message.len() as u64;
        let written = self.stream.write_all(message);
        let written = written.map_err(|source| self.broken(doing(batch), &source));
        self.give_up_on_error(written)?;
        self.awaiting = true;
        Ok(())
    }

    /// Waits for the reply to the last [`Client::send`]; `batch` must be the batch that was sent,
    /// unchanged.
    ///
    /// # Errors
    /// [`Error::Closed`], [`Error::Timeout`], [`Error::Protocol`], and the errors of the sink, all
    /// of them fatal; [`Error::Invalid`] if nothing has been sent to which SUMO would reply. A refused
    /// command is not an error here; it is passed to [`Sink::refused`].
    pub fn receive(&mut self, batch: &Batch, sink: &mut impl Sink) -> Result<(), Error> {
        if batch.is_silent() {
            return parse_reply(&SILENCE, batch, sink);
        }
        if !std::mem::take(&mut self.awaiting) {
            return Err(Error::invalid("no message has been sent to which SUMO would reply"));
        }
        let message = self.read_message(doing(batch));
        let read = message.and_then(|length| parse_reply(&self.input[..length], batch, sink));
        self.give_up_on_error(read)
    }

    /// Closes the connection after an error, so that a late answer cannot be mistaken for the
    /// answer to the next message.
    fn give_up_on_error(&mut self, result: Result<(), Error>) -> Result<(), Error> {
        if result.is_err() {
            self.awaiting = false;
            // Fails only if the connection is already closed.
            let _ = self.stream.shutdown(Shutdown::Both);
        }
        result
    }

    /// Closes the connection after telling SUMO so. Without other clients, SUMO then finishes its
    /// output files and terminates; [`Process::wait`](super::process::Process::wait) waits for
    /// that.
    ///
    /// # Errors
    /// As [`Client::receive`].
    pub fn close(mut self) -> Result<(), Error> {
        let mut batch = Batch::new();
        batch.close();
        self.run(&mut batch)?.check()?;
        // Fails only if the connection is already closed.
        let _ = self.stream.shutdown(Shutdown::Both);
        Ok(())
    }

    /// Reads one message into the buffer and returns its length. The buffer grows with the bytes
    /// received, not with the length that the message claims.
    fn read_message(&mut self, command: &'static str) -> Result<usize, Error> {
        const CHUNK: usize = 16 << 10;
        let start = Instant::now();
        let mut filled = 0;
        let mut length = None;
        loop {
            let needed = length.unwrap_or(4);
            if filled >= needed {
                if length.is_some() {
                    break;
                }
                length = Some(message_length(&self.input)?);
                continue;
            }
            let room = needed.min(filled + (filled / 2).max(CHUNK)).max(CHUNK);
            if self.input.len() < room {
                self.input.resize(room, 0);
            }
            match self.stream.read(&mut self.input[filled..]) {
                Ok(0) => {
                    return Err(Error::Closed { command, sim_time_s: self.time_s });
                }
                Ok(n) => filled += n,
                Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                Err(e) => return Err(self.broken(command, &e)),
            }
            if filled < length.unwrap_or(4) && start.elapsed() > self.timeout {
                return Err(self.broken(command, &io::ErrorKind::TimedOut.into()));
            }
        }
        let length = length.unwrap_or(4);
        if filled > length {
            let found = format!("{} bytes after it", filled - length);
            return Err(Error::Protocol {
                expected: "the end of the message",
                found,
                at_byte: length,
            });
        }
        self.bytes.1 += length as u64;
        Ok(length)
    }

    fn broken(&self, command: &'static str, source: &io::Error) -> Error {
        match source.kind() {
            io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut => Error::Timeout {
                command,
                seconds: self.timeout.as_secs_f64(),
                sim_time_s: self.time_s,
            },
            _ => Error::Closed { command, sim_time_s: self.time_s },
        }
    }
}

/// A message without commands.
const SILENCE: [u8; 4] = [0, 0, 0, 4];
/// Pause between two attempts to connect.
const POLL: Duration = Duration::from_millis(1);
/// Longest duration of one attempt to connect.
const ATTEMPT: Duration = Duration::from_secs(1);
const SETTING_UP: &str = "set up the connection to sumo";

fn check_timeout(timeout: Duration) -> Result<(), Error> {
    if timeout.is_zero() {
        return Err(Error::invalid("a timeout must be longer than zero"));
    }
    Ok(())
}

/// Opens a connection to `address`. Retries for up to `wait` while no process listens there, as
/// long as `check` succeeds.
pub(super) fn open(
    address: SocketAddr,
    wait: Duration,
    mut check: impl FnMut() -> Result<(), Error>,
) -> Result<TcpStream, Error> {
    let start = Instant::now();
    let mut attempts = 0;
    loop {
        attempts += 1;
        let left = wait.saturating_sub(start.elapsed()).clamp(POLL, ATTEMPT);
        let source = match TcpStream::connect_timeout(&address, left) {
            // If the system picks the free target port as the local port, TCP connects the socket
            // to itself.
            Ok(stream) if stream.local_addr().ok() == Some(address) => {
                io::ErrorKind::ConnectionRefused.into()
            }
            Ok(stream) => return Ok(stream),
            Err(source) => source,
        };
        check()?;
        if start.elapsed() >= wait {
            return Err(Error::Connect { port: address.port(), attempts, source });
        }
        thread::sleep(POLL);
    }
}

fn set_timeouts(stream: &TcpStream, timeout: Duration) -> Result<(), Error> {
    let write = stream.set_write_timeout(Some(timeout));
    write
        .and_then(|()| stream.set_read_timeout(Some(timeout)))
        .map_err(|source| Error::Io { doing: SETTING_UP, source })
}

/// Describes what a sealed batch does, for error messages.
fn doing(batch: &Batch) -> &'static str {
    match batch.sealed() {
        (_, true) => "simulation step",
        ([only], false) if !only.call.name.is_empty() => only.call.name,
        _ => "commands",
    }
}

fn message_length(bytes: &[u8]) -> Result<usize, Error> {
    let claimed = Reader::new(bytes, 0).i32()?;
    usize::try_from(claimed).ok().filter(|n| (4..=c::MAXIMUM_MESSAGE).contains(n)).ok_or_else(
        || {
            let found = format!("a length of {claimed} bytes");
            Error::Protocol { expected: "a message", found, at_byte: 0 }
        },
    )
}

#[cfg(test)]
mod tests;
