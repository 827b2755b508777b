//! Figures of a report.

use std::path::Path;

use super::block::{Block, Line, Unit, references, scores};
use super::{Error, in_words};
use crate::curves::{self, Along, Curve};
use crate::metrics::{Metric, SUCCESS, Shown};
use crate::plot::{Panel, Series, Style, figure};
use crate::scenario;
use crate::stats::aggregate::performance_profile;
use crate::sweep::{Reference, Sweep};

/// Width and height of a panel \[pixels\].
const PANEL: (u32, u32) = (640, 560);

/// Draws the metrics along the axis, or only success in one panel per value of `panels`. Lines are
/// shifted a little sideways, so that no interval hides another; published values are dashed.
pub(super) fn results(path: &Path, sweep: &Sweep, block: &Block<'_>) -> Result<(), Error> {
    let mut names: Vec<&str> = Vec::new();
    for (_, name) in block.series.iter().filter_map(|line| line.panel.as_ref()) {
        if !names.contains(&name.as_str()) {
            names.push(name);
        }
    }
    let panels: Vec<Panel> = if names.is_empty() {
        block.metrics(Shown::InFigures).map(|metric| panel(sweep, block, metric, None)).collect()
    } else {
        names.into_iter().map(|name| panel(sweep, block, SUCCESS, Some(name))).collect()
    };
    Ok(figure(path, "", &panels, PANEL)?)
}

fn panel(sweep: &Sweep, block: &Block<'_>, metric: &Metric, name: Option<&str>) -> Panel {
    let lines: Vec<(&str, &Line<'_>)> = (block.series.iter())
        .filter_map(|line| match (&line.panel, name) {
            (Some((label, own)), Some(name)) => (own == name).then_some((label.as_str(), line)),
            _ => Some((line.label.as_str(), line)),
        })
        .collect();
    let count = lines.len();
    let unit = block.unit();
    if block.x.is_none() && count > 1 {
        return side_by_side(
            &lines,
            &references(sweep, block, metric).collect::<Vec<_>>(),
            metric,
            unit,
        );
    }
    // A line between two places says that there is something in between, as between two numbers.
    let is_scale = block.categories.iter().all(|place| place.parse::<f64>().is_ok());
    let joined = |points| if is_scale { points } else { apart(points) };
    let mut series: Vec<Series> = Vec::new();
    for (k, (label, line)) in lines.iter().enumerate() {
        let dodge = dodge(k, count, block.categories.len());
        let places = line
            .rows
            .iter()
            .enumerate()
            .filter_map(|(x, row)| Some((x as f64 + dodge, row.estimate(metric, unit)?)));
        let (points, band) = places.map(|(x, e)| ((x, e.mean), (x, e.low, e.high))).unzip();
        series.push(Series {
            label: (*label).to_owned(),
            points: joined(points),
            band: Some(band),
            style: Style::Whiskers,
        });
    }
    for (reference, points) in references(sweep, block, metric) {
        // Published values get the same shift as the line that they are compared with.
        let partner = lines.iter().position(|(label, _)| *label == reference.beside);
        let aside = partner.map_or(0.0, |k| dodge(k, count, block.categories.len()));
        let points = points.into_iter().map(|(x, y)| (x as f64 + aside, y)).collect();
        series.push(Series {
            label: reference.label.clone(),
            points: joined(points),
            band: None,
            style: Style::Beside(reference.beside.clone()),
        });
    }
    // All panels of a metric have the same scale.
    let of_all = |line: &Line<'_>| {
        let estimates = line.rows.iter().filter_map(|row| row.estimate(metric, unit));
        estimates.flat_map(|e| [e.mean, e.low]).collect::<Vec<_>>()
    };
    let all = block
        .series
        .iter()
        .flat_map(of_all)
        .chain(series.iter().flat_map(|s| s.points.iter().map(|p| p.1)));
    Panel {
        title: name.unwrap_or(metric.title).to_owned(),
        x_label: block.x.as_deref().map_or_else(String::new, axis_label),
        y_label: metric.axis.to_owned(),
        y_range: scale(metric, all),
        categories: if block.x.is_some() { block.categories.clone() } else { vec![String::new()] },
        series,
        ..Panel::default()
    }
}

/// Returns the points with a NaN after each, which keeps the plot from joining them by a line.
fn apart(points: Vec<(f64, f64)>) -> Vec<(f64, f64)> {
    points.into_iter().flat_map(|point| [point, (f64::NAN, f64::NAN)]).collect()
}

/// Draws the lines side by side, each at its own place of the axis with its name below.
fn side_by_side(
    lines: &[(&str, &Line<'_>)],
    published: &[(&Reference, Vec<(usize, f64)>)],
    metric: &Metric,
    unit: Unit,
) -> Panel {
    const HERE: &str = "this sweep";
    let found = lines
        .iter()
        .enumerate()
        .filter_map(|(x, (_, line))| Some((x as f64, line.rows[0].estimate(metric, unit)?)));
    let (points, band): (Vec<_>, Vec<_>) =
        found.map(|(x, e)| ((x, e.mean), (x, e.low, e.high))).unzip();
    // Published values are drawn next to the line that they belong to, otherwise at a place of
    // their own.
    let mut categories: Vec<String> = lines.iter().map(|(label, _)| (*label).to_owned()).collect();
    let mut known: Vec<(f64, f64)> = Vec::new();
    for (reference, values) in published.iter().filter(|(_, values)| !values.is_empty()) {
        let partner = lines.iter().position(|(own, _)| *own == reference.beside);
        let mut x = partner.map_or(categories.len() as f64, |line| line as f64 + 0.25);
        if partner.is_none() {
            categories.push(reference.label.clone());
        }
        while known.iter().any(|point| (point.0 - x).abs() < 0.01) {
            x += 0.1;
        }
        known.extend(values.iter().map(|(_, y)| (x, *y)));
    }
    let ends = band.iter().map(|&(_, low, _)| low);
    let y_range = scale(metric, points.iter().chain(&known).map(|point| point.1).chain(ends));
    let here = Series {
        label: HERE.to_owned(),
        points: apart(points),
        band: Some(band),
        style: Style::Whiskers,
    };
    let there = Series {
        label: "published".to_owned(),
        points: apart(known.clone()),
        band: None,
        style: Style::Beside(HERE.to_owned()),
    };
    Panel {
        title: metric.title.to_owned(),
        y_label: metric.axis.to_owned(),
        y_range,
        categories,
        series: if known.is_empty() { vec![here] } else { vec![here, there] },
        ..Panel::default()
    }
}

/// Returns the ends of the axis of a rate; `None` for other metrics. The axis begins at 85 % if all
/// values and lower ends of intervals exceed 90 %, because the differences then lie in the last
/// percent. A single seed has no interval.
fn scale(metric: &Metric, values: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    let lowest = values.filter(|value| value.is_finite()).fold(f64::INFINITY, f64::min);
    metric.is_rate().then_some((if lowest > 90.0 { 85.0 } else { 0.0 }, 100.0))
}

/// Returns the shift of line `k` of `count`, as a fraction of the distance between two of the
/// `places`.
fn dodge(k: usize, count: usize, places: usize) -> f64 {
    let step = if places == 1 { 0.6 } else { 0.5 } / count as f64;
    (k as f64 - (count as f64 - 1.0) / 2.0) * if places == 1 { step } else { step.min(0.08) }
}

/// Returns the label of the axis for a key, with its unit if it is an attribute of a scenario that
/// has one.
fn axis_label(key: &str) -> String {
    match key {
        "agents" => return "vehicles".to_owned(),
        "scenario.observation.neighbours" => return "observed vehicles".to_owned(),
        _ => {}
    }
    let unit = key.strip_prefix("scenario.").and_then(|attribute| {
        let (element, name) = attribute.split_once('.')?;
        let element = scenario::describe().all().into_iter().find(|e| e.name == element)?;
        element.attribute(name)?.unit.clone()
    });
    let name = in_words(key);
    unit.map_or_else(|| name.clone(), |unit| format!("{name} ({unit})"))
}

/// Draws performance profiles of the lines that have all their results. Returns `false`, and draws
/// nothing, if these are fewer than two.
pub(super) fn profile(path: &Path, block: &Block<'_>) -> Result<bool, Error> {
    let thresholds: Vec<f64> = (0..=100).map(f64::from).collect();
    let series: Vec<Series> = (block.series.iter())
        .filter(|line| line.is_whole(SUCCESS))
        .map(|line| {
            let shares = performance_profile(&scores(line, SUCCESS), &thresholds);
            let points =
                thresholds.iter().zip(shares).map(|(t, share)| (*t, 100.0 * share)).collect();
            Series::curve(line.label.clone(), points, None)
        })
        .collect();
    if series.len() < 2 {
        return Ok(false);
    }
    let panel = Panel {
        title: "Performance profile".to_owned(),
        x_label: "success τ (%)".to_owned(),
        y_label: "runs above τ (%)".to_owned(),
        y_range: Some((0.0, 100.0)),
        series,
        ..Panel::default()
    };
    figure(path, "", &[panel], (760, 520))?;
    Ok(true)
}

/// Draws validation success of the trained cells against environment steps: one panel per value of
/// the axis. Returns `false` if there is no curve.
pub(super) fn learning_curves(path: &Path, block: &Block<'_>) -> Result<bool, Error> {
    let mut panels = Vec::new();
    for (place, category) in block.categories.iter().enumerate() {
        let mut series = Vec::new();
        for line in &block.series {
            let curves = validations(line, place)?;
            if !curves.is_empty() {
                series.push(curves::mean_curve(line.label.clone(), &curves, Along::Steps, SUCCESS));
            }
        }
        let name = |x: &String| format!("{category} {}", axis_label(x));
        panels.push(Panel {
            title: block.x.as_ref().map(name).unwrap_or_default(),
            x_label: Along::Steps.label().to_owned(),
            y_label: "validation success (%)".to_owned(),
            y_range: Some((0.0, 100.0)),
            series,
            ..Panel::default()
        });
    }
    panels.retain(|panel| !panel.series.is_empty());
    if panels.is_empty() {
        return Ok(false);
    }
    let width = if panels.len() == 1 { 700 } else { 560 };
    figure(path, "", &panels, (width, 520))?;
    Ok(true)
}

/// Returns the curves of the trained runs at a place.
fn validations(line: &Line<'_>, place: usize) -> Result<Vec<Curve>, Error> {
    let mut found = Vec::new();
    for (cell, _) in line.rows[place].runs.iter().filter(|(cell, _)| cell.trained().is_some()) {
        let lines = curves::read(&cell.run().metrics())?;
        found.push(curves::curve(&lines, Along::Steps, SUCCESS, curves::Line::validation));
    }
    found.retain(|curve| !curve.is_empty());
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::axis_label;

    #[test]
    fn axes_name_the_unit_of_what_they_show() {
        for (key, label) in [
            ("agents", "vehicles"),
            ("scenario.communication.range", "communication range (m)"),
            ("scenario.observation.detectionRange", "observation detection range (m)"),
            ("scenario.observation.intention", "observation intention"),
            ("channel.loss", "loss"),
        ] {
            assert_eq!(axis_label(key), label);
        }
    }
}
