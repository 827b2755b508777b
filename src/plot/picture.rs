//! Pictures of plain shapes in metres, as SVG or PNG. Maps of nets are drawn with them.

use std::fmt::Write as _;
use std::path::Path;

use plotters::prelude::*;

use super::Error;
use super::canvas::{self, Canvas, Drawing, Drawn, FINE, Placement, PlotBackend, write};
use crate::markup::escape as escaped;
use crate::record;

/// Length of the longer side of the drawing \[pixels\].
const SIDE: f64 = 1200.0;
/// White margin around all shapes \[pixels\].
const MARGIN: f64 = 24.0;
/// Height of letters \[pixels\].
const LETTERS: i32 = 18;
/// Height of a line of text \[pixels\].
const LINE: f64 = 28.0;
/// Number of straight pieces that form a circle.
const SIDES: u32 = 72;

/// Colour of texts and of the scale bar.
const TEXT_COLOR: Rgb = [25; 3];

/// A colour: red, green, blue.
pub type Rgb = [u8; 3];

/// A picture; later shapes are drawn on top of earlier ones.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Picture {
    title: String,
    shapes: Vec<Shape>,
    /// Colours and their meaning.
    legend: Vec<(Rgb, String)>,
}

#[derive(Debug, Clone, PartialEq)]
struct Shape {
    /// \[m\]
    points: Vec<[f64; 2]>,
    color: Rgb,
    /// Width of the line along the points \[m\]; `None` fills the area between them.
    width: Option<f64>,
}

impl Picture {
    /// Creates an empty picture.
    pub fn new(title: impl Into<String>) -> Self {
        Self { title: title.into(), ..Self::default() }
    }

    /// Adds a line; `width` in metres.
    pub fn line(&mut self, points: &[[f64; 2]], width: f64, color: Rgb) {
        self.shapes.push(Shape { points: points.to_vec(), color, width: Some(width) });
    }

    /// Adds a filled area.
    pub fn area(&mut self, points: &[[f64; 2]], color: Rgb) {
        self.shapes.push(Shape { points: points.to_vec(), color, width: None });
    }

    /// Adds a circular line of the given width \[m\], or a disc if the width is `None`.
    pub fn circle(&mut self, [x, y]: [f64; 2], radius: f64, width: Option<f64>, color: Rgb) {
        let angles = (0..=SIDES).map(|k| std::f64::consts::TAU * f64::from(k) / f64::from(SIDES));
        let points =
            angles.map(|angle| [x + radius * angle.cos(), y + radius * angle.sin()]).collect();
        self.shapes.push(Shape { points, color, width });
    }

    /// Adds an entry to the legend: a colour and its meaning.
    pub fn explain(&mut self, color: Rgb, text: impl Into<String>) {
        self.legend.push((color, text.into()));
    }

    /// Returns width and height in pixels, and everything to draw in the order of drawing.
    fn marks(&self) -> ([f64; 2], Vec<(Rgb, Mark)>) {
        let points = || self.shapes.iter().flat_map(|shape| &shape.points);
        let end = |axis: usize, sign: f64| {
            points().map(|p| sign * p[axis]).fold(f64::NEG_INFINITY, f64::max) * sign
        };
        let [mut left, bottom, right, mut top] =
            [end(0, -1.0), end(1, -1.0), end(0, 1.0), end(1, 1.0)];
        let longest = (right - left).max(top - bottom);
        let (mut scale, mut size) = (1.0, [0.0, 0.0]);
        if longest.is_finite() {
            scale = if longest > 0.0 { SIDE / longest } else { 1.0 };
            size = [scale * (right - left), scale * (top - bottom)];
        } else {
            (left, top) = (0.0, 0.0);
        }
        let place =
            |[x, y]: &[f64; 2]| [MARGIN + scale * (x - left), MARGIN + LINE + scale * (top - y)];
        let mut marks = vec![(TEXT_COLOR, Mark::Text([MARGIN, MARGIN], self.title.clone()))];
        for Shape { points, color, width } in &self.shapes {
            let places = points.iter().map(place).collect();
            marks.push((
                *color,
                match width {
                    // At least one pixel, so that lines stay visible in pictures of large nets.
                    Some(width) => Mark::Line(places, (scale * width).max(1.0)),
                    None => Mark::Area(places),
                },
            ));
        }
        let metres = ruler(scale);
        let bar = (TEXT_COLOR, format!("{metres} m"), scale * metres, 3.0);
        let legend = self.legend.iter().map(|(color, text)| (*color, text.clone(), LINE, 12.0));
        let mut y = MARGIN + LINE + size[1];
        for (color, text, length, width) in std::iter::once(bar).chain(legend) {
            y += LINE;
            marks.push((color, Mark::Line(vec![[MARGIN, y], [MARGIN + length, y]], width)));
            marks.push((TEXT_COLOR, Mark::Text([MARGIN + length + 10.0, y], text)));
        }
        // The picture is at least wide enough for the title.
        ([size[0].max(SIDE / 2.0) + 2.0 * MARGIN, y + MARGIN], marks)
    }

    /// Returns the picture as SVG.
    pub fn svg(&self) -> String {
        let ([width, height], marks) = self.marks();
        let mut svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width:.0} {height:.0}\" width=\"{width:.0}\" \
             font-family=\"sans-serif\" font-size=\"{LETTERS}\">\n<title>{}</title>\n\
             <rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>\n",
            escaped(&self.title)
        );
        for ([r, g, b], mark) in &marks {
            let color = format!("#{r:02x}{g:02x}{b:02x}");
            let _ = match mark {
                Mark::Line(points, width) => writeln!(
                    svg,
                    "<path d=\"{}\" fill=\"none\" stroke=\"{color}\" stroke-width=\"{width:.2}\" stroke-linejoin=\"round\"/>",
                    path(points)
                ),
                Mark::Area(points) => {
                    writeln!(svg, "<path d=\"{}Z\" fill=\"{color}\"/>", path(points))
                }
                Mark::Text([x, y], text) => writeln!(
                    svg,
                    "<text x=\"{x:.0}\" y=\"{y:.0}\" dominant-baseline=\"middle\">{}</text>",
                    escaped(text)
                ),
            };
        }
        svg.push_str("</svg>\n");
        svg
    }

    /// Writes the picture as PNG to `path`. The file appears complete or not at all.
    ///
    /// # Errors
    /// [`Error::Write`] if the file cannot be written, [`Error::Draw`] if drawing fails.
    pub fn png(&self, path: &Path) -> Result<(), Error> {
        let (size, marks) = self.marks();
        let bytes = canvas::png(size.map(|length| length.ceil() as u32).into(), &Marks(marks))?;
        Ok(record::write_atomic(path, &bytes)?)
    }
}

/// Something to draw, in pixels.
enum Mark {
    /// A line of a width.
    Line(Vec<[f64; 2]>, f64),
    Area(Vec<[f64; 2]>),
    Text([f64; 2], String),
}

struct Marks(Vec<(Rgb, Mark)>);

impl Drawing for Marks {
    fn paint<B: PlotBackend>(&self, canvas: &Canvas<B>) -> Drawn<B> {
        let fine = |[x, y]: [f64; 2]| {
            ((x * f64::from(FINE)).round() as i32, (y * f64::from(FINE)).round() as i32)
        };
        for ([r, g, b], mark) in &self.0 {
            let color = RGBColor(*r, *g, *b);
            let area = |points: &[[f64; 2]]| {
                let corners: Vec<_> = points.iter().map(|&point| fine(point)).collect();
                canvas.draw(&Polygon::new(corners, color.filled()))
            };
            match mark {
                Mark::Text(at, text) => {
                    write(canvas, text, LETTERS, color, Placement::RightOf, fine(*at))?;
                }
                Mark::Area(points) => area(points)?,
                // Thick lines are drawn as areas with round joints.
                Mark::Line(points, width) => {
                    let half = width / 2.0;
                    for pair in points.windows(2) {
                        let [[x0, y0], [x1, y1]] = [pair[0], pair[1]];
                        let length = (x1 - x0).hypot(y1 - y0).max(f64::MIN_POSITIVE);
                        let (dx, dy) = (half * (y1 - y0) / length, half * (x0 - x1) / length);
                        area(&[
                            [x0 + dx, y0 + dy],
                            [x1 + dx, y1 + dy],
                            [x1 - dx, y1 - dy],
                            [x0 - dx, y0 - dy],
                        ])?;
                    }
                    let radius = (half * f64::from(FINE)) as i32;
                    for &joint in points.iter().skip(1).take(points.len().saturating_sub(2)) {
                        canvas.draw(&Circle::new(fine(joint), radius, color.filled()))?;
                    }
                }
            }
        }
        canvas.present()
    }
}

/// Returns the length of the scale bar: a round number of metres, at most a fifth of the picture.
fn ruler(scale: f64) -> f64 {
    let fifth = SIDE / scale / 5.0;
    let decade = 10_f64.powf(fifth.log10().floor());
    [5.0, 2.0, 1.0].map(|k| k * decade).into_iter().find(|&m| m <= fifth).unwrap_or(decade)
}

/// Returns a line as the data of an SVG path.
pub(crate) fn path(points: &[[f64; 2]]) -> String {
    let point = |(k, [x, y]): (usize, &[f64; 2])| {
        format!("{}{x:.2} {y:.2}", if k == 0 { 'M' } else { 'L' })
    };
    points.iter().enumerate().map(point).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture() -> Picture {
        let mut picture = Picture::new("a < b");
        picture.line(&[[0.0, 0.0], [50.0, 0.0], [50.0, 20.0]], 3.0, [0, 114, 178]);
        picture.area(&[[10.0, 5.0], [20.0, 5.0], [20.0, 10.0]], [213, 94, 0]);
        picture.circle([30.0, 10.0], 4.0, None, [0, 158, 115]);
        picture.explain([213, 94, 0], "an area");
        picture
    }

    #[test]
    fn shapes_keep_their_places_and_proportions() {
        let svg = picture().svg();
        let document = roxmltree::Document::parse(&svg).unwrap();
        let path = document.descendants().find(|node| node.has_tag_name("path")).unwrap();
        // 50 m are 1200 pixels, and the y axis points up.
        assert_eq!(path.attribute("d"), Some("M24.00 532.00L1224.00 532.00L1224.00 52.00"));
        assert_eq!(path.attribute("stroke-width"), Some("72.00"));
        assert!(
            svg.contains("a &lt; b") && svg.contains("an area") && svg.contains("10 m"),
            "{svg}"
        );
    }

    #[test]
    fn a_png_shows_what_the_svg_does() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        picture().png(&path).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        assert!(bytes.starts_with(b"\x89PNG") && bytes.len() > 2000, "{} bytes", bytes.len());
        Picture::new("nothing").png(&path).unwrap();
        roxmltree::Document::parse(&Picture::new("nothing").svg()).unwrap();
    }
}
