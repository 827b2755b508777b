//! Vehicles and persons that are left out.

use super::*;

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
            format!("<trip id=\"v\" depart=\"triggered\" from=\"{from}\" to=\"{to}\"/>"),
            "give a time",
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
    let vehicle = |attributes: &str, stop: &str| {
        format!("<vehicle id=\"v\" depart=\"0\" {attributes}>{route}{stop}</vehicle>")
    };
    let not_taken = [
        (vehicle("", "<stop busStop=\"b\" duration=\"1\"/>"), "no busStop `b` of its stop"),
        (
            vehicle("", &format!("<stop lane=\"{from}_0\" triggered=\"true\" duration=\"1\"/>")),
            "triggered of <stop> is not taken: stops that wait for persons",
        ),
        (
            "<vehicle id=\"v\" depart=\"triggered\"><route edges=\"a\"/></vehicle>".into(),
            "it departs when persons or containers have boarded",
        ),
        (
            "<trip id=\"v\" from=\"a\" depart=\"0\"/>".into(),
            "it has no `to`: give both ends of its way",
        ),
        (
            "<flow id=\"v\" period=\"1\" toJunction=\"a\"/>".into(),
            "it has no `from`: give both ends of its way",
        ),
        (
            "<flow id=\"v\" period=\"1\" fromTaz=\"a\" toTaz=\"b\"/>".into(),
            "fromTaz of <flow> is not taken: zones are not taken: make trips or routes of the zones with SUMO's duarouter",
        ),
        (
            "<person id=\"v\" depart=\"0\"><ride from=\"a\" to=\"b\"/></person>".into(),
            "<ride> in <person> is not taken: a person has one <walk> here",
        ),
        (
            "<person id=\"v\" depart=\"0\"><walk edges=\"a\"/><walk edges=\"b\"/></person>".into(),
            "it has several walks",
        ),
        (
            "<person id=\"v\" depart=\"0\"><walk edges=\"a\" busStop=\"b\"/></person>".into(),
            "busStop of <walk> is not taken",
        ),
    ];
    for (text, expected) in cases.into_iter().chain(more).chain(not_taken) {
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
