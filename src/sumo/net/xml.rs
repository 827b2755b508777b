//! Parser of untrusted XML files, that is, nets and scenarios, with limits on memory and time.

use roxmltree::{Document, TextPos};

/// Greatest number of attributes of an element: the parser compares every attribute with every
/// other.
const MAX_ATTRIBUTES: usize = 256;

/// Greatest number of namespace declarations in a file: the parser copies all declarations in scope
/// to each element that declares a namespace.
const MAX_NAMESPACES: usize = 64;

/// A reason why a text cannot be read as XML.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum XmlError {
    /// The text is not well-formed, or has entities.
    #[error(transparent)]
    Syntax(#[from] roxmltree::Error),
    /// The text exceeds a limit that no regular file reaches.
    #[error("more than {limit} {what}")]
    Excess {
        /// Name of the counted items.
        what: &'static str,
        /// Greatest number of items.
        limit: usize,
    },
}

/// Parses a text.
///
/// # Errors
/// The reason why the text cannot be read, and the position.
pub(crate) fn parse(text: &str) -> Result<Document<'_>, (XmlError, TextPos)> {
    let excess = |what, limit, at| Err((XmlError::Excess { what, limit }, position(text, at)));
    let mut namespaces = 0;
    for tag in tags(text) {
        namespaces += tag.namespaces;
        if tag.attributes > MAX_ATTRIBUTES {
            return excess("attributes in an element", MAX_ATTRIBUTES, tag.at);
        }
        if namespaces > MAX_NAMESPACES {
            return excess("declarations of namespaces", MAX_NAMESPACES, tag.at);
        }
    }
    Document::parse(text).map_err(|error| {
        let at = error.pos();
        (error.into(), at)
    })
}

/// A start tag.
struct Tag {
    /// Position of its `<`.
    at: usize,
    attributes: usize,
    /// Number of the attributes that declare a namespace.
    namespaces: usize,
}

/// Returns the start tags of a text; ends where the text is certainly not XML.
fn tags(text: &str) -> impl Iterator<Item = Tag> {
    const OTHERS: [(&str, &str); 5] =
        [("<!--", "-->"), ("<![CDATA[", "]]>"), ("<?", "?>"), ("<!", ">"), ("</", ">")];
    let mut rest = 0;
    std::iter::from_fn(move || {
        loop {
            let at = rest + text[rest..].find('<')?;
            let other = OTHERS.iter().find(|(begin, _)| text[at..].starts_with(begin));
            if let Some((begin, end)) = other {
                let inside = at + begin.len();
                rest = inside + text[inside..].find(end)? + end.len();
                continue;
            }
            let mut tag = Tag { at, attributes: 0, namespaces: 0 };
            rest = at + 1;
            while let Some(more) = text[rest..].find(['"', '\'', '<', '>']) {
                let (name, end) = (&text[rest..rest + more], text.as_bytes()[rest + more]);
                rest += more;
                if matches!(end, b'<' | b'>') {
                    break;
                }
                let name = name.trim_end().trim_end_matches('=').split_whitespace().next_back();
                let declares = name.is_some_and(|n| n == "xmlns" || n.starts_with("xmlns:"));
                tag.attributes += 1;
                tag.namespaces += usize::from(declares);
                let value = rest + 1;
                let closing = text[value..].find(char::from(end));
                rest = closing.map_or(text.len(), |closing| value + closing + 1);
            }
            return Some(tag);
        }
    })
}

fn position(text: &str, at: usize) -> TextPos {
    let before = &text[..at];
    let line = before.rsplit('\n').next().unwrap_or_default();
    TextPos::new(before.matches('\n').count() as u32 + 1, line.chars().count() as u32 + 1)
}
