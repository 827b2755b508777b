//! Fingerprint of a scenario with all its files, by which a run detects that the scenario has
//! changed.

use std::path::Path;

use super::Scenario;
use crate::fnv::Fnv;
use crate::markup;

impl Scenario {
    /// Returns a hash, in hexadecimal, of the elements, attributes and texts in the scenario file
    /// and in the net, route and additional files that it names. Comments, white space and the locations of the
    /// files do not count. A file that cannot be read or is not XML contributes only this fact.
    pub fn fingerprint(&self) -> String {
        let nets = self.nets.iter().map(|net| net.file.as_path());
        let files = std::iter::once(self.path.as_path())
            .chain(nets)
            .chain(self.traffic.files.iter().map(AsRef::as_ref))
            .chain(self.occlusion.iter().map(|occlusion| occlusion.file.as_path()));
        let mut hash = Fnv::new();
        for file in files {
            hash.file(file);
        }
        hash.to_string()
    }
}

impl Fnv {
    fn file(&mut self, path: &Path) {
        let text = markup::read(path, u64::MAX - 1).ok().flatten().unwrap_or_default();
        let Ok(document) = roxmltree::Document::parse(&text) else { return self.text("no XML") };
        for node in document.descendants() {
            if node.is_element() {
                self.text(&format!("{} {}", node.ancestors().count(), node.tag_name().name()));
                for attribute in node.attributes() {
                    self.text(attribute.name());
                    self.text(attribute.value());
                }
            } else if let Some(text) =
                node.text().map(str::trim).filter(|text| node.is_text() && !text.is_empty())
            {
                self.text(text);
            }
        }
    }
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
        assert_ne!(of(&text.replacen("horizon=\"1000\"", "horizon=\"900\"", 1), None), own);
        let net = std::fs::read_to_string(&scenario.nets[0].file).unwrap();
        assert_eq!(of(&text, Some(&net)), own, "where a net is does not matter");
        assert_ne!(of(&text, Some(&net.replacen("speed=\"", "speed=\"1", 1))), own);
        assert_ne!(of(&text, Some("")), own);
    }
}
