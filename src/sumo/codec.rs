//! The byte format of the TraCI protocol: a [`Writer`] that builds one message in a reusable
//! buffer, a [`Reader`] for the bytes of a received message, and the typed [`Value`]s that both
//! support.
//!
//! A message consists of its length (4 bytes, big-endian, including these 4 bytes) and commands. A
//! command consists of its length (1 byte, or a zero byte and 4 bytes if it does not fit), its
//! identifier and its content. The reader does not trust the peer: it checks every access,
//! allocates no list before the bytes for it have arrived, and every error names the byte of the
//! message at which it occurred.

mod reader;
mod writer;

pub use reader::Reader;
pub use writer::Writer;

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

#[cfg(test)]
mod tests;
