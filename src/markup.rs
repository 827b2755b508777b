//! XML as text: reading of files, escaping, which also suits HTML and SVG, and a writer of indented
//! documents.

mod read;

use std::borrow::Cow;
use std::fmt::{Display, Write as _};

pub(crate) use read::read;

/// Escapes text for the content of an element.
pub(crate) fn escape(text: &str) -> Cow<'_, str> {
    replace(text, |c| match c {
        '&' => Some("&amp;"),
        '<' => Some("&lt;"),
        '>' => Some("&gt;"),
        '"' => Some("&quot;"),
        _ => None,
    })
}

/// Escapes text for a quoted attribute. Parsers would turn plain line breaks and tabs into spaces.
pub(crate) fn escape_attribute(text: &str) -> Cow<'_, str> {
    replace(text, |c| match c {
        '&' => Some("&amp;"),
        '<' => Some("&lt;"),
        '>' => Some("&gt;"),
        '"' => Some("&quot;"),
        '\t' => Some("&#9;"),
        '\n' => Some("&#10;"),
        '\r' => Some("&#13;"),
        _ => None,
    })
}

fn replace(text: &str, escaped: impl Fn(char) -> Option<&'static str>) -> Cow<'_, str> {
    if text.chars().all(|c| escaped(c).is_none()) {
        return text.into();
    }
    text.chars()
        .fold(String::with_capacity(text.len() + 8), |mut out, c| {
            match escaped(c) {
                Some(entity) => out.push_str(entity),
                None => out.push(c),
            }
            out
        })
        .into()
}

/// Writer of an XML document with one element per line, indented by four spaces per level.
pub(crate) struct Writer {
    text: String,
    /// Names of the elements that are not closed yet.
    open: Vec<&'static str>,
    /// Whether the start tag of the innermost element still accepts attributes.
    in_tag: bool,
}

impl Writer {
    /// Returns a document that consists of the XML declaration.
    pub(crate) fn new() -> Self {
        let text = "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n".to_owned();
        Self { text, open: Vec::new(), in_tag: false }
    }

    /// Writes a comment.
    pub(crate) fn comment(&mut self, text: &str) -> &mut Self {
        self.line();
        let _ = writeln!(self.text, "<!-- {} -->", text.replace("--", "-"));
        self
    }

    /// Begins an element. [`Writer::attribute`] adds attributes to it, and all elements up to the
    /// matching [`Writer::close`] are its children.
    pub(crate) fn open(&mut self, name: &'static str) -> &mut Self {
        self.line();
        let _ = write!(self.text, "<{name}");
        self.open.push(name);
        self.in_tag = true;
        self
    }

    /// Writes an attribute of the element that was opened last.
    pub(crate) fn attribute(&mut self, name: &str, value: impl Display) -> &mut Self {
        let _ = write!(self.text, " {name}=\"{}\"", escape_attribute(&value.to_string()));
        self
    }

    /// Ends the innermost element.
    pub(crate) fn close(&mut self) -> &mut Self {
        if let Some(name) = self.open.pop() {
            if self.in_tag {
                self.text.push_str("/>\n");
                self.in_tag = false;
            } else {
                self.line();
                let _ = writeln!(self.text, "</{name}>");
            }
        }
        self
    }

    /// Writes an element that contains only text.
    pub(crate) fn element(&mut self, name: &'static str, text: &str) -> &mut Self {
        self.line();
        let _ = writeln!(self.text, "<{name}>{}</{name}>", escape(text));
        self
    }

    /// Ends all elements and returns the document.
    pub(crate) fn finish(mut self) -> String {
        while !self.open.is_empty() {
            self.close();
        }
        self.text
    }

    /// Ends an open start tag and indents the next line.
    fn line(&mut self) {
        if self.in_tag {
            self.text.push_str(">\n");
            self.in_tag = false;
        }
        self.text.extend(self.open.iter().map(|_| "    "));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn documents_are_indented_and_escaped() {
        let mut xml = Writer::new();
        xml.comment("a -- b").open("a").attribute("x", "<\"\n>").open("b").attribute("n", 1.5);
        xml.close().element("c", "1 & 2");
        let expected = "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<!-- a - b -->\n\
                        <a x=\"&lt;&quot;&#10;&gt;\">\n    <b n=\"1.5\"/>\n    <c>1 &amp; 2</c>\n</a>\n";
        assert_eq!(xml.finish(), expected);
    }
}
