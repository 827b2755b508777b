//! Measures what a latent predicts beyond the observation from which it is computed.
//!
//! A decoder predicts a target (the privileged state, or the agent's message) from the latent. Much
//! of the target may already be contained in the observation, and then predicting it shows nothing.
//! The decoder is therefore also evaluated on only those features of the target that the
//! observation does not determine, in comparison with a linear probe: ridge regression from the raw
//! observation to the target.
//!
//! The probe is fitted on the episodes with even numbers. The probe and the decoder are compared on
//! the episodes with odd numbers, so that no episode is used for both.

use std::collections::BTreeSet;

use nalgebra::{DMatrix, DVector};
use tch::{Kind, Tensor};

use crate::algo::Reconstruction;
use crate::metrics::{DETERMINED, Knowledge, Probe};

/// Ridge penalty of the regression on standardised features. If a target equals a feature of the
/// observation, the share of its variance that remains unexplained is at most a quarter of this
/// value.
const RIDGE: f64 = 1e-4;
/// Variance below which a feature counts as constant.
const CONSTANT: f64 = 1e-10;
/// Minimum number of episodes in each half; with fewer there is no probe.
const FEWEST_EPISODES: usize = 4;
/// Minimum number of samples per feature of the observation for fitting; with fewer there is no
/// probe.
const FEWEST_SAMPLES: f64 = 10.0;

/// Sums over samples from which [`Knowledge`] is computed. Index 0 is the half for fitting, index 1
/// the half for comparing.
#[derive(Default)]
pub(super) struct Sums {
    /// Products of the observation's features with each other, `[1 + O, 1 + O]`; feature 0 is
    /// always 1.
    observations: [Option<Tensor>; 2],
    episodes: [BTreeSet<u64>; 2],
    targets: Vec<Target>,
}

struct Target {
    name: &'static str,
    halves: [Option<TargetSums>; 2],
}

/// Sums over the samples of one half, for one target.
struct TargetSums {
    /// Products of the observation's features with the target's features, `[1 + O, K]`.
    products: Tensor,
    /// Sums of squares of the target's features, `[K]`.
    squares: Tensor,
    /// Sums of the decoder's squared errors, `[K]`.
    errors: Tensor,
}

impl Sums {
    /// Adds the samples of one decision, with `observation [E, N, O]` and `active [E, N]`; world
    /// `e` plays `episodes[e]`.
    pub(super) fn add(
        &mut self,
        all: &[Reconstruction],
        observation: &Tensor,
        active: &Tensor,
        episodes: &[u64],
    ) {
        if all.is_empty() {
            return;
        }
        let rows = |x: &Tensor, chosen: &Tensor| {
            x.flatten(0, 1).index_select(0, chosen).to_kind(Kind::Double)
        };
        let parity: Vec<i64> = episodes.iter().map(|episode| (episode % 2) as i64).collect();
        let parity = Tensor::from_slice(&parity).unsqueeze(-1);
        for half in 0..2 {
            let here = active.gt(0.0).logical_and(&parity.eq(half as i64));
            let chosen = here.flatten(0, 1).nonzero().squeeze_dim(-1);
            if chosen.numel() == 0 {
                continue;
            }
            let worlds = Vec::<bool>::try_from(here.any_dim(1, false)).expect("flags");
            let playing = episodes
                .iter()
                .zip(worlds)
                .filter(|(_, plays)| *plays)
                .map(|(episode, _)| *episode);
            self.episodes[half].extend(playing);
            let x = rows(observation, &chosen);
            let x =
                Tensor::cat(&[&Tensor::ones([x.size()[0], 1], (Kind::Double, x.device())), &x], 1);
            let transposed = x.tr();
            accumulate(&mut self.observations[half], transposed.matmul(&x));
            for Reconstruction { name, prediction, target } in all {
                let (prediction, target) = (rows(prediction, &chosen), rows(target, &chosen));
                let sum = |x: Tensor| x.sum_dim_intlist(&[0_i64][..], false, Kind::Double);
                let sums = TargetSums {
                    products: transposed.matmul(&target),
                    squares: sum(target.square()),
                    errors: sum((prediction - target).square()),
                };
                let place =
                    self.targets.iter().position(|known| known.name == *name).unwrap_or_else(
                        || {
                            self.targets.push(Target { name, halves: [None, None] });
                            self.targets.len() - 1
                        },
                    );
                match &mut self.targets[place].halves[half] {
                    Some(known) => {
                        known.products += sums.products;
                        known.squares += sums.squares;
                        known.errors += sums.errors;
                    }
                    none => *none = Some(sums),
                }
            }
        }
    }

    pub(super) fn finish(&self) -> Vec<Knowledge> {
        self.targets.iter().map(|target| self.knowledge(target)).collect()
    }

    fn knowledge(&self, target: &Target) -> Knowledge {
        let (mut count, mut sums): (f64, Option<Moments>) = (0.0, None);
        let halves = [0, 1].map(|half| {
            Some(Moments::new(self.observations[half].as_ref()?, target.halves[half].as_ref()?))
        });
        for half in halves.iter().flatten() {
            count += half.count;
            sums = Some(sums.map_or_else(|| half.clone(), |sums| sums.plus(half)));
        }
        let (errors, variances) =
            sums.map_or_else(Default::default, |sums| (sums.errors(), sums.variances()));
        let features = errors.len().max(1) as f64;
        let error = errors.iter().sum::<f64>() / features;
        let explained = explained(&errors, &variances, &vec![true; errors.len()]).unwrap_or(0.0);
        let enough =
            self.episodes.iter().all(|episodes| episodes.len() >= FEWEST_EPISODES) && count > 0.0;
        let probe = match &halves {
            [Some(fit), Some(test)] if enough => probe(fit, test),
            _ => None,
        };
        Knowledge { name: target.name.to_owned(), error, explained, probe }
    }
}

fn accumulate(sum: &mut Option<Tensor>, more: Tensor) {
    match sum {
        Some(sum) => *sum += more,
        None => *sum = Some(more),
    }
}

/// Returns 1 − errors / variances, summed over the chosen features; `None` if their variance is 0.
fn explained(errors: &[f64], variances: &[f64], chosen: &[bool]) -> Option<f64> {
    let sum = |values: &[f64]| {
        values.iter().zip(chosen).filter(|(_, chosen)| **chosen).map(|(v, _)| v).sum::<f64>()
    };
    let variance = sum(variances);
    (variance > 0.0).then(|| 1.0 - sum(errors) / variance)
}

/// The sums of one half as matrices.
#[derive(Clone)]
struct Moments {
    count: f64,
    /// `[1 + O, 1 + O]`
    gram: DMatrix<f64>,
    /// `[1 + O, K]`
    products: DMatrix<f64>,
    squares: DVector<f64>,
    errors: DVector<f64>,
}

impl Moments {
    fn new(observations: &Tensor, target: &TargetSums) -> Self {
        let numbers = |x: &Tensor| Vec::<f64>::try_from(x.flatten(0, -1)).expect("numbers");
        let matrix = |x: &Tensor| {
            let size = x.size();
            DMatrix::from_row_slice(size[0] as usize, size[1] as usize, &numbers(x))
        };
        let gram = matrix(observations);
        Self {
            count: gram[(0, 0)],
            gram,
            products: matrix(&target.products),
            squares: DVector::from_vec(numbers(&target.squares)),
            errors: DVector::from_vec(numbers(&target.errors)),
        }
    }

    fn plus(self, other: &Self) -> Self {
        Self {
            count: self.count + other.count,
            gram: self.gram + &other.gram,
            products: self.products + &other.products,
            squares: self.squares + &other.squares,
            errors: self.errors + &other.errors,
        }
    }

    /// Returns the decoder's mean squared error of each feature of the target.
    fn errors(&self) -> Vec<f64> {
        self.errors.iter().map(|error| error / self.count).collect()
    }

    /// Returns the mean of a feature of the target.
    fn mean(&self, feature: usize) -> f64 {
        self.products[(0, feature)] / self.count
    }

    /// Returns the variance of each feature of the target.
    fn variances(&self) -> Vec<f64> {
        let variance = |(k, square): (usize, &f64)| square / self.count - self.mean(k).powi(2);
        self.squares.iter().enumerate().map(variance).collect()
    }
}

/// Returns the weights of the ridge regression, `[1 + O, K]`, with the intercept in row 0; `None`
/// with too few samples.
fn fit(moments: &Moments) -> Option<DMatrix<f64>> {
    let (n, targets) = (moments.count, moments.products.ncols());
    let mean = |i: usize| moments.gram[(0, i)] / n;
    let covariance = |i: usize, j: usize| moments.gram[(i, j)] / n - mean(i) * mean(j);
    let varying: Vec<usize> =
        (1..moments.gram.nrows()).filter(|&i| covariance(i, i) > CONSTANT).collect();
    if varying.is_empty() || n < FEWEST_SAMPLES * varying.len() as f64 {
        return None;
    }
    let scale: Vec<f64> = varying.iter().map(|&i| covariance(i, i).sqrt()).collect();
    let correlation = DMatrix::from_fn(varying.len(), varying.len(), |a, b| {
        covariance(varying[a], varying[b]) / (scale[a] * scale[b])
            + if a == b { RIDGE } else { 0.0 }
    });
    let cross = DMatrix::from_fn(varying.len(), targets, |a, k| {
        (moments.products[(varying[a], k)] / n - mean(varying[a]) * moments.mean(k)) / scale[a]
    });
    let slopes = correlation.cholesky()?.solve(&cross);
    let mut weights = DMatrix::zeros(moments.gram.nrows(), targets);
    for k in 0..targets {
        let mut intercept = moments.mean(k);
        for (a, &i) in varying.iter().enumerate() {
            let slope = slopes[(a, k)] / scale[a];
            weights[(i, k)] = slope;
            intercept -= slope * mean(i);
        }
        weights[(0, k)] = intercept;
    }
    Some(weights)
}

/// Fits the probe on one half and compares it with the decoder on the other.
fn probe(fitted: &Moments, test: &Moments) -> Option<Probe> {
    let weights = fit(fitted)?;
    let fitted_variances = fitted.variances();
    let (variances, errors) = (test.variances(), test.errors());
    let predicted = &test.gram * &weights;
    let mean_square = |k: usize| {
        let own = weights.column(k);
        let square = test.squares[k] - 2.0 * own.dot(&test.products.column(k))
            + own.dot(&predicted.column(k));
        (square / test.count).max(0.0)
    };
    let probed: Vec<f64> = (0..variances.len()).map(mean_square).collect();
    let varies: Vec<bool> = variances
        .iter()
        .zip(&fitted_variances)
        .map(|(a, b)| *a > CONSTANT && *b > CONSTANT)
        .collect();
    let open: Vec<bool> = (0..variances.len())
        .map(|k| varies[k] && 1.0 - probed[k] / variances[k] < DETERMINED)
        .collect();
    let count = |flags: &[bool]| flags.iter().filter(|flag| **flag).count();
    Some(Probe {
        samples: test.count as u64,
        features: count(&varies),
        explained: explained(&probed, &variances, &varies)?,
        undetermined: count(&open),
        undetermined_explained: explained(&errors, &variances, &open),
        undetermined_probe_explained: explained(&probed, &variances, &open),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::{self, Seed};

    const WORLDS: usize = 16;
    const AGENTS: usize = 2;

    /// Returns the result for synthetic samples: `rounds` times 16 episodes of `steps` decisions.
    /// `of` returns observation, target and prediction of a sample, given the episode number and a
    /// source of standard normal numbers.
    fn knowledge(
        rounds: u64,
        steps: u64,
        mut of: impl FnMut(u64, &mut dyn FnMut() -> f32) -> [Vec<f32>; 3],
    ) -> Knowledge {
        let mut sums = Sums::default();
        let mut source = Seed::new(5).rng();
        let mut normal = || {
            let mut one = [0.0];
            rng::fill_normal(&mut source, &mut one);
            one[0]
        };
        for round in 0..rounds {
            let episodes: Vec<u64> =
                (0..WORLDS as u64).map(|world| WORLDS as u64 * round + world).collect();
            for _ in 0..steps {
                let mut all: [Vec<f32>; 3] = Default::default();
                for &episode in &episodes {
                    for _ in 0..AGENTS {
                        let sample = of(episode, &mut normal);
                        all.iter_mut().zip(sample).for_each(|(all, one)| all.extend(one));
                    }
                }
                let [observation, target, prediction] = all.map(|values| {
                    Tensor::from_slice(&values).view([WORLDS as i64, AGENTS as i64, -1])
                });
                let active =
                    Tensor::ones([WORLDS as i64, AGENTS as i64], (Kind::Float, tch::Device::Cpu));
                sums.add(
                    &[Reconstruction { name: "world", prediction, target }],
                    &observation,
                    &active,
                    &episodes,
                );
            }
        }
        let [only] = &sums.finish()[..] else { panic!("one target") };
        only.clone()
    }

    fn close(found: f64, expected: f64, tolerance: f64) {
        assert!(
            (found - expected).abs() <= tolerance,
            "{found} is not within {tolerance} of {expected}"
        );
    }

    #[test]
    fn what_the_observation_holds_is_determined_and_what_is_independent_is_not() {
        // The target consists of a copy of a feature, a sum of two features, a constant, and a
        // number that is not observed. The decoder predicts the last exactly and the first two not
        // at all.
        let found = knowledge(4, 20, |_, normal| {
            let [a, b, hidden] = [normal(), normal(), normal()];
            [
                vec![a, b, 0.5],
                vec![a, 0.3 * a - 2.0 * b + 1.0, 0.25, hidden],
                vec![0.0, 0.0, 0.25, hidden],
            ]
        });
        let probe = found.probe.clone().expect("enough samples");
        assert_eq!((probe.features, probe.undetermined, probe.samples), (3, 1, 4 * 8 * 20 * 2));
        close(probe.undetermined_explained.unwrap(), 1.0, 1e-9);
        close(probe.undetermined_probe_explained.unwrap(), 0.0, 0.03);
        // The variances are 1, 4.09 and 1; the probe explains all but the last.
        close(probe.explained, 5.09 / 6.09, 0.03);
        // Over all features, the decoder's result is dominated by the features that it does not
        // predict.
        assert!(found.explained < 0.2, "{found:?}");
    }

    #[test]
    fn a_decoder_that_repeats_the_observation_knows_nothing_of_the_rest() {
        let found = knowledge(4, 20, |_, normal| {
            let [a, hidden] = [normal(), normal()];
            [vec![a], vec![2.0 * a, hidden], vec![2.0 * a, 0.0]]
        });
        close(found.explained, 0.8, 0.03);
        let probe = found.probe.expect("enough samples");
        assert_eq!((probe.features, probe.undetermined), (2, 1));
        close(probe.undetermined_explained.unwrap(), 0.0, 0.03);
    }

    #[test]
    fn nothing_is_left_where_everything_is_observed() {
        let found = knowledge(4, 20, |_, normal| {
            let a = normal();
            [vec![a, a], vec![a], vec![0.0]]
        });
        let probe = found.probe.expect("enough samples");
        assert_eq!((probe.undetermined, probe.undetermined_explained), (0, None));
        close(probe.explained, 1.0, 1e-4);
    }

    #[test]
    fn an_episode_is_on_one_side_alone() {
        // The observations identify the episode, and the target is constant within an episode:
        // samples of one episode in both halves would make the target look determined.
        let of_episode = |episode: u64, count: usize| {
            let mut values = vec![0.0; count];
            rng::fill_normal(&mut Seed::new(9).index(episode).rng(), &mut values);
            values
        };
        let found = knowledge(2, 40, |episode, _| {
            let values = of_episode(episode, 17);
            [values[..16].to_vec(), vec![values[16]], vec![0.0]]
        });
        let probe = found.probe.expect("enough samples");
        assert_eq!(probe.undetermined, 1);
        assert!(probe.explained < 0.5, "{probe:?}");
    }

    #[test]
    fn without_samples_enough_there_is_no_probe() {
        let few = |rounds, steps| {
            knowledge(rounds, steps, |_, normal| {
                let observation: Vec<f32> = (0..40).map(|_| normal()).collect();
                [observation, vec![normal()], vec![0.0]]
            })
        };
        assert_eq!(few(1, 20).probe, None, "320 samples to fit 40 features");
        assert!(few(1, 26).probe.is_some());
        let constant = knowledge(1, 20, |_, normal| [vec![normal()], vec![1.0], vec![1.0]]);
        assert_eq!((constant.probe, constant.error, constant.explained), (None, 0.0, 0.0));
    }
}
