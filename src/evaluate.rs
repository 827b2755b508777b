//! Headless evaluation of learned policies, which act deterministically, and of policies without
//! training, on seeds that training does not use.
//!
//! Episode `i` depends only on `(seed, i)`, so results do not depend on the number of worlds.

mod driver;
#[cfg(feature = "learn")]
mod knowledge;
mod latent;
#[cfg(feature = "learn")]
mod learned;

use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use serde::{Deserialize, Serialize};

use crate::env::{
    self, Audit, BackgroundMetrics, Driver, EpisodeRecord, Failures, Pursuit, Task, VecEnv,
    VecOptions,
};
use crate::replay::Recorder;
use crate::rng::Seed;
use crate::stats::Estimate;
use crate::sumo::Hosting;

use driver::PolicyDriver;
pub use driver::{Actor, Controller};
pub use latent::{DETERMINED, Knowledge, Probe};
#[cfg(feature = "learn")]
pub use learned::LearnedPolicy;

/// Number of steps of the window over which the paper sums rewards.
pub const WINDOW: usize = 1000;

/// Number of worlds that run at a time. A learned policy always gets this number of rows, whatever
/// the machine and the number of episodes, so that episodes are reproducible to the last bit.
const WORLDS: usize = 16;
/// How often an episode in which SUMO died is played again.
const RETRIES: u32 = 2;

/// A policy that controls the vehicles.
pub enum Policy<'a> {
    /// The same throttle in every step, without steering.
    Throttle(f32),
    /// Pure pursuit of the route.
    Pursuit(Pursuit),
    /// Standard normal actions (clipped by the environment), as an untrained policy has.
    Gaussian,
    /// Actions uniform in −1..1.
    Uniform,
    /// SUMO's own car-following and right-of-way model.
    Sumo,
    /// A trained policy.
    Learned(&'a dyn Controller),
}

/// Names of the policies without training, as on the command line.
pub const POLICIES: [&str; 6] =
    ["throttle:<a>", "pursuit:<speed>", "fcfs:<speed>", "gaussian", "uniform", "sumo"];

impl Policy<'static> {
    /// Returns a policy without training by its name on the command line; `None` for an unknown
    /// name.
    pub fn by_name(name: &str) -> Option<Self> {
        match name {
            "gaussian" => Some(Self::Gaussian),
            "uniform" => Some(Self::Uniform),
            "sumo" => Some(Self::Sumo),
            _ => {
                let (kind, value) = name.split_once(':')?;
                let value: f64 = value.parse().ok()?;
                let pursuit = |gives_way| {
                    (value > 0.0 && value.is_finite())
                        .then_some(Pursuit { speed: value, gives_way })
                };
                match kind {
                    "pursuit" => pursuit(false).map(Self::Pursuit),
                    "fcfs" => pursuit(true).map(Self::Pursuit),
                    "throttle" => {
                        (-1.0..=1.0).contains(&value).then_some(Self::Throttle(value as f32))
                    }
                    _ => None,
                }
            }
        }
    }
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
}

/// Means with 95 % intervals; the unit is the episode, or the window.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Metrics {
    /// Share of agents that arrived.
    pub success: Estimate,
    /// Share of agents that neither crashed nor went off-road.
    pub safety: Estimate,
    /// Share of agents that crashed.
    pub crash: Estimate,
    /// Share of agents that went off-road.
    pub out_of_road: Estimate,
    /// Reward per agent and episode.
    pub reward: Estimate,
    /// Throughput: reward per agent over [`WINDOW`] steps with automatic reset (the paper's
    /// "Rewards").
    pub window_reward: Estimate,
    /// Length of an episode \[steps\].
    pub episode_length: Estimate,
    /// (success − danger) · N / steps, in agents per step.
    pub efficiency: Estimate,
    /// Colliding pairs per episode in SUMO's report.
    pub sumo_collisions: Estimate,
    /// Colliding pairs per episode by our own box test.
    pub own_collisions: Estimate,
    /// Share of agents that loitered ([`EpisodeRecord::loitering`]).
    pub loitering: Estimate,
    /// Distance per crash over all episodes together; `None` if no agent moved.
    pub km_per_crash: Option<KmPerCrash>,
    /// Where SUMO's report and our own box test differ, and why; sums over all episodes.
    pub audit: Audit,
    /// Why agents did not arrive; sums over all episodes.
    pub failures: Failures,
    /// Effects on background traffic and pedestrians; `None` in tasks without them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub others: Option<BackgroundSummary>,
    /// How well the policy's latent predicts its targets; empty for policies without a latent.
    pub reconstruction: Vec<Knowledge>,
}

/// Distance that agents drive per crash, over all episodes together.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct KmPerCrash {
    /// Distance that agents drove \[km\].
    pub km: f64,
    /// Number of crashes of agents ([`EpisodeRecord::crashes`]).
    pub crashes: u64,
    /// Kilometres per crash with the exact interval of a Poisson count; only a lower bound without
    /// a crash.
    #[serde(flatten)]
    pub estimate: Estimate,
}

impl KmPerCrash {
    /// Computes the estimate from a distance \[km\] and a number of crashes; `None` if the distance
    /// is 0.
    pub fn new(km: f64, crashes: u64) -> Option<Self> {
        Some(Self { km, crashes, estimate: Estimate::exposure_per_event(km, crashes)? })
    }
}

/// Effects of agents on background traffic and pedestrians; see [`env::BackgroundMetrics`] for the
/// definitions. Shares and means are over the episodes that contain vehicles, or pedestrians;
/// `None` without such episodes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BackgroundSummary {
    /// Number of background vehicles in an episode.
    pub vehicles: Estimate,
    /// Share of the vehicles that collided with an agent or a wreck.
    pub crash: Option<Estimate>,
    /// SUMO's time loss of a vehicle \[s\].
    pub delay: Option<Estimate>,
    /// Hardest braking of a vehicle \[m/s²\].
    pub braking: Option<Estimate>,
    /// Share of the vehicles that had to brake harder than 6 m/s².
    pub hard_braking: Option<Estimate>,
    /// Share of the vehicles with a time to collision with an agent below 1.5 s, or with a
    /// collision.
    pub close: Option<Estimate>,
    /// Number of pedestrians in an episode.
    pub pedestrians: Estimate,
    /// Share of the pedestrians that were hit by an agent or a wreck.
    pub pedestrian_crash: Option<Estimate>,
    /// Share of the pedestrians with a time to collision with an agent below 1.5 s, or that were
    /// hit.
    pub pedestrian_close: Option<Estimate>,
    /// Smallest time to collision of an episode \[s\], at most 5.
    pub ttc: Option<Estimate>,
    /// Smallest post-encroachment time of an episode \[s\], at most 5.
    pub pet: Option<Estimate>,
}

impl BackgroundSummary {
    fn of(episodes: &[EpisodeRecord]) -> Option<Self> {
        type Of = fn(&BackgroundMetrics) -> f64;
        let all: Vec<BackgroundMetrics> =
            episodes.iter().filter_map(|record| record.others).collect();
        let column = |any: fn(&BackgroundMetrics) -> bool, of: Of| {
            all.iter().filter(|o| any(o)).map(of).collect::<Vec<_>>()
        };
        let driven: fn(&BackgroundMetrics) -> bool = |o| o.vehicles > 0;
        let walked: fn(&BackgroundMetrics) -> bool = |o| o.pedestrians > 0;
        let either: fn(&BackgroundMetrics) -> bool = |o| o.vehicles + o.pedestrians > 0;
        Some(Self {
            vehicles: Estimate::t(&column(|_| true, |o| f64::from(o.vehicles)))?,
            crash: Estimate::rate(&column(driven, |o| o.crash)),
            delay: Estimate::t(&column(driven, |o| o.delay)),
            braking: Estimate::t(&column(driven, |o| o.braking)),
            hard_braking: Estimate::rate(&column(driven, |o| o.hard_braking)),
            close: Estimate::rate(&column(driven, |o| o.close)),
            pedestrians: Estimate::t(&column(|_| true, |o| f64::from(o.pedestrians)))?,
            pedestrian_crash: Estimate::rate(&column(walked, |o| o.pedestrian_crash)),
            pedestrian_close: Estimate::rate(&column(walked, |o| o.pedestrian_close)),
            ttc: Estimate::t(&column(either, |o| o.ttc)),
            pet: Estimate::t(&column(either, |o| o.pet)),
        })
    }
}

impl Evaluation {
    /// Returns the summary over all episodes; `None` without episodes.
    pub fn metrics(&self) -> Option<Metrics> {
        let column =
            |of: fn(&EpisodeRecord) -> f64| self.episodes.iter().map(of).collect::<Vec<_>>();
        Some(Metrics {
            success: Estimate::rate(&column(|r| r.success))?,
            safety: Estimate::rate(&column(|r| r.safety))?,
            crash: Estimate::rate(&column(|r| r.crash))?,
            out_of_road: Estimate::rate(&column(|r| r.out_of_road))?,
            reward: Estimate::t(&column(|r| r.reward))?,
            window_reward: Estimate::t(&self.windows)?,
            episode_length: Estimate::t(&column(|r| f64::from(r.episode_length)))?,
            efficiency: Estimate::t(&column(|r| r.efficiency))?,
            sumo_collisions: Estimate::t(&column(|r| f64::from(r.sumo_collisions)))?,
            own_collisions: Estimate::t(&column(|r| f64::from(r.own_collisions)))?,
            loitering: Estimate::rate(&column(|r| r.loitering))?,
            km_per_crash: KmPerCrash::new(
                self.episodes.iter().map(|r| r.distance_km).sum(),
                self.episodes.iter().map(|r| u64::from(r.crashes)).sum(),
            ),
            audit: self.episodes.iter().fold(Audit::default(), |sum, r| sum.plus(&r.audit)),
            failures: self
                .episodes
                .iter()
                .fold(Failures::default(), |sum, r| sum.plus(&r.failures)),
            others: BackgroundSummary::of(&self.episodes),
            reconstruction: self.reconstruction.clone(),
        })
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
}

/// Plays `episodes` episodes of the stream `seed`, and as many more as the first complete window
/// needs.
///
/// # Errors
/// [`env::Error`] if SUMO cannot be run, or dies in the same episode three times.
pub fn evaluate(
    task: &Arc<Task>,
    policy: &Policy<'_>,
    episodes: u64,
    seed: Seed,
    hosting: &Hosting,
    observer: EvaluationObserver<'_>,
) -> Result<Evaluation, env::Error> {
    let EvaluationObserver { stop, report, recorder } = observer;
    let mut driver = PolicyDriver::new(policy, task, seed.child("actions"), recorder);
    let stage = Stage { task, seed, hosting, stop };
    let mut records = stage.play(0..episodes, RETRIES, &mut driver, report)?;
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
                reconstruction: driver.actor.map(|actor| actor.knowledge()).unwrap_or_default(),
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
    task: &'a Arc<Task>,
    seed: Seed,
    hosting: &'a Hosting,
    stop: &'a AtomicBool,
}

impl Stage<'_> {
    /// Plays a range of episodes and returns their records in order. Episodes in which SUMO died
    /// are played again.
    fn play(
        &self,
        episodes: Range<u64>,
        retries: u32,
        policy: &mut PolicyDriver<'_>,
        report: &mut dyn FnMut(u64),
    ) -> Result<Vec<EpisodeRecord>, env::Error> {
        let worlds = (WORLDS as u64).min(episodes.end - episodes.start) as usize;
        let driver =
            if matches!(policy.policy, Policy::Sumo) { Driver::Sumo } else { Driver::Agents };
        let options = VecOptions {
            replay: 0.0,
            worlds,
            driver,
            seed: self.seed.child("episodes"),
            episodes: episodes.clone(),
            hosting: *self.hosting,
        };
        let mut records = Vec::new();
        if worlds == 0 {
            return Ok(records);
        }
        let mut env = VecEnv::new(self.task, &options)?;
        policy.begin();
        while !env.is_finished() && !self.stop.load(Ordering::Relaxed) {
            policy.act(&env);
            env.step(&policy.actions)?;
            if let Some(recorder) = &mut policy.recorder {
                env.worlds().for_each(|world| recorder.reward(world));
            }
            let finished = env.take_finished();
            if !finished.is_empty() {
                records.extend(finished);
                report(records.iter().filter(|r: &&EpisodeRecord| !r.interrupted).count() as u64);
            }
        }
        drop(env);
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
    use serde_json::Value;

    use super::*;

    fn record(episode: u64, rewards: &[f32]) -> EpisodeRecord {
        EpisodeRecord {
            replayed: false,
            episode,
            episode_length: rewards.len() as u32,
            success: 1.0,
            safety: 1.0,
            crash: 0.0,
            out_of_road: 0.0,
            reward: 0.0,
            efficiency: 0.0,
            sumo_collisions: 0,
            own_collisions: 0,
            distance_km: 0.5,
            crashes: 0,
            loitering: 0.0,
            audit: Audit::default(),
            failures: Failures::default(),
            others: None,
            interrupted: false,
            step_rewards: rewards.to_vec(),
        }
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
        let crashed = EpisodeRecord { crashes: 2, distance_km: 1.5, ..record(1, &[1.0; 1000]) };
        let of = |episodes: Vec<EpisodeRecord>| {
            let evaluation =
                Evaluation { episodes, windows: vec![1.0], reconstruction: Vec::new() };
            evaluation.metrics().expect("episodes").km_per_crash.expect("they moved")
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

    #[test]
    fn policies_by_name() {
        assert!(matches!(Policy::by_name("throttle:-0.5"), Some(Policy::Throttle(a)) if a == -0.5));
        for bad in ["throttle:2", "throttle:nan", "throttle", "Gaussian", ""] {
            assert!(Policy::by_name(bad).is_none(), "{bad}");
        }
    }
}
