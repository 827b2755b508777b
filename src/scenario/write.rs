//! Writes a scenario as XML that the reader accepts.

use std::path::{Component, Path, PathBuf};

use super::attribute::{Field, Tag};
use super::schema::describe;
use super::{Jitter, Occlusion, Scenario, Traffic};
use crate::markup::Writer;

impl Scenario {
    /// Returns the scenario as the text of a file, from which [`Scenario::parse`] restores the same
    /// scenario. Paths that begin with the folder of [`Scenario::path`] are written relative to it.
    pub fn to_xml(&self) -> String {
        let folder = self.path.parent().unwrap_or(Path::new(""));
        let relative = |path: &Path| path.strip_prefix(folder).unwrap_or(path).to_path_buf();
        let mut xml = Writer::new();
        xml.open("scenario")
            .attribute("name", &self.name)
            .attribute("xmlns:xsi", "http://www.w3.org/2001/XMLSchema-instance")
            .attribute("xsi:noNamespaceSchemaLocation", "scenario.xsd")
            .element("description", &self.description);
        let root = &mut Tag::new(&mut xml, describe());
        root.fields("agents", &self.agents);
        if !self.routes.is_empty() {
            root.element("routes", |tag| {
                self.routes.iter().for_each(|route| tag.fields("route", route));
            });
        }
        root.element("nets", |tag| {
            for net in &self.nets {
                tag.element("net", |tag| {
                    tag.attribute("file", &relative(&net.file).to_string_lossy());
                    for row in &net.spawns {
                        tag.element("spawn", |tag| {
                            let known = row.routes.iter().filter_map(|&i| self.routes.get(i));
                            let ids: Vec<String> = known.map(|route| route.id.clone()).collect();
                            ids.write(tag, "route");
                            row.first.write(tag, "first");
                            row.spacing.write(tag, "spacing");
                            row.count.write(tag, "count");
                            row.departure.write(tag, "");
                        });
                    }
                });
            }
        });
        root.element("vehicle", |tag| {
            self.vehicle.write(tag, "");
            self.kinds.iter().for_each(|kind| tag.fields("kind", kind));
        });
        if self.jitter != Jitter::default() || self.nets.iter().any(|net| !net.spawns.is_empty()) {
            root.fields("jitter", &self.jitter);
        }
        root.element("control", |tag| {
            tag.attribute("mode", self.control.mode());
            self.control.write(tag, "");
        });
        root.fields("observation", &self.observation);
        root.fields("reward", &self.reward);
        root.fields("termination", &self.termination);
        root.fields("communication", &self.communication);
        if let Some(occlusion) = &self.occlusion {
            let file = relative(&occlusion.file);
            root.fields("occlusion", &Occlusion { file, ..occlusion.clone() });
        }
        let mut traffic = self.traffic.clone();
        traffic.files.iter_mut().for_each(|file| *file = relative(file));
        if traffic != Traffic::default() {
            root.fields("traffic", &traffic);
        }
        xml.finish()
    }

    /// Returns the same as [`Scenario::to_xml`], with paths relative to `folder`.
    ///
    /// # Errors
    /// If the folder, a net or a route file does not exist.
    pub fn to_xml_in(&self, folder: &Path) -> std::io::Result<String> {
        let folder = folder.canonicalize()?;
        let mut moved = Self { path: PathBuf::new(), ..self.clone() };
        let nets = moved.nets.iter_mut().map(|net| &mut net.file);
        let walls = moved.occlusion.iter_mut().map(|occlusion| &mut occlusion.file);
        for file in nets.chain(&mut moved.traffic.files).chain(walls) {
            *file = relative(&folder, &file.canonicalize()?);
        }
        Ok(moved.to_xml())
    }
}

/// Returns the path of a file relative to a folder, both without links.
fn relative(folder: &Path, file: &Path) -> PathBuf {
    let common = folder.components().zip(file.components()).take_while(|(a, b)| a == b).count();
    let up = folder.components().skip(common).map(|_| Component::ParentDir);
    up.chain(file.components().skip(common)).collect()
}
