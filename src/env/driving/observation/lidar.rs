//! Lidar: how far a vehicle sees in every direction, up to another vehicle's body, the end of the
//! road (a line or a kerb), or a polygon that blocks sight.

use std::f64::consts::TAU;

use nalgebra::Vector2;

use super::group::{FeatureGroup, View, Writer};
use crate::env::driving::agents::Status;
use crate::env::driving::collisions::on_two_levels;
use crate::env::driving::geometry::{Size, Stance, direction, to_box};
use crate::env::driving::road::Road;
use crate::env::spec::Described;
use crate::scenario::Lidar;

const BEAM: [Described; 1] = [("distance", "the lidar's range", 0.0, 1.0)];

/// In scenarios with lidar beams.
pub const GROUP: FeatureGroup = FeatureGroup {
    describe: |scenario, features| {
        features.push("lidar", scenario.observation.lidar.beams, &BEAM);
    },
    write,
};

/// Writes one distance per beam in units of the range, counter-clockwise from straight ahead; 1
/// where a beam hits nothing.
fn write(view: &View<'_>, w: &mut Writer<'_>) {
    let (traffic, lidar) = (view.traffic, view.scenario.observation.lidar);
    let own = traffic.stance(view.slot);
    let (mut along, mut ends) = ([[0.0; 2]; Lidar::MOST], [0.0; Lidar::MOST]);
    let mut beams = Beams::new(lidar, own, &mut along[..lidar.beams], &mut ends[..lidar.beams]);
    beams.end_with_road(view.map.road());
    if view.walls_block_sight() {
        view.map.walls.sides().for_each(|side| beams.end_with_line(side));
    }
    for (j, other) in traffic.slots.iter().enumerate() {
        if j == view.slot
            || other.status == Status::Empty
            || on_two_levels(view.map, view.own(), other)
        {
            continue;
        }
        beams.end_with_body(traffic.stance(j), other.size);
    }
    for (seen, distance) in w.rest().iter_mut().zip(ends) {
        *seen = (distance / lidar.range) as f32;
    }
}

/// The beams of a vehicle: their directions and the distances at which they end \[m\].
struct Beams<'a> {
    from: Stance,
    /// Beams per radian.
    density: f64,
    range: f64,
    along: &'a [[f64; 2]],
    ends: &'a mut [f64],
}

impl<'a> Beams<'a> {
    /// Beams from a vehicle at `from`, all as long as the lidar's range. The slices are storage,
    /// one element per beam.
    fn new(lidar: Lidar, from: Stance, along: &'a mut [[f64; 2]], ends: &'a mut [f64]) -> Self {
        ends.fill(lidar.range);
        let density = lidar.beams as f64 / TAU;
        let ((sin, cos), [mut x, mut y]) = (density.recip().sin_cos(), direction(&from));
        for along in &mut *along {
            *along = [x, y];
            (x, y) = (x * cos - y * sin, y * cos + x * sin);
        }
        Self { from, density, range: lidar.range, along, ends }
    }

    /// Returns the angle of a vector, counter-clockwise from straight ahead \[rad\].
    fn bearing(&self, vector: Vector2<f64>) -> f64 {
        bearing(self.from.rotation.inverse_transform_vector(&vector).into())
    }

    /// Ends beams at the distance that `hit` returns for their direction. Only beams within `wide`
    /// radians counter-clockwise from the angle `first` (0: straight ahead) are tested; no hit is
    /// nearer than `nearest` metres.
    fn between(
        &mut self,
        first: f64,
        wide: f64,
        nearest: f64,
        hit: impl Fn([f64; 2]) -> Option<f64>,
    ) {
        // Rounding up by a conversion, which rounds towards zero, is faster than `f64::ceil`.
        let up = |x: f64| x as i64 + i64::from(x > (x as i64) as f64);
        let count = self.along.len() as i64;
        let (from, to) = (up(first * self.density), -up(-(first + wide) * self.density));
        let mut beam = from.rem_euclid(count) as usize;
        for _ in from..=to.min(from + count - 1) {
            let end = &mut self.ends[beam];
            // Most beams have already ended nearer.
            if *end > nearest
                && let Some(distance) = hit(self.along[beam])
            {
                *end = end.min(distance);
            }
            beam = if beam + 1 == self.along.len() { 0 } else { beam + 1 };
        }
    }

    /// Ends beams at the box of another vehicle.
    fn end_with_body(&mut self, body: Stance, size: Size) {
        let half = size.map(|side| side / 2.0);
        let reach = (half[0] * half[0] + half[1] * half[1]).sqrt();
        let there = body.translation.vector - self.from.translation.vector;
        let apart = there.norm();
        if apart > self.range + reach {
            return;
        }
        // Beams that may hit the body: those that hit the circle around it, and a few beside them,
        // as an angle is less than its tangent.
        let middle = self.bearing(there);
        let clear = apart * apart - reach * reach;
        let wide =
            if clear > 0.0 { (reach / clear.sqrt() + SLACK).min(TAU / 2.0) } else { TAU / 2.0 };
        self.between(
            middle - wide,
            2.0 * wide,
            apart - reach,
            to_box(self.from.translation.vector.into(), body, half),
        );
    }

    /// Ends beams at kerbs and lines.
    fn end_with_road(&mut self, road: &Road) {
        let own: [f64; 2] = self.from.translation.vector.into();
        for (end, along) in self.ends.iter_mut().zip(self.along) {
            *end = road.to_kerb(own, *along, self.range);
        }
        road.lines_around(own, self.range, |line| self.end_with_line(line));
    }

    /// Ends beams at a straight line between two points.
    fn end_with_line(&mut self, line: [[f64; 2]; 2]) {
        /// Share of a line's length by which it is extended at both ends, so that rounding lets no
        /// beam pass through an end.
        const EDGE: f64 = 1e-9;
        let own: [f64; 2] = self.from.translation.vector.into();
        let [a, b] = line.map(|p| [p[0] - own[0], p[1] - own[1]]);
        let direction = [b[0] - a[0], b[1] - a[1]];
        let apart = cross(a, direction);
        // Distance of the straight line through both ends.
        let nearest =
            apart.abs() / (direction[0] * direction[0] + direction[1] * direction[1]).sqrt();
        if nearest > self.range {
            return;
        }
        // From the left of a directed line, its end is counter-clockwise of its start.
        let [first, last] =
            if apart > 0.0 { [a, b] } else { [b, a] }.map(|end| self.bearing(end.into()));
        let wide = last - first + SLACK;
        let wide = if wide < 0.0 { wide + TAU } else { wide };
        self.between(first - SLACK, wide + SLACK, nearest * (1.0 - EDGE), |along| {
            let across = cross(along, direction).recip();
            let (distance, place) = (apart * across, cross(a, along) * across);
            (distance >= 0.0 && (-EDGE..=1.0 + EDGE).contains(&place)).then_some(distance)
        });
    }
}

/// An angle larger than the error of [`bearing`] \[rad\].
const SLACK: f64 = 1e-3;

/// Returns the angle of a vector to within 0.0003 rad, much faster than `atan2`. It only selects
/// the beams that may hit something.
fn bearing([x, y]: [f64; 2]) -> f64 {
    let (along, across) = (x.abs(), y.abs());
    let ratio = along.min(across) / along.max(across).max(f64::MIN_POSITIVE);
    let square = ratio * ratio;
    let octant = (((-0.046_496_474_9 * square + 0.159_314_22) * square - 0.327_622_764) * square
        + 1.0)
        * ratio;
    let quadrant = if across > along { TAU / 4.0 - octant } else { octant };
    let half = if x < 0.0 { TAU / 2.0 - quadrant } else { quadrant };
    half.copysign(y)
}

fn cross(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::env::driving::conflicts::crossing;
    use crate::env::driving::geometry::Pose;
    use crate::scenario::{Border, Termination};

    const HALF: [f64; 2] = [2.2575, 0.926];

    proptest! {
        #[test]
        fn bearings_are_near_the_angle(half_turns in -0.9999..0.9999f64, length in 1e-3..200.0f64) {
            let angle = half_turns * TAU / 2.0;
            prop_assert!((bearing([length * angle.cos(), length * angle.sin()]) - angle).abs() < 3e-4);
        }

        /// Beams end where the road does: at its lines, or, on the parking lot, at the line between
        /// the directions and at the kerb, beyond which is no lane.
        #[test]
        fn beams_end_where_the_road_does(
            kerb in any::<bool>(), place in 0_usize..1000, t in 0.0..1.0f64, heading in -4.0..4.0f64, beams in 1_usize..90, range in 2.0..60.0f64,
        ) {
            let (net, border) = if kerb { ("parking_lot/parking_lot", Border::Kerb) } else { ("intersection/arm30", Border::Line) };
            let net = crate::env::driving::tests::net(net);
            let termination = Termination { horizon: 1, wreck_time: 0.0, border, broken_lines: Vec::new() };
            let road = Road::new(&net, HALF.map(|half| 2.0 * half), &termination).unwrap();
            let shape = &net.lanes[place % net.lanes.len()].shape;
            let (a, b) = (shape[0], shape[1]);
            let own = Pose { x: a[0] + t * (b[0] - a[0]), y: a[1] + t * (b[1] - a[1]), heading };
            let from = [own.x, own.y];
            let mut lines = Vec::new();
            road.lines_around([0.0, 0.0], 1e3, |line| lines.push(line));
            let (mut along, mut ends) = (vec![[0.0; 2]; beams], vec![0.0; beams]);
            Beams::new(Lidar { beams, range }, (&own).into(), &mut along, &mut ends).end_with_road(&road);
            for (beam, &end) in ends.iter().enumerate() {
                let angle = heading + TAU * beam as f64 / beams as f64;
                let at = |distance: f64| [from[0] + distance * angle.cos(), from[1] + distance * angle.sin()];
                let line = lines.iter().filter_map(|&[a, b]| crossing(from, at(range), a, b)).map(|(t, _)| t * range);
                let line = line.fold(range, f64::min);
                prop_assert!(end <= line + 1e-6, "{beam}: {end}, but a line after {line}");
                if kerb && end < line - 1e-6 {
                    prop_assert!(road.on_lane(at(end - 1e-6)) && !road.on_lane(at(end + 1e-6)), "{beam}: {end}");
                } else {
                    prop_assert!((end - line).abs() < 1e-6, "{beam}: {end}, a line after {line}");
                    let on = (0..200).map(|k| end * f64::from(k) / 200.0).all(|distance| road.on_lane(at(distance)));
                    prop_assert!(on || !kerb, "{beam}: the kerb is before {end}");
                }
            }
        }

        /// The selection of beams that may hit a body omits none: beams end where a test of every
        /// beam against every body ends them.
        #[test]
        fn no_beam_passes_through_a_body(
            own in (-30.0..30.0f64, -30.0..30.0f64, -4.0..4.0f64), bodies in prop::collection::vec((-30.0..30.0f64, -30.0..30.0f64, -4.0..4.0f64), 1..6),
            beams in 1_usize..90, range in 2.0..60.0f64,
        ) {
            let stance = |(x, y, heading): (f64, f64, f64)| Stance::from(&Pose { x, y, heading });
            let own = stance(own);
            let (mut along, mut ends) = (vec![[0.0; 2]; beams], vec![0.0; beams]);
            let mut found = Beams::new(Lidar { beams, range }, own, &mut along, &mut ends);
            for &body in &bodies {
                found.end_with_body(stance(body), HALF.map(|half| 2.0 * half));
            }
            for (along, end) in along.iter().zip(&ends) {
                let hits = bodies.iter().filter_map(|&body| to_box(own.translation.vector.into(), stance(body), HALF)(*along));
                let nearest = hits.fold(range, f64::min);
                prop_assert!((end - nearest).abs() < 1e-9, "{end} instead of {nearest}");
            }
        }

        /// A beam ends where a tiny box that moves along it first touches the vehicle.
        #[test]
        fn a_beam_ends_at_the_body(x in -20.0..20.0f64, y in -20.0..20.0f64, h in -4.0..4.0f64, direction in -4.0..4.0f64) {
            const DOT: f64 = 1e-3;
            let (from, target) = ([0.0; 2], Stance::from(&Pose { x, y, heading: h }));
            let dot = |distance: f64| {
                let (sin, cos) = direction.sin_cos();
                let (sin_h, cos_h) = h.sin_cos();
                let (dx, dy) = (distance * cos - x, distance * sin - y);
                (dx * cos_h + dy * sin_h).abs() <= HALF[0] + DOT && (dy * cos_h - dx * sin_h).abs() <= HALF[1] + DOT
            };
            let found = to_box(from, target, HALF)([direction.cos(), direction.sin()]);
            let first = (0..60_000).map(|k| f64::from(k) * 0.5e-3).find(|distance| dot(*distance));
            match (found, first) {
                (Some(found), Some(first)) => prop_assert!((found - first).abs() < 0.15, "{found} {first}"),
                (None, None) => {}
                // The tiny box only grazes the vehicle, and the beam misses it.
                (None, Some(_)) => prop_assert!(to_box(from, target, HALF.map(|h| h + 2.0 * DOT))([direction.cos(), direction.sin()]).is_some()),
                (Some(found), None) => prop_assert!(found > 29.9, "{found}"),
            }
        }
    }
}
