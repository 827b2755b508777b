//! Exploration noise that is correlated in time.

use crate::rng::{self, Rng};

/// The noise of a rollout's actions: standard normal at each step, that of throttle and brake correlated from one to the next. That of
/// steering, where there is any, is not: a wheel that is held wrong for long leads off the road.
pub(super) struct CorrelatedNoise {
    correlation: f32,
    actions: usize,
    values: Vec<f32>,
    drawn: Vec<f32>,
    begun: bool,
}

impl CorrelatedNoise {
    /// For so many agents with so many actions each, of which the throttle is the last; `correlation` is from 0 to below 1.
    pub(super) fn new(agents: usize, actions: usize, correlation: f32) -> Self {
        let count = agents * actions;
        Self { correlation, actions, values: vec![0.0; count], drawn: vec![0.0; count], begun: false }
    }

    /// The next step's. What `rng` gives is all that it depends on, besides the steps before.
    pub(super) fn next(&mut self, rng: &mut Rng) -> &[f32] {
        rng::fill_normal(rng, &mut self.drawn);
        // The first step's is as strong as that of all others.
        let (kept, new) =
            if self.begun { (self.correlation, (1.0 - self.correlation.powi(2)).sqrt()) } else { (0.0, 1.0) };
        self.begun = true;
        for (values, drawn) in self.values.chunks_mut(self.actions).zip(self.drawn.chunks(self.actions)) {
            let throttle = self.actions - 1;
            values[..throttle].copy_from_slice(&drawn[..throttle]);
            values[throttle] = kept * values[throttle] + new * drawn[throttle];
        }
        &self.values
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
        fn as_strong_at_every_step_and_correlated_as_asked(correlation in 0.0..0.95_f32, seed in 0..u64::MAX) {
            const COUNT: usize = 20_000;
            let mut rng = Seed::new(seed).rng();
            let mut noise = CorrelatedNoise::new(COUNT, 2, correlation);
            let mut before = noise.next(&mut rng).to_vec();
            for _ in 0..4 {
                let now = noise.next(&mut rng).to_vec();
                // Steering, then throttle.
                for (action, correlation) in [0.0, correlation].into_iter().enumerate() {
                    let mean = |of: &dyn Fn(usize) -> f32| {
                        (0..COUNT).map(|i| f64::from(of(2 * i + action))).sum::<f64>() / COUNT as f64
                    };
                    let (first, square) = (mean(&|i| now[i]), mean(&|i| now[i] * now[i]));
                    let product = mean(&|i| now[i] * before[i]);
                    // Six standard errors.
                    prop_assert!(first.abs() < 0.05 && (square - 1.0).abs() < 0.07, "{first} {square}");
                    prop_assert!((product - f64::from(correlation)).abs() < 0.07, "{product}");
                }
                before = now;
            }
        }
    }

    #[test]
    fn without_correlation_it_is_what_is_drawn() {
        let mut drawn = vec![0.0; 7];
        let (mut rng, mut same) = (Seed::new(3).rng(), Seed::new(3).rng());
        let mut noise = CorrelatedNoise::new(7, 1, 0.0);
        for _ in 0..3 {
            rng::fill_normal(&mut same, &mut drawn);
            assert_eq!(noise.next(&mut rng), drawn);
        }
    }
}
