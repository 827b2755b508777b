//! One cell of a sweep: a run with its evaluations. The progress of both follows from the files in
//! the cell's folder.

use std::collections::BTreeMap;
use std::fs::{File, TryLockError};
use std::io::{Read as _, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use toml::{Table, Value};

use super::{Error, Evaluate, label, value_of};
use crate::config::{self, Config};
use crate::metrics::EvaluationResult;
use crate::record::{self, write_atomic};
use crate::train::RunDir;

/// One run of the grid.
#[derive(Debug, Clone)]
pub struct Cell {
    /// Name of the cell: its folder, relative to the sweep's folder.
    pub id: String,
    /// The run folder.
    pub folder: PathBuf,
    /// The cell's keys and values of the grid.
    pub values: Vec<(String, Value)>,
    /// All settings of the run, resolved.
    pub config: Config,
    /// Fingerprint of the scenario's files
    /// ([`Scenario::fingerprint`](crate::scenario::Scenario::fingerprint)).
    pub fingerprint: String,
    /// The same of the scenario of each evaluation, by its `--set`s.
    pub evaluated: BTreeMap<Vec<String>, String>,
    /// Id of the cell that must be trained first, because this cell starts with its policy.
    pub after: Option<String>,
}

/// The progress of a cell.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum State {
    /// The folder contains no training.
    New,
    /// Training was interrupted after this number of steps.
    Partial(u64),
    /// Training is finished; this number of evaluations is missing.
    Trained(usize),
    /// Training and all evaluations are finished.
    Finished,
    /// A command failed; with the reason and the last lines of the log.
    Failed(String),
}

/// A command that a cell runs next.
#[derive(Debug, Clone, PartialEq)]
pub struct Job {
    /// Arguments of `iwol`.
    pub arguments: Vec<String>,
    /// Description for the user.
    pub what: String,
}

/// Content of the file that marks a run as trained to its end.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Trained {
    /// Environment steps of the training.
    pub steps: u64,
    /// Duration of rollouts and updates \[s\].
    pub seconds: f64,
}

impl Cell {
    /// Returns the run folder.
    pub fn run(&self) -> RunDir {
        RunDir::new(&self.folder)
    }

    /// Returns the cell's value of a key of the grid.
    pub fn value(&self, key: &str) -> Option<&Value> {
        value_of(&self.values, key)
    }

    /// Returns the path of the log with everything that the cell's processes printed to stderr.
    pub fn log(&self) -> PathBuf {
        self.folder.join("sweep.log")
    }

    fn trained_mark(&self) -> PathBuf {
        self.folder.join("trained.json")
    }

    fn failed_mark(&self) -> PathBuf {
        self.folder.join("failed.txt")
    }

    /// Returns the path of the result of an evaluation.
    pub fn result(&self, evaluate: &Evaluate, combination: &[(String, Value)]) -> PathBuf {
        self.folder.join("evaluations").join(evaluate.result(combination))
    }

    /// Returns steps and seconds of the training; `None` if it is not finished, or has gone on since.
    pub fn trained(&self) -> Option<Trained> {
        let trained: Trained =
            serde_json::from_slice(&std::fs::read(self.trained_mark()).ok()?).ok()?;
        (self.steps() <= trained.steps).then_some(trained)
    }

    /// Creates the folder and claims the cell for this sweep's process, until the result is dropped
    /// or the process ends. `None` if another sweep's process has claimed it.
    ///
    /// # Errors
    /// If the folder or the file of the claim cannot be created.
    pub fn claim(&self) -> Result<Option<File>, Error> {
        let path = self.folder.join(".sweep.lock");
        std::fs::create_dir_all(&self.folder).map_err(record::Error::io("create", &self.folder))?;
        let file = File::options().create(true).append(true).open(&path);
        let file = file.map_err(record::Error::io("create", &path))?;
        match file.try_lock() {
            Ok(()) => Ok(Some(file)),
            Err(TryLockError::WouldBlock) => Ok(None),
            Err(TryLockError::Error(source)) => {
                Err(record::Error::io("lock", &path)(source).into())
            }
        }
    }

    /// Returns the progress of the cell.
    pub fn state(&self, evaluations: &[Evaluate]) -> State {
        if let Ok(text) = std::fs::read_to_string(self.failed_mark()) {
            return State::Failed(text);
        }
        if self.trained().is_some() {
            let missing = self.missing(evaluations).count();
            return if missing == 0 { State::Finished } else { State::Trained(missing) };
        }
        match self.steps() {
            0 => State::New,
            steps => State::Partial(steps),
        }
    }

    /// Returns the recorded environment steps of the training.
    pub fn steps(&self) -> u64 {
        last_line(&self.run().metrics()).and_then(|line| line["step"].as_u64()).unwrap_or(0)
    }

    /// Returns the recorded duration of the training \[s\].
    pub fn seconds(&self) -> f64 {
        last_line(&self.run().metrics())
            .and_then(|line| line["time/total_s"].as_f64())
            .unwrap_or(0.0)
    }

    fn missing<'a>(
        &'a self,
        evaluations: &'a [Evaluate],
    ) -> impl Iterator<Item = (&'a Evaluate, Vec<(String, Value)>)> {
        let all = evaluations
            .iter()
            .filter(|e| e.applies(self))
            .flat_map(|e| e.combinations().into_iter().map(move |c| (e, c)));
        all.filter(|(evaluate, combination)| {
            !matches!(self.evaluation(evaluate, combination), Ok(Some(_)))
        })
    }

    /// Returns the result of exactly this evaluation: of the same method, with the same episodes,
    /// checkpoint, settings and scenario, of a run that is trained to its end. `None` if there is
    /// none.
    ///
    /// # Errors
    /// [`Error::Damaged`] if the file is not a result, [`Error::Record`] if it cannot be read.
    pub fn evaluation(
        &self,
        evaluate: &Evaluate,
        combination: &[(String, Value)],
    ) -> Result<Option<EvaluationResult>, Error> {
        // The results of a run that goes on are those of old weights.
        if self.trained().is_none() {
            return Ok(None);
        }
        let path = self.result(evaluate, combination);
        let bytes = match std::fs::read(&path) {
            Ok(bytes) => bytes,
            Err(source) if source.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(source) => return Err(record::Error::io("read", &path)(source).into()),
        };
        let found: EvaluationResult = serde_json::from_slice(&bytes)
            .and_then(|found: EvaluationResult| match found.metrics.counted {
                Some(counted) if counted > found.episodes => Err(serde::de::Error::custom(
                    format!("{counted} of {} episodes count", found.episodes),
                )),
                _ => Ok(found),
            })
            .map_err(|source| Error::Damaged { path, source })?;
        let known = found.fingerprint.as_ref().zip(self.evaluated.get(&found.set));
        let same = (found.episodes, found.seed) == (evaluate.episodes, 0)
            && found.policy == self.config.algorithm
            && found.checkpoint.as_deref() == Some(evaluate.checkpoint.file())
            && found.set == evaluate.sets(combination)
            && known.is_none_or(|(was, is)| was == is);
        Ok(same.then_some(found))
    }

    /// Checks that the run in the folder, if there is one, has this cell's settings and scenario.
    /// Settings that do not change results may differ.
    ///
    /// # Errors
    /// [`Error::Changed`] for other settings, [`Error::Scenario`] for a changed scenario,
    /// [`Error::Follows`] if the policy that the run began with has been trained anew.
    pub fn check(&self) -> Result<(), Error> {
        let begun = self.run().last().exists() || self.trained().is_some();
        if !begun {
            return Ok(());
        }
        let file = self.run().config();
        let read = std::fs::read_to_string(&file).map_err(record::Error::io("read", &file))?;
        let was: Table = toml::from_str(&read).map_err(|source| Error::Settings {
            path: file,
            message: source.message().to_owned(),
        })?;
        let own = |mut table: Table| {
            table.remove("simulation");
            table.remove("device");
            config::remove_untold(&mut table, &self.config.algorithm);
            let mut flat = config::flatten(&table);
            // The number of shards decides which samples the decoders learn from; it must not
            // change in a run that continues.
            if self.trained().is_some() {
                flat.remove("ppo.shards");
            }
            flat
        };
        let is = toml::from_str(&self.config.to_toml()).expect("settings are TOML");
        let (mut was, is) = (own(was), own(is));
        // The folder that contains the other cell does not matter.
        if let (Some(after), Some(Value::String(path))) = (&self.after, was.get("init_from"))
            && Path::new(path).ends_with(after)
        {
            was.insert("init_from".to_owned(), is["init_from"].clone());
        }
        if self.run().fingerprint().is_some_and(|was| was != self.fingerprint) {
            return Err(Error::Scenario {
                folder: self.folder.clone(),
                path: self.config.scenario.file.clone(),
            });
        }
        if let Some(config::Change { key, was, is }) =
            config::flat_changes(&was, &is).into_iter().next()
        {
            return Err(Error::Changed { folder: self.folder.clone(), key, was, is });
        }
        let policies = self.run().began_with().zip(RunDir::hash(&self.config.init_from));
        match (&self.after, policies) {
            (Some(after), Some((was, is))) if was != is => {
                Err(Error::Follows { folder: self.folder.clone(), after: after.clone() })
            }
            _ => Ok(()),
        }
    }

    /// Returns the next command to run; `None` if everything is done. The mark of a failure stays
    /// until [`Cell::retry`].
    ///
    /// # Errors
    /// If the folder cannot be written or contains another run.
    pub fn next(&self, evaluations: &[Evaluate]) -> Result<Option<Job>, Error> {
        self.check()?;
        let folder = self.folder.display().to_string();
        let evaluated = self.folder.join("evaluations");
        std::fs::create_dir_all(&evaluated).map_err(record::Error::io("create", &evaluated))?;
        if self.trained().is_none() {
            // A run that is resumed reads this file too: settings that do not change results may
            // have changed.
            write_atomic(&self.run().config(), self.config.to_toml().as_bytes())?;
            let resumed = self.run().last().exists();
            let mut arguments = vec!["train".to_owned(), "--out".to_owned(), folder.clone()];
            if resumed {
                arguments.push("--resume".to_owned());
            } else {
                arguments
                    .extend(["--config".to_owned(), self.run().config().display().to_string()]);
            }
            return Ok(Some(Job { arguments, what: "train".to_owned() }));
        }
        let Some((evaluate, combination)) = self.missing(evaluations).next() else {
            return Ok(None);
        };
        let out = self.result(evaluate, &combination);
        if matches!(self.evaluation(evaluate, &combination), Err(Error::Damaged { .. })) {
            // It would not be replaced, because it is no result.
            std::fs::remove_file(&out).map_err(record::Error::io("remove", &out))?;
        }
        Ok(Some({
            let checkpoint = self.folder.join("checkpoints").join(evaluate.checkpoint.file());
            let mut arguments = vec!["evaluate".to_owned(), checkpoint.display().to_string()];
            arguments.extend(["--episodes".to_owned(), evaluate.episodes.to_string()]);
            for set in evaluate.sets(&combination) {
                arguments.extend(["--set".to_owned(), set]);
            }
            let out = out.display().to_string();
            arguments.extend(["--out".to_owned(), out]);
            let what = format!("evaluate {} {}", evaluate.name, label(&combination));
            Job { arguments, what: what.trim_end().to_owned() }
        }))
    }

    /// Copies the data of reports, if training is finished, to the same place below another folder
    /// of run folders: settings, versions, validations and evaluations, without weights. They
    /// replace an earlier copy. Returns whether there is an earlier copy and nothing to replace it,
    /// as where another machine trains the cell.
    ///
    /// # Errors
    /// If a file cannot be read, written or removed, or the copy would replace a run with weights.
    pub fn keep(&self, out: &Path, sweep: &str) -> Result<bool, Error> {
        let kept = Self { folder: out.join(sweep).join(&self.id), ..self.clone() };
        let itself = std::fs::canonicalize(&kept.folder).ok();
        let itself =
            itself.is_some_and(|kept| Some(kept) == std::fs::canonicalize(&self.folder).ok());
        if itself || kept.run().last().exists() || kept.run().best().exists() {
            return Err(Error::Kept { folder: kept.folder });
        }
        let Some(trained) = self.trained() else { return Ok(kept.folder.exists()) };
        remove_folder(&kept.folder)?;
        let evaluations = self.folder.join("evaluations");
        let copies = kept.folder.join("evaluations");
        std::fs::create_dir_all(&copies).map_err(record::Error::io("create", &copies))?;
        let mut files = vec![(self.run().config(), kept.run().config())];
        if self.run().meta().exists() {
            files.push((self.run().meta(), kept.run().meta()));
        }
        for entry in
            std::fs::read_dir(&evaluations).map_err(record::Error::io("read", &evaluations))?
        {
            let name = entry.map_err(record::Error::io("read", &evaluations))?.file_name();
            if Path::new(&name).extension().is_some_and(|end| end == "json") {
                files.push((evaluations.join(&name), copies.join(&name)));
            }
        }
        for (from, to) in files {
            write_atomic(&to, &std::fs::read(&from).map_err(record::Error::io("read", &from))?)?;
        }
        let lines: Vec<serde_json::Value> = record::read_json_lines(&self.run().metrics())?;
        let validations = lines.iter().filter(|line| line["validation/episode_length"].is_number());
        let validations: Vec<String> = validations.map(|line| format!("{line}\n")).collect();
        write_atomic(&kept.run().metrics(), validations.concat().as_bytes())?;
        let text = serde_json::to_string(&trained).expect("two numbers");
        write_atomic(&kept.trained_mark(), text.as_bytes())?;
        Ok(false)
    }

    /// Marks the run as trained, and removes the mark of a failure and the results of evaluations of
    /// earlier weights.
    ///
    /// # Errors
    /// If a file cannot be written or removed.
    pub fn mark_trained(&self) -> Result<(), Error> {
        remove_folder(&self.folder.join("evaluations"))?;
        let trained = Trained { steps: self.steps(), seconds: self.seconds() };
        let text = serde_json::to_string(&trained).expect("two numbers");
        write_atomic(&self.trained_mark(), text.as_bytes())?;
        self.retry()
    }

    /// Marks the cell as failed, with the reason and the last lines of the log from byte `start`
    /// on, and returns that text.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn mark_failed(&self, why: &str, start: u64) -> Result<String, Error> {
        let log = std::fs::read(self.log()).unwrap_or_default();
        let log = String::from_utf8_lossy(log.get(start as usize..).unwrap_or_default());
        let lines: Vec<&str> = log.lines().filter(|line| !line.trim().is_empty()).collect();
        // The excerpt begins at the last error message; without one it consists of the last six
        // lines.
        let complaint = lines
            .iter()
            .rposition(|line| line.starts_with("error:") || line.contains("panicked at"));
        let from = complaint.unwrap_or(lines.len().saturating_sub(6));
        let last = lines[from..(from + 6).min(lines.len())].join("\n");
        let text = format!("{why}\n{last}");
        write_atomic(&self.failed_mark(), text.as_bytes())?;
        Ok(text)
    }

    /// Removes the mark of a failure.
    ///
    /// # Errors
    /// If the file cannot be removed.
    pub fn retry(&self) -> Result<(), Error> {
        let path = self.failed_mark();
        match std::fs::remove_file(&path) {
            Err(source) if source.kind() != std::io::ErrorKind::NotFound => {
                Err(record::Error::io("remove", &path)(source).into())
            }
            _ => Ok(()),
        }
    }
}

/// Removes a folder with what it contains, if there is one.
fn remove_folder(path: &Path) -> Result<(), Error> {
    match std::fs::remove_dir_all(path) {
        Err(source) if source.kind() != std::io::ErrorKind::NotFound => {
            Err(record::Error::io("remove", path)(source).into())
        }
        _ => Ok(()),
    }
}

/// Checks cells that start with the policy of another cell: the other cell must exist and have the
/// same networks, and the order of training must contain no cycle.
pub(super) fn check_order(cells: &[Cell]) -> Result<(), String> {
    for cell in cells {
        let begins_with =
            |cell: &&Cell| cells.iter().find(|other| cell.after.as_ref() == Some(&other.id));
        if let Some(after) = cell.after.as_ref().filter(|_| begins_with(&cell).is_none()) {
            return Err(format!(
                "cell {}: init_from: a [[skip]] removes the cell {after}",
                cell.id
            ));
        }
        if let Some(first) = begins_with(&cell) {
            let (of, trained) = (&first.config.algorithm, &cell.config.algorithm);
            if of != trained {
                return Err(format!(
                    "cell {}: init_from: {} trains {of}, which has other networks",
                    cell.id, first.id
                ));
            }
            if let Some(why) = first.config.cannot_serve(&cell.config) {
                return Err(format!("cell {}: init_from: {why}", cell.id));
            }
        }
        // If so many predecessors exist as there are cells, one of them occurs twice.
        if let Some(last) = std::iter::successors(Some(cell), begins_with).nth(cells.len()) {
            return Err(format!(
                "cell {}: init_from forms a cycle: no cell of the cycle can be trained first",
                last.id
            ));
        }
    }
    Ok(())
}

/// Returns the last whole line of a file of JSON lines; reads only the end of the file.
fn last_line(path: &Path) -> Option<serde_json::Value> {
    let mut file = File::open(path).ok()?;
    let length = file.metadata().ok()?.len();
    file.seek(SeekFrom::Start(length.saturating_sub(8192))).ok()?;
    let mut tail = Vec::new();
    file.read_to_end(&mut tail).ok()?;
    String::from_utf8_lossy(&tail).lines().rev().find_map(|line| serde_json::from_str(line).ok())
}
