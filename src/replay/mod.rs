//! Recordings of episodes, and their displays: a player in one HTML file, and still pictures as
//! SVG.
//!
//! A recording is JSON. Row `k` of its columns describes the agents at step `k`: pose and speed
//! before the decision, the chosen action, the agent's own reward for it, and the value estimate
//! for the observation. Numbers are stored as 16-bit integers with a scale, in base64, so that 48
//! vehicles over 1000 steps take 1.4 MB:
//!
//! ```python
//! column = recording["columns"]["speed"]
//! data = base64.b64decode(column["data"])
//! speed = np.frombuffer(data, "<i2").reshape(steps, agents) * column["scale"]
//! ```

mod recorder;
mod still;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde::{Deserialize, Serialize};

use crate::record;

pub use crate::env::{Lane, Zone};
pub use recorder::{RecordedDiagnostics, Recorder, Title};

/// The player's HTML; the recording replaces [`HOLE`].
const PLAYER: &str = include_str!("player.html");
const HOLE: &str = "__RECORDING__";
/// Version of the recording format.
const FORMAT: u32 = 1;
/// Integer that marks a missing number.
const NOTHING: i16 = i16::MIN;
/// Speed above which two positions are those of different vehicles \[m/s\].
const FASTEST: f64 = 60.0;

/// A recorded episode, step by step.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Recording {
    /// Version of the recording format.
    pub format: u32,
    /// Name of the scenario.
    pub scenario: String,
    /// Name of the policy.
    pub policy: String,
    /// Seed of the evaluation.
    pub seed: u64,
    /// Number of the episode within the evaluation.
    pub episode: u64,
    /// Duration of a step \[s\].
    pub step_length: f64,
    /// Number of agents N.
    pub agents: usize,
    /// Number of rows T.
    pub steps: usize,
    /// Communication range \[m\]; `None` if it is unlimited.
    pub comm_range: Option<f64>,
    /// Distance up to which agents see each other \[m\]; `None` if it is unlimited or unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sight_range: Option<f64>,
    /// Whether agents send messages at run time. If not, the edges show which agents are in range.
    pub communicates: bool,
    /// Size of every agent's vehicle, unless the columns `length` and `width` give each its own.
    pub vehicle: Size,
    /// The lanes of the net.
    pub lanes: Vec<Lane>,
    /// Areas of the ground; later ones lie over earlier ones.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub zones: Vec<Zone>,
    /// Polygons that block sight or radio, by their corners \[m\]; empty in tasks without them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub walls: Vec<Vec<[f64; 2]>>,
    /// Columns of numbers per step and agent, `[T, N]` each, by name.
    pub columns: BTreeMap<String, Column>,
    /// Base64 of `[T, N]` bytes: 0 absent, 1 driving, 2 arrived, 3 failed (crashed or off-road).
    pub status: String,
    /// Base64 of bits `[T, N, ⌈N/8⌉]`, least significant bit first: row i marks the agents whose
    /// messages reach agent i.
    pub edges: Option<String>,
    /// Background traffic per step: `[x, y, heading, length, width, wreck]` in metres and radians,
    /// wreck 0 or 1; empty in tasks without background traffic.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub others: Vec<Vec<[f64; 6]>>,
    /// Signals at the ends of lanes; empty in tasks without signals on their routes.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub signals: Vec<Signal>,
    /// Metrics of the episode, by name.
    pub summary: BTreeMap<String, f64>,
}

/// A signal.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Signal {
    /// The part of the stop line to which the signal applies; the connections from a lane share the
    /// lane's stop line \[m\].
    pub line: [[f64; 2]; 2],
    /// What the signal says at each step, a letter of SUMO's states each.
    pub states: String,
}

/// Length and width \[m\].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Size {
    /// Length \[m\].
    pub length: f64,
    /// Width \[m\].
    pub width: f64,
}

/// A column of numbers per step and agent.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Column {
    /// Unit of the numbers.
    pub unit: String,
    /// Factor by which the integers are multiplied.
    pub scale: f64,
    /// Base64 of little-endian 16-bit integers `[T, N]`; −32768 marks a missing number.
    pub data: String,
}

impl Column {
    /// Encodes numbers; NaN and infinities become missing numbers.
    fn new(unit: &str, values: &[f64]) -> Self {
        let largest = values
            .iter()
            .filter(|v| v.is_finite())
            .fold(0.0_f64, |largest, v| largest.max(v.abs()));
        // The range of 16-bit integers limits the resolution; a scale below 1e-4 is never needed.
        let scale = (largest / 32_000.0).max(1e-4);
        let bytes = values.iter().flat_map(|value| {
            let number = if value.is_finite() { (value / scale).round() as i16 } else { NOTHING };
            number.to_le_bytes()
        });
        Self { unit: unit.to_owned(), scale, data: STANDARD.encode(bytes.collect::<Vec<u8>>()) }
    }

    /// Returns the numbers, `[T, N]`, with NaN for missing ones; `None` if the data are damaged.
    fn values(&self) -> Option<Vec<f64>> {
        let bytes = STANDARD.decode(&self.data).ok()?;
        let number = |pair: &[u8]| match i16::from_le_bytes([pair[0], pair[1]]) {
            NOTHING => f64::NAN,
            number => f64::from(number) * self.scale,
        };
        bytes.len().is_multiple_of(2).then(|| bytes.chunks_exact(2).map(number).collect())
    }
}

impl Recording {
    /// Reads a recording from a file.
    ///
    /// # Errors
    /// [`Error::Record`] if the file cannot be read, [`Error::Damaged`] if it is no recording or its
    /// parts do not fit together.
    pub fn load(path: &Path) -> Result<Self, Error> {
        let text = std::fs::read(path).map_err(record::Error::io("read", path))?;
        let damaged = |why: String| Error::Damaged { path: path.to_owned(), why };
        let recording: Self = serde_json::from_slice(&text).map_err(|e| damaged(e.to_string()))?;
        if recording.format != FORMAT {
            return Err(damaged(format!(
                "its format is {}, and this program reads {FORMAT}",
                recording.format
            )));
        }
        let rows = recording.steps * recording.agents;
        let bytes = |text: &str| STANDARD.decode(text).map_or(0, |bytes| bytes.len());
        let edges = recording.steps * recording.agents * recording.agents.div_ceil(8);
        let whole = ["x", "y", "heading"].iter().all(|key| recording.columns.contains_key(*key))
            && recording.columns.values().all(|column| bytes(&column.data) == 2 * rows)
            && bytes(&recording.status) == rows
            && recording.edges.as_ref().is_none_or(|text| bytes(text) == edges)
            && (recording.others.is_empty() || recording.others.len() == recording.steps)
            && recording.signals.iter().all(|signal| signal.states.len() == recording.steps)
            && !(recording.lanes.is_empty() && recording.zones.is_empty())
            && recording.zones.iter().all(|zone| zone.shape.len() > 2)
            && recording.lanes.iter().all(|lane| lane.shape.len() > 1);
        let lengths = [recording.step_length, recording.vehicle.length, recording.vehicle.width];
        if lengths.iter().any(|length| *length <= 0.0) {
            return Err(damaged("a step or a vehicle has no length".to_owned()));
        }
        if rows == 0 || !whole {
            return Err(damaged(
                "its columns do not have a number per step and agent, or it has neither lanes nor areas"
                    .to_owned(),
            ));
        }
        Ok(recording)
    }

    /// Writes the recording to a file.
    ///
    /// # Errors
    /// [`Error::Record`] if the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), Error> {
        Ok(record::write_atomic(path, self.json().as_bytes())?)
    }

    fn json(&self) -> String {
        serde_json::to_string(self).expect("a recording is plain data")
    }

    /// Returns a self-contained HTML file that plays the recording.
    pub fn player(&self) -> String {
        // The escape keeps text of the recording from closing the script element around it or
        // opening another one.
        let json = self.json().replace('<', "\\u003c");
        let (before, after) =
            PLAYER.split_once(HOLE).expect("the player has a place for the recording");
        format!("{before}{json}{after}")
    }

    /// Returns the sizes of the agents' vehicles at a step.
    fn sizes(&self, step: usize) -> Vec<Size> {
        let column = |key: &str| self.columns.get(key)?.values();
        let (lengths, widths) = (column("length"), column("width"));
        let first = step * self.agents;
        let of = |column: &Option<Vec<f64>>, i: usize, usual: f64| {
            column.as_ref().map_or(usual, |values| values[first + i])
        };
        let size = |i: usize| Size {
            length: of(&lengths, i, self.vehicle.length),
            width: of(&widths, i, self.vehicle.width),
        };
        (0..self.agents).map(size).collect()
    }

    /// Returns status and pose `[x, y, heading]` of every agent at a step.
    fn vehicles(&self, step: usize) -> Vec<(Status, [f64; 3])> {
        let status = STANDARD.decode(&self.status).unwrap_or_default();
        let columns: Vec<Vec<f64>> = ["x", "y", "heading"]
            .iter()
            .filter_map(|key| self.columns.get(*key)?.values())
            .collect();
        let first = step * self.agents;
        let vehicle =
            |i: usize| (Status::from(status[first + i]), [0, 1, 2].map(|c| columns[c][first + i]));
        (0..self.agents).map(vehicle).collect()
    }

    /// Returns where the agents have been until a step: for each vehicle, its consecutive
    /// positions. A vehicle that takes over the slot of another has a list of its own.
    fn tracks(&self, step: usize) -> Vec<Vec<[f64; 2]>> {
        let status = STANDARD.decode(&self.status).unwrap_or_default();
        let column = |key: &str| self.columns.get(key).and_then(Column::values).unwrap_or_default();
        let (x, y) = (column("x"), column("y"));
        let mut tracks = Vec::new();
        for agent in 0..self.agents {
            let places = (0..=step).map(|t| t * self.agents + agent).map(|i| {
                let there = Status::from(status[i]) != Status::Gone;
                there.then_some([x[i], y[i]])
            });
            let mut track: Vec<[f64; 2]> = Vec::new();
            for place in places.chain([None]) {
                let follows = match (place, track.last()) {
                    (Some([x, y]), Some([u, v])) => {
                        (x - u).hypot(y - v) < FASTEST * self.step_length
                    }
                    (place, last) => place.is_none() == last.is_none(),
                };
                if !follows {
                    tracks.push(std::mem::take(&mut track));
                }
                track.extend(place);
            }
        }
        tracks.retain(|track| track.len() > 1);
        tracks
    }

    /// Returns the communication links at a step, as pairs of receiver and sender.
    fn links(&self, step: usize) -> Vec<(usize, usize)> {
        let bytes =
            self.edges.as_ref().and_then(|text| STANDARD.decode(text).ok()).unwrap_or_default();
        let (n, width) = (self.agents, self.agents.div_ceil(8));
        let bit = |i: usize, j: usize| {
            bytes.get((step * n + i) * width + j / 8).is_some_and(|b| b >> (j % 8) & 1 == 1)
        };
        (0..n)
            .flat_map(|i| (0..n).map(move |j| (i, j)))
            .filter(|&(i, j)| i != j && bit(i, j))
            .collect()
    }
}

/// Status of an agent in a recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Status {
    Gone = 0,
    Driving = 1,
    Arrived = 2,
    Failed = 3,
}

impl From<u8> for Status {
    fn from(code: u8) -> Self {
        match code {
            1 => Self::Driving,
            2 => Self::Arrived,
            3 => Self::Failed,
            _ => Self::Gone,
        }
    }
}

/// An error of reading or writing a recording.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The file is not a recording.
    #[error("`{}` is no recording that `iwol evaluate --record` wrote: {why}", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Description of the damage.
        why: String,
    },
    /// The file cannot be read or written.
    #[error(transparent)]
    Record(#[from] record::Error),
}

#[cfg(test)]
mod tests {
    use super::*;

    pub(super) fn recording() -> Recording {
        let column = |values: [f64; 4]| Column::new("m", &values);
        Recording {
            format: FORMAT,
            scenario: "a</script><!--<script".to_owned(),
            policy: "p".to_owned(),
            seed: 1,
            episode: 0,
            step_length: 0.1,
            agents: 2,
            steps: 2,
            comm_range: Some(50.0),
            sight_range: Some(12.0),
            communicates: true,
            vehicle: Size { length: 4.5, width: 1.8 },
            lanes: vec![Lane {
                id: "a_0".to_owned(),
                width: 3.2,
                internal: false,
                crossing: false,
                shape: vec![[0.0, 0.0], [9.0, 0.0]],
            }],
            zones: Vec::new(),
            walls: vec![vec![[1.0, 3.0], [5.0, 3.0], [5.0, 6.0]]],
            columns: BTreeMap::from([
                ("x".to_owned(), column([1.0, 400.0, 2.0, f64::NAN])),
                ("y".to_owned(), column([0.0; 4])),
                ("heading".to_owned(), column([0.0, -3.1, 0.5, 1.0])),
            ]),
            status: STANDARD.encode([1, 2, 3, 0]),
            edges: Some(STANDARD.encode([0b10, 0, 0, 0b01])),
            others: vec![vec![[4.0, 0.0, 0.0, 7.1, 2.4, 0.0]], Vec::new()],
            signals: vec![Signal { line: [[9.0, 1.6], [9.0, -1.6]], states: "ry".to_owned() }],
            summary: BTreeMap::new(),
        }
    }

    #[test]
    fn columns_keep_their_numbers_to_four_digits() {
        let values = [0.0, -0.123_4, 22.222_2, 399.99, f64::NAN];
        for (found, expected) in Column::new("m", &values).values().unwrap().iter().zip(values) {
            let close = (found - expected).abs() <= 400.0 / 32_000.0 / 2.0 + 1e-9;
            assert!(close || (found.is_nan() && expected.is_nan()), "{found} {expected}");
        }
    }

    #[test]
    fn a_recording_survives_its_file_and_damage_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("r.json");
        recording().save(&path).unwrap();
        let loaded = Recording::load(&path).unwrap();
        assert_eq!(loaded, recording());
        assert_eq!(loaded.links(0), [(0, 1)]);
        assert_eq!(loaded.links(1), [(1, 0)]);
        assert_eq!(loaded.vehicles(1)[0].0, Status::Failed);
        assert!(loaded.tracks(0).is_empty(), "one position is no way");
        let tracks = loaded.tracks(1);
        assert_eq!((tracks.len(), tracks[0].len()), (1, 2), "{tracks:?}: the other one has left");
        let text = std::fs::read_to_string(&path).unwrap();
        for (from, to) in [
            ("\"format\":1", "\"format\":7"),
            ("\"steps\":2", "\"steps\":3"),
            ("{", "["),
            ("\"agents\":2", "\"agents\":0"),
            ("\"ry\"", "\"r\""),
            ("\"step_length\":0.1", "\"step_length\":0.0"),
            ("\"length\":4.5", "\"length\":0.0"),
        ] {
            std::fs::write(&path, text.replacen(from, to, 1)).unwrap();
            let error = Recording::load(&path).unwrap_err();
            assert!(
                matches!(error, Error::Damaged { .. }) && error.to_string().contains("r.json"),
                "{error}"
            );
        }
    }

    #[test]
    fn names_cannot_break_out_of_the_player() {
        let html = recording().player();
        assert_eq!(html.matches("</script").count(), PLAYER.matches("</script").count());
        assert_eq!(html.matches("<!--").count(), PLAYER.matches("<!--").count());
        assert!(html.contains("a\\u003c/script>") && !html.contains(HOLE));
    }
}
