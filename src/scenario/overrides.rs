//! Other values for attributes of a scenario. A run may override every number, word and flag of an
//! element that occurs once; lists and files can be changed only in the scenario's file.

use std::ops::Range;
use std::path::{Path, PathBuf};

use roxmltree::{Document, Node};

use super::error::invalid;
use super::reader::{document, text};
use super::schema::{Attribute, Element, Kind, describe};
use super::{Error, Scenario};
use crate::markup::escape_attribute;

/// Element whose numbers cannot be overridden: how many agents there are is a choice of each run,
/// and which numbers are possible follows from the nets.
const AGENTS: &str = "agents";
/// Attribute that cannot be overridden, because it repeats whether there is an element
/// `<steering>`.
const MODE: &str = "mode";

/// An attribute that a run may override.
#[derive(Debug, Clone)]
pub struct Overridable {
    /// Names of the elements within `<scenario>`, and of the attribute.
    pub path: Vec<&'static str>,
    /// The element.
    pub element: &'static Element,
    /// The attribute.
    pub attribute: &'static Attribute,
}

/// Returns the attributes that a run may override, in the order of the schema.
pub fn overridable() -> Vec<Overridable> {
    fn collect(element: &'static Element, path: &[&'static str], out: &mut Vec<Overridable>) {
        let attributes = element.attributes.iter().filter(|a| a.is_overridable());
        out.extend(attributes.map(|attribute| Overridable {
            path: [path, &[attribute.name.as_str()]].concat(),
            element,
            attribute,
        }));
        for child in element.children.iter().filter(|child| child.most == Some(1)) {
            if child.name != AGENTS {
                collect(child, &[path, &[child.name.as_str()]].concat(), out);
            }
        }
    }
    let mut all = Vec::new();
    collect(describe(), &[], &mut all);
    all
}

/// Returns why a run cannot override what `path` names in the schema; `None` if the schema has
/// nothing of this name.
pub fn cannot_override(path: &[&str]) -> Option<String> {
    let (mut element, mut is_element) = (describe(), true);
    for (depth, name) in path.iter().enumerate() {
        match element.child(name) {
            Some(child) => element = child,
            None if depth + 1 == path.len() => {
                element.attribute(name)?;
                is_element = false;
            }
            None => return None,
        }
    }
    let all = overridable();
    let own = all.iter().filter(|known| known.element.name == element.name);
    let names: Vec<&str> = own.map(|known| known.attribute.name.as_str()).collect();
    Some(match names[..] {
        _ if path[0] == AGENTS => {
            "only the scenario's file can set it; the number of agents is the setting `agents`".into()
        }
        [] => "only the scenario's file can set lists, names and files; a run can override numbers, words and flags".into(),
        _ if is_element || path.last().is_some_and(|last| names.contains(last)) => {
            format!("the scenario has no element <{}>", element.name)
        }
        _ => format!(
            "only the scenario's file can set lists, names and files; of <{}>, a run can override {}",
            element.name,
            names.join(", ")
        ),
    })
}

impl Attribute {
    fn is_overridable(&self) -> bool {
        self.name != MODE && matches!(self.kind, Kind::Number { .. } | Kind::Choice(_))
    }
}

impl Overridable {
    /// Returns why the attribute cannot have a value, as for the same value in the file; `None` if
    /// it can.
    pub fn refusal(&self, value: &str) -> Option<String> {
        let kind = &self.attribute.kind;
        let refuse =
            || invalid(&self.element.name, &self.attribute.name, value, kind.instead_of(value));
        (!kind.accepts(value)).then(refuse)
    }
}

/// A scenario file of which some attributes may get other values.
#[derive(Debug)]
pub struct ScenarioFile {
    /// The text, in which optional elements that change nothing are present.
    text: String,
    /// The scenario as the file describes it, not checked against its nets.
    pub scenario: Scenario,
}

/// Another value for an attribute.
#[derive(Debug, Clone)]
pub struct Override {
    /// Names of the elements within `<scenario>`, and of the attribute.
    pub path: Vec<&'static str>,
    /// The text, or `None` if the attribute is to be left out.
    pub text: Option<String>,
}

/// Error of a scenario with overrides.
#[derive(Debug)]
pub struct Refused {
    /// Index of the override whose value is refused; `None` if the error is elsewhere in the file.
    pub index: Option<usize>,
    /// The error. Its position is that in the file.
    pub error: Error,
}

/// A part of the text that another text replaces.
struct Edit {
    index: usize,
    range: Range<usize>,
    text: String,
    /// Offset of the new text in the result.
    at: usize,
}

impl ScenarioFile {
    /// Reads a scenario file without its nets.
    ///
    /// # Errors
    /// As [`Scenario::read`].
    pub fn read(path: &Path) -> Result<Self, Error> {
        let mut text = text(path)?;
        let scenario = Scenario::parse(&text, path)?;
        let root = describe();
        for element in root.children.iter().filter(|child| child.least == 0) {
            let document = document(&text, path)?;
            let root = document.root_element();
            let missing = child(root, &element.name).is_none();
            let end = text[..root.range().end].rfind("</").filter(|_| missing);
            let Some(end) = end else { continue };
            let more = format!("{}<{}/>{}", &text[..end], element.name, &text[end..]);
            // An element whose absence means something stays absent.
            if Scenario::parse(&more, path).is_ok_and(|same| same == scenario) {
                text = more;
            }
        }
        Ok(Self { text, scenario })
    }

    fn path(&self) -> &PathBuf {
        &self.scenario.path
    }

    /// Returns the attributes that a run may override, each with its text in the file or its
    /// default; `None` if it has neither.
    pub fn values(&self) -> Vec<(Overridable, Option<String>)> {
        let Ok(document) = document(&self.text, self.path()) else { return Vec::new() };
        let value = |known: Overridable| {
            let own = find(document.root_element(), &known.path)?.attribute(*known.path.last()?);
            let text = own.map(str::to_owned).or_else(|| known.attribute.default.clone());
            Some((known, text))
        };
        overridable().into_iter().filter_map(value).collect()
    }

    /// Returns the scenario with other values of some attributes, after checking it against its
    /// nets.
    ///
    /// # Errors
    /// As [`Scenario::load`].
    pub fn load(&self, overrides: &[Override]) -> Result<Scenario, Refused> {
        let elsewhere = |error| Refused { index: None, error };
        let original = document(&self.text, self.path()).map_err(elsewhere)?;
        let edits =
            overrides.iter().enumerate().filter_map(|(index, o)| Edit::of(index, o, &original));
        let mut edits: Vec<Edit> = edits.collect();
        edits.sort_by_key(|edit| edit.range.start);
        let (mut edited, mut end) = (String::new(), 0);
        for edit in &mut edits {
            edited += &self.text[end..edit.range.start];
            edit.at = edited.len();
            edited += &edit.text;
            end = edit.range.end;
        }
        edited += &self.text[end..];
        Scenario::load_text(&edited, self.path()).map_err(|mut error| {
            let path = self.path();
            let Some(place) = error.place_mut().filter(|place| place.path == *path) else {
                return elsewhere(error);
            };
            let at = offset(&edited, place.line, place.column);
            let inside = |edit: &&Edit| (edit.at..edit.at + edit.text.len()).contains(&at);
            let index = edits.iter().find(inside).map(|edit| edit.index);
            let before = edits.iter().filter(|edit| edit.at + edit.text.len() <= at);
            let moved: isize =
                before.map(|edit| edit.text.len() as isize - edit.range.len() as isize).sum();
            let at = original.text_pos_at(at.saturating_add_signed(-moved));
            (place.line, place.column) = (at.row, at.col);
            Refused { index, error }
        })
    }
}

impl Edit {
    /// Returns the edit that gives an attribute its other value; `None` if there is nothing to do.
    fn of(index: usize, wanted: &Override, document: &Document) -> Option<Self> {
        let node = find(document.root_element(), &wanted.path)?;
        let name = wanted.path.last()?;
        let new = wanted.text.as_ref().map(|text| format!("{name}=\"{}\"", escape_attribute(text)));
        let (range, text) = match (node.attribute_node(*name), new) {
            (Some(own), new) => (own.range(), new.unwrap_or_default()),
            (None, Some(new)) => {
                let end = node.range().start + 1 + node.tag_name().name().len();
                (end..end, format!(" {new}"))
            }
            (None, None) => return None,
        };
        Some(Self { index, range, text, at: 0 })
    }
}

/// Returns the element of the attribute that `path` names.
fn find<'a, 'input>(root: Node<'a, 'input>, path: &[&str]) -> Option<Node<'a, 'input>> {
    let (_, elements) = path.split_last()?;
    elements.iter().try_fold(root, |node, name| child(node, name))
}

fn child<'a, 'input>(node: Node<'a, 'input>, name: &str) -> Option<Node<'a, 'input>> {
    node.children().find(|child| child.has_tag_name(name))
}

/// Returns the byte offset of a line and column, both from 1.
fn offset(text: &str, line: u32, column: u32) -> usize {
    let mut lines = text.split_inclusive('\n');
    let start: usize = lines.by_ref().take(line.saturating_sub(1) as usize).map(str::len).sum();
    let rest = lines.next().unwrap_or_default();
    let column = column.saturating_sub(1) as usize;
    start + rest.char_indices().nth(column).map_or(rest.len(), |(at, _)| at)
}
