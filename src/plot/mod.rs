//! Plots of curves, and of points with intervals, as PNG or SVG pictures.
//!
//! A figure has rows of panels that share one legend below them; a label has the same colour in
//! every panel. Names of horizontal reference lines (policies without training) stand at the right
//! margin, so that no text covers data. The font of PNGs is part of the program, so nothing has to
//! be installed. Everything is drawn at three times the size and PNGs are averaged down, because the
//! bitmap backend does not smooth all edges.

mod axis;
mod canvas;
mod chart;
mod legend;
mod marks;
mod picture;

use std::path::{Path, PathBuf};

use plotters::prelude::*;

use canvas::{Canvas, Drawing, Drawn, Placement, PlotBackend, px, write};
use legend::Legend;

pub(crate) use picture::path;
pub use picture::{Picture, Rgb};

use crate::record;
use crate::words::counted;

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
    /// The panels are too small, or the picture would be larger than the limit.
    #[error(
        "cannot draw {} of {width} x {height} pixels each; a panel needs at least {MIN_PANEL} x {MIN_PANEL}, the whole \
         picture at most {MAX_SIDE} x {MAX_SIDE}",
        counted(panels, "panel")
    )]
    Size {
        /// Requested number of panels.
        panels: usize,
        /// Requested width of a panel \[pixels\].
        width: u32,
        /// Requested height of a panel \[pixels\].
        height: u32,
    },
    /// The name of the file says no format of pictures.
    #[error("`{}` is not a picture file: give a name that ends in .png or .svg", path.display())]
    Format {
        /// The file.
        path: PathBuf,
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
const MAX_SIDE: u32 = 8192;
/// Maximum number of panels in a row.
const COLUMNS: usize = 4;

// Letter heights in pixels of the picture.
const TITLE: i32 = 28;
const HEADING: i32 = 24;
const TEXT: i32 = 21;
const TICK: i32 = 19;

const INK: RGBColor = RGBColor(25, 25, 25);

/// File format of a picture.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Format {
    /// Pixels.
    #[default]
    Png,
    /// Lines and text, sharp at any size.
    Svg,
}

impl Format {
    /// Returns the format that the extension of a file name says.
    ///
    /// # Errors
    /// [`Error::Format`] for another extension or none.
    pub fn of(path: &Path) -> Result<Self, Error> {
        let known = [Self::Png, Self::Svg];
        let said = |format: &Self| path.extension().is_some_and(|end| end == format.extension());
        known.into_iter().find(said).ok_or_else(|| Error::Format { path: path.to_owned() })
    }

    /// Returns the extension of file names, without the dot.
    pub fn extension(self) -> &'static str {
        match self {
            Self::Png => "png",
            Self::Svg => "svg",
        }
    }

    /// Returns the name of the format in web pages.
    pub fn media_type(self) -> &'static str {
        match self {
            Self::Png => "image/png",
            Self::Svg => "image/svg+xml",
        }
    }
}

/// Draws `panels` in rows of at most four under `title` and writes them as a picture to `path`, whose
/// extension says the format. `panel` is the width and height of each panel \[pixels\]; title and
/// legend take a part of the height. The file appears complete or not at all.
///
/// Panels and series without a usable point are marked "no data".
///
/// # Errors
/// [`Error::Format`] for a name that does not end in `.png` or `.svg`, [`Error::Size`] for panels
/// that are too small or a picture that would be too large, [`Error::Write`] if the file cannot be
/// written.
pub fn figure(path: &Path, title: &str, panels: &[Panel], panel: (u32, u32)) -> Result<(), Error> {
    let format = Format::of(path)?;
    let figure = Figure { title, panels };
    let (rows, columns) = figure.shape();
    let side = |panel: u32, count: usize| {
        let whole = panel.checked_mul(u32::try_from(count).ok()?)?;
        (panel >= MIN_PANEL && whole <= MAX_SIDE).then_some(whole)
    };
    let (Some(width), Some(height)) = (side(panel.0, columns), side(panel.1, rows)) else {
        return Err(Error::Size { panels: panels.len(), width: panel.0, height: panel.1 });
    };
    let bytes = match format {
        Format::Png => canvas::png((width, height), &figure)?,
        Format::Svg => canvas::svg((width, height), &figure)?,
    };
    Ok(record::write_atomic(path, &bytes)?)
}

struct Figure<'a> {
    title: &'a str,
    panels: &'a [Panel],
}

impl Figure<'_> {
    /// Returns the numbers of rows and columns of panels.
    fn shape(&self) -> (usize, usize) {
        let rows = self.panels.len().div_ceil(COLUMNS).max(1);
        (rows, self.panels.len().div_ceil(rows).max(1))
    }
}

impl Drawing for Figure<'_> {
    fn paint<B: PlotBackend>(&self, canvas: &Canvas<B>) -> Drawn<B> {
        let (width, height) = canvas.dim_in_pixel();
        let mut top = px(12);
        if !self.title.is_empty() {
            let middle = (width as i32 / 2, top + px(TITLE) / 2);
            write(canvas, self.title, TITLE, INK, Placement::Centred, middle)?;
            top += px(TITLE + 10);
        }
        let legend = Legend::new(self.panels);
        let bottom = legend.draw(canvas)?;
        let places = canvas.clone().margin(top, height as i32 - bottom, 0, 0);
        let places = places.split_evenly(self.shape());
        for (number, (place, panel)) in places.iter().zip(self.panels).enumerate() {
            // Rows are apart, so that a heading is not taken for a label of the axis above it.
            let above = if number < self.shape().1 { 0 } else { px(20) };
            let place = place.clone().margin(above, 0, 0, 0);
            chart::draw(canvas, &place, panel, &|label| legend.color(label))?;
        }
        canvas.present()
    }
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

    /// Draws a figure in a format and returns the content of the file.
    fn drawn_as(format: Format, panels: &[Panel], panel: (u32, u32)) -> Vec<u8> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("curve").with_extension(format.extension());
        figure(&path, "title", panels, panel).unwrap();
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "no temporary file is left");
        fs::read(&path).unwrap()
    }

    /// Draws a figure as PNG and as SVG, and returns width, height, and size in bytes of the PNG.
    fn drawn(panels: &[Panel], panel: (u32, u32)) -> (u32, u32, usize) {
        let svg = String::from_utf8(drawn_as(Format::Svg, panels, panel)).unwrap();
        let document = roxmltree::Document::parse(&svg).unwrap();
        let side = |name| document.root_element().attribute(name).unwrap().parse::<u32>().unwrap();
        let png = drawn_as(Format::Png, panels, panel);
        assert!(png.starts_with(b"\x89PNG\r\n\x1a\n"));
        let number = |at: usize| u32::from_be_bytes(png[at..at + 4].try_into().unwrap());
        assert_eq!((side("width"), side("height")), (number(16), number(20)));
        (number(16), number(20), png.len())
    }

    #[test]
    fn panels_have_the_size_asked_for() {
        let curve: Vec<_> = (0..30).map(|i| (f64::from(i) * 1e4, f64::from(i) / 30.0)).collect();
        let band = curve.iter().map(|&(x, y)| (x, y - 0.1, y + 0.1)).collect();
        let (width, height, bytes) =
            drawn(&[panel(curve.clone(), Some(band)), panel(curve, None)], (320, 320));
        assert_eq!((width, height), (640, 320));
        assert!(bytes > 5_000, "{bytes} bytes hold no picture");
    }

    #[test]
    fn many_panels_are_in_rows_and_none_is_left_out() {
        for (count, shape) in [(0, (1, 1)), (1, (1, 1)), (4, (1, 4)), (5, (2, 3)), (20, (5, 4))] {
            let mut panels = vec![panel(vec![(0.0, 1.0), (1.0, 2.0)], None); count];
            for (number, panel) in panels.iter_mut().enumerate() {
                panel.title = format!("panel {number}");
            }
            let svg = String::from_utf8(drawn_as(Format::Svg, &panels, (280, 280))).unwrap();
            let document = roxmltree::Document::parse(&svg).unwrap();
            let side =
                |name| document.root_element().attribute(name).unwrap().parse::<u32>().unwrap();
            assert_eq!((side("height") / 280, side("width") / 280), shape, "{count}");
            let is_there = |title: &str| {
                document.descendants().any(|node| node.text().is_some_and(|t| t.trim() == title))
            };
            assert!(panels.iter().all(|panel| is_there(&panel.title)), "{count}");
        }
    }

    #[test]
    fn an_svg_contains_each_text_once() {
        let mut shown = panel(vec![(0.0, 0.25), (1.0, 0.75)], None);
        shown.title = "a < b".to_owned();
        let svg = String::from_utf8(drawn_as(Format::Svg, &[shown], (640, 320))).unwrap();
        let document = roxmltree::Document::parse(&svg).unwrap();
        let texts = document.descendants().filter(|node| node.has_tag_name("text"));
        let texts: Vec<&str> = texts.filter_map(|node| node.text()).map(str::trim).collect();
        for wanted in ["title", "a < b", "steps", "reward", "a", "full throttle"] {
            assert_eq!(
                texts.iter().filter(|text| **text == wanted).count(),
                1,
                "{wanted}: {texts:?}"
            );
        }
    }

    #[test]
    fn the_name_says_the_format_and_others_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["curve.pdf", "curve", "curve.png.txt", "png"] {
            let path = folder.path().join(name);
            let error = figure(&path, "", &[], (280, 280)).unwrap_err().to_string();
            assert!(error.contains(name) && error.contains(".png or .svg"), "{error}");
            assert!(!path.exists());
        }
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
        for size in [(0, 0), (250, 400), (300, 100), (5000, 400), (u32::MAX, 400)] {
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
