//! A short run of a scenario with SUMO: whether it runs at all, what agents see in it, and how fast it is.

use std::sync::Arc;
use std::time::Instant;

use rand::RngExt as _;
use serde::Serialize;

use crate::env::{Driver, Error, Features, RouteGeometry, Task, VecEnv, VecOptions};
use crate::rng::{Seed, symmetric};
use crate::scenario::{Finding, Scenario, Severity};
use crate::sumo::Hosting;

/// Drivers differ in the speed they want: shares of the top speed.
const SHARES: std::ops::Range<f64> = 0.3..1.0;
/// Noise of throttle, brake and steering.
const NOISE: f64 = 0.3;
/// Most features that a finding names.
const NAMED: usize = 8;

/// What a trial saw.
#[derive(Debug, Clone, Serialize)]
pub struct Trial {
    /// Agents N.
    pub agents: usize,
    /// Steps taken.
    pub steps: u32,
    /// Episodes that came to an end.
    pub episodes: usize,
    /// Episodes that were broken off because SUMO lost a vehicle.
    pub lost: usize,
    /// Episodes in which all drove at full throttle, and those of them in which nobody came to harm.
    pub flat_out: [usize; 2],
    /// Most other routes that a route meets before its finish.
    pub meetings: usize,
    /// Steps of one world per second.
    pub steps_per_second: f64,
    /// Routes of vehicles that collided in the first step of an episode, sorted.
    pub collided_at_once: Vec<String>,
    /// What agents that drove saw, feature by feature.
    pub observation: Vec<Range>,
    /// The same of the privileged state.
    pub state: Vec<Range>,
}

/// The values that a feature had.
#[derive(Debug, Clone, Serialize)]
pub struct Range {
    /// Name.
    pub name: String,
    /// What one is.
    pub unit: String,
    /// Smallest value that it may have.
    pub low: f32,
    /// Largest value that it may have.
    pub high: f32,
    /// Smallest value.
    pub least: f32,
    /// Largest value.
    pub most: f32,
    /// Whether all were numbers.
    pub finite: bool,
}

impl Trial {
    /// Runs `steps` steps of one world. In every second episode vehicles follow their routes at full throttle, in the others at speeds
    /// of their own, with some noise.
    ///
    /// # Errors
    /// When the scenario does not take so many agents, or SUMO fails.
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
            driver: Driver::Agents,
            seed: seed.child("episodes"),
            episodes: 0..u64::from(u32::MAX),
            replay: 0.0,
            hosting: Hosting { processes: 1, ..*hosting },
        };
        let mut env = VecEnv::new(&task, &options)?;
        let mut trial = Self {
            agents: task.agents,
            steps,
            episodes: 0,
            lost: 0,
            flat_out: [0; 2],
            meetings: task.routes.iter().map(meetings).max().unwrap_or(0),
            steps_per_second: 0.0,
            collided_at_once: Vec::new(),
            observation: ranges(&task.spec.observation),
            state: ranges(&task.spec.state),
        };
        let width = task.spec.actions.len();
        let mut actions = vec![0.0; task.agents * width];
        let begin = Instant::now();
        for _ in 0..steps {
            let world = env.worlds().next().expect("one world");
            let (frame, own) = (world.frame(), seed.child("drivers").index(world.episode()));
            let mut noise = own.index(u64::from(world.step_count())).rng();
            for (i, acts) in actions.chunks_mut(width).enumerate() {
                let (share, noisy) = if is_flat_out(world.episode()) {
                    (1.0, 0.0)
                } else {
                    (own.child("speed").index(i as u64).rng().random_range(SHARES), NOISE)
                };
                let wanted = world.pursuit(i, share * scenario.vehicle.max_speed);
                // Where there is one action only, it is the throttle.
                for (act, wanted) in acts.iter_mut().zip(&wanted[2 - width..]) {
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
                    trial.flat_out[1] += usize::from(episode.safety >= 1.0);
                }
            }
            let world = env.worlds().next().expect("one world");
            if world.step_count() == 1 {
                let crashed = world.agents().filter(|agent| agent.fate.crashed);
                trial
                    .collided_at_once
                    .extend(crashed.map(|agent| scenario.routes[agent.route].id.clone()));
            }
        }
        trial.steps_per_second = f64::from(steps) / begin.elapsed().as_secs_f64().max(1e-9);
        trial.collided_at_once.sort();
        trial.collided_at_once.dedup();
        Ok(trial)
    }

    /// What is wrong, or seems to be, going by the trial.
    pub fn findings(&self, scenario: &Scenario) -> Vec<Finding> {
        let finding = |severity, message: String, hint: &str| Finding {
            severity,
            file: scenario.path.clone(),
            at: None,
            message,
            hint: Some(hint.to_owned()),
        };
        let mut findings = Vec::new();
        if !self.collided_at_once.is_empty() {
            findings.push(finding(
                Severity::Error,
                format!("vehicles of {} collide where they begin", list(&self.collided_at_once)),
                "move the places of rows on lanes that cross or run close to each other",
            ));
        }
        if self.lost > 0 {
            findings.push(finding(
                Severity::Error,
                format!("SUMO lost vehicles in {} episodes: they left its roads before they arrived", self.lost),
                "look at the routes' last edges and arrivalPos, and at lanes that lead to several lanes",
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
                    format!("{what}: out of range or no number: {}", list(&strange)),
                    "a defect of this program, or a net with extreme coordinates; please report it with the scenario",
                ));
            }
        }
        let seen = scenario.observation;
        if !seen.groups.nearest() && seen.conflict_streams < self.meetings {
            findings.push(finding(
                Severity::Warning,
                format!("a route meets {} others, and agents see {} of them", self.meetings, seen.conflict_streams),
                "more conflictStreams in <observation>, up to 16, or groups=\"both\", which shows the nearest vehicles besides",
            ));
        }
        let [played, unharmed] = self.flat_out;
        if played > 0 && unharmed == played && self.agents > 1 {
            findings.push(finding(
                Severity::Warning,
                format!("nobody came to harm in any of {played} episodes at full throttle: there is little to coordinate"),
                "more vehicles, or places from where they reach the meeting points at the same time; more --steps play more episodes",
            ));
        }
        let constant = self.constant();
        if !constant.is_empty() {
            findings.push(finding(
                Severity::Warning,
                format!("observation: never changed: {}", list(&constant)),
                "fewer streams, vehicles or neighbours in <observation> would do here; more --steps may show more",
            ));
        }
        findings
    }
}

impl Trial {
    /// Groups of the observation that never changed, as `neighbour_3`.
    fn constant(&self) -> Vec<String> {
        let group = |range: &Range| range.name.split('.').next().unwrap_or_default().to_owned();
        let groups = self.observation.chunk_by(|a, b| group(a) == group(b));
        let still = groups
            .filter(|group| group.iter().all(|range| range.finite && range.least >= range.most));
        still.filter_map(|ranges| ranges.first().map(group)).collect()
    }
}

/// Number of other routes that a route meets.
fn meetings(route: &RouteGeometry) -> usize {
    route.conflicts.iter().filter(|conflict| conflict.own <= route.arrival).count()
}

/// Every second episode.
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

/// Takes in what agent `i` saw, of the `[N, F]` that all saw.
fn take(ranges: &mut [Range], all: &[f32], i: usize) {
    let width = ranges.len();
    for (range, &value) in ranges.iter_mut().zip(&all[i * width..(i + 1) * width]) {
        range.finite &= value.is_finite();
        range.least = range.least.min(value);
        range.most = range.most.max(value);
    }
}

/// Names in a sentence, the first of many.
fn list(names: &[String]) -> String {
    let more = names.len().saturating_sub(NAMED);
    let shown = names[..names.len() - more].join(", ");
    if more > 0 { format!("{shown} and {more} more") } else { shown }
}
