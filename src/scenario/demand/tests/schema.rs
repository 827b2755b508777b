//! The table of elements and attributes: it has all of SUMO's schema, and the reader does what it
//! says.

use std::collections::BTreeSet;

use super::*;

/// Every element and attribute of SUMO's own schema is taken, counted for a warning, or leaves the
/// vehicle or person out.
#[test]
fn the_table_has_all_of_sumos_schema() {
    let folder =
        std::env::var_os("SUMO_HOME").map_or("/usr/share/sumo".into(), std::path::PathBuf::from);
    let schemas = folder.join("data/xsd");
    // SUMO 1.25 has moved the file.
    let types = ["routeTypes.xsd", "types/route.xsd"].map(|name| schemas.join(name));
    let types = types.iter().find(|file| file.exists()).expect("SUMO's schema");
    let text = std::fs::read_to_string(types).expect("SUMO's schema");
    let xsd = roxmltree::Document::parse(&text).unwrap();
    let root = std::fs::read_to_string(schemas.join("routes_file.xsd")).expect("SUMO's schema");
    let root = roxmltree::Document::parse(&root).unwrap();
    let named = |name: &str| {
        let nodes = xsd.descendants().chain(root.descendants());
        nodes
            .filter(|n| n.has_tag_name(("http://www.w3.org/2001/XMLSchema", "complexType")))
            .find(|n| n.attribute("name") == Some(name))
            .unwrap_or_else(|| panic!("no type {name}"))
    };
    let types: &[(&table::Known, &[&str])] = &[
        (&table::ROOT, &["routesType"]),
        (&table::TYPE, &["vTypeType"]),
        (&table::TYPES, &["vTypeDistributionType"]),
        (&table::ROUTE, &["routeType", "vehicleRouteType", "routeDistRouteType"]),
        (&table::ROUTES, &["routeDistributionType", "vehicleRouteDistributionType"]),
        (&table::VEHICLE, &["vehicleType"]),
        (&table::TRIP, &["tripType"]),
        (&table::FLOW, &["flowType"]),
        (&table::INTERVAL, &["flowIntervalType"]),
        (&table::STOP, &["stopType"]),
        (&table::PERSON, &["personType"]),
        (&table::PERSON_FLOW, &["personFlowType"]),
    ];
    let is = |node: &roxmltree::Node, name: &str| {
        node.tag_name().name() == name && node.has_attribute("name")
    };
    // What belongs to an element itself, and not to elements that are declared within it.
    let own = |node: roxmltree::Node, top: roxmltree::Node| {
        node.ancestors().skip(1).take_while(|n| *n != top).all(|n| n.tag_name().name() != "element")
    };
    let has = |list: &str, name: &str| list.split_whitespace().any(|known| known == name);
    let mut seen = 0;
    let mut missing = BTreeSet::new();
    let mut check = |known: &table::Known, node: roxmltree::Node| {
        for part in node.descendants().filter(|part| own(*part, node)) {
            let name = part.attribute("name").unwrap_or_default();
            let left_out = |list: &[(&str, &str)]| list.iter().any(|entry| has(entry.0, name));
            let (fits, counted) = if is(&part, "attribute") {
                let counted = known.name == "vType" || has(known.idle, name);
                (has(known.taken, name) || left_out(known.left_out), counted)
            } else if is(&part, "element") {
                (
                    has(known.children, name) || left_out(known.left_out_children),
                    has(known.idle_children, name),
                )
            } else {
                continue;
            };
            if !fits && !counted {
                missing.insert(format!("{name} of <{}>", known.name));
            }
            seen += 1;
        }
    };
    // A type, and the types that it extends.
    let whole = |name: &str| {
        let base = |node: &roxmltree::Node| {
            let extension = node.descendants().find(|n| n.tag_name().name() == "extension")?;
            extension.attribute("base").filter(|base| !base.contains(':')).map(named)
        };
        std::iter::successors(Some(named(name)), base).collect::<Vec<_>>()
    };
    for (known, names) in types {
        names.iter().flat_map(|name| whole(name)).for_each(|node| check(known, node));
    }
    let walk = named("personBaseType")
        .descendants()
        .find(|n| is(n, "element") && n.attribute("name") == Some("walk"))
        .unwrap();
    check(&table::WALK, walk.children().find(roxmltree::Node::is_element).unwrap());
    assert!(seen > 300, "{seen}");
    assert!(missing.is_empty(), "{missing:#?}");
    // The reader does what the table says.
    for known in table::ELEMENTS {
        let open = |attribute: &str| match known.name {
            "routes" | "vType" | "carFollowing-*" => None,
            "busStop" => Some(format!("<busStop id=\"x\" lane=\"a_0\" {attribute}=\"1\"/>")),
            "walk" => Some(format!(
                "<person id=\"p\" depart=\"0\"><walk edges=\"a\" {attribute}=\"1\"/></person>"
            )),
            "stop" => Some(format!(
                "<vehicle id=\"p\" depart=\"0\"><route edges=\"a\"/><stop lane=\"a_0\" duration=\"1\" {attribute}=\"1\"/></vehicle>"
            )),
            "route" => Some(format!("<route id=\"x\" edges=\"a\" {attribute}=\"1\"/>")),
            "routeDistribution" => Some(format!(
                "<routeDistribution id=\"x\" {attribute}=\"1\"><route edges=\"a\"/></routeDistribution>"
            )),
            "vTypeDistribution" => Some(format!(
                "<vTypeDistribution id=\"x\" {attribute}=\"1\"><vType id=\"y\"/></vTypeDistribution>"
            )),
            "interval" => Some(format!("<interval {attribute}=\"1\"/>")),
            "person" | "personFlow" => {
                let depart = if known.name == "person" { "depart" } else { "period" };
                Some(format!(
                    "<{0} id=\"x\" {depart}=\"5\" {attribute}=\"1\"><walk edges=\"a\"/></{0}>",
                    known.name
                ))
            }
            "trip" => {
                Some(format!("<trip id=\"x\" depart=\"5\" from=\"a\" to=\"b\" {attribute}=\"1\"/>"))
            }
            name => {
                let depart = if name == "flow" { "period" } else { "depart" };
                Some(format!(
                    "<{name} id=\"x\" {depart}=\"5\" {attribute}=\"1\"><route edges=\"a\"/></{name}>"
                ))
            }
        };
        for name in known.idle.split_whitespace() {
            let text = open(name).expect("an element");
            let found = demand(&format!("<routes>{text}</routes>"))
                .unwrap_or_else(|e| panic!("{text}: {e}"));
            assert!(found.unused.contains_key(&(known.name.into(), name.into())), "{text}");
        }
        for name in known.left_out.iter().flat_map(|entry| entry.0.split_whitespace()) {
            // Zones count only without edges.
            if name.ends_with("Taz") {
                continue;
            }
            let text = open(name).expect("an element");
            let found = demand(&format!("<routes>{text}</routes>"))
                .unwrap_or_else(|e| panic!("{text}: {e}"));
            let reason = found.sources[0].not_taken.as_deref().unwrap_or_default();
            assert!(reason.contains(&format!("{name} of <{}> is not taken", known.name)), "{text}");
        }
    }
}

/// The page in the documentation has the table.
#[test]
fn the_documentation_has_the_table() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/reference/route_files.md");
    let page = std::fs::read_to_string(&file).unwrap();
    let (head, table) = page.split_once("<!-- table -->\n").expect("the table's place");
    if std::env::var_os("IWOL_UPDATE").is_some() {
        std::fs::write(&file, format!("{head}<!-- table -->\n{}", route_files())).unwrap();
    } else {
        assert_eq!(
            table,
            route_files(),
            "IWOL_UPDATE=1 cargo test the_documentation_has_the_table"
        );
    }
}
