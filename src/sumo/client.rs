//! The TraCI connection: one message out, one message in. [`Client`] sends a [`Batch`] and reads the
//! reply; what comes back is handed, in place, to a [`Sink`], so that a caller who steps thousands of
//! times a second copies nothing. [`Client::run`], [`Client::step`] and [`Client::call`] collect the
//! same into owned values.

use std::{
    io::{self, Read as _, Write as _},
    net::{Shutdown, SocketAddr, TcpStream},
    sync::Arc,
    time::{Duration, Instant},
};

use super::{
    Error,
    batch::{Batch, Outcome},
    codec::{Reader, Value},
    constants as c,
    reply::{Report, Sink, parse_reply, read_value},
};

/// The peer's answer to the handshake.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Version {
    /// TraCI version number.
    pub api: i32,
    /// Program and version, for example `SUMO 1.15.0`.
    pub software: String,
}

/// One variable of a subscription, as [`Client::step`] collects it.
#[derive(Debug, Clone, PartialEq)]
pub struct Observed {
    /// As [`Report::response`].
    pub response: u8,
    /// As [`Report::around`].
    pub around: Option<Arc<str>>,
    /// As [`Report::object`].
    pub object: Arc<str>,
    /// As [`Report::variable`].
    pub variable: u8,
    /// The value, or SUMO's message why there is none.
    pub value: Result<Value, String>,
}

/// What came back from [`Client::step`].
#[derive(Debug, Default)]
pub struct StepReply {
    /// For each command of the batch, what SUMO said.
    pub outcomes: Vec<Outcome>,
    /// What the subscriptions report after the step.
    pub subscriptions: Vec<Observed>,
}

/// A connection to SUMO.
#[derive(Debug)]
pub struct Client {
    stream: TcpStream,
    /// Length of the reply's buffer is the most that was ever needed; the reply is a part of it.
    input: Vec<u8>,
    timeout: Duration,
    time_s: f64,
}

impl Client {
    /// Connects to a SUMO that listens on `address`. `timeout` bounds the wait for each reply.
    ///
    /// # Errors
    /// [`Error::Connect`] if nobody listens there.
    pub fn connect(address: SocketAddr, timeout: Duration) -> Result<Self, Error> {
        let stream = TcpStream::connect_timeout(&address, timeout).map_err(|source| Error::Connect {
            port: address.port(),
            attempts: 1,
            source,
        })?;
        Self::new(stream, timeout)
    }

    /// A client on a connection that exists.
    ///
    /// # Errors
    /// [`Error::Io`] if the connection cannot be set up for short messages and timeouts.
    pub fn new(stream: TcpStream, timeout: Duration) -> Result<Self, Error> {
        let doing = "set up the connection to sumo";
        let set = || {
            stream.set_nodelay(true)?;
            stream.set_write_timeout(Some(timeout))?;
            stream.set_read_timeout(Some(timeout))
        };
        set().map_err(|source| Error::Io { doing, source })?;
        Ok(Client { stream, input: Vec::new(), timeout, time_s: 0.0 })
    }

    pub(super) fn stream(&self) -> &TcpStream {
        &self.stream
    }

    /// Simulation time that error messages name \[s\].
    pub(super) fn set_time(&mut self, time_s: f64) {
        self.time_s = time_s;
    }

    /// Asks for the TraCI version and refuses one that is too old. Must be the first exchange.
    ///
    /// # Errors
    /// [`Error::Version`]; [`Error::Protocol`], [`Error::Closed`] or [`Error::Timeout`] if the peer is not SUMO.
    pub fn handshake(&mut self) -> Result<Version, Error> {
        let mut batch = Batch::new();
        batch.version();
        self.send(&mut batch, None)?;
        let mut sink = VersionSink(None);
        self.receive(&batch, &mut sink)?;
        match sink.0 {
            Some(version) if version.api >= c::MINIMUM_API_VERSION => Ok(version),
            Some(Version { api, software }) => {
                Err(Error::Version { found: api, minimum: c::MINIMUM_API_VERSION, peer: software })
            }
            None => {
                let found = "a refusal".to_owned();
                Err(Error::Protocol { expected: "a TraCI version", found, at_byte: 4 })
            }
        }
    }

    /// Sends one command, which `fill` puts into an empty batch, and returns its value if it has one.
    ///
    /// # Errors
    /// [`Error::Refused`]; fatal ones as [`Client::receive`]; [`Error::Invalid`] if it is not one command.
    pub fn call(&mut self, fill: impl FnOnce(&mut Batch)) -> Outcome {
        let mut batch = Batch::new();
        fill(&mut batch);
        match <[Outcome; 1]>::try_from(self.run(&mut batch)?) {
            Ok([outcome]) => outcome,
            Err(outcomes) => Err(Error::invalid(format!("a call holds one command, not {}", outcomes.len()))),
        }
    }

    /// Sends the commands of a batch without a step, and empties the batch.
    ///
    /// # Errors
    /// As [`Client::send`] and [`Client::receive`]; a refused command is an error in its own place only.
    pub fn run(&mut self, batch: &mut Batch) -> Result<Vec<Outcome>, Error> {
        if batch.is_empty() {
            return Ok(Vec::new());
        }
        Ok(self.exchange(batch, None)?.outcomes)
    }

    /// Sends the commands of a batch and one step to `until` \[s\] (0: one step length), and empties the batch.
    ///
    /// # Errors
    /// As [`Client::run`]; [`Error::Refused`] if SUMO refuses the step itself.
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
        let reply = sink.reply;
        batch.clear();
        Ok(reply)
    }

    /// Sends a batch, with a step as its last command if `until` is given, and does not wait.
    ///
    /// # Errors
    /// [`Error::Invalid`] if the message is too long; [`Error::Closed`] or [`Error::Timeout`] if it does not get out.
    pub fn send(&mut self, batch: &mut Batch, until: Option<f64>) -> Result<(), Error> {
        let message = batch.seal(until)?;
        let written = self.stream.write_all(message);
        let written = written.map_err(|source| self.broken(doing(until.is_some()), &source));
        self.give_up_on_error(written)
    }

    /// Waits for the reply to the last [`Client::send`], whose batch must be given again unchanged.
    ///
    /// # Errors
    /// [`Error::Closed`], [`Error::Timeout`], [`Error::Protocol`], and what the sink returns; all of them are fatal.
    /// Refused commands are told to the sink.
    pub fn receive(&mut self, batch: &Batch, sink: &mut impl Sink) -> Result<(), Error> {
        let (_, stepped) = batch.sealed();
        let message = self.read_message(doing(stepped));
        let read = message.and_then(|length| parse_reply(&self.input[..length], batch, sink));
        self.give_up_on_error(read)
    }

    /// Ends the connection after an error: an answer that comes too late must not pass for the next one.
    fn give_up_on_error(&self, result: Result<(), Error>) -> Result<(), Error> {
        if result.is_err() {
            // It may be closed already.
            let _ = self.stream.shutdown(Shutdown::Both);
        }
        result
    }

    /// Tells SUMO that this client is done; SUMO ends then.
    ///
    /// # Errors
    /// As [`Client::receive`].
    pub fn close(mut self) -> Result<(), Error> {
        let mut batch = Batch::new();
        batch.close();
        self.run(&mut batch)?;
        let _ = self.stream.shutdown(Shutdown::Both);
        Ok(())
    }

    /// Reads one message into the buffer and returns its length. The buffer grows with the bytes that
    /// come, not with the length that is claimed.
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
            return Err(Error::Protocol { expected: "the end of the message", found, at_byte: length });
        }
        Ok(length)
    }

    fn broken(&self, command: &'static str, source: &io::Error) -> Error {
        match source.kind() {
            io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut => {
                Error::Timeout { command, seconds: self.timeout.as_secs_f64(), sim_time_s: self.time_s }
            }
            _ => Error::Closed { command, sim_time_s: self.time_s },
        }
    }
}

fn doing(stepped: bool) -> &'static str {
    if stepped { "simulation step" } else { "commands" }
}

fn message_length(bytes: &[u8]) -> Result<usize, Error> {
    let claimed = Reader::new(bytes, 0).i32()?;
    usize::try_from(claimed).ok().filter(|n| (4..=c::MAXIMUM_MESSAGE).contains(n)).ok_or_else(|| {
        let found = format!("a length of {claimed} bytes");
        Error::Protocol { expected: "a message", found, at_byte: 0 }
    })
}

struct VersionSink(Option<Version>);

impl Sink for VersionSink {
    fn answer(&mut self, _: usize, _: u8, _: u8, value: &mut Reader<'_>) -> Result<(), Error> {
        self.0 = Some(Version { api: value.i32()?, software: value.str()?.to_owned() });
        Ok(())
    }
}

pub(super) struct Collector<'a> {
    batch: &'a Batch,
    pub(super) reply: StepReply,
    around: Shared,
    object: Shared,
}

impl<'a> Collector<'a> {
    pub(super) fn new(batch: &'a Batch) -> Self {
        let outcomes = batch.sealed().0.iter().map(|_| Ok(None)).collect();
        let reply = StepReply { outcomes, subscriptions: Vec::new() };
        Collector { batch, reply, around: Shared::default(), object: Shared::default() }
    }
}

/// The last of the names in a reply: a name stands there once, for any number of values, which share one copy.
#[derive(Default)]
struct Shared {
    /// Address and length in the reply.
    place: (usize, usize),
    name: Arc<str>,
}

impl Shared {
    fn copy(&mut self, name: &str) -> Arc<str> {
        let place = (name.as_ptr().addr(), name.len());
        if self.place != place {
            *self = Shared { place, name: name.into() };
        }
        Arc::clone(&self.name)
    }
}

impl Sink for Collector<'_> {
    fn refused(&mut self, index: usize, message: &str) {
        if let Some(outcome) = self.reply.outcomes.get_mut(index) {
            *outcome = Err(self.batch.refusal(index, message));
        }
    }

    fn answer(&mut self, index: usize, response: u8, variable: u8, value: &mut Reader<'_>) -> Result<(), Error> {
        let value = read_value(response, variable, value)?;
        if let Some(outcome) = self.reply.outcomes.get_mut(index) {
            *outcome = Ok(Some(value));
        }
        Ok(())
    }

    fn report(&mut self, report: Report<'_>, value: &mut Reader<'_>) -> Result<(), Error> {
        let value = if report.known {
            Ok(read_value(report.response, report.variable, value)?)
        } else {
            Err(value.string()?.to_owned())
        };
        if report.after_step {
            self.reply.subscriptions.push(Observed {
                response: report.response,
                around: report.around.map(|name| self.around.copy(name)),
                object: self.object.copy(report.object),
                variable: report.variable,
                value,
            });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
