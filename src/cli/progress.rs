//! The progress of a training, for people.

use std::sync::mpsc::{RecvTimeoutError, channel};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

use crate::train::{Activity, Present, Report, Stage, human_duration};

/// Least time between two lines about finished iterations.
const BETWEEN_LINES: Duration = Duration::from_secs(10);
/// Time without a line after which a line says what the training is doing.
const SILENCE: Duration = Duration::from_secs(60);
/// The same for the bar in a terminal.
const SILENT_BAR: Duration = Duration::from_secs(5);

/// The progress of a training on standard error: a bar in a terminal, else lines.
pub(super) struct ProgressView {
    bar: ProgressBar,
    terminal: bool,
    /// Number of worlds, each of which takes a step at a time.
    worlds: u64,
    steps: u64,
    state: Mutex<State>,
}

/// What was shown last.
struct State {
    step: u64,
    message: String,
    shown: Instant,
}

impl ProgressView {
    /// Creates a view of a training that ends after `steps` environment steps, of which `begun` are
    /// done.
    pub(super) fn new(steps: u64, begun: u64, worlds: usize, terminal: bool) -> Self {
        let bar = ProgressBar::new(steps);
        bar.set_style(
            ProgressStyle::with_template(
                "{bar:30} {human_pos}/{human_len} steps  {msg}  ETA {eta}",
            )
            .expect("a valid template"),
        );
        bar.set_position(begun);
        bar.reset_eta();
        let state = State { step: begun, message: String::new(), shown: Instant::now() };
        Self { bar, terminal, worlds: worlds as u64, steps, state: Mutex::new(state) }
    }

    /// Does the work of a training, whose reports come to the function that it gets, and shows what
    /// goes on meanwhile. The view ends with the work.
    pub(super) fn beside<R>(
        self,
        activity: &Activity,
        work: impl FnOnce(&dyn Fn(&Report)) -> R,
    ) -> R {
        let result = std::thread::scope(|scope| {
            let (end, ended) = channel::<()>();
            let view = &self;
            scope.spawn(move || {
                // The sender is dropped at the end of the work, also by a panic.
                while ended.recv_timeout(Duration::from_secs(1)) == Err(RecvTimeoutError::Timeout) {
                    if let Some(present) = activity.present() {
                        view.remind(&present);
                    }
                }
            });
            let result = work(&|report| view.show(report));
            drop(end);
            result
        });
        self.bar.finish_and_clear();
        result
    }

    /// Shows a finished iteration.
    fn show(&self, report: &Report) {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let percent = |share: Option<f64>| {
            share.map_or_else(|| "-".to_owned(), |s| format!("{:.1} %", 100.0 * s))
        };
        state.step = report.step;
        state.message = format!(
            "{:.0} steps/s  success {} (validation {})",
            report.steps_per_second,
            percent(report.training_success),
            percent(report.validation_success)
        );
        if self.terminal {
            self.bar.set_position(report.step);
            self.bar.set_message(state.message.clone());
            state.shown = Instant::now();
        } else if state.shown.elapsed() > BETWEEN_LINES || report.step >= self.steps {
            say!("{:>9} steps  {}", state.step, state.message);
            state.shown = Instant::now();
        }
    }

    /// Shows what the training is doing, if nothing has been shown for long.
    fn remind(&self, present: &Present) {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let silence = state.shown.elapsed();
        if self.terminal && silence > SILENT_BAR {
            self.bar.set_message(format!("{}  {}", state.message, self.describe(present)));
        } else if !self.terminal && silence > SILENCE {
            say!("{:>9} steps  {}", state.step, self.describe(present));
            state.shown = Instant::now();
        }
    }

    fn describe(&self, present: &Present) -> String {
        let stage = match present.stage {
            Stage::Rollout => format!("rollout: {} steps", present.count * self.worlds),
            // Before its first gradient step, an update computes values and advantages. MADDPG does
            // not count its steps.
            Stage::Update if present.count == 0 => "update".to_owned(),
            Stage::Update => format!("update: gradient step {}", present.count),
            Stage::Validation => "validation".to_owned(),
        };
        format!("{stage} ({} so far)", human_duration(present.elapsed()))
    }
}
