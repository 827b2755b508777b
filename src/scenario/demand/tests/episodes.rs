//! Which departures fall into an episode.

use super::*;

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
