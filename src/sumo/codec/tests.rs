//! Tests that values and commands survive encoding and decoding, and that invalid bytes are
//! rejected.

use super::*;
use crate::sumo::{Error, constants as c};
use proptest::{collection::vec, num, prelude::*};

fn number() -> impl Strategy<Value = f64> {
    num::f64::NORMAL | num::f64::ZERO | num::f64::INFINITE | num::f64::SUBNORMAL
}

fn value() -> impl Strategy<Value = Value> {
    let leaf = prop_oneof![
        any::<u8>().prop_map(Value::UByte),
        any::<i8>().prop_map(Value::Byte),
        any::<i32>().prop_map(Value::Integer),
        number().prop_map(Value::Double),
        ".{0,20}".prop_map(Value::String),
        vec(".{0,6}", 0..5).prop_map(Value::StringList),
        vec(number(), 0..5).prop_map(Value::DoubleList),
        [number(), number()].prop_map(Value::LonLat),
        [number(), number(), number()].prop_map(Value::LonLatAlt),
        [number(), number()].prop_map(Value::Position2D),
        [number(), number(), number()].prop_map(Value::Position3D),
        (".{0,6}", number(), any::<u8>()).prop_map(|(edge, position, lane)| Value::RoadMap {
            edge,
            position,
            lane
        }),
        vec([number(), number()], 0..4).prop_map(Value::Polygon),
        Just(Value::Polygon(vec![[1.0, 2.0]; 300])),
        any::<[u8; 4]>().prop_map(Value::Color),
    ];
    leaf.prop_recursive(3, 12, 4, |inner| vec(inner, 0..4).prop_map(Value::Compound))
}

fn encoded(value: &Value) -> Vec<u8> {
    let mut writer = Writer::default();
    writer.value(value);
    writer.bytes()[4..].to_vec()
}

proptest! {
    #[test]
    fn values_survive_the_wire(value in value()) {
        let bytes = encoded(&value);
        let mut reader = Reader::new(&bytes, 4);
        prop_assert_eq!(reader.value().unwrap(), value);
        prop_assert!(reader.end("the end").is_ok());
    }

    #[test]
    fn every_truncation_is_an_error_inside_the_bytes(value in value()) {
        let bytes = encoded(&value);
        for cut in 0..bytes.len() {
            match Reader::new(&bytes[..cut], 0).value() {
                Err(Error::Protocol { at_byte, .. }) => prop_assert!(at_byte <= cut),
                other => prop_assert!(false, "cut at {}: {:?}", cut, other),
            }
        }
    }

    #[test]
    fn arbitrary_bytes_never_panic(bytes in vec(any::<u8>(), 0..200)) {
        let mut reader = Reader::new(&bytes, 0);
        while reader.value().is_ok() && reader.remaining() > 0 {}
        let mut reader = Reader::new(&bytes, 0);
        while let Ok((_, content)) = reader.command() {
            prop_assert!(content.remaining() <= bytes.len());
        }
    }

    #[test]
    fn commands_of_any_length_survive_the_wire(content in vec(any::<u8>(), 0..600), id in any::<u8>()) {
        let mut writer = Writer::default();
        for _ in 0..2 {
            let range = writer.command(id, |w| content.iter().for_each(|b| { w.u8(*b); }));
            prop_assert_eq!(&writer.bytes()[range], &content[..]);
        }
        let message = writer.finish().unwrap().to_vec();
        prop_assert_eq!(u32::from_be_bytes(message[..4].try_into().unwrap()) as usize, message.len());
        let mut reader = Reader::new(&message[4..], 4);
        for _ in 0..2 {
            let (found, body) = reader.command().unwrap();
            prop_assert_eq!((found, body.bytes), (id, &content[..]));
        }
        prop_assert_eq!(reader.remaining(), 0);
    }
}

#[test]
fn a_claimed_length_beyond_the_bytes_is_refused_before_anything_is_allocated() {
    for kind in [c::TYPE_STRING, c::TYPE_STRINGLIST, c::TYPE_DOUBLELIST, c::TYPE_COMPOUND] {
        for length in [i32::MAX, -1, i32::MIN, 5] {
            let mut bytes = vec![kind];
            bytes.extend(length.to_be_bytes());
            assert!(matches!(
                Reader::new(&bytes, 0).value(),
                Err(Error::Protocol { at_byte: 1, .. })
            ));
        }
    }
}

#[test]
fn compounds_in_compounds_without_end_are_refused() {
    let bytes = [c::TYPE_COMPOUND, 0, 0, 0, 1].repeat(100_000);
    assert!(matches!(Reader::new(&bytes, 0).value(), Err(Error::Protocol { .. })));
}

#[test]
fn a_command_shorter_than_its_head_is_refused() {
    assert!(Reader::new(&[1, 2, 3], 0).command().is_err());
    assert!(Reader::new(&[0, 0, 0, 0, 5, 2], 0).command().is_err());
    assert!(Reader::new(&[0, 0xff, 0xff, 0xff, 0xff, 2], 0).command().is_err());
    assert!(Reader::new(&[0, 0, 0, 0, 6, 2], 0).command().is_ok());
}

#[test]
fn text_that_is_not_utf8_is_refused_where_it_begins() {
    let bytes = [0, 0, 0, 3, b'a', 0xff, b'b'];
    assert!(matches!(Reader::new(&bytes, 10).str(), Err(Error::Protocol { at_byte: 15, .. })));
}
