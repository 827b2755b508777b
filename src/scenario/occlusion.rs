//! Polygons that block sight and radio: reads them from an additional file of SUMO.

use std::path::PathBuf;

use roxmltree::Node;

use super::attribute::element;
use super::reader::{Reader, document, text};
use super::{Error, Finding};
use crate::sumo::net::{did_you_mean, nearest, shorten};

element! {
    /// Polygons that block sight, and radio if the scenario says so.
    #[derive(Debug, Clone, PartialEq)]
    pub struct Occlusion {
        /// SUMO's additional file with the polygons.
        pub file: PathBuf,
        /// Types of the polygons; empty: all of them.
        pub types: Vec<String>,
        /// Whether agents do not observe vehicles behind the polygons.
        pub sight: bool,
        /// Whether agents do not hear agents behind the polygons.
        pub radio: bool,
    }
}

/// Attributes that SUMO's `<poly>` may have.
const ATTRIBUTES: [&str; 12] = [
    "id",
    "type",
    "color",
    "fill",
    "geo",
    "lineWidth",
    "layer",
    "shape",
    "angle",
    "imgFile",
    "relativePath",
    "name",
];

/// A polygon, with its corners in the net's coordinates \[m\]. The last corner is joined to the
/// first.
#[derive(Debug, Clone, PartialEq)]
pub struct Polygon {
    /// Id.
    pub id: String,
    /// Corners, at least three.
    pub corners: Vec<[f64; 2]>,
}

impl Occlusion {
    /// Returns the polygons of the file that have one of the types.
    ///
    /// # Errors
    /// A file that cannot be read, a polygon that cannot be used, a type that no polygon has.
    pub fn polygons(&self) -> Result<Vec<Polygon>, Error> {
        let text = text(&self.file)?;
        let document = document(&text, &self.file)?;
        let reader = Reader::new(&self.file, &document);
        let kind = |node: &Node| node.attribute("type").unwrap_or_default().to_owned();
        let all = || polys(&reader);
        all().try_for_each(|node| reader.expect_attributes(node, &ATTRIBUTES))?;
        for wanted in &self.types {
            if !all().any(|node| kind(&node) == *wanted) {
                let kinds: Vec<String> = all().map(|node| kind(&node)).collect();
                let similar = nearest(wanted, kinds.iter().map(String::as_str));
                let message = format!(
                    "no polygon has the type `{}`{}",
                    shorten(wanted),
                    did_you_mean(similar)
                );
                return Err(reader.invalid(0, message));
            }
        }
        let chosen = |node: &Node| self.types.is_empty() || self.types.contains(&kind(node));
        let polygons: Vec<Polygon> =
            all().filter(chosen).map(|node| polygon(&reader, node)).collect::<Result<_, _>>()?;
        if polygons.is_empty() {
            return Err(reader.invalid(0, "the file has no element <poly>".into()));
        }
        Ok(polygons)
    }

    /// Returns a warning about elements of the file that are no polygons.
    pub(super) fn others(&self) -> Option<Finding> {
        let text = text(&self.file).ok()?;
        let document = document(&text, &self.file).ok()?;
        let reader = Reader::new(&self.file, &document);
        let mut others = document.root_element().children();
        let other = others.find(|node| node.is_element() && !node.has_tag_name("poly"))?;
        Some(Finding::warning(
            "occlusion",
            reader.at(other.range().start),
            format!("<{}> blocks nothing", shorten(other.tag_name().name())),
            "only elements <poly> block sight and radio",
        ))
    }
}

fn polys<'a, 'input>(reader: &Reader<'a, 'input>) -> impl Iterator<Item = Node<'a, 'input>> {
    reader.document.root_element().children().filter(|node| node.has_tag_name("poly"))
}

fn polygon(reader: &Reader, node: Node) -> Result<Polygon, Error> {
    let id = reader.text(node, "id")?.to_owned();
    if node.attribute("geo").is_some_and(|geo| matches!(geo, "1" | "true" | "yes" | "on" | "x")) {
        let allowed =
            "false: convert the polygons to the net's coordinates, with SUMO's polyconvert";
        return Err(reader.value(node, "geo", allowed));
    }
    let corner = |text: &str| {
        let mut numbers = text.split(',').map(|number| number.parse::<f64>().ok());
        let (x, y) = (numbers.next()??, numbers.next()??);
        (numbers.all(|z| z.is_some()) && x.is_finite() && y.is_finite()).then_some([x, y])
    };
    let shape = reader.text(node, "shape")?;
    let corners: Option<Vec<[f64; 2]>> = shape.split_whitespace().map(corner).collect();
    let mut corners = corners.unwrap_or_default();
    if corners.len() > 1 && corners.first() == corners.last() {
        corners.pop();
    }
    if corners.len() < 3 {
        let allowed = "at least three corners x,y, separated by spaces";
        return Err(reader.value(node, "shape", allowed));
    }
    Ok(Polygon { id, corners })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(xml: &str, types: &[&str]) -> Result<Vec<Polygon>, String> {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("walls.add.xml");
        std::fs::write(&file, xml).unwrap();
        let types = types.iter().map(ToString::to_string).collect();
        let occlusion = Occlusion { file, types, sight: true, radio: false };
        occlusion.polygons().map_err(|error| error.message())
    }

    #[test]
    fn polygons_are_read_or_refused_with_their_line() {
        let poly = |more: &str| format!("<additional><poly id=\"a\" {more}/></additional>");
        let square = "shape=\"0,0 10,0 10,10 0,10 0,0\"";
        let found = read(&poly(square), &[]).unwrap();
        assert_eq!(found[0].corners, [[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]]);
        for (xml, said) in [
            (poly("shape=\"0,0 10,0\""), "three corners"),
            (poly("shape=\"0,0 10,x 3,3\""), "three corners"),
            (poly(""), "shape"),
            (poly(&format!("{square} geo=\"true\"")), "polyconvert"),
            ("<additional/>".into(), "no element <poly>"),
            (poly(&format!("{square} typ=\"building\"")), "unknown attribute `typ`"),
        ] {
            let error = read(&xml, &[]).unwrap_err();
            assert!(error.contains(said), "{error}");
        }
        let typed = poly(&format!("{square} type=\"building\""));
        assert_eq!(read(&typed, &["building"]).unwrap().len(), 1);
        assert!(read(&typed, &["buildings"]).unwrap_err().contains("`building`"));
    }
}
