//! Reader of untrusted XML files, that is, nets and scenarios, with limits on size, memory and
//! time.

use std::{fs::File, io, io::Read as _, path::Path};

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

/// Returns the text of a file; `None` if the file is longer than `limit` bytes.
///
/// # Errors
/// The operating system's error, or the line and column of the first byte that is not UTF-8.
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
/// The reason why the text cannot be read, and the position.
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

/// Returns the number of attributes, at most [`MAX_ATTRIBUTES`] + 1, of the tag at the start of
/// `text`, whose `<` has been removed.
fn attributes(text: &str) -> usize {
    let mut bytes = text.bytes();
    let mut count = 0;
    while count <= MAX_ATTRIBUTES {
        match bytes.next() {
            Some(quote @ (b'"' | b'\'')) => {
                count += 1;
                // Skips to the closing quote.
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
