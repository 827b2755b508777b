//! What a training tells while it runs: a report on each iteration, and what it is doing at
//! present, for a display that another thread updates, because an iteration or a validation can
//! take minutes.

use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Report on an iteration, for the caller of [`Trainer::run`](super::Trainer::run).
#[derive(Debug, Clone, Copy)]
pub struct Report {
    /// Environment steps so far.
    pub step: u64,
    /// Environment steps per second of the last iteration.
    pub steps_per_second: f64,
    /// Success rate of the episodes that ended in the last iteration, with exploration noise;
    /// `None` if none ended.
    pub training_success: Option<f64>,
    /// Success rate of the last validation in this call of [`Trainer::run`](super::Trainer::run);
    /// `None` before the first.
    pub validation_success: Option<f64>,
}

/// A part of a training.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// The worlds play a rollout; counted in steps of all worlds together.
    Rollout,
    /// The networks learn from a rollout; counted in gradient steps.
    Update,
    /// The policy plays validation episodes; not counted.
    Validation,
}

/// What a training is doing at present. Threads share it.
#[derive(Debug, Default)]
pub struct Activity(Mutex<Option<Present>>);

/// A stage that is under way.
#[derive(Debug, Clone, Copy)]
pub struct Present {
    /// The stage.
    pub stage: Stage,
    /// How much of the stage has begun, in the units of [`Stage`].
    pub count: u64,
    begin: Instant,
}

impl Present {
    /// Returns the wall time since the stage began.
    pub fn elapsed(&self) -> Duration {
        self.begin.elapsed()
    }
}

impl Activity {
    /// Returns the stage that is under way; `None` before the first one.
    pub fn present(&self) -> Option<Present> {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Begins a stage.
    pub(super) fn begin(&self, stage: Stage) {
        let present = Present { stage, count: 0, begin: Instant::now() };
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(present);
    }

    /// Counts one more unit of a stage, if it is the present one. Of a rollout beside an update
    /// nothing is counted.
    pub(super) fn count(&self, stage: Stage) {
        let mut present = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(present) = present.as_mut().filter(|present| present.stage == stage) {
            present.count += 1;
        }
    }
}
