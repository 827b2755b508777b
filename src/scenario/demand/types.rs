//! Reads the types of vehicles and persons of route files, and distributions of them.

use std::fmt::Write as _;
use std::path::PathBuf;

use roxmltree::Node;

use super::super::reader::{Reader, document, finite, text_up_to};
use super::super::{Error, Place};
use super::table::{CAR_FOLLOWING, TYPE, TYPES};
use super::{Class, DEFAULT_TYPES, Demand, MAX_BYTES, VehicleKind, WALKERS, class_named};
use crate::sumo::net::{class_of_sumo, did_you_mean, nearest};

/// Ids of types that the environments define themselves.
const TAKEN: [&str; 2] = ["agent", "sumo_driver"];

/// Numbers of a type, and of its car-following model, of which SUMO checks no range, with the largest
/// value that is taken.
const NUMBERS: [(&str, f64); 8] = [
    ("accel", 100.0),
    ("decel", 100.0),
    ("apparentDecel", 100.0),
    ("emergencyDecel", 100.0),
    ("minGap", 1000.0),
    ("sigma", 1.0),
    ("speedDev", 10.0),
    ("tau", 1000.0),
];

/// Largest scale of a type: vehicles that depart instead of one.
const MAX_SCALE: f64 = 1000.0;

impl Demand {
    pub(super) fn vehicle_type(
        &mut self,
        reader: &Reader,
        node: Node,
        text: &str,
    ) -> Result<usize, Error> {
        let id = reader.text(node, "id")?;
        if TAKEN.contains(&id) || id.is_empty() {
            let allowed =
                format!("an id other than {}, which this program defines", TAKEN.join(" and "));
            return Err(reader.value(node, "id", allowed));
        }
        self.expect_children(reader, node, &TYPE)?;
        self.count_unknown(reader, node, &[TYPE.taken]);
        for model in node.children().filter(Node::is_element) {
            if !model.has_tag_name("param") {
                reader.expect_children(model, &[], false)?;
                self.count_unknown(reader, model, &[CAR_FOLLOWING.taken]);
            }
        }
        for part in node.descendants() {
            for (name, most) in NUMBERS.into_iter().filter(|(name, _)| part.has_attribute(*name)) {
                let allowed = format!("number from 0 to {most}");
                reader.number(part, name, &allowed, |v| (0.0..=most).contains(&v))?;
            }
        }
        let default = DEFAULT_TYPES.iter().position(|known| *known == id);
        if self.mixes.contains_key(id)
            || default.is_none() && self.types.iter().any(|kind| kind.id == id)
        {
            return Err(reader.duplicate(node, "vehicle type"));
        }
        let other = if default == Some(1) { WALKERS } else { super::CLASSES[0].name };
        let name = node.attribute("vClass").unwrap_or(other);
        // Vehicles of SUMO's other classes are left out, so that their sizes are of no use.
        let known = class_of_sumo(name);
        let unused = || Some(Class { name: known?, ..super::CLASSES[0] });
        let class = class_named(known.unwrap_or(name)).copied().or_else(unused);
        let Class { name: class, length, width, max_speed } = class.ok_or_else(|| {
            let known = || super::CLASSES.iter().map(|class| class.name);
            let given = node.attribute("vClass").unwrap_or_default();
            let similar = did_you_mean(nearest(given, known()));
            reader.value(node, "vClass", known().collect::<Vec<_>>().join(", ") + &similar)
        })?;
        let size = |key, otherwise| match node.attribute(key) {
            None => Ok(otherwise),
            Some(_) => {
                reader.number(node, key, "number from 0.1 to 100", |v| (0.1..=100.0).contains(&v))
            }
        };
        let max_speed = match node.attribute("maxSpeed") {
            None => max_speed,
            Some(_) => reader.number(node, "maxSpeed", "number above 0", |v| v > 0.0)?,
        };
        let scale = if node.has_attribute("scale") {
            let allowed = format!("number from 0 to {MAX_SCALE}");
            reader.number(node, "scale", &allowed, |v| (0.0..=MAX_SCALE).contains(&v))?
        } else {
            1.0
        };
        let kind = VehicleKind {
            id: id.into(),
            length: size("length", length)?,
            width: size("width", width)?,
            walks: class == WALKERS,
            class,
            max_speed,
            scale,
        };
        let _ = writeln!(self.definitions, "    {}", &text[node.range()]);
        if let Some(index) = default {
            if kind.walks != self.types[index].walks {
                let allowed = if index == 1 { WALKERS } else { "a class of vehicles" };
                return Err(reader.value(node, "vClass", allowed));
            }
            self.types[index] = kind;
            return Ok(index);
        }
        self.types.push(kind);
        Ok(self.types.len() - 1)
    }

    pub(super) fn type_distribution(
        &mut self,
        reader: &Reader,
        node: Node,
        text: &str,
    ) -> Result<(), Error> {
        self.expect(reader, node, &TYPES)?;
        let id = reader.text(node, "id")?;
        let default = DEFAULT_TYPES.iter().position(|known| *known == id);
        if self.mixes.contains_key(id) || default.is_none() && self.mix(id).is_some() {
            return Err(reader.duplicate(node, "vehicle type"));
        }
        let mut mix = Vec::new();
        for child in node.children().filter(Node::is_element) {
            let index = self.vehicle_type(reader, child, text)?;
            mix.push((index, probability(reader, child)?));
        }
        for (name, weight) in named(reader, node, "vTypes")? {
            let known = self.types.iter().position(|kind| kind.id == name).ok_or_else(|| {
                let similar = nearest(name, self.types.iter().map(|kind| kind.id.as_str()));
                let allowed = "ids of types that stand above in the files";
                reader.value(node, "vTypes", format!("{allowed}{}", did_you_mean(similar)))
            })?;
            mix.push((known, weight));
        }
        possible(reader, node, &mix)?;
        if default
            .is_some_and(|of| mix.iter().any(|&(kind, _)| self.types[kind].walks != (of == 1)))
        {
            let allowed = "a distribution of types of persons, or of vehicles, as the default type";
            return Err(reader.value(node, "id", allowed));
        }
        self.mixes.insert(id.into(), mix);
        Ok(())
    }

    /// Returns where the route files define the type that SUMO's message is about: the type that it
    /// names, one with a value that it quotes, or one whose attribute of that name is no number
    /// above 0.
    pub fn blamed(files: &[PathBuf], message: &str) -> Option<Place> {
        let quoted: Vec<&str> = message.split('\'').skip(1).step_by(2).collect();
        let words = || message.split(|c: char| !c.is_alphanumeric() && c != '_');
        let suspect = |name: &str, value: &str| {
            words().any(|word| word == name) && !value.parse::<f64>().is_ok_and(|v| v > 0.0)
        };
        let find = |pass: usize| {
            files.iter().find_map(|path| {
                let text = text_up_to(path, MAX_BYTES).ok()?;
                let document = document(&text, path).ok()?;
                let reader = Reader::new(path, &document);
                reader.all("vType").find_map(|kind| {
                    let mut attributes = kind
                        .descendants()
                        .flat_map(|node| node.attributes().map(move |attribute| (node, attribute)));
                    let of_id = kind.attribute("id").is_some_and(|id| quoted.contains(&id));
                    let value = attributes.find(|(_, attribute)| {
                        let (name, value) = (attribute.name(), attribute.value());
                        let named = of_id && quoted.contains(&name);
                        let fits =
                            if pass == 2 { suspect(name, value) } else { quoted.contains(&value) };
                        name != "id" && (named || fits)
                    });
                    let place = value.map(|(node, attribute)| reader.place(node, attribute.name()));
                    match pass {
                        0 if !of_id => None,
                        0 => Some(place.unwrap_or_else(|| reader.place(kind, "id"))),
                        _ => place,
                    }
                })
            })
        };
        (0..3).find_map(find)
    }
}

fn weight(text: &str) -> Option<f64> {
    finite(text).filter(|v| *v >= 0.0)
}

/// Returns the `probability` of an element of a distribution.
pub(super) fn probability(reader: &Reader, node: Node) -> Result<f64, Error> {
    weight(node.attribute("probability").unwrap_or("1"))
        .ok_or_else(|| reader.value(node, "probability", "number of at least 0"))
}

/// Returns the ids that the attribute `key` of a distribution lists, with their `probabilities`.
pub(super) fn named<'n>(
    reader: &Reader,
    node: Node<'n, '_>,
    key: &'static str,
) -> Result<Vec<(&'n str, f64)>, Error> {
    let ids: Vec<&str> = node.attribute(key).unwrap_or_default().split_whitespace().collect();
    let weights: Option<Vec<f64>> = match node.attribute("probabilities") {
        None => Some(vec![1.0; ids.len()]),
        Some(text) => text.split_whitespace().map(weight).collect(),
    };
    let weights = weights.filter(|weights| weights.len() == ids.len()).ok_or_else(|| {
        reader.value(node, "probabilities", format!("a number of at least 0 for each of {key}"))
    })?;
    Ok(ids.into_iter().zip(weights).collect())
}

/// Checks that a distribution is possible.
pub(super) fn possible(reader: &Reader, node: Node, mix: &[(usize, f64)]) -> Result<(), Error> {
    if mix.iter().map(|entry| entry.1).sum::<f64>() > 0.0 {
        return Ok(());
    }
    let allowed = "a distribution with an entry whose probability is above 0";
    Err(reader.value(node, "id", allowed))
}
