//! Parses a reply in place. SUMO answers the commands of a message one by one in order, and after a
//! step reports the values of the subscriptions. The parser passes each part to a [`Sink`] while it
//! reads.

use super::{
    Error,
    batch::{Answer, Batch},
    codec::{Reader, Value},
    constants::{self as c, Domain},
    domain::simulation::VAR_COLLISIONS,
};

/// A value that a subscription reports, without the value itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Report<'a> {
    /// Identifier of the answer: that of the subscription command plus 0x10.
    pub response: u8,
    /// The centre object of a context subscription; `None` for a variable subscription.
    pub around: Option<&'a str>,
    /// The object that the value belongs to.
    pub object: &'a str,
    /// Identifier of the command that reads variables of the object's domain, [`Domain::get`].
    pub domain: u8,
    /// Number of the variable.
    pub variable: u8,
    /// Whether there is a value. If `false`, SUMO's message follows instead (the object is gone).
    pub known: bool,
    /// Whether the value is that after the step of the message; otherwise it is the first answer to
    /// the subscription, from before the step.
    pub after_step: bool,
}

/// Receives the parts of a reply while it is read. A method that gets a `value` must read exactly
/// one typed value from it. The default implementations ignore everything.
pub trait Sink {
    /// Receives a refusal of the command with this index in the batch, or the reason why it was not
    /// sent.
    fn refused(&mut self, index: usize, message: &str) {
        let _ = (index, message);
    }

    /// Receives the value that the `get` command with this index reads; `response` is as in
    /// [`Report`].
    ///
    /// # Errors
    /// [`Error::Protocol`] if the bytes are no valid value.
    fn answer(
        &mut self,
        index: usize,
        response: u8,
        variable: u8,
        value: &mut Reader<'_>,
    ) -> Result<(), Error> {
        let _ = index;
        read_value(response, variable, value).map(drop)
    }

    /// Receives a variable that a subscription reports.
    ///
    /// # Errors
    /// [`Error::Protocol`] if the bytes are no valid value.
    fn report(&mut self, report: Report<'_>, value: &mut Reader<'_>) -> Result<(), Error> {
        report.read(value).map(drop)
    }

    /// Receives the end of the report of an object, after its last variable, which is `report`;
    /// `at` reads what follows.
    ///
    /// # Errors
    /// [`Error::Protocol`] if the report is incomplete.
    fn object_ends(&mut self, report: Report<'_>, at: &Reader<'_>) -> Result<(), Error> {
        let _ = (report, at);
        Ok(())
    }
}

impl Report<'_> {
    /// Reads the value at the reader's position.
    ///
    /// # Errors
    /// [`Error::Protocol`] if the bytes are no valid value.
    pub fn read(&self, value: &mut Reader<'_>) -> Result<Value, Error> {
        read_value(self.domain.wrapping_add(0x10), self.variable, value)
    }
}

/// Parses the reply to a sealed batch and passes its parts to `sink`.
pub(super) fn parse_reply(
    message: &[u8],
    batch: &Batch,
    sink: &mut impl Sink,
) -> Result<(), Error> {
    let mut reader = Reader::new(message, 0);
    reader.i32()?;
    let (queued, stepped) = batch.sealed();
    let mut carried_out = true;
    for (index, queued) in queued.iter().enumerate() {
        let call = queued.call;
        if let Some(what) = &queued.invalid {
            sink.refused(index, what);
            continue;
        }
        let (id, mut status) = reader.command()?;
        let result = status.u8()?;
        carried_out = result == c::RTYPE_OK;
        // SUMO 1.15 reports the refusal of a filter with the filter's number as the command
        // identifier.
        let filter = call.command == c::CMD_ADD_SUBSCRIPTION_FILTER && !carried_out;
        if id != call.command && !filter {
            return Err(Error::Protocol {
                expected: "the status of the next command",
                found: format!("that of command {id:#04x}"),
                at_byte: status.position(),
            });
        }
        let text = status.str()?;
        status.end("the end of a status")?;
        if !carried_out {
            sink.refused(index, text);
            // SUMO 1.15 sends an answer also for a refused subscription, with the reason in place
            // of the values. No command has the identifier of such an answer.
            let mut ahead = reader.clone();
            let subscription = matches!(call.answer, Answer::Subscription { .. });
            if subscription
                && ahead.command().is_ok_and(|(id, _)| id == call.command.wrapping_add(0x10))
            {
                reader = ahead;
            }
            continue;
        }
        if call.answer == Answer::Nothing {
            continue;
        }
        let (id, mut answer) = reader.command()?;
        let expected = if call.answer == Answer::Version {
            c::CMD_GETVERSION
        } else {
            call.command.wrapping_add(0x10)
        };
        if id != expected {
            return Err(answer.unexpected("the answer to the command", format!("answer {id:#04x}")));
        }
        let read = match call.answer {
            Answer::Nothing => Ok(()),
            Answer::Version => sink.answer(index, id, 0, &mut answer),
            Answer::Variable => {
                let variable = answer.u8()?;
                if call.variable != Some(variable) {
                    let found = format!("variable {variable:#04x}");
                    return Err(answer.unexpected("the variable that was asked for", found));
                }
                answer.str()?;
                sink.answer(index, id, variable, &mut answer)
            }
            Answer::Subscription { context } => {
                parse_reports(id, context, false, &mut answer, sink)
            }
        };
        read.and_then(|()| answer.end("the end of an answer"))
            .map_err(|error| error.in_answer_to(call.name))?;
    }
    // The step is the last command.
    if stepped && carried_out {
        let count = reader.count(2, "the number of subscriptions")?;
        for _ in 0..count {
            let (id, mut answer) = reader.command()?;
            parse_reports(id, is_context(id), true, &mut answer, sink)?;
            answer.end("the end of a subscription's answer")?;
        }
    }
    reader.end("the end of the message")
}

/// Variables whose value is a flat compound: the number of records, then all values of all records.
/// Each entry holds domain, variable, and number of values per record. For some of these variables
/// SUMO 1.15 writes more items than the compound's item count.
const LISTS: [(Domain, u8, usize); 10] = [
    (Domain::INDUCTION_LOOP, 0x17, 5),
    (Domain::LANE, 0x33, 8),
    (Domain::SIMULATION, VAR_COLLISIONS.number(), 9),
    (Domain::TRAFFIC_LIGHT, 0x2f, 9),
    (Domain::TRAFFIC_LIGHT, 0x32, 9),
    (Domain::TRAFFIC_LIGHT, 0x34, 9),
    (Domain::VEHICLE, 0x70, 4),
    (Domain::VEHICLE, 0x73, 6),
    (Domain::VEHICLE, 0x74, 16),
    (Domain::VEHICLE, 0xb2, 6),
];

/// Vehicle variable with the neighbouring vehicles.
const NEIGHBORS: u8 = 0xbf;

/// Reads the value of a variable; `response` is the identifier of the answer. It differs from
/// [`Reader::value`] where SUMO deviates from its own format: the item counts of [`LISTS`] are
/// wrong, the neighbours of a vehicle are a compound of untyped items, and a polygon without points
/// lacks the number that its first byte announces.
pub(super) fn read_value(
    response: u8,
    variable: u8,
    reader: &mut Reader<'_>,
) -> Result<Value, Error> {
    let of = |domain: Domain| [domain.get + 0x10, domain.subscribe + 0x10].contains(&response);
    let compound = reader.peek() == Some(c::TYPE_COMPOUND);
    let list = LISTS.iter().find(|(domain, listed, _)| *listed == variable && of(*domain));
    if let Some((.., values)) = list.filter(|_| compound) {
        let count = read_count(reader, *values)?;
        let mut items = vec![Value::Integer(count as i32)];
        for _ in 0..count * values {
            items.push(reader.value()?);
        }
        return Ok(Value::Compound(items));
    }
    if compound && variable == NEIGHBORS && of(Domain::VEHICLE) {
        reader.u8()?;
        let count = reader.count(4 + 8, "the number of neighbours")?;
        let mut items = vec![Value::Integer(count as i32)];
        for _ in 0..count {
            items.push(Value::String(reader.str()?.to_owned()));
            items.push(Value::Double(reader.f64()?));
        }
        return Ok(Value::Compound(items));
    }
    if reader.empty_polygon() {
        return Ok(Value::Polygon(Vec::new()));
    }
    reader.value()
}

/// Reads the head of the compound of collisions and returns the number of collisions.
pub(super) fn read_collision_count(reader: &mut Reader<'_>) -> Result<usize, Error> {
    // Collider, victim, their types, their speeds, kind, lane, position.
    read_count(reader, 9)
}

/// Reads the head of a list and returns the number of records, each of `values` values.
fn read_count(reader: &mut Reader<'_>, values: usize) -> Result<usize, Error> {
    reader.kind(c::TYPE_COMPOUND, "a list")?;
    reader.i32()?;
    reader.kind(c::TYPE_INTEGER, "the length of a list")?;
    // Each value takes at least two bytes.
    reader.count(values * 2, "the length of a list")
}

/// Whether an answer belongs to a context subscription.
fn is_context(response: u8) -> bool {
    matches!(response, 0x10..=0x1f | 0x90..=0x9f)
}

fn parse_reports(
    response: u8,
    context: bool,
    after_step: bool,
    reader: &mut Reader<'_>,
    sink: &mut impl Sink,
) -> Result<(), Error> {
    let centre = reader.str()?;
    // The answer to a variable subscription is 0x40 above the command that reads the variable.
    let domain = if context { reader.u8()? } else { response.wrapping_sub(0x40) };
    let variables = reader.u8()?;
    let objects = if context { reader.count(4, "the number of objects")? } else { 1 };
    for _ in 0..objects {
        let object = if context { reader.str()? } else { centre };
        let around = context.then_some(centre);
        let (variable, known) = (0, true);
        let mut report = Report { response, around, object, domain, variable, known, after_step };
        for _ in 0..variables {
            report.variable = reader.u8()?;
            report.known = reader.u8()? == c::RTYPE_OK;
            sink.report(report, reader)?;
        }
        sink.object_ends(report, reader)?;
    }
    Ok(())
}
