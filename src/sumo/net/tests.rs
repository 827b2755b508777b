//! Tests of the net reader and of paths.

use std::{f64::consts::FRAC_PI_2, path::Path as FilePath};

use proptest::prelude::*;

use super::{
    CARS, DEFAULT_LANE_WIDTH, EdgeFunction, Net, NetError, Path, Problem, XmlError, nearest,
};

/// A net with two lanes before a bend: only lane 1 of `a` leads to `c`, over two chained internal
/// lanes.
const NET: &str = r#"<net version="1.9">
    <location convBoundary="0,0,30,30"/>
    <edge id=":j_0" function="internal"><lane id=":j_0_0" index="0" speed="5" length="5" shape="10,0 15,0"/></edge>
    <edge id=":j_1" function="internal"><lane id=":j_1_0" index="0" speed="5" length="5" shape="15,0 20,0 20,10"/></edge>
    <edge id="a" from="w" to="j">
        <lane id="a_0" index="0" speed="10" length="10" shape="0,-3.2 10,-3.2"/>
        <lane id="a_1" index="1" speed="10" length="10" width="3.5" shape="0,0,1 10,0,1"/>
    </edge>
    <edge id="b" from="j" to="e"><lane id="b_0" index="0" speed="10" length="10" shape="20,-3.2 30,-3.2"/></edge>
    <edge id="c" from="j" to="n"><lane id="c_0" index="0" speed="10" length="40" shape="20,10 20,30"/></edge>
    <edge id="d" from="n" to="x"><lane id="d_0" index="0" speed="10" length="5" shape="20,30 20,35"/></edge>
    <junction id="j" type="priority" x="15" y="0" shape="10,-5 20,-5 20,5"/>
    <connection from="a" to="b" fromLane="0" toLane="0" dir="s" state="M"/>
    <connection from="a" to="c" fromLane="1" toLane="0" via=":j_0_0" dir="l" state="M"/>
    <connection from=":j_0" to="c" fromLane="0" toLane="0" via=":j_1_0" dir="l" state="m"/>
    <connection from=":j_1" to="c" fromLane="0" toLane="0" dir="l" state="m"/>
</net>"#;

fn parse(text: &str) -> Result<Net, NetError> {
    Net::parse(text, FilePath::new("x.net.xml"))
}

fn route(edges: &[&str]) -> Result<Path, NetError> {
    let edges: Vec<String> = edges.iter().map(|&e| e.to_owned()).collect();
    parse(NET).unwrap().route_path(&edges)
}

/// Returns the message of the error that the net causes when `from` is replaced by `to`.
fn broken(from: &str, to: &str) -> String {
    assert!(NET.contains(from));
    parse(&NET.replacen(from, to, 1)).unwrap_err().to_string()
}

#[test]
fn reads_every_part() {
    let net = parse(NET).unwrap();
    assert_eq!(
        (net.lanes.len(), net.edges.len(), net.junctions.len(), net.connections.len()),
        (7, 6, 1, 4)
    );
    assert_eq!(net.boundary, [[0.0, 0.0], [30.0, 30.0]]);
    let a = &net.edges[net.edge_index("a").unwrap()];
    assert_eq!(
        (a.from.as_deref(), a.to.as_deref(), a.function),
        (Some("w"), Some("j"), EdgeFunction::Normal)
    );
    let [first, second] = &net.lanes[a.lanes.clone()] else { panic!("two lanes") };
    assert_eq!((first.width, second.width, second.index), (DEFAULT_LANE_WIDTH, 3.5, 1));
    assert_eq!(second.shape, [[0.0, 0.0], [10.0, 0.0]], "heights are dropped");
    let over = net.connections_from(a.lanes.start + 1).next().unwrap();
    assert_eq!((net.lanes[over.via.unwrap()].id.as_str(), over.dir.as_str()), (":j_0_0", "l"));
    assert_eq!(net.junctions[0].kind, "priority");
}

#[test]
fn a_route_follows_chained_internal_lanes_from_the_lane_that_leads_on() {
    let path = route(&["a", "c"]).unwrap();
    assert_eq!(
        path.points,
        [[0.0, 0.0], [10.0, 0.0], [15.0, 0.0], [20.0, 0.0], [20.0, 10.0], [20.0, 30.0]]
    );
    assert_eq!(path.cumulative, [0.0, 10.0, 15.0, 20.0, 30.0, 50.0]);
    assert_eq!(path.widths, [3.5, 3.2, 3.2, 3.2, 3.2]);
    assert_eq!(
        (path.edge_start.as_slice(), path.edge_length.as_slice()),
        ([0.0, 30.0].as_slice(), [10.0, 20.0].as_slice())
    );
    assert_eq!(path.at(5.0), ([5.0, 0.0], 0.0));
    assert_eq!(path.at(40.0), ([20.0, 20.0], FRAC_PI_2));
    assert_eq!(path.arc(0, 4.0), Some(4.0));
    // `c` is 40 m long in SUMO, and its shape is 20 m long.
    assert_eq!(
        (path.arc(1, 10.0), path.arc(1, -10.0), path.arc(2, 0.0)),
        (Some(35.0), Some(45.0), None)
    );
}

#[test]
fn sumos_distance_along_a_route_can_be_converted_back() {
    // Lane c_0 is 40 m long in SUMO, and its shape 20 m; the second internal lane is 5 m long in
    // SUMO, and its shape 15 m.
    let path = route(&["a", "c"]).unwrap();
    assert!(
        (path.distance_of_arc(path.length()) - path.length()).abs() > 5.0,
        "SUMO counts otherwise here"
    );
    for k in 0..=100 {
        let s = path.length() * f64::from(k) / 100.0;
        assert!((path.arc_of_distance(path.distance_of_arc(s)) - s).abs() < 1e-9, "at {s}");
    }
}

#[test]
fn a_detour_is_on_the_same_lanes() {
    let path = route(&["a", "c"]).unwrap();
    // The detour across the junction is 40 m long instead of 20 m.
    let around = path.detoured(1, 4, [[10.0, 20.0], [20.0, 20.0]]);
    assert_eq!(
        around.points,
        [[0.0, 0.0], [10.0, 0.0], [10.0, 20.0], [20.0, 20.0], [20.0, 10.0], [20.0, 30.0]]
    );
    assert_eq!(around.widths, [3.5, 3.5, 3.5, 3.5, 3.2]);
    let stretches =
        |path: &Path| path.lane_stretches().map(|(_, from, to)| (from, to)).collect::<Vec<_>>();
    assert_eq!(stretches(&path), [(0.0, 10.0), (10.0, 15.0), (15.0, 30.0), (30.0, 50.0)]);
    assert_eq!(stretches(&around), [(0.0, 10.0), (10.0, 20.0), (20.0, 50.0), (50.0, 70.0)]);
    assert_eq!((&around.edges, &around.lanes), (&path.edges, &path.lanes));
    assert_eq!(
        (around.arc(0, 4.0), around.arc(1, 10.0), around.arc(1, -10.0)),
        (Some(4.0), Some(55.0), Some(65.0))
    );
    for k in 0..=100 {
        let distance = path.distance_of_arc(path.length()) * f64::from(k) / 100.0;
        let s = around.arc_of_distance(distance);
        assert!((around.distance_of_arc(s) - distance).abs() < 1e-9, "at {distance}");
        // Outside the detour, both paths have the same points.
        if !(10.0..50.0).contains(&s) {
            let ([x, y], [u, v]) = (around.at(s).0, path.at(path.arc_of_distance(distance)).0);
            assert!((x - u).hypot(y - v) < 1e-9, "at {distance}");
        }
    }
}

#[test]
fn the_gap_of_a_junction_without_internal_lanes_belongs_to_no_edge() {
    let path = route(&["a", "b"]).unwrap();
    assert_eq!(
        (path.edge_start.as_slice(), path.edge_length.as_slice()),
        ([0.0, 20.0].as_slice(), [10.0, 10.0].as_slice())
    );
    assert_eq!(path.length(), 30.0);
}

#[test]
fn routes_that_cannot_be_driven_are_refused() {
    assert!(matches!(route(&[]), Err(NetError { problem: Problem::EmptyRoute, .. })));
    assert_eq!(
        route(&["a", "cc"]).unwrap_err().to_string(),
        "x.net.xml: the net has no edge `cc`; did you mean `c`?"
    );
    assert_eq!(
        route(&["b", "c"]).unwrap_err().to_string(),
        "x.net.xml: the edge `b` does not lead to `c`"
    );
    // `a` leads to `c` from lane 1 only, and lane 1 cannot be reached from a lane of `z`.
    let z = r#"<edge id="z"><lane id="z_0" index="0" speed="1" length="1" shape="0,0 1,0"/></edge>
        <connection from="z" to="a" fromLane="0" toLane="0"/></net>"#;
    let net = parse(&NET.replace("</net>", z)).unwrap();
    let edges = ["z", "a", "c"].map(String::from);
    let error = net.route_path(&edges).unwrap_err();
    assert_eq!(error.to_string(), "x.net.xml: the route `z a c` needs a lane change");
    // Vehicles that change lanes can drive it: at the end of lane 0 of `a`, the path goes on from
    // lane 1.
    let path = net.route_path_with_changes(&edges, None, &[CARS]).unwrap();
    assert_eq!(path.edges, edges);
    let changes: Vec<f64> = path.lane_changes(&net).collect();
    assert_eq!(changes.len(), 1);
    assert!(changes[0] >= path.edge_start[1] + path.edge_length[1], "{changes:?}");
    let direct = net.route_path_with_changes(&edges[1..], None, &[CARS]).unwrap();
    assert_eq!(
        (direct.lane_changes(&net).count(), direct.lanes),
        (0, net.route_path(&edges[1..]).unwrap().lanes)
    );
    let stages = [&edges[0], &edges[2]].map(|edge| vec![edge.clone()]);
    assert_eq!(net.trip(&stages, &[CARS]).unwrap(), edges);
}

#[test]
fn broken_nets_are_refused_with_their_place() {
    insta::assert_snapshot!(broken(r#"speed="5""#, r#"speed="fast""#), @"x.net.xml:3:69: `fast` is not a valid speed of <lane>, allowed: a number of at least 0");
    insta::assert_snapshot!(broken(r#" length="5""#, ""), @"x.net.xml:3:41: <lane> lacks the attribute `length`");
    insta::assert_snapshot!(broken("0,-3.2 10,-3.2", "0,-3.2 nan,0"), @"x.net.xml:6:57: `0,-3.2 nan,0` is not a valid shape of <lane>, allowed: points x,y separated by spaces, two or more for a lane");
    insta::assert_snapshot!(broken("0,-3.2 10,-3.2", "0,-3.2"), @"x.net.xml:6:57: `0,-3.2` is not a valid shape of <lane>, allowed: points x,y separated by spaces, two or more for a lane");
    insta::assert_snapshot!(broken(r#"via=":j_0_0""#, r#"via=":j_0_9""#), @"x.net.xml:14:57: via=`:j_0_9` names nothing in this net; did you mean `:j_0_0`?");
    insta::assert_snapshot!(broken(r#"fromLane="1""#, r#"fromLane="2""#), @"x.net.xml:14:33: fromLane=`2` names nothing in this net");
    insta::assert_snapshot!(broken(r#"id="b""#, r#"id="a""#), @"x.net.xml:9:11: a second edge with the id `a`");
    insta::assert_snapshot!(broken(r#"convBoundary="0,0,30,30""#, r#"convBoundary="0,0,30""#), @"x.net.xml:2:15: `0,0,30` is not a valid convBoundary of <location>, allowed: left,bottom,right,top");
    insta::assert_snapshot!(parse("<nodes/>").unwrap_err(), @"x.net.xml:1:1: expected the element <net>, found <nodes>");
    insta::assert_snapshot!(parse("<net>\n<edge></net>").unwrap_err(), @"x.net.xml:2:7: cannot be read as XML");
    insta::assert_snapshot!(Net::load(FilePath::new("none.net.xml")).unwrap_err(), @"none.net.xml: cannot read the net");
}

#[test]
fn entities_and_deep_nesting_are_harmless() {
    let bomb = "<!DOCTYPE net [<!ENTITY a 'aaaa'><!ENTITY b '&a;&a;'>]><net>&b;</net>";
    assert!(matches!(parse(bomb), Err(NetError { problem: Problem::Xml { .. }, .. })));
    assert!(parse(&"<net>".repeat(200_000)).is_err());
}

#[test]
fn more_than_the_parser_bears_is_refused_at_once() {
    let many = |item: &dyn Fn(usize) -> String| (0..40_000).map(item).collect::<String>();
    let attributes = format!("<net>\n <edge{}/></net>", many(&|i| format!(" a{i}='\"'")));
    let namespaces = format!(
        "<net{}>{}</net>",
        many(&|i| format!(" xmlns:n{i}='{i}'")),
        "<a xmlns:a='a'/>".repeat(40_000)
    );
    let place = |text: &str| match parse(text).unwrap_err() {
        NetError {
            place: Some((line, column)),
            problem: Problem::Xml { source: XmlError::Excess { limit, .. } },
            ..
        } => (line, column, limit),
        error => panic!("{error}"),
    };
    assert_eq!(place(&attributes), (2, 2, 256));
    assert_eq!(place(&format!("<!-- don't -->\n{namespaces}")).0, 2);
    let declaring = format!("<net>{}</net>", "<a xmlns:a='a'/>".repeat(65));
    assert_eq!(place(&declaring), (1, 6 + 64 * 16, 64));
    // Quotes in texts, values and comments do not count as attributes, nor `xmlns` there as a
    // declaration.
    let text = NET.replace(
        "<location",
        &format!(
            "<!--{}--><a b=\"{}\">{0}</a><location",
            "\"' a xmlns='a' xmlns:b='b'".repeat(999),
            "'xmlns".repeat(999)
        ),
    );
    assert!(parse(&text).is_ok());
}

#[test]
fn a_file_that_is_not_utf8_is_refused_with_the_place() {
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), b"<net>\n \xc3\xa9\xe9</net>").unwrap();
    let error = Net::load(file.path()).unwrap_err();
    let source = std::error::Error::source(&error).unwrap().to_string();
    assert!(source.starts_with("not UTF-8 at line 2, column 3;"), "{source}");
}

#[test]
fn a_route_names_roads_and_connections_lead_over_junctions() {
    assert_eq!(
        route(&["a", ":j_0"]).unwrap_err().to_string(),
        "x.net.xml: the edge `:j_0` is not a road, so no route can name it"
    );
    insta::assert_snapshot!(broken(r#"via=":j_0_0""#, r#"via="b_0""#), @"x.net.xml:14:57: `b_0` is not a valid via of <connection>, allowed: a lane within a junction");
}

#[test]
fn positions_on_a_lane_of_next_to_no_length_are_numbers() {
    insta::assert_snapshot!(broken(r#"length="40""#, r#"length="1e-308""#), @"x.net.xml:10:70: `1e-308` is not a valid length of <lane>, allowed: a number of at least 0.001");
}

#[test]
fn points_that_rounding_makes_one_are_one() {
    // At 2e12 m, the resolution of an `f64` is 0.24 mm.
    let far = (0..1000).map(|i| [if i % 2 == 0 { -1e9 } else { 1e9 }, 0.0]);
    let path = Path::from_points(far.chain([[1e9, 1e-5], [1e9, 2.0]]), 1.0).unwrap();
    assert!(path.cumulative.windows(2).all(|pair| pair[0] < pair[1]));
    assert_eq!(path.points.len(), 1001);
    assert_eq!(path.at(path.length()), ([1e9, 2.0], FRAC_PI_2));
}

#[test]
fn routes_of_very_many_points_are_refused() {
    let shape = "0,0 1,0 ".repeat(1 << 10);
    let circle = format!(
        r#"<net><location convBoundary="0,0,1,1"/><edge id="a"><lane id="l" index="0" speed="1" length="1" shape="{shape}"/>
        </edge><connection from="a" to="a" fromLane="0" toLane="0"/></net>"#
    );
    let net = parse(&circle).unwrap();
    assert!(net.route_path(&vec!["a".to_owned(); 32]).is_ok());
    assert!(matches!(
        net.route_path(&vec!["a".to_owned(); 33]),
        Err(NetError { problem: Problem::LongRoute { points: 67_584, .. }, .. })
    ));
}

#[test]
fn messages_show_no_control_characters_of_the_file() {
    let error = broken(r#"<lane id=":j_0_0""#, "<lane id=\":j_0\u{9b}_0\"");
    assert!(
        error.ends_with("via=`:j_0_0` names nothing in this net; did you mean `:j_0\\u{9b}_0`?"),
        "{error}"
    );
}

#[test]
fn a_circle_of_internal_lanes_ends() {
    let circle = r#"from=":j_1" to="c" fromLane="0" toLane="0" via=":j_0_0" dir="l""#;
    let text = NET.replace(r#"from=":j_1" to="c" fromLane="0" toLane="0" dir="l""#, circle);
    assert_ne!(text, NET);
    assert!(parse(&text).unwrap().route_path(&["a".into(), "c".into()]).is_ok());
}

#[test]
fn lanes_are_numbered_in_their_order() {
    // Older versions of netconvert repeat an index.
    let repeated = NET.replace(r#"id="a_1" index="1""#, r#"id="a_1" index="0""#);
    assert_ne!(repeated, NET);
    assert_eq!(parse(&repeated).unwrap(), parse(NET).unwrap());
    let skipped = broken(r#"id="a_1" index="1""#, r#"id="a_1" index="2""#);
    assert!(skipped.contains("`2` is not a valid index of <lane>"), "{skipped}");
}

#[test]
fn lanes_connections_and_internal_lanes_may_be_closed() {
    let (bus, both) = (&["bus"][..], &["bus", CARS][..]);
    let way = |from: &str, to: &str, who: &[&str]| {
        let net = parse(&NET.replacen(from, to, 1)).unwrap();
        let edges = ["a".to_owned(), "c".to_owned()];
        let path = net.route_path_for(&edges, None, who);
        let trip = net.trip(&edges.map(|edge| vec![edge]), who);
        assert_eq!(trip.is_ok(), path.is_ok(), "{to}");
        path.map(|path| path.lanes.len()).map_err(|error| error.problem)
    };
    assert!(way("", "", both).is_ok());
    for (from, to) in [
        (r#"via=":j_0_0""#, r#"via=":j_0_0" allow="bus""#),
        (r#"via=":j_1_0""#, r#"via=":j_1_0" disallow="passenger""#),
        (r#"<lane id=":j_1_0""#, r#"<lane id=":j_1_0" allow="bus""#),
    ] {
        assert!(way(from, to, bus).is_ok(), "{to}");
        for who in [&[CARS][..], both] {
            // A connection inside a junction has no permissions of its own in SUMO.
            let inner = from.contains("via=\":j_1_0");
            assert!(inner || matches!(way(from, to, who), Err(Problem::Closed { .. })), "{to}");
        }
    }
    let (from, to) = (r#"<lane id="c_0""#, r#"<lane id="c_0" allow="bus tram""#);
    assert!(way(from, to, bus).is_ok());
    assert!(matches!(way(from, to, &[CARS]), Err(Problem::NotAllowed { .. })));
    let unknown = broken(r#"<lane id="c_0""#, r#"<lane id="c_0" allow="buss""#);
    assert!(unknown.contains("`buss` is not a valid allow of <lane>"), "{unknown}");
}

#[test]
fn positions_ahead_are_in_metres_of_the_lane() {
    let long = NET.replace(
        r#"id="a_1" index="1" speed="10" length="10""#,
        r#"id="a_1" index="1" speed="10" length="20""#,
    );
    assert_ne!(long, NET);
    let net = parse(&long).unwrap();
    let path = net.route_path(&["a".into(), "c".into()]).unwrap();
    assert_eq!((path.arc(0, 4.0), path.ahead(4.0, 3.0)), (Some(2.0), 10.0));
    assert_eq!(net.lanes[path.lanes[0]].stretch(), 2.0);
    let same = route(&["a", "c"]).unwrap();
    assert_eq!(same.ahead(4.1, 2.2575), 4.1 + 2.2575);
    // The lane `c_0` is shorter than its shape.
    let mut lane = parse(NET).unwrap().lanes[path.lanes[0]].clone();
    (lane.length, lane.shape) = (10.0, vec![[0.0, 0.0], [9.96, 0.0]]);
    assert_eq!(lane.stretch(), 1.0, "netconvert's rounding");
    (lane.length, lane.shape) = (0.1, vec![[3.0, 0.0]; 2]);
    assert_eq!(lane.stretch(), 1.0, "a node that only joins two roads");
}

#[test]
fn nearest_is_near() {
    let valid = ["west_in", "west_out", "east_in"];
    assert_eq!(nearest("wset_in", valid.into_iter()), Some("west_in"));
    assert_eq!(nearest("junction", valid.into_iter()), None);
    assert_eq!(nearest("c", ["A", "B", "C"].into_iter()), Some("C"));
    assert_eq!(nearest("MAIN", ["main", "MAIM"].into_iter()), Some("main"));
    assert_eq!(nearest(&"x".repeat(1000), valid.into_iter()), None);
}

/// Generates polylines of segments 5 to 40 m long with bends of up to 60 degrees.
fn polyline() -> impl Strategy<Value = Path> {
    prop::collection::vec((5.0..40.0, -1.04..1.04), 1..8).prop_map(|segments| {
        let (mut x, mut y, mut heading) = (3.0, -7.0, 0.5_f64);
        let mut points = vec![[x, y]];
        for (length, bend) in segments {
            heading += bend;
            x += length * heading.cos();
            y += length * heading.sin();
            points.push([x, y]);
        }
        Path::from_points(points, 3.5).unwrap()
    })
}

proptest! {
    #[test]
    fn projection_inverts_at(path in polyline(), segment in 0_usize..8, share in 0.2..0.8, lateral in -0.5..0.5_f64) {
        let segment = segment % path.widths.len();
        let (start, end) = (path.cumulative[segment], path.cumulative[segment + 1]);
        let s = start + share * (end - start);
        let ([x, y], heading) = path.at(s);
        let point = [x - lateral * heading.sin(), y + lateral * heading.cos()];
        for hint in [segment.saturating_sub(1), segment, segment + 1] {
            let (found, offset, found_segment) = path.project(point, hint);
            prop_assert_eq!(found_segment, segment);
            prop_assert!((found - s).abs() < 1e-9, "s {} found {}", s, found);
            prop_assert!((offset - lateral).abs() < 1e-9, "lateral {} found {}", lateral, offset);
        }
    }

    #[test]
    fn projection_inverts_at_beyond_both_ends(path in polyline(), beyond in 0.0..20.0_f64, lateral in -2.0..2.0_f64) {
        for (s, hint) in [(-beyond, 0), (path.length() + beyond, path.widths.len())] {
            let ([x, y], heading) = path.at(s);
            let (found, offset, _) = path.project([x - lateral * heading.sin(), y + lateral * heading.cos()], hint);
            prop_assert!((found - s).abs() < 1e-9 && (offset - lateral).abs() < 1e-9);
        }
    }

    #[test]
    fn a_place_is_the_same_wherever_the_search_for_it_begins(path in polyline(), at in -0.2..1.2_f64, hint in 0_usize..12) {
        // A point of the path belongs to the segment that begins there.
        let s = at * path.length();
        let corner = path.cumulative[hint % path.cumulative.len()];
        for s in [s, corner] {
            prop_assert_eq!(path.locate_from(s, hint), path.locate(s));
        }
    }

    #[test]
    fn nearest_finds_no_worse_a_place_than_project(path in polyline(), x in -50.0..150.0, y in -50.0..150.0, hint in 0_usize..9) {
        prop_assert!(path.nearest([x, y]).1.abs() <= path.project([x, y], hint).1.abs());
    }

    #[test]
    fn a_smooth_heading_turns_from_one_segment_to_the_next(path in polyline(), at in 0.0..1.0_f64) {
        let turned = |from: f64, to: f64| ((to - from).sin()).atan2((to - from).cos()).abs();
        let middles: Vec<f64> = path.cumulative.windows(2).map(|ends| f64::midpoint(ends[0], ends[1])).collect();
        for pair in middles.windows(2) {
            let [first, last] = [pair[0], pair[1]].map(|s| path.at(s).1);
            let [there, then] = [pair[0], pair[1]].map(|s| path.smooth_heading(s));
            prop_assert!(turned(there, first) < 1e-9 && turned(then, last) < 1e-9);
            // The heading turns through the smaller angle, and evenly.
            let between = path.smooth_heading(pair[0] + at * (pair[1] - pair[0]));
            prop_assert!((turned(first, between) - at * turned(first, last)).abs() < 1e-6);
        }
    }

    #[test]
    fn any_text_is_read_or_refused(text in ".{0,200}") {
        prop_assert!(parse(&text).is_err());
    }

    #[test]
    fn a_damaged_net_never_panics(at in 0..NET.len(), length in 0_usize..40, filler in "[ -~]{0,6}") {
        let end = (at + length).min(NET.len());
        let text = format!("{}{filler}{}", &NET[..at], &NET[end..]);
        if let Ok(net) = parse(&text) {
            // A net that is accepted gives a route or an error, and never panics.
            let _ = net.route_path(&["a".into(), "c".into()]).map(|path| path.at(1.0));
        }
    }
}
