//! Exploration noise that is correlated in time.

use crate::rng::{self, Rng};

/// The noise of a rollout's actions: a first-order autoregressive process with variance 1 in every
/// dimension of every agent's action.
///
/// Given the noise of the step before, the noise of a step is Gaussian. Its mean is the part that
/// is [`carried`](Self::carried) over, its standard deviation the share that is drawn anew.
/// Probabilities of actions are those of this distribution. An update takes the noise of the step
/// before as given, a(t−1) − μ(t−1) with the mean μ of the policy that acted, although that mean
/// depends on the weights that are learned. It is taken in units of the standard deviation, which
/// acting and update share, but for learned deviations and updates beside a simulation: there the
/// update's deviation is a little newer. So an action's mean is credited with the effects of
/// later actions as well, by the correlation to the power of the steps between them, as if a
/// deviation from it lasted. That is no unbiased gradient of the mean return; the unbiased one
/// learned more slowly (docs/lab/decision-process.md#the-gradient-under-noise-that-lasts).
pub(super) struct CorrelatedNoise {
    /// Correlation of each dimension with the step before, from 0 to below 1.
    correlation: Vec<f32>,
    /// Noise of the last step.
    values: Vec<f32>,
    drawn: Vec<f32>,
    carried: Vec<f32>,
    log_fresh: Vec<f32>,
    begun: bool,
}

impl CorrelatedNoise {
    /// Creates the noise of `agents` actions, whose dimensions have these correlations, each from 0
    /// to below 1.
    pub(super) fn new(agents: usize, correlation: Vec<f32>) -> Self {
        let zeros = || vec![0.0; agents * correlation.len()];
        let (values, drawn, carried) = (zeros(), zeros(), zeros());
        let log_fresh = vec![0.0; correlation.len()];
        Self { correlation, values, drawn, carried, log_fresh, begun: false }
    }

    /// Returns whether the noise of any dimension is correlated from step to step.
    pub(super) fn is_correlated(&self) -> bool {
        self.correlation.iter().any(|&correlation| correlation > 0.0)
    }

    /// Draws the next step's noise. The result depends only on `rng` and on the earlier steps.
    pub(super) fn advance(&mut self, rng: &mut Rng) {
        rng::fill_normal(rng, &mut self.drawn);
        // The first step has no step before it, but its noise has the same variance.
        for (d, &correlation) in self.correlation.iter().enumerate() {
            let kept = if self.begun { correlation } else { 0.0 };
            let fresh = (1.0 - kept * kept).sqrt();
            self.log_fresh[d] = fresh.ln();
            for i in (d..self.drawn.len()).step_by(self.correlation.len()) {
                self.carried[i] = kept * self.values[i];
                self.values[i] = self.carried[i] + fresh * self.drawn[i];
            }
        }
        self.begun = true;
    }

    /// Makes the noise of these entries independent of the steps before: that of an agent that takes
    /// over a slot. Its strength remains the same.
    pub(super) fn renew(&mut self, entries: std::ops::Range<usize>, rng: &mut Rng) {
        rng::fill_normal(rng, &mut self.values[entries]);
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
    pub(super) fn carried(&self) -> &[f32] {
        &self.carried
    }

    /// Returns the logarithm of the factor on the [`drawn`](Self::drawn) numbers of each dimension.
    pub(super) fn log_fresh(&self) -> &[f32] {
        &self.log_fresh
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
                let fresh = noise.log_fresh()[0].exp();
                let parts = noise.carried().iter().zip(noise.drawn());
                parts.map(|(carried, drawn)| carried + fresh * drawn).collect::<Vec<_>>()
            };
            noise.advance(&mut rng);
            let mut before = whole(&noise);
            for _ in 0..4 {
                noise.advance(&mut rng);
                let now = whole(&noise);
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
    fn renewed_entries_do_not_depend_on_the_past() {
        let renewed = |past: u64| {
            let mut noise = CorrelatedNoise::new(4, vec![0.9]);
            noise.advance(&mut Seed::new(past).rng());
            noise.renew(2..4, &mut Seed::new(7).rng());
            noise.advance(&mut Seed::new(8).rng());
            noise.carried().to_vec()
        };
        let (a, b) = (renewed(1), renewed(2));
        assert_eq!(a[2..], b[2..]);
        assert!(a[0] != b[0] && a[1] != b[1] && a[2] != 0.0);
    }

    #[test]
    fn without_correlation_it_is_what_is_drawn() {
        let mut drawn = vec![0.0; 14];
        let (mut rng, mut same) = (Seed::new(3).rng(), Seed::new(3).rng());
        let mut noise = CorrelatedNoise::new(7, vec![0.0, 0.0]);
        assert!(!noise.is_correlated());
        for _ in 0..3 {
            rng::fill_normal(&mut same, &mut drawn);
            noise.advance(&mut rng);
            assert_eq!(noise.drawn(), drawn);
            assert!(noise.carried().iter().all(|&x| x == 0.0) && noise.log_fresh() == [0.0, 0.0]);
        }
    }

    #[test]
    fn each_dimension_has_its_own_correlation() {
        let mut noise = CorrelatedNoise::new(5, vec![0.0, 0.9]);
        assert!(noise.is_correlated());
        for t in 0..3 {
            noise.advance(&mut Seed::new(t).rng());
        }
        let fresh = [0.0, 0.5 * (1.0_f32 - 0.81).ln()];
        assert!(noise.log_fresh().iter().zip(fresh).all(|(x, y)| (x - y).abs() < 1e-5));
        for pair in noise.carried().chunks(2) {
            assert!(pair[0] == 0.0 && pair[1] != 0.0, "{pair:?}");
        }
    }
}
