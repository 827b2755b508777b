//! Places of mistakes in route files.

use super::*;

#[test]
fn mistakes_have_their_place() {
    let cases = [
        ("<trip id=\"t\" depart=\"0\"/>", "<trip> lacks the attribute `from`"),
        ("<vehicle id=\"v\" depart=\"0\" route=\"r\"/>", "`r` is not a valid route of <vehicle>"),
        (
            "<vehicle id=\"v\" depart=\"trigered\"><route edges=\"a\"/></vehicle>",
            "`trigered` is not a valid depart",
        ),
        ("<flow id=\"f\"><route edges=\"a\"/></flow>", "<flow> lacks the attribute `period`"),
        ("<flow id=\"f\" period=\"0\"><route edges=\"a\"/></flow>", "`0` is not a valid period"),
        ("<vType id=\"agent\"/>", "`agent` is not a valid id of <vType>"),
        ("<vType id=\"x\" vClass=\"shipp\"/>", "`shipp` is not a valid vClass"),
        ("<vType id=\"x\"/><vType id=\"x\"/>", "a second vehicle type"),
        ("<vType id=\"x\" accel=\"nan\"/>", "`nan` is not a valid accel of <vType>"),
        ("<vType id=\"x\" decel=\"-4\"/>", "`-4` is not a valid decel of <vType>"),
        (
            "<vType id=\"x\"><carFollowing-Krauss sigma=\"5\"/></vType>",
            "`5` is not a valid sigma of <carFollowing-Krauss>",
        ),
        (
            "<vehicle id=\"v\" type=\"y\" depart=\"0\"><route edges=\"a\"/></vehicle>",
            "`y` is not a valid type",
        ),
        (
            "<vehicle id=\"v\" depart=\"0\"><route edges=\"a\"/><stop lane=\"a_0\"/></vehicle>",
            "<stop> lacks the attribute `duration`",
        ),
        ("<vTypeDistribution id=\"d\"/>", "`d` is not a valid id"),
        ("<person id=\"p\" depart=\"0\"/>", "<person> lacks the element `walk`"),
        (
            "<person id=\"p\" type=\"DEFAULT_VEHTYPE\" depart=\"0\"><walk edges=\"a\"/></person>",
            "not a valid type",
        ),
        (
            "<vehicle id=\"v\" type=\"DEFAULT_PEDTYPE\" depart=\"0\"><route edges=\"a\"/></vehicle>",
            "not a valid type",
        ),
        ("<vType id=\"DEFAULT_PEDTYPE\" vClass=\"bus\"/>", "`bus` is not a valid vClass"),
        (
            "<personFlow id=\"f\" period=\"9\"><walk from=\"a\"/></personFlow>",
            "<walk> lacks the attribute `to`",
        ),
        (
            "<vehicle id=\"v\" depart=\"0\" departLane=\"fre\"><route edges=\"a\"/></vehicle>",
            "did you mean `free`?",
        ),
        (
            "<vehicle id=\"v\" depart=\"0\" departLane=\"1.5\"><route edges=\"a\"/></vehicle>",
            "`1.5` is not a valid departLane",
        ),
        (
            "<vehicle id=\"v\" depart=\"0\" departEdge=\"free\"><route edges=\"a\"/></vehicle>",
            "`free` is not a valid departEdge",
        ),
        (
            "<routeDistribution id=\"d\" routes=\"a\"/>",
            "`a` is not a valid routes of <routeDistribution>",
        ),
        (
            "<trip id=\"t\" depart=\"0\" from=\"a\" to=\"b\"/><trip id=\"t\" depart=\"0\" from=\"a\" to=\"b\"/>",
            "a second vehicle or flow with the id `t`",
        ),
        (
            "<include href=\"b.xml\"/>",
            "<include> in <routes> is not taken: name the file in `files`",
        ),
        ("<busStop id=\"b\"/>", "<busStop> lacks the attribute `lane`"),
        ("<vehicel id=\"v\"/>", "did you mean `vehicle`?"),
        ("<vType id=\"x\" vClass=\"trukc\"/>", "did you mean `truck`?"),
        ("<vType id=\"x\"><carFollowing-IDN/></vType>", "did you mean `carFollowing-IDM`?"),
        (
            "<flow id=\"f\" period=\"1\" departSped=\"max\"><route edges=\"a\"/></flow>",
            "did you mean `departSpeed`?",
        ),
        (
            "<flow id=\"f\" period=\"1\" perHour=\"9\"><route edges=\"a\"/></flow>",
            "allowed: no value beside `period`",
        ),
        (
            "<flow id=\"f\" period=\"1\" begin=\"9\" end=\"8\"><route edges=\"a\"/></flow>",
            "allowed: `begin` or a time after it",
        ),
        (
            "<flow id=\"f\" period=\"1\" depart=\"1\"><route edges=\"a\"/></flow>",
            "`1` is not a valid depart",
        ),
        (
            "<vehicle id=\"v\" depart=\"0\" from=\"a\" to=\"b\"><route edges=\"a\"/></vehicle>",
            "allowed: no value beside a route",
        ),
        (
            "<person id=\"p\" depart=\"0\"><walk edges=\"a\" from=\"a\" to=\"b\"/></person>",
            "allowed: no value beside `from` and `to`",
        ),
    ];
    for (text, expected) in cases {
        let found = mistake(&format!("<routes>\n{text}</routes>"));
        assert!(found.starts_with("2:") && found.contains(expected), "{text}: {found}");
    }
}

/// The time to read a file grows with its size, and not with the square of it: 20,000 trips take a
/// second or two, where a search from the file's beginning for each place takes minutes.
#[test]
fn places_are_found_in_long_files() {
    let line = |i| format!("\n<trip id=\"t\u{e4}{i}\" depart=\"{i}\" from=\"a\" to=\"b\"/>");
    let text = format!("<routes>{}</routes>", (0..20_000).map(line).collect::<String>());
    let begin = std::time::Instant::now();
    let found = demand(&text).unwrap();
    assert!(begin.elapsed().as_secs() < 60, "{:?}", begin.elapsed());
    let last = &found.sources[19_999].place;
    let xml = roxmltree::Document::parse(&text).unwrap();
    let trip = xml.root_element().last_element_child().unwrap();
    let at = xml.text_pos_at(trip.attribute_node("from").unwrap().range().start);
    let from = &found.routes[19_999].place;
    assert_eq!((last.line, last.column, from.line, from.column), (20_001, 1, at.row, at.col));
}

#[test]
fn a_message_of_sumo_leads_to_the_type_that_it_is_about() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.rou.xml");
    std::fs::write(
        &file,
        "<routes>\n<vType id=\"a\" accel=\"2\"/>\n<vType id=\"b\"\n color=\"blurple\"/>\n<vType id=\"c\" accel=\"fast\"/>\n\
         <vType id=\"d\" guiShape=\"ship\"/></routes>",
    )
    .unwrap();
    let line = |message: &str| {
        Demand::blamed(std::slice::from_ref(&file), message).map(|place| place.line)
    };
    assert_eq!(line("Invalid color definition 'blurple'"), Some(4));
    assert_eq!(line("The shape 'ship' for vType 'd' is not known."), Some(6));
    assert_eq!(
        line("Invalid Car-Following-Model Attribute accel. Cannot be parsed to float"),
        Some(5)
    );
    assert_eq!(line("sumo ended"), None);
}
