//! Tests of warnings about what is allowed and of no effect.

use super::*;

/// Vehicles that observations were not made for are named.
#[test]
fn long_and_fast_vehicles_are_told() {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let text = std::fs::read_to_string(root.join("scenarios/flow_cross.xml")).unwrap();
    let nets = root.join("sumo_nets");
    let text = text.replace("../sumo_nets", nets.to_str().unwrap());
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.xml");
    let kinds = |from: &str, to: &str| -> Vec<&'static str> {
        std::fs::write(&file, text.replacen(from, to, 1)).unwrap();
        let kinds = Scenario::check(&file).list.into_iter().map(|finding| finding.kind);
        kinds.filter(|kind| ["long-vehicle", "fast-vehicle"].contains(kind)).collect()
    };
    assert!(kinds("length=", "length=").is_empty());
    assert_eq!(kinds("length=\"4.515\"", "length=\"16.5\""), ["long-vehicle"]);
    assert_eq!(kinds("maxSpeed=\"22.222\"", "maxSpeed=\"33\""), ["fast-vehicle"]);
}

#[test]
fn attributes_that_others_make_ineffective_are_named() {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let text = std::fs::read_to_string(root.join("scenarios/intersection.xml")).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.xml");
    let changed = text.replacen("wreckTime=", "border=\"kerb\" wreckTime=", 1).replacen(
        "conflictStreams=",
        "foresight=\"4\" lidarRange=\"50\" conflictStreams=",
        1,
    );
    let idle = |text: &str| -> Vec<String> {
        std::fs::write(&file, text).unwrap();
        let messages = Scenario::check(&file).list.into_iter().map(|finding| finding.message);
        messages.filter(|message| message.contains("has no effect")).collect()
    };
    assert!(idle(&text).is_empty());
    let expected = [
        "foresight of <observation> has no effect, because encounters is 0",
        "border of <termination> has no effect, because vehicles do not steer and observe no borders",
    ];
    assert_eq!(idle(&changed), expected);
    // Lidar sees the border.
    let seen = text.replacen("wreckTime=", "border=\"kerb\" wreckTime=", 1);
    assert_eq!(idle(&seen).len(), 1);
    assert!(
        idle(&seen.replacen("conflictStreams=", "lidarBeams=\"16\" conflictStreams=", 1))
            .is_empty()
    );
    // Without cooperation, agents share nothing, near or far.
    let near = text.replacen("<reward ", "<reward shareRange=\"50\" ", 1);
    assert!(idle(&near).is_empty());
    let alone = near.replacen("cooperation=\"0.06\"", "cooperation=\"0\"", 1);
    assert_eq!(idle(&alone), ["shareRange of <reward> has no effect, because cooperation is 0"]);
}

/// SUMO ignores vehicles that depart earlier than one before them in their file; here they drive.
#[test]
fn files_that_are_not_sorted_are_told() {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let text = std::fs::read_to_string(root.join("scenarios/flow_cross.xml")).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let text = text
        .replace("../sumo_nets/flow_cross/cars.rou.xml", "a.rou.xml")
        .replace("../sumo_nets", root.join("sumo_nets").to_str().unwrap());
    let told = |departures: [&str; 4]| -> Vec<String> {
        let vehicle = |(k, depart): (usize, &&str)| {
            format!("<vehicle id=\"v{k}\" type=\"car\" route=\"r\" depart=\"{depart}\"/>")
        };
        let vehicles: String = departures.iter().enumerate().map(vehicle).collect();
        let start = "<vType id=\"car\"/><route id=\"r\" edges=\"west_in east_out\"/>";
        let routes = format!("<routes>{start}{vehicles}</routes>");
        std::fs::write(folder.path().join("a.rou.xml"), routes).unwrap();
        let file = folder.path().join("a.xml");
        std::fs::write(&file, &text).unwrap();
        let findings = Scenario::check(&file).list;
        let unsorted = findings.into_iter().filter(|finding| finding.kind == "unsorted");
        unsorted.map(|finding| finding.message).collect()
    };
    assert!(told(["0", "1", "1", "2"]).is_empty());
    let messages = told(["0", "5", "3", "4"]);
    assert!(
        messages.len() == 1 && messages[0].contains("ignores 2 of its vehicles and flows"),
        "{messages:?}"
    );
    assert!(messages[0].contains("such as `v2`"), "{messages:?}");
}
