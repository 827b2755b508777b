//! Which routes of a scenario begin alike, and where they part.

use super::routes::RouteGeometry;
use crate::sumo::net::{EdgeFunction, Net, Path};

/// The direction that an indicator shows. A U-turn is signalled as a left turn (in left-hand
/// traffic as a right turn).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Indicator {
    Off,
    Left,
    Right,
}

impl Indicator {
    /// Returns the indicator for a connection's `dir` in a SUMO net.
    fn of(direction: &str) -> Self {
        match direction {
            "l" | "L" | "t" => Self::Left,
            "r" | "R" | "T" => Self::Right,
            _ => Self::Off,
        }
    }
}

/// A route's passage through a junction, in positions along the route's path \[m\].
#[derive(Debug, Clone, Copy)]
pub(super) struct Passage {
    /// Index into the net's junctions; `None` where the net does not list the junction.
    pub(super) junction: Option<usize>,
    pub(super) from: f64,
    pub(super) to: f64,
    pub(super) indicator: Indicator,
}

/// Which routes of a task begin alike, and where they part.
#[derive(Debug, Clone)]
pub(super) struct Forks {
    /// For every route: the routes that begin like it, itself included, in ascending order.
    pub(super) alike: Vec<Vec<usize>>,
    /// For every route and each of its `alike`: position up to which both paths have the same
    /// points \[m\].
    pub(super) together: Vec<Vec<f64>>,
    /// For every route: its junctions, in driving order.
    pub(super) passages: Vec<Vec<Passage>>,
}

impl Forks {
    pub(super) fn new(net: &Net, routes: &[RouteGeometry]) -> Self {
        // Routes that begin alike get one label, the smallest of their indices.
        let mut labels: Vec<usize> = (0..routes.len()).collect();
        for a in 0..routes.len() {
            for b in 0..a {
                if labels[a] != labels[b] && begin_alike(&routes[a], &routes[b]) {
                    let (kept, gone) = (labels[a].min(labels[b]), labels[a].max(labels[b]));
                    labels
                        .iter_mut()
                        .filter(|label| **label == gone)
                        .for_each(|label| *label = kept);
                }
            }
        }
        let like =
            |a: usize| (0..routes.len()).filter(|&b| labels[b] == labels[a]).collect::<Vec<_>>();
        let alike: Vec<Vec<usize>> = (0..routes.len()).map(like).collect();
        let together = |(a, alike): (usize, &Vec<usize>)| {
            alike.iter().map(|&b| common_length(&routes[a].path, &routes[b].path)).collect()
        };
        let together = alike.iter().enumerate().map(together).collect();
        Self {
            alike,
            together,
            passages: routes.iter().map(|route| passages(net, &route.path)).collect(),
        }
    }
}

/// Whether one of two routes begins on the other.
fn begin_alike(a: &RouteGeometry, b: &RouteGeometry) -> bool {
    if a.is_walked() != b.is_walked() {
        return false;
    }
    let begins_on = |a: &Path, b: &Path| {
        if let Some(lane) = a.lanes.first() {
            return b.lanes.contains(lane);
        }
        let (_, lateral, segment) = b.nearest(a.points[0]);
        let ([ax, ay], [bx, by]) = (a.direction(0), b.direction(segment));
        lateral.abs() < 0.1 && ax * bx + ay * by > 0.99
    };
    begins_on(a.lanes(), b.lanes()) || begins_on(b.lanes(), a.lanes())
}

/// Returns the position up to which two paths have the same points \[m\].
fn common_length(a: &Path, b: &Path) -> f64 {
    let common = a.points.iter().zip(&b.points).take_while(|(p, q)| p == q).count();
    common.checked_sub(1).map_or(0.0, |last| a.cumulative[last])
}

fn passages(net: &Net, path: &Path) -> Vec<Passage> {
    let stretches: Vec<(usize, f64, f64)> = path.lane_stretches().collect();
    let is_road =
        |k: &usize| net.edges[net.lanes[stretches[*k].0].edge].function == EdgeFunction::Normal;
    let roads: Vec<usize> = (0..stretches.len()).filter(is_road).collect();
    let passage = |pair: &[usize]| {
        let [(lane, _, from), (next, to, _)] = [stretches[pair[0]], stretches[pair[1]]];
        let via = (pair[1] > pair[0] + 1).then(|| stretches[pair[0] + 1].0);
        let connection = net.connections_from(lane).find(|c| c.to == next && c.via == via);
        let id = net.edges[net.lanes[lane].edge].to.as_deref();
        Passage {
            junction: net.junctions.iter().position(|junction| Some(junction.id.as_str()) == id),
            from,
            to,
            indicator: connection.map_or(Indicator::Off, |c| Indicator::of(&c.dir)),
        }
    };
    roads.windows(2).map(passage).collect()
}
