//! Reads messages.

use super::Value;
use crate::sumo::{Error, constants as c};

/// Maximum nesting depth of compounds; SUMO itself nests two.
const MAXIMUM_DEPTH: u32 = 16;

/// Reads the bytes of a message or of a part of it.
#[derive(Debug, Clone)]
pub struct Reader<'a> {
    pub(super) bytes: &'a [u8],
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
    pub(in crate::sumo) fn empty_polygon(&mut self) -> bool {
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
