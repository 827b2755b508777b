//! The format of the workload file.

use std::path::Path;

use anyhow::{Context as _, Result};
use serde::Deserialize;
use serde_json::Value;

/// A workload: what is simulated.
#[derive(Debug, Deserialize)]
pub(crate) struct Workload {
    /// SUMO's arguments, without the program name and the port.
    pub(crate) arguments: Vec<String>,
    pub(crate) vehicle_types: Vec<VehicleType>,
    pub(crate) routes: Vec<Route>,
    /// Names of the vehicles.
    pub(crate) vehicles: Vec<String>,
    /// Number of warm-up steps, which come first and are not timed.
    pub(crate) warmup: usize,
    /// Commands of each step.
    pub(crate) steps: Vec<Vec<Command>>,
}

/// A vehicle type, in metres, seconds, m/s and m/s².
#[derive(Debug, Deserialize)]
pub(crate) struct VehicleType {
    pub(crate) id: String,
    pub(crate) length: f64,
    pub(crate) width: f64,
    pub(crate) max_speed: f64,
    pub(crate) accel: f64,
    pub(crate) decel: f64,
    pub(crate) emergency_decel: f64,
    pub(crate) min_gap: f64,
    pub(crate) tau: f64,
}

#[derive(Debug, Deserialize)]
pub(crate) struct Route {
    pub(crate) id: String,
    /// The edges in driving order.
    pub(crate) edges: Vec<String>,
}

/// A command. Vehicles, routes and types are given by their indices in the lists of the workload.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(try_from = "Vec<Value>")]
pub(crate) enum Command {
    /// Adds a vehicle: position \[m\], speed \[m/s\].
    Add {
        vehicle: usize,
        route: usize,
        kind: usize,
        position: f64,
        speed: f64,
    },
    Remove {
        vehicle: usize,
    },
    SpeedMode {
        vehicle: usize,
        mode: i32,
    },
    /// Sets a speed \[m/s\].
    Speed {
        vehicle: usize,
        speed: f64,
    },
    /// Moves a vehicle: coordinates in metres, angle in degrees clockwise from north.
    Move {
        vehicle: usize,
        x: f64,
        y: f64,
        angle: f64,
        keep_route: i32,
    },
}

impl TryFrom<Vec<Value>> for Command {
    type Error = String;

    fn try_from(words: Vec<Value>) -> Result<Self, String> {
        Self::parse(&words).ok_or_else(|| format!("not a command: {}", Value::Array(words)))
    }
}

impl Command {
    fn parse(words: &[Value]) -> Option<Self> {
        let index = |word: &Value| word.as_u64().and_then(|index| usize::try_from(index).ok());
        let whole = |word: &Value| word.as_i64().and_then(|number| i32::try_from(number).ok());
        let (name, words) = words.split_first()?;
        Some(match (name.as_str()?, words) {
            ("add", [vehicle, route, kind, position, speed]) => Command::Add {
                vehicle: index(vehicle)?,
                route: index(route)?,
                kind: index(kind)?,
                position: position.as_f64()?,
                speed: speed.as_f64()?,
            },
            ("remove", [vehicle]) => Command::Remove { vehicle: index(vehicle)? },
            ("speed_mode", [vehicle, mode]) => Command::SpeedMode { vehicle: index(vehicle)?, mode: whole(mode)? },
            ("speed", [vehicle, speed]) => Command::Speed { vehicle: index(vehicle)?, speed: speed.as_f64()? },
            ("move", [vehicle, x, y, angle, keep_route]) => Command::Move {
                vehicle: index(vehicle)?,
                x: x.as_f64()?,
                y: y.as_f64()?,
                angle: angle.as_f64()?,
                keep_route: whole(keep_route)?,
            },
            _ => return None,
        })
    }
}

impl Workload {
    /// Reads the workload file.
    pub(crate) fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).with_context(|| format!("reading {}", path.display()))?;
        serde_json::from_str(&text).with_context(|| format!("reading {}", path.display()))
    }
}
