//! Reading of route files, and the places of mistakes in them.

use super::*;

fn demand(text: &str) -> Result<Demand, Error> {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.rou.xml");
    std::fs::write(&file, text).unwrap();
    Demand::load(&[file])
}

fn mistake(text: &str) -> String {
    let message = demand(text).unwrap_err().to_string();
    message.split_once("a.rou.xml:").map_or(message.clone(), |(_, rest)| rest.to_owned())
}

#[test]
fn reads_types_routes_vehicles_and_flows() {
    let found = demand(
        "<routes>\n<vType id=\"car\" carFollowModel=\"IDM\" length=\"4.5\"/>\n\
         <vTypeDistribution id=\"mix\"><vType id=\"truck\" vClass=\"truck\" probability=\"0.25\"/></vTypeDistribution>\n\
         <vTypeDistribution id=\"all\" vTypes=\"car truck\" probabilities=\"3 1\"/>\n\
         <route id=\"r\" edges=\"a b\"/>\n<vehicle id=\"v\" depart=\"0:01:05\" route=\"r\"/>\n\
         <flow id=\"f\" type=\"all\" end=\"10\" number=\"5\" departSpeed=\"max\"><route edges=\"b\"/></flow>\n\
         <flow id=\"g\" type=\"mix\" route=\"r\" period=\"exp(0.5)\"/>\n\
         <trip id=\"t\" depart=\"4\" from=\"a\" to=\"c\" via=\"d e\"/></routes>",
    )
    .unwrap();
    let sizes: Vec<_> =
        found.types.iter().map(|kind| (kind.id.as_str(), kind.length, kind.width)).collect();
    let [car, walker] = DEFAULT_TYPES;
    assert_eq!(
        sizes,
        [(car, 5.0, 1.8), (walker, 0.215, 0.478), ("car", 4.5, 1.8), ("truck", 7.1, 2.4)]
    );
    assert_eq!(found.definitions.matches("<vType ").count(), 2);
    assert!(found.definitions.contains("carFollowModel=\"IDM\""));
    let [v, f, g, t] = &found.sources[..] else { panic!("{:?}", found.sources) };
    assert_eq!((v.begin, v.number, v.route, &v.types[..]), (65.0, 1, 0, &[(0, 1.0)][..]));
    assert_eq!((f.spacing, f.number, f.route), (Spacing::Equal(2.0), 5, 1));
    assert_eq!((f.start.speed.as_str(), f.start.lane.as_str()), ("max", "first"));
    assert_eq!(f.types, [(2, 3.0), (3, 1.0)]);
    assert_eq!((g.spacing, g.types.clone()), (Spacing::Poisson(0.5), vec![(3, 0.25)]));
    assert_eq!((t.begin, t.number), (4.0, 1));
    assert_eq!(
        found.routes[t.route].itinerary,
        Itinerary::Trip(["a", "d", "e", "c"].map(Into::into).to_vec())
    );
}

#[test]
fn reads_persons_who_walk() {
    let found = demand(
        "<routes>\n<vType id=\"child\" vClass=\"pedestrian\" width=\"0.4\"/>\n\
         <person id=\"p\" depart=\"3\"><walk edges=\"a b c\" arrivalPos=\"7\"/></person>\n\
         <personFlow id=\"f\" type=\"child\" period=\"exp(0.1)\" departPos=\"5\"><walk from=\"a\" to=\"b\"/></personFlow></routes>",
    )
    .unwrap();
    let [p, f] = &found.sources[..] else { panic!("{:?}", found.sources) };
    assert_eq!((p.begin, p.number, &p.types[..]), (3.0, 1, &[(1, 1.0)][..]));
    let walk = |edges: &[&str], depart, arrival| Itinerary::Walk {
        edges: edges.iter().map(|&e| e.into()).collect(),
        depart,
        arrival,
    };
    assert_eq!(found.routes[0].itinerary, walk(&["a", "b", "c"], 0.0, Some(7.0)));
    assert_eq!((f.route, &f.types[..]), (1, &[(2, 1.0)][..]));
    assert_eq!(found.routes[1].itinerary, walk(&["a", "b"], 5.0, None));
    assert!(found.types[2].walks);
    assert_eq!((found.types[2].length, found.types[2].width), (0.215, 0.4));
}

#[test]
fn mistakes_have_their_place() {
    let cases = [
        ("<trip id=\"t\" from=\"a\" depart=\"0\"/>", "<trip> lacks the attribute `to`"),
        ("<trip id=\"t\" depart=\"0\"/>", "<trip> lacks the attribute `from`"),
        ("<vehicle id=\"v\" depart=\"0\" route=\"r\"/>", "`r` is not a valid route of <vehicle>"),
        (
            "<vehicle id=\"v\" depart=\"triggered\"><route edges=\"a\"/></vehicle>",
            "`triggered` is not a valid depart",
        ),
        ("<flow id=\"f\"><route edges=\"a\"/></flow>", "<flow> lacks the attribute `period`"),
        ("<flow id=\"f\" period=\"0\"><route edges=\"a\"/></flow>", "`0` is not a valid period"),
        ("<vType id=\"agent\"/>", "`agent` is not a valid id of <vType>"),
        ("<vType id=\"x\" vClass=\"ship\"/>", "`ship` is not a valid vClass"),
        ("<vType id=\"x\"/><vType id=\"x\"/>", "a second vehicle type"),
        (
            "<vehicle id=\"v\" type=\"y\" depart=\"0\"><route edges=\"a\"/></vehicle>",
            "`y` is not a valid type",
        ),
        (
            "<vehicle id=\"v\" depart=\"0\"><route edges=\"a\"/><stop lane=\"a_0\"/></vehicle>",
            "unknown element `stop`",
        ),
        ("<vTypeDistribution id=\"d\"/>", "`d` is not a valid id"),
        ("<person id=\"p\" depart=\"0\"/>", "<person> lacks the element `walk`"),
        (
            "<person id=\"p\" depart=\"0\"><walk edges=\"a\"/><ride from=\"a\" to=\"b\"/></person>",
            "unknown element `ride`",
        ),
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
        ("<containerFlow id=\"c\"/>", "unknown element `containerFlow`"),
        (
            "<flow id=\"f\" period=\"1\" departSped=\"max\"><route edges=\"a\"/></flow>",
            "did you mean `departSpeed`?",
        ),
        (
            "<flow id=\"f\" period=\"1\" perHour=\"9\"><route edges=\"a\"/></flow>",
            "allowed: no value beside `period`",
        ),
        (
            "<flow id=\"f\" period=\"1\" begin=\"9\" end=\"9\"><route edges=\"a\"/></flow>",
            "allowed: a time after `begin`",
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
            "<person id=\"p\" depart=\"0\"><walk edges=\"a\"/><walk edges=\"b\"/></person>",
            "a second element <walk>",
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

#[test]
fn attributes_without_effect_are_counted() {
    let found = demand(
        "<routes><vType id=\"t\" maxSped=\"3\" sigma=\"0\"/>\n<route id=\"r\" edges=\"a\" color=\"red\"/>\n\
         <vehicle id=\"v\" depart=\"0\" route=\"r\" arrivalPos=\"5\"/>\n\
         <vehicle id=\"w\" depart=\"0\" route=\"r\" arrivalPos=\"6\"/></routes>",
    )
    .unwrap();
    let unused: Vec<_> = found
        .unused
        .iter()
        .map(|((element, key), (count, place))| (&**element, &**key, *count, place.line))
        .collect();
    let expected =
        [("route", "color", 1, 2), ("vType", "maxSped", 1, 1), ("vehicle", "arrivalPos", 2, 3)];
    assert_eq!(unused, expected);
}
