//! What a scenario looks like, and how it runs: a picture of it ([`picture`], [`page`]) and a short trial ([`Trial`]).

mod map;
mod trial;

pub use map::{page, picture};
pub use trial::{Range, Trial};
