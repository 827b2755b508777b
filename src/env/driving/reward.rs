//! How a step ends for each agent, and what it is rewarded with.

use super::agents::{Outcome, Slot, Status};
use super::collisions::Collisions;
use super::surface::BESIDE;
use super::task::{Driver, Task};
use super::vehicle::tyres::Motion;
use crate::scenario::{Reward, Vehicle};

/// The agents' rewards in an episode.
#[derive(Debug, Clone)]
pub(super) struct Rewards {
    /// Each agent's own reward of the last step, `[N]`.
    pub(super) own: Vec<f64>,
    /// Sum of the agents' rewards in each step, divided by `active_agents`.
    pub(super) steps: Vec<f32>,
    /// Sum of `steps`.
    pub(super) total: f64,
    /// Number by which the sum of a step's rewards is divided: the agents of the episode, or all
    /// agent slots where agents come from route files.
    pub(super) active_agents: usize,
}

impl Rewards {
    pub(super) fn new(agents: usize) -> Self {
        let own = vec![0.0; agents];
        Self { own, steps: Vec::new(), total: 0.0, active_agents: agents }
    }

    /// Begins a new episode. The last step's rewards stay visible until the next step.
    pub(super) fn begin(&mut self, active_agents: usize) {
        self.active_agents = active_agents;
        self.total = 0.0;
        self.steps.clear();
    }

    /// Rewards the active agents for step number `step`, and ends the trajectories of those that
    /// arrived or failed: their entries of `terminated` become 1.
    pub(super) fn settle(
        &mut self,
        task: &Task,
        driver: Driver,
        step: u32,
        collisions: &Collisions,
        agents: &mut [Slot],
        terminated: &mut [f32],
    ) {
        let (steers, wreck_steps) = (task.steers(driver), task.wreck_steps());
        let mut sum = 0.0;
        self.own.fill(0.0);
        for (i, slot) in agents.iter_mut().enumerate() {
            // An agent that has just departed has not acted yet.
            if slot.status != Status::Active || slot.entered == step {
                continue;
            }
            let route = &task.map.routes[slot.route];
            let partner = collisions.partner(i);
            let outcome = outcome(task, steers, slot, partner.is_some());
            slot.outcome = outcome;
            if let Some(partner) = partner {
                slot.crash = Some(partner.crash(route, slot, step));
            }
            let mut reward = reward(task, steers, slot, slot.s - slot.s_before);
            if slot.ran_red {
                reward += task.scenario.reward.red_light;
            }
            reward -= task.scenario.reward.time * task.scenario.control.interval;
            self.own[i] = reward;
            sum += reward;
            if outcome.arrived || outcome.out_of_road || outcome.crashed {
                terminated[i] = 1.0;
                slot.status = if outcome.arrived { Status::Empty } else { Status::Wreck };
                slot.wreck_steps = wreck_steps;
                slot.speed = 0.0;
                slot.motion = Motion::at(slot.pose);
            }
        }
        let mean = sum / self.active_agents as f64;
        self.total += mean;
        self.steps.push(mean as f32);
    }
}

/// Returns what happened to an agent in a step.
fn outcome(task: &Task, steers: bool, slot: &Slot, crashed: bool) -> Outcome {
    let route = &task.map.routes[slot.route];
    let out_of_road = if steers {
        task.map.road().is_off_road(&slot.pose)
    } else {
        let lane = route.path.widths[slot.segment];
        slot.lateral.abs() > ((lane - slot.size[1]) / 2.0 - Vehicle::BORDER_MARGIN).max(0.0)
    };
    let finish = route.finish[0]..=route.finish[1];
    // An agent of a route file arrives where SUMO removes it, which puts it at the end of its route.
    let is_of_file = slot.departure.is_some();
    let arrival = if is_of_file { route.path.length() } else { route.arrival };
    let arrived = slot.s >= arrival && (!steers || finish.contains(&slot.lateral));
    Outcome { arrived, crashed, out_of_road }
}

/// Returns what is left of a reward for progress where the vehicle has the lateral offset `lateral`
/// from the centre line of a lane that is `width` wide, both in metres. `weight` is
/// [`Reward::lane_keeping`], and `factor`, at most 1, that of the lanes on which the vehicle is
/// ([`Route::off_lane`](crate::scenario::Route::off_lane)). What driving back costs stays whole, so
/// that a vehicle that drives to and fro gains nothing, wherever it does.
///
/// Source: MetaDrive, `metadrive/envs/metadrive_env.py` (`positive_road`, `use_lateral_reward`),
/// which multiplies the rewards of driving back as well.
fn kept_progress(weight: f64, factor: f64, progress: f64, lateral: f64, width: f64) -> f64 {
    let forwards = factor * progress;
    if progress <= 0.0 {
        progress
    } else if forwards > 0.0 {
        forwards * (1.0 - weight * (2.0 * lateral.abs() / width).min(1.0))
    } else {
        forwards
    }
}

/// Returns an agent's reward for a step in which it drove `distance` metres of its route. The first
/// case of its outcome that applies replaces the reward for driving.
fn reward(task: &Task, steers: bool, slot: &Slot, distance: f64) -> f64 {
    let rewards = &task.scenario.reward;
    if slot.outcome.arrived {
        rewards.arrive
    } else if slot.outcome.out_of_road {
        rewards.out_of_road
    } else if slot.outcome.crashed {
        rewards.crash
    } else {
        // The magnitude counts: a vehicle that steers may slide or drive backwards.
        let speed = if steers { slot.motion.velocity.norm() } else { slot.speed };
        if !steers {
            return rewards.progress * distance + rewards.speed * speed / Reward::SPEED_UNIT;
        }
        let lane = task.map.routes[slot.route].path.widths[slot.segment];
        let is_off = slot.lateral.abs() > lane / 2.0 + BESIDE;
        // Agents of route files are on routes that the scenario does not list.
        let listed = task.scenario.routes.get(slot.route).filter(|_| is_off);
        let factor = listed.map_or(1.0, |route| route.off_lane);
        let progress = rewards.progress * distance;
        kept_progress(rewards.lane_keeping, factor, progress, slot.lateral, lane)
            + factor * rewards.speed * speed / Reward::SPEED_UNIT
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::kept_progress;

    proptest! {
        /// Lane keeping and lanes of others only take, so that a vehicle that drives to and fro
        /// gains no reward for progress, whatever lanes it drives on. On the centre line of its own
        /// lanes nothing changes.
        #[test]
        fn to_and_fro_gains_nothing(
            weight in 0.0..=1.0f64,
            distance in 0.0..2.0f64,
            factors in [-1.0..=1.0f64, -1.0..=1.0f64],
            laterals in [-4.0..4.0f64, -4.0..4.0f64],
        ) {
            let there = kept_progress(weight, factors[0], distance, laterals[0], 3.5);
            let back = kept_progress(weight, factors[1], -distance, laterals[1], 3.5);
            prop_assert!(there <= distance && there + back <= 0.0, "{there} {back}");
            prop_assert_eq!(kept_progress(weight, 1.0, distance, 0.0, 3.5), distance);
            prop_assert_eq!(kept_progress(0.0, 1.0, distance, laterals[0], 3.5), distance);
        }
    }
}
