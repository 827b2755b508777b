//! The progress of a sweep, as a table for the user.

use std::fmt::Write as _;
use std::time::Duration;

use crate::sweep::{Cell, State, Sweep};
use crate::train::human_duration;
use crate::words::counted;

/// Formats one line per cell, and the time that the remaining cells will take.
pub(super) fn table(sweep: &Sweep, cells: &[(usize, &Cell)]) -> String {
    let width = cells.iter().map(|(_, cell)| cell.id.len()).max().unwrap_or(0).max(4);
    let mut text = format!(
        "{:>6}  {:width$}  {:22} {:>10} {:>9}\n",
        "number", "cell", "state", "steps", "minutes"
    );
    for (number, cell) in cells {
        let (state, trained) = (cell.state(&sweep.evaluations), cell.trained());
        let steps = trained.as_ref().map_or_else(|| cell.steps(), |t| t.steps);
        let minutes = trained.map_or_else(String::new, |t| format!("{:.1}", t.seconds / 60.0));
        let _ = write!(
            text,
            "{number:>6}  {:width$}  {:22} {steps:>10} {minutes:>9}",
            cell.id,
            name(&state)
        );
        if let Some(first) = sweep.waits_for(cell) {
            let _ = write!(text, "  waits for {}", first.id);
        }
        text.push('\n');
    }
    let count = |wanted: &dyn Fn(&State) -> bool| {
        cells.iter().filter(|(_, cell)| wanted(&cell.state(&sweep.evaluations))).count()
    };
    let (finished, failed) = (
        count(&|state| *state == State::Finished),
        count(&|state| matches!(state, State::Failed(_))),
    );
    let _ =
        writeln!(text, "{finished} of {} finished, {failed} failed", counted(cells.len(), "cell"));
    if finished + failed < cells.len() {
        let left = time_left(sweep, cells).map_or_else(
            || "unknown until the first cell is trained".to_owned(),
            |t| human_duration(t) + " of training, one cell at a time",
        );
        let _ = writeln!(text, "time left: {left}");
    }
    text
}

fn name(state: &State) -> String {
    match state {
        State::New => "new".to_owned(),
        State::Partial(_) => "partly trained".to_owned(),
        State::Trained(missing) => format!("trained, {missing} to evaluate"),
        State::Finished => "finished".to_owned(),
        State::Failed(_) => "failed".to_owned(),
    }
}

/// Estimates the remaining training time of `cells`. An untrained cell is expected to take as long
/// as the mean of the most similar trained cells; `None` if no cell is trained.
pub(super) fn time_left(sweep: &Sweep, cells: &[(usize, &Cell)]) -> Option<Duration> {
    let trained: Vec<(&Cell, f64)> =
        sweep.cells.iter().filter_map(|cell| Some((cell, cell.trained()?.seconds))).collect();
    let expected = |cell: &Cell| {
        let alike: [&dyn Fn(&Cell) -> bool; 3] = [
            &|other| {
                other.config.algorithm == cell.config.algorithm
                    && other.config.agents == cell.config.agents
            },
            &|other| other.config.algorithm == cell.config.algorithm,
            &|_| true,
        ];
        alike.iter().find_map(|alike| {
            let seconds: Vec<f64> =
                trained.iter().filter(|(other, _)| alike(other)).map(|(_, s)| *s).collect();
            (!seconds.is_empty()).then(|| seconds.iter().sum::<f64>() / seconds.len() as f64)
        })
    };
    let open = cells.iter().filter(|(_, cell)| {
        matches!(cell.state(&sweep.evaluations), State::New | State::Partial(_))
    });
    let seconds: Option<f64> =
        open.map(|(_, cell)| Some((expected(cell)? - cell.seconds()).max(0.0))).sum();
    seconds.map(Duration::from_secs_f64)
}
