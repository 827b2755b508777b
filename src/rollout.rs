//! Preallocated storage of a rollout, its division into chunks, and what agents learn from it
//! (`advantages`).
//!
//! Row `t` holds what is known before decision `t`; the reward and the ends of trajectories in row
//! `t` follow from that decision. Row `T` closes the rollout: it is observed and valued, but no
//! action follows. An agent that is truncated at `t` is still observed in row `t + 1` (present, not
//! active), so that its value can be bootstrapped like any other.

#![cfg(feature = "learn")]

mod advantages;

use std::ops::Range;

/// Sizes of a rollout.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sizes {
    /// Number T of steps.
    pub steps: usize,
    /// Number E of worlds.
    pub envs: usize,
    /// Number N of agent slots.
    pub agents: usize,
    /// Number O of observation features.
    pub observation: usize,
    /// Number S of features of the privileged state.
    pub state: usize,
    /// Number A of action dimensions; 1 where actions are discrete.
    pub actions: usize,
    /// Number K of choices where actions are discrete, else 0.
    pub choices: usize,
    /// Width M of what the policy remembers per agent in training (0: nothing).
    pub memory: usize,
    /// How many numbers per agent the noise of the policy's communication graphs has at each
    /// decision (0: no graphs).
    pub graph_noise: usize,
}

/// One rollout. All arrays are row-major.
#[derive(Debug, Clone)]
pub struct Rollout {
    /// Sizes of the arrays.
    pub sizes: Sizes,
    /// Observations, `[T + 1, E, N, O]`.
    pub observation: Vec<f32>,
    /// Privileged states, `[T + 1, E, N, S]`.
    pub state: Vec<f32>,
    /// Physical mask, `[T + 1, E, N, N]`; the diagonal is 1 for agents that are present.
    pub comm: Vec<f32>,
    /// What becomes of the message from agent `j` to agent `i`: -1 if it is lost, the number of the
    /// false message that replaces it, counted from 1, or 0, `[T + 1, E, N, N]`; empty where the
    /// policy [has no radio](crate::algo::Algorithm::has_radio).
    pub disturbance: Vec<f32>,
    /// 1 where a choice is open, else 0, `[T + 1, E, N, K]`; empty where actions are continuous.
    pub available: Vec<f32>,
    /// 1 where an agent acts, else 0, `[T + 1, E, N]`.
    pub active: Vec<f32>,
    /// 1 where trajectories start and memories are cleared, else 0, `[T + 1, E, N]`.
    pub start: Vec<f32>,
    /// Memory of the policy before the decision, `[T + 1, E, N, M]`.
    pub memory: Vec<f32>,
    /// Noise of the policy's communication graphs, `[T + 1, E, N, ..]`: for each graph, side by
    /// side, a number for each agent whom the agent in this row could hear.
    pub graph_noise: Vec<f32>,
    /// Actions as sampled, not clipped, `[T, E, N, A]`.
    pub action: Vec<f32>,
    /// Log density of each dimension of the action, `[T, E, N, A]`.
    pub log_prob: Vec<f32>,
    /// Shift of each action's mean by the noise of earlier steps, in units of the scheduled
    /// standard deviation, `[T, E, N, A]`; empty where the noise is independent from step to step.
    pub carried: Vec<f32>,
    /// Logarithm of the share of each dimension's standard deviation that is drawn anew at each step,
    /// `[T, A]`; empty where the noise is independent from step to step.
    pub log_fresh: Vec<f32>,
    /// Each agent's own reward, `[T, E, N]`.
    pub reward: Vec<f32>,
    /// Weight of each other agent's advantages or penalties, beside the agent's own part with
    /// weight 1 ([`Rollout::share_advantages`], [`Rollout::rewards_with_penalties`]).
    pub cooperation: f64,
    /// Which agents share in each other's advantages, `[T, E, N, N]`: 1 where agent `i` shares in
    /// the advantage of agent `j`, else 0; empty where all agents of a world share.
    pub sharing: Vec<f32>,
    /// 1 where the trajectory terminated, else 0, `[T, E, N]`.
    pub terminated: Vec<f32>,
    /// 1 where the trajectory was truncated, at the horizon or because its simulation broke off,
    /// else 0, `[T, E, N]`.
    pub truncated: Vec<f32>,
    /// 1 where the simulation broke off, else 0, `[T, E]`.
    pub interrupted: Vec<f32>,
    /// Whether the value of the last observation stands for the rewards after the horizon.
    pub bootstrap_horizon: bool,
}

impl Rollout {
    /// Allocates the arrays, filled with zeros; the optional ones are empty.
    pub fn new(sizes: Sizes) -> Self {
        let rows = sizes.steps * sizes.envs * sizes.agents;
        let closed = (sizes.steps + 1) * sizes.envs * sizes.agents;
        Self {
            observation: vec![0.0; closed * sizes.observation],
            state: vec![0.0; closed * sizes.state],
            comm: vec![0.0; closed * sizes.agents],
            disturbance: Vec::new(),
            available: vec![0.0; closed * sizes.choices],
            active: vec![0.0; closed],
            start: vec![0.0; closed],
            memory: vec![0.0; closed * sizes.memory],
            graph_noise: vec![0.0; closed * sizes.graph_noise],
            action: vec![0.0; rows * sizes.actions],
            log_prob: vec![0.0; rows * sizes.actions],
            carried: Vec::new(),
            log_fresh: Vec::new(),
            reward: vec![0.0; rows],
            cooperation: 0.0,
            sharing: Vec::new(),
            terminated: vec![0.0; rows],
            truncated: vec![0.0; rows],
            interrupted: vec![0.0; sizes.steps * sizes.envs],
            bootstrap_horizon: false,
            sizes,
        }
    }

    /// Returns the range of step `t` in an array with `width` numbers per agent.
    pub fn at(&self, t: usize, width: usize) -> Range<usize> {
        let size = self.sizes.envs * self.sizes.agents * width;
        t * size..(t + 1) * size
    }

    /// Returns the range of step `t` in world `e`, in an array with `width` numbers per agent.
    pub fn cell(&self, t: usize, e: usize, width: usize) -> Range<usize> {
        let size = self.sizes.agents * width;
        let first = (t * self.sizes.envs + e) * size;
        first..first + size
    }

    /// Returns chunks of `length` consecutive steps of one world, as `(first step, world)`. A
    /// shorter chunk at the end of a world is left out.
    pub fn chunks(&self, length: usize) -> Vec<(usize, usize)> {
        let per_env = self.sizes.steps / length;
        (0..per_env).flat_map(|c| (0..self.sizes.envs).map(move |e| (c * length, e))).collect()
    }

    /// Returns the rows `t · E + e` of chunks, step-major: all first steps, then all second steps,
    /// and so on.
    pub fn rows(&self, chunks: &[(usize, usize)], length: usize) -> Vec<i64> {
        (0..length)
            .flat_map(|l| chunks.iter().map(move |&(t, e)| ((t + l) * self.sizes.envs + e) as i64))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn chunks_partition_the_rollout(steps in 1usize..40, envs in 1usize..5, length in 1usize..11) {
            let rollout = Rollout::new(Sizes {
                steps, envs, agents: 2, observation: 1, state: 1, actions: 1, choices: 0, memory: 0, graph_noise: 0,
            });
            let chunks = rollout.chunks(length);
            let mut rows = rollout.rows(&chunks, length);
            // Step-major: entry l · chunks + c is step l of chunk c.
            for (i, &row) in rows.iter().enumerate() {
                let (t, e) = chunks[i % chunks.len()];
                prop_assert_eq!(row as usize, (t + i / chunks.len()) * envs + e);
            }
            rows.sort_unstable();
            prop_assert_eq!(rows, (0..(steps / length * length * envs) as i64).collect::<Vec<_>>());
        }
    }
}
