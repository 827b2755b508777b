//! The handshake: which SUMO answers, and when it has loaded its files.

use std::{io, time::Duration};

use super::{Client, SETTING_UP};
use crate::sumo::{Error, batch::Batch, codec::Reader, constants as c, reply::Sink};

/// Longest time between two looks at a SUMO that does not answer yet.
const LOOK: Duration = Duration::from_millis(100);

/// SUMO's answer to the handshake.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Version {
    /// TraCI version number.
    pub api: i32,
    /// Program and version, for example `SUMO 1.15.0`.
    pub software: String,
}

impl Version {
    /// Returns SUMO's release, for example `1.15.0`.
    pub fn release(&self) -> &str {
        self.software.strip_prefix("SUMO ").unwrap_or(&self.software)
    }

    /// Rejects a version that is too old.
    fn accepted(self) -> Result<Self, Error> {
        let Version { api: found, software: peer } = self;
        if found < c::MINIMUM_API_VERSION {
            return Err(Error::Version { found, minimum: c::MINIMUM_API_VERSION, peer });
        }
        Ok(Version { api: found, software: peer })
    }
}

impl Client {
    /// Asks for the TraCI version and rejects one that is too old. Call this method before any
    /// other; with several clients, right after [`Client::set_order`].
    ///
    /// # Errors
    /// [`Error::Version`] for a version that is too old; [`Error::Protocol`], [`Error::Closed`] or
    /// [`Error::Timeout`] if the peer is not SUMO.
    pub fn handshake(&mut self) -> Result<Version, Error> {
        self.get_version()?.accepted()
    }

    /// As [`Client::handshake`], with a SUMO that may still load its files: waits for the answer
    /// without a time limit as long as `check` succeeds.
    pub(in crate::sumo) fn handshake_while(
        &mut self,
        mut check: impl FnMut() -> Result<(), Error>,
    ) -> Result<Version, Error> {
        let batch = self.ask_version()?;
        let begun = self.await_byte(&mut check);
        self.give_up_on_error(begun)?;
        self.receive_version(&batch)?.accepted()
    }

    /// Asks for the TraCI version and the program's name.
    ///
    /// # Errors
    /// As [`Client::receive`].
    pub fn get_version(&mut self) -> Result<Version, Error> {
        let batch = self.ask_version()?;
        self.receive_version(&batch)
    }

    fn ask_version(&mut self) -> Result<Batch, Error> {
        let mut batch = Batch::new();
        batch.version();
        self.send(&mut batch, None)?;
        Ok(batch)
    }

    fn receive_version(&mut self, batch: &Batch) -> Result<Version, Error> {
        let mut sink = VersionSink(None);
        self.receive(batch, &mut sink)?;
        sink.0.ok_or_else(|| {
            let found = "a refusal".to_owned();
            Error::Protocol { expected: "a TraCI version", found, at_byte: 4 }
        })
    }

    /// Waits until there is something to read, or the end of the connection, as long as `check`
    /// succeeds.
    fn await_byte(&self, check: &mut impl FnMut() -> Result<(), Error>) -> Result<(), Error> {
        let limit = |limit| {
            let set = self.stream.set_read_timeout(Some(limit));
            set.map_err(|source| Error::Io { doing: SETTING_UP, source })
        };
        limit(LOOK)?;
        while let Err(e) = self.stream.peek(&mut [0]) {
            match e.kind() {
                io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut => check()?,
                io::ErrorKind::Interrupted => {}
                _ => return Err(self.broken("getVersion", &e)),
            }
        }
        limit(self.timeout)
    }
}

struct VersionSink(Option<Version>);

impl Sink for VersionSink {
    fn answer(&mut self, _: usize, _: u8, _: u8, value: &mut Reader<'_>) -> Result<(), Error> {
        self.0 = Some(Version { api: value.i32()?, software: value.str()?.to_owned() });
        Ok(())
    }
}
