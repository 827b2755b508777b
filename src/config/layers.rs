//! The sources of settings, their priority, and errors in them.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use toml::de::{DeTable, DeValue};
use toml::{Table, Value};

use super::{Config, DEFAULT_ALGORITHM, flatten};
use crate::algo;
use crate::scenario::{self, Scenario};
use crate::suggest::nearest;

/// A TOML text and its name in messages.
#[derive(Debug, Clone, Default)]
pub struct Document {
    /// File name, or another description of the source.
    pub name: String,
    /// The text.
    pub text: String,
    /// Whether the program made the text, so that its lines mean nothing to the reader of a
    /// message.
    pub generated: bool,
}

impl Document {
    /// Reads a file.
    ///
    /// # Errors
    /// [`Error::Read`].
    pub fn read(path: &Path) -> Result<Self, Error> {
        let text = std::fs::read_to_string(path)
            .map_err(|source| Error::Read { path: path.to_owned(), source })?;
        Ok(Self { name: path.display().to_string(), text, generated: false })
    }

    /// Returns the configuration with which a run was made, from its text.
    pub fn of_run(name: String, text: String) -> Self {
        Self { name, text, generated: false }
    }

    /// Returns a document of settings that come from several sources, which `name` describes.
    pub fn of_table(name: String, settings: &Table) -> Self {
        Self { name, text: settings.to_string(), generated: true }
    }
}

/// The sources of settings, in rising priority.
#[derive(Debug, Clone, Default)]
pub struct Layers {
    /// The file of `--config`, or the configuration in a checkpoint.
    pub document: Document,
    /// `--set key=value`, in order.
    pub sets: Vec<String>,
    /// Flags, as `(key, TOML value)`.
    pub flags: Vec<(&'static str, Value)>,
}

impl Config {
    /// Resolves the layers and returns the configuration, and the scenario with the `[env]` table
    /// applied.
    ///
    /// Settings that no layer gives get defaults that depend on the number N of agents (between 4
    /// and 48), on whether vehicles steer, and on the method (`docs/reference/settings.md` lists
    /// the values):
    ///
    /// - Number of agents: `train.anneal_steps` × 8/N, but at least half; `train.validate_every`
    ///   and `train.validation_episodes` × 8/N, but at least a quarter; `steps` and
    ///   `exploration.explore_steps` × 8/N below 8 agents; `train.envs` 256/N, but at least 8, and
    ///   16 from 8 to 16 agents.
    /// - Vehicles that steer: correlated noise (`exploration.correlation`); twice the
    ///   `exploration.explore_steps`, and then larger batches (`train.batch_growth`) and a higher
    ///   discount (`ppo.gamma_explored`); four times the `steps`; more `train.anneal_steps`;
    ///   `train.anneal_success` 0.9; `train.envs` 128/N below 8 agents.
    /// - Off-policy methods: half the `ppo.minibatch`; no `train.batch_growth`.
    /// - Methods with a team's return: no `env.cooperation`.
    /// - `init_from`: exploration begins at `exploration.log_std_explore`.
    ///
    /// # Errors
    /// [`Error`], with the place of the setting.
    pub fn resolve(layers: &Layers) -> Result<(Self, Scenario), Error> {
        let document @ Document { name, text, .. } = &layers.document;
        let parsed = DeTable::parse(text).map_err(|e| {
            let place = Origin::At { document, offset: e.span().map_or(0, |span| span.start) };
            Error::Syntax { place: place.to_string(), message: e.message().to_owned() }
        })?;

        // The scenario gives the defaults of `[env]` and of the number of agents, and that number
        // and the method give those of learning. So these settings are looked up first.
        let first = |key: &str| {
            let bare =
                |text: &str| parse_value(text).unwrap_or_else(|| Value::String(text.to_owned()));
            let flag = layers.flags.iter().find(|(own, _)| *own == key).map(|(_, v)| v.clone());
            let sets = layers.sets.iter().rev().filter_map(|set| set.split_once('='));
            let set = || {
                sets.clone().find(|(own, _)| own.trim() == key).map(|(_, text)| bare(text.trim()))
            };
            let file = || parsed.get_ref().iter().find(|(own, _)| own.get_ref() == key);
            flag.or_else(set).or_else(|| file().and_then(|(_, v)| parse_value(text.get(v.span())?)))
        };
        let word = |key: &str| first(key).and_then(|v| v.as_str().map(str::to_owned));
        let mut scenario = Scenario::load(Path::new(&word("scenario").ok_or(Error::NoScenario)?))?;

        let agents = first("agents").and_then(|v| u32::try_from(v.as_integer()?).ok());
        let agents = agents.unwrap_or(scenario.agents.default);
        let trained = word("init_from").is_some_and(|from| !from.is_empty());
        let algorithm = word("algorithm");
        let mut table = Self::defaults(
            &scenario,
            algorithm.as_deref().unwrap_or(DEFAULT_ALGORITHM),
            agents,
            trained,
        );
        let mut places = HashMap::new();
        merge(&mut table, &mut places, parsed.get_ref(), &[], document)?;
        for set in &layers.sets {
            let place = Origin::Set(set).to_string();
            let (key, value) = set.split_once('=').ok_or_else(|| Error::Value {
                place: place.clone(),
                key: set.clone(),
                message: "write it as key=value".to_owned(),
            })?;
            // Bare words are strings: `network.encoder=mlp` needs no quotes.
            let value =
                parse_value(value.trim()).unwrap_or_else(|| Value::String(value.trim().to_owned()));
            let keys: Vec<&str> = key.trim().split('.').collect();
            assign(&mut table, &mut places, &keys, value, place)?;
        }
        for (key, value) in &layers.flags {
            let place = Origin::Flag(key).to_string();
            assign(
                &mut table,
                &mut places,
                &key.split('.').collect::<Vec<_>>(),
                value.clone(),
                place,
            )?;
        }
        let config: Self =
            Value::Table(table).try_into().map_err(|e: toml::de::Error| Error::Value {
                place: name.clone(),
                key: String::new(),
                message: e.message().to_owned(),
            })?;
        if let Some((keys, allowed)) = config.out_of_range() {
            // The first key breaks the rule, but the user may have set another key of the rule.
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
}

/// The place where a setting is given.
enum Origin<'a> {
    At { document: &'a Document, offset: usize },
    Set(&'a str),
    Flag(&'a str),
}

impl std::fmt::Display for Origin<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::At { document: Document { name, generated: true, .. }, .. } => f.write_str(name),
            Self::At { document: Document { name, text, .. }, offset } => {
                let before = text.get(..*offset).unwrap_or(text);
                let line = before.matches('\n').count() + 1;
                let column = before.chars().rev().take_while(|&c| c != '\n').count() + 1;
                write!(f, "{name}:{line}:{column}")
            }
            Self::Set(set) => write!(f, "--set {set}"),
            Self::Flag(key) => write!(f, "--{}", key.rsplit('.').next().unwrap_or(key)),
        }
    }
}

/// The place where each key was last set.
type SetAt = HashMap<String, String>;

fn merge(
    table: &mut Table,
    places: &mut SetAt,
    layer: &DeTable<'_>,
    prefix: &[&str],
    document: &Document,
) -> Result<(), Error> {
    for (key, value) in layer {
        let mut keys = prefix.to_vec();
        keys.push(key.get_ref());
        let place = |offset| Origin::At { document, offset }.to_string();
        if let DeValue::Table(inner) = value.get_ref() {
            check_key(table, &keys, &place(key.span().start))?;
            merge(table, places, inner, &keys, document)?;
        } else {
            check_key(table, &keys, &place(key.span().start))?;
            let parsed =
                parse_value(&document.text[value.span()]).ok_or_else(|| Error::Syntax {
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

/// Checks that a key is valid: the table of defaults contains every valid key.
fn check_key(table: &Table, keys: &[&str], place: &str) -> Result<(), Error> {
    let mut here = table;
    for (depth, key) in keys.iter().enumerate() {
        let next = here.get(*key);
        match next {
            Some(Value::Table(inner)) => here = inner,
            Some(_) if depth + 1 == keys.len() => {}
            _ => {
                let valid = flatten(table);
                let name = keys.join(".");
                let similar = nearest(&name, valid.keys().map(String::as_str))
                    .or_else(|| nearest(key, here.keys().map(String::as_str)))
                    .map(str::to_owned);
                return Err(Error::UnknownKey {
                    place: place.to_owned(),
                    key: name,
                    nearest: similar,
                });
            }
        }
    }
    Ok(())
}

/// Sets a key and checks its type, so that an error names the place of the value. Ranges are
/// checked at the end, because some depend on other keys.
fn assign(
    table: &mut Table,
    places: &mut SetAt,
    keys: &[&str],
    value: Value,
    place: String,
) -> Result<(), Error> {
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
    let config: Config = Value::Table(table.clone())
        .try_into()
        .map_err(|e: toml::de::Error| bad(with_nearest(e.message())))?;
    if !algo::NAMES.contains(&config.algorithm.as_str()) {
        let similar = nearest(&config.algorithm, algo::NAMES)
            .map(|n| format!("; did you mean `{n}`?"))
            .unwrap_or_default();
        return Err(bad(format!(
            "there is no algorithm `{}` (available: {}){similar}",
            config.algorithm,
            algo::NAMES.join(", ")
        )));
    }
    places.insert(keys.join("."), place);
    Ok(())
}

/// Adds the nearest allowed word to a message about an unknown word. The message quotes first that
/// word, then the allowed ones.
fn with_nearest(message: &str) -> String {
    let mut quoted = message.split('`').skip(1).step_by(2);
    let word = quoted.next().filter(|_| message.starts_with("unknown variant"));
    let similar = word.and_then(|word| nearest(word, quoted));
    similar.map_or_else(
        || message.to_owned(),
        |similar| format!("{message}; did you mean `{similar}`?"),
    )
}

/// An error in a configuration.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The file cannot be read.
    #[error("cannot read `{}`", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// The text is not valid TOML.
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
        /// Origin of the key.
        place: String,
        /// The unknown name.
        key: String,
        /// The nearest valid name.
        nearest: Option<String>,
    },
    /// The value is not allowed.
    #[error("{place}: bad value for `{key}`: {message}")]
    Value {
        /// Origin of the value.
        place: String,
        /// The setting.
        key: String,
        /// What is wrong.
        message: String,
    },
    /// No source names a scenario.
    #[error(
        "no scenario given; name one with --scenario, e.g. --scenario scenarios/intersection.xml"
    )]
    NoScenario,
    /// The scenario is not valid.
    #[error(transparent)]
    Scenario(#[from] scenario::Error),
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use crate::algo::settings;
    use crate::config::{Train, plain};

    fn resolve(text: &str, sets: &[&str]) -> Result<Config, Error> {
        resolve_on("intersection", text, sets)
    }

    fn resolve_on(scenario: &str, text: &str, sets: &[&str]) -> Result<Config, Error> {
        let scenario =
            Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("scenarios/{scenario}.xml"));
        let layers = Layers {
            document: Document {
                name: "c.toml".to_owned(),
                text: text.to_owned(),
                generated: false,
            },
            sets: sets.iter().map(|s| (*s).to_owned()).collect(),
            flags: vec![("scenario", Value::String(scenario.display().to_string()))],
        };
        Config::resolve(&layers).map(|(config, _)| config)
    }

    fn message(text: &str, sets: &[&str]) -> String {
        resolve(text, sets).expect_err("must be refused").to_string()
    }

    /// `docs/reference/settings.md` has a row for each setting, with the default for 8 vehicles on
    /// the intersection.
    #[test]
    fn the_page_of_settings_has_all_of_them_with_their_defaults() {
        let defaults = flatten(&toml::from_str(&resolve("", &[]).unwrap().to_toml()).unwrap());
        let (_, tables) =
            include_str!("../../docs/reference/settings.md").split_once("## The run\n").unwrap();
        let quoted =
            |cell: &str| cell.split('`').skip(1).step_by(2).map(str::to_owned).collect::<Vec<_>>();
        let mut found = BTreeSet::new();
        for row in tables.lines().filter(|line| line.starts_with("| `")) {
            let cells: Vec<&str> = row.split(" | ").collect();
            let said = quoted(cells[1]).into_iter().next();
            for key in quoted(cells[0]).into_iter().filter(|key| !key.starts_with("--")) {
                let is = plain(
                    defaults
                        .get(&key)
                        .unwrap_or_else(|| panic!("`{key}` of the page is no setting")),
                );
                let same = match &said {
                    // A setting that is a file has no default.
                    None => key == "scenario" || is.is_empty(),
                    Some(said) => {
                        *said == is || said.parse::<f64>().is_ok_and(|said| is.parse() == Ok(said))
                    }
                };
                assert!(same, "{key}: {said:?} on the page, {is} by default");
                assert!(found.insert(key.clone()), "{key}: twice on the page");
            }
        }
        let missing: Vec<&String> = defaults.keys().filter(|key| !found.contains(*key)).collect();
        assert!(missing.is_empty(), "not in docs/reference/settings.md: {missing:?}");
    }

    #[test]
    fn later_layers_win() {
        let config = resolve(
            "seed = 3\n[ppo]\ngamma = 0.5\nepochs = 2\n",
            &["ppo.gamma=1", "network.encoder=mlp"],
        )
        .unwrap();
        assert_eq!((config.seed, config.ppo.gamma, config.ppo.epochs), (3, 1.0, 2));
        assert_eq!(config.network.encoder, settings::EncoderKind::Mlp);
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
        assert_eq!((eight.train.clone(), eight.steps), (Train::default(), 1_200_000));
        assert_eq!((samples(&four), four.steps), (2 * samples(&eight), eight.steps));
        assert!([&four, &most].iter().all(|c| c.ppo.minibatch == eight.ppo.minibatch));
        let replays = resolve("agents = 8", &["algorithm=maddpg"]).unwrap();
        assert_eq!(2 * replays.ppo.minibatch, eight.ppo.minibatch);
        assert_eq!(
            (2 * most.train.anneal_steps, 2 * at(16).train.anneal_steps),
            (eight.train.anneal_steps, eight.train.anneal_steps)
        );
        assert_eq!(most.exploration.explore_steps, eight.exploration.explore_steps);
        assert_eq!(most.train.validation_episodes, 16);
        assert_eq!(at(16).train.envs, eight.train.envs);
        // Defaults do not replace values that are given.
        assert_eq!(resolve("agents = 48\nsteps = 5", &["train.envs=3"]).unwrap().train.envs, 3);
        // These settings are the same for every number of agents.
        let searched = |c: &Config| {
            (c.train.repeat_failed, c.train.anneal_success, c.train.stop_success, c.ppo.gamma)
        };
        assert_eq!([&four, &eight, &most].map(searched), [(0.5, 0.95, 0.995, 0.99); 3]);
        assert_eq!(four.train.validation_episodes, 128);
        let shared =
            |name: &str| resolve(&format!("algorithm = '{name}'"), &[]).unwrap().env.cooperation;
        assert_eq!(
            ["mappo", "icp-dec", "icp-sum", "icp-monotonic"].map(shared),
            [0.06, 0.06, 0.0, 0.0]
        );
    }

    #[test]
    fn vehicles_that_steer_have_defaults_of_their_own() {
        let five = resolve_on("parking_lot", "", &[]).unwrap();
        assert_eq!((five.exploration.correlation, five.train.envs), (0.95, 25));
        assert_eq!(five.steps, 4 * resolve("agents = 5", &[]).unwrap().steps);
        let view = |c: &Config| (c.ppo.gamma, c.ppo.gamma_explored);
        assert_eq!((view(&five), view(&resolve("", &[]).unwrap())), ((0.99, 0.995), (0.99, 0.0)));
        assert_eq!(
            view(&resolve_on("parking_lot", "", &["algorithm=maddpg"]).unwrap()),
            view(&five),
            "one task for all"
        );
        assert_eq!((five.train.repeat_failed, five.train.anneal_success), (0.5, 0.9));
    }

    #[test]
    fn a_trained_policy_begins_with_less_noise() {
        let start = |sets: &[&str]| resolve("", sets).unwrap().exploration.log_std_start;
        let noise = settings::Exploration::default();
        assert_eq!(
            (start(&[]), start(&["init_from="])),
            (noise.log_std_start, noise.log_std_start)
        );
        assert_eq!(start(&["init_from=runs/any"]), noise.log_std_explore);
        assert_eq!(start(&["init_from=runs/any", "exploration.log_std_start=-0.5"]), -0.5);
    }

    #[test]
    fn the_resolved_configuration_is_a_configuration() {
        // Some settings are valid only together, and the order in which they are read must not
        // matter.
        for sets in [
            ["env.cooperation=0.25", "train.envs=3"],
            ["iwol.message=96", "iwol.heads=3"],
            ["network.token_width=24", "network.token_heads=3"],
            ["train.rollout_steps=256", "network.chunk_length=200"],
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
        assert_eq!(
            message("[ppo]\ngamma = 1.5\n", &[]),
            "c.toml:2:9: bad value for `ppo.gamma`: allowed: 0 to 1"
        );
        assert!(
            message("[ppo]\ngamma = \"x\"\n", &[])
                .starts_with("c.toml:2:9: bad value for `ppo.gamma`: invalid type")
        );
        assert!(message("[ppo\n", &[]).starts_with("c.toml:1:"));
        assert!(
            message("", &["iwol.mask=soft"])
                .starts_with("--set iwol.mask=soft: bad value for `iwol.mask`: unknown variant")
        );
        assert_eq!(
            message("", &["gamma"]),
            "--set gamma: bad value for `gamma`: write it as key=value"
        );
        assert!(
            message("", &["gamma=1"]).contains("did you mean `ppo.gamma`?"),
            "{}",
            message("", &["gamma=1"])
        );
        assert_eq!(
            message("[iwol]\nmessage = 6\n", &[]),
            "c.toml:2:11: bad value for `iwol.heads`: allowed: a divisor of iwol.message"
        );
        assert!(message("", &["device=gpu"]).contains("write cpu, cuda or cuda:<number>"));
        assert_eq!(
            message("", &["env.intention=hiden"]),
            "--set env.intention=hiden: bad value for `env.intention`: unknown variant `hiden`, expected one of `seen`, \
             `signalled`, `hidden`; did you mean `hidden`?"
        );
        assert_eq!(
            message("", &["env.signal_distance=20"]),
            "--set env.signal_distance=20: bad value for `env.signal_distance`: allowed: 30, the default, unless \
             env.intention is signalled: otherwise no vehicle has an indicator"
        );
        assert!(
            message("", &["env.intention=signalled", "env.signal_distance=0"])
                .contains("allowed: 1 to 200")
        );
        let signalled =
            resolve("", &["env.intention=signalled", "env.signal_distance=20"]).unwrap();
        assert_eq!(signalled.env.signal_distance, 20.0);
        assert!(message("", &["env.observation=all"]).contains("unknown variant"));
        assert!(message("", &["env.reward_crash=nan"]).contains("a finite number"));
        assert!(message("", &["agents=49"]).contains("49"), "{}", message("", &["agents=49"]));
        assert!(
            message("", &["ppo.target_kl=0.01", "algorithm=commformer"])
                .contains("0 with CommFormer")
        );
    }
}
