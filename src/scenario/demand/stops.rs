//! Reads the stops of route files.

use roxmltree::Node;

use super::super::Error;
use super::super::reader::Reader;
use super::table::{self, STOPPING_PLACES, flag};
use super::times::time;
use super::{Demand, Halt};
use crate::sumo::net::{did_you_mean, nearest, shorten};

impl Demand {
    /// Reads the stops within a route, vehicle, trip or flow; the reason, if one of them cannot be
    /// made.
    pub(super) fn stops(
        &mut self,
        reader: &Reader,
        node: Node,
    ) -> Result<Result<Vec<Halt>, String>, Error> {
        // The stops of persons are stages.
        if node.tag_name().name().starts_with("person") {
            return Ok(Ok(Vec::new()));
        }
        let stops = node.children().filter(|child| child.has_tag_name("stop"));
        let stops: Vec<_> =
            stops.map(|child| self.stop(reader, child)).collect::<Result<_, _>>()?;
        Ok(stops.into_iter().collect())
    }

    fn stop(&mut self, reader: &Reader, node: Node) -> Result<Result<Halt, String>, Error> {
        self.expect(reader, node, &table::STOP)?;
        if let Some(why) = table::left_out(node, &table::STOP) {
            return Ok(Err(why));
        }
        let optional = |key| match node.attribute(key) {
            None => Ok(None),
            Some(_) => time(reader, node, key, 0.0).map(Some),
        };
        let (duration, until) = (optional("duration")?, optional("until")?);
        if duration.is_none() && until.is_none() {
            return Err(reader.missing(node, "attribute", "duration"));
        }
        let place = STOPPING_PLACES.iter().find_map(|kind| Some((*kind, node.attribute(*kind)?)));
        let halt = match place {
            None => place_of(reader, node)?,
            Some((kind, id)) => {
                let known = self.stopping_places.get(&(kind.into(), id.into()));
                let Some(halt) = known else { return Ok(Err(self.no_place(kind, id))) };
                halt.clone()
            }
        };
        let parking = halt.parking || truth(reader, node, "parking", "false")?;
        Ok(Ok(Halt { duration: duration.unwrap_or(0.0), until, parking, ..halt }))
    }

    /// Returns why a stop at a place that does not stand above cannot be made.
    fn no_place(&self, kind: &str, id: &str) -> String {
        let own = self.stopping_places.keys().filter(|known| known.0 == kind);
        let similar = did_you_mean(nearest(id, own.map(|known| known.1.as_str())));
        format!("no {kind} `{}` of its stop stands above in the files{similar}", shorten(id))
    }

    /// Reads a place where vehicles stop.
    pub(super) fn stopping_place(&mut self, reader: &Reader, node: Node) -> Result<(), Error> {
        self.expect(reader, node, &table::STOPPING_PLACE)?;
        let (kind, id) = (node.tag_name().name(), reader.text(node, "id")?);
        let halt = place_of(reader, node)?;
        // The places begin at the beginning of the lane by default, unlike other stops.
        let parking = kind == "parkingArea" && !truth(reader, node, "onRoad", "false")?;
        let halt = Halt { start: halt.start.or(Some(0.0)), parking, ..halt };
        if self.stopping_places.insert((kind.into(), id.into()), halt).is_some() {
            return Err(reader.duplicate(node, kind));
        }
        Ok(())
    }
}

/// Returns where a stop or a stopping place is, as a stop that takes no time.
fn place_of(reader: &Reader, node: Node) -> Result<Halt, Error> {
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
    Ok(Halt {
        edge,
        lane,
        start: position("startPos")?,
        end: position("endPos")?,
        friendly: truth(reader, node, "friendlyPos", "false")?,
        duration: 0.0,
        until: None,
        parking: false,
    })
}

/// Returns the truth value of an attribute.
fn truth(reader: &Reader, node: Node, key: &str, otherwise: &str) -> Result<bool, Error> {
    let value = flag(node.attribute(key).unwrap_or(otherwise));
    value.ok_or_else(|| reader.value(node, key, "true, false"))
}
