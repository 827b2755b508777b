//! Failures between this program and SUMO. SUMO knows two kinds: a refused command, after which the
//! connection remains usable, and everything else, after which it does not. [`Error::is_fatal`]
//! tells them apart.

use std::{io, path::PathBuf};

/// A failure of SUMO or of the connection to it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A program of SUMO is in none of the folders where it could be.
    #[error("{binary} was not found; looked in {}", list(looked_in))]
    NotFound {
        /// Name of the program.
        binary: String,
        /// Folders that were searched, in this order.
        looked_in: Vec<PathBuf>,
    },
    /// The operating system could not start the program.
    #[error("could not start `{}`", binary.display())]
    Spawn {
        /// The program.
        binary: PathBuf,
        /// The operating system's reason.
        source: io::Error,
    },
    /// SUMO terminated by itself or was killed.
    #[error("sumo ended ({status}); {}", last_words(stderr_tail))]
    Exited {
        /// Exit status or signal, in words.
        status: String,
        /// The last lines that SUMO wrote to its standard error.
        stderr_tail: String,
    },
    /// The port belongs to a program that is not the SUMO that was started.
    #[error("port {port} belongs to another program")]
    PortTaken {
        /// The TCP port.
        port: u16,
    },
    /// SUMO hangs while it loads its files.
    #[error("sumo did not finish loading its files: {why}")]
    NotLoaded {
        /// What SUMO did, in words.
        why: String,
    },
    /// No process opened the port in time.
    #[error("could not connect to sumo on port {port} ({attempts} attempts)")]
    Connect {
        /// The TCP port.
        port: u16,
        /// Number of attempts.
        attempts: u32,
        /// Error of the last attempt.
        source: io::Error,
    },
    /// The peer's TraCI version is lower than the lowest version that is accepted.
    #[error("the peer (`{peer}`) speaks TraCI version {found}; at least {minimum} is needed")]
    Version {
        /// Version number of the peer.
        found: i32,
        /// Lowest version number that is accepted.
        minimum: i32,
        /// Name that the peer gives itself.
        peer: String,
    },
    /// SUMO refused one command. The connection remains usable.
    #[error("sumo refused {call} for `{id}`: {message}")]
    Refused {
        /// TraCI command identifier.
        command: u8,
        /// SUMO's name of the call, such as `vehicle.setSpeed`, or its numbers if it has no name.
        call: String,
        /// The object that the command addressed; empty if it addressed none.
        id: String,
        /// SUMO's reason.
        message: String,
    },
    /// The peer closed the connection.
    #[error("sumo closed the connection during `{command}`{}", at_time(*sim_time_s))]
    Closed {
        /// The operation that was in progress.
        command: &'static str,
        /// Last known simulation time \[s\].
        sim_time_s: Option<f64>,
    },
    /// The peer did not answer in time.
    #[error("no answer to `{command}` within {seconds} s{}", at_time(*sim_time_s))]
    Timeout {
        /// The operation that was in progress.
        command: &'static str,
        /// Length of the wait \[s\].
        seconds: f64,
        /// Last known simulation time \[s\].
        sim_time_s: Option<f64>,
    },
    /// The peer sent bytes that are not a valid TraCI message.
    #[error("not a TraCI answer: expected {expected}, found {found} at byte {at_byte}")]
    Protocol {
        /// What the protocol requires at this position.
        expected: &'static str,
        /// What was found at this position.
        found: String,
        /// Position in the message \[bytes\].
        at_byte: usize,
    },
    /// A value is not of the requested type. The connection remains usable.
    #[error("{call} gives {found} where {expected} should be")]
    Type {
        /// SUMO's name of the call, or the subscription.
        call: String,
        /// The type that was expected.
        expected: &'static str,
        /// What was found.
        found: String,
    },
    /// The request cannot be sent, and nothing was sent. The connection remains usable.
    #[error("{what}")]
    Invalid {
        /// What is wrong and which values are allowed.
        what: String,
    },
    /// The program was built without this backend.
    #[error("this program was built without the backend `{backend}`")]
    NotBuiltIn {
        /// The backend.
        backend: super::Backend,
    },
    /// libsumo is already running a simulation.
    #[error("libsumo runs one simulation per process, and it is running one")]
    Occupied,
    /// libsumo failed, or Python failed while calling it.
    #[error("libsumo could not {doing}: {message}")]
    Libsumo {
        /// The operation that failed.
        doing: &'static str,
        /// The message of libsumo or Python.
        message: String,
    },
    /// The net file cannot be read.
    #[error(transparent)]
    Net(#[from] Box<super::net::NetError>),
    /// The operating system reported a failure.
    #[error("could not {doing}")]
    Io {
        /// The operation that failed.
        doing: &'static str,
        /// The operating system's reason.
        source: io::Error,
    },
}

impl Error {
    /// Whether this SUMO instance is lost. If `false`, the connection is usable and the simulation
    /// goes on.
    #[must_use]
    pub fn is_fatal(&self) -> bool {
        !matches!(
            self,
            Error::Refused { .. }
                | Error::Type { .. }
                | Error::Invalid { .. }
                | Error::Occupied
                | Error::NotBuiltIn { .. }
        )
    }

    /// Returns what the user can do about the error, if anything is known.
    #[must_use]
    pub fn hint(&self) -> Option<String> {
        match self {
            Error::NotFound { binary, .. } => Some(format!(
                "run `scripts/bootstrap`, or `pip install eclipse-sumo` in a virtual environment, or set `SUMO_HOME` to the folder whose `bin` holds `{binary}`"
            )),
            Error::Exited { stderr_tail, .. } if stderr_tail.contains("shared libraries") => {
                Some("SUMO loads the libraries of another program: unset LD_LIBRARY_PATH".to_owned())
            }
            Error::NotLoaded { .. } => Some(
                "SUMO waits for something or is stopped; `iwol doctor` tries it on a small net"
                    .to_owned(),
            ),
            Error::Timeout { .. } => Some(
                "if the machine is busy, wait longer: `--set simulation.timeout=60`".to_owned(),
            ),
            Error::Net(e) => e.hint(),
            Error::NotBuiltIn { .. } => Some(
                "build with `--features libsumo` (`make build` does), or use --backend traci"
                    .to_owned(),
            ),
            Error::Occupied => {
                Some("use --backend traci, which takes any number of simulations".to_owned())
            }
            Error::Libsumo { doing: "import it", .. } => Some(
                "run `scripts/bootstrap`, which installs Debian's SUMO with its Python module, or use --backend traci".to_owned(),
            ),
            Error::Libsumo { doing: "stand in for sumo", .. } => Some(
                "use --backend traci, or the SUMO whose release libsumo has".to_owned(),
            ),
            Error::Version { .. } => {
                Some("install SUMO 1.15 or later with `scripts/bootstrap`".to_owned())
            }
            Error::PortTaken { port } => Some(format!(
                "choose a port other than {port}, or name none; a script `sumo` must keep SUMO in its process group"
            )),
            _ => None,
        }
    }

    /// Adds the name of the call to the error in its answer.
    pub(super) fn in_answer_to(self, call: &str) -> Self {
        match self {
            Error::Protocol { expected, found, at_byte } if !call.is_empty() => Error::Protocol {
                expected,
                found: format!("{found} as the answer to {call}"),
                at_byte,
            },
            Error::Type { expected, found, .. } if !call.is_empty() => {
                Error::Type { call: call.to_owned(), expected, found }
            }
            other => other,
        }
    }

    /// Returns the error for a value of an unexpected type, in a call that [`Error::in_answer_to`]
    /// is going to name.
    pub(super) fn other_type(expected: &'static str, found: impl Into<String>) -> Self {
        Error::Type { call: "a call".to_owned(), expected, found: found.into() }
    }

    pub(crate) fn invalid(what: impl Into<String>) -> Self {
        Error::Invalid { what: what.into() }
    }
}

fn at_time(sim_time_s: Option<f64>) -> String {
    sim_time_s.map(|time| format!(" at simulation time {time} s")).unwrap_or_default()
}

fn list(folders: &[PathBuf]) -> String {
    if folders.is_empty() {
        return "no folder: neither `SUMO_HOME` nor `PATH` is set".to_owned();
    }
    let names: Vec<String> = folders.iter().map(|f| format!("`{}`", f.display())).collect();
    names.join(", ")
}

fn last_words(stderr_tail: &str) -> String {
    if stderr_tail.is_empty() {
        return "it printed no message".to_owned();
    }
    format!("its last words: {stderr_tail}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_refusals_and_bad_requests_leave_the_connection_intact() {
        let refused = Error::Refused {
            command: 0xc4,
            call: "vehicle.setSpeed".into(),
            id: "v".into(),
            message: "no".into(),
        };
        assert!(!refused.is_fatal());
        assert_eq!(refused.to_string(), "sumo refused vehicle.setSpeed for `v`: no");
        assert!(!Error::invalid("slot 9 of 8").is_fatal());
        assert!(!Error::other_type("a double", "a string").is_fatal());
        let mut closed = Error::Closed { command: "step", sim_time_s: Some(1.5) };
        assert!(closed.is_fatal());
        assert_eq!(
            closed.to_string(),
            "sumo closed the connection during `step` at simulation time 1.5 s"
        );
        closed = Error::Closed { command: "step", sim_time_s: None };
        assert_eq!(closed.to_string(), "sumo closed the connection during `step`");
        assert!(Error::PortTaken { port: 1 }.is_fatal());
    }

    #[test]
    fn a_missing_sumo_names_the_folders_and_the_way_out() {
        let error =
            Error::NotFound { binary: "sumo".into(), looked_in: vec!["/a".into(), "/b".into()] };
        assert_eq!(error.to_string(), "sumo was not found; looked in `/a`, `/b`");
        assert!(error.hint().is_some_and(|h| h.contains("scripts/bootstrap")));
    }
}
