//! The documentation of the file format.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use iwol_sumo::scenario::{self, Element, Scenario};

use crate::support::root;

#[test]
fn the_page_on_scenario_files_is_what_the_schema_says() {
    let page = fs::read_to_string(root().join("docs/reference/scenario.md")).unwrap();
    assert!(
        page == scenario::markdown(),
        "out of date: run `iwol scenario reference > docs/reference/scenario.md`"
    );
    for element in scenario::describe().all() {
        assert!(!element.text.is_empty(), "<{}> is not explained", element.name);
        for attribute in &element.attributes {
            assert!(
                !attribute.text.is_empty(),
                "{} of <{}> is not explained",
                attribute.name,
                element.name
            );
        }
    }
}

/// Returns the names of attributes and elements that the reader's error messages list as valid, by
/// parent element.
fn accepted(text: &str) -> BTreeMap<String, BTreeSet<String>> {
    let mut accepted = BTreeMap::<String, BTreeSet<String>>::new();
    let document = roxmltree::Document::parse(text).unwrap();
    for node in document.descendants().filter(roxmltree::Node::is_element) {
        let name = node.tag_name().name();
        let at = node.range().start + 1 + name.len();
        for extra in [" zzz=\"1\"", "><zzz/></"] {
            let damaged = if extra.starts_with(' ') {
                format!("{}{extra}{}", &text[..at], &text[at..])
            } else {
                // The new child goes into the element, whether the element is empty or not.
                let open = at + text[at..].find('>').unwrap();
                match text[..open].strip_suffix('/') {
                    Some(start) => format!("{start}><zzz/></{name}{}", &text[open..]),
                    None => format!("{}<zzz/>{}", &text[..=open], &text[open + 1..]),
                }
            };
            let error = Scenario::parse(&damaged, Path::new("x.xml")).unwrap_err();
            let iwol_sumo::scenario::Error::Unknown { valid, key, .. } = error else {
                panic!("{name}: {error}")
            };
            assert_eq!(key, "zzz");
            accepted
                .entry(name.to_owned())
                .or_default()
                .extend(valid.iter().map(ToString::to_string));
        }
    }
    accepted
}

#[test]
fn all_that_the_reader_accepts_is_documented_and_nothing_else() {
    let text = fs::read_to_string(root().join("scenarios/intersection_turns_small.xml")).unwrap();
    let kind = "<kind id=\"a\" share=\"1\" length=\"1\" width=\"1\" maxSpeed=\"1\" accel=\"1\" brake=\"1:1\"/>";
    let more = "<occlusion file=\"a\"/><traffic penetration=\"0.5\"/></scenario>";
    let vehicle = |end: &str| format!("maxSpeed=\"22.222\"{end}");
    let with_kind = text.replace(&vehicle("/>"), &vehicle(&format!(">{kind}</vehicle>")));
    let accepted = accepted(&with_kind.replace("</scenario>", more));
    let describe = |element: &Element| {
        let attributes = element.attributes.iter().map(|attribute| attribute.name.clone());
        (
            element.name.clone(),
            attributes.chain(element.children.iter().map(|child| child.name.clone())).collect(),
        )
    };
    let documented: BTreeMap<String, BTreeSet<String>> =
        scenario::describe().all().into_iter().map(describe).collect();
    assert_eq!(accepted, documented);
}
