//! Builds messages.

use super::Value;
use crate::sumo::{Error, constants as c};

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
