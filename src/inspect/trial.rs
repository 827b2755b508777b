//! A short run of a scenario with SUMO: whether the scenario runs, what agents observe in it, and
//! how fast it is.

use std::sync::Arc;
use std::time::Instant;

use rand::RngExt as _;
use serde::Serialize;

use crate::env::{Driver, Error, Features, Refused, RouteGeometry, Task, VecEnv, VecOptions};
use crate::rng::{Seed, symmetric};
use crate::scenario::{Finding, LeftOut, Scenario, Severity};
use crate::sumo::Hosting;
use crate::words::counted;

/// Range of the agents' desired speeds, as shares of the maximum speed.
const SHARES: std::ops::Range<f64> = 0.3..1.0;
/// Amplitude of the noise on throttle, brake and steering, and of that on the lane that agents ask
/// for: so large that they change lanes.
const NOISE: [f64; 2] = [0.3, 0.6];
/// Maximum number of names that a finding lists.
const NAMED: usize = 8;

/// The result of a trial.
#[derive(Debug, Clone, Serialize)]
pub struct Trial {
    /// Number of agents N.
    pub agents: usize,
    /// Number of steps.
    pub steps: u32,
    /// Number of finished episodes.
    pub episodes: usize,
    /// Number of episodes that were interrupted because SUMO lost a vehicle.
    pub lost: usize,
    /// Number of episodes in which all agents drove at full throttle, and number of those in which
    /// no agent crashed or went off-road.
    pub flat_out: [usize; 2],
    /// Largest number of other routes with which a route has a conflict before its finish.
    pub meetings: usize,
    /// What the polygons of `<occlusion>` hide; `None` without polygons.
    pub hiding: Option<Hiding>,
    /// Share of the vehicles whose route needs a lane change.
    pub lane_changes: f64,
    /// Steps per second of one world.
    pub steps_per_second: f64,
    /// Routes of the vehicles that collided in the first step of an episode, sorted.
    pub collided_at_once: Vec<String>,
    /// Values of each feature of the observation, over all active agents.
    pub observation: Vec<Range>,
    /// Values of each feature of the privileged state, over all active agents.
    pub state: Vec<Range>,
}

/// The range of values of a feature.
#[derive(Debug, Clone, Serialize)]
pub struct Range {
    /// Name of the feature.
    pub name: String,
    /// Unit of the feature.
    pub unit: String,
    /// Smallest allowed value.
    pub low: f32,
    /// Largest allowed value.
    pub high: f32,
    /// Smallest value in the trial.
    pub least: f32,
    /// Largest value in the trial.
    pub most: f32,
    /// Whether all values were finite.
    pub finite: bool,
}

/// What polygons that block sight or radio do to vehicles on the routes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Hiding {
    /// Whether a polygon lies between two places on the routes that are within range of each other.
    pub hides: bool,
    /// A place on a route that lies in a polygon \[m\].
    pub covered: Option<[f64; 2]>,
}

/// Distance between two places on a route that are tried \[m\], and the most places.
const SPACING: f64 = 5.0;
const PLACES: usize = 600;

impl Hiding {
    fn of(task: &Task) -> Option<Self> {
        let walls = &task.map.walls;
        if walls.is_empty() {
            return None;
        }
        let places = |route: &RouteGeometry| {
            let count = (route.path.length() / SPACING) as u32;
            (0..=count).map(|k| route.path.at(f64::from(k) * SPACING).0).collect::<Vec<_>>()
        };
        let all: Vec<[f64; 2]> = task.map.routes.iter().flat_map(places).collect();
        let some: Vec<_> = all.iter().step_by(all.len().div_ceil(PLACES).max(1)).collect();
        let scenario = &task.scenario;
        let range = scenario.observation.detection_range.max(scenario.communication.range);
        let near = |a: &[f64; 2], b: &[f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]) <= range;
        let hidden = |a: &[f64; 2], b: &[f64; 2]| near(a, b) && walls.block(*a, *b);
        Some(Self {
            hides: some.iter().enumerate().any(|(k, a)| some[..k].iter().any(|b| hidden(a, b))),
            covered: all.iter().copied().find(|place| walls.contain(*place)),
        })
    }
}

impl Trial {
    /// Runs `steps` steps of one world. In episodes with an even number, vehicles follow their
    /// routes at full throttle; in the others they drive at individual speeds with some noise.
    ///
    /// # Errors
    /// [`Error`] if the scenario does not support this number of agents, or SUMO fails.
    pub fn run(
        scenario: &Scenario,
        agents: u32,
        steps: u32,
        seed: Seed,
        hosting: &Hosting,
    ) -> Result<Self, Error> {
        let task = Arc::new(Task::new(scenario, agents)?);
        let options = VecOptions {
            worlds: 1,
            stride: 1,
            driver: Driver::Agents,
            seed: seed.child("episodes"),
            episodes: 0..u64::from(u32::MAX),
            repeat_failed: 0.0,
            hosting: Hosting { processes: 1, ..*hosting },
        };
        let mut env = VecEnv::new(&task, &options)?;
        let mut trial = Self {
            agents: task.agents,
            steps,
            episodes: 0,
            lost: 0,
            flat_out: [0; 2],
            meetings: task.map.routes.iter().map(meetings).max().unwrap_or(0),
            hiding: Hiding::of(&task),
            lane_changes: task.lane_change_share(),
            steps_per_second: 0.0,
            collided_at_once: Vec::new(),
            observation: ranges(&task.spec.observation),
            state: ranges(&task.spec.state),
        };
        let (width, names) = (task.spec.actions.len(), task.spec.actions.names());
        let mut actions = vec![0.0; task.agents * width];
        let begin = Instant::now();
        for _ in 0..steps {
            let world = env.worlds().next().expect("one world");
            let (frame, own) = (world.frame(), seed.child("drivers").index(world.episode()));
            let mut noise = own.index(u64::from(world.step_count())).rng();
            for (i, acts) in actions.chunks_mut(width).enumerate() {
                let (share, noisy) = if is_flat_out(world.episode()) {
                    (1.0, [0.0; 2])
                } else {
                    (own.child("speed").index(i as u64).rng().random_range(SHARES), NOISE)
                };
                let [steer, throttle] = world.pursuit(i, share * scenario.vehicle.max_speed);
                let wanted = task.action(steer, throttle);
                for ((act, wanted), name) in acts.iter_mut().zip(wanted).zip(&names) {
                    let noisy = noisy[usize::from(*name == "lane")];
                    *act = (wanted + noisy * symmetric(&mut noise)).clamp(-1.0, 1.0) as f32;
                }
                if frame.active[i] > 0.0 {
                    take(&mut trial.observation, &frame.observation, i);
                    take(&mut trial.state, &frame.state, i);
                }
            }
            env.step(&actions)?;
            for episode in env.take_finished() {
                *(if episode.interrupted { &mut trial.lost } else { &mut trial.episodes }) += 1;
                if is_flat_out(episode.episode) && !episode.interrupted {
                    trial.flat_out[0] += 1;
                    trial.flat_out[1] += usize::from(episode.driving().safety >= 1.0);
                }
            }
            let world = env.worlds().next().expect("one world");
            if world.step_count() == 1 {
                let crashed = world.agents().filter(|agent| agent.outcome.crashed);
                trial
                    .collided_at_once
                    .extend(crashed.map(|agent| task.map.route_id(agent.route).to_owned()));
            }
        }
        trial.steps_per_second = f64::from(steps) / begin.elapsed().as_secs_f64().max(1e-9);
        trial.collided_at_once.sort();
        trial.collided_at_once.dedup();
        Ok(trial)
    }

    /// Returns an error for each route of a spawn place on which SUMO lets no vehicle depart, a
    /// warning about the vehicles and persons of the route files whom SUMO refuses, and one about
    /// those of whom it refuses a stop; with [`Traffic::strict`](crate::scenario::Traffic), an
    /// error for each of them.
    ///
    /// # Errors
    /// [`Error`] if the scenario does not support this number of agents, or SUMO fails.
    pub fn refused(
        scenario: &Scenario,
        agents: u32,
        hosting: &Hosting,
    ) -> Result<Vec<Finding>, Error> {
        let task = Task::new(scenario, agents)?;
        let of_place = |message: String| {
            Finding {
            severity: Severity::Error,
            kind: "departure",
            file: scenario.path.clone(),
            at: None,
            message,
            hint: Some(
                "lower the row's departSpeed, or move the place away from the junction: a vehicle that has to yield there must be able \
                 to stop"
                    .to_owned(),
            ),
        }
        };
        let mut findings: Vec<Finding> =
            task.dropped_at_places(hosting)?.into_iter().map(of_place).collect();
        let Refused { vehicles, stops, of } = task.refused_departures(hosting)?;
        if scenario.traffic.strict {
            let all = vehicles.iter().chain(&stops);
            findings.extend(all.map(|out| Finding::of(&out.error(), &out.place.path)));
            return Ok(findings);
        }
        let left_out = LeftOut::finding(&vehicles, of, "left out");
        let without = LeftOut::finding(&stops, of, "drive on without a stop");
        findings.extend(left_out.into_iter().chain(without));
        Ok(findings)
    }

    /// Returns the errors and warnings that follow from the trial.
    pub fn findings(&self, scenario: &Scenario) -> Vec<Finding> {
        let finding = |severity, kind, message: String, hint: &str| Finding {
            severity,
            kind,
            file: scenario.path.clone(),
            at: None,
            message,
            hint: Some(hint.to_owned()),
        };
        let mut findings = Vec::new();
        if !self.collided_at_once.is_empty() {
            findings.push(finding(
                Severity::Error,
                "collision-at-start",
                format!("vehicles of {} collide where they begin", list(&self.collided_at_once)),
                "move the places of rows on lanes that cross or run close to each other",
            ));
        }
        if self.lost > 0 {
            findings.push(finding(
                Severity::Error,
                "lost-vehicles",
                format!(
                    "SUMO lost vehicles in {}: they left its roads before they arrived",
                    counted(self.lost, "episode")
                ),
                "look at the last edges of the routes and at arrivalPos",
            ));
        }
        for (what, ranges) in [("observation", &self.observation), ("state", &self.state)] {
            let names = |wanted: &dyn Fn(&Range) -> bool| -> Vec<String> {
                ranges
                    .iter()
                    .filter(|range| wanted(range))
                    .map(|range| range.name.clone())
                    .collect()
            };
            let strange =
                names(&|range| !range.finite || range.least < range.low || range.most > range.high);
            if !strange.is_empty() {
                findings.push(finding(
                    Severity::Error,
                    "out-of-range",
                    format!("{what}: these features were outside of their range, or not finite: {}", list(&strange)),
                    "a defect of this program, or a net with extreme coordinates; please report it with the scenario",
                ));
            }
        }
        let seen = scenario.observation;
        if !seen.groups.nearest() && seen.conflict_streams < self.meetings {
            findings.push(finding(
                Severity::Warning,
                "conflict-streams",
                format!("a route crosses or joins {}, of which agents observe {}", counted(self.meetings, "other"), seen.conflict_streams),
                "raise conflictStreams in <observation>, up to 16, or use groups=\"both\", which adds the nearest vehicles",
            ));
        }
        let [played, unharmed] = self.flat_out;
        if played > 0 && unharmed == played && self.agents > 1 {
            findings.push(finding(
                Severity::Warning,
                "little-to-coordinate",
                format!("no vehicle crashed in {} at full throttle, so there is little to coordinate", counted(played, "episode")),
                "add vehicles, or move places so that vehicles reach conflict points at the same time; more --steps play more episodes",
            ));
        }
        if self.hiding.is_some_and(|hiding| !hiding.hides) {
            findings.push(finding(
                Severity::Warning,
                "hides-nobody",
                "no polygon of <occlusion> lies between two places on the routes".to_owned(),
                "give the corners in the coordinates of the net, whose <location netOffset> netconvert has added to those of its input",
            ));
        }
        if let Some([x, y]) = self.hiding.and_then(|hiding| hiding.covered) {
            findings.push(finding(
                Severity::Warning,
                "polygon-on-road",
                format!("vehicles drive through a polygon of <occlusion>, at ({x:.1}, {y:.1})"),
                "move the polygon off the road",
            ));
        }
        let constant = self.constant();
        if !self.saw_agents() {
            findings.push(finding(
                Severity::Warning,
                "no-agent",
                format!("no agent was on the road in {} of the trial", counted(self.steps, "step")),
                "give more --steps, or begin the route files' time later (`begin` of <traffic>)",
            ));
        } else if !constant.is_empty() {
            findings.push(finding(
                Severity::Warning,
                "constant-features",
                format!("observation: these features never changed: {}", list(&constant)),
                "observe fewer streams, vehicles or neighbours in <observation>; more --steps may show more",
            ));
        }
        findings
    }
}

impl Trial {
    /// Returns whether an agent was on the road in the trial, so that there are observations.
    pub fn saw_agents(&self) -> bool {
        self.observation.iter().any(|range| range.least <= range.most)
    }

    /// Returns the groups of the observation, e.g. `neighbour_3`, that never changed.
    fn constant(&self) -> Vec<String> {
        let group = |range: &Range| range.name.split('.').next().unwrap_or_default().to_owned();
        let groups = self.observation.chunk_by(|a, b| group(a) == group(b));
        let still = groups
            .filter(|group| group.iter().all(|range| range.finite && range.least >= range.most));
        still.filter_map(|ranges| ranges.first().map(group)).collect()
    }
}

/// Returns the number of other routes with which a route has a conflict before its finish.
fn meetings(route: &RouteGeometry) -> usize {
    route.conflicts.iter().filter(|conflict| conflict.own <= route.arrival).count()
}

/// Returns whether agents drive at full throttle in an episode: in every second one.
fn is_flat_out(episode: u64) -> bool {
    episode.is_multiple_of(2)
}

fn ranges(features: &Features) -> Vec<Range> {
    let range = |feature: &crate::env::Feature| Range {
        name: feature.name.clone(),
        unit: feature.unit.clone(),
        low: feature.low,
        high: feature.high,
        least: f32::INFINITY,
        most: f32::NEG_INFINITY,
        finite: true,
    };
    features.list.iter().map(range).collect()
}

/// Updates the ranges with the values of agent `i`, from `all [N, F]`.
fn take(ranges: &mut [Range], all: &[f32], i: usize) {
    let width = ranges.len();
    for (range, &value) in ranges.iter_mut().zip(&all[i * width..(i + 1) * width]) {
        range.finite &= value.is_finite();
        range.least = range.least.min(value);
        range.most = range.most.max(value);
    }
}

/// Returns the first names as a list for a sentence, with the number of the others.
fn list(names: &[String]) -> String {
    let more = names.len().saturating_sub(NAMED);
    let shown = names[..names.len() - more].join(", ");
    if more > 0 { format!("{shown} and {more} more") } else { shown }
}
