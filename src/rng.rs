//! The seed tree: every random number of a run is a function of the user's seed and a path of
//! labels.
//!
//! Streams are derived, never shared: the spawn places of an episode depend on
//! `(seed, "episodes", index)` alone. Evaluations in between, another number of worlds or a resumed
//! run therefore shift no other stream, and a checkpoint needs counters only, no generator state.

use rand::{Rng as _, RngExt as _, SeedableRng};

use crate::fnv::Fnv;

/// The generator of every stream.
pub type Rng = rand_chacha::ChaCha8Rng;

/// A node of the seed tree.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Seed([u8; 32]);

impl Seed {
    /// Returns the root of the tree for a user's seed.
    pub fn new(seed: u64) -> Self {
        let mut key = [0; 32];
        key[..8].copy_from_slice(&seed.to_le_bytes());
        Self(key).derive(0x6977_6f6c)
    }

    /// Returns the child with a name.
    #[must_use]
    pub fn child(&self, label: &str) -> Self {
        let mut hash = Fnv::new();
        hash.bytes(label.as_bytes());
        // Names set the low bit, which indices do not.
        self.derive(hash.value() | 1)
    }

    /// Returns the child with an index (below 2⁶³).
    #[must_use]
    pub fn index(&self, i: u64) -> Self {
        self.derive(i << 1)
    }

    /// Returns a generator for this node.
    pub fn rng(&self) -> Rng {
        Rng::from_seed(self.0)
    }

    /// Returns one number (31 bits) for programs that take a plain seed, such as SUMO.
    pub fn word(&self) -> u64 {
        self.rng().next_u64() & 0x7fff_ffff
    }

    fn derive(&self, stream: u64) -> Self {
        let mut rng = Rng::from_seed(self.0);
        rng.set_stream(stream.wrapping_add(1));
        let mut key = [0; 32];
        rng.fill_bytes(&mut key);
        Self(key)
    }
}

/// Draws a uniform number in `[-1, 1)`.
pub fn symmetric(rng: &mut Rng) -> f64 {
    rng.random::<f64>() * 2.0 - 1.0
}

/// Draws a uniform number in 0..1.
pub fn uniform(rng: &mut Rng) -> f64 {
    rng.random()
}

/// Draws a uniform integer below `bound`, which must be positive.
pub fn below(rng: &mut Rng, bound: usize) -> usize {
    rng.random_range(0..bound)
}

/// Fills `out` with independent standard normal numbers (Box–Muller).
pub fn fill_normal(rng: &mut Rng, out: &mut [f32]) {
    for pair in out.chunks_mut(2) {
        let radius = (-2.0 * (1.0 - rng.random::<f64>()).ln()).sqrt();
        let (sin, cos) = (std::f64::consts::TAU * rng.random::<f64>()).sin_cos();
        pair[0] = (radius * cos) as f32;
        if let Some(second) = pair.get_mut(1) {
            *second = (radius * sin) as f32;
        }
    }
}

/// Fills `out` with independent numbers that are uniform in 0..1.
pub fn fill_uniform(rng: &mut Rng, out: &mut [f32]) {
    out.fill_with(|| rng.random());
}

/// Fills `out` with independent standard logistic numbers, the difference of two Gumbel variables:
/// the noise of a two-class Gumbel-softmax.
pub fn fill_logistic(rng: &mut Rng, out: &mut [f32]) {
    for x in out {
        let u = rng.random::<f64>().clamp(1e-9, 1.0 - 1e-9);
        *x = (u / (1.0 - u)).ln() as f32;
    }
}

/// Shuffles `items` in place (Fisher–Yates).
pub fn shuffle<T>(rng: &mut Rng, items: &mut [T]) {
    for i in (1..items.len()).rev() {
        items.swap(i, below(rng, i + 1));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_are_reproducible_and_apart() {
        let root = Seed::new(7);
        assert_eq!(root.child("a").index(3), Seed::new(7).child("a").index(3));
        let nodes =
            [root, root.child("a"), root.child("b"), root.index(0), root.index(1), Seed::new(8)];
        for (i, a) in nodes.iter().enumerate() {
            for b in &nodes[i + 1..] {
                assert_ne!(a, b);
            }
        }
    }

    #[test]
    fn noise_has_the_right_moments() {
        let mut rng = Seed::new(1).rng();
        let mut xs = vec![0.0; 200_001];
        fill_normal(&mut rng, &mut xs);
        let moments = |xs: &[f32]| {
            let n = xs.len() as f64;
            let mean = xs.iter().map(|&x| f64::from(x)).sum::<f64>() / n;
            (mean, xs.iter().map(|&x| (f64::from(x) - mean).powi(2)).sum::<f64>() / n)
        };
        let (mean, variance) = moments(&xs);
        assert!(mean.abs() < 0.01 && (variance - 1.0).abs() < 0.02, "{mean} {variance}");
        fill_logistic(&mut rng, &mut xs);
        let (mean, variance) = moments(&xs);
        assert!(
            mean.abs() < 0.02 && (variance - std::f64::consts::PI.powi(2) / 3.0).abs() < 0.1,
            "{mean} {variance}"
        );
    }

    #[test]
    fn shuffle_is_a_permutation() {
        let mut xs: Vec<_> = (0..100).collect();
        shuffle(&mut Seed::new(2).rng(), &mut xs);
        assert_ne!(xs, (0..100).collect::<Vec<_>>());
        xs.sort_unstable();
        assert_eq!(xs, (0..100).collect::<Vec<_>>());
    }
}
