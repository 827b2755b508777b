//! Oriented boxes and their overlap: the collision test that does not depend on SUMO.

use nalgebra::{Isometry2, Translation2, UnitComplex, Vector2};

use crate::sumo::net::Path;

/// Pose of a vehicle's centre.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Pose {
    /// x coordinate in the net \[m\].
    pub x: f64,
    /// y coordinate in the net \[m\].
    pub y: f64,
    /// Heading, counter-clockwise from the x axis \[rad\].
    pub heading: f64,
}

impl Pose {
    /// Returns the centre \[m\].
    pub(crate) fn point(&self) -> [f64; 2] {
        [self.x, self.y]
    }

    /// Returns the pose at position `s` of a path.
    pub(crate) fn on(path: &Path, s: f64) -> Self {
        let ([x, y], heading) = path.at(s);
        Self { x, y, heading }
    }

    /// Returns the pose `lateral` metres to the left of a point.
    pub(crate) fn beside(point: [f64; 2], heading: f64, lateral: f64) -> Pose {
        let (sin, cos) = heading.sin_cos();
        Pose { x: point[0] - lateral * sin, y: point[1] + lateral * cos, heading }
    }

    /// Returns the pose `distance` metres behind this one, with the same heading.
    #[must_use]
    pub(crate) fn behind(&self, distance: f64) -> Self {
        let (sin, cos) = self.heading.sin_cos();
        Self { x: self.x - distance * cos, y: self.y - distance * sin, ..*self }
    }

    /// Interpolates linearly towards `next`, headings along the shorter arc; `t` in 0..=1.
    #[must_use]
    pub fn towards(&self, next: &Pose, t: f64) -> Pose {
        let turn = (next.heading - self.heading + std::f64::consts::PI)
            .rem_euclid(std::f64::consts::TAU)
            - std::f64::consts::PI;
        Pose {
            x: self.x + (next.x - self.x) * t,
            y: self.y + (next.y - self.y) * t,
            heading: self.heading + turn * t,
        }
    }

    /// Returns the distance between the centres \[m\].
    pub fn distance(&self, other: &Pose) -> f64 {
        let (dx, dy) = (self.x - other.x, self.y - other.y);
        (dx * dx + dy * dy).sqrt()
    }
}

/// Middle and direction of a box or vehicle, with the direction as a unit vector: a rotation and a
/// translation of the vehicle's own frame (forward, left) into the net.
pub(crate) type Stance = Isometry2<f64>;

impl From<&Pose> for Stance {
    fn from(pose: &Pose) -> Self {
        Self::new(Vector2::new(pose.x, pose.y), pose.heading)
    }
}

/// Returns the stance `lateral` metres to the left of a point, with this unit vector as direction.
pub(crate) fn beside([x, y]: [f64; 2], [cos, sin]: [f64; 2], lateral: f64) -> Stance {
    Stance::from_parts(
        Translation2::new(x - lateral * sin, y + lateral * cos),
        UnitComplex::from_cos_sin_unchecked(cos, sin),
    )
}

/// Length and width of a box \[m\].
pub type Size = [f64; 2];

/// Returns the largest gap between two boxes along any of the four axes of their sides \[m\]: at
/// most their distance, and negative where they overlap.
pub(crate) fn separation((a, a_size): (Stance, Size), (b, b_size): (Stance, Size)) -> f64 {
    let between = b.translation.vector - a.translation.vector;
    let apart = |rotation: UnitComplex<f64>, [along, across]: [f64; 2]| {
        let between = rotation.inverse_transform_vector(&between);
        (between.x.abs() - along).max(between.y.abs() - across)
    };
    let turned = turned(&a, &b);
    apart(a.rotation, reaches(turned, a_size, b_size))
        .max(apart(b.rotation, reaches(turned, b_size, a_size)))
}

/// Whether two boxes overlap (separating axis test).
pub fn boxes_overlap((a, a_size): (&Pose, Size), (b, b_size): (&Pose, Size)) -> bool {
    let (dx, dy) = (b.x - a.x, b.y - a.y);
    let reach = a_size[0].hypot(a_size[1]) / 2.0 + b_size[0].hypot(b_size[1]) / 2.0;
    dx * dx + dy * dy <= reach * reach && separation((a.into(), a_size), (b.into(), b_size)) <= 0.0
}

/// Returns the magnitudes of the cosine and the sine of the angle between two directions.
fn turned(a: &Stance, b: &Stance) -> [f64; 2] {
    let turn = a.rotation.rotation_to(&b.rotation);
    [turn.re.abs(), turn.im.abs()]
}

/// Returns the distances between two centres \[m\], along the length and the width of box `own`,
/// below which box `other` reaches into it; `cos` and `sin` as [`turned`] returns them.
fn reaches([cos, sin]: [f64; 2], own: Size, other: Size) -> [f64; 2] {
    let [own_l, own_w, half_l, half_w] =
        [own[0] / 2.0, own[1] / 2.0, other[0] / 2.0, other[1] / 2.0];
    [own_l + half_l * cos + half_w * sin, own_w + half_l * sin + half_w * cos]
}

/// Returns the unit vector in which a stance points.
pub(crate) fn direction(stance: &Stance) -> [f64; 2] {
    [stance.rotation.re, stance.rotation.im]
}

/// Returns the time \[s\] until two boxes touch if both go straight on at their speeds \[m/s\]: 0
/// where they overlap, `None` where they never touch.
pub(crate) fn time_to_contact(a: (&Pose, Size, f64), b: (&Pose, Size, f64)) -> Option<f64> {
    let stances = [a.0, b.0].map(Stance::from);
    let [own, other] = stances.map(|stance| stance.rotation);
    let between = stances[1].translation.vector - stances[0].translation.vector;
    let velocity =
        [0, 1].map(|axis| b.2 * direction(&stances[1])[axis] - a.2 * direction(&stances[0])[axis]);
    let onto = |vector: Vector2<f64>| {
        let [own, other] = [own, other].map(|axes| axes.inverse_transform_vector(&vector));
        [own.x, own.y, other.x, other.y]
    };
    let turned = turned(&stances[0], &stances[1]);
    let ([l, w], [other_l, other_w]) = (reaches(turned, a.1, b.1), reaches(turned, b.1, a.1));
    // Boxes overlap while they do so along all four axes.
    let [from, to] = stretch(onto(between), onto(velocity.into()), [l, w, other_l, other_w])?;
    (to >= 0.0).then_some(from.max(0.0))
}

/// Returns the first and last time at which a point that starts at `at` and moves by `displacement` per unit
/// of time is within `half` of zero along every axis; `None` if it never is.
pub(crate) fn stretch<const N: usize>(
    at: [f64; N],
    displacement: [f64; N],
    half: [f64; N],
) -> Option<[f64; 2]> {
    let (mut from, mut to) = (f64::NEG_INFINITY, f64::INFINITY);
    for ((at, displacement), half) in at.into_iter().zip(displacement).zip(half) {
        if displacement.abs() < 1e-12 {
            if at.abs() > half {
                return None;
            }
            continue;
        }
        let per_displacement = displacement.recip();
        let times = [(-half - at) * per_displacement, (half - at) * per_displacement];
        (from, to) = (from.max(times[0].min(times[1])), to.min(times[0].max(times[1])));
    }
    (from <= to).then_some([from, to])
}

/// Returns a function that maps a unit vector to the distance from point `from`, in its direction,
/// to a box with sides `2 · half` \[m\]: 0 from inside the box, `None` where the direction misses
/// it.
pub(crate) fn to_box(
    from: [f64; 2],
    target: Stance,
    half: [f64; 2],
) -> impl Fn([f64; 2]) -> Option<f64> {
    let at: [f64; 2] = target.inverse_transform_point(&from.into()).coords.into();
    move |along| {
        let along: [f64; 2] = target.rotation.inverse_transform_vector(&along.into()).into();
        let [enter, leave] = stretch(at, along, half)?;
        (leave >= 0.0).then_some(enter.max(0.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const LENGTH: f64 = 4.515;
    const WIDTH: f64 = 1.852;
    const SIZE: Size = [LENGTH, WIDTH];

    fn corners(p: &Pose) -> [[f64; 2]; 4] {
        let (s, c) = p.heading.sin_cos();
        [(1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0)].map(|(u, v)| {
            let (l, w) = (u * LENGTH / 2.0, v * WIDTH / 2.0);
            [p.x + l * c - w * s, p.y + l * s + w * c]
        })
    }

    /// Independent oracle: returns the area of one rectangle clipped by the other's half planes,
    /// which is positive when they overlap.
    fn overlap_by_clipping(a: &Pose, b: &Pose) -> f64 {
        let mut polygon: Vec<[f64; 2]> = corners(a).to_vec();
        let clip = corners(b);
        for i in 0..4 {
            let (p, q) = (clip[i], clip[(i + 1) % 4]);
            // The corners go clockwise, so the inside is on the right.
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
            .map(|i| {
                polygon[i][0] * polygon[(i + 1) % n][1] - polygon[(i + 1) % n][0] * polygon[i][1]
            })
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
            // Boxes that touch within rounding may count either way.
            prop_assume!(!(1e-12..1e-6).contains(&area));
            prop_assert_eq!(boxes_overlap((&a, SIZE), (&b, SIZE)), area > 0.0);
            prop_assert_eq!(boxes_overlap((&b, SIZE), (&a, SIZE)), area > 0.0);
        }
    }

    proptest! {
        /// Boxes of any size touch at the time of contact and not before; without a contact time
        /// they never touch.
        #[test]
        fn contact_is_when_boxes_begin_to_overlap(
            (x, y) in (-30.0..30.0f64, -30.0..30.0f64), (h, g) in (-4.0..4.0f64, -4.0..4.0f64),
            speeds in (-3.0..20.0f64, 0.0..20.0f64), sizes in ((2.0..12.0f64, 0.6..2.6f64), (2.0..12.0f64, 0.6..2.6f64)),
        ) {
            let (a, b) = (Pose { x: 0.0, y: 0.0, heading: h }, Pose { x, y, heading: g });
            let (own, other) = ([sizes.0.0, sizes.0.1], [sizes.1.0, sizes.1.1]);
            let at = |pose: &Pose, speed: f64, t: f64| {
                let (sin, cos) = pose.heading.sin_cos();
                Pose { x: pose.x + speed * t * cos, y: pose.y + speed * t * sin, heading: pose.heading }
            };
            let overlap = |t: f64, more: f64| {
                let grown = |size: Size| [size[0] + more, size[1] + more];
                boxes_overlap((&at(&a, speeds.0, t), grown(own)), (&at(&b, speeds.1, t), grown(other)))
            };
            match time_to_contact((&a, own, speeds.0), (&b, other, speeds.1)) {
                Some(t) if t < 60.0 => {
                    prop_assert!(overlap(t, 1e-6));
                    prop_assert!(t == 0.0 || (1..100).all(|k| !overlap(t * f64::from(k) / 100.0, -1e-6)));
                }
                Some(_) => {}
                None => prop_assert!((0..600).all(|k| !overlap(f64::from(k) / 20.0, -1e-6))),
            }
        }
    }

    #[test]
    fn interpolates_headings_the_short_way() {
        let a = Pose { x: 0.0, y: 0.0, heading: 3.0 };
        let b = Pose { x: 2.0, y: 0.0, heading: -3.0 };
        let middle = a.towards(&b, 0.5);
        assert!(
            (middle.heading.rem_euclid(std::f64::consts::TAU) - std::f64::consts::PI).abs() < 1e-9
        );
        assert_eq!(middle.x, 1.0);
    }
}
