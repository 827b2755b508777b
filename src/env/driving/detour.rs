//! Detours: the paths of routes whose U-turns are too sharp for a vehicle that steers.

use std::f64::consts::{FRAC_PI_2, PI};

use super::vehicle::tyres::least_radius;
use crate::scenario::Steering;
use crate::sumo::net::Path;

/// Radius of the U-turn arc in multiples of the vehicle's least turning radius, where the path's
/// own U-turn is too narrow. With this and [`SWING`] the vehicle stays on the road at 6 m/s.
const BACK: f64 = 1.5;
/// Radius of the arcs that swing out for the U-turn and back, in the same unit.
const SWING: f64 = 2.5;

/// Returns the path that a vehicle follows on a `route` with a U-turn too sharp for it: out to the
/// other side first, then back along the outline of a bulb.
///
/// Only the first such U-turn is replaced; `None` if there is none. Whether the new path lies on
/// the road is not checked.
pub(super) fn path_around(route: &Path, steering: &Steering) -> Option<Path> {
    let least = least_radius(steering);
    let heading = |i: usize| {
        let ([x, y], [u, v]) = (route.points[i], route.points[i + 1]);
        (v - y).atan2(u - x)
    };
    let segments = route.points.len().saturating_sub(1);
    // The route makes a U-turn between the end of segment `i` and the start of segment `j`.
    let turns = |&(i, j): &(usize, usize)| {
        (heading(j) - heading(i)).cos() < -0.99
            && route.cumulative[j] - route.cumulative[i + 1] < PI * least
    };
    let (i, j) = (0..segments).flat_map(|i| (i + 1..segments).map(move |j| (i, j))).find(turns)?;
    let ([x, y], [u, v], heading) = (route.points[i + 1], route.points[j], heading(i));
    let (sin, cos) = heading.sin_cos();
    // The bulb begins and ends level with the farther of the U-turn's two ends.
    let begin = ((u - x) * cos + (v - y) * sin).max(0.0);
    let across = (v - y) * cos - (u - x) * sin;
    let (half, side) = (across.abs() / 2.0, across.signum());
    let (back, swing) = (BACK * least, SWING * least);
    let out = ((half + swing) / (back + swing)).min(1.0).acos();
    // Arcs as (centre ahead, centre to the side of the U-turn, radius, first angle, angle),
    // relative to where the U-turn begins.
    let arcs = [
        (begin, -swing, swing, FRAC_PI_2, -out),
        (begin + (back + swing) * out.sin(), half, back, -FRAC_PI_2 - out, PI + 2.0 * out),
        (begin, 2.0 * half + swing, swing, out - FRAC_PI_2, -out),
    ];
    let arc = |(ahead, beside, radius, first, angle): (f64, f64, f64, f64, f64)| {
        let steps = (radius * angle.abs()).ceil().max(1.0);
        (1..=steps as u32).map(move |k| {
            let (sine, cosine) = (first + angle * f64::from(k) / steps).sin_cos();
            let (ahead, left) = (ahead + radius * cosine, side * (beside + radius * sine));
            [x + ahead * cos - left * sin, y + ahead * sin + left * cos]
        })
    };
    Some(route.detoured(i + 1, j, arcs.into_iter().flat_map(arc)))
}
