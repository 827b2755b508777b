//! Inspection of a scenario: a map of it ([`picture`], [`page`]), a short trial run ([`Trial`]), and a
//! whole check with a trial ([`check`]).

mod check;
mod map;
mod trial;

pub use check::{Report, check};
pub use map::{page, picture};
pub use trial::{Hiding, Range, Trial};
