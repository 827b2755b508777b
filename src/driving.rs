//! Training and evaluation of driving tasks: puts scenarios, settings, SUMO and the learners
//! together, which know nothing of each other.

use std::sync::Arc;

use crate::env::{self, Pursuit, Task, Traffic};
use crate::evaluate::{self, Controller, Evaluation, EvaluationObserver};
use crate::rng::Seed;
use crate::sumo::Hosting;

#[cfg(feature = "learn")]
pub use trainer::{TooFew, resume, traffic, train_in, trainer};

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

/// Plays `episodes` episodes of the stream `seed`, and as many more as the first complete window
/// needs.
///
/// # Errors
/// As [`evaluate::evaluate`].
pub fn evaluate(
    task: &Arc<Task>,
    policy: &Policy<'_>,
    episodes: u64,
    seed: Seed,
    hosting: &Hosting,
    observer: EvaluationObserver<'_>,
) -> Result<Evaluation, env::Error> {
    let traffic = Traffic::new(task, *hosting);
    let (traffic, policy) = match policy {
        Policy::Throttle(throttle) => {
            let action = task.action(0.0, f64::from(*throttle)).map(|value| value as f32);
            (traffic, evaluate::Policy::Constant(action[..task.spec.actions.len()].to_vec()))
        }
        Policy::Pursuit(rule) => (traffic.driven_by(*rule), evaluate::Policy::Rule),
        Policy::Gaussian => (traffic, evaluate::Policy::Gaussian),
        Policy::Uniform => (traffic, evaluate::Policy::Uniform),
        Policy::Sumo => (traffic.driven_by_sumo(), evaluate::Policy::Nothing),
        Policy::Learned(controller) => (traffic, evaluate::Policy::Learned(*controller)),
    };
    evaluate::evaluate(&traffic, &policy, episodes, seed, observer)
}

#[cfg(feature = "learn")]
mod trainer {
    use std::sync::Arc;

    use crate::checkpoint::Checkpoint;
    use crate::config::{Config, TaskSource};
    use crate::env::{Environment, Task, Traffic};
    use crate::ranks::Team;
    use crate::scenario::Scenario;
    use crate::train::{Error, Trainer};

    /// Starts a run on a scenario.
    ///
    /// # Errors
    /// If the task cannot be set up, or as [`Trainer::new`].
    pub fn trainer(config: Config, scenario: &Scenario) -> Result<Trainer, Error> {
        let traffic = traffic(&config, scenario)?;
        Trainer::new(config, Box::new(traffic))
    }

    /// Continues a run on a scenario from a checkpoint, as [`Trainer::resume`] does.
    ///
    /// # Errors
    /// If the task cannot be set up, or as [`Trainer::resume`].
    pub fn resume(
        config: Config,
        scenario: &Scenario,
        checkpoint: &Checkpoint,
    ) -> Result<Trainer, Error> {
        let traffic = traffic(&config, scenario)?;
        Trainer::resume(config, Box::new(traffic), checkpoint)
    }

    /// Starts a run, or continues it from a checkpoint, on a scenario or in a named
    /// environment, together with the other processes of a team.
    ///
    /// # Errors
    /// If the task cannot be set up, or as [`Trainer::among`].
    pub fn train_in(
        config: Config,
        place: &TaskSource,
        checkpoint: Option<&Checkpoint>,
        team: &Team,
    ) -> Result<Trainer, Error> {
        let environment: Box<dyn Environment> = match place {
            TaskSource::Scenario(scenario) => Box::new(traffic(&config, scenario)?),
            TaskSource::Environment(named) => named.environment(),
        };
        Trainer::among(config, environment, checkpoint, team)
    }

    /// Returns the environment of a run on a scenario.
    ///
    /// # Errors
    /// If the task cannot be set up.
    pub fn traffic(config: &Config, scenario: &Scenario) -> Result<Traffic, Error> {
        let mut task = Task::new(scenario, config.agents)?;
        if let Some(line) = task.left_out() {
            tracing::warn!("{line}");
        }
        let fewest = config.train.fewest_agents;
        let flow = scenario.agents.come_from_files();
        let most = if flow { task.starting as u32 } else { config.agents };
        if fewest > most {
            return Err(Error::Environment(Box::new(TooFew { fewest, agents: most })));
        }
        if fewest > 0 {
            task = task.with_fewest(fewest as usize);
        }
        Ok(Traffic::new(&Arc::new(task), config.hosting()).described_by(scenario))
    }

    /// The least number of agents in an episode exceeds the number of agents.
    #[derive(Debug, thiserror::Error)]
    #[error(
        "`train.fewest_agents`, the minimum number of agents in an episode, is {fewest}; allowed: 0 to {agents}, the number of agents{}",
        if *agents == 0 { " that start at spawn places" } else { "" }
    )]
    pub struct TooFew {
        /// The setting `train.fewest_agents`.
        pub fewest: u32,
        /// The setting `agents`.
        pub agents: u32,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn policies_by_name() {
        assert!(matches!(Policy::by_name("throttle:-0.5"), Some(Policy::Throttle(a)) if a == -0.5));
        for bad in ["throttle:2", "throttle:nan", "throttle", "Gaussian", ""] {
            assert!(Policy::by_name(bad).is_none(), "{bad}");
        }
    }
}
