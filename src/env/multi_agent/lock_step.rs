//! Worlds of an environment of one's own in lock-step: their episodes, and what is checked in each
//! step.

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};

use rayon::prelude::*;

use super::MultiAgentEnv;
use crate::env::environment::{WorldPhase, WorldView, Worlds};
use crate::env::episode::{Episode, Phase, WorldState};
use crate::env::error::Error;
use crate::env::frame::Frame;
use crate::env::picture::Picture;
use crate::env::record::EpisodeRecord;
use crate::env::spec::{OwnMetric, Values};

/// Worlds of an environment of one's own, on all cores.
pub(super) struct LockStep<E> {
    pub(super) worlds: Vec<World<E>>,
}

impl<E: MultiAgentEnv> Worlds for LockStep<E> {
    fn count(&self) -> usize {
        self.worlds.len()
    }

    fn view(&self, e: usize) -> WorldView<'_> {
        let World { frame, episode, .. } = &self.worlds[e];
        let phase = match episode.phase {
            Phase::Idle => WorldPhase::Idle,
            Phase::Running => WorldPhase::Running,
            Phase::Ended if episode.step > 0 && !episode.interrupted => WorldPhase::Ended,
            Phase::Ended | Phase::Spawning => WorldPhase::Between,
        };
        WorldView { frame, episode: episode.index, step: episode.step, phase }
    }

    fn step(&mut self, actions: &[f32]) -> Result<(), Error> {
        let Some(first) = self.worlds.first() else { return Ok(()) };
        // An evaluation gives the actions of more worlds than there are at its end.
        let width = first.actions_width();
        let each = self.worlds.par_iter_mut().zip(actions.par_chunks_exact(width));
        // A handful of worlds is not worth another core.
        each.with_min_len(4).try_for_each(|(world, actions)| world.step(actions))
    }

    fn take_finished(&mut self) -> Vec<EpisodeRecord> {
        self.worlds.iter_mut().filter_map(|world| world.finished.take()).collect()
    }

    fn states(&self) -> Vec<WorldState> {
        self.worlds.iter().map(World::state).collect()
    }

    fn picture(&self, e: usize) -> Option<Picture> {
        self.worlds[e].env.picture()
    }
}

/// One world, and its place in its episodes.
pub(super) struct World<E> {
    env: E,
    /// Whether the episodes are those of a training.
    training: bool,
    pub(super) episode: Episode,
    frame: Frame,
    /// The mask `comm`, `[N, N]`, as the environment has left it: absent agents are not cleared.
    heard: Vec<f32>,
    /// Sums of the agents' rewards in this episode, and their mean in each step.
    rewards: Vec<f64>,
    step_rewards: Vec<f32>,
    /// Actions of the coming step, within their bounds.
    actions: Vec<f32>,
    pub(super) finished: Option<EpisodeRecord>,
}

impl<E: MultiAgentEnv> World<E> {
    pub(super) fn new(env: E, episode: Episode, training: bool) -> Self {
        let frame = Frame::new(env.spec(), false);
        let rewards = vec![0.0; env.spec().agents];
        Self {
            env,
            training,
            episode,
            heard: frame.comm.clone(),
            frame,
            rewards,
            step_rewards: Vec::new(),
            actions: Vec::new(),
            finished: None,
        }
    }

    /// Returns how many numbers the actions of all agents are.
    fn actions_width(&self) -> usize {
        let spec = self.env.spec();
        spec.agents * spec.actions.len()
    }

    /// Takes a step, or begins the next episode.
    pub(super) fn step(&mut self, actions: &[f32]) -> Result<(), Error> {
        let worked = catch_unwind(AssertUnwindSafe(|| match self.episode.phase {
            Phase::Idle | Phase::Spawning => Ok(()),
            Phase::Ended => self.begin(),
            Phase::Running => self.go_on(actions),
        }));
        worked.unwrap_or_else(|panic| {
            let Episode { index, step, .. } = &self.episode;
            let what = format!("the environment panicked: {}", Error::text_of(&*panic));
            Err(Error::Own { episode: *index, step: *step, what })
        })
    }

    fn begin(&mut self) -> Result<(), Error> {
        if !self.episode.begin() {
            return Ok(());
        }
        self.frame.clear();
        let seed = self.episode.seed();
        if self.training {
            self.env.reset_for_training(seed, &mut self.frame);
        } else {
            self.env.reset(seed, &mut self.frame);
        }
        self.frame.start.fill(1.0);
        self.episode.phase = Phase::Running;
        self.rewards.fill(0.0);
        self.step_rewards.clear();
        self.frame.reward.fill(0.0);
        self.check()?;
        let ends = self.frame.terminated.iter().zip(&self.frame.truncated);
        if let Some(i) = ends.into_iter().position(|(end, cut)| end + cut > 0.0) {
            return Err(self.wrong(i, "ends in `reset`; an episode has one step at least"));
        }
        self.leave_out_absent();
        self.check_heard()
    }

    /// Clears `comm` for absent agents, and sets its diagonal for present ones.
    fn leave_out_absent(&mut self) {
        let Frame { comm, active, truncated, .. } = &mut self.frame;
        self.heard.copy_from_slice(comm);
        let present = |i: usize| active[i] + truncated[i] > 0.0;
        let n = active.len();
        for (i, row) in comm.chunks_exact_mut(n).enumerate() {
            for (j, hears) in row.iter_mut().enumerate() {
                let there = present(i) && present(j);
                *hears = f32::from(u8::from(there && (i == j || *hears > 0.0)));
            }
        }
    }

    /// Returns the state of the world, for a checkpoint.
    fn state(&self) -> WorldState {
        WorldState { observation: self.frame.observation.clone(), ..self.episode.state() }
    }

    /// Checks that a world that has repeated the actions of a state, `steps` of them, is in that
    /// state.
    pub(super) fn check_against(&self, state: &WorldState, steps: usize) -> Result<(), Error> {
        let seen = &self.frame.observation;
        // A processor of another kind may round differently.
        let other = |(now, then): (&f32, &f32)| (now - then).abs() > 1e-3 * then.abs().max(1.0);
        let changed = !state.observation.is_empty()
            && (seen.len() != state.observation.len()
                || seen.iter().zip(&state.observation).any(other));
        if (self.episode.index, self.episode.step as usize) == (state.episode, steps) && !changed {
            return Ok(());
        }
        Err(self.wrong_in_all(
            "the environment does not come back to where it was: it has changed, or an episode does not depend on its \
             seed and the actions alone",
        ))
    }

    fn go_on(&mut self, actions: &[f32]) -> Result<(), Error> {
        self.episode.note(actions);
        self.actions.clear();
        match self.env.spec().actions.choices() {
            None => self.actions.extend(actions.iter().map(|action| action.clamp(-1.0, 1.0))),
            Some(_) => self.actions.extend_from_slice(actions),
        }
        self.episode.step += 1;
        let before = self.frame.active.clone();
        if let Some(choices) = self.env.spec().actions.choices() {
            let is_choice =
                |choice: f32| choice.fract() == 0.0 && (0.0..choices as f32).contains(&choice);
            let acts = self.frame.active.iter().zip(&self.actions);
            let wrong =
                acts.enumerate().find(|(_, (acts, choice))| **acts > 0.0 && !is_choice(**choice));
            if let Some((i, (_, choice))) = wrong {
                return Err(
                    self.wrong(i, &format!("the action {choice} is none of {choices} choices"))
                );
            }
        }
        self.frame.begin(false);
        self.frame.reward.fill(0.0);
        self.frame.comm.copy_from_slice(&self.heard);
        self.env.step(&self.actions, &mut self.frame);
        self.check()?;
        // What is written for slots that did not act in this step does not count.
        let Frame { reward, terminated, truncated, .. } = &mut self.frame;
        for (i, acted) in before.iter().enumerate() {
            for value in [&mut reward[i], &mut terminated[i], &mut truncated[i]] {
                *value *= acted;
            }
        }
        self.leave_out_absent();
        self.check_heard()?;
        // The environment must say how the trajectory of an agent that stops acting has ended.
        for (i, acted) in before.iter().enumerate() {
            let frame = &self.frame;
            let (acted, acts, begins) = (*acted > 0.0, frame.active[i] > 0.0, frame.start[i] > 0.0);
            let ends = frame.terminated[i] + frame.truncated[i];
            let ended = ends > 0.0;
            if ends > 1.0 {
                return Err(self.wrong(i, "both `end` and `truncate` were called"));
            }
            if acted && !acts && !ended {
                let what = "acts no more, but neither `end` nor `truncate` was called";
                return Err(self.wrong(i, what));
            }
            if !acted && acts && !begins {
                return Err(self.wrong(i, "acts, but `begin_agent` was not called"));
            }
            if acted && begins {
                let what =
                    "begins in a slot that was in use until this step; let it come a step later";
                return Err(self.wrong(i, what));
            }
            if acts && ended {
                return Err(self.wrong(i, "acts on after its end"));
            }
        }
        let sum: f32 = self.frame.reward.iter().sum();
        self.step_rewards.push(sum / self.rewards.len() as f32);
        for (total, reward) in self.rewards.iter_mut().zip(&self.frame.reward) {
            *total += f64::from(*reward);
        }
        if self.frame.active.iter().all(|active| *active == 0.0) && !self.env.goes_on() {
            self.end()?;
        }
        Ok(())
    }

    fn end(&mut self) -> Result<(), Error> {
        let success = self.env.success();
        let (metrics, values) = (&self.env.spec().metrics, self.env.metrics());
        if metrics.len() != values.len() {
            return Err(self.wrong_in_all(&format!(
                "`metrics` returns {} values, but the spec has {} metrics",
                values.len(),
                metrics.len()
            )));
        }
        if !(0.0..=1.0).contains(&success) {
            let what = format!("`success` is {success}; allowed: a share from 0 to 1");
            return Err(self.wrong_in_all(&what));
        }
        for (OwnMetric { name, values, .. }, value) in metrics.iter().zip(&values) {
            let (fits, allowed) = match values {
                Values::Any => (value.is_finite(), "a finite number"),
                Values::Positive => (value.is_finite() && *value >= 0.0, "a number from 0 on"),
                Values::Rate => ((0.0..=1.0).contains(value), "a share from 0 to 1"),
            };
            if !fits {
                let what = format!("the metric `{name}` is {value}; allowed: {allowed}");
                return Err(self.wrong_in_all(&what));
            }
        }
        let own = metrics.iter().zip(values).map(|(metric, value)| (metric.name.to_owned(), value));
        self.finished = Some(EpisodeRecord {
            episode: self.episode.index,
            episode_length: self.episode.step,
            success,
            reward: self.rewards.iter().sum::<f64>() / self.rewards.len() as f64,
            driving: None,
            own: own.collect::<BTreeMap<_, _>>(),
            interrupted: false,
            repeated: self.episode.is_repeated(),
            step_rewards: std::mem::take(&mut self.step_rewards),
        });
        self.episode.end(success >= 1.0);
        Ok(())
    }

    /// Checks that the frame has the sizes of the spec and contains numbers, since one that does
    /// not would spoil all weights, that flags are 0 or 1, and that every agent that acts has a
    /// choice.
    fn check(&self) -> Result<(), Error> {
        let (frame, spec) = (&self.frame, self.env.spec());
        let n = spec.agents;
        let sizes = [
            ("observation", &frame.observation, spec.observation.len()),
            ("state", &frame.state, spec.state.len()),
            ("comm", &frame.comm, n),
            ("available", &frame.available, spec.actions.choices().unwrap_or(0)),
            ("active", &frame.active, 1),
            ("start", &frame.start, 1),
            ("reward", &frame.reward, 1),
            ("terminated", &frame.terminated, 1),
            ("truncated", &frame.truncated, 1),
            ("sharing", &frame.sharing, 0),
        ];
        for (what, values, width) in sizes {
            if values.len() != n * width {
                let (found, wanted) = (values.len(), n * width);
                return Err(
                    self.wrong_in_all(&format!("`{what}` has {found} numbers, not {wanted}"))
                );
            }
        }
        let flags = [
            ("comm", &frame.comm),
            ("available", &frame.available),
            ("active", &frame.active),
            ("start", &frame.start),
            ("terminated", &frame.terminated),
            ("truncated", &frame.truncated),
        ];
        for (what, flags) in flags {
            if let Some(at) = flags.iter().position(|flag| *flag != 0.0 && *flag != 1.0) {
                let text = format!("a number in `{what}` is {}, neither 0 nor 1", flags[at]);
                return Err(self.wrong(at / (flags.len() / n), &text));
            }
        }
        if let Some(choices) = self.env.spec().actions.choices() {
            for (i, open) in frame.available.chunks_exact(choices).enumerate() {
                if frame.active[i] > 0.0 && open.iter().all(|one| *one < 0.5) {
                    return Err(self.wrong(i, "no choice is open to it (`available`)"));
                }
            }
        }
        let arrays = [
            ("observation", &frame.observation),
            ("state", &frame.state),
            ("reward", &frame.reward),
        ];
        for (what, values) in arrays {
            let width = values.len() / self.rewards.len().max(1);
            if let Some(at) = values.iter().position(|value| !value.is_finite()) {
                let text = format!("{what} {} is {}", at % width, values[at]);
                return Err(self.wrong(at / width, &text));
            }
        }
        Ok(())
    }

    /// Checks that every agent hears no more others than the spec says.
    fn check_heard(&self) -> Result<(), Error> {
        let (frame, n) = (&self.frame, self.rewards.len());
        let Some(most) = self.env.spec().most_heard else { return Ok(()) };
        let heard = |i: usize| (0..n).filter(|&j| j != i && frame.comm[i * n + j] > 0.0).count();
        let Some(i) = (0..n).find(|&i| heard(i) > most) else { return Ok(()) };
        let text = format!("it hears {} others, and `most_heard` is {most}", heard(i));
        Err(self.wrong(i, &text))
    }

    pub(super) fn wrong_in_all(&self, what: &str) -> Error {
        let Episode { index, step, .. } = &self.episode;
        Error::Own { episode: *index, step: *step, what: what.to_owned() }
    }

    fn wrong(&self, agent: usize, what: &str) -> Error {
        let Episode { index, step, .. } = &self.episode;
        Error::Own { episode: *index, step: *step, what: format!("agent {agent}: {what}") }
    }
}
