//! Lidar: how far a vehicle sees in every direction, until the body of another vehicle or the end of the road (a line, or a kerb).

use std::f64::consts::TAU;

use super::Features;
use super::geometry::{Pose, stretch};
use super::road::Road;
use super::slots::{Status, Traffic};
use crate::scenario::Lidar;

pub(super) fn describe(lidar: Lidar, features: &mut Features) {
    features.push("lidar", lidar.beams, &[("distance", "the lidar's range", 0.0, 1.0)]);
}

/// Writes one distance per beam, counter-clockwise from straight ahead; 1 where nothing is in range.
pub(super) fn write(lidar: Lidar, road: &Road, traffic: &Traffic, slot: usize, out: &mut [f32]) {
    let own = &traffic.slots[slot].pose;
    for (beam, seen) in out.iter_mut().enumerate() {
        let (sin, cos) = angle(lidar, own, beam).sin_cos();
        *seen = (road.beam([own.x, own.y], [cos, sin], lidar.range) / lidar.range) as f32;
    }
    for (j, other) in traffic.slots.iter().enumerate() {
        let apart = traffic.distance(slot, j);
        let half = other.size.map(|side| side / 2.0);
        let reach = half[0].hypot(half[1]);
        if j == slot || other.status == Status::Empty || apart > lidar.range + reach {
            continue;
        }
        // The beams that may hit its box: those that hit the circle around it.
        let middle = (other.pose.y - own.y).atan2(other.pose.x - own.x) - own.heading;
        let wide = if apart > reach { (reach / apart).asin() } else { TAU / 2.0 };
        let spacing = TAU / lidar.beams as f64;
        let (first, last) = (((middle - wide) / spacing).ceil() as i64, ((middle + wide) / spacing).floor() as i64);
        for beam in first..=last.min(first + lidar.beams as i64 - 1) {
            let beam = beam.rem_euclid(lidar.beams as i64) as usize;
            if let Some(distance) = to_box(own, angle(lidar, own, beam), &other.pose, half) {
                out[beam] = out[beam].min((distance / lidar.range) as f32);
            }
        }
    }
}

fn angle(lidar: Lidar, own: &Pose, beam: usize) -> f64 {
    own.heading + TAU * beam as f64 / lidar.beams as f64
}

/// Distance from a point along a direction to a box \[m\]; 0 from inside.
fn to_box(from: &Pose, direction: f64, target: &Pose, half: [f64; 2]) -> Option<f64> {
    let (sin, cos) = target.heading.sin_cos();
    let (dx, dy) = (from.x - target.x, from.y - target.y);
    let at = [dx * cos + dy * sin, dy * cos - dx * sin];
    let (rise, run) = (direction - target.heading).sin_cos();
    let [enter, leave] = stretch(at, [run, rise], half)?;
    (leave >= 0.0).then_some(enter.max(0.0))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const HALF: [f64; 2] = [2.2575, 0.926];

    proptest! {
        /// Where a beam ends, a tiny box touches the vehicle; just before, it does not.
        #[test]
        fn a_beam_ends_at_the_body(x in -20.0..20.0f64, y in -20.0..20.0f64, h in -4.0..4.0f64, direction in -4.0..4.0f64) {
            const DOT: f64 = 1e-3;
            let (from, target) = (Pose::default(), Pose { x, y, heading: h });
            let dot = |distance: f64| {
                let (sin, cos) = direction.sin_cos();
                let (sin_h, cos_h) = h.sin_cos();
                let (dx, dy) = (distance * cos - x, distance * sin - y);
                (dx * cos_h + dy * sin_h).abs() <= HALF[0] + DOT && (dy * cos_h - dx * sin_h).abs() <= HALF[1] + DOT
            };
            let found = to_box(&from, direction, &target, HALF);
            let first = (0..60_000).map(|k| f64::from(k) * 0.5e-3).find(|distance| dot(*distance));
            match (found, first) {
                (Some(found), Some(first)) => prop_assert!((found - first).abs() < 0.15, "{found} {first}"),
                (None, None) => {}
                // It grazes the dot's margin.
                (None, Some(_)) => prop_assert!(to_box(&from, direction, &target, HALF.map(|h| h + 2.0 * DOT)).is_some()),
                (Some(found), None) => prop_assert!(found > 29.9, "{found}"),
            }
        }
    }
}
