//! Pure pursuit (Coulter 1992): the front wheels point to the circle through a point ahead on the route.

use std::f64::consts::{FRAC_PI_2, PI};

use super::geometry::Pose;
use super::steering::least_radius;
use crate::scenario::Steering;
use crate::sumo::net::Path;

/// How far ahead on the way the point lies \[m\].
const LOOK_AHEAD: f64 = 4.0;
/// Radius of a turn back where the route's own is too narrow, and that of swinging out for it, in least radii of the vehicle: with
/// these it stays on the road at 6 m/s.
const BACK: f64 = 1.5;
const SWING: f64 = 2.5;

/// The steering command, -1 to 1 (left), of a vehicle that is at `s` of a way.
pub(super) fn steer(steering: &Steering, way: &Path, s: f64, pose: &Pose) -> f64 {
    let ([x, y], _) = way.at(s + LOOK_AHEAD);
    let (dx, dy) = (x - pose.x, y - pose.y);
    let bearing = dy.atan2(dx) - pose.heading;
    let wheel = (2.0 * steering.wheelbase() * bearing.sin() / dx.hypot(dy).max(1.0)).atan();
    (wheel / steering.max_angle.to_radians()).clamp(-1.0, 1.0)
}

/// What a vehicle follows whose `route` turns back more sharply than it can: out to the other side first, and back in the outline of a
/// bulb, around the first such turn. `None` if there is none. Whether there is road is not asked.
pub(super) fn way_around(route: &Path, steering: &Steering) -> Option<Path> {
    let least = least_radius(steering);
    let heading = |i: usize| {
        let ([x, y], [u, v]) = (route.points[i], route.points[i + 1]);
        (v - y).atan2(u - x)
    };
    let segments = route.points.len().saturating_sub(1);
    // The route turns back between the end of one segment and the beginning of another.
    let turns = |&(i, j): &(usize, usize)| {
        (heading(j) - heading(i)).cos() < -0.99
            && route.cumulative[j] - route.cumulative[i + 1] < PI * least
    };
    let (i, j) = (0..segments).flat_map(|i| (i + 1..segments).map(move |j| (i, j))).find(turns)?;
    let ([x, y], [u, v], heading) = (route.points[i + 1], route.points[j], heading(i));
    let (sin, cos) = heading.sin_cos();
    // Where the bulb begins and ends: at the further of both ends.
    let begin = ((u - x) * cos + (v - y) * sin).max(0.0);
    let across = (v - y) * cos - (u - x) * sin;
    let (half, side) = (across.abs() / 2.0, across.signum());
    let (back, swing) = (BACK * least, SWING * least);
    let out = ((half + swing) / (back + swing)).min(1.0).acos();
    // Arcs as (centre ahead, centre to the side of the turn, radius, first angle, angle), where the way begins.
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
