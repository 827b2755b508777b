//! A reply, read in place. SUMO answers the commands of a message one by one, in order, and after a step
//! tells what the subscriptions report; all of it is handed to a [`Sink`] while it is read.

use super::{
    Error,
    batch::{Answer, Batch},
    codec::{Reader, Value},
    constants::{self as c, Domain},
    domain::simulation::VAR_COLLISIONS,
};

/// One variable that a subscription reports.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Report<'a> {
    /// Identifier of the answer: the subscription's command + 0x10.
    pub response: u8,
    /// The object at the centre, for a context subscription.
    pub around: Option<&'a str>,
    /// The object that the value belongs to.
    pub object: &'a str,
    /// The command that reads variables of the object's domain, [`Domain::get`].
    pub domain: u8,
    /// The variable.
    pub variable: u8,
    /// `false`: the value is SUMO's message why there is no value (the object is gone).
    pub known: bool,
    /// Whether the value is that after the step of the message; else it is the first answer to the
    /// subscription, of the time before the step.
    pub after_step: bool,
}

/// Takes in a reply as it is read. Each method gets what its name says; those for values must read the
/// one typed value that the reader stands at. The provided ones let everything pass.
pub trait Sink {
    /// The command of this index in the batch was refused, or was not sent because SUMO must not get it.
    fn refused(&mut self, index: usize, message: &str) {
        let _ = (index, message);
    }

    /// The value of a variable that the `get` command of this index asked for; `response` is as in [`Report`].
    ///
    /// # Errors
    /// [`Error::Protocol`] if the bytes are not what they should be.
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

    /// A variable of a subscription.
    ///
    /// # Errors
    /// [`Error::Protocol`] if the bytes are not what they should be.
    fn report(&mut self, report: Report<'_>, value: &mut Reader<'_>) -> Result<(), Error> {
        report.read(value).map(drop)
    }
}

impl Report<'_> {
    /// Reads the value that the reader stands at.
    ///
    /// # Errors
    /// [`Error::Protocol`] if there is none.
    pub fn read(&self, value: &mut Reader<'_>) -> Result<Value, Error> {
        read_value(self.domain.wrapping_add(0x10), self.variable, value)
    }
}

/// Reads the reply to a sealed batch.
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
        // 1.15 answers a refused filter under the filter's number.
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
            // 1.15 answers a refused subscription all the same, with the reason in place of the values. No command
            // has the identifier of such an answer.
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

/// Lists that are one compound of a number and all values of that many records: domain, variable, and
/// values of a record. For some of them, 1.15 writes more items than it counts.
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

/// Vehicle variable: those beside it.
const NEIGHBORS: u8 = 0xbf;

/// Reads the value of a variable; `response` is the identifier of the answer. Differs from
/// [`Reader::value`] where SUMO departs from its own types: [`LISTS`] are not counted right; the neighbours
/// of a vehicle are a compound of untyped items; a polygon without points lacks the number that its first
/// byte announces.
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

/// Reads the head of the compound of collisions up to their number.
pub(super) fn read_collision_count(reader: &mut Reader<'_>) -> Result<usize, Error> {
    // Collider, victim, their types, their speeds, kind, lane, position.
    read_count(reader, 9)
}

/// Reads the head of a list up to the number of records, of so many values each.
fn read_count(reader: &mut Reader<'_>, values: usize) -> Result<usize, Error> {
    reader.kind(c::TYPE_COMPOUND, "a list")?;
    reader.i32()?;
    reader.kind(c::TYPE_INTEGER, "the length of a list")?;
    // No value takes less than two bytes.
    reader.count(values * 2, "the length of a list")
}

/// Whether an answer is that of a context subscription.
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
    // A variable subscription is answered with 0x40 more than the command that reads the variable.
    let domain = if context { reader.u8()? } else { response.wrapping_sub(0x40) };
    let variables = reader.u8()?;
    let objects = if context { reader.count(4, "the number of objects")? } else { 1 };
    for _ in 0..objects {
        let object = if context { reader.str()? } else { centre };
        for _ in 0..variables {
            let variable = reader.u8()?;
            let known = reader.u8()? == c::RTYPE_OK;
            let around = context.then_some(centre);
            sink.report(
                Report { response, around, object, domain, variable, known, after_step },
                reader,
            )?;
        }
    }
    Ok(())
}
