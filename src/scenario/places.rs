//! Nets and their spawn places.

use std::path::PathBuf;
use std::sync::Arc;

use super::attribute::element;

/// A net and its spawn places.
#[derive(Debug, Clone, PartialEq)]
pub struct Net {
    /// Path of the `.net.xml`, resolved against the scenario file's folder.
    pub file: PathBuf,
    /// Rows of spawn places.
    pub spawns: Vec<SpawnRow>,
}

/// A row of equally spaced spawn places on the first edge of its routes.
#[derive(Debug, Clone, PartialEq)]
pub struct SpawnRow {
    /// Indices into [`Scenario::routes`](super::Scenario::routes) of the routes that begin here, all of them on one lane. A
    /// vehicle draws one of them in each episode.
    pub routes: Arc<[usize]>,
    /// Position of the first place on the routes' first edge \[m\].
    pub first: f64,
    /// Distance between neighbouring places \[m\].
    pub spacing: f64,
    /// Number of places.
    pub count: u32,
    /// Whether, when and how fast vehicles depart from these places.
    pub departure: PlaceDeparture,
}

/// A spawn place.
#[derive(Debug, Clone, PartialEq)]
pub struct SpawnPlace {
    /// Indices of the routes that begin here, as in [`SpawnRow::routes`].
    pub routes: Arc<[usize]>,
    /// Position on the routes' first edge \[m\].
    pub pos: f64,
    /// Whether, when and how fast a vehicle departs from this place.
    pub departure: PlaceDeparture,
}

element! {
    /// Whether, when and how fast vehicles depart from spawn places.
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub struct PlaceDeparture {
        /// Probability that a vehicle departs from a place in an episode, above 0 to 1.
        pub presence: f64,
        /// Earliest time of the departure, from the start of the episode \[s\].
        pub begin: f64,
        /// Latest time of the departure \[s\].
        pub end: f64,
        /// Speed of a vehicle when it departs \[m/s\].
        pub depart_speed: f64,
    }
}

impl PlaceDeparture {
    /// Returns whether a vehicle starts with the episode, standing still.
    pub fn is_immediate(&self) -> bool {
        self.end <= 0.0 && self.depart_speed <= 0.0
    }
}

impl Default for PlaceDeparture {
    fn default() -> Self {
        Self { presence: 1.0, begin: 0.0, end: 0.0, depart_speed: 0.0 }
    }
}

impl Net {
    /// Returns the number of spawn places.
    #[must_use]
    pub fn capacity(&self) -> u32 {
        self.spawns.iter().map(|row| row.count).sum()
    }

    /// Returns the spawn places, row by row.
    pub fn places(&self) -> impl Iterator<Item = SpawnPlace> + '_ {
        self.spawns.iter().flat_map(|row| {
            (0..row.count).map(|i| SpawnPlace {
                routes: Arc::clone(&row.routes),
                pos: row.first + row.spacing * f64::from(i),
                departure: row.departure,
            })
        })
    }
}
