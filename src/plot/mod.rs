//! Plots of curves, and of points with intervals, as PNG pictures.
//!
//! A figure is a row of panels that share one legend below them; a label has the same colour in
//! every panel. Names of horizontal reference lines (policies without training) stand at the right
//! margin, so that no text covers data. The font is part of the program, so nothing has to be
//! installed. Everything is drawn at three times the size and averaged down, because the bitmap
//! backend does not smooth all edges.

mod axis;
mod canvas;
mod chart;
mod legend;
mod picture;

use std::path::Path;

use plotters::prelude::*;

use canvas::{Canvas, Drawn, FINE, Placement, averaged, provide_font, px, write};
use legend::Legend;

pub(crate) use picture::path;
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
#[derive(Debug, Clone, Default, PartialEq)]
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

const INK: RGBColor = RGBColor(25, 25, 25);
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
    save(path, size, |canvas| draw(canvas, title, panels))
}

/// Lets `draw` paint on a canvas that is finer than the picture, averages it down to `size`, and
/// writes it as PNG to `path`. The file appears complete or not at all.
fn save(path: &Path, size: (u32, u32), draw: impl FnOnce(&Canvas) -> Drawn) -> Result<(), Error> {
    provide_font().map_err(Error::Draw)?;
    let fine_size = (size.0 * FINE, size.1 * FINE);
    let mut fine = vec![u8::MAX; fine_size.0 as usize * fine_size.1 as usize * 3];
    draw(&BitMapBackend::with_buffer(&mut fine, fine_size).into_drawing_area())
        .map_err(|e| Error::Draw(e.into()))?;
    let file = record::temporary_beside(path, ".png")?;
    let mut picture = BitMapBackend::new(file.path(), size);
    picture
        .blit_bitmap((0, 0), size, &averaged(&fine, size.0 as usize))
        .map_err(|e| Error::Draw(e.into()))?;
    picture.present().map_err(|e| Error::Draw(e.into()))?;
    drop(picture);
    Ok(record::replace(file, path)?)
}

fn draw(canvas: &Canvas, title: &str, panels: &[Panel]) -> Drawn {
    let (width, height) = canvas.dim_in_pixel();
    let mut top = px(12);
    if !title.is_empty() {
        let middle = (width as i32 / 2, top + px(TITLE) / 2);
        write(canvas, title, TITLE, INK, Placement::Centred, middle)?;
        top += px(TITLE + 10);
    }
    let legend = Legend::new(panels);
    let bottom = legend.draw(canvas)?;
    let places = canvas.clone().margin(top, height as i32 - bottom, 0, 0);
    for (place, panel) in places.split_evenly((1, panels.len().max(1))).iter().zip(panels) {
        chart::draw(canvas, place, panel, &|label| legend.color(label))?;
    }
    canvas.present()
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
        let mut compared = panel(vec![(0.0, 1.0)], Some(vec![(0.0, 0.5, 2.0)]));
        compared.series[0].style = Style::Whiskers;
        compared.series.push(Series {
            style: Style::Beside("a".to_owned()),
            ..Series::curve("paper a".to_owned(), vec![(0.0, 1.0), (1.0, 2.0)], None)
        });
        compared.categories = vec!["4".to_owned(), "8".to_owned()];
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
            compared,
        ];
        for panel in &panels {
            drawn(std::slice::from_ref(panel), (280, 280));
        }
        drawn(&[], (280, 280));
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
