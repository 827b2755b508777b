//! A world's place in its episodes: which one it plays, how far it has come, and what is needed to
//! come back to exactly this place.

use serde::{Deserialize, Serialize};

use super::order::{Order, Position};
use crate::rng::Seed;

/// State of a world between two exchanges.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Phase {
    /// Nothing happens until a reset.
    Idle,
    /// The coming exchange respawns.
    Ended,
    /// The respawn has been sent, and its snapshot is awaited.
    Spawning,
    /// An episode is under way.
    Running,
}

/// A world's place in its episodes, enough to restore exactly the same state.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct WorldState {
    /// Number of the current episode.
    pub episode: u64,
    /// Actions since the episode's spawn, `[steps, N, A]`.
    pub actions: Vec<f32>,
    /// Whether the simulation broke off in the last exchange, so that `episode` is yet to start.
    pub interrupted: bool,
    /// Position in the order of episodes.
    pub position: Position,
    /// What agents observe in this state, `[N, O]`, to check that a restored world comes back to
    /// it; empty for worlds that check it otherwise.
    #[serde(default)]
    pub observation: Vec<f32>,
}

/// The current episode of a world and those that follow.
#[derive(Debug, Clone)]
pub(super) struct Episode {
    seed: Seed,
    order: Order,
    /// Number of the episode in its stream.
    pub(super) index: u64,
    pub(super) phase: Phase,
    /// Steps since the start of the episode.
    pub(super) step: u32,
    /// Number of episodes that started while the simulation went on.
    pub(super) respawns: u64,
    /// Whether the simulation broke off in the last exchange.
    pub(super) interrupted: bool,
    actions: Vec<f32>,
}

impl Episode {
    /// Plays episodes `first, first + stride, …` below `end` of the stream `seed`, once it is
    /// reset.
    pub(super) fn new(seed: Seed, first: u64, stride: u64, end: u64) -> Self {
        Self {
            seed,
            order: Order::new(seed, first, stride, end),
            index: first,
            phase: Phase::Idle,
            step: 0,
            respawns: 0,
            interrupted: false,
            actions: Vec::new(),
        }
    }

    /// Repeats one of the failed episodes, if there are any, with this chance.
    pub(super) fn with_repeat_failed(self, chance: f64) -> Self {
        Self { order: self.order.with_repeat_failed(chance), ..self }
    }

    /// Returns the seed of the episode.
    pub(super) fn seed(&self) -> Seed {
        self.seed.index(self.index)
    }

    /// Returns SUMO's seed for the next episode.
    pub(super) fn simulator_seed(&self) -> u64 {
        self.seed.child("sumo").index(self.order.position.next).word()
    }

    /// Returns whether the episode repeats one that failed before.
    pub(super) fn is_repeated(&self) -> bool {
        self.order.position.replaying
    }

    /// Makes the coming exchange start the first of the episodes `first, first + stride, …` below
    /// `end` of another stream.
    pub(super) fn restart(&mut self, seed: Seed, first: u64, stride: u64, end: u64) {
        *self = Self {
            phase: Phase::Ended,
            respawns: self.respawns,
            interrupted: self.interrupted,
            ..Self::new(seed, first, stride, end)
        };
    }

    /// Makes the coming exchange start the episode with this number.
    pub(super) fn go_to(&mut self, index: u64) {
        self.order.go_to(index);
        self.phase = Phase::Ended;
    }

    /// Begins the next episode. Returns `false` if none is left.
    pub(super) fn begin(&mut self) -> bool {
        let fresh = std::mem::take(&mut self.interrupted);
        let Some(index) = self.order.begin() else {
            self.phase = Phase::Idle;
            return false;
        };
        self.index = index;
        self.respawns += u64::from(!fresh);
        self.step = 0;
        self.actions.clear();
        self.phase = Phase::Spawning;
        true
    }

    /// Notes the actions of the coming step, `[N, A]`.
    pub(super) fn note(&mut self, actions: &[f32]) {
        self.actions.extend_from_slice(actions);
    }

    /// Ends the episode; `solved`: whether all agents arrived.
    pub(super) fn end(&mut self, solved: bool) {
        self.phase = Phase::Ended;
        self.order.ended(self.index, solved);
    }

    /// Ends the episode because the simulation broke off.
    pub(super) fn abandon(&mut self) {
        self.interrupted = true;
        if self.phase == Phase::Spawning {
            self.order.repeat(self.index);
        }
        self.phase = Phase::Ended;
    }

    /// Returns the state, for a checkpoint.
    pub(super) fn state(&self) -> WorldState {
        let position = self.order.position.clone();
        let (episode, actions) = if self.interrupted {
            (position.next, Vec::new())
        } else {
            (self.index, self.actions.clone())
        };
        let interrupted = self.interrupted;
        WorldState { episode, actions, interrupted, position, observation: Vec::new() }
    }

    /// Completes the restoration of a state, after the state's actions have been repeated.
    pub(super) fn restore(&mut self, state: &WorldState) {
        if state.interrupted {
            self.interrupted = true;
            self.phase = Phase::Ended;
        }
        self.order.position = state.position.clone();
    }
}
