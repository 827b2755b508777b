//! One world: an episode's slots, from spawn to arrival or wreck. It needs no simulator: commands go out, a snapshot comes in.
//!
//! An episode that has ended stays visible for one frame, whose
//! agents are observed but do not act: a truncated agent's last observation, from which its return is bootstrapped.
//! The respawn travels in the next exchange, so that every world takes exactly one exchange per step, whoever hosts it.

use std::sync::Arc;

use super::audit::{Ours, Pairs, Sumos};
use super::comm::physical_mask;
use super::failures::{Crash, Failures, UPSTREAM};
use super::geometry::{Pose, boxes_overlap};
use super::metrics::EpisodeRecord;
use super::order::{Order, Position};
use super::slots::{EMPTY, Fate, Slot, Status, Track, Traffic};
use super::steering::Motion;
use super::task::{AGENT_TYPE, Place, SUMO_TYPE, Task};
use super::{Error, dynamics, observation, state};
use crate::rng::{self, Seed};
use crate::scenario::Reward;
use crate::sumo::{Command, Snapshot};

/// Fractions of a step at which boxes are tested: the simulator of the paper's task tests every 0.02 s.
const SUBSTEPS: u32 = 5;
/// Margin between wheel track and road border at which a vehicle is out of road \[m\], as measured on the paper's simulator.
const BORDER_MARGIN: f64 = 0.035;
/// How far ahead on its route the point lies that pure pursuit steers for \[m\].
const LOOK_AHEAD: f64 = 4.0;
/// SUMO's speed mode with every check off.
const NO_CHECKS: i32 = 32;
/// SUMO's speed mode of its own driver.
const SUMO_CHECKS: i32 = 31;

/// Who chooses the speeds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Driver {
    /// The actions.
    Agents,
    /// SUMO's own driver and right of way; actions are ignored.
    Sumo,
}

/// What agents and learners get from a world after an exchange. Reused from step to step.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// `[N, O]`; zeros where no agent is present.
    pub observation: Vec<f32>,
    /// `[N, S]`; zeros where no agent is present.
    pub state: Vec<f32>,
    /// Physical mask G_p, `[N, N]`; its diagonal tells who is present.
    pub comm: Vec<f32>,
    /// `[N]`, 1 where an agent acts in the coming step.
    pub active: Vec<f32>,
    /// Whether a new trajectory starts here (memories are cleared).
    pub start: bool,
    /// `[N]`: what the last step gave, with the cooperative mix.
    pub reward: Vec<f32>,
    /// `[N]`, 1 where the last step ended an agent's trajectory for good.
    pub terminated: Vec<f32>,
    /// `[N]`, 1 where the last step cut an agent's trajectory short.
    pub truncated: Vec<f32>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    /// Nothing happens until [`World::reset`].
    Idle,
    /// The coming exchange respawns.
    Ended,
    /// The respawn is under way.
    Spawning,
    Running,
}

/// An agent as an onlooker sees it.
#[derive(Debug, Clone, Copy)]
pub struct AgentView {
    /// Whether it drives.
    pub driving: bool,
    /// Whether it stands there as a wreck.
    pub wreck: bool,
    /// How it ended.
    pub fate: Fate,
    /// Of its centre, the last one where it is gone.
    pub pose: Pose,
    /// Its route's number.
    pub route: usize,
    /// Position of its centre along that \[m\].
    pub position: f64,
    /// Offset from the route's centre line, positive to the left \[m\].
    pub lateral: f64,
    /// \[m/s\]
    pub speed: f64,
    /// What the last step gave it, without the cooperative mix.
    pub reward: f64,
}

/// Whom an agent overlaps with.
#[derive(Debug, Clone, Copy)]
struct Partner {
    slot: usize,
    /// It is a wreck.
    wreck: bool,
}

/// A world's place in its episodes, enough to bring it back to the very same state.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct WorldState {
    /// Number of the current episode.
    pub episode: u64,
    /// Actions since its spawn, `[steps, N]`.
    pub actions: Vec<f32>,
    /// SUMO died in the last exchange: `episode` is yet to start.
    pub interrupted: bool,
    /// Place in the order of episodes.
    pub position: Position,
}

/// One world.
#[derive(Debug, Clone)]
pub struct World {
    task: Arc<Task>,
    driver: Driver,
    seed: Seed,
    order: Order,
    episode: u64,
    phase: Phase,
    step: u32,
    /// Agents of the current episode; the first slots are theirs.
    crew: usize,
    traffic: Traffic,
    frame: Frame,
    own_rewards: Vec<f64>,
    /// Scratch: positions along the routes before the step, poses and presence after it, whom each overlaps with.
    positions: Vec<f64>,
    poses: Vec<Pose>,
    present: Vec<bool>,
    partners: Vec<Option<Partner>>,
    total_reward: f64,
    step_rewards: Vec<f32>,
    pairs: Pairs,
    actions: Vec<f32>,
    interrupted: bool,
    respawns: u64,
    finished: Option<EpisodeRecord>,
}

impl World {
    /// A world that plays episodes `first, first + stride, …` below `end` of the stream `seed`. It is idle until
    /// [`World::reset`], and again when there are no more.
    pub fn new(task: Arc<Task>, driver: Driver, seed: Seed, first: u64, stride: u64, end: u64) -> Self {
        let n = task.agents;
        let (o, s) = (task.spec.observation.len(), task.spec.state.len());
        Self {
            driver,
            order: Order::new(seed, first, stride, end),
            seed,
            episode: first,
            phase: Phase::Idle,
            step: 0,
            crew: n,
            traffic: Traffic::new(n, task.routes.len()),
            frame: Frame {
                observation: vec![0.0; n * o],
                state: vec![0.0; n * s],
                comm: vec![0.0; n * n],
                active: vec![0.0; n],
                start: false,
                reward: vec![0.0; n],
                terminated: vec![0.0; n],
                truncated: vec![0.0; n],
            },
            own_rewards: vec![0.0; n],
            positions: vec![0.0; n],
            poses: vec![Pose::default(); n],
            present: vec![false; n],
            partners: vec![None; n],
            total_reward: 0.0,
            step_rewards: Vec::new(),
            pairs: Pairs::default(),
            actions: Vec::new(),
            interrupted: false,
            respawns: 0,
            finished: None,
            task,
        }
    }

    /// The same, which plays an episode that failed again with this chance, where there is one, instead of the next.
    #[must_use]
    pub fn with_replay(self, chance: f64) -> Self {
        Self { order: self.order.with_replay(chance), ..self }
    }

    /// The last frame.
    pub fn frame(&self) -> &Frame {
        &self.frame
    }

    /// The episode that the last step ended, if it did.
    pub fn take_finished(&mut self) -> Option<EpisodeRecord> {
        self.finished.take()
    }

    /// Whether the last step ended an episode as it should.
    pub(super) fn has_finished(&self) -> bool {
        self.finished.as_ref().is_some_and(|record| !record.interrupted)
    }

    /// Episodes that started while the simulation went on.
    pub fn respawns(&self) -> u64 {
        self.respawns
    }

    /// Number of the current episode in its stream.
    pub fn episode(&self) -> u64 {
        self.episode
    }

    /// Number of the turn under way: that of the episode, as long as none was replayed.
    pub fn turn(&self) -> u64 {
        self.order.turn()
    }

    /// Step of the current episode.
    pub fn step_count(&self) -> u32 {
        self.step
    }

    /// Whether the current episode goes on.
    pub fn is_running(&self) -> bool {
        self.phase == Phase::Running
    }

    /// Whether the current episode has come to its end and is still to be seen.
    pub fn has_ended(&self) -> bool {
        self.phase == Phase::Ended && !self.interrupted && self.step > 0
    }

    /// All agents, by slot.
    pub fn agents(&self) -> impl Iterator<Item = AgentView> + '_ {
        self.traffic.slots.iter().zip(&self.own_rewards).map(|(slot, reward)| AgentView {
            driving: slot.status == Status::Active,
            wreck: slot.status == Status::Wreck,
            fate: slot.fate,
            pose: slot.pose,
            route: slot.route,
            position: slot.s,
            lateral: slot.lateral,
            speed: slot.speed,
            reward: *reward,
        })
    }

    /// Steering and throttle with which the agent of a slot pursues its route at `speed` \[m/s\]: the wheels point to the circle
    /// through a point ahead on the route, and throttle closes the gap in speed within half a second.
    pub fn pursuit(&self, slot: usize, speed: f64) -> [f64; 2] {
        let (task, own) = (&*self.task, &self.traffic.slots[slot]);
        let control = &task.scenario.control;
        let throttle = ((speed - own.speed) / (0.5 * control.accel)).clamp(-1.0, 1.0);
        let Some(steering) = control.steering.filter(|_| own.status == Status::Active) else {
            return [0.0, throttle];
        };
        let ([x, y], _) = task.routes[own.route].path.at(own.s + LOOK_AHEAD);
        let (dx, dy) = (x - own.pose.x, y - own.pose.y);
        let bearing = dy.atan2(dx) - own.pose.heading;
        let wheel = (2.0 * steering.wheelbase * bearing.sin() / dx.hypot(dy).max(1.0)).atan();
        [(wheel / steering.max_angle.to_radians()).clamp(-1.0, 1.0), throttle]
    }

    /// Whether there is nothing left to play.
    pub fn is_idle(&self) -> bool {
        self.phase == Phase::Idle
    }

    /// Place in the episodes, for a checkpoint.
    pub fn state(&self) -> WorldState {
        let position = self.order.position.clone();
        if self.interrupted {
            return WorldState { episode: position.next, actions: Vec::new(), interrupted: true, position };
        }
        WorldState { episode: self.episode, actions: self.actions.clone(), interrupted: false, position }
    }

    /// Lets the coming exchange start `episode`, whatever is on the road now.
    pub fn reset(&mut self, episode: u64) {
        self.order.go_to(episode);
        self.phase = Phase::Ended;
    }

    /// Lets the coming exchange start the next episode, whatever is on the road now.
    pub(super) fn start_next(&mut self) {
        self.phase = Phase::Ended;
    }

    /// Commands of the coming exchange; `actions` is `[N, A]`, of which only active agents' entries count.
    pub fn act(&mut self, world: u32, actions: &[f32], commands: &mut Vec<Command>) {
        match self.phase {
            Phase::Idle | Phase::Spawning => {}
            Phase::Ended => self.spawn(world, commands),
            Phase::Running => {
                self.actions.extend_from_slice(actions);
                let task = &*self.task;
                for (i, slot) in self.traffic.slots.iter_mut().enumerate() {
                    let at = i as u32;
                    match slot.status {
                        Status::Active if self.driver == Driver::Agents => {
                            let (control, vehicle) = (&task.scenario.control, &task.scenario.vehicle);
                            let actions = &actions[i * task.spec.actions..(i + 1) * task.spec.actions];
                            let action = |k: usize| {
                                let action = f64::from(actions[k]);
                                if action.is_nan() { 0.0 } else { action.clamp(-1.0, 1.0) }
                            };
                            if let Some(steering) = &control.steering {
                                (slot.steer, slot.action) = (action(0), action(1));
                                slot.motion = slot.motion.advance(control, steering, vehicle, slot.steer, slot.action);
                                slot.speed = slot.motion.speed;
                                commands.extend(moves(task, world, at, slot));
                            } else {
                                slot.action = action(0);
                                let (way, speed) = dynamics::advance(control, vehicle, slot.speed, slot.action);
                                slot.speed = speed;
                                // SUMO moves a vehicle by its new speed times the step: the mean speed gives the exact way.
                                commands.push(Command::SetSpeed { world, slot: at, speed: way / control.interval });
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
                                // SUMO knows no vehicle any more.
                                Some(_) if slot.track == Track::Lost => {}
                                Some(_) => commands.extend(moves(task, world, at, slot)),
                                None => commands.push(Command::SetSpeed { world, slot: at, speed: 0.0 }),
                            }
                        }
                        Status::Empty if slot.added => {
                            slot.added = false;
                            commands.push(Command::Remove { world, slot: at });
                        }
                        _ => {}
                    }
                }
            }
        }
    }

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
        self.actions.clear();
        let mut rng = self.seed.index(self.episode).rng();
        let mut places: Vec<usize> = (0..task.places.len()).collect();
        rng::shuffle(&mut rng, &mut places);
        let half = task.scenario.vehicle.length / 2.0;
        let (vehicle_type, mode) = match self.driver {
            Driver::Agents => (AGENT_TYPE, NO_CHECKS),
            Driver::Sumo => (SUMO_TYPE, SUMO_CHECKS),
        };
        // A draw only where there is a choice, so that the others stay as they are.
        let choice = task.agents - task.fewest;
        self.crew = task.fewest + if choice > 0 { rng::below(&mut rng, choice + 1) } else { 0 };
        for (i, slot) in self.traffic.slots.iter_mut().enumerate() {
            let at = i as u32;
            if slot.added {
                commands.push(Command::Remove { world, slot: at });
            }
            if i >= self.crew {
                *slot = EMPTY;
                continue;
            }
            let place = &task.places[places[i]];
            let choice = place.routes.len();
            let route = place.routes[if choice > 1 { rng::below(&mut rng, choice) } else { 0 }];
            let s = place.pos + rng::symmetric(&mut rng) * task.scenario.jitter.longitudinal;
            let lateral = rng::symmetric(&mut rng) * task.scenario.jitter.lateral;
            let path = &task.routes[route].path;
            let (point, heading) = path.at(path.arc(0, s).unwrap_or(s));
            let pose = Pose::beside(point, heading, lateral);
            *slot = Slot {
                status: Status::Active,
                route,
                pose,
                before: pose,
                motion: Motion::at(pose),
                s,
                lateral,
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
            if self.driver == Driver::Agents {
                if task.several_lanes {
                    commands.push(Command::KeepLane { world, slot: at });
                }
                commands.push(Command::SetSpeed { world, slot: at, speed: 0.0 });
            }
        }
        self.phase = Phase::Spawning;
    }

    /// Takes in what the exchange brought, as world number `world` of the snapshot.
    ///
    /// # Errors
    /// [`Error::Vanished`] when SUMO lost a vehicle.
    pub fn observe(&mut self, world: u32, snapshot: &Snapshot) -> Result<(), Error> {
        let n = self.task.agents;
        match self.phase {
            Phase::Idle | Phase::Ended => return Ok(()),
            Phase::Spawning => {
                self.place(world, snapshot)?;
                self.phase = Phase::Running;
                self.frame.start = true;
                self.frame.reward.fill(0.0);
                self.frame.terminated.fill(0.0);
                self.frame.truncated.fill(0.0);
            }
            Phase::Running => {
                self.frame.start = false;
                self.step += 1;
                self.own_rewards.fill(0.0);
                self.frame.terminated.fill(0.0);
                self.frame.truncated.fill(0.0);
                self.advance(world, snapshot)?;
            }
        }
        self.traffic.refresh();
        if self.step > 0 {
            self.mix_rewards();
        }
        let horizon = self.step >= self.task.scenario.termination.horizon;
        let mut acting = 0;
        for (i, slot) in self.traffic.slots.iter().enumerate() {
            let present = slot.status == Status::Active;
            self.present[i] = present;
            self.poses[i] = slot.pose;
            self.frame.truncated[i] = f32::from(u8::from(present && horizon));
            self.frame.active[i] = f32::from(u8::from(present && !horizon));
            acting += u32::from(present && !horizon);
        }
        physical_mask(&self.poses, &self.present, self.task.scenario.communication.range, &mut self.frame.comm);
        let (o, s) = (self.task.spec.observation.len(), self.task.spec.state.len());
        for i in 0..n {
            let (seen, known) =
                (&mut self.frame.observation[i * o..(i + 1) * o], &mut self.frame.state[i * s..(i + 1) * s]);
            if self.present[i] {
                observation::write(&self.task.scenario, &self.task.routes, &self.traffic, i, seen);
                state::write(&self.task.scenario, &self.task.routes, self.task.bounds, &self.traffic, i, known);
            } else {
                seen.fill(0.0);
                known.fill(0.0);
            }
        }
        if acting == 0 && self.phase == Phase::Running {
            self.phase = Phase::Ended;
            let record = self.record(false);
            self.order.ended(self.episode, record.success >= 1.0);
            self.finished = Some(record);
        }
        Ok(())
    }

    /// SUMO is gone: the episode is cut short where it stands, and the next one starts with the coming exchange.
    pub fn interrupt(&mut self) {
        self.abandon();
        self.forget_vehicles();
    }

    /// As [`World::interrupt`], in a SUMO that goes on.
    pub(super) fn abandon(&mut self) {
        self.interrupted = true;
        if self.phase == Phase::Running {
            self.finished = Some(self.record(true));
            for (truncated, active) in self.frame.truncated.iter_mut().zip(&mut self.frame.active) {
                *truncated = *active;
                *active = 0.0;
            }
            self.frame.reward.fill(0.0);
            self.frame.terminated.fill(0.0);
            self.frame.start = false;
        } else if self.phase == Phase::Spawning {
            self.order.repeat(self.episode);
        }
        self.phase = Phase::Ended;
    }

    /// SUMO is fresh and empty: nothing is left to remove.
    pub(super) fn forget_vehicles(&mut self) {
        for slot in &mut self.traffic.slots {
            slot.added = false;
        }
    }

    /// The last touch of bringing the world back to a state, after its actions were played again.
    pub(super) fn restore(&mut self, state: &WorldState) {
        if state.interrupted {
            self.interrupted = true;
            self.start_next();
        }
        self.order.position = state.position.clone();
    }

    /// Whether the coming exchange respawns.
    pub(super) fn is_between_episodes(&self) -> bool {
        self.phase == Phase::Ended
    }

    /// Reads every vehicle's pose from the snapshot.
    fn place(&mut self, world: u32, snapshot: &Snapshot) -> Result<(), Error> {
        let task = &*self.task;
        let first = world as usize * task.agents;
        let half = task.scenario.vehicle.length / 2.0;
        for (i, slot) in self.traffic.slots.iter_mut().enumerate() {
            slot.before = slot.pose;
            if slot.status == Status::Empty {
                continue;
            }
            let steers = self.driver == Driver::Agents && task.scenario.control.steering.is_some();
            let Some(vehicle) = snapshot.vehicles.get(first + i).copied().flatten() else {
                // Off its route, a vehicle that steers ends with the road it is on: it leaves the net, on its own wheels.
                if slot.departed && steers && (slot.track != Track::Route || slot.status == Status::Wreck) {
                    slot.track = Track::Lost;
                    slot.pose = slot.motion.pose;
                    continue;
                }
                // SUMO's driver may have to wait for room before it departs; a vehicle that had departed cannot go.
                if slot.departed || self.driver == Driver::Agents {
                    return Err(Error::Vanished { slot: i, step: self.step });
                }
                continue;
            };
            slot.departed = true;
            if self.driver == Driver::Sumo {
                slot.speed = vehicle.speed;
            }
            let path = &task.routes[slot.route].path;
            if steers {
                slot.pose = slot.motion.pose;
                (slot.s, slot.lateral, slot.segment) = path.project([slot.pose.x, slot.pose.y], slot.segment);
                continue;
            }
            let front = path.arc_of_distance(vehicle.distance);
            let (point, heading, segment) = path.body(front, 2.0 * half);
            let (sin, cos) = heading.sin_cos();
            slot.pose = Pose::beside([point[0] - half * cos, point[1] - half * sin], heading, slot.lateral);
            slot.s = front - half;
            slot.segment = segment;
        }
        Ok(())
    }

    /// One step of a running episode: motion, ends and rewards.
    fn advance(&mut self, world: u32, snapshot: &Snapshot) -> Result<(), Error> {
        for (old, slot) in self.positions.iter_mut().zip(&self.traffic.slots) {
            *old = slot.s;
        }
        self.place(world, snapshot)?;
        self.find_collisions(world, snapshot);
        for collision in snapshot.collisions.iter().filter(|c| c.world == world) {
            let (a, b) = (collision.collider, collision.victim);
            let (slots, vehicle) = (&self.traffic.slots, &self.task.scenario.vehicle);
            self.pairs.sumo(a, b, || Sumos::reason(vehicle, &slots[a as usize], &slots[b as usize]));
        }
        let task = &*self.task;
        let scenario = &task.scenario;
        let wreck_steps = (scenario.termination.wreck_time / scenario.control.interval).round() as u32;
        let mut sum = 0.0;
        for (i, slot) in self.traffic.slots.iter_mut().enumerate().filter(|(_, slot)| slot.status == Status::Active) {
            let route = &task.routes[slot.route];
            let lane = route.path.widths[slot.segment];
            let steers = scenario.control.steering.is_some() && self.driver == Driver::Agents;
            let fate = Fate {
                arrived: slot.s >= route.arrival && (!steers || slot.lateral.abs() <= lane / 2.0),
                out_of_road: if steers {
                    slot.track == Track::Lost || task.road.as_ref().is_some_and(|road| road.left_by(&slot.pose))
                } else {
                    slot.lateral.abs() > (lane - scenario.vehicle.width) / 2.0 - BORDER_MARGIN
                },
                crashed: self.partners[i].is_some(),
            };
            slot.fate = fate;
            if let Some(Partner { slot: other, wreck }) = self.partners[i] {
                let upstream = route.conflicts.first().is_some_and(|c| c.own - slot.s > UPSTREAM);
                slot.crash = Some(Crash { other, wreck, step: self.step, speed: slot.speed, upstream });
            }
            // The first that applies replaces the step's reward.
            let reward = if fate.arrived {
                scenario.reward.arrive
            } else if fate.out_of_road {
                scenario.reward.out_of_road
            } else if fate.crashed {
                scenario.reward.crash
            } else {
                let way = slot.s - self.positions[i];
                scenario.reward.progress * way + scenario.reward.speed * slot.speed / Reward::SPEED_UNIT
            };
            self.own_rewards[i] = reward;
            sum += reward;
            if fate.arrived || fate.out_of_road || fate.crashed {
                self.frame.terminated[i] = 1.0;
                slot.status = if fate.arrived { Status::Empty } else { Status::Wreck };
                slot.wreck_steps = wreck_steps;
                if slot.track == Track::Lost {
                    slot.status = Status::Empty;
                }
                slot.speed = 0.0;
                slot.motion = Motion::at(slot.pose);
            }
        }
        self.total_reward += sum / self.crew as f64;
        self.step_rewards.push((sum / self.crew as f64) as f32);
        Ok(())
    }

    /// Boxes of active vehicles against all others on the road, at fractions of the step.
    fn find_collisions(&mut self, world: u32, snapshot: &Snapshot) {
        let slots = &self.traffic.slots;
        let vehicle = &self.task.scenario.vehicle;
        self.partners.fill(None);
        for i in 0..slots.len() {
            for j in 0..i {
                let on_road = |k: usize| slots[k].status != Status::Empty && slots[k].departed;
                let moving = |k: usize| slots[k].status == Status::Active;
                if !on_road(i) || !on_road(j) || !(moving(i) || moving(j)) {
                    continue;
                }
                let reach = vehicle.length + vehicle.width;
                let travelled = slots[i].pose.distance(&slots[i].before) + slots[j].pose.distance(&slots[j].before);
                if slots[i].pose.distance(&slots[j].pose) > reach + travelled {
                    continue;
                }
                let hit = (1..=SUBSTEPS).any(|k| {
                    let t = f64::from(k) / f64::from(SUBSTEPS);
                    let (a, b) =
                        (slots[i].before.towards(&slots[i].pose, t), slots[j].before.towards(&slots[j].pose, t));
                    boxes_overlap(&a, &b, vehicle.length, vehicle.width)
                });
                if hit {
                    self.partners[i].get_or_insert(Partner { slot: j, wreck: !moving(j) });
                    self.partners[j].get_or_insert(Partner { slot: i, wreck: !moving(i) });
                    let of_world = || snapshot.collisions.iter().filter(|c| c.world == world);
                    let reason = || Ours::reason(&self.task, [i, j].map(|k| (k as u32, &slots[k])), of_world());
                    self.pairs.ours(j as u32, i as u32, reason);
                }
            }
        }
    }

    /// Cooperative mix: (1 − λ) · own + λ / n · (sum over agents within communication range, itself included), n: agents
    /// of the episode.
    fn mix_rewards(&mut self) {
        let n = self.crew;
        let lambda = self.task.scenario.reward.cooperation;
        let range = self.task.scenario.communication.range;
        let slots = &self.traffic.slots;
        for i in 0..n {
            let mut near = 0.0;
            if lambda > 0.0 {
                for j in 0..n {
                    // Agents that have just arrived are off the road, but their last reward counts.
                    if i == j || slots[i].pose.distance(&slots[j].pose) <= range {
                        near += self.own_rewards[j];
                    }
                }
            }
            self.frame.reward[i] = ((1.0 - lambda) * self.own_rewards[i] + lambda * near / n as f64) as f32;
        }
    }

    fn record(&mut self, interrupted: bool) -> EpisodeRecord {
        let n = self.crew as f64;
        let share = |flag: fn(&Slot) -> bool| self.traffic.slots.iter().filter(|slot| flag(slot)).count() as f64 / n;
        let success = share(|slot| slot.fate.arrived);
        let danger = share(|slot| slot.fate.crashed || slot.fate.out_of_road);
        let (slots, routes) = (&self.traffic.slots, &self.task.scenario.routes);
        let mut failures = Failures::default();
        for slot in slots {
            failures.unfinished += u32::from(slot.status == Status::Active);
            failures.out_of_road += u32::from(slot.fate.out_of_road && slot.crash.is_none());
            if let Some(crash) = slot.crash.filter(|_| !slot.fate.arrived) {
                let both = [slot.route, slots[crash.other].route];
                failures.add(&crash, both[0] == both[1], both.map(|route| routes[route].id.as_str()));
            }
        }
        EpisodeRecord {
            episode: self.episode,
            episode_length: self.step,
            success,
            safety: 1.0 - danger,
            crash: share(|slot| slot.fate.crashed),
            out_of_road: share(|slot| slot.fate.out_of_road),
            reward: self.total_reward,
            efficiency: (success - danger) * n / f64::from(self.step.max(1)),
            sumo_collisions: self.pairs.of_sumo(),
            own_collisions: self.pairs.of_ours(),
            audit: self.pairs.audit(),
            failures,
            interrupted,
            replayed: self.order.position.replaying,
            step_rewards: std::mem::take(&mut self.step_rewards),
        }
    }
}

/// Puts a vehicle that steers where it is: SUMO moves it along its route first, at its speed, so that others react to that.
fn moves(task: &Task, world: u32, slot: u32, vehicle: &mut Slot) -> [Command; 2] {
    let Pose { x, y, heading } = vehicle.motion.pose;
    let (sin, cos) = heading.sin_cos();
    let half = task.scenario.vehicle.length / 2.0;
    let [x, y] = [x + half * cos, y + half * sin];
    let place = task.place(vehicle.route, [x, y], vehicle.segment);
    if place == Place::Beside {
        vehicle.track = Track::Astray;
    }
    // Where it was beside its route, SUMO may have given it another.
    let keep_route = if vehicle.track == Track::Route { place } else { Place::Beside }.keep_route();
    [
        Command::SetSpeed { world, slot, speed: vehicle.speed.max(0.0) },
        Command::MoveTo { world, slot, x, y, heading, keep_route },
    ]
}
