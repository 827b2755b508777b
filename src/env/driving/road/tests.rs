//! Tests of the road surface on shipped nets.

use proptest::prelude::*;

use super::*;
use crate::env::driving::tests::net;
use crate::sumo::net::Lane;

const LENGTH: f64 = 4.515;
const WIDTH: f64 = 1.852;

fn ends_at(border: Border) -> Termination {
    Termination { horizon: 1, wreck_time: 0.0, border, broken_lines: Vec::new() }
}

fn road() -> Road {
    Road::new(&net("intersection/arm30"), [LENGTH, WIDTH], &ends_at(Border::Line))
        .expect("a small net")
}

#[test]
fn a_vehicle_may_stray_as_far_as_measured() {
    let road = road();
    // Eastbound, in the middle of the arm. The centre line is y = 0 plus an offset in the
    // net's coordinates.
    let net = net("intersection/arm30");
    let edge = net.edge_index("west_in").unwrap();
    let lane = &net.lanes[net.edges[edge].lanes.start];
    let y = lane.shape[0][1];
    let x = f64::midpoint(lane.shape[0][0], lane.shape[1][0]);
    let left = |lateral: f64, heading: f64| road.is_off_road(&Pose { x, y: y + lateral, heading });
    for side in [-1.0, 1.0] {
        assert!(!left(side * 0.78, 0.0) && left(side * 0.80, 0.0));
    }
    assert!(!left(0.0, 0.3) && left(0.0, 0.6), "a vehicle across its lane touches the lines");
    assert!(road.is_off_road(&Pose { x: 1e5, y: 0.0, heading: 0.0 }));
}

/// Where vehicles drive on the left, everything is as in the mirror.
#[test]
fn a_left_hand_road_is_the_mirror_image() {
    let net = net("intersection_turns/two_lanes");
    for border in [Border::Line, Border::Kerb] {
        let road = |net: &Net| Road::new(net, [LENGTH, WIDTH], &ends_at(border)).expect("a net");
        let [right, left] = [road(&net), road(&net.mirrored())];
        assert!(!right.lines.is_empty() && right.lines.len() == left.lines.len());
        let lane = &net.lanes[net.edges[net.edge_index("west_in").unwrap()].lanes.start];
        let x = f64::midpoint(lane.shape[0][0], lane.shape[1][0]);
        for lateral in [0.0, 0.4, -0.7] {
            let y = lane.shape[0][1] + lateral;
            let [a, b] = [(&right, 1.0), (&left, -1.0)].map(|(road, side)| {
                road.margins(&Pose { x, y: side * y, heading: side * 0.1 }, 4.0, 8.0)
            });
            assert_eq!(a, [b[1], b[0], b[3], b[2]]);
        }
    }
}

/// Margins show on which side of a vehicle a line is, and how close it is. A road with two
/// lanes has its lines to the right of the right lane and to the left of the left lane.
#[test]
fn margins_show_on_which_side_a_line_is_and_how_close() {
    let net = net("intersection_turns/two_lanes");
    let road = Road::new(&net, [LENGTH, WIDTH], &ends_at(Border::Line)).expect("a small net");
    let edge = &net.edges[net.edge_index("west_in").unwrap()];
    let [right, left] = [0, 1].map(|k| &net.lanes[edge.lanes.start + k]);
    let margins = |lane: &Lane, lateral: f64| {
        let x = f64::midpoint(lane.shape[0][0], lane.shape[1][0]);
        road.margins(&Pose { x, y: lane.shape[0][1] + lateral, heading: 0.0 }, 4.0, 2.0)
    };
    let free = (right.width - WIDTH) / 2.0 - TOUCH;
    let close = |found: [f64; 4], expected: [f64; 4]| {
        found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6)
    };
    for lateral in [0.0, 0.3, -0.5] {
        let [above, below] = [margins(left, lateral), margins(right, lateral)];
        assert!(close(above, [free - lateral, 2.0, free - lateral, 2.0]), "{above:?}");
        assert!(close(below, [2.0, free + lateral, 2.0, free + lateral]), "{below:?}");
    }
    assert_eq!(margins(right, -1.2)[1], 0.0);
}

proptest! {
    /// The margin beside the body is 0 exactly where a vehicle touches a line.
    #[test]
    fn a_vehicle_that_touches_a_line_has_no_margin(x in 0.0..1.0, y in 0.0..1.0, heading in -3.2..3.2) {
        let road = road();
        let [low, high] = road.lines.iter().flatten().fold([[f64::MAX; 2], [f64::MIN; 2]], |[low, high], p| {
            [[low[0].min(p[0]), low[1].min(p[1])], [high[0].max(p[0]), high[1].max(p[1])]]
        });
        let at = |share: f64, axis: usize| low[axis] + share * (high[axis] - low[axis]);
        let pose = Pose { x: at(x, 0), y: at(y, 1), heading };
        let margins = road.margins(&pose, 4.0, 2.0);
        let touched = road.lines.iter().any(|line| road.touches(&pose, *line));
        prop_assert_eq!(touched, margins[0].min(margins[1]) == 0.0, "{:?} {:?}", pose, margins);
        prop_assert!(margins.iter().all(|margin| (0.0..=2.0).contains(margin)));
    }
}

#[test]
fn no_line_is_there_twice() {
    let lines = road().lines;
    for (i, &[a, b]) in lines.iter().enumerate() {
        assert!(!lines[..i].contains(&[a, b]) && !lines[..i].contains(&[b, a]), "{a:?} {b:?}");
    }
}

#[test]
fn no_line_crosses_a_path_over_the_junction() {
    let road = road();
    let net = net("intersection/arm30");
    for [from, to] in [["west_in", "east_out"], ["south_in", "north_out"]] {
        let path = net.route_path(&[from.to_owned(), to.to_owned()]).unwrap();
        for k in 0..=(path.length() / 0.5) as usize {
            let ([x, y], heading) = path.at(0.5 * k as f64);
            assert!(
                !road.is_off_road(&Pose { x, y, heading }),
                "on the path from {from} to {to}, at {x} {y}"
            );
        }
    }
}

#[test]
fn kerbs_and_the_line_between_directions_border_a_parking_lot() {
    let net = net("parking_lot/parking_lot");
    let [kerbs, lines] = [Border::Kerb, Border::Line]
        .map(|border| Road::new(&net, [LENGTH, WIDTH], &ends_at(border)).unwrap());
    let up = std::f64::consts::FRAC_PI_2;
    // (x, y, heading, off-road by kerbs, off-road by lines, description)
    let places = [
        (15.0, 0.0, 0.0, false, false, "on the road"),
        (15.0, 0.9, 0.0, true, true, "over the line between the directions"),
        (15.0, -1.3, 0.0, false, true, "over the line at the right"),
        (15.0, -1.5, 0.0, true, true, "over the kerb at the right"),
        (37.75, 11.5, up, false, true, "between two spaces"),
        (41.5, 11.5, up, true, true, "beside the last space"),
        (36.0, 1.75, up, false, false, "across the lot"),
        (61.0, 2.0, up, false, false, "straight on along the outside of the junction"),
        (62.0, 2.0, up, false, true, "over its border"),
        (62.6, 2.0, up, true, true, "over its kerb"),
    ];
    for (x, y, heading, by_kerbs, by_lines, what) in places {
        let pose = Pose { x, y, heading };
        assert_eq!(
            [kerbs.is_off_road(&pose), lines.is_off_road(&pose)],
            [by_kerbs, by_lines],
            "{what}"
        );
    }
}

/// The parking lot is bordered as measured on the paper's simulator.
#[test]
fn only_the_centre_counts_where_roads_end_and_sides_where_kerbs_are_convex() {
    let net = net("parking_lot/parking_lot");
    let broken = ["east_in", "east_out"].map(String::from).to_vec();
    let whole = ends_at(Border::Kerb);
    let measured = Termination { broken_lines: broken, ..whole.clone() };
    let [whole, measured] =
        [whole, measured].map(|t| Road::new(&net, [LENGTH, WIDTH], &t).unwrap());
    // (x, y, heading in degrees, off-road, description)
    let places = [
        (45.5, 1.75, 0.0, false, "over the broken line between lot and junction"),
        (36.0, 15.4, 90.0, false, "its front beyond the end of a space"),
        (36.9, 15.4, 90.0, false, "the same, aside"),
        (39.5, 15.4, 45.0, false, "a corner there, beside the last space"),
        (36.0, 15.6, 90.0, true, "its centre beyond the end of a space"),
        (36.0, 15.6, 0.0, true, "the same, across"),
        (0.1, 0.0, 180.0, false, "its front beyond the end of the road"),
        (-0.1, 0.0, 180.0, true, "its centre there"),
        (61.0, 23.4, 90.0, false, "its front beyond the end of an arm"),
        (61.0, -20.1, 90.0, true, "its centre there"),
        (41.3, 13.0, 90.0, true, "beside the last space"),
    ];
    for (x, y, heading, out, what) in places {
        let pose = Pose { x, y, heading: f64::to_radians(heading) };
        assert_eq!(measured.is_off_road(&pose), out, "{what}");
    }
    assert!(
        whole.is_off_road(&Pose { x: 45.5, y: 1.75, heading: 0.0 }),
        "a whole line must not be touched"
    );
    // The kerb is convex where the last space meets the curve out of the lot: there are poses
    // with all corners on lanes and a side beyond the kerb.
    let corners_only = |pose: &Pose| {
        let (sin, cos) = pose.heading.sin_cos();
        let corner = |a: f64, b: f64| {
            let (along, across) = (a * LENGTH / 2.0, b * WIDTH / 2.0);
            measured
                .on_lane([pose.x + along * cos - across * sin, pose.y + along * sin + across * cos])
        };
        [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)].iter().all(|&(a, b)| corner(a, b))
    };
    let poses = (0..40)
        .flat_map(|i| (0..40).map(move |j| [38.0 + 0.1 * f64::from(i), 4.0 + 0.1 * f64::from(j)]));
    let poses = poses.map(|[x, y]| Pose { x, y, heading: -std::f64::consts::FRAC_PI_4 });
    let hit = poses.filter(|pose| corners_only(pose) && measured.is_off_road(pose)).count();
    assert!(hit > 0, "no side meets the kerb first");
}

proptest! {
    /// A vehicle's box touches a segment exactly if a point of the segment is inside the box.
    #[test]
    fn touching_agrees_with_boxes(x in -6.0..6.0f64, y in -6.0..6.0f64, h in -4.0..4.0f64, g in -4.0..4.0f64) {
        let road = road();
        let pose = Pose { x, y, heading: h };
        let (sin, cos) = g.sin_cos();
        let long = road.half[0];
        let line = [[-long * cos, -long * sin], [long * cos, long * sin]];
        let oracle = (0..=4000).any(|k| {
            let t = f64::from(k) / 2000.0 - 1.0;
            let (px, py) = (t * long * cos - x, t * long * sin - y);
            let (s, c) = h.sin_cos();
            (px * c + py * s).abs() <= road.half[0] && (py * c - px * s).abs() <= road.half[1]
        });
        let found = road.touches(&pose, line);
        // The sampled points may miss a corner that the segment cuts by less than their
        // spacing.
        prop_assert!(found || !oracle);
        let smaller = Road { half: road.half.map(|v| v - 0.005), ..road };
        prop_assert!(oracle || !smaller.touches(&pose, line));
    }
}
