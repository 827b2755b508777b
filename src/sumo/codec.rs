//! The byte format of the TraCI protocol: a [`Writer`] that builds one message in a reusable
//! buffer, a [`Reader`] for the bytes of a received message, and the typed [`Value`]s that both
//! support.
//!
//! A message consists of its length (4 bytes, big-endian, including these 4 bytes) and commands. A
//! command consists of its length (1 byte, or a zero byte and 4 bytes if it does not fit), its
//! identifier and its content. The reader does not trust the peer: it checks every access,
//! allocates no list before the bytes for it have arrived, and every error names the byte of the
//! message at which it occurred.

use super::{Error, constants as c};

/// Maximum nesting depth of compounds; SUMO itself nests two.
const MAXIMUM_DEPTH: u32 = 16;

/// A typed value of the protocol.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Value {
    /// Unsigned byte.
    UByte(u8),
    /// Signed byte.
    Byte(i8),
    /// 32 bit integer.
    Integer(i32),
    /// Floating point number.
    Double(f64),
    /// Text.
    String(String),
    /// List of texts.
    StringList(Vec<String>),
    /// List of floating point numbers.
    DoubleList(Vec<f64>),
    /// Longitude and latitude \[deg\].
    LonLat([f64; 2]),
    /// Longitude, latitude \[deg\] and altitude \[m\].
    LonLatAlt([f64; 3]),
    /// x and y \[m\].
    Position2D([f64; 2]),
    /// x, y and z \[m\].
    Position3D([f64; 3]),
    /// A position on a lane.
    RoadMap {
        /// Edge identifier.
        edge: String,
        /// Distance from the start of the edge \[m\].
        position: f64,
        /// Index of the lane; 0 is the rightmost.
        lane: u8,
    },
    /// Points \[m\].
    Polygon(Vec<[f64; 2]>),
    /// Red, green, blue, alpha.
    Color([u8; 4]),
    /// Sequence of typed values.
    Compound(Vec<Value>),
}

impl Value {
    /// Returns the type in words.
    pub fn kind(&self) -> &'static str {
        match self {
            Value::UByte(_) => "an unsigned byte",
            Value::Byte(_) => "a byte",
            Value::Integer(_) => "an integer",
            Value::Double(_) => "a double",
            Value::String(_) => "a string",
            Value::StringList(_) => "a list of strings",
            Value::DoubleList(_) => "a list of doubles",
            Value::LonLat(_) | Value::LonLatAlt(_) => "a geographic position",
            Value::Position2D(_) => "a position on the plane",
            Value::Position3D(_) => "a position in space",
            Value::RoadMap { .. } => "a position on a lane",
            Value::Polygon(_) => "a polygon",
            Value::Color(_) => "a colour",
            Value::Compound(_) => "a compound",
        }
    }
}

/// Builds one message in a buffer that is reused from message to message.
#[derive(Debug, Clone)]
pub struct Writer {
    bytes: Vec<u8>,
}

impl Default for Writer {
    fn default() -> Self {
        Writer { bytes: vec![0; 4] }
    }
}

impl Writer {
    /// Returns the number of bytes written so far, including the 4 bytes of the message length.
    pub fn len(&self) -> usize {
        self.bytes.len()
    }

    /// Whether the message holds no command.
    pub fn is_empty(&self) -> bool {
        self.bytes.len() <= 4
    }

    /// Shortens the message to a length that [`Writer::len`] returned between two commands.
    pub fn truncate(&mut self, len: usize) {
        self.bytes.truncate(len.max(4));
    }

    /// Returns the bytes written so far. The first 4 hold the message length only after
    /// [`Writer::finish`].
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Fills in the message length and returns the message.
    ///
    /// # Errors
    /// [`Error::Invalid`] if the message is longer than [`c::MAXIMUM_MESSAGE`].
    pub fn finish(&mut self) -> Result<&[u8], Error> {
        let length = self.bytes.len();
        if length > c::MAXIMUM_MESSAGE {
            return Err(Error::invalid(format!(
                "a message of {length} bytes is longer than the {} that are allowed",
                c::MAXIMUM_MESSAGE
            )));
        }
        self.bytes[..4].copy_from_slice(&(length as u32).to_be_bytes());
        Ok(&self.bytes)
    }

    /// Writes one command, whose content after the identifier `content` writes. Returns the byte
    /// range of the content.
    pub fn command(&mut self, id: u8, content: impl FnOnce(&mut Writer)) -> std::ops::Range<usize> {
        let start = self.bytes.len();
        self.bytes.extend_from_slice(&[0, id]);
        content(self);
        let length = self.bytes.len() - start;
        if let Ok(short) = u8::try_from(length) {
            self.bytes[start] = short;
            start + 2..start + length
        } else {
            let long = (length + 4) as u32;
            let after_zero = start + 1;
            self.bytes.splice(after_zero..after_zero, long.to_be_bytes());
            start + 6..start + length + 4
        }
    }

    /// Writes an untyped byte.
    pub fn u8(&mut self, value: u8) -> &mut Self {
        self.bytes.push(value);
        self
    }

    /// Writes an untyped integer.
    pub fn i32(&mut self, value: i32) -> &mut Self {
        self.bytes.extend_from_slice(&value.to_be_bytes());
        self
    }

    /// Writes an untyped floating point number.
    pub fn f64(&mut self, value: f64) -> &mut Self {
        self.bytes.extend_from_slice(&value.to_be_bytes());
        self
    }

    /// Writes an untyped string.
    pub fn str(&mut self, value: &str) -> &mut Self {
        self.i32(value.len() as i32);
        self.bytes.extend_from_slice(value.as_bytes());
        self
    }

    /// Writes a typed double.
    pub fn double(&mut self, value: f64) -> &mut Self {
        self.u8(c::TYPE_DOUBLE).f64(value)
    }

    /// Writes a typed integer.
    pub fn integer(&mut self, value: i32) -> &mut Self {
        self.u8(c::TYPE_INTEGER).i32(value)
    }

    /// Writes a typed string.
    pub fn string(&mut self, value: &str) -> &mut Self {
        self.u8(c::TYPE_STRING).str(value)
    }

    /// Writes a typed list of strings.
    pub fn string_list<S: AsRef<str>>(&mut self, values: &[S]) -> &mut Self {
        self.u8(c::TYPE_STRINGLIST).i32(values.len() as i32);
        for value in values {
            self.str(value.as_ref());
        }
        self
    }

    /// Writes a typed list of floating point numbers.
    pub fn double_list(&mut self, values: &[f64]) -> &mut Self {
        self.u8(c::TYPE_DOUBLELIST).i32(values.len() as i32).doubles(values)
    }

    /// Writes a typed position: longitude and latitude \[deg\] if `geographic`, else x and y \[m\].
    pub fn position(&mut self, position: [f64; 2], geographic: bool) -> &mut Self {
        self.u8(if geographic { c::POSITION_LON_LAT } else { c::POSITION_2D }).doubles(&position)
    }

    /// Writes a typed position on a lane: edge, distance from its start \[m\], index of the lane.
    pub fn road_position(&mut self, edge: &str, position: f64, lane: u8) -> &mut Self {
        self.u8(c::POSITION_ROADMAP).str(edge).f64(position).u8(lane)
    }

    /// Writes a typed polygon of points \[m\].
    pub fn polygon(&mut self, points: &[[f64; 2]]) -> &mut Self {
        self.u8(c::TYPE_POLYGON);
        match u8::try_from(points.len()) {
            Ok(short) if short > 0 => self.u8(short),
            _ => self.u8(0).i32(points.len() as i32),
        };
        self.doubles(points.as_flattened())
    }

    /// Writes the head of a compound; the caller then writes its `items` typed values.
    pub fn compound(&mut self, items: i32) -> &mut Self {
        self.u8(c::TYPE_COMPOUND).i32(items)
    }

    /// Writes any typed value.
    pub fn value(&mut self, value: &Value) -> &mut Self {
        match value {
            Value::UByte(v) => self.u8(c::TYPE_UBYTE).u8(*v),
            Value::Byte(v) => self.u8(c::TYPE_BYTE).u8(v.to_be_bytes()[0]),
            Value::Integer(v) => self.integer(*v),
            Value::Double(v) => self.double(*v),
            Value::String(v) => self.string(v),
            Value::StringList(v) => self.string_list(v),
            Value::DoubleList(v) => self.double_list(v),
            Value::LonLat(v) => self.position(*v, true),
            Value::LonLatAlt(v) => self.u8(c::POSITION_LON_LAT_ALT).doubles(v),
            Value::Position2D(v) => self.position(*v, false),
            Value::Position3D(v) => self.u8(c::POSITION_3D).doubles(v),
            Value::RoadMap { edge, position, lane } => self.road_position(edge, *position, *lane),
            Value::Polygon(points) => self.polygon(points),
            Value::Color(v) => {
                self.u8(c::TYPE_COLOR).bytes.extend_from_slice(v);
                self
            }
            Value::Compound(items) => {
                self.compound(items.len() as i32);
                for item in items {
                    self.value(item);
                }
                self
            }
        }
    }

    fn doubles(&mut self, values: &[f64]) -> &mut Self {
        for value in values {
            self.f64(*value);
        }
        self
    }
}

/// Reads the bytes of a message or of a part of it.
#[derive(Debug, Clone)]
pub struct Reader<'a> {
    bytes: &'a [u8],
    /// Position of `bytes[0]` in the message.
    base: usize,
    at: usize,
}

impl<'a> Reader<'a> {
    /// Returns a reader for bytes that begin at byte `base` of the message.
    pub fn new(bytes: &'a [u8], base: usize) -> Self {
        Reader { bytes, base, at: 0 }
    }

    /// Returns the number of unread bytes.
    pub fn remaining(&self) -> usize {
        self.bytes.len() - self.at
    }

    /// Returns the position in the message \[bytes\].
    pub fn position(&self) -> usize {
        self.base + self.at
    }

    /// Returns the next byte without consuming it.
    pub fn peek(&self) -> Option<u8> {
        self.bytes.get(self.at).copied()
    }

    /// Returns the error "expected this, found that" for the current position.
    pub fn unexpected(&self, expected: &'static str, found: impl Into<String>) -> Error {
        Error::Protocol { expected, found: found.into(), at_byte: self.position() }
    }

    /// Consumes a polygon without points in SUMO's encoding, which is equal to the beginning of a
    /// polygon of more than 255 points. Returns `false`, and consumes nothing, if something else
    /// follows.
    pub(super) fn empty_polygon(&mut self) -> bool {
        let mut ahead = self.clone();
        let begins = ahead.kind(c::TYPE_POLYGON, "a polygon").is_ok()
            && ahead.u8().is_ok_and(|short| short == 0);
        let has_points = ahead.clone().count(16, "a polygon").is_ok_and(|count| count > 255);
        let empty = begins && !has_points;
        if empty {
            *self = ahead;
        }
        empty
    }

    /// Consumes `n` bytes.
    ///
    /// # Errors
    /// [`Error::Protocol`] if fewer bytes are left.
    fn take(&mut self, n: usize, expected: &'static str) -> Result<&'a [u8], Error> {
        if n > self.remaining() {
            return Err(self.unexpected(expected, format!("{} bytes of {n}", self.remaining())));
        }
        let taken = &self.bytes[self.at..self.at + n];
        self.at += n;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self, expected: &'static str) -> Result<[u8; N], Error> {
        let mut array = [0; N];
        array.copy_from_slice(self.take(N, expected)?);
        Ok(array)
    }

    /// Reads an untyped byte.
    ///
    /// # Errors
    /// [`Error::Protocol`] if too few bytes are left; this holds for every method that reads.
    pub fn u8(&mut self) -> Result<u8, Error> {
        Ok(self.array::<1>("a byte")?[0])
    }

    /// Reads an untyped integer.
    ///
    /// # Errors
    /// As [`Reader::u8`].
    pub fn i32(&mut self) -> Result<i32, Error> {
        Ok(i32::from_be_bytes(self.array("an integer")?))
    }

    /// Reads an untyped floating point number.
    ///
    /// # Errors
    /// As [`Reader::u8`].
    pub fn f64(&mut self) -> Result<f64, Error> {
        Ok(f64::from_be_bytes(self.array("a floating point number")?))
    }

    /// Reads an untyped string.
    ///
    /// # Errors
    /// As [`Reader::u8`]; also if the string is not UTF-8.
    pub fn str(&mut self) -> Result<&'a str, Error> {
        let length = self.count(1, "a string")?;
        let start = self.position();
        let bytes = self.take(length, "a string")?;
        std::str::from_utf8(bytes).map_err(|e| Error::Protocol {
            expected: "text in UTF-8",
            found: "other bytes".to_owned(),
            at_byte: start + e.valid_up_to(),
        })
    }

    /// Reads the number of items of a list, each of which takes at least `item` bytes.
    ///
    /// # Errors
    /// As [`Reader::u8`]; also if the number is negative or the remaining bytes cannot hold the
    /// items.
    pub fn count(&mut self, item: usize, expected: &'static str) -> Result<usize, Error> {
        let at_byte = self.position();
        let count = self.i32()?;
        match usize::try_from(count) {
            Ok(n) if n.checked_mul(item).is_some_and(|bytes| bytes <= self.remaining()) => Ok(n),
            _ => {
                let found = format!("a length of {count} with {} bytes left", self.remaining());
                Err(Error::Protocol { expected, found, at_byte })
            }
        }
    }

    /// Reads the head of a command and returns its identifier and a reader for its content.
    ///
    /// # Errors
    /// As [`Reader::u8`]; also if the command's length is shorter than its head or exceeds the
    /// remaining bytes.
    pub fn command(&mut self) -> Result<(u8, Reader<'a>), Error> {
        let start = self.at;
        let at_byte = self.position();
        let mut length = i64::from(self.u8()?);
        if length == 0 {
            length = i64::from(self.i32()?);
        }
        let id = self.u8()?;
        let head = self.at - start;
        let content = usize::try_from(length).ok().and_then(|l| l.checked_sub(head));
        let Some(content) = content.filter(|n| *n <= self.remaining()) else {
            let found =
                format!("a length of {length} with {} bytes left", self.bytes.len() - start);
            return Err(Error::Protocol { expected: "a command", found, at_byte });
        };
        let base = self.position();
        Ok((id, Reader::new(self.take(content, "a command")?, base)))
    }

    /// Checks that all bytes have been read.
    ///
    /// # Errors
    /// [`Error::Protocol`] if bytes are left.
    pub fn end(&self, expected: &'static str) -> Result<(), Error> {
        match self.remaining() {
            0 => Ok(()),
            n => Err(self.unexpected(expected, format!("{n} bytes more"))),
        }
    }

    /// Reads a type byte and checks that it equals `kind`.
    ///
    /// # Errors
    /// As [`Reader::u8`]; also if the type is another one.
    pub fn kind(&mut self, kind: u8, expected: &'static str) -> Result<(), Error> {
        let at_byte = self.position();
        let found = self.u8()?;
        if found == kind {
            return Ok(());
        }
        Err(Error::Protocol { expected, found: format!("type {found:#04x}"), at_byte })
    }

    /// Reads a typed double.
    ///
    /// # Errors
    /// As [`Reader::u8`]; also if the value has another type.
    pub fn double(&mut self) -> Result<f64, Error> {
        self.kind(c::TYPE_DOUBLE, "a double")?;
        self.f64()
    }

    /// Reads a typed integer.
    ///
    /// # Errors
    /// As [`Reader::double`].
    pub fn integer(&mut self) -> Result<i32, Error> {
        self.kind(c::TYPE_INTEGER, "an integer")?;
        self.i32()
    }

    /// Reads a typed string.
    ///
    /// # Errors
    /// As [`Reader::double`].
    pub fn string(&mut self) -> Result<&'a str, Error> {
        self.kind(c::TYPE_STRING, "a string")?;
        self.str()
    }

    /// Reads a typed position on the plane \[m\].
    ///
    /// # Errors
    /// As [`Reader::double`].
    pub fn position_2d(&mut self) -> Result<[f64; 2], Error> {
        self.kind(c::POSITION_2D, "a position")?;
        self.doubles()
    }

    /// Reads any typed value.
    ///
    /// # Errors
    /// As [`Reader::u8`]; also for an unknown type and for compounds nested more than 16 deep.
    pub fn value(&mut self) -> Result<Value, Error> {
        self.nested(0)
    }

    fn nested(&mut self, depth: u32) -> Result<Value, Error> {
        let at_byte = self.position();
        Ok(match self.u8()? {
            c::TYPE_UBYTE => Value::UByte(self.u8()?),
            c::TYPE_BYTE => Value::Byte(i8::from_be_bytes([self.u8()?])),
            c::TYPE_INTEGER => Value::Integer(self.i32()?),
            c::TYPE_DOUBLE => Value::Double(self.f64()?),
            c::TYPE_STRING => Value::String(self.str()?.to_owned()),
            c::TYPE_STRINGLIST => {
                let count = self.count(4, "a list of strings")?;
                let mut list = Vec::new();
                for _ in 0..count {
                    list.push(self.str()?.to_owned());
                }
                Value::StringList(list)
            }
            c::TYPE_DOUBLELIST => {
                let count = self.count(8, "a list of numbers")?;
                Value::DoubleList((0..count).map(|_| self.f64()).collect::<Result<_, _>>()?)
            }
            c::POSITION_LON_LAT => Value::LonLat(self.doubles()?),
            c::POSITION_LON_LAT_ALT => Value::LonLatAlt(self.doubles()?),
            c::POSITION_2D => Value::Position2D(self.doubles()?),
            c::POSITION_3D => Value::Position3D(self.doubles()?),
            c::POSITION_ROADMAP => Value::RoadMap {
                edge: self.str()?.to_owned(),
                position: self.f64()?,
                lane: self.u8()?,
            },
            c::TYPE_POLYGON => {
                let count = match self.u8()? {
                    0 => self.count(16, "a polygon")?,
                    short => usize::from(short),
                };
                Value::Polygon((0..count).map(|_| self.doubles()).collect::<Result<_, _>>()?)
            }
            c::TYPE_COLOR => Value::Color(self.array("a colour")?),
            c::TYPE_COMPOUND if depth < MAXIMUM_DEPTH => {
                let count = self.count(2, "a compound")?;
                let mut items = Vec::new();
                for _ in 0..count {
                    items.push(self.nested(depth + 1)?);
                }
                Value::Compound(items)
            }
            c::TYPE_COMPOUND => {
                let found = format!("more than {MAXIMUM_DEPTH} compounds in each other");
                return Err(Error::Protocol { expected: "a value", found, at_byte });
            }
            other => {
                let found = format!("type {other:#04x}");
                return Err(Error::Protocol { expected: "a known type of value", found, at_byte });
            }
        })
    }

    fn doubles<const N: usize>(&mut self) -> Result<[f64; N], Error> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = self.f64()?;
        }
        Ok(values)
    }
}

#[cfg(test)]
mod tests;
