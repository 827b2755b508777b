//! Reads elements and values of a scenario's XML. Every mistake becomes an error with its position.

use std::{fmt::Display, path::Path};

use roxmltree::{Attribute, Document, Node};

use super::Error;
use crate::sumo::net::{nearest, shorten, xml};

/// Largest magnitude of a number in a scenario, which keeps sums and products finite.
const MAX_NUMBER: f64 = 1e9;

/// Namespace of `xsi:noNamespaceSchemaLocation`, which names the schema for editors.
const XSI: &str = "http://www.w3.org/2001/XMLSchema-instance";

/// Names that are valid at one place of a file.
pub(super) type Names = &'static [&'static str];

/// The XML of a scenario or route file, and the path of the file.
pub(super) struct Reader<'a, 'input> {
    pub(super) path: &'a Path,
    pub(super) document: &'a Document<'input>,
}

/// Parses the text of a file.
pub(super) fn document<'t>(text: &'t str, path: &Path) -> Result<Document<'t>, Error> {
    xml::parse(text).map_err(|(source, at)| Error::Parse {
        path: path.into(),
        line: at.row,
        column: at.col,
        source,
    })
}

impl<'a, 'input> Reader<'a, 'input> {
    /// Checks that an element has only the given attributes and child elements, and no text.
    pub(super) fn expect(
        &self,
        node: Node,
        attributes: Names,
        children: Names,
    ) -> Result<(), Error> {
        self.expect_attributes(node, attributes)?;
        for child in node.children() {
            if child.is_element() && !children.iter().any(|&name| child.has_tag_name(name)) {
                return Err(self.unknown(
                    child,
                    "element",
                    child.tag_name().name(),
                    in_element(node),
                    children,
                ));
            }
            let text =
                child.text().map(str::trim).filter(|text| child.is_text() && !text.is_empty());
            if let Some(text) = text {
                return Err(self.unknown(child, "text", text, in_element(node), &[]));
            }
        }
        Ok(())
    }

    pub(super) fn expect_attributes(&self, node: Node, attributes: Names) -> Result<(), Error> {
        let known = |a: &Attribute| match a.namespace() {
            None => attributes.contains(&a.name()),
            Some(namespace) => namespace == XSI,
        };
        let Some(attribute) = node.attributes().find(|a| !known(a)) else {
            return Ok(());
        };
        let (line, column) = self.position(attribute.range().start);
        Err(Error::Unknown {
            path: self.path.into(),
            line,
            column,
            kind: "attribute",
            key: shorten(attribute.name()),
            parent: in_element(node),
            nearest: nearest(attribute.name(), attributes.iter().copied()),
            valid: attributes,
        })
    }

    /// Returns an element after checking that it has only the given attributes and no content.
    pub(super) fn leaf<'n>(
        &self,
        node: Node<'n, 'input>,
        attributes: Names,
    ) -> Result<Node<'n, 'input>, Error> {
        self.expect(node, attributes, &[])?;
        Ok(node)
    }

    /// Returns the only child with this name.
    pub(super) fn child(
        &self,
        parent: Node<'a, 'input>,
        name: &'static str,
    ) -> Result<Node<'a, 'input>, Error> {
        let mut found = parent.children().filter(|n| n.has_tag_name(name));
        let child = found.next().ok_or_else(|| self.missing(parent, "element", name))?;
        match found.next() {
            None => Ok(child),
            Some(second) => Err(self.duplicate(second.range().start, format!("element <{name}>"))),
        }
    }

    /// Returns the child elements, at most `limit`.
    pub(super) fn few(
        &self,
        parent: Node<'a, 'input>,
        limit: usize,
    ) -> Result<Vec<Node<'a, 'input>>, Error> {
        let children: Vec<_> = parent.children().filter(Node::is_element).collect();
        let Some(excess) = children.get(limit) else {
            return Ok(children);
        };
        let (line, column) = self.position(excess.range().start);
        let element = excess.tag_name().name().into();
        Err(Error::TooMany { path: self.path.into(), line, column, element, limit })
    }

    pub(super) fn text(&self, node: Node<'a, '_>, key: &'static str) -> Result<&'a str, Error> {
        node.attribute(key).ok_or_else(|| self.missing(node, "attribute", key))
    }

    pub(super) fn any(&self, node: Node, key: &'static str) -> Result<f64, Error> {
        self.number(node, key, "a number", |_| true)
    }

    pub(super) fn positive(&self, node: Node, key: &'static str) -> Result<f64, Error> {
        self.number(node, key, "a number greater than 0", |v| v > 0.0)
    }

    pub(super) fn not_negative(&self, node: Node, key: &'static str) -> Result<f64, Error> {
        self.number(node, key, "a number of at least 0", |v| v >= 0.0)
    }

    pub(super) fn number(
        &self,
        node: Node,
        key: &'static str,
        allowed: &str,
        valid: impl Fn(f64) -> bool,
    ) -> Result<f64, Error> {
        let Some(text) = node.attribute(key) else {
            return Err(self.missing(node, "attribute", key));
        };
        finite(text).filter(|&v| valid(v)).ok_or_else(|| self.value(node, key, allowed))
    }

    pub(super) fn whole(
        &self,
        node: Node,
        key: &'static str,
        least: u32,
        most: u32,
    ) -> Result<u32, Error> {
        let Some(text) = node.attribute(key) else {
            return Err(self.missing(node, "attribute", key));
        };
        let number = text.trim().parse().ok().filter(|v| (least..=most).contains(v));
        number
            .ok_or_else(|| self.value(node, key, format!("a whole number from {least} to {most}")))
    }

    /// Returns line and column, both from 1, of a byte offset.
    pub(super) fn position(&self, offset: usize) -> (u32, u32) {
        let at = self.document.text_pos_at(offset);
        (at.row, at.col)
    }

    /// Returns the byte offset of an attribute, or of its element if the attribute is missing.
    pub(super) fn offset(node: Node, key: &str) -> usize {
        node.attribute_node(key).map_or(node.range().start, |a| a.range().start)
    }

    pub(super) fn unknown(
        &self,
        node: Node,
        kind: &'static str,
        key: &str,
        parent: Box<str>,
        valid: Names,
    ) -> Error {
        let (line, column) = self.position(node.range().start);
        let nearest = nearest(key, valid.iter().copied());
        let key = shorten(key);
        Error::Unknown { path: self.path.into(), line, column, kind, key, parent, nearest, valid }
    }

    pub(super) fn missing(&self, node: Node, kind: &'static str, key: &'static str) -> Error {
        let (line, column) = self.position(node.range().start);
        Error::Missing {
            path: self.path.into(),
            line,
            column,
            kind,
            key,
            parent: node.tag_name().name().into(),
        }
    }

    pub(super) fn duplicate(&self, offset: usize, key: String) -> Error {
        let (line, column) = self.position(offset);
        Error::Duplicate { path: self.path.into(), line, column, key }
    }

    pub(super) fn value(&self, node: Node, key: &'static str, allowed: impl Display) -> Error {
        let (line, column) = self.position(Self::offset(node, key));
        let value = shorten(node.attribute(key).unwrap_or_default());
        let (element, allowed) = (node.tag_name().name().into(), allowed.to_string());
        Error::Value { path: self.path.into(), line, column, element, key, value, allowed }
    }
}

/// Returns the name of an element for messages, as `<agents>`.
pub(super) fn in_element(node: Node) -> Box<str> {
    format!("<{}>", node.tag_name().name()).into()
}

pub(super) fn finite(text: &str) -> Option<f64> {
    text.trim().parse::<f64>().ok().filter(|v| v.abs() <= MAX_NUMBER)
}
