//! Lines and text on a canvas that is finer than the picture, and averaging down to the picture.

use std::sync::OnceLock;

use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{FontStyle, FontTransform, register_font};

/// Oversampling factor: every pixel of the picture is the mean of `FINE` x `FINE` drawn pixels.
pub(super) const FINE: u32 = 3;

/// Name under which the built-in font is registered with the drawing library.
pub(super) const FONT: &str = "iwol";
pub(super) type Canvas<'a> = DrawingArea<BitMapBackend<'a>, Shift>;
pub(super) type Drawn<T = ()> =
    Result<T, DrawingAreaErrorKind<<BitMapBackend<'static> as DrawingBackend>::ErrorType>>;

/// Registers the built-in font once per process.
pub(super) fn provide_font() -> Result<(), Box<dyn std::error::Error + Send + Sync>> {
    static REGISTERED: OnceLock<bool> = OnceLock::new();
    let register =
        || register_font(FONT, FontStyle::Normal, epaint_default_fonts::UBUNTU_LIGHT).is_ok();
    if *REGISTERED.get_or_init(register) {
        Ok(())
    } else {
        Err("the built-in font is damaged".into())
    }
}

/// Averages each block of `FINE` x `FINE` pixels (three bytes each) to one pixel; `width` is the
/// width of the result.
pub(super) fn averaged(fine: &[u8], width: usize) -> Vec<u8> {
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
pub(super) fn write(
    canvas: &Canvas,
    text: &str,
    height: i32,
    color: RGBColor,
    place: Placement,
    (x, y): (i32, i32),
) -> Drawn {
    // The library centres the space between the lines; the middle of the capitals is this much
    // lower.
    let down = px(height) / 5;
    let font = (FONT, px(height)).into_font();
    let (font, h, x, y) = match place {
        Placement::RightOf => (font, HPos::Left, x, y + down),
        Placement::Centred => (font, HPos::Center, x, y + down),
        Placement::Upwards => (font.transform(FontTransform::Rotate270), HPos::Center, x + down, y),
    };
    let style = font.color(&color).pos(Pos::new(h, VPos::Center));
    // The text is drawn twice, a third of a pixel apart: the font's strokes are too light for small
    // letters.
    canvas.draw_text(text, &style, (x, y))?;
    canvas.draw_text(text, &style, (x + 1, y))
}

/// Returns the width of a text in drawn pixels.
pub(super) fn text_width(canvas: &Canvas, text: &str, height: i32) -> i32 {
    canvas
        .estimate_text_size(text, &(FONT, px(height)).into_text_style(canvas))
        .map_or(0, |(width, _)| width as i32)
}

/// Draws a line; `width` is in drawn pixels.
pub(super) fn line(
    canvas: &Canvas,
    from: (i32, i32),
    to: (i32, i32),
    width: i32,
    color: RGBColor,
) -> Drawn {
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
