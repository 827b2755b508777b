//! What learners get to see of a world.

use super::spec::EnvSpec;

/// What a world gives to agents and learners after an exchange. Reused from step to step.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Frame {
    /// Observations, `[N, O]`; zeros where no agent is present.
    pub observation: Vec<f32>,
    /// Privileged states, `[N, S]`; zeros where no agent is present.
    pub state: Vec<f32>,
    /// Physical mask G_p, `[N, N]`, row by row: 1 where the agent of the row can hear that of the
    /// column. Its diagonal is 1 for the agents that are present: those who act, and those whose
    /// trajectories the last step truncated. A [`MultiAgentEnv`](super::MultiAgentEnv) need not
    /// write the diagonal, nor leave out who is not present: [`Simple`](super::Simple) does both.
    pub comm: Vec<f32>,
    /// `[N, K]`, 1 where a choice is open to an agent, of the K choices of a discrete action; empty
    /// where actions are continuous.
    pub available: Vec<f32>,
    /// `[N]`, 1 where an agent acts in the coming step.
    pub active: Vec<f32>,
    /// `[N]`, 1 where a slot's new trajectory starts with this frame, so that memories are cleared:
    /// in all slots with a new episode, and in the slot of an agent that departs later.
    pub start: Vec<f32>,
    /// `[N]`, each agent's own reward of the last step.
    pub reward: Vec<f32>,
    /// Which agents share in each other's advantages, `[N, N]`: 1 where they are no further apart
    /// than the scenario's share range. Empty if all agents share, as in every environment without
    /// SUMO.
    pub sharing: Vec<f32>,
    /// `[N]`, 1 where the last step ended an agent's trajectory by arrival or failure.
    pub terminated: Vec<f32>,
    /// `[N]`, 1 where the last step truncated an agent's trajectory: at the horizon, or because
    /// SUMO broke off.
    pub truncated: Vec<f32>,
    /// Whether SUMO broke off in the last step.
    pub interrupted: bool,
}

impl Frame {
    /// Returns the frame of a world without agents. `shares`: whether not all agents share in each
    /// other's advantages.
    pub(super) fn new(spec: &EnvSpec, shares: bool) -> Self {
        let n = spec.agents;
        Self {
            observation: vec![0.0; n * spec.observation.len()],
            state: vec![0.0; n * spec.state.len()],
            comm: vec![0.0; n * n],
            available: vec![1.0; n * spec.actions.choices().unwrap_or(0)],
            active: vec![0.0; n],
            start: vec![0.0; n],
            reward: vec![0.0; n],
            sharing: vec![0.0; if shares { n * n } else { 0 }],
            terminated: vec![0.0; n],
            truncated: vec![0.0; n],
            interrupted: false,
        }
    }

    /// Empties the frame.
    pub(super) fn clear(&mut self) {
        let arrays = [
            &mut self.observation,
            &mut self.state,
            &mut self.comm,
            &mut self.active,
            &mut self.reward,
            &mut self.terminated,
            &mut self.truncated,
        ];
        for array in arrays {
            array.fill(0.0);
        }
        self.available.fill(1.0);
    }

    /// Returns the observation of an agent, `[O]`.
    pub fn observation_of(&mut self, agent: usize) -> &mut [f32] {
        let width = self.observation.len() / self.active.len();
        &mut self.observation[agent * width..][..width]
    }

    /// Returns the privileged state as seen from an agent, `[S]`.
    pub fn state_of(&mut self, agent: usize) -> &mut [f32] {
        let width = self.state.len() / self.active.len();
        &mut self.state[agent * width..][..width]
    }

    /// Returns which choices are open to an agent, `[K]`; empty where actions are continuous.
    pub fn available_to(&mut self, agent: usize) -> &mut [f32] {
        let width = self.available.len() / self.active.len();
        &mut self.available[agent * width..][..width]
    }

    /// Begins the trajectory of an agent that comes into an empty slot after the episode has begun:
    /// it acts from now on, and memories of the slot are cleared.
    pub fn begin_agent(&mut self, agent: usize) {
        (self.active[agent], self.start[agent]) = (1.0, 1.0);
    }

    /// Ends an agent's trajectory because it has reached its goal or has failed: it acts no more,
    /// and earns nothing after this step.
    pub fn end(&mut self, agent: usize) {
        (self.active[agent], self.terminated[agent]) = (0.0, 1.0);
    }

    /// Ends an agent's trajectory at the time limit. By default the limit is a deadline, after
    /// which nothing follows in the return; with `train.bootstrap_horizon` the value of the last
    /// observation stands for what would follow.
    pub fn truncate(&mut self, agent: usize) {
        (self.active[agent], self.truncated[agent]) = (0.0, 1.0);
    }

    /// Begins the frame after a respawn (`start`) or a step: nobody has ended yet.
    pub(super) fn begin(&mut self, start: bool) {
        self.start.fill(f32::from(u8::from(start)));
        self.terminated.fill(0.0);
        self.truncated.fill(0.0);
    }

    /// Truncates all active agents because SUMO broke off.
    pub(super) fn interrupt(&mut self) {
        for (truncated, active) in self.truncated.iter_mut().zip(&mut self.active) {
            *truncated = *active;
            *active = 0.0;
        }
        self.reward.fill(0.0);
        self.terminated.fill(0.0);
        self.start.fill(0.0);
        self.interrupted = true;
    }
}
