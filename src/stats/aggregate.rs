//! Aggregates over seeds and tasks, as defined by Agarwal et al. (2021), "Deep reinforcement
//! learning at the edge of the statistical precipice", and computed by their library rliable. The
//! unit is the seed: one score per trained run.
//!
//! Scores are given as `&[Vec<f64>]`: for each task (a number of vehicles, a scenario) one score
//! per seed. Tasks are the strata of the bootstrap: seeds are resampled within each task, never
//! across tasks.

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use super::{Estimate, mean};

/// Number of resamples of a bootstrap. More resamples change only the third digit of an interval.
pub const RESAMPLES: usize = 2000;

fn all(scores: &[Vec<f64>]) -> Vec<f64> {
    let mut all: Vec<f64> = scores.iter().flatten().copied().collect();
    all.sort_by(f64::total_cmp);
    all
}

/// Returns a statistic of each task; tasks without one are left out.
fn over_tasks(scores: &[Vec<f64>], of: impl Fn(&[f64]) -> Option<f64>) -> Vec<f64> {
    scores.iter().filter_map(|task| of(task)).collect()
}

/// Returns the mean over tasks of the mean over seeds; NaN without scores.
pub fn task_mean(scores: &[Vec<f64>]) -> f64 {
    mean(&over_tasks(scores, mean)).unwrap_or(f64::NAN)
}

/// Returns the median over tasks of the mean over seeds; for a single task, the median over its
/// seeds. NaN without scores.
pub fn median(scores: &[Vec<f64>]) -> f64 {
    let mut values = if let [only] = scores { only.clone() } else { over_tasks(scores, mean) };
    values.sort_by(f64::total_cmp);
    percentile(&values, 0.5)
}

/// Returns the interquartile mean over all runs of all tasks: the mean without the lowest and the
/// highest quarter (each rounded down to whole runs). NaN without scores.
pub fn interquartile_mean(scores: &[Vec<f64>]) -> f64 {
    let all = all(scores);
    let cut = all.len() / 4;
    mean(&all[cut..all.len() - cut]).unwrap_or(f64::NAN)
}

/// Returns the mean shortfall from `target`; scores above `target` have no shortfall. NaN without
/// scores.
pub fn optimality_gap(scores: &[Vec<f64>], target: f64) -> f64 {
    target
        - mean(&all(scores).iter().map(|score| score.min(target)).collect::<Vec<_>>())
            .unwrap_or(f64::NAN)
}

/// Returns the probability that a run of `x` scores higher than a run of `y` on the same task,
/// averaged over tasks (the Mann–Whitney statistic). Ties count half. Tasks without runs of both
/// are left out; NaN if no task remains.
pub fn probability_of_improvement(x: &[Vec<f64>], y: &[Vec<f64>]) -> f64 {
    let won = |a: f64, b: f64| if a > b { 1.0 } else { f64::from(u8::from(a == b)) / 2.0 };
    let task = |(x, y): (&Vec<f64>, &Vec<f64>)| {
        mean(&x.iter().flat_map(|&a| y.iter().map(move |&b| won(a, b))).collect::<Vec<_>>())
    };
    mean(&x.iter().zip(y).filter_map(task).collect::<Vec<_>>()).unwrap_or(f64::NAN)
}

/// Returns the performance profile: for each threshold, the share of runs that score above it (per
/// task, then averaged over tasks).
pub fn performance_profile(scores: &[Vec<f64>], thresholds: &[f64]) -> Vec<f64> {
    let above = |threshold: f64| {
        let share = |task: &[f64]| {
            mean(&task.iter().map(|&s| f64::from(u8::from(s > threshold))).collect::<Vec<_>>())
        };
        mean(&over_tasks(scores, share)).unwrap_or(f64::NAN)
    };
    thresholds.iter().map(|&threshold| above(threshold)).collect()
}

/// Returns the 95 % percentile interval of a statistic of groups of runs by the stratified
/// bootstrap. In each of [`RESAMPLES`] resamples, every task's seeds are drawn with replacement, as
/// many as it has. Equal scores give equal results. `None` without scores.
///
/// `same_runs` says that the tasks of a group are different measurements of the same runs, in the
/// same order: whole runs are drawn then. Tasks of unequal length are treated as independent.
///
/// With fewer than about five seeds these intervals are too narrow; use [`Estimate::t`] then.
pub fn bootstrap<const G: usize>(
    groups: [&[Vec<f64>]; G],
    same_runs: bool,
    statistic: impl Fn([&[Vec<f64>]; G]) -> f64,
) -> Option<Estimate> {
    if groups.iter().all(|group| group.iter().all(Vec::is_empty)) {
        return None;
    }
    Some(summary(statistic(groups), resample(groups, same_runs, &statistic)))
}

/// Returns the statistic of each resample, as [`bootstrap`] draws them.
pub(super) fn resample<const G: usize>(
    groups: [&[Vec<f64>]; G],
    same_runs: bool,
    statistic: impl Fn([&[Vec<f64>]; G]) -> f64,
) -> Vec<f64> {
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let mut drawn = groups.map(<[_]>::to_vec);
    let mut resample = || {
        for (drawn, group) in drawn.iter_mut().zip(groups) {
            let whole_runs = same_runs && group.windows(2).all(|two| two[0].len() == two[1].len());
            let mut runs: Vec<usize> = Vec::new();
            for (number, (drawn, task)) in drawn.iter_mut().zip(group).enumerate() {
                if number == 0 || !whole_runs {
                    runs = task.iter().map(|_| rng.random_range(0..task.len())).collect();
                }
                drawn.iter_mut().zip(&runs).for_each(|(score, &run)| *score = task[run]);
            }
        }
        statistic(drawn.each_ref().map(Vec::as_slice))
    };
    (0..RESAMPLES).map(|_| resample()).collect()
}

/// Returns a statistic with the 95 % percentile interval of its resamples.
pub(super) fn summary(mean: f64, mut resamples: Vec<f64>) -> Estimate {
    resamples.sort_by(f64::total_cmp);
    let (low, high) = (percentile(&resamples, 0.025), percentile(&resamples, 0.975));
    Estimate { mean, low, high }
}

/// Returns the mean curve of several runs with its t interval at each of `steps`. A run is a list
/// of `(step, score)` in order. Its score between two points is that of the earlier point, and
/// after its end that of the last point. Steps at which a run has no point yet are left out.
pub fn sample_efficiency(runs: &[Vec<(f64, f64)>], steps: &[f64]) -> Vec<(f64, Estimate)> {
    let at = |run: &Vec<(f64, f64)>, step: f64| {
        run.iter().take_while(|point| point.0 <= step).last().map(|p| p.1)
    };
    let point = |&step: &f64| {
        let scores: Option<Vec<f64>> = runs.iter().map(|run| at(run, step)).collect();
        Some((step, Estimate::t(&scores?)?))
    };
    steps.iter().filter_map(point).collect()
}

/// Returns a quantile of sorted values with linear interpolation (NumPy's default); NaN without
/// values.
pub fn percentile(sorted: &[f64], share: f64) -> f64 {
    let Some(last) = sorted.len().checked_sub(1) else { return f64::NAN };
    let place = share * last as f64;
    let (below, part) = (place.floor() as usize, place.fract());
    sorted[below] + part * (sorted[(below + 1).min(last)] - sorted[below])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Three tasks with five seeds each.
    fn a() -> Vec<Vec<f64>> {
        vec![
            vec![0.91, 0.95, 0.88, 0.99, 1.00],
            vec![0.42, 0.38, 0.55, 0.47, 0.31],
            vec![0.77, 0.81, 0.69, 0.90, 0.74],
        ]
    }

    fn b() -> Vec<Vec<f64>> {
        vec![
            vec![0.90, 0.85, 0.97, 0.80],
            vec![0.40, 0.35, 0.60, 0.20],
            vec![0.60, 0.81, 0.55, 0.70],
        ]
    }

    fn alone(
        scores: &[Vec<f64>],
        same_runs: bool,
        statistic: fn(&[Vec<f64>]) -> f64,
    ) -> Option<Estimate> {
        bootstrap([scores], same_runs, |[drawn]| statistic(drawn))
    }

    fn close(found: f64, expected: f64, tolerance: f64) {
        assert!(
            (found - expected).abs() <= tolerance,
            "{found} is not within {tolerance} of {expected}"
        );
    }

    /// The expected values come from rliable 1.2.0 and scipy 1.17.1
    /// (`scipy.stats.trim_mean(x, 0.25)` for the interquartile mean).
    #[test]
    fn point_values_are_those_of_rliable() {
        close(interquartile_mean(&a()), 0.746_666_666_666_666_7, 1e-12);
        close(interquartile_mean(&[(0..7).map(|k| f64::from(k * k)).collect()]), 11.0, 1e-12);
        close(optimality_gap(&a(), 1.0), 0.282, 1e-12);
        close(optimality_gap(&a(), 0.9), 0.198_666_666_666_666_55, 1e-12);
        close(median(&a()), 0.782, 1e-12);
        close(task_mean(&a()), 0.718, 1e-12);
        close(probability_of_improvement(&a(), &b()), 0.725, 1e-12);
        let profile = performance_profile(&a(), &[0.0, 0.4, 0.5, 0.81, 0.95]);
        for (found, expected) in
            profile.iter().zip([1.0, 13.0 / 15.0, 11.0 / 15.0, 0.4, 2.0 / 15.0])
        {
            close(*found, expected, 1e-12);
        }
    }

    /// The expected intervals come from `rliable.library.get_interval_estimates` with 50000 and
    /// 20000 resamples.
    #[test]
    fn bootstrap_intervals_are_those_of_rliable() {
        type Case = (fn(&[Vec<f64>]) -> f64, f64, f64);
        let cases: [Case; 4] = [
            (interquartile_mean, 0.7056, 0.7878),
            (task_mean, 0.6847, 0.7527),
            (median, 0.7240, 0.8480),
            (|s| optimality_gap(s, 1.0), 0.2473, 0.3153),
        ];
        for (statistic, low, high) in cases {
            let found = alone(&a(), false, statistic).unwrap();
            close(found.low, low, 0.008);
            close(found.high, high, 0.008);
        }
        let pair = [&a()[..], &b()[..]];
        let found = bootstrap(pair, false, |[x, y]| probability_of_improvement(x, y)).unwrap();
        close(found.mean, 0.725, 1e-12);
        close(found.low, 0.5, 0.02);
        close(found.high, 0.9167, 0.02);
    }

    #[test]
    fn the_bootstrap_draws_within_strata_and_repeats_itself() {
        // Tasks without spread have no uncertainty, however different their means are.
        let flat = [vec![0.1; 4], vec![0.9; 4]];
        let found = alone(&flat, false, task_mean).unwrap();
        assert_eq!((found.low, found.high), (0.5, 0.5));
        assert_eq!(alone(&a(), false, task_mean), alone(&a(), false, task_mean));
        assert_eq!(alone(&[vec![], vec![]], false, task_mean), None);
        assert_eq!(alone(&[], false, task_mean), None);
    }

    #[test]
    fn runs_that_are_seen_often_are_not_more_runs() {
        let once = vec![vec![0.2, 0.5, 0.9, 0.4, 0.7]];
        let often: Vec<Vec<f64>> = std::iter::repeat_n(once[0].clone(), 8).collect();
        let (many, one) =
            (alone(&often, true, task_mean).unwrap(), alone(&once, false, task_mean).unwrap());
        close(many.low, one.low, 1e-12);
        close(many.high, one.high, 1e-12);
        let (apart, together) =
            (alone(&often, false, task_mean).unwrap(), alone(&often, true, task_mean).unwrap());
        assert!(together.high - together.low > 2.0 * (apart.high - apart.low));
    }

    #[test]
    fn missing_scores_leave_no_number() {
        assert!(
            task_mean(&[]).is_nan()
                && median(&[]).is_nan()
                && interquartile_mean(&[vec![]]).is_nan()
        );
        assert!(probability_of_improvement(&[vec![1.0]], &[vec![]]).is_nan());
        close(task_mean(&[vec![], vec![0.25, 0.75]]), 0.5, 1e-15);
    }

    #[test]
    fn curves_hold_their_last_value() {
        let runs =
            vec![vec![(10.0, 0.0), (20.0, 1.0)], vec![(10.0, 0.5), (20.0, 0.6), (30.0, 0.8)]];
        let curve = sample_efficiency(&runs, &[5.0, 10.0, 25.0, 30.0]);
        assert_eq!(curve.iter().map(|point| point.0).collect::<Vec<_>>(), [10.0, 25.0, 30.0]);
        for (point, expected) in curve.iter().zip([0.25, 0.8, 0.9]) {
            close(point.1.mean, expected, 1e-12);
        }
    }
}
