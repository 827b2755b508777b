//! Spawning and motion of a world's vehicles: turns actions into SUMO's commands, and SUMO's
//! snapshots into poses.

use std::sync::Arc;

use super::super::geometry::Pose;
use super::super::slots::{EMPTY, Slot, Status, Track};
use super::super::steering::Motion;
use super::super::task::{AGENT_TYPE, RoutePosition, SUMO_TYPE, Task};
use super::super::{Error, dynamics, fcfs, pursuit};
use super::{Driver, Phase, World};
use crate::rng;
use crate::sumo::{Command, Snapshot};

/// SUMO's speed mode with every check off.
pub(super) const NO_CHECKS: i32 = 32;
/// SUMO's speed mode with all checks of SUMO's own driver.
const SUMO_CHECKS: i32 = 31;

/// A rule-based policy that follows its route by pure pursuit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pursuit {
    /// Speed \[m/s\].
    pub speed: f64,
    /// Whether the policy gives way by the rule first come, first served; otherwise it ignores
    /// other vehicles.
    pub gives_way: bool,
}

impl World {
    /// Writes the actions of such a policy for all slots, `[N, A]`.
    pub fn pursue(&self, Pursuit { speed, gives_way }: Pursuit, actions: &mut [f32]) {
        let (task, n) = (&*self.task, self.task.agents);
        let reverses = task.scenario.control.steering.is_some_and(|steering| steering.reverse);
        let waits = if gives_way { fcfs::giving_way(task, &self.traffic) } else { vec![false; n] };
        for (i, action) in actions.chunks_mut(task.spec.actions.len()).enumerate() {
            let [steer, throttle] = self.pursuit(i, if waits[i] { 0.0 } else { speed });
            // Where full brake does not drive backwards, it stops the vehicle fastest.
            let wanted = [steer, if waits[i] && !reverses { -1.0 } else { throttle }];
            // A vehicle that does not steer has the throttle as its only action.
            action
                .iter_mut()
                .zip(&wanted[2 - task.spec.actions.len()..])
                .for_each(|(to, from)| *to = *from as f32);
        }
    }

    /// Returns steering and throttle with which the agent of a slot follows its route at
    /// `speed` \[m/s\]. Steering is by pure pursuit; the throttle closes a gap in speed within
    /// half a second.
    pub fn pursuit(&self, slot: usize, speed: f64) -> [f64; 2] {
        let (task, own) = (&*self.task, &self.traffic.slots[slot]);
        let control = &task.scenario.control;
        let throttle = ((speed - own.speed) / (0.5 * control.accel)).clamp(-1.0, 1.0);
        let Some(steering) = control.steering.filter(|_| own.status == Status::Active) else {
            return [0.0, throttle];
        };
        [pursuit::steer(&steering, &task.routes[own.route].path, own.s, &own.pose), throttle]
    }

    /// Appends the commands of the coming exchange. `actions` is `[N, A]`, of which only active
    /// agents' entries count.
    pub fn act(&mut self, world: u32, actions: &[f32], commands: &mut Vec<Command>) {
        match self.phase {
            Phase::Idle | Phase::Spawning => {}
            Phase::Ended => self.spawn(world, commands),
            Phase::Running => {
                self.actions.extend_from_slice(actions);
                let task = &*self.task;
                for (i, slot) in self.traffic.slots[..task.agents].iter_mut().enumerate() {
                    let at = i as u32;
                    match slot.status {
                        Status::Active if self.driver == Driver::Agents => {
                            let (control, vehicle) =
                                (&task.scenario.control, &task.scenario.vehicle);
                            let actions = &actions
                                [i * task.spec.actions.len()..(i + 1) * task.spec.actions.len()];
                            let action = |k: usize| {
                                let action = f64::from(actions[k]);
                                if action.is_nan() { 0.0 } else { action.clamp(-1.0, 1.0) }
                            };
                            if let Some(steering) = &control.steering {
                                (slot.steer, slot.action) = (action(0), action(1));
                                slot.motion = slot.motion.advance(
                                    control,
                                    steering,
                                    vehicle,
                                    slot.steer,
                                    slot.action,
                                );
                                slot.speed = slot.motion.velocity.x;
                                moves(task, world, at, slot, commands);
                            } else {
                                slot.action = action(0);
                                let (distance, speed) =
                                    dynamics::advance(control, vehicle, slot.speed, slot.action);
                                slot.speed = speed;
                                // SUMO moves a vehicle by its new speed times the step length, so
                                // that the mean speed over the step gives the exact distance.
                                commands.push(Command::SetSpeed {
                                    world,
                                    slot: at,
                                    speed: distance / control.interval,
                                });
                            }
                        }
                        Status::Wreck if slot.wreck_steps == 0 => {
                            slot.status = Status::Empty;
                            slot.added = false;
                            commands.push(Command::Remove { world, slot: at });
                        }
                        Status::Wreck => {
                            slot.wreck_steps -= 1;
                            match &task.scenario.control.steering {
                                // SUMO does not have the vehicle any more.
                                Some(_) if slot.track == Track::Lost => {}
                                Some(_) if self.driver == Driver::Agents => {
                                    moves(task, world, at, slot, commands);
                                }
                                _ => {
                                    commands.push(Command::SetSpeed {
                                        world,
                                        slot: at,
                                        speed: 0.0,
                                    });
                                }
                            }
                        }
                        Status::Empty if slot.added => {
                            slot.added = false;
                            commands.push(Command::Remove { world, slot: at });
                        }
                        _ => {}
                    }
                }
                if self.task.others > 0 {
                    self.act_others(world, commands);
                }
            }
        }
    }

    /// Begins the next episode: draws its agents, routes and positions, and appends the commands
    /// that replace the vehicles on the road. The world becomes idle if no episode is left.
    fn spawn(&mut self, world: u32, commands: &mut Vec<Command>) {
        let task = Arc::clone(&self.task);
        let fresh = std::mem::take(&mut self.interrupted);
        let Some(episode) = self.order.begin() else {
            self.phase = Phase::Idle;
            return;
        };
        self.episode = episode;
        self.respawns += u64::from(!fresh);
        self.step = 0;
        self.total_reward = 0.0;
        self.step_rewards.clear();
        self.pairs.clear();
        (self.distance, self.crashes) = (0.0, 0);
        self.actions.clear();
        let mut rng = self.seed.index(self.episode).rng();
        let mut places: Vec<usize> = (0..task.places.len()).collect();
        rng::shuffle(&mut rng, &mut places);
        let half = task.scenario.vehicle.length / 2.0;
        let (vehicle_type, mode) = match self.driver {
            Driver::Agents => (AGENT_TYPE, NO_CHECKS),
            Driver::Sumo => (SUMO_TYPE, SUMO_CHECKS),
        };
        // The number is drawn only if there is a choice, so that the other random numbers do not
        // depend on this setting.
        let choice = task.agents - task.fewest;
        self.active_agents =
            task.fewest + if choice > 0 { rng::below(&mut rng, choice + 1) } else { 0 };
        let mut taken = Vec::new();
        let mut draw = |place: usize, rng: &mut rng::Rng| {
            let place = &task.places[places[place]];
            let free =
                |route: &&usize| task.reserved[**route].is_none_or(|end| !taken.contains(&end));
            let choice = place.routes.iter().filter(free).count();
            let drawn = if choice > 1 { rng::below(rng, choice) } else { 0 };
            // The scenario's check guarantees that a route is free.
            let route = *place.routes.iter().filter(free).nth(drawn).unwrap_or(&place.routes[0]);
            taken.extend(task.reserved[route]);
            (route, place.pos + rng::symmetric(rng) * task.scenario.jitter.longitudinal)
        };
        for (i, slot) in self.traffic.slots[..task.agents].iter_mut().enumerate() {
            let at = i as u32;
            if slot.added {
                commands.push(Command::Remove { world, slot: at });
            }
            if i >= self.active_agents {
                *slot = EMPTY;
                continue;
            }
            let (route, s) = draw(i, &mut rng);
            let lateral = rng::symmetric(&mut rng) * task.scenario.jitter.lateral;
            let path = &task.routes[route].path;
            let (point, heading) = path.at(path.arc(0, s).unwrap_or(s));
            let pose = Pose::beside(point, heading, lateral);
            *slot = Slot {
                status: Status::Active,
                route,
                size: [task.scenario.vehicle.length, task.scenario.vehicle.width],
                pose,
                before: pose,
                motion: Motion::at(pose),
                s,
                lateral,
                held: Some(s + half),
                added: true,
                ..EMPTY
            };
            commands.push(Command::Add {
                world,
                slot: at,
                route: route as u32,
                vehicle_type,
                depart_pos: s + half,
                depart_speed: 0.0,
            });
            commands.push(Command::SpeedMode { world, slot: at, mode });
            if task.several_lanes {
                commands.push(Command::KeepLane { world, slot: at });
            }
            if self.driver == Driver::Agents {
                commands.push(Command::SetSpeed { world, slot: at, speed: 0.0 });
            }
        }
        if task.others > 0 {
            let starts =
                (task.agents..task.agents + task.placed()).map(|place| draw(place, &mut rng));
            self.spawn_others(world, &starts.collect::<Vec<_>>(), commands);
        }
        self.phase = Phase::Spawning;
    }

    /// Reads every vehicle's pose from the snapshot.
    ///
    /// # Errors
    /// [`Error::Vanished`] if SUMO has lost a vehicle.
    pub(super) fn place(&mut self, world: u32, snapshot: &Snapshot) -> Result<(), Error> {
        let task = &*self.task;
        let first = world as usize * task.slots();
        let half = task.scenario.vehicle.length / 2.0;
        for (i, slot) in self.traffic.slots[..task.agents].iter_mut().enumerate() {
            slot.before = slot.pose;
            if slot.status == Status::Empty {
                continue;
            }
            let steers = self.driver == Driver::Agents && task.scenario.control.steering.is_some();
            let Some(vehicle) = snapshot.vehicles.get(first + i).copied().flatten() else {
                // SUMO removes a vehicle that is off its route when the vehicle reaches the end of
                // the road that it is on.
                if slot.departed
                    && steers
                    && (slot.track != Track::Route || slot.status == Status::Wreck)
                {
                    slot.track = Track::Lost;
                    slot.pose = slot.motion.pose;
                    continue;
                }
                // With SUMO's driver, a wreck may reach the end of its route before it has
                // stopped.
                if slot.departed && self.driver == Driver::Sumo && slot.status == Status::Wreck {
                    (slot.status, slot.added) = (Status::Empty, false);
                    continue;
                }
                // SUMO's driver may have to wait for room before it departs, but a vehicle that
                // has departed must not disappear.
                if slot.departed || self.driver == Driver::Agents {
                    let (route, length) =
                        (task.route_ids[slot.route].clone(), task.routes[slot.route].path.length());
                    return Err(Error::Vanished {
                        slot: i,
                        route,
                        position: slot.s,
                        length,
                        step: self.step,
                    });
                }
                continue;
            };
            slot.departed = true;
            if self.driver == Driver::Sumo {
                slot.speed = vehicle.speed;
            }
            let route = &task.routes[slot.route];
            if steers {
                slot.pose = slot.motion.pose;
                (slot.s, slot.lateral, slot.segment) =
                    route.path.project([slot.pose.x, slot.pose.y], slot.segment);
                continue;
            }
            let front = route.lanes().arc_of_distance(vehicle.distance);
            let (point, heading, segment) = route.lanes().body(front, 2.0 * half);
            let (sin, cos) = heading.sin_cos();
            slot.pose =
                Pose::beside([point[0] - half * cos, point[1] - half * sin], heading, slot.lateral);
            slot.s = route.on_way(front - half);
            slot.segment = segment;
        }
        if task.others > 0 {
            self.place_others(world, snapshot);
        }
        Ok(())
    }
}

/// Moves a vehicle that steers to its pose in SUMO. On its lane, SUMO keeps the vehicle on the
/// centre line and is given the speed that takes it as far along the route as the pose is, because
/// `moveToXY` takes SUMO many times longer. A vehicle that stands still needs no command.
fn moves(task: &Task, world: u32, slot: u32, vehicle: &mut Slot, commands: &mut Vec<Command>) {
    let pose = vehicle.motion.pose;
    if vehicle.sent == Some((pose, 0.0)) {
        return;
    }
    let (sin, cos) = pose.heading.sin_cos();
    let half = task.scenario.vehicle.length / 2.0;
    let [x, y] = [pose.x + half * cos, pose.y + half * sin];
    let (place, s) = task.locate(vehicle.route, [x, y], vehicle.segment);
    if place == RoutePosition::Beside {
        vehicle.track = Track::Astray;
    }
    // After the vehicle was beside its route, SUMO may have given it another route.
    let place = if vehicle.track == Track::Route { place } else { RoutePosition::Beside };
    let distance = task.routes[vehicle.route].lanes().distance_of_arc(s);
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
