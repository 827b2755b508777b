//! Routes of the plan.

use super::*;

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
