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
        ("<vType id=\"x\" vClass=\"shipp\"/>", "`shipp` is not a valid vClass"),
        ("<vType id=\"x\"/><vType id=\"x\"/>", "a second vehicle type"),
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
            "<person id=\"p\" depart=\"0\"><walk edges=\"a\"/><ride from=\"a\" to=\"b\"/></person>",
            "<ride> in <person> is not taken: a person has one <walk> here",
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
        ("<containerFlow id=\"c\"/>", "<containerFlow> in <routes> is not taken"),
        (
            "<flow id=\"f\" period=\"1\" fromTaz=\"a\" toTaz=\"b\"/>",
            "fromTaz of <flow> is not taken: zones are not taken: make trips or routes of the zones with SUMO's duarouter",
        ),
        (
            "<vehicle id=\"v\" depart=\"0\"><route edges=\"a\"><stop busStop=\"b\" duration=\"1\"/></route></vehicle>",
            "busStop of <stop> is not taken",
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
    assert_eq!(found.routes[0].stops.len(), 3);
    let stop = &found.routes[0].stops[0];
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
    assert!(found.unused.contains_key(&("additional".into(), "<busStop>".into())));
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
    let half = mistake(
        "<routes>\n<trip id=\"t\" depart=\"0\" from=\"a\" fromTaz=\"y\" toTaz=\"z\"/></routes>",
    );
    assert!(half.starts_with("2:") && half.contains("toTaz of <trip> is not taken"), "{half}");
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

#[test]
fn those_who_depart_outside_of_an_episode_are_counted() {
    let counts = |text: &str| {
        let plan = plan(text);
        (plan.wanted, plan.outside)
    };
    let trip = |id, depart| {
        format!("<trip id=\"{id}\" depart=\"{depart}\" from=\"west_in\" to=\"east_out\"/>")
    };
    let none = "<flow id=\"f\" number=\"0\" end=\"9\" from=\"west_in\" to=\"east_out\"/>";
    assert_eq!(counts(&(trip("a", 0) + &trip("b", 500) + none)), (1, 1));
    let empty = demand(&format!("<routes>{none}</routes>")).unwrap();
    assert_eq!(empty.first_departure(), None);
}

#[test]
fn episodes_begin_where_the_scenario_says() {
    let found = demand(
        "<routes><route id=\"r\" edges=\"a\"/><vehicle id=\"v\" depart=\"07:00:10\" route=\"r\"/>\
         <flow id=\"f\" route=\"r\" begin=\"25190\" end=\"25300\" period=\"4\" number=\"20\"/>\
         <flow id=\"g\" route=\"r\" begin=\"0\" probability=\"0.5\"/></routes>",
    )
    .unwrap();
    let within = |begin, horizon| -> Vec<_> {
        found.sources.iter().map(|source| source.within(begin, horizon)).collect()
    };
    assert_eq!(within(0.0, 100.0), [None, None, Some((0.0, u64::MAX))]);
    let late = within(25_200.0, 100.0);
    assert_eq!(late, [Some((10.0, 1)), Some((2.0, 17)), Some((0.0, u64::MAX))]);
    assert_eq!(within(25_211.0, 100.0)[0], None);
    assert_eq!(within(25_270.0, 100.0)[1], None, "all twenty have departed");
}

fn crossing() -> net::Net {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    net::Net::load(&root.join("sumo_nets/intersection_turns/two_lanes.net.xml")).unwrap()
}

/// Returns the plan of a file for the crossing, with the edges that it has for `IN` and `OUT`.
fn plan(text: &str) -> DemandPlan {
    let found = demand(&format!("<routes>{text}</routes>")).unwrap();
    found.plan(&crossing(), 0.0, 100.0).unwrap()
}

#[test]
fn vehicles_that_cannot_be_used_are_left_out_with_their_lines() {
    let net = crossing();
    let edges: Vec<&str> = net.roads().map(|edge| edge.id.as_str()).collect();
    let (from, to) = ("west_in", "east_out");
    assert!(edges.contains(&from) && edges.contains(&to), "{edges:?}");
    let cases = [
        (
            format!("<vehicle id=\"v\" depart=\"0\"><route edges=\"{from} {from}\"/></vehicle>"),
            "does not lead to",
        ),
        (
            format!("<vehicle id=\"v\" depart=\"0\"><route edges=\"{from} nowhere\"/></vehicle>"),
            "no edge `nowhere`",
        ),
        (
            format!("<trip id=\"v\" depart=\"0\" from=\"{from}\" to=\"{to}\" departSpeed=\"99\"/>"),
            "drives at most 55.56 m/s",
        ),
        (
            format!("<trip id=\"v\" depart=\"0\" from=\"{from}\" to=\"{to}\" departLane=\"7\"/>"),
            "departLane is 7",
        ),
        (
            format!("<trip id=\"v\" depart=\"0\" from=\"{from}\" to=\"{to}\" arrivalLane=\"7\"/>"),
            "arrivalLane is 7",
        ),
        (
            format!("<trip id=\"v\" depart=\"0\" from=\"{from}\" to=\"{to}\" departPos=\"-999\"/>"),
            "departPos is -999 m",
        ),
        (
            format!("<trip id=\"v\" depart=\"0\" from=\"{from}\" to=\"{to}\" departEdge=\"2\"/>"),
            "the route has 2 edges",
        ),
        (
            format!(
                "<trip id=\"v\" depart=\"0\" from=\"{from}\" to=\"{to}\" departEdge=\"1\" arrivalEdge=\"0\"/>"
            ),
            "before departEdge",
        ),
        (
            format!(
                "<vehicle id=\"v\" depart=\"0\"><route edges=\"{from} {to}\"/><stop lane=\"north_in_0\" duration=\"1\"/></vehicle>"
            ),
            "is not on its route",
        ),
        (
            format!(
                "<vehicle id=\"v\" depart=\"0\"><route edges=\"{from} {to}\"/><stop lane=\"{from}_0\" endPos=\"999\" duration=\"1\"/></vehicle>"
            ),
            "friendlyPos",
        ),
        (
            format!("<trip id=\"v\" depart=\"0\" fromJunction=\"nowhere\" to=\"{to}\"/>"),
            "no junction `nowhere`",
        ),
    ];
    let stop = |edge, end| format!("<stop lane=\"{edge}_0\" endPos=\"{end}\" duration=\"1\"/>");
    let route = format!("<route edges=\"{from} {to}\"/>");
    let more = [
        (
            format!(
                "<vType id=\"t\" vClass=\"tram\"/><vehicle id=\"v\" type=\"t\" depart=\"0\">{route}</vehicle>"
            ),
            "vehicles of class `tram` are not taken",
        ),
        (
            format!(
                "<vehicle id=\"v\" depart=\"0\">{route}{}{}</vehicle>",
                stop(from, 40),
                stop(from, 20)
            ),
            "`west_in` at 20 m lies before the stop above it",
        ),
        (
            format!(
                "<vehicle id=\"v\" depart=\"0\">{route}{}{}</vehicle>",
                stop(to, 20),
                stop(from, 40)
            ),
            "`west_in` at 40 m lies before the stop above it",
        ),
        (
            format!(
                "<vehicle id=\"v\" depart=\"0\" departPos=\"30\">{route}{}</vehicle>",
                stop(from, 20)
            ),
            "`west_in` at 20 m lies before its departPos",
        ),
    ];
    for (text, expected) in cases.into_iter().chain(more) {
        let plan = plan(&format!(
            "\n<trip id=\"good\" depart=\"0\" from=\"{from}\" to=\"{to}\"/>\n{text}"
        ));
        let [out] = &plan.left_out[..] else { panic!("{text}: {:?}", plan.left_out) };
        assert!(out.reason.contains(expected), "{text}: {}", out.reason);
        assert_eq!((out.id.as_str(), out.place.line, plan.sources.len()), ("v", 3, 1));
        let (message, _) = plan.warning().unwrap();
        assert!(
            message.starts_with("1 of 2 vehicles, persons and flows of the route files left out: ")
                && message.contains("`v` (line 3: "),
            "{message}"
        );
    }
}

#[test]
fn equal_paths_are_one_route() {
    let trip = |i| {
        let depart = f64::from(i) / 40.0;
        format!("<trip id=\"t{i}\" depart=\"{depart}\" from=\"west_in\" to=\"east_out\"/>\n")
    };
    let trips = (0..3000).map(trip).collect::<Vec<_>>().concat();
    let many = plan(&trips);
    assert_eq!((many.routes.len(), many.sources.len(), many.left_out.len()), (1, 3000, 0));
    let parts = plan(
        "<flow id=\"f\" period=\"1\" departEdge=\"random\"><route edges=\"west_in east_out\"/></flow>",
    );
    assert_eq!(parts.routes.iter().map(|laid| laid.edges.len()).collect::<Vec<_>>(), [2, 1]);
    assert_eq!(parts.sources[0].departures, [(Some(0), 0.5), (Some(1), 0.5)]);
    let lanes = plan(
        "<trip id=\"a\" depart=\"0\" from=\"west_in\" to=\"east_out\" departLane=\"0\"/>\
         <trip id=\"b\" depart=\"0\" from=\"west_in\" to=\"east_out\" departLane=\"1\"/>\
         <routeDistribution id=\"d\"><route edges=\"west_in east_out\"/><route edges=\"west_in nowhere\"/></routeDistribution>\
         <flow id=\"f\" period=\"1\" route=\"d\"/>",
    );
    assert!(
        lanes.left_out.len() == 1 && lanes.left_out[0].reason.contains("its other routes are used")
    );
    assert_eq!(
        lanes.sources[2].departures.iter().map(|entry| entry.0.is_some()).collect::<Vec<_>>(),
        [true, false]
    );
    assert_eq!(lanes.routes.len(), 2, "a route for each lane");
}

/// Every element and attribute of SUMO's own schema is taken, refused with its line, or counted for
/// a warning.
#[test]
fn the_table_has_all_of_sumos_schema() {
    let folder =
        std::env::var_os("SUMO_HOME").map_or("/usr/share/sumo".into(), std::path::PathBuf::from);
    let text =
        std::fs::read_to_string(folder.join("data/xsd/routeTypes.xsd")).expect("SUMO's schema");
    let xsd = roxmltree::Document::parse(&text).unwrap();
    let root =
        std::fs::read_to_string(folder.join("data/xsd/routes_file.xsd")).expect("SUMO's schema");
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
        (&table::FLOW, &["flowType", "flowWithoutIDType"]),
        (&table::INTERVAL, &["flowIntervalType"]),
        (&table::STOP, &["stopType"]),
        (&table::PERSON, &["personType", "personBaseType"]),
        (&table::PERSON_FLOW, &["personFlowType", "personBaseType"]),
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
    let mut check = |known: &table::Known, node: roxmltree::Node| {
        for part in node.descendants().filter(|part| own(*part, node)) {
            let name = part.attribute("name").unwrap_or_default();
            let refused = |list: &[(&str, &str)]| list.iter().any(|entry| has(entry.0, name));
            let (fits, counted) = if is(&part, "attribute") {
                let counted = known.name == "vType" || has(known.idle, name);
                (has(known.taken, name) || refused(known.refused), counted)
            } else if is(&part, "element") {
                (
                    has(known.children, name) || refused(known.refused_children),
                    has(known.idle_children, name),
                )
            } else {
                continue;
            };
            assert!(fits || counted, "{} of <{}>", name, known.name);
            seen += 1;
        }
    };
    for (known, names) in types {
        names.iter().for_each(|name| check(known, named(name)));
    }
    let walk = named("personBaseType")
        .descendants()
        .find(|n| is(n, "element") && n.attribute("name") == Some("walk"))
        .unwrap();
    check(&table::WALK, walk.children().find(roxmltree::Node::is_element).unwrap());
    assert!(seen > 300, "{seen}");
    // The reader does what the table says.
    for known in table::ELEMENTS {
        let open = |attribute: &str| match known.name {
            "routes" | "vType" | "carFollowing-*" => None,
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
        for name in known.refused.iter().flat_map(|entry| entry.0.split_whitespace()) {
            // Zones are refused only without edges.
            if name.ends_with("Taz") {
                continue;
            }
            let text = open(name).expect("an element");
            let message = mistake(&format!("<routes>\n{text}</routes>"));
            assert!(
                message.starts_with("2:")
                    && message.contains(&format!("{name} of <{}> is not taken", known.name)),
                "{message}"
            );
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
