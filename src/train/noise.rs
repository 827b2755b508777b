//! Exploration noise that is correlated in time.

use crate::rng::{self, Rng};

/// The noise of a rollout's actions: a first-order autoregressive process with variance 1 in every
/// dimension of every agent's action, which begins anew with each trajectory.
///
/// Given the noise of the step before, the noise of a step is Gaussian, with the mean
/// [`mean`](Self::mean) and the variance 1 − [`kept`](Self::kept)². That noise is the action of the
/// step before less its mean, a(t−1) − μ(t−1), so that the probability of an action is that of
/// N(μ(t) + kept · (a(t−1) − μ(t−1)), σ² (1 − kept²)), where both means are the policy's.
pub(super) struct CorrelatedNoise {
    /// Correlation of each dimension with the step before, from 0 to below 1.
    correlation: Vec<f32>,
    /// Noise of the last step.
    values: Vec<f32>,
    drawn: Vec<f32>,
    mean: Vec<f32>,
    kept: Vec<f32>,
}

impl CorrelatedNoise {
    /// Creates the noise of `agents` actions, whose dimensions have these correlations, each from 0
    /// to below 1.
    pub(super) fn new(agents: usize, correlation: Vec<f32>) -> Self {
        let zeros = || vec![0.0; agents * correlation.len()];
        Self { values: zeros(), drawn: zeros(), mean: zeros(), kept: zeros(), correlation }
    }

    /// Returns whether the noise of any dimension is correlated from step to step.
    pub(super) fn is_correlated(&self) -> bool {
        self.correlation.iter().any(|&correlation| correlation > 0.0)
    }

    /// Draws the next step's noise. It begins anew where `lasts`, by the number of an agent, is
    /// false. The result depends only on `rng` and, where it lasts, on the earlier steps.
    pub(super) fn advance(&mut self, rng: &mut Rng, lasts: impl Fn(usize) -> bool) {
        rng::fill_normal(rng, &mut self.drawn);
        let width = self.correlation.len();
        for (i, drawn) in self.drawn.iter().enumerate() {
            let kept = if lasts(i / width) { self.correlation[i % width] } else { 0.0 };
            self.kept[i] = kept;
            self.mean[i] = kept * self.values[i];
            self.values[i] = self.mean[i] + (1.0 - kept * kept).sqrt() * drawn;
        }
    }

    /// Returns the current step's noise.
    pub(super) fn values(&self) -> &[f32] {
        &self.values
    }

    /// Returns the standard normal numbers that were drawn for the current step.
    pub(super) fn drawn(&self) -> &[f32] {
        &self.drawn
    }

    /// Returns the mean of the current step's noise given the step before.
    pub(super) fn mean(&self) -> &[f32] {
        &self.mean
    }

    /// Returns the correlation of the current step's noise with that of the step before.
    pub(super) fn kept(&self) -> &[f32] {
        &self.kept
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::rng::Seed;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]
        #[test]
        fn as_strong_at_every_step_and_correlated_as_asked(
            correlation in 0.0..0.95_f32,
            seed in 0..u64::MAX,
        ) {
            const COUNT: usize = 20_000;
            let mut rng = Seed::new(seed).rng();
            let mut noise = CorrelatedNoise::new(COUNT, vec![correlation]);
            let whole = |noise: &CorrelatedNoise| {
                let fresh = |kept: f32| (1.0 - kept * kept).sqrt();
                let parts = noise.mean().iter().zip(noise.kept()).zip(noise.drawn());
                parts.map(|((mean, kept), drawn)| mean + fresh(*kept) * drawn).collect::<Vec<_>>()
            };
            noise.advance(&mut rng, |_| false);
            let mut before = whole(&noise);
            for _ in 0..4 {
                noise.advance(&mut rng, |_| true);
                let now = whole(&noise);
                prop_assert!(now.iter().zip(noise.values()).all(|(a, b)| (a - b).abs() < 1e-5));
                let mean = |of: &dyn Fn(usize) -> f32| {
                    (0..COUNT).map(|i| f64::from(of(i))).sum::<f64>() / COUNT as f64
                };
                let (first, square) = (mean(&|i| now[i]), mean(&|i| now[i] * now[i]));
                let product = mean(&|i| now[i] * before[i]);
                // The bounds are at least six standard errors.
                prop_assert!(first.abs() < 0.05 && (square - 1.0).abs() < 0.07, "{first} {square}");
                prop_assert!((product - f64::from(correlation)).abs() < 0.07, "{product}");
                before = now;
            }
        }
    }

    #[test]
    fn noise_that_begins_anew_does_not_depend_on_the_past() {
        let anew = |past: u64| {
            let mut noise = CorrelatedNoise::new(2, vec![0.9, 0.5]);
            noise.advance(&mut Seed::new(past).rng(), |_| false);
            noise.advance(&mut Seed::new(8).rng(), |agent| agent == 0);
            assert_eq!(noise.kept(), [0.9, 0.5, 0.0, 0.0]);
            noise.values().to_vec()
        };
        let (a, b) = (anew(1), anew(2));
        assert_eq!(a[2..], b[2..]);
        assert!(a[0] != b[0] && a[1] != b[1]);
    }

    #[test]
    fn without_correlation_it_is_what_is_drawn() {
        let mut drawn = vec![0.0; 14];
        let (mut rng, mut same) = (Seed::new(3).rng(), Seed::new(3).rng());
        let mut noise = CorrelatedNoise::new(7, vec![0.0, 0.0]);
        assert!(!noise.is_correlated());
        for _ in 0..3 {
            rng::fill_normal(&mut same, &mut drawn);
            noise.advance(&mut rng, |_| true);
            assert_eq!((noise.drawn(), noise.values()), (&drawn[..], &drawn[..]));
            assert!(noise.mean().iter().chain(noise.kept()).all(|&x| x == 0.0));
        }
    }

    #[test]
    fn each_dimension_has_its_own_correlation() {
        let mut noise = CorrelatedNoise::new(5, vec![0.0, 0.9]);
        assert!(noise.is_correlated());
        for t in 0..3 {
            noise.advance(&mut Seed::new(t).rng(), |_| t > 0);
        }
        for (kept, mean) in noise.kept().chunks(2).zip(noise.mean().chunks(2)) {
            assert!(kept == [0.0, 0.9] && mean[0] == 0.0 && mean[1] != 0.0, "{kept:?} {mean:?}");
        }
    }
}
