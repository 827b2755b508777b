//! Gives the signals of a net other programs.

use std::path::Path as FilePath;

use roxmltree::Node;

use super::NetError;
use super::read::document;

/// Returns a net whose signals have the given programs, elements `<tlLogic>` with their ids, in place
/// of their own, as in SUMO where additional files have programs; and the ids that the net does not
/// have. `path` is used only in messages.
///
/// # Errors
/// If the text is no XML.
pub(crate) fn with_programs(
    text: &str,
    path: &FilePath,
    programs: &[(String, String)],
) -> Result<(String, Vec<String>), NetError> {
    let document = document(text, path)?;
    let nodes = document.root_element().children().filter(|node| node.has_tag_name("tlLogic"));
    let id = |node: &Node| node.attribute("id").unwrap_or_default().to_owned();
    let own: Vec<(String, std::ops::Range<usize>)> =
        nodes.map(|node| (id(&node), node.range())).collect();
    let (mut out, mut at) = (String::with_capacity(text.len()), 0);
    for (nth, (id, range)) in own.iter().enumerate() {
        let mut new = programs.iter().filter(|program| program.0 == *id).peekable();
        if new.peek().is_none() {
            continue;
        }
        out += &text[at..range.start];
        // In place of the first of the signal's programs.
        if own[..nth].iter().all(|other| other.0 != *id) {
            new.for_each(|program| out += &program.1);
        }
        at = range.end;
    }
    out += &text[at..];
    let unknown = programs.iter().map(|program| &program.0);
    let mut unknown: Vec<String> =
        unknown.filter(|id| own.iter().all(|known| known.0 != **id)).cloned().collect();
    unknown.dedup();
    Ok((out, unknown))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn programs_of_additional_files_replace_those_of_the_net() {
        let net = "<net><tlLogic id=\"a\" programID=\"0\"/><x/><tlLogic id=\"a\" programID=\"1\"/><tlLogic id=\"b\"/></net>";
        let program =
            |id: &str| (id.to_owned(), format!("<tlLogic id=\"{id}\" programID=\"new\"/>"));
        let (text, unknown) =
            with_programs(net, FilePath::new("a.net.xml"), &[program("a"), program("c")])
                .expect("a net");
        assert_eq!(text, "<net><tlLogic id=\"a\" programID=\"new\"/><x/><tlLogic id=\"b\"/></net>");
        assert_eq!(unknown, ["c"]);
    }
}
