//! What learners and evaluations need of an environment: how to start its worlds, and what is
//! observed of a world.

use std::ops::Range;
use std::path::Path;

use super::episode::WorldState;
use super::error::Error;
use super::frame::Frame;
use super::picture::{Backdrop, Picture};
use super::record::EpisodeRecord;
use super::spec::EnvSpec;
use crate::rng::Seed;

/// The episodes that worlds play.
#[derive(Debug, Clone)]
pub struct Stream {
    /// Number of worlds E.
    pub worlds: usize,
    /// Distance between consecutive episodes of a world: E, or the number of worlds of all
    /// processes where these are a part of them.
    pub stride: u64,
    /// Seed of the episodes.
    pub seed: Seed,
    /// Episodes of the stream to play: world `e` plays `start + e`, `start + e + stride`, …, and
    /// then idles.
    pub episodes: Range<u64>,
    /// Whether the episodes are those of a training. Those of evaluations and validations may be
    /// drawn from another distribution.
    pub training: bool,
    /// Chance that a world repeats one of its failed episodes, if it has any, instead of playing
    /// the next episode of the stream.
    pub repeat_failed: f64,
    /// Whether other worlds of the environment go on while these are played.
    pub beside: bool,
}

/// An environment in which policies can be trained and evaluated: it starts worlds.
///
/// [`Simple`](super::Simple) makes one of any [`MultiAgentEnv`](super::MultiAgentEnv).
pub trait Environment: Send + Sync {
    /// Returns the name of the environment, as run folders and recordings have it.
    fn name(&self) -> &str;

    /// Returns sizes, actions and features, which never change.
    fn spec(&self) -> &EnvSpec;

    /// Returns the weight of each other agent's advantages, beside an agent's own with weight 1.
    fn cooperation(&self) -> f64 {
        0.0
    }

    /// Starts worlds at the beginning of their first episodes.
    ///
    /// # Errors
    /// If the worlds cannot be started.
    fn start(&self, stream: &Stream) -> Result<Box<dyn Worlds>, Error>;

    /// Starts worlds in the states that [`Worlds::states`] returned.
    ///
    /// # Errors
    /// If the worlds cannot be started, or do not come back to these states.
    fn restore(&self, stream: &Stream, states: &[WorldState]) -> Result<Box<dyn Worlds>, Error>;

    /// Returns what lies behind the agents in pictures and in the player.
    ///
    /// # Errors
    /// If it has to be read from a file that cannot be read.
    fn backdrop(&self) -> Result<Backdrop, Error>;

    /// Returns the name and the text of a file that describes the environment, for the run folder
    /// `folder`, to which paths in the text are relative; `None` for an environment without one.
    ///
    /// # Errors
    /// If the text cannot be written relative to the folder.
    fn description(&self, _folder: &Path) -> std::io::Result<Option<(&'static str, String)>> {
        Ok(None)
    }
}

/// Many worlds of an environment, which take their steps together.
pub trait Worlds: Send {
    /// Returns the number of worlds E.
    fn count(&self) -> usize;

    /// Returns what world `e` shows.
    fn view(&self, e: usize) -> WorldView<'_>;

    /// Takes a step in all worlds with the actions `[E, N, A]`, or of more worlds. A world whose
    /// episode has ended begins the next one instead.
    ///
    /// # Errors
    /// If the worlds cannot go on.
    fn step(&mut self, actions: &[f32]) -> Result<(), Error>;

    /// Takes the records of the episodes that the last step ended.
    fn take_finished(&mut self) -> Vec<EpisodeRecord>;

    /// Returns whether every world has played all its episodes.
    fn is_finished(&self) -> bool {
        (0..self.count()).all(|e| self.view(e).phase == WorldPhase::Idle)
    }

    /// Returns the state of every world, for [`Environment::restore`].
    fn states(&self) -> Vec<WorldState>;

    /// Writes the actions of the environment's own rule, `[E, N, A]`, if it has one that acts
    /// through actions.
    fn follow_rule(&self, _actions: &mut [f32]) {}

    /// Returns what pictures show of world `e` at present; `None` for environments that draw
    /// nothing.
    fn picture(&self, e: usize) -> Option<Picture>;

    /// Returns named counters, for the log of a training.
    fn counters(&self) -> Vec<(&'static str, f64)> {
        Vec::new()
    }
}

/// What a world shows.
#[derive(Debug, Clone, Copy)]
pub struct WorldView<'a> {
    /// What learners get to see.
    pub frame: &'a Frame,
    /// Number of the current episode in its stream.
    pub episode: u64,
    /// Steps since the start of the episode.
    pub step: u32,
    /// Whether the episode goes on.
    pub phase: WorldPhase,
}

/// State of a world's episode.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WorldPhase {
    /// There is nothing left to play.
    Idle,
    /// The coming step begins an episode; the last one was not played to its end.
    Between,
    /// The episode goes on.
    Running,
    /// The episode has been played to its end, and its last frame is visible.
    Ended,
}
