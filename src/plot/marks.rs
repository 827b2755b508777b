//! What curves and their entries in the legend have in common: runs of points, lines and rings.

use super::Series;
use super::axis::{runs, usable};
use super::canvas::px;

/// Width of a curve \[drawn pixels\].
pub(super) const LINE_WIDTH: i32 = px(5) / 2;
/// Lengths of a dash and of the gap after it \[drawn pixels\].
pub(super) const DASH: i32 = px(9);
pub(super) const GAP: i32 = px(6);

/// Returns the radius of the white inside of a ring, which marks values to compare with.
pub(super) fn inside(radius: i32) -> i32 {
    radius - px(3) / 2
}

/// Returns the runs of usable points of a series.
pub(super) fn points(series: &Series) -> Vec<Vec<(f64, f64)>> {
    runs(series.points.iter().map(|&(x, y)| (usable(x) && usable(y)).then_some((x, y))))
}
