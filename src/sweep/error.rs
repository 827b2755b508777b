//! Errors of sweeps.

use std::path::PathBuf;

use crate::config;

/// An error of a sweep.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The content of the file is not valid.
    #[error("{file}: {message}")]
    Content {
        /// The file.
        file: String,
        /// Description of the error, with line and column where they are known.
        message: String,
    },
    /// The settings of a cell are not valid.
    #[error("{place}")]
    Cell {
        /// File and cell, as text.
        place: String,
        /// The error of the settings.
        source: config::Error,
    },
    /// A result file does not contain what `iwol evaluate` writes.
    #[error("`{}` is damaged; delete it, and run the sweep again", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// The parser's reason.
        source: serde_json::Error,
    },
    /// The settings in a cell's folder are damaged.
    #[error("`{}` is damaged ({message}), so that it is not known which run this is; restore it, or delete the run", path.display())]
    Settings {
        /// The file.
        path: PathBuf,
        /// The parser's reason.
        message: String,
    },
    /// A file cannot be read or written.
    #[error(transparent)]
    Record(#[from] crate::record::Error),
    /// A cell's folder contains a run of a scenario that has changed since.
    #[error(
        "`{}` was trained with an earlier version of `{}`: this file, or a net or route file that it names, has changed; restore \
         the files, move the run to another folder, or choose another folder for runs (`iwol sweep --out`, `iwol report --runs`)",
        folder.display(), path.display()
    )]
    Scenario {
        /// The cell's folder.
        folder: PathBuf,
        /// The scenario's file.
        path: PathBuf,
    },
    /// A cell's folder contains a run that began with an earlier policy of another cell.
    #[error(
        "`{}` began with an earlier policy of the cell {after}, which has been trained anew since; move the run to another folder, or delete it to train it again",
        folder.display()
    )]
    Follows {
        /// The cell's folder.
        folder: PathBuf,
        /// The other cell.
        after: String,
    },
    /// The data of a report would replace a run that has its weights.
    #[error("`{}` contains a run with its weights; choose another folder for the data of reports", folder.display())]
    Kept {
        /// The run's folder.
        folder: PathBuf,
    },
    /// A cell's folder contains a run with other settings.
    #[error(
        "`{}` contains a run with another `{key}`: {was} in the run, {is} in the sweep file; move the run to another folder, or choose another folder for runs (`iwol sweep --out`, `iwol report --runs`)",
        folder.display()
    )]
    Changed {
        /// The cell's folder.
        folder: PathBuf,
        /// The setting.
        key: String,
        /// Its value in the folder.
        was: String,
        /// Its value in the sweep file.
        is: String,
    },
}
