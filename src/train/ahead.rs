//! Simulation beside learning (`train.overlap`): while the learner learns from one rollout, the
//! next one is played with the policy from before the update.

use super::collect::Exploring;
use super::{Error, Mark, Stage, Stops, Trainer, timed};
use crate::algo::{self, Algorithm, Losses};
use crate::checkpoint::{Checkpoint, Player};
use crate::env::EpisodeRecord;
use crate::rollout::Rollout;

/// The rollout that comes next, and the policy that plays it.
pub(super) struct Ahead {
    /// A copy of the learner from before its last update.
    player: Box<dyn Algorithm>,
    /// Logarithm of the scheduled standard deviation with which the rollout is played.
    log_std: f64,
    /// State before the rollout.
    mark: Mark,
    rollout: Rollout,
    /// The episodes that ended in the rollout.
    finished: Vec<EpisodeRecord>,
    is_played: bool,
    /// Why the rollout could not be played.
    failure: Option<Error>,
}

impl Ahead {
    /// Begins with the policy and the noise in the checkpoint, or else with those of the learner.
    ///
    /// # Errors
    /// If the checkpoint does not fit.
    pub(super) fn new(
        mut player: Box<dyn Algorithm>,
        trainer: &Trainer,
        checkpoint: Option<&Checkpoint>,
    ) -> Result<Self, Error> {
        let stored = checkpoint.and_then(|checkpoint| checkpoint.player.as_ref());
        let log_std = if let Some(stored) = stored {
            player.load(&stored.learner)?;
            stored.log_std
        } else {
            player.load(&trainer.learner.state())?;
            trainer.log_std()
        };
        Ok(Self {
            player,
            log_std,
            mark: trainer.collector.mark(),
            rollout: trainer.rollout.clone(),
            finished: Vec::new(),
            is_played: false,
            failure: None,
        })
    }

    /// Returns what a checkpoint needs to play the rollout again.
    pub(super) fn resume(&self) -> (Mark, Player) {
        let player = Player { learner: self.player.state(), log_std: self.log_std };
        (self.mark.copy(), player)
    }
}

impl Trainer {
    /// Learns from one rollout while the next one is played. If that one fails, the next iteration
    /// returns its error, and it can be played again from a checkpoint.
    ///
    /// # Errors
    /// As [`Trainer::iterate_until`].
    pub(super) fn iterate_ahead(
        &mut self,
        ahead: &mut Ahead,
        stops: Stops<'_>,
    ) -> Result<Losses, Error> {
        if let Some(failure) = ahead.failure.take() {
            return Err(failure);
        }
        let seed = self.iteration_seed(0);
        if !ahead.is_played {
            self.activity.begin(Stage::Rollout);
            let player = Exploring { policy: &*ahead.player, log_std: ahead.log_std };
            let noise = seed.child("noise");
            self.collector.collect(&self.config, player, &mut ahead.rollout, noise, stops)?;
            ahead.finished = std::mem::take(&mut self.collector.finished);
        }
        let (progress, (mark, mut player)) = (self.progress.clone(), ahead.resume());
        for (_, tensor) in &mut player.learner {
            *tensor = tensor.copy();
        }
        std::mem::swap(&mut self.rollout, &mut ahead.rollout);
        let finished = std::mem::take(&mut ahead.finished);
        // The player's deviation is that of its weights, from before the update.
        let log_std = self.log_std();
        let parameters = self.advance();
        ahead.player.load(&self.learner.state())?;
        (ahead.log_std, ahead.mark) = (log_std, self.collector.mark());
        // No update learns from what would be played after the last update.
        let goes_on = self.progress.step < self.config.steps;
        self.activity.begin(Stage::Update);
        let noise = self.iteration_seed(1).child("noise");
        let (learner, rollout) = (&mut *self.learner, &self.rollout);
        let (updated, played) = std::thread::scope(|scope| {
            let update = scope.spawn(move || {
                // Each thread has its own number of libtorch's threads.
                tch::set_num_threads(1);
                let mut seconds = 0.0;
                let seed = seed.child("update");
                let update = || learner.update_until(rollout, &parameters, seed, stops.update);
                (timed(&mut seconds, update), seconds)
            });
            let player = Exploring { policy: &*ahead.player, log_std: ahead.log_std };
            let played = if goes_on {
                self.collector.collect(&self.config, player, &mut ahead.rollout, noise, stops)
            } else {
                Ok(())
            };
            (update.join(), played)
        });
        let (losses, seconds) = updated.unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        self.collector.timers.update += seconds;
        ahead.finished = std::mem::replace(&mut self.collector.finished, finished);
        ahead.is_played = goes_on && played.is_ok();
        if let Err(algo::Error::Stopped) = losses {
            // Both rollouts are played again.
            self.progress = progress;
            ahead.player.load(&player.learner)?;
            (ahead.log_std, ahead.mark, ahead.is_played) = (player.log_std, mark, false);
            return Err(Error::Stopped);
        }
        let losses = losses?;
        self.progress.iteration += 1;
        ahead.failure = played.err();
        Ok(losses)
    }
}
