//! Files of XML that are not trusted, nets and scenarios alike: read within bounds of size, memory and time.

use std::{fs::File, io, io::Read as _, path::Path};

use roxmltree::{Document, TextPos};

/// Most attributes of an element: the parser compares each with each.
const MAX_ATTRIBUTES: usize = 256;

/// Most declarations of namespaces in a file: the parser copies all that hold to each element with one of its own.
const MAX_NAMESPACES: usize = 64;

/// Why a text is not read as XML.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum XmlError {
    /// It is not well-formed, or has entities.
    #[error(transparent)]
    Syntax(#[from] roxmltree::Error),
    /// It has more of something than any file that is meant to be read.
    #[error("more than {limit} {what}")]
    Excess {
        /// Of what.
        what: &'static str,
        /// Most.
        limit: usize,
    },
}

/// The text of a file; `None` if it is longer than `limit` bytes.
///
/// # Errors
/// What the system says; where the text is not UTF-8, with line and column.
pub(crate) fn read(path: &Path, limit: u64) -> io::Result<Option<String>> {
    let mut bytes = Vec::new();
    if File::open(path)?.take(limit + 1).read_to_end(&mut bytes)? as u64 > limit {
        return Ok(None);
    }
    String::from_utf8(bytes).map(Some).map_err(|error| {
        let valid = String::from_utf8_lossy(&error.as_bytes()[..error.utf8_error().valid_up_to()]);
        let TextPos { row, col } = position(&valid, valid.len());
        io::Error::new(io::ErrorKind::InvalidData, format!("not UTF-8 at line {row}, column {col}"))
    })
}

/// Parses a text.
///
/// # Errors
/// What is wrong with the XML, and where.
pub(crate) fn parse(text: &str) -> Result<Document<'_>, (XmlError, TextPos)> {
    let excess = |what, limit, at| Err((XmlError::Excess { what, limit }, position(text, at)));
    let mut tags =
        text.match_indices('<').filter(|(at, _)| !text[at + 1..].starts_with(['!', '?']));
    if let Some((at, _)) = tags.find(|(at, _)| attributes(&text[at + 1..]) > MAX_ATTRIBUTES) {
        return excess("attributes in an element", MAX_ATTRIBUTES, at);
    }
    if let Some((at, _)) = text.match_indices("xmlns").nth(MAX_NAMESPACES) {
        return excess("declarations of namespaces", MAX_NAMESPACES, at);
    }
    Document::parse(text).map_err(|error| {
        let at = error.pos();
        (error.into(), at)
    })
}

/// Number of attributes, one more than [`MAX_ATTRIBUTES`] at most, in the tag that the text begins in, after its `<`.
fn attributes(text: &str) -> usize {
    let mut bytes = text.bytes();
    let mut count = 0;
    while count <= MAX_ATTRIBUTES {
        match bytes.next() {
            Some(quote @ (b'"' | b'\'')) => {
                count += 1;
                // To the other quote.
                if !bytes.any(|byte| byte == quote) {
                    break;
                }
            }
            None | Some(b'>' | b'<') => break,
            Some(_) => {}
        }
    }
    count
}

fn position(text: &str, at: usize) -> TextPos {
    let before = &text[..at];
    let line = before.rsplit('\n').next().unwrap_or_default();
    TextPos::new(before.matches('\n').count() as u32 + 1, line.chars().count() as u32 + 1)
}
