//! The record of a world's episode.

use super::World;
use crate::env::driving::metrics::DrivingRecord;
use crate::env::record::EpisodeRecord;

impl World {
    /// Returns the record of the current episode.
    pub(super) fn record(&mut self, interrupted: bool) -> EpisodeRecord {
        let (task, steps, now) = (&*self.task, self.episode.step, self.now());
        let (agents, others) = self.traffic.slots.split_at(task.agents);
        let trips = self.trips.counts(task, steps, agents, &self.loitering);
        let n = trips.count.max(1.0);
        let (success, danger) = (trips.arrived / n, trips.failed / n);
        let background = || self.background.metrics(task, others, trips.begun > 0.0);
        let flow = task.has_flow().then(|| {
            let waiting = agents.iter().filter(|slot| slot.is_waiting()).count() as u32;
            let queued = waiting + self.background.queued(task, now);
            self.trips.flow(task, steps, agents, &self.loitering, queued)
        });
        let has_signals = !task.map.traffic_lights.lights.is_empty();
        let total = self.rewards.total;
        // Rewards are per slot where agents come from route files.
        let per_agent = total * task.agents as f64 / trips.begun.max(1.0);
        let driving = DrivingRecord {
            undecided: trips.count == 0.0,
            safety: 1.0 - danger,
            crash: trips.crashed / n,
            unfinished: trips.unfinished / n,
            delay: trips.delay,
            out_of_road: trips.out_of_road / n,
            efficiency: (success - danger) * n / f64::from(self.episode.step.max(1)),
            sumo_collisions: self.collisions.pairs.of_sumo(),
            own_collisions: self.collisions.pairs.of_ours(),
            distance_km: self.distance / 1000.0,
            crashes: self.collisions.crashes,
            loitering: trips.loitered / n,
            red_lights: has_signals.then(|| trips.red_lights / n),
            audit: self.collisions.pairs.audit(),
            failures: trips.failures,
            flow,
            others: (task.others > 0).then(background),
        };
        EpisodeRecord {
            episode: self.episode.index,
            episode_length: self.episode.step,
            success,
            reward: if task.has_flow() { per_agent } else { total },
            driving: Some(driving),
            own: std::collections::BTreeMap::new(),
            interrupted,
            repeated: self.episode.is_repeated(),
            step_rewards: std::mem::take(&mut self.rewards.steps),
        }
    }
}
