//! Batches: any number of TraCI commands in one message. A [`Batch`] keeps its buffers, so that
//! refilling it does not allocate. The simulation step is not a command of the batch. The client
//! appends the step as the last command, because SUMO carries out the commands that follow a step
//! in a message before that step.

use std::{
    ops::Range,
    sync::atomic::{AtomicU64, Ordering},
};

use super::{
    Error,
    codec::{Reader, Value, Writer},
    constants::{self as c, Domain},
    value::Argument as _,
    variable::{SubscriptionArgument, VariableId, VariableWith},
};

/// The part of a reply that follows the status of a command that SUMO carried out.
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
    /// Byte range of the message that begins with the object's identifier (an untyped string).
    object: Range<usize>,
    /// Why the command is left out of the message; `None` for a command that is sent.
    pub(super) invalid: Option<String>,
}

/// A command without its object and its content.
#[derive(Debug, Clone, Copy)]
pub(super) struct Call {
    /// SUMO's name, such as `vehicle.getSpeed`; empty for a command that the caller gave by number.
    pub(super) name: &'static str,
    pub(super) command: u8,
    /// Number of the variable that the command reads or changes.
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

    /// Whether the other call is the same command for the same variable.
    pub(super) fn is(self, other: Call) -> bool {
        (self.command, self.variable) == (other.command, other.variable)
    }
}

/// The commands of one message, in the order in which SUMO carries them out. The methods of the
/// domains, such as [`Batch::vehicle`], add commands and return a [`Ticket`](super::Ticket) each.
/// The reply to the batch gives the result for a ticket, and
/// [`Replies::check`](super::Replies::check) tells whether all other commands succeeded.
/// [`Client::run`](super::Client::run) and [`Client::step`](super::Client::step) send a batch.
#[derive(Debug)]
pub struct Batch {
    /// Number that no other batch has. [`Batch::clear`] assigns a new one.
    number: u64,
    writer: Writer,
    queued: Vec<Queued>,
    stepped: bool,
}

impl Default for Batch {
    fn default() -> Self {
        Batch {
            number: new_number(),
            writer: Writer::default(),
            queued: Vec::new(),
            stepped: false,
        }
    }
}

fn new_number() -> u64 {
    static NEXT: AtomicU64 = AtomicU64::new(0);
    NEXT.fetch_add(1, Ordering::Relaxed)
}

impl Batch {
    /// Returns an empty batch.
    pub fn new() -> Self {
        Self::default()
    }

    /// Returns the number of commands.
    pub fn len(&self) -> usize {
        self.queued.len()
    }

    /// Whether the batch holds no command.
    pub fn is_empty(&self) -> bool {
        self.queued.is_empty()
    }

    pub(super) fn number(&self) -> u64 {
        self.number
    }

    /// Removes all commands. The buffers are kept, and the tickets become invalid.
    pub fn clear(&mut self) {
        self.number = new_number();
        self.writer.truncate(0);
        self.queued.clear();
        self.stepped = false;
    }

    /// Adds a command that changes a variable of an object; `value` writes the typed value.
    pub fn set(
        &mut self,
        domain: Domain,
        variable: u8,
        object: &str,
        value: impl FnOnce(&mut Writer),
    ) {
        self.call(Call::set("", domain, variable), object, value);
    }

    /// Adds a command that reads a variable of an object. The value is that at the command's
    /// position in the batch, so before the step. SUMO crashes if the variable needs an argument:
    /// [`Batch::get_with`] sends it.
    pub fn get(&mut self, domain: Domain, variable: u8, object: &str) {
        self.get_with(domain, variable, object, |_| {});
    }

    /// Adds a command that reads a variable of an object for an argument, such as the name of a
    /// parameter; `argument` writes the typed argument.
    pub fn get_with(
        &mut self,
        domain: Domain,
        variable: u8,
        object: &str,
        argument: impl FnOnce(&mut Writer),
    ) {
        self.call(Call::get("", domain, variable), object, argument);
    }

    /// Adds a command that reads or changes a variable of an object.
    pub(super) fn call(&mut self, call: Call, object: &str, content: impl FnOnce(&mut Writer)) {
        self.push(call, usize::from(call.variable.is_some()), |w| {
            if let Some(variable) = call.variable {
                w.u8(variable);
            }
            w.str(object);
            content(w);
        });
    }

    /// Adds a command that addresses no object.
    pub(super) fn command(&mut self, call: Call, content: impl FnOnce(&mut Writer)) {
        // This offset lies beyond any message, so that `object` finds no identifier.
        self.push(call, usize::MAX, content);
    }

    /// Subscribes to variables of an object: SUMO reports them now and after each following step,
    /// in addition to those of earlier subscriptions. An empty list ends all variable subscriptions
    /// of the object. A list with a variable of another domain or with more than 255 variables is
    /// not sent, and the reply holds [`Error::Invalid`] for the command.
    pub fn subscribe(&mut self, domain: Domain, object: &str, variables: &[VariableId]) {
        self.subscribe_during(domain, object, variables, ALWAYS);
    }

    /// Subscribes as [`Batch::subscribe`] does, but for the simulation times from `during[0]` to
    /// `during[1]` \[s\] only.
    pub fn subscribe_during(
        &mut self,
        domain: Domain,
        object: &str,
        variables: &[VariableId],
        during: [f64; 2],
    ) {
        let call = subscription("subscribe", domain.subscribe, false, variables.is_empty());
        if let Err(what) = check_variables(domain, variables) {
            return self.reject(call, what);
        }
        self.push(call, 16, |w| {
            w.f64(during[0]).f64(during[1]).str(object);
            write_variables(w, variables);
        });
    }

    /// Subscribes as [`Batch::subscribe`] does, but to one variable that needs an argument.
    pub fn subscribe_with<A: SubscriptionArgument, T>(
        &mut self,
        domain: Domain,
        object: &str,
        variable: VariableWith<A, T>,
        argument: A::Given<'_>,
    ) {
        let call = subscription("subscribe", domain.subscribe, false, false);
        if variable.domain() != domain {
            return self.reject(call, OTHER_DOMAIN.to_owned());
        }
        self.push(call, 16, |w| {
            w.f64(ALWAYS[0]).f64(ALWAYS[1]).str(object);
            w.u8(1).u8(variable.number());
            argument.write(w);
        });
    }

    /// Subscribes as [`Batch::subscribe`] does, but to variables of the objects of the domain
    /// `around` within `range` metres of the object. For a domain whose objects SUMO cannot search
    /// by position the command is not sent either.
    ///
    /// SUMO 1.15 terminates if it does not know the object, which this method does not check. It
    /// also terminates if a command removes the object while the subscription lasts; end the
    /// subscription first.
    pub fn subscribe_context(
        &mut self,
        domain: Domain,
        object: &str,
        around: Domain,
        range: f64,
        variables: &[VariableId],
    ) {
        let call = subscription("subscribeContext", domain.context, true, variables.is_empty());
        if !around.has_places() {
            return self.reject(
                call,
                "sumo cannot look for objects of this domain around others".to_owned(),
            );
        }
        if let Err(what) = check_variables(around, variables) {
            return self.reject(call, what);
        }
        self.push(call, 16, |w| {
            w.f64(ALWAYS[0]).f64(ALWAYS[1]).str(object);
            w.u8(around.get).f64(range);
            write_variables(w, variables);
        });
    }

    /// Adds a command that is not sent and whose result is [`Error::Invalid`].
    fn reject(&mut self, call: Call, what: String) {
        self.unseal();
        let end = self.writer.len();
        self.queued.push(Queued { call, object: end..end, invalid: Some(what) });
    }

    pub(super) fn version(&mut self) {
        self.command(
            Call { answer: Answer::Version, ..Call::new("getVersion", c::CMD_GETVERSION) },
            |_| {},
        );
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

    /// Completes the message, with a step of the simulation to `until` \[s\] as its last command
    /// (0: one step length; `None`: no step). A batch can be sealed again, also after more commands
    /// were added; the new step then replaces the old one.
    pub(super) fn seal(&mut self, until: Option<f64>) -> Result<&[u8], Error> {
        if let Some(until) = until.filter(|until| !(until.is_finite() && *until >= 0.0)) {
            return Err(Error::invalid(format!(
                "the simulation cannot step to {until} s: a time is 0 or more"
            )));
        }
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
            // A step takes ten bytes: length (1), identifier (1), time (8).
            self.writer.truncate(self.writer.len() - 10);
        }
    }

    /// Whether the message of the sealed batch holds no command.
    pub(super) fn is_silent(&self) -> bool {
        self.writer.is_empty()
    }

    /// Returns all commands of the sealed message, including the step, and whether there is a step.
    pub(super) fn sealed(&self) -> (&[Queued], bool) {
        (&self.queued, self.stepped)
    }

    /// Returns the identifier of the object that a command addresses.
    fn object(&self, queued: &Queued) -> &str {
        let bytes = self.writer.bytes().get(queued.object.clone()).unwrap_or_default();
        Reader::new(bytes, 0).str().unwrap_or_default()
    }

    /// Returns the name, the object and the arguments of each call, for a backend that makes the
    /// calls without this format.
    #[cfg(feature = "libsumo")]
    pub(super) fn calls(&self) -> impl Iterator<Item = (&'static str, &str, Reader<'_>)> {
        self.queued.iter().map(|queued| {
            let bytes = self.writer.bytes().get(queued.object.clone()).unwrap_or_default();
            let mut content = Reader::new(bytes, queued.object.start);
            (queued.call.name, content.str().unwrap_or_default(), content)
        })
    }

    /// Returns the error for a command that SUMO refused or that was not sent.
    pub(super) fn refusal(&self, index: usize, message: &str) -> Error {
        let Some(queued) = self.queued.get(index).filter(|queued| queued.invalid.is_none()) else {
            return Error::invalid(message);
        };
        let Call { name, command, variable, .. } = queued.call;
        let call = match variable {
            _ if !name.is_empty() => name.to_owned(),
            Some(variable) => format!("command {command:#04x} for variable {variable:#04x}"),
            None => format!("command {command:#04x}"),
        };
        Error::Refused {
            command,
            call,
            id: self.object(queued).to_owned(),
            message: message.to_owned(),
        }
    }

    fn push(&mut self, call: Call, before_object: usize, content: impl FnOnce(&mut Writer)) {
        self.unseal();
        self.push_raw(call, before_object, content);
    }

    fn push_raw(&mut self, call: Call, before_object: usize, content: impl FnOnce(&mut Writer)) {
        let range = self.writer.command(call.command, content);
        self.queued.push(Queued {
            call,
            object: range.start.saturating_add(before_object)..range.end,
            invalid: None,
        });
    }
}

/// Begin and end time of a subscription that is not limited in time.
const ALWAYS: [f64; 2] = [c::INVALID_DOUBLE_VALUE; 2];

fn subscription(name: &'static str, command: u8, context: bool, ends: bool) -> Call {
    let answer = if ends { Answer::Nothing } else { Answer::Subscription { context } };
    Call { name, command, variable: None, answer }
}

const OTHER_DOMAIN: &str =
    "a variable of another domain than that of the objects that are subscribed to";

fn check_variables(domain: Domain, variables: &[VariableId]) -> Result<(), String> {
    if variables.iter().any(|variable| variable.domain() != domain) {
        return Err(OTHER_DOMAIN.to_owned());
    }
    match variables.len() {
        0..=255 => Ok(()),
        many => Err(format!("a subscription is to at most 255 variables, not {many}")),
    }
}

/// Writes variables that `check_variables` has accepted.
fn write_variables(w: &mut Writer, variables: &[VariableId]) {
    w.u8(variables.len() as u8);
    for variable in variables {
        w.u8(variable.number());
    }
}

/// The result of one command of a batch: the value for a `get` command, `None` for any other
/// command, [`Error::Refused`] if SUMO refused the command, or [`Error::Invalid`] if it was not
/// sent.
pub type CallResult = Result<Option<Value>, Error>;

#[cfg(test)]
mod tests;
