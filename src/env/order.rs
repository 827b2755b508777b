//! Order in which a world plays episodes: those of its stream and, in training, now and then one
//! that failed before (prioritised level replay with failure as the score: Jiang et al., ICML
//! 2021).

use rand::RngExt;
use serde::{Deserialize, Serialize};

use crate::rng::{self, Seed};

/// Most failed episodes that a world remembers.
const MEMORY: usize = 16;

/// Position of a world in its order of episodes.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Position {
    /// Episode that comes next.
    pub next: u64,
    /// First episode of the stream that has not been played.
    pub fresh: u64,
    /// Number that the next episode would have if none were repeated: it grows by the world's
    /// stride with every episode that begins, repeated ones included.
    pub episode_index: u64,
    /// Whether the current episode repeats an earlier one.
    pub replaying: bool,
    /// Episodes that failed when last played, oldest first.
    pub failed: Vec<u64>,
}

impl Position {
    /// Returns the position before `episode`, with no failed episodes remembered.
    pub(crate) fn before(episode: u64) -> Self {
        Self {
            next: episode,
            fresh: episode,
            episode_index: episode,
            replaying: false,
            failed: Vec::new(),
        }
    }
}

/// The order of a world's episodes.
#[derive(Debug, Clone)]
pub(super) struct Order {
    seed: Seed,
    /// Distance between consecutive episode numbers of this world.
    stride: u64,
    /// End of the stream: episodes from this number on are not played.
    end: u64,
    /// Probability that a failed episode is repeated next, if there is one; 0: never.
    repeat_failed: f64,
    pub(super) position: Position,
}

impl Order {
    /// Plays episodes `first, first + stride, …` below `end` of the stream `seed`, and repeats
    /// none.
    pub(super) fn new(seed: Seed, first: u64, stride: u64, end: u64) -> Self {
        Self {
            seed: seed.child("replay"),
            stride,
            end,
            repeat_failed: 0.0,
            position: Position::before(first),
        }
    }

    pub(super) fn with_repeat_failed(self, repeat_failed: f64) -> Self {
        Self { repeat_failed, ..self }
    }

    /// Continues with `episode` and those that follow it in the stream. Failed episodes stay
    /// remembered.
    pub(super) fn go_to(&mut self, episode: u64) {
        self.position = Position {
            failed: std::mem::take(&mut self.position.failed),
            ..Position::before(episode)
        };
    }

    /// Undoes the beginning of `episode`, which comes next again.
    pub(super) fn repeat(&mut self, episode: u64) {
        self.position.next = episode;
        self.position.episode_index -= self.stride;
        if !self.position.replaying {
            self.position.fresh = episode;
        }
    }

    /// Returns the number that the current episode would have if none had been repeated.
    pub(super) fn episode_index(&self) -> u64 {
        self.position.episode_index.saturating_sub(self.stride)
    }

    /// Begins the next episode and returns its number; `None` when all have been played.
    pub(super) fn begin(&mut self) -> Option<u64> {
        let Position { next, fresh, episode_index, replaying, .. } = &mut self.position;
        if *next >= self.end {
            return None;
        }
        let episode = *next;
        *replaying = episode < *fresh;
        if !*replaying {
            *fresh = episode + self.stride;
        }
        *episode_index += self.stride;
        *next = *fresh;
        Some(episode)
    }

    /// Records the end of `episode`, and whether all agents arrived (`solved`). Chooses the next
    /// episode.
    pub(super) fn ended(&mut self, episode: u64, solved: bool) {
        if self.repeat_failed <= 0.0 {
            return;
        }
        let episode_index = self.episode_index();
        let Position { next, failed, .. } = &mut self.position;
        failed.retain(|&other| other != episode);
        if !solved {
            failed.push(episode);
            if failed.len() > MEMORY {
                failed.remove(0);
            }
        }
        let mut rng = self.seed.index(episode_index).rng();
        if !failed.is_empty() && rng.random_bool(self.repeat_failed) {
            *next = failed[rng::below(&mut rng, failed.len())];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn play(order: &mut Order, count: usize, solved: impl Fn(u64) -> bool) -> Vec<(u64, bool)> {
        let episode = |order: &mut Order| {
            let episode = order.begin()?;
            order.ended(episode, solved(episode));
            Some((episode, order.position.replaying))
        };
        (0..count).map_while(|_| episode(order)).collect()
    }

    #[test]
    fn without_replay_the_stream_is_played_in_order() {
        let mut order = Order::new(Seed::new(1), 2, 3, 12);
        order.begin();
        order.repeat(2);
        assert_eq!(order.position, Position::before(2));
        assert_eq!(
            play(&mut order, 9, |_| false),
            [(2, false), (5, false), (8, false), (11, false)]
        );
        assert_eq!(order.position.failed, [0; 0]);
    }

    #[test]
    fn failed_episodes_come_back_until_they_are_solved() {
        let mut order = Order::new(Seed::new(1), 0, 4, u64::MAX).with_repeat_failed(0.5);
        let hard = |episode: u64| episode != 8 && episode != 40;
        let begun = play(&mut order, 400, hard);
        let fresh: Vec<u64> = begun.iter().filter(|b| !b.1).map(|b| b.0).collect();
        assert!(
            fresh.iter().copied().eq((0..fresh.len() as u64).map(|k| 4 * k)),
            "nothing of the stream is left out"
        );
        let again = |episode| begun.iter().filter(|b| b.1 && b.0 == episode).count();
        assert!(
            begun.iter().all(|b| !b.1 || b.0 == 8 || b.0 == 40),
            "what was solved is not repeated"
        );
        assert!(
            again(8) > 60 && again(40) > 60 && again(8) + again(40) < 240,
            "{} {}",
            again(8),
            again(40)
        );
        assert_eq!(order.position.failed.len(), 2);
        play(&mut order, 100, |_| true);
        assert_eq!(order.position.failed, [0; 0], "solved ones are forgotten");
    }

    #[test]
    fn few_are_remembered_and_none_twice() {
        let mut order = Order::new(Seed::new(3), 1, 2, u64::MAX).with_repeat_failed(0.3);
        play(&mut order, 200, |_| false);
        let mut failed = order.position.failed.clone();
        assert_eq!(failed.len(), MEMORY);
        failed.sort_unstable();
        failed.dedup();
        assert_eq!(failed.len(), MEMORY);
    }

    #[test]
    fn goes_on_from_a_position_as_without_a_break() {
        let solved = |episode: u64| !episode.is_multiple_of(3);
        let mut order = Order::new(Seed::new(5), 0, 2, u64::MAX).with_repeat_failed(0.5);
        play(&mut order, 37, solved);
        let mut other = Order::new(Seed::new(5), 0, 2, u64::MAX).with_repeat_failed(0.5);
        other.position = order.position.clone();
        assert_eq!(play(&mut order, 50, solved), play(&mut other, 50, solved));
    }
}
