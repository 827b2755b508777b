//! Settings on their way to a configuration.

use toml::de::{DeTable, DeValue};
use toml::{Table, Value};

use super::origin::{Origin, Origins};
use super::presets::{PRESETS, Preset};
use super::profiles::{PROFILES, Profile};
use super::{Config, Document, Error, flatten, full_name, scenario};
use crate::algo;
use crate::scenario::cannot_override;
use crate::suggest::nearest;

/// The keys that name settings instead of being settings.
pub(super) const NAMED: [&str; 2] = ["preset", "profile"];

/// The values of all settings, and the origin of each.
pub(super) struct Values {
    pub(super) table: Table,
    pub(super) origins: Origins,
}

impl Values {
    /// Returns a configuration's values; `origin` returns the origin of a setting by its name.
    pub(super) fn of(config: &Config, origin: impl Fn(&str) -> Origin) -> Self {
        let table = to_table(config);
        let origins = flatten(&table).into_keys().map(|key| (key.clone(), origin(&key))).collect();
        Self { table, origins }
    }

    /// Applies a rule and notes `origin` as the origin of what it changes.
    pub(super) fn follow(&mut self, origin: &Origin, change: impl FnOnce(&mut Config)) {
        let mut config: Config = self.table.clone().try_into().expect("defaults are valid");
        change(&mut config);
        let was = flatten(&self.table);
        self.table = to_table(&config);
        let changed =
            flatten(&self.table).into_iter().filter(|(key, value)| was.get(key) != Some(value));
        self.origins.extend(changed.map(|(key, _)| (key, origin.clone())));
    }

    /// Takes over the settings of a preset.
    pub(super) fn preset(&mut self, preset: &Preset) {
        for (key, value) in flatten(&preset.table()) {
            let keys: Vec<&str> = key.split('.').collect();
            if keys[0] == "scenario" && !self.has_scenario() {
                // What a preset says of scenarios does not concern environments without one.
                continue;
            }
            self.set(&keys, value, Origin::Preset(preset.name));
        }
    }

    /// Takes over the settings of a document.
    pub(super) fn merge(
        &mut self,
        layer: &DeTable<'_>,
        prefix: &[&str],
        document: &Document,
    ) -> Result<(), Error> {
        for (key, value) in layer {
            let keys = [prefix, &[key.get_ref()]].concat();
            self.check_key(&keys, &document.place(key.span().start))?;
            if let DeValue::Table(inner) = value.get_ref() {
                self.merge(inner, &keys, document)?;
            } else {
                let place = document.place(value.span().start);
                let parsed =
                    parse_value(&document.text[value.span()]).ok_or_else(|| Error::Syntax {
                        place: place.clone(),
                        message: "this value cannot be read".to_owned(),
                    })?;
                self.assign(&keys, parsed, &place)?;
            }
        }
        Ok(())
    }

    /// Sets a setting and checks its type, so that an error names the place of the value. Ranges
    /// are checked at the end, because some depend on other settings.
    pub(super) fn assign(&mut self, keys: &[&str], value: Value, place: &str) -> Result<(), Error> {
        let named = keys.join(".");
        let keys = &full_name(&named).split('.').collect::<Vec<_>>()[..];
        self.check_key(keys, place)?;
        let bad = |message: String| Error::Value {
            place: place.to_owned(),
            key: keys.join("."),
            message,
        };
        // Presets and profiles are taken over before all documents.
        let name = value.as_str().unwrap_or_default();
        let (known, names) = match keys {
            ["preset"] => {
                (Preset::named(name).is_some(), &PRESETS.each_ref().map(|preset| preset.name)[..])
            }
            ["profile"] => (
                Profile::named(name).is_some(),
                &PROFILES.each_ref().map(|profile| profile.name)[..],
            ),
            _ => (false, &[][..]),
        };
        if known {
            return Ok(());
        }
        if !names.is_empty() {
            let auto = "; --profile auto is that of this machine";
            let auto = if keys == ["profile"] { auto } else { "" };
            return Err(bad(unknown(keys[0], &value, names) + auto));
        }
        if flatten(&self.table).keys().any(|key| key.starts_with(&format!("{}.", keys.join(".")))) {
            return Err(bad("this is a group of settings; set one of them".to_owned()));
        }
        let value = match keys {
            ["scenario", path @ ..] => {
                scenario::checked(path, &value).unwrap_or(Ok(value)).map_err(bad)?
            }
            _ if value.as_float().is_some_and(f64::is_nan) => {
                let allowed = super::schema::allowed(keys).unwrap_or_else(|| "a number".to_owned());
                return Err(bad(format!("allowed: {allowed}")));
            }
            _ => value,
        };
        let plain = value.as_str().and_then(|text| {
            let number = text.parse::<f64>().ok().map(|number| number.to_string());
            number.or_else(|| Some(text.parse::<bool>().ok()?.to_string()))
        });
        self.set(keys, value, Origin::Given(place.to_owned()));
        let config: Config = match Value::Table(self.table.clone()).try_into() {
            Ok(config) => config,
            Err(error) => {
                let error: toml::de::Error = error;
                // The parser's words for a value of another type are those of Rust's types.
                let other_type = error.message().starts_with("invalid ");
                let allowed = other_type.then(|| super::schema::allowed(keys)).flatten();
                let plain =
                    plain.map_or_else(String::new, |plain| format!("; write it as {plain}"));
                return Err(bad(allowed.map_or_else(
                    || with_nearest(error.message()),
                    |allowed| format!("allowed: {allowed}{plain}"),
                )));
            }
        };
        let names = algo::names();
        if !names.contains(&config.algorithm.as_str()) {
            return Err(bad(unknown("algorithm", &config.algorithm.into(), &names)));
        }
        Ok(())
    }

    /// Returns the name of the setting or group that was probably meant: one with a similar last
    /// part, or else the most similar one.
    fn nearest(&self, name: &str) -> Option<String> {
        fn last(name: &str) -> &str {
            name.rsplit('.').next().unwrap_or_default()
        }
        let settings: Vec<String> = flatten(&self.table).into_keys().collect();
        let names = || settings.iter().map(String::as_str);
        let by_last = nearest(last(name), names().map(last)).and_then(|similar| {
            let mut same = names().filter(|key| last(key) == similar);
            nearest(name, same.clone()).or_else(|| same.next())
        });
        let groups = names().filter_map(|key| Some(key.rsplit_once('.')?.0));
        by_last.or_else(|| nearest(name, groups.chain(names()))).map(str::to_owned)
    }

    fn has_scenario(&self) -> bool {
        let scenario = self.table.get("scenario").and_then(Value::as_table);
        scenario.is_some_and(|values| values.values().any(Value::is_table))
    }

    fn set(&mut self, keys: &[&str], value: Value, origin: Origin) {
        let (last, folders) = keys.split_last().expect("a key has a name");
        let mut here = &mut self.table;
        for key in folders {
            here = here.get_mut(*key).and_then(Value::as_table_mut).expect("a valid key");
        }
        let value = match (&here[*last], value) {
            (Value::Float(_), Value::Integer(i)) => Value::Float(i as f64),
            (_, value) => value,
        };
        here.insert((*last).to_owned(), value);
        self.origins.insert(keys.join("."), origin);
    }

    /// Checks that a key is valid: the table contains every valid key but those of named settings.
    fn check_key(&self, keys: &[&str], place: &str) -> Result<(), Error> {
        if matches!(keys, [key] if NAMED.contains(key)) {
            return Ok(());
        }
        let mut here = &self.table;
        for (depth, key) in keys.iter().enumerate() {
            match here.get(*key) {
                Some(Value::Table(inner)) => here = inner,
                Some(_) if depth + 1 == keys.len() => {}
                _ => {
                    let (place, key) = (place.to_owned(), keys.join("."));
                    let known = (keys[0] == "scenario").then(|| cannot_override(&keys[1..]));
                    return Err(match known.flatten() {
                        Some(message) => Error::Value { place, key, message },
                        None => Error::UnknownKey { place, nearest: self.nearest(&key), key },
                    });
                }
            }
        }
        Ok(())
    }
}

pub(super) fn to_table(config: &Config) -> Table {
    Table::try_from(config).expect("a configuration is plain data")
}

/// Parses a value; `None` if the text is not one value.
pub(super) fn parse_value(text: &str) -> Option<Value> {
    let mut table: Table = toml::from_str(&format!("v = {text}")).ok()?;
    if table.len() == 1 { table.remove("v") } else { None }
}

/// Returns the message that no `what` has the name `name`.
fn unknown(what: &str, name: &Value, all: &[&str]) -> String {
    let name = super::plain(name);
    let similar = did_you_mean(nearest(&name, all.iter().copied()));
    format!("there is no {what} `{name}` (available: {}){similar}", all.join(", "))
}

fn did_you_mean(similar: Option<&str>) -> String {
    similar.map(|similar| format!("; did you mean `{similar}`?")).unwrap_or_default()
}

/// Adds the nearest allowed word to a message about an unknown word. The message quotes first that
/// word, then the allowed ones.
fn with_nearest(message: &str) -> String {
    let mut quoted = message.split('`').skip(1).step_by(2);
    let word = quoted.next().filter(|_| message.starts_with("unknown variant"));
    format!("{message}{}", did_you_mean(word.and_then(|word| nearest(word, quoted))))
}
