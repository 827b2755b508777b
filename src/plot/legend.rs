//! The legend that all panels of a figure share, and the colours of the series.

use plotters::element::DashedPathElement;
use plotters::prelude::*;

use super::canvas::{Canvas, Drawn, Placement, PlotBackend, line, px, text_width, write};
use super::marks::{DASH, GAP, LINE_WIDTH, inside, points};
use super::{INK, Panel, Series, Style, TEXT};

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

/// Returns the colour of the series with this number: after the whole palette, its colours come
/// again half as strong.
fn color(number: usize) -> RGBColor {
    let RGBColor(r, g, b) = PALETTE[number % PALETTE.len()];
    if (number / PALETTE.len()).is_multiple_of(2) {
        return RGBColor(r, g, b);
    }
    let pale = |part: u8| part / 2 + 128;
    RGBColor(pale(r), pale(g), pale(b))
}

/// Returns a text that is no wider than `room` pixels: the middle of a longer one is left out,
/// because names of cells differ at their ends.
fn fitted<B: PlotBackend>(canvas: &Canvas<B>, text: &str, room: i32) -> String {
    let letters: Vec<char> = text.chars().collect();
    let shortened = |kept: usize| {
        let (first, last) = (kept.div_ceil(2), kept / 2);
        let ends = letters[..first].iter().chain(&['…']).chain(&letters[letters.len() - last..]);
        ends.collect::<String>()
    };
    if text_width(canvas, text, TEXT) <= room {
        return text.to_owned();
    }
    let fits = |kept: &usize| text_width(canvas, &shortened(*kept), TEXT) <= room;
    shortened((0..letters.len()).rev().find(fits).unwrap_or(0))
}

/// The labels of a figure with their colours and marks.
pub(super) struct Legend {
    entries: Vec<Entry>,
}

struct Entry {
    label: String,
    /// The label, and whether its series have no data.
    text: String,
    color: RGBColor,
    dashed: bool,
    /// Whether the series consist of unconnected points.
    scattered: bool,
}

impl Legend {
    pub(super) fn new(panels: &[Panel]) -> Self {
        let all = || panels.iter().flat_map(|panel| &panel.series);
        let mut entries: Vec<Entry> = Vec::new();
        let mut solid = 0;
        for first in all() {
            if entries.iter().any(|entry| entry.label == first.label) {
                continue;
            }
            let same: Vec<&Series> = all().filter(|series| series.label == first.label).collect();
            let dashed = same.iter().any(|series| matches!(series.style, Style::Beside(_)));
            let empty = same.iter().all(|series| points(series).is_empty());
            entries.push(Entry {
                label: first.label.clone(),
                text: format!("{}{}", first.label, if empty { " (no data)" } else { "" }),
                color: color(solid),
                dashed,
                scattered: same.iter().any(|series| series.points.len() > 1)
                    && same.iter().all(|series| points(series).iter().all(|run| run.len() == 1)),
            });
            // Dashed series do not use up colours of the palette.
            solid += usize::from(!dashed);
        }
        // Dashed series have the colour of their partner, wherever it is in the figure.
        let partner = |label: &str| {
            all().filter(|series| series.label == label).find_map(|series| match &series.style {
                Style::Beside(partner) => Some(partner.as_str()),
                _ => None,
            })
        };
        let colors: Vec<Option<RGBColor>> = entries
            .iter()
            .map(|entry| {
                let partner = partner(&entry.label)?;
                Some(entries.iter().find(|other| other.label == partner)?.color)
            })
            .collect();
        for (entry, color) in entries.iter_mut().zip(colors) {
            entry.color = color.unwrap_or(entry.color);
        }
        Self { entries }
    }

    pub(super) fn color(&self, label: &str) -> RGBColor {
        let known = self.entries.iter().find(|entry| entry.label == label);
        known.map_or(INK, |entry| entry.color)
    }

    /// Draws the legend at the bottom, in as many rows as it needs, and returns the y of its upper
    /// edge.
    pub(super) fn draw<B: PlotBackend>(&self, canvas: &Canvas<B>) -> Drawn<B, i32> {
        const SWATCH: i32 = px(34);
        const BESIDE: i32 = px(9);
        const BETWEEN: i32 = px(34);
        const ROW: i32 = px(TEXT + 9);
        /// An entry with its text and its width.
        type Placed<'a> = (&'a Entry, String, i32);
        let (width, height) = canvas.dim_in_pixel();
        let (width, height) = (width as i32, height as i32);
        let most = width - px(20);
        let mut rows: Vec<(i32, Vec<Placed<'_>>)> = Vec::new();
        for entry in self.entries.iter().filter(|entry| !entry.label.is_empty()) {
            let text = fitted(canvas, &entry.text, most - SWATCH - BESIDE);
            let length = SWATCH + BESIDE + text_width(canvas, &text, TEXT);
            match rows.last_mut() {
                Some((used, row)) if *used + BETWEEN + length <= most => {
                    *used += BETWEEN + length;
                    row.push((entry, text, length));
                }
                _ => rows.push((length, vec![(entry, text, length)])),
            }
        }
        let top = height - px(10) - ROW * rows.len() as i32;
        for (number, (used, row)) in (0..).zip(&rows) {
            let mut x = (width - used) / 2;
            let y = top + ROW * number + ROW / 2;
            for (entry, text, length) in row {
                let ends = [(x, y), (x + SWATCH, y)];
                if entry.scattered {
                    let middle = (x + SWATCH / 2, y);
                    canvas.draw(&Circle::new(middle, px(5), entry.color.filled()))?;
                    if entry.dashed {
                        canvas.draw(&Circle::new(middle, inside(px(5)), WHITE.filled()))?;
                    }
                } else if entry.dashed {
                    let style = entry.color.stroke_width(LINE_WIDTH as u32);
                    canvas.draw(&DashedPathElement::new(ends, DASH, GAP, style))?;
                } else {
                    line(canvas, ends[0], ends[1], px(3), entry.color)?;
                }
                let beside = (x + SWATCH + BESIDE, y);
                write(canvas, text, TEXT, INK, Placement::RightOf, beside)?;
                x += length + BETWEEN;
            }
        }
        Ok(top)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dashed_series_have_the_colour_of_their_partner() {
        let series = |label: &str, style| Series {
            style,
            ..Series::curve(label.to_owned(), vec![(0.0, 1.0)], None)
        };
        let all = vec![
            series("a", Style::Whiskers),
            series("paper a", Style::Beside("a".to_owned())),
            series("b", Style::Curve),
            series("of nobody", Style::Beside("c".to_owned())),
        ];
        let legend = Legend::new(&[Panel { series: all, ..Panel::default() }]);
        let colors = ["a", "paper a", "b", "of nobody"].map(|label| legend.color(label));
        assert_eq!(colors[..3], [PALETTE[0], PALETTE[0], PALETTE[1]]);
        assert!(!PALETTE[..2].contains(&colors[3]));
    }
}
