//! The task that the command line of `iwol evaluate` names, in builds without the feature `learn`.

use std::path::Path;
use std::sync::Arc;

use anyhow::{Context as _, bail};
use serde::Deserialize as _;
use serde::de::IntoDeserializer as _;
use serde::de::value::Error;

use crate::env::{NamedEnvironment, Task};
use crate::evaluate::Controller;
use crate::provenance::Training;
use crate::scenario::Scenario;
use crate::sumo::{Choice, Hosting};

use super::Args;
use super::arena::Arena;

/// The task of an evaluation.
pub(super) struct Setup {
    pub(super) arena: Arena,
    /// Name of the scenario.
    pub(super) scenario: String,
    /// Fingerprint of the scenario's files, or the name of the environment.
    pub(super) fingerprint: String,
    /// Number of vehicles at spawn places.
    pub(super) agents: u32,
    /// File name of the trained policy's checkpoint: none.
    pub(super) checkpoint: Option<String>,
    /// Provenance of the trained policy: none.
    pub(super) training: Option<Training>,
}

impl Setup {
    pub(super) fn new(args: &Args) -> anyhow::Result<Self> {
        if args.run.is_some() {
            bail!(crate::cli::absent::needs_learn("a trained policy"));
        }
        if !args.set.is_empty() {
            bail!(crate::cli::absent::needs_learn("`--set`"));
        }
        if args.device != "cpu" {
            bail!(crate::cli::absent::needs_learn("`--device`"));
        }
        if let Some(name) = &args.environment {
            return Self::in_environment(args, name);
        }
        if args.agents == Some(0) {
            bail!("--agents 0: allowed: at least 1");
        }
        let path = args.scenario.as_ref().context("no scenario given; name one with --scenario")?;
        let scenario = Scenario::load(path)?;
        let agents = args.agents.unwrap_or(scenario.agents.default);
        let mut hosting = Hosting::default();
        let backend = args.backend.as_deref().unwrap_or("auto");
        let choice = Choice::deserialize(backend.into_deserializer())
            .map_err(|error: Error| anyhow::anyhow!("--backend: {error}"))?;
        hosting.backend = choice.backend();
        Ok(Self {
            arena: Arena::Roads { task: Arc::new(Task::new(&scenario, agents)?), hosting },
            fingerprint: scenario.fingerprint(),
            scenario: scenario.name,
            agents,
            checkpoint: None,
            training: None,
        })
    }

    fn in_environment(args: &Args, name: &str) -> anyhow::Result<Self> {
        let Some(named) = NamedEnvironment::find(name) else {
            bail!(
                "there is no environment `{name}` (available: {})",
                NamedEnvironment::names().join(", ")
            );
        };
        if args.backend.is_some() {
            bail!("--backend: has no effect: the environment is without SUMO");
        }
        let arena = Arena::Other(named.environment());
        let agents = u32::try_from(arena.spec().agents)?;
        if args.agents.is_some_and(|asked| asked != agents) {
            bail!("--agents: the environment has {agents} agents");
        }
        let scenario = named.name.to_owned();
        let fingerprint = scenario.clone();
        Ok(Self { arena, scenario, fingerprint, agents, checkpoint: None, training: None })
    }

    /// Returns the trained policy and its name: none.
    #[allow(clippy::unused_self, reason = "builds with the feature `learn` may have one")]
    pub(super) fn controller(&self) -> Option<(&'static str, Box<dyn Controller + '_>)> {
        None
    }

    /// Whether the trained policy's agents hear those of other episodes: there is none.
    #[allow(clippy::unused_self, reason = "builds with the feature `learn` may have one")]
    pub(super) fn is_shuffled(&self) -> bool {
        false
    }

    /// Returns the policy of an ONNX file: none.
    #[allow(clippy::unused_self, reason = "builds with the feature `learn` have some")]
    pub(super) fn model(&self, _: &Path) -> anyhow::Result<Box<dyn Controller>> {
        bail!(crate::cli::absent::needs_learn("`--policy onnx:FILE`"))
    }
}
