//! Lines and text on a canvas that is finer than the picture, and the picture that the canvas
//! becomes: pixels averaged down for PNG, a view box for SVG.

use std::sync::OnceLock;

use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{FontStyle, FontTransform, register_font};

use super::Error;

/// Oversampling factor: every pixel of the picture is the mean of `FINE` x `FINE` drawn pixels.
pub(super) const FINE: u32 = 3;

/// Name under which the built-in font is registered with the drawing library. Programs that show an
/// SVG use their own font of this name.
pub(super) const FONT: &str = "sans-serif";
pub(super) type Canvas<B> = DrawingArea<B, Shift>;
pub(super) type Drawn<B, T = ()> =
    Result<T, DrawingAreaErrorKind<<B as DrawingBackend>::ErrorType>>;

/// A backend of the drawing library, and how it draws text.
pub(super) trait PlotBackend: DrawingBackend {
    /// Number of times that a text is drawn, a third of a pixel apart.
    const STROKES: i32;

    /// Returns how far \[drawn pixels\] the middle of the capitals is above the point at which the
    /// backend centres a text of this height \[pixels of the picture\].
    fn below_centre(height: i32) -> i32;
}

impl PlotBackend for BitMapBackend<'_> {
    // The font's strokes are too light for small letters.
    const STROKES: i32 = 2;

    fn below_centre(height: i32) -> i32 {
        // The backend centres the space between the lines.
        px(height) / 5
    }
}

impl PlotBackend for SVGBackend<'_> {
    const STROKES: i32 = 1;

    fn below_centre(height: i32) -> i32 {
        // The backend centres the small letters.
        px(height) / 12
    }
}

/// A drawing: paints itself on the canvas of any backend.
pub(super) trait Drawing {
    fn paint<B: PlotBackend>(&self, canvas: &Canvas<B>) -> Drawn<B>;
}

/// Returns a drawing as PNG of `size` (width, height in pixels).
pub(super) fn png(size: (u32, u32), drawing: &impl Drawing) -> Result<Vec<u8>, Error> {
    provide_font()?;
    let fine_size = (size.0 * FINE, size.1 * FINE);
    let mut fine = vec![u8::MAX; fine_size.0 as usize * fine_size.1 as usize * 3];
    let canvas = BitMapBackend::with_buffer(&mut fine, fine_size).into_drawing_area();
    drawing.paint(&canvas).map_err(failed)?;
    drop(canvas);
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, size.0, size.1);
    encoder.set_color(png::ColorType::Rgb);
    encoder
        .write_header()
        .and_then(|mut writer| writer.write_image_data(&averaged(&fine, size.0 as usize)))
        .map_err(failed)?;
    Ok(bytes)
}

/// Returns a drawing as SVG of `size` (width, height in pixels).
pub(super) fn svg((width, height): (u32, u32), drawing: &impl Drawing) -> Result<Vec<u8>, Error> {
    provide_font()?;
    let (fine_width, fine_height) = (width * FINE, height * FINE);
    let mut text = String::new();
    let canvas = SVGBackend::with_string(&mut text, (fine_width, fine_height)).into_drawing_area();
    canvas.fill(&WHITE).and_then(|()| drawing.paint(&canvas)).map_err(failed)?;
    drop(canvas);
    // The view box keeps the size of the canvas.
    let side = |width, height| format!("width=\"{width}\" height=\"{height}\"");
    Ok(text.replacen(&side(fine_width, fine_height), &side(width, height), 1).into_bytes())
}

fn failed(error: impl std::error::Error + Send + Sync + 'static) -> Error {
    Error::Draw(error.into())
}

/// Registers the built-in font once per process.
fn provide_font() -> Result<(), Error> {
    static REGISTERED: OnceLock<bool> = OnceLock::new();
    let register =
        || register_font(FONT, FontStyle::Normal, epaint_default_fonts::UBUNTU_LIGHT).is_ok();
    if *REGISTERED.get_or_init(register) {
        Ok(())
    } else {
        Err(Error::Draw("the built-in font is damaged".into()))
    }
}

/// Averages each block of `FINE` x `FINE` pixels (three bytes each) to one pixel; `width` is the
/// width of the result.
fn averaged(fine: &[u8], width: usize) -> Vec<u8> {
    let fine_side = FINE as usize;
    let fine_row = width * fine_side * 3;
    let mut out = Vec::with_capacity(fine.len() / (fine_side * fine_side));
    for rows in fine.chunks_exact(fine_row * fine_side) {
        for column in 0..width {
            for channel in 0..3 {
                let first = column * fine_side * 3 + channel;
                let block =
                    (0..fine_side).flat_map(|y| (0..fine_side).map(move |x| y * fine_row + x * 3));
                let sum: u32 = block.map(|offset| u32::from(rows[first + offset])).sum();
                out.push((sum / (FINE * FINE)) as u8);
            }
        }
    }
    out
}

/// Converts a length from pixels of the picture to drawn pixels.
pub(super) const fn px(length: i32) -> i32 {
    length * FINE as i32
}

/// Position of a text relative to the point at which it is drawn. Vertically, the point is at the
/// middle of the capitals.
#[derive(Clone, Copy)]
pub(super) enum Placement {
    RightOf,
    Centred,
    /// Centred, and read from bottom to top.
    Upwards,
}

/// Draws a text at a drawn pixel; `height` is in pixels of the picture.
pub(super) fn write<B: PlotBackend>(
    canvas: &Canvas<B>,
    text: &str,
    height: i32,
    color: RGBColor,
    place: Placement,
    (x, y): (i32, i32),
) -> Drawn<B> {
    let down = B::below_centre(height);
    let font = (FONT, px(height)).into_font();
    let (font, h, x, y) = match place {
        Placement::RightOf => (font, HPos::Left, x, y + down),
        Placement::Centred => (font, HPos::Center, x, y + down),
        Placement::Upwards => (font.transform(FontTransform::Rotate270), HPos::Center, x + down, y),
    };
    let style = font.color(&color).pos(Pos::new(h, VPos::Center));
    (0..B::STROKES).try_for_each(|aside| canvas.draw_text(text, &style, (x + aside, y)))
}

/// Returns the width of a text in drawn pixels.
pub(super) fn text_width<B: PlotBackend>(canvas: &Canvas<B>, text: &str, height: i32) -> i32 {
    canvas
        .estimate_text_size(text, &(FONT, px(height)).into_text_style(canvas))
        .map_or(0, |(width, _)| width as i32)
}

/// Draws a line; `width` is in drawn pixels.
pub(super) fn line<B: PlotBackend>(
    canvas: &Canvas<B>,
    from: (i32, i32),
    to: (i32, i32),
    width: i32,
    color: RGBColor,
) -> Drawn<B> {
    canvas.draw(&PathElement::new(vec![from, to], color.stroke_width(width as u32)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn averaging_takes_the_mean_of_each_block() {
        // Two pixels side by side: the left block is 90 except for one 0, the right block is 200.
        let mut fine = vec![0; 3 * 6 * 3];
        for (i, byte) in fine.iter_mut().enumerate() {
            *byte = if (i / 3) % 6 < 3 { 90 } else { 200 };
        }
        fine[..3].fill(0);
        assert_eq!(averaged(&fine, 2), [80, 80, 80, 200, 200, 200]);
    }
}
