//! Polygons that block sight and radio.

use crate::scenario::Polygon;

/// The polygons of a task.
#[derive(Debug, Clone, Default)]
pub(crate) struct Walls {
    polygons: Vec<Outline>,
}

/// The closed outline of a polygon.
#[derive(Debug, Clone)]
struct Outline {
    /// Corners of the bounding box: `[x_min, y_min, x_max, y_max]` \[m\].
    bounds: [f64; 4],
    corners: Vec<[f64; 2]>,
}

impl Walls {
    pub(super) fn new(polygons: Vec<Polygon>) -> Self {
        let outline = |Polygon { corners, .. }: Polygon| {
            let bounds = corners.iter().fold(
                [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY],
                |[x0, y0, x1, y1], [x, y]| [x0.min(*x), y0.min(*y), x1.max(*x), y1.max(*y)],
            );
            Outline { bounds, corners }
        };
        Self { polygons: polygons.into_iter().map(outline).collect() }
    }

    /// Returns whether the straight line between two points crosses a polygon.
    pub(crate) fn block(&self, a: [f64; 2], b: [f64; 2]) -> bool {
        let [low, high] = [[a[0].min(b[0]), a[1].min(b[1])], [a[0].max(b[0]), a[1].max(b[1])]];
        let near = |outline: &&Outline| {
            let [x0, y0, x1, y1] = outline.bounds;
            low[0] <= x1 && x0 <= high[0] && low[1] <= y1 && y0 <= high[1]
        };
        self.polygons
            .iter()
            .filter(near)
            .any(|outline| outline.sides().any(|side| cross(a, b, side)))
    }

    /// Whether there is no polygon.
    pub(crate) fn is_empty(&self) -> bool {
        self.polygons.is_empty()
    }

    /// Returns whether a point is in a polygon.
    pub(crate) fn contain(&self, [x, y]: [f64; 2]) -> bool {
        let within = |outline: &Outline| {
            // A line to the right leaves a polygon that it begins in: it crosses an odd number of
            // sides.
            let crossed = outline.sides().filter(|[a, b]| {
                (a[1] > y) != (b[1] > y) && x < a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0])
            });
            crossed.count() % 2 == 1
        };
        self.polygons.iter().any(within)
    }

    /// Returns the sides of all polygons.
    pub(crate) fn sides(&self) -> impl Iterator<Item = [[f64; 2]; 2]> + '_ {
        self.polygons.iter().flat_map(Outline::sides)
    }

    /// Returns the corners of each polygon.
    pub(crate) fn corners(&self) -> impl Iterator<Item = &[[f64; 2]]> {
        self.polygons.iter().map(|outline| outline.corners.as_slice())
    }
}

impl Outline {
    fn sides(&self) -> impl Iterator<Item = [[f64; 2]; 2]> + '_ {
        let next = self.corners.iter().cycle().skip(1);
        self.corners.iter().zip(next).map(|(a, b)| [*a, *b])
    }
}

/// Whether two segments have a point in common.
fn cross(a: [f64; 2], b: [f64; 2], [c, d]: [[f64; 2]; 2]) -> bool {
    let side = |p: [f64; 2], q: [f64; 2], r: [f64; 2]| {
        (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])
    };
    let between = side(a, b, c) * side(a, b, d) <= 0.0;
    between && side(c, d, a) * side(c, d, b) <= 0.0
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn square() -> Walls {
        let corners = vec![[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]];
        Walls::new(vec![Polygon { id: "a".into(), corners }])
    }

    #[test]
    fn points_are_in_a_polygon_or_outside() {
        // An L: the square without its upper right quarter.
        let corners =
            vec![[0.0, 0.0], [10.0, 0.0], [10.0, 5.0], [5.0, 5.0], [5.0, 10.0], [0.0, 10.0]];
        let walls = Walls::new(vec![Polygon { id: "l".into(), corners }]);
        let inside = [[1.0, 1.0], [9.0, 4.0], [4.0, 9.0]];
        let outside = [[6.0, 6.0], [-1.0, 5.0], [11.0, 2.0], [4.0, 11.0], [9.0, -0.5]];
        assert!(inside.iter().all(|point| walls.contain(*point)));
        assert!(!outside.iter().any(|point| walls.contain(*point)));
    }

    proptest! {
        /// By the definition: some point of the line is on a side of the square or inside it.
        #[test]
        fn a_line_is_blocked_where_it_meets_the_polygon(
            a in prop::array::uniform2(-20.0..30.0f64),
            b in prop::array::uniform2(-20.0..30.0f64),
        ) {
            let inside = |[x, y]: [f64; 2]| (0.0..=10.0).contains(&x) && (0.0..=10.0).contains(&y);
            prop_assume!(!inside(a) && !inside(b));
            let point = |t: f64| [0, 1].map(|k| a[k] + (b[k] - a[k]) * t);
            let meets = (0..=2000).any(|k| inside(point(f64::from(k) / 2000.0)));
            let blocked = square().block(a, b);
            // A corner may be cut between two of the points.
            prop_assert!(!meets || blocked);
            let margin = |[x, y]: [f64; 2]| (-0.1..=10.1).contains(&x) && (-0.1..=10.1).contains(&y);
            let near = (0..=2000).any(|k| margin(point(f64::from(k) / 2000.0)));
            prop_assert!(near || !blocked);
            prop_assert_eq!(blocked, square().block(b, a));
        }
    }
}
