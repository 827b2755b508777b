//! Reads where and how fast vehicles depart and arrive.

use roxmltree::Node;

use super::super::Error;
use super::super::reader::{Reader, finite};
use super::{Finish, Start};
use crate::sumo::net::{did_you_mean, nearest, shorten};

/// Returns the text of an attribute that is one of `words`, or a number that `fits`.
fn word(
    reader: &Reader,
    node: Node,
    key: &str,
    number: &str,
    fits: impl Fn(f64) -> bool,
    words: &[&str],
) -> Result<String, Error> {
    let value = node.attribute(key).unwrap_or(words[0]).trim();
    if words.contains(&value) || finite(value).is_some_and(fits) {
        return Ok(value.to_owned());
    }
    let similar = did_you_mean(nearest(&shorten(value), words.iter().copied()));
    Err(reader.value(node, key, format!("{number}, {}{similar}", words.join(", "))))
}

fn is_index(value: f64) -> bool {
    value >= 0.0 && value.fract() == 0.0
}

const INDEX: &str = "the index of a lane, from 0";
const METRES: &str = "a number of metres (from the end of the edge, if negative)";
const SPEED: &str = "a number of at least 0";

/// Returns where and how fast a vehicle departs.
pub(super) fn start(reader: &Reader, node: Node) -> Result<Start, Error> {
    // The first word is SUMO's default.
    let lanes = ["first", "random", "free", "allowed", "best"];
    let places = ["base", "random", "free", "random_free", "last", "stop"];
    let speeds = ["0", "random", "max", "desired", "speedLimit", "last", "avg"];
    Ok(Start {
        lane: word(reader, node, "departLane", INDEX, is_index, &lanes)?,
        pos: word(reader, node, "departPos", METRES, |_| true, &places)?,
        speed: word(reader, node, "departSpeed", SPEED, |v| v >= 0.0, &speeds)?,
    })
}

/// Returns where and how fast a vehicle arrives.
pub(super) fn finish(reader: &Reader, node: Node) -> Result<Finish, Error> {
    Ok(Finish {
        lane: word(reader, node, "arrivalLane", INDEX, is_index, &["current", "first", "random"])?,
        pos: word(reader, node, "arrivalPos", METRES, |_| true, &["max", "random"])?,
        speed: word(reader, node, "arrivalSpeed", SPEED, |v| v >= 0.0, &["current"])?,
    })
}
