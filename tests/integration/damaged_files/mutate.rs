//! Damages XML, mostly so that it stays well-formed and the damage gets past the parser.

use std::ops::Range;

use iwol_sumo::rng::{Rng, below};

/// Attribute values that are invalid or extreme.
const VALUES: [&str; 36] = [
    "",
    " ",
    "0",
    "-0",
    "-1",
    "1",
    "2",
    "0.5",
    "1e-308",
    "5e-324",
    "-1e-308",
    "1e-6",
    "1e-3",
    "1e9",
    "-1e9",
    "1e308",
    "1e999",
    "nan",
    "-NaN",
    "inf",
    "-infinity",
    "2147483648",
    "4294967296",
    "18446744073709551616",
    "99999999999999999999999999999999",
    "0x10",
    "1,5",
    "1_000",
    "+7",
    "abc",
    "0,0",
    "0,0 0,0",
    "1e9,1e9 -1e9,-1e9",
    "0,0 1e-7,0",
    "true",
    "\u{202e}ß𝄞",
];

/// Pieces of text that do not belong into a net or a scenario.
const PIECES: [&str; 13] = [
    "\u{feff}",
    "\0",
    "<",
    ">",
    "&",
    "&#0;",
    "&amp;",
    "&#x110000;",
    "<!-- -- -->",
    "<![CDATA[<edge/>]]>",
    "<?a?>",
    "<a:b xmlns:a='u' a:c='1'/>",
    "]]>",
];

const BOMB: &str = "<!DOCTYPE x [<!ENTITY a 'aaaaaaaaaa'><!ENTITY b '&a;&a;&a;&a;&a;&a;&a;&a;'>\
    <!ENTITY c '&b;&b;&b;&b;&b;&b;&b;&b;'><!ENTITY d '&c;&c;&c;&c;&c;&c;&c;&c;'>]>";

/// Returns a text with some damage, often of one kind; foreign parts are taken from `other`.
pub fn damaged(rng: &mut Rng, text: &str, other: &str) -> Vec<u8> {
    let mut bytes = text.as_bytes().to_vec();
    for _ in 0..=below(rng, 6).saturating_sub(2) {
        let length = bytes.len();
        match below(rng, 100) {
            0..50 => value(rng, &mut bytes),
            50..62 => attribute(rng, &mut bytes),
            62..80 => element(rng, &mut bytes),
            80..84 => {
                let piece = pick(rng, &PIECES);
                insert_anywhere(rng, &mut bytes, piece.as_bytes());
            }
            84..86 => transplant(rng, &mut bytes, other.as_bytes()),
            86..88 => bytes.truncate(below(rng, length + 1)),
            88..94 if length > 0 => bytes[below(rng, length)] ^= 1 << below(rng, 8),
            94..96 => blow_up(rng, &mut bytes),
            96 => bytes = [BOMB.as_bytes(), &bytes[..], b"&d;"].concat(),
            97 => bytes = [b"\xef\xbb\xbf", &bytes[..]].concat(),
            98 if below(rng, 4) == 0 => {
                let units = String::from_utf8_lossy(&bytes).encode_utf16().collect::<Vec<_>>();
                bytes = units.iter().flat_map(|unit| unit.to_le_bytes()).collect();
            }
            _ => {}
        }
    }
    bytes
}

fn pick<'v>(rng: &mut Rng, list: &[&'v str]) -> &'v str {
    list[below(rng, list.len())]
}

fn insert(bytes: &mut Vec<u8>, at: usize, new: &[u8]) {
    bytes.splice(at..at, new.iter().copied());
}

fn insert_anywhere(rng: &mut Rng, bytes: &mut Vec<u8>, new: &[u8]) {
    let at = below(rng, bytes.len() + 1);
    insert(bytes, at, new);
}

/// Returns the ranges of all attribute values, between the quotes.
fn values(bytes: &[u8]) -> Vec<Range<usize>> {
    let quotes = bytes
        .iter()
        .enumerate()
        .filter(|(_, byte)| **byte == b'"')
        .map(|(at, _)| at)
        .collect::<Vec<_>>();
    quotes
        .chunks_exact(2)
        .map(|pair| pair[0] + 1..pair[1])
        .filter(|value| bytes[..value.start - 1].ends_with(b"="))
        .collect()
}

/// Returns the ranges of all elements whose end can be found, without comments and declarations.
fn elements(bytes: &[u8]) -> Vec<Range<usize>> {
    let (mut found, mut open) = (Vec::new(), Vec::new());
    let mut at = 0;
    while let Some(start) = bytes[at..].iter().position(|byte| *byte == b'<').map(|i| at + i) {
        let Some(end) = bytes[start..].iter().position(|byte| *byte == b'>').map(|i| start + i + 1)
        else {
            break;
        };
        match bytes[start + 1] {
            b'/' => found.extend(open.pop().map(|start| start..end)),
            b'!' | b'?' => {}
            _ if bytes[end - 2] == b'/' => found.push(start..end),
            _ => open.push(start),
        }
        at = end;
    }
    found
}

fn any(rng: &mut Rng, ranges: &[Range<usize>]) -> Option<Range<usize>> {
    (!ranges.is_empty()).then(|| ranges[below(rng, ranges.len())].clone())
}

/// Changes the value of an attribute, or one number or word of it.
fn value(rng: &mut Rng, bytes: &mut Vec<u8>) {
    let all = values(bytes);
    let (Some(mut at), Some(from)) = (any(rng, &all), any(rng, &all)) else {
        return;
    };
    if below(rng, 3) > 0 {
        // Only one item of a list is changed.
        let item = |byte: &u8| b" ,:".contains(byte);
        let cut = at.start + below(rng, at.len() + 1);
        let start =
            bytes[at.start..cut].iter().rposition(item).map_or(at.start, |i| at.start + i + 1);
        at = start..bytes[start..at.end].iter().position(item).map_or(at.end, |i| start + i);
    }
    let old = String::from_utf8_lossy(&bytes[at.clone()]).into_owned();
    let new = match below(rng, 8) {
        0 => pick(rng, &VALUES).to_owned(),
        1 => String::from_utf8_lossy(&bytes[from]).into_owned(),
        2 => String::new(),
        3 => format!("{old} {old}"),
        // The new value is a number that may be valid.
        _ => match old.parse::<f64>() {
            Ok(number) => match below(rng, 5) {
                0 => (number * 0.999).to_string(),
                1 => (number + 1.0).to_string(),
                2 => (-number).to_string(),
                3 => (number * 10_f64.powi(below(rng, 18) as i32 - 9)).to_string(),
                _ => number.round().to_string(),
            },
            Err(_) => return,
        },
    };
    bytes.splice(at, new.bytes());
}

/// Removes an attribute, duplicates it, or swaps the values of two attributes.
fn attribute(rng: &mut Rng, bytes: &mut Vec<u8>) {
    let all = values(bytes);
    let (Some(a), Some(b)) = (any(rng, &all), any(rng, &all)) else {
        return;
    };
    let start = bytes[..a.start].iter().rposition(|byte| b" \n<".contains(byte)).unwrap_or(0);
    let whole = bytes[start..=a.end].to_vec();
    match below(rng, 4) {
        0 => drop(bytes.drain(start..=a.end)),
        1 => insert(bytes, start, &whole),
        2 => insert(bytes, b.end + 1, &whole),
        _ if a.end < b.start => swap(bytes, a, b),
        _ if b.end < a.start => swap(bytes, b, a),
        _ => {}
    }
}

/// Swaps two ranges; `first` lies before `second`.
fn swap(bytes: &mut Vec<u8>, first: Range<usize>, second: Range<usize>) {
    let (one, two) = (bytes[first.clone()].to_vec(), bytes[second.clone()].to_vec());
    bytes.splice(second, one);
    bytes.splice(first, two);
}

/// Removes an element, repeats it, wraps it, moves it, or swaps it with another one.
fn element(rng: &mut Rng, bytes: &mut Vec<u8>) {
    let all = elements(bytes);
    let (Some(a), Some(b)) = (any(rng, &all), any(rng, &all)) else {
        return;
    };
    let whole = bytes[a.clone()].to_vec();
    match below(rng, 6) {
        0 => drop(bytes.drain(a)),
        1 => insert(bytes, a.start, &whole),
        2 => insert(bytes, a.start, &whole.repeat(below(rng, 60))),
        3 => insert(bytes, b.start, &whole),
        4 if a.end <= b.start => swap(bytes, a, b),
        4 if b.end <= a.start => swap(bytes, b, a),
        4 => {}
        _ => {
            insert(bytes, a.end, b"</net>");
            insert(bytes, a.start, b"<net>");
        }
    }
}

/// Inserts a piece of another text at a random position.
fn transplant(rng: &mut Rng, bytes: &mut Vec<u8>, other: &[u8]) {
    let start = below(rng, other.len());
    let end = start + below(rng, other.len() - start);
    insert_anywhere(rng, bytes, &other[start..end]);
}

/// Makes something very long, very deep or very numerous.
fn blow_up(rng: &mut Rng, bytes: &mut Vec<u8>) {
    let size = 1 << below(rng, 16);
    let list =
        |item: &dyn Fn(usize) -> String| (0..size).map(item).collect::<String>().into_bytes();
    match below(rng, 6) {
        0 => insert_anywhere(rng, bytes, &list(&|_| "<edge>".into())),
        kind => {
            let (all, tags) = (values(bytes), elements(bytes));
            let (Some(value), Some(tag)) = (any(rng, &all), any(rng, &tags)) else {
                return;
            };
            let name = tag.start
                + 1
                + bytes[tag.start + 1..].iter().take_while(|b| b.is_ascii_alphabetic()).count();
            let (at, new) = match kind {
                1 => (value.end, list(&|i| format!(" {i}"))),
                2 => (value.end, list(&|i| format!(" {i},{}", i % 7))),
                3 => (value.end, list(&|_| "a".into())),
                4 => (name, list(&|i| format!(" a{i}=''"))),
                _ => (name, list(&|i| format!(" xmlns:n{i}='u{i}'"))),
            };
            insert(bytes, at, &new);
        }
    }
}
