//! Fingerprint of a scenario with all its files, by which a run detects that the scenario has
//! changed.

use std::collections::HashSet;
use std::path::Path;

use super::{Scenario, overridable};
use crate::fnv::Fnv;
use crate::markup;

impl Scenario {
    /// Returns a hash, in hexadecimal, of the elements, attributes and texts in the scenario file
    /// and in the net, route and additional files that it names. Comments, white space and the
    /// locations of the files do not count, nor do the attributes of the scenario file that are
    /// settings of a run: each run has its own values of them. A file that cannot be read or is not
    /// XML contributes only this fact.
    pub fn fingerprint(&self) -> String {
        let settings: HashSet<String> =
            overridable().iter().map(|known| known.path.join(".")).collect();
        let mut hash = Fnv::new();
        hash.file(&self.path, &settings);
        let nets = self.nets.iter().map(|net| net.file.as_path());
        let files = nets
            .chain(self.traffic.files.iter().map(AsRef::as_ref))
            .chain(self.occlusion.iter().map(|occlusion| occlusion.file.as_path()));
        for file in files {
            hash.file(file, &HashSet::new());
        }
        hash.to_string()
    }
}

impl Fnv {
    /// Adds a file without the attributes in `left_out`, which names them as `element.attribute`
    /// from below the root.
    fn file(&mut self, path: &Path, left_out: &HashSet<String>) {
        let text = markup::read(path, u64::MAX - 1).ok().flatten().unwrap_or_default();
        let Ok(document) = roxmltree::Document::parse(&text) else { return self.text("no XML") };
        for node in document.descendants() {
            if node.is_element() {
                self.text(&format!("{} {}", node.ancestors().count(), node.tag_name().name()));
                for attribute in node.attributes() {
                    if !left_out.contains(&place_of(node, attribute.name())) {
                        self.text(attribute.name());
                        self.text(attribute.value());
                    }
                }
            } else if let Some(text) =
                node.text().map(str::trim).filter(|text| node.is_text() && !text.is_empty())
            {
                self.text(text);
            }
        }
    }
}

/// Returns the name of an attribute with the elements that contain it, without the root.
fn place_of(node: roxmltree::Node<'_, '_>, attribute: &str) -> String {
    let mut names: Vec<&str> = node.ancestors().map(|node| node.tag_name().name()).collect();
    // The last two are the root element and the document.
    names.truncate(names.len().saturating_sub(2));
    names.reverse();
    names.push(attribute);
    names.join(".")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_follows_from_what_files_say_and_not_from_how() {
        let folder = tempfile::tempdir().unwrap();
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        let scenario =
            Scenario::load(&root.join("scenarios/intersection.xml")).expect("a scenario");
        let text = std::fs::read_to_string(&scenario.path).unwrap();
        let of = |text: &str, net: Option<&str>| {
            let path = folder.path().join("intersection.xml");
            std::fs::write(&path, text).unwrap();
            let mut other = Scenario { path, ..scenario.clone() };
            if let Some(net) = net {
                other.nets[0].file = folder.path().join("a.net.xml");
                std::fs::write(&other.nets[0].file, net).unwrap();
            }
            other.fingerprint()
        };
        let own = scenario.fingerprint();
        assert_eq!(of(&text.replacen("<agents", "<!-- so many -->\n   <agents", 1), None), own);
        let changed = |was: &str, is: &str| {
            assert!(text.contains(was), "{was}");
            of(&text.replacen(was, is, 1), None)
        };
        // A run has its own value of this attribute.
        assert_eq!(changed("horizon=\"1000\"", "horizon=\"900\""), own);
        assert_ne!(changed("default=\"8\"", "default=\"9\""), own);
        assert_ne!(changed("count=\"", "count=\"1"), own);
        let net = std::fs::read_to_string(&scenario.nets[0].file).unwrap();
        assert_eq!(of(&text, Some(&net)), own, "where a net is does not matter");
        assert_ne!(of(&text, Some(&net.replacen("speed=\"", "speed=\"1", 1))), own);
        assert_ne!(of(&text, Some("")), own);
    }
}
