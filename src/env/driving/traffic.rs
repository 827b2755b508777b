//! The environment of vehicles in SUMO: a [`Task`] and where its worlds run, behind the interface
//! [`Environment`], so that learners and evaluations need to know neither SUMO nor the task.

use std::path::Path;
use std::sync::Arc;

use super::Outcome;
use super::frame::AgentView;
use super::task::{Driver, Task};
use super::vec::{VecEnv, VecOptions};
use super::world::World;
use crate::env::environment::{Environment, Stream, WorldPhase, WorldView, Worlds};
use crate::env::episode::WorldState;
use crate::env::error::Error;
use crate::env::expert::Pursuit;
use crate::env::picture::{Backdrop, Figure, FigureStatus, Lane, Picture, SignalPlace};
use crate::env::spec::EnvSpec;
use crate::scenario::Scenario;
use crate::sumo::Hosting;
use crate::sumo::net::{EdgeFunction, Net};

use crate::env::record::EpisodeRecord;

/// The environment of a task: its vehicles, what drives them, and where their simulations run.
#[derive(Debug, Clone)]
pub struct Traffic {
    task: Arc<Task>,
    hosting: Hosting,
    driver: Driver,
    rule: Option<Pursuit>,
    /// The scenario with the values of the settings, of which the task's is made.
    scenario: Option<Arc<Scenario>>,
}

impl Traffic {
    /// Creates the environment of a task, in which actions drive the agents' vehicles.
    pub fn new(task: &Arc<Task>, hosting: Hosting) -> Self {
        Self { task: Arc::clone(task), hosting, driver: Driver::Agents, rule: None, scenario: None }
    }

    /// Returns the same environment, whose run folders get `scenario`, of which the task was made.
    #[must_use]
    pub fn described_by(self, scenario: &Scenario) -> Self {
        Self { scenario: Some(Arc::new(scenario.clone())), ..self }
    }

    /// Returns the same environment, in which SUMO's own driver drives the agents' vehicles.
    #[must_use]
    pub fn driven_by_sumo(self) -> Self {
        Self { driver: Driver::Sumo, ..self }
    }

    /// Returns the same environment, in which the rule `rule` drives the agents' vehicles.
    #[must_use]
    pub fn driven_by(self, rule: Pursuit) -> Self {
        let driver = if rule.gives_way { Driver::Rules } else { Driver::Agents };
        Self { driver, rule: Some(rule), ..self }
    }

    fn options(&self, stream: &Stream) -> VecOptions {
        VecOptions {
            worlds: stream.worlds,
            stride: stream.stride,
            driver: self.driver,
            seed: stream.seed,
            episodes: stream.episodes.clone(),
            repeat_failed: stream.repeat_failed,
            hosting: if stream.beside { self.hosting.beside() } else { self.hosting },
        }
    }

    fn with_rule(&self, env: VecEnv) -> Box<dyn Worlds> {
        Box::new(env.with_rule(self.rule))
    }
}

impl Environment for Traffic {
    fn name(&self) -> &str {
        &self.task.scenario.name
    }

    fn spec(&self) -> &EnvSpec {
        &self.task.spec
    }

    fn cooperation(&self) -> f64 {
        self.task.scenario.reward.cooperation
    }

    fn start(&self, stream: &Stream) -> Result<Box<dyn Worlds>, Error> {
        Ok(self.with_rule(VecEnv::new(&self.task, &self.options(stream))?))
    }

    fn restore(&self, stream: &Stream, states: &[WorldState]) -> Result<Box<dyn Worlds>, Error> {
        Ok(self.with_rule(VecEnv::restore(&self.task, &self.options(stream), states)?))
    }

    fn backdrop(&self) -> Result<Backdrop, Error> {
        self.task.backdrop()
    }

    fn description(&self, folder: &Path) -> std::io::Result<Option<(&'static str, String)>> {
        let scenario = self.scenario.as_deref().unwrap_or(&self.task.scenario);
        Ok(Some(("scenario.xml", scenario.to_xml_in(folder)?)))
    }
}

impl Worlds for VecEnv {
    fn count(&self) -> usize {
        self.len()
    }

    fn view(&self, e: usize) -> WorldView<'_> {
        let world = self.world(e);
        WorldView {
            frame: world.frame(),
            episode: world.episode(),
            step: world.step_count(),
            phase: match world {
                _ if world.is_idle() => WorldPhase::Idle,
                _ if world.is_running() => WorldPhase::Running,
                _ if world.has_ended() => WorldPhase::Ended,
                _ => WorldPhase::Between,
            },
        }
    }

    fn step(&mut self, actions: &[f32]) -> Result<(), Error> {
        Self::step(self, actions)
    }

    fn take_finished(&mut self) -> Vec<EpisodeRecord> {
        Self::take_finished(self)
    }

    fn states(&self) -> Vec<WorldState> {
        Self::states(self)
    }

    fn follow_rule(&self, actions: &mut [f32]) {
        let Some(rule) = self.rule() else { return };
        let width = self.spec().agents * self.spec().actions.len();
        let actions = actions.chunks_mut(width);
        self.worlds().zip(actions).for_each(|(world, actions)| world.pursue(rule, actions));
    }

    fn picture(&self, e: usize) -> Option<Picture> {
        Some(self.world(e).picture())
    }

    fn counters(&self) -> Vec<(&'static str, f64)> {
        let resets = self.resets();
        vec![
            ("resets/respawns", resets.respawns as f64),
            ("resets/loads", resets.loads as f64),
            ("resets/restarts", resets.restarts as f64),
        ]
    }
}

impl World {
    /// Returns what pictures show of the world at present.
    pub fn picture(&self) -> Picture {
        let agent = |agent: AgentView| Figure {
            centre: agent.pose.point(),
            heading: agent.pose.heading,
            size: agent.size,
            speed: agent.speed,
            status: match agent.outcome {
                _ if agent.driving => FigureStatus::Active,
                _ if agent.wreck => FigureStatus::Failed,
                Outcome { arrived: true, .. } => FigureStatus::Arrived,
                _ => FigureStatus::Absent,
            },
        };
        let others = self.background_vehicles().map(|other| Figure {
            centre: other.pose.point(),
            heading: other.pose.heading,
            size: other.size,
            speed: other.speed,
            status: if other.wreck { FigureStatus::Failed } else { FigureStatus::Active },
        });
        Picture {
            agents: self.agents().map(agent).collect(),
            others: others.collect(),
            lights: self.traffic_lights().map(str::to_owned).collect(),
        }
    }
}

impl Task {
    /// Returns the roads, walls and signals of the task.
    ///
    /// # Errors
    /// If the net cannot be read.
    pub fn backdrop(&self) -> Result<Backdrop, Error> {
        let net = Net::load(self.map.net_file())?;
        let drawn = net.lanes.iter().filter(|lane| {
            let function = net.edges[lane.edge].function;
            !matches!(function, EdgeFunction::Other | EdgeFunction::WalkingArea)
        });
        let lanes = drawn.map(|lane| Lane {
            id: lane.id.clone(),
            width: lane.width,
            internal: net.edges[lane.edge].function == EdgeFunction::Internal,
            crossing: net.edges[lane.edge].function == EdgeFunction::Crossing,
            shape: lane.shape.clone(),
        });
        let vehicle = &self.scenario.vehicle;
        Ok(Backdrop {
            step_length: self.scenario.control.interval,
            size: [vehicle.length, vehicle.width],
            range: self.scenario.communication.range,
            sight: Some(self.scenario.observation.detection_range).filter(|m| m.is_finite()),
            lanes: lanes.collect(),
            zones: Vec::new(),
            walls: self.map.walls.corners().map(<[_]>::to_vec).collect(),
            signals: self.signal_places(&net),
        })
    }

    /// Returns where the signals of the traffic lights stand that rule routes. The signals of one
    /// lane lie side by side, from the right.
    fn signal_places(&self, net: &Net) -> Vec<SignalPlace> {
        let lights = &self.map.traffic_lights.lights;
        let known = |id: &str| lights.iter().position(|light| light.id == id);
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
            all.extend(own.into_iter().zip(0..).map(|((light, signal), place)| SignalPlace {
                line: [at(f64::from(place) / count), at(f64::from(place + 1) / count)],
                light,
                signal,
            }));
        }
        all
    }
}
