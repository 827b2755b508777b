//! Reading of route files.

use super::*;

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
    assert_eq!(
        (v.begin, v.number, &v.routes[..], &v.types[..]),
        (65.0, 1, &[(0, 1.0)][..], &[(0, 1.0)][..])
    );
    assert_eq!((v.id.as_str(), v.element, v.place.line), ("v", "vehicle", 6));
    assert_eq!((f.spacing, f.number, &f.routes[..]), (Spacing::Equal(2.0), 5, &[(1, 1.0)][..]));
    assert_eq!((f.start.speed.as_str(), f.start.lane.as_str()), ("max", "first"));
    assert_eq!(f.types, [(2, 3.0), (3, 1.0)]);
    assert_eq!((g.spacing, g.types.clone()), (Spacing::Poisson(0.5), vec![(3, 0.25)]));
    assert_eq!((t.begin, t.number), (4.0, 1));
    let [from, to] = ["a", "c"].map(|id| Terminal::Edge(id.into()));
    let via = ["d", "e"].map(Into::into).to_vec();
    assert_eq!(found.routes[t.routes[0].0].itinerary, Itinerary::Trip { from, via, to });
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
    assert_eq!((f.routes[0].0, &f.types[..]), (1, &[(2, 1.0)][..]));
    assert_eq!(found.routes[1].itinerary, walk(&["a", "b"], 5.0, None));
    assert!(found.types[2].walks);
    assert_eq!((found.types[2].length, found.types[2].width), (0.215, 0.4));
}

#[test]
fn attributes_without_effect_are_counted() {
    let found = demand(
        "<routes><vType id=\"t\" maxSped=\"3\" sigma=\"0\"/>\n<route id=\"r\" edges=\"a\" color=\"red\"/>\n\
         <vehicle id=\"v\" depart=\"0\" route=\"r\" departPosLat=\"left\"/>\n\
         <vehicle id=\"w\" depart=\"0\" route=\"r\" departPosLat=\"left\"><param key=\"a\" value=\"b\"/></vehicle></routes>",
    )
    .unwrap();
    let unused: Vec<_> = found
        .unused
        .iter()
        .map(|((element, key), (count, place))| (&**element, &**key, *count, place.line))
        .collect();
    let expected = [
        ("route", "color", 1, 2),
        ("vType", "maxSped", 1, 1),
        ("vehicle", "<param>", 1, 4),
        ("vehicle", "departPosLat", 2, 3),
    ];
    assert_eq!(unused, expected);
}

#[test]
fn distributions_repetitions_stops_and_intervals_are_read() {
    let found = demand(
        "<routes><route id=\"a\" edges=\"a b\" repeat=\"2\"><stop lane=\"b_1\" endPos=\"-5\" until=\"0:01:00\"/></route>\n\
         <routeDistribution id=\"d\"><route id=\"b\" edges=\"b\" probability=\"3\"/><route refId=\"a\"/></routeDistribution>\n\
         <routeDistribution id=\"e\" routes=\"d a\" probabilities=\"0.5 1\"/>\n\
         <interval begin=\"10\" end=\"20\"><flow id=\"f\" route=\"e\" number=\"5\" departEdge=\"random\" arrivalEdge=\"1\"/></interval>\n\
         <flow id=\"g\" route=\"b\" number=\"2\"/>\n\
         <trip id=\"t\" depart=\"0\" fromJunction=\"j\" to=\"c\"><stop edge=\"x\" duration=\"4\"/></trip></routes>",
    )
    .unwrap();
    let [f, g, t] = &found.sources[..] else { panic!("{:?}", found.sources) };
    assert_eq!(
        found.routes[0].itinerary,
        Itinerary::Route(["a", "b"].repeat(3).into_iter().map(Into::into).collect())
    );
    let stops = found.routes[0].stops.as_ref().unwrap();
    assert_eq!(stops.len(), 3);
    let stop = &stops[0];
    assert_eq!(
        (stop.edge.as_str(), stop.lane, stop.end, stop.until),
        ("b", Some(1), Some(-5.0), Some(60.0))
    );
    assert_eq!(f.routes, [(1, 1.5), (0, 0.5), (0, 1.0)]);
    assert_eq!((f.begin, f.end, f.spacing), (10.0, 20.0, Spacing::Equal(2.0)));
    assert_eq!((f.depart_edge, f.arrival_edge), (RouteEdge::Random, RouteEdge::Index(1)));
    assert_eq!(g.spacing, Spacing::Equal(43_200.0), "SUMO lets them depart within a day");
    let (from, to) = (Terminal::Junction("j".into()), Terminal::Edge("c".into()));
    let trip = Itinerary::Trip { from, via: vec!["x".into()], to };
    assert_eq!(found.routes[t.routes[0].0].itinerary, trip);
}

#[test]
fn types_may_stand_in_another_file() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        path
    };
    let types = write(
        "a.add.xml",
        "<additional><vType id=\"t\"/><route id=\"r\" edges=\"a\"/><busStop id=\"b\" lane=\"a_0\"/></additional>",
    );
    let vehicles = write(
        "b.rou.xml",
        "<routes><vehicle id=\"v\" type=\"t\" depart=\"0\" route=\"r\"/></routes>",
    );
    let found = Demand::load(&[&types, &vehicles]).unwrap();
    assert_eq!((found.sources.len(), found.types[2].id.as_str()), (1, "t"));
    let message = Demand::load(&[vehicles, types]).unwrap_err().to_string();
    assert!(message.contains("`t` is not a valid type"), "{message}");
}

/// What SUMO's own tools write beside the values that count.
#[test]
fn zones_beside_edges_and_false_flags_are_counted_or_taken() {
    let found = demand(
        "<trips><trip id=\"t\" depart=\"0\" from=\"a\" to=\"b\" fromTaz=\"y\" toTaz=\"z\"/>\
         <vehicle id=\"v\" depart=\"0\" fromTaz=\"y\" toTaz=\"z\"><route edges=\"a\"/>\
         <stop lane=\"a_0\" duration=\"1\" triggered=\"false\"/></vehicle></trips>",
    )
    .unwrap();
    let keys: Vec<_> =
        found.unused.keys().map(|(element, key)| format!("{element} {key}")).collect();
    assert_eq!(keys, ["trip fromTaz", "trip toTaz", "vehicle fromTaz", "vehicle toTaz"]);
    let half =
        "<routes><trip id=\"t\" depart=\"0\" from=\"a\" fromTaz=\"y\" toTaz=\"z\"/></routes>";
    let half = demand(half).unwrap().sources[0].not_taken.clone().unwrap();
    assert!(half.contains("toTaz of <trip> is not taken"), "{half}");
}

/// SUMO's `cross` and `ramp`, among others, have such files.
#[test]
fn a_distribution_may_be_the_default_type() {
    let found = demand(
        "<add><vTypeDistribution id=\"DEFAULT_VEHTYPE\"><vType id=\"car\" probability=\"3\"/>\
         <vType id=\"bus\" vClass=\"bus\" probability=\"1\"/></vTypeDistribution>\
         <trip id=\"t\" depart=\"0\" from=\"a\" to=\"b\"/></add>",
    )
    .unwrap();
    assert_eq!(found.sources[0].types, [(2, 3.0), (3, 1.0)]);
    let twice = "<routes>\n<vTypeDistribution id=\"DEFAULT_VEHTYPE\"><vType id=\"p\" vClass=\"pedestrian\"/></vTypeDistribution></routes>";
    assert!(mistake(twice).starts_with("2:"), "{}", mistake(twice));
}

#[test]
fn stops_at_stopping_places_are_where_these_are() {
    let found = demand(
        "<additional><busStop id=\"b\" lane=\"a_1\" startPos=\"5\" endPos=\"-3\" friendlyPos=\"true\"/>\
         <busStop id=\"c\" lane=\"c_0\"/>\
         <parkingArea id=\"b\" lane=\"a_0\" endPos=\"9\"/><parkingArea id=\"on\" lane=\"a_0\" onRoad=\"1\"/>\
         <route id=\"r\" edges=\"a b\"><stop busStop=\"b\" duration=\"8\"/></route>\
         <trip id=\"t\" depart=\"0\"><stop busStop=\"b\" until=\"70\"/><stop busStop=\"c\" duration=\"1\"/></trip>\
         <vehicle id=\"p\" route=\"r\" depart=\"0\"><stop parkingArea=\"b\" duration=\"1\"/><stop parkingArea=\"on\" duration=\"2\"/></vehicle>\
         <vehicle id=\"v\" route=\"r\" depart=\"0\"><stop busStop=\"d\" duration=\"1\"/></vehicle></additional>",
    )
    .unwrap();
    let stop = &found.routes[0].stops.as_ref().unwrap()[0];
    assert_eq!(
        (stop.edge.as_str(), stop.lane, stop.start, stop.end),
        ("a", Some(1), Some(5.0), Some(-3.0))
    );
    assert_eq!((stop.friendly, stop.duration, stop.until, stop.parking), (true, 8.0, None, false));
    let [t, p, v] = &found.sources[..] else { panic!("{:?}", found.sources) };
    let ends = ["a", "c"].map(|id| Terminal::Edge(id.into()));
    let [from, to] = ends;
    let trip = Itinerary::Trip { from, via: Vec::new(), to };
    assert_eq!(found.routes[t.routes[0].0].itinerary, trip, "from the first stop to the last");
    assert_eq!((t.stops[0].until, t.stops[1].start, t.stops[1].end), (Some(70.0), Some(0.0), None));
    assert_eq!(p.stops.iter().map(|stop| stop.parking).collect::<Vec<_>>(), [true, false]);
    let why = v.not_taken.as_deref().unwrap();
    assert!(why.starts_with("no busStop `d` of its stop stands above"), "{why}");
}

#[test]
fn a_flow_may_end_where_it_begins() {
    let found = demand(
        "<routes><flow id=\"f\" begin=\"5\" end=\"5\" number=\"3\" from=\"a\" to=\"b\"/>\
         <flow id=\"g\" begin=\"5\" end=\"5\" period=\"3\" from=\"a\" to=\"b\"/></routes>",
    )
    .unwrap();
    let within: Vec<_> = found.sources.iter().map(|source| source.within(5.0, 9.0)).collect();
    assert_eq!(within, [Some((0.0, 3)), None]);
    assert_eq!(found.sources[0].within(6.0, 9.0), None);
}
