//! Tests of replies (complete, truncated, damaged and malicious) and of peers that violate the
//! protocol.

use super::*;
use crate::sumo::{
    Domain, Value,
    codec::Writer,
    domain::{simulation::VAR_TIME, vehicle::VAR_SPEED},
};
use proptest::{collection::vec, prelude::*};

/// Returns a batch with every kind of answer, and a reply to it in the format of SUMO 1.15.
fn dialogue() -> (Batch, Vec<u8>) {
    let mut batch = Batch::new();
    batch.vehicle().set_speed("a", 1.0);
    batch.simulation().get_time();
    batch.subscribe(Domain::VEHICLE, "a", &[VAR_SPEED.id()]);
    batch.subscribe_context(Domain::JUNCTION, "j", Domain::VEHICLE, 9.0, &[VAR_SPEED.id()]);
    batch.vehicle().remove("b", 3);
    batch.subscribe(Domain::VEHICLE, "c", &[VAR_SPEED.id()]);
    batch.seal(Some(0.0)).unwrap();
    let mut w = Writer::default();
    let status = |w: &mut Writer, id, result, text: &str| {
        w.command(id, |w| {
            w.u8(result).str(text);
        });
    };
    let variable = |w: &mut Writer| {
        w.command(0xe4, |w| {
            w.str("a").u8(1).u8(VAR_SPEED.number()).u8(0).double(2.5);
        });
    };
    let context = |w: &mut Writer| {
        w.command(0x99, |w| {
            w.str("j").u8(0xa4).u8(1).i32(1).str("a").u8(VAR_SPEED.number()).u8(0).double(2.5);
        });
    };
    status(&mut w, 0xc4, 0, "");
    status(&mut w, 0xab, 0, "");
    w.command(0xbb, |w| {
        w.u8(VAR_TIME.number()).str("").double(7.0);
    });
    status(&mut w, 0xd4, 0, "");
    variable(&mut w);
    status(&mut w, 0x89, 0, "");
    context(&mut w);
    status(&mut w, 0xc4, 0xff, "Vehicle 'b' is not known");
    // SUMO sends an answer also for a refused subscription.
    status(&mut w, 0xd4, 0xff, "Vehicle 'c' is not known");
    w.command(0xe4, |w| {
        w.str("c").u8(1).u8(VAR_SPEED.number()).u8(0xff).string("Vehicle 'c' is not known");
    });
    status(&mut w, 0x02, 0, "");
    w.i32(3);
    variable(&mut w);
    context(&mut w);
    w.command(0xe4, |w| {
        w.str("b").u8(1).u8(VAR_SPEED.number()).u8(0xff).string("gone");
    });
    (batch, w.finish().unwrap().to_vec())
}

fn collect(message: &[u8], batch: &Batch) -> Result<StepReply, Error> {
    let mut sink = Collector::new(batch);
    parse_reply(message, batch, &mut sink)?;
    Ok(sink.reply)
}

#[test]
fn each_command_gets_its_own_result() {
    let (batch, message) = dialogue();
    let reply = collect(&message, &batch).unwrap();
    assert!(matches!(reply.outcomes[0], Ok(None)));
    assert!(matches!(reply.outcomes[1], Ok(Some(Value::Double(t))) if t == 7.0));
    let Err(Error::Refused { command, id, message, .. }) = &reply.outcomes[4] else {
        panic!("{:?}", reply.outcomes)
    };
    assert_eq!((*command, id.as_str(), message.as_str()), (0xc4, "b", "Vehicle 'b' is not known"));
    assert!(matches!(&reply.outcomes[5], Err(Error::Refused { id, .. }) if id == "c"));
    let values: Vec<_> =
        reply.subscriptions.iter().map(|o| (&*o.object, o.around.as_deref(), &o.value)).collect();
    assert!(matches!(reply.check(), Err(Error::Refused { command: 0xc4, .. })));
    let speed = Ok(Value::Double(2.5));
    let first: Vec<_> = reply
        .outcomes
        .first
        .subscriptions
        .iter()
        .map(|o| (&*o.object, o.around.as_deref()))
        .collect();
    assert_eq!(first, [("a", None), ("a", Some("j"))]);
    assert_eq!(
        values,
        [("a", None, &speed), ("a", Some("j"), &speed), ("b", None, &Err("gone".to_owned()))]
    );
}

#[test]
fn a_name_that_many_values_share_is_kept_once() {
    let mut batch = Batch::new();
    batch.seal(Some(0.0)).unwrap();
    let mut w = Writer::default();
    w.command(c::CMD_SIMSTEP, |w| {
        w.u8(0).str("");
    });
    w.i32(1).command(0x99, |w| {
        w.str(&"j".repeat(40_000)).u8(0xa4).u8(1).i32(5000);
        for i in 0..5000 {
            w.str(["a", "b"][i % 2]).u8(VAR_SPEED.number()).u8(0).value(&Value::UByte(1));
        }
    });
    let message = w.finish().unwrap();
    let mut reply = Err(Error::invalid(""));
    let heap = allocation_counter::measure(|| reply = collect(message, &batch)).bytes_max;
    let subscriptions = reply.unwrap().reports.subscriptions;
    assert!(heap < 40 * message.len() as u64, "{heap}");
    assert_eq!((&*subscriptions[0].object, &*subscriptions[4999].object), ("a", "b"));
    assert!(
        subscriptions
            .iter()
            .all(|observed| observed.around.as_ref().is_some_and(|name| name.len() == 40_000))
    );
}

#[test]
fn every_truncation_of_a_reply_is_an_error() {
    let (batch, message) = dialogue();
    for cut in 0..message.len() {
        assert!(
            matches!(collect(&message[..cut], &batch), Err(Error::Protocol { .. })),
            "cut at {cut}"
        );
    }
    let longer: Vec<u8> = message.iter().copied().chain([0]).collect();
    assert!(collect(&longer, &batch).is_err());
}

#[test]
fn the_status_of_another_command_is_an_error() {
    let (batch, mut message) = dialogue();
    message[5] = 0xc5;
    assert!(matches!(collect(&message, &batch), Err(Error::Protocol { .. })));
}

proptest! {
    #[test]
    fn hostile_replies_never_panic(bytes in vec(any::<u8>(), 0..300)) {
        let (batch, _) = dialogue();
        let _ = collect(&bytes, &batch);
    }

    #[test]
    fn damaged_replies_never_panic(at in any::<prop::sample::Index>(), to in any::<u8>()) {
        let (batch, mut message) = dialogue();
        let at = at.index(message.len());
        message[at] = to;
        let _ = collect(&message, &batch);
    }
}

/// Returns a client whose peer sends `bytes` and then closes the connection, after `hold` if given.
fn client_of(
    bytes: &'static [u8],
    hold: Option<Duration>,
) -> (Client, std::thread::JoinHandle<()>) {
    let listener = std::net::TcpListener::bind(("127.0.0.1", 0)).unwrap();
    let address = listener.local_addr().unwrap();
    let peer = std::thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        let _ = stream.read(&mut [0; 64]);
        let _ = stream.write_all(bytes);
        std::thread::sleep(hold.unwrap_or_default());
    });
    (Client::connect(address, Duration::from_millis(200)).unwrap(), peer)
}

#[test]
fn a_huge_claimed_length_is_refused_without_memory_for_it() {
    for bytes in [&[0x7f, 0xff, 0xff, 0xff][..], &[0xff, 0xff, 0xff, 0xff], &[0, 0, 0, 3]] {
        let (mut client, peer) = client_of(bytes, None);
        assert!(matches!(client.handshake(), Err(Error::Protocol { at_byte: 0, .. })));
        assert!(client.input.capacity() < 1 << 20);
        peer.join().unwrap();
    }
}

#[test]
fn a_large_claim_that_is_not_kept_costs_no_memory() {
    let (mut client, peer) = client_of(&[3, 0, 0, 0, 1, 2, 3], None);
    assert!(matches!(client.handshake(), Err(Error::Closed { .. })));
    assert!(client.input.capacity() < 1 << 20);
    peer.join().unwrap();
}

/// A reply is never taken for that to another message.
#[test]
fn each_message_waits_for_its_own_reply() {
    let (mut client, peer) = client_of(&[], Some(Duration::from_millis(300)));
    let (mut first, mut second) = (Batch::new(), Batch::new());
    first.vehicle().get_speed("a");
    second.vehicle().get_speed("b");
    let mut sink = Collector::new(&first);
    let unsent = client.receive(&first, &mut sink);
    assert!(matches!(unsent, Err(Error::Invalid { .. })), "{unsent:?}");
    client.send(&mut first, None).unwrap();
    let early = client.send(&mut second, None);
    assert!(matches!(early, Err(Error::Invalid { .. })), "{early:?}");
    assert!(matches!(client.vehicle().get_speed("b"), Err(Error::Invalid { .. })));
    peer.join().unwrap();
}

#[test]
fn a_timeout_is_longer_than_zero() {
    let listener = std::net::TcpListener::bind(("127.0.0.1", 0)).unwrap();
    let address = listener.local_addr().unwrap();
    let connected = Client::connect(address, Duration::ZERO);
    assert!(matches!(connected, Err(Error::Invalid { .. })), "{connected:?}");
    let within = Client::connect_within(address, Duration::from_secs(1), Duration::ZERO);
    assert!(matches!(within, Err(Error::Invalid { .. })), "{within:?}");
}

#[test]
fn silence_is_a_timeout_and_an_end_is_closed() {
    let (mut client, peer) = client_of(&[0, 0], Some(Duration::from_millis(600)));
    assert!(matches!(client.handshake(), Err(Error::Timeout { .. })));
    // The client does not take bytes that arrive later for an answer.
    assert!(matches!(client.handshake(), Err(Error::Closed { .. })));
    peer.join().unwrap();
    let (mut client, peer) = client_of(&[0, 0], None);
    assert!(matches!(client.handshake(), Err(Error::Closed { .. })));
    peer.join().unwrap();
}
