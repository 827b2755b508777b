//! The page of all metrics.

use std::fmt::Write as _;

use super::metric::better;
use super::{Shown, all, own};

/// Returns the reference of all metrics as Markdown: `docs/reference/metrics.md`.
pub fn reference() -> String {
    let mut text = String::from(
        "# Metrics\n\nWhat `iwol evaluate` measures, each as a mean with its 95 % interval. The key is that of the \
         JSON output, in which shares go from 0 to 1. Learning curves and all reports show the metrics that are \
         shown everywhere; reports show the metrics of reports if results contain them. Shares of agents are over \
         the episodes in which an agent arrived, failed or was unfinished; where agents come from route files, there \
         may be others.\n\n\
         | metric | key | better | shown | meaning |\n|---|---|---|---|---|\n",
    );
    for metric in all() {
        let better = better(metric.better);
        let shown = match metric.shown {
            Shown::Everywhere => "everywhere",
            Shown::InFigures => "tables and figures of reports",
            Shown::InTables => "tables of reports",
            Shown::InEvaluations => "evaluations",
        };
        let (heading, id) = (metric.heading(), metric.id);
        let meaning = metric.explanation;
        let _ = writeln!(text, "| {heading} | `{id}` | {better} | {shown} | {meaning} |");
    }
    text + &own::reference()
}
