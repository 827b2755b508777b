//! Trips: what became of the agents of an episode. An agent's trip ends when it arrives or fails,
//! and its slot may be given to another agent afterwards.

use serde::{Deserialize, Serialize};

use super::agents::{Slot, Status};
use super::failures::Failures;
use super::loitering::Loitering;
use super::map::Map;
use super::signals::STANDING;
use super::task::Task;
use super::trip::Trip;

/// An agent of a route file counts if it came on the road longer before the horizon than this multiple
/// of the time that its route takes at the speed limits, whatever becomes of it. Others may have no
/// time to arrive, and enough to crash. An episode that ends before its horizon, because no agent is
/// left, changes nothing of this.
const PATIENCE: f64 = 4.0;

/// The trips of an episode.
#[derive(Debug, Clone, Default)]
pub(super) struct Trips {
    ended: Vec<Trip>,
    pace: Pace,
}

/// How fast all vehicles on the road were, summed over vehicles and steps. Wrecks stand.
#[derive(Debug, Clone, Copy, Default)]
struct Pace {
    count: u32,
    /// Sum of the speeds \[m/s\].
    speed: f64,
    /// How often a vehicle stood.
    standing: u32,
}

/// The trips of an episode in numbers. Shares are fractions of `count`.
pub(super) struct Counts {
    /// Number of trips that have begun; the other numbers are of those that count.
    pub(super) begun: f64,
    pub(super) count: f64,
    pub(super) arrived: f64,
    pub(super) crashed: f64,
    pub(super) out_of_road: f64,
    /// Agents that crashed or went off-road.
    pub(super) failed: f64,
    /// Agents that neither arrived nor failed.
    pub(super) unfinished: f64,
    /// Time that an agent took longer than alone, mean over the agents from spawn places that
    /// arrived \[s\]; `None` if none did.
    pub(super) delay: Option<f64>,
    pub(super) loitered: f64,
    /// Number of red signals that agents passed.
    pub(super) red_lights: f64,
    pub(super) failures: Failures,
}

/// The flow of an episode's agents from route files.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct FlowMetrics {
    /// Length of the episode \[h\].
    pub hours: f64,
    /// Number of agents that departed.
    pub departed: u32,
    /// Number of agents that arrived.
    pub arrived: u32,
    /// Time that an agent loses against driving alone at the speed limits (SUMO's time loss), mean
    /// over the agents that arrived \[s\].
    pub delay: f64,
    /// Time that an agent waited for its departure, because no slot or no room on the road was
    /// free, mean over the agents that departed \[s\].
    pub waiting: f64,
    /// Number of agents that still waited for their departure at the end of the episode.
    pub queued: u32,
    /// Number of agents on the road at the end of the episode.
    pub on_road: u32,
    /// Mean speed of all vehicles on the road, agents and others \[m/s\]. A wreck has the speed 0.
    #[serde(default)]
    pub speed: f64,
    /// Share of these vehicles that stand, slower than 0.1 m/s, in the mean over all steps.
    #[serde(default)]
    pub standing: f64,
}

impl Trips {
    /// Begins a new episode.
    pub(super) fn begin(&mut self) {
        self.ended.clear();
        self.pace = Pace::default();
    }

    /// Notes how fast all vehicles on the road were in the last step.
    pub(super) fn watch(&mut self, map: &Map, slots: &[Slot]) {
        let here = |slot: &&Slot| slot.status != Status::Empty && slot.departed;
        let drives = |slot: &&Slot| !map.routes[slot.route].is_walked();
        for slot in slots.iter().filter(here).filter(drives) {
            self.pace.count += 1;
            self.pace.speed += slot.speed;
            self.pace.standing += u32::from(slot.speed < STANDING);
        }
    }

    /// Whether no agent's trip has ended.
    pub(super) fn are_none(&self) -> bool {
        self.ended.is_empty()
    }

    /// Stores the trip of the agent in a slot, which has ended in step number `step`.
    pub(super) fn end(&mut self, slot: usize, agent: &Slot, loitering: &Loitering, step: u32) {
        self.ended.push(Trip { unfinished: false, ..Trip::of(slot, agent, loitering, step) });
    }

    /// Returns all trips after `steps` steps, in the order of slots: those that have ended, those of
    /// the agents on the road, and those of agents from spawn places that still wait for room.
    fn all(&self, steps: u32, agents: &[Slot], loitering: &[Loitering]) -> Vec<Trip> {
        let driving = agents.iter().zip(loitering).enumerate();
        let driving = driving.filter(|(_, (agent, _))| {
            agent.status == Status::Active || agent.is_waiting() && agent.departure.is_none()
        });
        let driving =
            driving.map(|(slot, (agent, loitering))| Trip::of(slot, agent, loitering, steps));
        let mut trips: Vec<Trip> = self.ended.iter().copied().chain(driving).collect();
        trips.sort_by_key(|trip| trip.slot);
        trips
    }

    /// Returns the trips in numbers after `steps` steps.
    pub(super) fn counts(
        &self,
        task: &Task,
        steps: u32,
        agents: &[Slot],
        loitering: &[Loitering],
    ) -> Counts {
        let mut trips = self.all(steps, agents, loitering);
        let begun = trips.len();
        trips.retain(|trip| trip.has_time(task));
        let count = |flag: fn(&Trip) -> bool| trips.iter().filter(|trip| flag(trip)).count() as f64;
        let delays: Vec<f64> = trips.iter().filter_map(|trip| trip.delay.map(f64::from)).collect();
        let interval = task.scenario.control.interval;
        let mean = |steps: &[f64]| interval * steps.iter().sum::<f64>() / steps.len() as f64;
        Counts {
            begun: begun as f64,
            unfinished: count(|trip| trip.unfinished),
            delay: (!delays.is_empty()).then(|| mean(&delays)),
            count: count(|_| true),
            arrived: count(|trip| trip.outcome.arrived),
            crashed: count(|trip| trip.outcome.crashed),
            out_of_road: count(|trip| trip.outcome.out_of_road),
            failed: count(|trip| trip.outcome.crashed || trip.outcome.out_of_road),
            loitered: count(|trip| trip.loitered),
            red_lights: trips.iter().map(|trip| f64::from(trip.red_lights)).sum(),
            failures: Failures::of(&trips, &task.map.route_ids),
        }
    }

    /// Returns the flow of the agents from route files after `steps` steps; `queued` agents wait for
    /// their departure.
    pub(super) fn flow(
        &self,
        task: &Task,
        steps: u32,
        agents: &[Slot],
        loitering: &[Loitering],
        queued: u32,
    ) -> FlowMetrics {
        let interval = task.scenario.control.interval;
        let mut trips = self.all(steps, agents, loitering);
        trips.retain(|trip| trip.departure.is_some());
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len().max(1) as f64;
        let departures = trips.iter().filter_map(|trip| Some((trip.entered, trip.departure?)));
        let arrived = trips.iter().filter(|trip| trip.outcome.arrived);
        let losses = arrived.clone().filter_map(|trip| trip.departure.map(|d| d.time_loss));
        // A vehicle that departs at once is on the road one step after its time.
        let waits = departures
            .map(|(entered, departure)| (f64::from(entered) - 1.0) * interval - departure.due);
        FlowMetrics {
            hours: f64::from(steps) * interval / 3600.0,
            departed: trips.len() as u32,
            arrived: arrived.count() as u32,
            delay: mean(&losses.collect::<Vec<_>>()),
            waiting: mean(&waits.map(|wait| wait.max(0.0)).collect::<Vec<_>>()),
            queued,
            on_road: trips.iter().filter(|trip| trip.unfinished).count() as u32,
            speed: self.pace.speed / f64::from(self.pace.count.max(1)),
            standing: f64::from(self.pace.standing) / f64::from(self.pace.count.max(1)),
        }
    }
}

impl Trip {
    /// Whether an agent has time to arrive before the horizon. Agents of spawn places always have.
    fn has_time(&self, task: &Task) -> bool {
        self.departure.is_none() || {
            let steps = task.scenario.termination.horizon.saturating_sub(self.entered);
            f64::from(steps) * task.scenario.control.interval
                > PATIENCE * task.map.free_time[self.route]
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::env::driving::tests::scenario;

    #[test]
    fn the_pace_is_that_of_all_vehicles_on_the_road() {
        let task = Task::new(&scenario("flow_ring"), 6).expect("a task");
        let on_road =
            |status: Status, speed: f64| Slot { status, speed, departed: true, ..Slot::default() };
        let mut trips = Trips::default();
        let empty = Slot { status: Status::Empty, ..on_road(Status::Active, 50.0) };
        let waiting = Slot { departed: false, ..on_road(Status::Active, 50.0) };
        let first = [on_road(Status::Active, 6.0), on_road(Status::Active, 2.0), empty, waiting];
        trips.watch(&task.map, &first);
        // In the second step a vehicle has crashed, and stands.
        trips.watch(&task.map, &[on_road(Status::Active, 4.0), on_road(Status::Wreck, 0.0)]);
        let found = trips.flow(&task, 2, &[], &[], 0);
        assert!((found.speed - 3.0).abs() < 1e-9 && (found.standing - 0.25).abs() < 1e-9);
        trips.begin();
        assert_eq!(trips.flow(&task, 0, &[], &[], 0).speed, 0.0);
    }
}
