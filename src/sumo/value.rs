//! Conversions from SUMO's typed values to Rust's types and back.

use std::vec;

use super::{
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
    /// stays, which SUMO allows for vehicles only.
    pub fade: Option<(u8, f64)>,
    /// Number of the highlight; a new highlight replaces the one with the same number.
    pub kind: u8,
}

impl Default for Highlight {
    fn default() -> Self {
        Highlight { color: Color::rgb(255, 0, 0), size: -1.0, fade: None, kind: 0 }
    }
}

impl Argument for &Highlight {
    fn write(self, w: &mut Writer) {
        // SUMO does not fade a circle whose opacity is 0 and whose duration is negative.
        let (alpha, duration) = self.fade.unwrap_or((0, -1.0));
        (self.color, self.size, alpha, duration, self.kind).write(w);
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

/// Implements [`Argument`].
macro_rules! argument_types {
    ($($kind:ty: |$value:pat_param, $w:ident| $write:expr;)+) => {
        $(impl Argument for $kind {
            fn write(self, $w: &mut Writer) {
                let $value = self;
                $write;
            }
        })+
    };
}

argument_types! {
    f64: |v, w| w.double(v);
    i32: |v, w| w.integer(v);
    u8: |v, w| w.u8(c::TYPE_UBYTE).u8(v);
    i8: |v, w| w.u8(c::TYPE_BYTE).u8(v.cast_unsigned());
    &str: |v, w| w.string(v);
    Color: |Color { r, g, b, a }, w| w.u8(c::TYPE_COLOR).u8(r).u8(g).u8(b).u8(a);
    [f64; 2]: |v, w| w.position(v, false);
    Doubles<'_>: |Doubles(v), w| w.double_list(v);
    Empty: |Empty, w| w.compound(0);
    Untyped: |Untyped(v), w| w.u8(v);
    OnRoad<'_>: |OnRoad(edge, position, lane), w| w.road_position(edge, position, lane);
    OnPlane: |OnPlane(position, is_geo), w| w.position(position, is_geo);
    Points<'_>: |Points(points), w| w.polygon(points);
}

/// The argument of a call that has none.
pub(super) struct Nothing;
/// A compound without items.
pub(super) struct Empty;
/// A byte without a type.
pub(super) struct Untyped(pub(super) u8);
/// Edge, distance from its start \[m\], index of the lane.
pub(super) struct OnRoad<'a>(pub(super) &'a str, pub(super) f64, pub(super) u8);
/// x and y \[m\], or longitude and latitude \[deg\] if the second value is `true`.
pub(super) struct OnPlane(pub(super) [f64; 2], pub(super) bool);
/// Numbers.
pub(super) struct Doubles<'a>(pub(super) &'a [f64]);
/// Points of a line or an area \[m\].
pub(super) struct Points<'a>(pub(super) &'a [[f64; 2]]);

impl Argument for Nothing {
    fn write(self, _: &mut Writer) {}
}

impl<T: AsRef<str>> Argument for &[T] {
    fn write(self, w: &mut Writer) {
        w.string_list(self);
    }
}

/// Makes tuples arguments: they are compounds.
macro_rules! compounds {
    ($($item:ident)*) => {
        #[allow(non_snake_case, reason = "one name for the type and the value of an item")]
        impl<$($item: Argument),*> Argument for ($($item,)*) {
            fn write(self, w: &mut Writer) {
                let ($($item,)*) = self;
                w.compound(const { <[&str]>::len(&[$(stringify!($item)),*]) as i32 });
                $($item.write(w);)*
            }
        }
        compounds! { @less $($item)* }
    };
    (@less $last:ident) => {};
    (@less $first:ident $($item:ident)+) => { compounds! { $($item)+ } };
}

compounds! { A B C D E F G H I J K L M N }
