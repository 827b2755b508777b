//! The files that a run writes: metrics, episodes of validations, and TensorBoard events.

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde::Serialize;
use serde_json::Value;

use super::{Error, RunDir, Trainer};
use crate::algo::Losses;
use crate::checkpoint::Progress;
use crate::config::Config;
use crate::env::{DrivingRecord, Environment, EpisodeRecord};
use crate::evaluate::Evaluation;
use crate::metrics::{self, Metric, Shown};
use crate::record::{self, JsonLines, JsonObject, TensorBoard};

/// Keys of a validation's metrics of the world decoder: error and explained variance over all
/// features, explained variance of the linear probe, number of undetermined features, and explained
/// variance of these features by the decoder and by the probe ([`crate::metrics::Probe`]).
const WORLD: [&str; 6] = [
    "validation/world_error",
    "validation/world_explained",
    "validation/world_probe_explained",
    "validation/world_undetermined",
    "validation/world_undetermined_explained",
    "validation/world_undetermined_probe_explained",
];
/// The same keys for the interaction decoder.
const INTERACTION: [&str; 6] = [
    "validation/interaction_error",
    "validation/interaction_explained",
    "validation/interaction_probe_explained",
    "validation/interaction_undetermined",
    "validation/interaction_undetermined_explained",
    "validation/interaction_undetermined_probe_explained",
];

/// The open files of a run.
pub(super) struct Files {
    metrics: JsonLines,
    episodes: JsonLines,
    board: TensorBoard,
}

#[derive(Serialize)]
struct EpisodeLine<'a> {
    step: u64,
    #[serde(flatten)]
    record: &'a EpisodeRecord,
}

impl Files {
    /// Opens or creates the files. In a resumed run, lines beyond `step` and validations beyond
    /// `validated`, the step of the checkpoint's last validation, are removed, because that part is
    /// repeated.
    pub(super) fn open(
        dir: &RunDir,
        config: &Config,
        environment: &dyn Environment,
        step: u64,
        validated: u64,
    ) -> Result<Self, Error> {
        std::fs::create_dir_all(dir.path().join("checkpoints"))
            .map_err(|source| Error::Folder { path: dir.path().to_owned(), source })?;
        record::write_atomic(&dir.config(), config.to_toml().as_bytes())?;
        let text = environment.description(dir.path());
        if let Some((name, text)) = text.map_err(record::Error::io("write", dir.path()))? {
            record::write_atomic(&dir.path().join(name), text.as_bytes())?;
        }
        let resumed = step > 0;
        let open = |path: PathBuf,
                    future: &dyn Fn(&JsonObject) -> bool|
         -> Result<JsonLines, record::Error> {
            if !resumed {
                return JsonLines::create(&path);
            }
            let mut lines = JsonLines::resume(&path)?;
            lines.remove_where(future)?;
            Ok(lines)
        };
        let beyond = |line: &JsonObject, step: u64| {
            line.get("step").and_then(Value::as_u64).is_some_and(|own| own > step)
        };
        let validation = |line: &JsonObject| line.contains_key("validation/episode_length");
        Ok(Self {
            metrics: open(dir.metrics(), &|line| {
                beyond(line, if validation(line) { validated } else { step })
            })?,
            episodes: open(dir.episodes(), &|line| beyond(line, validated))?,
            board: TensorBoard::create(dir.path(), resumed.then_some(step))?,
        })
    }

    /// Flushes all lines to disk, before a checkpoint that relies on them.
    pub(super) fn sync(&self) -> Result<(), Error> {
        self.metrics.sync()?;
        Ok(self.episodes.sync()?)
    }

    fn write(&mut self, step: u64, values: &[(&str, f64)]) -> Result<(), Error> {
        let mut line = serde_json::Map::new();
        line.insert("step".to_owned(), step.into());
        for (key, value) in values {
            line.insert((*key).to_owned(), (*value).into());
        }
        self.metrics.append(&line)?;
        self.board.write(step, values.iter().copied())?;
        Ok(())
    }

    /// Writes an iteration's metrics and returns the success rate of the episodes that ended in it,
    /// without repeated and interrupted ones; `None` if there are none.
    pub(super) fn iteration(
        &mut self,
        trainer: &Trainer,
        losses: &Losses,
        steps_per_second: f64,
    ) -> Result<Option<f64>, Error> {
        let episodes: Vec<_> =
            trainer.collector.finished.iter().filter(|r| !r.interrupted && !r.repeated).collect();
        let mean = |of: fn(&EpisodeRecord) -> f64| {
            episodes.iter().map(|r| of(r)).sum::<f64>() / episodes.len() as f64
        };
        let driving = |of: fn(&DrivingRecord) -> Option<f64>| {
            let all: Vec<f64> =
                episodes.iter().filter_map(|r| r.driving.as_ref()).filter_map(of).collect();
            (!all.is_empty()).then(|| all.iter().sum::<f64>() / all.len() as f64)
        };
        let success = EpisodeRecord::mean_success(episodes.iter().copied());
        let mut values: Vec<(&str, f64)> = losses.clone();
        values.extend(success.map(|success| ("episode/success", success)));
        if !episodes.is_empty() {
            values.extend([
                ("episode/reward", mean(|r| r.reward)),
                ("episode/length", mean(|r| f64::from(r.episode_length))),
            ]);
            let known = [
                ("episode/safety", driving(|r| (!r.undecided).then_some(r.safety))),
                ("episode/sumo_collisions", driving(|r| Some(f64::from(r.sumo_collisions)))),
                ("episode/own_collisions", driving(|r| Some(f64::from(r.own_collisions)))),
            ];
            values.extend(known.into_iter().filter_map(|(name, value)| Some((name, value?))));
        }
        let timers = &trainer.collector.timers;
        values.extend([
            ("iteration", trainer.progress.iteration as f64),
            ("steps_per_second", steps_per_second),
            ("time/total_s", trainer.progress.seconds),
            ("time/simulate_s", timers.simulate),
            ("time/act_s", timers.act),
            ("time/copy_s", timers.copy),
            ("time/update_s", timers.update),
        ]);
        values.extend(trainer.collector.worlds.counters());
        let own = own_means("episode", episodes.iter().map(|record| &record.own));
        values.extend(own.iter().map(|(name, mean)| (name.as_str(), *mean)));
        self.write(trainer.progress.step, &values)?;
        Ok(success)
    }

    /// Writes the metrics and the episodes of a validation.
    pub(super) fn validation(
        &mut self,
        progress: &Progress,
        evaluation: &Evaluation,
    ) -> Result<(), Error> {
        for record in &evaluation.episodes {
            self.episodes.append(&EpisodeLine { step: progress.step, record })?;
        }
        let length = evaluation.episodes.iter().map(|r| f64::from(r.episode_length)).sum::<f64>()
            / evaluation.episodes.len().max(1) as f64;
        let mut values: Vec<(&str, f64)> = Vec::new();
        if let Some(metrics) = evaluation.metrics() {
            let mean = |metric: &Metric| Some((metric.validation, metric.unscaled(&metrics)?.mean));
            values.extend(metrics::shown(Shown::Everywhere).filter_map(mean));
        }
        values.extend([("validation/episode_length", length), ("time/total_s", progress.seconds)]);
        for r in &evaluation.reconstruction {
            let keys = if r.name == "world" { &WORLD } else { &INTERACTION };
            let probe = r.probe.as_ref();
            let numbers = [
                Some(r.error),
                Some(r.explained),
                probe.map(|p| p.explained),
                probe.map(|p| p.undetermined as f64),
                probe.and_then(|p| p.undetermined_explained),
                probe.and_then(|p| p.undetermined_probe_explained),
            ];
            values
                .extend(keys.iter().zip(numbers).filter_map(|(key, number)| Some((*key, number?))));
        }
        let own = own_means("validation", evaluation.episodes.iter().map(|record| &record.own));
        values.extend(own.iter().map(|(name, mean)| (name.as_str(), *mean)));
        self.write(progress.step, &values)
    }
}

/// Returns the means of the metrics that an environment defines by itself, by their names in a
/// group.
fn own_means<'a>(
    group: &str,
    episodes: impl Iterator<Item = &'a BTreeMap<String, f64>>,
) -> Vec<(String, f64)> {
    let mut all: BTreeMap<&String, (f64, f64)> = BTreeMap::new();
    for (name, value) in episodes.flatten() {
        let (sum, count) = all.entry(name).or_default();
        (*sum, *count) = (*sum + value, *count + 1.0);
    }
    all.into_iter().map(|(name, (sum, count))| (format!("{group}/{name}"), sum / count)).collect()
}
