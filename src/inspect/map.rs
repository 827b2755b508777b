//! A map of a scenario: its net, the polygons that block sight or radio, its routes, start places,
//! communication range, and conflict points.

use std::fmt::Write as _;

use crate::env::{Pose, Task};
use crate::markup::escape as escaped;
use crate::plot::{Picture, Rgb};
use crate::scenario::SpawnPlace;
use crate::sumo::net::{EdgeFunction, Net};
use crate::words::counted;

const ROAD: Rgb = [214, 218, 222];
const JUNCTION: Rgb = [232, 234, 236];
const VEHICLE: Rgb = [60, 60, 60];
const FINISH: Rgb = [0, 158, 115];
const MEETING: Rgb = [213, 94, 0];
/// Colours of routes; they differ from all other colours of the map.
const ROUTES: [Rgb; 4] = [[0, 114, 178], [230, 159, 0], [86, 180, 233], [120, 94, 200]];
const SIGNAL: Rgb = [204, 43, 43];
const RADIO: Rgb = [204, 121, 167];
const WALL: Rgb = [185, 167, 143];
/// Width of lines, and radius of conflict points \[m\].
const LINE: f64 = 0.35;
const POINT: f64 = 0.9;
/// Width of the net's margin around the routes that is shown \[m\].
const AROUND: f64 = 25.0;
/// Conflict points closer to each other than this are drawn as one \[m\].
const SAME: f64 = 1.0;

/// Returns a map of a scenario with a number of agents, seen from above.
pub fn picture(task: &Task, net: &Net) -> Picture {
    let meetings = meetings(task);
    let mut picture = Picture::new(format!(
        "{}: {}, {}, {}",
        task.scenario.name,
        counted(task.places.len(), "place"),
        counted(task.map.routes.len(), "route"),
        counted(meetings.len(), "meeting point"),
    ));
    let [left, bottom, right, top] = task.map.bounds;
    let window = [[left - AROUND, bottom - AROUND], [right + AROUND, top + AROUND]];
    for (function, color) in [(EdgeFunction::Internal, JUNCTION), (EdgeFunction::Normal, ROAD)] {
        for lane in net.lanes.iter().filter(|lane| net.edges[lane.edge].function == function) {
            for piece in cut(&lane.shape, &window) {
                picture.line(&piece, lane.width, color);
            }
        }
    }
    for corners in task.map.walls.corners() {
        let part = part(corners, &window);
        if !part.is_empty() {
            picture.area(&part, WALL);
        }
    }
    let vehicle = task.scenario.vehicle;
    for (i, route) in task.map.routes.iter().enumerate() {
        picture.line(&route.path.points, LINE, ROUTES[i % ROUTES.len()]);
    }
    for route in task.map.routes.iter().filter(|route| !route.is_walked()) {
        let ([x, y], heading) = route.path.at(route.arrival);
        picture.line(
            &across([x, y], heading, route.path.widths.last().copied().unwrap_or(0.0)),
            2.0 * LINE,
            FINISH,
        );
    }
    let has_signals = !task.map.traffic_lights.lights.is_empty();
    for (route, lines) in task.map.routes.iter().zip(&task.map.traffic_lights.lines) {
        for line in lines {
            // The direction is that of the lane, not of the turn behind the line.
            let ([x, y], heading) = route.path.at(line.at - 0.1);
            let width = route.path.widths[route.path.locate(line.at).1];
            picture.line(&across([x, y], heading, width), 2.0 * LINE, SIGNAL);
        }
    }
    let pose = |place: &SpawnPlace| {
        let path = &task.map.routes[place.routes[0]].path;
        let ([x, y], heading) = path.at(path.arc(0, place.pos).unwrap_or(0.0));
        Pose { x, y, heading }
    };
    let poses: Vec<Pose> = task.places.iter().map(pose).collect();
    let from_middle =
        |p: &&Pose| (p.x - f64::midpoint(left, right)).hypot(p.y - f64::midpoint(bottom, top));
    if let Some(one) = poses.iter().min_by(|a, b| from_middle(a).total_cmp(&from_middle(b))) {
        picture.circle([one.x, one.y], task.scenario.communication.range, Some(LINE), RADIO);
    }
    for pose in &poses {
        picture.area(&body(pose, vehicle.length, vehicle.width), VEHICLE);
    }
    for &at in &meetings {
        picture.circle(at, POINT, None, MEETING);
    }
    picture.explain(VEHICLE, "places where vehicles begin");
    picture.explain(ROUTES[0], "routes, in colours in turn");
    picture.explain(FINISH, "finish of a route");
    picture.explain(MEETING, "where routes cross or merge");
    if has_signals {
        picture.explain(SIGNAL, "stop lines of signals");
    }
    if let Some(occlusion) = &task.scenario.occlusion {
        let blocked = match (occlusion.sight, occlusion.radio) {
            (true, true) => "sight and radio",
            (true, false) => "sight",
            (false, true) => "radio",
            (false, false) => "nothing",
        };
        picture.explain(WALL, format!("polygons that block {blocked}"));
    }
    picture.explain(
        RADIO,
        format!("radio range of one vehicle, {} m", task.scenario.communication.range),
    );
    picture
}

/// Returns an HTML file with the map and a table of the routes.
pub fn page(task: &Task, net: &Net) -> String {
    let scenario = &task.scenario;
    let mut rows = String::new();
    for (i, geometry) in task.map.routes.iter().enumerate() {
        let meets: Vec<String> = geometry
            .conflicts
            .iter()
            .map(|conflict| {
                format!("{} at {:.0} m", task.map.route_id(conflict.route), conflict.own)
            })
            .collect();
        let _ = writeln!(
            rows,
            "<tr><td>{}</td><td>{}</td><td>{:.1}</td><td>{}</td></tr>",
            escaped(task.map.route_id(i)),
            escaped(&task.map.route_edges(i).join(" ")),
            geometry.arrival,
            escaped(&meets.join(", "))
        );
    }
    format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>{name}</title>\n\
         <style>body{{font-family:sans-serif;margin:2em}}svg{{max-width:100%;height:auto}}\
         td,th{{text-align:left;padding:.2em 1em .2em 0;vertical-align:top}}</style></head>\n\
         <body><h1>{name}</h1>\n<p>{description}</p>\n<p>{agents} agents, net {net}</p>\n{svg}\n\
         <table><tr><th>route</th><th>edges</th><th>finish at [m]</th><th>meets</th></tr>\n{rows}</table></body></html>\n",
        name = escaped(&scenario.name),
        description = escaped(&scenario.description),
        agents = task.agents,
        net = escaped(&net.path.display().to_string()),
        svg = picture(task, net).svg(),
    )
}

/// Returns the points at which routes of vehicles cross or merge with other routes, each point
/// once.
fn meetings(task: &Task) -> Vec<[f64; 2]> {
    let mut points: Vec<[f64; 2]> = Vec::new();
    for route in task.map.routes.iter().filter(|route| !route.is_walked()) {
        for conflict in route.conflicts.iter().filter(|conflict| conflict.own <= route.arrival) {
            let ([x, y], _) = route.path.at(conflict.own);
            if !points.iter().any(|p| (p[0] - x).hypot(p[1] - y) < SAME) {
                points.push([x, y]);
            }
        }
    }
    points
}

/// Returns the pieces of a line that lie in a window, which is given by its lower left and upper
/// right corners.
fn cut(line: &[[f64; 2]], window: &[[f64; 2]; 2]) -> Vec<Vec<[f64; 2]>> {
    let mut pieces: Vec<Vec<[f64; 2]>> = Vec::new();
    for pair in line.windows(2) {
        let direction = [pair[1][0] - pair[0][0], pair[1][1] - pair[0][1]];
        let mut span = (0.0_f64, 1.0_f64);
        for axis in 0..2 {
            let ends = [window[0][axis] - pair[0][axis], window[1][axis] - pair[0][axis]];
            if direction[axis] == 0.0 {
                // A line parallel to an axis and outside the window leaves no piece.
                span.1 = if ends[0] <= 0.0 && ends[1] >= 0.0 { span.1 } else { -1.0 };
            } else {
                let [a, b] = ends.map(|end| end / direction[axis]);
                span = (span.0.max(a.min(b)), span.1.min(a.max(b)));
            }
        }
        if span.0 > span.1 {
            continue;
        }
        let at = |t: f64| [pair[0][0] + t * direction[0], pair[0][1] + t * direction[1]];
        match pieces.last_mut().filter(|piece| span.0 == 0.0 && piece.last() == Some(&pair[0])) {
            Some(piece) => piece.push(at(span.1)),
            None => pieces.push(vec![at(span.0), at(span.1)]),
        }
    }
    pieces
}

/// Returns the part of a polygon that lies in a window, by its corners; empty if no part does. A
/// polygon with an inward corner may leave a part of zero width along the window's edge.
///
/// Source: I. Sutherland and G. Hodgman, *Reentrant polygon clipping*, 1974.
fn part(corners: &[[f64; 2]], window: &[[f64; 2]; 2]) -> Vec<[f64; 2]> {
    let mut part = corners.to_vec();
    for (axis, side) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
        let edge = window[side][axis];
        let beyond = |p: &[f64; 2]| if side == 0 { edge - p[axis] } else { p[axis] - edge };
        let mut rest = Vec::with_capacity(part.len() + 4);
        for (k, b) in part.iter().enumerate() {
            let a = &part[(k + part.len() - 1) % part.len()];
            let (from, to) = (beyond(a), beyond(b));
            if (from > 0.0) != (to > 0.0) {
                let t = from / (from - to);
                rest.push([a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])]);
            }
            if to <= 0.0 {
                rest.push(*b);
            }
        }
        part = rest;
    }
    part
}

/// Returns a line across a lane.
fn across([x, y]: [f64; 2], heading: f64, width: f64) -> [[f64; 2]; 2] {
    let (sin, cos) = heading.sin_cos();
    let half = width / 2.0;
    [[x - half * sin, y + half * cos], [x + half * sin, y - half * cos]]
}

/// Returns the outline of a vehicle, with a pointed front that shows its heading.
fn body(pose: &Pose, length: f64, width: f64) -> [[f64; 2]; 5] {
    let (sin, cos) = pose.heading.sin_cos();
    let (l, w) = (length / 2.0, width / 2.0);
    [[-l, -w], [0.6 * l, -w], [l, 0.0], [0.6 * l, w], [-l, w]]
        .map(|[x, y]| [pose.x + cos * x - sin * y, pose.y + sin * x + cos * y])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_cut_at_the_window() {
        let window = [[0.0, 0.0], [10.0, 10.0]];
        let inside = [[1.0, 1.0], [5.0, 1.0], [5.0, 9.0]];
        assert_eq!(cut(&inside, &window), [inside.to_vec()]);
        // The line enters the window, leaves it on the right, and enters it again from the top.
        let line = [[-5.0, 5.0], [15.0, 5.0], [15.0, 20.0], [5.0, 20.0], [5.0, 8.0]];
        assert_eq!(
            cut(&line, &window),
            [vec![[0.0, 5.0], [10.0, 5.0]], vec![[5.0, 10.0], [5.0, 8.0]]]
        );
        assert!(cut(&[[11.0, 0.0], [11.0, 10.0]], &window).is_empty());
    }

    #[test]
    fn a_polygon_is_cut_at_the_window() {
        let window = [[0.0, 0.0], [10.0, 10.0]];
        let square = |low: f64, high: f64| [[low, low], [high, low], [high, high], [low, high]];
        assert_eq!(part(&square(2.0, 3.0), &window), square(2.0, 3.0));
        assert!(part(&square(11.0, 12.0), &window).is_empty());
        // The order of the corners stays, from wherever it begins.
        let mut corner = part(&square(8.0, 12.0), &window);
        corner.sort_by(|a, b| a.partial_cmp(b).unwrap());
        assert_eq!(corner, [[8.0, 8.0], [8.0, 10.0], [10.0, 8.0], [10.0, 10.0]]);
        let mut whole = part(&square(-5.0, 15.0), &window);
        whole.sort_by(|a, b| a.partial_cmp(b).unwrap());
        assert_eq!(whole, [[0.0, 0.0], [0.0, 10.0], [10.0, 0.0], [10.0, 10.0]]);
    }
}
