//! The calls of the domains on a [`Client`]: each in an exchange of its own, or several in one.

use super::Client;
use crate::sumo::{
    Error,
    batch::{Batch, Call},
    constants::Domain,
    domain::{Decode, Scope},
    replies::{Replies, StepReply},
};

impl Scope for Client {
    type Output<T> = Result<T, Error>;

    fn request<T>(&mut self, fill: impl FnOnce(&mut Batch), decode: Decode<T>) -> Result<T, Error> {
        self.request_of(None, fill, decode)
    }

    fn request_for<T>(
        &mut self,
        domain: Domain,
        object: &str,
        fill: impl FnOnce(&mut Batch),
        decode: Decode<T>,
    ) -> Result<T, Error> {
        self.request_of(Some((domain, object)), fill, decode)
    }
}

impl Client {
    /// Sends one call. If `object` is given, first checks that SUMO knows it, because SUMO 1.15
    /// terminates on such a call for an unknown object.
    fn request_of<T>(
        &mut self,
        object: Option<(Domain, &str)>,
        fill: impl FnOnce(&mut Batch),
        decode: Decode<T>,
    ) -> Result<T, Error> {
        let mut batch = std::mem::take(&mut self.single);
        batch.clear();
        let ticket = batch.request(fill, decode);
        let known = match object {
            Some((domain, object)) if !batch.is_silent() => self.ask_for(domain, object),
            _ => Ok(()),
        };
        let replies = known.and_then(|()| self.run(&mut batch));
        self.single = batch;
        replies?.take(ticket)
    }

    /// Returns an error if SUMO does not know an object.
    fn ask_for(&mut self, domain: Domain, object: &str) -> Result<(), Error> {
        // Every domain has the variable 0x7e, `getParameter`.
        let parameter = Call::get("subscribeContext", domain, 0x7e);
        let ask = |batch: &mut Batch| {
            batch.call(parameter, object, |w| {
                w.string("");
            });
        };
        self.call(ask).map(drop)
    }
}

/// Calls that are sent together in one exchange, see [`Client::batch`].
#[derive(Debug)]
#[must_use = "the calls go out with `send` or `step` only"]
pub struct ClientBatch<'a> {
    pub(super) client: &'a mut Client,
    pub(in crate::sumo) batch: Batch,
}

impl ClientBatch<'_> {
    /// Sends the calls as [`Client::run`] does. The batch is empty afterwards and may be filled
    /// again.
    ///
    /// # Errors
    /// As [`Client::run`].
    pub fn send(&mut self) -> Result<Replies, Error> {
        self.client.run(&mut self.batch)
    }

    /// Sends the calls and a step as [`Client::step`] does. The batch is empty afterwards and may
    /// be filled again.
    ///
    /// # Errors
    /// As [`Client::step`].
    pub fn step(&mut self, until: f64) -> Result<StepReply, Error> {
        self.client.step(&mut self.batch, until)
    }
}
