//! Derived from the declarations of the settings: the JSON schema, the check of ranges, and
//! the reference page.

use std::fmt::Write as _;
use std::sync::LazyLock;

use serde_json::{Map, Value, json};
use toml::Table;

use super::presets::{PRESETS, STEERING};
use super::profiles::PROFILES;
use super::{Config, flatten};
use crate::scenario::overridable;

static SCHEMA: LazyLock<Value> = LazyLock::new(|| schemars::schema_for!(Config).into());

impl Config {
    /// Returns the JSON schema of files with settings, for editors. No setting is required.
    pub fn schema() -> Value {
        let mut schema = SCHEMA.clone();
        let named = |description: &str, names: &[&str]| json!({ "description": description, "enum": names });
        schema["properties"]["preset"] =
            named("Settings that replace defaults.", &PRESETS.map(|preset| preset.name));
        schema["properties"]["profile"] = named(
            "Kind of machine, whose sizes of rollouts and updates replace defaults.",
            &PROFILES.map(|profile| profile.name),
        );
        let groups = schema["$defs"].as_object_mut().expect("groups").values_mut();
        groups.filter_map(Value::as_object_mut).for_each(|group| _ = group.remove("required"));
        // The defaults of a group are those of its settings, of which some depend on the machine.
        let all = schema["properties"].as_object_mut().expect("settings").values_mut();
        let groups = all.filter(|one| one.get("$ref").is_some()).filter_map(Value::as_object_mut);
        groups.for_each(|group| _ = group.remove("default"));
        let root = schema.as_object_mut().expect("an object");
        root.remove("required");
        root.remove("unevaluatedProperties");
        root.insert("additionalProperties".to_owned(), false.into());
        schema
    }

    /// Returns the reference of all settings, as a Markdown page.
    pub fn reference() -> String {
        let mut page = String::from(
            "# Settings\n\n\
             Made from the declarations of the settings by `iwol config --reference`; edit the declarations, not this page.\n\n\
             Defaults are those for 8 vehicles that do not steer; *steering* marks those of scenarios in which vehicles steer \
             (`presets/steering.toml`). N stands for the number of agents. A [profile](../guide/training.md#where-settings-come-from) replaces sizes \
             of rollouts and updates and the device. `iwol config` prints what a run would use and where each value comes from.\n\n## The run\n",
        );
        let steering = flatten(&STEERING.table());
        let run: Vec<Setting> = settings(&SCHEMA).filter(|setting| !setting.is_group()).collect();
        // Writing to a string cannot fail.
        let _ = table(&mut page, "", &run, &steering);
        for group in settings(&SCHEMA).filter(Setting::is_group) {
            let text = linked(group.described["description"].as_str().unwrap_or_default());
            let _ = writeln!(page, "\n## `{}`\n\n{text}", group.key);
            let inner: Vec<Setting> = settings(group.described).collect();
            let _ = table(&mut page, &format!("{}.", group.key), &inner, &steering);
        }
        page + &of_scenario()
    }
}

/// Returns the first number of a configuration that is outside its declared range, as the full name
/// of its setting and the allowed values; `None` if there is none.
pub(super) fn out_of_range(table: &Table) -> Option<(String, String)> {
    flatten(table).into_iter().find_map(|(key, value)| {
        let number = value.as_float().or_else(|| value.as_integer().map(|whole| whole as f64))?;
        let (group, name) = key.split_once('.').map_or((None, &*key), |(g, name)| (Some(g), name));
        let group = group.map_or(&*SCHEMA, |group| described(&SCHEMA["properties"][group]));
        let range = Range::of(group["properties"][name].as_object()?);
        (!range.contains(number)).then(|| (key.clone(), range.to_string()))
    })
}

/// Returns the section about the values in a scenario's file.
fn of_scenario() -> String {
    let mut elements: Vec<(&str, String, Vec<String>)> = Vec::new();
    for known in overridable() {
        let (name, folders) = known.path.split_last().expect("a name");
        let path = folders.join(".");
        let name = format!("`{name}`");
        match elements.last_mut().filter(|last| last.1 == path) {
            Some(last) => last.2.push(name),
            None => elements.push((&known.element.name, path, vec![name])),
        }
    }
    let rows = elements.into_iter().map(|(element, path, names)| {
        format!(
            "| `scenario.{path}` | {} | [`<{element}>`](scenario.md#{element}) |\n",
            names.join(", ")
        )
    });
    format!(
        "\n## `scenario`\n\n\
         Numbers, words and flags of the scenario's file, by the names of its elements and attributes, e.g. \
         `--set scenario.observation.detectionRange=50`. A value replaces the one in the file; `inf` stands for a limit that the file does not have. \
         Lists, names and files can be changed only in the scenario's file.\n\n\
         | group | settings | meaning and allowed values |\n|---|---|---|\n{}",
        rows.collect::<String>()
    )
}

/// Returns the full names of all settings.
pub(super) fn names() -> Vec<String> {
    let all = settings(&SCHEMA).flat_map(|setting| {
        let inner = settings(setting.described).map(|own| format!("{}.{}", setting.key, own.key));
        let inner: Vec<String> = if setting.is_group() { inner.collect() } else { Vec::new() };
        if inner.is_empty() { vec![setting.key.to_owned()] } else { inner }
    });
    all.collect()
}

/// Returns the values that a setting allows, in words.
pub(super) fn allowed(keys: &[&str]) -> Option<String> {
    Some(setting(keys)?.allowed())
}

/// Returns the default that a setting declares.
pub(super) fn default(keys: &[&str]) -> Option<toml::Value> {
    toml::Value::try_from(setting(keys)?.field.get("default")?).ok()
}

/// Returns the setting with this name, by the parts of the name.
fn setting(keys: &[&str]) -> Option<Setting<'static>> {
    let mut group: &'static Value = &SCHEMA;
    let mut found = None;
    for key in keys {
        let setting = settings(group).find(|setting| setting.key == *key)?;
        group = setting.described;
        found = Some(setting);
    }
    found
}

/// Returns what a schema refers to, or the schema itself.
fn described(schema: &Value) -> &Value {
    schema["$ref"]
        .as_str()
        .and_then(|path| SCHEMA.pointer(path.trim_start_matches('#')))
        .unwrap_or(schema)
}

/// A setting, or a group of settings.
struct Setting<'a> {
    key: &'a str,
    /// Schema of the field itself: documentation, default and range.
    field: &'a Map<String, Value>,
    /// What the field's type declares; without a type of its own, the same as `field`.
    described: &'a Value,
}

fn settings(group: &Value) -> impl Iterator<Item = Setting<'_>> {
    group["properties"].as_object().into_iter().flatten().filter_map(|(key, field)| {
        Some(Setting { key, field: field.as_object()?, described: described(field) })
    })
}

impl Setting<'_> {
    fn is_group(&self) -> bool {
        self.described["type"] == "object"
    }

    /// Returns the explanation without the unit, and the unit, which it contains in brackets.
    fn text(&self) -> (String, &str) {
        let text = self.field.get("description").and_then(Value::as_str).unwrap_or_default();
        let found = text.split_once(" \\[").and_then(|(before, rest)| {
            let (unit, after) = rest.split_once("\\]")?;
            Some((format!("{before}{after}"), unit))
        });
        let (mut text, unit) = found.unwrap_or((text.to_owned(), ""));
        for (word, meaning) in self.words().into_iter().filter(|(_, text)| !text.is_empty()) {
            // Writing to a string cannot fail.
            let _ = write!(text, " `{word}`: {meaning}");
        }
        (linked(&text), unit)
    }

    /// Returns the words that a setting with a list of words allows, each with its explanation.
    fn words(&self) -> Vec<(&str, &str)> {
        let all = self.described["oneOf"].as_array().into_iter().flatten();
        let explained = all.filter_map(|one| {
            Some((one["const"].as_str()?, one["description"].as_str().unwrap_or_default()))
        });
        let bare = self.described["enum"].as_array().into_iter().flatten();
        explained.chain(bare.filter_map(|word| Some((word.as_str()?, "")))).collect()
    }

    fn allowed(&self) -> String {
        let words: Vec<String> = self.words().iter().map(|(word, _)| format!("`{word}`")).collect();
        match self.field.get("type").and_then(Value::as_str) {
            _ if !words.is_empty() => words.join(", "),
            Some("boolean") => "`true`, `false`".to_owned(),
            Some("integer") => format!("whole number, {}", Range::of(self.field)),
            Some("number") => Range::of(self.field).to_string(),
            _ => "text".to_owned(),
        }
    }
}

/// Writes a table of settings whose full names begin with `prefix`; `steering` has the defaults of
/// scenarios in which vehicles steer.
fn table(
    page: &mut String,
    prefix: &str,
    settings: &[Setting<'_>],
    steering: &std::collections::BTreeMap<String, toml::Value>,
) -> std::fmt::Result {
    writeln!(page, "\n| setting | unit | allowed | default | meaning |\n|---|---|---|---|---|")?;
    for setting in settings {
        let key = format!("{prefix}{}", setting.key);
        let (text, unit) = setting.text();
        let default = match setting.field.get("default") {
            Some(Value::String(empty)) if empty.is_empty() => "none".to_owned(),
            Some(default) => {
                format!("`{}`", default.as_str().map_or_else(|| default.to_string(), str::to_owned))
            }
            None if key == "scenario" => "required".to_owned(),
            None => "the scenario's".to_owned(),
        };
        let other = steering.get(&key).map(|value| format!("; steering `{value}`"));
        let other = other.unwrap_or_default();
        writeln!(page, "| `{key}` | {unit} | {} | {default}{other} | {text} |", setting.allowed())?;
    }
    Ok(())
}

/// Returns a doc comment as Markdown in one line: with links to the pages that it names.
fn linked(text: &str) -> String {
    let text = text.replace('\n', " ").replace("[`", "`").replace("`]", "`").replace('|', "\\|");
    let mut parts = text.split("(docs/");
    let mut line = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let (page, rest) = part.split_once(')').unwrap_or((part, ""));
        let _ = write!(line, "([more](../{page})){rest}");
    }
    line
}

/// The numbers that a setting allows.
struct Range {
    least: Option<f64>,
    above: Option<f64>,
    most: Option<f64>,
    below: Option<f64>,
    multiple_of: Option<f64>,
    /// Whether infinity is allowed.
    infinite: bool,
}

impl Range {
    fn of(schema: &Map<String, Value>) -> Self {
        let number = |key: &str| schema.get(key).and_then(Value::as_f64);
        Self {
            least: number("minimum"),
            above: number("exclusiveMinimum"),
            most: number("maximum"),
            below: number("exclusiveMaximum"),
            multiple_of: number("multipleOf"),
            infinite: schema.contains_key("infinite"),
        }
    }

    fn contains(&self, number: f64) -> bool {
        (number.is_finite() || self.infinite && number == f64::INFINITY)
            && self.least.is_none_or(|least| number >= least)
            && self.above.is_none_or(|above| number > above)
            && self.most.is_none_or(|most| number <= most)
            && self.below.is_none_or(|below| number < below)
            && self.multiple_of.is_none_or(|step| number % step == 0.0)
    }
}

impl std::fmt::Display for Range {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let lower = self.above.map(|n| format!("above {n}")).or(self.least.map(|n| n.to_string()));
        let upper = self.below.map(|n| format!("below {n}")).or(self.most.map(|most| {
            // Large limits are powers of two.
            if most >= 1e9 { format!("2^{}", most.log2()) } else { most.to_string() }
        }));
        if let Some(step) = self.multiple_of {
            write!(f, "a multiple of {step}, ")?;
        }
        match (lower, upper) {
            (Some(lower), Some(upper)) if self.above.is_some() => write!(f, "{lower}, to {upper}"),
            (Some(lower), Some(upper)) => write!(f, "{lower} to {upper}"),
            (Some(above), None) if self.above.is_some() => f.write_str(&above),
            (Some(least), None) => write!(f, "{least} or more"),
            (None, Some(most)) => write!(f, "at most {most}"),
            (None, None) => f.write_str("a finite number"),
        }?;
        if self.infinite { f.write_str(", or inf") } else { Ok(()) }
    }
}
