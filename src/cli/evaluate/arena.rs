//! Where `iwol evaluate` plays: on the roads of a scenario, or in an environment without SUMO.

use std::sync::Arc;

use anyhow::bail;

use crate::driving::{self, Policy};
use crate::env::{Backdrop, EnvSpec, Environment, Error, Task};
use crate::evaluate::{self, Evaluation, EvaluationObserver};
use crate::rng::Seed;
use crate::sumo::Hosting;

/// Where policies are evaluated.
pub(super) enum Arena {
    Roads { task: Arc<Task>, hosting: Hosting },
    Other(Box<dyn Environment>),
}

impl Arena {
    pub(super) fn spec(&self) -> &EnvSpec {
        match self {
            Self::Roads { task, .. } => &task.spec,
            Self::Other(environment) => environment.spec(),
        }
    }

    /// Returns the time between the decisions of agents that drive \[s\].
    #[cfg(feature = "learn")]
    pub(super) fn interval(&self) -> Option<f64> {
        match self {
            Self::Roads { task, .. } => Some(task.scenario.control.interval),
            Self::Other(_) => None,
        }
    }

    pub(super) fn backdrop(&self) -> Result<Backdrop, Error> {
        match self {
            Self::Roads { task, .. } => task.backdrop(),
            Self::Other(environment) => environment.backdrop(),
        }
    }

    /// Returns what the user should know of the task before it is played.
    pub(super) fn left_out(&self) -> Option<String> {
        match self {
            Self::Roads { task, .. } => task.left_out(),
            Self::Other(_) => None,
        }
    }

    /// Returns the number of agents if SUMO drives some of the `vehicles` at spawn places.
    pub(super) fn learners(&self, vehicles: u32) -> Option<usize> {
        let agents = self.spec().agents;
        (matches!(self, Self::Roads { .. }) && agents < vehicles as usize).then_some(agents)
    }

    /// Whether SUMO looks for collisions in junctions as well.
    pub(super) fn is_audited(&self) -> bool {
        matches!(self, Self::Roads { hosting, .. } if hosting.audit)
    }

    /// Refuses a policy that only vehicles can have.
    pub(super) fn check(&self, name: &str, policy: &Policy<'_>) -> anyhow::Result<()> {
        let any = matches!(policy, Policy::Gaussian | Policy::Uniform | Policy::Learned(_));
        if matches!(policy, Policy::Gaussian) && self.spec().actions.choices().is_some() {
            bail!(
                "{name} gives continuous actions, and those of the environment are choices; use uniform"
            );
        }
        if matches!(self, Self::Other(_)) && !any {
            bail!(
                "{name} drives vehicles; in an environment without SUMO choose uniform, or gaussian where actions are continuous"
            );
        }
        Ok(())
    }

    pub(super) fn evaluate(
        &self,
        policy: &Policy<'_>,
        episodes: u64,
        seed: Seed,
        observer: EvaluationObserver<'_>,
    ) -> Result<Evaluation, Error> {
        match self {
            Self::Roads { task, hosting } => {
                driving::evaluate(task, policy, episodes, seed, hosting, observer)
            }
            Self::Other(environment) => {
                let policy = match policy {
                    Policy::Learned(controller) => evaluate::Policy::Learned(*controller),
                    Policy::Uniform => evaluate::Policy::Uniform,
                    _ => evaluate::Policy::Gaussian,
                };
                evaluate::evaluate(&**environment, &policy, episodes, seed, observer)
            }
        }
    }
}
