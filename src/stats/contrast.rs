//! Comparisons of groups of trained runs: differences of interquartile means, with intervals and
//! p-values of the stratified bootstrap (Agarwal et al. 2021), and Holm's correction for several
//! comparisons.

use super::Estimate;
use super::aggregate::{interquartile_mean, resample, summary};

/// Number of runs in each group from which on the bootstrap's p-values are valid.
pub const RUNS_FOR_P: usize = 5;

/// A comparison of groups of runs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contrast {
    /// The weighted sum of the groups' interquartile means, with its 95 % interval.
    pub difference: Estimate,
    /// Two-sided p-value: twice the smaller share of resamples on either side of 0, 0 included.
    /// The least value depends on the number of resamples. `None` if a group has fewer than
    /// [`RUNS_FOR_P`] runs: with three runs in each of two groups that do not differ, a fifth of
    /// the p-values would be below 0.05.
    pub p: Option<f64>,
}

/// Returns the sum of the groups' interquartile means, each times its weight: 1 and -1 for the
/// difference of two groups, (1, -1, -1, 1) for how much a difference differs from another. Seeds
/// are resampled within each group. `None` if a group has fewer than two runs.
pub fn contrast(groups: &[(f64, Vec<f64>)]) -> Option<Contrast> {
    if groups.is_empty() || groups.iter().any(|(_, runs)| runs.len() < 2) {
        return None;
    }
    let runs: Vec<Vec<f64>> = groups.iter().map(|(_, runs)| runs.clone()).collect();
    let difference = |runs: &[Vec<f64>]| -> f64 {
        let mean = |runs: &Vec<f64>| interquartile_mean(std::slice::from_ref(runs));
        groups.iter().zip(runs).map(|((weight, _), runs)| weight * mean(runs)).sum()
    };
    let values = resample([&runs], false, |[drawn]| difference(drawn));
    let share = |beyond: &dyn Fn(f64) -> bool| {
        let count = values.iter().filter(|value| beyond(**value)).count();
        (count + 1) as f64 / (values.len() + 1) as f64
    };
    let p = 2.0 * share(&|value| value <= 0.0).min(share(&|value| value >= 0.0));
    let p = runs.iter().all(|runs| runs.len() >= RUNS_FOR_P).then_some(p.min(1.0));
    Some(Contrast { difference: summary(difference(&runs), values), p })
}

/// Returns p-values corrected for as many comparisons (Holm 1979): the chance that any of the true
/// null hypotheses is rejected at a level stays below it.
pub fn holm(p: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..p.len()).collect();
    order.sort_by(|&a, &b| p[a].total_cmp(&p[b]));
    let mut corrected = vec![0.0; p.len()];
    let mut least = 0.0_f64;
    for (rank, &which) in order.iter().enumerate() {
        least = least.max((p.len() - rank) as f64 * p[which]).min(1.0);
        corrected[which] = least;
    }
    corrected
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn holm_corrects_as_r_does() {
        // p.adjust(c(0.01, 0.04, 0.03, 0.005), "holm")
        let found = holm(&[0.01, 0.04, 0.03, 0.005]);
        let wanted = [0.03, 0.06, 0.06, 0.02];
        assert!(found.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-12), "{found:?}");
        assert!(holm(&[]).is_empty());
    }

    #[test]
    fn groups_that_differ_are_told_from_groups_that_do_not() {
        let runs = |mean: f64| (0..10).map(|k| mean + f64::from(k % 5) - 2.0).collect::<Vec<_>>();
        let far = contrast(&[(1.0, runs(90.0)), (-1.0, runs(40.0))]).expect("runs");
        assert!(
            (far.difference.mean - 50.0).abs() < 1e-9 && far.p.is_some_and(|p| p < 0.01),
            "{far:?}"
        );
        assert!(far.difference.low > 45.0 && far.difference.high < 55.0, "{far:?}");
        let none = contrast(&[(1.0, runs(90.0)), (-1.0, runs(90.0))]).expect("runs");
        assert!(
            none.p.is_some_and(|p| p > 0.2)
                && none.difference.low < 0.0
                && none.difference.high > 0.0
        );
        // The first difference is 50, the second 0.
        let groups = [(1.0, 90.0), (-1.0, 40.0), (-1.0, 95.0), (1.0, 95.0)];
        let groups = groups.map(|(weight, mean)| (weight, runs(mean)));
        let both = contrast(&groups).expect("runs");
        assert!(
            (both.difference.mean - 50.0).abs() < 1e-9 && both.p.is_some_and(|p| p < 0.01),
            "{both:?}"
        );
        assert_eq!(contrast(&[(1.0, runs(1.0)), (-1.0, vec![1.0])]), None);
        // Of the ten ways to divide these five runs, one is as extreme: no test has p < 0.1.
        let few = contrast(&[(1.0, vec![1.0, 2.0, 3.0]), (-1.0, vec![11.0, 12.0])]).expect("runs");
        assert!(few.p.is_none() && few.difference.mean < -9.0, "{few:?}");
    }

    proptest! {
        #[test]
        fn corrected_values_keep_their_order(p in prop::collection::vec(0.0..=1.0_f64, 1..8)) {
            let corrected = holm(&p);
            for (i, j) in (0..p.len()).flat_map(|i| (0..p.len()).map(move |j| (i, j))) {
                prop_assert!(p[i] > p[j] || corrected[i] <= corrected[j]);
            }
            prop_assert!(p.iter().zip(&corrected).all(|(p, c)| p <= c && *c <= 1.0));
        }
    }
}
