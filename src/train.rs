//! The training loop: rollout, update, and at intervals a validation and a checkpoint.
//!
//! All randomness comes from the seed tree, by iteration number. A checkpoint is taken between
//! iterations and contains the worlds' action histories, so that stopping and resuming changes
//! nothing.

#![cfg(feature = "learn")]

mod activity;
mod ahead;
mod collect;
mod error;
mod files;
mod last_action;
mod meta;
mod noise;
mod run_dir;
mod schedule;
mod setup;
#[cfg(test)]
mod tests;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use serde::Serialize;
use tch::{Kind, Tensor};

use crate::algo::{self, Algorithm, Losses, Stop, UpdateParameters};
use crate::checkpoint::{Checkpoint, Progress};
use crate::config::Config;
use crate::env::{Environment, EpisodeRecord, WorldState};
use crate::evaluate::{Evaluation, EvaluationObserver, LearnedPolicy, Policy, evaluate};
use crate::fnv::Fnv;
use crate::ranks::Team;
use crate::rng::Seed;
use crate::rollout::Rollout;
use ahead::Ahead;
use collect::{Collector, Exploring};

pub use activity::{Activity, Present, Report, Stage};
pub use error::Error;
use files::Files;
pub use run_dir::RunDir;
pub(crate) use schedule::STOP_VALIDATIONS;

/// How training ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TrainingEnd {
    /// All steps were done.
    Finished,
    /// Validations reached `train.stop_success`, and annealing is over.
    Solved,
    /// The caller asked to stop.
    Interrupted,
}

/// Seconds that each part of the loop took since the last report.
#[derive(Debug, Clone, Copy, Default, Serialize)]
struct Timers {
    #[serde(rename = "time/simulate_s")]
    simulate: f64,
    #[serde(rename = "time/act_s")]
    act: f64,
    #[serde(rename = "time/copy_s")]
    copy: f64,
    #[serde(rename = "time/update_s")]
    update: f64,
}

/// State of the worlds and of the policy's memory between two iterations.
struct Mark {
    worlds: Vec<WorldState>,
    memory: Tensor,
}

impl Mark {
    fn copy(&self) -> Self {
        Self { worlds: self.worlds.clone(), memory: self.memory.shallow_clone() }
    }
}

/// What says that an iteration is to be given up. Among several processes, all must get the same
/// answer to the same question.
#[derive(Clone, Copy)]
struct Stops<'a> {
    /// Asked after each step of the worlds.
    rollout: Stop<'a>,
    /// Asked before each gradient step.
    update: Stop<'a>,
}

impl Stops<'_> {
    const NEVER: Self = Self { rollout: &|| false, update: &|| false };
}

/// A learner and the worlds in which it trains.
pub struct Trainer {
    config: Config,
    environment: Box<dyn Environment>,
    learner: Box<dyn Algorithm>,
    team: Team,
    rollout: Rollout,
    /// The next rollout, where it is played beside the update.
    ahead: Option<Ahead>,
    collector: Collector,
    progress: Progress,
    activity: Arc<Activity>,
    seed: Seed,
}

impl Trainer {
    /// Starts a run in an environment.
    ///
    /// # Errors
    /// If worlds cannot be started, or if the device or the initial weights cannot be used.
    pub fn new(config: Config, environment: Box<dyn Environment>) -> Result<Self, Error> {
        Self::build(config, environment, None, &Team::alone())
    }

    /// Continues a run from a checkpoint. The configuration may ask for more steps than that of the
    /// checkpoint. Settings with which the worlds cannot be restored are refused; any other
    /// difference is the caller's responsibility.
    ///
    /// # Errors
    /// If the checkpoint does not fit or worlds cannot be started.
    pub fn resume(
        config: Config,
        environment: Box<dyn Environment>,
        checkpoint: &Checkpoint,
    ) -> Result<Self, Error> {
        Self::build(config, environment, Some(checkpoint), &Team::alone())
    }

    /// Starts a run, or continues it from a checkpoint, together with the other processes of a
    /// team. All of them must call the same functions of their trainers in the same order, and stop
    /// by [`Team::stop`].
    ///
    /// # Errors
    /// As [`Trainer::new`] and [`Trainer::resume`], and [`Error::TooManyRanks`].
    pub fn among(
        config: Config,
        environment: Box<dyn Environment>,
        checkpoint: Option<&Checkpoint>,
        team: &Team,
    ) -> Result<Self, Error> {
        Self::build(config, environment, checkpoint, team)
    }

    /// Returns the learner.
    pub fn learner(&self) -> &dyn Algorithm {
        &*self.learner
    }

    /// Returns the progress of training.
    pub fn progress(&self) -> &Progress {
        &self.progress
    }

    /// Returns what [`Trainer::run`] is doing at present.
    pub fn activity(&self) -> Arc<Activity> {
        Arc::clone(&self.activity)
    }

    /// Returns whether nothing is left to train: the run has taken all its steps, or is solved.
    pub fn is_over(&self) -> bool {
        let progress = &self.progress;
        progress.validated >= progress.step
            && (progress.step >= self.config.steps || schedule::solved(&self.config, progress))
    }

    /// Runs one iteration: a rollout and an update.
    ///
    /// # Errors
    /// If worlds cannot go on or training diverges.
    pub fn iterate(&mut self) -> Result<Losses, Error> {
        self.iterate_until(Stops::NEVER)
    }

    /// Runs one iteration. One that is given up leaves the learner and the progress as they were
    /// before; only the worlds have gone on.
    ///
    /// # Errors
    /// As [`Trainer::iterate`], and [`Error::Stopped`].
    fn iterate_until(&mut self, stops: Stops<'_>) -> Result<Losses, Error> {
        let begin = Instant::now();
        self.collector.finished.clear();
        let losses = match self.ahead.take() {
            None => self.iterate_in_turn(stops),
            Some(mut ahead) => {
                let losses = self.iterate_ahead(&mut ahead, stops);
                self.ahead = Some(ahead);
                losses
            }
        };
        self.progress.seconds += begin.elapsed().as_secs_f64();
        losses
    }

    /// Plays a rollout, then learns from it.
    fn iterate_in_turn(&mut self, stops: Stops<'_>) -> Result<Losses, Error> {
        let seed = self.iteration_seed(0);
        self.activity.begin(Stage::Rollout);
        self.collect(seed.child("noise"), stops)?;
        self.activity.begin(Stage::Update);
        let before = self.progress.clone();
        let parameters = self.advance();
        let learner = &mut self.learner;
        let updated = timed(&mut self.collector.timers.update, || {
            learner.update_until(&self.rollout, &parameters, seed.child("update"), stops.update)
        });
        if let Err(algo::Error::Stopped) = updated {
            self.progress = before;
            return Err(Error::Stopped);
        }
        let losses = updated?;
        self.agree()?;
        self.progress.iteration += 1;
        Ok(losses)
    }

    /// Plays a rollout with the present policy.
    fn collect(&mut self, seed: Seed, stops: Stops<'_>) -> Result<(), Error> {
        let player = Exploring { policy: &*self.learner, log_std: self.log_std() };
        self.collector.collect(&self.config, player, &mut self.rollout, seed, stops)
    }

    /// Returns the seed of an iteration, counted from the present one.
    fn iteration_seed(&self, later: u64) -> Seed {
        self.seed.child("iteration").index(self.progress.iteration + later)
    }

    /// Returns the logarithm of the scheduled standard deviation of actions.
    fn log_std(&self) -> f64 {
        schedule::update_parameters(&self.config, &self.progress).log_std
    }

    /// Adds the rollout's steps to the progress, and returns the parameters of the update.
    fn advance(&mut self) -> UpdateParameters {
        let steps = (self.rollout.sizes.steps * self.rollout.sizes.envs) as u64;
        schedule::advance(&self.config, &mut self.progress, steps);
        schedule::update_parameters(&self.config, &self.progress)
    }

    /// Checks that all processes have the same weights.
    fn agree(&self) -> Result<(), Error> {
        if self.team.ranks.size() == 1 {
            return Ok(());
        }
        let mut hash = Fnv::new();
        for (_, tensor) in self.learner.state() {
            let numbers: Vec<f32> = Vec::try_from(tensor.to_kind(Kind::Float).reshape([-1]))
                .expect("a state is of numbers");
            for number in numbers {
                hash.bytes(&number.to_ne_bytes());
            }
        }
        let all = self.team.ranks.all_gather(&hash.value().to_ne_bytes());
        let same = all.iter().all(|other| *other == all[0]);
        same.then_some(()).ok_or(Error::Diverged { iteration: self.progress.iteration })
    }

    /// Evaluates the averaged weights with deterministic actions, in episodes that training never
    /// plays. The episodes depend on the number of environment steps so far. If all validations
    /// played the same episodes, a run would stop at weights that happen to suit these episodes.
    ///
    /// # Errors
    /// If worlds cannot go on.
    pub fn validate(&mut self, stop: &AtomicBool) -> Result<Evaluation, Error> {
        self.learner.swap_average();
        let policy = LearnedPolicy { learner: &*self.learner, channel: self.config.channel };
        let evaluation = evaluate(
            &*self.environment,
            &Policy::Learned(&policy),
            self.config.train.validation_episodes,
            self.seed.child("validation").index(self.progress.step),
            EvaluationObserver { stop, report: &mut |_| {}, recorder: None, beside: true },
        );
        self.learner.swap_average();
        Ok(evaluation?)
    }

    /// Returns a checkpoint from which training can continue.
    pub fn checkpoint(&self) -> Checkpoint {
        match &self.ahead {
            None => self.checkpoint_at(self.collector.mark()),
            Some(ahead) => {
                let (mark, player) = ahead.resume();
                Checkpoint { player: Some(player), ..self.checkpoint_at(mark) }
            }
        }
    }

    fn checkpoint_at(&self, mark: Mark) -> Checkpoint {
        Checkpoint {
            player: None,
            progress: self.progress.clone(),
            config: self.config.to_toml(),
            algorithm: self.config.algorithm.clone(),
            features: self.environment.spec().observation.names(),
            learner: self.learner.state(),
            worlds: mark.worlds,
            memory: Vec::try_from(mark.memory.reshape([-1])).expect("memory is of floats"),
        }
    }

    /// Trains until all steps are done, the criterion for early stopping is met or `stop` is set,
    /// and writes the run's files. When `stop` is set in the middle of an iteration, the iteration
    /// is given up, the last checkpoint is the state before it, and training goes on from the
    /// checkpoint ([`Trainer::resume`]) rather than with this trainer, whose worlds have gone on.
    ///
    /// # Errors
    /// Any [`Error`]. The last checkpoint stays usable. If the simulation failed, it is the state
    /// before the rollout that failed.
    pub fn run(
        &mut self,
        dir: &RunDir,
        stop: &AtomicBool,
        report: &mut dyn FnMut(&Report),
    ) -> Result<TrainingEnd, Error> {
        let mut files = Files::open(
            dir,
            &self.config,
            &*self.environment,
            self.progress.step,
            self.progress.validated,
        )?;
        let (team, activity) = (self.team.clone(), self.activity());
        let is_stopped = || stop.load(Ordering::Relaxed);
        let rollout = || {
            activity.count(Stage::Rollout);
            is_stopped()
        };
        let update = || {
            activity.count(Stage::Update);
            is_stopped() || team.ranks.size() > 1 && team.must_stop()
        };
        let stops = Stops { rollout: &rollout, update: &update };
        let mut validation_success = None;
        let outcome = loop {
            if stop.load(Ordering::Relaxed) {
                break TrainingEnd::Interrupted;
            }
            let done = self.progress.step >= self.config.steps;
            // Depends on the progress alone, so that an interrupted validation is repeated.
            let due = self.progress.step >= self.progress.next_validation || done;
            if due && self.progress.validated < self.progress.step {
                // The checkpoint comes first, so that a failing validation loses no training.
                self.checkpoint().save(&dir.last())?;
                activity.begin(Stage::Validation);
                let evaluation = self.validate(stop)?;
                if stop.load(Ordering::Relaxed) {
                    continue;
                }
                validation_success = Some(self.judge(&evaluation, dir, &mut files)?);
                continue;
            }
            if schedule::solved(&self.config, &self.progress) {
                break TrainingEnd::Solved;
            }
            if done {
                break TrainingEnd::Finished;
            }
            let before = (self.progress.step, self.progress.seconds);
            self.collector.timers = Timers::default();
            let begin = self.ahead.is_none().then(|| self.collector.mark());
            let losses = match self.iterate_until(stops) {
                // Only the worlds have gone on, so that the iteration can be repeated from its
                // beginning.
                Err(error @ (Error::Env(_) | Error::Stopped)) => {
                    let begin = begin.map(|begin| self.checkpoint_at(begin));
                    let begin = begin.unwrap_or_else(|| self.checkpoint());
                    let Error::Stopped = error else {
                        begin.save(&dir.last())?;
                        return Err(error);
                    };
                    self.end(&begin, dir, &files)?;
                    return Ok(TrainingEnd::Interrupted);
                }
                other => other?,
            };
            let seconds = self.progress.seconds - before.1;
            let steps_per_second = (self.progress.step - before.0) as f64 / seconds.max(1e-9);
            let training_success = files.iteration(self, &losses, steps_per_second)?;
            report(&Report {
                step: self.progress.step,
                steps_per_second,
                training_success,
                validation_success,
            });
        };
        self.end(&self.checkpoint(), dir, &files)?;
        Ok(outcome)
    }

    /// Writes the checkpoint at the end of a call of [`Trainer::run`].
    fn end(&self, checkpoint: &Checkpoint, dir: &RunDir, files: &Files) -> Result<(), Error> {
        files.sync()?;
        dir.update_meta(&self.progress)?;
        checkpoint.save(&dir.last())?;
        if !dir.best().exists() {
            checkpoint.save(&dir.best())?;
        }
        Ok(())
    }

    /// Records a validation, updates the schedule, and saves the last checkpoint and, if it
    /// improved, the best one.
    fn judge(
        &mut self,
        evaluation: &Evaluation,
        dir: &RunDir,
        files: &mut Files,
    ) -> Result<f64, Error> {
        let success = EpisodeRecord::mean_success(evaluation.episodes.iter()).unwrap_or(0.0);
        let window =
            evaluation.windows.iter().sum::<f64>() / evaluation.windows.len().max(1) as f64;
        files.validation(&self.progress, evaluation)?;
        files.sync()?;
        schedule::validated(&self.config, &mut self.progress, success);
        if self.progress.best.is_none_or(|best| (success, window) > best) {
            self.progress.best = Some((success, window));
            self.checkpoint().save(&dir.best())?;
        }
        dir.update_meta(&self.progress)?;
        self.checkpoint().save(&dir.last())?;
        Ok(success)
    }
}

fn timed<R>(total: &mut f64, work: impl FnOnce() -> R) -> R {
    let begin = Instant::now();
    let result = work();
    *total += begin.elapsed().as_secs_f64();
    result
}

/// Formats a duration for people, such as `4.2 s` or `3 min 07 s`.
pub fn human_duration(duration: Duration) -> String {
    let s = duration.as_secs();
    if s < 60 {
        format!("{:.1} s", duration.as_secs_f64())
    } else {
        format!("{} min {:02} s", s / 60, s % 60)
    }
}
