//! The folder of a run.

use std::fs::{File, TryLockError};
use std::path::{Path, PathBuf};

use super::Error;

/// Files of a run.
#[derive(Debug, Clone)]
pub struct RunDir(PathBuf);

impl RunDir {
    /// A run folder; nothing is created.
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self(path.into())
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        &self.0
    }

    /// The resolved configuration.
    pub fn config(&self) -> PathBuf {
        self.0.join("config.toml")
    }

    /// How and with what the run was started.
    pub fn meta(&self) -> PathBuf {
        self.0.join("meta.json")
    }

    /// [`Scenario::fingerprint`](crate::scenario::Scenario::fingerprint) of the scenario that the run was begun with; none before it is
    /// begun, and of older runs.
    pub fn fingerprint(&self) -> Option<String> {
        let meta: serde_json::Value = serde_json::from_slice(&std::fs::read(self.meta()).ok()?).ok()?;
        Some(meta["scenario"].as_str()?.to_owned())
    }

    /// A line per iteration, and one per validation.
    pub fn metrics(&self) -> PathBuf {
        self.0.join("metrics.jsonl")
    }

    /// A line per validation episode.
    pub fn episodes(&self) -> PathBuf {
        self.0.join("eval.jsonl")
    }

    /// The newest checkpoint.
    pub fn last(&self) -> PathBuf {
        self.0.join("checkpoints/last.safetensors")
    }

    /// The checkpoint with the best validation.
    pub fn best(&self) -> PathBuf {
        self.0.join("checkpoints/best.safetensors")
    }

    /// Makes the folder and claims it for this process until the result is dropped, or the process is gone.
    ///
    /// # Errors
    /// [`Error::Locked`] when another process trains there.
    pub fn lock(&self) -> Result<File, Error> {
        std::fs::create_dir_all(&self.0).map_err(|source| Error::Folder { path: self.0.clone(), source })?;
        let failed = |source| Error::Folder { path: self.0.clone(), source };
        let file = File::options().create(true).append(true).open(self.lock_file()).map_err(failed)?;
        match file.try_lock() {
            Ok(()) => Ok(file),
            Err(TryLockError::WouldBlock) => Err(Error::Locked { path: self.0.clone() }),
            Err(TryLockError::Error(source)) => Err(failed(source)),
        }
    }

    /// Whether a process trains there.
    pub fn is_locked(&self) -> bool {
        File::open(self.lock_file()).is_ok_and(|file| matches!(file.try_lock_shared(), Err(TryLockError::WouldBlock)))
    }

    fn lock_file(&self) -> PathBuf {
        self.0.join(".lock")
    }

    /// The checkpoint that `path` stands for: a file for itself, a run folder for its best one, or else its last.
    pub fn checkpoint(path: &Path) -> PathBuf {
        let dir = Self::new(path);
        match () {
            () if !path.is_dir() => path.to_owned(),
            () if dir.best().exists() => dir.best(),
            () => dir.last(),
        }
    }
}
