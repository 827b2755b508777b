//! Inputs and outputs of a policy at one decision of E worlds with N agent slots each.

use std::ops::Range;

use tch::{Device, Kind, Tensor};

use crate::rollout::Rollout;

/// The input of a policy at one decision.
#[derive(Debug)]
pub struct Observation {
    /// Observation features, `[E, N, O]`.
    pub observation: Tensor,
    /// Physical mask, `[E, N, N]`; the diagonal is 1 where an agent is present.
    pub comm: Tensor,
    /// 1 where a trajectory starts, else 0, `[E, N]`.
    pub start: Tensor,
    /// Memory of the policy after the last decision, `[E, N, M]`.
    pub memory: Tensor,
    /// What becomes of the message from agent `j` to agent `i` in training: -1 if it is lost, the
    /// number of the false message that replaces it, counted from 1, or 0, `[E, N, N]`; empty where
    /// the policy [has no radio](super::Algorithm::has_radio).
    pub disturbance: Tensor,
    /// 1 where a choice is open, `[E, N, K]`; empty where actions are continuous.
    pub available: Tensor,
}

impl Observation {
    /// Returns the input of decision `t` of a rollout, for a policy with `memory [E, N, M]`.
    pub fn at(rollout: &Rollout, t: usize, memory: &Tensor) -> Self {
        let s = rollout.sizes;
        let part = |array: &[f32], width: usize| {
            let row = Tensor::from_slice(&array[rollout.at(t, width)]);
            row.view([s.envs as i64, s.agents as i64, width as i64])
        };
        let some = |array: &[f32], width: usize| {
            let none = || Tensor::zeros([0], (Kind::Float, Device::Cpu));
            if array.is_empty() { none() } else { part(array, width) }
        };
        Self {
            observation: part(&rollout.observation, s.observation),
            comm: part(&rollout.comm, s.agents),
            start: part(&rollout.start, 1).squeeze_dim(-1),
            memory: memory.shallow_clone(),
            disturbance: some(&rollout.disturbance, s.agents),
            available: some(&rollout.available, s.choices),
        }
    }

    /// Returns 0 where memories are cleared before the decision and 1 elsewhere, `[E, N]`.
    pub fn keep(&self) -> Tensor {
        self.start.ones_like() - &self.start
    }

    /// Returns the memory after the decision, `[E, N, M]`: what the encoder remembers, or the old
    /// memory where the encoder has none.
    pub fn memory_after(&self, encoder: Option<Tensor>) -> Tensor {
        encoder.map_or_else(|| self.memory.shallow_clone(), |memory| memory.view_as(&self.memory))
    }

    /// Returns this input with the memory `memory`.
    #[must_use]
    pub fn with_memory(&self, memory: Tensor) -> Self {
        Self { memory, ..self.map(Tensor::shallow_clone) }
    }

    pub(super) fn to(&self, device: Device) -> Self {
        self.map(|tensor| tensor.to_device(device))
    }

    /// Returns the part of the input that belongs to `worlds`.
    pub(super) fn of(&self, worlds: &Range<i64>) -> Self {
        self.map(|tensor| narrowed(tensor, worlds))
    }

    fn map(&self, change: impl Fn(&Tensor) -> Tensor) -> Self {
        Self {
            observation: change(&self.observation),
            comm: change(&self.comm),
            start: change(&self.start),
            memory: change(&self.memory),
            disturbance: change(&self.disturbance),
            available: change(&self.available),
        }
    }
}

/// How actions are chosen.
#[derive(Debug)]
pub enum ActMode {
    /// The mean action, with the most likely communication graph.
    Deterministic,
    /// A sample from noise that the caller provides, so that the caller owns all randomness.
    Sample {
        /// Standard normal noise, `[E, N, A]`.
        action: Tensor,
        /// Shift of the mean by noise of earlier steps, in units of the scheduled standard
        /// deviation, `[E, N, A]`; empty where noise is independent from step to step.
        carried: Tensor,
        /// Noise of the graphs, standard logistic times the noise scale, `[E, N, ..]`; empty for
        /// policies without a graph.
        graph: Tensor,
        /// Logarithm of the share of each dimension's standard deviation that is drawn anew, `[A]`;
        /// empty where noise is independent from step to step.
        log_fresh: Vec<f32>,
    },
}

impl ActMode {
    /// Returns the noise of the graphs; `None` for the most likely graphs.
    pub fn graph_noise(&self) -> Option<&Tensor> {
        match self {
            Self::Deterministic => None,
            Self::Sample { graph, .. } => Some(graph),
        }
    }

    pub(super) fn to(&self, device: Device) -> Self {
        self.map(|tensor| tensor.to_device(device))
    }

    /// Returns the mode with the part of the noise that belongs to `worlds`.
    pub(super) fn of(&self, worlds: &Range<i64>) -> Self {
        self.map(|tensor| narrowed(tensor, worlds))
    }

    fn map(&self, change: impl Fn(&Tensor) -> Tensor) -> Self {
        match self {
            Self::Deterministic => Self::Deterministic,
            Self::Sample { action, carried, graph, log_fresh } => Self::Sample {
                action: change(action),
                carried: change(carried),
                graph: change(graph),
                log_fresh: log_fresh.clone(),
            },
        }
    }
}

/// Returns the rows of a tensor `[E, ..]` that belong to `worlds`; an empty tensor stays empty.
fn narrowed(tensor: &Tensor, worlds: &Range<i64>) -> Tensor {
    if tensor.size()[0] == 0 {
        return tensor.shallow_clone();
    }
    tensor.narrow(0, worlds.start, worlds.end - worlds.start)
}

/// The output of a policy at one decision.
#[derive(Debug)]
pub struct Decision {
    /// Action, not clipped, `[E, N, A]`.
    pub action: Tensor,
    /// Log-probability of each dimension of the action, `[E, N, A]`.
    pub log_prob: Tensor,
    /// Memory of the policy after the decision, `[E, N, M]`.
    pub memory: Tensor,
}

impl Decision {
    pub(super) fn to(&self, device: Device) -> Self {
        Self {
            action: self.action.to_device(device),
            log_prob: self.log_prob.to_device(device),
            memory: self.memory.to_device(device),
        }
    }

    /// Returns action, log-probability and memory side by side, `[E, N, 2 A + M]`.
    pub(super) fn joined(&self) -> Tensor {
        Tensor::cat(&[&self.action, &self.log_prob, &self.memory], -1)
    }

    /// Takes apart what [`Decision::joined`] returned of actions that are `actions` wide.
    pub(super) fn parted(joined: &Tensor, actions: i64) -> Self {
        let part = |first, width| joined.narrow(-1, first, width).contiguous();
        Self {
            action: part(0, actions),
            log_prob: part(actions, actions),
            memory: part(2 * actions, joined.size()[2] - 2 * actions),
        }
    }
}

/// A decoder's prediction from a latent, and its target.
#[derive(Debug)]
pub struct Reconstruction {
    /// Name of the target: `world` or `interaction`.
    pub name: &'static str,
    /// The decoder's prediction, `[E, N, K]`.
    pub prediction: Tensor,
    /// The target of the prediction, `[E, N, K]`.
    pub target: Tensor,
}

impl Reconstruction {
    pub(super) fn to(&self, device: Device) -> Self {
        Self {
            prediction: self.prediction.to_device(device),
            target: self.target.to_device(device),
            ..*self
        }
    }
}

/// Diagnostics of a policy at one decision.
#[derive(Debug, Default)]
pub struct Diagnostics {
    /// Value of each agent, in units of the reward, `[E, N]`; `None` where the value function needs
    /// a memory of its own.
    pub value: Option<Tensor>,
    /// Communication graph at run time, `[E, N, N]`, row = listener; `None` for methods without
    /// messages.
    pub graph: Option<Tensor>,
}
