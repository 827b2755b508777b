//! Fuzz test with damaged replies: for any bytes from the peer, the reader terminates without a
//! panic and needs memory in proportion to the length of the message. `IWOL_FUZZ_CASES` sets the
//! number of cases, see [`cases`].

#[path = "../../tests/integration/damaged_files/cases.rs"]
mod cases;

use std::sync::LazyLock;

use allocation_counter::measure;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng as Rng;

use super::{
    Batch, Error, SimulationConfig, Value,
    codec::Writer,
    constants::{self as c, Domain},
    domain::{Variable, simulation, vehicle},
    fleet::Fleet,
    replies::Collector,
    reply::parse_reply,
    traci::StepSink,
};

/// Limit of the heap that reading a reply may take \[bytes\]: the first number for each byte of the
/// message, plus the second. Values of two bytes take the most heap per byte.
const HEAP: (u64, u64) = (100, 16 << 10);

/// Type bytes that `damage` writes into messages.
const TYPES: [u8; 14] = [0, 1, 2, 3, 4, 6, 7, 8, 9, 0x0b, 0x0c, 0x0e, 0x0f, 0x10];

const SPEED: u8 = vehicle::VAR_SPEED.number();
const DISTANCE: u8 = vehicle::VAR_DISTANCE.number();
const ARRIVED: u8 = simulation::VAR_ARRIVED_VEHICLES_IDS.number();
const COLLISIONS: u8 = simulation::VAR_COLLISIONS.number();
const TIME: u8 = simulation::VAR_TIME.number();
const VARIABLES: [u8; 5] = [SPEED, DISTANCE, ARRIVED, COLLISIONS, TIME];

const NAMES: [&str; 6] = ["w0s0", "w0s3", "w0s99", "", "ß𝄞", "w0s18446744073709551616"];

fn below(rng: &mut Rng, bound: usize) -> usize {
    rng.random_range(0..bound)
}

fn pick<T: Copy>(rng: &mut Rng, list: &[T]) -> T {
    list[below(rng, list.len())]
}

fn number(rng: &mut Rng) -> f64 {
    pick(rng, &[0.0, 1.5, -1e308, f64::NAN, f64::INFINITY, c::INVALID_DOUBLE_VALUE])
}

/// Returns a batch, a reply to it, and the number of commands that the reply refuses.
fn dialogue(rng: &mut Rng) -> (Batch, Vec<u8>, usize) {
    let mut batch = Batch::new();
    let mut w = Writer::default();
    let mut refused = 0;
    for _ in 0..below(rng, 6) {
        let (variable, name) = (pick(rng, &VARIABLES), pick(rng, &NAMES));
        let domain = pick(rng, &[Domain::VEHICLE, Domain::SIMULATION, Domain::JUNCTION]);
        let variables =
            |domain| VARIABLES.map(|number| Variable::<Value>::new(domain, number).id());
        let count = below(rng, VARIABLES.len());
        let answer = below(rng, 5);
        match answer {
            0 => batch.get(domain, variable, name),
            1 => batch.subscribe(domain, name, &variables(domain)[..count]),
            2 => batch.subscribe_context(
                domain,
                name,
                Domain::VEHICLE,
                9.0,
                &variables(Domain::VEHICLE)[..count],
            ),
            3 => drop(batch.vehicle().add(name, &vehicle::Addition::on_route("r"))),
            _ => drop(batch.vehicle().set_speed(name, 1.0)),
        }
        let command = [
            domain.get,
            domain.subscribe,
            domain.context,
            Domain::VEHICLE.set,
            Domain::VEHICLE.set,
        ][answer];
        let ok = below(rng, 6) > 0;
        refused += usize::from(!ok);
        status(&mut w, command, ok, name);
        match answer {
            _ if !ok => {}
            0 => drop(w.command(domain.get + 0x10, |w| {
                w.u8(variable).str(name);
                value(w, rng, domain, variable, 0);
            })),
            1 if count > 0 => report(&mut w, rng, domain, false),
            2 if count > 0 => report(&mut w, rng, domain, true),
            _ => {}
        }
    }
    let stepped = below(rng, 3) > 0;
    batch.seal(stepped.then_some(0.0)).unwrap();
    if stepped {
        status(&mut w, c::CMD_SIMSTEP, true, "");
        let reports = below(rng, 4);
        w.i32(reports as i32);
        for _ in 0..reports {
            let domain = pick(rng, &[Domain::VEHICLE, Domain::SIMULATION, Domain::JUNCTION]);
            let context = below(rng, 2) == 0;
            report(&mut w, rng, domain, context);
        }
    }
    (batch, w.finish().unwrap().to_vec(), refused)
}

fn status(w: &mut Writer, command: u8, ok: bool, text: &str) {
    w.command(command, |w| {
        w.u8(if ok { c::RTYPE_OK } else { 0xff }).str(text);
    });
}

fn report(w: &mut Writer, rng: &mut Rng, domain: Domain, context: bool) {
    let command = if context { domain.context } else { domain.subscribe };
    w.command(command + 0x10, |w| {
        let many = below(rng, 30) == 0;
        w.str(&pick(rng, &NAMES).repeat(if many { below(rng, 2000) } else { 1 }));
        if context {
            w.u8(Domain::VEHICLE.get);
        }
        let variables = 2 + below(rng, if many { 254 } else { 2 });
        w.u8(variables as u8);
        let objects = if context { below(rng, 4) } else { 1 };
        if context {
            w.i32(objects as i32);
        }
        for _ in 0..objects {
            if context {
                w.str(pick(rng, &NAMES));
            }
            for i in 0..variables {
                // `StepSink` requires distance and speed of a vehicle in a context report.
                let variable = match i {
                    0 if context => SPEED,
                    1 if context => DISTANCE,
                    _ => pick(rng, &VARIABLES),
                };
                let known = below(rng, 8) > 0;
                w.u8(variable).u8(if known { c::RTYPE_OK } else { 0xff });
                match variable {
                    _ if !known => drop(w.string("gone")),
                    // `StepSink` requires the right type for each variable that it reads.
                    // Collisions in a context report are an empty compound.
                    SPEED | DISTANCE | TIME => drop(w.double(rng.random_range(-1e9..1e9))),
                    ARRIVED => drop(w.string_list(&[pick(rng, &NAMES)])),
                    _ if context => drop(w.compound(0)),
                    _ => value(w, rng, domain, variable, 0),
                }
            }
        }
    });
}

/// Writes a random value, or collisions in SUMO's format.
fn value(w: &mut Writer, rng: &mut Rng, domain: Domain, variable: u8, depth: usize) {
    if variable == COLLISIONS && domain == Domain::SIMULATION {
        let count = below(rng, 4);
        w.compound(1 + 4 * count as i32).integer(count as i32);
        for _ in 0..count {
            w.string(pick(rng, &NAMES)).string(pick(rng, &NAMES)).string("t").string("t");
            w.double(number(rng))
                .double(number(rng))
                .string("junction")
                .string("l")
                .double(number(rng));
        }
        return;
    }
    let count = below(rng, 5);
    let numbers: Vec<f64> = (0..2 * count).map(|_| number(rng)).collect();
    w.value(&match below(rng, if depth < 6 { 16 } else { 15 }) {
        0 => Value::UByte(rng.random()),
        1 => Value::Byte(rng.random()),
        2 => Value::Integer(rng.random()),
        3 => Value::Double(number(rng)),
        4 => Value::String(pick(rng, &NAMES).repeat(below(rng, 40))),
        5 => Value::StringList((0..count).map(|_| pick(rng, &NAMES).to_owned()).collect()),
        6 => Value::DoubleList(numbers),
        7 => Value::LonLat([number(rng); 2]),
        8 => Value::LonLatAlt([number(rng); 3]),
        9 => Value::Position2D([number(rng); 2]),
        10 => Value::Position3D([number(rng); 3]),
        11 => Value::RoadMap {
            edge: pick(rng, &NAMES).to_owned(),
            position: number(rng),
            lane: rng.random(),
        },
        // At least one point, because SUMO encodes a polygon without points differently.
        12 => Value::Polygon(vec![[number(rng); 2]; 1 + count]),
        13 => Value::Polygon(vec![[number(rng); 2]; 250 + count]),
        14 => Value::Color(rng.random()),
        _ => {
            w.compound(count as i32);
            for _ in 0..count {
                value(w, rng, domain, SPEED, depth + 1);
            }
            return;
        }
    });
}

/// The state of one world with four slots.
static FLEET: LazyLock<Fleet> =
    LazyLock::new(|| Fleet::new(SimulationConfig::crossing(4)).unwrap());

fn damage(rng: &mut Rng, message: &mut Vec<u8>) {
    const COUNTS: [i32; 10] = [0, 1, -1, 2, 255, 256, 65_536, i32::MAX, i32::MIN, 1 << 24];
    for _ in 0..=below(rng, 4) {
        let (at, until) = (below(rng, message.len() + 1), below(rng, message.len() + 1));
        let (start, end) = (at.min(until), at.max(until));
        match below(rng, 12) {
            0 => message.truncate(at),
            1 => drop(message.drain(start..end)),
            2 => drop(message.splice(at..at, message[start..end].to_vec())),
            3 => {
                drop(message.splice(
                    at..at,
                    (0..below(rng, 300)).map(|_| rng.random()).collect::<Vec<u8>>(),
                ));
            }
            4 => {
                let few = message[start..end.min(start + 24)].repeat(below(rng, 400));
                message.splice(at..at, few);
            }
            5..8 if at + 4 <= message.len() => {
                message[at..at + 4].copy_from_slice(&pick(rng, &COUNTS).to_be_bytes());
            }
            8 | 9 if at < message.len() => message[at] = pick(rng, &TYPES),
            _ if at < message.len() => message[at] ^= 1 << below(rng, 8),
            _ => {}
        }
    }
}

/// Reads a message with both sinks, checks the limit on memory, and returns the number of refused
/// commands or the error.
fn read(message: &[u8], batch: &Batch) -> [Result<usize, Error>; 2] {
    let within = |what: &str, heap: u64| {
        let limit = HEAP.0 * message.len() as u64 + HEAP.1;
        assert!(
            heap <= limit,
            "{what}: {heap} bytes of heap for a message of {} bytes",
            message.len()
        );
    };
    let mut collector = Collector::new(batch);
    let mut collected = Ok(0);
    let heap = measure(|| collected = parse_reply(message, batch, &mut collector).map(|()| 0));
    within("collected", heap.bytes_max);
    let refused = collector.reply.outcomes.iter().filter(|outcome| outcome.is_err()).count();

    let mut fleet = FLEET.clone();
    let mut sink = StepSink::new(&mut fleet);
    let mut stepped = Ok(0);
    let heap = measure(|| stepped = parse_reply(message, batch, &mut sink).map(|()| 0));
    within("stepped", heap.bytes_max);
    let snapshot = &fleet.snapshot;
    assert_eq!(snapshot.vehicles.len(), 4);
    assert!(
        snapshot.vehicles.iter().flatten().all(|v| v.distance.is_finite() && v.speed.is_finite())
    );
    assert!(
        snapshot.collisions.iter().all(|collision| collision.collider < 4 && collision.victim < 4)
    );
    [collected.map(|_| refused), stepped]
}

#[test]
fn damaged_replies_are_read_or_refused() {
    cases::run(20_000, |number| {
        let mut rng = Rng::seed_from_u64(number);
        let (batch, mut message, refused) = dialogue(&mut rng);
        let [collected, stepped] = read(&message, &batch);
        assert_eq!(collected.unwrap(), refused, "the reply is valid");
        stepped.unwrap();
        damage(&mut rng, &mut message);
        for result in read(&message, &batch) {
            if let Err(error) = result {
                assert!(error.is_fatal() && error.to_string().len() < 200, "{error}");
            }
        }
    });
}
