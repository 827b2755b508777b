//! Templates of sites: SUMO sources in several sizes, and routes through them.
//!
//! Each lane leads to one lane of the next edge, so that no route needs a lane change: lane k to
//! lane k, except in a bottleneck. Traffic keeps to the right.

use std::f64::consts::{FRAC_PI_2, PI};

use super::plan::{LANE_WIDTH, Plan, Space};
use super::{Error, SPACING};
use crate::words::counted;

/// Kind of site.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Template {
    /// A junction with four arms, right before left: straight on, left, right.
    Cross,
    /// A junction with four arms and signals: straight on, left, right.
    Signals,
    /// A junction with three arms, where the straight road has priority.
    Tee,
    /// A roundabout with four arms, whose circle has priority.
    Roundabout,
    /// A ramp that joins a main road.
    Merge,
    /// Two by two junctions, right before left.
    Grid,
    /// A road in both directions with half as many lanes in the middle.
    Bottleneck,
    /// A road between two rows of parking spaces, on which vehicles steer.
    Parking,
}

/// Sizes of a site.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sizes {
    /// Lanes per direction. `None`: the smallest number that the template allows, which is 2 for a
    /// bottleneck and 1 for the others.
    pub lanes: Option<u32>,
    /// Minimum length of the lanes on which vehicles begin \[m\]. `None`: the length that the
    /// agents need, at least 30 m.
    pub arm_length: Option<f64>,
    /// Number of agents.
    pub agents: u32,
    /// Speed limit and top speed of the vehicles \[m/s\].
    pub speed: f64,
    /// Whether vehicles steer instead of following their lanes. In a parking lot they always do.
    pub steering: bool,
}

/// Arms of a site: name, and heading into the site in quarter turns counter-clockwise from east.
const ARMS: [(&str, usize); 4] = [("west", 0), ("south", 1), ("east", 2), ("north", 3)];
/// Turns at a junction: name, and quarter turns counter-clockwise.
const TURNS: [(&str, usize); 3] = [("straight", 0), ("left", 1), ("right", 3)];
/// Unit vectors of the four headings.
const HEADINGS: [[f64; 2]; 4] = [[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]];
/// Length of a lane that is not taken by its spawn places \[m\].
const FREE: f64 = 10.0;
/// Half the length of a vehicle \[m\], and the decision interval \[s\].
const HALF: f64 = 2.26;
const INTERVAL: f64 = 0.1;
/// Length of the shortest lane \[m\].
const SHORTEST: f64 = 30.0;
/// Angle between the ramp and the main road \[rad\].
const RAMP: f64 = PI / 6.0;
/// Radius of the curves between the road and the spaces, and length of a space \[m\].
const CURVE: f64 = 4.0;
const DEPTH: f64 = 8.0;
/// Distance from the last of these curves to the beginning of the line between the directions
/// \[m\]. In a narrow curve, a vehicle with tyres points up to 26 degrees to the inside of its
/// path.
const STRAIGHT: f64 = 1.0;
/// Largest number of agents of a parking lot, which has four routes for each agent, and highest
/// speed, from which a vehicle stops within the detection range \[m/s\].
const LOT_AGENTS: u32 = 60;
const LOT_SPEED: f64 = 22.222;

impl Template {
    /// All templates.
    pub const ALL: [Self; 8] = [
        Self::Cross,
        Self::Signals,
        Self::Tee,
        Self::Roundabout,
        Self::Merge,
        Self::Grid,
        Self::Bottleneck,
        Self::Parking,
    ];

    /// Returns the template's name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Cross => "cross",
            Self::Signals => "signals",
            Self::Tee => "tee",
            Self::Roundabout => "roundabout",
            Self::Merge => "merge",
            Self::Grid => "grid",
            Self::Bottleneck => "bottleneck",
            Self::Parking => "parking",
        }
    }

    /// Returns the template with this name.
    pub fn by_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|template| template.name() == name)
    }

    /// Returns a description in one sentence.
    pub(super) fn description(self) -> &'static str {
        match self {
            Self::Cross => {
                "Vehicles cross an unsignalised intersection: straight on, left or right."
            }
            Self::Signals => {
                "Vehicles cross an intersection with signals: straight on, left or right."
            }
            Self::Tee => "Vehicles pass an unsignalised T-junction.",
            Self::Roundabout => "Vehicles enter a roundabout and leave it at one of three exits.",
            Self::Merge => "Vehicles from a ramp merge into those of a main road.",
            Self::Grid => "Vehicles drive through four unsignalised intersections.",
            Self::Bottleneck => {
                "Vehicles merge where a road loses half of its lanes, and spread out behind it."
            }
            Self::Parking => "Vehicles enter and leave the spaces of a parking lot.",
        }
    }

    /// Returns the number of lanes per direction.
    pub(super) fn lanes(self, sizes: &Sizes) -> Result<u32, Error> {
        let (least, most, usual) = match self {
            Self::Bottleneck => (2, 4, 2),
            Self::Parking => (1, 1, 1),
            _ => (1, 4, 1),
        };
        let lanes = sizes.lanes.unwrap_or(usual);
        if !(least..=most).contains(&lanes) {
            let range =
                if least == most { least.to_string() } else { format!("{least} to {most}") };
            return Err(Error::size("lanes", &lanes, format!("{range} for `{}`", self.name())));
        }
        Ok(lanes)
    }

    /// Returns the site, and the number of spawn places on each lane where vehicles begin.
    pub(super) fn plan(self, sizes: &Sizes) -> Result<(Plan, u32), Error> {
        let lanes = self.lanes(sizes)?;
        let (agents, speed, kind) = match self {
            Self::Parking => (LOT_AGENTS, LOT_SPEED, " for `parking`"),
            _ => (768, 70.0, ""),
        };
        if !(1..=agents).contains(&sizes.agents) {
            return Err(Error::size("agents", &sizes.agents, format!("1 to {agents}{kind}")));
        }
        if !(1.0..=speed).contains(&sizes.speed) {
            return Err(Error::size("speed", &sizes.speed, format!("1 to {speed} m/s{kind}")));
        }
        let starts = match self {
            Self::Cross | Self::Signals | Self::Roundabout => 4 * lanes,
            Self::Tee => 3 * lanes,
            Self::Merge => lanes + 1,
            Self::Grid => 8 * lanes,
            Self::Bottleneck | Self::Parking => 2 * lanes,
        };
        // A parking lot has two rows of `places` spaces each: one space for each vehicle from
        // outside.
        let fewest = if self == Self::Parking { 2 } else { 1 };
        let places = sizes.agents.div_ceil(starts).max(fewest);
        let ahead = if self == Self::Roundabout { quarter(radius(lanes)) } else { 0.0 };
        let needed = (FREE + SPACING * f64::from(places) + ahead).max(SHORTEST);
        let arm = sizes.arm_length.unwrap_or(needed);
        if !(needed..=5000.0).contains(&arm) {
            let allowed = format!(
                "{needed} to 5000 m for {} on {starts} lanes",
                counted(sizes.agents, "agent")
            );
            return Err(Error::size("arm-length", &arm, allowed));
        }
        let mut plan = match self {
            Self::Cross => streets(1, &ARMS, "right_before_left", lanes, arm),
            Self::Signals => streets(1, &ARMS, "traffic_light", lanes, arm),
            Self::Tee => streets(1, &ARMS[..3], "priority", lanes, arm),
            Self::Grid => streets(2, &ARMS, "right_before_left", lanes, arm),
            Self::Roundabout => roundabout(lanes, arm),
            Self::Merge => merge(lanes, arm),
            Self::Bottleneck => bottleneck(lanes, arm),
            Self::Parking => parking(places, arm),
        };
        // The vehicle must be observed beyond the finish line before SUMO removes it at the end of
        // its route.
        let finish = (HALF + sizes.speed * INTERVAL).ceil();
        plan.routes.iter_mut().for_each(|route| route.arrival_pos = route.arrival_pos.min(-finish));
        Ok((plan, places))
    }
}

/// Returns `size` x `size` junctions of a type with arms on the given sides. Roads between junctions and to
/// the ends of the arms are `arm` metres long.
fn streets(size: usize, arms: &[(&str, usize)], kind: &'static str, lanes: u32, arm: f64) -> Plan {
    let side = arm + corner(lanes);
    let place = |[column, row]: [usize; 2]| [column as f64 * side, row as f64 * side];
    let junction = |[column, row]: [usize; 2]| {
        if size == 1 { "centre".to_owned() } else { format!("junction_{column}_{row}") }
    };
    // The arm on a side of a cell: each row or column has one.
    let outside = |quarter: usize, [column, row]: [usize; 2]| {
        let (name, _) = *arms.iter().find(|(_, own)| *own == quarter)?;
        let number = if quarter.is_multiple_of(2) { row } else { column };
        Some(if size == 1 { name.to_owned() } else { format!("{name}_{number}") })
    };
    let beyond = |[column, row]: [usize; 2], heading: usize| {
        let [dx, dy] = HEADINGS[heading].map(|v| v as isize);
        let cell = [column.checked_add_signed(dx)?, row.checked_add_signed(dy)?];
        cell.iter().all(|&i| i < size).then_some(cell)
    };
    // The edge that leaves a cell, and the cell that it leads to, if any.
    let leaving = |cell: [usize; 2], heading: usize| match beyond(cell, heading) {
        Some(next) => Some((format!("{}_to_{}", junction(cell), junction(next)), Some(next))),
        None => Some((format!("{}_out", outside((heading + 2) % 4, cell)?), None)),
    };
    let entering = |cell: [usize; 2], heading: usize| match beyond(cell, (heading + 2) % 4) {
        Some(before) => Some(leaving(before, heading)?.0),
        None => Some(format!("{}_in", outside(heading, cell)?)),
    };
    let mut plan = Plan::default();
    for cell in (0..size * size).map(|i| [i % size, i / size]) {
        plan.node(junction(cell), place(cell), kind);
        for (heading, [dx, dy]) in HEADINGS.into_iter().enumerate() {
            let Some(from) = entering(cell, heading) else { continue };
            if let Some(before) = beyond(cell, (heading + 2) % 4) {
                plan.edge(from.clone(), [&junction(before), &junction(cell)], lanes);
            } else if let Some(name) = outside(heading, cell) {
                let [x, y] = place(cell);
                plan.node(name.clone(), [x - dx * side, y - dy * side], "dead_end");
                plan.edge(from.clone(), [&name, &junction(cell)], lanes);
                plan.edge(format!("{name}_out"), [&junction(cell), &name], lanes);
                for (turn, by) in TURNS {
                    let Some(route) = drive(&leaving, cell, (heading + by) % 4) else { continue };
                    let edges: Vec<String> = std::iter::once(from.clone()).chain(route).collect();
                    plan.route(&format!("{name}_{turn}"), &edges, lanes);
                }
            }
            for (_, by) in TURNS {
                if let Some((to, _)) = leaving(cell, (heading + by) % 4) {
                    (0..lanes).for_each(|lane| plan.link(&from, &to, [lane, lane]));
                }
            }
        }
    }
    plan
}

/// Returns the edges straight on from a cell to the outside.
fn drive(
    leaving: &impl Fn([usize; 2], usize) -> Option<(String, Option<[usize; 2]>)>,
    mut cell: [usize; 2],
    heading: usize,
) -> Option<Vec<String>> {
    let mut edges = Vec::new();
    loop {
        let (edge, next) = leaving(cell, heading)?;
        edges.push(edge);
        match next {
            Some(next) => cell = next,
            None => return Some(edges),
        }
    }
}

/// Returns an upper bound of the distance that a junction reaches into its roads \[m\].
fn corner(lanes: u32) -> f64 {
    8.0 + 5.0 * f64::from(lanes)
}

/// Returns the radius of a roundabout's centre line \[m\].
fn radius(lanes: u32) -> f64 {
    14.0 + 6.0 * f64::from(lanes)
}

/// Returns the distance around a roundabout from one arm to the next \[m\].
fn quarter(radius: f64) -> f64 {
    (radius * FRAC_PI_2).round()
}

fn roundabout(lanes: u32, arm: f64) -> Plan {
    let radius = radius(lanes);
    let mut plan = Plan::default();
    let ring = |turns: usize| format!("ring_{}", ARMS[turns % 4].0);
    for (name, turns) in ARMS {
        let [dx, dy] = HEADINGS[turns];
        let outer = radius + arm + corner(lanes);
        let node = format!("{name}_entry");
        plan.node(node.clone(), [-radius * dx, -radius * dy], "priority");
        plan.node(name, [-outer * dx, -outer * dy], "dead_end");
        plan.edge(format!("{name}_in"), [name, &node], lanes);
        plan.edge(format!("{name}_out"), [&node, name], lanes);
        let start = PI + FRAC_PI_2 * turns as f64;
        let angles = (0..=8).map(|k| start + FRAC_PI_2 * f64::from(k) / 8.0);
        let arc = angles.map(|angle| [radius * angle.cos(), radius * angle.sin()]).collect();
        // The circle leads counter-clockwise to the next arm.
        plan.edge(ring(turns), [&node, &format!("{}_entry", ARMS[(turns + 1) % 4].0)], lanes)
            .shape = arc;
        for lane in 0..lanes {
            plan.link(&format!("{name}_in"), &ring(turns), [lane, lane]);
            plan.link(&ring(turns + 3), &ring(turns), [lane, lane]);
            plan.link(&ring(turns + 3), &format!("{name}_out"), [lane, lane]);
        }
        // Vehicles from west and east begin further ahead, so that they reach the next arm together
        // with the vehicles from there. Otherwise full throttle would succeed.
        if turns.is_multiple_of(2) {
            plan.ahead.insert(format!("{name}_in"), quarter(radius));
        }
        for (exit, turn) in ["right", "straight", "left"].into_iter().enumerate() {
            let route = (0..=exit).map(|k| ring(turns + k));
            let out = format!("{}_out", ARMS[(turns + exit + 1) % 4].0);
            let edges: Vec<String> =
                std::iter::once(format!("{name}_in")).chain(route).chain([out]).collect();
            plan.route(&format!("{name}_{turn}"), &edges, lanes);
        }
    }
    let names = |id: &dyn Fn(&str) -> String| ARMS.iter().map(|(name, _)| id(name)).collect();
    plan.ring =
        Some((names(&|name| format!("{name}_entry")), names(&|name| format!("ring_{name}"))));
    plan
}

fn merge(lanes: u32, arm: f64) -> Plan {
    // At a small angle, the junction reaches far into both roads.
    let outer = arm + 4.0 * corner(lanes);
    let mut plan = Plan::default();
    plan.node("west", [-outer, 0.0], "dead_end");
    plan.node("ramp", [-outer * RAMP.cos(), -outer * RAMP.sin()], "dead_end");
    plan.node("merge", [0.0, 0.0], "priority");
    plan.node("east", [outer, 0.0], "dead_end");
    plan.edge("main_in", ["west", "merge"], lanes);
    plan.edge("ramp_in", ["ramp", "merge"], 1);
    plan.edge("main_out", ["merge", "east"], lanes);
    (0..lanes).for_each(|lane| plan.link("main_in", "main_out", [lane, lane]));
    plan.link("ramp_in", "main_out", [0, 0]);
    plan.route("main", &["main_in", "main_out"].map(String::from), lanes);
    plan.route("ramp", &["ramp_in", "main_out"].map(String::from), 1);
    plan
}

fn bottleneck(lanes: u32, arm: f64) -> Plan {
    let narrow = lanes / 2;
    let (inner, outer) = (20.0, 20.0 + arm + 2.0 * corner(lanes));
    let mut plan = Plan::default();
    for (name, side) in [("west", -1.0), ("east", 1.0)] {
        plan.node(name, [side * outer, 0.0], "dead_end");
        plan.node(format!("{name}_end"), [side * inner, 0.0], "priority");
    }
    for (direction, from, to) in [("eastbound", "west", "east"), ("westbound", "east", "west")] {
        let (near, far) = (format!("{from}_end"), format!("{to}_end"));
        let [entry, middle, exit] =
            [format!("{from}_in"), format!("{direction}_narrow"), format!("{to}_out")];
        plan.edge(entry.clone(), [from, &near], lanes);
        plan.edge(middle.clone(), [&near, &far], narrow);
        plan.edge(exit.clone(), [&far, to], lanes);
        for lane in 0..lanes {
            plan.link(&entry, &middle, [lane, (lane / 2).min(narrow - 1)]);
        }
        // Each lane leads to one lane: from a lane that leads to several, SUMO chooses.
        (0..narrow).for_each(|lane| plan.link(&middle, &exit, [lane, 2 * lane]));
        plan.route(direction, &[entry, middle, exit], lanes);
    }
    plan
}

/// Returns two rows of `spaces` parking spaces beside a road that continues for `arm` metres to the
/// west and to the east.
///
/// As in `sumo_nets/parking_lot`, vehicles enter every space from both directions and leave it in
/// both directions, along quarter circles. The edges into a space and out of it lie on one another.
fn parking(spaces: u32, arm: f64) -> Plan {
    let half = LANE_WIDTH / 2.0;
    // Distances from the middle to the last space, to the end of the lot, and to the beginning of
    // the spaces.
    let last = half * f64::from(spaces - 1);
    let (end, mouth) = (last + CURVE + STRAIGHT, half + CURVE);
    let mut plan = Plan { lot: true, ..Plan::default() };
    plan.node("lot", [0.0, 0.0], "right_before_left").shape =
        vec![[-end, -mouth], [-end, mouth], [end, mouth], [end, -mouth]];
    let sides = [("west", -1.0), ("east", 1.0)];
    for (name, side) in sides {
        plan.node(name, [side * (end + arm), 0.0], "dead_end");
        plan.edge(format!("{name}_in"), [name, "lot"], 1);
        plan.edge(format!("{name}_out"), ["lot", name], 1);
    }
    plan.connection("west_in", "east_out", vec![[-end, -half], [end, -half]]);
    plan.connection("east_in", "west_out", vec![[end, half], [-end, half]]);
    let rows = [1.0, -1.0].into_iter().flat_map(|up| (0..spaces).map(move |column| (up, column)));
    let places: Vec<(String, f64, f64)> = rows
        .enumerate()
        .map(|(i, (up, column))| {
            (format!("space{}", i + 1), up, LANE_WIDTH * f64::from(column) - last)
        })
        .collect();
    for (space, up, x) in &places {
        let [entry, exit] = ["in", "out"].map(|end| format!("{space}_{end}"));
        // The edges into and out of a space have separate end nodes: netconvert would move edges
        // with a common end node apart.
        let ends = ["end", "start"].map(|which| format!("{space}_{which}"));
        let [near, far] = [mouth, mouth + DEPTH].map(|y| [*x, up * y]);
        for id in &ends {
            plan.node(id.clone(), far, "dead_end");
        }
        let edge = plan.edge(entry.clone(), ["lot", &ends[0]], 1);
        (edge.shape, edge.centred) = (vec![near, far], true);
        let edge = plan.edge(exit.clone(), [&ends[1], "lot"], 1);
        (edge.shape, edge.centred) = (vec![far, near], true);
        for (name, side) in sides {
            // A quarter circle from a lane at one side of the lot into the space.
            let bend = |lane: f64| {
                let angles = (0..=9).map(|k| FRAC_PI_2 * f64::from(k) / 9.0);
                let arc = angles.map(|angle| {
                    [
                        x + side * CURVE * (1.0 - angle.sin()),
                        lane + up * CURVE * (1.0 - angle.cos()),
                    ]
                });
                std::iter::once([side * end, lane]).chain(arc).chain([near]).collect::<Vec<_>>()
            };
            plan.connection(&format!("{name}_in"), &entry, bend(side * half));
            let mut out = bend(-side * half);
            out.reverse();
            plan.connection(&exit, &format!("{name}_out"), out);
        }
        plan.single.insert(exit);
        plan.spaces.push(Space { id: space.clone(), edge: entry, depth: DEPTH });
    }
    for (name, _) in sides {
        for (space, ..) in &places {
            plan.route(
                &format!("{name}_{space}"),
                &[format!("{name}_in"), format!("{space}_in")],
                1,
            );
        }
    }
    plan.routes.iter_mut().for_each(|route| route.reserved = true);
    for (space, ..) in &places {
        for (name, _) in sides {
            plan.route(
                &format!("{space}_{name}"),
                &[format!("{space}_out"), format!("{name}_out")],
                1,
            );
        }
    }
    plan
}
