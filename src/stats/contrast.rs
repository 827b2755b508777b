//! Comparisons of groups of trained runs: differences of interquartile means, with the intervals of
//! the stratified bootstrap (Agarwal et al. 2021), p-values, and Holm's correction for several
//! comparisons.

use rand::SeedableRng as _;
use rand::seq::SliceRandom as _;
use rand_chacha::ChaCha8Rng;

use super::Estimate;
use super::aggregate::{interquartile_mean, resample, summary};

/// Number of runs in each of four groups from which on the bootstrap gives a p-value. With ten runs
/// each and no difference, 5.3 % of the p-values are below 0.05, 1.1 % below 0.01 and 0.17 % below
/// 0.001; with five runs, 0.9 % are below 0.001.
pub const RUNS_FOR_P: usize = 10;

/// Number of ways to divide the runs of two groups up to which all of them are tried.
const MOST_DIVISIONS: f64 = 200_000.0;

/// Number of random divisions where there are more.
const DIVISIONS: usize = 20_000;

/// A comparison of groups of runs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contrast {
    /// The weighted sum of the groups' interquartile means, with its 95 % interval.
    pub difference: Estimate,
    /// Two-sided p-value. Of two groups, that of a permutation test: the share of all divisions of
    /// the runs into two groups of these sizes whose difference is at least as large. It is valid for
    /// any number of runs; with five runs each, the least value is 4/252, because the interquartile
    /// mean leaves out the lowest and the highest. Of four groups, that of the
    /// bootstrap: twice the smaller share of resamples on either side of 0; `None` if a group has
    /// fewer than [`RUNS_FOR_P`] runs.
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
    let p = match &runs[..] {
        [one, other] => Some(permuted(one, other)),
        all if all.iter().all(|runs| runs.len() >= RUNS_FOR_P) => {
            Some(2.0 * share(&|value| value <= 0.0).min(share(&|value| value >= 0.0)))
        }
        _ => None,
    };
    Some(Contrast { difference: summary(difference(&runs), values), p: p.map(|p| p.min(1.0)) })
}

/// Returns the two-sided p-value of the permutation test of the difference of interquartile means.
fn permuted(one: &[f64], other: &[f64]) -> f64 {
    let mean = |runs: &[f64]| interquartile_mean(&[runs.to_vec()]);
    let all = [one, other].concat();
    let count = one.len();
    let distance = |chosen: &[bool]| {
        let group = |of: bool| {
            let runs = all.iter().zip(chosen).filter(|(_, chosen)| **chosen == of);
            runs.map(|(run, _)| *run).collect::<Vec<f64>>()
        };
        (mean(&group(true)) - mean(&group(false))).abs()
    };
    let mut chosen: Vec<bool> = (0..all.len()).map(|k| k < count).collect();
    // Rounding must not make equal distances differ.
    let least = distance(&chosen) * (1.0 - 1e-9);
    let ways = (0..count).map(|k| (all.len() - k) as f64 / (k + 1) as f64).product::<f64>();
    if ways > MOST_DIVISIONS {
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        let mut far = || {
            chosen.shuffle(&mut rng);
            distance(&chosen) >= least
        };
        let beyond = (0..DIVISIONS).filter(|_| far()).count();
        return (beyond + 1) as f64 / (DIVISIONS + 1) as f64;
    }
    let (mut beyond, mut tried) = (0_u64, 0_u64);
    loop {
        tried += 1;
        beyond += u64::from(distance(&chosen) >= least);
        if !next_division(&mut chosen) {
            return beyond as f64 / tried as f64;
        }
    }
}

/// Changes a division into the next one in descending lexical order; returns whether there is one.
fn next_division(chosen: &mut [bool]) -> bool {
    let Some(last) = (1..chosen.len()).rev().find(|&k| chosen[k - 1] && !chosen[k]) else {
        return false;
    };
    let later = chosen[last..].iter().filter(|chosen| **chosen).count();
    chosen[last - 1] = false;
    for (k, chosen) in chosen[last..].iter_mut().enumerate() {
        *chosen = k <= later;
    }
    true
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
        let few = groups.each_ref().map(|(weight, runs)| (*weight, runs[..9].to_vec()));
        assert_eq!(contrast(&few).expect("runs").p, None);
    }

    #[test]
    fn p_values_of_two_groups_are_those_of_the_permutation_test() {
        // Of the ten ways to divide these five runs, this one has the largest difference.
        let few = contrast(&[(1.0, vec![1.0, 2.0, 3.0]), (-1.0, vec![11.0, 12.0])]).expect("runs");
        assert!(few.difference.mean < -9.0 && few.p == Some(0.1), "{few:?}");
        // scipy.stats.permutation_test of the difference of trim_mean(x, 0.25), all divisions.
        let one = vec![96.0, 96.1, 96.2, 96.3, 96.4];
        let other = vec![96.65, 96.7, 96.8, 96.9, 97.0];
        let five = contrast(&[(1.0, one), (-1.0, other)]).expect("runs");
        assert_eq!(five.p, Some(4.0 / 252.0));
        let same = contrast(&[(1.0, vec![5.0; 4]), (-1.0, vec![5.0; 4])]).expect("runs");
        assert_eq!(same.p, Some(1.0));
        // Of many runs, some divisions are drawn.
        let far = |mean: f64| (0..15).map(|k| mean + f64::from(k % 5)).collect::<Vec<_>>();
        let many = contrast(&[(1.0, far(0.0)), (-1.0, far(9.0))]).expect("runs");
        assert!(many.p.is_some_and(|p| p < 1e-3), "{many:?}");
    }

    #[test]
    fn every_division_comes_once() {
        for (all, count) in [(1, 1), (4, 2), (5, 3), (6, 1)] {
            let mut chosen: Vec<bool> = (0..all).map(|k| k < count).collect();
            let mut known = std::collections::BTreeSet::from([chosen.clone()]);
            while next_division(&mut chosen) {
                assert_eq!(chosen.iter().filter(|chosen| **chosen).count(), count);
                assert!(known.insert(chosen.clone()), "{chosen:?} twice");
            }
            let ways: usize = [(1, 1), (4, 6), (5, 10), (6, 6)]
                .into_iter()
                .find(|(of, _)| *of == all)
                .map(|(_, ways)| ways)
                .expect("listed");
            assert_eq!(known.len(), ways, "{count} of {all}");
        }
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
