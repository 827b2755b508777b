//! The result of an evaluation, as `iwol evaluate` writes it and reports read it.

use serde::{Deserialize, Serialize};

use super::Metrics;
use crate::provenance::{Program, Training};
use crate::stats::Estimate;

/// One evaluated policy: an object of the JSON output of `iwol evaluate`. Fields that files of
/// older versions lack have their defaults.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct EvaluationResult {
    /// Name of the scenario.
    pub scenario: String,
    /// Fingerprint of the scenario's files
    /// ([`Scenario::fingerprint`](crate::scenario::Scenario::fingerprint)), or the name of an
    /// environment without SUMO; absent in results of earlier versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fingerprint: Option<String>,
    /// Number of agents.
    pub agents: u32,
    /// Number of vehicles that the policy controls; present only if SUMO drives some of the
    /// vehicles at start places.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub learners: Option<usize>,
    /// Whether SUMO checked for collisions inside junctions as well (`simulation.audit`).
    #[serde(skip)]
    pub audited: bool,
    /// Name of the policy: of the algorithm, or as in `--policy`.
    pub policy: String,
    /// Number of episodes.
    pub episodes: u64,
    /// Seed of the episodes.
    pub seed: u64,
    /// File name of the checkpoint; present only for a learned policy.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub checkpoint: Option<String>,
    /// The values of `--set`, in order.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub set: Vec<String>,
    /// The program that evaluated the policy.
    pub program: Program,
    /// Provenance of the training; present only for a learned policy.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub run: Option<Training>,
    /// The metrics.
    pub metrics: Metrics,
    /// Indices of the episodes in which not every agent succeeded, in order.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub failed_episodes: Vec<u64>,
}

impl EvaluationResult {
    /// Reads the output of `iwol evaluate`: one object, or a list for several policies.
    ///
    /// # Errors
    /// The parser's error if the text is not such an output.
    pub fn read_all(text: &str) -> serde_json::Result<Vec<Self>> {
        if text.trim_start().starts_with('[') {
            serde_json::from_str(text)
        } else {
            Ok(vec![serde_json::from_str(text)?])
        }
    }
}

/// Distance that agents drive per crash, over all episodes together.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct KmPerCrash {
    /// Distance that agents drove \[km\].
    pub km: f64,
    /// Number of crashes of agents ([`crate::env::DrivingRecord::crashes`]).
    pub crashes: u64,
    /// Kilometres per crash with the exact interval of a Poisson count; only a lower bound without
    /// a crash.
    #[serde(flatten)]
    pub estimate: Estimate,
}

impl KmPerCrash {
    /// Computes the estimate from a distance \[km\] and a number of crashes; `None` if the distance
    /// is 0.
    pub fn new(km: f64, crashes: u64) -> Option<Self> {
        Some(Self { km, crashes, estimate: Estimate::exposure_per_event(km, crashes)? })
    }
}

/// How well a decoder predicts its target from a latent, over the active agents in every eighth
/// step.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Knowledge {
    /// The target: `world` (the privileged state) or `interaction` (the agent's message).
    pub name: String,
    /// Mean squared error over samples and features.
    pub error: f64,
    /// Share of the target's variance that the decoder explains: 1 is perfect, 0 is as good as
    /// predicting the mean.
    pub explained: f64,
    /// Comparison with a linear probe from the observation; `None` with too few episodes or
    /// samples.
    pub probe: Option<Probe>,
}

/// Limit from which a target feature counts as determined by the observation: the share of its
/// variance that the probe explains in episodes on which it was not fitted.
pub const DETERMINED: f64 = 0.99;

/// Comparison of a decoder with a linear probe from the raw observation, on episodes on which the
/// probe was not fitted. Features that hardly vary are left out.
///
/// A linear probe finds only weighted sums of the observation's features. A feature that the
/// observation determines in another way (a product, a minimum, a case distinction) counts as
/// undetermined. The number of undetermined features is therefore an upper bound of the number that
/// the observation leaves open.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Probe {
    /// Number of samples on which probe and decoder are compared.
    pub samples: u64,
    /// Number of features of the target that vary.
    pub features: usize,
    /// Share of the variance of all these features that the probe explains.
    pub explained: f64,
    /// Number of features that the observation does not determine: the probe explains less than
    /// [`DETERMINED`].
    pub undetermined: usize,
    /// Share of the variance of the undetermined features that the decoder explains; `None` if all
    /// features are determined.
    pub undetermined_explained: Option<f64>,
    /// Share of the variance of the undetermined features that the probe explains; `None` if all
    /// features are determined.
    pub undetermined_probe_explained: Option<f64>,
}
