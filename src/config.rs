//! Settings of a run: defaults < `--config file.toml` < `--set key=value` < flags, checked key by key.
//!
//! The scenario's own numbers appear as the table `[env]`, so that the resolved configuration is complete, is stored with
//! the run, and is itself a valid `--config`. Every mistake names the file, line and column, and the nearest valid key.

mod defaults;
mod flat;
mod older;
mod rules;

pub(crate) use flat::between;
pub use flat::{Change, changes, flatten, plain};
pub use older::complete_older;

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

use serde::{Deserialize, Serialize};
use toml::de::{DeTable, DeValue};
use toml::{Table, Value};

use crate::algo::{self, settings};
use crate::scenario::{self, Lidar, NeighbourOrder, ObservationGroups, Scenario};
use crate::suggest::nearest;
use crate::sumo::{Choice, Hosting};

/// What is trained when nothing names a method.
const DEFAULT_ALGORITHM: &str = "im-iwol";

/// Everything that defines a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// The scenario's file.
    pub scenario: PathBuf,
    /// Name of the algorithm.
    pub algorithm: String,
    /// Number of vehicles at spawn places; all are agents unless [`Env::penetration`] says otherwise.
    pub agents: u32,
    /// Seed of everything random.
    pub seed: u64,
    /// Environment steps (of one world each) to train for, at most.
    pub steps: u64,
    /// Where the networks are computed: `cpu`, `cuda` or `cuda:<number>`.
    pub device: algo::ComputeDevice,
    /// A run folder or checkpoint, of any number of agents, whose weights training starts from; empty: from new ones.
    pub init_from: PathBuf,
    /// The training loop.
    pub train: Train,
    /// Where the worlds run; what is learned does not depend on it, nor any metric but SUMO's own collision counts.
    pub simulation: Simulation,
    /// Networks.
    pub network: settings::Network,
    /// Proximal policy optimisation.
    pub ppo: settings::Ppo,
    /// Exploration noise.
    pub exploration: settings::Exploration,
    /// IWoL.
    pub iwol: settings::Iwol,
    /// The transformer of MAT and CommFormer.
    pub transformer: settings::Transformer,
    /// MAGIC.
    pub magic: settings::Magic,
    /// CommFormer.
    pub commformer: settings::CommFormer,
    /// ICP.
    pub icp: settings::Icp,
    /// MADDPG.
    pub maddpg: settings::Maddpg,
    /// The radio between agents, in evaluation.
    pub channel: algo::Channel,
    /// The scenario's numbers.
    pub env: Env,
}

/// The training loop. Lengths and counts are for 8 agents; those of another number follow from them where they are not given
/// ([`Config::resolve`]).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Train {
    /// Worlds E simulated in lock-step.
    pub envs: usize,
    /// Steps T per rollout.
    pub segment: usize,
    /// Once noise has fallen to what is kept until validations succeed ([`Exploration::explore_steps`](settings::Exploration)),
    /// rollouts have so many times the steps, and minibatches so many times the samples: a policy that has found most of its way
    /// is lost again to the noise of small ones. 1: as before.
    pub growth: usize,
    /// Each episode of training and validation has a random number of agents, from this one to `agents`, on the same net, so
    /// that the policy drives among any number; 0: always all.
    pub fewest_agents: u32,
    /// Chance that a world plays an episode of training again that failed before, where it remembers one (the last 16 that failed
    /// when last played), instead of the next: what seldom goes wrong is seldom seen otherwise.
    pub replay_failed: f64,
    /// At first the policy imitates pure pursuit of the route ([`Train::imitate_speed`]) on its own episodes, and over so many
    /// environment steps does so ever less and learns from rewards ever more (kickstarting: Schmitt et al., 2018); 0: not at all.
    pub imitate_steps: u64,
    /// Speed of the pursuit that is imitated \[m/s\].
    pub imitate_speed: f64,
    /// Weight of the danger of a crash as a potential (Ng et al., 1999): a step that brings an agent closer to one costs it in
    /// training what a step away from it gives back, so that the best policy stays the best. Danger is 1 at a crash and falls to 0
    /// where vehicles that go straight on do not touch within [`World::DANGER`](crate::env::World::DANGER). 0: none.
    pub shaping: f64,
    /// Environment steps between validations; each is followed by a checkpoint.
    pub validate_every: u64,
    /// Episodes per validation, with deterministic actions on seeds of their own.
    pub validation_episodes: u64,
    /// Stop when annealing is over and this share of agents succeeded on average of the last [`Train::stop_validations`]
    /// validations; 0 never stops early.
    pub stop_success: f64,
    /// See [`Train::stop_success`].
    pub stop_validations: u32,
    /// Annealing (of noise, then of the learning rate) goes on while this share of agents succeeds in validations, waits while
    /// it does not, and goes on in any case when the run would otherwise end before it is over; 0: only then. Training episodes
    /// would tell too early: agents that only succeed thanks to their noise do not yet know how. A run that is not good
    /// enough to stop when annealing is over learns on with as little noise, and explores again if it falls below this.
    pub anneal_success: f64,
    /// Environment steps that annealing takes, at most half of the run.
    pub anneal_steps: u64,
    /// When no validation has let annealing begin so many environment steps after training began, and the last is below
    /// [`Train::restart_success`], it begins again with other new weights, if there is time for as many and for annealing; 0: never.
    pub restart_steps: u64,
    /// A validation with this share of successful agents is worth going on from.
    pub restart_success: f64,
}

impl Default for Train {
    fn default() -> Self {
        Self {
            envs: 16,
            segment: 128,
            growth: 1,
            fewest_agents: 0,
            replay_failed: 0.0,
            imitate_steps: 0,
            imitate_speed: 6.0,
            shaping: 0.0,
            validate_every: 16_384,
            validation_episodes: 64,
            stop_success: 0.99,
            stop_validations: 4,
            anneal_success: 0.95,
            anneal_steps: 180_000,
            restart_steps: 0,
            restart_success: 0.8,
        }
    }
}

/// Where the worlds run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Simulation {
    /// `traci`: SUMO processes; `libsumo`: SUMO inside this process; `auto`: the faster.
    pub backend: Choice,
    /// SUMO processes over which the worlds are spread; 0: as many as there are cores.
    pub processes: usize,
    /// A SUMO that takes longer for an answer counts as dead \[s\].
    pub timeout: f64,
    /// Whether SUMO looks for collisions in junctions, too, to be compared with ours; most of its time at many vehicles.
    pub audit: bool,
}

impl Default for Simulation {
    fn default() -> Self {
        let Hosting { processes, timeout, audit, .. } = Hosting::default();
        Self { backend: Choice::default(), processes, timeout: timeout.as_secs_f64(), audit }
    }
}

/// The scenario's numbers that a run may change. Defaults are the scenario's own; that of `cooperation` follows from it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Env {
    /// How others are seen: `nearest`, `conflict` or `both`.
    pub observation: ObservationGroups,
    /// Others further away are not seen \[m\].
    pub detection_range: f64,
    /// Nearest vehicles in the observation.
    pub neighbours: usize,
    /// In which order: `distance`, nearest first, or `bearing`, from those straight ahead to those behind, in the same direction nearest first
    /// and with positions on a second, finer scale.
    pub neighbour_order: NeighbourOrder,
    /// Streams in the observation.
    pub conflict_streams: usize,
    /// Vehicles per stream in the observation.
    pub stream_vehicles: usize,
    /// Vehicles on crossing or merging routes in the observation.
    pub encounters: usize,
    /// How far ahead they tell how closely the two will pass if both keep to their ways and speeds \[s\]; 0: they do not.
    pub foresight: f64,
    /// Beams of the lidar.
    pub lidar_beams: usize,
    /// How far they reach \[m\].
    pub lidar_range: f64,
    /// Range d_comm of the physical mask \[m\].
    pub communication_range: f64,
    /// Share λ of the cooperative mix; the scenario's is for its own number of agents, and follows from it for another
    /// ([`Config::resolve`]).
    pub cooperation: f64,
    /// Reward per metre.
    pub reward_progress: f64,
    /// Reward per step at 80 km/h.
    pub reward_speed: f64,
    /// Reward of an arrival.
    pub reward_arrive: f64,
    /// Reward of leaving the road.
    pub reward_out_of_road: f64,
    /// Reward of a crash.
    pub reward_crash: f64,
    /// Steps until truncation.
    pub horizon: u32,
    /// A crashed vehicle stays this long \[s\].
    pub wreck_time: f64,
    /// Share of the vehicles at spawn places that learn; SUMO drives the others.
    pub penetration: f64,
}

impl Env {
    fn of(scenario: &Scenario, agents: u32) -> Self {
        let (seen, reward) = (&scenario.observation, &scenario.reward);
        // Of the mix, an agent's own reward has the share 1 − λ + λ/N, each other's λ/N: among more agents, a larger λ keeps
        // their ratio.
        let (lambda, own, n) = (reward.cooperation, f64::from(scenario.agents.default), f64::from(agents.max(1)));
        let kept = lambda * n / (lambda * n + (1.0 - lambda) * own);
        Self {
            observation: seen.groups,
            detection_range: seen.detection_range,
            neighbours: seen.neighbours,
            neighbour_order: seen.neighbour_order,
            conflict_streams: seen.conflict_streams,
            stream_vehicles: seen.stream_vehicles,
            encounters: seen.encounters,
            foresight: seen.foresight,
            lidar_beams: seen.lidar.beams,
            lidar_range: seen.lidar.range,
            communication_range: scenario.communication.range,
            cooperation: (kept * 1e6).round() / 1e6,
            reward_progress: reward.progress,
            reward_speed: reward.speed,
            reward_arrive: reward.arrive,
            reward_out_of_road: reward.out_of_road,
            reward_crash: reward.crash,
            horizon: scenario.termination.horizon,
            wreck_time: scenario.termination.wreck_time,
            penetration: scenario.traffic.penetration,
        }
    }

    fn apply(&self, scenario: &mut Scenario) {
        let (seen, reward) = (&mut scenario.observation, &mut scenario.reward);
        seen.groups = self.observation;
        seen.detection_range = self.detection_range;
        seen.neighbours = self.neighbours;
        seen.neighbour_order = self.neighbour_order;
        seen.conflict_streams = self.conflict_streams;
        seen.stream_vehicles = self.stream_vehicles;
        seen.encounters = self.encounters;
        seen.foresight = self.foresight;
        seen.lidar = Lidar { beams: self.lidar_beams, range: self.lidar_range };
        scenario.communication.range = self.communication_range;
        reward.cooperation = self.cooperation;
        reward.progress = self.reward_progress;
        reward.speed = self.reward_speed;
        reward.arrive = self.reward_arrive;
        reward.out_of_road = self.reward_out_of_road;
        reward.crash = self.reward_crash;
        scenario.termination.horizon = self.horizon;
        scenario.termination.wreck_time = self.wreck_time;
        scenario.traffic.penetration = self.penetration;
    }
}

/// A TOML text and what to call it in messages.
#[derive(Debug, Clone, Default)]
pub struct Document {
    /// File name, or another description of where it is from.
    pub name: String,
    /// The text.
    pub text: String,
}

impl Document {
    /// Reads a file.
    ///
    /// # Errors
    /// [`Error::Read`].
    pub fn read(path: &Path) -> Result<Self, Error> {
        let text = std::fs::read_to_string(path).map_err(|source| Error::Read { path: path.to_owned(), source })?;
        Ok(Self { name: path.display().to_string(), text })
    }

    /// Reads the configuration that a run was made with, which may be older than some settings.
    ///
    /// # Errors
    /// [`Error::Read`].
    pub fn read_run(path: &Path) -> Result<Self, Error> {
        let Self { name, text } = Self::read(path)?;
        Ok(Self::of_run(name, text))
    }

    /// The configuration that a run was made with, from its text.
    pub fn of_run(name: String, text: String) -> Self {
        // One that cannot be parsed is refused where it is resolved; one that is not older stays as it is, so that mistakes in it are
        // told with their lines.
        let mut table = toml::from_str::<Table>(&text).unwrap_or_default();
        let text = if complete_older(&mut table) { table.to_string() } else { text };
        Self { name, text }
    }
}

/// Where settings come from, in rising priority.
#[derive(Debug, Clone, Default)]
pub struct Layers {
    /// `--config`, or the configuration that a checkpoint holds.
    pub document: Document,
    /// `--set key=value`, in order.
    pub sets: Vec<String>,
    /// Flags, as `(key, TOML value)`.
    pub flags: Vec<(&'static str, Value)>,
}

/// Takes out of a configuration what `algorithm` is not told of: the settings of other methods.
pub fn remove_untold(table: &mut Table, algorithm: &str) {
    let told = algo::capabilities(algorithm).map_or(&[][..], |method| method.settings);
    for group in algo::Settings::OWN.iter().filter(|group| !told.contains(group)) {
        table.remove(*group);
    }
}

impl Config {
    /// Resolves the layers; gives the configuration and the scenario with the `[env]` table applied.
    ///
    /// Where they are not given, these follow the number of agents N (between 4 and 48): `train.anneal_steps` in proportion to
    /// 8/N, as are `train.validate_every` and `train.validation_episodes` down to a quarter, `steps` and
    /// `exploration.explore_steps` up only; `train.envs` is 256/N, at least 8, but 16 from 8 to 16. Below 8, failed episodes are
    /// played again (`train.replay_failed`), annealing goes on from 97 % of success, training stops at 99.7 %, and `ppo.gamma` is
    /// 0.997. Above 8, noise is the same in all worlds (`exploration.spread`), and a run that finds no way begins again
    /// (`train.restart_steps`).
    /// Vehicles that steer imitate pursuit at first (`train.imitate_steps`; not with `init_from`, nor by methods that replay), their
    /// noise lasts (`exploration.correlation`), is the same in all worlds and there from the start, and falls twice as slowly, after
    /// which batches grow (`train.growth`) and the view gets longer (`ppo.gamma_explored`; neither of methods that replay), in runs four
    /// times as long; `train.envs` is 128/N below 8, `ppo.gamma` that of 8, `train.replay_failed` that of fewer, and
    /// `train.anneal_success` 0.9. Minibatches of methods that replay are half as large (`ppo.minibatch`).
    /// `env.cooperation`, which the scenario gives for its own number of agents, is such that the reward of each other agent keeps its
    /// weight beside one's own. Training that begins with a trained policy begins with the noise at which others wait for success.
    ///
    /// # Errors
    /// [`Error`], naming the place.
    pub fn resolve(layers: &Layers) -> Result<(Self, Scenario), Error> {
        let Document { name, text } = &layers.document;
        let parsed = DeTable::parse(text).map_err(|e| {
            let place = Place::At { file: name.clone(), text, offset: e.span().map_or(0, |span| span.start) };
            Error::Syntax { place: place.to_string(), message: e.message().to_owned() }
        })?;

        // The scenario decides the defaults of `[env]` and of the number of agents; that number and the method decide those of
        // learning. So they are looked up first.
        let first = |key: &str| {
            let bare = |text: &str| parse_value(text).unwrap_or_else(|| Value::String(text.to_owned()));
            let flag = layers.flags.iter().find(|(own, _)| *own == key).map(|(_, v)| v.clone());
            let sets = layers.sets.iter().rev().filter_map(|set| set.split_once('='));
            let set = || sets.clone().find(|(own, _)| own.trim() == key).map(|(_, text)| bare(text.trim()));
            let file = || parsed.get_ref().iter().find(|(own, _)| own.get_ref() == key);
            flag.or_else(set).or_else(|| file().and_then(|(_, v)| parse_value(text.get(v.span())?)))
        };
        let word = |key: &str| first(key).and_then(|v| v.as_str().map(str::to_owned));
        let mut scenario = Scenario::load(Path::new(&word("scenario").ok_or(Error::NoScenario)?))?;

        let agents = first("agents").and_then(|v| u32::try_from(v.as_integer()?).ok());
        let agents = agents.unwrap_or(scenario.agents.default);
        let trained = word("init_from").is_some_and(|from| !from.is_empty());
        let algorithm = word("algorithm");
        let mut table = Self::defaults(&scenario, algorithm.as_deref().unwrap_or(DEFAULT_ALGORITHM), agents, trained);
        let mut places = HashMap::new();
        merge(&mut table, &mut places, parsed.get_ref(), &[], name, text)?;
        for set in &layers.sets {
            let place = Place::Set(set).to_string();
            let (key, value) = set.split_once('=').ok_or_else(|| Error::Value {
                place: place.clone(),
                key: set.clone(),
                message: "write it as key=value".to_owned(),
            })?;
            // Bare words are strings: `network.encoder=mlp` needs no quotes.
            let value = parse_value(value.trim()).unwrap_or_else(|| Value::String(value.trim().to_owned()));
            let keys: Vec<&str> = key.trim().split('.').collect();
            assign(&mut table, &mut places, &keys, value, place)?;
        }
        for (key, value) in &layers.flags {
            let place = Place::Flag(key).to_string();
            assign(&mut table, &mut places, &key.split('.').collect::<Vec<_>>(), value.clone(), place)?;
        }
        let config: Self = Value::Table(table).try_into().map_err(|e: toml::de::Error| Error::Value {
            place: name.clone(),
            key: String::new(),
            message: e.message().to_owned(),
        })?;
        if let Some((keys, allowed)) = config.out_of_range() {
            // The first key is the one that breaks the rule; another of the rule may be the one that was set.
            let place = keys.iter().find_map(|key| places.get(*key)).unwrap_or(name);
            return Err(Error::Value {
                place: place.clone(),
                key: keys[0].to_owned(),
                message: format!("allowed: {allowed}"),
            });
        }
        config.env.apply(&mut scenario);
        scenario.net_for(config.agents)?;
        Ok((config, scenario))
    }

    /// The learner's settings.
    pub fn settings(&self) -> algo::Settings {
        algo::Settings {
            network: self.network.clone(),
            ppo: self.ppo.clone(),
            exploration: self.exploration.clone(),
            iwol: self.iwol.clone(),
            transformer: self.transformer.clone(),
            magic: self.magic.clone(),
            commformer: self.commformer.clone(),
            icp: self.icp.clone(),
            maddpg: self.maddpg.clone(),
        }
    }

    /// Where the worlds run.
    pub fn hosting(&self) -> Hosting {
        let Simulation { backend, processes, timeout, audit } = self.simulation;
        Hosting { backend: backend.backend(), processes, timeout: Duration::from_secs_f64(timeout), audit }
    }

    /// As TOML.
    pub fn to_toml(&self) -> String {
        toml::to_string_pretty(self).expect("a configuration is plain data")
    }
}

/// Where a setting stands.
enum Place<'a> {
    At { file: String, text: &'a str, offset: usize },
    Set(&'a str),
    Flag(&'a str),
}

impl std::fmt::Display for Place<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::At { file, text, offset } => {
                let before = text.get(..*offset).unwrap_or(text);
                let line = before.matches('\n').count() + 1;
                let column = before.chars().rev().take_while(|&c| c != '\n').count() + 1;
                write!(f, "{file}:{line}:{column}")
            }
            Self::Set(set) => write!(f, "--set {set}"),
            Self::Flag(key) => write!(f, "--{}", key.rsplit('.').next().unwrap_or(key)),
        }
    }
}

/// Where each key was set last.
type SetAt = HashMap<String, String>;

fn merge(
    table: &mut Table,
    places: &mut SetAt,
    layer: &DeTable<'_>,
    prefix: &[&str],
    file: &str,
    text: &str,
) -> Result<(), Error> {
    for (key, value) in layer {
        let mut keys = prefix.to_vec();
        keys.push(key.get_ref());
        let place = |offset| Place::At { file: file.to_owned(), text, offset }.to_string();
        if let DeValue::Table(inner) = value.get_ref() {
            check_key(table, &keys, &place(key.span().start))?;
            merge(table, places, inner, &keys, file, text)?;
        } else {
            check_key(table, &keys, &place(key.span().start))?;
            let parsed = parse_value(&text[value.span()]).ok_or_else(|| Error::Syntax {
                place: place(value.span().start),
                message: "this value cannot be read".to_owned(),
            })?;
            assign(table, places, &keys, parsed, place(value.span().start))?;
        }
    }
    Ok(())
}

fn parse_value(text: &str) -> Option<Value> {
    let mut table: Table = toml::from_str(&format!("v = {text}")).ok()?;
    if table.len() == 1 { table.remove("v") } else { None }
}

/// The table of defaults knows every valid key.
fn check_key(table: &Table, keys: &[&str], place: &str) -> Result<(), Error> {
    let mut here = table;
    for (depth, key) in keys.iter().enumerate() {
        let next = here.get(*key);
        match next {
            Some(Value::Table(inner)) => here = inner,
            Some(_) if depth + 1 == keys.len() => {}
            _ => {
                let mut valid = Vec::new();
                list_keys(table, "", &mut valid);
                let name = keys.join(".");
                let similar = nearest(&name, valid.iter().map(String::as_str))
                    .or_else(|| nearest(key, here.keys().map(String::as_str)))
                    .map(str::to_owned);
                return Err(Error::UnknownKey { place: place.to_owned(), key: name, nearest: similar });
            }
        }
    }
    Ok(())
}

fn list_keys(table: &Table, prefix: &str, out: &mut Vec<String>) {
    for (key, value) in table {
        let name = if prefix.is_empty() { key.clone() } else { format!("{prefix}.{key}") };
        match value {
            Value::Table(inner) => list_keys(inner, &name, out),
            _ => out.push(name),
        }
    }
}

/// Sets a key and checks its type, so that a bad value is reported where it stands; ranges are checked at the end, since
/// some depend on other keys.
fn assign(table: &mut Table, places: &mut SetAt, keys: &[&str], value: Value, place: String) -> Result<(), Error> {
    check_key(table, keys, &place)?;
    let (last, folders) = keys.split_last().expect("a key has a name");
    let mut here = &mut *table;
    for key in folders {
        here = here.get_mut(*key).and_then(Value::as_table_mut).expect("checked above");
    }
    let value = match (&here[*last], value) {
        (Value::Float(_), Value::Integer(i)) => Value::Float(i as f64),
        (_, value) => value,
    };
    here.insert((*last).to_owned(), value);
    let bad = |message: String| Error::Value { place: place.clone(), key: keys.join("."), message };
    let config: Config =
        Value::Table(table.clone()).try_into().map_err(|e: toml::de::Error| bad(e.message().to_owned()))?;
    if !algo::NAMES.contains(&config.algorithm.as_str()) {
        let similar =
            nearest(&config.algorithm, algo::NAMES).map(|n| format!("; did you mean `{n}`?")).unwrap_or_default();
        return Err(bad(format!(
            "there is no algorithm `{}` (there are {}){similar}",
            config.algorithm,
            algo::NAMES.join(", ")
        )));
    }
    places.insert(keys.join("."), place);
    Ok(())
}

/// What can be wrong with a configuration.
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
    /// The file is not TOML.
    #[error("{place}: {message}")]
    Syntax {
        /// File, line and column.
        place: String,
        /// What is wrong.
        message: String,
    },
    /// No setting has this name.
    #[error("{place}: there is no setting `{key}`{}", nearest.as_ref().map(|n| format!("; did you mean `{n}`?")).unwrap_or_default())]
    UnknownKey {
        /// Where it stands.
        place: String,
        /// The name.
        key: String,
        /// The nearest valid one.
        nearest: Option<String>,
    },
    /// The value does not fit.
    #[error("{place}: bad value for `{key}`: {message}")]
    Value {
        /// Where it stands.
        place: String,
        /// The setting.
        key: String,
        /// What is wrong.
        message: String,
    },
    /// Nothing says which scenario to run.
    #[error("no scenario given; name one with --scenario, e.g. --scenario scenarios/intersection.xml")]
    NoScenario,
    /// The scenario is not valid.
    #[error(transparent)]
    Scenario(#[from] scenario::Error),
}

#[cfg(test)]
mod tests {
    use super::*;

    fn resolve(text: &str, sets: &[&str]) -> Result<Config, Error> {
        resolve_on("intersection", text, sets)
    }

    fn resolve_on(scenario: &str, text: &str, sets: &[&str]) -> Result<Config, Error> {
        let scenario = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("scenarios/{scenario}.xml"));
        let layers = Layers {
            document: Document { name: "c.toml".to_owned(), text: text.to_owned() },
            sets: sets.iter().map(|s| (*s).to_owned()).collect(),
            flags: vec![("scenario", Value::String(scenario.display().to_string()))],
        };
        Config::resolve(&layers).map(|(config, _)| config)
    }

    fn message(text: &str, sets: &[&str]) -> String {
        resolve(text, sets).expect_err("must be refused").to_string()
    }

    #[test]
    fn later_layers_win() {
        let config =
            resolve("seed = 3\n[ppo]\ngamma = 0.5\nepochs = 2\n", &["ppo.gamma=1", "network.encoder=mlp"]).unwrap();
        assert_eq!((config.seed, config.ppo.gamma, config.ppo.epochs), (3, 1.0, 2));
        assert_eq!(config.network.encoder, settings::EncoderKind::Mlp);
    }

    #[test]
    fn a_run_that_is_older_than_a_setting_goes_on_as_it_was() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("config.toml");
        let now = resolve_on("parking_lot", "", &[]).unwrap();
        let mut table: Table = toml::from_str(&now.to_toml()).unwrap();
        for (group, setting) in [("ppo", "gamma_explored"), ("train", "growth"), ("train", "imitate_steps")] {
            table[group].as_table_mut().unwrap().remove(setting).unwrap();
        }
        std::fs::write(&file, table.to_string()).unwrap();
        let of = |document: Document| Config::resolve(&Layers { document, ..Layers::default() }).unwrap().0;
        let resumed = of(Document::read_run(&file).unwrap());
        assert_eq!((resumed.ppo.gamma_explored, resumed.train.growth, resumed.train.imitate_steps), (0.0, 1, 0));
        // Otherwise it would change at a resume.
        assert!(now.ppo.gamma_explored > 0.0 && now.train.growth > 1 && now.train.imitate_steps > 0);
        assert_eq!(of(Document::read(&file).unwrap()), now);
        // What lacks nothing stays as somebody wrote it, lines and all.
        let text = format!("# mine\n\n{}", now.to_toml());
        std::fs::write(&file, &text).unwrap();
        assert_eq!(Document::read_run(&file).unwrap().text, text);
    }

    #[test]
    fn lengths_follow_the_number_of_agents() {
        let at = |agents: u32| {
            let config = resolve(&format!("agents = {agents}"), &[]).unwrap();
            for set in [format!("agents={agents}"), format!(" agents = {agents:#x} ")] {
                assert_eq!(config, resolve("agents = 7", &[&set]).unwrap());
            }
            config
        };
        let samples = |c: &Config| c.train.envs * c.agents as usize;
        let (four, eight, most) = (at(4), at(8), at(48));
        assert_eq!((eight.train.clone(), eight.steps), (Train::default(), 600_000));
        assert_eq!((samples(&four), four.steps), (2 * samples(&eight), 2 * eight.steps));
        assert!([&four, &most].iter().all(|c| c.ppo.minibatch == eight.ppo.minibatch));
        let replays = resolve("agents = 8", &["algorithm=maddpg"]).unwrap();
        assert_eq!(2 * replays.ppo.minibatch, eight.ppo.minibatch);
        assert_eq!(most.train.anneal_steps * 48, eight.train.anneal_steps * 8);
        assert_eq!(most.exploration.explore_steps, eight.exploration.explore_steps);
        assert_eq!(most.train.validation_episodes, 16);
        assert_eq!(at(16).train.envs, eight.train.envs);
        // The reward of each other agent weighs the same beside one's own.
        let weight = |c: &Config| {
            let (n, shared) = (f64::from(c.agents), c.env.cooperation);
            shared / n / (1.0 - shared + shared / n)
        };
        assert_eq!(eight.env.cooperation, 0.35);
        assert!([&four, &at(16), &most].iter().all(|c| (weight(c) - weight(&eight)).abs() < 1e-6));
        // What is written down is not changed.
        assert_eq!(resolve("agents = 48\nsteps = 5", &["train.envs=3"]).unwrap().train.envs, 3);
        let search = |c: &Config| (c.exploration.spread, c.train.restart_steps);
        let own = settings::Exploration::default().spread;
        assert_eq!([&four, &eight].map(search), [(own, 0); 2]);
        let searched = |c: &Config| (c.train.replay_failed, c.train.anneal_success, c.train.stop_success, c.ppo.gamma);
        let (few, more) = ((0.5, 0.97, 0.997, 0.997), (0.0, 0.95, 0.99, 0.99));
        assert_eq!([&four, &eight, &most].map(searched), [few, more, more]);
        assert_eq!(four.train.validation_episodes, 128);
        let shared = |name: &str| resolve(&format!("algorithm = '{name}'"), &[]).unwrap().env.cooperation;
        assert_eq!(["mappo", "icp-dec", "icp-sum", "icp-monotonic"].map(shared), [0.35, 0.35, 0.0, 0.0]);
        assert_eq!([&at(16), &most].map(search), [(0.0, 120_000); 2]);
    }

    #[test]
    fn vehicles_that_steer_begin_by_imitating() {
        let teaches = |sets: &[&str]| resolve_on("parking_lot", "", sets).unwrap().train.imitate_steps;
        assert_eq!(resolve("", &[]).unwrap().train.imitate_steps, 0);
        assert!(teaches(&[]) > 0);
        assert_eq!(teaches(&["init_from=runs/any"]), 0, "a trained policy can drive");
        assert_eq!(teaches(&["algorithm=maddpg"]), 0);
        let refused =
            resolve_on("parking_lot", "", &["algorithm=maddpg", "train.imitate_steps=5"]).expect_err("replays");
        assert!(refused.to_string().contains("train.imitate_steps"), "{refused}");
        let five = resolve_on("parking_lot", "", &[]).unwrap();
        assert_eq!((five.exploration.correlation, five.exploration.late_steps, five.train.envs), (0.8, 0, 25));
        assert_eq!(five.steps, 4 * resolve("agents = 5", &[]).unwrap().steps);
        let view = |c: &Config| (c.ppo.gamma, c.ppo.gamma_explored);
        assert_eq!((view(&five), view(&resolve("", &[]).unwrap())), ((0.99, 0.995), (0.99, 0.0)));
        assert_eq!((five.train.replay_failed, five.train.anneal_success), (0.5, 0.9));
    }

    #[test]
    fn a_trained_policy_begins_with_less_noise() {
        let start = |sets: &[&str]| resolve("", sets).unwrap().exploration.log_std_start;
        let noise = settings::Exploration::default();
        assert_eq!((start(&[]), start(&["init_from="])), (noise.log_std_start, noise.log_std_start));
        assert_eq!(start(&["init_from=runs/any"]), noise.log_std_explore);
        let restart = |sets: &[&str]| resolve("agents = 16", sets).unwrap().train.restart_steps;
        assert!(restart(&[]) > 0 && restart(&["init_from=runs/any"]) == 0, "it would throw the policy away");
        assert_eq!(start(&["init_from=runs/any", "exploration.log_std_start=-0.5"]), -0.5);
    }

    #[test]
    fn the_resolved_configuration_is_a_configuration() {
        // Some settings are valid only together: the order in which they are read must not matter.
        for sets in [
            ["env.cooperation=0.25", "train.envs=3"],
            ["iwol.message=96", "iwol.heads=3"],
            ["network.token_width=24", "network.token_heads=3"],
            ["train.segment=256", "network.chunk_length=200"],
        ] {
            let config = resolve("", &sets).unwrap();
            assert_eq!(resolve(&config.to_toml(), &[]).unwrap(), config);
        }
    }

    #[test]
    fn mistakes_name_place_key_and_neighbour() {
        assert_eq!(
            message("seed = 1\n\n[ppo]\n  gama = 0.9\n", &[]),
            "c.toml:4:3: there is no setting `ppo.gama`; did you mean `ppo.gamma`?"
        );
        assert_eq!(message("[ppo]\ngamma = 1.5\n", &[]), "c.toml:2:9: bad value for `ppo.gamma`: allowed: 0 to 1");
        assert!(
            message("[ppo]\ngamma = \"x\"\n", &[]).starts_with("c.toml:2:9: bad value for `ppo.gamma`: invalid type")
        );
        assert!(message("[ppo\n", &[]).starts_with("c.toml:1:"));
        assert!(
            message("", &["iwol.mask=soft"])
                .starts_with("--set iwol.mask=soft: bad value for `iwol.mask`: unknown variant")
        );
        assert_eq!(message("", &["gamma"]), "--set gamma: bad value for `gamma`: write it as key=value");
        assert!(message("", &["gamma=1"]).contains("did you mean `ppo.gamma`?"), "{}", message("", &["gamma=1"]));
        assert_eq!(
            message("[iwol]\nmessage = 6\n", &[]),
            "c.toml:2:11: bad value for `iwol.heads`: allowed: a divisor of iwol.message"
        );
        assert!(message("", &["device=gpu"]).contains("write cpu, cuda or cuda:<number>"));
        assert!(message("", &["env.observation=all"]).contains("unknown variant"));
        assert!(message("", &["env.reward_crash=nan"]).contains("a finite number"));
        assert!(message("", &["agents=49"]).contains("49"), "{}", message("", &["agents=49"]));
    }
}
