//! The layers of settings and their priority.

use std::fmt::Write as _;
use std::path::Path;

use toml::Value;
use toml::de::{DeTable, DeValue};

use super::defaults::Setting;
use super::origin::{Origin, Origins};
use super::presets::Preset;
use super::profiles::{PROFILES, Profile};
use super::values::{NAMED, Values, parse_value, to_table};
use super::{Change, Config, DEFAULT_ALGORITHM, Document, Error, full_name, schema};
use crate::env::{EnvSpec, Environment, NamedEnvironment};
use crate::scenario::{Scenario, ScenarioFile};
use crate::suggest::nearest;

/// The sources of settings, in rising priority. Below all of them are the defaults, then the profile
/// and the preset that the keys `profile` and `preset` name in any of them.
#[derive(Debug, Clone, Default)]
pub struct Layers {
    /// The profile where no layer names one; by default `laptop`, so that the same files give the
    /// same settings on every machine.
    pub profile: Option<&'static Profile>,
    /// The file of `--config`, or the configuration in a checkpoint.
    pub document: Document,
    /// `--set key=value`, in order.
    pub sets: Vec<String>,
    /// Flags, as `(key, TOML value)`.
    pub flags: Vec<(&'static str, Value)>,
}

/// The result of resolving layers.
#[derive(Debug)]
pub struct Resolution {
    /// All settings.
    pub config: Config,
    /// Where agents act.
    pub place: TaskSource,
    /// Where the value of each setting comes from.
    pub origins: Origins,
    /// The values that replace others in the scenario's file.
    pub replaced: Vec<Change>,
    /// The profile from which defaults come.
    pub profile: &'static Profile,
}

impl Resolution {
    /// Says which settings of a run replace values in the scenario's file. Settings that options
    /// give need no mention. `None` if there are no others.
    pub fn replacement(&self) -> Option<String> {
        let by_option = |change: &Change| match self.origins.get(&change.key) {
            Some(Origin::Given(place)) => place.starts_with("--"),
            _ => false,
        };
        let changes = self.replaced.iter().filter(|change| !by_option(change));
        let list: Vec<String> = changes.map(ToString::to_string).collect();
        let file = self.place.scenario()?.path.display();
        let text = || format!("settings of the run replace values in {file}: {}", list.join(", "));
        (!list.is_empty()).then(text)
    }
}

/// Where agents act.
#[derive(Debug)]
pub enum TaskSource {
    /// On the roads of a scenario, with the values of the settings.
    Scenario(Box<Scenario>),
    /// In an environment without SUMO.
    Environment(NamedEnvironment),
}

impl TaskSource {
    /// Returns the name.
    pub fn name(&self) -> &str {
        match self {
            Self::Scenario(scenario) => &scenario.name,
            Self::Environment(named) => named.name,
        }
    }

    /// Returns the scenario; `None` for an environment without one.
    pub fn scenario(&self) -> Option<&Scenario> {
        match self {
            Self::Scenario(scenario) => Some(scenario),
            Self::Environment(_) => None,
        }
    }

    /// Returns a number that another scenario would not have, or the name of an environment.
    pub fn fingerprint(&self) -> String {
        match self {
            Self::Scenario(scenario) => scenario.fingerprint(),
            Self::Environment(named) => named.name.to_owned(),
        }
    }
}

impl Config {
    /// Resolves the layers and returns the configuration, and the scenario with the values in it.
    ///
    /// # Errors
    /// As [`Layers::resolve`], and [`Error::WithoutScenario`] for an environment.
    pub fn resolve(layers: &Layers) -> Result<(Self, Scenario), Error> {
        let Resolution { config, place, .. } = layers.resolve()?;
        match place {
            TaskSource::Scenario(scenario) => Ok((config, *scenario)),
            TaskSource::Environment(named) => Err(Error::WithoutScenario { name: named.name }),
        }
    }
}

impl Layers {
    /// Resolves the layers.
    ///
    /// # Errors
    /// [`Error`], with the place of the setting.
    pub fn resolve(&self) -> Result<Resolution, Error> {
        let document = &self.document;
        let parsed = self.parsed()?;
        let profile = self.profile(parsed.get_ref());
        if let Some(named) = self.named_environment(parsed.get_ref())? {
            let environment = named.environment();
            let (config, origins) = self.in_environment(parsed.get_ref(), &*environment)?;
            let place = TaskSource::Environment(named);
            return Ok(Resolution { config, place, origins, replaced: Vec::new(), profile });
        }
        // The scenario gives its own values and the default number of agents.
        let path = match self.look_up(parsed.get_ref(), "scenario.file") {
            Some(Value::String(path)) => path,
            Some(other) => {
                let (place, key) = (self.place_of("scenario.file"), "scenario".to_owned());
                let message = format!("{other} is no path of a scenario file");
                return Err(Error::Value { place, key, message });
            }
            None => {
                let unknown = unknown_key(parsed.get_ref(), "", document);
                return Err(unknown.unwrap_or(Error::NoScenario));
            }
        };
        let file = ScenarioFile::read(Path::new(&path))?;
        let (config, origins) = self.settings(parsed.get_ref(), Setting::Scenario(&file))?;
        let scenario = config.scenario.load(&file, &origins)?;
        scenario.net_for(config.agents)?;
        let replaced = config.scenario.changes(&file);
        let place = TaskSource::Scenario(Box::new(scenario));
        Ok(Resolution { config, place, origins, replaced, profile })
    }

    /// Returns the environment that the layers name, if they name one.
    fn named_environment(&self, parsed: &DeTable<'_>) -> Result<Option<NamedEnvironment>, Error> {
        let Some(name) = self.word(parsed, "environment") else { return Ok(None) };
        let key = "environment".to_owned();
        let place = self.place_of("environment");
        let refused = |message: String| Error::Value { place, key, message };
        let Some(named) = NamedEnvironment::find(&name) else {
            let names = NamedEnvironment::names();
            let similar = nearest(&name, names.iter().copied());
            let similar = similar.map(|s| format!("; did you mean `{s}`?")).unwrap_or_default();
            let known = names.join(", ");
            return Err(refused(format!(
                "there is no environment `{name}` (available: {known}; one that an application registers is known to \
                 the application's own program){similar}"
            )));
        };
        match self.word(parsed, "scenario.file") {
            None => Ok(Some(named)),
            Some(file) => Err(refused(format!(
                "`{file}` is a scenario ({}); give either a scenario or an environment",
                self.place_of("scenario.file")
            ))),
        }
    }

    fn in_environment(
        &self,
        parsed: &DeTable<'_>,
        environment: &dyn Environment,
    ) -> Result<(Config, Origins), Error> {
        let (name, spec) = (environment.name(), environment.spec());
        self.check_effects(spec)?;
        let (config, origins) = self.settings(parsed, Setting::Environment { name, spec })?;
        self.check_agents(&config, spec)?;
        Ok((config, origins))
    }

    /// Refuses options of the command line whose settings have no effect in an environment without
    /// SUMO. Files may have such settings, because they may serve scenarios as well.
    fn check_effects(&self, spec: &EnvSpec) -> Result<(), Error> {
        let sets = self.sets.iter().filter_map(|set| Some(set.split_once('=')?.0.trim()));
        for key in sets.chain(self.flags.iter().map(|(key, _)| *key)).map(full_name) {
            let message = match () {
                () if key.starts_with("simulation.") || key.starts_with("scenario.") => {
                    "has no effect: the environment is without SUMO"
                }
                () if spec.actions.choices().is_some() && key == "exploration.correlation" => {
                    "has no effect: actions are discrete, and without noise"
                }
                () => continue,
            };
            let (place, message) = (self.place_of(key), message.to_owned());
            return Err(Error::Value { place, key: key.to_string(), message });
        }
        Ok(())
    }

    /// Resolves the layers for an environment without SUMO. Their `environment`, if they have one,
    /// has to be its name.
    ///
    /// # Errors
    /// [`Error`], with the place of the setting.
    pub fn for_environment(&self, environment: &dyn Environment) -> Result<Config, Error> {
        let parsed = self.parsed()?;
        let other = self.word(parsed.get_ref(), "environment");
        if let Some(other) = other.filter(|name| name != environment.name()) {
            let message =
                format!("the settings are for `{other}`, not for `{}`", environment.name());
            let (place, key) = (self.place_of("environment"), "environment".to_owned());
            return Err(Error::Value { place, key, message });
        }
        Ok(self.in_environment(parsed.get_ref(), environment)?.0)
    }

    /// Checks that the number of agents is that of an environment without scenario, which is the
    /// same in all episodes.
    fn check_agents(&self, config: &Config, spec: &EnvSpec) -> Result<(), Error> {
        if config.train.fewest_agents > 0 {
            let message = "allowed in scenarios only".to_owned();
            let (place, key) =
                (self.place_of("train.fewest_agents"), "train.fewest_agents".to_owned());
            return Err(Error::Value { place, key, message });
        }
        if config.agents as usize == spec.agents {
            return Ok(());
        }
        let stored: Option<toml::Table> = toml::from_str(&self.document.text).ok();
        let stored = stored.as_ref().and_then(|table| table.get("environment")?.as_str());
        if let Some(other) = stored.filter(|name| *name != config.environment) {
            let place = self.place_of("environment");
            let message = format!(
                "these settings are for `{other}`, not for `{}`, which has {} agents",
                config.environment, spec.agents
            );
            return Err(Error::Value { place, key: "environment".to_owned(), message });
        }
        let message = format!("the environment has {} agents", spec.agents);
        let (place, key) = (self.place_of("agents"), "agents".to_owned());
        Err(Error::Value { place, key, message })
    }

    /// Returns where the layers give a setting, by its full name.
    fn place_of(&self, key: &str) -> String {
        let named = |own: &str| full_name(own.trim()) == key;
        let flag = self.flags.iter().find(|(own, _)| named(own));
        let flag = flag.map(|(own, _)| format!("--{}", own.rsplit('.').next().unwrap_or(own)));
        let set = || {
            let set = self
                .sets
                .iter()
                .rfind(|set| set.split_once('=').is_some_and(|(own, _)| named(own)));
            set.map(|set| format!("--set {set}"))
        };
        flag.or_else(set).unwrap_or_else(|| self.document.name.clone())
    }

    /// Returns the document's tables.
    fn parsed(&self) -> Result<toml::Spanned<DeTable<'_>>, Error> {
        DeTable::parse(&self.document.text).map_err(|e| Error::Syntax {
            place: self.document.place(e.span().map_or(0, |span| span.start)),
            message: e.message().to_owned(),
        })
    }

    /// Returns all settings with their origins.
    fn settings(
        &self,
        parsed: &DeTable<'_>,
        setting: Setting<'_>,
    ) -> Result<(Config, Origins), Error> {
        let document = &self.document;
        // The number of agents and the method give the defaults of learning, so that they are
        // looked up first.
        let first = |key: &str| self.look_up(parsed, key);
        let word = |key: &str| first(key).and_then(|v| v.as_str().map(str::to_owned));
        let given = first("agents").and_then(|v| u32::try_from(v.as_integer()?).ok());
        let algorithm = word("algorithm");
        let preset = word("preset").and_then(|name| Preset::named(&name));
        let mut values = Values::defaults(
            setting,
            algorithm.as_deref().unwrap_or(DEFAULT_ALGORITHM),
            given.unwrap_or(setting.agents()),
            word("init_from").is_some_and(|from| !from.is_empty()),
            self.profile(parsed),
            preset.is_some(),
        );
        if let Some(preset) = preset {
            values.preset(preset);
        }

        values.merge(parsed, &[], document)?;
        for set in &self.sets {
            let place = format!("--set {set}");
            let Some((key, value)) = set.split_once('=') else {
                let message = "write it as key=value".to_owned();
                return Err(Error::Value { place, key: set.clone(), message });
            };
            values.assign(
                &key.trim().split('.').collect::<Vec<_>>(),
                bare(value.trim()),
                &place,
            )?;
        }
        for (key, value) in &self.flags {
            let place = format!("--{}", key.rsplit('.').next().unwrap_or(key));
            values.assign(&key.split('.').collect::<Vec<_>>(), value.clone(), &place)?;
        }

        if !matches!(values.origins["ppo.shards"], Origin::Given(_)) {
            values.follow(&Origin::Rule("minibatch"), Config::follow_minibatch);
        }
        let Values { table, origins } = values;
        let wrong = |keys: &[&str], allowed: &str| {
            // The first key breaks the rule, but the user may have set another key of the rule.
            let place = keys.iter().find_map(|key| match origins.get(*key)? {
                Origin::Given(place) => Some(place.clone()),
                _ => None,
            });
            Err(Error::Value {
                place: place.unwrap_or_else(|| document.name.clone()),
                key: keys[0].to_owned(),
                message: format!("allowed: {allowed}"),
            })
        };
        if let Some((key, allowed)) = schema::out_of_range(&table) {
            return wrong(&[&key], &allowed);
        }
        let config: Config =
            Value::Table(table).try_into().map_err(|e: toml::de::Error| Error::Value {
                place: document.name.clone(),
                key: String::new(),
                message: e.message().to_owned(),
            })?;
        if let Some((keys, allowed)) = config.broken_rule() {
            return wrong(keys, allowed);
        }
        Ok((config, origins))
    }

    /// Returns the profile that the layers name, or else the one for layers that name none.
    fn profile(&self, document: &DeTable<'_>) -> &'static Profile {
        let named = self.word(document, "profile").and_then(|name| Profile::named(&name));
        named.or(self.profile).unwrap_or(&PROFILES[0])
    }

    /// Returns the word that the layers give for a setting, by its full name; `None` if they give
    /// none or an empty one.
    fn word(&self, document: &DeTable<'_>, key: &str) -> Option<String> {
        let value = self.look_up(document, key)?;
        value.as_str().filter(|word| !word.is_empty()).map(str::to_owned)
    }

    /// Returns the value that the layers give for a setting, by its full name.
    fn look_up(&self, document: &DeTable<'_>, key: &str) -> Option<Value> {
        let flag = self.flags.iter().find(|(own, _)| full_name(own) == key).map(|(_, v)| v.clone());
        let set = || {
            let mut sets = self.sets.iter().rev().filter_map(|set| set.split_once('='));
            sets.find(|(own, _)| full_name(own.trim()) == key).map(|(_, text)| bare(text.trim()))
        };
        flag.or_else(set).or_else(|| self.in_document(document, "", key))
    }

    /// Returns the value of a setting in a table of the document whose full name is `prefix`.
    fn in_document(&self, table: &DeTable<'_>, prefix: &str, key: &str) -> Option<Value> {
        table.iter().find_map(|(own, value)| {
            let name = format!("{prefix}{}", own.get_ref());
            match value.get_ref() {
                DeValue::Table(inner) if key.starts_with(&format!("{name}.")) => {
                    self.in_document(inner, &format!("{name}."), key)
                }
                _ if full_name(&name) == key => parse_value(self.document.text.get(value.span())?),
                _ => None,
            }
        })
    }
}

impl Resolution {
    /// Returns the settings that the method reads, as TOML, with the origin of each as a comment.
    pub fn explained(&self) -> String {
        let mut table = to_table(&self.config);
        super::remove_untold(&mut table, &self.config.algorithm);
        let text = toml::to_string_pretty(&table).expect("a configuration is plain data");
        let mut group = String::new();
        let Profile { name, machines, .. } = self.profile;
        let mut lines = format!("# profile {name} (for {machines})\n");
        for line in text.lines() {
            if let Some(name) = line.strip_prefix('[') {
                group = format!("{}.", name.trim_end_matches(']'));
            }
            let origin = line
                .split_once(" = ")
                .and_then(|(key, _)| self.origins.get(&format!("{group}{key}")));
            match origin {
                Some(origin) => writeln!(lines, "{line:<44} # {origin}"),
                None => writeln!(lines, "{line}"),
            }
            .expect("a string takes any text");
        }
        lines
    }
}

/// Returns the error of the first key of a document that is no setting; a missing scenario may be
/// its consequence.
fn unknown_key(layer: &DeTable<'_>, prefix: &str, document: &Document) -> Option<Error> {
    let names = schema::names();
    layer.iter().find_map(|(key, value)| {
        let name = format!("{prefix}{}", key.get_ref());
        let group = format!("{name}.");
        match value.get_ref() {
            DeValue::Table(inner) if names.iter().any(|known| known.starts_with(&group)) => {
                unknown_key(inner, &group, document)
            }
            _ if NAMED.contains(&name.as_str()) || names.contains(&name) => None,
            _ => Some(Error::UnknownKey {
                place: document.place(key.span().start),
                nearest: nearest(&name, names.iter().map(String::as_str)).map(str::to_owned),
                key: name,
            }),
        }
    })
}

/// Parses the value of a `--set`. Bare words are strings: `network.encoder=mlp` needs no quotes.
fn bare(text: &str) -> Value {
    parse_value(text).unwrap_or_else(|| Value::String(text.to_owned()))
}
