//! Oriented boxes and their overlap: the collision test that does not depend on SUMO.

/// Pose of a vehicle's centre: metres, radians counter-clockwise from +x.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Pose {
    /// \[m\]
    pub x: f64,
    /// \[m\]
    pub y: f64,
    /// \[rad\]
    pub heading: f64,
}

impl Pose {
    /// The pose at `lateral` metres to the left of a point.
    pub(super) fn beside(point: [f64; 2], heading: f64, lateral: f64) -> Pose {
        let (sin, cos) = heading.sin_cos();
        Pose { x: point[0] - lateral * sin, y: point[1] + lateral * cos, heading }
    }

    /// Linear interpolation towards `next` (headings the short way round); `t` in 0..=1.
    #[must_use]
    pub fn towards(&self, next: &Pose, t: f64) -> Pose {
        let turn = (next.heading - self.heading + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU)
            - std::f64::consts::PI;
        Pose { x: self.x + (next.x - self.x) * t, y: self.y + (next.y - self.y) * t, heading: self.heading + turn * t }
    }

    /// Centre distance \[m\].
    pub fn distance(&self, other: &Pose) -> f64 {
        (self.x - other.x).hypot(self.y - other.y)
    }
}

/// Whether two boxes of equal size (`length` × `width`, metres) overlap (separating axes).
pub fn boxes_overlap(a: &Pose, b: &Pose, length: f64, width: f64) -> bool {
    let (dx, dy) = (b.x - a.x, b.y - a.y);
    let reach = length.hypot(width);
    if dx * dx + dy * dy > reach * reach {
        return false;
    }
    let (half_l, half_w) = (length / 2.0, width / 2.0);
    let (sin, cos) = (b.heading - a.heading).sin_cos();
    let (sin, cos) = (sin.abs(), cos.abs());
    // In a box's own axes, the other box reaches this far along its length and across.
    let along = half_l + half_l * cos + half_w * sin;
    let across = half_w + half_l * sin + half_w * cos;
    let separated = |heading: f64| {
        let (s, c) = heading.sin_cos();
        (dx * c + dy * s).abs() > along || (dy * c - dx * s).abs() > across
    };
    !separated(a.heading) && !separated(b.heading)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const LENGTH: f64 = 4.515;
    const WIDTH: f64 = 1.852;

    fn corners(p: &Pose) -> [[f64; 2]; 4] {
        let (s, c) = p.heading.sin_cos();
        [(1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0)].map(|(u, v)| {
            let (l, w) = (u * LENGTH / 2.0, v * WIDTH / 2.0);
            [p.x + l * c - w * s, p.y + l * s + w * c]
        })
    }

    /// Independent oracle: clip one rectangle by the other's half planes; an area remains when they overlap.
    fn overlap_by_clipping(a: &Pose, b: &Pose) -> f64 {
        let mut polygon: Vec<[f64; 2]> = corners(a).to_vec();
        let clip = corners(b);
        for i in 0..4 {
            let (p, q) = (clip[i], clip[(i + 1) % 4]);
            // Corners go clockwise: inside is to the right.
            let side = |r: [f64; 2]| (r[0] - p[0]) * (q[1] - p[1]) - (r[1] - p[1]) * (q[0] - p[0]);
            let mut next = Vec::new();
            for j in 0..polygon.len() {
                let (r, s) = (polygon[j], polygon[(j + 1) % polygon.len()]);
                let (dr, ds) = (side(r), side(s));
                if dr >= 0.0 {
                    next.push(r);
                }
                if dr * ds < 0.0 {
                    let t = dr / (dr - ds);
                    next.push([r[0] + t * (s[0] - r[0]), r[1] + t * (s[1] - r[1])]);
                }
            }
            polygon = next;
        }
        let n = polygon.len();
        (0..n)
            .map(|i| polygon[i][0] * polygon[(i + 1) % n][1] - polygon[(i + 1) % n][0] * polygon[i][1])
            .sum::<f64>()
            .abs()
            / 2.0
    }

    proptest! {
        #[test]
        fn agrees_with_clipping(dx in -6.0..6.0f64, dy in -6.0..6.0f64, h in -4.0..4.0f64, g in -4.0..4.0f64) {
            let a = Pose { x: 3.0, y: -2.0, heading: h };
            let b = Pose { x: 3.0 + dx, y: -2.0 + dy, heading: g };
            let area = overlap_by_clipping(&a, &b);
            // Touching within rounding may fall either way.
            prop_assume!(!(1e-12..1e-6).contains(&area));
            prop_assert_eq!(boxes_overlap(&a, &b, LENGTH, WIDTH), area > 0.0);
            prop_assert_eq!(boxes_overlap(&b, &a, LENGTH, WIDTH), area > 0.0);
        }
    }

    #[test]
    fn interpolates_headings_the_short_way() {
        let a = Pose { x: 0.0, y: 0.0, heading: 3.0 };
        let b = Pose { x: 2.0, y: 0.0, heading: -3.0 };
        let middle = a.towards(&b, 0.5);
        assert!((middle.heading.rem_euclid(std::f64::consts::TAU) - std::f64::consts::PI).abs() < 1e-9);
        assert_eq!(middle.x, 1.0);
    }
}
