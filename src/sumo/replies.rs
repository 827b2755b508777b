//! The reply to a [`Batch`] as owned values: a result for each [`Ticket`], and what the
//! subscriptions report.

use std::{cell::OnceCell, cmp::Ordering, ops::Deref, sync::Arc, vec};

use super::{
    Error,
    batch::{Batch, CallResult},
    codec::{Reader, Value},
    constants::Domain,
    domain::{FromValue, Reported, Ticket, simulation::VAR_TIME},
    reply::{Report, Sink, read_value},
};

/// The results of the commands of a batch, in order.
#[derive(Debug, Default)]
#[must_use = "a refusal shows in `check`, or when its ticket is taken"]
pub struct Replies {
    batch: u64,
    outcomes: Vec<CallResult>,
    /// SUMO's name of each command.
    names: Vec<&'static str>,
    /// The first values of the subscriptions that the batch makes, at the position of the
    /// subscribing command in the batch.
    pub first: Reports,
}

impl Replies {
    /// Returns the result for a ticket.
    ///
    /// # Errors
    /// [`Error::Refused`] if SUMO refused the command; [`Error::Invalid`] for a command that was
    /// not sent and for a ticket of another batch; [`Error::Type`] if the value has an unexpected
    /// type.
    pub fn take<T>(&mut self, ticket: Ticket<T>) -> Result<T, Error> {
        let Ticket { batch, commands, decode } = ticket;
        let last = commands
            .end
            .checked_sub(1)
            .filter(|last| batch == self.batch && *last < self.outcomes.len());
        let Some(last) = last else {
            return Err(Error::invalid(
                "the ticket is for another batch than that of these replies",
            ));
        };
        let mut answer = None;
        for outcome in &mut self.outcomes[commands] {
            answer = std::mem::replace(outcome, Ok(None))?;
        }
        decode(answer).map_err(|error| error.in_answer_to(self.names[last]))
    }

    /// Checks that all commands succeeded, except those whose tickets have been taken.
    ///
    /// # Errors
    /// The first failure: [`Error::Refused`], or [`Error::Invalid`] for a command that was not
    /// sent.
    pub fn check(&self) -> Result<(), Error> {
        match self.outcomes.iter().find_map(|outcome| outcome.as_ref().err()) {
            None => Ok(()),
            Some(Error::Refused { command, call, id, message }) => {
                let (call, id, message) = (call.clone(), id.clone(), message.clone());
                Err(Error::Refused { command: *command, call, id, message })
            }
            Some(not_sent) => Err(Error::invalid(not_sent.to_string())),
        }
    }

    pub(super) fn pop(&mut self) -> Option<CallResult> {
        self.names.pop();
        self.outcomes.pop()
    }
}

impl Deref for Replies {
    type Target = [CallResult];

    fn deref(&self) -> &[CallResult] {
        &self.outcomes
    }
}

impl IntoIterator for Replies {
    type Item = CallResult;
    type IntoIter = vec::IntoIter<CallResult>;

    fn into_iter(self) -> Self::IntoIter {
        self.outcomes.into_iter()
    }
}

/// The value of one variable that a subscription reports.
#[derive(Debug, Clone, PartialEq)]
pub struct Observed {
    /// As [`Report::response`].
    pub response: u8,
    /// As [`Report::around`].
    pub around: Option<Arc<str>>,
    /// As [`Report::object`].
    pub object: Arc<str>,
    /// As [`Report::domain`].
    pub domain: u8,
    /// As [`Report::variable`].
    pub variable: u8,
    /// The value, or SUMO's message if there is no value.
    pub value: Result<Value, String>,
}

impl Observed {
    fn subscription(&self) -> String {
        format!("the subscription to variable {:#04x}", self.variable)
    }

    /// Returns the key that identifies the value among those of a reply.
    fn key(&self) -> Key<'_> {
        (self.response, self.around.as_deref(), self.domain, &self.object, self.variable)
    }
}

/// Response, centre object, domain, object, variable.
type Key<'a> = (u8, Option<&'a str>, u8, &'a str, u8);

/// The reply to a batch with a step. It dereferences to the [`Reports`] at the time after the step.
#[derive(Debug, Default)]
#[must_use = "a refusal shows in `check`, or when its ticket is taken"]
pub struct StepReply {
    /// The results of the commands of the batch.
    pub outcomes: Replies,
    /// Reports of the subscriptions after the step.
    pub reports: Reports,
}

impl StepReply {
    /// Returns the result for a ticket, as [`Replies::take`] does.
    ///
    /// # Errors
    /// As [`Replies::take`].
    pub fn take<T>(&mut self, ticket: Ticket<T>) -> Result<T, Error> {
        self.outcomes.take(ticket)
    }

    /// Checks that all commands succeeded, as [`Replies::check`] does.
    ///
    /// # Errors
    /// As [`Replies::check`].
    pub fn check(&self) -> Result<(), Error> {
        self.outcomes.check()
    }
}

impl Deref for StepReply {
    type Target = Reports;

    fn deref(&self) -> &Reports {
        &self.reports
    }
}

/// The values that subscriptions report.
#[derive(Debug, Default)]
pub struct Reports {
    /// All values in SUMO's order.
    pub subscriptions: Vec<Observed>,
    /// Indices into `subscriptions`, sorted by key; computed on first use.
    order: OnceCell<Vec<u32>>,
}

impl Reports {
    /// Returns a subscribed variable of an object; `None` if there is no such subscription or the
    /// object is gone. If several subscriptions report the variable, the last value is returned.
    ///
    /// # Errors
    /// [`Error::Refused`] with SUMO's message if SUMO has no value; [`Error::Type`] if the value
    /// has an unexpected type.
    pub fn get<V: Reported>(&self, object: &str, variable: V) -> Option<Result<V::Value, Error>> {
        let id = variable.identify();
        let domain = id.domain();
        self.find((domain.subscribe + 0x10, None, domain.get, object, id.number()))
    }

    /// Returns the report of the context subscription of `centre`, an object of the domain `of`.
    pub fn around<'a>(&'a self, of: Domain, centre: &'a str) -> Context<'a> {
        Context { reports: self, response: of.context + 0x10, centre }
    }

    fn find<T: FromValue>(&self, key: Key<'_>) -> Option<Result<T, Error>> {
        let order = self.order();
        let end = order.partition_point(|i| self.at(*i).key() <= key);
        let observed =
            order[..end].last().map(|i| self.at(*i)).filter(|observed| observed.key() == key)?;
        Some(match &observed.value {
            Ok(value) => T::from_value(value.clone())
                .map_err(|error| error.in_answer_to(&observed.subscription())),
            Err(message) => Err(Error::Refused {
                command: observed.response.wrapping_sub(0x10),
                call: observed.subscription(),
                id: observed.object.to_string(),
                message: message.clone(),
            }),
        })
    }

    fn order(&self) -> &[u32] {
        self.order.get_or_init(|| {
            let mut order: Vec<u32> = (0..self.subscriptions.len() as u32).collect();
            order.sort_by(|a, b| self.at(*a).key().cmp(&self.at(*b).key()));
            order
        })
    }

    fn at(&self, index: u32) -> &Observed {
        &self.subscriptions[index as usize]
    }
}

/// The objects around a centre object, see [`Reports::around`].
#[derive(Debug, Clone, Copy)]
pub struct Context<'a> {
    reports: &'a Reports,
    response: u8,
    centre: &'a str,
}

impl<'a> Context<'a> {
    /// Returns the identifiers of the objects, sorted within each domain; those of one domain are
    /// adjacent.
    pub fn objects(&self) -> impl Iterator<Item = &'a str> + use<'a> {
        let Context { reports, response, centre } = *self;
        let order = reports.order();
        let head =
            move |o: &Observed| (o.response, o.around.as_deref()).cmp(&(response, Some(centre)));
        let start = order.partition_point(|i| head(reports.at(*i)) == Ordering::Less);
        let mut last: Option<(u8, &str)> = None;
        order[start..]
            .iter()
            .map(|i| reports.at(*i))
            .take_while(move |o| head(o) == Ordering::Equal)
            .filter_map(move |observed| {
                let object = (observed.domain, &*observed.object);
                (last.replace(object) != Some(object)).then_some(object.1)
            })
    }

    /// Returns a variable of one of the objects, as [`Reports::get`] does.
    ///
    /// # Errors
    /// As [`Reports::get`].
    pub fn get<V: Reported>(&self, object: &str, variable: V) -> Option<Result<V::Value, Error>> {
        let id = variable.identify();
        self.reports.find((self.response, Some(self.centre), id.domain().get, object, id.number()))
    }
}

/// A sink that collects a reply into owned values.
pub(super) struct Collector<'a> {
    batch: &'a Batch,
    pub(super) reply: StepReply,
    /// Last simulation time in the reply \[s\].
    pub(super) time_s: Option<f64>,
    around: Shared,
    object: Shared,
}

/// Most recent name in a reply. The reply contains a name once for several values, which share one
/// copy here.
#[derive(Default)]
struct Shared {
    /// Address and length of the name in the reply.
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

impl<'a> Collector<'a> {
    pub(super) fn new(batch: &'a Batch) -> Self {
        let (queued, _) = batch.sealed();
        let outcomes = Replies {
            batch: batch.number(),
            outcomes: queued.iter().map(|_| Ok(None)).collect(),
            names: queued.iter().map(|queued| queued.call.name).collect(),
            first: Reports::default(),
        };
        let reply = StepReply { outcomes, ..StepReply::default() };
        Collector {
            batch,
            reply,
            time_s: None,
            around: Shared::default(),
            object: Shared::default(),
        }
    }

    fn note_time(&mut self, domain: u8, variable: u8, value: &Value) {
        if let (true, Value::Double(time)) =
            (domain == Domain::SIMULATION.get && variable == VAR_TIME.number(), value)
        {
            self.time_s = Some(*time);
        }
    }
}

impl Sink for Collector<'_> {
    fn refused(&mut self, index: usize, message: &str) {
        if let Some(outcome) = self.reply.outcomes.outcomes.get_mut(index) {
            *outcome = Err(self.batch.refusal(index, message));
        }
    }

    fn answer(
        &mut self,
        index: usize,
        response: u8,
        variable: u8,
        value: &mut Reader<'_>,
    ) -> Result<(), Error> {
        let value = read_value(response, variable, value)?;
        self.note_time(response.wrapping_sub(0x10), variable, &value);
        if let Some(outcome) = self.reply.outcomes.outcomes.get_mut(index) {
            *outcome = Ok(Some(value));
        }
        Ok(())
    }

    fn report(&mut self, report: Report<'_>, value: &mut Reader<'_>) -> Result<(), Error> {
        let value =
            if report.known { Ok(report.read(value)?) } else { Err(value.string()?.to_owned()) };
        if let Ok(value) = &value {
            self.note_time(report.domain, report.variable, value);
        }
        let observed = Observed {
            response: report.response,
            around: report.around.map(|name| self.around.copy(name)),
            object: self.object.copy(report.object),
            domain: report.domain,
            variable: report.variable,
            value,
        };
        let StepReply { outcomes, reports } = &mut self.reply;
        let reports = if report.after_step { reports } else { &mut outcomes.first };
        reports.subscriptions.push(observed);
        Ok(())
    }
}
