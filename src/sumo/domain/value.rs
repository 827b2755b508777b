//! Conversions from SUMO's typed values to Rust's types and back.

use std::vec;

use crate::sumo::{
    Error,
    codec::{Value, Writer},
    constants as c,
};

/// A type that the result of a call can have.
pub trait FromValue: Sized {
    /// Converts SUMO's typed value.
    ///
    /// # Errors
    /// [`Error::Type`] if the value has another type.
    fn from_value(value: Value) -> Result<Self, Error>;
}

fn mismatch(expected: &'static str, found: &Value) -> Error {
    Error::other_type(expected, found.kind())
}

macro_rules! from_value {
    ($($result:ty: $expected:literal, $($value:pat => $then:expr),+;)+) => {
        $(impl FromValue for $result {
            fn from_value(value: Value) -> Result<Self, Error> {
                match value {
                    $($value => Ok($then),)+
                    other => Err(mismatch($expected, &other)),
                }
            }
        })+
    };
}

from_value! {
    f64: "a double", Value::Double(v) => v;
    i32: "an integer", Value::Integer(v) => v, Value::UByte(v) => v.into(), Value::Byte(v) => v.into();
    bool: "a truth value", Value::Integer(v) => v != 0, Value::UByte(v) => v != 0, Value::Byte(v) => v != 0;
    // SUMO sends a letter as its character code.
    char: "a letter", Value::UByte(v) => v.into(), Value::Byte(v) => v.cast_unsigned().into();
    String: "a string", Value::String(v) => v;
    Vec<String>: "a list of strings", Value::StringList(v) => v;
    Vec<f64>: "a list of doubles", Value::DoubleList(v) => v;
    [f64; 2]: "a position", Value::Position2D(v) | Value::LonLat(v) => v;
    [f64; 3]: "a position with height", Value::Position3D(v) | Value::LonLatAlt(v) => v;
    Vec<[f64; 2]>: "a polygon", Value::Polygon(v) => v;
    Color: "a colour", Value::Color([r, g, b, a]) => Color { r, g, b, a };
    RoadPosition: "a position on a lane",
        Value::RoadMap { edge, position, lane } => RoadPosition { edge, position, lane };
}

impl FromValue for Value {
    fn from_value(value: Value) -> Result<Self, Error> {
        Ok(value)
    }
}

impl FromValue for (String, String) {
    fn from_value(value: Value) -> Result<Self, Error> {
        compound(value, |fields| Ok((fields.take()?, fields.take()?)))
    }
}

/// A colour.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Color {
    /// Red.
    pub r: u8,
    /// Green.
    pub g: u8,
    /// Blue.
    pub b: u8,
    /// Opacity; 255 is opaque.
    pub a: u8,
}

impl Color {
    /// Returns an opaque colour.
    pub const fn rgb(r: u8, g: u8, b: u8) -> Self {
        Color { r, g, b, a: 255 }
    }
}

/// A position on a lane.
#[derive(Debug, Clone, PartialEq)]
pub struct RoadPosition {
    /// Edge identifier.
    pub edge: String,
    /// Distance from the start of the lane \[m\].
    pub position: f64,
    /// Index of the lane, 0 is the rightmost.
    pub lane: u8,
}

/// A circle drawn around an object in the graphical interface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Highlight {
    /// Colour of the circle.
    pub color: Color,
    /// Size \[m\]; negative: the length of the object.
    pub size: f64,
    /// Greatest opacity and duration \[s\] of a circle that fades in and out; `None`: the circle
    /// stays.
    pub fade: Option<(u8, f64)>,
    /// Number of the highlight; a new highlight replaces the one with the same number.
    pub kind: u8,
}

impl Default for Highlight {
    fn default() -> Self {
        Highlight { color: Color::rgb(255, 0, 0), size: -1.0, fade: None, kind: 0 }
    }
}

impl Highlight {
    pub(super) fn write(&self, w: &mut Writer) {
        // SUMO does not fade a circle whose opacity is 0 and whose duration is negative.
        let (alpha, duration) = self.fade.unwrap_or((0, -1.0));
        w.compound(5);
        Argument::write(self.color, w);
        w.double(self.size);
        Argument::write(alpha, w);
        w.double(duration);
        Argument::write(self.kind, w);
    }
}

/// The items of a compound, read from first to last.
pub(super) struct Fields(vec::IntoIter<Value>);

impl Fields {
    /// Takes the next item.
    pub(super) fn take<T: FromValue>(&mut self) -> Result<T, Error> {
        match self.0.next() {
            Some(value) => T::from_value(value),
            None => Err(Error::other_type("a value", "the end of a compound")),
        }
    }

    /// Takes all remaining items.
    pub(super) fn rest<T: FromValue>(&mut self) -> Result<Vec<T>, Error> {
        self.0.by_ref().map(T::from_value).collect()
    }

    /// Takes a number, and then that many records.
    pub(super) fn records<T: FromFields>(&mut self) -> Result<Vec<T>, Error> {
        let count: i32 = self.take()?;
        (0..count).map(|_| T::from_fields(self)).collect()
    }
}

/// A type that SUMO sends as consecutive values in a compound.
pub(super) trait FromFields: Sized {
    fn from_fields(fields: &mut Fields) -> Result<Self, Error>;
}

/// Reads a compound to its end with `read`; items that `read` leaves are an error.
pub(super) fn compound<T>(
    value: Value,
    read: impl FnOnce(&mut Fields) -> Result<T, Error>,
) -> Result<T, Error> {
    let items = match value {
        Value::Compound(items) => items,
        other => return Err(mismatch("a compound", &other)),
    };
    let mut fields = Fields(items.into_iter());
    let result = read(&mut fields)?;
    match fields.0.len() {
        0 => Ok(result),
        left => Err(Error::other_type("the end of a compound", format!("{left} values more"))),
    }
}

/// A type that can be an argument of a call.
pub trait Argument {
    /// Writes `self` as a typed value.
    fn write(self, w: &mut Writer);
}

impl Argument for f64 {
    fn write(self, w: &mut Writer) {
        w.double(self);
    }
}

impl Argument for i32 {
    fn write(self, w: &mut Writer) {
        w.integer(self);
    }
}

impl Argument for u8 {
    fn write(self, w: &mut Writer) {
        w.u8(c::TYPE_UBYTE).u8(self);
    }
}

impl Argument for i8 {
    fn write(self, w: &mut Writer) {
        w.u8(c::TYPE_BYTE).u8(self.cast_unsigned());
    }
}

impl Argument for &str {
    fn write(self, w: &mut Writer) {
        w.string(self);
    }
}

impl<T: AsRef<str>> Argument for &[T] {
    fn write(self, w: &mut Writer) {
        w.string_list(self);
    }
}

impl Argument for Color {
    fn write(self, w: &mut Writer) {
        w.u8(c::TYPE_COLOR).u8(self.r).u8(self.g).u8(self.b).u8(self.a);
    }
}

impl Argument for [f64; 2] {
    fn write(self, w: &mut Writer) {
        w.position(self, false);
    }
}
