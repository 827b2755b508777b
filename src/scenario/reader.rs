//! Reads elements and values of XML files. Every mistake becomes an error with its position.

use std::{cell::OnceCell, fmt::Display, path::Path};

use roxmltree::{Document, Node};

use super::schema::{self, Kind, MAX_NUMBER};
use super::{Error, Place};
use crate::markup;
use crate::sumo::net::{nearest, shorten, xml};

/// Largest file that is read \[bytes\].
pub(super) const MAX_BYTES: u64 = 4 << 20;

/// Namespace and names of the attributes that name the schema for editors.
const XSI: &str = "http://www.w3.org/2001/XMLSchema-instance";
const SCHEMA_LOCATION: [&str; 2] = ["noNamespaceSchemaLocation", "schemaLocation"];

/// Hint for missing elements and attributes.
const REFERENCE: &str = "`iwol scenario reference` prints all elements and attributes";

/// The XML of a scenario or route file, and the path of the file.
pub(super) struct Reader<'a, 'input> {
    pub(super) path: &'a Path,
    pub(super) document: &'a Document<'input>,
    /// Where each line begins. The document's own search begins anew for each position, which takes
    /// minutes in route files of many thousand vehicles.
    lines: OnceCell<Vec<usize>>,
}

/// Returns the text of a scenario or route file.
pub(super) fn text(path: &Path) -> Result<String, Error> {
    text_up_to(path, MAX_BYTES)
}

/// Returns the text of a file of at most `limit` bytes.
pub(super) fn text_up_to(path: &Path, limit: u64) -> Result<String, Error> {
    let text =
        markup::read(path, limit).map_err(|source| Error::Read { path: path.into(), source })?;
    text.ok_or_else(|| Error::TooLarge { path: path.into(), limit })
}

/// Parses the text of a file.
pub(super) fn document<'t>(text: &'t str, path: &Path) -> Result<Document<'t>, Error> {
    xml::parse(text).map_err(|(source, at)| Error::Parse {
        place: Place { path: path.into(), line: at.row, column: at.col },
        source,
    })
}

/// An element that the schema accepts.
pub(super) struct Element<'a, 'input> {
    pub(super) reader: &'a Reader<'a, 'input>,
    pub(super) node: Node<'a, 'input>,
    schema: &'static schema::Element,
}

impl<'a, 'input> Element<'a, 'input> {
    /// Returns the text of an attribute, or its default.
    pub(super) fn attribute(&self, name: &str) -> Option<&'a str> {
        self.node.attribute(name).or_else(|| self.schema.attribute(name)?.default.as_deref())
    }

    /// Returns the child elements called `name`.
    pub(super) fn children(&self, name: &str) -> impl Iterator<Item = Self> + use<'a, 'input> {
        let (reader, node, schema) = (self.reader, self.node, self.schema.child(name));
        schema.into_iter().flat_map(move |schema| {
            let nodes = node.children().filter(move |node| node.has_tag_name(schema.name.as_str()));
            nodes.map(move |node| Self { reader, node, schema })
        })
    }

    /// Returns the first child element called `name`.
    pub(super) fn child(&self, name: &str) -> Option<Self> {
        self.children(name).next()
    }

    /// Returns an error: the element lacks a `kind` (element or attribute) of this name.
    pub(super) fn lacks(&self, kind: &str, name: &str) -> Error {
        self.reader.missing(self.node, kind, name).hinted(REFERENCE)
    }

    /// Returns an error: the attribute has none of the values that the schema allows.
    pub(super) fn refuse(&self, name: &str) -> Error {
        let kind = self.schema.attribute(name).map(|known| &known.kind);
        let value = self.node.attribute(name).unwrap_or_default();
        let mut allowed = kind.map(|kind| kind.instead_of(value)).unwrap_or_default();
        if matches!(kind, Some(Kind::Number { .. } | Kind::List { .. })) {
            allowed += limit(value);
        }
        self.reader.value(self.node, name, allowed)
    }

    /// Checks the element and all elements in it against the schema.
    fn check(&self) -> Result<(), Error> {
        let Self { reader, node, schema } = self;
        reader.expect_attributes(*node, &names(&schema.attributes, |known| &known.name))?;
        let valid = names(&schema.children, |known| &known.name);
        reader.expect_children(*node, &valid, schema.is_text)?;
        for known in &schema.children {
            let mut found = node.children().filter(|child| child.has_tag_name(known.name.as_str()));
            if known.least > 0 && found.clone().next().is_none() {
                return Err(reader.missing(*node, "element", &known.name).hinted(REFERENCE));
            }
            if let Some(excess) = known.most.and_then(|most| found.nth(most)) {
                let name = &known.name;
                let message = match known.most {
                    Some(1) => format!("a second element <{name}>"),
                    most => format!("more than {} elements <{name}>", most.unwrap_or_default()),
                };
                return Err(reader.invalid(excess.range().start, message));
            }
        }
        for known in &schema.attributes {
            match node.attribute(known.name.as_str()) {
                None if known.required => {
                    return Err(reader.missing(*node, "attribute", &known.name).hinted(REFERENCE));
                }
                Some(text) if !known.kind.accepts(text) => return Err(self.refuse(&known.name)),
                _ => {}
            }
        }
        schema
            .children
            .iter()
            .flat_map(|known| self.children(&known.name))
            .try_for_each(|child| child.check())
    }
}

fn names<T>(list: &'static [T], name: impl Fn(&'static T) -> &'static String) -> Vec<&'static str> {
    list.iter().map(|known| name(known).as_str()).collect()
}

impl<'a, 'input> Reader<'a, 'input> {
    pub(super) fn new(path: &'a Path, document: &'a Document<'input>) -> Self {
        Self { path, document, lines: OnceCell::new() }
    }

    /// Returns the root element after checking the whole document against the schema.
    pub(super) fn root(&'a self) -> Result<Element<'a, 'input>, Error> {
        let (node, schema) = (self.document.root_element(), schema::describe());
        self.expect_root(node, &[&schema.name])?;
        let root = Element { reader: self, node, schema };
        root.check().map(|()| root)
    }

    /// Checks the name of the root element.
    pub(super) fn expect_root(&self, root: Node, valid: &[&'static str]) -> Result<(), Error> {
        if valid.iter().any(|&name| root.has_tag_name(name)) {
            return Ok(());
        }
        Err(self.unknown(root, "element", root.tag_name().name(), "the file".into(), valid))
    }

    /// Checks that an element has only the given child elements and, unless `text` is allowed, no
    /// text.
    pub(super) fn expect_children(
        &self,
        node: Node,
        valid: &[&'static str],
        text: bool,
    ) -> Result<(), Error> {
        let parent = || format!("<{}>", node.tag_name().name());
        for child in node.children() {
            let name = child.tag_name().name();
            if child.is_element() && !valid.iter().any(|&known| child.has_tag_name(known)) {
                return Err(self.unknown(child, "element", name, parent(), valid));
            }
            let content = child.text().map(str::trim).filter(|text| !text.is_empty());
            if let Some(content) = content.filter(|_| child.is_text() && !text) {
                return Err(self.unknown(child, "text", content, parent(), &[]));
            }
        }
        Ok(())
    }

    /// Checks that an element has only the given attributes.
    pub(super) fn expect_attributes(
        &self,
        node: Node,
        valid: &[&'static str],
    ) -> Result<(), Error> {
        let unknown = node.attributes().find(|a| match a.namespace() {
            None => !valid.contains(&a.name()),
            Some(namespace) => namespace != XSI || !SCHEMA_LOCATION.contains(&a.name()),
        });
        let Some(attribute) = unknown else { return Ok(()) };
        Err(Error::Unknown {
            place: self.at(attribute.range().start),
            kind: "attribute",
            key: shorten(attribute.name()),
            parent: format!("<{}>", node.tag_name().name()),
            nearest: nearest(attribute.name(), valid.iter().copied()),
            valid: valid.to_vec(),
        })
    }

    pub(super) fn text<'n>(&self, node: Node<'n, '_>, key: &str) -> Result<&'n str, Error> {
        node.attribute(key).ok_or_else(|| self.missing(node, "attribute", key))
    }

    pub(super) fn number(
        &self,
        node: Node,
        key: &str,
        allowed: &str,
        valid: impl Fn(f64) -> bool,
    ) -> Result<f64, Error> {
        let text = self.text(node, key)?;
        let number = finite(text).filter(|&v| valid(v));
        number.ok_or_else(|| self.value(node, key, format!("{allowed}{}", limit(text))))
    }

    /// Returns the place of a byte offset.
    pub(super) fn at(&self, offset: usize) -> Place {
        let text = self.document.input_text();
        let lines = self.lines.get_or_init(|| {
            let ends = text.bytes().zip(1..).filter(|(byte, _)| *byte == b'\n');
            std::iter::once(0).chain(ends.map(|(_, next)| next)).collect()
        });
        let line = lines.partition_point(|start| *start <= offset);
        let before = text.get(lines[line - 1]..offset).unwrap_or_default();
        let column = before.chars().count() as u32 + 1;
        Place { path: self.path.into(), line: line as u32, column }
    }

    /// Returns the place of an attribute, or of its element if the attribute is missing.
    pub(super) fn place(&self, node: Node, key: &str) -> Place {
        self.at(node.attribute_node(key).map_or(node.range().start, |a| a.range().start))
    }

    pub(super) fn unknown(
        &self,
        node: Node,
        kind: &'static str,
        key: &str,
        parent: String,
        valid: &[&'static str],
    ) -> Error {
        Error::Unknown {
            place: self.at(node.range().start),
            kind,
            key: shorten(key),
            parent,
            nearest: nearest(key, valid.iter().copied()),
            valid: valid.to_vec(),
        }
    }

    /// Returns all elements called `name` in document order.
    pub(super) fn all(&self, name: &'static str) -> impl Iterator<Item = Node<'a, 'input>> {
        self.document.descendants().filter(move |node| node.has_tag_name(name))
    }

    /// Returns the place of an attribute of the first element called `name`.
    pub(super) fn place_in(&self, name: &'static str, key: &str) -> Place {
        self.all(name).next().map_or_else(|| self.at(0), |node| self.place(node, key))
    }

    pub(super) fn invalid(&self, offset: usize, message: String) -> Error {
        Error::Invalid { place: self.at(offset), message, hint: None }
    }

    pub(super) fn missing(&self, node: Node, kind: &str, key: &str) -> Error {
        let parent = node.tag_name().name();
        self.invalid(node.range().start, format!("<{parent}> lacks the {kind} `{key}`"))
    }

    pub(super) fn duplicate(&self, node: Node, what: &str) -> Error {
        let id = shorten(node.attribute("id").unwrap_or_default());
        let message = format!("a second {what} with the id `{id}`");
        Error::Invalid { place: self.place(node, "id"), message, hint: None }
    }

    /// Returns an error: an attribute has a value that is not allowed.
    pub(super) fn value(&self, node: Node, key: &str, allowed: impl Display) -> Error {
        let value = node.attribute(key).unwrap_or_default();
        Error::value(self.place(node, key), node.tag_name().name(), key, value, allowed)
    }
}

/// Returns the limit of all numbers, in words, if one of the numbers in a text is beyond it.
fn limit(text: &str) -> &'static str {
    let beyond = |word: &str| word.parse::<f64>().is_ok_and(|v| v.abs() > MAX_NUMBER);
    if text.split_whitespace().any(beyond) { ", at most 1e9 in magnitude" } else { "" }
}

pub(super) fn finite(text: &str) -> Option<f64> {
    text.trim().parse::<f64>().ok().filter(|v| v.abs() <= MAX_NUMBER)
}
