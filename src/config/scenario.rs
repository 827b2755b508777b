//! The scenario as settings: its file, and the numbers, words and flags in the file that a run may
//! override, as `scenario.<element>.<attribute>` with the names of the XML. What there is, what is
//! allowed and what it means is declared in the schema of scenario files alone.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::PathBuf;

use schemars::{JsonSchema, Schema, SchemaGenerator};
use serde::{Deserialize, Serialize};
use serde_json::{Map, json};
use toml::{Table, Value};

use super::flat::{between, flatten};
use super::origin::{Origin, Origins};
use super::{Change, Error, plain, schema};
use crate::scenario::{
    Attribute, Kind, Overridable, Override, Refused, Scenario, ScenarioFile, overridable,
};

/// The scenario: its file, and values for numbers, words and flags in the file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ScenarioSettings {
    /// The file.
    pub file: PathBuf,
    /// The values, in a table per element.
    #[serde(flatten)]
    values: Table,
}

impl ScenarioSettings {
    /// Returns the values in a file.
    pub(super) fn of(file: &ScenarioFile) -> Self {
        let mut values = Table::new();
        for (known, text) in file.values() {
            insert(&mut values, &known.path, typed(known.attribute, text.as_deref()));
        }
        Self { file: file.scenario.path.clone(), values }
    }

    /// Returns the settings of an environment without a scenario.
    pub(super) fn none() -> Self {
        Self { file: PathBuf::new(), values: Table::new() }
    }

    /// Returns the value of an attribute of an element below `<scenario>`; `None` if the scenario
    /// does not have it.
    pub fn value(&self, element: &str, attribute: &str) -> Option<&Value> {
        find(&self.values, &[element, attribute])
    }

    /// Replaces the value of an attribute of an element below `<scenario>`, if there is a scenario.
    pub(super) fn set(&mut self, element: &str, attribute: &str, value: Value) {
        if !self.values.is_empty() {
            insert(&mut self.values, &[element, attribute], value);
        }
    }

    /// Returns the values that differ from those in a file.
    pub(super) fn changes(&self, file: &ScenarioFile) -> Vec<Change> {
        let changed = |(known, own, value): (Overridable, Value, &Value)| Change {
            key: format!("scenario.{}", known.path.join(".")),
            was: plain(&own),
            is: plain(value),
        };
        self.differing(file).into_iter().map(changed).collect()
    }

    /// Returns the attributes whose values differ, each with the value in the file and the value
    /// here.
    fn differing(&self, file: &ScenarioFile) -> Vec<(Overridable, Value, &Value)> {
        let all = file.values().into_iter();
        all.filter_map(|(known, text)| {
            let own = typed(known.attribute, text.as_deref());
            let value = find(&self.values, &known.path).filter(|value| **value != own)?;
            Some((known, own, value))
        })
        .collect()
    }

    /// Returns the scenario of a file with these values; `origins` has the source of each.
    pub(super) fn load(&self, file: &ScenarioFile, origins: &Origins) -> Result<Scenario, Error> {
        let differing = self.differing(file);
        let overrides: Vec<Override> = differing
            .iter()
            .map(|(known, _, value)| Override {
                path: known.path.clone(),
                text: text(known.attribute, value),
            })
            .collect();
        let key = |over: &Override| format!("scenario.{}", over.path.join("."));
        let place = |over: &Override| match origins.get(&key(over)) {
            Some(Origin::Given(place)) => place.clone(),
            Some(origin) => format!("{} ({origin})", key(over)),
            None => key(over),
        };
        file.load(&overrides).map_err(|Refused { index, error }| match index {
            Some(index) => {
                let over = &overrides[index];
                Error::Value { place: place(over), key: key(over), message: error.message() }
            }
            None if overrides.is_empty() => error.into(),
            None => Error::Overridden {
                places: overrides.iter().map(place).collect::<Vec<_>>().join(", "),
                error,
            },
        })
    }
}

/// Returns the settings in which a configuration `is` differs from an earlier one, `was`, both as
/// TOML, sorted by name. A setting or an attribute of the scenario that `was` lacks belongs to a
/// later version of the program and counts as its default.
pub fn changes(was: &str, is: &str) -> Vec<Change> {
    let flat = |text: &str| flatten(&text.parse().unwrap_or_default());
    flat_changes(&flat(was), &flat(is))
}

/// Returns the same as [`changes`], for flat settings.
pub(crate) fn flat_changes(
    was: &BTreeMap<String, Value>,
    is: &BTreeMap<String, Value>,
) -> Vec<Change> {
    let mut was = was.clone();
    for Overridable { path, attribute, .. } in overridable() {
        let key = format!("scenario.{}", path.join("."));
        if let Some(default) = attribute.default.as_deref()
            && is.contains_key(&key)
        {
            was.entry(key).or_insert_with(|| typed(attribute, Some(default)));
        }
    }
    for key in is.keys().filter(|key| !key.starts_with("scenario.")) {
        let parts: Vec<&str> = key.split('.').collect();
        if let Some(default) = schema::default(&parts) {
            was.entry(key.clone()).or_insert(default);
        }
    }
    between(&was, is)
}

/// Returns a value of the attribute at `path` as it is stored, or why it is not allowed; `None` if
/// there is no such attribute.
pub(super) fn checked(path: &[&str], value: &Value) -> Option<Result<Value, String>> {
    let known = overridable().into_iter().find(|known| known.path == path)?;
    let attribute = known.attribute;
    if is_absent(value) && !attribute.required && attribute.default.is_none() {
        return Some(Ok(typed(attribute, None)));
    }
    let text = plain(value);
    Some(known.refusal(&text).map_or_else(|| Ok(typed(attribute, Some(&text))), Err))
}

/// Returns the value of an attribute. A number that is missing limits nothing: it is infinite.
fn typed(attribute: &Attribute, text: Option<&str>) -> Value {
    let number = |text: &str| text.trim().parse::<f64>().unwrap_or(f64::NAN);
    match (&attribute.kind, text) {
        (Kind::Number { whole: true, .. }, Some(text)) => Value::Integer(number(text) as i64),
        (Kind::Number { .. }, text) => Value::Float(text.map_or(f64::INFINITY, number)),
        (_, Some("true")) => Value::Boolean(true),
        (_, Some("false")) => Value::Boolean(false),
        (_, text) => Value::String(text.unwrap_or_default().to_owned()),
    }
}

/// Returns the text of an attribute; `None` if the attribute is to be left out, because its value
/// is the default.
fn text(attribute: &Attribute, value: &Value) -> Option<String> {
    let default = attribute.default.as_deref().map(|default| typed(attribute, Some(default)));
    (default.as_ref() != Some(value) && !is_absent(value)).then(|| plain(value))
}

fn is_absent(value: &Value) -> bool {
    value.as_float() == Some(f64::INFINITY) || value.as_str() == Some("")
}

fn find<'a>(table: &'a Table, path: &[&str]) -> Option<&'a Value> {
    let (last, folders) = path.split_last()?;
    folders.iter().try_fold(table, |here, name| here.get(*name)?.as_table())?.get(*last)
}

fn insert(table: &mut Table, path: &[&str], value: Value) {
    match path {
        [] => {}
        [name] => _ = table.insert((*name).to_owned(), value),
        [name, rest @ ..] => {
            let inner = table.entry(*name).or_insert_with(|| Value::Table(Table::new()));
            if let Value::Table(inner) = inner {
                insert(inner, rest, value);
            }
        }
    }
}

impl JsonSchema for ScenarioSettings {
    fn schema_name() -> Cow<'static, str> {
        "Scenario".into()
    }

    fn inline_schema() -> bool {
        true
    }

    /// Returns a path, or an object with the path and an object per element.
    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        let file = json!({ "type": "string" });
        let mut root = json!({ "type": "object", "additionalProperties": false, "properties": { "file": file } });
        for Overridable { path, element, attribute } in overridable() {
            let mut here = &mut root;
            for name in &path[..path.len() - 1] {
                here = &mut here["properties"][name];
                if here.is_null() {
                    *here = json!({ "type": "object", "additionalProperties": false });
                }
            }
            here["description"] = element.text.clone().into();
            here["properties"][&attribute.name] = described(attribute).into();
        }
        let mut schema = Schema::default();
        schema.insert("anyOf".to_owned(), json!([file, root]));
        schema
    }
}

/// Returns the JSON schema of an attribute.
fn described(attribute: &Attribute) -> Map<String, serde_json::Value> {
    let unit = attribute.unit.as_ref().map_or_else(String::new, |unit| format!(" [{unit}]"));
    let text = format!("{}{unit}", attribute.text);
    let mut schema = Map::from_iter([("description".to_owned(), text.into())]);
    match &attribute.kind {
        Kind::Number { whole, least, above, most } => {
            schema.insert("type".to_owned(), if *whole { "integer" } else { "number" }.into());
            let limits = [("minimum", least), ("exclusiveMinimum", above), ("maximum", most)];
            schema.extend(limits.into_iter().filter_map(|(key, limit)| {
                // Limits that only keep sums finite are left out: an absent number is infinite.
                let limit = limit.filter(|limit| limit.abs() < 1e9)?;
                Some((key.to_owned(), serde_json::Value::from(limit)))
            }));
        }
        Kind::Choice(words) if words.iter().all(|word| word == "true" || word == "false") => {
            schema.insert("type".to_owned(), "boolean".into());
        }
        Kind::Choice(words) => _ = schema.insert("enum".to_owned(), json!(words)),
        Kind::Text { .. } | Kind::Pattern(_) | Kind::List { .. } => {}
    }
    schema
}
