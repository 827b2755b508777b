//! Plots of curves, and of points with intervals, as PNG pictures.
//!
//! A figure is a row of panels that share one legend below them; a label has the same colour in
//! every panel. Names of horizontal reference lines (policies without training) stand at the right
//! margin, so that no text covers data. The font is part of the program, so nothing has to be
//! installed. Everything is drawn at three times the size and averaged down, because the bitmap
//! backend does not smooth all edges.

mod axis;
mod canvas;
mod picture;

use std::ops::Range;
use std::path::Path;

use plotters::prelude::*;

use axis::{Axis, enclosing, runs, usable};
use canvas::{Canvas, Drawn, FINE, Placement, averaged, line, provide_font, px, text_width, write};

pub use picture::{Picture, Rgb};

use crate::record;

/// One curve of a panel.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    /// Name in the legend; curves with the same name have the same colour in all panels.
    pub label: String,
    /// `(x, y)` in the order of `x`. A point with a NaN or infinity is left out and interrupts the
    /// line.
    pub points: Vec<(f64, f64)>,
    /// `(x, low, high)` in the order of `x`: shaded behind the line, for example a 95 % interval.
    /// Entries with a NaN or infinity (the interval of a single value) are left out.
    pub band: Option<Vec<(f64, f64, f64)>>,
    /// How the series is drawn.
    pub style: Style,
}

impl Series {
    /// Creates a curve with a shaded band.
    pub fn curve(
        label: String,
        points: Vec<(f64, f64)>,
        band: Option<Vec<(f64, f64, f64)>>,
    ) -> Self {
        Self { label, points, band, style: Style::Curve }
    }
}

/// How a series is drawn.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub enum Style {
    /// A line with a shaded band.
    #[default]
    Curve,
    /// A line through points whose intervals are drawn as whiskers, for a few places along the x
    /// axis.
    Whiskers,
    /// A dashed line in the colour of the series with this label, e.g. published values to compare
    /// that series with.
    Beside(String),
}

/// One pair of axes.
#[derive(Debug, Clone, PartialEq)]
pub struct Panel {
    /// Heading; may be empty.
    pub title: String,
    /// Label of the x axis, with its unit.
    pub x_label: String,
    /// Label of the y axis, with its unit.
    pub y_label: String,
    /// Ends of the y axis, bottom first; chosen from the data if `None` or not a proper range.
    /// Values outside are drawn at the edge.
    pub y_range: Option<(f64, f64)>,
    /// Names of the places 0, 1, … along the x axis; if empty, the axis is a numeric scale.
    pub categories: Vec<String>,
    /// The curves.
    pub series: Vec<Series>,
    /// Horizontal dashed lines: name and y. Lines outside `y_range` are not drawn.
    pub references: Vec<(String, f64)>,
}

/// An error of drawing or writing a figure.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The picture is too small to hold the panels, or larger than the limit.
    #[error(
        "cannot draw {panels} panel(s) on {width} x {height} pixels; each panel needs at least \
         {MIN_PANEL} x {MIN_PANEL}, the whole at most {MAX_SIDE} x {MAX_SIDE}"
    )]
    Size {
        /// Requested number of panels.
        panels: usize,
        /// Requested width \[pixels\].
        width: u32,
        /// Requested height \[pixels\].
        height: u32,
    },
    /// The drawing library failed.
    #[error("cannot draw the figure")]
    Draw(#[source] Box<dyn std::error::Error + Send + Sync>),
    /// The file could not be written.
    #[error(transparent)]
    Write(#[from] record::Error),
}

/// Minimum width and height per panel \[pixels\].
const MIN_PANEL: u32 = 280;
/// Maximum width and height of a figure \[pixels\].
const MAX_SIDE: u32 = 4096;

// Letter heights in pixels of the picture.
const TITLE: i32 = 28;
const HEADING: i32 = 24;
const TEXT: i32 = 21;
const TICK: i32 = 19;

/// The colours of Okabe and Ito, which people with any colour vision can tell apart (without
/// yellow, which is too pale for a line on white), and four darker colours of Tol for figures with
/// all algorithms.
const PALETTE: [RGBColor; 11] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(0, 0, 0),
    RGBColor(136, 34, 85),
    RGBColor(153, 153, 51),
    RGBColor(51, 34, 136),
    RGBColor(136, 136, 136),
];
const INK: RGBColor = RGBColor(25, 25, 25);
const REFERENCE: RGBColor = RGBColor(70, 70, 70);
const GRID: RGBColor = RGBColor(226, 226, 226);

/// Maximum number of points of a line that also gets a dot at each point.
const DOTS_UP_TO: usize = 40;

/// Draws `panels` side by side under `title` and writes them as a PNG of `size` (width, height in
/// pixels) to `path`. The file appears complete or not at all.
///
/// Panels and series without a usable point are marked "no data".
///
/// # Errors
/// [`Error::Size`] for a size that cannot hold the panels, [`Error::Write`] if the file cannot be
/// written.
pub fn figure(path: &Path, title: &str, panels: &[Panel], size: (u32, u32)) -> Result<(), Error> {
    let (width, height) = size;
    let least_width =
        u32::try_from(panels.len().max(1)).map_or(u32::MAX, |n| n.saturating_mul(MIN_PANEL));
    if width < least_width || height < MIN_PANEL || width > MAX_SIDE || height > MAX_SIDE {
        return Err(Error::Size { panels: panels.len(), width, height });
    }
    provide_font().map_err(Error::Draw)?;
    let fine_size = (width * FINE, height * FINE);
    let mut fine = vec![u8::MAX; fine_size.0 as usize * fine_size.1 as usize * 3];
    draw(&BitMapBackend::with_buffer(&mut fine, fine_size).into_drawing_area(), title, panels)
        .map_err(|e| Error::Draw(e.into()))?;

    save(path, size, &fine)
}

/// Averages a drawing down to a picture of `size` and writes it as PNG to `path`. The file appears
/// complete or not at all.
fn save(path: &Path, size: (u32, u32), fine: &[u8]) -> Result<(), Error> {
    let file = record::temporary_beside(path, ".png")?;
    let mut picture = BitMapBackend::new(file.path(), size);
    picture
        .blit_bitmap((0, 0), size, &averaged(fine, size.0 as usize))
        .map_err(|e| Error::Draw(e.into()))?;
    picture.present().map_err(|e| Error::Draw(e.into()))?;
    drop(picture);
    Ok(record::replace(file, path)?)
}

fn draw(canvas: &Canvas, title: &str, panels: &[Panel]) -> Drawn {
    let width = canvas.dim_in_pixel().0 as i32;
    let mut top = px(12);
    if !title.is_empty() {
        write(canvas, title, TITLE, INK, Placement::Centred, (width / 2, top + px(TITLE) / 2))?;
        top += px(TITLE + 10);
    }
    let mut labels: Vec<&str> = Vec::new();
    for series in panels.iter().flat_map(|panel| &panel.series) {
        if !labels.contains(&series.label.as_str()) {
            labels.push(&series.label);
        }
    }
    let bottom = draw_legend(canvas, panels, &labels)?;
    let count = panels.len().max(1) as i32;
    for (number, panel) in (0..count).zip(panels) {
        let area =
            Area { left: width * number / count, right: width * (number + 1) / count, top, bottom };
        draw_panel(canvas, area, panel, &|label| color_of(label, panels, &labels))?;
    }
    canvas.present()
}

/// One entry of the legend: index of its label, text, width in drawn pixels.
type Entry = (usize, String, i32);

/// Draws the legend at the bottom, in as many rows as it needs, and returns the y of its upper
/// edge.
fn draw_legend(canvas: &Canvas, panels: &[Panel], labels: &[&str]) -> Drawn<i32> {
    const SWATCH: i32 = px(34);
    const GAP: i32 = px(9);
    const BETWEEN: i32 = px(34);
    const ROW: i32 = px(TEXT + 9);
    let (width, height) = canvas.dim_in_pixel();
    let (width, height) = (width as i32, height as i32);
    let mut rows: Vec<(i32, Vec<Entry>)> = Vec::new();
    for (index, &label) in labels.iter().enumerate().filter(|(_, label)| !label.is_empty()) {
        let mut same_label =
            panels.iter().flat_map(|panel| &panel.series).filter(|series| series.label == label);
        let empty =
            !same_label.any(|series| series.points.iter().any(|&(x, y)| usable(x) && usable(y)));
        let text = if empty { format!("{label} (no data)") } else { label.to_owned() };
        let entry = SWATCH + GAP + text_width(canvas, &text, TEXT);
        match rows.last_mut() {
            Some((used, row)) if *used + BETWEEN + entry <= width - px(20) => {
                *used += BETWEEN + entry;
                row.push((index, text, entry));
            }
            _ => rows.push((entry, vec![(index, text, entry)])),
        }
    }
    let mut y = height - px(10) - ROW * rows.len() as i32;
    let top = y;
    for (used, row) in &rows {
        let mut x = (width - used) / 2;
        let middle = y + ROW / 2;
        for (index, text, entry) in row {
            let color = color_of(labels[*index], panels, labels);
            if is_scattered(labels[*index], panels) {
                dot(
                    canvas,
                    (x + SWATCH / 2, middle),
                    px(5),
                    color,
                    is_dashed(labels[*index], panels),
                )?;
            } else if is_dashed(labels[*index], panels) {
                dashed(canvas, (x, middle), (x + SWATCH, middle), color)?;
            } else {
                line(canvas, (x, middle), (x + SWATCH, middle), px(3), color)?;
            }
            write(canvas, text, TEXT, INK, Placement::RightOf, (x + SWATCH + GAP, middle))?;
            x += entry + BETWEEN;
        }
        y += ROW;
    }
    Ok(top)
}

fn series_called<'a>(label: &'a str, panels: &'a [Panel]) -> impl Iterator<Item = &'a Series> {
    panels.iter().flat_map(|panel| &panel.series).filter(move |series| series.label == label)
}

fn is_dashed(label: &str, panels: &[Panel]) -> bool {
    series_called(label, panels).any(|series| matches!(series.style, Style::Beside(_)))
}

/// Returns whether the series with this label consist of unconnected points, with more than one
/// point in some panel.
fn is_scattered(label: &str, panels: &[Panel]) -> bool {
    let alone = |series: &Series| {
        runs(series.points.iter().map(|p| (usable(p.0) && usable(p.1)).then_some(())))
            .iter()
            .all(|run| run.len() == 1)
    };
    series_called(label, panels).any(|series| series.points.len() > 1)
        && series_called(label, panels).all(alone)
}

/// Draws a point as a dot, or as a ring for values to compare with.
fn dot(canvas: &Canvas, at: (i32, i32), radius: i32, color: RGBColor, ring: bool) -> Drawn {
    canvas.draw(&Circle::new(at, radius, color.filled()))?;
    if ring { canvas.draw(&Circle::new(at, radius - px(3) / 2, WHITE.filled())) } else { Ok(()) }
}

/// Returns the colour of a label: that of its partner ([`Style::Beside`]), otherwise the next
/// colour of the palette. Dashed series do not use up colours of the palette.
fn color_of(label: &str, panels: &[Panel], labels: &[&str]) -> RGBColor {
    let beside = series_called(label, panels).find_map(|series| match &series.style {
        Style::Beside(other) => labels.iter().find(|known| **known == other.as_str()),
        _ => None,
    });
    let own = beside.copied().unwrap_or(label);
    let solid: Vec<&&str> =
        labels.iter().filter(|known| **known == own || !is_dashed(known, panels)).collect();
    PALETTE[solid.iter().position(|known| **known == own).unwrap_or(0) % PALETTE.len()]
}

/// Draws a dashed line as wide as a curve.
fn dashed(canvas: &Canvas, from: (i32, i32), to: (i32, i32), color: RGBColor) -> Drawn {
    const DASH: f64 = px(9) as f64;
    const GAP: f64 = px(6) as f64;
    let (dx, dy) = (f64::from(to.0 - from.0), f64::from(to.1 - from.1));
    let length = dx.hypot(dy).max(1.0);
    let at = |way: f64| {
        let share = (way / length).min(1.0);
        (from.0 + (dx * share).round() as i32, from.1 + (dy * share).round() as i32)
    };
    let mut way = 0.0;
    while way < length {
        line(canvas, at(way), at(way + DASH), LINE_WIDTH, color)?;
        way += DASH + GAP;
    }
    Ok(())
}

/// A rectangle in drawn pixels.
#[derive(Clone, Copy)]
struct Area {
    left: i32,
    right: i32,
    top: i32,
    bottom: i32,
}

fn draw_panel(
    canvas: &Canvas,
    area: Area,
    panel: &Panel,
    color: &dyn Fn(&str) -> RGBColor,
) -> Drawn {
    let (mut x_axis, y_axis) = (Axis::new(x_range(panel), 5), Axis::new(y_range(panel), 6));
    if !panel.categories.is_empty() {
        x_axis.ticks = (0..panel.categories.len()).map(|k| k as f64).collect();
    }
    let wrap_at = (area.right - area.left) / 5;
    let references: Vec<(f64, Vec<String>)> = (panel.references.iter())
        .filter(|(_, y)| y_axis.range.start <= *y && *y <= y_axis.range.end)
        .map(|(label, y)| (*y, wrapped(canvas, label, wrap_at)))
        .collect();
    let widest =
        |texts: &mut dyn Iterator<Item = &String>| texts.map(|t| text_width(canvas, t, TICK)).max();
    let tick_labels: Vec<String> = y_axis.ticks.iter().map(|y| y_axis.label(*y)).collect();
    let tick_width = widest(&mut tick_labels.iter()).unwrap_or(0);
    let reference_width = widest(&mut references.iter().flat_map(|(_, lines)| lines))
        .map_or(0, |w| w + px(LEADER + 4));
    let heading = if panel.title.is_empty() { 0 } else { px(HEADING + 8) };
    let widest_category = widest(&mut panel.categories.iter()).unwrap_or(0);
    // The limits keep the plot area from inverting, however long the labels are.
    let left =
        (area.left + px(TEXT + 34) + tick_width).min(area.left + (area.right - area.left) / 2);
    let plot = Area {
        left,
        right: (area.right - reference_width - px(14)).min(area.right - px(28)).max(left + px(60)),
        top: area.top + heading + px(4),
        bottom: 0,
    };
    // Names that do not fit side by side are written upwards.
    let upwards =
        widest_category * panel.categories.len() as i32 > (plot.right - plot.left) * 9 / 10;
    let names = if upwards { widest_category.min((area.bottom - area.top) / 2) } else { px(TICK) };
    let plot = Area {
        bottom: (area.bottom - names - px(if panel.x_label.is_empty() { 22 } else { TEXT + 32 }))
            .max(area.top + heading + px(64)),
        ..plot
    };
    let at = |x: f64, y: f64| {
        (x_axis.place(x, plot.left, plot.right), y_axis.place(y, plot.bottom, plot.top))
    };

    let middle = i32::midpoint(plot.left, plot.right);
    write(
        canvas,
        &panel.title,
        HEADING,
        INK,
        Placement::Centred,
        (middle, area.top + px(HEADING) / 2),
    )?;
    for (y, label) in y_axis.ticks.iter().map(|y| at(0.0, *y).1).zip(&tick_labels) {
        line(canvas, (plot.left, y), (plot.right, y), px(1), GRID)?;
        line(canvas, (plot.left - px(5), y), (plot.left, y), px(1), INK)?;
        write(canvas, label, TICK, INK, Placement::LeftOf, (plot.left - px(9), y))?;
    }

    for series in &panel.series {
        let band = series.band.iter().flatten();
        let usable_band = band.map(|&(x, low, high)| {
            (usable(x) && usable(low) && usable(high)).then_some((x, low, high))
        });
        for run in runs(usable_band) {
            if series.style == Style::Whiskers {
                for &(x, low, high) in &run {
                    whisker(canvas, at(x, low), at(x, high), color(&series.label))?;
                }
                continue;
            }
            let upper = run.iter().map(|&(x, _, high)| at(x, high));
            let lower = run.iter().rev().map(|&(x, low, _)| at(x, low));
            canvas.draw(&Polygon::new(
                upper.chain(lower).collect::<Vec<_>>(),
                color(&series.label).mix(0.2),
            ))?;
        }
    }
    for &(y, _) in &references {
        let y = at(0.0, y).1;
        for x in (plot.left..plot.right).step_by(px(13) as usize) {
            line(canvas, (x, y), ((x + px(8)).min(plot.right), y), px(3) / 2, REFERENCE)?;
        }
    }
    let mut empty = true;
    for series in &panel.series {
        let color = color(&series.label);
        let points = series.points.iter().map(|&(x, y)| (usable(x) && usable(y)).then(|| at(x, y)));
        for run in runs(points) {
            empty = false;
            let dotted = series.points.len() <= DOTS_UP_TO || run.len() == 1;
            let radius = if dotted { px(7) / 2 } else { LINE_WIDTH / 2 };
            // Lines are drawn piece by piece with round joints: the drawing library's joints of
            // sharp turns extend far beyond the data.
            for pair in run.windows(2).filter(|pair| pair[0] != pair[1]) {
                if matches!(series.style, Style::Beside(_)) {
                    dashed(canvas, pair[0], pair[1], color)?;
                } else {
                    line(canvas, pair[0], pair[1], LINE_WIDTH, color)?;
                }
            }
            for point in run {
                dot(canvas, point, radius, color, matches!(series.style, Style::Beside(_)))?;
            }
        }
    }
    if empty {
        let centre = (middle, i32::midpoint(plot.top, plot.bottom));
        write(canvas, "no data", HEADING, REFERENCE, Placement::Centred, centre)?;
    }

    line(canvas, (plot.left, plot.top), (plot.left, plot.bottom), px(1), INK)?;
    line(canvas, (plot.left, plot.bottom), (plot.right, plot.bottom), px(1), INK)?;
    for &tick in &x_axis.ticks {
        let x = at(tick, 0.0).0;
        line(canvas, (x, plot.bottom), (x, plot.bottom + px(5)), px(1), INK)?;
        let label =
            panel.categories.get(tick as usize).cloned().unwrap_or_else(|| x_axis.label(tick));
        let (place, half) = if upwards {
            (Placement::Upwards, text_width(canvas, &label, TICK) / 2)
        } else {
            (Placement::Centred, px(TICK / 2))
        };
        write(canvas, &label, TICK, INK, place, (x, plot.bottom + px(9) + half))?;
    }
    let below_ticks = plot.bottom + names + px(14 + TEXT / 2);
    write(canvas, &panel.x_label, TEXT, INK, Placement::Centred, (middle, below_ticks))?;
    let beside = (area.left + px(12 + TEXT / 2), i32::midpoint(plot.top, plot.bottom));
    write(canvas, &panel.y_label, TEXT, INK, Placement::Upwards, beside)?;
    draw_reference_labels(
        canvas,
        plot,
        references.into_iter().map(|(y, lines)| (at(0.0, y).1, lines)).collect(),
    )
}

/// Draws an interval with bars at both ends.
fn whisker(canvas: &Canvas, low: (i32, i32), high: (i32, i32), color: RGBColor) -> Drawn {
    const HALF: i32 = px(5);
    line(canvas, low, high, px(3) / 2, color)?;
    for (x, y) in [low, high] {
        line(canvas, (x - HALF, y), (x + HALF, y), px(3) / 2, color)?;
    }
    Ok(())
}

/// Width of a curve \[drawn pixels\].
const LINE_WIDTH: i32 = px(5) / 2;

/// Length of the stroke between a reference line and its label \[pixels of the picture\].
const LEADER: i32 = 12;

/// Writes the names of the reference lines right of the plot, each as close to the height of its
/// line as the others allow.
fn draw_reference_labels(canvas: &Canvas, plot: Area, mut marks: Vec<(i32, Vec<String>)>) -> Drawn {
    const LINE: i32 = px(TICK);
    marks.sort_by_key(|(y, _)| *y);
    // Top edges of the labels: first moved down past each other, then up again from the plot's
    // lower edge.
    let mut tops = Vec::with_capacity(marks.len());
    let mut free_from = i32::MIN;
    for (y, lines) in &marks {
        let label_height = LINE * lines.len() as i32;
        let top = (y - label_height / 2).max(free_from);
        free_from = top + label_height + px(3);
        tops.push(top);
    }
    let mut free_to = plot.bottom + LINE / 2;
    for (top, (_, lines)) in tops.iter_mut().zip(&marks).rev() {
        let label_height = LINE * lines.len() as i32;
        *top = (*top).min(free_to - label_height);
        free_to = *top - px(3);
    }
    for (top, (y, lines)) in tops.into_iter().zip(&marks) {
        let middle = top + LINE * lines.len() as i32 / 2;
        line(
            canvas,
            (plot.right + px(2), *y),
            (plot.right + px(LEADER), middle),
            px(1),
            REFERENCE,
        )?;
        for (number, text) in (0..).zip(lines) {
            let at = (plot.right + px(LEADER + 4), top + LINE * number + LINE / 2);
            write(canvas, text, TICK, REFERENCE, Placement::RightOf, at)?;
        }
    }
    Ok(())
}

/// Breaks a label between words into lines of at most `width` drawn pixels; a longer word stays
/// whole.
fn wrapped(canvas: &Canvas, label: &str, width: i32) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in label.split_whitespace() {
        if let Some(line) = lines.last_mut() {
            let longer = format!("{line} {word}");
            if text_width(canvas, &longer, TICK) <= width {
                *line = longer;
                continue;
            }
        }
        lines.push(word.to_owned());
    }
    lines
}

fn x_range(panel: &Panel) -> Range<f64> {
    if !panel.categories.is_empty() {
        return -0.5..panel.categories.len() as f64 - 0.5;
    }
    let points =
        panel.series.iter().flat_map(|s| s.points.iter().filter(|p| usable(p.1)).map(|p| p.0));
    let bands = panel
        .series
        .iter()
        .flat_map(|s| s.band.iter().flatten().filter(|b| usable(b.1) && usable(b.2)).map(|b| b.0));
    enclosing(points.chain(bands), 0.0)
}

fn y_range(panel: &Panel) -> Range<f64> {
    if let Some((low, high)) = panel.y_range
        && usable(low)
        && usable(high)
        && high - low > f64::max(low.abs(), high.abs()) * 1e-9
    {
        return low..high;
    }
    let points = panel.series.iter().flat_map(|s| s.points.iter().map(|p| p.1));
    let bands = panel.series.iter().flat_map(|s| s.band.iter().flatten().flat_map(|b| [b.1, b.2]));
    enclosing(points.chain(bands).chain(panel.references.iter().map(|r| r.1)), 0.05)
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    fn panel(points: Vec<(f64, f64)>, band: Option<Vec<(f64, f64, f64)>>) -> Panel {
        Panel {
            title: "t".into(),
            x_label: "steps".into(),
            y_label: "reward".into(),
            y_range: None,
            categories: Vec::new(),
            series: vec![Series::curve("a".into(), points, band)],
            references: vec![("full throttle".into(), 0.5)],
        }
    }

    /// Draws a figure and returns width, height, and size in bytes of the PNG.
    fn drawn(panels: &[Panel], size: (u32, u32)) -> (u32, u32, usize) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("curve.png");
        figure(&path, "title", panels, size).unwrap();
        let png = fs::read(&path).unwrap();
        assert!(png.starts_with(b"\x89PNG\r\n\x1a\n"));
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "no temporary file is left");
        let number = |at: usize| u32::from_be_bytes(png[at..at + 4].try_into().unwrap());
        (number(16), number(20), png.len())
    }

    #[test]
    fn a_figure_has_the_size_asked_for() {
        let curve: Vec<_> = (0..30).map(|i| (f64::from(i) * 1e4, f64::from(i) / 30.0)).collect();
        let band = curve.iter().map(|&(x, y)| (x, y - 0.1, y + 0.1)).collect();
        let (width, height, bytes) =
            drawn(&[panel(curve.clone(), Some(band)), panel(curve, None)], (640, 320));
        assert_eq!((width, height), (640, 320));
        assert!(bytes > 5_000, "{bytes} bytes hold no picture");
    }

    #[test]
    fn hostile_numbers_do_not_panic() {
        let (nan, inf) = (f64::NAN, f64::INFINITY);
        let mut outside =
            panel(vec![(0.0, -1e29), (1.0, 1e29)], Some(vec![(0.0, -1e29, 1e29), (1.0, 0.0, inf)]));
        outside.y_range = Some((0.0, 1.0));
        let mut reversed = panel(vec![(0.0, 1.0), (1.0, 2.0)], None);
        reversed.y_range = Some((1.0, 0.0));
        let mut nothing = panel(vec![], None);
        nothing.series.clear();
        nothing.references =
            vec![(String::new(), nan), (String::new(), inf), ("much longer ".repeat(9), 0.0)];
        let panels = [
            panel(vec![], None),
            panel(vec![(nan, 1.0), (1.0, nan), (inf, -inf)], Some(vec![(nan, nan, nan)])),
            panel(vec![(1.0, 1.0)], Some(vec![(1.0, 0.0, 2.0)])),
            panel(vec![(0.0, 5.0), (0.0, 5.0), (0.0, 5.0)], Some(vec![])),
            panel(vec![(1.0, -f64::MAX), (2.0, f64::MAX)], None),
            panel(vec![(1.0, 1e-300), (2.0, 2e-300)], None),
            panel(vec![(1e15, 1.0), (1e15 + 1.0, 1.0 + 1e-15)], None),
            panel(
                vec![(3.0, 1.0), (1.0, 2.0), (2.0, nan)],
                Some(vec![(3.0, 2.0, 1.0), (1.0, 1.0, 1.0)]),
            ),
            outside,
            reversed,
            nothing,
        ];
        for panel in &panels {
            drawn(std::slice::from_ref(panel), (280, 280));
        }
        drawn(&[], (280, 280));
    }

    #[test]
    fn dashed_series_have_the_colour_of_their_partner() {
        let mut panel = panel(vec![(0.0, 1.0)], None);
        let series = |label: &str, style| Series {
            style,
            ..Series::curve(label.to_owned(), vec![(0.0, 1.0)], None)
        };
        panel.series = vec![
            series("a", Style::Whiskers),
            series("paper a", Style::Beside("a".to_owned())),
            series("b", Style::Curve),
            series("of nobody", Style::Beside("c".to_owned())),
        ];
        panel.categories = vec!["4".to_owned(), "8".to_owned()];
        let (panels, labels) = ([panel], ["a", "paper a", "b", "of nobody"]);
        let colors = labels.map(|label| color_of(label, &panels, &labels));
        assert_eq!(colors[..3], [PALETTE[0], PALETTE[0], PALETTE[1]]);
        assert!(!PALETTE[..2].contains(&colors[3]));
        drawn(&panels, (400, 300));
    }

    #[test]
    fn impossible_sizes_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("curve.png");
        let two = [panel(vec![], None), panel(vec![], None)];
        for size in [(0, 0), (500, 400), (600, 100), (u32::MAX, 400)] {
            assert!(
                matches!(figure(&path, "", &two, size), Err(Error::Size { panels: 2, .. })),
                "{size:?}"
            );
        }
        assert!(!path.exists());
    }

    #[test]
    fn a_folder_that_does_not_exist_is_named() {
        let error = figure(Path::new("no/such/folder/curve.png"), "", &[], (280, 280)).unwrap_err();
        assert!(error.to_string().contains("no/such/folder/curve.png"), "{error}");
    }
}
