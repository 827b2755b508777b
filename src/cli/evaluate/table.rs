//! The table of `iwol evaluate`.

use std::fmt::Write as _;

use crate::evaluate::DETERMINED;
use crate::metrics::{self, Better, EvaluationResult, Knowledge, Metric};
use crate::words::counted;

/// Describes how much of the variance of a target a latent explains: of the whole target, and of
/// the features that the observation does not determine.
fn describe(Knowledge { name, error, explained, probe }: &Knowledge) -> String {
    let percent = |share: f64| format!("{:.1} %", 100.0 * share);
    let whole = format!(
        "{} of the variance of the {name} target (mean squared error {error:.4})",
        percent(*explained)
    );
    let Some(probe) = probe else {
        return format!(
            "{whole}; there are too few episodes for a linear probe from the observation"
        );
    };
    let (Some(own), Some(probed)) =
        (probe.undetermined_explained, probe.undetermined_probe_explained)
    else {
        return format!("{whole}; the observation determines all {} features", probe.features);
    };
    format!(
        "{whole}; the observation does not determine {} of {} features (a linear probe from the observation explains less \
         than {:.0} % of their variance): of the variance of these features, the latent explains {} and the probe {}",
        probe.undetermined,
        probe.features,
        100.0 * DETERMINED,
        percent(own),
        percent(probed)
    )
}

/// Lists the episodes in which not every agent succeeded, for `--record-episode`; `None` without
/// any.
fn failed_episodes(row: &EvaluationResult) -> Option<String> {
    const SHOWN: usize = 12;
    let failed = &row.failed_episodes;
    let shown: Vec<String> = failed.iter().take(SHOWN).map(u64::to_string).collect();
    let first = shown.first()?;
    let more = if failed.len() > SHOWN { ", …" } else { "" };
    Some(format!(
        "in {} of {}: {}{more} (to record one: --record FILE --record-episode {first})",
        failed.len(),
        counted(row.episodes, "episode"),
        shown.join(", ")
    ))
}

/// Formats all policies side by side: one metric per line, with mean and 95 % interval per policy.
pub(super) fn table(rows: &[EvaluationResult]) -> String {
    // Counts of vehicles or pedestrians that are always 0, and the effects on them, are left out.
    let own = metrics::own(rows.iter().map(|row| &row.metrics));
    let lines: Vec<&Metric> = metrics::all()
        .chain(own)
        .filter(|metric| {
            rows.iter()
                .filter_map(|row| metric.estimate(&row.metrics))
                .any(|estimate| metric.better != Better::Neither || estimate.mean != 0.0)
        })
        .collect();
    let headings = lines.iter().map(|metric| metric.heading());
    let mut columns: Vec<Vec<String>> =
        vec![std::iter::once(String::new()).chain(headings).collect()];
    for row in rows {
        let cells = lines.iter().map(|metric| {
            let digits = metric.scale.digits;
            let estimate = metric.estimate(&row.metrics);
            estimate.map_or_else(|| "–".to_owned(), |estimate| format!("{estimate:.digits$}"))
        });
        columns.push(std::iter::once(row.policy.clone()).chain(cells).collect());
    }
    let width =
        |column: &[String]| column.iter().map(|cell| cell.chars().count()).max().unwrap_or(0);
    let mut text = String::new();
    if let Some(first) = rows.first() {
        let _ = writeln!(
            text,
            "{}, {}, {}, seed {}: mean [95 % interval]",
            first.scenario,
            first.learners.map_or_else(
                || counted(first.agents, "agent"),
                |learners| format!(
                    "{} among {} at spawn places",
                    counted(learners, "agent"),
                    counted(first.agents, "vehicle")
                )
            ),
            counted(first.episodes, "episode"),
            first.seed
        );
    }
    for line in 0..=lines.len() {
        for (i, column) in columns.iter().enumerate() {
            let (cell, width) = (&column[line], width(column));
            let _ = if i == 0 {
                write!(text, "{cell:<width$}")
            } else {
                write!(text, "   {cell:>width$}")
            };
        }
        text.push('\n');
    }
    for (row, known) in rows.iter().filter_map(|row| Some((row, row.metrics.counted?))) {
        let _ = writeln!(
            text,
            "{}: in {} of {} no agent counts, because none came or all came too late; shares of agents are over the others",
            row.policy,
            row.episodes.saturating_sub(known),
            counted(row.episodes, "episode")
        );
    }
    for row in rows.iter().filter(|row| !row.metrics.reconstruction.is_empty()) {
        for known in &row.metrics.reconstruction {
            let _ = writeln!(text, "latent of {}: explains {}", row.policy, describe(known));
        }
    }
    let driving = || rows.iter().filter_map(|row| Some((row, row.metrics.driving.as_ref()?)));
    for row in rows {
        if let Some(episodes) = failed_episodes(row) {
            let _ = writeln!(text, "failures of {}: {episodes}", row.policy);
        }
        for line in row.metrics.driving.iter().flat_map(|metrics| metrics.failures.describe()) {
            let _ = writeln!(text, "failures of {}: {line}", row.policy);
        }
    }
    for (row, metrics) in driving() {
        let audit = &metrics.audit;
        if audit.differences().is_empty() {
            continue;
        }
        if !row.audited {
            let _ = writeln!(
                text,
                "audit of {}: none, because SUMO did not check for collisions in junctions (simulation.audit)",
                row.policy
            );
            continue;
        }
        let _ = writeln!(
            text,
            "audit of {}: {:>5} colliding pairs are in both reports",
            row.policy, audit.agreed
        );
        let indent = "audit of : ".len() + row.policy.chars().count();
        for (reason, count) in audit.differences() {
            let _ = writeln!(text, "{:indent$}{count:>5} {reason}", "");
        }
    }
    text
}
