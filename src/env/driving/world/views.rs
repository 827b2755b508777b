//! What agents and learners get to see after a step: the world's frame.

use super::World;
use crate::env::driving::agents::Status;
use crate::env::driving::comm::{keep_nearest, physical_mask};
use crate::env::driving::intention::Knowledge;
use crate::env::driving::observation::View;

impl World {
    /// Writes to the frame which agents are present, act, are truncated, and are in range of each
    /// other. Returns the number of agents that act in the coming step.
    pub(super) fn mark_present(&mut self) -> u32 {
        let scenario = &self.task.scenario;
        let horizon = self.episode.step >= scenario.termination.horizon;
        let mut acting = 0;
        for (i, slot) in self.traffic.slots[..self.task.agents].iter().enumerate() {
            let present = slot.status == Status::Active;
            self.present[i] = present;
            self.poses[i] = slot.pose;
            self.frame.truncated[i] = f32::from(u8::from(present && horizon));
            self.frame.active[i] = f32::from(u8::from(present && !horizon));
            acting += u32::from(present && !horizon);
        }
        let range = scenario.communication.range;
        physical_mask(&self.poses, &self.present, range, &mut self.frame.comm);
        if scenario.occlusion.as_ref().is_some_and(|occlusion| occlusion.radio) {
            let n = self.task.agents;
            for i in 0..n {
                for j in (0..n).filter(|&j| self.traffic.is_blocked(i, j)) {
                    self.frame.comm[i * n + j] = 0.0;
                }
            }
        }
        let nearest = scenario.communication.nearest;
        if nearest > 0 {
            keep_nearest(&self.poses, nearest, &mut self.frame.comm, &mut self.near);
        }
        if !self.frame.sharing.is_empty() {
            let range = scenario.reward.share_range;
            physical_mask(&self.poses, &self.present, range, &mut self.frame.sharing);
        }
        acting
    }

    /// Writes the observations and privileged states of the agents to the frame.
    pub(super) fn write_views(&mut self) {
        let (task, traffic) = (&*self.task, &self.traffic);
        let horizon = f64::from(task.scenario.termination.horizon);
        let view = View {
            scenario: &task.scenario,
            map: &task.map,
            traffic,
            knowledge: Knowledge::public(&task.map, traffic, self.intentions.as_ref()),
            priorities: &self.right_of_way.priorities,
            time_left: 1.0 - f64::from(self.episode.step) / horizon,
            slot: 0,
            kinds: &task.abilities,
        };
        self.frame.write_views(task, &view, &self.present);
    }
}
