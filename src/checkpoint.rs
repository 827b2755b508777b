//! Checkpoints: one safetensors file with weights, optimiser moments, value normalisation, the
//! configuration and the state of every world. Loading a checkpoint executes nothing. Training
//! continues from it bit for bit.

#![cfg(feature = "learn")]

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use serde::{Deserialize, Serialize};
use tch::{Kind, Tensor};

use crate::env::{Features, Position, WorldState, names_differ};
use crate::record;

/// Version of the file's layout.
const FORMAT: &str = "iwol-sumo checkpoint 2";

/// Progress of training.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Default)]
pub struct Progress {
    /// Finished iterations (one rollout and one update each).
    pub iteration: u64,
    /// Environment steps (of one world each) so far.
    pub step: u64,
    /// Seconds of training so far.
    pub seconds: f64,
    /// Best validation so far: success rate, and throughput as window reward.
    pub best: Option<(f64, f64)>,
    /// Success rates of the last validations, at most as many as decide whether to stop.
    #[serde(default)]
    pub recent: Vec<f64>,
    /// Step at which the next validation is due.
    pub next_validation: u64,
    /// Step of the last validation.
    pub validated: u64,
    /// Environment steps of annealing so far.
    pub annealed: u64,
    /// How many of them took place only because the run was about to end.
    #[serde(default)]
    pub forced: u64,
    /// Whether the last validation allows annealing to proceed.
    pub annealing: bool,
}

/// Contents of a checkpoint.
#[derive(Debug)]
pub struct Checkpoint {
    /// Progress of training.
    pub progress: Progress,
    /// The resolved configuration, as TOML.
    pub config: String,
    /// Name of the algorithm.
    pub algorithm: String,
    /// Names of the numbers of an observation, in their order; empty in checkpoints of versions that
    /// did not store them.
    pub features: Vec<String>,
    /// State of the learner: tensors by name.
    pub learner: Vec<(String, Tensor)>,
    /// Current episode and action history of each world.
    pub worlds: Vec<WorldState>,
    /// Memory of the policy, `[E, N, M]` flattened.
    pub memory: Vec<f32>,
    /// The policy that plays the next rollout, where it is not the learner's
    /// ([`overlap`](crate::config::Train::overlap)).
    pub player: Option<Player>,
}

/// A policy that plays a rollout while the learner goes on.
#[derive(Debug)]
pub struct Player {
    /// State of the learner whose policy plays: tensors by name.
    pub learner: Vec<(String, Tensor)>,
    /// Logarithm of the scheduled standard deviation of actions.
    pub log_std: f64,
}

impl Checkpoint {
    /// Reduces the checkpoint to the averaged policy, as it was evaluated, and its value function,
    /// without the state that only resuming needs.
    #[must_use]
    pub fn weights(mut self) -> Self {
        if self.learner.iter().any(|(name, _)| name.starts_with("actor_average/")) {
            self.learner.retain(|(name, _)| !name.starts_with("actor/"));
        }
        for (name, _) in &mut self.learner {
            if let Some(rest) = name.strip_prefix("actor_average/") {
                *name = format!("actor/{rest}");
            }
        }
        let dropped = |name: &str| {
            name.split('/').next().is_some_and(|set| {
                ["_adam", "_memory", "_target"].iter().any(|end| set.ends_with(end))
            })
        };
        self.learner.retain(|(name, _)| !dropped(name));
        self.worlds.clear();
        self.memory.clear();
        self.player = None;
        self
    }

    /// Returns how the observations that the policy learned from differ from those of an environment
    /// with these features in the names of their numbers; `None` if they do not.
    pub fn misplaced(&self, features: &Features) -> Option<String> {
        let stored = Some(&self.features).filter(|names| !names.is_empty())?;
        names_differ("observation", stored, &features.names())
    }

    /// Writes a temporary file and renames it, so that an interruption or a full disk leaves the
    /// old file.
    ///
    /// # Errors
    /// [`Error::Write`] or [`Error::Record`].
    pub fn save(&self, path: &Path) -> Result<(), Error> {
        let mut entries: Vec<(String, Dtype, Vec<usize>, Vec<u8>)> = Vec::new();
        let mut add = |group: &str, state: &[(String, Tensor)]| {
            for (name, tensor) in state {
                let shape = tensor.size().iter().map(|&d| d as usize).collect();
                let (dtype, bytes) = tensor_bytes(tensor);
                entries.push((format!("{group}/{name}"), dtype, shape, bytes));
            }
        };
        add("learner", &self.learner);
        if let Some(player) = &self.player {
            add("player", &player.learner);
        }
        for (i, world) in self.worlds.iter().enumerate() {
            entries.push((
                format!("world/{i}"),
                Dtype::F32,
                vec![world.actions.len()],
                f32_bytes(&world.actions),
            ));
            if !world.observation.is_empty() {
                entries.push((
                    format!("observation/{i}"),
                    Dtype::F32,
                    vec![world.observation.len()],
                    f32_bytes(&world.observation),
                ));
            }
        }
        entries.push((
            "memory".to_owned(),
            Dtype::F32,
            vec![self.memory.len()],
            f32_bytes(&self.memory),
        ));
        let episodes: Vec<(u64, bool)> =
            self.worlds.iter().map(|world| (world.episode, world.interrupted)).collect();
        let positions: Vec<&Position> = self.worlds.iter().map(|world| &world.position).collect();
        let mut metadata = HashMap::from([
            ("format".to_owned(), FORMAT.to_owned()),
            ("algorithm".to_owned(), self.algorithm.clone()),
            ("config".to_owned(), self.config.clone()),
            ("features".to_owned(), serde_json::to_string(&self.features).expect("plain data")),
            ("progress".to_owned(), serde_json::to_string(&self.progress).expect("plain data")),
            ("episodes".to_owned(), serde_json::to_string(&episodes).expect("plain data")),
            ("positions".to_owned(), serde_json::to_string(&positions).expect("plain data")),
        ]);
        if let Some(player) = &self.player {
            metadata.insert("player".to_owned(), player.log_std.to_string());
        }
        let bad = |message: String| Error::Write { path: path.to_owned(), message };
        let views = entries
            .iter()
            .map(|(name, dtype, shape, bytes)| {
                TensorView::new(*dtype, shape.clone(), bytes)
                    .map(|view| (name, view))
                    .map_err(|e| bad(e.to_string()))
            })
            .collect::<Result<Vec<_>, _>>()?;
        let bytes =
            safetensors::serialize(views, Some(metadata)).map_err(|e| bad(e.to_string()))?;
        record::write_atomic(path, &bytes)?;
        Ok(())
    }

    /// Reads a checkpoint.
    ///
    /// # Errors
    /// [`Error`] if the file is not a complete checkpoint of this program.
    pub fn load(path: &Path) -> Result<Self, Error> {
        let bytes =
            std::fs::read(path).map_err(|source| Error::Read { path: path.to_owned(), source })?;
        let damaged = |message: String| Error::Damaged { path: path.to_owned(), message };
        let (_, header) = SafeTensors::read_metadata(&bytes).map_err(|e| damaged(e.to_string()))?;
        let tensors = SafeTensors::deserialize(&bytes).map_err(|e| damaged(e.to_string()))?;
        let metadata = header.metadata().as_ref();
        let text = |key: &str| {
            metadata
                .and_then(|m| m.get(key))
                .cloned()
                .ok_or_else(|| damaged(format!("it has no `{key}` entry")))
        };
        let format = text("format")?;
        if format != FORMAT {
            return Err(damaged(format!(
                "its format is `{format}`, this program reads `{FORMAT}`"
            )));
        }
        let progress: Progress = serde_json::from_str(&text("progress")?)
            .map_err(|e| damaged(format!("progress: {e}")))?;
        let episodes: Vec<(u64, bool)> = serde_json::from_str(&text("episodes")?)
            .map_err(|e| damaged(format!("episodes: {e}")))?;
        let features: Vec<String> = match text("features") {
            Ok(text) => {
                serde_json::from_str(&text).map_err(|e| damaged(format!("features: {e}")))?
            }
            Err(_) => Vec::new(),
        };
        let counters =
            [progress.iteration, progress.step, progress.next_validation, progress.validated];
        if progress.annealed > progress.step {
            return Err(damaged("it has annealed for more steps than it took".to_owned()));
        }
        if counters.iter().chain(episodes.iter().map(|(episode, _)| episode)).any(|&n| n > 1 << 60)
        {
            return Err(damaged("a counter in it is out of range".to_owned()));
        }
        // Checkpoints of older versions, which repeated no failed episodes, contain no positions.
        let stride = episodes.len() as u64;
        let after = |&(episode, interrupted): &(u64, bool)| {
            if interrupted { Position::before(episode) } else { Position::before(episode + stride) }
        };
        let positions: Vec<Position> = match text("positions") {
            Ok(text) => {
                serde_json::from_str(&text).map_err(|e| damaged(format!("positions: {e}")))?
            }
            Err(_) => episodes.iter().map(after).collect(),
        };
        let counters = |p: &Position| {
            [p.next, p.fresh, p.episode_index].into_iter().chain(p.failed.iter().copied()).max()
        };
        if positions.len() != episodes.len()
            || positions.iter().filter_map(counters).any(|n| n > 1 << 60)
        {
            return Err(damaged("its positions in the episodes do not fit".to_owned()));
        }
        let floats = |name: &str| -> Result<Vec<f32>, Error> {
            let view = tensors.tensor(name).map_err(|e| damaged(format!("{name}: {e}")))?;
            if view.dtype() != Dtype::F32 {
                return Err(damaged(format!("{name} is not of 32-bit floats")));
            }
            Ok(view
                .data()
                .chunks_exact(4)
                .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
                .collect())
        };
        let worlds = episodes
            .iter()
            .zip(positions)
            .enumerate()
            .map(|(i, (&(episode, interrupted), position))| {
                let observation = format!("observation/{i}");
                Ok(WorldState {
                    episode,
                    interrupted,
                    actions: floats(&format!("world/{i}"))?,
                    position,
                    observation: match tensors.tensor(&observation) {
                        Ok(_) => floats(&observation)?,
                        Err(_) => Vec::new(),
                    },
                })
            })
            .collect::<Result<_, Error>>()?;
        let mut groups = [("learner/", Vec::new()), ("player/", Vec::new())];
        for (name, view) in tensors.iter() {
            let part = |group: &mut (&str, Vec<_>)| name.starts_with(group.0);
            let Some(group) = groups.iter_mut().position(part) else {
                continue;
            };
            let (prefix, state) = &mut groups[group];
            let name = &name[prefix.len()..];
            let kind = match view.dtype() {
                Dtype::F32 => Kind::Float,
                Dtype::F64 => Kind::Double,
                Dtype::I64 => Kind::Int64,
                other => return Err(damaged(format!("{name} has the unexpected type {other:?}"))),
            };
            let shape: Vec<i64> = view.shape().iter().map(|&d| d as i64).collect();
            let tensor = Tensor::f_from_data_size(view.data(), &shape, kind)
                .map_err(|e| damaged(format!("{name}: {e}")))?;
            let finite = tensor.f_isfinite().and_then(|finite| bool::try_from(finite.all()));
            if kind != Kind::Int64 && !finite.map_err(|e| damaged(format!("{name}: {e}")))? {
                return Err(damaged(format!("{name} contains a value that is not finite")));
            }
            state.push((name.to_owned(), tensor));
        }
        let [(_, learner), (_, player)] = groups;
        let player = match metadata.and_then(|m| m.get("player")) {
            None => None,
            Some(log_std) => Some(Player {
                learner: player,
                log_std: log_std.parse().map_err(|e| damaged(format!("player: {e}")))?,
            }),
        };
        Ok(Self {
            progress,
            config: text("config")?,
            algorithm: text("algorithm")?,
            features,
            learner,
            worlds,
            memory: floats("memory")?,
            player,
        })
    }
}

fn f32_bytes(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

fn tensor_bytes(tensor: &Tensor) -> (Dtype, Vec<u8>) {
    let flat = tensor.detach().reshape([-1]);
    match tensor.kind() {
        Kind::Double => {
            let values = Vec::<f64>::try_from(flat).expect("a flat tensor of doubles");
            (Dtype::F64, values.iter().flat_map(|v| v.to_le_bytes()).collect())
        }
        Kind::Int64 => {
            let values = Vec::<i64>::try_from(flat).expect("a flat tensor of integers");
            (Dtype::I64, values.iter().flat_map(|v| v.to_le_bytes()).collect())
        }
        _ => {
            let values =
                Vec::<f32>::try_from(flat.to_kind(Kind::Float)).expect("a flat tensor of floats");
            (Dtype::F32, f32_bytes(&values))
        }
    }
}

/// An error in reading or writing a checkpoint.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The file cannot be read.
    #[error("cannot read the checkpoint `{}`", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// The file is not a complete checkpoint.
    #[error("`{}` is not a usable checkpoint: {message}", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        message: String,
    },
    /// The checkpoint cannot be serialised.
    #[error("cannot write the checkpoint `{}`: {message}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The cause.
        message: String,
    },
    /// The file cannot be written.
    #[error(transparent)]
    Record(#[from] record::Error),
}
