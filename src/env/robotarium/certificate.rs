//! Barrier certificates: the velocities nearest to the desired ones with which robots keep apart
//! (Wang, Ames & Egerstedt 2017, "Safety barrier certificates for collisions-free multirobot
//! systems"; `create_single_integrator_barrier_certificate2` of
//! `rps/utilities/barrier_certificates.py`, with the safety radius of MARBLER's setting `safe`).
//!
//! The velocities `v` minimise `Σ |v_i − v̂_i|²` subject to, for each pair,
//! `−2 eᵀ(v_i − v_j) ≤ γ h³` with `e = x_i − x_j` and `h = |e|² − r²`.

use clarabel::algebra::CscMatrix;
use clarabel::solver::{DefaultSettings, DefaultSolver, IPSolver, NonnegativeConeT};
use nalgebra::Vector2;

/// Safety radius r \[m\].
const RADIUS: f64 = 0.2;
/// Gain γ where robots are apart, and where they are nearer than the radius.
const GAIN: f64 = 100.0;
const UNSAFE_GAIN: f64 = 1e6;
/// Violation of a constraint that counts as rounding \[m²/s\].
const ROUNDING: f64 = 1e-12;

/// The constraint of a pair of robots: `−2 eᵀ(v_i − v_j) ≤ bound`.
struct Pair {
    robots: [usize; 2],
    apart: Vector2<f64>,
    bound: f64,
}

impl Pair {
    fn allows(&self, velocities: &[Vector2<f64>]) -> bool {
        let [i, j] = self.robots;
        -2.0 * self.apart.dot(&(velocities[i] - velocities[j])) <= self.bound + ROUNDING
    }

    /// Changes the velocities of the pair as little as possible so that this constraint holds with
    /// equality: the projection onto its plane.
    fn project(&self, velocities: &mut [Vector2<f64>]) {
        let [i, j] = self.robots;
        let excess = -2.0 * self.apart.dot(&(velocities[i] - velocities[j])) - self.bound;
        let change = self.apart * (excess / (4.0 * self.apart.norm_squared()));
        velocities[i] += change;
        velocities[j] -= change;
    }
}

/// Changes the velocities of points as little as possible so that the points keep apart.
///
/// Only constraints that matter are part of the programme: a minimum under some of the constraints
/// that keeps the others too is the minimum under all of them.
pub(super) fn certify(points: &[Vector2<f64>], velocities: &mut [Vector2<f64>]) {
    let mut others = pairs(points);
    let desired = velocities.to_vec();
    let mut chosen: Vec<Pair> = Vec::new();
    loop {
        let before = chosen.len();
        chosen.extend(others.extract_if(.., |pair| !pair.allows(velocities)));
        if chosen.len() == before {
            return;
        }
        velocities.copy_from_slice(&desired);
        if are_apart(&chosen, velocities.len()) {
            for pair in &chosen {
                pair.project(velocities);
            }
        } else {
            solve(&chosen, velocities);
        }
    }
}

/// Returns whether no robot is in two of the pairs.
fn are_apart(pairs: &[Pair], robots: usize) -> bool {
    let mut seen = vec![false; robots];
    pairs.iter().flat_map(|pair| pair.robots).all(|i| !std::mem::replace(&mut seen[i], true))
}

fn pairs(points: &[Vector2<f64>]) -> Vec<Pair> {
    let numbers = (0..points.len()).flat_map(|i| (i + 1..points.len()).map(move |j| [i, j]));
    let pair = |robots: [usize; 2]| {
        let apart = points[robots[0]] - points[robots[1]];
        let h = apart.norm_squared() - RADIUS * RADIUS;
        let gain = if h >= 0.0 { GAIN } else { UNSAFE_GAIN };
        Pair { robots, apart, bound: gain * h.powi(3) }
    };
    numbers.map(pair).collect()
}

/// Solves the quadratic programme.
fn solve(pairs: &[Pair], velocities: &mut [Vector2<f64>]) {
    let size = 2 * velocities.len();
    let mut objective = CscMatrix::identity(size);
    objective.nzval.fill(2.0);
    let linear: Vec<f64> = velocities.iter().flat_map(|v| [-2.0 * v.x, -2.0 * v.y]).collect();
    let row = |pair: &Pair| {
        let mut row = vec![0.0; size];
        let [i, j] = pair.robots;
        (row[2 * i], row[2 * i + 1]) = (-2.0 * pair.apart.x, -2.0 * pair.apart.y);
        (row[2 * j], row[2 * j + 1]) = (2.0 * pair.apart.x, 2.0 * pair.apart.y);
        row
    };
    let rows: Vec<Vec<f64>> = pairs.iter().map(row).collect();
    let constraints = CscMatrix::from(&rows);
    let bounds: Vec<f64> = pairs.iter().map(|pair| pair.bound).collect();
    let settings = DefaultSettings { verbose: false, ..DefaultSettings::default() };
    let cones = [NonnegativeConeT(pairs.len())];
    let solver = DefaultSolver::new(&objective, &linear, &constraints, &bounds, &cones, settings);
    let mut solver = solver.expect("the sizes of the programme fit");
    solver.solve();
    // Robots can always drive apart, so that there is a solution; the last iterate is one up to the
    // solver's tolerance.
    for (velocity, found) in velocities.iter_mut().zip(solver.solution.x.chunks_exact(2)) {
        *velocity = Vector2::new(found[0], found[1]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn vectors<const N: usize>(all: [[f64; 2]; N]) -> Vec<Vector2<f64>> {
        all.into_iter().map(Vector2::from).collect()
    }

    /// With one active constraint the solution is the projection onto a half space, which the
    /// reference's formula gives by hand: `v = v̂ − a (aᵀv̂ − b) / |a|²`.
    #[test]
    fn two_robots_are_slowed_down_along_their_connection() {
        let points = vectors([[0.0, 0.0], [0.3, 0.0]]);
        let mut velocities = vectors([[0.15, 0.05], [-0.1, 0.0]]);
        // e = (−0.3, 0), h = 0.09 − 0.04 = 0.05, b = 100 · 0.05³ = 0.0125,
        // a = (0.6, 0, −0.6, 0), aᵀv̂ = 0.15, |a|² = 0.72: the excess 0.1375 / 0.72 · 0.6 = 0.11458
        // is taken from each robot's speed towards the other.
        certify(&points, &mut velocities);
        let expected = vectors([[0.15 - 0.114_583_333, 0.05], [-0.1 + 0.114_583_333, 0.0]]);
        for (found, expected) in velocities.iter().zip(&expected) {
            assert!((found - expected).norm() < 1e-6, "{velocities:?}");
        }
    }

    /// Robots that are nearer than the radius drive apart with the larger gain.
    #[test]
    fn robots_that_are_too_near_drive_apart() {
        let points = vectors([[0.0, 0.0], [0.18, 0.0]]);
        let mut velocities = vectors([[0.0, 0.0]; 2]);
        certify(&points, &mut velocities);
        // h = 0.0324 − 0.04 = −0.0076, b = 10⁶ h³ = −0.438976: each speed is 0.438976 / 0.72 · 0.36.
        let speed = 0.438_976 / (2.0 * 0.36 * 0.36) * 0.36;
        assert!((velocities[0].x + speed).abs() < 1e-5, "{velocities:?}");
        assert!((velocities[1].x - speed).abs() < 1e-5, "{velocities:?}");
    }

    /// Four robots, of which two are nearer than the radius: the solution of cvxopt 1.3, which the
    /// reference uses, for the reference's matrices with tolerances of 1e-12.
    #[test]
    fn four_robots_as_in_the_reference() {
        let points = vectors([[0.0, 0.0], [0.25, 0.05], [0.05, -0.24], [-0.15, 0.1]]);
        let mut velocities = vectors([[0.15, 0.0], [-0.12, -0.06], [0.0, 0.14], [0.1, -0.05]]);
        certify(&points, &mut velocities);
        let expected = vectors([
            [0.362_179_695, -0.187_880_093],
            [0.316_037_189, 0.027_207_438],
            [0.080_194_823, -0.244_935_149],
            [-0.628_411_707, 0.435_607_804],
        ]);
        for (found, expected) in velocities.iter().zip(&expected) {
            assert!((found - expected).norm() < 1e-5, "{velocities:?}");
        }
    }

    /// What the constraints allow is not changed by a bit.
    #[test]
    fn allowed_velocities_stay() {
        let points = vectors([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]);
        let desired = vectors([[0.1, 0.0], [-0.1, 0.05], [0.0, -0.15]]);
        let mut velocities = desired.clone();
        certify(&points, &mut velocities);
        assert_eq!(velocities, desired);
    }

    /// The solution keeps all constraints, and no velocities near it that keep them are nearer to
    /// the desired ones. The programme is convex, so that it is the minimum.
    #[test]
    fn the_solution_is_the_minimum() {
        let mut rng = crate::rng::Seed::new(5).rng();
        let mut draw = |scale: f64| scale * crate::rng::symmetric(&mut rng);
        let mut solved = 0;
        for _ in 0..200 {
            let points: Vec<_> = (0..4).map(|_| Vector2::new(draw(0.4), draw(0.4))).collect();
            let desired: Vec<_> = (0..4).map(|_| Vector2::new(draw(0.14), draw(0.14))).collect();
            let mut found = desired.clone();
            certify(&points, &mut found);
            let pairs = pairs(&points);
            let scale = found.iter().map(nalgebra::Matrix::norm).fold(1.0, f64::max);
            for Pair { robots: [i, j], apart, bound } in &pairs {
                let value = -2.0 * apart.dot(&(found[*i] - found[*j]));
                assert!(value <= bound + 1e-6 * scale, "{value} > {bound}");
            }
            let cost = |v: &[Vector2<f64>]| -> f64 {
                v.iter().zip(&desired).map(|(v, d)| (v - d).norm_squared()).sum()
            };
            let best = cost(&found);
            solved += usize::from(best > 0.0);
            for _ in 0..50 {
                let other: Vec<_> =
                    found.iter().map(|v| v + Vector2::new(draw(0.02), draw(0.02))).collect();
                let allowed = pairs.iter().all(|pair| pair.allows(&other));
                assert!(!allowed || cost(&other) >= best - 1e-6 * scale * scale);
            }
        }
        assert!(solved > 100, "{solved} of 200 needed the solver");
    }
}
