//! Headless evaluation of learned policies, which act deterministically, and of policies without
//! training, in any environment, on seeds that training does not use.
//!
//! Episode `i` depends only on `(seed, i)`, so results do not depend on the number of worlds.

mod driver;
#[cfg(feature = "learn")]
mod knowledge;
#[cfg(feature = "learn")]
mod learned;
#[cfg(feature = "learn")]
mod onnx;

use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::env::{self, Environment, EpisodeRecord, OwnMetric, Stream};
use crate::metrics::WINDOW;
use crate::replay::Recorder;
use crate::rng::Seed;

pub use crate::metrics::{DETERMINED, Knowledge, Metrics, Probe};
use driver::PolicyDriver;
pub use driver::{Actor, Controller};
#[cfg(feature = "learn")]
pub use learned::LearnedPolicy;
#[cfg(feature = "learn")]
pub use onnx::{OnnxError, OnnxPolicy};

/// Number of worlds that run at a time. A learned policy always gets this number of rows, whatever
/// the machine and the number of episodes, so that episodes are reproducible to the last bit.
const WORLDS: usize = 16;
/// How often an episode in which the simulation broke off is played again.
const RETRIES: u32 = 2;

/// A policy that controls the agents.
pub enum Policy<'a> {
    /// The same action `[A]` of every agent in every step.
    Constant(Vec<f32>),
    /// Standard normal actions (clipped by the environment), as an untrained policy has.
    Gaussian,
    /// Actions uniform in −1..1.
    Uniform,
    /// The actions of the environment's own rule ([`follow_rule`](crate::env::Worlds::follow_rule)).
    Rule,
    /// None: the environment moves its agents by itself.
    Nothing,
    /// A trained policy.
    Learned(&'a dyn Controller),
}

/// The result of an evaluation.
#[derive(Debug, Clone, PartialEq)]
pub struct Evaluation {
    /// The requested episodes, in order.
    pub episodes: Vec<EpisodeRecord>,
    /// Reward per agent, summed over windows of [`WINDOW`] steps, each starting with a new episode
    /// (throughput).
    pub windows: Vec<f64>,
    /// How well the policy's latent predicts its targets; empty for policies without a latent.
    pub reconstruction: Vec<Knowledge>,
    /// Bits that an agent sent per decision, of each episode; empty for policies without messages.
    pub message_bits: Vec<f64>,
    /// The metrics that the environment defines by itself.
    pub own: Vec<OwnMetric>,
}

impl Evaluation {
    /// Returns the summary over all episodes; `None` without episodes.
    pub fn metrics(&self) -> Option<Metrics> {
        let Self { episodes, windows, reconstruction, message_bits, own } = self;
        Metrics::of(own, episodes, windows, reconstruction, message_bits)
    }

    /// Returns the indices of the episodes in which not every agent succeeded, in order.
    pub fn failed_episodes(&self) -> Vec<u64> {
        let failed = |record: &&EpisodeRecord| record.success().is_some_and(|share| share < 1.0);
        self.episodes.iter().filter(failed).map(|record| record.episode).collect()
    }
}

/// The observer of an evaluation: can stop it, and gets its progress and its episodes.
pub struct EvaluationObserver<'a> {
    /// Flag that stops the evaluation early; the finished episodes are returned.
    pub stop: &'a AtomicBool,
    /// Function that gets the number of finished episodes, after each step in which episodes end.
    pub report: &'a mut dyn FnMut(u64),
    /// Recorder of an episode, if one is to be recorded.
    pub recorder: Option<&'a mut Recorder>,
    /// Whether other worlds of the environment go on meanwhile, such as those of a training.
    pub beside: bool,
}

/// Plays `episodes` episodes of the stream `seed`, and as many more as the first complete window
/// needs.
///
/// # Errors
/// [`env::Error`] if the environment cannot be run, or breaks off in the same episode three times,
/// or if the policy cannot choose an action.
pub fn evaluate(
    environment: &dyn Environment,
    policy: &Policy<'_>,
    episodes: u64,
    seed: Seed,
    observer: EvaluationObserver<'_>,
) -> Result<Evaluation, env::Error> {
    let EvaluationObserver { stop, report, recorder, beside } = observer;
    let spec = environment.spec();
    let mut driver = PolicyDriver::new(policy, spec, seed.child("actions"), recorder);
    let stage = Stage { environment, seed, beside, stop };
    let mut records = stage.play(0..episodes, RETRIES, &mut driver, report)?;
    // What the actor tells is of the requested episodes alone, not of those that fill a window.
    let actor = driver.actor.as_deref();
    let reconstruction = actor.map(Actor::knowledge).unwrap_or_default();
    let message_bits = actor.map(Actor::message_bits).unwrap_or_default();
    let mut extra: Vec<EpisodeRecord> = Vec::new();
    loop {
        let all: Vec<&EpisodeRecord> = records.iter().chain(&extra).collect();
        let windows = windows(&all);
        let missing = WINDOW.saturating_sub(all.iter().map(|r| r.step_rewards.len()).sum());
        if !windows.is_empty() || missing == 0 || stop.load(Ordering::Relaxed) || all.is_empty() {
            records.sort_by_key(|record| record.episode);
            return Ok(Evaluation {
                episodes: records,
                windows,
                reconstruction,
                message_bits,
                own: spec.metrics.clone(),
            });
        }
        let mean = (WINDOW - missing).div_ceil(all.len()).max(1);
        let next = episodes + extra.len() as u64;
        extra.extend(stage.play(
            next..next + missing.div_ceil(mean) as u64,
            RETRIES,
            &mut driver,
            &mut |_| {},
        )?);
    }
}

/// Returns the sums of the mean reward over consecutive windows. Each window starts with a new
/// episode; its last episode is cut at the end of the window.
fn windows(records: &[&EpisodeRecord]) -> Vec<f64> {
    let mut sums = Vec::new();
    let (mut sum, mut steps) = (0.0, 0);
    for record in records {
        let take = record.step_rewards.len().min(WINDOW - steps);
        sum += record.step_rewards[..take].iter().map(|&r| f64::from(r)).sum::<f64>();
        steps += take;
        if steps == WINDOW {
            sums.push(sum);
            (sum, steps) = (0.0, 0);
        }
    }
    sums
}

/// Parameters that all episodes of an evaluation share.
struct Stage<'a> {
    environment: &'a dyn Environment,
    seed: Seed,
    beside: bool,
    stop: &'a AtomicBool,
}

impl Stage<'_> {
    /// Plays a range of episodes and returns their records in order. Episodes in which the
    /// simulation broke off are played again.
    fn play(
        &self,
        episodes: Range<u64>,
        retries: u32,
        policy: &mut PolicyDriver<'_>,
        report: &mut dyn FnMut(u64),
    ) -> Result<Vec<EpisodeRecord>, env::Error> {
        let worlds = (WORLDS as u64).min(episodes.end - episodes.start) as usize;
        let stream = Stream {
            training: false,
            stride: worlds as u64,
            repeat_failed: 0.0,
            worlds,
            seed: self.seed.child("episodes"),
            episodes: episodes.clone(),
            beside: self.beside,
        };
        let mut records = Vec::new();
        if worlds == 0 {
            return Ok(records);
        }
        let mut worlds = self.environment.start(&stream)?;
        policy.begin();
        while !worlds.is_finished() && !self.stop.load(Ordering::Relaxed) {
            policy.act(&*worlds)?;
            worlds.step(&policy.actions)?;
            if let Some(recorder) = &mut policy.recorder {
                recorder.reward(&*worlds);
            }
            let finished = worlds.take_finished();
            if !finished.is_empty() {
                records.extend(finished);
                report(records.iter().filter(|r: &&EpisodeRecord| !r.interrupted).count() as u64);
            }
        }
        drop(worlds);
        let again: Vec<u64> = records.iter().filter(|r| r.interrupted).map(|r| r.episode).collect();
        records.retain(|record| !record.interrupted);
        for episode in again {
            if retries == 0 {
                return Err(env::Error::KeepsFailing { episode, times: RETRIES + 1 });
            }
            records.extend(self.play(episode..episode + 1, retries - 1, policy, &mut |_| {})?);
        }
        records.sort_by_key(|record| record.episode);
        Ok(records)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use serde_json::Value;

    use super::*;
    use crate::env::{DrivingRecord, EnvSpec, NamedEnvironment, Worlds};
    use crate::replay::RecordedDiagnostics;

    fn record(episode: u64, rewards: &[f32]) -> EpisodeRecord {
        EpisodeRecord {
            episode,
            episode_length: rewards.len() as u32,
            success: 1.0,
            driving: Some(DrivingRecord {
                safety: 1.0,
                distance_km: 0.5,
                ..DrivingRecord::default()
            }),
            step_rewards: rewards.to_vec(),
            ..EpisodeRecord::default()
        }
    }

    /// A policy without motion that tells which episodes it has acted in.
    struct Witness;

    struct WitnessActor(BTreeSet<u64>);

    impl Controller for Witness {
        fn actor<'a>(&'a self, _: &'a EnvSpec, _: Seed) -> Box<dyn Actor + 'a> {
            Box::new(WitnessActor(BTreeSet::new()))
        }
    }

    impl Actor for WitnessActor {
        fn begin(&mut self) {}

        fn act(
            &mut self,
            worlds: &dyn Worlds,
            _: &mut [f32],
            _: Option<usize>,
        ) -> Result<RecordedDiagnostics, env::Error> {
            self.0.extend((0..worlds.count()).map(|e| worlds.view(e).episode));
            Ok(RecordedDiagnostics::default())
        }

        fn message_bits(&self) -> Vec<f64> {
            self.0.iter().map(|&episode| episode as f64).collect()
        }
    }

    /// Episodes that only fill a window of 1000 steps count for nothing else.
    #[test]
    fn what_a_policy_tells_is_of_the_requested_episodes() {
        let environment =
            NamedEnvironment::find("navigation").expect("a built-in one").environment();
        let observer = EvaluationObserver {
            stop: &AtomicBool::new(false),
            report: &mut |_| {},
            recorder: None,
            beside: false,
        };
        let policy = Policy::Learned(&Witness);
        let result = evaluate(&*environment, &policy, 3, Seed::new(1), observer).expect("it runs");
        assert_eq!((result.episodes.len(), result.windows.len()), (3, 1));
        assert_eq!(result.message_bits, [0.0, 1.0, 2.0]);
    }

    #[test]
    fn windows_start_fresh_and_cut_the_last_episode() {
        let records = [
            record(0, &[1.0; 600]),
            record(1, &[2.0; 600]),
            record(2, &[3.0; 999]),
            record(3, &[4.0; 500]),
        ];
        // The first window is 600 · 1 + 400 · 2; the next starts with the third episode: 999 · 3 +
        // 1 · 4. The remaining steps fill no window.
        assert_eq!(windows(&records.iter().collect::<Vec<_>>()), vec![1400.0, 3001.0]);
    }

    #[test]
    fn kilometres_and_crashes_are_those_of_all_episodes() {
        let driving = DrivingRecord { crashes: 2, distance_km: 1.5, ..DrivingRecord::default() };
        let crashed = EpisodeRecord { driving: Some(driving), ..record(1, &[1.0; 1000]) };
        let of = |episodes: Vec<EpisodeRecord>| {
            let evaluation = Evaluation {
                episodes,
                windows: vec![1.0],
                reconstruction: Vec::new(),
                message_bits: Vec::new(),
                own: Vec::new(),
            };
            evaluation.metrics().expect("episodes").driving().km_per_crash.expect("they moved")
        };
        let found = of(vec![record(0, &[1.0; 1000]), crashed]);
        assert_eq!((found.km, found.crashes, found.estimate.mean), (2.0, 2, 1.0));
        assert!(found.estimate.low < 1.0 && found.estimate.high > 1.0);
        let none = serde_json::to_value(of(vec![record(0, &[1.0; 1000])])).expect("JSON");
        assert_eq!(
            (&none["crashes"], &none["mean"], &none["high"]),
            (&0.into(), &Value::Null, &Value::Null)
        );
        assert!((none["low"].as_f64().expect("a lower bound") - 0.5 / 3.688_879).abs() < 1e-6);
    }
}
