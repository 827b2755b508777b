//! Measures what a latent predicts beyond the observation from which it is computed.
//!
//! A decoder predicts a target (the privileged state, or the agent's message) from the latent. Much
//! of the target may already be contained in the observation, and then predicting it shows nothing.
//! The decoder is therefore also evaluated on only those features of the target that the
//! observation does not determine, in comparison with a linear probe: ridge regression from the raw
//! observation to the target.

use serde::Serialize;

/// Limit from which a target feature counts as determined by the observation: the share of its
/// variance that the probe explains in episodes on which it was not fitted.
pub const DETERMINED: f64 = 0.99;
/// How well a decoder predicts its target from a latent, over the active agents in every eighth
/// step.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Knowledge {
    /// The target: `world` (the privileged state) or `interaction` (the agent's message).
    pub name: &'static str,
    /// Mean squared error over samples and features.
    pub error: f64,
    /// Share of the target's variance that the decoder explains: 1 is perfect, 0 is as good as
    /// predicting the mean.
    pub explained: f64,
    /// Comparison with a linear probe from the observation; `None` with too few episodes or
    /// samples.
    pub probe: Option<Probe>,
}

/// Comparison of a decoder with a linear probe from the raw observation, on episodes on which the
/// probe was not fitted. Features that hardly vary are left out.
///
/// A linear probe finds only weighted sums of the observation's features. A feature that the
/// observation determines in another way (a product, a minimum, a case distinction) counts as
/// undetermined. The number of undetermined features is therefore an upper bound of the number that
/// the observation leaves open.
#[derive(Debug, Clone, PartialEq, Serialize)]
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
