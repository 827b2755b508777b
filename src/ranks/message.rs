//! What a rank tells the others after a step of its worlds.

use serde::{Deserialize, Serialize};

use crate::env::{EpisodeRecord, Frame, WorldPhase, Worlds};

/// What has come of a rank's worlds.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Told {
    /// Whether this rank was asked to stop.
    pub(super) stop: bool,
    /// The error that keeps the worlds from going on.
    pub(super) error: Option<String>,
    pub(super) worlds: Vec<Place>,
    /// Lengths of a frame's arrays.
    pub(super) lengths: [usize; 10],
    pub(super) finished: Vec<Finished>,
}

/// Where a world is in its episodes.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub(super) struct Place {
    pub(super) episode: u64,
    pub(super) step: u32,
    phase: u8,
    interrupted: bool,
}

const PHASES: [WorldPhase; 4] =
    [WorldPhase::Idle, WorldPhase::Between, WorldPhase::Running, WorldPhase::Ended];

impl Place {
    pub(super) fn phase(&self) -> WorldPhase {
        PHASES[usize::from(self.phase)]
    }
}

/// A record with the parts that its file does not have.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Finished {
    record: EpisodeRecord,
    step_rewards: Vec<f32>,
    repeated: bool,
}

impl From<EpisodeRecord> for Finished {
    fn from(mut record: EpisodeRecord) -> Self {
        let step_rewards = std::mem::take(&mut record.step_rewards);
        Self { repeated: record.repeated, step_rewards, record }
    }
}

impl From<Finished> for EpisodeRecord {
    fn from(Finished { record, step_rewards, repeated }: Finished) -> Self {
        Self { repeated, step_rewards, ..record }
    }
}

/// The arrays of a frame, in the order in which they are sent.
fn arrays(frame: &mut Frame) -> [&mut Vec<f32>; 10] {
    let Frame { observation, state, comm, available, active, start, reward, sharing, .. } = frame;
    let Frame { terminated, truncated, .. } = frame;
    [observation, state, comm, available, active, start, reward, sharing, terminated, truncated]
}

/// Returns the bytes of a message: the length of the first part, that part, and the frames' numbers.
pub(super) fn encoded(mut told: Told, worlds: &dyn Worlds) -> Vec<u8> {
    let mut numbers: Vec<u8> = Vec::new();
    for e in 0..worlds.count() {
        let view = worlds.view(e);
        let phase = PHASES.iter().position(|phase| *phase == view.phase).unwrap_or(0) as u8;
        let interrupted = view.frame.interrupted;
        told.worlds.push(Place { episode: view.episode, step: view.step, phase, interrupted });
        let mut frame = view.frame.clone();
        for (array, length) in arrays(&mut frame).into_iter().zip(&mut told.lengths) {
            *length = array.len();
            numbers.extend_from_slice(bytemuck::cast_slice(array));
        }
    }
    let mut first = Vec::new();
    ciborium::into_writer(&told, &mut first).expect("memory can be written");
    let length = (first.len() as u64).to_ne_bytes();
    [&length[..], &first, &numbers].concat()
}

/// Reads a message; the frames' numbers go into `frames`, one for each of the rank's worlds.
pub(super) fn decoded(bytes: &[u8], frames: &mut [Frame]) -> Told {
    let (length, rest) = bytes.split_at(8);
    let length = u64::from_ne_bytes(length.try_into().expect("eight bytes")) as usize;
    let (first, rest) = rest.split_at(length);
    let told: Told = ciborium::from_reader(first).expect("a message of this program");
    // Copied, because the bytes may not be aligned for numbers.
    let numbers: Vec<f32> = bytemuck::allocation::pod_collect_to_vec(rest);
    let mut rest = &numbers[..];
    for (frame, place) in frames.iter_mut().zip(&told.worlds) {
        frame.interrupted = place.interrupted;
        for (array, length) in arrays(frame).into_iter().zip(told.lengths) {
            let (first, others) = rest.split_at(length);
            array.clear();
            array.extend_from_slice(first);
            rest = others;
        }
    }
    told
}
