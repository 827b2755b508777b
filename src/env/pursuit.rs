//! Pure pursuit (Coulter 1992): the front wheels point to the circle through a point ahead on the route.

use std::f64::consts::{FRAC_PI_2, PI};

use super::geometry::Pose;
use super::steering::curvature;
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
    let wheel = (2.0 * steering.wheelbase * bearing.sin() / dx.hypot(dy).max(1.0)).atan();
    (wheel / steering.max_angle.to_radians()).clamp(-1.0, 1.0)
}

/// The way of a vehicle whose route turns back more sharply than it can.
#[derive(Debug, Clone)]
pub struct Around {
    /// Out to the other side first, and back in the outline of a bulb.
    pub path: Path,
    /// The middle of the turn: `s` on the route, and the segment on the way.
    middle: (f64, usize),
}

impl Around {
    /// The way around the first turn back of a route that is too sharp; `None` if there is none. Whether there is road is not asked.
    pub(super) fn of(route: &Path, steering: &Steering) -> Option<Self> {
        let least = curvature(steering, steering.max_angle.to_radians()).recip();
        let heading = |i: usize| {
            let ([x, y], [u, v]) = (route.points[i], route.points[i + 1]);
            (v - y).atan2(u - x)
        };
        let segments = route.points.len().saturating_sub(1);
        // The route turns back between the end of one segment and the beginning of another.
        let turns = |&(i, j): &(usize, usize)| {
            (heading(j) - heading(i)).cos() < -0.99 && route.cumulative[j] - route.cumulative[i + 1] < PI * least
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
        let (before, after) = (route.points[..=i + 1].iter().copied(), route.points[j..].iter().copied());
        let points: Vec<_> = before.chain(arcs.into_iter().flat_map(arc)).chain(after).collect();
        let path = Path::from_points(points, route.widths[i])?;
        let middle = |path: &Path, end: f64| f64::midpoint(route.cumulative[i + 1], path.length() - end);
        let end = route.length() - route.cumulative[j];
        let segment = path.locate(middle(&path, end)).1;
        Some(Self { middle: (middle(route, end), segment), path })
    }

    /// `s` and lateral offset on the way of a vehicle that is at `point`, and at `s` of its route: both legs of the turn are near each
    /// other, and the route tells them apart.
    pub(super) fn locate(&self, point: [f64; 2], s: f64) -> (f64, f64) {
        let (middle, segment) = self.middle;
        let half = if s < middle { 0..segment + 1 } else { segment..self.path.points.len() - 1 };
        let (s, lateral, _) = self.path.nearest_of(point, half);
        (s, lateral)
    }
}
