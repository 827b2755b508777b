//! What agents observe of their last action where exploration noise lasts.
//!
//! An agent that observes its last action with the noise in it learns to act against the noise,
//! which is still there in the next step. Without noise, in a validation, it then acts against
//! itself, and brakes and accelerates in turn. So agents observe what they do without noise: their
//! last mean action. The noise begins anew with each rollout, so that the last action of the rollout
//! before tells nothing about it.

use crate::env::{ActionSpace, EnvSpec};
use crate::rollout::Rollout;

/// The mean actions of a step, for the observations of the next one.
pub(super) struct LastAction {
    /// The dimensions of actions that agents observe and whose noise lasts, each with its feature
    /// in the observation.
    seen: Vec<(usize, usize)>,
    /// The last mean actions, clipped to -1 to 1, `[E, N, A]`.
    means: Vec<f32>,
}

impl LastAction {
    /// # Panics
    /// If an environment names a feature that its observation does not have.
    pub(super) fn new(spec: &EnvSpec) -> Self {
        let seen = match &spec.actions {
            ActionSpace::Continuous(dimensions) => {
                let lasting = dimensions.iter().enumerate().filter(|(_, d)| d.noise_lasts);
                lasting.filter_map(|(d, dimension)| Some((d, dimension.feature?))).collect()
            }
            ActionSpace::Discrete(_) => Vec::new(),
        };
        let width = spec.observation.len();
        let known = seen.iter().all(|&(_, feature): &(usize, usize)| feature < width);
        assert!(known, "a dimension's `feature` is not among the {width} of the observation");
        Self { seen, means: Vec::new() }
    }

    /// Notes the means of `actions [E, N, A]`, which have the noise `noise [E, N, A]`, in units of
    /// each dimension's standard deviation, `deviations [A]`.
    pub(super) fn note(&mut self, actions: &[f32], noise: &[f32], deviations: &[f32]) {
        let deviations = deviations.iter().cycle();
        let parts = actions.iter().zip(noise).zip(deviations);
        self.means.clear();
        self.means.extend(
            parts.map(|((action, noise), deviation)| (action - noise * deviation).clamp(-1.0, 1.0)),
        );
    }

    /// Writes the noted means into row `t` of the observations of all present agents whose
    /// trajectories began before row `t`.
    pub(super) fn show(&self, rollout: &mut Rollout, t: usize) {
        let s = rollout.sizes;
        for agent in 0..s.envs * s.agents {
            let row = rollout.at(t, 1).start + agent;
            let present = rollout.comm[row * s.agents + agent % s.agents] > 0.0;
            if !present || rollout.start[row] > 0.0 {
                continue;
            }
            for &(dimension, feature) in &self.seen {
                rollout.observation[row * s.observation + feature] =
                    self.means[agent * s.actions + dimension];
            }
        }
    }
}
