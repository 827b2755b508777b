//! One world: the slots of an episode, from spawn to arrival or wreck. A world needs no simulator:
//! it emits commands and takes in snapshots.
//!
//! An episode that has ended stays visible for one frame, in which its agents are observed but do
//! not act. For a truncated agent this is the last observation, from which its return is
//! bootstrapped. The respawn travels in the next exchange, so that every world takes exactly one
//! exchange per step, however it is hosted.

mod motion;
mod others;
mod view;

use std::sync::Arc;

use rayon::prelude::*;

pub use self::motion::Pursuit;
use self::others::BackgroundState;
pub use self::view::{AgentView, Frame, OtherView};
use super::audit::{Ours, Pairs, Sumos};
use super::comm::physical_mask;
use super::failures::{Crash, Failures, UPSTREAM};
use super::fcfs;
use super::geometry::{Pose, boxes_overlap};
use super::intention::{Intentions, Knowledge};
use super::loitering;
use super::metrics::EpisodeRecord;
use super::order::{Order, Position};
use super::road::BESIDE;
use super::slots::{Outcome, Slot, Status, Track, Traffic};
use super::steering::Motion;
use super::task::Task;
use super::{Error, observation, state};
use crate::rng::Seed;
use crate::scenario::Reward;
use crate::sumo::{Collision, Snapshot};

/// Number of times per step at which boxes are tested for overlap: with steps of 0.1 s every
/// 0.02 s, as in the simulator of the paper's task.
const SUBSTEPS: u32 = 5;
/// Distance between a vehicle's side and the lane's border below which a vehicle that does not
/// steer is off-road \[m\], as measured on the paper's simulator.
const BORDER_MARGIN: f64 = 0.035;

/// Distance to the first conflict point at which vehicles get their priority, in scenarios whose
/// observations do not contain priority \[m\].
const PRIORITY_DISTANCE: f64 = 50.0;

/// What controls the agents' vehicles.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Driver {
    /// The actions.
    Agents,
    /// SUMO's own driver with SUMO's right of way; actions are ignored.
    Sumo,
}

/// State of a world between two exchanges.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    /// Nothing happens until [`World::reset`].
    Idle,
    /// The coming exchange respawns.
    Ended,
    /// The respawn has been sent, and its snapshot is awaited.
    Spawning,
    /// An episode is under way.
    Running,
}

/// Another vehicle that a vehicle overlaps with.
#[derive(Debug, Clone, Copy)]
struct Partner {
    /// Route of the other vehicle.
    route: usize,
    /// Whether one of the two is ahead of the other on its route.
    same_way: bool,
    /// Whether the other vehicle is a wreck.
    wreck: bool,
}

/// A world's place in its episodes, enough to restore exactly the same state.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct WorldState {
    /// Number of the current episode.
    pub episode: u64,
    /// Actions since the episode's spawn, `[steps, N, A]`.
    pub actions: Vec<f32>,
    /// Whether the simulation broke off in the last exchange, so that `episode` is yet to start.
    pub interrupted: bool,
    /// Position in the order of episodes.
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
    /// Number of agents in the current episode, which occupy the first slots.
    active_agents: usize,
    traffic: Traffic,
    /// Routes that each vehicle could still take, if the scenario hides routes.
    intentions: Option<Intentions>,
    others: BackgroundState,
    frame: Frame,
    own_rewards: Vec<f64>,
    /// Scratch: positions of the agents along their routes before the step.
    positions: Vec<f64>,
    /// Scratch: poses of the agents after the step.
    poses: Vec<Pose>,
    /// Scratch: which agents are present after the step.
    present: Vec<bool>,
    /// Scratch: the vehicle that the vehicle of each slot overlaps with.
    partners: Vec<Option<Partner>>,
    /// Scratch: the vehicles' priority numbers, if agents observe them.
    priorities: Vec<u32>,
    /// Scratch: pairs of slots of which the first vehicle blocks the second.
    blocked: Vec<(usize, usize)>,
    total_reward: f64,
    step_rewards: Vec<f32>,
    pairs: Pairs,
    /// Total distance that the agents have driven in this episode \[m\].
    distance: f64,
    /// Crashes of agents in this episode ([`EpisodeRecord::crashes`]).
    crashes: u32,
    actions: Vec<f32>,
    interrupted: bool,
    respawns: u64,
    finished: Option<EpisodeRecord>,
}

impl World {
    /// Creates a world that plays the episodes `first, first + stride, …` below `end` of the
    /// stream `seed`. The world is idle until [`World::reset`], and again after the last episode.
    pub fn new(
        task: Arc<Task>,
        driver: Driver,
        seed: Seed,
        first: u64,
        stride: u64,
        end: u64,
    ) -> Self {
        let n = task.agents;
        let (o, s) = (task.spec.observation.len(), task.spec.state.len());
        Self {
            driver,
            order: Order::new(seed, first, stride, end),
            seed,
            episode: first,
            phase: Phase::Idle,
            step: 0,
            active_agents: n,
            traffic: Traffic::new(task.slots(), task.routes.len()),
            intentions: Intentions::new(&task),
            others: BackgroundState::new(&task),
            frame: Frame {
                observation: vec![0.0; n * o],
                state: vec![0.0; n * s],
                comm: vec![0.0; n * n],
                active: vec![0.0; n],
                start: false,
                reward: vec![0.0; n],
                sharing: vec![
                    0.0;
                    if task.scenario.reward.share_range.is_finite() { n * n } else { 0 }
                ],
                terminated: vec![0.0; n],
                truncated: vec![0.0; n],
                interrupted: false,
            },
            own_rewards: vec![0.0; n],
            positions: vec![0.0; n],
            poses: vec![Pose::default(); n],
            present: vec![false; n],
            partners: vec![None; task.slots()],
            priorities: Vec::with_capacity(task.slots()),
            blocked: Vec::with_capacity(task.slots()),
            total_reward: 0.0,
            step_rewards: Vec::new(),
            pairs: Pairs::default(),
            distance: 0.0,
            crashes: 0,
            actions: Vec::new(),
            interrupted: false,
            respawns: 0,
            finished: None,
            task,
        }
    }

    /// Returns the same world, which with this chance repeats one of its failed episodes, if it
    /// has any, instead of playing the next episode of the stream.
    #[must_use]
    pub fn with_replay(self, chance: f64) -> Self {
        Self { order: self.order.with_replay(chance), ..self }
    }

    /// Returns the last frame.
    pub fn frame(&self) -> &Frame {
        &self.frame
    }

    /// Takes the record of the episode that the last step ended, if it ended one.
    pub fn take_finished(&mut self) -> Option<EpisodeRecord> {
        self.finished.take()
    }

    /// Returns whether the last step ended an episode that was not interrupted.
    pub(super) fn has_finished(&self) -> bool {
        self.finished.as_ref().is_some_and(|record| !record.interrupted)
    }

    /// Returns the number of episodes that started while the simulation went on.
    pub fn respawns(&self) -> u64 {
        self.respawns
    }

    /// Returns the number of the current episode in its stream.
    pub fn episode(&self) -> u64 {
        self.episode
    }

    /// Returns the steps since the start of the current episode.
    pub fn step_count(&self) -> u32 {
        self.step
    }

    /// Returns whether the current episode goes on.
    pub fn is_running(&self) -> bool {
        self.phase == Phase::Running
    }

    /// Returns whether the current episode has been played to its end and its last frame is
    /// visible.
    pub fn has_ended(&self) -> bool {
        self.phase == Phase::Ended && !self.interrupted && self.step > 0
    }

    /// Returns views of all agents, in the order of the slots.
    pub fn agents(&self) -> impl Iterator<Item = AgentView> + '_ {
        self.traffic.slots.iter().zip(&self.own_rewards).map(|(slot, reward)| AgentView {
            driving: slot.status == Status::Active,
            wreck: slot.status == Status::Wreck,
            outcome: slot.outcome,
            pose: slot.pose,
            route: slot.route,
            position: slot.s,
            lateral: slot.lateral,
            speed: slot.speed,
            reward: *reward,
        })
    }

    /// Returns views of the background traffic on the road.
    pub fn others(&self) -> impl Iterator<Item = OtherView> + '_ {
        let slots = self.traffic.slots[self.task.agents..].iter().filter(|slot| slot.departed);
        slots.map(|slot| OtherView {
            wreck: slot.status == Status::Wreck,
            pose: slot.pose,
            size: slot.size,
            route: slot.route,
            position: slot.s,
            speed: slot.speed,
        })
    }

    /// Returns SUMO's seed for the next episode.
    pub(super) fn simulator_seed(&self) -> u64 {
        self.seed.child("sumo").index(self.order.position.next).word()
    }

    /// Returns whether there is nothing left to play.
    pub fn is_idle(&self) -> bool {
        self.phase == Phase::Idle
    }

    /// Returns the state of the world, for a checkpoint.
    pub fn state(&self) -> WorldState {
        let position = self.order.position.clone();
        if self.interrupted {
            return WorldState {
                episode: position.next,
                actions: Vec::new(),
                interrupted: true,
                position,
            };
        }
        WorldState {
            episode: self.episode,
            actions: self.actions.clone(),
            interrupted: false,
            position,
        }
    }

    /// Makes the coming exchange start `episode`, whatever is on the road now.
    pub fn reset(&mut self, episode: u64) {
        self.order.go_to(episode);
        self.phase = Phase::Ended;
    }

    /// Makes the coming exchange start the next episode, whatever is on the road now.
    pub(super) fn start_next(&mut self) {
        self.phase = Phase::Ended;
    }

    /// Takes in the snapshot of an exchange, in which this is world number `world`, and writes the
    /// next frame.
    ///
    /// # Errors
    /// [`Error::Vanished`] if SUMO has lost a vehicle.
    pub fn observe(&mut self, world: u32, snapshot: &Snapshot) -> Result<(), Error> {
        let n = self.task.agents;
        self.frame.interrupted = false;
        match self.phase {
            Phase::Idle | Phase::Ended => return Ok(()),
            Phase::Spawning => {
                self.place(world, snapshot)?;
                self.phase = Phase::Running;
                self.intentions.iter_mut().for_each(Intentions::begin);
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
        let steers = self.steers();
        if let Some(intentions) = &mut self.intentions {
            intentions.update(&self.task, &self.traffic, steers);
        }
        let intentions = self.intentions.as_ref();
        let distance = self.task.scenario.observation.priority_distance;
        self.traffic.take_turns(
            &self.task.routes,
            intentions,
            if distance > 0.0 { distance } else { PRIORITY_DISTANCE },
        );
        if distance > 0.0 {
            let knowledge = Knowledge::public(&self.task, &self.traffic, intentions);
            fcfs::inherit(knowledge, &mut self.priorities, &mut self.blocked);
        }
        if self.step > 0 {
            let own = self.frame.reward.iter_mut().zip(&self.own_rewards);
            own.for_each(|(reward, own)| *reward = *own as f32);
        }
        let horizon = self.step >= self.task.scenario.termination.horizon;
        let mut acting = 0;
        for (i, slot) in self.traffic.slots.iter().take(n).enumerate() {
            let present = slot.status == Status::Active;
            self.present[i] = present;
            self.poses[i] = slot.pose;
            self.frame.truncated[i] = f32::from(u8::from(present && horizon));
            self.frame.active[i] = f32::from(u8::from(present && !horizon));
            acting += u32::from(present && !horizon);
        }
        physical_mask(
            &self.poses,
            &self.present,
            self.task.scenario.communication.range,
            &mut self.frame.comm,
        );
        if !self.frame.sharing.is_empty() {
            let range = self.task.scenario.reward.share_range;
            physical_mask(&self.poses, &self.present, range, &mut self.frame.sharing);
        }
        let (o, s) = (self.task.spec.observation.len(), self.task.spec.state.len());
        let (task, traffic, priorities, present) =
            (&*self.task, &self.traffic, &self.priorities, &self.present);
        let time_left =
            1.0 - f64::from(self.step) / f64::from(self.task.scenario.termination.horizon);
        let knowledge = Knowledge::public(task, traffic, self.intentions.as_ref());
        let view = |i: usize, seen: &mut [f32], known: &mut [f32]| {
            if present[i] {
                observation::write(task, knowledge, priorities, i, seen);
                state::write(task, traffic, time_left, i, known);
            } else {
                seen.fill(0.0);
                known.fill(0.0);
            }
        };
        let (seen, known) = (&mut self.frame.observation, &mut self.frame.state);
        let looks = &task.scenario.observation;
        if looks.lidar.beams > 0 || looks.foresight > 0.0 || looks.priority_distance > 0.0 {
            // Fewer than 16 agents are not worth another core.
            let views = seen
                .par_chunks_exact_mut(o)
                .zip(known.par_chunks_exact_mut(s))
                .enumerate()
                .with_min_len(16);
            views.for_each(|(i, (seen, known))| view(i, seen, known));
        } else {
            let views = seen.chunks_exact_mut(o).zip(known.chunks_exact_mut(s)).enumerate();
            views.for_each(|(i, (seen, known))| view(i, seen, known));
        }
        if acting == 0 && self.phase == Phase::Running {
            self.phase = Phase::Ended;
            let record = self.record(false);
            self.order.ended(self.episode, record.success >= 1.0);
            self.finished = Some(record);
        }
        Ok(())
    }

    /// Returns whether agents steer, so that they follow their routes' paths instead of the lanes.
    fn steers(&self) -> bool {
        self.driver == Driver::Agents && self.task.scenario.control.steering.is_some()
    }

    /// Puts the vehicle of a slot on another route, at its present pose.
    #[cfg(test)]
    pub(super) fn send(&mut self, slot: usize, route: usize) {
        let slot = &mut self.traffic.slots[slot];
        slot.route = route;
        (slot.s, slot.lateral, slot.segment) =
            self.task.routes[route].path.nearest([slot.pose.x, slot.pose.y]);
    }

    /// Truncates the current episode because SUMO is gone; the coming exchange starts the next
    /// one.
    pub fn interrupt(&mut self) {
        self.abandon();
        self.forget_vehicles();
    }

    /// Truncates the current episode as [`World::interrupt`] does, but in a SUMO that goes on.
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
            self.frame.interrupted = true;
        } else if self.phase == Phase::Spawning {
            self.order.repeat(self.episode);
        }
        self.phase = Phase::Ended;
    }

    /// Notes that SUMO has been renewed and is empty, so that no vehicle is left to remove.
    pub(super) fn forget_vehicles(&mut self) {
        for slot in &mut self.traffic.slots {
            slot.added = false;
        }
    }

    /// Completes the restoration of a state, after the state's actions have been repeated.
    pub(super) fn restore(&mut self, state: &WorldState) {
        if state.interrupted {
            self.interrupted = true;
            self.start_next();
        }
        self.order.position = state.position.clone();
    }

    /// Returns whether the coming exchange respawns.
    pub(super) fn is_between_episodes(&self) -> bool {
        self.phase == Phase::Ended
    }

    /// Performs one step of a running episode: motion, ends and rewards.
    fn advance(&mut self, world: u32, snapshot: &Snapshot) -> Result<(), Error> {
        for (old, slot) in self.positions.iter_mut().zip(&self.traffic.slots) {
            *old = slot.s;
        }
        self.place(world, snapshot)?;
        self.find_collisions(world, snapshot);
        self.distance += self.traffic.driven_by_agents(self.task.agents);
        loitering::watch(&self.task, &mut self.traffic.slots);
        let task = &*self.task;
        let of_agents =
            |c: &Collision| c.world == world && (c.collider.min(c.victim) as usize) < task.agents;
        for collision in snapshot.collisions.iter().filter(|c| of_agents(c)) {
            let (a, b) = (collision.collider, collision.victim);
            let slots = &self.traffic.slots;
            self.pairs.sumo(a, b, || Sumos::reason(task, &slots[a as usize], &slots[b as usize]));
        }
        let scenario = &task.scenario;
        let wreck_steps =
            (scenario.termination.wreck_time / scenario.control.interval).round() as u32;
        let mut sum = 0.0;
        let agents = self.traffic.slots[..task.agents].iter_mut().enumerate();
        for (i, slot) in agents.filter(|(_, slot)| slot.status == Status::Active) {
            let route = &task.routes[slot.route];
            let lane = route.path.widths[slot.segment];
            let steers = scenario.control.steering.is_some() && self.driver == Driver::Agents;
            let outcome = Outcome {
                arrived: slot.s >= route.arrival
                    && (!steers || (route.finish[0]..=route.finish[1]).contains(&slot.lateral)),
                out_of_road: if steers {
                    slot.track == Track::Lost
                        || task.road.as_ref().is_some_and(|road| road.left_by(&slot.pose))
                } else {
                    slot.lateral.abs() > (lane - scenario.vehicle.width) / 2.0 - BORDER_MARGIN
                },
                crashed: self.partners[i].is_some(),
            };
            slot.outcome = outcome;
            if let Some(Partner { route: other, same_way, wreck }) = self.partners[i] {
                let upstream = route.conflicts.first().is_some_and(|c| c.own - slot.s > UPSTREAM);
                slot.crash = Some(Crash {
                    other,
                    same_way,
                    wreck,
                    step: self.step,
                    speed: slot.speed,
                    upstream,
                });
            }
            // The first case that applies replaces the step's reward.
            let reward = if outcome.arrived {
                scenario.reward.arrive
            } else if outcome.out_of_road {
                scenario.reward.out_of_road
            } else if outcome.crashed {
                scenario.reward.crash
            } else {
                let distance = slot.s - self.positions[i];
                // The magnitude counts: a vehicle that steers may slide or drive backwards.
                let speed = if steers { slot.motion.velocity.norm() } else { slot.speed };
                let reward = scenario.reward.progress * distance
                    + scenario.reward.speed * speed / Reward::SPEED_UNIT;
                let off = steers && slot.lateral.abs() > lane / 2.0 + BESIDE;
                if off { scenario.routes[slot.route].off_lane * reward } else { reward }
            };
            self.own_rewards[i] = reward;
            sum += reward;
            if outcome.arrived || outcome.out_of_road || outcome.crashed {
                self.frame.terminated[i] = 1.0;
                slot.status = if outcome.arrived { Status::Empty } else { Status::Wreck };
                slot.wreck_steps = wreck_steps;
                if slot.track == Track::Lost {
                    slot.status = Status::Empty;
                }
                slot.speed = 0.0;
                slot.motion = Motion::at(slot.pose);
            }
        }
        self.meet_others(wreck_steps);
        self.total_reward += sum / self.active_agents as f64;
        self.step_rewards.push((sum / self.active_agents as f64) as f32);
        Ok(())
    }

    /// Tests the boxes of active vehicles against all other vehicles on the road, several times
    /// per step. Background vehicles are not tested against each other.
    fn find_collisions(&mut self, world: u32, snapshot: &Snapshot) {
        let slots = &self.traffic.slots;
        let agents = self.task.agents;
        self.partners.fill(None);
        for i in 0..slots.len() {
            for j in 0..i {
                let on_road = |k: usize| slots[k].status != Status::Empty && slots[k].departed;
                let moving = |k: usize| slots[k].status == Status::Active;
                let strangers = j >= agents && moving(i) && moving(j);
                if !on_road(i) || !on_road(j) || !(moving(i) || moving(j)) || strangers {
                    continue;
                }
                let half = |k: usize| f64::midpoint(slots[k].size[0], slots[k].size[1]);
                let reach = half(i) + half(j);
                let travelled = slots[i].pose.distance(&slots[i].before)
                    + slots[j].pose.distance(&slots[j].before);
                if slots[i].pose.distance(&slots[j].pose) > reach + travelled {
                    continue;
                }
                let hit = (1..=SUBSTEPS).any(|k| {
                    let t = f64::from(k) / f64::from(SUBSTEPS);
                    let (a, b) = (
                        slots[i].before.towards(&slots[i].pose, t),
                        slots[j].before.towards(&slots[j].pose, t),
                    );
                    boxes_overlap((&a, slots[i].size), (&b, slots[j].size))
                });
                if hit {
                    let drives = |k: usize| k < agents && moving(k);
                    self.crashes += u32::from(drives(i) || drives(j));
                    let on_way = |a: usize, b: usize| {
                        let route = &self.task.routes[slots[a].route];
                        route
                            .shared_position(slots[b].route, slots[b].s)
                            .is_some_and(|s| s >= slots[a].s)
                    };
                    let same_way = on_way(i, j) || on_way(j, i);
                    self.partners[i].get_or_insert(Partner {
                        route: slots[j].route,
                        same_way,
                        wreck: !moving(j),
                    });
                    self.partners[j].get_or_insert(Partner {
                        route: slots[i].route,
                        same_way,
                        wreck: !moving(i),
                    });
                    // SUMO gives pedestrians other shapes, so that their collisions cannot be
                    // compared.
                    if j >= agents || self.is_pedestrian(&slots[i]) {
                        continue;
                    }
                    let of_world = || snapshot.collisions.iter().filter(|c| c.world == world);
                    let reason = || {
                        Ours::reason(&self.task, [i, j].map(|k| (k as u32, &slots[k])), of_world())
                    };
                    self.pairs.ours(j as u32, i as u32, reason);
                }
            }
        }
    }

    /// Returns the record of the current episode.
    fn record(&mut self, interrupted: bool) -> EpisodeRecord {
        let n = self.active_agents as f64;
        let slots = &self.traffic.slots[..self.task.agents];
        let share =
            |flag: fn(&Slot) -> bool| slots.iter().filter(|slot| flag(slot)).count() as f64 / n;
        let success = share(|slot| slot.outcome.arrived);
        let danger = share(|slot| slot.outcome.crashed || slot.outcome.out_of_road);
        let routes = &self.task.route_ids;
        let mut failures = Failures::default();
        for slot in slots {
            failures.unfinished += u32::from(slot.status == Status::Active);
            if slot.outcome.out_of_road && slot.crash.is_none() {
                failures.leave(&routes[slot.route]);
            }
            if let Some(crash) = slot.crash.filter(|_| !slot.outcome.arrived) {
                failures.add(&crash, [slot.route, crash.other].map(|route| routes[route].as_str()));
            }
        }
        EpisodeRecord {
            episode: self.episode,
            episode_length: self.step,
            success,
            safety: 1.0 - danger,
            crash: share(|slot| slot.outcome.crashed),
            out_of_road: share(|slot| slot.outcome.out_of_road),
            reward: self.total_reward,
            efficiency: (success - danger) * n / f64::from(self.step.max(1)),
            sumo_collisions: self.pairs.of_sumo(),
            own_collisions: self.pairs.of_ours(),
            distance_km: self.distance / 1000.0,
            crashes: self.crashes,
            loitering: share(|slot| slot.loitering.is_long()),
            audit: self.pairs.audit(),
            failures,
            others: self.others_record(),
            interrupted,
            replayed: self.order.position.replaying,
            step_rewards: std::mem::take(&mut self.step_rewards),
        }
    }
}
