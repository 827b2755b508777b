//! The folder of a run.

use std::fs::{File, TryLockError};
use std::path::{Path, PathBuf};

use super::Error;

/// The paths of the files in a run folder.
#[derive(Debug, Clone)]
pub struct RunDir(PathBuf);

impl RunDir {
    /// Returns the run folder `path`; nothing is created.
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self(path.into())
    }

    /// Returns the path of the folder.
    pub fn path(&self) -> &Path {
        &self.0
    }

    /// Returns the path of the resolved configuration.
    pub fn config(&self) -> PathBuf {
        self.0.join("config.toml")
    }

    /// Returns the path of the scenario with the values of the configuration.
    pub fn scenario(&self) -> PathBuf {
        self.0.join("scenario.xml")
    }

    /// Returns the path of `meta.json`: the program, command and machine of the training, and its
    /// progress.
    pub fn meta(&self) -> PathBuf {
        self.0.join("meta.json")
    }

    /// Returns the [`Scenario::fingerprint`](crate::scenario::Scenario::fingerprint) of the
    /// scenario with which the run was begun; `None` before it is begun and for older runs.
    pub fn fingerprint(&self) -> Option<String> {
        Some(self.read_meta()?["scenario"].as_str()?.to_owned())
    }

    /// Returns the path of the metrics: one line per iteration and one per validation.
    pub fn metrics(&self) -> PathBuf {
        self.0.join("metrics.jsonl")
    }

    /// Returns the path of the validation episodes, one line each.
    pub fn episodes(&self) -> PathBuf {
        self.0.join("eval.jsonl")
    }

    /// Returns the path of the newest checkpoint.
    pub fn last(&self) -> PathBuf {
        self.0.join("checkpoints/last.safetensors")
    }

    /// Returns the path of the checkpoint with the best validation.
    pub fn best(&self) -> PathBuf {
        self.0.join("checkpoints/best.safetensors")
    }

    /// Creates the folder and locks it for this process until the result is dropped or the process
    /// ends. A folder in which nothing was written is then removed.
    ///
    /// # Errors
    /// [`Error::Locked`] if another process trains in the folder, [`Error::Folder`] if it cannot be
    /// created.
    pub fn lock(&self) -> Result<Claim, Error> {
        std::fs::create_dir_all(&self.0)
            .map_err(|source| Error::Folder { path: self.0.clone(), source })?;
        let failed = |source| Error::Folder { path: self.0.clone(), source };
        let file =
            File::options().create(true).append(true).open(self.lock_file()).map_err(failed)?;
        match file.try_lock() {
            Ok(()) => Ok(Claim { dir: self.clone(), _lock: file }),
            Err(TryLockError::WouldBlock) => Err(Error::Locked { path: self.0.clone() }),
            Err(TryLockError::Error(source)) => Err(failed(source)),
        }
    }

    /// Returns whether a process trains in the folder.
    pub fn is_locked(&self) -> bool {
        File::open(self.lock_file())
            .is_ok_and(|file| matches!(file.try_lock_shared(), Err(TryLockError::WouldBlock)))
    }

    fn lock_file(&self) -> PathBuf {
        self.0.join(".lock")
    }

    /// Returns the run folder that `path` names: a folder itself, or the run folder of a checkpoint
    /// in its folder `checkpoints`; `None` otherwise.
    pub fn of(path: &Path) -> Option<Self> {
        if path.is_dir() {
            return Some(Self::new(path));
        }
        let folder = path
            .parent()
            .filter(|folder| folder.file_name().is_some_and(|name| name == "checkpoints"))?;
        let run = folder.parent()?;
        Some(Self::new(if run.as_os_str().is_empty() { Path::new(".") } else { run }))
    }

    /// Returns the checkpoint that `path` names: a file itself, or the best checkpoint of a run
    /// folder, or its last one if there is no best one.
    pub fn checkpoint(path: &Path) -> PathBuf {
        let dir = Self::new(path);
        match () {
            () if !path.is_dir() => path.to_owned(),
            () if dir.best().exists() => dir.best(),
            () => dir.last(),
        }
    }
}

/// The exclusive right to train in a folder.
#[derive(Debug)]
pub struct Claim {
    dir: RunDir,
    _lock: File,
}

impl Drop for Claim {
    fn drop(&mut self) {
        let alone = |entry: std::io::Result<std::fs::DirEntry>| {
            entry.is_ok_and(|e| e.path() == self.dir.lock_file())
        };
        if std::fs::read_dir(self.dir.path()).is_ok_and(|mut entries| entries.all(alone)) {
            // Failing to remove the empty folder does no harm.
            let _ = std::fs::remove_file(self.dir.lock_file());
            let _ = std::fs::remove_dir(self.dir.path());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_claim_leaves_no_empty_folder() {
        let folder = tempfile::tempdir().unwrap();
        let dir = RunDir::new(folder.path().join("a/run"));
        let claim = dir.lock().expect("nobody is there");
        assert!(matches!(dir.lock(), Err(Error::Locked { .. })) && dir.is_locked());
        drop(claim);
        assert!(!dir.path().exists());

        let claim = dir.lock().expect("nobody is there any more");
        std::fs::write(dir.config(), "").unwrap();
        drop(claim);
        assert!(dir.config().exists() && !dir.is_locked(), "what was written stays");
    }
}
