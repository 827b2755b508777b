//! What can be wrong with a sweep.

use std::path::PathBuf;

use crate::config;

/// What is wrong with a sweep.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The file cannot be read.
    #[error("cannot read `{}`", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The file is not TOML, or has keys that a sweep has not.
    #[error("{file}: {message}")]
    Syntax {
        /// The file.
        file: String,
        /// What is wrong, with line and column.
        message: String,
    },
    /// The file makes no sense.
    #[error("{file}: {message}")]
    Content {
        /// The file.
        file: String,
        /// What is wrong.
        message: String,
    },
    /// The settings of a cell are not valid.
    #[error("{place}")]
    Cell {
        /// File and cell.
        place: String,
        /// What is wrong.
        source: config::Error,
    },
    /// A file of a cell cannot be read or written.
    #[error(transparent)]
    Record(#[from] crate::record::Error),
    /// A cell's folder holds a run of a scenario that has changed since.
    #[error(
        "`{}` was trained on `{}` as it was before: that file has changed, or a net or route file that it names; change it back, \
         or move the run away, or choose another --out",
        folder.display(), path.display()
    )]
    Scenario {
        /// The cell's folder.
        folder: PathBuf,
        /// The scenario's file.
        path: PathBuf,
    },
    /// What a report is made from would replace a run.
    #[error("`{}` holds a run with its weights; choose another folder to keep what reports are made from", folder.display())]
    Kept {
        /// The run's folder.
        folder: PathBuf,
    },
    /// A cell's folder holds a run with other settings.
    #[error(
        "`{}` holds a run with another `{key}`: {was}, and now {is}; move it away, or choose another --out",
        folder.display()
    )]
    Changed {
        /// The cell's folder.
        folder: PathBuf,
        /// The setting.
        key: String,
        /// In the folder.
        was: String,
        /// In the sweep file.
        is: String,
    },
}
