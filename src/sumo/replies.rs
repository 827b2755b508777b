//! What comes back from a [`Batch`], as owned values: a result for each
//! [`Ticket`], and what the subscriptions report after a step.

use std::{cell::OnceCell, cmp::Ordering, ops::Deref, sync::Arc, vec};

use super::{
    Error,
    batch::{Batch, Outcome},
    codec::{Reader, Value},
    constants::Domain,
    domain::{FromValue, Ticket, Variable},
    reply::{Report, Sink, read_value},
};

/// What SUMO said to each command of a batch, in order.
#[derive(Debug, Default)]
pub struct Replies {
    batch: u64,
    outcomes: Vec<Outcome>,
    /// For each command, SUMO's name for it and where in the message its value stood.
    places: Vec<(&'static str, usize)>,
}

impl Replies {
    /// The result that a ticket stands for.
    ///
    /// # Errors
    /// [`Error::Refused`] if SUMO refused the command; [`Error::Invalid`] for a ticket of another batch;
    /// [`Error::Protocol`] if the value is not of the type that it should be of.
    pub fn take<T>(&mut self, ticket: Ticket<T>) -> Result<T, Error> {
        let Ticket { batch, commands, decode } = ticket;
        let last = commands.end.checked_sub(1).filter(|last| batch == self.batch && *last < self.outcomes.len());
        let Some(last) = last else {
            return Err(Error::invalid("the ticket is for another batch than that of these replies"));
        };
        let mut answer = None;
        for outcome in &mut self.outcomes[commands] {
            answer = std::mem::replace(outcome, Ok(None))?;
        }
        let (name, at_byte) = self.places[last];
        decode(answer).map_err(|error| error.at(at_byte).in_answer_to(name))
    }

    pub(super) fn pop(&mut self) -> Option<Outcome> {
        self.places.pop();
        self.outcomes.pop()
    }
}

impl Deref for Replies {
    type Target = [Outcome];

    fn deref(&self) -> &[Outcome] {
        &self.outcomes
    }
}

impl IntoIterator for Replies {
    type Item = Outcome;
    type IntoIter = vec::IntoIter<Outcome>;

    fn into_iter(self) -> Self::IntoIter {
        self.outcomes.into_iter()
    }
}

/// One variable that a subscription reports after a step.
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
    /// The value, or SUMO's message why there is none.
    pub value: Result<Value, String>,
    /// Where in the message the value stood \[bytes\].
    pub at_byte: usize,
}

impl Observed {
    fn subscription(&self) -> String {
        format!("the subscription to variable {:#04x}", self.variable)
    }

    /// What tells it from all others.
    fn key(&self) -> Key<'_> {
        (self.response, self.around.as_deref(), self.domain, &self.object, self.variable)
    }
}

/// Response, object at the centre, domain, object, variable.
type Key<'a> = (u8, Option<&'a str>, u8, &'a str, u8);

/// What came back from a step.
#[derive(Debug, Default)]
pub struct StepReply {
    /// For each command of the batch, what SUMO said.
    pub outcomes: Replies,
    /// What the subscriptions report after the step, as SUMO orders it.
    pub subscriptions: Vec<Observed>,
    /// Indices of `subscriptions` by key; made when they are first asked for.
    order: OnceCell<Vec<u32>>,
}

impl StepReply {
    /// As [`Replies::take`].
    ///
    /// # Errors
    /// As [`Replies::take`].
    pub fn take<T>(&mut self, ticket: Ticket<T>) -> Result<T, Error> {
        self.outcomes.take(ticket)
    }

    /// A subscribed variable of an object; `None` if it is not subscribed to or the object is gone.
    ///
    /// # Errors
    /// [`Error::Refused`] with SUMO's message if SUMO has no value; [`Error::Protocol`] if the value is
    /// not of the type that it should be of.
    pub fn get<T: FromValue>(&self, object: &str, variable: Variable<T>) -> Option<Result<T, Error>> {
        let domain = variable.domain();
        self.find((domain.subscribe + 0x10, None, domain.get, object, variable.id()))
    }

    /// What the context subscription of an object reports: the objects around `centre`, which is an object
    /// of the domain `of`.
    pub fn around<'a>(&'a self, of: Domain, centre: &'a str) -> Context<'a> {
        Context { reply: self, response: of.context + 0x10, centre }
    }

    fn find<T: FromValue>(&self, key: Key<'_>) -> Option<Result<T, Error>> {
        let order = self.order();
        let at = order.binary_search_by(|i| self.at(*i).key().cmp(&key)).ok()?;
        let observed = self.at(order[at]);
        Some(match &observed.value {
            Ok(value) => T::from_value(value.clone())
                .map_err(|error| error.at(observed.at_byte).in_answer_to(&observed.subscription())),
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

/// The objects around one object, see [`StepReply::around`].
#[derive(Debug, Clone, Copy)]
pub struct Context<'a> {
    reply: &'a StepReply,
    response: u8,
    centre: &'a str,
}

impl<'a> Context<'a> {
    /// Identifiers of the objects, without order; those of one domain next to each other, sorted.
    pub fn objects(&self) -> impl Iterator<Item = &'a str> + use<'a> {
        let Context { reply, response, centre } = *self;
        let order = reply.order();
        let head = move |o: &Observed| (o.response, o.around.as_deref()).cmp(&(response, Some(centre)));
        let start = order.partition_point(|i| head(reply.at(*i)) == Ordering::Less);
        let mut last: Option<(u8, &str)> = None;
        order[start..].iter().map(|i| reply.at(*i)).take_while(move |o| head(o) == Ordering::Equal).filter_map(
            move |observed| {
                let object = (observed.domain, &*observed.object);
                (last.replace(object) != Some(object)).then_some(object.1)
            },
        )
    }

    /// A variable of one of the objects, as [`StepReply::get`].
    ///
    /// # Errors
    /// As [`StepReply::get`].
    pub fn get<T: FromValue>(&self, object: &str, variable: Variable<T>) -> Option<Result<T, Error>> {
        self.reply.find((self.response, Some(self.centre), variable.domain().get, object, variable.id()))
    }
}

/// Collects a reply.
pub(super) struct Collector<'a> {
    batch: &'a Batch,
    pub(super) reply: StepReply,
    around: Shared,
    object: Shared,
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

impl<'a> Collector<'a> {
    pub(super) fn new(batch: &'a Batch) -> Self {
        let (queued, _) = batch.sealed();
        let outcomes = Replies {
            batch: batch.number(),
            outcomes: queued.iter().map(|_| Ok(None)).collect(),
            places: queued.iter().map(|queued| (queued.call.name, 0)).collect(),
        };
        let reply = StepReply { outcomes, ..StepReply::default() };
        Collector { batch, reply, around: Shared::default(), object: Shared::default() }
    }
}

impl Sink for Collector<'_> {
    fn refused(&mut self, index: usize, message: &str) {
        if let Some(outcome) = self.reply.outcomes.outcomes.get_mut(index) {
            *outcome = Err(self.batch.refusal(index, message));
        }
    }

    fn answer(&mut self, index: usize, response: u8, variable: u8, value: &mut Reader<'_>) -> Result<(), Error> {
        let at_byte = value.position();
        let value = read_value(response, variable, value)?;
        let Replies { outcomes, places, .. } = &mut self.reply.outcomes;
        if let (Some(outcome), Some(place)) = (outcomes.get_mut(index), places.get_mut(index)) {
            *outcome = Ok(Some(value));
            place.1 = at_byte;
        }
        Ok(())
    }

    fn report(&mut self, report: Report<'_>, value: &mut Reader<'_>) -> Result<(), Error> {
        let at_byte = value.position();
        let value = if report.known { Ok(report.read(value)?) } else { Err(value.string()?.to_owned()) };
        if report.after_step {
            self.reply.subscriptions.push(Observed {
                response: report.response,
                around: report.around.map(|name| self.around.copy(name)),
                object: self.object.copy(report.object),
                domain: report.domain,
                variable: report.variable,
                value,
                at_byte,
            });
        }
        Ok(())
    }
}
