//! Initial weights, computed from a Rust generator in `f64`, so that they depend on the seed alone
//! and not on libtorch's global generator, its thread count or its linear algebra.

use crate::rng::{Rng, fill_normal, symmetric};

/// The distribution from which the initial values of one parameter are drawn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Init {
    /// Zero everywhere.
    Zeros,
    /// The same value everywhere.
    Constant(f64),
    /// A `[rows, columns]` matrix with orthonormal rows (orthonormal columns if there are fewer
    /// columns than rows) times a gain, drawn uniformly (Haar measure). This is the distribution of
    /// PyTorch's `init.orthogonal_`.
    Orthogonal(f64),
    /// Normal with mean 0 and this standard deviation.
    Normal(f64),
    /// Normal with mean 0 and standard deviation `gain * sqrt(2 / (rows + columns))`, for this
    /// gain.
    XavierNormal(f64),
    /// Uniform in `[-bound, bound)`, for this bound.
    Uniform(f64),
}

impl Init {
    /// Draws the values of a parameter of shape `shape`, in row-major order.
    ///
    /// # Panics
    /// If the distribution is defined for matrices only and `shape` does not have two dimensions (a
    /// bug in the layer).
    pub fn sample(self, shape: &[i64], rng: &mut Rng) -> Vec<f32> {
        let count = shape.iter().product::<i64>() as usize;
        match self {
            Init::Zeros => vec![0.0; count],
            Init::Constant(value) => vec![value as f32; count],
            Init::Uniform(bound) => (0..count).map(|_| (symmetric(rng) * bound) as f32).collect(),
            Init::Normal(std) => {
                gaussians(count, rng).into_iter().map(|v| (std * v) as f32).collect()
            }
            Init::XavierNormal(gain) => {
                let (rows, columns) = matrix(shape);
                let std = gain * (2.0 / (rows + columns) as f64).sqrt();
                gaussians(count, rng).into_iter().map(|v| (std * v) as f32).collect()
            }
            Init::Orthogonal(gain) => {
                let (rows, columns) = matrix(shape);
                orthogonal(rows, columns, gain, rng)
            }
        }
    }
}

fn matrix(shape: &[i64]) -> (usize, usize) {
    match *shape {
        [rows, columns] => (rows as usize, columns as usize),
        _ => panic!("this initialisation is for matrices, not for shape {shape:?}"),
    }
}

/// Draws `count` standard normal numbers.
fn gaussians(count: usize, rng: &mut Rng) -> Vec<f64> {
    let mut values = vec![0.0_f32; count];
    fill_normal(rng, &mut values);
    values.into_iter().map(f64::from).collect()
}

/// Returns the orthogonal factor of a Gaussian matrix times `gain`, by the Gram–Schmidt process.
///
/// Each vector is orthogonalised twice, which keeps the result orthogonal up to rounding error. The
/// triangular factor has a positive diagonal by construction; this sign convention makes the result
/// uniformly distributed.
fn orthogonal(rows: usize, columns: usize, gain: f64, rng: &mut Rng) -> Vec<f32> {
    let (count, length) = (rows.min(columns), rows.max(columns));
    let mut basis: Vec<Vec<f64>> = Vec::with_capacity(count);
    for _ in 0..count {
        let mut vector = gaussians(length, rng);
        for _ in 0..2 {
            for other in &basis {
                let projection: f64 = other.iter().zip(&vector).map(|(a, b)| a * b).sum();
                for (value, direction) in vector.iter_mut().zip(other) {
                    *value -= projection * direction;
                }
            }
        }
        let norm = vector.iter().map(|v| v * v).sum::<f64>().sqrt();
        for value in &mut vector {
            *value /= norm;
        }
        basis.push(vector);
    }
    let at = |row: usize, column: usize| {
        if rows <= columns { basis[row][column] } else { basis[column][row] }
    };
    (0..rows * columns).map(|i| (gain * at(i / columns, i % columns)) as f32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Seed;

    #[test]
    fn orthogonal_matrices_are_orthogonal() {
        let mut rng = Seed::new(1).rng();
        for (rows, columns) in [(1, 7), (8, 8), (24, 8), (5, 40), (96, 96)] {
            let gain = 1.5;
            let w = Init::Orthogonal(gain).sample(&[rows as i64, columns as i64], &mut rng);
            let at = |i: usize, k: usize| {
                f64::from(if rows <= columns { w[i * columns + k] } else { w[k * columns + i] })
            };
            let (count, length) = (rows.min(columns), rows.max(columns));
            for i in 0..count {
                for j in 0..count {
                    let dot: f64 = (0..length).map(|k| at(i, k) * at(j, k)).sum();
                    let expected = if i == j { gain * gain } else { 0.0 };
                    assert!((dot - expected).abs() < 1e-5, "{rows}x{columns}: <{i},{j}> = {dot}");
                }
            }
        }
    }

    /// Every entry has mean 0 and variance 1/n, as in the uniform distribution over rotations. A
    /// sign convention on the wrong factor would bias the diagonal.
    #[test]
    fn orthogonal_matrices_are_uniform() {
        let mut rng = Seed::new(2).rng();
        let (n, draws) = (4_usize, 4000);
        let (mut sum, mut squares) = (vec![0.0; n * n], vec![0.0; n * n]);
        for _ in 0..draws {
            for (i, v) in Init::Orthogonal(1.0)
                .sample(&[n as i64, n as i64], &mut rng)
                .into_iter()
                .enumerate()
            {
                sum[i] += f64::from(v) / f64::from(draws);
                squares[i] += f64::from(v * v) / f64::from(draws);
            }
        }
        assert!(sum.iter().all(|m| m.abs() < 0.04), "{sum:?}");
        assert!(squares.iter().all(|s| (s - 0.25).abs() < 0.02), "{squares:?}");
    }

    #[test]
    fn moments_and_bounds() {
        let mut rng = Seed::new(3).rng();
        let w = Init::XavierNormal(2.0_f64.sqrt()).sample(&[30, 70], &mut rng);
        let variance = w.iter().map(|v| f64::from(v * v)).sum::<f64>() / 2100.0;
        assert!((variance - 0.04).abs() < 0.006, "{variance}");
        let u = Init::Uniform(0.5).sample(&[1000], &mut rng);
        assert!(
            u.iter().all(|v| v.abs() <= 0.5)
                && u.iter().any(|v| *v > 0.45)
                && u.iter().any(|v| *v < -0.45)
        );
        assert_eq!(Init::Constant(-0.5).sample(&[3], &mut rng), [-0.5; 3]);
    }
}
