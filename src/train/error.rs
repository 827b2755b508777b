//! Errors in training.

use std::path::PathBuf;

use crate::{algo, checkpoint, env, record};

/// An error in training.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A world failed.
    #[error(transparent)]
    Env(#[from] env::Error),
    /// The environment cannot be set up with these settings.
    #[error(transparent)]
    Environment(Box<dyn std::error::Error + Send + Sync>),
    /// The learner failed.
    #[error(transparent)]
    Algorithm(#[from] algo::Error),
    /// The caller gave up an iteration.
    #[error("the iteration was stopped")]
    Stopped,
    /// A file of the run cannot be written.
    #[error(transparent)]
    Record(#[from] record::Error),
    /// A checkpoint cannot be read or written.
    #[error(transparent)]
    Checkpoint(#[from] checkpoint::Error),
    /// The requested device is not available.
    #[error(transparent)]
    Device(#[from] algo::NoDevice),
    /// The initial weights do not fit this run's networks.
    #[error("the weights in `{}` do not fit this run's networks and observations", path.display())]
    InitFrom {
        /// The checkpoint.
        path: PathBuf,
        /// The mismatch.
        source: algo::Error,
    },
    /// The initial weights belong to a policy that observes other numbers.
    #[error("the policy in `{}` observes other numbers than this run's agents: {difference}", path.display())]
    OtherObservation {
        /// The checkpoint.
        path: PathBuf,
        /// The first difference.
        difference: String,
    },
    /// The initial weights belong to another method.
    #[error(
        "`{}` contains a policy of {of}, but this run trains {trained}, which has other networks",
        path.display()
    )]
    OtherMethod {
        /// The checkpoint.
        path: PathBuf,
        /// Method of the checkpoint.
        of: String,
        /// Method of this run.
        trained: String,
    },
    /// The run folder cannot be created.
    #[error("cannot create the run folder `{}`", path.display())]
    Folder {
        /// The folder.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// Another process trains in the folder.
    #[error("another process is training in `{}`; wait for it, or choose another folder", path.display())]
    Locked {
        /// The folder.
        path: PathBuf,
    },
    /// There are more processes than pieces of work.
    #[error(
        "{key} is {count}, so that {size} processes cannot each have one; start fewer processes, or set it to {size} or more"
    )]
    TooManyRanks {
        /// The setting.
        key: &'static str,
        /// Its value.
        count: usize,
        /// Number of processes.
        size: usize,
    },
    /// Several processes cannot play and learn at the same time.
    #[error(
        "train.overlap is true, but {size} processes exchange results while they simulate and while they learn, one after the other; \
         set it to false, or start one process"
    )]
    OverlapAmongRanks {
        /// Number of processes.
        size: usize,
    },
    /// Processes of one training have come to different weights.
    #[error(
        "the processes of this training have come to different weights in iteration {iteration}, so that it cannot go on: their machines compute differently; start it on machines of one kind"
    )]
    Diverged {
        /// Number of the iteration.
        iteration: u64,
    },
    /// The checkpoint belongs to a run with other settings and cannot be resumed with these.
    #[error(
        "the checkpoint was written with another `{key}`; resume with the settings in the config.toml of its run folder"
    )]
    OtherRun {
        /// The first setting that differs.
        key: String,
    },
}
