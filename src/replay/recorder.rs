//! Records an episode while it is played.

use std::collections::BTreeMap;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;

use super::{Column, Error, FORMAT, Lane, Recording, Signal, Size, Status};
use crate::env::{EpisodeRecord, Outcome, Task, World};
use crate::sumo::net::{EdgeFunction, Net};

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
    actions: usize,
    /// Whether the task has background traffic.
    others: bool,
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
    fn new(agents: usize, actions: usize) -> Self {
        Self { action: vec![Vec::new(); actions], arrived: vec![0; agents], ..Self::default() }
    }
}

impl Recorder {
    /// Creates a recorder that waits for the given episode of a task.
    pub fn new(task: &Task, episode: u64) -> Self {
        let actions = task.spec.actions.len();
        let rows = Rows::new(task.agents, actions);
        Self { episode, actions, others: task.others > 0, rows, finished: false }
    }

    /// Returns whether a world plays the episode that the recorder waits for.
    pub fn watches(&self, world: &World) -> bool {
        !self.finished
            && world.episode() == self.episode
            && (world.is_running() || world.has_ended())
    }

    /// Records the state of the watched world before a decision, and the decision `actions [N, A]`.
    pub fn decide(&mut self, world: &World, actions: &[f32], diagnostics: &RecordedDiagnostics) {
        let agents = world.agents().count();
        // An episode in which SUMO died is played again from its start.
        if world.step_count() == 0 {
            self.rows = Rows::new(agents, self.actions);
        }
        let acts = world.is_running();
        let rows = &mut self.rows;
        for (i, agent) in world.agents().enumerate() {
            let status = match agent.outcome {
                _ if agent.driving => Status::Driving,
                _ if agent.wreck => Status::Crashed,
                Outcome { arrived: true, .. } if rows.arrived[i] < FAREWELL => Status::Arrived,
                _ => Status::Gone,
            };
            rows.arrived[i] += u32::from(agent.outcome.arrived);
            rows.x.push(agent.pose.x);
            rows.y.push(agent.pose.y);
            // The heading is mapped to −π..π, the range that a scale of 1e-4 can store.
            let (sin, cos) = agent.pose.heading.sin_cos();
            rows.heading.push(sin.atan2(cos));
            rows.sizes.iter_mut().zip(agent.size).for_each(|(column, size)| column.push(size));
            let if_driving = |value: f64| if agent.driving { value } else { f64::NAN };
            rows.speed.push(if_driving(agent.speed));
            for (a, column) in rows.action.iter_mut().enumerate() {
                let action = actions
                    .get(i * self.actions + a)
                    .map_or(f64::NAN, |v| f64::from(v.clamp(-1.0, 1.0)));
                column.push(if acts { if_driving(action) } else { f64::NAN });
            }
            rows.value
                .push(if_driving(diagnostics.value.get(i).copied().map_or(f64::NAN, f64::from)));
            rows.reward.push(f64::NAN);
            rows.status.push(status as u8);
        }
        if self.others {
            let short = |v: f64| (1000.0 * v).round() / 1000.0;
            let row = world.others().map(|other| {
                let (pose, wreck) = (other.pose, f64::from(u8::from(other.wreck)));
                [
                    short(pose.x),
                    short(pose.y),
                    short(pose.heading),
                    other.size[0],
                    other.size[1],
                    wreck,
                ]
            });
            rows.others.push(row.collect());
        }
        rows.lights.resize(world.traffic_lights().count(), Vec::new());
        for (light, state) in rows.lights.iter_mut().zip(world.traffic_lights()) {
            light.push(state.to_owned());
        }
        let comm = &world.frame().comm;
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
        self.finished |= world.has_ended();
    }

    /// Records the rewards of the step that followed the last decision.
    pub fn reward(&mut self, world: &World) {
        if self.finished || world.episode() != self.episode || world.step_count() == 0 {
            return;
        }
        let first = self.rows.reward.len().saturating_sub(world.agents().count());
        for (i, agent) in world.agents().enumerate() {
            if Status::from(self.rows.status[first + i]) == Status::Driving {
                self.rows.reward[first + i] = agent.reward;
            }
        }
    }

    /// Returns the recording of the episode as far as `world` has played it. Its last step is the
    /// present one. `None` if the world plays another episode and nothing has been recorded.
    ///
    /// # Errors
    /// As [`Recorder::finish`].
    pub fn so_far(
        &self,
        task: &Task,
        world: &World,
        policy: &str,
        seed: u64,
    ) -> Result<Option<Recording>, Error> {
        let mut recorder = self.clone();
        if recorder.watches(world) {
            recorder.decide(world, &[], &RecordedDiagnostics::default());
        }
        recorder.finished = !recorder.rows.status.is_empty();
        recorder.finish(task, policy, seed, None)
    }

    /// Returns the recording; `None` if the episode was not played to its end.
    ///
    /// # Errors
    /// [`Error::Net`] if the net cannot be read.
    pub fn finish(
        self,
        task: &Task,
        policy: &str,
        seed: u64,
        record: Option<&EpisodeRecord>,
    ) -> Result<Option<Recording>, Error> {
        if !self.finished {
            return Ok(None);
        }
        let path = task.map.net_file();
        let net = Net::load(path).map_err(|source| Error::Net { path: path.to_owned(), source })?;
        let lanes = net
            .lanes
            .iter()
            .filter(|lane| {
                !matches!(
                    net.edges[lane.edge].function,
                    EdgeFunction::Other | EdgeFunction::WalkingArea
                )
            })
            .map(|lane| Lane {
                id: lane.id.clone(),
                width: lane.width,
                internal: net.edges[lane.edge].function == EdgeFunction::Internal,
                crossing: net.edges[lane.edge].function == EdgeFunction::Crossing,
                shape: lane.shape.clone(),
            });
        let mut columns = BTreeMap::from([
            ("x".to_owned(), Column::new("m", &self.rows.x)),
            ("y".to_owned(), Column::new("m", &self.rows.y)),
            ("heading".to_owned(), Column::new("rad", &self.rows.heading)),
            ("speed".to_owned(), Column::new("m/s", &self.rows.speed)),
            ("reward".to_owned(), Column::new("1", &self.rows.reward)),
        ]);
        let vehicle = task.scenario.vehicle;
        let sizes = [("length", vehicle.length), ("width", vehicle.width)];
        for ((name, usual), column) in sizes.into_iter().zip(&self.rows.sizes) {
            let present = column.iter().zip(&self.rows.status);
            let mut present = present.filter(|(_, status)| **status != Status::Gone as u8);
            if present.any(|(size, _)| (size - usual).abs() > 1e-9) {
                columns.insert(name.to_owned(), Column::new("m", column));
            }
        }
        for (dimension, action) in task.spec.actions.iter().zip(&self.rows.action) {
            columns.insert(dimension.name.to_owned(), Column::new("1", action));
        }
        if self.rows.value.iter().any(|value| value.is_finite()) {
            columns.insert("value".to_owned(), Column::new("1", &self.rows.value));
        }
        let summary = record.map(|r| {
            [
                ("success", r.success),
                ("safety", r.safety),
                ("reward", r.reward),
                ("episode_length", f64::from(r.episode_length)),
            ]
        });
        let (vehicle, range) = (&task.scenario.vehicle, task.scenario.communication.range);
        Ok(Some(Recording {
            format: FORMAT,
            scenario: task.scenario.name.clone(),
            policy: policy.to_owned(),
            seed,
            episode: self.episode,
            step_length: task.scenario.control.interval,
            agents: task.agents,
            steps: self.rows.status.len() / task.agents,
            comm_range: range.is_finite().then_some(range),
            communicates: self.rows.graph,
            vehicle: Size { length: vehicle.length, width: vehicle.width },
            lanes: lanes.collect(),
            walls: task.map.walls.corners().map(<[_]>::to_vec).collect(),
            columns,
            status: STANDARD.encode(&self.rows.status),
            edges: Some(STANDARD.encode(&self.rows.edges)),
            others: self.rows.others,
            signals: signals(task, &net, &self.rows.lights),
            summary: summary
                .into_iter()
                .flatten()
                .map(|(key, value)| (key.to_owned(), value))
                .collect(),
        }))
    }
}

/// Returns the signals of the traffic lights in `lights`, which holds their states step by step in
/// the task's order. The signals of one lane lie side by side, from the right.
fn signals(task: &Task, net: &Net, lights: &[Vec<String>]) -> Vec<Signal> {
    let known = |id: &str| task.map.traffic_lights.lights.iter().position(|light| light.id == id);
    let mut all = Vec::new();
    for (index, lane) in net.lanes.iter().enumerate() {
        let mut own: Vec<(usize, usize)> = net
            .connections_from(index)
            .filter(|_| net.edges[lane.edge].function == EdgeFunction::Normal)
            .filter_map(|connection| connection.signal)
            .filter_map(|s| Some((known(&net.traffic_lights[s.traffic_light].id)?, s.index)))
            .collect();
        own.sort_unstable();
        own.dedup();
        let [.., before, end] = lane.shape[..] else { continue };
        let (dx, dy) = (end[0] - before[0], end[1] - before[1]);
        let length = dx.hypot(dy).max(f64::MIN_POSITIVE);
        // A point of the stop line, from the right end (0) to the left end (1).
        let at = |share: f64| {
            let left = (share - 0.5) * lane.width / length;
            [end[0] - dy * left, end[1] + dx * left].map(|v| (100.0 * v).round() / 100.0)
        };
        let count = own.len() as f64;
        all.extend(own.into_iter().zip(0..).map(|((light, signal), place)| {
            Signal {
                line: [at(f64::from(place) / count), at(f64::from(place + 1) / count)],
                states: lights[light]
                    .iter()
                    .map(|state| state.as_bytes().get(signal).map_or('O', |&letter| letter.into()))
                    .collect(),
            }
        }));
    }
    all
}
