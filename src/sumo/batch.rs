//! Any number of commands for one message. A [`Batch`] keeps its buffers, so that one that is filled
//! again and again allocates nothing. The step is not a command of the batch: the client appends it,
//! last, because SUMO carries out what follows a step in a message before that step.

use std::{
    ops::Range,
    sync::atomic::{AtomicU64, Ordering},
};

use super::{
    Error,
    codec::{Reader, Value, Writer},
    constants::{self as c, Domain},
};

/// What follows the status of a command that was carried out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Answer {
    Nothing,
    Version,
    Variable,
    Subscription { context: bool },
}

#[derive(Debug, Clone)]
pub(super) struct Queued {
    pub(super) call: Call,
    /// Where the object's identifier (an untyped string) lies in the message.
    object: Range<usize>,
}

/// What a command is, its object and content aside.
#[derive(Debug, Clone, Copy)]
pub(super) struct Call {
    /// SUMO's name, such as `vehicle.getSpeed`; empty for a command that was put together by hand.
    pub(super) name: &'static str,
    pub(super) command: u8,
    /// The variable that is read or changed.
    pub(super) variable: Option<u8>,
    pub(super) answer: Answer,
}

impl Call {
    pub(super) const fn new(name: &'static str, command: u8) -> Self {
        Call { name, command, variable: None, answer: Answer::Nothing }
    }

    pub(super) const fn get(name: &'static str, domain: Domain, variable: u8) -> Self {
        Call { name, command: domain.get, variable: Some(variable), answer: Answer::Variable }
    }

    pub(super) const fn set(name: &'static str, domain: Domain, variable: u8) -> Self {
        Call { name, command: domain.set, variable: Some(variable), answer: Answer::Nothing }
    }
}

/// Commands for one message, in the order in which SUMO carries them out. The methods of the domains, such
/// as [`Batch::vehicle`], add commands; each returns a [`Ticket`](super::Ticket), for which the reply to the
/// batch has the result. [`Client::run`](super::Client::run) and [`Client::step`](super::Client::step) send it.
#[derive(Debug)]
pub struct Batch {
    /// No other batch has it, nor this one after [`Batch::clear`].
    number: u64,
    writer: Writer,
    queued: Vec<Queued>,
    stepped: bool,
}

impl Default for Batch {
    fn default() -> Self {
        Batch { number: new_number(), writer: Writer::default(), queued: Vec::new(), stepped: false }
    }
}

fn new_number() -> u64 {
    static NEXT: AtomicU64 = AtomicU64::new(0);
    NEXT.fetch_add(1, Ordering::Relaxed)
}

impl Batch {
    /// An empty batch.
    pub fn new() -> Self {
        Self::default()
    }

    /// Number of commands.
    pub fn len(&self) -> usize {
        self.queued.len()
    }

    /// Whether there is no command.
    pub fn is_empty(&self) -> bool {
        self.queued.is_empty()
    }

    pub(super) fn number(&self) -> u64 {
        self.number
    }

    /// Takes all commands out; the buffers stay, the tickets are void.
    pub fn clear(&mut self) {
        self.number = new_number();
        self.writer.truncate(0);
        self.queued.clear();
        self.stepped = false;
    }

    /// Changes a variable of an object; `value` writes the typed value.
    pub fn set(&mut self, domain: Domain, variable: u8, object: &str, value: impl FnOnce(&mut Writer)) {
        self.call(Call::set("", domain, variable), object, value);
    }

    /// Reads a variable of an object, as it is when the command's turn comes: before the step.
    pub fn get(&mut self, domain: Domain, variable: u8, object: &str) {
        self.call(Call::get("", domain, variable), object, |_| {});
    }

    /// A command that reads or changes a variable of an object.
    pub(super) fn call(&mut self, call: Call, object: &str, content: impl FnOnce(&mut Writer)) {
        self.push(call, usize::from(call.variable.is_some()), |w| {
            if let Some(variable) = call.variable {
                w.u8(variable);
            }
            w.str(object);
            content(w);
        });
    }

    /// A command that is for no object.
    pub(super) fn command(&mut self, call: Call, content: impl FnOnce(&mut Writer)) {
        // No text can begin at the end of the command.
        self.push(call, usize::MAX, content);
    }

    /// Has the variables of an object reported now and after each step from now on; replaces an earlier
    /// subscription of the object. No variables: ends the subscription.
    pub fn subscribe(&mut self, domain: Domain, object: &str, variables: &[u8]) {
        self.subscribe_during(domain, object, variables, ALWAYS);
    }

    /// As [`Batch::subscribe`], from one simulation time to another \[s\].
    pub fn subscribe_during(&mut self, domain: Domain, object: &str, variables: &[u8], during: [f64; 2]) {
        let call = subscription("subscribe", domain.subscribe, false, variables);
        self.push(call, 16, |w| {
            w.f64(during[0]).f64(during[1]).str(object);
            write_variables(w, variables);
        });
    }

    /// As [`Batch::subscribe`], for one variable that needs an argument.
    pub fn subscribe_with(&mut self, domain: Domain, object: &str, variable: u8, argument: &Value) {
        let call = subscription("subscribe", domain.subscribe, false, &[variable]);
        self.push(call, 16, |w| {
            w.f64(ALWAYS[0]).f64(ALWAYS[1]).str(object);
            w.u8(1).u8(variable).value(argument);
        });
    }

    /// As [`Batch::subscribe`], for the `around` objects within `range` metres of the object. SUMO 1.15
    /// dies if the object is a vehicle that TraCI removes while the subscription lasts: end it first.
    pub fn subscribe_context(&mut self, domain: Domain, object: &str, around: Domain, range: f64, variables: &[u8]) {
        let call = subscription("subscribeContext", domain.context, true, variables);
        self.push(call, 16, |w| {
            w.f64(ALWAYS[0]).f64(ALWAYS[1]).str(object);
            w.u8(around.get).f64(range);
            write_variables(w, variables);
        });
    }

    pub(super) fn version(&mut self) {
        self.command(Call { answer: Answer::Version, ..Call::new("getVersion", c::CMD_GETVERSION) }, |_| {});
    }

    pub(super) fn close(&mut self) {
        self.command(Call::new("close", c::CMD_CLOSE), |_| {});
    }

    pub(super) fn load(&mut self, arguments: &[impl AsRef<str>]) {
        self.command(Call::new("load", c::CMD_LOAD), |w| {
            w.string_list(arguments);
        });
    }

    pub(super) fn set_order(&mut self, order: i32) {
        self.command(Call::new("setOrder", c::CMD_SETORDER), |w| {
            w.i32(order);
        });
    }

    /// Closes the message, with the step of the simulation to `until` \[s\] as its last command (0: one
    /// step length). May be called again, and commands may follow: the step is replaced then.
    pub(super) fn seal(&mut self, until: Option<f64>) -> Result<&[u8], Error> {
        self.unseal();
        if let Some(until) = until {
            self.stepped = true;
            self.push_raw(Call::new("simulationStep", c::CMD_SIMSTEP), usize::MAX, |w| {
                w.f64(until);
            });
        }
        self.writer.finish()
    }

    fn unseal(&mut self) {
        if self.stepped {
            self.stepped = false;
            self.queued.pop();
            // A step takes ten bytes: length, identifier, time.
            self.writer.truncate(self.writer.len() - 10);
        }
    }

    /// All commands of the sealed message, the step included, and whether there is a step.
    pub(super) fn sealed(&self) -> (&[Queued], bool) {
        (&self.queued, self.stepped)
    }

    /// The object that a command is for.
    fn object(&self, queued: &Queued) -> &str {
        let bytes = self.writer.bytes().get(queued.object.clone()).unwrap_or_default();
        Reader::new(bytes, 0).str().unwrap_or_default()
    }

    /// The error for a command that SUMO refused.
    pub(super) fn refusal(&self, index: usize, message: &str) -> Error {
        let Some(queued) = self.queued.get(index) else {
            return Error::invalid(format!("sumo refused a command that was not sent: {message}"));
        };
        let Call { name, command, variable, .. } = queued.call;
        let call = match variable {
            _ if !name.is_empty() => name.to_owned(),
            Some(variable) => format!("command {command:#04x} for variable {variable:#04x}"),
            None => format!("command {command:#04x}"),
        };
        Error::Refused { command, call, id: self.object(queued).to_owned(), message: message.to_owned() }
    }

    fn push(&mut self, call: Call, before_object: usize, content: impl FnOnce(&mut Writer)) {
        self.unseal();
        self.push_raw(call, before_object, content);
    }

    fn push_raw(&mut self, call: Call, before_object: usize, content: impl FnOnce(&mut Writer)) {
        let range = self.writer.command(call.command, content);
        self.queued.push(Queued { call, object: range.start.saturating_add(before_object)..range.end });
    }
}

/// Begin and end of a subscription without limits.
const ALWAYS: [f64; 2] = [c::INVALID_DOUBLE_VALUE; 2];

fn subscription(name: &'static str, command: u8, context: bool, variables: &[u8]) -> Call {
    let answer = if variables.is_empty() { Answer::Nothing } else { Answer::Subscription { context } };
    Call { name, command, variable: None, answer }
}

fn write_variables(w: &mut Writer, variables: &[u8]) {
    // A domain has fewer than 256 variables.
    w.u8(variables.len() as u8);
    for variable in variables {
        w.u8(*variable);
    }
}

/// What SUMO said to one command of a batch: the value that a `get` asked for, nothing for other
/// commands, or [`Error::Refused`].
pub type Outcome = Result<Option<Value>, Error>;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_step_is_always_the_last_command() {
        let mut batch = Batch::new();
        batch.vehicle().set_speed("a", 1.0);
        let once = batch.seal(Some(0.0)).unwrap().to_vec();
        assert_eq!(batch.seal(Some(0.0)).unwrap(), once);
        batch.vehicle().set_speed("b", 2.0);
        batch.seal(Some(0.0)).unwrap();
        let (queued, stepped) = batch.sealed();
        assert!(stepped);
        assert_eq!(queued.iter().map(|q| q.call.command).collect::<Vec<_>>(), [0xc4, 0xc4, c::CMD_SIMSTEP]);
        assert_eq!(queued.iter().map(|q| batch.object(q)).collect::<Vec<_>>(), ["a", "b", ""]);
        batch.seal(None).unwrap();
        assert_eq!(batch.sealed().0.len(), 2);
        batch.clear();
        assert_eq!(batch.seal(None).unwrap(), [0, 0, 0, 4]);
    }

    #[test]
    fn a_long_command_keeps_the_name_of_its_object() {
        let mut batch = Batch::new();
        batch.route().add("route", &["a_rather_long_edge_name"; 50]);
        batch.subscribe(Domain::VEHICLE, "v", &[c::VAR_SPEED]);
        let names: Vec<_> = batch.sealed().0.iter().map(|q| batch.object(q)).collect();
        assert_eq!(names, ["route", "v"]);
    }

    #[test]
    fn bytes_of_a_set_speed_are_those_of_the_protocol() {
        let mut batch = Batch::new();
        batch.vehicle().set_speed("v0", 3.0);
        let expected = [
            0, 0, 0, 31, // message length
            17, 0xc4, 0x40, 0, 0, 0, 2, b'v', b'0', 0x0b, 0x40, 0x08, 0, 0, 0, 0, 0, 0, // set speed
            10, 0x02, 0, 0, 0, 0, 0, 0, 0, 0, // step
        ];
        let mut expected = expected.to_vec();
        expected[3] = expected.len() as u8;
        expected[4] = (expected.len() - 14) as u8;
        assert_eq!(batch.seal(Some(0.0)).unwrap(), expected);
    }
}
