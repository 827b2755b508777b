//! The schedule of noise, entropy bonus and learning rate, the effect of validations on it, and the
//! criterion for stopping early.
//!
//! Exploration lowers the noise. Annealing lowers it further in its first two thirds, together with
//! the weight of the entropy bonus, and lowers the learning rate in its last third. Annealing
//! begins as soon as a validation succeeds, and at the latest when exploration is over; with
//! `train.anneal_success = 0` it takes place at the end of the run only. Until the task is solved
//! (`train.stop_success`), the learning rate rises and falls again.

use crate::algo::UpdateParameters;
use crate::algo::settings::{Exploration, NoiseMode};
use crate::checkpoint::Progress;
use crate::config::Config;

/// Number of validations that decide whether to stop (`train.stop_success`).
pub(crate) const STOP_VALIDATIONS: usize = 4;

/// Returns the parameters of the next update: learning rate, noise and weight of the entropy bonus.
pub(super) fn update_parameters(config: &Config, progress: &Progress) -> UpdateParameters {
    let (noise, ppo) = (&config.learner.exploration, &config.learner.ppo);
    let between = |from: f64, to: f64, share: f64| from + (to - from) * share;
    let share = ramp(progress.annealed, anneal_steps(config));
    let (noise_share, rate_share) = ((1.5 * share).min(1.0), (3.0 * share - 2.0).max(0.0));
    let explored = Exploration::LOG_STD_EXPLORED.min(noise.log_std_start);
    let exploring =
        between(noise.log_std_start, explored, ramp(progress.step, noise.explore_steps));
    let log_std = between(exploring, noise.log_std_end.min(exploring), noise_share);
    // A step of the same size changes a policy with less noise more.
    let follows = ppo.learning_rate_follows_noise && noise.mode == NoiseMode::Schedule;
    let follow = if follows { log_std.exp() } else { 1.0 };
    UpdateParameters {
        learning_rate: ppo.learning_rate * follow * between(1.0, ppo.learning_rate_end, rate_share),
        log_std,
        entropy_coefficient: ppo.entropy_coefficient * ppo.entropy_end.powf(noise_share),
    }
}

fn ramp(at: u64, length: u64) -> f64 {
    (at as f64 / length.max(1) as f64).min(1.0)
}

/// Adds an iteration of `steps` environment steps to the progress.
pub(super) fn advance(config: &Config, progress: &mut Progress, steps: u64) {
    let whole = anneal_steps(config);
    let left = whole.saturating_sub(progress.annealed);
    // If annealing began after this iteration, it would not be over at the end of the run.
    let ending = progress.step + steps + left > config.steps;
    // A policy that succeeds only with noise fails in validations, which have no noise, and does
    // not learn to succeed without noise while the noise stays. So exploration ends in any case.
    let earned = progress.annealing || is_explored(config, progress);
    if earned || ending {
        progress.annealed += steps;
    }
    if !earned && ending {
        progress.forced += steps;
    }
    progress.step += steps;
}

/// Adds a validation to the progress; `success` is the share of agents that succeeded.
pub(super) fn validated(config: &Config, progress: &mut Progress, success: f64) {
    let train = &config.train;
    progress.recent.push(success);
    let old = progress.recent.len().saturating_sub(STOP_VALIDATIONS);
    progress.recent.drain(..old);
    progress.annealing = train.anneal_success > 0.0 && success >= train.anneal_success;
    if annealed(config, progress) && !solved(config, progress) && train.stop_success > 0.0 {
        // The run keeps its low noise, and the learning rate falls anew, as far as the end of the
        // run leaves time for it.
        let (whole, left) = (anneal_steps(config), config.steps.saturating_sub(progress.step));
        progress.annealed = noise_steps(whole).max(whole.saturating_sub(left));
        progress.forced = progress.forced.min(progress.annealed);
    }
    progress.validated = progress.step;
    // The next multiple of the interval.
    progress.next_validation = (progress.step / train.validate_every + 1) * train.validate_every;
}

/// Adapts the progress of a run of `before` steps to the steps of `config`: annealing that took
/// place only because the run was about to end is taken back.
pub(super) fn extended(config: &Config, progress: &mut Progress, before: u64) {
    if config.steps <= before {
        return;
    }
    progress.annealed = progress.annealed.saturating_sub(progress.forced);
    progress.forced = 0;
    if is_explored(config, progress) && !progress.annealing {
        // The run learns on with its low noise and the full learning rate.
        progress.annealed = progress.annealed.min(noise_steps(anneal_steps(config)));
    }
}

/// Returns whether training can stop: annealing is over and each of the last validations succeeded.
/// A policy whose success varies between validations thus does not end a run.
pub(super) fn solved(config: &Config, progress: &Progress) -> bool {
    let (train, recent) = (&config.train, &progress.recent);
    let enough = recent.len() >= STOP_VALIDATIONS;
    let good = recent.iter().all(|success| *success >= train.stop_success);
    train.stop_success > 0.0 && enough && good && annealed(config, progress)
}

/// Returns whether exploration is over, so that the noise falls further.
fn is_explored(config: &Config, progress: &Progress) -> bool {
    config.train.anneal_success > 0.0 && progress.step >= config.learner.exploration.explore_steps
}

/// Returns the part of annealing in which the noise falls.
fn noise_steps(whole: u64) -> u64 {
    (2 * whole).div_ceil(3)
}

/// Returns the length of annealing in environment steps, at most half of the run.
fn anneal_steps(config: &Config) -> u64 {
    config.train.anneal_steps.min(config.steps / 2)
}

fn annealed(config: &Config, progress: &Progress) -> bool {
    progress.annealed >= anneal_steps(config)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use proptest::prelude::*;
    use toml::Value;

    use super::*;
    use crate::config::Layers;

    fn config() -> Config {
        let scenario = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/intersection.xml");
        let flags = vec![("scenario", Value::String(scenario.display().to_string()))];
        let (mut config, _) =
            Config::resolve(&Layers { flags, ..Layers::default() }).expect("a valid configuration");
        config.steps = 1000;
        config.learner.exploration.explore_steps = 400;
        (config.learner.exploration.log_std_start, config.learner.exploration.log_std_end) =
            (0.0, -2.0);
        (config.learner.ppo.learning_rate, config.learner.ppo.learning_rate_end) = (1e-3, 0.1);
        (config.learner.ppo.entropy_coefficient, config.learner.ppo.entropy_end) = (0.1, 0.01);
        (config.train.anneal_success, config.train.anneal_steps, config.train.validate_every) =
            (0.9, 200, 50);
        config.train.stop_success = 0.95;
        config
    }

    /// Simulates a run in iterations of 10 steps, in which `success` gives the success of each
    /// validation, and returns the progress at its end.
    fn play(
        config: &Config,
        success: impl Fn(&Progress) -> f64,
        mut see: impl FnMut(&Progress, UpdateParameters),
    ) -> Progress {
        let mut progress =
            Progress { next_validation: config.train.validate_every, ..Progress::default() };
        while progress.step < config.steps && !solved(config, &progress) {
            advance(config, &mut progress, 10);
            see(&progress, update_parameters(config, &progress));
            if progress.step >= progress.next_validation {
                let success = success(&progress);
                validated(config, &mut progress, success);
            }
        }
        progress
    }

    #[test]
    fn a_run_that_fails_anneals_after_exploration_and_learns_on() {
        let config = config();
        let mut history = Vec::new();
        let end = play(&config, |_| 0.0, |progress, now| history.push((progress.step, now)));
        let at = |step: u64| {
            let now: &UpdateParameters =
                history.iter().find(|(s, _)| *s == step).map(|(_, now)| now).expect("was seen");
            (now.log_std, now.learning_rate / now.log_std.exp())
        };
        assert!((at(200).0 + 0.5).abs() < 1e-12);
        assert!((at(400).0 + 1.0).abs() < 1e-12, "exploration is over");
        assert!((at(460).0 + 1.45).abs() < 1e-12, "the noise falls although validations fail");
        assert!((at(540).0 + 2.0).abs() < 1e-12);
        assert!(at(530).1 > 0.99e-3 && at(590).1 < 0.3e-3, "then the learning rate falls");
        assert!(at(610).1 > 0.8e-3 && at(660).1 < 0.3e-3, "and falls again");
        assert!((540..=1000).step_by(10).all(|step| (at(step).0 + 2.0).abs() < 1e-12));
        assert_eq!((end.step, end.annealed), (1000, 200));
        let entropy = |step: u64| {
            let of = |(s, now): &(u64, UpdateParameters)| {
                (*s == step).then_some(now.entropy_coefficient)
            };
            history.iter().find_map(of).expect("was seen")
        };
        assert_eq!((entropy(10), entropy(390)), (0.1, 0.1), "exploration keeps the entropy bonus");
        assert!((entropy(460) - 0.1 * 0.01_f64.powf(0.45)).abs() < 1e-12, "it falls as the noise");
        assert!((540..=1000).step_by(10).all(|step| (entropy(step) - 0.001).abs() < 1e-12));
    }

    #[test]
    fn annealing_pauses_while_validations_fail() {
        let config = config();
        // Validations succeed from step 300 on, except at step 350.
        let success =
            |progress: &Progress| f64::from(u8::from(progress.step >= 300 && progress.step != 350));
        let mut annealed = Vec::new();
        let end =
            play(&config, success, |progress, _| annealed.push((progress.step, progress.annealed)));
        let at = |step: u64| annealed.iter().find(|(s, _)| *s == step).expect("was seen").1;
        assert_eq!((at(300), at(350), at(400), at(450)), (0, 50, 50, 100));
        assert_eq!(
            (end.step, end.annealed),
            (550, 200),
            "stops when annealing is over and the last four validations succeeded"
        );
        let parameters = update_parameters(&config, &end);
        assert!((parameters.log_std + 2.0).abs() < 1e-12);
        assert!((parameters.learning_rate - 1e-4 * (-2.0_f64).exp()).abs() < 1e-12);
    }

    #[test]
    fn a_policy_that_swings_is_not_solved() {
        let config = config();
        let solved = |recent: [f64; 4]| {
            let progress = Progress {
                recent: recent.into(),
                annealed: 200,
                annealing: true,
                ..Progress::default()
            };
            super::solved(&config, &progress)
        };
        assert!(solved([0.95, 1.0, 1.0, 1.0]));
        assert!(
            !solved([1.0, 1.0, 1.0, 0.94]) && !solved([0.94, 1.0, 1.0, 1.0]),
            "the mean would be good enough"
        );
    }

    #[test]
    fn a_run_that_is_close_learns_on_without_more_noise() {
        let config = config();
        // Enough for annealing, but not for stopping.
        let mut history = Vec::new();
        let end = play(
            &config,
            |_| 0.92,
            |progress, parameters| history.push((progress.step, parameters)),
        );
        assert!(end.step >= 1000 && end.annealed >= 200, "and it ends annealed");
        let annealed = history
            .iter()
            .position(|(_, parameters)| parameters.log_std <= -2.0)
            .expect("it anneals");
        assert!(history[annealed..].iter().all(|(_, parameters)| parameters.log_std <= -2.0));
        let slowest = history
            .iter()
            .position(|(_, parameters)| parameters.learning_rate < 2e-4 * (-2.0_f64).exp())
            .expect("anneals");
        assert!(
            history[slowest..]
                .iter()
                .any(|(_, parameters)| parameters.learning_rate > 8e-4 * (-2.0_f64).exp()),
            "learns again"
        );
    }

    #[test]
    fn a_run_that_loses_its_success_keeps_its_low_noise() {
        let config = config();
        let after = |step: u64, success: f64| {
            let mut progress =
                Progress { step, annealed: 200, annealing: true, ..Progress::default() };
            validated(&config, &mut progress, success);
            (progress.annealing, progress.annealed)
        };
        assert_eq!(after(500, 0.5), (false, 134));
        assert_eq!(after(500, 0.92), (true, 134));
        // Annealing is taken back only as far as the remaining steps allow.
        assert_eq!(after(990, 0.92), (true, 190));
    }

    #[test]
    fn a_longer_run_takes_back_what_its_end_forced() {
        let mut config = config();
        let mut progress = play(&config, |_| 0.0, |_, _| ());
        config.steps = 2000;
        extended(&config, &mut progress, 1000);
        let extended_run = update_parameters(&config, &progress);
        assert!((extended_run.log_std + 2.0).abs() < 1e-12, "exploration was over");
        assert!((extended_run.learning_rate - 1e-3 * (-2.0_f64).exp()).abs() < 2e-5);
        let mut earned =
            Progress { annealing: true, annealed: 200, step: 1000, ..Progress::default() };
        extended(&config, &mut earned, 1000);
        assert_eq!(earned.annealed, 200);
        // Annealing that validations have earned stays, also where the last one failed.
        let mut paused = Progress { annealed: 50, step: 350, ..Progress::default() };
        extended(&config, &mut paused, 1000);
        assert_eq!(paused.annealed, 50);
        // A run that ends before exploration does is forced to anneal, and takes that back.
        config.steps = 300;
        let success = |progress: &Progress| f64::from(u8::from(progress.step == 50));
        let mut forced = play(&config, success, |_, _| ());
        assert_eq!((forced.annealed, forced.forced), (150, 100), "a success at step 50 counts");
        config.steps = 2000;
        extended(&config, &mut forced, 300);
        assert_eq!((forced.annealed, forced.forced), (50, 0));
    }

    proptest! {
        #[test]
        fn a_run_ends_annealed(
            seed: u64, anneal_steps in 1u64..2000, steps in 10u64..3000, log_std_start in -3.0..0.5,
        ) {
            let mut config = config();
            config.learner.exploration.log_std_start = log_std_start;
            (config.steps, config.train.anneal_steps) = (steps, anneal_steps);
            let success = |p: &Progress| f64::from((p.step.wrapping_mul(seed | 1) >> 7) as u8) / 255.0;
            let mut last = f64::INFINITY;
            let end = play(&config, success, |progress, parameters| {
                assert!(parameters.log_std <= last + 1e-12, "noise never grows: {progress:?}");
                last = parameters.log_std;
            });
            prop_assert!(end.annealed >= super::anneal_steps(&config));
            prop_assert!(end.step < steps + 10);
        }
    }
}
