//! One panel of a figure: axes, series and reference lines.

use std::ops::Range;

use plotters::element::DashedPathElement;
use plotters::prelude::*;

use super::axis::{Axis, enclosing, runs, usable};
use super::canvas::{Canvas, Drawn, FONT, Placement, PlotBackend, line, px, text_width, write};
use super::marks::{DASH, GAP, LINE_WIDTH, inside, points};
use super::{HEADING, INK, Panel, Style, TEXT, TICK};

const GRID: RGBColor = RGBColor(226, 226, 226);
const REFERENCE: RGBColor = RGBColor(70, 70, 70);
/// Length of the stroke between a reference line and its label \[pixels of the picture\].
const LEADER: i32 = 12;
/// Maximum number of points of a line that also gets a dot at each point.
const DOTS_UP_TO: usize = 40;

/// Draws a panel into its place on the canvas.
pub(super) fn draw<B: PlotBackend>(
    canvas: &Canvas<B>,
    place: &Canvas<B>,
    panel: &Panel,
    color: &dyn Fn(&str) -> RGBColor,
) -> Drawn<B> {
    let (mut x_axis, y_axis) = (Axis::new(x_range(panel), 5), Axis::new(y_range(panel), 6));
    if !panel.categories.is_empty() {
        x_axis.ticks = (0..panel.categories.len()).map(|k| k as f64).collect();
    }
    let (width, height) = place.dim_in_pixel();
    let (width, height) = (width as i32, height as i32);
    let references: Vec<(f64, Vec<String>)> = (panel.references.iter())
        .filter(|(_, y)| y_axis.range.start <= *y && *y <= y_axis.range.end)
        .map(|(label, y)| (*y, wrapped(canvas, label, width / 5)))
        .collect();
    let widest =
        |texts: &mut dyn Iterator<Item = &String>| texts.map(|t| text_width(canvas, t, TICK)).max();
    let tick_labels: Vec<String> = y_axis.ticks.iter().map(|y| y_axis.label(*y)).collect();
    // The limits keep the plot area from inverting, however long the labels are.
    let left = (px(TEXT + 26) + widest(&mut tick_labels.iter()).unwrap_or(0)).min(width / 2);
    let right = widest(&mut references.iter().flat_map(|(_, lines)| lines))
        .map_or(px(14), |w| w + px(LEADER + 18))
        .min(width - left - px(60));
    // Names that do not fit side by side are written upwards.
    let widest_category = widest(&mut panel.categories.iter()).unwrap_or(0);
    let upwards =
        widest_category * panel.categories.len() as i32 > (width - px(8) - left - right) * 9 / 10;
    let names = if upwards { widest_category.min(height / 2) } else { px(TICK) };
    let heading = if panel.title.is_empty() { 0 } else { px(HEADING + 8) };
    let below = (names + px(if panel.x_label.is_empty() { 22 } else { TEXT + 21 }))
        .min(height - heading - px(60));

    let mut builder = ChartBuilder::on(place);
    builder
        .margin_top(heading + px(4))
        .margin_right(right.max(px(14)))
        .margin_left(px(8))
        .x_label_area_size(below)
        .y_label_area_size(left);
    let mut chart = builder.build_cartesian_2d(x_axis.clone(), y_axis.clone())?;
    let name = |x: &f64| match panel.categories.get(*x as usize) {
        _ if upwards => String::new(),
        Some(category) => category.clone(),
        None => x_axis.label(*x),
    };
    // These texts are black, because the font's strokes are light.
    let style = |height: i32| (FONT, px(height)).into_font().color(&BLACK);
    chart
        .configure_mesh()
        .disable_x_mesh()
        .bold_line_style(GRID.stroke_width(px(1) as u32))
        .axis_style(INK.stroke_width(px(1) as u32))
        .set_all_tick_mark_size(px(5))
        .label_style(style(TICK))
        .y_label_offset(B::below_centre(TICK))
        .x_label_formatter(&name)
        .axis_desc_style(style(TEXT))
        .x_desc(&panel.x_label)
        .y_desc(&panel.y_label)
        .draw()?;

    for series in &panel.series {
        let color = color(&series.label);
        let band = series.band.iter().flatten();
        let usable_band = band.map(|&(x, low, high)| {
            (usable(x) && usable(low) && usable(high)).then_some(((x, low), (x, high)))
        });
        for run in runs(usable_band) {
            if series.style == Style::Whiskers {
                let stroke = color.stroke_width(px(3) as u32 / 2);
                let bar = |end| {
                    EmptyElement::at(end) + PathElement::new([(-px(5), 0), (px(5), 0)], stroke)
                };
                let ends = run.iter().map(|&(low, high)| PathElement::new([low, high], stroke));
                chart.draw_series(ends)?;
                chart.draw_series(run.iter().flat_map(|&(low, high)| [low, high]).map(bar))?;
            } else {
                let upper = run.iter().map(|ends| ends.1);
                let outline: Vec<_> = upper.chain(run.iter().rev().map(|ends| ends.0)).collect();
                chart.draw_series([Polygon::new(outline, color.mix(0.2))])?;
            }
        }
    }
    for &(y, _) in &references {
        let ends = [(x_axis.range.start, y), (x_axis.range.end, y)];
        let stroke = REFERENCE.stroke_width(px(3) as u32 / 2);
        chart.draw_series([DashedPathElement::new(ends, px(8), px(5), stroke)])?;
    }
    let mut empty = true;
    for series in &panel.series {
        let (color, ring) = (color(&series.label), matches!(series.style, Style::Beside(_)));
        let stroke = color.stroke_width(LINE_WIDTH as u32);
        for run in points(series) {
            empty = false;
            // Lines are drawn piece by piece with round joints: the drawing library's joints of
            // sharp turns extend far beyond the data.
            let pieces = || run.windows(2).map(|pair| [pair[0], pair[1]]).filter(|p| p[0] != p[1]);
            if ring {
                chart.draw_series(
                    pieces().map(|piece| DashedPathElement::new(piece, DASH, GAP, stroke)),
                )?;
            } else {
                chart.draw_series(pieces().map(|piece| PathElement::new(piece, stroke)))?;
            }
            let dotted = series.points.len() <= DOTS_UP_TO || run.len() == 1;
            let radius = if dotted { px(7) / 2 } else { LINE_WIDTH / 2 };
            chart.draw_series(run.iter().map(|&at| Circle::new(at, radius, color.filled())))?;
            let insides = run.iter().filter(|_| ring);
            let inside = inside(radius);
            chart.draw_series(insides.map(|&at| Circle::new(at, inside, WHITE.filled())))?;
        }
    }

    let (x, y) = (&x_axis.range, &y_axis.range);
    let pixel = |x: f64, y: f64| chart.backend_coord(&(x, y));
    let (corner, end) = (pixel(x.start, y.start), pixel(x.end, y.end));
    let middle = (i32::midpoint(corner.0, end.0), i32::midpoint(corner.1, end.1));
    if empty {
        write(canvas, "no data", HEADING, REFERENCE, Placement::Centred, middle)?;
    }
    let title = (middle.0, end.1 - px(4) - heading + px(HEADING) / 2);
    write(canvas, &panel.title, HEADING, INK, Placement::Centred, title)?;
    for (&x, category) in x_axis.ticks.iter().zip(&panel.categories).filter(|_| upwards) {
        let below = corner.1 + px(9) + text_width(canvas, category, TICK) / 2;
        write(canvas, category, TICK, INK, Placement::Upwards, (pixel(x, y.start).0, below))?;
    }
    let marks = references.into_iter().map(|(y, lines)| (pixel(x.end, y).1, lines)).collect();
    draw_reference_labels(canvas, (end.0, corner.1), marks)
}

/// Writes the names of the reference lines right of the plot, whose lower right corner is given,
/// each as close to the height of its line as the others allow.
fn draw_reference_labels<B: PlotBackend>(
    canvas: &Canvas<B>,
    (right, bottom): (i32, i32),
    mut marks: Vec<(i32, Vec<String>)>,
) -> Drawn<B> {
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
    let mut free_to = bottom + LINE / 2;
    for (top, (_, lines)) in tops.iter_mut().zip(&marks).rev() {
        let label_height = LINE * lines.len() as i32;
        *top = (*top).min(free_to - label_height);
        free_to = *top - px(3);
    }
    for (top, (y, lines)) in tops.into_iter().zip(&marks) {
        let middle = top + LINE * lines.len() as i32 / 2;
        line(canvas, (right + px(2), *y), (right + px(LEADER), middle), px(1), REFERENCE)?;
        for (number, text) in (0..).zip(lines) {
            let at = (right + px(LEADER + 4), top + LINE * number + LINE / 2);
            write(canvas, text, TICK, REFERENCE, Placement::RightOf, at)?;
        }
    }
    Ok(())
}

/// Breaks a label between words into lines of at most `width` drawn pixels; a longer word stays
/// whole.
fn wrapped<B: PlotBackend>(canvas: &Canvas<B>, label: &str, width: i32) -> Vec<String> {
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
