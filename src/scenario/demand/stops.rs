//! Reads the stops of route files.

use roxmltree::Node;

use super::super::Error;
use super::super::reader::Reader;
use super::table::{self, flag};
use super::times::time;
use super::{Demand, Halt};

impl Demand {
    /// Reads the stops within a route, vehicle, trip or flow.
    pub(super) fn stops(&mut self, reader: &Reader, node: Node) -> Result<Vec<Halt>, Error> {
        node.children()
            .filter(|child| child.has_tag_name("stop"))
            .map(|child| self.stop(reader, child))
            .collect()
    }

    fn stop(&mut self, reader: &Reader, node: Node) -> Result<Halt, Error> {
        self.expect(reader, node, &table::STOP)?;
        let (edge, lane) = match (node.attribute("lane"), node.attribute("edge")) {
            (Some(lane), None) => {
                let split = lane.rsplit_once('_').and_then(|(edge, index)| {
                    Some((edge.to_owned(), Some(index.parse::<u32>().ok()?)))
                });
                split.ok_or_else(|| {
                    reader.value(node, "lane", "the id of a lane: edge, `_` and index")
                })?
            }
            (None, Some(edge)) => (edge.to_owned(), None),
            (Some(_), Some(_)) => {
                return Err(reader.value(node, "edge", "no value beside `lane`"));
            }
            (None, None) => return Err(reader.missing(node, "attribute", "lane")),
        };
        let position = |key| match node.attribute(key) {
            None => Ok(None),
            Some(_) => reader.number(node, key, "number of metres", |_| true).map(Some),
        };
        let optional = |key| match node.attribute(key) {
            None => Ok(None),
            Some(_) => time(reader, node, key, 0.0).map(Some),
        };
        let flag = |key| {
            let value = flag(node.attribute(key).unwrap_or("false"));
            value.ok_or_else(|| reader.value(node, key, "true, false"))
        };
        let (duration, until) = (optional("duration")?, optional("until")?);
        if duration.is_none() && until.is_none() {
            return Err(reader.missing(node, "attribute", "duration"));
        }
        Ok(Halt {
            edge,
            lane,
            start: position("startPos")?,
            end: position("endPos")?,
            friendly: flag("friendlyPos")?,
            duration: duration.unwrap_or(0.0),
            until,
            parking: flag("parking")?,
        })
    }
}
