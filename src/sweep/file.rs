//! The format of a sweep file, and the cells that it describes.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use toml::{Table, Value};

use super::cell::check_order;
use super::conditions::{self, holds, listed};
use super::distinct::{check_distinct, check_seeds};
use super::{Cell, Contrast, Error, Evaluate, Reference, base, combinations, label, value_of};
use crate::config::{
    self, Config, Document, Layers, Resolution, TaskSource, flatten, full_name,
    no_matter_of_evaluation, plain,
};
use crate::metrics::{self, Shown};

/// A sweep file as it is written, merged with its base.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct File {
    /// The sweep file that this file is based on.
    #[serde(default)]
    base: Option<String>,
    /// Whether the rules, the skips and the evaluations are those of the base.
    #[serde(skip)]
    inherited: [bool; 3],
    #[serde(default)]
    pub(super) title: String,
    #[serde(default)]
    settings: Table,
    #[serde(default)]
    pub(super) grid: Table,
    #[serde(default)]
    rule: Vec<Rule>,
    #[serde(default)]
    skip: Vec<Skip>,
    #[serde(default)]
    pub(super) evaluate: Vec<Evaluate>,
    #[serde(default)]
    pub(super) reference: Vec<Reference>,
    #[serde(default)]
    pub(super) contrast: Vec<Contrast>,
}

/// Settings for the cells that match.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Rule {
    when: Table,
    set: Table,
}

/// Combinations of the grid that are left out.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Skip {
    when: Table,
}

impl File {
    /// Parses the text of `file` with its base, and checks everything that does not depend on the
    /// cells.
    pub(super) fn read(text: &str, file: &str) -> Result<Self, Error> {
        let mut parsed: Self = base::resolve(text, Path::new(file))?;
        if let Ok(own) = toml::from_str::<Self>(text) {
            let lists = [own.rule.is_empty(), own.skip.is_empty(), own.evaluate.is_empty()];
            parsed.inherited = lists.map(|empty| empty && own.base.is_some());
            own.check_settings().map_err(|message| wrong(file, message))?;
        }
        if parsed.evaluate.is_empty() {
            parsed.evaluate.push(toml::from_str("").expect("everything has a default"));
        }
        let checked = parsed
            .check_grid()
            .and_then(|()| parsed.check_evaluations())
            .and_then(|()| parsed.check_results())
            .and_then(|()| parsed.check_references())
            .and_then(|()| parsed.contrast.iter().try_for_each(|c| c.check(&parsed.evaluate)));
        checked.map_err(|message| wrong(file, message))?;
        Ok(parsed)
    }

    /// Checks that no setting of this file alone is a key of its grid as well: the cells would have
    /// the values of the grid.
    fn check_settings(&self) -> Result<(), String> {
        let twice = flatten(&self.settings).into_keys().find(|key| self.varies(key));
        twice.map_or(Ok(()), |key| {
            Err(format!(
                "[settings] {key} has no effect, because each cell has the value of the grid; remove {key} from [settings] or from [grid]"
            ))
        })
    }

    fn check_grid(&self) -> Result<(), String> {
        if self.grid.is_empty() {
            return Err(
                "there is no [grid]; give it a list of values, e.g. seed = [0, 1, 2]".to_owned()
            );
        }
        let Some((key, value)) =
            self.grid.iter().find(|(_, value)| value.as_array().is_none_or(Vec::is_empty))
        else {
            return Ok(());
        };
        if let Value::Table(table) = value
            && let Some((inner, value)) = flatten(table).into_iter().next()
        {
            return Err(format!(
                "[grid.{key}]: write the whole name of the setting in [grid]: \"{key}.{inner}\" = {value}"
            ));
        }
        let example = if value.is_array() { "…".to_owned() } else { value.to_string() };
        Err(format!("[grid] {key}: give a list of values, e.g. {key} = [{example}]"))
    }

    /// Checks that each evaluation has a file of its own for its result.
    fn check_results(&self) -> Result<(), String> {
        let mut known: BTreeMap<String, &str> = BTreeMap::new();
        for evaluate in &self.evaluate {
            for combination in evaluate.combinations() {
                let result = evaluate.result(&combination);
                if let Some(other) = known.insert(result.clone(), &evaluate.name) {
                    return Err(format!(
                        "[[evaluate]] `{}` and `{other}` both write {result}; give one of them another `name`",
                        evaluate.name
                    ));
                }
            }
        }
        Ok(())
    }

    fn check_evaluations(&self) -> Result<(), String> {
        for (i, evaluate) in self.evaluate.iter().enumerate() {
            let name = &evaluate.name;
            if self.evaluate[..i].iter().any(|other| other.name == *name) {
                return Err(format!(
                    "two evaluations have the name `{name}`; give each its own `name`"
                ));
            }
            if name == "learning_curves" {
                return Err(format!(
                    "[[evaluate]] `{name}`: the report has a figure of this name; choose another"
                ));
            }
            if name.is_empty() || name.contains(['/', ' ']) || evaluate.episodes == 0 {
                return Err(format!(
                    "[[evaluate]] `{name}`: allowed: a name without spaces and slashes, because it is part of a file name, and 1 or more episodes"
                ));
            }
            if let Some((key, _)) =
                evaluate.grid.iter().find(|(_, v)| v.as_array().is_none_or(Vec::is_empty))
            {
                return Err(format!(
                    "[[evaluate]] `{name}`, grid: give a list of values for {key}"
                ));
            }
            for (what, key) in [("x", &evaluate.x), ("panels", &evaluate.panels)] {
                let Some(key) = key else { continue };
                // The seeds of a place are one row.
                let several = |table: &Table| {
                    let count = table.get(key).and_then(Value::as_array).map_or(0, Vec::len);
                    count > 1 && key != "seed"
                };
                if !several(&self.grid) && !several(&evaluate.grid) || evaluate.x == evaluate.panels
                {
                    return Err(format!(
                        "[[evaluate]] `{name}`: {what} = \"{key}\" must be a key with several values in a grid, other than seed, and x and panels must differ"
                    ));
                }
            }
        }
        Ok(())
    }

    /// Checks that conditions name values of the grid, and that no rule sets a key of the grid. A
    /// file may narrow the grid to which the conditions of its base refer: they are not checked.
    fn check_conditions(&self) -> Result<(), String> {
        let of = |what: String, when: &Table| {
            conditions::check_values(when, &self.grid).map_err(|why| format!("{what}: {why}"))
        };
        let [rules, skips, evaluations] = self.inherited;
        for (i, rule) in self.rule.iter().enumerate().filter(|_| !rules) {
            let name = format!("[[rule]] number {}", i + 1);
            let twice = flatten(&rule.set).into_keys().find(|key| self.varies(key));
            if let Some(key) = twice {
                return Err(format!(
                    "{name} sets {key}, which has no effect, because each cell has the value of the grid; remove {key} from `set` or from [grid]"
                ));
            }
            of(name, &rule.when)?;
        }
        for (i, skip) in self.skip.iter().enumerate().filter(|_| !skips) {
            of(format!("[[skip]] number {}", i + 1), &skip.when)?;
        }
        let mut all = self.evaluate.iter().filter(|_| !evaluations);
        all.try_for_each(|evaluate| of(format!("[[evaluate]] `{}`", evaluate.name), &evaluate.when))
    }

    /// Whether the grid has a list of values for the setting `key`.
    fn varies(&self, key: &str) -> bool {
        self.grid.keys().any(|own| full_name(own) == full_name(key))
    }

    fn check_references(&self) -> Result<(), String> {
        for (i, reference) in self.reference.iter().enumerate() {
            let Reference { label, beside, metric, x, y, evaluate } = reference;
            let is_same = |other: &Reference| {
                (&other.label, &other.beside, &other.metric, &other.evaluate)
                    == (label, beside, metric, evaluate)
            };
            if y.is_empty() || self.reference[..i].iter().any(is_same) {
                return Err(format!(
                    "[[reference]] `{label}`: give its values of {metric} in one entry, with at least one y"
                ));
            }
            let named = |name: &String| self.evaluate.iter().find(|e| e.name == *name);
            let of = evaluate.as_ref().map_or(self.evaluate.first(), named);
            let known = of.is_some();
            let values = of.and_then(|of| self.axis(of)).unwrap_or_default();
            let alone = x.is_empty() && y.len() == 1 && values.len() < 2;
            if !alone && x.len() != y.len() {
                return Err(format!(
                    "[[reference]] `{label}`: give as many values of x as of y; x has {}, y has {}",
                    x.len(),
                    y.len()
                ));
            }
            if values.is_empty() && !x.is_empty() {
                return Err(format!(
                    "[[reference]] `{label}`: the evaluation has no horizontal axis; leave x out"
                ));
            }
            if let Some(other) = x.iter().find(|x| !values.iter().any(|value| same(value, x))) {
                let all: Vec<String> = values.iter().map(plain).collect();
                return Err(format!(
                    "[[reference]] `{label}`: x has {}, which the horizontal axis has not ({})",
                    plain(other),
                    all.join(", ")
                ));
            }
            let all = || metrics::shown(Shown::InTables).chain(metrics::of_environments());
            let reported = || all().map(|metric| metric.id);
            if !known || !reported().any(|id| id == *metric) {
                return Err(format!(
                    "[[reference]] `{label}`: metric must be one of {}, and evaluate the name of an evaluation",
                    reported().collect::<Vec<_>>().join(", ")
                ));
            }
            let (least, most) =
                metrics::named(metric).map_or((f64::MIN, f64::MAX), |m| m.scale.bounds);
            if let Some(wrong) = y.iter().find(|y| !(least..=most).contains(*y)) {
                return Err(format!(
                    "[[reference]] `{label}`: y has {wrong}, and values of {metric} lie between {least} and {most}, as in the JSON of `iwol evaluate`"
                ));
            }
        }
        Ok(())
    }

    /// Returns the values along the horizontal axis of an evaluation; `None` without an axis.
    fn axis(&self, of: &Evaluate) -> Option<Vec<Value>> {
        let several = |key: &&String| self.grid[*key].as_array().is_some_and(|all| all.len() > 1);
        let varying = || self.grid.keys().filter(several).filter(|key| *key != "seed");
        let own: Vec<&String> = of.grid.keys().collect();
        let chosen = match (&of.x, &own[..]) {
            (Some(x), _) => Some(x),
            (None, [only]) => Some(*only),
            _ => varying()
                .chain(own.iter().copied())
                .find(|key| *key == "agents")
                .or_else(|| varying().chain(own).find(|key| *key != "algorithm")),
        };
        let values = of.grid.get(chosen?).or_else(|| self.grid.get(chosen?))?;
        values.as_array().cloned()
    }

    /// Returns the cells of this file. Messages call the file `file`; the cells' folders lie in
    /// `folder`.
    pub(super) fn cells(&self, file: &str, folder: &Path) -> Result<Vec<Cell>, Error> {
        let kept = self.combinations().map_err(|message| wrong(file, message))?;
        let mut matched = vec![false; self.rule.len()];
        let mut fingerprints = BTreeMap::new();
        let mut cells = Vec::new();
        for values in kept {
            let settings = settings_of(&self.settings, &self.rule, &values, &mut matched);
            cells.push(self.cell(values, settings, file, folder, &mut fingerprints)?);
        }
        self.check_conditions()
            .and_then(|()| self.check_used(&cells, &matched))
            .and_then(|()| check_order(&cells))
            .and_then(|()| {
                let mut all = self.contrast.iter();
                all.try_for_each(|contrast| contrast.check_cells(&cells, &self.evaluate))
            })
            .map_err(|message| wrong(file, message))?;
        cells.sort_by_key(|cell| cell.config.seed);
        let alike = |(i, cell): &(usize, &Cell)| cells[..*i].iter().any(|one| one.id == cell.id);
        if let Some((_, twice)) = cells.iter().enumerate().find(alike) {
            return Err(wrong(file, format!("[grid]: two cells are called {}", twice.id)));
        }
        check_distinct(&cells)
            .and_then(|()| check_seeds(&cells))
            .map_err(|message| wrong(file, message))?;
        Ok(cells)
    }

    /// Returns the combinations of the grid without those that a `[[skip]]` leaves out.
    fn combinations(&self) -> Result<Vec<Vec<(String, Value)>>, String> {
        let left_out = |skip: &Skip, values: &[(String, Value)]| {
            holds(&skip.when, |key| value_of(values, key))
        };
        let (skipped, kept): (Vec<_>, Vec<_>) = combinations(&self.grid)
            .into_iter()
            .partition(|values| self.skip.iter().any(|skip| left_out(skip, values)));
        let unused = |skip: &&Skip| !skipped.iter().any(|values| left_out(skip, values));
        match self.skip.iter().find(unused).filter(|_| !self.inherited[1]) {
            Some(skip) => Err(format!("[[skip]]: no combination has {}", listed(&skip.when))),
            None if kept.is_empty() => Err("[[skip]] leaves no cell".to_owned()),
            None => Ok(kept),
        }
    }

    fn cell(
        &self,
        values: Vec<(String, Value)>,
        mut settings: Table,
        file: &str,
        folder: &Path,
        fingerprints: &mut BTreeMap<PathBuf, String>,
    ) -> Result<Cell, Error> {
        let id = cell_id(&values);
        let place = format!("{file}, cell {id}");
        let mut after = None;
        if let Some(Value::Table(change)) = settings.get("init_from") {
            let other = other_cell(&self.grid, &values, change)
                .map_err(|message| wrong(file, format!("cell {id}: {message}")))?;
            let folder = folder.join(&other).display().to_string();
            settings.insert("init_from".to_owned(), Value::String(folder));
            after = Some(other);
        }
        let document = Document::of_table("its settings".to_owned(), &settings);
        let layers = Layers { document, ..Layers::default() };
        let resolve = |layers: &Layers| {
            layers.resolve().map_err(|source| Error::Cell { place: place.clone(), source })
        };
        let Resolution { config, place: task, .. } = resolve(&layers)?;
        let varied = values.iter().map(|(key, _)| key).filter(|key| self.varies(key));
        let mut idle = varied.filter_map(|key| Some((key, config::idle(key, task.scenario()?)?)));
        if let Some((key, why)) = idle.next() {
            return Err(wrong(
                file,
                format!(
                    "[grid] {key} has no effect in cell {id}, because {why}; leave it out, or change the other value"
                ),
            ));
        }
        let mut fingerprint = |config: &Config, task: &TaskSource| {
            let known = config.scenario.file.join(&config.environment);
            fingerprints.entry(known).or_insert_with(|| task.fingerprint()).clone()
        };
        let of_training = fingerprint(&config, &task);
        if let Some(why) = config.cannot_be_trained() {
            return Err(wrong(file, format!("cell {id}: {why}")));
        }
        let mut cell = Cell {
            folder: folder.join(&id),
            id,
            values,
            config,
            fingerprint: of_training,
            evaluated: BTreeMap::new(),
            after,
        };
        // Errors in an evaluation are reported now, not after the training.
        let applying = self.evaluate.iter().filter(|evaluate| evaluate.applies(&cell));
        for evaluate in applying.collect::<Vec<_>>() {
            for combination in evaluate.combinations() {
                let sets = evaluate.sets(&combination);
                let useless = sets.iter().find_map(|set| no_matter_of_evaluation(set));
                let asked = resolve(&Layers { sets: sets.clone(), ..layers.clone() })?;
                let Resolution { config: asked, place: task, .. } = asked;
                cell.evaluated.insert(sets, fingerprint(&asked, &task));
                if let Some(why) = useless.or_else(|| cell.config.cannot_serve(&asked)) {
                    return Err(wrong(
                        file,
                        format!(
                            "[[evaluate]] `{}`, cell {}: {why}; select the cells of this evaluation with `when`",
                            evaluate.name, cell.id
                        ),
                    ));
                }
            }
        }
        Ok(cell)
    }

    /// Checks that every rule and every evaluation of this file applies to at least one cell;
    /// `matched` says so for the rules. Those of its base may be for values that this file leaves
    /// out of the grid.
    fn check_used(&self, cells: &[Cell], matched: &[bool]) -> Result<(), String> {
        let [rules, _, evaluations] = self.inherited;
        if let Some(rule) = matched.iter().position(|matched| !matched && !rules) {
            return Err(format!(
                "[[rule]] number {}: no cell has {}",
                rule + 1,
                listed(&self.rule[rule].when)
            ));
        }
        let unused = |evaluate: &&Evaluate| !cells.iter().any(|cell| evaluate.applies(cell));
        match self.evaluate.iter().filter(|_| !evaluations).find(unused) {
            Some(unused) => {
                Err(format!("[[evaluate]] `{}`: no cell has {}", unused.name, listed(&unused.when)))
            }
            None => Ok(()),
        }
    }
}

/// Returns whether two values are the same, numbers by their size.
fn same(a: &Value, b: &Value) -> bool {
    let number = |value: &Value| value.as_float().or_else(|| Some(value.as_integer()? as f64));
    a == b || number(a).is_some_and(|a| number(b) == Some(a))
}

fn wrong(file: &str, message: String) -> Error {
    Error::Content { file: file.to_owned(), message }
}

/// Returns the id of the cell whose policy another cell starts with: the cell that differs in the
/// keys of `change`.
fn other_cell(grid: &Table, values: &[(String, Value)], change: &Table) -> Result<String, String> {
    let change = flatten(change);
    for (key, wanted) in &change {
        let all = grid.get(key).and_then(Value::as_array);
        if all.is_none_or(|all| !all.contains(wanted)) {
            return Err(format!("init_from = {{ {key} = {wanted} }}: the grid has no such cell"));
        }
    }
    let other: Vec<(String, Value)> = values
        .iter()
        .map(|(key, own)| (key.clone(), change.get(key).unwrap_or(own).clone()))
        .collect();
    if other == values {
        return Err(
            "init_from names the cell itself; select the cells that use it with a [[rule]]"
                .to_owned(),
        );
    }
    Ok(cell_id(&other))
}

/// Merges the common settings, the cell's own values, and the settings of the matching rules in
/// their order.
fn settings_of(
    common: &Table,
    rules: &[Rule],
    values: &[(String, Value)],
    matched: &mut [bool],
) -> Table {
    let mut flat = flatten(common);
    flat.extend(values.iter().map(|(key, value)| (full_name(key).to_owned(), value.clone())));
    for (rule, matched) in rules.iter().zip(matched) {
        if holds(&rule.when, |key| flat.get(full_name(key))) {
            *matched = true;
            let mut set = flatten(&rule.set);
            // Values of the grid take precedence over rules, because the cell's name contains them.
            set.retain(|key, _| !values.iter().any(|(own, _)| full_name(own) == key));
            flat.extend(set);
        }
    }
    let mut nested = Table::new();
    for (key, value) in flat {
        let mut here = &mut nested;
        let mut parts = key.split('.').peekable();
        while let Some(part) = parts.next() {
            if parts.peek().is_none() {
                here.insert(part.to_owned(), value.clone());
                break;
            }
            let inner = here.entry(part.to_owned()).or_insert_with(|| Value::Table(Table::new()));
            match inner {
                Value::Table(table) => here = table,
                // A value where a table is expected: the configuration reports this error.
                _ => break,
            }
        }
    }
    nested
}

/// Returns the folder of a cell, relative to the sweep's folder: the values of the grid, then the
/// seed.
fn cell_id(values: &[(String, Value)]) -> String {
    let (seed, others): (Vec<_>, Vec<_>) =
        values.iter().cloned().partition(|(key, _)| key == "seed");
    let parts = [label(&others), label(&seed).replace('=', "_")];
    let parts: Vec<&str> =
        parts.iter().map(String::as_str).filter(|part| !part.is_empty()).collect();
    if parts.is_empty() { "run".to_owned() } else { parts.join("/") }
}
