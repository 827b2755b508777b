//! Records an episode while it is played.

use std::collections::BTreeMap;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;

use super::{Column, FORMAT, Recording, Signal, Size, Status};
use crate::env::{
    Backdrop, EnvSpec, EpisodeRecord, Figure, FigureStatus, Lane, Picture, WorldPhase, WorldView,
    Worlds,
};

/// Number of steps for which a vehicle that has arrived stays visible.
const FAREWELL: u32 = 5;

/// Diagnostics of a policy at a decision of one world.
#[derive(Debug, Clone, Default)]
pub struct RecordedDiagnostics {
    /// Value estimates, `[N]`; empty if the policy has none.
    pub value: Vec<f32>,
    /// Communication graph, `[N, N]`, row = receiver; empty for algorithms without messages.
    pub graph: Vec<f32>,
}

/// Records one episode while it is played.
#[derive(Debug, Clone)]
pub struct Recorder {
    episode: u64,
    agents: usize,
    /// Names of the numbers of an action, and their bounds.
    actions: Vec<&'static str>,
    bounds: [f32; 2],
    /// Whether an action is the number of a choice.
    chooses: bool,
    rows: Rows,
    finished: bool,
}

/// The columns of a recording, one entry per step and agent.
#[derive(Debug, Clone, Default)]
struct Rows {
    x: Vec<f64>,
    y: Vec<f64>,
    heading: Vec<f64>,
    speed: Vec<f64>,
    sizes: [Vec<f64>; 2],
    action: Vec<Vec<f64>>,
    reward: Vec<f64>,
    value: Vec<f64>,
    status: Vec<u8>,
    /// Whether the agent was on its way.
    acts: Vec<bool>,
    edges: Vec<u8>,
    others: Vec<Vec<[f64; 6]>>,
    /// States of each traffic light, step by step.
    lights: Vec<Vec<String>>,
    /// Number of steps since each agent arrived.
    arrived: Vec<u32>,
    /// Whether the policy has a communication graph.
    graph: bool,
}

impl Rows {
    /// Returns a strip of ground below all agents, for environments that draw none.
    fn ground(&self) -> Lane {
        const MARGIN: f64 = 1.0;
        let ends = |values: &[f64]| {
            let least = values.iter().copied().fold(f64::INFINITY, f64::min);
            let most = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            if least.is_finite() && most.is_finite() { [least, most] } else { [0.0, 0.0] }
        };
        let ([left, right], [bottom, top]) = (ends(&self.x), ends(&self.y));
        let middle = f64::midpoint(bottom, top);
        Lane {
            id: "ground".to_owned(),
            width: top - bottom + 2.0 * MARGIN,
            internal: false,
            crossing: false,
            shape: vec![[left - MARGIN, middle], [right + MARGIN, middle]],
        }
    }

    fn new(agents: usize, actions: usize) -> Self {
        Self { action: vec![Vec::new(); actions], arrived: vec![0; agents], ..Self::default() }
    }
}

impl Recorder {
    /// Creates a recorder that waits for the given episode.
    pub fn new(spec: &EnvSpec, episode: u64) -> Self {
        let actions = spec.actions.names();
        let rows = Rows::new(spec.agents, actions.len());
        let bounds =
            spec.actions.choices().map_or([-1.0, 1.0], |k| [0.0, k.saturating_sub(1) as f32]);
        let chooses = spec.actions.choices().is_some();
        Self { episode, agents: spec.agents, actions, bounds, chooses, rows, finished: false }
    }

    /// Returns the number of the world that plays the episode for which the recorder waits.
    pub fn watches(&self, worlds: &dyn Worlds) -> Option<usize> {
        let plays = |view: WorldView<'_>| {
            view.episode == self.episode
                && matches!(view.phase, WorldPhase::Running | WorldPhase::Ended)
        };
        (0..worlds.count()).find(|&e| !self.finished && plays(worlds.view(e)))
    }

    /// Records the state of the watched world `e` before a decision, and the decision
    /// `actions [N, A]`.
    pub fn decide(
        &mut self,
        worlds: &dyn Worlds,
        e: usize,
        actions: &[f32],
        diagnostics: &RecordedDiagnostics,
    ) {
        let Some(mut picture) = worlds.picture(e) else { return };
        picture.agents.resize(self.agents, Figure::default());
        self.note(&worlds.view(e), &picture, actions, diagnostics);
    }

    fn note(
        &mut self,
        view: &WorldView<'_>,
        picture: &Picture,
        actions: &[f32],
        diagnostics: &RecordedDiagnostics,
    ) {
        let agents = self.agents;
        // An episode in which SUMO died is played again from its start.
        if view.step == 0 {
            self.rows = Rows::new(agents, self.actions.len());
        }
        let acts = view.phase == WorldPhase::Running;
        let rows = &mut self.rows;
        for (i, agent) in picture.agents.iter().enumerate() {
            let arrived = agent.status == FigureStatus::Arrived;
            let status = match agent.status {
                FigureStatus::Active => Status::Driving,
                FigureStatus::Failed => Status::Failed,
                FigureStatus::Arrived if rows.arrived[i] < FAREWELL => Status::Arrived,
                _ => Status::Gone,
            };
            rows.arrived[i] += u32::from(arrived);
            rows.x.push(agent.centre[0]);
            rows.y.push(agent.centre[1]);
            // The heading is mapped to −π..π, the range that a scale of 1e-4 can store.
            let (sin, cos) = agent.heading.sin_cos();
            rows.heading.push(sin.atan2(cos));
            rows.sizes.iter_mut().zip(agent.size).for_each(|(column, size)| column.push(size));
            let drives = status == Status::Driving || view.frame.active[i] > 0.0;
            rows.acts.push(drives);
            let if_driving = |value: f64| if drives { value } else { f64::NAN };
            rows.speed.push(if_driving(agent.speed));
            for (a, column) in rows.action.iter_mut().enumerate() {
                let action = actions
                    .get(i * self.actions.len() + a)
                    .map_or(f64::NAN, |v| f64::from(v.clamp(self.bounds[0], self.bounds[1])));
                column.push(if acts { if_driving(action) } else { f64::NAN });
            }
            rows.value
                .push(if_driving(diagnostics.value.get(i).copied().map_or(f64::NAN, f64::from)));
            rows.reward.push(f64::NAN);
            rows.status.push(status as u8);
        }
        let short = |v: f64| (1000.0 * v).round() / 1000.0;
        let row = picture.others.iter().map(|other| {
            let wreck = f64::from(u8::from(other.status == FigureStatus::Failed));
            let [x, y] = other.centre.map(short);
            [x, y, short(other.heading), other.size[0], other.size[1], wreck]
        });
        rows.others.push(row.collect());
        rows.lights.resize(picture.lights.len(), Vec::new());
        for (light, state) in rows.lights.iter_mut().zip(&picture.lights) {
            light.push(state.clone());
        }
        let comm = &view.frame.comm;
        rows.graph = !diagnostics.graph.is_empty();
        for i in 0..agents {
            let mut bits = vec![0_u8; agents.div_ceil(8)];
            for j in (0..agents).filter(|&j| j != i && comm[i * agents + j] > 0.0) {
                if diagnostics.graph.get(i * agents + j).is_none_or(|&edge| edge > 0.5) {
                    bits[j / 8] |= 1 << (j % 8);
                }
            }
            rows.edges.extend(bits);
        }
        self.finished |= view.phase == WorldPhase::Ended;
    }

    /// Records the rewards of the step that followed the last decision.
    pub fn reward(&mut self, worlds: &dyn Worlds) {
        if self.finished {
            return;
        }
        let views = (0..worlds.count()).map(|e| worlds.view(e));
        for view in views.filter(|view| view.episode == self.episode && view.step > 0) {
            let first = self.rows.reward.len().saturating_sub(self.agents);
            for (i, reward) in view.frame.reward.iter().enumerate() {
                if self.rows.acts.get(first + i) == Some(&true) {
                    self.rows.reward[first + i] = f64::from(*reward);
                }
            }
        }
    }

    /// Returns the recording of the episode as far as world `e` has played it. Its last step is the
    /// present one. `None` if the world plays another episode and nothing has been recorded.
    pub fn so_far(
        &self,
        worlds: &dyn Worlds,
        e: usize,
        backdrop: &Backdrop,
        title: &Title<'_>,
    ) -> Option<Recording> {
        let mut recorder = self.clone();
        if recorder.watches(worlds) == Some(e) {
            recorder.decide(worlds, e, &[], &RecordedDiagnostics::default());
        }
        recorder.finished = !recorder.rows.status.is_empty();
        recorder.finish(backdrop, title, None)
    }

    /// Returns the recording; `None` if the episode was not played to its end.
    pub fn finish(
        self,
        backdrop: &Backdrop,
        title: &Title<'_>,
        record: Option<&EpisodeRecord>,
    ) -> Option<Recording> {
        if !self.finished {
            return None;
        }
        let mut columns = BTreeMap::from([
            ("x".to_owned(), Column::new("m", &self.rows.x)),
            ("y".to_owned(), Column::new("m", &self.rows.y)),
            ("heading".to_owned(), Column::new("rad", &self.rows.heading)),
            ("speed".to_owned(), Column::new("m/s", &self.rows.speed)),
            ("reward".to_owned(), Column::new("1", &self.rows.reward)),
        ]);
        let [length, width] = backdrop.size;
        let sizes = [("length", length), ("width", width)];
        for ((name, usual), column) in sizes.into_iter().zip(&self.rows.sizes) {
            let present = column.iter().zip(&self.rows.status);
            let mut present = present.filter(|(_, status)| **status != Status::Gone as u8);
            if present.any(|(size, _)| (size - usual).abs() > 1e-9) {
                columns.insert(name.to_owned(), Column::new("m", column));
            }
        }
        for (name, action) in self.actions.iter().zip(&self.rows.action) {
            let unit = if self.chooses { "choice" } else { "1" };
            columns.insert((*name).to_owned(), Column::new(unit, action));
        }
        if self.rows.value.iter().any(|value| value.is_finite()) {
            columns.insert("value".to_owned(), Column::new("1", &self.rows.value));
        }
        let summary = record.map(|r| {
            let mut all =
                vec![("reward", r.reward), ("episode_length", f64::from(r.episode_length))];
            if let Some(success) = r.success() {
                all.insert(0, ("success", success));
                all.extend(r.driving.as_ref().map(|driving| ("safety", driving.safety)));
            }
            all.extend(r.own.iter().map(|(name, value)| (name.as_str(), *value)));
            all
        });
        let signals = backdrop.signals.iter().map(|place| {
            let letter = |state: &String| {
                state.as_bytes().get(place.signal).map_or('O', |&letter| letter.into())
            };
            Signal {
                line: place.line,
                states: self
                    .rows
                    .lights
                    .get(place.light)
                    .into_iter()
                    .flatten()
                    .map(letter)
                    .collect(),
            }
        });
        let has_others = self.rows.others.iter().any(|row| !row.is_empty());
        Some(Recording {
            format: FORMAT,
            scenario: title.environment.to_owned(),
            policy: title.policy.to_owned(),
            seed: title.seed,
            episode: self.episode,
            step_length: backdrop.step_length,
            agents: self.agents,
            steps: self.rows.status.len() / self.agents,
            comm_range: backdrop.range.is_finite().then_some(backdrop.range),
            sight_range: backdrop.sight,
            communicates: self.rows.graph,
            vehicle: Size { length, width },
            lanes: if backdrop.lanes.is_empty() && backdrop.zones.is_empty() {
                vec![self.rows.ground()]
            } else {
                backdrop.lanes.clone()
            },
            zones: backdrop.zones.clone(),
            walls: backdrop.walls.clone(),
            columns,
            status: STANDARD.encode(&self.rows.status),
            edges: Some(STANDARD.encode(&self.rows.edges)),
            signals: signals.collect(),
            others: if has_others { self.rows.others } else { Vec::new() },
            summary: summary
                .into_iter()
                .flatten()
                .map(|(key, value)| (key.to_owned(), value))
                .collect(),
        })
    }
}

/// What a recording says about its origin.
#[derive(Debug, Clone, Copy)]
pub struct Title<'a> {
    /// Name of the environment, such as the scenario's.
    pub environment: &'a str,
    /// Name of the policy.
    pub policy: &'a str,
    /// Seed of the episodes.
    pub seed: u64,
}
