//! Pictures as arrays of pixels.

use resvg::tiny_skia::{Color, Pixmap, Transform};
use resvg::usvg::{self, Options, Tree};

/// Width of a picture \[pixels\].
const WIDTH: f32 = 900.0;

/// Draws an SVG picture on white, without its texts. Returns height, width, and the pixels row by row, each as red,
/// green and blue. Both sizes are even, as video formats want.
pub(crate) fn pixels(svg: &str) -> Result<([usize; 2], Vec<u8>), usvg::Error> {
    let tree = Tree::from_str(svg, &Options::default())?;
    let scale = WIDTH / tree.size().width();
    let even = |size: f32| 2 * ((size * scale / 2.0).round().max(1.0) as u32);
    let (width, height) = (even(tree.size().width()), even(tree.size().height()));
    let mut map = Pixmap::new(width, height).ok_or(usvg::Error::InvalidSize)?;
    map.fill(Color::WHITE);
    resvg::render(&tree, Transform::from_scale(scale, scale), &mut map.as_mut());
    // Nothing shines through the white, so that colours need no division by their opacity.
    let pixels = map.data().chunks_exact(4).flat_map(|pixel| &pixel[..3]).copied().collect();
    Ok(([height as usize, width as usize], pixels))
}
