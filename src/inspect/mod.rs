//! Inspection of a scenario: a map of it ([`picture`], [`page`]) and a short trial run ([`Trial`]).

mod map;
mod trial;

pub use map::{page, picture};
pub use trial::{Range, Trial};
