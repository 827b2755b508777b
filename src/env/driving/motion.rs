//! Motion of the agents: turns actions into SUMO's commands, and SUMO's snapshots into poses.

use super::agents::{Slot, Status, Track};
use super::geometry::Pose;
use super::lane_routes::Side;
use super::map::RoutePosition;
use super::routes::RouteGeometry;
use super::task::{Driver, Task};
use super::vehicle::longitudinal;
use crate::env::error::Error;
use crate::scenario::LaneChange;
use crate::sumo::{Body, Command, Snapshot};

/// SUMO's speed mode with all checks of SUMO's own driver.
pub(super) const SUMO_CHECKS: i32 = 31;
/// SUMO's speed mode with every check off.
pub(super) const NO_CHECKS: i32 = 32;

/// SUMO's lane change mode in which a vehicle changes lanes only on request, whoever is in the way.
const ON_REQUEST: i32 = 0;
/// SUMO's lane change mode for changes that the route or the cooperation with others demands.
const FOR_ROUTE: i32 = 0b0101;
/// Time for which an agent keeps its lane after a lane change \[s\].
pub(super) const LANE_TIME: f64 = 3.0;
/// Value of an action's last dimension from which the agent asks for the lane to the left.
const ASKS: f64 = 1.0 / 3.0;

/// Returns the command that says which lane changes SUMO may make by itself with an agent that has
/// just been added; `None` if its driver changes lanes as its model wants, or if it has no choice of
/// lanes.
pub(super) fn lane_change_mode(
    task: &Task,
    driver: Driver,
    world: u32,
    slot: u32,
) -> Option<Command> {
    let mode = match task.scenario.control.lane_change {
        LaneChange::Route | LaneChange::Action if driver == Driver::Sumo => return None,
        LaneChange::Route => FOR_ROUTE,
        LaneChange::None | LaneChange::Action => ON_REQUEST,
    };
    task.map.several_lanes.then_some(Command::LaneChangeMode { world, slot, mode })
}

/// Appends the commands of a step for the agents' slots. `actions` is `[N, A]`, of which only
/// active agents' entries count.
pub(super) fn act(
    task: &Task,
    driver: Driver,
    world: u32,
    actions: &[f32],
    agents: &mut [Slot],
    commands: &mut Vec<Command>,
) {
    let width = task.spec.actions.len();
    for (i, (slot, actions)) in agents.iter_mut().zip(actions.chunks_exact(width)).enumerate() {
        let at = i as u32;
        match slot.status {
            Status::Active if driver != Driver::Sumo => {
                drive(task, world, at, actions, slot, commands);
            }
            Status::Wreck if slot.wreck_steps == 0 => {
                slot.status = Status::Empty;
                slot.added = false;
                commands.push(Command::Remove { world, slot: at });
            }
            Status::Wreck => {
                slot.wreck_steps -= 1;
                if task.steers(driver) {
                    move_to_pose(task, world, at, slot, commands);
                    continue;
                }
                commands.push(Command::SetSpeed { world, slot: at, speed: 0.0 });
                if task.changes_lanes() {
                    let mode = ON_REQUEST;
                    commands.push(Command::LaneChangeMode { world, slot: at, mode });
                }
            }
            Status::Empty if slot.added && !slot.is_waiting() => {
                slot.added = false;
                commands.push(Command::Remove { world, slot: at });
            }
            _ => {}
        }
    }
}

/// Moves an active agent by its actions.
fn drive(
    task: &Task,
    world: u32,
    at: u32,
    actions: &[f32],
    slot: &mut Slot,
    commands: &mut Vec<Command>,
) {
    let (control, vehicle) = &task.abilities[slot.kind];
    let action = |k: usize| {
        let action = f64::from(actions[k]);
        if action.is_nan() { 0.0 } else { action.clamp(-1.0, 1.0) }
    };
    if let Some(steering) = &control.steering {
        (slot.steer, slot.action) = (action(0), action(1));
        slot.motion = slot.motion.advance(control, steering, vehicle, slot.steer, slot.action);
        slot.speed = slot.motion.velocity.x;
        move_to_pose(task, world, at, slot, commands);
    } else {
        slot.action = action(0);
        let (distance, speed) = longitudinal::advance(control, vehicle, slot.speed, slot.action);
        slot.speed = speed;
        // SUMO moves a vehicle by its new speed times the step length, so that the mean speed over
        // the step gives the exact distance.
        let mean = distance / control.interval;
        commands.push(Command::SetSpeed { world, slot: at, speed: mean });
        slot.lane_steps = slot.lane_steps.saturating_sub(1);
        let side = match control.lane_change {
            LaneChange::Action if action(1) > ASKS => Side::Left,
            LaneChange::Action if action(1) < -ASKS => Side::Right,
            _ => return,
        };
        if slot.lane_steps == 0
            && let Some((_, lane)) = task.map.lane_routes.beside(slot, side)
            && task.map.stays_on_lane(slot, distance)
        {
            commands.push(Command::ChangeLane { world, slot: at, lane });
        }
    }
}

/// Moves a vehicle that steers to its pose in SUMO. On its lane, SUMO keeps the vehicle on the
/// centre line and is given the speed that takes it as far along the route as the pose is, because
/// `moveToXY` takes SUMO many times longer. A vehicle that stands still needs no command, unless it
/// has left its route: SUMO would remove it as arrived if it stood at the end of a lane.
fn move_to_pose(
    task: &Task,
    world: u32,
    slot: u32,
    vehicle: &mut Slot,
    commands: &mut Vec<Command>,
) {
    let pose = vehicle.motion.pose;
    let may_stand = vehicle.track == Track::Route || vehicle.status == Status::Wreck;
    if may_stand && vehicle.sent == Some((pose, 0.0)) {
        return;
    }
    let (sin, cos) = pose.heading.sin_cos();
    let half = task.scenario.vehicle.length / 2.0;
    let [x, y] = [pose.x + half * cos, pose.y + half * sin];
    let (place, s) = task.map.locate(vehicle.route, [x, y], vehicle.segment);
    if place == RoutePosition::Beside {
        vehicle.track = Track::Astray;
    }
    let place = if vehicle.track == Track::Route { place } else { RoutePosition::Beside };
    let distance = task.map.routes[vehicle.route].lanes().distance_of_arc(s);
    let held = vehicle.held.take().filter(|_| place != RoutePosition::Beside);
    let speed = held.map(|held| (distance - held) / task.scenario.control.interval);
    if let Some(speed) =
        speed.filter(|speed| (0.0..=task.scenario.vehicle.max_speed).contains(speed))
    {
        vehicle.held = Some(distance);
        vehicle.sent = Some((pose, speed));
        commands.push(Command::SetSpeed { world, slot, speed });
        return;
    }
    // Over a junction, SUMO may put the vehicle on another lane that lies there and take it on
    // along that lane, so that it has another route.
    if place == RoutePosition::Junction {
        vehicle.track = Track::Astray;
    }
    vehicle.held = Some(distance).filter(|_| place == RoutePosition::Road);
    let speed = vehicle.speed.max(0.0);
    vehicle.sent = Some((pose, speed));
    commands.push(Command::SetSpeed { world, slot, speed });
    commands.push(Command::MoveTo {
        world,
        slot,
        x,
        y,
        heading: pose.heading,
        keep_route: place.keep_route(),
    });
}

/// Reads every agent's pose from the snapshot after step number `step`.
///
/// # Errors
/// [`Error::Vanished`] if SUMO has lost a vehicle.
pub(super) fn place(
    task: &Task,
    driver: Driver,
    world: u32,
    snapshot: &Snapshot,
    step: u32,
    agents: &mut [Slot],
) -> Result<(), Error> {
    let first = world as usize * task.slots();
    let steers = task.steers(driver);
    for (i, slot) in agents.iter_mut().enumerate() {
        (slot.before, slot.s_before) = (slot.pose, slot.s);
        if slot.status == Status::Empty && !slot.is_waiting() {
            continue;
        }
        let route = &task.map.routes[slot.route];
        let Some(vehicle) = snapshot.vehicles.get(first + i).copied().flatten() else {
            if slot.is_waiting() {
                continue;
            }
            if slot.departed
                && steers
                && (slot.track == Track::Astray || slot.status == Status::Wreck)
            {
                // The vehicle is on no lane for SUMO. How far beyond the end of a road that begins
                // depends on SUMO's version.
                slot.age += 1;
                take_own_pose(slot, route);
            } else if slot.departed && driver == Driver::Sumo && slot.status == Status::Wreck {
                // With SUMO's driver, a wreck may reach the end of its route before it has
                // stopped.
                (slot.status, slot.added) = (Status::Empty, false);
            } else if let Some(front) = front_at_its_end(task, slot) {
                // SUMO removes vehicles of route files where they arrive.
                (slot.s, slot.added) = (route.path.length(), false);
                let (point, heading) = route.path.at(front - slot.size[0] / 2.0);
                slot.pose = Pose::beside(point, heading, 0.0);
            } else if slot.departed || driver != Driver::Sumo {
                // SUMO's driver may have to wait for room before it departs, but a vehicle that
                // has departed must not disappear.
                return Err(Error::Vanished {
                    slot: i,
                    route: task.map.route_ids[slot.route].clone(),
                    position: slot.s,
                    length: route.path.length(),
                    step,
                });
            }
            continue;
        };
        let body = snapshot.bodies.get(first + i).copied().flatten();
        let departs = slot.is_waiting();
        if let (Some(departure), Some(body)) = (&mut slot.departure, body) {
            departure.time_loss = body.time_loss;
            if departs {
                // SUMO chose the place on the first edge.
                let lanes = route.lanes();
                let end = lanes.lane_stretches().next().map_or(0.0, |(_, _, end)| end);
                let (_, last) = lanes.locate(end * (1.0 - 1e-9));
                let (front, ..) = lanes.nearest_of([body.x, body.y], 0..last + 1);
                departure.origin = lanes.distance_of_arc(front) - vehicle.distance;
                slot.speed = vehicle.speed;
            }
        }
        slot.age = if departs { 0 } else { slot.age + 1 };
        if departs {
            (slot.status, slot.entered) = (Status::Active, step);
        }
        slot.departed = true;
        if driver == Driver::Sumo {
            slot.speed = vehicle.speed;
        }
        if steers {
            take_own_pose(slot, route);
            continue;
        }
        let half = slot.size[0] / 2.0;
        if task.changes_lanes() {
            let body = body.unwrap_or_default();
            place_on_lane(task, slot, &body, vehicle.speed);
            if departs {
                slot.before = slot.pose;
            }
            continue;
        }
        let origin = slot.departure.map_or(0.0, |departure| departure.origin);
        let front = route.lanes().arc_of_distance(vehicle.distance + origin);
        let (point, heading, segment) = route.lanes().body(front, 2.0 * half);
        let (sin, cos) = heading.sin_cos();
        slot.pose =
            Pose::beside([point[0] - half * cos, point[1] - half * sin], heading, slot.lateral);
        slot.s = route.on_path(front - half);
        slot.segment = segment;
        if departs {
            slot.before = slot.pose;
        }
    }
    Ok(())
}

/// Puts an agent that steers where its own motion has taken it.
fn take_own_pose(slot: &mut Slot, route: &RouteGeometry) {
    slot.pose = slot.motion.pose;
    (slot.s, slot.lateral, slot.segment) = route.path.project(slot.pose.point(), slot.segment);
}

/// Puts an agent that may change lanes where SUMO reports it, at the speed \[m/s\] with which SUMO
/// moved it in the last step.
fn place_on_lane(task: &Task, slot: &mut Slot, body: &Body, speed: f64) {
    let (map, half) = (&task.map, slot.size[0] / 2.0);
    let (lane, first) = (slot.lane, slot.lane.is_none());
    let changed = map.lane_routes.follow(&map.routes, slot, body);
    let path = map.routes[slot.route].lanes();
    let front = [body.x, body.y];
    let on_new_lane = changed.is_some();
    let (s, _, segment) = changed.unwrap_or_else(|| {
        let end = path.lane_stretches().next().map_or(0.0, |(_, _, end)| end);
        let on_first = 0..path.locate(end * (1.0 - 1e-9)).1 + 1;
        if first { path.nearest_of(front, on_first) } else { path.project(front, slot.segment) }
    });
    (slot.s, slot.segment) = (map.routes[slot.route].on_path(s - half), segment);
    if let (Some(from), Some(to)) = (lane, slot.lane)
        && from != to
        && map.lane_routes.are_beside(from, to)
    {
        slot.lane_steps = (LANE_TIME / task.scenario.control.interval).round() as u32;
    }
    let driven = speed * task.scenario.control.interval;
    if on_new_lane {
        // The two routes begin at different places.
        slot.s_before = slot.s - driven;
        slot.lines_passed = map.traffic_lights.passed_at(slot.route, slot.s_before + half);
    }
    if speed <= 0.0 {
        // SUMO stops a vehicle at the end of a lane on which its route does not go on.
        slot.speed = 0.0;
    }
    let (sin, cos) = body.heading.sin_cos();
    let centre = [body.x - half * cos, body.y - half * sin];
    slot.pose = Pose::beside(centre, body.heading, slot.lateral);
    if on_new_lane {
        // A lane change takes no time: nobody is between two lanes.
        slot.before = slot.pose.behind(driven);
    }
}

/// Returns the position of the front of an agent from a route file that reached the end of its trip
/// in the last step \[m\]; `None` if it did not.
fn front_at_its_end(task: &Task, slot: &Slot) -> Option<f64> {
    let end = slot.end_of_trip(&task.map).filter(|_| slot.status == Status::Active)?;
    let speed = slot.speed.max(task.scenario.vehicle.max_speed);
    let front = slot.s + slot.size[0] / 2.0;
    // A vehicle that SUMO drives may have gained some speed in the step.
    let within = (speed + 1.0) * task.scenario.control.interval + 0.5;
    (end - front <= within).then_some(end.max(front))
}
