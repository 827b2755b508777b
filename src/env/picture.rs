//! What pictures and the player show of a world.

use serde::{Deserialize, Serialize};

/// What moves in a world, at one time.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Picture {
    /// The agents, in the order of their slots.
    pub agents: Vec<Figure>,
    /// Others, such as background traffic.
    pub others: Vec<Figure>,
    /// States of the traffic lights in [`Backdrop::signals`], a letter per signal.
    pub lights: Vec<String>,
}

/// A body seen from above.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Figure {
    /// Position of the centre \[m\].
    pub centre: [f64; 2],
    /// Direction, counter-clockwise from the x axis \[rad\].
    pub heading: f64,
    /// Length and width \[m\].
    pub size: [f64; 2],
    /// Speed \[m/s\].
    pub speed: f64,
    /// How it is drawn.
    pub status: FigureStatus,
}

/// How a body is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum FigureStatus {
    /// It is not there.
    #[default]
    Absent,
    /// It moves, or acts.
    Active,
    /// It has reached its goal; it is shown for a few steps.
    Arrived,
    /// It has crashed, or failed otherwise.
    Failed,
}

/// What does not move in an environment.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Backdrop {
    /// Duration of a step \[s\].
    pub step_length: f64,
    /// Length and width of an agent's body, where nothing else is said \[m\].
    pub size: [f64; 2],
    /// Communication range \[m\]; infinite if it is unlimited.
    pub range: f64,
    /// Distance up to which agents see each other \[m\]; `None` if it is unlimited or unknown.
    pub sight: Option<f64>,
    /// Lanes, or other strips of ground.
    pub lanes: Vec<Lane>,
    /// Areas of the ground; later ones are drawn over earlier ones.
    pub zones: Vec<Zone>,
    /// Polygons that block sight or radio, by their corners \[m\].
    pub walls: Vec<Vec<[f64; 2]>>,
    /// Signals at the ends of lanes.
    pub signals: Vec<SignalPlace>,
}

/// A lane to draw.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Lane {
    /// SUMO id, or another name.
    pub id: String,
    /// Width \[m\].
    pub width: f64,
    /// Whether the lane lies in a junction.
    pub internal: bool,
    /// Whether the lane is a pedestrian crossing.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub crossing: bool,
    /// Centre line \[m\].
    pub shape: Vec<[f64; 2]>,
}

/// An area of the ground.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Zone {
    /// What the area is for; areas of one name have one colour.
    pub name: String,
    /// Corners \[m\].
    pub shape: Vec<[f64; 2]>,
}

impl Zone {
    /// Returns the rectangle between two opposite corners \[m\].
    pub fn rectangle(name: &str, [left, bottom]: [f64; 2], [right, top]: [f64; 2]) -> Self {
        let shape = vec![[left, bottom], [right, bottom], [right, top], [left, top]];
        Self { name: name.to_owned(), shape }
    }
}

/// Where a signal stands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SignalPlace {
    /// The part of the stop line to which the signal applies \[m\].
    pub line: [[f64; 2]; 2],
    /// Number of its traffic light in [`Picture::lights`].
    pub light: usize,
    /// Number of the signal in the light's state.
    pub signal: usize,
}
