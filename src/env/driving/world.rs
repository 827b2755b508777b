//! One world: puts the stages of a step in order. A world needs no simulator: it emits commands and
//! takes in snapshots.
//!
//! An episode that has ended stays visible for one frame, in which its agents are observed but do
//! not act. For a truncated agent this is the last observation, from which its return is
//! bootstrapped. The respawn travels in the next exchange, so that every world takes exactly one
//! exchange per step, however it is hosted.

mod record;
mod views;

use std::sync::Arc;

use super::agents::{Slot, Traffic};
use super::background::Background;
use super::collisions::Collisions;
use super::frame::{AgentView, BackgroundVehicle};
use super::geometry::Pose;
use super::intention::Intentions;
use super::loitering::{self, Loitering};
use super::motion;
use super::reward::Rewards;
use super::right_of_way::RightOfWay;
use super::signals::Signals;
use super::spawn::Spawned;
use super::task::{Driver, Task};
use super::trips::Trips;
use crate::env::episode::{Episode, Phase, WorldState};
use crate::env::error::Error;
use crate::env::frame::Frame;
use crate::env::record::EpisodeRecord;
use crate::rng::Seed;
use crate::sumo::{Command, Snapshot};

/// One world.
#[derive(Debug, Clone)]
pub struct World {
    task: Arc<Task>,
    driver: Driver,
    episode: Episode,
    traffic: Traffic,
    /// Routes that each vehicle could still take, if the scenario hides routes.
    intentions: Option<Intentions>,
    right_of_way: RightOfWay,
    signals: Signals,
    spawned: Spawned,
    background: Background,
    collisions: Collisions,
    rewards: Rewards,
    loitering: Vec<Loitering>,
    trips: Trips,
    /// Total distance that the agents have driven in this episode \[m\].
    distance: f64,
    frame: Frame,
    finished: Option<EpisodeRecord>,
    /// Scratch: poses of the agents after the step.
    poses: Vec<Pose>,
    /// Scratch: which agents are present after the step.
    present: Vec<bool>,
    /// Scratch: distances and slots of the agents that an agent could hear.
    near: Vec<(f64, usize)>,
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
        let (n, slots) = (task.agents, task.slots());
        let mut traffic = Traffic::new(slots, task.map.routes.len());
        traffic.agents = n;
        Self {
            driver,
            episode: Episode::new(seed, first, stride, end),
            traffic,
            intentions: Intentions::new(&task.map, task.scenario.observation, n, slots),
            right_of_way: RightOfWay::new(
                &task.scenario.observation,
                driver == Driver::Rules,
                slots,
            ),
            signals: Signals::new(&task.map.traffic_lights),
            spawned: Spawned::default(),
            background: Background::new(&task, driver),
            collisions: Collisions::new(slots),
            rewards: Rewards::new(n),
            loitering: vec![Loitering::default(); n],
            trips: Trips::default(),
            distance: 0.0,
            frame: Frame::new(&task.spec, task.scenario.reward.share_range.is_finite()),
            finished: None,
            poses: vec![Pose::default(); n],
            present: vec![false; n],
            near: Vec::with_capacity(n),
            task,
        }
    }

    /// Returns the same world, which with this chance repeats one of its failed episodes, if it
    /// has any, instead of playing the next episode of the stream.
    #[must_use]
    pub fn with_repeat_failed(self, chance: f64) -> Self {
        Self { episode: self.episode.with_repeat_failed(chance), ..self }
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
        self.episode.respawns
    }

    /// Returns the number of the current episode in its stream.
    pub fn episode(&self) -> u64 {
        self.episode.index
    }

    /// Returns the steps since the start of the current episode.
    pub fn step_count(&self) -> u32 {
        self.episode.step
    }

    /// Returns whether the current episode goes on.
    pub fn is_running(&self) -> bool {
        self.episode.phase == Phase::Running
    }

    /// Returns whether the current episode has been played to its end and its last frame is
    /// visible.
    pub fn has_ended(&self) -> bool {
        self.is_between_episodes() && !self.episode.interrupted && self.episode.step > 0
    }

    /// Returns whether there is nothing left to play.
    pub fn is_idle(&self) -> bool {
        self.episode.phase == Phase::Idle
    }

    /// Returns whether the coming exchange respawns.
    pub(super) fn is_between_episodes(&self) -> bool {
        self.episode.phase == Phase::Ended
    }

    /// Returns views of all agents, in the order of the slots.
    pub fn agents(&self) -> impl Iterator<Item = AgentView> + '_ {
        let agents = self.traffic.slots.iter().zip(&self.rewards.own);
        agents.map(|(slot, reward)| AgentView::new(slot, *reward))
    }

    /// Returns views of the background traffic on the road.
    pub fn background_vehicles(&self) -> impl Iterator<Item = BackgroundVehicle> + '_ {
        let slots = self.traffic.slots[self.task.agents..].iter();
        slots.filter(|slot| slot.departed).map(BackgroundVehicle::new)
    }

    pub(crate) fn task(&self) -> &Task {
        &self.task
    }

    pub(crate) fn traffic(&self) -> &Traffic {
        &self.traffic
    }

    /// Returns SUMO's seed for the next episode.
    pub(super) fn simulator_seed(&self) -> u64 {
        self.episode.simulator_seed()
    }

    /// Returns the state of the world, for a checkpoint.
    pub fn state(&self) -> WorldState {
        self.episode.state()
    }

    /// Completes the restoration of a state, after the state's actions have been repeated.
    pub(super) fn restore(&mut self, state: &WorldState) {
        self.episode.restore(state);
    }

    /// Makes the coming exchange start `episode`, whatever is on the road now.
    pub fn reset(&mut self, episode: u64) {
        self.episode.go_to(episode);
    }

    /// Makes the coming exchange start the first of the episodes `first, first + stride, …` below
    /// `end` of another stream, whatever is on the road now.
    pub(super) fn restart(&mut self, seed: Seed, first: u64, stride: u64, end: u64) {
        self.episode.restart(seed, first, stride, end);
    }

    /// Makes the coming exchange start the next episode, whatever is on the road now.
    pub(super) fn start_next(&mut self) {
        self.episode.phase = Phase::Ended;
    }

    /// Truncates the current episode because SUMO is gone; the coming exchange starts the next
    /// one.
    pub fn interrupt(&mut self) {
        self.abandon();
        self.forget_vehicles();
    }

    /// Truncates the current episode as [`World::interrupt`] does, but in a SUMO that goes on.
    pub(super) fn abandon(&mut self) {
        if self.is_running() {
            self.finished = Some(self.record(true));
            self.frame.interrupt();
        }
        self.episode.abandon();
    }

    /// Notes that SUMO has been renewed and is empty, so that no vehicle is left to remove.
    pub(super) fn forget_vehicles(&mut self) {
        for slot in &mut self.traffic.slots {
            slot.added = false;
        }
    }

    /// Puts the vehicle of a slot on another route, at its present pose.
    #[cfg(test)]
    pub(super) fn send(&mut self, slot: usize, route: usize) {
        let slot = &mut self.traffic.slots[slot];
        slot.route = route;
        (slot.s, slot.lateral, slot.segment) =
            self.task.map.routes[route].path.nearest(slot.pose.point());
    }

    /// Appends the commands of the coming exchange. `actions` is `[N, A]`, of which only active
    /// agents' entries count.
    pub fn act(&mut self, world: u32, actions: &[f32], commands: &mut Vec<Command>) {
        match self.episode.phase {
            Phase::Idle | Phase::Spawning => {}
            Phase::Ended => self.spawn(world, commands),
            Phase::Running => {
                self.episode.note(actions);
                let (task, now) = (&self.task, self.now());
                let slots = &mut self.traffic.slots;
                motion::act(task, self.driver, world, actions, &mut slots[..task.agents], commands);
                self.spawned.let_depart(task, self.driver, world, now, slots, commands);
                if task.others > 0 {
                    self.background.act(task, world, now, &self.spawned, slots, commands);
                }
            }
        }
    }

    /// Begins the next episode: draws its agents, routes and positions, and appends the commands
    /// that replace the vehicles on the road. The world becomes idle if no episode is left.
    fn spawn(&mut self, world: u32, commands: &mut Vec<Command>) {
        if !self.episode.begin() {
            return;
        }
        let (task, seed) = (&self.task, self.episode.seed());
        let (lights, interval) = (&task.map.traffic_lights, task.scenario.control.interval);
        Signals::begin(lights, interval, world, seed.child("signals"), commands);
        let (driver, slots) = (self.driver, &mut self.traffic.slots);
        for (slot, i) in slots[..task.agents].iter_mut().zip(0..) {
            if slot.added {
                commands.push(Command::Remove { world, slot: i });
            }
            *slot = Slot::default();
        }
        self.spawned = Spawned::draw(task, &mut seed.rng());
        self.spawned.let_depart(task, driver, world, 0.0, slots, commands);
        if task.others > 0 {
            let seed = seed.child("traffic");
            self.background.spawn(task, world, seed, &self.spawned, slots, commands);
        }
        // With agents from route files, rewards are per slot.
        let shares = if task.has_flow() { task.agents } else { self.spawned.active_agents };
        self.rewards.begin(shares);
        self.trips.begin();
        self.collisions.begin();
        self.loitering.fill(Loitering::default());
        self.distance = 0.0;
    }

    /// Takes in the snapshot of an exchange, in which this is world number `world`, and writes the
    /// next frame.
    ///
    /// # Errors
    /// [`Error::Vanished`] if SUMO has lost a vehicle.
    pub fn observe(&mut self, world: u32, snapshot: &Snapshot) -> Result<(), Error> {
        self.frame.interrupted = false;
        match self.episode.phase {
            Phase::Idle | Phase::Ended => return Ok(()),
            Phase::Spawning => {
                self.place(world, snapshot)?;
                for slot in &mut self.traffic.slots[..self.task.agents] {
                    Signals::enter(&self.task.map.traffic_lights, slot);
                }
                self.episode.phase = Phase::Running;
                self.intentions.iter_mut().for_each(Intentions::begin);
                self.frame.begin(true);
                self.frame.reward.fill(0.0);
            }
            Phase::Running => {
                self.frame.begin(false);
                self.episode.step += 1;
                self.place(world, snapshot)?;
                self.begin_new_agents();
                self.judge(world, snapshot);
                for (reward, own) in self.frame.reward.iter_mut().zip(&self.rewards.own) {
                    *reward = *own as f32;
                }
            }
        }
        self.relate();
        let acting = self.mark_present();
        self.write_views();
        if acting == 0 && !self.goes_on() {
            let record = self.record(false);
            self.episode.end(record.success().is_none_or(|success| success >= 1.0));
            self.finished = Some(record);
        }
        Ok(())
    }

    /// Returns the seconds since the start of the episode.
    fn now(&self) -> f64 {
        f64::from(self.episode.step) * self.task.scenario.control.interval
    }

    /// Reads every vehicle's pose from the snapshot.
    ///
    /// # Errors
    /// [`Error::Vanished`] if SUMO has lost a vehicle.
    fn place(&mut self, world: u32, snapshot: &Snapshot) -> Result<(), Error> {
        let task = &self.task;
        for dropped in snapshot.dropped.iter().filter(|dropped| dropped.world == world) {
            if let Some(slot) = self.traffic.slots.get_mut(dropped.slot as usize)
                && !dropped.drives
            {
                *slot = Slot::default();
            }
            task.warn_of_dropped(dropped);
        }
        self.signals.place(world, snapshot);
        let (agents, others) = self.traffic.slots.split_at_mut(task.agents);
        motion::place(task, self.driver, world, snapshot, self.episode.step, agents)?;
        if task.others > 0 {
            self.background.place(task, world, snapshot, others);
        }
        Ok(())
    }

    /// Clears what previous agents left in the slots into which an agent came in this step: their
    /// loitering, collisions and effects on background traffic.
    fn begin_new_agents(&mut self) {
        let step = self.episode.step;
        for (i, slot) in self.traffic.slots[..self.task.agents].iter_mut().enumerate() {
            if slot.departed && slot.entered == step {
                self.frame.start[i] = 1.0;
                Signals::enter(&self.task.map.traffic_lights, slot);
                self.loitering[i] = Loitering::default();
                self.collisions.renew(i);
                self.background.renew(i);
            }
        }
    }

    /// Whether the episode goes on although no agent acts: the horizon has not been reached, and
    /// agents are still to come, or agents come from route files and none has come. An episode
    /// without agents lasts until the horizon, since a new one would make SUMO load the net again.
    fn goes_on(&self) -> bool {
        let task = &self.task;
        self.episode.step < task.scenario.termination.horizon
            && (task.has_flow() && self.trips.are_none()
                || self.traffic.slots[..task.agents].iter().any(Slot::is_waiting)
                || self.spawned.expects_agents()
                || self.background.expects_agents(task))
    }

    /// Finds out how the step went: collisions, ends and rewards.
    fn judge(&mut self, world: u32, snapshot: &Snapshot) {
        let (task, now) = (&*self.task, self.now());
        let (map, n) = (&task.map, task.agents);
        let reported = || snapshot.collisions.iter().filter(move |c| c.world == world);
        self.collisions.find(map, n, &self.traffic.slots, reported);
        self.distance += self.traffic.driven_by_agents(n);
        self.trips.watch(map, &self.traffic.slots);
        let interval = task.scenario.control.interval;
        loitering::watch(map, interval, &self.traffic.slots, &mut self.loitering);
        self.signals.judge(&map.traffic_lights, &mut self.traffic.slots[..n]);
        let steer = task.scenario.control.steering.is_some();
        self.collisions.compare(map, steer, n, &self.traffic.slots, reported());
        self.rewards.settle(
            task,
            self.driver,
            self.episode.step,
            &self.collisions,
            &mut self.traffic.slots[..n],
            &mut self.frame.terminated,
        );
        for (i, loitering) in self.loitering.iter().enumerate() {
            if self.frame.terminated[i] > 0.0 {
                self.trips.end(i, &self.traffic.slots[i], loitering, self.episode.step);
            }
        }
        self.background.meet_agents(task, now, &self.collisions, &mut self.traffic.slots);
    }

    /// Works out the relations between the vehicles: distances, candidate routes, right of way.
    fn relate(&mut self) {
        let (task, map) = (&self.task, &self.task.map);
        self.traffic.refresh();
        if task.scenario.occlusion.is_some() {
            self.traffic.look_around(&map.walls);
        }
        if let Some(intentions) = &mut self.intentions {
            intentions.update(map, &self.traffic, task.steers(self.driver));
        }
        self.signals.look(&map.traffic_lights, task.agents, &mut self.traffic.slots);
        self.right_of_way.update(map, &mut self.traffic, self.intentions.as_ref());
    }

    /// Returns what the traffic lights that rule routes said in the last step, one letter for each
    /// signal as in SUMO's programs.
    pub fn traffic_lights(&self) -> impl Iterator<Item = &str> {
        self.signals.states()
    }

    /// Whether the vehicles get priorities.
    pub(crate) fn keeps_right_of_way(&self) -> bool {
        self.right_of_way.is_kept()
    }
}
