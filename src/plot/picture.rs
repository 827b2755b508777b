//! Pictures of plain shapes in metres, as SVG or PNG. Maps of nets are drawn with them.

use std::fmt::Write as _;
use std::path::Path;

use plotters::prelude::*;

use super::canvas::{Canvas, Drawn, FINE, Placement, provide_font, px, write};
use super::{Error, INK, save};
use crate::markup::escape as escaped;

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

    fn frame(&self) -> Frame {
        let points = || self.shapes.iter().flat_map(|shape| &shape.points);
        let end = |axis: usize, sign: f64| {
            points().map(|p| sign * p[axis]).fold(f64::NEG_INFINITY, f64::max) * sign
        };
        let [left, bottom, right, top] = [end(0, -1.0), end(1, -1.0), end(0, 1.0), end(1, 1.0)];
        let longest = (right - left).max(top - bottom);
        let scale = if longest.is_finite() && longest > 0.0 { SIDE / longest } else { 1.0 };
        let (left, top) = if longest.is_finite() { (left, top) } else { (0.0, 0.0) };
        let length =
            |from: f64, to: f64| if longest.is_finite() { scale * (to - from) } else { 0.0 };
        Frame {
            left,
            top,
            scale,
            // The picture is at least wide enough for the title.
            width: length(left, right).max(SIDE / 2.0) + 2.0 * MARGIN,
            map_bottom: MARGIN + LINE + length(bottom, top),
            lines: self.legend.len() + 1,
        }
    }

    /// Returns the length of the scale bar: a round number of metres, at most a fifth of the
    /// picture.
    fn ruler(frame: &Frame) -> f64 {
        let fifth = SIDE / frame.scale / 5.0;
        let decade = 10_f64.powf(fifth.log10().floor());
        [5.0, 2.0, 1.0]
            .into_iter()
            .map(|k| k * decade)
            .find(|&metres| metres <= fifth)
            .unwrap_or(decade)
    }

    /// Returns the picture as SVG.
    pub fn svg(&self) -> String {
        let frame = self.frame();
        let mut svg = String::new();
        let (width, height) = (frame.width, frame.height());
        let _ = writeln!(
            svg,
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width:.0} {height:.0}\" width=\"{width:.0}\" \
             font-family=\"sans-serif\" font-size=\"{LETTERS}\">\n<title>{}</title>\n\
             <rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>",
            escaped(&self.title)
        );
        let text = |svg: &mut String, [x, y]: [f64; 2], text: &str| {
            let _ = writeln!(
                svg,
                "<text x=\"{x:.0}\" y=\"{y:.0}\" dominant-baseline=\"middle\">{}</text>",
                escaped(text)
            );
        };
        text(&mut svg, [MARGIN, MARGIN], &self.title);
        for Shape { points, color, width } in &self.shapes {
            let place = |(k, point): (usize, &[f64; 2])| {
                let [x, y] = frame.place(*point);
                format!("{}{x:.2} {y:.2}", if k == 0 { 'M' } else { 'L' })
            };
            let way: String = points.iter().enumerate().map(place).collect();
            let color = hex(*color);
            let _ = match width {
                Some(width) => writeln!(
                    svg,
                    "<path d=\"{way}\" fill=\"none\" stroke=\"{color}\" stroke-width=\"{:.2}\" stroke-linejoin=\"round\"/>",
                    frame.width_of(*width)
                ),
                None => writeln!(svg, "<path d=\"{way}Z\" fill=\"{color}\"/>"),
            };
        }
        let metres = Self::ruler(&frame);
        for (k, (color, note)) in self.notes(metres).iter().enumerate() {
            let [x, y] = frame.note(k);
            let length = if k == 0 { metres * frame.scale } else { LINE };
            let _ = writeln!(
                svg,
                "<path d=\"M{x:.1} {y:.1}h{length:.1}\" stroke=\"{}\" stroke-width=\"{}\"/>",
                hex(*color),
                if k == 0 { 3 } else { 12 }
            );
            text(&mut svg, [x + length + 10.0, y], note);
        }
        svg.push_str("</svg>\n");
        svg
    }

    /// Writes the picture as PNG to `path`. The file appears complete or not at all.
    ///
    /// # Errors
    /// [`Error::Write`] if the file cannot be written, [`Error::Draw`] if drawing fails.
    pub fn png(&self, path: &Path) -> Result<(), Error> {
        provide_font().map_err(Error::Draw)?;
        let frame = self.frame();
        let size = (frame.width.ceil() as u32, frame.height().ceil() as u32);
        let fine_size = (size.0 * FINE, size.1 * FINE);
        let mut fine = vec![u8::MAX; fine_size.0 as usize * fine_size.1 as usize * 3];
        self.draw(&BitMapBackend::with_buffer(&mut fine, fine_size).into_drawing_area(), &frame)
            .map_err(|e| Error::Draw(e.into()))?;
        save(path, size, &fine)
    }

    fn draw(&self, canvas: &Canvas, frame: &Frame) -> Drawn {
        let fine = |[x, y]: [f64; 2]| {
            ((x * f64::from(FINE)).round() as i32, (y * f64::from(FINE)).round() as i32)
        };
        write(canvas, &self.title, LETTERS, INK, Placement::RightOf, fine([MARGIN, MARGIN]))?;
        for Shape { points, color: [r, g, b], width } in &self.shapes {
            let color = RGBColor(*r, *g, *b);
            let places: Vec<[f64; 2]> = points.iter().map(|&point| frame.place(point)).collect();
            let Some(width) = width else {
                canvas.draw(&Polygon::new(
                    places.into_iter().map(fine).collect::<Vec<_>>(),
                    color.filled(),
                ))?;
                continue;
            };
            // Thick lines are drawn as areas with round joints.
            let half = frame.width_of(*width) / 2.0;
            for pair in places.windows(2) {
                let [[x0, y0], [x1, y1]] = [pair[0], pair[1]];
                let length = (x1 - x0).hypot(y1 - y0).max(f64::MIN_POSITIVE);
                let (dx, dy) = (half * (y1 - y0) / length, half * (x0 - x1) / length);
                let corners = [
                    [x0 + dx, y0 + dy],
                    [x1 + dx, y1 + dy],
                    [x1 - dx, y1 - dy],
                    [x0 - dx, y0 - dy],
                ];
                canvas.draw(&Polygon::new(corners.map(fine).to_vec(), color.filled()))?;
            }
            let inner = places.len().saturating_sub(2);
            for &place in places.iter().skip(1).take(inner) {
                canvas.draw(&Circle::new(
                    fine(place),
                    (half * f64::from(FINE)) as i32,
                    color.filled(),
                ))?;
            }
        }
        let metres = Self::ruler(frame);
        for (k, (color, note)) in self.notes(metres).iter().enumerate() {
            let [x, y] = frame.note(k);
            let (length, height) = if k == 0 { (metres * frame.scale, 3) } else { (LINE, 12) };
            let color = RGBColor(color[0], color[1], color[2]);
            let (left, middle) = fine([x, y]);
            let (right, _) = fine([x + length, y]);
            let bar = [(left, middle - px(height) / 2), (right, middle + px(height) / 2)];
            canvas.draw(&Rectangle::new(bar, color.filled()))?;
            write(canvas, note, LETTERS, INK, Placement::RightOf, fine([x + length + 10.0, y]))?;
        }
        canvas.present()
    }

    /// Returns the scale bar and the legend.
    fn notes(&self, metres: f64) -> Vec<(Rgb, String)> {
        std::iter::once(([25; 3], format!("{metres} m")))
            .chain(self.legend.iter().cloned())
            .collect()
    }
}

/// The transformation from metres to pixels.
struct Frame {
    left: f64,
    top: f64,
    scale: f64,
    width: f64,
    map_bottom: f64,
    /// Number of lines of text below the map.
    lines: usize,
}

impl Frame {
    fn place(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [MARGIN + self.scale * (x - self.left), MARGIN + LINE + self.scale * (self.top - y)]
    }

    /// Returns the width of a line in pixels; at least one pixel, so that lines stay visible in
    /// pictures of large nets.
    fn width_of(&self, metres: f64) -> f64 {
        (self.scale * metres).max(1.0)
    }

    fn note(&self, line: usize) -> [f64; 2] {
        [MARGIN, self.map_bottom + LINE * (line as f64 + 1.0)]
    }

    fn height(&self) -> f64 {
        self.map_bottom + LINE * self.lines as f64 + MARGIN
    }
}

fn hex([r, g, b]: Rgb) -> String {
    format!("#{r:02x}{g:02x}{b:02x}")
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
