//! A run's `meta.json`: the program, command and machine of the training, and its progress.

use std::path::Path;
use std::time::SystemTime;

use serde::Serialize;
use serde_json::{Map, Value};

use super::RunDir;
use crate::checkpoint::Progress;
use crate::config::Config;
use crate::fnv::Fnv;
use crate::provenance::{self, Host, Program, Training};
use crate::record;

#[derive(Serialize)]
struct Meta<'a> {
    #[serde(flatten)]
    training: Training,
    command: Vec<String>,
    scenario: &'a str,
    /// Hash of the policy whose weights the run began with.
    #[serde(skip_serializing_if = "Option::is_none")]
    init_from: Option<String>,
    started_unix_s: u64,
    updated_unix_s: u64,
    host: Host,
    worlds: &'a str,
    shards: Value,
    device: String,
    steps: u64,
    seconds: f64,
}

impl RunDir {
    /// Writes `meta.json` before training starts or continues from `progress`, so that the run can
    /// be understood from its folder later. `fingerprint` is that of the scenario; `worlds`
    /// describes how the worlds are hosted.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn begin_meta(
        &self,
        config: &Config,
        progress: &Progress,
        fingerprint: &str,
        worlds: &str,
    ) -> Result<(), record::Error> {
        let program = Program::current();
        let now = now();
        // A run without a finished step takes nothing over from a file that is in the folder.
        let before = self.read_meta().filter(|_| progress.step > 0);
        let earlier = before.as_ref().and_then(training_of).map_or_else(Vec::new, |known| {
            let mut earlier = known.earlier;
            if known.program != program && !earlier.contains(&known.program) {
                earlier.push(known.program);
            }
            earlier.retain(|other| *other != program);
            earlier
        });
        let meta = Meta {
            training: Training { program, earlier },
            command: command(),
            scenario: fingerprint,
            init_from: match &before {
                Some(meta) => meta["init_from"].as_str().map(str::to_owned),
                None => Self::hash(&config.init_from),
            },
            started_unix_s: before.and_then(|meta| meta["started_unix_s"].as_u64()).unwrap_or(now),
            updated_unix_s: now,
            host: Host::current(),
            worlds,
            shards: config.learner.ppo.shards.into(),
            device: String::from(config.device),
            steps: progress.step,
            seconds: progress.seconds,
        };
        self.write_meta(&serde_json::to_value(meta).expect("plain data"))
    }

    /// Updates `meta.json` to `progress`; does nothing if there is no readable file.
    pub(super) fn update_meta(&self, progress: &Progress) -> Result<(), record::Error> {
        let Some(Value::Object(mut meta)) = self.read_meta() else { return Ok(()) };
        let news: Map<String, Value> = [
            ("steps".to_owned(), progress.step.into()),
            ("seconds".to_owned(), progress.seconds.into()),
            ("updated_unix_s".to_owned(), now().into()),
            ("peak_memory_gib".to_owned(), provenance::peak_memory_gib().into()),
        ]
        .into_iter()
        .collect();
        meta.extend(news);
        self.write_meta(&Value::Object(meta))
    }

    /// Returns the hash of the policy whose weights the run began with; `None` if it began with new
    /// ones, and for older runs.
    pub fn began_with(&self) -> Option<String> {
        Some(self.read_meta()?["init_from"].as_str()?.to_owned())
    }

    /// Returns the hash of the policy that `path` names, a run folder or a checkpoint; `None` if
    /// there is none.
    pub fn hash(path: &Path) -> Option<String> {
        let mut hash = Fnv::new();
        hash.bytes(&std::fs::read(Self::checkpoint(path)).ok()?);
        Some(hash.to_string())
    }

    /// Returns the programs that trained the run; `None` if `meta.json` is missing or damaged.
    pub fn training(&self) -> Option<Training> {
        training_of(&self.read_meta()?)
    }

    /// Returns the content of `meta.json`; `None`, with a warning unless the file is missing, if it
    /// cannot be read.
    pub(super) fn read_meta(&self) -> Option<Value> {
        let path = self.meta();
        let read = std::fs::read(&path).map_err(|error| {
            (error.kind() != std::io::ErrorKind::NotFound).then(|| error.to_string())
        });
        let value = read.and_then(|bytes| {
            serde_json::from_slice(&bytes).map_err(|error| Some(error.to_string()))
        });
        if let Err(Some(error)) = &value {
            tracing::warn!(
                "`{}` is damaged, so what the run was trained with is not known: {error}",
                path.display()
            );
        }
        value.ok()
    }

    fn write_meta(&self, meta: &Value) -> Result<(), record::Error> {
        record::write_atomic(&self.meta(), format!("{meta:#}\n").as_bytes())
    }
}

fn training_of(meta: &Value) -> Option<Training> {
    serde_json::from_value(meta.clone()).ok()
}

fn now() -> u64 {
    SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).map_or(0, |passed| passed.as_secs())
}

/// Returns the command line of this process. The program's path is reduced to its name, which is
/// the same on every machine.
fn command() -> Vec<String> {
    let mut words: Vec<String> =
        std::env::args_os().map(|word| word.to_string_lossy().into_owned()).collect();
    if let Some(program) = words.first_mut()
        && let Some(name) = Path::new(program.as_str()).file_name()
    {
        *program = name.to_string_lossy().into_owned();
    }
    words
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Document, Layers};

    #[test]
    fn a_resumed_run_names_every_program_that_trained_it() {
        let folder = tempfile::tempdir().unwrap();
        let dir = RunDir::new(folder.path());
        let text = "scenario = \"scenarios/intersection.xml\"".to_owned();
        let document = Document { name: "test".to_owned(), text, generated: false };
        let (config, _) = Config::resolve(&Layers { document, ..Layers::default() }).unwrap();
        let at = |step| Progress { step, ..Progress::default() };
        assert_eq!(dir.training(), None);
        dir.update_meta(&at(5)).expect("a run without the file");
        assert!(!dir.meta().exists());

        dir.begin_meta(&config, &at(0), "f", "one").unwrap();
        dir.update_meta(&at(64)).unwrap();
        let training = dir.training().expect("written");
        assert!(training.earlier.is_empty(), "{training:?}");
        assert_eq!(training.program, Program::current());
        let meta = dir.read_meta().expect("JSON");
        assert_eq!((&meta["steps"], &meta["scenario"]), (&64.into(), &"f".into()));
        assert!(meta["host"]["cores"].as_u64() > Some(0), "{meta}");
        assert!(meta["peak_memory_gib"].as_f64() > Some(0.0), "{meta}");

        // First the same program resumes the run; then the file names another version.
        dir.begin_meta(&config, &at(64), "f", "one").unwrap();
        assert!(dir.training().expect("written").earlier.is_empty());
        let older = meta.to_string().replace(&training.program.version, "0.0.7");
        std::fs::write(dir.meta(), older.replace(&meta["started_unix_s"].to_string(), "12345"))
            .unwrap();
        dir.begin_meta(&config, &at(64), "f", "one").unwrap();
        let earlier = dir.training().expect("written").earlier;
        assert_eq!(earlier.iter().map(|p| p.version.as_str()).collect::<Vec<_>>(), ["0.0.7"]);
        assert_eq!(dir.read_meta().expect("JSON")["started_unix_s"], 12345);
        // A new run in the folder takes nothing over.
        dir.begin_meta(&config, &at(0), "f", "one").unwrap();
        assert!(dir.training().expect("written").earlier.is_empty());
        assert_eq!(dir.began_with(), None);

        // The policy that a run began with stays that of its first step.
        let policy = folder.path().join("policy.safetensors");
        std::fs::write(&policy, "weights").unwrap();
        let config = Config { init_from: policy.clone(), ..config };
        dir.begin_meta(&config, &at(0), "f", "one").unwrap();
        let began = dir.began_with().expect("written");
        assert_eq!(Some(&began), RunDir::hash(&policy).as_ref());
        std::fs::write(&policy, "others").unwrap();
        assert_ne!(Some(&began), RunDir::hash(&policy).as_ref());
        dir.begin_meta(&config, &at(64), "f", "one").unwrap();
        assert_eq!(dir.began_with(), Some(began));
    }
}
